"""Whether an object stays on the table, judged on the set of masses that agree with what was seen.

Poses under slow pushes show the relative support friction k_i = mu_i m_i alone (`identification.identifiability`). With
friction coefficients between mu_min and mu_max every mass distribution

    k_i / mu_max <= t m_i <= k_i / mu_min,    t > 0

agrees with it. The farthest that its center of mass can be in a direction d is a linear-fractional program,

    h(d) = max sum m_i d.p_i / sum m_i

whose solution takes every cell on the far side of the line d.p = h as heavy, and on the near side as light, as can be:
sorting the cells along d and trying every cut finds it. k itself is known up to the posterior's spread: h is taken for
many draws from it that agree with the pushes (`consistent_draws`), and the value is kept that all but a small share of
the draws stay below. The half-planes
d.c <= h(d) over many d bound the center of mass by a polygon, from outside.

The object stays put while its center of mass is inside the convex hull of what holds it: the cells whose centers are on
the table, at least an inset away from its edge.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from gridpush_drake.errors import PlanningError
from gridpush_drake.geometry.convex import bound_by_half_planes, hull_of
from gridpush_drake.geometry.se2 import make_direction
from gridpush_drake.identification.posterior import Posterior, draw_consistent
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.pregrasp.support_margin import calc_margins
from gridpush_drake.planning.support_surface import SupportSurface, find_supported

Array = NDArray[np.float64]

DRAWS = 300
"""From the posterior."""

CONFIDENCE = 0.99
"""Share of the draws whose every mass distribution the bound holds for, by direction."""

DIRECTIONS = 72
"""Half-planes that bound the center of mass; every 5°."""

PRIOR_SIGMAS = 3.0
"""Standard deviations about a center of mass known beforehand that the set is cut down to."""

SUPPORT_INSET = 0.002
"""m inside the edge that a cell's center must be to count as held: what a pose may be wrong by."""


MIN_SHARE = 1e-12
"""Of the friction that a cell is given where a draw has none: masses must be positive."""


@dataclass(frozen=True, eq=False)
class PlausibleMassSet:
    """Mass distributions held possible, up to a common scale.

    Attributes:
        obj: the object.
        least: (S, n) the least mass of each cell, one row for every draw of the relative friction.
        most: (S, n) the greatest.
        confidence: share of the draws that a bound must hold for.

    Raises:
        PlanningError: shapes disagree, or the bounds are not positive and ordered.
    """

    obj: GridObject
    least: Array
    most: Array
    confidence: float = 1.0

    def __post_init__(self) -> None:
        if self.least.shape != self.most.shape or self.least.ndim != 2 or self.least.shape[1] != self.obj.n:
            raise PlanningError(
                f"mass set: bounds of shapes {self.least.shape} and {self.most.shape}; expected (S, {self.obj.n})"
            )
        if not ((self.least > 0) & (self.least <= self.most) & np.isfinite(self.most)).all():
            raise PlanningError("mass set: expected 0 < least <= most")
        if not 0 < self.confidence <= 1:
            raise PlanningError(f"confidence is {self.confidence!r}; expected a share, over 0 and up to 1")

    @classmethod
    def from_posterior(
        cls,
        obj: GridObject,
        posterior: Posterior,
        friction_range: tuple[float, float] | None = None,
        *,
        draws: int = DRAWS,
        confidence: float = CONFIDENCE,
        seed: int = 0,
    ) -> "PlausibleMassSet":
        """All masses that agree with what was learned.

        Args:
            obj: the object.
            posterior: of its relative friction.
            friction_range: least and greatest friction coefficient of any cell; the object's own bounds where None.
            draws: from the posterior.
            confidence: share of them that a bound must hold for.
            seed: of the draws.

        Returns:
            The set.

        Raises:
            PlanningError: the range is not positive and increasing.
        """
        low, high = friction_range or (obj.prior.friction_min, obj.prior.friction_max)
        if not 0 < low <= high < np.inf:
            raise PlanningError(f"friction_range is {(low, high)!r}; expected 0 < least <= greatest")
        share, _ = draw_consistent(posterior, draws, seed)
        share = np.maximum(share, MIN_SHARE)
        return cls(obj, share / high, share / low, confidence)

    @classmethod
    def of_masses(cls, obj: GridObject, params: CellParameters) -> "PlausibleMassSet":
        """One mass distribution, taken as known."""
        mass = params.mass[None]
        return cls(obj, mass, mass)

    def calc_support(self, directions: ArrayLike) -> Array:
        """How far the center of mass can be in directions, the greatest over the set.

        Args:
            directions: (D, 2) unit vectors, body frame.

        Returns:
            (D,) h, m.
        """
        far = [self._calc_farthest(d) for d in np.asarray(directions, dtype=np.float64)]
        return np.array([np.quantile(values, self.confidence, method="higher") for values in far])

    def _calc_farthest(self, direction: Array) -> Array:
        """(S,) h of each draw: the best of all cuts."""
        along = self.obj.p_BC @ direction
        order = np.argsort(along)
        p, least, most = along[order], self.least[:, order], self.most[:, order]
        none = np.zeros((len(least), 1))
        mass = _sum_up(least, none) + _sum_down(most, none)
        moment = _sum_up(least * p, none) + _sum_down(most * p, none)
        return np.asarray((moment / mass).max(axis=1))

    @cached_property
    def center_of_mass_polygon(self) -> Array:
        """(V, 2) corners of a convex polygon that the center of mass is in, body frame, m; counterclockwise.

        A center of mass known beforehand (`obj.prior.center_of_mass`) cuts it down to a square about that.
        """
        angle = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
        directions = make_direction(angle)
        corners = bound_by_half_planes(directions, self.calc_support(directions))
        at = self.obj.prior.center_of_mass
        if at is None:
            return corners
        reach = PRIOR_SIGMAS * self.obj.prior.center_of_mass_std
        known = shapely.box(at[0] - reach, at[1] - reach, at[0] + reach, at[1] + reach)
        both = shapely.MultiPoint(corners).convex_hull.intersection(known)
        kept = both if isinstance(both, shapely.Polygon) and not both.is_empty else known
        return np.asarray(shapely.geometry.polygon.orient(kept).exterior.coords)[:-1]


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
        masses: the masses held possible.
        poses: (K, 3) X_WB, m and rad.
        surface: the table.
        inset: m inside the edge that a cell's center must be to hold.

    Returns:
        (K,) m; negative where some mass distribution tips.
    """
    obj = masses.obj
    q = np.asarray(poses, dtype=np.float64).reshape(-1, 3)
    order = np.lexsort((obj.p_BC[:, 1], obj.p_BC[:, 0]))
    held = find_supported(obj, q, surface, inset)[:, order]
    margins = np.empty(len(q))
    calc_margins(obj.p_BC[order], np.ascontiguousarray(held), masses.center_of_mass_polygon, margins)
    return margins


def calc_stability_margin(
    masses: PlausibleMassSet, pose: ArrayLike, surface: SupportSurface, inset: float = SUPPORT_INSET
) -> float:
    """The margin at one pose (3,), m; see `calc_stability_margins`."""
    return float(calc_stability_margins(masses, pose, surface, inset)[0])


def _sum_up(values: Array, none: Array) -> Array:
    """(S, n+1) sums of the first 0..n values."""
    return np.concatenate([none, np.cumsum(values, axis=1)], axis=1)


def _sum_down(values: Array, none: Array) -> Array:
    """(S, n+1) sums of the last n..0 values."""
    return np.concatenate([np.cumsum(values[:, ::-1], axis=1)[:, ::-1], none], axis=1)
