"""`gridpush bench perception`: what the camera makes of photographs, rendered objects, and pushes.

The photographs are real (--data, see `find_photographs`). Everything else is rendered, see
`bench.perception.rendered_table`.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from gridpush_drake.bench.perception.found_outlines import (
    OutlineJob,
    run_outline,
    tabulate_outlines,
)
from gridpush_drake.bench.perception.found_photographs import (
    PhotoJob,
    RenderedPhotoJob,
    find_photographs,
    run_photo,
    run_rendered_photo,
    tabulate_photos,
    tabulate_rendered_photos,
)
from gridpush_drake.bench.perception.multi_object import (
    OBJECT_COUNTS,
    MultiObjectJob,
    run_multi_object,
    tabulate_multi_object,
)
from gridpush_drake.bench.perception.occluded_pushes import (
    OCCLUDED_OUTLINE_KINDS,
    OcclusionJob,
    run_occlusion,
    tabulate_occlusions,
)
from gridpush_drake.bench.perception.rendered_photographs import HALF_NAMES
from gridpush_drake.bench.perception.tracked_pushes import (
    TagJob,
    TrackJob,
    run_tag,
    run_track,
    tabulate_tags,
    tabulate_tracks,
)
from gridpush_drake.bench.study import OBJECTS_OPTION, Done, JobKind, Study, StudyOptions, option
from gridpush_drake.jobs.run import check_known
from gridpush_drake.objects.object_file import find_shipped_object, list_shipped_objects
from gridpush_drake.report.table import Table

POSE_COUNT = 10
"""Number of poses in which each object is rendered and found."""

PHOTOGRAPH_COUNT = 100
"""Number of rendered photographs of generated objects in each half."""

QUICK_PHOTOGRAPHS = 4
"""Number of rendered photographs in each half in the quick variant."""

PHOTOGRAPHS_A_JOB = 10
"""Number of rendered photographs that are taken in one job."""

OCCLUDED_PUSHES = 34
"""Number of hidden pushes of each kind of outline that looks alike when it is turned."""

QUICK_OCCLUDED_PUSHES = 2
"""Number of hidden pushes of each kind in the quick variant."""

MULTI_OBJECT_PUSHES = 5
"""Number of pushes through each number of objects, apart and touching."""

QUICK_COUNTS = (2,)
"""Numbers of objects in view in the quick variant."""

TRACKED_PUSH_COUNT = 5
"""Number of pushes during which each object is tracked."""

QUICK_OBJECTS = 2
"""Number of objects in the quick variant."""

QUICK_POSES = 2
"""Number of poses of each object in the quick variant."""


@dataclass(frozen=True)
class PerceptionBenchOptions(StudyOptions):
    """What is measured.

    Attributes:
        part: which part is measured.
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

    part: Literal["all", "photographs", "outlines", "pushes", "tags", "hidden", "several"] = option(
        "all",
        "Which part to measure: photographs are generated objects in photographs and, with --data, "
        "real ones; outlines and pushes are shipped objects, from above and tracked, tags the same "
        "by a tag; hidden are look-alikes that are pushed out of sight; several are objects that "
        "push each other; all is each of them.",
        metavar="PART",
    )
    data: Path | None = option(
        None,
        "Real photographs too: a folder with NAME_color.png, NAME_depth.png and NAME_label.pgm.",
        name="--data",
        metavar="DIR",
    )
    objects: tuple[str, ...] | None = option(None, **OBJECTS_OPTION)
    poses: int = POSE_COUNT
    pushes: int = TRACKED_PUSH_COUNT
    hidden_pushes: int = OCCLUDED_PUSHES
    photographs: int = PHOTOGRAPH_COUNT
    several_pushes: int = MULTI_OBJECT_PUSHES
    counts: tuple[int, ...] = OBJECT_COUNTS

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the objects."""
        return tuple(self.objects or list_shipped_objects())


Job = PhotoJob | RenderedPhotoJob | OutlineJob | TrackJob | OcclusionJob | MultiObjectJob
"""One job of the study."""


def shorten(options: PerceptionBenchOptions) -> PerceptionBenchOptions:
    """Makes the options of the quick variant."""
    names = options.names[:QUICK_OBJECTS]
    return replace(
        options,
        objects=names,
        poses=min(options.poses, QUICK_POSES),
        pushes=1,
        hidden_pushes=min(options.hidden_pushes, QUICK_OCCLUDED_PUSHES),
        photographs=min(options.photographs, QUICK_PHOTOGRAPHS),
        several_pushes=min(options.several_pushes, 1),
        counts=QUICK_COUNTS,
    )


def make_jobs(options: PerceptionBenchOptions) -> list[Job]:
    """Makes the jobs of the part that is measured, or of all parts.

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
        for half in HALF_NAMES
        for first in range(0, options.photographs, PHOTOGRAPHS_A_JOB)
    ]
    parts: dict[str, list[Job]] = {
        "photographs": [*photos, *rendered],
        "outlines": [OutlineJob(name, options.poses, options.seed) for name in names],
        "pushes": [TrackJob(name, options.pushes, options.seed) for name in names],
        "tags": [TagJob(name, options.pushes, options.seed) for name in names],
        "hidden": [
            OcclusionJob(kind, options.hidden_pushes, options.seed, model)
            for model in (True, False)
            for kind in OCCLUDED_OUTLINE_KINDS
        ],
        "several": [
            MultiObjectJob(count, touching, options.several_pushes, options.seed)
            for touching in (False, True)
            for count in options.counts
        ],
    }
    wanted = parts if options.part == "all" else (options.part,)
    return [job for part in wanted for job in parts[part]]


