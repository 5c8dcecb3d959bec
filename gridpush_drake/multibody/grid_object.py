"""A grid object as a body of a MultibodyPlant.

One rigid body with the cells' inertia stands on contact spheres, a cell on one (or four), and is
pushed at boxes along its outline. Two ways to hold it:

* "planar": a PlanarJoint whose parent frame lies `delta` below the table's top. Each sphere is
  pressed in by delta, so cell i bears m_i g by construction, as the planar model assumes. For dt =
  1 ms.
* "free": six degrees of freedom: it can tip over the table's edge and be lifted; the cells' loads
  shift as it is pushed above the table. For dt = 2 ms.

The plant's contact approximation is best left at Drake's default, "lagged": "sap" and "similar"
glide.

Frames: the table's top is the plane z = 0 of the world; the object's bottom is z = 0 of B, whose x
and y are the grid object's own. Spheres touch nothing but the table, sides everything but the
table.

A sphere that carries the fraction m_i g of the weight, pressed in by delta, has stiffness

    k_i = m_i g / delta

so that, pressed in by delta, it bears just that fraction, whatever the other spheres do.

A finger pushes at boxes. Contact of a sphere and a box is solved in closed form in Drake, that of
sphere and convex mesh by iteration. So each edge of the outline is the outer face of one box, as
deep as the object lets it be. A sphere's nearest point on these boxes is the nearest point of the
outline, corners and holes included; a corner shared by two boxes gives the same contact twice. The
inside is filled with boxes too, a little clear of the outline, so that whatever else comes down on
the object or grips it is not let through.
"""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from pydrake.common import MemoryFile
from pydrake.geometry import (
    Box,
    CollisionFilterDeclaration,
    CollisionFilterScope,
    GeometryId,
    GeometrySet,
    InMemoryMesh,
    Mesh,
    ProximityProperties,
    Role,
    SceneGraph,
    Sphere,
)
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    BodyIndex,
    FixedOffsetFrame,
    JointIndex,
    ModelInstanceIndex,
    PlanarJoint,
    RigidBody,
    SpatialInertia,
)
from pydrake.systems.framework import Context
from shapely import Polygon, box, prepare

from gridpush_drake.dynamics.bodies import Bodies
from gridpush_drake.errors import ObjectError, ParameterError, require_positive
from gridpush_drake.geometry.outline_mesh import make_outline_mesh
from gridpush_drake.geometry.se2 import Array, IntArray
from gridpush_drake.multibody.contact_material import MakeContactProperties, calc_own_friction
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters

SPHERE_RADIUS = 0.002
"""Radius of a contact sphere, m; more than the spheres are ever pressed in."""

SpheresPerCell = Literal[1, 4]


@dataclass(frozen=True, eq=False)
class Feet:
    """What a free object stands on: a foot below each cell.

    Attributes:
        stiffness: (n,) what each foot bears where all are pressed in as far as by the object's
            weight, kg.
        gap: (n,) how much higher each foot ends than the longest one, m. An object on three feet
            has three that end lowest; all others are its underside.
    """

    stiffness: Array
    gap: Array


