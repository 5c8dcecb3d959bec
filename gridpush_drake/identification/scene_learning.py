"""`identify_scene`: the maps of several objects, and their friction, learned together.

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
Two objects that never pushed each other cannot be compared, either; `SceneIdentification` says so.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from gridpush_drake.dynamics.physics import QUASI_STATIC, Physics
from gridpush_drake.dynamics.push import make_times_with
from gridpush_drake.dynamics.scene.bodies import DEFAULT_PAIR_FRICTION, Scene
from gridpush_drake.dynamics.scene.simulation import simulate_scene
from gridpush_drake.errors import IdentificationError
from gridpush_drake.geometry.se2 import Array, IntArray
from gridpush_drake.identification.hypotheses import WEAKNESS
from gridpush_drake.identification.load_prior import calc_smooth_covariance
from gridpush_drake.identification.prediction import calc_pose_error
from gridpush_drake.identification.robust_least_squares import RobustFit, fit_robustly
from gridpush_drake.identification.scene_problem import SceneProblem
from gridpush_drake.objects.grid_object import GridObject
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

UNEXPLAINED = 4.0
"""Root mean square of a push's residuals, in units of the noise, beyond which the model does not
explain the push."""

TOLD = 0.8
"""Share of the standard deviation beforehand that is left of what pushes did tell, at most."""


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
        noise_scale: root mean square of the residuals, in units of that noise, in which poses that
            the model cannot explain count for little.
        push_scales: (P,) root mean square of each push's residuals, in units of that noise.
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
    push_scales: Array
    simulations: int
    push_names: tuple[str, ...]
    moved: NDArray[np.bool_]
    errors_before: Array
    errors: Array
    physics: Physics

    @property
    def unexplained(self) -> tuple[str, ...]:
        """Names of the pushes that the model does not explain: what was learned hangs on others.

        A pose may have jumped, somebody may have moved an object, or the fit found no loads with
        which an object is hit, or missed, as it was.
        """
        far = self.push_scales > UNEXPLAINED
        return tuple(name for name, off in zip(self.push_names, far, strict=True) if off)

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
        for b in (body, other):
            params = self.scene.params[b]
            loads.append(float(params.mass @ params.friction))
        return float(np.log(loads[0] / loads[1])), self._calc_ratio_std(
            body, other, self.covariance
        )

    def tells_load_ratio(self, body: int, other: int) -> bool:
        """Says whether the pushes told how heavy one object is beside another.

        They do not where none moved both, or a third one that both moved in other pushes.
        """
        before = self._calc_ratio_std(body, other, self.prior_covariance)
        return self._calc_ratio_std(body, other, self.covariance) < TOLD * before

    def tells_pair_friction(self) -> NDArray[np.bool_]:
        """Says of which pairs (P,) the pushes told the friction on each other."""
        pairs = len(self.scene) * (len(self.scene) - 1) // 2
        before = np.sqrt(np.diag(self.prior_covariance)[len(self.z) - pairs :])
        return np.asarray(self.calc_pair_friction_std() < TOLD * before)

    def calc_pair_friction_std(self) -> Array:
        """Calculates the posterior standard deviations (P,) of the logarithms of pair frictions."""
        pairs = len(self.scene) * (len(self.scene) - 1) // 2
        variances = np.diag(self.covariance)
        return np.sqrt(variances[len(variances) - pairs :])

    def _calc_ratio_std(self, body: int, other: int, covariance: Array) -> float:
        """Calculates the standard deviation of the logarithm of two objects' ratio of loads."""
        J = np.zeros(len(covariance))
        for b, sign in ((body, 1.0), (other, -1.0)):
            J[self._cells(b)] += sign * self.scene.params[b].relative_friction()
        return float(np.sqrt(J @ covariance @ J))

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
    start: SceneIdentification | None = None,
) -> SceneIdentification:
    """Learns the objects of a log together.

    Args:
        objects: the N objects, in the order of the log's.
        log: their pushes.
        pair_friction: friction of two objects against each other that is expected beforehand.
        noise: standard deviations of the poses about their predictions, m, m and rad.
        amplitudes: standard deviations of log k of the smooth fields that are tried, increasing.
        physics: spin, gravity and tolerances.
        start: what was learned of the same objects from fewer pushes, to begin from; None to begin
            from even objects. The result depends on it only where there are several minima.

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
    given = (("noise", noise), ("amplitudes", amplitudes), ("pair_friction", (pair_friction,)))
    for name, values in given:
        if not (len(values) and np.isfinite(values).all() and min(values) > 0):
            raise IdentificationError(f"{name} is {tuple(values)!r}; expected positive numbers")
    problem = SceneProblem(objects, log, pair_friction, np.asarray(noise), physics)
    if start is not None and start.z.shape != problem.z0.shape:
        raise IdentificationError(
            f"start: has {len(start.z)} unknowns; expected {len(problem.z0)}, those of the same "
            "objects"
        )

    fits = _fit_all(problem, amplitudes, problem.z0 if start is None else start.z)
    if start is not None and max(fits[-1].push_scales) > UNEXPLAINED:
        # What was learned before may be a minimum from which no step leads to a better one.
        others = _fit_all(problem, amplitudes, problem.z0)
        if others[-1].evidence > fits[-1].evidence:
            fits = others
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
        push_scales=best.push_scales,
        simulations=problem.simulations,
        push_names=tuple(seen.name for seen in log),
        moved=_find_moved(log, noise),
        errors_before=calc_scene_errors(problem.make_scene(problem.z0, log[0].poses), log, physics),
        errors=calc_scene_errors(scene, log, physics),
        physics=physics,
    )


def find_pusher_radius(objects: Iterable[GridObject], radius: float | None = None) -> float:
    """Finds the pusher's radius in objects' files, m; the shipped finger's where none has it.

    Args:
        objects: the objects.
        radius: as given, m, which goes before the files; None where it is not.

    Raises:
        IdentificationError: they name different ones.
    """
    if radius is not None:
        return radius
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
    """The best z of one amplitude, and what `SceneIdentification` says of it."""

    z: Array
    covariance: Array
    prior_covariance: Array
    evidence: float
    noise_scale: float
    push_scales: Array


def _fit_all(problem: SceneProblem, amplitudes: Sequence[float], z: Array) -> list[_Fit]:
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


def _describe_fit(problem: SceneProblem, L: Array, found: RobustFit) -> _Fit:
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
