"""Bodies that do not obey the model, in MuJoCo: one free rigid body on feet, pushed by a disc at a given height.

What distinguishes the kinds is where the feet are, how stiff, and how high the pusher touches:

    own_weight   a foot below each cell, as stiff as the cell is heavy, pushed at the table's height
    half_height  the same, pushed at half the body's height
    foundation   a foot below each cell, all alike: an evenly compliant bottom
    vertices     rigid feet at the vertices of the outline's hull, uneven by tenths of a millimeter:
    a few of them bear three_feet   three rigid feet below cells

A rigid body whose feet are as stiff as their cells are heavy sinks evenly, so each cell bears its
own weight: the model's assumption, in a body with six degrees of freedom. Nothing changes that
while the pusher's force and friction act at one height; pushed above the table, it loads its front
and unloads its rear, as does every kind but the first.

How MuJoCo's contacts are set is said in `multibody.mjcf`.
"""

from dataclasses import dataclass, replace
from math import ceil
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridpush_drake.dynamics.physics import GRAVITY
from gridpush_drake.dynamics.push import Push
from gridpush_drake.extras import import_extra
from gridpush_drake.geometry.se2 import Array, transform
from gridpush_drake.multibody.mjcf import (
    FOOT_RADIUS,
    IMPRATIO,
    TABLE_HALF,
    TIME_STEP,
    TOLERANCE,
    WALL_RADIUS,
    calc_springs,
)
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters

if TYPE_CHECKING:
    import mujoco

RIGID_TIME_STEP, RIGID_SINKAGE = 5e-4, 1e-4
"""s, of bodies on rigid feet, and m that such a foot sinks under its share of the weight; a
compliant bottom sinks by SINKAGE."""

BODY_HEIGHT = 0.03
"""m, of every object; its mass is spread evenly over it."""

PUSHER_INERTIA, PUSHER_MASS, PUSHER_HALF_LENGTH = 1000.0, 0.01, 0.1
"""kg that resists a change of the pusher's given speed within a step; kg of what may follow the
object up and down, so that the pusher does not carry it; and m."""

PUSHER_SINKAGE = 1e-4
"""m that the pusher would sink into the body's side were it pushed by the body's weight."""

SETTLE_TIME = 1.0
"""s that a body is given to come to rest on its feet."""

Bounds = tuple[float, float, float, float]
"""Least x and y, greatest x and y, m."""

ENDLESS: Bounds = (-TABLE_HALF, -TABLE_HALF, TABLE_HALF, TABLE_HALF)
"""A table that nothing comes to the end of."""

EDGE_RADIUS = 0.003
"""m, of the rounded edge; its highest line is the edge."""

EDGE_GAP = 5e-4
"""m of a compliant body's flat bottom above the feet's ends: they alone bear it until it all but
tips."""

EDGE_SINKAGE, EDGE_TIME_STEP = 5e-5, 2.5e-4
"""m, of compliant bodies at an edge: the few feet that bear most there sink several times as deep;
and s at most of any body near one: at twice that, the far end of a light one may swing itself
up."""

EDGE_BEARING = 10
"""Places of the bottom by which a weight on the edge is shared out, to say how stiff they are."""

PLATE_HALF = 0.005
"""m, half the thickness of the plates that the bottom is made of, one a cell."""


