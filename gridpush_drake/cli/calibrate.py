"""`gridpush calibrate`: where a camera is, from a printed board of tags on the table."""

from pathlib import Path
from typing import Annotated

import typer

from gridpush_drake.cli import options
from gridpush_drake.cli.console import MM, print_json, print_line
from gridpush_drake.errors import PerceptionError
from gridpush_drake.files import write_whole
from gridpush_drake.perception import (
    Camera,
    TagBoard,
    calibrate_pose,
    draw_tags,
    find_tag_corners,
    read_color,
    write_picture,
)

FORM = "COLUMNSxROWS:SIZE[:GAP[:FIRST]], such as 4x5:0.035 (m)"


def calibrate(
    photo: Annotated[
        Path | None,
        typer.Argument(
            metavar="PHOTO", help="A photograph of the board on the table.", show_default=False
        ),
    ] = None,
    board: Annotated[
        str,
        typer.Option(
            metavar="BOARD",
            help=f"{FORM}: AprilTags 36h11, the side of a black square, 0.3 of it apart.",
        ),
    ] = "4x5:0.035",
    camera: Annotated[
        Path | None,
        typer.Option(
            metavar="CAMERA.yaml", help="The camera's file: its intrinsics and distortion."
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", "-o", metavar="CAMERA.yaml", help="The camera's file with X_WC, to write."
        ),
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option(metavar="SEEN.png", callback=options.PNG, help="The tags that were seen."),
    ] = None,
    sheet: Annotated[
        Path | None,
        typer.Option(
            "--print", metavar="BOARD.pdf", help="Write the board instead, to print at 100 %."
        ),
    ] = None,
    force: options.Force = False,
    json: options.Json = False,
) -> None:
    """Find the camera's pose from a photograph of a board of tags: its middle is the world's origin, z up."""
    tags = parse_board(board)
    if (photo is None) == (sheet is None):
        raise options.OptionError("calibrate: expected either a photograph, or --print BOARD.pdf")
    if sheet is not None:
        if sheet.suffix.lower() != ".pdf":
            raise options.OptionError(
                f"--print: is {str(sheet)!r}; expected a PDF file's name, such as board.pdf"
            )
        write_whole(sheet, tags.make_pdf(), force)
        width, height = tags.extent
        if json:
            print_json({"extent": [width, height], "written": str(sheet)})
        else:
            print_line(
                f"Wrote {sheet}: {width * MM:.0f} x {height * MM:.0f} mm of tags. Print it at 100 %, and measure it."
            )
        return
    assert photo is not None
    if camera is None or out is None:
        raise options.OptionError(
            "calibrate: --camera and --out are needed: the camera's file, and the one to write"
        )

    options.check_outputs(force, out, picture, inputs=(photo,))
    seen_by = Camera.read(camera)
    color = read_color(photo, seen_by)
    if picture is not None:
        write_picture(picture, draw_tags(color, find_tag_corners(color)), force)
    try:
        placed, error = calibrate_pose(color, seen_by, tags)
    except PerceptionError as problem:
        raise type(problem)(f"{photo}: {problem}", problem.picture) from problem
    placed.write(out, force)
    x, y, z = map(float, placed.center)
    if json:
        print_json({"p_WC": [x, y, z], "error": error, "written": str(out)})
    else:
        print_line(
            f"The camera is at ({x:z.3f}, {y:z.3f}, {z:z.3f}) m from the board's middle; the tags' corners are "
            f"{error:.2f} pixels off. Wrote {out}."
        )


def parse_board(text: str) -> TagBoard:
    """Reads a board. Raises OptionError where the text is of another form, TagError where a measure is out of range."""
    grid, *rest = text.split(":")
    try:
        columns, rows = map(int, grid.split("x"))
        size, gap, first = [float(part) for part in rest[:2]], rest[1:2], rest[2:]
        spacing = float(gap[0]) if gap else GAP * size[0]
        number = int(first[0]) if first else 0
        side = size[0]
    except (ValueError, IndexError):
        raise options.OptionError(f"--board: is {text!r}; expected {FORM}") from None
    if len(rest) > MAX_MEASURES:
        raise options.OptionError(f"--board: is {text!r}; expected {FORM}")
    return TagBoard(columns, rows, side, spacing, number)


GAP = 0.3
"""Between two tags, in their sides, unless said otherwise."""

MAX_MEASURES = 3
"""After a board's rows and columns."""
