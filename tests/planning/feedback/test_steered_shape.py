"""A plate and two fingertips are steered with their angle, as a round finger is without one."""

from dataclasses import replace

import numpy as np
import pytest

from gridpush_drake.dynamics.kernels.steering.finger_push import (
    STATE_SIZE,
    THETA,
    TIP_X,
    TIP_YAW,
    X,
    follow_tip,
)
from gridpush_drake.dynamics.physics import Physics
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.pusher import PusherShape
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import PlanningError
from gridpush_drake.geometry.se2 import transform, wrap_angle
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.feedback import (
    FollowOptions,
    FollowStatus,
    PosePath,
    PoseSensorModel,
    PushFollower,
    SteeredFinger,
    follow,
    plan_pose_path,
)
from gridpush_drake.planning.feedback.follow_log import FollowLog
from gridpush_drake.planning.feedback.pose_path import PathProgress
from gridpush_drake.planning.pushed_object import FeedbackFinger, make_model
from gridpush_drake.planning.world import SimulatedWorld
from tests.helpers.made_identifications import make_block

OBJ = make_block(12)
TRUTH = CellParameters.by_part(OBJ, {1: 0.05, 2: 0.2}, 0.4, 0.4)
PLATE = PusherShape.plate(0.04, 0.016, 0.003)
TIPS = PusherShape.discs([(0.0, -0.015), (0.0, 0.015)], 0.005)
SHAPES = {"plate": PLATE, "fingertips": TIPS}
FEW = FollowOptions(strokes=40, changes=60, refinements=2, draws=0)
SIGHT = PoseSensorModel(delay=0.1, missing=0.1)
GOAL = np.array([0.12, 0.08, 0.6])
BESIDE = np.array([-0.15, 0.0, 0.0])


def make_finger(shape, **more):
    return FeedbackFinger(radius=shape.radius, shape=shape, **more)


def steer(shape, goal, tip=BESIDE, seed=0, **more):
    """Steers a shape to a goal or along a path in a world that obeys the model."""
    finger = make_finger(shape, **more)
    follower = PushFollower(OBJ, TRUTH, goal, finger, options=FEW, seed=seed)
    world = SimulatedWorld(Model(OBJ, TRUTH), (0.0, 0.0, 0.0))
    steered = SteeredFinger(world, tip, shape.radius, SIGHT, seed, shape)
    return follow(follower, steered), steered


def measure_off(pose, goal):
    """Distance of the centroids, m, and the turn, rad."""
    middle = OBJ.p_BC.mean(axis=0)[None]
    off = transform(np.asarray(pose), middle) - transform(np.asarray(goal), middle)
    return float(np.linalg.norm(off)), abs(float(wrap_angle(pose[2] - goal[2])))


@pytest.mark.parametrize("push_height", [0.0, 0.02])
@pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)
def test_the_search_moves_the_object_as_simulate_does(shape, push_height):
    """With the loads of a push at a height, too, which shift from step to step."""
    params = replace(TRUTH, push_height=push_height)
    x = -0.064 if shape is PLATE else -0.069
    tips = np.array(
        [[x, 0.004, 0.0], [x + 0.02, 0.004, 0.1], [x + 0.04, 0.006, 0.25], [x + 0.05, 0.014, 0.3]]
    )
    push = Push.along(np.arange(4.0), tips[:, :2], shape=shape, yaw=tips[:, 2])
    model = Model(OBJ, params, Physics(regime="quasi_static"))
    expected = simulate(model, push, dt=0.01).final_pose
    # in small steps, so that what differs is not how long they are
    t = np.linspace(0.0, 3.0, 61)
    path = np.column_stack([np.interp(t, np.arange(4.0), column) for column in tips.T])
    state = np.zeros(STATE_SIZE)
    state[TIP_X : TIP_YAW + 1] = tips[0]
    pushed = make_model(OBJ, params, shape.radius, shape=shape)._replace(step=5e-4)
    follow_tip(pushed, state, path[1:])
    assert np.abs(expected).max() > 0.01
    assert state[X : THETA + 1] == pytest.approx(expected, abs=1e-4)
    assert state[TIP_X : TIP_YAW + 1] == pytest.approx(tips[-1])


def test_one_disc_as_a_shape_moves_the_object_as_a_disc_does():
    tips = np.array([[-0.055, 0.004], [-0.04, 0.006], [-0.03, 0.014]])
    poses = []
    for shape in (None, PusherShape.disc(0.01)):
        state = np.zeros(STATE_SIZE)
        state[TIP_X : TIP_X + 2] = (-0.08, 0.004)
        path = tips if shape is None else np.column_stack([tips, np.zeros(len(tips))])
        follow_tip(make_model(OBJ, TRUTH, 0.01, shape=shape), state, path)
        poses.append(state[X : THETA + 1])
    assert np.abs(poses[0]).max() > 0.01
    assert poses[1] == pytest.approx(poses[0], abs=1e-4)


