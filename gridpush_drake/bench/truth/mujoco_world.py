"""Bodies that do not obey the model, in MuJoCo: a rigid body on feet, pushed by a disc or a shape.

What distinguishes the kinds is where the feet are, how stiff they are, and how high the pusher
touches the body:

    own_weight   a foot below each cell, as stiff as the cell is heavy; pushed at the table's height
    half_height  the same feet; pushed at half the body's height
    foundation   a foot below each cell, all alike: an evenly compliant bottom
    vertices     rigid feet at the vertices of the outline's hull, uneven by tenths of a millimeter,
                 so that a few of them bear the body
    three_feet   three rigid feet below cells

A rigid body whose feet are as stiff as their cells are heavy sinks evenly, so each cell bears its
own weight. That is the model's assumption, in a body with six degrees of freedom. It holds as long
as the pusher's force and friction act at one height. Pushed above the table, a body loads its front
and unloads its rear, as every kind but the first one does.

The bodies themselves are drawn in `bench.truth.sets`. How MuJoCo's contacts are set is explained in
`multibody.mjcf`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridpush_drake.bench.worlds.mujoco_plant import (
    PUSHER_SINKAGE,
    list_pusher_parts,
    set_springs,
)
from gridpush_drake.dynamics.bodies import Bodies
from gridpush_drake.dynamics.physics import GRAVITY
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.pusher import PusherShape
from gridpush_drake.errors import PlanningError, PushError
from gridpush_drake.extras import import_extra
from gridpush_drake.geometry.se2 import Array, calc_yaw, transform
from gridpush_drake.multibody.mjcf import (
    FOOT_RADIUS,
    IMPEDANCE_RATIO,
    SOLVER_TOLERANCE,
    TABLE_HALF,
    TIME_STEP,
    WALL_RADIUS,
)
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.world import (
    FALLEN_TILT,
    OBSERVATION_COUNT,
    TrackedWorld,
    WorldMotion,
    WorldTruth,
)

if TYPE_CHECKING:
    import mujoco

RIGID_TIME_STEP = 5e-4
"""Time step of bodies on rigid feet, s."""

RIGID_SINKAGE = 1e-4
"""Distance by which a rigid foot sinks under its fraction of the weight, m. (A compliant bottom
sinks by `multibody.mjcf.SINKAGE`.)"""

BODY_HEIGHT = 0.03
"""Height of every body, m; its mass is spread evenly over it."""

PUSHER_INERTIA = 1000.0
"""Mass added to the pusher's two horizontal joints, kg: it resists a change of the pusher's given
speed within a step."""

PUSHER_MASS = 0.01
"""Mass of what may follow the object up and down with the pusher, kg; so light that the pusher does
not carry the object."""

TURNING_JOINT = f'<joint type="hinge" axis="0 0 1" armature="{PUSHER_INERTIA}"/>'
"""The joint, after the three others, of a pusher with a shape; its inertia is in kg m^2."""

PUSHER_HALF_LENGTH = 0.1
"""Half the length of the pusher, a vertical rod, m."""

SETTLE_TIME = 1.0
"""Time that a body is given to come to rest on its feet before it is first put down, s."""

Bounds = tuple[float, float, float, float]
"""Sides of a table along the world's axes: least x, least y, greatest x, greatest y, m."""

ENDLESS_TABLE: Bounds = (-TABLE_HALF, -TABLE_HALF, TABLE_HALF, TABLE_HALF)
"""Sides of a table whose edges nothing reaches, m."""

EDGE_RADIUS = 0.003
"""Radius of the rounded edge of a table, m; its highest line is the edge."""

EDGE_GAP = 5e-4
"""Height of a compliant body's flat bottom above the feet's ends, m: the feet alone bear the body
until it all but tips."""

EDGE_SINKAGE = 5e-5
"""Distance by which the feet of compliant bodies sink at an edge, m. There a few feet bear most of
the weight and sink several times as deep."""

EDGE_TIME_STEP = 2.5e-4
"""Greatest time step of any body near an edge, s. With twice that step, the far end of a light body
may swing itself up."""

