"""The inner loops over pixels and over points of a boundary, compiled.

They are what the tracker does with each picture of a camera. What they are for is said where they
are called: `foreground` tells the object from the table by the first two, and `registration` moves
an outline onto its edges by the others. The equations are in docs/theory/perception.md.

Images are float32, with the color's three channels last; places are x and y, pixels.
"""

from math import floor, sqrt
from typing import Any, NamedTuple

import numpy as np

from gridpush_drake.dynamics.kernels.compiled import kernel

EDGE_COVERAGE = 0.5
"""Coverage of a pixel at the object's edge; a pixel with more is object."""

EDGE_FOUND = 0
"""State of a point of the boundary whose edge was found."""

EDGE_MISSING = 1
"""State of a point of the boundary that is in plain view and has no edge."""

EDGE_COVERED = 2
"""State of a point of the boundary that has no edge because something covers it or the picture ends
there; it says nothing of the pose."""

_TINY = 1e-30
"""Least norm that is divided by."""


BLOCK_SIZE = 4
"""Side of the blocks of pixels in which colors are summed up, pixels: means over many pixels change
little from one pixel to the next."""


class ColorLevel(NamedTuple):
    """How the way from the table's color to the object's is measured; see `foreground`.

    Attributes:
        min_contrast: added to the squared difference of the two mean colors.
        light_weight: weight of lightness, which is the first channel of the colors.
        too_dark: darkening beyond which a pixel may be more than a shadow, units of CIE L*.
        dark: darkening beyond which it surely is, units of CIE L*.
    """

    min_contrast: Any
    light_weight: Any
    too_dark: Any
    dark: Any


@kernel(allocates=False)
def calc_color_distances(difference, deviation, shadow, distances):
    """Calculates the squared distance of colors from the table's, in the table's variances.

    Args:
        difference: (h, w, 3) color less the table's, CIE L*a*b*.
        deviation: (3,) standard deviations of the table's color.
        shadow: standard deviation of lightness where a pixel is darker than the table.
        distances: (h, w), is filled.
    """
    # One over the variance of each channel, for division is slow.
    light = np.float32(1.0 / deviation[0] ** 2)
    darker = np.float32(1.0 / max(shadow, deviation[0]) ** 2)
    chroma_a = np.float32(1.0 / deviation[1] ** 2)
    chroma_b = np.float32(1.0 / deviation[2] ** 2)
    for row in range(difference.shape[0]):
        for column in range(difference.shape[1]):
            L = difference[row, column, 0]
            a = difference[row, column, 1]
            b = difference[row, column, 2]
            # tau: shadows change lightness, hardly chroma.
            weight = light
            if L < 0:
                weight = darker
            distances[row, column] = a * a * chroma_a + b * b * chroma_b + L * L * weight


