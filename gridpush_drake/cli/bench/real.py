"""`gridpush bench real`: real robots' pushes."""

from pathlib import Path
from typing import Annotated, Any

import typer

from gridpush_drake.bench.real import run
from gridpush_drake.bench.table import Table
from gridpush_drake.cli import options
from gridpush_drake.cli.bench.common import Logs, Objects, run_as_bench


@run_as_bench
def real(
    data: Logs = None,
    objects: Objects = None,
    splits: Annotated[
        int, typer.Option(min=1, help="Divisions of a log into pushes to learn from and others.")
    ] = 10,
    figure: Annotated[
        Path | None,
        typer.Option(
            metavar="FIGURE.png",
            callback=options.PNG,
            help="Also draw the error against the number of pushes.",
        ),
    ] = None,
    force: options.Force = False,
    **common: Any,
) -> list[Table]:
    """Learn from real robots' pushes (--data), or simulated ones in their place, and predict others of them."""
    return run(data, objects=objects, splits=splits, figure=figure, force=force, **common)
