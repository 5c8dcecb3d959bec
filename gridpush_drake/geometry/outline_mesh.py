"""An outline as a solid: an area cut into triangles, and its prism as a mesh file.

Drake's renderers, Meshcat and SDFormat files all show an object as the prism of its outline.
Areas are shapely's, meshes trimesh's.
"""

import numpy as np
import trimesh
from numpy.typing import NDArray
from shapely import MultiPolygon, Polygon, constrained_delaunay_triangles

from gridpush_drake.geometry.se2 import Array


def make_outline_mesh(outline: Polygon, height: float, normals: bool = False) -> str:
    """Makes a closed prism of an outline, m, from z = 0 to `height`, m, as Wavefront OBJ text, faces outwards.

    With `normals` each face has its own vertices with normals, as renderers want them.
    """
    mesh = trimesh.creation.extrude_triangulation(*triangulate_area(outline), height)
    if normals:
        mesh.unmerge_vertices()
    return str(
        mesh.export(file_type="obj", include_normals=normals, header="prism of an outline, m")
    )


def triangulate_area(area: Polygon | MultiPolygon) -> tuple[Array, NDArray[np.int64]]:
    """Cuts an area into triangles.

    Returns:
        The corners (k, 2), each once, m, and the triangles (m, 3) as indices of corners.
    """
    triangles = constrained_delaunay_triangles(area).geoms
    corners, faces = np.unique(
        np.concatenate([np.array(triangle.exterior.coords)[:3, :2] for triangle in triangles]),
        axis=0,
        return_inverse=True,
    )
    return corners, faces.reshape(-1, 3)
