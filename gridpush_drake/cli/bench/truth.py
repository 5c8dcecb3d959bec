"""`gridpush bench truth`: bodies that do not obey the model."""

from pathlib import Path
from typing import Annotated, Any

import typer

from gridpush_drake.bench.table import Table
from gridpush_drake.bench.truth.learning import COUNTS, run
from gridpush_drake.bench.truth.sets import KINDS
from gridpush_drake.cli import options
from gridpush_drake.cli.bench.common import Objects, run_as_bench


@run_as_bench
def truth(
    kinds: Annotated[
        list[str] | None,
        typer.Option(
            "--kind",
            metavar="KIND",
            help="own_weight, half_height, foundation, vertices, three_feet or overhang; may be repeated.",
            show_default="all but overhang",
        ),
    ] = None,
    objects: Objects = None,
    sets: Annotated[int, typer.Option(min=1, help="Hidden bodies of each kind and object.")] = 3,
    pushes: Annotated[
        list[int] | None,
        typer.Option(
            min=1,
            help="How many pushes to learn from; may be repeated.",
            show_default="3, 5, 8, 18",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            metavar="DIR",
            help="Leave object files, pushes and truths there; those that are there are"
            " read, and made anew with --force.",
        ),
    ] = None,
    force: options.Force = False,
    **common: Any,
) -> list[Table]:
    """Learn bodies that do not obey the model: MuJoCo pushes them, on feet, foundations and uneven bottoms."""
    folder = None if out is None else out.resolve()
    return run(kinds or KINDS, objects, sets, pushes or COUNTS, out=folder, force=force, **common)
