"""`gridpush track`: follows an object through a video, and writes the pushes in it."""

import csv
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import cv2
import numpy as np
import shapely
import typer
from numpy.typing import NDArray

from gridpush_drake.cli.camera.object import TagSize
from gridpush_drake.cli.shell import options
from gridpush_drake.cli.shell.console import count_noun, print_json, print_line
from gridpush_drake.errors import CameraError, ImageError, PerceptionError, PushLogError, TagError
from gridpush_drake.files import read_text, write_together
from gridpush_drake.geometry.se2 import compose, transform
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import TagSchema, read_object_file
from gridpush_drake.perception import (
    Camera,
    Frame,
    KnownObject,
    PoseTracker,
    SceneTracker,
    detect_tags,
    draw_outline,
    read_frames,
    track_object,
    track_objects,
    write_picture,
)
from gridpush_drake.perception.images.camera import NOT_KNOWN
from gridpush_drake.perception.images.frames import Color
from gridpush_drake.pushes.segmentation import SegmenterOptions
from gridpush_drake.pushes.stream import (
    Recording,
    calc_velocities,
    make_samples,
    record_pushes,
    write_stream_csv,
)

Array = NDArray[np.float64]

By = Literal["auto", "outline", "tag"]
"""How the object's pose is found in a picture."""

TAG_PREFIX = "tag:"
"""What stands before the number of a tag in `--tip`."""

TIP_FORM = "the header t,tip_x,tip_y[,tip_z] and rows of numbers below it (s, m)"
"""The form of a file with the tip's places, for messages."""

ROD_LENGTH = 0.1
"""Length of the rod above the tip that may hide the object from the camera, m."""

ROD_MARGIN = 1.3
"""How much wider than it is the rod is assumed to be, as its place is not known exactly."""

ROD_POINTS = 24
"""Number of corners of the polygon that stands for the rod's circle."""


