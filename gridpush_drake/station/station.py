"""`Station`: what tasks need of a robot with an object on a table, simulated or real; and what commands the robot.

`AddRobotControl` puts into a Diagram all that knows nothing of whether the robot is real: the
executors of pushes and grasps, the inverse kinematics and the identifier. What it asks for is where
the tip and the object are; what it gives is where the arm's joints and the gripper should be.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from pydrake.multibody.inverse_kinematics import DifferentialInverseKinematicsIntegrator
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, OutputPort
from pydrake.systems.primitives import LogVectorOutput
from shapely import Polygon
from shapely.geometry.base import BaseGeometry

from gridpush_drake.errors import ScenarioError, StationError
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.multibody.weak_calc import NO_SLOTS
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.perception.sight import Sight
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.pushes.segmentation import RecordOptions, Sample
from gridpush_drake.pushes.stream import make_samples
from gridpush_drake.station.arm import (
    AddArmKinematics,
    ArmReach,
)
from gridpush_drake.station.camera import FoundObject, calc_pose_age
from gridpush_drake.station.grasping import (
    AddGraspExecutor,
    AddPusherGate,
    ExportGrasping,
    ExportOutputs,
    make_grasp_trajectory_options,
)
from gridpush_drake.station.others import OtherObject, leave_out
from gridpush_drake.station.resolve import ResolvedScenario
from gridpush_drake.station.robot import Robot
from gridpush_drake.station.scenario import PushScenario
from gridpush_drake.station.scene import CalcBasePose, CalcTipReach
from gridpush_drake.systems.grasp_executor import GraspExecutor
from gridpush_drake.systems.grid_identifier import GridIdentifier
from gridpush_drake.systems.messages import GraspCommand, PushCommand
from gridpush_drake.systems.push_executor import PushExecutor, PushTrajectoryOptions, plan_push

ESTIMATE_OUTPUTS = (
    "mass",
    "friction",
    "mass_std",
    "friction_std",
    "contact_friction",
    "center_of_mass",
    "center_of_mass_covariance",
    "loss",
    "num_pushes",
    "identification",
    "push_log",
    "message",
    "age",
)
"""Of the identifier, exported as `estimate.mass` and so on."""


@dataclass(frozen=True)
class Learning:
    """What the station's identifier learns from.

    Attributes:
        max_pushes: the first so many; None for no limit.
    """

    max_pushes: int | None = None


EDGE_DETAIL = 5e-4
"""m by which the edge may be simplified: of a round table to a polygon of few corners."""


def make_surface(table_top: BaseGeometry) -> SupportSurface:
    """The table's top as planners know it. Raises ScenarioError where it is in several pieces."""
    if not isinstance(table_top, Polygon):
        raise ScenarioError("directives: the table's top is in several pieces; expected one")
    return SupportSurface(shapely.simplify(table_top, EDGE_DETAIL))


def make_identifier(
    scenario: PushScenario, obj: GridObject, table_top: BaseGeometry, learning: Learning | None
) -> GridIdentifier:
    """The station's identifier: it knows the table's edge, and learns from the first `scenario.pokes.count` pushes."""
    learning = learning or Learning(scenario.pokes.count)
    return GridIdentifier(
        obj,
        period=1 / scenario.camera.rate,
        engaged_below=scenario.object_height,
        pusher_radius=obj.prior.pusher_radius,
        max_learning_pushes=learning.max_pushes,
        table=make_surface(table_top).corners if isinstance(table_top, Polygon) else None,
        # A warm start gains little. Without it `gridpush identify` finds the same from the log, bit
        # for bit on the same machine (another processor may take other BLAS kernels).
        warm_start=False,
        record=RecordOptions(pose_delay=calc_pose_age(scenario.camera)),
        answer_delay=scenario.simulation.answer_delay,
    )


PUSHER_LOG, POSE_LOG = "pusher_log", "pose_log"
"""Names of the systems that log what the identifier sees."""


def AddLogs(builder: DiagramBuilder, ports: dict[str, OutputPort], period: float) -> None:
    """Logs ports when the identifier looks: Drake publishes what was before the updates of the same time.

    Args:
        builder: the ports' systems are in it.
        ports: by the logs' names.
        period: s.
    """
    for name, port in ports.items():
        LogVectorOutput(port, builder, period).set_name(name)


