"""`identify_scene`: the maps of several objects, and their friction, learned together.

Pushes in which one object pushes another tell of both: how the pushed one answers, and by how much
it holds the other back. So all are learned in one: with z = (log k of every object's cells; log of
the frictions with the pusher; log of the pairs' frictions) and the residuals r(z) of all poses that
were seen, divided by their noise,

    min over z of  |r(z)|²/2 + (z - z_0)^T P^-1 (z - z_0)/2

by the least squares of `prior_fit`, with the exact derivatives of `simulate_scene`. The prior of
an object's log k is a smooth field of amplitude a (`hypotheses.calc_smooth_covariance`) and one
number more for the object as a whole: how heavy it is beside the others. Several amplitudes are
fitted, coarse to fine, and the one of greatest evidence, by Laplace's approximation, is taken.

What pushes cannot tell: a factor that all k have in common, for slow pushes only weigh the objects
against each other; and masses by themselves, as for one object (`docs/theory/model.md`, section 7).
The masses that are given stand for k_i = mu_i m_i g with the friction that the object's file names.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from gridpush_drake.dynamics.physics import QUASI_STATIC, Physics
from gridpush_drake.dynamics.push import make_times_with
from gridpush_drake.dynamics.scene.bodies import DEFAULT_PAIR_FRICTION, Scene, SceneBody
from gridpush_drake.dynamics.scene.motion import SceneJacobian, SceneMotion
from gridpush_drake.dynamics.scene.simulation import simulate_scene
from gridpush_drake.errors import IdentificationError
from gridpush_drake.geometry.se2 import Array, IntArray
from gridpush_drake.identification.hypotheses import WEAKNESS
from gridpush_drake.identification.load_prior import calc_smooth_covariance
from gridpush_drake.identification.prediction import calc_pose_error
from gridpush_drake.identification.prior_fit import fit_with_prior
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.pushes.push_log import DEFAULT_PUSHER_RADIUS
from gridpush_drake.pushes.scene_log import ObservedScenePush, SceneLog

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

LIMITS = {"xtol": 1e-4, "ftol": 1e-4, "gtol": 1e-6, "max_nfev": 25}
"""At which changes of unknowns and loss, at which slope and after how many evaluations a fit
ends."""


@dataclass(frozen=True, eq=False)
class SceneIdentification:
    """What was learned of several objects.

    Attributes:
        scene: the objects, with the parameters and pair frictions that fit best.
        z: (Z,) the unknowns that fit best, see the module's description.
        covariance: (Z, Z) posterior covariance of z.
        prior_covariance: (Z, Z) covariance of z before the pushes.
        amplitude: standard deviation of log k of the smooth fields that were taken.
        evidence: logarithm of the evidence of each of `AMPLITUDES`.
        noise: standard deviations of poses that were assumed, m, m and rad.
        noise_scale: root mean square of the residuals, in units of that noise.
        simulations: number of pushes that were simulated.
        push_names: names of the pushes.
        moved: (N,) whether a push moved the object by more than the noise.
        errors_before: (P, N) cell errors at the ends of the pushes with even objects, m.
        errors: (P, N) those with what was learned, m.
        physics: physics of the simulations.
    """

    scene: Scene
    z: Array
    covariance: Array
    prior_covariance: Array
    amplitude: float
    evidence: Array
    noise: tuple[float, float, float]
    noise_scale: float
    simulations: int
    push_names: tuple[str, ...]
    moved: NDArray[np.bool_]
    errors_before: Array
    errors: Array
    physics: Physics

    def list_unknowns(self, body: int) -> IntArray:
        """Lists the places in z of an object's cells, and of its friction with the pusher."""
        cells = sum(obj.n for obj in self.scene.objects)
        return np.append(self._cells(body), cells + body)

    def calc_center(self, body: int) -> tuple[Array, Array]:
        """Calculates where an object's load is centered.

        Args:
            body: number of the object.

        Returns:
            The center of friction (2,), body frame, m, and its posterior covariance (2, 2), m².
        """
        obj = self.scene.objects[body]
        params = self.scene.params[body]
        share = params.relative_friction()
        center = share @ obj.p_BC
        # dc = sum of share_i (p_i - c) dlog k_i
        J = (share[:, None] * (obj.p_BC - center)).T
        cells = self._cells(body)
        return center, J @ self.covariance[np.ix_(cells, cells)] @ J.T

    def calc_load_ratio(self, body: int, other: int) -> tuple[float, float]:
        """Calculates how heavy one object is beside another, with the friction of both.

        Args:
            body: number of the object.
            other: number of the other one.

        Returns:
            The logarithm of the ratio of their whole friction with the table, and its posterior
            standard deviation.
        """
        loads = []
        J = np.zeros(len(self.covariance))
        for b, sign in ((body, 1.0), (other, -1.0)):
            params = self.scene.params[b]
            loads.append(float(params.mass @ params.friction))
            J[self._cells(b)] += sign * params.relative_friction()
        ratio = float(np.log(loads[0] / loads[1]))
        return ratio, float(np.sqrt(J @ self.covariance @ J))

    def calc_pair_friction_std(self) -> Array:
        """Calculates the posterior standard deviations (P,) of the logarithms of pair frictions."""
        pairs = len(self.scene) * (len(self.scene) - 1) // 2
        variances = np.diag(self.covariance)
        return np.sqrt(variances[len(variances) - pairs :])

    def _cells(self, body: int) -> IntArray:
        """The places in z of an object's cells."""
        first = sum(obj.n for obj in self.scene.objects[:body])
        return np.arange(first, first + self.scene.objects[body].n)


