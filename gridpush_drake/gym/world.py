"""An episode of an environment as a world: closed loops and benches play games through it."""

import numpy as np
from numpy.typing import ArrayLike

from gridpush_drake.dynamics.bodies import Bodies
from gridpush_drake.dynamics.push import Push
from gridpush_drake.errors import PlanningError
from gridpush_drake.geometry.se2 import Array, check_vector
from gridpush_drake.gym.environments import PushEnvironment
from gridpush_drake.gym.episode import EpisodeState, PushGame
from gridpush_drake.planning.world import WorldTruth
from gridpush_drake.pushes.push_log import ObservedPush


class EnvironmentWorld:
    """A `PushWorld` that is an episode of a `PushEnvironment`.

    A push is made by the action that comes nearest to it. The object is not seen any more once the
    episode is over, so that a closed loop ends.

    Attributes:
        env: the environment.
        game: its game.
        reward: sum of the rewards so far.
        won: whether the game's aim was reached by the last push.
        over: whether the episode is over.
    """

    def __init__(self, env: PushEnvironment, seed: int) -> None:
        """Begins an episode with a seed.

        Raises:
            PlanningError: the actions of the environment's game are no pushes of one object.
        """
        if not isinstance(env.game, PushGame):
            raise PlanningError(
                f"game: {type(env.game).__name__}; expected one whose actions push one object"
            )
        self.env = env
        self.game = env.game
        self.reward = 0.0
        self.won = False
        self.over = False
        env.reset(seed=seed)

    @property
    def episode(self) -> EpisodeState:
        """The present episode."""
        episode: EpisodeState = self.env.episode
        return episode

    def put(self, pose: ArrayLike) -> None:
        """Puts the object down elsewhere, at a pose (3,), m and rad, and lets the episode go on.

        That is no push: it is worth nothing, and the game's score is measured anew. Pushes that
        were made before still count towards the episode's greatest number of pushes.

        Raises:
            PlanningError: the pose is not three finite numbers.
        """
        there = check_vector(PlanningError, "pose", pose, 3)
        self.env.episode = self.game.put(self.episode, there)
        self.over = self.game.is_cut_off(self.episode)

    def execute(self, push: Push) -> ObservedPush:
        """Takes the action that comes nearest to a push.

        Raises:
            PlanningError: the episode is over.
        """
        if self.over:
            raise PlanningError("push: the episode is over; expected none, or another episode")
        action = self.episode.shape.find_action(push, self.episode.pose)
        _, reward, terminated, cut_off, info = self.env.step(action)
        self.reward += reward
        self.won = info["is_success"]
        self.over = terminated or cut_off
        return self.episode.pushes[-1]

    def observe(self) -> Array | None:
        """Returns q_WB (3,) of the object as it was last seen; None once the episode is over."""
        return None if self.over else self.episode.pose

    @property
    def truth(self) -> WorldTruth:
        """What is true of the object now, for judges only."""
        episode = self.episode
        return WorldTruth(
            pose=np.array(episode.true_pose),
            fallen=episode.fallen,
            stays=not episode.fallen,
            bodies=None if episode.hidden is None else Bodies(episode.shape.obj, episode.hidden),
            motion=episode.motion,
        )
