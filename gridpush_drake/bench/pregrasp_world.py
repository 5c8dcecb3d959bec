"""The world of the pre-grasp benchmark: a hidden object on a table with an edge.

The truth is the quasi-static LCP with loads that follow what still lies on the table (`planning.edge_push`); poses are
seen with noise.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.dynamics.push import Push
from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.result import Identification
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.pregrasp.edge_push import is_supported, simulate_near_edge
from gridpush_drake.planning.pregrasp.goals import calc_overhangs
from gridpush_drake.planning.pregrasp.planner import PreGraspPlanner
from gridpush_drake.planning.pregrasp.uncertainty import UncertainModel
from gridpush_drake.planning.support_surface import SupportSurface, find_supported
from gridpush_drake.pushes.push_log import ObservedPush, PushLog

Array = NDArray[np.float64]

POSITION_NOISE = 0.0005
"""m per axis, standard deviation of a pose seen."""

ANGLE_NOISE = 0.003
"""rad."""

MAX_LEARNED_FROM = 14
"""Pushes: the latest ones; the cost of learning grows with them, and what they tell hardly does."""


def see(pose: Array, rng: np.random.Generator) -> Array:
    """A pose (3,) with noise."""
    return pose + np.array([POSITION_NOISE, POSITION_NOISE, ANGLE_NOISE]) * rng.standard_normal(3)


@dataclass(eq=False)
class EdgeWorld:
    """A hidden object on a table.

    Attributes:
        obj: the object.
        truth: its hidden parameters.
        surface: the table.
        pose: (3,) where it is.
        rng: of the noise.
        dropped: whether it fell.
    """

    obj: GridObject
    truth: CellParameters
    surface: SupportSurface
    pose: Array
    rng: np.random.Generator
    dropped: bool = False

    def observe(self) -> Array:
        """The pose with noise, (3,)."""
        return see(self.pose, self.rng)

    def push(self, push: Push) -> bool:
        """Makes a push; returns whether the object was on the table with all its cells throughout."""
        motion = simulate_near_edge(self.obj, self.truth, push, self.pose, self.surface)
        self.pose, self.dropped = motion.final_pose, self.dropped or motion.fell
        return bool(find_supported(self.obj, motion.poses, self.surface).all())


@dataclass(frozen=True)
class Outcome:
    """How a run ended.

    Attributes:
        grasped: whether a part was declared graspable, and truly hangs over with the object at rest.
        dropped: whether the object fell.
        pokes: made.
        slides: made.
        reason: the last decision's.
        arm: m from the true center of mass to the middle of the part to be grasped; NaN where there is none.
    """

    grasped: bool
    dropped: bool
    pokes: int
    slides: int
    reason: str
    arm: float = np.nan


Learn = Callable[[PushLog], UncertainModel | None]
"""From the pushes seen so far to a model; None where more must be seen first."""


def run_pregrasp(world: EdgeWorld, planner: PreGraspPlanner, learn: Learn) -> Outcome:
    """Runs the task to its end.

    Args:
        world: the hidden object.
        planner: decides.
        learn: learns.

    Returns:
        The outcome.
    """
    log: list[ObservedPush] = []
    counts = {"poke": 0, "slide": 0}
    model, learned_from = learn(PushLog(())), 0
    while True:
        if len(log) != learned_from:
            model, learned_from = learn(PushLog(tuple(log[-MAX_LEARNED_FROM:]))), len(log)
        # looked at anew: since the last push somebody may have moved it, which says nothing of its masses
        pose = world.observe()
        decision = planner.decide(pose, model, counts["poke"], counts["slide"])
        push = decision.push
        if push is None:
            break
        counts[decision.action] += 1
        on_table = world.push(push)
        if world.dropped:
            return Outcome(False, True, counts["poke"], counts["slide"], "fell during a push: " + decision.reason)
        if on_table:
            seen = world.observe()
            log.append(ObservedPush(f"push_{len(log)}", push, pose, np.array([push.duration]), seen[None]))
    grasped = decision.action == "grasp" and _hangs_over(world, planner)
    arm = np.nan
    if decision.action == "grasp" and decision.goal is not None:
        arm = float(np.linalg.norm(decision.goal.part.p_BG - world.truth.center_of_mass(world.obj)))
    return Outcome(grasped, False, counts["poke"], counts["slide"], decision.reason, arm)


@dataclass(eq=False)
class Learner:
    """What the default method learns, with its spread; each time it begins where it ended the last time.

    Attributes:
        obj: the object.
        found: the last time.
    """

    obj: GridObject
    found: Identification | None = None

    def __call__(self, log: PushLog) -> UncertainModel | None:
        """Learns from pushes; None before the first."""
        if not len(log):
            return None
        self.found = identify(self.obj, log, regime="quasi_static", start=self.found)
        return UncertainModel.of_identification(self.found, log=log)


@dataclass(eq=False)
class PaperLearner:
    """What the paper's method learns: masses and frictions within a range, taken for granted.

    Attributes:
        obj: the object.
        friction_range: that frictions are sought in.
        min_pokes: the first pushes, chosen, as the default method's are, by what that one learned.
        first: what learns from those.
    """

    obj: GridObject
    friction_range: tuple[float, float]
    min_pokes: int
    first: Learner = field(init=False)

    def __post_init__(self) -> None:
        self.first = Learner(self.obj)

    def __call__(self, log: PushLog) -> UncertainModel | None:
        """Learns from pushes; None before the first."""
        if len(log) < self.min_pokes or not len(log):
            return self.first(log)
        low, high = self.friction_range
        wide = replace(self.obj, prior=replace(self.obj.prior, friction_min=low, friction_max=high))
        found = identify(wide, log, method="paper", regime="quasi_static")
        return UncertainModel.of_parameters(self.obj, found.params)


def _hangs_over(world: EdgeWorld, planner: PreGraspPlanner) -> bool:
    overhangs = calc_overhangs(planner.parts, world.pose, world.surface)
    return bool(overhangs.max() >= 0) and is_supported(world.obj, world.truth, world.pose, world.surface)
