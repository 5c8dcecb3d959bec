"""Pushes in Drake's MultibodyPlant and in MuJoCo, and the same ones in the grid LCP model.

Objects have random parts. They get random pushes of 10 cm from random places of their outlines: by
a disc straight ahead, which the model follows with inertia, and by two fingertips or a plate along
arcs, which it follows quasi-statically. The plants' sphere feet resist
no spin, so the model's exact counterpart is spin="none"; "coupled", the default elsewhere, gives
cells their area. With Drake's "planar" base and in MuJoCo each cell bears its own weight, as the
model assumes. With the "free" base the loads shift, because the pusher touches the object above the
table.

`PlantWorld` is the plant as a world of closed loops and other benches.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import ceil, radians
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydrake.geometry import Box, Capsule, CollisionFilterDeclaration, GeometrySet, Sphere
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    Joint,
    ModelInstanceIndex,
    PdControllerGains,
    PrismaticJoint,
    RevoluteJoint,
    SpatialInertia,
)
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, DiagramBuilder
from shapely import Point

from gridpush_drake.bench.study import JobKind
from gridpush_drake.bench.worlds.mujoco_plant import MujocoPlant
from gridpush_drake.dynamics.bodies import Bodies
from gridpush_drake.dynamics.physics import Physics, Regime
from gridpush_drake.dynamics.push import Push, find_clear_start
from gridpush_drake.dynamics.pusher import PusherShape, choose_pusher_radius
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import PushError
from gridpush_drake.geometry.se2 import Array, compose, make_direction, turn_left
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.prediction import calc_pose_error
from gridpush_drake.multibody.contact_material import MakePartnerProperties
from gridpush_drake.multibody.grid_object import AddGridObject, Base
from gridpush_drake.multibody.ground_truth import (
    CalcPlanarPose,
    SetGridObjectParameters,
    SetGridObjectPose,
    SetGridObjectVelocity,
    sample_ground_truth,
)
from gridpush_drake.multibody.parser import AddPlantAndSceneGraph
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import find_shipped_object
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.planning.world import (
    FALLEN_TILT,
    OBSERVATION_COUNT,
    CenterOfMassSupport,
    TrackedWorld,
    WorldMotion,
    WorldTruth,
)
from gridpush_drake.report.table import ALL_RESULTS, Table, by_object, mean_of
from gridpush_drake.units import DEG_PER_RAD, MM_PER_M

DEFAULT_OBJECTS = ("claw_hammer", "combination_wrench", "toolbox", "spray_bottle")
"""Shipped objects that are pushed."""

PUSH_COUNT = 20
"""Number of pushes of each object by a disc."""

SHAPE_PUSH_COUNT = 13
"""Number of pushes of each object by each pusher of another shape."""

PUSH_LENGTH = 0.1
"""Length of a push, m."""

PUSHER_SPEED = 0.05
"""Speed of the pusher, m/s."""

MAX_PUSH_ANGLE = radians(30)
"""Greatest angle of a push from the outline's inward normal, rad."""

MIN_MOTION = 0.01
"""Mean distance that a push must move the cells, m; pushes that move them less are drawn again."""

MODEL_TIME_STEP = 1e-3
"""Time step of the model, s; the planar plant has the same."""

MAX_PUSH_TRIES = 100
"""Number of random pushes that are tried before it is said that none moves the object."""

PlantKind = Literal["planar", "free", "mujoco"]
"""Kind of a plant: Drake's with one of the bases of `AddGridObject`, or MuJoCo's."""

PLANAR_PLANT: PlantKind = "planar"
"""Drake's plant in which each cell bears its own weight."""

FREE_PLANT: PlantKind = "free"
"""Drake's plant in which loads shift; in it objects are pushed by a disc only."""

MUJOCO_PLANT: PlantKind = "mujoco"
"""The object in MuJoCo, see `MujocoPlant`."""

DISC_PUSHER = "disc"
"""Name of the pusher that is one disc, of the radius in the object's file."""

