"""`MakeHardwareStation`: the station of a real robot, or of its twin.

In the place of a simulated plant there are records and a guard. What moves the station's time on
by the robot's clock is `HardwareLink`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
import shapely
from numpy.typing import ArrayLike
from pydrake.common.value import AbstractValue
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform
from pydrake.multibody.inverse_kinematics import DifferentialInverseKinematicsIntegrator
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import JointActuatorIndex, PrismaticJoint
from pydrake.systems.framework import Context, DiagramBuilder, OutputPort
from pydrake.systems.primitives import Multiplexer
from shapely.geometry.base import BaseGeometry

from gridpush_drake.dynamics.pusher import PusherShape
from gridpush_drake.errors import StationError
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.multibody.tool_motion import R_WP_DOWN, calc_tool_pose
from gridpush_drake.multibody.weak_calc import NO_SLOTS
from gridpush_drake.station.control.grasping import ExportOutputs
from gridpush_drake.station.control.robot_control import (
    AddRobotControl,
    FeltLoad,
    Learning,
    RobotControl,
)
from gridpush_drake.station.links.link import ARM_PERIOD
from gridpush_drake.station.robot.arm import ArmPosture
from gridpush_drake.station.robot.arm_driver import DRIVER_OUTPUTS, STATUS_PORTS
from gridpush_drake.station.scene.camera import calc_pose_age
from gridpush_drake.station.scene.other_objects import list_others
from gridpush_drake.station.scene.resolve import ResolvedScenario, resolve
from gridpush_drake.station.scene.scene_camera import AddAllSeen, AddPosesTogether
from gridpush_drake.station.scene.setting import MakeSetting, StationSetting
from gridpush_drake.station.schema.scenario import PushScenario
from gridpush_drake.station.simulated.station import Station
from gridpush_drake.systems.observed_pose import ObservedPose
from gridpush_drake.systems.record_ports import RecordReader
from gridpush_drake.systems.robot_records import (
    ArmCommand,
    ArmStatus,
    GripperCommand,
    GripperStatus,
    Numbers,
    PoseObservation,
)
from gridpush_drake.systems.safety.arm_guard import ArmGuard
from gridpush_drake.systems.safety.guard_status import GuardLimits
from gridpush_drake.systems.sensing.arm_load_sensor import ArmLoadSensor
from gridpush_drake.systems.sensing.object_watch import ObjectWatch
from gridpush_drake.systems.sensing.pusher_state_sensor import ArmTipSensor

MAX_TILT = 0.1
"""A run begins only if the finger is turned by less than this from pointing down, rad."""

DEGREES = 180 / np.pi
"""Degrees in a radian."""

MIN_OBJECT_NOISE = 0.01
"""Distance that a point of an object at rest may seem to move, m, however little noise the camera
has. In runs with the twin in which nothing was wrong it was up to 4 mm."""

OBJECT_NOISE_DEVIATIONS = 8.0
"""Distance that a point of an object at rest may seem to move, in standard deviations of an ideal
camera's noise, if that is more than `MIN_OBJECT_NOISE`."""

OBJECT_MAX_AGE = 0.5
"""If the last observation of the object is older than this, the object is not seen, s."""

OBJECT_MESSAGE_TIME = 0.05
"""Longest time that a pose takes from the tracker to the guard, s."""


@dataclass(frozen=True, eq=False)
class TipBounds:
    """Bounds of where the finger's tip may be; an `ArmGuard` takes it as `validator`.

    Attributes:
        box: where the tip may be, seen from above, a polygon in W, m.
        table_top: the table's top, a polygon in W, m. Over it the tip stays above the table.
        top: greatest height of the tip above the table, m.
        shape: of a gripper that pushes, all of which keeps the bounds; None of a finger, whose
            tip's center does.
    """

    box: BaseGeometry
    table_top: BaseGeometry
    top: float
    shape: PusherShape | None = None

    def __call__(self, p_WP: Array, yaw: float) -> str | None:
        """Says in a sentence why the tip may not be at p_WP (3,), m, turned by a yaw, rad.

        Returns:
            The sentence; None if it may be there.
        """
        x, y, z = p_WP.tolist()
        what = "the finger's tip" if self.shape is None else "the gripper's tip"
        where = f"{what} is at ({x:.3f}, {y:.3f}, {z:.3f}) m"
        covered = shapely.Point(x, y) if self.shape is None else self.shape.at([x, y, yaw])
        if not self.box.covers(covered):
            x_min, y_min, x_max, y_max = self.box.bounds
            all_of_it = "it" if self.shape is None else "all of it"
            return (
                f"{where}; {all_of_it} may be at x {x_min:g} to {x_max:g} m and y {y_min:g} to "
                f"{y_max:g} m"
            )
        if z < 0.0 and self.table_top.intersects(covered):
            return f"{where}, in the table"
        if z > self.top:
            return f"{where}; it may be {self.top:.2f} m high"
        return None


