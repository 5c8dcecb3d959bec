"""`LimitMonitor`: watches if the robot keeps its limits, what it touches, and how its tip follows.

It only observes. What stops a real arm is `systems.safety.arm_guard`.
"""

from dataclasses import dataclass, field
from typing import Any
from weakref import ref

import numpy as np
from pydrake.multibody.plant import ContactResults, MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex
from pydrake.systems.framework import Context, EventStatus

from gridpush_drake.station.robot.robot import GetRobotInPlant, list_touching_bodies
from gridpush_drake.station.scene.other_objects import list_parts
from gridpush_drake.station.simulated.station import Station
from gridpush_drake.systems.base.messages import GraspPhase, PushPhase, SteerPhase
from gridpush_drake.units import MM_PER_M

GRIPPING_PHASES = (GraspPhase.CLOSING, GraspPhase.LIFTING, GraspPhase.HOLDING, GraspPhase.OPENING)
"""Phases of a grasp in which the gripper's fingers may touch the object."""

DEFAULT_PERIOD = 0.02
"""Time between two observations, s."""

MAX_TIP_DEVIATION = 0.02
"""If the tip is further than this from where it should be, a push is not the one planned, m."""


@dataclass
class LimitReport:
    """How near the robot came to its limits so far. A fraction of 1 is a joint just at its limit.

    Attributes:
        position_fraction: greatest distance of a joint from the middle of its range, by half the
            range.
        velocity_fraction: greatest speed of a joint, by its limit.
        torque_fraction: greatest torque commanded to a joint, by its limit.
        tracking_error: greatest distance of the tip from where it should have been at the time, in
            all pushes and while it was steered, m.
        force: greatest force on the finger's tip, N.
        strayed: the greatest distance in each push in which it was more than `MAX_TIP_DEVIATION`,
            m, by the push's `command_id`.
        touched: names of the pairs of bodies that touched but should not have.
    """

    position_fraction: float = 0.0
    velocity_fraction: float = 0.0
    torque_fraction: float = 0.0
    tracking_error: float = 0.0
    force: float = 0.0
    strayed: dict[int, float] = field(default_factory=dict)
    touched: set[tuple[str, str]] = field(default_factory=set)

    @property
    def ok(self) -> bool:
        """Whether all limits were kept, and only the tip or a grasp touched the object."""
        fractions = (self.position_fraction, self.velocity_fraction, self.torque_fraction)
        return max(fractions) <= 1.0 and not self.touched

    def explain_strayed(self) -> str:
        """Names the pushes in which the tip strayed, in a sentence; empty if it strayed in none."""
        if not self.strayed:
            return ""
        pushes = [
            f"{MM_PER_M * error:.0f} mm in push {command}"
            for command, error in self.strayed.items()
        ]
        where = "The tip was far from where it should have been"
        return f"{where}, {', '.join(pushes)}: is the arm held or stuck?"