def track(
    video: Annotated[
        Path,
        typer.Argument(
            metavar="VIDEO|FOLDER",
            help="A video, or a folder of images with a file times.csv, of an object that is "
            "pushed.",
            show_default=False,
        ),
    ],
    camera: Annotated[
        Path,
        typer.Option(
            "--camera",
            metavar="CAMERA.yaml",
            help="The camera's file, as ROS camera_info, OpenCV YAML or Drake's CameraConfig. It "
            "needs X_WC, the camera's pose, which `gridpush calibrate` finds.",
            show_default=False,
        ),
    ],
    object_file: Annotated[
        str,
        typer.Option(
            "--object",
            metavar="NAME|FILE",
            help="The object that is pushed, such as a file that `gridpush object` wrote.",
        ),
    ],
    tip: Annotated[
        str,
        typer.Option(
            metavar="TIP.csv|tag:ID",
            help="Where the tip of the pusher is: a CSV file with the columns t, tip_x, tip_y and, "
            "if known, tip_z (s and m, on the video's clock), or tag: and the number of an "
            "AprilTag 36h11 on the pusher, such as tag:7.",
        ),
    ],
    out: Annotated[
        Path, typer.Option("--out", "-o", metavar="PUSHES.csv", help="The push log to write.")
    ],
    beside: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME|FILE",
            help="Another object in view, such as a file that `gridpush object --all` wrote; may "
            "be repeated. The objects may touch and push each other: none is taken for a part of "
            "another. Only the pushes of --object are written.",
            show_default="no other object is in view",
        ),
    ] = None,
    tip_offset: Annotated[
        str,
        typer.Option(metavar="X,Y,Z", help="Where the tip is in the frame of the pusher's tag, m."),
    ] = "0,0,0",
    tag_size: TagSize = 0.03,
    tag_height: Annotated[
        float | None,
        typer.Option(
            metavar="M",
            help="Height of the pusher's tag above the table, m, if it stays level and at that "
            "height. The tip's place is more exact then.",
            show_default="found from the tag's picture",
        ),
    ] = None,
    height: Annotated[
        float | None,
        typer.Option(
            min=0,
            metavar="M",
            help="Height of the object above the table, m.",
            show_default="what its file says, else 0",
        ),
    ] = None,
    by: Annotated[
        By,
        typer.Option(
            help="How the object's pose is found: by its outline, or by the AprilTag on it that "
            "its file names. auto: by the tag if the file names one."
        ),
    ] = "auto",
    picture: Annotated[
        Path | None,
        typer.Option(
            metavar="SEEN.png",
            callback=options.EXPECT_PNG,
            help="Also write the last picture in which the object was found, with its outline "
            "there and in the first one.",
        ),
    ] = None,
    stream: Annotated[
        Path | None,
        typer.Option(
            metavar="STREAM.csv",
            help="Also write the poses of all pictures to a file that `gridpush record` reads.",
        ),
    ] = None,
    force: options.Force = False,
    json: options.Json = False,
) -> None:
    """Follow an object through a video, and write the pushes in it as a push log.

    Example: gridpush track video.mp4 --camera camera.yaml --object object.yaml --tip tag:7 --out
    pushes.csv
    """
    options.check_outputs(
        force, out, picture, stream, inputs=(video, camera, object_file, tip, *(beside or ()))
    )
    offset = options.parse_numbers("--tip-offset", tip_offset, "x,y,z", "m")
    seen_by = Camera.read(camera)
    obj = options.load_object(object_file)
    _check_camera(camera, seen_by, tag_height)
    seen = read_object_file(options.object_path(object_file)).seen
    tag = seen.tag if seen is not None else None
    if by == "tag" and tag is None:
        raise options.OptionError(
            f"--by: is 'tag', but {object_file} names no tag; expected auto or outline"
        )
    if beside and tag is not None and by != "outline":
        raise options.OptionError(
            f"--beside: is given, but {object_file} names a tag, which nothing beside the object "
            "disturbs; expected --by outline with it"
        )
    radius = options.choose_radius(None, obj)
    tall = height if height is not None else obj.height or 0.0
    find_tip = _TipFinder(tip, seen_by, tag_size, np.array(offset), tag_height)
    if tag is not None and by != "outline":
        followed = _follow_tag(video, seen_by, tall, tag)
    else:
        others = [options.load_object(name) for name in beside or ()]
        known = [KnownObject(obj.outline, tall, obj.name)]
        known += [KnownObject(each.outline, each.height or 0.0, each.name) for each in others]
        followed = _follow_outline(video, seen_by, known, radius, find_tip)

    seen_all = _watch(followed, find_tip, video)
    frames = len(seen_all.t)
    lost = int((~np.isfinite(seen_all.poses).all(axis=1)).sum())

    velocities = calc_velocities(seen_all.t, seen_all.tips)
    samples = make_samples(seen_all.t, seen_all.tips, velocities, seen_all.poses)
    recording = record_pushes(samples, obj, radius, source=str(video))
    log = recording.log

    # Write what was seen, also if there should be no push in it
    with write_together():
        if stream is not None:
            # a tag on the pusher is seen in the same pictures as the object; another clock may be
            # off
            same_clock = 0.0 if find_tip.tag is not None else None
            write_stream_csv(samples, stream, force, same_clock)
        if picture is not None and seen_all.pictures:
            write_picture(picture, _draw_outlines(seen_by, obj, tall, seen_all.pictures), force)
        if len(log):
            log.write_csv(out, force)
    if not len(log):
        raise PushLogError(
            f"{video}: holds no whole push: {_explain_no_push(recording)}; the object was seen in "
            f"{frames - lost} of {frames} frames"
        )
    if json:
        found = {"object": obj.name, "frames": frames, "lost": lost, "pushes": len(log)}
        print_json({**found, "written": str(out)})
    else:
        count = count_noun(len(log), "push")
        print_line(
            f"{count} in {frames} frames, in {lost} of which the object was not found. Wrote {out}."
        )


