"""Few points that are loaded almost as thousands of cells are, chosen by the center of rotation.

The friction of cell i, k_i v_i/|v_i|, is a smooth function of the cell's place p_i, but for the
center of rotation c, where v_i = w z × (p_i - c) vanishes. So the cells of a box that is far from
c may be replaced by few *nodes* x_a in it, whose loads interpolate theirs:

    sum_i k_i f(p_i) ≈ sum_a f(x_a) K_a,      K_a = sum_i k_i L_a(p_i)

with L_a the Lagrange polynomials of the nodes: exact for every polynomial f of their degree. The
boxes are those of a quadtree. A box of half diagonal R is far if

    |c - its middle| > far R + slack

Boxes that are not are replaced by their parts, and the smallest ones by their cells. Points that
were gathered so are used until c has moved by the slack. `docs/theory/model.md`, section 10, says
how exact that is; `dynamics.cell_pooling` makes the boxes.
"""

from math import sqrt
from typing import Any, NamedTuple

import numpy as np

from gridpush_drake.dynamics.kernels.compiled import kernel

X, Y, HALF_DIAGONAL = range(3)
"""Columns of a box: its middle and its half diagonal, m."""

NEXT, FIRST, LAST = range(3)
"""Columns of a box's places: the next box that is no part of it, the first of its cells, and the
one after the last of them."""

UX, UY, W, COUNT = range(4)
"""Entries of what was gathered last: the twist, and the number of points."""


class Pool(NamedTuple):
    """The boxes of one object with one distribution of loads.

    Attributes:
        boxes: (B, 3) middles and half diagonals, m; each box is followed by its parts.
        places: (B, 3) where a box ends, and its cells; a box is one of the smallest if the next box
            is no part of it.
        nodes: (B, 3, Q) places (x, y), m, and loads, N, of the nodes of each box.
        cells: (3, n) places and loads of the cells, box by box.
        far: a box is far from the center of rotation where it is this many half diagonals away.
        slack: how far the center of rotation may move until points are gathered anew, m.
        points: (3, n) places and loads of the points gathered last, and room for more.
        last: (4,) the twist that they were gathered for, and their number.
    """

    boxes: Any
    places: Any
    nodes: Any
    cells: Any
    far: float
    slack: float
    points: Any
    last: Any


NO_POOL = Pool(
    boxes=np.zeros((0, 3)),
    places=np.zeros((0, 3), np.int64),
    nodes=np.zeros((0, 3, 0)),
    cells=np.zeros((3, 0)),
    far=0.0,
    slack=0.0,
    points=np.zeros((3, 0)),
    last=np.zeros(4),
)
"""The pool of an object whose cells are summed one by one."""


@kernel(allocates=False, inlined=True)
def forget_points(pool):
    """Has points gathered anew, whatever they were gathered for last."""
    if pool.boxes.shape[0] > 0:
        pool.last[COUNT] = 0.0


@kernel(allocates=False)
def gather_points(pool, xi):
    """Gathers the points that stand for the cells at a twist (3,), into `pool.points`.

    Returns:
        Their number.
    """
    ux = xi[0]
    uy = xi[1]
    w = xi[2]
    last = pool.last
    # c = (-uy, ux)/w; written without a division, for a translation has no center
    moved_x = ux * last[W] - last[UX] * w
    moved_y = uy * last[W] - last[UY] * w
    if last[COUNT] > 0.0 and (
        sqrt(moved_x * moved_x + moved_y * moved_y) <= pool.slack * abs(w * last[W])
    ):
        return int(last[COUNT])
    boxes = pool.boxes
    places = pool.places
    points = pool.points
    count = 0
    b = 0
    while b < boxes.shape[0]:
        # |c - middle| by the speed of the middle
        vx = ux - w * boxes[b, Y]
        vy = uy + w * boxes[b, X]
        far = abs(w) * (pool.far * boxes[b, HALF_DIAGONAL] + pool.slack)
        first = places[b, FIRST]
        cells = places[b, LAST] - first
        nodes = pool.nodes.shape[2]
        if cells > nodes and vx * vx + vy * vy > far * far:
            for j in range(3):
                for i in range(nodes):
                    points[j, count + i] = pool.nodes[b, j, i]
            count += nodes
            b = places[b, NEXT]
        elif places[b, NEXT] == b + 1:
            for j in range(3):
                for i in range(cells):
                    points[j, count + i] = pool.cells[j, first + i]
            count += cells
            b += 1
        else:
            b += 1
    last[UX] = ux
    last[UY] = uy
    last[W] = w
    last[COUNT] = count
    return count
