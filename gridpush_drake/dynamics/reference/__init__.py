"""The paper's own forms, slow and independent: what the kernels are tested against, and its gradient.

Song & Boularias, "Learning to Slide Unknown Objects with Differentiable Physics Simulations", RSS 2020: the LCP in
maximal coordinates, its solvers as an LCP, a QP and a cone program, and the closed-form gradient of one step. The
names below are imported on first use.
"""

from typing import TYPE_CHECKING

from gridpush_drake.lazy import make_lazy_names

if TYPE_CHECKING:
    from gridpush_drake.dynamics.reference.isotropic_socp import solve_isotropic_socp
    from gridpush_drake.dynamics.reference.maximal_lcp import MaximalLcp, make_maximal_lcp, twist_to_cells
    from gridpush_drake.dynamics.reference.maximal_solvers import LcpSolution, solve_as_lcp, solve_as_qp
    from gridpush_drake.dynamics.reference.paper_gradient import (
        PaperGradient,
        calc_paper_gradient,
        calc_paper_loss_gradient,
        calc_paper_step_jacobian,
        calc_x11,
    )
    from gridpush_drake.dynamics.reference.paper_rollout import calc_paper_jacobian

__all__ = [
    "LcpSolution",
    "MaximalLcp",
    "PaperGradient",
    "calc_paper_gradient",
    "calc_paper_jacobian",
    "calc_paper_loss_gradient",
    "calc_paper_step_jacobian",
    "calc_x11",
    "make_maximal_lcp",
    "solve_as_lcp",
    "solve_as_qp",
    "solve_isotropic_socp",
    "twist_to_cells",
]

_HOMES = {
    "LcpSolution": "maximal_solvers",
    "MaximalLcp": "maximal_lcp",
    "PaperGradient": "paper_gradient",
    "calc_paper_gradient": "paper_gradient",
    "calc_paper_jacobian": "paper_rollout",
    "calc_paper_loss_gradient": "paper_gradient",
    "calc_paper_step_jacobian": "paper_gradient",
    "calc_x11": "paper_gradient",
    "make_maximal_lcp": "maximal_lcp",
    "solve_as_lcp": "maximal_solvers",
    "solve_as_qp": "maximal_solvers",
    "solve_isotropic_socp": "isotropic_socp",
    "twist_to_cells": "maximal_lcp",
}

__getattr__ = make_lazy_names(globals(), _HOMES)
