"""A table with an edge, an object that can tip over it, and a finger that presses: in Drake.

The object is free, with six degrees of freedom, and the edge bears (`multibody.table_rim`). The
finger is held by springs along x, y and z, as an arm under impedance control is; its force is
measured with noise and an offset.
"""

from dataclasses import dataclass, replace
from zlib import crc32

import numpy as np
from pydrake.geometry import Box, CollisionFilterDeclaration, GeometrySet, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    ModelInstanceIndex,
    PdControllerGains,
    PrismaticJoint,
    SpatialInertia,
)
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, DiagramBuilder

from gridpush_drake.errors import PlanningError
from gridpush_drake.geometry.se2 import Array, check_vector
from gridpush_drake.identification.model import Model
from gridpush_drake.multibody.contact_material import MakePartnerProperties
from gridpush_drake.multibody.grid_object import DEFAULT_HEIGHT, AddGridObject, Feet
from gridpush_drake.multibody.ground_truth import CalcPlanarPose, SetGridObjectPose
from gridpush_drake.multibody.parser import AddPlantAndSceneGraph
from gridpush_drake.multibody.table_rim import RIM_SPACING, AddRimSpheres
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.weighing.plan import Edge
from gridpush_drake.planning.weighing.press import PressOptions, PressState, PressTarget
from gridpush_drake.pushes.weighings import ANGLE_STD, EDGE_STD, FORCE_STD, POSITION_STD
from gridpush_drake.systems.base.messages import PressCommand
from gridpush_drake.systems.execution.edge_presser import EdgePresser
from gridpush_drake.systems.sensing.contact_force_sensor import ContactForceSensor
from gridpush_drake.systems.sensing.pusher_state_sensor import PusherStateSensor

TIME_STEP = 2e-3
"""Time step of the plant, s."""

TABLE_SIZE = (1.0, 1.0, 0.1)
"""Sides of the table along x, y and z, m. Its edge is at x = 0, the table where x is less."""

TABLE_EDGE = Edge(point=(0.0, 0.0), angle=0.0)
"""The edge."""

RIM_HALF_LENGTH = 0.26
"""Distance from the edge's middle to which there are spheres, m."""

FINGER_MASS = 1.0
"""Mass of each of the finger's three bodies, kg."""

FINGER_STIFFNESS = 2000.0
"""Stiffness with which the finger is held, N/m: that of an arm under impedance control."""

FINGER_DAMPING = 60.0
"""Damping with which the finger is held, N s/m."""

TIP_RADIUS = 0.008
"""Radius of the finger's tip, m."""

FINGER_START = (0.05, 0.0)
"""Where the finger is at first, (x, y), W, m. It moves at the height at which it hovers."""

OFFSET_STD = 0.5
"""Standard deviation of the force sensor's offset, per axis, N."""

MAX_SEED = 2**31
"""Bound of the seed of the force sensor's noise."""

OBSERVATION_PERIOD = 0.1
"""Time between two looks at a press under way, s."""

MAX_PRESS_TIME = 60.0
"""Time after which a press that does not end is given up, s."""


@dataclass(frozen=True)
class TiltTestNoise:
    """How wrong a weighing world tells what it measures, as standard deviations.

    Attributes:
        force: of each sample of the force at the tip, per axis, N.
        offset: of the force's offset, per axis, N.
        edge: of where the edge is along its normal, m, drawn anew for each press.
        position: of the object's seen position, per axis, m.
        angle: of its seen heading, rad.
    """

    force: float = FORCE_STD
    offset: float = OFFSET_STD
    edge: float = EDGE_STD
    position: float = POSITION_STD
    angle: float = ANGLE_STD


NOISELESS = TiltTestNoise(force=0.0, offset=0.0, edge=0.0, position=0.0, angle=0.0)
"""No noise at all."""


@dataclass(frozen=True, eq=False)
class TiltTestRun:
    """What became of a press.

    Attributes:
        state: how it ended, as the robot knows it.
        target: where it pressed, as the robot knows it.
        max_tilt: greatest tilt that the object truly had, rad.
        moved: how far the object truly lies from where it lay, m.
        time: how long the press took, s.
    """

    state: PressState
    target: PressTarget
    max_tilt: float
    moved: float
    time: float


