"""The average of the fits of all priors, and the spread of that mixture.

With E_a the log evidence of fit a, L_a the log density that it gives to the end of each push when
that push is left out, and its prior's weight p_a, the loads as fractions x_a of the whole are
averaged:

    w_a ~ p_a exp((E_a + L_a) / 2),    x = sum_a w_a x_a

Evidence alone, or predictions alone, may be sure of one wrong fit. So the spread goes by both, and
without the prior's weights: w'_a is the mean of ~ exp E_a and ~ exp((E_a + L_a) / 2). It is

    S = kappa² sum_a w'_a (T (S_a + d d^T) T^T + o o^T) + shared

S_a is the spread of fit a, and d how far it is from the mean of its group: all fits whose loads are
at the cells' centers are one group, and each of the others is one by itself. With y the fractions
of a group's mean, o = y/x - 1 is how far that group is from the average, and T = diag(y/x) +
(1 - y/x) y^T turns a small dz about y into what it does about x. kappa says how much more the
pushes contradict each other than was stated, where it is above 1; where it is below, S_a is that of
less noise. `shared` is the part of the load's shift that is common to all pushes
(`docs/theory/identification.md`, section 5).
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp, softmax

from gridpush_drake.geometry.se2 import Array, IntArray
from gridpush_drake.identification.fit.hypotheses import LoadHypothesis
from gridpush_drake.identification.fit.load_prior import LoadPrior
from gridpush_drake.identification.fit.map_fit import MapFit
from gridpush_drake.identification.result import FitStart, HypothesisEvidence, IdentificationStatus
from gridpush_drake.identification.statistics.noise import NoiseModel, NoiseScale
from gridpush_drake.identification.statistics.outliers import weigh_pushes
from gridpush_drake.identification.statistics.posterior import CELL_ENTRIES, calc_fraction
from gridpush_drake.identification.statistics.problem import PushProblem

SHARED_SHIFT = 0.3
"""Fraction of the load's shift from push to push that all pushes may share, so that no number of
pushes averages it out."""

MIN_NOISE_FACTOR = 2.0
"""Where the spread of the parameters is calculated, the noise is taken for at least this many times
as large as the pushes show it."""

PREDICTIVE_FRACTION = 0.5
"""How much the predictions of pushes left out count in the weight of a fit; the rest is evidence.
The evidence of a wrong prior may be far the greatest if all priors are wrong. Predictions alone
hardly tell an even object from one that is almost even."""

HOPELESS_EVIDENCE_GAP = 30.0
"""A fit whose log evidence is this far below the best one is not carried to its end, and is not
asked for predictions: it counts as predicting no better than any other."""

MIN_CHECKED_PUSHES = 3
"""Least number of pushes at which predictions of pushes left out decide whether anything was
learned. How much such predictions scatter is not known from fewer."""

NEGLIGIBLE_WEIGHT = 1e-3
"""Fits whose weight without that of the prior is below this do not count for the spread."""

TILT_RIDGE = 0.01
"""Relative ridge that keeps a tilt finite where a corner lies beyond the centers of all cells; it
takes off that much of the shift."""

TILT_STEPS = 20
"""Number of Newton steps by which a tilt is found."""

MAX_TILT_STEP = 1.0
"""Largest change of any cell's log k in one of these steps."""


@dataclass(frozen=True, eq=False)
class MapEnsembleFit:
    """What the default identifier found.

    Attributes:
        z: (n+1,) log k and log mu_c.
        covariance: (n+1, n+1) of z, over all fits.
        prior_covariance: (n+1, n+1) of z before the pushes, averaged in the same way.
        noise_std: standard deviation of what stays unexplained, per coordinate of the residual, m.
        load_shift_std: standard deviation of the load's center per axis from push to push, m.
        status: how it ended.
        starts: where each fit ended.
        best: the most probable fit; None where there was nothing to fit.
        interval_scale: factor on predicted intervals, see `Identification`.
        hypotheses: evidence, predictions and weight of each fit, in the order of `starts`.
    """

    z: Array
    covariance: Array
    prior_covariance: Array
    noise_std: float
    load_shift_std: float
    status: IdentificationStatus
    starts: tuple[FitStart, ...] = ()
    best: MapFit | None = None
    interval_scale: float = 1.0
    hypotheses: tuple[HypothesisEvidence, ...] = ()


