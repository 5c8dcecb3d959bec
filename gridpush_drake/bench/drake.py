"""`gridpush bench drake`: the whole station learning, and the speed of `GridLcpSystem`.

What the station learns is judged by pushes that are held out. Beside it, Drake's plant and MuJoCo
are compared with the grid LCP (`bench.worlds.plant`), and single updates of the station's Diagram
are timed.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from time import perf_counter, sleep, thread_time
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from gridpush_drake.bench.speed_cases import (
    DISC_RADIUS,
    PAPER_TIME_STEP,
    PUSH_DURATION,
    make_bench_push,
)
from gridpush_drake.bench.study import Done, JobKind, Study, StudyOptions, option
from gridpush_drake.bench.worlds import plant
from gridpush_drake.dynamics.physics import QUASI_STATIC, Regime
from gridpush_drake.extras import is_installed
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.prediction import calc_mean_cell_error
from gridpush_drake.jobs.run import Report, count_steps
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import find_shipped_object
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.report.table import Table, Value
from gridpush_drake.station.campaign.episodes import calc_center_error
from gridpush_drake.station.schema.camera_config import RGBD_RATE, CameraKind
from gridpush_drake.station.schema.scenario import PushScenario
from gridpush_drake.station.tasks.identify_task import IdentifyTask
from gridpush_drake.systems.dynamics.grid_lcp_system import GridLcpSystem
from gridpush_drake.units import MM_PER_M, MS_PER_S

DEFAULT_OBJECTS = ("claw_hammer", "combination_wrench", "spray_bottle")
"""Shipped objects that the station learns."""

DEFAULT_SEED_COUNT = 3
"""Number of hidden truths and noises of each object."""

POSE_CAMERA: CameraKind = "ideal"
"""The camera that sees poses, with noise."""

RGBD_CAMERA: CameraKind = "rgbd"
"""The camera that sees colors and depths, from which poses are found."""

SEEN_BY = {
    POSE_CAMERA: "pose noise 0.5 mm and 0.2°",
    RGBD_CAMERA: "object and poses from a rendered color and depth camera",
}
"""How the object is seen by each camera, in words."""


@dataclass(frozen=True)
class DrakeBenchOptions(StudyOptions):
    """What is measured.

    Attributes:
        camera: the camera of the station. With RGBD there is only the station, which learns from as
            many ideal poses a second, too.
        objects: names of the shipped objects that the station learns.
        seeds: number of hidden truths and noises of each of them.
        plant_objects: names of the shipped objects that are pushed in Drake's plant and in MuJoCo.
        plant_pushes: number of pushes of each of them by a disc.
        plant_shape_pushes: number of pushes of each of them by each pusher of another shape.
        updates: whether single updates of the station's Diagram are timed.
    """

    camera: CameraKind = option(
        POSE_CAMERA,
        "rgbd: only the station, which learns from a color and depth camera, and from ideal poses.",
    )
    objects: tuple[str, ...] = DEFAULT_OBJECTS
    seeds: int = DEFAULT_SEED_COUNT
    plant_objects: tuple[str, ...] = plant.DEFAULT_OBJECTS
    plant_pushes: int = plant.PUSH_COUNT
    plant_shape_pushes: int = plant.SHAPE_PUSH_COUNT
    updates: bool = True

    @property
    def cameras(self) -> tuple[CameraKind, ...]:
        """The cameras that the station is run with."""
        return (POSE_CAMERA,) if self.camera == POSE_CAMERA else (POSE_CAMERA, self.camera)


@dataclass(frozen=True)
class StationJob:
    """One experiment in the station.

    Attributes:
        name: name of a shipped object.
        seed: seed of all that is hidden or random.
        camera: what sees the object.
        rate: poses a second, Hz; the scenario's where None.
    """

    name: str
    seed: int
    camera: CameraKind = POSE_CAMERA
    rate: float | None = None


@dataclass(frozen=True)
class StationScore:
    """What came of one experiment.

    Attributes:
        name: name of the object.
        seed: seed of all that was hidden or random.
        status: how the experiment ended.
        pushes: number of pushes that were learned from.
        held_out: number of pushes that were held out.
        error: mean cell errors of the held-out pushes, m: with the uniform model, as learned, and
            with the true parameters.
        center_of_mass_error: errors of the center of mass, m: of the uniform model, and as learned.
        tracking_error: greatest distance of the finger from its path, m.
        fraction: greatest fraction of a joint's position, velocity or torque limit that was used.
        touched: number of pairs of bodies that touched and should not have.
        duration: simulated time, s.
        camera: what saw the object.
        rate: poses a second, Hz.
    """

    name: str
    seed: int
    status: str
    pushes: int
    held_out: int
    error: tuple[float, float, float]
    center_of_mass_error: tuple[float, float]
    tracking_error: float
    fraction: float
    touched: int
    duration: float
    camera: CameraKind = POSE_CAMERA
    rate: float = 30.0


def shorten(options: DrakeBenchOptions) -> DrakeBenchOptions:
    """Makes the options of the quick variant: the first objects, one seed, and two pushes."""
    return replace(
        options,
        objects=options.objects[:1],
        seeds=1,
        plant_objects=options.plant_objects[:1],
        plant_pushes=2,
        plant_shape_pushes=1,
        updates=False,
    )


def measure(options: DrakeBenchOptions, report: Report | None) -> list[Table]:
    """Times the LCP system, and single updates of the station."""
    if options.camera != POSE_CAMERA:
        return []
    tables = [run_lcp_system(report)]
    if options.updates:
        tables.append(run_updates(report))
    return tables


def make_jobs(options: DrakeBenchOptions) -> list[plant.PlantJob | StationJob]:
    """Makes the pushes in the plants, and the experiments in the station."""
    pushes: list[plant.PlantJob] = []
    if options.camera == POSE_CAMERA:
        # MuJoCo is in an extra, and is left out where it is not installed
        plants = [plant.PLANAR_PLANT, plant.FREE_PLANT]
        if is_installed("mujoco"):
            plants.append(plant.MUJOCO_PLANT)
        pushes = plant.make_jobs(
            options.plant_objects,
            plants,
            options.seed,
            options.plant_pushes,
            options.plant_shape_pushes,
        )
    rate = RGBD_RATE if len(options.cameras) > 1 else None
    experiments = [
        StationJob(name=name, seed=options.seed + i, camera=camera, rate=rate)
        for name in options.objects
        for i in range(options.seeds)
        for camera in options.cameras
    ]
    return [*pushes, *experiments]


def run_job(job: StationJob) -> StationScore:
    """Runs one experiment with the default scenario."""
    scenario = PushScenario(object=job.name, seed=job.seed)
    scenario.camera.use(job.camera)
    scenario.camera.rate = job.rate or scenario.camera.rate
    record = IdentifyTask(scenario).run()
    assert record.truth is not None  # of a simulated object it is known
    obj = record.obj
    limits = record.limit_report
    held_out = record.held_out_log
    uniform = CellParameters.uniform(obj)
    learned = uniform
    physics = QUASI_STATIC
    if record.estimates:
        learned = record.estimates[-1].params
        physics = record.estimates[-1].physics
    before, after, floor = (
        calc_mean_cell_error(Model(obj, params, physics), held_out)
        for params in (uniform, learned, record.truth)
    )
    return StationScore(
        name=job.name,
        seed=job.seed,
        status=record.status,
        pushes=len(record.training_log),
        held_out=len(held_out),
        error=(before, after, floor),
        center_of_mass_error=(
            calc_center_error(record, uniform),
            calc_center_error(record, learned),
        ),
        tracking_error=limits.tracking_error,
        fraction=max(limits.position_fraction, limits.velocity_fraction, limits.torque_fraction),
        touched=len(limits.touched),
        duration=record.duration,
        camera=job.camera,
        rate=scenario.camera.rate,
    )


def tabulate(options: DrakeBenchOptions, done: Done) -> list[Table]:
    """Tabulates the pushes in the plants, and the experiments by camera."""
    pushes = [score for scores in done.of(plant.PLANT_JOBS) for score in scores]
    experiments = done.of(STATION_JOBS)
    tables = [plant.make_table(pushes)] if pushes else []
    for camera in options.cameras:
        tables.append(make_table([score for score in experiments if score.camera == camera]))
    return tables


def make_table(scores: Sequence[StationScore]) -> Table:
    """Makes a row for each experiment, and one of their means."""
    rows: list[list[Value]] = [
        [f"{score.name}, {score.seed}", score.status, *_list_figures(score)] for score in scores
    ]
    if len(scores) > 1:
        means = np.nanmean([_list_figures(score) for score in scores], axis=0)
        rows.append(["mean", "", *means.tolist()])
    touched = sum(score.touched for score in scores)
    notes = [
        f"An iiwa with a finger, free base, {SEEN_BY[scores[0].camera]}, at {scores[0].rate:g} Hz; "
        "held-out pushes of 10 cm by the same robot.",
        "Greatest fraction of a joint's limits used: "
        f"{max(score.fraction for score in scores):.2f}; "
        f"forbidden contacts: {touched}.",
    ]
    columns = (
        "object, seed",
        "status",
        "pushes",
        "held out",
        "uniform, mm",
        "learned, mm",
        "truth, mm",
        "learned/uniform",
        "CoM uniform, mm",
        "CoM learned, mm",
        "tracking, mm",
    )
    title = "Learning in the full station: mean cell error of held-out pushes"
    return Table(title, columns, rows, notes)


def _list_figures(score: StationScore) -> list[float]:
    """Lists the numbers of a row of the table."""
    before, after, floor = score.error
    uniform, learned = score.center_of_mass_error
    return [
        score.pushes,
        score.held_out,
        before * MM_PER_M,
        after * MM_PER_M,
        floor * MM_PER_M,
        after / before,
        uniform * MM_PER_M,
        learned * MM_PER_M,
        score.tracking_error * MM_PER_M,
    ]


UPDATE_PERIOD = 0.005
"""Simulated time of one update of the Diagram, s: the station's shortest control period."""

