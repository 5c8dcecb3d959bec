"""`MakeHardwareStation`: a station whose robot is a real one, or its twin, on LCM."""

from dataclasses import dataclass

import numpy as np
import shapely
from pydrake.geometry import Meshcat
from pydrake.lcm import DrakeLcmInterface
from pydrake.math import RigidTransform
from pydrake.multibody.inverse_kinematics import DifferentialInverseKinematicsIntegrator
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import JointActuatorIndex
from pydrake.systems.framework import Context, DiagramBuilder
from pydrake.systems.primitives import Multiplexer
from shapely.geometry.base import BaseGeometry

from gridpush_drake.errors import StationError
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.multibody.tool_motion import R_WP_DOWN
from gridpush_drake.multibody.weak_calc import NO_SLOTS
from gridpush_drake.station.arm import ArmPosture
from gridpush_drake.station.arm_driver import DRIVER_OUTPUTS
from gridpush_drake.station.camera import calc_pose_age
from gridpush_drake.station.grasping import ExportOutputs
from gridpush_drake.station.lcm.robot_messages import (
    ARM_PERIOD,
    AddGripperMessages,
    AddObjectReceiver,
    IiwaMessages,
    find_arm_messages,
)
from gridpush_drake.station.lcm.twin import check_tracked
from gridpush_drake.station.resolve import ResolvedScenario, resolve
from gridpush_drake.station.scenario import PushScenario
from gridpush_drake.station.station import (
    AddRobotControl,
    Learning,
    MakeSetting,
    RobotControl,
    Setting,
    Station,
)
from gridpush_drake.systems.arm_guard import ArmGuard, GuardLimits
from gridpush_drake.systems.object_watch import ObjectWatch
from gridpush_drake.systems.pusher_state_sensor import ArmTipSensor

MAX_TILT = 0.1
"""Of the finger from where it points when a run begins, rad."""

DEGREES = 180 / np.pi

MIN_OBJECT_NOISE = 0.01
"""How far a point of an object at rest may seem to move, m, whatever the camera's noise. In healthy
runs with the twin it was 4 mm."""

OBJECT_NOISE_DEVIATIONS = 8.0
"""How many standard deviations of an ideal camera's noise a point of an object at rest may seem to
move, where that is more."""

OBJECT_MESSAGE_TIME = 0.05
"""Longest time that a pose takes from the tracker to the guard, s."""


@dataclass(frozen=True, eq=False)
class TipBounds:
    """Where the finger's tip may be; what an `ArmGuard` takes as `validator`.

    Attributes:
        box: seen from above, a polygon in W, m.
        table_top: the table's, a polygon in W, m; over it the tip stays above the table.
        top: greatest height above the table, m.
    """

    box: BaseGeometry
    table_top: BaseGeometry
    top: float

    def __call__(self, p_WP: Array) -> str | None:
        """None where the tip may be at p_WP (3,), m, else a sentence."""
        x, y, z = p_WP.tolist()
        where = f"the finger's tip is at ({x:.3f}, {y:.3f}, {z:.3f}) m"
        if not self.box.covers(shapely.Point(x, y)):
            near, far = self.box.bounds[:2], self.box.bounds[2:]
            return f"{where}; it may be at x {near[0]:g} to {far[0]:g} m and y {near[1]:g} to {far[1]:g} m"
        if z < 0.0 and self.table_top.covers(shapely.Point(x, y)):
            return f"{where}, in the table"
        return f"{where}; it may be {self.top:.2f} m high" if z > self.top else None


def make_bounds(setting: Setting) -> TipBounds:
    """Where the tip may be by a scenario: its workspace, home, and what lies between, with a margin around them."""
    scenario, (x, y, z) = setting.scenario, setting.home
    margin, workspace = scenario.safety.margin, scenario.workspace
    box = shapely.box(workspace.x[0], workspace.y[0], workspace.x[1], workspace.y[1]).union(
        shapely.Point(x, y)
    )
    top = max(z, scenario.finger.travel_height) + scenario.pregrasp.lift + margin
    return TipBounds(
        shapely.box(*box.envelope.buffer(margin, join_style="mitre").bounds), setting.table_top, top
    )


