"""Per-cell mass and friction, and the mass properties that follow from them.

These are the numbers with which an object is simulated, and those that are learned. What is known
of them beforehand is in `PhysicalPrior`; how they are learned stands in `identification`.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from gridpush_drake.errors import ParameterError
from gridpush_drake.frozen import Frozen
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.notebook import count, describe_range, make_page, make_table
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.units import MM_PER_M

DEFAULT_TOTAL_MASS = 1.0
"""Mass that is taken for an object that was never weighed, kg."""


@dataclass(frozen=True, eq=False)
class CellParameters(Frozen):
    """The physical parameters of a grid object's n cells.

    Attributes:
        mass: (n,) kg, positive.
        friction: (n,) friction coefficient of each cell against the support, >= 0.
        contact_friction: friction coefficient of the pusher against the object's outline, >= 0.
        push_height: height above the table at which pushers act, m: the higher, the more load they
            shift forward (see `dynamics.kernels.support_loads`). 0 leaves every cell its own
            weight, as in the paper.
        patch_ratio: side of the square in a cell's middle that bears its load, over the cell's
            side, from 0 to 1. 1 is the whole cell, as in the paper; towards 0 the cells stand on
            points, as a rigid body does on its feet.

    Raises:
        ParameterError: shapes disagree or a value is out of range.
    """

    mass: Array
    friction: Array
    contact_friction: float = 0.5
    push_height: float = 0.0
    patch_ratio: float = 1.0

    def __post_init__(self) -> None:
        mass, friction = (np.array(value, dtype=np.float64) for value in (self.mass, self.friction))
        if mass.ndim != 1 or mass.shape != friction.shape or not len(mass):
            raise ParameterError(
                f"mass of shape {mass.shape} and friction of shape {friction.shape}; expected "
                "(n,) and (n,)"
            )
        if not (np.isfinite(mass).all() and (mass > 0).all()):
            raise ParameterError("mass: expected positive finite numbers (kg)")
        if not (np.isfinite(friction).all() and (friction >= 0).all()):
            raise ParameterError("friction: expected finite numbers >= 0")
        if not (np.isfinite(self.contact_friction) and self.contact_friction >= 0):
            raise ParameterError(
                f"contact_friction is {self.contact_friction!r}; expected a number >= 0"
            )
        if not (np.isfinite(self.push_height) and self.push_height >= 0):
            raise ParameterError(f"push_height is {self.push_height!r}; expected a number >= 0 (m)")
        if not 0 <= self.patch_ratio <= 1:
            raise ParameterError(
                f"patch_ratio is {self.patch_ratio!r}; expected a number from 0 to 1"
            )
        for name, value in (("mass", mass), ("friction", friction)):
            value.setflags(write=False)
            object.__setattr__(self, name, value)
        for name in ("contact_friction", "push_height", "patch_ratio"):
            object.__setattr__(self, name, float(getattr(self, name)))

    def __repr__(self) -> str:
        """Number of cells, masses and frictions, in a line or two."""
        loads = f"{self.total_mass:.3g} kg in all, {describe_range(self.mass, 'kg')} a cell"
        frictions = (
            f"friction {describe_range(self.friction)}, of the pusher {self.contact_friction:.3g}"
        )
        more = (
            ""
            if self.push_height == 0
            else f", pushed {self.push_height * MM_PER_M:.1f} mm above the table"
        )
        return f"CellParameters of {count(self.n, 'cell')}: {loads};\n{frictions}{more}"

    def _repr_html_(self) -> str:
        """The least, middle and greatest of masses and frictions, as a table."""
        rows = [
            (name, *(f"{each:.4g}" for each in np.quantile(values, (0.0, 0.5, 1.0))), unit)
            for name, values, unit in (
                ("mass of a cell", self.mass, "kg"),
                ("friction of a cell", self.friction, ""),
            )
        ]
        return make_page(repr(self), make_table(("", "least", "median", "greatest", ""), rows))

    @classmethod
    def uniform(
        cls,
        obj: GridObject,
        total_mass: float | None = None,
        friction: float | None = None,
        contact_friction: float | None = None,
    ) -> "CellParameters":
        """Spreads the mass (kg) evenly over the cells; what is not given comes from `obj.prior`.

        Raises:
            ParameterError: a value is out of range.
        """
        if total_mass is None:
            total_mass = obj.prior.total_mass or DEFAULT_TOTAL_MASS
        return cls(
            np.full(obj.n, total_mass / obj.n),
            np.full(obj.n, obj.prior.friction if friction is None else friction),
            obj.prior.contact_friction if contact_friction is None else contact_friction,
            obj.prior.push_height or 0.0,
        )

    @classmethod
    def by_part(
        cls,
        obj: GridObject,
        mass: Mapping[int, float],
        friction: Mapping[int, float] | float | None = None,
        contact_friction: float | None = None,
    ) -> "CellParameters":
        """Gives every cell of a part the same values.

        Args:
            obj: the object.
            mass: mass of one *cell*, kg, by the part's label.
            friction: friction coefficient by label, or one for all; the prior's by default.
            contact_friction: friction of the pusher; the prior's by default.

        Raises:
            ParameterError: a label of the object is missing, or a value is out of range.
        """
        friction = obj.prior.friction if friction is None else friction
        return cls(
            _spread(obj, "mass", mass),
            _spread(obj, "friction", friction)
            if isinstance(friction, Mapping)
            else np.full(obj.n, float(friction)),
            obj.prior.contact_friction if contact_friction is None else contact_friction,
            obj.prior.push_height or 0.0,
        )

    @classmethod
    def random(
        cls,
        obj: GridObject,
        seed: int,
        mass_range: tuple[float, float] = (0.1, 5.0),
        friction_range: tuple[float, float] | None = None,
        by: str = "part",
    ) -> "CellParameters":
        """Draws masses, uniform in their logarithm, and frictions, uniform.

        Args:
            obj: the object.
            seed: seed of the draws.
            mass_range: smallest and largest mass of a cell, kg.
            friction_range: smallest and largest friction; None for `obj.prior.friction` everywhere.
            by: "part" to draw once for each part, "cell" once for each cell.

        Raises:
            ParameterError: a range is not positive and increasing, or `by` is neither word.
        """
        if by not in ("part", "cell"):
            raise ParameterError(f"by is {by!r}; expected 'part' or 'cell'")
        if not 0 < mass_range[0] <= mass_range[1] < np.inf:
            raise ParameterError(f"mass_range is {mass_range!r}; expected 0 < least <= greatest")
        rng = np.random.default_rng(seed)
        group = np.unique(obj.labels, return_inverse=True)[1] if by == "part" else np.arange(obj.n)
        groups = int(group.max()) + 1
        mass = np.exp(rng.uniform(np.log(mass_range[0]), np.log(mass_range[1]), groups))[group]
        height = obj.prior.push_height or 0.0
        if friction_range is None:
            return cls(mass, np.full(obj.n, obj.prior.friction), obj.prior.contact_friction, height)
        if not 0 <= friction_range[0] <= friction_range[1] < np.inf:
            raise ParameterError(
                f"friction_range is {friction_range!r}; expected 0 <= least <= greatest"
            )
        return cls(
            mass, rng.uniform(*friction_range, groups)[group], obj.prior.contact_friction, height
        )

    @property
    def n(self) -> int:
        """Number of cells."""
        return len(self.mass)

    @property
    def total_mass(self) -> float:
        """Mass of all cells together, kg."""
        return float(self.mass.sum())

    def center_of_mass(self, obj: GridObject) -> Array:
        """Center of mass p_BBcm (2,), m; raises ParameterError for an object of other cells."""
        if obj.n != self.n:
            raise ParameterError(
                f"parameters of {self.n} cells; expected {obj.n}, as {obj.name} has"
            )
        return self.mass @ obj.p_BC / self.total_mass

    def inertia(self, obj: GridObject) -> float:
        """Moment of inertia about the vertical axis through the center of mass, kg m²."""
        # Each cell is a plate, with m s²/6 about its own center.
        arm = obj.p_BC - self.center_of_mass(obj)
        return float(self.mass @ ((arm**2).sum(axis=1) + obj.cell_size**2 / 6))

    def relative_friction(self) -> Array:
        """Shares (n,) of the support's friction that the cells carry, k_i = mu_i m_i / sum(mu m).

        They are equal where there is no friction at all.
        """
        load = self.mass * self.friction
        total = load.sum()
        return load / total if total > 0 else np.full(self.n, 1 / self.n)


def _spread(obj: GridObject, name: str, by_label: Mapping[int, float] | ArrayLike) -> Array:
    assert isinstance(by_label, Mapping)
    missing = sorted(set(obj.labels.tolist()) - set(by_label))
    if missing:
        raise ParameterError(
            f"{name}: no value for part {missing[0]} of {obj.name}; expected one for each part"
        )
    return np.array([float(by_label[int(label)]) for label in obj.labels])
