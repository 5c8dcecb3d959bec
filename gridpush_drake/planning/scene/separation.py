"""`separate`: objects that touch are pushed until each has room around it.

Pushes are drawn at random along all outlines and simulated by `simulate_scene` with what is
believed of the objects; the best one is made, the objects are seen again, and so on. A push may
move several objects: that is weighed by where all of them end, and not forbidden.

The planner knows no table edge and no arm: the pusher comes from above, wherever it fits beside
every object.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from shapely import Point

from gridpush_drake.dynamics.motion import MotionStatus
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.scene.bodies import Scene
from gridpush_drake.dynamics.scene.simulation import simulate_scene
from gridpush_drake.errors import PlanningError, require_positive
from gridpush_drake.geometry.se2 import Array, transform_shape
from gridpush_drake.objects.grid_object import GridObject

MARGIN = 0.03
"""Room that every object should have around it, m."""

FREE = 1e-4
"""Distance of the pusher from every outline where a push begins, m."""

ANY_OUTLINE = 0.2
"""Share of the pushes that are drawn on any outline, and not on that of an object without room."""


@dataclass(frozen=True)
class SeparationOptions:
    """How objects are separated.

    Attributes:
        margin: room that every object should have around it, m.
        candidates: number of pushes that are simulated for each one that is made.
        lengths: least and greatest length of a push, m.
        slant: greatest angle of a push from the outline's inward normal, rad.
        radius: of the pusher, m.
        speed: of the pusher, m/s.
        max_pushes: number of pushes after which it is given up.

    Raises:
        PlanningError: a number is not positive, or the lengths do not increase.
    """

    margin: float = MARGIN
    candidates: int = 40
    lengths: tuple[float, float] = (0.03, 0.15)
    slant: float = 0.6
    radius: float = 0.008
    speed: float = 0.05
    max_pushes: int = 30

    def __post_init__(self) -> None:
        require_positive(
            PlanningError,
            margin=self.margin,
            candidates=self.candidates,
            slant=self.slant,
            radius=self.radius,
            speed=self.speed,
            max_pushes=self.max_pushes,
            least_length=self.lengths[0],
        )
        if not self.lengths[0] <= self.lengths[1] < np.inf:
            raise PlanningError(
                f"lengths are {self.lengths!r}; expected the least and the greatest, m"
            )


@dataclass(frozen=True, eq=False)
class Separation:
    """What came of it.

    Attributes:
        done: whether every object has the room that was asked for.
        poses: (P+1, N, 3) the objects before each push and at last, as they were seen, m and rad.
        clearances: (P+1, N) distance of each object from the nearest other one, m.
        pushes: the pushes that were made.
    """

    done: bool
    poses: Array
    clearances: Array
    pushes: tuple[Push, ...]


def calc_clearances(objects: Sequence[GridObject], poses: Array) -> Array:
    """Calculates the distance of each object from the nearest other one, (N,) m.

    Args:
        objects: the objects.
        poses: (N, 3) where they lie, m and rad.
    """
    outlines = np.array(
        [transform_shape(pose, obj.outline) for obj, pose in zip(objects, poses, strict=True)]
    )
    apart = shapely.distance(outlines[:, None], outlines[None, :])
    np.fill_diagonal(apart, np.inf)
    return np.asarray(apart.min(axis=1))


def separate(
    scene: Scene,
    execute: Callable[[Push, Array], Array],
    options: SeparationOptions | None = None,
    *,
    seed: int = 0,
) -> Separation:
    """Pushes objects until each has room around it.

    Args:
        scene: the objects as they are believed to be, where they are seen at the beginning.
        execute: makes a push of the objects at poses (N, 3), and returns where they are seen then.
        options: how.
        seed: seed of the pushes that are drawn.

    Returns:
        What came of it.

    Raises:
        PlanningError: no place was found from which an object can be pushed.
    """
    used = options or SeparationOptions()
    rng = np.random.default_rng(seed)
    poses = np.array(scene.poses)
    seen = [poses]
    clearances = [calc_clearances(scene.objects, poses)]
    pushes: list[Push] = []
    while clearances[-1].min() < used.margin and len(pushes) < used.max_pushes:
        push = plan_separating_push(scene.with_poses(poses, may_overlap=True), used, rng)
        poses = np.array(execute(push, poses))
        pushes.append(push)
        seen.append(poses)
        clearances.append(calc_clearances(scene.objects, poses))
    return Separation(
        done=bool(clearances[-1].min() >= used.margin),
        poses=np.array(seen),
        clearances=np.array(clearances),
        pushes=tuple(pushes),
    )


def plan_separating_push(
    scene: Scene, options: SeparationOptions, rng: np.random.Generator
) -> Push:
    """Chooses the best of many pushes: the one after which the least room is missing.

    Args:
        scene: the objects, where they lie.
        options: how.
        rng: draws the pushes.

    Returns:
        The push.

    Raises:
        PlanningError: no place was found from which an object can be pushed.
    """
    outlines = [
        transform_shape(pose, obj.outline)
        for obj, pose in zip(scene.objects, scene.poses, strict=True)
    ]
    taken = shapely.union_all(outlines)
    shapely.prepare(taken)
    clearances = calc_clearances(scene.objects, scene.poses)
    best: Push | None = None
    least = np.inf
    for _ in range(options.candidates):
        push = _draw_push(scene, taken, clearances, options, rng)
        if push is None:
            continue
        motion = simulate_scene(scene, push)
        if motion.status == MotionStatus.NO_CONTACT:
            continue
        missing = _calc_missing(scene, motion.final_poses, options.margin)
        if missing < least:
            least = missing
            best = push
    if best is None:
        raise PlanningError(
            f"scene of {', '.join(obj.name for obj in scene.objects)}: no place was found where "
            f"a pusher of {options.radius * 1000:g} mm fits beside an object"
        )
    return best


def _calc_missing(scene: Scene, poses: Array, margin: float) -> float:
    """Sums up the room that objects lack, m."""
    lacking = margin - calc_clearances(scene.objects, poses)
    return float(np.maximum(lacking, 0.0).sum())


def _draw_push(
    scene: Scene,
    taken: shapely.Geometry,
    clearances: Array,
    options: SeparationOptions,
    rng: np.random.Generator,
) -> Push | None:
    """Draws a push of an object that lacks room, or of any; None where the pusher does not fit."""
    lacking = np.flatnonzero(clearances < options.margin)
    everyone = np.arange(len(scene))
    body = int(rng.choice(everyone if rng.random() < ANY_OUTLINE else lacking))
    obj = scene.objects[body]
    push = Push.on_outline(
        obj,
        rng.uniform(0, obj.edges.perimeter),
        rng.uniform(-options.slant, options.slant),
        rng.uniform(*options.lengths),
        radius=options.radius,
        speed=options.speed,
        pose=scene.poses[body],
        clearance=2 * FREE,
    )
    fits = taken.distance(Point(push.start)) > options.radius + FREE
    return push if fits else None
