"""The default identifier: smooth priors of several strengths, weighed by evidence.

For each amplitude of the smoothness prior, weakest variation first, z is fitted by Gauss-Newton (`map_fit`), each fit
starting where the last one ended: coarse to fine. The fits are averaged, z = sum_a w_a z_a, by their evidence and a
prior weight a^-3/4 (`docs/theory/identification.md`, section 5).
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from gridpush_drake.identification.map_fit import (
    RANGE_CELLS,
    CenterOfMass,
    MapFit,
    calc_smooth_covariance,
    fit_map,
)
from gridpush_drake.identification.noise import NoiseModel, NoiseScale
from gridpush_drake.identification.problem import Linearization, PushProblem
from gridpush_drake.identification.result import FitStart, HistoryEntry, IdentificationStatus
from gridpush_drake.objects.grid_object import GridObject

Array = NDArray[np.float64]

WEAKNESS = 0.75
"""Power of 1/a that an amplitude a weighs beforehand: few noisy pushes are not to talk the model out of uniformity."""

FIRST_EVALUATIONS = 6
"""Of the pushes by each fit, before all have begun; only those that may count for something are then gone on with."""

HOPELESS = 30.0
"""Of log evidence below the best: more than a fit gains once it has begun to settle, and than leaves it any weight."""

SHARED_SHIFT = 0.3
"""Of the load's shift from push to push, how much all pushes may share, so that no number of them averages it out."""

FITTING = "fitting"
"""Word for the only stage of a fit."""


