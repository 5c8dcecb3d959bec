"""What each cell bears of an object's weight when some of it hangs over the table's rim.

A cell is a foot at its centre, as stiff as it is heavy (as `scene.feet` makes them): on the table altogether, every
foot bears its own cell's weight. Pressed in by a rigid body that sinks and tilts, foot i bears

    N_i = m_i g max(0, a.phi_i),    phi_i = (1, x_i, y_i),    for the feet on the table, 0 for the others

with a such that force and moments balance, sum N_i phi_i = g sum m_i phi_i. That is the stationary point of the convex

    f(a) = 1/2 sum_held m_i max(0, a.phi_i)^2 - a.sum_all m_i phi_i

found by Newton's method. f has no minimum where the centre of mass is outside the hull of the held feet: the object
then tips, and falls.
"""

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.grid.object import GridObject
from gridpush_drake.planning.convex import calc_margin_inside, hull_of

Array = NDArray[np.float64]

NEWTON_STEPS = 60
TOLERANCE = 1e-10
"""Relative, of the balance."""

LEAST_SLOPE = 1e-12
"""Relative, added to the Hessian where the feet that bear are in a line."""

HALVINGS = 40


def calc_edge_loads(obj: GridObject, mass: Array, held: NDArray[np.bool_]) -> Array | None:
    """Calculates the loads, as masses.

    Args:
        obj: the object.
        mass: (n,) of its cells, kg.
        held: (n,) whether a cell's foot is on the table.

    Returns:
        (n,) N_i/g, kg, which sum to the total mass; None where the object tips.
    """
    if held.all():
        return mass.copy()
    # lengths of order one: the Hessian is then well conditioned
    scale = obj.radius_of_gyration
    phi = np.column_stack([np.ones(obj.n), (obj.p_BC - obj.p_BC.mean(axis=0)) / scale])
    wanted = (mass @ phi) / mass.sum()
    if calc_margin_inside(wanted[None, 1:], hull_of(phi[held, 1:])) <= 0:
        return None
    stiffness = np.where(held, mass, 0.0) / mass.sum()
    load = _balance(stiffness, phi, wanted)
    return load * mass.sum() / load.sum()


def _balance(stiffness: Array, phi: Array, wanted: Array) -> Array:
    """(n,) loads that balance, by Newton's method with a line search on f."""

    def value(a: Array) -> float:
        return float(0.5 * stiffness @ np.maximum(phi @ a, 0.0) ** 2 - a @ wanted)

    a = np.array([1.0 / stiffness.sum(), 0.0, 0.0])
    for _ in range(NEWTON_STEPS):
        press = np.maximum(phi @ a, 0.0)
        gradient = (stiffness * press) @ phi - wanted
        if np.abs(gradient).max() < TOLERANCE:
            break
        bears = stiffness * (press > 0)
        H = (phi * bears[:, None]).T @ phi
        step = -np.linalg.solve(H + LEAST_SLOPE * max(np.trace(H), stiffness.max()) * np.eye(3), gradient)
        before, slope, size = value(a), float(gradient @ step), 1.0
        for _ in range(HALVINGS):
            if value(a + size * step) <= before + 1e-4 * size * slope:
                break
            size /= 2
        a = a + size * step
    return np.asarray(stiffness * np.maximum(phi @ a, 0.0))
