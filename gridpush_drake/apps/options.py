"""Options that several commands share."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from gridpush_drake.errors import GridPushError

ObjectOrModel = Annotated[
    str,
    typer.Argument(
        metavar="OBJECT_OR_MODEL",
        help="An object file, a model that `gridpush identify` wrote, or the name of a shipped object.",
        show_default=False,
    ),
]

PushesFile = Annotated[
    Path,
    typer.Argument(
        metavar="PUSHES.csv",
        help="A push log: push,t,tip_x,tip_y,object_x,object_y,object_theta[,force_x,force_y][,overhang].",
        show_default=False,
    ),
]

Force = Annotated[bool, typer.Option("--force", help="Replace output files that exist.")]

Json = Annotated[bool, typer.Option("--json", help="Print one JSON document on standard output, and nothing else.")]

LargestPiece = Annotated[bool, typer.Option("--largest-piece", help="Of a mask in several pieces, keep the largest.")]

Regime = Annotated[
    Literal["auto", "quasi_static", "inertial"],
    typer.Option(help="Slow pushes are quasi_static, fast ones inertial."),
]

Seed = Annotated[int, typer.Option(min=0, help="Of everything random.")]


class OptionError(GridPushError):
    """An option's value is not of its form."""


def parse_numbers(option: str, text: str, names: str) -> tuple[float, ...]:
    """Reads numbers separated by commas.

    Args:
        option: its name, for the message.
        text: what was given.
        names: the form, such as "x,y".

    Returns:
        As many finite numbers as `names` has.

    Raises:
        OptionError: the text is something else.
    """
    from math import isfinite

    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != len(names.split(",")) or not all(map(isfinite, numbers)):
        raise OptionError(
            f"{option}: is {text!r}; expected {names}, such as {','.join(['0.1'] * len(names.split(',')))}"
        )
    return numbers