@dataclass(frozen=True, eq=False)
class TruthBody:
    """A rigid body, its feet, and how it is pushed.

    Attributes:
        obj: its outline and cells.
        params: its cells' masses; friction of each cell, here of the foot nearest to it, and that
            of the pusher.
        feet: (F, 2) where the feet are, body frame, m.
        cell: (F,) the cell that each foot belongs to.
        load: (F,) that makes a foot sink by `sinkage`, N.
        sinkage: m.
        gap: (F,) how much shorter a foot is than the longest, m.
        push_height: of the pusher's contact above the feet's ends, m.
        bottom: height of the flat bottom, which a table's edge touches, above the longest feet's
            ends, m.
        time_step: s.
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
        """The same body for a table with an edge, where it must not sink far before it tips."""
        return (
            self
            if self.sinkage <= EDGE_SINKAGE
            else replace(self, sinkage=EDGE_SINKAGE, time_step=EDGE_TIME_STEP)
        )


@dataclass(frozen=True, eq=False)
class TruthMotion:
    """How a body moved.

    Attributes:
        times: (T+1,) s.
        poses: (T+1, 3) q = (x, y, theta) of B in W, m and rad.
        tilt: (T+1,) angle of B's z axis from the vertical, rad.
        height: (T+1,) of B's origin above where it stood at rest, m.
    """

    times: Array
    poses: Array
    tilt: Array
    height: Array


class TruthWorld:
    """A body on a table with or without an edge, and a pusher.

    Attributes:
        body: what is pushed.
        radius: of the pusher, m.
        loads: (n,) that the feet of each cell bear at rest, wholly on the table, N.
    """

    def __init__(self, body: TruthBody, radius: float, table: Bounds = ENDLESS) -> None:
        """Finds how the body rests on a table of these sides in W, m; the radius is the pusher's.

        Raises:
            MissingExtraError: MuJoCo is not installed.
        """
        mujoco = import_extra("mujoco", "bench")
        self.body, self.radius, self._mujoco = body, radius, mujoco
        self._table, self._steps, self._scene, edges = table, 0, 0, _find_edges(table)
        self._rim = np.array(body.obj.outline.convex_hull.exterior.coords)[:-1]
        scenes = (
            ([], edges) if edges else ([],)
        )  # away from the edges, to look for contacts with them takes most time
        self._models = [
            mujoco.MjModel.from_xml_string(_describe(body, radius, table, each)) for each in scenes
        ]
        self._splits = [1, ceil(body.time_step / EDGE_TIME_STEP)]
        for model, split in zip(self._models, self._splits, strict=False):
            model.opt.timestep = body.time_step / split
            _set_contacts(model, body)
        self._datas = [mujoco.MjData(model) for model in self._models]
        self._model, self._data = self._models[0], self._datas[0]
        self._settle((table[0] + table[2]) / 2, (table[1] + table[3]) / 2)

    def _settle(self, x: float, y: float) -> None:
        """Finds how the body rests wholly on the table, at x, y: height, tilt, and loads."""
        self._data.qpos[:2] = x, y
        self.wait(SETTLE_TIME)
        self._rest_quaternion, self._rest_height = (
            self._data.qpos[3:7].copy(),
            float(self._data.qpos[2]),
        )
        self.foot_loads = self.read_loads()
        self.loads = np.bincount(self.body.cell, self.foot_loads, self.body.obj.n).astype(
            np.float64
        )

    def read_loads(self) -> Array:
        """(F,) normal forces of the feet, N."""
        loads, force = np.zeros(len(self.body.feet)), np.zeros(6)
        table, first = self._model.geom("table").id, self._model.geom("f0").id
        for i in range(self._data.ncon):
            contact = self._data.contact[i]
            if table in (contact.geom1, contact.geom2) and contact.efc_address >= 0:
                self._mujoco.mj_contactForce(self._model, self._data, i, force)
                loads[max(contact.geom1, contact.geom2) - first] += force[0]
        return loads

    def wait(self, seconds: float) -> None:
        """Lets time pass while the pusher is far away."""
        self._data.qpos[7:9], self._data.qvel[6:9] = FAR, 0
        for _ in range(round(seconds / self.body.time_step)):
            self._step()

    def _step(self) -> None:
        """Takes a step in the scene without edges, or, where one is near, several smaller ones in that with them."""
        if self._steps % LOOK_EVERY == 0:
            rim = transform(self.read_pose(), self._rim)
            left, low, right, high = self._table
            near = (
                min(*(rim - (left, low)).min(axis=0), *((right, high) - rim).min(axis=0))
                < NEAR_EDGE
            )
            self._turn_to(len(self._models) - 1 if near else 0)
        self._mujoco.mj_step(self._model, self._data, self._splits[self._scene])
        self._steps += 1

    def _turn_to(self, scene: int) -> None:
        self._scene = scene
        before, self._model, self._data = self._data, self._models[scene], self._datas[scene]
        if self._data is not before:
            for name in ("qpos", "qvel", "qacc_warmstart"):
                getattr(self._data, name)[:] = getattr(before, name)

    def put(self, pose: ArrayLike) -> None:
        """Puts the body down at a pose (3,), m and rad, as it rests wholly on the table."""
        x, y, theta = np.asarray(pose, dtype=np.float64)
        data, turned, self._steps = self._data, np.zeros(4), 0
        self._mujoco.mj_resetData(self._model, data)
        self._mujoco.mju_mulQuat(
            turned, np.array([np.cos(theta / 2), 0, 0, np.sin(theta / 2)]), self._rest_quaternion
        )
        data.qpos[:7] = x, y, self._rest_height, *turned

    def read_pose(self) -> Array:
        """(3,) q of B in W, m and rad."""
        return _calc_poses(self._data.qpos[None, :7])[0]

    def read_tilt(self) -> float:
        """Angle of B's z axis from the vertical, rad."""
        return float(_calc_tilts(self._data.qpos[None, :7])[0])

    def push(self, push: Push) -> TruthMotion:
        """Pushes the body, with a disc of this world's radius, from where it is, at rest; theta is continuous."""
        dt = self.body.time_step
        count = round(push.duration / dt)
        times = np.linspace(0.0, push.duration, count + 1)
        path = push.tip_at(times)
        speed = np.diff(path, axis=0) / dt
        seen = np.empty((count + 1, 7))
        self._data.qvel[:] = 0
        for i in range(count + 1):
            seen[i] = self._data.qpos[:7]
            if i < count:
                self._data.qpos[7:9], self._data.qvel[6:8] = path[i], speed[i]
                self._step()
        poses = _calc_poses(seen)
        poses[:, 2] = np.unwrap(poses[:, 2])
        return TruthMotion(times, poses, _calc_tilts(seen), seen[:, 2] - self._rest_height)


