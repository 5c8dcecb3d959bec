"""Random scenes for benches and games: objects scattered or heaped up, of hidden masses."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from gridpush_drake.dynamics.bodies import Bodies
from gridpush_drake.geometry.se2 import Array, make_direction, transform_shape
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters

MASS_RANGE = (0.1, 5.0)
"""Least and greatest mass of a cell; one is drawn for each part. Only their ratios matter."""

FRICTION_RANGE = (0.3, 0.4)
"""Least and greatest friction of a part against the table."""

CONTACT_FRICTION_RANGE = (0.35, 0.65)
"""Least and greatest friction of the finger on an object."""

PAIR_FRICTION_RANGE = (0.1, 0.5)
"""Least and greatest friction of two objects against each other."""

MAX_ORIGIN_OFFSET = 0.22
"""Greatest distance of an object's origin from the middle, along x and y, m; it grows where the
objects do not fit."""

BOX_GROWTH = 1.02
"""Factor by which it grows with each place that does not fit."""

HEAP_GAP = 0.0015
"""Distance at which objects of a heap stop on their way to its middle, m."""

HEAP_STEP = 0.002
"""Step of that way, m."""

HEAP_REACH = 1.0
"""Where that way begins, m from the middle."""


@dataclass(frozen=True)
class HiddenRanges:
    """What the hidden truth of a scene is drawn from; least and greatest of each.

    Attributes:
        mass: of a cell, kg, one for each part.
        friction: of a part against the table.
        contact_friction: of the finger on an object.
        pair_friction: of two objects against each other.
    """

    mass: tuple[float, float] = MASS_RANGE
    friction: tuple[float, float] = FRICTION_RANGE
    contact_friction: tuple[float, float] = CONTACT_FRICTION_RANGE
    pair_friction: tuple[float, float] = PAIR_FRICTION_RANGE


def hide(
    objects: Sequence[GridObject],
    rng: np.random.Generator,
    ranges: HiddenRanges | None = None,
) -> Bodies:
    """Draws the true masses and frictions of objects."""
    drawn = ranges or HiddenRanges()
    hidden = []
    for obj in objects:
        seed = int(rng.integers(np.iinfo(np.int32).max))
        params = CellParameters.random(obj, seed, drawn.mass, drawn.friction)
        rough = float(rng.uniform(*drawn.contact_friction))
        hidden.append(replace(params, contact_friction=rough))
    return Bodies(objects, hidden, None, float(rng.uniform(*drawn.pair_friction)))


def scatter(
    objects: Sequence[GridObject],
    rng: np.random.Generator,
    gap: float,
    largest: float,
    box: float = MAX_ORIGIN_OFFSET,
) -> Array:
    """Draws poses of objects beside each other.

    Args:
        objects: the objects.
        rng: draws.
        gap: least distance between any two, m.
        largest: greatest distance of an object's origin from the middle, along x and y, that is
            tried, m; there must be room.
        box: that distance at first, m.

    Returns:
        (N, 3) poses, m and rad.
    """
    poses = []
    taken: BaseGeometry = shapely.Polygon()
    for obj in objects:
        while True:
            pose = np.append(rng.uniform(-box, box, 2), rng.uniform(-np.pi, np.pi))
            outline = transform_shape(pose, obj.outline)
            if taken.is_empty or outline.distance(taken) >= gap:
                break
            box = min(box * BOX_GROWTH, largest)
        poses.append(pose)
        taken = shapely.union(taken, outline)
    return np.array(poses)


def heap_up(objects: Sequence[GridObject], rng: np.random.Generator) -> Array:
    """Slides objects towards the first one until they all but touch.

    Args:
        objects: the objects.
        rng: draws from where each comes, and how it is turned.

    Returns:
        (N, 3) poses, m and rad; the heap's middle is the origin.
    """
    poses: list[Array] = []
    taken: BaseGeometry = shapely.Polygon()
    for obj in objects:
        direction = make_direction(rng.uniform(-np.pi, np.pi))
        angle = rng.uniform(-np.pi, np.pi)
        distance = 0.0 if taken.is_empty else HEAP_REACH
        pose = np.append(distance * direction, angle)
        while distance > 0:
            distance -= HEAP_STEP
            nearer = np.append(distance * direction, angle)
            if transform_shape(nearer, obj.outline).distance(taken) < HEAP_GAP:
                break
            pose = nearer
        poses.append(pose)
        taken = shapely.union(taken, transform_shape(pose, obj.outline))
    placed = np.array(poses)
    left, low, right, high = taken.bounds
    placed[:, :2] -= ((left + right) / 2, (low + high) / 2)
    return placed
