"""Makes a command of a study.

Its options are the fields of the study's own options, and those that all studies have.
"""

from collections.abc import Sequence
from dataclasses import Field, fields
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import typer

from gridpush_drake.bench.study import Study
from gridpush_drake.cli.shell import options
from gridpush_drake.cli.shell.console import print_json, print_table, to_json, work_progress
from gridpush_drake.cli.shell.lazy_group import declare
from gridpush_drake.files import write_whole
from gridpush_drake.jobs.results import open_results
from gridpush_drake.jobs.run import Execution
from gridpush_drake.report.table import Table

Out = Annotated[
    Path | None,
    typer.Option(
        "--out", "-o", metavar="FILE", help="Also write the tables: .md, or .json for JSON."
    ),
]
Quick = Annotated[bool, typer.Option("--quick", help="Make fewer runs, to see that it works.")]
ResultsFile = Annotated[
    Path | None,
    typer.Option(
        "--results",
        metavar="FILE.jsonl",
        help="Where each finished job's result is kept. A job that is found there is not run "
        "again; a file of other settings is refused, and --force begins it anew.",
        show_default="in gridpush_bench, a file for each choice of settings and version of the "
        "program",
    ),
]

OF_JOBS: dict[str, tuple[Any, Any]] = {
    "quick": (Quick, False),
    "seed": (options.Seed, 0),
    "workers": (options.Workers, options.DEFAULT_WORKERS),
    "dask": (options.Dask, None),
    "results": (ResultsFile, None),
}
"""Annotations and defaults of the options that every study with jobs has."""

OF_TABLES: dict[str, tuple[Any, Any]] = {
    "out": (Out, None),
    "force": (options.Force, False),
    "json": (options.Json, False),
}
"""Annotations and defaults of the options that every study has."""


def make_command(study: Study[Any]) -> Any:
    """Makes the function that Typer runs as a study's command.

    An option that the study declares itself, such as `out`, takes the place of the one of all
    studies.
    """
    own = _describe_options(study)
    shared = (OF_JOBS if study.tasks else {}) | OF_TABLES
    known = own | {name: each for name, each in shared.items() if name not in own}

    def command(**given: Any) -> None:
        json = given.pop("json")
        out = None if "out" in own else given.pop("out")
        options.check_outputs(given["force"], out)
        running = {
            name: given.pop(name)
            for name in ("workers", "dask", "results")
            if name in given and name not in own
        }
        chosen = study.options(**{name: _to_tuple(value) for name, value in given.items()})
        if study.tasks:
            settings = describe_settings(study, given)
            with options.executing(
                study.name,
                running["workers"],
                running["dask"],
                lambda: open_results(running["results"], study.name, settings, chosen.force),
            ) as execution:
                tables = study.run(chosen, execution)
        else:
            with work_progress(study.name) as report:
                tables = study.run(
                    chosen, Execution(report=report, prepare=options.compile_kernels)
                )
        show_tables(tables, out, chosen.force, json)

    return declare(command, known, study.help)


def describe_settings(study: Study[Any], given: dict[str, Any]) -> dict[str, Any]:
    """Returns those of the given options that results depend on, with paths in full."""
    names = {each.name for each in fields(study.options) if each.metadata.get("is_setting", True)}
    return {
        name: value.resolve() if isinstance(value, Path) else value
        for name, value in given.items()
        if name in names
    }


def show_tables(tables: Sequence[Table], out: Path | None, force: bool, json: bool) -> None:
    """Prints the tables, and writes them where asked."""
    document: dict[str, Any] = {}
    for table in tables:
        document.update(table.figures)
    document["tables"] = [table.to_dict() for table in tables]
    if out is not None:
        markdown = "\n".join(table.to_markdown() for table in tables)
        write_whole(out, to_json(document) if out.suffix == ".json" else markdown, force)
    if json:
        print_json(document)
        return
    for table in tables:
        print_table(table)


def _describe_options(study: Study[Any]) -> dict[str, tuple[Any, Any]]:
    """Returns annotation and default of each option that a study declares itself."""
    types = get_type_hints(study.options)
    found = {}
    for each in fields(study.options):
        if each.metadata.get("text"):
            found[each.name] = (_annotate(each, types[each.name]), each.default)
    return found


def _annotate(each: Field[Any], kind: Any) -> Any:
    """Returns a field's type as Typer takes it, with what the help says."""
    said = each.metadata
    settings = {
        "metavar": said["metavar"],
        "help": said["text"],
        "min": said["least"],
        "show_default": said["shown"] or True,
    }
    if said["ending"] is not None:
        settings["callback"] = options.expect_ending(said["ending"])
    names = [name for name in (said["name"], said["short"]) if name is not None]
    return Annotated[_to_list(kind), typer.Option(*names, **settings)]


LIST_TYPES = {
    tuple[str, ...]: list[str],
    tuple[str, ...] | None: list[str] | None,
    tuple[int, ...]: list[int],
    tuple[int, ...] | None: list[int] | None,
}
"""Types of options that may be repeated, as a study has them and as Typer takes them."""


def _to_list(kind: Any) -> Any:
    """Returns a type as Typer takes it: a list where the option may be repeated."""
    return LIST_TYPES.get(kind, kind)


def _to_tuple(value: Any) -> Any:
    """Returns a repeated option's values as a study takes them, None where it was not given."""
    if not isinstance(value, list):
        return value
    return tuple(value) or None
