"""What the solver remembers from step to step.

With it, a motion that is cut in two stays the same motion.

A step's guess is the extrapolation of the last two twists, its contact modes are those of the last
step. The solution does not depend on the guess where it is unique; where two contacts jam it may.
"""

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.dynamics.kernels.compiled import kernel

MEMORY_SIZE = 13
"""Twist of the last step (3), of the one before (3), contact modes (2), steps moved in a row, up to
MIN_MOVING_STEPS (1); the loads' tilt (2) and the friction with the table (2), see
`support_loads`."""

MIN_MOVING_STEPS = 2
"""Steps moved in a row from which on the twist is extrapolated."""

_LAST = 3
_MODES = 6
_MOVING_STEPS = 8
_TILT = 9
_FRICTION = 11


def make_memory() -> NDArray[np.float64]:
    """Makes the memory (MEMORY_SIZE,) of a body that was at rest."""
    return np.zeros(MEMORY_SIZE)


@kernel(allocates=False)
def recall(memory, xi, last_twist, modes, tilt, friction):
    """Fills twists (3,), modes, tilt and friction (2,) from the memory.

    Returns:
        The steps that the body moved in a row.
    """
    for i in range(3):
        xi[i] = memory[i]
        last_twist[i] = memory[_LAST + i]
    for j in range(2):
        modes[j] = int(memory[_MODES + j])
        tilt[j] = memory[_TILT + j]
        friction[j] = memory[_FRICTION + j]
    return int(memory[_MOVING_STEPS])


@kernel(allocates=False)
def remember(memory, xi, last_twist, modes, moving_steps, tilt, friction):
    """Writes what `recall` reads into the memory (MEMORY_SIZE,)."""
    for i in range(3):
        memory[i] = xi[i]
        memory[_LAST + i] = last_twist[i]
    for j in range(2):
        memory[_MODES + j] = modes[j]
        memory[_TILT + j] = tilt[j]
        memory[_FRICTION + j] = friction[j]
    # More than MIN_MOVING_STEPS steps tell nothing more, and a count that grows would never be the
    # same.
    memory[_MOVING_STEPS] = min(moving_steps, MIN_MOVING_STEPS)
