"""`Rearrange`: several objects of hidden masses are pushed to goals, as a game.

Each action is one push of one object, in the plain world of several objects
(`planning.world.SimulatedWorld`): whatever else the pushed object touches is pushed on.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import shapely
from gymnasium.spaces import Box
from numpy.typing import NDArray

from gridpush_drake.dynamics.push import Push
from gridpush_drake.errors import PlanningError, require_positive
from gridpush_drake.geometry.se2 import Array, check_vector
from gridpush_drake.gym.episode import EPISODE_OBJECTS, Game, Turn, flatten_pose
from gridpush_drake.gym.known_shape import FINGER_RADIUS, PLACE_COUNT, KnownShape, load_shapes
from gridpush_drake.gym.rendering import (
    FLOOR_WIDTH,
    GOAL_COLOR,
    PUSH_COLOR,
    TABLE_COLOR,
    TablePicture,
)
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.contact.trial import calc_goal_error
from gridpush_drake.planning.scene.random_scenes import hide, scatter
from gridpush_drake.planning.scene.rearrangement import RearrangePlanner
from gridpush_drake.planning.scene.rules import place_outlines
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.planning.world import SimulatedWorld

TABLE_SIDE = 1.2
"""Side of the table, m; its middle is the world's origin."""

SPACE_MARGIN = 0.5
"""Distance beyond the table's edge that the space of poses reaches, m."""

START_GAP = 0.01
"""Least distance of two objects at the beginning, m."""

GOAL_GAP = 0.03
"""Least distance of two goals, m."""

PER_METER = 10.0
"""Reward for a meter that all objects together come nearer to their goals."""

FALLEN_REWARD = -1.0
"""Reward for pushing an object off the table, which ends the episode."""

OBJECT_COLORS = ((96, 120, 160), (170, 110, 70), (90, 140, 90), (150, 90, 140), (120, 120, 60))
"""Colors of the objects, RGB from 0 to 255."""


@dataclass(frozen=True)
class RearrangeGameOptions:
    """What an episode is drawn from.

    Attributes:
        count: number of objects.
        objects: names of shipped objects, or objects; `count` of them are drawn for each episode.
        max_pushes: number of pushes after which an episode is cut off.
        position_std: standard deviation of seen positions, per axis, m.
        angle_std: standard deviation of seen angles, rad.

    Raises:
        PlanningError: a number is out of range, or there are fewer objects than `count`.
    """

    count: int = 3
    objects: Sequence[str | GridObject] = EPISODE_OBJECTS
    max_pushes: int = 40
    position_std: float = 0.0005
    angle_std: float = 0.003

    def __post_init__(self) -> None:
        require_positive(PlanningError, count=self.count, max_pushes=self.max_pushes)
        if isinstance(self.objects, str) or len(self.objects) < self.count:
            raise PlanningError(
                f"objects: {self.objects!r}; expected the names of at least {self.count} shipped "
                "objects, or as many objects"
            )


