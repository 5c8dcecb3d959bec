"""`gridpush bench planning`: choosing contact points, and pushing objects to goal poses in closed loop."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from gridpush_drake.bench.jobs import QUIET, Execution, check_known, run_jobs
from gridpush_drake.bench.protocol import (
    ANGLE_STD,
    POSITION_STD,
    PUSHED_SHIPPED,
    hide_parts,
    list_objects,
    make_hidden,
    make_planning_protocol,
    read_planning_object,
)
from gridpush_drake.bench.table import (
    MM,
    MS,
    PERCENT,
    Column,
    Table,
    by_object,
    calc_mean,
    count_of,
    mean_of,
)
from gridpush_drake.bench.worlds import LCP, find_world
from gridpush_drake.errors import GridPushError
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.contact.optimization import optimize_contact
from gridpush_drake.planning.contact.trial import ContactOptions, calc_goal_error
from gridpush_drake.planning.goal.next_push import GoalRules, RobustnessOptions
from gridpush_drake.planning.goal.push_to_goal import push_to_goal
from gridpush_drake.planning.loop_run import Learner

LEARNING, UNIFORM, TRUE, LOOK_AHEAD = "learning", "uniform", "true", "true, two ahead"
"""Which model pushes are planned with: learned on the way, uniform throughout, the truth; that
looking two ahead."""

WITHIN = 0.001
"""m by which a decision may be worse than the exhaustive search's and count as good as it."""

GRADIENT, DIFFERENCES, EXHAUSTIVE = "gradient", "finite_difference", "exhaustive"
"""Methods of the contact points' search."""


@dataclass(frozen=True)
class Decision:
    """One choice of a push: by which method, its cost above the exhaustive search's, m, and wall clock, s."""

    name: str
    method: str
    simulations: int
    gap: float
    seconds: float


@dataclass(frozen=True)
class Run:
    """One object pushed towards one goal, planned with the model of a mode.

    The first push's prediction is off by `first_error`, m, the later ones by `later_error` on
    average; NaN without any.
    """

    name: str
    mode: str
    success: bool
    fell: bool
    pushes: int
    status: str
    first_error: float
    later_error: float
    simulations: int
    planning_seconds: float
    learning_seconds: float


def tabulate_decisions(decisions: Sequence[Decision], names: Sequence[str]) -> Table:
    """By object: how many simulations a decision takes, and how good it is beside the exhaustive search's."""

    def of(method: str, calc: Callable[[Any], Any], field: str, scale: float = 1.0) -> Column:
        return lambda some: (
            scale * float(calc([getattr(entry, field) for entry in some if entry.method == method]))
        )

    def share_within(gaps: Sequence[float]) -> float:
        return PERCENT * float(np.mean(np.array(gaps) <= WITHIN))

    columns: dict[str, Column] = {
        "decisions": count_of("method", GRADIENT),
        "simulations": of(GRADIENT, np.mean, "simulations"),
        "most": lambda some: max(entry.simulations for entry in some if entry.method == GRADIENT),
        "within 1 mm, %": of(GRADIENT, share_within, "gap"),
        "mean gap, mm": of(GRADIENT, np.mean, "gap", MM),
        "worst gap, mm": of(GRADIENT, max, "gap", MM),
        "ms": of(GRADIENT, np.median, "seconds", MS),
        "f. d. simulations": of(DIFFERENCES, np.mean, "simulations"),
        "f. d. within 1 mm, %": of(DIFFERENCES, share_within, "gap"),
        "f. d. ms": of(DIFFERENCES, np.median, "seconds", MS),
        "exhaustive simulations": of(EXHAUSTIVE, np.mean, "simulations"),
        "exhaustive ms": of(EXHAUSTIVE, np.median, "seconds", MS),
    }
    notes = [
        "One push towards the goal, the masses drawn by part. A simulation with its exact Jacobian counts as one; one "
        "simulation of a straight push tells the best distance along it too, in every method.",
        "The gradient method's starts are ranked by the ellipsoidal limit surface: no simulation, but counted in ms.",
        "Gap: mean cell error at the push's end above the exhaustive search's, a grid walked on from its best nodes; "
        "negative is better.",
        "f. d.: finite differences, the paper's walk along the outline. Times are medians of wall clock.",
    ]
    return Table.of(
        "Choosing a contact point", ("object",), by_object(decisions, names), columns, notes
    )


