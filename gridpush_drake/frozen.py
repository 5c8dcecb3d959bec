"""Records that are never changed: with arrays that nobody can write to, and without copies."""

from dataclasses import fields
from typing import Any, Self

import numpy as np


class Frozen:
    """Base of frozen dataclasses with read-only arrays.

    Copies and unpickled ones have read-only arrays, too.
    """

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Takes what copying or unpickling made, and makes the fields' arrays read-only again."""
        self.__dict__.update(state)
        for field in fields(self):  # type: ignore[arg-type]
            value = state.get(field.name)
            if isinstance(value, np.ndarray):
                value.setflags(write=False)


class Unchanging:
    """Base of frozen records that a Context holds as state.

    Such a record is never changed, only replaced, so that its copy is itself: Drake copies the
    whole abstract state at every update of a part of it.
    """

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        return self
