import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from gridpush_drake.geometry.se2 import (
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
    np.testing.assert_allclose(make_rotation(found[2]), product.rotation.as_matrix()[:2, :2], atol=1e-14)
    np.testing.assert_allclose(compose(invert(q), q), np.zeros(3), atol=1e-14)
    np.testing.assert_allclose(transform_back(q, transform(q, POINTS)), POINTS, atol=1e-14)


def test_leading_dimensions_broadcast():
    many = transform(POSES, POINTS)
    assert many.shape == (6, 5, 2)
    for q, points in zip(POSES, many, strict=True):
        np.testing.assert_array_equal(points, transform(q, POINTS))
    np.testing.assert_array_equal(compose(POSES, OTHERS)[2], compose(POSES[2], OTHERS[2]))
    np.testing.assert_allclose(rotate(POSES[:, 2], [1.0, 0.0]), make_direction(POSES[:, 2]), atol=0)
    np.testing.assert_allclose(make_rotation(POSES[:, 2])[..., 0], make_direction(POSES[:, 2]), atol=0)


def test_wrapped_angles_point_the_same_way():
    theta = np.linspace(-20.0, 20.0, 101)
    wrapped = wrap_angle(theta)
    assert wrapped.min() >= -np.pi and wrapped.max() < np.pi
    np.testing.assert_allclose(make_direction(wrapped), make_direction(theta), atol=1e-14)
