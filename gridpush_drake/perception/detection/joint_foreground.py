"""What is object where neither color nor depth tells it pixel by pixel: all evidence together.

Three things tell an object that `foreground` tears to pieces or loses: a height that is less than a
pixel's noise but common to many pixels; depth that is missing, as on metal and on black; and colors
that the table has nowhere else. Their evidence is added up, spread along the picture's own edges by
a guided filter (He, Sun and Tang 2013), and then improved by the colors of what was found.

`detection` takes this answer only where `foreground`'s own lacks a part that is surely object. The
theory is in docs/theory/perception.md, section 1.
"""

from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from gridpush_drake.perception.detection.foreground import (
    Foreground,
    Image,
    Mask,
    blur,
    dilate,
    keep_largest,
    refine_boundary,
    remove_thin,
    to_lab,
)
from gridpush_drake.perception.images.frames import Color
from gridpush_drake.perception.images.table_plane import TO_DEVIATION, TablePlane

ABOUT_OBJECT = 15
"""Width of the brush that widens what may be object where the table's heights are taken, pixels."""

MAX_OBJECT = 0.6
"""If more than this fraction of the picture may be object, it is not widened."""

WAVE_RADIUS = 25.0
"""Standard deviation of the blur that tells the depth's slow waves on the table, pixels."""

HEIGHT_RADIUS = 2.0
"""Standard deviation of the blur that takes the noise of single pixels out of heights, pixels."""

MIN_DEVIATION = 2e-4
"""Least standard deviation of blurred heights on the table that is assumed, m."""

PLAINLY_HIGH = 6.0
"""A blurred height of more standard deviations than this is no table."""

HEIGHT_BIAS = 4.0
"""Blurred height at which it says nothing, standard deviations."""

HEIGHT_SLOPE = 0.8
"""Evidence of each standard deviation of blurred height."""

EVIDENCE_LIMITS = (-4.0, 6.0)
"""Least and greatest evidence of height, and of everything together before it is spread."""

COLOR_LIMITS = (-1.0, 6.0)
"""Least and greatest evidence of color: the table's color says little against a white object on a
white table."""

COLOR_BIAS = 5.0
"""Drop of the logarithm of a color's likelihood on the table at which color says nothing."""

COLOR_SLOPE = 0.6
"""Evidence of each unit of that logarithm."""

MEASURED_GAIN = 1.5
"""Height has its full say where at least one over this of the depth about a pixel is measured."""

HOLE_RADIUS = 1.5
"""Standard deviation of the blur that tells how much depth is missing about a pixel, pixels."""

HOLE_EVIDENCE = 2.0
"""Evidence of depth that is missing all about a pixel."""

HOLE_BIAS = 0.2
"""Fraction of missing depth about a pixel at which it begins to say something."""

COLOR_CLUSTERS = 6
"""Number of colors, each a normal distribution, of the table and of the object."""

CLUSTER_SAMPLES = 4000
"""Most pixels that these are taken from."""

MIN_CLUSTER = 0.01
"""A color of a smaller fraction of the pixels is left out."""

LEAST_CLUSTER = 20
"""A color of fewer pixels is left out."""

CLUSTER_ROUNDS = 20
"""Most rounds of the clustering of colors."""

LEAST_COVARIANCE = np.diag([4.0, 1.5, 1.5])
"""Added to the covariance of each color, units of CIE L*a*b* squared."""

SHADOW_STEPS = (5.0, 10.0, 16.0, 22.0)
"""Darkenings by which the table's colors may be in a shadow, units of CIE L*."""

SHADOW_COST = 0.1
"""What each unit of a darkening takes from the logarithm of the likelihood."""

CERTAIN_EVIDENCE = 1.5
"""Evidence from which on a pixel is surely object."""

MIN_CERTAIN_PIXELS = 50
"""With fewer pixels that are surely object, its colors are not learned."""

LEARNING_ROUNDS = 3
"""Number of times that the object's colors are learned, and the evidence is added up."""

COLOR_RATIO = (0.5, 2.0)
"""Weight and greatest evidence of what the learned colors say."""

NEAR_OBJECT = 31
"""Width of the brush that widens what was found, where learned colors count, pixels."""

RING_WIDTHS = (13, 61)
"""Widths of the brushes between which the table's colors nearby are learned, pixels."""

FILTER_RADIUS = 4
"""Half the side of the guided filter's window, pixels."""

FILTER_VARIANCE = 1e-4
"""Variance of the colors, of which 100 CIE units are 1, below which the filter sees no edge."""

