"""How well shipped objects are followed while they are pushed, for `gridpush bench perception`.

They are rendered with the arm in view, see `rendered_table`, and followed by their outlines, or by
a tag on them. Several objects in one picture are in `several_objects`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.bench.perception.rendered_table import (
    FOCAL_LENGTH,
    OBJECT_COLORS,
    OBJECT_HEIGHT,
    RenderedTable,
    load_object,
    make_overhead_camera,
)
from gridpush_drake.bench.worlds.plant import draw_push
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import GridPushError
from gridpush_drake.geometry.se2 import compose, wrap_angle
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.perception import (
    Camera,
    DetectedTag,
    Frame,
    PoseTracker,
    TrackedPose,
    detect_tags,
    solve_tag_to_body,
)
from gridpush_drake.perception.tracking.tracking import NOT_SEEN
from gridpush_drake.report.table import ALL_RESULTS, Table, Value
from gridpush_drake.units import MM_PER_M, PERCENT_PER_ONE

CAMERA_HEIGHT = 0.75
"""Height of the camera over the table where pushes are tracked, m."""

ROD_RADIUS = 0.006
"""Radius of the rod that pushes, m."""

FRAME_COUNT = 11
"""Number of frames of a push."""

OBJECT_TAG = (7, 0.04)
"""Number of the tag on the objects, and its side, m."""

MAX_DEVIATION = np.array([3e-3, 3e-3, np.radians(3)])
"""Greatest stated standard deviations (3,) with which the outline still determines the pose, m and
rad."""

NORMAL_95 = 1.96
"""Number of standard deviations on both sides that hold 95 % of a normal distribution."""


@dataclass(frozen=True)
class TrackJob:
    """One object that is pushed several times, and followed by its outline.

    Attributes:
        name: name of the object.
        pushes: number of pushes.
        seed: seed of everything random.
    """

    name: str
    pushes: int
    seed: int


@dataclass(frozen=True)
class TagJob(TrackJob):
    """One object that is pushed several times, and followed by a tag on it."""


@dataclass(frozen=True)
class TrackScore:
    """What was tracked of one object.

    Attributes:
        name: name of the object.
        frames: number of frames.
        lost: number of frames in which it was not found.
        errors: errors of x, y (m) and theta (rad) in each frame that determines the pose.
        deviations: standard deviations of x, y (m) and theta (rad) that the tracker states in these
            frames; NaN of a tag, which states none.
    """

    name: str
    frames: int
    lost: int
    errors: list[tuple[float, float, float]]
    deviations: list[tuple[float, float, float]]


def run_track(job: TrackJob) -> TrackScore:
    """Pushes an object by the model, and tracks its outline with the arm in view."""
    return _track(job, _follow_outline, tag=None)


def run_tag(job: TagJob) -> TrackScore:
    """Pushes an object by the model, and tracks the tag on it with the arm in view."""
    return _track(job, _follow_tag, tag=OBJECT_TAG)


def _track(job: TrackJob, begin: "Begin", tag: tuple[int, float] | None) -> TrackScore:
    """Pushes an object by the model, and follows it; `begin` makes what follows it."""
    obj = load_object(job.name)
    params = CellParameters.uniform(obj)
    errors: list[NDArray[np.float64]] = []
    deviations: list[NDArray[np.float64]] = []
    frames = lost = 0
    for k in range(job.pushes):
        push, pose = draw_push(Model(obj, params), job.seed + k, ROD_RADIUS)
        motion = simulate(Model(obj, params), push, pose, regime="inertial")
        camera = make_overhead_camera(CAMERA_HEIGHT, at=motion.poses[:, :2].mean(axis=0))
        color = OBJECT_COLORS[k % len(OBJECT_COLORS)]
        table = RenderedTable(
            outline=obj.outline,
            height=OBJECT_HEIGHT,
            color=color,
            camera=camera,
            rod_radius=ROD_RADIUS,
            tag=tag,
        )
        follow = begin(obj, table.look(pose, seed=k)[0], pose, camera)
        for i in np.linspace(0, len(motion.times) - 1, FRAME_COUNT).astype(int):
            q = motion.poses[i]
            seed = FRAME_COUNT * k + int(i)
            frame, arm = table.look(q, motion.tip[i], seed=seed, t=float(motion.times[i]))
            tracked = follow(frame, arm)
            frames += 1
            lost += not tracked.seen
            deviation = np.sqrt(np.diag(tracked.covariance))
            if tracked.seen and not (deviation > MAX_DEVIATION).any():
                off = tracked.pose - q
                errors.append(np.array([*off[:2], wrap_angle(off[2])]))
                deviations.append(deviation)
    return TrackScore(
        name=job.name,
        frames=frames,
        lost=lost,
        errors=_to_rows(errors),
        deviations=_to_rows(deviations),
    )


Follow = Callable[[Frame, NDArray[np.bool_]], TrackedPose]
"""Function that finds the pose in the next frame; it takes the frame, and where the arm is in
it."""


Begin = Callable[[GridObject, Frame, NDArray[np.float64], Camera], Follow]
"""Function that makes a `Follow`; it takes the object, the first frame, the pose (3,) in it, m and
rad, and the camera."""


def _follow_outline(
    obj: GridObject, first: Frame, pose: NDArray[np.float64], camera: Camera
) -> Follow:
    """Makes what follows the object by its outline."""
    tracker = PoseTracker(obj.outline, OBJECT_HEIGHT, camera)
    state = tracker.start(first, pose)

    def follow(frame: Frame, arm: NDArray[np.bool_]) -> TrackedPose:
        nonlocal state
        state, tracked = tracker.track(state, frame, arm)
        return tracked

    return follow


def _follow_tag(obj: GridObject, first: Frame, pose: NDArray[np.float64], camera: Camera) -> Follow:
    """Makes what follows the object by its tag, whose place is solved from the first frame."""
    number, size = OBJECT_TAG

    def find(frame: Frame) -> DetectedTag | None:
        return detect_tags(frame.color, camera, size, OBJECT_HEIGHT).get(number)

    tag = find(first)
    if tag is None:
        raise GridPushError(f"the tag on {obj.name} is not found in its first picture")
    X_TB = solve_tag_to_body(tag, pose)

    def follow(frame: Frame, arm: NDArray[np.bool_]) -> TrackedPose:
        tag = find(frame)
        if tag is None:
            return NOT_SEEN
        return replace(NOT_SEEN, pose=compose(tag.planar_pose, X_TB), seen=True)

    return follow


def tabulate_tracks(scores: Sequence[TrackScore]) -> Table:
    """Makes a row for each object, and one of all."""

    def make_row(name: str, some: Sequence[TrackScore]) -> tuple[Value, ...]:
        frames, lost, place, angle = _summarize_track(some)
        error = _stack([score.errors for score in some])
        std = _stack([score.deviations for score in some])
        within = float("nan")
        if len(error):
            within = float((np.abs(error) <= NORMAL_95 * std).mean())
        unclear = frames - lost - len(error)
        return name, frames, lost, unclear, place, angle, PERCENT_PER_ONE * within

    rows = [make_row(score.name, [score]) for score in scores] + [make_row(ALL_RESULTS, scores)]
    columns = (
        "object",
        "frames",
        "lost",
        "not determined",
        "place, RMS, mm",
        "angle, RMS, deg",
        "within 95 %, %",
    )
    notes = [
        f"Pushes of 10 cm, {FRAME_COUNT} frames each, with the arm in view, rendered from "
        f"{CAMERA_HEIGHT} m: a "
        f"pixel is {CAMERA_HEIGHT / FOCAL_LENGTH * MM_PER_M:.1f} mm.",
        "not determined: the stated deviation is above 3 mm or 3 degrees. within 95 %: of x, y and "
        "angle, how many are within the stated 95 % interval.",
    ]
    return Table("Pose during pushes", columns, rows, notes)


def tabulate_tags(scores: Sequence[TrackScore]) -> Table:
    """Makes a row for each object, and one of all."""
    rows = [(score.name, *_summarize_track([score])) for score in scores]
    rows.append((ALL_RESULTS, *_summarize_track(scores)))
    columns = ("object", "frames", "hidden", "place, RMS, mm", "angle, RMS, deg")
    notes = [
        f"The same pushes, by a tag of {OBJECT_TAG[1] * MM_PER_M:g} mm on the object; hidden: the "
        "arm covers a "
        "part of it."
    ]
    return Table("Pose during pushes, by a tag", columns, rows, notes)


def _stack(rows: Sequence[Sequence[tuple[float, float, float]]]) -> NDArray[np.float64]:
    """Stacks the rows of several scores (K, 3)."""
    return np.concatenate([np.reshape(some, (-1, 3)) for some in rows])


def _summarize_track(scores: Sequence[TrackScore]) -> tuple[int, int, float, float]:
    """Calculates frames, those without the object, and RMS errors of place, mm, and angle, deg."""
    frames = sum(score.frames for score in scores)
    lost = sum(score.lost for score in scores)
    error = _stack([score.errors for score in scores])
    if not len(error):
        return frames, lost, float("nan"), float("nan")
    place = float(np.sqrt((error[:, :2] ** 2).sum(axis=1).mean()))
    angle = float(np.degrees(np.sqrt((error[:, 2] ** 2).mean())))
    return frames, lost, MM_PER_M * place, angle


def _to_rows(values: Sequence[NDArray[np.float64]]) -> list[Any]:
    return [tuple(map(float, row)) for row in values]
