"""How the body loads the table: what each cell bears of the weight W.

A push above the table's height and the edge of the table shift these loads.

At rest on the table the cells bear N_i0 = m_i g, with their center at the center of mass c.
Friction F, which acts at the table's height against a force at height h, moves the center that
equilibrium asks for; beyond the edge nothing is borne (sigma_i, the fraction of a cell on the
table). Of all loads in equilibrium, those nearest to N_i0 sigma_i,

    min_N  sum_i N_i log(N_i / (N_i0 sigma_i))
    s.t.   sum N_i = W,    sum N_i p_i = W p*,    p* = c + h F / W

are an exponential tilt, N_i = W w_i with

    w_i = m_i sigma_i exp(b·p_i) / S,    S = sum_j m_j sigma_j exp(b·p_j)
    sum_i w_i p_i + delta(b) = p*

where delta, nothing to speak of while a cell s is small against 1/|b|, lets the center come up to
the edges of the outermost squares, and not only to their middles:

    delta_a = s/2 phi(b_a s/2),    phi(x) = eps x / sqrt(1 + x²) + (1 - eps) x⁵ / (1 + |x|⁵)
    p_bar = sum_i w_i p_i,    A = sum_i w_i (p_i - p_bar)(p_i - p_bar)^T + diag(s²/4 phi'(b_a s/2))

The left side is the gradient of a convex function of b, so Newton's method finds it. Where p* is
outside what bears, there is none: the body tips. F is the friction of the step before: in the same
step it would be the same but for O(dt).

With k_i = mu_i W w_i what the cell's friction carries, f_i = dg/dk_i and G0 = sum f_i k_i, G1 = sum
f_i k_i (p_i - p_bar)^T, the friction's force varies at a given twist by

    db = A^-1 [dp* - sum_i w_i (p_i - p_bar)(dlog m_i + dlog sigma_i)]
    df = sum_i f_i k_i (dlog mu_i + dlog m_i + dlog sigma_i)
         + G0 (dlog W - sum_i w_i (dlog m_i + dlog sigma_i)) + G1 db
    dp* = dc + h dF / W + F dh / W - (p* - c) dlog W
"""

from math import exp, sqrt
from typing import Any, NamedTuple

import numpy as np

from gridpush_drake.dynamics.kernels.compiled import kernel
from gridpush_drake.dynamics.kernels.friction.laws import renew

_NEWTON_LIMIT = 60
"""Most iterations of the search for the tilt b."""

_TOLERANCE = 1e-13
"""How near the center of the loads must come to p*, as a fraction of the cells' reach."""

_LONGEST_STEP = 2.0
"""Longest step of b in an iteration, times the cells' reach: exp(b·p) then stays in proportion."""

_STEEPEST = 200.0
"""Steepest tilt that is tried, |b| times the cells' reach. Beyond it no loads are looked for."""

_SAME_GAP = 1e-15
"""Two gaps between lines of cells that differ by no more than this count as the same, m."""

_FRACTION = 0.01
"""eps in phi. It keeps A regular where the cells stand in one line."""


class Support(NamedTuple):
    """What the loads depend on.

    Attributes:
        active: whether loads shift at all; otherwise every cell bears its own weight.
        mass, friction: (n,) m_i, kg, and mu_i.
        weight: W, N.
        com_x, com_y: c, m.
        height: h, m.
        reach: of the cells' centers from B's origin, m.
        xs, ys: the x and the y that occur among the cells, m.
        column, row: (n,) which of them are each cell's.
        table: (K, 4) edges of the table's top, (ax, ay, bx, by) in W, counterclockwise, m; none
            where it is endless.
    """

    active: bool
    mass: Any
    friction: Any
    weight: float
    com_x: float
    com_y: float
    height: float
    reach: float
    xs: Any
    ys: Any
    column: Any
    row: Any
    table: Any


