"""What `gridpush view` shows: a learned model, or pushes replayed beside their predictions."""

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike
from pydrake.geometry import Box, Meshcat, Rgba

from gridpush_drake.cli.shell.options import Target
from gridpush_drake.display.cell_colors import CellColors, Shown
from gridpush_drake.display.overlay import (
    Mark,
    Overlay,
    Phase,
    list_center_marks,
    make_color_scale,
    to_css,
)
from gridpush_drake.display.server import AimCamera
from gridpush_drake.display.shapes import (
    LAYER_DISTANCE,
    PLAN_COLOR,
    AddArrow,
    AddCells,
    AddCenter,
    AddGhost,
    AddPrism,
    MakePlanarTransform,
    SwapVisible,
)
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.pusher import PusherShape
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.prediction import Prediction
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.pushes.push_log import ObservedPush, PushLog
from gridpush_drake.units import MM_PER_M

OBJECT_PATH = "object"
"""Path of the object in Meshcat; below it each of several has its number."""

PREDICTED_PATH = "predicted"
"""Path in Meshcat of the object as the model predicts it, likewise."""

FINGER_PATH = "finger"
"""Path of the finger in Meshcat, below the path of its push."""

PUSHES_PATH = "pushes"
"""Path in Meshcat below which each push has its number."""

TABLE_PATH = "table"
"""Path of the table in Meshcat."""

TABLE_COLOR = Rgba(0.86, 0.84, 0.80)
"""Color of the table."""

FINGER_COLOR = Rgba(0.25, 0.27, 0.30)
"""Color of the finger."""

PLAIN_COLOR = (0.62, 0.66, 0.70)
"""Color of cells of which nothing is known, sRGB."""

TABLE_MARGIN = 0.05
"""How far the table reaches beyond everything that is shown on it, m."""

TABLE_THICKNESS = 0.01
"""Thickness of the table that is drawn, m."""

VIEW_FRACTION = 0.65
"""Distance of the camera from the middle, as a fraction of the diagonal of what is shown."""

FINGER_FRACTION = 2.0
"""Height of the finger that is drawn, as a multiple of the object's height."""

FRAMES_PER_SECOND = 30.0
"""How many poses a second are drawn in a replay."""

OVERHANG_CAPTION = "; a part of the object hangs over the table's edge"
"""What is added to a push's caption if the object hung over the edge."""

END_POSE_TIME = 0.8
"""How long the first and the last pose of a push are held in a replay, s."""


def describe_colors(shows: Shown) -> str:
    """Returns a sentence that says what the colors of the cells mean."""
    low, high = CellColors(shows).resolve_limits()
    if shows == "friction":
        return f"Colors: the cells' friction coefficient, from {low:g} (dark) to {high:g} (bright)."
    what = "mass" if shows == "mass" else "fraction of the friction"
    return (
        f"Colors: the cells' {what}, from {low:g} (dark) to {high:g} times (bright) the even "
        "fraction."
    )


def AddModel(meshcat: Meshcat, target: Target, shows: Shown, height: float) -> None:
    """Draws a model at rest in its body frame.

    Of a learned model the cells have colors, and the center of mass is marked with the ellipse that
    shows how sure it is.

    Args:
        meshcat: where to draw it.
        target: the model, or an object of which nothing was learned.
        shows: what the colors of the cells stand for.
        height: height of the object, m.
    """
    _AddObject(meshcat, OBJECT_PATH, target, CellColors(shows), height)
    FrameScene(meshcat, np.array(target.obj.outline.bounds).reshape(2, 2))


