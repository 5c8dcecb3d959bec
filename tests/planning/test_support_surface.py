import numpy as np
import pytest
import shapely

from gridpush_drake.errors import PlanningError
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.support_surface import SupportSurface
from tests.helpers.shapes import rectangle

L_SHAPE = [(0.0, 0.0), (0.6, 0.0), (0.6, 0.3), (0.3, 0.3), (0.3, 0.6), (0.0, 0.6)]


@pytest.fixture
def bar():
    return GridObject.from_outline(rectangle(0.2, 0.04), max_cells=40, name="bar")


def test_distances_to_a_rectangle_are_known():
    table = SupportSurface.rectangle((1.0, 2.0), (0.8, 0.4))
    points = [(1.0, 2.0), (1.35, 2.0), (1.4, 2.1), (1.5, 2.0), (1.43, 2.24)]
    np.testing.assert_allclose(
        table.signed_distances(points), [0.2, 0.05, 0.0, -0.1, -0.05], atol=1e-12
    )


@pytest.mark.parametrize(
    "table", [SupportSurface.round((0.1, 0.2), 0.4), SupportSurface.from_polygon(L_SHAPE)]
)
def test_distances_agree_with_the_polygon_s(table):
    points = np.random.default_rng(0).uniform(-0.5, 0.9, (200, 2))
    expected = [
        (1 if table.polygon.contains(shapely.Point(p)) else -1)
        * table.polygon.exterior.distance(shapely.Point(p))
        for p in points
    ]
    np.testing.assert_allclose(table.signed_distances(points), expected, atol=1e-12)
    np.testing.assert_array_equal(table.contains(points), np.array(expected) > 0)


def test_a_round_table_reaches_nowhere_beyond_its_circle():
    table = SupportSurface.round((0.5, 0.0), 0.45)
    radius = np.linalg.norm(table.corners - (0.5, 0.0), axis=1)
    assert radius.max() <= 0.45 + 1e-12
    assert table.signed_distances([(0.5, 0.0)])[0] > 0.449


def test_corners_may_be_given_in_either_turning():
    one, other = SupportSurface.from_polygon(L_SHAPE), SupportSurface.from_polygon(L_SHAPE[::-1])
    assert one.polygon.equals(other.polygon)
    assert not one.is_convex
    assert SupportSurface.rectangle((0, 0), (1, 1)).is_convex


@pytest.mark.parametrize(
    "table", [SupportSurface.rectangle((0, 0), (0.5, 0.4)), SupportSurface.round((0, 0), 0.25)]
)
def test_a_cell_s_square_is_as_far_inside_as_its_nearest_corner(table, bar):
    rng = np.random.default_rng(1)
    corners = bar.cell_size / 2 * np.array([(1, 1), (1, -1), (-1, 1), (-1, -1)])
    for pose in np.column_stack([rng.uniform(-0.3, 0.3, (20, 2)), rng.uniform(-4, 4, 20)]):
        c, s = np.cos(pose[2]), np.sin(pose[2])
        p = (bar.p_BC[:, None] + corners) @ np.array([[c, s], [-s, c]]) + pose[:2]
        nearest = table.signed_distances(p).min(axis=1)
        found = table.cell_distances(bar, pose)
        inside = nearest > 0
        np.testing.assert_allclose(found[inside], nearest[inside], atol=1e-12)
        assert (found[~inside] <= 1e-12).all()
        assert table.contains_cells(bar, pose) == inside.all()


def test_many_poses_at_once_are_as_one_by_one(bar):
    table = SupportSurface.rectangle((0, 0), (0.3, 0.3))
    poses = np.array([[0.0, 0.0, 0.0], [0.06, 0.0, 0.0], [0.06, 0.0, np.pi / 2]])
    np.testing.assert_array_equal(table.contains_cells(bar, poses, 0.0), [True, False, True])
    assert not table.contains_cells(bar, poses[0], 0.051)


def test_a_concave_table_never_holds_what_is_beyond_its_edge(bar):
    table = SupportSurface.from_polygon(L_SHAPE)
    assert table.contains_cells(bar, (0.15, 0.15, 0.3))
    assert not table.contains_cells(bar, (0.3, 0.3, -np.pi / 4))


def test_places_on_the_edge_are_found_again():
    table = SupportSurface.from_polygon(L_SHAPE)
    assert table.perimeter == pytest.approx(2.4)
    for s in np.linspace(0.02, 2.38, 16):
        point, normal = table.edge_at(s)
        assert not table.contains(point + 1e-6 * normal)
        assert table.contains(point - 1e-6 * normal)


def test_a_long_bar_fits_on_a_table_by_its_diagonal_only():
    table = SupportSurface.rectangle((3.0, -2.0), (0.3, 0.3))
    assert table.fits(rectangle(0.38, 0.02))
    assert not table.fits(rectangle(0.43, 0.02))


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: SupportSurface.rectangle((0, 0), (0.5, 0.0)), "positive sides"),
        (lambda: SupportSurface.rectangle((0, np.nan), (0.5, 0.5)), "center"),
        (lambda: SupportSurface.round((0, 0), -1.0), "radius"),
        (lambda: SupportSurface.from_polygon([(0, 0), (1, 1)]), "k >= 3"),
        (lambda: SupportSurface.from_polygon([(0, 0), (1, 1), (1, 0), (0, 1)]), "cross itself"),
        (
            lambda: SupportSurface(
                shapely.Point(0, 0).buffer(1).difference(shapely.Point(0, 0).buffer(0.5))
            ),
            "holes",
        ),
    ],
)
def test_refuses_what_is_no_table(make, says):
    with pytest.raises(PlanningError, match=says):
        make()
