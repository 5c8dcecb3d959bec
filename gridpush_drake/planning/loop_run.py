"""Steps a closed loop in a world, push after push, and learns on the way.

The loop is the one that a controller in a station steps. Here nothing happens between two
observations but a push. The worlds are in `planning.world`.

After two surprises in a row, or a clear one (`identification.innovation`), what was seen before is
forgotten: the object's load has changed, and the pushes before that are another object's.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from time import perf_counter
from typing import Generic

import numpy as np

from gridpush_drake.errors import PushRefusedError
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.innovation import InnovationRecord
from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.result import Identification
from gridpush_drake.identification.statistics.friction_gradient import HeldFriction
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.closed_loop import ClosedLoop, LoopStateType, Observation
from gridpush_drake.planning.robot_status import PushStatus
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.planning.world import PushWorld
from gridpush_drake.pushes.push_log import ObservedPush, PushLog
from gridpush_drake.pushes.segmentation import UNUSABLE_ERRORS

UNSEEN_POSE = np.full(3, np.nan)
"""Pose (3,) of an object that is not seen, and the goal of a loop that is given none."""

Learn = Callable[[GridObject, PushLog, Identification | None], Identification | None]
"""Function that learns from pushes. It takes the object, all pushes so far, and what was learned
before; it returns what is learned now, or None where that is nothing yet."""


@dataclass(frozen=True)
class Learner:
    """Learns after every push, and begins where it ended the last time.

    Attributes:
        memory: number of pushes, the latest ones, that are learned from at most; the cost of
            learning grows with them.
        seed: seed of the identification.
    """

    memory: int = 8
    seed: int = 0

    def select(self, log: PushLog) -> PushLog:
        """Selects the pushes that are learned from: the latest ones whose motion was seen."""
        return log.subset([i for i, seen in enumerate(log) if len(seen.t_observed)][-self.memory :])

    def __call__(
        self, obj: GridObject, log: PushLog, before: Identification | None
    ) -> Identification | None:
        """Learns from the latest pushes; returns `before` where the last push shows nothing new."""
        return self.learn(obj, log, before)

    def learn(
        self,
        obj: GridObject,
        log: PushLog,
        before: Identification | None,
        friction: HeldFriction | None = None,
    ) -> Identification | None:
        """Learns from the latest pushes; returns `before` where the last push shows nothing new.

        Args:
            obj: the object.
            log: all pushes so far.
            before: what was learned before.
            friction: friction coefficients that are held; None for the prior's.
        """
        chosen = self.select(log)
        if not len(chosen) or chosen[-1] is not log[-1]:
            return before
        return identify(
            Model(obj),
            chosen,
            seed=self.seed,
            regime="quasi_static",
            start=before,
            friction=friction,
        )


@dataclass(frozen=True, eq=False)
class LoopRun(Generic[LoopStateType]):
    """What came of stepping a loop to its end.

    Attributes:
        state: the loop's last state.
        log: the pushes that were made.
        identification: what was learned from them; None where that is nothing.
        planning_seconds: wall-clock time of the loop's steps, s.
        learning_seconds: wall-clock time of learning, s.
        innovations: what surprises there were among the pushes.
        left_out: names of pushes from which nothing could be learned, and why. They are not shown
            to whoever learns again.
    """

    state: LoopStateType
    log: PushLog = field(default_factory=lambda: PushLog(()))
    identification: Identification | None = None
    planning_seconds: float = 0.0
    learning_seconds: float = 0.0
    innovations: InnovationRecord = field(default_factory=InnovationRecord)
    left_out: Mapping[str, str] = field(default_factory=dict)


def run_loop(
    loop: ClosedLoop[LoopStateType],
    world: PushWorld,
    is_over: Callable[[LoopStateType], bool] | None = None,
    *,
    obj: GridObject | None = None,
    learn: Learn | None = None,
    goal: Array | None = None,
    surface: SupportSurface | None = None,
    progress: Callable[[LoopStateType, ObservedPush, bool], None] | None = None,
    begun: LoopRun[LoopStateType] | None = None,
) -> LoopRun[LoopStateType]:
    """Steps a loop in a world until it is over.

    Args:
        loop: the closed loop.
        world: where the objects lie and are pushed.
        is_over: says of a loop's state whether it is the last one; by default it is where the loop
            has nothing to decide.
        obj: the object, as whoever learns sees it; None where nobody does, or the loop does so by
            itself, as that of several objects.
        learn: learns after every push, from all that are not forgotten; None never learns.
        goal: (3,) q_WB that the loop is shown as its goal, m and rad; None for none.
        surface: the table, as whoever learns knows it; None where pushes keep clear of its edge.
        progress: called after every push with the state that asked for it, what was seen, and
            whether something was learned from it.
        begun: what came of the run that this one goes on with; None where it is the first.

    Returns:
        The last state, the pushes, what was learned, and how long it took.
    """
    table = None if surface is None else surface.corners
    run = begun or LoopRun(state=loop.begin(), log=PushLog((), table=table))
    target = UNSEEN_POSE if goal is None else goal
    time = 0.0
    refusal = ""
    while not (is_over or loop.is_idle)(run.state):
        # The robot is ready whenever the loop looks: a push is over when `execute` returns.
        time += loop.options.period
        pose = world.observe()
        before = run.state.push_id
        begin = perf_counter()
        shown = Observation(
            time=time,
            pose=UNSEEN_POSE if pose is None else pose,
            robot=PushStatus(command_id=before, reason=refusal),
            log=run.log,
            identification=run.identification,
            goal=target,
        )
        state = loop.step(run.state, shown)
        planning_seconds = run.planning_seconds + perf_counter() - begin
        run = replace(run, state=state, planning_seconds=planning_seconds)
        if state.push is None or state.push_id == before:
            continue

        # The loop has asked for another push. It is made, and learned from, or the loop is told
        # why it was refused.
        try:
            seen = world.execute(state.push)
        except PushRefusedError as error:
            refusal = str(error)
            continue
        refusal = ""
        begin = perf_counter()
        log = run.log.append(seen)
        innovations = run.innovations.note(run.identification, log)
        found = run.identification
        left_out = run.left_out
        if learn is not None and obj is not None:
            # What was learned of another object is no place to begin at.
            start = None if innovations.is_changed else run.identification
            shown_log = innovations.select(log)
            kept = [i for i, one in enumerate(shown_log) if one.name not in left_out]
            try:
                learned_now = learn(obj, shown_log.subset(kept), start)
                found = run.identification if learned_now is None else learned_now
            except UNUSABLE_ERRORS as error:
                # One push that nothing is learned from ends no task: it goes on with what it had.
                left_out = {**left_out, seen.name: str(error)}
        learned = found is not run.identification
        learning_seconds = run.learning_seconds + perf_counter() - begin
        run = replace(
            run,
            log=log,
            identification=found,
            learning_seconds=learning_seconds,
            innovations=innovations,
            left_out=left_out,
        )
        if progress is not None:
            progress(state, seen, learned)
    return run
