"""A world to push an object in that the project's own simulator moves, and the driver that steps a closed loop in it.

The loop is the one that a controller in a station steps; here nothing passes between two
observations but a push.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from time import perf_counter
from typing import Generic, Protocol

import numpy as np
import shapely
from numpy.typing import ArrayLike
from shapely import MultiPoint, Point

from gridpush_drake.dynamics.physics import Regime
from gridpush_drake.dynamics.push import Push, make_path_times
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import PlanningError
from gridpush_drake.geometry.se2 import Array, transform
from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.result import Identification
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.closed_loop import ClosedLoop, L, Observation
from gridpush_drake.planning.push_constraints import make_body
from gridpush_drake.planning.robot_status import PushStatus
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.pushes.push_log import ObservedPush, PushLog

OBSERVATIONS = 4  # poses that are seen during a push, after the first, its end among them
FALL_CHECKS = 40  # poses of a push at which it is checked whether the object falls
REGIME: Regime = "quasi_static"  # of the true motion

UNSEEN = np.full(3, np.nan)


class PushWorld(Protocol):
    """Where an object lies and can be pushed."""

    @property
    def pose(self) -> Array | None:
        """(3,) q_W of the object as it is seen now, m and rad; None while it is not seen, or has fallen."""
        ...

    def execute(self, push: Push) -> ObservedPush:
        """Carries out a push, and says what was seen of the object."""
        ...


class SimulatedWorld:
    """An object with hidden masses and frictions on a table, moved by `simulate`.

    The support presses as if there were no edge: an object that hangs over rubs like one that does
    not. It falls where its center of mass leaves the convex hull of what lies on the table.

    Attributes:
        obj: the object.
        hidden: its true masses and frictions.
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
        seed: int | np.random.Generator = 0,
        observations: int = OBSERVATIONS,
    ) -> None:
        """Puts the object down at `pose` (3,), m and rad.

        Args:
            surface: the table; None for one without end.
            position_std: standard deviation of seen positions, per axis, m.
            angle_std: of seen angles, rad.
            seed: of the noise, or what draws it.
            observations: poses that are seen during a push, after the first.

        Raises:
            PlanningError: a number is out of range.
        """
        if not (position_std >= 0 and angle_std >= 0 and observations >= 1):
            raise PlanningError(
                "position_std and angle_std must be >= 0, and observations at least 1"
            )
        self.obj, self.hidden, self.surface, self.fallen, self.pushes = (
            obj,
            hidden,
            surface,
            False,
            0,
        )
        self.true_pose = np.array(pose, dtype=np.float64)
        self._observations = observations
        self._std = np.array([position_std, position_std, angle_std])
        self._rng = np.random.default_rng(seed)
        self._body = np.array(make_body(obj).exterior.coords)[:-1]
        self._center_of_mass = hidden.center_of_mass(obj)
        self._seen = self.observe()

    @property
    def pose(self) -> Array | None:
        """(3,) q_W as it was last seen; None once the object has fallen."""
        return None if self.fallen else self._seen

    def observe(self, pose: Array | None = None) -> Array:
        """A pose (3,) with noise, m and rad; the present one where None."""
        seen: Array = (
            self.true_pose if pose is None else pose
        ) + self._std * self._rng.standard_normal(3)
        return seen

    def execute(self, push: Push) -> ObservedPush:
        """Pushes; what is seen is noisy, the motion is not."""
        times, begin = make_path_times(push, REGIME), self._seen
        poses, fell = self._move(push, times)
        steps = len(poses) - 1
        rows = np.unique(
            np.rint(np.linspace(0, steps, min(self._observations, steps) + 1)).astype(int)
        )[1:]
        self.fallen, self.true_pose = self.fallen or fell, poses[-1].copy()
        seen = np.array([self.observe(pose) for pose in poses[rows]]).reshape(-1, 3)
        self._seen = seen[-1] if len(seen) else self.observe()
        self.pushes += 1
        return ObservedPush(f"push_{self.pushes}", push, begin, times[rows], seen)

    def _move(self, push: Push, times: Array) -> tuple[Array, bool]:
        """The true poses (K, 3) at the first K times of a push, and whether the object falls at the last of them."""
        motion = simulate(self.obj, self.hidden, push, self.true_pose, times=times, regime=REGIME)
        return motion.poses, self._falls(motion.poses)

    def _falls(self, poses: Array) -> bool:
        if self.surface is None:
            return False
        rows = np.unique(np.linspace(0, len(poses) - 1, FALL_CHECKS).astype(int))
        return any(not self._is_supported(pose) for pose in poses[rows])

    def _is_supported(self, pose: Array) -> bool:
        assert self.surface is not None
        table = self.surface.polygon
        points = transform(pose[None], self._body)[0]
        if shapely.contains_xy(
            table, points[:, 0], points[:, 1]
        ).all() and table.convex_hull.equals(table):
            return True
        lying = shapely.intersection(table, shapely.Polygon(points))
        center = Point(transform(pose[None], self._center_of_mass[None])[0, 0])
        return (
            bool(MultiPoint(shapely.get_coordinates(lying)).convex_hull.covers(center))
            if lying.area > 0
            else False
        )


