"""The most probable parameters under one prior, by damped Gauss-Newton, and that prior's evidence.

With z = z_0 + A u, A A^T the prior covariance of z, the unknown is u, a priori N(0, I). Minimized
is

    1/2 |u|² + sum over pushes of Huber(W_p r_p(z)) + 1/2 |W_c (c(k) - c_0)|²

r_p the residuals of push p, W_p their whitening by the noise's covariance, c the center of friction
and c_0 the center of mass where one is given. Whitening, Huber's weights and the noise scale are
renewed between runs of the descent (`docs/theory/identification.md`, sections 3 and 4). Which
priors are fitted, and how their fits are averaged, is not decided here but in `map_ensemble`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular
from scipy.linalg.lapack import dtrtri

from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.noise import NoiseModel, NoiseScale, calc_effective_count
from gridpush_drake.identification.outliers import LeftOut
from gridpush_drake.identification.posterior import calc_center_jacobian, calc_share
from gridpush_drake.identification.problem import SHIFT, Linearization, PushProblem
from gridpush_drake.identification.result import FitStart
from gridpush_drake.objects.grid_object import GridObject, PhysicalPrior

EVALUATIONS = 25
"""Most times that the pushes are simulated for one fit."""

SETTLED = 0.001
"""Expected decrease of the loss at which a fit has settled for its noise scale."""

ROUGHLY_SETTLED = 0.05
"""Expected decrease of the loss at which the noise scale is renewed before the fit has settled. It
is used as long as the noise scale still changes."""

MAX_REJECTED = 3
"""Steps in a row that may make the loss larger, each shorter than the last. After so many the fit
is in a kink of the loss, where contacts change, and ends there."""

SCALE_TOLERANCE = 0.03
"""Relative change of the noise scale below which it has settled."""

MAX_STEP = 2.0
"""Largest change of any entry of z in one step. A longer step is shortened to it."""

DAMPING_FACTOR = 8.0
"""Factor by which damping grows when a step makes the loss larger, and falls when a step is taken.
It begins at the loss's curvature along the step, which about halves the next one."""

MAX_EFFECTIVE_SHARE = 0.8
"""Largest share of the residuals that parameters may use up. The rest speaks of the noise."""

FRICTION_STD = 0.2
"""Standard deviation of log mu from cell to cell. Where the bounds of an object's friction allow
less, it is what they allow."""

UNIFORM_WIDTH = 12.0**0.5
"""Width of a uniform distribution, in its standard deviations."""

MIN_CENTER_STD = 1e-4
"""Smallest standard deviation of a given center of mass, m. A smaller one is raised to it, for with
a sharper one the fit's equations are singular."""

LAST_POSE = slice(-3, None)
"""Rows of a push's residuals that belong to its last observed pose."""


