"""`gridpush bench paper`: the paper's simulated protocol, every method beside the others."""

from pathlib import Path
from typing import Annotated, Any

import typer

from gridpush_drake.bench import paper_figures
from gridpush_drake.bench.paper import run
from gridpush_drake.bench.table import Table
from gridpush_drake.cli import options
from gridpush_drake.cli.bench.common import Masks, Objects, run_as_bench
from gridpush_drake.identification.learning import METHODS


@run_as_bench
def paper(
    data: Masks = None,
    objects: Objects = None,
    sets: Annotated[int, typer.Option(min=1, help="Mass sets of each object.")] = 10,
    methods: Annotated[
        list[str] | None,
        typer.Option(
            "--method", metavar="NAME", help="A method; may be repeated.", show_default="all"
        ),
    ] = None,
    budget: Annotated[
        int, typer.Option(min=1, help="Most simulated pushes of an identification.")
    ] = 1500,
    figure: Annotated[
        Path | None,
        typer.Option(
            metavar="FIGURE.png",
            callback=options.PNG,
            help="Also draw the error against the number of simulations.",
        ),
    ] = None,
    figures: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Instead draw the paper's own figures there, as PNG and SVG, from fewer runs: mass maps, error against"
            " simulations, real pushes, contact points, the hammer at the edge. About 15 minutes on two cores.",
        ),
    ] = None,
    force: options.Force = False,
    **common: Any,
) -> list[Table]:
    """Repeat the paper's simulated identification, every method beside the others."""
    chosen = methods or METHODS
    if figures is not None:
        return paper_figures.run(figures, data, objects, chosen, force=force, **common)
    return run(data, sets, objects, chosen, budget, figure=figure, force=force, **common)
