"""A learned object and the finger that pushes it, as the compiled search takes them.

Also where both may be: `make_room` turns a table and obstacles into fields of distances, so that
the search can ask for hundreds of thousands of poses a second how near they come.
"""

from dataclasses import dataclass

import numpy as np
import shapely

from gridpush_drake.dynamics.kernel_call import make_support, prepare_rollout
from gridpush_drake.dynamics.kernels.steering.finger_push import (
    FreeSpace,
    PushedModel,
    ShapedModel,
)
from gridpush_drake.dynamics.physics import QUASI_STATIC, Physics
from gridpush_drake.dynamics.pusher import PusherShape
from gridpush_drake.dynamics.scene.kernel_call import (
    count_contact_room,
    make_bodies,
    make_tolerances,
    make_tool,
)
from gridpush_drake.errors import PlanningError, require_positive
from gridpush_drake.geometry.se2 import Array, make_direction, transform, wrap_angle
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.push_constraints import PushConstraints, make_body

SearchModel = PushedModel | ShapedModel
"""A model of the object as the compiled search takes it, under a disc or another shape."""

ROLLOUT_STEP = 0.0025
"""Length of the finger's path in a step of a rollout, m."""

FIELD_SPACING = 0.005
"""Distance of the nodes of a field, m."""

MAX_NODES = 400
"""Greatest number of nodes along either side of a field; the spacing is made larger for it."""

POINT_SPACING = 0.004
"""Distance of the points round an object that are looked up in a field, m."""

FIELD_ROOM = 0.3
"""By how much a field reaches beyond obstacles and start where there is no table, m."""

APPROACH_GAP = 0.012
"""Gap between finger and object where the finger comes down, m."""


@dataclass(frozen=True)
class FeedbackFinger:
    """The finger that pushes with feedback, whose velocity can be commanded: a disc, or a shape.

    Attributes:
        radius: of the disc, or of the shape's round corners, m.
        speed: greatest speed while it pushes, m/s.
        walking_speed: greatest speed on its way round the object, m/s.
        shape: of a finger that is no disc, such as a plate, which is steered with its angle; None
            of a disc.
        turning_speed: greatest speed at which such a finger turns, rad/s.
        most_yaw: greatest size of its angle, rad, which counts whole turns; a wrist turns no
            farther.

    Raises:
        PlanningError: a number is not positive, or the radius is not the shape's.
    """

    radius: float
    speed: float = 0.1
    walking_speed: float = 0.2
    shape: PusherShape | None = None
    turning_speed: float = 1.5
    most_yaw: float = np.inf

    def __post_init__(self) -> None:
        require_positive(PlanningError, "finger: ", "m", radius=self.radius)
        require_positive(
            PlanningError, "finger: ", "m/s", speed=self.speed, walking_speed=self.walking_speed
        )
        require_positive(PlanningError, "finger: ", "rad/s", turning_speed=self.turning_speed)
        if not self.most_yaw > 0:
            raise PlanningError(
                f"finger: most_yaw is {self.most_yaw!r}; expected a number > 0 (rad)"
            )
        if self.shape is not None and self.shape.radius != self.radius:
            raise PlanningError(
                f"finger: radius is {self.radius!r}; expected {self.shape.radius!r}, the shape's"
            )

    @property
    def reach(self) -> float:
        """How far it reaches from its center at most, m."""
        return self.radius if self.shape is None else self.shape.reach

    @property
    def coordinates(self) -> int:
        """Number of coordinates of its place: x and y, and the angle of a shape."""
        return 2 if self.shape is None else 3

    def place_beside(self, obj: GridObject, pose: Array, direction: float) -> Array:
        """Finds its place (D,) beside an object, W, m; one that is no disc faces it, rad.

        Args:
            obj: the object.
            pose: (3,) where it lies, X_WB, m and rad.
            direction: from the cells' centroid to the finger, W, rad.
        """
        away = make_direction(np.array(direction))
        corners = transform(pose, shapely.get_coordinates(obj.outline))
        center = transform(pose, obj.p_BC.mean(axis=0)[None])[0]
        distance = float(((corners - center) @ away).max()) + self.reach + APPROACH_GAP
        place = np.append(center + distance * away, wrap_angle(direction + np.pi))
        return place[: self.coordinates]


