"""How the kernels are compiled: once a machine, and again when the source of any changes.

Numba looks only at the file of the function that it caches, not at the files of those it calls; a
kernel spread over several files could so run with stale parts. And it takes two checkouts of the
same sources for different ones. The cache here is a folder named by the contents of all files of
this package and of the function's own file:

    $NUMBA_CACHE_DIR, else $XDG_CACHE_HOME/gridpush_drake, else ~/.cache/gridpush_drake

or, where that cannot be written, beside the bytecode. A folder that is already there is read where
it cannot be written. Whoever makes a new one removes those that nobody has used for a month. Where
there is no such folder, what was compiled lasts as long as the process.

What this takes from inside Numba stands in `numba_internals`.

Reading a compiled function means unpickling it, which can run any code. So a folder is used only
where nobody but this user and root can change it or any folder above it, and a file only where it
belongs to one of the two. A file holds one compiled function behind a hash of its content; one
that is damaged is removed, and the function compiled anew.
"""

import grp
import hashlib
import os
import pickle
import pwd
import secrets
import shutil
import stat
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numba

from gridpush_drake.dynamics.kernels import numba_internals
from gridpush_drake.dynamics.kernels.numba_internals import NumbaCache, dump
from gridpush_drake.errors import NumbaError

FAST_SUMS = frozenset({"reassoc", "contract", "nsz", "arcp"})
"""What lets a sum over cells be vectorized; infinities and NaN keep their meaning."""

DIGEST_LENGTH = 16
"""Hexadecimal digits of the sources' hash in the folder's name."""

KEY_LENGTH = 24
"""Hexadecimal digits of the hash of a function's argument types, in its file's name."""

MAX_UNUSED_TIME = 30 * 86400.0
"""s since a folder was last used, after which it is removed."""

FOLDER_MODE = 0o755
"""Mode of a new cache folder: everybody may read it, only its owner may write in it."""

FILE_MODE = 0o644
"""Mode of a file in the cache: everybody may read it, only its owner may write it."""

ROOT_USER = 0
"""Number of the user who may change everything anyway."""

KERNELS_FOLDER = Path(__file__).parent

_THIS_PROCESS = secrets.token_hex(8)
"""A word that no other process has."""

POLL_TIME = 0.02
"""Time between two looks for a file that another process is to write, s."""

COMPILING_NOTICE = "gridpush: compiling kernels (once a machine, takes up to a minute) ..."
"""Said on standard error by the first call that compiles."""


@dataclass(frozen=True)
class Others:
    """Other processes that are filling the cache.

    Attributes:
        sources: the files whose kernels they compile.
        at_work: tells whether any of them is still at work.
    """

    sources: frozenset[Path]
    at_work: Callable[[], bool]


_OTHERS: Others | None = None
"""Other processes that are filling the cache for this one; None where there are none.

It is of the whole process, as a kernel may first be called in any of its threads.
"""


@contextmanager
def filled_by(others: Others) -> Iterator[None]:
    """Lets this process wait for kernels that others are compiling, instead of compiling them too.

    It waits for a kernel until that is in the cache, or all others have ended. What they did not
    compile it compiles itself.
    """
    global _OTHERS
    before = _OTHERS
    _OTHERS = others
    try:
        yield
    finally:
        _OTHERS = before


