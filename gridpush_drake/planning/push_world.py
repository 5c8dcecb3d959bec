"""The world in which pushes are carried out: what a driver asks of it, and one made of the project's own simulator."""

from typing import Protocol

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray
from shapely import MultiPoint, Point

from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.simulate import Regime, simulate
from gridpush_drake.dynamics.time_grid import make_path_times
from gridpush_drake.errors import PlanningError
from gridpush_drake.grid.object import GridObject
from gridpush_drake.grid.parameters import CellParameters
from gridpush_drake.planning.push_constraints import make_body, place_points
from gridpush_drake.planning.surface import SupportSurface
from gridpush_drake.pushes.log import ObservedPush

Array = NDArray[np.float64]

OBSERVATIONS = 4
"""Poses that are seen during a push, after the first, its end among them."""

FALL_CHECKS = 40
"""Poses of a push at which it is looked whether the object falls."""


class PushWorld(Protocol):
    """Where an object lies and can be pushed: a simulation, or a station with a robot."""

    @property
    def pose(self) -> Array | None:
        """(3,) q_W of the object as it is seen now, m and rad; None while it is not seen, or has fallen."""
        ...

    def execute(self, push: Push) -> ObservedPush:
        """Carries out a push, and says what was seen of the object."""
        ...


class SimulatedWorld:
    """An object with hidden masses and frictions on a table, moved by `simulate`.

    The support presses as if there were no edge: an object that hangs over rubs like one that does not. It falls where
    its centre of mass leaves the convex hull of what lies on the table.

    Attributes:
        obj: the object.
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
        seed: int = 0,
        observations: int = OBSERVATIONS,
        regime: Regime = "quasi_static",
    ) -> None:
        """Puts the object down.

        Args:
            obj: the object.
            hidden: its true masses and frictions.
            pose: (3,) where it lies, m and rad.
            surface: the table; None for one without end.
            position_std: standard deviation of seen positions, per axis, m.
            angle_std: of seen angles, rad.
            seed: of the noise.
            observations: poses that are seen during a push, after the first.
            regime: of the simulation.

        Raises:
            PlanningError: a number is out of range.
        """
        if not (position_std >= 0 and angle_std >= 0 and observations >= 1):
            raise PlanningError("position_std and angle_std must be >= 0, and observations at least 1")
        self.obj, self.surface, self.fallen, self.pushes = obj, surface, False, 0
        self.true_pose = np.array(pose, dtype=np.float64)
        self._hidden, self._observations, self._regime = hidden, observations, regime
        self._std = np.array([position_std, position_std, angle_std])
        self._rng = np.random.default_rng(seed)
        self._body = np.array(make_body(obj).exterior.coords)[:-1]
        self._centre_of_mass = hidden.centre_of_mass(obj)
        self._seen = self._look(self.true_pose)

    @property
    def pose(self) -> Array | None:
        """(3,) q_W as it is seen; None once the object has fallen."""
        return None if self.fallen else self._seen

    def execute(self, push: Push) -> ObservedPush:
        """Pushes; what is seen is noisy, the motion is not."""
        times = make_path_times(push, self._regime)
        motion = simulate(self.obj, self._hidden, push, self.true_pose, times=times, regime=self._regime)
        steps = len(times) - 1
        rows = np.unique(np.rint(np.linspace(0, steps, min(self._observations, steps) + 1)).astype(int))[1:]
        begin = self._seen
        self.fallen = self.fallen or self._falls(motion.poses)
        self.true_pose = motion.final_pose.copy()
        seen = np.array([self._look(pose) for pose in motion.poses[rows]])
        self._seen = seen[-1]
        self.pushes += 1
        return ObservedPush(f"push_{self.pushes}", push, begin, times[rows], seen)

    def _look(self, pose: Array) -> Array:
        return pose + self._std * self._rng.standard_normal(3)

    def _falls(self, poses: Array) -> bool:
        if self.surface is None:
            return False
        rows = np.unique(np.linspace(0, len(poses) - 1, FALL_CHECKS).astype(int))
        return any(not self._is_supported(pose) for pose in poses[rows])

    def _is_supported(self, pose: Array) -> bool:
        assert self.surface is not None
        table = self.surface.polygon
        points = place_points(self._body, pose[None])[0]
        if shapely.contains_xy(table, points[:, 0], points[:, 1]).all() and table.convex_hull.equals(table):
            return True
        lying = shapely.intersection(table, shapely.Polygon(points))
        centre = Point(place_points(self._centre_of_mass[None], pose[None])[0, 0])
        return bool(MultiPoint(shapely.get_coordinates(lying)).convex_hull.covers(centre)) if lying.area > 0 else False
