"""One decision of pushing to a goal: whether to go on, and with which push.

Whoever pushes (`push_to_goal` in a simulated world, a controller in a station) looks, asks here, and does as told.

Pushing to a goal pose in a world that is not the model: look, choose a push, make it, learn from it, look again.

The model of a driver that pushes: learned anew as its pushes come in, where that may pay.

The world in which pushes are carried out: what a driver asks of it, and one made of the project's own simulator.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from time import perf_counter
from typing import Protocol

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray
from shapely import MultiPoint, Point

from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.simulation import Regime, simulate
from gridpush_drake.dynamics.time_grid import make_path_times
from gridpush_drake.errors import PlanningError
from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.result import Identification
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.contact.optimization import ContactOptions, check_pose
from gridpush_drake.planning.contact.trial import PlannedPush, calc_goal_error
from gridpush_drake.planning.goal.cost_to_go import CostToGo
from gridpush_drake.planning.goal.next_push import HorizonOptions, NextPush, choose_push
from gridpush_drake.planning.goal.push_plan import (
    DEFAULT_MAX_PUSHES,
    DEFAULT_TOLERANCE,
    REASONS,
    STUCK,
    check_ends,
    check_tolerance,
    judge,
)
from gridpush_drake.planning.goal.robustness import Robustness, RobustnessOptions, draw_model_samples
from gridpush_drake.planning.push_constraints import PushConstraints, make_body, place_points
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.pushes.push_log import ObservedPush, PushLog

Array = NDArray[np.float64]

DEFAULT_ROBUSTNESS = RobustnessOptions()
"""How much is doubted, where nothing else is said."""


@dataclass(frozen=True, eq=False)
class GoalRules:
    """How an object is pushed to a goal.

    Attributes:
        constraints: table, obstacles and further rules.
        contact: what pushes may be chosen from.
        horizons: how far ahead to look; one push by default, for the second says little of a model not yet learned.
        caution: how far pushes must be safe though the model may be wrong; None trusts the model.
        tolerance: mean cell error at which the goal counts as reached, m.
        max_pushes: most pushes.

    Raises:
        PlanningError: the tolerance is not positive, or the pushes are fewer than none.
    """

    constraints: PushConstraints = field(default_factory=PushConstraints)
    contact: ContactOptions = field(default_factory=ContactOptions)
    horizons: HorizonOptions = field(default_factory=lambda: HorizonOptions(horizon=1))
    caution: RobustnessOptions | None = DEFAULT_ROBUSTNESS
    tolerance: float = DEFAULT_TOLERANCE
    max_pushes: int = DEFAULT_MAX_PUSHES

    def __post_init__(self) -> None:
        check_tolerance(self.tolerance, self.max_pushes)


@dataclass(frozen=True, eq=False)
class PushDecision:
    """What to do.

    Attributes:
        status: why to end, see `push_plan.REASONS`; None where a push should be made.
        error: mean cell error to the goal now, m.
        chosen: the next push; None where there should be none, or none was looked for.
        way: to the goal, to be given to the next decision; None where the question did not come up.
    """

    status: str | None
    error: float
    chosen: NextPush | None = None
    way: CostToGo | None = None


def decide_push(
    obj: GridObject,
    pose: Array,
    goal: Array,
    made: int,
    params: CellParameters,
    identification: Identification | None,
    rules: GoalRules,
    way: CostToGo | None = None,
) -> PushDecision:
    """Decides on the next push.

    Args:
        obj: the object.
        pose: (3,) q_W where it lies, m and rad.
        goal: (3,) where it should.
        made: pushes so far.
        params: the model.
        identification: that the model comes from; None where nothing was learned.
        rules: how to push.
        way: of the decision before, to the same goal by the same rules; None where there was none.

    Returns:
        The decision.

    Raises:
        PlanningError: the finger fits nowhere on the outline.
    """
    error = float(calc_goal_error(obj, pose, goal))
    bad = check_ends(obj, pose, goal, rules.constraints, rules.contact.radius)
    if bad is not None:
        return PushDecision(bad, error)
    # what was looked for from where the object lay before may not say how to go on from where somebody put it
    if way is None or way.direct or not np.isfinite(way.calc_cost(pose)):
        way = CostToGo(obj, pose, goal, rules.constraints.start_at(obj, pose, rules.contact.radius))
    status = judge(obj, pose, way, made, rules.tolerance, rules.max_pushes)
    if status is not None:
        return PushDecision(status, error, way=way)
    caution = None
    if rules.caution is not None:
        doubts = draw_model_samples(obj, params, identification, rules.caution)
        caution = Robustness(obj, [params, *doubts], rules.constraints, rules.contact, rules.caution)
    chosen = choose_push(
        obj, params, pose, way, rules.tolerance, rules.constraints, rules.contact, rules.horizons, caution
    )
    return PushDecision(STUCK if chosen.push is None else None, error, chosen, way)


def forbid(rules: GoalRules, refused: tuple[Array, ...], apart: float, turned: float) -> GoalRules:
    """The rules without pushes like some that were refused.

    Args:
        rules: the rules.
        refused: of each such push (4,): where it began, W, m, and its unit direction.
        apart: m between the beginnings of pushes that are not alike.
        turned: rad between their directions.

    Returns:
        The rules, with a push rule that asks this first.
    """
    if not refused:
        return rules
    before = rules.constraints

    def allow(push: Push) -> bool:
        towards = push.velocity / np.linalg.norm(push.velocity)
        alike = any(
            np.linalg.norm(push.start - one[:2]) < apart and towards @ one[2:] > np.cos(turned) for one in refused
        )
        return not alike and before.allows_push(push)

    return replace(rules, constraints=replace(before, push_rule=allow))


@dataclass(frozen=True)
class LearningOptions:
    """When to learn, and from what.

    Attributes:
        first: after each of the first so many pushes.
        min_error: and later, where the prediction was off by more, m (mean cell error),
        relative_error: and by more than this share of how far the cells moved.
        memory: most pushes, the last, that are learned from.
        seed: of the identification.
    """

    first: int = 3
    min_error: float = 0.004
    relative_error: float = 0.1
    memory: int = 8
    seed: int = 0


@dataclass(eq=False)
class Learner:
    """The model, and the pushes that it comes from.

    Attributes:
        obj: the object.
        params: the model.
        options: when to learn; None never.
        identification: that the model comes from; None before the first.
        seconds: wall-clock time spent on learning.
        seen: all pushes.
    """

    obj: GridObject
    params: CellParameters
    options: LearningOptions | None
    identification: Identification | None = None
    seconds: float = 0.0
    seen: list[ObservedPush] = field(default_factory=list)

    def take(self, seen: ObservedPush, error: float) -> bool:
        """Takes a push in.

        Args:
            seen: the push.
            error: of its prediction, mean cell distance, m.

        Returns:
            Whether the model was learned anew.
        """
        self.seen.append(seen)
        options = self.options
        if options is None or not len(seen.t_observed):
            return False
        moved = float(calc_goal_error(self.obj, seen.pose, seen.final_pose))
        surprised = error > max(options.min_error, options.relative_error * moved)
        if len(self.seen) > options.first and not surprised:
            return False
        begin = perf_counter()
        log = PushLog(tuple(self.seen[-options.memory :]))
        self.identification = identify(
            self.obj, log, seed=options.seed, regime="quasi_static", start=self.identification
        )
        self.params = self.identification.params
        self.seconds += perf_counter() - begin
        return True


OBSERVATIONS = 4
"""Poses that are seen during a push, after the first, its end among them."""

FALL_CHECKS = 40
"""Poses of a push at which it is looked whether the object falls."""


class PushWorld(Protocol):
    """Where an object lies and can be pushed: a simulation, or a station with a robot."""

    @property
    def pose(self) -> Array | None:
        """(3,) q_W of the object as it is seen now, m and rad; None while it is not seen, or has fallen."""
        ...

    def execute(self, push: Push) -> ObservedPush:
        """Carries out a push, and says what was seen of the object."""
        ...


class SimulatedWorld:
    """An object with hidden masses and frictions on a table, moved by `simulate`.

    The support presses as if there were no edge: an object that hangs over rubs like one that does not. It falls where
    its center of mass leaves the convex hull of what lies on the table.

    Attributes:
        obj: the object.
        surface: the table; None for one without end.
        fallen: whether the object has fallen off.
        true_pose: (3,) q_W without noise.
        pushes: how many were made.
    """

    def __init__(
        self,
        obj: GridObject,
        hidden: CellParameters,
        pose: ArrayLike,
        surface: SupportSurface | None = None,
        *,
        position_std: float = 0.0,
        angle_std: float = 0.0,
        seed: int = 0,
        observations: int = OBSERVATIONS,
        regime: Regime = "quasi_static",
    ) -> None:
        """Puts the object down.

        Args:
            obj: the object.
            hidden: its true masses and frictions.
            pose: (3,) where it lies, m and rad.
            surface: the table; None for one without end.
            position_std: standard deviation of seen positions, per axis, m.
            angle_std: of seen angles, rad.
            seed: of the noise.
            observations: poses that are seen during a push, after the first.
            regime: of the simulation.

        Raises:
            PlanningError: a number is out of range.
        """
        if not (position_std >= 0 and angle_std >= 0 and observations >= 1):
            raise PlanningError("position_std and angle_std must be >= 0, and observations at least 1")
        self.obj, self.surface, self.fallen, self.pushes = obj, surface, False, 0
        self.true_pose = np.array(pose, dtype=np.float64)
        self._hidden, self._observations, self._regime = hidden, observations, regime
        self._std = np.array([position_std, position_std, angle_std])
        self._rng = np.random.default_rng(seed)
        self._body = np.array(make_body(obj).exterior.coords)[:-1]
        self._center_of_mass = hidden.center_of_mass(obj)
        self._seen = self._look(self.true_pose)

    @property
    def pose(self) -> Array | None:
        """(3,) q_W as it is seen; None once the object has fallen."""
        return None if self.fallen else self._seen

    def execute(self, push: Push) -> ObservedPush:
        """Pushes; what is seen is noisy, the motion is not."""
        times = make_path_times(push, self._regime)
        motion = simulate(self.obj, self._hidden, push, self.true_pose, times=times, regime=self._regime)
        steps = len(times) - 1
        rows = np.unique(np.rint(np.linspace(0, steps, min(self._observations, steps) + 1)).astype(int))[1:]
        begin = self._seen
        self.fallen = self.fallen or self._falls(motion.poses)
        self.true_pose = motion.final_pose.copy()
        seen = np.array([self._look(pose) for pose in motion.poses[rows]])
        self._seen = seen[-1]
        self.pushes += 1
        return ObservedPush(f"push_{self.pushes}", push, begin, times[rows], seen)

    def _look(self, pose: Array) -> Array:
        return pose + self._std * self._rng.standard_normal(3)

    def _falls(self, poses: Array) -> bool:
        if self.surface is None:
            return False
        rows = np.unique(np.linspace(0, len(poses) - 1, FALL_CHECKS).astype(int))
        return any(not self._is_supported(pose) for pose in poses[rows])

    def _is_supported(self, pose: Array) -> bool:
        assert self.surface is not None
        table = self.surface.polygon
        points = place_points(self._body, pose[None])[0]
        if shapely.contains_xy(table, points[:, 0], points[:, 1]).all() and table.convex_hull.equals(table):
            return True
        lying = shapely.intersection(table, shapely.Polygon(points))
        center = Point(place_points(self._center_of_mass[None], pose[None])[0, 0])
        return bool(MultiPoint(shapely.get_coordinates(lying)).convex_hull.covers(center)) if lying.area > 0 else False


Progress = Callable[["PushStep"], None]

DEFAULT_LEARNING = LearningOptions()
"""When to learn, where nothing else is said."""

LOST = "lost"
LOST_REASON = "The object is not seen any more: it has fallen, or something hides it."


@dataclass(frozen=True, eq=False)
class PushStep:
    """One round: what was planned, what happened, and what it was learned with.

    Attributes:
        planned: the push with its predicted end.
        seen: what happened.
        way: what was expected to be left to go after it, m.
        prediction_error: mean cell distance between predicted and seen end, m.
        goal_error: mean cell error to the goal at the seen end, m.
        horizon: of the search that the push came from.
        learned: whether the model was learned anew after it.
    """

    planned: PlannedPush
    seen: ObservedPush
    way: float
    prediction_error: float
    goal_error: float
    horizon: int
    learned: bool


@dataclass(frozen=True, eq=False)
class PushRun:
    """What came of pushing to a goal.

    Attributes:
        goal: (3,).
        steps: the rounds, in order.
        status: "reached", "lost", or why it ended: see `push_plan.REASONS`.
        reason: the same in a sentence.
        error: mean cell error at the last seen pose, m; NaN where none was seen.
        params: the last model.
        identification: it came from; None where nothing was learned.
        simulations: pushes simulated by the planner.
        planning_seconds: wall-clock time.
        learning_seconds: wall-clock time.
    """

    goal: Array
    steps: tuple[PushStep, ...]
    status: str
    reason: str
    error: float
    params: CellParameters
    identification: Identification | None
    simulations: int
    planning_seconds: float
    learning_seconds: float

    @property
    def log(self) -> PushLog:
        """The pushes that were made."""
        return PushLog(tuple(step.seen for step in self.steps), source="pushing to a goal")


def push_to_goal(
    world: PushWorld,
    obj: GridObject,
    goal: ArrayLike,
    *,
    params: CellParameters | None = None,
    learning: LearningOptions | None = DEFAULT_LEARNING,
    constraints: PushConstraints | None = None,
    options: ContactOptions | None = None,
    horizons: HorizonOptions | None = None,
    caution: RobustnessOptions | None = DEFAULT_ROBUSTNESS,
    tolerance: float = DEFAULT_TOLERANCE,
    max_pushes: int = DEFAULT_MAX_PUSHES,
    timeout: int = 3,
    progress: Progress | None = None,
) -> PushRun:
    """Pushes an object to a goal pose, looking after every push, and learning on the way.

    Args:
        world: that carries out pushes.
        obj: the object.
        goal: (3,) where it should lie, m and rad.
        params: the model to begin with; uniform by the object's prior where None.
        learning: when to learn; None never.
        constraints: table, obstacles and further rules; none by default.
        options: what pushes may be chosen from.
        horizons: how far ahead to look; one push where None, for the second says little of a model not yet learned.
        caution: how far pushes must be safe though the model may be wrong; None trusts the model.
        tolerance: mean cell error at which the goal counts as reached, m.
        max_pushes: most pushes.
        timeout: how often in a row to look for an object that is not seen before it counts as lost.
        progress: called after every push.

    Returns:
        What came of it. An object that was moved by somebody else between pushes is pushed from where it then lies.

    Raises:
        PlanningError: an argument is out of range.
    """
    if timeout < 1:
        raise PlanningError(f"timeout is {timeout!r}; expected at least 1")
    rules = GoalRules(
        constraints or PushConstraints(), options or ContactOptions(), horizons or HorizonOptions(horizon=1), caution,
        tolerance, max_pushes,
    )  # fmt: skip
    learner = Learner(obj, params or CellParameters.uniform(obj), learning)
    drive = _Drive(world, obj, check_pose("goal", goal), learner, rules, timeout)
    status: str | None = None
    while status is None:
        made = len(drive.steps)
        status = drive.go_on()
        if progress is not None and len(drive.steps) > made:
            progress(drive.steps[-1])
    return drive.finish(status)


@dataclass(eq=False)
class _Drive:
    """Pushing to a goal, round by round; see `push_to_goal` for what it is made of."""

    world: PushWorld
    obj: GridObject
    goal: Array
    learner: Learner
    rules: GoalRules
    timeout: int
    steps: list[PushStep] = field(default_factory=list)
    simulations: int = 0
    seconds: float = 0.0
    error: float = float("nan")
    way: CostToGo | None = None

    def go_on(self) -> str | None:
        """Looks, and where the goal is not reached makes one more push; why it ended, or None where it goes on."""
        q = _look(self.world, self.timeout)
        if q is None:
            return LOST
        begin = perf_counter()
        decision = decide_push(
            self.obj, q, self.goal, len(self.steps), self.learner.params, self.learner.identification, self.rules,
            self.way,
        )  # fmt: skip
        self.seconds += perf_counter() - begin
        self.error, self.way = decision.error, decision.way
        if decision.chosen is not None:
            self.simulations += decision.chosen.simulations
        if decision.chosen is not None and decision.chosen.push is not None:
            self._make(decision.chosen, decision.chosen.push)
        return decision.status

    def _make(self, decision: NextPush, planned: PlannedPush) -> None:
        """Makes a push, and learns from it unless the goal is reached."""
        seen = self.world.execute(planned.push)
        off = after = float("nan")
        if len(seen.t_observed):
            off = float(calc_goal_error(self.obj, seen.final_pose, planned.pose))
            after = float(calc_goal_error(self.obj, seen.final_pose, self.goal))
        learned = not after <= self.rules.tolerance and self.learner.take(seen, off)
        self.steps.append(PushStep(planned, seen, decision.way, off, after, decision.horizon, learned))

    def finish(self, status: str) -> PushRun:
        """What came of it."""
        reason = LOST_REASON if status == LOST else REASONS[status]
        return PushRun(
            self.goal, tuple(self.steps), status, reason, self.error, self.learner.params, self.learner.identification,
            self.simulations, self.seconds, self.learner.seconds,
        )  # fmt: skip


def _look(world: PushWorld, timeout: int) -> Array | None:
    for _ in range(timeout):
        q = world.pose
        if q is not None:
            return check_pose("pose", q)
    return None
