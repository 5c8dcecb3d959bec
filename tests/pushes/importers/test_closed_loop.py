import json

import numpy as np
import pytest

from gridpush_drake.dynamics.push import Push
from gridpush_drake.errors import PushLogError, PushLogWarning
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import PhysicalPrior
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.pushes.importers.closed_loop import ClosedLoopImporter

RADIUS, SPEED = 0.005, 0.04
DT = 1e-3
"""Period of the controller, s; the object is seen anew in every fourth one."""


@pytest.fixture(scope="module")
def model():
    side = 0.045 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    prior = PhysicalPrior(pusher_radius=RADIUS)
    obj = GridObject.from_outline(side, max_cells=36, name="square", prior=prior)
    return Model(obj, CellParameters.uniform(obj))


@pytest.fixture(scope="module")
def run(model):
    """Pushed for 3 s along a bow, moved by a hand while the tip is away, and pushed for 1 s."""
    poses, tips = [], []

    def push(pose, duration, swing):
        t = np.arange(0.0, duration + DT / 2, DT)
        start = np.array([pose[0] - 0.045 - RADIUS, pose[1] + 0.01])
        tip = start + np.column_stack([SPEED * t, swing * np.sin(2 * t)])
        path = Push.along(t, tip, RADIUS)
        seen = model.simulate(path, pose, times=t[::4]).poses
        poses.extend(np.repeat(seen, 4, axis=0)[: len(t)])
        tips.extend(tip)

    push(np.zeros(3), 3.0, 0.004)
    last = poses[-1]
    hand = last + np.linspace(0, 1, 1000)[:, None] * ([0.05, 0.02, 0.0] - last * [0, 0, 1])
    poses.extend(np.repeat(hand[::4], 4, axis=0))
    tips.extend(np.full((1000, 2), -0.3))
    push(poses[-1], 1.0, 0.0)
    return np.array(poses), np.array(tips)


def write(path, poses, tip, **changes):
    data = {
        "timeJSON": (DT * np.arange(len(poses))).tolist(),
        "q_sliderJSON": poses.T.tolist(),
        "q_pusher_sensedJSON": tip.T.tolist(),
        "u_controlJSON": [[0.0]],
    }
    path.write_text(json.dumps({**data, **changes}))
    return path


def test_windows_are_pushes_as_the_model_makes_them_and_a_hand_is_left_out(model, run, tmp_path):
    poses, tip = run
    path = write(tmp_path / "run.json", poses, tip)
    data = json.loads(path.read_text())
    # as the program that wrote it was ended: some entries are null, and one list goes on
    data["q_pusher_sensedJSON"][0][700] = None
    data["timeJSON"].append(99.0)
    path.write_text(json.dumps(data))
    with pytest.warns(PushLogWarning, match="1 window left out, in which the object moves though"):
        log, obj = ClosedLoopImporter(obj=model.obj).read(path)
    assert obj is model.obj and len(log) == 4
    for seen in log:
        assert seen.push.duration == pytest.approx(1.0, abs=0.01)
        predicted = model.simulate(seen.push, seen.pose).poses[-1]
        # The steps of a simulation begin anew with each window.
        np.testing.assert_allclose(predicted[:2], seen.final_pose[:2], atol=1e-4)
        np.testing.assert_allclose(predicted[2], seen.final_pose[2], atol=2e-3)
    # They follow one another, as the run was one.
    np.testing.assert_allclose(log[0].final_pose, log[1].pose)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"timeJSON": None}, "run.json: timeJSON: expected a list of numbers"),
        ({"q_sliderJSON": [[0.0], [0.0]]}, "q_sliderJSON: expected 3 lists"),
        ({"q_pusher_sensedJSON": [[0.0], ["a"]]}, "q_pusher_sensedJSON: entry 1 is 'a'"),
        ({"timeJSON": [0.0, 1e300]}, "timeJSON: entry 2 is '1e[+]300'; expected a finite number"),
        ({"timeJSON": [0.0]}, "has 1 whole rows; expected two or more"),
    ],
)
def test_what_is_no_run_is_refused(model, run, tmp_path, changes, message):
    path = write(tmp_path / "run.json", *run, **changes)
    with pytest.raises(PushLogError, match=message):
        ClosedLoopImporter(obj=model.obj).read(path)


def test_a_tip_that_never_comes_near_pushes_in_no_window(model, run, tmp_path):
    poses, tip = run
    path = write(tmp_path / "run.json", poses, tip + 0.5)
    with pytest.raises(PushLogError, match="pushes square in no window of 1 s"):
        ClosedLoopImporter(obj=model.obj).read(path)
    with pytest.raises(PushLogError, match="--window: is 0"):
        ClosedLoopImporter(obj=model.obj, window=0.0).read(path)
    path.write_text("{")
    with pytest.raises(PushLogError, match="is no JSON"):
        ClosedLoopImporter(obj=model.obj).read(path)
