"""A search's result in the form of a fit: its parameters, with Laplace's spread about them."""

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.grid.parameters import CellParameters
from gridpush_drake.identification.bounds import Bounds
from gridpush_drake.identification.default import DefaultFit, DefaultOptions, calc_prior_factor
from gridpush_drake.identification.map_fit import calc_laplace
from gridpush_drake.identification.problem import PushProblem
from gridpush_drake.identification.result import STATUS_BUDGET_SPENT, STATUS_LEARNED
from gridpush_drake.identification.search import SearchMethod
from gridpush_drake.identification.search_methods import DEFAULT_BUDGET_PER_PUSH
from gridpush_drake.identification.smoothness import calc_smooth_covariance
from gridpush_drake.identification.tracker import Tracker
from gridpush_drake.pushes.log import PushLog

Array = NDArray[np.float64]


def fit_by_search(
    problem: PushProblem,
    log: PushLog,
    search: SearchMethod,
    start: CellParameters,
    bounds: Bounds,
    log_contact_friction_std: float,
    options: DefaultOptions,
    budget: int | None,
    seed: int,
    tracker: Tracker,
) -> tuple[DefaultFit, Array]:
    """Runs a search.

    Args:
        problem: the training pushes, for the spread.
        log: the same.
        search: which.
        start: where to begin.
        bounds: of the parameters.
        log_contact_friction_std: prior standard deviation of log mu_c, which no search moves.
        options: whose widest prior and noise give the spread.
        budget: most pushes to simulate, or None.
        seed: of the search.
        tracker: of its history.

    Returns:
        The fit, and the cells' friction coefficients (n,).
    """
    found = search(
        problem.obj, log, start, bounds, budget=budget or DEFAULT_BUDGET_PER_PUSH * len(log), seed=seed,
        regime=problem.regime, progress=tracker.add,
    )  # fmt: skip
    final = PushProblem(problem.obj, log, found.params.friction, problem.regime)
    z = final.unknowns(found.params)
    C = calc_smooth_covariance(problem.obj, options.range_cells)
    A = calc_prior_factor(C, options.amplitudes[-1], log_contact_friction_std)
    covariance, scale = calc_laplace(final, z, A, options.noise)
    status = STATUS_BUDGET_SPENT if found.status == STATUS_BUDGET_SPENT else STATUS_LEARNED
    message = f"The search ended after {found.simulations} simulations: {found.status.replace('_', ' ')}."
    return (
        DefaultFit(z, covariance, A @ A.T, options.noise.pose * scale, status, message),
        found.params.friction,
    )
