"""`gridpush bench grasp`: the whole station pokes, slides, grasps and lifts objects."""

from typing import Annotated, Any

import typer

from gridpush_drake.bench.grasp import OBJECTS, SEEDS, run
from gridpush_drake.bench.table import Table
from gridpush_drake.cli import options
from gridpush_drake.cli.bench.common import Objects, run_as_bench


@run_as_bench
def grasp(
    objects: Objects = None,
    seeds: Annotated[
        int | None, typer.Option(min=1, help="Hidden truths and noises an object.")
    ] = None,
    seed: options.Seed = 0,
    **common: Any,
) -> list[Table]:
    """Let the whole station poke objects, slide them to the table's edge, grasp and lift them."""
    return run(objects or OBJECTS, range(seed, seed + (seeds or len(SEEDS))), **common)
