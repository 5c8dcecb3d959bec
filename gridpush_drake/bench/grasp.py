"""`gridpush bench grasp`: the whole story in the station; what is poked, slid to the edge, grasped, lifted and held."""

from collections.abc import Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np

from gridpush_drake.bench.jobs import QUIET, Execution, ObjectJob, run_jobs
from gridpush_drake.bench.table import MM, Table, Value, calc_mean
from gridpush_drake.errors import GridPushError
from gridpush_drake.multibody.parser import find_models
from gridpush_drake.objects.object_file import find_shipped_object
from gridpush_drake.station.pregrasp_task import PreGraspTask
from gridpush_drake.station.scenario import read_scenario

if TYPE_CHECKING:
    from gridpush_drake.station.pregrasp_task import PreGraspRecord

OBJECTS = ("claw_hammer", "combination_wrench", "spray_bottle")
SEEDS = (0, 1, 2)

SCENARIO = "scenarios/grasp.yaml"
"""Among the shipped models."""

HELD, DROPPED = "held", "dropped"
"""Of the statuses that `station.pregrasp_task` ends with; with any other the object was given up."""


COLUMNS = (
    "object", "runs", "held", "dropped", "given up", "pokes", "slides", "raised, mm", "CoM error, mm", "simulated, s",
    "wall, s",
)  # fmt: skip


@dataclass(frozen=True)
class GraspScore:
    """What came of one run.

    Attributes:
        name: of the object.
        seed: of the run.
        status: of the run, "held" where all went well.
        message: the status in a sentence.
        pokes: made.
        slides: made.
        raised: how far the object's lowest point was above the table at the end, m.
        center_of_mass_error: of the last estimate, m; NaN where nothing was learned.
        duration: simulated, s.
        wall: what the run took, s, without making the station.
    """

    name: str
    seed: int
    status: str
    message: str
    pokes: int
    slides: int
    raised: float
    center_of_mass_error: float
    duration: float
    wall: float


def run(
    objects: Sequence[str] = OBJECTS,
    seeds: Sequence[int] = SEEDS,
    *,
    quick: bool = False,
    execution: Execution = QUIET,
) -> list[Table]:
    """Runs the whole story with every object and seed.

    Args:
        objects: shipped objects' names.
        seeds: of the runs with each.
        quick: only the first object and the first seed.
        execution: how the jobs are run.

    Returns:
        One table, a row an object and one of all.

    Raises:
        ObjectError: an object is not shipped.
        GridPushError: there is no object, or no seed.
    """
    if not objects or not seeds:
        raise GridPushError(f"{'seeds' if objects else 'objects'}: none; expected at least one")
    for name in objects:
        find_shipped_object(name)
    if quick:
        objects, seeds = objects[:1], seeds[:1]
    jobs = [ObjectJob(name, seed) for name in objects for seed in seeds]
    scores = run_jobs(run_job, jobs, ObjectJob.describe, execution)
    return [tabulate(scores, objects)]


def run_job(job: ObjectJob) -> GraspScore:
    """Runs one object and seed in the shipped scenario."""
    scenario = read_scenario(find_models() / SCENARIO)
    scenario.object, scenario.seed = job.name, job.seed
    task = PreGraspTask(scenario)
    begin = perf_counter()
    record = task.run()
    return make_score(job, record, perf_counter() - begin)


def make_score(job: ObjectJob, record: "PreGraspRecord", wall: float) -> GraspScore:
    """What came of a run that took `wall` seconds."""
    error = float("nan")
    if record.estimates:
        assert record.truth is not None  # of a simulated object it is known
        found, truth = (params.center_of_mass(record.obj) for params in (record.estimates[-1].params, record.truth))
        error = float(np.linalg.norm(found - truth))
    last = record.last
    return GraspScore(
        job.name, job.seed, record.status, record.message, last.pokes, last.slides, record.raised, error,
        record.duration, wall,
    )  # fmt: skip


def tabulate(scores: Sequence[GraspScore], objects: Sequence[str]) -> Table:
    """A row an object, one of all, and a note for each run that did not end with the object held."""
    rows = [_make_row(name, [score for score in scores if score.name == name]) for name in objects]
    rows.append(_make_row("all", scores))
    notes = [
        "An iiwa with a gripper, free base, pose noise; what an object weighs and how it rubs is hidden.",
        "held: lifted and held. dropped: off the table or out of the gripper. given up: anything else, such as no safe "
        "way found.",
        "pokes, slides, raised, CoM error, simulated, wall: means of all runs; raised of those held.",
    ]
    notes += [
        f"{score.name}, seed {score.seed}: {score.status}. {score.message}" for score in scores if score.status != HELD
    ]
    return Table("The whole story in the station: poke, learn, slide, grasp, lift, hold", COLUMNS, rows, notes)


def _make_row(name: str, scores: Sequence[GraspScore]) -> tuple[Value, ...]:
    held, dropped = (sum(score.status == status for score in scores) for status in (HELD, DROPPED))
    return (
        name, len(scores), held, dropped, len(scores) - held - dropped,
        calc_mean([score.pokes for score in scores]), calc_mean([score.slides for score in scores]),
        MM * calc_mean([score.raised for score in scores if score.status == HELD]),
        MM * calc_mean([score.center_of_mass_error for score in scores]),
        calc_mean([score.duration for score in scores]), calc_mean([score.wall for score in scores]),
    )  # fmt: skip
