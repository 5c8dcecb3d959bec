"""`gridpush show`: draws a picture of an object or of a learned model."""

from pathlib import Path
from typing import Annotated

import typer

from gridpush_drake.cli.shell import options
from gridpush_drake.cli.shell.console import count_noun, print_found
from gridpush_drake.files import write_whole
from gridpush_drake.objects.object_file import speak_name
from gridpush_drake.report.draw import to_png
from gridpush_drake.report.figures import draw_model, draw_object
from gridpush_drake.units import MM_PER_M


def show(
    target: options.ObjectOrModel,
    out: Annotated[
        Path,
        typer.Option(
            "--out",
            "-o",
            metavar="PICTURE.png",
            callback=options.EXPECT_PNG,
            help="The picture to write, a PNG.",
        ),
    ],
    largest_piece: options.LargestPiece = False,
    force: options.Force = False,
    json: options.Json = False,
) -> None:
    """Draw a picture of an object, or of a learned model.

    Of an object, the picture shows the outline, the cells and the parts. Of a model, it shows the
    learned masses and frictions of the cells, and how sure they are.

    Example: gridpush show claw_hammer --out hammer.png
    """
    options.check_outputs(force, out)
    loaded = options.load_target(target, largest_piece)
    obj = loaded.obj
    figure = draw_object(obj) if loaded.model is None else draw_model(loaded.model)
    write_whole(out, to_png(figure), force)
    parts = sorted(set(obj.labels.tolist()))
    found = {
        "object": obj.name,
        "kind": "model" if loaded.model else "object",
        "cells": obj.n,
        "cell_size": obj.cell_size,
        "parts": parts,
        "written": [str(out)],
    }
    left, low, right, high = (bound * MM_PER_M for bound in obj.outline.bounds)
    size = f"{right - left:.0f} mm by {high - low:.0f} mm"
    cells = count_noun(obj.n, "cell")
    pieces = count_noun(len(parts), "part")
    line = f"{speak_name(obj.name)}: {size}, {cells} of {obj.cell_size * MM_PER_M:.1f} mm, {pieces}"
    print_found(found, [line, *options.describe_written(out)], json)
