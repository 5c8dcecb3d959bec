"""Random bodies of many kinds, pushed in our own simulator: what load hypotheses are judged on.

* TOOLS_KIND: two to four pieces, boxes and ovals, in a row, each of another weight, in the paper's
  simulated protocol (`bench.data.protocol`).
* PATCHES_KIND: a box or an oval, on which one to three patches have other weights; the same
protocol.
* EVEN_KIND: outlines of tools that bear evenly.
* BOWLS_KIND, RINGS_KIND, RIMS_KIND: plates and tools whose load is gathered in the middle, in a
ring about it, or
  out at the rim.

The last four are pushed at random places, and their poses are seen with noise. The outlines are
none of the shipped objects.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import shapely
from numpy.typing import ArrayLike
from shapely import Point, Polygon, affinity

from gridpush_drake.bench.data.protocol import (
    SUPPORT_FRICTION,
    add_pose_noise,
    hide_parts,
    push_object,
)
from gridpush_drake.bench.worlds.plant import draw_push
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject, PhysicalPrior
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.pushes.push_log import ObservedPush, PushLog

TOOLS_KIND = "tools"
"""Kind of a body of pieces in a row."""

PATCHES_KIND = "patches"
"""Kind of a body with patches of other weights."""

EVEN_KIND = "even"
"""Kind of a body that bears evenly."""

BOWLS_KIND = "bowls"
"""Kind of a body whose load is gathered in the middle."""

RINGS_KIND = "rings"
"""Kind of a body whose load lies in a ring about the middle."""

RIMS_KIND = "rims"
"""Kind of a body whose load lies at the rim."""

BY_PART = (TOOLS_KIND, PATCHES_KIND)
"""Kinds of bodies of several weights, which are pushed as in the paper's simulated protocol."""

MAX_CELLS = 127
"""Greatest number of cells of a body, as in the paper's protocol."""

PART_COUNT_RANGE = (2, 4)
"""Least and greatest number of parts of a body of several weights."""

MIN_FRACTION = 0.05
"""Smallest fraction of the cells that a part may have."""

MAX_FRACTION = 0.6
"""Largest fraction of the cells that a part may have where there are more than two."""

MASS_RATIO = (2.0, 40.0)
"""Least and greatest ratio of the heaviest part's cells to the lightest one's. Its logarithm is
drawn evenly."""

PIECE_LENGTH = (0.03, 0.25)
"""Least and greatest length of a tool's piece along the tool, m; drawn evenly by its logarithm."""

PIECE_WIDTH = (0.02, 0.14)
"""Least and greatest width of a tool's piece, m; drawn evenly by its logarithm."""

PIECE_OVERLAP = 0.1
"""Fraction of a piece's length by which the next piece overlaps it."""

OVAL_PROBABILITY = 0.3
"""Probability that a piece is an oval and not a box."""

SHIFT_PROBABILITY = 0.4
"""Probability that a piece lies off the tool's axis."""

MAX_SHIFT = 0.4
"""Greatest distance of such a piece from the axis, as a fraction of its width."""

PLATE_OVAL = 0.5
"""Probability that a plate or a patch is an oval and not a box."""

PLATE_SIZE = (0.1, 0.25)
"""Least and greatest length and width of a plate, m."""

PATCH_SIZE = (0.2, 0.9)
"""Least and greatest size of a patch, as a fraction of the plate's; drawn evenly by its
logarithm."""

TOOL_FRACTION = 0.3
"""Probability that a round load lies on a tool, and not on a plate."""

BOWL_RADIUS = (0.35, 0.7)
"""Least and greatest radius at which a bowl's load has fallen off, radii of gyration."""

RING_RADIUS = (0.6, 1.1)
"""Least and greatest radius of a ring, radii of gyration."""

RING_WIDTH = 0.12
"""Standard deviation of a ring's profile, radii of gyration."""

RIM_WIDTH = 0.25
"""Standard deviation of a rim's profile, radii of gyration."""

LEAST_LOAD = 1e-3
"""Load of the cells that bear next to nothing, beside the greatest one."""

CONTACT_FRICTION = 0.4
"""Friction of the pusher on a body whose load is round."""

POINT_PATCH_FRACTION = 0.2
"""On what part of its side a cell of a round load touches the table, see `CellParameters`."""

PUSHER_RADIUS = 0.008
"""Radius of the pusher of random pushes, m."""

OBSERVATION_COUNT = 5
"""Number of poses that are seen of a random push after its first one."""

