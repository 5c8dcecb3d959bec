"""Worlds with several objects on a table, as loops, benches and games use them.

`SimulatedSceneWorld` is to scenes what `planning.world.SimulatedWorld` is to one object: whoever
plans or learns sees poses with noise, and only judges read `truth`. To write another one, derive
from `TrackedSceneWorld`, which adds the noise and the bookkeeping, and say how a push moves the
objects. It also keeps the time that a finger would take, which is lifted between pushes and travels
over the objects.

In `SimulatedSceneWorld` an object falls where its center of mass leaves the convex hull of what
lies on the table. If it is pushed alone, with a part over the edge, its loads shift as they do
there (`planning.pregrasp.edge_motion.simulate_near_edge`); where objects push each other, the
support presses as if there were no edge. A fallen object is not seen any more, and touches nothing.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.dynamics.push import Push, make_path_times
from gridpush_drake.dynamics.scene.bodies import Scene, SceneBody
from gridpush_drake.dynamics.scene.simulation import simulate_scene
from gridpush_drake.errors import PlanningError, require_positive
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.model import Model
from gridpush_drake.planning.pregrasp.edge_motion import simulate_near_edge
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.planning.world import OBSERVATIONS, REGIME, CenterOfMassSupport
from gridpush_drake.pushes.scene_log import ObservedScenePush

TRAVEL_SPEED = 0.25
"""Speed of the finger between two pushes, m/s."""

LIFT_TIME = 0.5
"""Time that the finger takes to be lifted, and again to come down, s."""


@dataclass(frozen=True, eq=False)
class SceneTruth:
    """What is true of a scene now. Judges may read it; whoever plans or learns must not.

    Attributes:
        scene: the objects with their true masses and frictions, where they truly lie; a fallen one
            where it fell.
        fallen: (N,) whether each object has fallen off the table.
    """

    scene: Scene
    fallen: tuple[bool, ...]

    @property
    def poses(self) -> Array:
        """(N, 3) where the objects truly lie, m and rad."""
        return self.scene.poses


@runtime_checkable
class SceneWorld(Protocol):
    """A world with several objects that can be pushed, looked at, and judged."""

    def execute(self, push: Push) -> ObservedScenePush:
        """Carries out a push, and lets the objects come to rest.

        Returns:
            What was seen: all poses when the push began, and poses during it, all with noise.

        Raises:
            PushRefusedError: a robot makes the pushes of this world, and does not make this one.
        """
        ...

    def observe(self) -> Array | None:
        """Looks at the objects: (N, 3) q_WB with noise, m and rad; None once one has fallen."""
        ...

    @property
    def time(self) -> float:
        """Time that has passed in the world, s."""
        ...

    @property
    def truth(self) -> SceneTruth:
        """What is true of the objects now, for judges only."""
        ...


@dataclass(frozen=True, eq=False)
class SceneMotion:
    """How a push truly moved the objects of a scene.

    Attributes:
        times: (K,) s from the push's beginning, the first 0, the last the push's duration.
        poses: (K, N, 3) q_WB = (x, y, theta) at these times, m and rad, theta continuous; a fallen
            object stays where it fell.
        fallen: (N,) whether each object has fallen by the last of these times.
    """

    times: Array
    poses: Array
    fallen: NDArray[np.bool_]


class TrackedSceneWorld(ABC):
    """A `SceneWorld` but for how its objects move: it adds noise, and keeps what was seen last.

    A world derives from it and says in `do_push` how a push moves the objects. A constructor sets
    what that needs before or after it calls this class's.

    Attributes:
        pushes: number of pushes that were made.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        position_std: float = 0.0,
        angle_std: float = 0.0,
        seed: int | np.random.Generator = 0,
        observations: int = OBSERVATIONS,
        travel_speed: float = TRAVEL_SPEED,
        lift_time: float = LIFT_TIME,
    ) -> None:
        """Looks at the objects where a scene has them.

        Args:
            scene: the objects with their true masses and frictions.
            position_std: standard deviation of seen positions, per axis, m.
            angle_std: standard deviation of seen angles, rad.
            seed: seed of the noise, or the generator that draws it.
            observations: number of poses of each object that are seen during a push after the first
                one, at most.
            travel_speed: speed of the finger between pushes, m/s.
            lift_time: time that lifting the finger takes, and again lowering it, s.

        Raises:
            PlanningError: a number is out of range.
        """
        if not (position_std >= 0 and angle_std >= 0 and observations >= 1):
            raise PlanningError(
                "position_std and angle_std must be >= 0, and observations at least 1"
            )
        require_positive(PlanningError, travel_speed=travel_speed, lift_time=lift_time)
        self.pushes = 0
        self._scene = scene
        self._fallen = np.zeros(len(scene), dtype=bool)
        self._std = np.array([position_std, position_std, angle_std])
        self._rng = np.random.default_rng(seed)
        self._observations = observations
        self._travel_speed = travel_speed
        self._lift_time = lift_time
        self._time = 0.0
        self._tip: Array | None = None
        self._seen = self._add_noise(scene.poses)

    @abstractmethod
    def do_push(self, push: Push, scene: Scene, fallen: NDArray[np.bool_]) -> SceneMotion:
        """Pushes the objects, and lets them come to rest.

        Args:
            push: the path of a disc in the world frame, m and s.
            scene: the objects, where they lie.
            fallen: (N,) whether each of them has fallen before; it then touches nothing.

        Returns:
            The true motion; its last poses are where the objects lie afterwards.
        """

    @property
    def time(self) -> float:
        """Time that pushes and the finger's ways between them have taken, s."""
        return self._time

    @property
    def truth(self) -> SceneTruth:
        """What is true of the objects now, for judges only."""
        return SceneTruth(self._scene, tuple(self._fallen.tolist()))

    def observe(self) -> Array | None:
        """The poses (N, 3) that were seen last, m and rad; None once an object has fallen."""
        return None if self._fallen.any() else self._seen.copy()

    def execute(self, push: Push) -> ObservedScenePush:
        """Carries out a push; see `SceneWorld.execute`.

        An object that falls is left out of the world from then on; its poses as they were seen end
        where it fell.
        """
        begin = self._seen
        motion = self.do_push(push, self._scene, self._fallen.copy())
        self._fallen = self._fallen | motion.fallen
        self._scene = self._scene.with_poses(motion.poses[-1], may_overlap=True)
        self._spend(push)
        self.pushes += 1

        # Poses are seen evenly spaced in time, the last at the end.
        steps = len(motion.times) - 1
        even = np.linspace(0, steps, min(self._observations, steps) + 1)
        rows = np.unique(np.rint(even).astype(int))[1:]
        seen = self._add_noise(motion.poses[rows])
        self._seen = seen[-1].copy()
        return ObservedScenePush(
            name=f"push_{self.pushes}",
            push=push,
            poses=begin,
            t_observed=motion.times[rows],
            poses_observed=seen,
        )

    def _spend(self, push: Push) -> None:
        """Adds the time of a push, and of the finger's way to where it begins."""
        way = 0.0 if self._tip is None else float(np.linalg.norm(push.start - self._tip))
        self._time += way / self._travel_speed + 2 * self._lift_time + push.duration
        self._tip = push.xy[-1]

    def _add_noise(self, poses: Array) -> Array:
        """Draws poses (..., 3) as they are seen, m and rad."""
        return np.asarray(poses + self._std * self._rng.standard_normal(np.shape(poses)))


