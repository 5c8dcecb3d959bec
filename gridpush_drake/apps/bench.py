"""`gridpush bench`: the measurements, as tables."""

from collections.abc import Sequence
from pathlib import Path
from sys import stderr
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from gridpush_drake.apps import options
from gridpush_drake.apps.console import print_json, print_table, step_progress, to_json

if TYPE_CHECKING:
    from gridpush_drake.bench.table import Table

app = typer.Typer(no_args_is_help=True, help="Measure speed and accuracy.")

Data = Annotated[
    Path | None,
    typer.Option(metavar="DIR", help="Folder of masks, cmu_pushes, mit_pushes; by default shared/data above this one."),
]
Quick = Annotated[bool, typer.Option("--quick", help="Fewer runs: to see that it works.")]
Out = Annotated[
    Path | None, typer.Option("--out", "-o", metavar="FILE", help="Also write the tables: .md, or .json for JSON.")
]


@app.command("speed")
def speed(
    data: Data = None,
    repetitions: Annotated[int, typer.Option(min=3, help="Runs of each simulation.")] = 50,
    mujoco: Annotated[bool, typer.Option(help="Run MuJoCo beside, where it is installed.")] = True,
    out: Out = None,
    force: options.Force = False,
    json: options.Json = False,
) -> None:
    """Time a simulated push, its gradient, MuJoCo beside, the cost against the number of cells, and start-up."""
    from gridpush_drake.apps.kernels import compile_kernels
    from gridpush_drake.bench.speed import run

    _check((out,), force)
    compile_kernels()
    with step_progress("timing") as progress:
        tables = run(data, repetitions=repetitions, with_mujoco=mujoco, progress=progress)
    _show(tables, out, force, json)


@app.command("paper")
def paper(
    data: Data = None,
    quick: Quick = False,
    budget: Annotated[int | None, typer.Option(min=1, help="Most simulated pushes of an identification.")] = None,
    seed: options.Seed = 0,
    figure: Annotated[
        Path | None, typer.Option(metavar="FIGURE.png", help="Also draw the error against the number of simulations.")
    ] = None,
    out: Out = None,
    force: options.Force = False,
    json: options.Json = False,
) -> None:
    """Repeat the paper's simulated identification, every method beside the others."""
    from gridpush_drake.apps.kernels import compile_kernels
    from gridpush_drake.bench.paper import BUDGET, run

    _check((out, figure), force)
    compile_kernels()
    tables = run(
        data and data / "masks", budget=budget or BUDGET, seed=seed, quick=quick, figure=figure, force=force,
        progress=stderr.isatty(),
    )  # fmt: skip
    _show(tables, out, force, json)


@app.command("real")
def real(
    data: Data = None,
    quick: Quick = False,
    seed: options.Seed = 0,
    figure: Annotated[
        Path | None, typer.Option(metavar="FIGURE.png", help="Also draw the error against the number of pushes.")
    ] = None,
    out: Out = None,
    force: options.Force = False,
    json: options.Json = False,
) -> None:
    """Learn from real robots' pushes, and predict others of them."""
    from gridpush_drake.apps.kernels import compile_kernels
    from gridpush_drake.bench.real import run

    _check((out, figure), force)
    compile_kernels()
    tables = run(data, seed=seed, quick=quick, figure=figure, force=force, progress=stderr.isatty())
    _show(tables, out, force, json)


@app.command("planning")
def planning(
    data: Data = None,
    quick: Quick = False,
    sets: Annotated[int, typer.Option(min=1, help="Parameter and mass sets of each object.")] = 10,
    seed: options.Seed = 0,
    out: Out = None,
    force: options.Force = False,
    json: options.Json = False,
) -> None:
    """Choose contact points, and push objects to goal poses on the paper's round table."""
    from gridpush_drake.apps.kernels import compile_kernels
    from gridpush_drake.bench.planning import run

    _check((out,), force)
    compile_kernels()
    tables = run(data and data / "masks", sets=sets, seed=seed, quick=quick, progress=stderr.isatty())
    _show(tables, out, force, json)


