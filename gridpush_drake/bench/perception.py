"""`gridpush bench perception`: what the camera makes of photographs, of rendered objects, and of pushes.

The photographs are real (--data, see `find_photographs`); everything else is rendered, see
`rendered_table`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray
from shapely import Polygon

from gridpush_drake.bench.jobs import QUIET, Execution, check_known, run_jobs
from gridpush_drake.bench.plant import draw_push
from gridpush_drake.bench.protocol import find_masks
from gridpush_drake.bench.rendered_table import RenderedTable
from gridpush_drake.bench.table import MM, PERCENT, Table, Value
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import GridPushError, PerceptionError
from gridpush_drake.geometry.se2 import compose, transform, wrap_angle
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import find_shipped_object, list_shipped_objects
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.perception import (
    Camera,
    DetectedTag,
    DetectorOptions,
    Frame,
    PoseTracker,
    TrackedPose,
    detect_object,
    detect_tags,
    read_color,
    read_depth,
    solve_tag_to_body,
)
from gridpush_drake.perception.foreground import Cues
from gridpush_drake.perception.tracking import NOT_SEEN

POSES, PUSHES = 10, 5
"""Of each object."""

HEIGHT = 0.02
"""Of the objects, m."""

COLORS = (
    (0.60, 0.35, 0.20),
    (0.15, 0.25, 0.55),
    (0.25, 0.25, 0.27),
    (0.75, 0.15, 0.15),
    (0.20, 0.45, 0.25),
)
"""Of the objects, in turn: wood, blue, dark gray, red, green."""

WIDTH, HEIGHT_PIXELS, FOCAL = 640, 480, 615.0
"""Of the camera, pixels."""

DISTANCE, FAR = 0.6, 0.75
"""Of the camera over the table, for outlines and for pushes, m."""

MAX_SHIFT, MAX_TILT = 0.03, 3.0
"""Of the object from under the camera, m, and of the camera, degrees."""

ROD_RADIUS = 0.006
FRAMES = 11
"""Of a push."""

TAG = (7, 0.04)
"""Number and side, m, of the tag on the objects."""

MAX_DEVIATION = np.array([3e-3, 3e-3, np.radians(3)])
"""Of a covariance with which the outline determines the pose, m and rad."""

NORMAL_95 = 1.96
"""Standard deviations on both sides that hold 95 % of a normal distribution."""

COMPARED = 400
"""Points of an outline whose distance to the other is taken."""

CUES: tuple[Cues, ...] = ("both", "color", "depth")
COLOR_ENDING, DEPTH_ENDING = "_color.png", "_depth.png"


@dataclass(frozen=True)
class PhotoJob:
    """One photograph with its depth and its true mask."""

    name: str
    color: str
    depth: str
    mask: str


@dataclass(frozen=True)
class PhotoScore:
    """Intersection over union of a photograph's mask with the true one, by what was looked at: CUES."""

    name: str
    iou: tuple[float, ...]


@dataclass(frozen=True)
class OutlineJob:
    """One object at several poses."""

    name: str
    poses: int
    seed: int


@dataclass(frozen=True)
class OutlineScore:
    """What was found of one object.

    Attributes:
        name: of the object.
        errors: of each pose, mean distance between the outlines, m; NaN where none was found.
        areas: of each pose, relative error of the outline's area.
        heights: of each pose, error of the height, m.
    """

    name: str
    errors: list[float]
    areas: list[float]
    heights: list[float]


@dataclass(frozen=True)
class TrackJob:
    """One object, pushed several times, and followed by its outline or by a tag on it."""

    name: str
    pushes: int
    seed: int
    tag: bool = False


@dataclass(frozen=True)
class TrackScore:
    """What was tracked of one object.

    Attributes:
        name: of the object.
        frames: how many.
        lost: in how many it was not found.
        errors: of each frame found in which the outline determines the pose: x, y, theta, m and
            rad.
        deviations: likewise, as the tracker states them; NaN of a tag, which states none.
    """

    name: str
    frames: int
    lost: int
    errors: list[tuple[float, float, float]]
    deviations: list[tuple[float, float, float]]


