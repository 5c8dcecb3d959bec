"""An outline as a solid: an area cut into triangles, and its prism as a mesh file.

Drake's renderers, Meshcat and SDFormat files all show an object as the prism of its outline. The
meshes are for eyes and cameras only; contact is calculated with the outline itself, or with the
cells. Areas are shapely's, meshes trimesh's.
"""

import numpy as np
import trimesh
from shapely import MultiPolygon, Polygon, constrained_delaunay_triangles

from gridpush_drake.geometry.se2 import Array, IntArray


def make_outline_mesh(outline: Polygon, height: float, normals: bool = False) -> str:
    """Makes a closed prism of an outline, as the text of a Wavefront OBJ file.

    Args:
        outline: the outline, body frame, m.
        height: the prism reaches from z = 0 to this height, m.
        normals: whether each face has its own vertices, with normals, as renderers want them.

    Returns:
        The text; the faces are seen counterclockwise from outside.
    """
    corners, triangles = triangulate_area(outline)
    mesh = trimesh.creation.extrude_triangulation(corners, triangles, height)
    if normals:
        mesh.unmerge_vertices()
    text = mesh.export(file_type="obj", include_normals=normals, header="prism of an outline, m")
    return str(text)


def triangulate_area(area: Polygon | MultiPolygon) -> tuple[Array, IntArray]:
    """Cuts an area into triangles.

    Args:
        area: the area, m.

    Returns:
        The corners (k, 2), each once, m, and the triangles (m, 3) as indices of corners.
    """
    triangles = constrained_delaunay_triangles(area).geoms
    # The ring of a triangle has its first corner once more at the end.
    rings = [triangle.exterior.coords for triangle in triangles]
    all_corners = [np.array(ring)[:3, :2] for ring in rings]
    joined = np.concatenate(all_corners)
    corners, faces = np.unique(joined, axis=0, return_inverse=True)
    return corners, faces.reshape(-1, 3)
