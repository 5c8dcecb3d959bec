"""The LCM messages that robots and this package exchange: their types, channels and periods.

Functions add the systems that make them and read them, for either side: for the station that
commands a robot, and for a twin that behaves like the robot. An arm's messages depend on its driver
(`ARM_MESSAGES`); gripper and tracked object have messages of their own.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from drake import (
    lcmt_iiwa_command,
    lcmt_iiwa_status,
    lcmt_panda_command,
    lcmt_panda_status,
    lcmt_planar_manipuland_status,
    lcmt_schunk_wsg_command,
    lcmt_schunk_wsg_status,
)
from pydrake.common.value import AbstractValue
from pydrake.lcm import DrakeLcmInterface
from pydrake.manipulation import (
    IiwaCommandReceiver,
    IiwaCommandSender,
    IiwaStatusReceiver,
    IiwaStatusSender,
    MakeMultibodyStateToWsgStateSystem,
    PandaCommandReceiver,
    PandaCommandSender,
    PandaControlMode,
    PandaStatusReceiver,
    PandaStatusSender,
    SchunkWsgCommandReceiver,
    SchunkWsgCommandSender,
    SchunkWsgPositionController,
    SchunkWsgStatusReceiver,
    SchunkWsgStatusSender,
)
from pydrake.systems.framework import (
    BasicVector,
    Context,
    DiagramBuilder,
    InputPort,
    LeafSystem,
    OutputPort,
    System,
)
from pydrake.systems.lcm import LcmPublisherSystem, LcmSubscriberSystem
from pydrake.systems.primitives import MatrixGain

from gridpush_drake.errors import StationError
from gridpush_drake.multibody.weak_calc import NO_SLOTS, weakly
from gridpush_drake.station.robot import Robot
from gridpush_drake.systems.command_ramp import CommandRamp
from gridpush_drake.systems.planar_manipuland_status import (
    MICROSECONDS,
    PlanarManipulandStatusReceiver,
    PlanarManipulandStatusSender,
)

MILLISECONDS = 1e3
"""Milliseconds in a second."""

ARM_PERIOD = 0.005
"""Time between two statuses of an arm, and between two commands, s; drake-iiwa-driver keeps it."""

GRIPPER_PERIOD = 0.05
"""Time between two statuses of a gripper, and between two commands, s."""

GRIPPER_STATUS = "SCHUNK_WSG_STATUS"
"""Channel of a gripper's status, `lcmt_schunk_wsg_status`, as Drake's driver names it."""

GRIPPER_COMMAND = "SCHUNK_WSG_COMMAND"
"""Channel of a gripper's command, `lcmt_schunk_wsg_command`, as Drake's driver names it."""

OBJECT_STATUS = "PLANAR_MANIPULAND_STATUS"
"""Channel of the object's pose, `lcmt_planar_manipuland_status`; the name is this package's own.
Those of the other objects on the table are named by `name_object_channel`."""

PICTURES = "DRAKE_RGBD_CAMERA_IMAGES"
"""Channel of a camera's color and depth, `lcmt_image_array`, as Drake's examples name it."""

OBJECT_MAX_AGE = 0.5
"""If the last message about the object is older than this, the object is not seen, s."""

POSITION_MODE = PandaControlMode.kPosition
"""The mode in which a Panda is commanded: by joint positions."""

FROM_OPENING = np.array([[-0.5, 0.0], [0.5, 0.0], [0.0, -0.5], [0.0, 0.5]])
"""(4, 2) matrix from a gripper's opening, m, and its rate, m/s, to the positions of the left and
right finger and their velocities."""


@dataclass(frozen=True)
class IiwaMessages:
    """The messages that drake-iiwa-driver speaks.

    Attributes:
        status: channel of the arm's status.
        command: channel of the arm's command.
        status_type: type of the status.
        command_type: type of the command.
    """

    status: str = "IIWA_STATUS"
    command: str = "IIWA_COMMAND"
    status_type: Any = lcmt_iiwa_status
    command_type: Any = lcmt_iiwa_command

    def count_joints(self, message: Any) -> int:
        """Returns the number of joints in a status."""
        return int(message.num_joints)

    def find_fault(self, message: Any, n: int) -> str:
        """Says that a status is of another robot than one of n joints; empty if it is not.

        Whatever else may be wrong with its form is found by `find_form_fault`.
        """
        joints = self.count_joints(message)
        if joints == n:
            return ""
        return f"{self.status} speaks of {joints} joints; expected {n}, as the scenario's robot has"

    def read_joints(self, message: Any) -> Sequence[float]:
        """Returns the measured joint positions in a status, rad."""
        return tuple(message.joint_position_measured)

    def is_finite(self, command: Any) -> bool:
        """Returns whether a command has joint positions, all of them finite."""
        return len(command.joint_position) > 0 and bool(np.isfinite(command.joint_position).all())

    def AddStatusReceiver(
        self, builder: DiagramBuilder, lcm: DrakeLcmInterface, n: int
    ) -> dict[str, OutputPort]:
        """Adds the system that reads the status of an arm of n joints.

        Returns:
            Its output ports, by the names that Drake's `SimIiwaDriver` uses.
        """
        receiver = builder.AddNamedSystem("arm_status_receiver", IiwaStatusReceiver(n))
        _Subscribe(builder, lcm, self.status, kind=self.status_type, port=receiver.get_input_port())
        return {
            port.get_name(): port
            for port in map(receiver.get_output_port, range(receiver.num_output_ports()))
        }

    def AddCommandSender(
        self, builder: DiagramBuilder, lcm: DrakeLcmInterface, n: int
    ) -> InputPort:
        """Adds the system that sends commands; returns its input for n joint positions, rad."""
        sender = builder.AddNamedSystem("arm_command_sender", IiwaCommandSender(n))
        _Publish(
            builder,
            lcm,
            self.command,
            kind=self.command_type,
            port=sender.get_output_port(),
            period=ARM_PERIOD,
        )
        return sender.GetInputPort("position")

    def AddRobotSide(
        self,
        builder: DiagramBuilder,
        lcm: DrakeLcmInterface,
        n: int,
        driver: dict[str, OutputPort],
        ramp: CommandRamp,
    ) -> None:
        """Adds what the driver of a real arm does, to a simulated one.

        It makes statuses of the arm's measurements, and passes commands to a ramp. Until the first
        command the arm stays where it is.

        Args:
            builder: the builder that has the arm's driver.
            lcm: LCM on which the arm speaks.
            n: number of the arm's joints.
            driver: output ports of the simulated arm's driver, by name.
            ramp: brings the arm to rest when commands stop coming.
        """
        commands = builder.AddNamedSystem("arm_command_receiver", IiwaCommandReceiver(n))
        builder.Connect(commands.GetOutputPort("time"), ramp.GetInputPort("time_sent"))
        self._ConnectRobotSide(
            builder, lcm, driver, ramp, commands=commands, status=IiwaStatusSender(n)
        )

    def _ConnectRobotSide(
        self,
        builder: DiagramBuilder,
        lcm: DrakeLcmInterface,
        driver: dict[str, OutputPort],
        ramp: CommandRamp,
        commands: System,
        status: System,
    ) -> None:
        """Connects the system that reads commands and the system that makes statuses."""
        _Subscribe(
            builder,
            lcm,
            self.command,
            kind=self.command_type,
            port=commands.GetInputPort(self.command_type.__name__),
        )
        builder.Connect(driver["position_measured"], commands.GetInputPort("position_measured"))
        builder.Connect(commands.GetOutputPort("position"), ramp.GetInputPort("position_desired"))
        builder.AddNamedSystem("arm_status_sender", status)
        for port in map(status.get_input_port, range(status.num_input_ports())):
            name = PANDA_NAMES.get(port.get_name(), port.get_name())
            if name in driver:
                builder.Connect(driver[name], port)
        _Publish(
            builder,
            lcm,
            self.status,
            kind=self.status_type,
            port=status.get_output_port(),
            period=ARM_PERIOD,
        )


PANDA_NAMES = {"velocity_measured": "velocity_estimated"}
"""Names of an iiwa's ports by those of a Panda's, for the ports whose names differ."""


@dataclass(frozen=True)
class PandaMessages(IiwaMessages):
    """The messages that drake-franka-driver speaks, commanded by positions; see `IiwaMessages`."""

    status: str = "PANDA_STATUS"
    command: str = "PANDA_COMMAND"
    status_type: Any = lcmt_panda_status
    command_type: Any = lcmt_panda_command

    def read_joints(self, message: Any) -> Sequence[float]:
        """Returns the measured joint positions in a status, rad."""
        return tuple(message.joint_position)

    def AddStatusReceiver(
        self, builder: DiagramBuilder, lcm: DrakeLcmInterface, n: int
    ) -> dict[str, OutputPort]:
        """Adds the systems that read the status of an arm of n joints.

        Drake's receiver has no port for the time of the status; a `MessageClock` reads it.

        Returns:
            Their output ports, by the names that Drake's `SimIiwaDriver` uses.
        """
        receiver = builder.AddNamedSystem("arm_status_receiver", PandaStatusReceiver(n))
        _Subscribe(builder, lcm, self.status, kind=self.status_type, port=receiver.get_input_port())
        clock = _AddClock(builder, lcm, "arm_status_clock", self.status, self.status_type)
        ports = map(receiver.get_output_port, range(receiver.num_output_ports()))
        named = {PANDA_NAMES.get(port.get_name(), port.get_name()): port for port in ports}
        return named | {"time_measured": clock}

    def AddCommandSender(
        self, builder: DiagramBuilder, lcm: DrakeLcmInterface, n: int
    ) -> InputPort:
        """Adds the system that sends commands; returns its input for n joint positions, rad."""
        sender = builder.AddNamedSystem("arm_command_sender", PandaCommandSender(n, POSITION_MODE))
        _Publish(
            builder,
            lcm,
            self.command,
            kind=self.command_type,
            port=sender.get_output_port(),
            period=ARM_PERIOD,
        )
        return sender.GetInputPort("position")

    def AddRobotSide(
        self,
        builder: DiagramBuilder,
        lcm: DrakeLcmInterface,
        n: int,
        driver: dict[str, OutputPort],
        ramp: CommandRamp,
    ) -> None:
        """Adds what the driver of a real arm does, see `IiwaMessages.AddRobotSide`.

        Drake's receiver has no port for the time of the command; a `MessageClock` reads it.
        """
        commands = builder.AddNamedSystem(
            "arm_command_receiver", PandaCommandReceiver(n, POSITION_MODE)
        )
        clock = _AddClock(builder, lcm, "arm_command_clock", self.command, self.command_type)
        builder.Connect(clock, ramp.GetInputPort("time_sent"))
        self._ConnectRobotSide(
            builder, lcm, driver, ramp, commands=commands, status=PandaStatusSender(n)
        )


class MessageClock(LeafSystem):
    """Reads the time of a message.

    .. pydrake_system::

        name: MessageClock
        input_ports:
        - message
        output_ports:
        - time

    * message: abstract LCM message of the type that the system was made for, with a `utime`, us.
    * time: vector of 1, the time in the message, s.
    """

    __slots__ = NO_SLOTS

    def __init__(self, kind: Any) -> None:
        """Declares the system for messages of a type."""
        super().__init__()
        self._message = self.DeclareAbstractInputPort("message", AbstractValue.Make(kind()))
        self.DeclareVectorOutputPort("time", 1, weakly(self._calc), {self._message.ticket()})

    def _calc(self, context: Context, output: BasicVector) -> None:
        output.SetAtIndex(0, self._message.Eval(context).utime / MICROSECONDS)


ARM_MESSAGES: dict[str, IiwaMessages] = {"iiwa": IiwaMessages(), "panda": PandaMessages()}
"""Messages of the drivers that are known, by what an arm's robot.yaml says in `messages`."""


