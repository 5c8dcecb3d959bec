"""Logs of several objects: what is written is read back, and a push log of one object is one, too."""

import numpy as np
import pytest

from gridpush_drake.dynamics.push import Push
from gridpush_drake.errors import PushLogError
from gridpush_drake.pushes.observed_push import ObservedPush
from gridpush_drake.pushes.push_log import PushLog


def make_log():
    rng = np.random.default_rng(0)
    pushes = []
    for i in range(3):
        push = Push(rng.normal(size=2), rng.normal(size=2), 1.5, 0.008)
        times = np.array([0.5, 1.0, 1.5])
        pushes.append(
            ObservedPush(
                f"push {i}", push, rng.normal(size=(2, 3)), times, rng.normal(size=(3, 2, 3))
            )
        )
    return PushLog(tuple(pushes), names=("hammer", "bag"))


def test_what_is_written_is_read_back(tmp_path):
    log = make_log()
    log.write_csv(tmp_path / "log.csv")
    read = PushLog.read_csv(tmp_path / "log.csv", radius=0.008)
    assert read.names == log.names
    for mine, theirs in zip(read, log, strict=True):
        assert mine.name == theirs.name
        np.testing.assert_array_equal(mine.pose, theirs.pose)
        np.testing.assert_array_equal(mine.t_observed, theirs.t_observed)
        np.testing.assert_array_equal(mine.poses_observed, theirs.poses_observed)
        np.testing.assert_array_equal(mine.push.tip_at([0.0, 1.5]), theirs.push.tip_at([0.0, 1.5]))


def test_a_push_log_of_one_object_is_a_scene_log_of_one(tmp_path):
    push = Push((0, 0), (0.1, 0), 1.0, 0.008)
    seen = ObservedPush("a", push, np.zeros(3), np.array([1.0]), np.array([[0.1, 0.0, 0.2]]))
    PushLog((seen,)).write_csv(tmp_path / "log.csv")
    read = PushLog.read_csv(tmp_path / "log.csv")
    assert read.names == ("object",)
    np.testing.assert_array_equal(read[0].poses_observed[:, 0], seen.poses_observed)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("push,t,tip_x,tip_y\n", "NAME_x: is missing"),
        ("push,t,tip_x,a_x,a_y,a_theta\n", "column tip_y: is missing"),
        ("push,t,tip_x,tip_y,a_x,a_theta\n", "column a_y: is missing"),
        ("push,t,tip_x,tip_y,a_x,a_y,a_theta\n", "holds no push"),
        ("push,t,tip_x,tip_y,a_x,a_y,a_theta\nq,0,0,0,,,\nq,1,1,0,0,0,0\n", "line 2.*is empty"),
        ("push,t,tip_x,tip_y,a_x,a_y,a_theta\nq,0,0,0,0,0,0\nq,1,1,0,0,x,0\n", "line 3.*a_y.*'x'"),
        ("push,t,tip_x,tip_y,a_x,a_y,a_theta\nq,0,0,0,0,0,0\nq,1,1,0,,,\n", "t_observed"),
    ],
)
def test_what_is_refused(tmp_path, text, message):
    (tmp_path / "log.csv").write_text(text)
    with pytest.raises(PushLogError, match=message) as caught:
        PushLog.read_csv(tmp_path / "log.csv")
    assert "log.csv" in str(caught.value)


def test_pushes_of_other_objects_are_refused():
    log = make_log()
    with pytest.raises(PushLogError, match="2 objects; expected 1"):
        PushLog(log.pushes, names=("hammer",))


def test_a_log_of_several_objects_is_no_push_log(tmp_path):
    path = tmp_path / "scene.csv"
    path.write_text(
        "push,t,tip_x,tip_y,cup_x,cup_y,cup_theta,can_x,can_y,can_theta\n"
        "one,0,0,0,0,0,0,1,0,0\none,1,0.1,0,0.1,0,0,1,0,0\n"
    )
    with pytest.raises(PushLogError, match=r"several objects, cup, can; .* --with"):
        PushLog.read_csv(path)
    assert PushLog.read_csv(path).names == ("cup", "can")
