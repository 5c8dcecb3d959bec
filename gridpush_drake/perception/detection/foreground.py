"""Which pixels show something else than the table, by height and color together.

The table's color is a smooth polynomial over the picture, fitted to what is certainly table:
neither high nor, in later rounds, foreground. What a pixel's color c and height h say adds up:

    s = clip((|chroma(c) - table|^2/sigma^2 + (light(c) - table)^2/tau^2 - 9)/2)
        + clip(1.5 (h/sigma_h - 3))

with a wide tau where the pixel is darker than the table: that may be a shadow. Depth images miss
edges by some pixels, so that along them color speaks louder. The boundary of what is left is then
drawn anew where the color is half way between the object's and the table's, each the mean nearby; a
shadow is of the table's. What is too dark for a shadow, such as a side in the dark, lies as far on
that way as it is from the table, in whatever direction.

Which piece of the foreground is the object is decided in `detection` and `tracking`. The theory is
in docs/theory/perception.md, section 1.
"""

from typing import Any, Literal, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from gridpush_drake.geometry.se2 import Array
from gridpush_drake.perception.images.frames import Color, Mask
from gridpush_drake.perception.images.pixel_kernels import (
    BLOCK_SIZE,
    ColorLevel,
    calc_color_distances,
    calc_levels,
    sum_blocks,
)
from gridpush_drake.perception.images.table_plane import (
    TO_DEVIATION,
    TablePlane,
    calc_polynomial,
    make_basis,
)

Image = NDArray[np.float32]
Cues = Literal["both", "color", "depth"]

LIGHT_WEIGHT = 0.6
"""Weight of lightness where the boundary is drawn, with chroma at 1: a shadow differs from the
table in lightness alone."""

SHADOW_STD = 9.0
"""Standard deviation of the darkening that a shadow brings, units of CIE L*."""

MIN_COLOR_DEVIATION = 1.0
"""Least standard deviation of the table's color that is assumed, units of CIE L*a*b*: a table that
is perfectly even would let any speck count."""

COLOR_BIAS = 9.0
"""Squared distance of a color from the table's at which it says nothing; more speaks for the
object, less for the table. Unit: variances of the table's color."""

MIN_COLOR_SCORE = -3.0
"""Least score that color gives, however well it is the table's."""

MAX_COLOR_SCORE = 8.0
"""Greatest score that color gives, however far it is from the table's."""

HEIGHT_SLOPE = 1.5
"""Score that each standard deviation of height gives."""

HEIGHT_BIAS = 3.0
"""Height at which it says nothing, standard deviations of the table's heights; higher speaks for
the object, lower for the table."""

MAX_HEIGHT_SCORE = 5.0
"""Greatest score that height gives, for the object or for the table."""

HIGH_SIGMAS = 5.0
"""A pixel that is more than this many standard deviations above the table is certainly no table."""

EDGE_BAND = 13
"""Width of the band along the edges of what is high in which heights count for less, pixels: depth
images miss edges by some pixels."""

EDGE_WEIGHT = 0.25
"""Weight of the score by height in the band along the edges of what is high."""

RIM_FRACTION = 0.06
"""Width of the picture's rim that is taken for table where there is no depth, as a part of the
picture's sides."""

NEAR_OBJECT = 21
"""Width of the brush that widens what is taken for object when the table's color is fitted, pixels:
the object's shadow and reflection are no table."""

RIM_ORDER = 2
"""Degree of the polynomial of the table's color where only the picture's rim is known to be
table; a higher one would bend freely in the middle."""

COLOR_DEGREE = 3
"""Degree of the polynomial of the table's color once all of the table is known."""

STD_FACTORS = (3.0, 2.0, 1.5, 1.0)
"""Factor on the standard deviations of the table's color in each round of telling table and
foreground apart. The first fits are to the rim, or to what is near the object in color, and must
not throw out table that they have not seen."""

