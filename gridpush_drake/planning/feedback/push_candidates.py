"""Draws what the search for a plan tries (`push_search`): strokes, and changes of the plan."""

import numpy as np

from gridpush_drake.dynamics.kernels.steering.plan_search import (
    ANGLE,
    BEND,
    CHANGE_POINTS,
    LENGTH,
    PLACE,
    PRIMITIVE_SIZE,
    ROUND,
    SPIN,
    WALK,
)
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.planning.feedback.follow_options import FollowOptions
from gridpush_drake.planning.feedback.push_search import PushMoves
from gridpush_drake.planning.pushed_object import FeedbackFinger

SPEED_RANGE = (0.4, 1.0)
"""Least and greatest speed of a stroke, as a fraction of the finger's."""

PRIMITIVE_ANGLES = (-1.0, 1.0)
"""Least and greatest angle of a stroke from the inward normal, rad."""

BEND_STD = 0.06
"""Standard deviation of a stroke's turn in a decision, rad."""

SPIN_STD = 0.06
"""Standard deviation of a turn of a finger that is no disc in a decision, rad."""

AT_ONCE = 0.25
"""Fraction of the strokes that push at once, from where the finger is."""

FROM_NOW = 0.4
"""Fraction of the strokes that replace the whole plan; the others keep some of its beginning."""

CHANGE_SIZES = (0.0002, 0.015)
"""Least and greatest standard deviation of a change of places, m."""


def draw_candidates(
    rng: np.random.Generator, options: FollowOptions, finger: FeedbackFinger
) -> PushMoves:
    """Draws as many candidates as the options say, for one decision."""
    period = options.period
    # strokes from all around, most of them after going there
    count = options.strokes
    strokes = np.zeros((count, PRIMITIVE_SIZE))
    strokes[:, PLACE] = rng.uniform(0.0, 1.0, count)
    strokes[:, ANGLE] = rng.uniform(*PRIMITIVE_ANGLES, count)
    strokes[:, LENGTH] = period * finger.speed * draw_log_uniform(rng, SPEED_RANGE, count)
    strokes[:, BEND] = rng.normal(0.0, BEND_STD, count)
    strokes[:, WALK] = period * finger.walking_speed
    strokes[:, ROUND] = rng.choice([-1.0, 1.0], count)
    at_once = rng.random(count) < AT_ONCE
    strokes[at_once, PLACE] = -1.0
    strokes[at_once, ANGLE] = rng.uniform(-np.pi, np.pi, int(at_once.sum()))
    # later cuts are more often useful: a plan's beginning is good already
    cuts = np.sqrt(rng.random(count))
    cuts[rng.random(count) < FROM_NOW] = 0.0
    # changes of all sizes: the largest find something new, the smallest make it exact
    size = finger.coordinates
    changes = rng.standard_normal((options.changes, CHANGE_POINTS * size))
    turn = period * finger.turning_speed
    if finger.shape is not None:
        # a turn moves the finger's farthest point as much as a shift does
        changes[:, size - 1 :: size] /= finger.reach
        strokes[:, SPIN] = np.clip(rng.normal(0.0, SPIN_STD, count), -turn, turn)
    return PushMoves(
        strokes=strokes,
        cuts=cuts,
        changes=changes,
        scales=draw_log_uniform(rng, CHANGE_SIZES, options.changes),
        longest=float(period * finger.walking_speed),
        turn=float(turn),
        most_yaw=float(finger.most_yaw),
    )


def draw_log_uniform(rng: np.random.Generator, bounds: tuple[float, float], count: int) -> Array:
    """Draws numbers (count,) between two bounds, whose logarithms are spread evenly."""
    return np.exp(rng.uniform(np.log(bounds[0]), np.log(bounds[1]), count))