def run(
    data: Path | None = None,
    objects: Sequence[str] | None = None,
    poses: int = POSES,
    pushes: int = PUSHES,
    *,
    seed: int = 0,
    quick: bool = False,
    execution: Execution = QUIET,
) -> list[Table]:
    """Measures all three.

    Args:
        data: folder with NAME_color.png, NAME_depth.png and, anywhere in it, NAME_label.pgm; None
            for no photographs.
        objects: shipped objects' names; None for all.
        poses: in which each is rendered and found.
        pushes: during which each is tracked.
        seed: of everything random.
        quick: the first two objects, two poses, one push.
        execution: how the jobs are run.

    Returns:
        A table of photographs, where there are any, of outlines and of poses.

    Raises:
        ObjectError: an object is not shipped.
        GridPushError: there are no photographs in the folder, or an object is given twice.
    """
    names = list(objects or list_shipped_objects())
    for name in names:
        find_shipped_object(name)
    check_known("objects", names, list_shipped_objects())
    if quick:
        names, poses, pushes = names[:2], min(poses, 2), 1
    tables = []
    if data is not None:
        photos = run_jobs(run_photo, find_photographs(data), lambda job: job.name, execution)
        tables.append(tabulate_photos(photos))
    outline_jobs = [OutlineJob(name, poses, seed) for name in names]
    tables.append(
        tabulate_outlines(run_jobs(run_outline, outline_jobs, lambda job: job.name, execution))
    )
    track_jobs = [TrackJob(name, pushes, seed) for name in names]
    tables.append(
        tabulate_tracks(
            run_jobs(run_track, track_jobs, lambda job: f"{job.name}, pushed", execution)
        )
    )
    tag_jobs = [replace(job, tag=True) for job in track_jobs]
    tables.append(
        tabulate_tags(
            run_jobs(run_track, tag_jobs, lambda job: f"{job.name}, with a tag", execution)
        )
    )
    return tables


def find_photographs(data: Path) -> list[PhotoJob]:
    """Finds NAME_color.png, NAME_depth.png and NAME_label.pgm anywhere below a folder.

    Raises:
        GridPushError: there is no such folder, or no such three of one name.
    """
    masks = find_masks(data)
    jobs = []
    for color in sorted(data.rglob(f"*{COLOR_ENDING}")):
        name = color.name.removesuffix(COLOR_ENDING)
        depth = color.with_name(name + DEPTH_ENDING)
        if depth.is_file() and name in masks:
            jobs.append(PhotoJob(name, str(color), str(depth), str(masks[name])))
    if not jobs:
        raise GridPushError(
            f"{data}: holds no NAME{COLOR_ENDING} with NAME{DEPTH_ENDING} and NAME_label.pgm"
        )
    return jobs


def run_photo(job: PhotoJob) -> PhotoScore:
    """Finds the object of a photograph by each of CUES."""
    K = [[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT_PIXELS / 2], [0, 0, 1]]
    camera = Camera(WIDTH, HEIGHT_PIXELS, np.array(K), np.zeros(0))
    color, depth = read_color(job.color, camera), read_depth(job.depth, camera)
    true = np.asarray(cv2.imread(job.mask, cv2.IMREAD_UNCHANGED)) > 0
    scores = []
    for cues in CUES:
        try:
            mask = detect_object(color, depth, camera, DetectorOptions(cues=cues)).mask
            scores.append(float((mask & true).sum() / (mask | true).sum()))
        except PerceptionError:
            scores.append(0.0)
    return PhotoScore(job.name, tuple(scores))


def run_outline(job: OutlineJob) -> OutlineScore:
    """Renders an object at random poses and finds it."""
    obj, rng = _load(job.name), np.random.default_rng((job.seed, 1))
    score = OutlineScore(job.name, [], [], [])
    for k in range(job.poses):
        camera = make_overhead_camera(DISTANCE, rng.uniform(-MAX_TILT, MAX_TILT, 2))
        table = RenderedTable(obj.outline, HEIGHT, COLORS[k % len(COLORS)], camera)
        middle = camera.cast(camera.K[:2, 2])
        pose = np.array([*rng.uniform(-MAX_SHIFT, MAX_SHIFT, 2), rng.uniform(-np.pi, np.pi)])
        pose[:2] += (
            middle - transform([0, 0, pose[2]], [obj.outline.envelope.centroid.coords[0]])[0]
        )
        frame, _ = table.look(pose, seed=job.seed + k)
        true = shapely.transform(obj.outline, lambda points, pose=pose: transform(pose, points))
        try:
            found = detect_object(frame.color, frame.depth, camera)
        except PerceptionError:
            score.errors.append(float("nan"))
            continue
        score.errors.append(calc_outline_error(found.outline, true))
        score.areas.append(float(found.outline.area / true.area - 1))
        score.heights.append(found.height - HEIGHT)
    return score


