"""`gridpush bench`: the measurements, as tables.

What is slow to import is imported when the command runs, so that `gridpush` starts fast.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from gridpush_drake.cli import options
from gridpush_drake.cli.console import print_json, print_table, to_json, work_progress

if TYPE_CHECKING:
    from gridpush_drake.bench.jobs import Execution
    from gridpush_drake.bench.table import Table

app = typer.Typer(no_args_is_help=True, help="Measure speed and accuracy, on the objects that ship with the package.")

Masks = Annotated[
    Path | None,
    typer.Option(
        "--data", metavar="DIR", help="The paper's objects too: a clone of GitHub changkyu/rss2020_changkyu, or another"
        " folder of masks, NAME_label.pgm.",
    ),
]  # fmt: skip
Logs = Annotated[
    Path | None,
    typer.Option(
        "--data", metavar="DIR", help="Real pushes: a clone of GitHub robinzhoucmu/MLab_EXP or"
        " robinzhoucmu/PlanarManipulationToolBox, or a folder of such logs. Without, simulated pushes stand in.",
    ),
]  # fmt: skip
Quick = Annotated[bool, typer.Option("--quick", help="Fewer runs: to see that it works.")]
Objects = Annotated[
    list[str] | None,
    typer.Option(metavar="NAME", help="An object; may be repeated.", show_default="all of the bench's"),
]
KeptIn = Annotated[
    Path | None,
    typer.Option(
        "--results", metavar="FILE.jsonl", help="Where each finished job's result is kept. A job that is found there is"
        " not run again; a file of other settings is refused, and --force begins it anew.",
        show_default="in gridpush_bench, a file for each choice of settings and version of the program",
    ),
]  # fmt: skip
Out = Annotated[
    Path | None, typer.Option("--out", "-o", metavar="FILE", help="Also write the tables: .md, or .json for JSON.")
]


@app.command("speed")
def speed(
    data: Masks = None,
    repetitions: Annotated[int, typer.Option(min=3, help="Runs of each simulation.")] = 50,
    mujoco: Annotated[bool, typer.Option(help="Run MuJoCo beside, where it is installed.")] = True,
    out: Out = None,
    force: options.Force = False,
    json: options.Json = False,
) -> None:
    """Time a push, its gradient, MuJoCo beside, the cost against the number of cells, identification and start-up."""
    from gridpush_drake.bench.speed import load_hammer, run

    _check((out,), force)
    obj = load_hammer(data)
    options.compile_kernels()
    with work_progress("timing") as report:
        tables = run(obj, repetitions=repetitions, with_mujoco=mujoco, report=report)
    _show(tables, out, force, json)


@app.command("paper")
def paper(
    data: Masks = None,
    quick: Quick = False,
    objects: Objects = None,
    sets: Annotated[int, typer.Option(min=1, help="Mass sets of each object.")] = 10,
    methods: Annotated[
        list[str] | None,
        typer.Option("--method", metavar="NAME", help="A method; may be repeated.", show_default="all"),
    ] = None,
    budget: Annotated[int, typer.Option(min=1, help="Most simulated pushes of an identification.")] = 1500,
    seed: options.Seed = 0,
    figure: Annotated[
        Path | None, typer.Option(metavar="FIGURE.png", help="Also draw the error against the number of simulations.")
    ] = None,
    figures: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Instead draw the paper's own figures there, as PNG and SVG, from fewer runs: mass maps, error against"
            " simulations, real pushes, contact points, the hammer at the edge. About 15 minutes on two cores.",
        ),
    ] = None,
    workers: options.Workers = options.WORKERS,
    dask: options.Dask = None,
    results: KeptIn = None,
    out: Out = None,
    force: options.Force = False,
    json: options.Json = False,
) -> None:
    """Repeat the paper's simulated identification, every method beside the others."""
    from gridpush_drake.bench.paper import run
    from gridpush_drake.identification.learning import METHODS

    _check((out, figure), force)
    if figures is not None:
        from gridpush_drake.bench import paper_figures

        counts = paper_figures.QUICK if quick else paper_figures.Counts()
        chosen = {"data": _resolve(data), "quick": quick, "objects": objects, "methods": methods, "seed": seed}
        with _run_bench("paper_figures", chosen, results, workers, dask, force) as execution:
            tables = paper_figures.run(
                figures, data, objects, methods or METHODS, seed, execution, counts=counts, force=force
            )
        _show(tables, out, force, json)
        return
    settings = {
        "data": _resolve(data), "quick": quick, "objects": objects, "sets": sets, "methods": methods, "budget": budget,
        "seed": seed, "figure": figure is not None,
    }  # fmt: skip
    with _run_bench("paper", settings, results, workers, dask, force) as execution:
        tables = run(
            data, sets, objects, methods or METHODS, budget, seed, execution, quick=quick, figure=figure, force=force
        )
    _show(tables, out, force, json)


