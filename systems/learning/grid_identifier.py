"""`GridIdentifier`: a Drake system that watches pushes, keeps their log, and learns when one ends.

Every `period` it looks at the object and the tip. `pushes.segmentation` finds the pushes and writes
them down. When a push has ended, `identify` learns from the log. The estimate is the one that
`identify` makes of this log anywhere else.

After two surprises in a row, or a clear one (`identification.innovation`), the object is another
one than was learned, and what was seen before is not learned from any more.

If the force on the tip is measured, it is in the log, too. If the object is weighed, the estimate
is made in absolute numbers at once, and then all pushes are learned from once more with the
weighings, as `gridpush identify --weighings` does.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache, partial
from math import nan
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import BasicVector, Context

from gridpush_drake.dynamics.physics import Physics, Regime, make_physics
from gridpush_drake.dynamics.pusher import DEFAULT_PUSHER_RADIUS, PusherShape
from gridpush_drake.errors import IdentificationError
from gridpush_drake.frozen import Unchanging
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.fit.learning_task import LearningMethod
from gridpush_drake.identification.innovation import InnovationRecord
from gridpush_drake.identification.learning import describe_prior, identify
from gridpush_drake.identification.methods import find_method
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.model_check import select_used
from gridpush_drake.identification.result import HistoryEntry, Identification, calc_center_of_mass
from gridpush_drake.identification.statistics.problem import PushProblem
from gridpush_drake.identification.tilt_tests.weighed_model import estimate_masses
from gridpush_drake.multibody.weak_calc import NO_SLOTS, weakly
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.pushes.segmentation import (
    NOT_FELT,
    UNUSABLE_ERRORS,
    RecordOptions,
    Sample,
    SegmenterOptions,
    SegmenterState,
    TipMotion,
    advance,
    make_observed_push,
    name_push,
)
from gridpush_drake.pushes.weighings import MassTestLog
from gridpush_drake.systems.base.object_controller import AbstractStateSystem
from gridpush_drake.systems.base.worker import Request, WorkerResult, make_worker
from gridpush_drake.systems.sensing.planar_pose_sensor import DEFAULT_PERIOD

LOG_SOURCE = "observed pushes"
"""The source that is written into the log."""


@dataclass(frozen=True, eq=False)
class Estimate:
    """An identification, with what is calculated from it once for the ports.

    Attributes:
        found: the identification; before anything was learned, the prior in the same form.
        center_of_mass: (2,) estimated center of mass p_BBcm, m.
        center_of_mass_covariance: (2, 2) covariance of the center of mass, in B, m².
        loss: mean cell error of the pushes learned from, m; NaN if there are none.
    """

    found: Identification
    center_of_mass: Array
    center_of_mass_covariance: Array
    loss: float


@dataclass(frozen=True, eq=False)
class IdentifierState(Unchanging):
    """All that the identifier remembers; never changed, only replaced.

    Attributes:
        segmenter: state of the search for pushes.
        log: the pushes so far.
        estimate: the last estimate; None before the first.
        learned_at: time at which that was asked for, s; NaN before the first.
        considered: number of the log's pushes that were learned from, or left out.
        request: the learning under way in a worker; None if there is none.
        left_out: names of the pushes from which nothing could be learned.
        message: why nothing could be learned from the last push; empty if it was learned from, or
            was not meant to be.
        innovations: what surprises there were among the pushes of the log.
        weighings: what weighings there were when they were looked at last.
        learned_with: number of them that there were when it was last learned from the pushes.
        weighed_before: number of presses and of lifts before the object became another one, which
            do not count any more.
    """

    segmenter: SegmenterState = field(default_factory=SegmenterState)
    log: PushLog = field(default_factory=lambda: PushLog((), LOG_SOURCE))
    estimate: Estimate | None = None
    learned_at: float = nan
    considered: int = 0
    request: Request | None = None
    left_out: tuple[str, ...] = ()
    message: str = ""
    innovations: InnovationRecord = field(default_factory=InnovationRecord)
    weighings: MassTestLog = field(default_factory=MassTestLog)
    learned_with: int = 0
    weighed_before: tuple[int, int] = (0, 0)

    @property
    def is_behind(self) -> bool:
        """Whether there is a push that was not learned from yet, or a weighing since the last."""
        weighed_since = self.estimate is not None and self.learned_with < len(self.weighings)
        return self.considered < len(self.log) or (weighed_since and len(self.log) > 0)

    @property
    def counting_mass_tests(self) -> MassTestLog:
        """The weighings of the object as it is now."""
        presses, lifts = self.weighed_before
        log = self.weighings
        return replace(log, presses=log.presses[presses:], lifts=log.lifts[lifts:])


class GridIdentifier(AbstractStateSystem[IdentifierState]):
    """Learns the masses and frictions of an object of n cells from the pushes that it sees.

    .. pydrake_system::

        name: GridIdentifier
        input_ports:
        - object_pose
        - pusher_state
        - pusher_yaw
        - force
        - weighing_log
        output_ports:
        - mass
        - friction
        - mass_std
        - friction_std
        - contact_friction
        - center_of_mass
        - center_of_mass_covariance
        - loss
        - num_pushes
        - identification
        - push_log
        - message
        - age

    * object_pose: vector of 3, observed X_WB, (x, y, theta), m and rad; NaN if the object was not
      seen.
    * pusher_state: vector of 6, position p_WP of the tip's center, m, and its velocity v_WP, m/s; a
      sample with NaN is passed over.
    * pusher_yaw: vector of 1, angle of the pusher's frame, rad; it need not be connected if the
      pusher is a disc.
    * force: vector of 3, force on the tip in W, N, with whatever offset it has; it need not be
      connected.
    * weighing_log: abstract `MassTestLog`, presses and lifts so far; it need not be connected.
    * mass: vector of n, estimated mass of each cell, kg.
    * friction: vector of n, estimated friction coefficient of each cell against the support.
    * mass_std: vector of n, standard deviation of `mass`, kg.
    * friction_std: vector of n, standard deviation of `friction`.
    * contact_friction: vector of 1, estimated friction coefficient of the tip against the object.
    * center_of_mass: vector of 2, estimated p_BBcm in B, m.
    * center_of_mass_covariance: vector of 4, its covariance in B, row-major, m²; see
      `calc_center_of_mass`.
    * loss: vector of 1, mean cell error of the pushes learned from, m; NaN before the first.
    * num_pushes: vector of 1, number of pushes in the log.
    * identification: abstract `Identification`, the estimate; while nothing was learned it is the
      prior, with no `push_names`.
    * push_log: abstract `PushLog`, all pushes so far.
    * message: abstract `str`, why nothing could be learned from the last push; else empty. The
      estimate then stays as it was, and later estimates do without that push.
    * age: vector of 1, time since the estimate was asked for, which is when a push had ended, s;
      NaN before the first.

    After two surprises in a row, or a clear one (`identification.innovation`), the object is
    another one than was learned: then only the pushes that surprised and later ones are learned
    from.

    Learning takes long. With an answer delay it is done in a worker, see `systems.base.worker`: one
    push after another, while the outputs hold and further pushes are logged. Before the first push
    the outputs are those of the prior. Abstract state: one `IdentifierState`.
    """

    __slots__ = NO_SLOTS

    def __init__(
        self,
        obj: GridObject,
        period: float = DEFAULT_PERIOD,
        engaged_below: float = SegmenterOptions.engaged_below,
        method: str | LearningMethod = "default",
        max_learning_pushes: int | None = None,
        regime: Regime | None = None,
        seed: int = 0,
        warm_start: bool = True,
        *,
        physics: Physics | None = None,
        pusher_radius: float | None = None,
        pusher_shape: PusherShape | None = None,
        segmenter: SegmenterOptions | None = None,
        record: RecordOptions | None = None,
        table: ArrayLike | None = None,
        progress: Callable[[HistoryEntry], None] | None = None,
        answer_delay: float | None = 0.0,
    ) -> None:
        """Declares the system.

        Args:
            obj: the object.
            period: time between two samples, s.
            engaged_below: if the tip's center is lower than this, it can touch the object, m.
            method: a method of `identify`, or its name.
            max_learning_pushes: number of pushes, the first ones, that are learned from; later ones
                are only logged. None for all.
            regime: takes the place of the one in `physics`; see `identify`.
            seed: seed of everything random.
            warm_start: whether learning begins where it ended the last time (default method only).
                The estimate then differs by a fraction of its standard deviation from the one that
                `identify` makes of the log. Without a warm start both are the same bit for bit, on
                the same computer (on another processor NumPy may take other BLAS kernels).
            physics: friction law, spin, gravity and tolerances of the simulations; `Physics()` by
                default.
            pusher_radius: radius of the tip, m; by default that of the prior, or
                `DEFAULT_PUSHER_RADIUS`. If given, it replaces the prior's in `self.obj`, so that
                the object's file and the log say the same.
            pusher_shape: of a pusher that is no disc, in place of its radius; None of a disc. Its
                pushes do not know of the table's edge.
            segmenter: other options of finding pushes; its `engaged_below` is replaced by the
                argument.
            record: options of writing pushes down, with the age of the sensor's poses.
            table: (K, 2) corners in W of the table's top, m, which are written into the log; None
                if its edge is far away.
            progress: called now and then while learning.
            answer_delay: time after which an estimate is taken, s; None for real time, see
                `worker.make_worker`.

        Raises:
            IdentificationError, PlanningError, SimulationError: an argument is out of range.
        """
        found_method = find_method(method)
        used = make_physics(physics, regime)
        if not (np.isfinite(period) and period > 0):
            raise IdentificationError(f"period is {period!r}; expected a positive number (s)")
        if max_learning_pushes is not None and max_learning_pushes < 0:
            raise IdentificationError(
                f"max_learning_pushes is {max_learning_pushes}; expected 0 or more"
            )
        if pusher_radius is not None:
            obj = replace(obj, prior=replace(obj.prior, pusher_radius=pusher_radius))
        corners = None if table is None or pusher_shape is not None else np.asarray(table)
        no_pushes = PushLog((), LOG_SOURCE, table=corners)
        super().__init__(IdentifierState(log=no_pushes), period)
        self.obj = obj
        self._model = Model(obj, physics=used)
        self.max_learning_pushes = max_learning_pushes
        self.warm_start = warm_start
        self._worker = make_worker(answer_delay)
        self._pusher = pusher_shape or obj.prior.pusher_radius or DEFAULT_PUSHER_RADIUS
        self._segmenter = replace(segmenter or SegmenterOptions(), engaged_below=engaged_below)
        self._record = record or RecordOptions()
        self._learning: dict[str, Any] = {
            "method": found_method,
            "seed": seed,
            "progress": progress,
        }
        self._object_pose = self.DeclareVectorInputPort("object_pose", 3)
        self._pusher_state = self.DeclareVectorInputPort("pusher_state", 6)
        self._pusher_yaw = self.DeclareVectorInputPort("pusher_yaw", 1)
        self._force = self.DeclareVectorInputPort("force", 3)
        self._weighing_log = self.DeclareAbstractInputPort(
            "weighing_log", AbstractValue.Make(MassTestLog())
        )
        # What is held before any push takes a fifth of a station's making, and not every user of
        # this system looks at it: it is made when an output first shows it.
        self._declare_outputs(
            cache(lambda: _make_estimate(describe_prior(obj, found_method, seed, used), None))
        )

    def Learn(
        self,
        log: PushLog,
        start: Identification | None = None,
        weighings: MassTestLog | None = None,
    ) -> Identification:
        """Identifies the object from a log as the system does when a push ends.

        It knows nothing of what the system has forgotten.

        Args:
            log: the log; only the pushes that `select` takes of it are learned from.
            start: the identification at which learning begins; None for the prior.
            weighings: presses and lifts of the object; None where there are none.
        """
        chosen = self.select(log)
        return identify(self._model, chosen, start=start, weighings=weighings, **self._learning)

    def LearnAll(self, context: Context) -> Identification | None:
        """Learns from all pushes and weighings so far, at once, and leaves the outputs alone.

        A run may end before the last push, or what was weighed last, was learned from.

        Args:
            context: of this system.

        Returns:
            What the output `identification` would come to show; None while it shows the prior.
        """
        state = replace(self._get_state(context), request=None)
        while state.is_behind:
            state, work = self._find_work(state)
            if work is not None:
                state = self._take_answer(state, WorkerResult(work()), context.get_time())
        return None if state.estimate is None else state.estimate.found

    def select(self, log: PushLog) -> PushLog:
        """Selects the pushes of a log that are learned from."""
        return log[: self.max_learning_pushes]

    def _declare_outputs(self, make_prior: Callable[[], Estimate]) -> None:
        """Declares the output ports; before the first estimate they show the prior.

        Args:
            make_prior: makes the prior in the form of an estimate; the same at every call.
        """

        def declare(name: str, size: int, show: Callable[[Estimate], Any]) -> None:
            self._declare_vector(name, size, lambda now: show(now.estimate or make_prior()))

        n = self.obj.n
        declare("mass", n, lambda estimate: estimate.found.params.mass)
        declare("friction", n, lambda estimate: estimate.found.params.friction)
        declare("mass_std", n, lambda estimate: estimate.found.std.mass)
        declare("friction_std", n, lambda estimate: estimate.found.std.friction)
        declare("contact_friction", 1, lambda estimate: [estimate.found.params.contact_friction])
        declare("center_of_mass", 2, lambda estimate: estimate.center_of_mass)
        declare(
            "center_of_mass_covariance",
            4,
            lambda estimate: estimate.center_of_mass_covariance.ravel(),
        )
        declare("loss", 1, lambda estimate: [estimate.loss])
        self._declare_vector("num_pushes", 1, lambda now: [len(now.log)])
        self._declare_value(
            "identification", lambda now: (now.estimate or make_prior()).found, lazily=True
        )
        self._declare_value("push_log", lambda now: now.log)
        self._declare_value("message", lambda now: now.message)
        self.DeclareVectorOutputPort(
            "age", 1, weakly(self._calc_age), {self._remembered, self.time_ticket()}
        )

    def _calc_age(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector([context.get_time() - self._get_state(context).learned_at])

    def _go_on(self, context: Context, now: IdentifierState) -> IdentifierState:
        pusher = tuple(self._pusher_state.Eval(context).tolist())
        pose = tuple(self._object_pose.Eval(context).tolist())
        force = NOT_FELT
        if self._force.HasValue(context):
            x, y, z = self._force.Eval(context).tolist()
            force = (x, y, z)
        yaw = 0.0
        if self._pusher_yaw.HasValue(context):
            yaw = float(self._pusher_yaw.Eval(context)[0])
        sample = Sample(
            context.get_time(),
            pose=pose,
            tip=pusher[:3],
            velocity=pusher[3:],
            force=force,
            yaw=yaw,
        )
        segmenter, episode = advance(now.segmenter, sample, self._segmenter)
        logged = self._log_push(replace(now, segmenter=segmenter), episode)
        learned = self._learn(logged, context.get_time())
        if not self._weighing_log.HasValue(context):
            return learned
        return self._weigh(learned, self._weighing_log.Eval(context))

    def _weigh(self, state: IdentifierState, log: MassTestLog) -> IdentifierState:
        """Takes in what was weighed since the last look.

        After surprises, when the object is another one, older weighings do not count.
        """
        if state.estimate is None or len(log) == len(state.weighings):
            return state
        # What was learned from pushes stays; the weighings are added to it anew.
        before = state.estimate
        state = replace(state, weighings=log)
        try:
            estimate = _add_weighings(before, state.counting_mass_tests)
        except UNUSABLE_ERRORS as error:
            return replace(state, message=f"The weighings were not learned from: {error}.")
        return replace(state, estimate=estimate)

    def _log_push(self, state: IdentifierState, episode: TipMotion | None) -> IdentifierState:
        """Logs a push that has ended; `episode` is None if none has."""
        if episode is None:
            return state
        name = name_push(len(state.log))
        try:
            observed = make_observed_push(episode, self.obj, self._pusher, name, self._record)
        except UNUSABLE_ERRORS as error:
            return replace(state, message=f"A push could not be written down: {error}.")
        if observed is None:
            return state
        log = replace(state.log, pushes=(*state.log.pushes, observed))
        # The push is judged by what was known before it: once learned, it hardly surprises.
        before = None if state.estimate is None else state.estimate.found
        innovations = state.innovations.note(before, log)
        weighed_before = state.weighed_before
        if innovations.forgotten != state.innovations.forgotten:
            weighed_before = (len(state.weighings.presses), len(state.weighings.lifts))
        return replace(
            state, log=log, message="", innovations=innovations, weighed_before=weighed_before
        )

    def _learn(self, state: IdentifierState, time: float) -> IdentifierState:
        """Takes what a worker has learned, and learns from the log's next pushes one by one."""
        if state.request is not None and self._worker is not None:
            answer = self._worker.take(state.request, time)
            if answer is None:
                return state
            state = self._take_answer(state, answer, state.request.time)
        # One push after another, so that the estimates do not depend on how fast learning is.
        while state.is_behind:
            state, work = self._find_work(state)
            if work is None:
                continue
            if self._worker is not None:
                return replace(state, request=self._worker.ask(work, time))
            state = self._take_answer(state, WorkerResult(work()), time)
        return state

    def _find_work(
        self, state: IdentifierState
    ) -> tuple[IdentifierState, Callable[[], Estimate | str] | None]:
        """Finds what is to be calculated because of the first push that was not considered yet.

        If all pushes were, something was weighed since: what pushes tell depends on the frictions
        that weighings tell. So the last push, and with it all others, is considered once more.

        Returns:
            The state after this look; and a function that returns an estimate, or what is wrong
            with the push, or None if nothing is to be learned from it.
        """
        again = state.considered == len(state.log)
        if again:
            state = replace(state, considered=state.considered - 1)
        state = replace(state, learned_with=len(state.weighings))
        # Neither pushes from before the object changed, nor those that could not be used.
        log = state.log[: state.considered + 1]
        forgotten = state.innovations.forgotten
        left_out = {seen.name for seen in log[:forgotten]} | set(state.left_out)
        chosen = self.select(log)
        chosen = chosen.subset([i for i, seen in enumerate(chosen) if seen.name not in left_out])
        # If the last push is not among them, the estimate would be the one that is there.
        if not len(chosen) or (chosen[-1] is not log[-1] and not again):
            return replace(state, considered=state.considered + 1), None
        start = state.estimate.found if state.estimate is not None and self.warm_start else None
        # What was learned of another object is no place to begin at.
        if start is not None and forgotten and left_out & set(start.push_names):
            start = None
        weighings = state.counting_mass_tests
        return state, partial(_learn_from, weakly(self.Learn), chosen, start, weighings)

    def _take_answer(
        self, state: IdentifierState, answer: WorkerResult, asked: float
    ) -> IdentifierState:
        """Returns the state with a new estimate, or with the reason why there is none.

        Args:
            state: the state before.
            answer: what came of the work that `_find_work` has found.
            asked: time at which it was asked for, s.
        """
        name = state.log[state.considered].name
        state = replace(state, request=None, considered=state.considered + 1)
        if isinstance(answer.value, Estimate):
            estimate = answer.value
            message = ""
            try:
                estimate = _add_weighings(estimate, state.counting_mass_tests)
            except UNUSABLE_ERRORS as error:
                message = f"The weighings were not learned from: {error}."
            return replace(state, estimate=estimate, learned_at=asked, message=message)
        message = f"Nothing could be learned from {name}: {answer.value or answer.error}."
        return replace(state, left_out=(*state.left_out, name), message=message)


