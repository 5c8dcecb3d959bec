"""`gridpush bench drake`: the whole station learning, judged by pushes held out, and the speed of `GridLcpSystem`."""

from collections.abc import Sequence
from dataclasses import dataclass
from time import perf_counter, sleep, thread_time
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from gridpush_drake.bench import plant
from gridpush_drake.bench.campaign import calc_center_error
from gridpush_drake.bench.jobs import QUIET, Execution, Report, count_steps, run_jobs
from gridpush_drake.bench.speed import DT, DURATION, RADIUS, make_bench_push
from gridpush_drake.bench.table import MM, MS, Table, Value
from gridpush_drake.dynamics.physics import QUASI_STATIC, Regime
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.prediction import calc_mean_cell_error
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import find_shipped_object
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.station.identify_task import IdentifyTask
from gridpush_drake.station.scenario import PushScenario
from gridpush_drake.station.scenario_camera import RGBD_RATE, CameraKind
from gridpush_drake.systems.grid_lcp_system import GridLcpSystem

OBJECTS = ("claw_hammer", "combination_wrench", "spray_bottle")
SEEDS = (0, 1, 2)
IDEAL: CameraKind = "ideal"


@dataclass(frozen=True)
class Job:
    """One experiment in the station.

    Attributes:
        name: of a shipped object.
        seed: of all that is hidden or random.
        camera: what sees the object.
        rate: poses a second, Hz; the scenario's where None.
    """

    name: str
    seed: int
    camera: CameraKind = IDEAL
    rate: float | None = None


@dataclass(frozen=True)
class StationScore:
    """What came of one experiment; lengths in m.

    Mean cell errors of the held-out pushes are with the uniform model, as learned, and with the
    true parameters; center of mass errors with the first two. `share` is the greatest of joint
    position, velocity and torque limits; `touched` counts pairs of bodies that should not have
    touched; `rate` is of the poses, Hz.
    """

    name: str
    seed: int
    status: str
    pushes: int
    held_out: int
    error: tuple[float, float, float]
    center_of_mass_error: tuple[float, float]
    tracking_error: float
    share: float
    touched: int
    duration: float
    camera: CameraKind = IDEAL
    rate: float = 30.0


def run(
    seed: int = 0, execution: Execution = QUIET, *, quick: bool = False, camera: CameraKind = IDEAL
) -> list[Table]:
    """Measures all: the LCP system, single updates, the plant beside the model (`bench.plant`), and the station.

    No single updates, and of the rest the first object only, with two pushes and one seed, where
    `quick`. With a camera only the station, which learns from as many ideal poses a second, too.
    """
    count = 1 if quick else None
    if camera != IDEAL:
        return _run_station((IDEAL, camera), seed, count, execution)
    tables = [run_lcp_system(execution.report), *([] if quick else [run_updates(execution.report)])]
    pushes = plant.calc_scores(
        plant.OBJECTS[:count], 2 if quick else plant.PUSHES, seed=seed, execution=execution
    )
    return [*tables, plant.make_table(pushes), *_run_station((IDEAL,), seed, count, execution)]


def _run_station(
    cameras: Sequence[CameraKind], seed: int, count: int | None, execution: Execution
) -> list[Table]:
    """A table for each camera, of the first objects and seeds only where there is a count."""
    rate = RGBD_RATE if len(cameras) > 1 else None
    cases = [(name, seed + each) for name in OBJECTS[:count] for each in SEEDS[:count]]
    jobs = [Job(*case, camera, rate) for case in cases for camera in cameras]
    scores = run_jobs(
        run_job, jobs, lambda job: f"{job.name}, seed {job.seed}, {job.camera} camera", execution
    )
    return [make_table([score for score in scores if score.camera == camera]) for camera in cameras]


