"""`AddRobotControl`: what commands a robot in a station, whether that is simulated or real.

It adds the executors of pushes and grasps, the inverse kinematics and the identifier, and where a
station needs it, what weighs the object or steers the finger. Its inputs say where the tip and the
object are; its outputs say where the arm's joints and the gripper should be. What a station knows
of robot and table is in `station.scene.setting`, and where its finger may be in
`station.scene.finger_region`.
"""

from dataclasses import dataclass, replace

from pydrake.multibody.inverse_kinematics import DifferentialInverseKinematicsIntegrator
from pydrake.systems.framework import DiagramBuilder, OutputPort
from pydrake.systems.primitives import LogVectorOutput
from shapely import Polygon
from shapely.geometry.base import BaseGeometry

from gridpush_drake.dynamics.pusher import PusherShape
from gridpush_drake.multibody.tool_motion import TipRule
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.pushes.segmentation import RecordOptions
from gridpush_drake.station.control.grasping import (
    AddGraspExecutor,
    AddPusherGate,
    ExportGrasping,
    ExportOutputs,
    make_grasp_trajectory_options,
)
from gridpush_drake.station.robot.arm import ArmReach
from gridpush_drake.station.robot.arm_driver import AddArmKinematics
from gridpush_drake.station.scene.camera import calc_pose_age
from gridpush_drake.station.scene.finger_region import (
    REGION_SLACK,
    STEER_TURNING_SPEED,
    make_steer_region,
)
from gridpush_drake.station.scene.setting import (
    StationSetting,
    find_lookouts,
    make_style,
    make_surface,
)
from gridpush_drake.station.schema.scenario import PushScenario
from gridpush_drake.systems.execution.grasp_executor import GraspExecutor
from gridpush_drake.systems.execution.press_executor import ARM_PRESS, PressExecutor
from gridpush_drake.systems.execution.push_executor import PushExecutor, PushTrajectoryOptions
from gridpush_drake.systems.execution.steer_executor import SteerExecutor, SteerOptions
from gridpush_drake.systems.learning.grid_identifier import GridIdentifier
from gridpush_drake.systems.sensing.lift_scale import LiftOptions, LiftScale
from gridpush_drake.systems.sensing.object_pose_estimator import ObjectPoseEstimator
from gridpush_drake.systems.sensing.objects_pose_estimator import ObjectsPoseEstimator

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


def make_identifier(
    scenario: PushScenario,
    obj: GridObject,
    table_top: BaseGeometry,
    learning: Learning | None,
    shape: PusherShape | None = None,
) -> GridIdentifier:
    """Makes the system that learns the object, which also knows the table's edge.

    Args:
        scenario: the scenario, with the camera's rate and delay.
        obj: the object, as the robot knows it.
        table_top: the table's top, a polygon in W, m.
        learning: which pushes are learned from; None for the first `scenario.pokes.count`.
        shape: of a pusher that is no disc; None of a disc.
    """
    learning = learning or Learning(max_pushes=scenario.pokes.count)
    return GridIdentifier(
        obj,
        period=1 / scenario.camera.rate,
        # A tip that is lower than the object's top may touch it.
        engaged_below=scenario.object_height,
        pusher_radius=obj.prior.pusher_radius,
        pusher_shape=shape,
        max_learning_pushes=learning.max_pushes,
        table=make_surface(table_top).corners if isinstance(table_top, Polygon) else None,
        # A warm start saves little time. Without it `gridpush identify` finds the same parameters
        # from the written log, bit for bit on the same computer (on another processor NumPy may
        # take other BLAS kernels).
        warm_start=False,
        record=RecordOptions(pose_delay=calc_pose_age(scenario.camera)),
        answer_delay=scenario.simulation.answer_delay,
    )


YAW_LOG = "yaw_log"
PUSHER_LOG = "pusher_log"
POSE_LOG = "pose_log"
"""Names of the systems that log the pusher's yaw (of a pusher that is no disc), the tip's state and
the object's pose, as learned from."""


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


FORCE_FRACTION = 0.5
"""Fraction of the scenario's greatest force at which a steered finger goes up by itself. The rest
is for its braking."""


PRESS_FRACTION = 0.8
"""Greatest force of a press, as a fraction of the force at which a real arm is stopped."""


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
    setting: StationSetting,
    learning: Learning | None,
    pusher_state: OutputPort,
    pusher_yaw: OutputPort,
    object_pose: OutputPort,
    gripper_state: OutputPort | None,
    logged: dict[str, OutputPort] | None = None,
    tip_bounds: TipRule | None = None,
    load: FeltLoad | None = None,
    tip_force: OutputPort | None = None,
    steer_speed: float | None = None,
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
        pusher_yaw: (1,) angle by which the tool is turned about the vertical, rad.
        object_pose: (3,) X_WB of the object as the camera sees it, m and rad.
        gripper_state: (4,) state of the gripper's fingers, see `Station`; None without a gripper.
        logged: further ports to be logged whenever the identifier reads, by the logs' names.
        tip_bounds: says why a path may not lead the tip to a place, see `ArmReach`; None where it
            may go wherever the arm reaches.
        load: what the arm feels; None where nothing is weighed.
        tip_force: (3,) force on the tip in W, N, where the finger can be steered by its velocity;
            None where it cannot.
        steer_speed: greatest speed at which it can be steered, m/s; None where it cannot.
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
        "identifier",
        make_identifier(scenario, setting.obj, setting.table_top, learning, robot.shape),
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
    if tip_force is not None and steer_speed is not None:
        commander = _AddSteerExecutor(
            builder,
            setting,
            executor,
            commander=commander,
            reach=reach,
            tip_force=tip_force,
            speed=steer_speed,
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
    if robot.shape is not None:
        builder.Connect(pusher_yaw, identifier.GetInputPort("pusher_yaw"))
        logs[YAW_LOG] = pusher_yaw
    AddLogs(builder, logs, 1 / scenario.camera.rate)

    # The station's ports.
    builder.ExportInput(executor.GetInputPort("push_command"), "push_command")
    ExportOutputs(builder, executor, "executor", ("status",))
    ExportOutputs(builder, commander, "executor", ("tip_pose",))
    builder.ExportOutput(pusher_state, "pusher.state")
    builder.ExportOutput(pusher_yaw, "pusher.yaw")
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
    setting: StationSetting,
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
    options = replace(ARM_PRESS, max_force=PRESS_FRACTION * scenario.safety.force)
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
    setting: StationSetting,
    executor: PushExecutor,
    commander: PushExecutor | GraspExecutor | PressExecutor,
    reach: ArmReach,
    tip_force: OutputPort,
    speed: float,
) -> SteerExecutor:
    """Adds the executor of steering behind the other executors, and exports its ports.

    Args:
        builder: the builder that has the other executors.
        setting: robot and scene.
        executor: the executor of pushes.
        commander: the executor whose tip pose is passed on while nobody steers.
        reach: says whether the arm can follow a path.
        tip_force: (3,) force on the tip in W, N.
        speed: greatest speed of the finger, m/s.
    """
    scenario = setting.scenario
    region = make_steer_region(setting, reach, speed)
    style = SteerOptions(
        travel_height=scenario.finger.travel_height,
        push_height=scenario.finger.push_height,
        turns=setting.robot.shape is not None,
        max_speed=speed,
        max_turning_speed=STEER_TURNING_SPEED,
        max_force=FORCE_FRACTION * scenario.safety.force,
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
