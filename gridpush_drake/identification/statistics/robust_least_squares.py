"""Least squares with a normal prior in which some of what was seen may be far off.

With unknowns u = mean + root v and v ~ N(0, I) beforehand, and blocks of D residuals r_b(u), such
as those of all objects at one time of a push,

    min over v of  sum over b of rho(|r_b|²) + |v|²/2,    rho(S) = D c²/2 log(1 + S/(D c²)).

For blocks about as far off as expected, |r_b|² of about D, this is nearly S/2. A block that is
farther off weighs

    w_b = 2 rho'(S) = 1/(1 + |r_b|²/(D c²))

of that: it can draw the unknowns only so far. Where an object is missed in one simulation and hit
in the next, later poses are off by centimeters. A sum of squares then hangs on these poses alone,
and its slope there says nothing of how to hit; here the poses before lead the way.

The steps are damped ones of Gauss and Newton,

    (A^T W A + (1 + lambda) I) dv = -(A^T W r + v),    A = dr/du root,

shortened so that no unknown changes by more than `MAX_STEP`, and refused where the loss does not
fall, is not finite, or an unknown would be farther than `MAX_CHANGE` from its mean. The theory is
in `docs/theory/identification.md`, section 12. For residuals that need none of this there is
`prior_fit`.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from gridpush_drake.geometry.se2 import Array

TOLERATED_RESIDUAL = 2.0
"""c: root mean square of a block's residuals, in units of the noise, at which it has half the
weight."""

MAX_STEP = 1.0
"""Greatest change of an unknown in a step. Unknowns are logarithms: that is a factor of 2.7."""

MAX_CHANGE = 8.0
"""Greatest difference of an unknown from its mean: a factor of 3000. Beyond it the balances of
forces of a simulation have hardly any digits left."""

FIRST_DAMPING = 1.0
"""lambda of the first step."""

LESS_DAMPING = 0.2
"""Factor on lambda after a step that was taken."""

MORE_DAMPING = 5.0
"""Factor on lambda after one that was refused."""

MAX_DAMPING = 1e6
"""lambda beyond which no smaller step is tried: at a kink of the loss none need be better."""

FLAT_DECREASE = 2e-3
"""Relative fall of the loss below which a step counts as one of no use."""

FLAT_STEPS = 2
"""Number of such steps in a row after which the fit ends."""

MAX_EVALUATIONS = 40
"""Number of evaluations after which the fit ends in any case."""

CalcBlocks = Callable[[Array], tuple[Array, Array]]
"""Takes unknowns (N,); returns residuals (B, D), and their derivatives (B, D, N)."""


@dataclass(frozen=True, eq=False)
class RobustFit:
    """A minimum of the loss, or the best that was found.

    Attributes:
        v: (N,) the unknowns, whitened.
        loss: there.
        residuals: (B, D) there.
        weights: (B,) what each block weighs, 1 for one that is not off at all.
        curvature: (N, N) A^T W A, what the residuals add to the prior's I.
        evaluations: how often residuals were calculated.
    """

    v: Array
    loss: float
    residuals: Array
    weights: Array
    curvature: Array
    evaluations: int

    @property
    def noise_scale(self) -> float:
        """Root mean square of the residuals, each with its weight."""
        squares = np.mean(self.residuals**2, axis=1)
        return float(np.sqrt(self.weights @ squares / self.weights.sum()))


@dataclass(frozen=True, eq=False)
class _Point:
    """The loss and all that it is made of, at one v."""

    v: Array
    loss: float
    residuals: Array
    derivatives: Array
    weights: Array


def fit_robustly(calc: CalcBlocks, mean: Array, root: Array, start: Array) -> RobustFit:
    """Minimizes the loss.

    Args:
        calc: calculates residuals and derivatives; the residuals must be finite at the start.
        mean: (N,) of the unknowns beforehand.
        root: (N, N) of their covariance.
        start: (N,) v to begin with.

    Returns:
        The best that was found.
    """
    best = _evaluate(calc, mean, root, start)
    evaluations = 1
    damping = FIRST_DAMPING
    flat = 0
    H, g = _sum_up(best, root)
    while flat < FLAT_STEPS and damping <= MAX_DAMPING and evaluations < MAX_EVALUATIONS:
        # a step, shortened where it is too long
        factor = cho_factor(H + (1.0 + damping) * np.eye(len(g)))
        step = -cho_solve(factor, g + best.v)
        change = float(np.abs(root @ step).max())
        step *= min(1.0, MAX_STEP / max(change, np.finfo(float).tiny))
        if np.abs(root @ (best.v + step)).max() > MAX_CHANGE:
            damping *= MORE_DAMPING
            continue
        # taken where it is a better point
        there = _evaluate(calc, mean, root, best.v + step)
        evaluations += 1
        if not there.loss < best.loss:
            damping *= MORE_DAMPING
            continue
        useless = best.loss - there.loss < FLAT_DECREASE * best.loss
        flat = flat + 1 if useless else 0
        damping *= LESS_DAMPING
        best = there
        H, g = _sum_up(best, root)
    return RobustFit(
        v=best.v,
        loss=best.loss,
        residuals=best.residuals,
        weights=best.weights,
        curvature=H,
        evaluations=evaluations,
    )


def calc_loss(residuals: Array, v: Array) -> float:
    """Calculates the loss of residuals (B, D) and of v (N,)."""
    tolerated = residuals.shape[1] * TOLERATED_RESIDUAL**2
    squares = np.sum(residuals**2, axis=1)
    return float(0.5 * tolerated * np.log1p(squares / tolerated).sum() + 0.5 * v @ v)


def _evaluate(calc: CalcBlocks, mean: Array, root: Array, v: Array) -> _Point:
    residuals, derivatives = calc(mean + root @ v)
    finite = np.isfinite(residuals).all() and np.isfinite(derivatives).all()
    squares = np.mean(residuals**2, axis=1)
    return _Point(
        v=v,
        loss=calc_loss(residuals, v) if finite else np.inf,
        residuals=residuals,
        derivatives=derivatives,
        weights=1.0 / (1.0 + squares / TOLERATED_RESIDUAL**2),
    )


def _sum_up(point: _Point, root: Array) -> tuple[Array, Array]:
    """Calculates A^T W A (N, N) and A^T W r (N,); an object that no push moved has no part."""
    weights = np.repeat(point.weights, point.residuals.shape[1])
    r = point.residuals.ravel()
    J = point.derivatives.reshape(len(r), -1)
    telling = np.flatnonzero(J.any(axis=1))
    A = J[telling] @ root
    WA = weights[telling, None] * A
    return A.T @ WA, WA.T @ r[telling]
