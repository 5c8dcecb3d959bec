"""`gridpush/SlideToEdge-v0`: an object of hidden masses is pushed over the table's edge, so far that it can be grasped.

Graspable are its narrow parts near the true center of mass, where it does not turn in the gripper. Its score is how far
the part that is farthest out hangs over the edge, m; negative while some of what the gripper needs is over the table.
Reward: the score's increase in decimeters, and 1 when a part is out, which ends the episode, or -1 for falling off.
"""

from dataclasses import dataclass, replace

import numpy as np

from gridpush_drake.errors import PlanningError
from gridpush_drake.gym.episode import Episode, GameOptions, PushGame, Turn
from gridpush_drake.planning.pregrasp.goals import calc_overhangs
from gridpush_drake.planning.pregrasp.grasp_parts import GraspPart

TABLE = (0.9, 0.7)
"""Its sides, m."""

OFFSET = 0.05
"""m, at most, of the object from the table's middle at the beginning, along each axis."""

MAX_ARM = 0.06
"""m from the center of mass to the middle of a part, at most."""

PER_METER = 10.0
"""Reward for a meter."""


@dataclass(frozen=True, eq=False)
class SlideEpisode(Episode):
    """An episode with parts to grasp.

    Attributes:
        parts: any of which is to hang over; hidden, for they tell where the center of mass is.
    """

    parts: tuple[GraspPart, ...] = ()


class SlideToEdge(PushGame[SlideEpisode]):
    """The game."""

    def __init__(self, options: GameOptions | None = None) -> None:
        """Takes what an episode is drawn from. Raises PlanningError where an object has no graspable part."""
        super().__init__(options or GameOptions(), TABLE)
        for shape in self.shapes:
            if not shape.grasp_parts:
                raise PlanningError(f"objects: {shape.obj.name} has no part narrow enough to be grasped")

    def begin(self, rng: np.random.Generator) -> SlideEpisode:
        """Draws an object and where it lies, in the table's middle; again where it cannot be grasped near enough."""
        while True:
            shape, hidden = self.draw_object(rng)
            center = hidden.center_of_mass(shape.obj)
            near = tuple(part for part in shape.grasp_parts if np.linalg.norm(part.p_BG - center) <= MAX_ARM)
            if near:
                break
        start = np.append(rng.uniform(-OFFSET, OFFSET, 2), rng.uniform(-np.pi, np.pi))
        score = float(calc_overhangs(near, start, self.surface).max())
        return SlideEpisode(shape, hidden, rng, start, self.add_noise(start, rng), score, parts=near)

    def judge(self, before: SlideEpisode, after: SlideEpisode) -> Turn[SlideEpisode]:
        """By how much farther out a part is."""
        overhang = float(calc_overhangs(after.parts, after.true_pose, self.surface).max())
        won = overhang >= 0 and not after.fallen
        reward = PER_METER * (overhang - before.score) + won - after.fallen
        return Turn(replace(after, score=overhang), reward, won)