def identify_scene(
    objects: Sequence[GridObject],
    log: SceneLog,
    *,
    pair_friction: float = DEFAULT_PAIR_FRICTION,
    noise: tuple[float, float, float] = NOISE,
    amplitudes: Sequence[float] = AMPLITUDES,
    physics: Physics = QUASI_STATIC,
) -> SceneIdentification:
    """Learns the objects of a log together.

    Args:
        objects: the N objects, in the order of the log's.
        log: their pushes.
        pair_friction: friction of two objects against each other that is expected beforehand.
        noise: standard deviations of the poses about their predictions, m, m and rad.
        amplitudes: standard deviations of log k of the smooth fields that are tried, increasing.
        physics: spin, gravity and tolerances.

    Returns:
        What was learned.

    Raises:
        IdentificationError: the log is empty or has another number of objects, or a number is not
            positive.
    """
    if len(log) == 0:
        raise IdentificationError("scene log: holds no push; expected at least one")
    if log.names and len(log.names) != len(objects):
        raise IdentificationError(
            f"scene log of {len(log.names)} objects ({', '.join(log.names)}); expected "
            f"{len(objects)}: {', '.join(obj.name for obj in objects)}"
        )
    for name, values in (("noise", noise), ("amplitudes", amplitudes)):
        if not (len(values) and np.isfinite(values).all() and min(values) > 0):
            raise IdentificationError(f"{name} is {tuple(values)!r}; expected positive numbers")
    problem = _SceneProblem(objects, log, pair_friction, np.asarray(noise), physics)

    # Coarse to fine, each from where the last one ended.
    fits = []
    z = problem.z0
    for amplitude in amplitudes:
        fit = problem.fit(amplitude, z)
        z = fit.z
        fits.append(fit)
    evidence = np.array([fit.evidence for fit in fits])
    weighted = evidence - WEAKNESS * np.log(amplitudes)
    best = fits[int(np.argmax(weighted))]
    scene = problem.make_scene(best.z, log[0].poses)
    return SceneIdentification(
        scene=scene,
        z=best.z,
        covariance=best.covariance,
        prior_covariance=best.prior_covariance,
        amplitude=float(amplitudes[int(np.argmax(weighted))]),
        evidence=evidence,
        noise=noise,
        noise_scale=best.noise_scale,
        simulations=problem.simulations,
        push_names=tuple(seen.name for seen in log),
        moved=_find_moved(log, noise),
        errors_before=calc_scene_errors(problem.make_scene(problem.z0, log[0].poses), log, physics),
        errors=calc_scene_errors(scene, log, physics),
        physics=physics,
    )


