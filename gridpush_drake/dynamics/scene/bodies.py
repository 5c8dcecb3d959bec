"""`Scene`: several objects on a table, how rough they are to each other, and where they lie.

What one object weighs and how rough it is on the table and to the pusher stands in its
`CellParameters`, as ever; here they come together.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray
from shapely import Polygon

from gridpush_drake.dynamics.kernel_call import calc_reach
from gridpush_drake.errors import SimulationError
from gridpush_drake.frozen import Frozen
from gridpush_drake.geometry.polygons import OutlineEdges
from gridpush_drake.geometry.se2 import Array, check_vector, transform_shape
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters

DEFAULT_PAIR_FRICTION = 0.3
"""Friction coefficient of two objects against each other that is taken where none is given."""

CORNER_RADIUS = 0.0005
"""Radius of the round corners with which objects touch each other, m. The normal of a contact turns
evenly round a corner; at a sharp one it would jump."""

MIN_CORNER_RADIUS = 1e-5
"""Least such radius of an object with parts so thin that the usual one would break them, m."""

STRAIGHT = 1e-9
"""Sine of the turn up to which a vertex of a core counts as straight, and touches nothing."""

OVERLAP_TOLERANCE = 1e-8
"""Area of two outlines' overlap that is taken for touching, m²: 10 cm by 0.1 µm."""


class SceneBody(NamedTuple):
    """One object of a scene.

    Attributes:
        obj: the object.
        params: its cells' masses and frictions; its contact friction is that with the pusher.
        pose: (3,) q = (x, y, theta) of B in W at the beginning, m and rad.
    """

    obj: GridObject
    params: CellParameters
    pose: ArrayLike = (0.0, 0.0, 0.0)


class Core(NamedTuple):
    """An outline moved inwards by the radius of the corners.

    Attributes:
        edges: its edges, body frame.
        convex: (E,) whether the vertex where an edge begins is convex.
        radius: the radius, m.
    """

    edges: OutlineEdges
    convex: NDArray[np.bool_]
    radius: float


@dataclass(frozen=True, eq=False, init=False)
class Scene(Frozen):
    """N objects on a table.

    Attributes:
        objects: the N objects; one may lie there more than once.
        params: their cells' masses and frictions.
        poses: (N, 3) q = (x, y, theta) at the beginning, m and rad.
        pair_friction: (N, N) friction coefficients of two objects against each other, symmetric;
            the diagonal means nothing.

    Raises:
        SimulationError: there is no object, parameters belong to another object, a number is out of
            range, or two objects overlap.
    """

    objects: tuple[GridObject, ...]
    params: tuple[CellParameters, ...]
    poses: Array
    pair_friction: Array

    def __init__(
        self,
        bodies: Iterable[SceneBody | Sequence[object]],
        pair_friction: ArrayLike = DEFAULT_PAIR_FRICTION,
        *,
        may_overlap: bool = False,
    ) -> None:
        """Copies and checks what is given.

        Args:
            bodies: the objects, as `SceneBody` or (object, parameters, pose).
            pair_friction: one friction coefficient for all pairs, or (N, N).
            may_overlap: whether objects may overlap, as noisy poses of objects that touch do. In a
                push they are moved apart little by little.
        """
        # each by itself
        made = [SceneBody(*each) for each in bodies]
        if not made:
            raise SimulationError("scene: no objects; expected at least one")
        for body in made:
            body.params.center_of_mass(body.obj)
        # then all together
        objects = tuple(body.obj for body in made)
        poses = np.array([check_vector(SimulationError, "pose", body.pose, 3) for body in made])
        poses.setflags(write=False)
        object.__setattr__(self, "objects", objects)
        object.__setattr__(self, "params", tuple(body.params for body in made))
        object.__setattr__(self, "poses", poses)
        object.__setattr__(self, "pair_friction", _check_pair_friction(pair_friction, len(made)))
        if not may_overlap:
            check_overlap(objects, poses)

    def __len__(self) -> int:
        """Number of objects."""
        return len(self.objects)

    def __repr__(self) -> str:
        """The objects' names, in a line."""
        return f"Scene of {', '.join(obj.name for obj in self.objects)}"

    def with_poses(self, poses: ArrayLike, *, may_overlap: bool = False) -> "Scene":
        """Places the same objects elsewhere, at (N, 3), m and rad; `may_overlap` as of a scene.

        Raises:
            SimulationError: the poses are not N of three finite numbers, or two objects overlap.
        """
        places = np.asarray(poses, dtype=np.float64)
        if places.shape != self.poses.shape:
            raise SimulationError(
                f"poses of shape {places.shape}; expected ({len(self)}, 3), one for each object"
            )
        bodies = [SceneBody(*each) for each in zip(self.objects, self.params, places, strict=True)]
        return Scene(bodies, self.pair_friction, may_overlap=may_overlap)


