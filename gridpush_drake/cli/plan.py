"""`gridpush plan`: pushes that bring an object to a goal pose."""

from math import degrees, isfinite
from pathlib import Path
from typing import Annotated

import typer

from gridpush_drake.cli import options
from gridpush_drake.cli.console import MM, print_found
from gridpush_drake.files import write_whole
from gridpush_drake.planning.contact.trial import DEFAULT_RADIUS, ContactOptions
from gridpush_drake.planning.goal.next_push import GoalRules
from gridpush_drake.planning.goal.push_plan import (
    PushPlan,
    PushPlanStatus,
    describe_plan,
    plan_pushes,
    write_plan,
)
from gridpush_drake.planning.push_constraints import PushConstraints
from gridpush_drake.report.draw import to_png
from gridpush_drake.report.plan_figures import draw_plan


def plan(
    model: options.ObjectOrModel,
    goal: Annotated[
        str, typer.Option(metavar="X,Y,THETA", help="Where the object should lie, m and rad.")
    ],
    start: Annotated[
        str, typer.Option(metavar="X,Y,THETA", help="Where it lies, m and rad.")
    ] = "0,0,0",
    table: Annotated[
        str | None,
        typer.Option(
            metavar="SHAPE", help=f"The table's top: {options.FORMS}; endless where not given."
        ),
    ] = None,
    obstacle: Annotated[
        list[str] | None,
        typer.Option(
            metavar="SHAPE", help="What is in the way, in the same form; may be repeated."
        ),
    ] = None,
    overhang: Annotated[
        float, typer.Option(help="How far cells may hang over the table's edge, m.")
    ] = 0.0,
    radius: Annotated[
        float | None,
        typer.Option(
            help="Radius of the pusher, m; by default what the object's file says, or 0.008."
        ),
    ] = None,
    speed: Annotated[float, typer.Option(help="Speed of the pusher, m/s.")] = 0.03,
    tolerance: Annotated[
        float,
        typer.Option(help="Mean error of the cells below which the goal counts as reached, m."),
    ] = 0.005,
    max_pushes: Annotated[int, typer.Option(min=0, help="Greatest number of pushes.")] = 25,
    horizon: Annotated[int, typer.Option(min=1, max=2, help="Pushes to look ahead.")] = 2,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="PLAN.yaml", help="Write the plan.")
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option(metavar="PICTURE.png", callback=options.PNG, help="Draw the plan."),
    ] = None,
    largest_piece: options.LargestPiece = False,
    force: options.Force = False,
    json: options.Json = False,
) -> None:
    """Plan pushes that bring an object, or a learned model, to a goal pose."""
    options.check_outputs(force, out, picture, inputs=(model,))
    aim, pose = (
        options.parse_numbers(name, text, "x,y,theta")
        for name, text in (("--goal", goal), ("--start", start))
    )
    if not isfinite(overhang):
        raise options.OptionError(f"--overhang: is {overhang}; expected a finite number (m)")
    surface = None if table is None else options.parse_shape("--table", table)
    obstacles = [options.parse_shape("--obstacle", text).polygon for text in obstacle or ()]
    target = options.load_target(model, largest_piece)
    finger = target.obj.prior.pusher_radius or DEFAULT_RADIUS if radius is None else radius
    rules = GoalRules(
        PushConstraints(surface, tuple(obstacles), edge_margin=-overhang),
        ContactOptions(
            radius=finger, speed=speed, physics=target.make_physics("auto").with_regime("auto")
        ),
        horizon=horizon,
        tolerance=tolerance,
        max_pushes=max_pushes,
    )
    options.compile_kernels()
    found = plan_pushes(target.obj, target.params, pose, aim, rules)
    for option, ends in (
        ("--goal", (PushPlanStatus.GOAL_OFF_TABLE, PushPlanStatus.GOAL_BLOCKED)),
        ("--start", (PushPlanStatus.START_OFF_TABLE, PushPlanStatus.START_BLOCKED)),
    ):
        if found.status in ends:
            form = "expected x,y,theta (m, rad) on the table, clear of what is in the way"
            raise options.OptionError(
                f"{option}: {found.status}: {found.reason.rstrip('.')}; {form}"
            )
    if out is not None:
        write_plan(out, found, target.obj.name, finger, force)
    if picture is not None:
        write_whole(picture, to_png(draw_plan(target.obj, found, surface, obstacles)), force)
    written = [str(path) for path in (out, picture) if path is not None]
    document = {**describe_plan(found, target.obj.name, finger), "written": written}
    print_found(
        document,
        [*_describe(target.obj.name, found), *options.describe_written(out, picture)],
        json,
    )
    if not found.reached:
        raise typer.Exit(options.EXIT_NO_PLAN)


def _describe(name: str, found: PushPlan) -> list[str]:

    lines = [f"{name}: {found.status}: {found.reason}"]
    for number, (planned, error) in enumerate(
        zip(found.pushes, found.errors, strict=True), start=1
    ):
        (x0, y0), (x1, y1) = planned.push.xy[0] * MM, planned.push.xy[-1] * MM
        x, y, theta = planned.pose
        lines.append(
            f"push {number}  from {x0:.1f}, {y0:.1f} to {x1:.1f}, {y1:.1f} mm in {planned.push.duration:.1f} s: object "
            f"at x {x * MM:.1f} mm, y {y * MM:.1f} mm, theta {degrees(theta):.1f}°, its cells {error * MM:.1f} mm from "
            "the goal"
        )
    if not found.pushes:
        lines.append(f"No push; its cells are {found.error * MM:.1f} mm from the goal.")
    return [*lines, f"{found.simulations} simulated pushes, {found.seconds:.1f} s."]
