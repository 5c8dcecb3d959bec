"""One run of `bench.steering.experiments`: what is done, with which model, and how it went.

A body's loads are hidden. Three random pokes are seen, and its grid is learned from them. Then a
finger is steered by `planning.feedback.PushFollower`, which plans with the learned grid, an even
one, or (in the LCP world) the true one:

    path    along an S of half a meter, at 5 cm/s
    goal    to a goal pose 20 cm away and turned by up to 86°; in the LCP world with the learned
            grid, the same is also done stroke by stroke (`planning.goal.push_to_goal`)
    shove   the object lies at its goal; somebody shoves it by 3 cm and turns it by 20°

Poses are seen 50 times a second, 0.1 s late, with noise; one in ten never comes. Bodies and worlds
are in `bench.steering.worlds`, tables in `bench.steering.experiments`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from time import thread_time
from typing import Any

import numpy as np
import shapely
from numpy.typing import ArrayLike
from shapely.geometry.polygon import orient

from gridpush_drake.bench.steering.worlds import (
    POSE_SENSOR,
    STEERED_FINGER,
    HiddenBodyCase,
    make_case,
)
from gridpush_drake.dynamics.pusher import Pusher
from gridpush_drake.geometry.se2 import Array, make_direction, transform
from gridpush_drake.identification.model import Model
from gridpush_drake.jobs.results import ADDED_LATER
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.contact.trial import ContactOptions, calc_goal_offset
from gridpush_drake.planning.feedback.follow_options import (
    FollowDecision,
    FollowOptions,
    FollowStatus,
)
from gridpush_drake.planning.feedback.pose_path import PathProgress, PosePath
from gridpush_drake.planning.feedback.push_follower import PushFollower
from gridpush_drake.planning.feedback.steered_finger import (
    FollowRun,
    SteeredFinger,
    follow,
)
from gridpush_drake.planning.goal.next_push import GoalRules
from gridpush_drake.planning.goal.push_to_goal import PushRun, push_to_goal
from gridpush_drake.planning.loop_run import Learner
from gridpush_drake.planning.pushed_object import FeedbackFinger
from gridpush_drake.planning.world import SimulatedWorld
from gridpush_drake.pushes.push_csv import parse_pusher
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.systems.base.messages import PushCommand
from gridpush_drake.systems.execution.push_executor import (
    PushTrajectoryOptions,
    make_push_trajectory,
)

LEARNED_MODEL = "learned"
EVEN_MODEL = "even"
TRUE_MODEL = "true"
LEARNING_MODEL = "learning"
PRIMITIVE_PLANNER = "strokes"
MODEL_NAMES = (LEARNED_MODEL, LEARNING_MODEL, EVEN_MODEL, TRUE_MODEL, PRIMITIVE_PLANNER)
"""Names of what is planned with; LEARNING_MODEL is the learned grid, which is learned on while the
finger is steered, and PRIMITIVE_PLANNER the learned grid, stroke by stroke."""

POKING_MODELS = (LEARNED_MODEL, LEARNING_MODEL, PRIMITIVE_PLANNER)
"""Names of what begins with three pokes."""

PATH_RUN = "path"
GOAL_RUN = "goal"
DISTURBED_RUN = "shove"
RUN_KINDS = (PATH_RUN, GOAL_RUN, DISTURBED_RUN)
"""Names of what is done."""

OBJECT_NAMES = ("claw_hammer", "combination_wrench", "toolbox", "spray_bottle")
"""Shipped objects that are pushed."""

PATH_SPEED = 0.05
"""Speed on the path, m/s."""

PATH_LENGTH = 0.5
"""Length of the path along its axis, m."""

PATH_WIDTH = 0.06
"""How far the path swings to the side, m."""

WANTED_RMS = 0.003
"""Root mean square distance from the path that is wanted, m."""

GOAL_DISTANCE = 0.2
"""Distance of the goal, m."""

GOAL_TURN = 1.5
"""Greatest turn to the goal, rad."""

DISTURBANCE_DISTANCE = 0.03
"""Length of a shove, m."""

DISTURBANCE_TURN = np.radians(20)
"""Turn of a shove, rad."""

MOST_TIME = 60.0
"""Time after which a run is given up, s."""

PRIMITIVE_TOLERANCE = 0.002
"""Mean cell error at which the goal counts as reached stroke by stroke, m."""


@dataclass(frozen=True)
class FeedbackJob:
    """A run.

    Attributes:
        kind: what is done.
        world: name of the world.
        name: name of the object.
        model: what is planned with.
        seed: of everything.
        pusher: shape of a finger that is no disc, as `parse_pusher` reads it; empty of
            STEERED_FINGER. The body is poked by STEERED_FINGER in any case.
    """

    kind: str
    world: str
    name: str
    model: str
    seed: int
    pusher: str = field(default="", metadata=ADDED_LATER)

    def describe(self) -> str:
        """The run in a few words."""
        what = f"{self.kind}, {self.world}, {self.name} {self.seed}, {self.model}"
        return f"{what}, {self.pusher}" if self.pusher else what

    @property
    def finger(self) -> FeedbackFinger:
        """The finger that is steered."""
        if not self.pusher:
            return STEERED_FINGER
        shape = parse_pusher("pusher", self.pusher)
        return replace(STEERED_FINGER, radius=shape.radius, shape=shape)


@dataclass(frozen=True)
class Followed:
    """How a run went.

    Attributes:
        kind: what was done.
        world: name of the world.
        name: name of the object.
        model: what was planned with.
        seed: of everything.
        status: how it ended.
        reached: whether it ended where it should: on a path, at its end.
        time: how long it took, s.
        rms: root mean square distance of the cells' centroid from the path, m; NaN elsewhere.
        distance: of the cells' centroid from the goal at the end, m.
        turn: from the goal at the end, rad.
        decision: median time of the core for a decision, s; NaN stroke by stroke.
    """

    kind: str
    world: str
    name: str
    model: str
    seed: int
    status: str
    reached: bool
    time: float
    rms: float
    distance: float
    turn: float
    decision: float


def find_side(obj: GridObject) -> float:
    """Finds the direction of the inward normal of the longest side of the hull, body frame, rad."""
    hull = shapely.get_coordinates(orient(obj.outline.convex_hull).exterior)
    sides = np.diff(hull, axis=0)
    x, y = sides[np.linalg.norm(sides, axis=1).argmax()]
    return float(np.arctan2(x, -y))


def make_path(obj: GridObject) -> tuple[PosePath, Array]:
    """Makes the S, and the pose (3,) in which the object lies at its begin."""
    side = find_side(obj)
    pose = np.array([0.0, 0.0, -side])
    center = transform(pose, obj.p_BC.mean(axis=0)[None])[0]
    x = np.linspace(0.0, PATH_LENGTH, 200)
    y = PATH_WIDTH * np.sin(2 * np.pi * x / PATH_LENGTH) * x / PATH_LENGTH
    points = center + np.column_stack([x, y])
    return PosePath.through(obj, points, PATH_SPEED, -side), pose


def run_job(job: FeedbackJob) -> Followed:
    """Does one run."""
    finger = job.finger
    case = make_case(job.world, job.name, job.seed, learns=job.model in POKING_MODELS)
    rng = np.random.default_rng((job.seed, 52))
    obj = case.obj
    if job.kind == PATH_RUN:
        path, pose = make_path(obj)
        world = case.make_finger(pose, finger.place_beside(obj, pose, np.pi), finger)
        follower = make_follower(job, case, path)
        run, decision = time_run(job, case, follower, world)
        path_progress = PathProgress(obj, path)
        centers = transform(run.poses, obj.p_BC.mean(axis=0)[None])[:, 0]
        # what it does at the end is no part of following the path
        left = np.linalg.norm(centers - path_progress.at(path_progress.length)[:2], axis=1)
        if (left < WANTED_RMS).any():
            centers = centers[: int((left < WANTED_RMS).argmax()) + 1]
        rms = float(np.sqrt((path_progress.measure_distance(centers) ** 2).mean()))
        ended = follower.progress > path_progress.length - WANTED_RMS
        return make_result(
            job,
            obj,
            world.pose,
            path.goal,
            status=run.status.value,
            time=run.time,
            reached=ended,
            decision=decision,
            rms=rms,
        )
    pose = np.array([0.0, 0.0, rng.uniform(-np.pi, np.pi)])
    heading = rng.uniform(-np.pi, np.pi)
    shift = GOAL_DISTANCE * make_direction(np.array(heading))
    goal = pose + [*shift, rng.uniform(-GOAL_TURN, GOAL_TURN)]
    tip = finger.place_beside(obj, pose, heading + rng.uniform(-np.pi, np.pi))
    if job.model == PRIMITIVE_PLANNER:
        return run_strokes(job, case, pose, goal, tip)
    if job.kind == DISTURBED_RUN:
        # it lies at the goal, from where it is shoved
        pose = goal.copy()
        displacement = DISTURBANCE_DISTANCE * make_direction(rng.uniform(-np.pi, np.pi))
        pose += [*displacement, DISTURBANCE_TURN * rng.choice([-1.0, 1.0])]
        tip = finger.place_beside(obj, pose, heading)
    world = case.make_finger(pose, tip, finger)
    run, decision = time_run(job, case, make_follower(job, case, goal), world)
    reached = run.status == FollowStatus.REACHED
    return make_result(
        job,
        obj,
        world.pose,
        goal,
        status=run.status.value,
        time=run.time,
        reached=reached,
        decision=decision,
    )


class TimedFollower(PushFollower):
    """A controller that times its decisions.

    Attributes:
        times: the core's time for each decision so far, s.
    """

    def __init__(self, *arguments: Any, **options: Any) -> None:
        """Takes the arguments of `PushFollower`."""
        super().__init__(*arguments, **options)
        self.times: list[float] = []

    def decide(
        self, time: float, tip: ArrayLike, *, lead: float = 0.0, velocity: ArrayLike | None = None
    ) -> FollowDecision:
        """Decides, and takes the time."""
        begin = thread_time()
        decision = super().decide(time, tip, lead=lead, velocity=velocity)
        self.times.append(thread_time() - begin)
        return decision


def make_follower(
    job: FeedbackJob, case: HiddenBodyCase, goal: ArrayLike | PosePath
) -> TimedFollower:
    """Makes the controller of a run."""
    options = FollowOptions()
    draws: Sequence[CellParameters] = ()
    params = CellParameters.uniform(case.obj)
    if job.model == TRUE_MODEL:
        params = case.truth
    elif case.learned is not None:
        params = case.learned.params
        draws = case.learned.draws(options.ensemble, job.seed)
    return TimedFollower(
        case.obj, params, goal, job.finger, draws=draws, options=options, seed=job.seed
    )


@dataclass(frozen=True)
class PathLearner(Learner):
    """Learns from pokes and from the last pieces of the way since.

    Attributes:
        pokes: the pokes.
    """

    pokes: PushLog = field(default_factory=lambda: PushLog(()))

    def select(self, log: PushLog) -> PushLog:
        """Adds the pokes to what is learned from."""
        return PushLog((*self.pokes, *super().select(log)))


def time_run(
    job: FeedbackJob, case: HiddenBodyCase, follower: TimedFollower, finger: SteeredFinger
) -> tuple[FollowRun, float]:
    """Steers a finger, and measures the median time of a decision, s."""
    learner = None
    if job.model == LEARNING_MODEL and case.pokes is not None:
        learner = PathLearner(seed=job.seed, pokes=case.pokes)
    run = follow(follower, finger, MOST_TIME, learner=learner, identification=case.learned)
    return run, float(np.median(follower.times))


def run_strokes(
    job: FeedbackJob, case: HiddenBodyCase, pose: Array, goal: Array, tip: Array
) -> Followed:
    """Pushes to a goal stroke by stroke; the time is that of the finger's ways."""
    obj = case.obj
    learned = case.learned
    assert learned is not None
    world = SimulatedWorld(
        Model(obj, case.truth),
        pose,
        position_std=POSE_SENSOR.position_std,
        angle_std=POSE_SENSOR.angle_std,
        seed=job.seed,
    )
    contact = ContactOptions(Pusher(STEERED_FINGER.radius, STEERED_FINGER.speed))
    rules = GoalRules(contact=contact, robustness=None, tolerance=PRIMITIVE_TOLERANCE)
    run = push_to_goal(
        world, Model(obj, learned.params, learned.physics), goal, rules, learner=None
    )
    end = world.truth.pose
    return make_result(
        job,
        obj,
        end,
        goal,
        status=run.status,
        time=measure_strokes(run, tip),
        reached=run.status == FollowStatus.REACHED,
    )


