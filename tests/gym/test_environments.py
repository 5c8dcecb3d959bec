"""The environments: Gymnasium's and Stable-Baselines3's checks, the vector environment beside single ones."""

import warnings
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from shapely import Point

import gridpush_drake.gym  # registers the environments
from gridpush_drake.dynamics.simulation import calc_loads, simulate
from gridpush_drake.errors import ObjectError, PlanningError
from gridpush_drake.geometry.se2 import transform_back, wrap_angle
from gridpush_drake.gym import PushEnvironment, PushVectorEnvironment
from gridpush_drake.gym.environments import GAME_MODULES, PICTURE_SIZE
from gridpush_drake.gym.games import GOAL_TOLERANCE, PER_METER
from gridpush_drake.gym.known_shape import (
    FINGER_OPTIONS,
    OCCUPIED_VALUE,
    PICTURE_PIXELS,
    PICTURE_SIDE,
    PLACE_COUNT,
    load_shape,
)
from gridpush_drake.identification.model import Model
from gridpush_drake.planning.contact.trial import calc_goal_error

NAMES = tuple(GAME_MODULES)


@pytest.mark.parametrize("camera", [False, True])
@pytest.mark.parametrize("name", NAMES)
def test_gymnasium_finds_no_fault(name, camera):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        made = gymnasium.make(f"gridpush/{name}-v0", render_mode="rgb_array", camera=camera)
        check_env(made.unwrapped)


