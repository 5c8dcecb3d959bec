"""The paper's protocols: what is hidden, pushed, drawn and split (Song & Boularias, RSS 2020, VI).

They are drawn by seed for the objects that ship with the package, and read for the paper's own:
masks NAME_label.pgm anywhere below a clone of MASK_SOURCE, with `protocol.json` beside them, where
there is one, in place of what is drawn.

    simulated   hidden masses, ten pushes and their splits (VI.A). Where the paper pushes with a
    square finger of 3 cm,
                a disc of 1.5 cm radius stands in for it. Pushes are numbered from the object's left
                to its right, the five on its upper side first.
    planning    hidden masses, ten start and goal poses, a round table; masks at the scale that the
    paper plans with.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.dynamics.push import Push, make_path_times
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import GridPushError
from gridpush_drake.geometry.polygons import OutlineEdges
from gridpush_drake.geometry.se2 import Array, make_direction
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject, PhysicalPrior
from gridpush_drake.objects.mask import read_labels
from gridpush_drake.objects.object_file import (
    PartMaterial,
    find_shipped_object,
    list_shipped_objects,
)
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.push_constraints import PushConstraints
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.pushes.push_log import ObservedPush, PushLog

MASK_SOURCE = "GitHub changkyu/rss2020_changkyu"
"""Where the paper's masks are."""

MASK_ENDING = "_label.pgm"
"""Ending of the name of a mask."""

PROTOCOL_FILE = "protocol.json"
"""Name of the file beside the masks that has the paper's numbers."""

MAX_CELLS = 127
"""Greatest number of cells of an object that is made of a mask."""

METERS_PER_PIXEL = 0.001
"""Width of a mask's pixel in simulations, m, unless the data say otherwise."""

PLANNING_METERS_PER_PIXEL = 0.53 / 640
"""Width of a mask's pixel where the masks stand for real objects, m, unless the data say
otherwise."""

MASS_SETS = 10
"""Number of mass sets that are drawn for each object."""

MASS_RANGE = (0.1, 5.0)
"""Least and greatest mass of a cell, kg; the simulated protocol draws it evenly, for each part."""

TRAINING_PUSH_COUNTS = (1, 2, 3, 4, 5)
"""Numbers of pushes to learn from; the others of the ten are predicted."""

PUSHES_PER_SIDE = 5
"""Number of pushes onto each side of the object."""

PUSH_SPEED = 0.1
"""Speed of a simulated push, m/s."""

PUSH_DURATION = 2.0
"""Duration of a simulated push, s."""

FINGER_RADIUS = 0.015
"""Radius of the finger that makes it, m."""

OBSERVED_EVERY = 0.1
"""Time between two observations of the pose, s."""

SUPPORT_FRICTION = 0.4
"""Friction of every cell in the simulated truth; it is also the identifier's prior."""

PUSHED_SHIPPED = ("combination_wrench", "pliers", "toothpaste_tube")
"""Shipped objects that are pushed to goals, beside the masks: of other shapes than the masks
have."""

POSE_PAIR_COUNT = 10
"""Number of pairs of start and goal poses."""

TABLE_CENTER = (0.63, 0.0)
"""Center of the round table, m."""

TABLE_RADIUS = 0.5
"""Radius of the round table, m."""

PLACE_RADIUS = 0.28
"""Distance from the table's center within which poses are drawn evenly, m: the widest object then
hangs over by 45 mm."""

MAX_CELL_OVERHANG = 0.045
"""Distance by which cells may hang over the table's edge, m; the protocol's own poses make the
widest object do so by 36 mm."""

FINGER_OVERHANG = 0.1
"""Distance by which the finger's center may be beyond the table's edge, m: it ends above the table,
and pushes back what hangs over."""

POSITION_STD = 0.0005
"""Standard deviation of seen positions, per axis, m."""

ANGLE_STD = 0.003
"""Standard deviation of seen angles, rad."""

Drawn = TypeVar("Drawn", bound="Protocol | PlanningProtocol")

Masses = dict[str, tuple[tuple[float, ...], ...]]
"""Masses of the cells of each label 1, 2, ..., kg, by object and mass set."""


