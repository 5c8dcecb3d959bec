"""Shapes of an object and its estimate in Meshcat, and their changes, live and in a recording.

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

CELL_FRACTION = 0.94
"""Side of a drawn cell, in cells; the rest is the gap that lets cells be told apart."""

CIRCLE_SIDES = 48
"""Number of straight pieces of a drawn circle."""

MIN_HALF_AXIS = 1e-5
"""Smallest half axis of a drawn ellipse, m. A narrower one has no area to speak of."""

MIN_LENGTH = 1e-5
"""Smallest length of a drawn arrow, m."""


def make_cell_prisms(obj: GridObject, height: float, fraction: float = CELL_FRACTION) -> Trimesh:
    """Makes a prism for each cell, standing on the plane z = 0 of the body frame, open below.

    Args:
        obj: the object.
        height: height of the prisms, m.
        fraction: their sides, in sides of a cell.

    Returns:
        A mesh whose 8 n vertices come by corner, then by cell: the first n are all cells' first
        corners.
    """
    half = fraction * obj.cell_size / 2
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
    """Makes a flat band about an object's outline, half inside and half outside, body frame.

    Args:
        obj: the object.
        height: z of the band, m.
        width: its width, m.
    """
    outside = obj.outline.buffer(width / 2)
    inside = obj.outline.buffer(-width / 2)
    return _make_plate(outside.difference(inside), height)


def make_disc(covariance: ArrayLike, center: ArrayLike, height: float) -> Trimesh:
    """Makes a flat ellipse, the points p with (p - c)' S^-1 (p - c) <= 1.

    Args:
        covariance: (2, 2) S, m².
        center: (2,) c, m.
        height: z of the ellipse, m.
    """
    return _make_plate(make_ellipse(covariance, center), height)


def make_ring(covariance: ArrayLike, center: ArrayLike, height: float, width: float) -> Trimesh:
    """Makes the edge of the ellipse of `make_disc`, as a flat band that reaches outwards.

    Args:
        covariance: (2, 2) S, m².
        center: (2,) c, m.
        height: z of the band, m.
        width: its width, m.
    """
    outer = make_ellipse(covariance, center, width)
    inner = make_ellipse(covariance, center)
    return _make_plate(outer.difference(inner), height)


def make_arrow(start: ArrayLike, end: ArrayLike, height: float, width: float) -> Trimesh:
    """Makes a flat arrow, whose head is three times as wide and as long as its shaft is wide.

    Args:
        start: (2,) where it begins, m.
        end: (2,) its point, m.
        height: z of the arrow, m.
        width: width of its shaft, m.
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
    """Makes an area, m, a mesh at z = height, m."""
    corners, faces = triangulate_area(area)
    return Trimesh(np.column_stack([corners, np.full(len(corners), height)]), faces, process=False)


def _drop_floor(mesh: Trimesh) -> Trimesh:
    """Takes away the faces of a mesh that lie in the plane z = 0."""
    mesh.update_faces(~(mesh.triangles[:, :, 2] == 0.0).all(axis=1))
    return mesh


def make_ellipse(covariance: ArrayLike, center: ArrayLike, margin: float = 0.0) -> Polygon:
    """Makes an ellipse whose half axes are the roots of a covariance's eigenvalues.

    Args:
        covariance: (2, 2) the covariance, m².
        center: (2,) the ellipse's center, m.
        margin: length by which both half axes are longer, m.
    """
    values, vectors = np.linalg.eigh(np.asarray(covariance, dtype=np.float64))
    circle = make_direction(2 * np.pi * np.arange(CIRCLE_SIDES) / CIRCLE_SIDES)
    axes = np.sqrt(np.maximum(values, MIN_HALF_AXIS**2)) + margin
    return Polygon(np.asarray(center, dtype=np.float64) + (circle * axes) @ vectors.T)


VISIBLE_PROPERTY = "visible"
"""Property of a path in Meshcat."""

CENTER_COLOR = Rgba(0.93, 0.07, 0.42)
"""Color of the center of mass and its ellipse; no color of viridis comes near it."""

ELLIPSE_SIGMAS = 2.0
"""Half axes of an ellipse, in standard deviations."""

PLAN_COLOR = Rgba(0.93, 0.38, 0.05)
"""Color of what is to come: a push, and the pose that it is predicted to end in."""

GHOST_OPACITY = 0.3
"""Opacity of the prism of a predicted pose, 0 to 1."""

CENTER_RADIUS = 0.0025
"""Radius of the dot at the center of mass, m."""

RING_WIDTH = 0.0018
"""Width of an ellipse's edge, m."""

ARROW_WIDTH = 0.005
"""Width of the shaft of a push's arrow, m."""

LAYER_DISTANCE = 0.001
"""Distance between things that are drawn one over the other, m."""

EDGE_WIDTH = 0.0015
"""Width of a ghost's upper edge, m."""

GHOST_FRACTION = 0.97
"""Height of a ghost, in heights of its object, whose own top then covers it where the two meet."""


def AddCells(
    meshcat: Meshcat, path: str, obj: GridObject, colors: ArrayLike, height: float
) -> None:
    """Draws an object's cells as one mesh, standing on z = 0 of its body frame.

    Args:
        meshcat: where they are drawn.
        path: their path in Meshcat.
        obj: the object.
        colors: (n, 3) the cells' colors, sRGB, 0 to 1.
        height: height of the cells, m.
    """
    mesh = make_cell_prisms(obj, height)
    light = srgb_to_linear(np.asarray(colors, dtype=np.float64))
    vertices, faces = _to_columns(mesh)
    corners = len(mesh.vertices) // obj.n
    columns: Any = np.tile(light, (corners, 1)).T
    meshcat.SetTriangleColorMesh(path, vertices, faces, columns)


