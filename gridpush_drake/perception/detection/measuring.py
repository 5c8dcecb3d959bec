"""What is measured of an object whose pixels are known: its height, outline and parts.

What is seen of a prism of height h is its outline on every level from the table to h. A pixel of
the picture's outline shows a point of the top where the prism's side there faces away from the
camera, and one of the bottom where it faces it. So the outline is what the pixels' rays meet on all
levels: the intersection of the picture's outline cast to some levels from the table to the height.
The theory is in docs/theory/perception.md, section 2.
"""

import cv2
import numpy as np
import shapely
from shapely import MultiPolygon, Polygon
from shapely.geometry.polygon import orient

from gridpush_drake.errors import PerceptionError
from gridpush_drake.geometry.contour import calc_contour
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.perception.detection.foreground import keep_largest, to_lab
from gridpush_drake.perception.images.camera import Camera
from gridpush_drake.perception.images.frames import Color, Mask
from gridpush_drake.perception.images.table_plane import Heights

PIXEL_MIDDLE = 0.5
"""Distance from a pixel's upper left corner to its middle along each axis, pixels."""

RIM_WIDTH = 31
"""Side of the square window about a point of the outline in which the object's height there is
looked for, pixels."""

RIM_PERCENTILE = 60
"""Percentile of the heights in that window that is taken for the object's height near its rim;
depth images blur the edge downward."""

TOP_PERCENTILE = 90
"""Percentile of an object's smoothed heights that is taken for its height."""

TOP_WINDOW = 5
"""Side of the window whose median smooths the heights of an object, pixels; half of it is left out
along the object's rim."""

HEIGHT_LEVELS = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Levels to which the picture's outline is cast, as parts of the object's height."""

MAX_SIMPLIFICATION = 2e-4
"""Largest distance by which the outline may be simplified after the levels were intersected, m."""

MAX_PARTS = 3
"""Most parts of an object that are told apart by color."""

PART_ROUNDS = 30
"""Most rounds of the clustering of colors (k-means)."""

PART_EPSILON = 0.1
"""The clustering of colors ends when no center moves by more than this, units of CIE L*a*b*."""

PART_CONTRAST = 25.0
"""Clusters whose centers are nearer than this are one part, units of CIE L*a*b*."""

MIN_PART = 0.08
"""A part that has less than this fraction of the object's pixels is joined to the others."""

PART_SMOOTHING = 9
"""Side of the window of the median that colors and labels of parts go through, pixels."""


def find_height(heights: Heights, mask: Mask) -> float:
    """Finds the height of an object's top, m; 0 where depth was not measured on it."""
    # Depth images blur an object's rim, and single pixels are noisy: the rim is left out, and a
    # percentile taken for the top.
    brush = np.ones((TOP_WINDOW, TOP_WINDOW), np.uint8)
    inner = cv2.erode(mask.astype(np.uint8), brush) > 0
    smooth = cv2.medianBlur(np.nan_to_num(heights).astype(np.float32), TOP_WINDOW)
    measured = smooth[inner & np.isfinite(heights)]
    if not len(measured):
        return 0.0
    return max(0.0, float(np.percentile(measured, TOP_PERCENTILE)))


def cast_outline(
    contour: Polygon, camera: Camera, mask: Mask, heights: Heights | None, height: float
) -> Polygon:
    """Finds an object's outline on the table from its outline in the picture.

    Args:
        contour: outline in the picture, pixels from the picture's upper left corner.
        camera: camera with X_WC.
        mask: (height, width) bool, pixels that show the object.
        heights: (height, width) heights above the table, m; None for the same height everywhere.
        height: height of the object's top, m.

    Returns:
        The outline, W, m, counterclockwise.

    Raises:
        PerceptionError: nothing is common to all levels.
    """

    def cast(points: Array, level: float) -> Array:
        """Makes S_z: casts the contour to a part of the height at each of its points."""
        pixels = points - PIXEL_MIDDLE
        z: float | Array = height
        if heights is not None:
            z = _find_rim_heights(pixels, mask, heights, height)
        return camera.undistorted.cast(pixels, level * np.asarray(z))

    layers = [
        shapely.transform(contour, lambda points, level=level: cast(points, level))
        for level in HEIGHT_LEVELS
    ]

    # P: what all levels have in common. A flat object is the same on all.
    valid = shapely.make_valid(layers)
    outline = valid[0]
    if height > 0:
        outline = shapely.intersection_all(valid)
    pieces = [piece for piece in shapely.get_parts(outline) if isinstance(piece, Polygon)]
    if not pieces:
        raise PerceptionError(
            "the object is higher than it is wide, seen from the side; expected an overhead camera"
        )

    # Levels cross each other in many short sides, which say nothing of the object.
    largest = max(pieces, key=lambda piece: piece.area)
    if height > 0:
        largest = largest.simplify(MAX_SIMPLIFICATION)
    return orient(largest)


