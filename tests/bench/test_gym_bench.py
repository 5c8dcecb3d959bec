"""The players of the environments, and the tables of `gridpush bench gym`."""

import numpy as np
import pytest

from gridpush_drake.bench.games import environments as gym
from gridpush_drake.bench.games.environments import play_learned, play_planner, play_random, train
from gridpush_drake.bench.games.linear_player import WEIGHT_COUNT, choose_by_weights
from gridpush_drake.errors import GridPushError
from gridpush_drake.gym import EnvironmentWorld, PushEnvironment, PushVectorEnvironment


@pytest.mark.slow
def test_the_planner_wins_where_chance_does_not():
    planned, (random,) = play_planner("PushToGoal", 1), play_random("PushToGoal", 1, 1)
    assert planned.won
    assert planned.score < 0.02
    assert not random.won
    assert planned.reward > random.reward + 1


def test_a_planned_push_is_carried_out_as_planned():
    env = PushEnvironment("SlideToEdge")
    world = EnvironmentWorld(env, 3)
    push = world.episode.shape.make_push(np.array([0.2, -0.3, 0.1]), world.observe())
    made = world.execute(push).push
    np.testing.assert_allclose(made.start, push.start, atol=1e-6)
    np.testing.assert_allclose(made.velocity, push.velocity, atol=1e-6)
    assert made.length == pytest.approx(push.length, abs=1e-7)


def test_training_is_reproducible_and_better_than_what_it_began_with():
    weights = [train("PushToGoal", 0, generations=2, candidates=4, episodes=3) for _ in range(2)]
    np.testing.assert_array_equal(*weights)
    trained, untrained = (
        np.mean([score.reward for score in play_learned("PushToGoal", w, 100, 6)])
        for w in (weights[0], np.zeros(WEIGHT_COUNT))
    )
    assert trained > untrained + 1


def test_weights_choose_the_place_that_pushes_towards_the_goal():
    env = PushVectorEnvironment(8, "PushToGoal", objects=["claw_hammer"])
    seen, _ = env.reset(seed=0)
    weights = np.zeros(WEIGHT_COUNT)
    weights[0] = 1.0  # along the way to the goal
    for action, episode in zip(choose_by_weights(weights, seen), env.episodes, strict=True):
        push = episode.shape.make_push(action, episode.pose)
        way = episode.goal[:2] - episode.pose[:2]
        assert push.velocity @ way > 0.5 * np.linalg.norm(push.velocity) * np.linalg.norm(way)


def test_tables_have_every_player():
    scores = gym.run_job(gym.GameJob("SlideToEdge", gym.RANDOM_PLAYER, 0, 2)).scores
    played = [gym.PlayedGame("SlideToEdge", player, scores) for player in gym.PLAYER_NAMES]
    table = gym.tabulate_scores(played, ["SlideToEdge"])
    assert [row[1] for row in table.rows] == list(gym.PLAYER_NAMES)
    assert table.rows[0][3] == pytest.approx(np.mean([score.reward for score in scores]))
    (row,) = gym.tabulate_speed([("PushToGoal", 1)]).rows
    assert row[2] == gym.SIDE_BY_SIDE
    assert row[4] == row[5] > 100
    with pytest.raises(GridPushError, match="games: Chess"):
        gym.STUDY.run(games=("Chess",))