def make_bounds(setting: StationSetting) -> TipBounds:
    """Makes the tip's bounds: a box around the scenario's workspace and home, with a margin."""
    scenario = setting.scenario
    margin = scenario.safety.margin
    workspace = scenario.workspace
    x, y, z = setting.home
    used = shapely.box(workspace.x[0], workspace.y[0], workspace.x[1], workspace.y[1]).union(
        shapely.Point(x, y)
    )
    box = shapely.box(*used.envelope.buffer(margin, join_style="mitre").bounds)
    top = max(z, scenario.finger.travel_height) + scenario.pregrasp.lift + margin
    return TipBounds(box=box, table_top=setting.table_top, top=top, shape=setting.robot.shape)


def make_limits(scenario: PushScenario, control_plant: MultibodyPlant) -> GuardLimits:
    """Makes the limits of a guard from a scenario's `safety` and a robot's control plant."""
    safety = scenario.safety
    actuators = map(JointActuatorIndex, range(control_plant.num_actuators()))
    effort = np.array(
        [control_plant.get_joint_actuator(index).effort_limit() for index in actuators]
    )
    return GuardLimits(
        speed=control_plant.GetVelocityUpperLimits(),
        acceleration=np.full(control_plant.num_positions(), safety.acceleration),
        torque=safety.torque_share * effort,
        position_lower=control_plant.GetPositionLowerLimits(),
        position_upper=control_plant.GetPositionUpperLimits(),
        force=safety.force,
        status_age=safety.status_age,
        pose_jump=safety.pose_jump,
        pose_turn=safety.pose_turn,
        retreat=safety.retreat,
        following_error=safety.following_error,
        following_time=safety.following_time,
        sliding=tuple(
            joint.position_start()
            for joint in map(control_plant.get_joint, control_plant.GetJointIndices())
            if joint.type_name() == PrismaticJoint.kTypeName
        ),
    )


def make_object_watch(setting: StationSetting, several: bool = False) -> ObjectWatch:
    """Makes the judge of whether a scenario's object moves as the finger moves it.

    Args:
        setting: robot and scene.
        several: whether the object may be pushed through others.
    """
    scenario = setting.scenario
    outline = setting.obj.outline
    camera = scenario.camera
    noise = MIN_OBJECT_NOISE
    if camera.kind == "ideal":
        # The point of the outline that is farthest from B's origin seems to move most.
        radius = float(np.hypot(*np.abs(shapely.get_coordinates(outline)).T).max())
        deviation = camera.position_noise + radius * camera.angle_noise
        noise = max(noise, OBJECT_NOISE_DEVIATIONS * deviation)
    top = setting.obj.height or scenario.object_height
    if several:
        top = max(top, *(other.height for other in setting.others))
    return ObjectWatch(
        outline=outline,
        height=top,
        tip_radius=setting.robot.finger.tip_radius,
        shape=setting.robot.shape,
        noise=noise,
        pushed_by_others=several,
        lag=calc_pose_age(camera) + 1 / camera.rate + OBJECT_MESSAGE_TIME,
    )


