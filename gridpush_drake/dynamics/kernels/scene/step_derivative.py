"""The exact derivative of a converged step of several bodies, by the implicit function theorem.

At fixed modes the step's equations are K (xi, lam) = F(z), with z all that the step starts from.
Their derivative has the matrix of `contact_problem`,

    H dxi - E dlam = dF_wrench,    C dxi + compliance dlam = -dF_velocity

whose right-hand sides are those of `contact_terms`. The columns of the whole push, one for each
parameter, are then carried over the step: s = (dx, dtheta) in W and the twist's variation, body by
body.

Inputs of a step, in this order: poses (W) and twists (body frame) of the N bodies, place,
velocity, yaw and angular velocity of the pusher, N frictions with the pusher, those of the P pairs
(i, j), i < j, and the sum of all k, by which contacts are soft.

Columns of the push: k of all M cells | N frictions with the pusher | P of pairs | start x, start y,
direction, length | the variations of the path that `PusherPath` names | first poses.

Where the loads of one body shift (`support_loads`), its cells' columns are those of m_1..m_n, and
after the first pose there is one for h and, where they are wanted, n for mu_1..mu_n. The friction F
with the table is then carried along as in `forward_sensitivity`.
"""

from typing import Any, NamedTuple

import numpy as np

from gridpush_drake.dynamics.kernels.compiled import kernel
from gridpush_drake.dynamics.kernels.contact.contact_modes import SEPARATE, SLIDE_PLUS, STICK
from gridpush_drake.dynamics.kernels.forward_sensitivity import F_ROW
from gridpush_drake.dynamics.kernels.friction.laws import fill_load_derivatives
from gridpush_drake.dynamics.kernels.scene.body_laws import take_law
from gridpush_drake.dynamics.kernels.scene.contact_rows import PAIR_COMPLIANCE, calc_compliance
from gridpush_drake.dynamics.kernels.scene.contact_system import (
    build_contact_matrix,
    solve_banded,
)
from gridpush_drake.dynamics.kernels.scene.contact_terms import (
    APPROACH_OUTPUT,
    INPUT_COUNT,
    OTHER_POSE,
    OTHER_TWIST,
    OTHER_WRENCH,
    OUTPUT_COUNT,
    POSE_INPUT,
    SLIP_OUTPUT,
    TIP_INPUT,
    TIP_RATE,
    TIP_VELOCITY,
    TIP_YAW,
    TWIST_INPUT,
    WRENCH_OUTPUT,
    calc_contact_terms,
)
from gridpush_drake.dynamics.kernels.scene.contacts import (
    OVERLAP_RECOVERY,
    calc_place,
    find_fastest_vertex,
)
from gridpush_drake.dynamics.kernels.scene.records import (
    FIRST_BODY,
    OTHER_CX,
    OTHER_CY,
    OTHER_NX,
    OTHER_NY,
    ROW_CX,
    ROW_CY,
    ROW_GAP,
    ROW_NX,
    ROW_NY,
    SECOND_BODY,
)
from gridpush_drake.dynamics.kernels.support_loads import add_load_variations, fill_load_columns

_DELTA = 1e-30
"""Imaginary step of the derivatives. Its square vanishes beside every number here."""

_BOUNDED = 1e-9
"""Share by which an overlap may be less than the bound and still be bounded, for round-off."""

PUSH_COLUMNS = 4
"""Columns of the push: start x, start y, direction, length."""

TIP_COUNT = INPUT_COUNT - TIP_INPUT
"""Inputs of a step that say where the pusher is and how it moves."""


class Derivative(NamedTuple):
    """The derivative of a step and of the push so far, for N bodies and R contacts.

    Attributes:
        F: (3N, inputs + 3N) wrenches' derivatives; then dxi by every input, and by a generalized
            force on every body.
        V: (2R+N, inputs + 3N) velocities' derivatives, workspace.
        S: (6N, width) variations of the poses, and of the twists.
        next_S: workspace of its shape.
        f: (3, M) the cells' forces for one newton each.
        z, out: complex workspace of `contact_terms`.
        G: (N, 3, 3) the displacement's derivative by the twist, in the new body frame.
        A: (3, 3) workspace.
        Q: (11, width) of `support_loads`: rows 0-2 the pose's variations seen from the body, rows
            6-8 the force of each column, 9-10 F; used where loads shift.
    """

    F: Any
    V: Any
    S: Any
    next_S: Any
    f: Any
    z: Any
    out: Any
    G: Any
    A: Any
    Q: Any


