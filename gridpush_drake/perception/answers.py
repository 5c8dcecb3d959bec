"""Answers to where an object is in a picture, when several poses explain it nearly as well.

A wrench with nearly equal ends looks much the same turned by half a turn. Each registration of such
a picture is one answer, with how likely it is. `tracking` finds and weighs them; the theory is in
docs/theory/perception.md, section 3.
"""

from typing import NamedTuple

import numpy as np

from gridpush_drake.geometry.se2 import Array, wrap_angle
from gridpush_drake.perception.registration import Fit

MAX_DOUBT = 7.0
"""An answer is left out if the logarithm of its likelihood is below that of the likeliest by more
than this: it is a thousand times less likely."""

SAME_ANSWER = 0.2
"""Two answers whose angles differ by less than this are the same, rad."""


class OtherPose(NamedTuple):
    """A pose at which the object would look nearly as it does.

    Attributes:
        pose: (3,) (x, y, theta), W, m and rad.
        log_odds: logarithm of how likely it is over the likelihood of the pose that was told, 0 or
            less.
    """

    pose: Array
    log_odds: float


class Answer(NamedTuple):
    """A registration and how likely it is, among others of the same picture.

    Attributes:
        fit: the registration.
        weight: logarithm of its likelihood, up to a constant of the picture.
    """

    fit: Fit
    weight: float


def choose_answers(answers: list[Answer]) -> list[Answer]:
    """Sorts answers, the likeliest first, and leaves out those beyond doubt and those given twice.

    Args:
        answers: answers of one picture.

    Returns:
        Some of them, one or more.
    """
    kept: list[Answer] = []
    for answer in sorted(answers, key=lambda each: -each.weight):
        if kept and answer.weight < kept[0].weight - MAX_DOUBT:
            break
        turns = [abs(wrap_angle(answer.fit.pose[2] - each.fit.pose[2])) for each in kept]
        if all(turn > SAME_ANSWER for turn in turns):
            kept.append(answer)
    return kept


def list_others(answers: list[Answer]) -> tuple[OtherPose, ...]:
    """Lists all answers but the likeliest, which is the first, for the next frame."""
    best = answers[0].weight
    return tuple(OtherPose(each.fit.pose, each.weight - best) for each in answers[1:])


def mix_covariances(answers: list[Answer]) -> Array:
    """Calculates the covariance (3, 3) of a pose that may be one of several.

    Args:
        answers: what it may be; it is told as the first of them.

    Returns:
        The mean square distance from the first pose: its own covariance where there is no doubt.
    """
    # Likelihoods, normalized, are the answers' probabilities.
    weights = np.exp([each.weight - answers[0].weight for each in answers])
    weights /= weights.sum()
    total = np.zeros((3, 3))
    for weight, answer in zip(weights, answers, strict=True):
        off = answer.fit.pose - answers[0].fit.pose
        off[2] = wrap_angle(off[2])
        total += weight * (answer.fit.covariance + np.outer(off, off))
    return total
