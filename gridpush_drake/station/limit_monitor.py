"""How the robot behaves while it works: its limits, what it touches, how well its finger follows."""

from dataclasses import dataclass, field
from typing import Any
from weakref import ref

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex
from pydrake.systems.framework import Context, EventStatus

from gridpush_drake.station.robot import GetRobotInPlant
from gridpush_drake.station.station import Station
from gridpush_drake.systems.messages import GraspPhase, PushPhase

GRIPPING = (GraspPhase.CLOSING, GraspPhase.LIFTING, GraspPhase.HOLDING, GraspPhase.OPENING)
"""Phases of a grasp in which the gripper's fingers may touch the object."""

DEFAULT_PERIOD = 0.02
"""Between two observations, s."""

STRAYED = 0.02
"""m between tip and where it should be, from which on a push was not the one that was planned."""

MM = 1e3  # millimeters in a meter


@dataclass
class LimitReport:
    """What was seen up to now; shares are of the limits, so that 1 is just allowed.

    Attributes:
        position_share: furthest that a joint was from the middle of its range.
        velocity_share: fastest that a joint turned.
        torque_share: greatest torque that a joint was asked for.
        tracking_error: furthest that the tip was from where it should be at the time, during
            pushes, m.
        strayed: the same of those pushes, by their command, in which it was more than STRAYED.
        touched: pairs of bodies that should not have touched and did.
    """

    position_share: float = 0.0
    velocity_share: float = 0.0
    torque_share: float = 0.0
    tracking_error: float = 0.0
    strayed: dict[int, float] = field(default_factory=dict)
    touched: set[tuple[str, str]] = field(default_factory=set)

    @property
    def ok(self) -> bool:
        """Whether all limits were kept and nothing was touched but the object, by the tip or a grasp."""
        return (
            max(self.position_share, self.velocity_share, self.torque_share) <= 1.0
            and not self.touched
        )

    def explain_strayed(self) -> str:
        """Names the pushes in which the tip strayed, in a sentence; empty where there are none."""
        told = [f"{MM * error:.0f} mm in push {command}" for command, error in self.strayed.items()]
        where = "The tip was far from where it should have been"
        return f"{where}, {', '.join(told)}: is the arm held or stuck?" if told else ""


class LimitMonitor:
    """Watches a station: `simulator.set_monitor(LimitMonitor(station))`. What a real one touches it does not see.

    Attributes:
        limit_report: what was seen up to now.
    """

    def __init__(self, station: Station, period: float = DEFAULT_PERIOD) -> None:
        """Makes the monitor.

        Args:
            station: the station, or a part of the Diagram that is simulated.
            period: between two observations, s; 0 observes at every step.
        """
        self.limit_report = LimitReport()
        # a Simulator holds its monitor where the garbage collector does not see it
        self._station, self._period, self._next = ref(station), period, -np.inf
        plant, robot = station.plant, station.robot
        instances = GetRobotInPlant(plant, robot)
        arm = instances.arm
        joints = [plant.get_joint(index) for index in plant.GetJointIndices(arm)]
        joints = [joint for joint in joints if joint.num_positions() == 1]
        lower, upper = (
            np.array([limits(joint)[0] for joint in joints])
            for limits in (lambda j: j.position_lower_limits(), lambda j: j.position_upper_limits())
        )
        self._arm = station.robot.arm_model
        self._middle, self._half = (lower + upper) / 2, (upper - lower) / 2
        self._speed = np.array([joint.velocity_upper_limits()[0] for joint in joints])
        self._torque = np.array(
            [
                plant.get_joint_actuator(index).effort_limit()
                for index in plant.GetJointActuatorIndices(arm)
            ]
        )
        self._speaks_of_contacts = station.HasOutputPort("contact_results")
        if self._speaks_of_contacts:
            self._note_bodies(station, instances.gripper)

    def _note_bodies(self, station: Any, gripper: ModelInstanceIndex | None) -> None:
        plant, robot = station.plant, station.robot
        self._object = station.object_in_plant.body.index()
        self._others = {other.part.body_index for other in station.others}
        self._tip = plant.GetBodyByName(robot.finger.tip_frame).index()
        fingers = () if robot.gripper is None else robot.gripper.fingers
        self._fingers = {plant.GetBodyByName(name, gripper).index() for name in fingers}
        inspector = station.scene_graph.model_inspector()
        self._table = {
            plant.GetBodyFromFrameId(inspector.GetFrameId(geometry)).index()
            for geometry in station.table
        }

    def __call__(self, root_context: Context) -> EventStatus:
        """Observes, where it is time to."""
        station = self._station()
        if station is not None and root_context.get_time() >= self._next:
            self._next = root_context.get_time() + self._period
            self._observe(station, station.GetMyContextFromRoot(root_context))
        return EventStatus.DidNothing()

    def _observe(self, station: Station, context: Context) -> None:
        seen = self.limit_report

        def read(port: str) -> Any:
            return station.GetOutputPort(port).Eval(context)

        def share(now: float, values: np.ndarray, limits: np.ndarray) -> float:
            return max(now, float(np.max(np.abs(values) / limits)))

        seen.position_share = share(
            seen.position_share, read(f"{self._arm}.position_measured") - self._middle, self._half
        )
        seen.velocity_share = share(
            seen.velocity_share, read(f"{self._arm}.velocity_estimated"), self._speed
        )
        seen.torque_share = share(
            seen.torque_share, read(f"{self._arm}.torque_commanded"), self._torque
        )
        push = read("executor.status")
        if push.phase == PushPhase.PUSHING:
            gap = read("executor.tip_pose").translation() - read("pusher.state")[:3]
            error = float(np.linalg.norm(gap))
            seen.tracking_error = max(seen.tracking_error, error)
            if error > STRAYED:
                seen.strayed[push.command_id] = max(seen.strayed.get(push.command_id, 0.0), error)
        if not self._speaks_of_contacts:
            return
        contacts = read("contact_results")
        gripping = station.HasOutputPort("grasp.status") and read("grasp.status").phase in GRIPPING
        allowed = {self._tip, *self._table, *(self._fingers if gripping else ())}
        for i in range(contacts.num_point_pair_contacts()):
            contact = contacts.point_pair_contact_info(i)
            self._judge(station.plant, contact.bodyA_index(), contact.bodyB_index(), allowed)

    def _judge(self, plant: MultibodyPlant, a: int, b: int, allowed: set[int]) -> None:
        pair = {a, b}
        if (self._object in pair and pair & allowed) or (
            pair & self._others and pair & self._table
        ):
            return
        first, second = sorted(plant.get_body(index).name() for index in pair)
        self.limit_report.touched.add((first, second))
