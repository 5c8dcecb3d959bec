"""What of an object a gripper can take: narrow parts between the jaws, and the rim of wide ones.

Narrow parts: the gripper's two jaws close along a direction u in the table's plane. Seen along u, a
stretch is the piece of the object between two lines a finger's depth apart; it can be taken where

    its extent along u is at most the opening less a clearance on either side,
    both jaws, whose pads give a little, touch it side by side along a fair share of their depth,
    and the jaws have room beside it.

Its footprint is the rectangle of the piece, the clearances and the jaws: what must be beyond the
table's edge.

Flat parts: one jaw is under the overhang and one over it. Whatever is thin enough lies between the
jaws, however wide it is; what counts is whether the pads can hold it. Let the jaws press with F in
all, N_l from below and N_u from above, and let the center of mass be at d from the grasp point, d_x
along the fingers and d_y across. The object is level and at rest where

    N_l + N_u = F,   N_l - N_u = m g,   N_l r_l - N_u r_u = m g d

with the centers of pressure r_l, r_u within the pads, |x| <= a and |y| <= b. The left side of the
last equation is largest with the pressure at opposite ends of the two pads, so that there is a
solution exactly if

    m g |d_x| <= F a   and   m g |d_y| <= F b   (and m g <= F)

Beyond that the object tips about an end of a pad and pries the jaws open. Friction has no part in
it: gravity turns about a horizontal axis, friction of a level pad about its vertical normal only
(docs/theory/planning.md, section 5).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely
from shapely import Polygon, affinity

from gridpush_drake.dynamics.physics import GRAVITY
from gridpush_drake.errors import PlanningError, require_positive
from gridpush_drake.geometry.se2 import Array, make_direction, make_rotation, transform
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import DEFAULT_TOTAL_MASS
from gridpush_drake.planning.pregrasp.side_grasp import (
    SideGrasp,
    SideGripper,
    find_side_grasps,
    make_rectangles,
)
from gridpush_drake.planning.pregrasp.uncertainty import PlausibleMassSet
from gridpush_drake.planning.support_surface import SupportSurface

PIECE_SHARE = 0.95  # of the finger's depth that a piece must be long
CHORDS = 11  # lines across a piece that say where the jaws touch it
ANGLES = 36  # closing directions tried, evenly spaced over half a turn
STEP = 0.01  # m, between stretches tried in one closing direction


@dataclass(frozen=True)
class Gripper:
    """A parallel gripper, as far as it matters here; the figures are a Schunk WSG 50's with slim fingers.

    Attributes:
        opening: how far the jaws open, m.
        depth: of the fingers along the object, across the closing direction, m.
        clearance: between each open jaw and the object, m.
        thickness: of a jaw along the closing direction, m.
        pad: how far the jaws' pads give, m.
        hold: share of the depth along which both pads must touch.

    Raises:
        PlanningError: a value is out of range.
    """

    opening: float = 0.11
    depth: float = 0.03
    clearance: float = 0.004
    thickness: float = 0.010
    pad: float = 0.003
    hold: float = 0.35

    def __post_init__(self) -> None:
        lengths = {"opening": self.opening, "depth": self.depth, "thickness": self.thickness}
        require_positive(PlanningError, "gripper: ", "m", **lengths)
        if not 0 <= 2 * self.clearance < self.opening:
            raise PlanningError(
                f"gripper: clearance is {self.clearance!r}; expected 0 to half the opening (m)"
            )
        if not (0 <= self.hold <= 1 and self.pad >= 0):
            raise PlanningError(
                f"gripper: pad is {self.pad!r} and hold {self.hold!r}; expected a length >= 0 (m) and a share, 0 to 1"
            )


@dataclass(frozen=True, eq=False)
class GraspPart:
    """A stretch of the object that the gripper can take.

    Attributes:
        p_BG: (2,) middle of the stretch, body frame, m.
        closing: (2,) unit vector along which the jaws close, body frame.
        width: of the object between the jaws, m.
        footprint: (4, 2) corners of stretch, clearances and jaws, body frame, m, counterclockwise.
    """

    p_BG: Array
    closing: Array
    width: float
    footprint: Array


def find_grasp_parts(obj: GridObject, gripper: Gripper | None = None) -> list[GraspPart]:
    """Finds the narrow parts that the gripper can take, by closing direction and place; there may be none."""
    gripper = gripper or Gripper()
    parts: list[GraspPart] = []
    for angle in np.pi * np.arange(ANGLES) / ANGLES:
        parts.extend(_find_along(obj, gripper, float(angle)))
    return parts


def _find_along(obj: GridObject, gripper: Gripper, angle: float) -> Iterator[GraspPart]:
    """The parts for one closing direction, which is turned into the x axis."""
    outline = affinity.rotate(obj.outline, -angle, origin=(0.0, 0.0), use_radians=True)
    left, bottom, right, top = outline.bounds
    shapely.prepare(outline)
    spare = top - bottom - gripper.depth
    if spare < -(1 - PIECE_SHARE) * gripper.depth:
        return
    count = max(int(np.ceil(spare / STEP)), 0) + 1
    R = make_rotation(angle)
    for y in np.linspace(bottom, max(top - gripper.depth, bottom), count):
        strip = outline.intersection(shapely.box(left - 1.0, y, right + 1.0, y + gripper.depth))
        pieces = [piece for piece in getattr(strip, "geoms", [strip]) if isinstance(piece, Polygon)]
        for i, piece in enumerate(pieces):
            if _fits(piece, pieces[:i] + pieces[i + 1 :], gripper):
                yield _make_part(piece, y, R, gripper)


def _fits(piece: Polygon, others: list[Polygon], gripper: Gripper) -> bool:
    x0, y0, x1, y1 = piece.bounds
    width = x1 - x0
    if (
        width <= 0
        or width > gripper.opening - 2 * gripper.clearance
        or y1 - y0 < PIECE_SHARE * gripper.depth
    ):
        return False
    if _calc_held_share(piece, gripper.pad) < gripper.hold:
        return False
    reach = gripper.clearance + gripper.thickness
    sides = (shapely.box(x0 - reach, y0, x0, y1), shapely.box(x1, y0, x1 + reach, y1))
    return not any(side.intersects(other) for side in sides for other in others)


def _calc_held_share(piece: Polygon, pad: float) -> float:
    """Share of the piece's length along which both jaws touch, their pads given way by `pad`, m."""
    x0, y0, x1, y1 = piece.bounds
    heights = y0 + (y1 - y0) * (np.arange(CHORDS) + 0.5) / CHORDS
    ends = np.array([[[x0 - 1.0, y], [x1 + 1.0, y]] for y in heights])
    left, _, right, _ = shapely.bounds(shapely.intersection(piece, shapely.linestrings(ends))).T
    return float(((left <= x0 + pad) & (right >= x1 - pad)).mean())


