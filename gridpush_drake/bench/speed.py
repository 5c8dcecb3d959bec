"""`gridpush bench speed`: how fast pushes are simulated and differentiated, and objects identified.

Timing on one core: by the clock on the wall, and of identification and decisions by that of the
processor.
"""

import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from time import process_time

import numpy as np

from gridpush_drake.bench.speed_cases import (
    DRAWN_LENGTH,
    DRAWN_PUSHES,
    OBSERVED_POSE_COUNT,
    PAPER_TIME_STEP,
    PUSH_DURATION,
    draw_random_pushes,
    load_hammer,
    make_bench_log,
    make_bench_push,
    make_two_tip_push,
)
from gridpush_drake.bench.study import MASKS_OPTION, Study, StudyOptions, option
from gridpush_drake.bench.timing import Timing, measure, one_core
from gridpush_drake.bench.worlds.mujoco_boxes import make_mujoco_push
from gridpush_drake.dynamics.physics import QUASI_STATIC, Regime
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.push_batch import PushBatch
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.result import Identification
from gridpush_drake.identification.statistics.problem import PushProblem, TimedPush
from gridpush_drake.jobs.run import Report, count_steps
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.contact.optimization import optimize_contact
from gridpush_drake.planning.goal.next_push import GoalRules
from gridpush_drake.planning.goal.push_decision import decide_push
from gridpush_drake.planning.model_rollouts import WEIGHED_DRAWS
from gridpush_drake.planning.push_constraints import PushConstraints
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.report.table import Table, Value
from gridpush_drake.units import MS_PER_S

PAPER_SIMULATION = 1.3448
"""The paper's time of a simulated push, s (Song and Boularias, RSS 2020)."""

PAPER_GRADIENT = 0.0069
"""The paper's time of a gradient, s."""

PUSH_HEIGHT = 0.01
"""Height of the pusher above the table where loads shift, m."""

FINAL_JACOBIAN_SUFFIX = ", with the Jacobian of the final pose"
"""Ending of the name of a simulation that also gives the final pose's derivatives."""

ALL_JACOBIANS_SUFFIX = ", with the Jacobian of all poses"
"""Ending of the name of a simulation that also gives all poses' derivatives."""

CELL_COUNTS = (10, 30, 100, 300, 1000, 3000, 10000)
"""Numbers of cells for the cost against the number of cells."""

LINEAR_FROM = 300
"""Number of cells from which on the slope is fitted: with fewer, work that does not depend on their
number shows."""

START_UPS = 7
"""Number of runs of each command that starts Python."""

LOG_SIZES = ((60, 5), (132, 6), (132, 12), (132, 25), (132, 50), (132, 100), (132, 200))
"""Numbers of cells and pushes of the logs that are identified."""

UNREPEATED_PUSH_COUNT = 25
"""Number of pushes from which on an identification is timed only once."""

IDENTIFY_REPETITIONS = 5
"""How often an identification from fewer pushes is timed."""

DRAWN_LOG = (132, 6)
"""Number of cells and of pushes of the log from whose posterior models are drawn."""

BATCH_CELLS = 4900
"""Number of cells of the square whose pushes are timed in a batch."""

TABLE_RADIUS = 0.5
"""Radius of the table on which decisions are timed, m."""

GOAL_COUNT = 20
"""Number of goals for each of which one push is decided on."""

GOAL_REACH = (0.15, 0.15, 1.0)
"""How far off a goal is at most, along x and y, m, and in its angle, rad."""

Announce = Callable[[str], None]
"""Function that is called with what begins."""


@dataclass(frozen=True)
class SpeedBenchOptions(StudyOptions):
    """What is measured.

    Attributes:
        data: folder of the paper's masks; None pushes the shipped hammer.
        repetitions: number of runs of each simulation.
        mujoco: whether MuJoCo is run beside, where it is installed.
        sizes: numbers of cells for the cost against the number of cells.
        logs: numbers of cells and pushes of the logs that are identified.
        draws: number of models that are drawn from a posterior.
    """

    data: Path | None = option(None, **MASKS_OPTION)
    repetitions: int = option(50, "Runs of each simulation.", least=3)
    mujoco: bool = option(True, "Run MuJoCo beside, where it is installed.")
    sizes: tuple[int, ...] = CELL_COUNTS
    logs: tuple[tuple[int, int], ...] = LOG_SIZES
    draws: int = option(1000, "Models drawn from a posterior.", least=1)


