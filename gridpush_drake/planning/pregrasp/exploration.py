"""Which poke to make next: the one that is expected to tell most about what matters.

What was learned is z = (log k_1 .. log k_n, log mu_c) ~ N(mean, S). A push whose end would be seen
as the residual r = J z + noise, with J exact from its simulation and noise ~ N(0, R)
(`identification.noise.NoiseModel`), leaves

    S' = S - S J^T (J S J^T + R)^-1 J S

whatever will be seen. What matters is linear in z near the mean, f = F z: the center of friction,
which is the center of mass where all cells rub alike; how far the center of mass can be in one
direction, by the friction's bounds; or the poses that other pushes are predicted to end in. The
poke is chosen that makes the largest eigenvalue of F S' F^T least, the variance of what is then
known least (Bayesian linear design by its worst direction: Chaloner and Verdinelli 1995, section 2;
`docs/theory/identification.md`, section 7).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from threadpoolctl import threadpool_limits

from gridpush_drake.dynamics.motion import MotionStatus
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import PlanningError, require_positive
from gridpush_drake.geometry.se2 import Array, transform_back
from gridpush_drake.identification.identifiability import calc_farthest_center
from gridpush_drake.identification.posterior import calc_center_jacobian
from gridpush_drake.identification.problem import PushProblem
from gridpush_drake.planning.contact.reachable_outline import find_reachable_outline
from gridpush_drake.planning.contact.trial import DEFAULT_RADIUS
from gridpush_drake.planning.pregrasp.uncertainty import UncertainModel
from gridpush_drake.planning.push_constraints import PushConstraints
from gridpush_drake.pushes.push_log import ObservedPush, PushLog


@dataclass(frozen=True)
class PokeOptions:
    """What pokes may be chosen from.

    Attributes:
        radius: of the finger, a disc, m.
        speed: of the finger, m/s.
        distance: of a poke, the clearance included, m.
        clearance: gap between finger and object at the beginning, m.
        places: along the outline.
        angles: of the motion from the inward normal, rad.
        min_separation: share of the outline's length that a poke begins away from every poke made
            before: what the model gets wrong it would get wrong again.
    """

    radius: float = DEFAULT_RADIUS
    speed: float = 0.03
    distance: float = 0.04
    clearance: float = 0.002
    places: int = 36
    angles: tuple[float, ...] = (-0.4, 0.0, 0.4)
    min_separation: float = 0.04

    def __post_init__(self) -> None:
        require_positive(
            PlanningError, "poke: ", radius=self.radius, speed=self.speed, distance=self.distance
        )
        if self.places < 1 or not self.angles:
            raise PlanningError("poke: expected at least one place and one angle")


@dataclass(frozen=True, eq=False)
class PokeChoice:
    """The poke to make next."""

    push: Push  # the poke
    index: int  # among those offered
    std: float  # of what matters, in the direction least known, now
    expected_std: float  # the same after the poke
    expected_stds: (
        Array  # (N,) the same for every poke offered; infinite where it would not touch the object
    )


def make_pokes(
    model: UncertainModel,
    pose: ArrayLike,
    options: PokeOptions | None = None,
    constraints: PushConstraints | None = None,
) -> list[Push]:
    """Makes pokes to choose from: all places, with all angles, that are new, touch the object and break no rule.

    The object lies at `pose` (3,); the predicted motion keeps `constraints` to the end. There may
    be none.
    """
    options = options or PokeOptions()
    obj, params = model.obj, model.params
    q = np.asarray(pose, dtype=np.float64)
    reach = find_reachable_outline(obj, options.radius, options.clearance)
    checker = (constraints or PushConstraints()).start_at(obj, q, options.radius)
    pokes = []
    for s in reach.spread(reach.length / options.places)[0]:
        for angle in options.angles:
            push = Push.on_outline(
                obj, float(s), angle, options.distance, radius=options.radius, speed=options.speed, pose=q,
                clearance=options.clearance,
            )  # fmt: skip
            begins = transform_back(q, push.start[None])
            if (
                np.linalg.norm(model.poke_starts - begins, axis=1)
                < options.min_separation * reach.perimeter
            ).any():
                continue
            motion = simulate(obj, params, push, q, physics=model.physics)
            if motion.status == MotionStatus.OK and checker.count_allowed(
                motion.tip, motion.poses
            ) == len(motion.tip):
                pokes.append(push)
    return pokes


@threadpool_limits.wrap(limits=1, user_api="blas")
def choose_poke(
    model: UncertainModel, pose: ArrayLike, pokes: Sequence[Push], F: Array
) -> PokeChoice:
    """Chooses the poke that is expected to leave the least variance of what matters, in the direction least known.

    Args:
        model: of the object, with its posterior.
        pose: (3,) where the object lies, X_WB, m and rad.
        F: (m, n+1) what matters, as derivatives by z.

    Raises:
        PlanningError: there is no poke to choose from, or none touches the object.
    """
    if not pokes:
        raise PlanningError("pokes: none; expected at least one to choose from")
    S = model.require_posterior().covariance
    stds = np.full(len(pokes), np.inf)
    for i, push in enumerate(pokes):
        seen = calc_observation(model, push, pose)
        if seen is not None:
            stds[i] = calc_worst_std(calc_remaining(S, F, *seen))
    best = int(np.argmin(stds))
    if not np.isfinite(stds[best]):
        raise PlanningError("pokes: none of them touches the object")
    return PokeChoice(pokes[best], best, calc_worst_std(F @ S @ F.T), float(stds[best]), stds)


def calc_observation(
    model: UncertainModel, push: Push, pose: ArrayLike
) -> tuple[Array, Array] | None:
    """What the end of a push from `pose` (3,) would show; None where it does not touch the object.

    Returns J (3, n+1) of the residual by z, and R (3, 3) its noise, m².
    """
    obj, q = model.obj, np.asarray(pose, dtype=np.float64)
    seen = ObservedPush("poke", push, q, np.array([push.duration]), q[None])
    problem = PushProblem(obj, PushLog((seen,)), model.params, model.physics)
    linear = problem.linearize(model.require_posterior().mean)
    J = linear.by_z[0]
    if not J.any():
        return None
    return J, model.noise.calc_covariance(linear.by_inputs[0], model.noise_scale)


def calc_remaining(S: Array, F: Array, J: Array, R: Array) -> Array:
    """Covariance (m, m) of what matters, F (m, n+1), after J (r, n+1) was observed with noise R (r, r): F S' F^T."""
    SJ = S @ J.T
    G = F @ SJ
    return np.asarray(F @ S @ F.T - G @ np.linalg.solve(J @ SJ + R, G.T))


