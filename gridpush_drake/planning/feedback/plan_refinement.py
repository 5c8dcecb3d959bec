"""Refines a plan on a path by Gauss and Newton's method, for several models at once.

What is moved is a path of straight lines between KNOT_COUNT places, which is added to the plan. The
residuals of the plan's cost are differentiated by these places, by rollouts. See
`docs/theory/feedback.md`, section 7.
"""

from collections.abc import Sequence

import numpy as np

from gridpush_drake.dynamics.kernels.steering.finger_push import (
    STATE_SIZE,
    THETA,
    FreeSpace,
    X,
)
from gridpush_drake.geometry.se2 import Array, transform, wrap_angle
from gridpush_drake.planning.feedback.push_search import PushMoves, TrackingCost, roll_plans
from gridpush_drake.planning.pushed_object import SearchModel

KNOT_COUNT = 4
"""Places of a plan on a path that are moved by the refinement, with straight lines between."""

DIFFERENCE_STEP = 2e-4
"""Step of the differences of the refinement, m."""

DAMPING_FRACTION = 1e-2
"""Damping of the refinement, as a fraction of the mean of the diagonal."""

LEAST_DAMPING = 1e-12
"""Least damping, for plans that move nothing."""

STEP_SIZES = np.array([1.0, 0.5, 0.2, 0.05])
"""Lengths of a step of the refinement that are tried."""


def refine_plan(
    models: Sequence[SearchModel],
    cost_terms: TrackingCost,
    room: FreeSpace,
    state: Array,
    plan: Array,
    moves: PushMoves,
) -> bool:
    """Takes one damped step of the method, and keeps the best of a few lengths of it.

    Args:
        models: the estimate, and other models that count as much.
        cost_terms: what the object should do: follow a path.
        room: where object and finger may be.
        state: (STATE_SIZE,) now.
        plan: (T, D) places of the finger, W, m, and angles, rad, of one that is no disc; changed
            where the step makes it better.
        moves: how far the finger may go and turn in a decision.

    Returns:
        Whether it got better.
    """
    count, size = plan.shape
    corners = np.linspace(0.0, count - 1.0, KNOT_COUNT)
    shifts = np.zeros((size * KNOT_COUNT, count, size))
    # a turn by which the farthest point of the finger moves as far as all of it by a shift
    units = np.ones(size)
    if size > 2:
        units[2] = 1.0 / models[0].radius
    for i in range(KNOT_COUNT):
        bump = np.interp(np.arange(count), corners, np.eye(KNOT_COUNT)[i])
        for j in range(size):
            shifts[j * KNOT_COUNT + i, :, j] = units[j] * bump

    # Normal equations of all models together.
    tried = np.concatenate([plan[None], plan[None] + DIFFERENCE_STEP * shifts])
    H = np.zeros((len(shifts), len(shifts)))
    gradient = np.zeros(len(shifts))
    before = 0.0
    for model in models:
        states, costs = _roll(model, cost_terms, room, state, tried.copy(), moves)
        if not np.isfinite(costs[0]):
            return False
        residuals = _calc_residuals(cost_terms, states)
        J = (residuals[1:] - residuals[0]).T / DIFFERENCE_STEP
        J[:, ~np.isfinite(costs[1:])] = 0.0
        H += J.T @ J
        gradient += J.T @ residuals[0]
        before += float(costs[0])
    damping = DAMPING_FRACTION * np.trace(H) / len(H) + LEAST_DAMPING
    step = np.linalg.solve(H + damping * np.eye(len(H)), -gradient)

    # The best of a few lengths of the step.
    shift = np.tensordot(step, shifts, axes=1)
    tried = plan[None] + STEP_SIZES[:, None, None] * shift[None]
    total = np.zeros(len(STEP_SIZES))
    for model in models:
        _, costs = _roll(model, cost_terms, room, state, tried.copy(), moves)
        total += costs
    best = int(total.argmin())
    if not total[best] < before:
        return False
    plan[:] = tried[best]
    return True


def _roll(
    model: SearchModel,
    cost_terms: TrackingCost,
    room: FreeSpace,
    state: Array,
    plans: Array,
    moves: PushMoves,
) -> tuple[Array, Array]:
    """Follows plans (P, T, D) by a model; returns states (P, T + 1, STATE_SIZE), costs (P,)."""
    states = np.empty((len(plans), plans.shape[1] + 1, STATE_SIZE))
    costs = np.empty(len(plans))
    roll_plans(
        model,
        cost_terms,
        room,
        start=state,
        targets=plans,
        moves=moves,
        states=states,
        costs=costs,
    )
    return states, costs


def _calc_residuals(cost_terms: TrackingCost, states: Array) -> Array:
    """(P, 3T) numbers, m, whose squares add up to the costs of plans on a path."""
    # where the centroid is, seen along and across the path
    after = states[:, 1:]
    count = after.shape[1] + 1
    center = transform(after[..., X : THETA + 1], cost_terms.middle[None])[..., 0, :]
    off = center - cost_terms.references[1:count, :2]
    along = cost_terms.along[1:count]
    ahead = (off * along).sum(axis=-1)
    beside = off[..., 1] * along[:, 0] - off[..., 0] * along[:, 1]
    turn = cost_terms.arm * wrap_angle(after[..., THETA] - cost_terms.references[1:count, 2])
    found = np.stack(
        [beside, np.sqrt(cost_terms.weight_along) * ahead, np.sqrt(cost_terms.weight_turn) * turn],
        axis=-1,
    )
    return np.asarray(found.reshape(len(states), -1))
