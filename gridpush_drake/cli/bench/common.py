"""What the benches' commands share: options, and how a bench is run and its tables shown."""

from collections.abc import Callable, Sequence
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import Annotated, Any

import typer

from gridpush_drake.bench.jobs import open_results
from gridpush_drake.bench.table import Table
from gridpush_drake.cli import options
from gridpush_drake.cli.console import print_json, print_table, to_json
from gridpush_drake.files import write_whole

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


def run_as_bench(bench: Callable[..., list[Table]]) -> Callable[..., None]:
    """Makes a command of a bench: with its own options, and those of COMMON.

    Args:
        bench: measures, and returns the tables. It is called with its own options, and with
            `quick`, `seed` and `execution`. An option of COMMON that it declares itself, such as
            `out`, is passed on to it instead of being dealt with here.

    Returns:
        The function that Typer runs as a command; its help is the bench's docstring.
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
        show_tables(tables, out, force, json)

    parameters = [
        each.replace(kind=Parameter.KEYWORD_ONLY) for key, each in own.items() if key not in COMMON
    ]
    for key, (annotation, default) in COMMON.items():
        common = Parameter(key, Parameter.KEYWORD_ONLY, default=default, annotation=annotation)
        parameters.append(own[key].replace(kind=Parameter.KEYWORD_ONLY) if key in own else common)
    command.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    command.__annotations__ = {each.name: each.annotation for each in parameters}
    command.__doc__ = bench.__doc__
    return command


def show_tables(tables: Sequence[Table], out: Path | None, force: bool, json: bool) -> None:
    """Prints the tables, and writes them where asked."""
    document = {"tables": [table.to_dict() for table in tables]}
    if out is not None:
        markdown = "\n".join(table.to_markdown() for table in tables)
        write_whole(out, to_json(document) if out.suffix == ".json" else markdown, force)
    if json:
        print_json(document)
        return
    for table in tables:
        print_table(table)
