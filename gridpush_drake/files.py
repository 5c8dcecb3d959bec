"""Files that a user names: read within bounds, and written whole or not at all.

Several outputs of one command are written all or none, see `write_together`.

No file is overwritten that nobody asked to be.
"""

import os
import secrets
import shutil
import stat
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from gridpush_drake.errors import GridPushError, OutputError
from gridpush_drake.units import BYTES_PER_MEGABYTE

GZIP_MAGIC = b"\x1f\x8b"
"""First bytes of a file that gzip compressed."""

MAX_TEXT_SIZE = 64 * BYTES_PER_MEGABYTE
"""Largest size of a text file, bytes: about a million rows of a push log."""

TEMPORARY_PREFIX = ".gridpush-"
"""Beginning of the name of a file that is being written. It is short, so that a file can have any
name that the file system takes."""

NAME_BYTES = 8
"""Random bytes in the name of a file that is kept until others are written."""

MAX_BESIDE = 1000
"""Largest number of folders beside one that cannot be used that are tried."""

MAX_SHOWN = 200
"""Largest number of characters of a path that a message shows whole."""

SHOWN_END = 40
"""Number of characters that a message shows of each end of a longer path."""

NEW_MODE = 0o666
"""Mode of a new file, before the user's mask takes rights away."""

NON_BLOCKING = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
"""Flags with which a pipe that nobody writes to is opened at once."""


