"""A station as a world: pushes given from outside, by the robot, and closed loops in it."""

import numpy as np
import pytest

from gridpush_drake.dynamics.push import Push
from gridpush_drake.errors import PushRefusedError, StationError
from gridpush_drake.identification.model import Model
from gridpush_drake.planning.contact.trial import calc_goal_error
from gridpush_drake.planning.goal.push_to_goal import push_to_goal
from gridpush_drake.planning.world import PushWorld
from gridpush_drake.station.schema.scenario import PushScenario
from gridpush_drake.station.simulated.world import StationWorld
from tests.helpers.twin_bench import COARSE_BOOK


@pytest.fixture(scope="module")
def world():
    return StationWorld(PushScenario(object=COARSE_BOOK))


@pytest.mark.slow
def test_the_robot_makes_a_push_and_the_object_is_put_back(world):
    assert isinstance(world, PushWorld)
    start = world.truth.pose
    assert 0 < np.abs(world.observe() - start).max() < 0.02
    x, y = start[:2]
    push = Push((x, y - 0.15), (0.0, 0.05), 2.4, 0.008)
    seen = world.execute(push)
    end = world.truth.pose
    assert end[1] > y + 0.005
    motion = world.truth.motion
    np.testing.assert_allclose(motion.poses[0], start, atol=1e-3)
    np.testing.assert_allclose(motion.poses[-1], end, atol=1e-3)
    assert motion.times[-1] > 2.0
    np.testing.assert_allclose(seen.final_pose[:2], end[:2], atol=0.005)
    assert world.truth.bodies.params.n == world.station.obj.n

    world.put(start)
    np.testing.assert_allclose(world.truth.pose, start, atol=1e-3)
    np.testing.assert_allclose(world.observe(), start, atol=0.02)
    assert world.truth.motion is None


def test_a_push_out_of_reach_is_refused_with_the_robots_reason(world):
    made = world.pushes
    with pytest.raises(PushRefusedError, match=r"reach|joint|workspace|arm"):
        world.execute(Push((5.0, 0.0), (0.0, 0.05), 1.0, 0.008))
    assert world.pushes == made
    assert world.observe() is not None


@pytest.mark.slow
def test_a_closed_loop_reaches_its_goal_in_a_station():
    world = StationWorld(PushScenario(object="toolbox"))
    x, y, theta = world.truth.pose
    obj = world.station.obj
    goal = np.array([x + 0.02, y + 0.05, theta + 0.2])
    run = push_to_goal(world, Model(obj), goal, learner=None)
    assert run.status == "reached", run.reason
    assert calc_goal_error(obj, world.truth.pose, goal) < 0.03


def test_an_object_that_is_gone_is_not_pushed():
    world = StationWorld(PushScenario(object=COARSE_BOOK))
    world.put((0.6, 3.0, 0.0))
    assert world.truth.fallen
    assert world.observe() is None
    with pytest.raises(StationError, match="not seen"):
        world.execute(Push((0.6, -0.1), (0.0, 0.05), 1.0, 0.008))
