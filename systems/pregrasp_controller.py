"""What a pre-grasp controller remembers, and the numbers by which it goes about it.

Getting an object to the table's edge and grasping it there, as a Drake system: the paper's Algorithm 3, made safe.

    waiting ----> exploring, sliding ----> waiting        a push, then a new look
       |                  |                   ^
       |                  +--> stopping ------+           broken off, as the object might fall
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
from pydrake.systems.framework import Context

from gridpush_drake.dynamics.push import Push
from gridpush_drake.errors import GridPushError
from gridpush_drake.identification.result import Identification
from gridpush_drake.multibody.weak_calc import NO_SLOTS
from gridpush_drake.planning.pregrasp.planner import PreGraspDecision, PreGraspPlanner
from gridpush_drake.planning.pregrasp.side_grasp import SideGrasp
from gridpush_drake.planning.pregrasp.slides import TippingMonitor
from gridpush_drake.planning.pregrasp.uncertainty import UncertainModel
from gridpush_drake.pushes.pose_filter import PoseFilter, PoseFilterOptions
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.systems.messages import (
    GRASP_COMMAND_SIZE,
    PUSH_COMMAND_SIZE,
    GraspCommand,
    GraspOutcome,
    GraspStatus,
    PreGraspMode,
    PreGraspStatus,
    PushCommand,
    PushPhase,
    PushStatus,
)
from gridpush_drake.systems.object_controller import ObjectController

GRASPING = (PreGraspMode.VERIFYING, PreGraspMode.GRASPING, PreGraspMode.HOLDING)
"""Modes in which nothing is pushed."""


@dataclass(frozen=True)
class ControllerOptions(PoseFilterOptions):
    """How the controller goes about it.

    Attributes:
        max_refusals: pushes in a row that the executor refuses before it is given up.
        max_grasps: grasps before it is given up.
    """

    looks: int = 8
    timeout: float = 2.0
    max_refusals: int = 5
    max_grasps: int = 3


@dataclass(frozen=True, eq=False)
class ControllerState:
    """All that the controller remembers; never changed, only replaced.

    Attributes:
        status: as on the port.
        push: the last push command.
        grasp: the last grasp command.
        guard: of that push.
        looks: what was seen since everything came to rest.
        refused: pushes in a row that the executor refused.
    """

    status: PreGraspStatus = field(default_factory=PreGraspStatus)
    push: PushCommand = field(default_factory=PushCommand)
    grasp: GraspCommand = field(default_factory=GraspCommand)
    guard: TippingMonitor | None = None
    looks: PoseFilter = field(default_factory=PoseFilter)
    refused: int = 0

    def __deepcopy__(self, memo: dict[int, Any]) -> "ControllerState":
        """Itself: Drake copies the state at every update, and nothing in it is ever changed."""
        return self

    @property
    def shown_push(self) -> PushCommand:
        """The push command on the port: none while a push is broken off, and once the object is grasped."""
        without = (PreGraspMode.STOPPING, *GRASPING)
        return PushCommand() if self.status.mode in without else self.push

    def turn_to(self, mode: PreGraspMode, reason: str, **others: Any) -> "ControllerState":
        """In another mode, with nothing seen yet."""
        return replace(self, status=replace(self.status, mode=mode, reason=reason, **others), looks=self.looks.forget())


Array = NDArray[np.float64]
PUSHES = (PreGraspMode.EXPLORING, PreGraspMode.SLIDING, PreGraspMode.STOPPING)
"""Modes that last as long as a push."""

FindGrasp = Callable[[Array, Array], SideGrasp | None]
"""From the object's pose (3,) in W and its estimated center of mass (2,) in B to the grasp to take; None for none."""


