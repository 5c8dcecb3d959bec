"""What is believed of the objects of a scene: the best model, and others that may be the true one.

Before anything was learned, the best model has even objects, and the others are heavier towards one
side each,

    k_i ~ exp(a u.(p_i - c) / r),

with the direction u and the tilt a drawn for every object (c the cells' centroid, r the farthest
cell's distance from it), and a factor on each object's load and on every friction coefficient.
After objects were learned together they are draws from its posterior. The theory is in
`docs/theory/planning.md`, section 6.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from gridpush_drake.dynamics.bodies import DEFAULT_PAIR_FRICTION, Bodies
from gridpush_drake.dynamics.physics import Physics
from gridpush_drake.identification.learning import describe_prior
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.multi_object.joint_result import JointIdentification
from gridpush_drake.identification.result import Identification
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.goal.next_push import RobustnessOptions, draw_model_samples
from gridpush_drake.planning.pregrasp.uncertainty import UncertainModel

DEFAULT_DRAW_COUNT = 4
"""Number of further models by default."""

LOAD_STD = 0.5
"""Standard deviation of the logarithm of an object's whole load before anything was learned."""

FRICTION_STD = 0.3
"""Standard deviation of the logarithm of a contact's friction before anything was learned."""


@dataclass(frozen=True, eq=False)
class SceneBelief:
    """What is believed of some objects.

    Attributes:
        bodies: the best model.
        draws: further models.
        identification: that they come from; None where nothing was learned.
        models: what is known of single objects by their numbers, learned from pushes in which
            nothing else moved; their stability at the table's edge is judged by them.
        learned_alone: the identifications that these models were made of.
    """

    bodies: Bodies
    draws: tuple[Bodies, ...] = ()
    identification: JointIdentification | None = None
    models: Mapping[int, UncertainModel] = field(default_factory=dict)
    learned_alone: Mapping[int, Identification] = field(default_factory=dict)

    @property
    def objects(self) -> tuple[GridObject, ...]:
        """The objects."""
        return self.bodies.objects

    @cached_property
    def identifications(self) -> tuple[Identification, ...]:
        """(N,) what was learned of each object: alone if it was, else together with the others.

        Of an object of which nothing was learned it is the prior, without `push_names`.
        """
        if self.identification is None:
            together = tuple(describe_prior(obj) for obj in self.objects)
        else:
            together = self.identification.parts
        return tuple(self.learned_alone.get(b, found) for b, found in enumerate(together))

    def forget(self, bodies: Collection[int]) -> "SceneBelief":
        """Drops what was learned of some objects alone, by their numbers."""
        if not bodies:
            return self
        return replace(
            self,
            models={b: model for b, model in self.models.items() if b not in bodies},
            learned_alone={b: one for b, one in self.learned_alone.items() if b not in bodies},
        )

    @classmethod
    def of_truth(cls, bodies: Bodies) -> "SceneBelief":
        """Takes the objects' masses and frictions for known."""
        return cls(bodies)

    @classmethod
    def of_prior(
        cls,
        objects: Sequence[GridObject],
        *,
        pair_friction: float = DEFAULT_PAIR_FRICTION,
        draws: int = DEFAULT_DRAW_COUNT,
        seed: int = 0,
        physics: Physics | None = None,
    ) -> "SceneBelief":
        """Makes what is believed before any push.

        Args:
            objects: the N objects.
            pair_friction: friction that two objects are expected to have against each other.
            draws: number of further models.
            seed: seed of the draws.
            physics: how the objects slide; `Physics()` by default.
        """
        # Where there are several, loads do not shift, however high the objects are pushed.
        objects = [lay_flat(obj) for obj in objects]
        even = [CellParameters.uniform(obj) for obj in objects]
        rng = np.random.default_rng(seed)
        tilted = [
            draw_model_samples(Model(obj, params), None, RobustnessOptions())
            for obj, params in zip(objects, even, strict=True)
        ]
        models = []
        for _ in range(draws):
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
            models.append(Bodies(objects, drawn, physics, friction))
        return cls(Bodies(objects, even, physics, pair_friction), tuple(models))

    @classmethod
    def of_identification(
        cls, found: JointIdentification, *, draws: int = DEFAULT_DRAW_COUNT, seed: int = 0
    ) -> "SceneBelief":
        """Makes what is believed after pushes were learned from.

        Args:
            found: what was learned.
            draws: number of further models, from its posterior.
            seed: seed of the draws.
        """
        return cls(found, tuple(found.draws(draws, seed)), found)


def lay_flat(obj: GridObject) -> GridObject:
    """Returns an object of which is not known how high it is pushed: so no loads shift."""
    if obj.prior.push_height is None:
        return obj
    return replace(obj, prior=replace(obj.prior, push_height=None))
