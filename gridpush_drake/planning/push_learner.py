"""The model of a driver that pushes: learned anew as its pushes come in, where that may pay."""

from dataclasses import dataclass, field
from time import perf_counter

from gridpush_drake.grid.object import GridObject
from gridpush_drake.grid.parameters import CellParameters
from gridpush_drake.identification.identify import identify
from gridpush_drake.identification.result import Identification
from gridpush_drake.planning.planned_push import calc_goal_error
from gridpush_drake.pushes.log import ObservedPush, PushLog


@dataclass(frozen=True)
class LearningOptions:
    """When to learn, and from what.

    Attributes:
        first: after each of the first so many pushes.
        least_error: and later, where the prediction was off by more, m (mean cell error),
        relative_error: and by more than this share of how far the cells moved.
        memory: most pushes, the last, that are learned from.
        seed: of the identification.
    """

    first: int = 3
    least_error: float = 0.004
    relative_error: float = 0.1
    memory: int = 8
    seed: int = 0


@dataclass(eq=False)
class Learner:
    """The model, and the pushes that it comes from.

    Attributes:
        obj: the object.
        params: the model.
        options: when to learn; None never.
        identification: that the model comes from; None before the first.
        seconds: wall-clock time spent on learning.
        seen: all pushes.
    """

    obj: GridObject
    params: CellParameters
    options: LearningOptions | None
    identification: Identification | None = None
    seconds: float = 0.0
    seen: list[ObservedPush] = field(default_factory=list)

    def take(self, seen: ObservedPush, error: float) -> bool:
        """Takes a push in.

        Args:
            seen: the push.
            error: of its prediction, mean cell distance, m.

        Returns:
            Whether the model was learned anew.
        """
        self.seen.append(seen)
        options = self.options
        if options is None or not len(seen.t_observed):
            return False
        moved = float(calc_goal_error(self.obj, seen.pose, seen.final_pose))
        surprised = error > max(options.least_error, options.relative_error * moved)
        if len(self.seen) > options.first and not surprised:
            return False
        begin = perf_counter()
        log = PushLog(tuple(self.seen[-options.memory :]))
        self.identification = identify(
            self.obj, log, seed=options.seed, regime="quasi_static", start=self.identification
        )
        self.params = self.identification.params
        self.seconds += perf_counter() - begin
        return True
