"""Photographs of prisms on a table, painted by polygon filling: another way than any renderer, and quick."""

import cv2
import numpy as np
from scipy.spatial.transform import Rotation
from shapely import Polygon

from gridpush_drake.geometry.se2 import transform
from gridpush_drake.perception import Camera, Frame

FINE = 4
"""Side of a pixel in the pixels that are painted."""

SHIFT = 4
"""Bits of a fraction in cv2's drawing."""


def make_camera(width=640, height=480, focal=600.0, distance=0.7, rpy=(180, 0, 0), at=(0.0, 0.0), distortion=()):
    X_WC = np.eye(4)
    X_WC[:3, :3] = Rotation.from_euler("xyz", rpy, degrees=True).as_matrix()
    X_WC[:3, 3] = [*at, distance]
    K = [[focal, 0, width / 2 - 0.5], [0, focal, height / 2 - 0.5], [0, 0, 1]]
    return Camera(width, height, K, distortion, X_WC)


def paint(camera, prisms, seed=0, t=0.0, table=(170, 168, 160), noise=2.0, depth=True, shade=0.25, shadow=0.0):
    """A frame of prisms (outline (k, 2) in B, pose (3,), height, color), the lowest first."""
    rng = np.random.default_rng(seed)
    h, w = camera.height, camera.width
    rows, columns = np.mgrid[0:h, 0:w]
    light = 1 - shade * (columns / w - 0.3) ** 2 - shade * (rows / h) ** 2 / 2
    color = light[..., None] * np.array(table, dtype=float)
    rays = camera.undistorted.rays(np.stack([columns, rows], -1).astype(float))
    z_table = -camera.X_WC[2, 3] / (rays @ camera.X_WC[2, :3])
    z = z_table.copy()
    for outline, pose, height, tint in prisms:
        if shadow:
            soft = cv2.GaussianBlur(cover(camera, outline, pose, height, (0, -0.012)), (0, 0), 5)
            color *= (1 - shadow * soft)[..., None]
        sides = cover(camera, outline, pose, height)
        top = cover(camera, outline, pose, height, bottom=False)
        color += sides[..., None] * (0.6 * np.array(tint) - color)
        color += top[..., None] * (np.array(tint) - color)
        z = np.where(sides > 0.5, z_table - height / 2, z)
        z = np.where(top > 0.5, -(camera.X_WC[2, 3] - height) / (rays @ camera.X_WC[2, :3]), z)
    color = np.clip(color + noise * rng.standard_normal(color.shape), 0, 255).astype(np.uint8)
    z = z + 0.0012 * rng.standard_normal(z.shape)
    return Frame(color, z.astype(np.float32) if depth else None, t)


def cover(camera, outline, pose, height, shift=(0.0, 0.0), bottom=True):
    """How much of each pixel of the undistorted picture a prism covers, or its top alone."""
    p_W = transform(pose, np.asarray(outline)) + shift
    fine = np.zeros((camera.height * FINE, camera.width * FINE), np.uint8)
    levels = np.linspace(0, height, 2) if bottom else [height]
    rings = [
        (camera.undistorted.project(np.column_stack([p_W, np.full(len(p_W), z)])) + 0.5) * FINE - 0.5 for z in levels
    ]
    polygons = list(rings)
    if bottom:
        low, high = rings
        for i in range(len(low)):
            j = (i + 1) % len(low)
            polygons.append(np.array([low[i], low[j], high[j], high[i]]))
    for polygon in polygons:
        cv2.fillPoly(fine, [np.round(polygon * 2**SHIFT).astype(np.int32)], 255, shift=SHIFT)
    return cv2.resize(fine, (camera.width, camera.height), interpolation=cv2.INTER_AREA) / 255.0


def calc_outline_error(found: Polygon, true: Polygon) -> float:
    """Mean distance between two outlines, both ways, m."""

    def one_way(a, b):
        points = [a.exterior.interpolate(s, normalized=True) for s in np.linspace(0, 1, 400)]
        return np.mean([b.exterior.distance(p) for p in points])

    return (one_way(found, true) + one_way(true, found)) / 2