@dataclass(frozen=True)
class CenterOfMass:
    """Where the center of mass is held to be, and how far from it the center of friction may be.

    Friction differs from place to place. Where loads x_i rest on frictions mu_i that scatter by
    themselves, the center of friction scatters about the center of mass with the covariance
    sigma_mu² sum_i x_i² (p_i - c) (p_i - c)^T: a body on three feet far apart by a lot, one that
    rests evenly by little.

    Attributes:
        at: (2,) body frame, m.
        std: standard deviation per axis, m.
        friction_std: standard deviation of log mu from cell to cell, each by itself.
    """

    at: tuple[float, float]
    std: float
    friction_std: float = 0.0

    @classmethod
    def of_prior(cls, prior: PhysicalPrior) -> "CenterOfMass | None":
        """Reads it from what is told of an object; None where no center of mass is told.

        Frictions scatter no more than their bounds allow.
        """
        if prior.center_of_mass is None:
            return None
        bounds_std = float(np.log(prior.friction_max / prior.friction_min)) / UNIFORM_WIDTH
        return cls(
            at=prior.center_of_mass,
            std=max(prior.center_of_mass_std, MIN_CENTER_STD),
            friction_std=min(FRICTION_STD, bounds_std),
        )

    def make_whitening(self, obj: GridObject, z: Array) -> tuple[Array, float]:
        """Makes W_c, which whitens the center of friction's distance from `at`.

        Args:
            obj: the object.
            z: (n+1,) where the scatter is taken.

        Returns:
            W_c (2, 2), 1/m, and -log det W_c.
        """
        share = calc_share(z)
        center = share @ obj.p_BC
        arm = share[:, None] * (obj.p_BC - center)
        # Section 4: (W_c^T W_c)^-1 = sigma_c0² I + sigma_mu² sum_i x_i² (p_i - c) (p_i - c)^T.
        covariance = self.std**2 * np.eye(2) + self.friction_std**2 * (arm.T @ arm)
        L = np.linalg.cholesky(covariance)
        return np.linalg.inv(L), float(np.log(np.diag(L)).sum())

    def linearize(self, obj: GridObject, z: Array, whitening: Array) -> tuple[Array, Array]:
        """Whitened residual (2,) of the center of friction at z (n+1,), and its Jacobian (2, n+1).

        The whitening is taken as a constant: its own derivative by z is left out.
        """
        share = calc_share(z)
        residual = whitening @ (share @ obj.p_BC - self.at)
        J = whitening @ calc_center_jacobian(share, obj.p_BC)
        return residual, J


@dataclass(frozen=True, eq=False)
class MapFit:
    """The most probable z under one prior.

    Attributes:
        z: (n+1,) log k and log mu_c.
        covariance: (n+1, n+1) of z, Laplace's approximation.
        scale: scale of the noise that the pushes show.
        log_evidence: log evidence of the prior, up to a constant shared by all priors on the same
            data.
        effective_parameters: number of directions of u that the data, not the prior, hold in place
            (MacKay's gamma).
        settled: whether the fit ended by itself, and not because it had used up its simulations of
            the pushes.
        linearized: the least-squares problem about z.
    """

    z: Array
    covariance: Array
    scale: NoiseScale
    log_evidence: float
    effective_parameters: float
    settled: bool
    linearized: "LinearizedFit"

    @property
    def linear(self) -> Linearization:
        """The pushes' residuals and derivatives at z."""
        return self.linearized.linear

    def judge(self, problem: PushProblem, others: Sequence[int]) -> list[LeftOut]:
        """What this fit says of pushes of a problem that it was not fitted to."""
        linear = problem.linearize(self.z, others)
        found = []
        for r, J, inputs in zip(linear.residuals, linear.by_z, linear.by_inputs, strict=True):
            # A push that was not fitted shows r ~ N(0, Sigma + J S J^T).
            noise = self.linearized.noise.calc_covariance(inputs, self.scale)
            expected = noise + J @ self.covariance @ J.T
            Q = np.asarray(np.linalg.inv(expected), dtype=np.float64)
            found.append(LeftOut(precision=Q, pull=Q @ r))
        return found


def fit_map(
    problem: PushProblem,
    z0: Array,
    A: Array,
    noise: NoiseModel,
    center_of_mass: CenterOfMass | None = None,
    *,
    start: FitStart | None = None,
    linear: Linearization | None = None,
    warm_start: FitStart | None = None,
    on_step: Callable[[Array, Linearization], None] | None = None,
    max_evaluations: int = EVALUATIONS,
) -> MapFit:
    """Fits z.

    Args:
        problem: the training pushes.
        z0: (n+1,) prior mean.
        A: (n+1, n+1) factor of the prior covariance, A A^T.
        noise: the noise model.
        center_of_mass: prior knowledge of the center of mass, or None.
        start: where to begin; z0 and scale one by default.
        linear: the pushes' residuals and derivatives there, where they are known.
        warm_start: where a fit to fewer pushes ended; it is taken instead where it is the more
            probable beginning.
        on_step: called with z and the residuals and derivatives there after every step that is
            taken.
        max_evaluations: most times that the pushes are simulated.

    Returns:
        The fit.
    """
    # Of two places to begin, the more probable one is nearer to the end.
    start = start or FitStart(z0, NoiseScale())
    task = MapProblem(problem=problem, z0=z0, A=A, noise=noise, center_of_mass=center_of_mass)
    system = task.linearize_at(start, linear)
    if warm_start is not None:
        system = min(system, task.linearize_at(warm_start), key=LinearizedFit.objective)

    descent = _Descent(problem, system, max_evaluations, on_step)
    gamma = descent.run()
    system = descent.linearized

    # Section 4: log p(data) is about -loss - 1/2 log det H, and -log p(c_0), which is no data.
    evidence = -system.objective() - 0.5 * system.calc_log_determinant()
    if center_of_mass is not None:
        evidence -= _calc_center_evidence(problem.obj, z0, A, center_of_mass)
    return MapFit(
        z=z0 + A @ system.u,
        covariance=system.calc_covariance(),
        scale=system.scale,
        log_evidence=float(evidence),
        effective_parameters=gamma,
        settled=not descent.is_spent,
        linearized=system,
    )