class Loads(NamedTuple):
    """The loads of a step, and how they vary; body frame.

    Attributes:
        exp_x, exp_y: workspace, exp of b along the cells' xs and ys.
        fraction: (n,) w_i / m_i, 1/kg.
        slope: (n, 3) d sigma_i by the pose seen from the body, times w_i / sigma_i.
        tilt: (2,) b, 1/m.
        friction: (2,) F, N.
        shift: (2,) F / W of the step before.
        center: (2,) p*, m.
        mean: (2,) p_bar, m.
        inverse: (2, 2) A^-1, 1/m².
        by_pose: (3, 3) df by the pose seen from the body.
        by_force: (3, 2) df by F.
        by_tilt: (3, 2) G1.
        total: (3,) G0.
        H: (2, 3) first two rows of the friction's Hessian.
    """

    exp_x: Any
    exp_y: Any
    fraction: Any
    slope: Any
    tilt: Any
    friction: Any
    shift: Any
    center: Any
    mean: Any
    inverse: Any
    by_pose: Any
    by_force: Any
    by_tilt: Any
    total: Any
    H: Any


@kernel()
def make_loads(support):
    """Makes room for the loads of all cells."""
    n = support.mass.shape[0]
    return Loads(
        exp_x=np.zeros(support.xs.shape[0]),
        exp_y=np.zeros(support.ys.shape[0]),
        fraction=np.zeros(n),
        slope=np.zeros((n, 3)),
        tilt=np.zeros(2),
        friction=np.zeros(2),
        shift=np.zeros(2),
        center=np.zeros(2),
        mean=np.zeros(2),
        inverse=np.zeros((2, 2)),
        by_pose=np.zeros((3, 3)),
        by_force=np.zeros((3, 2)),
        by_tilt=np.zeros((3, 2)),
        total=np.zeros(3),
        H=np.zeros((2, 3)),
    )


@kernel(allocates=False)
def shift_loads(law, cells, cell_size, support, state, loads, record, t):
    """Lets a law know what the cells bear in step t, and records its center, and whether it tips.

    Args:
        law: of the body; its k is changed.
        record: with `load_centers` and `tips`.
        t: number of the step.
        cells, cell_size, support, state, loads: as of `find_loads`.
    """
    held = find_loads(support, cells, cell_size, state, loads, law.k)
    renew(law)
    center = loads.center
    record.load_centers[t, 0] = state.x + state.c * center[0] - state.s * center[1]
    record.load_centers[t, 1] = state.y + state.s * center[0] + state.c * center[1]
    record.tips[t] = not held


@kernel(allocates=False)
def find_loads(support, cells, cell_size, state, loads, k):
    """Calculates what the cells bear.

    Args:
        support: `Support`.
        cells: (2, n) cell centers, m.
        cell_size: m.
        state: `State`, where the body is.
        loads: `Loads`; tilt and friction of the step before in, fraction, slope, tilt, center, mean
            and inverse out.
        k: (n,) out: the friction each cell can carry, N.

    Returns:
        Whether there are such loads: False where the body tips. `k` is then that of the steepest
        tilt tried.
    """
    n = cells.shape[1]
    mass = support.mass
    reach = support.reach
    fraction = loads.fraction
    slope = loads.slope
    center = loads.center

    # sigma_i, in `fraction` until the tilt is known.
    near = _fill_covered_fractions(support.table, cells, cell_size, reach, state, fraction, slope)

    # p* = c + h F / W, and the tilt that puts the loads' center there.
    weight = support.weight
    loads.shift[0] = loads.friction[0] / weight
    loads.shift[1] = loads.friction[1] / weight
    center_x = support.com_x + support.height * loads.shift[0]
    center_y = support.com_y + support.height * loads.shift[1]
    _predict_tilt(loads, center_x - center[0], center_y - center[1], reach)
    center[0] = center_x
    center[1] = center_y
    found, S = _find_tilt(support, cells, cell_size, loads)
    if support.table.shape[0] > 0:
        # smoothed as the edge is, cells just beyond it might bear: their center may not lie there
        x = state.x + state.c * center[0] - state.s * center[1]
        y = state.y + state.s * center[0] + state.c * center[1]
        found = found and measure_depth(support.table, x, y)[0] > 0.0

    # w_i / m_i, and k_i = mu_i W w_i; the slope of sigma_i becomes that of log sigma_i times w_i.
    scale = 1.0 / S if S > 0.0 else 0.0
    for i in range(n):
        across = scale * loads.exp_x[support.column[i]] * loads.exp_y[support.row[i]]
        if near:
            for j in range(3):
                slope[i, j] *= mass[i] * across
        fraction[i] *= across
        k[i] = support.friction[i] * weight * mass[i] * fraction[i]
    return found


