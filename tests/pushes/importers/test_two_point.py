import numpy as np
import pytest

from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import PushLogError
from gridpush_drake.geometry.se2 import compose, invert
from gridpush_drake.identification.model import Model
from gridpush_drake.pushes.importers.cmu import triangle_block
from gridpush_drake.pushes.importers.two_point import TWO_TIPS, TwoPointImporter
from gridpush_drake.pushes.push_log import PushLog
from tests.helpers.shared_data import observe_two_point
from tests.helpers.two_tip_logs import describe_two_point, write_two_point

BEFORE = np.array([0.5, -0.2, 0.4])
AFTER = np.array([0.51, -0.19, 0.5])
ROWS = 5


def make_push(name, usable=1, angle=0.17):
    return describe_two_point(name, BEFORE, AFTER, angle, usable=usable, rows=ROWS)


@pytest.fixture
def write(tmp_path):
    return lambda *pushes: write_two_point(tmp_path / "pushes.txt", list(pushes))


def test_pushes_are_in_the_initial_object_frame(write):
    path = write(make_push("0101_1200_00"), make_push("0101_1200_01", usable=0))
    log, obj = TwoPointImporter(shuffle=False).read(path)
    assert (len(log), obj.name) == (1, "triangle_block")
    seen = log[0]
    push = seen.push
    np.testing.assert_array_equal(push.shape.core, TWO_TIPS.core)
    np.testing.assert_allclose(push.xy[0], (-0.05, 0.0), atol=1e-12)
    np.testing.assert_allclose(push.yaw, np.linspace(0, 0.17, ROWS), atol=1e-12)
    np.testing.assert_allclose(
        push.xy[-1] - (-0.05, 0.1), 0.1 * np.array([np.sin(0.17), -np.cos(0.17)])
    )
    np.testing.assert_allclose(seen.final_pose, compose(invert(BEFORE), AFTER), atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(seen.force, axis=1), [0, np.hypot(0.5, 0.25)])


def test_the_log_goes_through_its_file(write, tmp_path):
    log, _ = TwoPointImporter().read(write(make_push("a_0"), make_push("a_1", angle=-0.1)))
    log.write_csv(tmp_path / "log.csv")
    again = PushLog.read_csv(tmp_path / "log.csv")
    for mine, theirs in zip(log, again, strict=True):
        assert mine.push.radius == theirs.push.radius
        assert mine.push.shape.joined == theirs.push.shape.joined
        np.testing.assert_array_equal(mine.push.shape.core, theirs.push.shape.core)
        times = theirs.push.t
        np.testing.assert_array_equal(mine.push.yaw_at(times), theirs.push.yaw)
        np.testing.assert_array_equal(mine.push.tip_at(times), theirs.push.xy)


@pytest.mark.parametrize(
    ("line", "text", "says"),
    [
        (2, "0101 rotation 1", "line 2: is '0101 rotation 1'; expected push 1: name, rotation"),
        (3, "1 2", "line 3: is '1 2'; expected push 1: the block's pose before, x y theta"),
        (5, "1 2", "line 5: is '1 2'; expected push 1: the command"),
        (6, "x", "line 6: is 'x'; expected push 1: the number of tool rows"),
    ],
)
def test_refuses_other_lines(write, line, text, says):
    push = make_push("0101_1200_00")
    push[line - 2] = text
    with pytest.raises(PushLogError, match=says):
        TwoPointImporter().read(write(push))


def test_stable_pushes_of_the_real_block_go_with_the_tool():
    model = Model(triangle_block())
    slips = []
    for seen, stayed in observe_two_point("feet_30_90", slice(0, 40)):
        if stayed:
            end = simulate(model, seen.push, seen.pose).final_pose
            slips.append(np.linalg.norm(end[:2] - seen.final_pose[:2]))
    assert len(slips) >= 10
    assert np.median(slips) < 0.002
