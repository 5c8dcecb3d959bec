"""Logs of several objects: what is written is read back, and and of one."""

from dataclasses import replace

import numpy as np
import pytest

from gridpush_drake.dynamics.push import Push
from gridpush_drake.errors import PushLogError
from gridpush_drake.identification.model import Model
from gridpush_drake.pushes.observed_push import ObservedPush
from gridpush_drake.pushes.push_log import PushLog
from tests.helpers.shapes import make_shape


def make_log():
    rng = np.random.default_rng(0)
    pushes = []
    for i in range(3):
        push = Push(rng.normal(size=2), rng.normal(size=2), 1.5, 0.008)
        times = np.array([0.5, 1.0, 1.5])
        pushes.append(
            ObservedPush(
                f"push {i}", push, rng.uniform(-1, 1, (2, 3)), times, rng.uniform(-1, 1, (3, 2, 3))
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
    np.testing.assert_array_equal(read[0].poses_observed, seen.poses_observed)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("push,t,tip_x,tip_y\n", "object_x: is missing"),
        ("push,t,tip_x,a_x,a_y,a_theta\n", "column tip_y: is missing"),
        ("push,t,tip_x,tip_y,a_x,a_theta,b_x,b_y,b_theta\n", "column a_y: is missing"),
        ("push,t,tip_x,tip_y,a_x,a_y,a_theta\n", "holds no push"),
        ("push,t,tip_x,tip_y,a_x,a_y,a_theta\nq,0,0,0,,,\nq,1,1,0,0,0,0\n", "line 2.*is empty"),
        ("push,t,tip_x,tip_y,a_x,a_y,a_theta\nq,0,0,0,0,0,0\nq,1,1,0,0,x,0\n", "line 3.*a_y.*'x'"),
        (
            "push,t,tip_x,tip_y,a_x,a_y,a_theta\nq,0,0,0,0,0,0\nq,1,1,0,,,\n",
            "line 3, column a_x: is empty",
        ),
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


def test_forces_and_the_edge_are_kept(tmp_path):
    (first, *others) = make_log()
    times = np.array([0.2, 0.4])
    felt = replace(first, force_t=times, force=np.ones((2, 2)), overhang=True)
    table = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0]])
    PushLog((felt, *others), table=table, names=("a", "b")).write_csv(tmp_path / "log.csv")
    read = PushLog.read_csv(tmp_path / "log.csv")
    np.testing.assert_array_equal(read[0].force, felt.force)
    np.testing.assert_array_equal(read.table, table)
    assert read[0].overhang and not read[1].overhang and read.names == ("a", "b")


def test_whoever_knows_one_object_refuses_a_log_of_several(tmp_path):
    path = tmp_path / "several.csv"
    make_log().write_csv(path)
    with pytest.raises(PushLogError, match=r"of 2 objects \(hammer, bag\); expected 1: .* --with"):
        Model(make_shape("square", 20)).predict(path)
    one = PushLog.read_csv(path).single_out(1)
    assert one.names == ("bag",) and one[0].pose.shape == (3,)