UPDATE_MODES = {"in the same update": 0.0, "beside the Diagram, in real time": None}
"""Ways in which learning and choosing, which take long, are done, with the scenario's
`simulation.answer_delay`, s."""

UPDATE_POKES = 3
"""Number of pokes during which updates are timed."""

UPDATE_LIMIT = 120.0
"""Simulated time after which the pokes are given up, s."""

UPDATE_RATE = 1.0
"""Greatest number of simulated seconds in a second."""


def run_updates(report: Report | None = None) -> Table:
    """Times each update of the station's Diagram while the robot pokes and learns."""
    rows: list[list[Value]] = []
    announce = count_steps(report, len(UPDATE_MODES))
    for words, delay in UPDATE_MODES.items():
        announce(words)
        times, busy, learned = time_updates(delay)
        for when, chosen in (("at rest", times[~busy]), ("meanwhile", times[busy])):
            middle = (np.median(chosen, axis=0) * MS_PER_S).tolist()
            worst = (chosen.max(axis=0) * MS_PER_S).tolist()
            rows.append(
                [f"{words}; {when}", learned, len(chosen), middle[0], worst[0], middle[1], worst[1]]
            )
    columns = (
        "learning and choosing",
        "pushes learned from",
        "updates",
        "an update, ms",
        "worst, ms",
        "its own processor time, ms",
        "worst, ms of it",
    )
    notes = [
        f"An update is {UPDATE_PERIOD * MS_PER_S:g} ms of the station with its plant, at most "
        f"{UPDATE_RATE:g} "
        "times real time; meanwhile: while the identifier or the policy is at work. By the clock "
        "on the wall and, apart from what else the computer does, by the processor time of the "
        "thread that the Diagram runs in."
    ]
    return Table("Single updates of the station's Diagram", columns, rows, notes)


