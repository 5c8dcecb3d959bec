"""`gridpush bench gym`: how many pushes a second the Gymnasium environments make, and how well players do in them.

The players are our own planner, one at random, and a small one that learns by trying: it rates each
place of the outline, in each of some directions, by a weighted sum of what the observation says of
it, takes the best, and pushes as far as another weighted sum says. CMA-ES finds the weights: it
keeps those that earned most in episodes which are the same for all that it compares.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from time import perf_counter, process_time
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import sem

from gridpush_drake.bench.jobs import QUIET, Execution, check_known, run_jobs
from gridpush_drake.bench.pregrasp.world import is_over
from gridpush_drake.bench.protocol import hide_parts, know_friction
from gridpush_drake.bench.speed import one_core
from gridpush_drake.bench.table import MM, PERCENT, Column, Table, Value, count_of, mean_of
from gridpush_drake.errors import MissingExtraError
from gridpush_drake.extras import import_extra
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.result import Identification
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.goal.next_push import GoalRules
from gridpush_drake.planning.goal.push_to_goal import push_to_goal
from gridpush_drake.planning.loop_run import Learner, run_loop
from gridpush_drake.planning.pregrasp.exploration import (
    choose_poke,
    make_center_functional,
    make_pokes,
)
from gridpush_drake.planning.pregrasp.planner import PreGraspOptions, PreGraspPlanner
from gridpush_drake.planning.pregrasp.pregrasp_loop import PreGraspLoop, PreGraspLoopOptions
from gridpush_drake.planning.pregrasp.slides import SlideOptions
from gridpush_drake.planning.push_constraints import PushConstraints
from gridpush_drake.pushes.push_log import PushLog

try:
    from gridpush_drake.gym import PushEnvironment, PushVectorEnvironment
    from gridpush_drake.gym.episode import FRICTION_RANGE
    from gridpush_drake.gym.games import GAMES, HELD_OUT, ITERATIONS, MAX_ARM, REACHED
    from gridpush_drake.gym.known_shape import FINGER, PLACES
    from gridpush_drake.gym.world import EnvironmentWorld
except ModuleNotFoundError as error:
    if error.name != "gymnasium":
        raise
    raise MissingExtraError(
        "gymnasium: is not installed; expected pip install 'gridpush-drake[gym]'"
    ) from error

cma = import_extra("cma", "baselines")

PLANNER, LEARNED, RANDOM = "planner", "learned", "random"
PLAYERS = (PLANNER, LEARNED, RANDOM)
"""Our own planner, a small one trained by CMA-ES, and chance."""

EPISODES, QUICK_EPISODES = 20, 2
"""That each player plays, the same for all."""

CANDIDATES, TRAINING_EPISODES = 12, 16
"""Weights in a generation, and episodes that each of them plays."""

GENERATIONS = {"PushToGoal": 16, "SlideToEdge": 16, "Explore": 6}
"""Of the training: about a minute on an idle core."""

QUICK_GENERATIONS = 1

SIDE_BY_SIDE = 64
"""Episodes in the vector environment whose speed is measured."""

STEPS, QUICK_STEPS = {"PushToGoal": 60, "SlideToEdge": 60, "Explore": 8}, 2
"""Of that environment, that are timed."""

SIMULATIONS = {"Explore": 1 + ITERATIONS + HELD_OUT}
"""Simulated pushes in a step, where there is more than the one that is made."""


AIM = 0.8 * REACHED
"""m of mean cell error as it is seen, at which the planner stops: it sees poses with noise."""

SLIDE = SlideOptions(contact=replace(FINGER, starts=6, budget=24))
"""The planner's slides: the environment's own pushes."""

DIRECTIONS = (-0.5, 0.0, 0.5)
"""That the learned player chooses from, as actions."""

WEIGHTS, SPREAD = 11, 1.0
"""Of the learned player: eight rate a place and a direction, three the distance; and the first
ones' deviation."""


@dataclass(frozen=True)
class Score:
    """How one episode ended: the sum of all rewards, and the game's own measure, m."""

    reward: float
    won: bool
    fell: bool
    pushes: int
    score: float


@dataclass(frozen=True)
class Job:
    """A player's episodes in one game, the first one's seed and how many; and generations of its training."""

    game: str
    player: str
    seed: int
    episodes: int
    generations: int = 0


@dataclass(frozen=True)
class Played:
    """What came of a job; wall clock of the training, s."""

    game: str
    player: str
    scores: list[Score] = field(default_factory=list)
    seconds: float = 0.0


