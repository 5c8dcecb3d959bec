"""Steers a finger so that a learned object follows a path, or comes to a goal, by what is seen.

At each decision, ten times a second, the controller

    1. estimates where the object is now (`pose_track`),
    2. improves its plan of the finger's places (`push_search`),
    3. refines it, if the object follows a path, by Gauss and Newton's method for several models at
       once (`plan_refinement`),
    4. returns the velocity with which the plan begins.

Poses may come at any rate, late and with gaps. A status says what the controller does. With poses
that are wrong it comes to rest, and says why: where the object does not do what the finger should
cause, where it is disturbed too often, or where it does not get on. Then it rests until it is given
another goal (or another model, if the object moved unlike the one that it had). Everything random
comes from the seed, and no decision depends on a clock.

The theory is in `docs/theory/feedback.md`, sections 6 to 8.
"""

from collections.abc import Sequence
from copy import copy, deepcopy

import numpy as np
from numpy.typing import ArrayLike

from gridpush_drake.dynamics.kernels.steering.finger_push import (
    STATE_SIZE,
    THETA,
    TIP_X,
    FreeSpace,
    X,
    follow_tip,
)
from gridpush_drake.dynamics.kernels.steering.plan_search import Plan
from gridpush_drake.dynamics.physics import Physics
from gridpush_drake.errors import MAX_NUMBER, PlanningError
from gridpush_drake.geometry.se2 import Array, check_vector, transform, wrap_angle
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.feedback.follow_options import (
    AT_GOAL,
    FOLLOW_REASONS,
    NO_PUSH_FOUND,
    FollowDecision,
    FollowOptions,
    FollowStatus,
)
from gridpush_drake.planning.feedback.model_ensemble import ModelEnsemble
from gridpush_drake.planning.feedback.plan_refinement import refine_plan
from gridpush_drake.planning.feedback.pose_path import PathProgress, PosePath
from gridpush_drake.planning.feedback.pose_track import PoseTrack, TrackOptions, is_plausible
from gridpush_drake.planning.feedback.push_candidates import draw_candidates
from gridpush_drake.planning.feedback.push_search import TrackingCost, search_push
from gridpush_drake.planning.feedback.ways import make_outline_path
from gridpush_drake.planning.push_constraints import PushConstraints
from gridpush_drake.planning.pushed_object import (
    FeedbackFinger,
    SearchModel,
    covers_places,
    make_room,
)

GOAL_SHRINKAGE = 0.2
"""A plan ends as soon as the object is within this fraction of the goal's tolerances."""

SETTLING_TIME = 0.2
"""Time for which the object must be seen at the goal before it counts as reached, s."""

LEAST_MOTION = 0.3
"""Least motion, in radii of gyration, with which corrections of the model's motion are compared. If
the object has moved less, as much is assumed, so that noise alone does not look like a wrong
model."""

LEAST_PER_DECISION = 1 / 64
"""Least cost of a decision. The cost begins at 1 and is halved until some plan to the goal costs
less than standing still; for the next plan it is 1 again."""

LEAST_GAIN = 1e-3
"""Amount by which a plan to a goal must cost less than standing still, in decisions."""

MIN_PUSHED_MOTION = 1e-4
"""Least motion of the object in a decision that shows that the finger pushes it, m."""

MAX_PACES = 3.0
"""Greatest progress on a path between two decisions, in periods of decisions. If a decision comes
late, the path waits."""

MIN_PROGRESS = 0.002
"""Least distance that counts as progress, towards the goal or along the path, m."""


