"""What pokes are worth: pokes by design against random ones, from the same hidden truth.

The center of mass is wanted in both directions or, as for a goal at the table's edge, across one
line: here along the object's longest direction. Both ways choose from the same pokes, all of one
length. A long poke tells more, whichever it is, and two or three of them are needed in any case: so
the shorter the pokes, the more there is to gain by design.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from gridpush_drake.bench.data.protocol import add_pose_noise
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.belief import Belief
from gridpush_drake.planning.exploration.designed_pokes import (
    DesignedPokes,
    PokeOptions,
    make_center_functional,
    make_pokes,
)
from gridpush_drake.planning.exploration.strategy import PokeProposal, PokeStrategy
from gridpush_drake.planning.push_constraints import PushConstraints
from gridpush_drake.planning.world import SimulatedWorld
from gridpush_drake.pushes.push_log import ObservedPush, PushLog
from gridpush_drake.report.table import Column, Table
from gridpush_drake.units import MM_PER_M, PERCENT_PER_ONE

WANTED_STD = 0.005
"""Standard deviation of the center of mass that pokes are to reach, m: in the direction that is
wanted or, of both, in the one least known."""

BOTH_DIRECTIONS = "both directions"
"""Aim at the center of mass in both directions."""

ALONG_OBJECT = "along the object"
"""Aim at the center of mass along the object's longest direction."""

AIM_NAMES = (BOTH_DIRECTIONS, ALONG_OBJECT)
"""What of the center of mass is wanted."""

POKE_LENGTHS = (0.02, 0.04, 0.08)
"""Lengths of the pokes, m."""

MAX_POKES = 20
"""Number of pokes after which one gives up; it then counts as one more."""

CHI_SQUARE_BOUNDS = {BOTH_DIRECTIONS: 5.991 / 2, ALONG_OBJECT: 3.841}
"""Values per direction that 95 % of chi squares stay below: of two degrees of freedom, and of
one."""


@dataclass(frozen=True)
class Trace:
    """One run of pokes.

    Attributes:
        pokes: number of pokes until the standard deviation was small; MAX_POKES + 1 where it never
            was.
        error: error of the final estimate of what is wanted, m.
        chi_square: its square in units of the estimate's covariance, for each direction wanted; 1
            on average where the covariance is right.
    """

    pokes: int
    error: float
    chi_square: float


@dataclass(frozen=True)
class ExplorationScore:
    """Pokes by design and at random, with one object and one mass set.

    Attributes:
        name: name of the object.
        aim: what of the center of mass is wanted, one of AIM_NAMES.
        distance: length of the pokes, m.
        active: the run of pokes by design.
        random: the run of pokes at random.
    """

    name: str
    aim: str
    distance: float
    active: Trace
    random: Trace


EXPLORE_COLUMNS: dict[str, Column] = {
    "runs": len,
    "by design": lambda scores: _mean_pokes(scores, "active"),
    "at random": lambda scores: _mean_pokes(scores, "random"),
    "ratio": lambda scores: _mean_pokes(scores, "active") / _mean_pokes(scores, "random"),
    "error, mm": lambda scores: MM_PER_M * float(np.mean([score.active.error for score in scores])),
    "at random, mm": lambda scores: (
        MM_PER_M * float(np.mean([score.random.error for score in scores]))
    ),
    "within 95 %, %": lambda scores: (
        PERCENT_PER_ONE * float(np.mean([_is_within(score) for score in scores]))
    ),
}


def _mean_pokes(scores: Sequence[ExplorationScore], way: str) -> float:
    return float(np.mean([getattr(score, way).pokes for score in scores]))


def _is_within(score: ExplorationScore) -> list[bool]:
    return [
        trace.chi_square <= CHI_SQUARE_BOUNDS[score.aim] for trace in (score.active, score.random)
    ]


def tabulate_exploration(scores: Sequence[ExplorationScore]) -> Table:
    """Tabulates the pokes needed, by their length, and whether the stated spread is right."""
    lengths = sorted({score.distance for score in scores})
    groups = [
        (
            (aim, MM_PER_M * length),
            [score for score in scores if (score.aim, score.distance) == (aim, length)],
        )
        for aim in AIM_NAMES
        for length in lengths
    ]
    title = f"Pokes until the center of mass is known to {WANTED_STD * MM_PER_M:.0f} mm"
    notes = (
        "by design, at random: mean number of pokes; the poke said to tell most, or any of the "
        "same pool.",
        "wanted: of the center of mass; in both directions the least known one counts.",
        "error: mean distance of the final estimate from the true center.",
        "within 95 %: runs of either kind whose true center is within the 95 % range that the "
        "estimate states.",
    )
    return Table.of(title, ("wanted", "poke, mm"), groups, EXPLORE_COLUMNS, notes)