MAX_PIECE_GAP = 15
"""Pieces that are less than this far apart are one object, pixels."""

BRIDGE_EVIDENCE = -1.5
"""Least evidence of what joins them."""

MIN_COLOR_DIFFERENCE = 14.0
"""Least difference of the object's and the table's color nearby at which color draws the boundary,
units of CIE L*a*b*; with less it stays where the evidence says."""

MENDING_WIDTH = 41
"""Width of the brush that widens the pieces into which an object has fallen where its boundary was
drawn, pixels: what lies between two of them is object."""

MIN_PIECE = 0.05
"""A piece with less than this fraction of an object's pixels is left out then."""

INSIDE_RADIUS = 7.5
"""Standard deviation of the weights in the object's mean color nearby, pixels."""

OUTSIDE_RADIUS = 6.0
"""Standard deviation of the weights in the table's mean color nearby, pixels."""

BOUNDARY_WIDTH = 7
"""Width of the brush that keeps the boundary's own pixels out of the table's mean color, pixels."""

MAX_MISSED_FRACTION = 0.04
"""An answer lacks a part if it has not this fraction of the pixels that are surely object."""

MISSED_GAP = 11
"""Width of the brush that widens an answer before that is told, pixels."""

PLAINLY_TABLE = -1.0
"""Evidence below which a pixel is plainly table."""

RIM_WIDTH = 5
"""Width of the brush that widens what was found, before another answer has too much, pixels."""

MAX_FALSE_FRACTION = 0.1
"""An answer has too much if this fraction of it is plainly table."""


class _Color(NamedTuple):
    """A color as a normal distribution.

    Attributes:
        weight: its fraction of the pixels.
        mean: (3,) CIE L*a*b*, less the table's.
        precision: (3, 3) inverse of its covariance.
        log_det: logarithm of the determinant of its covariance.
    """

    weight: float
    mean: Image
    precision: Image
    log_det: float


class JointForeground(NamedTuple):
    """An object by all evidence together.

    Attributes:
        mask: (height, width) bool, the pixels that show it, in one piece; with color's boundary.
        evidence: (height, width), above 0 where there is object.
    """

    mask: Mask
    evidence: Image

    def disputes(self, mask: Mask) -> bool:
        """Says whether another answer (height, width) lacks a part, or has one too much."""
        sure = self.evidence > CERTAIN_EVIDENCE
        missed = (sure & ~dilate(mask, MISSED_GAP)).sum() > MAX_MISSED_FRACTION * max(1, sure.sum())
        table = self.evidence < PLAINLY_TABLE
        too_much = (
            mask & table & ~dilate(self.mask, RIM_WIDTH)
        ).sum() > MAX_FALSE_FRACTION * mask.sum()
        return bool(missed or too_much)


def find_jointly(
    color: Color, plane: TablePlane, found: Foreground, painted: Mask
) -> JointForeground | None:
    """Finds the object by all evidence together.

    Args:
        color: (height, width, 3), undistorted.
        plane: the table with the heights above it.
        found: foreground of the picture, for the table's color.
        painted: (height, width) bool, where the table was painted over what hides it; that its
            depth is missing says nothing.

    Returns:
        The object that stands out most; None where nothing does.
    """
    height, table = _weigh_depth(plane, found.mask, painted)
    on_table = _learn_colors(found.difference[table])

    # The likelihood of each color on the table, which may be in a shadow there.
    likely = _calc_log_likelihood(on_table, found.difference)
    for drop in SHADOW_STEPS:
        lit = found.difference + np.array([drop, 0, 0], dtype=np.float32)
        shaded = _calc_log_likelihood(on_table, lit) - np.float32(SHADOW_COST * drop)
        likely = np.maximum(likely, shaded)
    usual = float(np.median(likely[table]))
    by_color = np.clip(COLOR_SLOPE * (usual - likely - COLOR_BIAS), *COLOR_LIMITS)
    own = (height + by_color).astype(np.float32)

    # Each round learns the object's colors from what is surely object, and the table's nearby.
    guide = to_lab(color) / np.float32(100)
    total = own
    for _ in range(LEARNING_ROUNDS):
        evidence = _filter_along_edges(np.clip(total, *EVIDENCE_LIMITS), guide)
        mask = remove_thin(evidence > 0)
        sure = evidence > CERTAIN_EVIDENCE
        if sure.sum() < MIN_CERTAIN_PIXELS:
            break
        ring = dilate(mask, RING_WIDTHS[1]) & ~dilate(mask, RING_WIDTHS[0])
        nearby = on_table
        if ring.any():
            nearby = _learn_colors(found.difference[ring]) or on_table
        of_object = _calc_log_likelihood(_learn_colors(found.difference[sure]), found.difference)
        of_table = np.maximum(_calc_log_likelihood(nearby, found.difference), likely - 1)
        weight, limit = COLOR_RATIO
        ratio = np.clip(weight * (of_object - of_table), -limit, limit)
        total = own + np.where(dilate(mask, NEAR_OBJECT), ratio, np.float32(0))

    joined = _join(mask, evidence)
    if joined is None:
        return None
    return JointForeground(_draw_boundary(joined, found), evidence)