@dataclass(frozen=True, eq=False)
class Candidate:
    """One prior and its fit.

    Attributes:
        name: of the prior; the hypothesis' name, with a number where it proposed several.
        hypothesis: which proposed the prior.
        prior: the prior of z.
        problem: the training pushes, with the cells' loads where the prior has them.
        on_grid: whether the cells bear their loads at their own centers.
        fit: the most probable z under the prior.
    """

    name: str
    hypothesis: LoadHypothesis
    prior: LoadPrior
    problem: PushProblem
    on_grid: bool
    fit: MapFit

    @property
    def log_evidence(self) -> float:
        """Log evidence of the fit, without the fraction that the prior has of it."""
        return self.fit.log_evidence

    @property
    def shared_log_evidence(self) -> float:
        """Log evidence of the fit with the fraction that the prior has of it."""
        return self.log_evidence + float(np.log(self.prior.evidence_fraction))


def average_fits(
    problem: PushProblem, candidates: list[Candidate], noise: NoiseModel
) -> MapEnsembleFit:
    """Averages the fits of all priors.

    Args:
        problem: the training pushes, with loads at the cells' centers.
        candidates: the priors with their fits; at least one.
        noise: the noise model, unscaled.
    """
    fits = [one.fit for one in candidates]

    # Leaning on weak variation predicts better; it is no knowledge, and must not make the
    # estimate look surer. So the mean goes by w, and the spread by w', without the prior's weights,
    # and over all fits that either the evidence or the predictions speak for.
    evidences = np.array([one.shared_log_evidence for one in candidates])
    predictives = _calc_predictives(fits, evidences, noise)
    said = (1 - PREDICTIVE_FRACTION) * evidences + PREDICTIVE_FRACTION * predictives
    leaning = said + np.log([one.prior.weight for one in candidates])
    weights = softmax(leaning)
    plausible = (softmax(evidences) + softmax(said)) / 2

    # The mean: x = sum_a w_a x_a.
    groups = _group(problem, candidates, leaning, weights)
    z = _average_fractions(
        np.array([group.weight for group in groups]), [group.z for group in groups]
    )
    kappa = _calc_kappa(fits, plausible, problem.residuals(z), noise)
    wider = max(kappa, 1.0)
    surer = min(MIN_NOISE_FACTOR * kappa, 1.0)

    # The spread of the mixture, and the shift of the load that all pushes share.
    covariance, prior_covariance = _calc_mixture(candidates, groups, plausible, z, surer)
    scale = NoiseScale(*(wider * weights @ np.array([fit.scale for fit in fits])).tolist())
    scaled = noise.scaled(scale)
    shared = problem.calc_tilt_covariance(SHARED_SHIFT * surer * scaled.load_shift)

    best = int(np.argmax(weights))
    return MapEnsembleFit(
        z=z,
        covariance=wider**2 * covariance + shared,
        prior_covariance=wider**2 * prior_covariance,
        noise_std=scaled.pose,
        load_shift_std=scaled.load_shift,
        status=_find_status(candidates, evidences, weights, noise),
        starts=tuple(FitStart(one.fit.z, one.fit.scale, one.name) for one in candidates),
        best=fits[best],
        interval_scale=kappa / wider,
        hypotheses=_describe_hypotheses(candidates, evidences, predictives, weights),
    )


def _calc_kappa(
    fits: list[MapFit], plausible: Array, residuals: list[Array], noise: NoiseModel
) -> float:
    """Calculates by how much the pushes depart from what is said of each by all the others.

    Args:
        fits: the fits.
        plausible: (a,) weight of each fit by what the pushes say alone.
        residuals: (3K,) residuals of each push by the average, m.
        noise: the noise model, unscaled.
    """
    counted = np.flatnonzero(plausible > NEGLIGIBLE_WEIGHT)
    ratios = [fits[i].linearized.leave_out_ends(residuals).ratios for i in counted]
    return noise.calc_discrepancy(np.average(ratios, axis=0, weights=plausible[counted]))


def _describe_hypotheses(
    candidates: list[Candidate], evidences: Array, predictives: Array, weights: Array
) -> tuple[HypothesisEvidence, ...]:
    """Says of each fit how well it explains and predicts the pushes, and its weight."""
    return tuple(
        HypothesisEvidence(
            name=one.name,
            log_evidence=float(evidence - evidences.max()),
            log_predictive=float(predictive - predictives.max()),
            weight=float(weight),
        )
        for one, evidence, predictive, weight in zip(
            candidates, evidences, predictives, weights, strict=True
        )
    )