FIT_ROUNDS = 10
"""Number of reweighted least-squares fits of the table's color."""

FIT_SIDE = 140
"""The fit of the table's color looks at about the square of this many pixels, evenly over the
picture."""

CAUCHY_SCALE = 3.0
"""Scale of the Cauchy weights in the fit of the table's color, standard deviations: a color this
far off counts half."""

SCORE_SMOOTHING = 1.2
"""Standard deviation of the blur of scores, pixels."""

OPENING_SIZE = 3
"""What is narrower than this is too thin to be object and is taken away, pixels."""

CLOSING_SIZE = 5
"""Gaps narrower than this are closed, and high places narrower than this are left out, pixels."""

MIN_HOLE = 15
"""A hole of fewer pixels than this is filled."""

HOLE_SCORE = -1.0
"""A pixel with a lower score than this plainly shows the table."""

PARENT_COLUMN = 3
"""Column of OpenCV's hierarchy of contours with the contour about this one; -1 where it is no
hole."""

HOLE_FRACTION = 0.5
"""A hole is filled if less than this fraction of its pixels plainly shows the table."""

BOUNDARY_BAND = 6
"""The final boundary lies at most this far from the one before, in each round, pixels."""

INSIDE_RADIUS = 7.5
"""Standard deviation of the weights in the object's mean color nearby, pixels."""

OUTSIDE_RADIUS = 4.0
"""Standard deviation of the weights in the table's mean color nearby, pixels; less than for the
object, because shadows are narrow."""

MEAN_GAP = 3
"""Width of the strip at the boundary that no mean color includes, pixels: its pixels are mixtures
of both."""

TOO_DARK = 1.5 * SHADOW_STD
"""A pixel that is darker than the table nearby by more than this may be more than a shadow, units
of CIE L*."""

SHADOW_LIMIT = 3 * SHADOW_STD
"""A pixel that is darker than the table nearby by more than this is surely no shadow, units of CIE
L*."""

BOUNDARY_ROUNDS = 4
"""Number of times that the boundary is drawn; each time, the mean colors are taken anew."""

BOUNDARY_SMOOTHING = 0.5
"""Standard deviation of the blur of the boundary's level, pixels; a wider one would round corners
and close holes."""

MIN_CONTRAST = 9.0
"""Added to the squared difference of the two mean colors, units of CIE L*a*b* squared: where both
are alike, noise must not decide where the boundary is."""

MAX_CONTRADICTION = 0.1
"""If color and depth contradict each other about more than this fraction of an object, they are
taken to show different things. In five real photographs with their own depth it is up to 0.02, with
another photograph's depth 0.2 and more."""

COLOR_LEVEL = ColorLevel(
    min_contrast=MIN_CONTRAST, light_weight=LIGHT_WEIGHT, too_dark=TOO_DARK, dark=SHADOW_LIMIT
)
"""How the way from the table's color to the object's is measured where the boundary is drawn."""

BLUR_KERNEL = np.ones((5, 5), np.uint8)
"""A pixel and all that the blur of the boundary's level reaches from it."""

HEIGHT_SAYS = 0.15
"""Most that height moves a pixel along the way from the table's color to the object's, which has
length 1."""


