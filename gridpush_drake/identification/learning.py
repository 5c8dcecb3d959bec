"""`identify`: from a push log to a model (`docs/theory/identification.md`).

It checks what it is given, sets up the least-squares problem, hands it to one of the methods, and
turns what that finds into a model with its spread. The fit itself is not here, but in
`robust_fit` and `map_ensemble`, or in `baselines`.
"""

import warnings
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from numbers import Integral

import numpy as np
from threadpoolctl import threadpool_limits

from gridpush_drake.dynamics.physics import Physics, Regime
from gridpush_drake.errors import IdentificationError, ParameterError, PushLogWarning
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.absolute.force_scale import calc_force_scale
from gridpush_drake.identification.baselines.methods import DEFAULT_BUDGET_PER_PUSH, SEARCH_METHODS
from gridpush_drake.identification.baselines.search import (
    Bounds,
    SearchMethod,
    SearchStatus,
    run_search,
)
from gridpush_drake.identification.fit.fit_average import MapEnsembleFit
from gridpush_drake.identification.fit.map_ensemble import MapEnsemble
from gridpush_drake.identification.fit.map_fit import calc_laplace
from gridpush_drake.identification.fit.robust_fit import FitTask, Tracker, fit_robustly
from gridpush_drake.identification.flipped_poses import FlippedPoses, find_flipped_poses
from gridpush_drake.identification.identifiability import calc_identifiability
from gridpush_drake.identification.joint_fit import identify_together
from gridpush_drake.identification.joint_result import JointIdentification
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.model_check import judge_fit
from gridpush_drake.identification.result import (
    FitStart,
    Identification,
    IdentificationStatus,
    Progress,
)
from gridpush_drake.identification.statistics.center_of_mass import CenterOfMass
from gridpush_drake.identification.statistics.friction_gradient import (
    HeldFriction,
    calc_gradient_std,
)
from gridpush_drake.identification.statistics.noise import NoiseModel, NoiseScale
from gridpush_drake.identification.statistics.outliers import ScreenedLog
from gridpush_drake.identification.statistics.posterior import CONTACT_FRICTION, Posterior
from gridpush_drake.identification.statistics.problem import (
    PushProblem,
    make_even_parameters,
    resolve_physics,
)
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import DEFAULT_TOTAL_MASS, CellParameters
from gridpush_drake.pushes.arguments import LOG_TYPES, PushLogOrFile, check_types, read_log
from gridpush_drake.pushes.plausibility import check_plausible, explain_unused_forces
from gridpush_drake.pushes.push_log import PushLog

METHOD_NAMES = ("default", *SEARCH_METHODS)
"""Names of the methods that `identify` offers."""