Learn = Callable[[GridObject, PushLog, Identification | None], Identification | None]
"""From an object, the pushes so far and what was learned before to what is learned; None where that
is nothing yet."""


@dataclass(frozen=True)
class Learner:
    """Learns after every push, beginning where it ended the last time."""

    memory: int = 8  # most pushes, the latest, that are learned from; the cost grows with them
    seed: int = 0  # of the identification

    def select(self, log: PushLog) -> PushLog:
        """The pushes that are learned from."""
        return log.subset([i for i, seen in enumerate(log) if len(seen.t_observed)][-self.memory :])

    def __call__(
        self, obj: GridObject, log: PushLog, before: Identification | None
    ) -> Identification | None:
        """What the pushes say; `before` where there is nothing new to learn from."""
        chosen = self.select(log)
        if not len(chosen) or chosen[-1] is not log[-1]:
            return before
        return identify(obj, chosen, seed=self.seed, regime="quasi_static", start=before)


@dataclass(frozen=True, eq=False)
class LoopRun(Generic[L]):
    """What came of stepping a loop to its end."""

    state: L  # the last one
    log: PushLog = field(default_factory=lambda: PushLog(()))  # the pushes that were made
    identification: Identification | None = (
        None  # what was learned from them; None where that is nothing
    )
    planning_seconds: float = 0.0  # wall-clock time of the loop's steps
    learning_seconds: float = 0.0  # wall-clock time


def run_loop(
    loop: ClosedLoop[L],
    obj: GridObject,
    world: PushWorld,
    is_over: Callable[[L], bool],
    *,
    learn: Learn | None = None,
    goal: Array | None = None,
    surface: SupportSurface | None = None,
    progress: Callable[[L, ObservedPush, bool], None] | None = None,
) -> LoopRun[L]:
    """Steps a loop in a world until it is over.

    Args:
        obj: the object, as whoever learns sees it.
        learn: learns after every push; None never.
        goal: (3,) that the loop is shown; none where None.
        surface: the table, as whoever learns knows it; None where pushes keep clear of its edge.
        progress: called after every push with the state that asked for it, what was seen, and
            whether it taught.
    """
    run = LoopRun(loop.begin(), PushLog((), table=None if surface is None else surface.corners))
    time, target = 0.0, UNSEEN if goal is None else goal
    while not is_over(run.state):
        time += loop.options.period
        pose, before = world.pose, run.state.push_id
        robot = PushStatus(command_id=before)
        begin = perf_counter()
        shown = Observation(
            time, UNSEEN if pose is None else pose, robot, run.log, run.identification, goal=target
        )
        state = loop.step(run.state, shown)
        run = replace(
            run, state=state, planning_seconds=run.planning_seconds + perf_counter() - begin
        )
        if state.push is None or state.push_id == before:
            continue
        seen = world.execute(state.push)
        begin = perf_counter()
        log = replace(run.log, pushes=(*run.log, seen))
        found = run.identification if learn is None else learn(obj, log, run.identification)
        learned = found is not run.identification
        seconds = run.learning_seconds + perf_counter() - begin
        run = replace(run, log=log, identification=found, learning_seconds=seconds)
        if progress is not None:
            progress(state, seen, learned)
    return run
