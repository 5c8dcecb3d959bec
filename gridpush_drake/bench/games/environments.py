"""`gridpush bench gym`: the speed of the Gymnasium environments, and how well players do in them.

The players are our own planner, one that plays at random, and a small one that learns by trying.
The last one rates each place of the outline, in each of some directions, by a weighted sum of what
the observation says of it. It takes the best one, and pushes as far as another weighted sum says.
CMA-ES finds the weights: it keeps those that earned most in episodes which are the same for all
that it compares.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from time import perf_counter, process_time
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import sem

from gridpush_drake.bench.data.protocol import hide_parts, know_friction
from gridpush_drake.bench.pregrasp.world import is_over
from gridpush_drake.bench.study import Done, JobKind, Study, StudyOptions, option
from gridpush_drake.bench.timing import one_core
from gridpush_drake.errors import GridPushError, MissingExtraError
from gridpush_drake.extras import import_extra
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.result import Identification
from gridpush_drake.jobs.run import Report, check_known
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.exploration.designed_pokes import DesignedPokes
from gridpush_drake.planning.goal.next_push import GoalRules
from gridpush_drake.planning.goal.push_to_goal import push_to_goal
from gridpush_drake.planning.loop_run import Learner, run_loop
from gridpush_drake.planning.pregrasp.decision import PreGraspOptions
from gridpush_drake.planning.pregrasp.planner import PreGraspPlanner
from gridpush_drake.planning.pregrasp.pregrasp_loop import PreGraspLoop, PreGraspLoopOptions
from gridpush_drake.planning.pregrasp.slides import SlideOptions
from gridpush_drake.planning.push_constraints import PushConstraints
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.report.table import Column, Table, Value, count_of, mean_of
from gridpush_drake.units import MM_PER_M, PERCENT_PER_ONE

try:
    from gridpush_drake.bench.games.linear_player import WEIGHT_COUNT, choose_by_weights
    from gridpush_drake.gym import PushEnvironment, PushVectorEnvironment
    from gridpush_drake.gym.episode import FRICTION_RANGE
    from gridpush_drake.gym.games import (
        FILTER_ITERATIONS,
        GOAL_TOLERANCE,
        HELD_OUT,
        MAX_ARM,
    )
    from gridpush_drake.gym.known_shape import FINGER_OPTIONS
    from gridpush_drake.gym.world import EnvironmentWorld
except ModuleNotFoundError as error:
    if error.name != "gymnasium":
        raise
    raise MissingExtraError("gymnasium: is not installed; expected pip install '.[gym]'") from error

PLANNER_PLAYER = "planner"
"""Name of our own planner."""

LEARNED_PLAYER = "learned"
"""Name of the small player that is trained by CMA-ES."""

RANDOM_PLAYER = "random"
"""Name of the player that plays at random."""

PLAYER_NAMES = (PLANNER_PLAYER, LEARNED_PLAYER, RANDOM_PLAYER)
"""Names of the players."""

EPISODE_COUNT = 20
"""Number of episodes of each game that each player plays, the same for all."""

QUICK_EPISODES = 2
"""Number of episodes in the quick variant."""

CANDIDATE_COUNT = 12
"""Number of weights that CMA-ES compares in a generation."""

TRAINING_EPISODES = 16
"""Number of episodes that each of them plays."""

GENERATION_COUNTS = {"PushToGoal": 16, "SlideToEdge": 16, "Explore": 6, "PushTHidden": 16}
"""Number of generations of the training in each game: about a minute on an idle core."""

QUICK_GENERATIONS = 1
"""Number of generations in the quick variant."""

SIDE_BY_SIDE = 64
"""Number of episodes in the vector environment whose speed is measured."""

TIMED_STEP_COUNTS = {"PushToGoal": 60, "SlideToEdge": 60, "Explore": 8, "PushTHidden": 60}
"""Number of steps of that environment that are timed in each game."""

QUICK_STEPS = 2
"""Number of steps that are timed in the quick variant."""

SIMULATIONS_PER_STEP = {"Explore": 1 + FILTER_ITERATIONS + HELD_OUT}
"""Number of simulated pushes in a step of the games in which that is not only the one that is
made."""

PLANNER_TOLERANCE = 0.8 * GOAL_TOLERANCE
"""Mean cell error as it is seen, at which the planner stops, m: it sees poses with noise."""

SLIDE_OPTIONS = SlideOptions(contact=replace(FINGER_OPTIONS, starts=6, budget=24))
"""What the planner's slides are chosen from: pushes that the environment can make."""

