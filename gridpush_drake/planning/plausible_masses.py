"""`PlausibleMassSet`: the masses that an object may have, by what is known of its friction.

Where the center of mass may be: poses under slow pushes show only the relative support friction
k_i = mu_i m_i of each cell (`identification.identifiability`). With friction coefficients between
mu_min and mu_max it agrees with every mass distribution m for which

    k_i / mu_max <= t m_i <= k_i / mu_min   with some t > 0

The farthest that the center of mass of such a distribution can be in a direction d is

    h(d) = max over m of sum m_i d.p_i / sum m_i         (`calc_farthest_center`)

k itself is known up to the posterior's spread. So h is calculated for many draws of k from it that
agree with the pushes, and the value is kept that all but a small fraction of the draws stay below.
The half-planes d.c <= h(d) over many d bound the center of mass c by a polygon, from outside.

`PlausibleMassSet` is these mass distributions and that polygon. The theory is in
`docs/theory/planning.md`, section 3.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import shapely
from numpy.typing import ArrayLike

from gridpush_drake.dynamics.bodies import Bodies
from gridpush_drake.dynamics.physics import GRAVITY
from gridpush_drake.errors import PlanningError
from gridpush_drake.geometry.polygons import bound_by_half_planes
from gridpush_drake.geometry.se2 import Array, make_direction
from gridpush_drake.identification.absolute.estimate import LOG_MASS, AbsoluteEstimate
from gridpush_drake.identification.absolute.force_scale import ForceScale
from gridpush_drake.identification.identifiability import calc_farthest_center
from gridpush_drake.identification.statistics.posterior import DrawJudge, Posterior
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.weighing.region import cut_to_ellipse

MASS_DRAWS = 200
"""Number of draws from the posterior that the set of plausible masses is made of."""

CENTER_CONFIDENCE = 0.99
"""Fraction of the draws for which the bound of the center of mass must hold, in each direction."""

HALF_PLANE_COUNT = 72
"""Number of half-planes that bound the center of mass, evenly spaced over a full turn."""

PRIOR_SIGMAS = 3.0
"""If the center of mass is known beforehand, it is taken to be within this many standard deviations
of that, along x and along y."""

WEIGHED_SIGMAS = 3.5
"""If the object was weighed, mass and center of mass are taken to be within this many standard
deviations of what weighings say, the center in every direction."""


@dataclass(frozen=True, eq=False)
class PlausibleMassSet:
    """Mass distributions held possible, up to a common scale.

    Attributes:
        obj: the object.
        mass_min: (S, n) least mass of each cell, one row for every draw of the relative friction.
        mass_max: (S, n) greatest mass of each cell, one row for every draw.
        confidence: fraction of the draws for which a bound of the center of mass must hold.
        max_total_mass: greatest mass of the whole object that measured forces or weighings allow,
            kg; None where there are none, or the mass was told.
        weighed: what weighings said of mass and center of mass; None where there are none.

    Raises:
        PlanningError: shapes disagree, or the bounds are not positive and ordered.
    """

    obj: GridObject
    mass_min: Array
    mass_max: Array
    confidence: float = 1.0
    max_total_mass: float | None = None
    weighed: AbsoluteEstimate | None = None

    def __post_init__(self) -> None:
        shape = self.mass_min.shape
        if shape != self.mass_max.shape or len(shape) != 2 or shape[1] != self.obj.n:
            raise PlanningError(
                f"mass set: bounds of shapes {shape} and {self.mass_max.shape}; "
                f"expected (S, {self.obj.n})"
            )
        ordered = (self.mass_min > 0) & (self.mass_min <= self.mass_max)
        if not (ordered & np.isfinite(self.mass_max)).all():
            raise PlanningError("mass set: expected 0 < mass_min <= mass_max")
        if not 0 < self.confidence <= 1:
            raise PlanningError(
                f"confidence is {self.confidence!r}; expected a fraction, over 0 and up to 1"
            )

    @classmethod
    def from_posterior(
        cls,
        obj: GridObject,
        posterior: Posterior,
        friction_range: tuple[float, float] | None = None,
        *,
        seed: int = 0,
        force: ForceScale | None = None,
        judge: DrawJudge | None = None,
        weighed: AbsoluteEstimate | None = None,
    ) -> "PlausibleMassSet":
        """Makes the set of all masses that agree with what was learned.

        Args:
            obj: the object.
            posterior: of its relative friction.
            friction_range: least and greatest friction coefficient of any cell; the object's own
                bounds where None.
            seed: of the draws.
            force: what measured forces said, which bound the mass of an object that was not
                weighed.
            judge: says how well draws agree with what was seen, such as the pushes themselves.
            weighed: what weighings said, which bound mass and center of mass.

        Raises:
            PlanningError: the range is not positive and increasing.
        """
        low, high = friction_range or (obj.prior.friction_min, obj.prior.friction_max)
        if not 0 < low <= high < np.inf:
            raise PlanningError(
                f"friction_range is {(low, high)!r}; expected 0 < least <= greatest"
            )
        k, _ = posterior.draw(MASS_DRAWS, seed, judge)
        # All friction together is at least mu_min times the weight.
        heaviest = None
        if force is not None and obj.prior.total_mass is None:
            heaviest = force.bounds[1] / (GRAVITY * low)
        if weighed is not None and obj.prior.total_mass is None:
            mass_std = float(np.sqrt(weighed.covariance[LOG_MASS, LOG_MASS]))
            heaviest = weighed.total_mass * float(np.exp(WEIGHED_SIGMAS * mass_std))
        return cls(
            obj=obj,
            mass_min=k / high,
            mass_max=k / low,
            confidence=CENTER_CONFIDENCE,
            max_total_mass=heaviest,
            weighed=weighed,
        )

    @classmethod
    def of_masses(cls, model: Bodies) -> "PlausibleMassSet":
        """Makes the set of a single mass distribution, which is taken as known."""
        mass = model.params.mass[None]
        return cls(model.obj, mass, mass)

    def calc_support(self, directions: ArrayLike) -> Array:
        """Calculates h: how far the center of mass can be along some directions at most.

        Args:
            directions: (D, 2) unit vectors d, body frame.

        Returns:
            (D,) m.
        """
        p = self.obj.p_BC
        bounds = []
        for d in np.asarray(directions, np.float64):
            farthest = calc_farthest_center(p @ d, self.mass_min, self.mass_max)  # of each draw
            bounds.append(np.quantile(farthest, self.confidence, method="higher"))
        return np.array(bounds)

    @cached_property
    def center_of_mass_polygon(self) -> Array:
        """(V, 2) corners of a convex polygon that the center of mass is in, body frame, m.

        They are counterclockwise. If the object was weighed, the polygon is cut down to where
        weighings leave the center of mass; if the center of mass is known beforehand
        (`obj.prior.center_of_mass`), to a square about that.
        """
        angle = 2 * np.pi * np.arange(HALF_PLANE_COUNT) / HALF_PLANE_COUNT
        directions = make_direction(angle)
        corners = bound_by_half_planes(directions, self.calc_support(directions))
        if self.weighed is not None:
            mean = self.weighed.center_of_mass
            covariance = self.weighed.center_covariance
            corners = cut_to_ellipse(corners, mean, covariance, WEIGHED_SIGMAS)
        at = self.obj.prior.center_of_mass
        if at is None:
            return corners
        reach = PRIOR_SIGMAS * self.obj.prior.center_of_mass_std
        known = shapely.box(at[0] - reach, at[1] - reach, at[0] + reach, at[1] + reach)
        both = shapely.MultiPoint(corners).convex_hull.intersection(known)
        # Where pushes and prior contradict each other, the prior is believed.
        kept = both if isinstance(both, shapely.Polygon) and not both.is_empty else known
        return np.asarray(shapely.geometry.polygon.orient(kept).exterior.coords)[:-1]

    @property
    def middle(self) -> Array:
        """(2,) the mean of that polygon's corners, body frame, m: the estimated center of mass."""
        return self.center_of_mass_polygon.mean(axis=0)