def tabulate_runs(
    runs: Sequence[Run], names: Sequence[str], modes: Sequence[str], max_pushes: int
) -> Table:
    """By model and object: how often the goal is reached, and with how many pushes."""
    groups = [
        group
        for mode in modes
        for group in by_object([run for run in runs if run.mode == mode], names, mode)
    ]
    columns: dict[str, Column] = {
        "runs": len,
        "success, %": mean_of("success", PERCENT),
        "off the table": count_of("fell", True),
        "pushes": mean_of("pushes"),
        "90 %": lambda some: float(np.quantile([run.pushes for run in some], 0.9)),
        "most": lambda some: max(run.pushes for run in some),
        "first prediction, mm": mean_of("first_error", MM),
        "later, mm": mean_of("later_error", MM),
        "simulations": mean_of("simulations"),
        "planning, s": mean_of("planning_seconds"),
        "learning, s": mean_of("learning_seconds"),
    }
    failed = sorted({run.status for run in runs if not run.success})
    notes = [
        f"Success: mean cell error under 2 cm within {max_pushes} pushes, on the round table of radius 0.5 m.",
        "Hidden masses by part; poses seen with 0.5 mm and 0.003 rad of noise. "
        "The table's edge does not change how the object rubs; it falls where its center of mass loses its support.",
        "Models: learned on the way from the uniform one; uniform throughout; the true one, looking one push ahead "
        "(as the others do) and two.",
        "Predictions: mean cell error of a push's predicted end, of the first push and of the later ones.",
        "Pushes and seconds are means over the runs; the planner's simulations and seconds are a whole run's.",
    ]
    if failed:
        notes.append(f"Runs without success ended with: {', '.join(failed)}.")
    return Table.of("Pushing to a goal", ("model", "object"), groups, columns, notes)


SETS, QUICK_SETS = 10, 1
PAIRS, QUICK_PAIRS = 10, 3

Part = Literal["contact", "push"]
PART_NAMES: dict[Part, str] = {"contact": "contact points", "push": "pushing"}
PARTS = tuple(PART_NAMES)

METHOD_BUDGETS = {GRADIENT: 44, DIFFERENCES: 75}
"""Most simulations a decision; of the finite differences, the most that the paper's took."""

PARAMETER_SEED = 100
"""Of the first random parameter set of the contact points."""

SUCCESS, TOLERANCE = 0.02, 0.018
"""m, true mean cell error below which a run has succeeded (the paper's), and the seen one at which
the driver stops: less, for it sees poses with noise."""

MAX_PUSHES = 25


@dataclass(frozen=True)
class Job:
    """One object with one parameter or mass set, some pairs of poses, and the modes of the models to push with."""

    kind: Part
    data: Path | None
    name: str
    number: int
    pairs: int
    modes: tuple[str, ...]
    seed: int
    world: str = LCP


