"""`gridpush bench planning`: choosing contact points, and pushing objects to goal poses in closed loop."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from gridpush_drake.bench.planning_protocol import (
    FINGER_RADIUS,
    PUSHED_SHIPPED,
    hide_parts,
    list_objects,
    make_hidden,
    make_planning_protocol,
    read_planning_object,
)
from gridpush_drake.bench.planning_tables import (
    LEARNING,
    LOOK_AHEAD,
    TRUE,
    UNIFORM,
    Decision,
    Run,
    tabulate_decisions,
    tabulate_runs,
)
from gridpush_drake.bench.table import Table
from gridpush_drake.bench.workers import QUIET, Conduct, run_jobs
from gridpush_drake.errors import GridPushError
from gridpush_drake.grid.parameters import CellParameters
from gridpush_drake.planning.contact_point import ContactOptions, optimise_contact, with_search
from gridpush_drake.planning.next_push import HorizonOptions
from gridpush_drake.planning.planned_push import calc_goal_error
from gridpush_drake.planning.push_caution import CautionOptions
from gridpush_drake.planning.push_learner import LearningOptions
from gridpush_drake.planning.push_to_goal import PushStep, push_to_goal
from gridpush_drake.planning.push_world import SimulatedWorld

SETS, QUICK_SETS = 10, 1
PAIRS, QUICK_PAIRS = 10, 3

Part = Literal["contact", "push"]
PARTS: tuple[Part, ...] = ("contact", "push")
"""Contact points, and pushing."""

METHOD_BUDGETS = {"gradient": 44, "finite_difference": 75}
"""Most simulations a decision; of the finite differences, the most that the paper's took."""

PARAMETER_SEED = 100
"""Of the first random parameter set of the contact points."""

POSITION_STD, ANGLE_STD = 0.0005, 0.003
"""Noise of the poses that are seen, m per axis and rad."""

SUCCESS = 0.02
"""True mean cell error below which a run has succeeded, m (the paper's)."""

TOLERANCE = 0.018
"""Seen mean cell error at which the driver stops, m: below SUCCESS, for it sees poses with noise."""

MAX_PUSHES = 25


@dataclass(frozen=True)
class Job:
    """One object with one set of parameters.

    Attributes:
        kind: "contact" or "push".
        data: folder of the masks.
        name: of the object.
        number: of the parameter or mass set.
        pairs: how many of the start and goal poses.
        modes: of the models to push with.
        seed: of the noise and the learning.
    """

    kind: Part
    data: Path | None
    name: str
    number: int
    pairs: int
    modes: tuple[str, ...]
    seed: int


def run(
    data: Path | str | None = None,
    sets: int = SETS,
    objects: Sequence[str] | None = None,
    modes: Sequence[str] = (LEARNING, UNIFORM, TRUE, LOOK_AHEAD),
    parts: Sequence[Part] = PARTS,
    seed: int = 0,
    conduct: Conduct = QUIET,
    *,
    quick: bool = False,
) -> list[Table]:
    """Measures the choice of contact points, and pushing to goal poses on the round table.

    Args:
        data: folder of the paper's masks; None for the shipped objects alone.
        sets: how many parameter sets (contact points) and mass sets (pushing) of each object.
        objects: names of masks and shipped objects; where None, all for the contact points, and for the pushing the
            masks and `PUSHED_SHIPPED`.
        modes: of the pushing: which model it plans with.
        parts: "contact" and "push", or one of them.
        seed: of everything random.
        conduct: how the jobs are run.
        quick: one set, and three pairs of poses.

    Returns:
        Simulations, gap to the exhaustive optimum and time of a decision, by object; success, pushes and time of a run,
        by model and object.

    Raises:
        GridPushError: the data are not there, or an argument is out of range.
    """
    folder = None if data is None else Path(data).resolve()
    protocol = make_planning_protocol(folder, seed)
    known = list_objects(protocol)
    unknown = [name for name in objects or () if name not in known]
    if unknown:
        raise GridPushError(f"objects: {', '.join(unknown)}; expected some of {', '.join(known)}")
    if not 1 <= sets <= protocol.mass_sets:
        raise GridPushError(f"sets: {sets}; expected 1 to {protocol.mass_sets}")
    count, pairs = (QUICK_SETS, QUICK_PAIRS) if quick else (sets, len(protocol.pairs))
    names = {
        "contact": list(objects or known),
        "push": list(objects or list_objects(protocol, PUSHED_SHIPPED)),
    }
    jobs = [
        Job(part, folder, name, number, pairs, tuple(modes), seed)
        for part in parts
        for number in range(count)
        for name in names[part]
    ]
    results = run_jobs(run_job, jobs, _describe, conduct)
    decisions = [entry for result in results for entry in result if isinstance(entry, Decision)]
    runs = [entry for result in results for entry in result if isinstance(entry, Run)]
    tables = [tabulate_decisions(decisions, names["contact"])] if "contact" in parts else []
    return tables + ([tabulate_runs(runs, names["push"], modes, MAX_PUSHES)] if "push" in parts else [])


