"""`screen`: what `identify` is asked, as a task of which all may be believed.

Refused is what the method cannot do, and a log that cannot be true of the objects or that nothing
can be learned from. Poses that no motion of the pusher explains are left out, and the regime of the
simulations is chosen. What disagrees with the rest only by a fit is refused in the fit
(`fit.robust_fit`).
"""

import warnings
from collections.abc import Collection
from numbers import Integral

import numpy as np

from gridpush_drake.dynamics.one_object import refuse_several
from gridpush_drake.dynamics.physics import Physics, Regime
from gridpush_drake.errors import IdentificationError, PushLogWarning
from gridpush_drake.identification.fit.learning_task import LearningMethod, LearningTask
from gridpush_drake.identification.methods import LEARNING_METHODS, find_method
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.multi_object.joint_result import JointIdentification
from gridpush_drake.identification.result import Identification, Progress
from gridpush_drake.identification.statistics.friction_gradient import HeldFriction
from gridpush_drake.identification.statistics.outliers import ScreenedLog
from gridpush_drake.identification.statistics.problem import resolve_physics
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.pushes.arguments import LOG_TYPES, PushLogOrFile, check_types, read_log
from gridpush_drake.pushes.plausibility import (
    check_plausible,
    check_plausible_mass_tests,
    explain_unused_forces,
    name_source,
)
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.pushes.weighings import MassTestLog

SHOWN_NAMES = 5
"""Number of a log's pushes that a message names."""


def screen(
    model: Model,
    log: PushLogOrFile,
    method: str | LearningMethod,
    *,
    seed: int,
    regime: Regime | None,
    budget: int | None,
    progress: Progress | None,
    start: Identification | JointIdentification | None,
    friction: HeldFriction | None,
    weighings: MassTestLog | None,
    keep: Collection[str],
    fit_frame: bool,
) -> LearningTask:
    """Checks what `identify` is asked, and screens the log; the arguments are those of `identify`.

    Raises:
        IdentificationError, SimulationError, PushLogError, TypeError: see `identify`.
    """
    check_types("identify", model=(model, (Model,)), log=(log, LOG_TYPES))
    log = read_log(log, model.objects, require_final=True)
    _check_kept(keep, log)
    chosen = find_method(method, several=len(model) > 1)
    asked = model.physics.with_regime(regime)
    if not (isinstance(seed, Integral) and seed >= 0):
        raise IdentificationError(f"seed is {seed}; expected a whole number, 0 or more")
    if chosen.abilities.takes_several:
        refuse_several(IdentificationError, "regime", asked.regime == "inertial")
        refuse_several(IdentificationError, "budget", budget is not None)
        refuse_several(IdentificationError, "friction", friction is not None)
        refuse_several(IdentificationError, "weighings", weighings)
        refuse_several(IdentificationError, "keep", keep)
        refuse_several(IdentificationError, "fit_frame", fit_frame)
        _refuse_without_gradients(chosen, asked)
        screened = _check_joint_log(model, log)
        physics = asked.with_regime("quasi_static")
    else:
        _refuse_unable(chosen, model.with_physics(asked), start, friction)
        _refuse_without_frame(chosen, fit_frame)
        # Weighings first: to learn from the pushes takes a while.
        check_plausible_mass_tests(model.obj, weighings or MassTestLog())
        usable = log if chosen.abilities.takes_overhang else log.on_table
        screened = _check_log(model.obj, usable, keep, fit_frame)
        physics = resolve_physics(asked, model.obj, screened.log)
    return LearningTask(
        method=chosen,
        model=model.with_physics(physics),
        screened=screened,
        seed=int(seed),
        budget=budget,
        progress=progress,
        starts=() if start is None else start.fit_starts,
        friction=friction,
        weighings=weighings or MassTestLog(),
        fit_frame=fit_frame,
    )


