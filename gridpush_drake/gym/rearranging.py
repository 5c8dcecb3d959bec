"""`RearrangeEnvironment`: several objects of hidden masses are pushed to goals, as a game.

Each step is one push of one object, in the plain world of several objects
(`planning.world.SimulatedWorld`): whatever else the pushed object touches is pushed on.
"""

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
import shapely
from gymnasium.spaces import Box, Dict
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from gridpush_drake.dynamics.push import Push
from gridpush_drake.errors import PlanningError, require_positive
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.gym.episode import EPISODE_OBJECTS, flatten_pose
from gridpush_drake.gym.known_shape import FINGER_RADIUS, PLACE_COUNT, KnownShape, load_shape
from gridpush_drake.gym.rendering import (
    FLOOR_COLOR,
    GOAL_COLOR,
    LINE_WIDTH,
    PUSH_COLOR,
    SUPERSAMPLING,
    TABLE_COLOR,
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

PICTURE_SIZE = 480
"""Side of what `render` gives, pixels."""

RENDER_METADATA: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 2}
"""What the environment tells Gymnasium of its pictures."""

OBJECT_COLORS = ((96, 120, 160), (170, 110, 70), (90, 140, 90), (150, 90, 140), (120, 120, 60))
"""Colors of the objects, RGB from 0 to 255."""


