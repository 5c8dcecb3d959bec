"""`gridpush track`: a push log from a video, or a folder of images, of an object that is pushed."""

import csv
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
import shapely
import typer
from numpy.typing import NDArray

from gridpush_drake.cli import options
from gridpush_drake.cli.console import count_noun, print_json, print_line
from gridpush_drake.cli.object import TagSize
from gridpush_drake.errors import CameraError, ImageError, PerceptionError, PushLogError, TagError
from gridpush_drake.files import read_text
from gridpush_drake.geometry.se2 import compose, transform
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import TagSchema, read_object_file
from gridpush_drake.perception import (
    Camera,
    Frame,
    PoseTracker,
    detect_tags,
    draw_outline,
    read_frames,
    track_object,
    write_picture,
)
from gridpush_drake.perception.camera import NOT_KNOWN
from gridpush_drake.pushes.push_log import DEFAULT_PUSHER_RADIUS
from gridpush_drake.pushes.segmentation import SegmenterOptions
from gridpush_drake.pushes.stream import (
    calc_velocities,
    make_samples,
    record_pushes,
    write_stream_csv,
)

Array = NDArray[np.float64]


TAG = "tag:"
"""Before a tag's number."""

TIP_FORM = "the header t,tip_x,tip_y[,tip_z] and rows of numbers below it (s, m)"
ROD = 0.1
"""Height over the table up to which the tip's rod hides what is behind it, m."""

ROD_MARGIN, ROD_POINTS = 1.3, 24
"""By which the rod is taken wider than it is, and corners of its round."""


