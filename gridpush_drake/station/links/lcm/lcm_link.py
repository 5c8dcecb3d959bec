"""`LcmLink`: a `Link` over LCM, with the messages of Drake's drivers."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from drake import lcmt_image_array
from pydrake.lcm import DrakeLcmInterface

from gridpush_drake.errors import GridPushError
from gridpush_drake.perception.images.camera import Camera
from gridpush_drake.perception.images.frames import Frame
from gridpush_drake.station.links.lcm.lcm_messages import (
    GRIPPER_COMMAND,
    GRIPPER_STATUS,
    PICTURES,
    decode_gripper_command,
    decode_gripper_status,
    decode_message,
    decode_pose,
    encode_gripper_command,
    encode_gripper_status,
    encode_pose,
    find_arm_messages,
    name_object_channel,
)
from gridpush_drake.station.links.lcm.picture_messages import decode_frame, encode_frame
from gridpush_drake.station.links.link import (
    MILLISECONDS,
    SKIPPED,
    Link,
    LinkMessage,
    LinkRole,
    Record,
    Unusable,
)
from gridpush_drake.station.robot.robot import Robot
from gridpush_drake.systems.robot_records import (
    ArmCommand,
    ArmStatus,
    GripperCommand,
    GripperStatus,
    PoseObservation,
)


class LcmLink(Link):
    """Messages of LCM on one side, and records on the other.

    Attributes:
        place: see `Link`.
        where: the network, in words.
    """

    place = "on this --lcm"

    def __init__(
        self,
        lcm: DrakeLcmInterface,
        robot: Robot,
        role: LinkRole,
        *,
        camera: Camera | None = None,
        others: int = 0,
        where: str = "LCM",
    ) -> None:
        """Listens from now on.

        Args:
            lcm: the network.
            robot: the robot, whose driver and gripper say which messages there are.
            role: who speaks; it says which messages are heard.
            camera: that takes the pictures; needed only to hear some.
            others: number of other objects on the table, whose poses are said, too.
            where: the network, in words.

        Raises:
            StationError: the messages of the robot's driver are not known.
        """
        self.where = where
        self._lcm = lcm
        self._camera = camera
        self._received: list[LinkMessage] = []
        # The newest picture since the last call of `receive`, as it came; and how many came.
        self._picture = b""
        self._pictures = 0
        self._frames_sent = 0
        self._arm = find_arm_messages(robot)
        self._encoders: dict[type, Callable[[Any], bytes]] = {
            ArmStatus: self._arm.encode_status,
            ArmCommand: self._arm.encode_command,
            GripperStatus: encode_gripper_status,
            GripperCommand: encode_gripper_command,
            PoseObservation: encode_pose,
            Frame: self._encode_frame,
        }
        self._names = {
            ArmStatus: self._arm.status,
            ArmCommand: self._arm.command,
            GripperStatus: GRIPPER_STATUS,
            GripperCommand: GRIPPER_COMMAND,
            Frame: PICTURES,
        }
        self._subscribe(role, others, has_gripper=robot.gripper is not None)

    def receive(self, timeout: float) -> Sequence[LinkMessage]:
        """All that has come; waits up to `timeout`, s, where nothing has.

        Of several pictures only the newest is unpacked: that takes milliseconds.
        """
        self._lcm.HandleSubscriptions(round(MILLISECONDS * timeout))
        received = self._received
        self._received = []
        if self._pictures:
            received += [SKIPPED] * (self._pictures - 1)
            received.append(self._read(Frame, 0, self._decode_frame, self._picture))
            self._pictures = 0
        return received

    def send(self, record: Record) -> None:
        """Publishes a record's message."""
        name = self.get_name(type(record), getattr(record, "number", 0))
        self._lcm.Publish(name, self._encoders[type(record)](record))

    def get_name(self, kind: type, number: int = 0) -> str:
        """Returns the channel of a type of records; see `Link`."""
        return name_object_channel(number) if kind is PoseObservation else self._names[kind]

    def close(self) -> None:
        """Leaves the network, which needs nothing."""

    def _subscribe(self, role: LinkRole, others: int, has_gripper: bool) -> None:
        """Hears what a role reads."""
        if role == LinkRole.ROBOT:
            self._hear(ArmCommand, self._arm.decode_command)
            if has_gripper:
                self._hear(GripperCommand, decode_gripper_command)
        if role in (LinkRole.CONTROL, LinkRole.TRACKER):
            self._hear(ArmStatus, self._arm.decode_status)
            if has_gripper:
                self._hear(GripperStatus, decode_gripper_status)
        if role == LinkRole.CONTROL:
            for number in range(others + 1):
                self._hear(PoseObservation, partial(decode_pose, number=number), number)
        if role == LinkRole.TRACKER:
            self._lcm.Subscribe(PICTURES, self._take_picture)

    def _hear(self, kind: type, decode: Callable[[bytes], Record], number: int = 0) -> None:
        """Has the messages of a type of records come in."""

        def take(data: bytes) -> None:
            self._received.append(self._read(kind, number, decode, data))

        self._lcm.Subscribe(self.get_name(kind, number), take)

    def _read(
        self, kind: type, number: int, decode: Callable[[bytes], Record], data: bytes
    ) -> LinkMessage:
        """Makes a record of a message as it came.

        Raises nothing: the caller may be a callback of C code, which takes no exceptions.
        """
        try:
            return decode(data)
        except GridPushError as error:
            why = str(error)
        except Exception as error:
            why = f"{self.get_name(kind, number)} could not be read ({type(error).__name__})"
        return Unusable(why, kind, number)

    def _take_picture(self, data: bytes) -> None:
        self._picture = data
        self._pictures += 1

    def _decode_frame(self, data: bytes) -> Frame:
        assert self._camera is not None
        return decode_frame(decode_message(lcmt_image_array, PICTURES, data), self._camera)

    def _encode_frame(self, frame: Frame) -> bytes:
        self._frames_sent += 1
        return bytes(encode_frame(frame, self._frames_sent - 1).encode())
