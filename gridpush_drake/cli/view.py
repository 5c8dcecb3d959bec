"""`gridpush view`: a model, a log of pushes or a recording, in Meshcat."""

import os
import sys
import webbrowser
from collections.abc import Callable
from pathlib import Path
from threading import Event
from typing import Annotated, Any, Literal

import typer

from gridpush_drake.cli import options
from gridpush_drake.cli.console import count_noun, print_found
from gridpush_drake.cli.view_scene import AddModel, AddPushes, describe_colors, make_overlay
from gridpush_drake.display.film import write_film
from gridpush_drake.display.live_page import LivePage
from gridpush_drake.display.overlay import Overlay
from gridpush_drake.display.server import PublishOnce, looks_like_recording, write_recording
from gridpush_drake.errors import GridPushError
from gridpush_drake.files import exists, is_file
from gridpush_drake.identification.model_file import looks_like_model
from gridpush_drake.identification.prediction import predict, summarize_errors

Shows = Literal["mass", "friction", "relative_friction"]

MODEL_BESIDE, OBJECT_BESIDE = "model.yaml", "object.yaml"
"""Looked for beside a push log, as `gridpush demo` writes them."""


class ViewError(GridPushError):
    """A file cannot be shown as asked."""


Serve = Callable[["LivePage", "Overlay", dict[str, Any], list[str]], None]
"""Shows a scene, with what stands beside it, what was found, and the same in lines."""


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
        str | None,
        typer.Option(
            "--object", metavar="NAME|FILE", help="The pushes' object, where there is no model."
        ),
    ] = None,
    model_file: Annotated[
        Path | None,
        typer.Option(
            "--model",
            metavar="FILE",
            help="Predicts the pushes; by default model.yaml beside the log.",
        ),
    ] = None,
    push: Annotated[
        list[str] | None,
        typer.Option("--push", metavar="NAME", help="Replay this push only; may be repeated."),
    ] = None,
    shows: Annotated[Shows, typer.Option(help="What the cells' colors stand for.")] = "mass",
    height: options.Height = None,
    port: Annotated[
        int | None, typer.Option(help="Port of Meshcat's page; by default a free one from 7000 on.")
    ] = None,
    open_page: Annotated[
        bool, typer.Option("--open/--no-open", help="Open the page in the browser.")
    ] = True,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            metavar="FILE.html",
            callback=options.HTML,
            help="Write the page instead of serving it.",
        ),
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
    kind = Path(source).suffix.lower()
    _check_options(kind, {"--object": object_file, "--model": model_file, "--push": push}, out)
    if height is not None and not 0 < height < float("inf"):
        raise ViewError(f"--height: is {height}; expected a positive number (m)")
    options.check_outputs(force, out, inputs=(source,))

    def serve(page: LivePage, overlay: Overlay, found: dict[str, Any], lines: list[str]) -> None:
        _write_or_serve(page, overlay, found, lines, out, open_page, force, json)

    if film is not None:
        _check_recording(Path(source))
        write_film(Path(source), film, force)
        print_found({"kind": "film", "written": [str(film)]}, options.describe_written(film), json)
    elif kind in (".html", ".htm"):
        _check_recording(Path(source))
        address = Path(source).resolve().as_uri()
        opened = open_page and _open(address)
        line = f"{'Opened' if opened else 'Open this in a browser:'} {address}"
        print_found(
            {"kind": "recording", "url": address, "opened": opened, "written": []}, [line], json
        )
    elif kind == ".csv":
        target = _find_target(Path(source), object_file, model_file, largest_piece)
        _view_pushes(Path(source), target, push, shows, height, port if out is None else 0, serve)
    else:
        _view_model(source, largest_piece, shows, height, port if out is None else 0, serve)


def _check_options(kind: str, of_pushes: dict[str, Any], out: Path | None) -> None:
    for name, value in of_pushes.items():
        if value and kind != ".csv":
            raise ViewError(f"{name}: goes with a push log (.csv) only")
    if of_pushes["--object"] and of_pushes["--model"]:
        raise ViewError(
            "--object: a model holds its own object; expected either --object or --model"
        )
    if out is not None and kind in (".html", ".htm"):
        raise ViewError(
            "--out: a recording is a page already; expected a model or a push log with --out"
        )


def _check_recording(path: Path) -> None:

    if not is_file(path):
        raise ViewError(f"{path}: there is no such file")
    if not looks_like_recording(path):
        raise ViewError(
            f"{path}: is not a recording; expected a page that Meshcat wrote, such as the demo's"
        )


