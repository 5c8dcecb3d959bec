"""`PictureTracker`: finds objects in a camera's pictures, and says where they are.

One object is found by the detector, which knows nothing of it. Several, a scenario's `object` and
its `others`, are told apart by their outlines, which their files have.

It runs in a process of its own beside that of the controller, which is a `HardwareStation` and
waits for no picture. To know what the arm hides, it renders the arm as the camera sees it, with the
joints as they are in the robot's status. Whatever else hides the object is told by depth.

What cannot be used is left out and counted, see `Channel`. The pictures' times are by the robot's
clock. A picture from the future is left out, too, and so is one without a status of the
robot at about the same time.
"""

from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from time import monotonic

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import DiagramBuilder

from gridpush_drake.errors import PerceptionError
from gridpush_drake.multibody.parser import AddPlantAndSceneGraph, MakeParser
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.perception.detection.detection import DetectedObject, DetectorOptions
from gridpush_drake.perception.images.frames import Frame
from gridpush_drake.perception.images.table_view import find_off_table
from gridpush_drake.perception.tracking.multi_object_tracking import SceneTracker, SceneTrackerState
from gridpush_drake.perception.tracking.tracking import (
    NOT_SEEN,
    PoseTracker,
    TrackedPose,
    TrackerState,
)
from gridpush_drake.station.links.channel import Channel, count_reason
from gridpush_drake.station.links.link import SKIPPED, Link, LinkMessage, Unusable
from gridpush_drake.station.links.record_forms import find_frame_fault
from gridpush_drake.station.robot.robot import GetRobotInPlant, SetGripperOpening
from gridpush_drake.station.scene.camera import LIVE_TRACKER, AddRgbdCamera
from gridpush_drake.station.scene.contents import AddScene
from gridpush_drake.station.scene.other_objects import list_others
from gridpush_drake.station.scene.resolve import ResolvedScenario, resolve
from gridpush_drake.station.scene.scene_camera import TrackedScene
from gridpush_drake.station.schema.scenario import PushScenario
from gridpush_drake.systems.robot_records import ArmStatus, GripperStatus, PoseObservation
from gridpush_drake.systems.sensing.object_detector import ObjectNaming, find_in_frame

STATUSES = 1000
"""Number of the arm's last statuses that are remembered: some seconds."""

MAX_LAG = 0.5
"""Longest time between a picture and the arm's status nearest to it, s. If it is longer, the
picture's time is by another clock than the robot's, and the picture is left out."""


class RobotSilhouette:
    """Tells which pixels of a camera's pictures show the robot.

    Attributes:
        plant: the scene without the object.
        camera: intrinsics and pose of the scenario's camera.
        table_top: the table's top, a polygon in W, m.
        num_joints: number of the arm's joints.
    """

    def __init__(self, resolved: ResolvedScenario) -> None:
        """Makes the scene and a camera before it.

        Raises:
            ScenarioError: the camera makes no sense.
            StationError: nothing can be rendered on this computer.
        """
        scenario = resolved.scenario
        builder = DiagramBuilder()
        self.plant, scene_graph = AddPlantAndSceneGraph(builder, scenario.simulation.time_step)
        AddScene(MakeParser(self.plant, resolved.robot.packages), scenario)
        self.plant.Finalize()
        SetGripperOpening(self.plant, resolved.robot)
        self.table_top = resolved.table_top
        rgbd = AddRgbdCamera(builder, self.plant, scene_graph, scenario, [])
        self.camera = rgbd.camera
        self._labels = list(rgbd.occluded_by)
        self._sensor = rgbd.sensor
        self._robot = GetRobotInPlant(self.plant, resolved.robot)
        self.num_joints = self.plant.num_positions(self._robot.arm)
        self._diagram = builder.Build()
        self._context = self._diagram.CreateDefaultContext()

    def find(self, arm: ArmStatus, gripper: GripperStatus | None) -> NDArray[np.bool_]:
        """Finds the pixels (height, width) that show the robot.

        Args:
            arm: how the arm is.
            gripper: how the gripper is; None if it is not known, or there is no gripper.
        """
        context = self.plant.GetMyMutableContextFromRoot(self._context)
        self.plant.SetPositions(context, self._robot.arm, np.asarray(arm.position))
        if gripper is not None and self._robot.gripper is not None:
            fingers = gripper.calc_finger_state()[:2]
            self.plant.SetPositions(context, self._robot.gripper, fingers)
        port = self._sensor.label_image_output_port()
        labels = port.Eval(self._sensor.GetMyContextFromRoot(self._context)).data[..., 0]
        return np.isin(labels, self._labels)


