"""The least-squares problem of a fit, made linear about one point.

The parameters are z = z_0 + A u, so that the prior of u is N(0, I). Push p has the residuals
r_p(z), whitening W_p makes their covariance I, and Huber's weight w_p makes little of a push that
fits badly. Whitening and weights are held as they are at the point. Let r hold sqrt(w_p) W_p r_p of
all pushes, and J its derivatives by u. After a small step d from the point u, the loss is

    1/2 |u + d|² + 1/2 |r + J d|²

From its Hessian H = I + J^T J follow the next step, the spread of the estimate, the evidence, and
what the other pushes predict of each one (`docs/theory/identification.md`, sections 4 and 5).
`map_fit` takes steps until they have settled.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular
from scipy.linalg.lapack import dtrtri

from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.result import FitStart
from gridpush_drake.identification.statistics.center_of_mass import CenterOfMass
from gridpush_drake.identification.statistics.noise import (
    POSE_SIZE,
    LeftOutEnds,
    NoiseModel,
    NoiseScale,
    calc_effective_count,
)
from gridpush_drake.identification.statistics.outliers import LeftOut
from gridpush_drake.identification.statistics.problem import (
    SHIFT_COLUMNS,
    Linearization,
    PushProblem,
)

MAX_STEP = 2.0
"""Largest change of any entry of z in one step. A longer step is shortened to it."""

MAX_EFFECTIVE_FRACTION = 0.8
"""Largest fraction of the residuals that the parameters may be taken to explain. The noise is
estimated from the rest, so that some must be left."""

FIRST_RIDGE = 1e-14
"""Least ridge of a matrix that has lost a small eigenvalue to round-off, as a fraction of its
largest diagonal entry: about the round-off of a sum of a hundred terms."""

RIDGE_FACTOR = 10.0
"""Factor by which a ridge grows that was not enough."""

LAST_POSE = slice(-POSE_SIZE, None)
"""Rows of a push's residuals that belong to its last observed pose."""


@dataclass(frozen=True, eq=False)
class MapProblem:
    """The task of a fit: the pushes that it is to explain, and what is believed beforehand.

    Attributes:
        problem: the training pushes.
        z0: (n+1,) prior mean.
        A: (n+1, n+1) factor of the prior covariance, A A^T.
        noise: the noise model.
        center_of_mass: prior knowledge of the center of mass, or None.
    """

    problem: PushProblem
    z0: Array
    A: Array
    noise: NoiseModel
    center_of_mass: CenterOfMass | None

    def linearize_at(self, start: FitStart, linear: Linearization | None = None) -> "LinearizedFit":
        """Linearizes about a start; `linear` is the pushes' linearization there, if it is known."""
        u = solve_factor(self.A, start.z - self.z0)
        return self.linearize(u, linear or self.problem.linearize(start.z), start.scale)

    def linearize(self, u: Array, linear: Linearization, scale: NoiseScale) -> "LinearizedFit":
        """Linearizes about u (n+1,), where the pushes' residuals and derivatives are `linear`."""
        # dr/du = dr/dz A; one product for all pushes together is faster than one for each.
        ends = np.cumsum([len(r) for r in linear.residuals])[:-1]
        slopes = np.split(np.concatenate(linear.by_z) @ self.A, ends)
        return LinearizedFit(self, u, linear, slopes, scale)