@app.command("real")
def real(
    data: Logs = None,
    quick: Quick = False,
    objects: Objects = None,
    splits: Annotated[int, typer.Option(min=1, help="Divisions of a log into pushes to learn from and others.")] = 10,
    seed: options.Seed = 0,
    figure: Annotated[
        Path | None, typer.Option(metavar="FIGURE.png", help="Also draw the error against the number of pushes.")
    ] = None,
    workers: options.Workers = options.WORKERS,
    dask: options.Dask = None,
    results: KeptIn = None,
    out: Out = None,
    force: options.Force = False,
    json: options.Json = False,
) -> None:
    """Learn from real robots' pushes (--data), or simulated ones in their place, and predict others of them."""
    from gridpush_drake.bench.real import run

    _check((out, figure), force)
    settings = {"data": _resolve(data), "quick": quick, "objects": objects, "splits": splits, "seed": seed}
    with _run_bench("real", settings, results, workers, dask, force) as execution:
        tables = run(
            data,
            objects=objects,
            splits=splits,
            seed=seed,
            quick=quick,
            figure=figure,
            force=force,
            execution=execution,
        )
    _show(tables, out, force, json)


@app.command("planning")
def planning(
    data: Masks = None,
    quick: Quick = False,
    objects: Objects = None,
    sets: Annotated[int, typer.Option(min=1, help="Parameter and mass sets of each object.")] = 10,
    part: Annotated[Literal["all", "contact", "push"], typer.Option(help="Which to measure.")] = "all",
    seed: options.Seed = 0,
    workers: options.Workers = options.WORKERS,
    dask: options.Dask = None,
    results: KeptIn = None,
    out: Out = None,
    force: options.Force = False,
    json: options.Json = False,
) -> None:
    """Choose contact points, and push objects to goal poses on the paper's round table."""
    from gridpush_drake.bench.planning import PARTS, run

    _check((out,), force)
    settings = {
        "data": _resolve(data), "quick": quick, "objects": objects, "sets": sets, "part": part, "seed": seed
    }  # fmt: skip
    parts = PARTS if part == "all" else (part,)
    with _run_bench("planning", settings, results, workers, dask, force) as execution:
        tables = run(data, sets, objects, parts=parts, seed=seed, execution=execution, quick=quick)
    _show(tables, out, force, json)


@app.command("pregrasp")
def pregrasp(
    data: Masks = None,
    quick: Quick = False,
    objects: Objects = None,
    mass_sets: Annotated[int | None, typer.Option(min=1, help="Hidden sets of masses and frictions an object.")] = None,
    seeds: Annotated[int | None, typer.Option(min=1, help="Tables, starts and noises a set.")] = None,
    depth: Annotated[float, typer.Option(help="Depth of the gripper's fingers, which must hang over, m.")] = 0.03,
    experiment: Annotated[
        Literal["all", "sliding", "exploring"], typer.Option(help="Which of the two to measure.")
    ] = "all",
    world: Annotated[
        Literal["lcp", "mujoco"], typer.Option(help="What moves the objects: the model's own simulator, or MuJoCo.")
    ] = "lcp",
    support: Annotated[
        Literal["foundation", "three_feet", "vertices", "half_height"],
        typer.Option(help="How objects stand in MuJoCo."),
    ] = "foundation",
    friction: Annotated[
        tuple[float, float],
        typer.Option(
            metavar="LEAST GREATEST", help="Bounds of the friction of any part against the table, true and known."
        ),
    ] = (0.3, 0.4),
    seed: options.Seed = 0,
    workers: options.Workers = options.WORKERS,
    dask: options.Dask = None,
    results: KeptIn = None,
    out: Out = None,
    force: options.Force = False,
    json: options.Json = False,
) -> None:
    """Slide objects of hidden masses to the table's edge, and compare pokes by design with random ones."""
    from gridpush_drake.bench.pregrasp import MASS_SETS, SEEDS, run

    _check((out,), force)
    settings = {
        "data": _resolve(data), "quick": quick, "objects": objects, "mass_sets": mass_sets, "seeds": seeds,
        "depth": depth, "experiment": experiment, "world": world, "support": support, "friction": friction,
        "seed": seed,
    }  # fmt: skip
    with _run_bench("pregrasp", settings, results, workers, dask, force) as execution:
        tables = run(
            objects, mass_sets or MASS_SETS, seeds or SEEDS, seed=seed, execution=execution, depth=depth,
            experiment=experiment, quick=quick, data=data, friction=friction,
            support=support if world == "mujoco" else None,
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
    workers: options.Workers = options.WORKERS,
    dask: options.Dask = None,
    results: KeptIn = None,
    out: Out = None,
    force: options.Force = False,
    json: options.Json = False,
) -> None:
    """Let the whole station poke objects, slide them to the table's edge, grasp and lift them."""
    from gridpush_drake.bench.grasp import OBJECTS, SEEDS, run

    _check((out,), force)
    chosen = range(seed, seed + (seeds or len(SEEDS)))
    settings = {"quick": quick, "objects": objects, "seeds": seeds, "seed": seed}
    with _run_bench("grasp", settings, results, workers, dask, force) as execution:
        tables = run(objects or OBJECTS, chosen, quick=quick, execution=execution)
    _show(tables, out, force, json)