def find_pusher_radius(objects: Iterable[GridObject]) -> float:
    """Finds the pusher's radius in objects' files, m; the shipped finger's where none has it.

    Raises:
        IdentificationError: they name different ones.
    """
    radii = [obj.prior.pusher_radius for obj in objects]
    known = {radius for radius in radii if radius is not None}
    if len(known) > 1:
        listed = ", ".join(f"{radius:g} m" for radius in sorted(known))
        raise IdentificationError(
            f"the objects' files name pushers of different radii, {listed}; expected one pusher"
        )
    return known.pop() if known else DEFAULT_PUSHER_RADIUS


def calc_scene_errors(
    scene: Scene, pushes: Iterable[ObservedScenePush], physics: Physics = QUASI_STATIC
) -> Array:
    """Calculates how far objects end from where they were seen last.

    Args:
        scene: the objects, with what is believed of them.
        pushes: P pushes of them.
        physics: spin, gravity and tolerances.

    Returns:
        (P, N) mean distance of each object's cells, m.
    """
    errors = []
    for seen in pushes:
        start = scene.with_poses(seen.poses, may_overlap=True)
        times = make_times_with(seen.push, seen.t_observed[-1:], "quasi_static")
        last = int(np.searchsorted(times, seen.t_observed[-1]))
        poses = simulate_scene(start, seen.push, physics=physics, times=times).poses[last]
        each = zip(scene.objects, poses, seen.poses_observed[-1], strict=True)
        errors.append([calc_pose_error(obj, mine, theirs).cell for obj, mine, theirs in each])
    return np.array(errors)


def _find_moved(log: SceneLog, noise: tuple[float, float, float]) -> NDArray[np.bool_]:
    """Tells which objects a push moved by more than the noise, (N,)."""
    moved = np.zeros(len(log.names), dtype=bool)
    for seen in log:
        off = seen.poses_observed[-1] - seen.poses
        off[:, 2] = np.arctan2(np.sin(off[:, 2]), np.cos(off[:, 2]))
        moved |= (np.abs(off) > MOVED * np.asarray(noise)).any(axis=1)
    return moved


@dataclass(frozen=True, eq=False)
class _Fit:
    """The best z of one amplitude, its covariances after and before, and its evidence."""

    z: Array
    covariance: Array
    prior_covariance: Array
    evidence: float
    noise_scale: float


