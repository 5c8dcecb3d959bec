"""Pushes of a grid object in MuJoCo, by the very file that `gridpush export` writes for it.

The pusher is a vertical rod, or several that are joined, led along the push's path as the file's
head says that it should be. Needs the package `mujoco`.
"""

from itertools import pairwise
from typing import Any

import numpy as np

from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.pusher import PusherShape
from gridpush_drake.errors import PushError
from gridpush_drake.extras import import_extra
from gridpush_drake.geometry.se2 import Array, calc_yaw
from gridpush_drake.identification.model import Model
from gridpush_drake.multibody.mjcf import WALL_RADIUS, make_mjcf
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters

OBJECT_HEIGHT = 0.03
"""Height of the object, m. It is pushed at the table's height, so that it says nothing."""

PARKED_FINGER = (0.0, 4.0, 0.0)
"""Where the finger is while the object comes to rest, m, m and rad."""

SETTLING_STEPS = 200
"""Steps in which the object comes to rest on its feet."""

FINGER_HALF = 0.1
"""Half the length of the finger, m."""

FINGER_MASS = 0.01
"""Mass of the finger, kg."""

FINGER_ARMATURE = 1000.0
"""Inertia of the finger's joints, kg and kg m²: what it touches does not move it."""

OBJECT_POSITIONS = slice(0, 7)
FINGER_POSITIONS = slice(7, 10)
FINGER_VELOCITIES = slice(6, 9)
"""Places of the object's pose and of the finger's in MuJoCo's vectors."""


class MujocoPlant:
    """An object in MuJoCo, and a finger that pushes it."""

    def __init__(self, obj: GridObject, params: CellParameters, shape: PusherShape) -> None:
        """Builds the model.

        Args:
            obj: the object.
            params: its masses and frictions.
            shape: the finger's: a disc, or several.

        Raises:
            PushError: the shape is a polygon.
            MissingExtraError: `mujoco` is not installed.
        """
        require_discs(shape)
        self._mujoco: Any = import_extra("mujoco", "bench")
        kinds = self._mujoco
        spec = kinds.MjSpec.from_string(make_mjcf(Model(obj, params), OBJECT_HEIGHT))
        finger = spec.worldbody.add_body(name="finger", gravcomp=1)
        for axis in ((1, 0, 0), (0, 1, 0)):
            finger.add_joint(type=kinds.mjtJoint.mjJNT_SLIDE, axis=axis, armature=FINGER_ARMATURE)
        hinge = kinds.mjtJoint.mjJNT_HINGE
        finger.add_joint(type=hinge, axis=(0, 0, 1), armature=FINGER_ARMATURE)
        for center in shape.core:
            finger.add_geom(
                type=kinds.mjtGeom.mjGEOM_CAPSULE,
                pos=[*center, 0],
                size=[shape.radius - WALL_RADIUS, FINGER_HALF, 0],
                mass=FINGER_MASS,
            )
        spec.add_exclude(bodyname1="world", bodyname2="finger")
        self._model = spec.compile()
        self._data = kinds.MjData(self._model)

    def push(self, push: Push, pose: Array) -> Array:
        """Pushes the object from rest.

        Args:
            push: the push.
            pose: (3,) where the object lies, m and rad.

        Returns:
            Its last pose (3,), m and rad.
        """
        data = self._data
        self._mujoco.mj_resetData(self._model, data)
        x, y, theta = pose
        data.qpos[OBJECT_POSITIONS] = (x, y, 0, np.cos(theta / 2), 0, 0, np.sin(theta / 2))
        data.qpos[FINGER_POSITIONS] = PARKED_FINGER
        for _ in range(SETTLING_STEPS):
            self._mujoco.mj_step(self._model, data)

        # The finger is put where it is wanted at every step
        dt = self._model.opt.timestep
        count = round(push.duration / dt)
        times = np.linspace(0.0, push.duration, count + 1)
        path = np.column_stack([push.tip_at(times), push.yaw_at(times)])
        for now, then in pairwise(path):
            data.qpos[FINGER_POSITIONS] = now
            data.qvel[FINGER_VELOCITIES] = (then - now) / dt
            self._mujoco.mj_step(self._model, data)
        place = data.qpos[OBJECT_POSITIONS]
        return np.array([place[0], place[1], calc_yaw(*place[3:])])


def require_discs(shape: PusherShape) -> None:
    """Raises PushError where a shape is a polygon, which the plants do not know."""
    if shape.joined:
        raise PushError("push: by a polygon; expected a disc, or several, in a plant")
