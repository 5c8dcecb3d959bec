"""How the kernels are compiled: once a machine, and again whenever the source of any of them changes.

Numba looks only at the file of the function that it caches, not at the files of those it calls; a
kernel spread over several files could so run with stale parts. And it takes two checkouts of the
same sources for different ones. The cache here is a folder named by the contents of all files of
this package and of the function's own file:

    $NUMBA_CACHE_DIR, else $XDG_CACHE_HOME/gridpush_drake, else ~/.cache/gridpush_drake

or, where that cannot be written, beside the bytecode or in the folder for temporary files. A folder
that is already there is read where it cannot be written. Whoever makes a new one removes those that
nobody has used for a month.
"""

import hashlib
import os
import shutil
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import numba
from numba.core.caching import CompileResultCacheImpl, FunctionCache, _CacheLocator

FAST_SUMS = frozenset({"reassoc", "contract", "nsz", "arcp"})
"""What lets a sum over cells be vectorized; infinities and NaN keep their meaning."""

DIGEST_LENGTH = 16
"""Hexadecimal digits of the sources' hash in the folder's name."""

UNUSED = 30 * 86400.0
"""s since a folder was last used, after which it is removed."""

KERNELS = Path(__file__).parent


def kernel(
    *, allocates: bool = True, fast_sums: bool = False
) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Compiles a function on its first call; without the GIL, with division as in C.

    A function whose name begins with an underscore can be called from kernels only.

    Args:
        allocates: whether it makes arrays, or is called with such as nobody else holds. One that
            does neither need not count references, which costs more than the rest of a small
            function.
        fast_sums: whether sums may be reordered and divisions by the same number shared.

    Returns:
        The decorator.
    """

    def compile_function(function: Callable[..., Any]) -> Callable[..., Any]:
        options: dict[str, Any] = {
            "nogil": True,
            "error_model": "numpy",
            "fastmath": set(FAST_SUMS) if fast_sums else False,
            "_nrt": allocates,
            "no_cfunc_wrapper": True,
            "no_cpython_wrapper": function.__name__.startswith("_"),
        }
        dispatcher: Any = numba.njit(**options)(function)
        dispatcher._cache = _KernelCache(function)
        return dispatcher

    return compile_function


@cache
def calc_digest(source: Path) -> str:
    """Hashes the files of this package, and the file that a kernel stands in where that is another one.

    Args:
        source: that file.

    Returns:
        `DIGEST_LENGTH` hexadecimal digits, the same in every checkout of the same sources.
    """
    files = sorted(KERNELS.glob("*.py"))
    if source.parent != KERNELS:
        files.append(source)
    digest = hashlib.sha256()
    for file in files:
        digest.update(file.name.encode() + b"\0" + hashlib.sha256(file.read_bytes()).digest())
    return digest.hexdigest()[:DIGEST_LENGTH]


@cache
def find_cache_folder(source: Path) -> Path:
    """The folder for the compiled kernels of one file: one that is filled, else one that can be."""
    name = f"kernels-{calc_digest(source)}"
    given = os.environ.get("NUMBA_CACHE_DIR")
    home = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"))
    folders = [
        place / name
        for place in (
            [Path(given)] if given else [home / "gridpush_drake", KERNELS / "__pycache__"]
        )
    ]
    for folder in folders:
        with suppress(OSError):
            if any(folder.iterdir()):
                with suppress(OSError):
                    os.utime(folder)  # its last use
                return folder
    for folder in folders:
        with suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=folder):
                _remove_unused(folder.parent)
                return folder
    return Path(tempfile.gettempdir()) / f"gridpush_drake-{name}"


def _remove_unused(place: Path) -> None:
    """Removes the folders of other sources that were not used for long; several processes may be at it at once."""
    for folder in place.glob(f"kernels-{'[0-9a-f]' * DIGEST_LENGTH}"):
        with suppress(OSError):
            if time.time() - folder.stat().st_mtime > UNUSED:
                shutil.rmtree(folder, ignore_errors=True)


class _Locator(_CacheLocator):
    """Where Numba finds what it compiled of one function."""

    def __init__(self, function: Callable[..., Any], source: str) -> None:
        self._source, self._line = Path(source), function.__code__.co_firstlineno

    @classmethod
    def from_function(cls, function: Callable[..., Any], source: str) -> "_Locator":
        return cls(function, source)

    def get_cache_path(self) -> str:
        return str(find_cache_folder(self._source))

    def get_source_stamp(self) -> str:
        return calc_digest(self._source)

    def get_disambiguator(self) -> str:
        return str(self._line)


class _KernelCacheImpl(CompileResultCacheImpl):
    _locator_classes = [_Locator]  # noqa: RUF012


class _KernelCache(FunctionCache):
    """Numba's cache in our folder; where that cannot be written, what was compiled lasts as long as the process."""

    _impl_class = _KernelCacheImpl

    def save_overload(self, signature: Any, data: Any) -> None:
        with suppress(OSError):
            super().save_overload(signature, data)