INITIAL_WEIGHT_STD = 1.0
"""Standard deviation of the first weights that CMA-ES draws."""


@dataclass(frozen=True)
class GymBenchOptions(StudyOptions):
    """What is measured.

    Attributes:
        games: names of games; all of them where None.
        episodes: number of episodes of each game that each player plays.
        generations: number of generations of the training in each game.
        steps: number of steps that are timed in each game.
    """

    games: tuple[str, ...] | None = option(
        None, "A game; may be repeated.", name="--game", metavar="NAME", shown="all"
    )
    episodes: int = option(EPISODE_COUNT, "Episodes of each game that each player plays.", least=2)
    generations: Mapping[str, int] = field(default_factory=lambda: GENERATION_COUNTS)
    steps: Mapping[str, int] = field(default_factory=lambda: TIMED_STEP_COUNTS)

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the games."""
        return tuple(self.games or PLANNER_EPISODES)


@dataclass(frozen=True)
class GameScore:
    """How one episode ended.

    Attributes:
        reward: sum of all rewards.
        won: whether the game's aim was reached.
        fell: whether the object fell off the table.
        pushes: number of pushes.
        score: the game's own measure at the end, m.
    """

    reward: float
    won: bool
    fell: bool
    pushes: int
    score: float


@dataclass(frozen=True)
class GameJob:
    """A player's episodes in one game.

    Attributes:
        game: name of the game.
        player: one of PLAYER_NAMES.
        seed: seed of the first episode; the others' follow.
        episodes: number of episodes.
        generations: number of generations of the player's training.
    """

    game: str
    player: str
    seed: int
    episodes: int
    generations: int = 0


@dataclass(frozen=True)
class PlayedGame:
    """What came of a job.

    Attributes:
        game: name of the game.
        player: one of PLAYER_NAMES.
        scores: how each episode ended.
        seconds: wall-clock time of the training, s.
    """

    game: str
    player: str
    scores: list[GameScore] = field(default_factory=list)
    seconds: float = 0.0


def shorten(options: GymBenchOptions) -> GymBenchOptions:
    """Makes the options of the quick variant: two episodes, and hardly any training."""
    return replace(
        options,
        episodes=QUICK_EPISODES,
        generations=dict.fromkeys(PLANNER_EPISODES, QUICK_GENERATIONS),
        steps=dict.fromkeys(PLANNER_EPISODES, QUICK_STEPS),
    )


def measure(options: GymBenchOptions, report: Report | None) -> list[Table]:
    """Measures the environments' speed."""
    _check(options)
    return [tabulate_speed([(game, options.steps[game]) for game in options.names])]


def make_jobs(options: GymBenchOptions) -> list[GameJob]:
    """Makes a job for each episode of the planner, and one for each other player, in each game.

    Raises:
        GridPushError: a game is not known.
        MissingExtraError: the package cma is not installed, by which the learned player learns.
    """
    _check(options)
    planned = [
        GameJob(game=game, player=PLANNER_PLAYER, seed=options.seed + i, episodes=1)
        for game in options.names
        for i in range(options.episodes)
    ]
    others = []
    for game in options.names:
        chance = GameJob(
            game=game, player=RANDOM_PLAYER, seed=options.seed, episodes=options.episodes
        )
        others.append(replace(chance, player=LEARNED_PLAYER, generations=options.generations[game]))
        others.append(chance)
    return [*planned, *others]


def _check(options: GymBenchOptions) -> None:
    check_known("games", options.names, tuple(PLANNER_EPISODES))
    # That it is missing is said now, and not after minutes of other jobs.
    import_extra("cma", "baselines")


def run_job(job: GameJob) -> PlayedGame:
    """Does one job."""
    if job.player == PLANNER_PLAYER:
        return PlayedGame(job.game, job.player, [play_planner(job.game, job.seed)])
    if job.player == RANDOM_PLAYER:
        return PlayedGame(job.game, job.player, play_random(job.game, job.seed, job.episodes))
    begin = perf_counter()
    weights = train(job.game, job.seed, job.generations, CANDIDATE_COUNT, TRAINING_EPISODES)
    seconds = perf_counter() - begin
    scores = play_learned(job.game, weights, job.seed, job.episodes)
    return PlayedGame(job.game, job.player, scores, seconds)


def tabulate(options: GymBenchOptions, done: Done) -> list[Table]:
    """Tabulates how the players did."""
    return [tabulate_scores(done.of(GAME_JOBS), options.names)]


