"""`gridpush bench perception`: what the camera makes of photographs, rendered objects, and pushes.

The photographs are real (--data, see `find_photographs`). Everything else is rendered, see
`bench.rendered_table`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import shapely
from numpy.typing import NDArray
from shapely import Polygon

from gridpush_drake.bench.hidden_pushes import KINDS, HiddenJob, run_hidden, tabulate_hidden
from gridpush_drake.bench.jobs import check_known
from gridpush_drake.bench.plant import draw_push
from gridpush_drake.bench.protocol import find_masks
from gridpush_drake.bench.rendered_photographs import HALVES, Half, take_photograph
from gridpush_drake.bench.rendered_table import (
    FOCAL,
    HEIGHT_PIXELS,
    WIDTH,
    RenderedTable,
    make_overhead_camera,
)
from gridpush_drake.bench.several_objects import (
    COUNTS,
    SeveralJob,
    run_several,
    tabulate_several,
)
from gridpush_drake.bench.study import OBJECTS, Done, Study, StudyOptions, Task, option
from gridpush_drake.bench.table import ALL, MM, PERCENT, Table, Value
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

POSES = 10
"""Number of poses in which each object is rendered and found."""

PHOTOGRAPHS = 100
"""Number of rendered photographs of generated objects in each half."""

QUICK_PHOTOGRAPHS = 4
"""Number of rendered photographs in each half in the quick variant."""

PHOTOGRAPHS_A_JOB = 10
"""Number of rendered photographs that are taken in one job."""

GOOD = 0.9
"""Intersection over union from which on an object counts as well found."""

POOR = 0.8
"""Intersection over union below which an object counts as not found; without a refusal that is a
silent failure."""

HIDDEN_PUSHES = 34
"""Number of hidden pushes of each kind of outline that looks alike when it is turned."""

QUICK_HIDDEN_PUSHES = 2
"""Number of hidden pushes of each kind in the quick variant."""

SEVERAL_PUSHES = 5
"""Number of pushes through each number of objects, apart and touching."""

QUICK_COUNTS = (2,)
"""Numbers of objects in view in the quick variant."""

PUSHES = 5
"""Number of pushes during which each object is tracked."""

QUICK_OBJECTS = 2
"""Number of objects in the quick variant."""

QUICK_POSES = 2
"""Number of poses of each object in the quick variant."""

HEIGHT = 0.02
"""Height of the objects, m."""

COLORS = (
    (0.60, 0.35, 0.20),
    (0.15, 0.25, 0.55),
    (0.25, 0.25, 0.27),
    (0.75, 0.15, 0.15),
    (0.20, 0.45, 0.25),
)
"""Colors that the objects have in turn, red, green and blue from 0 to 1: wood, blue, dark gray,
red, green."""

DISTANCE = 0.6
"""Height of the camera over the table where outlines are found, m."""

FAR = 0.75
"""Height of the camera over the table where pushes are tracked, m."""

MAX_SHIFT = 0.03
"""Greatest distance of an object from the middle of the picture along x and y, m."""

MAX_TILT = 3.0
"""Greatest tilt of the camera about each axis, degrees."""

ROD_RADIUS = 0.006
"""Radius of the rod that pushes, m."""

FRAMES = 11
"""Number of frames of a push."""

TAG = (7, 0.04)
"""Number of the tag on the objects, and its side, m."""

MAX_DEVIATION = np.array([3e-3, 3e-3, np.radians(3)])
"""Greatest stated standard deviations (3,) with which the outline still determines the pose, m and
rad."""

NORMAL_95 = 1.96
"""Number of standard deviations on both sides that hold 95 % of a normal distribution."""

COMPARED = 400
"""Number of points of an outline whose distance to the other one is taken."""

CUES: tuple[Cues, ...] = ("both", "color", "depth")
"""What is looked at in a photograph."""

COLOR_ENDING = "_color.png"
"""Ending of the name of a color picture."""

DEPTH_ENDING = "_depth.png"
"""Ending of the name of a depth picture."""


@dataclass(frozen=True)
class Options(StudyOptions):
    """What is measured.

    Attributes:
        data: folder with NAME_color.png, NAME_depth.png and, anywhere in it, NAME_label.pgm; None
            for no photographs.
        objects: names of shipped objects; all of them where None.
        poses: number of poses in which each is rendered and found.
        pushes: number of pushes during which each is tracked.
        hidden_pushes: number of hidden pushes of each kind of outline that looks alike.
        photographs: number of rendered photographs of generated objects in each half.
        several_pushes: number of pushes through each number of objects, apart and touching.
        counts: numbers of objects in view that push each other.
    """

    data: Path | None = option(
        None,
        "Real photographs too: a folder with NAME_color.png, NAME_depth.png and NAME_label.pgm.",
        name="--data",
        metavar="DIR",
    )
    objects: tuple[str, ...] | None = option(None, **OBJECTS)
    poses: int = POSES
    pushes: int = PUSHES
    hidden_pushes: int = HIDDEN_PUSHES
    photographs: int = PHOTOGRAPHS
    several_pushes: int = SEVERAL_PUSHES
    counts: tuple[int, ...] = COUNTS

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the objects."""
        return tuple(self.objects or list_shipped_objects())