def make_overlay(
    targets: Sequence[Target],
    shows: Shown,
    log: PushLog | None = None,
    predictions: Sequence[Prediction] | None = None,
) -> Overlay:
    """Makes the legend and the captions of a page that shows a model or a replay of pushes.

    Args:
        targets: the models or objects that are shown.
        shows: what the colors of the cells stand for.
        log: the pushes that `AddPushes` records; None if no pushes are shown.
        predictions: the predictions that are shown beside the pushes; None if there are none.
    """
    learned = [target.obj for target in targets if target.model is not None]
    scale = make_color_scale(learned, CellColors(shows)) if learned else None
    marks = list_center_marks() if learned else ()
    if log is not None:
        marks += (Mark(to_css(PLAN_COLOR), "the finger's push", "line"),)
    if predictions is not None:
        what = "the object" if len(targets) == 1 else "the objects"
        marks += (Mark(to_css(PLAN_COLOR), f"{what} as the model predicts; solid: as observed"),)
    phases = list_push_phases(
        (seen.name, seen.push, OVERHANG_CAPTION if seen.overhang else "") for seen in log or ()
    )
    return Overlay(scale, marks, phases)


def list_push_phases(pushes: Iterable[tuple[str, Push, str]]) -> tuple[Phase, ...]:
    """Lists the captions of pushes that are shown one after the other.

    Args:
        pushes: name of each push, the push, and what else its caption says.
    """
    phases = []
    begin = 0.0
    for name, push, more in pushes:
        detail = f"{MM_PER_M * push.length:.0f} mm in {push.duration:.1f} s"
        phases.append(Phase(begin, name, detail + more))
        begin += END_POSE_TIME + push.duration + END_POSE_TIME
    return tuple(phases)


def AddPushes(
    meshcat: Meshcat,
    targets: Sequence[Target],
    log: PushLog,
    predictions: Sequence[Prediction] | None,
    shows: Shown,
    height: float,
) -> None:
    """Records a replay of pushes, one after the other.

    Shown are the objects as they were observed, the finger, and as ghosts the objects as they are
    predicted. Between two observations an object is drawn on the straight line from one to the
    other. The caller has to publish the recording.

    Args:
        meshcat: where to draw it.
        targets: the models or objects that were pushed, in the order of the log's.
        log: the pushes.
        predictions: the predicted motion of each push, in the order of the log; None for no ghost.
        shows: what the colors of the cells stand for.
        height: height of the objects, m.
    """
    one = len(targets) == 1
    paths = (
        [("", target) for target in targets]
        if one
        else [(f"/{b}", target) for b, target in enumerate(targets)]
    )
    for number, target in paths:
        _AddObject(meshcat, OBJECT_PATH + number, target, CellColors(shows), height)
        if predictions is not None:
            AddGhost(meshcat, PREDICTED_PATH + number, target.obj, height)
    FrameScene(meshcat, _calc_extent([target.obj for target in targets], log))
    meshcat.StartRecording(FRAMES_PER_SECOND)
    begin = 0.0
    for i, seen in enumerate(log):
        AddPusher(meshcat, seen.push, i, begin, height)
        first = begin + END_POSE_TIME
        last = first + seen.push.duration
        times = np.append(0.0, seen.t_observed)
        observed = list_poses(seen)
        for b, (number, _) in enumerate(paths):
            path = OBJECT_PATH + number
            RecordPoses(
                meshcat, path, first + times, observed[:, b], begin=begin, end=last + END_POSE_TIME
            )
            if predictions is None:
                continue
            motion = predictions[i]
            at = sample_times(motion.times)
            predicted = motion.poses.reshape(len(motion.times), -1, 3)[:, b]
            poses = np.column_stack([np.interp(at, motion.times, column) for column in predicted.T])
            path = PREDICTED_PATH + number
            RecordPoses(meshcat, path, first + at, poses, begin=begin, end=last + END_POSE_TIME)
        begin = last + END_POSE_TIME
    meshcat.StopRecording()


def list_poses(seen: ObservedPush) -> Array:
    """Lists all poses (K+1, N, 3) that were seen of the N objects of a push, m and rad."""
    return np.concatenate([seen.pose[None], seen.poses_observed]).reshape(
        len(seen.t_observed) + 1, -1, 3
    )


def _AddObject(
    meshcat: Meshcat, path: str, target: Target, colors: CellColors, height: float
) -> None:
    """Draws the cells of an object, and the center of mass of a learned model."""
    obj = target.obj
    params = target.params
    model = target.model
    drawn = (
        np.tile(PLAIN_COLOR, (obj.n, 1))
        if model is None
        else colors.calc_colors(params.mass, params.friction)
    )
    AddCells(meshcat, f"{path}/cells", obj, drawn, height)
    if model is not None:
        covariance = model.identifiability.center_of_friction_covariance
        AddCenter(
            meshcat,
            f"{path}/center",
            params.center_of_mass(obj),
            covariance,
            height + LAYER_DISTANCE,
        )


