"""`PushGuard`: watches a push under way that the object stays as safe as it was planned to.

A push is planned so that the worst-case stability margin m(q) stays at m0 or above, where m0 is what was asked for, or
less where the margin was thinner at the beginning. A look errs by up to e, so that nothing is known to be amiss until

    m_e(q) < m0 - e,

where m_e also counts as held those cells that only just seem to be beyond the rim, by e or less. Then something else
happened than was planned: the object slipped, or somebody moved it.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.planning.slide_push import SlideOptions, calc_kept_margin
from gridpush_drake.planning.stability import MassSet, calc_stability_margin
from gridpush_drake.planning.surface import SupportSurface

Array = NDArray[np.float64]

MM = 1e3
"""Millimetres in a metre."""


@dataclass(frozen=True, eq=False)
class PushGuard:
    """What one push was planned with.

    Attributes:
        masses: the masses held possible.
        surface: the table.
        margin: m0, m.
        inset: m inside the rim that a cell's centre must be to hold.
        error: e, of a look, m.
    """

    masses: MassSet
    surface: SupportSurface
    margin: float
    inset: float
    error: float

    @classmethod
    def of_push(
        cls, masses: MassSet, surface: SupportSurface, pose: Array, options: SlideOptions, error: float
    ) -> "PushGuard":
        """The guard of a push from `pose` (3,), planned with `options`; `error` is that of a look, m."""
        margin = calc_kept_margin(masses, pose, surface, options.margin, options.inset)
        return cls(masses, surface, margin, options.inset, error)

    def find_fault(self, pose: Array) -> str | None:
        """Why the push should not go on with the object seen at `pose` (3,), in half a sentence; None where it may."""
        margin = calc_stability_margin(self.masses, pose, self.surface, self.inset - self.error)
        if margin >= self.margin - self.error:
            return None
        return f"the object might fall, its stability margin is {margin * MM:.0f} mm at the worst"
