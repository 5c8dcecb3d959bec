"""The table's plane in a depth image, and how high everything stands above it.

Of a plane n.p = d in the camera frame, with the ray r = (x, y, 1) of each pixel, 1/z = (n/d).r:
linear in 1/z, so that three pixels give a plane, and many a least-squares one. A sensor's slow bias
over the picture is fitted besides.
"""

from dataclasses import dataclass

import numpy as np

from gridpush_drake.errors import ImageError, NoTableError
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.perception.camera import Camera
from gridpush_drake.perception.frames import MAX_DEPTH, MIN_DEPTH, Color, Depth

SAMPLES, TRIALS = 3000, 300
"""Pixels that planes are tried on, and planes tried."""

NEAR, BEHIND = 0.005, 0.012
"""m: a pixel nearer to the plane than this is of it; one this far behind it speaks against it:
objects stand on a table, nothing is beneath it."""

BEHIND_WEIGHT = 2.0

MIN_SHARE = 0.2
"""Of the measured pixels that are of the plane, least."""

MIN_MEASURED = 0.1
"""Of the picture that is measured, least."""

STRIDE = 3
"""Of the pixels that a fit looks at."""

REFINEMENTS, SPREAD = 8, 3.0
"""Least-squares fits, each to the pixels within so many standard deviations of the last."""

MIN_DEVIATION = 5e-4
"""m, of a plane's noise, that is ever assumed."""

BIAS_ORDER = 3
"""Of the polynomial over the picture that takes a sensor's slow bias."""

TO_DEVIATION = 1.4826
"""A standard deviation in medians of absolute deviations."""


@dataclass(frozen=True, eq=False)
class TablePlane:
    """A table, seen by a depth camera.

    Attributes:
        normal: (3,) unit normal in C, towards the camera.
        offset: distance of the plane from the camera, m: normal . p_C = -offset.
        heights: (height, width) of what each pixel shows above the table, m; NaN where it was not
            measured.
        deviation: standard deviation of the table's own heights, m.
    """

    normal: Array
    offset: float
    heights: Array
    deviation: float

    def make_pose(self, camera: Camera) -> Array:
        """(4, 4) X_WC: W's origin is where the optical axis meets the table, x to the right in the image, z up."""
        z = self.normal
        x = np.array([1.0, 0.0, 0.0]) - z[0] * z
        x /= np.linalg.norm(x)
        R_WC = np.array([x, np.cross(z, x), z])
        axis = np.array([0.0, 0.0, -self.offset / z[2]])
        X_WC = np.eye(4)
        X_WC[:3, :3], X_WC[:3, 3] = R_WC, -R_WC @ axis
        return X_WC


def fit_table(depth: Depth, camera: Camera, picture: Color) -> TablePlane:
    """Fits the table's plane.

    Args:
        depth: (height, width), m, undistorted; 0 or not finite where it was not measured.
        camera: that took it, without distortion; its pose is not used.
        picture: what to show where there is no table.

    Returns:
        The plane, and the heights above it.

    Raises:
        ImageError: the depth is not in meters.
        NoTableError: no plane takes a fair part of the picture.
    """
    valid = np.isfinite(depth) & (depth > 0)
    if valid.mean() < MIN_MEASURED:
        raise NoTableError(
            f"depth is measured in {valid.mean():.0%} of the picture; expected a table in view",
            picture,
        )
    median = float(np.median(depth[valid]))
    if not MIN_DEPTH <= median <= MAX_DEPTH:
        raise ImageError(
            f"the depth image's median is {median:g}; expected {MIN_DEPTH:g} to {MAX_DEPTH:g} m"
        )
    rays = make_rays(camera)[valid]
    z = np.asarray(depth[valid], dtype=np.float64)
    plane, share = _find_plane(rays, z)
    if share < MIN_SHARE:
        raise NoTableError(
            f"no plane takes more than {share:.0%} of the depth image; expected a table in view",
            picture,
        )
    plane = _refine(rays[::STRIDE], z[::STRIDE], plane)
    scale = 1 / np.linalg.norm(plane)
    heights = np.full(depth.shape, np.nan)
    heights[valid] = scale * (1 - z * (rays @ plane))
    heights, deviation = _take_bias(heights)
    return TablePlane(-plane * scale, float(scale), heights, deviation)


def make_rays(camera: Camera) -> Array:
    """(height, width, 3) directions in C, z = 1, of all pixels."""
    rows, columns = np.mgrid[: camera.height, : camera.width]
    return camera.rays(np.stack([columns, rows], axis=-1).astype(np.float64))


def make_basis(shape: tuple[int, ...], order: int) -> Array:
    """(height, width, m) monomials of total degree up to `order` over the picture, its sides at -1 and 1."""
    # Powers are taken of a row and a column only, which is a hundred times less than of every pixel.
    y, x = (np.linspace(-1, 1, side) for side in shape[:2])
    powers = [(i, j) for i in range(order + 1) for j in range(order + 1 - i)]
    basis = np.empty((len(y), len(x), len(powers)))
    for at, (i, j) in enumerate(powers):
        np.multiply(x[None, :] ** i, y[:, None] ** j, out=basis[..., at])
    return basis


def _find_plane(rays: Array, z: Array) -> tuple[Array, float]:
    """The plane n/d that most pixels are of and fewest behind, and its share."""
    rng = np.random.default_rng(0)
    chosen = rng.choice(len(z), min(SAMPLES, len(z)), replace=False)
    rays, z = rays[chosen], z[chosen]
    triples = rng.integers(len(z), size=(TRIALS, 3))
    systems = rays[triples]
    usable = np.abs(np.linalg.det(systems)) > np.finfo(float).eps
    planes = np.linalg.solve(systems[usable], 1 / z[triples][usable][..., None])[..., 0]
    heights = (1 - z * (planes @ rays.T)) / np.linalg.norm(planes, axis=1, keepdims=True)
    near = (np.abs(heights) < NEAR).mean(axis=1)
    behind = (heights < -BEHIND).mean(axis=1)
    best = int(np.argmax(near - BEHIND_WEIGHT * behind))
    return planes[best], float(near[best])


def _refine(rays: Array, z: Array, plane: Array) -> Array:
    limit = NEAR
    for _ in range(REFINEMENTS):
        heights = (1 - z * (rays @ plane)) / np.linalg.norm(plane)
        near = np.abs(heights) < limit
        weighted = rays[near] * z[near, None]
        plane = np.linalg.solve(weighted.T @ weighted, weighted.sum(axis=0))
        deviation = TO_DEVIATION * float(np.median(np.abs(heights[near])))
        limit = SPREAD * max(deviation, MIN_DEVIATION)
    return plane


def _take_bias(heights: Array) -> tuple[Array, float]:
    """Heights without the table's slow undulation, and their standard deviation on the table."""
    basis = make_basis(heights.shape, BIAS_ORDER)
    some = heights[::STRIDE, ::STRIDE]
    A = basis[::STRIDE, ::STRIDE][np.isfinite(some)]
    some = some[np.isfinite(some)]
    limit, off, deviation = NEAR, some, 0.0
    for _ in range(REFINEMENTS):
        near = np.abs(off) < limit
        bias = np.linalg.solve(A[near].T @ A[near], A[near].T @ some[near])
        off = some - A @ bias
        deviation = max(TO_DEVIATION * float(np.median(np.abs(off[near]))), MIN_DEVIATION)
        limit = min(NEAR, SPREAD * deviation)
    return heights - basis @ bias, deviation
