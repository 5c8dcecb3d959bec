"""`PokePolicy`: a Drake system that commands random pokes, one whenever the executor is ready.

A poke begins at a random place of the outline where the tip fits and the object stays in bounds.
Candidates are drawn until one of them will do. The k-th candidate of a push is drawn from (seed,
command_id, k) alone, so that it does not depend on the pushes before it, nor on how many candidates
these took.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from math import atan2, isfinite, pi, radians

import numpy as np
from numpy.typing import ArrayLike
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import BasicVector, Context
from shapely import LineString, Point, Polygon

from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.pusher import DEFAULT_PUSHER_RADIUS
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import PushError
from gridpush_drake.geometry.se2 import Array, transform_shape
from gridpush_drake.identification.model import Model
from gridpush_drake.multibody.weak_calc import NO_SLOTS
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.closed_loop import LoopOptions, Pose
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.systems.messages import PUSH_COMMAND_SIZE, PushCommand, PushStatus
from gridpush_drake.systems.object_controller import AbstractStateSystem
from gridpush_drake.systems.worker import Request, Worker, make_worker

Reach = Callable[[PushCommand], bool]
"""A function that returns whether the arm can carry out a command."""

ROUNDING = 1e-6
"""Share of the gap between tip and outline that may be missing at the start. A point that is
calculated on the outline is not exactly on it."""


WAYPOINTS = 4
"""Number of poses, evenly spread over a poke, at which the object must be in its region. There may
be something in the way, such as a post, though the object lies clear of it at the end."""


@dataclass(frozen=True)
class RandomPokeOptions:
    """How pokes are drawn.

    Attributes:
        distance: least and greatest length of a push, counted from where the tip would touch the
            outline, m.
        speed: speed of the tip, m/s.
        slant: greatest angle between a push and the outline's normal, rad.
        tip_radius: radius of the finger's tip, m.
        clearance: gap between tip and outline at the beginning, m. The way through it comes on top
            of the distance.
        min_motion: a push is drawn again if it is predicted to move the object's cells by less than
            this in the mean, m.
        candidates: greatest number of draws. Then a push that takes the object out of its region is
            taken, if there is no better one.

    Raises:
        PushError: a value is out of range.
    """

    distance: tuple[float, float] = (0.06, 0.10)
    speed: float = 0.03
    slant: float = radians(30)
    tip_radius: float = DEFAULT_PUSHER_RADIUS
    clearance: float = 0.008
    min_motion: float = 0.01
    candidates: int = 100

    def __post_init__(self) -> None:
        if not 0 < self.distance[0] <= self.distance[1] < np.inf:
            raise PushError(f"distance is {self.distance!r}; expected 0 < least <= greatest (m)")
        for name in ("speed", "tip_radius"):
            if not (isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise PushError(f"{name} is {getattr(self, name)!r}; expected a positive number")
        if not 0 <= self.slant < pi / 2:
            raise PushError(
                f"slant is {self.slant!r}; expected an angle from 0 to less than pi / 2 (rad)"
            )
        for name in ("clearance", "min_motion"):
            if not (isfinite(getattr(self, name)) and getattr(self, name) >= 0):
                raise PushError(f"{name} is {getattr(self, name)!r}; expected a number >= 0 (m)")
        if self.candidates < 1:
            raise PushError(f"candidates is {self.candidates!r}; expected 1 or more")


@dataclass(frozen=True)
class PokeRegion:
    """Regions in which pokes may happen, polygons in W, m.

    Attributes:
        workspace: where the tip's center may be.
        keep_in: where the whole object must stay.
        middle: where the object's centroid should stay, so that the finger gets at the object from
            all sides; None if nowhere.
    """

    workspace: Polygon
    keep_in: Polygon
    middle: Polygon | None = None

    @property
    def center(self) -> Array:
        """Best place for the object's centroid, (2,) in W, m."""
        return np.array((self.middle or self.keep_in).centroid.coords[0])

    def suits(self, centroid: Array) -> bool:
        """Returns whether an object with its centroid at (2,), m, is where it should stay."""
        return self.middle is None or bool(self.middle.covers(Point(centroid)))


