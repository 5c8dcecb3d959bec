"""`FeedbackPushController`: steers a finger that pushes an object; `PushFollower` between ports."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context

from gridpush_drake.dynamics.physics import Physics
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.learning import describe_prior
from gridpush_drake.identification.result import Identification
from gridpush_drake.multibody.weak_calc import NO_SLOTS
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.feedback.follow_options import (
    FOLLOW_REASONS,
    FollowOptions,
    FollowStatus,
)
from gridpush_drake.planning.feedback.pose_path import PosePath
from gridpush_drake.planning.feedback.pose_track import TrackOptions
from gridpush_drake.planning.feedback.push_follower import PushFollower
from gridpush_drake.planning.push_constraints import PushConstraints
from gridpush_drake.planning.pushed_object import FeedbackFinger
from gridpush_drake.systems.base.object_controller import AbstractStateSystem

SAMPLE_PERIOD = 0.01
"""Time between two looks at the ports, s."""

TIME_ROUNDING = 1e-9
"""A decision may be early by this much, s: the times of periodic updates are sums, with round-off.
"""

UNKNOWN_POSE = (np.nan, np.nan, np.nan)
"""A pose that is not known."""

REPEATED_AFTER = 0.1
"""A pose on the port that has not changed for this time counts as seen anew, s: the object rests,
and the camera does not say when it looks."""


@dataclass(frozen=True)
class FeedbackPushStatus:
    """How a `FeedbackPushController` stands.

    Attributes:
        mode: what it does, see `FOLLOW_REASONS`.
        reason: the mode in a sentence; empty while it pushes and the finger moves.
        pose: (x, y, theta) where the object is now, as the controller thinks, W, m and rad; NaN
            where it does not know.
        progress: how far the object came on its path, m.
        decisions: number of decisions so far.
    """

    mode: FollowStatus = FollowStatus.NO_GOAL
    reason: str = FOLLOW_REASONS[FollowStatus.NO_GOAL]
    pose: tuple[float, float, float] = UNKNOWN_POSE
    progress: float = 0.0
    decisions: int = 0


@dataclass(frozen=True, eq=False)
class FeedbackPushState:
    """All that a `FeedbackPushController` remembers; never changed, only replaced.

    Attributes:
        status: where it stands.
        velocity: (2,) of the finger, m/s; (3,) with rad/s of one that is no disc.
        follower: what decides; None before there was a goal.
        learned: what the follower's model is of; None for the model before anything was learned.
        goal: (3,) the goal; NaN where a path is followed, or there is none.
        decide_at: time of the next decision, s.
        shown: (3,) the pose that was on the port at the last look, m and rad.
        shown_at: when it was last taken for a new one, s.
    """

    status: FeedbackPushStatus
    velocity: tuple[float, ...]
    follower: PushFollower | None
    learned: Identification | None
    goal: tuple[float, ...]
    decide_at: float
    shown: tuple[float, ...] = UNKNOWN_POSE
    shown_at: float = -np.inf


class FeedbackPushController(AbstractStateSystem[FeedbackPushState]):
    """Steers a finger that touches an object, so that it follows a path or comes to a goal.

    .. pydrake_system::

        name: FeedbackPushController
        input_ports:
        - object_pose
        - pose_time
        - pusher_state
        - pusher_yaw
        - identification
        - goal_pose
        output_ports:
        - tip_velocity
        - status

    * object_pose: vector of 3, X_WB as it was last seen, (x, y, theta), m and rad; NaN if the
      object was not seen.
    * pose_time: vector of 1, time at which it was seen, s. It need not be connected: then a pose
      was seen `pose_delay` before the port changed.
    * pusher_state: vector of 6, position p_WP of the finger's center, m, and its velocity, m/s, as
      `PusherStateSensor` and `ArmTipSensor` have it; only x and y are used. Where they are NaN the
      finger rests.
    * pusher_yaw: vector of 1, angle of a finger that is no disc, rad, which counts whole turns; of
      a disc it need not be connected.
    * identification: abstract `Identification`, what was learned; it need not be connected. While
      it has no `push_names`, `params` is the model.
    * goal_pose: vector of 3, X_WB of the object at the goal, m and rad; NaN for no goal. It need
      not be connected where a path is given.
    * tip_velocity: vector of 2, velocity of the finger's center in W, m/s; zero while it rests. Of
      a finger that is no disc it is a vector of 3, with rad/s.
    * status: abstract `FeedbackPushStatus`.

    The ports are looked at every `SAMPLE_PERIOD`, and a decision is made every
    `FollowOptions.period`, at once: in a simulation it takes no time. Abstract state: one
    `FeedbackPushState`, so that a Context and its clone go on alike.
    """

    __slots__ = NO_SLOTS

    def __init__(
        self,
        obj: GridObject,
        finger: FeedbackFinger,
        path: PosePath | None = None,
        *,
        params: CellParameters | None = None,
        draws: Sequence[CellParameters] = (),
        physics: Physics | None = None,
        constraints: PushConstraints | None = None,
        options: FollowOptions | None = None,
        track: TrackOptions | None = None,
        pose_delay: float = 0.0,
        seed: int = 0,
    ) -> None:
        """Declares the system.

        Args:
            obj: the object.
            finger: the finger.
            path: to be followed; None for the goal on the port.
            params: the model before anything was learned; that of the object's prior by default.
            draws: further models before anything was learned.
            physics: physics of these models; of a learned one, its own is taken.
            constraints: table and obstacles.
            options: how plans are searched for.
            track: how poses are filtered.
            pose_delay: age of a pose when it comes to the port, s, where `pose_time` does not tell.
            seed: of the search.

        Raises:
            PlanningError: an argument is out of range.
        """
        self.obj = obj
        self.path = path
        self._finger = finger
        self._params = CellParameters.uniform(obj) if params is None else params
        self._draws = tuple(draws)
        self._physics = physics
        self._constraints = constraints
        self._options = options or FollowOptions()
        self._track = track
        self._pose_delay = pose_delay
        self._seed = seed
        self._rest = (0.0,) * finger.coordinates
        follower = None if path is None else self._make_follower(path, None)
        begin = FeedbackPushState(
            status=FeedbackPushStatus(),
            velocity=self._rest,
            follower=follower,
            learned=None,
            goal=UNKNOWN_POSE,
            decide_at=0.0,
        )
        super().__init__(begin, SAMPLE_PERIOD)
        self._object_pose = self.DeclareVectorInputPort("object_pose", 3)
        self._pose_time = self.DeclareVectorInputPort("pose_time", 1)
        self._pusher_state = self.DeclareVectorInputPort("pusher_state", 6)
        self._pusher_yaw = self.DeclareVectorInputPort("pusher_yaw", 1)
        self._identification = self.DeclareAbstractInputPort(
            "identification", AbstractValue.Make(describe_prior(obj))
        )
        self._goal_pose = self.DeclareVectorInputPort("goal_pose", 3)
        self._declare_vector("tip_velocity", finger.coordinates, lambda now: now.velocity)
        self._declare_value("status", lambda now: now.status)

    def _make_follower(
        self, goal: Array | PosePath, learned: Identification | None
    ) -> PushFollower:
        """Makes what decides."""
        draws = self._draws if learned is None else self._draw(learned)
        return PushFollower(
            self.obj,
            self._params if learned is None else learned.params,
            goal,
            self._finger,
            draws=draws,
            physics=self._physics if learned is None else learned.physics,
            constraints=self._constraints,
            options=self._options,
            track=self._track,
            seed=self._seed,
        )

    def _draw(self, learned: Identification) -> Sequence[CellParameters]:
        """Draws models that agree with what was learned."""
        return learned.draws(self._options.ensemble, self._seed)

    def _go_on(self, context: Context, now: FeedbackPushState) -> FeedbackPushState:
        time = context.get_time()
        learned = self._read_learned(context)
        goal = self._read_goal(context)
        follower = None if now.follower is None else now.follower.copy()
        # Another goal, or the first one.
        if self.path is None and not np.array_equal(goal, now.goal, equal_nan=True):
            if not np.isfinite(goal).all():
                follower = None
            elif follower is None:
                follower = self._make_follower(np.array(goal), learned)
            else:
                follower.set_goal(goal)
        if follower is not None and learned is not None and _is_new(learned, now.learned):
            follower.set_model(learned.params, self._draw(learned))
        now = replace(now, follower=follower, goal=goal, learned=learned)
        if follower is None:
            return replace(now, velocity=self._rest, status=FeedbackPushStatus())
        tip = self._pusher_state.Eval(context)[:2]
        if self._finger.shape is not None:
            tip = np.append(tip, self._pusher_yaw.Eval(context))
        follower.add_tip(time, tip)
        now = self._take_pose(context, now, follower)
        if time < now.decide_at - TIME_ROUNDING:
            return now
        decision = follower.decide(time, tip)
        x, y, theta = decision.pose.tolist()
        status = FeedbackPushStatus(
            mode=decision.status,
            reason=decision.reason,
            pose=(x, y, theta),
            progress=decision.progress,
            decisions=now.status.decisions + 1,
        )
        velocity = tuple(decision.velocity.tolist())
        return replace(now, status=status, velocity=velocity, decide_at=time + self._options.period)

    def _take_pose(
        self, context: Context, now: FeedbackPushState, follower: PushFollower
    ) -> FeedbackPushState:
        """Gives the pose on the port to what decides, if it is a new one."""
        time = context.get_time()
        shown = tuple(self._object_pose.Eval(context).tolist())
        if self._pose_time.HasValue(context):
            follower.add_pose(float(self._pose_time.Eval(context)[0]), shown)
            return now
        if shown == now.shown and time < now.shown_at + REPEATED_AFTER:
            return now
        follower.add_pose(time - self._pose_delay, shown)
        return replace(now, shown=shown, shown_at=time)

    def _read_learned(self, context: Context) -> Identification | None:
        """What was learned; None before anything was."""
        if not self._identification.HasValue(context):
            return None
        learned: Identification = self._identification.Eval(context)
        return learned if learned.push_names else None

    def _read_goal(self, context: Context) -> tuple[float, ...]:
        """The goal on the port; NaN where there is none."""
        if self.path is not None or not self._goal_pose.HasValue(context):
            return UNKNOWN_POSE
        return tuple(self._goal_pose.Eval(context).tolist())


def _is_new(learned: Identification, before: Identification | None) -> bool:
    """Whether something else was learned than before; Drake may have copied the same in between."""
    return before is None or not (
        learned.push_names == before.push_names
        and np.array_equal(learned.params.mass, before.params.mass)
        and np.array_equal(learned.params.friction, before.params.friction)
        and learned.params.contact_friction == before.params.contact_friction
    )
