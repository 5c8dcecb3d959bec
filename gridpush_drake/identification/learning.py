"""`identify`: from a push log to a model (`docs/theory/identification.md`).

It screens what it is given (`screening`), has a method fit it (`methods`), judges what comes back
(`model_check`), and reports it in words (`sentences`).
"""

import warnings
from collections.abc import Collection
from dataclasses import replace

from threadpoolctl import threadpool_limits

from gridpush_drake.dynamics.physics import DEFAULT_PHYSICS, Physics, Regime
from gridpush_drake.errors import PushLogWarning
from gridpush_drake.identification.fit.learning_task import Found, LearningMethod, LearningTask
from gridpush_drake.identification.methods import find_method
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.model_check import FitJudgment, judge
from gridpush_drake.identification.multi_object.joint_result import JointIdentification
from gridpush_drake.identification.result import Identification, Progress
from gridpush_drake.identification.screening import screen
from gridpush_drake.identification.sentences import describe_learning, list_warnings
from gridpush_drake.identification.statistics.friction_gradient import HeldFriction
from gridpush_drake.identification.statistics.outliers import ScreenedLog
from gridpush_drake.identification.statistics.problem import resolve_physics
from gridpush_drake.identification.tilt_tests.weighed_model import (
    add_estimate,
    calc_estimate,
    hold_friction,
)
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.pushes.arguments import PushLogOrFile
from gridpush_drake.pushes.plausibility import name_source
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.pushes.weighings import MassTestLog


# The matrices are small: threads of BLAS would only cost time, and change the order of sums.
@threadpool_limits.wrap(limits=1, user_api="blas")
def identify(
    model: Model,
    log: PushLogOrFile,
    method: str | LearningMethod = "default",
    seed: int = 0,
    *,
    regime: Regime | None = None,
    budget: int | None = None,
    progress: Progress | None = None,
    start: Identification | JointIdentification | None = None,
    friction: HeldFriction | None = None,
    weighings: MassTestLog | None = None,
    keep: Collection[str] = (),
    fit_frame: bool = False,
) -> Identification | JointIdentification:
    """Learns masses and frictions of an object, or of several, from pushes.

    Several objects are learned together from slow pushes (`joint_fit`), by the default method; what
    is for one object alone is refused.

    Args:
        model: the object or the objects, with what their `prior` says of them, and the friction
            law, spin, gravity and tolerances of the simulations; of several, the friction against
            each other that is expected. What the model holds of masses and other frictions is not
            used: learning begins from loads that are the same everywhere. The default method needs
            a law with exact gradients.
        log: the training pushes, or the name of their CSV file (`PushLog.read_csv`), with at least
            one observed pose each after the first. Pushes during which a part of the object hung
            over the table's edge are learned from only if the log has the table's corners, and only
            by the default method.
        method: one of METHOD_NAMES: "default", the paper's, or a baseline; or a method as an
            object, such as `MapEnsemble` with other hypotheses, or one of your own.
        seed: seed of everything random.
        regime: takes the place of the one in the model's physics. "auto", the default, is the one
            that suits the log's fastest push (`physics.FAST_PUSH`), for all of them.
        budget: largest number of pushes that a search simulates, for methods other than the
            default; DEFAULT_BUDGET_PER_PUSH times the number of pushes by default.
        progress: called now and then with the best model so far.
        start: a model that was learned of the same object from fewer pushes, with which the
            default method begins. It changes how long the fit takes, not what it finds.
        friction: friction coefficients of the cells, which are held, as weighings tell them
            (default method only); by default the prior's, which may change along the object.
            Pushes show the same loads with any of them, except those over a table's edge: there
            loads shift about the center of mass.
        weighings: tilt tests and lifts of the object, which make mass, friction and center of mass
            absolute.
        keep: names of pushes that are learned from however little they agree with the others.
            Poses that no motion of the pusher explains are left out of them, too.
        fit_frame: whether the frame of the outline may be off that of the logged poses, by an
            unknown pose that is learned together with the rest (default method only). The model's
            object is moved there, and its `outline_pose` says by how much, and how surely.

    Returns:
        The model, its spread, and what the log cannot tell; a `JointIdentification` of several
        objects. Where it is far off from the very pushes that it was learned from, or weighings put
        its center of mass outside the object, its status is "explains_little", and it should not be
        used.

    Warns:
        PushLogWarning: the log or the weighings may be true, but hardly are, or forces in the log
            are not learned from.

    Raises:
        IdentificationError: the method is unknown, or needs gradients that the friction law does
            not have; the seed is no whole number or negative; the log is empty or lacks
            observations; or no loads of the cells explain it with what is told of the object; or
            the frictions are not one positive number for each cell, or cannot be held by the
            method; or the method cannot find the outline's frame; or the equations of the weighings
            cannot be solved; or the log has no push of a name in `keep`.
        SimulationError: the regime is unknown, or the friction law does not know it.
        PushLogError: the object hung over the table's edge during every push, or the log or the
            weighings cannot be true of the object, see `pushes.plausibility`; or the log's file
            cannot be read.
        TypeError: an argument is of another type, or they are swapped.
    """
    task = screen(
        model,
        log,
        method,
        seed=seed,
        regime=regime,
        budget=budget,
        progress=progress,
        start=start,
        friction=friction,
        weighings=weighings,
        keep=keep,
        fit_frame=fit_frame,
    )
    found = fit(task)
    if isinstance(found.model, JointIdentification):
        # Each object's part of it is judged when it is looked at, see `JointIdentification.parts`.
        return found.model
    return report(task, found, judge(found))