def choose_poke(
    model: Model,
    pose: ArrayLike,
    command_id: int,
    seed: int,
    style: RandomPokeOptions,
    region: PokeRegion,
    reach: Reach | None = None,
    first: int = 0,
) -> tuple[PushCommand | None, int]:
    """Chooses a push.

    Candidates are drawn one after another. A candidate fits if the tip is beside the object at the
    beginning, stays within its workspace and within the arm's reach, and moves the object. The
    first fitting candidate is taken that is predicted to leave the object within its region. If
    there is none, the fitting candidate is taken that ends nearest to the region's center;
    candidates that keep the object in `region.keep_in` go before others.

    Args:
        model: one object, with its parameters.
        pose: (3,) X_WB of the object, m and rad.
        command_id: number of the command.
        seed: seed of the draws.
        style: how to push.
        region: where pushes may happen.
        reach: returns whether the arm can carry out a command; None if it always can.
        first: number of candidates to pass over, since they were looked at before.

    Returns:
        The command, or None if no candidate fits; and the number of candidates that were looked
        at, with those passed over.
    """
    obj = model.obj
    q = np.array(pose, dtype=np.float64)
    # The best of the fitting candidates that leave the region, and how bad it is: whether the
    # object leaves `keep_in`, and how far from the center it ends.
    nearest = None
    least = (True, np.inf)
    for attempt in range(first, first + style.candidates):
        command = draw_poke(obj, q, command_id, seed, attempt, style)
        if not fits(obj, q, command, style, region) or (reach is not None and not reach(command)):
            continue
        poses = predict_poke(model, q, command, style)
        cells = obj.cells_at(poses[-1])
        if np.linalg.norm(cells - obj.cells_at(q), axis=1).mean() < style.min_motion:
            continue
        leaves = not all(
            region.keep_in.covers(transform_shape(pose, obj.outline)) for pose in poses
        )
        centroid = cells.mean(axis=0)
        if not leaves and region.suits(centroid):
            return command, attempt + 1
        badness = (leaves, float(np.linalg.norm(centroid - region.center)))
        if badness < least:
            nearest = command
            least = badness
    return nearest, first + style.candidates


def draw_poke(
    obj: GridObject, pose: Array, command_id: int, seed: int, attempt: int, style: RandomPokeOptions
) -> PushCommand:
    """Draws a candidate: a place on the exterior outline, a slant and a distance, all uniform.

    Args:
        obj: the object.
        pose: (3,) X_WB of the object, m and rad.
        command_id: number of the command.
        seed: seed of all draws.
        attempt: number of the candidate, from 0.
        style: how to push.
    """
    rng = np.random.default_rng((seed, command_id, attempt))
    place = rng.uniform(0, obj.edges.perimeter)
    slant = rng.uniform(-1, 1) * style.slant
    distance = rng.uniform(*style.distance)
    push = Push.on_outline(
        obj,
        place,
        slant,
        distance + style.clearance,
        radius=style.tip_radius,
        speed=style.speed,
        pose=pose,
        clearance=style.clearance,
    )
    x, y = push.start.tolist()
    return PushCommand(
        command_id=command_id,
        x=x,
        y=y,
        direction=atan2(push.velocity[1], push.velocity[0]),
        distance=push.length,
        speed=style.speed,
    )


def fits(
    obj: GridObject, pose: Array, command: PushCommand, style: RandomPokeOptions, region: PokeRegion
) -> bool:
    """Returns whether the tip has room where it starts, and stays within its workspace.

    It has no room in a notch that is too narrow. It goes straight, and may not cross a place that
    was cut out of the workspace, such as that of a post.
    """
    start = Point(command.start)
    end = Point(command.end)
    gap = transform_shape(pose, obj.outline).distance(start)
    if gap < (1 - ROUNDING) * (style.tip_radius + style.clearance):
        return False
    return bool(region.workspace.covers(LineString([start, end])))


