"""Which push comes next, as a Drake system: random pokes, one whenever the executor is ready for it.

A poke begins at a random place of the outline where the tip fits and the object stays in bounds.
The k-th candidate of a push is drawn from (seed, command_id, k) alone: neither the pushes before it
nor how many candidates they took change it.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from math import atan2, isfinite, pi, radians

import numpy as np
from numpy.typing import ArrayLike
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import BasicVector, Context
from shapely import Point, Polygon

from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import PushError
from gridpush_drake.geometry.se2 import Array, transform_shape
from gridpush_drake.multibody.weak_calc import NO_SLOTS
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.closed_loop import LoopOptions, Pose
from gridpush_drake.pushes.push_log import DEFAULT_PUSHER_RADIUS
from gridpush_drake.systems.messages import PUSH_COMMAND_SIZE, PushCommand, PushStatus
from gridpush_drake.systems.object_controller import AbstractStateSystem
from gridpush_drake.systems.worker import Request, Worker, make_worker

Reach = Callable[[PushCommand], bool]
"""Whether the arm can carry out a command."""

ROUNDING = 1e-6
"""Share of the gap at the start that may be missing: the outline's own point is not exactly on
it."""


@dataclass(frozen=True)
class RandomPokeOptions:
    """How pokes are drawn.

    Attributes:
        distance: least and greatest, m, counted from where the tip would touch the outline.
        speed: of the tip, m/s.
        slant: furthest from the outline's normal, rad.
        tip_radius: m.
        clearance: gap between tip and outline at the beginning, m; the path through it comes on top
            of the distance.
        min_motion: of the cells, mean, as predicted, m; a push that moves the object less is drawn
            again.
        candidates: most draws before a push that takes the object out of its region is taken for
            want of a better one.

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
    """Where pokes may happen, W, m.

    Attributes:
        workspace: where the tip's center may be.
        keep_in: that the whole object must stay in.
        middle: that the object's centroid should stay in, where the finger gets at it from all
            sides; None asks for no more than `keep_in`.
    """

    workspace: Polygon
    keep_in: Polygon
    middle: Polygon | None = None

    @property
    def center(self) -> Array:
        """(2,) where the object's centroid is best, m."""
        return np.array((self.middle or self.keep_in).centroid.coords[0])

    def suits(self, centroid: Array) -> bool:
        """Whether the finger can get at an object with this centroid (2,), m, from all sides."""
        return self.middle is None or bool(self.middle.covers(Point(centroid)))


def choose_poke(
    obj: GridObject,
    params: CellParameters,
    pose: ArrayLike,
    command_id: int,
    seed: int,
    style: RandomPokeOptions,
    region: PokeRegion,
    reach: Reach | None = None,
    first: int = 0,
) -> tuple[PushCommand | None, int]:
    """Chooses a push.

    Candidates are drawn one after another. The first one is taken that fits (the tip beside the
    object and within its workspace, within the arm's reach), moves the object, and is predicted to
    leave it within its region. Where there is none, the fitting one that ends nearest to the
    region's center is taken, of those that keep the object in if any do.

    Args:
        obj: the object.
        params: by which its motion is predicted.
        pose: (3,) where it lies, m and rad.
        command_id: of the command.
        seed: of the draws.
        style: how to push.
        region: where.
        reach: whether the arm can carry out a command; None trusts it.
        first: candidates to pass over.

    Returns:
        The command, or None where no candidate fits; and how many candidates were looked at, with
        those passed over.
    """
    q = np.array(pose, dtype=np.float64)
    nearest, least = None, (True, np.inf)
    for attempt in range(first, first + style.candidates):
        command = draw_poke(obj, q, command_id, seed, attempt, style)
        if not fits(obj, q, command, style, region) or (reach is not None and not reach(command)):
            continue
        last = predict_poke(obj, params, q, command, style)
        cells = obj.cells_at(last)
        if np.linalg.norm(cells - obj.cells_at(q), axis=1).mean() < style.min_motion:
            continue
        leaves = not region.keep_in.covers(transform_shape(last, obj.outline))
        centroid = cells.mean(axis=0)
        if not leaves and region.suits(centroid):
            return command, attempt + 1
        badness = (leaves, float(np.linalg.norm(centroid - region.center)))
        if badness < least:
            nearest, least = command, badness
    return nearest, first + style.candidates


def draw_poke(
    obj: GridObject, pose: Array, command_id: int, seed: int, attempt: int, style: RandomPokeOptions
) -> PushCommand:
    """Draws a candidate: a place on the exterior outline, a slant and a distance, all uniform."""
    rng = np.random.default_rng((seed, command_id, attempt))
    place, slant, distance = (
        rng.uniform(0, obj.edges.perimeter),
        rng.uniform(-1, 1),
        rng.uniform(*style.distance),
    )
    push = Push.on_outline(
        obj, place, slant * style.slant, distance + style.clearance, radius=style.tip_radius, speed=style.speed,
        pose=pose, clearance=style.clearance,
    )  # fmt: skip
    x, y = push.start.tolist()
    return PushCommand(
        command_id, x, y, atan2(push.velocity[1], push.velocity[0]), push.length, style.speed
    )


def fits(
    obj: GridObject, pose: Array, command: PushCommand, style: RandomPokeOptions, region: PokeRegion
) -> bool:
    """Whether the tip has room where it starts (a notch may be too narrow) and stays within its workspace."""
    start, end = Point(command.start), Point(command.end)
    gap = transform_shape(pose, obj.outline).distance(start)
    if gap < (1 - ROUNDING) * (style.tip_radius + style.clearance):
        return False
    return bool(region.workspace.covers(start) and region.workspace.covers(end))


