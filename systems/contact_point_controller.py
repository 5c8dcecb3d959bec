"""What a contact-point controller remembers, and the numbers by which it goes about it.

Pushing an object to a goal pose, push by push, as a Drake system.

    waiting ---- at rest, and seen ----> pushing ----> waiting      a push, then a new look
       |
       +--> reached, failed       until there is another goal, or somebody moves the object

Whenever the robot is ready, the object is looked at until it lies still; then `planning.push_decision` says where and
how to push, by what was learned so far. So an object that slipped, or was moved by somebody, is pushed from where it
lies.
"""

from dataclasses import dataclass, field, replace
from math import cos, nan, sin
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context

from gridpush_drake.errors import GridPushError
from gridpush_drake.identification.result import Identification
from gridpush_drake.multibody.weak_calc import NO_SLOTS
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.contact.trial import PlannedPush, calc_goal_error
from gridpush_drake.planning.goal.cost_to_go import CostToGo
from gridpush_drake.planning.goal.push_plan import REACHED, REASONS, TOO_MANY_PUSHES
from gridpush_drake.planning.goal.push_to_goal import GoalRules, PushDecision, decide_push, forbid
from gridpush_drake.pushes.pose_filter import Pose, PoseFilter, PoseFilterOptions
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.systems.messages import (
    PUSH_COMMAND_SIZE,
    ContactPointMode,
    ContactPointStatus,
    PushCommand,
    PushStatus,
)
from gridpush_drake.systems.object_controller import ObjectController

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ControllerOptions(PoseFilterOptions):
    """How the controller goes about it.

    Attributes:
        max_refusals: pushes in a row that the executor refuses before it is given up.
        apart: pushes that begin nearer to a refused one than this, m,
        turned: in a direction less different than this, rad, are like it, and not tried.
        moved: mean cell distance by which somebody must have moved an object for a new attempt after the end, m.
    """

    max_refusals: int = 10
    apart: float = 0.01
    turned: float = 0.2
    moved: float = 0.01


@dataclass(frozen=True, eq=False)
class ControllerState:
    """All that the controller remembers; never changed, only replaced.

    Attributes:
        status: as on the port.
        goal: that is pushed to; None before the first.
        command: on the port.
        issued: the greatest number of a command so far.
        executed: of the executor when the goal was given, or the last command issued.
        looks: what was seen since everything came to rest.
        decided_at: where the object lay at the last decision.
        way: to the goal.
        refused: pushes that were refused since the last one that was not, (4,) each, see `push_decision.forbid`.
        logged: pushes in the log when the last command was issued.
    """

    status: ContactPointStatus = field(default_factory=ContactPointStatus)
    goal: Pose | None = None
    command: PushCommand = field(default_factory=PushCommand)
    issued: int = 0
    executed: int = 0
    looks: PoseFilter = field(default_factory=PoseFilter)
    decided_at: Array | None = None
    way: CostToGo | None = None
    refused: tuple[Array, ...] = ()
    logged: int = 0

    def __deepcopy__(self, memo: dict[int, Any]) -> "ControllerState":
        """Itself: Drake copies the state at every update, and nothing in it is ever changed."""
        return self

    def turn_to(self, mode: ContactPointMode, reason: str, cause: str = "", **others: Any) -> "ControllerState":
        """In another mode, with nothing seen yet, and no push under way."""
        none = {"expected_pose": None, "expected_error": nan}
        status = replace(self.status, mode=mode, reason=reason, cause=cause, **{**none, **others})
        return replace(self, status=status, looks=self.looks.forget())


REFUSED, ERROR = "refused", "error"
"""Causes of a failure that planning does not know of."""


