"""Which pixels show something else than the table, by height and color together.

The table's color is a smooth polynomial over the picture, fitted to what is certainly table:
neither high nor, in later rounds, foreground. What a pixel's color c and height h say adds up:

    s = clip((|chroma(c) - table|^2/sigma^2 + (light(c) - table)^2/tau^2 - 9)/2) + clip(1.5
    (h/sigma_h - 3))

with a wide tau where the pixel is darker than the table: that may be a shadow. Depth images miss
edges by some pixels, so that along them color speaks louder. The boundary of what is left is then
drawn anew where the color is half way between the object's and the table's, each the mean nearby; a
shadow is of the table's. What is too dark for a shadow, such as a side in the dark, lies as far on
that way as it is from the table, in whatever direction.
"""

from typing import Any, Literal, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from gridpush_drake.geometry.se2 import Array
from gridpush_drake.perception.frames import Color
from gridpush_drake.perception.table_plane import TO_DEVIATION, TablePlane, make_basis

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]
Cues = Literal["both", "color", "depth"]

LIGHT_WEIGHT = 0.6
"""Of lightness beside chroma, at the boundary: shadows differ from the table in lightness alone."""

SHADOW = 9.0
"""Standard deviation of darkening that a shadow brings, units of CIE L*."""

MIN_COLOR_DEVIATION = 1.0
"""Of the table, units of CIE L*a*b*."""

COLOR_BIAS, MIN_COLOR_SCORE, MAX_COLOR_SCORE = 9.0, -3.0, 8.0
HEIGHT_SLOPE, HEIGHT_BIAS, MAX_HEIGHT_SCORE = 1.5, 3.0, 5.0
"""Of the scores, above."""

HIGH = 5.0
"""Standard deviations of the table's heights above which a pixel is certainly no table."""

EDGE_BAND, EDGE_WEIGHT = 13, 0.25
"""Width of the band along the edges of what is high, pixels, and the weight of heights in it."""

RIM = 0.06
"""Width of the picture's rim, in its sides, taken for table where there is no depth."""

NEAR_OBJECT = 21
"""Width about what is high, pixels, that is not taken for table."""

RIM_ORDER, ORDER = 2, 3
"""Of the polynomial of the table's color, from the rim alone and from all of the table."""

GENEROSITY = (3.0, 2.0, 1.5, 1.0)
"""Of each round of telling table and foreground apart: standard deviations count for so much more,
as the first fits are to the rim, or to what is near the object in color."""

FIT_ROUNDS = 10
"""Of reweighting in a fit."""

OUTLIER = 3.0
"""Standard deviations from which on a color counts for less in the fit of the table's."""

SMOOTHING = 1.2
"""Of scores, standard deviation in pixels."""

OPENING, CLOSING = 3, 5
"""Widths, pixels, of what is too thin to be object, or a gap."""

MIN_HOLE, HOLE_SCORE, HOLE_SHARE = 15, -1.0, 0.5
"""A hole is filled where it has fewer pixels, or where less than this share of it has a score below
that."""

BAND = 6
"""Pixels about the first boundary within which the final one lies."""

INSIDE_RADIUS, OUTSIDE_RADIUS, MEAN_GAP = 7.5, 4.0, 3
"""Of the means of color nearby: standard deviations of their weights, the table's nearer as shadows
are narrow; and the strip of that width at the boundary that is left out, pixels."""

TOO_DARK, DARK = 1.5 * SHADOW, 3 * SHADOW
"""Drops of CIE L* from the table nearby from which on it is more and more, and surely, no
shadow."""

BOUNDARY_ROUNDS, BOUNDARY_SMOOTHING = 4, 0.5
"""Of drawing the boundary; and the standard deviation, in pixels, of what a wider one would round:
corners, holes."""

MIN_CONTRAST = 9.0
"""Squared difference of color at which the boundary is as uncertain as the pixels are noisy."""

CONTRADICTION = 0.1
"""Share of an object from which on color and depth are taken to show different things: of five real
photographs with their own depth it is up to 0.02, with another's 0.2 and more."""

