"""Worlds in which an object can be pushed: the one form that closed loops, benches and games use.

A `PushWorld` holds one object. It can be put down at a pose (`put`), it can be pushed (`execute`),
and it can be looked at (`observe`). What is true of it is in `truth`, which only judges may read:
whoever plans or learns sees poses with noise, as a camera or a tracker gives them.

These are worlds:

    SimulatedWorld           here: the model's own quasi-static simulator
    EdgeWorld                `bench.pregrasp.world`: the same, with loads that shift at an edge
    MujocoWorld              `bench.truth.mujoco_world`: a rigid body on feet, in MuJoCo
    PlantWorld               `bench.plant`: a body in Drake's MultibodyPlant
    EnvironmentWorld         `gym.world`: an episode of a Gymnasium environment
    StationWorld             `station.world`: a robot in a simulated station

To write another one, derive from `TrackedWorld`, which adds the noise and the bookkeeping: what is
left is how the object is put down and how a push moves it. `docs/extending.md` does it. How a
closed loop is stepped in a world is in `planning.loop_run`.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
import shapely
from numpy.typing import ArrayLike
from shapely import MultiPoint, Point

from gridpush_drake.dynamics.physics import Regime
from gridpush_drake.dynamics.push import Push, make_path_times
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import PlanningError
from gridpush_drake.geometry.se2 import Array, check_vector, transform
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.push_constraints import make_body
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.pushes.push_log import ObservedPush

OBSERVATIONS = 4
"""Default number of poses that are seen during a push after the first one; the last of them is seen
at the push's end."""

FALL_CHECKS = 40
"""Number of poses of a push, evenly spaced, at which it is checked whether the object falls."""

FALLEN_TILT = np.radians(10)
"""Tilt from which a body in a world of three dimensions counts as fallen, rad."""

REGIME: Regime = "quasi_static"
"""Regime in which `SimulatedWorld` moves its object."""


@dataclass(frozen=True, eq=False)
class WorldMotion:
    """How a push truly moved an object.

    Attributes:
        times: (K,) s from the push's beginning, the first 0. The last is the push's duration, or an
            earlier time at which the object fell.
        poses: (K, 3) q_WB = (x, y, theta) at these times, m and rad, theta continuous.
        fell: whether the object fell off the table, or over, by the last of these times.
        tilt: (K,) angle of the body's z axis from the vertical, rad; None in a planar world.
        overhang: whether a part of the object hung over the table's edge at any of these times.
        force_t: (F,) times at which the finger's force was measured, from the push's beginning on
            and in order, s; None in a world that measures none.
        force: (F, 2) force of the finger on the object, W, N, as a sensor measures it, with its
            noise; None likewise. Learners take the friction's scale from it.

    Raises:
        PlanningError: the force's times or values are missing, or do not belong together.
    """

    times: Array
    poses: Array
    fell: bool = False
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
        pose: (3,) q_WB of the object without noise, m and rad; the last one where it has fallen.
        fallen: whether the object has fallen off the table, or over.
        stays: whether the object, left alone, stays as it lies.
        tilt: angle of the body's z axis from the vertical, rad.
        params: the cells' true masses and frictions; None where the world has none, because its
            object is not made of such cells.
        motion: how the last push moved the object; None before the first push since it was put
            down.
    """

    pose: Array
    fallen: bool = False
    stays: bool = True
    tilt: float = 0.0
    params: CellParameters | None = None
    motion: WorldMotion | None = None


@runtime_checkable
class PushWorld(Protocol):
    """A world with one object that can be put down, pushed, looked at, and judged.

    Poses are (3,) q_WB = (x, y, theta) of the object's body frame in the world frame, m and rad.
    """

    def put(self, pose: ArrayLike) -> None:
        """Puts the object down at rest at a pose (3,), m and rad.

        It need not have been there before: an object that has fallen lies on the table again.
        """
        ...

    def execute(self, push: Push) -> ObservedPush:
        """Carries out a push from where the object lies, and lets the object come to rest.

        Args:
            push: the path of a disc in the world frame, m and s.

        Returns:
            What was seen of the object: its pose when the push began, and poses during it, all with
            noise. There are no later poses where the object was not seen any more.

        Raises:
            PushRefusedError: a robot makes the pushes of this world, and does not make this one.
        """
        ...

    def observe(self) -> Array | None:
        """Looks at the object: (3,) q_WB with noise, m and rad; None while it is not seen.

        An object that has fallen is not seen.
        """
        ...

    @property
    def truth(self) -> WorldTruth:
        """What is true of the object now, for judges only."""
        ...


class WorldMaker(Protocol):
    """How benches make a world: a class whose constructor takes these arguments.

    `bench.worlds` finds one by its name.
    """

    def __call__(
        self,
        obj: GridObject,
        params: CellParameters,
        pose: ArrayLike,
        surface: SupportSurface | None = None,
        *,
        position_std: float = 0.0,
        angle_std: float = 0.0,
        seed: int | np.random.Generator = 0,
    ) -> PushWorld:
        """Makes a world in which an object lies at rest.

        Args:
            obj: the object.
            params: its true masses and frictions, which are hidden from whoever learns.
            pose: (3,) where it lies, m and rad.
            surface: the table; None for one without end.
            position_std: standard deviation of seen positions, per axis, m.
            angle_std: standard deviation of seen angles, rad.
            seed: seed of the noise, or the generator that draws it.
        """
        ...


class TrackedWorld(ABC):
    """A `PushWorld` but for how its object moves: it adds noise, and keeps what was seen last.

    A world derives from it and says in `do_put` how its object is put down, and in `do_push` how a
    push moves it. A constructor sets what these two need before it calls this class's.

    Attributes:
        pushes: number of pushes that were made.
        params: the cells' true masses and frictions, for `truth`; None where there are none.
    """

    params: CellParameters | None = None

    def __init__(
        self,
        pose: ArrayLike,
        *,
        position_std: float = 0.0,
        angle_std: float = 0.0,
        seed: int | np.random.Generator = 0,
        observations: int = OBSERVATIONS,
        looks_anew: bool = False,
    ) -> None:
        """Puts the object down.

        Args:
            pose: (3,) where it lies, m and rad.
            position_std: standard deviation of seen positions, per axis, m.
            angle_std: standard deviation of seen angles, rad.
            seed: seed of the noise, or the generator that draws it.
            observations: number of poses that are seen during a push after the first one.
            looks_anew: whether `observe` draws new noise every time. Otherwise it gives the pose
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
        self._looks_anew = looks_anew
        self.put(pose)

    @abstractmethod
    def do_put(self, pose: Array) -> Array:
        """Puts the object down at a pose (3,), m and rad; returns the pose in which it rests."""

    @abstractmethod
    def do_push(self, push: Push, pose: Array) -> WorldMotion:
        """Pushes the object, which lies at a pose (3,), and lets it come to rest.

        Returns:
            The true motion; its last pose is where the object lies afterwards.
        """

    def put(self, pose: ArrayLike) -> None:
        """Puts the object down at rest at a pose (3,), m and rad, and looks at it.

        Raises:
            PlanningError: the pose is not three finite numbers.
        """
        self._fallen = False
        self._motion: WorldMotion | None = None
        self._pose = self.do_put(check_vector(PlanningError, "pose", pose, 3))
        self._seen = self._add_noise(self._pose)

    def execute(self, push: Push) -> ObservedPush:
        """Carries out a push; see `PushWorld.execute`."""
        begin = self._seen
        motion = self.do_push(push, self._pose)
        self._motion = motion
        self._fallen = self._fallen or motion.fell
        self._pose = motion.poses[-1].copy()
        self.pushes += 1

        # The poses that are seen are evenly spaced among those of the motion. Where there are fewer
        # of these, all are seen; where the object fell at once, none is.
        steps = len(motion.poses) - 1
        even = np.linspace(0, steps, min(self._observations, steps) + 1)
        rows = np.unique(np.rint(even).astype(int))[1:]
        seen = np.array([self._add_noise(pose) for pose in motion.poses[rows]]).reshape(-1, 3)
        self._seen = seen[-1] if len(seen) else self._add_noise(self._pose)
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
        """Looks at the object: (3,) q_WB with noise, m and rad; None once it has fallen."""
        if self._fallen:
            return None
        if self._looks_anew:
            self._seen = self._add_noise(self._pose)
        return self._seen

    @property
    def truth(self) -> WorldTruth:
        """What is true of the object now, for judges only."""
        return WorldTruth(
            pose=self._pose.copy(),
            fallen=self._fallen,
            stays=not self._fallen,
            params=self.params,
            motion=self._motion,
        )

    def _add_noise(self, pose: Array) -> Array:
        """Draws a pose (3,) as it is seen, m and rad."""
        seen: Array = pose + self._std * self._rng.standard_normal(3)
        return seen


