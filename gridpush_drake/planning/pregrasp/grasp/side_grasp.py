"""Where a gripper can take an object from the side, one jaw under the overhang and one over it.

What the gripper is made of, seen from above, and what it sweeps on its way in, is in `gripper`.
Whether its pads can then hold the object is another question, see `gripper.PadLimit`.

A grasp is a point and a heading. For each of many headings, the points at which the pads lie on the
object and the lower jaw is clear of the table are found exactly (`find_places`); those that are
left are then checked one by one for the rest of the gripper. Seen along the heading, with x along
it and y across, a rectangle [back, front] x [-w, w] about the point (x, y) crosses no edge of a
polygon exactly if for every edge, cut to the strip y - w .. y + w and there reaching from xa to xb,

    x <= xa - front   or   x >= xb - back

Each edge so blocks an interval of a line of constant y, and what is free is what the union of these
intervals leaves.

On wide objects evenly spaced lines and headings will do. A handle hardly wider than the pads asks
for the very heading, the bisector of its two sides, and for the very lines: those on which a side
of the pads touches a corner of the handle, and those between two such lines.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray
from shapely.geometry.base import BaseGeometry

from gridpush_drake.errors import PlanningError
from gridpush_drake.geometry.se2 import (
    Array,
    check_vector,
    make_rotation,
    transform_shape,
    wrap_angle,
)
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.pregrasp.grasp.gripper import Gripper, Rectangle
from gridpush_drake.planning.support_surface import SupportSurface

CROSSING_SLACK = 1e-6
"""Rectangles may cross an edge by this much, m, for round-off."""

NEARLY_PARALLEL = np.radians(12)
"""Two edges whose directions differ by less than this can be the sides of a handle, rad."""

SAME_HEADING = np.radians(0.2)
"""Two handles whose headings differ by less than this, rad, are tried with one heading, that of the
longer sides: across the length of the pads the difference is a tenth of a millimeter."""

SPACING_ALONG_LINE = 4
"""Grasp points on a line are spaced this many times as far apart as the lines. (A line's ends and
the point nearest to the aim are tried in any case.)"""

HEADING_COUNT = 72
"""Number of headings that are tried over a full turn, besides those of narrow handles."""

MIN_SIDE_FRACTION = 0.25
"""The sides of a narrow handle are at least this long, as a fraction of the pads' length."""

ARC_DETAIL = 4
"""Pieces into which a quarter turn is cut where a grown or shrunk outline is round."""

MAX_SLANT = np.radians(75)
"""Greatest angle between a heading and the shortest way from the grasp point to the table, rad."""

SLANT_SPARE = np.radians(5)
"""Headings are kept up to this much beyond `MAX_SLANT`, rad, while the shortest ways to the table
are known from points along the overhang's boundary only."""

MAX_LINE_SPACING = 0.005
"""Greatest distance between lines of grasp points, m."""

DISTANCE_DIGITS = 6
"""Grasps whose distances from the aim agree in so many decimals, of m, count as equally near."""

MIN_DISTANCE = 0.01
"""Two grasps whose points are this far apart, m, count as different."""

MIN_TURN = np.radians(12)
"""Two grasps whose headings differ by this much, rad, count as different."""


