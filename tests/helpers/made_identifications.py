"""A made-up but consistent identification, for what only writes, reads or draws one."""

import numpy as np

from gridpush_drake.grid.object import GridObject
from gridpush_drake.grid.parameters import CellParameters
from gridpush_drake.grid.prior import PhysicalPrior
from gridpush_drake.identification.identifiability import Identifiability
from gridpush_drake.identification.posterior import Posterior
from gridpush_drake.identification.result import STATUS_LEARNED, HistoryEntry, Identification

OUTLINE = [[-0.06, -0.03], [0.06, -0.03], [0.06, 0.03], [-0.06, 0.03]]
HEAD = [[0.02, -0.03], [0.06, -0.03], [0.06, 0.03], [0.02, 0.03]]


def make_block(max_cells: int = 18) -> GridObject:
    """A 120 x 60 mm block of two parts, the second heavier."""
    prior = PhysicalPrior(total_mass=1.2, pusher_radius=0.004)
    return GridObject.from_outline(OUTLINE, parts={2: HEAD}, max_cells=max_cells, name="block", prior=prior)


def make_identification(obj: GridObject | None = None, seed: int = 0) -> Identification:
    """Random numbers in the shape of a learned model."""
    obj = obj or make_block()
    rng, n = np.random.default_rng(seed), obj.n
    params = CellParameters(rng.uniform(0.02, 0.1, n), rng.uniform(0.2, 0.6, n), 0.43)
    std = CellParameters(rng.uniform(0.001, 0.02, n), rng.uniform(0.01, 0.1, n), 0.08)
    factor = rng.normal(size=(n + 1, n + 1)) * 0.1
    posterior = Posterior(
        np.append(np.log(params.relative_friction()), np.log(params.contact_friction)),
        factor @ factor.T,
        np.eye(n + 1),
    )
    k = params.relative_friction()
    known = Identifiability(
        relative_friction=k,
        relative_friction_std=k * rng.uniform(0.05, 0.5, n),
        centre_of_friction=k @ obj.p_BC,
        centre_of_friction_covariance=np.diag([1e-6, 2e-6]),
        learned_directions=3,
        null_space=np.linalg.qr(rng.normal(size=(n, n)))[0][3:],
        learned_share=rng.uniform(0, 1, n),
        mass_min=params.mass * 0.5,
        mass_max=params.mass * 2.0,
        centre_of_mass_box=np.array([[-0.01, -0.02], [0.02, 0.01]]),
        statements=("The pushes fix 3 combinations of the cells' friction.", "Mass itself is not identifiable."),
    )
    history = tuple(HistoryEntry(10 * (i + 1), 0.01 * 0.7**i, "descent") for i in range(8))
    return Identification(
        obj, params, std, posterior, known, "default", "quasi_static", STATUS_LEARNED, "learned from 4 pushes.",
        history, 80, 4e-4, seed, ("push_1", "push_2", "push_3", "push_4"), ("push_5",),
    )  # fmt: skip