# The matrices are small: threads of BLAS would only cost time, and change the order of sums.
@threadpool_limits.wrap(limits=1, user_api="blas")
def identify(
    model: Model,
    log: PushLogOrFile,
    method: str = "default",
    seed: int = 0,
    *,
    regime: Regime | None = None,
    budget: int | None = None,
    ensemble: MapEnsemble | None = None,
    progress: Progress | None = None,
    start: Identification | JointIdentification | None = None,
    friction: HeldFriction | None = None,
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
        method: one of METHOD_NAMES: "default", the paper's, or a baseline.
        seed: seed of everything random.
        regime: takes the place of the one in the model's physics. "auto", the default, is the one
            that suits the log's fastest push (`physics.FAST_PUSH`), for all of them.
        budget: largest number of pushes that a search simulates, for methods other than the
            default; DEFAULT_BUDGET_PER_PUSH times the number of pushes by default.
        ensemble: settings of the default method; its usual ones by default. A search calculates
            the spread of its model with the widest prior among them.
        progress: called now and then with the best model so far.
        start: a model that was learned of the same object from fewer pushes, with which the
            default method begins. It changes how long the fit takes, not what it finds.
        friction: friction coefficients of the cells, which are held, as weighings tell them
            (default method only); by default the prior's, which may change along the object.
            Pushes show the same loads with any of them, except those over a table's edge: there
            loads shift about the center of mass.

    Returns:
        The model, its spread, and what the log cannot tell; a `JointIdentification` of several
        objects. Where it is far off from the very
        pushes that it was learned from, its status is "explains_little", and it should not be used.

    Warns:
        PushLogWarning: the log may be true, but hardly is, or forces in it are not learned from.

    Raises:
        IdentificationError: the method is unknown, or needs gradients that the friction law does
            not have; the seed is no whole number or negative; the log is empty or lacks
            observations; or no loads of the cells explain it with what is told of the object; or
            the frictions are not one positive number for each cell.
        SimulationError: the regime is unknown, or the friction law does not know it.
        PushLogError: the object hung over the table's edge during every push, or the log cannot be
            true of the object, see `pushes.plausibility`; or its file cannot be read.
        TypeError: an argument is of another type, or they are swapped.
    """
    check_types("identify", model=(model, (Model,)), log=(log, LOG_TYPES))
    log = read_log(log, model.objects, require_final=True)
    if len(model) > 1:
        one_alone = {
            "method": method != "default",
            "regime": model.physics.with_regime(regime).regime == "inertial",
            "budget": budget is not None,
            "ensemble": ensemble is not None,
            "friction": friction is not None,
            "start": isinstance(start, Identification),
        }
        for name, given in one_alone.items():
            if given:
                raise IdentificationError(
                    f"{name}: is for one object; several are learned from slow pushes alone, by "
                    "the default method"
                )
        assert not isinstance(start, Identification)
        return identify_together(model, log, start=start)
    if isinstance(start, JointIdentification):
        raise IdentificationError("start: is of several objects; expected what was learned of one")
    obj = model.obj
    if method not in METHOD_NAMES:
        raise IdentificationError(
            f"method is {method!r}; expected one of {', '.join(METHOD_NAMES)}"
        )
    asked = model.physics.with_regime(regime)
    if method == "default" and True not in asked.law.gradients:
        raise IdentificationError(
            f"friction_law {asked.friction_law!r} has no exact gradients, which the default method "
            f"needs; expected another law, or one of the methods {', '.join(SEARCH_METHODS)}"
        )
    if not (isinstance(seed, Integral) and seed >= 0):
        raise IdentificationError(f"seed is {seed}; expected a whole number, 0 or more")

    # Poses that no motion of the pusher explains would spoil every later step.
    screened = _check_log(obj, log if method == "default" else log.on_table)
    log = screened.log
    used = resolve_physics(asked, obj, log)

    # The fit begins from loads that are the same everywhere: the prior mean z_0 (section 3).
    ensemble = _with_gradient(ensemble or MapEnsemble(), obj, friction)
    patch_ratio = ensemble.choose_patch_ratio(obj) if method == "default" else 1.0
    uniform = replace(make_even_parameters(obj), patch_ratio=patch_ratio)
    if friction is not None and method == "default":
        uniform = _hold_friction(uniform, friction.coefficients)
    problem = PushProblem(obj, log, uniform, used)
    z0 = problem.unknowns(uniform)

    # A push that misses the object says nothing of its loads, and has no derivatives to fit with.
    touched = problem.touched(z0)
    unused = tuple(push.name for push, hit in zip(log, touched, strict=True) if not hit)
    screened = screened.keep(log.subset(np.flatnonzero(touched)))
    problem = PushProblem(obj, screened.log, uniform, used)

    held = uniform
    tracker = Tracker(problem, progress)
    # The prior is told of mu_c, while the unknown is log mu_c: d(log mu_c) = d(mu_c) / mu_c.
    log_contact_friction_std = obj.prior.contact_friction_std / uniform.contact_friction
    touching = screened.log
    if not len(screened.log):
        fit = ensemble.fit_prior(obj, z0, log_contact_friction_std)
    elif method == "default":
        starts = _choose_starts(obj, start)
        task = FitTask(
            ensemble=ensemble,
            z0=z0,
            log_contact_friction_std=log_contact_friction_std,
            center_of_mass=CenterOfMass.of_prior(obj.prior),
            tracker=tracker,
        )
        try:
            fit, screened = fit_robustly(task, problem, screened, starts, int(seed))
        except (np.linalg.LinAlgError, ParameterError) as error:
            raise IdentificationError(_describe_no_fit(obj)) from error
    else:
        fit, held = _fit_by_search(
            problem,
            screened.log,
            SEARCH_METHODS[method],
            start=uniform,
            log_contact_friction_std=log_contact_friction_std,
            ensemble=ensemble,
            budget=budget,
            seed=seed,
            tracker=tracker,
        )
    result = _make_result(
        obj,
        screened,
        fit,
        held=held,
        method=method,
        tracker=tracker,
        physics=used,
        seed=seed,
        unused=unused,
        noise=ensemble.noise,
    )
    turned = None
    if method == "default":  # it needs gradients, which the baselines do without
        fit_field = partial(
            ensemble.fit_field,
            z0=z0,
            log_contact_friction_std=log_contact_friction_std,
            center_of_mass=CenterOfMass.of_prior(obj.prior),
        )
        problem = PushProblem(obj, touching, uniform, used)
        turned = find_flipped_poses(problem, touching, screened.log, z0, ensemble.noise, fit_field)
    for warning in _list_warnings(obj, screened.log, used, turned):
        warnings.warn(
            f"{log.source}: {warning}" if log.source else warning, PushLogWarning, stacklevel=2
        )
    return _note_poor_fit(result, screened.log)


def _with_gradient(
    ensemble: MapEnsemble, obj: GridObject, friction: HeldFriction | None
) -> MapEnsemble:
    """Tells the noise model how much the friction may change along the object."""
    std = calc_gradient_std(obj.prior) if friction is None else friction.gradient_std
    return replace(ensemble, noise=replace(ensemble.noise, friction_gradient=std))


def _hold_friction(even: CellParameters, friction: Array) -> CellParameters:
    """Gives parameters other friction coefficients, and masses that leave their loads as before.

    Args:
        even: the parameters.
        friction: (n,) the coefficients.
    """
    coefficients = np.asarray(friction, dtype=np.float64)
    good = np.isfinite(coefficients) & (coefficients > 0)
    if coefficients.shape != even.friction.shape or not good.all():
        raise IdentificationError(
            f"friction is {friction!r}; expected {even.n} positive numbers, one for each cell"
        )
    # k_i = mu_i m_i stay as they are.
    return replace(even, friction=coefficients, mass=even.mass * even.friction / coefficients)


def _list_warnings(
    obj: GridObject, used: PushLog, physics: Physics, turned: FlippedPoses | None
) -> Iterator[str]:
    """Says what in the pushes may spoil the model, or is not learned from, and why."""
    forces = explain_unused_forces(obj, used, physics.inertial)
    if forces is not None:
        yield forces
    if turned is not None:
        yield turned.describe(obj.name)


def _note_poor_fit(result: Identification, log: PushLog) -> Identification:
    """Marks a result that predicts its own pushes poorly, or no better than an even object.

    A result that explains its pushes is returned as it is.
    """
    judged = judge_fit(result, log)
    if judged is None:
        return result
    status, message = judged
    if status == IdentificationStatus.PRIOR_KEPT and result.status != IdentificationStatus.LEARNED:
        return result
    # What "default" says of itself is that it learned from the pushes. A search says how it ended.
    message = message if result.method == "default" else f"{result.message} {message}"
    return replace(result, status=status, message=message)


def describe_prior(
    obj: GridObject,
    ensemble: MapEnsemble | None = None,
    seed: int = 0,
    physics: Physics | None = None,
) -> Identification:
    """What is held of an object before any push, in the form of an identification.

    Args:
        obj: the object.
        ensemble: the default method, whose widest prior gives the spread.
        seed: the seed that the result names; nothing here is random.
        physics: the physics that the result names; `Physics()` by default.

    Returns:
        The uniform model, with status "no_usable_pushes".
    """
    ensemble = _with_gradient(ensemble or MapEnsemble(), obj, None)
    patch_ratio = ensemble.choose_patch_ratio(obj)
    uniform = replace(make_even_parameters(obj), patch_ratio=patch_ratio)
    problem = PushProblem(obj, PushLog(()), uniform, physics)
    log_contact_friction_std = obj.prior.contact_friction_std / uniform.contact_friction
    fit = ensemble.fit_prior(obj, problem.unknowns(uniform), log_contact_friction_std)
    tracker = Tracker(problem, None)
    return _make_result(
        obj,
        ScreenedLog(PushLog(())),
        fit,
        held=uniform,
        method="default",
        tracker=tracker,
        physics=problem.physics,
        seed=seed,
        unused=(),
        noise=ensemble.noise,
    )


def _describe_no_fit(obj: GridObject) -> str:
    """Says which of what was told of an object may be why its fit's equations cannot be solved."""
    prior = obj.prior
    given = []
    if prior.center_of_mass is not None:
        x, y = prior.center_of_mass
        given.append(f"center_of_mass.at, [{x:g}, {y:g}] m,")
    if prior.push_height is not None:
        given.append(f"pusher.height, {prior.push_height:g} m,")
    question = f"; is {' and '.join(given)} right?" if given else ""
    return (
        f"{obj.name}: the fit's equations cannot be solved, "
        f"no loads of its cells explain the pushes{question}"
    )


def _fit_by_search(
    problem: PushProblem,
    log: PushLog,
    method: SearchMethod,
    *,
    start: CellParameters,
    log_contact_friction_std: float,
    ensemble: MapEnsemble,
    budget: int | None,
    seed: int,
    tracker: Tracker,
) -> tuple[MapEnsembleFit, CellParameters]:
    """Runs one of the searches that the default method is compared with.

    Returns:
        A fit with Laplace's spread under the widest prior, and the parameters found.
    """
    budget = DEFAULT_BUDGET_PER_PUSH * len(log) if budget is None else budget
    found = run_search(
        method,
        problem.obj,
        log,
        start,
        Bounds.around(problem.obj, start),
        budget=budget,
        seed=seed,
        physics=problem.physics,
        progress=tracker.add,
    )

    # The searches state no spread of their own. Theirs is that of the exact derivatives at what
    # they found (section 8). The paper's method knows no push height, so that it is set again.
    params = replace(found.params, push_height=start.push_height)
    final = PushProblem(problem.obj, log, params, problem.physics)
    z = final.unknowns(params)
    A = ensemble.make_widest_factor(problem.obj, log_contact_friction_std)
    covariance, scale = calc_laplace(final, z, A, ensemble.noise)

    spent = found.status == SearchStatus.BUDGET_SPENT
    status = IdentificationStatus.BUDGET_SPENT if spent else IdentificationStatus.LEARNED
    message = (
        f"The search ended after {found.simulations} simulations: {found.status.replace('_', ' ')}."
    )
    noise = ensemble.noise.scaled(scale)
    fit = MapEnsembleFit(
        z=z,
        covariance=covariance,
        prior_covariance=A @ A.T,
        noise_std=noise.pose,
        load_shift_std=noise.load_shift,
        status=status,
        message=message,
    )
    return fit, params


def _choose_starts(obj: GridObject, start: Identification | None) -> tuple[FitStart, ...]:
    """Chooses where the fits of the default method begin; nothing where they begin anew."""
    if start is None:
        return ()
    if start.obj.n != obj.n:
        raise IdentificationError(
            f"start: an object of {start.obj.n} cells; expected {obj.n}, as {obj.name} has"
        )
    return start.starts or (FitStart(start.posterior.mean, NoiseScale()),)


def _check_log(obj: GridObject, log: PushLog) -> ScreenedLog:
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
    screened = ScreenedLog.of_jumps(obj, log)
    check_plausible(obj, screened.log, learning=True)
    return screened


def _make_result(
    obj: GridObject,
    screened: ScreenedLog,
    fit: MapEnsembleFit,
    *,
    held: CellParameters,
    method: str,
    tracker: Tracker,
    physics: Physics,
    seed: int,
    unused: tuple[str, ...],
    noise: NoiseModel,
) -> Identification:
    """Turns z and its covariance into masses, frictions and their standard deviations.

    Args:
        obj: the object.
        screened: the pushes learned from, and what was refused.
        fit: the most probable z, and its covariance.
        held: parameters that the fit does not change, among them every cell's friction.
        method: the method's name.
        tracker: counts the simulations, and has the history of the fit.
        physics: physics of the simulations.
        seed: seed of the draws that weigh measured forces.
        unused: names of the pushes that missed the object.
        noise: the noise model, at scale one.

    Returns:
        The result.
    """
    # Pushes show k_i = mu_i m_i up to a common scale (section 2): with the frictions held, the
    # masses follow, and their sum is what was told of the object.
    friction = held.friction
    posterior = Posterior(fit.z, fit.covariance, fit.prior_covariance)
    fraction = posterior.calc_fraction()
    total_mass = obj.prior.total_mass or DEFAULT_TOTAL_MASS
    mass = fraction / friction
    mass *= total_mass / mass.sum()
    params = replace(held, mass=mass, contact_friction=float(np.exp(fit.z[CONTACT_FRICTION])))

    # Measured forces give the common scale (section 10), but only those of slow pushes.
    force = None
    if screened.log and explain_unused_forces(obj, screened.log, physics.inertial) is None:
        force = calc_force_scale(Model(obj, params, physics), posterior, screened.log, seed)
    if force is not None:
        params = force.rescale(Model(obj, params))
        mass = params.mass
    relative_std = (
        np.sqrt(np.maximum(np.diag(posterior.calc_fraction_covariance()), 0.0)) / fraction
    )

    # Between its bounds, slow pushes say nothing of a friction coefficient by itself: uniform.
    log_contact_friction_std = np.sqrt(fit.covariance[CONTACT_FRICTION, CONTACT_FRICTION])
    std = CellParameters(
        mass=np.maximum(mass * relative_std, np.finfo(float).tiny),
        friction=np.full(obj.n, obj.prior.friction_std),
        contact_friction=float(params.contact_friction * log_contact_friction_std),
    )
    return Identification(
        objects=(obj,),
        parameters=(params,),
        std=std,
        posterior=posterior,
        identifiability=calc_identifiability(Model(obj, params), posterior, force),
        method=method,
        physics=physics,
        status=fit.status,
        message=fit.message,
        history=tuple(tracker.history),
        simulations=tracker.simulations,
        noise_std=fit.noise_std,
        load_shift_std=fit.load_shift_std,
        seed=seed,
        push_names=tuple(push.name for push in screened.log),
        unused_pushes=unused,
        outliers=screened.outliers,
        starts=fit.starts,
        force=force,
        interval_scale=fit.interval_scale,
        noise=noise,
        hypotheses=fit.hypotheses,
    )