SUBSTEP_COUNT = 20
"""Number of steps that a random push is simulated in between two of them."""


@dataclass(frozen=True, eq=False)
class RandomBody:
    """A body and its pushes.

    Attributes:
        obj: the object as whoever learns sees it.
        truth: its masses and frictions.
        training: pushes to learn from.
        held_out: pushes that are held out.
    """

    obj: GridObject
    truth: CellParameters
    training: PushLog
    held_out: PushLog


def draw_tool(rng: np.random.Generator) -> GridObject:
    """Draws a tool of pieces in a row, each a part."""
    while True:
        pieces = []
        x = 0.0
        for _ in range(rng.integers(PART_COUNT_RANGE[0], PART_COUNT_RANGE[1] + 1)):
            length, width = np.exp(rng.uniform(*np.log(np.transpose([PIECE_LENGTH, PIECE_WIDTH]))))
            shift = (
                rng.uniform(-MAX_SHIFT, MAX_SHIFT) * width
                if rng.random() < SHIFT_PROBABILITY
                else 0.0
            )
            piece = _draw_shape(rng, length, width, OVAL_PROBABILITY)
            pieces.append(affinity.translate(piece, x + length / 2, shift))
            x += (1 - PIECE_OVERLAP) * length
        turn = rng.uniform(0, 360)
        pieces = [affinity.rotate(piece, turn, origin=(0, 0)) for piece in pieces]
        parts = dict(enumerate(pieces, start=1))
        obj = _fill(shapely.union_all(pieces), parts, "tool")
        if obj is not None:
            return obj


def draw_patches(rng: np.random.Generator) -> GridObject:
    """Draws a plate with patches, each a part."""
    while True:
        plate = _draw_plate(rng)
        left, bottom, right, top = plate.bounds
        size = np.array([right - left, top - bottom])
        # What no patch covers is part 1.
        patches = {}
        for label in range(2, rng.integers(PART_COUNT_RANGE[0], PART_COUNT_RANGE[1] + 1) + 1):
            least, greatest = np.log(PATCH_SIZE)
            length, width = np.exp(rng.uniform(least, greatest, 2)) * size
            patch = _draw_shape(rng, length, width, PLATE_OVAL)
            patch = affinity.rotate(patch, rng.uniform(0, 360))
            place = rng.uniform((left, bottom), (right, top))
            patches[label] = affinity.translate(patch, *place)
        obj = _fill(plate, patches, "patches")
        if obj is not None:
            return obj


def draw_part_masses(obj: GridObject, rng: np.random.Generator) -> CellParameters:
    """Draws what the cells of each part weigh: one part is lightest, another one heaviest."""
    labels = np.unique(obj.labels)
    ratio = np.exp(rng.uniform(*np.log(MASS_RATIO)))
    masses = np.exp(rng.uniform(0, np.log(ratio), len(labels)))
    lightest, heaviest = rng.permutation(len(labels))[:2]
    masses[lightest] = 1.0
    masses[heaviest] = ratio
    by_label = dict(zip(labels.tolist(), masses.tolist(), strict=True))
    return CellParameters.by_part(obj, by_label, SUPPORT_FRICTION)


def draw_round_load(kind: str, obj: GridObject, rng: np.random.Generator) -> CellParameters:
    """Draws loads by the distance from the middle, for BOWLS_KIND, RINGS_KIND or RIMS_KIND."""
    r = np.linalg.norm(obj.p_BC - obj.p_BC.mean(axis=0), axis=1) / obj.radius_of_gyration
    if kind == BOWLS_KIND:
        off = r / rng.uniform(*BOWL_RADIUS)
    elif kind == RINGS_KIND:
        off = (r - rng.uniform(*RING_RADIUS)) / RING_WIDTH
    else:
        off = (r - r.max()) / RIM_WIDTH
    load = np.exp(-0.5 * off**2) + LEAST_LOAD
    friction = np.full(obj.n, SUPPORT_FRICTION)
    return CellParameters(
        load / load.sum(), friction, CONTACT_FRICTION, patch_ratio=POINT_PATCH_FRACTION
    )