HALF_STEP = 0.5
"""Half of the way from the table's color to the object's; a pixel beyond either counts as
either."""

HEIGHT_SAYS = 0.15
"""Most that height moves the boundary's level, which is 0.5 of the way from one color to the
other."""


class Foreground(NamedTuple):
    """What was told apart.

    Attributes:
        mask: (height, width) bool, everything that is no table.
        score: (height, width), above 0 where it is no table.
        difference: (height, width, 3) color less the table's, CIE L*a*b*.
        deviation: (3,) of the table's color; zeros where color was not looked at.
        heights: what height alone says of the boundary, -HEIGHT_SAYS to HEIGHT_SAYS; zeros without
            depth.
    """

    mask: Mask
    score: Image
    difference: Image
    deviation: Array
    heights: Image


def find_foreground(color: Color, plane: TablePlane | None, cues: Cues = "both") -> Foreground:
    """Tells table and everything else apart.

    Args:
        color: (height, width, 3), undistorted.
        plane: the table with the heights above it; None without depth, or where color alone is to
            say.
        cues: what is looked at.

    Returns:
        The foreground, in one piece or several.
    """
    plane = None if cues == "color" else plane
    high = find_high(plane) if plane is not None else None
    lab = to_lab(color)
    if cues == "depth":
        return score_pixels(np.zeros_like(lab), np.zeros(3), plane, high, cues)
    if high is None:
        table, order = _make_rim(color.shape[:2]), RIM_ORDER
    else:
        table, order = ~dilate(high, NEAR_OBJECT), ORDER
    for generosity in GENEROSITY:
        difference, deviation = fit_table_color(lab, table, order)
        found = score_pixels(difference, generosity * deviation, plane, high, cues)
        table, order = ~dilate(found.mask, NEAR_OBJECT), ORDER
    return found


def to_lab(color: Color) -> Image:
    """CIE L*a*b* of an image (height, width, 3) uint8."""
    return np.asarray(
        cv2.cvtColor(color.astype(np.float32) / np.iinfo(np.uint8).max, cv2.COLOR_RGB2LAB)
    )


def find_high(plane: TablePlane) -> Mask:
    """What certainly stands above the table."""
    high = np.nan_to_num(plane.heights) > HIGH * plane.deviation
    return _morph(high, cv2.MORPH_OPEN, CLOSING)


def fit_table_color(lab: Image, table: Mask, order: int) -> tuple[Image, Array]:
    """Fits the table's color, robustly.

    Args:
        lab: (height, width, 3).
        table: pixels taken for table, most of them rightly.
        order: of the polynomial.

    Returns:
        The picture less it, and (3,) its standard deviations.
    """
    stride = max(1, round(np.sqrt(lab.shape[0] * lab.shape[1]) / FIT_SIDE))
    some = np.zeros(table.shape, dtype=bool)
    some[::stride, ::stride] = True
    some &= table
    basis = make_basis(lab.shape, order)
    A, colors = basis[some], lab[some].astype(np.float64)
    weight = np.ones(len(A))
    fitted: Array = np.zeros((A.shape[1], 3))
    deviation: Array = np.ones(3)
    for _ in range(FIT_ROUNDS):
        W = (
            A * weight[:, None]
        )  # the normal equations: seventy times as fast, and polynomials on [-1, 1] allow them
        fitted = np.asarray(
            np.linalg.lstsq(W.T @ W, W.T @ (colors * weight[:, None]))[0], dtype=np.float64
        )
        off = colors - A @ fitted
        deviation = np.maximum(TO_DEVIATION * np.median(np.abs(off), axis=0), MIN_COLOR_DEVIATION)
        weight = 1 / (1 + ((off / (OUTLIER * deviation)) ** 2).sum(axis=1))
    return (lab - basis @ fitted).astype(np.float32), deviation


FIT_SIDE = 140
"""The fit looks at about this many pixels squared."""