def find_arm_messages(robot: Robot) -> IiwaMessages:
    """Finds the messages that a robot's driver speaks.

    Raises:
        StationError: the robot.yaml names none, or the robot has a gripper for which there are no
            messages.
    """
    kind = robot.arm.messages
    if kind is None:
        raise StationError(
            f"robot.yaml of {robot.arm_model} has no messages; "
            f"expected one of {', '.join(ARM_MESSAGES)} for LCM"
        )
    if kind != "iiwa" and robot.gripper is not None:
        raise StationError(
            f"the hand of a {kind} has no LCM message in Drake; expected a scene without a gripper"
        )
    return ARM_MESSAGES[kind]


def AddGripperMessages(
    builder: DiagramBuilder, lcm: DrakeLcmInterface
) -> tuple[OutputPort, SchunkWsgCommandSender]:
    """Adds the systems that read a gripper's status and send its commands.

    Returns:
        An output port with the positions of the left and right finger, m, and their velocities,
        m/s, (4,); and the sender, with the input ports `position`, the opening, m, and
        `force_limit`, N.
    """
    receiver = builder.AddNamedSystem("gripper_status_receiver", SchunkWsgStatusReceiver())
    _Subscribe(
        builder, lcm, GRIPPER_STATUS, kind=lcmt_schunk_wsg_status, port=receiver.get_input_port()
    )
    fingers = builder.AddNamedSystem("gripper_fingers", MatrixGain(FROM_OPENING))
    builder.Connect(receiver.GetOutputPort("state"), fingers.get_input_port())
    sender = builder.AddNamedSystem("gripper_command_sender", SchunkWsgCommandSender())
    _Publish(
        builder,
        lcm,
        GRIPPER_COMMAND,
        kind=lcmt_schunk_wsg_command,
        port=sender.get_output_port(),
        period=GRIPPER_PERIOD,
    )
    return fingers.get_output_port(), sender