class HardwareStation(Station):
    """The station of a real robot: records and a guard in the place of a simulated plant.

    It has the ports of every `Station`, and the following.

    .. pydrake_system::

        name: HardwareStation
        input_ports:
        - stop
        - arm_status
        - gripper_status
        - object.observation
        - other_0.observation
        - ...
        output_ports:
        - guard.status
        - guard.position
        - pusher.force
        - other_0.pose
        - ...

    - ``stop``: vector of 1, whether the arm is to be stopped, and by whom, see `ArmGuard`. It need
      not be connected.
    - ``arm_status``: abstract `ArmStatus`, the robot's last one.
    - ``gripper_status``: abstract `GripperStatus`, the last one; only with a gripper.
    - ``object.observation``, ``other_0.observation`` and so on: abstract `PoseObservation`, the
      last one of the object, and of each of the scenario's `others`.
    - ``guard.status``: abstract `GuardStatus`, how the guard stands.
    - ``guard.position``: vector of n, joint positions as they are sent to the robot, rad.
    - ``pusher.force``: vector of 3, force on the finger's tip in W, calculated from the torques on
      the joints, N.
    - ``other_0.pose`` and so on: vector of 3, X_WB of another object as its tracker sees it,
      (x, y, theta), m and rad; one port for each of the scenario's `others`.
    """

    __slots__ = NO_SLOTS

    def __init__(
        self,
        builder: DiagramBuilder,
        setting: StationSetting,
        control: RobotControl,
    ) -> None:
        """Builds the Diagram of a builder's systems; `MakeHardwareStation` calls it."""
        super().__init__(builder, setting, control, truth=None)
        self._setting = setting
        self._control = control

    def SetStart(self, root_context: Context, seed: int | None = None) -> None:
        """Makes a fresh Context begin with the arm where it is measured to be.

        From there the finger goes up first, and then to work.

        Args:
            root_context: Context of the station, or of the Diagram that the station is part of. It
                has taken a status of the robot.
            seed: has no effect: nothing here is random.

        Raises:
            StationError: the finger does not point down, or its tip is where it may not be.
        """
        context = self.GetMyMutableContextFromRoot(root_context)
        q = np.array(self.GetOutputPort(f"{self.robot.arm_model}.position_measured").Eval(context))
        X_WP = ArmPosture(self._setting.control_plant, self.robot).calc_tip_pose(q)
        self._check_start(q, X_WP)
        kinematics: DifferentialInverseKinematicsIntegrator = self._control.kinematics
        kinematics.SetPositions(kinematics.GetMyMutableContextFromRoot(root_context), q)
        self._control.executor.SetRest(root_context, X_WP)
        self.RequestStop(root_context, 0.0)

    def RequestStop(self, root_context: Context, stop: float) -> None:
        """Sets the input ``stop`` in a Context in which nothing is connected to it."""
        context = self.GetMyMutableContextFromRoot(root_context)
        self.GetInputPort("stop").FixValue(context, [stop])

    def TakeRecord(
        self, root_context: Context, record: ArmStatus | GripperStatus | PoseObservation
    ) -> None:
        """Sets the input port of a record in a Context in which nothing is connected to it."""
        name = "arm_status"
        if isinstance(record, PoseObservation):
            seen = ("object", *(other.name for other in self.others))
            name = f"{seen[record.number]}.observation"
        elif isinstance(record, GripperStatus):
            name = "gripper_status"
        context = self.GetMyMutableContextFromRoot(root_context)
        self.GetInputPort(name).FixValue(context, AbstractValue.Make(record))

    def GetArmCommand(self, root_context: Context) -> ArmCommand:
        """Returns the guard's present command, which the link sends once for every status."""
        context = self.GetMyContextFromRoot(root_context)
        position = self.GetOutputPort("guard.position").Eval(context)
        return ArmCommand(context.get_time(), np.array(position))

    def GetGripperCommand(self, root_context: Context) -> GripperCommand | None:
        """Returns the present command for the gripper; None if there is no gripper."""
        grasping = self._control.grasping
        if grasping is None:
            return None
        context = grasping.GetMyContextFromRoot(root_context)
        opening = grasping.GetOutputPort("gripper_position").Eval(context)
        force = grasping.GetOutputPort("gripper_force_limit").Eval(context)
        return GripperCommand(context.get_time(), float(opening[0]), float(force[0]))

    def _check_start(self, q: Array, X_WP: RigidTransform) -> None:
        """Checks that a run can begin with joints q (n,), rad, and the tip at X_WP."""
        home = np.round(self._setting.q_start, 3).tolist()
        tilt = X_WP.rotation().InvertAndCompose(R_WP_DOWN).ToAngleAxis().angle()
        if abs(tilt) > MAX_TILT:
            raise StationError(
                f"the finger is turned by {DEGREES * abs(tilt):.0f} degrees from where it points "
                f"down; at most {DEGREES * MAX_TILT:.0f} will do: bring the arm's joints to about "
                f"{home} rad"
            )
        breach = make_bounds(self._setting)(X_WP.translation(), calc_tool_pose(X_WP)[3])
        if breach:
            raise StationError(f"{breach}: bring the arm's joints to about {home} rad")


