"""`LinkBus`: a link in the place of LCM, for `HardwareLink`, `TwinLink` and `PictureTracker`.

Inside, station, twin and tracker speak LCM messages, whatever is outside. The bus makes a message
of each record that comes in, and a record of each message that goes out. So whatever comes over any
link passes the same `Channel`, with the same checks of form, order and clock, as what comes over
LCM; and a command that goes out has passed the same guard.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from drake import (
    lcmt_header,
    lcmt_iiwa_command,
    lcmt_iiwa_status,
    lcmt_image,
    lcmt_image_array,
    lcmt_panda_command,
    lcmt_panda_status,
    lcmt_planar_manipuland_status,
    lcmt_schunk_wsg_command,
    lcmt_schunk_wsg_status,
)
from pydrake.manipulation import PandaControlMode

from gridpush_drake.errors import GridPushError
from gridpush_drake.perception.camera import Camera
from gridpush_drake.perception.frames import MILLIMETERS
from gridpush_drake.station.links.lcm.picture_messages import decode_frame
from gridpush_drake.station.links.lcm.robot_messages import (
    GRIPPER_COMMAND,
    GRIPPER_STATUS,
    PICTURES,
    find_arm_messages,
    name_object_channel,
    name_object_channels,
)
from gridpush_drake.station.links.link import (
    ArmCommand,
    ArmStatus,
    GripperCommand,
    GripperStatus,
    Link,
    LinkMessage,
    ObjectSight,
    Picture,
    Unusable,
)
from gridpush_drake.station.robot import Robot
from gridpush_drake.systems.planar_manipuland_status import MICROSECONDS

NO_TIME = -1
"""The `utime` of a record whose time is no number: `find_form_fault` refuses it."""

LONGEST_TIME = 1e12
"""s; a time beyond this is none, and would not fit into an LCM message."""


class LinkBus:
    """Speaks LCM messages on one side and records of a `Link` on the other."""

    def __init__(
        self,
        link: Link,
        robot: Robot,
        *,
        camera: Camera | None = None,
        others: int = 0,
        leave_out: Callable[[str], None] | None = None,
    ) -> None:
        """Makes the bus.

        Args:
            link: carries the records.
            robot: which messages its driver would speak over LCM.
            camera: that takes the pictures; needed only to send some.
            others: number of other objects on the table, whose poses are said, too.
            leave_out: is told of what came and cannot be used, and why; it may be set later.

        Raises:
            StationError: the robot's `robot.yaml` names no messages.
        """
        self.leave_out = leave_out
        self._link = link
        self._camera = camera
        self._messages = find_arm_messages(robot)
        self._objects = name_object_channels(others)
        self._handlers: dict[str, list[Callable[[bytes], None]]] = {}

    def Subscribe(self, channel: str, handler: Callable[[bytes], None]) -> None:
        """Has a handler take all messages of a channel; see `DrakeLcmInterface`."""
        self._handlers.setdefault(channel, []).append(handler)

    def HandleSubscriptions(self, timeout_millis: int) -> int:
        """Waits for records and hands them on as messages; returns how many there were."""
        messages = self._link.receive(timeout_millis / MILLIMETERS)
        for message in messages:
            self._take(message)
        return len(messages)

    def Publish(self, channel: str, buffer: bytes) -> None:
        """Sends a message as a record."""
        record = self._decode(channel, buffer)
        if record is not None:
            self._link.send(record)

    def _take(self, message: LinkMessage) -> None:
        if isinstance(message, Unusable):
            if self.leave_out is not None:
                self.leave_out(message.why)
            return
        channel = self._find_channel(message)
        handlers = self._handlers.get(channel)
        if not handlers:
            return
        try:
            data = self._encode(message)
        except Exception as error:  # a record of an SDK may hold anything
            if self.leave_out is not None:
                kind = type(message).__name__
                self.leave_out(f"{channel}: no message can be made of {kind} ({error})")
            return
        for handler in handlers:
            handler(data)

    def _find_channel(self, message: LinkMessage) -> str:
        if isinstance(message, ArmStatus):
            return self._messages.status
        if isinstance(message, ArmCommand):
            return self._messages.command
        if isinstance(message, GripperStatus):
            return GRIPPER_STATUS
        if isinstance(message, GripperCommand):
            return GRIPPER_COMMAND
        if isinstance(message, ObjectSight):
            return name_object_channel(message.number)
        return PICTURES

    def _encode(self, message: LinkMessage) -> bytes:
        """The LCM message of a record; numbers that will not do are left to the reader's checks."""
        if isinstance(message, ArmStatus):
            return encode_arm_status(message, self._messages.status_type)
        if isinstance(message, ArmCommand):
            return encode_arm_command(message, self._messages.command_type)
        if isinstance(message, GripperStatus):
            status = lcmt_schunk_wsg_status()
            status.utime = calc_utime(message.time)
            status.actual_position_mm = MILLIMETERS * message.opening
            status.actual_speed_mm_per_s = MILLIMETERS * message.speed
            status.actual_force = float(message.force)
            return bytes(status.encode())
        if isinstance(message, GripperCommand):
            command = lcmt_schunk_wsg_command()
            command.utime = calc_utime(message.time)
            command.target_position_mm = MILLIMETERS * message.opening
            command.force = float(message.force)
            return bytes(command.encode())
        if isinstance(message, ObjectSight):
            seen = lcmt_planar_manipuland_status()
            seen.utime = calc_utime(message.time)
            x, y, seen.theta = _list(message.pose)
            seen.position = [x, y]
            return bytes(seen.encode())
        assert isinstance(message, Picture)
        return encode_picture(message)

    def _decode(self, channel: str, data: bytes) -> LinkMessage | None:
        """The record of an LCM message; None for one that is of no use outside."""
        if channel == self._messages.status:
            return decode_arm_status(self._messages.status_type.decode(data))
        if channel == self._messages.command:
            command = self._messages.command_type.decode(data)
            return ArmCommand(command.utime / MICROSECONDS, tuple(command.joint_position))
        if channel == GRIPPER_STATUS:
            status = lcmt_schunk_wsg_status.decode(data)
            return GripperStatus(
                time=status.utime / MICROSECONDS,
                opening=status.actual_position_mm / MILLIMETERS,
                speed=status.actual_speed_mm_per_s / MILLIMETERS,
                force=status.actual_force,
            )
        if channel == GRIPPER_COMMAND:
            wanted = lcmt_schunk_wsg_command.decode(data)
            return GripperCommand(
                time=wanted.utime / MICROSECONDS,
                opening=wanted.target_position_mm / MILLIMETERS,
                force=wanted.force,
            )
        if channel in self._objects:
            seen = lcmt_planar_manipuland_status.decode(data)
            pose = (*seen.position, seen.theta)
            return ObjectSight(seen.utime / MICROSECONDS, pose, self._objects.index(channel))
        if channel == PICTURES and self._camera is not None:
            try:
                frame = decode_frame(lcmt_image_array.decode(data), self._camera)
            except GridPushError:
                return None
            return Picture(frame.t, frame.color, frame.depth)
        return None


