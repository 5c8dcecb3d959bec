"""What is believed of several objects before their pushes, and the fit under it.

Each object has a normal prior of its own z = (log k, log mu_c), as a load hypothesis proposes it
(`fit.load_prior`). Together, with one number more for each object as a whole (how heavy it is
beside the others) and the frictions of the pairs, they are the prior of all unknowns,

    z ~ N(z_0, P),    P = blockdiag(A_b A_b^T + sigma_t² 1 1^T over the objects' cells;
                                    sigma_f² of all frictions)

with the order of z as in `joint_problem`. The evidence of such a prior is Laplace's.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag

from gridpush_drake.geometry.se2 import Array, IntArray
from gridpush_drake.identification.fit.load_prior import LoadPrior
from gridpush_drake.identification.multi_object.joint_problem import JointProblem
from gridpush_drake.identification.statistics.posterior import CELL_ENTRIES, CONTACT_FRICTION
from gridpush_drake.identification.statistics.robust_least_squares import fit_robustly

TOTAL_STD = 1.0
"""Standard deviation of the logarithm of an object's whole load beside the others'."""

FRICTION_STD = 0.5
"""Standard deviation of the logarithm of a contact's friction coefficient."""


@dataclass(frozen=True, eq=False)
class JointPrior:
    """The prior of all unknowns of N objects.

    Attributes:
        parts: (N,) the prior of each object's own unknowns.
        pairs: (P,) means of the logarithms of the pairs' frictions.
    """

    parts: tuple[LoadPrior, ...]
    pairs: Array

    def replace_part(self, body: int, part: LoadPrior) -> "JointPrior":
        """Makes the prior with another one for one of the objects."""
        parts = (*self.parts[:body], part, *self.parts[body + 1 :])
        return replace(self, parts=parts)

    def list_unknowns(self, body: int) -> IntArray:
        """Lists the places in z of an object's own unknowns, in their order."""
        sizes = [len(part.mean) - 1 for part in self.parts]
        first = sum(sizes[:body])
        return np.append(np.arange(first, first + sizes[body]), sum(sizes) + body)

    @cached_property
    def mean(self) -> Array:
        """(Z,) z_0."""
        cells = [part.mean[CELL_ENTRIES] for part in self.parts]
        friction = [part.mean[CONTACT_FRICTION] for part in self.parts]
        return np.concatenate([*cells, friction, self.pairs])

    @cached_property
    def root(self) -> Array:
        """(Z, Z) a factor L of the covariance, P = L L^T."""
        cells = [
            np.linalg.cholesky(calc_part_covariance(part)[CELL_ENTRIES, CELL_ENTRIES])
            for part in self.parts
        ]
        others = len(self.mean) - sum(len(each) for each in cells)
        return np.asarray(block_diag(*cells, FRICTION_STD * np.eye(others)))


def calc_part_covariance(part: LoadPrior) -> Array:
    """Calculates the covariance (n+1, n+1) of an object's own unknowns beside other objects."""
    cells = part.factor[CELL_ENTRIES, CELL_ENTRIES]
    return np.asarray(block_diag(cells @ cells.T + TOTAL_STD**2, FRICTION_STD**2))


@dataclass(frozen=True, eq=False)
class JointFit:
    """The best z under a prior, and what `JointIdentification` says of it.

    Attributes:
        prior: the prior.
        problem: the pushes, with the cells' loads where the prior has them.
        z: (Z,) the unknowns.
        covariance: (Z, Z) of z, Laplace's approximation.
        evidence: logarithm of the evidence, up to a constant that all priors share.
        noise_scale: root mean square of the residuals, each with its weight.
        push_scales: (P,) root mean square of each push's residuals.
        weights: (B,) what each block of residuals weighs.
    """

    prior: JointPrior
    problem: JointProblem
    z: Array
    covariance: Array
    evidence: float
    noise_scale: float
    push_scales: Array
    weights: Array


def fit_prior(problem: JointProblem, prior: JointPrior, start: Array) -> JointFit:
    """Fits all unknowns under a prior, beginning at z (Z,)."""
    L = prior.root
    # z = z_0 + L v with v ~ N(0, I)
    v = np.asarray(np.linalg.solve(L, start - prior.mean), dtype=np.float64)
    found = fit_robustly(problem.linearize, prior.mean, L, v)
    identity = np.eye(len(found.v))
    # the evidence by Laplace's approximation, and the posterior, with the noise that was found
    log_determinant = float(np.linalg.slogdet(found.curvature + identity)[1])
    noise = max(found.noise_scale, 1.0) ** 2
    squares = np.mean(found.residuals**2, axis=1)
    pushes = problem.push_of_block
    return JointFit(
        prior=prior,
        problem=problem,
        z=prior.mean + L @ found.v,
        covariance=L @ np.linalg.inv(found.curvature / noise + identity) @ L.T,
        evidence=-found.loss - 0.5 * log_determinant,
        noise_scale=found.noise_scale,
        push_scales=np.sqrt(np.bincount(pushes, squares) / np.bincount(pushes)),
        weights=found.weights,
    )


def fit_fields(problem: JointProblem, priors: Sequence[JointPrior], start: Array) -> list[JointFit]:
    """Fits smooth fields of increasing amplitude, each from where the last one ended."""
    fits: list[JointFit] = []
    for prior in priors:
        fits.append(fit_prior(problem, prior, start))
        start = fits[-1].z
    return fits