PUSHER_SHAPES = {
    "two fingertips": PusherShape.discs([(0.0, -0.02), (0.0, 0.02)], 0.004),
    "plate": PusherShape.plate(0.06, 0.015, 0.004),
}
"""The other pushers, by name."""

PUSHER_NAMES = (DISC_PUSHER, *PUSHER_SHAPES)
"""Names of all pushers."""

SHAPE_SPEED = PUSHER_SPEED / 4
"""Speed of a pusher with a shape, m/s. The model follows it quasi-statically, and the plants'
object has inertia: at the disc's speed it glides on by up to 1.2 mm where the pusher leaves it, at
a quarter of it by a tenth of that."""

MAX_CURVATURE = 5.0
"""Greatest curvature of the path of a pusher with a shape, 1/m; its sign is drawn, too."""

PLACING_GAP = 1e-6
"""Distance from the outline at which a pusher with a shape is put, m."""

SPIN_MODELS: tuple[Literal["none", "coupled"], ...] = ("none", "coupled")
"""Models of how a cell resists spinning."""

TIME_STEP = {"planar": 1e-3, "free": 2e-3}
"""Time step of the plant by the object's base, s."""

STICTION_TOLERANCE = 1e-5
"""Stiction tolerance of the plant, m/s. With Drake's own, 1e-3, a finger that should stick slips by
0.1 mm in a push of 0.1 m."""

PUSH_HEIGHT = 0.012
"""Height of the center of the pusher, a sphere, above the table, m."""

PUSHER_MASS = 1.0
"""Mass of each of the pusher's two bodies, kg."""

PUSHER_GAIN = 1e7
"""Stiffness with which the pusher is held to its path, N/m, and N m/rad of one that turns."""

PUSHER_DAMPING = 1e4
"""Damping with which the pusher is held to its path, N s/m, and N m s/rad of one that turns."""

MAX_PIECE = 0.005
"""Longest capsule that the side of a polygon is made of, m. Drake finds one contact between a
capsule and a box, which would jump from end to end of a longer one that lies flush."""

TABLE_SIZE = (4.0, 4.0, 0.1)
"""Sides of the table in the plant along x, y and z, m."""


@dataclass(frozen=True)
class PlantJob:
    """The pushes of one object.

    Attributes:
        name: name of a shipped object.
        plant: kind of the plant.
        seeds: seeds of the pushes.
        pusher: one of PUSHER_NAMES.
    """

    name: str
    plant: PlantKind
    seeds: tuple[int, ...]
    pusher: str = DISC_PUSHER


@dataclass(frozen=True)
class PlantScore:
    """How far plant and model differ at the end of one push.

    Attributes:
        name: name of the object.
        plant: kind of the plant.
        seed: seed of the push.
        spin: the model's spin.
        position: distance of both origins of the body frame, m.
        angle: difference of both angles, rad.
        cells: mean distance of the cells in plant and model, m.
        moved: mean distance that the plant's cells went, m.
        tracking_error: greatest distance of the plant's pusher from its path, m.
        tilt: greatest tilt of the object in Drake's plant, rad; NaN in MuJoCo.
        pusher: one of PUSHER_NAMES.
    """

    name: str
    plant: str
    seed: int
    spin: str
    position: float
    angle: float
    cells: float
    moved: float
    tracking_error: float
    tilt: float
    pusher: str = DISC_PUSHER


def make_jobs(
    objects: Sequence[str],
    plants: Sequence[PlantKind],
    seed: int,
    pushes: int = PUSH_COUNT,
    shape_pushes: int = SHAPE_PUSH_COUNT,
) -> list[PlantJob]:
    """Makes a job for each object, pusher and plant.

    Args:
        objects: names of shipped objects.
        plants: kinds of plants.
        seed: seed of the first push; the others' follow.
        pushes: number of pushes of each object by a disc.
        shape_pushes: number of pushes of each object by each pusher of another shape.

    Raises:
        ObjectError: an object is not shipped.
    """
    for name in objects:
        find_shipped_object(name)
    jobs = []
    for pusher in PUSHER_NAMES:
        count = pushes if pusher == DISC_PUSHER else shape_pushes
        seeds = tuple(range(seed, seed + count))
        used = [kind for kind in plants if pusher == DISC_PUSHER or kind != FREE_PLANT]
        jobs += [PlantJob(name, kind, seeds, pusher) for kind in used for name in objects]
    return jobs


