"""`gridpush bench pusht`: the benchmark PushT of gym-pusht, played without any demonstration.

The player is `feedback_controller.FeedbackController`, which knows the T's outline, the goal, the
walls and its own disc, and learns the T's center of friction and arm within each episode. It is
given observations (disc's position and T's pose) and nothing else. Lengths are in pixels.

In the hidden variant the center of friction is up to 30 pixels off, and drawn by the seed. The
project's own, harder game on the same T is played by `bench.pusht.strokes`.
"""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from io import BytesIO
from pathlib import Path
from time import thread_time
from typing import Any

import numpy as np
from PIL import Image, ImageDraw

from gridpush_drake.bench.pusht.feedback_controller import (
    FeedbackController,
    FeedbackOptions,
)
from gridpush_drake.bench.pusht.sliding_block import DrivenDisc, SlidingBlock
from gridpush_drake.bench.pusht.strokes import (
    PLAYERS,
    STROKES_TASK,
    PrimitiveEpisode,
    tabulate_strokes,
)
from gridpush_drake.bench.study import Done, JobKind, Study, StudyOptions, option
from gridpush_drake.errors import GridPushError
from gridpush_drake.extras import import_extra
from gridpush_drake.files import check_writable, write_whole
from gridpush_drake.geometry.se2 import Array, transform
from gridpush_drake.report.table import Proportion, Table, Value
from gridpush_drake.units import MS_PER_S

ENVIRONMENT = "gym_pusht/PushT-v0"

MAX_STEPS = 300
"""Decisions after which the environment cuts an episode off."""

BAR = ((-60.0, 0.0), (60.0, 0.0), (60.0, 30.0), (-60.0, 30.0))
STEM = ((-15.0, 30.0), (15.0, 30.0), (15.0, 120.0), (-15.0, 120.0))
"""The T's two parts, body frame, px."""

GOAL = (256.0, 256.0, np.pi / 4)
"""The goal pose, px and rad."""

DISC = DrivenDisc(
    radius=15.0, stiffness=100.0, damping=20.0, time_step=0.01, substeps=10, low=0.0, high=512.0
)
"""The disc and the law that drives it, px and s."""

WALLS = (7.0, 7.0, 504.0, 504.0)
"""Inner faces of the walls: low x, low y, high x, high y, px."""

SLOP = 0.1
"""Overlap that pymunk leaves uncorrected by default, px."""

CORRECTION = 1.0 - 0.9**0.6
"""Fraction of the overlap beyond it that pymunk corrects in a time step by default: 1 - (1 -
0.1)^(60 dt)."""

CENTER = (0.0, 45.0)
"""The T's center of friction in the standard variant, body frame, px. Only the hidden variant's
draw begins from it; the player does not know it."""

MAX_OFFSET = 30.0
"""Greatest distance of the hidden variant's center of friction from that, px."""

SUCCESS = 0.95
"""Coverage above which an episode is won."""

EPISODES = 500
QUICK_EPISODES = 4

FILM_EPISODES = 4
"""Number of episodes in a film."""

FILM_COLUMNS = 2
"""Episodes side by side in a film."""

FILM_SIZE = 240
"""Width and height of an episode in a film, pixels of the film."""

FIELD_SIZE = 512
"""Width and height of the plane, px."""

DOT_RADIUS = 4
"""Radius of the dot where the T is believed to turn about, pixels of the film."""

RING_RADIUS = 7
"""Radius of the ring where the T truly turns about, pixels of the film."""

FILM_COLORS = 32
"""Number of colors of a film."""

FILM_REST = 12
"""Pictures at the end of a film, which hold still."""

PICTURE_TIME = 100
"""Time of a picture in a film, ms: that of a decision."""

HIDDEN_STREAM = 34
"""Second word of the seed of the hidden variant's draw, so that it is not the player's seed."""


@dataclass(frozen=True)
class Episode:
    """An episode to play.

    Attributes:
        seed: of the environment and of the player.
        hidden: whether the center of friction is off.
    """

    seed: int
    hidden: bool

    def describe(self) -> str:
        """The episode in a few words."""
        return f"episode {self.seed}"