class _SceneProblem:
    """The residuals of a log as a function of z, and their derivatives."""

    def __init__(
        self,
        objects: Sequence[GridObject],
        log: SceneLog,
        pair_friction: float,
        noise: Array,
        physics: Physics,
    ) -> None:
        self.objects = tuple(objects)
        self.log = log
        self.noise = noise
        self.physics = physics
        self.simulations = 0
        self.even = [CellParameters.uniform(obj) for obj in objects]
        n = len(objects)
        self.pairs = np.triu_indices(n, 1)
        k = [np.log(each.mass * each.friction) for each in self.even]
        finger = np.log([each.contact_friction for each in self.even])
        self.z0 = np.concatenate([*k, finger, np.full(len(self.pairs[0]), np.log(pair_friction))])
        self._smooth = [calc_smooth_covariance(obj) for obj in objects]

    def make_params(self, z: Array) -> tuple[list[CellParameters], Array]:
        """Makes the parameters and the pair frictions (N, N) of z."""
        sizes = [obj.n for obj in self.objects]
        n = len(sizes)
        *logs, finger, pair = np.split(z, np.cumsum([*sizes, n]))
        params = [
            CellParameters(np.exp(log) / even.friction, even.friction, float(np.exp(mu)))
            for log, even, mu in zip(logs, self.even, finger, strict=True)
        ]
        friction = np.zeros((n, n))
        friction[self.pairs] = np.exp(pair)
        return params, friction + friction.T

    def make_scene(self, z: Array, poses: Array) -> Scene:
        """Makes the scene of z at poses (N, 3), m and rad."""
        params, friction = self.make_params(z)
        bodies = [
            SceneBody(obj, each, pose)
            for obj, each, pose in zip(self.objects, params, poses, strict=True)
        ]
        return Scene(bodies, friction, may_overlap=True)

    def linearize(self, z: Array) -> tuple[Array, Array]:
        """Calculates the residuals (R,), in units of the noise, and their derivatives by z."""
        residuals = []
        derivatives = []
        for seen in self.log:
            motion, rows = self._simulate(z, seen, gradients=True)
            residuals.append(self._calc_residual(motion, rows, seen))
            derivatives.append(self._chain(z, motion.jacobian) / self.noise[:, None])
        J = np.concatenate([each.reshape(-1, len(z)) for each in derivatives])
        return np.concatenate(residuals), J

    def calc_residuals(self, z: Array) -> Array:
        """Calculates the residuals (R,) alone."""
        parts = []
        for seen in self.log:
            motion, rows = self._simulate(z, seen, gradients=False)
            parts.append(self._calc_residual(motion, rows, seen))
        return np.concatenate(parts)

    def fit(self, amplitude: float, z: Array) -> _Fit:
        """Finds the best z of one amplitude, from a start."""
        # z = z_0 + L v with v ~ N(0, 1)
        cells = [np.linalg.cholesky(amplitude**2 * C + TOTAL_STD**2) for C in self._smooth]
        others = len(self.z0) - sum(obj.n for obj in self.objects)
        L = block_diag(*cells, FRICTION_STD * np.eye(others))
        start = np.linalg.solve(L, z - self.z0)
        objective, v = fit_with_prior(
            self.calc_residuals, lambda z: self.linearize(z)[1], self.z0, L, start, LIMITS
        )
        r, J = self.linearize(self.z0 + L @ v)
        A = J @ L
        curvature = A.T @ A + np.eye(len(v))
        # the evidence by Laplace's approximation, and the posterior, with the noise that was found
        evidence = -objective - 0.5 * float(np.linalg.slogdet(curvature)[1])
        scale = float(np.sqrt(r @ r / len(r)))
        covariance = L @ np.linalg.inv(A.T @ A / max(scale, 1.0) ** 2 + np.eye(len(v))) @ L.T
        return _Fit(
            z=self.z0 + L @ v,
            covariance=covariance,
            prior_covariance=L @ L.T,
            evidence=float(evidence),
            noise_scale=scale,
        )

    def _simulate(
        self, z: Array, seen: ObservedScenePush, gradients: bool
    ) -> tuple[SceneMotion, IntArray]:
        """Simulates a push from where it was seen to begin, and finds the rows that were seen."""
        self.simulations += 1
        times = make_times_with(seen.push, seen.t_observed, "quasi_static")
        rows = np.searchsorted(times, seen.t_observed)
        motion = simulate_scene(
            self.make_scene(z, seen.poses),
            seen.push,
            gradients=gradients,
            physics=self.physics,
            times=times,
            record=rows,
        )
        return motion, rows

    def _calc_residual(self, motion: SceneMotion, rows: IntArray, seen: ObservedScenePush) -> Array:
        """Calculates a push's residuals, in units of the noise."""
        off = motion.poses[rows] - seen.poses_observed
        off[..., 2] = np.arctan2(np.sin(off[..., 2]), np.cos(off[..., 2]))
        return np.asarray((off / self.noise).ravel())

    def _chain(self, z: Array, jacobian: SceneJacobian) -> Array:
        """Makes the derivatives (K, N, 3, Z) of the poses by z."""
        params, friction = self.make_params(z)
        by_k = [block * each.mass for block, each in zip(jacobian.mass, params, strict=True)]
        finger = jacobian.contact_friction * np.array([each.contact_friction for each in params])
        i, j = self.pairs
        pair = jacobian.pair_friction[..., i, j] * friction[i, j]
        return np.concatenate([*by_k, finger, pair], axis=-1)
