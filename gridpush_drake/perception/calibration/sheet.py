"""A sheet of paper in a photograph: where it is, and so where the camera is, in meters.

For people with a phone and no board of tags: the object lies beside or on a sheet of known size. In
the photograph the sheet is the lightest quadrilateral whose corners are those of a rectangle of its
sides, seen by a pinhole camera. Its corners are found to a fraction of a pixel by lines through its
edges. The camera's pose follows from them, and with it the metric scale.

If nobody says what camera it is, its focal length is the one by which the corners fit best, with
the optical axis in the picture's middle. A photograph from straight above tells no focal length;
one at a slant does. `FoundSheet.focal_known` tells which.

World frame: origin in the sheet's middle, x along its long side, z up from the table.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from shapely import Polygon

from gridpush_drake.errors import SheetError
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.perception.detection.foreground import to_lab
from gridpush_drake.perception.images.camera import Camera
from gridpush_drake.perception.images.frames import Color
from gridpush_drake.perception.tracking.registration import sample_image
from gridpush_drake.units import MM_PER_M

SHEET_SIZES = {
    "a3": (0.420, 0.297),
    "a4": (0.297, 0.210),
    "a5": (0.210, 0.148),
    "letter": (0.2794, 0.2159),
}
"""Long and short side of sheets of paper, m, by their names."""


MIN_FRACTION = 0.015
"""Least fraction of the picture that a sheet takes."""

MIN_LIGHTER = 4.0
"""How much lighter than the table beside it a sheet is at least, units of CIE L*."""

STRIP_WIDTH = 0.04
"""Width of the strips along a sheet's edges, inside and outside, in which paper and table are
compared, as a fraction of its shorter side in the picture."""

THRESHOLD_COUNT = 14
"""Number of thresholds of lightness at which quadrilaterals are looked for."""

BLUR_STD = 1.5
"""Standard deviation of the blur before that, pixels of the picture that is searched."""

SEARCH_SIZE = 1000
"""Longer side of the picture in which quadrilaterals are looked for, pixels."""

OUTLINE_TOLERANCE = 0.02
"""How far an outline may be from a quadrilateral, as a fraction of its perimeter."""

MIN_FILLED_FRACTION = 0.95
"""Least fraction of a quadrilateral that its outline fills, and of the outline's convex hull."""

MAX_MISFIT = 0.003
"""Largest mean distance of the corners from where a sheet of its size would have them, as a
fraction of the sheet's size in the picture. A sheet of another size misses by more."""

CORNER_DEVIATION = 0.4
"""Standard deviation of a corner that was found, pixels."""

FOCAL_RANGE = (0.45, 4.0)
"""Focal lengths between which that of an unknown camera lies, as fractions of the picture's longer
side."""

FOCAL_STEPS = 40
"""Number of focal lengths at which the fit is begun."""

IMPOSSIBLE_MISFIT = 1e12
"""Squared misfit of a focal length with which there is no solution."""

TYPICAL_FOCAL = 0.75
"""Focal length of a phone's main lens, as a fraction of the picture's longer side."""

MAX_FOCAL_DEVIATION = 0.12
"""Standard deviation of the focal length's logarithm up to which it counts as known."""

REFUSED_COLOR = (255, 0, 0)
"""Color of sheets that were refused, in pictures."""

LINE_WIDTH = 2
"""Width of the lines drawn in pictures, pixels."""

SAME_CORNER = 1.0
"""Corners that are nearer than this along each axis are the same, pixels."""

SAME_SHEET = 0.5
"""Two quadrilaterals of which this fraction overlaps are the same sheet."""

EDGE_POINTS = 80
"""Places along a side at which the paper's edge is looked for."""

EDGE_REACH = 0.012
"""How far from a first guess it is looked for, as a fraction of the sheet's size in the picture."""

MIN_EDGE_REACH = 4.0
"""How far it is looked for at least, and in all rounds but the first, pixels."""

EDGE_ROUNDS = 3
"""Number of times that the edges are looked for anew."""

