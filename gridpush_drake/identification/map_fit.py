"""The most probable parameters under one smoothness prior, by damped Gauss-Newton, and that prior's evidence.

With z = z_0 + A u, A A^T the prior covariance of z, the unknown is u, a priori N(0, I). Minimized
is

    1/2 |u|² + sum over pushes of Huber(W_p r_p(z)) + 1/2 |W_c (c(k) - c_0)|²

r_p the residuals of push p, W_p their whitening by the noise's covariance, c the center of friction
and c_0 the center of mass where one is given. Whitening, Huber's weights and the noise scale are
renewed between runs of the descent (`docs/theory/identification.md`, sections 3 and 4).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

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
"""The same at which the noise scale is renewed, as long as that still changes."""

MAX_REJECTED = 3
"""Steps in a row, each shorter, that make things worse: then the fit is in a kink of the loss,
where contacts change, and stays there."""

SCALE_TOLERANCE = 0.03
"""Relative change of the noise scale at which it has settled too."""

MAX_STEP = 2.0
"""Of any unknown, in one step."""

DAMPING_FACTOR = 8.0
"""What damping grows by when a step makes things worse. It begins at the loss's curvature along
that step, which about halves it."""

MAX_EFFECTIVE_SHARE = 0.8
"""Of the residuals, that parameters may use up; the rest speaks of the noise."""

FRICTION_STD = 0.2
"""Of log mu from cell to cell, at most: what the bounds of the friction allow where that is
less."""

UNIFORM_WIDTH = 12.0**0.5
"""Width of a uniform distribution, in its standard deviations."""

MIN_CENTER_STD = 1e-4
"""m, below which the center of mass is not taken to be known: sharper, the fit's equations are
singular."""

LAST_POSE = slice(-3, None)
"""Of a push's residuals."""


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
        friction_std: of log mu from cell to cell, each by itself.
    """

    at: tuple[float, float]
    std: float
    friction_std: float = 0.0

    @classmethod
    def of_prior(cls, prior: PhysicalPrior) -> "CenterOfMass | None":
        """What is told of an object; None where that is nothing. Frictions scatter no more than their bounds allow."""
        if prior.center_of_mass is None:
            return None
        bounds_std = float(np.log(prior.friction_max / prior.friction_min)) / UNIFORM_WIDTH
        return cls(
            prior.center_of_mass,
            max(prior.center_of_mass_std, MIN_CENTER_STD),
            min(FRICTION_STD, bounds_std),
        )

    def make_whitening(self, obj: GridObject, z: Array) -> tuple[Array, float]:
        """W_c (2, 2), 1/m, which whitens the center of friction's distance from `at` at z (n+1,), and -log det W_c."""
        share = calc_share(z)
        arm = share[:, None] * (obj.p_BC - share @ obj.p_BC)
        L = np.linalg.cholesky(self.std**2 * np.eye(2) + self.friction_std**2 * (arm.T @ arm))
        return np.linalg.inv(L), float(np.log(np.diag(L)).sum())

    def linearize(self, obj: GridObject, z: Array, whitening: Array) -> tuple[Array, Array]:
        """Whitened residual (2,) of the center of friction at z (n+1,), and its Jacobian (2, n+1)."""
        share = calc_share(z)
        return whitening @ (share @ obj.p_BC - self.at), whitening @ calc_center_jacobian(
            share, obj.p_BC
        )