def run_track(job: TrackJob) -> TrackScore:
    """Pushes an object by the model and tracks it with the arm in view."""
    obj = _load(job.name)
    params = CellParameters.uniform(obj)
    errors: list[NDArray[np.float64]] = []
    deviations: list[NDArray[np.float64]] = []
    frames = lost = 0
    for k in range(job.pushes):
        push, pose = draw_push(obj, params, job.seed + k, ROD_RADIUS)
        motion = simulate(obj, params, push, pose, regime="inertial")
        camera = make_overhead_camera(FAR, at=motion.poses[:, :2].mean(axis=0))
        tag = TAG if job.tag else None
        table = RenderedTable(obj.outline, HEIGHT, COLORS[k % len(COLORS)], camera, ROD_RADIUS, tag)
        follow = (_follow_tag if job.tag else _follow_outline)(
            obj, table.look(pose, seed=k)[0], pose, camera
        )
        for i in np.linspace(0, len(motion.times) - 1, FRAMES).astype(int):
            q = motion.poses[i]
            tracked = follow(
                *table.look(q, motion.tip[i], seed=FRAMES * k + int(i), t=float(motion.times[i]))
            )
            frames += 1
            lost += not tracked.seen
            deviation = np.sqrt(np.diag(tracked.covariance))
            if tracked.seen and not (deviation > MAX_DEVIATION).any():
                off = tracked.pose - q
                errors.append(np.array([*off[:2], wrap_angle(off[2])]))
                deviations.append(deviation)
    return TrackScore(job.name, frames, lost, _to_rows(errors), _to_rows(deviations))


Follow = Callable[[Frame, NDArray[np.bool_]], TrackedPose]
"""Of the next frame, and where the arm is in it."""


def _follow_outline(
    obj: GridObject, first: Frame, pose: NDArray[np.float64], camera: Camera
) -> Follow:
    tracker = PoseTracker(obj.outline, HEIGHT, camera)
    state = tracker.start(first, pose)

    def follow(frame: Frame, arm: NDArray[np.bool_]) -> TrackedPose:
        nonlocal state
        state, tracked = tracker.track(state, frame, arm)
        return tracked

    return follow


def _follow_tag(obj: GridObject, first: Frame, pose: NDArray[np.float64], camera: Camera) -> Follow:
    """By the tag, whose pose on the object is solved from the first frame."""
    number, size = TAG

    def find(frame: Frame) -> DetectedTag | None:
        return detect_tags(frame.color, camera, size, HEIGHT).get(number)

    tag = find(first)
    if tag is None:
        raise GridPushError(f"the tag on {obj.name} is not found in its first picture")
    X_TB = solve_tag_to_body(tag, pose)

    def follow(frame: Frame, arm: NDArray[np.bool_]) -> TrackedPose:
        tag = find(frame)
        return (
            NOT_SEEN
            if tag is None
            else replace(NOT_SEEN, pose=compose(tag.planar_pose, X_TB), seen=True)
        )

    return follow


def make_overhead_camera(
    distance: float, tilt: ArrayLike = (0.0, 0.0), at: ArrayLike = (0.0, 0.0)
) -> Camera:
    """A camera that looks down from `distance` m over the table at `at` (2,), tilted by degrees about its x and y."""
    a, b = np.radians(tilt)
    R_x = np.array([[1, 0, 0], [0, -np.cos(a), np.sin(a)], [0, -np.sin(a), -np.cos(a)]])
    R_y = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    X_WC = np.eye(4)
    X_WC[:3, :3], X_WC[:3, 3] = R_x @ R_y, [*np.asarray(at), distance]
    K = [[FOCAL, 0, (WIDTH - 1) / 2], [0, FOCAL, (HEIGHT_PIXELS - 1) / 2], [0, 0, 1]]
    return Camera(WIDTH, HEIGHT_PIXELS, np.array(K), np.zeros(0), X_WC)


def calc_outline_error(a: Polygon, b: Polygon) -> float:
    """Mean distance between two outlines, holes included, both ways, m."""
    return (_calc_distance(a, b) + _calc_distance(b, a)) / 2


def _calc_distance(a: Polygon, b: Polygon) -> float:
    boundary = a.boundary
    points = shapely.line_interpolate_point(
        boundary, np.linspace(0, boundary.length, COMPARED, endpoint=False)
    )
    return float(shapely.distance(points, b.boundary).mean())


