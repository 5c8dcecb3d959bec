"""Worlds in which objects can be pushed: the one form that closed loops, benches and games use.

A `PushWorld` holds one object, or several. They can be put down at poses (`put`), they can be
pushed (`execute`), and they can be looked at (`observe`). In a `SteeredWorld` the finger can also
be moved bit by bit, with the object in motion between. What is true of them is in `truth`, which
only judges may read: whoever plans or learns sees poses with noise, as a camera or a tracker gives
them. Where there is one object its pose is (3,), and of N objects (N, 3). Whoever writes for any
number of them may put one down at (1, 3), and sees it so.

These are worlds:

    SimulatedWorld           here: the model's own quasi-static simulator, for any number of
                             objects; the finger of one can be steered
    EdgeWorld                `bench.pregrasp.world`: the same, with loads that shift at an edge
    MujocoWorld              `bench.truth.mujoco_world`: a rigid body on feet, in MuJoCo; its
                             pusher can be steered
    PlantWorld               `bench.worlds.plant`: a body in Drake's MultibodyPlant
    EnvironmentWorld         `gym.world`: an episode of a Gymnasium environment
    StationWorld             `station.simulated.world`: a robot in a simulated station

To write another one, derive from `TrackedWorld`, which adds the noise and the bookkeeping: what is
left is how the objects are put down and how a push moves them. `docs/extending.md` does it. How a
closed loop is stepped in a world is in `planning.loop_run`.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray
from shapely import MultiPoint, Point

from gridpush_drake.dynamics.bodies import Bodies
from gridpush_drake.dynamics.kernels.steering.finger_push import (
    STATE_SIZE,
    THETA,
    TIP_X,
    X,
    follow_tip,
)
from gridpush_drake.dynamics.one_object import refuse_several
from gridpush_drake.dynamics.physics import Regime
from gridpush_drake.dynamics.push import Push, make_path_times
from gridpush_drake.dynamics.pusher import PusherShape
from gridpush_drake.dynamics.scene.simulation import simulate_together
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import PlanningError
from gridpush_drake.geometry.se2 import Array, transform
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.edge_motion import simulate_near_edge
from gridpush_drake.planning.push_constraints import make_body
from gridpush_drake.planning.pushed_object import SearchModel, make_model
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.pushes.push_log import ObservedPush

OBSERVATION_COUNT = 4
"""Default number of poses that are seen during a push after the first one; the last of them is seen
at the push's end."""

FALL_CHECKS = 40
"""Number of poses of a push, evenly spaced, at which it is checked whether the object falls."""

FALLEN_TILT = np.radians(10)
"""Tilt from which a body in a world of three dimensions counts as fallen, rad."""

WORLD_REGIME: Regime = "quasi_static"
"""Regime in which `SimulatedWorld` moves its objects."""

STEERED_STEP = 0.0005
"""Length of a steered finger's path in a step, m: a fifth of what the search for its way takes."""

TRAVEL_SPEED = 0.25
"""Speed of the finger between two pushes, m/s."""

LIFT_TIME = 0.5
"""Time that the finger takes to be lifted, and again to come down, s."""


@dataclass(frozen=True, eq=False)
class WorldMotion:
    """How a push truly moved the objects.

    Attributes:
        times: (K,) s from the push's beginning, the first 0. The last is the push's duration, or an
            earlier time at which the only object fell.
        poses: (K, 3) q_WB = (x, y, theta) at these times, m and rad, theta continuous; (K, N, 3) of
            several objects. One of several that fell stays where it fell.
        fell: whether the object fell off the table, or over, by the last of these times; (N,) of
            several objects.
        tilt: (K,) angle of the body's z axis from the vertical, rad; None in a planar world.
        overhang: whether a part of an object hung over the table's edge at any of these times.
        force_t: (F,) times at which the finger's force was measured, from the push's beginning on
            and in order, s; None in a world that measures none.
        force: (F, 2) force of the finger on the object, W, N, as a sensor measures it, with its
            noise; None likewise. Learners take the friction's scale from it.

    Raises:
        PlanningError: the force's times or values are missing, or do not belong together.
    """

    times: Array
    poses: Array
    fell: bool | NDArray[np.bool_] = False
    tilt: Array | None = None
    overhang: bool = False
    force_t: Array | None = None
    force: Array | None = None

    def __post_init__(self) -> None:
        if (self.force_t is None) != (self.force is None):
            raise PlanningError("motion: force_t and force are given together, or neither")
        if self.force_t is None or self.force is None:
            return
        if np.shape(self.force) != (len(self.force_t), 2):
            raise PlanningError(
                f"motion: force is of shape {np.shape(self.force)}; expected "
                f"({len(self.force_t)}, 2), a force (N) for each time in force_t"
            )