def _find_rim_heights(pixels: Array, mask: Mask, heights: Heights, height: float) -> Array:
    """Finds the object's height near each of (k, 2) pixels of its outline, (k,), m.

    An object that is not of one height is so taken for a prism at each side.
    """
    half = RIM_WIDTH // 2
    inside = np.where(mask, heights, np.nan)
    found = np.full(len(pixels), height)
    for i, (x, y) in enumerate(np.round(pixels).astype(int)):
        rows = slice(max(y - half, 0), y + half + 1)
        columns = slice(max(x - half, 0), x + half + 1)
        window = inside[rows, columns]
        window = window[np.isfinite(window)]
        if len(window):
            found[i] = np.clip(np.percentile(window, RIM_PERCENTILE), 0.0, height)
    return found


def find_parts(
    color: Color, mask: Mask, camera: Camera, outline: Polygon, height: float
) -> dict[int, Polygon | MultiPolygon]:
    """Finds parts by color, the largest first, W, m; one part where the object is of one color."""
    # Clusters of color, after a median that takes prints and grain away. OpenCV's generator is
    # seeded, so that the same picture gives the same parts.
    smooth = np.asarray(cv2.medianBlur(color, PART_SMOOTHING), dtype=np.uint8)
    lab = to_lab(smooth)[mask]
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, PART_ROUNDS, PART_EPSILON)
    cv2.setRNGSeed(0)
    _, labels, centers = cv2.kmeans(
        data=lab,
        K=min(MAX_PARTS, len(lab)),
        bestLabels=np.zeros((len(lab), 1), np.int32),
        criteria=criteria,
        attempts=1,
        flags=cv2.KMEANS_PP_CENTERS,
    )
    counts = np.bincount(labels.ravel(), minlength=len(centers))

    # Clusters that are large, and of another color than the larger ones, are parts.
    kept: list[int] = []
    for k in np.argsort(-counts):
        apart = all(np.linalg.norm(centers[k] - centers[other]) >= PART_CONTRAST for other in kept)
        if not kept or (apart and counts[k] >= MIN_PART * len(lab)):
            kept.append(int(k))

    # Every pixel goes to the nearest part in color, and single ones to what is about them.
    distances = np.linalg.norm(lab[:, None] - centers[kept], axis=-1)
    nearest = np.argmin(distances, axis=1)
    image = np.zeros(mask.shape, np.uint8)
    image[mask] = nearest + 1
    image = np.asarray(cv2.medianBlur(image, PART_SMOOTHING), dtype=np.uint8)

    # Parts are cast to the top, for that is what shows them, and cut to the object's outline.
    parts: dict[int, Polygon | MultiPolygon] = {}
    for label in range(1, len(kept) + 1):
        part = keep_largest(image == label)
        if part.sum() < MIN_PART * len(lab):
            continue
        contour = calc_contour(part.astype(np.float64))
        shape = shapely.transform(
            contour, lambda points: camera.undistorted.cast(points - PIXEL_MIDDLE, height)
        )
        pieces = shapely.get_parts(shapely.intersection(shapely.make_valid(shape), outline))
        pieces = [piece for piece in pieces if isinstance(piece, Polygon)]
        if pieces:
            whole = MultiPolygon(pieces) if len(pieces) > 1 else pieces[0]
            parts[len(parts) + 1] = whole
    return parts
