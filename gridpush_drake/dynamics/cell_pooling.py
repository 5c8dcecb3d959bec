"""The boxes by which thousands of cells are replaced by few points, of one object.

What the boxes are for stands in `kernels.pooled_loads`. They depend on the cells' places alone, and
are made once for each object; loads are brought to their nodes for each distribution of loads. The
smallest boxes take those of their cells,

    K_a = sum_i k_i L_a(p_i)

and every larger box those of the nodes of its parts, which is the same sum.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from gridpush_drake.dynamics.kernels.friction.pooled_loads import FIRST, LAST, NEXT, Pool
from gridpush_drake.geometry.se2 import Array, IntArray
from gridpush_drake.objects.grid_object import GridObject

POOLED_FROM = 1000
"""Least number of cells that are pooled."""

BOX_NODES = 5
"""Nodes along each side of a box."""

FAR_BOX_FACTOR = 3.0
"""A box is far from the center of rotation where it is this many half diagonals away."""

MIN_BOX_CELLS = 40
"""Number of cells up to which a box has no parts."""

QUARTER_SIDES = ((-1, -1), (-1, 1), (1, -1), (1, 1))
"""On which side of the middle of a box its four quarters lie, in x and y."""

MAX_CENTER_MOTION = 3.0
"""How far the center of rotation may move until points are gathered anew, in cells."""


class _Box(NamedTuple):
    """A box of the quadtree.

    Attributes:
        middle: (2,) m.
        half: half the side, m.
        level: number of boxes that it is a part of.
        quadrant: which quarter of the box above it is.
        above: index of the box that it is a part of; -1 for the whole.
        first, last: its cells, in the tree's order.
        next: index of the next box that is no part of it.
    """

    middle: Array
    half: float
    level: int = 0
    quadrant: int = 0
    above: int = -1
    first: int = 0
    last: int = 0
    next: int = 0


class _Transfer(NamedTuple):
    """How some boxes' loads are brought to those above them.

    Attributes:
        parts: (M,) the boxes, all of one quadrant and level.
        above: (M,) the boxes that they are parts of, each once.
        weights: (Q, Q) by which the loads of a part's nodes go to the nodes of the box above it.
    """

    parts: IntArray
    above: IntArray
    weights: Array


@dataclass(frozen=True, eq=False)
class CellPooling:
    """The quadtree of an object's cells.

    Attributes:
        order: (n,) the cells, box by box.
        weights: (n, Q) L_a of every cell, by the nodes of the smallest box that it is in.
        smallest: (S,) the smallest boxes.
        first: (S,) the first cell of each of them.
        transfers: what is brought from boxes to those above them, the lowest level first.
        boxes, places, nodes, cells, slack: as of `kernels.pooled_loads.Pool`, without loads.
    """

    order: IntArray
    weights: Array
    smallest: IntArray
    first: IntArray
    transfers: tuple[_Transfer, ...]
    boxes: Array
    places: IntArray
    nodes: Array
    cells: Array
    slack: float

    @classmethod
    def of_object(cls, obj: GridObject) -> "CellPooling":
        """Makes the boxes of an object, once for each object."""
        cached: CellPooling | None = obj.__dict__.get("_cell_pooling")
        if cached is None:
            cached = _make_pooling(obj)
            obj.__dict__["_cell_pooling"] = cached
        return cached

    def make_pool(self, k: Array) -> Pool:
        """Brings loads (n,), N, to the nodes."""
        loads = k[self.order]
        nodes = self.nodes.copy()
        at_nodes = np.zeros((len(self.boxes), BOX_NODES**2))
        at_nodes[self.smallest] = np.add.reduceat(loads[:, None] * self.weights, self.first)
        for transfer in self.transfers:
            at_nodes[transfer.above] += at_nodes[transfer.parts] @ transfer.weights
        nodes[:, 2] = at_nodes
        return Pool(
            boxes=self.boxes,
            places=self.places,
            nodes=nodes,
            cells=np.vstack([self.cells, loads]),
            far=FAR_BOX_FACTOR,
            slack=self.slack,
            points=np.empty((3, len(k) + BOX_NODES**2)),
            last=np.zeros(4),
        )


def _find_nodes() -> Array:
    """The nodes (BOX_NODES,) of Chebyshev between -1 and 1."""
    return np.cos((2 * np.arange(BOX_NODES) + 1) * np.pi / (2 * BOX_NODES))


def _calc_lagrange(t: Array) -> Array:
    """Calculates the Lagrange polynomials (K, BOX_NODES) of the nodes at places (K,)."""
    nodes = _find_nodes()
    found = np.ones((len(t), BOX_NODES))
    for a in range(BOX_NODES):
        for b in range(BOX_NODES):
            if b != a:
                found[:, a] *= (t - nodes[b]) / (nodes[a] - nodes[b])
    return found


def _calc_weights(box: _Box, p: Array) -> Array:
    """Calculates L_a of the nodes of a box (K, NODES²) at places (K, 2), m."""
    t = (p - box.middle) / box.half
    x = _calc_lagrange(t[:, 0])
    y = _calc_lagrange(t[:, 1])
    return (x[:, :, None] * y[:, None, :]).reshape(len(p), -1)


def _place_nodes(box: _Box) -> Array:
    """Places the nodes of a box (NODES², 2), m."""
    nodes = _find_nodes()
    x = box.middle[0] + box.half * nodes
    y = box.middle[1] + box.half * nodes
    return np.column_stack([np.repeat(x, BOX_NODES), np.tile(y, BOX_NODES)])


def _make_pooling(obj: GridObject) -> CellPooling:
    """Cuts the square that holds an object's cells into boxes."""
    p = obj.p_BC
    boxes, order = _cut_into_boxes(p, obj.cell_size)
    ordered = p[order]

    # The smallest boxes, and the weights of their cells.
    smallest = [b for b, box in enumerate(boxes) if box.next == b + 1]
    weights = np.vstack(
        [_calc_weights(boxes[b], ordered[boxes[b].first : boxes[b].last]) for b in smallest]
    )
    places = np.zeros((len(boxes), 3), np.int64)
    places[:, NEXT] = [box.next for box in boxes]
    places[:, FIRST] = [box.first for box in boxes]
    places[:, LAST] = [box.last for box in boxes]
    nodes = np.zeros((len(boxes), 3, BOX_NODES**2))
    for b, box in enumerate(boxes):
        nodes[b, :2] = _place_nodes(box).T
    return CellPooling(
        order=order,
        weights=weights,
        smallest=np.array(smallest),
        first=places[smallest, FIRST],
        transfers=tuple(_make_transfers(boxes)),
        boxes=np.array([[*box.middle, np.sqrt(2.0) * box.half] for box in boxes]),
        places=places,
        nodes=nodes,
        cells=np.array(ordered.T, order="C"),
        slack=MAX_CENTER_MOTION * obj.cell_size,
    )


