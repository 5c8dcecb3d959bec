"""The paper's closed-form gradient of many steps, cell by cell (`paper_rollout` has the equations)."""

from math import sqrt

import numpy as np

from gridpush_drake.dynamics.compiled import kernel
from gridpush_drake.dynamics.lagged import SPEED_AT_REST, YAW_RATE_AT_REST


@kernel()
def fill_paper_gradient(cells, mass, friction, inertia, kappa2, spin_arm, before, after, impulse, response, dm, dmu):
    """Fills in the derivatives of R steps.

    Args:
        cells: (2, n) cell centres p_BC, m.
        mass, friction: (n,) m_i, kg, and mu_i.
        inertia: of a cell about its centre over its mass, m².
        kappa2, spin_arm: the spin model: kappa² (m²) of the coupled one, c s (m) of the separate one; else zero.
        before, after: (R, 3) twists, in the frames of the steps.
        impulse: (R,) g dt, N s/kg.
        response: (R, 3, 3) from an impulse in that frame to the pose's displacement in W.
        dm, dmu: (R, 3, n) filled, by m_i and mu_i.
    """
    px, py = cells[0], cells[1]
    n = px.shape[0]
    row_m, row_mu = np.empty((3, n)), np.empty((3, n))
    for r in range(before.shape[0]):
        ux, uy, w = before[r, 0], before[r, 1], before[r, 2]
        ux1, uy1, w1 = after[r, 0], after[r, 1], after[r, 2]
        dx, dy, dw = ux1 - ux, uy1 - uy, w1 - w
        w_own = w if abs(w) > YAW_RATE_AT_REST else w1
        spins = abs(w_own) > YAW_RATE_AT_REST and w_own * w1 > 0.0
        spin = spin_arm * np.sign(w_own) if spins else 0.0
        for i in range(n):
            x, y = px[i], py[i]
            vx, vy, wi = ux - w * y, uy + w * x, w
            vx1, vy1 = ux1 - w1 * y, uy1 + w1 * x
            size = sqrt(vx * vx + vy * vy + kappa2 * wi * wi)
            if size <= SPEED_AT_REST:
                vx, vy, wi = vx1, vy1, w1
                size = sqrt(vx * vx + vy * vy + kappa2 * wi * wi)
            slides = size > SPEED_AT_REST and vx * vx1 + vy * vy1 + kappa2 * wi * w1 > 0.0
            inverse = impulse[r] / size if slides else 0.0
            fx, fy = vx * inverse, vy * inverse
            fw = x * fy - y * fx + kappa2 * wi * inverse + spin * impulse[r]
            momentum_x, momentum_y = dx - dw * y, dy + dw * x
            row_mu[0, i], row_mu[1, i], row_mu[2, i] = mass[i] * fx, mass[i] * fy, mass[i] * fw
            row_m[0, i] = momentum_x + friction[i] * fx
            row_m[1, i] = momentum_y + friction[i] * fy
            row_m[2, i] = x * momentum_y - y * momentum_x + inertia * dw + friction[i] * fw
        for j in range(3):
            a, b, c = response[r, j, 0], response[r, j, 1], response[r, j, 2]
            for i in range(n):
                dm[r, j, i] = a * row_m[0, i] + b * row_m[1, i] + c * row_m[2, i]
                dmu[r, j, i] = a * row_mu[0, i] + b * row_mu[1, i] + c * row_mu[2, i]