def open_file(path: Path | str, what: str, error: type[GridPushError], max_size: int) -> BinaryIO:
    """Opens a regular file for reading.

    Args:
        path: the file.
        what: what it should hold, for messages ("an object file").
        error: raised where it cannot be read.
        max_size: most bytes it may have.

    Returns:
        The open file, which the caller closes.

    Raises:
        GridPushError: `error`: there is no such file, no file can have this name, it is a folder, a
            pipe or a device, it is larger than `max_size`, or the system refuses.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | NON_BLOCKING)
    except (OSError, ValueError) as cause:
        raise error(
            f"{shorten_path(path)}: cannot be read: {_describe(cause)}; expected {what}"
        ) from cause
    problem = _find_problem(descriptor, max_size)
    if problem is None:
        return os.fdopen(descriptor, "rb")
    os.close(descriptor)
    raise error(f"{path}: {problem}; expected {what}")


def _find_problem(descriptor: int, max_size: int) -> str | None:
    """Says why an open file is none to be read; None where it is."""
    found = os.fstat(descriptor)
    if stat.S_ISDIR(found.st_mode):
        return "cannot be read: is a folder"
    if not stat.S_ISREG(found.st_mode):
        return "cannot be read: is a pipe or a device, not a file"
    if found.st_size > max_size:
        return (
            f"has {found.st_size / BYTES_PER_MEGABYTE:.0f} MB, more than "
            f"{max_size // BYTES_PER_MEGABYTE} MB"
        )
    try:
        os.pread(descriptor, 1, 0)  # a process's memory can be opened like a file, but not read
    except OSError as error:
        return f"cannot be read: {_describe(error)}"
    return None


def read_bytes(
    path: Path | str, what: str, error: type[GridPushError], max_size: int = MAX_TEXT_SIZE
) -> bytes:
    """Reads a regular file; the arguments and errors are those of `open_file`."""
    with open_file(path, what, error, max_size) as file:
        try:
            data = file.read(max_size + 1)
        except OSError as cause:
            raise error(f"{path}: cannot be read: {_describe(cause)}; expected {what}") from cause
    if len(data) > max_size:
        raise error(f"{path}: has more than {max_size // BYTES_PER_MEGABYTE} MB; expected {what}")
    return data


def read_text(
    path: Path | str, what: str, error: type[GridPushError], max_size: int = MAX_TEXT_SIZE
) -> str:
    """Reads a regular file of UTF-8 text, with or without a byte order mark.

    The arguments and errors are those of `open_file`.
    """
    content = read_bytes(path, what, error, max_size)
    if content.startswith(GZIP_MAGIC):
        raise error(f"{path}: is compressed by gzip; expected {what}, unpacked")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as cause:
        raise error(f"{path}: is not UTF-8 text; expected {what}") from cause


def read_head(path: Path | str, size: int) -> bytes:
    """Reads the first bytes of a regular file, at most `size`; none where it cannot be read."""
    try:
        with open_file(path, "a file", GridPushError, max_size=2**63) as file:
            return file.read(size)
    except (GridPushError, OSError):
        return b""


def is_file(path: Path | str) -> bool:
    """Whether there is such a regular file; False for what no file can be named."""
    return _holds(Path(path).is_file)


def exists(path: Path | str) -> bool:
    """Whether there is such a file or folder; False for what none can be named."""
    return _holds(Path(path).exists)


def is_same(path: Path | str, other: Path | str) -> bool:
    """Whether both name one file or folder that is there."""
    return _holds(lambda: Path(path).samefile(other))


def check_writable(path: Path | str, force: bool = False) -> Path:
    """Checks, before long work begins, that `path` may be written at its end.

    Args:
        path: the file to be written.
        force: whether an existing file may be replaced.

    Returns:
        `path` as a Path.

    Raises:
        OutputError: the file exists and `force` is not set, no file can have this name, or its
            folder is missing or read-only.
    """
    path = Path(path)
    try:
        path.lstat()
    except (FileNotFoundError, NotADirectoryError):
        pass
    except (OSError, ValueError) as error:
        raise OutputError(f"{shorten_path(path)}: cannot be written: {_describe(error)}") from error
    if path.is_dir():
        raise OutputError(f"{path}: is a folder; expected the name of a file")
    if path.exists():
        if not force:
            raise OutputError(f"{path}: exists already; pass --force to replace it")
        if not path.is_file():
            raise OutputError(f"{path}: is a pipe or a device; expected the name of a file")
    folder = path.parent
    if not folder.is_dir():
        raise OutputError(f"{path}: its folder {folder} does not exist")
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise OutputError(f"{path}: cannot write in {folder}: {error.strerror}") from error
    return path


@dataclass(frozen=True)
class _Draft:
    """A file that is written, but does not have its name yet.

    Attributes:
        temporary: where the content is, in the folder of `path`.
        path: the file that it becomes.
    """

    temporary: Path
    path: Path


_DRAFTS: ContextVar[list[_Draft] | None] = ContextVar("drafts", default=None)
"""The drafts of the `write_together` that is open; None where none is."""


@contextmanager
def write_together() -> Iterator[None]:
    """Lets all files that `write_whole` writes inside appear at the end, or none of them.

    A file that is replaced keeps its old content until then, and if any file cannot be written.
    Inside another `write_together`, the files are part of the outer one.

    Raises:
        OutputError: a file cannot be written.
    """
    if _DRAFTS.get() is not None:
        yield
        return
    drafts: list[_Draft] = []
    token = _DRAFTS.set(drafts)
    try:
        yield
        _publish(drafts)
    finally:
        _DRAFTS.reset(token)
        for draft in drafts:
            draft.temporary.unlink(missing_ok=True)


def write_whole(path: Path | str, content: str | bytes, force: bool = False) -> None:
    """Writes a file by way of a temporary one beside it, so that no half file is ever seen.

    Inside `write_together`, the file appears at the end of that.

    Args:
        path: the file to be written.
        content: text (written as UTF-8) or bytes.
        force: whether an existing file may be replaced.

    Raises:
        OutputError: as `check_writable`, or the disk refuses.
    """
    path = check_writable(path, force)
    data = content.encode() if isinstance(content, str) else content
    with write_together():
        drafts = _DRAFTS.get()
        assert drafts is not None
        try:
            with tempfile.NamedTemporaryFile(
                dir=path.parent, prefix=TEMPORARY_PREFIX, delete=False
            ) as file:
                drafts.append(_Draft(Path(file.name), path))
                file.write(data)
            # The mask can be read only by setting it.
            umask = os.umask(0)
            os.umask(umask)
            drafts[-1].temporary.chmod(NEW_MODE & ~umask)
        except OSError as error:
            raise OutputError(f"{path}: cannot be written: {error.strerror}") from error


def _publish(drafts: list[_Draft]) -> None:
    """Gives all drafts their names; if one cannot have it, everything is as it was before.

    Raises:
        OutputError: a file cannot have its name.
    """
    kept: dict[Path, Path] = {}
    done: list[Path] = []
    try:
        # One file alone is replaced at once, and needs nothing that could be put back.
        for draft in drafts if len(drafts) > 1 else []:
            try:
                if draft.path.exists() and draft.path not in kept:
                    kept[draft.path] = _keep(draft.path)
            except OSError as error:
                raise OutputError(f"{draft.path}: cannot be replaced: {error.strerror}") from error
        for draft in drafts:
            try:
                draft.temporary.replace(draft.path)
            except OSError as error:
                raise OutputError(f"{draft.path}: cannot be written: {error.strerror}") from error
            done.append(draft.path)
    except BaseException:
        for path in done:
            with suppress(OSError):
                if path in kept:
                    kept[path].replace(path)
                else:
                    path.unlink()
        raise
    finally:
        for old in kept.values():
            old.unlink(missing_ok=True)


def _keep(path: Path) -> Path:
    """Gives a file a second name beside it, under which it stays when it is replaced."""
    second = path.with_name(TEMPORARY_PREFIX + secrets.token_hex(NAME_BYTES))
    try:
        os.link(path, second)
    except OSError:  # as the file system has no second names
        try:
            shutil.copy2(path, second)
        except OSError:
            second.unlink(missing_ok=True)
            raise
    return second


def make_folder(path: Path | str) -> None:
    """Makes a folder for output, where it is missing. Raises OutputError where it cannot."""
    try:
        Path(path).mkdir(parents=True, exist_ok=True)
    except FileExistsError as error:
        raise OutputError(f"{shorten_path(path)}: is a file; expected a folder") from error
    except (OSError, ValueError) as error:
        raise OutputError(
            f"{shorten_path(path)}: cannot be made a folder: {_describe(error)}"
        ) from error


@contextmanager
def output_folder(path: Path | str) -> Iterator[None]:
    """Makes a folder for output, and takes it away again where nothing came of it.

    With it go the folders above it that were made for it.

    Raises:
        OutputError: it cannot be made.
    """
    path = Path(path)
    made = [folder for folder in (path, *path.parents) if not exists(folder)]
    make_folder(path)
    try:
        yield
    except BaseException:
        for folder in made:
            with suppress(OSError):  # as something is in it
                folder.rmdir()
        raise


def make_folder_beside(path: Path | str) -> Path:
    """Makes a new folder for files that cannot be written where they should be.

    It is beside that place, or else among temporary files.

    Raises:
        OutputError: neither can be made.
    """
    path = Path(path)
    for number in range(1, MAX_BESIDE + 1):
        beside = path.with_name(f"{path.name}-{number}")
        try:
            beside.mkdir()
        except FileExistsError:
            continue
        except OSError:
            break
        return beside
    try:
        return Path(tempfile.mkdtemp(prefix=f"{path.name}-"))
    except OSError as error:
        raise OutputError(f"{path}: cannot be written, nor anything else: {error}") from error


def shorten_path(path: Path | str) -> str:
    """Makes a path fit for a message: printable, and of one longer than any file's both ends."""
    text = str(path).replace("\0", "\\0")
    return text if len(text) <= MAX_SHOWN else f"{text[:SHOWN_END]}...{text[-SHOWN_END:]}"


def _holds(question: Callable[[], bool]) -> bool:
    """Whether something holds of a path; False where no file can be named by it."""
    try:
        return question()
    except (OSError, ValueError):
        return False


def _describe(error: OSError | ValueError) -> str:
    """Says in words why a path cannot be opened."""
    if isinstance(error, OSError):
        return error.strerror or str(error)
    return "its name holds a character that no file's name has (NUL)"
