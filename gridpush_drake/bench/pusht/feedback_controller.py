"""Steers a disc that pushes a block to a goal, by what is seen every tenth of a second.

At each decision the controller takes in the disc's position and the block's pose, learns the block
from how it moved since the last decision (`block_learner`), and improves its plan
(`primitive_search`) for the block as it is now known. It does the plan's first target and looks
again.

What the search's cost-to-go promises may be more than any plan can do: then standing still would
look best for ever. Where no plan costs less than standing still, decisions are counted for less, by
halves, until one does.

Everything random comes from the seed, and no decision depends on a clock.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from gridpush_drake.bench.pusht.block_learner import BlockLearner, BlockLearnerOptions
from gridpush_drake.bench.pusht.sliding_block import SlidingBlock
from gridpush_drake.bench.pusht.stroke_search import Candidates, Task, search
from gridpush_drake.dynamics.kernels.steering.driven_disc import PX, STATE_SIZE, THETA, VX, X
from gridpush_drake.dynamics.kernels.steering.plan_search import (
    ANGLE,
    BEND,
    CHANGE_POINTS,
    LENGTH,
    PLACE,
    PRIMITIVE_SIZE,
    ROUND,
    WALK,
    Plan,
)
from gridpush_drake.errors import PlanningError
from gridpush_drake.geometry.se2 import Array, check_vector, wrap_angle
from gridpush_drake.planning.feedback.push_candidates import draw_log_uniform

Status = Literal["pushing", "no_pose", "unlike_model"]
"""What a controller does: it pushes; it rests, as no pose came; or it rests, as the block moves
unlike anything that the model can do."""


@dataclass(frozen=True)
class FeedbackOptions:
    """How plans are searched for and what they cost. A cost of 1 is that of a decision.

    Attributes:
        success: coverage of the goal above which it is reached.
        strokes: strokes that are tried at each decision.
        changes: small changes that are tried at each decision.
        horizon: decisions that a plan has at most.
        base: cost-to-go of a pose next to the goal, which is not reached.
        per_root: cost-to-go for the square root of the distance from the goal, in radii of
            gyration.
        per_coverage: cost of the fraction of the goal that is not covered at the end.
        attempts: searches in one decision, each of which counts decisions half as much.
        missing: decisions in a row without a pose, during which the plan is carried on.
        surprise: distance of a pose from its prediction that tells of another model, in radii of
            gyration.
        innovations: decisions in a row with such a distance, after which the disc rests.
    """

    success: float = 0.95
    strokes: int = 240
    changes: int = 480
    horizon: int = 40
    base: float = 8.0
    per_root: float = 23.0
    per_coverage: float = 400.0
    attempts: int = 5
    missing: int = 2
    surprise: float = 0.5
    innovations: int = 8

    def __post_init__(self) -> None:
        for name in ("strokes", "changes", "horizon", "attempts", "innovations"):
            if not getattr(self, name) >= 1:
                raise PlanningError(f"{name} is {getattr(self, name)!r}; expected 1 or more")
        if not 0 < self.success < 1:
            raise PlanningError(f"success is {self.success!r}; expected between 0 and 1")


NEAR = 0.27
"""Distance of the block from the goal within which coverage is calculated, in radii of gyration."""

LEADS = (0.2, 4.7)
"""Least and greatest lead of a stroke's target before the disc, in the disc's radii."""

ANGLES = (-1.0, 1.0)
"""Least and greatest angle of a stroke from the inward normal, rad."""

BEND_STD = 0.06
"""Standard deviation of a stroke's turn in a decision, rad."""

GAINS = (1.0, 2.5)
"""Least and greatest gain on the way to a stroke's begin."""

AT_ONCE = 0.15
"""Fraction of the strokes that push at once, from where the disc is."""

FROM_NOW = 0.4
"""Fraction of the strokes that replace the whole plan; the others keep some of its beginning."""