def AddGripperSide(
    builder: DiagramBuilder,
    lcm: DrakeLcmInterface,
    controller: SchunkWsgPositionController,
    state: OutputPort,
    opening: float,
) -> None:
    """Adds what the driver of a real gripper does, to a simulated one.

    Args:
        builder: the builder that has the gripper's controller.
        lcm: LCM on which the gripper speaks.
        controller: moves the simulated gripper.
        state: (4,) positions of its fingers, m, and their velocities, m/s.
        opening: opening until the first command, m.
    """
    commands = builder.AddNamedSystem("gripper_command_receiver", SchunkWsgCommandReceiver(opening))
    _Subscribe(
        builder,
        lcm,
        GRIPPER_COMMAND,
        kind=lcmt_schunk_wsg_command,
        port=commands.GetInputPort("command_message"),
    )
    builder.Connect(
        commands.GetOutputPort("position"), controller.get_desired_position_input_port()
    )
    builder.Connect(commands.GetOutputPort("force_limit"), controller.get_force_limit_input_port())
    wsg_state = builder.AddNamedSystem("gripper_opening", MakeMultibodyStateToWsgStateSystem())
    builder.Connect(state, wsg_state.get_input_port())
    status = builder.AddNamedSystem("gripper_status_sender", SchunkWsgStatusSender())
    builder.Connect(wsg_state.get_output_port(), status.get_state_input_port())
    builder.Connect(controller.get_grip_force_output_port(), status.get_force_input_port())
    _Publish(
        builder,
        lcm,
        GRIPPER_STATUS,
        kind=lcmt_schunk_wsg_status,
        port=status.get_output_port(0),
        period=GRIPPER_PERIOD,
    )