class LinearizedFit:
    """The least-squares problem in u about one point, whitening and weights as they are there.

    Equations with H can be solved by a matrix with a row for each unknown, J^T J, or by one with a
    row for each residual, J J^T, because

        (c I + J^T J)^-1 = (I - J^T (c I + J J^T)^-1 J) / c

    The smaller of the two matrices is used ("the smaller form" below).

    Attributes:
        asked: the pushes and the prior. Its fields are attributes of this object, too.
        u: (n+1,) the point.
        linear: the pushes' residuals and derivatives by z there.
        slopes: (3K, n+1) derivatives of the residuals by u, one entry a push.
        scale: the noise scale.
        whitenings: W of each push.
        weights: Huber's weight of each push.
        rows: (3K,) whitened and weighted residuals of each push.
        center_whitening: (2, 2) W_c; only where a center of mass is given.
        center_spread: -log det W_c; only where a center of mass is given.
        r: (R,) all whitened and weighted residuals, the center of mass's last.
        J: (R, n+1) their derivatives by u.
        by_residuals: whether the form by residuals is the smaller one.
        gram: J J^T or J^T J, in the smaller form.
        factor: Cholesky's factor of I plus that, as `scipy.linalg.cho_factor` gives it.
        ridge: what had to be added to the diagonal for there to be a factor; 0 as a rule, see
            `factorize`.
    """

    def __init__(
        self,
        asked: MapProblem,
        u: Array,
        linear: Linearization,
        slopes: list[Array],
        scale: NoiseScale,
    ) -> None:
        """Whitens and weighs the residuals at a point, and factorizes the Hessian there."""
        self.asked = asked
        self.problem = asked.problem
        self.z0 = asked.z0
        self.A = asked.A
        self.noise = asked.noise
        self.center_of_mass = asked.center_of_mass
        self.u = u
        self.linear = linear
        self.slopes = slopes
        self.scale = scale

        # Huber's loss acts on each push as a whole: its rows share one weight.
        self.whitenings = self.noise.make_whitenings(linear.by_inputs, scale)
        whitened = [W.apply(r) for W, r in zip(self.whitenings, linear.residuals, strict=True)]
        self.weights = [self.noise.calc_weight(r) for r in whitened]
        roots = np.sqrt(self.weights)
        self.rows = [root * r for root, r in zip(roots, whitened, strict=True)]
        jacobians = [
            root * W.apply(J) for root, W, J in zip(roots, self.whitenings, slopes, strict=True)
        ]

        # What is known of the center of mass is two more rows: W_c (c(k) - c_0).
        rows = list(self.rows)
        if self.center_of_mass is not None:
            obj = self.problem.obj
            z = self.z0 + self.A @ u
            self.center_whitening, self.center_spread = self.center_of_mass.make_whitening(obj, z)
            r, J = self.center_of_mass.linearize(obj, z, self.center_whitening)
            rows.append(r)
            jacobians.append(J @ self.A)

        self.r = np.concatenate(rows)
        self.J = np.concatenate(jacobians)
        self.by_residuals = len(self.r) < len(u)
        self.gram = self.J @ self.J.T if self.by_residuals else self.J.T @ self.J
        self.factor, self.ridge = self._factorize(1.0)

    def move(self, u: Array, linear: Linearization) -> "LinearizedFit":
        """Linearizes about another point, with the same scale of the noise."""
        return self.asked.linearize(u, linear, self.scale)

    def rescale(self, scale: NoiseScale) -> "LinearizedFit":
        """Linearizes about the same point, with another scale of the noise."""
        return LinearizedFit(self.asked, self.u, self.linear, self.slopes, scale)

    def scale_noise(self, factor: float) -> "LinearizedFit":
        """Linearizes about the same point, with all noise multiplied by a factor."""
        return self.rescale(NoiseScale(factor * self.scale.pose, factor * self.scale.shift))

    def linearize_at_prior(self) -> tuple[Array, Array]:
        """Whitened residuals (R,) at z0, to first order, and their derivatives (R, n+1) by z."""
        residuals = self.r - self.J @ self.u
        by_z = solve_triangular(self.A, self.J.T, trans="T", lower=True).T
        return residuals, by_z

    def calc_step(self, damping: float) -> tuple[Array, float]:
        """Calculates the next step.

        Args:
            damping: keeps the step short, as a prior of this weight about the present u would;
                with 0 it is Gauss-Newton's step.

        Returns:
            The step (n+1,) of u, and the decrease of the loss that is expected of it.
        """
        # d = -(c I + J^T J)^-1 g, with g the gradient of the loss, in the smaller of both forms.
        g = self.u + self.J.T @ self.r
        c = 1.0 + damping
        factor = self.factor if damping == 0 else self._factorize(c)[0]
        if self.by_residuals:
            shown = self.J.T @ cho_solve(factor, self.J @ g)
            d = (shown - g) / c
        else:
            d = -cho_solve(factor, g)

        # The linearization holds only near the point: a long step is shortened.
        d *= calc_shortening(self.A @ d)
        slope = self.J @ d
        return d, float(-g @ d - 0.5 * (d @ d + slope @ slope))

    def calc_curvature(self, step: Array) -> float:
        """Curvature of the loss along a step, where the prior alone would have curvature 1."""
        slope = self.J @ step
        return 1.0 + float(slope @ slope) / float(step @ step)

    def calc_loss(self, u: Array, residuals: list[Array]) -> float:
        """Calculates the negative log posterior at u, without its normalization.

        It has Huber's own loss, and not the weighted squares that the linearization has instead.

        Args:
            u: (n+1,) the point.
            residuals: (3K,) of each push there, m.
        """
        total = 0.5 * float(u @ u)
        total += sum(
            self.noise.calc_loss(W.apply(r))
            for W, r in zip(self.whitenings, residuals, strict=True)
        )
        if self.center_of_mass is not None:
            z = self.z0 + self.A @ u
            r, _ = self.center_of_mass.linearize(self.problem.obj, z, self.center_whitening)
            total += 0.5 * float(r @ r)
        return total

    def objective(self) -> float:
        """Negative log posterior here, with the normalizations of the noise and of W_c."""
        # Section 4: 1/2 sum_p K_eff/K log det Sigma_p. K correlated poses count as K_eff.
        normalizer = sum(
            calc_effective_count(len(r)) / len(r) * W.log_determinant
            for W, r in zip(self.whitenings, self.linear.residuals, strict=True)
        )
        normalizer += 0.0 if self.center_of_mass is None else self.center_spread
        return (
            self.calc_loss(self.u, self.linear.residuals)
            + normalizer
            + self.noise.calc_scale_loss(self.scale)
        )

    def renew_scale(self) -> tuple[NoiseScale, float]:
        """Estimates the noise scale anew by MacKay's fixed points.

        The scale s of poses and the scale t of the load's shifts are

            s² = (sum |W r|² s² + nu) / (N - gamma + nu)
            t² = (sum |xi|² / sigma_c² + nu_c) / (sum gamma_c + nu_c)

        with xi the shift of the load that a push's residuals show, and gamma_c how many of the two
        coordinates of xi they truly show, between 0 and 2.

        Returns:
            The scale, and gamma, the effective number of parameters.
        """
        squares = sum(float(r @ r) for r in self.rows)
        count = sum(calc_effective_count(len(r)) for r in self.linear.residuals)

        # gamma = n + 1 - tr H^-1. The trace is the sum of the squares of the entries of the inverse
        # factor. If the center of mass is known beforehand, it determines two directions, and these
        # are not counted as determined by the pushes.
        known = 2 if self.center_of_mass is not None else 0
        root, _ = dtrtri(self.factor[0], lower=1)
        gamma = len(self.gram) - float((np.tril(root) ** 2).sum()) - known
        gamma = float(np.clip(gamma, 0.0, MAX_EFFECTIVE_FRACTION * count))

        weight = self.noise.prior_weight
        pose = np.sqrt((squares * self.scale.pose**2 + weight) / (count - gamma + weight))

        # The scale t of the load's shift follows from the shifts in the same way.
        moved, sure = self._calc_shifts()
        weight = self.noise.shift_weight
        shift = np.sqrt((moved * self.scale.shift**2 + weight) / (sure + weight))
        return NoiseScale(pose=float(pose), shift=float(shift)), gamma

    def _calc_shifts(self) -> tuple[float, float]:
        """Sums up how far the load's center seems to have shifted, and how surely it is known.

        Returns:
            Sums over all pushes of |xi|², xi the expected shift in its standard deviations, and of
            gamma_c, the number of its coordinates that the residuals show.
        """
        std = self.scale.shift * self.noise.load_shift
        moved = 0.0
        sure = 0.0
        first = 0
        pulls = []
        for r, root, W, inputs in zip(
            self.rows, np.sqrt(self.weights), self.whitenings, self.linear.by_inputs, strict=True
        ):
            # xi = T^T r, with T the whitened and weighted derivatives by the shift.
            T = root * std * W.apply(inputs[:, SHIFT_COLUMNS])
            pulls.append(self.J[first : first + len(r)].T @ T)
            first += len(r)
            moved += float(((T.T @ r) ** 2).sum())
            sure += float((T * T).sum())
        # A motion that the unknowns explain just as well does not show a shift of the load. That
        # part is taken off: tr T^T J H^-1 J^T T.
        v = np.concatenate(pulls, axis=1)
        return moved, sure - float((v * self.solve(v)).sum())

    def solve(self, v: Array) -> Array:
        """Solves (I + J^T J) x = v for x; v is (n+1,) or (n+1, p)."""
        if self.by_residuals:
            return np.asarray(v - self.J.T @ cho_solve(self.factor, self.J @ v))
        return np.asarray(cho_solve(self.factor, v))

    def calc_log_determinant(self) -> float:
        """Log determinant of H = I + J^T J, which is the same in both forms."""
        return 2.0 * float(np.log(np.diag(self.factor[0])).sum())

    def calc_covariance(self) -> Array:
        """Laplace's covariance (n+1, n+1) of z: A (I + J^T J)^-1 A^T."""
        # half^T half is symmetric to the last bit, which A times H^-1 times A^T would not be.
        if self.by_residuals:
            half = solve_triangular(self.factor[0], self.J @ self.A.T, lower=True)
            return self.A @ self.A.T - half.T @ half
        half = solve_triangular(self.factor[0], self.A.T, lower=True)
        return half.T @ half

    def leave_out(self) -> list[LeftOut]:
        """Predicts each push from all others, to first order, without a new fit for each.

        h = J H^-1 J^T is the covariance of a push's whitened residuals by the fit, in which the
        push itself took part with the weight w. The prediction of the others is off by
        (I - w h)^-1 r, whitened, with covariance I + h (I - w h)^-1.

        Returns:
            For each push how far its residuals are off the prediction, and how sure that is.
        """
        return self._left_out

    @cached_property
    def _left_out(self) -> list[LeftOut]:
        found = []
        for weight, W, r, J in zip(
            self.weights, self.whitenings, self.linear.residuals, self.slopes, strict=True
        ):
            identity = np.eye(len(r))
            whitened = W.apply(J)
            h = whitened @ self.solve(whitened.T)
            alone = np.linalg.inv(identity - weight * h)
            # In meters, Q = W^T (whitened covariance)^-1 W is the precision, and Q e the pull.
            covariance = identity + h @ alone
            root = np.asarray(np.linalg.solve(covariance, W.apply(identity)), dtype=np.float64)
            pull = root.T @ (alone @ W.apply(r))
            found.append(LeftOut(precision=W.apply(root), pull=pull))
        return found

    def leave_out_ends(self, residuals: list[Array] | None = None) -> LeftOutEnds:
        """Predicts the last pose of each push from all other pushes.

        Args:
            residuals: (3K,) residuals of each push, m, by the parameters that are to predict. They
                need not be those of this fit, which are taken where none are given.
        """
        ends = self._left_out_ends
        if residuals is None:
            return ends
        moved = [
            (r - own)[LAST_POSE] for r, own in zip(residuals, self.linear.residuals, strict=True)
        ]
        return LeftOutEnds(ends.errors + np.array(moved), ends.covariances)

    @cached_property
    def _left_out_ends(self) -> LeftOutEnds:
        errors = []
        covariances = []
        for left_out in self.leave_out():
            covariance = np.linalg.inv(left_out.precision)
            # The poses of a push share errors. The noise model allows for this by taking the noise
            # of each of K poses as K/K_eff times as large. A single pose has the noise itself.
            shared = (self.scale.pose * self.noise.pose) ** 2 * (np.sqrt(len(covariance) / 3) - 1)
            errors.append(covariance[LAST_POSE] @ left_out.pull)
            covariances.append(covariance[LAST_POSE, LAST_POSE] - shared * np.eye(POSE_SIZE))
        return LeftOutEnds(np.array(errors), np.array(covariances))

    def _factorize(self, c: float) -> tuple[tuple[Array, bool], float]:
        """Factorizes c I + J^T J, or c I + J J^T where that is smaller; see `factorize`."""
        return factorize(c * np.eye(len(self.gram)) + self.gram)