CHANGE_SIZES = (0.02, 1.7)
"""Least and greatest standard deviation of a change of targets, in the disc's radii."""


@dataclass(frozen=True, eq=False)
class FeedbackDecision:
    """What a controller decided.

    Attributes:
        target: (2,) target of the disc.
        status: what the controller does.
        reason: why it rests, a sentence; empty where it pushes.
        to_go: decisions that the plan has, its first included.
    """

    target: Array
    status: Status
    reason: str = ""
    to_go: int = 0


class FeedbackController:
    """Pushes one block to one goal.

    Attributes:
        block: what is known of the block.
        goal: (3,) pose.
        options: how plans are searched for.
        learner: learns the block.
    """

    def __init__(
        self,
        block: SlidingBlock,
        goal: ArrayLike,
        *,
        options: FeedbackOptions | None = None,
        learning: BlockLearnerOptions | None = None,
        seed: int = 0,
    ) -> None:
        """Begins with the disc at rest.

        Args:
            block: what is known of the block.
            goal: (3,) pose, in the block's unit of length and rad.
            options: how plans are searched for.
            learning: what is held possible of the block.
            seed: of the search.

        Raises:
            PlanningError: the goal is not three finite numbers.
        """
        self.block = block
        self.goal = check_vector(PlanningError, "goal", goal, 3)
        self.options = options or FeedbackOptions()
        self.learner = BlockLearner(block, learning)
        self._rng = np.random.default_rng(seed)
        self._plan = np.zeros((self.options.horizon, 2))
        self._states = np.zeros((self.options.horizon + 1, STATE_SIZE))
        self._length = 0
        self._per_decision = 1.0
        self._velocity = np.zeros(2)
        self._missing = 0
        self._innovations = 0
        self._last_disc: Array | None = None
        self._last_pose: Array | None = None
        self._last_target = np.zeros(2)

    def decide(self, disc: ArrayLike, pose: ArrayLike | None) -> FeedbackDecision:
        """Decides where the disc should go next; to be called once each decision's time.

        Args:
            disc: (2,) position of the disc.
            pose: (3,) pose of the block; None, or with NaN, where none came.

        Raises:
            PlanningError: the disc's position is not two finite numbers.
        """
        position = check_vector(PlanningError, "disc", disc, 2)
        self._follow_disc(position)
        seen = None if pose is None else np.asarray(pose, dtype=np.float64)
        if seen is None or not np.isfinite(seen).all():
            return self._go_without_pose(position)
        self._missing = 0
        self._learn(position, seen)
        if self._innovations >= self.options.innovations:
            return self._rest(position, "unlike_model", "the block moves unlike the model of it")
        self._search(position, seen)
        return self._do_first(position, seen)

    def _follow_disc(self, position: Array) -> None:
        """Corrects the disc's predicted velocity by where the disc was seen to be."""
        if self._last_disc is not None:
            disc = self.block.disc
            predicted = self._states[0, PX : PX + 2]
            duration = disc.time_step * disc.substeps
            self._velocity = self._states[0, VX : VX + 2] + (position - predicted) / duration

    def _learn(self, position: Array, pose: Array) -> None:
        """Takes in how the block moved since the last decision."""
        if self._last_pose is None or self._last_disc is None:
            return
        off = pose - self._states[0, X : THETA + 1]
        unit = self.block.gyration_radius
        distance = float(np.hypot(np.hypot(off[0], off[1]), unit * wrap_angle(off[2])))
        if distance > self.options.surprise * unit:
            self._innovations += 1
        else:
            self._innovations = 0
        self.learner.add(self._last_disc, self._last_pose, self._last_target, pose)

    def _search(self, position: Array, pose: Array) -> None:
        """Improves the plan from the present state on."""
        first = self._states[0]
        first[PX : PX + 2] = position
        first[VX : VX + 2] = self._velocity
        first[X : THETA + 1] = pose
        record = self.block.make_record(self.learner.estimate)
        plan = Plan(targets=self._plan, states=self._states)
        self._per_decision = min(1.0, 2.0 * self._per_decision)
        for attempt in range(self.options.attempts):
            if attempt:
                self._per_decision /= 2.0
            cost, self._length, to_go = search(
                record,
                self._make_task(),
                self.block.ways,
                plan,
                self._length,
                self._draw_candidates(),
            )
            # better than to stand still for one decision
            if cost < self._per_decision + to_go - 1e-3:
                break

    def _do_first(self, position: Array, pose: Array) -> FeedbackDecision:
        """Does the plan's first target, and remembers what is left of the plan."""
        target = self._plan[0].copy()
        decision = FeedbackDecision(target, "pushing", to_go=self._length)
        self._remember(position, pose, target)
        return decision

    def _remember(self, position: Array, pose: Array | None, target: Array) -> None:
        """Moves the plan on by a decision whose target was done."""
        self._last_disc = np.concatenate([position, self._velocity])
        self._last_pose = None if pose is None else pose.copy()
        self._last_target = target
        self._plan[:-1] = self._plan[1:]
        self._states[:-1] = self._states[1:]
        self._length = max(self._length - 1, 0)

    def _go_without_pose(self, position: Array) -> FeedbackDecision:
        """Carries the plan on for a while, then rests."""
        self._missing += 1
        if self._missing <= self.options.missing and self._length > 0:
            target = self._plan[0].copy()
            decision = FeedbackDecision(target, "pushing", to_go=self._length)
            self._remember(position, None, target)
            return decision
        return self._rest(position, "no_pose", "no pose of the block came")

    def _rest(self, position: Array, status: Status, reason: str) -> FeedbackDecision:
        """Lets the disc rest where it is."""
        self._length = 0
        self._last_pose = None
        self._last_disc = None
        self._velocity = np.zeros(2)
        return FeedbackDecision(position.copy(), status, reason)

    def _make_task(self) -> Task:
        """Makes the record of what is wanted."""
        unit = self.block.gyration_radius
        options = self.options
        return Task(
            goal=self.goal,
            arm=unit,
            middle=self.block.centroid,
            area=float(self.block.outline.area),
            success=options.success,
            per_coverage=options.per_coverage,
            near=NEAR * unit,
            base=options.base,
            per_root=options.per_root / np.sqrt(unit),
            per_decision=self._per_decision,
            low=float(self.block.disc.low),
            high=float(self.block.disc.high),
        )

    def _draw_candidates(self) -> Candidates:
        """Draws what the search tries."""
        rng = self._rng
        count = self.options.strokes
        radius = self.block.disc.radius
        strokes = np.zeros((count, PRIMITIVE_SIZE))
        strokes[:, PLACE] = rng.uniform(0.0, 1.0, count)
        strokes[:, ANGLE] = rng.uniform(*ANGLES, count)
        strokes[:, LENGTH] = radius * draw_log_uniform(rng, LEADS, count)
        strokes[:, BEND] = rng.normal(0.0, BEND_STD, count)
        strokes[:, WALK] = rng.uniform(*GAINS, count)
        strokes[:, ROUND] = rng.choice([-1.0, 1.0], count)
        at_once = rng.random(count) < AT_ONCE
        strokes[at_once, PLACE] = -1.0
        strokes[at_once, ANGLE] = rng.uniform(-np.pi, np.pi, int(at_once.sum()))
        # later cuts are more often useful: a plan's beginning is good already
        cuts = np.sqrt(rng.random(count))
        cuts[rng.random(count) < FROM_NOW] = 0.0
        changes = rng.standard_normal((self.options.changes, 2 * CHANGE_POINTS))
        sizes = radius * draw_log_uniform(rng, CHANGE_SIZES, self.options.changes)
        return Candidates(strokes=strokes, cuts=cuts, changes=changes, scales=sizes)
