"""What of an object a gripper can take: its narrow parts, and the rim of what is wide everywhere.

Narrow parts: the gripper's two jaws close level, along a direction u in the table's plane. A
*stretch* of the object is what lies between two lines along u, the fingers' depth apart. Each piece
of it can be taken where

    its extent along u is at most the opening less a clearance on either side,
    both jaws, whose pads give a little, touch it side by side along a fair fraction of their depth,
    and the jaws have room beside it.

The *footprint* of a part is what must be beyond the table's edge before the gripper can take it: a
rectangle about the piece, the clearances and the jaws.

Flat parts: the gripper reaches in from the side, one jaw under the overhang and one over it.
Whatever is thin enough lies between the jaws, however wide it is; what counts is whether the pads
can hold it (`gripper.PadLimit`).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from shapely import Polygon, affinity

from gridpush_drake.geometry.se2 import Array, make_direction, make_rotation, transform
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.plausible_masses import PlausibleMassSet
from gridpush_drake.planning.pregrasp.grasp.gripper import Gripper, PadLimit, Rectangle
from gridpush_drake.planning.pregrasp.grasp.side_grasp import SideGrasp, find_side_grasps
from gridpush_drake.planning.support_surface import SupportSurface

MIN_PIECE_FRACTION = 0.95
"""A piece must be at least this long, as a fraction of the fingers' depth."""

CHORD_COUNT = 11
"""Number of lines across a piece, evenly spaced, at which it is checked whether the jaws touch."""

CLOSING_DIRECTIONS = 36
"""Number of closing directions that are tried, evenly spaced over half a turn."""

STRETCH_SPACING = 0.01
"""Greatest distance between neighboring stretches that are tried in one closing direction, m."""

RIM_DETAIL = 0.005
"""The rim is simplified by this much before headings are taken from it, m, so that small teeth do
not turn them."""

RIM_SPACING = 0.015
"""Distance along the rim between places that are tried, m."""

DEPTH_SPACING = 0.01
"""Greatest distance between depths that are tried at one place of the rim, m."""

LINE_EXTENSION = 1.0
"""By how much lines are made to reach beyond an object on either side, m."""


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


@dataclass(frozen=True, eq=False)
class FlatPart(GraspPart):
    """A place at the rim where the gripper can reach in from the side.

    What a `GraspPart` says of the jaws means here: `closing` is across the fingers, and `width` is
    the width of the jaws.

    Attributes:
        heading: direction in which the fingers point, body frame, rad.
    """

    heading: float


def find_grasp_parts(obj: GridObject, gripper: Gripper | None = None) -> list[GraspPart]:
    """Finds the narrow parts that the gripper can take, by closing direction and place.

    There may be none.
    """
    gripper = gripper or Gripper()
    parts: list[GraspPart] = []
    for angle in np.pi * np.arange(CLOSING_DIRECTIONS) / CLOSING_DIRECTIONS:
        parts.extend(_find_along(obj, gripper, float(angle)))
    return parts


def _find_along(obj: GridObject, gripper: Gripper, angle: float) -> Iterator[GraspPart]:
    """Finds the parts for one closing direction, at `angle` (rad) from the body's x axis."""
    # Turn the object so that the closing direction is the x axis, and a stretch a level strip.
    outline = affinity.rotate(obj.outline, -angle, origin=(0.0, 0.0), use_radians=True)
    left, bottom, right, top = outline.bounds
    shapely.prepare(outline)
    spare = top - bottom - gripper.finger_depth
    if spare < -(1 - MIN_PIECE_FRACTION) * gripper.finger_depth:
        return
    count = max(int(np.ceil(spare / STRETCH_SPACING)), 0) + 1
    R = make_rotation(angle)
    for y in np.linspace(bottom, max(top - gripper.finger_depth, bottom), count):
        strip = outline.intersection(
            shapely.box(left - LINE_EXTENSION, y, right + LINE_EXTENSION, y + gripper.finger_depth)
        )
        # A strip across a fork or a hole has several pieces; each may be a part by itself.
        pieces = [piece for piece in getattr(strip, "geoms", [strip]) if isinstance(piece, Polygon)]
        for i, piece in enumerate(pieces):
            if _can_take(piece, pieces[:i] + pieces[i + 1 :], gripper):
                yield _make_part(piece, y, R, gripper)


def _can_take(piece: Polygon, others: list[Polygon], gripper: Gripper) -> bool:
    """Whether the jaws, closing along x, can take a piece of a strip beside its `others`."""
    x0, y0, x1, y1 = piece.bounds
    width = x1 - x0
    if width <= 0 or width > gripper.max_part_width:
        return False
    if y1 - y0 < MIN_PIECE_FRACTION * gripper.finger_depth:
        return False
    if _calc_held_fraction(piece, gripper.pad_give) < gripper.min_held_share:
        return False
    # The open jaws must have room on both sides of the piece.
    left = shapely.box(x0 - gripper.side_room, y0, x0, y1)
    right = shapely.box(x1, y0, x1 + gripper.side_room, y1)
    return not any(jaw.intersects(other) for jaw in (left, right) for other in others)


def _calc_held_fraction(piece: Polygon, pad_give: float) -> float:
    """Fraction of a piece's length along which both jaws touch it; pads yield by `pad_give`, m."""
    x0, y0, x1, y1 = piece.bounds
    heights = y0 + (y1 - y0) * (np.arange(CHORD_COUNT) + 0.5) / CHORD_COUNT
    lines = shapely.linestrings(
        [[[x0 - LINE_EXTENSION, y], [x1 + LINE_EXTENSION, y]] for y in heights]
    )
    left, _, right, _ = shapely.bounds(shapely.intersection(piece, lines)).T
    return float(((left <= x0 + pad_give) & (right >= x1 - pad_give)).mean())


