"""Cells' values as colors, on a scale that stays the same while an estimate improves.

Shares are shown as ratios to the even fraction: a cell's mass as m_i n / sum(m), its relative
friction as mu_i m_i n / sum(mu m). Colors follow the logarithm, u = log(value / low) / log(high /
low) cut to 0..1, so that a quarter of the even fraction and four times as much lie equally far from
the middle.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from matplotlib import colormaps
from numpy.typing import ArrayLike

from gridpush_drake.errors import StationError
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.report.draw import CELL_MAP

Shown = Literal["mass", "friction", "relative_friction"]

COLORED_VALUES = ("mass", "friction", "relative_friction")
"""Values of cells that can be shown."""

MIN_FRACTION = 0.25
"""Lower end of the color scale of shares, in even shares."""

MAX_FRACTION = 4.0
"""Upper end of the color scale of shares, in even shares."""

MIN_FRICTION = 0.1
"""Lower end of the color scale of friction coefficients."""

MAX_FRICTION = 1.0
"""Upper end of the color scale of friction coefficients."""


@dataclass(frozen=True)
class CellColors:
    """Which of the cells' values are shown, and in what colors.

    Attributes:
        shows: "mass" or "relative_friction", in even shares, or "friction", as the coefficient.
        limits: (low, high) ends of the color map, beyond which colors stay the same; by default
            MIN_FRACTION and MAX_FRACTION, or for "friction" MIN_FRICTION and MAX_FRICTION.
        colormap: as matplotlib names it.

    Raises:
        StationError: a name is unknown, or the limits are not 0 < low < high.
    """

    shows: Shown = "mass"
    limits: tuple[float, float] | None = None
    colormap: str = CELL_MAP

    def __post_init__(self) -> None:
        if self.shows not in COLORED_VALUES:
            raise StationError(
                f"shows is {self.shows!r}; expected one of {', '.join(COLORED_VALUES)}"
            )
        if self.colormap not in colormaps:
            raise StationError(
                f"colormap is {self.colormap!r}; expected one of matplotlib's, such as {CELL_MAP}"
            )
        low, high = self.resolve_limits()
        if not 0 < low < high < np.inf:
            raise StationError(f"limits are {self.limits!r}; expected 0 < least < greatest")

    def resolve_limits(self) -> tuple[float, float]:
        """Finds the ends of the color map."""
        if self.limits is not None:
            return self.limits
        return (
            (MIN_FRICTION, MAX_FRICTION)
            if self.shows == "friction"
            else (MIN_FRACTION, MAX_FRACTION)
        )

    def calc_values(self, mass: ArrayLike, friction: ArrayLike) -> Array:
        """Calculates the values (n,) that are shown of cells.

        Args:
            mass: (n,) masses, kg.
            friction: (n,) friction coefficients.
        """
        friction = np.asarray(friction, dtype=np.float64)
        if self.shows == "friction":
            return friction
        weight = np.asarray(mass, dtype=np.float64)
        weight = weight * friction if self.shows == "relative_friction" else weight
        total = weight.sum()
        return weight * len(weight) / total if total > 0 else np.ones(len(weight))

    def calc_colors(self, mass: ArrayLike, friction: ArrayLike) -> Array:
        """(n, 3) sRGB, 0 to 1, of cells with masses (n,), kg, and friction coefficients (n,)."""
        return self.calc_colors_of(self.calc_values(mass, friction))

    def calc_colors_of(self, values: ArrayLike) -> Array:
        """(..., 3) sRGB, 0 to 1, of values (...)."""
        low, high = self.resolve_limits()
        cut = np.clip(np.asarray(values, dtype=np.float64), low, high)
        # u = log(value / low) / log(high / low)
        u = np.log(cut / low) / np.log(high / low)
        red_green_blue_opacity = np.asarray(colormaps[self.colormap](u))
        return red_green_blue_opacity[..., :3]
