"""Which press comes next, until mass and center of mass are known well enough.

The object is laid over the edge in 24 directions, from its longest one on. (With four, along and
across, either way round, narrow objects could be pressed along only: across, no place is far enough
beyond the edge, and slanted ones tell of both.) Before the first press its center of mass may be
anywhere that pushes and friction bounds allow, so that little of it may hang over. Each press tells
more, and the next may go further.

Of all presses that are safe, the one comes next after which mass and center are expected to be
known best. With S the covariance of (log m, c, log mu) now, a press that will show the force F with
the derivatives J and the variance r leaves

    S' = S - S J^T J S / (J S J^T + r),    r = s_F² + ((F + m g) s_e / a)² + (m g / a)² (s_p² + ...)

with the errors of force, edge and pose, and what is made small is

    S'(log m) / (what is enough of it)² + trace S'(c) / (what is enough of it)²
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
import shapely

from gridpush_drake.dynamics.physics import GRAVITY
from gridpush_drake.geometry.se2 import Array, make_rotation, turn_left
from gridpush_drake.identification.absolute import (
    CENTER,
    LOG_MASS,
    AbsoluteEstimate,
    PoseNoise,
)
from gridpush_drake.identification.result import Identification
from gridpush_drake.identification.weighed_model import believe_before
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.weighing.plan import (
    Edge,
    PlannedPress,
    PressRules,
    list_rests,
)
from gridpush_drake.planning.weighing.region import cut_to_ellipse

HEAVIER = 1.5
"""Factor on the mass that is supposed, for each press that the object withstood."""


SURE_SIGMAS = 3.5
"""Number of standard deviations by which the expected force of a press may be too high while the
object still surely lies still."""

SURE_SHARE = 0.75
"""Share of the least force that is possible up to which the tip presses fast."""

HEADINGS = 24
"""Number of headings in which an object is laid over an edge, evenly spaced."""


@dataclass(frozen=True)
class SequenceOptions:
    """When enough is known, and how sure a plan is to be.

    Attributes:
        rules: what each press keeps to.
        sigmas: how many standard deviations the center of mass may be off from where presses say,
            in every direction.
        mass_std: relative standard deviation of the mass that is enough.
        center_std: standard deviation of the center of mass that is enough, in its worst direction,
            m.
        min_gain: share of what is open that the next press must be expected to take away.
        max_presses: greatest number of presses.
    """

    rules: PressRules = field(default_factory=PressRules)
    sigmas: float = 3.5
    mass_std: float = 0.0125
    center_std: float = 0.00125
    min_gain: float = 0.03
    max_presses: int = 10


def calc_headings(obj: GridObject, edge: Edge) -> Array:
    """Calculates headings, rad, the first with the outline's longest direction across the edge."""
    corners = shapely.get_coordinates(obj.outline.minimum_rotated_rectangle)
    sides = np.diff(corners[:3], axis=0)
    longest = sides[np.argmax((sides**2).sum(axis=1))]
    along = float(np.arctan2(longest[1], longest[0]))
    return np.asarray(
        edge.angle - along + 2 * np.pi / HEADINGS * np.arange(HEADINGS), dtype=np.float64
    )


def plan_next_press(
    found: Identification,
    centers: Array,
    edge: Edge,
    top: float,
    presses: int = 0,
    withstood: int = 0,
    options: SequenceOptions | None = None,
) -> PlannedPress | None:
    """Plans the press that comes next.

    Args:
        found: what is known, with the weighings so far.
        centers: (V, 2) corners of the region that the center of mass is in by all that pushes and
            friction bounds say, body frame, m.
        edge: the edge.
        top: height of the object's top above the table, m.
        presses: number of presses so far.
        withstood: number of those since the last tilt at which the object did not tilt.
        options: when enough is known.

    Returns:
        Where the object is to lie and where to press; None where enough is known, no safe
        press tells more, or there were enough of them.
    """
    options = options or SequenceOptions()
    if presses >= options.max_presses or is_known(found, options):
        return None
    rules = options.rules
    region = centers
    belief = found.weighed or believe_before(found)
    if found.weighed is not None:
        region = cut_to_ellipse(
            centers, belief.center_of_mass, belief.center_covariance, options.sigmas
        )
    if belief.presses or belief.pushes:
        rules = replace(rules, mass=belief.total_mass)
    rules = replace(rules, mass=rules.mass * HEAVIER**withstood)

    # The whole finger is to press on the object; only where no such press is left, a press is made
    # on a part that is too narrow for that. A heavy object may lie still wherever its center of
    # mass is farthest from the edge. If there is no other press, one is made that tilts it with the
    # center where it is expected.
    for is_narrow, surely in product((False, True), (True, False)):
        rules = replace(rules, is_narrow=is_narrow)
        rests = [
            planned
            for heading in calc_headings(found.obj, edge).tolist()
            for planned in list_rests(found.obj, region, heading, edge, top, rules, surely=surely)
        ]
        best = _choose_most_telling(belief, rests, rules, options)
        if best is not None:
            return with_sure_force(best, belief, rules)
    return None


def _choose_most_telling(
    belief: AbsoluteEstimate,
    rests: Sequence[PlannedPress],
    rules: PressRules,
    options: SequenceOptions,
) -> PlannedPress | None:
    """Chooses the press that is expected to leave least open; None where none tells enough."""
    least = (1 - options.min_gain) * calc_open(belief.covariance, options)
    best: PlannedPress | None = None
    for planned in rests:
        left = calc_left_open(belief, planned, rules, options)
        if left < least:
            best = planned
            least = left
    return best


def with_sure_force(
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
    sure = SURE_SHARE * force * float(np.exp(-SURE_SIGMAS * relative))
    return replace(planned, target=replace(planned.target, sure_force=sure))


def calc_left_open(
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
    return calc_open(left, options)


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
    a = target.calc_arm(np.array(target.place))
    b = float(n @ (np.array(target.edge_point) - planned.pose[:2] - arm))
    force = weight * b / a
    J = np.zeros(len(belief.mean))
    J[LOG_MASS] = force
    J[CENTER] = -weight / a * (n @ R)
    by_edge = (force + weight) / a * noise.edge
    by_place = weight / a * noise.position
    by_angle = weight / a * float(n @ turn_left(arm)) * noise.angle
    return force, J, rules.force_std**2 + by_edge**2 + by_place**2 + by_angle**2


def calc_open(S: Array, options: SequenceOptions) -> float:
    """Calculates how much a covariance (4, 4) leaves open of mass and center, see above."""
    mass = float(S[LOG_MASS, LOG_MASS]) / options.mass_std**2
    return mass + float(np.trace(S[CENTER, CENTER])) / options.center_std**2


def is_known(found: Identification, options: SequenceOptions) -> bool:
    """Whether mass and center of mass are known well enough."""
    absolute = found.weighed
    if absolute is None:
        return False
    mass_std = float(np.sqrt(absolute.covariance[LOG_MASS, LOG_MASS]))
    worst = float(np.sqrt(np.linalg.eigvalsh(absolute.center_covariance).max()))
    return mass_std <= options.mass_std and worst <= options.center_std
