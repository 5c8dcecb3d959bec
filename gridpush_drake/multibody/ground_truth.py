"""What an object weighs and how it rubs, drawn at random and hidden from whoever is to find out.

Its pose and its hidden truth are set in a Context: one Diagram serves for many runs.
"""

from typing import Any, Literal

import numpy as np
import shapely
from numpy.typing import ArrayLike
from pydrake.geometry import RoleAssign, SceneGraph, Sphere
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.math import SpatialVelocity
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Context
from scipy.optimize import linprog
from scipy.spatial import cKDTree

from gridpush_drake.errors import ObjectError
from gridpush_drake.geometry.se2 import Array, IntArray, check_vector
from gridpush_drake.identification.model import Model
from gridpush_drake.multibody.grid_object import (
    SPHERE_RADIUS,
    ApplyGridObjectFilters,
    Feet,
    GridObjectInPlant,
    MakeSideProperties,
    MakeSpatialInertia,
    calc_gravity,
)
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import DEFAULT_TOTAL_MASS, CellParameters

Range = tuple[float, float]

CELL_MASS_RANGE = (0.1, 1.0)
"""Smallest and largest mass of a cell, kg, before all are scaled to the object's total mass. One
draw is made for each part."""

FRICTION_RANGE = (0.2, 0.6)
"""Smallest and largest friction coefficient of the cells against the support."""

CONTACT_FRICTION_RANGE = (0.35, 0.65)
"""Smallest and largest friction coefficient of the pusher against the object."""

MIN_TILT = 0.05
"""Smallest factor of a mass that is tilted, see `resample_parameters`."""


def sample_ground_truth(
    obj: GridObject,
    seed: int,
    *,
    cell_mass_range: Range = CELL_MASS_RANGE,
    friction_range: Range = FRICTION_RANGE,
    contact_friction_range: Range = CONTACT_FRICTION_RANGE,
    friction_by_part: bool = False,
) -> CellParameters:
    """Draws what the parts weigh and how they rub.

    The total mass is the object's, or `DEFAULT_TOTAL_MASS`.

    Args:
        obj: the object.
        seed: seed of the draws.
        cell_mass_range: smallest and largest mass of a cell before all are scaled to the total, kg;
            one draw for each part, uniform in the logarithm.
        friction_range: smallest and largest coefficient against the support.
        contact_friction_range: smallest and largest coefficient against the pusher.
        friction_by_part: whether every part has a friction of its own. Slow pushes cannot tell mass
            and friction apart, and the center of mass can only be learned where they do not vary
            both.

    Returns:
        Masses and frictions of all cells.
    """
    drawn = CellParameters.random(
        obj, seed, cell_mass_range, friction_range if friction_by_part else None
    )
    total = obj.prior.total_mass or DEFAULT_TOTAL_MASS
    rng = np.random.default_rng((seed, 1))
    contact_friction = float(rng.uniform(*contact_friction_range))
    friction = drawn.friction if friction_by_part else np.full(obj.n, rng.uniform(*friction_range))
    return CellParameters(drawn.mass * (total / drawn.total_mass), friction, contact_friction)


def resample_parameters(model: Model, other: GridObject) -> CellParameters:
    """Carries parameters over to another grid of the same object, such as one that a camera saw.

    Each cell takes mass by area and friction from the nearest one. Then masses are tilted, linearly
    over the object, so that total mass and center of mass are kept.

    Args:
        model: one object, with its parameters.
        other: the same object on another grid, in the same frame.

    Returns:
        Parameters of the other grid's cells; `params` themselves where it is the same object.
    """
    obj = model.obj
    params = model.params
    if other is obj:
        return params
    nearest = cKDTree(obj.p_BC).query(other.p_BC)[1]
    center = params.center_of_mass(obj)
    mass = params.mass[nearest]
    mass = mass * (params.mass.sum() / mass.sum())
    # The factor a + b . (p - c) that keeps the sums of m and of m (p - c)
    off = other.p_BC - center
    moments = np.column_stack([np.ones(other.n), off])
    wanted = [params.mass.sum(), 0.0, 0.0]
    tilt = np.linalg.solve(moments.T @ (mass[:, None] * moments), wanted)
    tilted = mass * np.maximum(moments @ tilt, MIN_TILT)
    return CellParameters(tilted, params.friction[nearest], params.contact_friction)


Support = Literal["own_weight", "foundation", "three_feet", "vertices"]
"""How a free body stands: each cell bears its own weight, on an evenly compliant bottom, on three
feet, or on uneven feet at the vertices of its outline's hull."""

BEARING_FEET = 3
"""Number of rigid feet that share a body's weight, which says how stiff each is."""

FEET_SLACK = 0.002
"""Distance of the center of mass from the sides of three feet's triangle, m, beside that by which a
push moves the load."""

