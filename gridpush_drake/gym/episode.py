"""`Game`: what is drawn, seen and rewarded; and an episode in which one hidden object is pushed.

A game holds what never changes, an episode all that does. `play` takes one action in each of many
episodes; an environment is one episode, a vector environment many. In a `PushGame` an action is a
push of one object, and the pushes of all episodes are simulated together.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import inf
from typing import Any, ClassVar, Generic, Protocol, TypeVar

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray

from gridpush_drake.dynamics.motion import Motion
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.simulation import calc_loads, simulate_batch
from gridpush_drake.errors import PlanningError
from gridpush_drake.geometry.se2 import Array, rotate, transform, wrap_angle
from gridpush_drake.gym.known_shape import FINGER_OPTIONS, KnownShape, load_shapes
from gridpush_drake.gym.rendering import (
    FLOOR_WIDTH,
    GOAL_COLOR,
    PUSH_COLOR,
    TABLE_COLOR,
    VIEW_HALF_SIDE,
    TablePicture,
    color_cells,
)
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.belief import Belief
from gridpush_drake.planning.pregrasp.grasp.grasp_parts import GraspPart
from gridpush_drake.planning.support_surface import SupportSurface, find_supported
from gridpush_drake.planning.world import WorldMotion
from gridpush_drake.pushes.push_log import ObservedPush, PushLog

EPISODE_OBJECTS = (
    "claw_hammer",
    "combination_wrench",
    "pliers",
    "spray_bottle",
    "spring_clamp",
    "toothpaste_tube",
)
"""Shipped objects of which one is drawn for each episode."""

MASS_RANGE = (0.1, 5.0)
"""Least and greatest mass of a cell, kg; one is drawn for each part."""

FRICTION_RANGE = (0.3, 0.4)
"""Least and greatest friction of a part against the table."""

CONTACT_FRICTION_RANGE = (0.35, 0.65)
"""Least and greatest friction of the finger on the object."""

TIP_STEP = 0.002
"""Distance that the finger moves in a step of the simulation, m."""

OBSERVATION_COUNT = 4
"""Number of poses that are seen during a push after the first one, its end among them."""

SPACE_MARGIN = 1.0
"""Distance beyond the table's edge that the space of poses reaches, m."""


PUSH_PICTURES = 2
"""Number of pushes a second in a film of pictures."""


class AnyEpisode(Protocol):
    """How an episode of any game stands."""

    @property
    def score(self) -> float:
        """The game's own measure."""

    @property
    def fallen(self) -> bool:
        """Whether an object fell off the table, which ends the episode."""


EpisodeType = TypeVar("EpisodeType", bound=AnyEpisode)
"""The episode of a game."""


def take_objects(objects: Sequence[str | GridObject]) -> tuple[str | GridObject, ...]:
    """Takes the objects of which one is drawn for each episode: names of shipped ones, or objects.

    Raises:
        PlanningError: there is none, or a single name was given.
    """
    expected = "expected the names of shipped objects, or objects"
    if isinstance(objects, str):
        raise PlanningError(f"objects: {objects!r} is not a list; {expected}")
    taken = tuple(objects)
    if not taken:
        raise PlanningError(f"objects: none is given; {expected}")
    return taken


@dataclass(frozen=True)
class GameOptions:
    """What an episode is drawn from.

    Attributes:
        objects: names of shipped objects, or objects; one is drawn for each episode.
        max_pushes: number of pushes after which an episode is cut off.
        position_std: standard deviation of seen positions, per axis, m.
        angle_std: standard deviation of seen angles, rad.
        workers: number of threads that simulate; no result depends on it.

    Raises:
        PlanningError: a number is out of range, or there is no object.
        ObjectError: no shipped object has one of the names.
    """

    objects: Sequence[str | GridObject] = EPISODE_OBJECTS
    max_pushes: int = 20
    position_std: float = 0.0005
    angle_std: float = 0.003
    workers: int = 1

    def __post_init__(self) -> None:
        object.__setattr__(self, "objects", take_objects(self.objects))
        for name in ("max_pushes", "workers"):
            if not getattr(self, name) >= 1:
                raise PlanningError(f"{name} is {getattr(self, name)!r}; expected 1 or more")
        if not (0 <= self.position_std < inf and 0 <= self.angle_std < inf):
            raise PlanningError("position_std and angle_std must be finite and >= 0")