class _Descent:
    """Damped Gauss-Newton from one point, and what it remembers from step to step.

    Attributes:
        problem: the training pushes.
        linearized: the least-squares problem about the point reached so far.
    """

    def __init__(
        self,
        problem: PushProblem,
        system: "LinearizedFit",
        max_evaluations: int,
        on_step: Callable[[Array, Linearization], None] | None,
    ) -> None:
        self.problem = problem
        self.linearized = system
        self._on_step = on_step
        # Simulations of the pushes that are left, steps rejected in a row, and the damping.
        self._left = max_evaluations
        self._rejected = 0
        self._damping = 0.0

    @property
    def is_spent(self) -> bool:
        """Whether the pushes are not to be simulated any more."""
        return self._left <= 0

    def run(self) -> float:
        """Goes down until steps and noise scale have settled; returns gamma there."""
        scale_changes = True
        while True:
            step, expected = self.linearized.calc_step(self._damping)
            settled = expected < SETTLED or self._rejected >= MAX_REJECTED
            if settled or self.is_spent or (scale_changes and expected < ROUGHLY_SETTLED):
                # The residuals say how large the noise is, once the steps have become small.
                scale, gamma = self.linearized.renew_scale()
                change = np.abs(np.log(np.divide(scale, self.linearized.scale))).max()
                scale_changes = bool(change >= SCALE_TOLERANCE)
                if scale_changes or settled or self.is_spent:
                    self.linearized = self.linearized.rescale(scale)
                if self.is_spent or (settled and not scale_changes):
                    return gamma
                if scale_changes:
                    # Another loss: steps are not damped to begin with, and one more may be tried.
                    self._damping = 0.0
                    self._rejected = min(self._rejected, MAX_REJECTED - 1)
                    continue
            self._try_step(step)

    def _try_step(self, step: Array) -> None:
        """Takes a step if it makes the loss smaller; if not, the next one is shorter."""
        system = self.linearized
        u = system.u + step
        z = system.z0 + system.A @ u
        linear = self.problem.linearize(z)
        self._left -= 1
        before = system.calc_loss(system.u, system.linear.residuals)
        # Written so that a loss that is not a number is rejected, too.
        if not system.calc_loss(u, linear.residuals) < before:
            self._damping = max(DAMPING_FACTOR * self._damping, system.calc_curvature(step))
            self._rejected += 1
            return
        self.linearized = system.move(u, linear)
        # The damping was right if the step before was rejected; else none was needed.
        self._damping = self._damping / DAMPING_FACTOR if self._rejected else 0.0
        self._rejected = 0
        if self._on_step is not None:
            self._on_step(z, linear)


