"""Fit, refuse, fit again: the conversation between the default method's fit and its outliers.

A log may hold poses at which a tracker jumped, and pushes of another object. The fit to the whole
log says which poses and pushes agree least with the others; what is refused is left out, and the
rest is fitted again, until nothing is refused any more (`docs/theory/identification.md`, section
5).

How one fit is made is in `map_ensemble` and `map_fit`; what makes a pose or a push an outlier is in
`outliers`. This module only decides what is fitted next.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.fit.fit_average import MapEnsembleFit
from gridpush_drake.identification.fit.linearized_fit import LinearizedFit
from gridpush_drake.identification.fit.map_fit import MapFit, fit_without
from gridpush_drake.identification.result import FitStart, HistoryEntry
from gridpush_drake.identification.statistics.noise import NoiseScale
from gridpush_drake.identification.statistics.outliers import (
    SUSPECT_EVIDENCE,
    Disagreement,
    LeftOut,
    ScreenedLog,
    calc_outlier_evidence,
)
from gridpush_drake.identification.statistics.problem import Linearization, PushProblem

FITTING_STAGE = "fitting"
"""Name of the only stage of a fit in histories."""

MAX_TRIALS = 2
"""Number of suspected pushes without which the log is fitted, before the log is taken as it is."""

MAX_FITS = 8
"""Number of fits to a log at most, each without what the one before refused."""

POOR_SCALE = NoiseScale(pose=2.0, shift=4.0)
"""If the noise scales of a fit are larger than these, several pushes may be another object's: the
fit explains them all by noise, or by loads that shift."""

MAJORITY_TRIALS = 16
"""Number of small sets of pushes that are fitted by themselves where the fit to all is poor."""

MAJORITY_PUSHES = 3
"""Number of pushes in each of these sets."""


class Tracker:
    """Keeps the history of the fits to a log, and tells of each step whoever wants to know.

    Attributes:
        problem: the pushes that are fitted now.
        progress: is called with each entry of the history; None for nobody.
        history: the entries so far. Their loss is the least one of the present fit to this step.
    """

    def __init__(
        self, problem: PushProblem, progress: Callable[[HistoryEntry], None] | None
    ) -> None:
        """Begins at nothing simulated."""
        self.problem = problem
        self.progress = progress
        self.history: list[HistoryEntry] = []
        self._first = 0

    @property
    def simulations(self) -> int:
        """Pushes simulated, by the problem or by a search of its own."""
        searched = self.history[-1].simulations if self.history else 0
        return max(searched, self.problem.simulations)

    def follow(self, problem: PushProblem) -> None:
        """Goes on with a problem that does without what was refused, whose losses begin anew."""
        self.problem = problem
        self._first = len(self.history)

    def report(self, z: Array, linear: Linearization) -> None:
        """Notes where a fit is."""
        loss = float(self.problem.calc_cell_errors(linear.residuals).mean())
        before = [entry.loss for entry in self.history[self._first :][-1:]]
        best = min([loss, *before])
        entry = HistoryEntry(simulations=self.problem.simulations, loss=best, stage=FITTING_STAGE)
        self.add(entry)

    def add(self, entry: HistoryEntry) -> None:
        """Notes an entry."""
        self.history.append(entry)
        if self.progress is not None:
            self.progress(entry)


@dataclass(frozen=True, eq=False)
class Fitter:
    """How pushes are fitted, which stays the same from one fit of a log to the next.

    Attributes:
        fit_all: fits all hypotheses to pushes; its `starts` are where fits to others have ended.
        fit_few: fits one smooth field to a few pushes.
        tracker: is told which pushes are fitted.
    """

    fit_all: Callable[..., MapEnsembleFit]
    fit_few: Callable[[PushProblem], MapFit]
    tracker: Tracker

    def fit(
        self, problem: PushProblem, starts: tuple[FitStart, ...] = ()
    ) -> tuple[MapEnsembleFit, MapFit]:
        """Fits all hypotheses to the pushes; returns their average, and the most probable one."""
        self.tracker.follow(problem)
        average = self.fit_all(problem, starts=starts)
        assert average.best is not None
        return average, average.best


def fit_robustly(
    fitter: Fitter,
    problem: PushProblem,
    screened: ScreenedLog,
    starts: tuple[FitStart, ...],
    seed: int,
) -> tuple[MapEnsembleFit, ScreenedLog]:
    """Fits a log, and refuses what does not agree with the rest.

    Args:
        fitter: how to fit.
        problem: the pushes of `screened`.
        screened: the log, without the poses that no motion of the pusher explains.
        starts: where the first fit begins, see `MapEnsemble.fit`.
        seed: of the sets of pushes that are fitted by themselves where the fit to all is poor.

    Returns:
        The last fit, and the log that it was made of with all that was refused.
    """
    average, best = fitter.fit(problem, starts)
    # Several outlier pushes at once can hide each other in one poor fit. Then small sets of pushes
    # are asked by themselves, and what the best of them refuses stays out if the rest fits well.
    if is_poor(best) and screened.may_refuse and len(problem) > MAJORITY_PUSHES:
        majority = find_majority(fitter, problem, screened, seed)
        if majority is not screened:
            rest = problem.replace_log(majority.log)
            average_of_rest, best_of_rest = fitter.fit(rest)
            if not is_poor(best_of_rest):
                problem = rest
                screened = majority
                average = average_of_rest
                best = best_of_rest
    # Single poses first, then whole pushes, one a fit: each refusal changes what the rest says.
    for _ in range(MAX_FITS - 1):
        left_out = best.linearized.leave_out()
        refused = screened.refuse_poses(left_out, problem.obj.radius_of_gyration)
        if refused is screened:
            refused = refuse_worst_push(screened, best.linearized, left_out)
        if refused is screened:
            break
        screened = refused
        problem = problem.replace_log(screened.log)
        average, best = fitter.fit(problem, average.starts)
    return average, screened


def is_poor(fit: MapFit) -> bool:
    """Whether a fit needs so much noise, or such shifts of the load, that outliers may be in it."""
    return fit.scale.pose > POOR_SCALE.pose or fit.scale.shift > POOR_SCALE.shift


def find_majority(
    fitter: Fitter, problem: PushProblem, screened: ScreenedLog, seed: int
) -> ScreenedLog:
    """Finds the pushes that belong together, by fits to a few of them.

    Each set of a few pushes says of every other push how probable it is, as this object's or as
    another's. The set that makes the others the most probable names the outliers.

    Returns:
        The log without the outliers; `screened` itself where there are none, or more than may be
        refused.
    """
    rng = np.random.default_rng(seed)
    travels = _calc_travels(screened)
    best_score = -np.inf
    outliers: dict[int, Disagreement] = {}
    for _ in range(MAJORITY_TRIALS):
        few = np.sort(rng.choice(len(problem), MAJORITY_PUSHES, replace=False))
        fit = fitter.fit_few(problem.choose(few.tolist()))
        if is_poor(fit):
            continue
        others = np.setdiff1d(np.arange(len(problem)), few).tolist()
        judged = dict(zip(others, fit.judge(problem, others), strict=True))
        evidence = {i: calc_outlier_evidence(one, travels[i]) for i, one in judged.items()}
        # log of (density as this object's + density as another's), push by push
        scores = [
            one.log_density + np.logaddexp(0.0, evidence[i].log_ratio) for i, one in judged.items()
        ]
        score = float(np.mean(scores))
        if score > best_score:
            best_score = score
            outliers = {
                i: one.explain(judged[i])
                for i, one in evidence.items()
                if one.log_ratio > 0 and screened.log[i].name not in screened.trusted
            }
    if not outliers or len(outliers) > screened.may_refuse:
        return screened
    return screened.refuse_pushes(outliers)


def refuse_worst_push(
    screened: ScreenedLog, fit: LinearizedFit, left_out: list[LeftOut]
) -> ScreenedLog:
    """Refuses the push that agrees least with the others, if they say it is another object's.

    Args:
        screened: the log.
        fit: the most probable fit to it.
        left_out: what the other pushes say of each, to first order. Suspected pushes are judged
            again by a fit to the others.

    Returns:
        The log without that push; `screened` itself where none is refused.
    """
    travels = _calc_travels(screened)
    log_ratios = [
        calc_outlier_evidence(seen, travel).log_ratio
        for seen, travel in zip(left_out, travels, strict=True)
    ]
    suspects = [
        int(i)
        for i in np.argsort(log_ratios)[::-1]
        if log_ratios[i] > SUSPECT_EVIDENCE and screened.log[i].name not in screened.trusted
    ]
    for i in suspects[: min(screened.may_refuse, MAX_TRIALS)]:
        seen = fit_without(fit, i)
        evidence = calc_outlier_evidence(seen, travels[i])
        if evidence.log_ratio > 0:
            return screened.refuse_pushes({i: evidence.explain(seen)})
    return screened


def _calc_travels(screened: ScreenedLog) -> list[Array]:
    """How far the pusher had gone at each observed pose after the first, (K,) m, push by push."""
    return [seen.push.distance_at(seen.t_observed) for seen in screened.log]
