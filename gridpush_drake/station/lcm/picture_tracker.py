"""`PictureTracker`: finds an object in a camera's pictures on LCM, and says where it is, for a `HardwareStation`.

It is a process of its own beside the controller's, which therefore waits for no picture. What the
arm hides it knows by rendering the arm where the camera is, with the joints as the robot's status
has them; what else stands high is told by depth.

Messages that cannot be used are left out and counted, see `Channel`. The pictures' times are by the
robot's clock: a picture from the future, or one that no status was sent near to, is left out, too.
"""

from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from time import monotonic
from typing import Any

import numpy as np
from drake import lcmt_image_array, lcmt_schunk_wsg_status
from numpy.typing import NDArray
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from gridpush_drake.errors import GridPushError, PerceptionError
from gridpush_drake.multibody.parser import MakeParser
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.perception.detection import DetectedObject, find_off_table
from gridpush_drake.perception.frames import MILLIMETERS, Frame
from gridpush_drake.perception.tracking import NOT_SEEN, PoseTracker, TrackedPose, TrackerState
from gridpush_drake.station.camera import LIVE, AddRgbdCamera
from gridpush_drake.station.lcm.bus import Bus
from gridpush_drake.station.lcm.channel import Channel, count_reason
from gridpush_drake.station.lcm.message_forms import decode_message, find_form_fault
from gridpush_drake.station.lcm.picture_messages import decode_frame
from gridpush_drake.station.lcm.robot_messages import (
    FROM_OPENING,
    GRIPPER_STATUS,
    OBJECT_STATUS,
    PICTURES,
    find_arm_messages,
)
from gridpush_drake.station.lcm.twin import check_tracked
from gridpush_drake.station.resolve import ResolvedScenario, resolve
from gridpush_drake.station.robot import GetRobotInPlant
from gridpush_drake.station.scenario import PushScenario
from gridpush_drake.station.scene import AddScene
from gridpush_drake.systems.object_detector import ObjectNaming, find_in_frame
from gridpush_drake.systems.planar_manipuland_status import MICROSECONDS, make_status

STATUSES = 1000
"""Number of the arm's last statuses that are remembered: some seconds."""

MAX_LAG = 0.5
"""Longest time between a picture and the arm's status nearest to it, s. A picture further away is by
another clock than the robot's, and left out."""


class RobotSilhouette:
    """Where a scenario's robot is in the pictures of its camera."""

    def __init__(self, resolved: ResolvedScenario) -> None:
        """Makes the scene without the object; see `TwinCamera` for what may be raised."""
        scenario = resolved.scenario
        builder = DiagramBuilder()
        self.plant, scene_graph = AddMultibodyPlantSceneGraph(
            builder, scenario.simulation.time_step
        )
        AddScene(MakeParser(self.plant), scenario)
        self.plant.Finalize()
        self.table_top = resolved.table_top
        rgbd = AddRgbdCamera(builder, self.plant, scene_graph, scenario, None)
        self.camera, self._labels, self._sensor = rgbd.camera, list(rgbd.hidden_by), rgbd.sensor
        self._robot = GetRobotInPlant(self.plant, resolved.robot)
        self.num_joints = self.plant.num_positions(self._robot.arm)
        self._diagram = builder.Build()
        self._context = self._diagram.CreateDefaultContext()

    def find(self, joints: Sequence[float], opening: float | None) -> NDArray[np.bool_]:
        """The pixels (height, width) that show the robot.

        Args:
            joints: the arm's positions, rad.
            opening: the gripper's, m; None where it is not known, or there is none.
        """
        context = self.plant.GetMyMutableContextFromRoot(self._context)
        self.plant.SetPositions(context, self._robot.arm, np.asarray(joints))
        if opening is not None and self._robot.gripper is not None:
            self.plant.SetPositions(context, self._robot.gripper, FROM_OPENING[:2, 0] * opening)
        port = self._sensor.label_image_output_port()
        labels = port.Eval(self._sensor.GetMyContextFromRoot(self._context)).data[..., 0]
        return np.isin(labels, self._labels)


