"""The paper's lagged friction, whose directions are those of the motion before the step.

`docs/theory/model.md`, sections 2 and 3, has the paper's LCP and its condensed form.

With d_i the unit direction in which cell i moved before the step, and sigma the sense in which the
body turned,

    Psi(xi) = sum_i k_i r(d_i·v_i) + K_spin r(sigma w),      r(z) = (z + sqrt(z² + eps²))/2

where r is a smooth max(0, z). And with r' and r'' the slope and curvature of r, and row_i = (d_i,
p_i × d_i),

    dPsi/dxi       = sum_i k_i r' row_i
    d²Psi/dxi²     = sum_i k_i r'' row_i row_i^T
    d²Psi/dxi dk_i = r' row_i

and similar terms for the spin. At rest the directions are those of the motion that the applied
force would start; under a pusher, whose force is not known beforehand, friction from rest is
isotropic. The spin is always "separate".
"""

from math import sqrt
from typing import Any, NamedTuple

import numpy as np

from gridpush_drake.dynamics.kernels.compiled import kernel
from gridpush_drake.dynamics.kernels.friction.friction_law import FrictionLaw
from gridpush_drake.dynamics.kernels.friction.isotropic_friction import (
    add_isotropic,
    add_symmetric,
    calc_isotropic_dissipation,
    fill_cell_forces,
    make_isotropic,
    renew_spin_load,
)

SPEED_AT_REST = 1e-9
"""m/s; a cell slower than this has no direction of its own."""

YAW_RATE_AT_REST = 1e-8
"""rad/s; a cell that turns more slowly has no sense of rotation of its own."""

IMPENDING_AT_REST = 1e-9
"""Fraction of the fastest cell's impending speed below which a cell's impending direction is
undefined."""


class Lagged(NamedTuple):
    """The law of one object, and the directions of the present step.

    Attributes:
        k, spin: as in `Isotropic`.
        dx, dy: (n,) the directions d_i, body frame; zero where there is none.
        sense: (2,) whether the directions are known, 0 or 1, and the sense of rotation: -1, 0 or 1.
    """

    k: Any
    spin: Any
    dx: Any
    dy: Any
    sense: Any


def make_lagged(k, arm, spin):
    """Makes the law of an object; arguments as of `FrictionLaw.make`."""
    isotropic = make_isotropic(k, arm, spin)
    n = len(k)
    return Lagged(
        k=isotropic.k,
        spin=isotropic.spin,
        dx=np.zeros(n),
        dy=np.zeros(n),
        sense=np.zeros(2),
    )


@kernel(allocates=False)
def fill_lagged_directions(px, py, cx, cy, velocity, force_acceleration, cell_size, dx, dy):
    """Fills in the unit directions of the cells' velocities.

    A cell at rest has that of the motion that the applied force would start.

    Args:
        px, py: (n,) cell centers, m.
        cx, cy: center of mass, m.
        velocity: (3,) of the center of mass, m/s, and yaw rate, rad/s, body frame.
        force_acceleration: (3,) of the center of mass, m/s², and of the yaw, rad/s², that the
            applied force alone would give the body.
        cell_size: m.
        dx, dy: (n,) out; zero where neither exists.

    Returns:
        The sense of rotation: -1, 0 or 1.
    """
    vx = velocity[0]
    vy = velocity[1]
    w = velocity[2]
    ux = force_acceleration[0]
    uy = force_acceleration[1]
    r = force_acceleration[2]

    # A cell that the force would start much more slowly than the fastest one has no direction.
    fastest = cell_size * abs(r)
    for i in range(px.shape[0]):
        x = px[i] - cx
        y = py[i] - cy
        fastest = max(fastest, sqrt((ux - r * y) ** 2 + (uy + r * x) ** 2))
    slow = IMPENDING_AT_REST * fastest
    for i in range(px.shape[0]):
        x = px[i] - cx
        y = py[i] - cy
        cell_x = vx - w * y
        cell_y = vy + w * x
        size = sqrt(cell_x * cell_x + cell_y * cell_y)
        if size <= SPEED_AT_REST:
            # at rest: the motion that the force would start
            cell_x = ux - r * y
            cell_y = uy + r * x
            size = sqrt(cell_x * cell_x + cell_y * cell_y)
            if size <= slow:
                size = np.inf
        dx[i] = cell_x / size
        dy[i] = cell_y / size
    if abs(w) > YAW_RATE_AT_REST:
        return np.sign(w)
    return np.sign(r) if abs(r) > slow / cell_size else 0.0