def run(
    data: Path | str | None = None,
    sets: int = SETS,
    objects: Sequence[str] | None = None,
    modes: Sequence[str] = (LEARNING, UNIFORM, TRUE, LOOK_AHEAD),
    parts: Sequence[Part] = PARTS,
    seed: int = 0,
    execution: Execution = QUIET,
    *,
    quick: bool = False,
    world: str = LCP,
) -> list[Table]:
    """Measures the choice of contact points, and pushing to goal poses on the round table.

    The arguments are the options of `gridpush bench planning`, and `modes` which model pushes are
    planned with; `world` is the name of the world in which objects are pushed, see
    `bench.worlds`. Without `objects`, contact points are chosen on all, and the masks and
    `PUSHED_SHIPPED` are pushed. One set, and three pairs of poses, where `quick`.

    Returns:
        Simulations, gap to the exhaustive optimum and time of a decision, by object; success,
        pushes and time of a run, by model and object.

    Raises:
        GridPushError: the data are not there, or an argument is out of range.
    """
    folder = None if data is None else Path(data).resolve()
    protocol = make_planning_protocol(folder, seed)
    known = list_objects(protocol)
    check_known("objects", objects or known, known)
    if not 1 <= sets <= protocol.mass_sets:
        raise GridPushError(f"sets: {sets}; expected 1 to {protocol.mass_sets}")
    find_world(world)
    count, pairs = (QUICK_SETS, QUICK_PAIRS) if quick else (sets, len(protocol.pairs))
    names = {
        "contact": list(objects or known),
        "push": list(objects or list_objects(protocol, PUSHED_SHIPPED)),
    }
    jobs = [
        Job(
            kind=part,
            data=folder,
            name=name,
            number=number,
            pairs=pairs,
            modes=tuple(modes),
            seed=seed,
            world=world,
        )
        for part in parts
        for number in range(count)
        for name in names[part]
    ]
    results = run_jobs(
        run_job,
        jobs,
        lambda job: f"{PART_NAMES[job.kind]}: {job.name}, set {job.number}",
        execution,
    )
    decisions = [entry for result in results for entry in result if isinstance(entry, Decision)]
    runs = [entry for result in results for entry in result if isinstance(entry, Run)]
    tables = [tabulate_decisions(decisions, names["contact"])] if "contact" in parts else []
    return tables + (
        [tabulate_runs(runs, names["push"], modes, MAX_PUSHES)] if "push" in parts else []
    )


def run_job(job: Job) -> list[Decision | Run]:
    """Does one job."""
    return [*(_decide(job) if job.kind == "contact" else _push(job))]


def _decide(job: Job) -> list[Decision]:
    """Every method's choice of the first push, for each pair of poses."""
    protocol = make_planning_protocol(job.data, job.seed)
    obj = read_planning_object(protocol, job.name)
    params = CellParameters.random(obj, PARAMETER_SEED + job.number)
    options = ContactOptions()
    decisions = []
    for start, goal in protocol.pairs[: job.pairs]:
        best = optimize_contact(obj, params, start, goal, method=EXHAUSTIVE, options=options)
        plans = [best]
        for method, budget in METHOD_BUDGETS.items():
            chosen = replace(options, budget=budget, seed=job.seed)
            plans.append(optimize_contact(obj, params, start, goal, method=method, options=chosen))
        decisions += [
            Decision(job.name, plan.method, plan.simulations, plan.cost - best.cost, plan.seconds)
            for plan in plans
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
            world = find_world(job.world)(
                obj,
                hidden,
                start,
                protocol.surface,
                position_std=POSITION_STD,
                angle_std=ANGLE_STD,
                seed=job.seed + pair,
            )
            done = push_to_goal(
                world, plain, goal,
                GoalRules(
                    protocol.constraints, ContactOptions(), 2 if mode == LOOK_AHEAD else 1,
                    None if mode in (TRUE, LOOK_AHEAD) else RobustnessOptions(seed=job.seed), TOLERANCE, MAX_PUSHES,
                ),
                params=hidden if mode in (TRUE, LOOK_AHEAD) else None,
                learner=Learner(seed=job.seed) if mode == LEARNING else None,
            )  # fmt: skip
            errors = [step.prediction_error for step in done.steps]
            truth = world.truth
            error = float(calc_goal_error(obj, truth.pose, goal))
            runs.append(
                Run(
                    job.name, mode, not truth.fallen and error < SUCCESS, truth.fallen, len(done.steps), done.status,
                    errors[0] if errors else np.nan, calc_mean(errors[1:]),
                    done.simulations, done.planning_seconds, done.learning_seconds,
                )
            )  # fmt: skip
    return runs
