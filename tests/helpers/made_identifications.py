"""A made-up but consistent identification, for what only writes, reads or draws one."""

import numpy as np

from gridpush_drake.dynamics.physics import QUASI_STATIC
from gridpush_drake.identification.identifiability import calc_identifiability
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.result import HistoryEntry, Identification, IdentificationStatus
from gridpush_drake.identification.statistics.posterior import Posterior
from gridpush_drake.objects.grid_object import GridObject, PhysicalPrior
from gridpush_drake.objects.parameters import CellParameters

OUTLINE = [[-0.06, -0.03], [0.06, -0.03], [0.06, 0.03], [-0.06, 0.03]]
HEAD = [[0.02, -0.03], [0.06, -0.03], [0.06, 0.03], [0.02, 0.03]]


def make_block(max_cells: int = 18) -> GridObject:
    """A 120 x 60 mm block of two parts, the second heavier."""
    prior = PhysicalPrior(total_mass=1.2, pusher_radius=0.004)
    return GridObject.from_outline(
        OUTLINE, parts={2: HEAD}, max_cells=max_cells, name="block", prior=prior
    )


def make_identification(obj: GridObject | None = None, seed: int = 0) -> Identification:
    """Random numbers in the shape of a learned model."""
    obj = obj or make_block()
    rng, n = np.random.default_rng(seed), obj.n
    params = CellParameters(rng.uniform(0.02, 0.1, n), rng.uniform(0.2, 0.6, n), 0.43)
    std = CellParameters(rng.uniform(0.001, 0.02, n), rng.uniform(0.01, 0.1, n), 0.08)
    factor = rng.normal(size=(n + 1, n + 1)) * 0.1
    posterior = Posterior(
        np.append(np.log(params.relative_friction()), np.log(params.contact_friction)),
        (factor @ factor.T + (factor @ factor.T).T) / 2,
        np.eye(n + 1),
    )
    history = tuple(HistoryEntry(10 * (i + 1), 0.01 * 0.7**i, "descent") for i in range(8))
    known = calc_identifiability(Model(obj, params), posterior)
    return Identification(
        objects=(obj,),
        parameters=(params,),
        std=std,
        posterior=posterior,
        identifiability=known,
        method="default",
        physics=QUASI_STATIC,
        status=IdentificationStatus.LEARNED,
        message="learned from 4 pushes.",
        history=history,
        simulations=80,
        noise_std=4e-4,
        load_shift_std=2e-3,
        seed=seed,
        push_names=("push_1", "push_2", "push_3", "push_4"),
        unused_pushes=("push_5",),
    )