def time_updates(answer_delay: float | None) -> tuple[Array, NDArray[np.bool_], int]:
    """Lets the station poke a hammer, and times its updates.

    Args:
        answer_delay: the scenario's `simulation.answer_delay`, s.

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
    times = []
    busy = []

    def remember() -> list[Any]:
        return [
            one.GetMyContextFromRoot(context).get_abstract_state(0).get_value() for one in systems
        ]

    task.simulator.Initialize()
    while context.get_time() < UPDATE_LIMIT and (
        task.read("executor.status").executed < UPDATE_POKES
        or any(one.request for one in remember())
    ):
        before = remember()
        begin = perf_counter()
        own = thread_time()
        task.simulator.AdvanceTo(context.get_time() + UPDATE_PERIOD)
        times.append((perf_counter() - begin, thread_time() - own))
        sleep(max(0.0, UPDATE_PERIOD / UPDATE_RATE - times[-1][0]))
        after = remember()
        # A learner that answers within the update has no request before or after it.
        answered = (
            after[0].considered != before[0].considered or after[1].command != before[1].command
        )
        busy.append(answered or any(one.request for one in (*before, *after)))
    return np.array(times), np.array(busy), len(task.read("estimate.identification").push_names)


LCP_OBJECTS = ("claw_hammer", "toolbox")
"""Shipped objects that are pushed by the LCP system."""

LCP_REGIMES: tuple[Regime, ...] = ("inertial", "quasi_static")
"""Regimes in which the LCP system is timed."""

LCP_RUNS = 10
"""Number of runs of each push."""


def run_lcp_system(report: Report | None = None) -> Table:
    """Times the push of the speed benchmark in a Simulator, by object and regime."""
    rows: list[list[Value]] = []
    announce = count_steps(report, len(LCP_OBJECTS) * len(LCP_REGIMES))
    for name in LCP_OBJECTS:
        for regime in LCP_REGIMES:
            announce(f"{name}, {regime}")
            obj = GridObject.from_yaml(find_shipped_object(name))
            times = np.sort(_time_pushes(obj, regime))
            median = float(np.median(times))
            rows.append(
                [
                    f"{name}, {regime}",
                    obj.n,
                    median * MS_PER_S,
                    float(times[0]) * MS_PER_S,
                    PUSH_DURATION / median,
                ]
            )
    notes = [
        f"A push of {PUSH_DURATION:g} s in steps of {PAPER_TIME_STEP * MS_PER_S:g} ms, {LCP_RUNS} "
        "runs, with Drake's "
        "Simulator and logging."
    ]
    columns = ("object, regime", "cells", "median, ms", "least, ms", "times real time")
    return Table("GridLcpSystem in a Simulator", columns, rows, notes)


def _time_pushes(obj: GridObject, regime: Regime) -> list[float]:
    """Times LCP_RUNS pushes, s; one more is made before, which warms up."""
    push = make_bench_push(obj)
    builder = DiagramBuilder()
    lcp = builder.AddSystem(
        GridLcpSystem(
            Model(obj, CellParameters.random(obj, seed=0)), PAPER_TIME_STEP, regime, DISC_RADIUS
        )
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
        simulator.AdvanceTo(PUSH_DURATION)
        times.append(perf_counter() - begin)
    return times[1:]


STATION_JOBS = JobKind(
    job=StationJob,
    run=run_job,
    describe=lambda job: f"{job.name}, seed {job.seed}, {job.camera} camera",
)
"""What is done with an experiment in the station."""

STUDY = Study(
    name="drake",
    help="Compare Drake's plant and MuJoCo with the grid LCP, time the LCP system, and let the "
    "whole station learn.",
    options=DrakeBenchOptions,
    shorten=shorten,
    measure=measure,
    make_jobs=make_jobs,
    tasks=(plant.PLANT_JOBS, STATION_JOBS),
    tabulate=tabulate,
)
"""`gridpush bench drake`."""