def make_style(scenario: PushScenario, robot: Robot) -> PushTrajectoryOptions:
    """How the scenario's finger pushes."""
    finger = scenario.finger
    return PushTrajectoryOptions(
        travel_height=finger.travel_height,
        push_height=finger.push_height,
        tip_radius=robot.finger.tip_radius,
    )


@dataclass(frozen=True, eq=False)
class Setting:
    """What is known of a robot and what is before it, whether it is simulated or real.

    Attributes:
        scenario: what it was made from; with a color and depth camera, pose and height of the
            object are as seen.
        obj: the object, as the robot knows it.
        found: it in the photograph; None where the robot is told the object.
        others: further objects on the table.
        plant: the scene, finalised; of a real robot it is only asked for measures.
        control_plant: the robot alone, as `MakeControlPlant` makes it.
        robot: the robot's measures.
        table_top: where on it things may lie, a polygon in W, m.
        home: p_WP of the tip at the beginning, m.
        q_start: (n,) the arm's posture there, to which it is drawn, rad.
    """

    scenario: PushScenario
    obj: GridObject
    found: FoundObject | None
    others: tuple[OtherObject, ...]
    plant: MultibodyPlant
    control_plant: MultibodyPlant
    robot: Robot
    table_top: BaseGeometry
    home: tuple[float, float, float]
    q_start: Array


def MakeSetting(
    resolved: ResolvedScenario,
    scenario: PushScenario,
    plant: MultibodyPlant,
    found: FoundObject | None = None,
    others: tuple[OtherObject, ...] = (),
) -> Setting:
    """Makes a setting of a resolved scenario, with the arm at its home; see `Setting`.

    Args:
        resolved: what is known of robot, object and table.
        scenario: the resolved one, or a copy in which pose and height of the object are as seen.
        plant: the scene, finalised.
        found: the object in the photograph; None where the robot is told the object.
        others: further objects in the plant.
    """
    return Setting(
        scenario=scenario,
        obj=resolved.obj if found is None else found.obj,
        found=found,
        others=others,
        plant=plant,
        control_plant=resolved.control_plant,
        robot=resolved.robot,
        table_top=resolved.table_top,
        home=resolved.home,
        q_start=resolved.q_start,
    )


def find_lookouts(setting: Setting) -> Array:
    """Where the tip goes (3, 3), p_WP, m, while the arm may hide the object from a camera.

    They are its home and, as high, the two corners of the workspace that are nearest to the robot's
    base: of what lies behind one of them, seen from the camera, another shows something.
    """
    workspace, (_, _, z) = setting.scenario.workspace, setting.home
    p_WR = CalcBasePose(setting.plant, setting.robot).translation()
    corners = np.array([(x, y, z) for x in workspace.x for y in workspace.y])
    nearest = np.argsort(np.linalg.norm(corners[:, :2] - p_WR[:2], axis=1), kind="stable")[:2]
    return np.vstack([setting.home, corners[nearest]])


@dataclass(frozen=True, eq=False)
class RobotControl:
    """What `AddRobotControl` put into a builder.

    Attributes:
        executor: carries out pushes.
        grasping: carries out grasps; None where the scene has no gripper.
        kinematics: the differential inverse kinematics; its `joint_positions` are for the arm.
        identifier: learns the object.
        reach: of the arm.
    """

    executor: PushExecutor
    grasping: GraspExecutor | None
    kinematics: DifferentialInverseKinematicsIntegrator
    identifier: GridIdentifier
    reach: ArmReach