def _calc_poses(positions: Array) -> Array:
    """(K, 3) q of B in W from (K, 7) positions and quaternions, m and rad."""
    w, x, y, z = positions[:, 3:].T
    return np.column_stack(
        [positions[:, :2], np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))]
    )


def _calc_tilts(positions: Array) -> Array:
    """(K,) angles of B's z axis from the vertical, rad, likewise."""
    _, x, y, _ = positions[:, 3:].T
    return np.asarray(np.arccos(np.clip(1 - 2 * (x * x + y * y), -1, 1)))


LOOK_EVERY, NEAR_EDGE = 50, 0.01
"""Steps, and m of the outline inside an edge from where on contacts with the edges are looked
for."""

FAR = (0.0, 50.0)
"""m, where the pusher is while it does not push."""


Edge = tuple[tuple[float, float], tuple[float, float]]
"""Ends of a side of the table, m."""


def _describe(body: TruthBody, radius: float, table: Bounds, edges: list[Edge]) -> str:
    """The scene in MJCF, with some of the table's edges; all contacts are between pairs that are named."""
    left, low, right, high = table
    rims = "".join(
        f'<geom name="e{i}" type="capsule" size="{EDGE_RADIUS}" '
        f'fromto="{a[0]} {a[1]} {-EDGE_RADIUS} {b[0]} {b[1]} {-EDGE_RADIUS}"/>'
        for i, (a, b) in enumerate(edges)
    )
    return f"""
<mujoco>
  <compiler inertiafromgeom="false"/>
  <option timestep="{body.time_step}" cone="elliptic" impratio="{IMPRATIO}" tolerance="{TOLERANCE}"
   gravity="0 0 {-GRAVITY}"/>
  <default><geom contype="0" conaffinity="0" mass="0"/></default>
  <worldbody>
    <geom name="table" type="box" pos="{(left + right) / 2} {(low + high) / 2} -0.5"
     size="{(right - left) / 2} {(high - low) / 2} 0.5"/>{rims}
    <body><freejoint/>{_describe_inertia(body)}{_describe_geoms(body)}</body>
    <body gravcomp="1">
      <inertial pos="0 0 0" mass="{PUSHER_MASS}" diaginertia="1 1 1"/>
      <joint type="slide" axis="1 0 0" armature="{PUSHER_INERTIA}"/>
      <joint type="slide" axis="0 1 0" armature="{PUSHER_INERTIA}"/>
      <joint type="slide" axis="0 0 1" damping="1"/>
      <geom name="pusher" type="capsule" size="{radius - WALL_RADIUS} {PUSHER_HALF_LENGTH}"/>
    </body>
  </worldbody>
  <contact>{_describe_pairs(body, len(edges))}</contact>
</mujoco>"""


