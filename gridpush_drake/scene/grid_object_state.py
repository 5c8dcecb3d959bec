"""The pose and the hidden truth of a grid object, in a Context: one Diagram serves for many runs."""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.geometry import RoleAssign, SceneGraph
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.math import SpatialVelocity
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Context

from gridpush_drake.errors import ObjectError
from gridpush_drake.grid.parameters import CellParameters
from gridpush_drake.scene.grid_object import GridObjectInPlant, MakeSideProperties, MakeSpatialInertia, calc_gravity


def SetGridObjectPose(
    plant: MultibodyPlant, plant_context: Context, handle: GridObjectInPlant, pose: ArrayLike
) -> None:
    """Puts an object down on the table, at rest.

    Args:
        plant: the plant.
        plant_context: its Context.
        handle: the object.
        pose: (3,) q = (x, y, theta) of B in W, m and rad.

    Raises:
        ObjectError: the pose is not three finite numbers.
    """
    q = np.array(pose, dtype=np.float64)
    if q.shape != (3,) or not np.isfinite(q).all():
        raise ObjectError(f"pose is {pose!r}; expected three finite numbers: x, y (m), theta (rad)")
    if handle.joint is not None:
        handle.joint.set_pose(plant_context, q[:2], q[2])
    else:
        X_WB = RigidTransform(RollPitchYaw(0, 0, q[2]), [q[0], q[1], -handle.delta])
        plant.SetFloatingBaseBodyPoseInWorldFrame(plant_context, handle.body, X_WB)
    SetGridObjectVelocity(plant, plant_context, handle, (0.0, 0.0, 0.0))


def SetGridObjectVelocity(
    plant: MultibodyPlant, plant_context: Context, handle: GridObjectInPlant, velocity: ArrayLike
) -> None:
    """Sets an object's planar velocity.

    Args:
        plant: the plant.
        plant_context: its Context.
        handle: the object.
        velocity: (3,) (vx, vy, w) of B's origin in W, m/s and rad/s.
    """
    vx, vy, w = np.asarray(velocity, dtype=np.float64)
    if handle.joint is not None:
        handle.joint.set_translational_velocity(plant_context, [vx, vy])
        handle.joint.set_angular_velocity(plant_context, w)
    else:
        plant.SetFreeBodySpatialVelocity(plant_context, handle.body, SpatialVelocity([0, 0, w], [vx, vy, 0]))


def CalcPlanarPose(plant: MultibodyPlant, plant_context: Context, handle: GridObjectInPlant) -> NDArray[np.float64]:
    """Calculates q = (x, y, theta) (3,) of B in W, m and rad; theta in (-pi, pi] for a free base."""
    if handle.joint is not None:
        return np.array([*handle.joint.get_translation(plant_context), handle.joint.get_rotation(plant_context)])
    X_WB = plant.EvalBodyPoseInWorld(plant_context, handle.body)
    R = X_WB.rotation().matrix()
    return np.array([*X_WB.translation()[:2], np.arctan2(R[1, 0], R[0, 0])])


def SetGridObjectParameters(
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    context: Context,
    handle: GridObjectInPlant,
    params: CellParameters,
) -> None:
    """Changes the truth: inertia, what each foot bears and how it rubs, the friction of the sides.

    Args:
        plant: the plant.
        scene_graph: of the plant.
        context: of the Diagram that holds both; `Simulator.reset_context` and `Diagram.CreateDefaultContext` bring back
            the parameters that the object was added with.
        handle: the object.
        params: the new masses and frictions.

    Raises:
        ParameterError: the parameters are of another number of cells, or a friction is 2 or more.
    """
    inertia = MakeSpatialInertia(handle.obj, params, handle.height)
    feet = handle.layout.make_properties(params, handle.delta, calc_gravity(plant))
    side = MakeSideProperties(params, handle.side_stiffness)
    handle.body.SetSpatialInertiaInBodyFrame(plant.GetMyMutableContextFromRoot(context), inertia)
    scene_context = scene_graph.GetMyMutableContextFromRoot(context)
    source = plant.get_source_id()
    for geometry, properties in zip(handle.feet, feet, strict=True):
        scene_graph.AssignRole(scene_context, source, geometry, properties, RoleAssign.kReplace)
    for geometry in handle.sides:
        scene_graph.AssignRole(scene_context, source, geometry, side, RoleAssign.kReplace)
