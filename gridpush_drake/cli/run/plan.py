"""`gridpush plan`: plans pushes that bring an object to a goal pose."""

from dataclasses import replace
from math import degrees, isfinite
from pathlib import Path
from typing import Annotated

import typer

from gridpush_drake import report
from gridpush_drake.cli.shell import options
from gridpush_drake.cli.shell.console import print_found
from gridpush_drake.files import write_together, write_whole
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.object_file import speak_name
from gridpush_drake.planning.contact.trial import ContactOptions
from gridpush_drake.planning.goal.next_push import GoalRules
from gridpush_drake.planning.goal.push_plan import (
    PushPlan,
    PushPlanStatus,
    describe_plan,
    plan_pushes,
    write_plan,
)
from gridpush_drake.planning.push_constraints import PushConstraints
from gridpush_drake.units import MM_PER_M


def plan(
    model: options.ObjectOrModel,
    goal: Annotated[
        str,
        typer.Option(
            metavar="X,Y,THETA",
            help="The goal: where the object should lie in the end, world frame, m and rad.",
        ),
    ],
    start: Annotated[
        str,
        typer.Option(
            metavar="X,Y,THETA",
            help="Where the object lies in the beginning, world frame, m and rad.",
        ),
    ] = "0,0,0",
    table: Annotated[
        str | None,
        typer.Option(
            metavar="SHAPE",
            help=f"Shape of the table's top: {options.SHAPE_HELP}",
            show_default="an endless table",
        ),
    ] = None,
    obstacle: Annotated[
        list[str] | None,
        typer.Option(
            metavar="SHAPE",
            help="Something on the table that object and pusher must not touch, in the same form "
            "as --table. The option may be repeated.",
        ),
    ] = None,
    overhang: Annotated[
        float,
        typer.Option(
            metavar="M", help="How far the object may hang over the table's edge on the way, m."
        ),
    ] = 0.0,
    radius: options.PusherRadius = None,
    pusher: options.PushingShape = None,
    speed: Annotated[float, typer.Option(metavar="M/S", help="Speed of the pusher, m/s.")] = 0.03,
    tolerance: Annotated[
        float,
        typer.Option(
            metavar="M",
            help="How near is near enough: the goal counts as reached when the cells of the object "
            "are off by less than this on average, m.",
        ),
    ] = 0.005,
    max_pushes: Annotated[int, typer.Option(min=0, help="Largest number of pushes.")] = 25,
    horizon: Annotated[
        int,
        typer.Option(
            min=1,
            max=2,
            help="How many pushes to look ahead when one is chosen: 2 needs fewer pushes, 1 is "
            "planned faster.",
        ),
    ] = 2,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="PLAN.yaml", help="Also write the plan to this file."),
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option(
            metavar="PICTURE.png",
            callback=options.EXPECT_PNG,
            help="Also draw the plan into this picture.",
        ),
    ] = None,
    largest_piece: options.LargestPiece = False,
    force: options.Force = False,
    json: options.Json = False,
) -> None:
    """Plan pushes that bring an object to a goal pose.

    The object may be a learned model; otherwise its mass and friction are assumed to be spread
    evenly. The exit code is 1 if no plan reaches the goal.

    Example: gridpush plan model.yaml --goal 0.2,0.1,1.57 --table round:0.5 --picture plan.png
    """
    options.check_outputs(force, out, picture, inputs=(model,))
    goal_pose = options.parse_numbers("--goal", goal, "x,y,theta", "m, rad")
    start_pose = options.parse_numbers("--start", start, "x,y,theta", "m, rad")
    if not isfinite(overhang):
        raise options.OptionError(f"--overhang: is {overhang}; expected a finite number (m)")
    surface = None if table is None else options.parse_shape("--table", table)
    obstacles = [options.parse_shape("--obstacle", text).polygon for text in obstacle or ()]
    target = options.load_target(model, largest_piece)
    made = replace(options.make_pusher(radius, pusher, target.obj), speed=speed)
    radius = made.choose_radius(target.obj)
    # a plan's pushes are all of one speed, so that the regime is decided by it, not by the model's
    rules = GoalRules(
        PushConstraints(surface, tuple(obstacles), edge_margin=-overhang),
        ContactOptions(made, physics=target.make_physics("auto").with_regime("auto")),
        horizon=horizon,
        tolerance=tolerance,
        max_pushes=max_pushes,
    )
    options.compile_kernels()
    found = plan_pushes(Model(target.obj, target.params), start_pose, goal_pose, rules)
    _check_ends(found)
    with write_together():
        if out is not None:
            write_plan(out, found, target.obj.name, radius, force)
        if picture is not None:
            drawn = report.draw_plan(target.obj, found, surface, obstacles)
            write_whole(picture, report.to_png(drawn), force)
    written = [str(path) for path in (out, picture) if path is not None]
    document = {**describe_plan(found, target.obj.name, radius), "written": written}
    lines = [
        *_describe(speak_name(target.obj.name), found),
        *options.describe_written(out, picture),
    ]
    print_found(document, lines, json)
    if not found.reached:
        raise typer.Exit(options.EXIT_NO_PLAN)


def _check_ends(found: PushPlan) -> None:
    """Raises OptionError where the goal or the start is off the table or at an obstacle."""
    bad_ends = {
        PushPlanStatus.GOAL_OFF_TABLE: "--goal",
        PushPlanStatus.GOAL_BLOCKED: "--goal",
        PushPlanStatus.START_OFF_TABLE: "--start",
        PushPlanStatus.START_BLOCKED: "--start",
    }
    option = bad_ends.get(found.status)
    if option is not None:
        raise options.OptionError(
            f"{option}: {found.reason.rstrip('.')}; expected x,y,theta (m, rad) on the table, "
            "clear of all obstacles"
        )


def _describe(name: str, found: PushPlan) -> list[str]:
    """Returns a plan in lines of words, one for each push."""
    lines = [f"{name}: {found.status}: {found.reason}"]
    for number, (planned, error) in enumerate(
        zip(found.pushes, found.errors, strict=True), start=1
    ):
        x0, y0 = planned.push.xy[0] * MM_PER_M
        x1, y1 = planned.push.xy[-1] * MM_PER_M
        x, y, theta = planned.pose
        lines.append(
            f"push {number}  from {x0:.1f}, {y0:.1f} to {x1:.1f}, {y1:.1f} mm in "
            f"{planned.push.duration:.1f} s: object at x {x * MM_PER_M:.1f} mm, y "
            f"{y * MM_PER_M:.1f} mm, theta "
            f"{degrees(theta):.1f}°, its cells {error * MM_PER_M:.1f} mm from the goal on average"
        )
    if not found.pushes:
        lines.append(
            f"No push; the object's cells are {found.error * MM_PER_M:.1f} mm from the goal on "
            "average."
        )
    return [*lines, f"{found.simulations} simulated pushes, {found.seconds:.1f} s."]
