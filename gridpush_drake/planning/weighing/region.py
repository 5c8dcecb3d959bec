"""Where a center of mass may be: a convex polygon, cut down to what an estimate leaves."""

import numpy as np
import shapely
from shapely import Polygon

from gridpush_drake.geometry.polygons import MIN_CORNERS, hull_of
from gridpush_drake.geometry.se2 import Array, make_direction

ELLIPSE_SIDES = 24
"""Number of sides of the polygon that stands for an ellipse."""


def cut_to_ellipse(corners: Array, mean: Array, covariance: Array, sigmas: float) -> Array:
    """Cuts a convex polygon down to what an estimate of a point in it leaves.

    Args:
        corners: (V, 2) corners of the polygon, m.
        mean: (2,) estimate of the point, m.
        covariance: (2, 2) of it, m².
        sigmas: how many standard deviations the point may be off, in every direction.

    Returns:
        (V', 2) corners of what both allow, counterclockwise; of the estimate's alone, where they
        contradict each other.
    """
    # The ellipse is a circle that is stretched; the polygon about it has its sides as tangents.
    half = np.pi / ELLIPSE_SIDES
    circle = make_direction(np.linspace(0.0, 2 * np.pi, ELLIPSE_SIDES, endpoint=False))
    stretch = np.linalg.cholesky(covariance)
    ellipse = mean + sigmas / np.cos(half) * circle @ stretch.T
    # What both allow is convex, too.
    region = shapely.MultiPoint(corners).convex_hull
    both = shapely.intersection(region, Polygon(ellipse))
    kept = hull_of(shapely.get_coordinates(both))
    if len(kept) >= MIN_CORNERS:
        return kept
    return ellipse
