"""A finger that is steered in a world: how `PushFollower` is tried, and measured.

A `SteeredFinger` is moved in a `planning.world.SteeredWorld` at the velocity that is commanded.
Poses of the object are seen now and then, with noise; they come late, and some never come. `follow`
lets a controller steer a finger until it is done.
"""

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from gridpush_drake.dynamics.pusher import PusherShape
from gridpush_drake.errors import PlanningError, require_positive
from gridpush_drake.geometry.se2 import Array, check_vector
from gridpush_drake.identification.result import Identification
from gridpush_drake.planning.feedback.follow_log import FollowLog, SeenPose
from gridpush_drake.planning.feedback.follow_options import FollowStatus
from gridpush_drake.planning.feedback.push_follower import PushFollower
from gridpush_drake.planning.loop_run import Learner
from gridpush_drake.planning.world import SteeredWorld
from gridpush_drake.pushes.push_log import PushLog

MAX_POSE_WAIT = 1.0
"""Time for which `follow` waits for a first pose, s."""

TIME_TOLERANCE = 1e-9
"""Two times are one if they differ by less, s."""


@dataclass(frozen=True)
class PoseSensorModel:
    """How the object is seen.

    Attributes:
        period: time between two poses, s.
        delay: time after which a pose comes, s.
        missing: fraction of the poses that never come.
        position_std: standard deviation of a seen position, per axis, m.
        angle_std: standard deviation of a seen angle, rad.

    Raises:
        PlanningError: a number is out of range.
    """

    period: float = 0.02
    delay: float = 0.1
    missing: float = 0.1
    position_std: float = 0.0005
    angle_std: float = 0.003

    def __post_init__(self) -> None:
        require_positive(PlanningError, "sight: ", "s", period=self.period)
        for name in ("delay", "position_std", "angle_std"):
            if not getattr(self, name) >= 0:
                raise PlanningError(f"sight: {name} is {getattr(self, name)!r}; expected >= 0")
        if not 0 <= self.missing <= 1:
            raise PlanningError(f"sight: missing is {self.missing!r}; expected from 0 to 1")


class SteeredFinger:
    """A finger whose velocity is commanded in a world, and what is seen of the object meanwhile.

    Attributes:
        world: the world.
        radius: of the finger, m.
        shape: of a finger that is no disc; None of a disc.
        time: now, s.
        tip: (2,) where the finger's center is, W, m; (3,) with its angle, rad, of a shape.
        pose_sensor: how the object is seen.
        poses: (3,) true poses of the object at the ends of all ticks so far, for judges.
    """

    def __init__(
        self,
        world: SteeredWorld,
        tip: ArrayLike,
        radius: float,
        pose_sensor: PoseSensorModel | None = None,
        seed: int = 0,
        shape: PusherShape | None = None,
    ) -> None:
        """Puts the finger down, and looks at the object for the first time.

        Args:
            world: the world, with the object at rest.
            tip: (2,) where the finger is, W, m; (3,) with its angle, rad, of a shape.
            radius: of the finger, or of the shape's round corners, m.
            pose_sensor: how the object is seen.
            seed: of the noise.
            shape: of a finger that is no disc.

        Raises:
            PlanningError: the place is not as many finite numbers, or the radius is not positive.
        """
        require_positive(PlanningError, "finger: ", "m", radius=radius)
        self.world = world
        self.radius = radius
        self.shape = shape
        self.time = 0.0
        self.tip = check_vector(PlanningError, "tip", tip, 2 if shape is None else 3, "m")
        self.pose_sensor = pose_sensor or PoseSensorModel()
        self.poses: list[Array] = []
        self._rng = np.random.default_rng(seed)
        self._coming: deque[SeenPose] = deque()
        self._look()

    @property
    def pose(self) -> Array:
        """(3,) where the object truly is, for judges, m and rad."""
        return self.world.truth.pose

    def move(self, velocity: ArrayLike) -> list[SeenPose]:
        """Moves the finger at a velocity (2,), m/s, until the object is seen again.

        That of a shape is (3,), with rad/s.

        Returns:
            The poses that came meanwhile, in order.
        """
        duration = self.pose_sensor.period
        tip = self.tip + duration * np.asarray(velocity, dtype=np.float64)
        if self.shape is None:
            self.world.steer(self.tip, tip, duration, self.radius)
        else:
            self.world.steer(self.tip, tip, duration, self.radius, self.shape)
        self.tip = tip
        self.time += duration
        self.poses.append(self.pose)
        self._look()
        due = self.time - self.pose_sensor.delay + TIME_TOLERANCE
        came = []
        while self._coming and self._coming[0].time <= due:
            came.append(self._coming.popleft())
        return came

    def _look(self) -> None:
        """Sees the object, with noise, or does not."""
        pose_sensor = self.pose_sensor
        std = np.array([pose_sensor.position_std, pose_sensor.position_std, pose_sensor.angle_std])
        seen = self.pose + std * self._rng.standard_normal(3)
        if self._rng.random() >= pose_sensor.missing:
            self._coming.append(SeenPose(self.time, seen))