EDGE_BEARING = 10
"""Number of places of the bottom that share a weight which lies on the edge. It says how stiff
these places are."""

PLATE_HALF = 0.005
"""Half the thickness of the plates, one for each cell, that the bottom is made of, m."""

LOOK_EVERY = 50
"""Number of steps after which it is checked again whether an edge is near."""

NEAR_EDGE = 0.01
"""Distance of the body's outline from an edge, m, below which contacts with the edges are looked
for."""

PARKED_PUSHER = (0.0, 50.0)
"""Place of the pusher while it does not push, m."""

Edge = tuple[tuple[float, float], tuple[float, float]]
"""Both ends of a side of the table, m."""


@dataclass(frozen=True, eq=False)
class TruthBody:
    """A rigid body, its feet, and how it is pushed.

    Attributes:
        obj: the object whose outline and cells the body has.
        params: masses of the cells, friction of the foot nearest to each cell, and friction of the
            pusher.
        feet: (F, 2) where the feet are, body frame, m.
        cell: (F,) number of the cell that each foot belongs to.
        load: (F,) force that makes a foot sink by `sinkage`, N.
        sinkage: distance by which the feet sink under `load`, m.
        gap: (F,) how much shorter a foot is than the longest one, m.
        push_height: height of the pusher's contact above the feet's ends, m.
        bottom: height of the flat bottom, which a table's edge touches, above the longest feet's
            ends, m.
        time_step: time step in which the body is simulated, s.
    """

    obj: GridObject
    params: CellParameters
    feet: Array
    cell: NDArray[np.int64]
    load: Array
    sinkage: float
    gap: Array
    push_height: float
    bottom: float = EDGE_GAP
    time_step: float = TIME_STEP

    def harden(self) -> "TruthBody":
        """Returns the body for a table with an edge, where it must not sink far before it tips."""
        if self.sinkage <= EDGE_SINKAGE:
            return self
        return replace(self, sinkage=EDGE_SINKAGE, time_step=EDGE_TIME_STEP)