def _weigh_depth(plane: TablePlane, rough: Mask, painted: Mask) -> tuple[Image, Mask]:
    """Weighs blurred heights, and depth that is missing.

    Args:
        plane: the table with the heights above it.
        rough: (height, width) bool, what may be object.
        painted: (height, width) bool, where missing depth says nothing.

    Returns:
        (height, width) their evidence; and (height, width) bool, what is surely table.
    """
    heights = plane.heights.astype(np.float32)
    measured = np.isfinite(heights)
    occupied = _widen(rough)
    for _ in range(2):
        # Waves are what is left on the table; without them, blurred heights tell thin objects.
        waves = _blur_where(heights, measured & ~occupied, WAVE_RADIUS)
        above = _blur_where(heights - waves, measured, HEIGHT_RADIUS)
        on_table = np.abs(above[measured & ~occupied])
        deviation = MIN_DEVIATION
        if len(on_table):
            deviation = max(TO_DEVIATION * float(np.median(on_table)), MIN_DEVIATION)
        relative = above / np.float32(deviation)
        occupied = _widen((relative > PLAINLY_HIGH) | rough)
    says = np.clip(HEIGHT_SLOPE * (relative - HEIGHT_BIAS), *EVIDENCE_LIMITS)
    says *= np.clip(MEASURED_GAIN * blur(measured, HEIGHT_RADIUS), 0, 1)

    # Some depth is missing everywhere; more than twice of that tells metal, or black.
    table = ~occupied
    hole = ~measured & ~painted
    usual = float(hole[table].mean()) if table.any() else 0.0
    missing = blur(hole, HOLE_RADIUS) - np.float32(2 * usual + HOLE_BIAS)
    says += HOLE_EVIDENCE * np.clip(missing, 0, 1)
    return says.astype(np.float32), table


def _widen(mask: Mask) -> Mask:
    """Widens what may be object, unless that would take most of the picture."""
    wide = dilate(mask, ABOUT_OBJECT)
    return wide if wide.mean() <= MAX_OBJECT else mask


def _learn_colors(pixels: Image) -> list[_Color]:
    """Learns the colors of pixels (k, 3), CIE L*a*b* less the table's."""
    if len(pixels) < MIN_CERTAIN_PIXELS:
        return []
    some = pixels[np.linspace(0, len(pixels) - 1, min(len(pixels), CLUSTER_SAMPLES)).astype(int)]
    # OpenCV's generator is seeded, so that the same picture gives the same colors.
    cv2.setRNGSeed(0)
    _, labels, centers = cv2.kmeans(
        data=some.astype(np.float32),
        K=COLOR_CLUSTERS,
        bestLabels=np.zeros((len(some), 1), np.int32),
        criteria=(cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, CLUSTER_ROUNDS, 0.1),
        attempts=1,
        flags=cv2.KMEANS_PP_CENTERS,
    )
    colors = []
    for k in range(len(centers)):
        members = some[labels.ravel() == k]
        if len(members) < max(LEAST_CLUSTER, MIN_CLUSTER * len(some)):
            continue
        covariance = np.cov(members.T) + LEAST_COVARIANCE
        colors.append(
            _Color(
                weight=len(members) / len(some),
                mean=members.mean(axis=0).astype(np.float32),
                precision=np.linalg.inv(covariance).astype(np.float32),
                log_det=float(np.linalg.slogdet(covariance)[1]),
            )
        )
    return colors


def _calc_log_likelihood(colors: list[_Color], image: Image) -> Image:
    """Calculates the logarithm of the likelihood of an image (h, w, 3), by the likeliest color."""
    best = np.full(image.shape[:2], -np.inf, dtype=np.float32)
    for each in colors:
        # off^T P off, channel by channel: an image of 3 channels has no faster einsum.
        off = [image[..., i] - each.mean[i] for i in range(3)]
        squared = np.zeros_like(best)
        for i in range(3):
            for j in range(3):
                squared += off[i] * each.precision[i, j] * off[j]
        constant = np.float32(np.log(each.weight) - 0.5 * each.log_det)
        best = np.maximum(best, constant - np.float32(0.5) * squared)
    return best