class _PlantPush(NamedTuple):
    """A push in a plant.

    Attributes:
        end: (3,) the object's last pose, m and rad.
        tracking_error: greatest distance of the pusher from its path, m.
        tilt: greatest tilt of the object, rad; NaN where it is not known.
    """

    end: Array
    tracking_error: float
    tilt: float


def run_job(job: PlantJob) -> list[PlantScore]:
    """Pushes one object in the plant and in the model, once for each seed."""
    obj = GridObject.from_yaml(find_shipped_object(job.name))
    shape = PUSHER_SHAPES.get(job.pusher) or PusherShape.disc(choose_pusher_radius(obj))
    push_there = _make_plant(job, obj, shape)
    regime: Regime = "inertial" if job.pusher == DISC_PUSHER else "quasi_static"
    scores = []
    for seed in job.seeds:
        params = sample_ground_truth(obj, seed, friction_by_part=True)
        model = Model(obj, params)
        if job.pusher == DISC_PUSHER:
            push, pose = draw_push(model, seed, shape.radius)
        else:
            push, pose = draw_shape_push(model, seed, shape)
        found = push_there(params, push, pose)
        moved = calc_pose_error(obj, found.end, pose).cell
        for spin in SPIN_MODELS:
            physics = Physics(regime=regime, spin=spin)
            expected = simulate(Model(obj, params, physics), push, pose, MODEL_TIME_STEP)
            error = calc_pose_error(obj, expected.final_pose, found.end)
            scores.append(
                PlantScore(
                    name=job.name,
                    plant=job.plant,
                    seed=seed,
                    spin=spin,
                    position=error.position,
                    angle=error.angle,
                    cells=error.cell,
                    moved=moved,
                    tracking_error=found.tracking_error,
                    tilt=found.tilt,
                    pusher=job.pusher,
                )
            )
    return scores


def _make_plant(
    job: PlantJob, obj: GridObject, shape: PusherShape
) -> Callable[[CellParameters, Push, Array], _PlantPush]:
    """Makes what pushes an object of given parameters from a pose (3,) in a job's plant."""
    if job.plant == MUJOCO_PLANT:

        def push_in_mujoco(params: CellParameters, push: Push, pose: Array) -> _PlantPush:
            end = MujocoPlant(obj, params, shape).push(push, pose)
            return _PlantPush(end, tracking_error=0.0, tilt=np.nan)

        return push_in_mujoco

    pusher: dict[str, Any] = (
        {"radius": shape.radius} if job.pusher == DISC_PUSHER else {"shape": shape}
    )
    base: Base = "free" if job.plant == FREE_PLANT else "planar"
    world = PlantWorld(Model(obj, CellParameters.uniform(obj)), base=base, **pusher)

    def push_in_drake(params: CellParameters, push: Push, pose: Array) -> _PlantPush:
        world.set_params(params)
        world.put(pose)
        world.execute(push)
        motion = world.truth.motion
        assert motion is not None
        assert motion.tilt is not None
        return _PlantPush(motion.poses[-1], world.tracking_error, float(motion.tilt.max()))

    return push_in_drake


def draw_push(model: Model, seed: int, radius: float) -> tuple[Push, Array]:
    """Draws a push from a place of the outline inwards, and where the object lies.

    Args:
        model: one object, with its parameters.
        seed: seed of the push and the pose.
        radius: radius of the pusher, m.

    Returns:
        The push, and the object's pose (3,), m and rad.

    Raises:
        PushError: hardly any push moves the object.
    """
    obj = model.obj
    rng = np.random.default_rng((seed, 3))

    def draw(pose: Array) -> Push | None:
        place = rng.uniform(0, obj.edges.perimeter)
        angle = rng.uniform(-MAX_PUSH_ANGLE, MAX_PUSH_ANGLE)
        point, _, normal = obj.edges.at(place)
        # In a notch the pusher may not reach the place without touching another one.
        if obj.outline.distance(Point(point + normal * radius)) < (1 - 1e-6) * radius:
            return None
        return Push.on_outline(
            obj, place, angle, PUSH_LENGTH, radius=radius, speed=PUSHER_SPEED, pose=pose
        )

    return _draw_moving(model, rng, "inertial", draw)


