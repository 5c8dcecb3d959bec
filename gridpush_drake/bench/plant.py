"""The same pushes in Drake's MultibodyPlant and in the grid LCP model.

Random parts, random pushes of 10 cm from random places of the outline. The plant's sphere feet
resist no spin, so the model's exact counterpart is spin="none"; "coupled", the default elsewhere,
gives cells their area. With the "planar" base each cell bears its own weight, as the model assumes;
with the "free" base the loads shift because the push acts above the table.

A grid object in a MultibodyPlant, pushed by a sphere along a given path.

The sphere slides on two prismatic joints, x and y, and is held to its path by stiff implicit PD
gains: it errs by force/gain, 1e-6 m. A pusher of huge mass at constant velocity would seem simpler,
but Drake's solver stops at a residual relative to the largest momentum around, and the object's
motion is then not solved at all.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import radians
from typing import Any, Literal

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
from shapely import Point

from gridpush_drake.bench.jobs import QUIET, Execution, run_jobs
from gridpush_drake.bench.table import ALL, DEGREES, MM, Table, by_object, mean_of
from gridpush_drake.dynamics.physics import Physics
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import PushError
from gridpush_drake.identification.prediction import calc_pose_error
from gridpush_drake.multibody.contact_material import MakePartnerProperties
from gridpush_drake.multibody.grid_object import AddGridObject, Base
from gridpush_drake.multibody.ground_truth import (
    CalcPlanarPose,
    SetGridObjectParameters,
    SetGridObjectPose,
    sample_ground_truth,
)
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import find_shipped_object
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.pushes.push_log import DEFAULT_PUSHER_RADIUS

OBJECTS = ("claw_hammer", "combination_wrench", "toolbox", "spray_bottle")
PUSHES, DISTANCE, SPEED = 20, 0.1, 0.05
"""Of an object; m and m/s."""

SLANT = radians(30)
"""Furthest from the outline's normal."""

MIN_MOTION = 0.01
"""m, mean over the cells; pushes that move the object less are drawn again."""

MODEL_TIME_STEP = 1e-3
"""s, of the model: the plant's."""

TRIES = 100
BASES: tuple[Base, ...] = ("planar", "free")
SPINS: tuple[Literal["none", "coupled"], ...] = ("none", "coupled")


@dataclass(frozen=True)
class PlantJob:
    """The pushes of one object, held in one way."""

    name: str
    base: Base
    seeds: tuple[int, ...]


@dataclass(frozen=True)
class PlantScore:
    """How far plant (its base, its tilt) and model (its spin) differ at the end of one push, m and rad.

    `position` is the distance of B's origins, `cells` the mean one of the cells, `moved` how far
    the plant's cells went on average, and `tracking_error` the plant's pusher's.
    """

    name: str
    base: str
    seed: int
    spin: str
    position: float
    angle: float
    cells: float
    moved: float
    tracking_error: float
    tilt: float


def calc_scores(
    objects: Sequence[str] = OBJECTS,
    pushes: int = PUSHES,
    bases: Sequence[Base] = BASES,
    *,
    seed: int = 0,
    execution: Execution = QUIET,
) -> list[PlantScore]:
    """Compares the two, push by push, and for each spin model; `seed` is the first push's.

    Raises:
        ObjectError: an object is not shipped.
    """
    for name in objects:
        find_shipped_object(name)
    seeds = tuple(range(seed, seed + pushes))
    jobs = [PlantJob(name, base, seeds) for base in bases for name in objects]
    results = run_jobs(run_job, jobs, lambda job: f"{job.name}, {job.base}", execution)
    return [score for result in results for score in result]


