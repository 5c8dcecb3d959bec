"""A push by a given force, the paper's own setting."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.errors import PushError


@dataclass(frozen=True, eq=False)
class ForcePush:
    """A force in W applied at a point of the object, piecewise constant in time.

    Attributes:
        point: (2,) p_BP where it acts, m, body frame.
        force: (2,) or (K, 2) N, world frame; the k-th acts from t[k] to t[k+1].
        duration: s, positive.
        t: (K,) times at which each force begins, s, strictly increasing from 0; not needed for one force.

    Raises:
        PushError: shapes disagree or a value is out of range.
    """

    point: NDArray[np.float64]
    force: NDArray[np.float64]
    duration: float
    t: NDArray[np.float64] = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        point = np.array(self.point, dtype=np.float64)
        force = np.atleast_2d(np.array(self.force, dtype=np.float64))
        t = np.zeros(1) if self.t is None else np.array(self.t, dtype=np.float64)
        if point.shape != (2,) or force.shape != (len(t), 2):
            raise PushError(
                f"force push: point of shape {point.shape}, force of shape {force.shape}, {len(t)} times; "
                "expected (2,), (K, 2) and K"
            )
        if not (np.isfinite(point).all() and np.isfinite(force).all() and np.isfinite(t).all()):
            raise PushError("force push: point, force and t must be finite numbers")
        if t[0] != 0 or (np.diff(t) <= 0).any():
            raise PushError("force push: t must begin at 0 and strictly increase")
        if not (np.isfinite(self.duration) and self.duration > 0):
            raise PushError(f"force push: duration is {self.duration!r}; expected a positive number (s)")
        for name, value in (("point", point), ("force", force), ("t", t)):
            value.setflags(write=False)
            object.__setattr__(self, name, value)

    def force_during(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """(T, 2) the force in each of the T steps between `times` (T+1,), N, world frame; that of the step's start."""
        index = np.searchsorted(self.t, times[:-1], side="right") - 1
        return self.force[np.maximum(index, 0)]
