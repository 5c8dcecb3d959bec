"""`Bodies`: one or several objects on a table, what their cells weigh, and how they slide.

What an object weighs and how rough it is on the table and to the pusher stands in its
`CellParameters`; how rough objects are to each other stands in `pair_friction`.

It is the part of a model that simulations need. `identification.model.Model` is made of it and adds
what a model can do; users make that one. Where there is one object, `obj` and `params` are it and
its parameters, and nobody has to write an index.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from gridpush_drake.dynamics.physics import DEFAULT_PHYSICS, Physics, Regime
from gridpush_drake.errors import SimulationError
from gridpush_drake.frozen import Frozen
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters

ValueType = TypeVar("ValueType")

DEFAULT_PAIR_FRICTION = 0.3
"""Friction coefficient of two objects against each other that is taken where none is given."""

NO_PAIRS = np.zeros((1, 1))
"""Matrix of the pairs' friction of one object, which has none: one for all such models."""
NO_PAIRS.setflags(write=False)


@dataclass(frozen=True, eq=False, init=False)
class Bodies(Frozen):
    """N objects with their parameters, and the physics by which they move.

    Attributes:
        objects: the N objects.
        parameters: (N,) the masses and frictions of their cells.
        physics: friction law, regime, spin, gravity and tolerances.
        pair_friction: (N, N) friction coefficients of two objects against each other, symmetric;
            the diagonal means nothing.
    """

    objects: tuple[GridObject, ...]
    parameters: tuple[CellParameters, ...]
    physics: Physics = DEFAULT_PHYSICS
    pair_friction: Array = DEFAULT_PAIR_FRICTION  # type: ignore[assignment]

    def __init__(
        self,
        objects: GridObject | Sequence[GridObject],
        parameters: CellParameters | Sequence[CellParameters] | None = None,
        physics: Physics | None = None,
        pair_friction: ArrayLike = DEFAULT_PAIR_FRICTION,
    ) -> None:
        """Copies and checks what is given.

        Args:
            objects: an object, or several.
            parameters: its masses and frictions, or those of each; by default the total mass and
                friction of the objects' files, spread evenly over the cells.
            physics: `Physics()` by default.
            pair_friction: one friction coefficient for all pairs of objects, or (N, N).

        Raises:
            SimulationError: there is no object, parameters belong to another object, or a friction
                coefficient is out of range.
            TypeError: an argument is of another type, or they are swapped.
        """
        # One object may be given as it is, and so may its parameters.
        many = _make_tuple("objects", objects, GridObject)
        object.__setattr__(self, "objects", many)
        if parameters is None:
            parameters = [CellParameters.uniform(obj) for obj in many]
        object.__setattr__(
            self, "parameters", _make_tuple("parameters", parameters, CellParameters)
        )
        object.__setattr__(self, "physics", DEFAULT_PHYSICS if physics is None else physics)
        object.__setattr__(self, "pair_friction", pair_friction)
        self.__post_init__()

    def __post_init__(self) -> None:
        # Of each kind there is one for each object, and they fit.
        if not isinstance(self.physics, Physics):
            raise TypeError(f"physics is a {type(self.physics).__name__}; expected a Physics")
        if not self.objects:
            raise SimulationError("objects: there is none; expected at least one")
        if len(self.parameters) != len(self.objects):
            raise SimulationError(
                f"parameters of {len(self.parameters)} objects; "
                f"expected {len(self.objects)}, one for each"
            )
        for obj, params in self:
            if params.n != obj.n:
                raise SimulationError(
                    f"parameters of {params.n} cells; expected {obj.n}, as {obj.name} has"
                )
        friction = _check_pair_friction(self.pair_friction, len(self.objects))
        object.__setattr__(self, "pair_friction", friction)

    def __len__(self) -> int:
        """Number of objects."""
        return len(self.objects)

    def __iter__(self) -> Iterator[tuple[GridObject, CellParameters]]:
        """Each object with its parameters."""
        return iter(zip(self.objects, self.parameters, strict=True))

    @property
    def obj(self) -> GridObject:
        """The object.

        Raises:
            SimulationError: there are several.
        """
        self._require_one("obj")
        return self.objects[0]

    @property
    def params(self) -> CellParameters:
        """The masses and frictions of the object's cells.

        Raises:
            SimulationError: there are several objects.
        """
        self._require_one("params")
        return self.parameters[0]

    @property
    def center_of_mass(self) -> Array:
        """The center of mass p_BBcm in the body frame, m: (2,), or (N, 2) of several objects."""
        centers = np.array([params.center_of_mass(obj) for obj, params in self])
        return centers[0] if len(self) == 1 else centers

    @property
    def total_mass(self) -> float:
        """Mass of all objects together, kg."""
        return float(sum(params.total_mass for params in self.parameters))

    def with_params(self, *parameters: CellParameters) -> Self:
        """Makes a model of these objects with other masses and frictions, one set for each."""
        return self._with(parameters=parameters)

    def with_physics(self, physics: Physics) -> Self:
        """Makes a model of these objects that slide by another physics."""
        return self._with(physics=physics)

    def take(self, indices: Sequence[int]) -> "Bodies":
        """Takes some of the objects, by their numbers, in that order."""
        chosen = list(indices)
        return Bodies(
            [self.objects[i] for i in chosen],
            [self.parameters[i] for i in chosen],
            self.physics,
            self.pair_friction[np.ix_(chosen, chosen)],
        )

    def resolve(self, speed: float, regime: Regime | None = None) -> Self:
        """Replaces the regime "auto" by the one that suits a speed, as `Physics.resolve` does.

        Several objects know the regime "quasi_static" alone.

        Args:
            speed: mean speed of the fastest push, m/s.
            regime: takes the place of the one in `physics`, unless None.
        """
        physics = self.physics.with_regime(regime)
        if physics.regime != "auto":
            return self.with_physics(physics)
        if len(self) > 1:
            return self.with_physics(physics.with_regime("quasi_static"))
        mean_friction = float(self.params.friction @ self.params.mass / self.params.total_mass)
        return self.with_physics(physics.resolve(self.obj, mean_friction, speed))

    def _with(self, **changes: object) -> Self:
        """Copies the record with other fields, which are known to fit: nothing is checked."""
        made = object.__new__(type(self))
        made.__dict__.update(self.__dict__)
        made.__dict__.update(changes)
        return made

    def _require_one(self, name: str) -> None:
        """Raises SimulationError, for the property of that name, unless there is one object."""
        if len(self.objects) != 1:
            names = ", ".join(obj.name for obj in self.objects)
            raise SimulationError(
                f"{name}: there are {len(self.objects)} objects ({names}); expected one"
            )