class Foreground(NamedTuple):
    """Table and everything else, told apart in a picture.

    Attributes:
        mask: (height, width) bool, everything that is no table.
        score: (height, width), above 0 where it is no table.
        difference: (height, width, 3) color less the table's, CIE L*a*b*.
        deviation: (3,) standard deviations of the table's color; zeros where color was not looked
            at.
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

    # What is certainly table to begin with: what is not near anything high, or the picture's rim.
    if high is None:
        table = _make_rim(color.shape[:2])
        order = RIM_ORDER
    else:
        table = ~dilate(high, NEAR_OBJECT)
        order = COLOR_DEGREE

    # Each round fits the color to what the round before took for table.
    for generosity in STD_FACTORS:
        difference, deviation = fit_table_color(lab, table, order)
        found = score_pixels(difference, generosity * deviation, plane, high, cues)
        table = ~dilate(found.mask, NEAR_OBJECT)
        order = COLOR_DEGREE
    return found


def to_lab(color: Color) -> Image:
    """Turns an image (height, width, 3) uint8 into CIE L*a*b*, float32."""
    scaled = color.astype(np.float32) / np.iinfo(np.uint8).max
    return np.asarray(cv2.cvtColor(scaled, cv2.COLOR_RGB2LAB))


def find_high(plane: TablePlane) -> Mask:
    """Finds the pixels that certainly show what stands above the table."""
    high = plane.heights > HIGH_SIGMAS * plane.deviation
    return _morph(high, cv2.MORPH_OPEN, CLOSING_SIZE)


def fit_table_color(lab: Image, table: Mask, order: int) -> tuple[Image, Array]:
    """Fits the table's color, robustly.

    Args:
        lab: (height, width, 3).
        table: pixels taken for table, most of them rightly.
        order: degree of the polynomial.

    Returns:
        (height, width, 3) the picture less the table's color, and (3,) the standard deviations of
        that on the table.
    """
    # A fraction of the pixels is enough for so few coefficients.
    rows, columns = lab.shape[:2]
    stride = max(1, round(np.sqrt(rows * columns) / FIT_SIDE))
    some = table[::stride, ::stride]
    A = make_basis(lab.shape, order, stride)[some]
    colors = lab[::stride, ::stride][some].astype(np.float64)

    weight = np.ones(len(A))
    fitted: Array = np.zeros((A.shape[1], 3))
    deviation: Array = np.ones(3)
    for _ in range(FIT_ROUNDS):
        # The normal equations are seventy times as fast as A itself, and polynomials on [-1, 1] are
        # far enough from singular for them.
        W = A * weight[:, None]
        right = W.T @ (colors * weight[:, None])
        solution, *_ = np.linalg.lstsq(W.T @ W, right)
        fitted = np.asarray(solution, dtype=np.float64)

        # Cauchy's weights: what is not table after all loses its say.
        off = colors - A @ fitted
        scatter = TO_DEVIATION * np.median(np.abs(off), axis=0)
        deviation = np.maximum(scatter, MIN_COLOR_DEVIATION)
        relative = off / (CAUCHY_SCALE * deviation)
        weight = 1 / (1 + (relative**2).sum(axis=1))
    return (lab - calc_polynomial(lab.shape, order, fitted)).astype(np.float32), deviation


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
        deviation: (3,) standard deviations of the table's color.
        plane: the table with the heights above it; None without depth.
        high: where `find_high` says so; None without depth.
        cues: what is looked at.

    Returns:
        The foreground, in one piece or several.
    """
    score = np.zeros(difference.shape[:2], dtype=np.float32)
    heights = np.zeros_like(score)

    # The first part of s: color.
    if cues != "depth":
        distance = _calc_color_distance(difference, deviation)
        score = np.clip((distance - COLOR_BIAS) / 2, MIN_COLOR_SCORE, MAX_COLOR_SCORE)

    # The second part of s: height, which says nothing where it was not measured.
    if plane is not None and high is not None:
        relative = (plane.heights / plane.deviation).astype(np.float32, copy=False)
        says = HEIGHT_SLOPE * (relative - HEIGHT_BIAS)
        says[np.isnan(says)] = 0.0
        says = np.clip(says, -MAX_HEIGHT_SCORE, MAX_HEIGHT_SCORE)
        heights = (HEIGHT_SAYS / MAX_HEIGHT_SCORE) * says
        if cues == "both":
            # Depth images miss edges by some pixels, and color does not.
            band = dilate(high, EDGE_BAND) & ~erode(high, EDGE_BAND)
            says = np.where(band, EDGE_WEIGHT * says, says)
        score = score + says

    # Neighbors decide together. Narrow gaps are closed unless the table shows through them.
    smooth = blur(score, SCORE_SMOOTHING)
    mask = remove_thin(smooth > 0)
    closed = _morph(mask, cv2.MORPH_CLOSE, CLOSING_SIZE)
    mask = fill_holes(closed & (smooth >= HOLE_SCORE), smooth)
    return Foreground(
        mask=mask,
        score=smooth,
        difference=difference,
        deviation=deviation,
        heights=heights,
    )