def run_job(job: Job) -> StationScore:
    """Runs one experiment with the default scenario."""
    scenario = PushScenario(object=job.name, seed=job.seed)
    scenario.camera.use(job.camera)
    scenario.camera.rate = job.rate or scenario.camera.rate
    record = IdentifyTask(scenario).run()
    assert record.truth is not None  # of a simulated object it is known
    obj, truth, limits, held_out = (
        record.obj,
        record.truth,
        record.limit_report,
        record.held_out_log,
    )
    uniform = CellParameters.uniform(obj)
    learned = record.estimates[-1].params if record.estimates else uniform
    physics = QUASI_STATIC
    if record.estimates:
        physics = record.estimates[-1].physics
    before, after, floor = (
        calc_mean_cell_error(obj, params, held_out, physics) for params in (uniform, learned, truth)
    )
    gaps = [calc_center_error(record, params) for params in (uniform, learned)]
    return StationScore(
        job.name, job.seed, record.status, len(record.training_log), len(held_out), (before, after, floor),
        (gaps[0], gaps[1]), limits.tracking_error,
        max(limits.position_share, limits.velocity_share, limits.torque_share), len(limits.touched),
        record.duration, job.camera, scenario.camera.rate,
    )  # fmt: skip


def make_table(scores: Sequence[StationScore]) -> Table:
    """A row a score, and one of their means."""
    rows: list[list[Value]] = [
        [f"{score.name}, {score.seed}", score.status, *_figures(score)] for score in scores
    ]
    if len(scores) > 1:
        rows.append(
            ["mean", "", *np.nanmean([_figures(score) for score in scores], axis=0).tolist()]
        )
    touched = sum(score.touched for score in scores)
    seen = {
        IDEAL: "pose noise 0.5 mm and 0.2°",
        "rgbd": "object and poses from a rendered color and depth camera",
    }
    notes = [
        f"An iiwa with a finger, free base, {seen[scores[0].camera]}, at {scores[0].rate:g} Hz; "
        "held-out pushes of 10 cm by the same robot.",
        f"Greatest share of a joint's limits used: {max(score.share for score in scores):.2f}; "
        f"forbidden contacts: {touched}.",
    ]
    columns = (
        "object, seed", "status", "pushes", "held out", "uniform, mm", "learned, mm", "truth, mm", "learned/uniform",
        "CoM uniform, mm", "CoM learned, mm", "tracking, mm",
    )  # fmt: skip
    return Table(
        "Learning in the full station: mean cell error of held-out pushes", columns, rows, notes
    )


def _figures(score: StationScore) -> list[float]:
    before, after, floor = score.error
    uniform, learned = score.center_of_mass_error
    return [
        score.pushes, score.held_out, before * MM, after * MM, floor * MM, after / before, uniform * MM, learned * MM,
        score.tracking_error * MM,
    ]  # fmt: skip


UPDATE = 0.005
"""s of the station's shortest control period, which one update of the Diagram is."""

UPDATE_MODES = {"in the same update": 0.0, "beside the Diagram, in real time": None}
"""How what takes long is answered: `simulation.answer_delay`."""

UPDATE_POKES, UPDATE_LIMIT, UPDATE_RATE = 3, 120.0, 1.0
"""Simulated s after which it is given up, and simulated seconds a second, at most."""


def run_updates(report: Report | None = None) -> Table:
    """Times each update of the station's Diagram while the robot pokes and learns: a row for each way of learning."""
    rows: list[list[Value]] = []
    announce = count_steps(report, len(UPDATE_MODES))
    for words, delay in UPDATE_MODES.items():
        announce(words)
        times, busy, learned = time_updates(delay)
        for when, chosen in (("at rest", times[~busy]), ("meanwhile", times[busy])):
            middle, worst = (
                (np.median(chosen, axis=0) * MS).tolist(),
                (chosen.max(axis=0) * MS).tolist(),
            )
            rows.append(
                [f"{words}; {when}", learned, len(chosen), middle[0], worst[0], middle[1], worst[1]]
            )
    columns = (
        "learning and choosing", "pushes learned from", "updates", "an update, ms", "worst, ms",
        "its own processor time, ms", "worst, ms of it",
    )  # fmt: skip
    notes = [
        f"An update is {UPDATE * MS:g} ms of the station with its plant, at most {UPDATE_RATE:g} times real time; "
        "meanwhile: while the identifier or the policy is at work. By the clock on the wall and, apart from what else "
        "the computer does, by the processor time of the thread that the Diagram runs in."
    ]
    return Table("Single updates of the station's Diagram", columns, rows, notes)


