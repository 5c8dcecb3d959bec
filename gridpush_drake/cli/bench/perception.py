"""`gridpush bench perception`: objects in photographs, and their poses in videos."""

from pathlib import Path
from typing import Annotated, Any

import typer

from gridpush_drake.bench.perception import run
from gridpush_drake.bench.table import Table
from gridpush_drake.cli.bench.common import Objects, run_as_bench


@run_as_bench
def perception(
    data: Annotated[
        Path | None,
        typer.Option(
            "--data", metavar="DIR", help="Real photographs too: a folder with NAME_color.png, NAME_depth.png and"
            " NAME_label.pgm.",
        ),
    ] = None,
    objects: Objects = None,
    **common: Any,
) -> list[Table]:  # fmt: skip
    """Find objects in photographs, real and rendered, and track them while they are pushed."""
    return run(data, objects, **common)
