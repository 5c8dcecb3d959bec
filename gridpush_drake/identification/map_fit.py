"""The most probable parameters under one smoothness prior, by trust-region Gauss-Newton, and that prior's evidence.

With z = z_0 + A u, A A^T the prior covariance of z, the unknown is u, a priori N(0, I). Minimized is

    1/2 |u|² + sum over pushes of Huber(W_p r_p(z)) + 1/2 |(c(k) - c_0)/sigma_c|²

r_p the residuals of push p, W_p their whitening by the noise's covariance, c the center of friction and c_0 the center
of mass where one is given. Whitening, Huber's weights and the noise scale are renewed between runs of the trust-region
solver (`docs/theory/identification.md`, sections 3 and 4).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from gridpush_drake.identification.posterior import calc_center_jacobian
from gridpush_drake.identification.problem import PushProblem
from gridpush_drake.identification.result import FitStart
from gridpush_drake.objects.grid_object import GridObject

Array = NDArray[np.float64]

RENEWALS = 4
"""Times whitening, weights and noise scale are renewed."""

WARM_RENEWALS = 2
"""The same where a fit begins at one to nearly the same pushes."""

EVALUATIONS = 8
"""Most steps of the trust-region solver between renewals."""

TOLERANCE = 1e-4
"""Relative, of loss and step, at which the solver stops."""

MAX_INFORMED_SHARE = 0.8
"""Of the residuals, that parameters may use up; the rest speaks of the noise."""

RANGE_CELLS = 4.0
"""Distance, in cells, at which two cells' log-frictions are nearly independent."""

KAPPA_RANGE = 8.0**0.5
"""kappa times the range, of the Matérn field of smoothness one (Lindgren, Rue and Lindström 2011, section 2)."""


@dataclass(frozen=True)
class NoiseModel:
    """Standard deviations at scale one, and the prior on their scale.

    Attributes:
        pose: of a residual (a coordinate of the centroid, or the turn at the radius of gyration), m.
        tip: of the pusher's place per axis, m.
        log_contact_friction: of log mu_c from push to push.
        prior_weight: how many residuals the prior on scale one is worth.
        outlier: a push whose whitened residual is this many standard deviations counts less from there on (Huber).
    """

    pose: float = 0.0008
    tip: float = 0.0015
    log_contact_friction: float = 0.3
    prior_weight: float = 20.0
    outlier: float = 1.0

    def calc_factor(self, input_jacobian: Array, scale: float) -> Array:
        """Lower Cholesky factor (3K, 3K) of Sigma.

        Args:
            input_jacobian: (3K, 3) residuals by start x, start y (both per m) and log mu_c, m.
            scale: s.
        """
        rows = len(input_jacobian)
        count = rows / 3
        inputs = input_jacobian * np.array([self.tip, self.tip, self.log_contact_friction])
        sigma = self.pose**2 * np.sqrt(count) * np.eye(rows) + inputs @ inputs.T
        return scale * np.linalg.cholesky(sigma)

    def calc_weight(self, whitened: Array) -> float:
        """Huber's weight of a push, 1 or less, from its whitened residuals (3K,)."""
        size = _calc_size(whitened)
        return 1.0 if size <= self.outlier else self.outlier / size

    def calc_loss(self, whitened: Array) -> float:
        """Huber's loss of a push from its whitened residuals (3K,): -log likelihood but for its normalization."""
        size = _calc_size(whitened)
        squared = size**2 if size <= self.outlier else self.outlier * (2 * size - self.outlier)
        return 0.5 * calc_effective_count(len(whitened)) * squared


def calc_effective_count(rows: int) -> float:
    """How many independent residuals a push's 3K count for: 3 K_eff."""
    return 3.0 * float(np.sqrt(rows / 3))


def _calc_size(whitened: Array) -> float:
    """Root mean square of the whitened residuals, one where the noise is as large as supposed."""
    return float(np.sqrt(whitened @ whitened / calc_effective_count(len(whitened))))


@dataclass(frozen=True)
class CenterOfMass:
    """Where the center of mass is held to be.

    Attributes:
        at: (2,) body frame, m.
        std: standard deviation per axis, m.
    """

    at: tuple[float, float]
    std: float

    def linearize(self, obj: GridObject, z: Array) -> tuple[Array, Array]:
        """Whitened residual (2,) of the center of friction at z (n+1,), and its Jacobian (2, n+1)."""
        k = np.exp(z[:-1] - z[:-1].max())
        share = k / k.sum()
        center = share @ obj.p_BC
        return (center - np.asarray(self.at)) / self.std, calc_center_jacobian(share, obj.p_BC) / self.std