def _check_pair_friction(given: ArrayLike, n: int) -> Array:
    """Makes the matrix (n, n) of the pairs' friction, of one number or a matrix."""
    friction = np.array(given, dtype=np.float64)
    if friction.shape == ():
        friction = np.full((n, n), float(friction))
    if friction.shape != (n, n):
        raise SimulationError(
            f"pair_friction of shape {friction.shape}; expected one number or ({n}, {n})"
        )
    pairs = friction[np.triu_indices(n, 1)]
    if not (np.isfinite(pairs).all() and (pairs >= 0).all()):
        raise SimulationError("pair_friction: expected finite numbers >= 0")
    if not np.array_equal(pairs, friction.T[np.triu_indices(n, 1)]):
        raise SimulationError(
            "pair_friction: expected a symmetric matrix; two objects have one friction coefficient"
        )
    np.fill_diagonal(friction, 0.0)
    friction.setflags(write=False)
    return friction


def check_overlap(objects: Sequence[GridObject], poses: Array) -> None:
    """Raises SimulationError, which names both, where two objects overlap at poses (N, 3)."""
    # Outlines that merely touch have an overlap without area.
    outlines = [
        transform_shape(pose, obj.outline) for obj, pose in zip(objects, poses, strict=True)
    ]
    for i, j in combinations(range(len(objects)), 2):
        if not outlines[i].intersects(outlines[j]):
            continue
        area = outlines[i].intersection(outlines[j]).area
        if area > OVERLAP_TOLERANCE:
            raise SimulationError(
                f"scene: {describe_object(objects, i)} and {describe_object(objects, j)} overlap "
                f"by {area * 1e4:.3g} cm²; expected objects beside each other"
            )


def describe_object(objects: Sequence[GridObject], index: int) -> str:
    """Names an object of a scene, with its number where the name alone does not tell it."""
    name = objects[index].name
    same = sum(obj.name == name for obj in objects)
    return name if same == 1 else f"{name} (object {index})"


def get_core(obj: GridObject) -> Core:
    """Moves an object's outline inwards by the radius of its corners, once for each object.

    An object with parts thinner than twice that radius has sharper corners.

    Raises:
        SimulationError: even `MIN_CORNER_RADIUS` breaks the outline.
    """
    cached: Core | None = obj.__dict__.get("_scene_core")
    if cached is None:
        cached = _make_core(obj)
        obj.__dict__["_scene_core"] = cached
    return cached


def _make_core(obj: GridObject) -> Core:
    # As round as usual, or less where that would break a thin part off.
    radius = CORNER_RADIUS
    while radius >= MIN_CORNER_RADIUS:
        inner = obj.outline.buffer(-radius, join_style="mitre", mitre_limit=MITRE_LIMIT)
        whole = isinstance(inner, Polygon) and not inner.is_empty
        if whole and len(inner.interiors) == len(obj.outline.interiors):
            edges = OutlineEdges.from_polygon(shapely.remove_repeated_points(inner))
            return Core(edges=edges, convex=_find_convex(edges), radius=radius)
        radius /= 2
    raise SimulationError(
        f"{obj.name}: its outline is thinner than {2 * MIN_CORNER_RADIUS * 1000:g} mm somewhere; "
        "expected one that can touch another object"
    )


MITRE_LIMIT = 10.0
"""Farthest that a vertex of the core may be from the outline's, in radii."""


def _find_convex(edges: OutlineEdges) -> NDArray[np.bool_]:
    """Tells which vertices, where the edges begin, are convex."""
    # the turn from the edge before: to the left where the vertex is convex
    along = edges.end - edges.start
    before = along[edges.previous]
    turn = before[:, 0] * along[:, 1] - before[:, 1] * along[:, 0]
    lengths = np.linalg.norm(before, axis=1) * np.linalg.norm(along, axis=1)
    return np.asarray(turn > STRAIGHT * lengths)


def calc_outline_reach(obj: GridObject) -> float:
    """The farthest point of the outline from B's origin, m; no less than the farthest cell's."""
    farthest = np.linalg.norm(obj.edges.start, axis=1).max()
    return max(float(farthest), calc_reach(obj))