class LimitMonitor:
    """Watches a station: `simulator.set_monitor(LimitMonitor(station))`.

    With a real robot nobody knows what touches what: `touched` then stays empty.

    Attributes:
        limit_report: what was observed so far.
    """

    def __init__(
        self, station: Station, period: float = DEFAULT_PERIOD, *, pushes_others: bool = False
    ) -> None:
        """Makes the monitor.

        Args:
            station: the station; it may be a part of the Diagram that is simulated.
            period: time between two observations, s; with 0 it observes at every step.
            pushes_others: whether the tip may touch the other objects, and all objects each other.
        """
        self._pushes_others = pushes_others
        self.limit_report = LimitReport()
        # A weak reference: a Simulator holds its monitor in C++, where Python's garbage collector
        # does not see it, and the station would never be freed.
        self._station = ref(station)
        self._period = period
        self._next = -np.inf
        self._arm = station.robot.arm_model
        instances = GetRobotInPlant(station.plant, station.robot)
        self._read_limits(station.plant, instances.arm)
        self._knows_contacts = station.HasOutputPort("contact_results")
        if self._knows_contacts:
            self._find_bodies(station, instances.gripper)

    def _read_limits(self, plant: MultibodyPlant, arm: ModelInstanceIndex) -> None:
        """Reads the limits of the arm's joints from the plant, each an array (n,)."""
        joints = [plant.get_joint(index) for index in plant.GetJointIndices(arm)]
        joints = [joint for joint in joints if joint.num_positions() == 1]
        motors = [plant.get_joint_actuator(index) for index in plant.GetJointActuatorIndices(arm)]
        lower = np.array([joint.position_lower_limits()[0] for joint in joints])
        upper = np.array([joint.position_upper_limits()[0] for joint in joints])
        self._middle = (lower + upper) / 2
        self._half_range = (upper - lower) / 2
        self._max_velocity = np.array([joint.velocity_upper_limits()[0] for joint in joints])
        self._max_torque = np.array([motor.effort_limit() for motor in motors])

    def _find_bodies(self, station: Any, gripper: ModelInstanceIndex | None) -> None:
        """Finds the indices of the bodies that may touch each other."""
        plant = station.plant
        robot = station.robot
        self._object = station.object_in_plant.body.index()
        self._others = {part.body_index for part in list_parts(station.others)}
        self._tip = {body.index() for body in list_touching_bodies(plant, robot)}
        fingers = () if robot.gripper is None else robot.gripper.fingers
        self._fingers = {plant.GetBodyByName(name, gripper).index() for name in fingers}
        inspector = station.scene_graph.model_inspector()
        self._table = {
            plant.GetBodyFromFrameId(inspector.GetFrameId(geometry)).index()
            for geometry in station.table
        }

    def __call__(self, root_context: Context) -> EventStatus:
        """Observes if it is time to; a Simulator calls it after every step."""
        station = self._station()
        if station is not None and root_context.get_time() >= self._next:
            self._next = root_context.get_time() + self._period
            self._observe(station, station.GetMyContextFromRoot(root_context))
        return EventStatus.DidNothing()

    def _observe(self, station: Station, context: Context) -> None:
        report = self.limit_report

        def read(port: str) -> Any:
            return station.GetOutputPort(port).Eval(context)

        def raise_fraction(fraction: float, values: np.ndarray, limits: np.ndarray) -> float:
            return max(fraction, float(np.max(np.abs(values) / limits)))

        # The arm's joints.
        from_middle = read(f"{self._arm}.position_measured") - self._middle
        velocity = read(f"{self._arm}.velocity_estimated")
        torque = read(f"{self._arm}.torque_commanded")
        report.position_fraction = raise_fraction(
            report.position_fraction, from_middle, self._half_range
        )
        report.velocity_fraction = raise_fraction(
            report.velocity_fraction, velocity, self._max_velocity
        )
        report.torque_fraction = raise_fraction(report.torque_fraction, torque, self._max_torque)

        # The tip, in pushes only: on its way from one to the next nothing depends on it.
        push = read("executor.status")
        if push.phase == PushPhase.PUSHING:
            gap = read("executor.tip_pose").translation() - read("pusher.state")[:3]
            error = float(np.linalg.norm(gap))
            report.tracking_error = max(report.tracking_error, error)
            if error > MAX_TIP_DEVIATION:
                before = report.strayed.get(push.command_id, 0.0)
                report.strayed[push.command_id] = max(before, error)
        is_steered = (
            station.HasOutputPort("steer.status")
            and read("steer.status").phase == SteerPhase.STEERING
        )
        if is_steered:
            gap = read("executor.tip_pose").translation() - read("pusher.state")[:3]
            report.tracking_error = max(report.tracking_error, float(np.linalg.norm(gap)))
        if station.HasOutputPort("pusher.force"):
            force = float(np.linalg.norm(read("pusher.force")))
            report.force = max(report.force, force)
        if self._knows_contacts:
            gripping = (
                station.HasOutputPort("grasp.status")
                and read("grasp.status").phase in GRIPPING_PHASES
            )
            self._judge_contacts(station.plant, read("contact_results"), gripping)

    def _judge_contacts(
        self, plant: MultibodyPlant, contacts: ContactResults, gripping: bool
    ) -> None:
        """Notes the pairs of bodies that touch but should not, and the force on the tip.

        The object may touch tip and table, and the gripper's fingers while they grip. Other objects
        may touch the table, and, where they are pushed, the tip and each other.
        """
        may_touch_object = {*self._tip, *self._table}
        may_touch_others = set(self._table)
        if self._pushes_others:
            may_touch_object |= self._others
            may_touch_others |= {*self._tip, *self._others}
        if gripping:
            may_touch_object |= self._fingers
        on_tip = np.zeros(3)
        for i in range(contacts.num_point_pair_contacts()):
            contact = contacts.point_pair_contact_info(i)
            pair = {contact.bodyA_index(), contact.bodyB_index()}
            if self._tip & pair:
                sign = 1.0 if contact.bodyB_index() in self._tip else -1.0
                on_tip += sign * contact.contact_force()
            if self._object in pair and pair & may_touch_object:
                continue
            if pair <= self._others | may_touch_others and pair & self._others:
                continue
            first, second = sorted(plant.get_body(index).name() for index in pair)
            self.limit_report.touched.add((first, second))
        self.limit_report.force = max(self.limit_report.force, float(np.linalg.norm(on_tip)))