def draw_shape_push(model: Model, seed: int, shape: PusherShape) -> tuple[Push, Array]:
    """Draws a push by a shape, along an arc that begins at the outline, and where the object lies.

    Args:
        model: one object, with its parameters.
        seed: seed of the push and the pose.
        shape: the pusher's; it pushes about along its x axis.

    Returns:
        The push, and the object's pose (3,), m and rad.

    Raises:
        PushError: hardly any push moves the object.
    """
    obj = model.obj
    rng = np.random.default_rng((seed, 4))

    def draw(pose: Array) -> Push:
        point, _, normal = obj.edges.at(rng.uniform(0, obj.edges.perimeter))
        angle = np.arctan2(*-normal[::-1]) + rng.uniform(-MAX_PUSH_ANGLE, MAX_PUSH_ANGLE)
        curvature = rng.uniform(-MAX_CURVATURE, MAX_CURVATURE)
        p_BT = find_clear_start(obj, shape, point, angle, 0.0, PLACING_GAP)
        X_WT = compose(pose, np.array([*p_BT, angle]))
        return Push.about(
            X_WT[:2] + turn_left(make_direction(X_WT[2])) / curvature,
            curvature * PUSH_LENGTH,
            shape=shape,
            start=X_WT[:2],
            yaw=X_WT[2],
            duration=PUSH_LENGTH / SHAPE_SPEED,
        )

    return _draw_moving(model, rng, "quasi_static", draw)


def _draw_moving(
    model: Model, rng: np.random.Generator, regime: Regime, draw: Callable[[Array], Push | None]
) -> tuple[Push, Array]:
    """Draws poses (3,) and pushes until a push moves the object.

    Args:
        model: one object, with its parameters.
        rng: draws the poses.
        regime: in which the pushes are simulated.
        draw: draws a push of the object at a pose; None where that push cannot be made.

    Returns:
        The push, and the object's pose (3,), m and rad.

    Raises:
        PushError: hardly any push moves the object.
    """
    obj = model.obj
    for _ in range(MAX_PUSH_TRIES):
        pose = np.array([*rng.uniform(-0.1, 0.1, 2), rng.uniform(-np.pi, np.pi)])
        push = draw(pose)
        if push is None:
            continue
        last = simulate(model, push, pose, regime=regime).final_pose
        if calc_pose_error(obj, last, pose).cell >= MIN_MOTION:
            return push, pose
    raise PushError(
        f"{obj.name}: none of {MAX_PUSH_TRIES} random pushes moves it by "
        f"{MIN_MOTION * MM_PER_M:g} mm"
    )


