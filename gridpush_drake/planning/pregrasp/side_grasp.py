"""Where a gripper can take an object from beyond the table's edge, one jaw under the overhang and one over it.

Seen from above, with the grasp point G in the middle between the pads and the x axis along the
heading in which the fingers point, the gripper is made of rectangles:

    pads       [-pad_length/2, pad_length/2] x pad_width   wholly on the object, a margin inside its
    outline jaws       [-body_front, jaw_reach] x jaw_width        the lower one clear of the table
    the rest   [-body_back, -body_front] x body_width      clear of the object, and of the table

For each of many headings the places where the pads and the lower jaw may be are found exactly
(`find_places`); what is left is looked at one by one. Seen along the heading, with x along it and y
across, a rectangle [back, front] x [-w, w] about the point (x, y) crosses no edge of a polygon
exactly if for every edge, cut to the strip y - w .. y + w and there reaching from xa to xb,

    x <= xa - front   or   x >= xb - back

so that on a line of constant y what is free is what a union of intervals leaves. On wide objects
evenly spaced lines and headings will do. A handle hardly wider than the pads asks for the very
heading, the bisector of its two sides, and for the very lines: on which a side of the pads touches
a corner of the handle, and between two such lines.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray
from shapely.geometry.base import BaseGeometry

from gridpush_drake.errors import PlanningError
from gridpush_drake.geometry.se2 import (
    Array,
    check_vector,
    make_rotation,
    transform,
    transform_shape,
    wrap_angle,
)
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.support_surface import SupportSurface

TOUCH = 1e-6  # m, for round-off: rectangles may cross an edge by as much
NEARLY_PARALLEL = np.radians(12)  # between the two sides of a handle

SAME = np.radians(0.2)
"""Between headings of which only that of the longer sides is tried: across the pads' length it is a
tenth of a millimeter."""

ALONG = 4
"""Times as far apart as the lines, places on a line are tried: its ends and what is nearest to the
aim are exact."""


@dataclass(frozen=True, eq=False)
class Walls:
    """Edges that a rectangle must not cross."""

    edges: Array  # (e, 2, 2) their ends, m
    back: float  # of the rectangle along the heading, from the grasp point, m
    front: float  # likewise
    width: float  # of the rectangle, m


def get_edges(shape: BaseGeometry) -> Array:
    """The edges (e, 2, 2) of all rings of polygons, counterclockwise about what is inside."""
    rings = shapely.get_rings(shapely.get_parts(shapely.orient_polygons(shape)))
    corners, ring = shapely.get_coordinates(rings, return_index=True)
    within = np.flatnonzero(ring[:-1] == ring[1:])
    return np.stack([corners[within], corners[within + 1]], axis=1)


@dataclass(frozen=True, eq=False)
class Handle:
    """A narrow stretch of an object."""

    heading: float  # along it, rad
    corners: Array  # (k, 2) ends of its sides, m


def find_handles(edges: Array, shortest: float, widest: float) -> list[Handle]:
    """Narrow handles: pairs of edges that face each other, those of longer edges first, one of each heading.

    Args:
        edges: (e, 2, 2) of polygons, counterclockwise, m.
        shortest: edge that counts, m.
        widest: handle that counts, m.

    Returns:
        Handles whose heading, the sides' bisector, is in [0, pi).
    """
    along = edges[:, 1] - edges[:, 0]
    length = np.linalg.norm(along, axis=1)
    edges, along, length = (array[length >= shortest] for array in (edges, along, length))
    angle = np.arctan2(along[:, 1], along[:, 0])
    i, j = np.triu_indices(len(angle), 1)
    slant = np.remainder(angle[j] - angle[i], 2 * np.pi) - np.pi
    near = np.abs(slant) <= NEARLY_PARALLEL
    i, j, slant = i[near], j[near], slant[near]
    # what lies to the left of an edge is inside
    across = along[i, 0] * (edges[j] - edges[i, :1])[..., 1].mean(axis=1)
    across -= along[i, 1] * (edges[j] - edges[i, :1])[..., 0].mean(axis=1)
    gap = shapely.distance(shapely.linestrings(edges[i]), shapely.linestrings(edges[j]))
    rank = np.where((gap <= widest) & (across > 0), np.minimum(length[i], length[j]), 0.0)
    found: list[Handle] = []
    for k in np.argsort(-rank, kind="stable")[: np.count_nonzero(rank)]:
        heading, corners = (
            float((angle[i[k]] + slant[k] / 2) % np.pi),
            edges[[i[k], j[k]]].reshape(4, 2),
        )
        for n, other in enumerate(found):
            if abs((heading - other.heading + np.pi / 2) % np.pi - np.pi / 2) <= SAME:
                found[n] = Handle(other.heading, np.concatenate([other.corners, corners]))
                break
        else:
            found.append(Handle(heading, corners))
    return found


def find_places(
    shape: BaseGeometry,
    pads: Walls,
    others: Sequence[Walls],
    tries: Sequence[tuple[float, Array | None]],
    aim: Array,
    step: float,
) -> tuple[Array, Array]:
    """Points (k, 2), m, and headings (k,), rad, with which the pads lie on an object.

    Args:
        shape: what the pads must lie on, m.
        pads: the pads, and the edges of `shape`; the grasp point lies in them.
        others: further rectangles and what they must not cross.
        tries: headings, rad, with the corners (k, 2) of a narrow handle, to look there only, or
            None for everywhere.
        aim: (2,) point near which places are wanted, m.
        step: between lines, at most, m.
    """
    headings = np.array([heading for heading, _ in tries])
    R = make_rotation(headings)
    y_aim = aim @ R[:, :, 1].T
    across = pads.edges.reshape(-1, 2) @ R[:, :, 1].T
    half = pads.width / 2
    chosen = [
        _choose_lines(across[:, k], half, y_aim[k], step)
        if corners is None
        else _choose_lines_in_handle(corners @ R[k, :, 1], half, step)
        for k, (_, corners) in enumerate(tries)
    ]
    lines = np.concatenate([np.empty(0), *chosen])
    counts = np.array([len(ys) for ys in chosen], dtype=int)
    R, headings = (np.repeat(array, counts, axis=0) for array in (R, headings))
    blocked = [_block(lines, wall, R) for wall in (pads, *others)]
    row, low, high = _find_gaps(
        *(np.concatenate(ends, axis=1) for ends in zip(*blocked, strict=True))
    )
    inside = shapely.contains_xy(shape, *_turn_back((low + high) / 2, lines[row], R[row]).T)
    row, low, high = row[inside], low[inside], high[inside]
    count = np.ceil((high - low) / (ALONG * step)).astype(int) + 1
    which, share = _divide(count)
    x = low[which] + (high - low)[which] * share / np.maximum(count - 1, 1)[which]
    x = np.append(x, np.clip(R[row, :, 0] @ aim, low, high))
    row = np.append(row[which], row)
    return _turn_back(x, lines[row], R[row]), headings[row]


def _turn_back(x: Array, y: Array, R: Array) -> Array:
    """Points (k, 2) in W of those along and across headings, whose rotations are (k, 2, 2)."""
    return x[:, None] * R[:, :, 0] + y[:, None] * R[:, :, 1]


def _choose_lines(corners: Array, half: float, aim: float, step: float) -> Array:
    """The y on which to look in an outline whose corners are at y (k,)."""
    low, high = corners.min() + half, corners.max() - half
    if high < low:
        return np.empty(0)
    even = np.linspace(low, high, int(np.ceil((high - low) / step)) + 1)
    return np.append(even, np.clip(aim, low, high))


def _choose_lines_in_handle(corners: Array, half: float, step: float) -> Array:
    """The y on which to look in a handle whose corners are at y (k,): touching one, and between."""
    touching = np.sort(np.concatenate([corners + half, corners - half]))
    touching = touching[
        (touching >= corners.min() + half - TOUCH) & (touching <= corners.max() - half + TOUCH)
    ]
    if not len(touching):
        return touching
    touching = touching[np.append(True, np.diff(touching) > TOUCH)]
    gaps = np.diff(touching)
    count = np.ceil(gaps / step).astype(int)
    which, share = _divide(count)
    return np.concatenate([touching, touching[which] + gaps[which] * (share + 0.5) / count[which]])


def _divide(count: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Indices of (k,) counts, each as often as it counts, and how often it was there before."""
    which = np.repeat(np.arange(len(count)), count)
    return which, np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)


