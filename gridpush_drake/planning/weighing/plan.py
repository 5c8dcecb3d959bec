"""Where to press on an object that hangs over the table's edge, so that its tilt is caught.

The object lies with its plausible centers of mass in a convex region C, body frame. Pressing at P,
a beyond the edge, tilts it about the edge as the force reaches m g b / a, with b how far c is
inside.
The whole tip must be over the object, seen from above; on objects whose parts are too narrow for
that, the middle of the tip. Two more things must hold for each c in C, whatever the mass:

    b > h tan(t) + error        tilted by the angle t at which the press stops, an object of height
                                h still has its center of mass inside the edge, and comes back
    s_min < s* < s_max          where weight and press together act at that moment, the object must
    s* = (a s_c + b s_P)        lie on the edge: s runs along the edge, from s_min to s_max where
         / (a + b)              the object crosses it. Else it would roll over a corner instead

s* is a quotient of linear functions of c, so that it is enough to look at the corners of C. Of all
places that do, the one is taken that is expected to tell the product m b best,

    (std of m b / m b)² = (s_F a / (m g b))² + (s_e (1 / a + 1 / b))²

with s_F the error of the force and s_e that of the edge.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil, cos, radians, sin, tan

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely import LineString, Polygon
from shapely.affinity import translate

from gridpush_drake.dynamics.physics import GRAVITY
from gridpush_drake.errors import PlanningError, require_positive
from gridpush_drake.geometry.se2 import (
    Array,
    compose,
    invert,
    make_rotation,
    transform,
    transform_shape,
)
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.weighing.press import PressTarget
from gridpush_drake.pushes.weighings import EDGE_STD

AVOIDED_RADIUS = 0.02
"""Distance from a place on the object at which it slid within which it is pressed no more, m."""

EDGE_LINE_HALF_LENGTH = 10.0
"""Half the length of the line that stands for an edge, m."""


@dataclass(frozen=True)
class PressRules:
    """What a press must keep to, and what is supposed where it is compared with others.

    Attributes:
        max_tilt: tilt at which every press has stopped, rad.
        pose_error: how far the object may be from where it was seen, m.
        min_arm: least distance of the tip from the edge, m.
        tip_radius: radius of the tip's sphere, m.
        rim_margin: least distance of the whole tip, seen from above, from the object's outline, m:
            how far off outline and place may be.
        is_narrow: whether the object's parts are too narrow for that. Then only the tip's middle
            must be over the object, wherever the object may be: `pose_error` from its outline.
        spacing: distance of the places that are tried, m.
        overhang_step: distance of the overhangs that are tried, m.
        mass: mass that is supposed in comparing places, kg. No place is taken at which it would
            need more than the greatest force.
        max_force: greatest force of a press, N.
        force_std: standard deviation of the force at the tilt, N.
        avoided: places on the object at which it slid when it was pressed, body frame, m.
    """

    max_tilt: float = radians(5.0)
    pose_error: float = 0.004
    min_arm: float = 0.02
    tip_radius: float = 0.008
    rim_margin: float = 0.001
    is_narrow: bool = False
    spacing: float = 0.003
    overhang_step: float = 0.003
    mass: float = 0.5
    max_force: float = 50.0
    force_std: float = 0.05
    avoided: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        others = ("is_narrow", "avoided")
        numbers = {name: value for name, value in vars(self).items() if name not in others}
        require_positive(PlanningError, "press: ", **numbers)

    @property
    def rim(self) -> float:
        """Least distance of the tip's middle from the object's outline, m."""
        return self.pose_error if self.is_narrow else self.tip_radius + self.rim_margin


@dataclass(frozen=True)
class Edge:
    """The line of a table's edge.

    Attributes:
        point: (x, y) of one of its points, W, m.
        angle: direction of its outward normal, rad.
    """

    point: tuple[float, float]
    angle: float

    @property
    def normal(self) -> Array:
        """(2,) outward unit normal, W."""
        return np.array([cos(self.angle), sin(self.angle)])

    @property
    def tangent(self) -> Array:
        """(2,) unit vector along the edge, W."""
        return np.array([-sin(self.angle), cos(self.angle)])

    def calc_beyond(self, p: Array) -> Array:
        """Calculates how far points (..., 2) are beyond the edge, m; negative on the table."""
        return np.asarray((p - np.array(self.point)) @ self.normal)

    def calc_along(self, p: Array) -> Array:
        """Calculates where points (..., 2) are along the edge, m."""
        return np.asarray((p - np.array(self.point)) @ self.tangent)


@dataclass(frozen=True, eq=False)
class PlannedPress:
    """A press that is safe, and what is expected of it.

    Attributes:
        pose: (3,) X_WB of the object, m and rad.
        target: where to press.
        relative_std: expected standard deviation of m b, relative to it.
        inside: least distance of the plausible centers of mass from the edge, m.
    """

    pose: Array
    target: PressTarget
    relative_std: float
    inside: float

    def move_to(self, edge: Edge, along: float) -> "PlannedPress":
        """Moves it to another edge.

        Args:
            edge: the edge.
            along: by how much it is moved along that edge, m, from the edge's point.
        """
        X_WE = np.array([*(np.array(edge.point) + along * edge.tangent), edge.angle])
        # The frame of its own edge.
        X_EW = invert(np.array([*self.target.edge_point, self.target.edge_angle]))
        X = compose(X_WE, X_EW)
        x, y = transform(X, np.array([self.target.place]))[0].tolist()
        target = replace(self.target, place=(x, y), edge_point=edge.point, edge_angle=edge.angle)
        return replace(self, pose=compose(X, self.pose), target=target)


@dataclass(frozen=True, eq=False)
class _LyingObject:
    """An object as it lies.

    Attributes:
        pose: (3,) X_WB, m and rad.
        outline: its outline, W, m.
        places: (K, 2) on a grid, where the whole tip is over it, W, m.
    """

    pose: Array
    outline: Polygon
    places: Array

    @classmethod
    def at(cls, pose: Array, outline: Polygon, rules: PressRules) -> "_LyingObject":
        """Lays an object, whose outline is given in the body frame, to a pose (3,)."""
        placed = transform_shape(pose, outline)
        return cls(np.asarray(pose), placed, _list_places(placed, rules))

    def move(self, p: Array) -> "_LyingObject":
        """Moves it by (2,), W, m."""
        pose = self.pose + np.append(p, 0.0)
        return _LyingObject(pose, translate(self.outline, *p), self.places + p)


def plan_press(
    obj: GridObject,
    centers: Array,
    pose: Array,
    edge: Edge,
    top: float,
    rules: PressRules | None = None,
    is_robust: bool = True,
) -> PlannedPress | None:
    """Plans a press on an object where it lies.

    Args:
        obj: the object.
        centers: (V, 2) corners of the region that its center of mass is in, body frame, m.
        pose: (3,) X_WB, m and rad.
        edge: the edge over which it hangs.
        top: height of its top above the table, m.
        rules: what the press must keep to.
        is_robust: whether the greatest force must tilt an object of the supposed mass wherever in
            the region its center of mass is, and not only with it in the middle.

    Returns:
        The press; None where none is safe.
    """
    rules = rules or PressRules()
    lying = _LyingObject.at(pose, obj.outline, rules)
    return _choose_place(lying, centers, edge, top, rules, is_robust)


def _choose_place(
    lying: _LyingObject,
    centers: Array,
    edge: Edge,
    top: float,
    rules: PressRules,
    is_robust: bool,
) -> PlannedPress | None:
    """Chooses the place at which a press is safe and tells most; for `plan_press`."""
    c_W = transform(lying.pose, centers)
    b = -edge.calc_beyond(c_W)
    inside = float(b.min())
    if inside <= _calc_least_inside(top, rules):
        return None
    crossing = _find_crossing(lying.outline, edge)
    if crossing is None:
        return None
    places = lying.places[edge.calc_beyond(lying.places) >= rules.min_arm]
    if rules.avoided:
        slid = transform(lying.pose, np.array(rules.avoided))
        distances = np.linalg.norm(places[:, None] - slid, axis=2)
        places = places[(distances > AVOIDED_RADIUS).all(axis=1)]
    places = places[_find_safe(places, c_W, crossing, edge, rules, is_robust)]
    if not len(places):
        return None

    # The most telling one, with the center of mass in the middle of the region.
    middle = float(b.mean())
    arm = edge.calc_beyond(places)
    by_force = rules.force_std * arm / (rules.mass * GRAVITY * middle)
    by_edge = EDGE_STD * (1 / arm + 1 / middle)
    stds = np.hypot(by_force, by_edge)
    best = int(np.argmin(stds))
    x, y = places[best].tolist()
    target = PressTarget(
        place=(x, y),
        edge_point=edge.point,
        edge_angle=edge.angle,
        top=top,
        tip_radius=rules.tip_radius,
    )
    return PlannedPress(
        pose=lying.pose, target=target, relative_std=float(stds[best]), inside=inside
    )


def _find_safe(
    places: Array,
    c_W: Array,
    crossing: Sequence[float],
    edge: Edge,
    rules: PressRules,
    is_robust: bool,
) -> NDArray[np.bool_]:
    """Says at which of some places (K, 2) a press is safe, with each center of mass (V, 2), W."""
    # Where weight and press act together, for each place and each corner of the region.
    a = edge.calc_beyond(places)[:, None]
    b = -edge.calc_beyond(c_W)
    s = edge.calc_along(places)[:, None]
    together = (a * edge.calc_along(c_W) + b * s) / (a + b)
    low, high = crossing
    slack = np.minimum(together - low, high - together).min(axis=1)
    farthest = float(b.max()) if is_robust else float(b.mean())
    light = rules.mass * GRAVITY * farthest <= rules.max_force * a[:, 0]
    return np.asarray((slack > rules.pose_error) & light)


def list_placements(
    obj: GridObject,
    centers: Array,
    heading: float,
    edge: Edge,
    top: float,
    rules: PressRules | None = None,
    along: float = 0.0,
    is_robust: bool = True,
) -> list[PlannedPress]:
    """Lists how far an object may hang over an edge, with a press on it for each overhang.

    Args:
        obj: the object.
        centers: (V, 2) corners of the region that its center of mass is in, body frame, m.
        heading: of the object, rad.
        edge: the edge.
        top: height of the object's top above the table, m.
        rules: what the presses must keep to.
        along: where the middle of the object is along the edge, from the edge's point, m.
        is_robust: see `plan_press`.

    Returns:
        A press for each overhang at which one is safe.
    """
    rules = rules or PressRules()
    # How far the body reaches along the edge's normal, from its origin.
    corners = shapely.get_coordinates(obj.outline) @ make_rotation(heading).T
    reach = corners @ edge.normal
    across = corners @ edge.tangent
    # Farther out than this, no place is safe wherever the center of mass is.
    farthest = float(reach.max() - (centers @ make_rotation(heading).T @ edge.normal).max())
    farthest -= _calc_least_inside(top, rules)
    overhangs = np.arange(rules.min_arm + rules.rim, farthest, rules.overhang_step)
    sideways = along - float(across.max() + across.min()) / 2
    # The object is moved and never turned, and all of its places with it.
    turned = _LyingObject.at(np.array([0.0, 0.0, heading]), obj.outline, rules)
    found = []
    for overhang in overhangs:
        beyond = overhang - reach.max()
        p = np.array(edge.point) + beyond * edge.normal + sideways * edge.tangent
        planned = _choose_place(turned.move(p), centers, edge, top, rules, is_robust)
        if planned is not None:
            found.append(planned)
    return found


def _calc_least_inside(top: float, rules: PressRules) -> float:
    """Least distance of a center of mass from the edge, m, so that a tilted object comes back."""
    return top * tan(rules.max_tilt) + rules.pose_error


def _find_crossing(outline: Polygon, edge: Edge) -> Sequence[float] | None:
    """Finds from where to where along the edge an outline crosses it, m; None where it does not."""
    p = np.array(edge.point)
    line = LineString(
        [p - EDGE_LINE_HALF_LENGTH * edge.tangent, p + EDGE_LINE_HALF_LENGTH * edge.tangent]
    )
    crossing = shapely.get_coordinates(outline.intersection(line))
    if len(crossing) < 2:
        return None
    s = edge.calc_along(crossing)
    return float(s.min()), float(s.max())


def _list_places(outline: Polygon, rules: PressRules) -> Array:
    """Lists places (K, 2) on a grid at which the tip is over an outline, m, in its frame."""
    room = outline.buffer(-rules.rim)
    if room.is_empty:
        return np.empty((0, 2))
    left, low, right, high = room.bounds
    x, y = np.meshgrid(_divide(left, right, rules.spacing), _divide(low, high, rules.spacing))
    grid = np.column_stack([x.ravel(), y.ravel()])
    return np.asarray(grid[shapely.contains_xy(room, grid[:, 0], grid[:, 1])])


def _divide(low: float, high: float, spacing: float) -> Array:
    """Divides an interval into equal parts, no longer than `spacing`, and returns their middles."""
    count = ceil((high - low) / spacing)
    return np.asarray(low + (high - low) / count * (np.arange(count) + 0.5), dtype=np.float64)