@kernel(allocates=False)
def _fill_covered_fractions(table, cells, cell_size, reach, state, covered, slope):
    """Fills in sigma_i, the fraction of each cell that is on the table, and its slope.

    It rises from 0 to 1 as the cell's center comes inside the edge, over the cell's size.

    Args:
        table, cells, cell_size, reach, state: as in `find_loads`.
        covered: (n,) filled with sigma_i.
        slope: (n, 3) filled with its derivatives by the pose seen from the body, where the table
            has an edge.

    Returns:
        Whether the edge is so near that any cell may hang over it.
    """
    n = cells.shape[1]
    covered[:] = 1.0
    near = False
    if table.shape[0] > 0:
        slope[:, :] = 0.0
        inside, nx, ny = measure_depth(table, state.x, state.y)
        near = inside < reach + cell_size
        if near:
            for i in range(n):
                px = cells[0, i]
                py = cells[1, i]
                x = state.x + state.c * px - state.s * py
                y = state.y + state.s * px + state.c * py
                depth, nx, ny = measure_depth(table, x, y)
                covered[i] = min(max(0.5 + depth / cell_size, 0.0), 1.0)
                if 0.0 < covered[i] < 1.0:
                    # the inward direction of the edge in the body frame, and its moment
                    bx = state.c * nx + state.s * ny
                    by = -state.s * nx + state.c * ny
                    slope[i, 0] = bx / cell_size
                    slope[i, 1] = by / cell_size
                    slope[i, 2] = (px * by - py * bx) / cell_size
    return near


@kernel(allocates=False)
def measure_depth(table, x, y):
    """Measures how far a point is inside the table's edge.

    Args:
        table: (K, 4) edges of the table's top, (ax, ay, bx, by), counterclockwise, m.
        x, y: the point, m.

    Returns:
        The distance, m, negative beyond the edge, and the direction (two numbers) in which it
        grows.
    """
    nearest = np.inf
    inside = on_edge = False
    nx = ny = 0.0
    for e in range(table.shape[0]):
        ax = table[e, 0]
        ay = table[e, 1]
        bx = table[e, 2]
        by = table[e, 3]
        ex = bx - ax
        ey = by - ay
        rx = x - ax
        ry = y - ay
        # a ray from the point crosses the outline an odd number of times where it is inside
        if (ay > y) != (by > y) and rx < ry * ex / ey:
            inside = not inside
        along = (rx * ex + ry * ey) / (ex * ex + ey * ey)
        clipped = min(max(along, 0.0), 1.0)
        rx -= clipped * ex
        ry -= clipped * ey
        distance2 = rx * rx + ry * ry
        if distance2 < nearest:
            nearest = distance2
            on_edge = along == clipped
            # on an edge its inward normal, at a corner the way from there to the point
            if on_edge:
                nx = -ey
                ny = ex
            else:
                nx = rx
                ny = ry
    size = sqrt(nx * nx + ny * ny)
    if not (on_edge or inside):
        size = -size
    distance = sqrt(nearest)
    return (distance if inside else -distance), nx / size, ny / size


@kernel(allocates=False)
def _predict_tilt(loads, dx, dy, reach):
    """Moves the last step's b by A^-1 dp*, dp* = (dx, dy), where that is little.

    A^-1 is zero before the first step.
    """
    inverse = loads.inverse
    tilt = loads.tilt
    step_x = inverse[0, 0] * dx + inverse[0, 1] * dy
    step_y = inverse[1, 0] * dx + inverse[1, 1] * dy
    if (abs(step_x) + abs(step_y)) * reach < _LONGEST_STEP:
        tilt[0] += step_x
        tilt[1] += step_y