def _refuse_unable(
    method: LearningMethod,
    model: Model,
    start: Identification | JointIdentification | None,
    friction: HeldFriction | None,
) -> None:
    """Raises IdentificationError: a method for one object cannot do what it is asked."""
    if start is not None and len(start) > 1:
        raise IdentificationError("start: is of several objects; expected what was learned of one")
    obj = model.obj
    physics = model.physics
    _refuse_without_gradients(method, physics)
    if friction is not None and not method.abilities.holds_friction:
        raise IdentificationError(
            f"friction: the method {method.name} cannot hold it; expected a method that can, such "
            "as default"
        )
    if start is not None and start.obj.n != obj.n:
        raise IdentificationError(
            f"start: an object of {start.obj.n} cells; expected {obj.n}, as {obj.name} has"
        )


def _refuse_without_gradients(method: LearningMethod, physics: Physics) -> None:
    """Raises IdentificationError: the friction law lacks the gradients that a method needs."""
    if method.abilities.needs_gradients and True not in physics.law.gradients:
        others = [
            name
            for name, (one, *_) in LEARNING_METHODS.items()
            if not one.abilities.needs_gradients
        ]
        raise IdentificationError(
            f"friction_law {physics.friction_law!r} has no exact gradients, which the "
            f"{method.name} method needs; expected another law, or one of the methods "
            f"{', '.join(others)}"
        )


def _refuse_without_frame(method: LearningMethod, fit_frame: bool) -> None:
    """Raises IdentificationError: a method is asked for the outline's frame and cannot find it."""
    if fit_frame and not method.abilities.fits_frame:
        raise IdentificationError(
            f"fit_frame: the method {method.name} cannot find where the outline is; expected a "
            "method that can, such as default"
        )


def _check_kept(keep: Collection[str], log: PushLog) -> None:
    """Raises IdentificationError: a push that is to be kept is not in the log."""
    if isinstance(keep, str):
        raise IdentificationError(f"keep is {keep!r}; expected names of pushes, as [{keep!r}]")
    names = [seen.name for seen in log]
    for name in keep:
        if name not in names:
            raise IdentificationError(
                f"keep: {log.source or 'the push log'} has no push {name!r}; expected names of "
                f"pushes, such as {', '.join(map(repr, names[:SHOWN_NAMES]))}"
            )


def _check_log(
    obj: GridObject, log: PushLog, keep: Collection[str], fit_frame: bool
) -> ScreenedLog:
    """Refuses a log that nothing can be learned from, and the poses that jump.

    A log without a pusher radius takes that of the object's prior.
    """
    source = log.source or "push log"
    if not len(log):
        raise IdentificationError(f"{source}: no pushes; expected at least one")
    log = log.supported
    for push in log:
        if not len(push.t_observed):
            raise IdentificationError(
                f"{source}: push {push.name}: object_x, object_y, object_theta: "
                "no pose after the first row; expected at least one"
            )
    if not log.radius_given and obj.prior.pusher_radius is not None:
        log = log.with_radius(obj.prior.pusher_radius)
    screened = ScreenedLog.of_jumps(obj, log, keep)
    check_plausible(obj, screened.log, learning=True, frame_known=not fit_frame)
    return screened


def _check_joint_log(model: Model, log: PushLog) -> ScreenedLog:
    """Refuses a log of several objects that nothing can be learned from; it is kept as it is.

    Of poses that cannot be true, and of forces, which then are not used, warnings are given.
    """
    if not len(log):
        raise IdentificationError("push log: holds no push; expected at least one")
    if not (model.pair_friction[np.triu_indices(len(model), 1)] > 0).all():
        raise IdentificationError(
            "pair_friction: expected positive numbers, as what is expected beforehand"
        )
    for i, obj in enumerate(model.objects):
        check_plausible(obj, log.single_out(i), learning=False, alone=False)
    unused = explain_unused_forces(model.objects, log, inertial=False)
    if unused is not None:
        warnings.warn(name_source(log.source, unused), PushLogWarning, stacklevel=4)
    return ScreenedLog(log)