def _make_part(piece: Polygon, y: float, R: Array, gripper: Gripper) -> GraspPart:
    x0, _, x1, _ = piece.bounds
    reach = gripper.clearance + gripper.thickness
    a, b = x0 - reach, x1 + reach
    corners = np.array([[a, y], [b, y], [b, y + gripper.depth], [a, y + gripper.depth]])
    middle = np.array([(x0 + x1) / 2, y + gripper.depth / 2])
    return GraspPart(R @ middle, R[:, 0].copy(), float(x1 - x0), corners @ R.T)


MM, PERCENT = 1e3, 100.0  # millimeters in a meter, percent in the whole

USED = 0.8
"""Of what the pads can hold, that is used: for the lift's acceleration, and for pads that do not
lie on evenly."""

RIM_DETAIL = 0.005  # m: finer teeth of the rim turn no heading
ALONG, DEEPER = (
    0.015,
    0.01,
)  # m between places along the rim, and between depths from it, that are tried


@dataclass(frozen=True, eq=False)
class PadLimit:
    """What the pads of a gripper can hold of an object.

    Raises:
        PlanningError: force or weight is not positive.
    """

    gripper: SideGripper  # its measures
    force: float  # with which both jaws press, N
    weight: float  # of the object, at most, N

    def __post_init__(self) -> None:
        require_positive(PlanningError, "pads: ", "N", force=self.force, weight=self.weight)

    @classmethod
    def of_object(cls, obj: GridObject, gripper: SideGripper, force: float) -> "PadLimit":
        """For an object's total mass as it is known beforehand, or the usual one."""
        return cls(gripper, force, GRAVITY * (obj.prior.total_mass or DEFAULT_TOTAL_MASS))

    def weigh(self, masses: PlausibleMassSet) -> "PadLimit":
        """The same with the greatest weight that measured forces leave an object that was not weighed."""
        heaviest = masses.max_total_mass
        return self if heaviest is None else replace(self, weight=GRAVITY * heaviest)

    @property
    def torques(self) -> tuple[float, float]:
        """The greatest torque of the weight that the pads hold, by an arm along the fingers and by one across, N m."""
        return self.force * self.gripper.pad_length / 2, self.force * self.gripper.pad_width / 2

    @property
    def max_arm(self) -> float:
        """How far from the center of mass the pads hold the object at most, with something to spare, m."""
        return USED * max(self.torques) / self.weight

    def calc_shares(self, p_BG: Array, headings: Array, centers: Array) -> Array:
        """What share of their limit the pads would have to hold, (k,); over 1 is more than they can.

        Args:
            p_BG: (k, 2) grasp points, body frame, m.
            headings: (k,) in which the fingers point, body frame, rad.
            centers: (v, 2) corners of a polygon that the center of mass is in, body frame, m; the
                worst counts.
        """
        along = make_direction(headings)
        arm = centers[None] - p_BG[:, None]
        d_x = np.abs(np.einsum("kvi,ki->kv", arm, along)).max(axis=1)
        d_y = np.abs(arm[..., 1] * along[:, :1] - arm[..., 0] * along[:, 1:]).max(axis=1)
        by_length, by_width = self.torques
        return (
            np.maximum(np.maximum(d_x / by_length, d_y / by_width), 1.0 / self.force) * self.weight
        )

    def holds(self, p_BG: Array, headings: Array, centers: Array) -> Array:
        """Whether the pads hold that with something to spare, (k,) bool; the arguments are those of `calc_shares`."""
        return np.asarray(self.calc_shares(p_BG, headings, centers) <= USED)

    def describe_best(self, parts: Sequence["FlatPart"], centers: Array) -> str:
        """Why the pads cannot hold the object by any of some parts, in the words of the one that asks for least."""
        shares = self.calc_shares(*_stack(parts), centers)
        best = int(np.argmin(shares))
        far = np.linalg.norm(centers - parts[best].p_BG, axis=1).max()
        by_length, by_width = self.torques
        return (
            f"the pads cannot hold it: at the best place that the gripper reaches, its {self.weight:.1f} N are up to "
            f"{MM * far:.0f} mm away, {PERCENT * shares[best]:.0f} % of what the pads hold ({by_length:.2f} N m along "
            f"the fingers, {by_width:.2f} N m across, at {self.force:g} N); {PERCENT * USED:.0f} % are allowed"
        )


