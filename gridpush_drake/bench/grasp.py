"""`gridpush bench grasp`: the whole story in the station.

Objects are poked, slid to the table's edge, grasped, lifted and held. The runs are episodes of a
campaign (`station.campaign.episodes`) with a shipped scenario: `grasp`, or `grasp_unknown_inertia`
where the robot is told nothing.

Of objects of which nothing is told, some are too heavy to be held at all: arm and gripper reach no
place so near to their center of mass. Therefore it is worked out for each run whether the same
planner, told the hidden masses and frictions, sees a way to hold the object from where it lies.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gridpush_drake.bench.study import OBJECTS_OPTION, Done, JobKind, Study, StudyOptions, option
from gridpush_drake.errors import GridPushError
from gridpush_drake.objects.object_file import find_shipped_object
from gridpush_drake.report.table import (
    Column,
    Proportion,
    Table,
    by_object,
    calc_mean,
    count_of,
    mean_of,
)
from gridpush_drake.station.campaign.episodes import (
    BROKEN_STATUS,
    DROPPED_OUTCOME,
    GAVE_UP,
    NOT_LIFTED,
    REFUSED_STATUS,
    EpisodeJob,
    EpisodeOutcome,
    make_episode_task,
    run_episode,
)
from gridpush_drake.station.schema.camera_config import CameraKind
from gridpush_drake.station.schema.scenario_file import (
    format_scenario,
    parse_scenario,
    read_scenario,
)
from gridpush_drake.station.tasks.pregrasp_task import PreGraspTask
from gridpush_drake.station.tasks.task import TaskStatus
from gridpush_drake.units import MM_PER_M, PERCENT_PER_ONE

DEFAULT_OBJECTS = ("claw_hammer", "combination_wrench", "spray_bottle")
"""Shipped objects that are grasped by default."""

DEFAULT_SEED_COUNT = 3
"""Number of hidden truths and noises of each object by default."""

SCENARIO_NAME = "grasp"
"""Name of the shipped scenario of the episodes."""

UNKNOWN_INERTIA_SCENARIO_NAME = "grasp_unknown_inertia"
"""Name of that in which the robot is told neither mass nor friction, and either may be anything."""


@dataclass(frozen=True)
class GraspBenchOptions(StudyOptions):
    """What is measured.

    Attributes:
        objects: names of shipped objects.
        seeds: number of hidden truths and noises of each object; the first one has the seed `seed`.
            Where nothing is told, the mass is drawn from the seed, and no two runs have the same.
        unknown_inertia: whether the robot is told neither mass nor friction, and weighs the object.
        camera: how the object is seen.
    """

    objects: tuple[str, ...] | None = option(None, **OBJECTS_OPTION)
    seeds: int = option(DEFAULT_SEED_COUNT, "Hidden truths and noises of each object.", least=1)
    unknown_inertia: bool = option(
        False, "Tell the robot neither mass nor friction: it weighs the object on the way."
    )
    camera: CameraKind = option("ideal", "What the robot sees; `gridpush demo --help` explains it.")

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the objects."""
        return DEFAULT_OBJECTS if self.objects is None else self.objects


@dataclass(frozen=True)
class GraspEpisode(EpisodeOutcome):
    """What came of a run, and what could have come of it.

    Attributes:
        could_be_held: whether a robot that knew the object's masses and frictions would see a way
            to hold it; None where its mass was told.
    """

    could_be_held: bool | None = None


def run_grasp(job: EpisodeJob) -> GraspEpisode:
    """Runs an episode, and says whether its object could be held."""
    outcome = GraspEpisode(**vars(run_episode(job)))
    if outcome.status in (REFUSED_STATUS, BROKEN_STATUS):
        return outcome
    # To make a station takes seconds.
    if not parse_scenario(Path("scenario.yaml"), job.scenario).unknown_inertia:
        return outcome
    task = make_episode_task(job)
    assert isinstance(task, PreGraspTask)
    return replace(outcome, could_be_held=task.could_hold())


def shorten(options: GraspBenchOptions) -> GraspBenchOptions:
    """Makes the options of the quick variant: the first object with the first seed."""
    return replace(options, objects=options.names[:1], seeds=min(options.seeds, 1))


def make_jobs(options: GraspBenchOptions) -> list[EpisodeJob]:
    """Makes an episode of each object and seed.

    Raises:
        ObjectError: an object is not shipped.
        GridPushError: there is no object, or no seed.
    """
    if not options.names:
        raise GridPushError("objects: none; expected at least one")
    if options.seeds < 1:
        raise GridPushError("seeds: none; expected at least one")
    for name in options.names:
        find_shipped_object(name)
    scenario = read_scenario(
        UNKNOWN_INERTIA_SCENARIO_NAME if options.unknown_inertia else SCENARIO_NAME
    )
    scenario.camera.use(options.camera)
    text = format_scenario(scenario)
    # The mass is drawn from the seed: where it is not told, no two runs have the same.
    apart, step = (1, len(options.names)) if options.unknown_inertia else (0, 1)
    return [
        EpisodeJob(object=name, seed=options.seed + apart * k + step * i, scenario=text)
        for k, name in enumerate(options.names)
        for i in range(options.seeds)
    ]


