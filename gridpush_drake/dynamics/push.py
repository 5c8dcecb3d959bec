"""A push: the planned or recorded planar motion of a disc-shaped pusher."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridpush_drake.errors import PushError


@dataclass(frozen=True, eq=False)
class Push:
    """The motion of a disc of radius `radius` in the plane of the support, piecewise linear in time.

    `Push(start, velocity, duration, radius)` is straight at constant velocity; `Push.along` follows sampled points.

    Attributes:
        start: (2,) p_WP of the disc's centre at the beginning, m, world frame.
        velocity: (2,) v_WP, m/s, world frame; for a sampled path, its mean.
        duration: s, positive.
        radius: m, positive.
        t: (K,) sample times from the push's beginning, s, strictly increasing, `t[0] == 0`.
        xy: (K, 2) p_WP at those times, m.
        start_tangent: (2,) direction in W in which `start` moves as the contact's arc length on the outline
            grows, where the push was made by an outline location; None otherwise.

    Raises:
        PushError: a value is not finite, or radius or duration is not positive.
    """

    start: NDArray[np.float64]
    velocity: NDArray[np.float64]
    duration: float
    radius: float
    t: NDArray[np.float64] = field(default=None, kw_only=True, repr=False)  # type: ignore[assignment]
    xy: NDArray[np.float64] = field(default=None, kw_only=True, repr=False)  # type: ignore[assignment]
    start_tangent: NDArray[np.float64] | None = field(default=None, kw_only=True, repr=False)

    def __post_init__(self) -> None:
        start, velocity = _vector("start", self.start), _vector("velocity", self.velocity)
        _require_positive("radius", self.radius)
        _require_positive("duration", self.duration)
        t = np.array([0.0, self.duration]) if self.t is None else self.t
        xy = np.array([start, start + velocity * self.duration]) if self.xy is None else self.xy
        for name, value in (("start", start), ("velocity", velocity), ("t", t), ("xy", xy)):
            value.setflags(write=False)
            object.__setattr__(self, name, value)
        object.__setattr__(self, "duration", float(self.duration))
        object.__setattr__(self, "radius", float(self.radius))

    @classmethod
    def along(cls, t: ArrayLike, xy: ArrayLike | Sequence[Sequence[float]], radius: float) -> "Push":
        """Makes a push along sampled points.

        Args:
            t: (K,) times, s, strictly increasing, K >= 2; only differences matter.
            xy: (K, 2) p_WP at those times, m, world frame.
            radius: of the disc, m.

        Returns:
            The push.

        Raises:
            PushError: shapes disagree, a value is not finite, or time does not increase.
        """
        t = np.array(t, dtype=np.float64)
        xy = np.array(xy, dtype=np.float64)
        if t.ndim != 1 or len(t) < 2 or xy.shape != (len(t), 2):
            raise PushError(
                f"push: t of shape {t.shape} and xy of shape {xy.shape}; expected (K,) and (K, 2), K >= 2"
            )
        if not (np.isfinite(t).all() and np.isfinite(xy).all()):
            raise PushError("push: t and xy must be finite numbers")
        if np.any(np.diff(t) <= 0):
            raise PushError(
                f"push: t must be strictly increasing; t[{int(np.argmax(np.diff(t) <= 0)) + 1}] is not"
            )
        t = t - t[0]
        return cls(xy[0].copy(), (xy[-1] - xy[0]) / t[-1], t[-1], radius, t=t, xy=xy)

    @property
    def length(self) -> float:
        """Length of the path, m."""
        return float(np.linalg.norm(np.diff(self.xy, axis=0), axis=1).sum())

    def tip_at(self, times: ArrayLike) -> NDArray[np.float64]:
        """Interpolates p_WP of the disc's centre at `times` (K,), s from the beginning; held past the ends. (K, 2), m."""
        times = np.asarray(times, dtype=np.float64)
        return np.column_stack([np.interp(times, self.t, self.xy[:, axis]) for axis in (0, 1)])


def _vector(name: str, value: ArrayLike) -> NDArray[np.float64]:
    vector = np.array(value, dtype=np.float64)
    if vector.shape != (2,) or not np.isfinite(vector).all():
        raise PushError(f"push: {name} is {value!r}; expected two finite numbers")
    return vector


def _require_positive(name: str, value: float) -> None:
    if not (np.isfinite(value) and value > 0):
        raise PushError(f"push: {name} is {value!r}; expected a positive number")
