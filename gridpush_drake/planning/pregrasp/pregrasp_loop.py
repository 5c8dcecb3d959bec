"""The loop that grasps an object at the table's edge: the paper's Algorithm 3, made safe.

    waiting ----> exploring, sliding ----> waiting        a push, then a new observation
       |                  |                   ^
       |                  +--> stopping ------+           a push is broken off in which the object
       |                                      ^           might fall, or hit something
       +--> weighing -------------------------+           a press at the edge, then a new look
       |                                      ^
       +--> verifying --> grasping -----------+           an object that was missed, or slipped, is
                    |        |                            observed anew
                    |        +--> holding
                    +--> ready                            where somebody else is to grasp it

Whenever robot and object are at rest the object is observed for a while, and the planner decides
what to do next; nothing is done on an old observation. A decision depends on that, on what was
learned, and on how often something was tried. So an object that slipped, or was moved by somebody,
is simply taken from where it lies.

After two surprises in a row, or a clear one (`identification.innovation`), the object is another
one than was learned. The planner then begins anew: it pokes until it knows enough, before it slides
on.

If an object that surprised hangs over the edge, what matters is that it does not fall. After a
slight surprise, the first one there, the push is learned from, all that was learned is taken as
less sure, and the stability margin is judged anew. If it still holds, the loop goes on with short
slides until a push ends as it was predicted. If it does not, or what was learned does not explain
the push either, or the object surprised clearly, or for the second time, it is neither slid on nor
grasped there. Short pushes bring it back onto the table, and there the planner begins anew. Where
no push does so safely, by all models by which the object stays where it lies, it is given up. If
the center of mass was weighed, slight surprises say nothing of it: then it only matters whether the
margin holds.

It weighs only where its planner does (`weighing_planner`). An object that withstood a press is
heavier than was supposed, and is pressed where less force would do. Where it slid under a press it
is not pressed again. After several presses in a row that weighed nothing it is pressed no more, and
the loop goes on with what is known.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import StrEnum
from math import inf, nan
from typing import Any

from gridpush_drake.dynamics.push import Push
from gridpush_drake.errors import GridPushError
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.innovation import check_innovation
from gridpush_drake.identification.result import Identification
from gridpush_drake.planning.belief import Belief
from gridpush_drake.planning.closed_loop import (
    FAILED_MODE,
    LOST_MODE,
    MAX_FALLBACKS,
    WAITING_MODE,
    ClosedLoop,
    LoopOptions,
    LoopState,
    Observation,
    Pose,
)
from gridpush_drake.planning.plausible_masses import PlausibleMassSet
from gridpush_drake.planning.pregrasp.decision import PokeForecast, PreGraspDecision
from gridpush_drake.planning.pregrasp.goals import PreGraspGoal
from gridpush_drake.planning.pregrasp.grasp.grasp_parts import FlatPart
from gridpush_drake.planning.pregrasp.grasp.side_grasp import SideGrasp
from gridpush_drake.planning.pregrasp.planner import PreGraspPlanner
from gridpush_drake.planning.pregrasp.push_monitor import PushMonitor
from gridpush_drake.planning.robot_status import GraspOutcome, GraspStatus, PressStatus, PushPhase
from gridpush_drake.planning.support_surface import find_supported
from gridpush_drake.planning.weighing.press import PressOutcome, PressTarget
from gridpush_drake.pushes.push_log import PushLog

FindGrasp = Callable[[Array, Array, PlausibleMassSet, bool], SideGrasp | None]
"""Finds a grasp; returns None where there is none.

