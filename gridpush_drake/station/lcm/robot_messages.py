"""The LCM messages that robots and this package exchange: which, on which channel, how often; and what makes them.

An arm's driver says which messages it speaks (`ARM_MESSAGES`); gripper and tracked object have
messages of their own.
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

ARM_PERIOD = 0.005
"""Between two statuses of an arm, and between two commands, s: what drake-iiwa-driver keeps."""

GRIPPER_PERIOD = 0.05
"""Between two statuses of a gripper, and between two commands, s."""

GRIPPER_STATUS, GRIPPER_COMMAND = "SCHUNK_WSG_STATUS", "SCHUNK_WSG_COMMAND"

OBJECT_STATUS = "PLANAR_MANIPULAND_STATUS"
"""Channels, as Drake's drivers name them; that of the object is this package's."""

PICTURES = "DRAKE_RGBD_CAMERA_IMAGES"
"""Channel of a camera's color and depth, `lcmt_image_array`, as Drake's examples name it."""

OBJECT_MAX_AGE = 0.5
"""Since the last message of the object, after which it is not seen, s."""

POSITION_MODE = PandaControlMode.kPosition

FROM_OPENING = np.array([[-0.5, 0.0], [0.5, 0.0], [0.0, -0.5], [0.0, 0.5]])
"""From a gripper's opening, m, and its velocity to its fingers' positions and velocities."""


@dataclass(frozen=True)
class IiwaMessages:
    """What drake-iiwa-driver speaks.

    Attributes:
        status: channel of `lcmt_iiwa_status`.
        command: channel of `lcmt_iiwa_command`.
    """

    status: str = "IIWA_STATUS"
    command: str = "IIWA_COMMAND"
    status_type: Any = lcmt_iiwa_status
    command_type: Any = lcmt_iiwa_command

    def count_joints(self, message: Any) -> int:
        """How many joints a status speaks of."""
        return int(message.num_joints)

    def find_fault(self, message: Any, n: int) -> str:
        """Says that a status is of another robot than one of n joints; empty where it is not.

        What else may be wrong with its form is told by `find_form_fault`.
        """
        joints = self.count_joints(message)
        if joints == n:
            return ""
        return f"{self.status} speaks of {joints} joints; expected {n}, as the scenario's robot has"

    def read_joints(self, message: Any) -> Sequence[float]:
        """The measured positions in a status, rad."""
        return tuple(message.joint_position_measured)

    def is_finite(self, command: Any) -> bool:
        """Whether a command is one: all its numbers are finite, and it has some."""
        return len(command.joint_position) > 0 and bool(np.isfinite(command.joint_position).all())

    def AddStatusReceiver(
        self, builder: DiagramBuilder, lcm: DrakeLcmInterface, n: int
    ) -> dict[str, OutputPort]:
        """Adds what reads the status of n joints; returns its ports by the names that a `SimIiwaDriver` uses."""
        receiver = builder.AddNamedSystem("arm_status_receiver", IiwaStatusReceiver(n))
        _Subscribe(builder, lcm, self.status, self.status_type, receiver.get_input_port())
        return {
            port.get_name(): port
            for port in map(receiver.get_output_port, range(receiver.num_output_ports()))
        }

    def AddCommandSender(
        self, builder: DiagramBuilder, lcm: DrakeLcmInterface, n: int
    ) -> InputPort:
        """Adds what sends commands; returns the port for the positions of the n joints."""
        sender = builder.AddNamedSystem("arm_command_sender", IiwaCommandSender(n))
        _Publish(
            builder, lcm, self.command, self.command_type, sender.get_output_port(), ARM_PERIOD
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
        """Adds what a robot's driver does: makes statuses of its ports, by name, and feeds a ramp with commands.

        Until the first command the arm stays where it is.
        """
        commands = builder.AddNamedSystem("arm_command_receiver", IiwaCommandReceiver(n))
        builder.Connect(commands.GetOutputPort("time"), ramp.GetInputPort("time_sent"))
        self._ConnectRobotSide(builder, lcm, driver, ramp, commands, IiwaStatusSender(n))

    def _ConnectRobotSide(
        self,
        builder: DiagramBuilder,
        lcm: DrakeLcmInterface,
        driver: dict[str, OutputPort],
        ramp: CommandRamp,
        commands: System,
        status: System,
    ) -> None:
        _Subscribe(
            builder,
            lcm,
            self.command,
            self.command_type,
            commands.GetInputPort(self.command_type.__name__),
        )
        builder.Connect(driver["position_measured"], commands.GetInputPort("position_measured"))
        builder.Connect(commands.GetOutputPort("position"), ramp.GetInputPort("position_desired"))
        builder.AddNamedSystem("arm_status_sender", status)
        for port in map(status.get_input_port, range(status.num_input_ports())):
            name = PANDA_NAMES.get(port.get_name(), port.get_name())
            if name in driver:
                builder.Connect(driver[name], port)
        _Publish(builder, lcm, self.status, self.status_type, status.get_output_port(), ARM_PERIOD)


PANDA_NAMES = {"velocity_measured": "velocity_estimated"}
"""Names that an iiwa's ports have, by those that a Panda's have where they differ."""


@dataclass(frozen=True)
class PandaMessages(IiwaMessages):
    """What drake-franka-driver speaks, in its mode of positions; see `IiwaMessages`."""

    status: str = "PANDA_STATUS"
    command: str = "PANDA_COMMAND"
    status_type: Any = lcmt_panda_status
    command_type: Any = lcmt_panda_command

    def read_joints(self, message: Any) -> Sequence[float]:
        """The measured positions in a status, rad."""
        return tuple(message.joint_position)

    def AddStatusReceiver(
        self, builder: DiagramBuilder, lcm: DrakeLcmInterface, n: int
    ) -> dict[str, OutputPort]:
        """Adds what reads the status of n joints; returns its ports by the names that a `SimIiwaDriver` uses.

        Drake's receiver has no port for the time of the status, which is read from the message.
        """
        receiver = builder.AddNamedSystem("arm_status_receiver", PandaStatusReceiver(n))
        _Subscribe(builder, lcm, self.status, self.status_type, receiver.get_input_port())
        clock = _AddClock(builder, lcm, "arm_status_clock", self.status, self.status_type)
        ports = map(receiver.get_output_port, range(receiver.num_output_ports()))
        named = {PANDA_NAMES.get(port.get_name(), port.get_name()): port for port in ports}
        return named | {"time_measured": clock}

    def AddCommandSender(
        self, builder: DiagramBuilder, lcm: DrakeLcmInterface, n: int
    ) -> InputPort:
        """Adds what sends commands; returns the port for the positions of the n joints."""
        sender = builder.AddNamedSystem("arm_command_sender", PandaCommandSender(n, POSITION_MODE))
        _Publish(
            builder, lcm, self.command, self.command_type, sender.get_output_port(), ARM_PERIOD
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
        """Adds what a robot's driver does, see `IiwaMessages.AddRobotSide`.

        Drake's receiver has no port for the time of the command, which is read from the message.
        """
        commands = builder.AddNamedSystem(
            "arm_command_receiver", PandaCommandReceiver(n, POSITION_MODE)
        )
        clock = _AddClock(builder, lcm, "arm_command_clock", self.command, self.command_type)
        builder.Connect(clock, ramp.GetInputPort("time_sent"))
        self._ConnectRobotSide(builder, lcm, driver, ramp, commands, PandaStatusSender(n))


class MessageClock(LeafSystem):
    """Reads the time of a message.

    .. pydrake_system::

        name: MessageClock
        input_ports:
        - message
        output_ports:
        - time

    * message: abstract, of the kind it was made for, with a `utime`, us.
    * time: vector of 1, that, s.
    """

    __slots__ = NO_SLOTS

    def __init__(self, kind: Any) -> None:
        """Takes messages of a kind."""
        super().__init__()
        self._message = self.DeclareAbstractInputPort("message", AbstractValue.Make(kind()))
        self.DeclareVectorOutputPort("time", 1, weakly(self._calc), {self._message.ticket()})

    def _calc(self, context: Context, output: BasicVector) -> None:
        output.SetAtIndex(0, self._message.Eval(context).utime / MICROSECONDS)


ARM_MESSAGES: dict[str, IiwaMessages] = {"iiwa": IiwaMessages(), "panda": PandaMessages()}
"""By what an arm's robot.yaml says of its `messages`."""


