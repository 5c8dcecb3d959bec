"""`gridpush object`: finds an object in a photograph, and writes an object file for it."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal, NamedTuple
from warnings import warn

import typer

from gridpush_drake.cli.shell import options
from gridpush_drake.cli.shell.console import count_noun, print_json, print_line
from gridpush_drake.errors import (
    MultipleObjectsError,
    NoObjectError,
    NoTableError,
    ObjectWarning,
    PerceptionError,
    TagError,
)
from gridpush_drake.files import write_together, write_whole
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import (
    OBJECT_FILE,
    SeenSchema,
    TagSchema,
    dump_object,
    speak_name,
)
from gridpush_drake.perception import (
    SHEET_SIZES,
    Camera,
    DetectedObject,
    DetectorOptions,
    ObjectHint,
    detect_by_sheet,
    detect_object,
    detect_objects,
    detect_tags,
    find_sheet,
    read_color,
    read_depth,
    read_focal_length,
    read_mask,
    solve_tag_to_body,
    write_picture,
)
from gridpush_drake.perception.detection.expected_iou import DOUBTFUL_IOU
from gridpush_drake.perception.detection.foreground import MAX_CONTRADICTION
from gridpush_drake.perception.images.frames import Color, Depth, read_any_color
from gridpush_drake.units import CM2_PER_M2, MM_PER_M

MAX_PIXEL = 1e6
"""Greatest coordinate of a pixel that is believed."""

HINTED_ERRORS = (NoObjectError, MultipleObjectsError, NoTableError)
"""Refusals that a hint helps against."""

ALL_HINT = ", and --all writes a file for each object"
"""What is added to the refusal of a photograph of several objects."""

DETECTION_HINTS = (
    "; --click X,Y, --box LEFT,TOP,RIGHT,BOTTOM or --mask MASK.png can say where it is"
)
"""What is added to them."""

SheetName = Literal["a3", "a4", "a5", "letter"]
"""Sheets of paper that `SHEET_SIZES` has the sides of."""

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
        "photograph is enough, if it is taken at a slant of 20 to 50 degrees.",
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
    ] = Path(OBJECT_FILE),
    picture: Annotated[
        Path | None,
        typer.Option(
            metavar="SEEN.png",
            callback=options.EXPECT_PNG,
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
            help="Height of the object above the table, m. Needed without --depth, because the "
            "top of a high object is nearer to the camera and looks larger than its foot.",
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
    all_objects: Annotated[
        bool,
        typer.Option(
            "--all",
            help="Find each of several objects, and write a file for each: with --out object.yaml, "
            "object_1.yaml, object_2.yaml and so on, from left to right in the photograph. What "
            "the border cuts, such as a hand, is left out.",
        ),
    ] = False,
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
            help="Divide the object into parts by its colors. Learning weighs whether the cells of "
            "a part are of one material (key uniform_parts), and a simulation with random masses "
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

    The file holds the object's outline, its cells and its height. The object is distinguished from
    the table by its color and, with --depth, by its height.

    Example: gridpush object photo.png --depth depth.png --camera camera.yaml --out object.yaml
    """
    # With --all, `out` itself is not written; which files are is known once the objects are found.
    written = None if all_objects else out
    options.check_outputs(force, written, picture, inputs=(photo, camera, depth, mask))
    _check_options(camera, sheet, depth)
    if all_objects:
        chosen_too = {
            "--sheet": sheet,
            "--mask": mask,
            "--box": box,
            "--click": click,
            "--tag": tag,
        }
        _check_all(chosen_too)
    seen_by = None if camera is None else Camera.read(camera)
    color = read_any_color(photo) if seen_by is None else read_color(photo, seen_by)
    measured = None if depth is None else read_depth(depth, _require(seen_by))
    if all_objects:
        wanted = _AllWanted(
            out=out,
            picture=picture,
            cell_size=cell_size,
            name=name or photo.stem,
            force=force,
            json=json,
        )
        options_of_all = DetectorOptions(height=height, parts=parts)
        _make_all(photo, color, measured, _require(seen_by), options_of_all, wanted)
        return
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
                SHEET_SIZES[sheet],
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
        help_there = (
            "" if hint is not None or not isinstance(error, HINTED_ERRORS) else DETECTION_HINTS
        )
        if help_there and sheet is None and isinstance(error, MultipleObjectsError):
            help_there += ALL_HINT
        raise type(error)(f"{photo}: {error}{help_there}", error.picture) from error
    if found.contradiction > MAX_CONTRADICTION:
        warn(
            f"{photo}: color and depth contradict each other about {found.contradiction:.0%} of "
            f"the object; is {depth} of the same scene, and registered to the color picture? "
            "--picture shows what was found",
            ObjectWarning,
            stacklevel=2,
        )
    if found.expected_iou < DOUBTFUL_IOU:
        warn(
            f"{photo}: the outline is expected to share only {found.expected_iou:.0%} of its area "
            "with the true one (intersection over union), for the object hardly stands out from "
            f"the table in parts; --picture shows what was found{DETECTION_HINTS}",
            ObjectWarning,
            stacklevel=2,
        )
    obj = found.make_grid_object(cell_size, name or photo.stem)
    tag_on_it = None if tag is None else _find_tag(photo, color, found, tag, tag_size)
    made = _WrittenObject(path=out, obj=obj, found=found, pixel=(float(pixel[0]), float(pixel[1])))
    with write_together():
        made.write(tag_on_it, force)
        if picture is not None:
            write_picture(picture, found.picture, force)
    if json:
        print_json(made.describe())
    else:
        made.print()


