"""A grid object in a MultibodyPlant, pushed by a sphere along a given path.

The sphere slides on two prismatic joints, x and y, and is held to its path by stiff implicit PD gains: it errs by
force/gain, 1e-6 m. A pusher of huge mass at constant velocity would seem simpler, but Drake's solver stops at a
residual relative to the largest momentum around, and the object's motion is then not solved at all.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.geometry import Box, CollisionFilterDeclaration, GeometrySet, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    ModelInstanceIndex,
    PdControllerGains,
    PrismaticJoint,
    SpatialInertia,
)
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from gridpush_drake.dynamics.push import Push
from gridpush_drake.errors import PushError
from gridpush_drake.grid.object import GridObject
from gridpush_drake.grid.parameters import CellParameters
from gridpush_drake.scene.contact_material import MakePartnerProperties
from gridpush_drake.scene.grid_object import AddGridObject, Base
from gridpush_drake.scene.grid_object_state import CalcPlanarPose, SetGridObjectParameters, SetGridObjectPose

TIME_STEP = {"planar": 1e-3, "free": 2e-3}
"""s."""

STICTION_TOLERANCE = 1e-5
"""m/s; Drake's own, 1e-3, lets a finger that should stick slip by 0.1 mm in a push of 0.1 m."""

PUSH_HEIGHT = 0.012
"""m, of the sphere's centre above the table."""

PUSHER_MASS = 1.0
"""kg, of each of the pusher's two bodies."""

PUSHER_GAIN, PUSHER_DAMPING = 1e7, 1e4
"""N/m and N s/m."""

TABLE_SIZE = (4.0, 4.0, 0.1)
"""m."""


@dataclass(frozen=True, eq=False)
class PlantMotion:
    """How an object moved.

    Attributes:
        times: (T+1,) s.
        poses: (T+1, 3) q = (x, y, theta) of B in W, m and rad.
        tracking_error: the pusher's greatest distance from its path at any of the times, m.
        tilt: the greatest angle of B's z axis from the vertical, rad.
    """

    times: NDArray[np.float64]
    poses: NDArray[np.float64]
    tracking_error: float
    tilt: float


class PlantPusher:
    """A Diagram of one object, a table and a pusher; it is built once and pushes as often as wanted.

    Args:
        obj: the object.
        params: its masses and frictions, until a push brings others.
        radius: of the pusher, m.
        base: "planar" or "free".
        dt: the plant's time step, s; by default TIME_STEP of the base.
        push_height: of the pusher's centre above the table, m.
        options: passed on to `AddGridObject`.
    """

    def __init__(
        self, obj: GridObject, params: CellParameters, radius: float, base: Base = "planar", dt: float | None = None,
        push_height: float = PUSH_HEIGHT, **options: Any,
    ) -> None:  # fmt: skip
        builder = DiagramBuilder()
        self.radius, self.dt = radius, TIME_STEP[base] if dt is None else dt
        self.plant, self.scene_graph = AddMultibodyPlantSceneGraph(builder, self.dt)
        self.plant.set_stiction_tolerance(STICTION_TOLERANCE)
        table = self.plant.RegisterCollisionGeometry(
            self.plant.world_body(), RigidTransform(np.array([0, 0, -TABLE_SIZE[2] / 2])), Box(*TABLE_SIZE), "table",
            MakePartnerProperties(),
        )  # fmt: skip
        self.pusher = AddPusher(self.plant, radius, push_height)
        self.handle = AddGridObject(self.plant, self.scene_graph, obj, params, base, table=[table], **options)
        tip = self.plant.GetCollisionGeometriesForBody(self.plant.GetBodyByName("tip", self.pusher))
        self.scene_graph.collision_filter_manager().Apply(
            CollisionFilterDeclaration().ExcludeBetween(GeometrySet(tip), GeometrySet(table))
        )
        self.plant.Finalize()
        self.simulator = Simulator(builder.Build())

    def push(self, params: CellParameters, push: Push, pose: ArrayLike = (0.0, 0.0, 0.0)) -> PlantMotion:
        """Pushes the object from rest.

        Args:
            params: the object's masses and frictions.
            push: of a pusher of this one's radius.
            pose: (3,) of the object at the beginning, m and rad.

        Returns:
            The motion.

        Raises:
            PushError: the pusher's radius is another.
        """
        if not np.isclose(push.radius, self.radius):
            raise PushError(f"push: the radius is {push.radius:g} m; expected that of the plant's, {self.radius:g}")
        plant, simulator = self.plant, self.simulator
        context = simulator.get_mutable_context()
        plant_context = plant.GetMyMutableContextFromRoot(context)
        SetGridObjectParameters(plant, self.scene_graph, context, self.handle, params)
        SetGridObjectPose(plant, plant_context, self.handle, pose)
        times = np.linspace(0, push.duration, round(push.duration / self.dt) + 1)
        path = push.tip_at(times)
        velocity = np.gradient(path, times, axis=0)
        desired = plant.get_desired_state_input_port(self.pusher)
        plant.SetPositions(plant_context, self.pusher, path[0])
        plant.SetVelocities(plant_context, self.pusher, velocity[0])
        desired.FixValue(plant_context, np.r_[path[0], velocity[0]])
        context.SetTime(0)
        simulator.Initialize()
        poses, error, tilt = [CalcPlanarPose(plant, plant_context, self.handle)], 0.0, 0.0
        for i in range(1, len(times)):
            # the gains act at the step's end, so that is where the pusher is wanted
            desired.FixValue(plant_context, np.r_[path[i], velocity[i]])
            simulator.AdvanceTo(i * self.dt)
            poses.append(CalcPlanarPose(plant, plant_context, self.handle))
            error = max(error, float(np.linalg.norm(plant.GetPositions(plant_context, self.pusher) - path[i])))
            upright = plant.EvalBodyPoseInWorld(plant_context, self.handle.body).rotation().matrix()[2, 2]
            tilt = max(tilt, float(np.arccos(np.clip(upright, -1, 1))))
        return PlantMotion(times, np.array(poses), error, tilt)


def AddPusher(plant: MultibodyPlant, radius: float, height: float) -> ModelInstanceIndex:
    """Adds a sphere on two prismatic joints, x and y of the world, with PD gains.

    Args:
        plant: before Finalize.
        radius: m.
        height: of the sphere's centre, m.

    Returns:
        Its model instance; the desired state is x, y (m) and their rates.
    """
    instance = plant.AddModelInstance("pusher")
    inertia = SpatialInertia.SolidSphereWithMass(PUSHER_MASS, radius)
    slide = plant.AddRigidBody("slide", instance, inertia)
    tip = plant.AddRigidBody("tip", instance, inertia)
    rail = plant.AddFrame(
        FixedOffsetFrame("rail", plant.world_frame(), RigidTransform(np.array([0, 0, height])), instance)
    )
    for name, parent, child, axis in (
        ("x", rail, slide.body_frame(), [1, 0, 0]),
        ("y", slide.body_frame(), tip.body_frame(), [0, 1, 0]),
    ):
        joint = plant.AddJoint(PrismaticJoint(name, parent, child, np.array(axis)))
        gains = PdControllerGains(p=PUSHER_GAIN, d=PUSHER_DAMPING)
        plant.AddJointActuator(name, joint).set_controller_gains(gains)
    plant.RegisterCollisionGeometry(tip, RigidTransform(), Sphere(radius), "tip", MakePartnerProperties())
    return instance