def predict_poke(
    model: Model,
    pose: Array,
    command: PushCommand,
    style: RandomPokeOptions,
) -> Array:
    """Predicts poses X_WB (WAYPOINTS, 3) of the object on its way, m and rad, the last at the end.

    Inertia is neglected.
    """
    velocity = (command.end - command.start) / command.distance * command.speed
    push = Push(command.start, velocity, command.distance / command.speed, style.tip_radius)
    motion = simulate(model, push, pose, regime="quasi_static", record=[])
    rows = np.linspace(0, len(motion.poses) - 1, WAYPOINTS + 1).round().astype(int)[1:]
    return motion.poses[rows]


DEFAULT_PERIOD = 0.05
"""Time between two looks at the executor's status, s."""

LOGGING_TIME = 2.0
"""Time after a poke within which it is logged, if it is at all, s."""

MAX_REPETITION = 2
"""Greatest number of pokes that are made, in how many are wanted: not every poke is logged."""


@dataclass(frozen=True)
class PokePolicyState:
    """All that the policy remembers.

    Attributes:
        command: the command on the port.
        attempts: number of candidates that were looked at for the next command, none of which fits.
        request: the choice under way in a worker; None if there is none.
        looked_at: (3,) X_WB of the object when that choice was asked for, m and rad.
        ready_at: time at which the executor was found ready after the command, s; inf before.
        reason: why the last choice could not be made; empty if it could.
    """

    command: PushCommand = field(default_factory=PushCommand)
    attempts: int = 0
    request: Request | None = None
    looked_at: Pose | None = None
    ready_at: float = np.inf
    reason: str = ""


