"""Planar rigid motions, SE(2).

A pose q = (x, y, theta), m and rad, is X_AB: where frame B stands in frame A, as in Drake's
monogram notation.

    p_A = (x, y) + R(theta) p_B,      R(theta) = [[cos theta, -sin theta], [sin theta, cos theta]]

All functions take arrays with any leading dimensions, which broadcast, and return new ones.
"""

from math import cos, sin
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from shapely.affinity import affine_transform
from shapely.geometry.base import BaseGeometry

from gridpush_drake.errors import MAX_NUMBER, GridPushError

Array = NDArray[np.float64]
"""Of numbers; docstrings say of what shape."""

Shape = TypeVar("Shape", bound=BaseGeometry)


def make_rotation(theta: ArrayLike) -> Array:
    """Makes R(theta), (..., 2, 2), of angles theta (...,), rad."""
    angle = np.asarray(theta, dtype=np.float64)
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([np.stack([c, -s], axis=-1), np.stack([s, c], axis=-1)], axis=-2)


def make_direction(theta: ArrayLike) -> Array:
    """Makes the unit vectors (..., 2) at angles theta (...,), rad, from the x axis."""
    angle = np.asarray(theta, dtype=np.float64)
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def rotate(theta: ArrayLike, v: ArrayLike) -> Array:
    """Rotates vectors v (..., 2) by angles theta (...,), rad: R(theta) v."""
    angle, vector = np.asarray(theta, dtype=np.float64), np.asarray(v, dtype=np.float64)
    c, s = np.cos(angle), np.sin(angle)
    x, y = vector[..., 0], vector[..., 1]
    return np.stack([c * x - s * y, s * x + c * y], axis=-1)


def transform(X_AB: ArrayLike, p_B: ArrayLike) -> Array:
    """Brings points p_B (n, 2), given in B, m, into A: (..., n, 2) for poses X_AB (..., 3)."""
    q = np.asarray(X_AB, dtype=np.float64)[..., None, :]
    return q[..., :2] + rotate(q[..., 2], p_B)


def transform_back(X_AB: ArrayLike, p_A: ArrayLike) -> Array:
    """Brings points p_A (..., n, 2), given in A, m, into B: (..., n, 2) for poses X_AB (..., 3)."""
    q = np.asarray(X_AB, dtype=np.float64)[..., None, :]
    return rotate(-q[..., 2], np.asarray(p_A, dtype=np.float64) - q[..., :2])


def transform_shape(X_AB: ArrayLike, shape: Shape) -> Shape:
    """Brings a shapely geometry, given in B, m, into A, for one pose X_AB (3,)."""
    x, y, theta = np.asarray(X_AB, dtype=np.float64).tolist()
    c, s = cos(theta), sin(theta)
    placed: Shape = affine_transform(shape, [c, -s, s, c, x, y])
    return placed


def compose(X_AB: ArrayLike, X_BC: ArrayLike) -> Array:
    """Composes poses (..., 3): X_AC = X_AB X_BC; the angles add up and are not wrapped."""
    q_AB, q_BC = np.asarray(X_AB, dtype=np.float64), np.asarray(X_BC, dtype=np.float64)
    p_AC = q_AB[..., :2] + rotate(q_AB[..., 2], q_BC[..., :2])
    return np.concatenate([p_AC, (q_AB[..., 2] + q_BC[..., 2])[..., None]], axis=-1)


def invert(X_AB: ArrayLike) -> Array:
    """Inverts poses (..., 3): X_BA."""
    q = np.asarray(X_AB, dtype=np.float64)
    return np.concatenate([rotate(-q[..., 2], -q[..., :2]), -q[..., 2:]], axis=-1)


def wrap_angle(theta: ArrayLike) -> Array:
    """Wraps angles (...,), rad, into [-pi, pi)."""
    return np.asarray((np.asarray(theta, dtype=np.float64) + np.pi) % (2.0 * np.pi) - np.pi)


def check_vector(
    kind: type[GridPushError], name: str, value: ArrayLike, size: int, unit: str = ""
) -> Array:
    """Copies two or three finite numbers (size,), at most MAX_NUMBER. Raises `kind` where they are not."""
    try:
        vector = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        vector = np.empty(0)
    if vector.shape != (size,) or not (np.abs(vector) <= MAX_NUMBER).all():
        count = {2: "two", 3: "three"}[size]
        form = f"{count} finite numbers, at most {MAX_NUMBER:g}{unit and f' ({unit})'}"
        raise kind(f"{name} is {value!r}; expected {form}")
    return vector
