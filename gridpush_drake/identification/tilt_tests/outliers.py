"""About which line an object tilted in each press, and mass, center and friction with that.

A press at the table's edge is a tilt test. It may be none, or another one than it seems
(`docs/theory/identification.md`, section 11): an object on feet first rocks about a line of two
supports, and a press on which something slid says nothing. So each press is judged by what all
others, the forces of the pushes and the lifts say. With the tilting lines L = (L_1, ..., L_P), the
evidence is, by Laplace's approximation,

    log p(data, L) = sum_i log p(L_i) p(way_i | L_i) - loss - log det H / 2
                     - sum over counting presses of log(s_i sqrt(2 pi))
                     - sum over left-out presses of log(F_i log(F_max / F_min))

A press that is left out might have shown any force, evenly in its logarithm. The way that the tip
went on freely tells edge and supports apart: rocking ends after g (a + D) / D, with g the gap below
the underside, which is evenly distributed in its logarithm.

The lines are searched by changing one at a time as long as the evidence grows. The estimate is the
mean of all that were tried, by their evidence, and so is as unsure as they disagree.

The pushes are judged, too. They show the center of friction, and where a few feet of very different
friction bear an object, that may be far from the center of mass. So if many weighings agree badly
with the pushes, it is also supposed that these tell nothing of the center, which is little probable
beforehand, and the evidence decides.
"""

from math import log, pi, sqrt

import numpy as np

from gridpush_drake.errors import IdentificationError
from gridpush_drake.geometry.se2 import transform, transform_back
from gridpush_drake.identification.absolute.estimate import (
    CENTER_INDICES,
    LINE_DISTANCE,
    LINE_SPREAD,
    LOG_MASS,
    WANTED_UNKNOWNS,
    AbsoluteEstimate,
    AbsoluteFit,
    MassProblem,
    TiltingLine,
    TiltTestCheck,
    fit_absolute,
)
from gridpush_drake.pushes.weighings import TiltTest

SUPPORT_PRIOR = 0.3
"""Probability beforehand that the last force at which an object gave way is that of a support line,
if the tip was pressed on as far as is safe; before it is looked how far it then went."""

UNKNOWN_WAY_PRIOR = 0.05
"""Probability beforehand that the object tilted about a support line, for presses of which it is
not known how far the tip went on."""

ROCKED_FACTOR = 0.3
"""Factor on that probability where the object was already seen to rock, and to be stiff again."""

NONE_PRIOR = 0.02
"""Probability beforehand that a press is none, as where something slid."""

FORCE_RANGE = (0.3, 50.0)
"""Least and greatest force that a press which is none may show, N."""

UNDERSIDE_GAPS = (2e-5, 1e-3)
"""Least and greatest height of an underside above the table, m."""

RARE_GAP = 0.01
"""Probability of a gap beyond these."""

MIN_WEIGHT = 0.03
"""Weight, relative to the most probable tilting lines, below which others are not averaged."""

MIN_AGREEMENT_PROBABILITY = 0.2
"""Probability of observations that agree as badly as they do with tilts about the edge in all
presses, below which it is supposed that most presses may be wrong."""

CENTER_WRONG_PRIOR = 0.05
"""Probability beforehand that the pushes tell nothing of the center of mass."""

MIN_WEIGHINGS = 5
"""Number of weighings from which on the pushes are doubted: three tell mass and center of mass."""

MAX_SWEEPS = 6
"""Greatest number of times that the line of each press is tried to be changed."""

Lines = tuple[TiltingLine, ...]