class SimulatedSceneWorld(TrackedSceneWorld):
    """Objects with hidden masses and frictions on a table, moved by `simulate_scene`.

    Attributes:
        surface: the table; None for one without end.
    """

    def __init__(
        self,
        scene: Scene,
        surface: SupportSurface | None = None,
        *,
        position_std: float = 0.0,
        angle_std: float = 0.0,
        seed: int | np.random.Generator = 0,
        observations: int = OBSERVATIONS,
        travel_speed: float = TRAVEL_SPEED,
        lift_time: float = LIFT_TIME,
    ) -> None:
        """Puts the objects down where a scene has them.

        Args:
            scene: the objects with their true masses and frictions.
            surface: the table; None for one without end.
            position_std: see `TrackedSceneWorld`, as all that follows.
            angle_std: standard deviation of seen angles, rad.
            seed: seed of the noise, or the generator that draws it.
            observations: number of poses that are seen during a push, at most.
            travel_speed: speed of the finger between pushes, m/s.
            lift_time: time that lifting the finger takes, and again lowering it, s.

        Raises:
            PlanningError: a number is out of range.
        """
        self.surface = surface
        self._supports = [
            None if surface is None else CenterOfMassSupport(obj, params, surface)
            for obj, params in zip(scene.objects, scene.params, strict=True)
        ]
        super().__init__(
            scene,
            position_std=position_std,
            angle_std=angle_std,
            seed=seed,
            observations=observations,
            travel_speed=travel_speed,
            lift_time=lift_time,
        )

    def do_push(self, push: Push, scene: Scene, fallen: NDArray[np.bool_]) -> SceneMotion:
        """Simulates a push of the objects that have not fallen."""
        # What has fallen stays where it fell; the rest is simulated.
        times = make_path_times(push, REGIME)
        poses = np.repeat(scene.poses[None], len(times), axis=0)
        lying = np.flatnonzero(~fallen)
        if len(lying):
            bodies = [SceneBody(scene.objects[b], scene.params[b], scene.poses[b]) for b in lying]
            friction = scene.pair_friction[np.ix_(lying, lying)]
            part = Scene(bodies, friction, may_overlap=True)
            poses[:, lying] = simulate_scene(part, push, times=times).poses
        falls = fallen | self._shift_loads(push, scene, poses)
        for b, support in enumerate(self._supports):
            if support is not None and not falls[b]:
                falls[b] = support.falls(poses[:, b])
        return SceneMotion(times=times, poses=poses, fallen=falls)

    def _shift_loads(self, push: Push, scene: Scene, poses: Array) -> NDArray[np.bool_]:
        """Simulates a motion (T+1, N, 3) anew where one object alone moved over the edge.

        Returns:
            (N,) which objects fell in it.
        """
        fell = np.zeros(len(scene), dtype=bool)
        moving = np.flatnonzero((poses[-1] != poses[0]).any(axis=1))
        if self.surface is None or len(moving) != 1:
            return fell
        b = int(moving[0])
        obj = scene.objects[b]
        if self.surface.contains_cells(obj, poses[0, b]) and self.surface.contains_cells(
            obj, poses[-1, b]
        ):
            return fell
        motion = simulate_near_edge(Model(obj, scene.params[b]), push, poses[0, b], self.surface)
        # After a fall it stays where it fell.
        poses[: len(motion.poses), b] = motion.poses
        poses[len(motion.poses) :, b] = motion.poses[-1]
        fell[b] = motion.fell
        return fell
