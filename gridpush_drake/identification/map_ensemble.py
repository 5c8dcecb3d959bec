"""The default identifier: several ideas of how the object bears on the table, weighed by evidence.

For each amplitude of the smoothness prior, weakest variation first, z is fitted by Gauss-Newton
(`map_fit`), each fit starting where the last one ended: coarse to fine. Where the best of them
leaves much unexplained it may be a poor optimum; then fits begin with loads that are tilted to all
sides. One more is of a rigid bottom that rests on the outline's corners, and the last are of
objects of two parts, by the cuts that explain the pushes best (`load_priors`). By their evidence
and a prior weight a^-0.65 the shares of friction that they give are averaged, x = sum_a w_a x_a
(`docs/theory/identification.md`, section 5).
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from scipy.special import logsumexp, softmax

from gridpush_drake.errors import IdentificationError
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.load_priors import (
    CENTER_STD,
    RANGE_CELLS,
    LoadPrior,
    calc_prior_factor,
    calc_smooth_covariance,
    choose_parts,
    make_bottom,
    make_field,
)
from gridpush_drake.identification.map_fit import CenterOfMass, MapFit, fit_map, solve_factor
from gridpush_drake.identification.noise import POSE, NoiseModel, NoiseScale
from gridpush_drake.identification.posterior import CELLS, calc_share
from gridpush_drake.identification.problem import Linearization, PushProblem
from gridpush_drake.identification.result import FitStart, HistoryEntry, IdentificationStatus
from gridpush_drake.objects.grid_object import GridObject

FIRST_EVALUATIONS = 6
"""Of the pushes by each fit, before all have begun; only those that may count for something are
then gone on with."""

HOPELESS = 30.0
"""Of log evidence below the best: more than a fit gains once it has begun to settle, and than
leaves it any weight."""

STUCK = 1.0
"""Scale of the noise at the best field beyond which it may be a poor optimum."""

FAR = 10.0
"""Standard deviations of a pose, as the noise is found to be, beyond which a push that ends so far
off tells of a poor optimum: it is explained away by being sensitive to where it began."""

TILT_DIRECTIONS, TILT_SIZES = 8, (1.0, 2.5)
"""Of tilted loads that fits then begin with; the sizes are of log k, at the object's radius of
gyration."""

TILTED_FITS, TILTED_AMPLITUDE = 3, 1.5
"""How many of them, those that predict best, are fitted; and the amplitude, the nearest of those
there are."""

SHARED_SHIFT = 0.3
"""Of the load's shift from push to push, how much all pushes may share, so that no number of them
averages it out."""

CAUTION = 2.0
"""How much larger than the pushes show it the noise is taken for, where it says how sure the
parameters are."""

NEGLIGIBLE = 1e-3
"""Of the evidence, below which a fit does not come to count for the spread."""

TILT_RIDGE = 0.01
"""Keeps the tilt finite where a corner's place is beyond all cells' centers; it takes off that much
of the shift."""

TILT_STEPS, MAX_TILT_STEP = 20, 1.0
"""Newton's, and the longest, of any cell's log k."""

FITTING = "fitting"
"""Word for the only stage of a fit."""


@dataclass(frozen=True, eq=False)
class MapEnsembleFit:
    """What the default identifier found.

    Attributes:
        z: (n+1,) log k and log mu_c.
        covariance: (n+1, n+1) of z, over all fits.
        prior_covariance: (n+1, n+1) of z before the pushes, averaged in the same way.
        noise_std: standard deviation of what stays unexplained, per coordinate of the residual, m.
        load_shift_std: of the load's center per axis from push to push, m.
        status: how it ended.
        message: the status in a sentence.
        starts: where each fit ended.
        best: the most probable fit; None where there was nothing to fit.
        interval_scale: of predicted intervals, see `Identification`.
    """

    z: Array
    covariance: Array
    prior_covariance: Array
    noise_std: float
    load_shift_std: float
    status: IdentificationStatus
    message: str
    starts: tuple[FitStart, ...] = ()
    best: MapFit | None = None
    interval_scale: float = 1.0


@dataclass(frozen=True)
class MapEnsemble:
    """The default identifier, and what it takes for granted.

    Attributes:
        amplitudes: standard deviations of log k under each smoothness prior, increasing; the first
            stands for uniform.
        range_cells: correlation range of the prior, cells.
        noise: the noise model.
        patch_ratio: on what part of its side a cell bears its load, see `CellParameters`; None for
            n^(-1/2): a rigid body stands on points, but the only cell of an object is all of it.
    """

    amplitudes: tuple[float, ...] = (0.05, 0.3, 0.7, 1.5, 3.0, 6.0)
    range_cells: float = RANGE_CELLS
    noise: NoiseModel = field(default_factory=NoiseModel)
    patch_ratio: float | None = None

    def __post_init__(self) -> None:
        """Raises IdentificationError: the amplitudes are not positive and increasing, or there are none."""
        steps = np.diff((0.0, *self.amplitudes))
        if not (len(self.amplitudes) and (steps > 0).all() and np.isfinite(self.amplitudes[-1])):
            raise IdentificationError(
                f"amplitudes: {self.amplitudes}; expected positive finite numbers that increase"
            )

    def choose_patch_ratio(self, obj: GridObject) -> float:
        """On what part of its side a cell of the object bears its load."""
        return float(obj.n**-0.5) if self.patch_ratio is None else self.patch_ratio

    @property
    def count(self) -> int:
        """How many fits there are before those of two parts."""
        return len(self.amplitudes) + 1

    def fit(
        self,
        problem: PushProblem,
        z0: Array,
        log_contact_friction_std: float,
        center_of_mass: CenterOfMass | None,
        on_step: Callable[[Array, Linearization], None],
        starts: tuple[FitStart, ...] = (),
    ) -> MapEnsembleFit:
        """Fits every amplitude, the rigid bottom and objects of two parts, and averages.

        Args:
            problem: the training pushes; at least one.
            z0: (n+1,) prior mean of z.
            log_contact_friction_std: prior standard deviation of log mu_c.
            center_of_mass: prior knowledge; None stands for CENTER_STD about the cells' centroid.
            on_step: called with z and the pushes' residuals and derivatives there after every step.
            starts: of fits to fewer pushes; each of the first `count` fits begins there or where
                the last amplitude's ended, whichever is more probable.

        Returns:
            The fit.
        """
        center_of_mass = center_of_mass or _hold_center(problem.obj)
        C = calc_smooth_covariance(problem.obj, self.range_cells)
        priors = self._make_priors(problem.obj, z0, C, log_contact_friction_std)
        fit_one = partial(fit_map, noise=self.noise, center_of_mass=center_of_mass, on_step=on_step)
        fits: list[MapFit] = []
        for i, prior in enumerate(priors):
            smooth = prior.p_BC is problem.obj.p_BC
            last = fits[-1] if fits and smooth else None
            begin = (
                None
                if last is None
                else FitStart(last.z, NoiseScale(*np.minimum(last.scale, 1.0).tolist()))
            )
            fits.append(
                fit_one(
                    problem if smooth else problem.move_cells(prior.p_BC), prior.mean, prior.factor,
                    start=begin, linear=None if last is None else last.linear,
                    warm_start=starts[i] if starts else None, max_evaluations=FIRST_EVALUATIONS,
                )
            )  # fmt: skip
        self._begin_with_tilts(priors, fits, fit_one)
        self._follow_best(priors, fits, fit_one)
        best = fits[self._find_best(fits)]
        residuals, J = best.system.linearize_at_prior()
        known = len(center_of_mass.at)
        for prior, z in choose_parts(
            problem.obj, z0, C, log_contact_friction_std, residuals, J, known
        ):
            priors.append(prior)
            fits.append(
                fit_one(
                    problem, prior.mean, prior.factor, start=FitStart(best.z, best.scale), linear=best.linear,
                    warm_start=FitStart(z, best.scale), max_evaluations=FIRST_EVALUATIONS,
                )
            )  # fmt: skip
        best_evidence = max(fit.log_evidence for fit in fits)
        for i, (fit, prior) in enumerate(zip(fits, priors, strict=True)):
            if not fit.settled and fit.log_evidence > best_evidence - HOPELESS:
                start = FitStart(fit.z, fit.scale)
                fits[i] = fit_one(
                    fit.system.problem, prior.mean, prior.factor, start=start, linear=fit.linear
                )
        return self._average(problem, priors, fits)

    def fit_field(
        self,
        problem: PushProblem,
        z0: Array,
        log_contact_friction_std: float,
        center_of_mass: CenterOfMass | None,
    ) -> MapFit:
        """Fits the smooth field of the middle amplitude alone, with the arguments of `fit`."""
        amplitude, C = (
            self.amplitudes[self._middle],
            calc_smooth_covariance(problem.obj, self.range_cells),
        )
        A = calc_prior_factor(C, amplitude, log_contact_friction_std)
        return fit_map(problem, z0, A, self.noise, center_of_mass or _hold_center(problem.obj))

    def _begin_with_tilts(
        self, priors: list[LoadPrior], fits: list[MapFit], fit_one: Callable[..., MapFit]
    ) -> None:
        """Fits anew from tilted loads where the best field is poor.

        It leaves much unexplained, or a push ends far off, or its neighbors are much worse.
        """
        best = self._find_best(fits)
        beside = max(
            (fits[i].log_evidence for i in self._fields if abs(i - best) == 1), default=np.inf
        )
        scale, farthest = (
            fits[best].scale.pose,
            max(np.linalg.norm(r[-POSE:]) for r in fits[best].linear.residuals),
        )
        explains = scale < STUCK and farthest < FAR * scale * self.noise.pose
        if explains and beside > fits[best].log_evidence - HOPELESS:
            return
        middle = self._middle
        prior, problem = priors[middle], fits[middle].system.problem
        tilted = tilt_loads(problem.obj, prior.mean)
        errors = [problem.calc_cell_errors(problem.residuals(z)).mean() for z in tilted]
        for i in np.argsort(errors, kind="stable")[:TILTED_FITS]:
            fit = fit_one(
                problem, prior.mean, prior.factor, start=FitStart(tilted[i], NoiseScale())
            )
            fits[middle] = max(fits[middle], fit, key=lambda fit: fit.log_evidence)

    def _follow_best(
        self, priors: list[LoadPrior], fits: list[MapFit], fit_one: Callable[..., MapFit]
    ) -> None:
        """Fits the other fields anew from where their neighbor ended, where that is better than where they are."""
        best = self._find_best(fits)
        for i in [*reversed(self._fields[:best]), *self._fields[best + 1 :]]:
            near, own, prior = fits[i + 1 if i < best else i - 1], fits[i].system, priors[i]
            if fits[i].log_evidence > near.log_evidence - HOPELESS:
                continue
            there = own.move(solve_factor(prior.factor, near.z - prior.mean), near.linear).rescale(
                near.scale
            )
            if there.objective() < own.objective():
                fits[i] = fit_one(
                    own.problem, prior.mean, prior.factor, start=FitStart(near.z, near.scale), linear=near.linear,
                    max_evaluations=FIRST_EVALUATIONS,
                )  # fmt: skip

    @property
    def _middle(self) -> int:
        """The field whose amplitude is the nearest to TILTED_AMPLITUDE."""
        return int(np.argmin(np.abs(np.log(np.array(self.amplitudes) / TILTED_AMPLITUDE))))

    @property
    def _fields(self) -> range:
        return range(len(self.amplitudes))

    def _find_best(self, fits: list[MapFit]) -> int:
        """Of the fields, the most probable one."""
        return max(self._fields, key=lambda i: fits[i].log_evidence)

    def _average(
        self, problem: PushProblem, priors: list[LoadPrior], fits: list[MapFit]
    ) -> MapEnsembleFit:
        """Averages the fits; the spread is the mixture's, and what the pushes say of each other is in it."""
        evidences = np.array(
            [
                fit.log_evidence + np.log(prior.share)
                for prior, fit in zip(priors, fits, strict=True)
            ]
        )
        leaning = evidences + np.log([prior.weight for prior in priors])
        plausible, weights = softmax(evidences), softmax(leaning)
        bottom = self.count - 1
        fields = np.delete(np.arange(len(fits)), bottom)
        z_field = _average_shares(softmax(leaning[fields]), [fits[i].z for i in fields])
        z_bottom = _move_center(problem.obj.p_BC, fits[bottom].z, priors[bottom].p_BC)
        z = _average_shares(np.array([1 - weights[bottom], weights[bottom]]), [z_field, z_bottom])
        residuals, counted = problem.residuals(z), np.flatnonzero(plausible > NEGLIGIBLE)
        ratios = [fits[i].system.calc_end_errors(residuals) for i in counted]
        kappa = self.noise.calc_discrepancy(np.average(ratios, axis=0, weights=plausible[counted]))
        wider, surer = max(kappa, 1.0), min(CAUTION * kappa, 1.0)
        # Leaning on weak variation predicts better; it is no knowledge, and must not make the
        # estimate look surer.
        covariance, prior_covariance = np.zeros((2, len(z), len(z)))
        for means, chosen in ((z_field, fields), (z_bottom, [bottom])):
            if not plausible[chosen].sum() > NEGLIGIBLE:
                continue
            off, T = _compare_shares(means, z)
            for i in chosen:
                d = fits[i].z - means if means is z_field else np.zeros(len(z))
                S = (
                    fits[i].covariance
                    if surer == 1.0
                    else fits[i].system.scale_noise(surer).calc_covariance()
                )
                covariance += plausible[i] * (T @ (S + np.outer(d, d)) @ T.T + np.outer(off, off))
                root = T @ priors[i].factor
                prior_covariance += plausible[i] * (root @ root.T)
        scale = NoiseScale(*(wider * weights @ np.array([fit.scale for fit in fits])).tolist())
        noise, best = self.noise.scaled(scale), int(np.argmax(weights))
        return MapEnsembleFit(
            z,
            wider**2 * covariance
            + problem.calc_tilt_covariance(SHARED_SHIFT * surer * noise.load_shift),
            wider**2 * prior_covariance,
            noise.pose,
            noise.load_shift,
            *_describe(uniform_is_best=best == 0),
            tuple(FitStart(fit.z, fit.scale) for fit in fits),
            fits[best],
            kappa / wider,
        )

    def _make_priors(
        self, obj: GridObject, z0: Array, C: Array, log_contact_friction_std: float
    ) -> list[LoadPrior]:
        """A smooth field of each amplitude, weakest first, and a rigid bottom on the outline's corners."""
        fields = [make_field(obj, z0, C, a, log_contact_friction_std) for a in self.amplitudes]
        return [*fields, make_bottom(obj, z0, log_contact_friction_std)]

    def fit_prior(
        self, obj: GridObject, z0: Array, log_contact_friction_std: float
    ) -> MapEnsembleFit:
        """Gives the widest prior, where no push touched the object."""
        A = self.make_widest_factor(obj, log_contact_friction_std)
        message = "The pusher never touched the object: nothing was learned, this is the prior."
        return MapEnsembleFit(
            z0,
            A @ A.T,
            A @ A.T,
            self.noise.pose,
            self.noise.load_shift,
            IdentificationStatus.NO_DATA,
            message,
        )

    def make_widest_factor(self, obj: GridObject, log_contact_friction_std: float) -> Array:
        """Makes the factor (n+1, n+1) of the prior covariance of z at the last amplitude."""
        return calc_prior_factor(
            calc_smooth_covariance(obj, self.range_cells),
            self.amplitudes[-1],
            log_contact_friction_std,
        )