def run_job(job: Job) -> list[Decision | Run]:
    """Does one job."""
    return list(_decide(job) if job.kind == "contact" else _push(job))


def _decide(job: Job) -> list[Decision]:
    """Every method's choice of the first push, for each pair of poses."""
    protocol = make_planning_protocol(job.data, job.seed)
    obj = read_planning_object(protocol, job.name)
    params = CellParameters.random(obj, PARAMETER_SEED + job.number)
    options = ContactOptions(radius=FINGER_RADIUS)
    decisions = []
    for start, goal in protocol.pairs[: job.pairs]:
        best = optimise_contact(obj, params, start, goal, method="exhaustive", options=options)
        plans = [best]
        for method, budget in METHOD_BUDGETS.items():
            chosen = with_search(options, budget=budget, seed=job.seed)
            plans.append(optimise_contact(obj, params, start, goal, method=method, options=chosen))
        decisions += [
            Decision(job.name, plan.method, plan.simulations, plan.cost - best.cost, plan.seconds) for plan in plans
        ]
    return decisions


def _push(job: Job) -> list[Run]:
    """Runs in closed loop, for each pair of poses and each model to plan with."""
    protocol = make_planning_protocol(job.data, job.seed)
    obj = read_planning_object(protocol, job.name)
    hidden, plain = make_hidden(protocol, job.name, job.number), hide_parts(obj)
    runs = []
    for pair, (start, goal) in enumerate(protocol.pairs[: job.pairs]):
        for mode in job.modes:
            world = SimulatedWorld(
                obj, hidden, start, protocol.surface, position_std=POSITION_STD, angle_std=ANGLE_STD,
                seed=job.seed + pair,
            )  # fmt: skip
            done = push_to_goal(
                world, plain, goal,
                params=hidden if mode in (TRUE, LOOK_AHEAD) else None,
                learning=LearningOptions(seed=job.seed) if mode == LEARNING else None,
                constraints=protocol.constraints,
                options=ContactOptions(radius=FINGER_RADIUS),
                caution=None if mode in (TRUE, LOOK_AHEAD) else CautionOptions(seed=job.seed),
                horizons=HorizonOptions(horizon=2 if mode == LOOK_AHEAD else 1),
                tolerance=TOLERANCE, max_pushes=MAX_PUSHES,
            )  # fmt: skip
            error = float(calc_goal_error(obj, world.true_pose, goal))
            runs.append(
                Run(
                    job.name, mode, not world.fallen and error < SUCCESS, world.fallen, len(done.steps), done.status,
                    *_split(done.steps),
                    done.simulations, done.planning_seconds, done.learning_seconds,
                )
            )  # fmt: skip
    return runs


def _split(steps: Sequence[PushStep]) -> tuple[float, float]:
    """Prediction error of the first push, and the mean of the later ones, m; NaN where there are none."""
    errors = [step.prediction_error for step in steps]
    first, later = errors[:1], errors[1:]
    return first[0] if first else float("nan"), float(np.mean(later)) if later else float("nan")


def _describe(job: Job) -> str:
    return f"{'contact points' if job.kind == 'contact' else 'pushing'}: {job.name}, set {job.number}"
