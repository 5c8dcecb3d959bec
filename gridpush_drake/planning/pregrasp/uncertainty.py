"""What is known of an object's cells, in the form that exploration takes: a normal z and what a push shows of it.

What is believed of an object, in the forms that pre-grasp decisions take.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from gridpush_drake.identification.learning import MIN_CONTACT_FRICTION
from gridpush_drake.identification.map_ensemble import MapEnsembleOptions, calc_prior_factor
from gridpush_drake.identification.map_fit import NoiseModel, calc_smooth_covariance
from gridpush_drake.identification.posterior import Posterior, draw_consistent
from gridpush_drake.identification.result import Identification
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.pregrasp.stability import MIN_SHARE, PlausibleMassSet
from gridpush_drake.pushes.push_log import PushLog

Array = NDArray[np.float64]

PRIOR_AMPLITUDE = 1.0
"""Standard deviation of log k before the first poke: a half to twice, or so."""


@dataclass(frozen=True, eq=False)
class LinearizedPosterior:
    """What is known of an object's cells.

    Attributes:
        obj: the object.
        posterior: of z.
        noise: of what is seen of a push.
        scale: of the noise.
        made: (K, 2) where the finger's center was as the pushes learned from began, body frame, m.
    """

    obj: GridObject
    posterior: Posterior
    noise: NoiseModel = field(default_factory=NoiseModel)
    scale: float = 1.0
    made: Array = field(default_factory=lambda: np.empty((0, 2)))

    @classmethod
    def of_prior(cls, obj: GridObject, amplitude: float = PRIOR_AMPLITUDE) -> "LinearizedPosterior":
        """Before any push: the smoothness prior about uniform friction.

        Args:
            obj: the object.
            amplitude: standard deviation of log k.
        """
        options = MapEnsembleOptions()
        mu_c = max(obj.prior.contact_friction, MIN_CONTACT_FRICTION)
        C = calc_smooth_covariance(obj, options.range_cells)
        A = calc_prior_factor(C, amplitude, obj.prior.contact_friction_std / mu_c)
        start = CellParameters.uniform(obj)
        z = np.append(np.log(start.mass * start.friction), np.log(mu_c))
        return cls(obj, Posterior(z, A @ A.T, A @ A.T), options.noise)

    @classmethod
    def of_identification(
        cls, found: Identification, log: PushLog | None = None, noise: NoiseModel | None = None
    ) -> "LinearizedPosterior":
        """After pushes; the noise is as large as they said.

        Args:
            found: the model with its posterior.
            log: the pushes, so that they are not repeated.
            noise: that it was learned with.
        """
        noise = noise or NoiseModel()
        made = [turn_back(seen.push.start - seen.pose[:2], seen.pose[2]) for seen in log or ()]
        return cls(found.obj, found.posterior, noise, found.noise_std / noise.pose, np.array(made).reshape(-1, 2))

    @property
    def params(self) -> CellParameters:
        """The cells' parameters at the mean, every friction that of the prior."""
        z, mu = self.posterior.mean, self.obj.prior.friction
        return CellParameters(np.exp(z[:-1]) / mu, np.full(self.obj.n, mu), float(np.exp(z[-1])))


def turn_back(vector: Array, angle: float) -> Array:
    """A vector (2,) in W as a body at the angle (rad) sees it."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([c * vector[0] + s * vector[1], -s * vector[0] + c * vector[1]])


DRAWS = 4
"""Models besides the mean that a slide's pushes are tried on."""


@dataclass(frozen=True, eq=False)
class Belief:
    """What is believed of the object, in the forms that the decisions take.

    Attributes:
        params: the model that motions are predicted with.
        masses: the set that stability is judged on.
        draws: further models that slides are tried on.
        knowledge: that pokes are chosen by; None where nothing is left to learn.
    """

    params: CellParameters
    masses: PlausibleMassSet
    draws: tuple[CellParameters, ...] = ()
    knowledge: LinearizedPosterior | None = None

    @classmethod
    @threadpool_limits.wrap(limits=1, user_api="blas")
    def of_identification(
        cls,
        found: Identification,
        friction_range: tuple[float, float] | None = None,
        *,
        draws: int = DRAWS,
        seed: int = 0,
        log: PushLog | None = None,
    ) -> "Belief":
        """What pushes said.

        Args:
            found: the model with its posterior.
            friction_range: least and greatest friction coefficient of any cell; the object's own bounds where None.
            draws: further models to try slides on.
            seed: of all draws.
            log: the pushes, so that pokes are not repeated.

        Returns:
            The belief.

        Raises:
            PlanningError: the range is not positive and increasing.
        """
        return cls(
            found.params,
            PlausibleMassSet.from_posterior(found.obj, found.posterior, friction_range, seed=seed),
            _draw_models(found, draws, seed),
            LinearizedPosterior.of_identification(found, log),
        )

    @classmethod
    def of_prior(cls, obj: GridObject, friction_range: tuple[float, float] | None = None, *, seed: int = 0) -> "Belief":
        """What is believed before any push."""
        knowledge = LinearizedPosterior.of_prior(obj)
        masses = PlausibleMassSet.from_posterior(obj, knowledge.posterior, friction_range, seed=seed)
        return cls(knowledge.params, masses, (), knowledge)

    @classmethod
    def of_parameters(cls, obj: GridObject, params: CellParameters) -> "Belief":
        """Parameters taken for granted, without doubt."""
        return cls(params, PlausibleMassSet.of_masses(obj, params))


def _draw_models(found: Identification, count: int, seed: int) -> tuple[CellParameters, ...]:
    """Models that agree with the pushes; every cell's friction is the found one, its mass varies."""
    if not count:
        return ()
    shares, contact_frictions = draw_consistent(found.posterior, count, seed)
    friction = found.params.friction
    total = float(found.params.mass @ friction)
    return tuple(
        CellParameters(total * np.maximum(share, MIN_SHARE) / friction, friction, float(mu_c))
        for share, mu_c in zip(shares, contact_frictions, strict=True)
    )
