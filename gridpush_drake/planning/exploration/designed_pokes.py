"""Pokes by design: the one that is expected to tell most about what matters.

What was learned is z = (log k_1 .. log k_n, log mu_c) ~ N(mean, S). A push whose end would be seen
as the residual r = J z + noise, with J exact from its simulation and noise ~ N(0, R)
(`identification.statistics.noise.NoiseModel`), leaves

    S' = S - S J^T (J S J^T + R)^-1 J S

whatever will be seen. What matters is linear in z near the mean, f = F z. It may be

    the center of friction, which is the center of mass where all cells rub alike,
    how far the center of mass can be in one direction, by the friction's bounds,
    the poses that other pushes are predicted to end in.

The poke is chosen that makes the largest eigenvalue of F S' F^T least: the variance of what is then
known least (Bayesian linear design by its worst direction: Chaloner and Verdinelli 1995, section 2;
`docs/theory/identification.md`, section 7).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike
from threadpoolctl import threadpool_limits

from gridpush_drake.dynamics.motion import MotionStatus
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.pusher import DEFAULT_PUSHER, Pusher
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import PlanningError, require_positive
from gridpush_drake.geometry.se2 import Array, transform_back
from gridpush_drake.identification.identifiability import calc_farthest_center
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.statistics.posterior import calc_center_jacobian
from gridpush_drake.identification.statistics.problem import PushProblem
from gridpush_drake.planning.belief import Belief
from gridpush_drake.planning.contact.reachable_outline import find_reachable_outline
from gridpush_drake.planning.exploration.strategy import PokeProposal
from gridpush_drake.planning.push_constraints import PushConstraints
from gridpush_drake.pushes.push_log import ObservedPush, PushLog

Functional = Callable[[Belief], Array]
"""Function that calculates F (m, n+1), the derivatives by z of what matters, for a belief."""

Cut = Callable[[Push], Push | None]
"""Function that shortens a poke to what is safe; it returns None where nothing of it is."""


@dataclass(frozen=True)
class PokeOptions:
    """What pokes may be chosen from.

    Attributes:
        pusher: what pokes.
        distance: of a poke, the clearance included, m.
        places: number of places along the outline.
        angles: of the motion from the inward normal, rad.
        min_separation: fraction of the outline's length by which a poke begins away from every poke
            made before: what the model gets wrong at one place it would get wrong there again.

    Raises:
        PlanningError: a value is out of range.
    """

    pusher: Pusher = DEFAULT_PUSHER
    distance: float = 0.04
    places: int = 36
    angles: tuple[float, ...] = (-0.4, 0.0, 0.4)
    min_separation: float = 0.04

    def __post_init__(self) -> None:
        require_positive(PlanningError, "poke: ", distance=self.distance)
        if self.places < 1 or not self.angles:
            raise PlanningError("poke: expected at least one place and one angle")


@dataclass(frozen=True, eq=False)
class DesignedPokes:
    """Proposes the poke that is expected to tell most of what matters, among those that are safe.

    Attributes:
        options: what pokes may be chosen from.
        functional: what matters; by default the center of friction.
        cut: shortens pokes to what is safe; None where all that the rules allow are.
    """

    options: PokeOptions = field(default_factory=PokeOptions)
    functional: Functional = field(default=lambda belief: make_center_functional(belief))
    cut: Cut | None = None

    def propose(self, belief: Belief, pose: ArrayLike, rules: PushConstraints) -> PokeProposal:
        """Proposes the next poke, see `PokeStrategy`.

        Raises:
            PlanningError: the belief leaves nothing to learn.
        """
        pokes = make_pokes(belief, pose, self.options, rules)
        if not pokes:
            return PokeProposal(None, "no new poke moves the object and keeps to the rules")
        std, expected_stds = rate_pokes(belief, pose, pokes, self.functional(belief))
        # The arm is asked last, for that takes longest: the best poke first, until it can make one.
        for index in np.argsort(expected_stds, kind="stable").tolist():
            expected = float(expected_stds[index])
            if not np.isfinite(expected):
                break
            poke = pokes[index] if self.cut is None else self.cut(pokes[index])
            if poke is None or not rules.allows_push(poke):
                continue
            return PokeProposal(poke, std=std, expected_std=expected, candidates=len(pokes))
        return PokeProposal(None, "no poke is safe that the finger can make", candidates=len(pokes))


def make_pokes(
    model: Belief,
    pose: ArrayLike,
    options: PokeOptions | None = None,
    constraints: PushConstraints | None = None,
) -> list[Push]:
    """Makes the pokes to choose from.

    They begin at all places, with all angles, as far as they are new, touch the object and break no
    rule. There may be none.

    Args:
        model: of the object; it says how the object would move, and where pokes were made.
        pose: (3,) where the object lies, X_WB, m and rad.
        options: what pokes may be chosen from.
        constraints: rules that the predicted motion keeps to its end; none by default.
    """
    options = options or PokeOptions()
    obj = model.obj
    q = np.asarray(pose, dtype=np.float64)
    radius = options.pusher.choose_radius(obj)
    reach = find_reachable_outline(obj, radius, options.pusher.clearance)
    checker = (constraints or PushConstraints()).start_at(obj, q, options.pusher.choose_reach(obj))
    believed = Model(obj, model.params, model.physics)
    pokes = []
    for s in reach.spread(reach.length / options.places)[0]:
        for angle in options.angles:
            push = Push.on_outline(
                obj,
                float(s),
                angle,
                options.distance,
                radius=radius,
                shape=options.pusher.shape,
                speed=options.pusher.speed,
                pose=q,
                clearance=options.pusher.clearance,
            )
            # Not where a poke was made before.
            p_BP = transform_back(q, push.start[None])
            distances = np.linalg.norm(model.poke_starts - p_BP, axis=1)
            if (distances < options.min_separation * reach.perimeter).any():
                continue
            # Not one that is predicted to miss, or to break a rule.
            motion = simulate(believed, push, q)
            if motion.status != MotionStatus.OK:
                continue
            if checker.count_allowed(motion.tip, motion.poses) == len(motion.tip):
                pokes.append(push)
    return pokes


@threadpool_limits.wrap(limits=1, user_api="blas")
def rate_pokes(
    model: Belief, pose: ArrayLike, pokes: Sequence[Push], F: Array
) -> tuple[float, Array]:
    """Calculates how well what matters is known now, and how well after each of K pokes.

    What matters has several coordinates; the direction counts in which it is then known least.

    Args:
        model: of the object, with its posterior.
        pose: (3,) where the object lies, X_WB, m and rad.
        pokes: the pokes.
        F: (m, n+1) derivatives by z of what matters.

    Returns:
        The standard deviation now, m, and those expected (K,); infinite for a poke that would not
        touch the object.
    """
    S = model.require_posterior().covariance
    stds = np.full(len(pokes), np.inf)
    for i, push in enumerate(pokes):
        observation = calc_observation(model, push, pose)
        if observation is not None:
            J, R = observation
            stds[i] = calc_worst_std(calc_remaining(S, F, J, R))
    return calc_worst_std(F @ S @ F.T), stds


def calc_observation(model: Belief, push: Push, pose: ArrayLike) -> tuple[Array, Array] | None:
    """Calculates what the end of a push would show of z.

    Args:
        model: of the object, with its posterior.
        push: the push.
        pose: (3,) where the object lies, X_WB, m and rad.

    Returns:
        J (3, n+1), derivatives of the residual by z, and R (3, 3), covariance of its noise, m².
        None where the push does not touch the object.
    """
    q = np.asarray(pose, dtype=np.float64)
    # The observation is made up: what would be seen does not matter, only its derivatives do.
    seen = ObservedPush("poke", push, q, np.array([push.duration]), q[None])
    problem = PushProblem(model.obj, PushLog((seen,)), model.params, model.physics)
    linear = problem.linearize(model.require_posterior().mean)
    J = linear.by_z[0]
    if not J.any():
        return None
    return J, model.noise.calc_covariance(linear.by_inputs[0], model.noise_scale)


def calc_remaining(S: Array, F: Array, J: Array, R: Array) -> Array:
    """Calculates F S' F^T, the covariance of what matters after an observation.

    Args:
        S: (n+1, n+1) covariance of z before it.
        F: (m, n+1) derivatives by z of what matters.
        J: (r, n+1) derivatives by z of what is observed.
        R: (r, r) covariance of its noise.

    Returns:
        (m, m).
    """
    SJ = S @ J.T
    FSJ = F @ SJ
    return np.asarray(F @ S @ F.T - FSJ @ np.linalg.solve(J @ SJ + R, FSJ.T))


def calc_worst_std(covariance: Array) -> float:
    """Standard deviation in the direction that is known least, by a covariance (m, m)."""
    return float(np.sqrt(max(np.linalg.eigvalsh(covariance)[-1], 0.0)))


def make_center_functional(model: Belief, direction: ArrayLike | None = None) -> Array:
    """Derivatives by z of the center of friction, m.

    Args:
        model: of the object, with its posterior.
        direction: (2,) unit vector, body frame; None for both coordinates.

    Returns:
        F, (2, n+1), or (1, n+1) along `direction`.
    """
    F = calc_center_jacobian(model.require_posterior().calc_fraction(), model.obj.p_BC)
    return F if direction is None else np.asarray(direction, dtype=np.float64)[None] @ F


def make_farthest_functional(model: Belief, direction: ArrayLike) -> Array:
    """Derivatives by z of how far the center of mass can be along a direction, m.

    How far it can be is limited by the bounds of the friction coefficients. The more of the
    friction is far out on either side, the farther they let the center of mass be. That may be
    known badly long after the center of friction is known well.

    Args:
        model: of the object, with its posterior.
        direction: (2,) unit vector, body frame.

    Returns:
        F, (1, n+1).
    """
    d = np.asarray(direction, dtype=np.float64)
    along = model.obj.p_BC @ d
    fraction = model.require_posterior().calc_fraction()
    low, high = model.friction_range or (model.obj.prior.friction_min, model.obj.prior.friction_max)
    # The farthest center of mass is that of the masses in which all cells beyond it are as heavy,
    # and all others as light, as the bounds allow. Which cells those are changes only at ties, so
    # that its derivatives are those of the center of these masses.
    farthest = calc_farthest_center(along, fraction[None] / high, fraction[None] / low)[0]
    mass = fraction / np.where(along > farthest, low, high)
    return np.asarray(d[None] @ calc_center_jacobian(mass / mass.sum(), model.obj.p_BC))


def calc_center_std(model: Belief) -> float:
    """Standard deviation of the center of friction in the direction in which it is known least, m.

    It is 0 where the parameters are taken for granted.
    """
    if model.posterior is None:
        return 0.0
    F = make_center_functional(model)
    return calc_worst_std(F @ model.posterior.covariance @ F.T)
