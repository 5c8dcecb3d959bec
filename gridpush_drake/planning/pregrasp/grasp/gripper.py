"""`Gripper`: a parallel gripper, described once; and `PadLimit`, what its pads can hold.

Every other form of a gripper is made from this record:

    gripper.yaml --GripperMeasures.make_gripper--> Gripper        (read by `station.robot.robot`)
    Gripper --limit_pads--> PadLimit                              (what its pads can hold)
    Gripper --GraspTrajectoryOptions.of_gripper-->                (how it carries out a grasp)

The gripper reaches in from the side, beyond the table's edge, one jaw under the object and one over
it. Seen from above, with the grasp point G in the middle between the pads and the x axis along the
heading in which the fingers point, it is made of rectangles:

    pads    [-pad_length/2, pad_length/2] x pad_width    must lie on the object
    jaws    [-body_front, jaw_reach] x jaw_width         the lower one must be clear of the table
    body    [-body_back, -body_front] x body_width       must be clear of the object and the table

It comes down a `standoff` behind the place where it closes, and goes in along its heading. What it
sweeps on its way is each rectangle, made longer by the standoff behind.

Where a narrow part of an object is sought, the jaws are taken to close level, in the table's plane,
one on either side of the part (`grasp_parts`).

What the pads can hold: let both jaws together press with F, from below with N_l and from above with
N_u, and let the center of mass be at d from the grasp point, d_x along the fingers and d_y across.
The object is level and at rest where

    N_l + N_u = F,   N_l - N_u = m g,   N_l r_l - N_u r_u = m g d

with the centers of pressure r_l, r_u within the pads, |x| <= a and |y| <= b. The left side of the
last equation is largest with the pressure at opposite ends of the two pads, so that there is a
solution exactly if

    m g |d_x| <= F a   and   m g |d_y| <= F b   and   m g <= F

Beyond that the object tips about an end of a pad and pries the jaws open. Friction has no part in
it: gravity turns the object about a horizontal axis, and the friction of a level pad turns it about
the vertical only (docs/theory/planning.md, section 5).
"""

from dataclasses import dataclass, fields, replace
from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

from gridpush_drake.dynamics.physics import GRAVITY
from gridpush_drake.errors import MAX_NUMBER, PlanningError, require_positive
from gridpush_drake.geometry.se2 import Array, make_direction, transform
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import DEFAULT_TOTAL_MASS
from gridpush_drake.planning.plausible_masses import PlausibleMassSet
from gridpush_drake.units import MM_PER_M, PERCENT_PER_ONE

USED_FRACTION = 0.8
"""Fraction of what the pads can hold that a plan uses. The rest is for the acceleration of the
lift, and for pads that do not lie on evenly."""


class Rectangle(NamedTuple):
    """A rectangle that moves with the grasp point, its sides along and across the heading.

    Attributes:
        back: where it begins, along the heading from the grasp point, m; usually negative.
        front: where it ends, along the heading from the grasp point, m.
        width: across the heading, m; half of it on either side of the grasp point.
    """

    back: float
    front: float
    width: float

    def list_corners(self) -> Array:
        """(4, 2) corners, counterclockwise, m: x along the heading, y across."""
        half = self.width / 2
        return np.array(
            [(self.back, -half), (self.front, -half), (self.front, half), (self.back, half)]
        )

    def place(self, points: Array, headings: Array) -> NDArray[np.object_]:
        """Polygons (k,) of the rectangle at grasp points (k, 2), m, with headings (k,), rad."""
        return shapely.polygons(transform(np.column_stack([points, headings]), self.list_corners()))


