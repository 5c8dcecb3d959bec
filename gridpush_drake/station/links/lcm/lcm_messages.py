"""The LCM messages of Drake's drivers, and how records are made of them and they of records.

An arm's messages depend on its driver (`ARM_MESSAGES`); gripper and tracked object have messages of
their own, and so have pictures, see `picture_messages`. Numbers that are none are refused here by
the names that the message has for them; what else a record must be is said in `record_forms`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from io import BytesIO
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
from pydrake.manipulation import PandaControlMode

from gridpush_drake.errors import StationError
from gridpush_drake.station.robot.robot import Robot
from gridpush_drake.systems.robot_records import (
    ArmCommand,
    ArmStatus,
    GripperCommand,
    GripperStatus,
    Numbers,
    PoseObservation,
)
from gridpush_drake.units import MM_PER_M

MICROSECONDS = 1e6
"""Microseconds in a second."""

GRIPPER_STATUS = "SCHUNK_WSG_STATUS"
"""Channel of a gripper's status, `lcmt_schunk_wsg_status`, as Drake's driver names it."""

GRIPPER_COMMAND = "SCHUNK_WSG_COMMAND"
"""Channel of a gripper's command, `lcmt_schunk_wsg_command`, as Drake's driver names it."""

OBJECT_STATUS = "PLANAR_MANIPULAND_STATUS"
"""Channel of the object's pose, `lcmt_planar_manipuland_status`; the name is this package's own.
Those of the other objects on the table are named by `name_object_channel`."""

PICTURES = "DRAKE_RGBD_CAMERA_IMAGES"
"""Channel of a camera's color and depth, `lcmt_image_array`, as Drake's examples name it."""

POSITION_MODE = int(PandaControlMode.kPosition)
"""The mode in which a Panda is commanded: by joint positions."""

LARGEST_NUMBER = 1e6
"""Greatest magnitude of a number in a message, in whatever unit; none that is measured is as large.
Bounds of the numbers that are used are in `record_forms`."""


@dataclass(frozen=True)
class ArmMessages:
    """The messages that an arm's driver speaks.

    Attributes:
        status: channel of the arm's status.
        command: channel of the arm's command.
        status_type: type of the status.
        command_type: type of the command.
        fields: the status's names of the numbers in an `ArmStatus`.
        count: the command's field for the number of positions.
        modes: fields of the command that must have one value, which says how the arm is moved.
    """

    status: str
    command: str
    status_type: Any
    command_type: Any
    fields: Mapping[str, str]
    count: str
    modes: Mapping[str, int] = field(default_factory=dict)

    def encode_status(self, record: ArmStatus) -> bytes:
        """Makes the message of a status; what the status does not say is 0."""
        message = self.status_type()
        message.utime = calc_utime(record.time)
        message.num_joints = len(record.position)
        for name in message.__slots__:
            if isinstance(getattr(message, name), list):
                setattr(message, name, [0.0] * message.num_joints)
        for own, name in self.fields.items():
            numbers = getattr(record, own)
            if numbers is not None:
                setattr(message, name, _list(numbers))
        return bytes(message.encode())

    def decode_status(self, data: bytes) -> ArmStatus:
        """Makes a status of its message; raises StationError where that cannot be done."""
        message = decode_message(self.status_type, self.status, data)
        numbers = {own: getattr(message, name) for own, name in self.fields.items()}
        return ArmStatus(time=message.utime / MICROSECONDS, **numbers)

    def encode_command(self, record: ArmCommand) -> bytes:
        """Makes the message of a command."""
        message = self.command_type()
        message.utime = calc_utime(record.time)
        message.joint_position = _list(record.position)
        setattr(message, self.count, len(message.joint_position))
        for name, mode in self.modes.items():
            setattr(message, name, mode)
        return bytes(message.encode())

    def decode_command(self, data: bytes) -> ArmCommand:
        """Makes a command of its message; raises StationError where that cannot be done."""
        message = decode_message(self.command_type, self.command, data)
        for name, mode in self.modes.items():
            if getattr(message, name) != mode:
                raise StationError(f"{self.command}: {name} is another mode; expected {mode}")
        return ArmCommand(message.utime / MICROSECONDS, message.joint_position)


IIWA = ArmMessages(
    status="IIWA_STATUS",
    command="IIWA_COMMAND",
    status_type=lcmt_iiwa_status,
    command_type=lcmt_iiwa_command,
    fields={
        "position": "joint_position_measured",
        "velocity": "joint_velocity_estimated",
        "torque_external": "joint_torque_external",
        "position_commanded": "joint_position_commanded",
        "torque_commanded": "joint_torque_commanded",
        "torque_measured": "joint_torque_measured",
    },
    count="num_joints",
)
"""The messages that drake-iiwa-driver speaks."""

PANDA = ArmMessages(
    status="PANDA_STATUS",
    command="PANDA_COMMAND",
    status_type=lcmt_panda_status,
    command_type=lcmt_panda_command,
    fields={
        "position": "joint_position",
        "velocity": "joint_velocity",
        "torque_external": "joint_torque_external",
        "position_commanded": "joint_position_desired",
        "torque_commanded": "joint_torque_desired",
        "torque_measured": "joint_torque",
    },
    count="num_joint_position",
    modes={"control_mode_expected": POSITION_MODE},
)
"""The messages that drake-franka-driver speaks, commanded by positions."""

ARM_MESSAGES = {"iiwa": IIWA, "panda": PANDA}
"""Messages of the drivers that are known, by what an arm's robot.yaml says in `messages`."""