@pytest.mark.parametrize("name", NAMES)
def test_stable_baselines_finds_no_fault(name):
    checker = pytest.importorskip(
        "stable_baselines3.common.env_checker",
        reason="stable-baselines3 is not installed: it brings 1 GB of torch",
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        checker.check_env(PushEnvironment(name, camera=True))


@pytest.mark.parametrize("name", NAMES)
def test_a_vector_environment_is_single_ones_bit_for_bit(name):
    """Through the ends of episodes, whatever the threads."""
    count, seed = 3, 11
    own = {"Rearrange": {"max_pushes": 3}, "Follow": {"max_steps": 3}}
    options = own.get(name, {"max_pushes": 3, "workers": 2})
    path = f"gridpush/{name}-v0"
    many = gymnasium.make_vec(path, count, vectorization_mode="vector_entry_point", **options)
    assert isinstance(many, PushVectorEnvironment)
    singles = [
        gymnasium.make(path, disable_env_checker=True, **options).unwrapped for _ in range(count)
    ]
    seen, _ = many.reset(seed=seed)
    firsts = [single.reset(seed=seed + i)[0] for i, single in enumerate(singles)]
    _assert_same(seen, firsts)
    rng, over = np.random.default_rng(0), np.zeros(count, dtype=bool)
    for _ in range(6):
        actions = rng.uniform(-1, 1, many.action_space.shape).astype(np.float32)
        seen, rewards, terminated, cut_off, infos = many.step(actions)
        results = []
        for i, single in enumerate(singles):
            if over[i]:
                results.append((*single.reset(), 0.0, False, False))
            else:
                one, reward, ended, cut, info = single.step(actions[i])
                results.append((one, info, reward, ended, cut))
        _assert_same(seen, [result[0] for result in results])
        assert rewards.tolist() == [result[2] for result in results]
        assert infos["score"].tolist() == [result[1]["score"] for result in results]
        assert terminated.tolist() == [result[3] for result in results]
        assert cut_off.tolist() == [result[4] for result in results]
        over = terminated | cut_off
    assert many.observation_space.contains(seen)


def test_each_episode_of_a_vector_environment_may_have_its_own_seed():
    many, seeds = PushVectorEnvironment(2, "PushToGoal"), [7, 3]
    singles = [PushEnvironment("PushToGoal").reset(seed=seed)[0] for seed in seeds]
    _assert_same(many.reset(seed=seeds)[0], singles)
    with pytest.raises(PlanningError, match="seed: 1 seeds; expected 2"):
        many.reset(seed=[7])


def _assert_same(seen, singles):
    for name, values in seen.items():
        np.testing.assert_array_equal(values, np.stack([single[name] for single in singles]))


def test_an_action_is_that_push_and_the_push_that_action():
    shape, rng, pose = (
        load_shape("claw_hammer"),
        np.random.default_rng(0),
        np.array([0.1, -0.2, 0.7]),
    )
    for action in rng.uniform(-0.99, 0.99, (50, 3)):
        push = shape.make_push(action, pose)
        np.testing.assert_allclose(shape.find_action(push, pose), action, atol=1e-5)
        gap = shape.obj.outline.distance(Point(transform_back(pose, push.start[None])[0]))
        assert gap == pytest.approx(
            FINGER_OPTIONS.pusher.radius + FINGER_OPTIONS.pusher.clearance, abs=1e-6
        )


def test_a_push_moves_the_object_as_the_model_says():
    env = PushEnvironment("PushToGoal", position_std=0.0, angle_std=0.0)
    seen, info = env.reset(seed=4)
    before, action = env.episode, np.array([0.3, 0.1, 0.5], dtype=np.float32)
    after, reward, *_ = env.step(action)
    push = before.shape.make_push(action, before.true_pose)
    motion = simulate(
        Model(before.shape.obj, before.hidden), push, before.true_pose, regime="quasi_static"
    )
    np.testing.assert_allclose(
        env.episode.true_pose, motion.final_pose, atol=2e-4
    )  # steps twice as long
    np.testing.assert_allclose(after["pose"][:2], motion.final_pose[:2], atol=2e-4)
    errors = [
        float(calc_goal_error(before.shape.obj, e.true_pose, before.goal))
        for e in (before, env.episode)
    ]
    assert info["score"] == errors[0]
    assert reward == pytest.approx(PER_METER * (errors[0] - errors[1]))
    moved = motion.final_pose - before.true_pose
    assert after["last_motion"][2] == pytest.approx(wrap_angle(moved[2]), abs=2e-3)
    assert np.hypot(*after["last_motion"][:2]) == pytest.approx(np.hypot(*moved[:2]), abs=2e-4)
    np.testing.assert_array_equal(after["last_action"], action)
    assert not seen["last_action"].any()


def test_the_goal_is_won_where_the_object_lies_at_it():
    env = PushEnvironment("PushToGoal", objects=["claw_hammer"], position_std=0.0, angle_std=0.0)
    env.reset(seed=0)
    action = np.array([0.0, 0.0, -0.8], dtype=np.float32)
    goal = env.game.play([env.episode], [action])[0].episode.true_pose
    object.__setattr__(env.episode, "goal", goal + [GOAL_TOLERANCE / 2, 0.0, 0.0])
    _, _, terminated, cut_off, info = env.step(action)
    assert (terminated, cut_off, info["is_success"]) == (True, False, True)


def test_an_object_pushed_on_and_on_falls_and_the_episode_ends():
    env = PushEnvironment("SlideToEdge", objects=["toothpaste_tube"], max_pushes=40)
    env.reset(seed=1)
    part, endless = (
        env.episode.shape.grasp_parts[0],
        5.0 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]),
    )
    object.__setattr__(env.episode, "parts", (replace(part, footprint=endless),))
    shape, ended = env.episode.shape, False
    while not ended:
        before, theta = env.episode, env.episode.pose[2]
        # the place whose inward normal points along the world's x axis, in line with the middle
        normals = shape.outline[:, 2] * np.cos(theta) - shape.outline[:, 3] * np.sin(theta)
        place = int(
            np.argmax(normals - 5 * np.abs(shape.outline[:, :2] @ [np.sin(theta), np.cos(theta)]))
        )
        action = np.array([2 * place / PLACE_COUNT - 1, 0.0, 1.0], dtype=np.float32)
        _, reward, ended, cut_off, info = env.step(action)
        assert not cut_off
    after = env.episode
    assert after.fallen
    assert not info["is_success"]
    assert after.pushes[-1].overhang
    assert (
        calc_loads(Model(shape.obj, after.hidden), before.true_pose, env.game.surface.corners)
        is not None
    )
    assert (
        calc_loads(Model(shape.obj, after.hidden), after.true_pose, env.game.surface.corners)
        is None
    )
    assert reward == pytest.approx(10 * (after.score - before.score) - 1)


