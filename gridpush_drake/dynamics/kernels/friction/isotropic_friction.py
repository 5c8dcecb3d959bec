"""Isotropic Coulomb friction with maximal dissipation, at every cell.

`docs/theory/model.md`, section 3, derives it.

With v_i = u + w z × p_i the velocity of cell i in the body frame,

    Psi(xi) = sum_i k_i s_i + K_spin |w|,      s_i = sqrt(|v_i|² + (kappa w)² + eps²)

* "separate" spin: kappa = 0, K_spin = sum_i k_i c s, and |w| smoothed as sqrt(w² + eps²) with the
  same number eps. Sliding and spinning of a cell are independent, as in the paper's LCP with its
  two rows a cell.
* "coupled" spin (the default): kappa = c s, K_spin = 0. The mean of |v_i + w z × r| over the points
  r of a square cell is |v_i| where it slides fast and c s |w| where it only spins; s_i has both
  limits and errs by O(s²) in between, where the sum of the two errs by O(s): a finer grid then
  changes nothing but the resolution.
* "none": kappa = K_spin = 0, point feet.

c = (sqrt 2 + asinh 1)/6 is the mean distance of a unit square's points from its center; eps the
stiction tolerance. With a_i = d(s_i²/2)/dxi and G_i = da_i/dxi,

    dPsi/dxi       = sum_i k_i a_i/s_i
    d²Psi/dxi²     = sum_i k_i (G_i - a_i a_i^T/s_i²)/s_i
    d²Psi/dxi dk_i = a_i/s_i

Of an object with thousands of cells, those that are far from the center of rotation may be replaced
by few points that are loaded almost alike (`pooled_loads`).
"""

from math import sqrt
from typing import Any, NamedTuple

import numpy as np

from gridpush_drake.dynamics.kernels.compiled import kernel
from gridpush_drake.dynamics.kernels.friction.friction_law import FrictionLaw
from gridpush_drake.dynamics.kernels.friction.pooled_loads import (
    NO_POOL,
    forget_points,
    gather_points,
)


class Isotropic(NamedTuple):
    """The law of one object.

    Attributes:
        k: (n,) friction each cell can carry, N.
        spin: (3,) kappa² (m²), the spin load K_spin (N m) and the spin arm (m) by which k_i enters
            it.
        pool: `pooled_loads.Pool`; without boxes where every cell is summed by itself.
    """

    k: Any
    spin: Any
    pool: Any


def make_isotropic(k, arm, spin):
    """Makes the law of an object; arguments as of `FrictionLaw.make`."""
    coupled = spin == "coupled"
    separate = spin == "separate"
    kappa2 = arm**2 if coupled else 0.0
    spin_load = k.sum() * arm if separate else 0.0
    spin_lever_arm = arm if separate else 0.0
    return Isotropic(k=k, spin=np.array([kappa2, spin_load, spin_lever_arm]), pool=NO_POOL)


@kernel(allocates=False, fast_sums=True, inlined=True)
def accumulate_isotropic(px, py, k, kappa2, eps2, ux, uy, w):
    """Sums over the cells what gradient and Hessian of Psi are made of, in one pass.

    With a_i = d(s_i²/2)/dxi, the gradient is sum k_i a_i / s_i and the Hessian sum k_i (G_i - a_i
    a_i^T / s_i²) / s_i.

    Returns:
        A0, Ax, Ay, A2 = sum k_i/s_i (1, px, py, |p|² + kappa²), and B = sum k_i/s_i³ a a^T: xx, xy,
        xw, yy, yw, ww.
    """
    A0 = Ax = Ay = A2 = 0.0
    Bxx = Bxy = Bxw = Byy = Byw = Bww = 0.0
    spin2 = kappa2 * w * w + eps2
    spin1 = kappa2 * w
    for i in range(px.shape[0]):
        x = px[i]
        y = py[i]
        # v_i = u + w z × p_i, and k_i / s_i
        vx = ux - w * y
        vy = uy + w * x
        inverse2 = 1.0 / (vx * vx + vy * vy + spin2)
        load = k[i] * sqrt(inverse2)
        az = x * vy - y * vx + spin1
        A0 += load
        Ax += load * x
        Ay += load * y
        A2 += load * (x * x + y * y + kappa2)
        # now k_i / s_i³
        load *= inverse2
        Bxx += load * vx * vx
        Bxy += load * vx * vy
        Bxw += load * vx * az
        Byy += load * vy * vy
        Byw += load * vy * az
        Bww += load * az * az
    return A0, Ax, Ay, A2, Bxx, Bxy, Bxw, Byy, Byw, Bww


@kernel(allocates=False, inlined=True)
def add_isotropic(px, py, k, kappa2, spin_load, eps, xi, majorize, g, H):
    """Adds gradient and Hessian of Psi at `xi` to g (3,) and H (3, 3).

    With `majorize` the Hessian is sum k_i G_i / s_i, the quadratic that touches Psi at xi from
    above: slower, but a step with it always descends.
    """
    ux = xi[0]
    uy = xi[1]
    w = xi[2]
    A0, Ax, Ay, A2, Bxx, Bxy, Bxw, Byy, Byw, Bww = accumulate_isotropic(
        px, py, k, kappa2, eps * eps, ux, uy, w
    )
    g[0] += ux * A0 - w * Ay
    g[1] += uy * A0 + w * Ax
    g[2] += uy * Ax - ux * Ay + w * A2
    # The touching quadratic is without the part that is subtracted.
    if majorize:
        Bxx = Bxy = Bxw = Byy = Byw = Bww = 0.0
    # The separate spin's K_spin sqrt(w² + eps²).
    spin_bend = 0.0
    if spin_load > 0.0:
        spin_speed = sqrt(w * w + eps * eps)
        g[2] += spin_load * w / spin_speed
        spin_bend = spin_load / spin_speed
        if not majorize:
            spin_bend *= (eps / spin_speed) ** 2
    add_symmetric(H, 1.0, A0 - Bxx, -Bxy, -Ay - Bxw, A0 - Byy, Ax - Byw, A2 - Bww + spin_bend)