def _hold_center(obj: GridObject) -> CenterOfMass:
    """Where nothing is known of the center of mass: about the cells' centroid."""
    x, y = obj.p_BC.mean(axis=0)
    return CenterOfMass((x, y), CENTER_STD * obj.radius_of_gyration)


def _describe(uniform_is_best: bool) -> tuple[IdentificationStatus, str]:
    """The status, and the same in a sentence."""
    if not uniform_is_best:
        return IdentificationStatus.LEARNED, "Learned from the pushes."
    return (
        IdentificationStatus.PRIOR_KEPT,
        "The pushes are explained best by an almost even object; only the contact friction was fitted freely.",
    )


def tilt_loads(obj: GridObject, z0: Array) -> list[Array]:
    """Makes z (n+1,) whose loads grow exponentially across the object in some direction, with the total of z0's.

    The load of an only cell has nowhere to go; of that object there is none.
    """
    if obj.n == 1:
        return []
    arm = obj.p_BC - obj.p_BC.mean(axis=0)
    arm /= np.sqrt((arm**2).sum(axis=1).mean())
    tilted = []
    for size in TILT_SIZES:
        for angle in np.arange(TILT_DIRECTIONS) * (2 * np.pi / TILT_DIRECTIONS):
            z = z0.copy()
            z[CELLS] += size * (arm @ [np.cos(angle), np.sin(angle)])
            z[CELLS] += logsumexp(z0[CELLS]) - logsumexp(z[CELLS])
            tilted.append(z)
    return tilted