def find_arm_messages(robot: Robot) -> ArmMessages:
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


def name_object_channel(number: int) -> str:
    """Names the channel of an object's pose, by its number.

    Args:
        number: 0 for the scenario's `object`, and 1 and so on for its `others`, whose channels are
            called after the station's ports, `other_0.pose` and so on.
    """
    return OBJECT_STATUS if number == 0 else f"{OBJECT_STATUS}_OTHER_{number - 1}"


def calc_utime(time: float) -> int:
    """Calculates a message's time, whole microseconds, of a time, s."""
    return round(MICROSECONDS * time)


def decode_message(kind: Any, channel: str, data: bytes) -> Any:
    """Decodes a message of a channel.

    Raises:
        StationError: the message is of another type, is cut short, has more bytes than its fields,
            or a number in it is not finite or too large.
    """
    stream = BytesIO(data)
    try:
        message = kind.decode(stream)
    except Exception as error:  # whatever the bytes make of it
        raise StationError(f"{channel} is not {kind.__name__}, or not whole") from error
    if stream.tell() != len(data):
        raise StationError(f"{channel} is not {kind.__name__}: it is longer than its fields")
    for name in message.__slots__:
        fault = _find_number_fault(getattr(message, name), kind is lcmt_planar_manipuland_status)
        if fault:
            raise StationError(f"{channel}: {name} {fault}")
    return message


def _find_number_fault(value: Any, unknown: bool) -> str:
    """Says what is wrong with the numbers in a field; empty if nothing is.

    Args:
        value: a number, several, or something else.
        unknown: whether NaN may stand for what the sender does not know.
    """
    for number in value if isinstance(value, Sequence) else (value,):
        if not isinstance(number, float) or abs(number) <= LARGEST_NUMBER:
            continue
        if not np.isfinite(number):
            if not (unknown and np.isnan(number)):
                return "is not finite"
        else:
            return f"is beyond all measure; expected at most {LARGEST_NUMBER:g}"
    return ""


def encode_gripper_status(record: GripperStatus) -> bytes:
    """Makes the message of a gripper's status."""
    message = lcmt_schunk_wsg_status()
    message.utime = calc_utime(record.time)
    message.actual_position_mm = MM_PER_M * record.opening
    message.actual_speed_mm_per_s = MM_PER_M * record.speed
    message.actual_force = float(record.force)
    return bytes(message.encode())


def decode_gripper_status(data: bytes) -> GripperStatus:
    """Makes a gripper's status of its message; raises StationError where that cannot be done."""
    message = decode_message(lcmt_schunk_wsg_status, GRIPPER_STATUS, data)
    return GripperStatus(
        time=message.utime / MICROSECONDS,
        opening=message.actual_position_mm / MM_PER_M,
        speed=message.actual_speed_mm_per_s / MM_PER_M,
        force=message.actual_force,
    )


def encode_gripper_command(record: GripperCommand) -> bytes:
    """Makes the message of a gripper's command."""
    message = lcmt_schunk_wsg_command()
    message.utime = calc_utime(record.time)
    message.target_position_mm = MM_PER_M * record.opening
    message.force = float(record.force)
    return bytes(message.encode())


def decode_gripper_command(data: bytes) -> GripperCommand:
    """Makes a gripper's command of its message; raises StationError where that cannot be done."""
    message = decode_message(lcmt_schunk_wsg_command, GRIPPER_COMMAND, data)
    opening = message.target_position_mm / MM_PER_M
    return GripperCommand(message.utime / MICROSECONDS, opening, message.force)


def encode_pose(record: PoseObservation) -> bytes:
    """Makes the message of an object's pose; its velocities are 0."""
    message = lcmt_planar_manipuland_status()
    message.utime = calc_utime(record.time)
    *message.position, message.theta = _list(record.pose)
    return bytes(message.encode())


def decode_pose(data: bytes, number: int) -> PoseObservation:
    """Makes the observation of an object of its message, by the object's number.

    Raises:
        StationError: that cannot be done.
    """
    channel = name_object_channel(number)
    message = decode_message(lcmt_planar_manipuland_status, channel, data)
    pose = (*message.position, message.theta)
    return PoseObservation(message.utime / MICROSECONDS, pose, number)


def _list(numbers: Numbers) -> list[float]:
    return np.asarray(numbers, dtype=np.float64).ravel().tolist()
