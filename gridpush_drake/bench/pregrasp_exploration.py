"""How many pokes it takes to find the center of mass, chosen by design and at random.

Either the center is wanted in both directions, or, as for a goal at the table's edge, across one line: here along the
object's longest direction. Both ways choose from the same pokes, all of one length. A long poke tells more, whichever
it is, and two or three of them are needed in any case: so the shorter the pokes, the more there is to gain by design.
"""

from dataclasses import dataclass

import numpy as np

from gridpush_drake.bench.pregrasp_world import add_pose_noise
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.learning import identify
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.pregrasp.exploration import PokeOptions, choose_poke, make_center_functional, make_pokes
from gridpush_drake.planning.pregrasp.uncertainty import UncertainModel
from gridpush_drake.pushes.push_log import ObservedPush, PushLog

WANTED_STD = 0.005
"""m, of the center of mass, in the direction wanted or, of both, in the one least known."""

BOTH, ALONG = "both directions", "along the object"
AIMS = (BOTH, ALONG)
"""What of the center of mass is wanted."""

DISTANCES = (0.02, 0.04, 0.08)
"""Of the pokes, m."""

MAX_POKES = 20
"""Made before giving up; then counted as one more."""


@dataclass(frozen=True)
class Trace:
    """One run.

    Attributes:
        pokes: made until the standard deviation was small; `MAX_POKES` + 1 where it never was.
        stds: of what is wanted after each poke, m.
        errors: of what is wanted after each poke, m.
        chi_square: squared error of the final estimate in units of its covariance, for each direction wanted; 1 on
            average where that is right.
    """

    pokes: int
    stds: tuple[float, ...]
    errors: tuple[float, ...]
    chi_square: float


@dataclass(frozen=True)
class ExplorationScore:
    """Both ways with one object and one mass set."""

    name: str
    aim: str
    distance: float
    active: Trace
    random: Trace


def explore(
    obj: GridObject,
    truth: CellParameters,
    name: str,
    mass_set: int,
    seed: int,
    aim: str = BOTH,
    distance: float = PokeOptions().distance,
) -> ExplorationScore:
    """Pokes an object both ways, from the same hidden truth.

    Args:
        obj: the object.
        truth: its hidden parameters. All its cells are made to rub alike: only then is the center of friction the
            center of mass.
        name: of the object.
        mass_set: number of the hidden set.
        seed: of noise and random pokes.
        aim: of AIMS.
        distance: of the pokes, m.

    Returns:
        The two runs.
    """
    alike = CellParameters(truth.mass, np.full(obj.n, obj.prior.friction), truth.contact_friction)
    long = np.linalg.svd(obj.p_BC - obj.p_BC.mean(axis=0))[2][0]
    wanted = np.eye(2) if aim == BOTH else long[None]
    options = PokeOptions(distance=distance)
    runs = [
        _run(obj, alike, wanted, options, active, np.random.default_rng([seed, mass_set])) for active in (True, False)
    ]
    return ExplorationScore(name, aim, distance, *runs)


def _run(
    obj: GridObject,
    truth: CellParameters,
    wanted: Array,
    options: PokeOptions,
    active: bool,
    rng: np.random.Generator,
) -> Trace:
    """One run; `wanted` (1 or 2, 2) are the directions in which the center is."""
    center, found = wanted @ truth.center_of_mass(obj), None
    model, pose, log = UncertainModel.of_prior(obj), np.zeros(3), list[ObservedPush]()
    stds: list[float] = []
    errors: list[float] = []
    chi_square = np.nan
    while len(log) < MAX_POKES and not (stds and stds[-1] < WANTED_STD):
        pokes = make_pokes(model, pose, options)
        if active:
            F = wanted @ make_center_functional(model)
            push = choose_poke(model, pose, pokes, F).push
        else:
            push = pokes[int(rng.integers(len(pokes)))]
        after = add_pose_noise(simulate(obj, truth, push, pose, regime="quasi_static").final_pose, rng)
        log.append(ObservedPush(f"poke_{len(log)}", push, pose, np.array([push.duration]), after[None]))
        pose = after
        seen = PushLog(tuple(log))
        found = identify(obj, seen, regime="quasi_static", start=found)
        model = UncertainModel.of_identification(found, log=seen if active else None)
        covariance = wanted @ found.identifiability.center_of_friction_covariance @ wanted.T
        error = wanted @ found.identifiability.center_of_friction - center
        stds.append(float(np.sqrt(np.linalg.eigvalsh(covariance)[-1])))
        errors.append(float(np.linalg.norm(error)))
        chi_square = float(error @ np.linalg.solve(covariance, error)) / len(wanted)
    count = len(log) if stds[-1] < WANTED_STD else MAX_POKES + 1
    return Trace(count, tuple(stds), tuple(errors), chi_square)