@dataclass(frozen=True)
class _Watched:
    """What was seen in a video.

    Attributes:
        t: times (K,) of the pictures, s.
        tips: places (K, 3) of the tip, world frame, m; NaN where it was not found.
        poses: poses (K, 3) of the object; NaN where it was not found.
        pictures: the first and the last picture in which the object was found, with its pose.
    """

    t: Array
    tips: Array
    poses: Array
    pictures: list[tuple[Frame, Array]]


def _watch(
    followed: Iterator[tuple[Frame, Array]], find_tip: "_TipFinder", video: Path
) -> _Watched:
    """Goes through a video, picture by picture.

    Args:
        followed: yields each picture and the object's pose in it.
        find_tip: finds the tip in a picture.
        video: the video, for messages.

    Raises:
        TagError: the tip's tag is in no picture.
        PushLogError: the file with the tip's places is of another time than the video.
    """
    rows: list[tuple[float, Array, Array]] = []
    # only two pictures are kept, for they are large
    pictures: list[tuple[Frame, Array]] = []
    for frame, pose in followed:
        rows.append((frame.t, find_tip(frame), pose))
        if np.isfinite(pose).all():
            pictures = [*pictures[:1], (frame, pose)]
    find_tip.check(video, rows)
    return _Watched(
        t=np.array([row[0] for row in rows]),
        tips=np.array([row[1] for row in rows]),
        poses=np.array([row[2] for row in rows]),
        pictures=pictures,
    )


def _check_camera(path: Path, camera: Camera, tag_height: float | None) -> None:
    """Raises an error where the camera's pose is not known, or the tag would be above it."""
    if camera.X_WC is None:
        raise CameraError(f"{path}: {NOT_KNOWN}")
    if tag_height is not None and not 0 <= tag_height < camera.center[2]:
        raise options.OptionError(
            f"--tag-height: is {tag_height:g}; expected 0 to {camera.center[2]:.3g} m, where the "
            "camera is"
        )


def _draw_outlines(
    camera: Camera, obj: GridObject, height: float, pictures: list[tuple[Frame, Array]]
) -> Color:
    """Draws the outlines at the poses in some pictures into the last of these pictures."""
    drawn = camera.undistort(pictures[-1][0].color)
    for _, pose in pictures:
        outline = shapely.transform(obj.outline, lambda points, pose=pose: transform(pose, points))
        drawn = draw_outline(drawn, camera, outline, height, pose)
    return drawn


def _explain_no_push(recording: Recording) -> str:
    """Returns the probable reason why a video holds no push."""
    if recording.unusable:
        return "; ".join(recording.unusable)
    if recording.unfinished:
        return "it ends within a push: expected the tip to rest for a second after it"
    below = SegmenterOptions().engaged_below
    return f"the tip never moved the object while it was below {below:g} m"


class _TipFinder:
    """Finds where the tip is in a picture, from a CSV file or from a tag on the pusher.

    Attributes:
        tag: number of the tag; None if the places come from a file.
        seen: numbers of all tags that were found so far.
    """

    def __init__(
        self, text: str, camera: Camera, size: float, offset: Array, height: float | None
    ) -> None:
        """Begins.

        Args:
            text: the value of `--tip`.
            camera: the camera.
            size: side of the tag's black square, m.
            offset: place of the tip (3,) in the tag's frame, m.
            height: height of the tag above the table, m; None if it is not known.
        """
        self.text = text
        self.camera = camera
        self.size = size
        self.offset = offset
        self.height = height
        self.tag = None
        self.seen: set[int] = set()
        if text.startswith(TAG_PREFIX):
            number = text.removeprefix(TAG_PREFIX)
            if not re.fullmatch("[0-9]{1,9}", number):
                raise options.OptionError(
                    f"--tip: is {text!r}; expected TIP.csv, or tag:ID, such as tag:7"
                )
            self.tag = int(number)
        else:
            self.times, self.places = _read_tips(Path(text))

    def __call__(self, frame: Frame) -> Array:
        """Returns the place p_WP (3,) of the tip, m; NaN if it is not known in this picture."""
        if self.tag is None:
            if not self.times[0] <= frame.t <= self.times[-1]:
                return np.full(3, np.nan)
            return np.array([np.interp(frame.t, self.times, self.places[:, i]) for i in range(3)])
        tags = detect_tags(frame.color, self.camera, self.size, self.height)
        self.seen |= tags.keys()
        X_WT = tags[self.tag].X_WT if self.tag in tags else None
        if X_WT is None:
            return np.full(3, np.nan)
        return X_WT[:3, :3] @ self.offset + X_WT[:3, 3]

    def check(self, video: Path, rows: list[Any]) -> None:
        """Raises TagError or PushLogError where the tip was known in no picture."""
        if any(np.isfinite(row[1]).all() for row in rows):
            return
        if self.tag is not None:
            there = ", ".join(map(str, sorted(self.seen))) or "none"
            raise TagError(
                f"{video}: tag {self.tag} is in no frame; the tags that are seen are: {there}"
            )
        raise PushLogError(
            f"{self.text}: its times are {self.times[0]:g} to {self.times[-1]:g} s, those of the "
            f"frames {rows[0][0]:g} to {rows[-1][0]:g} s; expected times that overlap"
        )