@kernel(allocates=False)
def _find_tilt(support, cells, cell_size, loads):
    """Finds the tilt b by Newton's method, from that of the last step.

    Returns:
        Whether it exists, and S at the last b tried.
    """
    reach = support.reach
    exp_x = loads.exp_x
    exp_y = loads.exp_y
    center = loads.center
    tilt = loads.tilt
    mean = loads.mean
    inverse = loads.inverse
    S = 0.0
    half = cell_size / 2.0
    # exp of how far from p*, or from the cells where p* is so far beyond them that exp would
    # overflow: w is the same
    from_x = min(max(center[0], -reach), reach)
    from_y = min(max(center[1], -reach), reach)
    for _ in range(_NEWTON_LIMIT):
        b0 = tilt[0]
        b1 = tilt[1]
        _fill_exponentials(support.xs, b0, from_x, exp_x)
        _fill_exponentials(support.ys, b1, from_y, exp_y)
        S, sx, sy, sxx, sxy, syy = _sum_moments(support, cells, loads)
        if not S > 0.0:
            break  # no cell is on the table

        # p_bar - p*, A, and delta(b)
        sx = sx / S
        sy = sy / S
        delta_x, bend_x = _calc_phi(b0 * half)
        delta_y, bend_y = _calc_phi(b1 * half)
        xx = sxx / S - sx * sx + half * half * bend_x
        yy = syy / S - sy * sy + half * half * bend_y
        xy = sxy / S - sx * sy
        det = xx * yy - xy * xy
        mean[0] = sx + center[0]
        mean[1] = sy + center[1]
        inverse[0, 0] = yy / det
        inverse[1, 1] = xx / det
        inverse[0, 1] = inverse[1, 0] = -xy / det

        # Newton's step on p_bar + delta(b) = p*, no longer than exp can follow.
        off_x = -(sx + half * delta_x)
        off_y = -(sy + half * delta_y)
        if abs(off_x) + abs(off_y) <= _TOLERANCE * reach:
            return True, S
        step_x = inverse[0, 0] * off_x + inverse[0, 1] * off_y
        step_y = inverse[1, 0] * off_x + inverse[1, 1] * off_y
        length = sqrt(step_x * step_x + step_y * step_y) * reach
        if length > _LONGEST_STEP:
            step_x = step_x * _LONGEST_STEP / length
            step_y = step_y * _LONGEST_STEP / length
        b0 = b0 + step_x
        b1 = b1 + step_y
        if not (sqrt(b0 * b0 + b1 * b1) * reach < _STEEPEST):
            break
        tilt[0] = b0
        tilt[1] = b1
    return False, S


@kernel(allocates=False)
def _fill_exponentials(lines, b, origin, values):
    """Fills in exp(b (x - origin)) for lines of cells at x, which increase.

    Lines that are equally far apart share a factor, so that few exponentials are needed.
    """
    values[0] = exp(b * (lines[0] - origin))
    gap = 0.0
    factor = 1.0
    for i in range(1, lines.shape[0]):
        step = lines[i] - lines[i - 1]
        if abs(step - gap) > _SAME_GAP:
            gap = step
            factor = exp(b * step)
        values[i] = values[i - 1] * factor


@kernel(allocates=False, fast_sums=True)
def _sum_moments(support, cells, loads):
    """Sums m_i sigma_i exp(b·p_i), up to a factor, times 1, x, y, x², x y and y².

    (x, y) = p_i - p*.
    """
    mass = support.mass
    column = support.column
    row = support.row
    covered = loads.fraction
    exp_x = loads.exp_x
    exp_y = loads.exp_y
    cx = loads.center[0]
    cy = loads.center[1]
    px = cells[0]
    py = cells[1]
    S = sx = sy = sxx = sxy = syy = 0.0
    for i in range(px.shape[0]):
        x = px[i] - cx
        y = py[i] - cy
        w = mass[i] * covered[i] * exp_x[column[i]] * exp_y[row[i]]
        S += w
        sx += w * x
        sy += w * y
        sxx += w * x * x
        sxy += w * x * y
        syy += w * y * y
    return S, sx, sy, sxx, sxy, syy


@kernel(allocates=False)
def _calc_phi(x):
    """Calculates phi(x) and its derivative."""
    root = sqrt(1.0 + x * x)
    fourth = x * x * x * x
    whole = 1.0 + abs(x) * fourth
    value = _FRACTION * x / root + (1.0 - _FRACTION) * x * fourth / whole
    slope = _FRACTION / (root * root * root) + (1.0 - _FRACTION) * 5.0 * fourth / (whole * whole)
    return value, slope