@app.command("truth")
def truth(
    quick: Quick = False,
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
        typer.Option(min=1, help="How many pushes to learn from; may be repeated.", show_default="3, 5, 8, 18"),
    ] = None,
    seed: options.Seed = 0,
    workers: options.Workers = options.WORKERS,
    dask: options.Dask = None,
    results: KeptIn = None,
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
    json: options.Json = False,
) -> None:
    """Learn bodies that do not obey the model: MuJoCo pushes them, on feet, foundations and uneven bottoms."""
    from gridpush_drake.bench.truth import COUNTS, run
    from gridpush_drake.bench.truth_sets import KINDS

    settings = {
        "quick": quick, "kinds": kinds, "objects": objects, "sets": sets, "pushes": pushes, "seed": seed,
        "out": _resolve(out),
    }  # fmt: skip
    with _run_bench("truth", settings, results, workers, dask, force) as execution:
        tables = run(
            kinds or KINDS, objects, sets, pushes or COUNTS, seed, execution, quick=quick, out=_resolve(out),
            force=force,
        )  # fmt: skip
    _show(tables, None, force, json)


@app.command("drake")
def drake(
    quick: Quick = False,
    seed: options.Seed = 0,
    workers: options.Workers = options.WORKERS,
    dask: options.Dask = None,
    results: KeptIn = None,
    out: Out = None,
    force: options.Force = False,
    json: options.Json = False,
) -> None:
    """Set Drake's plant beside the grid LCP, time the LCP system, and let the whole station learn."""
    from gridpush_drake.bench import drake, plant

    _check((out,), force)
    with _run_bench("drake", {"quick": quick, "seed": seed}, results, workers, dask, force) as execution:
        options.compile_kernels()
        tables = drake.run_lcp_system(report=execution.report)
        tables += [] if quick else drake.run_updates(report=execution.report)
        if quick:
            tables += plant.run(plant.OBJECTS[:1], 2, seed=seed, execution=execution)
            tables += drake.run(drake.OBJECTS[:1], (seed,), execution)
        else:
            tables += plant.run(seed=seed, execution=execution)
            tables += drake.run(seeds=[seed + s for s in drake.SEEDS], execution=execution)
    _show(tables, out, force, json)


@app.command("perception")
def perception(
    data: Annotated[
        Path | None,
        typer.Option(
            "--data", metavar="DIR", help="Real photographs too: a folder with NAME_color.png, NAME_depth.png and"
            " NAME_label.pgm.",
        ),
    ] = None,
    quick: Quick = False,
    objects: Objects = None,
    seed: options.Seed = 0,
    workers: options.Workers = options.WORKERS,
    dask: options.Dask = None,
    results: KeptIn = None,
    out: Out = None,
    force: options.Force = False,
    json: options.Json = False,
) -> None:  # fmt: skip
    """Find objects in photographs, real and rendered, and track them while they are pushed."""
    from gridpush_drake.bench.perception import run

    _check((out,), force)
    settings = {"data": _resolve(data), "quick": quick, "objects": objects, "seed": seed}
    with _run_bench("perception", settings, results, workers, dask, force) as execution:
        tables = run(data, objects, seed=seed, quick=quick, execution=execution)
    _show(tables, out, force, json)


@app.command("gym")
def gym(
    quick: Quick = False,
    games: Annotated[
        list[str] | None,
        typer.Option("--game", metavar="NAME", help="A game; may be repeated.", show_default="all three"),
    ] = None,
    episodes: Annotated[int, typer.Option(min=2, help="Episodes of each game that each player plays.")] = 20,
    seed: options.Seed = 0,
    workers: options.Workers = options.WORKERS,
    dask: options.Dask = None,
    results: KeptIn = None,
    out: Out = None,
    force: options.Force = False,
    json: options.Json = False,
) -> None:
    """Time the Gymnasium environments; let our planner, a small learned player and chance play them."""
    from gridpush_drake.bench.gym import run

    _check((out,), force)
    settings = {"quick": quick, "games": games, "episodes": episodes, "seed": seed}
    with _run_bench("gym", settings, results, workers, dask, force) as execution:
        tables = run(games, episodes, seed, execution, quick=quick)
    _show(tables, out, force, json)


@contextmanager
def _run_bench(
    bench: str, settings: dict[str, Any], path: Path | None, workers: int, dask: str | None, force: bool
) -> "Iterator[Execution]":
    """How a bench's jobs are run: their results are kept, and what is done is shown."""
    from gridpush_drake.bench.jobs import open_results

    results = open_results(path, bench, settings, force)
    with (
        options.connecting(dask) as executor,
        options.executing(bench, results, workers, executor) as execution,
    ):
        yield execution


def _resolve(path: Path | None) -> Path | None:
    return None if path is None else path.resolve()


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
        print_table(table)
