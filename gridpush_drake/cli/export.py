"""`gridpush export`: an object or a learned model as a model for other simulators.

What is slow to import is imported when the command runs, so that `gridpush` starts fast.
"""

from pathlib import Path
from typing import Annotated, Literal

import typer

from gridpush_drake.cli import options
from gridpush_drake.cli.console import print_json, print_line

Format = Literal["sdf", "urdf", "mjcf"]

SUFFIXES: dict[str, Format] = {".sdf": "sdf", ".urdf": "urdf", ".xml": "mjcf", ".mjcf": "mjcf"}


def export(
    target: options.ObjectOrModel,
    out: Annotated[Path, typer.Argument(metavar="OUT", help="The file to write.", show_default=False)],
    file_format: Annotated[
        Format | None,
        typer.Option(
            "--format",
            help="SDFormat or URDF for Drake, MJCF for MuJoCo. All say every cell's mass and friction; what they cannot"
            " say stands in the file.",
            show_default="by the file's name: .sdf, .urdf, .xml or .mjcf",
        ),
    ] = None,
    base: Annotated[
        Literal["free", "planar"],
        typer.Option(
            help="Six degrees of freedom, or, in SDFormat, held to the table's plane, each cell bearing its own weight."
        ),
    ] = "free",
    height: Annotated[float, typer.Option(help="Height of the object, m.")] = 0.03,
    largest_piece: options.LargestPiece = False,
    force: options.Force = False,
    json: options.Json = False,
) -> None:
    """Write an object or a learned model for Drake (SDFormat, URDF) or MuJoCo (MJCF)."""
    from gridpush_drake.files import check_writable

    chosen = file_format or SUFFIXES.get(out.suffix)
    if chosen is None:
        raise options.OptionError(
            f"OUT: is {str(out)!r}; expected a name that ends in {', '.join(SUFFIXES)}, or --format"
        )
    if base == "planar" and chosen != "sdf":
        raise options.OptionError(f"base: is 'planar'; expected 'free', or the format sdf: {chosen} cannot say it here")
    check_writable(out, force)
    loaded = options.load_target(target, largest_piece)

    if chosen == "sdf":
        from gridpush_drake.multibody.sdformat import WriteSdf

        WriteSdf(loaded.obj, loaded.params, out, force, base=base, height=height)
    elif chosen == "urdf":
        from gridpush_drake.multibody.sdformat import WriteUrdf

        WriteUrdf(loaded.obj, loaded.params, out, force, height=height)
    else:
        from gridpush_drake.multibody.mjcf import WriteMjcf

        WriteMjcf(loaded.obj, loaded.params, out, force, height=height)
    if json:
        print_json(
            {
                "object": loaded.obj.name,
                "cells": loaded.obj.n,
                "total_mass": loaded.params.total_mass,
                "format": chosen,
                "base": base,
                "height": height,
                "written": [str(out)],
            }
        )
        return
    source = "learned model" if loaded.model else "object, mass and friction spread evenly"
    print_line(f"{loaded.obj.name} ({source}): {loaded.obj.n} cells, {loaded.params.total_mass:.3g} kg, {base} base")
    print_line(f"Wrote {out}.")
