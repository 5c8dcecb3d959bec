"""`Follow`: a finger is steered ten times a second, to push an object along a path, as a game.

The other games are of single pushes, decided beforehand (`gym.games`). Here contact is kept: an
action is the finger's velocity, and poses come late, with noise and gaps, as in
`planning.feedback.SteeredFinger`. What is hidden is drawn as in the other games.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np
import shapely
from gymnasium.spaces import Box
from numpy.typing import NDArray
from shapely.geometry.polygon import orient

from gridpush_drake.errors import PlanningError, require_positive
from gridpush_drake.geometry.se2 import Array, check_vector, make_direction, rotate, transform
from gridpush_drake.gym.episode import (
    CONTACT_FRICTION_RANGE,
    EPISODE_OBJECTS,
    FRICTION_RANGE,
    MASS_RANGE,
    Game,
    Turn,
    flatten_pose,
    take_objects,
)
from gridpush_drake.gym.known_shape import KnownShape, load_shapes
from gridpush_drake.gym.rendering import (
    GOAL_COLOR,
    OBJECT_COLOR,
    PUSH_COLOR,
    TABLE_COLOR,
    TablePicture,
)
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.feedback.follow_log import SeenPose
from gridpush_drake.planning.feedback.pose_path import PathProgress, PosePath
from gridpush_drake.planning.feedback.steered_finger import PoseSensorModel, SteeredFinger
from gridpush_drake.planning.pushed_object import FeedbackFinger
from gridpush_drake.planning.world import SimulatedWorld

STEERED_FINGER = FeedbackFinger(radius=0.008, speed=0.1, walking_speed=0.2)
"""The finger. An action of length 1 is its walking speed."""

STEP_PERIOD = 0.1
"""Time of a step, s."""

PATH_POSES_AHEAD = 12
"""Poses of the path ahead of the object that are observed."""

AHEAD_SPACING = 0.02
"""Length of the path between two of them, m."""

PATH_LENGTH = 0.4
"""Length of a path, m."""

PATH_POINTS = 60
"""Points by which a path is made."""

MAX_BEND = 0.9
"""Greatest angle by which a path's heading swings to either side, rad."""

PATH_SPEED = 0.05
"""Speed of a path, m/s: a player may be faster or slower."""

END_TOLERANCE = 0.005
"""Distance of the cells' centroid from the path's end at which it is reached, m."""

PER_METER = 10.0
"""Reward for a meter of progress along the path."""

PER_METER_OFF = 5.0
"""What a step costs for a meter that the centroid is off the path."""

PER_STEP = 0.01
"""What each step costs."""

MAX_PLACE = 2.0
"""Limit of the places that are observed, m."""

VIEW_HALF_SIDE = 0.4
"""Half the side of the picture, m."""

LINE_WIDTH = 0.003
"""Width of lines in the picture, m."""


@dataclass(frozen=True)
class FollowGameOptions:
    """What an episode is drawn from.

    Attributes:
        objects: names of shipped objects, or objects; one is drawn for each episode.
        max_steps: number of steps after which an episode is cut off.
        delay: time after which a pose comes, s.
        missing: fraction of the poses that never come.
        position_std: standard deviation of a seen position, per axis, m.
        angle_std: standard deviation of a seen angle, rad.

    Raises:
        PlanningError: a number is out of range, or there is no object.
        ObjectError: no shipped object has one of the names.
    """

    objects: Sequence[str | GridObject] = EPISODE_OBJECTS
    max_steps: int = 300
    delay: float = 0.1
    missing: float = 0.1
    position_std: float = 0.0005
    angle_std: float = 0.003

    def __post_init__(self) -> None:
        object.__setattr__(self, "objects", take_objects(self.objects))
        require_positive(PlanningError, max_steps=self.max_steps)
        self.make_pose_sensor()

    def make_pose_sensor(self) -> PoseSensorModel:
        """Makes how the object is seen. Raises PlanningError where a number is out of range."""
        return PoseSensorModel(
            delay=self.delay,
            missing=self.missing,
            position_std=self.position_std,
            angle_std=self.angle_std,
        )


@dataclass(eq=False)
class FollowEpisode:
    """An episode; all that changes is in `world`, and in the numbers.

    Attributes:
        shape: the object, as a player sees it.
        hidden: its true masses and frictions.
        path: where it should go.
        way: the path, measured.
        world: object and finger.
        seen: the pose that came last.
        came: all poses that came since the last step.
        progress: how far it truly came on the path, m.
        off: true distances of the centroid from the path so far, m.
    """

    shape: KnownShape
    hidden: CellParameters
    path: PosePath
    way: PathProgress
    finger: SteeredFinger
    seen: SeenPose
    came: list[SeenPose]
    progress: float = 0.0
    off: list[float] = field(default_factory=list)
    fallen: ClassVar[bool] = False

    @property
    def score(self) -> float:
        """Root mean square distance from the path so far, m."""
        return float(np.sqrt((np.array(self.off or [0.0]) ** 2).mean()))

    def find_center(self, pose: Array) -> Array:
        """Place (2,) of the cells' centroid at a pose (3,), W, m."""
        return transform(pose, self.shape.obj.p_BC.mean(axis=0)[None])[0]