def make_model(
    obj: GridObject,
    params: CellParameters,
    radius: float,
    physics: Physics | None = None,
    *,
    shape: PusherShape | None = None,
    approximate: bool = True,
) -> SearchModel:
    """Makes a model as the compiled search takes it.

    Args:
        obj: the object.
        params: its masses and frictions.
        radius: of the finger, m.
        physics: physics of the model; its regime does not matter, for the search is quasi-static.
        shape: of a finger that is no disc.
        approximate: whether poses may be a little off, as in `PushBatch`; not of what stands for
            the true object.

    Raises:
        PlanningError: the parameters are those of another object, or the friction law knows no
            slow pushes.
    """
    if params.n != obj.n:
        raise PlanningError(f"model: has {params.n} cells; expected {obj.n}, as {obj.name} has")
    used = QUASI_STATIC if physics is None else physics
    if "quasi_static" not in used.law.regimes:
        raise PlanningError(
            f"physics: friction_law {used.friction_law!r} knows no slow pushes; expected one that "
            "knows the regime 'quasi_static'"
        )
    used = used.with_regime("quasi_static")
    if not float(params.friction @ params.mass) * used.gravity > 0:
        raise PlanningError("model: expected some friction with the support")
    model = Model(obj, params, used)
    corners = shapely.get_coordinates(obj.outline)
    reach = float(np.linalg.norm(corners, axis=1).max())
    if shape is not None:
        tool = make_tool(shape)
        bodies = make_bodies(model)
        return ShapedModel(
            bodies=bodies,
            support=make_support(model, None),
            tolerances=make_tolerances(used),
            tool=tool,
            edges=bodies.outline,
            reach=reach,
            radius=shape.reach,
            step=ROLLOUT_STEP,
            contacts=count_contact_room(1, tool),
        )
    law, body, support, edges, scheme = prepare_rollout(model, None, approximate=approximate)
    return PushedModel(
        law=law,
        body=body,
        support=support,
        edges=edges,
        scheme=scheme,
        reach=reach,
        radius=float(radius),
        step=ROLLOUT_STEP,
    )


def make_room(
    obj: GridObject, constraints: PushConstraints, finger: FeedbackFinger, places: Array
) -> FreeSpace:
    """Makes the fields of where object and finger may be.

    Args:
        obj: the object.
        constraints: table, obstacles, margins and the finger's region.
        finger: the finger.
        places: (K, 2) in W that the fields must reach, where there is no table, m.
    """
    # points round the object, which stand for all of it
    rim = make_body(obj).exterior
    count = int(np.ceil(rim.length / POINT_SPACING))
    points = shapely.get_coordinates(
        shapely.line_interpolate_point(rim, np.arange(count) / count, normalized=True)
    )
    areas = [] if constraints.surface is None else [constraints.surface.polygon]
    if constraints.finger_region is not None:
        areas.append(constraints.finger_region)
    shapes = [*areas, *constraints.obstacles]
    if not shapes:
        nothing = np.zeros((2, 2))
        return FreeSpace(
            bounded=False,
            low=np.zeros(2),
            spacing=1.0,
            object_field=nothing,
            finger_field=nothing,
            points=points,
        )

    # the nodes reach as far as the table, or as the object may be met
    boxes = np.array([shape.bounds for shape in shapes]).reshape(-1, 2)
    corners = np.concatenate([boxes, places])
    low = corners.min(axis=0) - FIELD_ROOM
    high = corners.max(axis=0) + FIELD_ROOM
    spacing = max(FIELD_SPACING, float((high - low).max()) / MAX_NODES)
    counts = np.ceil((high - low) / spacing).astype(int) + 1
    x, y = np.meshgrid(*(low[i] + spacing * np.arange(counts[i]) for i in range(2)), indexing="ij")
    nodes = shapely.points(x, y)

    # how far each node is from what is forbidden, less the margins
    object_field = np.full(counts, np.inf)
    finger_field = np.full(counts, np.inf)
    if constraints.surface is not None:
        depth = _measure_depth(constraints.surface.polygon, nodes)
        object_field = np.minimum(object_field, depth - constraints.edge_margin)
        finger_field = np.minimum(finger_field, depth - constraints.finger_inset)
    if constraints.finger_region is not None:
        depth = _measure_depth(constraints.finger_region, nodes)
        finger_field = np.minimum(finger_field, depth)
    if constraints.obstacles:
        away = -_measure_depth(shapely.union_all(list(constraints.obstacles)), nodes)
        away -= constraints.obstacle_margin
        object_field = np.minimum(object_field, away)
        finger_field = np.minimum(finger_field, away - finger.reach)
    return FreeSpace(
        bounded=True,
        low=low,
        spacing=spacing,
        object_field=object_field,
        finger_field=finger_field,
        points=points,
    )


def covers_places(room: FreeSpace, places: Array) -> bool:
    """Whether the fields reach as far about places (K, 2), m, as they should."""
    if not room.bounded:
        return True
    high = room.low + room.spacing * (np.array(room.object_field.shape) - 1)
    inside = (places >= room.low + FIELD_ROOM) & (places <= high - FIELD_ROOM)
    return bool(inside.all())


def _measure_depth(shape: shapely.Geometry, nodes: Array) -> Array:
    """How deep inside a shape nodes are, m; negative outside."""
    depth = shapely.distance(shapely.boundary(shape), nodes)
    shapely.prepare(shape)
    return np.where(shapely.covers(shape, nodes), depth, -depth)