def measure_all(options: SpeedBenchOptions, report: Report | None) -> list[Table]:
    """Measures everything, on one core.

    Args:
        options: what is measured.
        report: called with what begins, as of jobs.
    """
    obj = load_hammer(options.data)
    steps = len(_make_simulations(obj)) + len(options.sizes) + len(options.logs) + 6
    announce = count_steps(report, steps + int(options.mujoco))
    with one_core() as pinned:
        tables = [
            _measure_push(obj, options.repetitions, options.mujoco, pinned, announce),
            _measure_sizes(options.sizes, options.repetitions, announce),
            _measure_batches(obj, options.repetitions, announce),
            _measure_identification(options.logs, announce),
            _measure_decisions(obj, options.draws, announce),
        ]
        announce("start-up")
        tables.append(_measure_start_up())
    return tables


def _make_simulations(obj: GridObject) -> dict[str, Callable[[], object]]:
    """Makes what is timed, by name; the Jacobian is expanded to all its named blocks."""
    params = CellParameters.random(obj, seed=0)
    push = make_bench_push(obj)
    steps = round(PUSH_DURATION / PAPER_TIME_STEP)
    high = replace(params, push_height=PUSH_HEIGHT)
    recorded: dict[str, Sequence[int] | None] = {
        "": None,
        FINAL_JACOBIAN_SUFFIX: [steps],
        ALL_JACOBIANS_SUFFIX: range(steps + 1),
    }
    kinds: list[tuple[str, CellParameters, Push, Regime]] = [
        ("inertial", params, push, "inertial"),
        ("quasi_static", params, push, "quasi_static"),
        ("quasi_static, loads shift", high, push, "quasi_static"),
        ("quasi_static, two tips", params, make_two_tip_push(obj), "quasi_static"),
    ]
    return {
        name + suffix: partial(_simulate, obj, used, made, regime, record)
        for name, used, made, regime in kinds
        for suffix, record in recorded.items()
        if (used is params and made is push) or suffix != ALL_JACOBIANS_SUFFIX
    }


def _simulate(
    obj: GridObject,
    params: CellParameters,
    push: Push,
    regime: Regime,
    record: Sequence[int] | None,
) -> object:
    if record is None:
        return simulate(Model(obj, params), push, dt=PAPER_TIME_STEP, regime=regime)
    return simulate(
        Model(obj, params), push, dt=PAPER_TIME_STEP, regime=regime, gradients=True, record=record
    ).jacobian


def _measure_push(
    obj: GridObject, repetitions: int, with_mujoco: bool, pinned: bool, announce: Announce
) -> Table:
    times: dict[str, Timing] = {}
    for name, work in _make_simulations(obj).items():
        announce(name)
        times[name] = measure(work, repetitions, warm_up=3)
    plain = times["inertial"].median
    rows: list[list[Value]] = [
        _row(name, timing, timing.median / plain) for name, timing in times.items()
    ]
    notes = [
        f"{obj.name}, {obj.n} cells, {PUSH_DURATION:g} s push, step "
        f"{PAPER_TIME_STEP * MS_PER_S:g} ms; median and "
        f"quartiles of {repetitions} runs{', pinned to one core' if pinned else ''}.",
        "The Jacobian is by all masses and frictions, the contact friction and the push.",
    ]
    if with_mujoco:
        announce("MuJoCo")
        try:
            work = make_mujoco_push(
                Model(obj, CellParameters.random(obj, seed=0)), make_bench_push(obj)
            )
            beside = measure(work, repetitions=3, warm_up=0)
            rows.append(_row("MuJoCo, cells as boxes, step 2 ms", beside, beside.median / plain))
        except ImportError:
            notes.append("MuJoCo is not installed: pip install '.[bench]'.")
    rows.append(
        ["the paper, simulation", PAPER_SIMULATION * MS_PER_S, None, None, PAPER_SIMULATION / plain]
    )
    rows.append(
        [
            "the paper, gradient by itself",
            PAPER_GRADIENT * MS_PER_S,
            None,
            None,
            PAPER_GRADIENT / plain,
        ]
    )
    notes.append("The paper's times are as published, on its authors' computer.")
    return Table(
        "One push", ("what", "median, ms", "25 %, ms", "75 %, ms", "times the first"), rows, notes
    )