@kernel(allocates=False, fast_sums=True)
def fill_load_columns(support, cells, loads, k, Q, n_other):
    """Turns f_i = dg/dk_i in rows 6-8 of Q into df by each m_i.

    Where Q has columns for them, df by h and by each mu_i are filled in, too.

    Args:
        support: `Support`.
        cells: (2, n) cell centers, m.
        loads: `Loads`; by_pose, by_force, by_tilt and total are filled.
        k: (n,) the step's, N.
        Q: (11, width) see `forward_sensitivity`; rows 6-8 hold f_i in the first n columns.
        n_other: columns between those of the masses and h.
    """
    n = cells.shape[1]
    mass = support.mass
    mu = support.friction
    G0 = loads.total
    G1 = loads.by_tilt
    inverse = loads.inverse
    mean = loads.mean
    center = loads.center
    by_pose = loads.by_pose
    by_force = loads.by_force
    by_pose[:, :] = 0.0
    weight = support.weight
    px = cells[0]
    py = cells[1]

    # G0 = sum f_i k_i and G1 = sum f_i k_i (p_i - p_bar)^T
    for j in range(3):
        f = Q[6 + j]
        total = 0.0
        by_x = 0.0
        by_y = 0.0
        for i in range(n):
            force = f[i] * k[i]
            total += force
            by_x += force * (px[i] - mean[0])
            by_y += force * (py[i] - mean[1])
        G0[j] = total
        G1[j, 0] = by_x
        G1[j, 1] = by_y
    # G1 A^-1: the force by the center of the loads
    for j in range(3):
        a = G1[j, 0]
        b = G1[j, 1]
        G1[j, 0] = a * inverse[0, 0] + b * inverse[1, 0]
        G1[j, 1] = a * inverse[0, 1] + b * inverse[1, 1]
        by_force[j, 0] = G1[j, 0] * support.height / weight
        by_force[j, 1] = G1[j, 1] * support.height / weight

    # df by the pose: sigma_i changes the load of its cell, and by S and p_bar those of all.
    for i in range(n if support.table.shape[0] > 0 else 0):
        arm_x = cells[0, i] - mean[0]
        arm_y = cells[1, i] - mean[1]
        for j in range(3):
            # df by w_i sigma_i' at a given twist
            force = mu[i] * weight * Q[6 + j, i] - G0[j] - G1[j, 0] * arm_x - G1[j, 1] * arm_y
            for m in range(3):
                by_pose[j, m] += force * loads.slope[i, m]

    # df by h: p* moves by F / W.
    shift_x = center[0] - support.com_x
    shift_y = center[1] - support.com_y
    width = Q.shape[1]
    whole = mass.sum()
    frictions = n + n_other + 1
    if width > n + n_other:
        h = n + n_other
        for j in range(3):
            Q[6 + j, h] = G1[j, 0] * loads.shift[0] + G1[j, 1] * loads.shift[1]

    # df by mu_i, then by m_i, which moves W, c and w_i.
    one = 1.0 / whole
    fraction = loads.fraction
    for j in range(3):
        f = Q[6 + j]
        total = G0[j]
        by_x = G1[j, 0]
        by_y = G1[j, 1]
        if width > frictions:
            by_friction = f[frictions:]
            for i in range(n):
                by_friction[i] = f[i] * weight * mass[i] * fraction[i]
        for i in range(n):
            w = fraction[i]
            dx = (px[i] - support.com_x - shift_x) * one - w * (px[i] - mean[0])
            dy = (py[i] - support.com_y - shift_y) * one - w * (py[i] - mean[1])
            f[i] = f[i] * mu[i] * weight * w + total * (one - w) + by_x * dx + by_y * dy


@kernel(allocates=False, fast_sums=True)
def add_load_variations(loads, Q):
    """Adds to the forces in rows 6-8 of Q what the pose (rows 0-2) and F (rows 9-10) do to them.

    The sum of them, x and y, then stands in the rows of F, where the step is to be added.
    """
    P = loads.by_pose
    R = loads.by_force
    s0 = Q[0]
    s1 = Q[1]
    s2 = Q[2]
    F0 = Q[9]
    F1 = Q[10]
    for j in range(3):
        p0 = P[j, 0]
        p1 = P[j, 1]
        p2 = P[j, 2]
        r0 = R[j, 0]
        r1 = R[j, 1]
        f = Q[6 + j]
        for c in range(f.shape[0]):
            f[c] += p0 * s0[c] + p1 * s1[c] + p2 * s2[c] + r0 * F0[c] + r1 * F1[c]
    for j in range(2):
        F = Q[9 + j]
        f = Q[6 + j]
        for c in range(f.shape[0]):
            F[c] = f[c]