def estimate_absolute(problem: MassProblem) -> AbsoluteEstimate:
    """Estimates mass, center of mass and mean friction, and judges each press.

    Args:
        problem: what was observed, and what was held beforehand.

    Returns:
        The estimate, without radius of gyration.

    Raises:
        IdentificationError: nothing was weighed, and no force was measured.
    """
    if not len(problem.log) and problem.force is None:
        raise IdentificationError("weighings: there are none; expected at least one, or a force")
    searches = [search_lines(problem)]
    outlying = problem.suppose_center_outlier()
    if outlying is not None and _disagree(searches[0]):
        searches.append(search_lines(outlying))
    fits = [one for tried in searches for one in tried.values()]
    evidence = np.array([calc_log_evidence(one) for one in fits])
    weight = np.exp(evidence - evidence.max())
    best = fits[int(np.argmax(evidence))]
    tried = searches[1 if best.problem.is_center_outlier else 0]
    counted = [(one, w) for one, w in zip(fits, weight, strict=True) if w >= MIN_WEIGHT]
    total = sum(w for _, w in counted)
    fractions = [w / total for _, w in counted]
    # The mean and the covariance of a mixture of normals.
    means = np.array([one.u[:WANTED_UNKNOWNS] for one, _ in counted])
    mean = np.array(fractions) @ means
    covariance = np.zeros((WANTED_UNKNOWNS, WANTED_UNKNOWNS))
    for (one, _), fraction, own in zip(counted, fractions, means, strict=True):
        off = own - mean
        covariance += fraction * (
            one.covariance[:WANTED_UNKNOWNS, :WANTED_UNKNOWNS] + np.outer(off, off)
        )
    probability = [
        sum(
            fraction
            for (one, _), fraction in zip(counted, fractions, strict=True)
            if one.problem.tilting_lines[i] == line
        )
        for i, line in enumerate(best.problem.tilting_lines)
    ]
    return AbsoluteEstimate(
        mean=mean,
        covariance=covariance,
        presses=len(problem.log.presses),
        lifts=len(problem.log.lifts),
        pushes=0 if problem.force is None else problem.force.pushes,
        agreement=best.agreement,
        tests=tuple(judge_press(best, tried, i, p) for i, p in enumerate(probability)),
        center_outlier_probability=sum(
            fraction
            for (one, _), fraction in zip(counted, fractions, strict=True)
            if one.problem.is_center_outlier
        ),
    )


def _disagree(tried: dict[Lines, AbsoluteFit]) -> bool:
    """Whether many weighings agree badly with pushes, whatever the tilting lines are."""
    best = max(tried.values(), key=calc_log_evidence)
    log = best.problem.log
    counting = sum(line != TiltingLine.NONE for line in best.problem.tilting_lines)
    enough = counting + len(log.lifts) >= MIN_WEIGHINGS
    return enough and best.agreement < MIN_AGREEMENT_PROBABILITY


def search_lines(problem: MassProblem) -> dict[Lines, AbsoluteFit]:
    """Searches the tilting lines of all presses; returns the fits of all that were tried."""
    count = len(problem.log.presses)
    edges = (TiltingLine.EDGE,) * count
    tried = {edges: fit_absolute(problem.suppose(edges))}
    _climb(problem, edges, tried)
    if tried[edges].agreement < MIN_AGREEMENT_PROBABILITY:
        # If most presses are wrong, the few right ones are found only by adding one to none.
        none = (TiltingLine.NONE,) * count
        tried[none] = fit_absolute(problem.suppose(none))
        _climb(problem, none, tried)
    return tried


def _climb(problem: MassProblem, start: Lines, tried: dict[Lines, AbsoluteFit]) -> None:
    """Changes the line of one press at a time as long as the evidence grows.

    Args:
        problem: the observations.
        start: lines to begin with, which were tried.
        tried: the fits of all lines that were tried; more are added.
    """
    best = start
    most = calc_log_evidence(tried[best])
    for _ in range(MAX_SWEEPS):
        changed = False
        for i in range(len(start)):
            for line in TiltingLine:
                lines = (*best[:i], line, *best[i + 1 :])
                if lines not in tried:
                    tried[lines] = fit_absolute(problem.suppose(lines), near=tried[best])
                evidence = calc_log_evidence(tried[lines])
                if evidence > most:
                    best = lines
                    most = evidence
                    changed = True
        if not changed:
            return


