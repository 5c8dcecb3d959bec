"""`gridpush object`: finds an object in a photograph, and writes an object file for it."""

from pathlib import Path
from typing import Annotated, Literal
from warnings import warn

import typer

from gridpush_drake.cli import options
from gridpush_drake.cli.console import print_json, print_line
from gridpush_drake.errors import (
    NoObjectError,
    NoTableError,
    ObjectWarning,
    PerceptionError,
    SeveralObjectsError,
    TagError,
)
from gridpush_drake.files import write_whole
from gridpush_drake.objects.object_file import SeenSchema, TagSchema, dump_object
from gridpush_drake.perception import (
    SHEETS,
    Camera,
    DetectedObject,
    DetectorOptions,
    ObjectHint,
    detect_by_sheet,
    detect_object,
    detect_tags,
    find_sheet,
    read_color,
    read_depth,
    read_focal_length,
    read_mask,
    solve_tag_to_body,
    write_picture,
)
from gridpush_drake.perception.foreground import CONTRADICTION
from gridpush_drake.perception.frames import Color, read_any_color

MM = 1e3
"""Millimeters in a meter."""

CM2 = 1e4
"""Square centimeters in a square meter."""

MAX_PIXEL = 1e6
"""Greatest coordinate of a pixel that is believed."""

HELPED = (NoObjectError, SeveralObjectsError, NoTableError)
"""Refusals that a hint helps against."""

HINTS = "; --click X,Y, --box LEFT,TOP,RIGHT,BOTTOM or --mask MASK.png can say where it is"
"""What is added to them."""

SheetName = Literal["a3", "a4", "a5", "letter"]
"""Sheets of paper that `SHEETS` has the sides of."""

Photo = Annotated[
    Path,
    typer.Argument(
        metavar="PHOTO",
        help="A photograph of the object on the table, in color.",
        show_default=False,
    ),
]
CameraFile = Annotated[
    Path | None,
    typer.Option(
        "--camera",
        metavar="CAMERA.yaml",
        help="The camera's file, as ROS camera_info, OpenCV YAML or Drake's CameraConfig. Without "
        "--depth or --sheet it needs X_WC, the camera's pose, which `gridpush calibrate` finds. It "
        "has to be given, unless --sheet is.",
        show_default=False,
    ),
]
Sheet = Annotated[
    SheetName | None,
    typer.Option(
        metavar="NAME",
        help="A blank sheet of paper that lies flat on the table: a3, a4, a5 or letter. The object "
        "lies beside it or on it. It tells the scale and where the camera is, so that a phone's "
        "photograph does, taken at a slant of 20 to 50 degrees.",
        show_default=False,
    ),
]
TagSize = Annotated[
    float, typer.Option(metavar="M", min=1e-3, help="Side of the tag's black square, m.")
]