class PushFollower:
    """Pushes one object along one path, or to one goal.

    Attributes:
        obj: the object.
        finger: the finger.
        constraints: table and obstacles.
        options: how plans are searched for.
        track: where the object is.
        progress: how far the object came on its path, m.
    """

    def __init__(
        self,
        obj: GridObject,
        params: CellParameters,
        goal: ArrayLike | PosePath,
        finger: FeedbackFinger,
        *,
        draws: Sequence[CellParameters] = (),
        physics: Physics | None = None,
        constraints: PushConstraints | None = None,
        options: FollowOptions | None = None,
        track: TrackOptions | None = None,
        seed: int = 0,
    ) -> None:
        """Begins with nothing seen.

        Args:
            obj: the object.
            params: its masses and frictions, as learned.
            goal: (3,) pose X_WB, m and rad; or a path, at whose end its last pose is the goal.
            finger: the finger.
            draws: other models that agree with what was learned, such as
                `Identification.draws(32)`; at most `options.ensemble` are used.
            physics: physics of the models; the search is quasi-static in any case.
            constraints: table, obstacles, margins and the finger's region; the further rules are
                those of straight pushes, and are not asked.
            options: how plans are searched for.
            track: how poses are filtered.
            seed: of the search.

        Raises:
            PlanningError: an argument is out of range, or a model is of another object.
        """
        self.obj = obj
        self.finger = finger
        self.constraints = constraints or PushConstraints()
        self.options = options or FollowOptions()
        self.track = PoseTrack(obj.radius_of_gyration, track)
        self.progress = 0.0
        self._pace = 0.0
        self._decided_at = -np.inf
        self._best = np.inf
        self._best_at = -np.inf
        # times of the latest disturbances; their number on the way to this goal, now and at the
        # last decision
        self._disturbed_at: tuple[float, ...] = ()
        self._disturbances = 0
        self._known_disturbances = 0
        self._stopped: FollowStatus | None = None
        self._begun_goal = np.full(3, np.nan)
        self._middle = obj.p_BC.mean(axis=0)
        self._ways = make_outline_path(obj.outline, finger.radius, finger.shape)
        # decisions that it takes to go half round the object
        way = obj.outline.convex_hull.length + 2 * np.pi * finger.reach
        self._half_round = way / 2 / (finger.walking_speed * self.options.period)
        self._rng = np.random.default_rng(seed)
        self._physics = physics
        self._way: PathProgress | None = None
        self._room: FreeSpace | None = None
        self._begin_plan()
        self.set_model(params, draws)
        self.set_goal(goal)

    def copy(self) -> "PushFollower":
        """Makes a copy that goes on independently of this one; what never changes is shared."""
        other = copy(self)
        other.track = self.track.copy()
        other._ensemble = self._ensemble.copy()
        other._plan = self._plan.copy()
        other._rng = deepcopy(self._rng)
        return other

    def set_model(self, params: CellParameters, draws: Sequence[CellParameters] = ()) -> None:
        """Goes on with another model, such as one that was learned meanwhile.

        Args:
            params: masses and frictions.
            draws: other models that may be the true one.

        Raises:
            PlanningError: a model is of another object.
        """
        self._ensemble = ModelEnsemble(
            self.obj,
            params,
            list(draws)[: self.options.ensemble],
            self.finger,
            self._physics,
        )
        self._unlike_since = np.inf
        if self._stopped == FollowStatus.UNLIKE_MODEL:
            self._stopped = None
            self.track.forget_response()

    def set_goal(self, goal: ArrayLike | PosePath) -> None:
        """Goes on with another goal, or path; the goal may move on from decision to decision.

        A goal that moves by less than MIN_PROGRESS is the same one: what was found of the way to it
        holds.

        Args:
            goal: (3,) pose X_WB, m and rad; or a path.

        Raises:
            PlanningError: the pose is not three finite numbers.
        """
        self.progress = 0.0
        self._pace = 0.0
        poses = np.empty((0, 3))
        if isinstance(goal, PosePath):
            self._way = PathProgress(self.obj, goal)
            self.goal = goal.goal
            poses = goal.poses
            self._begin_plan()
            self._begin_path()
        else:
            before = self._way
            self.goal = check_vector(PlanningError, "goal", _limit_numbers(goal), 3)
            self._way = None
            # a plan to another goal may do for this one, too: the search will see
            if before is not None:
                self._begin_plan()
            if before is not None or not self._measure_to(self._begun_goal) < MIN_PROGRESS:
                self._begin_path()
        self._near_since = np.inf
        places = np.vstack([self.goal[None], poses])
        self._refused = None if is_plausible(places) else FollowStatus.GOAL_TOO_FAR
        if self._refused is not None:
            return
        if self._room is None or not covers_places(self._room, places[:, :2]):
            self._room = make_room(self.obj, self.constraints, self.finger, places[:, :2])
        self._refused = self._find_refusal()

    @property
    def refusal(self) -> FollowStatus | None:
        """Why the goal or the path cannot be followed, whatever is seen; None where it can."""
        return self._refused

    @property
    def _size(self) -> int:
        """Number of coordinates of the finger's place."""
        return self.finger.coordinates

    def _get_tip(self, state: Array) -> Array:
        """The finger's place (D,) in a state (STATE_SIZE,), m and rad."""
        return state[TIP_X : TIP_X + self._size]

    @property
    def model(self) -> SearchModel:
        """The estimate, as the compiled search takes it."""
        return self._ensemble.models[0]

    def add_pose(self, time: float, pose: ArrayLike) -> None:
        """Takes in a pose that was seen, whenever it comes.

        Args:
            time: when it was seen, s; at most the time of the last decision or `add_tip`.
            pose: (3,) X_WB, m and rad; with NaN, or beyond FARTHEST, it is passed over.
        """
        seen = np.asarray(pose, dtype=np.float64)
        if seen.shape != (3,) or not is_plausible(seen):
            return
        since = self.track.seen_at
        disturbances = self.track.disturbances
        if not self.track.add_pose(self.model, time, seen):
            return
        if self.track.disturbances != disturbances:
            latest = self._disturbed_at[1 - self.options.frequent_disturbances :]
            self._disturbed_at = (*latest, time)
            self._disturbances += 1
            self._ensemble.forget()
        else:
            tips = self.track.find_tips(since, time)
            self._ensemble.add(time, self.track.seen_pose, tips)
        moved = max(self.track.moved, LEAST_MOTION * self.obj.radius_of_gyration)
        if float(np.linalg.norm(self.track.corrected)) > self.options.unlike * moved:
            self._unlike_since = min(self._unlike_since, time)
        else:
            self._unlike_since = np.inf

    def add_tip(self, time: float, tip: ArrayLike) -> None:
        """Takes in where the finger's center is, (2,) m, at a time, s; times increase.

        Of a finger that is no disc it is (3,), with its angle, rad, which is continuous. With NaN,
        or beyond MAX_COORDINATE, it is passed over.
        """
        if is_plausible(tip):
            self.track.add_tip(time, check_vector(PlanningError, "tip", tip, self._size, "m"))

    def decide(
        self,
        time: float,
        tip: ArrayLike,
        *,
        lead: float = 0.0,
        velocity: ArrayLike | None = None,
    ) -> FollowDecision:
        """Decides on the finger's velocity; to be called once each `options.period`.

        Args:
            time: now, s.
            tip: (2,) where the finger's center is, W, m, and (3,) with its angle, rad, if it is no
                disc; with NaN, or beyond MAX_COORDINATE, the finger rests.
            lead: time until the finger does what is decided, s. It is not 0 if deciding itself
                takes a good part of a period.
            velocity: (2,) of the finger until then, W, m/s, or (3,) with rad/s; at rest if None.

        Raises:
            PlanningError: the finger's place or its velocity are not as many finite numbers, or the
                lead is negative.
        """
        if not lead >= 0:
            raise PlanningError(f"lead is {lead!r}; expected a time >= 0 (s)")
        self.add_tip(time, tip)
        # the pace of a path that decisions keep, whenever they come
        passed = min(time - self._decided_at, MAX_PACES * self.options.period)
        self._decided_at = time
        status = self._find_pause(time, tip)
        if status is not None:
            return self._rest(status)
        state = self.track.predict(self.model)
        pose = state[X : THETA + 1].copy()
        status = self._look_at_goal(time, pose, passed)
        if status is not None:
            return self._rest(status, pose)
        if np.isfinite(self._near_since):
            return self._push(np.zeros(self._size), AT_GOAL, pose)
        if lead > 0.0 and velocity is not None:
            way = lead * check_vector(PlanningError, "velocity", velocity, self._size, "m/s")
            follow_tip(self.model, state, (self._get_tip(state) + way)[None])
        cost_terms = self._make_cost(lead)
        chosen = self._search(state, cost_terms)
        return self._push(chosen, "" if chosen.any() else NO_PUSH_FOUND, pose)

    def _find_pause(self, time: float, tip: ArrayLike) -> FollowStatus | None:
        """Why nothing can be decided now from what is known; None where it can.

        Args:
            time: now, s.
            tip: (2,) where the finger's center is, W, m.
        """
        options = self.options
        if self._refused is not None:
            return self._refused
        if self._stopped is not None:
            return self._stopped
        if not is_plausible(tip):
            return FollowStatus.NO_FINGER
        if time - self.track.came_at > options.no_pose_after:
            return FollowStatus.NO_POSE
        if time - self.track.seen_at > options.no_pose_after:
            # poses come, but no two of them agree
            return FollowStatus.DISTURBED
        is_unlike = time - self._unlike_since > options.unlike_after
        # Written so that a response that is not known yet is good enough.
        if is_unlike or self.track.response < options.least_response:
            return self._stop(FollowStatus.UNLIKE_MODEL)
        if self._disturbances >= options.disturbances:
            return self._stop(FollowStatus.DISTURBED)
        lately = [at for at in self._disturbed_at if at > time - options.disturbance_time]
        if len(lately) >= options.frequent_disturbances:
            return FollowStatus.DISTURBED
        return None

    def _stop(self, status: FollowStatus) -> FollowStatus:
        """Lets the finger rest for good, until there is another goal."""
        self._stopped = status
        return status

    def _push(self, velocity: Array, reason: str, pose: Array) -> FollowDecision:
        """Makes a decision to push, or to wait for a reason until a push can be made."""
        return FollowDecision(velocity, FollowStatus.PUSHING, reason, pose, self.progress)

    def _find_refusal(self) -> FollowStatus | None:
        """Why the goal or the path cannot be followed, whatever is seen; None where it can."""
        # the goal, which is the path's last pose
        on_table, blocked = self.constraints.allow_pose(self.obj, self.goal)
        if not on_table:
            return FollowStatus.GOAL_OFF_TABLE
        if blocked:
            return FollowStatus.GOAL_BLOCKED
        if self._way is None:
            return None
        # the path before it
        if self._way.path.speed > self.finger.speed:
            return FollowStatus.TOO_FAST
        if not self.constraints.is_free:
            poses = self._way.path.poses
            checker = self.constraints.start_at(self.obj, self.goal, self.finger.reach)
            allowed = checker.allows_geometry(poses)
            # the object may begin too near to something, and then comes out
            begin = int(allowed.argmax())
            if not (allowed.any() and allowed[begin:].all()):
                return FollowStatus.PATH_BLOCKED
        return None

    def _look_at_goal(self, time: float, pose: Array, passed: float) -> FollowStatus | None:
        """Notes how far the object has come; says whether it is there, or does not get on.

        Args:
            time: now, s.
            pose: (3,) where the object is.
            passed: time since the last decision, s.
        """
        # How far it has come: along the path, then towards the goal.
        center = transform(pose, self._middle[None])[0]
        if self._way is not None:
            self.progress = self._way.project(center, float(pose[2]), self.progress)
            step = self._way.path.speed * passed
            self._pace = min(self.progress, self._pace + step)
            gained = -self.progress
        else:
            gained = 0.0
        if not self._is_on_path:
            gained += self._measure_to(pose)
        # Whether it got on lately; a disturbance is not its fault.
        is_disturbed = self._disturbances != self._known_disturbances
        self._known_disturbances = self._disturbances
        if is_disturbed or gained < self._best - MIN_PROGRESS or self._best_at == -np.inf:
            self._best = gained
            self._best_at = time
        options = self.options
        if not self._is_on_path:
            aim = transform(self.goal, self._middle[None])[0]
            distance = float(np.linalg.norm(center - aim))
            turn = abs(float(wrap_angle(pose[2] - self.goal[2])))
            near = distance < options.position_tolerance and turn < options.angle_tolerance
            self._near_since = min(self._near_since, time) if near else np.inf
            # it counts once it was seen to lie there, with the finger at rest
            if self.track.seen_at > self._near_since + SETTLING_TIME:
                self._begin_path()  # a later disturbance begins a new way to the goal
                return FollowStatus.REACHED
        if time - self._best_at > options.stuck_after:
            return self._stop(FollowStatus.STUCK)
        return None

    def _measure_to(self, pose: Array) -> float:
        """Distance of a pose (3,) from the goal, m; the turn counts by the radius of gyration."""
        centers = transform(np.array([pose, self.goal]), self._middle[None])[:, 0]
        distance = float(np.linalg.norm(centers[0] - centers[1]))
        turn = abs(float(wrap_angle(pose[2] - self.goal[2])))
        return float(np.hypot(distance, self.obj.radius_of_gyration * turn))

    @property
    def _is_on_path(self) -> bool:
        """Whether there is a path, and the object is not yet at its end."""
        return self._way is not None and self.progress < self._way.length - MIN_PROGRESS

    def _make_cost(self, lead: float) -> TrackingCost:
        """Says what is wanted of the next decisions, the first of which is done after a time, s."""
        options = self.options
        # where the object should be after each decision
        follows = self._is_on_path
        count = self._count_decisions(follows)
        if follows:
            assert self._way is not None
            ahead = self._way.path.speed * (lead + options.period * np.arange(count + 1))
            references = self._way.at(self._pace + ahead)
            along = self._way.along(self._pace + ahead)
        else:
            center = transform(self.goal, self._middle[None])[0]
            references = np.tile(np.append(center, self.goal[2]), (count + 1, 1))
            along = np.zeros((count + 1, 2))
        arm = self.obj.radius_of_gyration
        return TrackingCost(
            follows=follows,
            references=references,
            along=along,
            weight_along=float(options.weight_along),
            weight_turn=float(options.weight_turn),
            middle=self._middle,
            arm=float(arm),
            position_tolerance=float(options.position_tolerance),
            angle_tolerance=float(options.angle_tolerance),
            per_decision=1.0,
            base=float(options.base * self._half_round),
            per_length=float(options.slowness / (self.finger.speed * options.period)),
            per_root=float(options.per_root / np.sqrt(arm)),
            goal_fraction=GOAL_SHRINKAGE,
        )

    def _count_decisions(self, follows: bool) -> int:
        """Decisions of a plan, on a path or to a goal."""
        return self.options.path_horizon if follows else self.options.horizon

    def _begin_path(self) -> None:
        """Begins a way to the goal: forgets how near the object came, and what went wrong."""
        self._begun_goal = self.goal
        self._best = np.inf
        self._best_at = -np.inf
        self._disturbances = 0
        self._known_disturbances = 0
        self._stopped = None

    def _begin_plan(self) -> None:
        """Forgets the plan."""
        self._length = 0
        self._per_decision = 1.0
        self._found = True
        self._follows = False
        self._plan = np.zeros((1, self._size))

    def _search(self, state: Array, cost_terms: TrackingCost) -> Array:
        """Improves the plan from a state (STATE_SIZE,) on; returns its first velocity (D,)."""
        options = self.options
        count = self._count_decisions(cost_terms.follows)
        if self._follows != cost_terms.follows or len(self._plan) != count:
            self._begin_plan()
            self._plan = np.zeros((count, self._size))
            self._follows = cost_terms.follows
        assert self._room is not None
        tip = self._get_tip(state).copy()
        states = np.zeros((count + 1, STATE_SIZE))
        states[0] = state
        plan = Plan(targets=self._plan, states=states)
        if self._length == 0:
            self._per_decision = 1.0 if self._found else self._per_decision
        for attempt in range(options.attempts):
            if attempt or not self._found:
                self._per_decision = max(0.5 * self._per_decision, LEAST_PER_DECISION)
            candidates = draw_candidates(self._rng, options, self.finger)
            cost, self._length, to_go = search_push(
                self.model,
                cost_terms._replace(per_decision=self._per_decision),
                self._room,
                self._ways,
                plan,
                self._length,
                candidates,
            )
            # better than to stand still for one decision
            self._found = cost_terms.follows or cost < self._per_decision + to_go - LEAST_GAIN
            if self._found:
                break
            self._length = 0
        if self._length == 0:
            return np.zeros(self._size)
        if cost_terms.follows:
            for _ in range(options.refinements):
                targets = self._plan[: self._length]
                models = self._ensemble.models[: 1 + options.draws]
                if not refine_plan(models, cost_terms, self._room, state, targets, candidates):
                    break
        velocity = self._limit((self._plan[0] - tip) / options.period, state)
        self._plan[:-1] = self._plan[1:]
        self._length -= 1
        return velocity

    def _limit(self, velocity: Array, state: Array) -> Array:
        """Shortens a velocity (D,), m/s, to what the finger may have at a state (STATE_SIZE,).

        While it pushes it is slower than on its way round the object: until the next decision
        nobody corrects it, and poses come late. A finger that is no disc turns slower with it.
        """
        after = state.copy()
        tip = self._get_tip(state)
        follow_tip(self.model, after, (tip + self.options.period * velocity)[None])
        moved = after[X : THETA + 1] - state[X : THETA + 1]
        pushes = (
            np.hypot(np.hypot(*moved[:2]), self.obj.radius_of_gyration * moved[2])
            > MIN_PUSHED_MOTION
        )
        most = self.finger.speed if pushes else self.finger.walking_speed
        speed = float(np.linalg.norm(velocity[:2]))
        return np.asarray(velocity * min(1.0, most / max(speed, most)))

    def _rest(self, status: FollowStatus, pose: Array | None = None) -> FollowDecision:
        """Lets the finger rest."""
        self._begin_plan()
        where = np.full(3, np.nan) if pose is None else pose
        return FollowDecision(
            np.zeros(self._size), status, FOLLOW_REASONS[status], where, self.progress
        )


def _limit_numbers(goal: ArrayLike) -> ArrayLike:
    """Limits the numbers of a goal to MAX_NUMBER: as too far away it is refused by a status."""
    numbers = np.asarray(goal)
    is_number = np.issubdtype(numbers.dtype, np.number)
    return np.clip(numbers, -MAX_NUMBER, MAX_NUMBER) if is_number else goal
