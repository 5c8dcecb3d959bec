import numpy as np
import pytest
from matplotlib.patches import Circle

from gridpush_drake.dynamics.push import Push
from gridpush_drake.planning.contact.trial import calc_goal_error
from gridpush_drake.report.draw import to_png
from gridpush_drake.report.plan_figures import draw_push_run
from tests.helpers.shapes import make_shape

POSES = [(0.0, 0.0, 0.0), (0.05, 0.0, 0.3), (0.1, 0.02, 0.6)]
GOAL = (0.1, 0.03, 0.7)


@pytest.mark.parametrize("count", [0, 1, 2])
def test_shows_every_push_and_the_errors(count):
    obj = make_shape("claw_hammer", 20)
    pushes = [Push((-0.1, 0.05 * i), (0.1, 0.0), 1.0, 0.008) for i in range(count)]
    figure = draw_push_run(obj, POSES[: count + 1], pushes, GOAL, expected=[0.02] * count, tolerance=0.02)
    way, errors = figure.axes
    circles = [patch for patch in way.patches if isinstance(patch, Circle)]
    assert [circle.center for circle in circles] == [tuple(push.start) for push in pushes]
    np.testing.assert_allclose(errors.lines[0].get_ydata(), 1e3 * calc_goal_error(obj, POSES[: count + 1], GOAL))
    for push in pushes:
        low, high = way.get_xlim()
        assert low < push.xy[:, 0].min() and push.xy[:, 0].max() < high
    assert to_png(figure).startswith(b"\x89PNG")
