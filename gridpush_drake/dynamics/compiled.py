"""How the kernels are compiled: once a machine, and again whenever any kernel's source changes.

Numba looks only at the file of the function it caches, not at the files of those it calls; a kernel spread over several
files could so run with stale parts. The cache here is keyed by all of them together.
"""

import hashlib
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba

KERNEL_FILES = (
    "columns.py",
    "compiled.py",
    "contact.py",
    "displacement.py",
    "friction.py",
    "lagged.py",
    "modes.py",
    "paper_kernel.py",
    "rollout.py",
    "sensitivity.py",
    "step.py",
    "step_memory.py",
)

FAST_SUMS = frozenset({"reassoc", "contract", "nsz", "arcp"})
"""What lets a sum over cells be vectorised; infinities and NaN keep their meaning."""


def kernel(*, fast_sums: bool = False) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Compiles a function on its first call; without the GIL, with division as in C.

    Args:
        fast_sums: whether sums may be reordered and divisions by the same number shared.

    Returns:
        The decorator.
    """

    def compile_function(function: Callable[..., Any]) -> Callable[..., Any]:
        previous = numba.config.CACHE_DIR  # type: ignore[attr-defined]
        numba.config.CACHE_DIR = str(_cache_folder())  # type: ignore[attr-defined]
        try:
            fastmath = set(FAST_SUMS) if fast_sums else False
            return numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=fastmath)(function)
        finally:
            numba.config.CACHE_DIR = previous  # type: ignore[attr-defined]

    return compile_function


def _cache_folder() -> Path:
    """Beside the bytecode, or, where that is read-only, in the user's cache; NUMBA_CACHE_DIR overrides both."""
    folder = Path(__file__).parent
    digest = hashlib.sha256(b"".join((folder / name).read_bytes() for name in KERNEL_FILES)).hexdigest()[:16]
    given = os.environ.get("NUMBA_CACHE_DIR")
    home = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"))
    places = [Path(given)] if given else [folder / "__pycache__", home / "gridpush_drake"]
    for place in places:
        candidate = place / f"kernels-{digest}"
        try:
            candidate.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=candidate):
                return candidate
        except OSError:
            continue
    return Path(tempfile.gettempdir()) / f"gridpush_drake-kernels-{digest}"