def run(
    games: Sequence[str] | None = None,
    episodes: int = EPISODES,
    seed: int = 0,
    execution: Execution = QUIET,
    *,
    quick: bool = False,
) -> list[Table]:
    """Measures the environments' speed, then lets every player play the same episodes, of all games where None.

    The arguments are the options of `gridpush bench gym`; two episodes, and hardly any training,
    where `quick`.

    Raises:
        GridPushError: a game is not known.
    """
    chosen = list(games or GAMES)
    check_known("games", chosen, tuple(GAMES))
    count = QUICK_EPISODES if quick else episodes
    speeds = tabulate_speed([(game, QUICK_STEPS if quick else STEPS[game]) for game in chosen])

    def describe(job: Job) -> str:
        return f"{job.game}, {job.player}, seed {job.seed}"

    jobs = [Job(game, PLANNER, seed + i, 1) for game in chosen for i in range(count)]
    for game in chosen:
        jobs += [
            Job(game, LEARNED, seed, count, QUICK_GENERATIONS if quick else GENERATIONS[game]),
            Job(game, RANDOM, seed, count),
        ]
    return [speeds, tabulate_scores(run_jobs(run_job, jobs, describe, execution), chosen)]


def run_job(job: Job) -> Played:
    """Does one job."""
    if job.player == PLANNER:
        return Played(job.game, job.player, [play_planner(job.game, job.seed)])
    if job.player == RANDOM:
        return Played(job.game, job.player, play_random(job.game, job.seed, job.episodes))
    begin = perf_counter()
    weights = train(job.game, job.seed, job.generations, CANDIDATES, TRAINING_EPISODES)
    seconds = perf_counter() - begin
    return Played(
        job.game, job.player, play_learned(job.game, weights, job.seed, job.episodes), seconds
    )


def tabulate_speed(games: Sequence[tuple[str, int]]) -> Table:
    """Times vector environments that chance plays, for so many steps after the first."""
    rows: list[list[Value]] = []
    with one_core():
        for game, steps in games:
            env = PushVectorEnvironment(SIDE_BY_SIDE, game)
            env.reset(seed=0)
            rng, made = np.random.default_rng(0), 0
            env.step(rng.uniform(-1, 1, (SIDE_BY_SIDE, 3)))  # whatever is made once
            begin, busy = perf_counter(), process_time()
            for _ in range(steps):
                before = [len(episode.pushes) for episode in env.episodes]
                env.step(rng.uniform(-1, 1, (SIDE_BY_SIDE, 3)))
                made += sum(
                    len(now.pushes) > was for now, was in zip(env.episodes, before, strict=True)
                )
            rates = made / (perf_counter() - begin), made / (process_time() - busy)
            rows.append([game, SIDE_BY_SIDE, made, *rates, rates[1] * SIMULATIONS.get(game, 1)])
    return Table(
        "Speed of the vector environments, on one core",
        (
            "game", "side by side", "pushes", "pushes a second", "pushes a second of the core's time",
            "simulated pushes a second of its time",
        ),
        rows,
        (
            "Whole steps at random, with observations, rewards and new episodes; by wall clock, and by the time that"
            " the core worked for it, which is less where other programs run.",
            f"A step of Explore simulates {SIMULATIONS['Explore']} pushes: the one made, its derivatives "
            f"{ITERATIONS} times for the learner, and {HELD_OUT} that are held out.",
        ),
        digits=4,
    )  # fmt: skip


def tabulate_scores(played: Sequence[Played], games: Sequence[str]) -> Table:
    """How the players did."""
    columns: dict[str, Column] = {
        "episodes": len,
        "reward": mean_of("reward"),
        "standard error": lambda scores: (
            float(sem([score.reward for score in scores])) if len(scores) > 1 else None
        ),
        "won, %": mean_of("won", PERCENT),
        "fell": count_of("fell", True),
        "pushes": mean_of("pushes"),
        "final score, mm": lambda scores: MM * float(np.median([score.score for score in scores])),
    }
    rows: list[list[Value]] = []
    for game in games:
        for player in PLAYERS:
            chosen = [entry for entry in played if (entry.game, entry.player) == (game, player)]
            scores = [score for entry in chosen for score in entry.scores]
            row = {name: calc(scores) for name, calc in columns.items()}
            row |= {"won, %": None} if game == "Explore" else {}
            rows.append(
                [game, player, *row.values(), sum(entry.seconds for entry in chosen) or None]
            )
    notes = (
        "All play the same episodes: objects, hidden masses, starts, goals. Reward: mean of an episode's sum.",
        "Final score, median: mean cell error to the goal; how far a part to be grasped hangs over the edge; error"
        " of foretold pushes.",
        "planner: this project's own, learning as it goes; learned: a linear rating of places and directions by "
        f"{CANDIDATES} candidates a generation of CMA-ES, trained on other episodes; random: any action.",
    )
    return Table(
        "Players of the environments",
        ("game", "player", *columns, "training, s"),
        rows,
        notes,
        keys=2,
    )