class Follow(Game[FollowEpisode]):
    """`gridpush/Follow-v0`: an object of hidden masses is pushed along a path, with feedback.

    A step is 0.1 s. An action is the finger's velocity (2,) in W, in units of 0.2 m/s; a longer one
    than 1 is shortened. An observation is a dictionary; lengths are in m:

        pose          (4,) x, y, cosine and sine of theta of the object's body frame, as it was seen
                      last, with noise
        age           (1,) of that pose, s
        tip           (2,) where the finger's center is
        path          (12, 4) poses of the body frame on the path ahead of the pose that was seen,
                      2 cm apart, as the pose; at its end the last one is repeated
        progress      (1,) how far it came on the path by that pose, m
        outline       (256,) 64 places of the outline: point and inward normal (4 each), body frame
        occupancy     (48, 48, 1) 255 where the object is, 1 cm a pixel, about its cells' centroid

    Its score is the root mean square distance from the path so far, m. Reward: 10 a meter of true
    progress along the path, less 5 a meter of the centroid's distance from it and 0.01 in each
    step, and 1 for coming within 5 mm of its end, which ends the episode.

    Attributes:
        options: what is drawn.
        finger: the finger that is steered.
    """

    options_kind = FollowGameOptions
    action_size = 2
    pictures_per_second = round(1 / STEP_PERIOD)
    finger: ClassVar[FeedbackFinger] = STEERED_FINGER

    def __init__(self, options: FollowGameOptions | None = None) -> None:
        """Takes what an episode is drawn from."""
        self.options = options or FollowGameOptions()
        self._shapes = load_shapes(self.options.objects)

    def make_spaces(self) -> dict[str, Box]:
        """Makes the spaces of the observation."""
        shape = self._shapes[0]
        limit = np.array([MAX_PLACE, MAX_PLACE, 1.0, 1.0], dtype=np.float32)
        limits = np.tile(limit, (PATH_POSES_AHEAD, 1))
        duration = self.options.max_steps * STEP_PERIOD
        return {
            "pose": Box(-limit, limit),
            "age": Box(0.0, np.float32(duration + 1.0), (1,)),
            "tip": Box(-MAX_PLACE, MAX_PLACE, (2,)),
            "path": Box(-limits, limits),
            "progress": Box(0.0, MAX_PLACE, (1,)),
            "outline": Box(-1.0, 1.0, (shape.outline.size,)),
            "occupancy": Box(0, np.iinfo(np.uint8).max, shape.occupancy.shape, np.uint8),
        }

    def play(
        self, episodes: Sequence[FollowEpisode], actions: Sequence[Array]
    ) -> list[Turn[FollowEpisode]]:
        """Moves the finger of each episode for 0.1 s."""
        return [self._steer(*pair) for pair in zip(episodes, actions, strict=True)]

    def _steer(self, episode: FollowEpisode, action: Array) -> Turn[FollowEpisode]:
        """Moves the finger of an episode for 0.1 s."""
        chosen = check_vector(PlanningError, "action", action, 2)
        size = float(np.linalg.norm(chosen))
        direction = chosen / max(size, 1.0)
        velocity = STEERED_FINGER.walking_speed * direction
        finger = episode.finger
        episode.came = []
        frame_count = round(STEP_PERIOD / finger.pose_sensor.period)
        for _ in range(frame_count):
            came = finger.move(velocity)
            episode.came.extend(came)
        # poses come late, and some never
        if episode.came:
            episode.seen = episode.came[-1]
        # what it was worth, by where the object truly is
        center = episode.find_center(finger.pose)
        before = episode.progress
        episode.progress = episode.way.project(center, float(finger.pose[2]), before)
        off = float(episode.way.measure_distance(center[None])[0])
        episode.off.append(off)
        end = episode.way.at(episode.way.length)[:2]
        left = float(np.linalg.norm(center - end))
        won = left < END_TOLERANCE
        gained = PER_METER * (episode.progress - before)
        reward = gained - PER_METER_OFF * off - PER_STEP
        if won:
            reward += 1.0
        return Turn(episode, reward, won)

    def is_cut_off(self, episode: FollowEpisode) -> bool:
        """Says whether all steps of an episode were made."""
        return len(episode.off) >= self.options.max_steps

    def begin(self, rng: np.random.Generator) -> FollowEpisode:
        """Draws an object, what is hidden of it, and its path."""
        chosen = int(rng.integers(len(self._shapes)))
        shape = self._shapes[chosen]
        obj = shape.obj
        largest = np.iinfo(np.int64).max
        mass_seed = int(rng.integers(largest))
        noise_seed = int(rng.integers(largest))
        contact_friction = float(rng.uniform(*CONTACT_FRICTION_RANGE))
        hidden = CellParameters.random(obj, mass_seed, MASS_RANGE, FRICTION_RANGE)
        hidden = replace(hidden, contact_friction=contact_friction)
        path = draw_path(obj, rng)
        pose = np.array(path.poses[0])
        finger = SteeredFinger(
            SimulatedWorld(Model(obj, hidden), pose),
            tip=STEERED_FINGER.place_beside(obj, pose, pose[2] + find_side(obj) + np.pi),
            radius=STEERED_FINGER.radius,
            pose_sensor=self.options.make_pose_sensor(),
            seed=noise_seed,
        )
        # the object was seen to lie there before the episode began
        options = self.options
        std = np.array([options.position_std, options.position_std, options.angle_std])
        seen = SeenPose(0.0, pose + std * rng.standard_normal(3))
        return FollowEpisode(
            shape=shape,
            hidden=hidden,
            path=path,
            way=PathProgress(obj, path),
            finger=finger,
            seen=seen,
            came=[seen],
        )

    def observe(self, episode: FollowEpisode) -> dict[str, Any]:
        """Returns what a player sees."""
        seen = episode.seen.pose
        center = episode.find_center(seen)
        progress = episode.way.project(center, float(seen[2]), episode.progress)
        lengths = AHEAD_SPACING * np.arange(1, PATH_POSES_AHEAD + 1)
        ahead = episode.way.at(progress + lengths)
        middle = episode.shape.obj.p_BC.mean(axis=0)
        origins = ahead[:, :2] - rotate(ahead[:, 2], middle)
        headings = ahead[:, 2]
        poses = np.column_stack([origins, np.cos(headings), np.sin(headings)])
        return {
            "pose": flatten_pose(seen),
            "age": np.array([episode.finger.time - episode.seen.time]),
            "tip": episode.finger.tip,
            "path": poses,
            "progress": np.array([progress]),
            "outline": episode.shape.outline.ravel(),
            "occupancy": episode.shape.occupancy,
        }

    def draw(self, episode: FollowEpisode, size: int, show_hidden: bool) -> NDArray[np.uint8]:
        """Draws path, object, and finger; nothing that is hidden is shown."""
        obj = episode.shape.obj
        middle = episode.way.at(episode.way.length / 2)[:2]
        picture = TablePicture(size, middle, VIEW_HALF_SIDE, TABLE_COLOR)
        outline = np.array(obj.outline.exterior.coords)[:, :2]
        picture.fill(transform(episode.finger.pose, outline), OBJECT_COLOR)
        line = episode.way.at(np.linspace(0.0, episode.way.length, PATH_POINTS))[:, :2]
        picture.draw_line(line, GOAL_COLOR, LINE_WIDTH)
        picture.draw_line(transform(episode.path.goal, outline), GOAL_COLOR, LINE_WIDTH)
        finger = shapely.Point(episode.finger.tip).buffer(STEERED_FINGER.radius)
        picture.fill(shapely.get_coordinates(finger), PUSH_COLOR)
        return picture.finish()


def find_side(obj: GridObject) -> float:
    """Finds the direction of the inward normal of the longest side of the hull, body frame, rad."""
    hull = orient(obj.outline.convex_hull).exterior
    sides = np.diff(shapely.get_coordinates(hull), axis=0)
    longest = np.linalg.norm(sides, axis=1).argmax()
    x, y = sides[longest]
    return float(np.arctan2(x, -y))


def draw_path(obj: GridObject, rng: np.random.Generator) -> PosePath:
    """Draws a path of `PATH_LENGTH` from the origin on that swings to both sides.

    The object goes with the longest side of its hull behind.
    """
    s = np.linspace(0.0, 1.0, PATH_POINTS)
    begin, phase = rng.uniform(-np.pi, np.pi, 2)
    bend = rng.uniform(0.0, MAX_BEND)
    swing = np.sin(2 * np.pi * s + phase) - np.sin(phase)
    heading = begin + bend * swing
    step = PATH_LENGTH / (PATH_POINTS - 1)
    ways = np.cumsum(step * make_direction(heading[:-1]), axis=0)
    points = np.vstack([np.zeros(2), ways])
    return PosePath.through(obj, points, PATH_SPEED, -find_side(obj))
