"""The form that a record of each type must have to be used, whatever link it came over.

A number that is not finite, or larger than anything that can be measured, would end in an assertion
of Drake's or in a simulation of NaN. Whether a record is *true* is not decided here: that is what
`ArmGuard` is for.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from gridpush_drake.perception.images.camera import Camera
from gridpush_drake.perception.images.frames import Frame
from gridpush_drake.systems.robot_records import (
    ArmCommand,
    ArmStatus,
    GripperCommand,
    GripperStatus,
    PoseObservation,
)


@dataclass(frozen=True)
class NumberForm:
    """Bounds of the numbers in a field of a record.

    Attributes:
        largest: greatest magnitude, in the field's own unit.
        unit: unit of the field, for the words to the user.
        count: how many numbers there are; None for one for each of the arm's joints.
        optional: whether the field may be None instead.
        unknown: whether NaN may stand for what the sender does not know.
    """

    largest: float
    unit: str
    count: int | None = None
    optional: bool = False
    unknown: bool = False


TIME = NumberForm(1e12, "s", count=1)
JOINT_POSITION = NumberForm(1e3, "rad")
JOINT_POSITION_IF_KNOWN = NumberForm(1e3, "rad", optional=True)
JOINT_VELOCITY = NumberForm(1e3, "rad/s")
JOINT_TORQUE = NumberForm(1e6, "N m")
JOINT_TORQUE_IF_KNOWN = NumberForm(1e6, "N m", optional=True)
OPENING = NumberForm(1e1, "m", count=1)
OPENING_SPEED = NumberForm(1e3, "m/s", count=1)
FORCE = NumberForm(1e6, "N", count=1)
POSE = NumberForm(1e4, "m or rad", count=3, unknown=True)
"""Kinds of numbers in records. The greatest magnitudes are far beyond those of any robot or table,
and small enough for every calculation with them."""

FORMS: Mapping[type, Mapping[str, NumberForm]] = {
    ArmStatus: {
        "position": JOINT_POSITION,
        "velocity": JOINT_VELOCITY,
        "torque_external": JOINT_TORQUE,
        "position_commanded": JOINT_POSITION_IF_KNOWN,
        "torque_commanded": JOINT_TORQUE_IF_KNOWN,
        "torque_measured": JOINT_TORQUE_IF_KNOWN,
    },
    GripperStatus: {"opening": OPENING, "speed": OPENING_SPEED, "force": FORCE},
    PoseObservation: {"pose": POSE},
    ArmCommand: {"position": JOINT_POSITION},
    GripperCommand: {"opening": OPENING, "force": FORCE},
}
"""Forms of the numbers in each type of record, by the fields' names."""


def find_form_fault(record: Any, name: str, joints: int = 0) -> str:
    """Says what is wrong with the form of a record.

    Args:
        record: a record of one of the types in `FORMS`.
        name: what the network calls such records, for the words.
        joints: number of the arm's joints, if the record is about an arm.

    Returns:
        The first field that is not what it should be, and what was expected, in words that are the
        same for all records with the same fault; empty if all are as they should be.
    """
    fault = _find_number_fault(record.time, TIME, joints)
    if fault:
        return f"{name}: time {fault}"
    if record.time < 0.0:
        return f"{name}: time is negative; expected the sender's clock in seconds"
    other = isinstance(record, ArmStatus) and find_other_robot(record, name, joints)
    if other:
        return other
    for field, form in FORMS[type(record)].items():
        fault = _find_number_fault(getattr(record, field), form, joints)
        if fault:
            return f"{name}: {field} {fault}"
    return ""


def find_other_robot(status: ArmStatus, name: str, joints: int) -> str:
    """Says that a status is of another robot than one of so many joints; empty if it is not."""
    count = np.size(status.position)
    if count == joints:
        return ""
    return f"{name} speaks of {count} joints; expected {joints}, as the scenario's robot has"


def _find_number_fault(value: Any, form: NumberForm, joints: int) -> str:
    """Says what is wrong with the numbers in a field; empty if nothing is."""
    if value is None and form.optional:
        return ""
    try:
        values = np.asarray(value, dtype=np.float64).ravel().tolist()
    except (TypeError, ValueError):  # a record of an SDK may hold anything
        return "holds something else than numbers"
    if form.count is None and len(values) != joints:
        return f"is of another number of joints; expected {joints}"
    if form.count is not None and len(values) != form.count:
        return f"is of another size; expected {form.count}"
    for number in values:
        if math.isnan(number) and form.unknown:
            continue
        if not math.isfinite(number):
            return "is not finite"
        if abs(number) > form.largest:
            return f"is beyond all measure; expected at most {form.largest:g} {form.unit}"
    return ""


def find_frame_fault(frame: Frame, name: str, camera: Camera) -> str:
    """Says what is wrong with a picture for those who know its camera; empty if nothing is."""
    size = (camera.height, camera.width)
    images: dict[str, tuple[Any, tuple[int, ...], type]] = {
        "color": (frame.color, (*size, len("rgb")), np.uint8)
    }
    if frame.depth is not None:
        images["depth"] = (frame.depth, size, np.float32)
    for field, (image, shape, kind) in images.items():
        if np.shape(image) != shape or image.dtype != kind:
            expected = f"{camera.width} x {camera.height} pixels of {np.dtype(kind)}"
            return f"{name}: {field} has another form; expected {expected}, as the camera's"
    return "" if math.isfinite(frame.t) else f"{name}: t is not finite"