def calc_utime(time: float) -> int:
    """A time, s, in whole microseconds; `NO_TIME` for what is no time."""
    if not 0.0 <= time <= LONGEST_TIME:  # true for NaN
        return NO_TIME
    return round(MICROSECONDS * time)


def encode_arm_status(status: ArmStatus, kind: Any) -> bytes:
    """The message of an arm's status; what the status does not say is 0.

    Args:
        status: the status.
        kind: `lcmt_iiwa_status` or `lcmt_panda_status`.

    Raises:
        ValueError: there are not as many velocities or torques as positions.
    """
    position = _list(status.position)
    n = len(position)
    zeros = [0.0] * n
    velocity = _list(status.velocity, n)
    external = _list(status.torque_external, n)
    wanted = position if status.position_commanded is None else _list(status.position_commanded, n)
    message = kind()
    message.utime = calc_utime(status.time)
    message.num_joints = n
    message.joint_torque_external = external
    if kind is lcmt_panda_status:
        message.joint_position = position
        message.joint_position_desired = wanted
        message.joint_velocity = velocity
        message.joint_velocity_desired = zeros
        message.joint_acceleration_desired = zeros
        message.joint_torque = zeros
        message.joint_torque_desired = zeros
    else:
        message.joint_position_measured = position
        message.joint_velocity_estimated = velocity
        message.joint_position_commanded = wanted
        message.joint_position_ipo = wanted
        message.joint_torque_measured = zeros
        message.joint_torque_commanded = zeros
    return bytes(message.encode())