def tabulate_speed(games: Sequence[tuple[str, int]]) -> Table:
    """Times vector environments that chance plays.

    Args:
        games: name of each game, and how many steps after the first one are timed.
    """
    rows: list[list[Value]] = []
    with one_core():
        for game, steps in games:
            env = PushVectorEnvironment(SIDE_BY_SIDE, game)
            env.reset(seed=0)
            rng = np.random.default_rng(0)
            made = 0
            # Whatever is made once is made in the first step, which is not timed.
            env.step(rng.uniform(-1, 1, (SIDE_BY_SIDE, 3)))
            begin = perf_counter()
            busy = process_time()
            for _ in range(steps):
                before = [len(episode.pushes) for episode in env.episodes]
                env.step(rng.uniform(-1, 1, (SIDE_BY_SIDE, 3)))
                made += sum(
                    len(now.pushes) > was for now, was in zip(env.episodes, before, strict=True)
                )
            rate = made / (perf_counter() - begin)
            core_rate = made / (process_time() - busy)
            simulated_rate = core_rate * SIMULATIONS_PER_STEP.get(game, 1)
            rows.append([game, SIDE_BY_SIDE, made, rate, core_rate, simulated_rate])
    columns = (
        "game",
        "side by side",
        "pushes",
        "pushes a second",
        "pushes a second of the core's time",
        "simulated pushes a second of its time",
    )
    notes = (
        "Whole steps at random, with observations, rewards and new episodes; by wall clock, and by "
        "the time that the core worked for it, which is less where other programs run.",
        f"A step of Explore simulates {SIMULATIONS_PER_STEP['Explore']} pushes: the one made, its "
        f"derivatives {FILTER_ITERATIONS} times for the learner, and {HELD_OUT} that are held out.",
    )
    title = "Speed of the vector environments, on one core"
    return Table(title, columns, rows, notes, digits=4)


def tabulate_scores(played: Sequence[PlayedGame], games: Sequence[str]) -> Table:
    """Tabulates by game and player how the players did."""
    columns: dict[str, Column] = {
        "episodes": len,
        "reward": mean_of("reward"),
        "standard error": lambda scores: (
            float(sem([score.reward for score in scores])) if len(scores) > 1 else None
        ),
        "won, %": mean_of("won", PERCENT_PER_ONE),
        "fell": count_of("fell", True),
        "pushes": mean_of("pushes"),
        "final score, mm": lambda scores: (
            MM_PER_M * float(np.median([score.score for score in scores]))
        ),
    }
    rows: list[list[Value]] = []
    for game in games:
        for player in PLAYER_NAMES:
            chosen = [entry for entry in played if (entry.game, entry.player) == (game, player)]
            scores = [score for entry in chosen for score in entry.scores]
            row = {name: calc(scores) for name, calc in columns.items()}
            if game == "Explore":
                row["won, %"] = None  # it cannot be won
            training = sum(entry.seconds for entry in chosen) or None
            rows.append([game, player, *row.values(), training])
    notes = (
        "All play the same episodes: objects, hidden masses, starts, goals. Reward: mean of an "
        "episode's sum.",
        "Final score, median: mean cell error to the goal; how far a part to be grasped hangs over "
        "the edge; error of predicted pushes.",
        "planner: this project's own, learning as it goes; learned: a linear rating of places and "
        f"directions by {CANDIDATE_COUNT} candidates a generation of CMA-ES, trained on other "
        "episodes; "
        "random: any action.",
    )
    names = ("game", "player", *columns, "training, s")
    return Table("Players of the environments", names, rows, notes, keys=2)


def play_planner(game: str, seed: int) -> GameScore:
    """Lets our own planner play an episode of a game; the seed is also the planner's."""
    world = EnvironmentWorld(PushEnvironment(game), seed)
    PLANNER_EPISODES[game](world, seed)
    end = world.episode
    return GameScore(
        reward=world.reward,
        won=world.won,
        fell=end.fallen,
        pushes=len(end.pushes),
        score=float(end.score),
    )


def _hide(obj: GridObject) -> GridObject:
    """Returns the object as the planner sees it: no parts, no weight, bounds of its frictions."""
    return know_friction(hide_parts(obj), *FRICTION_RANGE)


def _push_to_goal(world: EnvironmentWorld, seed: int) -> None:
    """Pushes the object to its goal, and learns it on the way."""
    episode = world.episode
    game = world.game
    assert episode.goal is not None
    constraints = PushConstraints(game.surface, finger_inset=-FINGER_OPTIONS.distance_range[1])
    rules = GoalRules(
        constraints, FINGER_OPTIONS, tolerance=PLANNER_TOLERANCE, max_pushes=game.options.max_pushes
    )
    push_to_goal(
        world, Model(_hide(episode.shape.obj)), episode.goal, rules, learner=Learner(seed=seed)
    )


