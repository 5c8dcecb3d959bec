"""What was seen while a finger was steered is learned from, as pushes whose paths are curved."""

import numpy as np
import pytest

from gridpush_drake.errors import PlanningError
from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.prediction import calc_final_errors, predict
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.feedback import (
    FollowLog,
    FollowOptions,
    PoseSensorModel,
    PushFollower,
    SeenPose,
    SteeredFinger,
    follow,
)
from gridpush_drake.planning.loop_run import Learner
from gridpush_drake.planning.pushed_object import FeedbackFinger
from gridpush_drake.planning.world import SimulatedWorld
from gridpush_drake.pushes.push_log import PushLog
from tests.helpers.made_identifications import make_block

OBJ = make_block(12)
TRUTH = CellParameters.by_part(OBJ, {1: 0.03, 2: 0.3}, 0.4, 0.4)
EVEN = CellParameters.uniform(OBJ)
FINGER = FeedbackFinger(radius=0.01)
FEW = FollowOptions(strokes=40, changes=60, draws=0)
SHARP = PoseSensorModel(position_std=1e-4, angle_std=5e-4)
GOAL = (0.12, 0.08, 0.6)


def steer(**more):
    """Steers to one goal, with the even model to begin with; returns follower, log and run."""
    steered = SteeredFinger(
        SimulatedWorld(Model(OBJ, TRUTH), np.zeros(3)), (-0.15, 0.0), FINGER.radius, SHARP, 2
    )
    follower = PushFollower(OBJ, EVEN, GOAL, FINGER, options=FEW)
    log = FollowLog(OBJ, FINGER.radius)
    run = follow(follower, steered, 30.0, log=log, **more)
    return follower, log, run


def calc_mean_error(params, log):
    errors = calc_final_errors(OBJ, predict(Model(OBJ, params), log, "quasi_static"), log)
    return np.mean([error.cell for error in errors])


def test_pieces_are_curved_and_tell_of_the_object(tmp_path):
    _, log, _ = steer()
    pushes = log.cut()
    assert len(pushes) >= 2
    assert any(len(seen.push.t) > 10 for seen in pushes)
    bent = [
        np.linalg.norm(seen.push.xy[-1] - seen.push.xy[0]) < 0.98 * seen.push.length
        for seen in pushes
    ]
    assert any(bent)
    made = PushLog(tuple(pushes))
    # the truth explains what was seen, and what is learned of it does nearly as well
    assert calc_mean_error(TRUTH, made) < 1e-3
    found = identify(Model(OBJ), made, regime="quasi_static")
    assert calc_mean_error(found.params, made) < 0.5 * calc_mean_error(EVEN, made)
    # a file keeps them as they are
    made.write_csv(tmp_path / "pieces.csv")
    again = PushLog.read_csv(tmp_path / "pieces.csv", FINGER.radius)
    assert [seen.name for seen in again] == [seen.name for seen in made]
    assert again[0].push.xy == pytest.approx(made[0].push.xy, abs=1e-6)
    assert again[0].poses_observed == pytest.approx(made[0].poses_observed, abs=1e-6)


def test_the_model_is_learned_while_the_finger_is_steered():
    follower, log, run = steer(learner=Learner())
    assert run.learned >= 1
    assert run.identification.push_names[0] == "piece_1"
    loads = run.identification.params
    assert follower.model.body.k == pytest.approx(loads.friction * loads.mass * 9.81)
    made = PushLog(tuple(log.cut()))
    assert calc_mean_error(loads, made) < calc_mean_error(EVEN, made)


def test_what_moves_nothing_is_no_push():
    log = FollowLog(OBJ, FINGER.radius)
    for k in range(100):
        log.add_tip(0.02 * k, np.array([-0.3, 0.004 * k]))
        log.add_pose(SeenPose(0.02 * k, np.zeros(3)))
    assert log.cut() == []
    # nor is a shove, with the finger at rest
    still = FollowLog(OBJ, FINGER.radius)
    for k in range(100):
        still.add_tip(0.02 * k, np.array([-0.3, 0.0]))
        still.add_pose(SeenPose(0.02 * k, np.array([0.001 * k, 0.0, 0.0])))
    assert still.cut() == []
    with pytest.raises(PlanningError, match="log: radius"):
        FollowLog(OBJ, 0.0)
