"""What a camera does to pictures, by statistics of a flat table and a step in depth."""

import numpy as np
import pytest
from pydrake.systems.framework import Context
from pydrake.systems.sensors import ImageDepth32F, ImageRgba8U

from gridpush_drake.systems.sensing.rgbd_noise import RgbdNoise

WIDTH, HEIGHT, PERIOD = 160, 120, 0.1
NEAR, FAR = 1.0, 2.0


def make(**options) -> tuple[RgbdNoise, Context]:
    """The left half is near, the right half far; the last column was not measured."""
    noise = RgbdNoise(WIDTH, HEIGHT, PERIOD, **options)
    context = noise.CreateDefaultContext()
    color, depth = ImageRgba8U(WIDTH, HEIGHT), ImageDepth32F(WIDTH, HEIGHT)
    color.mutable_data[:] = (100, 150, 200, 255)
    depth.mutable_data[:] = NEAR
    depth.mutable_data[:, WIDTH // 2 :] = FAR
    depth.mutable_data[:, -1] = np.inf
    noise.GetInputPort("color_image").FixValue(context, color)
    noise.GetInputPort("depth_image").FixValue(context, depth)
    return noise, context


def look(noise: RgbdNoise, context: Context, time: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    context.SetTime(time)
    color, depth = (
        noise.GetOutputPort(name).Eval(context).data for name in ("color_image", "depth_image")
    )
    return color[..., :3].astype(float), depth[..., 0].copy()


def test_without_noise_pictures_stay_as_they_are_but_for_what_was_not_measured():
    noise, context = make()
    color, depth = look(noise, context)
    assert (color == (100, 150, 200)).all()
    assert (depth[:, :-1] > 0).all() and (depth[:, -1] == 0).all()
    np.testing.assert_array_equal(np.unique(depth), [0.0, NEAR, FAR])


def test_depth_noise_grows_with_the_distance_squared_and_edges_are_holes():
    _, depth = look(*make(depth_noise=0.002, depth_edge=0.1))
    middle = WIDTH // 2
    assert (depth[:, middle - 1 : middle + 1] == 0).all()
    near, far = depth[:, : middle - 1], depth[:, middle + 1 : -2]
    assert (near > 0).all() and (far > 0).all()
    assert near.std() == pytest.approx(0.002 * NEAR**2, rel=0.05)
    assert far.std() == pytest.approx(0.002 * FAR**2, rel=0.05)
    assert near.mean() == pytest.approx(NEAR, abs=1e-4)


def test_exposure_is_common_to_a_picture_and_noise_is_not():
    noise, context = make(color_noise=2.0, exposure_noise=0.05)
    means = []
    for count in range(30):
        color, _ = look(noise, context, count * PERIOD)
        assert color.reshape(-1, 3).std(axis=0) == pytest.approx([2.0] * 3, rel=0.1)
        means.append(color.reshape(-1, 3).mean(axis=0) / (100, 150, 200))
    assert np.std(means, axis=0) == pytest.approx([0.05] * 3, rel=0.4)
    np.testing.assert_allclose(np.ptp(means, axis=1), 0, atol=2e-3)


def test_noise_depends_on_the_picture_and_the_seed_alone():
    options = {"color_noise": 2.0, "depth_noise": 0.002}
    noise, context = make(**options)
    first, second = look(noise, context, 0.0), look(noise, context, PERIOD)
    again = look(noise, context, 0.0)
    clone = look(noise, context.Clone(), PERIOD)
    noise.SetSeed(context, 1)
    other = look(noise, context, 0.0)
    for i in range(2):
        np.testing.assert_array_equal(first[i], again[i])
        np.testing.assert_array_equal(second[i], clone[i])
        assert (first[i] != second[i]).any() and (first[i] != other[i]).any()
