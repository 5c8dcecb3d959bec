"""What a poke is expected to leave unknown: its outcomes are imagined, and learned from.

To first order about one estimate (`designed_pokes.calc_remaining`) pokes are well compared, but
what they leave is far too hopeful: learning weighs many hypotheses of the loads, and finds out how
noisy the pushes are. So for the poke that was chosen

    1. models are drawn that may be the true one: from the posterior, or, before any push, one from
       each hypothesis of the loads that needs no pushes;
    2. each of them is poked, and its poses are spoiled by the noise that the pushes have;
    3. each outcome is learned from as a real one would be, together with the pushes so far.

The forecast is the median of the standard deviations that are then left. It is no bound: about half
of all pokes leave more.
"""

import warnings
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import GridPushError, PushLogWarning
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.fit.load_prior import HypothesisInputs
from gridpush_drake.identification.fit.map_ensemble import MapEnsemble
from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.statistics.posterior import CONTACT_FRICTION, calc_fraction
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.belief import Belief
from gridpush_drake.planning.exploration.designed_pokes import Functional, calc_worst_std
from gridpush_drake.planning.world import OBSERVATION_COUNT
from gridpush_drake.pushes.push_log import ObservedPush, PushLog

FORECAST_DRAWS = 5
"""Number of models whose pokes are imagined once pushes were learned from."""

IMAGINED_POKE = "imagined_poke"
"""Name of an imagined poke in the log that is learned from."""


def forecast_std(
    model: Belief, push: Push, pose: ArrayLike, make_functional: Functional
) -> float | None:
    """Forecasts the standard deviation of what matters after a poke.

    Args:
        model: of the object, with its posterior.
        push: the poke.
        pose: (3,) where the object lies, X_WB, m and rad.
        make_functional: calculates the derivatives by z of what matters.

    Returns:
        The standard deviation in the direction that is then known least; None where nothing could
        be imagined, as the pushes learned from are not at hand.
    """
    if model.identification is None or len(model.log) < len(model.identification.push_names):
        return None
    rng = np.random.default_rng(model.seed)
    left = []
    for params in _draw_models(model, rng):
        seen = _imagine(model, params, push, np.asarray(pose, dtype=np.float64), rng)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", PushLogWarning)
                found = identify(
                    Model(model.obj),
                    PushLog((*model.log, seen)),
                    regime="quasi_static",
                    start=model.identification,
                )
        except GridPushError:
            continue  # nothing is learned from such an outcome
        if IMAGINED_POKE not in found.push_names:
            continue
        after = Belief.of_identification(found, friction_range=model.friction_range)
        F = make_functional(after)
        left.append(calc_worst_std(F @ found.posterior.covariance @ F.T))
    return float(np.median(left)) if left else None


def _draw_models(model: Belief, rng: np.random.Generator) -> list[CellParameters]:
    """Draws models that may be the true one."""
    posterior = model.require_posterior()
    if len(model.log):
        return posterior.draw_parameters(model.params, FORECAST_DRAWS, model.seed, model.evidence)
    variance = posterior.prior_covariance[CONTACT_FRICTION, CONTACT_FRICTION]
    setting = HypothesisInputs(model.obj, posterior.mean, float(np.sqrt(variance)))
    draws = []
    for hypothesis in MapEnsemble().hypotheses:
        if hypothesis.needs_pushes:
            continue
        for prior in hypothesis.propose(setting):
            z = prior.mean + prior.factor @ rng.standard_normal(len(prior.mean))
            draws.append(_make_parameters(model, z))
    return draws


def _make_parameters(model: Belief, z: Array) -> CellParameters:
    """Makes masses of the estimate's friction that bear the loads of z (n+1,)."""
    params = model.params
    mass = float(params.mass @ params.friction) * calc_fraction(z) / params.friction
    return replace(params, mass=mass, contact_friction=float(np.exp(z[CONTACT_FRICTION])))


def _imagine(
    model: Belief,
    params: CellParameters,
    push: Push,
    pose: Array,
    rng: np.random.Generator,
) -> ObservedPush:
    """Imagines what would be seen of a push, if a model were the true one.

    The contact friction varies from push to push, and poses are noisy, as pushes have shown it.
    """
    noise = model.noise
    factor = np.exp(noise.log_contact_friction * rng.standard_normal())
    varied = replace(params, contact_friction=float(factor * params.contact_friction))
    motion = simulate(Model(model.obj, varied, model.physics), push, pose)
    # as often as the pushes so far were seen
    count = len(model.log[-1].t_observed) if len(model.log) else OBSERVATION_COUNT
    times = push.duration * np.arange(1, count + 1) / count
    poses = np.column_stack([np.interp(times, motion.times, motion.poses[:, i]) for i in range(3)])
    unit = np.array([1.0, 1.0, model.obj.radius_of_gyration])
    std = model.noise_scale.pose * noise.pose
    poses += std / unit * rng.standard_normal(poses.shape)
    return ObservedPush(IMAGINED_POKE, push, pose, times, poses)