@dataclass(frozen=True, eq=False)
class RearrangeEpisode:
    """How an episode stands; where the objects truly lie changes in `world`.

    Attributes:
        shapes: the objects as a player sees them.
        planner: knows their goals, and says which of them are reached.
        world: the objects, with their hidden masses and frictions.
        seen: (N, 3) where they were seen last, m and rad.
        score: sum over all objects of the mean distance of their cells from where they are at the
            goals, m.
        reached: whether every object truly lies at its goal.
        last_action: (4,) zeros before the first push.
        last_push: the last push; None before the first.
    """

    shapes: tuple[KnownShape, ...]
    planner: RearrangePlanner
    world: SimulatedWorld
    seen: Array
    score: float = np.nan
    reached: bool = False
    last_action: Array = field(default_factory=lambda: np.zeros(4))
    last_push: Push | None = None

    @property
    def objects(self) -> tuple[GridObject, ...]:
        """The objects."""
        return tuple(shape.obj for shape in self.shapes)

    @property
    def goals(self) -> Array:
        """(N, 3) the objects' goals, m and rad."""
        return self.planner.goals

    @property
    def fallen(self) -> bool:
        """Whether an object fell off the table."""
        return bool(np.any(self.world.truth.fallen))

    def find_action(self, body: int, push: Push) -> NDArray[np.float32]:
        """Finds the action (4,) that comes nearest to a push that begins at an object.

        Args:
            body: number of the object.
            push: the push, with the radius of the game's finger.
        """
        fraction = 2 * (body + 0.5) / len(self.shapes) - 1
        rest = self.shapes[body].find_action(push, self.seen[body])
        return np.append(fraction, rest).astype(np.float32)

    def make_push(self, action: Array) -> Push:
        """Makes the push of an action (4,)."""
        count = len(self.shapes)
        body = min(int((action[0] + 1) / 2 * count), count - 1)
        return self.shapes[body].make_push(action[1:], self.seen[body])

    def fits(self, push: Push) -> bool:
        """Says whether the finger can come down where a push begins, by what is seen."""
        outlines = place_outlines(self.objects, self.seen)
        distances = shapely.distance(outlines, shapely.Point(push.start))
        return bool((distances > FINGER_RADIUS).all())

    def measure(self) -> "RearrangeEpisode":
        """The episode with its score, by where the objects truly lie."""
        poses = self.world.truth.pose
        score = 0.0
        for obj, pose, goal in zip(self.objects, poses, self.goals, strict=True):
            score += float(calc_goal_error(obj, pose, goal))
        return replace(self, score=score, reached=bool(self.planner.find_reached(poses).all()))