@dataclass(frozen=True, eq=False)
class EpisodeState:
    """How an episode stands.

    No player is shown `hidden`, `true_pose`, `score`, `parts` and `motion`, which are the truth.

    Attributes:
        shape: the object as a player knows it.
        hidden: its true masses and frictions.
        rng: draws the noise.
        true_pose: (3,) true pose q_W of the object, m and rad.
        pose: (3,) pose as it was last seen, m and rad.
        score: the game's score, see `PushGame.measure`, m; NaN before it was measured.
        last_action: (3,) the last action; zeros before the first.
        last_motion: (3,) by which the last push was seen to move the object, in its own frame
            before, m and rad.
        pushes: what was seen of every push, in order.
        fallen: whether the object fell off the table.
        goal: (3,) goal pose q_W, m and rad; None in games without one.
        parts: graspable parts, any of which is to hang over the edge; hidden, for they tell where
            the center of mass is.
        model: what the game's learner holds possible; None in games without one.
        held_out: pushes that the learner is tested on, from the pose (0, 0, 0).
        motion: how the last push truly moved the object; None before the first, and where the
            object was put elsewhere since.
    """

    shape: KnownShape
    hidden: CellParameters
    rng: np.random.Generator
    true_pose: Array
    pose: Array
    score: float = np.nan
    last_action: Array = field(default_factory=lambda: np.zeros(3))
    last_motion: Array = field(default_factory=lambda: np.zeros(3))
    pushes: tuple[ObservedPush, ...] = ()
    fallen: bool = False
    goal: Array | None = None
    parts: tuple[GraspPart, ...] = ()
    model: Belief | None = None
    held_out: PushLog = field(default_factory=lambda: PushLog(()))
    motion: WorldMotion | None = None

    @property
    def log(self) -> PushLog:
        """The pushes so far, as a learner takes them."""
        return PushLog(self.pushes)


@dataclass(frozen=True, eq=False)
class Turn(Generic[EpisodeType]):
    """What came of one action.

    Attributes:
        episode: the episode after it.
        reward: its reward.
        won: whether the game's aim is reached, which ends the episode.
    """

    episode: EpisodeType
    reward: float
    won: bool = False

    @property
    def terminated(self) -> bool:
        """Whether the episode is over: won, or lost as the object fell."""
        return self.won or self.episode.fallen


class Game(Generic[EpisodeType]):
    """What is drawn, seen and rewarded: all that an environment asks of a game.

    Attributes:
        options_kind: class of the options.
        defaults: fields of the options for which the game has other defaults.
        action_size: length of an action, each of whose numbers is from -1 to 1.
        pictures_per_second: number of actions a second in a film of pictures.
    """

    options_kind: ClassVar[type[Any]]
    defaults: ClassVar[dict[str, Any]] = {}
    action_size: ClassVar[int] = 3
    pictures_per_second: ClassVar[int] = PUSH_PICTURES

    @classmethod
    def list_defaults(cls) -> dict[str, Any]:
        """Options that the game has other defaults for."""
        return cls.defaults

    def begin(self, rng: np.random.Generator) -> EpisodeType:
        """Draws an episode; `rng` also draws its noise."""
        raise NotImplementedError

    def play(
        self, episodes: Sequence[EpisodeType], actions: Sequence[Array]
    ) -> list[Turn[EpisodeType]]:
        """Takes one action (action_size,) in each of the episodes, none of which is over."""
        raise NotImplementedError

    def is_cut_off(self, episode: EpisodeType) -> bool:
        """Says whether all actions of an episode were taken."""
        raise NotImplementedError

    def make_spaces(self) -> dict[str, Box]:
        """Makes the spaces of the observation; lengths in m, angles as cosine and sine."""
        raise NotImplementedError

    def observe(self, episode: EpisodeType) -> dict[str, Any]:
        """Returns what a player sees."""
        raise NotImplementedError

    def draw(self, episode: EpisodeType, size: int, show_hidden: bool) -> NDArray[np.uint8]:
        """Draws an episode from straight above (size, size, 3), RGB; x to the right and y up.

        Args:
            episode: the episode.
            size: side of the picture, pixels.
            show_hidden: whether the picture may show what is hidden from players.
        """
        raise NotImplementedError


