"""Has the rollouts compiled by a process of their own, before this process loads them.

Machine code that was just compiled and the same code loaded from the cache can differ in the last
bit of a sum: functions that several kernels call are in each one's file, and whichever copy is
loaded first is called by all. A process that compiled the rollouts would so calculate what no later
process on this machine calculates again. Therefore no process calculates with what it compiled:
where the cache lacks the rollouts, another process fills it, and this one loads them like all that
come after it.

If that process fails, or there is no folder for the cache, only this is lost: this process compiles
whatever it does not find.
"""

import fcntl
import os
import subprocess
import sys
from contextlib import suppress
from functools import cache
from pathlib import Path
from types import FunctionType

from gridpush_drake.dynamics.kernels.compiled import get_cache
from gridpush_drake.dynamics.kernels.rollout import rollout, rollout_pushes

COMPILE = "from gridpush_drake.dynamics.warm_up import compile_rollouts; compile_rollouts()"
"""Python code that the other process runs."""

COMPILES = "GRIDPUSH_COMPILES"
"""Environment variable by which the other process knows that it is the one to compile."""

LOCK = "compiling.lock"
"""File in the cache's folder that is locked while one process has the rollouts compiled."""


def is_compiled() -> bool:
    """Whether the rollouts are in the cache, as it seems by the names of its files."""
    return all(get_cache(each).list_files() for each in (rollout, rollout_pushes))


@cache
def have_rollouts_compiled() -> None:
    """Fills the cache by another process if the rollouts are not in it; only the first call acts.

    Several processes may call it at once: one has them compiled, the others wait for it.
    """
    interpreted = isinstance(rollout, FunctionType)  # where NUMBA_DISABLE_JIT is set
    if os.environ.get(COMPILES) or interpreted or not sys.executable or is_compiled():
        return
    folder = get_cache(rollout).cache_path
    if not folder:
        return
    with suppress(OSError), (Path(folder) / LOCK).open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if is_compiled():
            return
        path = os.pathsep.join(filter(None, sys.path))
        subprocess.run(
            [sys.executable, "-c", COMPILE],
            check=False,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            env={**os.environ, COMPILES: "1", "PYTHONPATH": path},
        )