@dataclass(frozen=True)
class PhotoJob:
    """One photograph.

    Attributes:
        name: what it is called.
        color: file of its colors.
        depth: file of its depths.
        mask: file of the true mask of the object.
    """

    name: str
    color: str
    depth: str
    mask: str


@dataclass(frozen=True)
class RenderedPhotoJob:
    """Some rendered photographs of generated objects.

    Attributes:
        half: "tuning" or "reporting".
        first: number of the first photograph.
        count: number of photographs.
    """

    half: Half
    first: int
    count: int


@dataclass(frozen=True)
class RenderedPhotoScore:
    """How well objects were found in rendered photographs.

    Attributes:
        half: "tuning" or "reporting".
        iou: intersection over union of each mask with the true one; NaN where no object was found
            and the detector says so.
    """

    half: Half
    iou: list[float]


@dataclass(frozen=True)
class PhotoScore:
    """How well the object's mask was found in a photograph.

    Attributes:
        name: what the photograph is called.
        iou: intersection of the found mask with the true one over their union, for each of CUES.
    """

    name: str
    iou: tuple[float, ...]


@dataclass(frozen=True)
class OutlineJob:
    """One object at several poses.

    Attributes:
        name: name of the object.
        poses: number of poses.
        seed: seed of everything random.
    """

    name: str
    poses: int
    seed: int


@dataclass(frozen=True)
class OutlineScore:
    """What was found of one object.

    Attributes:
        name: name of the object.
        errors: mean distance between the outlines at each pose, m; NaN where none was found.
        areas: relative error of the outline's area at each pose where one was found.
        heights: error of the height at each pose where an outline was found, m.
    """

    name: str
    errors: list[float]
    areas: list[float]
    heights: list[float]


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


Job = PhotoJob | RenderedPhotoJob | OutlineJob | TrackJob | HiddenJob | SeveralJob
"""One job of the study."""


def shorten(options: Options) -> Options:
    """Makes the options of the quick variant."""
    names = options.names[:QUICK_OBJECTS]
    return replace(
        options,
        objects=names,
        poses=min(options.poses, QUICK_POSES),
        pushes=1,
        hidden_pushes=min(options.hidden_pushes, QUICK_HIDDEN_PUSHES),
        photographs=min(options.photographs, QUICK_PHOTOGRAPHS),
        several_pushes=min(options.several_pushes, 1),
        counts=QUICK_COUNTS,
    )


