"""Records whose arrays nobody can write to."""

from dataclasses import fields
from typing import Any

import numpy as np


class Frozen:
    """Base of frozen dataclasses with read-only arrays: copies and unpickled ones have read-only arrays, too."""

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Takes what copying or unpickling made, and makes the fields' arrays read-only again."""
        self.__dict__.update(state)
        for field in fields(self):  # type: ignore[arg-type]
            value = state.get(field.name)
            if isinstance(value, np.ndarray):
                value.setflags(write=False)
