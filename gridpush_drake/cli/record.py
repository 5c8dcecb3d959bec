"""`gridpush record`: a continuous stream of poses to a push log."""

from dataclasses import replace
from math import isfinite
from pathlib import Path
from typing import Annotated

import typer

from gridpush_drake.cli import options
from gridpush_drake.cli.console import MM, count_noun, print_found

MS = 1e3
"""Milliseconds in a second."""

ENGAGED_BELOW = 0.05
"""`SegmenterOptions.engaged_below`, which takes long to import, m."""

MAX_SPAN = 10.0
"""Of a tip's places, m; where they span more and nothing is pushed, they may be in another unit."""


def record(
    stream: Annotated[
        Path,
        typer.Argument(
            metavar="STREAM.csv",
            help="A CSV file with the columns t, tip_x, tip_y, object_x, object_y, object_theta and, if known, tip_z"
            " and tip_vx, tip_vy, tip_vz; cells are empty where something was not seen.",
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
    ] = ENGAGED_BELOW,
    pose_delay: Annotated[
        float, typer.Option(help="How much older the object's poses are than their times say, s.")
    ] = 0.0,
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
    import numpy as np

    from gridpush_drake.errors import PushLogError
    from gridpush_drake.planning.support_surface import stayed_supported
    from gridpush_drake.pushes.plausibility import check_plausible
    from gridpush_drake.pushes.push_log import DEFAULT_PUSHER_RADIUS
    from gridpush_drake.pushes.segmentation import RecordOptions, SegmenterOptions
    from gridpush_drake.pushes.stream import estimate_delay, read_stream_csv, record_pushes

    options.check_outputs(force, out, inputs=(stream, object_file))
    for option, value in (("--engaged-below", engaged_below), ("--pose-delay", pose_delay)):
        if not isfinite(value):
            raise options.OptionError(f"{option}: is {value}; expected a finite number")
    surface = None if table is None else options.parse_shape("--table", table)
    obj = options.load_object(object_file)
    radius = obj.prior.pusher_radius or DEFAULT_PUSHER_RADIUS
    how = SegmenterOptions(engaged_below=engaged_below), RecordOptions(pose_delay=pose_delay)
    samples = read_stream_csv(stream)
    recorded = record_pushes(samples, obj, radius, *how, str(stream))
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
    delay = estimate_delay(samples, obj, radius, *how)
    found = {
        "object": obj.name,
        "pushes": len(log),
        "delay": None
        if delay is None
        else {key: getattr(delay, key) for key in ("value", "std", "pushes")},
        "overhanging": [seen.name for seen in log if seen.overhang],
        "unusable": list(recorded.unusable),
        "unfinished": recorded.unfinished,
        "written": [str(out)],
    }
    length = sum(seen.push.length for seen in log) / len(log)
    lines = [f"{count_noun(len(log), 'push')}, {length * MM:.0f} mm long on average."]
    if delay is not None:
        lines.append(
            f"The object's poses are {delay.value * MS:.0f} +- {delay.std * MS:.0f} ms later than --pose-delay says, "
            f"by {delay.pushes} pushes."
        )
    if recorded.unfinished:
        lines.append("The stream ends within a push, which is left out.")
    lines += [f"Left out: {text}." for text in recorded.unusable]
    print_found(found, [*lines, *options.describe_written(out)], json)
