"""`gridpush bench planning`: contact points, and pushes to a goal pose."""

from typing import Annotated, Any, Literal

import typer

from gridpush_drake.bench.planning import PARTS, run
from gridpush_drake.bench.table import Table
from gridpush_drake.bench.worlds import LCP
from gridpush_drake.cli.bench.common import Masks, Objects, run_as_bench


@run_as_bench
def planning(
    data: Masks = None,
    objects: Objects = None,
    sets: Annotated[int, typer.Option(min=1, help="Parameter and mass sets of each object.")] = 10,
    part: Annotated[
        Literal["all", "contact", "push"], typer.Option(help="Which to measure.")
    ] = "all",
    world: Annotated[
        str,
        typer.Option(
            metavar="WORLD",
            help="What moves the objects that are pushed: lcp, edge, mujoco or drake, or MODULE:CLASS of a world of "
            "your own.",
        ),
    ] = LCP,
    **common: Any,
) -> list[Table]:
    """Choose contact points, and push objects to goal poses on the paper's round table."""
    return run(
        data, sets, objects, parts=PARTS if part == "all" else (part,), world=world, **common
    )
