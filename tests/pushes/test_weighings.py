"""Weighings: their records and the CSV file that holds them."""

from dataclasses import replace

import numpy as np
import pytest

from gridpush_drake.errors import PushLogError, PushLogWarning
from gridpush_drake.pushes.weighings import FORCE_STD, TORQUE_STD, LiftTest, MassTestLog, TiltTest
from tests.helpers.weighed_objects import Truth, make_problem

HEADER = "kind,object_x,object_y,object_theta,place_x,place_y,force,edge_x,edge_y,edge_angle"
PRESS = "press,-0.06,0.01,0.3,0.05,0.0,4.2,0.0,0.5,0.0"
LIFT = "lift,-0.06,0.01,0.3,0.02,0.0,6.7,,,"


@pytest.fixture
def write(tmp_path):
    def write_text(text):
        path = tmp_path / "weighings.csv"
        path.write_text(text)
        return path

    return write_text


def test_round_trip_bit_for_bit(tmp_path):
    log = make_problem(Truth(0.68, np.zeros(2), 0.3), np.random.default_rng(0)).log
    rocked = replace(log.presses[0], center_shift=3e-4, free_way=0.0021, rock_force=1.7)
    log = replace(log, presses=(rocked, *log.presses[1:]))
    log.write_csv(tmp_path / "log.csv")
    back = MassTestLog.read_csv(tmp_path / "log.csv")
    assert (len(back.presses), len(back.lifts)) == (4, 1)
    for one, again in zip((*log.presses, *log.lifts), (*back.presses, *back.lifts), strict=True):
        for name in one.__dataclass_fields__:
            np.testing.assert_array_equal(getattr(one, name), getattr(again, name))
    back.write_csv(tmp_path / "again.csv")
    assert (tmp_path / "again.csv").read_bytes() == (tmp_path / "log.csv").read_bytes()


def test_columns_that_are_not_there_have_defaults(write):
    log = MassTestLog.read_csv(write(f"{HEADER}\n{PRESS}\n{LIFT}\n"))
    (press,) = log.presses
    (lift,) = log.lifts
    assert press.force_std == lift.weight_std == FORCE_STD
    assert lift.torque is None
    assert lift.torque_std == TORQUE_STD
    assert press.arm == pytest.approx(0.05)
    assert repr(log).startswith("MassTestLog: 1 edge press, 1 lift, from ")


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("", "is empty; expected the header kind"),
        (f"{HEADER}\n", "holds no weighing; expected at least one row"),
        (HEADER.replace("force", "forces") + f"\n{PRESS}", "did you mean 'force'"),
        (HEADER.replace("kind,", "") + "\n" + PRESS[6:], "column kind: is missing"),
        (HEADER.replace("kind,", "") + "\n" + PRESS[6:], "edge_angle and, if known, torque_x,"),
        (f"{HEADER},{HEADER}\n{PRESS},{PRESS}", "is there twice"),
        (f"{HEADER}\n{PRESS.replace('press', 'pull')}", "kind: is 'pull'; expected 'press' or"),
        (f"{HEADER}\n{PRESS.replace('4.2', 'much')}", "force: is 'much'; expected a finite number"),
        (
            f"{HEADER}\n{PRESS.replace('4.2', '-4.2')}",
            "line 2: press: force is -4.2; expected a po",
        ),
        (
            f"{HEADER}\n{PRESS.replace('0.05,', '-0.05,')}",
            "line 2: press: the tip is 50.0 mm inside",
        ),
        (f"{HEADER}\n{PRESS}\n{PRESS[:-3]}", "line 3, column edge_angle: is ''; expected a finite"),
        (f"{HEADER},torque_x,torque_y\n{LIFT},0.1,", "torque_y: is ''; expected a finite number"),
    ],
)
def test_what_is_wrong_is_named(write, content, says):
    path = write(content)
    with pytest.raises(PushLogError) as caught:
        MassTestLog.read_csv(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert says in message
    assert "\n" not in message


def test_further_columns_are_passed_over(write):
    with pytest.warns(PushLogWarning, match="passed over the column color"):
        log = MassTestLog.read_csv(write(f"{HEADER},color\n{PRESS},red\n"))
    assert len(log) == 1


def test_records_are_frozen_and_checked():
    press = TiltTest(np.zeros(3), np.array([0.1, 0]), 1.0, np.zeros(2), 0.0)
    with pytest.raises(ValueError, match="read-only"):
        press.pose[0] = 1.0
    with pytest.raises(PushLogError, match="edge_angle is nan"):
        TiltTest(np.zeros(3), np.array([0.1, 0]), 1.0, np.zeros(2), np.nan)
    with pytest.raises(PushLogError, match="lift: torque is"):
        LiftTest(np.zeros(3), np.zeros(2), 1.0, np.zeros(3))
    with pytest.raises(PushLogError, match="lift: weight is -1"):
        LiftTest(np.zeros(3), np.zeros(2), -1.0)