class ContactPointController(ObjectController[ControllerState]):
    """Pushes an object to a goal pose.

    One push at a time is commanded, when the executor is ready and the object lies still. A refused push is not tried
    again, but another one is chosen. A command that was not taken up when the object went out of sight is withdrawn.
    With another goal on the port everything begins anew, after the push under way.

    .. pydrake_system::

        name: ContactPointController
        input_ports:
        - object_pose
        - identification
        - push_log
        - push_status
        - goal_pose
        output_ports:
        - status
        - push_command

    * object_pose: vector of 3, observed (x, y, theta) of B in W, m and rad; NaN where the object was not seen.
    * identification: abstract `Identification`; without `push_names` what was learned before counts, see `params`.
    * push_log: abstract `PushLog`, all pushes so far; need not be connected.
    * push_status: abstract `PushStatus` of the executor.
    * goal_pose: vector of 3, where the object should lie, (x, y, theta) of B in W, m and rad; NaN for nowhere.
    * status: abstract `ContactPointStatus`.
    * push_command: vector of 6, see `PushCommand`; id 0 before the first.

    Abstract state: one `ControllerState`.
    """

    __slots__ = NO_SLOTS

    def __init__(
        self,
        obj: GridObject,
        rules: GoalRules | None = None,
        *,
        params: CellParameters | None = None,
        options: ControllerOptions | None = None,
    ) -> None:
        """Declares the system.

        Args:
            obj: the object.
            rules: table, obstacles, finger, arm, how near to the goal, and how pushes are chosen.
            params: the model before anything was learned; the prior's by default.
            options: how to go about it.
        """
        self.obj, self.rules, self.options = obj, rules or GoalRules(), options or ControllerOptions()
        super().__init__(obj, ControllerState(), self.options.period)
        self._params = CellParameters.uniform(obj) if params is None else params
        self._goal_pose = self.DeclareVectorInputPort("goal_pose", 3)
        self._declare_command("push_command", PUSH_COMMAND_SIZE, lambda now: now.command.to_vector())

    def _go_on(self, context: Context, now: ControllerState) -> ControllerState:
        """One look: waits for the robot, then for a goal, then for the object, then decides."""
        executor: PushStatus = self._push_status.Eval(context)
        pose, time = self._object_pose.Eval(context), context.get_time()
        if not executor.ready or now.command.command_id not in (0, executor.command_id):
            return self._wait_for_robot(now, executor, pose, time)
        if now.status.mode == ContactPointMode.PUSHING:
            now = self._end_push(now, executor, self._read_log(context))
        now = self._take_goal(now, tuple(self._goal_pose.Eval(context).tolist()), executor)
        if now.goal is None:
            return now
        now = self._look(now, time, pose)
        if len(now.looks) < self.options.looks:
            return now
        return self._decide(now, executor, self._read_found(context), self._read_log(context))

    def _read_found(self, context: Context) -> Identification | None:
        """What was learned; None where that is nothing yet."""
        found: Identification = self._identification.Eval(context)
        return found if found.push_names else None

    def _read_log(self, context: Context) -> PushLog:
        return self._push_log.Eval(context) if self._push_log.HasValue(context) else PushLog(())

    def _wait_for_robot(self, now: ControllerState, executor: PushStatus, pose: Array, time: float) -> ControllerState:
        now = replace(now, looks=now.looks.wait(time, pose))
        if not np.isfinite(pose).all() and executor.ready:
            # it was not taken up, and when the object is seen again it may lie elsewhere
            return replace(now, command=PushCommand(executor.command_id)).turn_to(
                ContactPointMode.WAITING, "The object is not seen."
            )
        return now

    def _end_push(self, now: ControllerState, executor: PushStatus, log: PushLog) -> ControllerState:
        """After a push that was carried out, or refused."""
        status = now.status
        if executor.executed > now.executed:
            off = nan
            if len(log) > now.logged and status.expected_pose is not None and len(log[-1].t_observed):
                off = float(calc_goal_error(self.obj, log[-1].final_pose, status.expected_pose))
            now = replace(now, refused=(), executed=executor.executed)
            return now.turn_to(
                ContactPointMode.WAITING, "A push was made.", pushes=status.pushes + 1, refused=0, prediction_error=off
            )
        direction = now.command.direction
        refused = (*now.refused, np.array([*now.command.start, cos(direction), sin(direction)]))
        now = replace(now, refused=refused)
        if len(refused) < self.options.max_refusals:
            return now.turn_to(
                ContactPointMode.WAITING, f"A push was refused: {executor.reason}.", refused=len(refused)
            )
        reason = f"The last {len(refused)} pushes were refused; the last one because {executor.reason}."
        return now.turn_to(ContactPointMode.FAILED, reason, REFUSED, refused=len(refused))

    def _take_goal(self, now: ControllerState, goal: Pose, executor: PushStatus) -> ControllerState:
        """Begins anew where another goal is given."""
        wanted = goal if np.isfinite(goal).all() else None
        if wanted == now.goal and now.status.reason != ContactPointStatus.reason:
            return now
        reason = "No goal is given." if wanted is None else "Looking at the object."
        begun = ControllerState(
            goal=wanted, command=now.command, issued=now.issued, executed=executor.executed, looks=now.looks
        )
        return begun.turn_to(ContactPointMode.WAITING, reason)

    def _look(self, now: ControllerState, time: float, pose: Array) -> ControllerState:
        """Takes in what is seen of the object at rest."""
        looks, lost = now.looks.take_in(time, pose, self.options), now.status.mode == ContactPointMode.LOST
        if not lost and looks.is_overdue(time, self.options):
            return now.turn_to(ContactPointMode.LOST, f"The object has not been seen for {self.options.timeout:g} s.")
        if lost and len(looks):
            now = now.turn_to(ContactPointMode.WAITING, "The object is seen again.")
        return now if looks is now.looks else replace(now, looks=looks)

    def _decide(
        self, now: ControllerState, executor: PushStatus, found: Identification | None, log: PushLog
    ) -> ControllerState:
        pose, goal = now.looks.calc_mean(), np.array(now.goal)
        if now.status.mode in (ContactPointMode.REACHED, ContactPointMode.FAILED):
            since = np.inf if now.decided_at is None else calc_goal_error(self.obj, pose, now.decided_at)
            if since < self.options.moved or now.status.cause == TOO_MANY_PUSHES:
                return now
            now = replace(now, refused=()).turn_to(ContactPointMode.WAITING, "Somebody moved the object.", refused=0)
        now = replace(now, decided_at=pose)
        params = self._params if found is None else found.params
        rules = forbid(self.rules, now.refused, self.options.apart, self.options.turned)
        try:
            decision = decide_push(self.obj, pose, goal, now.status.pushes, params, found, rules, now.way)
        except GridPushError as error:
            return now.turn_to(ContactPointMode.FAILED, f"No push could be planned: {error}.", ERROR)
        now = replace(now, way=decision.way)
        if decision.chosen is not None and decision.chosen.push is not None:
            return self._command(now, executor, decision, decision.chosen.push, len(log))
        mode = ContactPointMode.REACHED if decision.status == REACHED else ContactPointMode.FAILED
        cause = str(decision.status)
        return now.turn_to(mode, REASONS[cause], cause, error=decision.error)

    def _command(
        self, now: ControllerState, executor: PushStatus, decision: PushDecision, planned: PlannedPush, logged: int
    ) -> ControllerState:
        command = PushCommand.from_push(now.issued + 1, planned.push)
        x, y, theta = planned.pose.tolist()
        expected = float(calc_goal_error(self.obj, planned.pose, np.array(now.goal)))
        now = now.turn_to(
            ContactPointMode.PUSHING, f"Push {now.status.pushes + 1} is under way.", error=decision.error,
            expected_pose=(x, y, theta), expected_error=expected,
        )  # fmt: skip
        return replace(now, command=command, issued=command.command_id, executed=executor.executed, logged=logged)