def play_planner(game: str, seed: int) -> Score:
    """Lets our own planner play an episode of a game; the seed is also the planner's."""
    world = EnvironmentWorld(PushEnvironment(game), seed)
    PLANNED[game](world, seed)
    end = world.episode
    return Score(
        reward=world.reward,
        won=world.won,
        fell=end.fallen,
        pushes=len(end.pushes),
        score=float(end.score),
    )


def _hide(obj: GridObject) -> GridObject:
    """The object as the planner sees it: no parts, no weight, and the range that frictions are drawn from."""
    return know_friction(hide_parts(obj), *FRICTION_RANGE)


def _push_to_goal(world: EnvironmentWorld, seed: int) -> None:
    episode, game = world.episode, world.env.game
    assert episode.goal is not None
    constraints = PushConstraints(game.surface, finger_inset=-FINGER.distance_range[1])
    rules = GoalRules(constraints, FINGER, tolerance=AIM, max_pushes=game.options.max_pushes)
    push_to_goal(world, _hide(episode.shape.obj), episode.goal, rules, learner=Learner(seed=seed))


def _slide_to_edge(world: EnvironmentWorld, seed: int) -> None:
    obj, surface = _hide(world.episode.shape.obj), world.env.game.surface
    planner = PreGraspPlanner(obj, surface, PreGraspOptions(max_arm=MAX_ARM, slide=SLIDE))
    loop = PreGraspLoop(
        planner,
        lambda *_: None,
        seed=seed,
        options=PreGraspLoopOptions(observations=1, timeout=0.1),
    )
    learner = Learner(memory=14, seed=seed)

    def learn(
        obj: GridObject, log: PushLog, before: Identification | None
    ) -> Identification | None:
        return before if world.over else learner(obj, log, before)

    run_loop(loop, obj, world, is_over, learn=learn, surface=surface)


def _explore(world: EnvironmentWorld, seed: int) -> None:
    while not world.over:
        episode = world.episode
        assert episode.model is not None
        pokes = make_pokes(episode.model, episode.pose)
        world.execute(
            choose_poke(
                episode.model, episode.pose, pokes, make_center_functional(episode.model)
            ).push
        )


PLANNED: dict[str, Callable[[EnvironmentWorld, int], None]] = {
    "PushToGoal": _push_to_goal,
    "SlideToEdge": _slide_to_edge,
    "Explore": _explore,
}
"""Functions that play an episode of each game with our own planner, of a seed."""


def play_random(game: str, seed: int, episodes: int) -> list[Score]:
    """Lets chance play episodes, seeded `seed`, `seed` + 1, ..."""
    rng = np.random.default_rng(seed)
    return _play_all(game, seed, episodes, lambda seen: rng.uniform(-1, 1, (episodes, 3)))


def play_learned(game: str, weights: Array, seed: int, episodes: int) -> list[Score]:
    """Lets the weights (WEIGHTS,) play episodes, seeded `seed`, `seed` + 1, ..."""
    return _play_all(game, seed, episodes, lambda seen: choose_by_weights(weights, seen))


def train(game: str, seed: int, generations: int, candidates: int, episodes: int) -> Array:
    """Finds weights (WEIGHTS,) by CMA-ES: the mean of the last generation.

    Each of a generation's candidates plays the same episodes.
    """
    rng = np.random.default_rng(seed)
    options = {"seed": int(rng.integers(1, 2**31)), "popsize": candidates, "verbose": -9}
    search = cma.CMAEvolutionStrategy(np.zeros(WEIGHTS), SPREAD, options)
    for _ in range(generations):
        first, tried = int(rng.integers(2**31)), search.ask()
        earned = [
            np.mean([score.reward for score in play_learned(game, w, first, episodes)])
            for w in tried
        ]
        search.tell(tried, [-value for value in earned])
    return np.asarray(search.result.xfavorite)


