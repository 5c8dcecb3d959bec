"""`gridpush bench reality`: every set of real pushes at hand, in one table.

The rows are the sets, each with what is believed of the object:

    does not move     it stays where it is: how much there is to predict
    even object       all cells alike: what is believed before the first push
    learned           masses and frictions learned from a few pushes of the set
    the set's own     predictions of another model that come with the set, where there are any

The columns are the simulators that then predict held-out pushes: ours, and Drake's and MuJoCo's
plants with the very same masses and frictions. What repeated pushes differ by is the least error
that is possible.

Without real pushes, simulated ones stand in, and the table says so. The plants push faster than
slow robots do, as that changes next to nothing: see `PLANT_SPEED`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from gridpush_drake.bench.data.real_logs import (
    CMU_LOG,
    MIT_LOG,
    SIMULATED_LOG,
    SIMULATED_PUSH_COUNT,
    find_push_logs,
    name_logs,
    simulate_log,
)
from gridpush_drake.bench.real import CMU_RHO, calc_splits_mean
from gridpush_drake.bench.study import Done, JobKind, Study, StudyOptions, option
from gridpush_drake.bench.worlds.mujoco_plant import MujocoPlant
from gridpush_drake.bench.worlds.plant import PlantWorld
from gridpush_drake.dynamics.push import Push
from gridpush_drake.errors import GridPushError
from gridpush_drake.geometry.se2 import Array, wrap_angle
from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.prediction import predict
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import find_shipped_object
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.pushes.importers import find_importer
from gridpush_drake.pushes.importers.mit import read_model_errors
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.report.table import Mean, Table, Value
from gridpush_drake.units import MM_PER_M

STILL_MODEL = "does not move"
EVEN_MODEL = "even object"
LEARNED_MODEL = "learned"
SET_MODEL = "the set's own model"
"""Names of what is believed of an object."""

LCP_ENGINE = "ours"
DRAKE_ENGINE = "Drake"
MUJOCO_ENGINE = "MuJoCo"
"""Names of the simulators."""

TRAINING_PUSH_COUNTS = (5, 25)
"""Numbers of pushes to learn from."""

DEFAULT_TEST_COUNT = 20
"""Number of held-out pushes of each division, by default."""

DEFAULT_SPLIT_COUNT = 5
"""Number of divisions of a set into pushes to learn from and others, by default."""

STAND_INS = ("claw_hammer", "toolbox")
"""Shipped objects whose simulated pushes stand in for real ones."""

QUICK_SPLITS = 1
QUICK_TEST = 3
"""Numbers of divisions and of held-out pushes in the quick variant."""

REPEATABILITY = {CMU_LOG: 1.4}
"""What repeated pushes differ by, mm, by the kind of set, where it is known."""

PLANT_SPEED = 0.02
"""Least speed of the pusher in the plants, m/s. Slower pushes are made at this speed, from which an
object that slides with a friction of 0.3 stops within 0.07 mm."""


@dataclass(frozen=True)
class RealityBenchOptions(StudyOptions):
    """What is measured.

    Attributes:
        data: folder of real pushes; None for simulated ones.
        splits: number of divisions of a set into pushes to learn from and others.
        test: number of held-out pushes of each division.
        plants: whether Drake's and MuJoCo's plants predict, too.
    """

    data: Path | None = option(
        None,
        "Real pushes: a clone of GitHub robinzhoucmu/MLab_EXP or "
        "robinzhoucmu/PlanarManipulationToolBox, or a folder that holds such logs. Without, "
        "simulated pushes stand in.",
        name="--data",
        metavar="DIR",
    )
    splits: int = option(
        DEFAULT_SPLIT_COUNT, "Divisions of a set into pushes to learn from and others.", least=1
    )
    test: int = option(DEFAULT_TEST_COUNT, "Held-out pushes of each division.", least=1)
    plants: bool = option(True, "Let Drake's and MuJoCo's plants predict, too.")


@dataclass(frozen=True)
class RealityJob:
    """One division of one set.

    Attributes:
        name: name of the set.
        kind: kind of the set: CMU, MIT or SIMULATED_LOG of `bench.real`.
        path: its file, or that of the object whose pushes are simulated.
        split: number of the division, and of the simulated truth.
        test: number of held-out pushes.
        engines: names of the simulators.
        seed: seed of everything random.
    """

    name: str
    kind: str
    path: Path
    split: int
    test: int
    engines: tuple[str, ...]
    seed: int


@dataclass(frozen=True)
class RealityScore:
    """How far predictions of held-out pushes are off.

    Attributes:
        name: name of the set.
        kind: its kind.
        split: number of the division.
        model: what is believed of the object.
        training: number of pushes that were learned from.
        engine: name of the simulator.
        pushes: number of each held-out push in the set.
        errors: |dxy| + rho |dtheta| of each of them, m.
    """

    name: str
    kind: str
    split: int
    model: str
    training: int
    engine: str
    pushes: tuple[int, ...]
    errors: tuple[float, ...]


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
    needed = max(TRAINING_PUSH_COUNTS) + options.test
    if options.data is not None:
        sets = name_logs(find_push_logs(Path(options.data).resolve(), needed))
        for _, kind, path in sets:
            _read_file(path, kind)
    elif needed > SIMULATED_PUSH_COUNT:
        raise GridPushError(
            f"--test: {options.test}; expected at most "
            f"{SIMULATED_PUSH_COUNT - max(TRAINING_PUSH_COUNTS)} with simulated pushes"
        )
    else:
        sets = [(name, SIMULATED_LOG, find_shipped_object(name)) for name in STAND_INS]
    engines = [LCP_ENGINE]
    if options.plants:
        engines.append(DRAKE_ENGINE)
    # MuJoCo is in an extra, so that its column is left out where it is not installed
    if options.plants and find_spec("mujoco"):
        engines.append(MUJOCO_ENGINE)
    jobs = []
    for name, kind, path in sets:
        for split in range(options.splits):
            job = RealityJob(
                name=name,
                kind=kind,
                path=path,
                split=split,
                test=options.test,
                engines=tuple(engines),
                seed=options.seed,
            )
            jobs.append(job)
    return jobs


def _read(job: RealityJob) -> tuple[PushLog, GridObject]:
    """Reads the set of a job, or simulates the pushes that stand in for one."""
    if job.kind == SIMULATED_LOG:
        return simulate_log(job.path, job.seed, job.split)
    return _read_file(job.path, job.kind)


@lru_cache(maxsize=1)
def _read_file(path: Path, kind: str) -> tuple[PushLog, GridObject]:
    """Reads a set of real pushes. The center of mass of a CMU plate is told: it is even."""
    log, obj = find_importer(kind)().read(path)
    if kind == CMU_LOG:
        obj = replace(obj, prior=replace(obj.prior, center_of_mass=(0.0, 0.0)))
    return log, obj


def run_job(job: RealityJob) -> list[RealityScore]:
    """Learns from one division of one set, and predicts the held-out pushes in every simulator."""
    log, obj = _read(job)
    order = np.random.default_rng([job.seed, job.split]).permutation(len(log))
    held_out = [int(number) for number in order[: job.test]]
    test = log.subset(held_out)
    rest = order[job.test :]

    # What is believed of the object
    believed = [(EVEN_MODEL, 0, CellParameters.uniform(obj))]
    for count in TRAINING_PUSH_COUNTS:
        found = identify(Model(obj), log.subset(rest[:count]), seed=job.seed)
        believed.append((LEARNED_MODEL, count, found.params))

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
            pushes=tuple(held_out),
            errors=tuple(errors),
        )

    scores = [score(STILL_MODEL, 0, LCP_ENGINE, [seen.pose for seen in test])]
    for model, training, params in believed:
        for engine in job.engines:
            ends = find_ends(engine, obj, params, test)
            scores.append(score(model, training, engine, ends))
    return scores


def find_ends(engine: str, obj: GridObject, params: CellParameters, log: PushLog) -> list[Array]:
    """Predicts where pushes end.

    Args:
        engine: name of the simulator.
        obj: the object.
        params: its masses and frictions.
        log: the pushes, all with one pusher.

    Returns:
        Of each push the object's last pose (3,), m and rad.
    """
    if engine == LCP_ENGINE:
        return [motion.poses[-1] for motion in predict(Model(obj, params), log, "quasi_static")]
    radius = log[0].push.radius
    if engine == MUJOCO_ENGINE:
        plant = MujocoPlant(obj, params, radius)
        return [plant.push(hasten(seen.push), seen.pose) for seen in log]
    world = PlantWorld(Model(obj, params), radius=radius)
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
    return push if factor <= 1.0 else Push.along(push.t / factor, push.xy, push.radius)


def calc_error(one: Array, other: Array) -> float:
    """Calculates |dxy| + rho |dtheta| of two poses (3,), m."""
    dx, dy, turn = one - other
    return float(np.hypot(dx, dy) + CMU_RHO * abs(wrap_angle(turn)))


def tabulate(options: RealityBenchOptions, done: Done) -> list[Table]:
    """Makes the one table."""
    scores = [score for scores in done.of(SPLIT_JOBS) for score in scores]
    jobs = [job for job, _ in done.list_pairs(SPLIT_JOBS)]
    engines = jobs[0].engines
    rows: list[list[Value]] = []
    for name, kind, path in dict.fromkeys((job.name, job.kind, job.path) for job in jobs):
        for model, training in (
            (STILL_MODEL, 0),
            (EVEN_MODEL, 0),
            *((LEARNED_MODEL, count) for count in TRAINING_PUSH_COUNTS),
        ):
            means = [_calc_mean(scores, name, model, training, engine) for engine in engines]
            rows.append([name, model, training, *means, REPEATABILITY.get(kind)])
        if kind == MIT_LOG:
            own = _read_own(path)
            rows.append([name, SET_MODEL, None, own, *[None] * (len(engines) - 1), None])
    notes = [
        f"Error |dxy| + rho |dtheta| of held-out pushes, rho = {MM_PER_M * CMU_RHO:.1f} mm; mean "
        "over "
        f"all that {options.splits} divisions held out, {options.test} each, ± 95 % confidence "
        "(Student's t over pushes; what other pushes to learn from would change is not in it).",
        "Drake and MuJoCo have the same masses and frictions as ours. Drake's object is held to "
        "the table's plane, MuJoCo's is free on its feet; both are pushed at "
        f"{MM_PER_M * PLANT_SPEED:g} mm/s at least.",
        "The center of mass of the CMU's plates is told: they are even.",
        f"{SET_MODEL}: the mean error over all pushes of the file by another model, as the file "
        "says.",
        "Repeated: what the same push differs by when it is made again, where that is known.",
    ]
    title = "Real pushes: held-out error, mm"
    if options.data is None:
        title = "Simulated stand-in for real pushes: held-out error, mm"
        notes.insert(0, "Nothing here is real: pass real robots' pushes with --data.")
    columns = ("set", "model", "training", *engines, "repeated")
    return [Table(title, columns, rows, notes, keys=3)]


def _calc_mean(
    scores: Sequence[RealityScore], name: str, model: str, training: int, engine: str
) -> Mean | None:
    """Calculates the mean over pushes, mm; None if a simulator did not predict with a model."""
    chosen = [
        score
        for score in scores
        if (score.name, score.model, score.training, score.engine)
        == (name, model, training, engine)
    ]
    if not chosen:
        return None
    # A push that several divisions held out counts once, with its mean error
    by_push: dict[tuple[str, int], list[float]] = {}
    for score in chosen:
        # Each division of simulated pushes has pushes of its own
        of = str(score.split) if score.kind == SIMULATED_LOG else ""
        for number, error in zip(score.pushes, score.errors, strict=True):
            by_push.setdefault((of, number), []).append(MM_PER_M * error)
    return calc_splits_mean(np.array([np.mean(errors) for errors in by_push.values()]))


def _read_own(path: Path) -> Mean:
    """Reads the mean error of a set's own model, mm."""
    position, angle = read_model_errors(path)
    return Mean(MM_PER_M * (position + CMU_RHO * angle))


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