def AddPusher(meshcat: Meshcat, push: Push, i: int, begin: float, height: float) -> None:
    """Draws a push's arrow and its finger, and records how the finger moves.

    Args:
        meshcat: where to draw it.
        push: the push.
        i: number of the push in the log, from 0.
        begin: when the push is shown first, s. The finger starts to move END_POSE_TIME later.
        height: height of the object, m.
    """
    path = f"{PUSHES_PATH}/{i}"
    if push.length > 0:
        AddArrow(meshcat, f"{path}/arrow", push.xy[0], push.xy[-1], height + 4 * LAYER_DISTANCE)
    shape = push.shape or PusherShape.disc(push.radius)
    AddPrism(meshcat, f"{path}/{FINGER_PATH}", shape.area, FINGER_FRACTION * height, FINGER_COLOR)
    at = sample_times(push.t)
    tips = np.column_stack([push.tip_at(at), push.yaw_at(at)])
    end = begin + END_POSE_TIME + push.duration + END_POSE_TIME
    RecordPoses(
        meshcat,
        f"{path}/{FINGER_PATH}",
        begin + END_POSE_TIME + at,
        tips,
        begin=begin,
        end=end,
    )
    SwapVisible(
        meshcat, path, f"{PUSHES_PATH}/{i - 1}" if i else None, begin, 1 / FRAMES_PER_SECOND
    )


def RecordPoses(
    meshcat: Meshcat,
    path: str,
    times: Array,
    poses: Array,
    begin: float,
    end: float,
) -> None:
    """Records how a path in Meshcat moves.

    Args:
        meshcat: where it is drawn.
        path: the path.
        times: times (k,) of the poses, s.
        poses: planar poses (k, 3), m and rad.
        begin: the first pose is held from this time on, s.
        end: the last pose is held until a frame before this time, s.
    """
    still_held = end - 1 / FRAMES_PER_SECOND
    for time, pose in zip([begin, *times, still_held], [poses[0], *poses, poses[-1]], strict=True):
        meshcat.SetTransform(path, MakePlanarTransform(pose), float(time))


def sample_times(times: Array) -> Array:
    """Returns the times at which a motion is recorded, one frame or more apart."""
    count = int(np.ceil((times[-1] - times[0]) * FRAMES_PER_SECOND)) + 1
    return times if len(times) <= count else np.linspace(times[0], times[-1], count)


def _calc_extent(objects: Sequence[GridObject], log: PushLog) -> Array:
    """Returns the smallest and largest x, y (2, 2) of observed cells and finger paths, m."""
    poses = np.concatenate([list_poses(seen) for seen in log])
    cells = [obj.cells_at(poses[:, b]).reshape(-1, 2) for b, obj in enumerate(objects)]
    points = np.concatenate([*cells, *(seen.push.xy for seen in log)])
    return np.array([points.min(axis=0), points.max(axis=0)])


def FrameScene(meshcat: Meshcat, extent: ArrayLike) -> None:
    """Draws a table below what is shown, and points the camera at it.

    Args:
        meshcat: where to draw it.
        extent: smallest and largest x, y (2, 2) of what is shown, m.
    """
    low, high = np.asarray(extent, dtype=np.float64)
    middle = (low + high) / 2
    size = high - low
    width, depth = size + 2 * TABLE_MARGIN
    meshcat.SetObject(TABLE_PATH, Box(width, depth, TABLE_THICKNESS), TABLE_COLOR)
    meshcat.SetTransform(
        TABLE_PATH, MakePlanarTransform([*middle, 0.0], -TABLE_THICKNESS / 2 - LAYER_DISTANCE)
    )
    AimCamera(meshcat, [*middle, 0.0], VIEW_FRACTION * float(np.hypot(*size)))
