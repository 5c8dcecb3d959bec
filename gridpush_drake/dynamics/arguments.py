"""Checks of what callers give to `simulate`."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridpush_drake.dynamics.kernels.friction import LAWS
from gridpush_drake.dynamics.kernels.friction_law import SPIN_MODELS
from gridpush_drake.dynamics.push import ForcePush, Push
from gridpush_drake.errors import SimulationError


def check_regime(regime: str, push: Push | ForcePush, friction: str, spin: str, gradients: bool | str) -> None:
    """Refuses words that are not known, and combinations that make no sense.

    Raises:
        SimulationError: either.
    """
    for name, value, known in (
        ("regime", regime, ("inertial", "quasi_static")),
        ("friction", friction, tuple(LAWS)),
        ("spin", spin, SPIN_MODELS),
        ("gradients", gradients, (False, True, "mass", "paper")),
    ):
        if value not in known:
            raise SimulationError(f"{name} is {value!r}; expected one of {', '.join(map(repr, known))}")
    quasi_static = regime == "quasi_static"
    if quasi_static and isinstance(push, ForcePush):
        raise SimulationError(
            "regime: a force-driven push needs 'inertial'; a quasi-static body has no velocity of its own"
        )
    if quasi_static and gradients == "paper":
        raise SimulationError("gradients: 'paper' differentiates momentum; it needs the inertial regime")
    law = LAWS[friction]
    if regime not in law.regimes:
        raise SimulationError(f"friction: {friction!r} needs the regime {' or '.join(map(repr, law.regimes))}")
    if (gradients if gradients != "mass" else True) not in law.gradients:
        words = ", ".join(map(repr, law.gradients))
        raise SimulationError(f"gradients is {gradients!r}; with friction={friction!r} expected one of {words}")


def check_vector(name: str, value: ArrayLike) -> NDArray[np.float64]:
    """Copies three finite numbers.

    Raises:
        SimulationError: they are not.
    """
    try:
        vector = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        vector = np.empty(0)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise SimulationError(f"{name} is {value!r}; expected three finite numbers")
    return vector


def check_number(name: str, value: float, least: float) -> None:
    """Refuses what is not a finite number of at least `least`.

    Raises:
        SimulationError: it is not.
    """
    if not (np.isfinite(value) and value >= least):
        raise SimulationError(f"{name} is {value!r}; expected a finite number >= {least:g}")


def check_record(record: ArrayLike, steps: int) -> NDArray[np.int64]:
    """Copies the indices of the poses whose Jacobian is wanted, out of steps + 1; negative ones count from the end.

    Raises:
        SimulationError: they are not whole numbers from -(steps + 1) to `steps` that name each pose once at most.
    """
    rows = np.array(record)
    whole = rows.ndim == 1 and (len(rows) == 0 or np.issubdtype(rows.dtype, np.integer))
    if not whole or (rows < -(steps + 1)).any() or (rows > steps).any():
        raise SimulationError(f"record: expected whole numbers from {-(steps + 1)} to {steps}")
    rows = rows.astype(np.int64)
    rows[rows < 0] += steps + 1
    if len(np.unique(rows)) != len(rows):
        raise SimulationError("record: names a pose twice; expected distinct indices")
    return rows
