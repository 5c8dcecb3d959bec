"""Worlds in which a finger is steered: how `PushFollower` is tried, and measured.

A `FingerWorld` holds one object and one finger, whose velocity is commanded. Poses of the object
are seen now and then, with noise; they come late, and some never come. `follow` lets a controller
steer in a world until it is done.
"""

from abc import ABC, abstractmethod
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from gridpush_drake.dynamics.kernels.steering.finger_push import (
    MEMORY,
    STATE_SIZE,
    THETA,
    TIP_X,
    TIP_Y,
    VX,
    W,
    X,
    follow_tip,
)
from gridpush_drake.errors import PlanningError, require_positive
from gridpush_drake.geometry.se2 import Array, check_vector
from gridpush_drake.identification.result import Identification
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.feedback.follow_log import FollowLog, SeenPose
from gridpush_drake.planning.feedback.follow_options import FollowStatus
from gridpush_drake.planning.feedback.push_follower import PushFollower
from gridpush_drake.planning.feedback.pushed_object import make_model
from gridpush_drake.planning.loop_run import Learner
from gridpush_drake.pushes.push_log import PushLog

WORLD_STEP = 0.0005
"""Length of the finger's path in a step of the world, m: a fifth of what the search takes."""

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


class FingerWorld(ABC):
    """A world but for how its object moves: it adds sight, and keeps what happened.

    A world derives from it and says in `do_put` how object and finger are put down, in `do_steer`
    how the finger moves the object, and in `pose` where the object is. A constructor sets what
    these need before it calls this class's. `docs/extending.md` does it.

    Attributes:
        time: now, s.
        tip: (2,) where the finger's center is, W, m.
        pose_sensor: how the object is seen.
        poses: (3,) true poses of the object at the ends of all ticks so far, for judges.
    """

    def __init__(
        self,
        pose: ArrayLike,
        tip: ArrayLike,
        pose_sensor: PoseSensorModel | None = None,
        seed: int = 0,
    ) -> None:
        """Looks at the object for the first time.

        Args:
            pose: (3,) where it lies, m and rad.
            tip: (2,) where the finger is, m.
            pose_sensor: how the object is seen.
            seed: of the noise.

        Raises:
            PlanningError: a place is not as many finite numbers.
        """
        self.time = 0.0
        self.tip = check_vector(PlanningError, "tip", tip, 2, "m")
        self.pose_sensor = pose_sensor or PoseSensorModel()
        self.poses: list[Array] = []
        self._rng = np.random.default_rng(seed)
        self._coming: deque[SeenPose] = deque()
        self.do_put(check_vector(PlanningError, "pose", pose, 3))
        self._look()

    @property
    @abstractmethod
    def pose(self) -> Array:
        """(3,) where the object truly is, for judges, m and rad."""

    @abstractmethod
    def do_put(self, pose: Array) -> None:
        """Puts the object down at rest at a pose (3,), m and rad, with the finger at `tip`."""

    @abstractmethod
    def do_steer(self, tip: Array, duration: float) -> None:
        """Moves the finger evenly from `tip` to a place (2,), m, within a time, s."""

    def disturb(self, pose: ArrayLike) -> None:
        """Puts the object down elsewhere, at a pose (3,), m and rad, as somebody's hand does.

        Raises:
            PlanningError: the pose is not three finite numbers.
        """
        self.do_put(check_vector(PlanningError, "pose", pose, 3))

    def move(self, velocity: ArrayLike) -> list[SeenPose]:
        """Moves the finger at a velocity (2,), m/s, until the object is seen again.

        Returns:
            The poses that came meanwhile, in order.
        """
        duration = self.pose_sensor.period
        tip = self.tip + duration * np.asarray(velocity, dtype=np.float64)
        self.do_steer(tip, duration)
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