def make_limits(scenario: PushScenario, control_plant: MultibodyPlant) -> GuardLimits:
    """What a scenario's guard allows the robot of a control plant."""
    safety, n = scenario.safety, control_plant.num_positions()
    actuators = map(JointActuatorIndex, range(control_plant.num_actuators()))
    effort = np.array(
        [control_plant.get_joint_actuator(index).effort_limit() for index in actuators]
    )
    return GuardLimits(
        speed=control_plant.GetVelocityUpperLimits(),
        acceleration=np.full(n, safety.acceleration),
        torque=safety.torque_share * effort,
        force=safety.force,
        status_age=safety.status_age,
        pose_jump=safety.pose_jump,
        pose_turn=safety.pose_turn,
        retreat=safety.retreat,
        following_error=safety.following_error,
        following_time=safety.following_time,
    )


def make_object_watch(setting: Setting) -> ObjectWatch:
    """What the motion of a scenario's object is judged by, as the scenario's camera sees it."""
    scenario, outline = setting.scenario, setting.obj.outline
    camera = scenario.camera
    noise = MIN_OBJECT_NOISE
    if camera.kind == "ideal":
        reach = float(np.hypot(*np.abs(shapely.get_coordinates(outline)).T).max())
        deviation = camera.position_noise + reach * camera.angle_noise
        noise = max(noise, OBJECT_NOISE_DEVIATIONS * deviation)
    return ObjectWatch(
        outline=outline,
        height=setting.obj.height or scenario.object_height,
        tip_radius=setting.robot.finger.tip_radius,
        noise=noise,
        lag=calc_pose_age(camera) + 1 / camera.rate + OBJECT_MESSAGE_TIME,
    )


class HardwareStation(Station):
    """The station of a real robot: LCM and a guard in the place of the plant.

    Beside the ports of every `Station` it has these.

    .. pydrake_system::

        name: HardwareStation
        input_ports:
        - stop
        output_ports:
        - guard.status
        - guard.position
        - pusher.force

    - ``stop``: (1,) see `ArmGuard`; need not be connected.
    - ``guard.status``: abstract `GuardStatus`; ``guard.position``: (n,) as sent to the robot, rad.
    - ``pusher.force``: (3,) on the finger's tip, from the torques on the joints, N.
    """

    __slots__ = NO_SLOTS

    def __init__(
        self,
        builder: DiagramBuilder,
        setting: Setting,
        control: RobotControl,
        messages: IiwaMessages,
    ) -> None:
        """Takes over a builder's systems; `MakeHardwareStation` calls it."""
        super().__init__(builder, setting, control, None)
        self._setting, self._control, self._messages = setting, control, messages

    def SetStart(self, root_context: Context, seed: int | None = None) -> None:
        """Begins where the arm is measured to be: the finger goes up from there, and then to work.

        Args:
            root_context: of the station, or of the Diagram it is part of; a status of the robot has
                come in.
            seed: has no effect: nothing here is random.

        Raises:
            StationError: the finger does not point down there, or its tip is where it may not be.
        """
        context = self.GetMyMutableContextFromRoot(root_context)
        q = np.array(self.GetOutputPort(f"{self.robot.arm_model}.position_measured").Eval(context))
        X_WP = ArmPosture(self._setting.control_plant, self.robot).calc_tip_pose(q)
        self._check_start(q, X_WP)
        kinematics: DifferentialInverseKinematicsIntegrator = self._control.kinematics
        kinematics.SetPositions(kinematics.GetMyMutableContextFromRoot(root_context), q)
        self._control.executor.SetRest(root_context, X_WP.translation())
        self.RequestStop(root_context, 0.0)

    def RequestStop(self, root_context: Context, stop: float) -> None:
        """Gives ``stop`` a value, in a Context in which nothing is connected to it."""
        context = self.GetMyMutableContextFromRoot(root_context)
        self.GetInputPort("stop").FixValue(context, [stop])

    def PublishCommand(self, root_context: Context) -> None:
        """Sends the arm's present command: one for every status, however the two sides' periods lie."""
        publisher = self.GetSubsystemByName(f"{self._messages.command}_publisher")
        publisher.ForcedPublish(publisher.GetMyContextFromRoot(root_context))

    def _check_start(self, q: Array, X_WP: RigidTransform) -> None:
        home = np.round(self._setting.q_start, 3).tolist()
        tilt = X_WP.rotation().InvertAndCompose(R_WP_DOWN).ToAngleAxis().angle()
        if abs(tilt) > MAX_TILT:
            raise StationError(
                f"the finger is turned by {DEGREES * abs(tilt):.0f} degrees from where it points down; at most "
                f"{DEGREES * MAX_TILT:.0f} will do: bring the arm's joints to about {home} rad"
            )
        breach = make_bounds(self._setting)(X_WP.translation())
        if breach:
            raise StationError(f"{breach}: bring the arm's joints to about {home} rad")