def make_jobs(options: Options) -> list[Job]:
    """Makes the jobs: photographs, real and rendered, objects, pushes, and hidden pushes.

    Raises:
        ObjectError: an object is not shipped.
        GridPushError: there are no photographs in the folder, or an object is given twice.
    """
    names = options.names
    for name in names:
        find_shipped_object(name)
    check_known("objects", names, list_shipped_objects())
    photos = [] if options.data is None else find_photographs(options.data)
    rendered = [
        RenderedPhotoJob(half, first, min(PHOTOGRAPHS_A_JOB, options.photographs - first))
        for half in HALVES
        for first in range(0, options.photographs, PHOTOGRAPHS_A_JOB)
    ]
    return [
        *photos,
        *rendered,
        *(OutlineJob(name, options.poses, options.seed) for name in names),
        *(TrackJob(name, options.pushes, options.seed) for name in names),
        *(TagJob(name, options.pushes, options.seed) for name in names),
        *(
            HiddenJob(kind, options.hidden_pushes, options.seed, model)
            for model in (True, False)
            for kind in KINDS
        ),
        *(
            SeveralJob(count, touching, options.several_pushes, options.seed)
            for touching in (False, True)
            for count in options.counts
            if options.several_pushes
        ),
    ]


def tabulate(options: Options, done: Done) -> list[Table]:
    """Tabulates photographs, where there are any, outlines, poses, and hidden pushes."""
    photos = done.of(PHOTO)
    return [
        *([tabulate_photos(photos)] if photos else []),
        tabulate_rendered_photos(done.of(RENDERED)),
        tabulate_outlines(done.of(OUTLINE)),
        tabulate_tracks(done.of(TRACK)),
        tabulate_tags(done.of(TAGGED)),
        tabulate_hidden(done.of(HIDDEN)),
        tabulate_several(done.of(SEVERAL)),
    ]


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
    color = read_color(job.color, camera)
    depth = read_depth(job.depth, camera)
    true = np.asarray(cv2.imread(job.mask, cv2.IMREAD_UNCHANGED)) > 0
    scores = []
    for cues in CUES:
        try:
            mask = detect_object(color, depth, camera, DetectorOptions(cues=cues)).mask
            scores.append(float((mask & true).sum() / (mask | true).sum()))
        except PerceptionError:
            scores.append(0.0)
    return PhotoScore(job.name, tuple(scores))


def run_rendered_photo(job: RenderedPhotoJob) -> RenderedPhotoScore:
    """Renders photographs of generated objects and finds them."""
    iou = []
    for number in range(job.first, job.first + job.count):
        photo = take_photograph(job.half, number)
        try:
            mask = detect_object(photo.frame.color, photo.frame.depth, photo.camera).mask
        except PerceptionError:
            iou.append(float("nan"))
            continue
        iou.append(float((mask & photo.mask).sum() / (mask | photo.mask).sum()))
    return RenderedPhotoScore(job.half, iou)


def run_outline(job: OutlineJob) -> OutlineScore:
    """Renders an object at random poses and finds it."""
    obj = _load(job.name)
    rng = np.random.default_rng((job.seed, 1))
    score = OutlineScore(name=job.name, errors=[], areas=[], heights=[])
    for k in range(job.poses):
        camera = make_overhead_camera(DISTANCE, rng.uniform(-MAX_TILT, MAX_TILT, 2))
        table = RenderedTable(obj.outline, HEIGHT, COLORS[k % len(COLORS)], camera)
        middle = camera.cast(camera.K[:2, 2])
        pose = np.array([*rng.uniform(-MAX_SHIFT, MAX_SHIFT, 2), rng.uniform(-np.pi, np.pi)])
        # the outline, and not the body frame's origin, is to be near the middle of the picture
        center = obj.outline.envelope.centroid.coords[0]
        pose[:2] += middle - transform([0, 0, pose[2]], [center])[0]
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
    """Pushes an object by the model, and tracks its outline with the arm in view."""
    return _track(job, _follow_outline, tag=None)


def run_tag(job: TagJob) -> TrackScore:
    """Pushes an object by the model, and tracks the tag on it with the arm in view."""
    return _track(job, _follow_tag, tag=TAG)


