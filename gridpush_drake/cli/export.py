"""`gridpush export`: an object or a learned model as a model for other simulators.

What is slow to import is imported when the command runs, so that `gridpush` starts fast.
"""

from pathlib import Path
from typing import Annotated, Literal

import typer

from gridpush_drake.cli import options
from gridpush_drake.cli.console import print_json, print_line

SUFFIX = ".sdf"


def export(
    target: options.ObjectOrModel,
    out: Annotated[Path, typer.Argument(metavar="OUT.sdf", help="The file to write.", show_default=False)],
    base: Annotated[
        Literal["free", "planar"],
        typer.Option(help="Six degrees of freedom, or held to the table's plane, each cell bearing its own weight."),
    ] = "free",
    height: Annotated[float, typer.Option(help="Of the object, m.")] = 0.03,
    largest_piece: options.LargestPiece = False,
    force: options.Force = False,
    json: options.Json = False,
) -> None:
    """Write an object or a learned model as an SDFormat model, for Drake."""
    from gridpush_drake.files import check_writable

    if out.suffix != SUFFIX:
        raise options.OptionError(f"OUT.sdf: is {str(out)!r}; expected a name that ends in {SUFFIX}")
    check_writable(out, force)
    loaded = options.load_target(target, largest_piece)

    from gridpush_drake.multibody.sdformat import WriteSdf

    WriteSdf(loaded.obj, loaded.params, out, force, base=base, height=height)
    if json:
        print_json(
            {
                "object": loaded.obj.name,
                "cells": loaded.obj.n,
                "total_mass": loaded.params.total_mass,
                "base": base,
                "height": height,
                "written": [str(out)],
            }
        )
        return
    source = "learned model" if loaded.model else "object, mass and friction spread evenly"
    print_line(f"{loaded.obj.name} ({source}): {loaded.obj.n} cells, {loaded.params.total_mass:.3g} kg, {base} base")
    print_line(f"Wrote {out}.")