def score_pixels(
    difference: Image,
    deviation: Array,
    plane: TablePlane | None,
    high: Mask | None,
    cues: Cues = "both",
) -> Foreground:
    """Adds up what color and height say of each pixel.

    Args:
        difference: (height, width, 3) color less the table's, CIE L*a*b*.
        deviation: (3,) of the table's color.
        plane: the table with the heights above it; None without depth.
        high: where `find_high` says so; None without depth.
        cues: what is looked at.

    Returns:
        The foreground, in one piece or several.
    """
    score = np.zeros(difference.shape[:2])
    heights = np.zeros_like(score)
    if cues != "depth":
        distance = _calc_color_distance(difference, deviation)
        score += np.clip((distance - COLOR_BIAS) / 2, MIN_COLOR_SCORE, MAX_COLOR_SCORE)
    if plane is not None and high is not None:
        says = HEIGHT_SLOPE * (
            np.nan_to_num(plane.heights / plane.deviation, nan=HEIGHT_BIAS) - HEIGHT_BIAS
        )
        says = np.clip(says, -MAX_HEIGHT_SCORE, MAX_HEIGHT_SCORE)
        heights = HEIGHT_SAYS * np.clip(says / MAX_HEIGHT_SCORE, -1, 1)
        if cues == "both":
            band = dilate(high, EDGE_BAND) & ~_erode(high, EDGE_BAND)
            says = np.where(band, EDGE_WEIGHT * says, says)
        score += says
    smooth = _blur(score, SMOOTHING)
    mask = remove_thin(smooth > 0)
    mask = fill_holes(_morph(mask, cv2.MORPH_CLOSE, CLOSING) & (smooth >= HOLE_SCORE), smooth)
    return Foreground(mask, smooth, difference, deviation, heights.astype(np.float32))


def calc_contradiction(mask: Mask, found: Foreground, plane: TablePlane | None) -> float:
    """How much of an object color and height contradict each other about.

    Args:
        mask: of the object.
        found: of the picture.
        plane: the table with the heights above it; None without depth.

    Returns:
        The share of the object that has another color than the table but not its height, or that is
        certainly high but has the table's color, whichever is larger; 0 where the other of the two
        sees no object at all.
    """
    if plane is None or not mask.any():
        return 0.0
    colored = _calc_color_distance(found.difference, found.deviation) > COLOR_BIAS
    heights, area = np.nan_to_num(plane.heights / plane.deviation, nan=HEIGHT_BIAS), mask.sum()
    flat = (
        (mask & colored & (heights < HEIGHT_BIAS)).sum()
        if find_high(plane).sum() > CONTRADICTION * area
        else 0
    )
    plain = (
        (mask & ~colored & (heights > HIGH)).sum()
        if (mask & colored).sum() > CONTRADICTION * area
        else 0
    )
    return float(max(flat, plain) / area)


def refine_boundary(
    mask: Mask, found: Foreground, covered: Mask | None = None
) -> tuple[Mask, Image]:
    """Draws one object's boundary where the color is half way between the object's and the table's nearby.

    Args:
        mask: of the object; in one piece, unless something covers it.
        found: of the picture.
        covered: pixels which show something else, such as the arm, and say nothing; None where
            there are none.

    Returns:
        The mask, and (height, width) how much of each pixel is object, 0 to 1.
    """
    if not found.difference.any():
        return mask, _blur(mask, BOUNDARY_SMOOTHING)
    colors = found.difference * np.array([LIGHT_WEIGHT, 1, 1], dtype=np.float32)
    level = np.zeros(mask.shape, dtype=np.float32)
    shown = np.ones_like(mask) if covered is None else ~covered
    table = shown & ~mask
    for _ in range(BOUNDARY_ROUNDS):
        band = dilate(mask, 2 * BAND + 1) & ~_erode(mask, 2 * BAND + 1)
        inside = _calc_nearby_mean(colors, _erode(mask, MEAN_GAP) & shown, INSIDE_RADIUS)
        outside = _calc_nearby_mean(colors, ~dilate(mask, MEAN_GAP) & shown, OUTSIDE_RADIUS)
        along = _calc_along(colors, inside, outside)
        level = _blur(np.clip(along, -HALF_STEP, HALF_STEP) + found.heights, BOUNDARY_SMOOTHING)
        level = np.where(band, level, np.where(mask, 1, -1)).astype(np.float32)
        mask = keep_largest(level > 0) if covered is None else level > 0
    mask = fill_holes(mask, found.score, table)
    return mask, np.where(mask == (level > 0), np.clip(level + 0.5, 0, 1), mask).astype(np.float32)