def decode_arm_status(message: Any) -> ArmStatus:
    """The record of an arm's LCM status."""
    if isinstance(message, lcmt_panda_status):
        position = message.joint_position
        velocity = message.joint_velocity
        wanted = message.joint_position_desired
    else:
        assert isinstance(message, lcmt_iiwa_status)
        position = message.joint_position_measured
        velocity = message.joint_velocity_estimated
        wanted = message.joint_position_commanded
    return ArmStatus(
        time=message.utime / MICROSECONDS,
        position=tuple(position),
        velocity=tuple(velocity),
        torque_external=tuple(message.joint_torque_external),
        position_commanded=tuple(wanted),
    )


def encode_arm_command(command: ArmCommand, kind: Any) -> bytes:
    """The `lcmt_iiwa_command` or `lcmt_panda_command`, as `kind` says, of a command."""
    position = _list(command.position)
    message = kind()
    message.utime = calc_utime(command.time)
    message.joint_position = position
    if kind is lcmt_panda_command:
        message.num_joint_position = len(position)
        message.control_mode_expected = PandaControlMode.kPosition
    else:
        assert kind is lcmt_iiwa_command
        message.num_joints = len(position)
    return bytes(message.encode())


def encode_picture(picture: Picture) -> bytes:
    """The `lcmt_image_array` of a picture, not compressed."""
    header = lcmt_header()
    header.utime = calc_utime(picture.time)
    color = np.ascontiguousarray(picture.color, dtype=np.uint8)
    images = [_make_image(header, color, lcmt_image.PIXEL_FORMAT_RGB)]
    images[0].channel_type = lcmt_image.CHANNEL_TYPE_UINT8
    if picture.depth is not None:
        depth = np.ascontiguousarray(picture.depth, dtype="<f4")
        images.append(_make_image(header, depth, lcmt_image.PIXEL_FORMAT_DEPTH))
        images[1].channel_type = lcmt_image.CHANNEL_TYPE_FLOAT32
    message = lcmt_image_array()
    message.header = header
    message.num_images = len(images)
    message.images = images
    return bytes(message.encode())


def _make_image(header: lcmt_header, pixels: np.ndarray[Any, Any], form: int) -> lcmt_image:
    image = lcmt_image()
    image.header = header
    image.height, image.width = pixels.shape[:2]
    image.row_stride = pixels.strides[0]
    image.data = pixels.tobytes()
    image.size = len(image.data)
    image.pixel_format = form
    image.compression_method = lcmt_image.COMPRESSION_METHOD_NOT_COMPRESSED
    return image


def _list(numbers: Sequence[float] | np.ndarray[Any, Any], count: int | None = None) -> list[float]:
    """The numbers as floats. Raises ValueError where there are not as many as joints."""
    values = np.asarray(numbers, dtype=np.float64).ravel().tolist()
    if count is not None and len(values) != count:
        raise ValueError(f"{len(values)} numbers; expected {count}, one for each joint")
    return values
