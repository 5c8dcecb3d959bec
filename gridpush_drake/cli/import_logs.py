"""`gridpush import`: public data sets to a push log and an object file.

What is slow to import is imported when the command runs, so that `gridpush` starts fast.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gridpush_drake.cli import options
from gridpush_drake.cli.console import print_json, print_line
from gridpush_drake.errors import OutputError

if TYPE_CHECKING:
    from gridpush_drake.objects.grid_object import GridObject
    from gridpush_drake.pushes.push_log import PushLog

app = typer.Typer(no_args_is_help=True, help="Convert a public data set to a push log and an object file.")

OutDir = Annotated[
    Path | None,
    typer.Option(metavar="DIR", help="Folder for pushes.csv and object.yaml, made if missing; or name both:"),
]
OutCsv = Annotated[Path | None, typer.Option(metavar="PUSHES.csv", help="The push log to write.")]
OutObject = Annotated[Path | None, typer.Option(metavar="OBJECT.yaml", help="The object file to write.")]


@app.command("cmu")
def cmu(
    log: Annotated[Path, typer.Argument(metavar="LOG.txt", help="A file of GitHub robinzhoucmu/MLab_EXP.")],
    out_dir: OutDir = None,
    out_csv: OutCsv = None,
    out_object: OutObject = None,
    calibrate: Annotated[bool, typer.Option(help="Correct the logged tool point to the tip's center.")] = True,
    shuffle: Annotated[bool, typer.Option(help="Put the pushes in random order.")] = True,
    uniform_plate: Annotated[
        bool, typer.Option("--uniform-plate", help="Take the block's center of mass as known to be at its centroid.")
    ] = False,
    seed: options.Seed = 0,
    force: options.Force = False,
    json: options.Json = False,
) -> None:
    """Import pushes of a triangular block (Zhou, Paolini, Bagnell, Mason, ICRA 2016)."""
    from gridpush_drake.pushes.importers.cmu import BLOCK_CELLS, import_cmu

    paths = _check_outputs(out_dir, out_csv, out_object, force)
    pushes, obj = import_cmu(log, calibrate=calibrate, shuffle=shuffle, seed=seed, uniform_plate=uniform_plate)
    _write(pushes, obj, BLOCK_CELLS, paths, force, json)


@app.command("mit")
def mit(
    file: Annotated[Path, typer.Argument(metavar="FILE.mat", help="A file of the MIT push data set, start and end.")],
    out_dir: OutDir = None,
    out_csv: OutCsv = None,
    out_object: OutObject = None,
    shape: Annotated[
        str | None, typer.Option(help="The shape's name, such as rect1; by default as the file's name or content says.")
    ] = None,
    object_file: Annotated[
        str | None, typer.Option("--object", metavar="OBJECT.yaml", help="The object, where its shape is not known.")
    ] = None,
    force: options.Force = False,
    json: options.Json = False,
) -> None:
    """Import pushes of the MIT push data set (Yu, Bauza, Fazeli, Rodriguez, IROS 2016)."""
    from gridpush_drake.pushes.importers.mit import MIT_CELLS, import_mit

    paths = _check_outputs(out_dir, out_csv, out_object, force)
    given = options.load_object(object_file) if object_file else None
    pushes, obj = import_mit(file, shape=shape, obj=given)
    _write(pushes, obj, obj.n if given else MIT_CELLS, paths, force, json)


def _check_outputs(
    out_dir: Path | None, out_csv: Path | None, out_object: Path | None, force: bool
) -> tuple[Path, Path]:
    from gridpush_drake.files import check_writable, make_folder

    if (out_dir is None) == (out_csv is None or out_object is None):
        raise OutputError("--out-dir: expected a folder, or both --out-csv and --out-object instead of it")
    if out_dir is not None:
        make_folder(out_dir)
    folder = out_dir or Path()
    paths = out_csv or folder / "pushes.csv", out_object or folder / "object.yaml"
    for path in paths:
        check_writable(path, force)
    return paths


def _write(
    pushes: "PushLog", obj: "GridObject", max_cells: int, paths: tuple[Path, Path], force: bool, json: bool
) -> None:

    pushes.write_csv(paths[0], force)
    obj.write_yaml(paths[1], max_cells=max_cells, force=force)
    if json:
        print_json({"object": obj.name, "cells": obj.n, "pushes": len(pushes), "written": list(map(str, paths))})
    else:
        print_line(f"{len(pushes)} pushes of {obj.name}. Wrote {paths[0]} and {paths[1]}.")