def name_object_channel(number: int) -> str:
    """Names the channel of an object's pose, by its number.

    Args:
        number: 0 for the scenario's `object`, and 1 and so on for its `others`, whose channels are
            called after the station's ports, `other_0.pose` and so on.
    """
    return OBJECT_STATUS if number == 0 else f"{OBJECT_STATUS}_OTHER_{number - 1}"


def name_object_channels(others: int) -> list[str]:
    """Names the channels of the poses of a scenario's `object` and of as many others."""
    return [name_object_channel(number) for number in range(others + 1)]


def AddObjectReceiver(
    builder: DiagramBuilder,
    lcm: DrakeLcmInterface,
    time: OutputPort,
    delay: float,
    number: int = 0,
) -> tuple[OutputPort, OutputPort]:
    """Adds the systems that read where an object is.

    Args:
        builder: the builder that has the time's system.
        lcm: LCM on which the object's pose is said.
        time: (1,) time by the clock of the messages, s.
        delay: age of the pose that the executor and the identifier get, s; always the same, so that
            the identifier knows it.
        number: the object's number, see `name_object_channel`.

    Returns:
        Output ports with the pose (3,) of that age, and with the newest pose, m and rad.
    """
    channel = name_object_channel(number)
    name = "camera" if number == 0 else f"camera_{number}"
    receiver = builder.AddNamedSystem(
        name, PlanarManipulandStatusReceiver(ARM_PERIOD, OBJECT_MAX_AGE, delay)
    )
    builder.Connect(time, receiver.GetInputPort("time"))
    subscriber = LcmSubscriberSystem.Make(channel, lcmt_planar_manipuland_status, lcm)
    builder.AddNamedSystem(f"{channel}_subscriber", subscriber)
    builder.Connect(subscriber.get_output_port(), receiver.GetInputPort("message"))
    return receiver.GetOutputPort("object_pose"), receiver.GetOutputPort("newest_pose")