def AddRobotControl(
    builder: DiagramBuilder,
    setting: Setting,
    learning: Learning | None,
    pusher_state: OutputPort,
    object_pose: OutputPort,
    gripper_state: OutputPort | None,
    logged: dict[str, OutputPort] | None = None,
) -> RobotControl:
    """Adds what commands the robot and learns the object, connects it, and exports its ports and those it reads.

    Args:
        builder: the ports' systems are in it.
        setting: robot and scene.
        learning: what is learned from; the first `scenario.pokes.count` pushes by default.
        pusher_state: (6,) p_WP, m, and v_WP, m/s, of the tip.
        object_pose: (3,) as the camera sees it, m and rad.
        gripper_state: (4,) see `Station`; None where there is no gripper.
        logged: what else is logged when the identifier looks, by the logs' names.

    Returns:
        The systems.
    """
    scenario, robot, control_plant = setting.scenario, setting.robot, setting.control_plant
    kinematics = AddArmKinematics(builder, robot, control_plant, setting.q_start)
    reach, style = ArmReach(control_plant, robot, setting.q_start), make_style(scenario, robot)
    lookouts = () if scenario.camera.kind == "ideal" else find_lookouts(setting)
    executor = builder.AddNamedSystem(
        "executor", PushExecutor(setting.home, setting.obj.outline, reach, style, lookouts)
    )
    identifier = builder.AddNamedSystem(
        "identifier", make_identifier(scenario, setting.obj, setting.table_top, learning)
    )
    grasping, seen = None, pusher_state
    if robot.gripper is not None and gripper_state is not None:
        grasp_style = make_grasp_trajectory_options(
            scenario, control_plant, robot.gripper, robot.finger.tip_frame
        )
        grasping = AddGraspExecutor(
            builder, robot.gripper, executor, reach, setting.table_top, grasp_style
        )
        builder.Connect(gripper_state, grasping.GetInputPort("gripper_state"))
        ExportGrasping(builder, gripper_state, grasping)
        seen = AddPusherGate(builder, pusher_state, grasping).GetOutputPort("pusher_state")
    desired = executor if grasping is None else grasping
    builder.Connect(desired.GetOutputPort("tip_pose"), kinematics.GetInputPort("X_AE_desired"))
    for consumer in (executor, identifier):
        builder.Connect(object_pose, consumer.GetInputPort("object_pose"))
    builder.Connect(seen, identifier.GetInputPort("pusher_state"))
    AddLogs(
        builder,
        {PUSHER_LOG: seen, POSE_LOG: object_pose} | (logged or {}),
        1 / scenario.camera.rate,
    )
    builder.ExportInput(executor.GetInputPort("push_command"), "push_command")
    ExportOutputs(builder, executor, "executor", ("status",))
    ExportOutputs(builder, desired, "executor", ("tip_pose",))
    builder.ExportOutput(pusher_state, "pusher.state")
    builder.ExportOutput(object_pose, "object.pose")
    ExportOutputs(builder, identifier, "estimate", ESTIMATE_OUTPUTS)
    return RobotControl(executor, grasping, kinematics, identifier, reach)


StationMaker = Callable[..., "Station"]
"""Makes a station of a scenario, a Meshcat or None, and `show_object` and `learning` by name; see
`MakePushStation`."""


