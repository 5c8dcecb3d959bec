"""What is known of an object's mass and friction before any push."""

from dataclasses import dataclass

import numpy as np

from gridpush_drake.errors import ParameterError


@dataclass(frozen=True)
class PhysicalPrior:
    """Prior knowledge of an object, all of it optional.

    Attributes:
        total_mass: kg; None where it was not weighed.
        center_of_mass: (x, y) in the body frame, m; None where unknown.
        center_of_mass_std: its standard deviation per axis, m.
        friction: prior friction coefficient of the cells against the support.
        friction_min: smallest coefficient held possible.
        friction_max: largest coefficient held possible.
        contact_friction: prior friction coefficient of the pusher against the object.
        contact_friction_std: its standard deviation.
        pusher_radius: m; None where the object's file does not say.
        push_height: above the table, where the pusher touches, m; it comes with the pusher's radius. None where nothing
            is said of it: every cell is then taken to bear its own weight.

    Raises:
        ParameterError: a value is out of range.
    """

    total_mass: float | None = None
    center_of_mass: tuple[float, float] | None = None
    center_of_mass_std: float = 0.002
    friction: float = 0.4
    friction_min: float = 0.05
    friction_max: float = 1.0
    contact_friction: float = 0.5
    contact_friction_std: float = 0.15
    pusher_radius: float | None = None
    push_height: float | None = None

    def __post_init__(self) -> None:
        positive = (
            "total_mass", "center_of_mass_std", "friction", "friction_min", "friction_max",
            "contact_friction_std", "pusher_radius", "push_height",
        )  # fmt: skip
        for name in positive:
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value > 0):
                raise ParameterError(f"{name} is {value!r}; expected a positive number")
        if self.push_height is not None and self.pusher_radius is None:
            raise ParameterError("push_height is given without pusher_radius; expected both")
        if not (np.isfinite(self.contact_friction) and self.contact_friction >= 0):
            raise ParameterError(f"contact_friction is {self.contact_friction!r}; expected a number >= 0")
        if not self.friction_min <= self.friction <= self.friction_max:
            raise ParameterError(
                f"friction.prior is {self.friction!r}; expected min <= prior <= max, "
                f"here {self.friction_min} to {self.friction_max}"
            )
        if self.center_of_mass is not None and not np.isfinite(self.center_of_mass).all():
            raise ParameterError(f"center_of_mass.at is {self.center_of_mass!r}; expected two finite numbers")
