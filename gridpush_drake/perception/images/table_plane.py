"""The table's plane in a depth image, and how high everything stands above it.

Of a plane n.p = d in the camera frame, with the ray r = (x, y, 1) of each pixel, 1/z = (n/d).r:
linear in 1/z, so that three pixels give a plane, and many a least-squares one. A sensor's slow bias
over the picture is fitted besides.

What on the table is an object is told in `foreground`. The theory is in docs/theory/perception.md,
section 1.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.errors import ImageError, NoTableError
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.perception.images.camera import Camera
from gridpush_drake.perception.images.frames import MAX_DEPTH, MIN_DEPTH, Color, Depth

Heights = NDArray[np.floating[Any]]
"""Heights above the table, m, in either precision; NaN where depth was not measured."""

SAMPLE_COUNT = 3000
"""Pixels that planes are tried on; fewer are tried if depth is measured in fewer."""

TRIAL_COUNT = 300
"""Planes that are tried, each through three of those pixels."""

PLANE_DISTANCE = 0.005
"""A pixel that is nearer to a plane than this counts as lying on it, m."""

BEHIND_DISTANCE = 0.012
"""A pixel that is further than this behind a plane speaks against it, m: objects stand on a table,
and nothing is beneath it."""

BEHIND_WEIGHT = 2.0
"""How many pixels on a plane it takes to outweigh one that is behind it."""

MIN_FRACTION = 0.2
"""Least fraction of the measured pixels that lie on the table; with less there is no table in
view."""

MIN_MEASURED = 0.1
"""Least fraction of the picture in which depth is measured; with less no table is looked for."""

PIXEL_STRIDE = 3
"""Fits look at one pixel of this many; neighboring pixels tell nearly the same."""

REFINEMENT_COUNT = 8
"""Number of least-squares fits, each to the pixels that are near the fit before."""

OUTLIER_SIGMAS = 3.0
"""A pixel further from a fit than this is left out of the next one, standard deviations."""

MIN_DEVIATION = 5e-4
"""Least standard deviation of the heights measured on a table that is assumed, m."""

BIAS_ORDER = 3
"""Degree of the polynomial over the picture that takes a sensor's slow bias."""

TO_DEVIATION = 1.4826
"""Standard deviation of a normal distribution over the median of its absolute deviations."""


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
    heights: Heights
    deviation: float

    def make_pose(self, camera: Camera) -> Array:
        """Makes the pose of the camera in a world whose z = 0 is the table.

        Args:
            camera: camera that saw the table.

        Returns:
            (4, 4) X_WC: W's origin is where the optical axis meets the table, x to the right in the
            image, z up.
        """
        # W's axes in C: z is the normal, x the image's right without its part along z.
        z = self.normal
        x = np.array([1.0, 0.0, 0.0]) - z[0] * z
        x /= np.linalg.norm(x)
        R_WC = np.array([x, np.cross(z, x), z])

        # W's origin in C, from normal . p_C = -offset on the optical axis.
        origin = np.array([0.0, 0.0, -self.offset / z[2]])
        X_WC = np.eye(4)
        X_WC[:3, :3] = R_WC
        X_WC[:3, 3] = -R_WC @ origin
        return X_WC