@dataclass(frozen=True, eq=False)
class ContactSphereLayout:
    """Where an object's contact spheres are.

    Attributes:
        p_BS: (f, 2) where the spheres touch the table, body frame, m.
        cell: (f,) the cell that each of them belongs to.
        spheres_per_cell: 1 for spheres at the cells' centers, 4 for spheres at their corners.
    """

    p_BS: Array
    cell: IntArray
    spheres_per_cell: SpheresPerCell

    @classmethod
    def for_object(
        cls, obj: GridObject, spheres_per_cell: SpheresPerCell = 1
    ) -> "ContactSphereLayout":
        """Lays out the spheres of an object, cell by cell.

        Args:
            obj: the object.
            spheres_per_cell: 1, or 4 to support the object out to its edge.

        Raises:
            ParameterError: `spheres_per_cell` is neither.
        """
        if spheres_per_cell == 1:
            return cls(obj.p_BC, np.arange(obj.n), 1)
        if spheres_per_cell != 4:
            raise ParameterError(f"spheres_per_cell is {spheres_per_cell!r}; expected 1 or 4")
        corners = obj.cell_size / 2 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        p_BS = (obj.p_BC[:, None] + corners).reshape(-1, 2)
        return cls(p_BS=p_BS, cell=np.repeat(np.arange(obj.n), 4), spheres_per_cell=4)

    def make_properties(
        self, params: CellParameters, delta: float, gravity: float, support: Feet | None = None
    ) -> list[ProximityProperties]:
        """Makes the spheres' contact properties.

        Args:
            params: the cells' masses and frictions.
            delta: how far the spheres are pressed in at rest, m.
            gravity: m/s².
            support: on what the object stands; by default each cell bears its own mass.

        Raises:
            ParameterError: a friction is 2 or more, which Drake's combination cannot give.
        """
        # k_i = m_i g / delta, shared by the spheres of a cell
        borne = params.mass if support is None else support.stiffness
        stiffness = borne * gravity / (delta * self.spheres_per_cell)
        friction = [
            calc_own_friction(float(mu), f"friction of cell {i}")
            for i, mu in enumerate(params.friction)
        ]
        return [MakeContactProperties(friction[i], float(stiffness[i])) for i in self.cell]

    def place_spheres(self, support: Feet | None = None) -> list[RigidTransform]:
        """Places the spheres' centers in B, on the feet that the object stands on."""
        gap = np.zeros(len(self.cell)) if support is None else support.gap[self.cell]
        return [
            RigidTransform([x, y, SPHERE_RADIUS + z])
            for (x, y), z in zip(self.p_BS, gap, strict=True)
        ]


MAX_DEPTH = 0.01
"""Largest depth of a box behind an edge of the outline, m."""

MAX_HALVINGS = 12
"""Largest number of times that a box behind an edge is made half as deep for want of room."""

MAX_PROTRUSION = 1e-6
"""Distance by which boxes may stand out of the outline next to a sharp corner, m."""

STRIP_COUNT = 24
"""Number of rows of boxes that fill the inside."""

OUTLINE_CLEARANCE = 5e-4
"""Distance from the outline to the boxes that fill the inside, m; deeper than a finger presses
in."""


@dataclass(frozen=True, eq=False)
class PlanarBox:
    """A rectangle in the body frame.

    Attributes:
        center: (2,) its center, m.
        angle: angle of its length from the x axis, rad.
        size: length and width, m.
    """

    center: Array
    angle: float
    size: tuple[float, float]


def make_edge_boxes(obj: GridObject) -> list[PlanarBox]:
    """Makes a box behind every edge of the outline, those of the exterior first.

    The box's outer face is the edge, and it is as deep as the object lets it be.
    """
    room = obj.outline.buffer(MAX_PROTRUSION)
    prepare(room)
    boxes = []
    for start, end in zip(obj.edges.start, obj.edges.end, strict=True):
        length = float(np.linalg.norm(end - start))
        along = (end - start) / length
        inward = np.array([-along[1], along[0]])
        depth = MAX_DEPTH
        for _ in range(MAX_HALVINGS):
            if room.covers(Polygon([start, end, end + depth * inward, start + depth * inward])):
                break
            depth /= 2
        center = (start + end) / 2 + depth / 2 * inward
        angle = float(np.arctan2(along[1], along[0]))
        boxes.append(PlanarBox(center=center, angle=angle, size=(length, depth)))
    return boxes


def make_inner_boxes(obj: GridObject) -> list[PlanarBox]:
    """Fills the outline, clear of it, with boxes that lie in STRIP_COUNT rows along the x axis."""
    room = obj.outline.buffer(-OUTLINE_CLEARANCE)
    if room.is_empty:
        return []
    left, bottom, right, top = room.bounds
    boxes = []
    for low, high in pairwise(np.linspace(bottom, top, STRIP_COUNT + 1)):
        outside = box(left, low, right, high).difference(room)
        # The row is free where nothing outside is seen along y: between the ranges of x that the
        # pieces outside cover.
        pieces = [piece for piece in getattr(outside, "geoms", [outside]) if piece.area]
        seen = sorted((piece.bounds[0], piece.bounds[2]) for piece in pieces)
        reached = left
        for start, end in [*seen, (right, right)]:
            if start - reached > OUTLINE_CLEARANCE:
                center = np.array([reached + start, low + high]) / 2
                size = (start - reached, high - low)
                boxes.append(PlanarBox(center=center, angle=0.0, size=size))
            reached = max(reached, end)
    return boxes