def _block(lines: Array, wall: Walls, R: Array) -> tuple[Array, Array]:
    """Where on the lines (l,), whose rotations are (l, 2, 2), the edges begin and cease to block, two (l, e).

    Infinite where they do not.
    """
    x0, x1, y0, y1 = (R[:, :, axis] @ wall.edges[:, end].T for axis in (0, 1) for end in (0, 1))
    low, high = ((lines + side * (wall.width / 2 - TOUCH))[:, None] for side in (-1, 1))
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.clip(((low - y0) / (y1 - y0), (high - y0) / (y1 - y0)), 0.0, 1.0)
    xa, xb = x0 + (x1 - x0) * share
    met = (np.maximum(y0, y1) > low) & (np.minimum(y0, y1) < high)
    begin = np.where(met, np.minimum(xa, xb) - wall.front + TOUCH, np.inf)
    return begin, np.where(met, np.maximum(xa, xb) - wall.back - TOUCH, -np.inf)


def _find_gaps(begin: Array, end: Array) -> tuple[NDArray[np.int64], Array, Array]:
    """Bounded gaps between intervals (l, e) on every line: their line's index, and where they begin and end."""
    order = np.argsort(begin, axis=1)
    begin = np.take_along_axis(begin, order, axis=1)
    end = np.maximum.accumulate(np.take_along_axis(end, order, axis=1), axis=1)
    row, k = np.nonzero((begin[:, 1:] >= end[:, :-1]) & np.isfinite(begin[:, 1:]))
    return row, end[row, k], begin[row, k + 1]


