"""Which cells touch: the pairs that share a side, made connected where the grid fell into islands."""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components, minimum_spanning_tree
from scipy.spatial import Delaunay, QhullError, cKDTree

SIDE_REACH = 1.2
"""Centres nearer than this many cell sides share a side; diagonal neighbours are sqrt(2) sides apart."""

FLATNESS = 1e-9
"""Cells whose extent across their main direction is below this many cell sides stand in one line."""


def calc_adjacency(p_BC: ArrayLike, cell_size: float) -> NDArray[np.int64]:
    """Finds the pairs of cells that share a side, and joins islands by their shortest links.

    Args:
        p_BC: (n, 2) cell centres on a square lattice, any one frame, m.
        cell_size: side of a cell, m.

    Returns:
        (m, 2) pairs i < j in increasing order; as a graph they connect all n cells.
    """
    p_BC = np.asarray(p_BC, dtype=np.float64)
    pairs = cKDTree(p_BC).query_pairs(SIDE_REACH * cell_size, output_type="ndarray").astype(np.int64)
    islands = _find_islands(pairs, len(p_BC))
    if islands.max() > 0:
        pairs = np.concatenate([pairs, _calc_links(p_BC, cell_size, islands)])
    return _tidy(pairs)


def _find_islands(pairs: NDArray[np.int64], n: int) -> NDArray[np.int64]:
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    return connected_components(graph, directed=False)[1].astype(np.int64)


def _calc_links(p_BC: NDArray[np.float64], cell_size: float, islands: NDArray[np.int64]) -> NDArray[np.int64]:
    """Shortest tree of links between islands; the Delaunay edges contain the Euclidean spanning tree."""
    candidates = _tidy(_delaunay_edges(p_BC, cell_size))
    i, j = candidates[islands[candidates[:, 0]] != islands[candidates[:, 1]]].T
    length = np.linalg.norm(p_BC[i] - p_BC[j], axis=1)
    ends = np.sort(np.column_stack([islands[i], islands[j]]), axis=1)
    order = np.lexsort((length, ends[:, 1], ends[:, 0]))
    first = order[np.unique(ends[order], axis=0, return_index=True)[1]]
    count = int(islands.max()) + 1
    graph = coo_array((length[first], (ends[first, 0], ends[first, 1])), shape=(count, count))
    tree = minimum_spanning_tree(graph.tocsr()).tocoo()
    chosen = {(int(a), int(b)) for a, b in zip(*tree.coords, strict=True)}
    kept = [k for k in first if (int(ends[k, 0]), int(ends[k, 1])) in chosen]
    return np.column_stack([i[kept], j[kept]])


def _delaunay_edges(p_BC: NDArray[np.float64], cell_size: float) -> NDArray[np.int64]:
    centred = (p_BC - p_BC.mean(axis=0)) / cell_size
    along, _, axes = np.linalg.svd(centred, full_matrices=False)
    across = centred @ axes[-1]
    if len(p_BC) > 2 and np.ptp(across) > FLATNESS:
        try:
            simplices = Delaunay(centred).simplices
            return np.concatenate([simplices[:, [0, 1]], simplices[:, [1, 2]], simplices[:, [2, 0]]]).astype(np.int64)
        except QhullError:
            pass
    order = np.argsort(along[:, 0], kind="stable")
    return np.column_stack([order[:-1], order[1:]]).astype(np.int64)


def _tidy(pairs: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.unique(np.sort(pairs, axis=1), axis=0).reshape(-1, 2)
