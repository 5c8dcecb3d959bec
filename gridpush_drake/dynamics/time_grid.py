"""The times of a push's steps."""

from math import ceil

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridpush_drake.dynamics.push import ForcePush, Push
from gridpush_drake.errors import SimulationError, require_positive

Array = NDArray[np.float64]

DEFAULT_DT = 0.01  # s, the longest step where none is given
DEFAULT_TIP_STEP = 0.001  # m, the furthest the pusher moves in a step where none is given
MAX_STEPS = 1_000_000  # of a simulation, each of which is kept: 1 km of the pusher's path by default
SLACK = 1e-9  # share of a step by which a duration may exceed a whole number of them


def make_times(push: Push | ForcePush, dt: float | None, regime: str = "inertial") -> Array:
    """Cuts a push into steps of dt, s, the last one shortened to end with it; the default ones where None.

    Returns:
        (T+1,) s from the push's beginning.

    Raises:
        SimulationError: dt is not positive, or so short that there are more than MAX_STEPS.
    """
    if dt is not None:
        require_positive(SimulationError, unit="s", dt=dt)
        steps = _count_steps(push.duration / dt)
        return np.append(np.arange(steps) * dt, push.duration)
    if isinstance(push, ForcePush):
        return np.linspace(0.0, push.duration, _count_steps(push.duration / DEFAULT_DT) + 1)
    return make_path_times(push, regime)


def make_path_times(
    push: Push, regime: str = "inertial", tip_step: float = DEFAULT_TIP_STEP, longest: float = DEFAULT_DT
) -> Array:
    """Cuts a push's path into the default steps: (T+1,), s from its beginning.

    "inertial": every piece of the path, whose samples are among the times, is cut into the longest steps allowed,
    `longest` (s) and `tip_step` (m of the pusher), so that they do not jump with the piece's length and speed; the last
    two, half a step to a whole one each, share what is left. "quasi_static": the path's length is cut evenly, whatever
    its pieces and however long they last, for time does not matter.

    Raises:
        SimulationError: they are more than MAX_STEPS.
    """
    distance = np.linalg.norm(np.diff(push.xy, axis=0), axis=1)
    if regime == "quasi_static":
        arc = np.append(0.0, np.cumsum(distance))
        count = _count_steps(arc[-1] / tip_step)
        cuts = np.interp(arc[-1] * np.arange(1, count) / count, arc, push.t)
        return np.unique(np.concatenate([[0.0], cuts, [push.duration]]))
    wanted = np.maximum(distance / tip_step, np.diff(push.t) / longest)
    _count_steps(float(np.maximum(wanted, 1.0).sum()))
    pieces = [push.t[i] + (push.t[i + 1] - push.t[i]) * _cut(parts) for i, parts in enumerate(wanted)]
    return np.append(np.concatenate(pieces), push.t[-1])


def _count_steps(steps: float) -> int:
    """Rounds up to a whole number of steps. Raises SimulationError where they are too many to be kept."""
    if not steps <= MAX_STEPS:
        raise SimulationError(
            f"the push takes {steps:.3g} steps; expected at most {MAX_STEPS}: a shorter path or time (in m and s), or "
            "longer steps"
        )
    return max(1, ceil(steps - SLACK))


def _cut(parts: float) -> Array:
    """Cuts 1 into steps of 1/parts, of which the last two share what is left; returns where each begins."""
    count = _count_steps(parts)
    if parts > count - SLACK:
        return np.arange(count) / count
    starts = np.arange(count) / parts
    if count > 1:
        starts[-1] = (starts[-2] + 1.0) / 2
    return starts


def check_times(times: ArrayLike) -> Array:
    """Copies the steps' times that a caller gives, (T+1,), s: finite and strictly increasing, or a SimulationError."""
    times = np.array(times, dtype=np.float64)
    if times.ndim != 1 or len(times) < 2 or not np.isfinite(times).all() or (np.diff(times) <= 0).any():
        raise SimulationError("times: expected at least two finite, strictly increasing numbers (s)")
    return times