class MujocoWorld(TrackedWorld):
    """A rigid body in MuJoCo on a table with or without an edge, pushed by a disc or a shape.

    The pushes' forces, the tilting and the falling are MuJoCo's. A body counts as fallen when it
    tilts by FALLEN_TILT or more.

    Attributes:
        body: the body that is pushed.
        bodies: the object with its true masses and frictions.
        shape: the pusher's; None of a disc.
        radius: radius of the disc, or of the shape's round corners, m.
        foot_loads: (F,) what each foot bears at rest, wholly on the table, N.
        loads: (n,) what the feet of each cell bear at rest, wholly on the table, N.
    """

    bodies: Bodies

    def __init__(
        self,
        body: TruthBody,
        pusher: float | PusherShape,
        table: Bounds = ENDLESS_TABLE,
        pose: ArrayLike | None = None,
        *,
        settle: float = 0.0,
        position_std: float = 0.0,
        angle_std: float = 0.0,
        seed: int | np.random.Generator = 0,
        observations: int = OBSERVATION_COUNT,
        observes_anew: bool = False,
    ) -> None:
        """Finds how the body rests on the table, and puts it down.

        Args:
            body: the body.
            pusher: radius of the disc that pushes, m, or the shape.
            table: sides of the table in W, m.
            pose: (3,) where the body is put down first, m and rad; the middle of the table where
                None.
            settle: how long the body is given to come to rest when it is put down, s. With 0 it is
                put down as it rests wholly on the table, which is right away from the edges.
            position_std: standard deviation of seen positions, per axis, m.
            angle_std: standard deviation of seen angles, rad.
            seed: seed of the noise, or the generator that draws it.
            observations: number of poses that are seen during a push after the first one.
            observes_anew: whether `observe` draws new noise every time.

        Raises:
            MissingExtraError: MuJoCo is not installed.
            PlanningError: a number is out of range.
        """
        mujoco = import_extra("mujoco", "bench")
        self.body = body
        self.bodies = Bodies(body.obj, body.params)
        self.shape = pusher if isinstance(pusher, PusherShape) else None
        self.radius = pusher.radius if isinstance(pusher, PusherShape) else pusher
        self._mujoco = mujoco
        self._settle = settle
        self._table = table
        self._rim = np.array(body.obj.outline.convex_hull.exterior.coords)[:-1]

        # There are two scenes, without and with the table's edges: to look for contacts with them
        # takes most of the time, and far from them there are none. The second one takes smaller
        # steps.
        edges = _find_edges(table)
        scenes: list[list[Edge]] = [[], edges] if edges else [[]]
        self._models = [
            mujoco.MjModel.from_xml_string(_describe(body, pusher, table, each)) for each in scenes
        ]
        self._splits = [1, ceil(body.time_step / EDGE_TIME_STEP)]
        for model, split in zip(self._models, self._splits, strict=False):
            model.opt.timestep = body.time_step / split
            _set_contacts(model, body)
        self._datas = [mujoco.MjData(model) for model in self._models]
        self._scene = 0
        self._steps = 0

        middle = np.array([(table[0] + table[2]) / 2, (table[1] + table[3]) / 2, 0.0])
        self._find_rest(middle[:2])
        super().__init__(
            middle if pose is None else pose,
            position_std=position_std,
            angle_std=angle_std,
            seed=seed,
            observations=observations,
            observes_anew=observes_anew,
        )

    def _find_rest(self, middle: Array) -> None:
        """Finds height, tilt and loads of the body resting wholly on the table, at (2,) x and y."""
        self._data.qpos[:2] = middle
        self._let_pass(SETTLE_TIME)
        self._rest_height = float(self._data.qpos[2])
        self._rest_quaternion = self._data.qpos[3:7].copy()
        self.foot_loads = self.read_loads()
        loads = np.bincount(self.body.cell, self.foot_loads, self.body.obj.n)
        self.loads = loads.astype(np.float64)

    def do_put(self, pose: Array) -> Array:
        """Puts the body down at a pose (3,), and waits for `settle`; returns where it then lies."""
        x, y, theta = pose
        turn = np.array([np.cos(theta / 2), 0, 0, np.sin(theta / 2)])
        quaternion = np.zeros(4)
        self._mujoco.mju_mulQuat(quaternion, turn, self._rest_quaternion)
        self._steps = 0
        self._mujoco.mj_resetData(self._model, self._data)
        self._data.qpos[:7] = x, y, self._rest_height, *quaternion
        if not self._settle:
            return pose
        self._let_pass(self._settle)
        return self._read_pose(pose[2])

    def do_push(self, push: Push, pose: Array) -> WorldMotion:
        """Pushes the body from where it is, at rest, with this world's pusher.

        Raises:
            PushError: the pusher's radius is another, or one of both is a disc alone.
        """
        motion = self._push(push)
        motion.poses[:, 2] = np.unwrap(np.append(pose[2], motion.poses[:, 2]))[1:]
        return motion

    def _push(self, push: Push) -> WorldMotion:
        """Pushes the body; the angles are continuous, and the first is between -pi and pi.

        Raises:
            PushError: the pusher's radius is another, or one of both is a disc alone.
        """
        if (push.shape is None) != (self.shape is None):
            raise PushError("push: not by the pusher that the world has; expected the same one")
        if not np.isclose(push.radius, self.radius):
            raise PushError(
                f"push: the radius is {push.radius:g} m; "
                f"expected that of the world's pusher, {self.radius:g} m"
            )
        dt = self.body.time_step
        count = round(push.duration / dt)
        times = np.linspace(0.0, push.duration, count + 1)
        path = push.tip_at(times)
        speed = np.diff(path, axis=0) / dt
        yaw = push.yaw_at(times)
        rate = np.diff(yaw) / dt
        seen = np.empty((count + 1, 7))
        self._data.qvel[:] = 0
        for i in range(count + 1):
            seen[i] = self._data.qpos[:7]
            if i < count:
                self._data.qpos[7:9] = path[i]
                self._data.qvel[6:8] = speed[i]
                if self.shape is not None:
                    self._data.qpos[10] = yaw[i]
                    self._data.qvel[9] = rate[i]
                self._step()
        poses = calc_poses(seen)
        poses[:, 2] = np.unwrap(poses[:, 2])
        tilt = calc_tilts(seen)
        return WorldMotion(
            times=times, poses=poses, fell=bool((tilt >= FALLEN_TILT).any()), tilt=tilt
        )

    def steer(
        self,
        begin: Array,
        end: Array,
        duration: float,
        radius: float,
        shape: PusherShape | None = None,
    ) -> None:
        """Moves the pusher evenly between two places; see `SteeredWorld.steer`.

        Raises:
            PlanningError: the radius or the shape is not that of this world's pusher.
        """
        if radius != self.radius:
            raise PlanningError(f"radius is {radius!r}; expected {self.radius:g} m, the pusher's")
        if shape is not self.shape:
            raise PlanningError("shape: not that of this world's pusher; expected the same one")
        dt = self.body.time_step
        count = max(1, round(duration / dt))
        speed = (end - begin) / (count * dt)
        for i in range(count):
            place = begin + i / count * (end - begin)
            self._data.qpos[7:9] = place[:2]
            self._data.qvel[6:8] = speed[:2]
            if shape is not None:
                self._data.qpos[10] = place[2]
                self._data.qvel[9] = speed[2]
            self._step()
        self._pose = self._read_pose(self._pose[2])

    @property
    def truth(self) -> WorldTruth:
        """What is true of the body now, for judges only.

        A body that is tilted by FALLEN_TILT or more does not stay as it lies.
        """
        tilt = self._read_tilt()
        return replace(super().truth, tilt=tilt, stays=tilt < FALLEN_TILT)

    def wait(self, seconds: float) -> None:
        """Lets time pass while the pusher is far away."""
        self._let_pass(seconds)
        self._pose = self._read_pose(self._pose[2])

    def read_loads(self) -> Array:
        """Reads the feet's normal forces (F,), N."""
        loads = np.zeros(len(self.body.feet))
        force = np.zeros(6)
        table = self._model.geom("table").id
        first = self._model.geom("f0").id
        for i in range(self._data.ncon):
            contact = self._data.contact[i]
            if table in (contact.geom1, contact.geom2) and contact.efc_address >= 0:
                self._mujoco.mj_contactForce(self._model, self._data, i, force)
                loads[max(contact.geom1, contact.geom2) - first] += force[0]
        return loads

    @property
    def _model(self) -> "mujoco.MjModel":
        """The model of the scene that is stepped at present."""
        return self._models[self._scene]

    @property
    def _data(self) -> "mujoco.MjData":
        """The state of the scene that is stepped at present."""
        return self._datas[self._scene]

    def _let_pass(self, seconds: float) -> None:
        self._data.qpos[7:9] = PARKED_PUSHER
        self._data.qvel[6:] = 0
        for _ in range(round(seconds / self.body.time_step)):
            self._step()

    def _step(self) -> None:
        """Takes a step, or several smaller ones where an edge of the table is near."""
        if self._steps % LOOK_EVERY == 0:
            rim = transform(self._read_pose(), self._rim)
            left, low, right, high = self._table
            room = (*(rim - (left, low)).min(axis=0), *((right, high) - rim).min(axis=0))
            self._turn_to(len(self._models) - 1 if min(room) < NEAR_EDGE else 0)
        self._mujoco.mj_step(self._model, self._data, self._splits[self._scene])
        self._steps += 1

    def _turn_to(self, scene: int) -> None:
        """Goes on in another scene, from the state of the present one."""
        before = self._data
        self._scene = scene
        if self._data is not before:
            for name in ("qpos", "qvel", "qacc_warmstart"):
                getattr(self._data, name)[:] = getattr(before, name)

    def _read_pose(self, near: float | None = None) -> Array:
        """Reads q of B in W (3,), m and rad; its angle is the one nearest to `near`, if given."""
        pose = calc_poses(self._data.qpos[None, :7])[0]
        if near is not None:
            pose[2] = np.unwrap([near, pose[2]])[1]
        return pose

    def _read_tilt(self) -> float:
        """Reads the angle of B's z axis from the vertical, rad."""
        return float(calc_tilts(self._data.qpos[None, :7])[0])