def fit(task: LearningTask) -> Found:
    """Fits the pushes of a task, and weighings with them.

    On the table pushes show how the loads mu_i m_i g lie, whatever the frictions are, and weighings
    add what makes them absolute. Over the table's edge it is not as simple: there the loads shift
    about the center of mass, and pushes by themselves take that for the center of friction. So the
    pushes are learned from twice: as if friction were the same everywhere, and then with the
    frictions held that the weighings tell with it. All that is known goes in each time. So the
    result is the same whenever the object was weighed between its pushes.
    """
    found = task.method.learn(task)
    if not len(task.weighings):
        return found
    estimate = calc_estimate(found.alone, task.weighings, seed=task.seed)
    # Weighings that contradict each other tell no frictions to hold.
    if task.method.abilities.holds_friction and not estimate.contradictory:
        held = hold_friction(add_estimate(found.alone, estimate))
        found = task.method.learn(task.hold(held, found.alone.fit_starts))
        estimate = calc_estimate(found.alone, task.weighings, seed=task.seed)
    return replace(found, estimate=estimate)


def report(task: LearningTask, found: Found, judgment: FitJudgment) -> Identification:
    """Says in words what was learned of one object, and warns of what may spoil it.

    Returns:
        The model, with its status and message, and with what weighings say.
    """
    source = found.screened.log.source
    for sentence in list_warnings(found, judgment):
        warnings.warn(name_source(source, sentence), PushLogWarning, stacklevel=3)
    message = describe_learning(found, judgment)
    model = replace(found.alone, status=judgment.status, message=message)
    if found.estimate is None:
        return model
    return add_estimate(model, found.estimate, task.weighings.source)


def describe_prior(
    obj: GridObject,
    method: str | LearningMethod = "default",
    seed: int = 0,
    physics: Physics | None = None,
) -> Identification:
    """What is held of an object before any push, in the form of an identification.

    Args:
        obj: the object.
        method: the method by which it will be learned, whose widest prior gives the spread.
        seed: the seed that the result names; nothing here is random.
        physics: the physics that the result names; `Physics()` by default.

    Returns:
        The uniform model, with status "no_usable_pushes".
    """
    nothing = PushLog(())
    task = LearningTask(
        method=find_method(method),
        model=Model(obj, physics=resolve_physics(physics or DEFAULT_PHYSICS, obj, nothing)),
        screened=ScreenedLog(nothing),
        seed=seed,
    )
    found = task.method.learn(task)
    return report(task, found, judge(found))
