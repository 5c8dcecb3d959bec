"""What a press is expected to tell of mass and center of mass, and what is enough.

With S the covariance of (log m, c, log mu) now, a press that will show the force F with the
derivatives J and the variance r leaves

    S' = S - S J^T J S / (J S J^T + r),    r = s_F² + ((F + m g) s_e / a)² + (m g / a)² (s_p² + ...)

with the errors of force, edge and pose. What presses are to make small is

    S'(log m) / (what is enough of it)² + trace S'(c) / (what is enough of it)²

An object is laid over the edge in 24 directions, from its longest one on. (With four, along and
across, either way round, narrow objects could be pressed along only: across, no place is far enough
beyond the edge, and slanted ones tell of both.) Which press comes next is decided in
`planning.pregrasp.weighing_planner`.
"""

from dataclasses import dataclass, field, replace

import numpy as np
import shapely

from gridpush_drake.dynamics.physics import GRAVITY
from gridpush_drake.geometry.se2 import Array, make_rotation, turn_left
from gridpush_drake.identification.absolute.estimate import (
    CENTER_INDICES,
    LOG_MASS,
    AbsoluteEstimate,
    PoseNoise,
)
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.weighing.plan import Edge, PlannedPress, PressRules

MASS_INCREASE = 1.5
"""Factor on the mass that is supposed, for each press that the object withstood."""

NO_TIP_SIGMAS = 3.5
"""Number of standard deviations by which the expected force of a press may be too high while the
object still surely lies still."""

NO_TIP_FRACTION = 0.75
"""Fraction of the least force that is possible up to which the tip presses fast."""

HEADING_COUNT = 24
"""Number of headings in which an object is laid over an edge, evenly spaced."""


@dataclass(frozen=True)
class SequenceOptions:
    """What presses keep to, and when enough is known.

    Attributes:
        rules: what each press keeps to.
        mass_std: relative standard deviation of the mass that is enough.
        center_std: standard deviation of the center of mass that is enough, along x and along y, m.
    """

    rules: PressRules = field(default_factory=PressRules)
    mass_std: float = 0.0125
    center_std: float = 0.00125


def calc_headings(obj: GridObject, edge: Edge) -> Array:
    """Calculates headings, rad, the first with the outline's longest direction across the edge."""
    corners = shapely.get_coordinates(obj.outline.minimum_rotated_rectangle)
    sides = np.diff(corners[:3], axis=0)
    longest = sides[np.argmax((sides**2).sum(axis=1))]
    along = float(np.arctan2(longest[1], longest[0]))
    return np.asarray(
        edge.angle - along + 2 * np.pi / HEADING_COUNT * np.arange(HEADING_COUNT), dtype=np.float64
    )


def with_no_tip_force(
    planned: PlannedPress, belief: AbsoluteEstimate, rules: PressRules
) -> PlannedPress:
    """Says with a press up to which force the object surely lies still.

    Args:
        planned: the press.
        belief: what is known now; the force is that of its mass, whatever the rules suppose.
        rules: with the standard deviation of the force.
    """
    force, J, variance = _predict_force(belief, planned, rules)
    # The force is a product of what is known to so many percent: its logarithm is about normal.
    relative = float(np.sqrt(J @ belief.covariance @ J + variance)) / force
    sure = NO_TIP_FRACTION * force * float(np.exp(-NO_TIP_SIGMAS * relative))
    return replace(planned, target=replace(planned.target, no_tip_force=sure))


def calc_remaining_uncertainty(
    belief: AbsoluteEstimate, planned: PlannedPress, rules: PressRules, options: SequenceOptions
) -> float:
    """Calculates how much a press is expected to leave open of mass and center, see above.

    Args:
        belief: what is known now.
        planned: the press.
        rules: with the standard deviation of its force.
        options: with what is enough.
    """
    _, J, r = _predict_force(belief, planned, rules)
    S = belief.covariance
    SJ = S @ J
    left = S - np.outer(SJ, SJ) / (float(J @ SJ) + r)
    return calc_normalized_uncertainty(left, options)


def _predict_force(
    belief: AbsoluteEstimate, planned: PlannedPress, rules: PressRules
) -> tuple[float, Array, float]:
    """Predicts the force of a press.

    Returns:
        F, N; its derivatives (4,) by log m, the center of mass and log mu; and the variance of what
        is measured, N².
    """
    noise = PoseNoise()
    target = planned.target
    n = target.normal
    R = make_rotation(planned.pose[2])
    arm = R @ belief.center_of_mass
    weight = GRAVITY * belief.total_mass
    # F = m g b / a and its derivatives.
    a = target.calc_lever_arm(np.array(target.place))
    b = float(n @ (np.array(target.edge_point) - planned.pose[:2] - arm))
    force = weight * b / a
    J = np.zeros(len(belief.mean))
    J[LOG_MASS] = force
    J[CENTER_INDICES] = -weight / a * (n @ R)
    by_edge = (force + weight) / a * noise.edge
    by_place = weight / a * noise.position
    by_angle = weight / a * float(n @ turn_left(arm)) * noise.angle
    return force, J, rules.force_std**2 + by_edge**2 + by_place**2 + by_angle**2


def calc_normalized_uncertainty(S: Array, options: SequenceOptions) -> float:
    """Calculates how much a covariance (4, 4) leaves open of mass and center, see above."""
    mass = float(S[LOG_MASS, LOG_MASS]) / options.mass_std**2
    return mass + float(np.trace(S[CENTER_INDICES, CENTER_INDICES])) / options.center_std**2