def calc_poses(positions: Array) -> Array:
    """Calculates q of B in W (K, 3), m and rad, from positions and quaternions (K, 7)."""
    return np.column_stack([positions[:, :2], calc_yaw(*positions[:, 3:].T)])


def calc_tilts(positions: Array) -> Array:
    """Calculates B's angles from the vertical (K,), rad, from positions and quaternions (K, 7)."""
    _, x, y, _ = positions[:, 3:].T
    return np.asarray(np.arccos(np.clip(1 - 2 * (x * x + y * y), -1, 1)))


def _describe(
    body: TruthBody, pusher: float | PusherShape, table: Bounds, edges: list[Edge]
) -> str:
    """Describes the scene in MJCF, with some of the table's edges.

    No geoms collide by themselves. Feet f touch the table, the pusher's parts touch walls w, and
    plates p touch the table's edges.
    """
    left, low, right, high = table
    obj = body.obj
    params = body.params
    rims = "".join(
        f'<geom name="e{i}" type="capsule" size="{EDGE_RADIUS}" '
        f'fromto="{a[0]} {a[1]} {-EDGE_RADIUS} {b[0]} {b[1]} {-EDGE_RADIUS}"/>'
        for i, (a, b) in enumerate(edges)
    )
    geoms = (
        describe_feet(body.feet, body.gap)
        + _describe_walls(body)
        + describe_plates(obj, "p", body.bottom + PLATE_HALF)
    )
    pairs = describe_pairs("foot", "table", "f", params.friction[body.cell])
    turns = isinstance(pusher, PusherShape)
    shape = pusher if isinstance(pusher, PusherShape) else PusherShape.disc(pusher)
    parts = _describe_pusher(shape)
    for i in range(len(parts)):
        friction = [params.contact_friction] * len(obj.edges.start)
        pairs += describe_pairs("wall", f"pusher{i}", "w", friction)
    for i in range(len(edges)):
        pairs += describe_pairs("edge", f"e{i}", "p", params.friction)
    return f"""
<mujoco>
  {describe_options(body.time_step)}
  <worldbody>
    <geom name="table" type="box" pos="{(left + right) / 2} {(low + high) / 2} -0.5"
     size="{(right - left) / 2} {(high - low) / 2} 0.5"/>{rims}
    <body><freejoint/>{describe_inertia(obj, params)}{geoms}</body>
    <body gravcomp="1">
      <inertial pos="0 0 0" mass="{PUSHER_MASS}" diaginertia="1 1 1"/>
      <joint type="slide" axis="1 0 0" armature="{PUSHER_INERTIA}"/>
      <joint type="slide" axis="0 1 0" armature="{PUSHER_INERTIA}"/>
      <joint type="slide" axis="0 0 1" damping="1"/>
      {TURNING_JOINT if turns else ""}{"".join(parts)}
    </body>
  </worldbody>
  <contact>{pairs}</contact>
</mujoco>"""