def _filter_along_edges(evidence: Image, guide: Image) -> Image:
    """Spreads evidence (h, w) over what has one color in the guide (h, w, 3): a guided filter."""
    side = (2 * FILTER_RADIUS + 1, 2 * FILTER_RADIUS + 1)

    def mean(image: NDArray[Any]) -> Image:
        return np.asarray(cv2.blur(image, side), dtype=np.float32)

    # In each window the evidence is taken for a linear function of color, a . I + b.
    middle = mean(guide)
    level = mean(evidence)
    with_evidence = mean(guide * evidence[..., None]) - middle * level[..., None]
    variance = np.empty((*evidence.shape, 3, 3), dtype=np.float32)
    for i in range(3):
        for j in range(i, 3):
            product = mean(guide[..., i] * guide[..., j]) - middle[..., i] * middle[..., j]
            variance[..., i, j] = product
            variance[..., j, i] = product
    variance += FILTER_VARIANCE * np.eye(3, dtype=np.float32)
    a = np.linalg.solve(variance, with_evidence[..., None])[..., 0]
    b = level - (a * middle).sum(axis=-1)
    return (mean(a) * guide).sum(axis=-1) + mean(b)


def _join(mask: Mask, evidence: Image) -> Mask | None:
    """Joins the pieces of the plainest object; None where there is none."""
    brush = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (MAX_PIECE_GAP, MAX_PIECE_GAP))
    closed = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_CLOSE, brush)
    count, labels = cv2.connectedComponents(closed, connectivity=8)
    if count < 2:
        return None
    weights = np.where(mask, np.clip(evidence, 0, EVIDENCE_LIMITS[1]), 0)
    totals = np.bincount(labels.ravel(), weights=weights.ravel(), minlength=count)
    totals[0] = 0  # the table
    chosen = labels == int(np.argmax(totals))

    # What joins the pieces must not be plainly table.
    joined = chosen & (mask | (evidence > BRIDGE_EVIDENCE))
    smooth = cv2.morphologyEx(joined.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    return keep_largest(smooth > 0)


def _draw_boundary(mask: Mask, found: Foreground) -> Mask:
    """Draws a mask's boundary by color, where the object's color differs from the table's."""
    drawn, _ = refine_boundary(mask, found)
    inside = cv2.erode(mask.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    of_object = _blur_where(found.difference, inside, INSIDE_RADIUS)
    of_table = _blur_where(found.difference, ~dilate(mask, BOUNDARY_WIDTH), OUTSIDE_RADIUS)
    contrast = np.sqrt(((of_object - of_table) ** 2).sum(axis=-1))
    return _mend(np.where(contrast > MIN_COLOR_DIFFERENCE, drawn, mask), mask)


def _mend(drawn: Mask, before: Mask) -> Mask:
    """Joins what was one piece before its boundary was drawn.

    Beside a part that differs much from the table, color counts also on the beginning of one that
    hardly does, and takes it for table: then the object falls apart there.

    Args:
        drawn: (height, width) bool, the mask with its boundary drawn.
        before: (height, width) bool, the mask before that, in one piece.

    Returns:
        The mask in one piece.
    """
    count, labels, stats, _ = cv2.connectedComponentsWithStats(
        drawn.astype(np.uint8), connectivity=4
    )
    least = MIN_PIECE * drawn.sum()
    large = [i for i in range(1, count) if stats[i, cv2.CC_STAT_AREA] >= least]
    if len(large) < 2:
        return keep_largest(drawn)

    # The pixels between two large pieces are what they were before.
    near = np.zeros(drawn.shape, dtype=np.int64)
    for i in large:
        near += dilate(labels == i, MENDING_WIDTH)
    return keep_largest(np.isin(labels, large) | (before & (near > 1)))


def _blur_where(image: NDArray[Any], where: Mask, deviation: float) -> Image:
    """Takes the mean of an image's pixels of a mask near each pixel."""
    weight = blur(where, deviation) + np.float32(1e-3)
    counted = where if image.ndim == 2 else where[..., None]
    total = blur(np.where(counted, image, 0), deviation)
    return total / (weight if image.ndim == 2 else weight[..., None])
