"""`gridpush bench speed`: how long a push, its gradient, identification and start-up take."""

from typing import Annotated

import typer

from gridpush_drake.bench.speed import load_hammer, run
from gridpush_drake.cli import options
from gridpush_drake.cli.bench.common import Masks, Out, show_tables
from gridpush_drake.cli.console import work_progress


def speed(
    data: Masks = None,
    repetitions: Annotated[int, typer.Option(min=3, help="Runs of each simulation.")] = 50,
    mujoco: Annotated[bool, typer.Option(help="Run MuJoCo beside, where it is installed.")] = True,
    out: Out = None,
    force: options.Force = False,
    json: options.Json = False,
) -> None:
    """Time a push, its gradient, MuJoCo beside, the cost against the number of cells, identification and start-up."""
    options.check_outputs(force, out)
    obj = load_hammer(data)
    options.compile_kernels()
    with work_progress("timing") as report:
        tables = run(obj, repetitions=repetitions, with_mujoco=mujoco, report=report)
    show_tables(tables, out, force, json)