def _make_part(piece: Polygon, y: float, R: Array, gripper: Gripper) -> GraspPart:
    """Makes the part of a piece.

    Args:
        piece: of a strip, in coordinates in which the jaws close along x.
        y: where the strip begins, m.
        R: (2, 2) rotation from these coordinates into the body frame.
        gripper: the gripper.
    """
    x0, _, x1, _ = piece.bounds
    left = x0 - gripper.side_room
    right = x1 + gripper.side_room
    top = y + gripper.finger_depth
    corners = np.array([[left, y], [right, y], [right, top], [left, top]])
    middle = np.array([(x0 + x1) / 2, y + gripper.finger_depth / 2])
    return GraspPart(
        p_BG=R @ middle, closing=R[:, 0].copy(), width=float(x1 - x0), footprint=corners @ R.T
    )


def find_flat_parts(obj: GridObject, gripper: Gripper) -> list[FlatPart]:
    """Finds where the gripper can take an object by its rim, the fingers pointing straight in.

    At each place of the rim several depths are tried, from the least that the pads need to the
    greatest that the gripper's body lets them.
    """
    inner = obj.outline.buffer(-gripper.pad_margin)
    grown = obj.outline.buffer(gripper.object_clearance)
    shapely.prepare(inner)
    shapely.prepare(grown)
    shallowest = gripper.pad_length / 2 + gripper.pad_margin
    deepest = gripper.body_front - gripper.object_clearance
    count = max(int(np.ceil((deepest - shallowest) / DEPTH_SPACING)), 0) + 1
    parts = []
    for point, heading in _list_rim_places(obj):
        inward = make_direction(heading)
        for depth in np.linspace(shallowest, deepest, count):
            part = _make_flat_part(point + depth * inward, heading, gripper)
            pads = gripper.pads.place(part.p_BG[None], np.array([heading]))[0]
            body = gripper.body.place(part.p_BG[None], np.array([heading]))[0]
            if shapely.covers(inner, pads) and not shapely.intersects(grown, body):
                parts.append(part)
    return parts


def _list_rim_places(obj: GridObject) -> Iterator[tuple[Array, float]]:
    """Lists places of the outer rim.

    Yields:
        A point (2,), body frame, m, and the heading that points straight in from there, rad.
    """
    ring = shapely.orient_polygons(obj.outline.simplify(RIM_DETAIL)).exterior
    corners = shapely.get_coordinates(ring)
    edges = np.diff(corners, axis=0)
    ends = np.cumsum(np.linalg.norm(edges, axis=1))
    for s in np.arange(RIM_SPACING / 2, ring.length, RIM_SPACING):
        edge = edges[min(int(np.searchsorted(ends, s)), len(edges) - 1)]
        # The ring is counterclockwise, so that inside is to the left of each edge: (-y, x).
        yield np.array(ring.interpolate(s).coords[0]), float(np.arctan2(edge[0], -edge[1]))


def _make_flat_part(p_BG: Array, heading: float, gripper: Gripper) -> FlatPart:
    """Makes the part at a grasp point (2,), body frame, m, with the fingers along `heading`, rad.

    Its footprint is that of the pads and the lower jaw, with the jaw's clearance from the table.
    """
    spare = gripper.table_clearance
    footprint = Rectangle(
        back=-gripper.pad_length / 2,
        front=gripper.jaw_reach + spare,
        width=2 * (gripper.jaw_width / 2 + spare),
    )
    return FlatPart(
        p_BG=p_BG,
        closing=make_direction(heading + np.pi / 2),
        width=gripper.jaw_width,
        footprint=transform(np.append(p_BG, heading), footprint.list_corners()),
        heading=heading,
    )


def find_held_parts(parts: Sequence[FlatPart], pads: PadLimit, centers: Array) -> list[FlatPart]:
    """Finds the flat parts by which the pads hold the object.

    Args:
        parts: to choose from.
        pads: what the pads can hold.
        centers: (v, 2) corners of a polygon, body frame, m; the object must be held wherever in it
            the center of mass is.
    """
    held = pads.holds(*stack_flat_parts(parts), centers)
    return [parts[i] for i in np.flatnonzero(held).tolist()]


def stack_flat_parts(parts: Sequence[FlatPart]) -> tuple[Array, Array]:
    """Grasp points (k, 2), body frame, m, and headings (k,), rad, of some parts."""
    points = np.array([part.p_BG for part in parts]).reshape(-1, 2)
    headings = np.array([part.heading for part in parts])
    return points, headings


def find_held_grasps(
    obj: GridObject,
    pose: Array,
    surface: SupportSurface,
    pads: PadLimit,
    aim: Array,
    height: float,
    masses: PlausibleMassSet,
    at_worst: bool,
) -> list[SideGrasp]:
    """Finds where the pads can take an object as it overhangs, and hold it.

    The order, and the arguments not named here, are those of `find_side_grasps`.

    Args:
        pads: what the pads can hold.
        masses: that the object may have.
        at_worst: True if it must be held whichever of these masses it has; False if it must be held
            with its center of mass where it is estimated.
    """
    found = find_side_grasps(obj, pose, surface, pads.gripper, aim, height=height)
    if not found:
        return found
    points = np.array([grasp.p_BG for grasp in found])
    headings = np.array([grasp.approach for grasp in found]) - pose[2]
    centers = masses.center_of_mass_polygon if at_worst else masses.middle[None]
    held = pads.weigh(masses).holds(points, headings, centers)
    return [found[i] for i in np.flatnonzero(held)]