class PushGame(Game[EpisodeState]):
    """A game in which each action is a push of the only object; a game is a subclass.

    Attributes:
        table: sides of the table along x and y, m; its middle is the world's origin.
        options: what an episode is drawn from.
        shapes: the objects as a player knows them.
        surface: the table.
    """

    options_kind = GameOptions
    table: ClassVar[tuple[float, float]]

    def __init__(self, options: GameOptions | None = None) -> None:
        """Takes what an episode is drawn from."""
        self.options = options or GameOptions()
        self.shapes = load_shapes(self.options.objects)
        self.surface = SupportSurface.rectangle((0.0, 0.0), self.table)
        self._half = np.array(self.table) / 2

    def measure(self, episode: EpisodeState) -> float:
        """Calculates the game's score of an episode as it stands, m."""
        raise NotImplementedError

    def judge(self, before: EpisodeState, after: EpisodeState) -> Turn[EpisodeState]:
        """Says what a push was worth, and returns the episode after it with its `score`."""
        raise NotImplementedError

    def put(self, episode: EpisodeState, pose: Array) -> EpisodeState:
        """Returns the episode with its object put down at a pose (3,), seen and measured anew."""
        seen = self.add_noise(pose, episode.rng)
        moved = replace(episode, true_pose=pose, pose=seen, fallen=False, motion=None)
        return replace(moved, score=self.measure(moved))

    def make_own_spaces(self) -> dict[str, Box]:
        """Makes the spaces of what this game adds to the observation."""
        return {}

    def observe_own(self, episode: EpisodeState) -> dict[str, Array]:
        """Returns what this game adds to the observation."""
        return {}

    def draw_object(self, rng: np.random.Generator) -> tuple[KnownShape, CellParameters]:
        """Draws an object and what is hidden of it."""
        shape = self.shapes[int(rng.integers(len(self.shapes)))]
        seed = int(rng.integers(np.iinfo(np.int64).max))
        hidden = CellParameters.random(shape.obj, seed, MASS_RANGE, FRICTION_RANGE)
        return shape, replace(hidden, contact_friction=float(rng.uniform(*CONTACT_FRICTION_RANGE)))

    def add_noise(self, poses: Array, rng: np.random.Generator) -> Array:
        """Draws poses (..., 3) as they are seen, m and rad."""
        std = (self.options.position_std, self.options.position_std, self.options.angle_std)
        return np.asarray(poses + np.array(std) * rng.standard_normal(np.shape(poses)))

    def make_spaces(self) -> dict[str, Box]:
        """Makes the spaces of the observation; lengths in m, angles as cosine and sine."""
        far = (self._half + SPACE_MARGIN).astype(np.float32)
        limit = np.array([*far, 1.0, 1.0], dtype=np.float32)
        step = np.array([*(2 * far), np.pi], dtype=np.float32)
        shape = self.shapes[0]
        return {
            "pose": Box(-limit, limit),
            "outline": Box(-1.0, 1.0, (shape.outline.size,)),
            "occupancy": Box(0, np.iinfo(np.uint8).max, shape.occupancy.shape, np.uint8),
            "last_action": Box(-1.0, 1.0, (3,)),
            "last_motion": Box(-step, step),
            "table": Box(0.0, far),
            **self.make_own_spaces(),
        }

    def observe(self, episode: EpisodeState) -> dict[str, Any]:
        """Returns what a player sees."""
        return {
            "pose": flatten_pose(episode.pose),
            "outline": episode.shape.outline.ravel(),
            "occupancy": episode.shape.occupancy,
            "last_action": episode.last_action,
            "last_motion": episode.last_motion,
            "table": self._half,
            **self.observe_own(episode),
        }

    def play(
        self, episodes: Sequence[EpisodeState], actions: Sequence[Array]
    ) -> list[Turn[EpisodeState]]:
        """Makes one push in each of the episodes, all simulated in one batch.

        Args:
            episodes: the episodes, none of them over.
            actions: (3,) the action in each, see `KnownShape.make_push`.
        """
        after = self.push(episodes, actions)
        return [self.judge(*pair) for pair in zip(episodes, after, strict=True)]

    def push(
        self, episodes: Sequence[EpisodeState], actions: Sequence[Array]
    ) -> list[EpisodeState]:
        """Makes one push in each of the episodes, as `play` does; they are not judged yet."""
        pairs = list(zip(episodes, actions, strict=True))
        pushes = [episode.shape.make_push(action, episode.pose) for episode, action in pairs]
        motions = simulate_batch(
            [Model(episode.shape.obj, episode.hidden) for episode in episodes],
            pushes,
            np.reshape([episode.true_pose for episode in episodes], (-1, 3)),
            workers=self.options.workers,
            dt=TIP_STEP / FINGER_OPTIONS.pusher.speed,
            regime="quasi_static",
            table=self.surface.corners,
        )
        played = zip(pairs, pushes, motions, strict=True)
        return [self._go_on(*pair, push, motion) for pair, push, motion in played]

    def _go_on(
        self, episode: EpisodeState, action: Array, push: Push, motion: Motion
    ) -> EpisodeState:
        """Returns an episode after a push, not yet judged."""
        # The motion ends where the object begins to tip.
        poses = motion.poses
        fallen = bool(motion.tips.any())
        if fallen:
            poses = poses[: int(np.argmax(motion.tips)) + 1]
        rows = np.unique(
            np.rint(np.linspace(0, len(poses) - 1, OBSERVATION_COUNT + 1)).astype(int)
        )[1:]
        seen = self.add_noise(poses[rows], episode.rng)
        on_table = bool(find_supported(episode.shape.obj, poses, self.surface).all())
        if not on_table:
            at_rest = calc_loads(
                Model(episode.shape.obj, episode.hidden), poses[-1], self.surface.corners
            )
            fallen = fallen or at_rest is None
        observed = ObservedPush(
            name=f"push_{len(episode.pushes) + 1}",
            push=push,
            pose=episode.pose,
            t_observed=motion.times[rows],
            poses_observed=seen,
            overhang=not on_table,
        )

        # By how much the object was seen to move, in its own frame before the push.
        pose = seen[-1] if len(seen) else self.add_noise(poses[-1], episode.rng)
        change = pose - episode.pose
        moved = np.append(rotate(-episode.pose[2], change[:2]), wrap_angle(change[2]))
        return replace(
            episode,
            true_pose=poses[-1].copy(),
            pose=pose,
            fallen=fallen,
            last_action=np.clip(np.asarray(action, dtype=np.float64), -1.0, 1.0),
            last_motion=moved,
            pushes=(*episode.pushes, observed),
            motion=WorldMotion(
                times=motion.times[: len(poses)], poses=poses, fell=fallen, overhang=not on_table
            ),
        )

    def is_cut_off(self, episode: EpisodeState) -> bool:
        """Says whether all pushes of an episode were made."""
        return len(episode.pushes) >= self.options.max_pushes

    def draw(self, episode: EpisodeState, size: int, show_hidden: bool) -> NDArray[np.uint8]:
        """Draws the table, the object, its goal and the finger's last path."""
        corners = self.surface.corners
        obj = episode.shape.obj
        half = min(np.abs(corners).max() + FLOOR_WIDTH, VIEW_HALF_SIDE)
        # A table larger than the view is seen about the object.
        middle = np.zeros(2) if half < VIEW_HALF_SIDE else episode.true_pose[:2]
        picture = TablePicture(size, middle, half)
        picture.fill(corners, TABLE_COLOR)
        square = obj.cell_size / 2 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        colors = color_cells(episode.hidden.mass, show_hidden)
        for p_BC, color in zip(obj.p_BC, colors, strict=True):
            picture.fill(transform(episode.true_pose, p_BC + square), color)
        if episode.goal is not None:
            outline = np.array(obj.outline.exterior.coords)
            picture.draw_line(transform(episode.goal, outline), GOAL_COLOR)
        if episode.pushes:
            push = episode.pushes[-1].push
            picture.draw_line(push.xy, PUSH_COLOR)
            picture.fill_disc(push.xy[-1], push.radius, PUSH_COLOR)
        return picture.finish()


def flatten_pose(pose: Array) -> Array:
    """Returns x and y, m, and cosine and sine of theta (4,) of a pose (3,)."""
    return np.array([pose[0], pose[1], np.cos(pose[2]), np.sin(pose[2])])
