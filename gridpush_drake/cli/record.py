"""`gridpush record`: a continuous stream of poses to a push log."""

from dataclasses import asdict, replace
from math import isfinite
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from gridpush_drake.cli import options
from gridpush_drake.cli.console import MM, count_noun, print_found
from gridpush_drake.errors import PushLogError
from gridpush_drake.planning.support_surface import stayed_supported
from gridpush_drake.pushes.plausibility import check_plausible
from gridpush_drake.pushes.pose_delay import choose_delay
from gridpush_drake.pushes.push_log import DEFAULT_PUSHER_RADIUS
from gridpush_drake.pushes.segmentation import RecordOptions, SegmenterOptions
from gridpush_drake.pushes.stream import DELAY, MAX_TOLD_DELAY, read_stream_csv, record_pushes

MAX_SPAN = 10.0
"""Of a tip's places, m; where they span more and nothing is pushed, they may be in another unit."""


def record(
    stream: Annotated[
        Path,
        typer.Argument(
            metavar="STREAM.csv",
            help="A CSV file with the columns t, tip_x, tip_y, object_x, object_y, object_theta and, if known, tip_z,"
            " tip_vx, tip_vy, tip_vz and, in the first row, object_delay; cells are empty where nothing was seen.",
            show_default=False,
        ),
    ],
    object_file: Annotated[
        str,
        typer.Option(
            "--object", metavar="OBJECT", help="An object file, or a shipped object's name."
        ),
    ],
    out: Annotated[
        Path, typer.Option("--out", "-o", metavar="PUSHES.csv", help="The push log to write.")
    ],
    engaged_below: Annotated[
        float,
        typer.Option(help="Height of the tip's center below which it can touch the object, m."),
    ] = SegmenterOptions.engaged_below,
    pose_delay: Annotated[
        float | None,
        typer.Option(
            metavar="S",
            help="How much later the object's poses are than their times say, s; by default, what the stream says in"
            " its column object_delay, or else what its pushes say.",
        ),
    ] = None,
    table: Annotated[
        str | None,
        typer.Option(
            metavar="SHAPE", help=f"Marks pushes with a part off its edge: {options.FORMS}."
        ),
    ] = None,
    force: options.Force = False,
    json: options.Json = False,
) -> None:
    """Cut a stream of the tip's and the object's poses into pushes, as the robot does while it pokes."""
    options.check_outputs(force, out, inputs=(stream, object_file))
    if not isfinite(engaged_below):
        raise options.OptionError(
            f"--engaged-below: is {engaged_below}; expected a finite number (m)"
        )
    if pose_delay is not None and not abs(pose_delay) <= MAX_TOLD_DELAY:
        raise options.OptionError(
            f"--pose-delay: is {pose_delay}; expected a number (s), at most {MAX_TOLD_DELAY:g}"
        )
    surface = None if table is None else options.parse_shape("--table", table)
    obj = options.load_object(object_file)
    radius = obj.prior.pusher_radius or DEFAULT_PUSHER_RADIUS
    segmenter = SegmenterOptions(engaged_below=engaged_below)
    read = read_stream_csv(stream)
    samples = read.samples
    # what the user says goes before what the file says, and that before what the pushes say
    told, told_by = (
        (pose_delay, "--pose-delay") if pose_delay is not None else (read.pose_delay, DELAY)
    )
    delay = choose_delay(
        samples, obj, segmenter, told=told, told_by="" if told is None else told_by
    )
    record_options = RecordOptions(pose_delay=delay.value)
    recorded = record_pushes(samples, obj, radius, segmenter, record_options, str(stream))
    log = recorded.log
    if not len(log):
        ended = (
            "it ends within a push"
            if recorded.unfinished
            else "the tip never moved the object while it was down"
        )
        tips = np.array([sample.tip[:2] for sample in samples if isfinite(sample.tip[0])])
        span = float(np.ptp(tips, axis=0).max()) if len(tips) else 0.0
        if span > MAX_SPAN:
            ended += f"; tip_x, tip_y: in millimeters? expected m, they span {span:.3g}"
        why = "; ".join(recorded.unusable) or ended
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
            "told_by": delay.told_by or None,
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
        f"{count_noun(len(log), 'push')}, {length * MM:.0f} mm long on average.",
        delay.describe(),
    ]
    if recorded.unfinished:
        lines.append("The stream ends within a push, which is left out.")
    lines += [f"Left out: {text}." for text in recorded.unusable]
    print_found(found, [*lines, *options.describe_written(out)], json)