class PreGraspController(ObjectController[ControllerState]):
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
        - status
        - push_command
        - grasp_command

    * object_pose: vector of 3, observed (x, y, theta) of B in W, m and rad; NaN where the object was not seen.
    * identification: abstract `Identification`; without `push_names` before the first push.
    * push_log: abstract `PushLog`, all pushes so far.
    * push_status: abstract `PushStatus` of the push executor.
    * grasp_status: abstract `GraspStatus` of the grasp executor.
    * status: abstract `PreGraspStatus`.
    * push_command: vector of 6, see `PushCommand`; number 0 before the first, while a push is
      broken off, and while the object is grasped.
    * grasp_command: vector of 6, see `GraspCommand`; number 0 before the first.

    Abstract state: one `ControllerState`.
    """

    __slots__ = NO_SLOTS

    def __init__(
        self,
        planner: PreGraspPlanner,
        find_grasp: FindGrasp,
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
            grasp_height: z of the grasp point in W: half the object's thickness, m.
            lift: how high to lift, m.
            seed: of the draws from what is believed.
            options: how to go about it.
        """
        self.planner, self.options, self.seed = planner, options or ControllerOptions(), seed
        super().__init__(planner.obj, ControllerState(), self.options.period)
        self._find_grasp, self._height, self._lift = find_grasp, grasp_height, lift
        self._grasp_status = self.DeclareAbstractInputPort("grasp_status", AbstractValue.Make(GraspStatus()))
        self._declare_command("push_command", PUSH_COMMAND_SIZE, lambda now: now.shown_push.to_vector())
        self._declare_command("grasp_command", GRASP_COMMAND_SIZE, lambda now: now.grasp.to_vector())

    def _go_on(self, context: Context, now: ControllerState) -> ControllerState:
        """One look: waits for the robot, then for the object, then decides."""
        if now.status.over:
            return now
        pushing, grasping = self._push_status.Eval(context), self._grasp_status.Eval(context)
        time, pose = context.get_time(), self._object_pose.Eval(context)
        if now.status.mode == PreGraspMode.GRASPING:
            return self._follow_grasp(replace(now, looks=now.looks.wait(time, pose)), grasping)
        if pushing.number != now.push.number or not (pushing.ready and grasping.ready):
            return self._follow_push(replace(now, looks=now.looks.wait(time, pose)), pushing, pose)
        if now.status.mode in PUSHES:
            now = self._end_push(now, pushing)
            if now.status.over:
                return now
        now = self._look(now, time, pose)
        if len(now.looks) < self.options.looks:
            return now
        pose = now.looks.calc_mean()
        found, log = self._identification.Eval(context), self._push_log.Eval(context)
        return self._decide(now, pose, found, log)

    def _follow_push(self, now: ControllerState, pushing: PushStatus, pose: Array) -> ControllerState:
        """Until a push was carried out, or refused: takes it back where the object is not seen, or might fall."""
        seen = np.isfinite(pose).all()
        if pushing.ready and pushing.number != now.push.number and not seen:
            # it was not taken up, and when the object is seen again it may lie elsewhere
            return replace(now, push=replace(now.push, number=pushing.number)).turn_to(
                PreGraspMode.WAITING, "The object is not seen.", expected_pose=None, **_uncount(now)
            )
        if (
            pushing.phase != PushPhase.PUSHING
            or not seen
            or now.guard is None
            or now.status.mode == PreGraspMode.STOPPING
        ):
            return now
        fault = now.guard.find_fault(pose)
        return now if fault is None else now.turn_to(PreGraspMode.STOPPING, f"The push is broken off: {fault}.")

    def _end_push(self, now: ControllerState, pushing: PushStatus) -> ControllerState:
        """After a push that was carried out, or refused."""
        if not pushing.reason:
            what = "broken off" if now.status.mode == PreGraspMode.STOPPING else "made"
            return replace(now, refused=0).turn_to(PreGraspMode.WAITING, f"A push was {what}.", expected_pose=None)
        undone = _uncount(now)
        if now.refused + 1 >= self.options.max_refusals:
            return now.turn_to(
                PreGraspMode.FAILED, f"The robot refused {now.refused + 1} pushes: {pushing.reason}.", **undone
            )
        return replace(now, refused=now.refused + 1).turn_to(
            PreGraspMode.WAITING, f"The robot refused a push: {pushing.reason}.", expected_pose=None, **undone
        )

    def _look(self, now: ControllerState, time: float, pose: Array) -> ControllerState:
        """Takes in what is seen of the object at rest."""
        looks, lost = now.looks.take_in(time, pose, self.options), now.status.mode == PreGraspMode.LOST
        if not lost and looks.is_overdue(time, self.options):
            reason = f"The object has not been seen for {self.options.timeout:g} s."
            return now.turn_to(PreGraspMode.LOST, reason, goal=None)
        if lost and len(looks):
            now = now.turn_to(PreGraspMode.WAITING, "The object is seen again.")
        return now if looks is now.looks else replace(now, looks=looks)

    def _decide(self, now: ControllerState, pose: Array, found: Identification, log: PushLog) -> ControllerState:
        try:
            model = self._believe(found, log)
            decision = self.planner.decide(pose, model, now.status.pokes, now.status.slides)
        except GridPushError as error:
            return now.turn_to(PreGraspMode.FAILED, f"Nothing could be planned: {error}.", goal=None)
        told = {"goal": decision.goal, "margin": decision.margin, "expected_pose": None}
        if decision.action == "fail":
            return now.turn_to(PreGraspMode.FAILED, _sentence(decision.reason), **told)
        if decision.push is not None:
            return self._command_push(now, pose, model, decision, decision.push)
        if now.status.mode != PreGraspMode.VERIFYING:
            return now.turn_to(PreGraspMode.VERIFYING, _sentence(decision.reason), **told)
        assert model is not None
        return self._command_grasp(now, pose, model, told)

    def _believe(self, found: Identification, log: PushLog) -> UncertainModel | None:
        if not found.push_names:
            return None
        used = log.subset([i for i, seen in enumerate(log) if seen.name in found.push_names])
        return UncertainModel.of_identification(found, seed=self.seed, log=used)

    def _command_push(
        self, now: ControllerState, pose: Array, model: UncertainModel | None, decision: PreGraspDecision, push: Push
    ) -> ControllerState:
        planner, known = self.planner, model or UncertainModel.of_prior(self.planner.obj)
        guard = TippingMonitor.of_push(known.masses, planner.surface, pose, planner.options.slide, self.options.rest)
        poke = decision.action == "poke"
        command = PushCommand.from_push(now.push.number + 1, push)
        expected = None if decision.expected_pose is None else tuple(decision.expected_pose.tolist())
        return replace(now, push=command, guard=guard).turn_to(
            PreGraspMode.EXPLORING if poke else PreGraspMode.SLIDING,
            _sentence(decision.reason),
            pokes=now.status.pokes + poke,
            slides=now.status.slides + (not poke),
            goal=decision.goal,
            margin=decision.margin,
            expected_pose=expected,
        )

    def _command_grasp(
        self, now: ControllerState, pose: Array, model: UncertainModel, told: dict[str, Any]
    ) -> ControllerState:
        grasp = self._find_grasp(pose, model.masses.center_of_mass_polygon.mean(axis=0))
        if grasp is None and told["goal"] is not None:
            grasp = self._find_grasp(pose, told["goal"].part.p_BG)  # what the plan found: farther off, but within reach
        if grasp is None:
            return now.turn_to(PreGraspMode.FAILED, "The gripper reaches no part that hangs over.", **told)
        x, y = grasp.p_WG.tolist()
        command = GraspCommand(now.grasp.number + 1, x, y, self._height, grasp.approach, self._lift)
        return replace(now, grasp=command).turn_to(
            PreGraspMode.GRASPING, "A part that hangs over is taken.", grasps=now.status.grasps + 1, **told
        )

    def _follow_grasp(self, now: ControllerState, grasping: GraspStatus) -> ControllerState:
        """While a grasp is under way, and after it."""
        if grasping.number != now.grasp.number or not grasping.outcome:
            return now
        if grasping.outcome == GraspOutcome.HELD:
            return now.turn_to(PreGraspMode.HOLDING, "The object is lifted and held.")
        if not grasping.ready:
            return now  # it retreats
        what = f"The grasp was {grasping.outcome}: {grasping.reason}."
        mode = PreGraspMode.FAILED if now.status.grasps >= self.options.max_grasps else PreGraspMode.WAITING
        return now.turn_to(mode, what, goal=None)


def _uncount(now: ControllerState) -> dict[str, int]:
    """The counts without the push last commanded."""
    poke = now.status.mode == PreGraspMode.EXPLORING
    return {"pokes": now.status.pokes - poke, "slides": now.status.slides - (not poke)}


def _sentence(words: str) -> str:
    return words[:1].upper() + words[1:] + "."
