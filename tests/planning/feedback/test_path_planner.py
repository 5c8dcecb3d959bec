"""Paths among obstacles that a finger can push an object along."""

import numpy as np
import pytest
from shapely import box

from gridpush_drake.errors import PlanningError
from gridpush_drake.geometry.se2 import transform_shape
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.contact.trial import calc_goal_error
from gridpush_drake.planning.feedback import (
    FollowOptions,
    FollowStatus,
    PushFollower,
    SteeredFinger,
    follow,
    plan_pose_path,
)
from gridpush_drake.planning.goal.cost_to_go import CostToGo
from gridpush_drake.planning.push_constraints import PushConstraints
from gridpush_drake.planning.pushed_object import FeedbackFinger
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.planning.world import SimulatedWorld
from tests.helpers.made_identifications import make_block

OBJ = make_block(12)
TRUTH = CellParameters.by_part(OBJ, {1: 0.05, 2: 0.2}, 0.4, 0.4)
FINGER = FeedbackFinger(radius=0.01)
TABLE = SupportSurface.rectangle((0.2, 0.0), (0.9, 0.6))
WALL = box(0.18, -0.3, 0.22, 0.06)
RULES = PushConstraints(TABLE, (WALL,))
START = np.array([0.0, -0.05, 0.0])
GOAL = np.array([0.4, -0.05, 0.0])


def plan(rules=RULES, goal=GOAL, **more):
    return plan_pose_path(Model(OBJ, TRUTH), START, goal, FINGER, rules, **{"speed": 0.05, **more})


@pytest.mark.slow
def test_a_path_leads_round_a_wall_and_is_followed_to_its_end():
    found = plan()
    assert found.status == FollowStatus.PUSHING
    poses = found.path.poses
    assert poses[0] == pytest.approx(START)
    assert poses[-1] == pytest.approx(GOAL)
    for pose in poses:
        outline = transform_shape(pose, OBJ.outline)
        assert outline.distance(WALL) > RULES.obstacle_margin
        assert TABLE.polygon.covers(outline)
    # a pose is a push away from the one before
    assert calc_goal_error(OBJ, poses[1:-1], poses[0])[0] < 0.02
    steered = SteeredFinger(
        SimulatedWorld(Model(OBJ, TRUTH), START), (-0.1, -0.05), FINGER.radius, seed=3
    )
    options = FollowOptions(strokes=40, changes=60, draws=0)
    follower = PushFollower(
        OBJ, TRUTH, found.path, FINGER, constraints=RULES, options=options, seed=1
    )
    run = follow(follower, steered)
    assert run.status == FollowStatus.REACHED
    for pose in run.poses[::5]:
        assert transform_shape(pose, OBJ.outline).distance(WALL) > 0.0
    assert calc_goal_error(OBJ, steered.pose, GOAL) < 0.003


def test_without_obstacles_a_path_is_little_longer_than_need_be():
    found = plan(PushConstraints())
    way = np.linalg.norm(np.diff(found.path.poses[:, :2], axis=0), axis=1).sum()
    assert found.status == FollowStatus.PUSHING
    assert 0.4 <= way < 0.6


@pytest.mark.parametrize(
    ("rules", "goal", "status"),
    [
        (RULES, [0.9, 0.0, 0.0], FollowStatus.GOAL_OFF_TABLE),
        (RULES, [0.2, 0.0, 0.0], FollowStatus.GOAL_BLOCKED),
        (PushConstraints(TABLE, (box(0.18, -0.3, 0.22, 0.3),)), GOAL, FollowStatus.PATH_BLOCKED),
    ],
)
def test_says_why_there_is_no_path(rules, goal, status):
    found = plan(rules, goal)
    assert found.path is None
    assert found.status == status
    assert found.reason.endswith(".")


def test_refuses_what_makes_no_sense():
    with pytest.raises(PlanningError, match="speed"):
        plan(speed=0.0)
    with pytest.raises(PlanningError, match="goal"):
        plan(goal=(0.0, 0.0))


def test_costs_are_estimated_as_the_lattice_has_them():
    cost_to_go = CostToGo(OBJ, START, GOAL, RULES.start_at(OBJ, START, FINGER.radius))
    poses = np.array([START, [0.0, 0.1, 0.0], [0.2, 0.2, 0.0], [0.2, -0.1, 0.0], [9.0, 0.0, 0.0]])
    found = cost_to_go.estimate_costs(poses)
    exact = [cost_to_go.calc_cost(pose) for pose in poses[:3]]
    assert found[:3] == pytest.approx(exact, abs=0.06)
    assert np.isinf(found[3:]).all()
    free = CostToGo(OBJ, START, GOAL, PushConstraints().start_at(OBJ, START, FINGER.radius))
    assert free.estimate_costs(poses) == pytest.approx(calc_goal_error(OBJ, poses, GOAL))
