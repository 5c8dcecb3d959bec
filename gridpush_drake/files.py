"""Files are written whole or not at all, and nothing a user made is overwritten unasked."""

import os
import tempfile
from pathlib import Path

from gridpush_drake.errors import OutputError


def check_writable(path: Path | str, force: bool = False) -> Path:
    """Checks, before long work begins, that `path` may be written at its end.

    Args:
        path: the file to be written.
        force: whether an existing file may be replaced.

    Returns:
        `path` as a Path.

    Raises:
        OutputError: the file exists and `force` is not set, or its folder is missing or read-only.
    """
    path = Path(path)
    if path.is_dir():
        raise OutputError(f"{path}: is a folder; expected the name of a file")
    if path.exists() and not force:
        raise OutputError(f"{path}: exists already; pass --force to replace it")
    folder = path.parent
    if not folder.is_dir():
        raise OutputError(f"{path}: its folder {folder} does not exist")
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise OutputError(f"{path}: cannot write in {folder}: {error.strerror}") from error
    return path


def write_whole(path: Path | str, content: str | bytes, force: bool = False) -> None:
    """Writes `content` to `path` by way of a temporary file beside it, so that no half file is ever seen.

    Args:
        path: the file to be written.
        content: text (written as UTF-8) or bytes.
        force: whether an existing file may be replaced.

    Raises:
        OutputError: as `check_writable`, or the disk refuses.
    """
    path = check_writable(path, force)
    data = content.encode() if isinstance(content, str) else content
    temporary = None
    try:
        with tempfile.NamedTemporaryFile(dir=path.parent, prefix=f".{path.name}.", delete=False) as file:
            temporary = Path(file.name)
            file.write(data)
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)
        temporary.replace(path)
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror}") from error
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)
