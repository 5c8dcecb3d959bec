"""`gridpush bench planning`: choosing contact points, and pushing objects to goal poses.

The objects are the shipped ones and, where they are given, the paper's masks. Contact points are
chosen by three methods, of which the exhaustive search judges the others. Pushing to a goal is a
closed loop in a world, with models that know more or less of the object.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from gridpush_drake.bench.data.protocol import (
    ANGLE_STD,
    POSITION_STD,
    PUSHED_SHIPPED,
    PlanningProtocol,
    hide_parts,
    list_objects,
    make_hidden,
    make_planning_protocol,
    read_planning_object,
)
from gridpush_drake.bench.study import (
    MASKS_OPTION,
    OBJECTS_OPTION,
    Done,
    JobKind,
    Study,
    StudyOptions,
    option,
)
from gridpush_drake.bench.worlds.by_name import LCP_WORLD, find_world
from gridpush_drake.errors import GridPushError
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.model import Model
from gridpush_drake.jobs.run import check_known
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.contact.optimization import optimize_contact
from gridpush_drake.planning.contact.trial import ContactOptions, calc_goal_error
from gridpush_drake.planning.goal.next_push import GoalRules, RobustnessOptions
from gridpush_drake.planning.goal.push_to_goal import push_to_goal
from gridpush_drake.planning.loop_run import Learner
from gridpush_drake.report.table import Column, Table, by_object, calc_mean, count_of, mean_of
from gridpush_drake.units import MM_PER_M, MS_PER_S, PERCENT_PER_ONE

LEARNING_MODEL = "learning"
"""Name of the model that is learned on the way."""

UNIFORM_MODEL = "uniform"
"""Name of the model whose masses and frictions are the same everywhere throughout."""

TRUE_MODEL = "true"
"""Name of the true model."""

LOOK_AHEAD = "true, two ahead"
"""Name of the true model, with which pushes are planned two ahead."""

PLANNING_MODELS = (LEARNING_MODEL, UNIFORM_MODEL, TRUE_MODEL, LOOK_AHEAD)
"""Models that pushes are planned with."""

GOOD_DECISION_COST = 0.001
"""Cost by which a decision may be worse than the exhaustive search's and count as good as it, m."""

GRADIENT_SEARCH = "gradient"
"""Name of the search for a contact point by exact gradients."""

DIFFERENCE_SEARCH = "finite_difference"
"""Name of the search for a contact point by finite differences."""

EXHAUSTIVE_SEARCH = "exhaustive"
"""Name of the exhaustive search for a contact point."""

METHOD_BUDGETS = {GRADIENT_SEARCH: 44, DIFFERENCE_SEARCH: 75}
"""Greatest numbers of simulations of a decision; of the finite differences, the most that the
paper's took."""

PARAMETER_SEED = 100
"""Seed of the first random parameter set of the contact points."""

SUCCESS_ERROR = 0.02
"""True mean cell error below which a run has succeeded, m; the paper's."""

GOAL_TOLERANCE = 0.018
"""Seen mean cell error below which the closed loop stops, m: less than SUCCESS_ERROR, for it sees
poses with noise."""

MAX_PUSHES = 25
"""Greatest number of pushes towards a goal."""

QUICK_SETS = 1
"""Number of parameter or mass sets of each object in the quick variant."""

QUICK_PAIRS = 3
"""Number of pairs of start and goal poses in the quick variant."""

CONTACT_PART = "contact"
"""Name of the part that chooses contact points."""

PUSH_PART = "push"
"""Name of the part that pushes to goals."""

PART_NAMES = {CONTACT_PART: "contact points", PUSH_PART: "pushing"}
"""What the parts are called while they run."""

OBSERVATION_SENTENCE = f"poses seen with {1e3 * POSITION_STD:g} mm and {ANGLE_STD:g} rad of noise."
"""How the object is seen, in words."""

WORLD_NOTES = {
    LCP_WORLD: f"Hidden masses by part; {OBSERVATION_SENTENCE} The table's edge does not change "
    "how the object rubs; it "
    "falls where its center of mass loses its support."
}
"""What a reader of the table should know of a world, by its name."""