def calc_contradiction(mask: Mask, found: Foreground, plane: TablePlane | None) -> float:
    """Calculates about how much of an object color and height contradict each other.

    Args:
        mask: (height, width) bool, pixels that show the object.
        found: foreground of the picture.
        plane: the table with the heights above it; None without depth.

    Returns:
        The fraction of the object that has another color than the table but not its height, or that
        is certainly high but has the table's color, whichever is larger; 0 where the other of the
        two sees no object at all.
    """
    if plane is None or not mask.any():
        return 0.0
    colored = _calc_color_distance(found.difference, found.deviation) > COLOR_BIAS
    heights = np.nan_to_num(plane.heights / plane.deviation, nan=HEIGHT_BIAS)
    area = mask.sum()

    # Of another color than the table, and as low; said only if depth sees objects at all.
    flat = 0
    if find_high(plane).sum() > MAX_CONTRADICTION * area:
        low = heights < HEIGHT_BIAS
        flat = (mask & colored & low).sum()

    # As high as an object, and of the table's color; said only if color sees the object at all.
    plain = 0
    if (mask & colored).sum() > MAX_CONTRADICTION * area:
        tall = heights > HIGH_SIGMAS
        plain = (mask & ~colored & tall).sum()
    return float(max(flat, plain) / area)


def refine_boundary(
    mask: Mask, found: Foreground, covered: Mask | None = None
) -> tuple[Mask, Image]:
    """Draws an object's boundary where the color is half way between object and table nearby.

    Args:
        mask: (height, width) bool, pixels that show the object; in one piece, unless something
            covers it.
        found: foreground of the picture.
        covered: pixels which show something else, such as the arm, and say nothing; None where
            there are none.

    Returns:
        The mask, and (height, width) how much of each pixel is object, 0 to 1.
    """
    if not found.difference.any():
        return mask, blur(mask, BOUNDARY_SMOOTHING)
    # Lightness counts less than chroma: a shadow must not move the boundary.
    colors = found.difference * np.array([LIGHT_WEIGHT, 1, 1], dtype=np.float32)
    shown = np.ones_like(mask)
    if covered is not None:
        shown = ~covered
    table = shown & ~mask
    for _ in range(BOUNDARY_ROUNDS):
        # c_o and c_t: mean colors nearby, of what is surely object and surely table.
        certain_object = erode(mask, MEAN_GAP) & shown
        certain_table = ~dilate(mask, MEAN_GAP) & shown
        inside, outside = sum_blocks(colors, certain_object, certain_table)
        inside = blur(inside, INSIDE_RADIUS / BLOCK_SIZE)
        outside = blur(outside, OUTSIDE_RADIUS / BLOCK_SIZE)

        # How far each color is on the way from c_t to c_o; the boundary is at level 0. Far from the
        # boundary before, nothing changes sides.
        width = 2 * BOUNDARY_BAND + 1
        band = dilate(mask, width) & ~erode(mask, width)
        about = cv2.dilate(band.view(np.uint8), BLUR_KERNEL)
        along = np.zeros(mask.shape, dtype=np.float32)
        calc_levels(colors, inside, outside, about, COLOR_LEVEL, along)
        level = blur(along + found.heights, BOUNDARY_SMOOTHING)
        sides = np.where(mask, np.float32(1), np.float32(-1))
        level = np.where(band, level, sides)
        mask = level > 0
        if covered is None:
            mask = keep_largest(mask)

    # Where holes were filled or pieces dropped, the level does not say how much is object.
    mask = fill_holes(mask, found.score, table)
    agrees = mask == (level > 0)
    coverage = np.where(agrees, np.clip(level + 0.5, 0, 1), mask)
    return mask, coverage.astype(np.float32)


