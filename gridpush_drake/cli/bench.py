"""`gridpush bench`: the measurements, as tables."""

from collections.abc import Callable, Sequence
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from gridpush_drake.cli import options
from gridpush_drake.cli.console import print_json, print_table, to_json, work_progress

if TYPE_CHECKING:
    from gridpush_drake.bench.table import Table

app = typer.Typer(
    no_args_is_help=True,
    help="Measure speed and accuracy, on the objects that ship with the package.",
)

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
Objects = Annotated[
    list[str] | None,
    typer.Option(
        metavar="NAME", help="An object; may be repeated.", show_default="all of the bench's"
    ),
]
Out = Annotated[
    Path | None,
    typer.Option(
        "--out", "-o", metavar="FILE", help="Also write the tables: .md, or .json for JSON."
    ),
]

COMMON: dict[str, tuple[Any, Any]] = {
    "quick": (Annotated[bool, typer.Option("--quick", help="Fewer runs: to see that it works.")], False),
    "seed": (options.Seed, 0),
    "workers": (options.Workers, options.WORKERS),
    "dask": (options.Dask, None),
    "results": (
        Annotated[
            Path | None,
            typer.Option(
                metavar="FILE.jsonl", help="Where each finished job's result is kept. A job that is found there is not"
                " run again; a file of other settings is refused, and --force begins it anew.",
                show_default="in gridpush_bench, a file for each choice of settings and version of the program",
            ),
        ],
        None,
    ),
    "out": (Out, None),
    "force": (options.Force, False),
    "json": (options.Json, False),
}  # fmt: skip
"""Options of every bench that runs jobs, with their defaults."""

NO_SETTINGS = {"figure", "figures", "force"}
"""Options of some benches that change no job's result."""


def _add(bench: Callable[..., "list[Table]"]) -> Callable[..., "list[Table]"]:
    """Adds a bench as a command: its own options, and COMMON.

    It is called with its options, and with `quick`, `seed` and `execution`; what it has of COMMON
    itself is its own affair, such as where `out` goes.
    """
    name = bench.__name__
    own = {
        key: each
        for key, each in signature(bench).parameters.items()
        if each.kind is not Parameter.VAR_KEYWORD
    }

    def command(
        workers: int, dask: str | None, results: Path | None, json: bool, **given: Any
    ) -> None:
        from gridpush_drake.bench.jobs import open_results

        out = None if "out" in own else given.pop("out")
        force = given["force"] if "force" in own else given.pop("force")
        options.check_outputs(force, out)
        settings = {
            key: value.resolve() if isinstance(value, Path) else value
            for key, value in given.items()
            if key not in NO_SETTINGS
        }
        with options.executing(
            name, workers, dask, lambda: open_results(results, name, settings, force)
        ) as execution:  # fmt: skip
            tables = bench(**given, execution=execution)
        _show(tables, out, force, json)

    parameters = [
        each.replace(kind=Parameter.KEYWORD_ONLY) for key, each in own.items() if key not in COMMON
    ]
    for key, (annotation, default) in COMMON.items():
        common = Parameter(key, Parameter.KEYWORD_ONLY, default=default, annotation=annotation)
        parameters.append(own[key].replace(kind=Parameter.KEYWORD_ONLY) if key in own else common)
    command.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    command.__annotations__ = {each.name: each.annotation for each in parameters}
    app.command(name, help=bench.__doc__)(command)
    return bench


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

    options.check_outputs(force, out)
    obj = load_hammer(data)
    options.compile_kernels()
    with work_progress("timing") as report:
        tables = run(obj, repetitions=repetitions, with_mujoco=mujoco, report=report)
    _show(tables, out, force, json)


@_add
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
) -> "list[Table]":
    """Repeat the paper's simulated identification, every method beside the others."""
    from gridpush_drake.bench import paper_figures
    from gridpush_drake.bench.paper import run
    from gridpush_drake.identification.learning import METHODS

    chosen = methods or METHODS
    if figures is not None:
        return paper_figures.run(figures, data, objects, chosen, force=force, **common)
    return run(data, sets, objects, chosen, budget, figure=figure, force=force, **common)


@_add
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
) -> "list[Table]":
    """Learn from real robots' pushes (--data), or simulated ones in their place, and predict others of them."""
    from gridpush_drake.bench.real import run

    return run(data, objects=objects, splits=splits, figure=figure, force=force, **common)