@dataclass(frozen=True)
class PlanningBenchOptions(StudyOptions):
    """What is measured.

    Attributes:
        data: folder of the paper's masks; None for the shipped objects alone.
        objects: names of objects. By default contact points are chosen on all, and the masks and
            `PUSHED_SHIPPED` are pushed.
        sets: number of parameter and mass sets of each object.
        part: which part is measured.
        world: name of the world in which objects are pushed, see `bench.worlds.by_name`.
        modes: models that pushes are planned with, of PLANNING_MODELS.
        pairs: number of pairs of start and goal poses; all of the protocol's where None.
    """

    data: Path | None = option(None, **MASKS_OPTION)
    objects: tuple[str, ...] | None = option(None, **OBJECTS_OPTION)
    sets: int = option(10, "Parameter and mass sets of each object.", least=1)
    part: Literal["all", "contact", "push"] = option("all", "Which part to measure.")
    world: str = option(
        LCP_WORLD,
        "What moves the objects that are pushed: lcp, edge, mujoco or drake, or MODULE:CLASS of a "
        "world of your own.",
        metavar="WORLD",
    )
    modes: tuple[str, ...] = PLANNING_MODELS
    pairs: int | None = None

    @property
    def parts(self) -> tuple[str, ...]:
        """The parts that are measured."""
        return tuple(PART_NAMES) if self.part == "all" else (self.part,)


@dataclass(frozen=True)
class PlanningJob:
    """One object with one parameter or mass set.

    Attributes:
        kind: the part.
        data: folder of the paper's masks; None without them.
        name: name of the object.
        number: number of the parameter or mass set.
        pairs: number of pairs of start and goal poses.
        modes: models that pushes are planned with.
        seed: seed of everything random.
        world: name of the world in which the object is pushed.
    """

    kind: str
    data: Path | None
    name: str
    number: int
    pairs: int
    modes: tuple[str, ...]
    seed: int
    world: str = LCP_WORLD


@dataclass(frozen=True)
class Decision:
    """One choice of a push.

    Attributes:
        name: name of the object.
        method: method of the search.
        simulations: number of simulated pushes.
        gap: its cost above the exhaustive search's, m.
        seconds: wall-clock time, s.
    """

    name: str
    method: str
    simulations: int
    gap: float
    seconds: float


