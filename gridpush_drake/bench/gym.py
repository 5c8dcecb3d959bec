"""`gridpush bench gym`: how many pushes a second the Gymnasium environments make, and how well players do in them."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from time import perf_counter, process_time

import numpy as np

from gridpush_drake.bench.jobs import QUIET, Execution, check_known, run_jobs
from gridpush_drake.bench.speed import one_core
from gridpush_drake.bench.table import MM, PERCENT, Table, Value
from gridpush_drake.errors import GridPushError

try:
    from gridpush_drake.bench.gym_policies import Score, play_learned, play_planner, play_random, train
    from gridpush_drake.gym import PushVectorEnvironment
    from gridpush_drake.gym.games import GAMES, HELD_OUT, ITERATIONS
except ModuleNotFoundError as error:
    if error.name != "gymnasium":
        raise
    raise GridPushError("gymnasium: is not installed; expected pip install 'gridpush-drake[gym]'") from error

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


@dataclass(frozen=True)
class Job:
    """A player's episodes in one game.

    Attributes:
        game: of `gym.environments.GAMES`.
        player: of PLAYERS.
        seed: of the first episode; the others' follow.
        episodes: how many.
        generations: of the learned player's training.
    """

    game: str
    player: str
    seed: int
    episodes: int
    generations: int = 0


@dataclass(frozen=True)
class Played:
    """What came of a job.

    Attributes:
        game: that was played.
        player: of PLAYERS.
        scores: of the episodes.
        seconds: wall clock of the training.
    """

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
    """Measures the environments' speed, then lets every player play the same episodes.

    Args:
        games: of `gym.environments.GAMES`; all where None.
        episodes: that each player plays of each game.
        seed: of the first episode, and of the training.
        execution: how the jobs are run.
        quick: two episodes, and hardly any training.

    Returns:
        Steps a second; and reward, success and pushes by game and player.

    Raises:
        GridPushError: a game is not known.
    """
    chosen = list(games or GAMES)
    check_known("games", chosen, tuple(GAMES))
    count = QUICK_EPISODES if quick else episodes
    speeds = tabulate_speed([(game, QUICK_STEPS if quick else STEPS[game]) for game in chosen])
    jobs = [Job(game, PLANNER, seed + i, 1) for game in chosen for i in range(count)]
    for game in chosen:
        jobs += [
            Job(game, LEARNED, seed, count, QUICK_GENERATIONS if quick else GENERATIONS[game]),
            Job(game, RANDOM, seed, count),
        ]
    return [speeds, tabulate_scores(run_jobs(run_job, jobs, _describe, execution), chosen)]


def run_job(job: Job) -> Played:
    """Does one job."""
    if job.player == PLANNER:
        return Played(job.game, job.player, [play_planner(job.game, job.seed)])
    if job.player == RANDOM:
        return Played(job.game, job.player, play_random(job.game, job.seed, job.episodes))
    begin = perf_counter()
    weights = train(job.game, job.seed, job.generations, CANDIDATES, TRAINING_EPISODES)
    seconds = perf_counter() - begin
    return Played(job.game, job.player, play_learned(job.game, weights, job.seed, job.episodes), seconds)


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
                made += sum(len(now.pushes) > was for now, was in zip(env.episodes, before, strict=True))
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
    rows: list[list[Value]] = []
    for game in games:
        for player in PLAYERS:
            chosen = [entry for entry in played if (entry.game, entry.player) == (game, player)]
            scores = [score for entry in chosen for score in entry.scores]
            rewards = np.array([score.reward for score in scores])
            error = float(rewards.std(ddof=1) / np.sqrt(len(rewards))) if len(rewards) > 1 else float("nan")
            seconds = sum(entry.seconds for entry in chosen)
            wins: Value = None if game == "Explore" else PERCENT * float(np.mean([score.won for score in scores]))
            rows.append(
                [
                    game, player, len(scores), float(rewards.mean()), error, wins, sum(score.fell for score in scores),
                    float(np.mean([score.pushes for score in scores])),
                    MM * float(np.median([score.score for score in scores])), seconds or None,
                ]
            )  # fmt: skip
    return Table(
        "Players of the environments",
        (
            "game", "player", "episodes", "reward", "standard error", "won, %", "fell", "pushes", "final score, mm",
            "training, s",
        ),
        rows,
        (
            "All play the same episodes: objects, hidden masses, starts, goals. Reward: mean of an episode's sum.",
            "Final score, median: mean cell error to the goal; how far a part to be grasped hangs over the edge; error"
            " of foretold pushes.",
            "planner: this project's own, learning as it goes; learned: a linear rating of places and directions by "
            f"{CANDIDATES} candidates a generation of CMA-ES, trained on other episodes; random: any action.",
        ),
        keys=2,
    )  # fmt: skip


def _describe(job: Job) -> str:
    return f"{job.game}, {job.player}, seed {job.seed}"