EDGE_BLUR = 1.0
"""Standard deviation of the blur before edges are looked for, pixels."""

EDGE_STEP = 0.5
"""Distance between the points across an edge at which the lightness is looked at, pixels."""

MIN_BEND = 1e-6
"""Least bend of a parabola through three slopes; a flatter one has no top."""

MIN_SLOPE_FRACTION = 0.25
"""Edges less steep than this fraction of the median one are left out."""

LINE_EPSILON = 1e-3
"""Accuracy of the lines through edges, pixels and rad."""

PARALLEL_SINE = 1e-3
"""Sine of the angle between two lines below which they are parallel."""

CORNER_ROOM = 0.04
"""Part of each side, at both ends, in which the edge is not looked for: corners are bent."""


@dataclass(frozen=True, eq=False)
class FoundSheet:
    """A sheet that was found.

    Attributes:
        size: (2,) its long and its short side, m.
        corners: (4, 2) its corners in the undistorted picture, pixels, in the order of
            `list_corners`.
        camera: the camera, with X_WC.
        focal_known: whether the focal length was told, or is well known from the corners. If not,
            only what is flat on the table can be measured.
        misfit: mean distance of the corners from where they should be, pixels.
    """

    size: tuple[float, float]
    corners: Array
    camera: Camera
    focal_known: bool
    misfit: float

    def cover(self, margin: float = 0.0) -> NDArray[np.bool_]:
        """Finds the pixels (height, width) bool of the undistorted picture that show the sheet.

        Args:
            margin: how much larger than it is the sheet is taken to be, m.
        """
        length, width = self.size
        larger = list_corners((length + 2 * margin, width + 2 * margin))
        corners = self.camera.undistorted.project(larger)
        drawn = np.zeros((self.camera.height, self.camera.width), np.uint8)
        cv2.fillConvexPoly(drawn, np.round(corners).astype(np.int32), 1)
        return drawn > 0


def list_corners(size: tuple[float, float]) -> Array:
    """Lists the corners (4, 3) of a sheet in W, m, counterclockwise as seen from above."""
    x, y = np.array(size) / 2
    return np.array([[-x, -y, 0.0], [x, -y, 0.0], [x, y, 0.0], [-x, y, 0.0]])


def find_sheet(
    color: Color,
    size: tuple[float, float],
    camera: Camera | None = None,
    focal: float | None = None,
) -> FoundSheet:
    """Finds the one sheet of paper of a size in a photograph.

    Args:
        color: (height, width, 3) uint8, red, green, blue, as it was taken.
        size: long and short side of the sheet, m.
        camera: the camera; its X_WC is not looked at. None if nobody knows it.
        focal: focal length, pixels, if that is all that is known of the camera.

    Returns:
        The sheet, and the camera with its pose.

    Raises:
        ImageError: the picture has another size than the camera.
        SheetError: there is none, or several.
    """
    height, width = color.shape[:2]
    if camera is not None:
        camera.check_size(color, "the photograph")
        color = camera.undistort(color)
    elif focal is not None:
        camera = _make_camera(width, height, focal)
    light = to_lab(color)[..., 0]
    shape = (height, width)
    found: list[FoundSheet] = []
    tried: list[Array] = []
    light_ones: list[Array] = []
    for guess in _list_quadrilaterals(light):
        corners = _refine(light, guess)
        if corners is None or any(_is_same(corners, other) for other in tried):
            continue
        tried.append(corners)
        if not _is_lighter(light, corners):
            continue
        light_ones.append(corners)
        sheet = _fit(corners, size, camera, shape)
        if sheet is not None:
            found.append(sheet)

    # One sheet gives a quadrilateral at many thresholds: the best of those that overlap counts
    found.sort(key=lambda sheet: sheet.misfit)
    distinct: list[FoundSheet] = []
    for sheet in found:
        if not any(_overlap(sheet.corners, other.corners) for other in distinct):
            distinct.append(sheet)
    sides = " x ".join(f"{MM_PER_M * side:.0f}" for side in size)
    if not distinct:
        others = [
            name
            for name, other in SHEET_SIZES.items()
            if any(_fit(corners, other, camera, shape) for corners in light_ones)
        ]
        instead = f" (what is in view may be {' or '.join(others)})" if others else ""
        raise SheetError(
            f"no sheet of {sides} mm is in view{instead}; expected all four corners of a blank "
            "white sheet in view, on a table that is darker",
            color,
        )
    if len(distinct) > 1:
        outlines = [np.round(sheet.corners).astype(np.int32) for sheet in distinct]
        picture = cv2.polylines(color.copy(), outlines, True, REFUSED_COLOR, LINE_WIDTH)
        raise SheetError(f"{len(distinct)} sheets of {sides} mm are in view; expected one", picture)
    return distinct[0]