@dataclass(frozen=True, eq=False)
class FollowRun:
    """What came of steering in a world.

    Attributes:
        status: the controller's last status.
        time: how long it took, s.
        poses: (K, 3) true poses of the object, one for each pose that could be seen.
        tips: (K, 2) places of the finger, m; (K, 3) with its angle, rad, of a shape.
        decisions: number of decisions.
        learned: number of times that the model was learned anew.
        identification: what was learned last; None where nothing was.
    """

    status: FollowStatus
    time: float
    poses: Array
    tips: Array
    decisions: int
    learned: int = 0
    identification: Identification | None = None


def follow(
    follower: PushFollower,
    finger: SteeredFinger,
    most: float = 60.0,
    *,
    log: FollowLog | None = None,
    learner: Learner | None = None,
    identification: Identification | None = None,
) -> FollowRun:
    """Lets a controller steer a finger in a world until it no longer pushes.

    Args:
        follower: the controller.
        finger: the finger.
        most: longest time, s.
        log: takes in what is seen; None where nobody wants it.
        learner: learns from the log while the finger is steered, whenever it has another push;
            None never.
        identification: what was learned before, which the learner begins with.

    Raises:
        PlanningError: a decision's time is shorter than that between two poses.
    """
    per_decision = round(follower.options.period / finger.pose_sensor.period)
    if per_decision < 1:
        raise PlanningError(
            f"sight: period is {finger.pose_sensor.period:g} s; expected at most that of a "
            "decision, "
            f"{follower.options.period:g} s"
        )
    if learner is not None and log is None:
        log = FollowLog(follower.obj, follower.finger.radius)
    found = identification
    known = 0
    learned = 0
    begin = finger.time
    first = len(finger.poses)
    tips = []
    decisions = 0
    follower.add_tip(finger.time, finger.tip)
    if log is not None:
        log.add_tip(finger.time, finger.tip)
    while True:
        decision = follower.decide(finger.time, finger.tip)
        decisions += 1
        is_waiting = decision.status == FollowStatus.NO_POSE and finger.time < begin + MAX_POSE_WAIT
        goes_on = decision.status == FollowStatus.PUSHING or is_waiting
        if not goes_on or finger.time - begin > most:
            break
        # the velocity holds until the next decision, while poses come
        for _ in range(per_decision):
            came = finger.move(decision.velocity)
            tips.append(finger.tip)
            follower.add_tip(finger.time, finger.tip)
            for seen in came:
                follower.add_pose(seen.time, seen.pose)
            if log is not None:
                log.add_tip(finger.time, finger.tip)
                for seen in came:
                    log.add_pose(seen)
        if learner is None or log is None:
            continue
        # the last piece still grows
        pushes = log.cut()[:-1]
        if len(pushes) > known:
            known = len(pushes)
            found = learner(follower.obj, PushLog(tuple(pushes)), found)
            if found is not None:
                draws = found.draws(follower.options.ensemble)
                follower.set_model(found.params, draws)
                learned += 1
    return FollowRun(
        status=decision.status,
        time=finger.time - begin,
        poses=np.array(finger.poses[first:]).reshape(-1, 3),
        tips=np.array(tips).reshape(-1, len(finger.tip)),
        decisions=decisions,
        learned=learned,
        identification=found,
    )
