"""Loads the compiled kernels before a command needs them, or compiles them.

Kernels are the functions in which pushes are simulated. Where they have to be compiled and there is
a second core, a second process compiles half of them.
"""

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
from gridpush_drake.identification.model import Model
from gridpush_drake.planning.contact import optimize_contact
from gridpush_drake.planning.pregrasp.stability import calc_stability_margin
from gridpush_drake.planning.pregrasp.uncertainty import PlausibleMassSet
from gridpush_drake.planning.support_surface import SupportSurface

APART = "from gridpush_drake.cli.kernels import compile_apart; compile_apart()"
"""Python code that the second process runs."""

PATIENCE = 60.0
"""Time that the second process is waited for once this one is done, s. Then it is ended: whatever
it has not compiled is compiled when it is first needed."""


def compile_all() -> None:
    """Loads the kernels that commands need, and compiles those that are not in the cache."""
    with _working_apart(needed=not is_compiled()):
        compile_rollouts()
    compile_contact_search()
    compile_margins()


def compile_apart() -> None:
    """Compiles the second process's part: what a rollout needs last, and what it does not need."""
    compile_columns()
    compile_margins()


def compile_contact_search() -> None:
    """Loads or compiles the kernels that choose where to push, by choosing one push."""
    obj = make_square()
    goal = [0.02, 0.0, 0.1]
    optimize_contact(Model(obj), [0.0, 0.0, 0.0], goal)


def compile_margins() -> None:
    """Loads or compiles the kernels of planning a grasp, by calculating one stability margin."""
    obj = make_square()
    masses = PlausibleMassSet.of_masses(Model(obj))
    calc_stability_margin(masses, [0.0, 0.0, 0.0], SupportSurface.round([0.0, 0.0], 1.0))


@contextmanager
def _working_apart(needed: bool) -> Iterator[None]:
    """Lets a second process compile its part meanwhile, if there is a second core for it.

    If anything goes wrong in that process, only time is lost: this process compiles whatever it
    does not find in the cache.

    Args:
        needed: whether there is anything to compile.
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