def _list_quadrilaterals(light: NDArray[np.float32]) -> Iterator[Array]:
    """Lists quadrilaterals (4, 2) that are lighter than what is about them, pixels."""
    height, width = light.shape
    scale = min(1.0, SEARCH_SIZE / max(height, width))
    small = cv2.resize(light, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    small = cv2.GaussianBlur(small, (0, 0), BLUR_STD)
    low, high = np.percentile(small, [5, 99])
    for level in np.linspace(low, high, THRESHOLD_COUNT + 2)[1:-1]:
        lighter = (small > level).astype(np.uint8)
        contours, _ = cv2.findContours(lighter, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        for contour in contours:
            area = cv2.contourArea(contour)
            if area < MIN_FRACTION * small.size:
                continue
            hull = cv2.convexHull(contour)
            rounding = OUTLINE_TOLERANCE * cv2.arcLength(hull, True)
            corners = cv2.approxPolyDP(hull, rounding, True).reshape(-1, 2)
            if len(corners) != 4:
                continue
            # An outline with bays is no sheet, nor one that the quadrilateral cuts
            is_filled = area > MIN_FILLED_FRACTION * cv2.contourArea(hull)
            is_close = area > MIN_FILLED_FRACTION * cv2.contourArea(corners)
            at_border = (corners <= 1).any() or (corners >= np.array(small.shape[::-1]) - 2).any()
            if is_filled and is_close and not at_border:
                yield (corners + 0.5) / scale - 0.5


def _refine(light: NDArray[np.float32], guess: Array) -> Array | None:
    """Finds the corners of a light quadrilateral to a fraction of a pixel.

    Lines are fitted to where the lightness falls most steeply, across each side.

    Returns:
        (4, 2) corners, pixels, counterclockwise as seen from above; None where there are no edges.
    """
    # In pictures y is down: counterclockwise from above is clockwise there
    corners = np.array(guess, float)
    if cv2.contourArea(corners.astype(np.float32), oriented=True) > 0:
        corners = corners[::-1]
    size = float(np.sqrt(cv2.contourArea(corners.astype(np.float32))))
    reach = max(MIN_EDGE_REACH, EDGE_REACH * size)
    smooth = np.asarray(cv2.GaussianBlur(light, (0, 0), EDGE_BLUR), np.float32)
    for _ in range(EDGE_ROUNDS):
        lines = []
        for i in range(4):
            line = _fit_edge(smooth, corners[i], corners[(i + 1) % 4], reach)
            if line is None:
                return None
            lines.append(line)
        # A corner is where the side that ends there meets the one that begins there
        new = [_intersect(lines[i - 1], lines[i]) for i in range(4)]
        if any(corner is None for corner in new):
            return None
        corners = np.array(new)
        reach = MIN_EDGE_REACH
    return corners


def _fit_edge(light: NDArray[np.float32], start: Array, end: Array, reach: float) -> Array | None:
    """Fits a line to an edge between two corners.

    Returns:
        (2, 2) a point of the line and its direction; None where there is no edge.
    """
    along = end - start
    length = float(np.linalg.norm(along))
    if length < 4 * reach:
        return None
    across = np.array([-along[1], along[0]]) / length

    # The lightness across the side, at places along it: (places, offsets)
    fractions = np.linspace(CORNER_ROOM, 1 - CORNER_ROOM, EDGE_POINTS)
    offsets = np.arange(-reach, reach + EDGE_STEP / 2, EDGE_STEP)
    places = start + fractions[:, None, None] * along + offsets[None, :, None] * across
    profiles = sample_image(light, places)

    # The edge is where it changes most, to a part of a step by the parabola through three slopes
    slopes = np.abs(np.gradient(profiles, axis=1))
    best = np.clip(np.argmax(slopes, axis=1), 1, len(offsets) - 2)
    rows = np.arange(EDGE_POINTS)
    before = slopes[rows, best - 1]
    there = slopes[rows, best]
    after = slopes[rows, best + 1]
    bend = np.minimum(before - 2 * there + after, -MIN_BEND)
    shift = np.clip(0.5 * (before - after) / bend, -1, 1)
    exact = offsets[best] + EDGE_STEP * shift
    edge = start + fractions[:, None] * along + exact[:, None] * across

    # Where the object or a shadow lies at the edge, some of these points are elsewhere: faint edges
    # are left out, and the fit is robust
    steep = there > MIN_SLOPE_FRACTION * np.median(there)
    points = edge[steep].astype(np.float32)
    line = cv2.fitLine(points, cv2.DIST_WELSCH, 0, LINE_EPSILON, LINE_EPSILON)
    vx, vy, x, y = line.ravel()
    return np.array([[x, y], [vx, vy]], float)


def _intersect(one: Array, other: Array) -> Array | None:
    """Finds where two lines meet; None where they are parallel."""
    directions = np.column_stack([one[1], -other[1]])
    if abs(np.linalg.det(directions)) < PARALLEL_SINE:
        return None
    along, _ = np.linalg.solve(directions, other[0] - one[0])
    return np.asarray(one[0] + along * one[1])


def _is_lighter(light: NDArray[np.float32], corners: Array) -> bool:
    """Says whether a quadrilateral is lighter than what is right beside it, along every side."""
    middle = corners.mean(axis=0)
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1)
    step = STRIP_WIDTH * sides.min()
    fractions = np.linspace(CORNER_ROOM, 1 - CORNER_ROOM, EDGE_POINTS)[:, None]
    for i in range(4):
        # A line just inside of the side and one just outside of it
        start = corners[i - 1]
        along = corners[i] - start
        inward = np.array([-along[1], along[0]]) / np.linalg.norm(along)
        if inward @ (middle - start) < 0:
            inward = -inward
        points = start + fractions * along
        inside = np.median(sample_image(light, points + step * inward))
        outside = np.median(sample_image(light, points - step * inward))
        if inside < outside + MIN_LIGHTER:
            return False
    return True


def _fit(
    corners: Array, size: tuple[float, float], camera: Camera | None, shape: tuple[int, int]
) -> FoundSheet | None:
    """Fits a sheet to four corners.

    Args:
        corners: (4, 2) pixels of the undistorted picture, counterclockwise as seen from above.
        size: long and short side, m.
        camera: the camera; None if nobody knows it.
        shape: height and width of the picture, pixels.

    Returns:
        The sheet; None if the corners are not those of such a sheet.
    """
    scale = float(np.sqrt(cv2.contourArea(corners.astype(np.float32))))
    best: FoundSheet | None = None
    for first in range(2):
        # The long side may be the first or the second; by half a turn a sheet looks the same
        turned = np.roll(corners, -first, axis=0)
        sheet = (
            _solve_with_focal(turned, size, shape)
            if camera is None
            else _solve(turned, size, camera)
        )
        if sheet is not None and (best is None or sheet.misfit < best.misfit):
            best = sheet
    if best is None or best.misfit > max(MAX_MISFIT * scale, 2 * CORNER_DEVIATION):
        return None
    return best


def _solve(corners: Array, size: tuple[float, float], camera: Camera) -> FoundSheet | None:
    """Finds the camera's pose from a sheet's corners; None if the sheet would be behind it."""
    p_W = list_corners(size)
    K = camera.K

    # The pose by a closed form for planes, then with the least squared distance of the corners
    solved, turn, shift = cv2.solvePnP(p_W, corners, K, None, flags=cv2.SOLVEPNP_IPPE)
    if not solved:
        return None
    turn, shift = cv2.solvePnPRefineLM(p_W, corners, K, None, turn, shift)

    # X_WC is the inverse of X_CW = [R_CW p_CW]
    R_CW, _ = cv2.Rodrigues(turn)
    X_WC = np.eye(4)
    X_WC[:3, :3] = R_CW.T
    X_WC[:3, 3] = -R_CW.T @ shift.ravel()
    if X_WC[2, 3] <= 0:
        return None

    # How far the corners are from where this pose has them
    placed = camera.with_pose(X_WC)
    missed = placed.undistorted.project(p_W) - corners
    misfit = float(np.linalg.norm(missed, axis=1).mean())
    if not np.isfinite(misfit):
        return None
    return FoundSheet(
        size=size,
        corners=corners,
        camera=placed,
        focal_known=True,
        misfit=misfit,
    )


def _solve_with_focal(
    corners: Array, size: tuple[float, float], shape: tuple[int, int]
) -> FoundSheet | None:
    """Finds pose and focal length from a sheet's corners.

    The focal length is known as well as the corners tell it: the squared misfit, in the corners'
    variances, rises by 1 at one standard deviation from its minimum.
    """
    height, width = shape
    side = max(height, width)

    def solve(log_focal: float) -> FoundSheet | None:
        camera = _make_camera(width, height, float(np.exp(log_focal)) * side)
        return _solve(corners, size, camera)

    def cost(log_focal: float) -> float:
        sheet = solve(log_focal)
        if sheet is None:
            return IMPOSSIBLE_MISFIT
        missed = sheet.camera.project(list_corners(size)) - corners
        return float((missed**2).sum()) / CORNER_DEVIATION**2

    low, high = np.log(FOCAL_RANGE)
    grid = np.linspace(low, high, FOCAL_STEPS)
    costs = np.array([cost(value) for value in grid])

    # The best one on the grid, then the best between its neighbors there
    at = int(np.argmin(costs))
    bounds = (grid[max(at - 1, 0)], grid[min(at + 1, len(grid) - 1)])
    best = float(minimize_scalar(cost, bounds=bounds, method="bounded").x)

    # How far about the optimum the fit is nearly as good
    near = grid[costs <= min(cost(best), costs.min()) + 1.0]
    step = grid[1] - grid[0]
    deviation = (near.max() - near.min()) / 2 + step / 2 if len(near) else step / 2
    known = bool(deviation < MAX_FOCAL_DEVIATION)
    if not known:
        # All that is sure is a lens such as phones have
        typical = float(np.log(TYPICAL_FOCAL))
        best = typical if near.min() <= typical <= near.max() else best
    sheet = solve(best)
    return None if sheet is None else replace(sheet, focal_known=known)


def _make_camera(width: int, height: int, focal: float) -> Camera:
    """Makes a camera without distortion whose optical axis is in the picture's middle."""
    K = np.array(
        [
            [focal, 0.0, width / 2 - 0.5],
            [0.0, focal, height / 2 - 0.5],
            [0.0, 0.0, 1.0],
        ]
    )
    return Camera(width, height, K, np.zeros(0))


def _is_same(one: Array, other: Array) -> bool:
    """Says whether two quadrilaterals have the same corners, whichever comes first."""
    gaps = [np.abs(np.roll(one, turn, axis=0) - other).max() for turn in range(4)]
    return bool(min(gaps) < SAME_CORNER)


def _overlap(one: Array, other: Array) -> bool:
    """Says whether two quadrilaterals are of the same sheet, or one lies within the other."""
    first = Polygon(one)
    second = Polygon(other)
    if not (first.is_valid and second.is_valid):
        return True
    common = shapely.intersection(first, second).area
    return bool(common > SAME_SHEET * min(first.area, second.area))
