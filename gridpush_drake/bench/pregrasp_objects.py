"""The objects and tables of the pre-grasp benchmark."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from gridpush_drake.bench.public_data import find_masks
from gridpush_drake.errors import GridPushError
from gridpush_drake.grid.object import GridObject
from gridpush_drake.grid.object_file import find_shipped_object
from gridpush_drake.planning.surface import SupportSurface

MASK_OBJECT = "hammer"
"""The paper's own hammer, a mask among the public data."""

OBJECTS = (
    "claw_hammer",
    "combination_wrench",
    "pliers",
    "spray_bottle",
    "spring_clamp",
    "toolbox",
    "toothpaste_tube",
)
"""Those of the shipped objects that have a graspable part."""

METRES_PER_PIXEL = 0.53 / 640
"""Of the paper's masks, for its real objects."""

RECTANGLE, RADIUS, HEXAGON = (0.9, 0.7), 0.45, 0.5
"""m: sides, radius, circumradius of the tables, which take turns by seed."""


def find_mask(data: Path) -> Path:
    """Finds the paper's hammer among the public data. Raises GridPushError where it is not there."""
    masks = find_masks(data)
    if MASK_OBJECT not in masks:
        raise GridPushError(f"{data}: holds no mask of {MASK_OBJECT}; expected {MASK_OBJECT}_label.pgm")
    return masks[MASK_OBJECT].resolve()


def load_bench_object(name: str, friction_range: tuple[float, float], mask: Path | None = None) -> GridObject:
    """Loads an object, its support friction known to be within a range, its parts' masses not at all.

    Args:
        name: of OBJECTS, or of the mask.
        friction_range: least and greatest coefficient of any cell.
        mask: file of the paper's object; None for a shipped one.

    Returns:
        The object; the prior coefficient is the range's geometric mean.

    Raises:
        ObjectError: no shipped object has this name, or the mask cannot be read.
    """
    if mask is not None:
        obj = GridObject.from_mask(mask, metres_per_pixel=METRES_PER_PIXEL, name=name)
    else:
        obj = GridObject.from_yaml(find_shipped_object(name))
    low, high = friction_range
    prior = replace(
        obj.prior, total_mass=None, friction=float(np.sqrt(low * high)), friction_min=low, friction_max=high
    )
    return replace(obj, prior=prior)


def make_table(seed: int) -> SupportSurface:
    """A rectangular, a round or a hexagonal table about the world's origin, in turn."""
    kind = seed % 3
    if kind == 0:
        return SupportSurface.rectangle((0.0, 0.0), RECTANGLE)
    if kind == 1:
        return SupportSurface.round((0.0, 0.0), RADIUS)
    angle = np.pi / 3 * np.arange(6)
    return SupportSurface.from_polygon(HEXAGON * np.column_stack([np.cos(angle), np.sin(angle)]))