def check_folder(data: Path, expected: str) -> None:
    """Checks that a folder is there.

    Args:
        data: the folder.
        expected: what it should be, for the error.

    Raises:
        GridPushError: it is not there.
    """
    if not data.is_dir():
        raise GridPushError(f"{data}: is no folder; expected {expected}")


def find_masks(data: Path) -> dict[str, Path]:
    """Finds the paper's masks anywhere below a folder, by the objects' names.

    Raises:
        GridPushError: there is no such folder, no mask in it, or two of one name.
    """
    check_folder(data, f"a clone of {MASK_SOURCE}")
    masks: dict[str, Path] = {}
    for path in sorted(data.rglob(f"*{MASK_ENDING}")):
        name = path.name.removesuffix(MASK_ENDING)
        if name in masks:
            raise GridPushError(
                f"{path}: is a second mask of {name}, beside {masks[name]}; expected one of each"
            )
        masks[name] = path
    if not masks:
        raise GridPushError(
            f"{data}: holds no mask; expected files NAME{MASK_ENDING}, as of {MASK_SOURCE}"
        )
    return masks


@dataclass(frozen=True)
class Split:
    """A division of an object's pushes.

    Attributes:
        train: numbers of the pushes to learn from.
        test: numbers of those to predict.
    """

    train: tuple[int, ...]
    test: tuple[int, ...]


@dataclass(frozen=True)
class Protocol:
    """The simulated protocol's numbers.

    Attributes:
        masks: the paper's objects' files, by name; the other objects are shipped.
        masses: mass of a cell of each label 1, 2, ..., kg, by object and mass set.
        splits: divisions of the pushes by the number of training pushes; mass set i goes with
            split i.
        meters_per_pixel: width of a mask's pixel, m.
    """

    masks: dict[str, Path]
    masses: Masses
    splits: dict[int, tuple[Split, ...]]
    meters_per_pixel: float = METERS_PER_PIXEL


@dataclass(frozen=True, eq=False)
class ProtocolCase:
    """An object with one mass set, pushed ten times, as the identifier sees it.

    It is of one part, and nothing is known of it but the defaults.

    Attributes:
        obj: the object.
        log: the pushes.
    """

    obj: GridObject
    log: PushLog


@lru_cache(maxsize=4)
def make_protocol(data: Path | None = None, seed: int = 0) -> Protocol:
    """The simulated protocol: of the shipped objects, and of the masks in a folder.

    Raises:
        GridPushError: there is no such folder, no mask in it, or `protocol.json` is not of its
            form.
    """
    masks = {} if data is None else find_masks(data)
    labels: dict[str, NDArray[Any]] = {
        name: read_labels(path).labels for name, path in masks.items()
    }
    labels |= {
        name: GridObject.from_yaml(find_shipped_object(name)).labels
        for name in list_shipped_objects()
    }
    drawn = Protocol(
        masks,
        {name: draw_masses(name, seen, seed) for name, seen in labels.items()},
        draw_splits(seed),
    )

    def read(content: Any) -> Protocol:
        splits = {
            int(count): tuple(
                Split(tuple(split["train"]), tuple(split["test"])) for split in splits
            )
            for count, splits in content["splits"].items()
        }
        scale = float(content["metres_per_pixel"]["simulated"])
        return Protocol(masks, _read_masses(content, drawn.masses), splits, scale)

    return _read_document(drawn, "masses_by_label, splits and metres_per_pixel.simulated", read)


def draw_masses(name: str, labels: NDArray[Any], seed: int) -> tuple[tuple[float, ...], ...]:
    """Draws MASS_SETS times the masses of the cells of an object, kg.

    Args:
        name: name of the object.
        labels: labels 1, 2, ... of its cells or pixels.
        seed: seed of the protocol.
    """
    rng = np.random.default_rng([seed, crc32(name.encode())])
    drawn = rng.uniform(*MASS_RANGE, (MASS_SETS, int(labels.max())))
    return tuple(map(tuple, drawn.tolist()))