@dataclass(frozen=True, eq=False)
class FlatPart(GraspPart):
    """A place at the rim; its `closing` is across the fingers, its `width` that of the jaws."""

    heading: float  # in which the fingers point, body frame, rad


def find_held_parts(parts: Sequence[FlatPart], pads: PadLimit, centers: Array) -> list[FlatPart]:
    """Those by which the pads hold the object, wherever in a polygon (v, 2) its center of mass is, body frame, m."""
    return [parts[i] for i in np.flatnonzero(pads.holds(*_stack(parts), centers)).tolist()]


def find_held_grasps(
    obj: GridObject, pose: Array, surface: SupportSurface, pads: PadLimit, aim: Array, height: float,
    masses: PlausibleMassSet, at_worst: bool,
) -> list[SideGrasp]:  # fmt: skip
    """Finds where the pads can take an object as it overhangs, and hold it.

    The order, and the arguments not named here, are those of `find_side_grasps`.

    Args:
        pads: that hold it.
        masses: that it may have.
        at_worst: whether it must be held whichever of them it has, or with its center of mass where
            it is estimated.
    """
    found = find_side_grasps(obj, pose, surface, pads.gripper, aim, height=height)
    if not found:
        return found
    points = np.array([grasp.p_BG for grasp in found])
    headings = np.array([grasp.approach for grasp in found]) - pose[2]
    centers = masses.center_of_mass_polygon if at_worst else masses.middle[None]
    held = pads.weigh(masses).holds(points, headings, centers)
    return [found[i] for i in np.flatnonzero(held)]