def choose_by_weights(weights: Array, seen: dict[str, NDArray[Any]]) -> Array:
    """The learned player's actions (N, 3) for N observations."""
    count, directions = len(seen["pose"]), np.array(DIRECTIONS)
    outline = seen["outline"].reshape(count, PLACES, 4).astype(np.float64)
    middle = outline[..., :2].mean(axis=1, keepdims=True)
    arm = outline[..., :2] - middle
    size = np.sqrt((arm**2).sum(axis=-1).mean(axis=1))[:, None, None]
    wanted, turn = _find_wanted(seen, middle[:, 0])
    low, high = FINGER.angle_range
    angle = low + (high - low) * (directions + 1) / 2
    c, s, nx, ny = np.cos(angle), np.sin(angle), outline[..., 2, None], outline[..., 3, None]
    ux, uy = c * nx - s * ny, s * nx + c * ny
    lever = (arm[..., 0, None] * uy - arm[..., 1, None] * ux) / size
    far = np.linalg.norm(wanted, axis=1)[:, None, None]
    along = (ux * wanted[:, 0, None, None] + uy * wanted[:, 1, None, None]) / (
        far + np.finfo(float).tiny
    )
    last = (seen["last_action"][:, :1] + 1) / 2 - np.arange(PLACES) / PLACES
    pushed = np.abs(seen["last_action"]).max(axis=1) > 0
    near = np.cos(2 * np.pi * last)[..., None] * pushed[:, None, None]
    spin = turn[:, None, None]
    features = np.stack(
        np.broadcast_arrays(
            along, along * far / size, lever * spin, np.abs(lever), np.abs(lever) * np.abs(spin),
            np.abs(lever) * far / size, near, np.abs(angle),
        )
    )  # fmt: skip
    rated = np.tensordot(weights[:8], features, axes=1).reshape(count, -1)
    best = rated.argmax(axis=1)
    place, direction = best // len(directions), directions[best % len(directions)]
    reach = np.stack([np.ones(count), far[:, 0, 0] / size[:, 0, 0], np.abs(turn)])
    return np.column_stack([2 * place / PLACES - 1, direction, np.tanh(weights[8:] @ reach)])


def _find_wanted(seen: dict[str, NDArray[Any]], middle: Array) -> tuple[Array, Array]:
    """By how much the object's middle (N, 2), body frame, m, is to move, (N, 2), and to turn, (N,) rad."""
    pose = seen["pose"].astype(np.float64)
    x, y, c, s = pose.T
    here = np.column_stack(
        [x + c * middle[:, 0] - s * middle[:, 1], y + s * middle[:, 0] + c * middle[:, 1]]
    )
    turn = np.zeros(len(pose))
    if "goal" in seen:
        gx, gy, gc, gs = seen["goal"].astype(np.float64).T
        there = np.column_stack(
            [gx + gc * middle[:, 0] - gs * middle[:, 1], gy + gs * middle[:, 0] + gc * middle[:, 1]]
        )
        turn, move = np.arctan2(gs * c - gc * s, gc * c + gs * s), there - here
    elif "estimate" in seen:
        move = np.zeros_like(here)
    else:  # to the nearest edge
        room = seen["table"] - np.abs(here)
        nearest = room.argmin(axis=1)
        move = np.zeros_like(here)
        rows = np.arange(len(here))
        move[rows, nearest] = np.sign(here[rows, nearest]) * room[rows, nearest]
    return np.column_stack([c * move[:, 0] + s * move[:, 1], c * move[:, 1] - s * move[:, 0]]), turn


def _play_all(
    game: str, seed: int, episodes: int, choose: Callable[[dict[str, NDArray[Any]]], Array]
) -> list[Score]:
    """Plays one episode in each place of a vector environment."""
    env = PushVectorEnvironment(episodes, game)
    seen, _ = env.reset(seed=seed)
    scores: list[Score | None] = [None] * episodes
    rewards = np.zeros(episodes)
    while any(score is None for score in scores):
        seen, earned, terminated, cut_off, infos = env.step(choose(seen))
        for i in map(int, np.flatnonzero(np.asarray(terminated) | np.asarray(cut_off))):
            if scores[i] is None:
                end = env.episodes[i]
                total = float(rewards[i] + earned[i])
                won = bool(infos["is_success"][i])
                scores[i] = Score(total, won, end.fallen, len(end.pushes), float(end.score))
        rewards += earned
    return [score for score in scores if score is not None]
