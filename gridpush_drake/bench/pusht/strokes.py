"""Players of `gridpush/PushTHidden-v0`: the T with a hidden load, in four strokes to its goal.

All of them are our own planner, and play the same episodes. They differ in the model that it plans
with: learned from the pokes and from each stroke, the even T, or the truth. `bench.pusht` runs
them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from gridpush_drake.bench.data.protocol import hide_parts, know_friction
from gridpush_drake.bench.study import JobKind
from gridpush_drake.extras import import_extra
from gridpush_drake.geometry.se2 import Array, transform_shape
from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.result import Identification
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.goal.next_push import GoalRules
from gridpush_drake.planning.goal.push_to_goal import push_to_goal
from gridpush_drake.planning.loop_run import Learner
from gridpush_drake.planning.push_constraints import PushConstraints
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.report.table import Proportion, Table, Value, calc_interval
from gridpush_drake.units import MM_PER_M

LEARNED = "learned"
"""Name of the player whose model is learned from the pokes and from each stroke."""

EVEN = "even"
"""Name of the player that takes the T for an even one."""

TRUE = "true"
"""Name of the player that is told the truth, which no honest player can be."""

PLAYERS = (LEARNED, EVEN, TRUE)
"""Names of the players."""

TOLERANCE = 0.001
"""Mean cell error, as it is seen, at which a player stops, m."""


@dataclass(frozen=True)
class PrimitiveEpisode:
    """An episode to play.

    Attributes:
        seed: of the environment and of the learner.
        player: one of PLAYERS.
    """

    seed: int
    player: str

    def describe(self) -> str:
        """The episode in a few words."""
        return f"four strokes, {self.player}, seed {self.seed}"


@dataclass(frozen=True)
class StrokesPlayed:
    """How an episode ended.

    Attributes:
        player: one of PLAYERS.
        seed: of the environment.
        reached: whether the T came within the game's tolerance.
        error: mean distance of the cells from where they are at the goal, m.
        coverage: fraction of the goal that the T covers.
        strokes: number of strokes.
        prediction_error: mean cell error of the strokes' predicted ends, m.
    """

    player: str
    seed: int
    reached: bool
    error: float
    coverage: float
    strokes: int
    prediction_error: float


@dataclass(frozen=True)
class PokesAndStrokes(Learner):
    """Learns from what was seen before the first stroke, too.

    Attributes:
        pokes: the pushes that were seen before.
    """

    pokes: PushLog = field(default_factory=lambda: PushLog(()))

    def __call__(
        self, obj: GridObject, log: PushLog, before: Identification | None
    ) -> Identification | None:
        """Learns from the pokes and all strokes."""
        return identify(
            Model(obj),
            PushLog((*self.pokes, *log)),
            seed=self.seed,
            regime="quasi_static",
            start=before,
        )


def play_strokes(job: PrimitiveEpisode) -> StrokesPlayed:
    """Plays one episode."""
    # gymnasium is an extra, which whoever lists the benches may lack
    import_extra("gymnasium", "pusht")
    from gridpush_drake.gym import EnvironmentWorld, PushEnvironment
    from gridpush_drake.gym.episode import FRICTION_RANGE
    from gridpush_drake.gym.known_shape import FINGER_OPTIONS

    world = EnvironmentWorld(PushEnvironment("PushTHidden"), job.seed)
    episode = world.episode
    assert episode.goal is not None
    obj = know_friction(hide_parts(episode.shape.obj), *FRICTION_RANGE)
    params: CellParameters | None = None
    learner: Learner | None = None
    if job.player == LEARNED:
        learner = PokesAndStrokes(seed=job.seed, pokes=episode.log)
        first = identify(Model(obj), episode.log, seed=job.seed, regime="quasi_static")
        params = first.params
    elif job.player == TRUE:
        params = episode.hidden
    game = world.game
    rules = GoalRules(
        PushConstraints(game.surface, finger_inset=-FINGER_OPTIONS.distance_range[1]),
        FINGER_OPTIONS,
        horizon=2,
        robustness=None,
        tolerance=TOLERANCE,
        max_pushes=game.options.max_pushes,
    )
    run = push_to_goal(world, Model(obj, params), episode.goal, rules, learner=learner)
    end = world.episode
    return StrokesPlayed(
        player=job.player,
        seed=job.seed,
        reached=world.won,
        error=float(end.score),
        coverage=calc_coverage(episode.shape.obj, end.true_pose, episode.goal),
        strokes=len(run.steps),
        prediction_error=float(np.mean([step.prediction_error for step in run.steps])),
    )


def calc_coverage(obj: GridObject, pose: Array, goal: Array) -> float:
    """Fraction of the goal (3,) that an object covers at a pose (3,)."""
    wanted = transform_shape(goal, obj.outline)
    return float(wanted.intersection(transform_shape(pose, obj.outline)).area / wanted.area)


def tabulate_strokes(played: Sequence[StrokesPlayed]) -> Table:
    """Tabulates the players, and how much better the learned model did than the even one."""
    rows: list[list[Value]] = []
    for player in PLAYERS:
        own = [each for each in played if each.player == player]
        if not own:
            continue
        reached = Proportion.of(sum(each.reached for each in own), len(own))
        rows.append(
            [
                player,
                len(own),
                reached.describe(),
                calc_interval([each.strokes for each in own]),
                calc_interval([each.error for each in own], MM_PER_M),
                calc_interval([each.coverage for each in own]),
                calc_interval([each.prediction_error for each in own], MM_PER_M),
            ]
        )
    columns = (
        "model",
        "episodes",
        "within 5 mm",
        "strokes",
        "final cell error, mm",
        "final coverage",
        "prediction error, mm",
    )
    notes = [
        "gridpush/PushTHidden-v0: three random pokes, seen; then four strokes at most, none of "
        "which is corrected while it is made.",
        "The same planner for all, two strokes ahead. Means with 95 % bootstrap intervals.",
    ]
    pairs = _pair(played)
    if len(pairs) > 1:
        gain = calc_interval([even.error - learned.error for learned, even in pairs], MM_PER_M)
        notes.append(
            f"Learned against even, episode by episode: {gain.describe()} mm of final cell error "
            "less."
        )
    return Table("PushT with a hidden load, in four strokes", columns, rows, notes)


def _pair(
    played: Sequence[StrokesPlayed],
) -> list[tuple[StrokesPlayed, StrokesPlayed]]:
    """Episodes that both the learned and the even model played, in pairs."""
    by_key = {(each.player, each.seed): each for each in played}
    seeds = sorted({each.seed for each in played})
    return [
        (by_key[LEARNED, seed], by_key[EVEN, seed])
        for seed in seeds
        if (LEARNED, seed) in by_key and (EVEN, seed) in by_key
    ]


STROKES_TASK = JobKind(job=PrimitiveEpisode, run=play_strokes, describe=PrimitiveEpisode.describe)
"""What is done with an episode."""