def tabulate_exploration_by_object(
    scores: Sequence[ExplorationScore], objects: Sequence[str]
) -> Table:
    """Tabulates the pokes needed by object, over all lengths."""
    groups = [
        ((aim, name), [score for score in scores if (score.aim, score.name) == (aim, name)])
        for aim in AIM_NAMES
        for name in objects
    ]
    return Table.of(
        "The same by object, pokes of all lengths", ("wanted", "object"), groups, EXPLORE_COLUMNS
    )


POKE_COMPARISONS = {
    f"exploring, {aim}, {1e3 * distance:.0f} mm": (aim, distance)
    for distance in POKE_LENGTHS
    for aim in AIM_NAMES
}
"""Comparisons of pokes by their names, with what is wanted of the center of mass, and the pokes'
length, m."""


def explore(
    obj: GridObject,
    truth: CellParameters,
    name: str,
    mass_set: int,
    seed: int,
    aim: str = BOTH_DIRECTIONS,
    distance: float = PokeOptions().distance,
) -> ExplorationScore:
    """Pokes an object by design and at random, from the same hidden truth.

    All its cells are made to rub alike: only then is the center of friction the center of mass.

    Args:
        obj: the object.
        truth: its true masses.
        name: name of the object.
        mass_set: number of the hidden set of masses, which seeds the noise too.
        seed: seed of the noise.
        aim: what of the center of mass is wanted, one of AIM_NAMES.
        distance: length of the pokes, m.
    """
    alike = CellParameters(truth.mass, np.full(obj.n, obj.prior.friction), truth.contact_friction)
    long = np.linalg.svd(obj.p_BC - obj.p_BC.mean(axis=0))[2][0]
    wanted = np.eye(2) if aim == BOTH_DIRECTIONS else long[None]
    options = PokeOptions(distance=distance)
    runs = []
    for active in (True, False):
        rng = np.random.default_rng([seed, mass_set])
        designed = DesignedPokes(options, lambda model: wanted @ make_center_functional(model))
        strategy = designed if active else DrawnPokes(options, rng)
        runs.append(_poke(obj, alike, wanted, strategy, rng, keeps_apart=active))
    return ExplorationScore(name=name, aim=aim, distance=distance, active=runs[0], random=runs[1])


@dataclass(frozen=True, eq=False)
class DrawnPokes:
    """Proposes any of the pokes that could be chosen by design.

    Attributes:
        options: what pokes may be chosen from.
        rng: draws them.
    """

    options: PokeOptions
    rng: np.random.Generator

    def propose(self, belief: Belief, pose: ArrayLike, rules: PushConstraints) -> PokeProposal:
        """Proposes the next poke, see `PokeStrategy`."""
        pokes = make_pokes(belief, pose, self.options, rules)
        if not pokes:
            return PokeProposal(None, "there is no new place left")
        return PokeProposal(pokes[int(self.rng.integers(len(pokes)))], candidates=len(pokes))


def _poke(
    obj: GridObject,
    truth: CellParameters,
    wanted: Array,
    strategy: PokeStrategy[Belief, PushConstraints],
    rng: np.random.Generator,
    *,
    keeps_apart: bool,
) -> Trace:
    """Makes one run.

    Args:
        obj: the object.
        truth: its true masses and frictions.
        wanted: (1, 2) or (2, 2) the directions in which the center of mass is wanted.
        strategy: chooses the pokes.
        rng: draws the noise.
        keeps_apart: whether the strategy is told where pokes were made before.
    """
    center = wanted @ truth.center_of_mass(obj)
    found = None
    model = Belief.of_prior(obj)
    pose = np.zeros(3)
    world = SimulatedWorld(Model(obj, truth), pose)
    log = list[ObservedPush]()
    std = np.inf
    error = np.inf
    chi_square = np.inf
    while len(log) < MAX_POKES and not std < WANTED_STD:
        push = strategy.propose(model, pose, PushConstraints()).push
        if push is None:
            break  # there is no new place left
        # The object is pushed from where it was seen: what is compared are the choices alone.
        world.put(pose)
        after = add_pose_noise(world.execute(push).final_pose, rng)
        log.append(
            ObservedPush(f"poke_{len(log)}", push, pose, np.array([push.duration]), after[None])
        )
        pose = after

        # What was learned, and how far off it is.
        seen = PushLog(tuple(log))
        found = identify(Model(obj), seen, regime="quasi_static", start=found)
        model = Belief.of_identification(found, log=seen if keeps_apart else None)
        covariance = wanted @ found.identifiability.center_of_friction_covariance @ wanted.T
        off = wanted @ found.identifiability.center_of_friction - center
        std = float(np.sqrt(np.linalg.eigvalsh(covariance)[-1]))
        error = float(np.linalg.norm(off))
        chi_square = float(off @ np.linalg.solve(covariance, off)) / len(wanted)
    pokes_needed = len(log) if std < WANTED_STD else MAX_POKES + 1
    return Trace(pokes=pokes_needed, error=error, chi_square=chi_square)
