"""Where a gripper can take an object from beyond the table's rim, one jaw under the overhang and one over it.

Seen from above, with the grasp point G in the middle between the pads and the x axis along the heading in which the
fingers point, the gripper is made of rectangles:

    pads       [-pad_length/2, pad_length/2] x pad_width       on the object, a margin inside its outline
    jaws       [-body_front, jaw_reach] x jaw_width            the lower one clear of the table
    the rest   [-body_back, -body_front] x body_width          clear of the object, and of the table

    pads       [-pad_length/2, pad_length/2] x pad_width   wholly on the object, a margin inside its outline
    jaws       [-body_front, jaw_reach] x jaw_width        the lower one clear of the table
    the rest   [-body_back, -body_front] x body_width      clear of the object, and of the table
"""

from dataclasses import dataclass, fields

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray
from shapely.affinity import affine_transform

from gridpush_drake.errors import PlanningError
from gridpush_drake.grid.object import GridObject
from gridpush_drake.planning.surface import SupportSurface

Array = NDArray[np.float64]

HEADINGS = 36
"""Tried over a full turn."""

MOST_SLANT = np.radians(75)
"""Between a heading and the shortest way in to the table."""

STEP = 0.005
"""m, between grasp points tried."""


@dataclass(frozen=True)
class SideGripper:
    """A parallel gripper seen from above while it reaches in from the side, m; as `models/gripper` has it.

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
            value, may_be_zero = getattr(self, field.name), field.name.endswith("clearance") or field.name == "margin"
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
    """Finds where the gripper can take an object that overhangs the rim.

    Args:
        obj: the object.
        pose: (3,) X_WB, m and rad.
        surface: the table.
        gripper: its measures.
        aim: (2,) point near which to grasp, body frame, m: the estimated centre of mass; by default the mean of the
            cells.
        height: of the object, m.
        step: between grasp points tried, m.
        headings: tried over a full turn.

    Returns:
        The grasps, by distance from `aim`, at equal distance by clearance from the table; none where there is no place.

    Raises:
        PlanningError: a number is not finite or not positive, or the object is too thick for the gripper.
    """
    gripper = gripper or SideGripper()
    q = _check_vector("pose", pose, 3)
    target = obj.p_BC.mean(axis=0) if aim is None else _check_vector("aim", aim, 2)
    if not (np.isfinite(height) and height > 0 and np.isfinite(step) and step > 0 and headings >= 1):
        raise PlanningError(
            f"height is {height!r}, step {step!r} and headings {headings!r}; expected positive lengths (m) and a number"
        )
    if height > gripper.opening - 2 * gripper.height_clearance:
        raise PlanningError(
            f"{obj.name}: {height:g} m thick; expected at most the gripper's opening less its clearances, "
            f"{gripper.opening - 2 * gripper.height_clearance:g} m"
        )
    outline = _place(obj.outline, q)
    points, angles = _propose(outline, surface, gripper, step, headings)
    kept = _filter(outline, points, angles, surface, gripper)
    points, angles = points[kept], angles[kept]
    if not len(points):
        return []
    c, s = np.cos(q[2]), np.sin(q[2])
    p_BG = (points - q[:2]) @ np.array([[c, -s], [s, c]])
    distance = np.linalg.norm(p_BG - target, axis=1)
    clear = shapely.distance(_make_rectangles(points, angles, *_lower_jaw(gripper)), surface.polygon)
    order = np.lexsort((-clear, np.round(distance, 6)))
    return [
        SideGrasp(points[i].copy(), float(angles[i]), p_BG[i].copy(), float(distance[i]), float(clear[i]))
        for i in order.tolist()
    ]


def _propose(
    outline: shapely.Polygon, surface: SupportSurface, gripper: SideGripper, step: float, headings: int
) -> tuple[Array, Array]:
    """Points (k, 2) of the overhang and headings (k,) with which the fingers come from beyond the rim."""
    # no farther out than half the pads' width or in than half the jaw's, whatever the heading
    beyond = outline.buffer(-gripper.margin - gripper.pad_width / 2, quad_segs=2)
    beyond -= surface.polygon.buffer(gripper.table_clearance + gripper.jaw_width / 2, join_style="mitre")
    if beyond.is_empty:
        return np.empty((0, 2)), np.empty(0)
    left, low, right, high = beyond.bounds
    x, y = np.arange(left, right + step, step), np.arange(low, high + step, step)
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    points = points[shapely.contains_xy(beyond, points[:, 0], points[:, 1])]
    inwards = np.diff(shapely.get_coordinates(shapely.shortest_line(shapely.points(points), surface.polygon)), axis=0)
    inwards = inwards[::2] / np.linalg.norm(inwards[::2], axis=1, keepdims=True)
    angles = np.pi * (2 * np.arange(1, headings + 1) / headings - 1)
    ahead = inwards @ np.array([np.cos(angles), np.sin(angles)])
    chosen, heading = np.nonzero(ahead >= np.cos(MOST_SLANT))
    return points[chosen], angles[heading]


def _filter(
    outline: shapely.Polygon, points: Array, angles: Array, surface: SupportSurface, gripper: SideGripper
) -> NDArray[np.int64]:
    """Indices of those whose pads lie on the object, and whose gripper is clear of the table and of the object."""
    half = gripper.pad_length / 2
    kept = np.arange(len(points))
    inner, table = outline.buffer(-gripper.margin), surface.polygon.buffer(gripper.table_clearance)
    grown = outline.buffer(gripper.object_clearance)
    for shape in (inner, table, grown):
        shapely.prepare(shape)
    body = (-gripper.body_back - gripper.standoff, -gripper.body_front, gripper.body_width)
    jaws_before = (-gripper.body_front - gripper.standoff, gripper.jaw_reach - gripper.standoff, gripper.jaw_width)
    tests = (
        (inner, True, (-half, half, gripper.pad_width)),
        (table, False, _lower_jaw(gripper)),
        (table, False, body),
        (grown, False, body),
        (grown, False, jaws_before),
    )
    for shape, wanted, (back, front, width) in tests:
        rectangles = _make_rectangles(points[kept], angles[kept], back, front, width)
        found = shapely.covers(shape, rectangles) if wanted else ~shapely.intersects(shape, rectangles)
        kept = kept[found]
    return kept


def _lower_jaw(gripper: SideGripper) -> tuple[float, float, float]:
    """The lane that the lower jaw sweeps: its back and front along the heading, and its width, m."""
    return -gripper.body_front - gripper.standoff, gripper.jaw_reach, gripper.jaw_width


def _make_rectangles(points: Array, angles: Array, back: float, front: float, width: float) -> NDArray[np.object_]:
    """Rectangles from `back` to `front` along the headings, seen from the points, m."""
    c, s = np.cos(angles), np.sin(angles)
    corners = np.array([(back, -width / 2), (front, -width / 2), (front, width / 2), (back, width / 2)])
    x = points[:, :1] + np.outer(c, corners[:, 0]) - np.outer(s, corners[:, 1])
    y = points[:, 1:] + np.outer(s, corners[:, 0]) + np.outer(c, corners[:, 1])
    return shapely.polygons(np.stack([x, y], axis=-1))


def _place(outline: shapely.Polygon, q: Array) -> shapely.Polygon:
    c, s = np.cos(q[2]), np.sin(q[2])
    return affine_transform(outline, [c, -s, s, c, q[0], q[1]])


def _check_vector(name: str, value: ArrayLike, size: int) -> Array:
    vector = np.array(value, dtype=np.float64)
    if vector.shape != (size,) or not np.isfinite(vector).all():
        raise PlanningError(f"{name} is {value!r}; expected {size} finite numbers")
    return vector
