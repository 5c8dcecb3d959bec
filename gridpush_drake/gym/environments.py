"""The environments: `PushEnvironment`, one episode, and `PushVectorEnvironment`, many at once.

The episodes of a vector environment are simulated together.

The i-th of a vector environment that is seeded with s does what an environment seeded with s + i
does, bit for bit.
"""

from collections.abc import Sequence
from importlib import import_module
from typing import Any, cast

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Dict, Space
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from gridpush_drake.errors import PlanningError
from gridpush_drake.gym.episode import PUSH_PICTURES, Game

CAMERA_SIZE = 96
"""Side of what the camera sees, pixels."""

PICTURE_SIZE = 480
"""Side of what `render` gives, pixels."""

RENDER_METADATA: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": PUSH_PICTURES}
"""What the environments tell Gymnasium of their pictures."""

GAME_MODULES = {
    **dict.fromkeys(("PushToGoal", "SlideToEdge", "Explore", "PushTHidden"), "games"),
    "Rearrange": "rearranging",
    "Follow": "following",
}
"""Module of this package that has each game, by the class's name, which is the environment's. It
is imported when the game is made: several objects, and a steered finger, take time to import."""

Observation = dict[str, NDArray[Any]]
"""What a player sees, by name."""


def register_environments() -> None:
    """Makes the environments known to Gymnasium, as `gridpush/NAME-v0`."""
    for name in GAME_MODULES:
        if f"gridpush/{name}-v0" not in gymnasium.registry:
            gymnasium.register(
                f"gridpush/{name}-v0",
                entry_point=f"{__name__}:PushEnvironment",
                vector_entry_point=f"{__name__}:PushVectorEnvironment",
                kwargs={"game": name},
            )


def make_game(game: str, options: dict[str, Any]) -> Game[Any]:
    """Makes a game.

    Args:
        game: its name, one of GAME_MODULES.
        options: fields of the game's options.

    Raises:
        PlanningError: there is no such game.
    """
    if game not in GAME_MODULES:
        raise PlanningError(f"game: {game!r}; expected one of {', '.join(GAME_MODULES)}")
    kind = getattr(import_module(f"{__package__}.{GAME_MODULES[game]}"), game)
    made: Game[Any] = kind(kind.options_kind(**kind.list_defaults() | options))
    return made


def _describe_pictures(game: Game[Any]) -> dict[str, Any]:
    """What an environment of a game tells Gymnasium of its pictures."""
    return {**RENDER_METADATA, "render_fps": game.pictures_per_second}


class _View:
    """What is seen of a game's episodes.

    Attributes:
        space: the space of an observation.
    """

    def __init__(self, game: Game[Any], camera: bool) -> None:
        """Takes a game, and whether there is a camera, whose picture is "rgb"."""
        self._game = game
        self._camera = camera
        self._spaces = game.make_spaces()
        if camera:
            self._spaces["rgb"] = Box(
                0, np.iinfo(np.uint8).max, (CAMERA_SIZE, CAMERA_SIZE, 3), np.uint8
            )
        # Gymnasium's stubs leave its type open
        self.space = cast(Space[Observation], Dict(cast(dict[str, Space[Any]], self._spaces)))

    def observe(self, episodes: Sequence[Any]) -> Observation:
        """Returns what is seen of each episode, one above the other."""
        seen = [self._game.observe(episode) for episode in episodes]
        if self._camera:
            for values, episode in zip(seen, episodes, strict=True):
                values["rgb"] = self._game.draw(episode, CAMERA_SIZE, show_hidden=False)
        return {
            name: np.clip(
                np.stack([values[name] for values in seen]), space.low, space.high
            ).astype(space.dtype)
            for name, space in self._spaces.items()
        }


class PushEnvironment(gymnasium.Env[Observation, NDArray[Any]]):
    """One episode after another of a game.

    `gym.rearranging.Rearrange` and `gym.following.Follow` say what actions and observations are in
    their games. In the others an action is a push of the only object: (place, direction, distance),
    each from -1 to 1. They stand for where along the outline that the finger can reach (once
    round), for -0.8 to 0.8 rad from the inward normal there, and for 1 to 15 cm. An observation is
    a dictionary; lengths are in m, and everything is as it was seen, with noise:

        pose          (4,) x, y, cosine and sine of theta of the object's body frame
        outline       (256,) 64 places, at actions -1, -1 + 2/64, ...: point and inward normal (4
                      each), body frame
        occupancy     (48, 48, 1) 255 where the object is, 1 cm a pixel, about its cells' centroid
        last_action   (3,) zeros before the first push
        last_motion   (3,) by which it moved the object, in the object's frame before, m and rad
        table         (2,) half of the sides along x and y; its middle is the world's origin
        goal          (4,) as the pose (PushToGoal)
        estimate      (3,) the learner's center of friction, body frame, and its standard deviation
                      (Explore)
        rgb           (96, 96, 3) the scene from above, where `camera` is set

    `info` has "score", the game's own measure in m (mean distance to the goal; how far a part hangs
    over; held-out error), and "is_success".

    Attributes:
        game: what is drawn, seen and rewarded.
        episode: the present one.
    """

    metadata = RENDER_METADATA

    def __init__(
        self,
        game: str = "PushToGoal",
        render_mode: str | None = None,
        camera: bool = False,
        **options: Any,
    ) -> None:
        """Makes the environment of a game of GAME_MODULES.

        Args:
            game: its name.
            render_mode: "rgb_array", or None for no pictures.
            camera: whether the observation has "rgb", the scene seen from above, which shows no
                masses.
            options: fields of the game's options.
        """
        self.game = make_game(game, options)
        self.metadata = _describe_pictures(self.game)
        self.render_mode = render_mode
        self._view = _View(self.game, camera)
        self.observation_space = self._view.space
        self.action_space = Box(-1.0, 1.0, (self.game.action_size,), np.float32)
        self.episode: Any = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begins another episode."""
        super().reset(seed=seed, options=options)
        self.episode = self.game.begin(self.np_random)
        return self._observe(), {"score": self.episode.score, "is_success": False}

    def step(self, action: NDArray[Any]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Takes one action."""
        assert self.episode is not None, "call reset first"
        (turn,) = self.game.play([self.episode], [np.asarray(action)])
        self.episode = turn.episode
        cut_off = not turn.terminated and self.game.is_cut_off(turn.episode)
        info = {"score": turn.episode.score, "is_success": turn.won}
        return self._observe(), float(turn.reward), turn.terminated, cut_off, info

    def render(self) -> NDArray[np.uint8] | None:
        """Draws the scene from above (PICTURE_SIZE, PICTURE_SIZE, 3), with the hidden masses."""
        if self.render_mode is None or self.episode is None:
            return None
        return self.game.draw(self.episode, PICTURE_SIZE, show_hidden=True)

    def _observe(self) -> Observation:
        assert self.episode is not None
        return {name: values[0] for name, values in self._view.observe([self.episode]).items()}


