"""`gridpush object`: an object file from one photograph."""

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

MM, CM2 = 1e3, 1e4
"""In m and m^2."""

Photo = Annotated[
    Path,
    typer.Argument(
        metavar="PHOTO", help="A photograph of the object on the table.", show_default=False
    ),
]
CameraFile = Annotated[
    Path,
    typer.Option(
        "--camera", metavar="CAMERA.yaml", help="ROS camera_info, OpenCV YAML or Drake's CameraConfig; with X_WC, as"
        " `gridpush calibrate` writes it, unless there is depth.", show_default=False,
    ),
]  # fmt: skip
TagSize = Annotated[
    float, typer.Option(metavar="M", min=1e-3, help="Side of a tag's black square, m.")
]


def make_object(
    photo: Photo,
    camera: CameraFile,
    depth: Annotated[
        Path | None,
        typer.Option(
            metavar="DEPTH.png", help="Depth image, registered: 16 bit in mm, or float in m."
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
            help="What was seen; also where no object was found.",
        ),
    ] = None,
    name: Annotated[
        str | None, typer.Option(help="Name of the object.", show_default="the photograph's")
    ] = None,
    height: Annotated[
        float | None,
        typer.Option(min=1e-4, help="Height of the object, m.", show_default="as depth says"),
    ] = None,
    cell_size: Annotated[
        float | None,
        typer.Option(min=1e-4, help="Side of a cell, m.", show_default="127 cells at most"),
    ] = None,
    parts: Annotated[
        bool, typer.Option("--parts", help="Tell the object's parts apart by color.")
    ] = False,
    tag: Annotated[
        int | None,
        typer.Option(min=0, help="AprilTag 36h11 on the object: its pose goes into the file."),
    ] = None,
    tag_size: TagSize = 0.03,
    force: options.Force = False,
    json: options.Json = False,
) -> None:
    """Find the object in a photograph and write its outline, cells and height as an object file."""
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
            f"{photo}: color and depth contradict each other about {found.contradiction:.0%} of the object; is {depth} "
            "of the same scene, and registered? --picture shows what was found",
            ObjectWarning,
            stacklevel=2,
        )
    obj = found.make_grid_object(cell_size, name or photo.stem)
    tag_on_it = None if tag is None else _find_tag(photo, color, found, tag, tag_size)
    x, y, theta = map(float, found.X_WB)
    at = float(found.pixel[0]), float(found.pixel[1])
    seen = SeenSchema(pixel=at, pose=(x, y, theta), tag=tag_on_it)
    write_whole(out, dump_object(obj.name, obj.grid, obj.prior, obj.height, seen), force)
    if picture is not None:
        write_picture(picture, found.picture, force)
    if json:
        print_json(
            {"object": obj.name, "cells": obj.n, "height": obj.height, "area": found.outline.area, "pixel": at,
             "pose": [x, y, theta], "written": str(out)}
        )  # fmt: skip
    else:
        tall = f"{found.height * MM:.0f} mm high" if found.height else "of unknown height"
        print_line(
            f"{obj.name}: {found.outline.area * CM2:.1f} cm2, {tall}, {obj.n} cells. Wrote {out}."
        )


def _find_tag(photo: Path, color: Color, found: DetectedObject, tag: int, size: float) -> TagSchema:

    tags = detect_tags(color, found.camera, size, found.height)
    if tag not in tags:
        there = ", ".join(map(str, sorted(tags))) or "none"
        raise TagError(f"{photo}: tag {tag} is not in view; there are: {there}", found.picture)
    x, y, theta = map(float, solve_tag_to_body(tags[tag], found.X_WB))
    return TagSchema(id=tag, size=size, pose=(x, y, theta))