def kernel(
    *, allocates: bool = True, fast_sums: bool = False, inlined: bool = False
) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Compiles a function on its first call; without the GIL, with division as in C.

    A function whose name begins with an underscore can be called from kernels only.

    Args:
        allocates: whether it makes arrays, or is called with such as nobody else holds. One that
            does neither need not count references, which costs more than the rest of a small
            function.
        fast_sums: whether sums may be reordered and divisions by the same number shared.
        inlined: whether its code becomes part of every kernel that calls it. To hand over a record
            of arrays costs more than a small function does; but each call makes the caller larger.

    Returns:
        The decorator.
    """

    def compile_function(function: Callable[..., Any]) -> Callable[..., Any]:
        return numba_internals.make_dispatcher(
            function,
            KernelCache(function),
            counts_references=allocates,
            called_from_python=not function.__name__.startswith("_"),
            inlined=inlined,
            nogil=True,
            error_model="numpy",
            fastmath=set(FAST_SUMS) if fast_sums else False,
        )

    return compile_function


def get_cache(function: Callable[..., Any]) -> "KernelCache":
    """Takes the cache of a kernel."""
    found: KernelCache = numba_internals.get_cache(function)
    return found


def compile_for(function: Callable[..., Any], types: Sequence[Any]) -> None:
    """Compiles a kernel for some types of arguments, or finds it in the cache."""
    numba_internals.compile_for(function, types)


@cache
def calc_digest(source: Path) -> str:
    """Hashes the files of this package, and the file of a kernel that stands elsewhere.

    Args:
        source: that file.

    Returns:
        `DIGEST_LENGTH` hexadecimal digits, the same in every checkout of the same sources.
    """
    files = sorted(KERNELS_FOLDER.rglob("*.py"))
    if KERNELS_FOLDER not in source.parents:
        files.append(source)
    digest = hashlib.sha256()
    for file in files:
        digest.update(file.name.encode() + b"\0" + hashlib.sha256(file.read_bytes()).digest())
    return digest.hexdigest()[:DIGEST_LENGTH]


@cache
def find_cache_folder(source: Path) -> Path | None:
    """Finds the folder for the compiled kernels of one file: a filled one, else one that can be.

    A place that others can change is left out, and that is said on standard error.

    Returns:
        The folder, without symbolic links in its path; None where there is none.
    """
    name = f"kernels-{calc_digest(source)}"
    folders = []
    for place in _list_places():
        folder = Path(os.path.realpath(place / name))
        fault = find_ownership_fault(folder)
        if fault is None:
            folders.append(folder)
        else:
            _say_once(f"gridpush: {place} is not used for compiled kernels: {fault}")
    for folder in folders:
        with suppress(OSError):
            if any(folder.iterdir()):
                with suppress(OSError):
                    os.utime(folder)  # its last use
                return folder
    for folder in folders:
        with suppress(OSError):
            _make_folder(folder)
            with tempfile.TemporaryFile(dir=folder):
                _remove_unused(folder.parent)
                return folder
    return None


def _list_places() -> list[Path]:
    """The folders in which a cache folder may lie, the first one preferred."""
    given = os.environ.get("NUMBA_CACHE_DIR")
    if given:
        return [Path(given)]
    places = []
    home = Path(os.environ.get("XDG_CACHE_HOME", ""))
    if home.is_absolute():
        places.append(home / "gridpush_drake")
    else:
        # a user whom the system does not know by name has no home
        with suppress(RuntimeError):
            places.append(Path.home() / ".cache" / "gridpush_drake")
    return [*places, KERNELS_FOLDER / "__pycache__"]


def find_ownership_fault(folder: Path) -> str | None:
    """Says why what is in a folder may be another user's.

    Args:
        folder: without symbolic links in its path; it need not be there.

    Returns:
        The reason; None where only this user and root can change the folder, what is above it, and
        so what it holds. The folder itself may not even be of a shared group.
    """
    for part in (folder, *folder.parents):
        try:
            found = part.lstat()
        except (FileNotFoundError, NotADirectoryError):
            continue
        except OSError as error:
            return f"{part} cannot be looked at ({error.strerror})"
        if not stat.S_ISDIR(found.st_mode):
            return f"{part} is not a folder"
        if found.st_uid not in (os.getuid(), ROOT_USER):
            return f"{part} belongs to another user"
        # in a folder with the sticky bit, such as /tmp, others cannot rename what is mine
        sticky = part != folder and found.st_mode & stat.S_ISVTX
        if found.st_mode & stat.S_IWOTH and not sticky:
            return f"{part} can be written by every user"
        private = part != folder and _is_private_group(found.st_gid)
        if found.st_mode & stat.S_IWGRP and not (sticky or private):
            return f"{part} can be written by a group of users"
    return None


def _is_private_group(group: int) -> bool:
    """Whether a group is this user's alone: many systems make one of each user's name."""
    try:
        user = pwd.getpwuid(os.getuid())
        entry = grp.getgrgid(group)
    except KeyError:
        return False
    own = user.pw_gid == group and entry.gr_name == user.pw_name
    return own and set(entry.gr_mem) <= {user.pw_name}


def _make_folder(folder: Path) -> None:
    """Makes a folder, and those above it that are missing, which only this user can write in."""
    for part in (*reversed(folder.parents), folder):
        with suppress(FileExistsError):
            part.mkdir(FOLDER_MODE)


def _remove_unused(place: Path) -> None:
    """Removes the folders of other sources that were not used for long.

    Several processes may be at it at once.
    """
    for folder in place.glob(f"kernels-{'[0-9a-f]' * DIGEST_LENGTH}"):
        with suppress(OSError):
            if time.time() - folder.stat().st_mtime > MAX_UNUSED_TIME:
                shutil.rmtree(folder, ignore_errors=True)


@cache
def _say_once(text: str) -> None:
    """Prints a line on standard error, where there is one, once a process."""
    with suppress(OSError, ValueError, AttributeError):
        print(text, file=sys.stderr, flush=True)


class KernelCache(NumbaCache):
    """The compiled forms of one function.

    Each is in a file of its own, which is named by the types of the arguments.

    Several processes can so write at once. (Numba's own cache numbers the files in an index, where
    one process could find its number given to another one's file.)
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        """Looks for no folder yet, but hashes the sources now, as they are read."""
        self._function = function
        self._source = Path(function.__code__.co_filename)
        calc_digest(self._source)
        # <locals>, of a function within another one, is no part of a file's name.
        name = function.__qualname__.replace("<", "").replace(">", "")
        line = function.__code__.co_firstlineno
        self._stem = f"{self._source.stem}.{name}-{line}"

    @property
    def cache_path(self) -> str:
        """The folder; empty where there is none."""
        return str(find_cache_folder(self._source) or "")

    def list_files(self) -> list[Path]:
        """The files of this function that are there, whatever their arguments' types."""
        folder = find_cache_folder(self._source)
        return [] if folder is None else sorted(folder.glob(f"{self._stem}.*.nbc"))

    def find_file(self, signature: Any, codegen: Any) -> Path | None:
        """Names the function's file for some types of arguments; None if there is no folder."""
        folder = find_cache_folder(self._source)
        if folder is None:
            return None
        key = hashlib.sha256(repr(self._make_key(signature, codegen)).encode())
        return folder / f"{self._stem}.{key.hexdigest()[:KEY_LENGTH]}.nbc"

    def load_overload(self, signature: Any, target_context: Any) -> Any:
        """What was compiled for some types of arguments; None where it has to be compiled."""
        codegen = numba_internals.get_codegen(target_context)
        file = self.find_file(signature, codegen)
        compiled = None
        if file is not None:
            self._wait_for_others(file)
            try:
                data = _read(file)
                if data is not None:
                    key, types, reduced = pickle.loads(data)
                    if key == self._make_key(signature, codegen) and types == signature:
                        compiled = numba_internals.rebuild_result(target_context, reduced)
            except NumbaError:
                raise
            except Exception:
                # whatever was written there, it is not what this program would have written
                _say_once(f"gridpush: a damaged file in {file.parent} is compiled anew")
                with suppress(OSError):
                    file.unlink()
        if compiled is None:
            _say_once(COMPILING_NOTICE)
        return compiled

    def _wait_for_others(self, file: Path) -> None:
        """Waits for a file that another process is to write, see `filled_by`."""
        if _OTHERS is None or self._source not in _OTHERS.sources:
            return
        while not file.exists() and _OTHERS.at_work():
            _say_once(COMPILING_NOTICE)
            time.sleep(POLL_TIME)

    def save_overload(self, signature: Any, data: Any) -> None:
        """Keeps what was compiled, where that can be."""
        codegen = numba_internals.get_result_codegen(data)
        file = self.find_file(signature, codegen)
        if file is None or not numba_internals.can_be_kept(data):
            return
        key = self._make_key(signature, codegen)
        content = dump((key, signature, numba_internals.reduce_result(data)))
        with suppress(OSError):
            _write(file, content)

    def _make_key(self, signature: Any, codegen: Any) -> tuple[str, ...]:
        """What else the machine code depends on, besides the sources."""
        machine = numba_internals.describe_machine(codegen)
        # a function that is made within another one may hold values of that
        held = dump([cell.cell_contents for cell in self._function.__closure__ or ()])
        code = hashlib.sha256(self._function.__code__.co_code + held).hexdigest()
        laws = hash_own_records(signature)
        return (numba.__version__, sys.version, code, str(signature), laws, *machine)


def hash_own_records(signature: Any) -> str:
    """Hashes the files that define records of the user's own among a function's arguments.

    Such a record is the data of a friction law: the machine code holds that law's functions, whose
    file is not among the sources of this package. It may be a field of another record.

    Args:
        signature: the types of the arguments, or Numba's signature with them.

    Returns:
        A word that is another one whenever one of these files is. A record of a module without a
        file has one that holds for this process only.
    """
    found = set()
    for record in numba_internals.list_record_classes(getattr(signature, "args", signature)):
        if record.__module__.startswith(f"{__package__}."):
            continue
        file = getattr(sys.modules.get(record.__module__), "__file__", None)
        found.add(_THIS_PROCESS if file is None else calc_digest(Path(file)))
    return " ".join(sorted(found))


def _read(file: Path) -> bytes | None:
    """Reads the content of a file behind its hash.

    Returns:
        The content; None where there is no such file, or it is not this user's or root's alone.

    Raises:
        ValueError: the content is not that which was written.
    """
    try:
        descriptor = os.open(file, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    except OSError:
        return None
    with os.fdopen(descriptor, "rb") as opened:
        found = os.fstat(descriptor)
        mine = stat.S_ISREG(found.st_mode) and found.st_uid in (os.getuid(), ROOT_USER)
        if not mine or found.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
            return None
        content = opened.read()
    size = hashlib.sha256().digest_size
    if hashlib.sha256(content[size:]).digest() != content[:size]:
        raise ValueError
    return content[size:]


def _write(file: Path, content: bytes) -> None:
    """Writes content behind its hash, whole or not at all."""
    descriptor, name = tempfile.mkstemp(dir=file.parent, prefix=".writing-")
    temporary = Path(name)
    try:
        with os.fdopen(descriptor, "wb") as opened:
            opened.write(hashlib.sha256(content).digest())
            opened.write(content)
        temporary.chmod(FILE_MODE)
        temporary.replace(file)
    except BaseException:
        with suppress(OSError):
            temporary.unlink()
        raise
