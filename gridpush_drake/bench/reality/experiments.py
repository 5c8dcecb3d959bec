"""`gridpush bench reality`: every set of real pushes at hand, in one table.

The rows are the sets, each with what is believed of the object:

    does not move     it stays where it is: how much there is to predict
    even object       all cells alike: what is believed before the first push
    learned           masses and frictions learned from a few pushes, or runs, of the set
    learned, frame    the same, with where the outline is in the frame of the logged poses
    the set's own     predictions of another model that come with the set, where there are any

The columns are the simulators that then predict held-out pushes: ours, and Drake's and MuJoCo's
plants with the very same masses and frictions. What repeated pushes differ by is the least error
that is possible. Further columns say how many ends are in the regions that the learned model states
beforehand, and of how many pushes by several tips it is said rightly whether the object goes along.
Runs of several pushes are also predicted as a whole, from where the object lies at their beginning.

Without real pushes, simulated ones stand in, and the table says so. The plants push faster than
slow robots do, as that changes next to nothing: see `PLANT_SPEED`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gridpush_drake.bench.data.real_logs import (
    CMU_LOG,
    DUBINS_LOG,
    IMPORTED_LOG,
    MIT_LOG,
    SIMULATED_LOG,
    SIMULATED_PUSH_COUNT,
    TWO_POINT_LOG,
    find_push_logs,
    name_logs,
)
from gridpush_drake.bench.data.real_sets import (
    MAX_SLIP,
    PUSH_COUNTS,
    START_GAP,
    LiftedRun,
    RealSet,
    calc_error,
    divide,
    place_runs,
    read_set,
)
from gridpush_drake.bench.reality.pictures import write_pictures
from gridpush_drake.bench.reality.scores import (
    DRAKE_ENGINE,
    EVEN_MODEL,
    FRAME_MODEL,
    LCP_ENGINE,
    MUJOCO_ENGINE,
    PLANT_SPEED,
    STILL_MODEL,
    RealityJob,
    RealityScore,
    RunScore,
    SlipScore,
    list_learned,
    read_job,
)
from gridpush_drake.bench.reality.tables import tabulate_pushes, tabulate_runs
from gridpush_drake.bench.study import Done, JobKind, Study, StudyOptions, option
from gridpush_drake.bench.worlds.mujoco_plant import MujocoPlant
from gridpush_drake.bench.worlds.plant import PlantWorld
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.pusher import PusherShape
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import GridPushError
from gridpush_drake.extras import is_installed
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.prediction import calc_pose_error, predict
from gridpush_drake.identification.result import Identification
from gridpush_drake.identification.spread import predict_spread
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import find_shipped_object
from gridpush_drake.planning.stable.stable_push import Slip, calc_push_stability, calc_slip
from gridpush_drake.pushes.push_log import ObservedPush, PushLog
from gridpush_drake.report.table import Table

REAL_KINDS = (CMU_LOG, TWO_POINT_LOG, MIT_LOG, DUBINS_LOG, IMPORTED_LOG)
"""Kinds of sets of real pushes."""

DEFAULT_TEST_COUNT = 20
"""Number of held-out pushes of each division, by default."""

DEFAULT_SPLIT_COUNT = 5
"""Number of divisions of a set into pushes to learn from and others, by default."""

STAND_INS = ("claw_hammer", "toolbox")
"""Shipped objects whose simulated pushes stand in for real ones."""

QUICK_SPLITS = 1
QUICK_TEST = 3
"""Numbers of divisions and of held-out pushes in the quick variant."""


@dataclass(frozen=True)
class RealityBenchOptions(StudyOptions):
    """What is measured.

    Attributes:
        data: folder of real pushes; None for simulated ones.
        splits: number of divisions of a set into pushes to learn from and others.
        test: number of held-out pushes of each division; of runs, those from one start are.
        plants: whether Drake's and MuJoCo's plants predict, too.
        pictures: folder into which a picture of each set is written; None for none.
    """

    data: Path | None = option(
        None,
        "Real pushes: a clone of GitHub robinzhoucmu/MLab_EXP or "
        "robinzhoucmu/PlanarManipulationToolBox, or a folder that holds such logs, or two-point "
        "pushes or runs of two fingers in the forms that `gridpush import` reads, or folders that "
        "`gridpush import` wrote (`--out-dir`). Without, simulated pushes stand in.",
        name="--data",
        metavar="DIR",
    )
    splits: int = option(
        DEFAULT_SPLIT_COUNT, "Divisions of a set into pushes to learn from and others.", least=1
    )
    test: int = option(DEFAULT_TEST_COUNT, "Held-out pushes of each division.", least=1)
    plants: bool = option(True, "Let Drake's and MuJoCo's plants predict, too.")
    pictures: Path | None = option(
        None,
        "Also draw a picture of each set into this folder.",
        metavar="DIR",
        is_setting=False,
    )


def shorten(options: RealityBenchOptions) -> RealityBenchOptions:
    """Makes the options of the quick variant."""
    return replace(
        options,
        splits=min(options.splits, QUICK_SPLITS),
        test=min(options.test, QUICK_TEST),
    )


def make_jobs(options: RealityBenchOptions) -> list[RealityJob]:
    """Makes a job for each set and division.

    Raises:
        GridPushError: the data are not there, or there are too few simulated pushes.
        PushLogError: a set cannot be read.
    """
    needed = max(PUSH_COUNTS) + options.test
    if options.data is not None:
        found = find_push_logs(Path(options.data).resolve(), needed, REAL_KINDS)
        sets = name_logs(found)
        for _, kind, path in sets:
            read_set(path, kind)
    elif needed > SIMULATED_PUSH_COUNT:
        raise GridPushError(
            f"--test: {options.test}; expected at most "
            f"{SIMULATED_PUSH_COUNT - max(PUSH_COUNTS)} with simulated pushes"
        )
    else:
        sets = [(name, SIMULATED_LOG, find_shipped_object(name)) for name in STAND_INS]
    engines = [LCP_ENGINE]
    if options.plants:
        engines.append(DRAKE_ENGINE)
    # MuJoCo is in an extra, so that its column is left out where it is not installed
    if options.plants and is_installed("mujoco"):
        engines.append(MUJOCO_ENGINE)
    return [
        RealityJob(
            name=name,
            kind=kind,
            path=path,
            split=split,
            test=options.test,
            engines=tuple(engines),
            seed=options.seed,
        )
        for name, kind, path in sets
        for split in range(options.splits)
    ]


def run_job(job: RealityJob) -> list[RealityScore]:
    """Learns from one division of one set, and predicts the held-out pushes in every simulator."""
    known = read_job(job)
    division = divide(known, job.test, job.seed, job.split)
    known = place_runs(known, division.training[max(division.training)])
    test_runs = [known.runs[i] for i in division.test_runs]
    test = known.log.subset(division.test)

    # What is believed of the object
    believed: list[tuple[str, int, Model]] = [(EVEN_MODEL, 0, Model(known.obj))]
    for count, pushes in division.training.items():
        training = known.log.subset(pushes)
        for name in list_learned(job.kind):
            found = identify(
                Model(known.obj), training, seed=job.seed, fit_frame=name == FRAME_MODEL
            )
            believed.append((name, count, found))

    # What each simulator makes of it
    def score(model: str, training: int, engine: str, ends: Sequence[Array]) -> RealityScore:
        errors = [calc_error(end, seen.final_pose) for end, seen in zip(ends, test, strict=True)]
        return RealityScore(
            name=job.name,
            kind=job.kind,
            split=job.split,
            model=model,
            training=training,
            engine=engine,
            pushes=division.test,
            errors=tuple(errors),
        )

    still = score(STILL_MODEL, 0, LCP_ENGINE, [seen.pose for seen in test])
    ends = [calc_run_score(known.obj, run.pose, run) for run in test_runs]
    scores = [replace(still, runs=tuple(ends))]
    for name, count, model in believed:
        for engine in job.engines:
            found_ends = find_ends(engine, model, test)
            one = score(name, count, engine, found_ends)
            if engine == LCP_ENGINE:
                one = replace(
                    one,
                    ranks=tuple(calc_ranks(model, test, found_ends)),
                    slips=tuple(judge_slips(known, division.test, model, found_ends)),
                    runs=tuple(
                        calc_run_score(known.obj, find_run_end(model, run), run)
                        for run in test_runs
                    ),
                )
            scores.append(one)
    return scores


def find_ends(engine: str, model: Model, log: PushLog) -> list[Array]:
    """Predicts where pushes end.

    Args:
        engine: name of the simulator.
        model: the object with its masses and frictions.
        log: the pushes, all with one pusher.

    Returns:
        Of each push the object's last pose (3,), m and rad.
    """
    if engine == LCP_ENGINE:
        return [motion.poses[-1] for motion in predict(model, log, "quasi_static")]
    first = log[0].push
    if engine == MUJOCO_ENGINE:
        shape = first.shape or PusherShape.disc(first.radius)
        plant = MujocoPlant(model.obj, model.params, shape)
        return [plant.push(hasten(seen.push), seen.pose) for seen in log]
    radius = None if first.shape else first.radius
    world = PlantWorld(Model(model.obj, model.params), radius=radius, shape=first.shape)
    ends = []
    for seen in log:
        world.put(seen.pose)
        world.execute(hasten(seen.push))
        motion = world.truth.motion
        assert motion is not None
        ends.append(motion.poses[-1])
    return ends


def hasten(push: Push) -> Push:
    """Makes a push as fast as `PLANT_SPEED`, if it is slower."""
    factor = PLANT_SPEED * push.duration / push.length
    if factor <= 1.0:
        return push
    if push.shape is None:
        return Push.along(push.t / factor, push.xy, push.radius)
    return Push.along(push.t / factor, push.xy, shape=push.shape, yaw=push.yaw)


def calc_ranks(model: Model, log: PushLog, ends: Sequence[Array]) -> list[float]:
    """Calculates the probability of a smaller error of each push than the one that was seen.

    Args:
        model: what is believed; where it was not learned, it says nothing of its errors.
        log: the pushes.
        ends: (3,) where it says that each ends, m and rad.

    Returns:
        The probabilities, spread evenly from 0 to 1 if what the model says of its errors is true.
    """
    if not isinstance(model, Identification):
        return []
    ranks = []
    for spread, end, seen in zip(predict_spread(model, log), ends, log, strict=True):
        cells = model.obj.cells_at(end) - model.obj.cells_at(seen.final_pose)
        error = float(np.sqrt((cells**2).sum(axis=1).mean()))
        ranks.append(spread.calc_probability(error))
    return ranks


def judge_slips(
    known: RealSet, numbers: Sequence[int], model: Model, ends: Sequence[Array]
) -> list[SlipScore]:
    """Compares how far the object slips from its pusher, as predicted, with what was seen.

    Args:
        known: the set; of pushes by discs alone nothing is judged.
        numbers: numbers of the pushes.
        model: what is believed.
        ends: (3,) where it says that each ends, m and rad.
    """
    if known.kind not in MAX_SLIP:
        return []
    gap = START_GAP[known.kind]
    limits = MAX_SLIP[known.kind]

    def slip(seen: ObservedPush, end: Array) -> Slip:
        return calc_slip(model.obj, seen.push, seen.pose, end, gap)

    scores = []
    for number, end in zip(numbers, ends, strict=True):
        push = known.log[number]
        said = slip(push, end)
        seen = slip(push, push.final_pose)
        cone = calc_push_stability(model, push.push, push.pose, count=1, tolerance=gap)
        stable = seen.is_within(*limits) if known.stayed is None else known.stayed[number]
        score = SlipScore(
            said=said.distance,
            said_angle=said.angle,
            seen=seen.distance,
            seen_angle=seen.angle,
            predicted_stable=said.is_within(*limits),
            cone_stable=cone.is_stable,
            stable=stable,
        )
        scores.append(score)
    return scores


def find_run_end(model: Model, run: LiftedRun) -> Array:
    """Predicts where a run ends, (3,), from where the object lies at its beginning."""
    pose = run.pose
    for push in run.pushes:
        pose = simulate(model, push, pose, regime="quasi_static").final_pose
    return pose


def calc_run_score(obj: GridObject, end: Array, run: LiftedRun) -> RunScore:
    """Compares a predicted end (3,) of a run with the one that was seen."""
    off = calc_pose_error(obj, end, run.end)
    return RunScore(position=off.position, angle=off.angle)


def tabulate(options: RealityBenchOptions, done: Done) -> list[Table]:
    """Makes the tables, of pushes and of runs, and draws the pictures."""
    scores = [score for scores in done.of(SPLIT_JOBS) for score in scores]
    jobs = [job for job, _ in done.list_pairs(SPLIT_JOBS)]
    tables = [tabulate_pushes(jobs, scores)]
    if any(score.runs for score in scores):
        tables.append(tabulate_runs(jobs, scores))
    if options.pictures is not None:
        sets = {job.name: read_job(job) for job in jobs if job.split == 0}
        write_pictures(options.pictures, sets, scores, options.force)
    return tables


SPLIT_JOBS = JobKind(
    job=RealityJob, run=run_job, describe=lambda job: f"{job.name}, split {job.split}"
)
"""What is done with a job."""

STUDY = Study(
    name="reality",
    help="Predict every set of real pushes (--data), or simulated ones in their place, by our "
    "model and by Drake's and MuJoCo's plants with the same masses.",
    options=RealityBenchOptions,
    shorten=shorten,
    make_jobs=make_jobs,
    tasks=(SPLIT_JOBS,),
    tabulate=tabulate,
)
"""`gridpush bench reality`."""
