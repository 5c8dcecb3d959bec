"""Sessions with a hidden weight: the tasks of Phys2Real (arXiv:2510.11689), body after body.

A T has a weight taped below it, at the end of its stem (T_BOTTOM_TASK) or at the middle of its bar
(T_TOP_TASK), or a hammer has a heavy head (HAMMER_TASK). Whoever pushes it sees the outline alone.
In each episode of a session the same body lies 40 cm from its goal, turned anywhere, and a finger
is steered until the goal is believed reached. What was learned in an episode, and the last pushes
that it was learned from, are carried into the next one; the first one begins with an even object.

Goals, tolerances, masses, friction and starts are those of the authors' simulation (GitHub
phys2real/isaaclab-phys2real, `push_env_cfg.py` and `terminations.py`). It does not tell the size of
the T, which is taken from how far its centroid is from its middle, nor how heavy the head of the
hammer is. Their robot is a real arm; here it is a finger, and each episode may take MOST_TIME. The
runs beside these are in `bench.steering.runs`, tables in `bench.steering.experiments`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import radians

import numpy as np
import shapely
from shapely import Polygon

from gridpush_drake.bench.steering.runs import (
    LEARNING_MODEL,
    MOST_TIME,
    Followed,
    PathLearner,
    TimedFollower,
)
from gridpush_drake.bench.steering.worlds import POSE_SENSOR, STEERED_FINGER, put_body
from gridpush_drake.bench.truth.sets import (
    CONTACT_FRICTION,
    CONTACT_FRICTION_RANGE,
    CONTACT_FRICTION_STD,
    MASS_RATIO,
)
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.result import Identification
from gridpush_drake.objects.grid_object import GridObject, PhysicalPrior
from gridpush_drake.objects.object_file import find_shipped_object
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.contact.trial import calc_goal_offset
from gridpush_drake.planning.feedback.follow_log import FollowLog
from gridpush_drake.planning.feedback.follow_options import FollowOptions
from gridpush_drake.planning.feedback.steered_finger import FollowRun, follow
from gridpush_drake.pushes.push_log import PushLog

T_BOTTOM_TASK = "t_bottom"
T_TOP_TASK = "t_top"
HAMMER_TASK = "hammer"
WEIGHT_TASKS = (T_BOTTOM_TASK, T_TOP_TASK, HAMMER_TASK)
"""Names of the tasks."""

T_UNIT = 0.053
"""Width of the T's bar and of its stem, m. The T is 4 units wide and 4 long, so that its centroid
is 0.64 units from its middle; the authors' simulation has 34 mm."""

T_OUTLINE = ((-2, 2), (-2, 1), (-0.5, 1), (-0.5, -2), (0.5, -2), (0.5, 1), (2, 1), (2, 2))
"""Corners of the T, in units, its bar up."""

CELLS_PER_UNIT = 4
"""Number of cells across the T's bar and its stem, which then has 112 in all."""

WEIGHT_PLACES = {T_BOTTOM_TASK: -1.5, T_TOP_TASK: 1.5}
"""Middle of the taped weight, a square of one unit, on the T's axis, in units from its middle."""

T_MASS = 0.2
"""Mass of the T without the weight, kg."""

WEIGHT_MASS = 0.14316
"""Mass of the weight, kg."""

T_FRICTION = (0.3, 0.7)
"""Least and greatest friction of the T on the table; whoever pushes knows as much."""

HAMMER_MASS = (0.8 * 0.62, 1.2 * 0.62)
"""Least and greatest mass of the hammer, kg."""

HAMMER_HEAD = 2
"""Label of the shipped hammer's head. One of its cells weighs MASS_RATIO as much as one of the
handle."""

HAMMER_FRICTION = (0.5, 1.2)
"""Least and greatest friction of the hammer on the table; whoever pushes knows as much."""

START_PLACE = (0.0, 0.4)
"""Place of the object's frame at the start, from that of the goal, m; the heading is anything."""

GOAL_HEADINGS = {T_BOTTOM_TASK: 0.0, T_TOP_TASK: 0.0, HAMMER_TASK: np.pi / 4}
"""Heading of the object at the goal, rad."""

GOAL_POSITION = 0.03
"""Distance from the goal within which an episode counts as a success, m."""

GOAL_ANGLE = radians(10.0)
"""Turn from the goal within which an episode counts as a success, rad."""

GOAL_SPEED = 0.01
"""Speed of the object below which an episode counts as a success, m/s."""

STOPPING_FRACTION = 0.7
"""Fraction of these tolerances at which the controller stops: it sees late poses with noise."""

CARRIED_PUSHES = 8
"""Number of pushes that are carried from episode to episode, the latest ones."""


@dataclass(frozen=True)
class SessionJob:
    """Episodes with one hidden body.

    Attributes:
        kind: one of WEIGHT_TASKS.
        world: name of the world.
        model: what is planned with: LEARNING_MODEL, or EVEN_MODEL, which never learns.
        seed: of everything.
        episodes: number of episodes.
    """

    kind: str
    world: str
    model: str
    seed: int
    episodes: int

    def describe(self) -> str:
        """The session in a few words."""
        return f"{self.kind}, {self.world}, {self.model} {self.seed}"


