"""`Belief`: what is believed of one object, or of several, and how far it may be wrong.

It is the estimate, by which motions are predicted, and other models that may be the true one, by
which decisions are tried. Learning gives both: the other models are draws from its posterior. Of
one object a belief says, too, which masses it may have.

Before anything was learned of several objects, the estimate has even ones, and in the other models
each is heavier towards one side,

    k_i ~ exp(a u.(p_i - c) / r),

with the direction u and the tilt a drawn for every object (c the cells' centroid, r the farthest
cell's distance from it), and a factor on each object's load and on every friction coefficient.
The theory is in `docs/theory/planning.md`, sections 2, 3 and 6.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from threadpoolctl import threadpool_limits

from gridpush_drake.dynamics.bodies import DEFAULT_PAIR_FRICTION, Bodies
from gridpush_drake.dynamics.physics import Physics
from gridpush_drake.errors import PlanningError
from gridpush_drake.geometry.se2 import Array, make_direction, transform_back
from gridpush_drake.identification.absolute.estimate import AbsoluteEstimate
from gridpush_drake.identification.absolute.force_scale import ForceScale
from gridpush_drake.identification.fit.evidence import PushEvidence, select_learned
from gridpush_drake.identification.fit.hypotheses import SmoothField
from gridpush_drake.identification.fit.map_ensemble import MapEnsemble
from gridpush_drake.identification.learning import describe_prior
from gridpush_drake.identification.multi_object.joint_result import JointIdentification
from gridpush_drake.identification.result import Identification
from gridpush_drake.identification.statistics.friction_gradient import (
    calc_gradient_std,
    draw_gradients,
)
from gridpush_drake.identification.statistics.noise import NoiseModel, NoiseScale
from gridpush_drake.identification.statistics.posterior import Posterior
from gridpush_drake.identification.tilt_tests.weighed_model import believe_before
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.model_rollouts import WEIGHED_DRAWS
from gridpush_drake.planning.plausible_masses import PlausibleMassSet
from gridpush_drake.pushes.push_log import PushLog

SEVERAL_DRAWS = 4
"""Number of further models of several objects by default: each costs a simulation of them all."""

PRIOR_AMPLITUDE = 1.0
"""Standard deviation of log k before the first poke: friction may well differ by a factor of 2 or 3
from cell to cell."""

PRIOR_TILTS = (1.0, 2.0)
"""Tilts a above that an object of which nothing is known is tried with by default."""

PRIOR_SIDES = 4
"""Number of directions u for each tilt by default."""

LOAD_STD = 0.5
"""Standard deviation of the logarithm of an object's whole load before anything was learned."""

FRICTION_STD = 0.3
"""Standard deviation of the logarithm of a contact's friction before anything was learned."""