def track(
    video: Annotated[
        Path, typer.Argument(metavar="VIDEO|FOLDER", help="A video, or a folder of images with times.csv.",
                             show_default=False)
    ],
    camera: Annotated[
        Path,
        typer.Option("--camera", metavar="CAMERA.yaml", help="ROS camera_info, OpenCV YAML or Drake's CameraConfig, "
                     "with X_WC, as `gridpush calibrate` writes it.", show_default=False),
    ],
    object_file: Annotated[
        str, typer.Option("--object", metavar="OBJECT", help="An object file, as `gridpush object` writes it.")
    ],
    tip: Annotated[
        str,
        typer.Option(metavar="TIP.csv|tag:ID", help="Where the tip is: t,tip_x,tip_y[,tip_z] on the video's clock, or"
                     " an AprilTag 36h11 on the pusher."),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="PUSHES.csv", help="The push log to write.")],
    tip_offset: Annotated[str, typer.Option(metavar="X,Y,Z", help="Place of the tip in its tag's frame, m.")] = "0,0,0",
    tag_size: TagSize = 0.03,
    tag_height: Annotated[
        float | None, typer.Option(help="Height of the pusher's tag over the table, m, if it stays level: more exact.")
    ] = None,
    height: Annotated[
        float | None, typer.Option(min=0, help="Height of the object, m.", show_default="as its file says, or 0")
    ] = None,
    by: Annotated[
        str, typer.Option(metavar="auto|outline|tag", help="What tells the object's pose; auto: its file's tag.")
    ] = "auto",
    picture: Annotated[
        Path | None, typer.Option(metavar="SEEN.png", callback=options.PNG, help="What was seen first and last.")
    ] = None,
    stream: Annotated[
        Path | None, typer.Option(metavar="STREAM.csv", help="Also write all poses, as `gridpush record` reads them.")
    ] = None,
    force: options.Force = False,
    json: options.Json = False,
) -> None:  # fmt: skip
    """Follow an object through a video and write the pushes in it as a push log."""
    options.check_outputs(force, out, picture, stream, inputs=(video, camera, object_file, tip))
    offset = options.parse_numbers("--tip-offset", tip_offset, "x,y,z")
    seen_by, obj = Camera.read(camera), options.load_object(object_file)
    if seen_by.X_WC is None:
        raise CameraError(f"{camera}: {NOT_KNOWN}")
    if tag_height is not None and not 0 <= tag_height < seen_by.center[2]:
        raise options.OptionError(
            f"--tag-height: is {tag_height:g}; expected 0 to {seen_by.center[2]:.3g} m, where the camera is"
        )
    seen = read_object_file(options.object_path(object_file)).seen
    tag = seen.tag if seen is not None else None
    if by not in ("auto", "outline", "tag") or (by == "tag" and tag is None):
        raise options.OptionError(
            f"--by: is {by!r}; expected auto, outline or, where the object's file has one, tag"
        )
    radius = obj.prior.pusher_radius or DEFAULT_PUSHER_RADIUS
    tall = height if height is not None else obj.height or 0.0
    find_tip = _TipFinder(tip, seen_by, tag_size, np.array(offset), tag_height)
    found = _follow_tag if by != "outline" and tag is not None else _follow_outline
    rows: list[tuple[float, Array, Array]] = []
    pictures: list[tuple[Frame, Array]] = []
    for frame, pose in found(video, seen_by, obj, tall, radius, find_tip, tag):
        rows.append((frame.t, find_tip(frame), pose))
        if np.isfinite(pose).all():
            pictures = [*pictures[:1], (frame, pose)]
    find_tip.check(video, rows)
    t, tips, poses = (np.array([row[i] for row in rows]) for i in range(3))
    lost = int((~np.isfinite(poses).all(axis=1)).sum())
    samples = make_samples(t, tips, calc_velocities(t, tips), poses)
    if stream is not None:
        # a tag on the pusher is seen in the same pictures as the object, another clock may be off
        same_clock = 0.0 if find_tip.tag is not None else None
        write_stream_csv(samples, stream, force, same_clock)
    if picture is not None and pictures:
        drawn = seen_by.undistort(pictures[-1][0].color)
        for _, pose in pictures:
            outline = shapely.transform(
                obj.outline, lambda points, pose=pose: transform(pose, points)
            )
            drawn = draw_outline(drawn, seen_by, outline, tall, pose)
        write_picture(picture, drawn, force)
    recording = record_pushes(samples, obj, radius, source=str(video))
    log = recording.log
    if not len(log):
        ended = f"the tip never moved the object while it was below {SegmenterOptions().engaged_below:g} m"
        if recording.unfinished:
            ended = "it ends within a push: expected the tip to rest for a second after it"
        why = "; ".join(recording.unusable) or ended
        raise PushLogError(
            f"{video}: holds no whole push: {why}; the object was seen in {len(t) - lost} of {len(t)} frames"
        )
    log.write_csv(out, force)
    if json:
        print_json(
            {
                "object": obj.name,
                "frames": len(t),
                "lost": lost,
                "pushes": len(log),
                "written": str(out),
            }
        )
    else:
        count = count_noun(len(log), "push")
        print_line(
            f"{count} in {len(t)} frames, in {lost} of which the object was not found. Wrote {out}."
        )


class _TipFinder:
    """Where the tip is in a frame: from a CSV file on the same clock, or from a tag on the pusher."""

    def __init__(
        self, text: str, camera: Camera, size: float, offset: Array, height: float | None
    ) -> None:
        self.text, self.camera, self.size, self.offset, self.height = (
            text,
            camera,
            size,
            offset,
            height,
        )
        self.tag = None
        self.seen: set[int] = set()
        if text.startswith(TAG):
            number = text.removeprefix(TAG)
            if not re.fullmatch("[0-9]{1,9}", number):
                raise options.OptionError(
                    f"--tip: is {text!r}; expected TIP.csv, or tag:ID, such as tag:7"
                )
            self.tag = int(number)
        else:
            self.times, self.places = _read_tips(Path(text))

    def __call__(self, frame: Frame) -> Array:
        """(3,) p_WP of the tip, m; NaN where it is not known."""
        if self.tag is None:
            if not self.times[0] <= frame.t <= self.times[-1]:
                return np.full(3, np.nan)
            return np.array([np.interp(frame.t, self.times, self.places[:, i]) for i in range(3)])

        tags = detect_tags(frame.color, self.camera, self.size, self.height)
        self.seen |= tags.keys()
        X_WT = tags[self.tag].X_WT if self.tag in tags else None
        return np.full(3, np.nan) if X_WT is None else X_WT[:3, :3] @ self.offset + X_WT[:3, 3]

    def check(self, video: Path, rows: list[Any]) -> None:
        """Raises TagError or PushLogError where the tip was known in no frame."""
        if any(np.isfinite(row[1]).all() for row in rows):
            return
        if self.tag is not None:
            there = ", ".join(map(str, sorted(self.seen))) or "none"
            raise TagError(f"{video}: tag {self.tag} is in no frame; there are: {there}")
        raise PushLogError(
            f"{self.text}: its times are {self.times[0]:g} to {self.times[-1]:g} s, the frames' {rows[0][0]:g} to "
            f"{rows[-1][0]:g} s; expected clocks that overlap"
        )


