"""`gridpush show`: a picture of an object or a model.

What is slow to import is imported when the command runs, so that `gridpush` starts fast.
"""

from pathlib import Path
from typing import Annotated

import typer

from gridpush_drake.cli import options
from gridpush_drake.cli.console import print_json, print_line


def show(
    target: options.ObjectOrModel,
    out: Annotated[Path, typer.Option("--out", "-o", metavar="PICTURE.png", help="The picture to write.")],
    largest_piece: options.LargestPiece = False,
    force: options.Force = False,
    json: options.Json = False,
) -> None:
    """Draw an object with its parts, or what a model learned of it."""
    from gridpush_drake.files import check_writable, write_whole
    from gridpush_drake.report.figures import draw_model, draw_object

    check_writable(out, force)
    loaded = options.load_target(target, largest_piece)
    obj = loaded.obj
    write_whole(out, draw_object(obj) if loaded.model is None else draw_model(loaded.model), force)
    if json:
        print_json(
            {
                "object": obj.name,
                "kind": "model" if loaded.model else "object",
                "cells": obj.n,
                "cell_size": obj.cell_size,
                "parts": sorted(set(obj.labels.tolist())),
                "written": [str(out)],
            }
        )
        return
    left, low, right, high = (1e3 * bound for bound in obj.outline.bounds)
    print_line(
        f"{obj.name}: {right - left:.0f} mm by {high - low:.0f} mm, {obj.n} cells of {obj.cell_size * 1e3:.1f} mm, "
        f"{len(set(obj.labels.tolist()))} part(s)"
    )
    print_line(f"Wrote {out}.")
