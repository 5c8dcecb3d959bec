"""What is drawn of an object and its estimate in Meshcat, and how it changes in a live scene and in a recording alike.

An animation in Meshcat moves things and changes properties, but cannot change a mesh. So each new version of what is
drawn gets a path of its own, and versions take turns by the property "visible", which is recorded.

Meshcat's shader takes a mesh's vertex colours for linear light, though a material's for sRGB; what is given here is
always sRGB.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.geometry import Meshcat, Rgba
from pydrake.math import RigidTransform, RotationMatrix

from gridpush_drake.grid.object import GridObject
from gridpush_drake.systems.triangle_meshes import (
    TriangleMesh,
    make_arrow,
    make_cell_prisms,
    make_disc,
    make_outline_edge,
    make_outline_prism,
    make_ring,
)

VISIBLE = "visible"

CENTRE_COLOR = Rgba(0.93, 0.07, 0.42)
"""Of the centre of mass and its ellipse; no colour of viridis comes near."""

ELLIPSE_OPACITY = 0.3

PLAN_COLOR = Rgba(0.93, 0.38, 0.05)
"""Of what is to come: a push, and the pose it is predicted to end in."""

GHOST_OPACITY = 0.3

CENTRE_RADIUS = 0.0025
"""Of the dot at the centre of mass, m."""

RIM_WIDTH = 0.0012
"""Of the ellipse's rim, m."""

ARROW_WIDTH = 0.005
"""Of a push's shaft, m."""

LAYER = 0.001
"""Between what is drawn one over the other, m."""

EDGE_WIDTH = 0.0015
"""Of a ghost's upper edge, m."""

GHOST_SHARE = 0.97
"""Height of a ghost, in heights of its object, whose own top then covers it where the two meet."""


def AddCells(
    meshcat: Meshcat, path: str, obj: GridObject, colors: ArrayLike, height: float, share: float | None = None
) -> None:
    """Draws an object's cells as one mesh, standing on z = 0 of its body frame.

    Args:
        meshcat: where to draw.
        path: what is there already is replaced.
        obj: the object.
        colors: (n, 3) sRGB, 0 to 1.
        height: of the cells, m.
        share: side of a drawn cell, in cells; `triangle_meshes.CELL_SHARE` by default.
    """
    mesh = make_cell_prisms(obj, height) if share is None else make_cell_prisms(obj, height, share)
    light = srgb_to_linear(np.asarray(colors, dtype=np.float64))
    vertices, faces = _to_columns(mesh)
    corners = len(mesh.vertices) // obj.n
    columns: Any = np.tile(light, (corners, 1)).T
    meshcat.SetTriangleColorMesh(path, vertices, faces, columns)


def AddCentre(
    meshcat: Meshcat, path: str, centre: ArrayLike, covariance: ArrayLike, height: float, sigmas: float
) -> None:
    """Draws an estimated point with its uncertainty, flat, at z = `height` and a little above.

    Args:
        meshcat: where to draw.
        path: a dot is drawn at `path`/dot, the ellipse and its rim at `path`/ellipse and `path`/rim.
        centre: (2,) body frame, m.
        covariance: (2, 2) m²; nothing but the dot is drawn where it is not finite.
        height: m.
        sigmas: half axes of the ellipse, in standard deviations.
    """
    dot = make_disc(CENTRE_RADIUS**2 * np.eye(2), centre, height + 2 * LAYER)
    _AddMesh(meshcat, f"{path}/dot", dot, CENTRE_COLOR)
    spread = sigmas**2 * np.asarray(covariance, dtype=np.float64)
    if np.isfinite(spread).all() and spread.any():
        fill = make_disc(spread, centre, height)
        _AddMesh(meshcat, f"{path}/ellipse", fill, _fade(CENTRE_COLOR, ELLIPSE_OPACITY))
        _AddMesh(meshcat, f"{path}/rim", make_ring(spread, centre, height + LAYER, RIM_WIDTH), CENTRE_COLOR)


def AddGhost(meshcat: Meshcat, path: str, obj: GridObject, height: float, color: Rgba = PLAN_COLOR) -> None:
    """Draws a translucent prism of an object's outline, body frame, with its upper edge as an opaque band.

    Args:
        meshcat: where to draw.
        path: the prism is drawn at `path`/body, the edge at `path`/edge.
        obj: the object.
        height: of the object, m; the body ends a little below it and the edge lies a little above.
        color: of both.
    """
    _AddMesh(meshcat, f"{path}/body", make_outline_prism(obj, GHOST_SHARE * height), _fade(color, GHOST_OPACITY))
    edge = make_outline_edge(obj, height + LAYER / 2, EDGE_WIDTH)
    _AddMesh(meshcat, f"{path}/edge", edge, color)


def AddArrow(meshcat: Meshcat, path: str, start: ArrayLike, end: ArrayLike, height: float) -> None:
    """Draws a push from `start` (2,) to `end` (2,), world frame, m, as a flat arrow at z = `height`, m."""
    _AddMesh(meshcat, path, make_arrow(start, end, height, ARROW_WIDTH), PLAN_COLOR)


def ApplyTurn(meshcat: Meshcat, shown: str | None, hidden: str | None, time: float, period: float) -> None:
    """Shows one path instead of another, from `time` on, live and in the recording where one is made.

    Args:
        meshcat: the scene.
        shown: the path to be seen from now on; in the recording it is hidden before.
        hidden: the path to be seen no more; in the recording it stays as it is until a `period` before, at least.
        time: in the recording, s.
        period: what passed since the scene was drawn last, s.
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


def srgb_to_linear(srgb: NDArray[np.float64]) -> NDArray[np.float64]:
    """Colours (..., 3), 0 to 1, as linear light (IEC 61966-2-1)."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def _AddMesh(meshcat: Meshcat, path: str, mesh: TriangleMesh, color: Rgba) -> None:
    vertices, faces = _to_columns(mesh)
    meshcat.SetTriangleMesh(path, vertices, faces, color)


def _to_columns(mesh: TriangleMesh) -> tuple[Any, Any]:
    return mesh.vertices.T, mesh.faces.T


def _fade(color: Rgba, opacity: float) -> Rgba:
    return Rgba(color.r(), color.g(), color.b(), opacity)
