"""`Station`: what tasks need of a robot with an object on a table, whether simulated or real.

It is a Diagram with the ports and methods that every task uses. The part that is the same in both
kinds of stations, which commands the robot, is added by `station.control.robot_control`. The
simulated station is in `station.simulated.push_station`, the real one in
`station.hardware.hardware_station`.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context, Diagram, DiagramBuilder

from gridpush_drake.dynamics.push import Push
from gridpush_drake.errors import StationError
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.result import Identification
from gridpush_drake.multibody.weak_calc import NO_SLOTS
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.perception.images.camera_view import CameraView
from gridpush_drake.planning.weighing.press import PressTarget
from gridpush_drake.pushes.segmentation import Sample
from gridpush_drake.pushes.stream import make_samples
from gridpush_drake.station.control.robot_control import (
    POSE_LOG,
    PUSHER_LOG,
    YAW_LOG,
    RobotControl,
)
from gridpush_drake.station.scene.setting import StationSetting
from gridpush_drake.systems.base.messages import GraspCommand, PressCommand, PushCommand
from gridpush_drake.systems.execution.push_executor import plan_push
from gridpush_drake.systems.learning.grid_identifier import GridIdentifier

StationMaker = Callable[..., "Station"]
"""A function that makes a station of a scenario and a Meshcat (or None), with `show_object`,
`learning`, `steer_speed` and `several` by keyword, as `MakePushStation` does."""


class Station(Diagram):
    """A robot with an object on a table, as tasks need it.

    `PushStation` is a simulated one, `HardwareStation` a real one.

    .. pydrake_system::

        name: Station
        input_ports:
        - push_command
        - grasp_command
        - press_command
        - steer_command
        output_ports:
        - executor.status
        - executor.tip_pose
        - pusher.state
        - pusher.yaw
        - object.pose
        - estimate.mass
        - estimate.friction
        - ...
        - iiwa.position_measured
        - ...
        - steer.status
        - grasp.status
        - grasp.gripper_position
        - gripper.state
        - press.status
        - weighing.log

    - ``push_command``: vector of 6, a push, see `PushCommand`.
    - ``grasp_command``: vector of 6, a grasp, see `GraspCommand`; it need not be connected. The
      station has this port, the ports of ``grasp`` and ``gripper.state`` only with a gripper.
    - ``press_command``: vector of 11, a press at the table's edge, see `PressCommand`; it need not
      be connected. The station has this port, ``press.status`` and ``weighing.log`` only if nothing
      is told of the object (`PushScenario.unknown_inertia`).
    - ``steer_command``: vector of 7, a finger that is steered, see `SteerCommand`. The station has
      this port and ``steer.status`` only if it is made with `steer_speed`.
    - ``executor.status``: abstract `PushStatus`, how the executor of pushes stands.
    - ``executor.tip_pose``: abstract `RigidTransform`, desired X_WP of the tip, whether in a push,
      in a grasp or steered.
    - ``pusher.state``: vector of 6, p_WP, m, and v_WP, m/s, of the tip's center, calculated from
      the arm's joints.
    - ``pusher.yaw``: vector of 1, angle by which the tool is turned about the vertical, rad.
    - ``object.pose``: vector of 3, X_WB as the camera sees it, (x, y, theta), m and rad; NaN while
      the object is not seen.
    - ``estimate.mass`` and the other ports of the estimate: see `GridIdentifier`.
    - ``iiwa.position_measured`` and the other ports of the arm: see Drake's `SimIiwaDriver`. They
      begin with the name that the scene gives to the arm's model, which may be ``panda``.
    - ``steer.status``: abstract `SteerStatus`, how the executor of steering stands.
    - ``grasp.status``: abstract `GraspStatus`, how the executor of grasps stands.
    - ``grasp.gripper_position``: vector of 1, the opening that the gripper is asked for, m.
    - ``gripper.state``: vector of 4, positions of the left and right finger, m, and their
      velocities, m/s.
    - ``press.status``: abstract `PressStatus`, how the executor of presses stands.
    - ``weighing.log``: abstract `MassTestLog`, what presses and lifts told so far.

    Attributes:
        scenario, obj, found, others, obstacles, plant, robot, table_top, home: see
            `StationSetting`.
        truth: true parameters of the object in a fresh Context; None if nobody knows them.
        style: options of the finger's path in a push.
        reach: says whether the arm can follow a path.
    """

    __slots__ = NO_SLOTS

    def __init__(
        self,
        builder: DiagramBuilder,
        setting: StationSetting,
        control: RobotControl,
        truth: CellParameters | None,
    ) -> None:
        """Builds the Diagram of a builder's systems.

        Args:
            builder: the builder with all systems, which is empty afterwards.
            setting: what the station knows.
            control: the systems that `AddRobotControl` added.
            truth: true parameters of the object; None if nobody knows them.
        """
        super().__init__()
        self.scenario = setting.scenario
        self.obj = setting.obj
        self.found = setting.found
        self.others = setting.others
        self.obstacles = setting.obstacles
        self.plant = setting.plant
        self.robot = setting.robot
        self.table_top = setting.table_top
        self.home = setting.home
        self.truth = truth
        self.style = control.executor.style
        self._rest = control.executor.home
        self.reach = control.reach
        self._grasping = control.grasping
        self._pressing = control.pressing
        builder.BuildInto(self)

    def FindObstacle(self, command: PushCommand) -> str | None:
        """Says why the arm cannot carry out a push when it comes from its home; None if it can."""
        return plan_push(command, self._rest, self.style, self.reach, self._rest)[1]

    def CanPush(self, push: Push) -> bool:
        """Says whether the arm can carry out a push when it comes from its home."""
        return self.FindObstacle(PushCommand.from_push(1, push)) is None

    def FindGraspObstacle(self, command: GraspCommand) -> str | None:
        """Says why the arm cannot carry out a grasp when it comes from its home; None if it can.

        Raises:
            StationError: the scene has no gripper.
        """
        if self._grasping is None:
            raise StationError("the scene has no gripper; expected a model named gripper")
        return self._grasping.plan(command, (*self.home, 0.0))[1] or None

    def FindPressObstacle(self, command: PressCommand) -> str | None:
        """Says why the arm cannot carry out a press when it comes from its home; None if it can.

        Raises:
            StationError: nothing is weighed.
        """
        if self._pressing is None:
            raise StationError("nothing is weighed; expected a scenario with unknown_inertia: true")
        return self._pressing.plan(command, (*self.home, 0.0))[1] or None

    def CanPress(self, target: PressTarget, pose: Array) -> bool:
        """Says whether the arm can press there, with the object at a pose (3,), m and rad.

        Raises:
            StationError: nothing is weighed.
        """
        x, y, theta = pose.tolist()
        command = PressCommand.from_target(1, target, (x, y, theta))
        return self.FindPressObstacle(command) is None

    def SetStart(self, root_context: Context, seed: int | None = None) -> None:
        """Makes a fresh Context ready to begin.

        Args:
            root_context: Context of the station, or of the Diagram that the station is part of.
            seed: seed of everything random, instead of the scenario's.
        """
        raise NotImplementedError

    def GetTruth(self, root_context: Context) -> CellParameters | None:
        """Returns the object's true parameters in a Context; None if nobody knows them."""
        return None

    def FindStream(self, root_context: Context) -> list[Sample]:
        """Returns all that the identifier has read in a Context, from which it cut its pushes.

        Args:
            root_context: Context of the station, or of the Diagram that the station is part of.
        """
        t, tip = self._find_log(root_context, PUSHER_LOG)
        _, poses = self._find_log(root_context, POSE_LOG)
        samples = make_samples(t, tip[:, :3], tip[:, 3:], poses)
        if not self.HasSubsystemNamed(YAW_LOG):
            return samples
        _, yaw = self._find_log(root_context, YAW_LOG)
        turned = zip(samples, yaw[:, 0].tolist(), strict=True)
        return [sample._replace(yaw=angle) for sample, angle in turned]

    def LearnAll(self, root_context: Context) -> Identification | None:
        """Learns from all that the identifier has read in a Context; see `GridIdentifier.LearnAll`.

        Args:
            root_context: Context of the station, or of the Diagram that the station is part of.
        """
        identifier = self.GetSubsystemByName("identifier")
        assert isinstance(identifier, GridIdentifier)
        return identifier.LearnAll(identifier.GetMyContextFromRoot(root_context))

    def FindCameraView(self, root_context: Context) -> CameraView | None:
        """Returns what a color and depth camera saw in a Context, and its errors.

        It is None for an ideal camera, and for a real robot, where nobody knows the true pose.
        """
        return None

    def _find_log(
        self, root_context: Context, name: str
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Returns the times (K,), s, and the values (K, d) of a log.

        The logs are looked up by name each time. As attributes they would keep the station alive
        for good, for Python's garbage collector does not see the references within C++.
        """
        log = self.GetSubsystemByName(name).FindLog(root_context)
        return log.sample_times(), log.data().T
