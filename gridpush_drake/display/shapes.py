"""What is drawn of an object and its estimate in Meshcat, and how it changes in a live scene and in a recording alike.

An animation in Meshcat moves things and changes properties, but cannot change a mesh. So each new
version of what is drawn gets a path of its own, and versions take turns by the property "visible",
which is recorded.

Meshcat's shader takes a mesh's vertex colors for linear light, though a material's for sRGB; what
is given here is always sRGB.

What is drawn lies flat on a table: cells, an outline's prism, discs, rings and arrows. Areas are
shapely's, meshes trimesh's.
"""

from typing import Any

import numpy as np
import trimesh
from numpy.typing import ArrayLike
from pydrake.geometry import Meshcat, Rgba
from pydrake.math import RigidTransform, RotationMatrix
from shapely import MultiPolygon, Polygon
from trimesh import Trimesh

from gridpush_drake.geometry.outline_mesh import triangulate_area
from gridpush_drake.geometry.se2 import Array, make_direction
from gridpush_drake.objects.grid_object import GridObject

CELL_SHARE = 0.94
"""Side of a drawn cell, in cells; the rest is the gap that lets cells be told apart."""

CIRCLE_SIDES = 48
"""Straight pieces of a drawn circle."""

MIN_HALF_AXIS = 1e-5
"""Of a drawn ellipse, m; one that is narrower has no area to speak of."""

MIN_LENGTH = 1e-5
"""Of a drawn arrow, m."""


def make_cell_prisms(obj: GridObject, height: float, share: float = CELL_SHARE) -> Trimesh:
    """Makes a prism a cell, standing on the plane z = 0 of the body frame, open below; its side is `share` of a cell's.

    The 8 n vertices come by corner, then by cell (the first n are all cells' first corners).
    """
    half = share * obj.cell_size / 2
    low = [-half, -half, 0.0]
    high = [half, half, height]
    box = _drop_floor(trimesh.creation.box(bounds=[low, high]))
    # The box, once about the middle of every cell.
    p_BC = np.column_stack([obj.p_BC, np.zeros(obj.n)])
    vertices = box.vertices[:, None] + p_BC
    cell = np.arange(obj.n)
    faces = box.faces[None] * obj.n + cell[:, None, None]
    vertices = vertices.reshape(-1, 3)
    faces = faces.reshape(-1, 3)
    return Trimesh(vertices, faces, process=False)


def make_outline_prism(obj: GridObject, height: float) -> Trimesh:
    """Makes the walls and the lid of an object's outline; body frame, from z = 0 to `height`, m."""
    return _drop_floor(
        trimesh.creation.extrude_triangulation(*triangulate_area(obj.outline), height)
    )


def make_outline_edge(obj: GridObject, height: float, width: float) -> Trimesh:
    """Makes a flat band about an object's outline, half inside and half outside; body frame, at z = `height`, m."""
    outside = obj.outline.buffer(width / 2)
    inside = obj.outline.buffer(-width / 2)
    return _make_plate(outside.difference(inside), height)


def make_disc(covariance: ArrayLike, center: ArrayLike, height: float) -> Trimesh:
    """Makes a flat ellipse at z = `height`, m, the points p with (p - c)' S^-1 (p - c) <= 1: S in m², c in m."""
    return _make_plate(_make_ellipse(covariance, center), height)


def make_ring(covariance: ArrayLike, center: ArrayLike, height: float, width: float) -> Trimesh:
    """Makes the edge of the ellipse of `make_disc`, as a flat band that reaches `width`, m, outwards."""
    outer = _make_ellipse(covariance, center, width)
    inner = _make_ellipse(covariance, center)
    return _make_plate(outer.difference(inner), height)


