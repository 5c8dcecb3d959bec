"""Where the public data sets are looked for."""

from pathlib import Path

from gridpush_drake.errors import GridPushError

SHARED = Path("shared", "data")
"""Looked for in every folder above this file's, and above the current one."""


def find_shared_data() -> Path:
    """Finds the folder of the public data beside the repository.

    Raises:
        GridPushError: it is not there.
    """
    for folder in (*Path(__file__).resolve().parents, *Path.cwd().parents):
        if (folder / SHARED).is_dir():
            return folder / SHARED
    raise GridPushError(f"no folder {SHARED} above the repository or the current folder; pass the data's with --data")