def calc_laplace(
    problem: PushProblem, z: Array, A: Array, noise: NoiseModel
) -> tuple[Array, NoiseScale]:
    """Spread about given parameters.

    Args:
        problem: the training pushes.
        z: (n+1,) the parameters.
        A: (n+1, n+1) factor of the prior covariance.
        noise: the noise model.

    Returns:
        The covariance (n+1, n+1) of z by Laplace's approximation, and the noise scale.
    """
    task = MapProblem(problem=problem, z0=z, A=A, noise=noise, center_of_mass=None)
    system = task.linearize(np.zeros(len(z)), problem.linearize(z), NoiseScale())
    scale, _ = system.renew_scale()
    return system.rescale(scale).calc_covariance(), scale


@dataclass(frozen=True, eq=False)
class MapProblem:
    """What a fit is asked: which pushes it is to explain, and what is believed beforehand.

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

    Of the two forms of I + J^T J and its inverse the smaller one is taken: by unknowns, or by
    residuals,

        (c I + J^T J)^-1 = (I - J^T (c I + J J^T)^-1 J) / c

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
        self.factor = self._factorize(1.0)

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
            damping: how much stronger the prior is taken to be, about u. 0 is Gauss-Newton's step.

        Returns:
            The step (n+1,) of u, and the decrease of the loss that is expected of it.
        """
        # d = -(c I + J^T J)^-1 g, with g the gradient of the loss, in the smaller of both forms.
        g = self.u + self.J.T @ self.r
        c = 1.0 + damping
        factor = self.factor if damping == 0 else self._factorize(c)
        if self.by_residuals:
            shown = self.J.T @ cho_solve(factor, self.J @ g)
            d = (shown - g) / c
        else:
            d = -cho_solve(factor, g)

        # Far away the linearization says nothing.
        d *= _calc_shortening(self.A @ d)
        slope = self.J @ d
        return d, float(-g @ d - 0.5 * (d @ d + slope @ slope))

    def calc_curvature(self, step: Array) -> float:
        """Curvature of the loss along a step, over that of the prior's part of it, which is 1."""
        slope = self.J @ step
        return 1.0 + float(slope @ slope) / float(step @ step)

    def calc_loss(self, u: Array, residuals: list[Array]) -> float:
        """Negative log posterior at u but for normalization; Huber's, not the weighted quadratic.

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
        """The noise scale by MacKay's fixed points, and gamma.

        s² = (sum |W r|² s² + nu)/(N - gamma + nu), and t² = (sum |xi|²/sigma_c² + nu_c)/(sum
        gamma_c + nu_c) with xi the shifts that the residuals speak for and gamma_c how surely, each
        between 0 and 2.
        """
        squares = sum(float(r @ r) for r in self.rows)
        count = sum(calc_effective_count(len(r)) for r in self.linear.residuals)

        # gamma = n + 1 - tr H^-1. The squares of the inverse factor's entries add up to that
        # trace. Two directions are held by the center of mass, and not by the pushes.
        known = 2 if self.center_of_mass is not None else 0
        root, _ = dtrtri(self.factor[0], lower=1)
        gamma = len(self.gram) - float((np.tril(root) ** 2).sum()) - known
        gamma = float(np.clip(gamma, 0.0, MAX_EFFECTIVE_SHARE * count))

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
            T = root * std * W.apply(inputs[:, SHIFT])
            pulls.append(self.J[first : first + len(r)].T @ T)
            first += len(r)
            moved += float(((T.T @ r) ** 2).sum())
            sure += float((T * T).sum())
        # What the unknowns explain just as well is no sign of a shift: tr T^T J H^-1 J^T T.
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
        # Both forms are made from a half, so that what comes out is symmetric.
        if self.by_residuals:
            half = solve_triangular(self.factor[0], self.J @ self.A.T, lower=True)
            return self.A @ self.A.T - half.T @ half
        half = solve_triangular(self.factor[0], self.A.T, lower=True)
        return half.T @ half

    def fit_without(self, index: int) -> LeftOut:
        """Fits the other pushes again, and gives what they say of one."""
        chosen = [i for i in range(len(self.problem)) if i != index]
        fit = fit_map(
            self.problem.choose(chosen),
            self.z0,
            self.A,
            self.noise,
            self.center_of_mass,
            start=FitStart(self.z0 + self.A @ self.u, self.scale),
            linear=self.linear.choose(chosen),
        )
        return fit.judge(self.problem, [index])[0]

    def leave_out(self) -> list[LeftOut]:
        """What the other pushes say of each, to first order.

        With h = J H^-1 J^T of a push of weight w, its own pull on the fit included, the others
        predict residuals (I - w h)^-1 r with covariance I + h (I - w h)^-1, all whitened.
        """
        found = []
        for weight, W, r, J in zip(
            self.weights, self.whitenings, self.linear.residuals, self.slopes, strict=True
        ):
            identity = np.eye(len(r))
            whitened = W.apply(J)
            h = whitened @ self.solve(whitened.T)
            alone = np.linalg.inv(identity - weight * h)
            # Precision and pull in meters: W is on both sides of the whitened covariance's inverse.
            covariance = identity + h @ alone
            root = np.asarray(np.linalg.solve(covariance, W.apply(identity)), dtype=np.float64)
            pull = root.T @ (alone @ W.apply(r))
            found.append(LeftOut(precision=W.apply(root), pull=pull))
        return found

    def calc_end_errors(self, residuals: list[Array]) -> Array:
        """Says how far off the other pushes predict each one's last pose, seen by itself.

        Args:
            residuals: (3K,) of each push, m, by the parameters that are to predict, which stand in
                for this fit's.

        Returns:
            (P,) squared lengths of the errors, as cells move, over the expected ones.
        """
        found = []
        for left_out, r, own in zip(
            self.leave_out(), residuals, self.linear.residuals, strict=True
        ):
            covariance = np.linalg.inv(left_out.precision)
            # The noise of K poses is written K/K_eff times as large, because they share errors. A
            # single pose, seen by itself, has it once.
            shared = (self.scale.pose * self.noise.pose) ** 2 * (np.sqrt(len(covariance) / 3) - 1)
            e = covariance[LAST_POSE] @ left_out.pull + (r - own)[LAST_POSE]
            expected = float(np.trace(covariance[LAST_POSE, LAST_POSE]) - 3 * shared)
            found.append(float(e @ e) / expected)
        return np.array(found)

    def _factorize(self, c: float) -> tuple[Array, bool]:
        """Factorizes c I + J^T J, or c I + J J^T where that is smaller."""
        return cho_factor(c * np.eye(len(self.gram)) + self.gram, lower=True)


def _calc_shortening(dz: Array) -> float:
    """Factor, 1 or less, by which a step dz (n+1,) is shortened to MAX_STEP."""
    return min(1.0, MAX_STEP / max(float(np.abs(dz).max()), np.finfo(float).tiny))


def solve_factor(A: Array, difference: Array) -> Array:
    """Solves A u = z - z_0 for u (n+1,).

    Args:
        A: (n+1, n+1) factor of the prior covariance.
        difference: (n+1,) z - z_0.
    """
    return np.asarray(np.linalg.solve(A, difference), dtype=np.float64)


def _calc_center_evidence(
    obj: GridObject, z0: Array, A: Array, center_of_mass: CenterOfMass
) -> float:
    """Log p(c_0) under the prior alone, before any push: knowledge, not data.

    Laplace's approximation about the most probable u, as for the fit itself.
    """
    # Gauss-Newton in the form by residuals, of which there are but two.
    u = np.zeros(A.shape[1])
    for _ in range(EVALUATIONS):
        z = z0 + A @ u
        whitening, spread = center_of_mass.make_whitening(obj, z)
        r, J = center_of_mass.linearize(obj, z, whitening)
        J = J @ A
        inner = np.eye(len(r)) + J @ J.T
        step = J.T @ np.linalg.solve(inner, J @ u - r) - u
        if float(step @ step) < SETTLED:
            break
        u += step * _calc_shortening(A @ step)
    return float(-0.5 * (u @ u + r @ r) - spread - 0.5 * np.linalg.slogdet(inner)[1])
