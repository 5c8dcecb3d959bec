"""Objects that look the same, or nearly, when they are turned.

A plate looks the same turned by half a turn, and a wrench with nearly equal ends nearly so. One
picture does not tell the two answers apart; but an object goes on from where it was, and a model
can say where a push takes it. The tracker weighs both answers, see docs/theory/perception.md,
section 3.
"""

from typing import NamedTuple

import numpy as np
from shapely import Polygon, affinity

from gridpush_drake.geometry.se2 import Array, transform, wrap_angle

COMPARED_ANGLES = 72
"""Number of angles at which an outline is compared with itself, evenly over a full turn."""

MIN_SYMMETRY_IOU = 0.4
"""Least intersection over union of an outline with itself, turned, at which the two are looked at
as two answers; a picture of what differs more tells them apart without doubt."""

DEGREES_OF_FREEDOM = 4.0
"""Degrees of freedom of Student's distribution of where an object is about where it is expected."""

SAME_POSE_IOU = 0.98
"""Intersection over union from which on two answers are one where nothing was seen before: no
picture tells which end of the object is which, and either end may be called the first."""

MIN_PROMINENCE = 0.02
"""A turned outline is an answer by itself if it overlaps better by this than at some angle on
either side of it. A disc, which overlaps equally at all angles, has no other answers."""


class SymmetricPose(NamedTuple):
    """A way to turn an object after which it looks much as it did.

    Attributes:
        pose: (3,) X_BA, m and rad: an object at X_WB looks much as it does at X_WB X_BA.
        overlap: intersection over union of the two outlines.
    """

    pose: Array
    overlap: float


class ExpectedPose(NamedTuple):
    """Where an object is expected to be, before a picture is looked at.

    Attributes:
        pose: (3,) (x, y, theta), W, m and rad.
        place_deviation: standard deviation of the place of the outline's middle, m.
        turn_deviation: standard deviation of the angle, rad.
    """

    pose: Array
    place_deviation: float
    turn_deviation: float


def find_symmetries(outline: Polygon) -> tuple[SymmetricPose, ...]:
    """Finds the ways to turn an outline after which it looks much as it did.

    Args:
        outline: outline in B, m.

    Returns:
        The ways, those after which it looks most alike first; not turning it is none of them.
    """
    step = 2 * np.pi / COMPARED_ANGLES
    middle = outline.centroid
    overlaps = np.ones(COMPARED_ANGLES)
    for k in range(1, COMPARED_ANGLES):
        turned = affinity.rotate(outline, k * step, origin=middle, use_radians=True)
        common = outline.intersection(turned).area
        overlaps[k] = common / (2 * outline.area - common)

    # Peaks of the overlap that are high, and that stand out from the angles about them.
    found: list[SymmetricPose] = []
    center = np.array(middle.coords[0])
    for k in range(1, COMPARED_ANGLES):
        overlap = overlaps[k]
        rises = overlap >= overlaps[k - 1] and overlap > overlaps[(k + 1) % COMPARED_ANGLES]
        if overlap < MIN_SYMMETRY_IOU or not rises:
            continue
        if not _stands_out(overlaps, k):
            continue
        theta = k * step
        # The middle of the turned outline stays where it is: p + R center = center.
        p = center - transform([0.0, 0.0, theta], center[None])[0]
        found.append(SymmetricPose(np.array([*p, theta]), float(overlap)))
    found.sort(key=lambda way: -way.overlap)
    return tuple(found)


def _stands_out(overlaps: Array, k: int) -> bool:
    """Says whether the overlap falls by MIN_PROMINENCE on both sides before it rises."""
    for side in (-1, 1):
        lower = False
        for distance in range(1, COMPARED_ANGLES):
            other = overlaps[(k + side * distance) % COMPARED_ANGLES]
            if other > overlaps[k]:
                break
            if other < overlaps[k] - MIN_PROMINENCE:
                lower = True
                break
        if not lower:
            return False
    return True


def calc_pose_innovation(expected: ExpectedPose, pose: Array, middle: Array) -> float:
    """Calculates how little an object is expected at a pose.

    Tails are those of Student's distribution: where a model is far off, it says little of which of
    two answers is right.

    Args:
        expected: where it is expected.
        pose: (3,) the pose.
        middle: (2,) the outline's middle, B, m.

    Returns:
        The negative logarithm of the density, up to a constant; 0 at the pose expected.
    """
    here = transform(pose, middle[None])[0]
    there = transform(expected.pose, middle[None])[0]
    place = np.linalg.norm(here - there) / expected.place_deviation
    turn = wrap_angle(pose[2] - expected.pose[2]) / expected.turn_deviation
    total = np.log1p(place**2 / DEGREES_OF_FREEDOM) + np.log1p(turn**2 / DEGREES_OF_FREEDOM)
    return float((DEGREES_OF_FREEDOM + 1) / 2 * total)
