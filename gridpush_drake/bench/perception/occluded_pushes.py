"""Hidden pushes of objects that look alike when they are turned, for `gridpush bench perception`.

The outlines are generated and are none of the shipped objects: wrenches with nearly equal ends, and
plates with a small corner cut off. All of an object is hidden while it is pushed. Its halves weigh
and rub differently; the model that says where the push takes it knows nothing of this.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import shapely
from shapely import Point, Polygon

from gridpush_drake.bench.perception.rendered_table import RenderedTable, make_overhead_camera
from gridpush_drake.bench.worlds.plant import draw_push
from gridpush_drake.dynamics.motion import Motion
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.geometry.se2 import Array, transform, wrap_angle
from gridpush_drake.identification.model import Model
from gridpush_drake.multibody.ground_truth import sample_ground_truth
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.perception import Camera, Frame, PoseTracker
from gridpush_drake.perception.images.frames import Mask
from gridpush_drake.perception.tracking.pose_prediction import make_expectation
from gridpush_drake.perception.tracking.symmetries import ExpectedPose
from gridpush_drake.report.table import ALL_RESULTS, Table

OCCLUDED_OUTLINE_KINDS = ("wrench", "plate", "square")
"""Kinds of outlines that are generated."""

MAX_CELLS = 40
"""Number of cells of an object; its motion under a push need not be exact."""

OBJECT_HEIGHT = 0.02
"""Height of the objects, m."""

OBJECT_COLOR = (0.60, 0.35, 0.20)
"""Color of the objects: red, green and blue, 0 to 1."""

CAMERA_HEIGHT = 0.75
"""Height of the camera over the table, m."""

ROD_RADIUS = 0.006
"""Radius of the rod that pushes, m."""

OCCLUDED_FRAMES = 5
"""Number of frames in which the object is hidden, evenly over the push."""

SEEN_FRAMES = 3
"""Number of frames after the push in which it is seen."""

COVER_MARGIN = 0.02
"""What hides the object reaches further than the object by this, m."""

COVER_DEPTH = 0.6
"""Depth of what hides the object, m."""

TIME_MARGIN = 1e-9
"""A time of the motion that is later by less than this is the one that is asked for, s."""

COVER_BRIGHTNESS = 40
"""Color of what hides the object, of 255."""

FLIPPED_ANGLE = np.radians(30)
"""An angle that is off by more than this is that of another answer, rad."""

LOST_DISTANCE = 0.02
"""A place that is off by more than this is that of another answer, m."""


@dataclass(frozen=True)
class OcclusionJob:
    """Some pushes of generated outlines of one kind.

    Attributes:
        kind: one of OCCLUDED_OUTLINE_KINDS.
        pushes: number of pushes, each of another outline.
        seed: seed of everything random.
        model: whether the tracker is told where a model says that the push takes the object.
    """

    kind: str
    pushes: int
    seed: int
    model: bool


@dataclass(frozen=True)
class OcclusionScore:
    """What was found after hidden pushes.

    Attributes:
        kind: one of OCCLUDED_OUTLINE_KINDS.
        model: whether a model said where the object would be.
        pushes: number of pushes.
        flipped: number of pushes after which another answer was told than the right one.
        doubted: number of pushes after which the tracker itself says that it does not know.
        unseen: number of pushes after which nothing was told.
    """

    kind: str
    model: bool
    pushes: int
    flipped: int
    doubted: int
    unseen: int


def make_symmetric(kind: str, rng: np.random.Generator) -> Polygon:
    """Makes an outline that looks nearly the same when it is turned.

    Args:
        kind: one of OCCLUDED_OUTLINE_KINDS: by half a turn, or by a quarter.
        rng: generator of its sizes.

    Returns:
        The outline, m, about its middle.
    """
    if kind == "wrench":
        # A handle with two heads, of which one is larger by up to 4 %, each with a jaw or a hole.
        length = rng.uniform(0.12, 0.20)
        radius = rng.uniform(0.014, 0.020)
        handle = shapely.box(-length / 2, -0.35 * radius, length / 2, 0.35 * radius)
        heads = []
        for side, size in ((-1, radius), (1, radius * rng.uniform(1.0, 1.04))):
            head = Point(side * length / 2, 0).buffer(size)
            heads.append(head - Point(side * (length / 2 + 0.2 * size), 0).buffer(0.5 * size))
        outline = shapely.union_all([handle, *heads])
        holes = [
            Point(side * (length / 2 + 0.2 * radius), 0).buffer(0.5 * radius) for side in (-1, 1)
        ]
        return Polygon(shapely.difference(outline, shapely.union_all(holes)).exterior)
    width = rng.uniform(0.08, 0.14)
    depth = width if kind == "square" else width * rng.uniform(0.5, 0.8)
    cut = rng.uniform(0.0, 0.006)
    corner = np.array([width / 2, depth / 2])
    plate = shapely.box(*-corner, *corner)
    wedge = Polygon([corner + (cut + 1e-4, 0), corner - (cut, 0), corner - (0, cut)])
    return Polygon(plate.difference(wedge).exterior)


def run_occlusion(job: OcclusionJob) -> OcclusionScore:
    """Pushes objects that are hidden meanwhile, and finds them afterwards."""
    flipped = 0
    doubted = 0
    unseen = 0
    for k in range(job.pushes):
        seed = job.seed + k
        errors, deviation = push_occluded(job.kind, seed, job.model)
        if errors is None:
            unseen += 1
        elif deviation > FLIPPED_ANGLE / 2:
            doubted += 1
        elif np.hypot(*errors[:2]) > LOST_DISTANCE or abs(errors[2]) > FLIPPED_ANGLE:
            flipped += 1
    return OcclusionScore(
        kind=job.kind,
        model=job.model,
        pushes=job.pushes,
        flipped=flipped,
        doubted=doubted,
        unseen=unseen,
    )


def push_occluded(kind: str, seed: int, use_model: bool) -> tuple[Array | None, float]:
    """Pushes one object that is hidden meanwhile.

    Args:
        kind: one of OCCLUDED_OUTLINE_KINDS.
        seed: seed of everything random.
        use_model: whether the tracker is told where the model says that the push takes it.

    Returns:
        (3,) error of the last pose told, of the outline's middle, m, and angle, rad; None where
        none was told. And the standard deviation of the angle that is stated, rad.
    """
    rng = np.random.default_rng((seed, OCCLUDED_OUTLINE_KINDS.index(kind)))
    outline = make_symmetric(kind, rng)
    x_middle = outline.centroid.x
    right = outline.intersection(shapely.box(x_middle, -1, 1, 1))
    obj = GridObject.from_outline(outline, parts={2: right}, max_cells=MAX_CELLS, name=kind)
    truth = sample_ground_truth(obj, seed)
    believed = CellParameters.uniform(obj)
    push, start = draw_push(Model(obj, truth), seed, ROD_RADIUS)
    motion = simulate(Model(obj, truth), push, start, regime="inertial")
    predicted = simulate(Model(obj, believed), push, start, regime="inertial")

    # The object is seen, then hidden while it is pushed, then seen again.
    camera = make_overhead_camera(CAMERA_HEIGHT, at=motion.poses[:, :2].mean(axis=0))
    table = RenderedTable(outline=outline, height=OBJECT_HEIGHT, color=OBJECT_COLOR, camera=camera)
    tracker = PoseTracker(outline, OBJECT_HEIGHT, camera)
    first = table.look(start, seed=seed)[0]
    state = tracker.start(first, start)
    duration = float(motion.times[-1])
    times = np.linspace(duration / OCCLUDED_FRAMES, duration, OCCLUDED_FRAMES)
    for number, t in enumerate(times):
        pose = motion.poses[np.searchsorted(motion.times, t - TIME_MARGIN)]
        frame, _ = table.look(pose, seed=seed + number, t=float(t))
        frame, covered = hide(frame, outline, pose, camera)
        expected = _predict(predicted, float(t), start, use_model)
        state, tracked = tracker.track(state, frame, covered, expected)
    for number in range(SEEN_FRAMES):
        t = duration * (1 + (number + 1) / OCCLUDED_FRAMES)
        pose = motion.final_pose
        frame, _ = table.look(pose, seed=seed + len(times) + number, t=t)
        expected = _predict(predicted, duration, start, use_model) if number == 0 else None
        state, tracked = tracker.track(state, frame, None, expected)
    if not tracked.seen:
        return None, float("nan")
    middle = np.array(outline.centroid.coords[0])[None]
    off = transform(tracked.pose, middle)[0] - transform(motion.final_pose, middle)[0]
    turn = wrap_angle(tracked.pose[2] - motion.final_pose[2])
    return np.array([*off, turn]), float(np.sqrt(tracked.covariance[2, 2]))


def _predict(motion: Motion, t: float, start: Array, use_model: bool) -> ExpectedPose | None:
    """Says where a model expects the object at a time, s; None without a model."""
    if not use_model:
        return None
    index = min(int(np.searchsorted(motion.times, t - TIME_MARGIN)), len(motion.times) - 1)
    pose = motion.poses[index]
    way = float(np.linalg.norm(pose[:2] - start[:2]))
    turn = abs(float(pose[2] - start[2]))
    return make_expectation(pose, way, turn)


def hide(frame: Frame, outline: Polygon, pose: Array, camera: Camera) -> tuple[Frame, Mask]:
    """Hides an object in a frame by something dark above it.

    Args:
        frame: the frame.
        outline: outline of the object, B, m.
        pose: (3,) its pose, W.
        camera: camera that took the frame.

    Returns:
        The frame, and (height, width) what is covered.
    """
    placed = shapely.transform(outline, lambda points: transform(pose, points))
    around = np.array(placed.convex_hull.buffer(COVER_MARGIN).exterior.coords)
    pixels = camera.project(np.column_stack([around, np.full(len(around), OBJECT_HEIGHT)]))
    covered = np.zeros(frame.color.shape[:2], np.uint8)
    cv2.fillPoly(covered, [np.round(pixels).astype(np.int32)], 1)
    mask = covered > 0
    color = frame.color.copy()
    color[mask] = COVER_BRIGHTNESS
    assert frame.depth is not None
    depth = np.where(mask, np.float32(COVER_DEPTH), frame.depth)
    return frame._replace(color=color, depth=depth), mask


def tabulate_occlusions(scores: Sequence[OcclusionScore]) -> Table:
    """Makes a row for each kind of outline with and without a model, and one of all with it."""

    def make_row(name: str, model: bool, some: Sequence[OcclusionScore]) -> tuple[str | int, ...]:
        return (
            name,
            "model" if model else "its last pose",
            sum(score.pushes for score in some),
            sum(score.flipped for score in some),
            sum(score.doubted for score in some),
            sum(score.unseen for score in some),
        )

    rows = [make_row(score.kind, score.model, [score]) for score in scores]
    for model in (True, False):
        rows.append(
            make_row(ALL_RESULTS, model, [score for score in scores if score.model == model])
        )
    columns = ("outline", "expected by", "pushes", "flipped", "in doubt", "not seen")
    notes = [
        "Generated outlines that look nearly the same when they are turned, all of them hidden "
        "while they are pushed by 10 cm. flipped: the angle told is off by more than 30 degrees, or"
        " the place by more than 20 mm; in doubt: the tracker says so itself.",
        "model: a model that knows nothing of how the object bears on the table says where the "
        "push takes it.",
    ]
    return Table("Pose after hidden pushes", columns, rows, notes)
