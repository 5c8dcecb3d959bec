"""What is believed of the objects of a scene: the best model, and others that may be the true one.

Before anything was learned, the best model has even objects, and the others are heavier towards one
side each,

    k_i ~ exp(a u.(p_i - c) / r),

with the direction u and the tilt a drawn for every object (c the cells' centroid, r the farthest
cell's distance from it), and a factor on each object's load and on every friction coefficient.
After `identify_scene` they are draws from its posterior. The theory is in
`docs/theory/planning.md`, section 6.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from gridpush_drake.dynamics.scene.bodies import DEFAULT_PAIR_FRICTION, Scene, SceneBody
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.learning import describe_prior
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.result import Identification
from gridpush_drake.identification.scene_learning import SceneIdentification
from gridpush_drake.identification.scene_models import make_object_models
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.goal.next_push import RobustnessOptions, draw_model_samples
from gridpush_drake.planning.pregrasp.uncertainty import UncertainModel

DRAWS = 4
"""Number of further models by default."""

LOAD_STD = 0.5
"""Standard deviation of the logarithm of an object's whole load before anything was learned."""

FRICTION_STD = 0.3
"""Standard deviation of the logarithm of a contact's friction before anything was learned."""

MAX_LOG_FRICTION = 1.0
"""Farthest that the logarithm of a drawn contact friction is from the best model's."""


@dataclass(frozen=True, eq=False)
class SceneBelief:
    """What is believed of some objects.

    Attributes:
        scene: the best model; where its objects lie does not matter.
        draws: further models.
        identification: that they come from; None where nothing was learned.
        models: what is known of single objects by their numbers, learned from pushes in which
            nothing else moved; their stability at the table's edge is judged by them.
        learned_alone: the identifications that these models were made of.
    """

    scene: Scene
    draws: tuple[Scene, ...] = ()
    identification: SceneIdentification | None = None
    models: Mapping[int, UncertainModel] = field(default_factory=dict)
    learned_alone: Mapping[int, Identification] = field(default_factory=dict)

    @property
    def objects(self) -> tuple[GridObject, ...]:
        """The objects."""
        return self.scene.objects

    @cached_property
    def identifications(self) -> tuple[Identification, ...]:
        """(N,) what was learned of each object: alone if it was, else together with the others.

        Of an object of which nothing was learned it is the prior, without `push_names`.
        """
        if self.identification is None:
            together = tuple(describe_prior(obj) for obj in self.objects)
        else:
            together = make_object_models(self.identification)
        return tuple(self.learned_alone.get(b, found) for b, found in enumerate(together))

    @classmethod
    def of_truth(cls, scene: Scene) -> "SceneBelief":
        """Takes the objects' masses and frictions for known."""
        return cls(scene)

    @classmethod
    def of_prior(
        cls,
        objects: Sequence[GridObject],
        poses: Array,
        *,
        pair_friction: float = DEFAULT_PAIR_FRICTION,
        draws: int = DRAWS,
        seed: int = 0,
    ) -> "SceneBelief":
        """Makes what is believed before any push.

        Args:
            objects: the N objects.
            poses: (N, 3) where they lie, m and rad.
            pair_friction: friction that two objects are expected to have against each other.
            draws: number of further models.
            seed: seed of the draws.
        """
        # In a scene loads do not shift, however high the objects are pushed.
        objects = [lay_flat(obj) for obj in objects]
        even = [CellParameters.uniform(obj) for obj in objects]
        scene = _make_scene(objects, even, poses, pair_friction)
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
            models.append(_make_scene(objects, drawn, poses, friction))
        return cls(scene, tuple(models))

    @classmethod
    def of_identification(
        cls, found: SceneIdentification, *, draws: int = DRAWS, seed: int = 0
    ) -> "SceneBelief":
        """Makes what is believed after pushes were learned from.

        Args:
            found: what was learned.
            draws: number of further models, from its posterior.
            seed: seed of the draws.
        """
        models = draw_scenes(found, draws, seed)
        return cls(found.scene, tuple(models), found)


def lay_flat(obj: GridObject) -> GridObject:
    """Returns an object of which is not known how high it is pushed: in a scene no loads shift."""
    if obj.prior.push_height is None:
        return obj
    return replace(obj, prior=replace(obj.prior, push_height=None))


def draw_scenes(found: SceneIdentification, count: int, seed: int) -> list[Scene]:
    """Draws models from the posterior of z = (log k; log of both kinds of contact friction).

    Args:
        found: what was learned.
        count: number of models.
        seed: seed of the draws.
    """
    scene = found.scene
    n = len(scene)
    # a root of the covariance, which may be singular up to round-off
    values, vectors = np.linalg.eigh(found.covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    rng = np.random.default_rng(seed)
    sizes = [obj.n for obj in scene.objects]
    pairs = np.triu_indices(n, 1)
    models = []
    for _ in range(count):
        change = root @ rng.standard_normal(len(root))
        *logs, finger, pair = np.split(change, np.cumsum([*sizes, n]))
        finger = np.clip(finger, -MAX_LOG_FRICTION, MAX_LOG_FRICTION)
        pair = np.clip(pair, -MAX_LOG_FRICTION, MAX_LOG_FRICTION)
        params = [
            replace(
                each,
                mass=each.mass * np.exp(log),
                contact_friction=float(each.contact_friction * np.exp(mu)),
            )
            for each, log, mu in zip(scene.params, logs, finger, strict=True)
        ]
        friction = np.zeros((n, n))
        friction[pairs] = scene.pair_friction[pairs] * np.exp(pair)
        models.append(_make_scene(scene.objects, params, scene.poses, friction + friction.T))
    return models


def _make_scene(
    objects: Sequence[GridObject],
    params: Sequence[CellParameters],
    poses: Array,
    pair_friction: float | Array,
) -> Scene:
    """Makes a scene at noisy poses (N, 3), at which objects that touch may overlap."""
    bodies = [SceneBody(*each) for each in zip(objects, params, poses, strict=True)]
    return Scene(bodies, pair_friction, may_overlap=True)
