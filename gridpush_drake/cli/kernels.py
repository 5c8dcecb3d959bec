"""Compiled kernels, loaded or made before a command needs them; on two processes where there is much to compile."""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from gridpush_drake.dynamics.warm_up import (
    compile_columns,
    compile_rollouts,
    is_compiled,
    make_square,
)
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.pregrasp.stability import calc_stability_margin
from gridpush_drake.planning.pregrasp.uncertainty import PlausibleMassSet
from gridpush_drake.planning.support_surface import SupportSurface

APART = "from gridpush_drake.cli.kernels import compile_apart; compile_apart()"
"""What the second process does."""

PATIENCE = 60.0
"""s that the second process is waited for once the first is done; then it is ended, as it is not
needed."""


def compile_all() -> None:
    """Loads the kernels that commands need; compiles those that are not in the cache, on two processes."""
    with _working_apart(needed=not is_compiled()):
        compile_rollouts()
    compile_margins()


def compile_apart() -> None:
    """The second process's part: what the rollout needs last, and what is no part of it."""
    compile_columns()
    compile_margins()


def compile_margins() -> None:
    """Calculates one stability margin: loads the kernels of planning a grasp, or compiles them."""
    obj = make_square()
    masses = PlausibleMassSet.of_masses(obj, CellParameters.uniform(obj))
    calc_stability_margin(masses, [0.0, 0.0, 0.0], SupportSurface.round([0.0, 0.0], 1.0))


@contextmanager
def _working_apart(needed: bool) -> Iterator[None]:
    """Lets a second process compile its part meanwhile, where there is a second core for it.

    What goes wrong there costs time only: this process compiles whatever it does not find.
    """
    if not needed or len(os.sched_getaffinity(0)) < 2 or not sys.executable:
        yield
        return
    quiet = subprocess.DEVNULL
    try:
        apart = subprocess.Popen(
            [sys.executable, "-c", APART], stdin=quiet, stdout=quiet, stderr=quiet
        )
    except OSError:
        yield
        return
    try:
        yield
        apart.wait(PATIENCE)
    except subprocess.TimeoutExpired:
        pass
    finally:
        apart.kill()
        apart.wait()
