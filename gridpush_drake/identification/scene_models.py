"""What was learned of several objects, as a model of each: `make_object_models`.

Each model is that object's part of the common posterior, and can be used as any other: to predict,
to plan, to be written to a file. What objects have in common, such as how rough they are to each
other, stands in the `SceneIdentification` alone.
"""

import numpy as np

from gridpush_drake.identification.identifiability import calc_identifiability
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.noise import NoiseModel
from gridpush_drake.identification.posterior import Posterior
from gridpush_drake.identification.result import Identification, IdentificationStatus
from gridpush_drake.identification.scene_learning import SceneIdentification
from gridpush_drake.notebook import MM, count
from gridpush_drake.objects.parameters import CellParameters

METHOD = "scene"
"""Name of the method in the models."""

LITTLE = 0.5
"""Share of the pushes that the model does not explain from which on it explains little."""


def make_object_models(found: SceneIdentification) -> tuple[Identification, ...]:
    """Makes a model of each object.

    Their masses have the ratios that were learned; how heavy all are together no slow push tells.

    Args:
        found: what was learned of all.

    Returns:
        (N,) the models, in the order of the objects.
    """
    return tuple(_make_model(found, b) for b in range(len(found.scene)))


def _make_model(found: SceneIdentification, body: int) -> Identification:
    obj = found.scene.objects[body]
    params = found.scene.params[body]
    # the object's own unknowns: its cells, and its friction with the pusher
    places = found.list_unknowns(body)
    block = np.ix_(places, places)
    posterior = Posterior(
        mean=found.z[places],
        covariance=found.covariance[block],
        prior_covariance=found.prior_covariance[block],
    )
    share = posterior.calc_share()
    relative_std = np.sqrt(np.maximum(np.diag(posterior.calc_share_covariance()), 0.0)) / share
    std = CellParameters(
        mass=np.maximum(params.mass * relative_std, np.finfo(float).tiny),
        friction=np.full(obj.n, obj.prior.friction_std),
        contact_friction=float(params.contact_friction * np.sqrt(posterior.covariance[-1, -1])),
    )
    status = IdentificationStatus.LEARNED
    before = found.errors_before[:, body].mean() * MM
    after = found.errors[:, body].mean() * MM
    message = (
        f"Learned together with {count(len(found.scene) - 1, 'other object')} from "
        f"{count(len(found.push_names), 'push')}: cell error {after:.2f} mm, "
        f"{before:.2f} mm as an even object."
    )
    if found.unexplained:
        message += f" It does not explain {', '.join(found.unexplained)}."
    if not found.moved[body]:
        status = IdentificationStatus.PRIOR_KEPT
        message = "No push moved it: nothing was learned of it."
    elif len(found.unexplained) >= LITTLE * len(found.push_names):
        status = IdentificationStatus.EXPLAINS_LITTLE
        message = f"The model explains little of the pushes. {message}"
    elif after > before:
        status = IdentificationStatus.PRIOR_KEPT
        message = f"The pushes are predicted no better than for an even object. {message}"
    return Identification(
        objects=(obj,),
        parameters=(params,),
        std=std,
        posterior=posterior,
        identifiability=calc_identifiability(Model(obj, params), posterior),
        method=METHOD,
        physics=found.physics,
        status=status,
        message=message,
        history=(),
        simulations=found.simulations,
        noise_std=found.noise_scale * found.noise[0],
        load_shift_std=0.0,
        seed=0,
        push_names=found.push_names,
        noise=NoiseModel(),
    )
