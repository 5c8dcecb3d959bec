"""The paper's simulated protocol: its objects, hidden masses, pushes and splits (Song & Boularias, RSS 2020, VI.A).

Where the paper pushes with a square finger of 3 cm, a disc of 1.5 cm radius stands in for it here. Pushes are numbered
from the image's left to its right, the five on its upper side first.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.bench.shared_data import find_shared_data
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.simulate import simulate
from gridpush_drake.dynamics.time_grid import make_path_times
from gridpush_drake.errors import GridPushError
from gridpush_drake.grid.mask_image import read_labels
from gridpush_drake.grid.object import GridObject
from gridpush_drake.grid.outline import OutlineEdges
from gridpush_drake.grid.parameters import CellParameters
from gridpush_drake.grid.prior import PhysicalPrior
from gridpush_drake.pushes.log import ObservedPush, PushLog

Array = NDArray[np.float64]

MASKS = "masks"
"""Their folder among the public data."""

MAX_CELLS = 127
PUSHES_PER_SIDE = 5
SPEED = 0.1
"""m/s."""

DURATION = 2.0
"""s."""

FINGER_RADIUS = 0.015
"""m."""

OBSERVED_EVERY = 0.1
"""s between observations of the pose."""

SUPPORT_FRICTION = 0.4
"""Of every cell, in the simulated truth; it is also the identifier's prior."""


@dataclass(frozen=True)
class Split:
    """Indices of the pushes to learn from and of those to predict."""

    train: tuple[int, ...]
    test: tuple[int, ...]


@dataclass(frozen=True)
class Protocol:
    """The protocol's numbers.

    Attributes:
        folder: where the masks are, `<object>_label.pgm`.
        masses: mass of a cell of each label 1, 2, ..., kg, by object and mass set.
        splits: by number of training pushes; mass set i goes with split i.
        metres_per_pixel: of the masks, m.
    """

    folder: Path
    masses: dict[str, tuple[tuple[float, ...], ...]]
    splits: dict[int, tuple[Split, ...]]
    metres_per_pixel: float


@dataclass(frozen=True, eq=False)
class Case:
    """An object with one mass set, pushed ten times.

    Attributes:
        obj: as the identifier sees it: one part, and no prior but the defaults.
        log: the ten observed pushes.
    """

    obj: GridObject
    log: PushLog


def read_protocol(folder: Path | str | None = None) -> Protocol:
    """Reads `protocol.json`.

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
        masses = {str(name): tuple(map(tuple, sets)) for name, sets in content["masses_by_label"].items()}
        splits = {
            int(count): tuple(Split(tuple(split["train"]), tuple(split["test"])) for split in splits)
            for count, splits in content["splits"].items()
        }
        return Protocol(folder, masses, splits, float(content["metres_per_pixel"]["simulated"]))
    except OSError as error:
        raise GridPushError(f"{path}: cannot be read: {error.strerror}; expected the paper's masks there") from error
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise GridPushError(
            f"{path}: expected JSON with masses_by_label, splits and metres_per_pixel.simulated ({error!r})"
        ) from error


def make_case(protocol: Protocol, name: str, mass_set: int) -> Case:
    """Simulates the ten pushes of an object with hidden masses.

    Args:
        protocol: the protocol.
        name: of the object.
        mass_set: number of the mass set.

    Returns:
        The observed pushes, and the object without its labels.

    Raises:
        GridPushError: the protocol has no such object.
    """
    if name not in protocol.masses:
        raise GridPushError(f"objects: {name!r} is not in the protocol; expected one of {', '.join(protocol.masses)}")
    mask = protocol.folder / f"{name}_label.pgm"
    prior = PhysicalPrior(friction=SUPPORT_FRICTION)
    obj = GridObject.from_mask(mask, metres_per_pixel=protocol.metres_per_pixel, max_cells=MAX_CELLS, prior=prior)
    masses = dict(enumerate(protocol.masses[name][mass_set], start=1))
    truth = CellParameters.by_part(obj, masses, SUPPORT_FRICTION)
    pushes = make_pushes(obj, columns=read_labels(mask).shape[1])
    seen = [_observe(obj, truth, f"push_{i}", push) for i, push in enumerate(pushes)]
    plain = GridObject(name, obj.p_BC, obj.cell_size, np.ones(obj.n, dtype=np.int64), obj.outline, prior)
    return Case(plain, PushLog(tuple(seen), source=f"{name}, mass set {mass_set}"))


def make_pushes(obj: GridObject, columns: int) -> list[Push]:
    """The ten pushes, for an object at the pose (0, 0, 0): along -y onto the upper side, then along +y onto the lower.

    Args:
        obj: the object.
        columns: of its image, from its first to its last pixel.

    Returns:
        The pushes; the disc touches the outline at their start.
    """
    left, _, right, _ = obj.outline.bounds
    step = columns // PUSHES_PER_SIDE
    places = columns // 2 + step * (np.arange(PUSHES_PER_SIDE) - PUSHES_PER_SIDE // 2)
    x = left + (places + 0.5) * (right - left) / columns
    starts = [(side, np.array([xi, place_disc(obj.edges, xi, side, FINGER_RADIUS)])) for side in (1, -1) for xi in x]
    return [Push(start, np.array([0.0, -side * SPEED]), DURATION, FINGER_RADIUS) for side, start in starts]


def place_disc(edges: OutlineEdges, x: float, side: int, radius: float) -> float:
    """Where a disc that comes along y first touches the outline.

    The centre then lies on the outline grown by the radius: on a circle about a vertex or on a shifted edge.

    Args:
        edges: of the outline, body frame, m.
        x: of the disc's centre, m, within the outline's extent.
        side: +1 to come from above (+y), -1 from below.
        radius: of the disc, m.

    Returns:
        y of the disc's centre, m.
    """
    flip = np.array([1.0, side])
    start, end = edges.start * flip, edges.end * flip
    offset = x - start[:, 0]
    near = np.abs(offset) <= radius
    heights = [start[near, 1] + np.sqrt(radius**2 - offset[near] ** 2)]
    along = end - start
    normal = np.column_stack([-along[:, 1], along[:, 0]]) / np.linalg.norm(along, axis=1, keepdims=True)
    normal *= np.where(normal[:, 1:] < 0, -1.0, 1.0)
    steep = along[:, 0] == 0
    share = (offset - radius * normal[:, 0]) / np.where(steep, 1.0, along[:, 0])
    meets = ~steep & (share >= 0) & (share <= 1)
    heights.append(start[meets, 1] + radius * normal[meets, 1] + share[meets] * along[meets, 1])
    return float(side * np.concatenate(heights).max())


def _observe(obj: GridObject, truth: CellParameters, name: str, push: Push) -> ObservedPush:
    times = make_path_times(push)
    simulation = simulate(obj, truth, push, times=times, regime="inertial")
    every = round(len(times[1:]) * OBSERVED_EVERY / DURATION)
    return ObservedPush(name, push, simulation.poses[0], times[every::every], simulation.poses[every::every])
