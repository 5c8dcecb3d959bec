"""Observed pushes: the tip's path, the object's poses and, where it was measured, the force.

Positions are in the world frame W, in m; angles in rad; times in s from the push's own beginning; forces, N,
are the pusher's on the object.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridpush_drake.dynamics.push import Push
from gridpush_drake.errors import PushLogError

DEFAULT_PUSHER_RADIUS = 0.005
"""The disc's radius where neither the reader's caller nor the object's file gives one, m."""


@dataclass(frozen=True, eq=False)
class ObservedPush:
    """One push and what was seen of the object while it lasted.

    Attributes:
        name: what to call it; any text without blanks at its ends.
        push: the disc's motion.
        pose: (3,) q_W = (x, y, theta) of the object at the push's beginning, m and rad.
        t_observed: (K,) times of the later observations, s, strictly increasing, in (0, push.duration]; K is
            0 only where a push is to be predicted.
        poses_observed: (K, 3) q_W at those times, theta continuous (see `nearest_turn`).
        force_t: (F,) times of the force samples, s, strictly increasing, in [0, push.duration]; None where
            the force was not measured.
        force: (F, 2) force on the object in W, N; None where it was not measured.
        overhang: whether a part of the object hung over the table's edge, which the model does not know of.

    Raises:
        PushLogError: a shape, a time or a value is not as said above.
    """

    name: str
    push: Push
    pose: NDArray[np.float64]
    t_observed: NDArray[np.float64]
    poses_observed: NDArray[np.float64]
    force_t: NDArray[np.float64] | None = None
    force: NDArray[np.float64] | None = None
    overhang: bool = False

    def __post_init__(self) -> None:
        if not self.name or self.name != self.name.strip():
            raise PushLogError(f"push {self.name!r}: its name must not be empty nor have blanks at its ends")
        t_observed = self._array("t_observed", self.t_observed, (-1,))
        self._array("pose", self.pose, (3,))
        self._array("poses_observed", self.poses_observed, (len(t_observed), 3))
        self._check_times("t_observed", t_observed)
        if len(t_observed) and t_observed[0] <= 0:
            raise PushLogError(f"push {self.name!r}: t_observed[0] is {t_observed[0]} s; expected times > 0")
        if (self.force_t is None) != (self.force is None):
            raise PushLogError(f"push {self.name!r}: force_t and force come together, or not at all")
        if self.force_t is not None and self.force is not None:
            force_t = self._array("force_t", self.force_t, (-1,))
            self._array("force", self.force, (len(force_t), 2))
            self._check_times("force_t", force_t)

    def _array(self, name: str, value: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.float64]:
        array = np.array(value, dtype=np.float64)
        if array.size == 0 and 0 in shape:
            array = array.reshape(shape)
        if array.ndim != len(shape) or any(n not in (-1, m) for n, m in zip(shape, array.shape, strict=True)):
            raise PushLogError(f"push {self.name!r}: {name} has shape {array.shape}; expected {shape}")
        if not np.isfinite(array).all():
            raise PushLogError(f"push {self.name!r}: {name} must hold finite numbers")
        array.setflags(write=False)
        object.__setattr__(self, name, array)
        return array

    def _check_times(self, name: str, t: NDArray[np.float64]) -> None:
        if np.any(np.diff(t) <= 0):
            raise PushLogError(f"push {self.name!r}: {name} must be strictly increasing")
        if len(t) and (t[0] < 0 or t[-1] > self.push.duration):
            raise PushLogError(
                f"push {self.name!r}: {name} runs from {t[0]} to {t[-1]} s; expected times within the push, "
                f"0 to {self.push.duration} s"
            )

    @property
    def final_pose(self) -> NDArray[np.float64]:
        """(3,) q_W at the last observation. Raises PushLogError where there is none after the first."""
        if not len(self.poses_observed):
            raise PushLogError(f"push {self.name!r}: the object was not observed after the push's beginning")
        return self.poses_observed[-1]