def test_pokes_lessen_the_held_out_error():
    drops = []
    for seed in range(6):
        env = PushEnvironment("Explore", objects=["combination_wrench"])
        _, info = env.reset(seed=seed)
        rng, first, total = np.random.default_rng(seed), info["score"], 0.0
        for _ in range(8):
            seen, reward, terminated, cut_off, info = env.step(
                rng.uniform(-1, 1, 3).astype(np.float32)
            )
            total += reward
        assert cut_off
        assert not terminated
        assert total == pytest.approx(100 * (first - info["score"]))
        drops.append(info["score"] / first)
    assert np.median(drops) < 0.6
    assert seen["estimate"][2] > 0


def test_hidden_masses_differ_by_seed_and_are_not_seen():
    env = PushEnvironment("PushToGoal", objects=["pliers"], camera=True)
    first, _ = env.reset(seed=0)
    hidden = env.episode.hidden
    env.reset(seed=1)
    assert not np.array_equal(env.episode.hidden.mass, hidden.mass)
    again, _ = env.reset(seed=0)
    np.testing.assert_array_equal(env.episode.hidden.mass, hidden.mass)
    object.__setattr__(env.episode, "hidden", type(hidden)(hidden.mass[::-1], hidden.friction))
    for name, value in env._observe().items():
        np.testing.assert_array_equal(value, first[name])
        np.testing.assert_array_equal(value, again[name])


def test_occupancy_has_the_object_s_area_and_pictures_show_it():
    shape = load_shape("claw_hammer")
    area = (shape.occupancy == OCCUPIED_VALUE).sum() * (PICTURE_SIDE / PICTURE_PIXELS) ** 2
    assert area == pytest.approx(shape.obj.n * shape.obj.cell_size**2, rel=0.1)
    env = PushEnvironment("SlideToEdge", render_mode="rgb_array", objects=["claw_hammer"])
    assert env.render() is None
    env.reset(seed=0)
    picture = env.render()
    assert picture.shape == (PICTURE_SIZE, PICTURE_SIZE, 3)
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 10
    assert PushEnvironment("Explore").render() is None


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"objects": []}, PlanningError, "objects: none"),
        ({"objects": ["anvil"]}, ObjectError, "anvil"),
        ({"objects": "pliers"}, PlanningError, "'pliers' is not a list"),
        ({"game": "chess"}, PlanningError, "game: 'chess'; expected one of PushToGoal"),
        ({"max_pushes": 0}, PlanningError, "max_pushes is 0"),
        ({"max_pushes": np.nan}, PlanningError, "max_pushes is nan"),
        ({"angle_std": -1.0}, PlanningError, "angle_std"),
        ({"position_std": np.inf}, PlanningError, "position_std"),
    ],
)
def test_bad_options_are_refused(options, error, message):
    with pytest.raises(error, match=message):
        PushEnvironment(**options)


@pytest.mark.parametrize("action", [[np.nan, 0.0, 0.0], [0.0, 0.0], np.zeros((1, 3)), None])
def test_an_action_that_is_none_is_refused(action):
    environment = PushEnvironment("PushToGoal")
    environment.reset(seed=0)
    with pytest.raises(PlanningError, match="expected three finite numbers"):
        environment.step(action)


def test_what_cannot_be_grasped_is_refused():
    with pytest.raises(PlanningError, match="open_book has no part"):
        PushEnvironment("SlideToEdge", objects=["open_book"])


def test_importing_registers():
    assert gridpush_drake.gym.PushEnvironment is PushEnvironment
    assert {f"gridpush/{name}-v0" for name in NAMES} <= set(gymnasium.registry)
