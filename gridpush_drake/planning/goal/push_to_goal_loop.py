"""The loop that pushes an object to a goal pose, for controllers and simulated worlds alike.

    waiting ---- at rest, and seen ----> pushing ----> waiting      a push, then a new observation
       |                                    ^
       |                                 poking        where pushes surprised
       |
       +--> reached, failed       until there is another goal, or somebody moves the object

Whenever the robot is ready, the object is observed until it lies still. Then `decide_push` says
where and how to push, by what was learned so far. So an object that slipped, or was moved by
somebody, is pushed from where it lies.

After two surprises in a row, or a clear one, the object is another one than was learned. Then
`RELEARNING_POKES` pokes are made, which tell most of where it bears, before it is pushed on. Where
it hangs over the table's edge, any surprise ends the pushing.

`push_to_goal` steps the loop in a simulated world, and a controller steps it on a robot. A whole
sequence by the model alone is planned by `push_plan`.
"""

from dataclasses import dataclass, field, replace
from enum import StrEnum
from math import nan
from typing import Any

import numpy as np

from gridpush_drake.errors import GridPushError
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.model import Model
from gridpush_drake.notebook import count
from gridpush_drake.planning.closed_loop import (
    FAILED_MODE,
    MAX_FALLBACKS,
    WAITING_MODE,
    ClosedLoop,
    LoopOptions,
    LoopState,
    Observation,
    Pose,
)
from gridpush_drake.planning.contact.trial import PlannedPush, calc_goal_error
from gridpush_drake.planning.goal.cost_to_go import CostToGo
from gridpush_drake.planning.goal.learning_poke import choose_poke_within
from gridpush_drake.planning.goal.next_push import GoalRules
from gridpush_drake.planning.goal.push_decision import decide_push, forbid
from gridpush_drake.planning.goal.push_plan import STATUS_SENTENCES, PushPlanStatus
from gridpush_drake.planning.support_surface import find_supported

MOVED_AFTER_END = 0.01
"""If somebody moves an object by this much after the end, as the mean way of its cells, m, it is
pushed again."""

REFUSED_CAUSE = "refused"
"""Cause of a failure: the robot refused too many pushes in a row."""

ERROR_CAUSE = "error"
"""Cause of a failure: no push could be planned, for an argument makes no sense."""

INNOVATION_CAUSE = "surprised"
"""Cause of a failure: the object moves unlike what was learned of it, and pushing on is not safe or
does not help."""

RELEARNING_POKES = 2
"""Number of pokes after the object was found to be another one than was learned. With the one or
two pushes that surprised, it is then learned anew from three or four."""


class ContactPointMode(StrEnum):
    """What the loop is doing."""

    WAITING = "waiting"
    PUSHING = "pushing"
    POKING = "poking"
    REACHED = "reached"
    FAILED = "failed"
    LOST = "lost"


@dataclass(frozen=True)
class ContactPointStatus:
    """Where the loop stands.

    Attributes:
        mode: "waiting" for a goal, for the robot, or for the object to be seen at rest; "pushing";
            "poking", to learn the object anew; "reached" the goal; "failed"; or "lost" the object
            out of sight.
        reason: the mode in a sentence.
        cause: of "reached" or "failed": a key of `planning.goal.push_plan.REASONS`, "refused",
            "error" or "surprised"; else empty.
        pushes: number of pushes towards this goal that were carried out, pokes among them.
        refused: number of pushes, the last ones in a row, that were refused.
        error: mean cell error to the goal where the object was last seen at rest, m; NaN before.
        expected_pose: (x, y, theta) in which the push under way is predicted to leave the object,
            W, m and rad.
        expected_error: mean cell error to the goal there, m; NaN where no push is under way.
        prediction_error: mean cell distance of where the last push left the object from where it
            was predicted to, m; NaN before.
        innovations: number of the last pushes that were surprises, one after another.
        surprise: the last push's surprise in a sentence; empty where it was none.
    """

    mode: ContactPointMode = ContactPointMode.WAITING
    reason: str = "Nothing was seen yet."
    cause: str = ""
    pushes: int = 0
    refused: int = 0
    error: float = nan
    expected_pose: Pose | None = None
    expected_error: float = nan
    prediction_error: float = nan
    innovations: int = 0
    surprise: str = ""


