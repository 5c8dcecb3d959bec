"""The default steps."""

import numpy as np
import pytest

from gridpush_drake.dynamics import DEFAULT_DT, DEFAULT_TIP_STEP, Push, make_path_times
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.objects.parameters import CellParameters
from tests.helpers.shapes import make_shape

SPEEDS = np.concatenate([np.geomspace(0.003, 0.6, 200), 0.05 * (1 + np.linspace(-1e-3, 1e-3, 21))])


@pytest.mark.parametrize("length", [0.0123, 0.1, 0.2])
def test_the_default_step_is_a_continuous_function_of_the_speed(length):
    for speed in SPEEDS:
        push = Push((0.0, 0.0), (speed, 0.0), length / speed, 0.01)
        times = make_path_times(push)
        steps, longest = np.diff(times), min(DEFAULT_DT, DEFAULT_TIP_STEP / speed)
        assert times[0] == 0.0
        assert times[-1] == push.duration
        np.testing.assert_allclose(steps[:-2], longest, rtol=1e-7)
        assert steps.max() <= longest * (1 + 1e-7)
        assert steps[-2:].min() >= 0.5 * longest * (1 - 1e-7)


def test_where_the_number_of_steps_changes_the_motion_hardly_does():
    """Around 0.05 m/s a push of 0.1 m takes 200 steps or 201."""
    obj = make_shape("square", 36)
    params, poses, counts = CellParameters.uniform(obj, 1.0, 0.4, 0.2), [], []
    for speed in (0.05 * (1 - 1e-6), 0.05, 0.05 * (1 + 1e-6)):
        motion = simulate(obj, params, Push((-0.055, 0.02), (speed, 0.0), 0.1 / speed, 0.005))
        poses.append(motion.final_pose)
        counts.append(len(motion.times) - 1)
    assert counts == [201, 200, 200]
    np.testing.assert_allclose(poses[0], poses[1], rtol=0, atol=1e-6)
    np.testing.assert_allclose(poses[2], poses[1], rtol=0, atol=1e-6)