@kernel()
def make_derivative(n, cells, room, width):
    """Makes the workspace for n bodies of so many cells in all, and `width` columns."""
    inputs = count_inputs(n)
    return Derivative(
        F=np.zeros((3 * n, inputs + 3 * n)),
        V=np.zeros((2 * room + n, inputs + 3 * n)),
        S=np.zeros((6 * n, width)),
        next_S=np.zeros((3 * n, width)),
        f=np.zeros((3, cells)),
        z=np.zeros(INPUT_COUNT, np.complex128),
        out=np.zeros(OUTPUT_COUNT, np.complex128),
        G=np.zeros((n, 3, 3)),
        A=np.zeros((3, 3)),
        Q=np.zeros((F_ROW + 2, width)),
    )


@kernel(allocates=False)
def count_frictions(n):
    """Counts the frictions of n bodies with the pusher, and of their pairs."""
    return n + (n * (n - 1)) // 2


@kernel(allocates=False)
def count_inputs(n):
    """Counts the inputs of a step of n bodies."""
    return 6 * n + TIP_COUNT + count_frictions(n) + 1


@kernel(allocates=False)
def find_pair(i, j, n):
    """Numbers the pairs (i, j), i < j, of n bodies: (0, 1), (0, 2), ..., (1, 2), ..."""
    low = min(i, j)
    high = max(i, j)
    return low * n - (low * (low + 1)) // 2 + high - low - 1


@kernel(allocates=False)
def fill_step_derivative(
    bodies, state, motion, contacts, h, dt, scales, xi, awake, work, derivative
):
    """Fills in dxi by every input of a step; zeros where the step has no derivative.

    Args:
        bodies, state, motion: as the step saw them.
        contacts: `Contacts` with the solution.
        h, dt: the time after which the step looks at the bodies, and the step, s.
        scales: `SceneScales`.
        xi: (N, 3) twists of the solution.
        awake: (N,) which bodies take part.
        work: `ContactWork` with S^-1 at the solution.
        derivative: `Derivative`; its F is filled.
    """
    n = xi.shape[0]
    inputs = count_inputs(n)
    columns = inputs + 3 * n
    F = derivative.F
    V = derivative.V
    # A generalized force on every body, besides what the inputs do.
    for row in range(3 * n):
        for column in range(columns):
            F[row, column] = 0.0
    for b in range(n):
        if awake[b]:
            for a in range(3):
                F[3 * b + a, inputs + 3 * b + a] = 1.0

    compliance = calc_compliance(contacts, scales)
    size = build_contact_matrix(contacts, compliance, work)
    for row in range(size):
        for column in range(columns):
            V[row, column] = 0.0
    for r in range(contacts.counts[0]):
        if contacts.modes[r] != SEPARATE:
            row = work.place[r]
            _add_contact(bodies, state, motion, contacts, r, row, h, dt, scales, xi, derivative)
            # All contacts are the harder, the more the cells can carry together.
            lam = contacts.lam[r]
            soft = compliance[0 if contacts.ids[r, SECOND_BODY] < 0 else 1] / scales.load
            V[row, inputs - 1] -= soft * lam[0]
            if contacts.modes[r] == STICK:
                V[row + 1, inputs - 1] -= soft * lam[1]

    # First the response without contacts, S^-1 F, then that of the contact forces.
    for b in range(n):
        inverse = work.inverse[b]
        for column in range(columns):
            x = F[3 * b, column]
            y = F[3 * b + 1, column]
            z = F[3 * b + 2, column]
            for a in range(3):
                value = inverse[a, 0] * x + inverse[a, 1] * y + inverse[a, 2] * z
                F[3 * b + a, column] = value if awake[b] else 0.0
    for p in range(size):
        i = work.ends[work.used[p], 0]
        j = work.ends[work.used[p], 1]
        C = work.rows[work.used[p]]
        for column in range(columns):
            value = -V[p, column]
            for a in range(3):
                value -= C[a] * F[3 * i + a, column]
                if j >= 0:
                    value -= C[3 + a] * F[3 * j + a, column]
            V[p, column] = value
    # The contact forces' derivatives, and with them the twists'.
    if not solve_banded(work.W, V, work.right, size, columns):
        for row in range(3 * n):
            for column in range(columns):
                F[row, column] = 0.0
        return
    for p in range(size):
        i = work.ends[work.used[p], 0]
        j = work.ends[work.used[p], 1]
        response = work.responses[p]
        for a in range(3):
            for column in range(columns):
                F[3 * i + a, column] += response[a] * V[p, column]
            if j >= 0:
                for column in range(columns):
                    F[3 * j + a, column] += response[3 + a] * V[p, column]


