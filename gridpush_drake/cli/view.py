"""`gridpush view`: a model, a log of pushes or a recording, in Meshcat.

What `gridpush view` puts into Meshcat: a model, or pushes to be replayed with their predictions.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import typer
from numpy.typing import ArrayLike, NDArray
from pydrake.geometry import Box, Cylinder, Meshcat, Rgba

from gridpush_drake.cli import options
from gridpush_drake.cli.console import MM, print_json, print_line
from gridpush_drake.cli.options import Target
from gridpush_drake.cli.recording_legend import describe_scale, list_center_marks, to_css
from gridpush_drake.errors import GridPushError
from gridpush_drake.identification.prediction import Prediction
from gridpush_drake.multibody.cell_colors import CellColors, Shown
from gridpush_drake.multibody.meshcat_server import AimCamera
from gridpush_drake.multibody.meshcat_shapes import (
    LAYER,
    PLAN_COLOR,
    AddArrow,
    AddCells,
    AddCenter,
    AddGhost,
    ApplyTurn,
    MakePlanarTransform,
)
from gridpush_drake.multibody.recording_overlay import Mark, Overlay, Phase
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.pushes.push_log import ObservedPush, PushLog
from gridpush_drake.systems.estimate_visualizer import SIGMAS

if TYPE_CHECKING:
    from pydrake.geometry import Meshcat

    from gridpush_drake.cli.options import Target
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
class Look:
    """How things are drawn: which of the cells' values gives their color, and the object's height, m."""

    shows: Literal["mass", "friction", "relative_friction"]
    height: float


@dataclass(frozen=True)
class Delivery:
    """Where the page goes: to a port, and the browser, or to the file `out`; and whether to say so in JSON."""

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
    height: Annotated[float, typer.Option(help="Of the object, m.")] = DEFAULT_HEIGHT,
    port: Annotated[int | None, typer.Option(help="Of Meshcat's page; by default a free one from 7000 on.")] = None,
    open_page: Annotated[bool, typer.Option("--open/--no-open", help="Open the page in the browser.")] = True,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="FILE.html", help="Write the page instead of serving it.")
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
    look, delivery = Look(shows, height), Delivery(port, open_page, out, force, json)
    if kind in (".html", ".htm"):
        _play_recording(Path(source), open_page, json)
    elif kind == ".csv":
        target = _find_target(Path(source), object_file, model_file, largest_piece)
        _view_pushes(Path(source), target, push, look, delivery)
    else:
        _view_model(source, look, largest_piece, delivery)


def _check_options(kind: str, of_pushes: dict[str, Any], out: Path | None) -> None:
    for name, value in of_pushes.items():
        if value and kind != ".csv":
            raise ViewError(f"{name}: goes with a push log (.csv) only")
    if of_pushes["--object"] and of_pushes["--model"]:
        raise ViewError("--object: a model holds its own object; expected either --object or --model")
    if out is not None and kind in (".html", ".htm"):
        raise ViewError("--out: a recording is a page already; expected a model or a push log with --out")


def _play_recording(path: Path, open_page: bool, json: bool) -> None:
    from gridpush_drake.files import is_file
    from gridpush_drake.multibody.meshcat_server import looks_like_recording

    if not is_file(path):
        raise ViewError(f"{path}: there is no such file")
    if not looks_like_recording(path):
        raise ViewError(f"{path}: is not a recording; expected a page that Meshcat wrote, such as the demo's")
    address = path.resolve().as_uri()
    opened = open_page and _open(address)
    if json:
        print_json({"kind": "recording", "url": address, "opened": opened, "written": []})
    else:
        print_line(f"{'Opened' if opened else 'Open this in a browser:'} {address}")


def _view_model(source: str, look: Look, largest_piece: bool, delivery: Delivery) -> None:
    from gridpush_drake.cli.options import load_target

    target = load_target(source, largest_piece)
    meshcat = _start(delivery)
    AddModel(meshcat, target, look.shows, look.height)
    lines = [f"{target.obj.name}: {target.obj.n} cells", describe_colors(look.shows)]
    kind = "model" if target.model else "object"
    overlay = make_overlay(target, look.shows)
    _deliver(meshcat, overlay, {"kind": kind, "object": target.obj.name}, lines, delivery)


def _find_target(log: Path, object_file: str | None, model_file: Path | None, largest_piece: bool) -> "Target":
    """The model or object of a push log: as told, or by the names the demo uses."""
    from gridpush_drake.cli.options import load_target
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
    return load_target(str(told), largest_piece)


def _view_pushes(path: Path, target: "Target", names: list[str] | None, look: Look, delivery: Delivery) -> None:
    from gridpush_drake.cli.options import describe_overhanging, load_log
    from gridpush_drake.identification.prediction import summarize_errors

    log = load_log(path, target.obj, require_final=False)
    known = [seen.name for seen in log]
    for name in names or ():
        if name not in known:
            raise ViewError(f"--push: {path} has no push {name!r}; it has {', '.join(known)}")
    chosen = log.subset([i for i, name in enumerate(known) if not names or name in names])
    predictions = _predict(target, log, chosen) if target.model else None
    overhanging = [seen.name for seen in chosen.overhanging]
    judged = [prediction for prediction in predictions or [] if prediction.name not in overhanging]
    errors = summarize_errors(target.obj, judged, chosen.supported) if judged else []

    meshcat = _start(delivery)
    AddPushes(meshcat, target, chosen, predictions, look.shows, look.height)
    lines = [f"{target.obj.name}: {len(chosen)} push{'' if len(chosen) == 1 else 'es'}"]
    if predictions:
        lines += ["Solid: as observed. Orange: as the model predicts it.", describe_colors(look.shows)]
    cell = [error for error in errors if error.name == "cell"]
    lines += [f"Mean cell error of the final poses: {error.mean * error.scale:.1f} {error.unit}" for error in cell]
    if predictions and overhanging:
        lines.append(f"Of these errors, {describe_overhanging(overhanging)}")
    found = {"kind": "pushes", "object": target.obj.name, "pushes": [seen.name for seen in chosen]}
    overlay = make_overlay(target, look.shows, chosen, predictions)
    _deliver(meshcat, overlay, {**found, "errors": [vars(error) for error in errors]}, lines, delivery)


def _predict(target: "Target", log: "PushLog", chosen: "PushLog") -> "list[Prediction]":
    from gridpush_drake.cli.options import compile_kernels
    from gridpush_drake.identification.learning import choose_regime
    from gridpush_drake.identification.prediction import predict

    compile_kernels()
    return predict(target.obj, target.params, chosen, target.resolve_regime("auto", choose_regime(target.obj, log)))


def _start(delivery: Delivery) -> "Meshcat":
    from gridpush_drake.multibody.meshcat_server import StartMeshcatServer

    return StartMeshcatServer(0 if delivery.out is not None else delivery.port)


def _deliver(
    meshcat: "Meshcat", overlay: "Overlay", found: dict[str, Any], lines: list[str], delivery: Delivery
) -> None:
    """Writes the page, or serves it until told to stop."""
    from gridpush_drake.multibody.meshcat_server import PublishOnce, write_recording

    out, url = delivery.out, meshcat.web_url()
    if out is None:
        PublishOnce(meshcat)
        found, last = {**found, "url": url, "written": []}, f"Meshcat shows it at {url} (Enter or Ctrl-C to end)"
    else:
        write_recording(meshcat, out, delivery.force, overlay)
        found, last = {**found, "written": [str(out)]}, f"Wrote {out}."
    if delivery.json:
        print_json(found)
    else:
        for line in (*lines, last):
            print_line(line)
    if out is None:
        if delivery.open_page:
            _open(url)
        _wait()


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
    """Returns on Enter at a terminal, or on Ctrl-C."""
    import sys
    from threading import Event

    try:
        if sys.stdin is not None and sys.stdin.isatty():
            sys.stdin.readline()
        else:
            Event().wait()
    except KeyboardInterrupt:
        pass


Array = NDArray[np.float64]

OBJECT, GHOST, FINGER, PUSHES, TABLE = "object", "predicted", "finger", "pushes", "table"
"""Paths in Meshcat."""

TABLE_COLOR = Rgba(0.86, 0.84, 0.80)
FINGER_COLOR = Rgba(0.25, 0.27, 0.30)
PLAIN_COLOR = (0.62, 0.66, 0.70)
"""Cells of which nothing is known, sRGB."""

TABLE_MARGIN, TABLE_THICKNESS = 0.05, 0.01
"""About what stands on the table, and of the table, m."""

VIEW_SHARE = 0.65
"""Distance of the camera, in diagonals of what is to be seen."""

FINGER_SHARE = 2.0
"""Height of the finger, in heights of the object."""

FRAMES_PER_SECOND = 30.0

HOLD = 0.8
"""s for which a push's first and last poses are held."""


