"""`JointSmoothFields`: the maps of several objects, and their friction, learned together.

Pushes in which one object pushes another tell of both: how the pushed one answers, and by how much
it holds the other back. So all are learned in one: with z = (log k of every object's cells; log of
the frictions with the pusher; log of the pairs' frictions) and the residuals r(z) of all poses that
were seen, divided by their noise,

    min over z of  sum of rho(|r_b(z)|²) + (z - z_0)^T P^-1 (z - z_0)/2

with a block r_b for all objects at each time of each push. Poses that the model cannot explain
count for little by rho (`robust_least_squares`), and their pushes are named in the result. The
prior of an object's log k is a smooth field of amplitude a (`hypotheses.calc_smooth_covariance`)
and one number more for the object as a whole: how heavy it is beside the others. Several amplitudes
are fitted, coarse to fine, and the one of greatest evidence, by Laplace's approximation, is taken.

What pushes cannot tell: a factor that all k have in common, for slow pushes only weigh the objects
against each other; and masses by themselves, as for one object (`docs/theory/model.md`, section 7).
The masses that are given stand for k_i = mu_i m_i g with the friction that the object's file names.
Two objects that never pushed each other cannot be compared, either; `JointIdentification` says so.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from gridpush_drake.dynamics.bodies import Bodies
from gridpush_drake.dynamics.push import make_times_with
from gridpush_drake.dynamics.scene.simulation import simulate_together
from gridpush_drake.errors import IdentificationError
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.fit.hypotheses import AMPLITUDE_EXPONENT
from gridpush_drake.identification.fit.learning_task import Abilities, Found, LearningTask
from gridpush_drake.identification.fit.load_prior import calc_smooth_covariance
from gridpush_drake.identification.multi_object.joint_problem import JointProblem
from gridpush_drake.identification.multi_object.joint_result import (
    METHOD,
    UNEXPLAINED,
    JointIdentification,
)
from gridpush_drake.identification.prediction import calc_cell_errors
from gridpush_drake.identification.statistics.robust_least_squares import RobustFit, fit_robustly
from gridpush_drake.pushes.observed_push import ObservedPush
from gridpush_drake.pushes.push_log import PushLog

AMPLITUDES = (0.05, 0.3, 0.7, 1.5)
"""Standard deviations of log k within an object that are tried."""

TOTAL_STD = 1.0
"""Standard deviation of the logarithm of an object's whole load beside the others'."""

FRICTION_STD = 0.5
"""Standard deviation of the logarithm of a contact's friction coefficient."""

NOISE = (1e-3, 1e-3, 5e-3)
"""Standard deviations of what poses are off from their predictions, m, m and rad: those of seeing
them, and those of the model."""

MOVED = 4.0
"""An object counts as moved where it was seen to end this many standard deviations of the noise
from where it lay."""


@dataclass(frozen=True)
class JointSmoothFields:
    """The method by which several objects are learned together.

    Attributes:
        noise: standard deviations of the poses about their predictions, m, m and rad.
        amplitudes: standard deviations of log k of the smooth fields that are tried, increasing.

    Raises:
        IdentificationError: a number is not positive.
    """

    noise: tuple[float, float, float] = NOISE
    amplitudes: tuple[float, ...] = AMPLITUDES

    def __post_init__(self) -> None:
        for name, values in (("noise", self.noise), ("amplitudes", self.amplitudes)):
            if not (len(values) and np.isfinite(values).all() and min(values) > 0):
                raise IdentificationError(f"{name} is {tuple(values)!r}; expected positive numbers")

    @property
    def name(self) -> str:
        """Name of the method."""
        return METHOD

    @property
    def abilities(self) -> Abilities:
        """It learns several objects, and descends exact gradients."""
        return Abilities(needs_gradients=True, takes_several=True)

    def learn(self, task: LearningTask) -> Found:
        """Learns the objects of a task together; see `LearningMethod`.

        What they begin from changes the result only where there are several minima.

        Raises:
            IdentificationError: learning is to begin from other objects.
        """
        log = task.screened.log
        problem = JointProblem(task.model, log, np.asarray(self.noise))
        begin = problem.z0
        if task.starts:
            begin = task.starts[0].z
        if begin.shape != problem.z0.shape:
            raise IdentificationError(
                f"start: has {len(begin)} unknowns; expected {len(problem.z0)}, those of the same "
                "objects"
            )

        fits = _fit_all(problem, self.amplitudes, begin)
        if task.starts and max(fits[-1].push_scales) > UNEXPLAINED:
            # What was learned before may be a minimum from which no step leads to a better one.
            others = _fit_all(problem, self.amplitudes, problem.z0)
            if others[-1].evidence > fits[-1].evidence:
                fits = others
        evidence = np.array([fit.evidence for fit in fits])
        chosen = int(np.argmax(evidence - AMPLITUDE_EXPONENT * np.log(self.amplitudes)))
        best = fits[chosen]
        learned = problem.make_model(best.z)
        model = JointIdentification(
            objects=learned.objects,
            parameters=learned.parameters,
            physics=task.model.physics,
            pair_friction=learned.pair_friction,
            z=best.z,
            covariance=best.covariance,
            prior_covariance=best.prior_covariance,
            amplitude=float(self.amplitudes[chosen]),
            evidence=evidence,
            noise=self.noise,
            noise_scale=best.noise_scale,
            push_scales=best.push_scales,
            simulations=problem.simulations,
            push_names=tuple(seen.name for seen in log),
            moved=_find_moved(log, self.noise),
            errors_before=calc_end_errors(problem.make_model(problem.z0), log),
            errors=calc_end_errors(learned, log),
        )
        return Found(model, task.screened)