@kernel(allocates=False)
def _add_contact(bodies, state, motion, contacts, r, row, h, dt, scales, xi, derivative):
    """Adds the derivatives of a contact's wrenches to F, and of its velocities to rows of V."""
    n = xi.shape[0]
    ids = contacts.ids[r]
    i = ids[FIRST_BODY]
    j = ids[SECOND_BODY]
    mode = contacts.modes[r]
    z = derivative.z
    out = derivative.out
    V = derivative.V
    for a in range(3):
        z[POSE_INPUT + a] = state.q[i, a]
        z[TWIST_INPUT + a] = state.twist[i, a]
        if j >= 0:
            z[OTHER_POSE + a] = state.q[j, a]
            z[OTHER_TWIST + a] = state.twist[j, a]
    z[TIP_INPUT] = motion.x
    z[TIP_INPUT + 1] = motion.y
    z[TIP_VELOCITY] = motion.vx
    z[TIP_VELOCITY + 1] = motion.vy
    z[TIP_YAW] = motion.yaw
    z[TIP_RATE] = motion.rate
    for k in range(INPUT_COUNT):
        # which of the step's inputs the contact's is
        if k < OTHER_POSE:
            column = 3 * i + k if k < TWIST_INPUT else 3 * n + 3 * i + k - TWIST_INPUT
        elif k < TIP_INPUT:
            if j < 0:
                continue
            place = k - OTHER_POSE
            column = 3 * j + place if place < 3 else 3 * n + 3 * j + place - 3
        else:
            if j >= 0:
                continue
            column = 6 * n + k - TIP_INPUT
        value = z[k]
        z[k] = value + 1j * _DELTA
        calc_contact_terms(
            z,
            bodies,
            ids,
            contacts.numbers[r],
            motion.tool,
            h,
            dt,
            xi,
            contacts.lam[r],
            out,
        )
        z[k] = value
        for a in range(3):
            derivative.F[3 * i + a, column] += out[WRENCH_OUTPUT + a].imag / _DELTA
            if j >= 0:
                derivative.F[3 * j + a, column] += out[OTHER_WRENCH + a].imag / _DELTA
        V[row, column] += out[APPROACH_OUTPUT].imag / _DELTA
        if mode == STICK:
            V[row + 1, column] += out[SLIP_OUTPUT].imag / _DELTA
    if j >= 0 or not scales.disc:
        _add_pusher_speed(motion, contacts, r, n, row, dt, scales, V)
    if mode != STICK:
        # Sliding: lam_t = ± mu lam_n, so the friction coefficient acts on the wrenches.
        slide = contacts.lam[r, 0] if mode == SLIDE_PLUS else -contacts.lam[r, 0]
        _add_friction(contacts.numbers[r], i, j, n, slide, derivative.F)


@kernel(allocates=False)
def _add_pusher_speed(motion, contacts, r, n, row, dt, scales, V):
    """Adds to rows of V what the pusher's speed does to a contact that gives way by it.

    The compliance goes with it, and of two bodies the overlap that is undone in a step.
    """
    speed, vertex = find_fastest_vertex(motion)
    if speed == 0.0:
        return
    lam = contacts.lam[r]
    softness = PAIR_COMPLIANCE / scales.load
    normal = softness * lam[0]
    tangential = softness * lam[1]
    bound = -(1.0 - _BOUNDED) * OVERLAP_RECOVERY * speed * dt
    if contacts.ids[r, SECOND_BODY] >= 0 and contacts.numbers[r, ROW_GAP] <= bound:
        normal -= OVERLAP_RECOVERY
    # The speed's derivatives by velocity, yaw and angular velocity.
    px = motion.tool.core.ax[vertex]
    py = motion.tool.core.ay[vertex]
    _, _, vx, vy = calc_place(motion, px, py)
    vx /= speed
    vy /= speed
    vc = motion.turn_vc
    vs = motion.turn_vs
    next_c = motion.turn_c + vc * dt
    next_s = motion.turn_s + vs * dt
    # of the vertex's arm: its mean change, and itself when the step ends
    change_x = vc * px - vs * py
    change_y = vs * px + vc * py
    arm_x = next_c * px - next_s * py
    arm_y = next_s * px + next_c * py
    by_yaw = vy * change_x - vx * change_y
    by_rate = vy * arm_x - vx * arm_y
    columns = 6 * n - TIP_INPUT
    for k, factor in (
        (TIP_VELOCITY, vx),
        (TIP_VELOCITY + 1, vy),
        (TIP_YAW, by_yaw),
        (TIP_RATE, by_rate),
    ):
        V[row, columns + k] += normal * factor
        if contacts.modes[r] == STICK:
            V[row + 1, columns + k] += tangential * factor


