"""Paths of a car that can turn only so tightly to each hand: arcs and Dubins curves.

At the curvature k, positive to the left, a pose q = (p, theta) moves by the length s to

    theta' = theta + k s,      p' = p + s sinc(k s/2) t(theta + k s/2)

with t(theta) the direction of travel and n(theta) its left normal. A curve of a turn, a straight
line and another turn (Dubins 1957) has turning centers c_i = p_i + n(theta_i)/k_i at both ends.
Its line, of length s and direction theta, touches both circles where

    c_2 - c_1 = s t(theta) + d n(theta),      d = 1/k_2 - 1/k_1,

so that s^2 = |c_2 - c_1|^2 - d^2, and theta is the angle of c_2 - c_1 less that of (s, d). The
curvatures of both hands may differ. Curves of three turns are left out: they are of use only where
both ends are near each other.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridpush_drake.geometry.se2 import Array, compose

FULL_TURN = 2 * np.pi
"""rad."""

ROUNDED_TURN = 1e-9
"""Angle, rad, by which a turn may fall short of a full one and still counts as none."""


class DubinsCurves(NamedTuple):
    """Curves of a turn, a line and a turn: left or right at either end.

    Attributes:
        curvatures: (4, 3) of the three pieces, 1/m.
        lengths: (..., 4, 3) of them, m; infinite where there is no such curve.
    """

    curvatures: Array
    lengths: Array


def move_along_arc(pose: ArrayLike, curvature: float, length: ArrayLike) -> Array:
    """Moves poses (..., 3), m and rad, along arcs of a curvature, 1/m, by lengths (...,), m."""
    start = np.asarray(pose, dtype=np.float64)
    s = np.asarray(length, dtype=np.float64)
    turn = curvature * s
    # the chord points along the middle of the turn; numpy's sinc is that of pi x
    chord = s * np.sinc(turn / FULL_TURN)
    zeros = np.zeros_like(turn)
    halfway = compose(start, np.stack([zeros, zeros, turn / 2], axis=-1))
    return compose(halfway, np.stack([chord, zeros, turn / 2], axis=-1))


def find_dubins_curves(
    start: ArrayLike, goal: ArrayLike, right: float, left: float
) -> DubinsCurves:
    """Finds the four curves of a turn, a line and a turn between poses.

    Args:
        start: (..., 3) poses at the beginning, m and rad.
        goal: (..., 3) poses at the end, broadcast with `start`.
        right: curvature of turns to the right, 1/m, negative; 0 where there are none.
        left: curvature of turns to the left, 1/m, positive; 0 where there are none.
    """
    first = np.asarray(start, dtype=np.float64)
    last = np.asarray(goal, dtype=np.float64)
    curvatures = []
    lengths = []
    for k1 in (left, right):
        for k2 in (left, right):
            curvatures.append((k1, 0.0, k2))
            lengths.append(_find_lengths(first, last, k1, k2))
    return DubinsCurves(np.array(curvatures), np.stack(lengths, axis=-2))


def _find_lengths(start: Array, goal: Array, k1: float, k2: float) -> Array:
    """Finds the lengths (..., 3), m, of the pieces of the curve with turns of given curvatures."""
    if k1 == 0 or k2 == 0:
        shape = np.broadcast_shapes(start.shape, goal.shape)
        return np.full(shape, np.inf)

    # c_2 - c_1 and d of the equation
    between = _find_center(goal, k2) - _find_center(start, k1)
    d = 1 / k2 - 1 / k1
    square = np.abs(between) ** 2 - d**2
    # no line where one circle is within the other, or they cross
    line = np.sqrt(np.where(square >= 0, square, np.inf))
    theta = np.angle(between) - np.arctan2(d, line)

    # the turns up to the line's direction, and from it
    first = _find_turn(theta - start[..., 2], k1)
    last = _find_turn(goal[..., 2] - theta, k2)
    return np.stack([first, line, last], axis=-1)


def _find_center(pose: Array, curvature: float) -> NDArray[np.complex128]:
    """Finds the centers (...,) about which poses (..., 3) turn, x + iy, m."""
    x = pose[..., 0]
    y = pose[..., 1]
    left_normal = 1j * np.exp(1j * pose[..., 2])
    return x + 1j * y + left_normal / curvature


def _find_turn(angle: Array, curvature: float) -> Array:
    """Finds how long a turn by angles, rad, modulo a full turn, is at a curvature: m."""
    turned = np.mod(np.sign(curvature) * angle, FULL_TURN)
    # what falls short of a full turn by rounding is none
    is_none = turned > FULL_TURN - ROUNDED_TURN
    turned = np.where(is_none, 0.0, turned)
    return turned / abs(curvature)