def describe_colors(shows: Shown) -> str:
    """What the colors mean, in a sentence."""
    least, greatest = CellColors(shows).resolve_limits()
    if shows == "friction":
        return f"Colors: the cells' friction coefficient, from {least:g} (dark) to {greatest:g} (bright)."
    what = "mass" if shows == "mass" else "share of the friction"
    return f"Colors: the cells' {what}, from {least:g} (dark) to {greatest:g} times (bright) the even share."


def AddModel(meshcat: Meshcat, target: Target, shows: Shown, height: float) -> None:
    """Draws a model at rest in its body frame: its cells in their colors, the center of mass and its ellipse.

    Args:
        meshcat: where to draw.
        target: the model, or an object with its prior.
        shows: what the colors stand for.
        height: of the object, m.
    """
    _AddObject(meshcat, target, CellColors(shows), height)
    _FrameScene(meshcat, np.array(target.obj.outline.bounds).reshape(2, 2))


def make_overlay(
    target: Target, shows: Shown, log: PushLog | None = None, predictions: Sequence[Prediction] | None = None
) -> Overlay:
    """What stands beside the page of a model, or of the pushes that `AddPushes` records."""
    scale = describe_scale(target.obj, CellColors(shows)) if target.model is not None else None
    marks = list_center_marks() if target.model is not None else ()
    if log is not None:
        marks += (Mark(to_css(PLAN_COLOR), "the finger's push", "line"),)
    if predictions is not None:
        marks += (Mark(to_css(PLAN_COLOR), "the object as the model predicts it; solid: as observed"),)
    phases, begin = [], 0.0
    for seen in log or ():
        detail = f"{MM * seen.push.length:.0f} mm in {seen.push.duration:.1f} s"
        over = "; a part of the object hangs over the table's edge" if seen.overhang else ""
        phases.append(Phase(begin, seen.name, detail + over))
        begin += HOLD + seen.push.duration + HOLD
    return Overlay(scale, marks, tuple(phases))