@dataclass(frozen=True, eq=False)
class MapFit:
    """The most probable z under one prior.

    Attributes:
        z: (n+1,) log k and log mu_c.
        covariance: (n+1, n+1) of z, Laplace's approximation.
        scale: of the noise, s.
        log_evidence: for the prior, up to a constant shared by all priors on the same data.
        informed: number of directions of u that the data, not the prior, hold in place (MacKay's gamma).
    """

    z: Array
    covariance: Array
    scale: float
    log_evidence: float
    informed: float


def fit_map(
    problem: PushProblem,
    z0: Array,
    A: Array,
    noise: NoiseModel,
    center_of_mass: CenterOfMass | None = None,
    *,
    pushes: Sequence[int] | None = None,
    start: Array | None = None,
    scale: float = 1.0,
    warm_start: FitStart | None = None,
    on_renewal: Callable[[Array], None] | None = None,
) -> MapFit:
    """Fits z.

    Args:
        problem: the training pushes.
        z0: (n+1,) prior mean.
        A: (n+1, n+1) factor of the prior covariance, A A^T.
        noise: the noise model.
        center_of_mass: prior knowledge of the center of mass, or None.
        pushes: those to use; all by default.
        start: (n+1,) where to begin; z0 by default.
        scale: of the noise, to begin with.
        warm_start: where a fit to fewer pushes ended; it is taken instead where it is the more probable beginning, and
            then WARM_RENEWALS do.
        on_renewal: called with z after every run of the solver.

    Returns:
        The fit.
    """
    u = np.asarray(np.linalg.solve(A, (z0 if start is None else start) - z0), dtype=np.float64)
    chosen = range(len(problem)) if pushes is None else pushes
    renewals = RENEWALS
    if warm_start is not None:
        other = np.asarray(np.linalg.solve(A, warm_start.z - z0), dtype=np.float64)
        beginnings = ((u, scale), (other, warm_start.scale))
        stages = [_Stage(problem, z0, A, noise, center_of_mass, chosen, v, s) for v, s in beginnings]
        best = min(stages, key=_Stage.objective)
        u, scale = best.start, best.scale
        if best is stages[1]:
            renewals = WARM_RENEWALS
    for _ in range(renewals):
        stage = _Stage(problem, z0, A, noise, center_of_mass, chosen, u, scale)
        u = stage.solve(u)
        scale, gamma = stage.renew_scale(u)
        if on_renewal is not None:
            on_renewal(z0 + A @ u)
    stage = _Stage(problem, z0, A, noise, center_of_mass, chosen, u, scale)
    H = stage.hessian(u)
    covariance = A @ np.linalg.solve(H, A.T)
    evidence = -stage.loss(u) - 0.5 * np.linalg.slogdet(H)[1] - stage.log_normalizer
    evidence -= 0.5 * noise.prior_weight * (2 * np.log(scale) + scale**-2)
    if center_of_mass is not None:
        evidence -= _calc_center_evidence(problem.obj, z0, A, center_of_mass)
    return MapFit(z0 + A @ u, 0.5 * (covariance + covariance.T), scale, float(evidence), gamma)


def calc_laplace(problem: PushProblem, z: Array, A: Array, noise: NoiseModel) -> tuple[Array, float]:
    """Spread about given parameters.

    Args:
        problem: the training pushes.
        z: (n+1,) the parameters.
        A: (n+1, n+1) factor of the prior covariance.
        noise: the noise model.

    Returns:
        The covariance (n+1, n+1) of z by Laplace's approximation, and the noise scale.
    """
    u = np.zeros(len(z))
    scale, _ = _Stage(problem, z, A, noise, None, range(len(problem)), u, 1.0).renew_scale(u)
    H = _Stage(problem, z, A, noise, None, range(len(problem)), u, scale).hessian(u)
    return A @ np.linalg.solve(H, A.T), scale