def _read_tips(path: Path) -> tuple[Array, Array]:
    """Times (K,), s, and places (K, 3), m, of the tip."""
    lines = list(
        csv.reader(read_text(path, f"the tip's places: {TIP_FORM}", PushLogError).splitlines())
    )
    header = [name.strip() for name in lines[0]] if lines else []
    if header[:3] != ["t", "tip_x", "tip_y"] or header[3:] not in ([], ["tip_z"]) or len(lines) < 3:
        raise PushLogError(f"{path}: expected {TIP_FORM}")
    rows = []
    for number, line in enumerate(lines[1:], start=2):
        try:
            values = [float(cell) for cell in line]
        except ValueError:
            values = []
        if len(values) != len(header) or not all(map(math.isfinite, values)):
            raise PushLogError(f"{path}, line {number}: is {','.join(line)!r}; expected {TIP_FORM}")
        rows.append([*values, 0.0][:4])
    table = np.array(rows)
    if (np.diff(table[:, 0]) <= 0).any():
        raise PushLogError(f"{path}: its times do not increase; expected {TIP_FORM}")
    return table[:, 0], table[:, 1:]


def _follow_outline(
    video: Path, camera: Camera, obj: GridObject, height: float, radius: float, find_tip: _TipFinder,
    tag: TagSchema | None,
) -> Iterator[tuple[Frame, Array]]:  # fmt: skip

    around = np.linspace(0, 2 * np.pi, ROD_POINTS, endpoint=False)
    circle = ROD_MARGIN * radius * np.column_stack([np.cos(around), np.sin(around)])

    def cover(frame: Frame) -> NDArray[np.bool_] | None:
        place = find_tip(frame)
        if not np.isfinite(place).all():
            return None
        ends = [
            np.column_stack([place[:2] + circle, np.full(len(circle), place[2] + z)])
            for z in (0.0, ROD)
        ]
        hull = cv2.convexHull(np.round(camera.project(np.concatenate(ends))).astype(np.int32))
        painted = np.zeros((camera.height, camera.width), np.uint8)
        cv2.fillConvexPoly(painted, hull, 1)
        return painted > 0

    try:
        tracker = PoseTracker(obj.outline, height, camera)
        for frame, tracked in track_object(tracker, read_frames(video, camera), cover):
            yield frame, tracked.pose
    except ImageError:
        raise
    except PerceptionError as error:
        raise type(error)(f"{video}: {error}", error.picture) from error


def _follow_tag(
    video: Path, camera: Camera, obj: GridObject, height: float, radius: float, find_tip: _TipFinder,
    tag: TagSchema | None,
) -> Iterator[tuple[Frame, Array]]:  # fmt: skip

    assert tag is not None
    for frame in read_frames(video, camera):
        tags = detect_tags(frame.color, camera, tag.size, height)
        yield (
            frame,
            compose(tags[tag.id].planar_pose, tag.pose) if tag.id in tags else np.full(3, np.nan),
        )
