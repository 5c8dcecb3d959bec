"""`Station`: what tasks need of a robot with an object on a table, whether simulated or real.

`AddRobotControl` adds the part of a station that is the same for both: the executors of pushes and
grasps, the inverse kinematics and the identifier. Its inputs say where the tip and the object are;
its outputs say where the arm's joints and the gripper should be. What a station knows of robot and
table is in `station.setting`, and where its finger may be in `station.finger_region`. The simulated
station is in `station.push_station`, the real one in `station.lcm.hardware_station`.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import shapely
from numpy.typing import NDArray
from pydrake.multibody.inverse_kinematics import DifferentialInverseKinematicsIntegrator
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, OutputPort
from pydrake.systems.primitives import LogVectorOutput
from shapely import Polygon
from shapely.geometry.base import BaseGeometry

from gridpush_drake.errors import ScenarioError, StationError
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.result import Identification
from gridpush_drake.multibody.weak_calc import NO_SLOTS
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.perception.sight import Sight
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.pushes.segmentation import RecordOptions, Sample
from gridpush_drake.pushes.stream import make_samples
from gridpush_drake.station.arm import ArmReach
from gridpush_drake.station.arm_driver import AddArmKinematics
from gridpush_drake.station.camera import calc_pose_age
from gridpush_drake.station.finger_region import REGION_SLACK, make_steer_region
from gridpush_drake.station.grasping import (
    AddGraspExecutor,
    AddPusherGate,
    ExportGrasping,
    ExportOutputs,
    make_grasp_trajectory_options,
)
from gridpush_drake.station.scenario import PushScenario
from gridpush_drake.station.setting import Setting, find_lookouts, make_style
from gridpush_drake.systems.grasp_executor import GraspExecutor
from gridpush_drake.systems.grid_identifier import GridIdentifier
from gridpush_drake.systems.lift_scale import LiftOptions, LiftScale
from gridpush_drake.systems.messages import GraspCommand, PressCommand, PushCommand
from gridpush_drake.systems.object_pose_estimator import ObjectPoseEstimator
from gridpush_drake.systems.objects_pose_estimator import ObjectsPoseEstimator
from gridpush_drake.systems.press_executor import ARM_PRESS, PressExecutor
from gridpush_drake.systems.push_executor import PushExecutor, PushTrajectoryOptions, plan_push
from gridpush_drake.systems.steer_executor import SteerExecutor, SteerOptions

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
"""Output ports of the identifier that the station exports, as `estimate.mass` and so on."""


@dataclass(frozen=True)
class Learning:
    """Which pushes the station's identifier learns from.

    Attributes:
        max_pushes: it learns from the first pushes, this many; None for all.
    """

    max_pushes: int | None = None


EDGE_DETAIL = 5e-4
"""Distance by which the table's edge may be simplified, m. A round table becomes a polygon of few
corners."""


def make_surface(table_top: BaseGeometry) -> SupportSurface:
    """Makes the surface that planners know from the table's top, a polygon in W, m.

    Raises:
        ScenarioError: the table's top is in several pieces.
    """
    if not isinstance(table_top, Polygon):
        raise ScenarioError("directives: the table's top is in several pieces; expected one")
    return SupportSurface(shapely.simplify(table_top, EDGE_DETAIL))


def make_identifier(
    scenario: PushScenario, obj: GridObject, table_top: BaseGeometry, learning: Learning | None
) -> GridIdentifier:
    """Makes the system that learns the object, which also knows the table's edge.

    Args:
        scenario: the scenario, with the camera's rate and delay.
        obj: the object, as the robot knows it.
        table_top: the table's top, a polygon in W, m.
        learning: which pushes are learned from; None for the first `scenario.pokes.count`.
    """
    learning = learning or Learning(max_pushes=scenario.pokes.count)
    return GridIdentifier(
        obj,
        period=1 / scenario.camera.rate,
        # A tip that is lower than the object's top may touch it.
        engaged_below=scenario.object_height,
        pusher_radius=obj.prior.pusher_radius,
        max_learning_pushes=learning.max_pushes,
        table=make_surface(table_top).corners if isinstance(table_top, Polygon) else None,
        # A warm start saves little time. Without it `gridpush identify` finds the same parameters
        # from the written log, bit for bit on the same computer (on another processor NumPy may
        # take other BLAS kernels).
        warm_start=False,
        record=RecordOptions(pose_delay=calc_pose_age(scenario.camera)),
        answer_delay=scenario.simulation.answer_delay,
    )


PUSHER_LOG = "pusher_log"
POSE_LOG = "pose_log"
"""Names of the systems that log the tip's state and the object's pose, as learned from."""


def AddLogs(builder: DiagramBuilder, ports: dict[str, OutputPort], period: float) -> None:
    """Logs ports at the times at which the identifier reads them.

    With the same period the logs hold exactly what the identifier has read: at each of these times
    Drake publishes to the logs before it updates any discrete state.

    Args:
        builder: the builder that has the ports' systems.
        ports: the ports to be logged, by the names of their logs.
        period: period of the identifier, s.
    """
    for name, port in ports.items():
        LogVectorOutput(port, builder, period).set_name(name)


@dataclass(frozen=True, eq=False)
class FeltLoad:
    """The ports that tell what an arm feels, for a station that weighs; see `ArmLoadSensor`.

    Attributes:
        tip_force: (3,) force on the finger's tip in W, N.
        smooth_tip_force: (3,) a running average of it, N.
        grasp_wrench: (6,) torque about the grasp point, N m, above force, N, on the gripper in W.
    """

    tip_force: OutputPort
    smooth_tip_force: OutputPort
    grasp_wrench: OutputPort


FORCE_SHARE = 0.5
"""Share of the scenario's greatest force at which a steered finger goes up by itself. The rest is
for its braking."""

PRESS_SHARE = 0.8
"""Greatest force of a press, as a share of the force at which a real arm is stopped."""


@dataclass(frozen=True, eq=False)
class RobotControl:
    """The systems that `AddRobotControl` put into a builder.

    Attributes:
        executor: carries out pushes.
        grasping: carries out grasps; None if the scene has no gripper.
        pressing: carries out presses at the table's edge; None if nothing is weighed.
        kinematics: the differential inverse kinematics. Its port `joint_positions` commands the
            arm.
        identifier: learns the object.
        reach: says whether the arm can follow a path.
    """

    executor: PushExecutor
    grasping: GraspExecutor | None
    pressing: PressExecutor | None
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
    tip_bounds: Callable[[Array], str | None] | None = None,
    load: FeltLoad | None = None,
    tip_force: OutputPort | None = None,
    all_seen: OutputPort | None = None,
) -> RobotControl:
    """Adds the systems that command the robot and learn the object, and connects them.

    The ports that these systems share with the outside, and the three ports given, become ports of
    the station; see `Station` for their names.

    Args:
        builder: the builder that has the ports' systems.
        setting: robot and scene.
        learning: which pushes are learned from; None for the first `scenario.pokes.count`.
        pusher_state: (6,) p_WP, m, and v_WP, m/s, of the tip.
        object_pose: (3,) X_WB of the object as the camera sees it, m and rad.
        gripper_state: (4,) state of the gripper's fingers, see `Station`; None without a gripper.
        logged: further ports to be logged whenever the identifier reads, by the logs' names.
        tip_bounds: says why a path may not lead the tip to a place, see `ArmReach`; None where it
            may go wherever the arm reaches.
        load: what the arm feels; None where nothing is weighed.
        tip_force: (3,) force on the tip in W, N, where the finger can be steered by its velocity;
            None where it cannot.
        all_seen: (3,) the same as `object_pose`, but NaN while any other object of the task is not
            seen, so that the executor waits, and looks out, for all of them; None where there is
            only the one.

    Returns:
        The systems that were added.
    """
    scenario = setting.scenario
    robot = setting.robot
    control_plant = setting.control_plant

    # From a command to joint positions: the executor of pushes, then the inverse kinematics.
    kinematics = AddArmKinematics(builder, robot, control_plant, setting.q_start)
    reach = ArmReach(control_plant, robot, setting.q_start, tip_bounds)
    style = make_style(scenario, robot)
    # Only pictures can be covered by the arm; an ideal camera always sees the object.
    lookouts = () if scenario.camera.kind == "ideal" else find_lookouts(setting)
    executor = builder.AddNamedSystem(
        "executor", PushExecutor(setting.home, setting.obj.outline, reach, style, lookouts)
    )
    identifier = builder.AddNamedSystem(
        "identifier", make_identifier(scenario, setting.obj, setting.table_top, learning)
    )

    # With a gripper the executor of grasps stands between the executor of pushes and the arm, and a
    # gate keeps the tip's motions in a grasp from the identifier.
    grasping = None
    learned_state = pusher_state
    if robot.gripper is not None and gripper_state is not None:
        grasp_style = make_grasp_trajectory_options(
            scenario, control_plant, robot.gripper, robot.finger.tip_frame
        )
        grasping = AddGraspExecutor(
            builder, robot.gripper, executor, reach, setting.table_top, grasp_style
        )
        builder.Connect(gripper_state, grasping.GetInputPort("gripper_state"))
        ExportGrasping(builder, gripper_state, grasping)
        gate = AddPusherGate(builder, pusher_state, grasping)
        learned_state = gate.GetOutputPort("pusher_state")
    commander = executor if grasping is None else grasping

    # If the object is weighed, the executor of presses comes last, and what it and the gripper feel
    # goes to the identifier.
    pressing = None
    if load is not None:
        pressing = _add_weighing(
            builder,
            setting,
            load,
            pusher_state=pusher_state,
            object_pose=object_pose,
            executor=executor,
            grasping=grasping,
            identifier=identifier,
            style=style,
            reach=reach,
        )
        if grasping is not None:
            builder.Connect(pressing.GetOutputPort("status"), gate.GetInputPort("press_status"))
        commander = pressing
    if tip_force is not None:
        commander = _AddSteerExecutor(
            builder, setting, executor, commander=commander, reach=reach, tip_force=tip_force
        )
    builder.Connect(commander.GetOutputPort("tip_pose"), kinematics.GetInputPort("X_AE_desired"))

    # Where tip and object are goes to whoever needs it, and into the logs.
    builder.Connect(all_seen or object_pose, executor.GetInputPort("object_pose"))
    builder.Connect(object_pose, identifier.GetInputPort("object_pose"))
    watcher = object_pose.get_system()
    if isinstance(watcher, ObjectPoseEstimator | ObjectsPoseEstimator):
        # A camera is told where pushes take what the arm hides from it.
        if watcher.HasInputPort("pusher_state"):
            builder.Connect(learned_state, watcher.GetInputPort("pusher_state"))
        for name in ("mass", "friction", "contact_friction"):
            if watcher.HasInputPort(name):
                builder.Connect(identifier.GetOutputPort(name), watcher.GetInputPort(name))
    builder.Connect(learned_state, identifier.GetInputPort("pusher_state"))
    logs = {PUSHER_LOG: learned_state, POSE_LOG: object_pose} | (logged or {})
    AddLogs(builder, logs, 1 / scenario.camera.rate)

    # The station's ports.
    builder.ExportInput(executor.GetInputPort("push_command"), "push_command")
    ExportOutputs(builder, executor, "executor", ("status",))
    ExportOutputs(builder, commander, "executor", ("tip_pose",))
    builder.ExportOutput(pusher_state, "pusher.state")
    builder.ExportOutput(object_pose, "object.pose")
    ExportOutputs(builder, identifier, "estimate", ESTIMATE_OUTPUTS)
    return RobotControl(
        executor=executor,
        grasping=grasping,
        pressing=pressing,
        kinematics=kinematics,
        identifier=identifier,
        reach=reach,
    )


def _add_weighing(
    builder: DiagramBuilder,
    setting: Setting,
    load: FeltLoad,
    *,
    pusher_state: OutputPort,
    object_pose: OutputPort,
    executor: PushExecutor,
    grasping: GraspExecutor | None,
    identifier: GridIdentifier,
    style: PushTrajectoryOptions,
    reach: ArmReach,
) -> PressExecutor:
    """Adds what presses at the table's edge and weighs what is lifted, and exports its ports.

    Args:
        builder: the builder that has the other systems.
        setting: robot and scene.
        load: what the arm feels.
        pusher_state: (6,) p_WP, m, and v_WP, m/s, of the tip.
        object_pose: (3,) X_WB of the object as the camera sees it, m and rad.
        executor: carries out pushes.
        grasping: carries out grasps; None if the scene has no gripper.
        identifier: learns the object, by weighings, too.
        style: heights and speeds of the tip's way through the air.
        reach: says whether the arm can follow a path.

    Returns:
        The executor of presses, which leads the arm from now on.
    """
    scenario = setting.scenario
    options = replace(ARM_PRESS, max_force=PRESS_SHARE * scenario.safety.force)
    pressing: PressExecutor = builder.AddNamedSystem(
        "press_executor", PressExecutor(setting.obj, reach, style, options)
    )
    before = executor if grasping is None else grasping
    builder.Connect(before.GetOutputPort("tip_pose"), pressing.GetInputPort("other_tip_pose"))
    builder.Connect(executor.GetOutputPort("status"), pressing.GetInputPort("push_status"))
    builder.Connect(object_pose, pressing.GetInputPort("object_pose"))
    builder.Connect(pusher_state, pressing.GetInputPort("pusher_state"))
    builder.Connect(load.tip_force, pressing.GetInputPort("force"))
    builder.Connect(load.smooth_tip_force, identifier.GetInputPort("force"))
    builder.Connect(pressing.GetOutputPort("status"), executor.GetInputPort("press_status"))
    builder.ExportInput(pressing.GetInputPort("press_command"), "press_command")
    ExportOutputs(builder, pressing, "press", ("status",))
    weighings = pressing.GetOutputPort("weighing_log")

    # The gripper weighs what it lifts.
    if grasping is not None:
        builder.Connect(grasping.GetOutputPort("status"), pressing.GetInputPort("grasp_status"))
        scale = builder.AddNamedSystem(
            "lift_scale", LiftScale(LiftOptions.of_hold(scenario.pregrasp.hold))
        )
        builder.Connect(weighings, scale.GetInputPort("weighing_log"))
        builder.Connect(grasping.GetOutputPort("status"), scale.GetInputPort("grasp_status"))
        builder.Connect(load.grasp_wrench, scale.GetInputPort("grasp_wrench"))
        builder.ConnectInput("grasp_command", scale.GetInputPort("grasp_command"))
        builder.Connect(object_pose, scale.GetInputPort("object_pose"))
        weighings = scale.GetOutputPort("weighing_log")
    builder.Connect(weighings, identifier.GetInputPort("weighing_log"))
    builder.ExportOutput(weighings, "weighing.log")
    return pressing


def _AddSteerExecutor(
    builder: DiagramBuilder,
    setting: Setting,
    executor: PushExecutor,
    commander: PushExecutor | GraspExecutor | PressExecutor,
    reach: ArmReach,
    tip_force: OutputPort,
) -> SteerExecutor:
    """Adds the executor of steering behind the other executors, and exports its ports.

    Args:
        builder: the builder that has the other executors.
        setting: robot and scene.
        executor: the executor of pushes.
        commander: the executor whose tip pose is passed on while nobody steers.
        reach: says whether the arm can follow a path.
        tip_force: (3,) force on the tip in W, N.
    """
    scenario = setting.scenario
    follow = scenario.follow
    region = make_steer_region(setting, reach)
    style = SteerOptions(
        travel_height=scenario.finger.travel_height,
        push_height=scenario.finger.push_height,
        max_speed=max(follow.finger_speed, follow.walking_speed),
        max_force=FORCE_SHARE * scenario.safety.force,
    )
    # The follower keeps to the same region by a grid of places, which is a little less exact.
    steering: SteerExecutor = builder.AddNamedSystem(
        "steer_executor", SteerExecutor(region.buffer(REGION_SLACK), reach, style)
    )
    builder.Connect(commander.GetOutputPort("tip_pose"), steering.GetInputPort("passed_tip_pose"))
    builder.Connect(executor.GetOutputPort("status"), steering.GetInputPort("push_status"))
    builder.Connect(steering.GetOutputPort("status"), executor.GetInputPort("steer_status"))
    builder.Connect(tip_force, steering.GetInputPort("tip_force"))
    builder.ExportInput(steering.GetInputPort("steer_command"), "steer_command")
    ExportOutputs(builder, steering, "steer", ("status",))
    return steering


StationMaker = Callable[..., "Station"]
"""A function that makes a station of a scenario and a Meshcat (or None), with `show_object`,
`learning`, `steered` and `several` by keyword, as `MakePushStation` does."""


class Station(Diagram):
    """A robot with an object on a table, as tasks need it.

    `PushStation` is a simulated one, `HardwareStation` a real one.

    .. pydrake_system::

        name: Station
        input_ports:
        - push_command
        - grasp_command
        - press_command
        - steer_command
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
        - steer.status
        - grasp.status
        - grasp.gripper_position
        - gripper.state
        - press.status
        - weighing.log

    - ``push_command``: vector of 6, a push, see `PushCommand`.
    - ``grasp_command``: vector of 6, a grasp, see `GraspCommand`; it need not be connected. The
      station has this port, the ports of ``grasp`` and ``gripper.state`` only with a gripper.
    - ``press_command``: vector of 11, a press at the table's edge, see `PressCommand`; it need not
      be connected. The station has this port, ``press.status`` and ``weighing.log`` only if nothing
      is told of the object (`PushScenario.nothing_told`).
    - ``steer_command``: vector of 5, a finger that is steered, see `SteerCommand`. The station has
      this port and ``steer.status`` only if it is made with `steered`.
    - ``executor.status``: abstract `PushStatus`, how the executor of pushes stands.
    - ``executor.tip_pose``: abstract `RigidTransform`, desired X_WP of the tip, whether in a push,
      in a grasp or steered.
    - ``pusher.state``: vector of 6, p_WP, m, and v_WP, m/s, of the tip's center, calculated from
      the arm's joints.
    - ``object.pose``: vector of 3, X_WB as the camera sees it, (x, y, theta), m and rad; NaN while
      the object is not seen.
    - ``estimate.mass`` and the other ports of the estimate: see `GridIdentifier`.
    - ``iiwa.position_measured`` and the other ports of the arm: see Drake's `SimIiwaDriver`. They
      begin with the name that the scene gives to the arm's model, which may be ``panda``.
    - ``steer.status``: abstract `SteerStatus`, how the executor of steering stands.
    - ``grasp.status``: abstract `GraspStatus`, how the executor of grasps stands.
    - ``grasp.gripper_position``: vector of 1, the opening that the gripper is asked for, m.
    - ``gripper.state``: vector of 4, positions of the left and right finger, m, and their
      velocities, m/s.
    - ``press.status``: abstract `PressStatus`, how the executor of presses stands.
    - ``weighing.log``: abstract `WeighingLog`, what presses and lifts told so far.

    Attributes:
        scenario, obj, found, others, obstacles, plant, robot, table_top, home: see `Setting`.
        truth: true parameters of the object in a fresh Context; None if nobody knows them.
        style: options of the finger's path in a push.
        reach: says whether the arm can follow a path.
    """

    __slots__ = NO_SLOTS

    def __init__(
        self,
        builder: DiagramBuilder,
        setting: Setting,
        control: RobotControl,
        truth: CellParameters | None,
    ) -> None:
        """Builds the Diagram of a builder's systems.

        Args:
            builder: the builder with all systems, which is empty afterwards.
            setting: what the station knows.
            control: the systems that `AddRobotControl` added.
            truth: true parameters of the object; None if nobody knows them.
        """
        super().__init__()
        self.scenario = setting.scenario
        self.obj = setting.obj
        self.found = setting.found
        self.others = setting.others
        self.obstacles = setting.obstacles
        self.plant = setting.plant
        self.robot = setting.robot
        self.table_top = setting.table_top
        self.home = setting.home
        self.truth = truth
        self.style = control.executor.style
        self.reach = control.reach
        self._grasping = control.grasping
        self._pressing = control.pressing
        builder.BuildInto(self)

    def FindObstacle(self, command: PushCommand) -> str | None:
        """Says why the arm cannot carry out a push when it comes from its home; None if it can."""
        return plan_push(command, self.home, self.style, self.reach, self.home)[1]

    def FindGraspObstacle(self, command: GraspCommand) -> str | None:
        """Says why the arm cannot carry out a grasp when it comes from its home; None if it can.

        Raises:
            StationError: the scene has no gripper.
        """
        if self._grasping is None:
            raise StationError("the scene has no gripper; expected a model named gripper")
        return self._grasping.plan(command, (*self.home, 0.0))[1] or None

    def FindPressObstacle(self, command: PressCommand) -> str | None:
        """Says why the arm cannot carry out a press when it comes from its home; None if it can.

        Raises:
            StationError: nothing is weighed.
        """
        if self._pressing is None:
            raise StationError("nothing is weighed; expected a scenario with nothing_told: true")
        return self._pressing.plan(command, (*self.home, 0.0))[1] or None

    def SetStart(self, root_context: Context, seed: int | None = None) -> None:
        """Makes a fresh Context ready to begin.

        Args:
            root_context: Context of the station, or of the Diagram that the station is part of.
            seed: seed of everything random, instead of the scenario's.
        """
        raise NotImplementedError

    def GetTruth(self, root_context: Context) -> CellParameters | None:
        """Returns the object's true parameters in a Context; None if nobody knows them."""
        return None

    def FindStream(self, root_context: Context) -> list[Sample]:
        """Returns all that the identifier has read in a Context, from which it cut its pushes.

        Args:
            root_context: Context of the station, or of the Diagram that the station is part of.
        """
        t, tip = self._find_log(root_context, PUSHER_LOG)
        _, poses = self._find_log(root_context, POSE_LOG)
        return make_samples(t, tip[:, :3], tip[:, 3:], poses)

    def LearnAll(self, root_context: Context) -> Identification | None:
        """Learns from all that the identifier has read in a Context; see `GridIdentifier.LearnAll`.

        Args:
            root_context: Context of the station, or of the Diagram that the station is part of.
        """
        identifier = self.GetSubsystemByName("identifier")
        assert isinstance(identifier, GridIdentifier)
        return identifier.LearnAll(identifier.GetMyContextFromRoot(root_context))

    def FindSight(self, root_context: Context) -> Sight | None:
        """Returns what a color and depth camera saw in a Context, and its errors.

        It is None for an ideal camera, and for a real robot, where nobody knows the true pose.
        """
        return None

    def _find_log(
        self, root_context: Context, name: str
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Returns the times (K,), s, and the values (K, d) of a log.

        The logs are looked up by name each time. As attributes they would keep the station alive
        for good, for Python's garbage collector does not see the references within C++.
        """
        log = self.GetSubsystemByName(name).FindLog(root_context)
        return log.sample_times(), log.data().T
