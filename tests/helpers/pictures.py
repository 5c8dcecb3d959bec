"""Photographs of prisms on a table, painted by polygon filling: another way than any renderer, and quick."""

import cv2
import numpy as np
import shapely
from scipy.spatial.transform import Rotation
from shapely import Polygon

from gridpush_drake.geometry.se2 import transform
from gridpush_drake.perception import Camera, Frame

FINE = 4
"""Side of a pixel in the pixels that are painted."""

SHIFT = 4
"""Bits of a fraction in cv2's drawing."""


def make_camera(
    width=640, height=480, focal=600.0, distance=0.7, rpy=(180, 0, 0), at=(0.0, 0.0), distortion=()
):
    X_WC = np.eye(4)
    X_WC[:3, :3] = Rotation.from_euler("xyz", rpy, degrees=True).as_matrix()
    X_WC[:3, 3] = [*at, distance]
    K = [[focal, 0, width / 2 - 0.5], [0, focal, height / 2 - 0.5], [0, 0, 1]]
    return Camera(width, height, K, distortion, X_WC)


def paint(
    camera,
    prisms,
    seed=0,
    t=0.0,
    table=(170, 168, 160),
    noise=2.0,
    depth=True,
    shade=0.25,
    shadow=0.0,
):
    """A frame of prisms (outline (k, 2) in B, pose (3,), height, color), the lowest first."""
    rng = np.random.default_rng(seed)
    h, w = camera.height, camera.width
    rays, z_table = _cast_rays(camera)
    rows, columns = np.ogrid[0:h, 0:w]
    light = 1 - shade * (columns / w - 0.3) ** 2 - shade * (rows / h) ** 2 / 2
    color = light[..., None] * np.array(table, dtype=float)
    z = z_table.copy()
    for outline, pose, height, tint in prisms:
        if shadow:
            soft = cv2.GaussianBlur(cover(camera, outline, pose, height, (0, -0.012)), (0, 0), 5)
            color *= (1 - shadow * soft)[..., None]
        # Sides and top are painted where the prism is alone: the rest of the picture is as it was.
        part, sides = _cover_part(camera, outline, pose, height)
        color[part] += sides[..., None] * (0.6 * np.array(tint) - color[part])
        z[part] = np.where(sides > 0.5, z_table[part] - height / 2, z[part])
        part, top = _cover_part(camera, outline, pose, height, bottom=False)
        color[part] += top[..., None] * (np.array(tint) - color[part])
        z_top = -(camera.X_WC[2, 3] - height) / (rays[part] @ camera.X_WC[2, :3])
        z[part] = np.where(top > 0.5, z_top, z[part])
    color = np.clip(color + noise * rng.standard_normal(color.shape), 0, 255).astype(np.uint8)
    z = z + 0.0012 * rng.standard_normal(z.shape)
    return Frame(color, z.astype(np.float32) if depth else None, t)


_RAYS: dict[int, tuple] = {}
"""What `_cast_rays` found of the last cameras, by their `id`; each camera is held, too."""


def _cast_rays(camera):
    """The rays of all pixels (height, width, 3), and the table's depths (height, width), m."""
    if id(camera) not in _RAYS:
        rows, columns = np.mgrid[0 : camera.height, 0 : camera.width]
        rays = camera.undistorted.rays(np.stack([columns, rows], -1).astype(float))
        z_table = -camera.X_WC[2, 3] / (rays @ camera.X_WC[2, :3])
        if len(_RAYS) > 2:
            _RAYS.clear()
        _RAYS[id(camera)] = camera, rays, z_table
    return _RAYS[id(camera)][1:]


def cover(camera, outline, pose, height, shift=(0.0, 0.0), bottom=True):
    """How much of each pixel of the undistorted picture a prism covers, or its top alone."""
    covered = np.zeros((camera.height, camera.width))
    part, fraction = _cover_part(camera, outline, pose, height, shift, bottom)
    covered[part] = fraction
    return covered


