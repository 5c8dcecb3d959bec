"""One push and what was seen of the object, or of several, while it lasted.

Several pushes are a push log (`push_log`).
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from gridpush_drake.dynamics.push import Push
from gridpush_drake.errors import PushLogError
from gridpush_drake.frozen import Frozen
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.notebook import count, describe_move
from gridpush_drake.units import MM_PER_M

TIME_TOLERANCE = 1e-6
"""Time before a push's beginning or after its end that is counted as the beginning or the end, s.

Times that are calculated from time stamps differ by their round-off, 2e-7 s where seconds are
counted from 1970. What was seen further away is refused.
"""


@dataclass(frozen=True, eq=False)
class ObservedPush(Frozen):
    """One push and what was seen of the object, or of N objects, while it lasted.

    Attributes:
        name: what to call it; any text without blanks at its ends.
        push: the disc's motion.
        pose: (3,) q_W = (x, y, theta) of the object at the push's beginning, m and rad; (N, 3) of
            several objects.
        t_observed: (K,) times of the later observations, s, strictly increasing, in (0,
            push.duration]; K is 0 only where a push is to be predicted.
        poses_observed: (K, 3) q_W at those times, theta continuous (see `nearest_turn`); (K, N, 3)
            of several objects.
        force_t: (F,) times of the force samples, s, strictly increasing, in [0, push.duration];
            None where the force was not measured.
        force: (F, 2) force of the pusher in W, N, on whatever it touches; None where it was not
            measured.
        lift_force: (F,) its upward part at the same times, N; negative where the finger presses
            down. None where it was not measured.
        overhang: whether a part of an object hung over the table's edge.

    Raises:
        PushLogError: a shape, a time or a value is not as said above.
    """

    name: str
    push: Push
    pose: Array
    t_observed: Array
    poses_observed: Array
    force_t: Array | None = None
    force: Array | None = None
    overhang: bool = False
    lift_force: Array | None = None

    def __post_init__(self) -> None:
        if not self.name or self.name != self.name.strip():
            raise PushLogError(
                f"push {self.name!r}: its name must not be empty nor have blanks at its ends"
            )
        t_observed = self._times("t_observed", self.t_observed)
        several = np.shape(self.pose)[:-1]
        self._array("pose", self.pose, (*several, 3) if len(several) == 1 else (3,))
        self._array("poses_observed", self.poses_observed, (len(t_observed), *np.shape(self.pose)))
        if len(t_observed) and t_observed[0] <= 0:
            raise PushLogError(
                f"push {self.name!r}: t_observed[0] is {t_observed[0]} s; expected times > 0"
            )
        if (self.force_t is None) != (self.force is None):
            raise PushLogError(
                f"push {self.name!r}: force_t and force come together, or not at all"
            )
        if self.force_t is not None and self.force is not None:
            force_t = self._times("force_t", self.force_t)
            self._array("force", self.force, (len(force_t), 2))
        if self.lift_force is not None:
            if self.force_t is None:
                raise PushLogError(f"push {self.name!r}: lift_force does not come without force_t")
            self._array("lift_force", self.lift_force, (len(self.force_t),))

    @property
    def object_count(self) -> int:
        """Number of objects that were seen."""
        return 1 if self.pose.ndim == 1 else len(self.pose)

    def single_out(self, index: int) -> "ObservedPush":
        """Takes what was seen of one of several objects, as if nothing else had been touched."""
        return replace(self, pose=self.pose[index], poses_observed=self.poses_observed[:, index])

    def __repr__(self) -> str:
        """Name, push and what became of the object, in a line."""
        path = f"{self.push.length * MM_PER_M:.0f} mm in {self.push.duration:.3g} s"
        seen_any = len(self.t_observed) > 0
        seen = count(len(self.t_observed), "pose")
        went = ""
        if self.pose.ndim > 1:
            went = f" of {count(len(self.pose), 'object')}"
        elif seen_any:
            went = f", the object {describe_move(self.pose, self.final_pose)}"
        over = ", over the table's edge" if self.overhang else ""
        return f"ObservedPush {self.name!r}: {path}, {seen}{went}{over}"

    def _array(self, name: str, value: ArrayLike, shape: tuple[int, ...]) -> Array:
        """Makes a field a read-only array of a shape, in which -1 stands for any number."""
        array = np.array(value, dtype=np.float64)
        if array.size == 0 and 0 in shape:
            array = array.reshape(shape)
        if array.ndim != len(shape) or any(
            n not in (-1, m) for n, m in zip(shape, array.shape, strict=True)
        ):
            raise PushLogError(
                f"push {self.name!r}: {name} has shape {array.shape}; expected {shape}"
            )
        if not np.isfinite(array).all():
            raise PushLogError(f"push {self.name!r}: {name} must hold finite numbers")
        array.setflags(write=False)
        object.__setattr__(self, name, array)
        return array

    def _times(self, name: str, value: ArrayLike) -> Array:
        """Makes a field read-only times (-1,), s, that increase and are within the push."""
        t = self._array(name, value, (-1,))
        end = self.push.duration
        near_end = (t > end) & (t <= end + TIME_TOLERANCE)
        near_beginning = (t < 0) & (t >= -TIME_TOLERANCE)
        if near_end.any() or near_beginning.any():
            t = self._array(name, np.where(near_end, end, np.where(near_beginning, 0.0, t)), (-1,))
        if np.any(np.diff(t) <= 0):
            raise PushLogError(f"push {self.name!r}: {name} must be strictly increasing")
        if len(t) and (t[0] < 0 or t[-1] > end):
            raise PushLogError(
                f"push {self.name!r}: {name} runs from {t[0]} to {t[-1]} s; expected times within "
                f"the push, 0 to {end} s"
            )
        return t

    @property
    def final_pose(self) -> Array:
        """Pose q_W (3,) at the last observation, m and rad; (N, 3) of several objects.

        Raises:
            PushLogError: the object was not observed after the push's beginning.
        """
        if not len(self.poses_observed):
            raise PushLogError(
                f"push {self.name!r}: the object was not observed after the push's beginning"
            )
        return self.poses_observed[-1]


def nearest_turn(theta: float, reference: float) -> float:
    """Adds whole turns to an angle so that it is within pi of another one.

    Args:
        theta: the angle, rad.
        reference: the other one, rad.

    Returns:
        The angle, rad; the very same number where it is near already.
    """
    turns = round((reference - theta) / math.tau)
    return theta + turns * math.tau if turns else theta
