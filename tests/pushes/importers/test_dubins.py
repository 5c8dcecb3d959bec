import numpy as np
import pytest

from gridpush_drake.errors import PushLogError
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.pushes.importers.dubins import DubinsImporter
from tests.helpers.shapes import rectangle

HEADER = "task,repeat,t,object_x,object_y,object_theta,robot_x,robot_y,robot_theta,action"
DT = 0.1
BLOCK = GridObject.from_outline(rectangle(0.05, 0.035), max_cells=12)


def make_run(repeat, action, begin, delay_rows=2, hidden=()):
    """The fingers stand for 4 rows, push the block by 2 mm a row for 10 rows, and stand again.

    The object's pose is told two rows late, and turns through pi.
    """
    lines = []
    moved = np.concatenate([np.zeros(4), 0.002 * np.arange(1, 11), np.full(6, 0.02)])
    for k, x in enumerate(moved):
        late = moved[max(k - delay_rows, 0)]
        theta = 3.13 + late
        theta -= 2 * np.pi * (theta > np.pi)
        seen = ",," if k in hidden else f"{0.025 + late:.5f},0,{theta:.5f}"
        lines.append(f"a,{repeat},{begin + DT * k:.3f},{seen},{x - 0.0025:.5f},0,0,{action}")
    return lines


@pytest.fixture
def write(tmp_path):
    def write(*lines):
        path = tmp_path / "runs.csv"
        path.write_text("\n".join([HEADER, *lines]) + "\n")
        return path

    return write


def test_runs_are_cut_into_pushes_and_the_camera_is_late(write):
    runs = [*make_run(0, 1, 0.0), *make_run(0, 1, 5.0), *make_run(1, 2, 0.0, hidden=[8])]
    log, obj = DubinsImporter(BLOCK, object_delay=2 * DT).read(write(*runs))
    assert obj is BLOCK
    assert [seen.name for seen in log] == ["a_0_1", "a_0_2", "a_1_1"]
    for seen in log:
        assert seen.push.duration == pytest.approx(10 * DT)
        np.testing.assert_allclose(np.abs(seen.push.shape.core), [[0, 0.009]] * 2)
        # where the object was then, in front of the fingers, and its angle goes on
        tips = seen.push.tip_at(seen.t_observed)
        np.testing.assert_allclose(seen.poses_observed[:, 0] - tips[:, 0], 0.0275, atol=1e-9)
        np.testing.assert_allclose(seen.poses_observed[:, 2] - 3.13, tips[:, 0] + 0.0025, atol=2e-5)
    assert len(log[2].t_observed) == len(log[0].t_observed) - 1


def test_a_push_whose_end_is_not_seen_is_left_out(write):
    path = write(*make_run(0, 1, 0.0, hidden=range(8, 20)))
    with pytest.raises(PushLogError, match="no push is seen at its beginning and its end"):
        DubinsImporter(BLOCK).read(path)


@pytest.mark.parametrize(
    ("options", "line", "says"),
    [
        ({"obj": None}, "", "--object is missing"),
        ({}, "a,0,x,0,0,0,0,0,0,1", "line 22, column t: is 'x'; expected a finite number"),
        ({}, "a,0,9,0,,0,0,0,0,1", "line 22, column object_y: is ''"),
        ({}, "a,0,9,0,0,0,0,nan,0,1", "line 22, column robot_y: is 'nan'"),
    ],
)
def test_refuses_what_is_no_run(write, options, line, says):
    lines = [*make_run(0, 1, 0.0), *([line] if line else [])]
    with pytest.raises(PushLogError, match=says):
        DubinsImporter(**{"obj": BLOCK, **options}).read(write(*lines))


def test_refuses_options_out_of_range():
    with pytest.raises(PushLogError, match="--finger-radius: is 0"):
        DubinsImporter(BLOCK, finger_radius=0)
    with pytest.raises(PushLogError, match="--object-delay: is -1"):
        DubinsImporter(BLOCK, object_delay=-1)