def make_table(scores: Sequence[PlantScore]) -> Table:
    """Sums up scores by object, pusher, plant and spin model, and over all objects."""
    names = list(dict.fromkeys(score.name for score in scores))
    groups = [
        ((name, pusher, kind, spin), found)
        for pusher, kind in dict.fromkeys((score.pusher, score.plant) for score in scores)
        for spin in SPIN_MODELS
        for (name,), found in by_object(
            [s for s in scores if (s.pusher, s.plant, s.spin) == (pusher, kind, spin)], names
        )
        if name != ALL_RESULTS or len(names) > 1
    ]
    columns = {
        "pushes": len,
        "moved, mm": mean_of("moved", MM_PER_M),
        "mean, mm": mean_of("position", MM_PER_M),
        "max, mm": lambda some: MM_PER_M * max(score.position for score in some),
        "mean, °": mean_of("angle", DEG_PER_RAD),
        "max, °": lambda some: DEG_PER_RAD * max(score.angle for score in some),
        "cells, mm": mean_of("cells", MM_PER_M),
    }
    worst = max(score.tracking_error for score in scores)
    notes = (
        f"Difference of the last poses after pushes of {PUSH_LENGTH * 100:g} cm at "
        f"{PUSHER_SPEED * 100:g} cm/s; random parts. A disc goes straight ahead; the others go "
        f"along arcs of radii down to {100 / MAX_CURVATURE:g} cm, at {SHAPE_SPEED * 100:g} cm/s.",
        "Planar: every foot bears its cell's weight, dt 1 ms.",
        "Free: six degrees of freedom, pushed 12 mm above the table, dt 2 ms: load shifts to the "
        "cells in front.",
        "mujoco: every foot bears its cell's weight, pushed at the table's height.",
        "Spin: the model's; none is the plants' sphere feet.",
        f"The pusher of Drake's plant left its path by at most {worst * 1e6:.1f} µm.",
    )
    return Table.of(
        "Drake's MultibodyPlant and MuJoCo against the grid LCP",
        ("object", "pusher", "plant", "spin"),
        groups,
        columns,
        notes,
    )