@dataclass(frozen=True, eq=False)
class WorldTruth:
    """What is true of a world now. Judges may read it; whoever plans or learns must not.

    Attributes:
        pose: (3,) q_WB of the object without noise, m and rad, or (N, 3) of several; where one has
            fallen, its last one.
        fallen: whether the object has fallen off the table, or over; (N,) of several objects.
        stays: whether the objects, left alone, stay as they lie.
        tilt: angle of the body's z axis from the vertical, rad.
        bodies: the objects with their true masses and frictions; None where the world has none,
            because its object is not made of such cells.
        motion: how the last push moved the objects; None before the first push since they were put
            down.
    """

    pose: Array
    fallen: bool | NDArray[np.bool_] = False
    stays: bool = True
    tilt: float = 0.0
    bodies: Bodies | None = None
    motion: WorldMotion | None = None


@runtime_checkable
class PushWorld(Protocol):
    """A world with one object, or several, that can be put down, pushed, looked at, and judged.

    A pose is (3,) q_WB = (x, y, theta) of the object's body frame in the world frame, m and rad;
    (N, 3) of several objects.
    """

    def put(self, pose: ArrayLike) -> None:
        """Puts the objects down at rest at a pose, m and rad.

        They need not have been there before: an object that has fallen lies on the table again.
        """
        ...

    def execute(self, push: Push) -> ObservedPush:
        """Carries out a push from where the objects lie, and lets them come to rest.

        Args:
            push: the path of a disc in the world frame, m and s.

        Returns:
            What was seen of the objects: their pose when the push began, and poses during it, all
            with noise. There are no later poses where the object was not seen any more.

        Raises:
            PushRefusedError: a robot makes the pushes of this world, and does not make this one.
        """
        ...

    def observe(self) -> Array | None:
        """Looks at the objects: q_WB with noise, m and rad; None while one of them is not seen.

        An object that has fallen is not seen.
        """
        ...

    @property
    def truth(self) -> WorldTruth:
        """What is true of the objects now, for judges only."""
        ...


@runtime_checkable
class SteeredWorld(PushWorld, Protocol):
    """A world in which the finger can be moved bit by bit, too, as a controller steers it."""

    def steer(
        self,
        begin: Array,
        end: Array,
        duration: float,
        radius: float,
        shape: PusherShape | None = None,
    ) -> None:
        """Moves a finger evenly between two places, and the object as far as it is touched.

        The object keeps the motion that it has: the next piece goes on where this one ends.

        Args:
            begin: (2,) where the finger's center is, W, m; (3,) with its angle, rad, of a shape.
            end: where it is to be, likewise.
            duration: time for this, s.
            radius: of the finger, or of the shape's round corners, m.
            shape: of a finger that is no disc.
        """
        ...


class WorldMaker(Protocol):
    """How benches make a world: a class whose constructor takes these arguments.

    `bench.worlds.by_name` finds one by its name.
    """

    def __call__(
        self,
        bodies: Bodies,
        pose: ArrayLike,
        surface: SupportSurface | None = None,
        *,
        position_std: float = 0.0,
        angle_std: float = 0.0,
        seed: int | np.random.Generator = 0,
    ) -> PushWorld:
        """Makes a world in which an object lies at rest.

        Args:
            bodies: the object with its true masses and frictions, which are hidden from whoever
                learns.
            pose: (3,) where it lies, m and rad.
            surface: the table; None for one without end.
            position_std: standard deviation of seen positions, per axis, m.
            angle_std: standard deviation of seen angles, rad.
            seed: seed of the noise, or the generator that draws it.
        """
        ...


