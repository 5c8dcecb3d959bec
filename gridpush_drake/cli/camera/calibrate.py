"""`gridpush calibrate`: finds where and what a camera is, from a printed board of tags."""

from pathlib import Path
from typing import Annotated

import typer

from gridpush_drake.cli.shell import options
from gridpush_drake.cli.shell.console import print_json, print_line, print_notice
from gridpush_drake.errors import PerceptionError
from gridpush_drake.files import write_whole
from gridpush_drake.perception import (
    Camera,
    TagBoard,
    calibrate_intrinsics,
    calibrate_pose,
    draw_tags,
    find_tag_corners,
    read_color,
    read_photographs,
    write_picture,
)
from gridpush_drake.units import MM_PER_M

BOARD_FORM = "COLUMNSxROWS:SIZE[:GAP[:FIRST]], such as 4x5:0.035 (m)"
"""The form of a board on the command line, for messages."""

DEFAULT_TAG_GAP = 0.3
"""Distance between two tags, as a fraction of a tag's side, if the board does not give it."""

MAX_MEASURES = 3
"""How many numbers may follow a board's columns and rows: SIZE, GAP and FIRST."""


def calibrate(
    photo: Annotated[
        Path | None,
        typer.Argument(
            metavar="PHOTO",
            help="A photograph of the board, which lies flat on the table.",
            show_default=False,
        ),
    ] = None,
    board: Annotated[
        str,
        typer.Option(
            metavar="BOARD",
            help="The board's tags, which are AprilTags 36h11, as COLUMNSxROWS:SIZE, or with "
            ":GAP, or with :GAP:FIRST after it. SIZE is the side of a tag's black square and GAP "
            "the distance between two tags, m (0.3 of SIZE if not given); FIRST is the number of "
            "the first tag (0 if not given).",
        ),
    ] = "4x5:0.035",
    camera: Annotated[
        Path | None,
        typer.Option(
            metavar="CAMERA.yaml",
            help="The camera's file with its intrinsics and distortion, as ROS camera_info, OpenCV "
            "YAML or Drake's CameraConfig. Needed with PHOTO.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            metavar="CAMERA.yaml",
            help="The camera's file to write: the same with X_WC, the camera's pose. Needed with "
            "PHOTO.",
        ),
    ] = None,
    intrinsics: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Do not look for the camera's pose, but find its focal lengths, center and "
            "distortion from at least 5 photographs of the board in this folder, taken with the "
            "same zoom and focus, the board tilted to all sides.",
        ),
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option(
            metavar="SEEN.png",
            callback=options.EXPECT_PNG,
            help="Also write the photograph with the tags that were found drawn into it.",
        ),
    ] = None,
    sheet: Annotated[
        Path | None,
        typer.Option(
            "--print",
            metavar="BOARD.pdf",
            help="Do not calibrate, but write the board as a page to be printed at 100 %.",
        ),
    ] = None,
    force: options.Force = False,
    json: options.Json = False,
) -> None:
    """Find where a camera is, and what camera it is, from photographs of a printed board.

    The middle of the board becomes the origin of the world frame, with z pointing up. First print
    the board with --print and lay it on the table; then take a photograph of it.

    The camera's intrinsics, if nobody knows them, are found beforehand with --intrinsics.

    Example: gridpush calibrate photo.png --camera intrinsics.yaml --out camera.yaml
    """
    tags = parse_board(board)
    if sum(each is not None for each in (photo, sheet, intrinsics)) != 1:
        raise options.OptionError(
            "calibrate: expected either a photograph, or --intrinsics FOLDER, or --print BOARD.pdf"
        )
    if intrinsics is not None:
        if out is None:
            raise options.OptionError("calibrate: --intrinsics needs --out, the file to write")
        _find_intrinsics(tags, intrinsics, out, force, json)
        return
    if sheet is not None:
        _print_board(tags, sheet, force, json)
        return
    assert photo is not None
    if camera is None or out is None:
        raise options.OptionError(
            "calibrate: a photograph needs --camera, the camera's file, and --out, the file to "
            "write"
        )

    options.check_outputs(force, out, picture, inputs=(photo,))
    seen_by = Camera.read(camera)
    color = read_color(photo, seen_by)
    # written first, for it shows what is wrong with a photograph from which no pose can be found
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
            f"The camera is at ({x:z.3f}, {y:z.3f}, {z:z.3f}) m from the board's middle; the tags' "
            f"corners are {error:.2f} pixels off. Wrote {out}."
        )


def _find_intrinsics(tags: TagBoard, folder: Path, out: Path, force: bool, json: bool) -> None:
    """Finds a camera's intrinsics from the photographs in a folder, and writes its file."""
    options.check_outputs(force, out)
    found = calibrate_intrinsics(read_photographs(folder), tags)
    found.camera.write(out, force)
    K = found.camera.K
    if json:
        print_json(
            {
                "K": K.tolist(),
                "distortion": found.camera.distortion.tolist(),
                "error": found.error,
                "focal_deviation": found.focal_deviation,
                "used": list(found.used),
                "unused": list(found.unused),
                "written": str(out),
            }
        )
        return
    if found.unused:
        print_notice(f"Too few tags in {', '.join(found.unused)}; left out.")
    print_line(
        f"{len(found.used)} photographs: focal lengths {K[0, 0]:.1f} and {K[1, 1]:.1f} pixels, "
        f"known to {100 * found.focal_deviation:.2f} %; the tags' corners are {found.error:.2f} "
        f"pixels off. Wrote {out}."
    )


def _print_board(tags: TagBoard, sheet: Path, force: bool, json: bool) -> None:
    """Writes a board as a PDF page, and prints how large it should come out."""
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
            f"Wrote {sheet}: {width * MM_PER_M:.0f} x {height * MM_PER_M:.0f} mm of tags. Print "
            "it at 100 %, "
            "and measure it."
        )


def parse_board(text: str) -> TagBoard:
    """Reads a board from its form on the command line.

    Args:
        text: "4x5:0.035", or with the gap, or with the gap and the first tag's number after it.

    Raises:
        OptionError: the text is of another form.
        TagError: a number is out of its range.
    """
    grid, *measures = text.split(":")
    try:
        columns, rows = map(int, grid.split("x"))
        size = float(measures[0])
        gap = float(measures[1]) if len(measures) > 1 else DEFAULT_TAG_GAP * size
        first = int(measures[2]) if len(measures) > 2 else 0
    except (ValueError, IndexError):
        raise options.OptionError(f"--board: is {text!r}; expected {BOARD_FORM}") from None
    if len(measures) > MAX_MEASURES:
        raise options.OptionError(f"--board: is {text!r}; expected {BOARD_FORM}")
    return TagBoard(columns, rows, size, gap, first)