def _calc_color_distance(difference: Image, deviation: Array) -> Image:
    """Calculates the squared distance of colors from the table's, in the table's variances.

    Args:
        difference: (height, width, 3) color less the table's, CIE L*a*b*.
        deviation: (3,) standard deviations of the table's color.

    Returns:
        (height, width) squared distance, with a wide deviation where a pixel is darker.
    """
    distances = np.empty(difference.shape[:2], dtype=np.float32)
    calc_color_distances(difference, np.asarray(deviation, dtype=np.float64), SHADOW_STD, distances)
    return distances


def keep_largest(mask: Mask) -> Mask:
    """Keeps the largest piece of a mask; nothing of an empty one."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats(
        mask.astype(np.uint8), connectivity=4
    )
    if count < 2:
        return mask
    area = stats[1:, cv2.CC_STAT_AREA]
    return labels == 1 + int(np.argmax(area))


def fill_holes(mask: Mask, score: Image, table: Mask | None = None) -> Mask:
    """Fills the holes of a mask through which the table is not plainly seen.

    Args:
        mask: (height, width) bool.
        score: (height, width), below HOLE_SCORE where the table is plainly seen.
        table: (height, width) bool, pixels that are known to be table: a hole that has one of them
            stays; None where there are none.

    Returns:
        The mask with its holes filled.
    """
    # Most masks have no hole at all, which contours tell sooner than pieces do.
    _, hierarchy = cv2.findContours(mask.view(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
    if hierarchy is None or not (hierarchy[0, :, PARENT_COLUMN] >= 0).any():
        return mask
    count, labels, stats, _ = cv2.connectedComponentsWithStats(
        (~mask).astype(np.uint8), connectivity=4
    )
    area = stats[:, cv2.CC_STAT_AREA]
    plain = np.bincount(labels[score < HOLE_SCORE], minlength=count)
    filled = (area < MIN_HOLE) | (plain < HOLE_FRACTION * area)

    # What reaches the picture's rim is no hole.
    for rim in (labels[0], labels[-1], labels[:, 0], labels[:, -1]):
        filled[rim] = False
    if table is not None:
        filled[labels[table]] = False
    return mask | filled[labels]


def _make_rim(shape: tuple[int, ...]) -> Mask:
    """Makes a mask (height, width) of the picture's rim."""
    rim = np.ones(shape, dtype=bool)
    rows, columns = (round(RIM_FRACTION * side) for side in shape)
    rim[rows:-rows, columns:-columns] = False
    return rim


def blur(image: NDArray[Any], deviation: float) -> Image:
    """Blurs an image by a Gaussian of this standard deviation, pixels."""
    blurred = cv2.GaussianBlur(image.astype(np.float32), (0, 0), deviation)
    return np.asarray(blurred, dtype=np.float32)


def dilate(mask: Mask, width: int) -> Mask:
    """Widens a mask by half of `width` pixels all around."""
    return _morph(mask, cv2.MORPH_DILATE, width)


def remove_thin(mask: Mask) -> Mask:
    """Takes away what is too thin to be object."""
    return _morph(mask, cv2.MORPH_OPEN, OPENING_SIZE)


def erode(mask: Mask, width: int) -> Mask:
    """Narrows a mask by half of `width` pixels all around."""
    return _morph(mask, cv2.MORPH_ERODE, width)


def _morph(mask: Mask, operation: int, width: int) -> Mask:
    """Applies one of OpenCV's morphological operations with a round brush of this width, pixels."""
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (width, width))
    return cv2.morphologyEx(mask.astype(np.uint8), operation, kernel) > 0
