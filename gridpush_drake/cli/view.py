"""`gridpush view`: shows a model, a log of pushes or a recording, by Meshcat or in Rerun."""

import os
import sys
import webbrowser
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from threading import Event
from typing import Annotated, Any, Literal

import typer

from gridpush_drake.cli import options
from gridpush_drake.cli.console import count_noun, print_found
from gridpush_drake.cli.view_rerun import show_model, show_pushes
from gridpush_drake.cli.view_scene import AddModel, AddPushes, describe_colors, make_overlay
from gridpush_drake.cli.view_scene_log import (
    AddScenePushes,
    describe_scene_pushes,
    make_scene,
    make_scene_overlay,
    predict_scene,
)
from gridpush_drake.display.film import write_film
from gridpush_drake.display.live_page import LivePage
from gridpush_drake.display.overlay import Overlay
from gridpush_drake.display.rerun_scene import LIVE, RerunScene
from gridpush_drake.display.server import PublishOnce, looks_like_recording, write_recording
from gridpush_drake.errors import GridPushError
from gridpush_drake.files import exists, is_file
from gridpush_drake.identification.model_file import looks_like_model
from gridpush_drake.identification.prediction import Prediction, predict, summarize_errors
from gridpush_drake.identification.scene_learning import find_pusher_radius
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.pushes.scene_log import SceneLog
from gridpush_drake.station.rerun_replay import show_run
from gridpush_drake.station.run_recording import SUFFIX, read_run

Shows = Literal["mass", "friction", "relative_friction"]
"""What the colors of the cells may stand for."""

MODEL_BESIDE = "model.yaml"
"""Name of the model that is looked for beside a push log; `gridpush demo` writes it there."""

OBJECT_BESIDE = "object.yaml"
"""Name of the object that is looked for beside a push log; `gridpush demo` writes it there."""


class ViewError(GridPushError):
    """A file cannot be shown in the way that was asked for."""


@dataclass(frozen=True)
class Scene:
    """What is shown.

    Attributes:
        page: the page, on which everything has been drawn.
        overlay: the legend and the captions of the page.
        found: what is printed with `--json`.
        lines: what is printed without it.
    """

    page: LivePage
    overlay: Overlay
    found: dict[str, Any]
    lines: list[str]


@dataclass(frozen=True)
class Look:
    """How it is shown.

    Attributes:
        shows: what the colors of the cells stand for.
        height: height of the object, m; None for its file's, or the default one.
        port: port of the page; None for the first free one from 7000 on, 0 for any.
    """

    shows: Shows
    height: float | None
    port: int | None


@dataclass(frozen=True)
class OfPushes:
    """Options that go with a push log.

    Attributes:
        object_file: the object that was pushed; None for the one beside the log.
        model_file: the model by which pushes are predicted; None for the one beside the log.
        names: names of the pushes to replay; None for all.
    """

    object_file: str | None
    model_file: Path | None
    names: list[str] | None


