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
"""Turn in a step below which sin(phi)/phi and the like are taken from their series, rad."""


_SERIES_ANGLE = 0.05
"""Angle up to which the series of `calc_turn` are exact to rounding, rad."""


@kernel(allocates=False, inlined=True)
def calc_turn(angle):
    """Calculates cosine and sine of an angle, by their series where it is as small as in a step."""
    if not abs(angle) < _SERIES_ANGLE:
        return cos(angle), sin(angle)
    x = angle * angle
    # the next terms are below 1e-19 of what is there
    c = 1.0 - x / 2.0 * (1.0 - x / 12.0 * (1.0 - x / 30.0 * (1.0 - x / 56.0)))
    s = angle * (1.0 - x / 6.0 * (1.0 - x / 20.0 * (1.0 - x / 42.0 * (1.0 - x / 72.0))))
    return c, s


class PoseMaps(NamedTuple):
    """How variations pass through the displacement of a step, (3, 3) each.

    s' = A s + G dxi for the variation of the pose seen from the body, and v' = L dxi for that of
    the velocity of the center of mass with the yaw rate, both in the new body frame, at constant a.
    """

    A: Any
    G: Any
    L: Any


@kernel(allocates=False, inlined=True)
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
    ux = xi[0]
    uy = xi[1]
    w = xi[2]
    phi = w * dt
    c, s = calc_turn(phi)
    A[2, 0] = A[2, 1] = G[2, 0] = G[2, 1] = L[2, 0] = L[2, 1] = 0.0
    A[2, 2] = 1.0
    G[2, 2] = dt
    L[2, 2] = 1.0
    if inertial:
        # v_com in the frame of the twist; it goes straight for dt, while B turns about it.
        com_x = ux - w * cy
        com_y = uy + w * cx
        ca, sa = calc_turn(a)
        d0 = dt * (ca * com_x - sa * com_y) + cx - (c * cx - s * cy)
        d1 = dt * (sa * com_x + ca * com_y) + cy - (s * cx + c * cy)
        # from the frame of the twist to the new body frame
        cb = c * ca + s * sa
        sb = s * ca - c * sa
        new_x = cb * com_x + sb * com_y
        new_y = -sb * com_x + cb * com_y
        turned_x = -cb * cy + sb * cx
        turned_y = sb * cy + cb * cx
        # G and L: by the twist, in the new body frame, where the turn itself moves what is seen.
        G[0, 0] = dt * cb
        G[0, 1] = dt * sb
        G[0, 2] = dt * (turned_x + cy)
        G[1, 0] = -dt * sb
        G[1, 1] = dt * cb
        G[1, 2] = dt * (turned_y - cx)
        L[0, 0] = cb
        L[0, 1] = sb
        L[0, 2] = turned_x + dt * new_y
        L[1, 0] = -sb
        L[1, 1] = cb
        L[1, 2] = turned_y - dt * new_x
    else:
        # V(phi) = [[sinc, -cosc], [cosc, sinc]], and its slopes by phi
        new_x = ux
        new_y = uy
        if abs(phi) < _SMALL_ANGLE:
            sinc = 1.0 - phi * phi / 6.0
            cosc = phi / 2.0 - phi * phi * phi / 24.0
            sinc_slope = -phi / 3.0 + phi * phi * phi / 30.0
            cosc_slope = 0.5 - phi * phi / 8.0
        else:
            sinc = s / phi
            cosc = (1.0 - c) / phi
            sinc_slope = (c - sinc) / phi
            cosc_slope = (s - cosc) / phi
        d0 = dt * (sinc * ux - cosc * uy)
        d1 = dt * (cosc * ux + sinc * uy)
        g02 = dt * dt * (sinc_slope * ux - cosc_slope * uy)
        g12 = dt * dt * (cosc_slope * ux + sinc_slope * uy)
        G[0, 0] = dt * (c * sinc + s * cosc)
        G[0, 1] = dt * (s * sinc - c * cosc)
        G[0, 2] = c * g02 + s * g12
        G[1, 0] = dt * (c * cosc - s * sinc)
        G[1, 1] = dt * (c * sinc + s * cosc)
        G[1, 2] = c * g12 - s * g02
        # the velocity of B's origin is u itself
        L[0, 0] = 1.0
        L[0, 1] = 0.0
        L[0, 2] = 0.0
        L[1, 0] = 0.0
        L[1, 1] = 1.0
        L[1, 2] = 0.0
    # A: the old pose's variation, seen from the new body frame
    A[0, 0] = c
    A[0, 1] = s
    A[0, 2] = -c * d1 + s * d0
    A[1, 0] = -s
    A[1, 1] = c
    A[1, 2] = s * d1 + c * d0
    return d0, d1, new_x, new_y