def draw_splits(seed: int) -> dict[int, tuple[Split, ...]]:
    """Draws a split for each mass set and number of pushes to learn from."""
    rng = np.random.default_rng([seed, len(TRAINING_PUSH_COUNTS)])
    orders = {
        count: [rng.permutation(2 * PUSHES_PER_SIDE).tolist() for _ in range(MASS_SETS)]
        for count in TRAINING_PUSH_COUNTS
    }
    return {
        count: tuple(Split(tuple(order[:count]), tuple(sorted(order[count:]))) for order in some)
        for count, some in orders.items()
    }


def _read_masses(content: Any, drawn: Masses) -> Masses:
    """Reads the masses of a document; those that it does not have are as drawn."""
    return {
        name: tuple(map(tuple, content["masses_by_label"].get(name, sets)))
        for name, sets in drawn.items()
    }


def _read_document(drawn: Drawn, expected: str, read: Callable[[Any], Drawn]) -> Drawn:
    """Reads `protocol.json`; returns what was drawn where there is none.

    Args:
        drawn: what was drawn.
        expected: names of the document's keys, for the error.
        read: makes the protocol of the document.

    Raises:
        GridPushError: the document cannot be read, or is of another form.
    """
    beside = (mask.with_name(PROTOCOL_FILE) for mask in drawn.masks.values())
    path = next((path for path in beside if path.is_file()), None)
    if path is None:
        return drawn
    try:
        return read(json.loads(path.read_text()))
    except OSError as error:
        raise GridPushError(
            f"{path}: cannot be read: {error.strerror}; expected the paper's numbers"
        ) from error
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise GridPushError(f"{path}: expected JSON with {expected} ({error!r})") from error


def make_case(
    protocol: Protocol,
    name: str,
    mass_set: int,
    show_parts: bool = False,
    density_spread: float | None = None,
) -> ProtocolCase:
    """Simulates the ten pushes of an object with one of its hidden mass sets.

    Args:
        protocol: the protocol.
        name: name of the object.
        mass_set: number of its mass set.
        show_parts: whether whoever learns sees which cells are of one part, as by their colors.
        density_spread: geometric standard deviation of the densities that whoever sees the parts is
            told of them; None to tell none.

    Raises:
        GridPushError: the protocol has no such object.
    """
    if name not in protocol.masses:
        raise GridPushError(
            f"objects: {name!r} is not in the protocol; expected one of "
            f"{', '.join(protocol.masses)}"
        )
    masses = dict(enumerate(protocol.masses[name][mass_set], start=1))
    prior = PhysicalPrior(friction=SUPPORT_FRICTION, uniform_parts=show_parts)
    if density_spread is not None:
        rng = np.random.default_rng([mass_set, crc32(name.encode())])
        prior = replace(prior, materials=tell_materials(masses, density_spread, rng))
    obj = replace(read_object(protocol, name), name=name, prior=prior)
    mask = protocol.masks.get(name)
    columns = None if mask is None else read_labels(mask).labels.shape[1]
    truth = CellParameters.by_part(obj, masses, SUPPORT_FRICTION)
    log = push_object(obj, truth, columns)
    seen = obj if show_parts else hide_parts(obj)
    return ProtocolCase(seen, replace(log, source=f"{name}, mass set {mass_set}"))


def tell_materials(
    masses: Mapping[int, float], spread: float, rng: np.random.Generator
) -> tuple[PartMaterial, ...]:
    """Tells the densities of an object's parts, each wrong by a factor of its own.

    Args:
        masses: mass of a cell of each label, kg.
        spread: geometric standard deviation of the factors, which is told, too.
        rng: draws them.
    """
    return tuple(
        PartMaterial(
            label=label,
            name=f"part {label}",
            density=mass * float(spread ** rng.standard_normal()),
            spread=spread,
        )
        for label, mass in masses.items()
    )


def push_object(obj: GridObject, truth: CellParameters, columns: int | None = None) -> PushLog:
    """Simulates the ten pushes of an object.

    Args:
        obj: the object.
        truth: its masses and frictions.
        columns: number of columns of its picture; as many as it is METERS_PER_PIXEL wide where
            None.
    """
    if columns is None:
        left, _, right, _ = obj.outline.bounds
        columns = round((right - left) / METERS_PER_PIXEL)
    pushes = make_pushes(obj, columns)
    seen = [_observe(obj, truth, f"push_{i}", push) for i, push in enumerate(pushes)]
    return PushLog(tuple(seen))