HEADINGS = 72  # tried over a full turn, beside those of narrow handles
MIN_EDGE = 0.25  # of the pads' length, that the sides of a narrow handle are long
ARC_DETAIL = 4  # pieces of a quarter turn, where what is within or about the outline is round
MAX_SLANT = np.radians(75)  # between a heading and the shortest way in to the table

SLANT_SPARE = np.radians(5)
"""For the directions between those in which the table is seen from corners of the overhang."""

STEP = 0.005  # m, between grasp points tried


@dataclass(frozen=True)
class SideGripper:
    """A parallel gripper seen from above while it reaches in from the side, m; as `models/grippers/wsg_50` has it.

    Attributes:
        opening: of the jaws, over and under the object.
        pad_length: of the pads' contact along the heading.
        pad_width: across it.
        jaw_reach: of the jaws beyond the grasp point.
        jaw_width: across the heading.
        body_front: from the grasp point back to the gripper's body.
        body_width: of body, bracket and finger, whichever is widest, across the heading.
        body_back: from the grasp point back to the farthest of them.
        standoff: from where the gripper comes down to the grasp point.
        table_clearance: of the lower jaw.
        object_clearance: of body, bracket and finger; of everything while it comes down.
        height_clearance: of each open jaw, over and under the object.
        margin: of the pads inside the outline.

    Raises:
        PlanningError: a measure is not a positive number; a clearance or margin is negative.
    """

    opening: float = 0.1
    pad_length: float = 0.024
    pad_width: float = 0.012
    jaw_reach: float = 0.015
    jaw_width: float = 0.02
    body_front: float = 0.0669
    body_width: float = 0.064
    body_back: float = 0.202
    standoff: float = 0.1
    table_clearance: float = 0.004
    object_clearance: float = 0.008
    height_clearance: float = 0.01
    margin: float = 0.0005

    def __post_init__(self) -> None:
        for field in fields(self):
            value, may_be_zero = (
                getattr(self, field.name),
                field.name.endswith("clearance") or field.name == "margin",
            )
            if not (np.isfinite(value) and (value > 0 or (may_be_zero and value == 0))):
                kind = "a number >= 0" if may_be_zero else "a positive number"
                raise PlanningError(f"side gripper: {field.name} is {value!r}; expected {kind} (m)")
        if not self.jaw_reach < self.standoff or not self.body_front < self.body_back:
            raise PlanningError(
                "side gripper: expected jaw_reach less than standoff, and body_front less than body_back (m)"
            )


@dataclass(frozen=True, eq=False)
class SideGrasp:
    """A grasp from the side.

    Attributes:
        p_WG: (2,) grasp point, m.
        approach: heading in which the fingers point, rad from W's x axis, in (-pi, pi].
        p_BG: (2,) grasp point, body frame, m.
        distance: from the grasp point to what was aimed at, m.
        clearance: between the lower jaw and the table, m.
    """

    p_WG: Array
    approach: float
    p_BG: Array
    distance: float
    clearance: float


