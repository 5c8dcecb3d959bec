"""The planning protocol: objects, hidden masses, ten start and goal poses, a round table (Song & Boularias, RSS 2020).

The masks are read at the scale that the paper plans with. To them come objects that ship with the package.
"""

import json
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.bench.paper_protocol import MASKS, MAX_CELLS, SUPPORT_FRICTION
from gridpush_drake.bench.shared_data import find_shared_data
from gridpush_drake.errors import GridPushError
from gridpush_drake.grid.object import GridObject
from gridpush_drake.grid.object_file import find_shipped_object
from gridpush_drake.grid.parameters import CellParameters
from gridpush_drake.grid.prior import PhysicalPrior
from gridpush_drake.planning.push_constraints import PushConstraints
from gridpush_drake.planning.surface import SupportSurface

Array = NDArray[np.float64]

SHIPPED = (
    "claw_hammer", "combination_wrench", "open_book", "pliers", "snack_bag", "spray_bottle", "spring_clamp", "toolbox",
    "toothpaste_tube",
)  # fmt: skip
"""Objects that come with the package, beside the masks."""

PUSHED_SHIPPED = ("combination_wrench", "pliers", "toothpaste_tube")
"""Those of them that are pushed to goals, beside the masks: of other shapes than the masks have."""

FINGER_RADIUS = 0.008
"""m."""

OVERHANG = 0.045
"""m by which cells may hang over the table's edge; the protocol's own poses make the widest object do so by 36 mm."""

FINGER_OVERHANG = 0.1
"""m by which the finger's centre may be beyond the edge: it ends above the table, and pushes back what hangs over."""


@dataclass(frozen=True, eq=False)
class PlanningProtocol:
    """The protocol's numbers.

    Attributes:
        folder: of the masks.
        masses: mass of a cell of each label 1, 2, ..., kg, by mask and mass set.
        pairs: (10, 2, 3) start and goal poses, m and rad.
        surface: the round table.
        metres_per_pixel: of the masks, m.
    """

    folder: Path
    masses: dict[str, list[list[float]]]
    pairs: Array
    surface: SupportSurface
    metres_per_pixel: float

    @property
    def constraints(self) -> PushConstraints:
        """What pushes must keep clear of."""
        return PushConstraints(self.surface, edge_margin=-OVERHANG, finger_inset=-FINGER_OVERHANG)

    @property
    def mass_sets(self) -> int:
        """How many mass sets there are for each mask."""
        return min(len(sets) for sets in self.masses.values())


@lru_cache(maxsize=4)
def read_planning_protocol(folder: Path | None = None) -> PlanningProtocol:
    """Reads the planning part of `protocol.json`.

    Args:
        folder: that holds it and the masks; found beside the repository where None.

    Returns:
        The protocol.

    Raises:
        GridPushError: the folder or the file is not there, or the file is not of its form.
    """
    folder = find_shared_data() / MASKS if folder is None else Path(folder)
    path = folder / "protocol.json"
    try:
        content: Any = json.loads(path.read_text())
        planning = content["planning"]
        pairs = np.stack([np.array(planning[end], dtype=np.float64) for end in ("start", "goal")], axis=1)
        table = planning["table"]
        surface = SupportSurface.round(table["centre"], float(table["radius"]))
        masses = {str(name): list(map(list, sets)) for name, sets in content["masses_by_label"].items()}
        return PlanningProtocol(folder, masses, pairs, surface, float(content["metres_per_pixel"]["real_and_planning"]))
    except OSError as error:
        raise GridPushError(f"{path}: cannot be read: {error.strerror}; expected the paper's masks there") from error
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise GridPushError(
            f"{path}: expected JSON with masses_by_label, planning and metres_per_pixel ({error!r})"
        ) from error


def list_objects(protocol: PlanningProtocol, shipped: tuple[str, ...] = SHIPPED) -> list[str]:
    """Names of the masks and of the shipped objects."""
    return [*protocol.masses, *shipped]


@lru_cache(maxsize=32)
def read_planning_object(protocol: PlanningProtocol, name: str) -> GridObject:
    """An object by its name, with its parts. Raises ObjectError where there is none."""
    if name in protocol.masses:
        return GridObject.from_mask(
            protocol.folder / f"{name}_label.pgm", metres_per_pixel=protocol.metres_per_pixel, max_cells=MAX_CELLS,
            prior=PhysicalPrior(friction=SUPPORT_FRICTION),
        )  # fmt: skip
    return GridObject.from_yaml(find_shipped_object(name))


def hide_parts(obj: GridObject) -> GridObject:
    """The object as whoever learns sees it: one part."""
    return GridObject(obj.name, obj.p_BC, obj.cell_size, np.ones(obj.n, dtype=np.int64), obj.outline, obj.prior)


def make_hidden(protocol: PlanningProtocol, name: str, mass_set: int) -> CellParameters:
    """The hidden masses of a mass set: the protocol's for a mask, drawn by part for a shipped object."""
    obj = read_planning_object(protocol, name)
    if name in protocol.masses:
        return CellParameters.by_part(obj, dict(enumerate(protocol.masses[name][mass_set], start=1)), SUPPORT_FRICTION)
    return CellParameters.random(obj, mass_set)
