"""What `gridpush view` puts into Meshcat: a model, or pushes to be replayed with their predictions."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from pydrake.geometry import Box, Cylinder, Meshcat, Rgba

from gridpush_drake.cli.console import MM
from gridpush_drake.cli.options import Target
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
    LAYER,
    PLAN_COLOR,
    AddArrow,
    AddCells,
    AddCenter,
    AddGhost,
    MakePlanarTransform,
    SwapVisible,
)
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.prediction import Prediction
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.pushes.push_log import ObservedPush, PushLog

OBJECT, GHOST, FINGER, PUSHES, TABLE = "object", "predicted", "finger", "pushes", "table"
"""Paths in Meshcat."""

TABLE_COLOR, FINGER_COLOR = Rgba(0.86, 0.84, 0.80), Rgba(0.25, 0.27, 0.30)
PLAIN_COLOR = (0.62, 0.66, 0.70)
"""Cells of which nothing is known, sRGB."""

TABLE_MARGIN, TABLE_THICKNESS = 0.05, 0.01
"""About what stands on the table, and of the table, m."""

VIEW_SHARE, FINGER_SHARE = 0.65, 2.0
"""Distance of the camera, in diagonals of what is to be seen, and height of the finger, in heights
of the object."""

FRAMES_PER_SECOND, HOLD = 30.0, 0.8
"""Of a replay, and s for which a push's first and last poses are held."""


def describe_colors(shows: Shown) -> str:
    """What the colors mean, in a sentence."""
    low, high = CellColors(shows).resolve_limits()
    if shows == "friction":
        return f"Colors: the cells' friction coefficient, from {low:g} (dark) to {high:g} (bright)."
    what = "mass" if shows == "mass" else "share of the friction"
    return (
        f"Colors: the cells' {what}, from {low:g} (dark) to {high:g} times (bright) the even share."
    )


def AddModel(meshcat: Meshcat, target: Target, shows: Shown, height: float) -> None:
    """Draws a model at rest in its body frame: its cells in their colors, the center of mass and its ellipse."""
    _AddObject(meshcat, target, CellColors(shows), height)
    _FrameScene(meshcat, np.array(target.obj.outline.bounds).reshape(2, 2))


def make_overlay(
    target: Target,
    shows: Shown,
    log: PushLog | None = None,
    predictions: Sequence[Prediction] | None = None,
) -> Overlay:
    """What stands beside the page of a model, or of the pushes that `AddPushes` records."""
    scale = make_color_scale(target.obj, CellColors(shows)) if target.model is not None else None
    marks = list_center_marks() if target.model is not None else ()
    if log is not None:
        marks += (Mark(to_css(PLAN_COLOR), "the finger's push", "line"),)
    if predictions is not None:
        marks += (
            Mark(to_css(PLAN_COLOR), "the object as the model predicts it; solid: as observed"),
        )
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

    Between two observations the object is drawn on the straight line from one to the other. The
    recording is begun here and left for the caller to publish.
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
            poses = np.column_stack(
                [np.interp(at, motion.times, column) for column in motion.poses.T]
            )
            _RecordPoses(meshcat, GHOST, first + at, poses, begin, last + HOLD)
        begin = last + HOLD
    meshcat.StopRecording()


def _AddObject(meshcat: Meshcat, target: Target, colors: CellColors, height: float) -> None:
    obj, params, model = target.obj, target.params, target.model
    drawn = (
        np.tile(PLAIN_COLOR, (obj.n, 1))
        if model is None
        else colors.calc_colors(params.mass, params.friction)
    )
    AddCells(meshcat, f"{OBJECT}/cells", obj, drawn, height)
    if model is not None:
        covariance = model.identifiability.center_of_friction_covariance
        AddCenter(
            meshcat, f"{OBJECT}/center", params.center_of_mass(obj), covariance, height + LAYER
        )


def _AddPush(meshcat: Meshcat, seen: ObservedPush, i: int, begin: float, height: float) -> None:
    """Draws a push's arrow and its finger, and moves the finger from `begin` + HOLD on."""
    path, push = f"{PUSHES}/{i}", seen.push
    if push.length > 0:
        AddArrow(meshcat, f"{path}/arrow", push.xy[0], push.xy[-1], height + 4 * LAYER)
    meshcat.SetObject(
        f"{path}/{FINGER}", Cylinder(push.radius, FINGER_SHARE * height), FINGER_COLOR
    )
    at = _sample(push.t)
    tips = np.column_stack([push.tip_at(at), np.zeros(len(at))])
    middle = FINGER_SHARE * height / 2
    end = begin + HOLD + push.duration + HOLD
    _RecordPoses(meshcat, f"{path}/{FINGER}", begin + HOLD + at, tips, begin, end, middle)
    SwapVisible(meshcat, path, f"{PUSHES}/{i - 1}" if i else None, begin, 1 / FRAMES_PER_SECOND)


def _RecordPoses(
    meshcat: Meshcat,
    path: str,
    times: Array,
    poses: Array,
    begin: float,
    end: float,
    height: float = 0.0,
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
    """(2, 2) min and max x, y, m, of all observed cells and of the finger's paths."""
    poses = np.concatenate([np.vstack([seen.pose, seen.poses_observed]) for seen in log])
    points = np.concatenate([obj.cells_at(poses).reshape(-1, 2), *(seen.push.xy for seen in log)])
    return np.array([points.min(axis=0), points.max(axis=0)])


def _FrameScene(meshcat: Meshcat, extent: ArrayLike) -> None:
    """Puts a table below (2, 2) `extent`, min and max x, y, m, and points the camera at it."""
    low, high = np.asarray(extent, dtype=np.float64)
    middle, size = (low + high) / 2, high - low
    width, depth = size + 2 * TABLE_MARGIN
    meshcat.SetObject(TABLE, Box(width, depth, TABLE_THICKNESS), TABLE_COLOR)
    meshcat.SetTransform(TABLE, MakePlanarTransform([*middle, 0.0], -TABLE_THICKNESS / 2 - LAYER))
    AimCamera(meshcat, [*middle, 0.0], VIEW_SHARE * float(np.hypot(*size)))
