"""The public data of other people that benches take with --data: a clone, or a folder of it.

| what | found anywhere below the folder by | public source |
|---|---|---|
| the paper's object masks | `NAME_label.pgm`; beside them, where there is one, `protocol.json` | PAPER_SOURCE |
| CMU's pushes | text files of that form, see `pushes.importers.cmu` | CMU_SOURCE |
| the MIT's pushes | MATLAB files with `record_all`, see `pushes.importers.mit` | MIT_SOURCE |
"""

from pathlib import Path

from scipy.io import whosmat

from gridpush_drake.errors import GridPushError
from gridpush_drake.pushes.importers.cmu import POSE_SIZE

PAPER_SOURCE = "GitHub changkyu/rss2020_changkyu"
CMU_SOURCE = "GitHub robinzhoucmu/MLab_EXP"
MIT_SOURCE = "GitHub robinzhoucmu/PlanarManipulationToolBox"

MASK_ENDING = "_label.pgm"
PROTOCOL = "protocol.json"
RECORDS = "record_all"
"""The variable of a MATLAB file that holds pushes."""


def find_masks(data: Path) -> dict[str, Path]:
    """Finds the paper's masks.

    Args:
        data: a folder.

    Returns:
        Their files by the objects' names.

    Raises:
        GridPushError: there is no such folder, no mask in it, or two of one name.
    """
    _check_folder(data, f"a clone of {PAPER_SOURCE}")
    masks: dict[str, Path] = {}
    for path in sorted(data.rglob(f"*{MASK_ENDING}")):
        name = path.name.removesuffix(MASK_ENDING)
        if name in masks:
            raise GridPushError(f"{path}: is a second mask of {name}, beside {masks[name]}; expected one of each")
        masks[name] = path
    if not masks:
        raise GridPushError(f"{data}: holds no mask; expected files NAME{MASK_ENDING}, as of {PAPER_SOURCE}")
    return masks


def find_protocol(masks: dict[str, Path]) -> Path | None:
    """Finds the file of the paper's drawn numbers beside the masks; None where there is none."""
    paths = [path.parent / PROTOCOL for path in masks.values()]
    return next((path for path in paths if path.is_file()), None)


def find_push_logs(data: Path, min_pushes: int) -> list[tuple[str, Path]]:
    """Finds real robots' push logs.

    Args:
        data: a folder.
        min_pushes: of a CMU file; others are passed over.

    Returns:
        The kind ("cmu" or "mit") and the file of each, CMU's first.

    Raises:
        GridPushError: there is no such folder, or no push log in it.
    """
    expected = f"push logs as of {CMU_SOURCE} (text files of {min_pushes} or more pushes) or of {MIT_SOURCE} (.mat)"
    _check_folder(data, expected)
    logs = [("cmu", path) for path in sorted(data.rglob("*.txt")) if _count_cmu_pushes(path) >= min_pushes]
    logs += [("mit", path) for path in sorted(data.rglob("*.mat")) if _has_records(path)]
    if not logs:
        raise GridPushError(f"{data}: holds no push log; expected {expected}")
    return logs


def _check_folder(data: Path, expected: str) -> None:
    if not data.is_dir():
        raise GridPushError(f"{data}: is no folder; expected {expected}")


def _count_cmu_pushes(path: Path) -> int:
    """How many pushes a file of CMU's form begins by saying it has; 0 for another file."""
    try:
        with path.open() as file:
            count, before, after = (file.readline().split() for _ in range(3))
        if len(count) == 1 and len(before) == len(after) == POSE_SIZE:
            return int(count[0])
    except (OSError, ValueError):
        pass
    return 0


def _has_records(path: Path) -> bool:

    try:
        return any(name == RECORDS for name, _, _ in whosmat(path))
    except (OSError, ValueError, TypeError, NotImplementedError):
        return False