class TrackedWorld(ABC):
    """A `PushWorld` but for how its objects move: it adds noise, and keeps what was seen last.

    A world derives from it and says in `do_put` how its objects are put down, and in `do_push` how
    a push moves them. A constructor sets what these two need before it calls this class's.

    Attributes:
        pushes: number of pushes that were made.
        bodies: the objects with their true masses and frictions, for `truth`; None where there are
            none.
    """

    bodies: Bodies | None = None

    def __init__(
        self,
        pose: ArrayLike,
        *,
        position_std: float = 0.0,
        angle_std: float = 0.0,
        seed: int | np.random.Generator = 0,
        observations: int = OBSERVATION_COUNT,
        observes_anew: bool = False,
    ) -> None:
        """Puts the objects down.

        Args:
            pose: (3,) where the object lies, m and rad; (N, 3) of several.
            position_std: standard deviation of seen positions, per axis, m.
            angle_std: standard deviation of seen angles, rad.
            seed: seed of the noise, or the generator that draws it.
            observations: number of poses that are seen during a push after the first one.
            observes_anew: whether `observe` draws new noise every time. Otherwise it gives the pose
                that was seen last, which is when the last push ended.

        Raises:
            PlanningError: a number is out of range.
        """
        if not (position_std >= 0 and angle_std >= 0 and observations >= 1):
            raise PlanningError(
                "position_std and angle_std must be >= 0, and observations at least 1"
            )
        self.pushes = 0
        self._std = np.array([position_std, position_std, angle_std])
        self._rng = np.random.default_rng(seed)
        self._observations = observations
        self._observes_anew = observes_anew
        self._time = 0.0
        self._tip: Array | None = None
        self.put(pose)

    @abstractmethod
    def do_put(self, pose: Array) -> Array:
        """Puts the objects down at a pose, m and rad; returns the pose in which they rest."""

    @abstractmethod
    def do_push(self, push: Push, pose: Array) -> WorldMotion:
        """Pushes the objects, which lie at a pose, and lets them come to rest.

        Those of several that have fallen before (`fallen`) touch nothing.

        Returns:
            The true motion; its last pose is where the objects lie afterwards.
        """

    @property
    def time(self) -> float:
        """Time that pushes and a finger's ways between them would have taken, s."""
        return self._time

    @property
    def fallen(self) -> NDArray[np.bool_]:
        """Whether the object has fallen, () or (N,), for `do_push`."""
        return self._fallen

    def put(self, pose: ArrayLike) -> None:
        """Puts the objects down at rest at a pose, m and rad, and looks at them.

        Raises:
            PlanningError: the pose is not three finite numbers for each object.
        """
        q = np.array(pose, dtype=np.float64)
        n = 1 if self.bodies is None else len(self.bodies)
        known = ((n, 3), (3,)) if n == 1 else ((n, 3),)
        if q.shape not in known or not np.isfinite(q).all():
            form = "three finite numbers" if n == 1 else f"({n}, 3) finite numbers"
            raise PlanningError(f"pose is {pose!r}; expected {form} (m and rad)")
        self._fallen = np.zeros(q.shape[:-1], dtype=bool)
        self._motion: WorldMotion | None = None
        self._pose = self.do_put(q)
        self._seen = self._add_noise(self._pose)

    def execute(self, push: Push) -> ObservedPush:
        """Carries out a push; see `PushWorld.execute`."""
        begin = self._seen
        motion = self.do_push(push, self._pose)
        self._motion = motion
        self._fallen = self._fallen | motion.fell
        self._pose = motion.poses[-1].copy()
        self.pushes += 1
        # The finger is lifted, goes to where the push begins, and comes down.
        way = 0.0 if self._tip is None else float(np.linalg.norm(push.start - self._tip))
        self._time += way / TRAVEL_SPEED + 2 * LIFT_TIME + push.duration
        self._tip = push.xy[-1]

        # The poses that are seen are evenly spaced among those of the motion. Where there are fewer
        # of these, all are seen; where the object fell at once, none is.
        steps = len(motion.poses) - 1
        even = np.linspace(0, steps, min(self._observations, steps) + 1)
        rows = np.unique(np.rint(even).astype(int))[1:]
        seen = self._add_noise(motion.poses[rows])
        self._seen = seen[-1].copy() if len(seen) else self._add_noise(self._pose)
        return ObservedPush(
            name=f"push_{self.pushes}",
            push=push,
            pose=begin,
            t_observed=motion.times[rows],
            poses_observed=seen,
            overhang=motion.overhang,
            force_t=motion.force_t,
            force=motion.force,
        )

    def observe(self) -> Array | None:
        """Looks at the objects: q_WB with noise, m and rad; None once one has fallen."""
        if self._fallen.any():
            return None
        if self._observes_anew:
            self._seen = self._add_noise(self._pose)
        return self._seen.copy()

    @property
    def truth(self) -> WorldTruth:
        """What is true of the objects now, for judges only."""
        fallen = self._fallen.copy() if self._fallen.ndim else bool(self._fallen)
        return WorldTruth(
            pose=self._pose.copy(),
            fallen=fallen,
            stays=not self._fallen.any(),
            bodies=self.bodies,
            motion=self._motion,
        )

    def _add_noise(self, pose: Array) -> Array:
        """Draws poses (..., 3) as they are seen, m and rad."""
        return np.asarray(pose + self._std * self._rng.standard_normal(np.shape(pose)))