def _track(job: TrackJob, begin: "Begin", tag: tuple[int, float] | None) -> TrackScore:
    """Pushes an object by the model, and follows it; `begin` makes what follows it."""
    obj = _load(job.name)
    params = CellParameters.uniform(obj)
    errors: list[NDArray[np.float64]] = []
    deviations: list[NDArray[np.float64]] = []
    frames = lost = 0
    for k in range(job.pushes):
        push, pose = draw_push(obj, params, job.seed + k, ROD_RADIUS)
        motion = simulate(obj, params, push, pose, regime="inertial")
        camera = make_overhead_camera(FAR, at=motion.poses[:, :2].mean(axis=0))
        color = COLORS[k % len(COLORS)]
        table = RenderedTable(
            outline=obj.outline,
            height=HEIGHT,
            color=color,
            camera=camera,
            rod_radius=ROD_RADIUS,
            tag=tag,
        )
        follow = begin(obj, table.look(pose, seed=k)[0], pose, camera)
        for i in np.linspace(0, len(motion.times) - 1, FRAMES).astype(int):
            q = motion.poses[i]
            seed = FRAMES * k + int(i)
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
    tracker = PoseTracker(obj.outline, HEIGHT, camera)
    state = tracker.start(first, pose)

    def follow(frame: Frame, arm: NDArray[np.bool_]) -> TrackedPose:
        nonlocal state
        state, tracked = tracker.track(state, frame, arm)
        return tracked

    return follow


def _follow_tag(obj: GridObject, first: Frame, pose: NDArray[np.float64], camera: Camera) -> Follow:
    """Makes what follows the object by its tag, whose place is solved from the first frame."""
    number, size = TAG

    def find(frame: Frame) -> DetectedTag | None:
        return detect_tags(frame.color, camera, size, HEIGHT).get(number)

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


def calc_outline_error(a: Polygon, b: Polygon) -> float:
    """Calculates the mean distance between two outlines, holes included, both ways, m."""
    return (_calc_distance(a, b) + _calc_distance(b, a)) / 2


def _calc_distance(a: Polygon, b: Polygon) -> float:
    """Calculates the mean distance of points of one outline from the other outline, m."""
    boundary = a.boundary
    points = shapely.line_interpolate_point(
        boundary, np.linspace(0, boundary.length, COMPARED, endpoint=False)
    )
    return float(shapely.distance(points, b.boundary).mean())


def tabulate_photos(scores: Sequence[PhotoScore]) -> Table:
    """Makes a row for each photograph, and one of their mean."""
    rows: list[tuple[Value, ...]] = [(score.name, *score.iou) for score in scores]
    rows.append(("mean", *np.mean([score.iou for score in scores], axis=0).tolist()))
    notes = [
        "Intersection over union with a mask drawn by hand, which itself would not score above "
        "about 0.97."
    ]
    columns = ("photograph", *CUES)
    return Table("The object's mask in real photographs", columns, rows, notes)


def tabulate_rendered_photos(scores: Sequence[RenderedPhotoScore]) -> Table:
    """Makes a row for each half of the rendered photographs."""
    rows: list[tuple[Value, ...]] = []
    for half in HALVES:
        iou = np.concatenate([score.iou for score in scores if score.half == half] or [[]])
        found = iou[np.isfinite(iou)]
        if not len(found):
            continue
        rows.append(
            (
                half,
                len(iou),
                len(iou) - len(found),
                float(found.mean()),
                PERCENT * float((found >= GOOD).sum() / len(iou)),
                PERCENT * float((found < POOR).sum() / len(iou)),
            )
        )
    columns = (
        "half",
        "photographs",
        "refused",
        "mean of those found",
        f"at least {GOOD}, %",
        f"below {POOR}, %",
    )
    notes = [
        "Generated outlines of several materials on gray, white, wooden and patterned tables, with "
        "the depth of a stereo camera. The halves have other outlines and other materials.",
        "Intersection over union with the true mask; below: found wrongly, without a refusal.",
    ]
    return Table("The object's mask in rendered photographs", columns, rows, notes)