def calc_end_errors(bodies: Bodies, pushes: Iterable[ObservedPush]) -> Array:
    """Calculates how far several objects end from where they were seen last.

    Args:
        bodies: the objects, with what is believed of them.
        pushes: P pushes of them.

    Returns:
        (P, N) mean distance of each object's cells, m.
    """
    errors = []
    for seen in pushes:
        times = make_times_with(seen.push, seen.t_observed[-1:], "quasi_static")
        last = int(np.searchsorted(times, seen.t_observed[-1]))
        poses = simulate_together(bodies, seen.push, seen.pose, times=times).poses[last]
        errors.append(calc_cell_errors(bodies.objects, poses, seen.final_pose))
    return np.array(errors)


def _find_moved(log: PushLog, noise: tuple[float, float, float]) -> NDArray[np.bool_]:
    """Tells which objects a push moved by more than the noise, (N,)."""
    moved = np.zeros(len(log.names), dtype=bool)
    for seen in log:
        off = seen.final_pose - seen.pose
        off[:, 2] = np.arctan2(np.sin(off[:, 2]), np.cos(off[:, 2]))
        moved |= (np.abs(off) > MOVED * np.asarray(noise)).any(axis=1)
    return moved


@dataclass(frozen=True, eq=False)
class _Fit:
    """The best z of one amplitude, and what `JointIdentification` says of it."""

    z: Array
    covariance: Array
    prior_covariance: Array
    evidence: float
    noise_scale: float
    push_scales: Array


def _fit_all(problem: JointProblem, amplitudes: Sequence[float], z: Array) -> list[_Fit]:
    """Fits every amplitude, coarse to fine, each from where the last one ended."""
    smooth = [calc_smooth_covariance(obj) for obj in problem.objects]
    others = len(problem.z0) - sum(obj.n for obj in problem.objects)
    fits = []
    for amplitude in amplitudes:
        # z = z_0 + L v with v ~ N(0, I)
        cells = [np.linalg.cholesky(amplitude**2 * C + TOTAL_STD**2) for C in smooth]
        L = block_diag(*cells, FRICTION_STD * np.eye(others))
        v = np.linalg.solve(L, z - problem.z0)
        fit = _describe_fit(problem, L, fit_robustly(problem.linearize, problem.z0, L, v))
        fits.append(fit)
        z = fit.z
    return fits


def _describe_fit(problem: JointProblem, L: Array, found: RobustFit) -> _Fit:
    """Calculates posterior and evidence of a minimum."""
    identity = np.eye(len(found.v))
    # the evidence by Laplace's approximation, and the posterior, with the noise that was found
    log_determinant = float(np.linalg.slogdet(found.curvature + identity)[1])
    noise = max(found.noise_scale, 1.0) ** 2
    squares = np.mean(found.residuals**2, axis=1)
    pushes = problem.push_of_block
    return _Fit(
        z=problem.z0 + L @ found.v,
        covariance=L @ np.linalg.inv(found.curvature / noise + identity) @ L.T,
        prior_covariance=L @ L.T,
        evidence=-found.loss - 0.5 * log_determinant,
        noise_scale=found.noise_scale,
        push_scales=np.sqrt(np.bincount(pushes, squares) / np.bincount(pushes)),
    )