@dataclass(frozen=True, eq=False)
class Belief:
    """What is believed of one object, or of several.

    Attributes:
        bodies: the estimate, by which motions are predicted. Slides and pokes are planned slow
            enough to end at rest, so that it is quasi-static, whatever pushes were learned from.
        identification: what was learned, with which learning from a further push begins; without
            `push_names` where it is the prior of one object. None where nothing was learned of
            several, or the parameters are taken for granted.
        sample_count: number of further models that are drawn.
        seed: of all draws.
        prior_samples: the further models, where nothing was learned of several objects.
        alone: of several objects, what is believed of single ones by their numbers, learned from
            pushes in which nothing else moved; stability at the table's edge is judged by it.
        posterior: of one object's z = (log k, log mu_c); None where the parameters are taken for
            granted. This and the following are of one object; those of several are in `alone`.
        noise_scale: by how much larger than `noise` the pushes were found to scatter.
        friction_range: least and greatest friction coefficient of any cell; the object's own bounds
            where None.
        poke_starts: (K, 2) where the finger's center was as the pushes learned from began, body
            frame, m.
        force: what measured forces said; None where there were none.
        evidence: the pushes learned from, which judge the draws; None where they are not at hand.
        noise: of what pushes show, before `noise_scale`.
        absolute: what is held of mass and center of mass; None where the parameters are taken for
            granted. Weighings that contradict each other are not in it.
        log: the pushes learned from; empty where they are not at hand.
        presses: number of presses at the table's edge so far, whether they agree or not.
    """

    bodies: Bodies
    identification: Identification | JointIdentification | None = None
    sample_count: int = 0
    seed: int = 0
    prior_samples: tuple[Bodies, ...] = ()
    alone: Mapping[int, "Belief"] = field(default_factory=dict)
    posterior: Posterior | None = None
    noise_scale: NoiseScale = field(default_factory=NoiseScale)
    friction_range: tuple[float, float] | None = None
    poke_starts: Array = field(default_factory=lambda: np.empty((0, 2)))
    force: ForceScale | None = None
    evidence: PushEvidence | None = None
    noise: NoiseModel = field(default_factory=NoiseModel)
    absolute: AbsoluteEstimate | None = None
    log: PushLog = field(default_factory=lambda: PushLog(()))
    presses: int = 0

    @classmethod
    def of_identification(
        cls,
        found: Identification | JointIdentification,
        *,
        friction_range: tuple[float, float] | None = None,
        sample_count: int | None = None,
        seed: int = 0,
        log: PushLog | None = None,
    ) -> "Belief":
        """Makes what is believed after pushes were learned from.

        Args:
            found: what was learned.
            friction_range: of one object, least and greatest friction coefficient of any cell; the
                object's own bounds where None.
            sample_count: number of further models; `WEIGHED_DRAWS` of one object by default, and
                `SEVERAL_DRAWS` of several.
            seed: of all draws.
            log: of one object, the pushes learned from, if they are at hand. They judge the draws,
                and pokes keep away from where they began.
        """
        if isinstance(found, JointIdentification):
            count = SEVERAL_DRAWS if sample_count is None else sample_count
            return cls(found, found, sample_count=count, seed=seed)
        starts = [transform_back(seen.pose, seen.push.start[None])[0] for seen in log or ()]
        return cls(
            bodies=_slow_down(Bodies(found.obj, found.params, found.physics)),
            identification=found,
            sample_count=WEIGHED_DRAWS if sample_count is None else sample_count,
            seed=seed,
            posterior=found.posterior,
            noise_scale=found.noise_scale,
            friction_range=friction_range,
            poke_starts=np.array(starts).reshape(-1, 2),
            force=found.force,
            evidence=PushEvidence.of_log(found, log),
            noise=found.noise,
            absolute=found.weighed or believe_before(found),
            log=PushLog(()) if log is None else select_learned(found, log),
            presses=0 if found.absolute is None else found.absolute.presses,
        )

    @classmethod
    def of_prior(
        cls, obj: GridObject, *, friction_range: tuple[float, float] | None = None
    ) -> "Belief":
        """Makes what is believed of one object before any push.

        It is the smoothness prior about uniform friction.
        """
        prior = describe_prior(obj, MapEnsemble(hypotheses=(SmoothField(PRIOR_AMPLITUDE),)))
        return cls.of_identification(prior, friction_range=friction_range, sample_count=0)

    @classmethod
    def of_even_objects(
        cls,
        objects: Sequence[GridObject],
        *,
        pair_friction: float = DEFAULT_PAIR_FRICTION,
        sample_count: int = SEVERAL_DRAWS,
        seed: int = 0,
        physics: Physics | None = None,
    ) -> "Belief":
        """Makes what is believed of several objects before any push: even ones, or tilted.

        Args:
            objects: the N objects.
            pair_friction: friction that two objects are expected to have against each other.
            sample_count: number of further models.
            seed: seed of the draws.
            physics: how the objects slide; `Physics()` by default.
        """
        # Where there are several, loads do not shift, however high the objects are pushed.
        objects = [lay_flat(obj) for obj in objects]
        tilted = [tilt_loads(Bodies(obj)) for obj in objects]
        rng = np.random.default_rng(seed)
        samples = []
        for _ in range(sample_count):
            drawn = []
            for options in tilted:
                one = options[int(rng.integers(len(options)))]
                heavier = float(np.exp(LOAD_STD * rng.standard_normal()))
                rougher = float(np.exp(FRICTION_STD * rng.standard_normal()))
                drawn.append(
                    replace(
                        one,
                        mass=one.mass * heavier,
                        contact_friction=one.contact_friction * rougher,
                    )
                )
            friction = pair_friction * float(np.exp(FRICTION_STD * rng.standard_normal()))
            samples.append(Bodies(objects, drawn, physics, friction))
        even = Bodies(objects, None, physics, pair_friction)
        return cls(even, sample_count=sample_count, seed=seed, prior_samples=tuple(samples))

    @classmethod
    def of_parameters(cls, bodies: Bodies) -> "Belief":
        """Takes the objects' masses and frictions for granted."""
        return cls(_slow_down(bodies))

    @property
    def objects(self) -> tuple[GridObject, ...]:
        """The objects."""
        return self.bodies.objects

    @property
    def obj(self) -> GridObject:
        """The object. Raises SimulationError where there are several."""
        return self.bodies.obj

    @property
    def params(self) -> CellParameters:
        """The estimate of its masses and frictions. Raises SimulationError likewise."""
        return self.bodies.params

    @property
    def physics(self) -> Physics:
        """The physics by which motions are predicted."""
        return self.bodies.physics

    @cached_property
    def identifications(self) -> tuple[Identification, ...]:
        """(N,) what was learned of each object: alone if it was, else together with the others.

        Of an object of which nothing was learned it is the prior, without `push_names`.
        """
        known = self.identification
        together = [describe_prior(obj) for obj in self.objects] if known is None else known.parts
        found = []
        for b, part in enumerate(together):
            one = self.alone[b].identification if b in self.alone else None
            found.append(one if isinstance(one, Identification) else part)
        return tuple(found)

    @cached_property
    def samples(self) -> tuple[Bodies, ...]:
        """Further models that may be true, by which decisions are tried beside the estimate."""
        if isinstance(self.identification, JointIdentification):
            return tuple(self.identification.draws(self.sample_count, self.seed))
        if self.posterior is None:
            return self.prior_samples
        draws = self.posterior.draw_parameters(
            self.params, self.sample_count, self.seed, self.evidence
        )
        # Over the edge it matters where the center of mass is, and not only that of friction.
        varied = draw_gradients(self.obj, draws, self.noise.friction_gradient, self.seed)
        return tuple(self.bodies.with_params(params) for params in varied)

    @cached_property
    def masses(self) -> PlausibleMassSet:
        """The masses of one object that stability is judged on.

        Raises:
            PlanningError: the friction range is not increasing.
            SimulationError: there are several objects.
        """
        if self.posterior is None:
            return PlausibleMassSet.of_masses(self.bodies)
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

    @property
    def weighed(self) -> AbsoluteEstimate | None:
        """What weighings of one object said; None where there are none."""
        held = self.absolute
        return held if held is not None and held.presses + held.lifts else None

    def require_posterior(self) -> Posterior:
        """The posterior of one object, which a poke can narrow.

        Raises:
            PlanningError: there is none, for the parameters are taken for granted, or there are
                several objects.
        """
        if self.posterior is None:
            raise PlanningError(
                "belief: parameters taken for granted, or several objects; expected one object "
                "with a posterior that pokes can narrow"
            )
        return self.posterior

    def inflate(self, factor: float) -> "Belief":
        """The belief with all that was learned of one object less sure, as after a surprise.

        Args:
            factor: on the standard deviations of what pushes, their forces and weighings said, 1 or
                more.
        """
        if self.posterior is None:
            return self
        force = self.force
        if force is not None:
            force = replace(force, relative_std=factor * force.relative_std)
        absolute = self.absolute
        if absolute is not None:
            absolute = replace(absolute, covariance=factor**2 * absolute.covariance)
        gradient = min(factor * self.noise.friction_gradient, calc_gradient_std(self.obj.prior))
        return replace(
            self,
            noise=replace(self.noise, friction_gradient=gradient),
            posterior=self.posterior.widen(factor),
            force=force,
            evidence=None if self.evidence is None else self.evidence.relax(factor),
            absolute=absolute,
        )

    def forget(self, bodies: Collection[int]) -> "Belief":
        """Drops what was learned of some objects alone, by their numbers."""
        kept = {b: one for b, one in self.alone.items() if b not in bodies}
        return replace(self, alone=kept) if bodies else self