def tabulate_outlines(scores: Sequence[OutlineScore]) -> Table:
    """Makes a row for each object, and one of all."""

    def make_row(name: str, some: Sequence[OutlineScore]) -> tuple[Value, ...]:
        errors, areas, heights = (
            np.concatenate([getattr(score, key) for score in some])
            for key in ("errors", "areas", "heights")
        )
        found = errors[np.isfinite(errors)]
        return (
            name,
            len(errors),
            len(errors) - len(found),
            *(MM * _calc_mean_and_worst(found)),
            PERCENT * float(np.mean(areas)),
            PERCENT * float(np.abs(areas).max(initial=0.0)),
            MM * float(np.abs(heights).max(initial=0.0)),
        )

    rows = [make_row(score.name, [score]) for score in scores] + [make_row(ALL, scores)]
    columns = (
        "object",
        "poses",
        "not found",
        "outline, mean, mm",
        "outline, worst, mm",
        "area, mean, %",
        "area, worst, %",
        "height, worst, mm",
    )
    notes = [
        f"Rendered from {DISTANCE} m, {FOCAL:g} pixels of focal length, with shadows, a depth "
        f"camera's noise and holes; objects {HEIGHT * MM:g} mm high, in {len(COLORS)} colors.",
        "outline: mean distance between the found one and the true one; area: of what it encloses.",
    ]
    return Table("Outline of objects from one photograph", columns, rows, notes)


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
        return name, frames, lost, unclear, place, angle, PERCENT * within

    rows = [make_row(score.name, [score]) for score in scores] + [make_row(ALL, scores)]
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
        f"Pushes of 10 cm, {FRAMES} frames each, with the arm in view, rendered from {FAR} m: a "
        f"pixel is {FAR / FOCAL * MM:.1f} mm.",
        "not determined: the stated deviation is above 3 mm or 3 degrees. within 95 %: of x, y and "
        "angle, how many are within the stated 95 % interval.",
    ]
    return Table("Pose during pushes", columns, rows, notes)


def tabulate_tags(scores: Sequence[TrackScore]) -> Table:
    """Makes a row for each object, and one of all."""
    rows = [(score.name, *_summarize_track([score])) for score in scores]
    rows.append((ALL, *_summarize_track(scores)))
    columns = ("object", "frames", "hidden", "place, RMS, mm", "angle, RMS, deg")
    notes = [
        f"The same pushes, by a tag of {TAG[1] * MM:g} mm on the object; hidden: the arm covers a "
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
    return frames, lost, MM * place, angle


def _load(name: str) -> GridObject:
    return GridObject.from_yaml(find_shipped_object(name))


def _calc_mean_and_worst(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Calculates mean and greatest of some values (2,); NaN where there are none."""
    if not len(values):
        return np.full(2, np.nan)
    return np.array([values.mean(), values.max()])


def _to_rows(values: Sequence[NDArray[np.float64]]) -> list[Any]:
    return [tuple(map(float, row)) for row in values]


PHOTO = Task(job=PhotoJob, run=run_photo, describe=lambda job: job.name)
"""What is done with a photograph."""

RENDERED = Task(
    job=RenderedPhotoJob,
    run=run_rendered_photo,
    describe=lambda job: f"{job.half} photographs from {job.first} on",
)
"""What is done with some rendered photographs."""

OUTLINE = Task(job=OutlineJob, run=run_outline, describe=lambda job: job.name)
"""What is done to find an object's outline."""

TRACK = Task(job=TrackJob, run=run_track, describe=lambda job: f"{job.name}, pushed")
"""What is done to follow an object's outline."""

TAGGED = Task(job=TagJob, run=run_tag, describe=lambda job: f"{job.name}, with a tag")
"""What is done to follow the tag on an object."""

HIDDEN = Task(job=HiddenJob, run=run_hidden, describe=lambda job: f"{job.kind}, hidden")
"""What is done to find objects after hidden pushes."""

SEVERAL = Task(
    job=SeveralJob,
    run=run_several,
    describe=lambda job: f"{job.count} objects, {'touching' if job.touching else 'apart'}",
)
"""What is done to follow several objects that push each other."""

STUDY = Study(
    name="perception",
    help="Find objects in photographs, real and rendered, and track them while they are pushed.",
    options=Options,
    shorten=shorten,
    make_jobs=make_jobs,
    tasks=(PHOTO, RENDERED, OUTLINE, TRACK, TAGGED, HIDDEN, SEVERAL),
    tabulate=tabulate,
)
"""`gridpush bench perception`."""