class SimulatedWorld(TrackedWorld):
    """Objects with hidden masses and frictions on a table, moved by `simulate`.

    An object falls where its center of mass leaves the convex hull of what lies on the table.

    The support presses as if there were no edge: an object that hangs over it rubs like one that
    does not. `bench.pregrasp.world.EdgeWorld` is the world in which loads shift at the edge; so
    they do here where one of several objects is pushed alone, with a part over the edge
    (`planning.edge_motion.simulate_near_edge`).

    Attributes:
        bodies: the objects with their true masses and frictions.
        surface: the table; None for one without end.
    """

    bodies: Bodies

    def __init__(
        self,
        bodies: Bodies,
        pose: ArrayLike,
        surface: SupportSurface | None = None,
        *,
        position_std: float = 0.0,
        angle_std: float = 0.0,
        seed: int | np.random.Generator = 0,
        observations: int = OBSERVATION_COUNT,
    ) -> None:
        """Puts objects down; the arguments are those of `WorldMaker` and `TrackedWorld`.

        Raises:
            PlanningError: a number is out of range.
        """
        self.bodies = bodies
        self.surface = surface
        # Of a finger that is steered: its models by their radius, and what the last piece left.
        self._models: dict[float | PusherShape, SearchModel] = {}
        self._state = np.zeros(STATE_SIZE)
        self._supports = [
            None if surface is None else CenterOfMassSupport(obj, center, surface)
            for obj, center in zip(
                bodies.objects, np.atleast_2d(bodies.center_of_mass), strict=True
            )
        ]
        super().__init__(
            pose,
            position_std=position_std,
            angle_std=angle_std,
            seed=seed,
            observations=observations,
        )

    def do_put(self, pose: Array) -> Array:
        """Returns the pose itself: an object rests wherever it lies."""
        self._state[:] = 0.0
        return pose

    def do_push(self, push: Push, pose: Array) -> WorldMotion:
        """Simulates a push of the objects that have not fallen, from a pose, m and rad."""
        self._state[:] = 0.0
        times = make_path_times(push, WORLD_REGIME)
        if pose.ndim == 1:
            motion = simulate(self.bodies, push, pose, times=times, regime=WORLD_REGIME)
            support = self._supports[0]
            fell = support is not None and support.falls(motion.poses)
            return WorldMotion(times=times, poses=motion.poses, fell=fell)
        # What has fallen stays where it fell; the rest is simulated.
        poses = np.repeat(pose[None], len(times), axis=0)
        lying = np.flatnonzero(~self.fallen).tolist()
        if lying:
            part = self.bodies.take(lying)
            poses[:, lying] = simulate_together(part, push, pose[lying], times=times).poses
        fell_now = self.fallen | self._shift_loads(push, poses)
        for b, support in enumerate(self._supports):
            if support is not None and not fell_now[b]:
                fell_now[b] = support.falls(poses[:, b])
        return WorldMotion(times=times, poses=poses, fell=fell_now)

    def steer(
        self,
        begin: Array,
        end: Array,
        duration: float,
        radius: float,
        shape: PusherShape | None = None,
    ) -> None:
        """Moves a finger that pushes the only object; see `SteeredWorld.steer`.

        The motion is quasi-static, and the table has no edge.

        Raises:
            PlanningError: there are several objects.
        """
        refuse_several(PlanningError, "steer", len(self.bodies) > 1)
        finger = radius if shape is None else shape
        model = self._models.get(finger)
        if model is None:
            obj, params, physics = self.bodies.obj, self.bodies.params, self.bodies.physics
            model = make_model(obj, params, radius, physics, shape=shape, approximate=False)
            model = self._models[finger] = model._replace(step=STEERED_STEP)
        state = self._state
        state[X : THETA + 1] = self._pose
        state[TIP_X : TIP_X + len(begin)] = begin
        follow_tip(model, state, end[None])
        self._pose = state[X : THETA + 1].copy()

    def _shift_loads(self, push: Push, poses: Array) -> NDArray[np.bool_]:
        """Simulates a motion (T+1, N, 3) anew where one object alone moved over the edge.

        Returns:
            (N,) which objects fell in it.
        """
        fell = np.zeros(len(self.bodies), dtype=bool)
        moving = np.flatnonzero((poses[-1] != poses[0]).any(axis=1))
        # Under another shape than a disc no loads shift.
        if self.surface is None or len(moving) != 1 or push.shape is not None:
            return fell
        b = int(moving[0])
        ends = (poses[0, b], poses[-1, b])
        if all(self.surface.contains_cells(self.bodies.objects[b], pose) for pose in ends):
            return fell
        motion = simulate_near_edge(self.bodies.take([b]), push, poses[0, b], self.surface)
        # After a fall it stays where it fell.
        poses[: len(motion.poses), b] = motion.poses
        poses[len(motion.poses) :, b] = motion.poses[-1]
        fell[b] = motion.fell
        return fell


