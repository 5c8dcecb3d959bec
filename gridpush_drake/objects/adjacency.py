"""Which cells touch: the pairs that share a side, and links between islands of cells."""

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components, minimum_spanning_tree
from scipy.spatial import Delaunay, QhullError, cKDTree

from gridpush_drake.geometry.se2 import Array, IntArray

SIDE_REACH = 1.2
"""Two cells share a side if their centers are nearer than this many cell sides. Centers of diagonal
neighbors are sqrt(2) sides apart."""

LINE_TOLERANCE = 1e-9
"""Cells stand in one line if their extent across it is below this many cell sides."""


def calc_adjacency(p_BC: ArrayLike, cell_size: float) -> IntArray:
    """Finds the pairs of cells that share a side, and joins islands by their shortest links.

    Args:
        p_BC: (n, 2) cell centers on a square lattice, any one frame, m.

    Returns:
        (m, 2) pairs i < j in increasing order; as a graph they connect all n cells.
    """
    p_BC = np.asarray(p_BC, dtype=np.float64)
    tree = cKDTree(p_BC)
    pairs = tree.query_pairs(SIDE_REACH * cell_size, output_type="ndarray").astype(np.int64)
    islands = _find_islands(pairs, len(p_BC))
    if islands.max() > 0:
        pairs = np.concatenate([pairs, _calc_links(p_BC, cell_size, islands)])
    return _tidy(pairs)


def _find_islands(pairs: IntArray, n: int) -> IntArray:
    """Numbers the groups of cells that are connected: (n,) each cell's group."""
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    return connected_components(graph, directed=False)[1].astype(np.int64)


def _calc_links(p_BC: Array, cell_size: float, islands: IntArray) -> IntArray:
    """Links islands of cells by the shortest tree.

    Args:
        p_BC: (n, 2) cell centers, m.
        cell_size: side of a cell, m.
        islands: (n,) number of each cell's island.

    Returns:
        (islands - 1, 2) pairs of cells, one for each branch of the tree.
    """
    # The Delaunay edges contain the Euclidean spanning tree. Only those between islands matter.
    candidates = _tidy(_delaunay_edges(p_BC, cell_size))
    islands_of = islands[candidates]
    i, j = candidates[islands_of[:, 0] != islands_of[:, 1]].T

    # Of all edges between the same two islands, the shortest is kept.
    length = np.linalg.norm(p_BC[i] - p_BC[j], axis=1)
    ends = np.sort(np.column_stack([islands[i], islands[j]]), axis=1)
    order = np.lexsort((length, ends[:, 1], ends[:, 0]))
    first = order[np.unique(ends[order], axis=0, return_index=True)[1]]

    # The tree, with an island as a node.
    count = int(islands.max()) + 1
    graph = coo_array((length[first], (ends[first, 0], ends[first, 1])), shape=(count, count))
    tree = minimum_spanning_tree(graph.tocsr()).tocoo()
    chosen = {(int(a), int(b)) for a, b in zip(*tree.coords, strict=True)}
    kept = [k for k in first if (int(ends[k, 0]), int(ends[k, 1])) in chosen]
    return np.column_stack([i[kept], j[kept]])


def _delaunay_edges(p_BC: Array, cell_size: float) -> IntArray:
    """Finds the edges (e, 2) of the Delaunay triangles of cell centers (n, 2), m.

    Centers in a line have no triangles; there each is joined to the next one.
    """
    centered = (p_BC - p_BC.mean(axis=0)) / cell_size
    along, _, axes = np.linalg.svd(centered, full_matrices=False)
    across = centered @ axes[-1]
    if len(p_BC) > 2 and np.ptp(across) > LINE_TOLERANCE:
        try:
            corners = Delaunay(centered).simplices
        except QhullError:
            pass  # so nearly in a line that Qhull finds no triangle
        else:
            sides = [corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]]
            return np.concatenate(sides).astype(np.int64)
    order = np.argsort(along[:, 0], kind="stable")
    return np.column_stack([order[:-1], order[1:]]).astype(np.int64)


def _tidy(pairs: IntArray) -> IntArray:
    """Puts pairs (m, 2) in increasing order, each i < j and once."""
    return np.unique(np.sort(pairs, axis=1), axis=0).reshape(-1, 2)
