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

from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.fit.linearized_fit import (
    LinearizedFit,
    MapProblem,
    calc_shortening,
    solve_factor,
)
from gridpush_drake.identification.result import FitStart
from gridpush_drake.identification.statistics.center_of_mass import CenterOfMass
from gridpush_drake.identification.statistics.noise import NoiseModel, NoiseScale
from gridpush_drake.identification.statistics.outliers import LeftOut
from gridpush_drake.identification.statistics.posterior import CONTACT_FRICTION
from gridpush_drake.identification.statistics.problem import Linearization, PushProblem
from gridpush_drake.objects.grid_object import GridObject

MAX_EVALUATIONS = 25
"""Most times that the pushes are simulated for one fit."""

SETTLED_DECREASE = 0.001
"""Expected decrease of the loss at which a fit has settled for its noise scale."""

ROUGHLY_SETTLED = 0.05
"""Expected decrease of the loss at which the noise scale is renewed before the fit has settled. It
is used as long as the noise scale still changes."""

MAX_REJECTED = 3
"""Steps in a row that may make the loss larger, each shorter than the last. After so many the fit
is in a kink of the loss, where contacts change, and ends there."""

SCALE_TOLERANCE = 0.03
"""Relative change of the noise scale below which it has settled."""

DAMPING_FACTOR = 8.0
"""Factor by which damping grows when a step makes the loss larger, and falls when a step is taken.
It begins at the loss's curvature along the step, which about halves the next one."""

SCANNED_FRICTIONS = (-3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0)
"""Contact frictions that are tried where a fit has ended, as distances of log mu_c from its prior
mean in prior standard deviations."""

FRICTION_GAIN = 1.0
"""Least decrease of the loss by which another contact friction is taken for better, nats."""


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
    max_evaluations: int = MAX_EVALUATIONS,
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
            settled = expected < SETTLED_DECREASE or self._rejected >= MAX_REJECTED
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
        smaller = system.calc_loss(u, linear.residuals) < before
        moved = _move_to(system, u, linear) if smaller else None
        if moved is None:
            self._damping = max(DAMPING_FACTOR * self._damping, system.calc_curvature(step))
            self._rejected += 1
            return
        self.linearized = moved
        # The damping was right if the step before was rejected; else none was needed.
        self._damping = self._damping / DAMPING_FACTOR if self._rejected else 0.0
        self._rejected = 0
        if self._on_step is not None:
            self._on_step(z, linear)


def _move_to(system: LinearizedFit, u: Array, linear: Linearization) -> LinearizedFit | None:
    """Linearizes about another point; None where its equations cannot be solved.

    That is where a push's end all but jumps, so that its derivatives are as good as infinite.
    """
    try:
        moved = system.move(u, linear)
    except np.linalg.LinAlgError:
        return None
    return None if moved.ridge > 0 else moved


def fit_without(fit: LinearizedFit, index: int) -> LeftOut:
    """Fits the other pushes again, and gives what they say of one.

    Args:
        fit: the least-squares problem about the most probable parameters of all pushes.
        index: the push that is left out.
    """
    asked = fit.asked
    chosen = [i for i in range(len(asked.problem)) if i != index]
    others = fit_map(
        asked.problem.choose(chosen),
        asked.z0,
        asked.A,
        asked.noise,
        asked.center_of_mass,
        start=FitStart(asked.z0 + asked.A @ fit.u, fit.scale),
        linear=fit.linear.choose(chosen),
    )
    return others.judge(asked.problem, [index])[0]


def replace_contact_friction(z: Array, log_friction: float) -> Array:
    """Copies z (n+1,) with another log mu_c."""
    other = z.copy()
    other[CONTACT_FRICTION] = log_friction
    return other


def scan_contact_friction(fit: MapFit) -> float | None:
    """Looks for a contact friction that explains the pushes better with the loads of a fit.

    Where all contacts stick, the motion is the same with any larger friction: the loss is flat in
    log mu_c but for its prior, and no descent finds the friction at which some contacts slip.

    Returns:
        log mu_c, the best of `SCANNED_FRICTIONS`; None where none is better than the fit's own.
    """
    system = fit.linearized
    std = system.A[CONTACT_FRICTION, CONTACT_FRICTION]
    if not std > 0:
        return None
    frictions = system.z0[CONTACT_FRICTION] + std * np.array(SCANNED_FRICTIONS)
    losses = []
    for friction in frictions:
        z = replace_contact_friction(fit.z, friction)
        u = solve_factor(system.A, z - system.z0)
        losses.append(system.calc_loss(u, system.problem.residuals(z)))
    best = int(np.argmin(losses))
    now = system.calc_loss(system.u, system.linear.residuals)
    return float(frictions[best]) if losses[best] < now - FRICTION_GAIN else None


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


def _calc_center_evidence(
    obj: GridObject, z0: Array, A: Array, center_of_mass: CenterOfMass
) -> float:
    """Log p(c_0) under the prior alone, before any push: knowledge, not data.

    Laplace's approximation about the most probable u, as for the fit itself.
    """
    # Gauss-Newton in the form by residuals, of which there are but two.
    u = np.zeros(A.shape[1])
    for _ in range(MAX_EVALUATIONS):
        z = z0 + A @ u
        whitening, spread = center_of_mass.make_whitening(obj, z)
        r, J = center_of_mass.linearize(obj, z, whitening)
        J = J @ A
        inner = np.eye(len(r)) + J @ J.T
        step = J.T @ np.linalg.solve(inner, J @ u - r) - u
        if float(step @ step) < SETTLED_DECREASE:
            break
        u += step * calc_shortening(A @ step)
    return float(-0.5 * (u @ u + r @ r) - spread - 0.5 * np.linalg.slogdet(inner)[1])
