"""Planar rigid motions, SE(2).

A pose q = (x, y, theta), m and rad, is X_AB: where frame B stands in frame A, as in Drake's
monogram notation.

    p_A = (x, y) + R(theta) p_B,      R(theta) = [[cos theta, -sin theta], [sin theta, cos theta]]

All functions take arrays with any leading dimensions, which broadcast, and return new ones.
"""

from math import cos, sin
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from shapely.affinity import affine_transform
from shapely.geometry.base import BaseGeometry

from gridpush_drake.errors import MAX_NUMBER, GridPushError

Array = NDArray[np.float64]
"""An array of floating-point numbers. Docstrings give its shape and its units."""

IntArray = NDArray[np.int64]
"""An array of whole numbers. Docstrings give its shape and its meaning."""

Shape = TypeVar("Shape", bound=BaseGeometry)


class _Pose(NamedTuple):
    """Poses taken apart.

    Attributes:
        p: (..., 2) where the frame's origin stands, m.
        theta: (...,) the frame's angle, rad.
    """

    p: Array
    theta: Array


def _to_floats(values: ArrayLike) -> Array:
    """Takes numbers as an array, without a copy where they are one."""
    return np.asarray(values, dtype=np.float64)


def _split(X_AB: ArrayLike) -> _Pose:
    """Takes poses (..., 3) apart."""
    q = _to_floats(X_AB)
    return _Pose(p=q[..., :2], theta=q[..., 2])


def _join(p: Array, theta: Array) -> Array:
    """Makes poses (..., 3) of positions (..., 2), m, and angles (...,), rad."""
    return np.concatenate([p, theta[..., None]], axis=-1)


def _stack(*components: Array) -> Array:
    """Puts the components (...,) of vectors beside each other, along a new last dimension."""
    return np.stack(components, axis=-1)


def make_rotation(theta: ArrayLike) -> Array:
    """Makes R(theta), (..., 2, 2), of angles theta (...,), rad."""
    angle = _to_floats(theta)
    c = np.cos(angle)
    s = np.sin(angle)
    first_row = _stack(c, -s)
    second_row = _stack(s, c)
    return np.stack([first_row, second_row], axis=-2)


def make_direction(theta: ArrayLike) -> Array:
    """Makes the unit vectors (..., 2) at angles theta (...,), rad, from the x axis."""
    angle = _to_floats(theta)
    return _stack(np.cos(angle), np.sin(angle))


def turn_left(v: Array) -> Array:
    """Rotates vectors (..., 2) by 90 degrees counterclockwise."""
    x = v[..., 0]
    y = v[..., 1]
    return _stack(-y, x)


def turn_right(v: Array) -> Array:
    """Rotates vectors (..., 2) by 90 degrees clockwise."""
    x = v[..., 0]
    y = v[..., 1]
    return _stack(y, -x)


def rotate(theta: ArrayLike, v: ArrayLike) -> Array:
    """Rotates vectors v (..., 2) by angles theta (...,), rad: R(theta) v."""
    angle = _to_floats(theta)
    vector = _to_floats(v)
    c = np.cos(angle)
    s = np.sin(angle)
    x = vector[..., 0]
    y = vector[..., 1]
    rotated_x = c * x - s * y
    # filled in place: `np.stack` takes longer than the rest for the few vectors of most calls
    rotated = np.empty((*rotated_x.shape, 2))
    rotated[..., 0] = rotated_x
    rotated[..., 1] = s * x + c * y
    return rotated


def transform(X_AB: ArrayLike, p_B: ArrayLike) -> Array:
    """Brings points p_B (n, 2), given in B, m, into A: (..., n, 2) for poses X_AB (..., 3)."""
    # One more dimension, along which each pose meets all n points.
    pose = _split(_to_floats(X_AB)[..., None, :])
    # p_A = (x, y) + R(theta) p_B
    return pose.p + rotate(pose.theta, p_B)


def transform_back(X_AB: ArrayLike, p_A: ArrayLike) -> Array:
    """Brings points p_A (..., n, 2), given in A, m, into B: (..., n, 2) for poses X_AB (..., 3)."""
    pose = _split(_to_floats(X_AB)[..., None, :])
    # p_B = R(-theta) (p_A - (x, y))
    return rotate(-pose.theta, _to_floats(p_A) - pose.p)


def transform_shape(X_AB: ArrayLike, shape: Shape) -> Shape:
    """Brings a shapely geometry, given in B, m, into A, for one pose X_AB (3,)."""
    x, y, theta = _to_floats(X_AB).tolist()
    c = cos(theta)
    s = sin(theta)
    # shapely's order: the matrix row by row, then the translation
    placed: Shape = affine_transform(shape, [c, -s, s, c, x, y])
    return placed


def compose(X_AB: ArrayLike, X_BC: ArrayLike) -> Array:
    """Composes poses (..., 3): X_AC = X_AB X_BC; the angles add up and are not wrapped."""
    outer = _split(X_AB)
    inner = _split(X_BC)
    p_AC = outer.p + rotate(outer.theta, inner.p)
    return _join(p_AC, outer.theta + inner.theta)


def invert(X_AB: ArrayLike) -> Array:
    """Inverts poses (..., 3): X_BA."""
    pose = _split(X_AB)
    p_BA = rotate(-pose.theta, -pose.p)
    return _join(p_BA, -pose.theta)


def wrap_angle(theta: ArrayLike) -> Array:
    """Wraps angles (...,), rad, into [-pi, pi)."""
    from_start = (_to_floats(theta) + np.pi) % (2.0 * np.pi)
    return np.asarray(from_start - np.pi)


def calc_yaw(
    w: Array,
    x: Array,
    y: Array,
    z: Array,
) -> Array:
    """Calculates the turns about z (...,), rad, of quaternions of length 1, parts (...,) each."""
    # half of where the body's x axis points
    aside = y * y + z * z
    along_x = 0.5 - aside
    along_y = w * z + x * y
    yaw: Array = np.arctan2(along_y, along_x)
    return yaw


QUATERNION_TOLERANCE = 0.01
"""Largest difference of a quaternion's length from 1."""


def check_vector(
    kind: type[GridPushError], name: str, value: ArrayLike, size: int, unit: str = ""
) -> Array:
    """Checks a vector of two to four numbers that a user gave.

    Args:
        kind: the error to raise.
        name: what the user calls the vector.
        value: what was given.
        size: 2, 3 or 4.
        unit: the unit of the numbers, or both units, for the message; none by default.

    Returns:
        (size,) a copy of the numbers.

    Raises:
        GridPushError: of the given kind, where there are not so many numbers, or one is not finite
            or larger than `MAX_NUMBER`.
    """
    try:
        vector = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        vector = np.empty(0)  # refused below, for its shape
    # Written so that a NaN is refused, too.
    if vector.shape != (size,) or not (np.abs(vector) <= MAX_NUMBER).all():
        count = {2: "two", 3: "three", 4: "four"}[size]
        form = f"{count} finite numbers, at most {MAX_NUMBER:g}{unit and f' ({unit})'}"
        raise kind(f"{name} is {value!r}; expected {form}")
    return vector