def calc_log_evidence(fit: AbsoluteFit) -> float:
    """Calculates how well observations and tilting lines go together, see above."""
    problem = fit.problem
    total = -fit.loss - fit.log_determinant / 2
    if problem.is_center_outlier:
        total += log(CENTER_WRONG_PRIOR / (1 - CENTER_WRONG_PRIOR))
    for press, line in zip(problem.log.presses, problem.tilting_lines, strict=True):
        supports = UNKNOWN_WAY_PRIOR
        if press.free_way is not None:
            supports = SUPPORT_PRIOR * (1.0 if press.rock_force is None else ROCKED_FACTOR)
        if line == TiltingLine.NONE:
            total += log(NONE_PRIOR) - log(press.force * log(FORCE_RANGE[1] / FORCE_RANGE[0]))
            continue
        total -= log(press.force_std * sqrt(2 * pi))
        if line == TiltingLine.EDGE:
            total += log(1 - NONE_PRIOR - supports)
        else:
            total += log(supports * calc_way_probability(press, get_support_distance(fit, press)))
    return total


def get_support_distance(fit: AbsoluteFit, press: TiltTest) -> float:
    """Distance of the support line of a press, which tilted about it, from the edge, m."""
    problem = fit.problem
    rest = problem.find_support_rest(press)
    first = problem.size - len(problem.support_rests)
    return float(LINE_DISTANCE * np.exp(LINE_SPREAD * fit.u[first + rest]))


def calc_way_probability(press: TiltTest, distance: float) -> float:
    """Probability that an object which rocks goes on as freely as it did, or farther.

    Args:
        press: the press.
        distance: D, of the support line from the edge, m.
    """
    if not press.free_way:
        return 1.0
    gap = press.free_way * distance / (press.arm + distance)
    least, most = UNDERSIDE_GAPS
    fraction = log(most / gap) / log(most / least)
    return float(np.clip(fraction, RARE_GAP, 1.0))


def judge_press(
    best: AbsoluteFit, tried: dict[Lines, AbsoluteFit], index: int, probability: float
) -> TiltTestCheck:
    """Judges a press by what all others say.

    Args:
        best: the fit with the most probable tilting lines.
        tried: fits with other lines.
        index: of the press.
        probability: that its line is that.
    """
    problem = best.problem
    press = problem.log.presses[index]
    lines = problem.tilting_lines
    without = (*lines[:index], TiltingLine.NONE, *lines[index + 1 :])
    others = tried.get(without) or fit_absolute(problem.suppose(without), near=best)
    r, row = others.problem.calc_press(others.u, index, TiltingLine.EDGE)
    spread = float(np.sqrt(1 + row @ others.covariance @ row))
    x, y = transform_back(press.pose, press.place[None])[0].tolist()
    return TiltTestCheck(
        place=(x, y),
        arm=press.arm,
        force=press.force,
        expected=press.force + r * press.force_std,
        residual=-r / spread,
        line=lines[index],
        probability=float(probability),
        support_distance=_find_support(best, index),
    )


def _find_support(best: AbsoluteFit, index: int) -> float | None:
    """Finds how far inside the edge an object rocked, m; None where no rocking is known.

    A press that shows both forces tells m g b by that about the edge, and then by the first one
    F1 = m g (b - D) / (a + D) the support line, as if that were parallel to the edge.
    """
    problem = best.problem
    press = problem.log.presses[index]
    line = problem.tilting_lines[index]
    if line == TiltingLine.SUPPORTS:
        return get_support_distance(best, press)
    if line == TiltingLine.NONE or press.rock_force is None:
        return None
    weight = problem.gravity * float(np.exp(best.u[LOG_MASS]))
    center = transform(press.pose, best.u[CENTER_INDICES][None])[0]
    b = float(press.normal @ (press.edge_point - center))
    return (weight * b - press.rock_force * press.arm) / (weight + press.rock_force)
