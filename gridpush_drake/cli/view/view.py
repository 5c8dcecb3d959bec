"""`gridpush view`: shows a model, a log of pushes or a recording, by Meshcat or in Rerun."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from gridpush_drake.cli.shell import options
from gridpush_drake.cli.shell.console import print_found
from gridpush_drake.cli.view.view_log import (
    OfPushes,
    ViewError,
    describe_pushes,
    find_target,
    find_targets,
    pick_pushes,
    predict_pushes,
)
from gridpush_drake.cli.view.view_page import (
    PageStyle,
    describe_target,
    draw_model_page,
    draw_pushes_page,
    open_recording,
    serve,
)
from gridpush_drake.cli.view.view_rerun import show_model, show_pushes
from gridpush_drake.cli.view.view_scene import describe_colors
from gridpush_drake.display.cell_colors import Shown
from gridpush_drake.display.film import write_film
from gridpush_drake.display.rerun_scene import LIVE_VIEWER, RerunScene
from gridpush_drake.display.server import looks_like_recording, write_recording
from gridpush_drake.files import is_file
from gridpush_drake.objects.object_file import speak_name
from gridpush_drake.station.recording.rerun_replay import show_run
from gridpush_drake.station.recording.run_recording import RECORDING_SUFFIX, read_run


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
            metavar="NAME=MODEL|OBJECT",
            help="For a log of several objects: the model or the object file of one of them, after "
            "the name with which its columns in the log begin; NAME= may be left out if that is "
            "the object's own. The option is repeated for each.",
        ),
    ] = None,
    shows: Annotated[
        Shown,
        typer.Option(
            metavar="VALUE",
            help="What the colors of a model's cells stand for: mass; friction, the coefficient; "
            "or relative_friction, each cell's fraction of the friction.",
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
            callback=options.EXPECT_HTML,
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
            "that viewer. Needs pip install '.\\[rerun]'.",
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
        open_recording(Path(source), open_page, json)
        return

    # A page that is only written needs no port of its own, so that any free one does
    style = PageStyle(shows=shows, height=height, port=port if out is None else 0)
    if others:
        targets, log = find_targets(Path(source), others, largest_piece)
        scene = draw_pushes_page(targets, pick_pushes(Path(source), log, push), style)
    elif kind == ".csv":
        target = find_target(Path(source), object_file, model_file, largest_piece)
        log = options.load_log(Path(source), target.obj, require_final=False)
        scene = draw_pushes_page([target], pick_pushes(Path(source), log, push), style)
    else:
        scene = draw_model_page(options.load_target(source, largest_piece), style)
    scene.page.overlay = scene.overlay
    if out is None:
        serve(scene, open_page, json)
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
        if kind == RECORDING_SUFFIX:
            raise ViewError(
                f"--rerun: missing; a run that --record wrote ({RECORDING_SUFFIX}) is shown with "
                "--rerun "
                "live or --rerun FILE.rrd (Foxglove opens it as it is)"
            )
        return
    if kind in (".html", ".htm"):
        raise ViewError(
            "--rerun: a recording.html is a page already; expected a model, a push log, or a run "
            f"that --record wrote ({RECORDING_SUFFIX})"
        )
    for name, value in of_page.items():
        if value is not None:
            raise ViewError(f"{name}: goes with a page; expected no --rerun with it")


def _show_in_rerun(
    source: str,
    rerun: str,
    of_pushes: OfPushes,
    shows: Shown,
    largest_piece: bool,
    force: bool,
    json: bool,
) -> None:
    """Shown a model, a push log or a recorded run in the Rerun viewer, or writes a file for it."""
    # Everything is read first, so that nothing is begun that cannot be shown
    draw: Callable[[RerunScene], None]
    path = Path(source)
    if path.suffix.lower() == RECORDING_SUFFIX:
        run = read_run(path)
        draw = partial(show_run, run=run)
        found: dict[str, Any] = {"kind": "run", "seconds": run.end}
        lines = [f"{source}: a run of {run.end:.0f} s"]
    elif path.suffix.lower() == ".csv":
        target = find_target(
            path,
            of_pushes.object_file,
            of_pushes.model_file,
            largest_piece,
        )
        log = options.load_log(path, target.obj, require_final=False)
        picked = pick_pushes(path, log, of_pushes.names)
        predictions = predict_pushes([target], picked)
        draw = partial(
            show_pushes,
            target=target,
            log=picked,
            predictions=predictions,
            shows=shows,
        )
        found, lines = describe_pushes([target], picked, predictions, shows)
    else:
        target = options.load_target(source, largest_piece)
        draw = partial(
            show_model,
            target=target,
            shows=shows,
        )
        found = describe_target(target)
        lines = [f"{speak_name(target.obj.name)}: {target.obj.n} cells", describe_colors(shows)]

    scene = RerunScene(rerun, force)
    try:
        draw(scene)
    except BaseException:
        scene.drop()
        raise
    scene.finish()
    if rerun == LIVE_VIEWER:
        found["written"] = []
        lines.append("It is shown in the Rerun viewer.")
    else:
        found["written"] = [rerun]
        lines += options.describe_written(Path(rerun))
    print_found(found, lines, json)


def _check_recording(path: Path) -> None:
    """Raises ViewError where a file is no recording."""
    if not is_file(path):
        raise ViewError(f"{path}: there is no such file")
    if not looks_like_recording(path):
        raise ViewError(
            f"{path}: is not a recording; expected a page that Meshcat wrote, such as the demo's"
        )