class LcpFingerWorld(FingerWorld):
    """An object with hidden masses and frictions, moved by the grid LCP, quasi-static.

    Attributes:
        obj: the object.
        params: its true masses and frictions.
    """

    def __init__(
        self,
        obj: GridObject,
        params: CellParameters,
        pose: ArrayLike,
        tip: ArrayLike,
        radius: float,
        pose_sensor: PoseSensorModel | None = None,
        seed: int = 0,
    ) -> None:
        """Puts object and finger down.

        Args:
            obj: the object.
            params: its true masses and frictions.
            pose: (3,) where it lies, m and rad.
            tip: (2,) where the finger is, m.
            radius: of the finger, m.
            pose_sensor: how the object is seen.
            seed: of the noise.

        Raises:
            PlanningError: a place is not as many finite numbers, or the parameters are those of
                another object.
        """
        self.obj = obj
        self.params = params
        model = make_model(obj, params, radius, approximate=False)
        self._model = model._replace(step=WORLD_STEP)
        self._state = np.zeros(STATE_SIZE)
        super().__init__(pose, tip, pose_sensor, seed)

    @property
    def pose(self) -> Array:
        """(3,) where the object truly is, for judges, m and rad."""
        return self._state[X : THETA + 1].copy()

    def do_put(self, pose: Array) -> None:
        """Puts the object down at rest at a pose (3,), m and rad, with the finger at `tip`."""
        self._state[TIP_X : TIP_Y + 1] = self.tip
        self._state[X : THETA + 1] = pose
        self._state[VX : W + 1] = 0.0
        self._state[MEMORY:] = 0.0

    def do_steer(self, tip: Array, duration: float) -> None:
        """Moves the finger evenly from `tip` to a place (2,), m, quasi-statically."""
        follow_tip(self._model, self._state, tip[None])


@dataclass(frozen=True, eq=False)
class FollowRun:
    """What came of steering in a world.

    Attributes:
        status: the controller's last status.
        time: how long it took, s.
        poses: (K, 3) true poses of the object, one for each pose that could be seen.
        tips: (K, 2) places of the finger, m.
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
    world: FingerWorld,
    most: float = 60.0,
    *,
    log: FollowLog | None = None,
    learner: Learner | None = None,
    identification: Identification | None = None,
) -> FollowRun:
    """Lets a controller steer in a world until it no longer pushes.

    Args:
        follower: the controller.
        world: the world.
        most: longest time, s.
        log: takes in what is seen; None where nobody wants it.
        learner: learns from the log while the finger is steered, whenever it has another push;
            None never.
        identification: what was learned before, which the learner begins with.

    Raises:
        PlanningError: a decision's time is shorter than that between two poses.
    """
    per_decision = round(follower.options.period / world.pose_sensor.period)
    if per_decision < 1:
        raise PlanningError(
            f"sight: period is {world.pose_sensor.period:g} s; expected at most that of a "
            "decision, "
            f"{follower.options.period:g} s"
        )
    if learner is not None and log is None:
        log = FollowLog(follower.obj, follower.finger.radius)
    found = identification
    known = 0
    learned = 0
    begin = world.time
    first = len(world.poses)
    tips = []
    decisions = 0
    follower.add_tip(world.time, world.tip)
    if log is not None:
        log.add_tip(world.time, world.tip)
    while True:
        decision = follower.decide(world.time, world.tip)
        decisions += 1
        is_waiting = decision.status == FollowStatus.NO_POSE and world.time < begin + MAX_POSE_WAIT
        goes_on = decision.status == FollowStatus.PUSHING or is_waiting
        if not goes_on or world.time - begin > most:
            break
        # the velocity holds until the next decision, while poses come
        for _ in range(per_decision):
            came = world.move(decision.velocity)
            tips.append(world.tip)
            follower.add_tip(world.time, world.tip)
            for seen in came:
                follower.add_pose(seen.time, seen.pose)
            if log is not None:
                log.add_tip(world.time, world.tip)
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
        time=world.time - begin,
        poses=np.array(world.poses[first:]).reshape(-1, 3),
        tips=np.array(tips).reshape(-1, 2),
        decisions=decisions,
        learned=learned,
        identification=found,
    )
