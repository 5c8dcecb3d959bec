import numpy as np
import pytest

from gridpush_drake.dynamics.physics import Physics
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import PushLogError
from gridpush_drake.geometry.se2 import compose
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.prediction import predict
from gridpush_drake.identification.statistics.problem import resolve_physics
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.pushes.importers.dubins import DubinsImporter
from tests.helpers.shapes import rectangle
from tests.helpers.two_tip_logs import DELAY_ROWS, ROW_TIME, RUNS_HEADER, simulate_run

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
        path.write_text("\n".join([RUNS_HEADER, *lines]) + "\n")
        return path

    return write


def test_runs_are_cut_into_pushes_and_the_camera_is_late(write):
    runs = [*make_run(0, 1, 0.0), *make_run(0, 1, 5.0), *make_run(1, 2, 0.0, hidden=[8])]
    log, obj = DubinsImporter(BLOCK, object_delay=2 * DT, calibrate=False).read(write(*runs))
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


def test_the_cameras_frame_is_found_where_the_fingers_lie_on_the_outline(write):
    X_RC = np.array([0.002, -0.0015, 0.004])
    model = Model(BLOCK)
    turns = ([0.3, -0.3], [-0.3, 0.2], [0.25, -0.3])
    runs = [simulate_run(model, "a", i, some, X_RC) for i, some in enumerate(turns)]
    path = write(*(line for run in runs for line in run))
    delay = DELAY_ROWS * ROW_TIME
    log, _ = DubinsImporter(BLOCK, object_delay=delay).read(path)
    raw, _ = DubinsImporter(BLOCK, object_delay=delay, calibrate=False).read(path)
    for seen, told in zip(log, raw, strict=True):
        expected = compose(X_RC, told.final_pose)
        assert np.linalg.norm(expected[:2] - told.final_pose[:2]) > 0.001
        assert np.linalg.norm(expected[:2] - seen.final_pose[:2]) < 0.0005
        # what is predicted from there agrees with what was seen
        end = simulate(model, seen.push, seen.pose, regime="quasi_static").final_pose
        assert np.linalg.norm(end[:2] - seen.final_pose[:2]) < 0.0005


def test_runs_by_fingers_that_are_fast_are_learned_from_as_slow_ones(write):
    lines = simulate_run(Model(BLOCK), "a", 0, [0.3, -0.3], np.zeros(3))
    log, obj = DubinsImporter(BLOCK, object_delay=DELAY_ROWS * ROW_TIME).read(write(*lines))
    assert resolve_physics(Physics(), obj, log).regime == "quasi_static"
    motions = predict(Model(obj), log)
    for motion, seen in zip(motions, log, strict=True):
        np.testing.assert_allclose(motion.poses[-1], seen.final_pose, atol=1e-3)


def test_refuses_options_out_of_range():
    with pytest.raises(PushLogError, match="--finger-radius: is 0"):
        DubinsImporter(BLOCK, finger_radius=0)
    with pytest.raises(PushLogError, match="--object-delay: is -1"):
        DubinsImporter(BLOCK, object_delay=-1)
