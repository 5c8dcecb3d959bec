"""`Pusher`: what pushes objects, and how: its shape, its speed, and the room it needs."""

from collections.abc import Sequence
from dataclasses import dataclass

from gridpush_drake.errors import ObjectError, PlanningError, require_positive
from gridpush_drake.objects.grid_object import GridObject

DEFAULT_PUSHER_RADIUS = 0.008
"""Radius of a pusher where neither the caller nor the object's file gives one, m: that of the
shipped finger, `models/fingers/rod`. Learning and planning take the same one."""


@dataclass(frozen=True)
class Pusher:
    """A disc that pushes objects.

    Attributes:
        radius: of the disc, m; None for that of the objects' files, or else of the shipped finger.
        speed: at which it pushes, m/s.
        clearance: gap between disc and object where a push begins, m.

    Raises:
        PlanningError: a number is out of range.
    """

    radius: float | None = None
    speed: float = 0.03
    clearance: float = 0.002

    def __post_init__(self) -> None:
        if self.radius is not None:
            require_positive(PlanningError, unit="m", radius=self.radius)
        require_positive(PlanningError, unit="m/s", speed=self.speed)
        if not 0 <= self.clearance < float("inf"):
            raise PlanningError(f"clearance is {self.clearance!r}; expected a number >= 0 (m)")

    def choose_radius(self, objects: GridObject | Sequence[GridObject]) -> float:
        """Chooses the radius, m, with which it pushes an object or objects."""
        return choose_pusher_radius(objects, self.radius)


DEFAULT_PUSHER = Pusher()
"""The shipped finger, or that of the objects' files, at its usual speed."""


def find_pusher_radius(objects: Sequence[GridObject]) -> float | None:
    """Finds the pusher's radius in objects' files, m; None where none has it.

    Raises:
        ObjectError: they name different ones.
    """
    known = [obj.prior.pusher_radius for obj in objects]
    radii = {radius for radius in known if radius is not None}
    if len(radii) > 1:
        listed = ", ".join(f"{radius:g} m" for radius in sorted(radii))
        raise ObjectError(
            f"the objects' files name pushers of different radii, {listed}; expected one pusher"
        )
    return radii.pop() if radii else None


def choose_pusher_radius(
    objects: GridObject | Sequence[GridObject], radius: float | None = None
) -> float:
    """Chooses a pusher's radius, m: as given, else the objects' files', else the shipped finger's.

    Args:
        objects: the object, or the objects, that are pushed.
        radius: as given, m; None where it is not.

    Raises:
        ObjectError: the objects' files name different ones.
    """
    if radius is not None:
        return radius
    known = find_pusher_radius([objects] if isinstance(objects, GridObject) else objects)
    return DEFAULT_PUSHER_RADIUS if known is None else known
