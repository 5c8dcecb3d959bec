"""Several objects in view that push each other, for `gridpush bench perception`.

Shipped objects lie in a row, apart or touching. A rod pushes the first of them through the others,
as `simulate` says, and the tracker follows all of their outlines with the arm in view.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from gridpush_drake.bench.perception.rendered_table import (
    OBJECT_COLORS,
    OBJECT_HEIGHT,
    RenderedObject,
    RenderedTable,
    load_object,
    make_overhead_camera,
)
from gridpush_drake.dynamics.bodies import Bodies
from gridpush_drake.dynamics.motion import Motion, MotionStatus
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import PushError
from gridpush_drake.geometry.se2 import Array, transform_shape, wrap_angle
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.perception import Frame, TrackedPose
from gridpush_drake.perception.tracking.multi_object_tracking import KnownObject, SceneTracker
from gridpush_drake.report.table import ALL_RESULTS, Table, Value
from gridpush_drake.units import MM_PER_M

PICTURED_OBJECTS = (
    "claw_hammer",
    "combination_wrench",
    "pliers",
    "spray_bottle",
    "spring_clamp",
    "toothpaste_tube",
)
"""Shipped objects of which up to four are in one picture; the other ones are too large for that."""

OBJECT_COUNTS = (2, 3, 4)
"""Numbers of objects in view."""

CAMERA_HEIGHT = 0.75
"""Height of the camera over the table, m."""

ROD_RADIUS = 0.006
"""Radius of the rod that pushes, m."""

PUSH_LENGTH = 0.12
"""Length of a push, m."""

ROD_SPEED = 0.05
"""Speed of the rod, m/s."""

FRAME_COUNT = 11
"""Number of frames of a push."""

GAP_RANGE = (0.01, 0.03)
"""Range of the gaps between objects that lie apart, m."""

MAX_TOUCHING_GAP = 2e-4
"""Greatest gap between objects that touch, m."""

MAX_ROW_OFFSET = 0.02
"""Greatest distance of an object's middle from the line that they lie along, m."""

MAX_ROW_ANGLE = 0.5
"""Greatest angle between an object's shorter side and the line, rad."""

PICTURE_MARGIN = 0.02
"""Room that every object keeps from the border of what the camera sees, m."""

MIN_MOTION = 0.005
"""Least way of an object's middle that makes a push one of it, m."""

MAX_ROW_TRIES = 60
"""Most rows that are tried for a push that moves two objects and more, and stays in view."""

LOST_PLACE = 0.01
"""A place that is off by more than this is that of another object, m."""

LOST_ANGLE = np.radians(20)
"""An angle that is off by more than this is a wrong one, rad."""


@dataclass(frozen=True)
class MultiObjectJob:
    """Some pushes of several objects through each other.

    Attributes:
        count: number of objects in view.
        touching: whether they touch at the beginning.
        pushes: number of pushes, each of other objects.
        seed: seed of everything random.
    """

    count: int
    touching: bool
    pushes: int
    seed: int


@dataclass(frozen=True)
class MultiObjectScore:
    """What was tracked of several objects.

    Attributes:
        count: number of objects in view.
        touching: whether they touched at the beginning.
        pushes: number of pushes.
        frames: number of frames times objects.
        unseen: number of these in which the tracker says that the object was not seen.
        wrong: number of these in which the pose is that of another object, or of none.
        errors: errors of x, y (m) and theta (rad) of each of the others.
        deviations: standard deviations of x, y (m) and theta (rad) that the tracker states there.
    """

    count: int
    touching: bool
    pushes: int
    frames: int
    unseen: int
    wrong: int
    errors: list[tuple[float, float, float]]
    deviations: list[tuple[float, float, float]]


def run_multi_object(job: MultiObjectJob) -> MultiObjectScore:
    """Pushes objects through each other, and tracks all of their outlines."""
    unseen = 0
    wrong = 0
    frames = 0
    errors: list[tuple[float, float, float]] = []
    deviations: list[tuple[float, float, float]] = []
    for k in range(job.pushes):
        seed = job.seed + k
        objects, motion = draw_motion(job.count, job.touching, seed)
        for poses, tracked in track_motion(objects, motion, seed):
            for true, found in zip(poses, tracked, strict=True):
                frames += 1
                if not found.seen:
                    unseen += 1
                    continue
                off = found.pose - true
                off[2] = wrap_angle(off[2])
                if np.hypot(*off[:2]) > LOST_PLACE or abs(off[2]) > LOST_ANGLE:
                    wrong += 1
                    continue
                deviation = np.sqrt(np.diag(found.covariance))
                errors.append(_to_row(off))
                deviations.append(_to_row(deviation))
    return MultiObjectScore(
        count=job.count,
        touching=job.touching,
        pushes=job.pushes,
        frames=frames,
        unseen=unseen,
        wrong=wrong,
        errors=errors,
        deviations=deviations,
    )