def AddPushes(
    meshcat: Meshcat,
    target: Target,
    log: PushLog,
    predictions: Sequence[Prediction] | None,
    shows: Shown,
    height: float,
) -> None:
    """Records pushes one after the other: the object as observed, the finger, and the predicted poses as a ghost.

    Between two observations the object is drawn on the straight way from one to the other.

    Args:
        meshcat: where to draw; its recording is begun here and left for the caller to publish.
        target: the model that predicts, or the object alone.
        log: the pushes.
        predictions: one a push; None for none.
        shows: what the cells' colors stand for.
        height: of the object, m.
    """
    obj = target.obj
    _AddObject(meshcat, target, CellColors(shows), height)
    if predictions is not None:
        AddGhost(meshcat, GHOST, obj, height)
    _FrameScene(meshcat, _calc_extent(obj, log))
    meshcat.StartRecording(FRAMES_PER_SECOND)
    begin = 0.0
    for i, seen in enumerate(log):
        _AddPush(meshcat, seen, i, begin, height)
        first, last = begin + HOLD, begin + HOLD + seen.push.duration
        times, poses = np.append(0.0, seen.t_observed), np.vstack([seen.pose, seen.poses_observed])
        _RecordPoses(meshcat, OBJECT, first + times, poses, begin, last + HOLD)
        if predictions is not None:
            motion = predictions[i]
            at = _sample(motion.times)
            poses = np.column_stack([np.interp(at, motion.times, column) for column in motion.poses.T])
            _RecordPoses(meshcat, GHOST, first + at, poses, begin, last + HOLD)
        begin = last + HOLD
    meshcat.StopRecording()