def MakeHardwareStation(
    scenario: PushScenario | ResolvedScenario,
    meshcat: Meshcat | None = None,
    *,
    lcm: DrakeLcmInterface,
    show_object: bool = True,
    learning: Learning | None = None,
    name: str = "station",
) -> HardwareStation:
    """Makes the station of a robot on LCM.

    The messages that it reads must be whole: Drake ends the process over one that is not.
    `HardwareLink` lets only such ones through, and moves the station's time on by the robot's.

    Args:
        scenario: what stands where, resolved or not; the object's truth and the simulation's settings have no
            effect.
        meshcat: has no effect: nothing is simulated that could be shown.
        lcm: on which the robot is.
        show_object: has no effect.
        learning: what is learned from; the first `scenario.pokes.count` pushes by default.
        name: of the station in a Diagram.

    Returns:
        The station. Call its `SetStart` on each new Context.

    Raises:
        ScenarioError: the scenario makes no sense, or has several objects.
        StationError: the arm cannot take the posture of its home.
    """
    resolved = resolve(scenario)
    scenario, robot, obj = resolved.scenario, resolved.robot, resolved.obj
    check_tracked(scenario)
    if scenario.camera.kind == "rgbd" and obj.height:  # as the tracker found it
        scenario = scenario.model_copy(update={"object_height": obj.height})
    setting = MakeSetting(resolved, scenario, resolved.scene.plant)
    n, messages = len(setting.q_start), find_arm_messages(robot)
    builder = DiagramBuilder()
    status = messages.AddStatusReceiver(builder, lcm, n)
    tip = builder.AddNamedSystem(
        "tip_sensor", ArmTipSensor(setting.control_plant, robot.finger.tip_frame)
    )
    for port in ("position_measured", "velocity_estimated", "torque_external"):
        builder.Connect(status[port], tip.GetInputPort(port))
    pose_age = calc_pose_age(scenario.camera)
    object_pose, newest_pose = AddObjectReceiver(builder, lcm, status["time_measured"], pose_age)
    pusher_state = tip.GetOutputPort("pusher_state")
    gripper_state, gripper = (
        (None, None) if robot.gripper is None else AddGripperMessages(builder, lcm)
    )
    control = AddRobotControl(builder, setting, learning, pusher_state, object_pose, gripper_state)
    if control.grasping is not None and gripper is not None:
        builder.Connect(
            control.grasping.GetOutputPort("gripper_position"), gripper.GetInputPort("position")
        )
        builder.Connect(
            control.grasping.GetOutputPort("gripper_force_limit"),
            gripper.GetInputPort("force_limit"),
        )
    posture = ArmPosture(setting.control_plant, robot)
    guard = builder.AddNamedSystem(
        "guard",
        ArmGuard(
            make_limits(scenario, setting.control_plant),
            calc_tip=lambda q: posture.calc_tip_pose(q).translation(),
            validator=make_bounds(setting),
            period=ARM_PERIOD,
            object_watch=make_object_watch(setting),
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
    builder.Connect(pusher_state, guard.GetInputPort("pusher_state"))
    builder.Connect(tip.GetOutputPort("force"), guard.GetInputPort("force"))
    builder.Connect(newest_pose, guard.GetInputPort("object_pose"))
    builder.Connect(guard.GetOutputPort("position"), messages.AddCommandSender(builder, lcm, n))
    builder.ExportInput(guard.GetInputPort("stop"), "stop")
    ExportOutputs(builder, guard, "guard", ("status", "position"))
    ExportOutputs(builder, tip, "pusher", ("force",))
    state = builder.AddNamedSystem("arm_state", Multiplexer([n, n]))
    for index, port in enumerate(("position_measured", "velocity_estimated")):
        builder.Connect(status[port], state.get_input_port(index))
    builder.ExportOutput(state.get_output_port(), f"{robot.arm_model}.state_estimated")
    for port in DRIVER_OUTPUTS:
        if port in status:
            builder.ExportOutput(status[port], f"{robot.arm_model}.{port}")
    station = HardwareStation(builder, setting, control, messages)
    station.set_name(name)
    return station