@dataclass(frozen=True, eq=False)
class MapFit:
    """The most probable z under one prior.

    Attributes:
        z: (n+1,) log k and log mu_c.
        covariance: (n+1, n+1) of z, Laplace's approximation.
        scale: of the noise.
        log_evidence: for the prior, up to a constant shared by all priors on the same data.
        effective_parameters: number of directions of u that the data, not the prior, hold in place (MacKay's
            gamma).
        settled: whether it ended by itself, not because it was not to simulate the pushes any more.
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
        linear, found = problem.linearize(self.z, others), []
        for r, J, inputs in zip(linear.residuals, linear.by_z, linear.by_inputs, strict=True):
            noise = self.linearized.noise.calc_covariance(inputs, self.scale)
            Q = np.asarray(np.linalg.inv(noise + J @ self.covariance @ J.T), dtype=np.float64)
            found.append(LeftOut(Q, Q @ r))
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
    make = partial(LinearizedFit.of, problem, z0, A, noise, center_of_mass)
    start = start or FitStart(z0, NoiseScale())
    system = make(solve_factor(A, start.z - z0), linear or problem.linearize(start.z), start.scale)
    if warm_start is not None:
        other = make(
            solve_factor(A, warm_start.z - z0), problem.linearize(warm_start.z), warm_start.scale
        )
        system = min(system, other, key=LinearizedFit.objective)
    descent = _Descent(problem, system, max_evaluations, on_step)
    gamma = descent.run()
    system = descent.linearized
    evidence = -system.objective() - 0.5 * system.calc_log_determinant()
    if center_of_mass is not None:
        evidence -= _calc_center_evidence(problem.obj, z0, A, center_of_mass)
    return MapFit(
        z0 + A @ system.u,
        system.calc_covariance(),
        system.scale,
        float(evidence),
        gamma,
        not descent.is_spent,
        system,
    )


class _Descent:
    """Damped Gauss-Newton from one point, and what it remembers from step to step."""

    def __init__(
        self, problem: PushProblem, system: "LinearizedFit", max_evaluations: int,
        on_step: Callable[[Array, Linearization], None] | None,
    ) -> None:  # fmt: skip
        self.problem, self.linearized, self._on_step = problem, system, on_step
        self._left, self._rejected, self._damping = max_evaluations, 0, 0.0

    @property
    def is_spent(self) -> bool:
        """Whether the pushes are not to be simulated any more."""
        return self._left <= 0

    def run(self) -> float:
        """Goes down until steps and noise scale have settled; returns gamma there."""
        settling = True  # the scale
        while True:
            step, expected = self.linearized.calc_step(self._damping)
            settled = expected < SETTLED or self._rejected >= MAX_REJECTED
            if settled or self.is_spent or (settling and expected < ROUGHLY_SETTLED):
                scale, gamma = self.linearized.renew_scale()
                settling = bool(
                    np.abs(np.log(np.divide(scale, self.linearized.scale))).max() >= SCALE_TOLERANCE
                )
                if settling or settled or self.is_spent:
                    self.linearized = self.linearized.rescale(scale)
                if self.is_spent or (settled and not settling):
                    return gamma
                if settling:
                    self._damping, self._rejected = 0.0, min(self._rejected, MAX_REJECTED - 1)
                    continue
            self._try_step(step)

    def _try_step(self, step: Array) -> None:
        """Takes a step if it makes things better; if not, the next one is shorter."""
        system = self.linearized
        u = system.u + step
        z = system.z0 + system.A @ u
        linear = self.problem.linearize(z)
        self._left -= 1
        if not system.calc_loss(u, linear.residuals) < system.calc_loss(
            system.u, system.linear.residuals
        ):
            self._damping = max(DAMPING_FACTOR * self._damping, system.calc_curvature(step))
            self._rejected += 1
            return
        self.linearized = system.move(u, linear)
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
    u, linear = np.zeros(len(z)), problem.linearize(z)
    system = LinearizedFit.of(problem, z, A, noise, None, u, linear, NoiseScale())
    scale, _ = system.renew_scale()
    return system.rescale(scale).calc_covariance(), scale


class LinearizedFit:
    """The least-squares problem in u about one point, whitening and weights as they are there.

    Of the two forms of I + J^T J and its inverse the smaller one is taken: by unknowns, or by
    residuals,

        (c I + J^T J)^-1 = (I - J^T (c I + J J^T)^-1 J) / c
    """

    def __init__(
        self, problem: PushProblem, z0: Array, A: Array, noise: NoiseModel, center_of_mass: CenterOfMass | None,
        u: Array, linear: Linearization, slopes: list[Array], scale: NoiseScale,
    ) -> None:  # fmt: skip
        """Takes over a point; `slopes` (3K, n+1) are the residuals' derivatives by u, one entry a push."""
        self.problem, self.z0, self.A, self.noise, self.center_of_mass = (
            problem,
            z0,
            A,
            noise,
            center_of_mass,
        )
        self.u, self.linear, self.slopes, self.scale = u, linear, slopes, scale
        self.whitenings = noise.make_whitenings(linear.by_inputs, scale)
        whitened = [W.apply(r) for W, r in zip(self.whitenings, linear.residuals, strict=True)]
        self.weights = [noise.calc_weight(r) for r in whitened]
        roots = np.sqrt(self.weights)
        self.rows = [root * r for root, r in zip(roots, whitened, strict=True)]
        jacobians = [
            root * W.apply(J) for root, W, J in zip(roots, self.whitenings, slopes, strict=True)
        ]
        rows = list(self.rows)
        if center_of_mass is not None:
            z = z0 + A @ u
            self.center_whitening, self.center_spread = center_of_mass.make_whitening(
                problem.obj, z
            )
            r, J = center_of_mass.linearize(problem.obj, z, self.center_whitening)
            rows.append(r)
            jacobians.append(J @ A)
        self.r, self.J = np.concatenate(rows), np.concatenate(jacobians)
        self.by_residuals = len(self.r) < len(u)
        self.gram = self.J @ self.J.T if self.by_residuals else self.J.T @ self.J
        self.factor = self._factorize(1.0)

    @classmethod
    def of(
        cls, problem: PushProblem, z0: Array, A: Array, noise: NoiseModel, center_of_mass: CenterOfMass | None,
        u: Array, linear: Linearization, scale: NoiseScale,
    ) -> "LinearizedFit":  # fmt: skip
        """The problem about u (n+1,), where the pushes' residuals and derivatives are `linear`."""
        ends = np.cumsum([len(r) for r in linear.residuals])[:-1]
        slopes = np.split(np.concatenate(linear.by_z) @ A, ends)
        return cls(problem, z0, A, noise, center_of_mass, u, linear, slopes, scale)

    def move(self, u: Array, linear: Linearization) -> "LinearizedFit":
        """The same about another point."""
        return self.of(
            self.problem, self.z0, self.A, self.noise, self.center_of_mass, u, linear, self.scale
        )

    def rescale(self, scale: NoiseScale) -> "LinearizedFit":
        """The same about the same point, with another scale of the noise."""
        return LinearizedFit(
            self.problem,
            self.z0,
            self.A,
            self.noise,
            self.center_of_mass,
            self.u,
            self.linear,
            self.slopes,
            scale,
        )

    def scale_noise(self, factor: float) -> "LinearizedFit":
        """The same about the same point, with all noise so many times as large."""
        return self.rescale(NoiseScale(factor * self.scale.pose, factor * self.scale.shift))

    def linearize_at_prior(self) -> tuple[Array, Array]:
        """The whitened residuals (R,) at z0, to first order, and their derivatives (R, n+1) by z."""
        return self.r - self.J @ self.u, solve_triangular(self.A, self.J.T, trans="T", lower=True).T

    def calc_step(self, damping: float) -> tuple[Array, float]:
        """Step of u, damped by so much as if the prior were that much stronger about u, and the expected decrease."""
        g = self.u + self.J.T @ self.r
        c = 1.0 + damping
        factor = self.factor if damping == 0 else self._factorize(c)
        d = (
            (self.J.T @ cho_solve(factor, self.J @ g) - g) / c
            if self.by_residuals
            else -cho_solve(factor, g)
        )
        d *= min(1.0, MAX_STEP / max(float(np.abs(self.A @ d).max()), np.finfo(float).tiny))
        slope = self.J @ d
        return d, float(-g @ d - 0.5 * (d @ d + slope @ slope))

    def calc_curvature(self, step: Array) -> float:
        """Of the loss along a step, in that of the prior, which is 1."""
        slope = self.J @ step
        return 1.0 + float(slope @ slope) / float(step @ step)

    def calc_loss(self, u: Array, residuals: list[Array]) -> float:
        """Negative log posterior at u but for normalization; Huber's, not the weighted quadratic."""
        total = 0.5 * float(u @ u)
        total += sum(
            self.noise.calc_loss(W.apply(r))
            for W, r in zip(self.whitenings, residuals, strict=True)
        )
        if self.center_of_mass is not None:
            r, _ = self.center_of_mass.linearize(
                self.problem.obj, self.z0 + self.A @ u, self.center_whitening
            )
            total += 0.5 * float(r @ r)
        return total

    def objective(self) -> float:
        """Negative log posterior here, the normalizations of the noise and of the center's distance included."""
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
        known = 2 if self.center_of_mass is not None else 0
        squares = sum(float(r @ r) for r in self.rows)
        count = sum(calc_effective_count(len(r)) for r in self.linear.residuals)
        root, _ = dtrtri(
            self.factor[0], lower=1
        )  # whose squares add up to the trace of the inverse
        gamma = len(self.gram) - float((np.tril(root) ** 2).sum()) - known
        gamma = float(np.clip(gamma, 0.0, MAX_EFFECTIVE_SHARE * count))
        weight = self.noise.prior_weight
        pose = np.sqrt((squares * self.scale.pose**2 + weight) / (count - gamma + weight))
        moved, sure = self._calc_shifts()
        weight = self.noise.shift_weight
        return NoiseScale(
            float(pose), float(np.sqrt((moved * self.scale.shift**2 + weight) / (sure + weight)))
        ), gamma

    def _calc_shifts(self) -> tuple[float, float]:
        """Sums over pushes of |xi|², xi the expected shift of the load's center in its deviations, and of gamma_c."""
        std = self.scale.shift * self.noise.load_shift
        moved, sure, first, pulls = 0.0, 0.0, 0, []
        for r, root, W, inputs in zip(
            self.rows, np.sqrt(self.weights), self.whitenings, self.linear.by_inputs, strict=True
        ):
            T = root * std * W.apply(inputs[:, SHIFT])
            pulls.append(self.J[first : first + len(r)].T @ T)
            first += len(r)
            moved += float(((T.T @ r) ** 2).sum())
            sure += float((T * T).sum())
        v = np.concatenate(pulls, axis=1)
        return moved, sure - float((v * self.solve(v)).sum())

    def solve(self, v: Array) -> Array:
        """(I + J^T J)^-1 v."""
        if self.by_residuals:
            return np.asarray(v - self.J.T @ cho_solve(self.factor, self.J @ v))
        return np.asarray(cho_solve(self.factor, v))

    def calc_log_determinant(self) -> float:
        """Of I + J^T J."""
        return 2.0 * float(np.log(np.diag(self.factor[0])).sum())

    def calc_covariance(self) -> Array:
        """(n+1, n+1) of z: A (I + J^T J)^-1 A^T."""
        if self.by_residuals:
            half = solve_triangular(self.factor[0], self.J @ self.A.T, lower=True)
            return self.A @ self.A.T - half.T @ half
        half = solve_triangular(self.factor[0], self.A.T, lower=True)
        return half.T @ half

    def fit_without(self, index: int) -> LeftOut:
        """Fits the other pushes again, and gives what they say of one."""
        chosen = [i for i in range(len(self.problem)) if i != index]
        fit = fit_map(
            self.problem.choose(chosen), self.z0, self.A, self.noise, self.center_of_mass,
            start=FitStart(self.z0 + self.A @ self.u, self.scale), linear=self.linear.choose(chosen),
        )  # fmt: skip
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
            root = np.asarray(
                np.linalg.solve(identity + h @ alone, W.apply(identity)), dtype=np.float64
            )
            found.append(LeftOut(W.apply(root), root.T @ (alone @ W.apply(r))))
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
            shared = (self.scale.pose * self.noise.pose) ** 2 * (np.sqrt(len(covariance) / 3) - 1)
            e = covariance[LAST_POSE] @ left_out.pull + (r - own)[LAST_POSE]
            found.append(
                float(e @ e) / float(np.trace(covariance[LAST_POSE, LAST_POSE]) - 3 * shared)
            )
        return np.array(found)

    def _factorize(self, c: float) -> tuple[Array, bool]:
        return cho_factor(c * np.eye(len(self.gram)) + self.gram, lower=True)


def solve_factor(A: Array, difference: Array) -> Array:
    """The u (n+1,) of a difference of z (n+1,)."""
    return np.asarray(np.linalg.solve(A, difference), dtype=np.float64)


def _calc_center_evidence(
    obj: GridObject, z0: Array, A: Array, center_of_mass: CenterOfMass
) -> float:
    """Log p(c_0) under the smoothness prior alone: knowledge, not data. Laplace's, as that of the fit is."""
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
        u += step * min(1.0, MAX_STEP / max(float(np.abs(A @ step).max()), np.finfo(float).tiny))
    return float(-0.5 * (u @ u + r @ r) - spread - 0.5 * np.linalg.slogdet(inner)[1])