def view(
    source: Annotated[
        str,
        typer.Argument(
            metavar="MODEL.yaml|PUSHES.csv|RECORDING.html|RUN.mcap",
            help="What to show: a model that `gridpush identify` wrote, an object, a push log, "
            "the recording.html of a demo, or, with --rerun, a run that --record wrote.",
            show_default=False,
        ),
    ],
    object_file: Annotated[
        str | None,
        typer.Option(
            "--object",
            metavar="NAME|FILE",
            help="The object that was pushed, for a push log without a model.",
            show_default="object.yaml beside the log",
        ),
    ] = None,
    model_file: Annotated[
        Path | None,
        typer.Option(
            "--model",
            metavar="FILE",
            help="The learned model by which the pushes of a log are predicted.",
            show_default="model.yaml beside the log",
        ),
    ] = None,
    push: Annotated[
        list[str] | None,
        typer.Option(
            "--push",
            metavar="NAME",
            help="Replay only this push of the log. The option may be repeated.",
            show_default="all pushes",
        ),
    ] = None,
    others: Annotated[
        list[str] | None,
        typer.Option(
            "--with",
            metavar="\\[NAME=]MODEL.yaml|OBJECT",
            help="An object of a log of several, by the name that its columns begin with; to be "
            "repeated for each of them, with its model or only the object.",
        ),
    ] = None,
    shows: Annotated[
        Shows,
        typer.Option(
            help="What the colors of a model's cells stand for: mass; friction, the coefficient; "
            "or relative_friction, each cell's share of the friction."
        ),
    ] = "mass",
    height: options.Height = None,
    port: Annotated[
        int | None,
        typer.Option(
            metavar="N", help="Port of the page.", show_default="the first free one from 7000"
        ),
    ] = None,
    open_page: Annotated[
        bool,
        typer.Option(
            "--open/--no-open", help="Whether to open the page in the browser, or only to serve it."
        ),
    ] = True,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            metavar="FILE.html",
            callback=options.HTML,
            help="Write the page to this file instead of serving it.",
        ),
    ] = None,
    film: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.gif",
            help="Make a film of a recording instead of showing it, as .gif or .webp. This needs "
            "Chromium, which draws it.",
        ),
    ] = None,
    rerun: Annotated[
        str | None,
        typer.Option(
            "--rerun",
            metavar="FILE.rrd|live",
            help="Show it in the Rerun viewer instead of the browser (live), or write a file for "
            "that viewer. Needs pip install 'gridpush-drake\\[rerun]'.",
        ),
    ] = None,
    largest_piece: options.LargestPiece = False,
    force: options.Force = False,
    json: options.Json = False,
) -> None:
    """Show a learned model, a log of pushes or a recording in the browser, or in Rerun.

    The pushes of a log are replayed one after the other, the observed motion beside the predicted
    one. The page is served until Enter or Ctrl-C ends the command.

    Example: gridpush view gridpush_demo/pushes.csv
    """
    kind = Path(source).suffix.lower()
    of_log = {"--object": object_file, "--model": model_file, "--push": push, "--with": others}
    _check_options(kind, of_log, out)
    of_page = {
        "--out": out,
        "--film": film,
        "--port": port,
        "--height": height,
        "--with": others or None,
    }
    _check_rerun(kind, rerun, of_page)
    if height is not None and not 0 < height < float("inf"):
        raise ViewError(f"--height: is {height}; expected a positive number (m)")
    options.check_outputs(force, out, inputs=(source,))
    if rerun is not None:
        of_pushes = OfPushes(
            object_file=object_file,
            model_file=model_file,
            names=push,
        )
        _show_in_rerun(
            source,
            rerun,
            of_pushes,
            shows=shows,
            largest_piece=largest_piece,
            force=force,
            json=json,
        )
        return
    if film is not None:
        _check_recording(Path(source))
        write_film(Path(source), film, force)
        print_found({"kind": "film", "written": [str(film)]}, options.describe_written(film), json)
        return
    if kind in (".html", ".htm"):
        _check_recording(Path(source))
        _open_recording(Path(source), open_page, json)
        return

    # A page that is only written needs no port of its own, so that any free one does
    look = Look(shows=shows, height=height, port=port if out is None else 0)
    if others:
        scene = _show_scene_log(Path(source), others, push, look, largest_piece)
    elif kind == ".csv":
        target = _find_target(Path(source), object_file, model_file, largest_piece)
        scene = _show_pushes(Path(source), target, push, look)
    else:
        scene = _show_model(options.load_target(source, largest_piece), look)
    scene.page.overlay = scene.overlay
    if out is None:
        _serve(scene, open_page, json)
    else:
        write_recording(scene.page.meshcat, out, force, scene.overlay)
        lines = [*scene.lines, *options.describe_written(out)]
        print_found({**scene.found, "written": [str(out)]}, lines, json)


def _check_options(kind: str, of_pushes: dict[str, Any], out: Path | None) -> None:
    """Raises ViewError where options do not go together with what is shown.

    Args:
        kind: ending of the source's name, in small letters.
        of_pushes: the options that go with a push log only, by their names.
        out: the page to write.
    """
    for name, value in of_pushes.items():
        if value and kind != ".csv":
            raise ViewError(f"{name}: goes with a push log (.csv) only")
    if of_pushes["--with"] and (of_pushes["--object"] or of_pushes["--model"]):
        raise ViewError(
            "--with: names the objects of a log of several; expected no --object or --model with it"
        )
    if of_pushes["--object"] and of_pushes["--model"]:
        raise ViewError(
            "--object: a model holds its own object; expected either --object or --model"
        )
    if out is not None and kind in (".html", ".htm"):
        raise ViewError(
            "--out: a recording is a page already; expected a model or a push log with --out"
        )


def _check_rerun(kind: str, rerun: str | None, of_page: dict[str, Any]) -> None:
    """Raises ViewError where --rerun is missing, or does not go with what is shown and how.

    Args:
        kind: ending of the source's name, in small letters.
        rerun: what the option says; None if it is not given.
        of_page: the options that go with a page only, by their names.
    """
    if rerun is None:
        if kind == SUFFIX:
            raise ViewError(
                f"--rerun: missing; a run that --record wrote ({SUFFIX}) is shown with --rerun "
                "live or --rerun FILE.rrd (Foxglove opens it as it is)"
            )
        return
    if kind in (".html", ".htm"):
        raise ViewError(
            "--rerun: a recording.html is a page already; expected a model, a push log, or a run "
            f"that --record wrote ({SUFFIX})"
        )
    for name, value in of_page.items():
        if value is not None:
            raise ViewError(f"{name}: goes with a page; expected no --rerun with it")