@kernel(allocates=False)
def _add_friction(numbers, i, j, n, slide, F):
    """Adds a sliding contact's derivative by its friction coefficient to F."""
    column = 6 * n + TIP_COUNT + (i if j < 0 else n + find_pair(i, j, n))
    fx = -slide * numbers[ROW_NY]
    fy = slide * numbers[ROW_NX]
    F[3 * i, column] += fx
    F[3 * i + 1, column] += fy
    F[3 * i + 2, column] += numbers[ROW_CX] * fy - numbers[ROW_CY] * fx
    if j >= 0:
        fx = slide * numbers[OTHER_NY]
        fy = -slide * numbers[OTHER_NX]
        F[3 * j, column] += fx
        F[3 * j + 1, column] += fy
        F[3 * j + 2, column] += numbers[OTHER_CX] * fy - numbers[OTHER_CY] * fx


@kernel(allocates=False)
def start_columns(bodies, pusher, S):
    """Fills in the variations at the beginning: every pose varies by itself.

    Args:
        bodies: `BodyArrays`.
        pusher: `PusherPath`.
        S: (6N, width) zeros.
    """
    n = S.shape[0] // 6
    first = _count_before_poses(bodies, pusher)
    for row in range(3 * n):
        S[row, first + row] = 1.0


@kernel(allocates=False)
def _count_before_poses(bodies, pusher):
    """Counts the columns before those of the first poses."""
    n = bodies.cell_size.shape[0]
    variations = PUSH_COLUMNS + pusher.variations.shape[0]
    return bodies.first_cell[n] + count_frictions(n) + variations