def make_object(
    photo: Photo,
    camera: CameraFile = None,
    sheet: Sheet = None,
    depth: Annotated[
        Path | None,
        typer.Option(
            metavar="DEPTH.png",
            help="Depth picture of the same scene, registered to PHOTO pixel by pixel: 16 bit in "
            "mm, or floating point in m.",
        ),
    ] = None,
    out: Annotated[
        Path, typer.Option("--out", "-o", metavar="OBJECT.yaml", help="The object file to write.")
    ] = Path("object.yaml"),
    picture: Annotated[
        Path | None,
        typer.Option(
            metavar="SEEN.png",
            callback=options.PNG,
            help="Also write the photograph with what was found drawn into it. It is written even "
            "if no object was found.",
        ),
    ] = None,
    name: Annotated[
        str | None,
        typer.Option(help="Name of the object in its file.", show_default="the photograph's name"),
    ] = None,
    height: Annotated[
        float | None,
        typer.Option(
            min=1e-4,
            metavar="M",
            help="Height of the object above the table, m. Needed without --depth, for the top of "
            "a high object seems larger than its foot.",
            show_default="as --depth shows it",
        ),
    ] = None,
    mask: Annotated[
        Path | None,
        typer.Option(
            metavar="MASK.png",
            help="Which pixels of PHOTO show the object: an image of the same size, black where it "
            "is not, as any segmenter writes. It is taken as it is.",
        ),
    ] = None,
    box: Annotated[
        str | None,
        typer.Option(
            metavar="LEFT,TOP,RIGHT,BOTTOM",
            help="A box in PHOTO that holds all of the object and nothing else but table, pixels. "
            "Helps where the object is hard to tell from the table.",
        ),
    ] = None,
    click: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y",
            help="A pixel of PHOTO that shows the object: chooses among several objects.",
        ),
    ] = None,
    cell_size: Annotated[
        float | None,
        typer.Option(
            min=1e-4,
            metavar="M",
            help="Side of the square cells that the object is divided into, m.",
            show_default="so large that there are at most 127",
        ),
    ] = None,
    parts: Annotated[
        bool,
        typer.Option(
            "--parts",
            help="Divide the object into parts by its colors. A simulation with random masses "
            "gives each part a mass of its own.",
        ),
    ] = False,
    tag: Annotated[
        int | None,
        typer.Option(
            min=0,
            metavar="ID",
            help="Number of an AprilTag 36h11 that is stuck on the object. Where it is on the "
            "object is written to the file, so that `gridpush track` can follow the tag.",
        ),
    ] = None,
    tag_size: TagSize = 0.03,
    force: options.Force = False,
    json: options.Json = False,
) -> None:
    """Find the object in a photograph, and write an object file for it.

    The file holds the object's outline, its cells and its height. The object is told from the table
    by its color and, with --depth, by its height.

    Example: gridpush object photo.png --depth depth.png --camera camera.yaml --out object.yaml
    """
    options.check_outputs(force, out, picture, inputs=(photo, camera, depth, mask))
    _check_told(camera, sheet, depth)
    seen_by = None if camera is None else Camera.read(camera)
    color = read_any_color(photo) if seen_by is None else read_color(photo, seen_by)
    measured = None if depth is None else read_depth(depth, _require(seen_by))
    hint = None
    try:
        if sheet is None:
            hint = _read_hint(mask, box, click, _require(seen_by))
            chosen = DetectorOptions(height=height, parts=parts, hint=hint)
            found = detect_object(color, measured, _require(seen_by), chosen)
            pixel = found.pixel
        else:
            paper = find_sheet(
                color,
                SHEETS[sheet],
                camera=seen_by,
                focal=read_focal_length(photo) if seen_by is None else None,
            )
            hint = _read_hint(mask, box, click, paper.camera)
            chosen = DetectorOptions(height=height, parts=parts, hint=hint)
            by_sheet = detect_by_sheet(color, paper, chosen)
            found = by_sheet.found
            color = by_sheet.color
            pixel = by_sheet.pixel
    except PerceptionError as error:
        if picture is not None and error.picture is not None:
            write_picture(picture, error.picture, force)
        help_there = "" if hint is not None or not isinstance(error, HELPED) else HINTS
        raise type(error)(f"{photo}: {error}{help_there}", error.picture) from error
    if found.contradiction > CONTRADICTION:
        warn(
            f"{photo}: color and depth contradict each other about {found.contradiction:.0%} of "
            f"the object; is {depth} of the same scene, and registered to the color picture? "
            "--picture shows what was found",
            ObjectWarning,
            stacklevel=2,
        )
    if found.doubtful:
        warn(
            f"{photo}: parts of the object hardly stand out from the table, and its outline may be "
            f"wrong; --picture shows what was found{HINTS}",
            ObjectWarning,
            stacklevel=2,
        )
    obj = found.make_grid_object(cell_size, name or photo.stem)
    tag_on_it = None if tag is None else _find_tag(photo, color, found, tag, tag_size)
    x, y, theta = map(float, found.X_WB)
    at = (float(pixel[0]), float(pixel[1]))
    seen = SeenSchema(pixel=at, pose=(x, y, theta), tag=tag_on_it)
    write_whole(out, dump_object(obj.name, obj.grid, obj.prior, obj.height, seen), force)
    if picture is not None:
        write_picture(picture, found.picture, force)
    if json:
        print_json(
            {
                "object": obj.name,
                "cells": obj.n,
                "height": obj.height,
                "area": found.outline.area,
                "pixel": at,
                "pose": [x, y, theta],
                "written": str(out),
            }
        )
    else:
        tall = f"{found.height * MM:.0f} mm high" if found.height else "of unknown height"
        print_line(
            f"{obj.name}: {found.outline.area * CM2:.1f} cm2, {tall}, {obj.n} cells. Wrote {out}."
        )


def _check_told(camera: Path | None, sheet: SheetName | None, depth: Path | None) -> None:
    """Raises OptionError where nothing tells the scale, or two things do."""
    if camera is None and sheet is None:
        raise options.OptionError(
            "--camera: missing; expected the camera's file, or --sheet a4 if a sheet of paper lies "
            "on the table"
        )
    if sheet is not None and depth is not None:
        raise options.OptionError("--sheet and --depth: both are given; expected one of them")


def _require(camera: Camera | None) -> Camera:
    """Returns a camera that `_check_told` has made sure of."""
    assert camera is not None
    return camera


def _read_hint(
    mask: Path | None, box: str | None, click: str | None, camera: Camera
) -> ObjectHint | None:
    """Reads what is said of where the object is; None where nothing is.

    Raises:
        OptionError: two hints are given, or a number is none.
        ImageError: the mask cannot be read.
    """
    given = {"--mask": mask, "--box": box, "--click": click}
    names = [name for name, value in given.items() if value is not None]
    if len(names) > 1:
        raise options.OptionError(f"{' and '.join(names)}: both are given; expected one of them")
    if mask is not None:
        return ObjectHint(mask=read_mask(mask, camera))
    if box is not None:
        left, top, right, bottom = _read_numbers("--box", box, 4, "left,top,right,bottom")
        return ObjectHint(box=(left, top, right, bottom))
    if click is not None:
        x, y = _read_numbers("--click", click, 2, "x,y")
        return ObjectHint(click=(x, y))
    return None


def _read_numbers(option: str, text: str, count: int, form: str) -> list[float]:
    """Reads numbers with commas between them. Raises OptionError where they are no pixels."""
    try:
        numbers = [float(word) for word in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != count or not all(abs(number) < MAX_PIXEL for number in numbers):
        raise options.OptionError(f"{option}: is {text!r}; expected {form} (pixels)")
    return numbers


def _find_tag(photo: Path, color: Color, found: DetectedObject, tag: int, size: float) -> TagSchema:
    """Finds where a tag is on the object. Raises TagError where it is not in the photograph."""
    tags = detect_tags(color, found.camera, size, found.height)
    if tag not in tags:
        there = ", ".join(map(str, sorted(tags))) or "none"
        raise TagError(
            f"{photo}: tag {tag} is not in view; the tags in view are: {there}", found.picture
        )
    x, y, theta = map(float, solve_tag_to_body(tags[tag], found.X_WB))
    return TagSchema(id=tag, size=size, pose=(x, y, theta))
