"""Getting an object to the table's rim and grasping it there, as a Drake system: the paper's Algorithm 3, made safe.

    waiting ----> exploring, sliding ----> waiting        a push, then a new look
       |                                      ^
       +--> verifying --> grasping -----------+           what was missed or slipped is looked at anew
                             |
                             +--> holding

Whenever robot and object are at rest the object is looked at for a while, and `planning.pregrasp` decides what to do
next; nothing is done on an old look. What is decided depends on that look, on what was learned and on how often
something was tried: an object that slipped or was moved by somebody is simply dealt with where it lies.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from gridpush_drake.dynamics.push import Push
from gridpush_drake.errors import PlanningError
from gridpush_drake.identification.result import Identification
from gridpush_drake.planning.belief import Belief
from gridpush_drake.planning.pregrasp import PreGraspDecision, PreGraspPlanner
from gridpush_drake.planning.side_grasp import SideGrasp
from gridpush_drake.pushes.log import PushLog
from gridpush_drake.systems import grasp_status, pre_grasp_status
from gridpush_drake.systems.grasp_command import GRASP_COMMAND_SIZE, GraspCommand
from gridpush_drake.systems.grasp_status import GraspStatus
from gridpush_drake.systems.pre_grasp_status import PreGraspStatus
from gridpush_drake.systems.push_command import PUSH_COMMAND_SIZE, PushCommand
from gridpush_drake.systems.push_status import PushStatus

Array = NDArray[np.float64]
FindGrasp = Callable[[Array, Array], SideGrasp | None]
"""From the object's pose (3,) in W and its estimated centre of mass (2,) in B to the grasp to take; None for none."""