def test_a_turn_in_place_moves_the_object():
    state = np.zeros(STATE_SIZE)
    state[TIP_X : TIP_YAW + 1] = (-0.062, 0.0, 0.0)
    follow_tip(
        make_model(OBJ, TRUTH, PLATE.radius, shape=PLATE), state, np.array([[-0.062, 0.0, 0.5]])
    )
    assert state[THETA] != 0.0


@pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)
def test_comes_to_a_goal_within_the_fingers_limits(shape):
    run, steered = steer(shape, GOAL, turning_speed=1.2)
    assert run.status == FollowStatus.REACHED
    distance, turn = measure_off(steered.pose, GOAL)
    assert distance < 0.002
    assert turn < np.radians(1)
    turned = np.diff(run.tips[:, 2])
    assert np.abs(turned).max() <= 1.2 * SIGHT.period + 1e-9
    assert np.abs(turned).max() > 0.0


@pytest.mark.slow
def test_follows_a_path_and_what_it_saw_is_learned_from_as_pushes():
    s = np.linspace(0.0, 0.3, 40)
    points = OBJ.p_BC.mean(axis=0) + np.column_stack([s, 0.02 * (1 - np.cos(2 * np.pi * s / 0.3))])
    path = PosePath.through(OBJ, points, 0.05)
    run, steered = steer(PLATE, path, tip=(-0.08, 0.0, 0.0))
    off = PathProgress(OBJ, path).measure_distance(
        transform(run.poses, OBJ.p_BC.mean(axis=0)[None])[:, 0]
    )
    assert run.status == FollowStatus.REACHED
    assert np.sqrt((off**2).mean()) < 2e-3
    assert measure_off(steered.pose, path.goal)[0] < 0.002


def test_a_log_cuts_what_it_saw_into_pushes_by_the_shape():
    log = FollowLog(OBJ, PLATE.radius, shape=PLATE)
    finger = make_finger(PLATE)
    world = SimulatedWorld(Model(OBJ, TRUTH), (0.0, 0.0, 0.0))
    steered = SteeredFinger(world, BESIDE, PLATE.radius, SIGHT, 0, PLATE)
    follower = PushFollower(OBJ, TRUTH, GOAL, finger, options=FEW)
    follow(follower, steered, log=log)
    pushes = log.cut()
    assert pushes
    for seen in pushes:
        assert seen.push.shape is PLATE
        assert len(seen.push.yaw) == len(seen.push.t)
    predicted = Model(OBJ, TRUTH).simulate(pushes[0].push, pushes[0].pose).final_pose
    assert predicted == pytest.approx(pushes[0].final_pose, abs=0.006)


def test_a_shape_that_looks_the_same_after_half_a_turn_never_turns_beyond_its_wrist():
    """The goal is behind the object, so that the plate has to go round it and push back."""
    fingers = PusherShape.polygon(
        [(-0.01, -0.02), (0.01, -0.02), (0.01, 0.02), (-0.01, 0.02)], 3e-3
    )
    assert fingers.period == pytest.approx(np.pi)
    assert PLATE.period == pytest.approx(2 * np.pi)
    goal = np.array([-0.1, 0.02, 0.2])
    run, steered = steer(fingers, goal, most_yaw=1.8)
    assert run.status == FollowStatus.REACHED
    assert measure_off(steered.pose, goal)[0] < 0.002
    assert np.abs(run.tips[:, 2]).max() <= 1.8 + 1e-9


def test_the_same_seed_gives_the_same_bits():
    ends = [steer(TIPS, GOAL, seed=3)[0].poses for _ in range(2)]
    assert (ends[0] == ends[1]).all()


def test_a_path_is_planned_for_a_plate():
    plan = plan_pose_path(
        Model(OBJ, TRUTH), (0.0, 0.0, 0.0), (0.25, 0.1, 0.4), make_finger(PLATE), speed=0.05
    )
    assert plan.path is not None, plan.reason
    assert measure_off(plan.path.goal, (0.25, 0.1, 0.4))[0] == pytest.approx(0.0, abs=1e-9)


def test_refuses_what_makes_no_sense():
    with pytest.raises(
        PlanningError, match=r"finger: radius is 0\.01; expected 0\.003, the shape's"
    ):
        FeedbackFinger(radius=0.01, shape=PLATE)
    with pytest.raises(PlanningError, match="finger: turning_speed"):
        make_finger(PLATE, turning_speed=0.0)
    with pytest.raises(PlanningError, match="finger: most_yaw"):
        make_finger(PLATE, most_yaw=-1.0)
    world = SimulatedWorld(Model(OBJ, TRUTH), (0.0, 0.0, 0.0))
    with pytest.raises(PlanningError, match="tip"):
        SteeredFinger(world, (0.0, 0.0), PLATE.radius, shape=PLATE)
    follower = PushFollower(OBJ, TRUTH, GOAL, make_finger(PLATE), options=FEW)
    with pytest.raises(PlanningError, match="tip"):
        follower.decide(0.0, (0.0, 0.0))
