"""Support friction: the dissipation of n cells as a convex function of the body's twist.

With xi = (ux, uy, w) the twist of the body in its own frame, v_i = u + w z × p_i the velocity of cell i and
k_i = mu_i m_i g the friction it can carry, the isotropic dissipation is

    Psi(xi) = sum_i k_i s_i + K_spin |w|,      s_i = sqrt(|v_i|² + (kappa w)² + eps²)

* "separate" spin (design note, section 3): kappa = 0, K_spin = sum_i k_i c s. Sliding and spinning of a cell are
  independent, as in the paper's LCP with its two rows a cell.
* "coupled" spin (the default): kappa = c s, K_spin = 0. The mean of |v_i + w z × r| over the points r of a square cell
  is |v_i| where it slides fast and c s |w| where it only spins; s_i has both limits and errs by O(s²) in between,
  where the sum of the two errs by O(s): a finer grid then changes nothing but the resolution.
* "none": kappa = K_spin = 0, point feet.

c = (sqrt 2 + asinh 1)/6 is the mean distance of a unit square's points from its centre; eps the stiction tolerance.

The paper's lagged direction replaces |v_i| by max(0, d_i·v_i) with d_i the direction of the cell's current velocity.
"""

from math import asinh, sqrt

from gridpush_drake.dynamics.compiled import kernel

SPIN_ARM = (sqrt(2) + asinh(1)) / 6
"""c: mean distance of a unit square's points from its centre."""

SPIN_MODELS = ("coupled", "separate", "none")


@kernel(fast_sums=True)
def accumulate_isotropic(px, py, k, kappa2, eps2, ux, uy, w):
    """Sums over the cells what gradient and Hessian of Psi are made of, in one pass.

    With a_i = d(s_i²/2)/dxi, the gradient is sum k_i a_i / s_i and the Hessian sum k_i (G_i - a_i a_i^T / s_i²) / s_i.

    Returns:
        A0, Ax, Ay, A2 = sum k_i/s_i (1, px, py, |p|² + kappa²), and B = sum k_i/s_i³ a a^T: xx, xy, xw, yy, yw, ww.
    """
    A0 = Ax = Ay = A2 = 0.0
    Bxx = Bxy = Bxw = Byy = Byw = Bww = 0.0
    spin2 = kappa2 * w * w + eps2
    spin1 = kappa2 * w
    for i in range(px.shape[0]):
        x, y = px[i], py[i]
        vx = ux - w * y
        vy = uy + w * x
        inverse2 = 1.0 / (vx * vx + vy * vy + spin2)
        load = k[i] * sqrt(inverse2)
        az = x * vy - y * vx + spin1
        A0 += load
        Ax += load * x
        Ay += load * y
        A2 += load * (x * x + y * y + kappa2)
        load *= inverse2
        Bxx += load * vx * vx
        Bxy += load * vx * vy
        Bxw += load * vx * az
        Byy += load * vy * vy
        Byw += load * vy * az
        Bww += load * az * az
    return A0, Ax, Ay, A2, Bxx, Bxy, Bxw, Byy, Byw, Bww


@kernel()
def add_isotropic(px, py, k, kappa2, spin_load, eps, xi, majorize, g, H):
    """Adds gradient and Hessian of Psi at `xi` to g (3,) and H (3, 3).

    With `majorize` the Hessian is sum k_i G_i / s_i, the quadratic that touches Psi at xi from above: slower, but a
    step with it always descends.
    """
    ux, uy, w = xi[0], xi[1], xi[2]
    A0, Ax, Ay, A2, Bxx, Bxy, Bxw, Byy, Byw, Bww = accumulate_isotropic(px, py, k, kappa2, eps * eps, ux, uy, w)
    g[0] += ux * A0 - w * Ay
    g[1] += uy * A0 + w * Ax
    g[2] += uy * Ax - ux * Ay + w * A2
    if majorize:
        Bxx = Bxy = Bxw = Byy = Byw = Bww = 0.0
    spin_bend = 0.0
    if spin_load > 0.0:
        spin_speed = sqrt(w * w + eps * eps)
        g[2] += spin_load * w / spin_speed
        spin_bend = spin_load / spin_speed
        if not majorize:
            spin_bend *= (eps / spin_speed) ** 2
    _add_symmetric(H, 1.0, A0 - Bxx, -Bxy, -Ay - Bxw, A0 - Byy, Ax - Byw, A2 - Bww + spin_bend)


@kernel()
def add_lagged(px, py, k, dx, dy, spin_load, spin_sign, eps, xi, g, H):
    """Adds gradient and Hessian of the paper's lagged dissipation at `xi` to g (3,) and H (3, 3).

    max(0, z) is smoothed as (z + sqrt(z² + eps²))/2, z = d_i·v_i(xi); (dx, dy) are the lagged unit directions d_i in
    the body frame and spin_sign the sign of the current yaw rate (zero where undefined).
    """
    ux, uy, w = xi[0], xi[1], xi[2]
    for i in range(px.shape[0]):
        row0, row1 = dx[i], dy[i]
        row2 = px[i] * dy[i] - py[i] * dx[i]
        slope, bend = _smooth_ramp(row0 * ux + row1 * uy + row2 * w, eps)
        load = k[i] * slope
        g[0] += load * row0
        g[1] += load * row1
        g[2] += load * row2
        load = k[i] * bend
        _add_symmetric(
            H, load, row0 * row0, row0 * row1, row0 * row2, row1 * row1, row1 * row2, row2 * row2
        )  # fmt: skip
    slope, bend = _smooth_ramp(spin_sign * w, eps)
    g[2] += spin_load * slope * spin_sign
    H[2, 2] += spin_load * bend * spin_sign * spin_sign


@kernel()
def _smooth_ramp(z, eps):
    """Slope and curvature of (z + sqrt(z² + eps²))/2."""
    root = sqrt(z * z + eps * eps)
    return 0.5 * (1.0 + z / root), 0.5 * eps * eps / (root * root * root)


@kernel()
def _add_symmetric(H, scale, xx, xy, xw, yy, yw, ww):
    H[0, 0] += scale * xx
    H[0, 1] += scale * xy
    H[1, 0] += scale * xy
    H[0, 2] += scale * xw
    H[2, 0] += scale * xw
    H[1, 1] += scale * yy
    H[1, 2] += scale * yw
    H[2, 1] += scale * yw
    H[2, 2] += scale * ww