def _show_in_rerun(
    source: str,
    rerun: str,
    of_pushes: OfPushes,
    shows: Shows,
    largest_piece: bool,
    force: bool,
    json: bool,
) -> None:
    """Shows a model, a push log or a recorded run in the Rerun viewer, or writes a file for it."""
    # Everything is read first, so that nothing is begun that cannot be shown
    draw: Callable[[RerunScene], None]
    path = Path(source)
    if path.suffix.lower() == SUFFIX:
        run = read_run(path)
        draw = partial(show_run, run=run)
        found: dict[str, Any] = {"kind": "run", "seconds": run.end}
        lines = [f"{source}: a run of {run.end:.0f} s"]
    elif path.suffix.lower() == ".csv":
        target = _find_target(
            path,
            of_pushes.object_file,
            of_pushes.model_file,
            largest_piece,
        )
        picked = _pick_pushes(path, target, of_pushes.names)
        predictions = _predict(target, picked)
        draw = partial(
            show_pushes,
            target=target,
            log=picked,
            predictions=predictions,
            shows=shows,
        )
        found, lines = _describe_pushes(target, picked, predictions, shows)
    else:
        target = options.load_target(source, largest_piece)
        draw = partial(
            show_model,
            target=target,
            shows=shows,
        )
        found = _describe_target(target)
        lines = [f"{target.obj.name}: {target.obj.n} cells", describe_colors(shows)]

    scene = RerunScene(rerun, force)
    try:
        draw(scene)
    except BaseException:
        scene.drop()
        raise
    scene.finish()
    if rerun == LIVE:
        found["written"] = []
        lines.append("It is shown in the Rerun viewer.")
    else:
        found["written"] = [rerun]
        lines += options.describe_written(Path(rerun))
    print_found(found, lines, json)


def _describe_target(target: options.Target) -> dict[str, Any]:
    """Says for machines what is shown: a learned model, or only an object."""
    kind = "model" if target.model else "object"
    return {"kind": kind, "object": target.obj.name}


def _check_recording(path: Path) -> None:
    """Raises ViewError where a file is no recording."""
    if not is_file(path):
        raise ViewError(f"{path}: there is no such file")
    if not looks_like_recording(path):
        raise ViewError(
            f"{path}: is not a recording; expected a page that Meshcat wrote, such as the demo's"
        )


def _open_recording(path: Path, open_page: bool, json: bool) -> None:
    """Opens a recording in the browser, or prints its address; it needs no server."""
    address = path.resolve().as_uri()
    opened = open_page and _open(address)
    line = f"{'Opened' if opened else 'Open this in a browser:'} {address}"
    found = {"kind": "recording", "url": address, "opened": opened, "written": []}
    print_found(found, [line], json)


def _show_model(target: options.Target, look: Look) -> Scene:
    """Draws a model or an object at rest."""
    page = LivePage(look.port)
    AddModel(page.meshcat, target, look.shows, options.choose_height(look.height, target.obj))
    return Scene(
        page=page,
        overlay=make_overlay(target, look.shows),
        found=_describe_target(target),
        lines=[f"{target.obj.name}: {target.obj.n} cells", describe_colors(look.shows)],
    )


def _find_target(
    log: Path, object_file: str | None, model_file: Path | None, largest_piece: bool
) -> options.Target:
    """Reads the model or the object of a push log.

    It is the one that the user names, else the one beside the log under a name that the demo uses.
    """
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
            f"{log}: its object is unknown; expected --object, --model, or {MODEL_BESIDE} or "
            f"{OBJECT_BESIDE} beside it"
        )
    return options.load_target(str(told), largest_piece)


def _show_pushes(path: Path, target: options.Target, names: list[str] | None, look: Look) -> Scene:
    """Records a replay of pushes, beside their predictions if there is a learned model.

    Args:
        path: the push log.
        target: the model or the object that was pushed.
        names: names of the pushes to replay; None for all.
        look: how they are shown.

    Raises:
        ViewError: the log has no push of a name.
    """
    picked = _pick_pushes(path, target, names)
    predictions = _predict(target, picked)
    page = LivePage(look.port)
    height = options.choose_height(look.height, target.obj)
    AddPushes(page.meshcat, target, picked, predictions, look.shows, height)

    found, lines = _describe_pushes(target, picked, predictions, look.shows)
    overlay = make_overlay(target, look.shows, picked, predictions)
    return Scene(page=page, overlay=overlay, found=found, lines=lines)