def _AddObject(meshcat: Meshcat, target: Target, colors: CellColors, height: float) -> None:
    obj, params, model = target.obj, target.params, target.model
    drawn = np.tile(PLAIN_COLOR, (obj.n, 1)) if model is None else colors.calc_colors(params.mass, params.friction)
    AddCells(meshcat, f"{OBJECT}/cells", obj, drawn, height)
    if model is not None:
        covariance = model.identifiability.center_of_friction_covariance
        AddCenter(meshcat, f"{OBJECT}/center", params.center_of_mass(obj), covariance, height + LAYER, SIGMAS)


def _AddPush(meshcat: Meshcat, seen: ObservedPush, i: int, begin: float, height: float) -> None:
    """Draws a push's arrow and its finger, and moves the finger from `begin` + HOLD on."""
    path, push = f"{PUSHES}/{i}", seen.push
    if push.length > 0:
        AddArrow(meshcat, f"{path}/arrow", push.xy[0], push.xy[-1], height + 4 * LAYER)
    meshcat.SetObject(f"{path}/{FINGER}", Cylinder(push.radius, FINGER_SHARE * height), FINGER_COLOR)
    at = _sample(push.t)
    tips = np.column_stack([push.tip_at(at), np.zeros(len(at))])
    middle = FINGER_SHARE * height / 2
    end = begin + HOLD + push.duration + HOLD
    _RecordPoses(meshcat, f"{path}/{FINGER}", begin + HOLD + at, tips, begin, end, middle)
    ApplyTurn(meshcat, path, f"{PUSHES}/{i - 1}" if i else None, begin, 1 / FRAMES_PER_SECOND)


def _RecordPoses(
    meshcat: Meshcat, path: str, times: Array, poses: Array, begin: float, end: float, height: float = 0.0
) -> None:
    """Records planar poses (k, 3) at `times` (k,), s, the first held from `begin` on and the last until `end`."""
    still_held = end - 1 / FRAMES_PER_SECOND
    for time, pose in zip([begin, *times, still_held], [poses[0], *poses, poses[-1]], strict=True):
        meshcat.SetTransform(path, MakePlanarTransform(pose, height), float(time))


def _sample(times: Array) -> Array:
    """Times from the first to the last, a frame apart or, where there are fewer, those themselves."""
    count = int(np.ceil((times[-1] - times[0]) * FRAMES_PER_SECOND)) + 1
    return times if len(times) <= count else np.linspace(times[0], times[-1], count)


def _calc_extent(obj: GridObject, log: PushLog) -> Array:
    """(2, 2) least and greatest x, y, m, of all observed cells and of the finger's ways."""
    poses = np.concatenate([np.vstack([seen.pose, seen.poses_observed]) for seen in log])
    points = np.concatenate([obj.cells_at(poses).reshape(-1, 2), *(seen.push.xy for seen in log)])
    return np.array([points.min(axis=0), points.max(axis=0)])


def _FrameScene(meshcat: Meshcat, extent: ArrayLike) -> None:
    """Puts a table below (2, 2) `extent`, least and greatest x, y, m, and points the camera at it."""
    low, high = np.asarray(extent, dtype=np.float64)
    middle, size = (low + high) / 2, high - low
    width, depth = size + 2 * TABLE_MARGIN
    meshcat.SetObject(TABLE, Box(width, depth, TABLE_THICKNESS), TABLE_COLOR)
    meshcat.SetTransform(TABLE, MakePlanarTransform([*middle, 0.0], -TABLE_THICKNESS / 2 - LAYER))
    AimCamera(meshcat, [*middle, 0.0], VIEW_SHARE * float(np.hypot(*size)))
