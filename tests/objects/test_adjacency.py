import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from gridpush_drake.objects.cells import calc_adjacency


def lattice(mask, size=1.0):
    row, column = np.nonzero(mask)
    return size * np.column_stack([column, row]).astype(float)


def components(pairs, n):
    return connected_components(coo_array((np.ones(len(pairs)), tuple(pairs.T)), shape=(n, n)), directed=False)[0]


def test_block_of_cells_has_every_shared_side_once():
    pairs = calc_adjacency(lattice(np.ones((3, 4)), 0.01), 0.01)
    assert len(pairs) == 3 * 3 + 2 * 4
    assert (pairs[:, 0] < pairs[:, 1]).all()
    assert len(np.unique(pairs, axis=0)) == len(pairs)


def test_single_cell_has_no_neighbors():
    assert calc_adjacency([[0.3, 0.1]], 0.01).shape == (0, 2)


def test_diagonal_neighbors_do_not_share_a_side_but_are_linked_when_nothing_else_joins_them():
    np.testing.assert_array_equal(calc_adjacency([[0, 0], [1, 0], [1, 1]], 1.0), [[0, 1], [1, 2]])
    np.testing.assert_array_equal(calc_adjacency([[0, 0], [1, 1]], 1.0), [[0, 1]])


def test_islands_are_joined_by_their_shortest_links():
    left, right = lattice(np.ones((3, 3))), lattice(np.ones((3, 3))) + [5, 0]
    pairs = calc_adjacency(np.concatenate([left, right]), 1.0)
    p = np.concatenate([left, right])
    length = np.linalg.norm(p[pairs[:, 0]] - p[pairs[:, 1]], axis=1)
    assert len(pairs) == 12 + 12 + 1
    assert length.max() == pytest.approx(3)


def test_islands_in_one_line_are_joined_neighbor_to_neighbor():
    p = np.array([[0.0, 0], [1, 0], [9, 0], [4, 0]])
    np.testing.assert_array_equal(calc_adjacency(p, 1.0), [[0, 1], [1, 3], [2, 3]])


def test_turned_line_of_islands():
    p = np.array([0.0, 2, 5, 9])[:, None] * [np.cos(0.7), np.sin(0.7)]
    np.testing.assert_array_equal(calc_adjacency(p, 1.0), [[0, 1], [1, 2], [2, 3]])


@given(st.integers(0, 2**32 - 1), st.floats(0.05, 0.9))
@settings(deadline=None, max_examples=60)
def test_graph_is_connected_and_links_are_a_tree_of_islands(seed, density):
    mask = np.random.default_rng(seed).random((9, 11)) < density
    mask[4, 5] = True
    p = lattice(mask, 0.02)
    pairs = calc_adjacency(p, 0.02)
    length = np.linalg.norm(p[pairs[:, 0]] - p[pairs[:, 1]], axis=1)
    sides = pairs[length < 0.021]
    assert len(sides) == (mask[1:] & mask[:-1]).sum() + (mask[:, 1:] & mask[:, :-1]).sum()
    assert components(pairs, len(p)) == 1
    assert len(pairs) - len(sides) == components(sides, len(p)) - 1


def test_links_have_the_length_of_the_minimum_spanning_tree():
    rng = np.random.default_rng(3)
    p = lattice(rng.random((12, 12)) < 0.15)
    pairs = calc_adjacency(p, 1.0)
    total = np.linalg.norm(p[pairs[:, 0]] - p[pairs[:, 1]], axis=1).sum()
    reached, expected = {0}, 0.0
    while len(reached) < len(p):  # Prim's algorithm
        inside = sorted(reached)
        outside = [i for i in range(len(p)) if i not in reached]
        distance = np.linalg.norm(p[inside][:, None] - p[outside][None], axis=2)
        expected += distance.min()
        reached.add(outside[int(np.argmin(distance.min(axis=0)))])
    cycles = len(pairs) - (len(p) - 1)
    assert total - cycles == pytest.approx(expected)


@pytest.mark.parametrize("density", [1.0, 0.55])
def test_ten_thousand_cells_hang_together(density):
    mask = np.random.default_rng(0).random((100, 100)) < density
    pairs = calc_adjacency(lattice(mask), 1.0)
    assert components(pairs, int(mask.sum())) == 1