def make_pushes(obj: GridObject, columns: int) -> list[Push]:
    """Makes the ten pushes of an object at the pose (0, 0, 0).

    The first ones go along -y onto the upper side, the others along +y onto the lower side. The
    disc touches the outline when they begin.

    Args:
        obj: the object.
        columns: number of columns of the object's picture, from its first to its last pixel.
    """
    left, _, right, _ = obj.outline.bounds
    step = columns // PUSHES_PER_SIDE
    places = columns // 2 + step * (np.arange(PUSHES_PER_SIDE) - PUSHES_PER_SIDE // 2)
    x = left + (places + 0.5) * (right - left) / columns
    starts = [
        (side, np.array([xi, place_disc(obj.edges, xi, side, FINGER_RADIUS)]))
        for side in (1, -1)
        for xi in x
    ]
    return [
        Push(start, np.array([0.0, -side * PUSH_SPEED]), PUSH_DURATION, FINGER_RADIUS)
        for side, start in starts
    ]


def place_disc(edges: OutlineEdges, x: float, side: int, radius: float) -> float:
    """Finds where a disc that comes along y touches the outline.

    Its center then lies on the outline grown by the radius: on a circle about a vertex or on a
    shifted edge.

    Args:
        edges: the outline.
        x: x of the disc's center, m.
        side: 1 where the disc comes from above, -1 where it comes from below.
        radius: radius of the disc, m.

    Returns:
        y of the disc's center, m.
    """
    flip = np.array([1.0, side])
    start = edges.start * flip
    end = edges.end * flip
    offset = x - start[:, 0]
    near = np.abs(offset) <= radius
    heights = [start[near, 1] + np.sqrt(radius**2 - offset[near] ** 2)]
    along = end - start
    normal = np.column_stack([-along[:, 1], along[:, 0]]) / np.linalg.norm(
        along, axis=1, keepdims=True
    )
    normal *= np.where(normal[:, 1:] < 0, -1.0, 1.0)
    steep = along[:, 0] == 0
    fraction = (offset - radius * normal[:, 0]) / np.where(steep, 1.0, along[:, 0])
    meets = ~steep & (fraction >= 0) & (fraction <= 1)
    heights.append(start[meets, 1] + radius * normal[meets, 1] + fraction[meets] * along[meets, 1])
    return float(side * np.concatenate(heights).max())


def _observe(obj: GridObject, truth: CellParameters, name: str, push: Push) -> ObservedPush:
    times = make_path_times(push, "inertial")
    simulation = simulate(Model(obj, truth), push, times=times, regime="inertial")
    every = round(len(times[1:]) * OBSERVED_EVERY / PUSH_DURATION)
    return ObservedPush(
        name, push, simulation.poses[0], times[every::every], simulation.poses[every::every]
    )


@dataclass(frozen=True, eq=False)
class PlanningProtocol:
    """The planning protocol's numbers.

    Attributes:
        seed: seed of what was drawn.
        masks: files of the paper's objects by name.
        masses: mass of a cell of each label 1, 2, ..., kg, by mask and mass set.
        pairs: (10, 2, 3) start and goal poses, m and rad.
        surface: the round table.
        meters_per_pixel: width of a mask's pixel, m.
    """

    seed: int
    masks: dict[str, Path]
    masses: Masses
    pairs: Array
    surface: SupportSurface
    meters_per_pixel: float = PLANNING_METERS_PER_PIXEL

    @property
    def constraints(self) -> PushConstraints:
        """The rules that pushes must keep."""
        return PushConstraints(
            self.surface, edge_margin=-MAX_CELL_OVERHANG, finger_inset=-FINGER_OVERHANG
        )

    @property
    def mass_sets(self) -> int:
        """The number of mass sets of each object."""
        return min(map(len, self.masses.values()), default=MASS_SETS)


