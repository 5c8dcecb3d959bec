"""The exact derivative of one converged step, by the implicit function theorem.

Differentiating the step's equations F(xi, lam; z) = 0 at fixed modes gives K d(xi, lam) = -dF, with
K as built in `contact_modes.build_contact_system`. The contact enters by the disc's center twice: t
at the beginning of the step gives the gap, and t_m, where the disc is expected halfway through it,
the contact's place and directions. In the body frame, with alpha = T·dt_m,

    dN = -bend alpha T,   dT = bend alpha N,   dgap = -(gx, gy)·dt
    dc = alpha T on an edge, 0 at a vertex
"""

from math import cos, sin
from typing import Any, NamedTuple

from gridpush_drake.dynamics.kernels.compiled import kernel
from gridpush_drake.dynamics.kernels.contact.contact import BEND, CX, CY, GX, GY, NX, NY
from gridpush_drake.dynamics.kernels.contact.contact_modes import (
    SEPARATE,
    SLIDE_PLUS,
    STICK,
    build_contact_system,
    relax_jam,
)
from gridpush_drake.dynamics.kernels.small_matrix import solve_dense

T_X, T_Y, AHEAD_X, AHEAD_Y, V_X, V_Y, FRICTION = range(7)
"""What a step depends on through its contacts: t, t_m, the pusher's velocity v_p, and mu_c."""


class StepDerivative(NamedTuple):
    """The derivative of a step by what acts on it.

    Attributes:
        F: workspace (7, 7).
        Y: (3, 3) d xi / d(-F_1): response to a generalized force.
        D: (3, 7) d xi / d(t, t_m, v_p, mu_c).
        E: (3, 8) d xi / d(t, v_p, (u, w), mu_c) at the beginning of the step.
    """

    F: Any
    Y: Any
    D: Any
    E: Any


@kernel(allocates=False)
def calc_step_derivative(H, touch, compliance, unknowns, K, X, derivative):
    """Differentiates a converged step: fills `derivative.Y` and `.D`.

    Args:
        H, touch, compliance: as the step used them.
        unknowns: the solution.
        K, X: workspace (7, 7), each.
        derivative: `StepDerivative` out.

    Returns:
        False where the modes leave the step without a derivative.
    """
    contacts, count, vpx, vpy, _, dt = touch
    xi, lam, modes = unknowns
    F = derivative.F
    Y = derivative.Y
    D = derivative.D
    size = build_contact_system(H, touch, modes, compliance, K)
    F[:size, :] = 0.0
    force_x = F[0]
    force_y = F[1]
    moment = F[2]
    row = 3
    for c in range(count):
        mode = modes[c]
        if mode == SEPARATE:
            continue
        nx = contacts[c, NX]
        ny = contacts[c, NY]
        cx = contacts[c, CX]
        cy = contacts[c, CY]
        bend = contacts[c, BEND]

        # How the rows J_n = (N, c × N) and J_t = (T, c × T) vary with alpha = T·dt_m. At a vertex
        # the normal turns by -bend alpha; on an edge the contact point moves along by alpha.
        tx = -ny
        ty = nx
        c_cross_n = cx * ny - cy * nx
        c_cross_t = cx * ty - cy * tx
        dn0 = -bend * tx
        dn1 = -bend * ty
        dn2 = -bend * c_cross_t
        if bend == 0.0:
            dn2 = -1.0
        dt0 = bend * nx
        dt1 = bend * ny
        dt2 = bend * c_cross_n

        # The balance of forces, rows 0 to 2: -dJ_n^T lam_n - dJ_t^T lam_t.
        f0 = -(dn0 * lam[c, 0] + dt0 * lam[c, 1])
        f1 = -(dn1 * lam[c, 0] + dt1 * lam[c, 1])
        f2 = -(dn2 * lam[c, 0] + dt2 * lam[c, 1])
        force_x[AHEAD_X] += f0 * tx
        force_x[AHEAD_Y] += f0 * ty
        force_y[AHEAD_X] += f1 * tx
        force_y[AHEAD_Y] += f1 * ty
        moment[AHEAD_X] += f2 * tx
        moment[AHEAD_Y] += f2 * ty

        # The normal row: J_n xi - N·v_p + gap/dt, whose gap is that at the beginning of the step.
        asked = F[row]
        along = dn0 * xi[0] + dn1 * xi[1] + dn2 * xi[2] - dn0 * vpx - dn1 * vpy
        asked[T_X] = -contacts[c, GX] / dt
        asked[T_Y] = -contacts[c, GY] / dt
        asked[AHEAD_X] = along * tx
        asked[AHEAD_Y] = along * ty
        asked[V_X] = -nx
        asked[V_Y] = -ny
        row += 1
        if mode == STICK:
            # The tangential row: J_t xi - T·v_p.
            asked = F[row]
            along = dt0 * xi[0] + dt1 * xi[1] + dt2 * xi[2] - dt0 * vpx - dt1 * vpy
            asked[AHEAD_X] = along * tx
            asked[AHEAD_Y] = along * ty
            asked[V_X] = -tx
            asked[V_Y] = -ty
            row += 1
        else:
            # Sliding: lam_t = ± mu_c lam_n, so mu_c acts on the balance of forces.
            slide = lam[c, 0] if mode == SLIDE_PLUS else -lam[c, 0]
            force_x[FRICTION] -= slide * tx
            force_y[FRICTION] -= slide * ty
            moment[FRICTION] -= slide * c_cross_t

    # Y are the first rows of K^-1, and D = -K^-1 F.
    if size == 7:
        relax_jam(contacts, F, 7)
    X[:size, :size] = 0.0
    for i in range(size):
        X[i, i] = 1.0
    if not solve_dense(K, X, size, size):
        return False
    for i in range(3):
        for j in range(3):
            Y[i, j] = X[i, j]
        for j in range(7):
            total = 0.0
            for m in range(size):
                total -= X[i, m] * F[m, j]
            D[i, j] = total
    return True