@dataclass(frozen=True)
class Played:
    """How an episode went.

    Attributes:
        success: whether the goal was covered by more than SUCCESS.
        max_coverage: greatest coverage.
        steps: decisions made.
        decision_time: mean time of the core for a decision, s.
        slowest: longest such time, s.
        center_error: distance of the learned center of friction from the true one, px.
        offset: distance of the true one from `CENTER`, px.
    """

    success: bool
    max_coverage: float
    steps: int
    decision_time: float
    slowest: float
    center_error: float
    offset: float


def make_block() -> SlidingBlock:
    """Makes the T as everybody knows it: outline, walls, and the disc."""
    return SlidingBlock(parts=(BAR, STEM), disc=DISC, walls=WALLS, slop=SLOP, correction=CORRECTION)


class PushTPlayer:
    """Plays one episode of PushT by its observations.

    Attributes:
        controller: decides, and learns.
    """

    def __init__(self, seed: int = 0) -> None:
        """Begins an episode; the seed is the search's."""
        # an episode has nothing to lose: it is never given up
        options = FeedbackOptions(success=SUCCESS, innovations=MAX_STEPS)
        self.controller = FeedbackController(make_block(), GOAL, options=options, seed=seed)

    def act(self, observation: Array) -> Array:
        """Chooses the action (2,) for an observation (5,): disc's x and y, T's x, y and angle."""
        return self.controller.decide(observation[:2], observation[2:5]).target


@dataclass(frozen=True)
class Options(StudyOptions):
    """What is measured.

    Attributes:
        episodes: number of episodes, seeded `seed`, `seed` + 1, ...
        hidden: whether the center of friction is off.
        strokes: whether `gridpush/PushTHidden-v0` is played instead.
        film: file that a film of the first episodes is written to; None for no film.
    """

    episodes: int = option(EPISODES, "Episodes, seeded --seed, --seed + 1, ...", least=1)
    hidden: bool = option(
        False, "Draw the center of friction up to 30 pixels off, by seed.", name="--hidden"
    )
    strokes: bool = option(
        False,
        "Play gridpush/PushTHidden-v0 instead: a hidden load and four open-loop strokes, with the "
        "learned, the even and the true model.",
        name="--strokes",
    )
    film: Path | None = option(
        None,
        "Also write a film of the first four episodes, side by side.",
        metavar="FILE.gif",
        ending=".gif",
        is_setting=False,
    )


def shorten(options: Options) -> Options:
    """Makes the options of the quick variant."""
    return replace(options, episodes=min(options.episodes, QUICK_EPISODES))


def make_jobs(options: Options) -> list[Episode | PrimitiveEpisode]:
    """Makes the episodes.

    Raises:
        MissingExtraError: gym-pusht is not installed.
        GridPushError: there is no episode.
        OutputError: the film cannot be written.
    """
    if options.film is not None:
        check_writable(options.film, options.force)
    if options.episodes < 1:
        raise GridPushError("episodes: none; expected at least one")
    if options.strokes:
        import_extra("gymnasium", "pusht")
        return [
            PrimitiveEpisode(options.seed + i, player)
            for i in range(options.episodes)
            for player in PLAYERS
        ]
    import_pusht()
    return [Episode(options.seed + i, options.hidden) for i in range(options.episodes)]


def import_pusht() -> Any:
    """Imports gym-pusht, without pygame's greeting.

    Raises MissingExtraError if it is not installed.
    """
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    return import_extra("gym_pusht", "pusht")


def draw_center(seed: int) -> Array:
    """Draws the hidden variant's center of friction (2,), px, evenly within MAX_OFFSET."""
    rng = np.random.default_rng((seed, HIDDEN_STREAM))
    distance = MAX_OFFSET * np.sqrt(rng.random())
    angle = rng.uniform(-np.pi, np.pi)
    return np.array(CENTER) + distance * np.array([np.cos(angle), np.sin(angle)])


def make_environment(center: Array | None = None) -> Any:
    """Makes the environment, as it is; with another center of friction (2,), px, if given."""
    import_pusht()
    gymnasium = import_extra("gymnasium", "pusht")
    own = {} if center is None else {"block_cog": (float(center[0]), float(center[1]))}
    return gymnasium.make(ENVIRONMENT, disable_env_checker=True, **own)


