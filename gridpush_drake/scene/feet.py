"""The feet that an object stands on: small spheres, pressed into the table by the cells' weights.

A foot that carries the share m_i g of the weight, pressed in by delta, has stiffness

    k_i = m_i g / delta

so that, pressed in by delta, it bears just that share, whatever the other feet do.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import ProximityProperties

from gridpush_drake.errors import ParameterError
from gridpush_drake.grid.object import GridObject
from gridpush_drake.grid.parameters import CellParameters
from gridpush_drake.scene.contact_material import MakeContactProperties, calc_own_friction

FOOT_RADIUS = 0.002
"""m; more than the feet are ever pressed in."""

FeetPerCell = Literal[1, 4]


@dataclass(frozen=True, eq=False)
class FeetLayout:
    """Where the feet are.

    Attributes:
        p_BF: (f, 2) where they touch the table, body frame, m.
        cell: (f,) the cell that each belongs to.
        feet_per_cell: 1: at the cells' centres; 4: at their corners.
    """

    p_BF: NDArray[np.float64]
    cell: NDArray[np.int64]
    feet_per_cell: FeetPerCell

    @classmethod
    def for_object(cls, obj: GridObject, feet_per_cell: FeetPerCell = 1) -> "FeetLayout":
        """Lays out the feet of an object.

        Args:
            obj: the object.
            feet_per_cell: 1, or 4 to support it out to its rim.

        Returns:
            The layout, cell by cell.

        Raises:
            ParameterError: `feet_per_cell` is neither.
        """
        if feet_per_cell == 1:
            return cls(obj.p_BC, np.arange(obj.n), 1)
        if feet_per_cell != 4:
            raise ParameterError(f"feet_per_cell is {feet_per_cell!r}; expected 1 or 4")
        corners = obj.cell_size / 2 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        return cls((obj.p_BC[:, None] + corners).reshape(-1, 2), np.repeat(np.arange(obj.n), 4), 4)

    def make_properties(self, params: CellParameters, delta: float, gravity: float) -> list[ProximityProperties]:
        """Makes the feet's contact properties.

        Args:
            params: what the cells weigh and how they rub.
            delta: how far the feet are pressed in, m.
            gravity: m/s².

        Returns:
            Properties of the f feet.

        Raises:
            ParameterError: a friction is 2 or more, which Drake's combination cannot give.
        """
        stiffness = params.mass * gravity / (delta * self.feet_per_cell)
        friction = [calc_own_friction(float(mu), f"friction of cell {i}") for i, mu in enumerate(params.friction)]
        return [MakeContactProperties(friction[i], float(stiffness[i])) for i in self.cell]
