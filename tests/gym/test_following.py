"""`gridpush/Follow-v0`: what is seen and rewarded, and how the follower plays it."""

import numpy as np
import pytest

from gridpush_drake.errors import ObjectError, PlanningError
from gridpush_drake.gym import PushEnvironment
from gridpush_drake.gym.following import PATH_LENGTH, STEERED_FINGER, STEP_PERIOD
from gridpush_drake.planning.feedback import FollowOptions, PushFollower

NAME = "combination_wrench"


def test_the_same_seed_is_the_same_episode():
    ends = []
    for _ in range(2):
        env = PushEnvironment("Follow", objects=[NAME])
        env.reset(seed=5)
        rng = np.random.default_rng(0)
        for _ in range(10):
            seen, reward, *_ = env.step(rng.uniform(-1, 1, 2).astype(np.float32))
        ends.append((seen, reward))
    assert ends[0][1] == ends[1][1]
    for name, values in ends[0][0].items():
        np.testing.assert_array_equal(values, ends[1][0][name])


def test_an_action_is_a_velocity_and_poses_come_late():
    env = PushEnvironment("Follow", objects=[NAME], delay=0.1, missing=0.0)
    seen, info = env.reset(seed=1)
    assert (info["score"], info["is_success"]) == (0.0, False)
    begin = seen["tip"].copy()
    assert seen["progress"] == pytest.approx(0.0, abs=0.01)
    # away from the object; a longer velocity than 1 is shortened
    away = begin - seen["pose"][:2]
    way = away / np.linalg.norm(away)
    seen, reward, won, cut_off, _ = env.step(3.0 * way)
    assert seen["tip"] - begin == pytest.approx(
        STEP_PERIOD * STEERED_FINGER.walking_speed * way, abs=1e-6
    )
    assert seen["age"] == pytest.approx(0.1, abs=0.021)
    assert not won and not cut_off
    assert reward < 0.0  # it costs time
    with pytest.raises(PlanningError, match="action"):
        env.step(np.array([np.nan, 0.0]))


def test_an_episode_is_cut_off():
    env = PushEnvironment("Follow", objects=[NAME], max_steps=3)
    env.reset(seed=1)
    ends = [env.step(np.zeros(2))[2:4] for _ in range(3)]
    assert ends == [(False, False), (False, False), (False, True)]


def test_what_makes_no_sense_is_refused():
    with pytest.raises(ObjectError):
        PushEnvironment("Follow", objects=["teapot"])
    with pytest.raises(PlanningError, match="missing"):
        PushEnvironment("Follow", missing=2.0)
    with pytest.raises(PlanningError, match="not a list"):
        PushEnvironment("Follow", objects=NAME)


def play_follower(env, seed):
    """Plays an episode by the follower, which is told the truth; returns the last info and reward."""
    env.reset(seed=seed)
    episode = env.episode
    follower = PushFollower(
        episode.shape.obj,
        episode.hidden,
        episode.path,
        STEERED_FINGER,
        options=FollowOptions(draws=0, position_tolerance=0.003),
        seed=seed,
    )
    total = 0.0
    ended = False
    follower.add_tip(episode.finger.time, episode.finger.tip)
    while not ended:
        for each in episode.came:
            follower.add_pose(each.time, each.pose)
        decision = follower.decide(episode.finger.time, episode.finger.tip)
        _, reward, won, cut_off, info = env.step(decision.velocity / STEERED_FINGER.walking_speed)
        total += reward
        ended = won or cut_off
    return info, total


@pytest.mark.slow
def test_the_follower_wins_and_chance_does_not():
    env = PushEnvironment("Follow", objects=[NAME])
    info, total = play_follower(env, 2)
    assert info["is_success"]
    assert info["score"] < 0.005
    assert total > 0.5 * 10.0 * PATH_LENGTH
    env.reset(seed=2)
    rng = np.random.default_rng(0)
    chance = 0.0
    ended = False
    while not ended:
        _, reward, won, cut_off, info = env.step(rng.uniform(-1, 1, 2))
        chance += reward
        ended = won or cut_off
    assert not info["is_success"]
    assert chance < total


def test_a_picture_shows_path_object_and_finger():
    env = PushEnvironment("Follow", render_mode="rgb_array", objects=[NAME])
    assert env.render() is None
    env.reset(seed=2)
    picture = env.render()
    assert picture.shape == (480, 480, 3)
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 3