def draw_hidden_weight(kind: str, rng: np.random.Generator) -> tuple[GridObject, CellParameters]:
    """Draws a body.

    Returns:
        The object as whoever pushes it sees it, of one part, and its true masses and frictions.
    """
    low, high = HAMMER_FRICTION if kind == HAMMER_TASK else T_FRICTION
    prior = PhysicalPrior(
        friction=(low + high) / 2,
        friction_min=low,
        friction_max=high,
        contact_friction=CONTACT_FRICTION,
        contact_friction_std=CONTACT_FRICTION_STD,
    )
    if kind == HAMMER_TASK:
        shipped = GridObject.from_yaml(find_shipped_object("claw_hammer"))
        obj = replace(shipped, labels=np.ones(shipped.n, dtype=np.int64), prior=prior)
        ratio = np.exp(rng.uniform(*np.log(MASS_RATIO)))
        mass = np.where(shipped.labels == HAMMER_HEAD, ratio, 1.0)
        mass *= rng.uniform(*HAMMER_MASS) / mass.sum()
    else:
        obj = make_t(prior)
        place = np.array([0.0, WEIGHT_PLACES[kind] * T_UNIT])
        below = (np.abs(obj.p_BC - place) < T_UNIT / 2).all(axis=1)
        mass = np.full(obj.n, T_MASS / obj.n) + WEIGHT_MASS * below / below.sum()
    friction = np.full(obj.n, rng.uniform(low, high))
    return obj, CellParameters(mass, friction, rng.uniform(*CONTACT_FRICTION_RANGE))


def make_t(prior: PhysicalPrior) -> GridObject:
    """Makes the T, of cells that fill it exactly; the origin is in the middle between its ends."""
    outline = Polygon(np.array(T_OUTLINE) * T_UNIT)
    size = T_UNIT / CELLS_PER_UNIT
    left, low, right, high = outline.bounds
    x, y = np.meshgrid(
        np.arange(left + size / 2, right, size), np.arange(low + size / 2, high, size)
    )
    inside = shapely.contains_xy(outline, x, y)
    p_BC = np.column_stack([x[inside], y[inside]])
    return GridObject(
        name="t",
        p_BC=p_BC,
        cell_size=size,
        labels=np.ones(len(p_BC), dtype=np.int64),
        outline=outline,
        prior=prior,
    )


def run_session(job: SessionJob) -> list[Followed]:
    """Runs the episodes of a session, and carries what was learned from one to the next."""
    rng = np.random.default_rng((job.seed, 53))
    obj, truth = draw_hidden_weight(job.kind, rng)
    _, make_finger = put_body(job.world, obj, truth, rng, job.seed)
    goal = np.array([0.0, 0.0, GOAL_HEADINGS[job.kind]])
    learns = job.model == LEARNING_MODEL
    carried = PushLog(())
    found: Identification | None = None
    results = []
    for episode in range(job.episodes):
        pose = np.array([*START_PLACE, rng.uniform(-np.pi, np.pi)])
        tip = STEERED_FINGER.place_beside(obj, pose, rng.uniform(-np.pi, np.pi))
        finger = make_finger(pose, tip, STEERED_FINGER)
        follower = _make_follower(obj, found, goal, job.seed + episode)
        log = FollowLog(obj, STEERED_FINGER.radius)
        run = follow(
            follower,
            finger,
            MOST_TIME,
            log=log,
            learner=PathLearner(seed=job.seed, pokes=carried) if learns else None,
            identification=found,
        )
        results.append(_judge(job, obj, run, goal, float(np.median(follower.times))))
        if learns:
            found = run.identification
            made = [replace(push, name=f"{episode + 1}_{push.name}") for push in log.cut()]
            carried = PushLog((*carried, *made)[-CARRIED_PUSHES:])
    return results


def _make_follower(
    obj: GridObject, found: Identification | None, goal: Array, seed: int
) -> TimedFollower:
    """Makes the controller of an episode, with what was learned before, or an even object."""
    options = FollowOptions(
        position_tolerance=STOPPING_FRACTION * GOAL_POSITION,
        angle_tolerance=STOPPING_FRACTION * GOAL_ANGLE,
    )
    params = CellParameters.uniform(obj)
    draws: Sequence[CellParameters] = ()
    if found is not None:
        params = found.params
        draws = found.draws(options.ensemble, seed)
    return TimedFollower(obj, params, goal, STEERED_FINGER, draws=draws, options=options, seed=seed)


def _judge(
    job: SessionJob, obj: GridObject, run: FollowRun, goal: Array, decision: float
) -> Followed:
    """Judges an episode by where the object truly is at its end, and how fast."""
    distance, turn = calc_goal_offset(obj, run.poses[-1], goal)
    step, _ = calc_goal_offset(obj, run.poses[-1], run.poses[-2])
    at_rest = step < GOAL_SPEED * POSE_SENSOR.period
    return Followed(
        kind=job.kind,
        world=job.world,
        name=obj.name,
        model=job.model,
        seed=job.seed,
        status=run.status.value,
        reached=distance < GOAL_POSITION and turn < GOAL_ANGLE and at_rest,
        time=run.time,
        rms=np.nan,
        distance=distance,
        turn=turn,
        decision=decision,
    )