class PushVectorEnvironment(VectorEnv[Observation, NDArray[Any], NDArray[Any]]):
    """Many episodes at once; pushes of one object are simulated in one batch.

    An episode that is over begins anew with the next step, whose action it does not heed
    (`AutoresetMode.NEXT_STEP`).

    Attributes:
        game: what is drawn, seen and rewarded.
        episodes: the present ones.
    """

    def __init__(
        self,
        num_envs: int = 1,
        game: str = "PushToGoal",
        render_mode: str | None = None,
        camera: bool = False,
        **options: Any,
    ) -> None:
        """Makes the environment of a game of GAME_MODULES.

        Args:
            num_envs: number of episodes.
            game: the game's name.
            render_mode: "rgb_array", or None for no pictures.
            camera: whether the observation has "rgb", the scene seen from above, which shows no
                masses.
            options: fields of the game's options.
        """
        self.num_envs = num_envs
        self.game = make_game(game, options)
        self.render_mode = render_mode
        pictures = _describe_pictures(self.game)
        self.metadata = {**pictures, "autoreset_mode": AutoresetMode.NEXT_STEP}
        self._view = _View(self.game, camera)
        self.single_observation_space = self._view.space
        self.single_action_space = Box(-1.0, 1.0, (self.game.action_size,), np.float32)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.episodes: list[Any] = []
        self._generators: list[np.random.Generator] = []
        self._over = np.zeros(num_envs, dtype=bool)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Observation, dict[str, Any]]:
        """Begins all episodes; the i-th is seeded with `seed` + i, or with the i-th of the seeds.

        Raises:
            PlanningError: there is not one seed an episode.
        """
        if seed is not None or not self._generators:
            seeds: list[int | None] = [None] * self.num_envs
            if seed is not None:
                seeds = (
                    list(seed)
                    if isinstance(seed, Sequence)
                    else [seed + i for i in range(self.num_envs)]
                )
            if len(seeds) != self.num_envs:
                raise PlanningError(
                    f"seed: {len(seeds)} seeds; expected {self.num_envs}, one an episode"
                )
            self._generators = [np_random(one)[0] for one in seeds]
        self.episodes = [self.game.begin(rng) for rng in self._generators]
        self._over[:] = False
        return self._view.observe(self.episodes), self._inform(np.zeros(self.num_envs, dtype=bool))

    def step(
        self, actions: NDArray[Any]
    ) -> tuple[Observation, NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Takes one action in each episode that is not over."""
        rewards = np.zeros(self.num_envs)
        terminated, cut_off, won = np.zeros((3, self.num_envs), dtype=bool)
        # Episodes that are over begin anew, and do not heed their actions.
        for i in np.flatnonzero(self._over):
            self.episodes[i] = self.game.begin(self._generators[i])
        going_on = np.flatnonzero(~self._over)
        turns = self.game.play(
            [self.episodes[i] for i in going_on], [np.asarray(actions[i]) for i in going_on]
        )
        for i, turn in zip(going_on, turns, strict=True):
            self.episodes[i] = turn.episode
            rewards[i] = turn.reward
            terminated[i] = turn.terminated
            won[i] = turn.won
            cut_off[i] = not turn.terminated and self.game.is_cut_off(turn.episode)
        self._over = terminated | cut_off
        return self._view.observe(self.episodes), rewards, terminated, cut_off, self._inform(won)

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """A picture of each episode, as `PushEnvironment.render` has it."""
        if self.render_mode is None or not self.episodes:
            return None
        return tuple(
            self.game.draw(episode, PICTURE_SIZE, show_hidden=True) for episode in self.episodes
        )

    def _inform(self, won: NDArray[np.bool_]) -> dict[str, Any]:
        every = np.ones(self.num_envs, dtype=bool)
        scores = np.array([episode.score for episode in self.episodes])
        return {"score": scores, "_score": every, "is_success": won, "_is_success": every}