def _describe_pusher(shape: PusherShape) -> list[str]:
    """Describes the parts of a pusher."""
    geoms = []
    for i, part in enumerate(list_pusher_parts(shape)):
        x, y = part.place
        turn = " ".join(map(str, part.quaternion))
        size = " ".join(map(str, (*part.size, PUSHER_HALF_LENGTH)))
        geoms.append(
            f'<geom name="pusher{i}" type="{"capsule" if part.is_rod else "box"}" '
            f'pos="{x} {y} 0" quat="{turn}" size="{size}"/>'
        )
    return geoms


def _find_edges(table: Bounds) -> list[Edge]:
    """Finds the ends of those of the table's sides that are within reach."""
    left, low, right, high = table
    corners = [(left, low), (right, low), (right, high), (left, high)]
    sides = zip(corners, corners[1:] + corners[:1], strict=True)
    return [(a, b) for a, b in sides if max(abs(a[0] + b[0]), abs(a[1] + b[1])) < 2 * TABLE_HALF]


def describe_inertia(obj: GridObject, params: CellParameters, z: float = BODY_HEIGHT / 2) -> str:
    """Describes mass, center of mass and inertia: each cell is a block of the body's height.

    Args:
        obj: the object.
        params: masses of its cells.
        z: height of the center of mass, m.
    """
    mass = params.mass
    x, y = params.center_of_mass(obj)
    arm_x, arm_y = (obj.p_BC - (x, y)).T
    cell = mass.sum() * obj.cell_size**2 / 12
    flat = mass.sum() * BODY_HEIGHT**2 / 12 + cell
    ixx = mass @ arm_y**2 + flat
    iyy = mass @ arm_x**2 + flat
    ixy = -mass @ (arm_x * arm_y)
    izz = mass @ (arm_x**2 + arm_y**2) + 2 * cell
    return (
        f'<inertial pos="{x} {y} {z}" mass="{mass.sum()}" '
        f'fullinertia="{ixx} {iyy} {izz} {ixy} 0 0"/>'
    )