Base = Literal["planar", "free"]

DEFAULT_HEIGHT = 0.03
"""Height of an object whose file does not tell it, m."""

DEFAULT_DELTA = {"planar": 1e-3, "free": 1e-6}
"""How far the spheres are pressed in at rest, m. A free body on softer spheres tips falsely."""

SIDE_STIFFNESS = 3e5
"""Stiffness of the outline, N/m: a push of 3 N presses the finger in by 0.01 mm. Friction of
Drake's lagged contact follows the normal force of the step before. On a stiffer outline that force
jumps from step to step, and the finger slips."""

SIDE_DISSIPATION = 100.0
"""Dissipation of the outline's contacts by Hunt and Crossley, s/m. It keeps the finger from
bouncing."""

DEFAULT_COLOR = (0.55, 0.62, 0.7, 1.0)
"""Color of an object: red, green, blue and opacity, 0 to 1."""


@dataclass(frozen=True, eq=False)
class GridObjectInPlant:
    """A grid object's parts in a plant.

    Attributes:
        obj: the object.
        base: "planar" or "free".
        model_instance: the object's own model instance.
        plant: the plant.
        body_index: index of the rigid body, with frame B.
        joint_index: index of the planar joint; None for a free base.
        contact_spheres: geometries of the spheres, in the order of `layout`.
        sides: geometries along and within the outline.
        visuals: illustration geometries.
        layout: where the spheres are.
        height: height of the object, m.
        delta: how far the spheres are pressed in at rest, m.
        side_stiffness: stiffness of the outline's contacts, N/m.
        table: geometries that the spheres stand on.
    """

    obj: GridObject
    base: Base
    model_instance: ModelInstanceIndex
    plant: MultibodyPlant
    body_index: BodyIndex
    joint_index: JointIndex | None
    contact_spheres: tuple[GeometryId, ...]
    sides: tuple[GeometryId, ...]
    visuals: tuple[GeometryId, ...]
    layout: ContactSphereLayout
    height: float
    delta: float
    side_stiffness: float
    table: tuple[GeometryId, ...]

    @property
    def body(self) -> RigidBody:
        """The rigid body.

        It is not kept, for it holds its plant where the garbage collector does not see it.
        """
        return self.plant.get_body(self.body_index)

    @property
    def joint(self) -> PlanarJoint | None:
        """The planar joint; None for a free base."""
        return None if self.joint_index is None else self.plant.get_joint(self.joint_index)