@_add
def planning(
    data: Masks = None,
    objects: Objects = None,
    sets: Annotated[int, typer.Option(min=1, help="Parameter and mass sets of each object.")] = 10,
    part: Annotated[
        Literal["all", "contact", "push"], typer.Option(help="Which to measure.")
    ] = "all",
    **common: Any,
) -> "list[Table]":
    """Choose contact points, and push objects to goal poses on the paper's round table."""
    from gridpush_drake.bench.planning import PARTS, run

    return run(data, sets, objects, parts=PARTS if part == "all" else (part,), **common)


@_add
def pregrasp(
    data: Masks = None,
    objects: Objects = None,
    mass_sets: Annotated[
        int | None, typer.Option(min=1, help="Hidden sets of masses and frictions an object.")
    ] = None,
    seeds: Annotated[
        int | None, typer.Option(min=1, help="Tables, starts and noises a set.")
    ] = None,
    depth: Annotated[
        float, typer.Option(help="Depth of the gripper's fingers, which must hang over, m.")
    ] = 0.03,
    experiment: Annotated[
        Literal["all", "sliding", "exploring", "materials", "bounds"],
        typer.Option(
            help="What to measure: all stands for sliding and exploring; materials are objects of rubber and steel; "
            "bounds of the friction are judged by what they allow at best."
        ),
    ] = "all",
    truths: Annotated[
        list[str] | None,
        typer.Option(
            "--truth",
            metavar="TRUTH",
            help="What moves the objects, on rectangular tables: lcp, the model's own simulator, or MuJoCo bodies that "
            "stand as own_weight, half_height, foundation, vertices or three_feet; may be repeated.",
            show_default="the model's own simulator, on any table",
        ),
    ] = None,
    max_arm: Annotated[
        float,
        typer.Option(help="How far from its believed center of mass an object may be taken, m."),
    ] = 0.06,
    friction: Annotated[
        tuple[float, float],
        typer.Option(
            metavar="LEAST GREATEST",
            help="Bounds of the friction of any part against the table, true and known.",
        ),
    ] = (0.3, 0.4),
    **common: Any,
) -> "list[Table]":
    """Slide objects of hidden masses to the table's edge, and compare pokes by design with random ones."""
    from gridpush_drake.bench.pregrasp.experiments import MASS_SETS, SEEDS, run

    return run(
        objects, mass_sets or MASS_SETS, seeds or SEEDS, depth=depth, experiment=experiment, data=data,
        friction=friction, truths=truths, max_arm=max_arm, **common,
    )  # fmt: skip


@_add
def grasp(
    objects: Objects = None,
    seeds: Annotated[
        int | None, typer.Option(min=1, help="Hidden truths and noises an object.")
    ] = None,
    seed: options.Seed = 0,
    **common: Any,
) -> "list[Table]":
    """Let the whole station poke objects, slide them to the table's edge, grasp and lift them."""
    from gridpush_drake.bench.grasp import OBJECTS, SEEDS, run

    return run(objects or OBJECTS, range(seed, seed + (seeds or len(SEEDS))), **common)


@_add
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
) -> "list[Table]":
    """Learn bodies that do not obey the model: MuJoCo pushes them, on feet, foundations and uneven bottoms."""
    from gridpush_drake.bench.truth.learning import COUNTS, run
    from gridpush_drake.bench.truth.sets import KINDS

    folder = None if out is None else out.resolve()
    return run(kinds or KINDS, objects, sets, pushes or COUNTS, out=folder, force=force, **common)


@_add
def drake(
    camera: Annotated[
        Literal["ideal", "rgbd"],
        typer.Option(
            help="rgbd: only the station, which learns from a color and depth camera, and from ideal poses."
        ),
    ] = "ideal",
    **common: Any,
) -> "list[Table]":
    """Set Drake's plant beside the grid LCP, time the LCP system, and let the whole station learn."""
    from gridpush_drake.bench.drake import run

    options.compile_kernels()
    return run(camera=camera, **common)


@_add
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
) -> "list[Table]":  # fmt: skip
    """Find objects in photographs, real and rendered, and track them while they are pushed."""
    from gridpush_drake.bench.perception import run

    return run(data, objects, **common)


@_add
def gym(
    games: Annotated[
        list[str] | None,
        typer.Option(
            "--game", metavar="NAME", help="A game; may be repeated.", show_default="all three"
        ),
    ] = None,
    episodes: Annotated[
        int, typer.Option(min=2, help="Episodes of each game that each player plays.")
    ] = 20,
    **common: Any,
) -> "list[Table]":
    """Time the Gymnasium environments; let our planner, a small learned player and chance play them."""
    from gridpush_drake.bench.gym import run

    return run(games, episodes, **common)
