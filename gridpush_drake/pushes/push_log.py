"""Several pushes of an object, or of several, and what was seen of it: `PushLog`.

Positions are in the world frame W, in m; angles in rad; times in s from the push's own beginning;
forces, N, are the pusher's on the object. What one push holds is said in `observed_push`, and the
columns of the file in `push_csv`.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import overload

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.dynamics.pusher import DEFAULT_PUSHER_RADIUS
from gridpush_drake.errors import PushLogError
from gridpush_drake.frozen import Frozen
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.notebook import count, describe_move, make_page, make_table
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.pushes.observed_push import ObservedPush as ObservedPush
from gridpush_drake.pushes.push_csv import OBJECT, read_pushes, write_pushes
from gridpush_drake.units import MM_PER_M


@dataclass(frozen=True, eq=False)
class PushLog(Frozen):
    """Several pushes of the same objects. `log[3]` is a push; `log[1:4]`, `log[[0, 2]]` are logs.

    Attributes:
        pushes: the pushes.
        source: where they came from, such as a file's name.
        radius_given: whether the pusher's radius was given with the pushes; where it was not, they
            carry DEFAULT_PUSHER_RADIUS, and whoever knows the object's file replaces it
            (`with_radius`).
        table: (K, 2) corners in W of the table's top, counterclockwise, m; None where its edge is
            far or unknown.
        names: what the log calls its objects, in the order of their poses.

    Raises:
        PushLogError: a push is of other objects than `names`, or the table is no polygon.
    """

    pushes: tuple[ObservedPush, ...]
    source: str = ""
    radius_given: bool = True
    table: Array | None = None
    names: tuple[str, ...] = (OBJECT,)

    def __post_init__(self) -> None:
        object.__setattr__(self, "pushes", tuple(self.pushes))
        object.__setattr__(self, "names", tuple(self.names))
        for seen in self.pushes:
            if seen.object_count != len(self.names):
                raise PushLogError(
                    f"push {seen.name!r}: {seen.object_count} objects; expected {len(self.names)}: "
                    f"{', '.join(self.names)}"
                )
        if self.table is not None:
            corners = np.array(self.table, dtype=np.float64)
            if (
                corners.ndim != 2
                or corners.shape[1] != 2
                or len(corners) < 3
                or not np.isfinite(corners).all()
            ):
                raise PushLogError(
                    f"table: corners of shape {corners.shape}; expected (K, 2) finite numbers, K "
                    ">= 3 (m)"
                )
            corners.setflags(write=False)
            object.__setattr__(self, "table", corners)

    @classmethod
    def read_csv(
        cls, path: Path | str, radius: float | None = None, *, require_final: bool = True
    ) -> "PushLog":
        """Reads a push log; `docs/howto/own_pushes.md` has the columns.

        Args:
            radius: of the pusher, m; DEFAULT_PUSHER_RADIUS where None, and `radius_given` says so.
            require_final: whether every push must have an observation after its first row.

        Raises:
            PushLogError: the file cannot be read or breaks the form; the message names the file,
                the line, the column and the expected form.
            PushError: the radius is not positive.

        Warns:
            PushLogWarning: the file has further columns, which are passed over, or so many poses of
                a push that only some of them are kept.
        """
        pushes, table, names = read_pushes(
            Path(path), DEFAULT_PUSHER_RADIUS if radius is None else radius, require_final
        )
        return cls(pushes, str(path), radius_given=radius is not None, table=table, names=names)

    def write_csv(self, path: Path | str, force: bool = False) -> None:
        """Writes the log so that `read_csv` gives its numbers back bit for bit.

        Raises:
            PushLogError: two pushes have the same name, or there is no push.
            OutputError: the file exists and `force` is not set, or it cannot be written.
        """
        write_pushes(Path(path), self.pushes, self.table, self.names, force)

    def __repr__(self) -> str:
        """How many pushes and poses there are, how long and from where, in a line."""
        poses = count(sum(len(seen.t_observed) for seen in self), "pose")
        way = sum(seen.push.length for seen in self)
        source = f", from {self.source}" if self.source else ""
        return f"PushLog of {count(len(self), 'push')}: {poses}, {way:.3g} m of pushing{source}"

    def _repr_html_(self) -> str:
        """A row a push."""
        heads = ("push", "path, mm", "duration, s", "poses seen", "the object", "forces")
        rows = [
            (
                seen.name,
                f"{seen.push.length * MM_PER_M:.0f}",
                f"{seen.push.duration:.3g}",
                len(seen.t_observed),
                _describe_moves(seen),
                "none" if seen.force_t is None else len(seen.force_t),
            )
            for seen in self
        ]
        return make_page(repr(self), make_table(heads, rows))

    def __len__(self) -> int:
        return len(self.pushes)

    def __iter__(self) -> Iterator[ObservedPush]:
        return iter(self.pushes)

    @overload
    def __getitem__(self, index: int) -> ObservedPush: ...

    @overload
    def __getitem__(self, index: slice | Sequence[int] | NDArray[np.integer]) -> "PushLog": ...

    def __getitem__(
        self, index: int | slice | Sequence[int] | NDArray[np.integer]
    ) -> "ObservedPush | PushLog":
        if isinstance(index, slice):
            return replace(self, pushes=self.pushes[index])
        if isinstance(index, (int, np.integer)):
            return self.pushes[index]
        return self.subset(index)

    def subset(self, indices: Sequence[int] | NDArray[np.integer]) -> "PushLog":
        """Takes some of the pushes.

        Args:
            indices: their places, or a mask of booleans.

        Returns:
            A log of them, in the order of the indices.

        Raises:
            IndexError: an index is beyond the last push.
        """
        chosen = np.arange(len(self))[list(indices)]
        return replace(self, pushes=tuple(self.pushes[i] for i in chosen))

    @property
    def supported(self) -> "PushLog":
        """The pushes that a model can explain: all, where the table is known, else `on_table`."""
        return self if self.table is not None else self.on_table

    @property
    def on_table(self) -> "PushLog":
        """The pushes during which the whole object was on the table, for models that know no edge.

        The log has no table.

        Raises:
            PushLogError: there are pushes, but none of them is such a one.
        """
        kept = self.subset([i for i, seen in enumerate(self) if not seen.overhang])
        if len(self) and not len(kept):
            raise PushLogError(
                f"{self.source or 'push log'}: overhang is 1 in every push; expected the column "
                "table, or at least one push with the whole object on the table"
            )
        return replace(kept, table=None)

    @property
    def overhanging(self) -> "PushLog":
        """Takes the pushes that no model can explain: over the edge of an unknown table."""
        return self.subset(
            [i for i, seen in enumerate(self) if seen.overhang and self.table is None]
        )

    def append(self, seen: ObservedPush) -> "PushLog":
        """Adds a push at the end. Objects of a log without pushes are numbered if they are many."""
        names = self.names
        if not self.pushes and seen.object_count != len(names):
            names = tuple(f"{OBJECT}_{i}" for i in range(seen.object_count))
        return replace(self, pushes=(*self.pushes, seen), names=names)

    def single_out(self, index: int) -> "PushLog":
        """Takes what was seen of one of several objects, as if nothing else had been touched."""
        pushes = tuple(seen.single_out(index) for seen in self)
        return replace(self, pushes=pushes, names=(self.names[index],))

    def check_objects(self, objects: Sequence[GridObject]) -> None:
        """Raises PushLogError where the log is of another number of objects than those given."""
        if len(self.names) == len(objects):
            return
        hint = "; several are learned together by gridpush identify --with"
        raise PushLogError(
            f"{self.source or 'push log'}: is of {count(len(self.names), 'object')} "
            f"({', '.join(self.names)}); expected {len(objects)}: "
            f"{', '.join(obj.name for obj in objects)}{hint if len(objects) == 1 else ''}"
        )

    def with_radius(self, radius: float) -> "PushLog":
        """Gives all pushes by a disc one of another radius, m.

        Raises:
            PushError: the radius is not positive.
        """
        pushes = tuple(
            seen
            if seen.push.shape is not None
            else replace(seen, push=replace(seen.push, radius=radius))
            for seen in self.pushes
        )
        return replace(self, pushes=pushes, radius_given=True)


def _describe_moves(seen: ObservedPush) -> str:
    """Says what became of each object in a push."""
    if not len(seen.t_observed):
        return "not seen"
    ends = zip(seen.pose.reshape(-1, 3), seen.final_pose.reshape(-1, 3), strict=True)
    return "; ".join(describe_move(*each) for each in ends)


def find_shipped_log(name: str) -> Path:
    """Finds the file of a push log that comes with the package.

    The log of "claw_hammer" has eight pushes of the shipped object of that name, simulated in
    Drake with poses that are off by 0.3 mm and 0.1° (standard deviations). The cells of the
    hammer's head weigh four times as much as those of its handle.

    Raises:
        PushLogError: there is none of that name; the message lists all.
    """
    folder = Path(str(files("gridpush_drake"))) / "models" / "logs"
    known = sorted(path.stem for path in folder.glob("*.csv"))
    if name not in known:
        raise PushLogError(
            f"{name}: no shipped push log has this name; shipped are: {', '.join(known)}"
        )
    return folder / f"{name}.csv"
