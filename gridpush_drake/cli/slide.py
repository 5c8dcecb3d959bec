"""`gridpush slide`: where to slide an object so that it can be grasped at the table's edge, and by which pushes."""

import json
from dataclasses import replace
from math import degrees
from pathlib import Path
from typing import Annotated, Any

import typer

from gridpush_drake.cli import options
from gridpush_drake.cli.console import MM, print_found, to_json
from gridpush_drake.files import write_whole
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.contact.trial import DEFAULT_RADIUS
from gridpush_drake.planning.pregrasp.exploration import PokeOptions
from gridpush_drake.planning.pregrasp.goals import ANY_ARM, ArmLimits, GoalOptions, PreGraspGoal
from gridpush_drake.planning.pregrasp.grasp_parts import (
    FlatPart,
    Gripper,
    PadLimit,
    find_held_grasps,
)
from gridpush_drake.planning.pregrasp.planner import (
    ACCEPTED_SHARE,
    PreGraspOptions,
    PreGraspPlan,
    PreGraspPlanner,
    PreGraspPlanStatus,
    plan_pregrasp,
)
from gridpush_drake.planning.pregrasp.side_grasp import SideGripper, check_thickness
from gridpush_drake.planning.pregrasp.slides import SlideOptions
from gridpush_drake.planning.pregrasp.uncertainty import PlausibleMassSet, UncertainModel
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.report.draw import to_png
from gridpush_drake.report.plan_figures import draw_slide
from gridpush_drake.yaml_file import dump_yaml

USUAL_HEIGHT = 0.03
"""Of an object whose file does not say how thick it is, m."""


def slide(
    model: options.ObjectOrModel,
    table: options.Table,
    start: Annotated[
        str | None,
        typer.Option(
            metavar="x,y,theta",
            help="Where the object is, m and rad; by default in the table's middle.",
        ),
    ] = None,
    opening: Annotated[float, typer.Option(help="How far the gripper opens, m.")] = 0.11,
    depth: Annotated[
        float, typer.Option(help="Depth of the gripper's fingers, which must hang over, m.")
    ] = 0.03,
    pad_force: Annotated[
        float | None,
        typer.Option(
            metavar="N",
            help="Also take by its rim what is narrow nowhere, between a jaw below it and one above that press with so "
            "much in all.",
        ),
    ] = None,
    margin: Annotated[float, typer.Option(help="Stability margin asked for, m.")] = 0.003,
    radius: Annotated[
        float | None,
        typer.Option(
            help="Radius of the pusher, m; by default what the object's file says, or 0.008."
        ),
    ] = None,
    friction: Annotated[
        str | None,
        typer.Option(
            metavar="min,max",
            help="Bounds of the friction with the table; by default those of the object's file.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", "-o", metavar="PLAN", help="Write the plan: .yaml, or .json for JSON."
        ),
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option(
            metavar="PICTURE.png",
            callback=options.PNG,
            help="Draw the plan, what hangs over and what holds it.",
        ),
    ] = None,
    largest_piece: options.LargestPiece = False,
    force: options.Force = False,
    json: options.Json = False,
) -> None:
    """Plan pushes to the table's edge, until a part hangs over that a gripper can take and nothing falls."""
    options.check_outputs(force, out, picture, inputs=(model,))
    surface = options.parse_shape("--table", table)
    target = options.load_target(model, largest_piece)
    middle = surface.polygon.representative_point()
    pose = (
        (middle.x, middle.y, 0.0)
        if start is None
        else options.parse_numbers("--start", start, "x,y,theta")
    )
    bounds = None
    if friction is not None:
        low, high = options.parse_numbers("--friction", friction, "min,max")
        bounds = low, high
    finger = target.obj.prior.pusher_radius or DEFAULT_RADIUS if radius is None else radius
    pads = limits = None
    if pad_force is not None:
        pads = PadLimit.of_object(target.obj, SideGripper(opening=opening), pad_force)
        limits = _limit_to_held(target.obj, surface, pads)
    chosen = PreGraspOptions(
        gripper=Gripper(opening=opening, depth=depth),
        goal=GoalOptions(margin=margin),
        slide=SlideOptions(
            margin=ACCEPTED_SHARE * margin, contact=replace(SlideOptions().contact, radius=finger)
        ),
        poke=PokeOptions(radius=finger),
        pads=pads,
    )
    planner = PreGraspPlanner(target.obj, surface, chosen, limits=limits or ANY_ARM)
    if not surface.contains(target.obj.cells_at(pose)).any():
        raise options.OptionError(f"--start: is {start}; expected a place on the table")
    options.compile_kernels()
    if target.model is None:
        uncertain = UncertainModel.of_prior(target.obj, friction_range=bounds)
    else:
        uncertain = UncertainModel.of_identification(target.model, friction_range=bounds)
    plan = plan_pregrasp(planner, uncertain, pose)
    found = _describe(planner, plan, "learned" if target.model else "prior")
    found["written"] = [str(path) for path in (out, picture) if path is not None]
    if out is not None:
        write_whole(out, _to_text(found, out), force)
    if picture is not None:
        write_whole(picture, to_png(draw_slide(planner, uncertain.masses, plan)), force)
    print_found(found, [*_explain(found), *options.describe_written(out, picture)], json)
    if plan.status != PreGraspPlanStatus.READY:
        raise typer.Exit(options.EXIT_NO_PLAN)


