"""`gridpush bench grasp`: the whole story in the station; what is poked, slid to the edge, grasped, lifted and held.

Its runs are episodes of a campaign with the shipped scenario.
"""

from collections.abc import Sequence

from gridpush_drake.bench.campaign import (
    DROPPED,
    GAVE_UP,
    NOT_LIFTED,
    Episode,
    EpisodeJob,
    run_episode,
)
from gridpush_drake.bench.jobs import QUIET, Execution, run_jobs
from gridpush_drake.bench.table import MM, Table, by_object, calc_mean, count_of, mean_of
from gridpush_drake.errors import GridPushError
from gridpush_drake.objects.object_file import find_shipped_object
from gridpush_drake.station.scenario_file import format_scenario, read_scenario
from gridpush_drake.station.task import TaskStatus

OBJECTS = ("claw_hammer", "combination_wrench", "spray_bottle")
SEEDS = (0, 1, 2)

SCENARIO = "grasp"
"""Name of the shipped scenario of its episodes."""


def run(
    objects: Sequence[str] = OBJECTS,
    seeds: Sequence[int] = SEEDS,
    *,
    quick: bool = False,
    execution: Execution = QUIET,
) -> list[Table]:
    """Runs the whole story with every shipped object and seed; with the first of each only where `quick`.

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
    scenario = format_scenario(read_scenario(SCENARIO))
    jobs = [EpisodeJob(name, seed, scenario=scenario) for name in objects for seed in seeds]
    return [tabulate(run_jobs(run_episode, jobs, EpisodeJob.describe, execution), objects)]


def tabulate(episodes: Sequence[Episode], objects: Sequence[str]) -> Table:
    """A row an object, one of all, and a note for each run that did not end with the object held."""
    held = str(TaskStatus.HELD)
    columns = {
        "runs": len,
        "held": count_of("outcome", held),
        "dropped": count_of("outcome", DROPPED),
        "not lifted": count_of("outcome", NOT_LIFTED),
        "given up": count_of("outcome", GAVE_UP),
        "pokes": mean_of("pokes"),
        "slides": mean_of("slides"),
        "raised, mm": lambda runs: (
            MM * calc_mean([run.raised for run in runs if run.outcome == held])
        ),
        "CoM error, mm": mean_of("center_of_mass_error", MM),
        "simulated, s": mean_of("duration"),
        "wall, s": mean_of("wall"),
    }
    notes = [
        "An iiwa with a gripper, free base, pose noise; what an object weighs and how it rubs is hidden.",
        "held: lifted and held. dropped: off the table. not lifted: the gripper went up without it. given up: "
        "anything else, such as no safe way found.",
        "pokes, slides, raised, CoM error, simulated, wall: means of all runs; raised of those held.",
    ]
    notes += [
        f"{run.object}, seed {run.seed}: {run.status}. {run.message}"
        for run in episodes
        if run.outcome != held
    ]
    title = "The whole story in the station: poke, learn, slide, grasp, lift, hold"
    return Table.of(title, ("object",), by_object(episodes, objects, key="object"), columns, notes)
