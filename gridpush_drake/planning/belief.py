"""What is believed of an object, in the forms that pre-grasp decisions take."""

from dataclasses import dataclass

import numpy as np
from threadpoolctl import threadpool_limits

from gridpush_drake.grid.object import GridObject
from gridpush_drake.grid.parameters import CellParameters
from gridpush_drake.identification.result import Identification
from gridpush_drake.planning.consistent_draws import draw_consistent
from gridpush_drake.planning.knowledge import Knowledge
from gridpush_drake.planning.stability import LEAST_SHARE, MassSet
from gridpush_drake.pushes.log import PushLog

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
    masses: MassSet
    draws: tuple[CellParameters, ...] = ()
    knowledge: Knowledge | None = None

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
            MassSet.from_posterior(found.obj, found.posterior, friction_range, seed=seed),
            _draw_models(found, draws, seed),
            Knowledge.of_identification(found, log),
        )

    @classmethod
    def of_prior(cls, obj: GridObject, friction_range: tuple[float, float] | None = None, *, seed: int = 0) -> "Belief":
        """What is believed before any push."""
        knowledge = Knowledge.of_prior(obj)
        masses = MassSet.from_posterior(obj, knowledge.posterior, friction_range, seed=seed)
        return cls(knowledge.params, masses, (), knowledge)

    @classmethod
    def of_parameters(cls, obj: GridObject, params: CellParameters) -> "Belief":
        """Parameters taken for granted, without doubt."""
        return cls(params, MassSet.of_masses(obj, params))


def _draw_models(found: Identification, count: int, seed: int) -> tuple[CellParameters, ...]:
    """Models that agree with the pushes; every cell's friction is the found one, its mass varies."""
    if not count:
        return ()
    shares, contact_frictions = draw_consistent(found.posterior, count, seed)
    friction = found.params.friction
    total = float(found.params.mass @ friction)
    return tuple(
        CellParameters(total * np.maximum(share, LEAST_SHARE) / friction, friction, float(mu_c))
        for share, mu_c in zip(shares, contact_frictions, strict=True)
    )
