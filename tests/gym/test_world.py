"""An episode of a Gymnasium environment as a world of closed loops."""

import numpy as np
import pytest

from gridpush_drake.errors import PlanningError
from gridpush_drake.gym import EnvironmentWorld, PushEnvironment
from gridpush_drake.planning import PushWorld
from gridpush_drake.planning.contact.trial import calc_goal_error


def make_push(world, place=0.2, distance=-0.4):
    return world.episode.shape.make_push(np.array([place, 0.0, distance]), world.observe())


def test_an_episode_is_a_world():
    world = EnvironmentWorld(PushEnvironment("PushToGoal"), 3)
    assert isinstance(world, PushWorld)
    before = world.truth
    assert before.motion is None
    assert 0 < np.abs(world.observe() - before.pose).max() < 0.02
    seen = world.execute(make_push(world))
    after = world.truth
    assert np.linalg.norm(after.pose[:2] - before.pose[:2]) > 0.005
    np.testing.assert_array_equal(after.motion.poses[-1], after.pose)
    np.testing.assert_array_equal(seen.final_pose, world.observe())
    assert after.motion.times[-1] == pytest.approx(seen.push.duration)
    assert world.reward != 0.0
    np.testing.assert_array_equal(after.bodies.params.mass, world.episode.hidden.mass)


@pytest.mark.parametrize("game", ["PushToGoal", "SlideToEdge", "Explore"])
def test_the_object_is_put_elsewhere_and_the_score_is_measured_anew(game):
    world = EnvironmentWorld(PushEnvironment(game), 3)
    score = world.episode.score
    world.execute(make_push(world))
    made = len(world.episode.pushes)
    world.put((0.05, -0.1, 0.7))
    np.testing.assert_array_equal(world.truth.pose, [0.05, -0.1, 0.7])
    assert 0 < np.abs(world.observe() - world.truth.pose).max() < 0.02
    assert world.truth.motion is None
    assert len(world.episode.pushes) == made
    assert np.isfinite(world.episode.score)
    if game == "PushToGoal":
        episode = world.episode
        expected = calc_goal_error(episode.shape.obj, episode.true_pose, episode.goal)
        assert episode.score == pytest.approx(float(expected))
        world.put(episode.goal)
        assert world.episode.score == pytest.approx(0.0, abs=1e-9)
    assert score != world.episode.score
    with pytest.raises(PlanningError, match="pose"):
        world.put((np.nan, 0.0, 0.0))


def test_an_episode_that_is_over_is_not_seen_and_not_pushed():
    world = EnvironmentWorld(PushEnvironment("SlideToEdge", max_pushes=1), 3)
    push = make_push(world)
    world.execute(push)
    assert world.over
    assert world.observe() is None
    with pytest.raises(PlanningError, match="the episode is over"):
        world.execute(push)


@pytest.mark.parametrize("game", ["Rearrange", "Follow"])
def test_a_game_of_other_actions_is_no_world_of_one_object(game):
    with pytest.raises(PlanningError, match=f"game: {game}; expected one whose actions push one"):
        EnvironmentWorld(PushEnvironment(game), 0)