def _stack(parts: Sequence[FlatPart]) -> tuple[Array, Array]:
    """Their points (k, 2) and headings (k,)."""
    return np.array([part.p_BG for part in parts]).reshape(-1, 2), np.array(
        [part.heading for part in parts]
    )


def find_flat_parts(obj: GridObject, gripper: SideGripper) -> list[FlatPart]:
    """Finds where the gripper can take an object by its rim, the fingers pointing straight in.

    Along the rim each part is as far in as the pads need, as the gripper's body lets them, and in
    between.
    """
    inner = obj.outline.buffer(-gripper.margin)
    grown = obj.outline.buffer(gripper.object_clearance)
    for shape in (inner, grown):
        shapely.prepare(shape)
    parts = []
    for point, heading in _list_places(obj):
        inward = make_direction(heading)
        deepest = gripper.body_front - gripper.object_clearance
        shallowest = gripper.pad_length / 2 + gripper.margin
        for depth in np.linspace(
            shallowest, deepest, max(int(np.ceil((deepest - shallowest) / DEEPER)), 0) + 1
        ):
            part = _make_flat_part(point + depth * inward, heading, gripper)
            at = part.p_BG[None], np.array([heading])
            pads = make_rectangles(
                *at, -gripper.pad_length / 2, gripper.pad_length / 2, gripper.pad_width
            )[0]
            body = make_rectangles(
                *at, -gripper.body_back, -gripper.body_front, gripper.body_width
            )[0]
            if shapely.covers(inner, pads) and not shapely.intersects(grown, body):
                parts.append(part)
    return parts


def _list_places(obj: GridObject) -> Iterator[tuple[Array, float]]:
    """Points of the outer rim and the headings straight in from there."""
    ring = shapely.orient_polygons(obj.outline.simplify(RIM_DETAIL)).exterior
    corners = shapely.get_coordinates(ring)
    along = np.diff(corners, axis=0)
    ends = np.cumsum(np.linalg.norm(along, axis=1))
    for s in np.arange(ALONG / 2, ring.length, ALONG):
        edge = along[min(int(np.searchsorted(ends, s)), len(along) - 1)]
        yield np.array(ring.interpolate(s).coords[0]), float(np.arctan2(edge[0], -edge[1]))


def _make_flat_part(p_BG: Array, heading: float, gripper: SideGripper) -> FlatPart:
    """Its footprint, which must be beyond the edge, is the pads' and the lower jaw's, with its clearance."""
    spare = gripper.table_clearance
    back, front, half = (
        -gripper.pad_length / 2,
        gripper.jaw_reach + spare,
        gripper.jaw_width / 2 + spare,
    )
    corners = np.array([(back, -half), (front, -half), (front, half), (back, half)])
    across = make_direction(heading + np.pi / 2)
    return FlatPart(
        p_BG, across, gripper.jaw_width, transform(np.append(p_BG, heading), corners), heading
    )