def _prepare(job: Episode) -> tuple[Array, Any]:
    """Returns an episode's true center of friction (2,), px, and its environment."""
    center = draw_center(job.seed) if job.hidden else np.array(CENTER)
    return center, make_environment(center if job.hidden else None)


def play(job: Episode) -> Played:
    """Plays one episode."""
    _load_kernels()
    center, env = _prepare(job)
    try:
        player = PushTPlayer(job.seed)
        fields = play_in(env, player, job.seed)
    finally:
        env.close()
    estimate = player.controller.learner.estimate
    error = np.hypot(estimate.center_x - center[0], estimate.center_y - center[1])
    return Played(
        **fields,
        center_error=float(error),
        offset=float(np.linalg.norm(center - np.array(CENTER))),
    )


@cache
def _load_kernels() -> None:
    """Loads what is compiled, or compiles it, so that no decision that is timed does."""
    player = PushTPlayer()
    disc = np.array([100.0, 100.0])
    pose = np.array(GOAL) + np.array([50.0, 0.0, 0.5])
    for shift in (0.0, 1.0):
        # the second pose, which has moved, is learned from
        player.controller.decide(disc, pose + shift)


def play_in(
    env: Any, player: PushTPlayer, seed: int, look: Callable[[Array], None] = lambda seen: None
) -> dict[str, Any]:
    """Plays an episode in an environment.

    Args:
        env: the environment.
        player: the player.
        seed: of the environment.
        look: called with what is observed, at the beginning and after each decision.

    Returns:
        The first fields of `Played`.
    """
    observation, _ = env.reset(seed=seed)
    coverages = []
    times = []
    over = False
    terminated = False
    look(observation)
    while not over:
        begin = thread_time()
        action = player.act(observation)
        times.append(thread_time() - begin)
        observation, _, terminated, truncated, info = env.step(action)
        coverages.append(float(info["coverage"]))
        over = bool(terminated or truncated)
        look(observation)
    return {
        "success": bool(terminated),
        "max_coverage": max(coverages),
        "steps": len(times),
        "decision_time": float(np.mean(times)),
        "slowest": max(times),
    }


def draw_centers(picture: Image.Image, player: PushTPlayer, pose: Array, truth: Array) -> None:
    """Draws about which point the T is believed to turn, as a dot, and truly turns, as a ring.

    Args:
        picture: an episode's picture, which is drawn into.
        player: the player.
        pose: (3,) of the T, px and rad.
        truth: (2,) the true center of friction, body frame, px.
    """
    estimate = player.controller.learner.estimate
    believed = np.array([estimate.center_x, estimate.center_y])
    draw = ImageDraw.Draw(picture)
    scale = FILM_SIZE / FIELD_SIZE
    (x, y), (true_x, true_y) = scale * transform(pose, np.array([believed, truth]))
    r = RING_RADIUS
    draw.ellipse((true_x - r, true_y - r, true_x + r, true_y + r), outline="black")
    r = DOT_RADIUS
    draw.ellipse((x - r, y - r, x + r, y + r), fill="orange", outline="black")


def _take_pictures(job: Episode) -> list[Image.Image]:
    """Plays an episode, and takes a picture at its beginning and after each decision."""
    truth, env = _prepare(job)
    player = PushTPlayer(job.seed)
    pictures = []

    def look(seen: Array) -> None:
        picture = Image.fromarray(env.render()).resize((FILM_SIZE, FILM_SIZE))
        draw_centers(picture, player, seen[2:5], truth)
        pictures.append(picture)

    try:
        play_in(env, player, job.seed, look)
    finally:
        env.close()
    return pictures