class PokePolicy(AbstractStateSystem[PokePolicyState]):
    """Commands one exploratory push after another, see `choose_poke`.

    .. pydrake_system::

        name: PokePolicy
        input_ports:
        - object_pose
        - status
        - push_log
        output_ports:
        - push_command
        - message

    * object_pose: vector of 3, observed X_WB, (x, y, theta), m and rad; while it is NaN the policy
      waits.
    * status: abstract `PushStatus` of the executor.
    * push_log: abstract `PushLog`, the pushes that could be written down. It need not be connected.
    * push_command: vector of 6, see `PushCommand`; its id is 0 before the first. It stays until the
      executor is ready again and has taken up, or refused, its id.
    * message: abstract `str`, why the choice of a push has failed in a worker; else empty.

    A refused command is replaced by another one, with the next id. After `num_pushes` executed
    commands, and `test_pushes` more with a distance of their own, the last command stays. A push
    that was not written down, such as one before or after which the arm hid the object, is made up
    for by another one where the log is connected; twice as many are made at most. Abstract
    state: one `PokePolicyState`. Numeric parameter 0: the seed.
    """

    __slots__ = NO_SLOTS

    def __init__(
        self,
        model: Model,
        region: PokeRegion,
        seed: int = 0,
        num_pushes: int = 8,
        style: RandomPokeOptions | None = None,
        *,
        reach: Reach | None = None,
        test_pushes: int = 0,
        test_distance: float = 0.10,
        period: float = DEFAULT_PERIOD,
        answer_delay: float | None = 0.0,
    ) -> None:
        """Declares the system.

        Args:
            model: one object, with its parameters.
            region: where the tip may be, and where the object must stay.
            seed: seed of the draws.
            num_pushes: number of pushes to be executed.
            style: how to push.
            reach: returns whether the arm can carry out a command; None if it always can.
            test_pushes: number of pushes to be executed after those.
            test_distance: length of these pushes, m.
            period: time between two looks at the status, s.
            answer_delay: time after which a choice is taken, s; None for real time, see
                `worker.make_worker`.

        Raises:
            PushError: a number is negative, or the period is not positive.
            PlanningError: the delay is negative.
        """
        for name, value in (("num_pushes", num_pushes), ("test_pushes", test_pushes)):
            if value < 0:
                raise PushError(f"{name} is {value!r}; expected 0 or more")
        if not (np.isfinite(period) and period > 0):
            raise PushError(f"period is {period!r}; expected a positive number (s)")
        super().__init__(PokePolicyState(), period)
        self._worker = make_worker(answer_delay)
        self.obj = model.obj
        self.region = region
        self.style = style or RandomPokeOptions()
        self._seed = self.DeclareNumericParameter(BasicVector([float(seed)]))
        self.num_pushes = num_pushes
        self.test_pushes = test_pushes
        self._test_style = replace(self.style, distance=(test_distance, test_distance))
        self._model = model
        self._reach = reach
        self._object_pose = self.DeclareVectorInputPort("object_pose", 3)
        self._status = self.DeclareAbstractInputPort("status", AbstractValue.Make(PushStatus()))
        self._push_log = self.DeclareAbstractInputPort("push_log", AbstractValue.Make(PushLog(())))
        self._declare_vector("push_command", PUSH_COMMAND_SIZE, lambda now: now.command.to_vector())
        self._declare_value("message", lambda now: now.reason)

    def SetSeed(self, root_context: Context, seed: int) -> None:
        """Sets the seed of the draws in a Diagram's Context."""
        context = self.GetMyMutableContextFromRoot(root_context)
        context.get_mutable_numeric_parameter(int(self._seed)).SetFromVector([float(seed)])

    def _go_on(self, context: Context, now: PokePolicyState) -> PokePolicyState:
        status: PushStatus = self._status.Eval(context)
        pose = self._object_pose.Eval(context)
        is_idle = status.ready and status.command_id == now.command.command_id
        if is_idle and now.ready_at == np.inf:
            now = replace(now, ready_at=context.get_time())
        is_due = is_idle and np.isfinite(pose).all() and self._wants_more(context, now, status)
        if not is_due:
            # A choice under way is of no use any more.
            return now if now.request is None else replace(now, request=None, looked_at=None)
        if now.request is not None and self._worker is not None:
            return self._take_choice(self._worker, now, pose, context.get_time())

        # A new choice, at once or in a worker.
        planned = self.num_pushes + self.test_pushes
        is_test = self.num_pushes <= status.executed < planned
        style = self._test_style if is_test else self.style
        choose = partial(
            choose_poke,
            model=self._model,
            pose=np.array(pose),
            command_id=now.command.command_id + 1,
            seed=int(context.get_numeric_parameter(int(self._seed)).value()[0]),
            style=style,
            region=self.region,
            reach=self._reach,
            first=now.attempts,
        )
        if self._worker is None:
            command, attempts = choose()
            return _apply_choice(now, command, attempts)
        x, y, theta = pose.tolist()
        request = self._worker.ask(choose, context.get_time())
        return replace(now, request=request, looked_at=(x, y, theta))

    def _wants_more(self, context: Context, now: PokePolicyState, status: PushStatus) -> bool:
        """Whether another push is wanted: not all were made, or one of them was not logged."""
        planned = self.num_pushes + self.test_pushes
        if status.executed < planned:
            return True
        if not self._push_log.HasValue(context) or status.executed >= MAX_REPETITION * planned:
            return False
        if context.get_time() < now.ready_at + LOGGING_TIME:
            return False
        log: PushLog = self._push_log.Eval(context)
        return len(log) < planned

    def _take_choice(
        self, worker: Worker, now: PokePolicyState, pose: Array, time: float
    ) -> PokePolicyState:
        """Returns the state after a choice in a worker; `now` if that is still under way.

        A choice counts only if the object still lies where it did when the choice was asked for.
        """
        assert now.request is not None and now.looked_at is not None
        answer = worker.take(now.request, time)
        if answer is None:
            return now
        looked_at = now.looked_at
        now = replace(now, request=None, looked_at=None, reason=answer.error)
        if answer.error or not LoopOptions().are_of_one_rest([looked_at], pose):
            return now
        command, attempts = answer.value
        return _apply_choice(now, command, attempts)


def _apply_choice(
    now: PokePolicyState, command: PushCommand | None, attempts: int
) -> PokePolicyState:
    """Returns the state after `choose_poke`: with the new command, or with the draws in vain."""
    if command is None:
        return PokePolicyState(command=now.command, attempts=attempts, ready_at=now.ready_at)
    return PokePolicyState(command=command)
