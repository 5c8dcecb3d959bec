"""`gridpush record`: cuts a continuous recording of poses into pushes, and writes a push log."""

from collections.abc import Sequence
from dataclasses import asdict, replace
from math import isfinite
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from gridpush_drake.cli.shell import options
from gridpush_drake.cli.shell.console import count_noun, print_found
from gridpush_drake.errors import PushLogError
from gridpush_drake.planning.support_surface import stayed_supported
from gridpush_drake.pushes.plausibility import check_plausible
from gridpush_drake.pushes.pose_delay import choose_delay
from gridpush_drake.pushes.push_csv import PUSHER_HELP, choose_pusher
from gridpush_drake.pushes.segmentation import RecordOptions, Sample, SegmenterOptions
from gridpush_drake.pushes.stream import (
    DELAY_COLUMN,
    MAX_GIVEN_DELAY,
    Recording,
    read_stream_csv,
    record_pushes,
)
from gridpush_drake.units import MM_PER_M

MAX_SPAN = 10.0
"""If the tip's places span more than this and no push is found, they are probably in mm, m."""


def record(
    stream: Annotated[
        Path,
        typer.Argument(
            metavar="STREAM.csv",
            help="A CSV file with the columns t, tip_x, tip_y, object_x, object_y, object_theta "
            "(s, m and rad) and, if known, tip_z, tip_vx, tip_vy, tip_vz, tip_yaw and, in the "
            "first row, object_delay. Where nothing was seen, the fields of a row are empty.",
            show_default=False,
        ),
    ],
    object_file: Annotated[
        str,
        typer.Option(
            "--object",
            metavar="NAME|FILE",
            help="The object that was pushed: an object file, or a shipped object's name.",
        ),
    ],
    out: Annotated[
        Path, typer.Option("--out", "-o", metavar="PUSHES.csv", help="The push log to write.")
    ],
    engaged_below: Annotated[
        float,
        typer.Option(
            metavar="M",
            help="Height of the tip's center below which the tip can touch the object, m. Only "
            "motion below it is taken for a push.",
        ),
    ] = SegmenterOptions.engaged_below,
    pusher: Annotated[
        str | None,
        typer.Option(
            metavar="SHAPE",
            help="Shape of a pusher that is no round tip, whose angle is the stream's column "
            f"tip_yaw (0 without it): {PUSHER_HELP}",
            show_default="a disc of the radius in the object's file",
        ),
    ] = None,
    pose_delay: Annotated[
        float | None,
        typer.Option(
            metavar="S",
            help="How much older the object's poses are than their times say, s, for instance as a "
            "camera needs time to find the object.",
            show_default="the column object_delay, else found from the pushes",
        ),
    ] = None,
    table: Annotated[
        str | None,
        typer.Option(
            metavar="SHAPE",
            help="Shape of the table's top. If given, pushes in which the object hung over the "
            f"edge are marked in the log. {options.SHAPE_HELP}",
        ),
    ] = None,
    force: options.Force = False,
    json: options.Json = False,
) -> None:
    """Cut a long recording of poses into pushes, and write them as a push log.

    The recording holds where the tip of the pusher and the object were, many times a second. A push
    goes on while the tip is down and moves. It has ended when the tip has stopped and then lifts,
    moves on, or stands still for a second.

    Example: gridpush record stream.csv --object object.yaml --out pushes.csv
    """
    options.check_outputs(force, out, inputs=(stream, object_file))
    _check_numbers(engaged_below, pose_delay)
    surface = None if table is None else options.parse_shape("--table", table)
    obj = options.load_object(object_file)
    what = choose_pusher("--pusher", pusher, obj)
    segmenter = SegmenterOptions(engaged_below=engaged_below)
    read = read_stream_csv(stream)
    samples = read.samples
    # the user knows the delay best, then the file; else it has to be found from the pushes
    if pose_delay is not None:
        delay = choose_delay(samples, obj, segmenter, given=pose_delay, given_by="--pose-delay")
    elif read.pose_delay is not None:
        delay = choose_delay(samples, obj, segmenter, given=read.pose_delay, given_by=DELAY_COLUMN)
    else:
        delay = choose_delay(samples, obj, segmenter)
    record_options = RecordOptions(pose_delay=delay.value)
    recorded = record_pushes(samples, obj, what, segmenter, record_options, str(stream))
    log = recorded.log
    if not len(log):
        why = _explain_no_push(samples, recorded)
        raise PushLogError(
            f"{stream}: holds no push: {why}; expected a tip below {engaged_below:g} m that pushes"
        )
    if surface is not None:
        pushes = tuple(
            replace(seen, overhang=not stayed_supported(obj, seen, surface)) for seen in log
        )
        log = replace(log, pushes=pushes, table=surface.corners)
    check_plausible(obj, replace(log, source=str(stream)), learning=True)
    log.write_csv(out, force)
    found = {
        "object": obj.name,
        "pushes": len(log),
        "delay": {
            "applied": delay.value,
            "told_by": delay.given_by or None,
            "found": None if delay.found is None else asdict(delay.found),
            "contradicted": delay.is_contradicted,
        },
        "overhanging": [seen.name for seen in log if seen.overhang],
        "unusable": list(recorded.unusable),
        "unfinished": recorded.unfinished,
        "written": [str(out)],
    }
    length = sum(seen.push.length for seen in log) / len(log)
    lines = [
        f"{count_noun(len(log), 'push')}, {length * MM_PER_M:.0f} mm long on average.",
        delay.describe(),
    ]
    if recorded.unfinished:
        lines.append("The recording ends within a push, which is left out.")
    lines += [f"Left out: {text}." for text in recorded.unusable]
    print_found(found, [*lines, *options.describe_written(out)], json)


def _check_numbers(engaged_below: float, pose_delay: float | None) -> None:
    """Raises OptionError where one of the numbers is not usable."""
    if not isfinite(engaged_below):
        raise options.OptionError(
            f"--engaged-below: is {engaged_below}; expected a finite number (m)"
        )
    # written so that a NaN is refused, too
    if pose_delay is not None and not abs(pose_delay) <= MAX_GIVEN_DELAY:
        raise options.OptionError(
            f"--pose-delay: is {pose_delay}; expected a number (s), at most {MAX_GIVEN_DELAY:g}"
        )


def _explain_no_push(samples: Sequence[Sample], recorded: Recording) -> str:
    """Returns the probable reason why a recording holds no push."""
    if recorded.unusable:
        return "; ".join(recorded.unusable)
    why = (
        "it ends within a push"
        if recorded.unfinished
        else "the tip never moved the object while it was down"
    )
    tips = np.array([sample.tip[:2] for sample in samples if isfinite(sample.tip[0])])
    span = float(np.ptp(tips, axis=0).max()) if len(tips) else 0.0
    if span > MAX_SPAN:
        why += f"; tip_x, tip_y: in millimeters? expected m, they span {span:.3g}"
    return why