@dataclass(frozen=True)
class ControllerOptions:
    """How the controller goes about it.

    Attributes:
        period: between two looks, s.
        looks: at the object at rest, whose mean counts.
        rest: looks further apart than this are not of one rest, m,
        rest_angle: likewise, rad.
        patience: how long the object may be out of sight before it counts as lost, s.
        most_refusals: pushes in a row that the executor refuses before it is given up.
        most_grasps: grasps before it is given up.
    """

    period: float = 0.05
    looks: int = 8
    rest: float = 0.004
    rest_angle: float = 0.04
    patience: float = 2.0
    most_refusals: int = 5
    most_grasps: int = 3

    def __post_init__(self) -> None:
        for name in ("period", "rest", "rest_angle", "patience"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise PlanningError(f"{name} is {getattr(self, name)!r}; expected a positive number")
        for name in ("looks", "most_refusals", "most_grasps"):
            if getattr(self, name) < 1:
                raise PlanningError(f"{name} is {getattr(self, name)!r}; expected 1 or more")


@dataclass(frozen=True, eq=False)
class ControllerState:
    """All that the controller remembers; never changed, only replaced.

    Attributes:
        status: as on the port.
        push: the last push command.
        grasp: the last grasp command.
        looks: poses seen since everything came to rest.
        last_seen: when the object was, s.
        refused: pushes in a row that the executor refused.
    """

    status: PreGraspStatus = field(default_factory=PreGraspStatus)
    push: PushCommand = field(default_factory=PushCommand)
    grasp: GraspCommand = field(default_factory=GraspCommand)
    looks: tuple[tuple[float, float, float], ...] = ()
    last_seen: float = 0.0
    refused: int = 0

    def __deepcopy__(self, memo: dict[int, Any]) -> "ControllerState":
        """Itself: Drake copies the state at every update, and nothing in it is ever changed."""
        return self

    @property
    def shown_push(self) -> PushCommand:
        """The push command on the port: none once the object is grasped."""
        grasping = (pre_grasp_status.VERIFYING, pre_grasp_status.GRASPING, pre_grasp_status.HOLDING)
        return PushCommand() if self.status.mode in grasping else self.push

    def turn_to(self, mode: str, reason: str, **others: Any) -> "ControllerState":
        """In another mode, with nothing seen yet."""
        return replace(self, status=replace(self.status, mode=mode, reason=reason, **others), looks=())


class PreGraspController(LeafSystem):
    """Explores, slides, verifies, grasps and lifts.

    .. pydrake_system::

        name: PreGraspController
        input_ports:
        - object_pose
        - identification
        - push_log
        - push_status
        - grasp_status
        output_ports:
        - push_command
        - grasp_command
        - status

    * object_pose: vector of 3, observed (x, y, theta) of B in W, m and rad; NaN where the object was not seen.
    * identification: abstract `Identification`, or None before the first push.
    * push_log: abstract `PushLog`, all pushes so far.
    * push_status: abstract `PushStatus` of the push executor.
    * grasp_status: abstract `GraspStatus` of the grasp executor.
    * push_command: vector of 6, see `PushCommand`; number 0 before the first, and while the object is grasped.
    * grasp_command: vector of 6, see `GraspCommand`; number 0 before the first.
    * status: abstract `PreGraspStatus`.

    Abstract state: one `ControllerState`.
    """

    def __init__(
        self,
        planner: PreGraspPlanner,
        find_grasp: FindGrasp,
        friction_range: tuple[float, float] | None = None,
        *,
        grasp_height: float = 0.015,
        lift: float = 0.1,
        seed: int = 0,
        options: ControllerOptions | None = None,
    ) -> None:
        """Declares the system.

        Args:
            planner: decides, for one object on one table.
            find_grasp: finds how to take the object where it lies.
            friction_range: least and greatest friction of any cell; the object's own bounds where None.
            grasp_height: z of the grasp point in W: half the object's thickness, m.
            lift: how high to lift, m.
            seed: of the draws from what is believed.
            options: how to go about it.
        """
        super().__init__()
        self.planner, self.options, self.seed = planner, options or ControllerOptions(), seed
        self._find_grasp, self._friction_range = find_grasp, friction_range
        self._height, self._lift = grasp_height, lift
        self._state = self.DeclareAbstractState(AbstractValue.Make(ControllerState()))
        self._object_pose = self.DeclareVectorInputPort("object_pose", 3)
        self._identification = self.DeclareAbstractInputPort("identification", AbstractValue.Make(object()))
        self._push_log = self.DeclareAbstractInputPort("push_log", AbstractValue.Make(object()))
        self._push_status = self.DeclareAbstractInputPort("push_status", AbstractValue.Make(PushStatus()))
        self._grasp_status = self.DeclareAbstractInputPort("grasp_status", AbstractValue.Make(GraspStatus()))
        state = {self.abstract_state_ticket(self._state)}

        def declare(name: str, size: int, command: Callable[[ControllerState], Array]) -> None:
            self.DeclareVectorOutputPort(
                name, size, lambda context, output: output.SetFromVector(command(self._get_state(context))), state
            )

        declare("push_command", PUSH_COMMAND_SIZE, lambda now: now.shown_push.to_vector())
        declare("grasp_command", GRASP_COMMAND_SIZE, lambda now: now.grasp.to_vector())
        self.DeclareAbstractOutputPort(
            "status",
            lambda: AbstractValue.Make(PreGraspStatus()),
            lambda context, output: output.set_value(self._get_state(context).status),
            state,
        )
        self.DeclarePeriodicUnrestrictedUpdateEvent(self.options.period, 0.0, self._update)

    def _get_state(self, context: Context) -> ControllerState:
        state: ControllerState = context.get_abstract_state(int(self._state)).get_value()
        return state

    def _update(self, context: Context, state: State) -> EventStatus:
        now = self._get_state(context)
        new = now if now.status.over else self._go_on(context, now)
        if new is now:
            return EventStatus.DidNothing()
        state.get_mutable_abstract_state(int(self._state)).set_value(new)
        return EventStatus.Succeeded()

    def _go_on(self, context: Context, now: ControllerState) -> ControllerState:
        """One look: waits for the robot, then for the object, then decides."""
        pushing, grasping = self._push_status.Eval(context), self._grasp_status.Eval(context)
        if now.status.mode == pre_grasp_status.GRASPING:
            return self._follow_grasp(now, grasping)
        if pushing.number != now.push.number or not (pushing.ready and grasping.ready):
            return replace(now, looks=()) if now.looks else now
        if now.status.mode in (pre_grasp_status.EXPLORING, pre_grasp_status.SLIDING):
            now = self._end_push(now, pushing)
            if now.status.over:
                return now
        now = self._look(now, context.get_time(), self._object_pose.Eval(context))
        if len(now.looks) < self.options.looks:
            return now
        pose = np.mean(now.looks, axis=0)
        found, log = self._identification.Eval(context), self._push_log.Eval(context)
        return self._decide(now, pose, found, log)

    def _end_push(self, now: ControllerState, pushing: PushStatus) -> ControllerState:
        """After a push that was carried out, or refused."""
        if not pushing.reason:
            return replace(now, refused=0).turn_to(pre_grasp_status.WAITING, "A push was made.", expected_pose=None)
        undone = {"pokes": now.status.pokes - 1} if now.status.mode == pre_grasp_status.EXPLORING else {
            "slides": now.status.slides - 1
        }  # fmt: skip
        if now.refused + 1 >= self.options.most_refusals:
            return now.turn_to(
                pre_grasp_status.FAILED, f"The robot refused {now.refused + 1} pushes: {pushing.reason}.", **undone
            )
        return replace(now, refused=now.refused + 1).turn_to(
            pre_grasp_status.WAITING, f"The robot refused a push: {pushing.reason}.", expected_pose=None, **undone
        )

    def _look(self, now: ControllerState, time: float, pose: Array) -> ControllerState:
        """Takes in what is seen of the object at rest."""
        if np.isnan(pose).any():
            if time - now.last_seen <= self.options.patience or now.status.mode == pre_grasp_status.LOST:
                return replace(now, looks=()) if now.looks else now
            return now.turn_to(
                pre_grasp_status.LOST, f"The object has not been seen for {self.options.patience:g} s.", goal=None
            )
        if now.status.mode == pre_grasp_status.LOST:
            now = now.turn_to(pre_grasp_status.WAITING, "The object is seen again.")
        x, y, theta = pose.tolist()
        looks = np.array([*now.looks, (x, y, theta)])[-self.options.looks :]
        off = np.abs(looks - looks[-1])
        moved = (off[:, :2].max(axis=1) > self.options.rest) | (off[:, 2] > self.options.rest_angle)
        kept = looks[int(np.flatnonzero(moved)[-1]) + 1 :] if moved.any() else looks
        return replace(now, looks=tuple(map(tuple, kept.tolist())), last_seen=time)

    def _decide(self, now: ControllerState, pose: Array, found: Identification | None, log: PushLog) -> ControllerState:
        belief = self._believe(found, log)
        decision = self.planner.decide(pose, belief, now.status.pokes, now.status.slides)
        told = {"goal": decision.goal, "margin": decision.margin, "expected_pose": None}
        if decision.action == "fail":
            return now.turn_to(pre_grasp_status.FAILED, _sentence(decision.reason), **told)
        if decision.push is not None:
            return self._command_push(now, decision, decision.push)
        if now.status.mode != pre_grasp_status.VERIFYING:
            return now.turn_to(pre_grasp_status.VERIFYING, _sentence(decision.reason), **told)
        assert belief is not None
        return self._command_grasp(now, pose, belief, told)

    def _believe(self, found: Identification | None, log: PushLog) -> Belief | None:
        if found is None:
            return None
        used = log.subset([i for i, seen in enumerate(log) if seen.name in found.push_names])
        return Belief.of_identification(found, self._friction_range, seed=self.seed, log=used)

    def _command_push(self, now: ControllerState, decision: PreGraspDecision, push: Push) -> ControllerState:
        poke = decision.action == "poke"
        command = PushCommand.from_push(now.push.number + 1, push)
        expected = None if decision.expected_pose is None else tuple(decision.expected_pose.tolist())
        return replace(now, push=command).turn_to(
            pre_grasp_status.EXPLORING if poke else pre_grasp_status.SLIDING,
            _sentence(decision.reason),
            pokes=now.status.pokes + poke,
            slides=now.status.slides + (not poke),
            goal=decision.goal,
            margin=decision.margin,
            expected_pose=expected,
        )

    def _command_grasp(
        self, now: ControllerState, pose: Array, belief: Belief, told: dict[str, Any]
    ) -> ControllerState:
        grasp = self._find_grasp(pose, belief.masses.centre_of_mass_polygon.mean(axis=0))
        if grasp is None:
            return now.turn_to(pre_grasp_status.FAILED, "The gripper reaches no part that hangs over.", **told)
        x, y = grasp.p_WG.tolist()
        command = GraspCommand(now.grasp.number + 1, x, y, self._height, grasp.approach, self._lift)
        return replace(now, grasp=command).turn_to(
            pre_grasp_status.GRASPING, "A part that hangs over is taken.", grasps=now.status.grasps + 1, **told
        )

    def _follow_grasp(self, now: ControllerState, grasping: GraspStatus) -> ControllerState:
        """While a grasp is under way, and after it."""
        if grasping.number != now.grasp.number or not grasping.outcome:
            return now
        if grasping.outcome == grasp_status.HELD:
            return now.turn_to(pre_grasp_status.HOLDING, "The object is lifted and held.")
        if not grasping.ready:
            return now  # it retreats
        what = f"The grasp was {grasping.outcome}: {grasping.reason}."
        mode = pre_grasp_status.FAILED if now.status.grasps >= self.options.most_grasps else pre_grasp_status.WAITING
        return now.turn_to(mode, what, goal=None)


def _sentence(words: str) -> str:
    return words[:1].upper() + words[1:] + "."
