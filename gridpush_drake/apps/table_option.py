"""The `--table` option: a rectangular, a round or a polygonal table."""

from typing import TYPE_CHECKING, Annotated

import typer

from gridpush_drake.apps.options import OptionError

if TYPE_CHECKING:
    from gridpush_drake.planning.surface import SupportSurface

FORMS = "rectangle:WxH@x,y, round:R@x,y or polygon:x,y;x,y;x,y (m)"

Table = Annotated[str, typer.Option("--table", metavar="SHAPE", help=f"The table's top: {FORMS}.", show_default=False)]


def parse_table(text: str) -> "SupportSurface":
    """Reads a table.

    Args:
        text: `rectangle:0.8x0.6@0,0` (sides along x and y, then the centre), `round:0.5@0.6,0` (radius, then the
            centre) or `polygon:0,0;1,0;0,1` (corners), m; a centre left out is the world's origin.

    Returns:
        The table.

    Raises:
        OptionError: the text is of no such form.
        PlanningError: a side or radius is not positive, or the polygon crosses itself.
    """
    from gridpush_drake.planning.surface import SupportSurface

    kind, _, rest = text.partition(":")
    size, _, centre = rest.partition("@")
    at = _read(text, centre, ",", 2) if centre else [0.0, 0.0]
    if kind == "rectangle":
        return SupportSurface.rectangle(at, _read(text, size, "x", 2))
    if kind == "round":
        return SupportSurface.round(at, _read(text, size, "x", 1)[0])
    if kind == "polygon" and not centre:
        return SupportSurface.from_polygon([_read(text, corner, ",", 2) for corner in rest.split(";")])
    raise OptionError(f"--table: is {text!r}; expected {FORMS}")


def _read(whole: str, text: str, separator: str, count: int) -> list[float]:
    try:
        numbers = [float(part) for part in text.split(separator)]
    except ValueError:
        numbers = []
    if len(numbers) != count:
        raise OptionError(f"--table: is {whole!r}; expected {FORMS}")
    return numbers
