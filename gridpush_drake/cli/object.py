"""`gridpush object`: finds an object in a photograph, and writes an object file for it."""

from pathlib import Path
from typing import Annotated
from warnings import warn

import typer

from gridpush_drake.cli import options
from gridpush_drake.cli.console import print_json, print_line
from gridpush_drake.errors import ObjectWarning, PerceptionError, TagError
from gridpush_drake.files import write_whole
from gridpush_drake.objects.object_file import SeenSchema, TagSchema, dump_object
from gridpush_drake.perception import (
    Camera,
    DetectedObject,
    DetectorOptions,
    detect_object,
    detect_tags,
    read_color,
    read_depth,
    solve_tag_to_body,
    write_picture,
)
from gridpush_drake.perception.foreground import CONTRADICTION
from gridpush_drake.perception.frames import Color

MM = 1e3
"""Millimeters in a meter."""

CM2 = 1e4
"""Square centimeters in a square meter."""

Photo = Annotated[
    Path,
    typer.Argument(
        metavar="PHOTO",
        help="A photograph of the object on the table, in color.",
        show_default=False,
    ),
]
CameraFile = Annotated[
    Path,
    typer.Option(
        "--camera",
        metavar="CAMERA.yaml",
        help="The camera's file, as ROS camera_info, OpenCV YAML or Drake's CameraConfig. Without "
        "--depth it needs X_WC, the camera's pose, which `gridpush calibrate` finds.",
        show_default=False,
    ),
]
TagSize = Annotated[
    float, typer.Option(metavar="M", min=1e-3, help="Side of the tag's black square, m.")
]


def make_object(
    photo: Photo,
    camera: CameraFile,
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
    options.check_outputs(force, out, picture, inputs=(photo, camera, depth))
    seen_by = Camera.read(camera)
    color = read_color(photo, seen_by)
    measured = None if depth is None else read_depth(depth, seen_by)
    try:
        found = detect_object(color, measured, seen_by, DetectorOptions(height=height, parts=parts))
    except PerceptionError as error:
        if picture is not None and error.picture is not None:
            write_picture(picture, error.picture, force)
        raise type(error)(f"{photo}: {error}", error.picture) from error
    if found.contradiction > CONTRADICTION:
        warn(
            f"{photo}: color and depth contradict each other about {found.contradiction:.0%} of "
            f"the object; is {depth} of the same scene, and registered to the color picture? "
            "--picture shows what was found",
            ObjectWarning,
            stacklevel=2,
        )
    obj = found.make_grid_object(cell_size, name or photo.stem)
    tag_on_it = None if tag is None else _find_tag(photo, color, found, tag, tag_size)
    x, y, theta = map(float, found.X_WB)
    at = (float(found.pixel[0]), float(found.pixel[1]))
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