class Rearrange(Game[RearrangeEpisode]):
    """`gridpush/Rearrange-v0`: several objects are to be brought to goals, one push at a time.

    An action is (object, place, direction, distance), each from -1 to 1: which of the objects, in
    equal fractions of that range, and the push of it as `PushEnvironment` has it. Where the finger
    does not fit beside the object, because another one lies there, nothing moves. An observation is
    a dictionary; lengths are in m, and everything is as it was seen, with noise:

        poses         (N, 4) x, y, cosine and sine of theta of each object
        goals         (N, 4) the same of the goals
        outlines      (N, 256) each object's outline, as `PushEnvironment` has it
        last_action   (4,) zeros before the first push
        table         (2,) half of the table's sides; its middle is the world's origin

    Its score is the sum over all objects of the mean distance of their cells from where they should
    be, m. Reward: the score's decrease in decimeters, and -1 where an object falls. The aim is
    reached, which ends the episode, where every object lies within 2 cm and 0.2 rad of its goal.

    Attributes:
        options: what an episode is drawn from.
        surface: the table.
    """

    options_kind = RearrangeGameOptions
    action_size = 4

    def __init__(self, options: RearrangeGameOptions | None = None) -> None:
        """Takes what an episode is drawn from.

        Raises:
            ObjectError: no shipped object has one of the names.
        """
        self.options = options or RearrangeGameOptions()
        self.surface = SupportSurface.rectangle((0.0, 0.0), (TABLE_SIDE, TABLE_SIDE))
        self._shapes = load_shapes(self.options.objects)

    def begin(self, rng: np.random.Generator) -> RearrangeEpisode:
        """Draws objects, where they lie and where they should."""
        drawn = rng.permutation(len(self._shapes))[: self.options.count]
        shapes = tuple(self._shapes[int(i)] for i in drawn)
        objects = [shape.obj for shape in shapes]
        # Where they lie and should lie, drawn one after another, and then what is hidden.
        start = scatter(objects, rng, START_GAP, TABLE_SIDE / 4)
        goals = scatter(objects, rng, GOAL_GAP, TABLE_SIDE / 4)
        world = SimulatedWorld(
            hide(objects, rng),
            start,
            self.surface,
            position_std=self.options.position_std,
            angle_std=self.options.angle_std,
            seed=rng,
        )
        planner = RearrangePlanner(objects, goals)
        return RearrangeEpisode(shapes, planner, world, _look(world)).measure()

    def play(
        self, episodes: Sequence[RearrangeEpisode], actions: Sequence[Array]
    ) -> list[Turn[RearrangeEpisode]]:
        """Makes one push in each of the episodes."""
        return [self._push(*pair) for pair in zip(episodes, actions, strict=True)]

    def _push(self, before: RearrangeEpisode, action: Array) -> Turn[RearrangeEpisode]:
        """Makes one push in an episode."""
        world = before.world
        clipped = np.clip(check_vector(PlanningError, "action", action, 4), -1.0, 1.0)
        push = before.make_push(clipped)
        # Where the finger fits nowhere beside the object, the push is lost.
        if before.fits(push):
            world.execute(push)
        else:
            world.pushes += 1
        after = replace(before, last_action=clipped, last_push=push)
        # What has fallen is not seen any more, and the player keeps what was seen before.
        if not after.fallen:
            after = replace(after, seen=_look(world))
        after = after.measure()
        if after.fallen:
            return Turn(after, FALLEN_REWARD)
        return Turn(after, PER_METER * (before.score - after.score), after.reached)

    def is_cut_off(self, episode: RearrangeEpisode) -> bool:
        """Says whether all pushes of an episode were made."""
        return episode.world.pushes >= self.options.max_pushes

    def make_spaces(self) -> dict[str, Box]:
        """Makes the spaces of the observation."""
        far = TABLE_SIDE / 2 + SPACE_MARGIN
        count = self.options.count
        limit = np.tile(np.array([far, far, 1.0, 1.0], dtype=np.float32), (count, 1))
        return {
            "poses": Box(-limit, limit),
            "goals": Box(-limit, limit),
            "outlines": Box(-1.0, 1.0, (count, 4 * PLACE_COUNT)),
            "last_action": Box(-1.0, 1.0, (4,)),
            "table": Box(0.0, far, (2,)),
        }

    def observe(self, episode: RearrangeEpisode) -> dict[str, Array]:
        """Returns what a player sees."""
        return {
            "poses": np.array([flatten_pose(pose) for pose in episode.seen]),
            "goals": np.array([flatten_pose(goal) for goal in episode.goals]),
            "outlines": np.array([shape.outline.ravel() for shape in episode.shapes]),
            "last_action": episode.last_action,
            "table": np.full(2, TABLE_SIDE / 2),
        }

    def draw(self, episode: RearrangeEpisode, size: int, show_hidden: bool) -> NDArray[np.uint8]:
        """Draws objects, goals and the last push; nothing that is hidden is shown."""
        picture = TablePicture(size, np.zeros(2), TABLE_SIDE / 2 + FLOOR_WIDTH)
        picture.fill(self.surface.corners, TABLE_COLOR)
        for b, outline in enumerate(place_outlines(episode.objects, episode.world.truth.pose)):
            corners = shapely.get_coordinates(outline.exterior)
            picture.fill(corners, OBJECT_COLORS[b % len(OBJECT_COLORS)])
        # The outline of a goal is green, with a line of its object's color on it.
        for b, outline in enumerate(place_outlines(episode.objects, episode.goals)):
            corners = shapely.get_coordinates(outline.exterior)
            picture.draw_line(corners, GOAL_COLOR, times=2)
            picture.draw_line(corners, OBJECT_COLORS[b % len(OBJECT_COLORS)])
        if episode.last_push is not None:
            picture.draw_line(episode.last_push.xy, PUSH_COLOR)
        return picture.finish()


def _look(world: SimulatedWorld) -> Array:
    """Looks at objects none of which has fallen, (N, 3), m and rad."""
    seen = world.observe()
    assert seen is not None
    return seen
