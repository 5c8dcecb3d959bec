"""Answers to where an object is in a picture, when several poses explain it nearly as well.

A wrench with nearly equal ends looks much the same turned by half a turn. Each registration of such
a picture is one answer, with how likely it is. `tracking` finds and weighs them; the theory is in
docs/theory/perception.md, section 3.
"""

from typing import NamedTuple

import numpy as np

from gridpush_drake.geometry.se2 import Array, wrap_angle
from gridpush_drake.perception.tracking.registration import Fit

MAX_LOG_RATIO = 7.0
"""An answer is left out if the logarithm of its likelihood is below that of the likeliest by more
than this: it is a thousand times less likely."""

SAME_POSE = 0.2
"""Two answers whose angles differ by less than this are the same, rad."""


class OtherPose(NamedTuple):
    """A pose at which the object would look nearly as it does.

    Attributes:
        pose: (3,) (x, y, theta), W, m and rad.
        log_prior_ratio: logarithm of how likely it is over the likelihood of the pose that was
            told, 0 or less.
    """

    pose: Array
    log_prior_ratio: float


class PoseHypothesis(NamedTuple):
    """A registration and how likely it is, among others of the same picture.

    Attributes:
        fit: the registration.
        weight: logarithm of its likelihood, up to a constant of the picture.
    """

    fit: Fit
    weight: float


def choose_hypotheses(hypotheses: list[PoseHypothesis]) -> list[PoseHypothesis]:
    """Sorts answers, the likeliest first, and leaves out those beyond doubt and those given twice.

    Args:
        hypotheses: answers of one picture.

    Returns:
        Some of them, one or more.
    """
    kept: list[PoseHypothesis] = []
    for hypothesis in sorted(hypotheses, key=lambda each: -each.weight):
        if kept and hypothesis.weight < kept[0].weight - MAX_LOG_RATIO:
            break
        turns = [abs(wrap_angle(hypothesis.fit.pose[2] - each.fit.pose[2])) for each in kept]
        if all(turn > SAME_POSE for turn in turns):
            kept.append(hypothesis)
    return kept


def list_others(hypotheses: list[PoseHypothesis]) -> tuple[OtherPose, ...]:
    """Lists all answers but the likeliest, which is the first, for the next frame."""
    best = hypotheses[0].weight
    return tuple(OtherPose(each.fit.pose, each.weight - best) for each in hypotheses[1:])


def mix_covariances(hypotheses: list[PoseHypothesis]) -> Array:
    """Calculates the covariance (3, 3) of a pose that may be one of several.

    Args:
        hypotheses: what it may be; it is told as the first of them.

    Returns:
        The mean square distance from the first pose: its own covariance where there is no doubt.
    """
    # Likelihoods, normalized, are the answers' probabilities.
    weights = np.exp([each.weight - hypotheses[0].weight for each in hypotheses])
    weights /= weights.sum()
    total = np.zeros((3, 3))
    for weight, hypothesis in zip(weights, hypotheses, strict=True):
        off = hypothesis.fit.pose - hypotheses[0].fit.pose
        off[2] = wrap_angle(off[2])
        total += weight * (hypothesis.fit.covariance + np.outer(off, off))
    return total