class _Stage:
    """The least-squares problem in u with whitening and weights held as they are at one u."""

    def __init__(
        self,
        problem: PushProblem,
        z0: Array,
        A: Array,
        noise: NoiseModel,
        center_of_mass: CenterOfMass | None,
        pushes: Sequence[int],
        u: Array,
        scale: float,
    ) -> None:
        self.problem, self.z0, self.A, self.noise = problem, z0, A, noise
        self.center_of_mass, self.pushes, self.scale = center_of_mass, pushes, scale
        self._at: Array | None = None
        linear = problem.linearize(z0 + A @ u, pushes)
        factors = [noise.calc_factor(inputs, scale) for inputs in linear.by_inputs]
        self.start = u
        self.log_normalizer = float(
            sum(calc_effective_count(len(L)) / len(L) * np.log(np.diag(L)).sum() for L in factors)
        )
        self.whitening = [np.linalg.inv(L) for L in factors]
        self.weights = [noise.calc_weight(W @ r) for W, r in zip(self.whitening, linear.residuals, strict=True)]
        self._store(u, linear.residuals, linear.by_z)

    def objective(self) -> float:
        """Negative log posterior at the start, the normalization of the noise included."""
        scale_prior = self.noise.prior_weight * (np.log(self.scale) + 0.5 * self.scale**-2)
        return self.loss(self.start) + self.log_normalizer + scale_prior

    def solve(self, u: Array) -> Array:
        """Runs the trust-region solver from u."""
        return least_squares(
            lambda v: self._evaluate(v)[0], u, jac=lambda v: self._evaluate(v)[1], method="trf", x_scale=1.0,
            ftol=TOLERANCE, xtol=TOLERANCE, gtol=None, max_nfev=EVALUATIONS,
        ).x  # fmt: skip

    def hessian(self, u: Array) -> Array:
        """Gauss-Newton Hessian (n+1, n+1) in u, the prior's identity included."""
        J = self._evaluate(u)[1]
        return J.T @ J

    def loss(self, u: Array) -> float:
        """Negative log posterior at u but for normalization; Huber's, not the weighted quadratic."""
        self._evaluate(u)
        assert self._residuals is not None
        whitened = [W @ r for W, r in zip(self.whitening, self._residuals, strict=True)]
        total = 0.5 * float(u @ u) + sum(self.noise.calc_loss(w) for w in whitened)
        if self.center_of_mass is not None:
            r, _ = self.center_of_mass.linearize(self.problem.obj, self.z0 + self.A @ u)
            total += 0.5 * float(r @ r)
        return total

    def renew_scale(self, u: Array) -> tuple[float, float]:
        """The noise scale by MacKay's fixed point, s² = (sum w |W r|² s² + nu)/(N - gamma + nu), and gamma."""
        H = self.hessian(u)
        squares = sum(
            w * float((W @ r) @ (W @ r)) for w, W, r in zip(self.weights, self.whitening, self._residuals, strict=True)
        )
        count = sum(calc_effective_count(len(r)) for r in self._residuals)
        gamma = len(u) - float(np.trace(np.linalg.inv(H))) - (2 if self.center_of_mass is not None else 0)
        gamma = float(np.clip(gamma, 0.0, MAX_INFORMED_SHARE * count))
        weight = self.noise.prior_weight
        return float(np.sqrt((squares * self.scale**2 + weight) / (count - gamma + weight))), gamma

    def _evaluate(self, u: Array) -> tuple[Array, Array]:
        """Stacked residuals and their Jacobian by u; simulates once a point."""
        if self._at is None or not np.array_equal(u, self._at):
            linear = self.problem.linearize(self.z0 + self.A @ u, self.pushes)
            self._store(u, linear.residuals, linear.by_z)
        return self._stacked

    def _store(self, u: Array, residuals: list[Array], by_z: list[Array]) -> None:
        self._at, self._residuals = u.copy(), residuals
        rows, jacobians = [u], [np.eye(len(u))]
        for weight, W, r, J in zip(self.weights, self.whitening, residuals, by_z, strict=True):
            root = np.sqrt(weight)
            rows.append(root * (W @ r))
            jacobians.append(root * (W @ (J @ self.A)))
        if self.center_of_mass is not None:
            r, J = self.center_of_mass.linearize(self.problem.obj, self.z0 + self.A @ u)
            rows.append(r)
            jacobians.append(J @ self.A)
        self._stacked = np.concatenate(rows), np.concatenate(jacobians)


def _calc_center_evidence(obj: GridObject, z0: Array, A: Array, center_of_mass: CenterOfMass) -> float:
    """Log p(c_0) under the smoothness prior alone, to first order about z0: knowledge, not data."""
    r, J = center_of_mass.linearize(obj, z0)
    spread = np.eye(2) + (J @ A) @ (J @ A).T
    return float(-0.5 * r @ np.linalg.solve(spread, r) - 0.5 * np.linalg.slogdet(spread)[1])


def calc_smooth_covariance(obj: GridObject, range_cells: float = RANGE_CELLS) -> NDArray[np.float64]:
    """Makes C (n, n), unit mean variance: C^-1 ~ (L + kappa² I)², L the graph Laplacian of neighboring cells.

    Args:
        obj: the object.
        range_cells: correlation range, cells.

    Returns:
        The covariance.
    """
    i, j = obj.adjacency.T
    L = np.zeros((obj.n, obj.n))
    np.add.at(L, (i, i), 1.0)
    np.add.at(L, (j, j), 1.0)
    L[i, j] = L[j, i] = -1.0
    root = np.linalg.inv(L + KAPPA_RANGE**2 / range_cells**2 * np.eye(obj.n))
    C = root @ root
    return C / np.diag(C).mean()
