from itertools import pairwise

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from shapely import Polygon

from gridpush_drake.errors import ObjectError
from gridpush_drake.objects import outline as outlines
from gridpush_drake.objects.adjacency import calc_adjacency
from gridpush_drake.objects.cells import MAX_CELLS
from gridpush_drake.objects.grid_object import GridObject

TRIANGLE = [[-0.05, -0.05], [0.10, -0.05], [-0.05, 0.10]]


def rectangle(width, height):
    return [[0, 0], [width, 0], [width, height], [0, height]]


def turned(points, angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.asarray(points) @ np.array([[c, s], [-s, c]])


def gyration(polygon):
    """Root mean square distance from the centroid, from the triangles of a fan."""
    polygon, total = Polygon(polygon), 0.0
    center = np.array(polygon.centroid.coords[0])
    for sign, ring in [(1, polygon.exterior), *((-1, hole) for hole in polygon.interiors)]:
        p = np.array(ring.coords) - center
        if Polygon(ring).exterior.is_ccw != (sign > 0):
            p = p[::-1]
        for a, b in pairwise(p):
            total += (a[0] * b[1] - a[1] * b[0]) / 12 * (a @ a + a @ b + b @ b)
    return np.sqrt(total / polygon.area)


@pytest.mark.parametrize("max_cells", [60, 1000, MAX_CELLS])
@pytest.mark.parametrize(
    "outline",
    [
        TRIANGLE,
        rectangle(0.135, 0.09),
        turned(rectangle(0.2, 0.05), 0.4),
        [[0.06 * np.cos(a), 0.06 * np.sin(a)] for a in np.arange(6) * np.pi / 3],
    ],
    ids=["triangle", "rectangle", "turned bar", "hexagon"],
)
def test_cells_are_nearly_as_many_as_allowed_and_true_to_the_outline(outline, max_cells):
    obj = GridObject.from_outline(outline, max_cells=max_cells)
    true = gyration(outline)
    assert 0.88 * max_cells <= obj.n <= max_cells
    assert np.linalg.norm(obj.p_BC.mean(axis=0) - Polygon(outline).centroid.coords[0]) < 0.02 * true
    assert obj.radius_of_gyration == pytest.approx(true, rel=0.02)
    assert obj.n * obj.cell_size**2 == pytest.approx(Polygon(outline).area, rel=0.03)


@pytest.mark.parametrize(
    "height, max_cells, rows, columns",
    [(0.0003, 1000, 1, 1000), (0.003, 100, 1, 100), (0.003, 60, 1, 60), (0.003, 1000, 3, 300)],
)
def test_rod_is_rows_of_cells_that_end_where_it_ends(height, max_cells, rows, columns):
    obj = GridObject.from_outline(rectangle(0.3, height), max_cells=max_cells)
    assert obj.n == rows * columns
    assert len(np.unique(obj.p_BC[:, 1].round(9))) == rows
    assert obj.p_BC[:, 0].min() - obj.cell_size / 2 == pytest.approx(0, abs=1e-9)
    assert obj.p_BC[:, 0].max() + obj.cell_size / 2 == pytest.approx(0.3)


def test_square_is_tiled():
    obj = GridObject.from_outline(rectangle(0.09, 0.09), max_cells=127)
    assert obj.n == 121
    assert obj.cell_size == pytest.approx(0.09 / 11)


def test_choice_is_deterministic_and_made_once(monkeypatch):
    one = GridObject.from_outline(TRIANGLE, max_cells=77)
    outlines._choose_cells.cache_clear()
    other = GridObject.from_outline(TRIANGLE, max_cells=77)
    np.testing.assert_array_equal(one.p_BC, other.p_BC)
    monkeypatch.setattr(outlines, "choose_cells", None)
    again = GridObject.from_outline(TRIANGLE, max_cells=77)
    assert again.p_BC is not other.p_BC
    np.testing.assert_array_equal(again.p_BC, other.p_BC)


def test_outline_is_the_body_frame_and_runs_counterclockwise():
    obj = GridObject.from_outline(TRIANGLE[::-1], max_cells=55)
    assert obj.outline.exterior.is_ccw
    assert obj.outline.equals(Polygon(TRIANGLE))


def test_repeated_vertices_are_dropped():
    obj = GridObject.from_outline([TRIANGLE[0], *TRIANGLE, TRIANGLE[0]])
    assert len(obj.outline.exterior.coords) == 4


def test_holes_hold_no_cells():
    ring = shapely.Point(0, 0).buffer(0.1).difference(shapely.Point(0, 0).buffer(0.06))
    obj = GridObject.from_outline(ring, max_cells=300)
    assert np.linalg.norm(obj.p_BC, axis=1).min() > 0.055
    assert obj.n * obj.cell_size**2 == pytest.approx(ring.area, rel=0.05)


def test_parts_label_the_cells_whose_centers_they_cover():
    parts = {3: rectangle(0.1, 0.2), 2: [[0, 0], [0.2, 0], [0.2, 0.1], [0, 0.1]]}
    obj = GridObject.from_outline(rectangle(0.3, 0.2), parts=parts, max_cells=150)
    x, y = obj.p_BC.T
    np.testing.assert_array_equal(
        obj.labels, np.where(x < 0.1, 3, np.where((x < 0.2) & (y < 0.1), 2, 1))
    )


def test_one_cell_is_made_for_whatever_the_shape():
    for outline in (rectangle(1, 1), TRIANGLE, rectangle(1, 1e-6), turned(rectangle(1, 1e-9), 0.5)):
        assert GridObject.from_outline(outline, max_cells=1).n == 1


@pytest.mark.parametrize("width", [1e-3, 1e-5, 1e-9])
def test_turned_sliver_has_cells_along_all_its_length(width):
    outline = turned(rectangle(1, width), 0.5)
    obj = GridObject.from_outline(outline, max_cells=127)
    along = obj.p_BC @ [np.cos(0.5), np.sin(0.5)]
    assert 50 <= obj.n <= 127
    assert along.min() < 0.03 and along.max() > 0.97


@pytest.mark.parametrize("max_cells", [0, -3, 2.5, True, "60", None])
def test_count_must_be_a_positive_whole_number(max_cells):
    with pytest.raises(ObjectError, match="max_cells"):
        GridObject.from_outline(TRIANGLE, max_cells=max_cells)


@pytest.mark.parametrize(
    "outline, word",
    [
        ([[0, 0], [1, 1], [1, 0], [0, 1]], "cross"),
        ([[0, 0], [1, 1], [2, 2]], "no area"),
        ([[0, 0], [0, 0], [0, 0]], "no area"),
        ([[0, 0], [1, 1]], "three"),
        ([], "three"),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "three"),
        ([[0, 0], [np.nan, 1], [1, 0]], "finite"),
        ([[0, 0], [np.inf, 1], [1, 0]], "finite"),
        ([["a", 0], [0, 1], [1, 0]], "list of"),
        ([[0, 0], [1], [1, 0]], "list of"),
        (Polygon(), "empty"),
        (Polygon(rectangle(1, 1), [rectangle(1, 1)]), "outline"),
        ([[0, 0], [1e200, 0], [0, 1e200]], r"coordinate of 1e\+200 m"),
    ],
)
def test_bad_outlines_are_refused(outline, word):
    with pytest.raises(ObjectError, match=word):
        GridObject.from_outline(outline)