def _limit_to_held(obj: GridObject, surface: SupportSurface, pads: PadLimit) -> ArmLimits:
    """Asks of a goal with a part of the rim whether the gripper gets there clear of the table, and holds the object."""
    height = obj.height or USUAL_HEIGHT
    check_thickness(obj, height, pads.gripper)

    def can_grasp(goal: PreGraspGoal, masses: PlausibleMassSet) -> bool:
        if not isinstance(goal.part, FlatPart):
            return True
        return bool(
            find_held_grasps(
                obj, goal.pose, surface, pads, goal.part.p_BG, height, masses, at_worst=True
            )
        )

    return ArmLimits(can_grasp=can_grasp)


def _describe(planner: PreGraspPlanner, plan: PreGraspPlan, model: str) -> dict[str, Any]:
    goal = plan.goal
    found: dict[str, Any] = {
        "object": planner.obj.name,
        "model": model,
        "graspable_parts": len(planner.parts),
        "rim_parts": len(planner.flat_parts),
        "status": plan.status.value,
        "message": plan.message,
        "goal": None,
        "pushes": [],
        "poke": None if plan.poke is None else _describe_push(plan.poke),
    }
    if goal is not None:
        found["goal"] = {
            "pose": goal.pose,
            "overhang": goal.overhang,
            "stability_margin": goal.margin,
            "grasp": _describe_grasp(goal),
        }
    for push, after in zip(plan.pushes, plan.poses[1:], strict=True):
        found["pushes"].append({**_describe_push(push), "object_after": after})
    return found


def _describe_grasp(goal: PreGraspGoal) -> dict[str, Any]:

    if isinstance(goal.part, FlatPart):
        return {"at": goal.p_WG, "by": "rim", "approach": goal.part.heading + goal.pose[2]}
    return {
        "at": goal.p_WG,
        "by": "narrow part",
        "closing": goal.closing_W,
        "width": goal.part.width,
    }


def _describe_push(push: Any) -> dict[str, Any]:
    return {"from": push.xy[0], "to": push.xy[-1], "duration": push.duration, "radius": push.radius}


def _to_text(found: dict[str, Any], out: Path) -> str:
    document = to_json({key: value for key, value in found.items() if key != "written"})
    if out.suffix == ".json":
        return document

    return dump_yaml(json.loads(document), allow_unicode=True)


def _explain(found: dict[str, Any]) -> list[str]:
    lines = [f"{found['object']}: {found['status']}: {found['message']}"]
    if found["model"] == "prior":
        lines.append(
            f"{found['object']} is an object, not a model: nothing is known of its masses yet."
        )
    goal = found["goal"]
    if goal is not None:
        grasp = goal["grasp"]
        if grasp["by"] == "rim":
            how = f"by the rim, the fingers pointing along {degrees(grasp['approach']):.1f}°"
        else:
            how = f"{grasp['width'] * MM:.1f} mm wide"
        lines += [
            f"goal  {_tell_pose(goal['pose'])}; stability margin {goal['stability_margin'] * MM:.1f} mm at the worst",
            f"grasp at x {grasp['at'][0] * MM:.1f} mm, y {grasp['at'][1] * MM:.1f} mm, {how}",
        ]
    for i, push in enumerate(found["pushes"], start=1):
        (x0, y0), (x1, y1) = push["from"], push["to"]
        lines.append(
            f"push {i}  from {x0 * MM:.1f} mm, {y0 * MM:.1f} mm to {x1 * MM:.1f} mm, {y1 * MM:.1f} mm "
            f"in {push['duration']:.1f} s: object at {_tell_pose(push['object_after'])}"
        )
    return lines


def _tell_pose(pose: Any) -> str:
    x, y, theta = pose
    return f"x {x * MM:.1f} mm, y {y * MM:.1f} mm, theta {degrees(theta):.1f}°"