def _measure_sizes(sizes: Sequence[int], repetitions: int, announce: Announce) -> Table:
    rows: list[list[Value]] = []
    medians = []
    for size in sizes:
        announce(f"{size} cells")
        obj = GridObject.from_outline(
            np.array([[0, 0], [0.2, 0], [0.2, 0.2], [0, 0.2]]), max_cells=size
        )
        works = _make_simulations(obj)
        chosen = [works[name] for name in ("inertial", f"inertial{FINAL_JACOBIAN_SUFFIX}")]
        fewer = max(3, int(repetitions * min(1.0, 100 / obj.n)))
        plain, jacobian = (measure(work, fewer).median for work in chosen)
        medians.append((obj.n, plain, jacobian))
        rows.append(
            [obj.n, plain * MS_PER_S, jacobian * MS_PER_S, jacobian / plain, plain / obj.n * 1e6]
        )
    columns = ("cells", "simulation, ms", "with Jacobian, ms", "ratio", "simulation, µs a cell")
    notes = [
        "A square of 0.2 m; inertial, with the Jacobian of the final pose.",
        _describe_slopes(np.array(medians)),
    ]
    return Table("Cost against the number of cells", columns, rows, notes)


def _describe_slopes(medians: np.ndarray) -> str:
    """Says with which power of the number of cells the times grow, by least squares."""
    large = np.log(medians[medians[:, 0] >= LINEAR_FROM])
    if len(large) < 2:
        return f"Too few sizes of {LINEAR_FROM} cells or more to fit a slope."
    plain, jacobian = (np.polyfit(large[:, 0], large[:, column], 1)[0] for column in (1, 2))
    return (
        f"Log-log slope from {LINEAR_FROM} cells: simulation {plain:.2f}, with Jacobian "
        f"{jacobian:.2f}; 1 is linear."
    )


def _measure_identification(logs: Sequence[tuple[int, int]], announce: Announce) -> Table:
    rows: list[list[Value]] = []
    for cells, pushes in logs:
        announce(f"identification, {cells} cells, {pushes} pushes")
        obj, log = make_bench_log(cells, pushes)
        # What is compiled or loaded for the first identification is not timed.
        identify(Model(obj), log.subset(range(min(2, pushes))))
        repetitions = IDENTIFY_REPETITIONS if pushes < UNREPEATED_PUSH_COUNT else 1
        whole = measure(partial(identify, Model(obj), log), repetitions, 0, process_time)
        found = identify(Model(obj), log)
        problem = PushProblem(obj, log, found.params, QUASI_STATIC)
        timed = [TimedPush.of(seen, QUASI_STATIC.regime) for seen in log]
        batch, single = (
            measure(work, repetitions, 1, process_time).median
            for work in (
                partial(problem.linearize, problem.unknowns(found.params)),
                partial(_simulate_singly, found.with_physics(QUASI_STATIC), timed),
            )
        )
        rows.append(
            [
                obj.n,
                pushes,
                whole.median,
                whole.median / pushes * MS_PER_S,
                found.simulations / pushes,
                batch * MS_PER_S,
                single * MS_PER_S,
            ]
        )
    columns = (
        "cells",
        "pushes",
        "identify, s",
        "a push, ms",
        "simulations of each",
        "all pushes and Jacobians, ms",
        "the same one by one, ms",
    )
    note = (
        f"Processor time; {OBSERVED_POSE_COUNT} poses of each push. The last two columns are one "
        "evaluation "
        "of the log: in one call, which also makes residuals of it, and by `simulate`, push by "
        "push."
    )
    return Table("Identification", columns, rows, [note])


def _measure_decisions(obj: GridObject, draws: int, announce: Announce) -> Table:
    announce("decisions on the next push")
    rng = np.random.default_rng(0)
    params = CellParameters.random(obj, seed=0)
    goals = rng.uniform(-1.0, 1.0, (GOAL_COUNT, 3)) * GOAL_REACH
    still = np.zeros(3)
    model = Model(obj, params)
    optimize_contact(model, still, goals[0])
    times = [
        measure(partial(optimize_contact, model, still, goal), 1, 0, process_time).median
        for goal in goals
    ]
    low, median, high = np.quantile(times, [0.25, 0.5, 0.75])
    decision = Timing(float(median), float(low), float(high))

    # With draws of a posterior.
    cells, count = DRAWN_LOG
    learned, log = make_bench_log(cells, count)
    found = identify(Model(learned), log)
    announce(f"decisions with {WEIGHED_DRAWS} draws")
    free = _time_weighed_decisions(found, GoalRules(), goals)
    table = SupportSurface.round((0.0, 0.0), TABLE_RADIUS)
    bounded = _time_weighed_decisions(found, GoalRules(PushConstraints(table)), goals)
    announce(f"{draws} models, {DRAWN_PUSHES} pushes")
    models = found.draws(draws)
    batch = PushBatch(learned, draw_random_pushes(learned, rng), QUASI_STATIC, approximate=True)
    batch.simulate(models[0])
    whole = measure(lambda: [batch.simulate(model) for model in models], 1, 0, process_time).median
    each = whole / (draws * DRAWN_PUSHES)
    rows: list[list[Value]] = [
        ["where and how to push next, by gradient", *_to_ms(decision)],
        [f"the same, weighed with {WEIGHED_DRAWS} draws", *_to_ms(free)],
        [f"the same on a table, weighed with {WEIGHED_DRAWS} draws", *_to_ms(bounded)],
        [f"{DRAWN_PUSHES} pushes by each of {draws} drawn models", MS_PER_S * whole, None, None],
        ["one of these pushes", MS_PER_S * each, None, None],
    ]
    notes = [
        f"Processor time. The first decision is on one push of the {obj.name}, {obj.n} cells; "
        f"median and quartiles over {GOAL_COUNT} goals.",
        f"The drawn models are of a bar of {learned.n} cells, from the posterior after {count} "
        f"pushes; so are the next two decisions, which also take the draws. Each push by the drawn "
        f"models is {DRAWN_LENGTH * 100:g} cm long, in steps of 1 mm, and approximate.",
    ]
    return Table("Decisions", ("what", "median, ms", "25 %, ms", "75 %, ms"), rows, notes)