def predict_poke(
    obj: GridObject,
    params: CellParameters,
    pose: Array,
    command: PushCommand,
    style: RandomPokeOptions,
) -> Array:
    """Predicts the object's pose (3,) after a push, by the LCP of slow motion."""
    velocity = (command.end - command.start) / command.distance * command.speed
    push = Push(command.start, velocity, command.distance / command.speed, style.tip_radius)
    return simulate(obj, params, push, pose, regime="quasi_static", record=[]).final_pose


DEFAULT_PERIOD = 0.05
"""s."""


@dataclass(frozen=True)
class PokePolicyState:
    """All that the policy remembers.

    Attributes:
        command: on the port.
        attempts: candidates looked at for the next command, where none was found so far.
        request: the choice under way; None where none is.
        looked_at: (3,) where the object lay then, m and rad.
        reason: why no choice could be made, the last time; empty where it could.
    """

    command: PushCommand = field(default_factory=PushCommand)
    attempts: int = 0
    request: Request | None = None
    looked_at: Pose | None = None
    reason: str = ""


class PokePolicy(AbstractStateSystem[PokePolicyState]):
    """Commands one exploratory push after another, see `choose_poke`.

    .. pydrake_system::

        name: PokePolicy
        input_ports:
        - object_pose
        - status
        output_ports:
        - push_command
        - message

    * object_pose: vector of 3, observed (x, y, theta) of B in W, m and rad; while it is NaN the
      policy waits.
    * status: abstract `PushStatus` of the executor.
    * push_command: vector of 6, see `PushCommand`; id 0 before the first. It stays until the
      executor is ready again and has taken up, or refused, its id.
    * message: abstract `str`, why no push could be chosen, where what chooses beside the Diagram
      failed; else empty.

    A refused command is replaced by another one, with the next id. After `num_pushes` executed
    commands, and `test_pushes` more of their own style, the last one stays. Abstract state: one
    `PokePolicyState`. Numeric parameter 0: the seed.
    """

    __slots__ = NO_SLOTS

    def __init__(
        self,
        obj: GridObject,
        region: PokeRegion,
        seed: int = 0,
        num_pushes: int = 8,
        style: RandomPokeOptions | None = None,
        *,
        params: CellParameters | None = None,
        reach: Reach | None = None,
        test_pushes: int = 0,
        test_distance: float = 0.10,
        period: float = DEFAULT_PERIOD,
        answer_delay: float | None = 0.0,
    ) -> None:
        """Declares the system.

        Args:
            obj: the object.
            region: where the tip may be, and the object must stay.
            seed: of the draws.
            num_pushes: to be executed.
            style: how to push.
            params: by which the object's motion is predicted; the prior's by default.
            reach: whether the arm can carry out a command; None trusts it.
            test_pushes: to be executed after that.
            test_distance: of those, m.
            period: between two looks at the status, s.
            answer_delay: s after which a choice is taken; None for real time, see
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
        self.obj, self.region, self.style = obj, region, style or RandomPokeOptions()
        self._seed = self.DeclareNumericParameter(BasicVector([float(seed)]))
        self.num_pushes, self.test_pushes = num_pushes, test_pushes
        self._test_style = replace(self.style, distance=(test_distance, test_distance))
        self._params = CellParameters.uniform(obj) if params is None else params
        self._reach = reach
        self._object_pose = self.DeclareVectorInputPort("object_pose", 3)
        self._status = self.DeclareAbstractInputPort("status", AbstractValue.Make(PushStatus()))
        self._declare_vector("push_command", PUSH_COMMAND_SIZE, lambda now: now.command.to_vector())
        self._declare_value("message", lambda now: now.reason)

    def SetSeed(self, root_context: Context, seed: int) -> None:
        """Sets the seed of the draws in a Diagram's Context."""
        context = self.GetMyMutableContextFromRoot(root_context)
        context.get_mutable_numeric_parameter(int(self._seed)).SetFromVector([float(seed)])

    def _go_on(self, context: Context, now: PokePolicyState) -> PokePolicyState:
        status: PushStatus = self._status.Eval(context)
        pose = self._object_pose.Eval(context)
        wanted = status.executed < self.num_pushes + self.test_pushes
        if not (
            wanted
            and status.ready
            and status.command_id == now.command.command_id
            and np.isfinite(pose).all()
        ):
            return now if now.request is None else replace(now, request=None, looked_at=None)
        if now.request is not None and self._worker is not None:
            return self._take_choice(self._worker, now, pose, context.get_time())
        style = self.style if status.executed < self.num_pushes else self._test_style
        seed = int(context.get_numeric_parameter(int(self._seed)).value()[0])
        work = partial(
            choose_poke, self.obj, self._params, np.array(pose), now.command.command_id + 1, seed, style, self.region,
            self._reach, now.attempts,
        )  # fmt: skip
        if self._worker is None:
            return _choose(now, *work())
        x, y, theta = pose.tolist()
        return replace(
            now, request=self._worker.ask(work, context.get_time()), looked_at=(x, y, theta)
        )

    def _take_choice(
        self, worker: Worker, now: PokePolicyState, pose: Array, time: float
    ) -> PokePolicyState:
        """The state once a choice was made, which counts if the object still lies there; `now` while none was."""
        assert now.request is not None and now.looked_at is not None
        answer = worker.take(now.request, time)
        if answer is None:
            return now
        lay, now = now.looked_at, replace(now, request=None, looked_at=None, reason=answer.error)
        if answer.error or not LoopOptions().are_of_one_rest([lay], pose):
            return now
        return _choose(now, *answer.value)


def _choose(now: PokePolicyState, command: PushCommand | None, attempts: int) -> PokePolicyState:
    """The state after `choose_poke`."""
    return PokePolicyState(command) if command else PokePolicyState(now.command, attempts)