def _move_center(p_BC: Array, z: Array, p_loads: Array) -> Array:
    """The z of loads at p_loads (n, 2) on cells at p_BC (n, 2), tilted along so that their center stays where it is."""
    x = calc_share(z)
    arm = p_BC - x @ p_loads
    if len(x) == 1:
        return z
    ridge, b = TILT_RIDGE * float((p_BC.var(axis=0)).sum()) * np.eye(2), np.zeros(2)
    for _ in range(TILT_STEPS):
        w = x * np.exp(arm @ b - (arm @ b).max())
        w /= w.sum()
        mean = w @ arm
        step = -np.linalg.solve(
            (arm * w[:, None]).T @ arm - np.outer(mean, mean) + ridge, mean + ridge @ b
        )
        b += step / max(1.0, float(np.abs(arm @ step).max()) / MAX_TILT_STEP)
    moved = z.copy()
    moved[CELLS] += arm @ b
    return moved


def _average_shares(weights: Array, z: list[Array]) -> Array:
    """The z whose shares are the average of others', with the averages of their common scale and of log mu_c."""
    values = np.array(z)
    level = logsumexp(values[:, CELLS], axis=1)
    average = np.asarray(weights @ values)
    average[CELLS] = np.log(weights @ np.exp(values[:, CELLS] - level[:, None])) + weights @ level
    return average


