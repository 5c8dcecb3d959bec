"""`gridpush view`: a model, a log of pushes or a recording, in Meshcat."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from gridpush_drake.cli import options
from gridpush_drake.cli.console import print_json, print_line
from gridpush_drake.errors import GridPushError

if TYPE_CHECKING:
    from pydrake.geometry import Meshcat

    from gridpush_drake.identification.prediction import Prediction
    from gridpush_drake.multibody.recording_overlay import Overlay
    from gridpush_drake.pushes.push_log import PushLog

DEFAULT_HEIGHT = 0.03
"""Of an object, m; flat object files do not say."""

MODEL_BESIDE, OBJECT_BESIDE = "model.yaml", "object.yaml"
"""Looked for beside a push log, as `gridpush demo` writes them."""


class ViewError(GridPushError):
    """A file cannot be shown as asked."""


@dataclass(frozen=True)
class ViewOptions:
    """How things are drawn, and where the page goes.

    Attributes:
        shows: which of the cells' values gives their color.
        height: of the object, m.
        port: of the page, where it is served.
        open_page: whether it is opened in the browser then.
        out: file to write it to instead.
        force: whether that may be replaced.
        json: whether to say in JSON what was done.
    """

    shows: Literal["mass", "friction", "relative_friction"]
    height: float
    port: int | None
    open_page: bool
    out: Path | None
    force: bool
    json: bool


def view(
    source: Annotated[
        str,
        typer.Argument(
            metavar="MODEL.yaml|PUSHES.csv|RECORDING.html",
            help="A model that `gridpush identify` wrote (or an object), a push log, or a recording of the demo.",
            show_default=False,
        ),
    ],
    object_file: Annotated[
        str | None, typer.Option("--object", metavar="NAME|FILE", help="The pushes' object, where there is no model.")
    ] = None,
    model_file: Annotated[
        Path | None,
        typer.Option("--model", metavar="FILE", help="Predicts the pushes; by default model.yaml beside the log."),
    ] = None,
    push: Annotated[
        list[str] | None, typer.Option("--push", metavar="NAME", help="Replay this push only; may be repeated.")
    ] = None,
    shows: Annotated[
        Literal["mass", "friction", "relative_friction"], typer.Option(help="What the cells' colors stand for.")
    ] = "mass",
    height: Annotated[float, typer.Option(help="Height of the object, m.")] = DEFAULT_HEIGHT,
    port: Annotated[
        int | None, typer.Option(help="Port of Meshcat's page; by default a free one from 7000 on.")
    ] = None,
    open_page: Annotated[bool, typer.Option("--open/--no-open", help="Open the page in the browser.")] = True,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="FILE.html", help="Write the page instead of serving it.")
    ] = None,
    film: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.gif",
            help="Write a film of a recording, GIF or WebP, instead of showing it; Chromium draws it.",
        ),
    ] = None,
    largest_piece: options.LargestPiece = False,
    force: options.Force = False,
    json: options.Json = False,
) -> None:
    """Show a learned model, replay pushes beside their predictions, or play a recording, in Meshcat."""
    from gridpush_drake.files import check_writable

    kind = Path(source).suffix.lower()
    _check_options(kind, {"--object": object_file, "--model": model_file, "--push": push}, out)
    if not 0 < height < float("inf"):
        raise ViewError(f"--height: is {height}; expected a positive number (m)")
    if out is not None:
        check_writable(out, force)
    if film is not None:
        _write_film(Path(source), film, force, json)
        return
    chosen = ViewOptions(shows, height, port, open_page, out, force, json)
    if kind in (".html", ".htm"):
        _play_recording(Path(source), open_page, json)
    elif kind == ".csv":
        target = _find_target(Path(source), object_file, model_file, largest_piece)
        _view_pushes(Path(source), target, push, chosen)
    else:
        _view_model(source, largest_piece, chosen)


def _check_options(kind: str, of_pushes: dict[str, Any], out: Path | None) -> None:
    for name, value in of_pushes.items():
        if value and kind != ".csv":
            raise ViewError(f"{name}: goes with a push log (.csv) only")
    if of_pushes["--object"] and of_pushes["--model"]:
        raise ViewError("--object: a model holds its own object; expected either --object or --model")
    if out is not None and kind in (".html", ".htm"):
        raise ViewError("--out: a recording is a page already; expected a model or a push log with --out")


def _check_recording(path: Path) -> None:
    from gridpush_drake.files import is_file
    from gridpush_drake.multibody.meshcat_server import looks_like_recording

    if not is_file(path):
        raise ViewError(f"{path}: there is no such file")
    if not looks_like_recording(path):
        raise ViewError(f"{path}: is not a recording; expected a page that Meshcat wrote, such as the demo's")


def _write_film(path: Path, film: Path, force: bool, json: bool) -> None:
    from gridpush_drake.multibody.recording_film import write_film

    _check_recording(path)
    write_film(path, film, force)
    if json:
        print_json({"kind": "film", "written": [str(film)]})
    else:
        print_line(f"Wrote {film}.")


def _play_recording(path: Path, open_page: bool, json: bool) -> None:
    _check_recording(path)
    address = path.resolve().as_uri()
    opened = open_page and _open(address)
    if json:
        print_json({"kind": "recording", "url": address, "opened": opened, "written": []})
    else:
        print_line(f"{'Opened' if opened else 'Open this in a browser:'} {address}")


def _view_model(source: str, largest_piece: bool, chosen: ViewOptions) -> None:
    from gridpush_drake.cli.view_scene import AddModel, describe_colors, make_overlay

    target = options.load_target(source, largest_piece)
    meshcat = _start(chosen)
    AddModel(meshcat, target, chosen.shows, chosen.height)
    lines = [f"{target.obj.name}: {target.obj.n} cells", describe_colors(chosen.shows)]
    kind = "model" if target.model else "object"
    overlay = make_overlay(target, chosen.shows)
    _write_or_serve(meshcat, overlay, {"kind": kind, "object": target.obj.name}, lines, chosen)


def _find_target(log: Path, object_file: str | None, model_file: Path | None, largest_piece: bool) -> "options.Target":
    """The model or object of a push log: as told, or by the names the demo uses."""
    from gridpush_drake.files import exists, is_file
    from gridpush_drake.identification.model_file import looks_like_model

    if model_file is not None and not looks_like_model(model_file):
        raise ViewError(f"--model: {model_file} is not a model; expected a file that `gridpush identify` wrote")
    beside = (log.parent / MODEL_BESIDE, log.parent / OBJECT_BESIDE)
    told = model_file or object_file or next((path for path in beside if is_file(path)), None)
    if not exists(log):
        raise ViewError(f"{log}: there is no such file")
    if told is None:
        raise ViewError(
            f"{log}: its object is unknown; expected --object, --model, or {MODEL_BESIDE} or {OBJECT_BESIDE} beside it"
        )
    return options.load_target(str(told), largest_piece)


def _view_pushes(path: Path, target: "options.Target", names: list[str] | None, chosen: ViewOptions) -> None:
    from gridpush_drake.cli.view_scene import AddPushes, describe_colors, make_overlay
    from gridpush_drake.identification.prediction import summarize_errors

    log = options.load_log(path, target.obj, require_final=False)
    known = [seen.name for seen in log]
    for name in names or ():
        if name not in known:
            raise ViewError(f"--push: {path} has no push {name!r}; it has {', '.join(known)}")
    picked = log.subset([i for i, name in enumerate(known) if not names or name in names])
    predictions = _predict(target, log, picked) if target.model else None
    overhanging = [seen.name for seen in picked.overhanging]
    judged = [prediction for prediction in predictions or [] if prediction.name not in overhanging]
    errors = summarize_errors(target.obj, judged, picked.supported) if judged else []

    meshcat = _start(chosen)
    AddPushes(meshcat, target, picked, predictions, chosen.shows, chosen.height)
    lines = [f"{target.obj.name}: {len(picked)} push{'' if len(picked) == 1 else 'es'}"]
    if predictions:
        lines += ["Solid: as observed. Orange: as the model predicts it.", describe_colors(chosen.shows)]
    cell = [error for error in errors if error.name == "cell"]
    lines += [f"Mean cell error of the final poses: {error.mean * error.scale:.1f} {error.unit}" for error in cell]
    if predictions and overhanging:
        lines.append(f"Of these errors, {options.describe_overhanging(overhanging)}")
    found = {"kind": "pushes", "object": target.obj.name, "pushes": [seen.name for seen in picked]}
    overlay = make_overlay(target, chosen.shows, picked, predictions)
    _write_or_serve(meshcat, overlay, {**found, "errors": [vars(error) for error in errors]}, lines, chosen)


def _predict(target: "options.Target", log: "PushLog", chosen: "PushLog") -> "list[Prediction]":
    from gridpush_drake.identification.learning import choose_regime
    from gridpush_drake.identification.prediction import predict

    options.compile_kernels()
    return predict(target.obj, target.params, chosen, target.resolve_regime("auto", choose_regime(target.obj, log)))


def _start(chosen: ViewOptions) -> "Meshcat":
    from gridpush_drake.multibody.meshcat_server import StartMeshcatServer

    return StartMeshcatServer(0 if chosen.out is not None else chosen.port)


def _write_or_serve(
    meshcat: "Meshcat", overlay: "Overlay", found: dict[str, Any], lines: list[str], chosen: ViewOptions
) -> None:
    """Writes the page, or serves it until told to stop."""
    from gridpush_drake.multibody.meshcat_server import PublishOnce, write_recording

    out, url = chosen.out, meshcat.web_url()
    if out is not None:
        write_recording(meshcat, out, chosen.force, overlay)
        _print_found({**found, "written": [str(out)]}, [*lines, f"Wrote {out}."], chosen.json)
        return
    try:  # from the first line on: who reads the address may interrupt at once
        PublishOnce(meshcat)
        last = f"Meshcat shows it at {url} (Enter or Ctrl-C to end)"
        _print_found({**found, "url": url, "written": []}, [*lines, last], chosen.json)
        if chosen.open_page:
            _open(url)
        _wait()
    except KeyboardInterrupt:
        pass


def _print_found(found: dict[str, Any], lines: list[str], as_json: bool) -> None:
    if as_json:
        print_json(found)
    else:
        for line in lines:
            print_line(line)


def _open(address: str) -> bool:
    """Opens a page in the desktop's browser; False where there is none."""
    import os
    import sys
    import webbrowser

    # Without a display Python would start a browser in the terminal itself, if it finds one.
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        return False
    return webbrowser.open(address)


def _wait() -> None:
    """Returns on Enter at a terminal; elsewhere never."""
    import sys
    from threading import Event

    if sys.stdin is not None and sys.stdin.isatty():
        sys.stdin.readline()
    else:
        Event().wait()