def find_arm_messages(robot: Robot) -> IiwaMessages:
    """What a robot's driver speaks. Raises StationError where nobody knows, or there is a hand that none can move."""
    kind = robot.arm.messages
    if kind is None:
        raise StationError(
            f"robot.yaml of {robot.arm_model} has no messages; expected one of {', '.join(ARM_MESSAGES)} for LCM"
        )
    if kind != "iiwa" and robot.gripper is not None:
        raise StationError(
            f"the hand of a {kind} has no LCM message in Drake; expected a scene without a gripper"
        )
    return ARM_MESSAGES[kind]


def AddGripperMessages(
    builder: DiagramBuilder, lcm: DrakeLcmInterface
) -> tuple[OutputPort, SchunkWsgCommandSender]:
    """Adds what reads a gripper's status and sends its commands.

    Returns:
        The fingers' positions, left and right, m, and velocities, m/s, (4,); and the sender, with
        the input ports `position`, the opening, m, and `force_limit`, N.
    """
    receiver = builder.AddNamedSystem("gripper_status_receiver", SchunkWsgStatusReceiver())
    _Subscribe(builder, lcm, GRIPPER_STATUS, lcmt_schunk_wsg_status, receiver.get_input_port())
    fingers = builder.AddNamedSystem("gripper_fingers", MatrixGain(FROM_OPENING))
    builder.Connect(receiver.GetOutputPort("state"), fingers.get_input_port())
    sender = builder.AddNamedSystem("gripper_command_sender", SchunkWsgCommandSender())
    _Publish(
        builder,
        lcm,
        GRIPPER_COMMAND,
        lcmt_schunk_wsg_command,
        sender.get_output_port(),
        GRIPPER_PERIOD,
    )
    return fingers.get_output_port(), sender


