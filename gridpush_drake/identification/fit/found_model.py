"""From z and its spread to masses, frictions and what is known of them: `make_identification`.

The fits know loads and their logarithms alone. What that says of an object in SI units, with the
scale that measured forces give, is worked out here, for every method of one object alike.
"""

from dataclasses import replace

import numpy as np

from gridpush_drake.identification.absolute.force_scale import calc_force_scale
from gridpush_drake.identification.fit.fit_average import MapEnsembleFit
from gridpush_drake.identification.fit.learning_task import LearningTask, TouchingPushes
from gridpush_drake.identification.fit.robust_fit import Tracker
from gridpush_drake.identification.identifiability import calc_identifiability
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.result import Identification
from gridpush_drake.identification.statistics.noise import NoiseModel
from gridpush_drake.identification.statistics.outliers import ScreenedLog
from gridpush_drake.identification.statistics.posterior import CONTACT_FRICTION, Posterior
from gridpush_drake.objects.parameters import DEFAULT_TOTAL_MASS, CellParameters
from gridpush_drake.pushes.plausibility import explain_unused_forces


def make_identification(
    task: LearningTask,
    pushes: TouchingPushes,
    screened: ScreenedLog,
    fit: MapEnsembleFit,
    *,
    held: CellParameters,
    method: str,
    tracker: Tracker,
    noise: NoiseModel,
) -> Identification:
    """Turns z and its covariance into masses, frictions and their standard deviations.

    Args:
        task: what was learned from.
        pushes: those of its pushes that touch the object.
        screened: the pushes learned from, and what was refused.
        fit: the most probable z, and its covariance.
        held: parameters that the fit does not change, among them every cell's friction.
        method: the method's name.
        tracker: counts the simulations, and has the history of the fit.
        noise: the noise model, at scale one.

    Returns:
        The model, without `message`.
    """
    obj = task.obj
    physics = task.model.physics
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
    if screened.log and explain_unused_forces([obj], screened.log, physics.inertial) is None:
        force = calc_force_scale(Model(obj, params, physics), posterior, screened.log, task.seed)
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
        message="",
        history=tuple(tracker.history),
        simulations=tracker.simulations,
        noise_std=fit.noise_std,
        load_shift_std=fit.load_shift_std,
        seed=task.seed,
        push_names=tuple(push.name for push in screened.log),
        unused_pushes=pushes.unused,
        outliers=screened.outliers,
        starts=fit.starts,
        force=force,
        interval_scale=fit.interval_scale,
        noise=noise,
        hypotheses=fit.hypotheses,
    )