def AddObjectSender(
    builder: DiagramBuilder,
    lcm: DrakeLcmInterface,
    pose: OutputPort,
    period: float,
    offset: float,
    number: int = 0,
) -> None:
    """Adds the systems that say where an object is seen.

    Args:
        builder: the builder that has the camera.
        lcm: LCM on which the pose is said.
        pose: (3,) X_WB of the object as seen, m and rad.
        period: time between two messages, s.
        offset: time of the first message, s.
        number: the object's number, see `name_object_channel`.
    """
    channel = name_object_channel(number)
    sender = builder.AddNamedSystem(f"{channel}_sender", PlanarManipulandStatusSender())
    builder.Connect(pose, sender.get_input_port())
    publisher = LcmPublisherSystem.Make(
        channel,
        lcmt_planar_manipuland_status,
        lcm,
        publish_period=period,
        publish_offset=offset,
    )
    builder.AddNamedSystem(f"{channel}_publisher", publisher)
    builder.Connect(sender.get_output_port(), publisher.get_input_port())


def _AddClock(
    builder: DiagramBuilder, lcm: DrakeLcmInterface, name: str, channel: str, kind: Any
) -> OutputPort:
    """Adds the systems that read the time of a channel's messages, s."""
    clock = builder.AddNamedSystem(name, MessageClock(kind))
    subscriber = builder.AddNamedSystem(
        f"{name}_subscriber", LcmSubscriberSystem.Make(channel, kind, lcm)
    )
    builder.Connect(subscriber.get_output_port(), clock.get_input_port())
    return clock.get_output_port()


def _Subscribe(
    builder: DiagramBuilder, lcm: DrakeLcmInterface, channel: str, kind: Any, port: InputPort
) -> None:
    """Has a channel's messages, of Drake's own type `kind`, come in at a port."""
    subscriber = LcmSubscriberSystem.Make(channel, kind, lcm, use_cpp_serializer=True)
    builder.AddNamedSystem(f"{channel}_subscriber", subscriber)
    builder.Connect(subscriber.get_output_port(), port)


def _Publish(
    builder: DiagramBuilder,
    lcm: DrakeLcmInterface,
    channel: str,
    kind: Any,
    port: OutputPort,
    period: float,
) -> None:
    """Has what is on a port published on a channel, as messages of Drake's own type `kind`."""
    publisher = LcmPublisherSystem.Make(
        channel, kind, lcm, publish_period=period, use_cpp_serializer=True
    )
    builder.AddNamedSystem(f"{channel}_publisher", publisher)
    builder.Connect(port, publisher.get_input_port())
