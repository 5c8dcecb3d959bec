"""The game with several objects: what a push is worth, and what is refused."""

import numpy as np
import pytest

from gridpush_drake.dynamics.pusher import Pusher
from gridpush_drake.errors import PlanningError
from gridpush_drake.gym import PushEnvironment
from gridpush_drake.gym.environments import PICTURE_SIZE
from gridpush_drake.planning.belief import Belief
from gridpush_drake.planning.scene.rearrangement import RearrangeOptions, RearrangePlanner
from gridpush_drake.planning.scene.search import SceneSearchOptions


def test_a_seed_gives_an_episode_bit_for_bit():
    runs = []
    for _ in range(2):
        environment = PushEnvironment("Rearrange", count=2)
        seen, _ = environment.reset(seed=5)
        environment.action_space.seed(1)
        parts = [seen["poses"]]
        for _ in range(3):
            seen, *_ = environment.step(environment.action_space.sample())
            parts.append(seen["poses"])
        runs.append(np.array(parts))
    np.testing.assert_array_equal(*runs)
    assert np.ptp(runs[0], axis=0).max() > 0.01


@pytest.mark.slow
def test_our_planner_wins_by_the_games_actions():
    environment = PushEnvironment(
        "Rearrange", "rgb_array", count=2, position_std=0.0, angle_std=0.0
    )
    environment.reset(seed=3)
    objects = environment.episode.objects
    search = SceneSearchOptions(
        candidates=24, firsts=3, seconds=8, lengths=(0.008, 0.14), pusher=Pusher(0.01, 0.05)
    )
    planner = RearrangePlanner(objects, environment.episode.goals, RearrangeOptions(search=search))
    belief = Belief.of_even_objects(objects, sample_count=2)
    total, ended, steps = 0.0, False, []
    first = environment.render()
    while not ended:
        decision = planner.decide(environment.episode.seen, belief, steps)
        action = environment.episode.find_action(decision.body, decision.push)
        _, reward, terminated, truncated, info = environment.step(action)
        total += reward
        ended = terminated or truncated
    assert info["is_success"] and terminated and total > 0
    picture = environment.render()
    assert picture.shape == (PICTURE_SIZE, PICTURE_SIZE, 3)
    assert (picture != first).any()


def test_what_is_refused():
    with pytest.raises(PlanningError, match="count is 0"):
        PushEnvironment("Rearrange", count=0)
    with pytest.raises(PlanningError, match="at least 3 shipped objects"):
        PushEnvironment("Rearrange", count=3, objects=("pliers",))
    environment = PushEnvironment("Rearrange", count=1)
    environment.reset(seed=0)
    with pytest.raises(PlanningError, match="action"):
        environment.step(np.array([0.0, np.nan, 0.0, 0.0]))