def _read_tips(path: Path) -> tuple[Array, Array]:
    """Reads the times (K,), s, and the places (K, 3), m, of the tip from a CSV file."""
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
    video: Path,
    camera: Camera,
    known: Sequence[KnownObject],
    radius: float,
    find_tip: _TipFinder,
) -> Iterator[tuple[Frame, Array]]:
    """Follows the object through a video by its outline.

    Args:
        video: the video, or a folder of images.
        camera: the camera.
        known: the object, and all others in view.
        radius: radius of the rod that ends in the tip, m. What it hides is not compared.
        find_tip: finds the tip in a picture.

    Yields:
        Each picture and the object's pose (3,) in it; NaN where the object was not found.
    """
    around = np.linspace(0, 2 * np.pi, ROD_POINTS, endpoint=False)
    circle = ROD_MARGIN * radius * np.column_stack([np.cos(around), np.sin(around)])

    def cover(frame: Frame) -> NDArray[np.bool_] | None:
        """Finds the pixels that the rod may hide; None if nobody knows where it is."""
        place = find_tip(frame)
        if not np.isfinite(place).all():
            return None
        ends = [
            np.column_stack([place[:2] + circle, np.full(len(circle), place[2] + z)])
            for z in (0.0, ROD_LENGTH)
        ]
        hull = cv2.convexHull(np.round(camera.project(np.concatenate(ends))).astype(np.int32))
        painted = np.zeros((camera.height, camera.width), np.uint8)
        cv2.fillConvexPoly(painted, hull, 1)
        return painted > 0

    try:
        frames = read_frames(video, camera)
        if len(known) > 1:
            for frame, all_poses in track_objects(SceneTracker(known, camera), frames, cover):
                yield frame, all_poses[0].pose
            return
        tracker = PoseTracker(known[0].outline, known[0].height, camera)
        for frame, tracked in track_object(tracker, frames, cover):
            yield frame, tracked.pose
    except ImageError:
        raise
    except PerceptionError as error:
        raise type(error)(f"{video}: {error}", error.picture) from error


def _follow_tag(
    video: Path, camera: Camera, height: float, tag: TagSchema
) -> Iterator[tuple[Frame, Array]]:
    """Follows the object through a video by a tag on it.

    Args:
        video: the video, or a folder of images.
        camera: the camera.
        height: height of the object, and so of the tag, m.
        tag: the tag, and where it is on the object.

    Yields:
        Each picture and the object's pose (3,) in it; NaN where the tag was not found.
    """
    for frame in read_frames(video, camera):
        tags = detect_tags(frame.color, camera, tag.size, height)
        if tag.id in tags:
            yield frame, compose(tags[tag.id].planar_pose, tag.pose)
        else:
            yield frame, np.full(3, np.nan)
