import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from gridpush_drake.geometry.polygons import bound_by_half_planes, calc_margin_inside, hull_of
from gridpush_drake.geometry.se2 import (
    calc_yaw,
    compose,
    invert,
    make_direction,
    make_rotation,
    rotate,
    transform,
    transform_back,
    wrap_angle,
)

RNG = np.random.default_rng(3)
POSES = RNG.uniform(-4.0, 4.0, (6, 3))
OTHERS = RNG.uniform(-4.0, 4.0, (6, 3))
POINTS = RNG.uniform(-1.0, 1.0, (5, 2))


def in_space(q):
    return RigidTransform.from_components([q[0], q[1], 0.0], Rotation.from_euler("z", q[2]))


@pytest.mark.parametrize(("q", "r"), list(zip(POSES, OTHERS, strict=True)))
def test_agrees_with_scipy_s_motions_in_space(q, r):
    points = np.column_stack([POINTS, np.zeros(len(POINTS))])
    np.testing.assert_allclose(transform(q, POINTS), in_space(q).apply(points)[:, :2], atol=1e-14)
    product = in_space(q) * in_space(r)
    found = compose(q, r)
    np.testing.assert_allclose(found[:2], product.translation[:2], atol=1e-14)
    np.testing.assert_allclose(
        make_rotation(found[2]), product.rotation.as_matrix()[:2, :2], atol=1e-14
    )
    np.testing.assert_allclose(compose(invert(q), q), np.zeros(3), atol=1e-14)
    np.testing.assert_allclose(transform_back(q, transform(q, POINTS)), POINTS, atol=1e-14)


def test_leading_dimensions_broadcast():
    many = transform(POSES, POINTS)
    assert many.shape == (6, 5, 2)
    for q, points in zip(POSES, many, strict=True):
        np.testing.assert_array_equal(points, transform(q, POINTS))
    np.testing.assert_array_equal(compose(POSES, OTHERS)[2], compose(POSES[2], OTHERS[2]))
    np.testing.assert_allclose(rotate(POSES[:, 2], [1.0, 0.0]), make_direction(POSES[:, 2]), atol=0)
    np.testing.assert_allclose(
        make_rotation(POSES[:, 2])[..., 0], make_direction(POSES[:, 2]), atol=0
    )


def test_yaw_of_a_tilted_body_is_where_its_x_axis_points():
    turns = Rotation.from_euler("ZYX", np.random.default_rng(0).uniform(-1.4, 1.4, (50, 3)))
    x, y, z, w = turns.as_quat().T
    np.testing.assert_allclose(calc_yaw(w, x, y, z), turns.as_euler("ZYX")[:, 0], atol=1e-12)


def test_wrapped_angles_point_the_same_way():
    theta = np.linspace(-20.0, 20.0, 101)
    wrapped = wrap_angle(theta)
    assert wrapped.min() >= -np.pi and wrapped.max() < np.pi
    np.testing.assert_allclose(make_direction(wrapped), make_direction(theta), atol=1e-14)


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