def write_film(path: Path, jobs: Sequence[Episode], force: bool = False) -> None:
    """Plays episodes again, and writes a film of them, side by side.

    Raises:
        OutputError: the file cannot be written.
    """
    films = [_take_pictures(job) for job in jobs]
    columns = min(FILM_COLUMNS, len(films))
    rows = -(-len(films) // columns)
    length = max(map(len, films)) + FILM_REST
    frames = []
    for k in range(length):
        frame = Image.new("RGB", (columns * FILM_SIZE, rows * FILM_SIZE), "white")
        for i, pictures in enumerate(films):
            place = ((i % columns) * FILM_SIZE, (i // columns) * FILM_SIZE)
            frame.paste(pictures[min(k, len(pictures) - 1)], place)
        frames.append(frame.quantize(FILM_COLORS))
    content = BytesIO()
    frames[0].save(
        content,
        "GIF",
        save_all=True,
        append_images=frames[1:],
        duration=PICTURE_TIME,
        loop=0,
        optimize=True,
    )
    write_whole(path, content.getvalue(), force)


def summarize(played: Sequence[Played]) -> dict[str, float]:
    """The figures that `--json` has at its top: shares from 0 to 1, counts of decisions, ms."""
    if not played:
        raise GridPushError("episodes: none was played; expected 1 or more")
    return {
        "episodes": len(played),
        "success": float(np.mean([each.success for each in played])),
        "mean_max_coverage": float(np.mean([each.max_coverage for each in played])),
        "mean_max_reward": float(
            np.mean([min(each.max_coverage / SUCCESS, 1.0) for each in played])
        ),
        "median_steps": float(np.median([each.steps for each in played])),
        "decision_ms": MS_PER_S * float(np.mean([each.decision_time for each in played])),
    }


def tabulate(options: Options, done: Done) -> list[Table]:
    """Tabulates the episodes."""
    if options.strokes:
        return [tabulate_strokes(done.of(STROKES_TASK))]
    if options.film is not None:
        jobs = [job for job, _ in done.list_pairs(TASK)]
        write_film(options.film, jobs[:FILM_EPISODES], options.force)
    return [tabulate_episodes(done.of(TASK), options.seed, options.hidden)]


def tabulate_episodes(played: Sequence[Played], seed: int, hidden: bool) -> Table:
    """Tabulates episodes, the first of which was seeded `seed`."""
    figures = summarize(played)
    fraction = Proportion.of(sum(each.success for each in played), len(played))
    coverages = [each.max_coverage for each in played]
    steps = [each.steps for each in played]
    spread = float(np.std(coverages, ddof=1) / np.sqrt(len(played))) if len(played) > 1 else 0.0
    rows: list[tuple[str, Value]] = [
        ("episodes", len(played)),
        ("won, with the 95 % interval", fraction.describe()),
        (
            "mean greatest coverage, and its standard error",
            f"{np.mean(coverages):.4f} ± {spread:.4f}",
        ),
        ("least greatest coverage", min(coverages)),
        ("mean greatest reward, coverage / 0.95 and at most 1", figures["mean_max_reward"]),
        ("median of the decisions", figures["median_steps"]),
        ("90 % of the episodes took at most, decisions", float(np.quantile(steps, 0.9))),
        ("longest episode, decisions", max(steps)),
        ("a decision, mean, ms", figures["decision_ms"]),
        ("slowest decision, ms", MS_PER_S * max(each.slowest for each in played)),
        (
            "true center of friction from the standard one, mean, px",
            float(np.mean([each.offset for each in played])),
        ),
        (
            "learned center from the true one, median, px",
            float(np.median([each.center_error for each in played])),
        ),
    ]
    variant = "hidden center of friction" if hidden else "standard"
    notes = (
        f"{ENVIRONMENT}, seeds {seed} to {seed + len(played) - 1}; states, {MAX_STEPS} "
        f"decisions of 0.1 s; won at a coverage above {SUCCESS}, where the episode ends.",
        "A decision is timed by the work of the one core that makes it.",
        "The player sees observations only. It knows outline, goal, walls and its own disc; center "
        "of friction and arm are learned in each episode.",
    )
    return Table(f"PushT, {variant}", ("what", "value"), rows, notes, digits=4, figures=figures)


TASK = JobKind(job=Episode, run=play, describe=Episode.describe)
"""What is done with an episode."""

STUDY = Study(
    name="pusht",
    help="Play PushT of gym-pusht with feedback, learning the T's friction within each episode.",
    options=Options,
    shorten=shorten,
    make_jobs=make_jobs,
    tasks=(TASK, STROKES_TASK),
    tabulate=tabulate,
)
"""`gridpush bench pusht`."""