def find_side_grasps(
    obj: GridObject,
    pose: ArrayLike,
    surface: SupportSurface,
    gripper: SideGripper | None = None,
    aim: ArrayLike | None = None,
    *,
    height: float = 0.03,
    step: float = STEP,
    headings: int = HEADINGS,
) -> list[SideGrasp]:
    """Finds where the gripper can take an object of a height (m), at a pose (3,), that overhangs the edge.

    Args:
        aim: (2,) point near which to grasp, body frame, m: the estimated center of mass; by default
            the mean of the cells.
        step: between grasp points tried, m: at most so much across the heading, four times as much
            along it.
        headings: tried over a full turn, beside those of narrow handles.

    Returns:
        The grasps, by distance from `aim`, at equal distance by clearance from the table; none
        where there is no place.

    Raises:
        PlanningError: a number is not finite or not positive, or the object is too thick for the
            gripper.
    """
    gripper = gripper or SideGripper()
    q = check_vector(PlanningError, "pose", pose, 3)
    target = obj.p_BC.mean(axis=0) if aim is None else check_vector(PlanningError, "aim", aim, 2)
    if not (
        np.isfinite(height) and height > 0 and np.isfinite(step) and step > 0 and headings >= 1
    ):
        raise PlanningError(
            f"height is {height!r}, step {step!r} and headings {headings!r}; expected positive lengths (m) and a number"
        )
    check_thickness(obj, height, gripper)
    outline = transform_shape(q, obj.outline)
    R = make_rotation(q[2])
    points, angles = _propose(outline, surface, gripper, R @ target + q[:2], step, headings)
    kept = _filter(outline, points, angles, surface, gripper)
    points, angles = points[kept], angles[kept]
    if not len(points):
        return []
    p_BG = (points - q[:2]) @ R
    distance = np.linalg.norm(p_BG - target, axis=1)
    clear = shapely.distance(make_rectangles(points, angles, *_lower_jaw(gripper)), surface.polygon)
    order = np.lexsort((-clear, np.round(distance, 6)))
    return [
        SideGrasp(
            points[i].copy(), float(angles[i]), p_BG[i].copy(), float(distance[i]), float(clear[i])
        )
        for i in order.tolist()
    ]


def check_thickness(obj: GridObject, height: float, gripper: SideGripper) -> None:
    """Raises PlanningError where an object of a height, m, is too thick for the gripper."""
    if height > gripper.opening - 2 * gripper.height_clearance:
        raise PlanningError(
            f"{obj.name}: {height:g} m thick; expected at most the gripper's opening less its clearances, "
            f"{gripper.opening - 2 * gripper.height_clearance:g} m"
        )


def _propose(
    outline: shapely.Polygon,
    surface: SupportSurface,
    gripper: SideGripper,
    aim: Array,
    step: float,
    headings: int,
) -> tuple[Array, Array]:
    """Points (k, 2) and headings (k,) with which the pads are on the overhang and the lower jaw clear of the table."""
    inner = outline.buffer(-gripper.margin, quad_segs=ARC_DETAIL)
    # no farther in than half the jaw's width, whatever the heading; the pads reach no farther from
    # there than this
    least, half = (
        gripper.table_clearance + gripper.jaw_width / 2,
        np.hypot(gripper.pad_length, gripper.pad_width) / 2,
    )
    beyond = inner - surface.polygon.buffer(least, join_style="mitre")
    overhang = inner - surface.polygon.buffer(least - half, join_style="mitre")
    if beyond.is_empty:
        return np.empty((0, 2)), np.empty(0)
    table = surface.polygon.buffer(gripper.table_clearance)
    pads = Walls(
        get_edges(overhang), -gripper.pad_length / 2, gripper.pad_length / 2, gripper.pad_width
    )
    grown = _grow(outline, gripper.object_clearance + 4 * TOUCH)
    jaw = Walls(get_edges(table), *_lower_jaw(gripper))
    rest = Walls(
        get_edges(grown),
        -gripper.body_back - gripper.standoff,
        -gripper.body_front,
        gripper.body_width,
    )
    shapely.prepare(overhang)
    handles, even = _choose_headings(beyond, pads, surface, step, headings)
    tries = [
        *((handle.heading, handle.corners) for handle in handles),
        *((angle, None) for angle in even),
    ]
    points, angles = find_places(overhang, pads, (jaw, rest), tries, aim, step)
    inwards = _find_ways_in(points, surface)
    ahead = inwards[:, 0] * np.cos(angles) + inwards[:, 1] * np.sin(angles) >= np.cos(MAX_SLANT)
    return points[ahead], angles[ahead]