class PlantWorld(TrackedWorld):
    """An object in a MultibodyPlant on a table, pushed by a sphere or a shape along a given path.

    The sphere slides on two prismatic joints, x and y (a shape turns on a revolute one, too). Stiff
    implicit PD gains hold it to its path, from which it errs by force/gain, 1e-6 m. A pusher of
    huge mass at constant velocity would seem simpler, but Drake's solver stops at a residual
    relative to the largest momentum around, and the object's motion is then not solved at all.

    With the "planar" base the object cannot fall: as in `SimulatedWorld`, it counts as fallen where
    its center of mass leaves the hull of what lies on the table. With the "free" base it has fallen
    where it tilts by FALLEN_TILT.

    Attributes:
        bodies: the object with its true masses and frictions; `set_params` changes them.
        radius: radius of the pusher, m.
        shape: what the pusher is seen as from above; None of one sphere.
        dt: time step of the plant, s.
        plant: the plant.
        scene_graph: its geometry.
        pusher: the pusher's model instance.
        handle: the object in the plant.
        simulator: what advances plant and geometry.
        tracking_error: greatest distance of the pusher from its path during the last push, m.
    """

    bodies: Bodies

    def __init__(
        self,
        bodies: Bodies,
        pose: ArrayLike = (0.0, 0.0, 0.0),
        surface: SupportSurface | None = None,
        *,
        radius: float | None = None,
        shape: PusherShape | None = None,
        base: Base = "planar",
        push_height: float = PUSH_HEIGHT,
        edge: float | None = None,
        position_std: float = 0.0,
        angle_std: float = 0.0,
        seed: int | np.random.Generator = 0,
        observations: int = OBSERVATION_COUNT,
        **options: Any,
    ) -> None:
        """Builds the plant, which pushes as often as wanted, and puts the object down.

        Args:
            bodies: the object with its true masses and frictions.
            pose: (3,) where it lies, m and rad.
            surface: the table as far as falling goes, see above; None for one without end. The
                plant's own table is TABLE_SIZE large.
            radius: radius of the pusher, m; the one that planners push with where None.
            shape: what the pusher is seen as from above, in place of a radius.
            base: "planar" or "free".
            push_height: height of the pusher's center above the table, m.
            edge: x of the plant's table's edge in W, m: the table is where x is less; None for a
                table about the world's origin.
            position_std: standard deviation of seen positions, per axis, m.
            angle_std: standard deviation of seen angles, rad.
            seed: seed of the noise, or the generator that draws it.
            observations: number of poses that are seen during a push after the first one.
            options: passed on to `AddGridObject`.
        """
        self.bodies = bodies
        self.radius = choose_pusher_radius(bodies.obj, shape.radius if shape else radius)
        self.shape = shape
        self.dt = TIME_STEP[base]
        self.tracking_error = 0.0
        self._support = (
            None
            if surface is None
            else CenterOfMassSupport(bodies.obj, bodies.center_of_mass, surface)
        )
        builder = DiagramBuilder()
        self.plant, self.scene_graph = AddPlantAndSceneGraph(builder, self.dt)
        self.plant.set_stiction_tolerance(STICTION_TOLERANCE)
        middle = [0.0 if edge is None else edge - TABLE_SIZE[0] / 2, 0.0, -TABLE_SIZE[2] / 2]
        table = self.plant.RegisterCollisionGeometry(
            self.plant.world_body(),
            RigidTransform(np.array(middle)),
            Box(*TABLE_SIZE),
            "table",
            MakePartnerProperties(),
        )
        self.pusher = AddPusher(self.plant, self.radius, push_height, shape)
        self.handle = AddGridObject(
            self.plant, self.scene_graph, bodies, base, table=[table], **options
        )
        # The pusher may be low, and must not rub on the table.
        tip = self.plant.GetCollisionGeometriesForBody(self.plant.GetBodyByName("tip", self.pusher))
        self.scene_graph.collision_filter_manager().Apply(
            CollisionFilterDeclaration().ExcludeBetween(GeometrySet(tip), GeometrySet(table))
        )
        self.plant.Finalize()
        self.simulator = Simulator(builder.Build())
        self.set_params(bodies.params)
        super().__init__(
            pose,
            position_std=position_std,
            angle_std=angle_std,
            seed=seed,
            observations=observations,
        )

    def set_params(self, params: CellParameters) -> None:
        """Gives the object other masses and frictions."""
        context = self.simulator.get_mutable_context()
        SetGridObjectParameters(self.plant, self.scene_graph, context, self.handle, params)
        self.bodies = self.bodies.with_params(params)

    def do_put(self, pose: Array) -> Array:
        """Puts the object down flat at a pose (3,), at rest."""
        SetGridObjectPose(self.plant, self._plant_context, self.handle, pose)
        return pose

    def do_push(self, push: Push, pose: Array) -> WorldMotion:
        """Pushes the object from where it is, at rest.

        Raises:
            PushError: the pusher's radius is another, or one of both is a disc alone.
        """
        if not np.isclose(push.radius, self.radius):
            raise PushError(
                f"push: the radius is {push.radius:g} m; "
                f"expected that of the plant's pusher, {self.radius:g} m"
            )
        if (push.shape is None) != (self.shape is None):
            raise PushError("push: expected the pusher of the plant, discs or one disc")
        plant = self.plant
        context = self.simulator.get_mutable_context()
        plant_context = self._plant_context
        times = np.linspace(0, push.duration, round(push.duration / self.dt) + 1)
        path = push.tip_at(times)
        if push.shape is not None:
            path = np.column_stack([path, push.yaw_at(times)])
        velocity = np.gradient(path, times, axis=0)
        desired = plant.get_desired_state_input_port(self.pusher)

        # Everything is at rest but the pusher, which is on its path already.
        SetGridObjectVelocity(plant, plant_context, self.handle, (0.0, 0.0, 0.0))
        plant.SetPositions(plant_context, self.pusher, path[0])
        plant.SetVelocities(plant_context, self.pusher, velocity[0])
        desired.FixValue(plant_context, np.r_[path[0], velocity[0]])
        context.SetTime(0)
        self.simulator.Initialize()

        poses = [CalcPlanarPose(plant, plant_context, self.handle)]
        tilt = [0.0]
        self.tracking_error = 0.0
        for i in range(1, len(times)):
            # The gains act at the step's end, so that is where the pusher is wanted.
            desired.FixValue(plant_context, np.r_[path[i], velocity[i]])
            self.simulator.AdvanceTo(i * self.dt)
            poses.append(CalcPlanarPose(plant, plant_context, self.handle))
            off = plant.GetPositions(plant_context, self.pusher)[:2] - path[i, :2]
            self.tracking_error = max(self.tracking_error, float(np.linalg.norm(off)))
            tilt.append(self._read_tilt())
        made = np.array(poses)
        made[:, 2] = np.unwrap(np.append(pose[2], made[:, 2]))[1:]
        fell = max(tilt) >= FALLEN_TILT or (self._support is not None and self._support.falls(made))
        return WorldMotion(times=times, poses=made, fell=fell, tilt=np.array(tilt))

    @property
    def truth(self) -> WorldTruth:
        """What is true of the object now, for judges only."""
        return replace(super().truth, tilt=self._read_tilt())

    @property
    def _plant_context(self) -> Context:
        return self.plant.GetMyMutableContextFromRoot(self.simulator.get_mutable_context())

    def _read_tilt(self) -> float:
        """Reads the angle of B's z axis from the vertical, rad."""
        X_WB = self.plant.EvalBodyPoseInWorld(self._plant_context, self.handle.body)
        upright = X_WB.rotation().matrix()[2, 2]
        return float(np.arccos(np.clip(upright, -1, 1)))