def AddGridObject(
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    model: Bodies,
    base: Base = "planar",
    *,
    table: Iterable[GeometryId],
    height: float = DEFAULT_HEIGHT,
    name: str | None = None,
    delta: float | None = None,
    spheres_per_cell: SpheresPerCell = 1,
    support: Feet | None = None,
    rim_gap: float = 0.0,
    side_stiffness: float = SIDE_STIFFNESS,
    visual: bool = True,
    color: Sequence[float] = DEFAULT_COLOR,
    touches: bool = True,
) -> GridObjectInPlant:
    """Adds a grid object to a plant, before Finalize.

    The table and the pusher's tip are to be stiff partners (`contact_material.SetPartner`). Spheres
    and sides are filtered against whatever else is in the plant by now; where more is added
    afterwards, call `ApplyGridObjectFilters` again.

    Args:
        plant: a discrete plant; its gravity field is the one that the spheres are made for.
        scene_graph: the plant's.
        model: one object, with its parameters.
        base: how it is held, "planar" or "free"; see the head of this module.
        table: collision geometries that the spheres stand on; top at z = 0.
        height: height of the object, m.
        name: name of model instance and body, which no other model has; the object's by default.
        delta: how far the spheres are pressed in at rest, m; by default 1e-3 for "planar", 1e-6 for
            "free".
        spheres_per_cell: 1, or 4: at the cells' corners, so that the object is supported out to its
            edge. Over a table's edge it tips up to one cell early, either way.
        support: on what it stands (see `ground_truth.calc_support`). By default each cell bears its
            own weight.
        rim_gap: height of its flat underside above the table, m, which a table's edge touches when
            the object tilts; 0 for an object that lies flat. Its feet alone touch the table.
        side_stiffness: stiffness of the outline's contacts, N/m.
        visual: whether it has illustration geometry.
        color: red, green, blue and opacity of that geometry.
        touches: whether it touches anything. One that is only looked at needs no contact geometry,
            and no table.

    Returns:
        The object's parts in the plant.

    Raises:
        ObjectError: `base` is neither, a size is not positive, there is no table, or a model of
            that name.
        ParameterError: the parameters are of another number of cells, or a friction is 2 or more.
    """
    obj = model.obj
    if base not in DEFAULT_DELTA:
        raise ObjectError(f"base is {base!r}; expected 'planar' or 'free'")
    delta = DEFAULT_DELTA[base] if delta is None else delta
    require_positive(ObjectError, height=height, delta=delta, side_stiffness=side_stiffness)
    if not 0 <= rim_gap < height:
        raise ObjectError(
            f"rim_gap is {rim_gap!r}; expected 0 or more, and less than the height, {height:g} m"
        )
    table = list(table)
    if touches and not table:
        raise ObjectError(
            "table is empty; expected the collision geometries that the spheres stand on"
        )
    name = obj.name if name is None else name
    if plant.HasModelInstanceNamed(name):
        raise ObjectError(
            f"name is {name!r}, as another model's in the plant; expected one of its own"
        )
    layout = ContactSphereLayout.for_object(obj, spheres_per_cell)
    model_instance = plant.AddModelInstance(name)
    body = plant.AddRigidBody(name, model_instance, MakeSpatialInertia(model, height))
    joint = _hold(plant, body, base, delta)
    spheres: tuple[GeometryId, ...] = ()
    sides: tuple[GeometryId, ...] = ()
    visuals: tuple[GeometryId, ...] = ()
    if touches:
        spheres = _add_spheres(plant, body, layout, model.params, delta, support)
        sides = _add_sides(plant, body, model, (rim_gap, height), side_stiffness)
    if visual:
        visuals = _add_visual(plant, scene_graph, body, obj, height, color)
    handle = GridObjectInPlant(
        obj=obj,
        base=base,
        model_instance=model_instance,
        plant=plant,
        body_index=body.index(),
        joint_index=joint and joint.index(),
        contact_spheres=spheres,
        sides=sides,
        visuals=visuals,
        layout=layout,
        height=height,
        delta=delta,
        side_stiffness=side_stiffness,
        table=tuple(table),
    )
    if touches:
        ApplyGridObjectFilters(plant, scene_graph, handle, table)
    return handle


def MakeSpatialInertia(model: Bodies, height: float = DEFAULT_HEIGHT) -> SpatialInertia:
    """Sums up the cells' inertia, each cell a homogeneous square prism.

    Args:
        model: one object, with its parameters.
        height: its height, m.

    Returns:
        M_BBo_B, about B's origin at the object's bottom.

    Raises:
        ParameterError: the parameters are of another number of cells, or Drake finds the masses
            unphysical.
    """
    obj = model.obj
    params = model.params
    params.center_of_mass(obj)  # says so where the numbers of cells differ
    total = SpatialInertia.Zero()
    with refuse_unphysical(model):
        for (x, y), mass in zip(obj.p_BC, params.mass, strict=True):
            cell = SpatialInertia.SolidBoxWithMass(mass, obj.cell_size, obj.cell_size, height)
            total += cell.Shift([-x, -y, -height / 2])
    return total


@contextmanager
def refuse_unphysical(model: Bodies) -> Iterator[None]:
    """Turns Drake's complaint about an inertia into a ParameterError that names the masses."""
    obj = model.obj
    params = model.params
    try:
        yield
    except RuntimeError as error:
        raise ParameterError(
            f"{obj.name}: mass or height: cells of {params.mass.min():g} to {params.mass.max():g} "
            f"kg, {obj.cell_size:g} m wide, make no inertia that Drake takes for physical; "
            "expected other sizes"
        ) from error


def MakeSideProperties(params: CellParameters, stiffness: float) -> ProximityProperties:
    """Makes the contact properties of an object's sides, of a stiffness, N/m."""
    friction = calc_own_friction(params.contact_friction, "contact_friction")
    return MakeContactProperties(friction, stiffness, SIDE_DISSIPATION)


def calc_gravity(plant: MultibodyPlant) -> float:
    """Calculates the magnitude of a plant's gravity, m/s²; it points down."""
    return float(np.linalg.norm(plant.gravity_field().gravity_vector()))