def _show_scene_log(
    path: Path, named: list[str], names: list[str] | None, look: Look, largest_piece: bool
) -> Scene:
    """Records a replay of pushes of several objects, beside their predictions if all are learned.

    Args:
        path: the log.
        named: the objects, as NAME=FILE or FILE.
        names: names of the pushes to replay; None for all.
        look: how they are shown.
        largest_piece: as of `options.LargestPiece`.

    Raises:
        ViewError: the log has other objects, or no push of a name.
    """
    targets = {}
    for text in named:
        name, file = options.split_name(text)
        target = options.load_target(file, largest_piece)
        targets[name or target.obj.name] = target
    objects = [target.obj for target in targets.values()]
    log = SceneLog.read_csv(path, find_pusher_radius(objects))
    options.check_names(path, log, targets)
    known = [seen.name for seen in log]
    for name in names or ():
        if name not in known:
            raise ViewError(f"--push: {path} has no push {name!r}; it has {', '.join(known)}")
    picked = tuple(seen for seen in log if not names or seen.name in names)
    log = SceneLog(picked, log.names)
    options.compile_kernels()
    believed = make_scene(targets, log)
    motions = predict_scene(believed, log)
    page = LivePage(look.port)
    height = options.choose_height(look.height, objects[0])
    AddScenePushes(page.meshcat, targets, log, motions, look.shows, height)
    found, lines = describe_scene_pushes(believed, log)
    return Scene(page=page, overlay=make_scene_overlay(log, motions), found=found, lines=lines)


def _describe_pushes(
    target: options.Target,
    picked: PushLog,
    predictions: list[Prediction] | None,
    shows: Shows,
) -> tuple[dict[str, Any], list[str]]:
    """Says which pushes are shown, and how well they are predicted; for machines and in lines."""
    # The model assumes a table below all of the object, so pushes over its edge are not judged
    overhanging = [seen.name for seen in picked.overhanging]
    judged = [prediction for prediction in predictions or [] if prediction.name not in overhanging]
    errors = summarize_errors(target.obj, judged, picked.supported) if judged else []
    lines = [f"{target.obj.name}: {count_noun(len(picked), 'push')}"]
    if predictions:
        lines.append("Solid: as observed. Orange: as the model predicts it.")
        lines.append(describe_colors(shows))
    for error in errors:
        if error.name == "cell":
            mean = error.mean * error.scale
            lines.append(f"Mean cell error of the final poses: {mean:.1f} {error.unit}")
    if predictions and overhanging:
        lines.append(f"These errors have {options.describe_overhanging(overhanging)}")
    found = {
        "kind": "pushes",
        "object": target.obj.name,
        "pushes": [seen.name for seen in picked],
        "errors": [vars(error) for error in errors],
    }
    return found, lines


def _predict(target: options.Target, picked: PushLog) -> list[Prediction] | None:
    """Predicts pushes by a learned model; None where nothing was learned."""
    if target.model is None:
        return None
    options.compile_kernels()
    return predict(target.obj, target.params, picked, physics=target.make_physics("auto"))


def _pick_pushes(path: Path, target: options.Target, names: list[str] | None) -> PushLog:
    """Reads the pushes with some names, or all pushes, from a log."""
    log = options.load_log(path, target.obj, require_final=False)
    known = [seen.name for seen in log]
    for name in names or ():
        if name not in known:
            raise ViewError(f"--push: {path} has no push {name!r}; it has {', '.join(known)}")
    return log.subset([i for i, name in enumerate(known) if not names or name in names])


def _serve(scene: Scene, open_page: bool, json: bool) -> None:
    """Serves a page until the user ends the command."""
    url = scene.page.url
    # Whoever reads the address may interrupt at once, so everything from the first line on is
    # guarded
    try:
        PublishOnce(scene.page.meshcat)
        last = f"The page is at {url} (Enter or Ctrl-C ends it)"
        found = {**scene.found, "url": url, "written": []}
        print_found(found, [*scene.lines, last], json)
        if open_page:
            _open(url)
        _wait()
    except KeyboardInterrupt:
        pass


def _open(address: str) -> bool:
    """Opens a page in the desktop's browser. Returns False if there is none."""
    # Without a display Python would start a browser in the terminal itself, if it finds one.
    if sys.platform.startswith("linux") and not (
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    ):
        return False
    return webbrowser.open(address)


def _wait() -> None:
    """Waits for Enter at a terminal; without one, until the process is interrupted."""
    if sys.stdin is not None and sys.stdin.isatty():
        sys.stdin.readline()
    else:
        Event().wait()