class CenterOfMassSupport:
    """Where an object falls off a table: its center of mass leaves the hull of what lies on it."""

    def __init__(self, obj: GridObject, center_of_mass: Array, surface: SupportSurface) -> None:
        """Takes an object, its true center of mass p_BBcm (2,), m, and the table."""
        self._table = surface.polygon
        self._is_convex = self._table.convex_hull.equals(self._table)
        self._body = np.array(make_body(obj).exterior.coords)[:-1]
        self._center_of_mass = center_of_mass

    def falls(self, poses: Array) -> bool:
        """Says whether the object falls at any of at most FALL_CHECKS of the poses (K, 3)."""
        rows = np.unique(np.linspace(0, len(poses) - 1, FALL_CHECKS).astype(int))
        return any(not self._is_supported(pose) for pose in poses[rows])

    def _is_supported(self, pose: Array) -> bool:
        # Most often the whole body lies on a convex table, which is quick to see.
        points = transform(pose[None], self._body)[0]
        inside = shapely.contains_xy(self._table, points[:, 0], points[:, 1])
        if inside.all() and self._is_convex:
            return True
        lying = shapely.intersection(self._table, shapely.Polygon(points))
        if not lying.area > 0:
            return False
        hull = MultiPoint(shapely.get_coordinates(lying)).convex_hull
        center = Point(transform(pose[None], self._center_of_mass[None])[0, 0])
        return bool(hull.covers(center))
