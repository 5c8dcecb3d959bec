"""`gridpush/PushTHidden-v0`: a T with a hidden load, three pokes seen before, and four strokes."""

import gymnasium
import numpy as np
import pytest

import gridpush_drake.gym  # noqa: F401
from gridpush_drake.bench.pusht.experiments import BAR, STEM
from gridpush_drake.geometry.se2 import wrap_angle
from gridpush_drake.gym import PushEnvironment, PushTHidden
from gridpush_drake.gym.games import (
    INITIAL_POKES,
    PER_METER,
    T_DISTANCE,
    T_OUTLINE,
    T_REACHED,
    T_TURN,
    T_UNIT,
    make_t,
)
from gridpush_drake.planning.contact.trial import calc_goal_error


@pytest.fixture
def env():
    made = PushEnvironment("PushTHidden")
    made.reset(seed=5)
    return made


def test_it_is_the_t_of_pusht():
    corners = np.array([*BAR, *STEM]) * T_UNIT
    t = make_t()
    assert t.outline.area == pytest.approx((120 * 30 + 30 * 90) * T_UNIT**2, rel=0.02)
    np.testing.assert_allclose(
        np.reshape(t.outline.bounds, (2, 2)),
        [corners.min(axis=0), corners.max(axis=0)],
        atol=0.006,
    )
    assert {tuple(corner) for corner in (*BAR, *STEM)} >= {
        tuple(map(float, corner)) for corner in T_OUTLINE
    }
    assert len(set(t.labels)) == 4


def test_pokes_are_seen_before_and_are_no_strokes(env):
    episode = env.episode
    assert len(episode.pushes) == INITIAL_POKES
    for _ in range(3):
        _, _, terminated, cut_off, _ = env.step(np.array([0.0, 0.0, -1.0]))
        assert not cut_off and not terminated
    assert env.step(np.array([0.0, 0.0, -1.0]))[3]
    assert len(env.episode.pushes) == INITIAL_POKES + 4


def test_the_observation_tells_of_the_pokes(env):
    observation, _ = env.reset(seed=6)
    rows = observation["pokes"].reshape(INITIAL_POKES, 6)
    shape = env.episode.shape
    for row, seen in zip(rows, env.episode.pushes, strict=True):
        again = shape.make_push(row[:3], seen.pose)
        np.testing.assert_allclose(again.start, seen.push.start, atol=1e-5)
        np.testing.assert_allclose(again.velocity, seen.push.velocity, atol=1e-5)
        turn = wrap_angle(seen.final_pose[2] - seen.pose[2])
        assert row[5] == pytest.approx(turn, abs=1e-5)
        moved = np.linalg.norm(seen.final_pose[:2] - seen.pose[:2])
        assert np.linalg.norm(row[3:5]) == pytest.approx(moved, abs=1e-5)


def test_goals_are_near_and_loads_differ_by_part():
    game = PushEnvironment("PushTHidden").game
    assert isinstance(game, PushTHidden)
    for seed in range(20):
        episode = game.begin(np.random.default_rng(seed))
        step = np.linalg.norm(episode.goal[:2] - episode.true_pose[:2])
        assert T_DISTANCE[0] <= step <= T_DISTANCE[1]
        assert abs(wrap_angle(episode.goal[2] - episode.true_pose[2])) <= T_TURN
        assert len(np.unique(episode.hidden.mass)) == 4
        expected = calc_goal_error(episode.shape.obj, episode.true_pose, episode.goal)
        assert episode.score == pytest.approx(float(expected))


def test_coming_within_5_mm_wins(env):
    episode = env.episode
    env.episode = env.game.put(episode, episode.goal + [0.0, 0.0, 0.001])
    # a stroke that stops short of the T
    _, reward, terminated, _, info = env.step(np.array([0.0, 0.0, -1.0]))
    assert info["is_success"] == (info["score"] < T_REACHED) == terminated
    assert reward == pytest.approx(
        PER_METER
        * (
            calc_goal_error(episode.shape.obj, episode.goal + [0, 0, 0.001], episode.goal)
            - info["score"]
        )
        + terminated,
        abs=1e-6,
    )


def test_it_is_registered():
    made = gymnasium.make("gridpush/PushTHidden-v0", disable_env_checker=True)
    observation, info = made.reset(seed=0)
    assert observation["pokes"].shape == (6 * INITIAL_POKES,)
    assert info["score"] > T_REACHED