@app.command("pregrasp")
def pregrasp(
    quick: Quick = False,
    mass_sets: Annotated[int | None, typer.Option(min=1, help="Hidden sets of masses and frictions an object.")] = None,
    seeds: Annotated[int | None, typer.Option(min=1, help="Tables, starts and noises a set.")] = None,
    depth: Annotated[float, typer.Option(help="Of the gripper's fingers: what must hang over, m.")] = 0.03,
    experiment: Annotated[
        Literal["all", "sliding", "exploring"], typer.Option(help="Which of the two to measure.")
    ] = "all",
    seed: options.Seed = 0,
    out: Out = None,
    force: options.Force = False,
    json: options.Json = False,
) -> None:
    """Slide objects of hidden masses to the table's edge, and compare pokes by design with random ones."""
    from gridpush_drake.apps.kernels import compile_kernels
    from gridpush_drake.bench.pregrasp import MASS_SETS, SEEDS, run

    _check((out,), force)
    compile_kernels()
    tables = run(
        mass_sets=mass_sets or MASS_SETS, seeds=seeds or SEEDS, seed=seed, depth=depth, experiment=experiment,
        quick=quick, progress=stderr.isatty(),
    )  # fmt: skip
    _show(tables, out, force, json)


@app.command("grasp")
def grasp(
    quick: Quick = False,
    objects: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="A shipped object; may be repeated. By default three.")
    ] = None,
    seeds: Annotated[int | None, typer.Option(min=1, help="Hidden truths and noises an object.")] = None,
    seed: options.Seed = 0,
    out: Out = None,
    force: options.Force = False,
    json: options.Json = False,
) -> None:
    """Let the whole station poke objects, slide them to the table's edge, grasp and lift them."""
    from gridpush_drake.apps.kernels import compile_kernels
    from gridpush_drake.bench.pregrasp_station import OBJECTS, SEEDS, run

    _check((out,), force)
    compile_kernels()
    chosen = range(seed, seed + (seeds or len(SEEDS)))
    tables = run(objects or OBJECTS, chosen, quick=quick, progress=stderr.isatty())
    _show(tables, out, force, json)


@app.command("drake")
def drake(
    quick: Quick = False,
    seed: options.Seed = 0,
    out: Out = None,
    force: options.Force = False,
    json: options.Json = False,
) -> None:
    """Set Drake's plant beside the grid LCP, time the LCP system, and let the whole station learn."""
    from gridpush_drake.apps.kernels import compile_kernels
    from gridpush_drake.bench import lcp_system, plant, station

    _check((out,), force)
    compile_kernels()
    with step_progress("GridLcpSystem") as report:
        tables = lcp_system.run(progress=report)
    shown = stderr.isatty()
    if quick:
        tables += plant.run(plant.OBJECTS[:1], 2, seed=seed, progress=shown)
        tables += station.run(station.OBJECTS[:1], (seed,), progress=shown)
    else:
        tables += plant.run(seed=seed, progress=shown)
        tables += station.run(seeds=[seed + s for s in station.SEEDS], progress=shown)
    _show(tables, out, force, json)


def _check(paths: "Sequence[Path | None]", force: bool) -> None:
    from gridpush_drake.files import check_writable

    for path in paths:
        if path is not None:
            check_writable(path, force)


def _show(tables: "Sequence[Table]", out: Path | None, force: bool, json: bool) -> None:
    """Prints the tables, and writes them where asked."""
    from gridpush_drake.files import write_whole

    document = {"tables": [table.to_dict() for table in tables]}
    if out is not None:
        markdown = "\n".join(table.to_markdown() for table in tables)
        write_whole(out, to_json(document) if out.suffix == ".json" else markdown, force)
    if json:
        print_json(document)
        return
    for table in tables:
        print_table(table.to_rich())
