"""What is known of an object, in the forms that pre-grasp decisions take: Identification -> UncertainModel.

Poses under slow pushes show the relative support friction k_i = mu_i m_i alone
(`identification.identifiability`). With friction coefficients between mu_min and mu_max every mass
distribution

    k_i / mu_max <= t m_i <= k_i / mu_min,    t > 0

agrees with it. The farthest that its center of mass can be in a direction d is

    h(d) = max sum m_i d.p_i / sum m_i

(`calc_farthest_center`). k itself is known up to the posterior's spread: h is taken for many draws
from it that agree with the pushes, and the value is kept that all but a small share of the draws
stay below. The half-planes d.c <= h(d) over many d bound the center of mass by a polygon, from
outside.
"""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import shapely
from numpy.typing import ArrayLike
from threadpoolctl import threadpool_limits

from gridpush_drake.dynamics.physics import GRAVITY, QUASI_STATIC, Physics
from gridpush_drake.errors import PlanningError
from gridpush_drake.geometry.polygons import bound_by_half_planes
from gridpush_drake.geometry.se2 import Array, make_direction, transform_back
from gridpush_drake.identification.evidence import PushEvidence
from gridpush_drake.identification.force_scale import ForceScale
from gridpush_drake.identification.hypotheses import SmoothField
from gridpush_drake.identification.identifiability import calc_farthest_center
from gridpush_drake.identification.learning import describe_prior
from gridpush_drake.identification.map_ensemble import MapEnsemble
from gridpush_drake.identification.noise import NoiseModel, NoiseScale
from gridpush_drake.identification.posterior import DrawJudge, Posterior
from gridpush_drake.identification.result import Identification
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.pushes.push_log import PushLog

PRIOR_AMPLITUDE = 1.0  # standard deviation of log k before the first poke: a half to twice, or so
MASS_DRAWS = 200  # from the posterior, for the set of plausible masses
CONFIDENCE = (
    0.99  # share of the draws whose every mass distribution the bound holds for, by direction
)
DIRECTIONS = 72  # Half-planes that bound the center of mass; every 5°
PRIOR_SIGMAS = (
    3.0  # standard deviations about a center of mass known beforehand that the set is cut down to
)
SLIDE_SAMPLES = 4  # models besides the estimate that a slide's pushes are tried on


@dataclass(frozen=True, eq=False)
class PlausibleMassSet:
    """Mass distributions held possible, up to a common scale.

    Attributes:
        obj: the object.
        mass_min: (S, n) the least mass of each cell, one row for every draw of the relative
            friction.
        mass_max: (S, n) the greatest.
        confidence: share of the draws that a bound must hold for.
        max_total_mass: greatest mass of the whole, kg, by measured forces; None where nothing says
            it but the object.

    Raises:
        PlanningError: shapes disagree, or the bounds are not positive and ordered.
    """

    obj: GridObject
    mass_min: Array
    mass_max: Array
    confidence: float = 1.0
    max_total_mass: float | None = None

    def __post_init__(self) -> None:
        shape = self.mass_min.shape
        if shape != self.mass_max.shape or len(shape) != 2 or shape[1] != self.obj.n:
            raise PlanningError(
                f"mass set: bounds of shapes {shape} and {self.mass_max.shape}; expected (S, {self.obj.n})"
            )
        if not (
            (self.mass_min > 0) & (self.mass_min <= self.mass_max) & np.isfinite(self.mass_max)
        ).all():
            raise PlanningError("mass set: expected 0 < mass_min <= mass_max")
        if not 0 < self.confidence <= 1:
            raise PlanningError(
                f"confidence is {self.confidence!r}; expected a share, over 0 and up to 1"
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
    ) -> "PlausibleMassSet":
        """All masses that agree with what was learned.

        Args:
            posterior: of its relative friction.
            friction_range: least and greatest friction coefficient of any cell; the object's own
                bounds where None.
            force: what measured forces said, which bound the mass of an object that was not
                weighed.
            judge: of the draws, such as the pushes themselves.

        Raises:
            PlanningError: the range is not positive and increasing.
        """
        low, high = friction_range or (obj.prior.friction_min, obj.prior.friction_max)
        if not 0 < low <= high < np.inf:
            raise PlanningError(
                f"friction_range is {(low, high)!r}; expected 0 < least <= greatest"
            )
        share, _ = posterior.draw(MASS_DRAWS, seed, judge)
        heaviest = None
        if force is not None and obj.prior.total_mass is None:
            heaviest = force.bounds[1] / (GRAVITY * low)
        return cls(obj, share / high, share / low, CONFIDENCE, heaviest)

    @classmethod
    def of_masses(cls, obj: GridObject, params: CellParameters) -> "PlausibleMassSet":
        """One mass distribution, taken as known."""
        mass = params.mass[None]
        return cls(obj, mass, mass)

    def calc_support(self, directions: ArrayLike) -> Array:
        """How far the center of mass can be along unit vectors (D, 2), body frame, at most: h (D,), m."""
        p = self.obj.p_BC
        far = [
            calc_farthest_center(p @ d, self.mass_min, self.mass_max)
            for d in np.asarray(directions, np.float64)
        ]
        return np.array([np.quantile(values, self.confidence, method="higher") for values in far])

    @cached_property
    def center_of_mass_polygon(self) -> Array:
        """(V, 2) corners of a convex polygon that the center of mass is in, body frame, m; counterclockwise.

        A center of mass known beforehand (`obj.prior.center_of_mass`) cuts it down to a square
        about that.
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

    @property
    def middle(self) -> Array:
        """(2,) the mean of that polygon's corners, where the center of mass is taken to be, body frame, m."""
        return self.center_of_mass_polygon.mean(axis=0)