class TiltTestWorld:
    """An object on a table with an edge, which a finger presses.

    Attributes:
        obj: the object.
        params: its true masses and frictions.
        height: height of the object, m.
        options: how presses are made.
        noise: of what is measured.
    """

    def __init__(
        self,
        obj: GridObject,
        params: CellParameters,
        *,
        height: float = DEFAULT_HEIGHT,
        options: PressOptions | None = None,
        noise: TiltTestNoise | None = None,
        seed: int = 0,
        support: Feet | None = None,
        rim_gap: float = 0.0,
    ) -> None:
        """Builds the Diagram.

        Args:
            obj: the object.
            params: its true masses and frictions.
            height: height of the object, m.
            options: how presses are made.
            noise: of what is measured.
            seed: seed of all noise.
            support: on what the object stands; by default each cell bears its own weight.
            rim_gap: height of its underside above the table and its edge, m.
        """
        self.obj = obj
        self.params = params
        self.height = height
        self.options = options or PressOptions()
        self.noise = noise or TiltTestNoise()
        # Two objects with one seed are told apart, so that their errors are not the same.
        name = crc32(obj.name.encode())
        self._rng = np.random.default_rng((seed, 11, name))
        builder = DiagramBuilder()
        plant, scene_graph = AddPlantAndSceneGraph(builder, TIME_STEP)
        self._plant = plant
        x, y, z = TABLE_SIZE
        table = plant.RegisterCollisionGeometry(
            plant.world_body(),
            RigidTransform([-x / 2, 0.0, -z / 2]),
            Box(x, y, z),
            "table",
            MakePartnerProperties(),
        )
        count = round(2 * RIM_HALF_LENGTH / RIM_SPACING) + 1
        rim = np.linspace(-RIM_HALF_LENGTH, RIM_HALF_LENGTH, count)
        AddRimSpheres(plant, np.column_stack([np.zeros(count), rim]))
        self._finger = AddFinger(plant)
        self._handle = AddGridObject(
            plant,
            scene_graph,
            Model(obj, params),
            "free",
            table=[table],
            height=height,
            support=support,
            rim_gap=rim_gap,
        )
        plant.set_gravity_enabled(self._finger, False)
        plant.Finalize()
        tip = plant.GetBodyByName("tip", self._finger)
        # The finger presses beyond the edge, and is to meet nothing but the object.
        world = GeometrySet(plant.GetCollisionGeometriesForBody(plant.world_body()))
        own = GeometrySet(plant.GetCollisionGeometriesForBody(tip))
        scene_graph.collision_filter_manager().Apply(
            CollisionFilterDeclaration().ExcludeBetween(own, world)
        )

        presser = builder.AddSystem(EdgePresser(TIP_RADIUS, self.options))
        sensor = builder.AddSystem(PusherStateSensor(tip.index()))
        feeler = builder.AddSystem(
            ContactForceSensor(
                tip.index(), noise=self.noise.force, seed=int(self._rng.integers(MAX_SEED))
            )
        )
        builder.Connect(plant.get_body_poses_output_port(), sensor.GetInputPort("body_poses"))
        builder.Connect(
            plant.get_body_spatial_velocities_output_port(),
            sensor.GetInputPort("body_spatial_velocities"),
        )
        builder.Connect(
            plant.get_contact_results_output_port(), feeler.GetInputPort("contact_results")
        )
        builder.Connect(sensor.GetOutputPort("pusher_state"), presser.GetInputPort("pusher_state"))
        builder.Connect(feeler.GetOutputPort("force"), presser.GetInputPort("force"))
        builder.Connect(
            presser.GetOutputPort("tip_command"), plant.get_desired_state_input_port(self._finger)
        )
        builder.ExportInput(presser.GetInputPort("press_command"), "press_command")
        builder.ExportOutput(presser.GetOutputPort("press_status"), "press_status")
        self._feeler = feeler
        self._diagram = builder.Build()
        self._simulator = Simulator(self._diagram)
        self._presses = 0
        self._diagram.GetInputPort("press_command").FixValue(
            self._context, PressCommand().to_vector()
        )
        start = np.array([*FINGER_START, height + TIP_RADIUS + self.options.clearance])
        plant.SetPositions(self._plant_context, self._finger, start)

    @property
    def _context(self) -> Context:
        return self._simulator.get_mutable_context()

    @property
    def _plant_context(self) -> Context:
        return self._plant.GetMyMutableContextFromRoot(self._context)

    def put(self, pose: Array) -> None:
        """Puts the object down at rest at a pose (3,), m and rad, below the finger.

        Raises:
            PlanningError: the pose is not three finite numbers.
        """
        q = check_vector(PlanningError, "pose", pose, 3)
        SetGridObjectPose(self._plant, self._plant_context, self._handle, q)

    def observe(self) -> Array:
        """Looks at the object: (3,) q_WB with noise, m and rad."""
        std = (self.noise.position, self.noise.position, self.noise.angle)
        seen: Array = self.read_pose() + std * self._rng.standard_normal(3)
        return seen

    def read_pose(self) -> Array:
        """Reads where the object truly is, (3,) q_WB, m and rad; for judges only."""
        return CalcPlanarPose(self._plant, self._plant_context, self._handle)

    def read_tilt(self) -> float:
        """Reads how far the object is truly tilted, rad; for judges only."""
        X_WB = self._plant.EvalBodyPoseInWorld(self._plant_context, self._handle.body)
        return float(np.arccos(np.clip(X_WB.rotation().matrix()[2, 2], -1, 1)))

    def press(self, target: PressTarget) -> TiltTestRun:
        """Presses where the robot wants to, up to the first sign of tilt, and goes up again.

        Args:
            target: where to press, by the true edge. The robot's own idea of the edge is off by
                noise, and is in what is returned.
        """
        self._presses += 1
        before = self.read_pose()
        believed = draw_believed_target(target, self.noise, self._rng)
        edge_x, edge_y = believed.edge_point
        offset = self.noise.offset * self._rng.standard_normal(3)
        self._feeler.SetOffset(self._context, offset)
        command = PressCommand(
            self._presses,
            x=target.place[0],
            y=target.place[1],
            edge_x=edge_x,
            edge_y=edge_y,
            edge_angle=target.edge_angle,
            top=target.top,
            no_tip_force=target.no_tip_force,
        )
        port = self._diagram.GetInputPort("press_command")
        port.FixValue(self._context, command.to_vector())
        begin = self._context.get_time()
        status = self._diagram.GetOutputPort("press_status")
        tilt = self.read_tilt()
        state = PressState()
        while self._context.get_time() < begin + MAX_PRESS_TIME:
            self._simulator.AdvanceTo(self._context.get_time() + OBSERVATION_PERIOD)
            tilt = max(tilt, self.read_tilt())
            state = status.Eval(self._context)
            if state.over:
                break
        moved = float(np.linalg.norm(self.read_pose()[:2] - before[:2]))
        return TiltTestRun(
            state=state,
            target=believed,
            max_tilt=tilt,
            moved=moved,
            time=self._context.get_time() - begin,
        )

    def let_pass(self, time: float) -> None:
        """Lets time pass, s."""
        self._simulator.AdvanceTo(self._context.get_time() + time)