def MakeHardwareStation(
    scenario: PushScenario | ResolvedScenario,
    meshcat: Meshcat | None = None,
    *,
    show_object: bool = True,
    learning: Learning | None = None,
    steer_speed: float | None = None,
    several: bool = False,
    name: str = "station",
) -> HardwareStation:
    """Makes the station of a robot that is linked by records.

    The numbers in them must be finite. `HardwareLink` lets only such records through, and moves the
    station's time on by the robot's clock.

    Args:
        scenario: the scenario, resolved or not. Its truth and its simulation have no effect.
        meshcat: has no effect: nothing is simulated that could be shown.
        show_object: has no effect.
        learning: which pushes are learned from; None for the first `scenario.pokes.count`.
        steer_speed: greatest speed at which the finger can be steered by the port `steer_command`,
            m/s; None for a station without this port.
        several: whether the task is with all objects: it then waits until all of them are seen.
        name: name of the station in a Diagram.

    Returns:
        The station. Call its `SetStart` on each new Context.

    Raises:
        ScenarioError: the scenario makes no sense.
    """
    resolved = resolve(scenario)
    scenario = resolved.scenario
    robot = resolved.robot
    if scenario.camera.kind == "rgbd" and resolved.obj.height:
        # The height is the one that the tracker found, and wrote into the object's file.
        scenario = scenario.model_copy(update={"object_height": resolved.obj.height})
    others = list_others(scenario, resolved.others)
    setting = MakeSetting(resolved, scenario, resolved.scene.plant, others=others)
    n = len(setting.q_start)
    builder = DiagramBuilder()

    # What the records tell: the arm's joints, and from them the tip; the objects; the gripper.
    status = _AddArmStatus(builder, n)
    tip = builder.AddNamedSystem(
        "tip_sensor", ArmTipSensor(setting.control_plant, robot.finger.tip_frame)
    )
    for port in ("position_measured", "velocity_estimated", "torque_external"):
        builder.Connect(status[port], tip.GetInputPort(port))
    pose_age = calc_pose_age(scenario.camera)
    camera = _AddObservedPose(builder, "object", status, pose_age)
    object_pose = camera.GetOutputPort("object_pose")
    all_seen = None
    if others:
        poses = [object_pose]
        for other in others:
            other_camera = _AddObservedPose(builder, other.name, status, pose_age)
            pose = other_camera.GetOutputPort("object_pose")
            builder.ExportOutput(pose, f"{other.name}.pose")
            poses.append(pose)
        if several:
            all_seen = AddAllSeen(builder, AddPosesTogether(builder, poses, "scene_poses"))
    gripper_state = None
    if robot.gripper is not None:
        gripper_state = _AddGripperStatus(builder)

    # If the object is weighed, what the arm feels at its tip and in its gripper.
    load = _add_load(builder, setting, status) if scenario.unknown_inertia else None

    # What commands the robot, as in the simulation; and between it and the arm, the guard.
    control = AddRobotControl(
        builder,
        setting,
        learning,
        pusher_state=tip.GetOutputPort("pusher_state"),
        pusher_yaw=tip.GetOutputPort("pusher_yaw"),
        object_pose=object_pose,
        gripper_state=gripper_state,
        tip_bounds=make_bounds(setting),
        load=load,
        tip_force=tip.GetOutputPort("force"),
        steer_speed=steer_speed,
        all_seen=all_seen,
    )
    guard = _AddGuard(builder, setting, control, status=status, tip=tip, several=several)
    builder.Connect(camera.GetOutputPort("newest_pose"), guard.GetInputPort("object_pose"))

    _ExportArmPorts(builder, status, robot.arm_model, n)
    station = HardwareStation(builder, setting, control)
    station.set_name(name)
    return station


def _AddArmStatus(builder: DiagramBuilder, n: int) -> dict[str, OutputPort]:
    """Adds what reads the status of an arm of n joints.

    Returns:
        Its output ports, by the names that Drake's `SimIiwaDriver` uses, and `time_measured`.
    """
    ports: dict[str, Callable[[ArmStatus], ArrayLike]] = {
        port: partial(_read_status, field) for field, port in STATUS_PORTS.items()
    }
    ports["time_measured"] = lambda status: status.time
    zeros = np.zeros(n)
    reader = builder.AddNamedSystem(
        "arm_status_reader", RecordReader(ArmStatus(0.0, zeros, zeros, zeros), ports)
    )
    builder.ExportInput(reader.get_input_port(), "arm_status")
    return {name: reader.GetOutputPort(name) for name in ports}


def _read_status(field: str, status: ArmStatus) -> Numbers:
    """Reads a field of a status; unknown torques are 0, an unknown command is where the arm is."""
    numbers: Numbers | None = getattr(status, field)
    if numbers is not None:
        return numbers
    return status.position if field == "position_commanded" else np.zeros(len(status.position))