Its arguments are the object's pose (3,) in W, the point (2,) in B near which to take it, the masses
that it may have, and True if the pads must hold it whichever of these it has (False: with its
center of mass where it is estimated)."""

Infer = Callable[[Identification | None, PushLog], Belief | None]
"""Says what is possible, given what was learned and the pushes so far; returns None where more must
be seen first."""


MAX_EDGE_INNOVATIONS = 1
"""Number of slight surprises of an object that hangs over the edge, after which the loop goes on.
After the next one it gives up."""

COVARIANCE_INFLATION = 2.0
"""After a surprise over the edge, the standard deviations of all that was learned are taken so many
times as large as would have made the push just no surprise."""

MAX_WAITS = 10
"""Number of times that the object is looked at anew until a push that surprised over the edge is
learned from. Then the loop gives up."""

WEIGHED_CENTER_STD = 0.005
"""Greatest standard deviation of a weighed center of mass, along x and along y, m, for slight
surprises over the edge not to matter. After a surprise it is taken as less sure, too."""

CAREFUL_LENGTH = 0.03
"""Length of the longest slide after a surprise over the edge, m."""

MAX_RETREATS = 12
"""Number of pushes, over the whole run, that bring an object back onto the table after surprises
over the edge. Then the loop gives up."""


class PreGraspMode(StrEnum):
    """What the loop is doing."""

    WAITING = "waiting"
    EXPLORING = "exploring"
    SLIDING = "sliding"
    STOPPING = "stopping"
    WEIGHING = "weighing"
    VERIFYING = "verifying"
    READY = "ready"
    GRASPING = "grasping"
    HOLDING = "holding"
    LOST = "lost"
    FAILED = "failed"


@dataclass(frozen=True, eq=False)
class PreGraspStatus:
    """Where the loop stands.

    Attributes:
        mode: "waiting" (to see the object at rest), "exploring", "sliding", "stopping" (a push that
            is broken off), "weighing" (a press at the table's edge is made), "verifying" (that it
            can be grasped where it lies), "ready" (to be grasped by somebody else), "grasping"
            (until it is lifted), "holding", "lost" (from sight) or "failed".
        reason: for the mode, in a sentence.
        pokes: number of pokes asked for so far and not refused.
        slides: number of slides asked for so far and not refused.
        grasps: number of grasps asked for so far.
        presses: number of presses so far that weighed the object.
        goal: the goal that the object is slid to, or grasped at; None where there is none.
        expected_pose: (x, y, theta) where the push under way is expected to leave the object, m and
            rad; None without.
        margin: stability margin of the goal at the worst, m; NaN without one.
        forecast: of the last poke asked for; None before the first.
        innovations: number of the last pushes that were surprises, one after another.
        surprise: the last push's surprise in a sentence; empty where it was none.
    """

    mode: PreGraspMode = PreGraspMode.WAITING
    reason: str = "The object was not looked at yet."
    pokes: int = 0
    slides: int = 0
    grasps: int = 0
    presses: int = 0
    goal: PreGraspGoal | None = None
    expected_pose: Pose | None = None
    margin: float = nan
    forecast: PokeForecast | None = None
    innovations: int = 0
    surprise: str = ""

    @property
    def over(self) -> bool:
        """Whether nothing more is done."""
        return self.mode in (PreGraspMode.READY, PreGraspMode.HOLDING, PreGraspMode.FAILED)


@dataclass(frozen=True)
class PreGraspLoopOptions(LoopOptions):
    """How the loop observes, and when it gives up; see `LoopOptions` for the other fields.

    Attributes:
        max_grasps: number of grasps after which the loop gives up.
        max_failed_presses: number of presses in a row that weighed nothing after which the object
            is pressed no more.
    """

    observations: int = 8
    timeout: float = 2.0
    max_refusals: int = 5
    max_grasps: int = 3
    max_failed_presses: int = 4


SLIPS = (PressOutcome.SLID, PressOutcome.MOVED)
"""Outcomes of presses after which an object is not pressed at the same place again."""

NO_PUSH = (
    PreGraspMode.STOPPING,
    PreGraspMode.WEIGHING,
    PreGraspMode.VERIFYING,
    PreGraspMode.READY,
    PreGraspMode.GRASPING,
    PreGraspMode.HOLDING,
)
"""Modes in which no push is asked for."""


@dataclass(frozen=True, eq=False)
class PreGraspState(LoopState):
    """All that the loop remembers; never changed, only replaced.

    Attributes:
        status: where the loop stands.
        monitor: of the push under way, or of the last one; None before the first.
        grasp: the last grasp asked for; None before the first.
        grasp_id: number of that grasp, counted from 1; 0 before the first.
        pokes_before: number of pokes made before the loop last fell back to pokes.
        slides_before: number of slides made before that.
        press: the last press asked for; None before the first.
        press_id: number of that press, counted from 1; 0 before the first.
        press_pose: (x, y, theta) where the object lay then, m and rad; None before the first.
        no_tilt_count: number of presses at which the object did not tilt, since the last one at
            which it did.
        failed_presses: number of presses in a row that weighed nothing.
        slid_places: where on the object it was pressed and slid, body frame, m.
        edge_innovations: number of surprises so far with which the object came to hang over the
            edge.
        waits: number of times that the object was looked at anew since the last push, because a
            push that surprised was not learned from yet.
        retreating: whether the object is being brought back onto the table.
        retreats: number of pushes that were to bring it back.
    """

    status: PreGraspStatus = field(default_factory=PreGraspStatus)
    monitor: PushMonitor | None = None
    grasp: SideGrasp | None = None
    grasp_id: int = 0
    pokes_before: int = 0
    slides_before: int = 0
    press: PressTarget | None = None
    press_id: int = 0
    press_pose: Pose | None = None
    no_tilt_count: int = 0
    failed_presses: int = 0
    slid_places: tuple[tuple[float, float], ...] = ()
    edge_innovations: int = 0
    waits: int = 0
    retreating: bool = False
    retreats: int = 0

    @property
    def shown_press(self) -> PressTarget | None:
        """The press that is asked for: none before the first, and where it was taken back."""
        return self.press if self.status.mode == PreGraspMode.WEIGHING else None

    @property
    def shown_push(self) -> Push | None:
        """The push that is asked for: none while one is broken off, or in a grasp."""
        return None if self.status.mode in NO_PUSH else self.push

    def turn_to(self, mode: str, reason: str, **others: Any) -> "PreGraspState":
        """The state in another mode, see `LoopState.turn_to`. A lost object has no goal."""
        if mode == LOST_MODE:
            others = {"goal": None, **others}
        return super().turn_to(mode, reason, **others)


class PreGraspLoop(ClosedLoop[PreGraspState]):
    """Explores, slides, verifies, grasps and lifts.

    Attributes:
        planner: decides, for one object on one table.
        seed: of the draws from what is held possible.
    """

    pushing_modes = (PreGraspMode.EXPLORING, PreGraspMode.SLIDING, PreGraspMode.STOPPING)

    def __init__(
        self,
        planner: PreGraspPlanner,
        find_grasp: FindGrasp | None,
        *,
        infer: Infer | None = None,
        seed: int = 0,
        options: PreGraspLoopOptions | None = None,
    ) -> None:
        """Takes what never changes.

        Args:
            planner: decides what to do.
            find_grasp: finds a grasp where the planner wants one; None to end where the object
                could be grasped.
            infer: says what is possible; by default the identification's posterior does.
            seed: of the draws from what is possible.
            options: how the loop observes, and when it gives up.
        """
        self.planner = planner
        self.seed = seed
        self._find_grasp = find_grasp
        self.options: PreGraspLoopOptions = options or PreGraspLoopOptions()
        self._infer = infer or self.infer_from_identification

    def begin(self) -> PreGraspState:
        """The state before the first observation."""
        return PreGraspState()

    def infer_from_identification(
        self, found: Identification | None, log: PushLog
    ) -> Belief | None:
        """Says what is possible by the posterior; None before anything was learned."""
        if found is None:
            return None
        used = log.subset([i for i, seen in enumerate(log) if seen.name in found.push_names])
        return Belief.of_identification(found, seed=self.seed, log=used)

    def is_idle(self, now: PreGraspState) -> bool:
        """Whether nothing more is done."""
        return now.status.over

    def observe(self, now: PreGraspState, seen: Observation) -> tuple[PreGraspState, bool]:
        """The state after an observation but for the decision, and whether a decision is due."""
        if now.status.over:
            return now, False
        if now.status.mode == PreGraspMode.GRASPING:
            now = replace(now, filter=now.filter.wait(seen.time, seen.pose))
            return self._follow_grasp(now, seen.gripper), False
        if now.status.mode == PreGraspMode.WEIGHING:
            now = replace(now, filter=now.filter.wait(seen.time, seen.pose))
            return self.follow_press(now, seen.presser), False
        return super().observe(now, seen)

    def _wait(self, now: PreGraspState, seen: Observation) -> PreGraspState:
        """The state while the robot is at work.

        A push is broken off if the object might fall in it, or hit another one.
        """
        now = super()._wait(now, seen)
        if seen.robot.phase != PushPhase.PUSHING or not seen.seen:
            return now
        if now.monitor is None or now.status.mode == PreGraspMode.STOPPING:
            return now
        fault = now.monitor.find_fault(seen.pose)
        if fault is None:
            return now
        reason = f"The push is broken off: {fault}."
        return now.turn_to(PreGraspMode.STOPPING, reason, expected_pose=now.status.expected_pose)

    def _count_made(self, now: PreGraspState, seen: Observation) -> dict[str, Any]:
        if now.status.mode == PreGraspMode.STOPPING:
            return {"reason": "A push was broken off."}
        return {}

    def _count_refused(self, now: PreGraspState) -> dict[str, Any]:
        # A push that was refused was counted when it was asked for.
        if now.status.mode == PreGraspMode.EXPLORING:
            return {"pokes": now.status.pokes - 1, "slides": now.status.slides}
        return {"pokes": now.status.pokes, "slides": now.status.slides - 1}

    def _judge(self, now: PreGraspState, seen: Observation) -> PreGraspState:
        """The state after a push was judged.

        One that was broken off is not: the loop saw already that something else moved the object.
        """
        broken_off = now.status.mode == PreGraspMode.STOPPING
        return now if broken_off else super()._judge(now, seen)

    def _end_push(self, now: PreGraspState, seen: Observation) -> PreGraspState:
        """The state after a push; the planner begins anew if the object has changed."""
        after = replace(super()._end_push(now, seen), waits=0)
        if after.innovations is now.innovations or after.innovations.last is None:
            return after
        if self._hangs_over(seen.log[-1].final_pose):
            after = replace(after, edge_innovations=after.edge_innovations + 1)
        if not after.innovations.is_changed:
            return after
        return replace(
            after,
            fallbacks=after.fallbacks + 1,
            pokes_before=after.status.pokes,
            slides_before=after.status.slides,
        )

    def _hangs_over(self, pose: Array) -> bool:
        """Whether a part of the object at a pose (3,) hangs over the table's edge."""
        planner = self.planner
        return not find_supported(planner.obj, pose, planner.surface).all()

    def decide(self, now: PreGraspState, seen: Observation) -> PreGraspState:
        """The state with the next push or grasp asked for, or at the end."""
        pose = now.filter.calc_mean()
        if now.fallbacks > MAX_FALLBACKS:
            reason = "The object goes on moving unlike what was learned of it."
            return now.turn_to(FAILED_MODE, reason, goal=None)
        hangs_over = self._hangs_over(pose)
        if not hangs_over and now.retreating:
            now = replace(now, retreating=False)
        is_ambiguous = hangs_over and now.innovations.last is not None
        planner = self._choose_planner(now)
        try:
            if is_ambiguous and not _is_learned(seen) and now.waits < MAX_WAITS:
                return replace(now, filter=now.filter.forget(), waits=now.waits + 1)
            uncertain = self._infer(seen.identification, seen.log)
            if is_ambiguous or now.retreating:
                # What was learned before was just refuted. What is learned now is doubted; what
                # that leaves possible decides whether the object is still safe.
                uncertain = (uncertain or Belief.of_prior(planner.obj)).inflate(
                    _calc_inflation(now)
                )
                why = self._find_danger(now, seen, pose, uncertain)
                if why is not None:
                    return self._retreat(now, pose, uncertain, seen, why)
                planner = planner.go_gently(CAREFUL_LENGTH)
            decision = planner.decide(
                pose,
                uncertain,
                now.status.pokes - now.pokes_before,
                now.status.slides - now.slides_before,
            )
        except GridPushError as error:
            return now.turn_to(FAILED_MODE, f"Nothing could be planned: {error}.", goal=None)
        return self._follow_decision(now, pose, uncertain, decision, seen)

    def _find_danger(
        self, now: PreGraspState, seen: Observation, pose: Array, doubted: Belief
    ) -> str | None:
        """Says why an object that surprised over the edge should not stay there; None if it may.

        Args:
            now: the state.
            seen: what is seen, and was learned from the push that surprised.
            pose: (3,) where the object lies.
            doubted: what may be true of it.
        """
        if now.retreating:
            return "and is not back on the table yet"
        if now.innovations.is_changed:
            return "so far off that it may be another object"
        # Pushes that surprise slightly say nothing against a center of mass that was weighed.
        if not _is_center_weighed(doubted):
            if now.edge_innovations > MAX_EDGE_INNOVATIONS:
                return "not for the first time"
            if not _is_learned(seen):
                return "and nothing could be learned from it"
            if not _is_explained(seen):
                return "and what is learned now does not explain it"
        if not self.planner.is_safe(pose, doubted.masses):
            return "and by what may be true it is no longer safe"
        return None

    def _retreat(
        self,
        now: PreGraspState,
        pose: Array,
        doubted: Belief,
        seen: Observation,
        why: str,
    ) -> PreGraspState:
        """The state in which the object is brought back onto the table, to be poked anew there.

        It is given up where no push does so safely, or too many were made already.
        """
        if not now.retreating and not now.innovations.is_changed:
            now = replace(
                now,
                fallbacks=now.fallbacks + 1,
                pokes_before=now.status.pokes,
                slides_before=now.status.slides,
            )
        if now.fallbacks > MAX_FALLBACKS or now.retreats >= MAX_RETREATS:
            return _give_up_at_edge(now, why)
        decision = self.planner.go_gently(CAREFUL_LENGTH).retreat(pose, doubted)
        if decision is None or decision.push is None:
            return _give_up_at_edge(now, f"{why}; no push brings it back safely")
        push = decision.push
        reason = f"it hangs over and surprised, {why}; {decision.reason}"
        decision = replace(decision, reason=reason)
        now = replace(now, retreating=True, retreats=now.retreats + 1, edge_innovations=0)
        return self._push(now, pose, doubted, decision, push, seen)

    def _follow_decision(
        self,
        now: PreGraspState,
        pose: Array,
        uncertain: Belief | None,
        decision: PreGraspDecision,
        seen: Observation,
    ) -> PreGraspState:
        """The state in which a planner's decision is carried out."""
        reason = _make_sentence(decision.reason)
        if decision.action == "fail":
            return now.turn_to(FAILED_MODE, reason, goal=decision.goal, margin=decision.margin)
        if decision.press is not None:
            x, y, theta = pose.tolist()
            now = replace(
                now,
                press=decision.press,
                press_id=now.press_id + 1,
                press_pose=(x, y, theta),
            )
            return now.turn_to(PreGraspMode.WEIGHING, reason, goal=None)
        if decision.push is not None:
            return self._push(now, pose, uncertain, decision, decision.push, seen)
        # The object can be grasped. It is observed once more before that is done.
        if now.status.mode != PreGraspMode.VERIFYING:
            return now.turn_to(
                PreGraspMode.VERIFYING, reason, goal=decision.goal, margin=decision.margin
            )
        assert uncertain is not None
        if self._find_grasp is None:
            return now.turn_to(
                PreGraspMode.READY, reason, goal=decision.goal, margin=decision.margin
            )
        return self._grasp(now, pose, uncertain, decision, self._find_grasp)

    def _choose_planner(self, now: PreGraspState) -> PreGraspPlanner:
        """The planner, which supposes a heavier object for each press that this one withstood.

        After presses in a row that weighed nothing it weighs no more.
        """
        planner = self.planner
        count = now.failed_presses
        if count >= self.options.max_failed_presses:
            return planner.stop_weighing(
                f"{count} presses in a row weighed nothing, so that it is weighed no more"
            )
        for _ in range(now.no_tilt_count):
            planner = planner.suppose_heavier()
        return planner.avoid(now.slid_places)

    def _push(
        self,
        now: PreGraspState,
        pose: Array,
        uncertain: Belief | None,
        decision: PreGraspDecision,
        push: Push,
        seen: Observation,
    ) -> PreGraspState:
        """The state with a push asked for, and watched."""
        planner = self.planner
        known = uncertain or Belief.of_prior(planner.obj)
        slide = planner.options.slide
        if now.retreating:
            # It was planned by the models by which the object stays, not by the worst masses.
            slide = replace(slide, margin=-inf)
        monitor = PushMonitor.of_push(
            masses=known.masses,
            surface=planner.surface,
            pose=pose,
            options=slide,
            error=self.options.rest_distance,
            obstacles=planner.obstacles,
        )
        # The reason of a poke says also what came of the poke before.
        reason = _make_sentence(decision.reason)
        last = now.status.forecast
        if last is not None and decision.forecast is not None:
            reason += last.describe_outcome(decision.forecast)
        if now.innovations.is_changed:
            reason = f"The last pushes surprised, and the object is learned anew: {reason}"
        elif now.innovations.last is not None and self._hangs_over(pose) and not now.retreating:
            reason = f"The last push surprised, but the object is safe still: {reason}"
        expected_pose = None
        if decision.expected_pose is not None:
            expected_pose = tuple(decision.expected_pose.tolist())
        poke = decision.action == "poke"
        return replace(now, monitor=monitor).ask(
            push,
            PreGraspMode.EXPLORING if poke else PreGraspMode.SLIDING,
            reason,
            seen,
            pokes=now.status.pokes + poke,
            slides=now.status.slides + (not poke),
            goal=decision.goal,
            margin=decision.margin,
            forecast=decision.forecast or last,
            expected_pose=expected_pose,
        )

    def _grasp(
        self,
        now: PreGraspState,
        pose: Array,
        uncertain: Belief,
        decision: PreGraspDecision,
        find: FindGrasp,
    ) -> PreGraspState:
        """The state with a grasp asked for; failed, where there is none."""
        goal = decision.goal
        grasp = choose_grasp(find, pose, uncertain.masses, goal)
        if grasp is None:
            why = (
                "The gripper reaches no part that hangs over and by which its pads hold the object."
            )
            return now.turn_to(FAILED_MODE, why, goal=goal, margin=decision.margin)
        return replace(now, grasp=grasp, grasp_id=now.grasp_id + 1).turn_to(
            PreGraspMode.GRASPING,
            "A part that hangs over is taken.",
            grasps=now.status.grasps + 1,
            goal=goal,
            margin=decision.margin,
        )

    def follow_press(self, now: PreGraspState, presser: PressStatus) -> PreGraspState:
        """The state while a press is under way, and after it."""
        if presser.command_id != now.press_id or presser.outcome is None or not presser.ready:
            return now
        what = f"It was pressed at the edge: {presser.reason}."
        if presser.weighed:
            weighed = replace(now, no_tilt_count=0, failed_presses=0)
            return weighed.turn_to(WAITING_MODE, what, presses=now.status.presses + 1)
        failed = replace(now, failed_presses=now.failed_presses + 1)
        if presser.outcome == PressOutcome.TOO_HEAVY:
            failed = replace(failed, no_tilt_count=now.no_tilt_count + 1)
        if presser.outcome in SLIPS:
            assert now.press is not None and now.press_pose is not None
            slid = now.press.find_on(now.press_pose)
            failed = replace(failed, slid_places=(*now.slid_places, slid))
        return failed.turn_to(WAITING_MODE, what)

    def _follow_grasp(self, now: PreGraspState, gripper: GraspStatus) -> PreGraspState:
        """The state while a grasp is under way, and after it."""
        if gripper.command_id != now.grasp_id or not gripper.outcome:
            return now
        if gripper.outcome == GraspOutcome.HELD:
            return now.turn_to(PreGraspMode.HOLDING, "The object is lifted and held.")
        # After a grasp that failed, the gripper retreats before anything else is done.
        if not gripper.ready:
            return now
        what = f"The grasp was {gripper.outcome}: {gripper.reason}."
        give_up = now.status.grasps >= self.options.max_grasps
        return now.turn_to(FAILED_MODE if give_up else WAITING_MODE, what, goal=None)


