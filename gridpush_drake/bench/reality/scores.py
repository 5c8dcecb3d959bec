"""What one division of a set of real pushes is, and what was measured of it."""

from dataclasses import dataclass
from pathlib import Path

from gridpush_drake.bench.data.real_logs import DUBINS_LOG, SIMULATED_LOG
from gridpush_drake.bench.data.real_sets import RealSet, read_set, simulate_set

STILL_MODEL = "does not move"
EVEN_MODEL = "even object"
LEARNED_MODEL = "learned"
FRAME_MODEL = "learned, frame"
SET_MODEL = "the set's own model"
"""Names of what is believed of an object."""

LCP_ENGINE = "ours"
DRAKE_ENGINE = "Drake"
MUJOCO_ENGINE = "MuJoCo"
"""Names of the simulators."""

PLANT_SPEED = 0.02
"""Least speed of the pusher in the plants, m/s. Slower pushes are made at this speed, from which an
object that slides with a friction of 0.3 stops within 0.07 mm."""


@dataclass(frozen=True)
class RealityJob:
    """One division of one set.

    Attributes:
        name: name of the set.
        kind: kind of the set, of `bench.data.real_logs`.
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
class SlipScore:
    """What was said of how far an object slips from its pusher in one push, and what was seen.

    Attributes:
        said: distance, m, that the simulation says.
        said_angle: angle, rad, that it says.
        seen: distance that was seen, m.
        seen_angle: angle that was seen, rad.
        predicted_stable: whether that is little enough to call the push stable.
        cone_stable: whether the motion cone says that the object does not slip at all.
        stable: whether the push was stable.
    """

    said: float
    said_angle: float
    seen: float
    seen_angle: float
    predicted_stable: bool
    cone_stable: bool
    stable: bool


@dataclass(frozen=True)
class RunScore:
    """How far the predicted end of a run is off.

    Attributes:
        position: m.
        angle: rad.
    """

    position: float
    angle: float


@dataclass(frozen=True)
class RealityScore:
    """How far predictions of held-out pushes are off.

    Attributes:
        name: name of the set.
        kind: its kind.
        split: number of the division.
        model: what is believed of the object.
        training: number of pushes, or of runs, that were learned from.
        engine: name of the simulator.
        pushes: number of each held-out push in the set.
        errors: |dxy| + rho |dtheta| of each of them, m.
        ranks: probability of an error below that of each of them, as a learned model says it.
        slips: of each of them, by several tips, how far the object slips.
        runs: of each held-out run, how far its end is off.
    """

    name: str
    kind: str
    split: int
    model: str
    training: int
    engine: str
    pushes: tuple[int, ...]
    errors: tuple[float, ...]
    ranks: tuple[float, ...] = ()
    slips: tuple[SlipScore, ...] = ()
    runs: tuple[RunScore, ...] = ()


def read_job(job: RealityJob) -> RealSet:
    """Reads the set of a job, or simulates the pushes that stand in for one."""
    if job.kind == SIMULATED_LOG:
        return simulate_set(job.path, job.seed, job.split)
    return read_set(job.path, job.kind)


def list_learned(kind: str) -> tuple[str, ...]:
    """Lists the models that are learned of a set. Frames of outlines are sure but of runs' sets."""
    return (LEARNED_MODEL, FRAME_MODEL) if kind == DUBINS_LOG else (LEARNED_MODEL,)