class SimulatedWorld(TrackedWorld):
    """An object with hidden masses and frictions on a table, moved by `simulate`.

    The support presses as if there were no edge: an object that hangs over it rubs like one that
    does not. It falls where its center of mass leaves the convex hull of what lies on the table.
    `bench.pregrasp.world.EdgeWorld` is the world in which loads shift at the edge.

    Attributes:
        obj: the object.
        params: its true masses and frictions.
        surface: the table; None for one without end.
    """

    params: CellParameters

    def __init__(
        self,
        obj: GridObject,
        params: CellParameters,
        pose: ArrayLike,
        surface: SupportSurface | None = None,
        *,
        position_std: float = 0.0,
        angle_std: float = 0.0,
        seed: int | np.random.Generator = 0,
        observations: int = OBSERVATIONS,
    ) -> None:
        """Puts an object down; the arguments are those of `WorldMaker` and `TrackedWorld`.

        Raises:
            PlanningError: a number is out of range.
        """
        self.obj = obj
        self.params = params
        self.surface = surface
        self._support = None if surface is None else CenterOfMassSupport(obj, params, surface)
        super().__init__(
            pose,
            position_std=position_std,
            angle_std=angle_std,
            seed=seed,
            observations=observations,
        )

    def do_put(self, pose: Array) -> Array:
        """Returns the pose (3,) itself: the object rests wherever it lies."""
        return pose

    def do_push(self, push: Push, pose: Array) -> WorldMotion:
        """Simulates a push of the object from a pose (3,), m and rad."""
        times = make_path_times(push, REGIME)
        motion = simulate(Model(self.obj, self.params), push, pose, times=times, regime=REGIME)
        fell = self._support is not None and self._support.falls(motion.poses)
        return WorldMotion(times=times, poses=motion.poses, fell=fell)


class CenterOfMassSupport:
    """Where an object falls off a table: its center of mass leaves the hull of what lies on it."""

    def __init__(self, obj: GridObject, params: CellParameters, surface: SupportSurface) -> None:
        """Takes an object, its true masses, and the table."""
        self._table = surface.polygon
        self._is_convex = self._table.convex_hull.equals(self._table)
        self._body = np.array(make_body(obj).exterior.coords)[:-1]
        self._center_of_mass = params.center_of_mass(obj)

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
