"""What the parameters that a search tries lie between."""

from dataclasses import dataclass

import numpy as np

from gridpush_drake.errors import IdentificationError
from gridpush_drake.grid.object import GridObject
from gridpush_drake.grid.parameters import CellParameters

MASS_SPREAD = 50.0
"""Ratio of the greatest to the least cell mass where nothing else is known: the paper's 5.0 kg to 0.1 kg."""


@dataclass(frozen=True)
class Bounds:
    """What every cell's parameters lie between; equal numbers hold a parameter where it is.

    Attributes:
        mass: least and greatest mass of a cell, kg.
        friction: least and greatest friction coefficient of a cell against the support.

    Raises:
        IdentificationError: a range is not positive and increasing.
    """

    mass: tuple[float, float]
    friction: tuple[float, float]

    def __post_init__(self) -> None:
        for name in ("mass", "friction"):
            low, high = getattr(self, name)
            if not 0 < low <= high < np.inf:
                raise IdentificationError(f"bounds.{name} is {(low, high)!r}; expected 0 < least <= greatest")

    @classmethod
    def around(cls, obj: GridObject, start: CellParameters) -> "Bounds":
        """The object's friction bounds, and masses up to sqrt(MASS_SPREAD) times the start's mean up and down."""
        mean, factor = start.total_mass / start.n, MASS_SPREAD**0.5
        return cls((mean / factor, mean * factor), (obj.prior.friction_min, obj.prior.friction_max))

    def clip(self, params: CellParameters) -> CellParameters:
        """The nearest parameters within the bounds."""
        mass, friction = np.clip(params.mass, *self.mass), np.clip(params.friction, *self.friction)
        return CellParameters(mass, friction, params.contact_friction)