def _calc_predictives(fits: list[MapFit], evidences: Array, noise: NoiseModel) -> Array:
    """Calculates how well each fit predicts the ends of pushes from all other pushes.

    Args:
        fits: the fits.
        evidences: (a,) their log evidences.
        noise: the noise model, unscaled.

    Returns:
        (a,) log densities. Hopeless fits have the least one of all others.
    """
    asked = evidences > evidences.max() - HOPELESS_EVIDENCE_GAP
    found = [
        noise.calc_log_predictive(fit.linearized.leave_out_ends()) if ask else np.inf
        for fit, ask in zip(fits, asked, strict=True)
    ]
    return np.where(asked, found, np.min(found))


def _calc_mixture(
    candidates: list[Candidate],
    groups: list["_AveragedGroup"],
    plausible: Array,
    z: Array,
    surer: float,
) -> tuple[Array, Array]:
    """Calculates the spread of all fits about their average.

    Args:
        candidates: the priors with their fits.
        groups: which of the fits are averaged directly.
        plausible: (a,) weight of each fit by what the pushes say alone.
        z: (n+1,) the average.
        surer: factor on the noise with which the spread of each fit is calculated, at most 1.

    Returns:
        sum_a w'_a (T (S_a + d d^T) T^T + o o^T), (n+1, n+1), and the same of the priors, without d
        and o.
    """
    covariance, prior_covariance = np.zeros((2, len(z), len(z)))
    for group in groups:
        if not plausible[group.members].sum() > NEGLIGIBLE_WEIGHT:
            continue
        off, T = _compare_fractions(group.z, z)
        for i in group.members:
            fit = candidates[i].fit
            d = fit.z - group.z if group.on_grid else np.zeros(len(z))
            S = fit.covariance
            if surer != 1.0:
                S = fit.linearized.scale_noise(surer).calc_covariance()
            covariance += plausible[i] * (T @ (S + np.outer(d, d)) @ T.T + np.outer(off, off))
            root = T @ candidates[i].prior.factor
            prior_covariance += plausible[i] * (root @ root.T)
    return covariance, prior_covariance


def _group(
    problem: PushProblem, candidates: list[Candidate], leaning: Array, weights: Array
) -> list["_AveragedGroup"]:
    """Puts all fits with loads at the cells' centers into one group, each other into its own.

    Args:
        problem: the training pushes, with loads at the cells' centers.
        candidates: the priors with their fits.
        leaning: (a,) log weights in the mean, up to a constant.
        weights: (a,) weights in the mean.
    """
    on_grid = np.flatnonzero([one.on_grid for one in candidates])
    elsewhere = np.flatnonzero([not one.on_grid for one in candidates])
    groups = []
    if len(on_grid):
        z = _average_fractions(softmax(leaning[on_grid]), [candidates[i].fit.z for i in on_grid])
        weight = 1 - float(weights[elsewhere].sum())
        groups.append(_AveragedGroup(z=z, weight=weight, members=on_grid, on_grid=True))
    for i in elsewhere:
        one = candidates[i]
        z = move_center(problem.obj.p_BC, one.fit.z, one.prior.p_BC)
        groups.append(
            _AveragedGroup(z=z, weight=float(weights[i]), members=np.array([i]), on_grid=False)
        )
    return groups


@dataclass(frozen=True, eq=False)
class _AveragedGroup:
    """Fits whose loads are averaged directly.

    Attributes:
        z: (n+1,) their average, with loads on the grid.
        weight: of the group in the whole average.
        members: indices of the fits.
        on_grid: whether they bear their loads at the cells' centers.
    """

    z: Array
    weight: float
    members: IntArray
    on_grid: bool


def _find_status(
    candidates: list[Candidate], evidences: Array, weights: Array, noise: NoiseModel
) -> IdentificationStatus:
    """Tells whether anything was learned.

    Args:
        candidates: the priors with their fits.
        evidences: (a,) their log evidences.
        weights: (a,) weights in the mean.
        noise: the noise model, unscaled.

    Returns:
        "prior_kept" if an even object is the most probable, or if pushes left out are not predicted
        better than by it by more than one standard error.
    """
    kept = candidates[int(np.argmax(weights))].prior.stands_for_even
    gains = _calc_predictive_gains(candidates, evidences, weights, noise)
    if gains is not None and len(gains.values) >= MIN_CHECKED_PUSHES:
        kept = kept or gains.mean <= gains.standard_error
    return IdentificationStatus.PRIOR_KEPT if kept else IdentificationStatus.LEARNED