def _cover_part(camera, outline, pose, height, shift=(0.0, 0.0), bottom=True):
    """The same of a part of the picture, outside of which nothing is covered: its slices, too."""
    p_W = transform(pose, np.asarray(outline)) + shift
    levels = np.linspace(0, height, 2) if bottom else [height]
    rings = [
        camera.undistorted.project(np.column_stack([p_W, np.full(len(p_W), z)])) for z in levels
    ]
    corners = np.concatenate(rings)
    size = np.array([camera.width, camera.height])
    low = np.clip(np.floor(corners.min(axis=0)).astype(int) - 1, 0, size)
    high = np.clip(np.ceil(corners.max(axis=0)).astype(int) + 2, low, size)
    part = slice(low[1], high[1]), slice(low[0], high[0])
    width, length = high - low
    if not width * length:
        return part, np.zeros((length, width))
    rings = [(ring - low + 0.5) * FINE - 0.5 for ring in rings]
    polygons = list(rings)
    if bottom:
        lower, upper = rings
        for i in range(len(lower)):
            j = (i + 1) % len(lower)
            polygons.append(np.array([lower[i], lower[j], upper[j], upper[i]]))
    fine = np.zeros((length * FINE, width * FINE), np.uint8)
    for polygon in polygons:
        cv2.fillPoly(fine, [np.round(polygon * 2**SHIFT).astype(np.int32)], 255, shift=SHIFT)
    covered = cv2.resize(fine, (int(width), int(length)), interpolation=cv2.INTER_AREA) / 255.0
    return part, covered


def calc_outline_error(found: Polygon, true: Polygon) -> float:
    """Mean distance between two outlines, both ways, m."""

    def one_way(a, b):
        fractions = np.linspace(0, 1, 400)
        points = shapely.line_interpolate_point(a.exterior, fractions, normalized=True)
        return shapely.distance(b.exterior, points).mean()

    return (one_way(found, true) + one_way(true, found)) / 2


TAG_PIXELS = 40
"""Of a bit of a tag that is to be painted."""


def paint_tag(color, camera, number, corners, seed=0):
    """The photograph with an AprilTag 36h11 whose corners (4, 3) are in W, and white about it."""
    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    side = 8 * TAG_PIXELS
    tag = np.pad(
        cv2.aruco.generateImageMarker(family, number, side), TAG_PIXELS, constant_values=255
    )
    middle = corners.mean(axis=0)
    low, high = -0.5, side + 2 * TAG_PIXELS - 0.5
    square = np.array([[low, low], [high, low], [high, high], [low, high]])
    rows, columns = np.mgrid[0 : camera.height, 0 : camera.width]
    fine = (np.arange(FINE) + 0.5) / FINE - 0.5
    total, weight = np.zeros((camera.height, camera.width)), np.zeros((camera.height, camera.width))
    outer = middle + (corners - middle) * (10 / 8)
    to_tag = cv2.getPerspectiveTransform(outer[:, :2].astype(np.float32), square.astype(np.float32))
    bounds = camera.project(outer)
    x0, y0 = np.maximum(np.floor(bounds.min(axis=0)).astype(int) - 2, 0)
    x1, y1 = np.ceil(bounds.max(axis=0)).astype(int) + 3
    part = (slice(y0, y1), slice(x0, x1))
    for dx in fine:
        for dy in fine:
            pixels = np.stack([columns[part] + dx, rows[part] + dy], -1).astype(float)
            p_W = camera.cast(pixels, float(middle[2]))
            places = cv2.perspectiveTransform(p_W.reshape(1, -1, 2), to_tag.astype(float)).reshape(
                p_W.shape
            )
            values = cv2.remap(
                tag, places.astype(np.float32), None, cv2.INTER_LINEAR, borderValue=0
            )
            inside = ((places > low) & (places < high)).all(axis=-1)
            total[part] += values * inside
            weight[part] += inside
    fraction = (weight / FINE**2)[..., None]
    shade = 0.85 * total / np.maximum(weight, 1) + 15
    noise = 2.0 * np.random.default_rng((seed, number)).standard_normal(shade.shape)
    return np.clip(fraction * (shade + noise)[..., None] + (1 - fraction) * color, 0, 255).astype(
        np.uint8
    )