def _compare_shares(z: Array, z0: Array) -> tuple[Array, Array]:
    """How far z is from z0, x/x0 - 1 of the shares, and T (n+1, n+1), by which dz varies that, the scale apart."""
    ratio, off, T = calc_share(z) / calc_share(z0), z - z0, np.eye(len(z))
    off[CELLS] = ratio - 1
    T[CELLS, CELLS] = np.diag(ratio) + np.outer(1 - ratio, calc_share(z))
    return off, T


class Tracker:
    """Keeps the best loss so far, and tells whoever wants to know."""

    def __init__(
        self, problem: PushProblem, progress: Callable[[HistoryEntry], None] | None
    ) -> None:
        """Begins at nothing simulated."""
        self.problem, self.progress = problem, progress
        self.history: list[HistoryEntry] = []
        self._first = 0

    @property
    def simulations(self) -> int:
        """Pushes simulated, by the problem or by a search of its own."""
        searched = self.history[-1].simulations if self.history else 0
        return max(searched, self.problem.simulations)

    def follow(self, problem: PushProblem) -> None:
        """Goes on with a problem that does without what was refused, whose losses begin anew."""
        self.problem, self._first = problem, len(self.history)

    def report(self, z: Array, linear: Linearization) -> None:
        """Notes where a fit is."""
        loss = float(self.problem.calc_cell_errors(linear.residuals).mean())
        self.add(
            HistoryEntry(
                self.problem.simulations,
                min([loss, *(e.loss for e in self.history[self._first :][-1:])]),
                FITTING,
            )
        )

    def add(self, entry: HistoryEntry) -> None:
        """Notes an entry."""
        self.history.append(entry)
        if self.progress is not None:
            self.progress(entry)