@kernel(allocates=False)
def step_columns(bodies, support, state, pusher, motion, t, eps, xi, dt, shift, loads, derivative):
    """Carries every column over one step.

    Args:
        bodies: `BodyArrays`.
        support: `Support`.
        state: `SceneState` at the step's beginning.
        pusher: `PusherPath`.
        motion: `ToolMotion` of the step.
        t: number of the step.
        eps: stiction tolerance, m/s.
        xi: (N, 3) twists of the step.
        dt: the step, s.
        shift: (N, 2) the displacements of the step, W, m.
        loads: `Loads` of the step.
        derivative: `Derivative`; its S is carried on.
    """
    n = xi.shape[0]
    F = derivative.F
    S = derivative.S
    dxi = derivative.next_S
    width = S.shape[1]
    inputs = count_inputs(n)
    cells = bodies.first_cell[n]
    frictions = count_frictions(n)

    # What all columns have in common: dxi by the poses and twists at the beginning.
    for row in range(3 * n):
        out = dxi[row]
        for column in range(width):
            out[column] = 0.0
        for k in range(6 * n):
            factor = F[row, k]
            if factor == 0.0:
                continue
            variation = S[k]
            for column in range(width):
                out[column] += factor * variation[column]

    # The cells: each acts on its own body by the force -f.
    if support.active:
        others = _count_before_poses(bodies, pusher) + 3 - cells
        _add_shifting_loads(bodies, support, state, eps, xi, loads, others, derivative)
    for b in range(0 if support.active else n):
        first = bodies.first_cell[b]
        last = bodies.first_cell[b + 1]
        forces = derivative.f[:, first:last]
        law, places = take_law(bodies, b)
        fill_load_derivatives(law, places, eps, xi[b], forces)
        for row in range(3 * n):
            y0 = F[row, inputs + 3 * b]
            y1 = F[row, inputs + 3 * b + 1]
            y2 = F[row, inputs + 3 * b + 2]
            by_load = F[row, inputs - 1]
            if y0 == 0.0 and y1 == 0.0 and y2 == 0.0 and by_load == 0.0:
                continue
            out = dxi[row]
            for i in range(last - first):
                by_force = y0 * forces[0, i] + y1 * forces[1, i] + y2 * forces[2, i]
                out[first + i] += by_load - by_force

    # The frictions of the contacts, and the pusher's path.
    tip = 6 * n
    ray_x = motion.x - pusher.tip[0, 0]
    ray_y = motion.y - pusher.tip[0, 1]
    for row in range(3 * n):
        out = dxi[row]
        for k in range(frictions):
            out[cells + k] += F[row, tip + TIP_COUNT + k]
        at_push = cells + frictions
        fx = F[row, tip]
        fy = F[row, tip + 1]
        fvx = F[row, tip + 2]
        fvy = F[row, tip + 3]
        out[at_push] += fx
        out[at_push + 1] += fy
        # to turn the path about its start turns the pusher with it
        out[at_push + 2] += -ray_y * fx + ray_x * fy - motion.vy * fvx + motion.vx * fvy
        out[at_push + 2] += F[row, tip + TIP_YAW - TIP_INPUT]
        if pusher.path_length > 0.0:
            # a longer path in the same time stretches places and velocities alike
            stretch = ray_x * fx + ray_y * fy + motion.vx * fvx + motion.vy * fvy
            out[at_push + 3] += stretch / pusher.path_length
        for d in range(pusher.variations.shape[0]):
            now = pusher.variations[d, t]
            after = pusher.variations[d, t + 1]
            change = now[0] * fx + now[1] * fy
            change += now[2] * F[row, tip + TIP_YAW - TIP_INPUT]
            # and how the velocities vary with it
            change += (after[0] - now[0]) / dt * fvx
            change += (after[1] - now[1]) / dt * fvy
            change += (after[2] - now[2]) / dt * F[row, tip + TIP_RATE - TIP_INPUT]
            out[at_push + PUSH_COLUMNS + d] += change

    # x' = x + R d and theta' = theta + w dt; the twist's variation is dxi itself.
    for b in range(n):
        angle = state.q[b, 2] + xi[b, 2] * dt
        c = np.cos(angle)
        s = np.sin(angle)
        G = derivative.G[b]
        for column in range(width):
            u = dxi[3 * b, column]
            v = dxi[3 * b + 1, column]
            w = dxi[3 * b + 2, column]
            gx = G[0, 0] * u + G[0, 1] * v + G[0, 2] * w
            gy = G[1, 0] * u + G[1, 1] * v + G[1, 2] * w
            turned = S[3 * b + 2, column]
            S[3 * b, column] += c * gx - s * gy - turned * shift[b, 1]
            S[3 * b + 1, column] += s * gx + c * gy + turned * shift[b, 0]
            S[3 * b + 2, column] += dt * w
    for row in range(3 * n):
        for column in range(width):
            S[3 * n + row, column] = dxi[row, column]
    # F' = H2 dxi + f, and f stands there already
    for row in range(2 if support.active else 0):
        H = loads.H[row]
        friction = derivative.Q[F_ROW + row]
        for column in range(width):
            for i in range(3):
                friction[column] += H[i] * dxi[i, column]


@kernel(allocates=False)
def _add_shifting_loads(bodies, support, state, eps, xi, loads, others, derivative):
    """Adds to the twist's variations what the loads of one body do, which shift with its pose.

    Args:
        bodies, support, state, eps, xi, loads: as of `step_columns`.
        others: columns between those of the masses and h.
        derivative: `Derivative`; the twist's variations, in next_S, are added to.
    """
    F = derivative.F
    S = derivative.S
    Q = derivative.Q
    c = state.turn[0, 0]
    s = state.turn[0, 1]
    law, cells = take_law(bodies, 0)
    n = cells.shape[1]
    width = S.shape[1]
    for column in range(width):
        Q[0, column] = c * S[0, column] + s * S[1, column]
        Q[1, column] = c * S[1, column] - s * S[0, column]
        Q[2, column] = S[2, column]
        for row in range(6, F_ROW):
            Q[row, column] = 0.0
    fill_load_derivatives(law, cells, eps, xi[0], Q[6:F_ROW, :n])
    fill_load_columns(support, cells, loads, law.k, Q, others)
    add_load_variations(loads, Q)
    inputs = count_inputs(1)
    by_friction = n + others + 1
    for row in range(3):
        out = derivative.next_S[row]
        y0 = F[row, inputs]
        y1 = F[row, inputs + 1]
        y2 = F[row, inputs + 2]
        for column in range(width):
            out[column] -= y0 * Q[6, column] + y1 * Q[7, column] + y2 * Q[8, column]
        # and by the sum of all m_i mu_i g
        by_load = F[row, inputs - 1] * support.weight / support.mass.sum()
        for i in range(n):
            out[i] += by_load * support.friction[i]
        for i in range(width - by_friction):
            out[by_friction + i] += by_load * support.mass[i]