@dataclass(frozen=True, eq=False)
class SideGrasp:
    """A grasp from the side.

    Attributes:
        p_WG: (2,) grasp point, m.
        approach: heading in which the fingers point, rad from W's x axis, in (-pi, pi].
        p_BG: (2,) grasp point, body frame, m.
        distance: from the grasp point to the point that was aimed at, m.
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
    gripper: Gripper | None = None,
    aim: ArrayLike | None = None,
    *,
    height: float = 0.03,
    step: float = MAX_LINE_SPACING,
    headings: int = HEADING_COUNT,
) -> list[SideGrasp]:
    """Finds where the gripper can take an object that overhangs the edge.

    Args:
        obj: the object.
        pose: (3,) where it lies, X_WB, m and rad.
        surface: the table.
        gripper: the gripper; the default one where None.
        aim: (2,) point near which to grasp, body frame, m: the estimated center of mass; by default
            the mean of the cells.
        height: of the object, m.
        step: greatest distance across the heading between grasp points, m. Along the heading it is
            `SPACING_ALONG_LINE` times as much.
        headings: number of headings over a full turn, besides those of narrow handles.

    Returns:
        The grasps, by distance from `aim`, at equal distance by clearance from the table; none
        where there is no place.

    Raises:
        PlanningError: a number is not finite or not positive, or the object is too thick for the
            gripper.
    """
    gripper = gripper or Gripper()
    q = check_vector(PlanningError, "pose", pose, 3)
    target = obj.p_BC.mean(axis=0) if aim is None else check_vector(PlanningError, "aim", aim, 2)
    if not (
        np.isfinite(height) and height > 0 and np.isfinite(step) and step > 0 and headings >= 1
    ):
        raise PlanningError(
            f"height is {height!r}, step {step!r} and headings {headings!r}; "
            "expected positive lengths (m) and a number"
        )
    gripper.check_thickness(obj, height)
    outline = transform_shape(q, obj.outline)
    R = make_rotation(q[2])
    # Grasps by which pads and lower jaw fit, then those of them by which all of the gripper does.
    points, angles = _propose(outline, surface, gripper, R @ target + q[:2], step, headings)
    kept = _filter(outline, points, angles, surface, gripper)
    points = points[kept]
    angles = angles[kept]
    if not len(points):
        return []
    p_BG = (points - q[:2]) @ R
    distance = np.linalg.norm(p_BG - target, axis=1)
    clearance = shapely.distance(gripper.swept_jaw.place(points, angles), surface.polygon)
    # Distances are rounded, so that round-off does not decide between grasps that are as near.
    order = np.lexsort((-clearance, np.round(distance, DISTANCE_DIGITS)))
    return [
        SideGrasp(
            p_WG=points[i].copy(),
            approach=float(angles[i]),
            p_BG=p_BG[i].copy(),
            distance=float(distance[i]),
            clearance=float(clearance[i]),
        )
        for i in order.tolist()
    ]


def choose_varied(
    grasps: Sequence[SideGrasp],
    count: int,
    *,
    min_distance: float = MIN_DISTANCE,
    min_turn: float = MIN_TURN,
) -> list[SideGrasp]:
    """Chooses a few grasps of a list that differ from one another, the best first.

    It takes time to ask an arm whether it can carry out a grasp, so that not all are asked about.

    Args:
        grasps: the list, best first.
        count: how many to choose at most.
        min_distance: two grasps differ if their points are this far apart, m.
        min_turn: two grasps differ if their headings do by this much, rad.
    """
    p_WG = np.array([grasp.p_WG for grasp in grasps]).reshape(-1, 2)
    approach = np.array([grasp.approach for grasp in grasps])
    left = np.arange(len(grasps))
    chosen: list[SideGrasp] = []
    while len(left) and len(chosen) < count:
        best = left[0]
        left = left[1:]
        chosen.append(grasps[best])
        # Drop what is like the grasp just chosen, in place and in heading.
        distance = np.linalg.norm(p_WG[left] - p_WG[best], axis=1)
        turn = np.abs(wrap_angle(approach[left] - approach[best]))
        left = left[(distance >= min_distance) | (turn >= min_turn)]
    return chosen


def _propose(
    outline: shapely.Polygon,
    surface: SupportSurface,
    gripper: Gripper,
    aim: Array,
    step: float,
    headings: int,
) -> tuple[Array, Array]:
    """Finds grasps with the pads on the overhang and the lower jaw clear of the table.

    Returns:
        Points (k, 2), m, and headings (k,), rad, in W.
    """
    # Whatever the heading, a grasp point is at least half the jaw's width and the clearance beyond
    # the edge, and the pads reach no farther from it than half their diagonal. So the pads lie on
    # `overhang`, and the grasp points in `beyond`.
    inner = outline.buffer(-gripper.pad_margin, quad_segs=ARC_DETAIL)
    least = gripper.table_clearance + gripper.jaw_width / 2
    half_diagonal = np.hypot(gripper.pad_length, gripper.pad_width) / 2
    beyond = inner - surface.polygon.buffer(least, join_style="mitre")
    overhang = inner - surface.polygon.buffer(least - half_diagonal, join_style="mitre")
    if beyond.is_empty:
        return np.empty((0, 2)), np.empty(0)
    # What must not be crossed: the overhang's edges by the pads, the table's by the lower jaw, and
    # the object's by the body.
    table = surface.polygon.buffer(gripper.table_clearance)
    grown = _grow(outline, gripper.object_clearance + 4 * CROSSING_SLACK)
    pads = Walls(get_edges(overhang), gripper.pads)
    jaw = Walls(get_edges(table), gripper.swept_jaw)
    body = Walls(get_edges(grown), gripper.swept_body)
    shapely.prepare(overhang)
    handles, even = _choose_headings(beyond, pads, surface, step, headings)
    tries: list[tuple[float, Array | None]] = [
        *((handle.heading, handle.corners) for handle in handles),
        *((angle, None) for angle in even),
    ]
    points, angles = find_places(overhang, pads, (jaw, body), tries, aim, step)
    # Keep the grasps whose heading is within MAX_SLANT of the way in to the table.
    inwards = _find_ways_in(points, surface)
    ahead = inwards[:, 0] * np.cos(angles) + inwards[:, 1] * np.sin(angles) >= np.cos(MAX_SLANT)
    return points[ahead], angles[ahead]


def _choose_headings(
    beyond: BaseGeometry, pads: "Walls", surface: SupportSurface, step: float, count: int
) -> tuple[list["Handle"], list[float]]:
    """Chooses headings that point in to the table from somewhere in the region `beyond` its edge.

    Returns:
        Narrow handles, each with its heading; and those of `count` evenly spaced headings, rad.
    """
    even = np.pi * (2 * np.arange(1, count + 1) / count - 1)
    # A handle counts as narrow if the pads, at the nearest of the even headings, have less than a
    # step's play in it.
    length = pads.rectangle.front - pads.rectangle.back
    off = min(np.pi / count, np.pi / 4)
    widest = length * np.sin(off) + pads.rectangle.width * np.cos(off) + step
    handles = find_handles(pads.edges, MIN_SIDE_FRACTION * length, widest)
    both_ways = [
        Handle(handle.heading + turn, handle.corners)
        for turn in (0.0, -np.pi)
        for handle in handles
    ]
    # The way in from any point leads over the region's boundary, and from there on in the same
    # direction, so that it is enough to look at points along the boundary.
    inwards = _find_ways_in(
        shapely.get_coordinates(shapely.segmentize(beyond, MAX_LINE_SPACING)), surface
    )

    def points_in(headings: Array) -> NDArray[np.bool_]:
        ahead = inwards @ np.array([np.cos(headings), np.sin(headings)])
        return np.asarray((ahead >= np.cos(MAX_SLANT + SLANT_SPARE)).any(axis=0))

    kept = points_in(np.array([handle.heading for handle in both_ways]))
    return [both_ways[k] for k in np.flatnonzero(kept)], even[points_in(even)].tolist()


def _find_ways_in(points: Array, surface: SupportSurface) -> Array:
    """Unit vectors (k, 2) from points (k, 2) beyond the edge to the nearest place of the table."""
    lines = shapely.shortest_line(shapely.points(points), surface.polygon)
    ends = shapely.get_coordinates(lines).reshape(-1, 2, 2)
    inwards = ends[:, 1] - ends[:, 0]
    return np.asarray(inwards / np.linalg.norm(inwards, axis=1, keepdims=True))


def _filter(
    outline: shapely.Polygon,
    points: Array,
    angles: Array,
    surface: SupportSurface,
    gripper: Gripper,
) -> NDArray[np.int64]:
    """Indices of the grasps by which the gripper is clear of the table and of the object.

    The lower jaw is not checked again. The pads are on the object by then.
    """
    table = surface.polygon.buffer(gripper.table_clearance)
    grown = _grow(outline, gripper.object_clearance)
    shapely.prepare(table)
    shapely.prepare(grown)
    kept = np.arange(len(points))
    for shape, rectangle in (
        (table, gripper.swept_body),
        (grown, gripper.swept_body),
        (grown, gripper.jaws_coming_down),
    ):
        kept = kept[~shapely.intersects(shape, rectangle.place(points[kept], angles[kept]))]
    return kept


def _grow(outline: shapely.Polygon, clearance: float) -> BaseGeometry:
    """The outline grown by at least `clearance`, m, everywhere, with few edges.

    A circle of radius r is replaced by a polygon whose edges come as near as r cos(half an edge's
    angle), so that r is made larger by that factor.
    """
    return outline.buffer(clearance / np.cos(np.pi / (4 * ARC_DETAIL)), quad_segs=ARC_DETAIL)


@dataclass(frozen=True, eq=False)
class Walls:
    """Edges that a rectangle must not cross.

    Attributes:
        edges: (e, 2, 2) both ends of each edge, m.
        rectangle: what must not cross them; it moves with the grasp point.
    """

    edges: Array
    rectangle: Rectangle


def get_edges(shape: BaseGeometry) -> Array:
    """The edges (e, 2, 2) of all rings of polygons, counterclockwise about what is inside."""
    rings = shapely.get_rings(shapely.get_parts(shapely.orient_polygons(shape)))
    corners, ring = shapely.get_coordinates(rings, return_index=True)
    within = np.flatnonzero(ring[:-1] == ring[1:])
    return np.stack([corners[within], corners[within + 1]], axis=1)


@dataclass(frozen=True, eq=False)
class Handle:
    """A narrow stretch of an object, between two sides that face each other.

    Attributes:
        heading: along it, the bisector of its sides, rad.
        corners: (k, 2) ends of its sides, m.
    """

    heading: float
    corners: Array


def find_handles(edges: Array, shortest: float, widest: float) -> list[Handle]:
    """Finds narrow handles: pairs of edges that face each other.

    Args:
        edges: (e, 2, 2) of polygons, counterclockwise, m.
        shortest: edges that are shorter do not count, m.
        widest: handles that are wider do not count, m.

    Returns:
        Handles whose heading is in [0, pi), one of each heading, those of longer edges first.
    """
    along = edges[:, 1] - edges[:, 0]
    length = np.linalg.norm(along, axis=1)
    long_enough = length >= shortest
    edges = edges[long_enough]
    along = along[long_enough]
    length = length[long_enough]
    # All pairs (i, j) of edges that run in opposite directions, but for a slant.
    angle = np.arctan2(along[:, 1], along[:, 0])
    i, j = np.triu_indices(len(angle), 1)
    slant = np.remainder(angle[j] - angle[i], 2 * np.pi) - np.pi
    near = np.abs(slant) <= NEARLY_PARALLEL
    i = i[near]
    j = j[near]
    slant = slant[near]
    # The inside of a polygon is to the left of its edges: they face each other if j is left of i.
    across = along[i, 0] * (edges[j] - edges[i, :1])[..., 1].mean(axis=1)
    across -= along[i, 1] * (edges[j] - edges[i, :1])[..., 0].mean(axis=1)
    gap = shapely.distance(shapely.linestrings(edges[i]), shapely.linestrings(edges[j]))
    rank = np.where((gap <= widest) & (across > 0), np.minimum(length[i], length[j]), 0.0)
    # Pairs of nearly the same heading make one handle, with the corners of all.
    found: list[Handle] = []
    for k in np.argsort(-rank, kind="stable")[: np.count_nonzero(rank)]:
        heading = float((angle[i[k]] + slant[k] / 2) % np.pi)
        corners = edges[[i[k], j[k]]].reshape(4, 2)
        for n, other in enumerate(found):
            if abs((heading - other.heading + np.pi / 2) % np.pi - np.pi / 2) <= SAME_HEADING:
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
    """Finds points and headings with which the pads lie on an object, and nothing crosses a wall.

    Args:
        shape: what the pads must lie on, m.
        pads: the pads, and the edges of `shape`; the grasp point lies in them.
        others: further rectangles and what they must not cross.
        tries: headings, rad. With each goes None, to look everywhere, or the corners (k, 2) of a
            narrow handle, to look there only.
        aim: (2,) point near which places are wanted, m.
        step: greatest distance between lines, m.

    Returns:
        Points (k, 2), m, and headings (k,), rad.
    """
    headings = np.array([heading for heading, _ in tries])
    R = make_rotation(headings)
    # Lines of constant y for every heading, where y is the coordinate across it.
    y_aim = aim @ R[:, :, 1].T
    y_corners = pads.edges.reshape(-1, 2) @ R[:, :, 1].T
    half = pads.rectangle.width / 2
    chosen = [
        _choose_lines(y_corners[:, k], half, y_aim[k], step)
        if corners is None
        else _choose_lines_in_handle(corners @ R[k, :, 1], half, step)
        for k, (_, corners) in enumerate(tries)
    ]
    lines = np.concatenate([np.empty(0), *chosen])
    counts = np.array([len(ys) for ys in chosen], dtype=int)
    R = np.repeat(R, counts, axis=0)
    headings = np.repeat(headings, counts, axis=0)
    # What all edges leave free of every line, as far as it is inside the shape.
    begins = []
    ends = []
    for walls in (pads, *others):
        begin, end = _block(lines, walls, R)
        begins.append(begin)
        ends.append(end)
    row, low, high = _find_gaps(np.concatenate(begins, axis=1), np.concatenate(ends, axis=1))
    inside = shapely.contains_xy(shape, *_turn_back((low + high) / 2, lines[row], R[row]).T)
    row = row[inside]
    low = low[inside]
    high = high[inside]
    # In every gap evenly spaced points, its ends among them, and the one nearest to the aim.
    count = np.ceil((high - low) / (SPACING_ALONG_LINE * step)).astype(int) + 1
    gap, number = _divide(count)
    x = low[gap] + (high - low)[gap] * number / np.maximum(count - 1, 1)[gap]
    x = np.append(x, np.clip(R[row, :, 0] @ aim, low, high))
    row = np.append(row[gap], row)
    return _turn_back(x, lines[row], R[row]), headings[row]


def _turn_back(x: Array, y: Array, R: Array) -> Array:
    """Turns points that are seen along headings back into W.

    Args:
        x: (k,) coordinates along the headings, m.
        y: (k,) coordinates across them, m.
        R: (k, 2, 2) rotations of the headings.

    Returns:
        (k, 2) m.
    """
    return x[:, None] * R[:, :, 0] + y[:, None] * R[:, :, 1]


def _choose_lines(y_corners: Array, half: float, y_aim: float, step: float) -> Array:
    """Chooses the y on which to look in an outline whose corners are at y (k,), m.

    Args:
        y_corners: (k,) of the outline, m.
        half: half the width of the pads, m.
        y_aim: of the point near which places are wanted, m.
        step: greatest distance between lines, m.
    """
    low = y_corners.min() + half
    high = y_corners.max() - half
    if high < low:
        return np.empty(0)
    even = np.linspace(low, high, int(np.ceil((high - low) / step)) + 1)
    return np.append(even, np.clip(y_aim, low, high))


def _choose_lines_in_handle(y_corners: Array, half: float, step: float) -> Array:
    """Chooses the y on which to look in a handle whose corners are at y (k,), m.

    They are those where a side of the pads touches a corner, and evenly spaced ones in between; the
    arguments are those of `_choose_lines`.
    """
    touching = np.sort(np.concatenate([y_corners + half, y_corners - half]))
    low = y_corners.min() + half - CROSSING_SLACK
    high = y_corners.max() - half + CROSSING_SLACK
    touching = touching[(touching >= low) & (touching <= high)]
    if not len(touching):
        return touching
    touching = touching[np.append(True, np.diff(touching) > CROSSING_SLACK)]
    gaps = np.diff(touching)
    count = np.ceil(gaps / step).astype(int)
    gap, number = _divide(count)
    return np.concatenate([touching, touching[gap] + gaps[gap] * (number + 0.5) / count[gap]])


def _divide(count: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Numbers the pieces of things that are divided into count (k,) pieces each.

    Returns:
        For every piece, which thing it is of, and its number within that thing, from 0.
    """
    which = np.repeat(np.arange(len(count)), count)
    return which, np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)