def make_arrow(start: ArrayLike, end: ArrayLike, height: float, width: float) -> Trimesh:
    """Makes a flat arrow from `start` (2,) to `end` (2,) at z = `height`, m, with a shaft of a width, m.

    The head is three times as wide and long, at most the whole arrow.
    """
    tail = np.asarray(start, dtype=np.float64)
    point = np.asarray(end, dtype=np.float64)
    length = float(np.linalg.norm(point - tail))
    along = (point - tail) / length
    across = np.array([-along[1], along[0]])
    half = width / 2
    neck = length - min(3 * width, length)
    # Corners as distances along the arrow and across it, counterclockwise.
    outline = [
        (neck, -3 * half),
        (length, 0.0),
        (neck, 3 * half),
    ]
    if neck > 0.0:
        outline = [(0.0, -half), (neck, -half), *outline, (neck, half), (0.0, half)]
    corners = [tail + s * along + t * across for s, t in outline]
    return _make_plate(Polygon(corners), height)


def _make_plate(area: Polygon | MultiPolygon, height: float) -> Trimesh:
    """An area at z = height."""
    corners, faces = triangulate_area(area)
    return Trimesh(np.column_stack([corners, np.full(len(corners), height)]), faces, process=False)


def _drop_floor(mesh: Trimesh) -> Trimesh:
    """What stands on z = 0, open below."""
    mesh.update_faces(~(mesh.triangles[:, :, 2] == 0.0).all(axis=1))
    return mesh


def _make_ellipse(covariance: ArrayLike, center: ArrayLike, margin: float = 0.0) -> Polygon:
    """The ellipse whose half axes are the square roots of the covariance's eigenvalues, and longer by `margin`, m."""
    values, vectors = np.linalg.eigh(np.asarray(covariance, dtype=np.float64))
    circle = make_direction(2 * np.pi * np.arange(CIRCLE_SIDES) / CIRCLE_SIDES)
    axes = np.sqrt(np.maximum(values, MIN_HALF_AXIS**2)) + margin
    return Polygon(np.asarray(center, dtype=np.float64) + (circle * axes) @ vectors.T)


VISIBLE = "visible"

CENTER_COLOR = Rgba(
    0.93, 0.07, 0.42
)  # of the center of mass and its ellipse; no color of viridis comes near

ELLIPSE_OPACITY = 0.3

SIGMAS = 2.0
"""Half axes of the ellipse, in standard deviations."""

PLAN_COLOR = Rgba(
    0.93, 0.38, 0.05
)  # of what is to come: a push, and the pose it is predicted to end in

GHOST_OPACITY = 0.3

CENTER_RADIUS = 0.0025
"""Of the dot at the center of mass, m."""

RING_WIDTH = 0.0012
"""Of the ellipse's edge, m."""

ARROW_WIDTH = 0.005
"""Of a push's shaft, m."""

LAYER = 0.001
"""Between what is drawn one over the other, m."""

EDGE_WIDTH = 0.0015
"""Of a ghost's upper edge, m."""

GHOST_SHARE = 0.97
"""Height of a ghost, in heights of its object, whose own top then covers it where the two meet."""


def AddCells(
    meshcat: Meshcat, path: str, obj: GridObject, colors: ArrayLike, height: float
) -> None:
    """Draws an object's cells as one mesh, standing on z = 0 of its body frame, in `colors` (n, 3), sRGB, 0 to 1."""
    mesh = make_cell_prisms(obj, height)
    light = srgb_to_linear(np.asarray(colors, dtype=np.float64))
    vertices, faces = _to_columns(mesh)
    corners = len(mesh.vertices) // obj.n
    columns: Any = np.tile(light, (corners, 1)).T
    meshcat.SetTriangleColorMesh(path, vertices, faces, columns)