def _choose_headings(
    beyond: BaseGeometry, pads: Walls, surface: SupportSurface, step: float, count: int
) -> tuple[list[Handle], list[float]]:
    """Headings that point inwards from somewhere `beyond` the edge: along narrow handles, and of `count` even ones."""
    even = np.pi * (2 * np.arange(1, count + 1) / count - 1)
    # in anything wider the pads have a step's play at the nearest of the even headings
    length, off = pads.front - pads.back, min(np.pi / count, np.pi / 4)
    widest = length * np.sin(off) + pads.width * np.cos(off) + step
    handles = find_handles(pads.edges, MIN_EDGE * length, widest)
    both = [
        Handle(handle.heading + turn, handle.corners)
        for turn in (0.0, -np.pi)
        for handle in handles
    ]
    # the way in from any point leads over the region's boundary, and from there on in the same
    # direction
    inwards = _find_ways_in(shapely.get_coordinates(shapely.segmentize(beyond, STEP)), surface)

    def points_in(headings: Array) -> NDArray[np.bool_]:
        ahead = inwards @ np.array([np.cos(headings), np.sin(headings)])
        return np.asarray((ahead >= np.cos(MAX_SLANT + SLANT_SPARE)).any(axis=0))

    kept = points_in(np.array([handle.heading for handle in both]))
    return [both[k] for k in np.flatnonzero(kept)], even[points_in(even)].tolist()


def _find_ways_in(points: Array, surface: SupportSurface) -> Array:
    """Unit vectors (k, 2) from points (k, 2) beyond the edge to the nearest place of the table."""
    lines = shapely.shortest_line(shapely.points(points), surface.polygon)
    inwards = shapely.get_coordinates(lines).reshape(-1, 2, 2)
    inwards = inwards[:, 1] - inwards[:, 0]
    return np.asarray(inwards / np.linalg.norm(inwards, axis=1, keepdims=True))


def _filter(
    outline: shapely.Polygon,
    points: Array,
    angles: Array,
    surface: SupportSurface,
    gripper: SideGripper,
) -> NDArray[np.int64]:
    """Indices of those whose gripper, but for the lower jaw, is clear of the table and of the object."""
    kept = np.arange(len(points))
    table, grown = (
        surface.polygon.buffer(gripper.table_clearance),
        _grow(outline, gripper.object_clearance),
    )
    for shape in (table, grown):
        shapely.prepare(shape)
    body = (-gripper.body_back - gripper.standoff, -gripper.body_front, gripper.body_width)
    jaws_before = (
        -gripper.body_front - gripper.standoff,
        gripper.jaw_reach - gripper.standoff,
        gripper.jaw_width,
    )
    tests = (
        (table, body),
        (grown, body),
        (grown, jaws_before),
    )
    for shape, (back, front, width) in tests:
        kept = kept[
            ~shapely.intersects(
                shape, make_rectangles(points[kept], angles[kept], back, front, width)
            )
        ]
    return kept


def _grow(outline: shapely.Polygon, clearance: float) -> BaseGeometry:
    """What is nowhere nearer to the outline than the clearance, of few edges."""
    return outline.buffer(clearance / np.cos(np.pi / (4 * ARC_DETAIL)), quad_segs=ARC_DETAIL)


def _lower_jaw(gripper: SideGripper) -> tuple[float, float, float]:
    """The lane that the lower jaw sweeps: its back and front along the heading, and its width, m."""
    return -gripper.body_front - gripper.standoff, gripper.jaw_reach, gripper.jaw_width


def make_rectangles(
    points: Array, angles: Array, back: float, front: float, width: float
) -> NDArray[np.object_]:
    """Rectangles from `back` to `front` along the headings, seen from the points, m."""
    corners = np.array(
        [(back, -width / 2), (front, -width / 2), (front, width / 2), (back, width / 2)]
    )
    return shapely.polygons(transform(np.column_stack([points, angles]), corners))


APART = 0.01  # m between grasp points, from which on two grasps differ
TURNED = np.radians(12)  # likewise between headings


def choose_varied(
    grasps: Sequence[SideGrasp], count: int, *, apart: float = APART, turned: float = TURNED
) -> list[SideGrasp]:
    """Chooses at most `count` grasps of a list, the best first: a few that differ, as to ask an arm takes time.

    One is unlike those chosen before it from `apart` (m) between the points or `turned` (rad)
    between the headings on.
    """
    p_WG = np.array([grasp.p_WG for grasp in grasps]).reshape(-1, 2)
    approach = np.array([grasp.approach for grasp in grasps])
    left, chosen = np.arange(len(grasps)), list[SideGrasp]()
    while len(left) and len(chosen) < count:
        best, left = left[0], left[1:]
        chosen.append(grasps[best])
        off = np.linalg.norm(p_WG[left] - p_WG[best], axis=1)
        angle = np.abs(wrap_angle(approach[left] - approach[best]))
        left = left[(off >= apart) | (angle >= turned)]
    return chosen