def calc_worst_std(covariance: Array) -> float:
    """Standard deviation in the direction least known, of a covariance (m, m)."""
    return float(np.sqrt(max(np.linalg.eigvalsh(covariance)[-1], 0.0)))


def make_center_functional(model: UncertainModel, direction: ArrayLike | None = None) -> Array:
    """The center of friction, m: its derivatives by z, (2, n+1), or (1, n+1) along `direction` (2,), body frame."""
    F = calc_center_jacobian(model.require_posterior().calc_share(), model.obj.p_BC)
    return F if direction is None else np.asarray(direction, dtype=np.float64)[None] @ F


def make_farthest_functional(model: UncertainModel, direction: ArrayLike) -> Array:
    """How far the center of mass can be along `direction` (2,), body frame, m, by the friction's bounds: as above.

    The bounds take it the farther, the more of the friction is far out on either side; the center
    of friction alone may be known well long before that is.
    """
    d = np.asarray(direction, dtype=np.float64)
    along, share = model.obj.p_BC @ d, model.require_posterior().calc_share()
    low, high = model.friction_range or (model.obj.prior.friction_min, model.obj.prior.friction_max)
    farthest = calc_farthest_center(along, share[None] / high, share[None] / low)[0]
    mass = share / np.where(along > farthest, low, high)
    return np.asarray(d[None] @ calc_center_jacobian(mass / mass.sum(), model.obj.p_BC))