def _block(lines: Array, walls: Walls, R: Array) -> tuple[Array, Array]:
    """Where on the lines (l,), whose rotations are R (l, 2, 2), the edges begin and cease to block.

    Returns:
        Two arrays (l, e), m along the line; inf and -inf where an edge does not block a line.
    """
    # Ends of the edges along and across each line's heading.
    x0 = R[:, :, 0] @ walls.edges[:, 0].T
    x1 = R[:, :, 0] @ walls.edges[:, 1].T
    y0 = R[:, :, 1] @ walls.edges[:, 0].T
    y1 = R[:, :, 1] @ walls.edges[:, 1].T
    # Each edge cut to the strip that the rectangle covers: it reaches from xa to xb there.
    half = walls.rectangle.width / 2 - CROSSING_SLACK
    low = (lines - half)[:, None]
    high = (lines + half)[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        fraction = np.clip(((low - y0) / (y1 - y0), (high - y0) / (y1 - y0)), 0.0, 1.0)
    xa, xb = x0 + (x1 - x0) * fraction
    # Blocked is min(xa, xb) - front < x < max(xa, xb) - back, where the strip meets the edge.
    met = (np.maximum(y0, y1) > low) & (np.minimum(y0, y1) < high)
    begin = np.minimum(xa, xb) - walls.rectangle.front + CROSSING_SLACK
    end = np.maximum(xa, xb) - walls.rectangle.back - CROSSING_SLACK
    return np.where(met, begin, np.inf), np.where(met, end, -np.inf)


def _find_gaps(begin: Array, end: Array) -> tuple[NDArray[np.int64], Array, Array]:
    """Finds the bounded gaps between intervals on every line.

    Args:
        begin: (l, e) where the intervals begin, one row for every line.
        end: (l, e) where they end.

    Returns:
        For every gap the index of its line, where it begins and where it ends.
    """
    order = np.argsort(begin, axis=1)
    begin = np.take_along_axis(begin, order, axis=1)
    # How far all intervals up to each one reach: a gap is where the next begins beyond that.
    end = np.maximum.accumulate(np.take_along_axis(end, order, axis=1), axis=1)
    row, k = np.nonzero((begin[:, 1:] >= end[:, :-1]) & np.isfinite(begin[:, 1:]))
    return row, end[row, k], begin[row, k + 1]
