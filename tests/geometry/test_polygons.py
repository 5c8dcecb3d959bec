import numpy as np
import pytest

from gridpush_drake.geometry.polygons import bound_by_half_planes, calc_margin_inside, hull_of
from gridpush_drake.geometry.se2 import make_direction

DIRECTIONS = make_direction(2 * np.pi * np.arange(72) / 72)


@pytest.mark.parametrize("seed", range(5))
def test_half_planes_leave_the_points_that_keep_every_bound(seed):
    rng = np.random.default_rng(seed)
    points = rng.normal(scale=0.05, size=(7, 2)) + rng.normal(scale=0.2, size=2)
    offsets = (points @ DIRECTIONS.T).max(axis=0) + rng.uniform(0.0, 0.01, len(DIRECTIONS))
    corners = bound_by_half_planes(DIRECTIONS, offsets)
    assert calc_margin_inside(points, corners) >= 0
    grid = points.mean(axis=0) + rng.uniform(-0.3, 0.3, (2000, 2))
    room = (offsets - grid @ DIRECTIONS.T).min(axis=1)
    inside = np.array([calc_margin_inside(p[None], corners) > 0 for p in grid])
    clear = np.abs(room) > 1e-8
    np.testing.assert_array_equal(inside[clear], room[clear] > 0)
    assert inside.any() and not inside.all()


def test_half_planes_through_one_point_leave_it():
    point = np.array([0.13, -0.07])
    corners = bound_by_half_planes(DIRECTIONS, DIRECTIONS @ point)
    assert len(corners) >= 3
    np.testing.assert_allclose(corners - point, 0.0, atol=1e-8)


def test_points_in_a_line_have_no_hull():
    assert hull_of(np.array([[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]])).shape == (0, 2)
    assert calc_margin_inside(np.zeros((1, 2)), np.empty((0, 2))) == -np.inf