def _calc_color_distance(difference: Image, deviation: Array) -> Image:
    """Squared distance of colors from the table's, in its standard deviations; a wide one where they are darker."""
    L, a, b = np.moveaxis(difference, -1, 0)
    distance = (a / deviation[1]) ** 2 + (b / deviation[2]) ** 2
    distance += (L / np.where(L < 0, np.maximum(SHADOW, deviation[0]), deviation[0])) ** 2
    return np.asarray(distance, dtype=np.float32)


def keep_largest(mask: Mask) -> Mask:
    """The largest piece of a mask; nothing of nothing."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats(
        mask.astype(np.uint8), connectivity=4
    )
    return labels == 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA])) if count > 1 else mask


def fill_holes(mask: Mask, score: Image, table: Mask | None = None) -> Mask:
    """Fills the holes through which the table is not plainly seen, unless some of it is known to be table."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats(
        (~mask).astype(np.uint8), connectivity=4
    )
    rim = np.unique(np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]]))
    area = stats[:, cv2.CC_STAT_AREA]
    plain = np.bincount(labels[score < HOLE_SCORE], minlength=count)
    filled = (area < MIN_HOLE) | (plain < HOLE_SHARE * area)
    filled[rim] = False
    if table is not None:
        filled[labels[table]] = False
    return mask | filled[labels]


def _make_rim(shape: tuple[int, ...]) -> Mask:
    rim = np.ones(shape, dtype=bool)
    rows, columns = (round(RIM * side) for side in shape)
    rim[rows:-rows, columns:-columns] = False
    return rim


def _calc_along(colors: Image, inside: Image, outside: Image) -> Image:
    """How far colors are from half way between two others, -0.5 at the one outside and 0.5 at the one inside."""
    step = inside - outside
    square = (step**2).sum(axis=-1) + MIN_CONTRAST
    along = ((colors - (inside + outside) / 2) * step).sum(axis=-1) / square
    distance = np.sqrt(((colors - outside) ** 2).sum(axis=-1) / square) - HALF_STEP
    drop = (outside - colors)[..., 0] / LIGHT_WEIGHT
    return along + np.clip((drop - TOO_DARK) / (DARK - TOO_DARK), 0, 1) * np.maximum(
        distance - along, 0
    )


def _calc_nearby_mean(colors: Image, where: Mask, radius: float) -> Image:
    total = _blur(colors * where[..., None], radius)
    return total / (_blur(where, radius) + np.finfo(np.float32).eps)[..., None]


def _blur(image: NDArray[Any], deviation: float) -> Image:
    return np.asarray(
        cv2.GaussianBlur(image.astype(np.float32), (0, 0), deviation), dtype=np.float32
    )


def dilate(mask: Mask, width: int) -> Mask:
    """Widens a mask by half of `width` pixels all around."""
    return _morph(mask, cv2.MORPH_DILATE, width)


def remove_thin(mask: Mask) -> Mask:
    """Takes away what is too thin to be object."""
    return _morph(mask, cv2.MORPH_OPEN, OPENING)


def _erode(mask: Mask, width: int) -> Mask:
    return _morph(mask, cv2.MORPH_ERODE, width)


def _morph(mask: Mask, operation: int, width: int) -> Mask:
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (width, width))
    return cv2.morphologyEx(mask.astype(np.uint8), operation, kernel) > 0