def tilt_loads(
    model: Bodies, tilts: Sequence[float] = PRIOR_TILTS, sides: int = PRIOR_SIDES
) -> list[CellParameters]:
    """Makes an object's parameters heavier towards one side.

    Args:
        model: one object, with the parameters that are changed.
        tilts: a of the equation above.
        sides: number of directions u for each tilt. The first is along the object's longest axis,
            where unevenness matters most.
    """
    obj = model.obj
    params = model.params
    # (p_i - c) and r of the equation
    lever_arm = obj.p_BC - obj.p_BC.mean(axis=0)
    r = max(float(np.linalg.norm(lever_arm, axis=1).max()), obj.cell_size)
    axis = np.linalg.eigh(lever_arm.T @ lever_arm)[1][:, -1]
    angles = np.arctan2(axis[1], axis[0]) + 2 * np.pi * np.arange(sides) / sides
    slopes = make_direction(angles) @ lever_arm.T / r
    return [
        replace(params, mass=params.mass * np.exp(tilt * slope))
        for tilt in tilts
        for slope in slopes
    ]


def lay_flat(obj: GridObject) -> GridObject:
    """Returns an object of which is not known how high it is pushed: so no loads shift."""
    if obj.prior.push_height is None:
        return obj
    return replace(obj, prior=replace(obj.prior, push_height=None))


def _slow_down(bodies: Bodies) -> Bodies:
    """The bodies as slow pushes move them."""
    return bodies.with_physics(bodies.physics.with_regime("quasi_static"))