def run_job(job: PlantJob) -> list[PlantScore]:
    """Pushes one object in the plant and in the model, once a seed."""
    obj = GridObject.from_yaml(find_shipped_object(job.name))
    radius = obj.prior.pusher_radius or DEFAULT_PUSHER_RADIUS
    pusher = PlantPusher(obj, CellParameters.uniform(obj), radius, job.base)
    scores = []
    for seed in job.seeds:
        params = sample_ground_truth(obj, seed, friction_by_part=True)
        push, pose = draw_push(obj, params, seed, radius)
        motion = pusher.push(params, push, pose)
        moved = calc_pose_error(obj, motion.poses[-1], pose).cell
        for spin in SPINS:
            physics = Physics(regime="inertial", spin=spin)
            expected = simulate(
                obj, params, push, pose, MODEL_TIME_STEP, physics=physics
            ).final_pose
            error = calc_pose_error(obj, expected, motion.poses[-1])
            scores.append(
                PlantScore(
                    job.name, job.base, seed, spin, error.position, error.angle, error.cell, moved,
                    motion.tracking_error, motion.tilt,
                )
            )  # fmt: skip
    return scores


def draw_push(
    obj: GridObject, params: CellParameters, seed: int, radius: float
) -> tuple[Push, np.ndarray]:
    """Draws a push of a pusher's radius, from a place of the outline inwards, and a pose (3,) of the object.

    Raises:
        PushError: hardly any push moves the object.
    """
    rng = np.random.default_rng((seed, 3))
    for _ in range(TRIES):
        pose = np.array([*rng.uniform(-0.1, 0.1, 2), rng.uniform(-np.pi, np.pi)])
        place, angle = rng.uniform(0, obj.edges.perimeter), rng.uniform(-SLANT, SLANT)
        point, _, normal = obj.edges.at(place)
        if obj.outline.distance(Point(point + normal * radius)) < (1 - 1e-6) * radius:
            continue
        push = Push.on_outline(obj, place, angle, DISTANCE, radius=radius, speed=SPEED, pose=pose)
        if (
            calc_pose_error(
                obj, simulate(obj, params, push, pose, regime="inertial").final_pose, pose
            ).cell
            >= MIN_MOTION
        ):
            return push, pose
    raise PushError(f"{obj.name}: none of {TRIES} random pushes moves it by {MIN_MOTION * MM:g} mm")


def make_table(scores: Sequence[PlantScore]) -> Table:
    """Sums up scores by object, base and spin model, and over all objects."""
    names = list(dict.fromkeys(score.name for score in scores))
    groups = [
        ((name, base, spin), found)
        for base in dict.fromkeys(score.base for score in scores)
        for spin in SPINS
        for (name,), found in by_object(
            [s for s in scores if (s.base, s.spin) == (base, spin)], names
        )
        if name != ALL or len(names) > 1
    ]
    columns = {
        "pushes": len,
        "moved, mm": mean_of("moved", MM),
        "mean, mm": mean_of("position", MM),
        "max, mm": lambda some: MM * max(score.position for score in some),
        "mean, °": mean_of("angle", DEGREES),
        "max, °": lambda some: DEGREES * max(score.angle for score in some),
        "cells, mm": mean_of("cells", MM),
    }
    worst = max(score.tracking_error for score in scores)
    notes = (
        f"Difference of the last poses after pushes of {DISTANCE * 100:g} cm at {SPEED * 100:g} cm/s; random parts.",
        "Planar: every foot bears its cell's weight, dt 1 ms.",
        "Free: six degrees of freedom, pushed 12 mm above the table, dt 2 ms: load shifts to the cells in front.",
        "Spin: the model's; none is the plant's sphere feet.",
        f"The plant's pusher left its path by at most {worst * 1e6:.1f} µm.",
    )
    return Table.of(
        "MultibodyPlant against the grid LCP", ("object", "base", "spin"), groups, columns, notes
    )


TIME_STEP = {"planar": 1e-3, "free": 2e-3}
"""s."""

STICTION_TOLERANCE = 1e-5
"""m/s; Drake's own, 1e-3, lets a finger that should stick slip by 0.1 mm in a push of 0.1 m."""

PUSH_HEIGHT = 0.012
"""m, of the sphere's center above the table."""