def _AddGripperStatus(builder: DiagramBuilder) -> OutputPort:
    """Adds what reads a gripper's status; returns the port with the state (4,) of its fingers."""
    reader = builder.AddNamedSystem(
        "gripper_status_reader",
        RecordReader(GripperStatus(0.0, 0.0), {"state": GripperStatus.calc_finger_state}),
    )
    builder.ExportInput(reader.get_input_port(), "gripper_status")
    return reader.get_output_port()


def _AddObservedPose(
    builder: DiagramBuilder, name: str, status: dict[str, OutputPort], delay: float
) -> ObservedPose:
    """Adds what holds an object's pose between two observations of it.

    Args:
        builder: the builder that has the systems of the arm's status.
        name: the object's, as in the station's ports.
        status: ports with the arm's status.
        delay: age of the pose that the executor and the identifier get, s; always the same, so that
            the identifier knows it.
    """
    camera: ObservedPose = builder.AddNamedSystem(
        f"{name}_camera", ObservedPose(ARM_PERIOD, OBJECT_MAX_AGE, delay)
    )
    builder.Connect(status["time_measured"], camera.GetInputPort("time"))
    builder.ExportInput(camera.GetInputPort("observation"), f"{name}.observation")
    return camera


def _add_load(
    builder: DiagramBuilder, setting: StationSetting, status: dict[str, OutputPort]
) -> FeltLoad:
    """Adds what tells which forces the arm feels, and returns its ports."""
    robot = setting.robot
    grasp_frame = None if robot.gripper is None else robot.gripper.grasp_frame
    sensor = builder.AddNamedSystem(
        "load_sensor",
        ArmLoadSensor(setting.control_plant, robot.finger.tip_frame, grasp_frame),
    )
    for port in ("position_measured", "torque_external"):
        builder.Connect(status[port], sensor.GetInputPort(port))
    return FeltLoad(
        tip_force=sensor.GetOutputPort("tip_force"),
        smooth_tip_force=sensor.GetOutputPort("smooth_tip_force"),
        grasp_wrench=sensor.GetOutputPort("grasp_wrench"),
    )


def _AddGuard(
    builder: DiagramBuilder,
    setting: StationSetting,
    control: RobotControl,
    status: dict[str, OutputPort],
    tip: ArmTipSensor,
    several: bool,
) -> ArmGuard:
    """Adds the guard behind what commands the arm, and exports its ports and the tip's force.

    Args:
        builder: the builder that has the other systems.
        setting: robot and scene.
        control: the systems that command the robot.
        status: ports with the arm's status, by the names that a `SimIiwaDriver` uses.
        tip: measures the finger's tip.
        several: whether objects may be pushed through one another.
    """
    posture = ArmPosture(setting.control_plant, setting.robot)
    guard: ArmGuard = builder.AddNamedSystem(
        "guard",
        ArmGuard(
            make_limits(setting.scenario, setting.control_plant),
            calc_tip=lambda q: posture.calc_tip_pose(q).translation(),
            validator=make_bounds(setting),
            period=ARM_PERIOD,
            object_watch=make_object_watch(setting, several),
        ),
    )
    if control.grasping is not None:
        builder.Connect(
            control.grasping.GetOutputPort("status"), guard.GetInputPort("grasp_status")
        )
    builder.Connect(
        control.kinematics.GetOutputPort("joint_positions"), guard.GetInputPort("position_desired")
    )
    for port in ("position_measured", "torque_external", "time_measured"):
        builder.Connect(status[port], guard.GetInputPort(port))
    for port in ("pusher_state", "pusher_yaw"):
        builder.Connect(tip.GetOutputPort(port), guard.GetInputPort(port))
    builder.Connect(tip.GetOutputPort("force"), guard.GetInputPort("force"))
    builder.ExportInput(guard.GetInputPort("stop"), "stop")
    ExportOutputs(builder, guard, "guard", ("status", "position"))
    ExportOutputs(builder, tip, "pusher", ("force",))
    return guard


def _ExportArmPorts(
    builder: DiagramBuilder, status: dict[str, OutputPort], arm_model: str, n: int
) -> None:
    """Exports the status of an arm of n joints by the names that the simulated station has."""
    state = builder.AddNamedSystem("arm_state", Multiplexer([n, n]))
    builder.Connect(status["position_measured"], state.get_input_port(0))
    builder.Connect(status["velocity_estimated"], state.get_input_port(1))
    builder.ExportOutput(state.get_output_port(), f"{arm_model}.state_estimated")
    for port in DRIVER_OUTPUTS:
        if port in status:
            builder.ExportOutput(status[port], f"{arm_model}.{port}")
