"""The form that an LCM message of each type must have to be used.

Every message that this package reads is checked here before anything else sees it. A number that is
not finite, or larger than anything that can be measured, would end in an assertion of Drake's or in
a simulation of NaN. Whether a message is *true* is not decided here: that is what `ArmGuard` is
for. Pictures are checked in `picture_messages`, where they are decoded.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from typing import Any

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

FindFault = Callable[[Any], str]
"""A function that says why a message cannot be used; empty if it can. Its words are the same for
all messages with the same fault, so that these can be counted."""


@dataclass(frozen=True)
class Numbers:
    """Bounds of the numbers in a field of a message.

    Attributes:
        largest: greatest magnitude, in the field's own unit.
        unit: unit of the field, for the words to the user.
        per_joint: whether the field has one number for each of the arm's joints.
        optional: whether a field with a number for each joint may be empty instead.
        unknown: whether NaN may stand for what the sender does not know.
    """

    largest: float
    unit: str
    per_joint: bool = False
    optional: bool = False
    unknown: bool = False


JOINT_POSITION = Numbers(1e3, "rad", per_joint=True)
JOINT_VELOCITY = Numbers(1e3, "rad/s", per_joint=True)
JOINT_ACCELERATION = Numbers(1e6, "rad/s²", per_joint=True)
JOINT_TORQUE = Numbers(1e6, "N m", per_joint=True)
UNUSED_VELOCITY = Numbers(1e3, "rad/s", per_joint=True, optional=True)
UNUSED_TORQUE = Numbers(1e6, "N m", per_joint=True, optional=True)
OPENING = Numbers(1e4, "mm")
OPENING_SPEED = Numbers(1e6, "mm/s")
FORCE = Numbers(1e6, "N")
SHARE = Numbers(1e3, "of 1")
PLACE = Numbers(1e3, "m", unknown=True)
TURN = Numbers(1e4, "rad", unknown=True)
SPEED = Numbers(1e3, "m/s", unknown=True)
TURN_SPEED = Numbers(1e4, "rad/s", unknown=True)
"""Kinds of numbers in messages. The greatest magnitudes are far beyond those of any robot or table,
and small enough for every calculation with them."""

FORMS: Mapping[type, Mapping[str, Numbers]] = {
    lcmt_iiwa_status: {
        "joint_position_measured": JOINT_POSITION,
        "joint_velocity_estimated": JOINT_VELOCITY,
        "joint_position_commanded": JOINT_POSITION,
        "joint_position_ipo": JOINT_POSITION,
        "joint_torque_measured": JOINT_TORQUE,
        "joint_torque_commanded": JOINT_TORQUE,
        "joint_torque_external": JOINT_TORQUE,
    },
    lcmt_panda_status: {
        "joint_position": JOINT_POSITION,
        "joint_position_desired": JOINT_POSITION,
        "joint_velocity": JOINT_VELOCITY,
        "joint_velocity_desired": JOINT_VELOCITY,
        "joint_acceleration_desired": JOINT_ACCELERATION,
        "joint_torque": JOINT_TORQUE,
        "joint_torque_desired": JOINT_TORQUE,
        "joint_torque_external": JOINT_TORQUE,
        "control_command_success_rate": SHARE,
    },
    lcmt_schunk_wsg_status: {
        "actual_position_mm": OPENING,
        "actual_force": FORCE,
        "actual_speed_mm_per_s": OPENING_SPEED,
    },
    lcmt_planar_manipuland_status: {
        "position": PLACE,
        "theta": TURN,
        "velocity": SPEED,
        "thetadot": TURN_SPEED,
    },
    lcmt_iiwa_command: {"joint_position": JOINT_POSITION, "joint_torque": UNUSED_TORQUE},
    lcmt_panda_command: {
        "joint_position": JOINT_POSITION,
        "joint_velocity": UNUSED_VELOCITY,
        "joint_torque": UNUSED_TORQUE,
    },
    lcmt_schunk_wsg_command: {"target_position_mm": OPENING, "force": FORCE},
}
"""Kinds of the numbers in each type of message, by the fields' names. `Channel` checks `utime`."""


MODES: Mapping[type, tuple[str, int]] = {
    lcmt_panda_command: ("control_mode_expected", int(PandaControlMode.kPosition)),
}
"""Types of messages that say in which mode the arm is moved: the field, and the one mode that is
understood here."""


def decode_message(kind: Any, channel: str, data: bytes) -> Any:
    """Decodes a message of a channel.

    Raises:
        StationError: the message is of another type, is cut short, or has more bytes than its
            fields. Drake's own subscribers would end the process over it.
    """
    stream = BytesIO(data)
    try:
        message = kind.decode(stream)
    except Exception as error:  # whatever the bytes make of it
        raise StationError(f"{channel} is not {kind.__name__}, or not whole") from error
    if stream.tell() != len(data):
        raise StationError(f"{channel} is not {kind.__name__}: it is longer than its fields")
    return message


def find_form_fault(message: Any, channel: str, joints: int = 0) -> str:
    """Says what is wrong with the form of a message.

    Args:
        message: a message of one of the types in `FORMS`.
        channel: name of the channel on which it came.
        joints: number of the arm's joints, if the message is about an arm.

    Returns:
        The first field that is not what it should be, and what was expected; empty if all are.
    """
    if message.utime < 0:
        return f"{channel}: utime is negative; expected the sender's clock in microseconds"
    field, mode = MODES.get(type(message), ("", 0))
    if field and getattr(message, field) != mode:
        return f"{channel}: {field} is another mode; expected {mode}"
    for name, numbers in FORMS[type(message)].items():
        value = getattr(message, name)
        values: Sequence[float] = value if isinstance(value, Sequence) else (value,)
        fault = _find_number_fault(values, numbers, joints)
        if fault:
            return f"{channel}: {name} {fault}"
    return ""


def _find_number_fault(values: Sequence[float], numbers: Numbers, joints: int) -> str:
    """Says what is wrong with the numbers in a field; empty if nothing is."""
    missing = numbers.optional and not values
    if numbers.per_joint and len(values) != joints and not missing:
        return f"is of another number of joints; expected {joints}"
    for value in values:
        if math.isnan(value) and numbers.unknown:
            continue
        if not math.isfinite(value):
            return "is not finite"
        if abs(value) > numbers.largest:
            return f"is beyond all measure; expected at most {numbers.largest:g} {numbers.unit}"
    return ""