class _AllWanted(NamedTuple):
    """What is to be made of all objects in a photograph.

    Attributes:
        out: the file from whose name those of the objects' files are made.
        picture: the picture to write; None for none.
        cell_size: side of the cells, m; None for the default number of cells.
        name: name from which those of the objects are made.
        force: whether existing files may be replaced.
        json: whether the result is printed as JSON.
    """

    out: Path
    picture: Path | None
    cell_size: float | None
    name: str
    force: bool
    json: bool


def _check_all(chosen: Mapping[str, object]) -> None:
    """Raises OptionError where an option is given that says which one object is meant."""
    given = [name for name, value in chosen.items() if value is not None]
    if given:
        raise options.OptionError(
            f"--all and {given[0]}: both are given; expected --all alone, with --camera"
        )


def _make_all(
    photo: Path,
    color: Color,
    depth: Depth | None,
    camera: Camera,
    chosen: DetectorOptions,
    wanted: _AllWanted,
) -> None:
    """Finds all objects in a photograph, and writes an object file for each.

    Args:
        photo: the photograph's file, for messages.
        color: its colors.
        depth: depth, m; None without.
        camera: the camera.
        chosen: what counts as an object.
        wanted: what is to be written.
    """
    try:
        found = detect_objects(color, depth, camera, chosen)
    except PerceptionError as error:
        if wanted.picture is not None and error.picture is not None:
            write_picture(wanted.picture, error.picture, wanted.force)
        raise type(error)(f"{photo}: {error}", error.picture) from error
    if found.cut:
        things = count_noun(found.cut, "thing")
        verb = "is" if found.cut == 1 else "are"
        warn(
            f"{photo}: {things} cut by the picture's border {verb} left out, as a hand or an arm "
            "would be; --picture shows what was found",
            ObjectWarning,
            stacklevel=3,
        )
    for number, each in enumerate(found.objects, start=1):
        _warn_of(photo, number, each)

    # All files are written, or none.
    suffix = wanted.out.suffix
    paths = [
        wanted.out.with_name(f"{wanted.out.stem}_{number}{suffix}")
        for number in range(1, len(found.objects) + 1)
    ]
    options.check_outputs(wanted.force, *paths, wanted.picture, inputs=(photo,))
    rows = []
    for number, (path, each) in enumerate(zip(paths, found.objects, strict=True), start=1):
        obj = each.make_grid_object(wanted.cell_size, f"{wanted.name}_{number}")
        rows.append(
            _WrittenObject(
                path=path, obj=obj, found=each, pixel=(float(each.pixel[0]), float(each.pixel[1]))
            )
        )
    with write_together():
        for row in rows:
            row.write(None, wanted.force)
        if wanted.picture is not None:
            write_picture(wanted.picture, found.picture, wanted.force)
    if wanted.json:
        print_json({"objects": [row.describe() for row in rows], "cut": found.cut})
        return
    for row in rows:
        row.print()


def _warn_of(photo: Path, number: int, found: DetectedObject) -> None:
    """Warns where one of several objects is doubtful."""
    if found.doubtful or found.expected_iou < DOUBTFUL_IOU:
        warn(
            f"{photo}: object {number} hardly stands out from the table in parts, and its outline "
            f"is expected to share only {found.expected_iou:.0%} of its area with the true one; "
            "--picture shows what was found",
            ObjectWarning,
            stacklevel=4,
        )
    if found.crowded:
        warn(
            f"{photo}: object {number} may be two objects that touch; if it is, move them apart, "
            "for a photograph alone does not tell where one ends; --picture shows what was found",
            ObjectWarning,
            stacklevel=4,
        )


class _WrittenObject(NamedTuple):
    """An object that was found, and the file for it.

    Attributes:
        path: the object file.
        obj: the object.
        found: what was found in the photograph.
        pixel: where its body frame's origin is in the photograph, pixels.
    """

    path: Path
    obj: GridObject
    found: DetectedObject
    pixel: tuple[float, float]

    def write(self, tag: TagSchema | None, force: bool) -> None:
        """Writes the object file, with the tag on the object where there is one."""
        x, y, theta = map(float, self.found.X_WB)
        seen = SeenSchema(pixel=self.pixel, pose=(x, y, theta), tag=tag)
        obj = self.obj
        write_whole(self.path, dump_object(obj.name, obj.grid, obj.prior, obj.height, seen), force)

    def describe(self) -> dict[str, object]:
        """Describes the object for JSON."""
        return {
            "object": self.obj.name,
            "cells": self.obj.n,
            "height": self.obj.height,
            "area": self.found.outline.area,
            "expected_iou": self.found.expected_iou,
            "pixel": self.pixel,
            "pose": list(map(float, self.found.X_WB)),
            "written": str(self.path),
        }

    def print(self) -> None:
        """Prints a line about the object."""
        height = self.found.height
        tall = f"{height * MM_PER_M:.0f} mm high" if height else "of unknown height"
        print_line(
            f"{speak_name(self.obj.name)}: {self.found.outline.area * CM2_PER_M2:.1f} cm², {tall}, "
            f"{self.obj.n} cells."
            f" Wrote {self.path}."
        )


def _check_options(camera: Path | None, sheet: SheetName | None, depth: Path | None) -> None:
    """Raises OptionError where nothing tells the scale, or two things do."""
    if camera is None and sheet is None:
        raise options.OptionError(
            "--camera: missing; expected the camera's file, or --sheet a4 if a sheet of paper lies "
            "on the table"
        )
    if sheet is not None and depth is not None:
        raise options.OptionError("--sheet and --depth: both are given; expected one of them")


def _require(camera: Camera | None) -> Camera:
    """Returns a camera that `_check_options` has made sure of."""
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