class RearrangeEnvironment(gymnasium.Env[dict[str, NDArray[Any]], NDArray[Any]]):
    """Several objects are to be brought to goals, one push a step.

    An action is (object, place, direction, distance), each from -1 to 1: which of the objects, in
    equal fractions of that range, and the push of it as `PushEnvironment` has it. Where the finger
    does not fit beside the object, because another one lies there, nothing moves. An observation is
    a dictionary; lengths are in m, and everything is as it was seen, with noise:

        poses         (N, 4) x, y, cosine and sine of theta of each object
        goals         (N, 4) the same of the goals
        outlines      (N, 256) each object's outline, as `PushEnvironment` has it
        last_action   (4,) zeros before the first push
        table         (2,) half of the table's sides; its middle is the world's origin

    `info` has "score", the sum over all objects of the mean distance of their cells from where they
    should be, m, and "is_success": every object lies within 2 cm and 0.2 rad of its goal.

    Attributes:
        world: the present episode's world.
        shapes: its objects.
        goals: (N, 3) their goals, m and rad.
    """

    metadata = RENDER_METADATA

    def __init__(
        self,
        render_mode: str | None = None,
        *,
        count: int = 3,
        objects: Sequence[str | GridObject] = EPISODE_OBJECTS,
        max_pushes: int = 40,
        position_std: float = 0.0005,
        angle_std: float = 0.003,
    ) -> None:
        """Makes the environment.

        Args:
            render_mode: "rgb_array", or None for no pictures.
            count: number of objects.
            objects: names of shipped objects, or objects; `count` of them are drawn for each
                episode.
            max_pushes: number of pushes after which an episode is cut off.
            position_std: standard deviation of seen positions, per axis, m.
            angle_std: standard deviation of seen angles, rad.

        Raises:
            PlanningError: a number is out of range, or there are fewer objects than `count`.
            ObjectError: no shipped object has one of the names.
        """
        require_positive(PlanningError, count=count, max_pushes=max_pushes)
        if isinstance(objects, str) or len(objects) < count:
            raise PlanningError(
                f"objects: {objects!r}; expected the names of at least {count} shipped objects, or "
                "as many objects"
            )
        self.render_mode = render_mode
        self.shapes: list[KnownShape] = []
        self.goals = np.empty((0, 3))
        self.world: SimulatedWorld | None = None
        self._known = [
            load_shape(one) if isinstance(one, str) else KnownShape(one) for one in objects
        ]
        self._count = count
        self._max_pushes = max_pushes
        self._position_std = position_std
        self._angle_std = angle_std
        self._surface = SupportSurface.rectangle((0.0, 0.0), (TABLE_SIDE, TABLE_SIDE))
        self._last_action = np.zeros(4)
        self._last_push: Push | None = None
        self._seen = np.zeros((count, 3))
        self.action_space = Box(-1.0, 1.0, (4,), np.float32)
        self.observation_space = Dict({**self._make_spaces()})  # type: ignore[assignment]

    def _make_spaces(self) -> dict[str, Box]:
        """Makes the spaces of the observation."""
        far = TABLE_SIDE / 2 + SPACE_MARGIN
        limit = np.tile(np.array([far, far, 1.0, 1.0], dtype=np.float32), (self._count, 1))
        return {
            "poses": Box(-limit, limit),
            "goals": Box(-limit, limit),
            "outlines": Box(-1.0, 1.0, (self._count, 4 * PLACE_COUNT)),
            "last_action": Box(-1.0, 1.0, (4,)),
            "table": Box(0.0, far, (2,)),
        }

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """Begins another episode."""
        super().reset(seed=seed, options=options)
        rng = self.np_random
        drawn = rng.permutation(len(self._known))[: self._count]
        self.shapes = [self._known[int(i)] for i in drawn]
        objects = [shape.obj for shape in self.shapes]
        start = scatter(objects, rng, START_GAP, TABLE_SIDE / 4)
        self.goals = scatter(objects, rng, GOAL_GAP, TABLE_SIDE / 4)
        self.world = SimulatedWorld(
            hide(objects, rng),
            start,
            self._surface,
            position_std=self._position_std,
            angle_std=self._angle_std,
            seed=rng,
        )
        self._planner = RearrangePlanner(objects, self.goals)
        self._last_action = np.zeros(4)
        self._last_push = None
        self._seen = self._look(self.world)
        return self._observe(), {"score": self._measure(), "is_success": self._is_done()}

    def step(
        self, action: NDArray[Any]
    ) -> tuple[dict[str, NDArray[Any]], float, bool, bool, dict[str, Any]]:
        """Makes one push."""
        world = self.world
        assert world is not None, "call reset first"
        before = self._measure()
        given = np.asarray(action, dtype=np.float64)
        if given.shape != (4,) or not np.isfinite(given).all():
            raise PlanningError(f"action: {action!r}; expected four finite numbers")
        self._last_action = np.clip(given, -1.0, 1.0)
        push = self._make_push(self._last_action)
        self._last_push = push
        if self._fits(push):
            world.execute(push)
        else:
            world.pushes += 1
        fell = bool(np.any(world.truth.fallen))
        if not fell:
            self._seen = self._look(world)
        score = self._measure()
        won = self._is_done() and not fell
        reward = FALLEN_REWARD if fell else PER_METER * (before - score)
        cut_off = not (won or fell) and world.pushes >= self._max_pushes
        return self._observe(), reward, won or fell, cut_off, {"score": score, "is_success": won}

    def find_action(self, body: int, push: Push) -> NDArray[np.float32]:
        """Finds the action (4,) that comes nearest to a push that begins at an object.

        Args:
            body: number of the object.
            push: the push, with the radius of the game's finger.
        """
        fraction = 2 * (body + 0.5) / self._count - 1
        rest = self.shapes[body].find_action(push, self._seen[body])
        return np.append(fraction, rest).astype(np.float32)

    def render(self) -> NDArray[np.uint8] | None:
        """Draws the scene from above: objects, goals and the last push."""
        if self.render_mode is None or self.world is None:
            return None
        scale = SUPERSAMPLING * PICTURE_SIZE / (TABLE_SIDE + 2 * FLOOR_WIDTH)
        image = Image.new("RGB", (SUPERSAMPLING * PICTURE_SIZE,) * 2, FLOOR_COLOR)
        brush = ImageDraw.Draw(image)
        width = max(1, round(LINE_WIDTH * scale))

        def place(points: Array) -> list[tuple[float, float]]:
            pixels = (np.asarray(points) * (1, -1) + TABLE_SIDE / 2 + FLOOR_WIDTH) * scale
            return [(float(x), float(y)) for x, y in pixels]

        objects = [shape.obj for shape in self.shapes]
        brush.polygon(place(self._surface.corners), fill=TABLE_COLOR)
        for b, outline in enumerate(place_outlines(objects, self.world.truth.pose)):
            brush.polygon(
                place(outline.exterior.coords), fill=OBJECT_COLORS[b % len(OBJECT_COLORS)]
            )
        for b, outline in enumerate(place_outlines(objects, self.goals)):
            line = place(outline.exterior.coords)
            brush.line(line, fill=GOAL_COLOR, width=2 * width)
            brush.line(line, fill=OBJECT_COLORS[b % len(OBJECT_COLORS)], width=width)
        if self._last_push is not None:
            brush.line(place(self._last_push.xy), fill=PUSH_COLOR, width=width)
        return np.asarray(image.reduce(SUPERSAMPLING))

    def _make_push(self, action: Array) -> Push:
        """Makes the push of an action (4,)."""
        fraction = (action[0] + 1) / 2
        body = int(fraction * self._count)
        body = min(body, self._count - 1)
        shape = self.shapes[body]
        return shape.make_push(action[1:], self._seen[body])

    def _fits(self, push: Push) -> bool:
        """Says whether the finger can come down where a push begins, by what is seen."""
        objects = [shape.obj for shape in self.shapes]
        outlines = place_outlines(objects, self._seen)
        start = shapely.Point(push.start)
        distances = shapely.distance(outlines, start)
        return bool((distances > FINGER_RADIUS).all())

    def _look(self, world: SimulatedWorld) -> Array:
        """Looks at the objects, none of which has fallen."""
        seen = world.observe()
        assert seen is not None
        return seen

    def _measure(self) -> float:
        """Calculates the score, m, by where the objects truly lie."""
        assert self.world is not None
        poses = self.world.truth.pose
        score = 0.0
        for shape, pose, goal in zip(
            self.shapes,
            poses,
            self.goals,
            strict=True,
        ):
            error = calc_goal_error(shape.obj, pose, goal)
            score += float(error)
        return score

    def _is_done(self) -> bool:
        """Says whether every object truly lies at its goal."""
        assert self.world is not None
        return bool(self._planner.find_reached(self.world.truth.pose).all())

    def _observe(self) -> dict[str, NDArray[Any]]:
        """Makes the observation, as its space has it."""
        poses = [flatten_pose(pose) for pose in self._seen]
        goals = [flatten_pose(goal) for goal in self.goals]
        outlines = [shape.outline.ravel() for shape in self.shapes]
        values = {
            "poses": poses,
            "goals": goals,
            "outlines": outlines,
            "last_action": self._last_action,
            "table": np.full(2, TABLE_SIDE / 2),
        }
        seen = {}
        for name, space in self._make_spaces().items():
            value = np.array(values[name])
            inside = np.clip(value, space.low, space.high)
            seen[name] = inside.astype(np.float32)
        return seen


FLOOR_WIDTH = 0.1
"""Width of the floor that is seen around the table, m."""