def _find_edges(table: Bounds) -> list[Edge]:
    """The ends of those of the table's sides that are within reach."""
    left, low, right, high = table
    corners = [(left, low), (right, low), (right, high), (left, high)]
    sides = zip(corners, corners[1:] + corners[:1], strict=True)
    return [(a, b) for a, b in sides if max(abs(a[0] + b[0]), abs(a[1] + b[1])) < 2 * TABLE_HALF]


def _describe_inertia(body: TruthBody) -> str:
    obj, mass = body.obj, body.params.mass
    x, y = body.params.center_of_mass(obj)
    arm_x, arm_y = (obj.p_BC - (x, y)).T
    cell = mass.sum() * obj.cell_size**2 / 12
    flat = mass.sum() * BODY_HEIGHT**2 / 12 + cell
    ixx, iyy, ixy = mass @ arm_y**2 + flat, mass @ arm_x**2 + flat, -mass @ (arm_x * arm_y)
    izz = mass @ (arm_x**2 + arm_y**2) + 2 * cell
    return f'<inertial pos="{x} {y} {BODY_HEIGHT / 2}" mass="{mass.sum()}" fullinertia="{ixx} {iyy} {izz} {ixy} 0 0"/>'


def _describe_geoms(body: TruthBody) -> str:
    """Feet f, walls w along the outline at the pusher's height, and plates p: the flat bottom."""
    z, half, edges = body.push_height, body.obj.cell_size / 2, body.obj.edges
    feet = (
        f'<geom name="f{i}" type="sphere" size="{FOOT_RADIUS}" pos="{x} {y} {FOOT_RADIUS + gap}"/>'
        for i, ((x, y), gap) in enumerate(zip(body.feet, body.gap, strict=True))
    )
    walls = (
        f'<geom name="w{i}" type="capsule" size="{WALL_RADIUS}" fromto="{a[0]} {a[1]} {z} {b[0]} {b[1]} {z}"/>'
        for i, (a, b) in enumerate(zip(edges.start, edges.end, strict=True))
    )
    plates = (
        f'<geom name="p{i}" type="box" size="{half} {half} {PLATE_HALF}" pos="{x} {y} {body.bottom + PLATE_HALF}"/>'
        for i, (x, y) in enumerate(body.obj.p_BC)
    )
    return "".join([*feet, *walls, *plates])


def _describe_pairs(body: TruthBody, edges: int) -> str:
    """Feet on the table, the pusher on walls, plates on the table's edges, with their frictions."""
    params = body.params
    feet = [("foot", "table", f"f{i}", mu) for i, mu in enumerate(params.friction[body.cell])]
    walls = [
        ("wall", "pusher", f"w{i}", params.contact_friction)
        for i in range(len(body.obj.edges.start))
    ]
    rims = [
        ("edge", f"e{e}", f"p{i}", mu) for e in range(edges) for i, mu in enumerate(params.friction)
    ]
    return "".join(
        f'<pair name="{kind}_{a}_{b}" geom1="{a}" geom2="{b}" condim="3" friction="{mu} {mu} 0 0 0"/>'
        for kind, a, b, mu in (*feet, *walls, *rims)
    )


def _set_contacts(model: "mujoco.MjModel", body: TruthBody) -> None:
    """Gives feet, walls and edges their stiffness."""
    weight = np.array([body.params.total_mass * GRAVITY])
    foot, pusher = (float(value) for value in model.body_invweight0[1:, 0])
    names = [model.pair(i).name for i in range(model.npair)]  # MuJoCo sorts them
    feet = [names.index(f"foot_table_f{i}") for i in range(len(body.load))]
    walls, edges = (
        [i for i, name in enumerate(names) if name.startswith(kind)] for kind in ("wall", "edge")
    )
    _set_springs(model, feet, body.load, body.sinkage, foot)
    _set_springs(model, walls, weight, PUSHER_SINKAGE, foot + pusher)
    _set_springs(model, edges, weight / EDGE_BEARING, body.sinkage, foot)


def _set_springs(
    model: "mujoco.MjModel", rows: list[int], load: Array, sinkage: float, inverse: float
) -> None:
    """Lets pairs of geoms give way by `sinkage` under a load, see `calc_springs`."""
    springs, slip, impedance = calc_springs(load, sinkage, inverse)
    model.pair_solref[rows], model.pair_solreffriction[rows] = springs, slip
    model.pair_solimp[rows, :2] = impedance[:, None]
