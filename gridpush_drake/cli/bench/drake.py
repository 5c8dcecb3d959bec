"""`gridpush bench drake`: Drake's plant beside the grid LCP, and the whole station."""

from typing import Annotated, Any, Literal

import typer

from gridpush_drake.bench.drake import run
from gridpush_drake.bench.table import Table
from gridpush_drake.cli import options
from gridpush_drake.cli.bench.common import run_as_bench


@run_as_bench
def drake(
    camera: Annotated[
        Literal["ideal", "rgbd"],
        typer.Option(
            help="rgbd: only the station, which learns from a color and depth camera, and from ideal poses."
        ),
    ] = "ideal",
    **common: Any,
) -> list[Table]:
    """Set Drake's plant beside the grid LCP, time the LCP system, and let the whole station learn."""
    options.compile_kernels()
    return run(camera=camera, **common)
