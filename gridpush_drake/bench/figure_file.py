"""Figures as files."""

from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

from gridpush_drake.errors import OutputError
from gridpush_drake.files import check_writable, write_whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DPI = 150

ENDINGS = (".png", ".pdf", ".svg")


def check_figure(path: Path | str, force: bool) -> None:
    """Checks, before long work begins, that a figure may be written. Raises OutputError where it may not."""
    if Path(path).suffix.lower() not in ENDINGS:
        raise OutputError(f"{path}: is of an unknown kind; expected a name that ends in {', '.join(ENDINGS)}")
    check_writable(path, force)


def save_figure(figure: "Figure", path: Path | str, force: bool) -> None:
    """Writes a figure in the format of the path's ending. Raises OutputError as `check_figure` does."""
    buffer = BytesIO()
    figure.savefig(buffer, format=Path(path).suffix.lstrip("."), dpi=DPI)
    write_whole(path, buffer.getvalue(), force)