def time_updates(answer_delay: float | None) -> tuple[Array, NDArray[np.bool_], int]:
    """Lets the station poke a hammer; `answer_delay` is as of the scenario.

    Returns:
        (U, 2) each update's time by the clock on the wall and by that of the thread's processor, s;
        (U,) whether something was being learned or chosen; the pushes learned from.
    """
    scenario = PushScenario(object="claw_hammer")
    simulation = scenario.simulation.model_copy(update={"answer_delay": answer_delay})
    pokes = scenario.pokes.model_copy(update={"count": UPDATE_POKES, "test_count": 0})
    task = IdentifyTask(scenario.model_copy(update={"simulation": simulation, "pokes": pokes}))
    context = task.simulator.get_mutable_context()
    task.station.SetStart(context)
    systems = (task.station.GetSubsystemByName("identifier"), task.controller)
    times, busy = [], []

    def remember() -> list[Any]:
        return [
            one.GetMyContextFromRoot(context).get_abstract_state(0).get_value() for one in systems
        ]

    task.simulator.Initialize()
    while context.get_time() < UPDATE_LIMIT and (
        task.read("executor.status").executed < UPDATE_POKES
        or any(one.request for one in remember())
    ):
        before, begin, own = remember(), perf_counter(), thread_time()
        task.simulator.AdvanceTo(context.get_time() + UPDATE)
        times.append((perf_counter() - begin, thread_time() - own))
        sleep(max(0.0, UPDATE / UPDATE_RATE - times[-1][0]))
        after = remember()
        answered = (
            after[0].considered != before[0].considered or after[1].command != before[1].command
        )
        busy.append(answered or any(one.request for one in (*before, *after)))
    return np.array(times), np.array(busy), len(task.read("estimate.identification").push_names)


LCP_OBJECTS = ("claw_hammer", "toolbox")
LCP_REGIMES: tuple[Regime, ...] = ("inertial", "quasi_static")
LCP_RUNS = 10
"""Of each push."""


def run_lcp_system(report: Report | None = None) -> Table:
    """Times the push of the speed benchmark in a Simulator: a row an object and regime."""
    rows: list[list[Value]] = []
    announce = count_steps(report, len(LCP_OBJECTS) * len(LCP_REGIMES))
    for name in LCP_OBJECTS:
        for regime in LCP_REGIMES:
            announce(f"{name}, {regime}")
            obj = GridObject.from_yaml(find_shipped_object(name))
            times = np.sort(_time_pushes(obj, regime))
            median = float(np.median(times))
            rows.append(
                [f"{name}, {regime}", obj.n, median * MS, float(times[0]) * MS, DURATION / median]
            )
    notes = [
        f"A push of {DURATION:g} s in steps of {DT * MS:g} ms, {LCP_RUNS} runs, with Drake's Simulator and logging."
    ]
    columns = ("object, regime", "cells", "median, ms", "least, ms", "times real time")
    return Table("GridLcpSystem in a Simulator", columns, rows, notes)


def _time_pushes(obj: GridObject, regime: Regime) -> list[float]:
    push = make_bench_push(obj)
    builder = DiagramBuilder()
    lcp = builder.AddSystem(
        GridLcpSystem(obj, CellParameters.random(obj, seed=0), DT, regime, RADIUS)
    )
    states = np.column_stack([push.xy, np.tile(push.velocity, (len(push.xy), 1))])
    source = builder.AddSystem(
        TrajectorySource(PiecewisePolynomial.FirstOrderHold(push.t, states.T))
    )
    builder.Connect(source.get_output_port(), lcp.GetInputPort("pusher_state"))
    diagram = builder.Build()
    times = []
    for _ in range(LCP_RUNS + 1):
        simulator = Simulator(diagram)
        simulator.Initialize()
        begin = perf_counter()
        simulator.AdvanceTo(DURATION)
        times.append(perf_counter() - begin)
    return times[1:]
