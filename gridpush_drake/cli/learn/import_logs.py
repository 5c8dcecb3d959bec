"""`gridpush import`: converts public data sets and ROS bags to a push log and an object file.

There is a command for each importer in `pushes.importers`. Its options are the importer's fields,
so that a new importer needs nothing here.
"""

import dataclasses
from inspect import Parameter
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import typer
from typer.core import TyperGroup

from gridpush_drake.cli.shell import options
from gridpush_drake.cli.shell.console import count_noun, print_found
from gridpush_drake.cli.shell.lazy_group import declare, make_single, refuse_unknown
from gridpush_drake.errors import OutputError
from gridpush_drake.files import exists, make_folder
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import OBJECT_FILE, speak_name
from gridpush_drake.pushes.importers import IMPORTER_CLASSES, Importer, find_importer
from gridpush_drake.pushes.push_csv import PUSHES_FILE

OutDir = Annotated[
    Path | None,
    typer.Option(
        metavar="DIR",
        help="Folder to write pushes.csv and object.yaml to; it is made if it is missing. Give "
        "either this, or both --out-csv and --out-object.",
    ),
]
OutCsv = Annotated[
    Path | None,
    typer.Option(metavar="PUSHES.csv", help="The push log to write, without --out-dir."),
]
OutObject = Annotated[
    Path | None,
    typer.Option(metavar="OBJECT.yaml", help="The object file to write, without --out-dir."),
]

OUTPUT_OPTIONS = {
    "out_dir": (OutDir, None),
    "out_csv": (OutCsv, None),
    "out_object": (OutObject, None),
}
"""Annotations and defaults of the options of every importer that say what to write."""

FLAG_OPTIONS = {"force": (options.Force, False), "json": (options.Json, False)}
"""Annotations and defaults of the other options of every importer."""


class ImporterGroup(TyperGroup):
    """A group with one command for each importer, which is imported only when it is asked for."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Returns the importers' names."""
        return list(IMPORTER_CLASSES)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Returns the command of an importer, or None if there is no importer of this name."""
        if cmd_name not in self.commands and cmd_name in self.list_commands(ctx):
            self.commands[cmd_name] = _make_command(cmd_name, find_importer(cmd_name))
        return super().get_command(ctx, cmd_name)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Finds the importer that the words name; refuses one that is not there."""
        refuse_unknown(ctx.command_path, args[:1], self.list_commands(ctx))
        return super().resolve_command(ctx, args)


app = typer.Typer(
    cls=ImporterGroup,
    no_args_is_help=True,
    help="Convert a public data set or a ROS bag to a push log and an object file.",
)


def _make_command(name: str, importer: type[Importer]) -> Any:
    """Makes the command of an importer, whose options are the importer's fields."""
    types = get_type_hints(importer)
    fields = {field.name: field for field in dataclasses.fields(importer)}  # type: ignore[arg-type]

    def run(
        file: Path,
        out_dir: Path | None,
        out_csv: Path | None,
        out_object: Path | None,
        force: bool,
        json: bool,
        **chosen: Any,
    ) -> None:
        csv_path, object_path = _check_outputs(out_dir, out_csv, out_object, force)
        for key, value in chosen.items():
            if value is not None and _is_object(types[key]):
                chosen[key] = options.load_object(value)
        pushes, obj = importer(**chosen).read(file)
        if out_dir is not None:
            make_folder(out_dir)
        pushes.write_csv(csv_path, force)
        obj.write_yaml(object_path, force=force)
        found = {
            "object": obj.name,
            "cells": obj.n,
            "pushes": len(pushes),
            "written": [str(csv_path), str(object_path)],
        }
        count = count_noun(len(pushes), "push")
        print_found(
            found, [f"{count} of {speak_name(obj.name)}. Wrote {csv_path} and {object_path}."], json
        )

    file = Annotated[
        Path, typer.Argument(metavar=importer.file, help=f"The file to convert: {importer.source}.")
    ]
    own = {
        key: (_describe_option(field, types[key]), field.default) for key, field in fields.items()
    }
    shown = {"file": (file, Parameter.empty)} | OUTPUT_OPTIONS | own | FLAG_OPTIONS
    summary = (importer.__doc__ or "").partition("\n")[0]
    further = getattr(importer, "example", "")
    example = f"Example: gridpush import {name} {importer.file} {further} --out-dir FOLDER"
    return make_single(name, declare(run, shown, f"{summary}\n\n{example}"))


def _describe_option(field: dataclasses.Field[Any], kind: Any) -> Any:
    """Returns the option of an importer's field, as Typer reads it from an annotation."""
    names = [field.metadata["name"]] if "name" in field.metadata else []
    if _is_object(kind):
        return Annotated[
            str | None, typer.Option(*names, metavar="OBJECT.yaml", help=field.metadata["help"])
        ]
    return Annotated[kind, typer.Option(*names, help=field.metadata["help"])]


def _is_object(kind: Any) -> bool:
    """Returns whether a field holds an object, which the user names by its file."""
    return kind == GridObject | None


def _check_outputs(
    out_dir: Path | None, out_csv: Path | None, out_object: Path | None, force: bool
) -> tuple[Path, Path]:
    """Returns the paths of the push log and of the object file, after checking them.

    Nothing is made yet, so that a command that fails later leaves no empty folder.
    """
    if (out_dir is None) == (out_csv is None or out_object is None):
        raise OutputError(
            "--out-dir: expected a folder, or both --out-csv and --out-object instead of it"
        )
    folder = out_dir or Path()
    csv_path = out_csv or folder / PUSHES_FILE
    object_path = out_object or folder / OBJECT_FILE
    if out_dir is None or out_dir.is_dir():
        options.check_outputs(force, csv_path, object_path)
    elif exists(out_dir):
        raise OutputError(f"--out-dir: {out_dir} is a file; expected a folder")
    return csv_path, object_path