@pytest.mark.parametrize(
    "parts, word",
    [
        ({0: TRIANGLE}, "label"),
        ({1.5: TRIANGLE}, "label"),
        ({2: [[0, 0], [1, 1], [1, 0], [0, 1]]}, "part 2"),
    ],
)
def test_bad_parts_are_refused(parts, word):
    with pytest.raises(ObjectError, match=word):
        GridObject.from_outline(TRIANGLE, parts=parts)


@given(st.integers(0, 2**32 - 1), st.integers(3, 12), st.integers(1, 400), st.floats(1e-3, 1e3))
@settings(deadline=None, max_examples=25)
def test_random_star_shapes(seed, corners, max_cells, scale):
    rng = np.random.default_rng(seed)
    angle = np.sort(rng.uniform(0, 2 * np.pi, corners))
    radius = scale * rng.uniform(0.2, 1, corners)
    outline = Polygon(np.column_stack([radius * np.cos(angle), radius * np.sin(angle)]))
    if not outline.is_valid or outline.area < 0.05 * scale**2:
        return
    obj = GridObject.from_outline(outline, max_cells=max_cells)
    assert 1 <= obj.n <= max_cells
    if max_cells > 100:
        assert obj.n > 0.75 * max_cells
        assert obj.n * obj.cell_size**2 == pytest.approx(outline.area, rel=0.1)
        offset = obj.p_BC.mean(axis=0) - np.array(outline.centroid.coords[0])
        assert np.linalg.norm(offset) < 0.08 * gyration(outline)


def lattice(mask, size=1.0):
    row, column = np.nonzero(mask)
    return size * np.column_stack([column, row]).astype(float)


def components(pairs, n):
    return connected_components(
        coo_array((np.ones(len(pairs)), tuple(pairs.T)), shape=(n, n)), directed=False
    )[0]


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