@dataclass(frozen=True, eq=False)
class _PredictiveGains:
    """How much nearer pushes left out are predicted by the average than by an even fit.

    Attributes:
        values: (P,) distance of each push's end from the even fit's prediction, less that from the
            average's, m.
        weights: (P,) how much each push counts, see `weigh_pushes`.
    """

    values: Array
    weights: Array

    @property
    def mean(self) -> float:
        """Weighted mean of the gains, m."""
        return float(np.average(self.values, weights=self.weights))

    @property
    def standard_error(self) -> float:
        """Standard error of the mean, m."""
        count = len(self.values)
        off = self.weights / self.weights.sum() * (self.values - self.mean)
        return float(np.sqrt(count / (count - 1) * (off @ off)))


def _calc_predictive_gains(
    candidates: list[Candidate], evidences: Array, weights: Array, noise: NoiseModel
) -> _PredictiveGains | None:
    """Calculates how much nearer pushes left out are predicted by the average than by an even fit.

    Args:
        candidates: the priors with their fits.
        evidences: (a,) their log evidences.
        weights: (a,) weights in the mean.
        noise: the noise model, unscaled.

    Returns:
        The gains; None if no fit stands for an even object, or the evidence is clearly against it.
    """
    asked = evidences > evidences.max() - HOPELESS_EVIDENCE_GAP
    even = next(
        (
            one.fit
            for one, ask in zip(candidates, asked, strict=True)
            if one.prior.stands_for_even and ask
        ),
        None,
    )
    if even is None:
        return None

    # Residuals are linear in the loads, so that those of the average are averages.
    counted = np.flatnonzero(weights > NEGLIGIBLE_WEIGHT)
    errors = [candidates[i].fit.linearized.leave_out_ends().errors for i in counted]
    averaged = np.average(errors, axis=0, weights=weights[counted])
    by_average = np.linalg.norm(averaged, axis=1)
    by_even = np.linalg.norm(even.linearized.leave_out_ends().errors, axis=1)
    return _PredictiveGains(
        values=by_even - by_average, weights=weigh_pushes([by_even, by_average], noise.pose)
    )


def move_center(p_BC: Array, z: Array, p_loads: Array) -> Array:
    """Carries loads at given points over to the cells, so that their center stays where it is.

    The loads are tilted, exponentially along a direction b: x_i exp(b . arm_i). Newton's method
    finds the b for which the tilted loads' arms sum up to nothing.

    Args:
        p_BC: (n, 2) the cells' centers, m.
        z: (n+1,) log loads and log mu_c.
        p_loads: (n, 2) points at which the loads are, m.

    Returns:
        (n+1,) z of the cells.
    """
    x = calc_fraction(z)
    arm = p_BC - x @ p_loads
    if len(x) == 1:
        return z
    ridge = TILT_RIDGE * float((p_BC.var(axis=0)).sum()) * np.eye(2)
    b = np.zeros(2)
    for _ in range(TILT_STEPS):
        w = x * np.exp(arm @ b - (arm @ b).max())
        w /= w.sum()
        mean = w @ arm
        hessian = (arm * w[:, None]).T @ arm - np.outer(mean, mean) + ridge
        step = -np.linalg.solve(hessian, mean + ridge @ b)
        b += step / max(1.0, float(np.abs(arm @ step).max()) / MAX_TILT_STEP)
    moved = z.copy()
    moved[CELL_ENTRIES] += arm @ b
    return moved


def _average_fractions(weights: Array, z: list[Array]) -> Array:
    """Averages points z, each (n+1,): their shares, their common scale, and log mu_c."""
    values = np.array(z)
    level = logsumexp(values[:, CELL_ENTRIES], axis=1)
    average = np.asarray(weights @ values)
    average[CELL_ENTRIES] = (
        np.log(weights @ np.exp(values[:, CELL_ENTRIES] - level[:, None])) + weights @ level
    )
    return average


def _compare_fractions(z: Array, z0: Array) -> tuple[Array, Array]:
    """Compares the fractions of the loads at two points.

    Args:
        z: (n+1,) one point.
        z0: (n+1,) the other.

    Returns:
        How far z is from z0 (n+1,): x/x0 - 1 of the shares, and the difference of log mu_c. And T
        (n+1, n+1), the derivative of that by z, apart from the common scale.
    """
    ratio = calc_fraction(z) / calc_fraction(z0)
    off = z - z0
    T = np.eye(len(z))
    off[CELL_ENTRIES] = ratio - 1
    T[CELL_ENTRIES, CELL_ENTRIES] = np.diag(ratio) + np.outer(1 - ratio, calc_fraction(z))
    return off, T