def AddCenter(
    meshcat: Meshcat, path: str, center: ArrayLike, covariance: ArrayLike, height: float
) -> None:
    """Draws an estimated point and its ellipse of `ELLIPSE_SIGMAS` standard deviations, flat.

    A dot is drawn at `path`/dot, and the ellipse's edge at `path`/edge. The ellipse is not filled:
    whatever lies over cells, however faint, gives them colors that mean other values.

    Args:
        meshcat: where they are drawn.
        path: their path in Meshcat.
        center: (2,) the point, m; where it is not finite, nothing is drawn.
        covariance: (2, 2) its covariance, m²; where it is not finite, only the dot is drawn.
        height: z of the lowest of them, m.
    """
    if not np.isfinite(center).all():
        return
    dot = make_disc(CENTER_RADIUS**2 * np.eye(2), center, height + 2 * LAYER_DISTANCE)
    _AddMesh(meshcat, f"{path}/dot", dot, CENTER_COLOR)
    spread = ELLIPSE_SIGMAS**2 * np.asarray(covariance, dtype=np.float64)
    if np.isfinite(spread).all() and spread.any():
        _AddMesh(
            meshcat,
            f"{path}/edge",
            make_ring(spread, center, height + LAYER_DISTANCE, RING_WIDTH),
            CENTER_COLOR,
        )


def AddGhost(
    meshcat: Meshcat, path: str, obj: GridObject, height: float, color: Rgba = PLAN_COLOR
) -> None:
    """Draws a translucent prism of an object's outline, with its upper edge as an opaque band.

    They are at `path`/body, which ends a little below `height`, m, and at `path`/edge, which lies a
    little above.
    """
    _AddMesh(
        meshcat,
        f"{path}/body",
        make_outline_prism(obj, GHOST_FRACTION * height),
        _fade(color, GHOST_OPACITY),
    )
    edge = make_outline_edge(obj, height + LAYER_DISTANCE / 2, EDGE_WIDTH)
    _AddMesh(meshcat, f"{path}/edge", edge, color)


def AddPrism(
    meshcat: Meshcat, path: str, area: Polygon | MultiPolygon, height: float, color: Rgba
) -> None:
    """Draws the prism of an area, m, from z = 0 to `height`, m."""
    mesh = trimesh.creation.extrude_triangulation(*triangulate_area(area), height)
    _AddMesh(meshcat, path, mesh, color)


def AddArrow(meshcat: Meshcat, path: str, start: ArrayLike, end: ArrayLike, height: float) -> None:
    """Draws a push as a flat arrow.

    Args:
        meshcat: where it is drawn.
        path: its path in Meshcat.
        start: (2,) where the push begins, world frame, m.
        end: (2,) where it ends, world frame, m.
        height: z of the arrow, m.

    Nothing is drawn of a push that is not finite, or too short to be seen.
    """
    if not np.linalg.norm(np.subtract(end, start)) > MIN_LENGTH:
        return
    _AddMesh(meshcat, path, make_arrow(start, end, height, ARROW_WIDTH), PLAN_COLOR)


def SwapVisible(
    meshcat: Meshcat, shown: str | None, hidden: str | None, time: float, period: float
) -> None:
    """Shows one path instead of another, live and in the recording where one is made.

    In the recording the one that is shown is hidden before; the other one stays as it is until the
    scene was drawn last, at least.

    Args:
        meshcat: where they are drawn.
        shown: the path that is shown; None for none.
        hidden: the path that is hidden; None for none.
        time: from when on, s.
        period: time since the scene was drawn last, s.
    """
    recording = meshcat.get_mutable_recording()
    begin = recording.start_time()
    frame = 1 / recording.frames_per_second()
    if time < begin:
        begin = time
    if shown is not None:
        meshcat.SetProperty(shown, VISIBLE_PROPERTY, False, begin)
    if hidden is not None:
        meshcat.SetProperty(hidden, VISIBLE_PROPERTY, True, max(begin, time - max(period, frame)))
        meshcat.SetProperty(hidden, VISIBLE_PROPERTY, False, time)
    if shown is not None:
        meshcat.SetProperty(shown, VISIBLE_PROPERTY, True, time)


def MakePlanarTransform(pose: ArrayLike, height: float = 0.0) -> RigidTransform:
    """X_WB of a pose (3,) (x, y, theta), m and rad, at z = `height`, m."""
    x, y, theta = np.asarray(pose, dtype=np.float64)
    p_WB: Any = np.array([x, y, height])
    return RigidTransform(RotationMatrix.MakeZRotation(theta), p_WB)


def srgb_to_linear(srgb: Array) -> Array:
    """Colors (..., 3), 0 to 1, as linear light (IEC 61966-2-1)."""
    dark = srgb / 12.92
    bright = ((srgb + 0.055) / 1.055) ** 2.4
    return np.where(srgb <= 0.04045, dark, bright)


def _AddMesh(meshcat: Meshcat, path: str, mesh: Trimesh, color: Rgba) -> None:
    """Draws a mesh in one color."""
    vertices, faces = _to_columns(mesh)
    meshcat.SetTriangleMesh(path, vertices, faces, color)


def _to_columns(mesh: Trimesh) -> tuple[Any, Any]:
    """Takes vertices and faces as Meshcat wants them, one a column."""
    return mesh.vertices.T, mesh.faces.T.astype(np.int32)


def _fade(color: Rgba, opacity: float) -> Rgba:
    """Makes a color translucent."""
    return Rgba(color.r(), color.g(), color.b(), opacity)