def AddGripperSide(
    builder: DiagramBuilder,
    lcm: DrakeLcmInterface,
    controller: SchunkWsgPositionController,
    state: OutputPort,
    opening: float,
) -> None:
    """Adds what a gripper's driver does, for a simulated one.

    Args:
        builder: the gripper's controller is in it.
        lcm: on which it speaks.
        controller: moves the gripper.
        state: (4,) of the fingers.
        opening: until the first command, m.
    """
    commands = builder.AddNamedSystem("gripper_command_receiver", SchunkWsgCommandReceiver(opening))
    _Subscribe(
        builder,
        lcm,
        GRIPPER_COMMAND,
        lcmt_schunk_wsg_command,
        commands.GetInputPort("command_message"),
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
        lcmt_schunk_wsg_status,
        status.get_output_port(0),
        GRIPPER_PERIOD,
    )


def AddObjectReceiver(
    builder: DiagramBuilder, lcm: DrakeLcmInterface, time: OutputPort, delay: float
) -> tuple[OutputPort, OutputPort]:
    """Adds what reads where the object is.

    Args:
        builder: the time's system is in it.
        lcm: on which it is said.
        time: by the clock of the messages, s.
        delay: how old a pose is told, s.

    Returns:
        The ports with its pose (3,) so long ago, and with the newest, m and rad.
    """
    receiver = builder.AddNamedSystem(
        "camera", PlanarManipulandStatusReceiver(ARM_PERIOD, OBJECT_MAX_AGE, delay)
    )
    builder.Connect(time, receiver.GetInputPort("time"))
    subscriber = LcmSubscriberSystem.Make(OBJECT_STATUS, lcmt_planar_manipuland_status, lcm)
    builder.AddNamedSystem("object_subscriber", subscriber)
    builder.Connect(subscriber.get_output_port(), receiver.GetInputPort("message"))
    return receiver.GetOutputPort("object_pose"), receiver.GetOutputPort("newest_pose")


def AddObjectSender(
    builder: DiagramBuilder, lcm: DrakeLcmInterface, pose: OutputPort, period: float, offset: float
) -> None:
    """Adds what says where an object is seen.

    Args:
        builder: the camera is in it.
        lcm: on which it is said.
        pose: (3,) of the object as seen, m and rad.
        period: between two messages, s.
        offset: of the first, s.
    """
    sender = builder.AddNamedSystem("object_status_sender", PlanarManipulandStatusSender())
    builder.Connect(pose, sender.get_input_port())
    publisher = LcmPublisherSystem.Make(
        OBJECT_STATUS,
        lcmt_planar_manipuland_status,
        lcm,
        publish_period=period,
        publish_offset=offset,
    )
    builder.AddNamedSystem("object_publisher", publisher)
    builder.Connect(sender.get_output_port(), publisher.get_input_port())


def _AddClock(
    builder: DiagramBuilder, lcm: DrakeLcmInterface, name: str, channel: str, kind: Any
) -> OutputPort:
    """Adds what reads the time of a channel's messages, s."""
    clock = builder.AddNamedSystem(name, MessageClock(kind))
    subscriber = builder.AddNamedSystem(
        f"{name}_subscriber", LcmSubscriberSystem.Make(channel, kind, lcm)
    )
    builder.Connect(subscriber.get_output_port(), clock.get_input_port())
    return clock.get_output_port()


def _Subscribe(
    builder: DiagramBuilder, lcm: DrakeLcmInterface, channel: str, kind: Any, port: InputPort
) -> None:
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
    publisher = LcmPublisherSystem.Make(
        channel, kind, lcm, publish_period=period, use_cpp_serializer=True
    )
    builder.AddNamedSystem(f"{channel}_publisher", publisher)
    builder.Connect(port, publisher.get_input_port())