@dataclass(frozen=True)
class Gripper:
    """A parallel gripper; by default the one in `models/grippers/wsg_50`.

    Attributes:
        opening: how far the jaws open, one over and one under the object, m.
        pad_length: of the pads' contact area along the heading, m.
        pad_width: of the pads' contact area across the heading, m.
        jaw_reach: how far the jaws reach beyond the grasp point, m.
        jaw_width: of a jaw across the heading, m.
        body_front: from the grasp point back to the front of the gripper's body, m.
        body_width: across the heading, m: of body, bracket or pushing finger, the widest.
        body_back: from the grasp point back to the end of body, bracket and finger, m.
        max_force: greatest force with which both jaws press together, N.
        closing_speed: greatest change of the opening, m/s.
        standoff: from where the gripper comes down to where it closes, m.
        table_clearance: least distance of the gripper from the table's edge, m.
        object_clearance: least distance of body, bracket and finger from the object, and of the
            jaws too while the gripper comes down, m.
        height_clearance: least gap between each open jaw and the object, m.
        pad_margin: how far inside the object's outline the pads must lie, m.
        level_opening: how far the jaws open where they close level on a narrow part, m. By default
            the 110 mm of a Schunk WSG 50; the model of it opens to 100 mm, see `opening`.
        finger_depth: of a narrow part, how long a stretch the fingers take, m.
        side_clearance: gap between each open jaw and a narrow part, m.
        jaw_thickness: of a jaw along the direction in which it closes on a narrow part, m.
        pad_give: how far the pads yield to an uneven side of a narrow part, m.
        min_held_share: fraction of `finger_depth` along which both pads must touch a narrow part.

    Raises:
        PlanningError: a value is out of range.
    """

    # What the gripper measures, and can do; a gripper.yaml says these.
    opening: float = 0.1
    pad_length: float = 0.024
    pad_width: float = 0.012
    jaw_reach: float = 0.015
    jaw_width: float = 0.02
    body_front: float = 0.0669
    body_width: float = 0.064
    body_back: float = 0.202
    max_force: float = 80.0
    closing_speed: float = 0.15
    # How it reaches in from the side, and what it keeps clear of.
    standoff: float = 0.1
    table_clearance: float = 0.004
    object_clearance: float = 0.008
    height_clearance: float = 0.01
    pad_margin: float = 0.0005
    # How it takes a narrow part.
    level_opening: float = 0.11
    finger_depth: float = 0.03
    side_clearance: float = 0.004
    jaw_thickness: float = 0.010
    pad_give: float = 0.003
    min_held_share: float = 0.35

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            unit = FIELD_UNITS.get(field.name, "m")
            if field.name not in MAY_BE_ZERO:
                require_positive(PlanningError, "gripper: ", unit, **{field.name: value})
            elif not 0 <= value <= MAX_NUMBER:
                raise PlanningError(
                    f"gripper: {field.name} is {value!r}; expected a number >= 0 ({unit})"
                )
        if not self.jaw_reach < self.standoff or not self.body_front < self.body_back:
            raise PlanningError(
                "gripper: expected jaw_reach less than standoff, and body_front less than "
                "body_back (m)"
            )
        if not 2 * self.side_clearance < self.level_opening:
            raise PlanningError(
                f"gripper: side_clearance is {self.side_clearance!r}; "
                "expected less than half of level_opening (m)"
            )
        if self.min_held_share > 1:
            raise PlanningError(
                f"gripper: min_held_share is {self.min_held_share!r}; expected a fraction, 0 to 1"
            )

    @property
    def pads(self) -> Rectangle:
        """The pads, where they hold the object."""
        return Rectangle(back=-self.pad_length / 2, front=self.pad_length / 2, width=self.pad_width)

    @property
    def body(self) -> Rectangle:
        """Body, bracket and finger, where the pads hold the object."""
        return Rectangle(back=-self.body_back, front=-self.body_front, width=self.body_width)

    @property
    def swept_body(self) -> Rectangle:
        """What body, bracket and finger sweep on the way in."""
        return Rectangle(
            back=-self.body_back - self.standoff, front=-self.body_front, width=self.body_width
        )

    @property
    def swept_jaw(self) -> Rectangle:
        """What the lower jaw sweeps on the way in."""
        return Rectangle(
            back=-self.body_front - self.standoff, front=self.jaw_reach, width=self.jaw_width
        )

    @property
    def jaws_coming_down(self) -> Rectangle:
        """The jaws while the gripper comes down, before it goes in."""
        return Rectangle(
            back=-self.body_front - self.standoff,
            front=self.jaw_reach - self.standoff,
            width=self.jaw_width,
        )

    @property
    def max_thickness(self) -> float:
        """Greatest height of an object that fits between the open jaws, m."""
        return self.opening - 2 * self.height_clearance

    @property
    def max_part_width(self) -> float:
        """Greatest width of a narrow part, m."""
        return self.level_opening - 2 * self.side_clearance

    @property
    def side_room(self) -> float:
        """Room that an open jaw needs beside a narrow part, m."""
        return self.side_clearance + self.jaw_thickness

    def check_thickness(self, obj: GridObject, height: float) -> None:
        """Raises PlanningError where an object of a height, m, is too thick for the gripper."""
        if height > self.max_thickness:
            raise PlanningError(
                f"{obj.name}: {height:g} m thick; expected at most the gripper's opening less its "
                f"clearances, {self.max_thickness:g} m"
            )

    def limit_force(self, force: float) -> float:
        """The force with which the jaws press if `force` is asked for, N."""
        return min(force, self.max_force)

    def limit_pads(self, obj: GridObject, force: float) -> "PadLimit":
        """Makes the limit of what the pads can hold of an object.

        Args:
            obj: the object; it weighs what is known beforehand, or else `DEFAULT_TOTAL_MASS`.
            force: with which both jaws together press, N.

        Raises:
            PlanningError: the force is not positive.
        """
        weight = GRAVITY * (obj.prior.total_mass or DEFAULT_TOTAL_MASS)
        return PadLimit(gripper=self, force=force, weight=weight)


