"""What is known of an object, as pre-grasp decisions take it: Identification -> UncertainModel.

Where the center of mass may be: poses under slow pushes show only the relative support friction
k_i = mu_i m_i of each cell (`identification.identifiability`). With friction coefficients between
mu_min and mu_max it agrees with every mass distribution m for which

    k_i / mu_max <= t m_i <= k_i / mu_min   with some t > 0

The farthest that the center of mass of such a distribution can be in a direction d is

    h(d) = max over m of sum m_i d.p_i / sum m_i         (`calc_farthest_center`)

k itself is known up to the posterior's spread. So h is calculated for many draws of k from it that
agree with the pushes, and the value is kept that all but a small fraction of the draws stay below.
The half-planes d.c <= h(d) over many d bound the center of mass c by a polygon, from outside.

`PlausibleMassSet` is these mass distributions and that polygon. `UncertainModel` is the estimate,
by which motions are predicted, with all that says how far it may be wrong. The theory is in
`docs/theory/planning.md`, section 3.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import shapely
from numpy.typing import ArrayLike
from threadpoolctl import threadpool_limits

from gridpush_drake.dynamics.physics import GRAVITY, QUASI_STATIC, Physics
from gridpush_drake.errors import PlanningError
from gridpush_drake.geometry.polygons import bound_by_half_planes
from gridpush_drake.geometry.se2 import Array, make_direction, transform_back
from gridpush_drake.identification.absolute.estimate import LOG_MASS, AbsoluteEstimate
from gridpush_drake.identification.absolute.force_scale import ForceScale
from gridpush_drake.identification.fit.evidence import PushEvidence, select_learned
from gridpush_drake.identification.fit.hypotheses import SmoothField
from gridpush_drake.identification.fit.map_ensemble import MapEnsemble
from gridpush_drake.identification.identifiability import calc_farthest_center
from gridpush_drake.identification.learning import describe_prior
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.result import Identification
from gridpush_drake.identification.statistics.friction_gradient import (
    calc_gradient_std,
    draw_gradients,
)
from gridpush_drake.identification.statistics.noise import NoiseModel, NoiseScale
from gridpush_drake.identification.statistics.posterior import DrawJudge, Posterior
from gridpush_drake.identification.tilt_tests.weighed_model import believe_before
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.model_rollouts import WEIGHED_DRAWS
from gridpush_drake.planning.weighing.region import cut_to_ellipse
from gridpush_drake.pushes.push_log import PushLog

PRIOR_AMPLITUDE = 1.0
"""Standard deviation of log k before the first poke: friction may well differ by a factor of 2 or 3
from cell to cell."""

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
    def of_masses(cls, model: Model) -> "PlausibleMassSet":
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


@dataclass(frozen=True, eq=False)
class UncertainModel:
    """A model of an object and how far it may be wrong.

    Attributes:
        obj: the object.
        params: the estimate, by which motions are predicted.
        posterior: of z = (log k, log mu_c); None where the parameters are taken for granted.
        noise_scale: by how much larger than `noise` the pushes were found to scatter.
        friction_range: least and greatest friction coefficient of any cell; the object's own bounds
            where None.
        sample_count: number of further models that slides are tried on.
        seed: of all draws.
        poke_starts: (K, 2) where the finger's center was as the pushes learned from began, body
            frame, m.
        force: what measured forces said; None where there were none.
        evidence: the pushes learned from, which judge the draws; None where they are not at hand.
        noise: of what pushes show, before `noise_scale`.
        belief: what is held of mass and center of mass; None where the parameters are taken for
            granted. Weighings that contradict each other are not in it.
        found: what was learned, with which learning from a further push begins; None where the
            parameters are taken for granted.
        log: the pushes learned from; empty where they are not at hand.
        presses: number of presses at the table's edge so far, whether they agree or not.
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
    belief: AbsoluteEstimate | None = None
    found: Identification | None = None
    log: PushLog = field(default_factory=lambda: PushLog(()))
    presses: int = 0
    physics: Physics = QUASI_STATIC

    @classmethod
    def of_identification(
        cls,
        found: Identification,
        *,
        friction_range: tuple[float, float] | None = None,
        sample_count: int = WEIGHED_DRAWS,
        seed: int = 0,
        log: PushLog | None = None,
    ) -> "UncertainModel":
        """Makes the model of what was learned from pushes.

        Args:
            found: what was learned.
            friction_range: least and greatest friction coefficient of any cell; the object's own
                bounds where None.
            sample_count: number of further models that slides are weighed with.
            seed: of all draws.
            log: the pushes learned from, if they are at hand. They judge the draws, and pokes keep
                away from where they began.
        """
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
            belief=found.weighed or believe_before(found),
            found=found,
            log=PushLog(()) if log is None else select_learned(found, log),
            presses=0 if found.absolute is None else found.absolute.presses,
            physics=found.physics.with_regime("quasi_static"),
        )

    @classmethod
    def of_prior(
        cls, obj: GridObject, *, friction_range: tuple[float, float] | None = None
    ) -> "UncertainModel":
        """Makes the model before any push: the smoothness prior about uniform friction."""
        prior = describe_prior(obj, MapEnsemble(hypotheses=(SmoothField(PRIOR_AMPLITUDE),)))
        return cls.of_identification(prior, friction_range=friction_range, sample_count=0)

    @classmethod
    def of_parameters(cls, model: Model) -> "UncertainModel":
        """Makes a model whose parameters are taken for granted."""
        return cls(model.obj, model.params)

    def inflate(self, factor: float) -> "UncertainModel":
        """The model with all that was learned less sure, as after a push that surprised.

        Args:
            factor: on the standard deviations of what pushes, their forces and weighings said, 1 or
                more.
        """
        if self.posterior is None:
            return self
        force = self.force
        if force is not None:
            force = replace(force, relative_std=factor * force.relative_std)
        belief = self.belief
        if belief is not None:
            belief = replace(belief, covariance=factor**2 * belief.covariance)
        gradient = min(factor * self.noise.friction_gradient, calc_gradient_std(self.obj.prior))
        return replace(
            self,
            noise=replace(self.noise, friction_gradient=gradient),
            posterior=self.posterior.widen(factor),
            force=force,
            evidence=None if self.evidence is None else self.evidence.relax(factor),
            belief=belief,
        )

    @property
    def weighed(self) -> AbsoluteEstimate | None:
        """What weighings said; None where there are none."""
        belief = self.belief
        return belief if belief is not None and belief.presses + belief.lifts else None

    @cached_property
    def masses(self) -> PlausibleMassSet:
        """The masses that stability is judged on.

        Raises:
            PlanningError: the friction range is not increasing.
        """
        if self.posterior is None:
            return PlausibleMassSet.of_masses(Model(self.obj, self.params))
        with threadpool_limits(limits=1, user_api="blas"):
            return PlausibleMassSet.from_posterior(
                self.obj,
                self.posterior,
                self.friction_range,
                seed=self.seed,
                force=self.force,
                judge=self.evidence,
                weighed=self.weighed,
            )

    @cached_property
    def samples(self) -> tuple[CellParameters, ...]:
        """Further models that agree with the pushes, which slides are tried on."""
        if self.posterior is None:
            return ()
        draws = self.posterior.draw_parameters(
            self.params, self.sample_count, self.seed, self.evidence
        )
        # Over the edge it matters where the center of mass is, and not only that of friction.
        return tuple(draw_gradients(self.obj, draws, self.noise.friction_gradient, self.seed))

    def require_posterior(self) -> Posterior:
        """The posterior, which a poke can narrow.

        Raises:
            PlanningError: there is none, for the parameters are taken for granted.
        """
        if self.posterior is None:
            raise PlanningError(
                "model: parameters taken for granted; expected a posterior that pokes can narrow"
            )
        return self.posterior
