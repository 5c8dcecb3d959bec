"""Pushes of a grid object in MuJoCo, by the very file that `gridpush export` writes for it.

The pusher is a vertical rod, or several that are joined (by plates where the pusher is a polygon),
led along the push's path as the file's head says that it should be. The walls give way to it as
the object's feet do to the table, see `multibody.mjcf`. Needs the package `mujoco`.
"""

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from gridpush_drake.dynamics.physics import GRAVITY
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.pusher import PusherShape
from gridpush_drake.extras import import_extra
from gridpush_drake.geometry.se2 import Array, calc_yaw, turn_right
from gridpush_drake.identification.model import Model
from gridpush_drake.multibody.mjcf import WALL_RADIUS, calc_springs, make_mjcf
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

PUSHER_SINKAGE = 1e-4
"""Distance by which a pusher would sink into an object's side if it pushed with the object's
weight, m."""

CONTACT_KIND = "push"
"""What the names of the finger's contacts with the walls begin with."""

OBJECT_POSITIONS = slice(0, 7)
FINGER_POSITIONS = slice(7, 10)
FINGER_VELOCITIES = slice(6, 9)
"""Places of the object's pose and of the finger's in MuJoCo's vectors."""


class PusherPart(NamedTuple):
    """A part of a pusher in MuJoCo, upright and `2 FINGER_HALF` high.

    Attributes:
        place: (2,) of its middle, pusher's frame, m.
        angle: of its length, rad.
        size: radius of a rod, or half of the length and of the thickness of a plate, m.
    """

    place: Array
    angle: float
    size: tuple[float, ...]

    @property
    def is_rod(self) -> bool:
        """Whether it is a rod, a capsule in MuJoCo; a plate is a box."""
        return len(self.size) == 1

    @property
    def quaternion(self) -> list[float]:
        """(w, x, y, z) of its turn by the angle."""
        return [np.cos(self.angle / 2), 0, 0, np.sin(self.angle / 2)]


def list_pusher_parts(shape: PusherShape) -> list[PusherPart]:
    """Lists the rods at a shape's corners, or of its discs, and the plates at its straight sides.

    They are thinner than the shape by the radius of the objects' walls, which touch them.
    """
    radius = shape.radius - WALL_RADIUS
    parts = [PusherPart(place, 0.0, (radius,)) for place in shape.core]
    if not shape.joined:
        return parts
    after = np.roll(shape.core, -1, axis=0)
    for begin, end in zip(shape.core, after, strict=True):
        length = float(np.linalg.norm(end - begin))
        along = (end - begin) / length
        place = (begin + end) / 2 + radius / 2 * turn_right(along)
        angle = float(np.arctan2(along[1], along[0]))
        parts.append(PusherPart(place, angle, (length / 2, radius / 2)))
    return parts


class MujocoPlant:
    """An object in MuJoCo, and a finger that pushes it."""

    def __init__(self, obj: GridObject, params: CellParameters, shape: PusherShape) -> None:
        """Builds the model.

        Args:
            obj: the object.
            params: its masses and frictions.
            shape: the finger's.

        Raises:
            MissingExtraError: `mujoco` is not installed.
        """
        self._mujoco: Any = import_extra("mujoco", "bench")
        kinds = self._mujoco
        spec = kinds.MjSpec.from_string(make_mjcf(Model(obj, params), OBJECT_HEIGHT))
        finger = spec.worldbody.add_body(name="finger", gravcomp=1)
        for axis in ((1, 0, 0), (0, 1, 0)):
            finger.add_joint(type=kinds.mjtJoint.mjJNT_SLIDE, axis=axis, armature=FINGER_ARMATURE)
        hinge = kinds.mjtJoint.mjJNT_HINGE
        finger.add_joint(type=hinge, axis=(0, 0, 1), armature=FINGER_ARMATURE)
        for i, part in enumerate(list_pusher_parts(shape)):
            finger.add_geom(
                name=f"finger_{i}",
                type=kinds.mjtGeom.mjGEOM_CAPSULE if part.is_rod else kinds.mjtGeom.mjGEOM_BOX,
                size=[*part.size, FINGER_HALF, 0][:3],
                pos=[*part.place, 0],
                quat=part.quaternion,
                mass=FINGER_MASS,
            )
            for k in range(len(obj.edges.start)):
                spec.add_pair(
                    name=f"{CONTACT_KIND}_{i}_{k}",
                    geomname1=f"finger_{i}",
                    geomname2=f"wall_{k}",
                    condim=3,
                    friction=[params.contact_friction, params.contact_friction, 0, 0, 0],
                )
        spec.add_exclude(bodyname1="world", bodyname2="finger")
        self._model = spec.compile()
        # The file cannot know what pushes, and its walls are stiff. They rub a finger that slides
        # along them wrongly: a push of 10 cm would end up to 9 mm off.
        weight = np.array([params.total_mass * GRAVITY])
        inverse = float(self._model.body_invweight0[1:, 0].sum())
        set_springs(self._model, CONTACT_KIND, weight, PUSHER_SINKAGE, inverse)
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


def set_springs(model: Any, kind: str, load: Array, sinkage: float, inverse: float) -> None:
    """Lets pairs of geoms give way under loads; see `calc_springs`.

    Args:
        model: the model.
        kind: kind of the pairs; their names begin with it and an underscore.
        load: (K,) load of each pair, in the order of their geoms, or (1,) of all, N.
        sinkage: how far they give way, m.
        inverse: see `calc_springs`.
    """
    # MuJoCo sorts the pairs; one geom of each comes in the order in which they were described.
    names = [model.pair(i).name for i in range(model.npair)]
    rows = sorted(
        (i for i, name in enumerate(names) if name.startswith(f"{kind}_")),
        key=lambda i: max(model.pair_geom1[i], model.pair_geom2[i]),
    )
    springs, slip, impedance = calc_springs(load, sinkage, inverse)
    model.pair_solref[rows] = springs
    model.pair_solreffriction[rows] = slip
    model.pair_solimp[rows, :2] = impedance[:, None]
