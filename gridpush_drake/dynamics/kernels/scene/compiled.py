"""How the kernels of a scene are compiled: as those of one body, and again when any changes.

The cache of `dynamics.kernels.compiled` knows the sources of the one-body kernels and of the file
that a kernel stands in. The kernels here are spread over several files more, so all of these take
part in the name under which each is kept.
"""

import hashlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from gridpush_drake.dynamics.kernels import numba_internals
from gridpush_drake.dynamics.kernels.compiled import KernelCache

SCENE_KERNELS_FOLDER = Path(__file__).parent


@cache
def calc_digest() -> str:
    """Hashes the files of this package."""
    digest = hashlib.sha256()
    for file in sorted(SCENE_KERNELS_FOLDER.glob("*.py")):
        digest.update(file.name.encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()


class SceneCache(KernelCache):
    """The compiled forms of one function, which hold for the sources of this package only."""

    def __init__(self, function: Callable[..., Any]) -> None:
        """Hashes the sources now, as they are read."""
        super().__init__(function)
        self._digest = calc_digest()

    def _make_key(self, signature: Any, codegen: Any) -> tuple[str, ...]:
        return (*super()._make_key(signature, codegen), self._digest)


def kernel(*, allocates: bool = True) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Compiles a function on its first call; without the GIL, with division as in C.

    A function whose name begins with an underscore can be called from kernels only.

    Args:
        allocates: whether it makes arrays, or is called with such as nobody else holds.

    Returns:
        The decorator.
    """

    def compile_function(function: Callable[..., Any]) -> Callable[..., Any]:
        return numba_internals.make_dispatcher(
            function,
            SceneCache(function),
            counts_references=allocates,
            called_from_python=not function.__name__.startswith("_"),
            nogil=True,
            error_model="numpy",
        )

    return compile_function