def _cut_into_boxes(p: Array, cell_size: float) -> tuple[list[_Box], IntArray]:
    """Makes the boxes, each followed by its parts, of cells at places (n, 2), m.

    Returns:
        The boxes, and the order (n,) in which they have the cells.
    """
    low = p.min(axis=0)
    high = p.max(axis=0)
    order: list[int] = []
    boxes: list[_Box] = []

    def add(box: _Box, cells: IntArray) -> None:
        """Adds a box with some cells, and its parts after it."""
        index = len(boxes)
        boxes.append(box)
        first = len(order)
        if len(cells) <= MIN_BOX_CELLS:
            order.extend(cells.tolist())
        else:
            quadrants = 2 * (p[cells, 0] >= box.middle[0]) + (p[cells, 1] >= box.middle[1])
            for quadrant, side in enumerate(QUARTER_SIDES):
                some = cells[quadrants == quadrant]
                if not len(some):
                    continue
                part = box._replace(
                    middle=box.middle + box.half / 2 * np.array(side),
                    half=box.half / 2,
                    level=box.level + 1,
                    quadrant=quadrant,
                    above=index,
                )
                add(part, some)
        boxes[index] = box._replace(first=first, last=len(order), next=len(boxes))

    half = float((high - low).max() + cell_size) / 2
    add(_Box(middle=(low + high) / 2, half=half), np.arange(len(p)))
    return boxes, np.array(order)


def _make_transfers(boxes: list[_Box]) -> list[_Transfer]:
    """Says how loads are brought from boxes to those above them, the lowest level first."""
    found = []
    unit = _Box(middle=np.zeros(2), half=1.0)
    for level in range(max(box.level for box in boxes), 0, -1):
        for quadrant, side in enumerate(QUARTER_SIDES):
            parts = [
                b for b, box in enumerate(boxes) if (box.level, box.quadrant) == (level, quadrant)
            ]
            if parts:
                part = unit._replace(middle=np.array(side) / 2, half=0.5)
                above = np.array([boxes[b].above for b in parts])
                weights = _calc_weights(unit, _place_nodes(part))
                found.append(_Transfer(np.array(parts), above, weights))
    return found