def draw_motion(count: int, touching: bool, seed: int) -> tuple[list[GridObject], Motion]:
    """Draws objects in a row, and pushes the first one through the others.

    Args:
        count: number of objects.
        touching: whether they touch at the beginning.
        seed: seed of everything random.

    Returns:
        The objects, and their motion; at least two objects move.

    Raises:
        PushError: none of the rows that were drawn does.
    """
    rng = np.random.default_rng((seed, count, int(touching)))
    for _ in range(MAX_ROW_TRIES):
        names = rng.permutation(PICTURED_OBJECTS)[:count]
        objects = [load_object(str(name)) for name in names]
        poses = _make_row(objects, touching, rng)
        push = _draw_push(objects[0], poses[0], rng)
        motion = simulate(Bodies(objects), push, poses)
        ways = np.linalg.norm(motion.poses[-1, :, :2] - motion.poses[0, :, :2], axis=1)
        if (
            motion.status == MotionStatus.OK
            and (ways > MIN_MOTION).sum() >= 2
            and _stays_in_view(objects, motion)
        ):
            return objects, motion
    raise PushError(
        f"none of {MAX_ROW_TRIES} random rows of {count} objects moves two of them in view"
    )


def track_motion(
    objects: Sequence[GridObject], motion: Motion, seed: int
) -> list[tuple[Array, tuple[TrackedPose, ...]]]:
    """Renders some frames of a motion, and tracks all objects in them.

    Args:
        objects: the objects.
        motion: their motion.
        seed: seed of the pictures' noise.

    Returns:
        For each frame the true poses (N, 3), W, m and rad, and what was tracked of each object.
    """
    camera = make_overhead_camera(CAMERA_HEIGHT)
    prisms = [
        RenderedObject(obj.outline, OBJECT_HEIGHT, OBJECT_COLORS[i % len(OBJECT_COLORS)])
        for i, obj in enumerate(objects)
    ]
    first = prisms[0]
    table = RenderedTable(
        outline=first.outline,
        height=first.height,
        color=first.color,
        camera=camera,
        rod_radius=ROD_RADIUS,
        others=prisms[1:],
    )
    tracker = SceneTracker(
        [KnownObject(obj.outline, OBJECT_HEIGHT, obj.name) for obj in objects], camera
    )

    def look(i: int, arm: bool) -> tuple[Frame, NDArray[np.bool_]]:
        poses = motion.poses[i]
        return table.look(
            poses[0],
            motion.tip[i] if arm else None,
            seed=FRAME_COUNT * seed + i,
            t=float(motion.times[i]),
            others=list(poses[1:]),
        )

    state = tracker.start(look(0, arm=False)[0], list(motion.poses[0]))
    found = []
    for i in np.linspace(0, len(motion.times) - 1, FRAME_COUNT).astype(int):
        frame, hidden = look(int(i), arm=True)
        state, tracked = tracker.track(state, frame, hidden)
        found.append((motion.poses[i], tracked))
    return found


def tabulate_multi_object(scores: Sequence[MultiObjectScore]) -> Table:
    """Makes a row for each number of objects, apart and touching, and one of all."""

    def make_row(name: str, touching: str, some: Sequence[MultiObjectScore]) -> tuple[Value, ...]:
        error = np.concatenate([np.reshape(score.errors, (-1, 3)) for score in some])
        std = np.concatenate([np.reshape(score.deviations, (-1, 3)) for score in some])
        place = float("nan")
        angle = float("nan")
        within = float("nan")
        if len(error):
            place = MM_PER_M * float(np.sqrt((error[:, :2] ** 2).sum(axis=1).mean()))
            angle = float(np.degrees(np.sqrt((error[:, 2] ** 2).mean())))
            within = 100 * float((np.abs(error) <= 1.96 * std).mean())
        return (
            name,
            touching,
            sum(score.pushes for score in some),
            sum(score.frames for score in some),
            sum(score.unseen for score in some),
            sum(score.wrong for score in some),
            place,
            angle,
            within,
        )

    rows = [
        make_row(str(score.count), "touching" if score.touching else "apart", [score])
        for score in scores
    ]
    rows.append(make_row(ALL_RESULTS, "", scores))
    columns = (
        "objects",
        "at first",
        "pushes",
        "poses",
        "not seen",
        "wrong",
        "place, RMS, mm",
        "angle, RMS, deg",
        "within 95 %, %",
    )
    notes = [
        f"Shipped objects in a row, of which the first is pushed by {100 * PUSH_LENGTH:g} cm "
        "through the"
        f" others, {FRAME_COUNT} frames each, with the arm in view.",
        "wrong: the pose told is off by more than 10 mm or 20 degrees, as if objects were swapped.",
    ]
    return Table("Poses of several objects that push each other", columns, rows, notes)