@dataclass(frozen=True, eq=False)
class PushLog:
    """Several pushes of one object. `log[3]` is a push; `log[1:4]` and `log[[0, 2]]` are logs.

    Attributes:
        pushes: the pushes.
        source: where they came from, such as a file's name.
        radius_given: whether the pusher's radius was given with the pushes; where it was not, they carry
            DEFAULT_PUSHER_RADIUS, and whoever knows the object's file replaces it (`with_radius`).
    """

    pushes: tuple[ObservedPush, ...]
    source: str = ""
    radius_given: bool = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "pushes", tuple(self.pushes))

    @classmethod
    def read_csv(cls, path: Path | str, radius: float | None = None, *, require_final: bool = True) -> "PushLog":
        """Reads a push log; README, "Bring your own pushes", has the columns.

        Args:
            path: the CSV file.
            radius: of the pusher, m; DEFAULT_PUSHER_RADIUS where None, and `radius_given` says so.
            require_final: whether every push must have an observation after its first row.

        Returns:
            The log.

        Raises:
            PushLogError: the file cannot be read or breaks the form; the message names the file, the line,
                the column and the expected form.
            PushError: the radius is not positive.
        """
        from gridpush_drake.pushes.csv_file import read_push_csv

        return read_push_csv(Path(path), radius, require_final=require_final)

    def write_csv(self, path: Path | str, force: bool = False) -> None:
        """Writes the log so that `read_csv` gives its numbers back bit for bit.

        Args:
            path: the CSV file.
            force: whether an existing file may be replaced.

        Raises:
            PushLogError: two pushes have the same name, or there is no push.
            OutputError: the file exists and `force` is not set, or it cannot be written.
        """
        from gridpush_drake.pushes.csv_file import write_push_csv

        write_push_csv(self, Path(path), force)

    def __len__(self) -> int:
        return len(self.pushes)

    def __iter__(self) -> Iterator[ObservedPush]:
        return iter(self.pushes)

    @overload
    def __getitem__(self, index: int) -> ObservedPush: ...

    @overload
    def __getitem__(self, index: slice | Sequence[int] | NDArray[np.integer]) -> "PushLog": ...

    def __getitem__(self, index: int | slice | Sequence[int] | NDArray[np.integer]) -> "ObservedPush | PushLog":
        if isinstance(index, slice):
            return replace(self, pushes=self.pushes[index])
        if isinstance(index, (int, np.integer)):
            return self.pushes[index]
        return self.subset(index)

    def subset(self, indices: Sequence[int] | NDArray[np.integer]) -> "PushLog":
        """The log of the pushes at `indices` (or of a mask), in their order. Raises IndexError beyond the last."""
        chosen = np.arange(len(self))[list(indices)]
        return replace(self, pushes=tuple(self.pushes[i] for i in chosen))

    @property
    def supported(self) -> "PushLog":
        """The pushes during which the whole object was on the table: those that a model can explain.

        Raises:
            PushLogError: there are pushes, but none of them is such a one.
        """
        kept = self.subset([i for i, seen in enumerate(self) if not seen.overhang])
        if len(self) and not len(kept):
            raise PushLogError(
                f"{self.source or 'push log'}: overhang is 1 in every push; expected at least one push with the whole "
                "object on the table"
            )
        return kept

    @property
    def overhanging(self) -> "PushLog":
        """The pushes during which a part of the object hung over the table's edge."""
        return self.subset([i for i, seen in enumerate(self) if seen.overhang])

    def with_radius(self, radius: float) -> "PushLog":
        """The same pushes made by a disc of `radius`, m. Raises PushError where it is not positive."""
        pushes = tuple(replace(seen, push=replace(seen.push, radius=radius)) for seen in self.pushes)
        return replace(self, pushes=pushes, radius_given=True)


def nearest_turn(theta: float, reference: float) -> float:
    """`theta`, rad, by as many whole turns as bring it within pi of `reference`; none where it is already."""
    turns = round((reference - theta) / math.tau)
    return theta + turns * math.tau if turns else theta