def tabulate(options: PerceptionBenchOptions, done: Done) -> list[Table]:
    """Tabulates all that was measured."""
    tables: list[tuple[JobKind[Any, Any], Callable[[Any], Table]]] = [
        (PHOTO_JOBS, tabulate_photos),
        (RENDERED_JOBS, tabulate_rendered_photos),
        (OUTLINE_JOBS, tabulate_outlines),
        (TRACK_JOBS, tabulate_tracks),
        (TAG_JOBS, tabulate_tags),
        (OCCLUSION_JOBS, tabulate_occlusions),
        (MULTI_OBJECT_JOBS, tabulate_multi_object),
    ]
    return [make(done.of(task)) for task, make in tables if done.of(task)]


PHOTO_JOBS = JobKind(job=PhotoJob, run=run_photo, describe=lambda job: job.name)
"""What is done with a photograph."""

RENDERED_JOBS = JobKind(
    job=RenderedPhotoJob,
    run=run_rendered_photo,
    describe=lambda job: f"{job.half} photographs from {job.first} on",
)
"""What is done with some rendered photographs."""

OUTLINE_JOBS = JobKind(job=OutlineJob, run=run_outline, describe=lambda job: job.name)
"""What is done to find an object's outline."""

TRACK_JOBS = JobKind(job=TrackJob, run=run_track, describe=lambda job: f"{job.name}, pushed")
"""What is done to follow an object's outline."""

TAG_JOBS = JobKind(job=TagJob, run=run_tag, describe=lambda job: f"{job.name}, with a tag")
"""What is done to follow the tag on an object."""

OCCLUSION_JOBS = JobKind(
    job=OcclusionJob, run=run_occlusion, describe=lambda job: f"{job.kind}, hidden"
)
"""What is done to find objects after hidden pushes."""

MULTI_OBJECT_JOBS = JobKind(
    job=MultiObjectJob,
    run=run_multi_object,
    describe=lambda job: f"{job.count} objects, {'touching' if job.touching else 'apart'}",
)
"""What is done to follow several objects that push each other."""

STUDY = Study(
    name="perception",
    help="Find objects in photographs, real and rendered, and track them while they are pushed.",
    options=PerceptionBenchOptions,
    shorten=shorten,
    make_jobs=make_jobs,
    tasks=(
        PHOTO_JOBS,
        RENDERED_JOBS,
        OUTLINE_JOBS,
        TRACK_JOBS,
        TAG_JOBS,
        OCCLUSION_JOBS,
        MULTI_OBJECT_JOBS,
    ),
    tabulate=tabulate,
)
"""`gridpush bench perception`."""
