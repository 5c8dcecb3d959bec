"""The pose update of one step, x' = x + R d, theta' = theta + w dt, and its derivative.

Quasi-static: d = V(w dt) u dt, the body turns about its instantaneous center (exact for a constant
twist). Inertial: d = dt R(a) v_com + c - R(w dt) c, the center of mass moves straight (exact for
free flight).

The twist (u, w) is that of the body turned by the angle a, which in the inertial regime is how far
it is expected to have turned halfway through the step, so that v_com = R(a)^T R^T v_com,W.
"""

from math import cos, sin
from typing import Any, NamedTuple

from gridpush_drake.dynamics.kernels.compiled import kernel

_SMALL_ANGLE = 1e-4


class PoseMaps(NamedTuple):
    """How variations pass through the displacement of a step, (3, 3) each.

    s' = A s + G dxi for the variation of the pose seen from the body, and v' = L dxi for that of
    the velocity of the center of mass with the yaw rate, both in the new body frame, at constant a.
    """

    A: Any
    G: Any
    L: Any


@kernel(allocates=False)
def calc_displacement_maps(xi, dt, inertial, a, cx, cy, maps):
    """Calculates the displacement of a step, and how variations pass through it.

    Args:
        xi: (3,) twist.
        dt: s.
        inertial: the regime.
        a: angle of the frame of the twist, rad.
        cx, cy: center of mass, body frame, m; zero in the quasi-static regime.
        maps: `PoseMaps` out.

    Returns:
        d (two numbers, m, in the old body frame) and the velocity of (cx, cy) (two numbers, m/s, in
        the new one).
    """
    A, G, L = maps
    ux, uy, w = xi[0], xi[1], xi[2]
    phi = w * dt
    c, s = cos(phi), sin(phi)
    A[2, 0] = A[2, 1] = G[2, 0] = G[2, 1] = L[2, 0] = L[2, 1] = 0.0
    A[2, 2], G[2, 2], L[2, 2] = 1.0, dt, 1.0
    if inertial:
        com_x, com_y = ux - w * cy, uy + w * cx
        ca, sa = cos(a), sin(a)
        d0 = dt * (ca * com_x - sa * com_y) + cx - (c * cx - s * cy)
        d1 = dt * (sa * com_x + ca * com_y) + cy - (s * cx + c * cy)
        # from the frame of the twist to the new body frame
        cb, sb = c * ca + s * sa, s * ca - c * sa
        new_x, new_y = cb * com_x + sb * com_y, -sb * com_x + cb * com_y
        turned_x, turned_y = -cb * cy + sb * cx, sb * cy + cb * cx
        G[0, 0], G[0, 1], G[0, 2] = dt * cb, dt * sb, dt * (turned_x + cy)
        G[1, 0], G[1, 1], G[1, 2] = -dt * sb, dt * cb, dt * (turned_y - cx)
        L[0, 0], L[0, 1], L[0, 2] = cb, sb, turned_x + dt * new_y
        L[1, 0], L[1, 1], L[1, 2] = -sb, cb, turned_y - dt * new_x
    else:
        new_x, new_y = ux, uy
        if abs(phi) < _SMALL_ANGLE:
            sinc, cosc = 1.0 - phi * phi / 6.0, phi / 2.0 - phi * phi * phi / 24.0
            sinc_slope, cosc_slope = -phi / 3.0 + phi * phi * phi / 30.0, 0.5 - phi * phi / 8.0
        else:
            sinc, cosc = s / phi, (1.0 - c) / phi
            sinc_slope, cosc_slope = (c - sinc) / phi, (s - cosc) / phi
        d0 = dt * (sinc * ux - cosc * uy)
        d1 = dt * (cosc * ux + sinc * uy)
        g02, g12 = (
            dt * dt * (sinc_slope * ux - cosc_slope * uy),
            dt * dt * (cosc_slope * ux + sinc_slope * uy),
        )
        G[0, 0], G[0, 1], G[0, 2] = (
            dt * (c * sinc + s * cosc),
            dt * (s * sinc - c * cosc),
            c * g02 + s * g12,
        )
        G[1, 0], G[1, 1], G[1, 2] = (
            dt * (c * cosc - s * sinc),
            dt * (c * sinc + s * cosc),
            c * g12 - s * g02,
        )
        L[0, 0], L[0, 1], L[0, 2] = 1.0, 0.0, 0.0
        L[1, 0], L[1, 1], L[1, 2] = 0.0, 1.0, 0.0
    A[0, 0], A[0, 1], A[0, 2] = c, s, -c * d1 + s * d0
    A[1, 0], A[1, 1], A[1, 2] = -s, c, s * d1 + c * d0
    return d0, d1, new_x, new_y