def fit_table(depth: Depth, camera: Camera, picture: Color) -> TablePlane:
    """Fits the table's plane.

    Args:
        depth: (height, width), m, undistorted; 0 or not finite where it was not measured.
        camera: camera that took it, without distortion; its pose is not used.
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

    # RANSAC finds which plane is the table, least squares where exactly it is.
    rays = make_rays(camera)[valid]
    z = np.asarray(depth[valid], dtype=np.float64)
    plane, fraction = _find_plane(rays, z)
    if fraction < MIN_FRACTION:
        raise NoTableError(
            f"no plane takes more than {fraction:.0%} of the depth image; expected a table in view",
            picture,
        )
    plane = _refine(rays[::PIXEL_STRIDE], z[::PIXEL_STRIDE], plane)

    # Heights above it: 1 - z (n/d).r is 0 on the plane, and 1/|n/d| the camera's distance.
    scale = 1 / np.linalg.norm(plane)
    heights = np.full(depth.shape, np.nan)
    heights[valid] = scale * (1 - z * (rays @ plane))
    heights, deviation = _take_bias(heights)
    return TablePlane(
        normal=-plane * scale, offset=float(scale), heights=heights, deviation=deviation
    )


def make_rays(camera: Camera) -> Array:
    """Makes the rays r of all pixels: (height, width, 3) directions in C with z = 1."""
    rows, columns = np.mgrid[: camera.height, : camera.width]
    return camera.rays(np.stack([columns, rows], axis=-1).astype(np.float64))


def make_basis(shape: tuple[int, ...], order: int, stride: int = 1) -> Array:
    """Makes the monomials of a polynomial over a picture.

    Args:
        shape: height and width of the picture, and anything after them.
        order: degree of the polynomial.
        stride: of so many rows and columns only the first is taken.

    Returns:
        (height, width, m) monomials of total degree up to `order`, with the picture's sides at -1
        and 1; with a stride, as many rows and columns as are taken.
    """
    # Powers are taken of a row and a column only, which is a hundred times less work than of every
    # pixel.
    y, x = (side[::stride] for side in _make_sides(shape))
    powers = _list_powers(order)
    basis = np.empty((len(y), len(x), len(powers)))
    for at, (i, j) in enumerate(powers):
        columns = x[None, :] ** i
        rows = y[:, None] ** j
        np.multiply(columns, rows, out=basis[..., at])
    return basis


def calc_polynomial(shape: tuple[int, ...], order: int, coefficients: Array) -> Array:
    """Calculates polynomials over a whole picture: rows by columns, without its monomials.

    Args:
        shape: height and width of the picture, and anything after them.
        order: degree of the polynomials.
        coefficients: (m, c) of the monomials of `make_basis`, of each of c polynomials.

    Returns:
        (height, width, c) their values.
    """
    y, x = _make_sides(shape)
    # By the powers of y and x, and the polynomial.
    table = np.zeros((order + 1, order + 1, coefficients.shape[1]))
    for at, (i, j) in enumerate(_list_powers(order)):
        table[j, i] = coefficients[at]
    of_rows = np.tensordot(np.vander(y, order + 1, increasing=True), table, axes=1)
    return np.asarray(np.vander(x, order + 1, increasing=True) @ of_rows)


def _make_sides(shape: tuple[int, ...]) -> tuple[Array, Array]:
    """Makes the rows' and the columns' places in a picture, from -1 to 1."""
    return np.linspace(-1, 1, shape[0]), np.linspace(-1, 1, shape[1])


def _list_powers(order: int) -> list[tuple[int, int]]:
    """Lists the powers of x and y in each monomial of total degree up to `order`."""
    return [(i, j) for i in range(order + 1) for j in range(order + 1 - i)]


def _find_plane(rays: Array, z: Array) -> tuple[Array, float]:
    """Finds the plane on which most pixels lie, and fewest behind it (RANSAC).

    Args:
        rays: (k, 3) rays of the measured pixels.
        z: (k,) depth of each, m.

    Returns:
        (3,) n/d, 1/m, and the fraction of pixels on it.
    """
    # A sample of the pixels, so that every trial costs the same.
    rng = np.random.default_rng(0)
    chosen = rng.choice(len(z), min(SAMPLE_COUNT, len(z)), replace=False)
    rays = rays[chosen]
    z = z[chosen]

    # A plane through three pixels each, from 1/z = (n/d).r; three on a line determine none.
    triples = rng.integers(len(z), size=(TRIAL_COUNT, 3))
    systems = rays[triples]
    usable = np.abs(np.linalg.det(systems)) > np.finfo(float).eps
    inverse_depth = 1 / z[triples][usable]
    solved = np.linalg.solve(systems[usable], inverse_depth[..., None])
    planes = solved[..., 0]

    # The top of a large box has many pixels on it, too, and the table behind it.
    lengths = np.linalg.norm(planes, axis=1, keepdims=True)
    heights = (1 - z * (planes @ rays.T)) / lengths
    near = (np.abs(heights) < PLANE_DISTANCE).mean(axis=1)
    behind = (heights < -BEHIND_DISTANCE).mean(axis=1)
    best = int(np.argmax(near - BEHIND_WEIGHT * behind))
    return planes[best], float(near[best])


def _refine(rays: Array, z: Array, plane: Array) -> Array:
    """Refines a plane n/d (3,) by least squares over the pixels near it.

    Args:
        rays: (k, 3) rays of pixels.
        z: (k,) depth of each, m.
        plane: (3,) the plane to begin with, 1/m.

    Returns:
        (3,) the plane, 1/m.
    """
    limit = PLANE_DISTANCE
    for _ in range(REFINEMENT_COUNT):
        inverse_depth = rays @ plane
        heights = (1 - z * inverse_depth) / np.linalg.norm(plane)
        near = np.abs(heights) < limit

        # Rows are weighted by z, so that what is least is 1 - z (n/d).r, which goes with height.
        weighted = rays[near] * z[near, None]
        plane = np.linalg.solve(weighted.T @ weighted, weighted.sum(axis=0))
        deviation = TO_DEVIATION * float(np.median(np.abs(heights[near])))
        limit = OUTLIER_SIGMAS * max(deviation, MIN_DEVIATION)
    return plane


def _take_bias(heights: Array) -> tuple[Array, float]:
    """Takes the table's slow undulation, the sensor's bias, out of heights.

    Args:
        heights: (height, width) above the plane, m; NaN where depth was not measured.

    Returns:
        (height, width) heights without it, m, and their standard deviation on the table, m.
    """
    basis = make_basis(heights.shape, BIAS_ORDER)
    some = heights[::PIXEL_STRIDE, ::PIXEL_STRIDE]
    measured = np.isfinite(some)
    A = basis[::PIXEL_STRIDE, ::PIXEL_STRIDE]
    A = A[measured]
    some = some[measured]

    # Objects are left out because they are further from the fit than the table's noise.
    limit = PLANE_DISTANCE
    off = some
    deviation = 0.0
    for _ in range(REFINEMENT_COUNT):
        near = np.abs(off) < limit
        # A[near] is copied twice on purpose: of one array with itself NumPy makes the product by
        # another BLAS function, and the last bits of all heights would no longer be what they were.
        bias = np.linalg.solve(A[near].T @ A[near], A[near].T @ some[near])
        off = some - A @ bias
        scatter = TO_DEVIATION * float(np.median(np.abs(off[near])))
        deviation = max(scatter, MIN_DEVIATION)
        limit = min(PLANE_DISTANCE, OUTLIER_SIGMAS * deviation)
    return heights - basis @ bias, deviation