def ApplyGridObjectFilters(
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    handle: GridObjectInPlant,
    table: Iterable[GeometryId],
    context: Context | None = None,
) -> None:
    """Lets an object's spheres touch the table alone, and its sides everything but the table.

    That is of what is in the plant by now; see `AddGridObject`.

    Args:
        plant: the plant.
        scene_graph: its SceneGraph.
        handle: the object.
        table: collision geometries that the spheres stand on.
        context: Context of the SceneGraph in which it is to hold; by default the model itself.
    """
    table = list(table)
    inspector = scene_graph.model_inspector()
    everything = GeometrySet(inspector.GetAllGeometryIds())
    others = set(inspector.GetGeometryIds(everything, Role.kProximity)) - set(table)
    spheres = GeometrySet(list(handle.contact_spheres))
    sides = GeometrySet(list(handle.sides))
    declaration = CollisionFilterDeclaration(CollisionFilterScope.kAll)
    declaration.ExcludeBetween(spheres, GeometrySet(list(others)))
    declaration.ExcludeWithin(spheres)
    declaration.ExcludeBetween(sides, GeometrySet(table))
    if context is None:
        scene_graph.collision_filter_manager().Apply(declaration)
    else:
        scene_graph.collision_filter_manager(context).Apply(declaration)


def _hold(plant: MultibodyPlant, body: RigidBody, base: Base, delta: float) -> PlanarJoint | None:
    """Holds the body so that its spheres are pressed in: by a joint, or by its initial pose."""
    X_WB = RigidTransform([0.0, 0.0, -delta])
    if base == "free":
        plant.SetDefaultFloatingBaseBodyPose(body, X_WB)
        return None
    frame = plant.AddFrame(
        FixedOffsetFrame(f"{body.name()}_table", plant.world_frame(), X_WB, body.model_instance())
    )
    return plant.AddJoint(
        PlanarJoint(f"{body.name()}_planar", frame, body.body_frame(), np.zeros(3))
    )


def _add_spheres(
    plant: MultibodyPlant,
    body: RigidBody,
    layout: ContactSphereLayout,
    params: CellParameters,
    delta: float,
    support: Feet | None,
) -> tuple[GeometryId, ...]:
    """Adds the contact spheres below the cells."""
    properties = layout.make_properties(params, delta, calc_gravity(plant), support)
    shape = Sphere(SPHERE_RADIUS)
    return tuple(
        plant.RegisterCollisionGeometry(body, X_BS, shape, f"sphere_{i}", properties[i])
        for i, X_BS in enumerate(layout.place_spheres(support))
    )


def _add_sides(
    plant: MultibodyPlant,
    body: RigidBody,
    model: Bodies,
    between: tuple[float, float],
    stiffness: float,
) -> tuple[GeometryId, ...]:
    """Adds the boxes along and within the outline, between two heights, m."""
    obj = model.obj
    properties = MakeSideProperties(model.params, stiffness)
    low, high = between

    def add(name: str, flat: PlanarBox) -> GeometryId:
        X_BG = RigidTransform(RollPitchYaw(0, 0, flat.angle), [*flat.center, (low + high) / 2])
        return plant.RegisterCollisionGeometry(
            body, X_BG, Box(*flat.size, high - low), name, properties
        )

    edges = [add(f"edge_{i}", flat) for i, flat in enumerate(make_edge_boxes(obj))]
    inside = [add(f"inside_{i}", flat) for i, flat in enumerate(make_inner_boxes(obj))]
    return (*edges, *inside)


def _add_visual(
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    body: RigidBody,
    obj: GridObject,
    height: float,
    color: Sequence[float],
) -> tuple[GeometryId, ...]:
    """Adds the prism of the outline that is seen; cameras do not see it."""
    file = MemoryFile(make_outline_mesh(obj.outline, height), ".obj", f"{obj.name}.obj")
    geometry = plant.RegisterVisualGeometry(
        body,
        RigidTransform(),
        Mesh(InMemoryMesh(mesh_file=file)),
        "outline",
        np.asarray(color, dtype=float),
    )
    scene_graph.RemoveRole(plant.get_source_id(), geometry, Role.kPerception)
    return (geometry,)