SOFT_STIFFNESS_RATIO = 1e-3
"""Stiffness of the bottom beside three feet, relative to an even one: it bears where a foot is over
the edge."""

MAX_FEET_DRAWS = 20_000
"""Largest number of draws of three feet."""


def calc_support(
    model: Model,
    support: Support,
    seed: int,
    push_height: float,
    rim_gap: float = 0.0,
) -> Feet | None:
    """Draws on what a body stands.

    Args:
        model: one object, with its parameters.
        support: how it stands.
        seed: seed by which feet are drawn.
        push_height: height of a pusher that must not tip the body from three feet, m.
        rim_gap: height of the underside above the table beside three feet or feet at the
            vertices, m; the latter are uneven by up to as much. With 0 the underside beside three
            feet touches the table, and is soft.

    Returns:
        A foot below each cell; None where each cell bears its own weight.

    Raises:
        ObjectError: no three feet are found.
    """
    obj = model.obj
    params = model.params
    even = params.total_mass / obj.n
    flat = np.zeros(obj.n)
    if support == "own_weight":
        return None
    if support == "foundation":
        return Feet(np.full(obj.n, even), flat)
    rng = np.random.default_rng((seed, 2))
    if support == "three_feet":
        margin = float(params.friction.max()) * push_height + FEET_SLACK
        feet = draw_feet(model, margin, rng)
        length = np.zeros(len(feet))
    else:
        rim = shapely.get_coordinates(obj.outline.convex_hull)[:-1]
        feet = np.unique(cKDTree(obj.p_BC).query(rim)[1])
        length = rng.uniform(0.0, rim_gap, len(feet))
        length -= length.min()
    stiffness = np.full(obj.n, even if rim_gap > 0 else SOFT_STIFFNESS_RATIO * even)
    stiffness[feet] = params.total_mass / BEARING_FEET
    gap = np.full(obj.n, rim_gap)
    gap[feet] = length
    return Feet(stiffness, gap)


def calc_rigid_loads(places: Array, gap: Array, center: Array) -> Array:
    """Calculates what rigid feet bear where a body lies at rest.

    Of all loads in equilibrium with the weight, they are those that hold it lowest:

        min_N  sum N_i gap_i    s.t.  N >= 0,  sum N_i = 1,  sum N_i p_i = p_com

    Args:
        places: (F, 2) p_i, where the feet are, m.
        gap: (F,) how much higher each of them ends than the longest one, m.
        center: (2,) p_com, m.

    Returns:
        (F,) N, as fractions of the weight.

    Raises:
        ObjectError: the center of mass is not above the feet.
    """
    # In units of the body's size, so that tolerances are relative ones.
    size = float(np.abs(places - center).max())
    balance = np.vstack([np.ones(len(places)), (places - center).T / size])
    found = linprog(gap / size, A_eq=balance, b_eq=[1.0, 0.0, 0.0])
    if found.x is None:
        raise ObjectError("feet: the center of mass is not above them")
    return np.asarray(found.x)


def draw_feet(model: Model, margin: float, rng: np.random.Generator) -> IntArray:
    """Draws three cells whose triangle holds the center of mass.

    Args:
        model: one object, with its parameters.
        margin: least distance of the center of mass from the triangle's sides, m.
        rng: the generator that draws.

    Returns:
        (3,) the cells.

    Raises:
        ObjectError: none are found.
    """
    obj = model.obj
    center = shapely.Point(model.params.center_of_mass(obj))
    for _ in range(MAX_FEET_DRAWS):
        cells = rng.choice(obj.n, 3, replace=False)
        triangle = shapely.Polygon(obj.p_BC[cells])
        if triangle.covers(center) and triangle.exterior.distance(center) >= margin:
            return np.asarray(cells, dtype=np.int64)
    raise ObjectError(
        f"{obj.name}: found no three feet about the center of mass, {margin:g} m from every side"
    )


def _move_spheres(
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    scene_context: Context,
    handle: GridObjectInPlant,
    support: Feet | None,
) -> None:
    """Moves the spheres in a SceneGraph's Context to where feet end, if they are elsewhere."""
    inspector = scene_graph.get_query_output_port().Eval(scene_context).inspector()
    moved = [
        (geometry, X_BS)
        for geometry, X_BS in zip(
            handle.contact_spheres, handle.layout.place_spheres(support), strict=True
        )
        if not inspector.GetPoseInFrame(geometry).IsExactlyEqualTo(X_BS)
    ]
    shape = Sphere(SPHERE_RADIUS)
    for geometry, X_BS in moved:
        scene_graph.ChangeShape(scene_context, plant.get_source_id(), geometry, shape, X_BS)
    if moved:
        # A geometry whose shape was changed has lost its collision filters.
        ApplyGridObjectFilters(plant, scene_graph, handle, handle.table, scene_context)