def AddCenter(
    meshcat: Meshcat, path: str, center: ArrayLike, covariance: ArrayLike, height: float
) -> None:
    """Draws an estimated point and its ellipse of SIGMAS standard deviations, flat, from z = `height` up.

    A dot is drawn at `path`/dot, the ellipse and its edge at `path`/ellipse and `path`/edge;
    nothing where `center` (2,), m, is not finite, and the dot alone where `covariance` (2, 2), m²,
    is not.
    """
    if not np.isfinite(center).all():
        return
    dot = make_disc(CENTER_RADIUS**2 * np.eye(2), center, height + 2 * LAYER)
    _AddMesh(meshcat, f"{path}/dot", dot, CENTER_COLOR)
    spread = SIGMAS**2 * np.asarray(covariance, dtype=np.float64)
    if np.isfinite(spread).all() and spread.any():
        fill = make_disc(spread, center, height)
        _AddMesh(meshcat, f"{path}/ellipse", fill, _fade(CENTER_COLOR, ELLIPSE_OPACITY))
        _AddMesh(
            meshcat,
            f"{path}/edge",
            make_ring(spread, center, height + LAYER, RING_WIDTH),
            CENTER_COLOR,
        )


def AddGhost(
    meshcat: Meshcat, path: str, obj: GridObject, height: float, color: Rgba = PLAN_COLOR
) -> None:
    """Draws a translucent prism of an object's outline, body frame, with its upper edge as an opaque band.

    They are at `path`/body, which ends a little below `height`, m, and at `path`/edge, which lies a
    little above.
    """
    _AddMesh(
        meshcat,
        f"{path}/body",
        make_outline_prism(obj, GHOST_SHARE * height),
        _fade(color, GHOST_OPACITY),
    )
    edge = make_outline_edge(obj, height + LAYER / 2, EDGE_WIDTH)
    _AddMesh(meshcat, f"{path}/edge", edge, color)


def AddArrow(meshcat: Meshcat, path: str, start: ArrayLike, end: ArrayLike, height: float) -> None:
    """Draws a push from `start` (2,) to `end` (2,), world frame, m, as a flat arrow at z = `height`, m.

    Nothing is drawn of one that is not finite, or too short to be seen.
    """
    if not np.linalg.norm(np.subtract(end, start)) > MIN_LENGTH:
        return
    _AddMesh(meshcat, path, make_arrow(start, end, height, ARROW_WIDTH), PLAN_COLOR)


def SwapVisible(
    meshcat: Meshcat, shown: str | None, hidden: str | None, time: float, period: float
) -> None:
    """Shows one path instead of another, from `time` (s) on, live and in the recording where one is made.

    In the recording `shown` is hidden before; `hidden` stays as it is until a `period` (s) before,
    at least: what passed since the scene was drawn last.
    """
    recording = meshcat.get_mutable_recording()
    begin = recording.start_time()
    frame = 1 / recording.frames_per_second()
    if time < begin:
        begin = time
    if shown is not None:
        meshcat.SetProperty(shown, VISIBLE, False, begin)
    if hidden is not None:
        meshcat.SetProperty(hidden, VISIBLE, True, max(begin, time - max(period, frame)))
        meshcat.SetProperty(hidden, VISIBLE, False, time)
    if shown is not None:
        meshcat.SetProperty(shown, VISIBLE, True, time)


def MakePlanarTransform(pose: ArrayLike, height: float = 0.0) -> RigidTransform:
    """X_WB of a pose (3,) (x, y, theta), m and rad, at z = `height`, m."""
    x, y, theta = np.asarray(pose, dtype=np.float64)
    p_WB: Any = np.array([x, y, height])
    return RigidTransform(RotationMatrix.MakeZRotation(theta), p_WB)


def srgb_to_linear(srgb: Array) -> Array:
    """Colors (..., 3), 0 to 1, as linear light (IEC 61966-2-1)."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def _AddMesh(meshcat: Meshcat, path: str, mesh: Trimesh, color: Rgba) -> None:
    vertices, faces = _to_columns(mesh)
    meshcat.SetTriangleMesh(path, vertices, faces, color)


def _to_columns(mesh: Trimesh) -> tuple[Any, Any]:
    return mesh.vertices.T, mesh.faces.T.astype(np.int32)


def _fade(color: Rgba, opacity: float) -> Rgba:
    return Rgba(color.r(), color.g(), color.b(), opacity)