def draw_believed_target(
    target: PressTarget, noise: TiltTestNoise, rng: np.random.Generator
) -> PressTarget:
    """Draws where the robot believes the edge of a target to be, along its normal."""
    off = noise.edge * float(rng.standard_normal())
    x, y = (np.array(target.edge_point) + off * target.normal).tolist()
    return replace(target, edge_point=(x, y))


def AddFinger(plant: MultibodyPlant) -> ModelInstanceIndex:
    """Adds a sphere on three prismatic joints, x, y and z of the world, with PD gains.

    Returns:
        Its model instance; the desired state is x, y, z (m) and their rates (m/s).
    """
    instance = plant.AddModelInstance("finger")
    inertia = SpatialInertia.SolidSphereWithMass(FINGER_MASS, TIP_RADIUS)
    parent = plant.world_body()
    for name, body_name, axis in (
        ("x", "slide_x", [1, 0, 0]),
        ("y", "slide_y", [0, 1, 0]),
        ("z", "tip", [0, 0, 1]),
    ):
        body = plant.AddRigidBody(body_name, instance, inertia)
        joint = plant.AddJoint(
            PrismaticJoint(name, parent.body_frame(), body.body_frame(), np.array(axis))
        )
        gains = PdControllerGains(p=FINGER_STIFFNESS, d=FINGER_DAMPING)
        plant.AddJointActuator(name, joint).set_controller_gains(gains)
        parent = body
    plant.RegisterCollisionGeometry(
        parent, RigidTransform(), Sphere(TIP_RADIUS), "tip", MakePartnerProperties()
    )
    return instance
