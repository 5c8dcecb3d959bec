"""The paper's simulated protocol: hidden masses, pushes and splits (Song & Boularias, RSS 2020, VI.A).

It is drawn by seed for the objects that ship with the package, and read for the paper's own, which are masks of the
public data. Where the paper pushes with a square finger of 3 cm, a disc of 1.5 cm radius stands in for it here. Pushes
are numbered from the object's left to its right, the five on its upper side first.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.bench.public_data import find_masks, find_protocol
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.simulate import simulate
from gridpush_drake.dynamics.time_grid import make_path_times
from gridpush_drake.errors import GridPushError
from gridpush_drake.geometry.outline import OutlineEdges
from gridpush_drake.objects.grid_object import GridObject, PhysicalPrior
from gridpush_drake.objects.mask import read_labels
from gridpush_drake.objects.object_file import find_shipped_object, list_shipped_objects
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.pushes.push_log import ObservedPush, PushLog

Array = NDArray[np.float64]

MAX_CELLS = 127
METERS_PER_PIXEL = 0.001
"""Of the masks, m, unless the data say otherwise."""

MASS_SETS = 10
"""Drawn for each object."""

MASS_RANGE = (0.1, 5.0)
"""What the mass of a part's cells is drawn from, evenly, kg a cell."""

TRAINING = (1, 2, 3, 4, 5)
"""Numbers of pushes to learn from; the others of the ten are predicted."""

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
        masks: the paper's objects' files, by name; the other objects are shipped.
        masses: mass of a cell of each label 1, 2, ..., kg, by object and mass set.
        splits: by number of training pushes; mass set i goes with split i.
        meters_per_pixel: of the masks, m.
    """

    masks: dict[str, Path]
    masses: dict[str, tuple[tuple[float, ...], ...]]
    splits: dict[int, tuple[Split, ...]]
    meters_per_pixel: float = METERS_PER_PIXEL


@dataclass(frozen=True, eq=False)
class Case:
    """An object with one mass set, pushed ten times.

    Attributes:
        obj: as the identifier sees it: one part, and no prior but the defaults.
        log: the ten observed pushes.
    """

    obj: GridObject
    log: PushLog


def make_protocol(data: Path | str | None = None, seed: int = 0) -> Protocol:
    """Draws the protocol for the shipped objects, and reads what the public data have of it.

    Args:
        data: folder of the paper's masks, with or without `protocol.json` beside them; None for the shipped objects.
        seed: of what is drawn.

    Returns:
        The protocol.

    Raises:
        GridPushError: there is no such folder, no mask in it, or `protocol.json` is not of its form.
    """
    labels: dict[str, NDArray[Any]] = {
        name: GridObject.from_yaml(find_shipped_object(name)).labels for name in list_shipped_objects()
    }
    masks: dict[str, Path] = {}
    if data is not None:
        masks = find_masks(Path(data))
        labels = {name: read_labels(path) for name, path in masks.items()} | labels
    drawn = Protocol(masks, {name: draw_masses(name, seen, seed) for name, seen in labels.items()}, draw_splits(seed))
    path = find_protocol(masks)
    return drawn if path is None else _read_protocol(path, drawn)


def draw_masses(name: str, labels: NDArray[Any], seed: int) -> tuple[tuple[float, ...], ...]:
    """Draws an object's mass sets.

    Args:
        name: of the object; it changes what is drawn.
        labels: of its cells or pixels; 0 is no part.
        seed: of the draw.

    Returns:
        `MASS_SETS` times the mass of a cell of each label 1, 2, ..., kg.
    """
    rng = np.random.default_rng([seed, crc32(name.encode())])
    return tuple(map(tuple, rng.uniform(*MASS_RANGE, (MASS_SETS, int(labels.max()))).tolist()))


def draw_splits(seed: int, counts: Sequence[int] = TRAINING) -> dict[int, tuple[Split, ...]]:
    """Draws a split for each mass set and number of pushes to learn from."""
    rng = np.random.default_rng([seed, len(counts)])
    orders = {count: [rng.permutation(2 * PUSHES_PER_SIDE).tolist() for _ in range(MASS_SETS)] for count in counts}
    return {
        count: tuple(Split(tuple(order[:count]), tuple(sorted(order[count:]))) for order in some)
        for count, some in orders.items()
    }


def _read_protocol(path: Path, drawn: Protocol) -> Protocol:
    """The protocol with what `protocol.json` has in place of what was drawn."""
    try:
        content: Any = json.loads(path.read_text())
        masses = {str(name): tuple(map(tuple, sets)) for name, sets in content["masses_by_label"].items()}
        splits = {
            int(count): tuple(Split(tuple(split["train"]), tuple(split["test"])) for split in splits)
            for count, splits in content["splits"].items()
        }
        known = {name: masses.get(name, sets) for name, sets in drawn.masses.items()}
        return Protocol(drawn.masks, known, splits, float(content["metres_per_pixel"]["simulated"]))
    except OSError as error:
        raise GridPushError(f"{path}: cannot be read: {error.strerror}; expected the paper's numbers") from error
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
    prior = PhysicalPrior(friction=SUPPORT_FRICTION)
    mask, scale = protocol.masks.get(name), protocol.meters_per_pixel
    if mask is None:
        obj = replace(GridObject.from_yaml(find_shipped_object(name)), prior=prior)
        left, _, right, _ = obj.outline.bounds
        columns = round((right - left) / METERS_PER_PIXEL)
    else:
        obj = GridObject.from_mask(mask, meters_per_pixel=scale, max_cells=MAX_CELLS, prior=prior)
        columns = read_labels(mask).shape[1]
    masses = dict(enumerate(protocol.masses[name][mass_set], start=1))
    truth = CellParameters.by_part(obj, masses, SUPPORT_FRICTION)
    pushes = make_pushes(obj, columns)
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

    The center then lies on the outline grown by the radius: on a circle about a vertex or on a shifted edge.

    Args:
        edges: of the outline, body frame, m.
        x: of the disc's center, m, within the outline's extent.
        side: +1 to come from above (+y), -1 from below.
        radius: of the disc, m.

    Returns:
        y of the disc's center, m.
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
