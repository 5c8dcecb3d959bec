"""`gridpush simulate`: push an object in simulation."""

from collections.abc import Sequence
from math import degrees
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from gridpush_drake.cli import options
from gridpush_drake.cli.console import MM, print_found
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.simulation import simulate as simulate_push
from gridpush_drake.files import write_whole
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.pushes.push_log import DEFAULT_PUSHER_RADIUS, ObservedPush, PushLog
from gridpush_drake.report.draw import to_png
from gridpush_drake.report.figures import draw_motion

PUSH_NAME = "push_1"


def simulate(
    target: options.ObjectOrModel,
    start: Annotated[
        str, typer.Option(metavar="X,Y", help="Center of the pusher at the beginning, m.")
    ],
    velocity: Annotated[str, typer.Option(metavar="VX,VY", help="Velocity of the pusher, m/s.")],
    duration: Annotated[float, typer.Option(help="Duration of the push, s.")],
    radius: Annotated[
        float | None,
        typer.Option(
            help="Radius of the pusher, m; by default what the object's file says, or 0.005."
        ),
    ] = None,
    pose: Annotated[
        str,
        typer.Option(metavar="X,Y,THETA", help="Pose of the object at the beginning, m and rad."),
    ] = "0,0,0",
    regime: options.Regime = "auto",
    mass_seed: Annotated[
        int | None, typer.Option(min=0, help="Give each part a random mass, drawn with this seed.")
    ] = None,
    samples: Annotated[
        int, typer.Option(min=1, help="Poses to write to the log, after the first.")
    ] = 10,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="LOG.csv", help="Write a push log.")
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option(metavar="PICTURE.png", callback=options.PNG, help="Draw the motion."),
    ] = None,
    largest_piece: options.LargestPiece = False,
    force: options.Force = False,
    json: options.Json = False,
) -> None:
    """Simulate one push of an object or of a learned model."""
    options.check_outputs(force, out, picture, inputs=(target,))
    loaded = options.load_target(target, largest_piece)
    finger = loaded.obj.prior.pusher_radius if radius is None else radius
    push = Push(
        options.parse_numbers("--start", start, "x,y"),
        options.parse_numbers("--velocity", velocity, "vx,vy"),
        duration,
        DEFAULT_PUSHER_RADIUS if finger is None else finger,
    )
    pose_W = options.parse_numbers("--pose", pose, "x,y,theta")
    params = loaded.params if mass_seed is None else CellParameters.random(loaded.obj, mass_seed)
    physics = loaded.make_physics(regime)
    options.compile_kernels()
    motion = simulate_push(loaded.obj, params, push, pose_W, physics=physics)
    chosen = motion.physics.regime
    if out is not None:
        steps = len(motion.times) - 1
        rows = np.unique(np.rint(np.linspace(0, steps, min(samples, steps) + 1)).astype(int))[1:]
        seen = ObservedPush(
            PUSH_NAME, push, motion.poses[0], motion.times[rows], motion.poses[rows]
        )
        PushLog((seen,)).write_csv(out, force)
    if picture is not None:
        write_whole(picture, to_png(draw_motion(loaded.obj, push, motion.poses)), force)
    first, last = motion.poses[0], motion.final_pose
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
        f"{loaded.obj.name}, {chosen}: {motion.status}",
        f"from  {_describe_pose(first.tolist())}",
        f"to    {_describe_pose(last.tolist())}",
        *options.describe_written(out, picture),
    ]
    print_found(found, lines, json)


def _describe_pose(pose: Sequence[float]) -> str:
    return f"x {pose[0] * MM:.2f} mm, y {pose[1] * MM:.2f} mm, theta {degrees(pose[2]):.2f}°"