@kernel(allocates=False, fast_sums=True)
def fill_cell_forces(px, py, spin, eps2, xi, f):
    """Fills f (3, >= n) with dg/dk_i: a_i / s_i.

    To its last row the separate spin adds c s w / |w|.

    Args:
        px, py: (n,) cell centers, m.
        spin: (3,) of `Isotropic`.
        eps2: stiction tolerance squared, m²/s².
        xi: (3,) twist.
        f: (3, >= n) out.
    """
    kappa2 = spin[0]
    ux = xi[0]
    uy = xi[1]
    w = xi[2]
    spin_torque = spin[2] * w / sqrt(w * w + eps2)
    f0 = f[0]
    f1 = f[1]
    f2 = f[2]
    for i in range(px.shape[0]):
        x = px[i]
        y = py[i]
        vx = ux - w * y
        vy = uy + w * x
        inverse = 1.0 / sqrt(vx * vx + vy * vy + kappa2 * w * w + eps2)
        f0[i] = vx * inverse
        f1[i] = vy * inverse
        f2[i] = (x * vy - y * vx + kappa2 * w) * inverse + spin_torque


@kernel(allocates=False, inlined=True)
def add_symmetric(H, scale, xx, xy, xw, yy, yw, ww):
    """Adds scale times a symmetric matrix, given by its upper triangle, to H (3, 3)."""
    H[0, 0] += scale * xx
    H[0, 1] += scale * xy
    H[1, 0] += scale * xy
    H[0, 2] += scale * xw
    H[2, 0] += scale * xw
    H[1, 1] += scale * yy
    H[1, 2] += scale * yw
    H[2, 1] += scale * yw
    H[2, 2] += scale * ww


@kernel(allocates=False)
def calc_isotropic_dissipation(k, spin, cells, eps, xi):
    """Calculates Psi; `k` and `spin` as in `Isotropic`."""
    ux = xi[0]
    uy = xi[1]
    w = xi[2]
    kappa2 = spin[0]
    spin_load = spin[1]
    total = spin_load * sqrt(w * w + eps * eps)
    for i in range(k.shape[0]):
        vx = ux - w * cells[1, i]
        vy = uy + w * cells[0, i]
        total += k[i] * sqrt(vx * vx + vy * vy + kappa2 * w * w + eps * eps)
    return total


@kernel(allocates=False)
def renew_spin_load(law):
    """Calculates K_spin anew from k, which loads that shift have changed."""
    if law.spin[2] > 0.0:
        total = 0.0
        for i in range(law.k.shape[0]):
            total += law.k[i]
        law.spin[1] = law.spin[2] * total


@kernel(allocates=False, inlined=True)
def _begin_push(law):
    """Lets no push be summed over points that were gathered for another one."""
    forget_points(law.pool)


@kernel(allocates=False, inlined=True)
def _begin_step(law, cells, com_x, com_y, cell_size, expected_velocity, force_acceleration, known):
    """Isotropic friction does not ask how the body moved."""


@kernel(allocates=False)
def _calc_dissipation(law, cells, eps, xi):
    """Calculates Psi, of all cells by themselves."""
    return calc_isotropic_dissipation(law.k, law.spin, cells, eps, xi)


@kernel(allocates=False, inlined=True)
def _add_derivatives(law, cells, eps, xi, majorize, g, H):
    """Adds gradient and Hessian, see `add_isotropic`."""
    px = cells[0]
    py = cells[1]
    k = law.k
    pool = law.pool
    if pool.boxes.shape[0] > 0:
        count = gather_points(pool, xi)
        px = pool.points[0, :count]
        py = pool.points[1, :count]
        k = pool.points[2, :count]
    add_isotropic(px, py, k, law.spin[0], law.spin[1], eps, xi, majorize, g, H)


@kernel(allocates=False, inlined=True)
def _can_majorize(law):
    """Every sum of norms has a quadratic that touches it from above."""
    return True


@kernel(allocates=False)
def _fill_load_derivatives(law, cells, eps, xi, f):
    """Fills in f_i, see `fill_cell_forces`."""
    fill_cell_forces(cells[0], cells[1], law.spin, eps * eps, xi, f)


ISOTROPIC_LAW = FrictionLaw(
    name="isotropic",
    data=Isotropic,
    make=make_isotropic,
    renew=renew_spin_load,
    begin_step=_begin_step,
    calc_dissipation=_calc_dissipation,
    add_derivatives=_add_derivatives,
    can_majorize=_can_majorize,
    fill_load_derivatives=_fill_load_derivatives,
    gradients=(False, True, "paper"),
    begin_push=_begin_push,
)