@dataclass(frozen=True, eq=False)
class MapEnsembleFit:
    """What the default identifier found.

    Attributes:
        z: (n+1,) log k and log mu_c.
        covariance: (n+1, n+1) of z, over all amplitudes.
        prior_covariance: (n+1, n+1) of z before the pushes, averaged in the same way.
        noise_std: standard deviation of what stays unexplained, per coordinate of the residual, m.
        load_shift_std: of the load's center per axis from push to push, m.
        status: how it ended.
        message: the status in a sentence.
        starts: where each amplitude's fit ended.
        best: the fit of the most probable amplitude; None where there was nothing to fit.
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


@dataclass(frozen=True)
class MapEnsemble:
    """The default identifier, and what it takes for granted.

    Attributes:
        amplitudes: standard deviations of log k under each smoothness prior, increasing; the first stands for uniform.
        range_cells: correlation range of the prior, cells.
        noise: the noise model.
    """

    amplitudes: tuple[float, ...] = (0.05, 0.3, 0.7, 1.5, 3.0, 6.0)
    range_cells: float = RANGE_CELLS
    noise: NoiseModel = field(default_factory=NoiseModel)

    def fit(
        self,
        problem: PushProblem,
        z0: Array,
        log_contact_friction_std: float,
        center_of_mass: CenterOfMass | None,
        on_step: Callable[[Array, Linearization], None],
        starts: tuple[FitStart, ...] = (),
    ) -> MapEnsembleFit:
        """Fits every amplitude, and averages.

        Args:
            problem: the training pushes; at least one.
            z0: (n+1,) prior mean of z.
            log_contact_friction_std: prior standard deviation of log mu_c.
            center_of_mass: prior knowledge, or None.
            on_step: called with z and the pushes' residuals and derivatives there after every step.
            starts: of a fit to fewer pushes, one an amplitude; each fit begins there or where the last amplitude's
                ended, whichever is more probable.

        Returns:
            The fit.
        """
        C = calc_smooth_covariance(problem.obj, self.range_cells)
        factors = [calc_prior_factor(C, amplitude, log_contact_friction_std) for amplitude in self.amplitudes]
        fit_one = partial(fit_map, problem, z0, noise=self.noise, center_of_mass=center_of_mass, on_step=on_step)
        fits: list[MapFit] = []
        for i, A in enumerate(factors):
            last = fits[-1] if fits else None
            begin = None if last is None else FitStart(last.z, NoiseScale(*np.minimum(last.scale, 1.0).tolist()))
            fits.append(
                fit_one(
                    A, start=begin, linear=None if last is None else last.linear,
                    warm_start=starts[i] if starts else None, max_evaluations=FIRST_EVALUATIONS,
                )
            )  # fmt: skip
        best_evidence = max(fit.log_evidence for fit in fits)
        for i, fit in enumerate(fits):
            if not fit.settled and fit.log_evidence > best_evidence - HOPELESS:
                fits[i] = fit_one(factors[i], start=FitStart(fit.z, fit.scale), linear=fit.linear)
        plausible = _calc_weights(fits)
        weights = plausible * np.power(self.amplitudes, -WEAKNESS)
        weights /= weights.sum()
        z = weights @ np.array([fit.z for fit in fits])
        best = int(np.argmax(weights))
        noise = self.noise.scaled(NoiseScale(*(weights @ np.array([fit.scale for fit in fits])).tolist()))
        shared = SHARED_SHIFT * noise.load_shift
        # Leaning on weak variation predicts better; it is no knowledge, and must not make the estimate look surer.
        spread = [fit.covariance + np.outer(fit.z - z, fit.z - z) for fit in fits]
        return MapEnsembleFit(
            z,
            np.einsum("a,aij->ij", plausible, np.array(spread)) + problem.calc_tilt_covariance(shared),
            np.einsum("a,aij->ij", plausible, np.array([A @ A.T for A in factors])),
            noise.pose,
            noise.load_shift,
            *_describe(uniform_is_best=best == 0),
            tuple(FitStart(fit.z, fit.scale) for fit in fits),
            fits[best],
        )

    def fit_prior(self, obj: GridObject, z0: Array, log_contact_friction_std: float) -> MapEnsembleFit:
        """Gives the widest prior, where no push touched the object."""
        A = self.make_widest_factor(obj, log_contact_friction_std)
        message = "The pusher never touched the object: nothing was learned, this is the prior."
        return MapEnsembleFit(
            z0, A @ A.T, A @ A.T, self.noise.pose, self.noise.load_shift, IdentificationStatus.NO_DATA, message
        )

    def make_widest_factor(self, obj: GridObject, log_contact_friction_std: float) -> Array:
        """Makes the factor (n+1, n+1) of the prior covariance of z at the last amplitude."""
        return calc_prior_factor(
            calc_smooth_covariance(obj, self.range_cells), self.amplitudes[-1], log_contact_friction_std
        )


def _describe(uniform_is_best: bool) -> tuple[IdentificationStatus, str]:
    """The status, and the same in a sentence."""
    if not uniform_is_best:
        return IdentificationStatus.LEARNED, "Learned from the pushes."
    return (
        IdentificationStatus.PRIOR_KEPT,
        "The pushes are explained best by an almost even object; only the contact friction was fitted freely.",
    )


def calc_prior_factor(C: Array, amplitude: float, log_contact_friction_std: float) -> Array:
    """Cholesky factor (n+1, n+1) of blockdiag(a² C, sigma²), the prior covariance of z."""
    return np.asarray(block_diag(amplitude * np.linalg.cholesky(C), np.diag([log_contact_friction_std])))


def _calc_weights(fits: list[MapFit]) -> Array:
    """Of each fit by its evidence."""
    evidences = np.array([fit.log_evidence for fit in fits])
    weights = np.exp(evidences - evidences.max())
    return weights / weights.sum()


class Tracker:
    """Keeps the best loss so far, and tells whoever wants to know."""

    def __init__(self, problem: PushProblem, progress: Callable[[HistoryEntry], None] | None) -> None:
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
                self.problem.simulations, min([loss, *(e.loss for e in self.history[self._first :][-1:])]), FITTING
            )
        )

    def add(self, entry: HistoryEntry) -> None:
        """Notes an entry."""
        self.history.append(entry)
        if self.progress is not None:
            self.progress(entry)
