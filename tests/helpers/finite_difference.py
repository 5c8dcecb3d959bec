"""The finite-difference harness that every gradient of the project meets."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

STENCILS = {2: ((1, 1 / 2),), 4: ((1, 2 / 3), (2, -1 / 12))}
"""Central differences by order: (offset k, weight a_k) of f'(x) = sum_k a_k (f(x + k h) - f(x - k
h)) / h."""

X_FLOOR = 1e-3
"""Least |x_j| that a step is scaled to, as a fraction of the largest |x|."""


def calc_finite_difference(
    function: Callable[[NDArray[np.float64]], ArrayLike],
    x: ArrayLike,
    *,
    step: float = 1e-6,
    order: int = 2,
) -> NDArray[np.float64]:
    """Differentiates `function` by central differences.

    Args:
        function: from an array of x's shape to an array (or number) of any shape; never sees its
            argument changed afterwards.
        x: where; any shape.
        step: relative step: coordinate j moves by step * max(|x_j|, X_FLOOR max|x|), by `step`
            itself at x = 0.
        order: 2 or 4 (Richardson's extrapolation of the steps h and 2h; with a larger step, 1e-3
            say, it is the more accurate).

    Returns:
        The Jacobian, of shape f.shape + x.shape.
    """
    x = np.asarray(x, dtype=np.float64)
    largest = np.abs(x).max(initial=0.0)
    h = step * np.maximum(np.abs(x), X_FLOOR * largest) if largest > 0 else np.full(x.shape, step)
    columns = []
    for index in np.ndindex(x.shape):
        column = 0.0
        for offset, weight in STENCILS[order]:
            up, down = x.copy(), x.copy()
            up[index] += offset * h[index]
            down[index] -= offset * h[index]
            difference = np.array(function(up), dtype=np.float64) - np.array(
                function(down), dtype=np.float64
            )
            column = column + weight * difference * (2 * offset) / (up[index] - down[index])
        columns.append(column)
    columns = np.stack(columns, axis=-1)
    return columns.reshape(columns.shape[:-1] + x.shape)


def check_jacobian(
    function: Callable[[NDArray[np.float64]], ArrayLike],
    x: ArrayLike,
    jacobian: ArrayLike,
    *,
    step: float = 1e-6,
    rtol: float = 1e-6,
    atol: float = 0.0,
    order: int = 2,
) -> None:
    """Compares `jacobian` with central differences of `function` at x.

    An entry may be off by atol + rtol * (the largest entry of its column): the derivatives by one
    parameter are measured by their largest, since differences cannot resolve an entry that is much
    smaller than its neighbors.

    Args:
        function: from an array of x's shape to an array (or number).
        x: where.
        jacobian: of shape f.shape + x.shape.
        step: relative step (see `calc_finite_difference`).
        rtol: relative tolerance.
        atol: absolute tolerance, in the Jacobian's units.
        order: 2 or 4.

    Raises:
        AssertionError: shapes differ, or an entry is off; the message names the worst one.
    """
    x, jacobian = np.asarray(x, dtype=np.float64), np.asarray(jacobian, dtype=np.float64)
    expected = calc_finite_difference(function, x, step=step, order=order)
    assert jacobian.shape == expected.shape, (
        f"jacobian has shape {jacobian.shape}; expected {expected.shape}"
    )
    assert np.isfinite(jacobian).all(), (
        f"jacobian has {np.sum(~np.isfinite(jacobian))} entries that are not finite"
    )
    f_axes = tuple(range(expected.ndim - x.ndim))
    largest = np.maximum(np.abs(expected), np.abs(jacobian)).max(axis=f_axes, keepdims=True)
    error, allowed = np.abs(jacobian - expected), atol + rtol * largest + np.finfo(float).tiny
    worst = np.unravel_index(np.argmax(error / allowed), error.shape)
    at = ", ".join(str(int(i)) for i in worst)
    off, limit = error[worst], np.broadcast_to(allowed, error.shape)[worst]
    assert off <= limit, (
        f"{np.sum(error > allowed)} of {error.size} entries are off; worst is jacobian[{at}] = {jacobian[worst]:.10g}, "
        f"differences give {expected[worst]:.10g}: off by {off:.3g}, {limit:.3g} allowed "
        f"(step {step:g}, order {order}, rtol {rtol:g}, atol {atol:g})"
    )