class Station(Diagram):
    """A robot with an object on a table, as tasks need it: `PushStation` is simulated, `HardwareStation` is real.

    .. pydrake_system::

        name: Station
        input_ports:
        - push_command
        - grasp_command
        output_ports:
        - executor.status
        - executor.tip_pose
        - pusher.state
        - object.pose
        - estimate.mass
        - estimate.friction
        - ...
        - iiwa.position_measured
        - ...
        - grasp.status
        - gripper.state

    - ``push_command``: (6,) see `PushCommand`.
    - ``executor.status``: abstract `PushStatus`; ``executor.tip_pose``: abstract `RigidTransform`,
      X_WP desired.
    - ``pusher.state``: (6,) p_WP, m, and v_WP, m/s, of the tip's center, from the joints.
    - ``object.pose``: (3,) as the camera sees it, m and rad.
    - ``estimate.*``: see `GridIdentifier`; ``iiwa.*``: see Drake's `SimIiwaDriver`.
      Another arm's ports have the name that the scene gives to its model: ``panda.*``.
    - Where the scene has a gripper: ``grasp_command``: (6,) see `GraspCommand`, need not be
      connected; ``grasp.status``: abstract `GraspStatus`; ``gripper.state``: (4,) the fingers'
      positions, left and right, m, and velocities, m/s. ``executor.tip_pose`` is then what push and
      grasp executor together desire.

    Attributes:
        scenario, obj, found, others, plant, robot, table_top, home: see `Setting`.
        truth: what the object really weighs and how it rubs in a fresh Context; None where nobody
            knows.
        style: how the executor pushes.
    """

    __slots__ = NO_SLOTS

    def __init__(
        self,
        builder: DiagramBuilder,
        setting: Setting,
        control: RobotControl,
        truth: CellParameters | None,
    ) -> None:
        """Takes over a builder's systems."""
        super().__init__()
        self.scenario, self.obj, self.found, self.others = (
            setting.scenario, setting.obj, setting.found, setting.others,
        )  # fmt: skip
        self.plant, self.robot, self.table_top, self.home = (
            setting.plant, setting.robot, setting.table_top, setting.home,
        )  # fmt: skip
        self.truth, self.style = truth, control.executor.style
        self.reach, self._grasping = control.reach, control.grasping
        builder.BuildInto(self)

    def FindObstacle(self, command: PushCommand) -> str | None:
        """Says why the arm cannot carry out a push, come from its home; None where it can."""
        return plan_push(command, self.home, self.style, self.reach)[1]

    def FindGraspObstacle(self, command: GraspCommand) -> str | None:
        """Says why the arm cannot carry out a grasp, come from its home; None where it can.

        Raises:
            StationError: the scene has no gripper.
        """
        if self._grasping is None:
            raise StationError("the scene has no gripper; expected a model named gripper")
        return self._grasping.plan(command, (*self.home, 0.0))[1] or None

    def SetStart(self, root_context: Context, seed: int | None = None) -> None:
        """Makes a fresh Context ready to begin.

        Args:
            root_context: of the station, or of the Diagram it is part of.
            seed: of everything random, instead of the scenario's.
        """
        raise NotImplementedError

    def GetTruth(self, root_context: Context) -> CellParameters | None:
        """What the object really weighs and how it rubs in a Context; None where nobody knows."""
        return None

    def FindStream(self, root_context: Context) -> list[Sample]:
        """All that the identifier has seen in a Context: the stream that its pushes were cut from.

        Args:
            root_context: of the station, or of the Diagram it is part of.
        """
        t, tip = self._find_log(root_context, PUSHER_LOG)
        return make_samples(t, tip[:, :3], tip[:, 3:], self._find_log(root_context, POSE_LOG)[1])

    def FindSight(self, root_context: Context) -> Sight | None:
        """What a color and depth camera saw in a Context, and how far off that was; None where nobody knows."""
        return None

    def _find_log(
        self, root_context: Context, name: str
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Times (K,), s, and values (K, d). The logs are no attributes: they would keep the station alive for good."""
        log = self.GetSubsystemByName(name).FindLog(root_context)
        return log.sample_times(), log.data().T


RING_SEGMENTS = 32
"""A quarter turn, of the polygon for a ring."""


def MakeFingerRegion(station: Station, inset: float = 0.0) -> BaseGeometry:
    """Makes the region in which the tip's center may be while it pushes.

    Args:
        station: the station.
        inset: least distance from the region's edge, m.

    Returns:
        The region, W, m: where the arm reaches, and in it the workspace, without the places where
        the tip would touch another object; it may be empty.
    """
    workspace, height = station.scenario.workspace, station.scenario.finger.push_height
    box = shapely.box(workspace.x[0], workspace.y[0], workspace.x[1], workspace.y[1])
    if station.robot.arm.reach is None:
        region = station.reach.find_region(box.bounds, height).buffer(-inset)
    else:
        axis, least, greatest = CalcTipReach(station.plant, station.robot, height)
        region = MakeRing(axis, least + inset, greatest - inset) & box.buffer(-inset)
    return leave_out(region, station.others, station.robot.finger.tip_radius + inset)


def MakeRing(axis: NDArray[np.float64], least: float, greatest: float) -> shapely.Polygon:
    """The places about the robot's axis (2,) between two distances, m."""
    outer, inner = (
        shapely.Point(axis).buffer(radius, RING_SEGMENTS) for radius in (greatest, least)
    )
    return outer - inner
