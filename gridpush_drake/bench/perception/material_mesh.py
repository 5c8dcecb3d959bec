"""Meshes with physically based materials, as glTF 2.0 in memory, for rendered photographs.

Drake's VTK renderer takes the color, the metalness and the roughness of such a mesh, and a picture
for its color, and lets an environment be reflected in it.
"""

import base64
import json
from itertools import pairwise
from typing import Any, NamedTuple

import cv2
import numpy as np
import shapely
from numpy.typing import NDArray
from pydrake.common import MemoryFile
from pydrake.geometry import InMemoryMesh, Mesh
from shapely import Polygon
from shapely.geometry.polygon import orient

from gridpush_drake.geometry.se2 import Array, IntArray

FLOAT_CODE = 5126
"""Code of 32-bit floats in glTF."""

UNSIGNED_CODE = 5125
"""Code of unsigned 32-bit whole numbers in glTF."""

TO_GLTF = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""Rotation from a frame whose z axis is up to glTF's, whose y axis is up."""


class Material(NamedTuple):
    """How a surface looks.

    Attributes:
        color: red, green and blue, 0 to 1, linear.
        metallic: 1 for metal, 0 for anything else.
        roughness: 0 for a mirror, 1 for chalk.
        texture: (h, w, 3) uint8 picture that the color is multiplied with; None for an even one.
    """

    color: tuple[float, float, float]
    metallic: float
    roughness: float
    texture: NDArray[np.uint8] | None = None


class _Surface(NamedTuple):
    """Triangles.

    Attributes:
        points: (n, 3) vertices, m.
        normals: (n, 3) unit normals there.
        texture: (n, 2) places in the texture, 0 to 1 for one whole picture.
        triangles: (k, 3) rows of vertices, counterclockwise as seen from outside.
    """

    points: Array
    normals: Array
    texture: Array
    triangles: IntArray


def make_prism_mesh(outline: Polygon, height: float, material: Material, tile: float) -> Mesh:
    """Makes the mesh of a prism that stands on z = 0.

    Args:
        outline: outline of the prism, m.
        height: height of the prism, m.
        material: how it looks.
        tile: side that one picture of the texture covers, m.

    Returns:
        The mesh.
    """
    whole = orient(outline)
    points: list[list[float]] = []
    normals: list[list[float]] = []
    triangles: list[list[int]] = []

    # The top, cut into triangles.
    for piece in shapely.constrained_delaunay_triangles(whole).geoms:
        corners = np.array(orient(piece).exterior.coords)[:3]
        first = len(points)
        points += [[*corner, height] for corner in corners]
        normals += [[0.0, 0.0, 1.0]] * 3
        triangles.append([first, first + 1, first + 2])

    # The sides, each a rectangle; their normals point out of the object, also in holes.
    for ring in (whole.exterior, *whole.interiors):
        corners = np.array(ring.coords)
        for a, b in pairwise(corners):
            along = b - a
            length = float(np.hypot(*along))
            first = len(points)
            points += [[*a, 0.0], [*b, 0.0], [*b, height], [*a, height]]
            normals += [[along[1] / length, -along[0] / length, 0.0]] * 4
            triangles += [[first, first + 1, first + 2], [first, first + 2, first + 3]]
    corners = np.array(points)
    surface = _Surface(corners, np.array(normals), corners[:, :2] / tile, np.array(triangles))
    return _make_mesh(surface, material)


def make_plane_mesh(size: float, material: Material, tile: float) -> Mesh:
    """Makes the mesh of a square plane z = 0.

    Args:
        size: its side, m.
        material: how it looks.
        tile: side that one picture of the texture covers, m.

    Returns:
        The mesh.
    """
    half = size / 2
    points = np.array(
        [[-half, -half, 0.0], [half, -half, 0.0], [half, half, 0.0], [-half, half, 0]]
    )
    normals = np.tile([0.0, 0.0, 1.0], (4, 1))
    triangles = np.array([[0, 1, 2], [0, 2, 3]])
    return _make_mesh(_Surface(points, normals, points[:, :2] / tile, triangles), material)


def _make_mesh(surface: _Surface, material: Material) -> Mesh:
    """Writes a surface as glTF and makes Drake's mesh of it."""
    arrays = [
        (surface.points @ TO_GLTF.T).astype("<f4"),
        (surface.normals @ TO_GLTF.T).astype("<f4"),
        surface.texture.astype("<f4"),
        surface.triangles.astype("<u4").reshape(-1, 1),
    ]
    kinds = ["VEC3", "VEC3", "VEC2", "SCALAR"]
    views = []
    accessors = []
    offset = 0
    for number, (array, kind) in enumerate(zip(arrays, kinds, strict=True)):
        views.append({"buffer": 0, "byteOffset": offset, "byteLength": array.nbytes})
        component = UNSIGNED_CODE if kind == "SCALAR" else FLOAT_CODE
        accessor: dict[str, Any] = {
            "bufferView": number,
            "componentType": component,
            "count": len(array),
            "type": kind,
            "min": array.min(axis=0).tolist(),
            "max": array.max(axis=0).tolist(),
        }
        accessors.append(accessor)
        offset += array.nbytes
    data = b"".join(array.tobytes() for array in arrays)
    surface_looks: dict[str, Any] = {
        "baseColorFactor": [*material.color, 1.0],
        "metallicFactor": material.metallic,
        "roughnessFactor": material.roughness,
    }
    attributes = {"POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 2}
    content: dict[str, Any] = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": 3, "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": surface_looks, "doubleSided": True}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(data), "uri": _embed(data, "application/octet-stream")}],
    }
    if material.texture is not None:
        _, png = cv2.imencode(".png", cv2.cvtColor(material.texture, cv2.COLOR_RGB2BGR))
        content["images"] = [{"uri": _embed(png.tobytes(), "image/png")}]
        content["textures"] = [{"source": 0}]
        surface_looks["baseColorTexture"] = {"index": 0}
    return Mesh(InMemoryMesh(mesh_file=MemoryFile(json.dumps(content), ".gltf", "mesh.gltf")))


def _embed(data: bytes, kind: str) -> str:
    """Writes bytes as an address that holds them itself."""
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"