@kernel(allocates=False)
def calc_input_derivative(first, start, derivative):
    """Differentiates a step by what it is given at its beginning, through `contact.look_ahead`.

    With tdot = v_p - u - w z × t the disc's motion seen from the body that moves with the expected
    twist (u, w), with N_0 and T_0 the directions of the contact at the beginning, and R(a), a = h
    w, the turn expected until halfway,

        t_m = t + h T_0 (T_0·tdot),    v_p,m = R(a)^T v_p,

        dt_m = (1 + h bend_0 (N_0 (T_0·tdot) + T_0 (N_0·tdot)) T_0^T) dt + h T_0 T_0^T dtdot

    Args:
        first: (9,) the first contact at the beginning, a row of `contact`.
        start: `StepStart`.
        derivative: its D from `calc_step_derivative`; its E is filled.
    """
    D = derivative.D
    E = derivative.E
    n0x = first[NX]
    n0y = first[NY]
    bend0 = first[BEND]
    h = start.h
    w = start.yaw_rate
    tx = start.tx
    ty = start.ty
    rx = start.rx
    ry = start.ry
    vpx = start.vpx
    vpy = start.vpy
    t0x = -n0y
    t0y = n0x
    along = t0x * rx + t0y * ry
    across = n0x * rx + n0y * ry
    # dt_m/dt, besides the identity: as t moves along T_0 the directions of the look ahead turn.
    bx = h * bend0 * (n0x * along + t0x * across)
    by = h * bend0 * (n0y * along + t0y * across)
    ca = cos(start.a)
    sa = sin(start.a)
    for i in range(3):
        step = D[i]
        out = E[i]
        mx = step[AHEAD_X]
        my = step[AHEAD_Y]
        vx = step[V_X]
        vy = step[V_Y]
        bent = mx * bx + my * by
        slid = h * (mx * t0x + my * t0y)
        # d xi / d tdot is slid T_0^T; tdot depends on t by -w z × t
        out[0] = step[T_X] + mx + bent * t0x - slid * w * t0y
        out[1] = step[T_Y] + my + bent * t0y + slid * w * t0x
        out[2] = slid * t0x + vx * ca - vy * sa
        out[3] = slid * t0y + vx * sa + vy * ca
        out[4] = -slid * t0x
        out[5] = -slid * t0y
        out[6] = -slid * (t0y * tx - t0x * ty) + h * (vx * vpy - vy * vpx)
        out[7] = step[FRICTION]