def _slide_to_edge(world: EnvironmentWorld, seed: int) -> None:
    """Pokes the object, and slides a part of it over the edge."""
    obj = _hide(world.episode.shape.obj)
    surface = world.game.surface
    planner = PreGraspPlanner(obj, surface, PreGraspOptions(max_arm=MAX_ARM, slide=SLIDE_OPTIONS))
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

    run_loop(loop, world, is_over, obj=obj, learn=learn, surface=surface)


def _explore(world: EnvironmentWorld, seed: int) -> None:
    """Makes the pokes that tell most of the center of friction."""
    strategy = DesignedPokes()
    while not world.over:
        episode = world.episode
        assert episode.model is not None
        proposal = strategy.propose(episode.model, episode.pose, PushConstraints())
        if proposal.push is None:
            raise GridPushError(f"{episode.shape.obj.name}: {proposal.reason}")
        world.execute(proposal.push)


PLANNER_EPISODES: dict[str, Callable[[EnvironmentWorld, int], None]] = {
    "PushToGoal": _push_to_goal,
    "SlideToEdge": _slide_to_edge,
    "Explore": _explore,
    "PushTHidden": _push_to_goal,
}
"""Functions that play an episode of each game with our own planner, of a seed."""


def play_random(game: str, seed: int, episodes: int) -> list[GameScore]:
    """Lets chance play episodes, seeded `seed`, `seed` + 1, ..."""
    rng = np.random.default_rng(seed)
    return _play_all(game, seed, episodes, lambda seen: rng.uniform(-1, 1, (episodes, 3)))


def play_learned(game: str, weights: Array, seed: int, episodes: int) -> list[GameScore]:
    """Lets the weights (WEIGHT_COUNT,) play episodes, seeded `seed`, `seed` + 1, ..."""
    return _play_all(game, seed, episodes, lambda seen: choose_by_weights(weights, seen))


def train(game: str, seed: int, generations: int, candidates: int, episodes: int) -> Array:
    """Finds weights (WEIGHT_COUNT,) by CMA-ES: the mean of the last generation.

    Args:
        game: name of the game.
        seed: seed of the search and its episodes.
        generations: number of generations.
        candidates: number of weights in a generation.
        episodes: number of episodes that each of them plays, the same for all of a generation.
    """
    cma = import_extra("cma", "baselines")
    rng = np.random.default_rng(seed)
    options = {"seed": int(rng.integers(1, 2**31)), "popsize": candidates, "verbose": -9}
    search = cma.CMAEvolutionStrategy(np.zeros(WEIGHT_COUNT), INITIAL_WEIGHT_STD, options)
    for _ in range(generations):
        first = int(rng.integers(2**31))
        tried = search.ask()
        earned = [
            np.mean([score.reward for score in play_learned(game, w, first, episodes)])
            for w in tried
        ]
        search.tell(tried, [-value for value in earned])
    return np.asarray(search.result.xfavorite)


def _play_all(
    game: str, seed: int, episodes: int, choose: Callable[[dict[str, NDArray[Any]]], Array]
) -> list[GameScore]:
    """Plays one episode in each place of a vector environment."""
    env = PushVectorEnvironment(episodes, game)
    seen, _ = env.reset(seed=seed)
    scores: list[GameScore | None] = [None] * episodes
    rewards = np.zeros(episodes)
    while any(score is None for score in scores):
        seen, earned, terminated, cut_off, infos = env.step(choose(seen))
        for i in map(int, np.flatnonzero(np.asarray(terminated) | np.asarray(cut_off))):
            if scores[i] is None:
                end = env.episodes[i]
                total = float(rewards[i] + earned[i])
                won = bool(infos["is_success"][i])
                scores[i] = GameScore(
                    reward=total,
                    won=won,
                    fell=end.fallen,
                    pushes=len(end.pushes),
                    score=float(end.score),
                )
        rewards += earned
    return [score for score in scores if score is not None]


def _describe(job: GameJob) -> str:
    return f"{job.game}, {job.player}, seed {job.seed}"


GAME_JOBS = JobKind(job=GameJob, run=run_job, describe=_describe)
"""What is done with a job."""

STUDY = Study(
    name="gym",
    help="Time the Gymnasium environments; let our planner, a small learned player and chance play "
    "them.",
    options=GymBenchOptions,
    shorten=shorten,
    measure=measure,
    make_jobs=make_jobs,
    tasks=(GAME_JOBS,),
    tabulate=tabulate,
)
"""`gridpush bench gym`."""