def tabulate_photos(scores: Sequence[PhotoScore]) -> Table:
    """A row a photograph, and their mean."""
    rows: list[tuple[Value, ...]] = [(score.name, *score.iou) for score in scores]
    rows.append(("mean", *np.mean([score.iou for score in scores], axis=0).tolist()))
    notes = [
        "Intersection over union with a mask drawn by hand, which itself would not score above about 0.97."
    ]
    return Table(
        "The object's mask in real photographs",
        ("photograph", "both", "color", "depth"),
        rows,
        notes,
    )


def tabulate_outlines(scores: Sequence[OutlineScore]) -> Table:
    """A row an object, and one of all."""

    def make_row(name: str, some: Sequence[OutlineScore]) -> tuple[Value, ...]:
        errors, areas, heights = (
            np.concatenate([getattr(score, key) for score in some])
            for key in ("errors", "areas", "heights")
        )
        found = errors[np.isfinite(errors)]
        return (
            name, len(errors), len(errors) - len(found), *(MM * _stats(found)),
            PERCENT * float(np.mean(areas)), PERCENT * float(np.abs(areas).max(initial=0.0)),
            MM * float(np.abs(heights).max(initial=0.0)),
        )  # fmt: skip

    rows = [make_row(score.name, [score]) for score in scores] + [make_row("all", scores)]
    columns = (
        "object", "poses", "not found", "outline, mean, mm", "outline, worst, mm", "area, mean, %", "area, worst, %",
        "height, worst, mm",
    )  # fmt: skip
    notes = [
        f"Rendered from {DISTANCE} m, {FOCAL:g} pixels of focal length, with shadows, a depth camera's noise and holes;"
        f" objects {HEIGHT * MM:g} mm high, in {len(COLORS)} colors.",
        "outline: mean distance between the found one and the true one; area: of what it encloses.",
    ]
    return Table("Outline of objects from one photograph", columns, rows, notes)


def tabulate_tracks(scores: Sequence[TrackScore]) -> Table:
    """A row an object, and one of all."""

    def make_row(name: str, some: Sequence[TrackScore]) -> tuple[Value, ...]:
        frames, lost, place, angle = _summarize_track(some)
        e, s = (
            np.concatenate([np.reshape(rows, (-1, 3)) for rows in both])
            for both in _list_errors(some)
        )
        within = float((np.abs(e) <= NORMAL_95 * s).mean()) if len(e) else float("nan")
        return name, frames, lost, frames - lost - len(e), place, angle, PERCENT * within

    rows = [make_row(score.name, [score]) for score in scores] + [make_row("all", scores)]
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
        f"Pushes of 10 cm, {FRAMES} frames each, with the arm in view, rendered from {FAR} m: a pixel is "
        f"{FAR / FOCAL * MM:.1f} mm.",
        "not determined: the stated deviation is above 3 mm or 3 degrees. within 95 %: of x, y and angle, how many are"
        " within the stated 95 % interval.",
    ]
    return Table("Pose during pushes", columns, rows, notes)


def tabulate_tags(scores: Sequence[TrackScore]) -> Table:
    """A row an object, and one of all."""
    rows = [(score.name, *_summarize_track([score])) for score in scores] + [
        ("all", *_summarize_track(scores))
    ]
    columns = ("object", "frames", "hidden", "place, RMS, mm", "angle, RMS, deg")
    notes = [
        f"The same pushes, by a tag of {TAG[1] * MM:g} mm on the object; hidden: the arm covers a part of it."
    ]
    return Table("Pose during pushes, by a tag", columns, rows, notes)


def _list_errors(scores: Sequence[TrackScore]) -> tuple[list[Any], list[Any]]:
    return [score.errors for score in scores], [score.deviations for score in scores]


def _summarize_track(scores: Sequence[TrackScore]) -> tuple[int, int, float, float]:
    """Frames, how many without the object, and RMS errors of place, mm, and angle, deg."""
    e = np.concatenate([np.reshape(score.errors, (-1, 3)) for score in scores])
    frames, lost = sum(score.frames for score in scores), sum(score.lost for score in scores)
    if not len(e):
        return frames, lost, float("nan"), float("nan")
    place = float(np.sqrt((e[:, :2] ** 2).sum(axis=1).mean()))
    return frames, lost, MM * place, float(np.degrees(np.sqrt((e[:, 2] ** 2).mean())))


def _load(name: str) -> GridObject:
    return GridObject.from_yaml(find_shipped_object(name))


def _stats(values: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.array([values.mean(), values.max()]) if len(values) else np.full(2, np.nan)


def _to_rows(values: Sequence[NDArray[np.float64]]) -> list[Any]:
    return [tuple(map(float, row)) for row in values]
