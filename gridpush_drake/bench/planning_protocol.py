"""The planning protocol: objects, hidden masses, ten start and goal poses, a round table (Song & Boularias, RSS 2020).

It is drawn by seed, or read where the public data have it. To the objects that ship with the package come the data's
masks, at the scale that the paper plans with.
"""

import json
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.bench.paper_protocol import MASS_SETS, MAX_CELLS, SUPPORT_FRICTION, draw_masses
from gridpush_drake.bench.public_data import find_masks, find_protocol
from gridpush_drake.errors import GridPushError
from gridpush_drake.objects.grid_object import GridObject, PhysicalPrior
from gridpush_drake.objects.mask import read_labels
from gridpush_drake.objects.object_file import find_shipped_object
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.push_constraints import PushConstraints
from gridpush_drake.planning.support_surface import SupportSurface

Array = NDArray[np.float64]

SHIPPED = (
    "claw_hammer", "combination_wrench", "open_book", "pliers", "snack_bag", "spray_bottle", "spring_clamp", "toolbox",
    "toothpaste_tube",
)  # fmt: skip
"""Objects that come with the package, beside the masks."""

PUSHED_SHIPPED = ("combination_wrench", "pliers", "toothpaste_tube")
"""Those of them that are pushed to goals, beside the masks: of other shapes than the masks have."""

METERS_PER_PIXEL = 0.53 / 640
"""Of the masks, m, unless the data say otherwise."""

PAIRS = 10
"""Of start and goal poses."""

TABLE_CENTER, TABLE_RADIUS = (0.63, 0.0), 0.5
"""Of the round table, m."""

PLACE_RADIUS = 0.28
"""Within which poses are drawn about the table's center, evenly, m: the widest object then hangs over by 45 mm."""

FINGER_RADIUS = 0.008
"""m."""

OVERHANG = 0.045
"""m by which cells may hang over the table's edge; the protocol's own poses make the widest object do so by 36 mm."""

FINGER_OVERHANG = 0.1
"""m by which the finger's center may be beyond the edge: it ends above the table, and pushes back what hangs over."""


@dataclass(frozen=True, eq=False)
class PlanningProtocol:
    """The protocol's numbers.

    Attributes:
        seed: of what was drawn.
        masks: files of the paper's objects by name.
        masses: mass of a cell of each label 1, 2, ..., kg, by mask and mass set.
        pairs: (10, 2, 3) start and goal poses, m and rad.
        surface: the round table.
        meters_per_pixel: of the masks, m.
    """

    seed: int
    masks: dict[str, Path]
    masses: dict[str, tuple[tuple[float, ...], ...]]
    pairs: Array
    surface: SupportSurface
    meters_per_pixel: float = METERS_PER_PIXEL

    @property
    def constraints(self) -> PushConstraints:
        """What pushes must keep clear of."""
        return PushConstraints(self.surface, edge_margin=-OVERHANG, finger_inset=-FINGER_OVERHANG)

    @property
    def mass_sets(self) -> int:
        """How many mass sets there are for each object."""
        return min(map(len, self.masses.values()), default=MASS_SETS)


@lru_cache(maxsize=4)
def make_planning_protocol(data: Path | None = None, seed: int = 0) -> PlanningProtocol:
    """Draws the protocol, and reads what the public data have of it.

    Args:
        data: folder of the paper's masks, with or without `protocol.json` beside them; None for the shipped objects.
        seed: of what is drawn.

    Returns:
        The protocol.

    Raises:
        GridPushError: there is no such folder, no mask in it, or `protocol.json` is not of its form.
    """
    masks = {} if data is None else find_masks(Path(data))
    masses = {name: draw_masses(name, read_labels(path), seed) for name, path in masks.items()}
    surface = SupportSurface.round(TABLE_CENTER, TABLE_RADIUS)
    drawn = PlanningProtocol(seed, masks, masses, draw_pairs(seed), surface)
    path = find_protocol(masks)
    return drawn if path is None else _read_protocol(path, drawn)


def draw_pairs(seed: int) -> Array:
    """Draws (`PAIRS`, 2, 3) start and goal poses on the table, m and rad."""
    rng = np.random.default_rng([seed, PAIRS])
    distance = PLACE_RADIUS * np.sqrt(rng.uniform(size=(PAIRS, 2)))
    bearing, heading = rng.uniform(-np.pi, np.pi, (2, PAIRS, 2))
    x, y = TABLE_CENTER
    return np.stack([x + distance * np.cos(bearing), y + distance * np.sin(bearing), heading], axis=-1)


def _read_protocol(path: Path, drawn: PlanningProtocol) -> PlanningProtocol:
    """The protocol with what `protocol.json` has in place of what was drawn."""
    try:
        content: Any = json.loads(path.read_text())
        planning = content["planning"]
        pairs = np.stack([np.array(planning[end], dtype=np.float64) for end in ("start", "goal")], axis=1)
        table = planning["table"]
        surface = SupportSurface.round(table["centre"], float(table["radius"]))
        masses = {str(name): tuple(map(tuple, sets)) for name, sets in content["masses_by_label"].items()}
        known = {name: masses.get(name, sets) for name, sets in drawn.masses.items()}
        scale = float(content["metres_per_pixel"]["real_and_planning"])
        return PlanningProtocol(drawn.seed, drawn.masks, known, pairs, surface, scale)
    except OSError as error:
        raise GridPushError(f"{path}: cannot be read: {error.strerror}; expected the paper's numbers") from error
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise GridPushError(
            f"{path}: expected JSON with masses_by_label, planning and metres_per_pixel ({error!r})"
        ) from error


def list_objects(protocol: PlanningProtocol, shipped: tuple[str, ...] = SHIPPED) -> list[str]:
    """Names of the masks and of the shipped objects."""
    return [*protocol.masks, *shipped]


@lru_cache(maxsize=32)
def read_planning_object(protocol: PlanningProtocol, name: str) -> GridObject:
    """An object by its name, with its parts. Raises ObjectError where there is none."""
    if name in protocol.masks:
        return GridObject.from_mask(
            protocol.masks[name], meters_per_pixel=protocol.meters_per_pixel, max_cells=MAX_CELLS,
            prior=PhysicalPrior(friction=SUPPORT_FRICTION),
        )  # fmt: skip
    return GridObject.from_yaml(find_shipped_object(name))


def hide_parts(obj: GridObject) -> GridObject:
    """The object as whoever learns sees it: one part."""
    return GridObject(obj.name, obj.p_BC, obj.cell_size, np.ones(obj.n, dtype=np.int64), obj.outline, obj.prior)


def make_hidden(protocol: PlanningProtocol, name: str, mass_set: int) -> CellParameters:
    """The hidden masses of a mass set: the protocol's for a mask, drawn by part for a shipped object."""
    obj = read_planning_object(protocol, name)
    if name in protocol.masks:
        return CellParameters.by_part(obj, dict(enumerate(protocol.masses[name][mass_set], start=1)), SUPPORT_FRICTION)
    return CellParameters.random(obj, protocol.seed + mass_set)