def _make_row(objects: Sequence[GridObject], touching: bool, rng: np.random.Generator) -> Array:
    """Lays objects in a row along x, each with its shorter side about along it.

    Returns:
        (N, 3) their poses, m and rad.
    """
    poses = []
    before: shapely.Geometry | None = None
    for obj in objects:
        box = np.array(obj.outline.minimum_rotated_rectangle.exterior.coords)
        sides = np.diff(box[:3], axis=0)
        long = sides[np.argmax(np.linalg.norm(sides, axis=1))]
        theta = np.pi / 2 - np.arctan2(long[1], long[0]) + np.pi * rng.integers(2)
        theta += rng.uniform(-MAX_ROW_ANGLE, MAX_ROW_ANGLE)
        shape = transform_shape(np.array([0.0, 0.0, theta]), obj.outline)
        y = rng.uniform(-MAX_ROW_OFFSET, MAX_ROW_OFFSET) - shape.centroid.y
        gap = MAX_TOUCHING_GAP if touching else rng.uniform(*GAP_RANGE)
        x = 0.0
        if before is not None:
            x = _slide(before, transform_shape([0.0, y, 0.0], shape), gap)
        pose = np.array([x, y, theta])
        placed = transform_shape(pose, obj.outline)
        before = placed if before is None else shapely.union(before, placed)
        poses.append(pose)

    # The row's middle, with room for the push, lies in the picture's middle.
    assert before is not None
    left, _, right, _ = before.bounds
    shift = np.array([-(left + right + PUSH_LENGTH) / 2, 0.0, 0.0])
    return np.array(poses) + shift


def _slide(before: shapely.Geometry, shape: shapely.Geometry, gap: float) -> float:
    """Finds how far to the right a shape lies clear of those before it by a gap, m."""
    low = before.bounds[0] - shape.bounds[2]
    high = before.bounds[2] - shape.bounds[0] + gap
    # From the right the shape comes nearer until the gap is reached; bisection finds where, as far
    # as the distance falls steadily.
    step = 0.005
    x = high
    while x > low:
        if before.distance(transform_shape([x - step, 0.0, 0.0], shape)) < gap:
            break
        x -= step
    inside = x - step
    while x - inside > 1e-6:
        middle = (x + inside) / 2
        if before.distance(transform_shape([middle, 0.0, 0.0], shape)) < gap:
            inside = middle
        else:
            x = middle
    return x


def _draw_push(obj: GridObject, pose: Array, rng: np.random.Generator) -> Push:
    """Draws a push along the row, which begins to the left of the first object."""
    first = transform_shape(pose, obj.outline)
    left, low, _, high = first.bounds
    y = rng.uniform(0.7 * low + 0.3 * high, 0.3 * low + 0.7 * high)
    angle = rng.uniform(-0.2, 0.2)
    start = [left - ROD_RADIUS - 0.002, y]
    velocity = ROD_SPEED * np.array([np.cos(angle), np.sin(angle)])
    return Push(start, velocity, (PUSH_LENGTH + 0.002) / ROD_SPEED, ROD_RADIUS)


def _stays_in_view(objects: Sequence[GridObject], motion: Motion) -> bool:
    """Says whether the camera sees all of the objects at the beginning and at the end."""
    camera = make_overhead_camera(CAMERA_HEIGHT)
    low = camera.cast([0, camera.height - 1], OBJECT_HEIGHT) + PICTURE_MARGIN
    high = camera.cast([camera.width - 1, 0], OBJECT_HEIGHT) - PICTURE_MARGIN
    view = shapely.box(*low, *high)
    return all(
        view.contains(transform_shape(pose, obj.outline))
        for poses in (motion.poses[0], motion.poses[-1])
        for pose, obj in zip(poses, objects, strict=True)
    )


def _to_row(values: Array) -> tuple[float, float, float]:
    x, y, theta = map(float, values)
    return x, y, theta