@dataclass(frozen=True, eq=False)
class PushToGoalState(LoopState):
    """All that the loop remembers; never changed, only replaced.

    Attributes:
        status: where the loop stands.
        begun: whether a goal, or that there is none, was taken notice of.
        goal: pose (x, y, theta) that is pushed to, m and rad; None where there is none.
        decided_at: (3,) where the object lay at the last decision; None before the first.
        planned: the push under way, or the last one, as planned; None before the first.
        cost_to_go: to the goal; None before the first decision.
        simulations: number of the planner's simulations, towards this goal.
        pokes: number of pokes that are still to be made before the object is pushed on.
    """

    status: ContactPointStatus = field(default_factory=ContactPointStatus)
    begun: bool = False
    goal: Pose | None = None
    decided_at: Array | None = None
    planned: PlannedPush | None = None
    cost_to_go: CostToGo | None = None
    simulations: int = 0
    pokes: int = 0

    def turn_to(self, mode: str, reason: str, **others: Any) -> "PushToGoalState":
        """The state in another mode, see `LoopState.turn_to`; it has no cause unless given one."""
        return super().turn_to(mode, reason, **{"cause": "", "expected_error": nan, **others})


class PushToGoalLoop(ClosedLoop[PushToGoalState]):
    """Pushes an object to the goal that it is shown.

    One push at a time is asked for, when the robot is ready and the object lies still. A refused
    push is not tried again, but another one is chosen. With another goal everything begins anew,
    after the push under way.

    Attributes:
        obj: the object.
        rules: how to push.
        model: the object, with its parameters before anything was learned.
    """

    pushing_modes = (ContactPointMode.PUSHING, ContactPointMode.POKING)

    def __init__(
        self,
        model: Model,
        rules: GoalRules | None = None,
        options: LoopOptions | None = None,
    ) -> None:
        """Takes what never changes.

        Args:
            model: one object, with its parameters.
            rules: how to push.
            options: how the loop observes, and when it gives up.
        """
        self.obj = model.obj
        self.model = model
        self.rules = rules or GoalRules()
        self.options = options or LoopOptions()

    def begin(self) -> PushToGoalState:
        """The state before the first observation."""
        return PushToGoalState()

    def is_idle(self, now: PushToGoalState) -> bool:
        """Whether there is no goal."""
        return now.goal is None

    def _count_made(self, now: PushToGoalState, seen: Observation) -> dict[str, Any]:
        status = now.status
        log = seen.log
        error = nan
        # Where the push was logged, and the object was seen, how far from the prediction it ended.
        if len(log) > now.logged and status.expected_pose is not None and len(log[-1].t_observed):
            error = float(calc_goal_error(self.obj, log[-1].final_pose, status.expected_pose))
        return {"pushes": status.pushes + 1, "refused": 0, "prediction_error": error}

    def _count_refused(self, now: PushToGoalState) -> dict[str, Any]:
        count = len(now.refused)
        return {
            "refused": count,
            "cause": REFUSED_CAUSE if count >= self.options.max_refusals else "",
        }

    def _prepare(self, now: PushToGoalState, seen: Observation) -> PushToGoalState:
        """The state that begins anew, where another goal is given."""
        x, y, theta = seen.goal.tolist()
        wanted = (x, y, theta) if np.isfinite(seen.goal).all() else None
        if wanted == now.goal and now.begun:
            return now
        reason = "No goal is given." if wanted is None else "Looking at the object."
        begun = PushToGoalState(
            begun=True,
            goal=wanted,
            push=now.push,
            push_id=now.push_id,
            filter=now.filter,
            believed=now.believed,
            logged=now.logged,
            innovations=now.innovations,
            fallbacks=now.fallbacks,
            pokes=now.pokes,
        )
        return begun.turn_to(WAITING_MODE, reason)

    def _end_push(self, now: PushToGoalState, seen: Observation) -> PushToGoalState:
        """The state after a push; pokes are due if it says that the object has changed."""
        after = super()._end_push(now, seen)
        if after.innovations is not now.innovations and after.innovations.is_changed:
            return replace(after, pokes=RELEARNING_POKES, fallbacks=after.fallbacks + 1)
        # A poke that was made is one less to make; one that was refused is chosen anew.
        poked = now.status.mode == ContactPointMode.POKING and not seen.robot.reason
        return replace(after, pokes=max(now.pokes - 1, 0)) if poked else after

    def decide(self, now: PushToGoalState, seen: Observation) -> PushToGoalState:
        """The state with the next push asked for, or at the end."""
        pose = now.filter.calc_mean()
        found = seen.identification
        # After the end there is another attempt only if somebody moved the object.
        if now.status.mode in (ContactPointMode.REACHED, FAILED_MODE):
            moved = np.inf
            if now.decided_at is not None:
                moved = float(calc_goal_error(self.obj, pose, now.decided_at))
            if moved < MOVED_AFTER_END or now.status.cause == PushPlanStatus.TOO_MANY_PUSHES:
                return now
            now = replace(now, refused=()).turn_to(
                WAITING_MODE, "Somebody moved the object.", refused=0
            )
        now = replace(now, decided_at=pose)
        try:
            surprised = self._face_innovation(now, seen, pose)
            if surprised is not None:
                return surprised
            decision = decide_push(
                model=self.model if found is None else found,
                pose=pose,
                goal=np.array(now.goal),
                made=now.status.pushes,
                identification=found,
                rules=forbid(self.rules, now.refused),
                cost_to_go=now.cost_to_go,
            )
        except GridPushError as error:
            return now.turn_to(
                FAILED_MODE, f"No push could be planned: {error}.", cause=ERROR_CAUSE
            )
        chosen = decision.chosen
        now = replace(
            now,
            cost_to_go=decision.cost_to_go,
            simulations=now.simulations + (chosen.simulations if chosen else 0),
        )
        if chosen is not None and chosen.push is not None:
            return self._push(now, decision.error, chosen.push, seen)
        cause = decision.status
        assert cause is not None
        mode = ContactPointMode.REACHED if cause == PushPlanStatus.REACHED else FAILED_MODE
        return now.turn_to(mode, STATUS_SENTENCES[cause], cause=cause.value, error=decision.error)

    def _face_innovation(
        self, now: PushToGoalState, seen: Observation, pose: Array
    ) -> PushToGoalState | None:
        """The state in which the loop pokes or stops, because pushes surprised.

        Args:
            now: the state.
            seen: what is seen.
            pose: (3,) where the object lies, X_WB, m and rad.

        Returns:
            The state; None where nothing surprised, the object is at the goal, or no more pushes
            are allowed.

        Raises:
            PlanningError: a poke cannot be planned.
        """
        last = now.innovations.last
        if (last is None and not now.pokes) or now.status.pushes >= self.rules.max_pushes:
            return None
        error = float(calc_goal_error(self.obj, pose, np.array(now.goal)))
        if error <= self.rules.tolerance:
            return None
        surface = self.rules.constraints.surface
        hangs_over = surface is not None and not find_supported(self.obj, pose, surface).all()
        if last is not None and hangs_over:
            reason = (
                f"The object hangs over the table's edge, and surprised. {last.describe()} "
                "It is pushed no further."
            )
            return now.turn_to(FAILED_MODE, reason, cause=INNOVATION_CAUSE, error=error)
        if not now.pokes or seen.identification is None:
            return None
        if now.fallbacks > MAX_FALLBACKS:
            reason = "The object goes on moving unlike what was learned of it."
            return now.turn_to(FAILED_MODE, reason, cause=INNOVATION_CAUSE, error=error)
        poke = choose_poke_within(
            forbid(self.rules, now.refused),
            pose,
            seen.identification,
            now.innovations.select(seen.log),
            np.array(now.goal),
        )
        if poke is None:
            reason = "The object moves unlike what was learned of it, and no poke is safe."
            return now.turn_to(FAILED_MODE, reason, cause=INNOVATION_CAUSE, error=error)
        reason = (
            "The last pushes surprised, and the object is learned anew: "
            f"{count(now.pokes, 'poke')} to go."
        )
        return self._push(now, error, poke, seen, ContactPointMode.POKING, reason)

    def _push(
        self,
        now: PushToGoalState,
        error: float,
        planned: PlannedPush,
        seen: Observation,
        mode: ContactPointMode = ContactPointMode.PUSHING,
        reason: str = "",
    ) -> PushToGoalState:
        """The state with a push asked for.

        Args:
            now: the state.
            error: mean cell error to the goal now, m.
            planned: the push.
            seen: what it was chosen by.
            mode: "pushing", or "poking".
            reason: why it is made, in a sentence; its number by default.
        """
        x, y, theta = planned.pose.tolist()
        expected_error = float(calc_goal_error(self.obj, planned.pose, np.array(now.goal)))
        return replace(now, planned=planned).ask(
            planned.push,
            mode,
            reason or f"Push {now.status.pushes + 1} is under way.",
            seen,
            error=error,
            expected_pose=(x, y, theta),
            expected_error=expected_error,
        )
