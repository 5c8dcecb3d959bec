"""`gridpush bench pusht`: the benchmark PushT, which the player sees by its observations only."""

import subprocess
import sys

import numpy as np
import pytest
from PIL import Image, ImageColor

from gridpush_drake.bench.pusht.experiments import (
    CENTER,
    FILM_SIZE,
    MAX_OFFSET,
    Episode,
    Played,
    PushTPlayer,
    draw_center,
    draw_centers,
    make_environment,
    play,
    play_in,
    summarize,
    tabulate_episodes,
)
from gridpush_drake.errors import GridPushError

FIRST = 10000
"""Seed of the first episode played here."""


class Sealed:
    """An environment of which a player, and whoever calls it, can see no more than this."""

    def __init__(self, env):
        self.__env = env

    def __getattr__(self, name):
        raise AssertionError(f"the simulator's {name} was looked at")

    def reset(self, *, seed):
        observation, _ = self.__env.reset(seed=seed)
        return seal(observation), {}

    def step(self, action):
        assert action.shape == (2,) and action.min() >= 0 and action.max() <= 512
        observation, _, terminated, truncated, info = self.__env.step(action)
        return seal(observation), 0.0, terminated, truncated, {"coverage": info["coverage"]}


def seal(observation):
    assert observation.shape == (5,)
    copy = np.array(observation)
    copy.setflags(write=False)
    return copy


@pytest.mark.parametrize("hidden", [False, True])
def test_the_player_wins_by_observations_alone(hidden):
    pytest.importorskip("gym_pusht")
    for seed in (FIRST, FIRST + 1):
        env = make_environment(draw_center(seed) if hidden else None)
        fields = play_in(Sealed(env), PushTPlayer(seed), seed)
        assert fields["success"]
        assert fields["steps"] <= 80
        # and nothing else that `play` has access to makes any difference
        played = play(Episode(seed, hidden))
        assert played.steps == fields["steps"]
        assert played.max_coverage == pytest.approx(fields["max_coverage"], abs=1e-6)


@pytest.mark.slow
def test_the_player_needs_no_simulator():
    """It plays from observations where neither gym-pusht nor pymunk can be imported."""
    code = (
        "import sys\n"
        "for name in ('gym_pusht', 'pymunk', 'gymnasium', 'pygame'):\n"
        "    sys.modules[name] = None\n"
        "import numpy as np\n"
        "from gridpush_drake.bench.pusht.experiments import PushTPlayer\n"
        "action = PushTPlayer(0).act(np.array([100.0, 100.0, 300.0, 200.0, 1.0]))\n"
        "print(action.shape, bool((action >= 0).all()))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.split() == ["(2,)", "True"], done.stderr


def test_hidden_centers_are_drawn_evenly_within_a_circle():
    offsets = np.array([draw_center(seed) for seed in range(2000)]) - CENTER
    distance = np.linalg.norm(offsets, axis=1)
    assert distance.max() <= MAX_OFFSET
    assert np.mean(distance**2) == pytest.approx(MAX_OFFSET**2 / 2, rel=0.05)
    np.testing.assert_array_equal(draw_center(7), draw_center(7))
    assert np.abs(offsets.mean(axis=0)).max() < 1.0


def make_played(**changes):
    fields = {
        "success": True,
        "max_coverage": 0.99,
        "steps": 20,
        "decision_time": 0.004,
        "slowest": 0.01,
        "center_error": 0.1,
        "offset": 0.0,
    }
    return Played(**{**fields, **changes})


def test_figures_are_those_of_the_episodes():
    played = [make_played(), make_played(success=False, max_coverage=0.5, steps=300)]
    figures = summarize(played)
    assert figures["success"] == 0.5
    assert figures["mean_max_coverage"] == pytest.approx(0.745)
    assert figures["median_steps"] == 160
    assert figures["decision_ms"] == pytest.approx(4.0)
    values = dict(tabulate_episodes(played, 0, False).rows)
    assert values["episodes"] == 2
    assert values["longest episode, decisions"] == 300
    with pytest.raises(GridPushError, match="expected 1 or more"):
        summarize([])


def test_a_film_shows_where_the_t_is_believed_to_turn_about():
    picture = Image.new("RGB", (FILM_SIZE, FILM_SIZE), "white")
    player = PushTPlayer(0)
    believed = player.controller.learner.estimate
    pose = np.array([200.0, 300.0, np.pi / 2])
    draw_centers(picture, player, pose, np.array([60.0, 0.0]))
    scale = FILM_SIZE / 512
    at = (200.0 - believed.center_y, 300.0 + believed.center_x)
    assert picture.getpixel(tuple(round(scale * x) for x in at)) == ImageColor.getrgb("orange")
    # the ring about the true one is seven pixels wide to either side
    assert picture.getpixel((int(scale * 200) + 7, int(scale * 360))) == (0, 0, 0)