@dataclass(frozen=True, eq=False)
class UncertainModel:
    """A model of an object and how far it may be wrong.

    Attributes:
        obj: the object.
        params: the estimate, which motions are predicted with.
        posterior: of z; None where the parameters are taken for granted.
        noise_scale: of `noise`, as large as the pushes said.
        friction_range: least and greatest friction coefficient of any cell; the object's own bounds
            where None.
        sample_count: further models that slides are tried on.
        seed: of all draws.
        poke_starts: (K, 2) where the finger's center was as the pushes learned from began, body
            frame, m.
        force: what measured forces said; None where there were none.
        evidence: the pushes learned from, which judge the draws; None where they are not at hand.
        noise: of what pushes show, at scale one.
        physics: by which motions are predicted. Slides and pokes are planned slow enough to end at
            rest, so that it is always quasi-static, whatever pushes were learned from.
    """

    obj: GridObject
    params: CellParameters
    posterior: Posterior | None = None
    noise_scale: NoiseScale = field(default_factory=NoiseScale)
    friction_range: tuple[float, float] | None = None
    sample_count: int = 0
    seed: int = 0
    poke_starts: Array = field(default_factory=lambda: np.empty((0, 2)))
    force: ForceScale | None = None
    evidence: PushEvidence | None = None
    noise: NoiseModel = field(default_factory=NoiseModel)
    physics: Physics = QUASI_STATIC

    @classmethod
    def of_identification(
        cls,
        found: Identification,
        *,
        friction_range: tuple[float, float] | None = None,
        sample_count: int = SLIDE_SAMPLES,
        seed: int = 0,
        log: PushLog | None = None,
    ) -> "UncertainModel":
        """Takes what pushes said, with the noise they showed; those of `log` judge the draws, and are not repeated."""
        evidence = PushEvidence.of_log(found, log)
        starts = [transform_back(seen.pose, seen.push.start[None])[0] for seen in log or ()]
        return cls(
            obj=found.obj,
            params=found.params,
            posterior=found.posterior,
            noise_scale=found.noise_scale,
            friction_range=friction_range,
            sample_count=sample_count,
            seed=seed,
            poke_starts=np.array(starts).reshape(-1, 2),
            force=found.force,
            evidence=evidence,
            noise=found.noise,
            physics=found.physics.with_regime("quasi_static"),
        )

    @classmethod
    def of_prior(
        cls, obj: GridObject, *, friction_range: tuple[float, float] | None = None
    ) -> "UncertainModel":
        """Takes what is held before any push: the smoothness prior about uniform friction."""
        prior = describe_prior(obj, MapEnsemble(hypotheses=(SmoothField(PRIOR_AMPLITUDE),)))
        return cls.of_identification(prior, friction_range=friction_range, sample_count=0)

    @classmethod
    def of_parameters(cls, obj: GridObject, params: CellParameters) -> "UncertainModel":
        """Takes parameters for granted."""
        return cls(obj, params)

    @cached_property
    def masses(self) -> PlausibleMassSet:
        """The masses that stability is judged on. Raises PlanningError: the friction range is not increasing."""
        if self.posterior is None:
            return PlausibleMassSet.of_masses(self.obj, self.params)
        with threadpool_limits(limits=1, user_api="blas"):
            return PlausibleMassSet.from_posterior(
                self.obj,
                self.posterior,
                self.friction_range,
                seed=self.seed,
                force=self.force,
                judge=self.evidence,
            )

    @cached_property
    def samples(self) -> tuple[CellParameters, ...]:
        """Further models that agree with the pushes, which slides are tried on."""
        if self.posterior is None:
            return ()
        return tuple(
            self.posterior.draw_parameters(self.params, self.sample_count, self.seed, self.evidence)
        )

    def require_posterior(self) -> Posterior:
        """The posterior, which a poke can narrow. Raises PlanningError: the parameters are taken for granted."""
        if self.posterior is None:
            raise PlanningError(
                "model: parameters taken for granted; expected a posterior that pokes can narrow"
            )
        return self.posterior