@kernel(allocates=False)
def add_lagged(px, py, k, dx, dy, spin_load, spin_sign, eps, xi, g, H):
    """Adds gradient and Hessian of the paper's lagged dissipation at `xi` to g (3,) and H (3, 3).

    max(0, z) is smoothed as (z + sqrt(z² + eps²))/2, z = d_i·v_i(xi); (dx, dy) are the lagged unit
    directions d_i in the body frame and spin_sign the sign of the current yaw rate (zero where
    undefined).
    """
    ux = xi[0]
    uy = xi[1]
    w = xi[2]
    for i in range(px.shape[0]):
        row0 = dx[i]
        row1 = dy[i]
        row2 = px[i] * dy[i] - py[i] * dx[i]
        slope, bend = _smooth_ramp(row0 * ux + row1 * uy + row2 * w, eps)
        load = k[i] * slope
        # k_i r' row_i
        g[0] += load * row0
        g[1] += load * row1
        g[2] += load * row2
        # k_i r'' row_i row_i^T
        load = k[i] * bend
        add_symmetric(
            H, load, row0 * row0, row0 * row1, row0 * row2, row1 * row1, row1 * row2, row2 * row2
        )
    slope, bend = _smooth_ramp(spin_sign * w, eps)
    g[2] += spin_load * slope * spin_sign
    H[2, 2] += spin_load * bend * spin_sign * spin_sign


@kernel(allocates=False)
def _smooth_ramp(z, eps):
    """Slope and curvature of (z + sqrt(z² + eps²))/2."""
    root = sqrt(z * z + eps * eps)
    return 0.5 * (1.0 + z / root), 0.5 * eps * eps / (root * root * root)


@kernel(allocates=False)
def fill_lagged_cell_forces(px, py, dx, dy, spin_lever_arm, spin_sign, eps, xi, f):
    """Fills f (3, >= n) with the derivative of the gradient by every k_i."""
    ux = xi[0]
    uy = xi[1]
    w = xi[2]
    slope, _ = _smooth_ramp(spin_sign * w, eps)
    spin_torque = spin_lever_arm * slope * spin_sign
    for i in range(px.shape[0]):
        row2 = px[i] * dy[i] - py[i] * dx[i]
        slope, _ = _smooth_ramp(dx[i] * ux + dy[i] * uy + row2 * w, eps)
        f[0, i] = slope * dx[i]
        f[1, i] = slope * dy[i]
        f[2, i] = slope * row2 + spin_torque


@kernel(allocates=False)
def _begin_step(law, cells, com_x, com_y, cell_size, expected_velocity, force_acceleration, known):
    """Takes the cells' directions from the motion before the step, see `fill_lagged_directions`."""
    law.sense[0] = law.sense[1] = 0.0
    if known:
        law.sense[0] = 1.0
        law.sense[1] = fill_lagged_directions(
            cells[0],
            cells[1],
            com_x,
            com_y,
            expected_velocity,
            force_acceleration,
            cell_size,
            law.dx,
            law.dy,
        )


@kernel(allocates=False)
def _calc_dissipation(law, cells, eps, xi):
    """Calculates Psi, which is isotropic where no direction is known."""
    if law.sense[0] == 0.0:
        return calc_isotropic_dissipation(law.k, law.spin, cells, eps, xi)
    z = law.sense[1] * xi[2]
    total = law.spin[1] * (z + sqrt(z * z + eps * eps)) / 2.0
    for i in range(law.k.shape[0]):
        z = law.dx[i] * (xi[0] - xi[2] * cells[1, i]) + law.dy[i] * (xi[1] + xi[2] * cells[0, i])
        total += law.k[i] * (z + sqrt(z * z + eps * eps)) / 2.0
    return total


@kernel(allocates=False)
def _add_derivatives(law, cells, eps, xi, majorize, g, H):
    """Adds gradient and Hessian; both are isotropic where no direction is known."""
    if law.sense[0] == 0.0:
        add_isotropic(cells[0], cells[1], law.k, law.spin[0], law.spin[1], eps, xi, majorize, g, H)
    else:
        add_lagged(
            cells[0], cells[1], law.k, law.dx, law.dy, law.spin[1], law.sense[1], eps, xi, g, H
        )


@kernel(allocates=False)
def _can_majorize(law):
    """Only where friction is isotropic: the smooth ramp has no such quadratic."""
    return law.sense[0] == 0.0


@kernel(allocates=False)
def _fill_load_derivatives(law, cells, eps, xi, f):
    """Fills in f_i; they are isotropic where no direction is known."""
    if law.sense[0] == 0.0:
        fill_cell_forces(cells[0], cells[1], law.spin, eps * eps, xi, f)
    else:
        fill_lagged_cell_forces(
            cells[0], cells[1], law.dx, law.dy, law.spin[2], law.sense[1], eps, xi, f
        )


LAGGED_LAW = FrictionLaw(
    name="lagged",
    data=Lagged,
    make=make_lagged,
    renew=renew_spin_load,
    begin_step=_begin_step,
    calc_dissipation=_calc_dissipation,
    add_derivatives=_add_derivatives,
    can_majorize=_can_majorize,
    fill_load_derivatives=_fill_load_derivatives,
    spin_models=("separate",),
    regimes=("inertial",),
    gradients=(False, "paper"),
    looks_ahead=False,
)