PUSHER_MASS, PUSHER_GAIN, PUSHER_DAMPING = 1.0, 1e7, 1e4
"""kg, of each of the pusher's two bodies; N/m and N s/m."""

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
        push_height: of the pusher's center above the table, m.
        edge: x of the table's edge in W, m: the table is where x is less; None for one without.
        options: passed on to `AddGridObject`.
    """

    def __init__(
        self, obj: GridObject, params: CellParameters, radius: float, base: Base = "planar",
        push_height: float = PUSH_HEIGHT, edge: float | None = None, **options: Any,
    ) -> None:  # fmt: skip
        builder = DiagramBuilder()
        self.radius, self.dt = radius, TIME_STEP[base]
        self.plant, self.scene_graph = AddMultibodyPlantSceneGraph(builder, self.dt)
        self.plant.set_stiction_tolerance(STICTION_TOLERANCE)
        middle = [0.0 if edge is None else edge - TABLE_SIZE[0] / 2, 0.0, -TABLE_SIZE[2] / 2]
        table = self.plant.RegisterCollisionGeometry(
            self.plant.world_body(), RigidTransform(np.array(middle)), Box(*TABLE_SIZE), "table",
            MakePartnerProperties(),
        )  # fmt: skip
        self.pusher = AddPusher(self.plant, radius, push_height)
        self.handle = AddGridObject(
            self.plant, self.scene_graph, obj, params, base, table=[table], **options
        )
        tip = self.plant.GetCollisionGeometriesForBody(self.plant.GetBodyByName("tip", self.pusher))
        self.scene_graph.collision_filter_manager().Apply(
            CollisionFilterDeclaration().ExcludeBetween(GeometrySet(tip), GeometrySet(table))
        )
        self.plant.Finalize()
        self.simulator = Simulator(builder.Build())

    def push(
        self, params: CellParameters, push: Push, pose: ArrayLike = (0.0, 0.0, 0.0)
    ) -> PlantMotion:
        """Pushes the object from rest at a pose (3,), m and rad, with these masses and frictions.

        Raises:
            PushError: the pusher's radius is another.
        """
        if not np.isclose(push.radius, self.radius):
            raise PushError(
                f"push: the radius is {push.radius:g} m; expected that of the plant's, {self.radius:g}"
            )
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
            error = max(
                error,
                float(np.linalg.norm(plant.GetPositions(plant_context, self.pusher) - path[i])),
            )
            upright = (
                plant.EvalBodyPoseInWorld(plant_context, self.handle.body).rotation().matrix()[2, 2]
            )
            tilt = max(tilt, float(np.arccos(np.clip(upright, -1, 1))))
        return PlantMotion(times, np.array(poses), error, tilt)


def AddPusher(plant: MultibodyPlant, radius: float, height: float) -> ModelInstanceIndex:
    """Adds a sphere on two prismatic joints, x and y of the world, with PD gains, before Finalize.

    Returns:
        Its model instance; the desired state is x, y (m) and their rates.
    """
    instance = plant.AddModelInstance("pusher")
    inertia = SpatialInertia.SolidSphereWithMass(PUSHER_MASS, radius)
    slide = plant.AddRigidBody("slide", instance, inertia)
    tip = plant.AddRigidBody("tip", instance, inertia)
    rail = plant.AddFrame(
        FixedOffsetFrame(
            "rail", plant.world_frame(), RigidTransform(np.array([0, 0, height])), instance
        )
    )
    for name, parent, child, axis in (
        ("x", rail, slide.body_frame(), [1, 0, 0]),
        ("y", slide.body_frame(), tip.body_frame(), [0, 1, 0]),
    ):
        joint = plant.AddJoint(PrismaticJoint(name, parent, child, np.array(axis)))
        gains = PdControllerGains(p=PUSHER_GAIN, d=PUSHER_DAMPING)
        plant.AddJointActuator(name, joint).set_controller_gains(gains)
    plant.RegisterCollisionGeometry(
        tip, RigidTransform(), Sphere(radius), "tip", MakePartnerProperties()
    )
    return instance
