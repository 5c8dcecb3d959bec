"""The paper's Algorithm 1: coordinate descent in M and mu by the closed-form gradient.

Source: Song & Boularias, RSS 2020.

The loss is the mean over pushes, observed times tau and cells of |x_tau - x*_tau|, predicted and
observed places. The paper holds x_t and xdot_t constant in each step's derivative; of the chain
rule through the steps of the LCP there remains the sum of their own terms, each by the closed form
of one step (`dynamics.reference.paper_gradient`),

    dloss/dM  = sum_tau dloss/dq_tau · sum_{t < tau} dq_{t+1}/dM  |_{x_t, xdot_t, F constant}
    dloss/dmu = sum_tau dloss/dq_tau · sum_{t < tau} dq_{t+1}/dmu |_{x_t, xdot_t, F constant}

The loss descended is that of the paper's own model, whatever the regime asked for: inertial, with
the friction directions of the step before.

Steps. The closed form leaves out how a step changes those after it and how the pusher's force
answers: it is a good direction, of no meaningful length. A step is therefore normalized: the cell
whose logarithm it would move most moves by a given amount, all others in proportion, then all are
clipped to the bounds. A step that does not lower the loss is taken back, which costs its
simulations, and the next is shorter; one that does is followed by a longer one. M and mu take
turns, each with its own step.
"""

from dataclasses import dataclass, replace

import numpy as np

from gridpush_drake.dynamics.motion import Motion
from gridpush_drake.dynamics.physics import Physics
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.baselines.search import CellLoss, LossSearch, SearchStatus
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters

PARAMETER_BLOCKS = ("mass", "friction")
"""Blocks of parameters that are descended in by turns."""

PAPER_PHYSICS = Physics(friction_law="lagged", regime="inertial")
"""The paper's model."""

MIN_MISS = 1e-12
"""Distance of a predicted cell from the observed one below which it has no direction, m."""


@dataclass(frozen=True)
class PaperDescent:
    """Algorithm 1: nothing in it is random.

    Its model is always inertial, pushed at the table's height.

    Attributes:
        first_step: largest change of a cell's log mass or log friction in the first step.
        lengthen: factor on the step after a success.
        shorten: factor on the step after a failure.
        min_step: step below which, in both blocks, the search has stalled.
        physics: physics of its model.
    """

    first_step: float = 0.5
    lengthen: float = 1.5
    shorten: float = 0.5
    min_step: float = 1e-3
    physics: Physics | None = PAPER_PHYSICS

    def run(self, search: LossSearch) -> SearchStatus:
        """Descends in M and mu by turns, with backtracking, until it stalls or the loss ends it."""
        loss = search.loss
        bounds = search.bounds
        params = replace(search.first, push_height=0.0)
        lowest, simulations = loss.evaluate(params, "start", gradients="paper")
        gradient = calc_paper_gradient_of_loss(loss, simulations)
        steps = {
            block: self.first_step
            for block in PARAMETER_BLOCKS
            if np.ptp(getattr(bounds, block)) > 0
        }
        while max(steps.values(), default=0.0) > self.min_step:
            for block in steps:
                trial = bounds.clip(_step(params, block, gradient[block], steps[block]))
                value, simulations = loss.evaluate(trial, f"descent in {block}", gradients="paper")
                if value < lowest:
                    params = trial
                    lowest = value
                    gradient = calc_paper_gradient_of_loss(loss, simulations)
                    steps[block] *= self.lengthen
                else:
                    steps[block] *= self.shorten
        return SearchStatus.STALLED


def calc_paper_gradient_of_loss(loss: CellLoss, simulations: list[Motion]) -> dict[str, Array]:
    """Calculates the paper's gradient of the loss, by block (n,): dloss/dm, m/kg; dloss/dmu, m.

    Args:
        loss: the loss.
        simulations: simulations of its pushes, with `gradients="paper"` at every step.

    Returns:
        The gradient by masses and by frictions.
    """
    gradient = {block: np.zeros(loss.obj.n) for block in PARAMETER_BLOCKS}
    for simulation, miss, rows in zip(
        simulations, loss.misses(simulations), loss.rows, strict=True
    ):
        by_pose = np.zeros((len(simulation.poses), 3))
        by_observed = _differentiate_by_pose(loss.obj, simulation.poses[rows], miss)
        np.add.at(by_pose, rows, by_observed / len(simulations))
        # A step moves all poses after it.
        after = by_pose[::-1].cumsum(axis=0)[::-1]
        for block in PARAMETER_BLOCKS:
            gradient[block] += np.einsum("tj,tjn->n", after, getattr(simulation.jacobian, block))
    return gradient


def _step(params: CellParameters, block: str, gradient: Array, step: float) -> CellParameters:
    """Moves one block against its gradient, by `step` in the logarithm of the cell moved most."""
    values: Array = getattr(params, block)
    by_log = gradient * values
    moved = values * np.exp(-step * by_log / max(np.abs(by_log).max(), np.finfo(float).tiny))
    if block == "mass":
        return CellParameters(moved, params.friction, params.contact_friction)
    return CellParameters(params.mass, moved, params.contact_friction)


def _differentiate_by_pose(obj: GridObject, poses: Array, miss: Array) -> Array:
    """Differentiates the mean distance of the cells from where they were seen.

    Args:
        obj: the object.
        poses: (K, 3) predicted poses, m and rad.
        miss: (K, n, 2) predicted minus observed cell centers, m.

    Returns:
        (K, 3) the derivatives by the predicted poses.
    """
    distance = np.linalg.norm(miss, axis=-1, keepdims=True)
    pull = miss / np.maximum(distance, MIN_MISS) / (miss.shape[0] * miss.shape[1])
    arm = obj.cells_at(poses) - poses[:, None, :2]
    torque = arm[..., 0] * pull[..., 1] - arm[..., 1] * pull[..., 0]
    return np.column_stack([pull.sum(axis=1), torque.sum(axis=1)])