def _check_pair_friction(given: ArrayLike, n: int) -> Array:
    """Makes the matrix (n, n) of the pairs' friction, of one number or a matrix."""
    if n == 1 and isinstance(given, float):
        return NO_PAIRS
    friction = np.array(given, dtype=np.float64)
    if friction.shape == ():
        friction = np.full((n, n), float(friction))
    if friction.shape != (n, n):
        raise SimulationError(
            f"pair_friction of shape {friction.shape}; expected one number or ({n}, {n})"
        )
    pairs = friction[np.triu_indices(n, 1)]
    if not (np.isfinite(pairs).all() and (pairs >= 0).all()):
        raise SimulationError("pair_friction: expected finite numbers >= 0")
    if not np.array_equal(pairs, friction.T[np.triu_indices(n, 1)]):
        raise SimulationError(
            "pair_friction: expected a symmetric matrix; two objects have one friction coefficient"
        )
    np.fill_diagonal(friction, 0.0)
    friction.setflags(write=False)
    return friction


def describe_object(objects: Sequence[GridObject], index: int) -> str:
    """Names one of several objects, with its number where the name alone does not tell it."""
    name = objects[index].name
    same = sum(obj.name == name for obj in objects)
    return name if same == 1 else f"{name} (object {index})"


def _make_tuple(name: str, given: Any, kind: type[ValueType]) -> tuple[ValueType, ...]:
    """Makes a tuple of one or several values, each of a certain kind."""
    if isinstance(given, kind):
        return (given,)
    if isinstance(given, str) or not isinstance(given, Sequence):
        raise TypeError(f"{name} is a {type(given).__name__}; expected a {kind.__name__}")
    values = tuple(given)
    for value in values:
        if not isinstance(value, kind):
            raise TypeError(f"{name}: a {type(value).__name__}; expected a {kind.__name__}")
    return values