def _learn_from(
    learn: Callable[..., Identification],
    log: PushLog,
    start: Identification | None,
    weighings: MassTestLog,
) -> Estimate | str:
    """Learns from a log; returns the estimate, or what is wrong with the last push."""
    try:
        return _make_estimate(learn(log, start, weighings), log)
    except UNUSABLE_ERRORS as error:
        return str(error)


def _make_estimate(found: Identification, log: PushLog | None) -> Estimate:
    """Calculates what the ports show of an identification.

    Args:
        found: the identification.
        log: the pushes that it could learn from; None for the prior.
    """
    # How far off the pushes that were learned from end, without what was refused of them.
    loss = np.nan
    pushed = found.unweighed
    if log is not None and pushed.push_names:
        used = select_used(pushed, log)
        problem = PushProblem(pushed.obj, used, pushed.params, pushed.physics)
        residuals = problem.residuals(problem.unknowns(pushed.params))
        loss = float(problem.calc_cell_errors(residuals).mean())
    center, covariance = calc_center_of_mass(found)
    return Estimate(
        found=found, center_of_mass=center, center_of_mass_covariance=covariance, loss=loss
    )


def _add_weighings(before: Estimate, log: MassTestLog) -> Estimate:
    """Returns an estimate with weighings, if there are any, in the place of those that it has."""
    pushed = before.found.unweighed
    found = estimate_masses(pushed, log) if len(log) else pushed
    center, covariance = calc_center_of_mass(found)
    return replace(before, found=found, center_of_mass=center, center_of_mass_covariance=covariance)
