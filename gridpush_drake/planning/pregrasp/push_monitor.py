"""`PushMonitor` watches a push under way near the table's edge.

It sees whether the object stays as safe as was planned, and clear of other things on the table.

A push is planned so that the worst-case stability margin m(q) stays at m0 or above, where m0 is
what was asked for, or less where the margin was thinner at the beginning. An observed pose is wrong
by up to e, so that nothing is known to be amiss until

    m_e(q) < m0 - e,

where m_e also counts as held those cells that only just seem to be beyond the edge, by e or less.
If that happens, something else happened than was planned: the object slipped, or somebody moved it.
How pushes are planned is in `slides`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import shapely
from shapely import Polygon
from shapely.geometry.base import BaseGeometry

from gridpush_drake.geometry.se2 import Array, transform_shape
from gridpush_drake.planning.plausible_masses import PlausibleMassSet
from gridpush_drake.planning.pregrasp.slides import SlideOptions, calc_kept_margin
from gridpush_drake.planning.pregrasp.stability import calc_stability_margin
from gridpush_drake.planning.push_constraints import make_body
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.units import MM_PER_M

BREAK_OFF_DISTANCE = 0.015
"""Distance between the object and another thing below which a push under way is broken off, m. Two
pictures may pass before the finger stops, in which it moves by less."""


@dataclass(frozen=True, eq=False)
class PushMonitor:
    """Watches one push, by what it was planned with.

    Attributes:
        masses: that the object may have.
        surface: the table.
        margin: m0, the stability margin that the push was planned to keep, m.
        inset: how far inside the edge a cell's center must be to hold, m.
        error: e, by how much an observed pose may be wrong, m.
        obstacles: other things on the table, as one shape in W; None for none.
        room: least distance from them that the object keeps, m.
    """

    masses: PlausibleMassSet
    surface: SupportSurface
    margin: float
    inset: float
    error: float
    obstacles: BaseGeometry | None = None
    room: float = 0.0

    @classmethod
    def of_push(
        cls,
        masses: PlausibleMassSet,
        surface: SupportSurface,
        pose: Array,
        options: SlideOptions,
        error: float,
        obstacles: Sequence[Polygon] = (),
    ) -> "PushMonitor":
        """Makes the monitor of a push that was planned with `options`.

        Args:
            masses: that the object may have.
            surface: the table.
            pose: (3,) where the push begins, X_WB, m and rad.
            options: that the push was planned with.
            error: by how much an observed pose may be wrong, m.
            obstacles: what else lies on the table, polygons in W, m. Where the object begins nearer
                to one than pushes are broken off at, it must not come nearer still.
        """
        others = None
        room = 0.0
        if obstacles:
            others = shapely.union_all(list(obstacles))
            at_start = transform_shape(pose, make_body(masses.obj)).distance(others)
            room = min(BREAK_OFF_DISTANCE, at_start - error)
        return cls(
            masses=masses,
            surface=surface,
            margin=calc_kept_margin(masses, pose, surface, options.margin, options.inset),
            inset=options.inset,
            error=error,
            obstacles=others,
            room=room,
        )

    def find_fault(self, pose: Array) -> str | None:
        """Says why the push should not go on.

        Args:
            pose: (3,) where the object is seen, X_WB, m and rad.

        Returns:
            The reason in half a sentence; None where the push may go on.
        """
        if self.obstacles is not None:
            gap = transform_shape(pose, make_body(self.masses.obj)).distance(self.obstacles)
            if gap < self.room:
                return f"the object is {gap * MM_PER_M:.0f} mm from another one"
        margin = calc_stability_margin(self.masses, pose, self.surface, self.inset - self.error)
        if margin >= self.margin - self.error:
            return None
        return (
            f"the object might fall, its stability margin is {margin * MM_PER_M:.0f} mm at the "
            "worst"
        )