def choose_grasp(
    find: FindGrasp, pose: Array, masses: PlausibleMassSet, goal: PreGraspGoal | None
) -> SideGrasp | None:
    """Chooses a grasp of an object that hangs over the edge; None where there is none.

    It is as near the center of mass as the gripper gets; else at the part that the plan found,
    which is farther off, but within reach.

    Args:
        find: finds a grasp near a point of the object.
        pose: (3,) where the object lies, X_WB, m and rad.
        masses: that it may have.
        goal: what the plan found; None where there is no plan.
    """
    at_worst = goal is not None and isinstance(goal.part, FlatPart)
    grasp = find(pose, masses.middle, masses, at_worst)
    if grasp is None and goal is not None:
        grasp = find(pose, goal.part.p_BG, masses, at_worst)
    return grasp


def _calc_inflation(now: PreGraspState) -> float:
    """By how much less sure what was learned is, after a push that surprised over the edge."""
    last = now.innovations.last
    # On the way back, a push may have ended as it was predicted to.
    return (
        COVARIANCE_INFLATION
        if last is None
        else COVARIANCE_INFLATION * max(last.distance / last.limit, 1.0)
    )


def _is_learned(seen: Observation) -> bool:
    """Whether the last push of the log was learned from, or refused as an outlier."""
    found = seen.identification
    if found is None:
        return False
    name = seen.log[-1].name
    return name in found.push_names or any(one.push == name for one in found.outliers)


def _is_explained(seen: Observation) -> bool:
    """Whether what was learned explains the last push: by it, the push would be no surprise."""
    found = seen.identification
    judgment = None if found is None else check_innovation(found, seen.log[-1], seen.log.table)
    return judgment is not None and not judgment.innovations


def _is_center_weighed(doubted: Belief) -> bool:
    """Whether weighings tell the center of mass, in whatever way the object moves when pushed."""
    weighed = doubted.weighed
    return weighed is not None and float(weighed.center_std.max()) <= WEIGHED_CENTER_STD


def _give_up_at_edge(now: PreGraspState, why: str) -> PreGraspState:
    """The state in which the loop gives up an object that surprised and hangs over the edge."""
    innovation_text = "" if now.innovations.last is None else f"{now.innovations.last.describe()} "
    reason = (
        f"The object hangs over the table's edge, and surprised, {why}. "
        f"{innovation_text}It is neither slid on nor grasped."
    )
    return now.turn_to(FAILED_MODE, reason, goal=None)


def _make_sentence(words: str) -> str:
    """Words with a capital at the beginning and a period at the end."""
    return words[:1].upper() + words[1:] + "."