def tabulate(options: GraspBenchOptions, done: Done) -> list[Table]:
    """Tabulates the episodes by object, and what was learned where it was not told."""
    episodes = done.of(EPISODE_JOBS)
    weighed = [run for run in episodes if run.mass_holds is not None]
    return [
        tabulate_episodes(episodes, options.names),
        *([tabulate_learned(weighed, options.names)] if weighed else []),
    ]


def tabulate_episodes(episodes: Sequence[GraspEpisode], objects: Sequence[str]) -> Table:
    """Makes a row for each object, one of all, and a note for each run that did not end well."""
    held = str(TaskStatus.HELD)
    asked = any(run.could_be_held is not None for run in episodes)
    columns: dict[str, Column] = {
        "runs": len,
        **({"could be held": count_of("could_be_held", True)} if asked else {}),
        "held": count_of("outcome", held),
        "dropped": count_of("outcome", DROPPED_OUTCOME),
        "not lifted": count_of("outcome", NOT_LIFTED),
        "given up": count_of("outcome", GAVE_UP),
        "pokes": mean_of("pokes"),
        "slides": mean_of("slides"),
        "raised, mm": lambda runs: (
            MM_PER_M * calc_mean([run.raised for run in runs if run.outcome == held])
        ),
        "CoM error, mm": mean_of("center_of_mass_error", MM_PER_M),
        "simulated, s": mean_of("duration"),
        "wall, s": mean_of("wall"),
    }
    notes = [
        "An iiwa with a gripper, free base, pose noise; what an object weighs and how it rubs is "
        "hidden.",
        "held: lifted and held. dropped: off the table. not lifted: the gripper went up without "
        "it. given up: anything else, such as no safe way found.",
        "pokes, slides, raised, CoM error, simulated, wall: means of all runs; raised of those "
        "held.",
    ]
    if asked:
        notes.append(
            "could be held: a robot that knew the object's masses and frictions would see a way to "
            "hold it. The others are too heavy for the gripper, as far from their center of mass "
            "as it has to take them."
        )
    notes += [
        f"{run.object}, seed {run.seed}: {run.status}. {run.message}"
        for run in episodes
        if run.outcome != held
    ]
    title = "The whole story in the station: poke, learn, slide, grasp, lift, hold"
    return Table.of(title, ("object",), by_object(episodes, objects, key="object"), columns, notes)


def tabulate_learned(episodes: Sequence[EpisodeOutcome], objects: Sequence[str]) -> Table:
    """Makes a row for each object and one of all: errors at the end, and intervals that hold."""
    columns = {
        "runs": len,
        "mass off, %": _size_of("mass_error", PERCENT_PER_ONE),
        "CoM off, mm": _size_of("center_of_mass_error", MM_PER_M),
        "friction off": _size_of("friction_error"),
        "mass inside": _proportion_of("mass_holds"),
        "CoM inside": _proportion_of("center_holds"),
        "friction inside": _proportion_of("friction_holds"),
    }
    notes = [
        "off: medians of the errors' sizes. inside: runs whose stated 95 % interval, or region, "
        "holds the truth, with 95 % Wilson intervals."
    ]
    title = "What was learned of objects of which neither mass nor friction was told"
    return Table.of(title, ("object",), by_object(episodes, objects, key="object"), columns, notes)


def _size_of(field: str, scale: float = 1.0) -> Column:
    """Makes a column: the median size of a field."""
    return lambda runs: scale * float(np.median([abs(getattr(run, field)) for run in runs]))


def _proportion_of(field: str) -> Column:
    """Makes a column: how many runs have a field that is true, with its interval."""
    return lambda runs: Proportion.of(
        sum(getattr(run, field) for run in runs), len(runs)
    ).describe()


EPISODE_JOBS = JobKind(job=EpisodeJob, run=run_grasp, describe=EpisodeJob.describe)
"""What is done with an episode."""

STUDY = Study(
    name="grasp",
    help="Let the whole station poke objects, slide them to the table's edge, grasp and lift them.",
    options=GraspBenchOptions,
    shorten=shorten,
    make_jobs=make_jobs,
    tasks=(EPISODE_JOBS,),
    tabulate=tabulate,
)
"""`gridpush bench grasp`."""