MAY_BE_ZERO = (
    "table_clearance",
    "object_clearance",
    "height_clearance",
    "pad_margin",
    "side_clearance",
    "pad_give",
    "min_held_share",
)
"""Fields of `Gripper` that may be zero; all the others are positive."""

FIELD_UNITS = {"max_force": "N", "closing_speed": "m/s", "min_held_share": "1"}
"""Units of those fields of `Gripper` that are not in m."""


@dataclass(frozen=True, eq=False)
class PadLimit:
    """What the pads of a gripper can hold of an object, by the equations above.

    Attributes:
        gripper: whose pads they are; a and b are half their length and half their width.
        force: F, with which both jaws together press, N.
        weight: m g, greatest weight that the object may have, N.

    Raises:
        PlanningError: force or weight is not positive.
    """

    gripper: Gripper
    force: float
    weight: float

    def __post_init__(self) -> None:
        require_positive(PlanningError, "pads: ", "N", force=self.force, weight=self.weight)

    def weigh(self, masses: PlausibleMassSet) -> "PadLimit":
        """Makes the limit for the greatest weight that the object may have.

        It differs from this limit if the object was not weighed, but forces were measured.
        """
        heaviest = masses.max_total_mass
        return self if heaviest is None else replace(self, weight=GRAVITY * heaviest)

    @property
    def torques(self) -> tuple[float, float]:
        """F a and F b: greatest torques of the weight that the pads hold, N m.

        The first is for an arm of the weight along the fingers, the second for one across.
        """
        return self.force * self.gripper.pad_length / 2, self.force * self.gripper.pad_width / 2

    @property
    def max_arm(self) -> float:
        """Greatest distance of the grasp from the center of mass that a plan allows, m.

        It is the distance along the longer side of the pads.
        """
        return USED_FRACTION * max(self.torques) / self.weight

    def calc_fractions(self, p_BG: Array, headings: Array, centers: Array) -> Array:
        """Calculates what fraction of their limit the pads would have to hold.

        Args:
            p_BG: (k, 2) grasp points, body frame, m.
            headings: (k,) in which the fingers point, body frame, rad.
            centers: (v, 2) corners of a polygon that the center of mass is in, body frame, m. The
                worst of them counts.

        Returns:
            (k,); what is above 1, the pads cannot hold.
        """
        along = make_direction(headings)
        d = centers[None] - p_BG[:, None]
        d_x = np.abs(np.einsum("kvi,ki->kv", d, along)).max(axis=1)
        d_y = np.abs(d[..., 1] * along[:, :1] - d[..., 0] * along[:, 1:]).max(axis=1)
        Fa, Fb = self.torques
        # m g |d_x| / (F a), m g |d_y| / (F b) and m g / F: the greatest of them must be at most 1.
        return np.maximum(np.maximum(d_x / Fa, d_y / Fb), 1.0 / self.force) * self.weight

    def holds(self, p_BG: Array, headings: Array, centers: Array) -> Array:
        """Whether the pads hold the object at some grasp points with something to spare.

        They do if they need no more than `USED_FRACTION` of their limit. Arguments as of
        `calc_fractions`; returns (k,) bool.
        """
        return np.asarray(self.calc_fractions(p_BG, headings, centers) <= USED_FRACTION)

    def describe_best(self, p_BG: Array, headings: Array, centers: Array) -> str:
        """Says why the pads can hold the object at none of some places.

        It gives the figures of the place that asks least of the pads. Arguments as of
        `calc_fractions`.
        """
        fractions = self.calc_fractions(p_BG, headings, centers)
        best = int(np.argmin(fractions))
        farthest = np.linalg.norm(centers - p_BG[best], axis=1).max()
        Fa, Fb = self.torques
        return (
            f"the pads cannot hold it: at the best place that the gripper reaches, its "
            f"{self.weight:.1f} N are up to {MM_PER_M * farthest:.0f} mm away, "
            f"{PERCENT_PER_ONE * fractions[best]:.0f} % of what the pads hold ({Fa:.2f} N m along "
            f"the fingers, {Fb:.2f} N m across, at {self.force:g} N); "
            f"{PERCENT_PER_ONE * USED_FRACTION:.0f} % are allowed"
        )