def push_at_random(
    obj: GridObject, truth: CellParameters, count: int, rng: np.random.Generator
) -> PushLog:
    """Pushes an object slowly from random places; its poses are seen with noise."""
    seen = []
    for i in range(count):
        push, pose = draw_push(Model(obj, truth), int(rng.integers(2**31)), PUSHER_RADIUS)
        times = np.linspace(0, push.duration, OBSERVATION_COUNT * SUBSTEP_COUNT + 1)
        motion = simulate(Model(obj, truth), push, pose, times=times, regime="quasi_static")
        poses = np.array([add_pose_noise(pose, rng) for pose in motion.poses[::SUBSTEP_COUNT]])
        seen.append(
            ObservedPush(f"push_{i + 1}", push, poses[0], times[::SUBSTEP_COUNT][1:], poses[1:])
        )
    return PushLog(tuple(seen))


def draw_body(kind: str, seed: int, training: int, held_out: int) -> RandomBody:
    """Draws a body and pushes it.

    Args:
        kind: one of BODY_DRAWERS.
        seed: seed of everything random.
        training: number of pushes to learn from.
        held_out: number of pushes that are held out, at most. Of the protocol's ten pushes of
            TOOLS_KIND and PATCHES_KIND those that are not learned from are held out.
    """
    rng = np.random.default_rng([seed, list(BODY_DRAWERS).index(kind)])
    obj, truth = BODY_DRAWERS[kind](kind, rng)
    count = training + held_out
    log = push_object(obj, truth) if kind in BY_PART else push_at_random(obj, truth, count, rng)
    order = rng.permutation(len(log))
    return RandomBody(
        obj=hide_parts(replace(obj, prior=PhysicalPrior(friction=SUPPORT_FRICTION))),
        truth=truth,
        training=log.subset(order[:training]),
        held_out=log.subset(order[training:][:held_out]),
    )


def _draw_tools(kind: str, rng: np.random.Generator) -> tuple[GridObject, CellParameters]:
    obj = draw_tool(rng)
    return obj, draw_part_masses(obj, rng)


def _draw_patches(kind: str, rng: np.random.Generator) -> tuple[GridObject, CellParameters]:
    obj = draw_patches(rng)
    return obj, draw_part_masses(obj, rng)


def _draw_even(kind: str, rng: np.random.Generator) -> tuple[GridObject, CellParameters]:
    obj = draw_tool(rng)
    return obj, CellParameters.uniform(obj)


def _draw_round(kind: str, rng: np.random.Generator) -> tuple[GridObject, CellParameters]:
    if rng.random() < TOOL_FRACTION:
        obj = draw_tool(rng)
    else:
        obj = GridObject.from_outline(_draw_plate(rng), max_cells=MAX_CELLS, name="plate")
    return obj, draw_round_load(kind, obj, rng)


BODY_DRAWERS: dict[str, Callable[[str, np.random.Generator], tuple[GridObject, CellParameters]]] = {
    TOOLS_KIND: _draw_tools,
    PATCHES_KIND: _draw_patches,
    EVEN_KIND: _draw_even,
    BOWLS_KIND: _draw_round,
    RINGS_KIND: _draw_round,
    RIMS_KIND: _draw_round,
}
"""What draws an object of a kind, with its masses and frictions."""


def _draw_shape(rng: np.random.Generator, length: float, width: float, oval: float) -> Polygon:
    """Draws a box or, with a probability, an oval about the origin."""
    if rng.random() < oval:
        return Polygon(affinity.scale(Point(0, 0).buffer(0.5), length, width))
    return shapely.box(-length / 2, -width / 2, length / 2, width / 2)


def _draw_plate(rng: np.random.Generator) -> Polygon:
    """Draws a turned box or oval."""
    length, width = rng.uniform(PLATE_SIZE[0], PLATE_SIZE[1], 2)
    plate = _draw_shape(rng, length, width, PLATE_OVAL)
    return Polygon(affinity.rotate(plate, rng.uniform(0, 360)))


def _fill(outline: Polygon, parts: dict[int, Polygon], name: str) -> GridObject | None:
    """Fills an outline with cells; None where a part is not of the size that it should have.

    Args:
        outline: the outline.
        parts: areas of the parts by label; label 1 may be left out, for what no other one covers.
        name: the object's name.
    """
    if outline.geom_type != "Polygon":
        return None
    areas: dict[int, ArrayLike | Polygon] = {**parts}
    obj = GridObject.from_outline(
        Polygon(outline.exterior), parts=areas, max_cells=MAX_CELLS, name=name
    )
    count = max(parts)
    fractions = np.array([(obj.labels == label).mean() for label in range(1, count + 1)])
    most = MAX_FRACTION if count > PART_COUNT_RANGE[0] else 1 - MIN_FRACTION
    return obj if fractions.min() >= MIN_FRACTION and fractions.max() <= most else None