def _view_model(
    source: str, largest_piece: bool, shows: Shows, height: float | None, port: int | None, serve: Serve
) -> None:  # fmt: skip

    target = options.load_target(source, largest_piece)
    page = LivePage(port)
    AddModel(page.meshcat, target, shows, options.choose_height(height, target.obj))
    lines = [f"{target.obj.name}: {target.obj.n} cells", describe_colors(shows)]
    kind = "model" if target.model else "object"
    serve(page, make_overlay(target, shows), {"kind": kind, "object": target.obj.name}, lines)


def _find_target(
    log: Path, object_file: str | None, model_file: Path | None, largest_piece: bool
) -> options.Target:
    """The model or object of a push log: as told, or by the names the demo uses."""
    if model_file is not None and not looks_like_model(model_file):
        raise ViewError(
            f"--model: {model_file} is not a model; expected a file that `gridpush identify` wrote"
        )
    beside = (log.parent / MODEL_BESIDE, log.parent / OBJECT_BESIDE)
    told = model_file or object_file or next((path for path in beside if is_file(path)), None)
    if not exists(log):
        raise ViewError(f"{log}: there is no such file")
    if told is None:
        raise ViewError(
            f"{log}: its object is unknown; expected --object, --model, or {MODEL_BESIDE} or {OBJECT_BESIDE} beside it"
        )
    return options.load_target(str(told), largest_piece)


def _view_pushes(
    path: Path, target: options.Target, names: list[str] | None, shows: Shows, height: float | None, port: int | None,
    serve: Serve,
) -> None:  # fmt: skip

    log = options.load_log(path, target.obj, require_final=False)
    known = [seen.name for seen in log]
    for name in names or ():
        if name not in known:
            raise ViewError(f"--push: {path} has no push {name!r}; it has {', '.join(known)}")
    picked = log.subset([i for i, name in enumerate(known) if not names or name in names])
    predictions = None
    if target.model:
        options.compile_kernels()
        predictions = predict(
            target.obj, target.params, picked, physics=target.make_physics("auto")
        )
    overhanging = [seen.name for seen in picked.overhanging]
    judged = [prediction for prediction in predictions or [] if prediction.name not in overhanging]
    errors = summarize_errors(target.obj, judged, picked.supported) if judged else []

    page = LivePage(port)
    tall = options.choose_height(height, target.obj)
    AddPushes(page.meshcat, target, picked, predictions, shows, tall)
    lines = [f"{target.obj.name}: {count_noun(len(picked), 'push')}"]
    if predictions:
        lines += ["Solid: as observed. Orange: as the model predicts it.", describe_colors(shows)]
    cell = [error for error in errors if error.name == "cell"]
    lines += [
        f"Mean cell error of the final poses: {error.mean * error.scale:.1f} {error.unit}"
        for error in cell
    ]
    if predictions and overhanging:
        lines.append(f"Of these errors, {options.describe_overhanging(overhanging)}")
    found = {"kind": "pushes", "object": target.obj.name, "pushes": [seen.name for seen in picked]}
    overlay = make_overlay(target, shows, picked, predictions)
    serve(page, overlay, {**found, "errors": [vars(error) for error in errors]}, lines)


def _write_or_serve(
    page: LivePage, overlay: Overlay, found: dict[str, Any], lines: list[str], out: Path | None, open_page: bool,
    force: bool, json: bool,
) -> None:  # fmt: skip
    """Writes the page, or serves it until told to stop."""
    url = page.url
    page.overlay = overlay
    if out is not None:
        write_recording(page.meshcat, out, force, overlay)
        print_found(
            {**found, "written": [str(out)]}, [*lines, *options.describe_written(out)], json
        )
        return
    try:  # from the first line on: who reads the address may interrupt at once
        PublishOnce(page.meshcat)
        last = f"Meshcat shows it at {url} (Enter or Ctrl-C to end)"
        print_found({**found, "url": url, "written": []}, [*lines, last], json)
        if open_page:
            _open(url)
        _wait()
    except KeyboardInterrupt:
        pass


def _open(address: str) -> bool:
    """Opens a page in the desktop's browser; False where there is none."""
    # Without a display Python would start a browser in the terminal itself, if it finds one.
    if sys.platform.startswith("linux") and not (
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    ):
        return False
    return webbrowser.open(address)


def _wait() -> None:
    """Returns on Enter at a terminal; elsewhere never."""
    if sys.stdin is not None and sys.stdin.isatty():
        sys.stdin.readline()
    else:
        Event().wait()
