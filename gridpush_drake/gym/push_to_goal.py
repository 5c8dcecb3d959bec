"""`gridpush/PushToGoal-v0`: an object of hidden masses is pushed to a goal pose on a large table.

Its score is the mean distance of the cells from where they are at the goal, m (the paper's ADD). Reward: the score's
decrease in decimeters, and 1 for coming within 2 cm, which ends the episode, or -1 for falling off the table.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from gymnasium.spaces import Box

from gridpush_drake.geometry.se2 import Array
from gridpush_drake.gym.episode import Episode, GameOptions, PushGame, Turn, flatten_pose
from gridpush_drake.gym.known_shape import KnownShape
from gridpush_drake.planning.contact.trial import calc_goal_error

TABLE = (1.4, 1.2)
"""Its sides, m."""

MARGIN = 0.1
"""m inside the edge that the object lies at the beginning, and at the goal."""

REACHED = 0.02
"""m, mean cell error: the paper's."""

PER_METER = 10.0
"""Reward for a meter."""

MIN_ERROR = 0.1
"""m, mean cell error at the beginning."""


@dataclass(frozen=True, eq=False)
class GoalEpisode(Episode):
    """An episode with a goal.

    Attributes:
        goal: (3,) q_W, m and rad.
    """

    goal: Array = field(default_factory=lambda: np.zeros(3))


class PushToGoal(PushGame[GoalEpisode]):
    """The game."""

    def __init__(self, options: GameOptions | None = None) -> None:
        """Takes what an episode is drawn from."""
        super().__init__(options or GameOptions(), TABLE)

    def begin(self, rng: np.random.Generator) -> GoalEpisode:
        """Draws an object, where it lies and where it should."""
        shape, hidden = self.draw_object(rng)
        start = self._draw_pose(shape, rng)
        goal, error = start, 0.0
        while error < MIN_ERROR:
            goal = self._draw_pose(shape, rng)
            error = float(calc_goal_error(shape.obj, start, goal))
        return GoalEpisode(shape, hidden, rng, start, self.add_noise(start, rng), error, goal=goal)

    def judge(self, before: GoalEpisode, after: GoalEpisode) -> Turn[GoalEpisode]:
        """By how much nearer the goal is."""
        error = float(calc_goal_error(after.shape.obj, after.true_pose, after.goal))
        won = error < REACHED and not after.fallen
        reward = PER_METER * (before.score - error) + won - after.fallen
        return Turn(replace(after, score=error), reward, won)

    def make_own_spaces(self) -> dict[str, Box]:
        """The goal, as the pose."""
        limit = np.array([*self._half, 1.0, 1.0], dtype=np.float32)
        return {"goal": Box(-limit, limit)}

    def observe_own(self, episode: GoalEpisode) -> dict[str, Array]:
        """The goal, as the pose."""
        return {"goal": flatten_pose(episode.goal)}

    def find_goal(self, episode: GoalEpisode) -> Array:
        """The goal."""
        return episode.goal

    def _draw_pose(self, shape: KnownShape, rng: np.random.Generator) -> Array:
        """A pose (3,) wholly on the table."""
        while True:
            pose = np.append(rng.uniform(-self._half, self._half), rng.uniform(-np.pi, np.pi))
            if self.surface.contains_cells(shape.obj, pose, MARGIN):
                return pose