@dataclass
class TrackerReport:
    """What a tracker did.

    Attributes:
        pictures: number of pictures that were looked at.
        seen: number of those in which the object was seen.
        skipped: number of pictures that were not looked at, since newer ones came meanwhile.
        left_out: number of messages that could not be used, by why.
    """

    pictures: int = 0
    seen: int = 0
    skipped: int = 0
    left_out: Counter[str] = field(default_factory=Counter)

    def describe(self) -> str:
        """The report in a sentence."""
        text = f"{self.pictures} pictures, the object seen in {self.seen} of them, {self.skipped} skipped"
        return text + "".join(f"; {count} left out: {why}" for why, count in self.left_out.items())


class PictureTracker:
    """Looks at pictures as they come, and says where the object is: `PLANAR_MANIPULAND_STATUS`.

    Attributes:
        obj: the object that is followed; None until it is found.
        detected: what was found; None where the object was given.
        message: why the object was not found in the last picture; empty where it was.
        report: how it went.
    """

    def __init__(
        self,
        scenario: PushScenario | ResolvedScenario,
        lcm: Bus,
        obj: GridObject | None = None,
        clock: Callable[[], float] = monotonic,
    ) -> None:
        """Listens from now on.

        Args:
            scenario: robot, table and camera, resolved or not; which object lies there only says a name and what is
                known beforehand.
            lcm: on which pictures and the arm's status come, and the pose is said.
            obj: to follow; None for what the detector finds.
            clock: by which messages arrive, s.

        Raises:
            ScenarioError: the camera makes no sense, or there are several objects.
            StationError: nothing can be rendered here, or nobody knows what the robot's driver
                speaks.
        """
        resolved = resolve(scenario)
        scenario, robot = resolved.scenario, resolved.robot
        check_tracked(scenario)
        self._told = resolved.obj
        self.obj, self.message = obj, ""
        self.detected: DetectedObject | None = None
        self.report = TrackerReport()
        self._scenario, self._lcm, self._messages = scenario, lcm, find_arm_messages(robot)
        self._silhouette = RobotSilhouette(resolved)
        self._off_table = find_off_table(self._silhouette.camera, self._silhouette.table_top)
        self._statuses: deque[tuple[int, Sequence[float]]] = deque(maxlen=STATUSES)
        self._opening: float | None = None
        self._clock, self._clock_jump = clock, scenario.safety.clock_jump
        self._picture: tuple[bytes, float] | None = None
        self._last = -1
        self._tracker: PoseTracker | None = None
        self._state: TrackerState | None = None
        self._arm = Channel(
            self._messages.status,
            self._messages.status_type,
            now=clock,
            clock_jump=self._clock_jump,
            find_fault=self._find_arm_fault,
            leave_out=self.leave_out,
        )
        self._gripper = Channel(
            GRIPPER_STATUS,
            lcmt_schunk_wsg_status,
            now=clock,
            clock_jump=self._clock_jump,
            find_fault=lambda message: find_form_fault(message, GRIPPER_STATUS),
            leave_out=self.leave_out,
        )
        lcm.Subscribe(PICTURES, self._take_picture)
        lcm.Subscribe(self._messages.status, self._take_status)
        if robot.gripper is not None:
            lcm.Subscribe(GRIPPER_STATUS, self._take_gripper)

    def step(self, timeout: float = 0.0) -> TrackedPose | None:
        """Waits for messages for so long, s, and looks at the newest picture.

        Returns:
            What it told; None where there was none, or it could not be used.
        """
        self._lcm.HandleSubscriptions(round(1e3 * timeout))
        picture, self._picture = self._picture, None
        if picture is None or not self._statuses:
            return None
        frame = self._read_frame(*picture)
        if frame is None:
            return None
        utime = self._last = round(MICROSECONDS * frame.t)
        _, joints = self._find_nearest(utime)
        tracked = self._look(frame, self._silhouette.find(joints, self._opening))
        self.report.pictures += 1
        self.report.seen += tracked.seen
        self._lcm.Publish(OBJECT_STATUS, make_status(frame.t, tracked.pose).encode())
        return tracked

    def find_obstacle(self) -> str:
        """Says why no pose is told yet; empty where one is."""
        if not self._statuses:
            return f"no status of the robot on {self._messages.status}"
        if self._last < 0:
            left_out = "".join(f" ({why})" for why in self.report.left_out)
            return f"no usable picture on {PICTURES}{left_out}"
        return self.message

    def _look(self, frame: Frame, hidden: NDArray[np.bool_]) -> TrackedPose:
        """Finds the object in a picture, at first anywhere."""
        guess = None
        if self.obj is None:
            found = self._detect(frame, hidden)
            if found is None:
                return NOT_SEEN
            guess = found.X_WB
        assert self.obj is not None
        if self._tracker is None:
            height = self.obj.height or self._scenario.object_height
            camera, table_top = self._silhouette.camera, self._silhouette.table_top
            self._tracker = PoseTracker(self.obj.outline, height, camera, LIVE, table_top)
        try:
            state = self._state or self._tracker.start(frame, guess, hidden)
        except PerceptionError as error:
            self.message = str(error)
            return NOT_SEEN
        self._state, tracked = self._tracker.track(state, frame, hidden)
        self.message = ""
        return tracked

    def _detect(self, frame: Frame, hidden: NDArray[np.bool_]) -> DetectedObject | None:
        naming = ObjectNaming(self._told.name, self._told.prior, self._scenario.object_pose[2])
        unseen = (self._off_table, hidden)
        found = find_in_frame(
            frame, self._silhouette.camera, None, naming, unseen, self._scenario.seed
        )
        if isinstance(found, str):
            self.message = found
            return None
        self.detected, self.obj = found
        return self.detected

    def _read_frame(self, data: bytes, arrival: float) -> Frame | None:
        """Decodes a picture that arrived at a time, s; None, and counted, where it cannot be used."""
        try:
            message = decode_message(lcmt_image_array, PICTURES, data)
            frame = decode_frame(message, self._silhouette.camera)
        except GridPushError as error:
            self.leave_out(str(error))
            return None
        utime = round(MICROSECONDS * frame.t)
        why, (nearest, _) = "", self._find_nearest(utime)
        if utime <= self._last:
            why = "a picture was not newer than the one before"
        elif self._arm.clock.calc_advance(frame.t, arrival) > self._clock_jump:
            why = "a picture is from the future, by the robot's clock; expected one clock for both"
        elif abs(nearest - utime) > MAX_LAG * MICROSECONDS:
            why = (
                f"a picture is more than {MAX_LAG:g} s from the robot's nearest status; "
                "expected one clock for both"
            )
        if why:
            self.leave_out(why)
        return None if why else frame

    def _find_nearest(self, utime: int) -> tuple[int, Sequence[float]]:
        """The time, us, and the joints of the status nearest to a picture's time, us."""
        return min(self._statuses, key=lambda status: abs(status[0] - utime))

    def _find_arm_fault(self, message: Any) -> str:
        joints = self._silhouette.num_joints
        fault = self._messages.find_fault(message, joints)
        return fault or find_form_fault(message, self._messages.status, joints)

    def _take_picture(self, data: bytes) -> None:
        self.report.skipped += self._picture is not None
        self._picture = (data, self._clock())

    def _take_status(self, data: bytes) -> None:
        changes = self._arm.clock_changes
        if not self._arm.take(data):
            return
        if self._arm.clock_changes != changes:
            # the times before the clock jumped say nothing about pictures after it
            self._statuses.clear()
            self._last = -1
        message = self._arm.message
        self._statuses.append((message.utime, self._messages.read_joints(message)))

    def _take_gripper(self, data: bytes) -> None:
        if self._gripper.take(data):
            self._opening = self._gripper.message.actual_position_mm / MILLIMETERS

    def leave_out(self, why: str) -> None:
        """Counts what came and cannot be used, by why."""
        count_reason(self.report.left_out, why)