def describe_options(time_step: float) -> str:
    """Describes how a scene is stepped, with geoms that do not collide by themselves."""
    return (
        '<compiler inertiafromgeom="false"/>'
        f'<option timestep="{time_step}" cone="elliptic" impratio="{IMPEDANCE_RATIO}" '
        f'tolerance="{SOLVER_TOLERANCE}" gravity="0 0 {-GRAVITY}"/>'
        '<default><geom contype="0" conaffinity="0" mass="0"/></default>'
    )


def describe_feet(places: Array, gaps: ArrayLike = 0.0, name: str = "f") -> str:
    """Describes the spheres that stand on the table.

    Args:
        places: (F, 2) where they are, body frame, m.
        gaps: (F,) how much shorter a foot is than the longest one, m.
        name: what their names begin with; numbers follow.
    """
    heights = FOOT_RADIUS + np.broadcast_to(gaps, len(places))
    return "".join(
        f'<geom name="{name}{i}" type="sphere" size="{FOOT_RADIUS}" pos="{x} {y} {z}"/>'
        for i, ((x, y), z) in enumerate(zip(places, heights, strict=True))
    )


def describe_plates(obj: GridObject, name: str, z: float) -> str:
    """Describes a plate for each cell, whose middle is at a height z, m."""
    half = obj.cell_size / 2
    return "".join(
        f'<geom name="{name}{i}" type="box" size="{half} {half} {PLATE_HALF}" pos="{x} {y} {z}"/>'
        for i, (x, y) in enumerate(obj.p_BC)
    )


def describe_pairs(kind: str, geom: str, others: str, frictions: Sequence[float] | Array) -> str:
    """Describes contacts of a geom with others of numbered names, each with its friction."""
    return "".join(
        f'<pair name="{kind}_{geom}_{others}{i}" geom1="{geom}" geom2="{others}{i}" condim="3" '
        f'friction="{mu} {mu} 0 0 0"/>'
        for i, mu in enumerate(frictions)
    )


def _describe_walls(body: TruthBody) -> str:
    """Describes walls w along the outline at the pusher's height."""
    z = body.push_height
    edges = body.obj.edges
    return "".join(
        f'<geom name="w{i}" type="capsule" size="{WALL_RADIUS}" '
        f'fromto="{a[0]} {a[1]} {z} {b[0]} {b[1]} {z}"/>'
        for i, (a, b) in enumerate(zip(edges.start, edges.end, strict=True))
    )


def _set_contacts(model: "mujoco.MjModel", body: TruthBody) -> None:
    """Gives feet, walls and edges their stiffness."""
    weight = np.array([body.params.total_mass * GRAVITY])
    foot, pusher = (float(value) for value in model.body_invweight0[1:, 0])
    set_springs(model, "foot", body.load, body.sinkage, foot)
    set_springs(model, "wall", weight, PUSHER_SINKAGE, foot + pusher)
    set_springs(model, "edge", weight / EDGE_BEARING, body.sinkage, foot)