@dataclass
class TrackerReport:
    """What a tracker did.

    Attributes:
        pictures: number of pictures that were looked at.
        seen: number of those in which the object was seen, or all of several.
        skipped: number of pictures that were not looked at, since newer ones came meanwhile.
        left_out: number of records that could not be used, by why.
    """

    pictures: int = 0
    seen: int = 0
    skipped: int = 0
    left_out: Counter[str] = field(default_factory=Counter)

    def describe(self) -> str:
        """Returns the report in words."""
        text = (
            f"{self.pictures} pictures, the object seen in {self.seen} of them, "
            f"{self.skipped} skipped"
        )
        return text + "".join(f"; {count} left out: {why}" for why, count in self.left_out.items())


class PictureTracker:
    """Looks at pictures as they come, and says where the object is.

    Where the scenario has other objects, all of them are followed, see `PoseObservation.number`.

    Attributes:
        obj: the object that is followed, the first of several; None until it is found.
        detected: what the detector found; None if the object was given, or is not found yet.
        message: why the object was not found in the last picture; empty if it was.
        report: what the tracker did.
    """

    def __init__(
        self,
        scenario: PushScenario | ResolvedScenario,
        link: Link,
        obj: GridObject | None = None,
        clock: Callable[[], float] = monotonic,
    ) -> None:
        """Has heard nothing yet.

        Args:
            scenario: robot, table and camera, resolved or not. Of a single object only name and
                prior are used, for the object that is found.
            link: over which pictures and the arm's status come, and over which the pose is said.
            obj: the single object to follow; None to follow what the detector finds.
            clock: returns the time by which records arrive, s.

        Raises:
            ScenarioError: the camera makes no sense.
            StationError: nothing can be rendered on this computer.
        """
        resolved = resolve(scenario)
        scenario = resolved.scenario
        others = list_others(scenario, resolved.others)
        self.obj = resolved.obj if others else obj
        self.detected: DetectedObject | None = None
        self.message = ""
        self.report = TrackerReport()
        self._scenario = scenario
        self._named_after = resolved.obj
        self._link = link
        self._clock = clock
        self._clock_jump = scenario.safety.clock_jump
        self._silhouette = RobotSilhouette(resolved)
        self._off_table = find_off_table(self._silhouette.camera, self._silhouette.table_top)
        # What the robot last said; and the newest picture that was not looked at yet, and its
        # arrival, s.
        self._statuses: deque[ArmStatus] = deque(maxlen=STATUSES)
        self._picture: tuple[Frame, float] | None = None
        # Time of the last picture that was looked at, s.
        self._last = -np.inf
        # What follows several objects; None for a single one.
        self._scene: SceneTracker | None = None
        self._scene_state: SceneTrackerState | None = None
        if others:
            tracked = TrackedScene(scenario, resolved.obj, others)
            self._scene = tracked.make_tracker(self._silhouette.camera, self._silhouette.table_top)
            self._guesses = tracked.guess()
        # What follows the object once it is found.
        self._tracker: PoseTracker | None = None
        self._state: TrackerState | None = None
        self._arm = self._make_channel(ArmStatus)
        self._gripper = self._make_channel(GripperStatus)

    def step(self, timeout: float = 0.0) -> TrackedPose | None:
        """Waits for records, and looks at the newest picture.

        Args:
            timeout: longest time to wait, s.

        Returns:
            The pose that was found and said, of the first object; None if there was no picture that
            could be used.
        """
        poses = self.step_all(timeout)
        return poses[0] if poses else None

    def step_all(self, timeout: float = 0.0) -> tuple[TrackedPose, ...]:
        """Waits for records, and looks at the newest picture.

        Args:
            timeout: longest time to wait, s.

        Returns:
            The poses that were found and said, of all objects in their order; empty if there was no
            picture that could be used.
        """
        for message in self._link.receive(timeout):
            self._take(message)
        picture = self._picture
        self._picture = None
        if picture is None or not self._statuses:
            return ()
        frame, arrival = picture
        why = self._find_frame_fault(frame, arrival)
        if why:
            self._leave_out(why)
            return ()
        self._last = frame.t
        hidden = self._silhouette.find(self._find_nearest(frame.t), self._gripper.record)
        if self._scene is None:
            poses: tuple[TrackedPose, ...] = (self._look(frame, hidden),)
        else:
            poses = self._look_at_scene(self._scene, frame, hidden)
        self.report.pictures += 1
        self.report.seen += all(tracked.seen for tracked in poses)
        for number, tracked in enumerate(poses):
            self._link.send(PoseObservation(frame.t, tracked.pose, number))
        return poses

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the objects that are followed; empty until they are known."""
        if self._scene is not None:
            return self._scene.names
        return () if self.obj is None else (self.obj.name,)

    def find_obstacle(self) -> str:
        """Says why there is no pose yet; empty if the object was found in the last picture."""
        if not self._statuses:
            return f"no status of the robot on {self._arm.name}"
        if self._last == -np.inf:
            left_out = "".join(f" ({why})" for why in self.report.left_out)
            return f"no usable picture on {self._link.get_name(Frame)}{left_out}"
        return self.message

    def _look(self, frame: Frame, hidden: NDArray[np.bool_]) -> TrackedPose:
        """Finds the object: at first anywhere, by the detector; then near its last pose."""
        guess = None
        if self.obj is None:
            found = self._detect(frame, hidden)
            if found is None:
                return NOT_SEEN
            guess = found.X_WB
        assert self.obj is not None
        if self._tracker is None:
            self._tracker = PoseTracker(
                self.obj.outline,
                self.obj.height or self._scenario.object_height,
                self._silhouette.camera,
                options=LIVE_TRACKER,
                table_top=self._silhouette.table_top,
            )
        try:
            state = self._state or self._tracker.start(frame, guess, hidden)
        except PerceptionError as error:
            self.message = str(error)
            return NOT_SEEN
        self._state, tracked = self._tracker.track(state, frame, hidden)
        self.message = ""
        return tracked

    def _look_at_scene(
        self, tracker: SceneTracker, frame: Frame, hidden: NDArray[np.bool_]
    ) -> tuple[TrackedPose, ...]:
        """Finds all objects: at first by their outlines alone; then near their last poses."""
        try:
            state = self._scene_state or tracker.start(frame, self._guesses, hidden)
        except PerceptionError as error:
            self.message = str(error)
            return (NOT_SEEN,) * len(tracker)
        self._scene_state, poses = tracker.track(state, frame, hidden)
        self.message = ""
        return poses

    def _detect(self, frame: Frame, hidden: NDArray[np.bool_]) -> DetectedObject | None:
        """Looks for an object anywhere in a picture; the one that is found is then followed."""
        named_after = self._named_after
        naming = ObjectNaming(named_after.name, named_after.prior, self._scenario.object_pose[2])
        found = find_in_frame(
            frame,
            self._silhouette.camera,
            DetectorOptions(parts=True),
            naming=naming,
            off_table=self._off_table,
            hidden=hidden,
            seed=self._scenario.seed,
        )
        if isinstance(found, str):
            self.message = found
            return None
        self.detected, self.obj = found
        return self.detected

    def _find_frame_fault(self, frame: Frame, arrival: float) -> str:
        """Says why a picture cannot be used; empty if it can.

        Args:
            frame: the picture.
            arrival: when it came, s, by this process's clock.
        """
        fault = find_frame_fault(frame, self._link.get_name(Frame), self._silhouette.camera)
        if fault:
            return fault
        if frame.t <= self._last:
            return "a picture was not newer than the one before"
        if self._arm.clock.calc_advance(frame.t, arrival) > self._clock_jump:
            return "a picture is from the future, by the robot's clock; expected one clock for both"
        if abs(self._find_nearest(frame.t).time - frame.t) > MAX_LAG:
            return (
                f"a picture is more than {MAX_LAG:g} s from the robot's nearest status; "
                "expected one clock for both"
            )
        return ""

    def _find_nearest(self, time: float) -> ArmStatus:
        """Returns the status nearest to a picture's time, s."""
        return min(self._statuses, key=lambda status: abs(status.time - time))

    def _make_channel(self, kind: type) -> Channel:
        """Makes the channel of the arm's or the gripper's statuses."""
        return Channel(
            self._link.get_name(kind),
            joints=self._silhouette.num_joints,
            now=self._clock,
            clock_jump=self._clock_jump,
            leave_out=self._leave_out,
        )

    def _take(self, message: LinkMessage) -> None:
        """Takes what came; of several pictures the newest is kept for this `step`."""
        if message == SKIPPED:
            self.report.skipped += 1
        elif isinstance(message, Unusable):
            self._leave_out(message.why)
        elif isinstance(message, Frame):
            self.report.skipped += self._picture is not None
            self._picture = (message, self._clock())
        elif isinstance(message, ArmStatus):
            self._take_status(message)
        elif isinstance(message, GripperStatus):
            self._gripper.take(message)

    def _take_status(self, status: ArmStatus) -> None:
        """Remembers a status of the arm."""
        changes = self._arm.clock_changes
        if not self._arm.take(status):
            return
        if self._arm.clock_changes != changes:
            # Times before the robot's clock jumped say nothing about pictures after it.
            self._statuses.clear()
            self._last = -np.inf
        self._statuses.append(status)

    def _leave_out(self, why: str) -> None:
        """Counts what cannot be used."""
        count_reason(self.report.left_out, why)