def _time_weighed_decisions(found: Identification, rules: GoalRules, goals: Array) -> Timing:
    """Times decisions for a push to each of some goals (G, 3), with draws of a posterior."""
    times = []
    for goal in goals:
        decide = partial(
            decide_push,
            model=found,
            pose=np.zeros(3),
            goal=goal,
            made=0,
            identification=found,
            rules=rules,
        )
        times.append(measure(decide, 1, 0, process_time).median)
    low, median, high = np.quantile(times, [0.25, 0.5, 0.75])
    return Timing(float(median), float(low), float(high))


def _to_ms(timing: Timing) -> list[Value]:
    """Median and quartiles in ms."""
    return [MS_PER_S * seconds for seconds in timing]


def _measure_batches(obj: GridObject, repetitions: int, announce: Announce) -> Table:
    """Times pushes of a few and of many cells in a batch, exact and approximate."""
    square = GridObject.from_outline(
        np.array([[0, 0], [0.2, 0], [0.2, 0.2], [0, 0.2]]), max_cells=BATCH_CELLS, name="square"
    )
    rows: list[list[Value]] = []
    for each in (obj, square):
        announce(f"batches, {each.n} cells")
        params = CellParameters.random(each, seed=0)
        pushes = draw_random_pushes(each, np.random.default_rng(0))
        times = []
        for approximate in (False, True):
            batch = PushBatch(each, pushes, QUASI_STATIC, approximate=approximate)
            work = partial(batch.simulate, params)
            fewer = max(3, repetitions // 10)
            times.append(measure(work, fewer, 1, process_time).median / len(pushes))
        rows.append(
            [each.name, each.n, *(MS_PER_S * seconds for seconds in times), times[0] / times[1]]
        )
    columns = ("object", "cells", "exact, ms a push", "approximate, ms a push", "ratio")
    note = (
        f"Processor time; {DRAWN_PUSHES} pushes of {DRAWN_LENGTH * 100:g} cm in steps of 1 mm, "
        "quasi-static, in one call of `PushBatch`."
    )
    return Table("Pushes in a batch", columns, rows, [note])


def _simulate_singly(model: Model, timed: Sequence[TimedPush]) -> None:
    for one in timed:
        _ = one.simulate(model, gradients="mass", record=one.rows).jacobian


def _measure_start_up() -> Table:
    commands = {
        "python -c pass": ["-c", "pass"],
        "import gridpush_drake": ["-c", "import gridpush_drake"],
        "gridpush --help": ["-m", "gridpush_drake.cli.main", "--help"],
    }
    rows: list[list[Value]] = []
    for name, arguments in commands.items():
        timing = measure(
            lambda arguments=arguments: subprocess.run(  # type: ignore[misc]
                [sys.executable, *arguments], check=True, stdout=subprocess.DEVNULL
            ),
            START_UPS,
        )
        rows.append([name, *timing])
    return Table(
        "Start-up",
        ("what", "median, s", "25 %, s", "75 %, s"),
        rows,
        [f"Processes, {START_UPS} runs each."],
    )


def _row(name: str, timing: Timing, ratio: float) -> list[Value]:
    return [name, *(MS_PER_S * seconds for seconds in timing), ratio]


STUDY = Study(
    name="speed",
    help="Time a push and its gradient, the same push in MuJoCo, pushes of ever more cells, "
    "identifications, decisions and start-up.",
    options=SpeedBenchOptions,
    measure=measure_all,
)
"""`gridpush bench speed`."""