def measure_strokes(run: PushRun, tip: Array) -> float:
    """Time that a station's arm takes for the strokes: up, over, down, push, pause, s.

    Nothing is counted for looking and for planning.

    Args:
        run: the strokes.
        tip: (2,) where the finger is first, on the table, m.
    """
    style = PushTrajectoryOptions(tip_radius=STEERED_FINGER.radius)
    time = 0.0
    place = np.append(tip, style.push_height)
    for step in run.steps:
        command = PushCommand.from_push(1, step.planned.push)
        segments = make_push_trajectory(command, place, style)
        time += sum(segment.duration for segment in segments)
        place = np.array(segments[-1].end)
    # the last way up is no part of coming to the goal
    return time - (segments[-1].duration if run.steps else 0.0)


def make_result(
    job: FeedbackJob,
    obj: GridObject,
    pose: Array,
    goal: Array,
    *,
    status: str,
    time: float,
    reached: bool,
    decision: float = np.nan,
    rms: float = np.nan,
) -> Followed:
    """Makes the result of a run that ended with the object at a pose (3,)."""
    distance, turn = calc_goal_offset(obj, pose, goal)
    return Followed(
        kind=job.kind,
        world=job.world,
        name=job.name,
        model=job.model,
        seed=job.seed,
        status=status,
        reached=reached,
        time=time,
        rms=rms,
        distance=distance,
        turn=turn,
        decision=decision,
    )