def factorize(matrix: Array) -> tuple[tuple[Array, bool], float]:
    """Factorizes I plus a Gram matrix after Cholesky, whatever round-off did to it.

    The matrix is positive definite, but where a push's end all but jumps, derivatives are so large
    that round-off makes it indefinite: with entries of 1e16, an eigenvalue of 1 is lost. Then a
    ridge is added to the diagonal, `FIRST_RIDGE` of its largest entry, and ten times as much until
    there is a factor. That keeps the large eigenvalues, and takes the small ones for a little
    larger: what the pushes leave open counts as a little better known.

    Args:
        matrix: (N, N), symmetric.

    Returns:
        The lower factor, as `scipy.linalg.cho_factor` gives it, and the ridge; 0 where none was
        needed.

    Raises:
        LinAlgError: an entry is not finite, or no ridge up to the largest entry is enough.
    """
    if not np.isfinite(matrix).all():
        raise np.linalg.LinAlgError("matrix with entries that are not finite")
    largest = float(np.diag(matrix).max(initial=1.0))
    ridge = 0.0
    while True:
        try:
            return cho_factor(matrix + ridge * np.eye(len(matrix)), lower=True), ridge
        except np.linalg.LinAlgError:
            if ridge >= largest:
                raise
            ridge = max(RIDGE_FACTOR * ridge, FIRST_RIDGE * largest)


def calc_shortening(dz: Array) -> float:
    """Factor, 1 or less, by which a step dz (n+1,) is shortened to MAX_STEP."""
    return min(1.0, MAX_STEP / max(float(np.abs(dz).max()), np.finfo(float).tiny))


def solve_factor(A: Array, difference: Array) -> Array:
    """Solves A u = z - z_0 for u (n+1,).

    Args:
        A: (n+1, n+1) factor of the prior covariance.
        difference: (n+1,) z - z_0.
    """
    return np.asarray(np.linalg.solve(A, difference), dtype=np.float64)