PLANT_JOBS = JobKind(
    job=PlantJob, run=run_job, describe=lambda job: f"{job.name}, {job.plant}, {job.pusher}"
)
"""What is done with a job."""


def AddPusher(
    plant: MultibodyPlant, radius: float, height: float, shape: PusherShape | None = None
) -> ModelInstanceIndex:
    """Adds a pusher on prismatic joints, x and y of the world, with PD gains, before Finalize.

    Args:
        plant: the plant.
        radius: radius of the sphere, or of the shape's discs or round corners, m.
        height: height of its center above the world's origin, m.
        shape: discs, as spheres that also turn together, or a polygon, with lying capsules along
            its sides; None of a single sphere.

    Returns:
        Its model instance; the desired state is x, y (m) and their rates (m/s); of a shape x, y,
        yaw (m and rad) and their rates.
    """
    instance = plant.AddModelInstance("pusher")
    inertia = SpatialInertia.SolidSphereWithMass(PUSHER_MASS, radius)
    names = ("slide", "tip") if shape is None else ("slide", "carriage", "tip")
    slide, *others = (plant.AddRigidBody(name, instance, inertia) for name in names)
    tip = others[-1]
    X_WR = RigidTransform(np.array([0, 0, height]))
    rail = plant.AddFrame(FixedOffsetFrame("rail", plant.world_frame(), X_WR, instance))
    x, y, z = np.eye(3)
    joints: list[Joint] = [
        PrismaticJoint("x", rail, slide.body_frame(), x),
        PrismaticJoint("y", slide.body_frame(), others[0].body_frame(), y),
    ]
    if shape is not None:
        joints.append(RevoluteJoint("yaw", others[0].body_frame(), tip.body_frame(), z))
    for joint in joints:
        added = plant.AddJoint(joint)
        actuator = plant.AddJointActuator(joint.name(), added)
        actuator.set_controller_gains(PdControllerGains(p=PUSHER_GAIN, d=PUSHER_DAMPING))
    for i, (X_TG, part) in enumerate(_list_pusher_parts(radius, shape)):
        plant.RegisterCollisionGeometry(
            tip, X_TG, part, f"tip{i}" if i else "tip", MakePartnerProperties()
        )
    return instance


def _list_pusher_parts(
    radius: float, shape: PusherShape | None
) -> list[tuple[RigidTransform, Sphere | Capsule]]:
    """Lists the geometries of a pusher, each with its pose in the pusher's frame."""
    if shape is None or not shape.joined:
        centers = np.zeros((1, 2)) if shape is None else shape.core
        return [(RigidTransform(np.array([*center, 0])), Sphere(radius)) for center in centers]
    parts = []
    for begin, end in zip(shape.core, np.roll(shape.core, -1, axis=0), strict=True):
        side = end - begin
        length = float(np.linalg.norm(side))
        lying = RollPitchYaw(0, np.pi / 2, np.arctan2(side[1], side[0]))
        count = ceil(length / MAX_PIECE)
        for i in range(count):
            middle = begin + (i + 0.5) / count * side
            X_TG = RigidTransform(lying, np.array([*middle, 0]))
            parts.append((X_TG, Capsule(radius, length / count)))
    return parts