@dataclass(frozen=True)
class Run:
    """One object pushed towards one goal.

    Attributes:
        name: name of the object.
        mode: model that pushes were planned with.
        success: whether the object truly came to its goal.
        fell: whether it fell off the table.
        pushes: number of pushes.
        status: how the closed loop ended.
        first_error: how far the first push's prediction was off, m; NaN without a push.
        later_error: how far the later pushes' predictions were off on average, m; NaN without any.
        simulations: number of pushes that the planner simulated.
        planning_seconds: wall-clock time of planning, s.
        learning_seconds: wall-clock time of learning, s.
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


def shorten(options: PlanningBenchOptions) -> PlanningBenchOptions:
    """Makes the options of the quick variant."""
    return replace(options, sets=QUICK_SETS, pairs=QUICK_PAIRS)


def make_jobs(options: PlanningBenchOptions) -> list[PlanningJob]:
    """Makes a job for each part, set and object.

    Raises:
        GridPushError: the data are not there, or an option is out of range.
    """
    folder, protocol = _read_protocol(options)
    known = list_objects(protocol)
    check_known("objects", options.objects or known, known)
    if not 1 <= options.sets <= protocol.mass_sets:
        raise GridPushError(f"sets: {options.sets}; expected 1 to {protocol.mass_sets}")
    find_world(options.world)
    return [
        PlanningJob(
            kind=part,
            data=folder,
            name=name,
            number=number,
            pairs=len(protocol.pairs) if options.pairs is None else options.pairs,
            modes=options.modes,
            seed=options.seed,
            world=options.world,
        )
        for part in options.parts
        for number in range(options.sets)
        for name in _list_names(options, protocol, part)
    ]


def _read_protocol(options: PlanningBenchOptions) -> tuple[Path | None, PlanningProtocol]:
    folder = None if options.data is None else Path(options.data).resolve()
    return folder, make_planning_protocol(folder, options.seed)


def _list_names(options: PlanningBenchOptions, protocol: PlanningProtocol, part: str) -> list[str]:
    """Returns the names of the objects of a part."""
    if options.objects:
        return list(options.objects)
    return (
        list_objects(protocol) if part == CONTACT_PART else list_objects(protocol, PUSHED_SHIPPED)
    )


def run_job(job: PlanningJob) -> list[Decision | Run]:
    """Does one job."""
    return [*(_decide(job) if job.kind == CONTACT_PART else _push(job))]


def _decide(job: PlanningJob) -> list[Decision]:
    """Chooses the first push by every method, for each pair of poses."""
    protocol = make_planning_protocol(job.data, job.seed)
    obj = read_planning_object(protocol, job.name)
    params = CellParameters.random(obj, PARAMETER_SEED + job.number)
    options = ContactOptions()
    decisions = []
    for start, goal in protocol.pairs[: job.pairs]:
        best = optimize_contact(
            Model(obj, params), start, goal, method=EXHAUSTIVE_SEARCH, options=options
        )
        plans = [best]
        for method, budget in METHOD_BUDGETS.items():
            chosen = replace(options, budget=budget, seed=job.seed)
            plans.append(
                optimize_contact(Model(obj, params), start, goal, method=method, options=chosen)
            )
        decisions += [
            Decision(
                name=job.name,
                method=plan.method,
                simulations=plan.simulations,
                gap=plan.cost - best.cost,
                seconds=plan.seconds,
            )
            for plan in plans
        ]
    return decisions


def _push(job: PlanningJob) -> list[Run]:
    """Pushes in closed loop, for each pair of poses and each model to plan with."""
    protocol = make_planning_protocol(job.data, job.seed)
    obj = read_planning_object(protocol, job.name)
    hidden = make_hidden(protocol, job.name, job.number)
    return [
        _push_once(job, protocol, obj, hidden, pair, mode)
        for pair in range(min(job.pairs, len(protocol.pairs)))
        for mode in job.modes
    ]


def _push_once(
    job: PlanningJob,
    protocol: PlanningProtocol,
    obj: GridObject,
    hidden: CellParameters,
    pair: int,
    mode: str,
) -> Run:
    """Pushes an object once from start to goal, planned with the model of a mode."""
    start: Array
    goal: Array
    start, goal = protocol.pairs[pair]
    world = find_world(job.world)(
        Model(obj, hidden),
        start,
        protocol.surface,
        position_std=POSITION_STD,
        angle_std=ANGLE_STD,
        seed=job.seed + pair,
    )
    knows_all = mode in (TRUE_MODEL, LOOK_AHEAD)
    rules = GoalRules(
        constraints=protocol.constraints,
        contact=ContactOptions(),
        horizon=2 if mode == LOOK_AHEAD else 1,
        robustness=None if knows_all else RobustnessOptions(seed=job.seed),
        tolerance=GOAL_TOLERANCE,
        max_pushes=MAX_PUSHES,
    )
    done = push_to_goal(
        world,
        Model(hide_parts(obj), hidden if knows_all else None),
        goal,
        rules,
        learner=Learner(seed=job.seed) if mode == LEARNING_MODEL else None,
    )
    truth = world.truth
    errors = [step.prediction_error for step in done.steps]
    return Run(
        name=job.name,
        mode=mode,
        success=not truth.fallen and float(calc_goal_error(obj, truth.pose, goal)) < SUCCESS_ERROR,
        fell=bool(truth.fallen),
        pushes=len(done.steps),
        status=done.status,
        first_error=errors[0] if errors else np.nan,
        later_error=calc_mean(errors[1:]),
        simulations=done.simulations,
        planning_seconds=done.planning_seconds,
        learning_seconds=done.learning_seconds,
    )


def tabulate(options: PlanningBenchOptions, done: Done) -> list[Table]:
    """Tabulates the decisions by object, and the runs by model and object."""
    _, protocol = _read_protocol(options)
    results = [entry for entries in done.of(PLANNING_JOBS) for entry in entries]
    decisions = [entry for entry in results if isinstance(entry, Decision)]
    runs = [entry for entry in results if isinstance(entry, Run)]
    tables = []
    if CONTACT_PART in options.parts:
        tables.append(tabulate_decisions(decisions, _list_names(options, protocol, CONTACT_PART)))
    if PUSH_PART in options.parts:
        names = _list_names(options, protocol, PUSH_PART)
        tables.append(tabulate_runs(runs, names, options.modes, options.world))
    return tables


def tabulate_decisions(decisions: Sequence[Decision], names: Sequence[str]) -> Table:
    """Tabulates by object how many simulations a decision takes, and how good it is."""

    def of(method: str, calc: Callable[[Any], Any], field: str, scale: float = 1.0) -> Column:
        return lambda some: (
            scale * float(calc([getattr(entry, field) for entry in some if entry.method == method]))
        )

    def fraction_within(gaps: Sequence[float]) -> float:
        return PERCENT_PER_ONE * float(np.mean(np.array(gaps) <= GOOD_DECISION_COST))

    columns: dict[str, Column] = {
        "decisions": count_of("method", GRADIENT_SEARCH),
        "simulations": of(GRADIENT_SEARCH, np.mean, "simulations"),
        "most": lambda some: max(
            entry.simulations for entry in some if entry.method == GRADIENT_SEARCH
        ),
        "within 1 mm, %": of(GRADIENT_SEARCH, fraction_within, "gap"),
        "mean gap, mm": of(GRADIENT_SEARCH, np.mean, "gap", MM_PER_M),
        "worst gap, mm": of(GRADIENT_SEARCH, max, "gap", MM_PER_M),
        "ms": of(GRADIENT_SEARCH, np.median, "seconds", MS_PER_S),
        "f. d. simulations": of(DIFFERENCE_SEARCH, np.mean, "simulations"),
        "f. d. within 1 mm, %": of(DIFFERENCE_SEARCH, fraction_within, "gap"),
        "f. d. ms": of(DIFFERENCE_SEARCH, np.median, "seconds", MS_PER_S),
        "exhaustive simulations": of(EXHAUSTIVE_SEARCH, np.mean, "simulations"),
        "exhaustive ms": of(EXHAUSTIVE_SEARCH, np.median, "seconds", MS_PER_S),
    }
    notes = [
        "One push towards the goal, the masses drawn by part. A simulation with its exact Jacobian "
        "counts as one; one simulation of a straight push tells the best distance along it too, in "
        "every method.",
        "The gradient method's starts are ranked by the ellipsoidal limit surface: no simulation, "
        "but counted in ms.",
        "Gap: mean cell error at the push's end above the exhaustive search's, a grid walked on "
        "from its best nodes; negative is better.",
        "f. d.: finite differences, the paper's walk along the outline. Times are medians of wall "
        "clock.",
    ]
    return Table.of(
        "Choosing a contact point", ("object",), by_object(decisions, names), columns, notes
    )


def tabulate_runs(
    runs: Sequence[Run], names: Sequence[str], modes: Sequence[str], world: str = LCP_WORLD
) -> Table:
    """Tabulates by model and object how often the goal is reached, and with how many pushes."""
    groups = [
        group
        for mode in modes
        for group in by_object([run for run in runs if run.mode == mode], names, mode)
    ]
    columns: dict[str, Column] = {
        "runs": len,
        "success, %": mean_of("success", PERCENT_PER_ONE),
        "off the table": count_of("fell", True),
        "pushes": mean_of("pushes"),
        "90 %": lambda some: float(np.quantile([run.pushes for run in some], 0.9)),
        "most": lambda some: max(run.pushes for run in some),
        "first prediction, mm": mean_of("first_error", MM_PER_M),
        "later, mm": mean_of("later_error", MM_PER_M),
        "simulations": mean_of("simulations"),
        "planning, s": mean_of("planning_seconds"),
        "learning, s": mean_of("learning_seconds"),
    }
    failed = sorted({run.status for run in runs if not run.success})
    notes = [
        f"Success: mean cell error under 2 cm within {MAX_PUSHES} pushes, on the round table of "
        "radius 0.5 m.",
        WORLD_NOTES.get(world, f"Pushed in {world}; {OBSERVATION_SENTENCE}"),
        "Models: learned on the way from the uniform one; uniform throughout; the true one, "
        "looking one push ahead (as the others do) and two.",
        "Predictions: mean cell error of a push's predicted end, of the first push and of the "
        "later ones.",
        "Pushes and seconds are means over the runs; the planner's simulations and seconds are a "
        "whole run's.",
    ]
    if failed:
        notes.append(f"Runs without success ended with: {', '.join(failed)}.")
    return Table.of("Pushing to a goal", ("model", "object"), groups, columns, notes)


PLANNING_JOBS = JobKind(
    job=PlanningJob,
    run=run_job,
    describe=lambda job: f"{PART_NAMES[job.kind]}: {job.name}, set {job.number}",
)
"""What is done with a job."""

STUDY = Study(
    name="planning",
    help="Choose contact points, and push objects to goal poses on the paper's round table.",
    options=PlanningBenchOptions,
    shorten=shorten,
    make_jobs=make_jobs,
    tasks=(PLANNING_JOBS,),
    tabulate=tabulate,
)
"""`gridpush bench planning`."""
