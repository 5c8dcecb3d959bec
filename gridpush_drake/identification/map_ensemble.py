"""The default identifier: smooth priors of several strengths, weighed by evidence, checked by cross-validation.

1. For each amplitude of the smoothness prior, weakest variation first, fit z by trust-region Gauss-Newton (`map_fit`),
   each fit starting where the last one ended: coarse to fine.
2. Weigh the fits by their evidence. The first, all but uniform, has prior odds of `prior_odds` to one against
   each of the others, so that a few noisy pushes do not talk the model out of it.
3. Average them: z = sum_a w_a z_a.
4. Push-wise cross-validation over the training pushes: mix the average with the uniform fit, with the smallest share of
   the average that predicts left-out pushes as well as any, give or take a fraction of the standard error. Where the
   pushes do not favor what was learned, that is the uniform fit (`docs/theory/identification.md`, section 5).
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.identification.map_fit import (
    RANGE_CELLS,
    CenterOfMass,
    MapFit,
    NoiseModel,
    calc_smooth_covariance,
    fit_map,
)
from gridpush_drake.identification.problem import PushProblem
from gridpush_drake.identification.result import FitStart, HistoryEntry, IdentificationStatus
from gridpush_drake.objects.grid_object import GridObject

Array = NDArray[np.float64]

MM = 1e3
"""Millimeters in a meter."""

STAGE_FITTING, STAGE_CHECKING = "fitting", "cross-validating"


@dataclass(frozen=True, eq=False)
class MapEnsembleFit:
    """What the default identifier found.

    Attributes:
        z: (n+1,) log k and log mu_c.
        covariance: (n+1, n+1) of z, over all amplitudes by their evidence alone.
        prior_covariance: (n+1, n+1) of z before the pushes, averaged in the same way.
        noise_std: standard deviation of what stays unexplained, per coordinate of the residual, m.
        status: how it ended.
        message: the status in a sentence.
        starts: where each amplitude's fit ended.
    """

    z: Array
    covariance: Array
    prior_covariance: Array
    noise_std: float
    status: IdentificationStatus
    message: str
    starts: tuple[FitStart, ...] = ()


@dataclass(frozen=True)
class MapEnsemble:
    """The default identifier, and what it takes for granted.

    Attributes:
        amplitudes: standard deviations of log k under each smoothness prior, increasing; the first stands for uniform.
        prior_odds: of the first against each of the others.
        range_cells: correlation range of the prior, cells.
        noise: the noise model.
        folds: most parts that the pushes are cut into for cross-validation.
        shares: of the learned model in the mixtures that cross-validation compares, increasing from 0 to 1.
        standard_errors: that a smaller share may be worse than the best and be taken for it.
        kept_weight: weight of the first amplitude above which the prior counts as kept.
        max_mixture_error: mean cell error of the training pushes, in standard deviations of a pose, above which (and
            above `max_mixture_ratio` times the learned model's) a mixture does not explain the pushes at all.
        max_mixture_ratio: see there.
    """

    amplitudes: tuple[float, ...] = (0.05, 0.3, 0.7, 1.5, 3.0)
    prior_odds: float = 20.0
    range_cells: float = RANGE_CELLS
    noise: NoiseModel = field(default_factory=NoiseModel)
    folds: int = 5
    shares: tuple[float, ...] = (0.0, 0.25, 0.5, 0.75, 1.0)
    standard_errors: float = 0.6
    kept_weight: float = 0.95
    max_mixture_error: float = 8.0
    max_mixture_ratio: float = 2.0

    def fit(
        self,
        problem: PushProblem,
        z0: Array,
        log_contact_friction_std: float,
        center_of_mass: CenterOfMass | None,
        seed: int,
        report: Callable[[Array, str], None],
        starts: tuple[FitStart, ...] = (),
    ) -> MapEnsembleFit:
        """Takes the four steps above.

        Args:
            problem: the training pushes; at least one.
            z0: (n+1,) prior mean of z.
            log_contact_friction_std: prior standard deviation of log mu_c.
            center_of_mass: prior knowledge, or None.
            seed: of the folds.
            report: called with z and a word, now and then.
            starts: of a fit to fewer pushes, one an amplitude; each fit begins there or where the last amplitude's
                ended, whichever is more probable.

        Returns:
            The fit.
        """
        C = calc_smooth_covariance(problem.obj, self.range_cells)
        factors = [calc_prior_factor(C, amplitude, log_contact_friction_std) for amplitude in self.amplitudes]
        fits: list[MapFit] = []
        for i, A in enumerate(factors):
            fits.append(
                fit_map(
                    problem, z0, A, self.noise, center_of_mass, start=fits[-1].z if fits else z0,
                    scale=fits[-1].scale if fits else 1.0, warm_start=starts[i] if starts else None,
                    on_renewal=lambda z: report(z, STAGE_FITTING),
                )
            )  # fmt: skip
        weights = _calc_weights(fits, self.prior_odds)
        average = weights @ np.array([fit.z for fit in fits])
        best = int(np.argmax(weights))
        learned_share, errors = 1.0, None
        if best > 0 and len(problem) > 1:
            learned_share, errors = self._cross_validate(
                problem, z0, factors, fits, weights, average, center_of_mass, seed, report
            )
        z = learned_share * average + (1 - learned_share) * fits[0].z
        weights = learned_share * weights
        weights[0] += 1 - learned_share
        # Leaning on the uniform fit predicts better; it is no knowledge, and must not make the estimate look surer.
        plausible = _calc_weights(fits, prior_odds=1.0)
        spread = [fit.covariance + np.outer(fit.z - z, fit.z - z) for fit in fits]
        return MapEnsembleFit(
            z,
            np.einsum("a,aij->ij", plausible, np.array(spread)),
            np.einsum("a,aij->ij", plausible, np.array([A @ A.T for A in factors])),
            self.noise.pose * float(weights @ np.array([fit.scale for fit in fits])),
            *self._describe(weights, learned_share, errors),
            tuple(FitStart(fit.z, fit.scale) for fit in fits),
        )

    def fit_prior(self, obj: GridObject, z0: Array, log_contact_friction_std: float) -> MapEnsembleFit:
        """Gives the widest prior, where no push touched the object."""
        A = self.make_widest_factor(obj, log_contact_friction_std)
        message = "The pusher never touched the object: nothing was learned, this is the prior."
        return MapEnsembleFit(z0, A @ A.T, A @ A.T, self.noise.pose, IdentificationStatus.NO_DATA, message)

    def make_widest_factor(self, obj: GridObject, log_contact_friction_std: float) -> Array:
        """Makes the factor (n+1, n+1) of the prior covariance of z at the last amplitude."""
        return calc_prior_factor(
            calc_smooth_covariance(obj, self.range_cells), self.amplitudes[-1], log_contact_friction_std
        )

    def _cross_validate(
        self,
        problem: PushProblem,
        z0: Array,
        factors: list[Array],
        fits: list[MapFit],
        weights: Array,
        average: Array,
        center_of_mass: CenterOfMass | None,
        seed: int,
        report: Callable[[Array, str], None],
    ) -> tuple[float, tuple[float, float]]:
        """Chooses the learned model's share; gives the errors of left-out pushes, uniform and learned, m, too."""
        order = np.random.default_rng(seed).permutation(len(problem))
        errors = np.empty((len(self.shares), len(problem)))
        best = int(np.argmax(weights))
        for part in np.array_split(order, min(self.folds, len(problem))):
            rest = sorted(set(order.tolist()) - set(part.tolist()))
            uniform, learned = (
                fit_map(
                    problem, z0, factors[i], self.noise, center_of_mass, pushes=rest, start=fits[i].z,
                    scale=fits[i].scale,
                ).z
                for i in (0, best)
            )  # fmt: skip
            left_out = sorted(part.tolist())
            for i, share in enumerate(self.shares):
                residuals = problem.residuals((1 - share) * uniform + share * learned, left_out)
                errors[i, left_out] = problem.calc_cell_errors(residuals)
            report(learned, STAGE_CHECKING)
        candidates = self._explains(problem, fits[0].z, average)
        excess = errors - errors[np.argmin(np.where(candidates, errors.mean(axis=1), np.inf))]
        standard_error = excess.std(axis=1, ddof=1) / np.sqrt(len(problem))
        chosen = int(np.argmax(candidates & (excess.mean(axis=1) <= self.standard_errors * standard_error)))
        return self.shares[chosen], (float(errors[0].mean()), float(errors[-1].mean()))

    def _explains(self, problem: PushProblem, uniform: Array, learned: Array) -> NDArray[np.bool_]:
        """Whether the mixture at each share explains the training pushes, by and large; the learned model always does.

        Halfway between two models a push may go round the object's other side, and neither model's predictions are met.
        """
        mixtures = [(1 - share) * uniform + share * learned for share in self.shares]
        errors = np.array([problem.calc_cell_errors(problem.residuals(z)).mean() for z in mixtures])
        return errors <= max(self.max_mixture_ratio * errors[-1], self.max_mixture_error * self.noise.pose)

    def _describe(
        self, weights: Array, learned_share: float, errors: tuple[float, float] | None
    ) -> tuple[IdentificationStatus, str]:
        """The status, and the same in a sentence."""
        checked = ""
        if errors:
            uniform, learned = (f"{MM * error:.2f} mm" for error in errors)
            checked = f"left-out training pushes are predicted to {learned}, by uniform friction to {uniform}"
        if weights[0] >= self.kept_weight:
            reason = checked or "the pushes do not speak against uniform friction"
            message = f"The friction was left uniform: {reason}. The contact friction was fitted."
            return IdentificationStatus.PRIOR_KEPT, message
        if weights[0] > 1 - self.kept_weight:
            reason = f" ({checked})" if checked else ""
            share = f"{100 * (1 - weights[0]):.0f} % learned and the rest uniform"
            return IdentificationStatus.MIXTURE, f"{share}: the pushes favor neither alone{reason}."
        return IdentificationStatus.LEARNED, "Learned from the pushes" + (f": {checked}." if checked else ".")


def calc_prior_factor(C: Array, amplitude: float, log_contact_friction_std: float) -> Array:
    """Cholesky factor (n+1, n+1) of blockdiag(a² C, sigma²), the prior covariance of z."""
    A = np.zeros((len(C) + 1, len(C) + 1))
    A[:-1, :-1] = amplitude * np.linalg.cholesky(C)
    A[-1, -1] = log_contact_friction_std
    return A


def _calc_weights(fits: list[MapFit], prior_odds: float) -> Array:
    log_weights = np.array([fit.log_evidence for fit in fits])
    log_weights[0] += np.log(prior_odds)
    weights = np.exp(log_weights - log_weights.max())
    return weights / weights.sum()


class Tracker:
    """Keeps the best loss so far, and tells whoever wants to know."""

    def __init__(self, problem: PushProblem, progress: Callable[[HistoryEntry], None] | None) -> None:
        """Begins at nothing simulated."""
        self.problem, self.progress = problem, progress
        self.history: list[HistoryEntry] = []

    @property
    def simulations(self) -> int:
        """Pushes simulated, by the problem or by a search of its own."""
        searched = self.history[-1].simulations if self.history else 0
        return max(searched, self.problem.simulations)

    def report(self, z: Array, stage: str) -> None:
        """Notes where a fit is; while checking, z was fitted to some pushes only and its loss does not count."""
        best = self.history[-1].loss if self.history else np.inf
        if stage != STAGE_CHECKING:
            spent = self.problem.simulations
            best = min(best, float(self.problem.calc_cell_errors(self.problem.residuals(z)).mean()))
            self.problem.simulations = spent
        self.add(HistoryEntry(self.problem.simulations, best, stage))

    def add(self, entry: HistoryEntry) -> None:
        """Notes an entry."""
        self.history.append(entry)
        if self.progress is not None:
            self.progress(entry)