def describe_truth(obj: GridObject, truth: CellParameters) -> dict[str, Any]:
    """Lists the truth by part, for a file that people read."""
    parts = []
    for label in np.unique(obj.labels).tolist():
        first = int(np.argmax(obj.labels == label))
        parts.append(
            {
                "part": label,
                "cells": int((obj.labels == label).sum()),
                "cell_mass": float(truth.mass[first]),
                "friction": float(truth.friction[first]),
                "relative_friction": float(truth.relative_friction()[obj.labels == label].sum()),
            }
        )
    return {
        "object": obj.name,
        "total_mass": truth.total_mass,
        "center_of_mass": truth.center_of_mass(obj).tolist(),
        "center_of_friction": (truth.relative_friction() @ obj.p_BC).tolist(),
        "contact_friction": truth.contact_friction,
        "parts": parts,
    }


def SetGridObjectPose(
    plant: MultibodyPlant, plant_context: Context, handle: GridObjectInPlant, pose: ArrayLike
) -> None:
    """Puts an object down on the table, at rest.

    Args:
        plant: the plant.
        plant_context: its Context, which is changed.
        handle: the object.
        pose: (3,) q of B in W, m and rad.

    Raises:
        ObjectError: the pose is not three numbers.
    """
    q = check_vector(ObjectError, "pose", pose, 3, "x, y, m, theta, rad")
    if handle.joint is not None:
        handle.joint.set_pose(plant_context, q[:2], q[2])
    else:
        X_WB = RigidTransform(RollPitchYaw(0, 0, q[2]), [q[0], q[1], -handle.delta])
        plant.SetFloatingBaseBodyPoseInWorldFrame(plant_context, handle.body, X_WB)
    SetGridObjectVelocity(plant, plant_context, handle, (0.0, 0.0, 0.0))


def SetGridObjectVelocity(
    plant: MultibodyPlant, plant_context: Context, handle: GridObjectInPlant, velocity: ArrayLike
) -> None:
    """Sets an object's planar velocity (3,), (vx, vy, w) of B's origin in W, m/s and rad/s."""
    vx, vy, w = np.asarray(velocity, dtype=np.float64)
    if handle.joint is not None:
        handle.joint.set_translational_velocity(plant_context, [vx, vy])
        handle.joint.set_angular_velocity(plant_context, w)
    else:
        plant.SetFreeBodySpatialVelocity(
            plant_context, handle.body, SpatialVelocity([0, 0, w], [vx, vy, 0])
        )


def CalcPlanarPose(
    plant: MultibodyPlant, plant_context: Context, handle: GridObjectInPlant
) -> Array:
    """Calculates q (3,) of B in W, m and rad; theta is in (-pi, pi] for a free base."""
    if handle.joint is not None:
        place = handle.joint.get_translation(plant_context)
        return np.array([*place, handle.joint.get_rotation(plant_context)])
    X_WB = plant.EvalBodyPoseInWorld(plant_context, handle.body)
    R = X_WB.rotation().matrix()
    return np.array([*X_WB.translation()[:2], np.arctan2(R[1, 0], R[0, 0])])


def SetGridObjectParameters(
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    context: Context,
    handle: GridObjectInPlant,
    params: CellParameters,
    support: Feet | None = None,
) -> None:
    """Changes the truth: inertia, feet and friction of the spheres, friction of the sides.

    Args:
        plant: the plant.
        scene_graph: its SceneGraph.
        context: Context of the Diagram that holds both; `Simulator.reset_context` and
            `Diagram.CreateDefaultContext` bring back the parameters that the object was added with.
        handle: the object.
        params: the new truth.
        support: on what it stands, as in `AddGridObject`. The height of its underside stays.

    Raises:
        ParameterError: the parameters are of another number of cells, or a friction is 2 or more.
    """
    inertia = MakeSpatialInertia(Model(handle.obj, params), handle.height)
    layout = handle.layout
    spheres = layout.make_properties(params, handle.delta, calc_gravity(plant), support)
    side = MakeSideProperties(params, handle.side_stiffness)
    handle.body.SetSpatialInertiaInBodyFrame(plant.GetMyMutableContextFromRoot(context), inertia)
    scene_context = scene_graph.GetMyMutableContextFromRoot(context)
    source = plant.get_source_id()
    for geometry, properties in zip(handle.contact_spheres, spheres, strict=True):
        scene_graph.AssignRole(scene_context, source, geometry, properties, RoleAssign.kReplace)
    _move_spheres(plant, scene_graph, scene_context, handle, support)
    for geometry in handle.sides:
        scene_graph.AssignRole(scene_context, source, geometry, side, RoleAssign.kReplace)
