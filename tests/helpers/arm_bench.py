"""The arm with its finger over a table, and an executor to whom a test gives commands."""

from dataclasses import dataclass, field

import numpy as np
from pydrake.geometry import Box, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from gridpush_drake.station.robot.arm import ArmReach, CalcStartPosture, MakeControlPlant
from gridpush_drake.station.robot.arm_driver import AddArmDriver, AddArmKinematics
from gridpush_drake.station.robot.robot import AddRobot, find_robot
from gridpush_drake.station.schema.scenario import PushScenario
from gridpush_drake.systems.base.messages import PushCommand
from gridpush_drake.systems.execution.push_executor import PushExecutor, PushTrajectoryOptions

ROBOT = find_robot(PushScenario().directives)

HOME = (0.6, 0.0, 0.2)
LONGEST = 60.0
"""s, of a push that never ends."""

TABLE_SIZE = (0.8, 1.2, 0.1)


@dataclass
class Record:
    """Rows of one time each."""

    time: list = field(default_factory=list)
    phase: list = field(default_factory=list)
    desired: list = field(default_factory=list)
    tip: list = field(default_factory=list)
    down: list = field(default_factory=list)
    q: list = field(default_factory=list)
    v: list = field(default_factory=list)
    torque: list = field(default_factory=list)
    contacts: set = field(default_factory=set)

    def array(self, name: str) -> np.ndarray:
        return np.array(getattr(self, name))


class ArmBench:
    """Arm, finger, table, driver, inverse kinematics and executor in one Diagram."""

    def __init__(
        self,
        time_step: float = 0.001,
        style: PushTrajectoryOptions | None = None,
        dress=None,
        reach: bool = True,
    ):
        self.control_plant = MakeControlPlant(ROBOT)
        self.q_start = CalcStartPosture(self.control_plant, ROBOT, HOME)
        self.reach = ArmReach(self.control_plant, ROBOT, self.q_start)
        builder = DiagramBuilder()
        self.plant, self.scene_graph = AddMultibodyPlantSceneGraph(builder, time_step)
        self.arm = AddRobot(self.plant, ROBOT)
        add_table(self.plant)
        if dress is not None:
            dress(self.plant)
        self.plant.Finalize()
        self.plant.SetDefaultPositions(self.arm.arm, self.q_start)
        self.driver = AddArmDriver(builder, self.plant, ROBOT, self.arm.arm, self.control_plant)
        self.kinematics = AddArmKinematics(builder, ROBOT, self.control_plant, self.q_start)
        builder.Connect(
            self.kinematics.GetOutputPort("joint_positions"), self.driver.GetInputPort("position")
        )
        self.executor = builder.AddNamedSystem(
            "executor", PushExecutor(HOME, reach=self.reach if reach else None, style=style)
        )
        builder.Connect(
            self.executor.GetOutputPort("tip_pose"), self.kinematics.GetInputPort("X_AE_desired")
        )
        builder.ExportInput(self.executor.GetInputPort("push_command"), "push_command")
        self.diagram = builder.Build()
        self.simulator = Simulator(self.diagram)
        self.start()

    def start(self) -> None:
        """Begins anew with the same Diagram and Context."""
        context = self.simulator.get_mutable_context()
        context.SetTime(0.0)
        self.diagram.SetDefaultContext(context)
        self.kinematics.SetPositions(
            self.kinematics.GetMyMutableContextFromRoot(context), self.q_start
        )
        self.command(PushCommand())
        self.simulator.Initialize()

    def command(self, command: PushCommand) -> None:
        context = self.simulator.get_mutable_context()
        self.diagram.GetInputPort("push_command").FixValue(context, command.to_vector())

    @property
    def status(self):
        context = self.executor.GetMyContextFromRoot(self.simulator.get_context())
        return self.executor.GetOutputPort("status").Eval(context)

    def record(self, every: float, until) -> Record:
        """Goes on, looking every so many seconds, until `until(status)`."""
        record = Record()
        while True:
            self.simulator.AdvanceTo(self.simulator.get_context().get_time() + every)
            self._note(record)
            if until(self.status) or len(record.time) * every > LONGEST:
                return record

    def push(self, command: PushCommand, every: float = 0.005) -> Record:
        """Carries a command out to the end, or lets it be refused."""
        self.command(command)
        return self.record(
            every, lambda status: status.command_id == command.command_id and status.ready
        )

    def _note(self, record: Record) -> None:
        root = self.simulator.get_context()
        plant_context = self.plant.GetMyContextFromRoot(root)
        executor_context = self.executor.GetMyContextFromRoot(root)
        X_WP = self.plant.GetFrameByName(ROBOT.finger.tip_frame).CalcPoseInWorld(plant_context)
        record.time.append(root.get_time())
        record.phase.append(self.status.phase)
        record.desired.append(
            self.executor.GetOutputPort("tip_pose").Eval(executor_context).translation().copy()
        )
        record.tip.append(X_WP.translation().copy())
        record.down.append(X_WP.rotation().matrix()[:, 2].copy())
        record.q.append(self.plant.GetPositions(plant_context, self.arm.arm))
        record.v.append(self.plant.GetVelocities(plant_context, self.arm.arm))
        record.torque.append(
            self.plant.get_net_actuation_output_port(self.arm.arm).Eval(plant_context)
        )
        results = self.plant.get_contact_results_output_port().Eval(plant_context)
        for i in range(results.num_point_pair_contacts()):
            info = results.point_pair_contact_info(i)
            names = (
                self.plant.get_body(info.bodyA_index()).name(),
                self.plant.get_body(info.bodyB_index()).name(),
            )
            record.contacts.add(tuple(sorted(names)))


def add_table(plant: MultibodyPlant) -> None:
    """A box whose top is z = 0, in front of the arm's foot."""
    X_WT = RigidTransform([0.2 + TABLE_SIZE[0] / 2, 0.0, -TABLE_SIZE[2] / 2])
    plant.RegisterCollisionGeometry(
        plant.world_body(), X_WT, Box(*TABLE_SIZE), "table", CoulombFriction(1.0, 1.0)
    )


def add_box(
    plant: MultibodyPlant, mass: float = 1.0, friction: float = 0.3, p_WB=(0.6, 0.0)
) -> None:
    """A box on four round feet, so that it slides and does not rock; `friction` is that of the pair with the table."""
    a, b, height, foot = 0.1, 0.2, 0.05, 0.005
    inertia = SpatialInertia.SolidBoxWithMass(mass, a, b, height)
    body = plant.AddRigidBody("box", plant.AddModelInstance("box"), inertia)
    own = CoulombFriction(friction / (2.0 - friction), friction / (2.0 - friction))
    plant.RegisterCollisionGeometry(
        body, RigidTransform(), Box(a, b, height - 2 * foot), "side", own
    )
    for x in (-a / 2 + foot, a / 2 - foot):
        for y in (-b / 2 + foot, b / 2 - foot):
            X_BF = RigidTransform([x, y, -height / 2 + foot])
            plant.RegisterCollisionGeometry(body, X_BF, Sphere(foot), f"foot_{x:.3f}_{y:.3f}", own)
    plant.SetDefaultFloatingBaseBodyPose(body, RigidTransform([*p_WB, height / 2]))
