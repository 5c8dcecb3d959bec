"""`gridpush simulate`: simulates one push."""

from collections.abc import Sequence
from math import degrees
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from gridpush_drake import report
from gridpush_drake.cli.shell import options
from gridpush_drake.cli.shell.console import print_found
from gridpush_drake.dynamics.push import Push
from gridpush_drake.files import write_together, write_whole
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.object_file import speak_name
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.pushes.push_log import ObservedPush, PushLog
from gridpush_drake.units import MM_PER_M

PUSH_NAME = "push_1"
"""Name of the push in the log that is written."""


def simulate(
    target: options.ObjectOrModel,
    start: Annotated[
        str,
        typer.Option(
            metavar="X,Y",
            help="Where the center of the pusher is at the beginning, world frame, m.",
        ),
    ],
    velocity: Annotated[
        str,
        typer.Option(
            metavar="VX,VY", help="Velocity of the pusher, which stays the same, world frame, m/s."
        ),
    ],
    duration: Annotated[float, typer.Option(metavar="S", help="How long the pusher moves, s.")],
    radius: options.PusherRadius = None,
    pose: Annotated[
        str,
        typer.Option(
            metavar="X,Y,THETA",
            help="Pose of the object at the beginning, world frame, m and rad.",
        ),
    ] = "0,0,0",
    regime: options.Regime = "auto",
    mass_seed: Annotated[
        int | None,
        typer.Option(
            min=0,
            help="Give each part of the object a random mass, drawn with this seed.",
            show_default="the model's masses, or mass spread evenly",
        ),
    ] = None,
    samples: Annotated[
        int,
        typer.Option(
            min=1,
            help="How many poses of the object --out gets, besides the first, evenly in time.",
        ),
    ] = 10,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="LOG.csv", help="Also write the push as a push log."),
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option(
            metavar="PICTURE.png",
            callback=options.EXPECT_PNG,
            help="Also draw the motion into this picture.",
        ),
    ] = None,
    largest_piece: options.LargestPiece = False,
    force: options.Force = False,
    json: options.Json = False,
) -> None:
    """Simulate one push of an object or of a learned model.

    The pusher is a disc that moves along a straight line at a constant velocity. Printed is where
    the object ends.

    Example: gridpush simulate claw_hammer --start 0.05,-0.1 --velocity 0,0.05 --duration 2
    """
    options.check_outputs(force, out, picture, inputs=(target,))
    loaded = options.load_target(target, largest_piece)
    push = Push(
        options.parse_numbers("--start", start, "x,y", "m"),
        options.parse_numbers("--velocity", velocity, "vx,vy", "m/s"),
        duration,
        options.choose_radius(radius, loaded.obj),
    )
    pose_W = options.parse_numbers("--pose", pose, "x,y,theta", "m, rad")
    params = loaded.params if mass_seed is None else CellParameters.random(loaded.obj, mass_seed)
    physics = loaded.make_physics(regime)
    options.compile_kernels()
    motion = Model(loaded.obj, params, physics).simulate(push, pose_W)
    chosen = motion.physics.regime
    with write_together():
        if out is not None:
            # as many steps of the motion as poses are asked for, evenly in time, without the first
            steps = len(motion.times) - 1
            rows = np.unique(np.rint(np.linspace(0, steps, min(samples, steps) + 1)).astype(int))[
                1:
            ]
            seen = ObservedPush(
                PUSH_NAME, push, motion.poses[0], motion.times[rows], motion.poses[rows]
            )
            PushLog((seen,)).write_csv(out, force)
        if picture is not None:
            drawn = report.draw_motion(loaded.obj, push, motion.poses)
            write_whole(picture, report.to_png(drawn), force)
    first = motion.poses[0]
    last = motion.final_pose
    found = {
        "object": loaded.obj.name,
        "regime": chosen,
        "status": motion.status,
        "initial_pose": first,
        "final_pose": last,
        "penetration": motion.penetration,
        "written": [str(path) for path in (out, picture) if path],
    }
    lines = [
        f"{speak_name(loaded.obj.name)}, {chosen}: {motion.status}",
        f"from  {_describe_pose(first.tolist())}",
        f"to    {_describe_pose(last.tolist())}",
        *options.describe_written(out, picture),
    ]
    print_found(found, lines, json)


def _describe_pose(pose: Sequence[float]) -> str:
    """Returns a pose in words, in mm and degrees."""
    return (
        f"x {pose[0] * MM_PER_M:.2f} mm, y {pose[1] * MM_PER_M:.2f} mm, theta "
        f"{degrees(pose[2]):.2f}°"
    )
