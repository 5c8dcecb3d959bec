"""Graspable parts: stretches of the object that are narrower than the gripper opens.

The gripper's two jaws close along a direction u in the table's plane. Seen along u, a stretch is the piece of the
object between two lines a finger's depth apart; it can be taken where

    its extent along u is at most the opening less a clearance on either side,
    both jaws, whose pads give a little, touch it side by side along a fair share of their depth, and
    the jaws have room beside it.

Its footprint is the rectangle of the piece, the clearances and the jaws: what must be beyond the table's edge.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import shapely
from shapely import Polygon, affinity

from gridpush_drake.errors import PlanningError
from gridpush_drake.geometry.se2 import Array, make_rotation
from gridpush_drake.objects.grid_object import GridObject

PIECE_SHARE = 0.95
"""Of the finger's depth that a piece must be long."""

CHORDS = 11
"""Lines across a piece that say where the jaws touch it."""

ANGLES = 36
"""Closing directions tried, evenly spaced over half a turn."""

STEP = 0.01
"""m, between stretches tried in one closing direction."""


@dataclass(frozen=True)
class Gripper:
    """A parallel gripper, as far as it matters here; the figures are a Schunk WSG 50's with slim fingers.

    Attributes:
        opening: how far the jaws open, m.
        depth: of the fingers along the object, across the closing direction, m.
        clearance: between each open jaw and the object, m.
        thickness: of a jaw along the closing direction, m.
        pad: how far the jaws' pads give, m.
        hold: share of the depth along which both pads must touch.

    Raises:
        PlanningError: a value is out of range.
    """

    opening: float = 0.11
    depth: float = 0.03
    clearance: float = 0.004
    thickness: float = 0.010
    pad: float = 0.003
    hold: float = 0.35

    def __post_init__(self) -> None:
        for name in ("opening", "depth", "thickness"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise PlanningError(f"gripper: {name} is {getattr(self, name)!r}; expected a positive number (m)")
        if not 0 <= 2 * self.clearance < self.opening:
            raise PlanningError(f"gripper: clearance is {self.clearance!r}; expected 0 to half the opening (m)")
        if not (0 <= self.hold <= 1 and self.pad >= 0):
            raise PlanningError(
                f"gripper: pad is {self.pad!r} and hold {self.hold!r}; expected a length >= 0 (m) and a share, 0 to 1"
            )


@dataclass(frozen=True, eq=False)
class GraspPart:
    """A stretch of the object that the gripper can take.

    Attributes:
        p_BG: (2,) middle of the stretch, body frame, m.
        closing: (2,) unit vector along which the jaws close, body frame.
        width: of the object between the jaws, m.
        footprint: (4, 2) corners of stretch, clearances and jaws, body frame, m, counterclockwise.
    """

    p_BG: Array
    closing: Array
    width: float
    footprint: Array


def find_grasp_parts(obj: GridObject, gripper: Gripper | None = None) -> list[GraspPart]:
    """Finds where the gripper can take the object.

    Args:
        obj: the object.
        gripper: its measures.

    Returns:
        The parts, by closing direction and place; empty where the object is too wide everywhere.
    """
    gripper = gripper or Gripper()
    parts: list[GraspPart] = []
    for angle in np.pi * np.arange(ANGLES) / ANGLES:
        parts.extend(_find_along(obj, gripper, float(angle)))
    return parts


def _find_along(obj: GridObject, gripper: Gripper, angle: float) -> Iterator[GraspPart]:
    """The parts for one closing direction, which is turned into the x axis."""
    outline = affinity.rotate(obj.outline, -angle, origin=(0.0, 0.0), use_radians=True)
    left, bottom, right, top = outline.bounds
    shapely.prepare(outline)
    spare = top - bottom - gripper.depth
    if spare < -(1 - PIECE_SHARE) * gripper.depth:
        return
    count = max(int(np.ceil(spare / STEP)), 0) + 1
    R = make_rotation(angle)
    for y in np.linspace(bottom, max(top - gripper.depth, bottom), count):
        strip = outline.intersection(shapely.box(left - 1.0, y, right + 1.0, y + gripper.depth))
        pieces = [piece for piece in getattr(strip, "geoms", [strip]) if isinstance(piece, Polygon)]
        for i, piece in enumerate(pieces):
            if _fits(piece, pieces[:i] + pieces[i + 1 :], gripper):
                yield _make_part(piece, y, R, gripper)


def _fits(piece: Polygon, others: list[Polygon], gripper: Gripper) -> bool:
    x0, y0, x1, y1 = piece.bounds
    width = x1 - x0
    if width <= 0 or width > gripper.opening - 2 * gripper.clearance or y1 - y0 < PIECE_SHARE * gripper.depth:
        return False
    if _calc_held_share(piece, gripper.pad) < gripper.hold:
        return False
    reach = gripper.clearance + gripper.thickness
    sides = (shapely.box(x0 - reach, y0, x0, y1), shapely.box(x1, y0, x1 + reach, y1))
    return not any(side.intersects(other) for side in sides for other in others)


def _calc_held_share(piece: Polygon, pad: float) -> float:
    """Share of the piece's length along which both jaws touch, their pads given way by `pad`, m."""
    x0, y0, x1, y1 = piece.bounds
    heights = y0 + (y1 - y0) * (np.arange(CHORDS) + 0.5) / CHORDS
    ends = np.array([[[x0 - 1.0, y], [x1 + 1.0, y]] for y in heights])
    left, _, right, _ = shapely.bounds(shapely.intersection(piece, shapely.linestrings(ends))).T
    return float(((left <= x0 + pad) & (right >= x1 - pad)).mean())


def _make_part(piece: Polygon, y: float, R: Array, gripper: Gripper) -> GraspPart:
    x0, _, x1, _ = piece.bounds
    reach = gripper.clearance + gripper.thickness
    a, b = x0 - reach, x1 + reach
    corners = np.array([[a, y], [b, y], [b, y + gripper.depth], [a, y + gripper.depth]])
    middle = np.array([(x0 + x1) / 2, y + gripper.depth / 2])
    return GraspPart(R @ middle, R[:, 0].copy(), float(x1 - x0), corners @ R.T)