@lru_cache(maxsize=4)
def make_planning_protocol(data: Path | None = None, seed: int = 0) -> PlanningProtocol:
    """Makes the planning protocol of the shipped objects and of the masks in a folder.

    Args:
        data: the folder; None without masks.
        seed: seed of what is drawn.

    Raises:
        GridPushError: the folder or its `protocol.json` cannot be read.
    """
    masks = {} if data is None else find_masks(data)
    masses = {
        name: draw_masses(name, read_labels(path).labels, seed) for name, path in masks.items()
    }
    surface = SupportSurface.round(TABLE_CENTER, TABLE_RADIUS)
    drawn = PlanningProtocol(seed, masks, masses, draw_pairs(seed), surface)

    def read(content: Any) -> PlanningProtocol:
        planning = content["planning"]
        pairs = np.stack(
            [np.array(planning[end], dtype=np.float64) for end in ("start", "goal")], axis=1
        )
        table = planning["table"]
        surface = SupportSurface.round(table["centre"], float(table["radius"]))
        scale = float(content["metres_per_pixel"]["real_and_planning"])
        return PlanningProtocol(
            seed=seed,
            masks=masks,
            masses=_read_masses(content, masses),
            pairs=pairs,
            surface=surface,
            meters_per_pixel=scale,
        )

    return _read_document(drawn, "masses_by_label, planning and metres_per_pixel", read)


def draw_pairs(seed: int) -> Array:
    """Draws (`POSE_PAIR_COUNT`, 2, 3) start and goal poses on the table, m and rad."""
    rng = np.random.default_rng([seed, POSE_PAIR_COUNT])
    distance = PLACE_RADIUS * np.sqrt(rng.uniform(size=(POSE_PAIR_COUNT, 2)))
    bearing, heading = rng.uniform(-np.pi, np.pi, (2, POSE_PAIR_COUNT, 2))
    places = TABLE_CENTER + distance[..., None] * make_direction(bearing)
    return np.concatenate([places, heading[..., None]], axis=-1)


def list_objects(protocol: PlanningProtocol, shipped: Sequence[str] | None = None) -> list[str]:
    """Lists the names of the masks and of shipped objects, of all of these where None."""
    return [*protocol.masks, *(list_shipped_objects() if shipped is None else shipped)]


def read_object(protocol: Protocol | PlanningProtocol, name: str) -> GridObject:
    """Reads an object by its name, with its parts. Raises ObjectError where there is none."""
    if name in protocol.masks:
        return GridObject.from_mask(
            protocol.masks[name],
            meters_per_pixel=protocol.meters_per_pixel,
            max_cells=MAX_CELLS,
            prior=PhysicalPrior(friction=SUPPORT_FRICTION),
        )
    return GridObject.from_yaml(find_shipped_object(name))


read_planning_object = lru_cache(maxsize=32)(read_object)
"""Reads an object of a planning protocol; each file is read only once."""


def hide_parts(obj: GridObject) -> GridObject:
    """Returns the object as whoever learns sees it: of one part."""
    return replace(obj, labels=np.ones(obj.n, dtype=np.int64))


def add_pose_noise(pose: Array, rng: np.random.Generator) -> Array:
    """Draws a pose (3,) as it is seen, m and rad."""
    return pose + np.array([POSITION_STD, POSITION_STD, ANGLE_STD]) * rng.standard_normal(3)


def know_friction(obj: GridObject, low: float, high: float) -> GridObject:
    """Returns the object with a friction that is known to be within a range, and an unknown weight.

    The prior of the friction is the geometric mean of its bounds.
    """
    middle = float(np.sqrt(low * high))
    prior = replace(
        obj.prior, total_mass=None, friction=middle, friction_min=low, friction_max=high
    )
    return replace(obj, prior=prior)


def make_hidden(protocol: PlanningProtocol, name: str, mass_set: int) -> CellParameters:
    """Makes the hidden masses of a mass set.

    They are the protocol's for a mask, and drawn by part for a shipped object.
    """
    obj = read_planning_object(protocol, name)
    if name in protocol.masks:
        masses = dict(enumerate(protocol.masses[name][mass_set], start=1))
        return CellParameters.by_part(obj, masses, SUPPORT_FRICTION)
    return CellParameters.random(obj, protocol.seed + mass_set)