@kernel()
def sum_blocks(colors, in_object, in_table):
    """Sums up the colors of the object's and of the table's pixels in blocks of pixels.

    Args:
        colors: (h, w, 3) colors.
        in_object: (h, w) bool, pixels that count for the object.
        in_table: (h, w) bool, pixels that count for the table.

    Returns:
        Two arrays (m, n, 4), of the object and of the table: the sums of colors in each block of
        BLOCK_SIZE x BLOCK_SIZE pixels and, last, the numbers of pixels.
    """
    rows, columns = in_object.shape
    # The last block of a row or a column may have fewer pixels; their number says so.
    m = -(-rows // BLOCK_SIZE)
    n = -(-columns // BLOCK_SIZE)
    inside = np.zeros((m, n, 4), dtype=np.float32)
    outside = np.zeros((m, n, 4), dtype=np.float32)
    # What is in neither, the strip at the boundary, counts for nothing.
    for row in range(rows):
        for column in range(columns):
            if in_object[row, column]:
                into = inside[row // BLOCK_SIZE, column // BLOCK_SIZE]
            elif in_table[row, column]:
                into = outside[row // BLOCK_SIZE, column // BLOCK_SIZE]
            else:
                continue
            for i in range(3):
                into[i] += colors[row, column, i]
            into[3] += np.float32(1.0)
    return inside, outside


@kernel(allocates=False)
def calc_levels(colors, inside, outside, where, law, levels):
    """Calculates how far colors are from half way between the object's and the table's nearby.

    Args:
        colors: (h, w, 3) colors, lightness weighted.
        inside: (m, n, 4) sums of the object's colors nearby and, last, of their weights, for each
            block of pixels; see `sum_blocks`.
        outside: (m, n, 4) the table's.
        where: (h, w) uint8, only pixels where this is not 0 are filled.
        law: a `ColorLevel`.
        levels: (h, w), -0.5 at the color outside and 0.5 at the color inside.
    """
    rows, columns = where.shape
    last_row = inside.shape[0] - 1
    last_column = inside.shape[1] - 1
    for row in range(rows):
        # The two coarse rows about this one, and the fraction of the second.
        y = min(max((row + EDGE_COVERAGE) / BLOCK_SIZE - EDGE_COVERAGE, 0.0), float(last_row))
        top = min(int(y), max(last_row - 1, 0))
        bottom = min(top + 1, last_row)
        below = np.float32(y - top)
        for column in range(columns):
            # Most of a picture is far from the boundary, and costs nothing.
            if where[row, column] == 0:
                continue
            # The two coarse columns likewise.
            x = min(
                max((column + EDGE_COVERAGE) / BLOCK_SIZE - EDGE_COVERAGE, 0.0), float(last_column)
            )
            left = min(int(x), max(last_column - 1, 0))
            right = min(left + 1, last_column)
            beside = np.float32(x - left)
            levels[row, column] = _calc_level(
                colors[row, column],
                inside,
                outside,
                (top, bottom, left, right),
                (below, beside),
                law,
            )


@kernel(allocates=False)
def _calc_level(color, inside, outside, corners, fractions, law):
    """Calculates the level of one pixel; see `calc_levels`."""
    weight_in = _mix(inside, 3, corners, fractions) + np.float32(_TINY)
    weight_out = _mix(outside, 3, corners, fractions) + np.float32(_TINY)
    square = np.float32(law.min_contrast)
    along = np.float32(0.0)
    squared_distance = np.float32(0.0)
    drop = np.float32(0.0)
    # (c - (c_o + c_t)/2).(c_o - c_t) / |c_o - c_t|^2, summed up channel by channel.
    for i in range(3):
        c_o = _mix(inside, i, corners, fractions) / weight_in
        c_t = _mix(outside, i, corners, fractions) / weight_out
        step = c_o - c_t
        off = color[i] - c_t
        square += step * step
        along += (color[i] - np.float32(EDGE_COVERAGE) * (c_o + c_t)) * step
        squared_distance += off * off
        if i == 0:
            drop = -off / np.float32(law.light_weight)
    along /= square

    # What is too dark for a shadow is object in whatever direction its color lies: a side in the
    # dark has not the color of the top.
    if drop > law.too_dark:
        distance = np.float32(sqrt(squared_distance / square)) - np.float32(EDGE_COVERAGE)
        no_shadow = min((drop - law.too_dark) / (law.dark - law.too_dark), 1.0)
        along += np.float32(no_shadow) * max(distance - along, np.float32(0.0))
    return min(max(along, np.float32(-EDGE_COVERAGE)), np.float32(EDGE_COVERAGE))


@kernel(allocates=False)
def _mix(image, channel, corners, fractions):
    """Interpolates a channel between four pixels."""
    top, bottom, left, right = corners
    below, beside = fractions
    one = np.float32(1.0)
    upper = (one - beside) * image[top, left, channel] + beside * image[top, right, channel]
    lower = (one - beside) * image[bottom, left, channel] + beside * image[bottom, right, channel]
    return (one - below) * upper + below * lower


@kernel(allocates=False)
def _sample(image, x, y):
    """Interpolates an image of one channel between its pixels; outside of it everything is 0."""
    rows, columns = image.shape
    left = floor(x)
    top = floor(y)
    if left < -1 or top < -1 or left >= columns or top >= rows:
        return 0.0
    beside = x - left
    below = y - top
    # Pixels that are not there count as 0.
    value = 0.0
    for i in range(2):
        row = top + i
        if row < 0 or row >= rows:
            continue
        fraction = below if i else 1.0 - below
        for j in range(2):
            column = left + j
            if column < 0 or column >= columns:
                continue
            value += fraction * (beside if j else 1.0 - beside) * image[row, column]
    return value


class Across(NamedTuple):
    """Where an edge is looked for across the expected boundary.

    Attributes:
        reach: how far to look inward and outward, pixels.
        step: distance between two samples, pixels.
        count: number of samples, from inside to outside.
    """

    reach: Any
    step: Any
    count: Any


@kernel(allocates=False)
def find_edges(coverage, covered, pixels, normals, across, offsets, state):
    """Looks for the object's edge across its expected boundary.

    An edge is where the coverage falls through a half, and both samples about it show something.
    Its place is interpolated between them. Of several, the nearest to the boundary counts.

    Args:
        coverage: (h, w) fraction of each pixel that is object.
        covered: (h, w) uint8, not 0 where a pixel says nothing.
        pixels: (n, 2) points of the expected boundary.
        normals: (n, 2) outward unit normals there, in the picture.
        across: an `Across`.
        offsets: (n,) is filled with how far outward the nearest edge is, pixels, NaN where there
            is none.
        state: (n,) is filled with EDGE_FOUND, EDGE_MISSING or EDGE_COVERED.
    """
    last_x = coverage.shape[1] - 1
    last_y = coverage.shape[0] - 1
    for i in range(len(pixels)):
        nearest = np.inf
        unseen = False
        before = 0.0
        occluded_before = True
        # From inside to outside, as the coverage falls.
        for k in range(across.count):
            offset = k * across.step - across.reach
            x = pixels[i, 0] + offset * normals[i, 0]
            y = pixels[i, 1] + offset * normals[i, 1]
            level = _sample(coverage, x, y)
            hidden = _sample(covered, x, y) > 0
            unseen = unseen or hidden or x < 0 or y < 0 or x > last_x or y > last_y
            if (
                before > EDGE_COVERAGE
                and level <= EDGE_COVERAGE
                and not hidden
                and not occluded_before
            ):
                at = (
                    offset - across.step + across.step * (before - EDGE_COVERAGE) / (before - level)
                )
                if abs(at) < abs(nearest):
                    nearest = at
            before = level
            occluded_before = hidden

        # Without an edge, a point tells against the pose only if all of its samples could show one.
        offsets[i] = nearest
        state[i] = EDGE_FOUND
        if nearest == np.inf:
            offsets[i] = np.nan
            state[i] = EDGE_COVERED if unseen else EDGE_MISSING


class Points(NamedTuple):
    """Points of a boundary in the picture; all arrays are filled by `linearize`.

    Attributes:
        pixels: (n, 2) places of the points in the picture.
        J: (n, 3) derivatives of the edges' places along their normals by the pose, pixels/m and
            pixels/rad.
        normals: (n, 2) outward unit normals in the picture.
        sides: (n,) width of the object's side that is seen at each point, pixels; 0 where the top
            ends there.
        scales: (n,) pixels a meter across the boundary.
    """

    pixels: Any
    J: Any
    normals: Any
    sides: Any
    scales: Any


@kernel(allocates=False)
def linearize(points, normals, H, pose, foot, side, found):
    """Projects boundary points, and finds how they move along their normals with the pose.

    Args:
        points: (n, 2) points of the silhouette's boundary on the table, W, m.
        normals: (n, 2) outward unit normals there, W.
        H: (3, 3) homography from the table's plane, W, m, to the picture, pixels.
        pose: (3,) pose of the object, W.
        foot: (2,) point of the table below the camera, W, m.
        side: width on the table of a side that is seen, over the distance from the foot.
        found: `Points` to be filled.
    """
    for i in range(len(points)):
        x = points[i, 0]
        y = points[i, 1]
        n_x = normals[i, 0]
        n_y = normals[i, 1]
        # The pixel (u, v) of the point: (u w, v w, w) = H (x, y, 1).
        w = H[2, 0] * x + H[2, 1] * y + H[2, 2]
        u = (H[0, 0] * x + H[0, 1] * y + H[0, 2]) / w
        v = (H[1, 0] * x + H[1, 1] * y + H[1, 2]) / w
        found.pixels[i, 0] = u
        found.pixels[i, 1] = v

        # Derivatives of the pixel by x and y on the table.
        u_x = (H[0, 0] - u * H[2, 0]) / w
        u_y = (H[0, 1] - u * H[2, 1]) / w
        v_x = (H[1, 0] - v * H[2, 0]) / w
        v_y = (H[1, 1] - v * H[2, 1]) / w

        # A perspective picture keeps tangents and not normals: the normal in the picture is across
        # the picture of the tangent, on the side of the outward normal's picture.
        along_u = -u_x * n_y + u_y * n_x
        along_v = -v_x * n_y + v_y * n_x
        outward_u = u_x * n_x + u_y * n_y
        outward_v = v_x * n_x + v_y * n_y
        length = max(sqrt(along_u * along_u + along_v * along_v), _TINY)
        across_u = along_v / length
        across_v = -along_u / length
        if across_u * outward_u + across_v * outward_v < 0:
            across_u = -across_u
            across_v = -across_v
        found.normals[i, 0] = across_u
        found.normals[i, 1] = across_v

        # n_i' J_i: a turn moves a point by the arm from the body's origin, turned by 90 degrees.
        J_x = across_u * u_x + across_v * v_x
        J_y = across_u * u_y + across_v * v_y
        found.J[i, 0] = J_x
        found.J[i, 1] = J_y
        found.J[i, 2] = J_y * (x - pose[0]) - J_x * (y - pose[1])

        # A side is seen where its normal points to the camera's foot. On the table it is as wide as
        # a line of sight over the top's edge goes on before it meets the table.
        toward_foot = max(0.0, (foot[0] - x) * n_x + (foot[1] - y) * n_y)
        scale = sqrt(outward_u * outward_u + outward_v * outward_v)
        found.sides[i] = toward_foot * side * scale
        found.scales[i] = scale
