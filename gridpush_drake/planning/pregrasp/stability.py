"""Whether an object stays on the table, judged on the set of masses that agree with what was seen.

The object stays put while its center of mass, wherever it may be (`uncertainty.PlausibleMassSet`), is inside the convex
hull of what holds it: the cells whose centers are on the table, at least an inset away from its edge.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridpush_drake.geometry.convex import hull_of
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.pregrasp.support_margin import calc_margins
from gridpush_drake.planning.pregrasp.uncertainty import PlausibleMassSet
from gridpush_drake.planning.support_surface import SupportSurface, find_supported

Array = NDArray[np.float64]

SUPPORT_INSET = 0.002
"""m inside the edge that a cell's center must be to count as supported: what a pose may be wrong by."""


def calc_support_polygon(
    obj: GridObject, pose: ArrayLike, surface: SupportSurface, inset: float = SUPPORT_INSET
) -> Array:
    """What holds the object: the convex hull of the cells' centers that are on the table.

    Args:
        obj: the object.
        pose: (3,) X_WB, m and rad.
        surface: the table.
        inset: m inside the edge that a center must be.

    Returns:
        (V, 2) corners, body frame, m, counterclockwise; empty where no three cells hold it.
    """
    return hull_of(obj.p_BC[find_supported(obj, pose, surface, inset)])


def calc_stability_margins(
    masses: PlausibleMassSet, poses: ArrayLike, surface: SupportSurface, inset: float = SUPPORT_INSET
) -> Array:
    """How far the center of mass at its worst stays inside what holds the object, at many poses.

    Args:
        masses: the plausible masses.
        poses: (K, 3) X_WB, m and rad.
        surface: the table.
        inset: m inside the edge that a cell's center must be to hold.

    Returns:
        (K,) m; negative where some mass distribution tips.
    """
    obj = masses.obj
    q = np.asarray(poses, dtype=np.float64).reshape(-1, 3)
    order = np.lexsort((obj.p_BC[:, 1], obj.p_BC[:, 0]))
    supported = find_supported(obj, q, surface, inset)[:, order]
    margins = np.empty(len(q))
    calc_margins(obj.p_BC[order], np.ascontiguousarray(supported), masses.center_of_mass_polygon, margins)
    return margins


def calc_stability_margin(
    masses: PlausibleMassSet, pose: ArrayLike, surface: SupportSurface, inset: float = SUPPORT_INSET
) -> float:
    """The margin at one pose (3,), m; see `calc_stability_margins`."""
    return float(calc_stability_margins(masses, pose, surface, inset)[0])
