"""`gridpush slide`: plans pushes that bring an object to the table's edge, to be grasped there."""

import json
from dataclasses import replace
from math import degrees
from pathlib import Path
from typing import Annotated, Any

import typer

from gridpush_drake import report
from gridpush_drake.cli.shell import options
from gridpush_drake.cli.shell.console import print_found, to_json
from gridpush_drake.dynamics.push import Push
from gridpush_drake.errors import PlanningError
from gridpush_drake.files import write_together, write_whole
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.belief import Belief
from gridpush_drake.planning.exploration.designed_pokes import PokeOptions
from gridpush_drake.planning.plausible_masses import PlausibleMassSet
from gridpush_drake.planning.pregrasp.decision import PreGraspOptions
from gridpush_drake.planning.pregrasp.goals import ANY_ARM, ArmLimits, GoalOptions, PreGraspGoal
from gridpush_drake.planning.pregrasp.grasp.grasp_parts import FlatPart, find_held_grasps
from gridpush_drake.planning.pregrasp.grasp.gripper import Gripper, PadLimit
from gridpush_drake.planning.pregrasp.planner import ACCEPTED_FRACTION, PreGraspPlanner
from gridpush_drake.planning.pregrasp.pregrasp_plan import (
    PreGraspPlan,
    PreGraspPlanStatus,
    plan_pregrasp,
)
from gridpush_drake.planning.pregrasp.slides import SlideOptions
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.pushes.push_csv import describe_pusher
from gridpush_drake.units import MM_PER_M
from gridpush_drake.yaml_file import dump_yaml


def slide(
    model: options.ObjectOrModel,
    table: options.Table,
    start: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,THETA",
            help="Where the object lies in the beginning, world frame, m and rad.",
            show_default="in the middle of the table",
        ),
    ] = None,
    opening: Annotated[
        float,
        typer.Option(
            metavar="M",
            help="How far the gripper opens, m. What it takes has to be narrower than that.",
        ),
    ] = Gripper.level_opening,
    depth: Annotated[
        float,
        typer.Option(
            metavar="M",
            help="Depth of the gripper's fingers, m. So much of the object has to hang over the "
            "edge where it is grasped.",
        ),
    ] = Gripper.finger_depth,
    pad_force: Annotated[
        float | None,
        typer.Option(
            metavar="N",
            help="Also try to take the object by its rim, with one finger of the gripper below it "
            "and one above it. This is for objects that are too wide everywhere else. N is the "
            "force with which the gripper presses, in newtons.",
            show_default="no grasp by the rim",
        ),
    ] = None,
    margin: Annotated[
        float,
        typer.Option(
            metavar="M",
            help="Stability margin that is asked for, m: how far from tipping the object has to "
            "stay, wherever its center of mass may be.",
        ),
    ] = 0.003,
    radius: options.PusherRadius = None,
    pusher: options.PushingShape = None,
    friction: Annotated[
        str | None,
        typer.Option(
            metavar="MIN,MAX",
            help="Smallest and largest friction coefficient that a cell may have on the table. The "
            "closer they are, the better the center of mass is known.",
            show_default="those of the object's file",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            metavar="PLAN",
            help="Also write the plan to this file, as YAML, or as JSON if its name ends with "
            ".json.",
        ),
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option(
            metavar="PICTURE.png",
            callback=options.EXPECT_PNG,
            help="Also draw the plan into this picture: the pushes, what hangs over the edge, and "
            "what keeps the object from falling.",
        ),
    ] = None,
    largest_piece: options.LargestPiece = False,
    force: options.Force = False,
    json: options.Json = False,
) -> None:
    """Plan pushes that bring an object to the table's edge, so that it can be grasped there.

    In the end a part that the gripper can take hangs over the edge, and the object does not fall
    wherever its center of mass may be. If too little is known of it, the command names the poke
    that would tell most. The exit code is 1 if there is no plan.

    Example: gridpush slide model.yaml --table rectangle:0.8x0.6 --picture slide.png
    """
    options.check_outputs(force, out, picture, inputs=(model,))
    surface = options.parse_shape("--table", table)
    target = options.load_target(model, largest_piece)
    if start is None:
        middle = surface.polygon.representative_point()
        pose: tuple[float, ...] = (middle.x, middle.y, 0.0)
    else:
        pose = options.parse_numbers("--start", start, "x,y,theta", "m, rad")
    bounds = None
    if friction is not None:
        low, high = options.parse_numbers("--friction", friction, "min,max", "coefficients")
        bounds = (low, high)
    made = options.make_pusher(radius, pusher, target.obj)
    gripper = Gripper(opening=opening, level_opening=opening, finger_depth=depth)
    limits = ANY_ARM
    if pad_force is not None:
        pads = gripper.limit_pads(target.obj, pad_force)
        limits = _limit_to_held(target.obj, surface, pads)
    chosen = PreGraspOptions(
        gripper=gripper,
        pad_force=pad_force,
        goal=GoalOptions(margin=margin),
        slide=SlideOptions(
            margin=ACCEPTED_FRACTION * margin,
            contact=replace(SlideOptions().contact, pusher=made),
        ),
        poke=PokeOptions(made),
    )
    try:
        planner = PreGraspPlanner(target.obj, surface, chosen, limits=limits)
    except PlanningError as error:
        # The object's size and the table's are known only together.
        text = str(error)
        raise PlanningError(f"--{text}" if text.startswith("table: ") else text) from error
    if not surface.contains(target.obj.cells_at(pose)).any():
        raise options.OptionError(
            f"--start: is {start}; expected a pose in which the object lies on the table"
        )
    options.compile_kernels()
    if target.model is None:
        uncertain = Belief.of_prior(target.obj, friction_range=bounds)
    else:
        uncertain = Belief.of_identification(target.model, friction_range=bounds)
    plan = plan_pregrasp(planner, uncertain, pose)
    found = _describe(planner, plan, "learned" if target.model else "prior")
    found["written"] = [str(path) for path in (out, picture) if path is not None]
    with write_together():
        if out is not None:
            write_whole(out, _to_text(found, out), force)
        if picture is not None:
            drawn = report.draw_slide(planner, uncertain.masses, plan)
            write_whole(picture, report.to_png(drawn), force)
    print_found(found, [*_explain(found), *options.describe_written(out, picture)], json)
    if plan.status != PreGraspPlanStatus.READY:
        raise typer.Exit(options.EXIT_NO_PLAN)


def _limit_to_held(obj: GridObject, surface: SupportSurface, pads: PadLimit) -> ArmLimits:
    """Makes the limits that let only those grasps by the rim pass that hold the object.

    The gripper also has to get there without touching the table. Other grasps are not limited.
    """
    height = obj.height or options.DEFAULT_HEIGHT
    pads.gripper.check_thickness(obj, height)

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
    """Returns a plan for machines; lengths are in m and angles in rad.

    Args:
        planner: what made the plan.
        plan: the plan.
        model: "learned" or "prior", what the plan was made by.
    """
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
    """Returns for machines where and how a goal's object is grasped, world frame."""
    if isinstance(goal.part, FlatPart):
        return {"at": goal.p_WG, "by": "rim", "approach": goal.part.heading + goal.pose[2]}
    return {
        "at": goal.p_WG,
        "by": "narrow part",
        "closing": goal.closing_W,
        "width": goal.part.width,
    }


def _describe_push(push: Push) -> dict[str, Any]:
    """Returns a push for machines."""
    place = {"from": push.xy[0], "to": push.xy[-1], "duration": push.duration}
    return {**place, "radius": push.radius, **describe_pusher(push)}


def _to_text(found: dict[str, Any], out: Path) -> str:
    """Returns the text of a plan's file."""
    document = to_json({key: value for key, value in found.items() if key != "written"})
    if out.suffix == ".json":
        return document
    # by way of JSON, which turns arrays into lists and leaves plain values
    return dump_yaml(json.loads(document), allow_unicode=True)


def _explain(found: dict[str, Any]) -> list[str]:
    """Returns a plan in lines of words."""
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
            how = f"{grasp['width'] * MM_PER_M:.1f} mm wide"
        lines += [
            f"goal  {_tell_pose(goal['pose'])}; stability margin at the worst "
            f"{goal['stability_margin'] * MM_PER_M:.1f} mm",
            f"grasp at x {grasp['at'][0] * MM_PER_M:.1f} mm, y {grasp['at'][1] * MM_PER_M:.1f} "
            f"mm, {how}",
        ]
    for i, push in enumerate(found["pushes"], start=1):
        x0, y0 = push["from"]
        x1, y1 = push["to"]
        lines.append(
            f"push {i}  from {x0 * MM_PER_M:.1f} mm, {y0 * MM_PER_M:.1f} mm to "
            f"{x1 * MM_PER_M:.1f} mm, "
            f"{y1 * MM_PER_M:.1f} mm in {push['duration']:.1f} s: object at "
            f"{_tell_pose(push['object_after'])}"
        )
    return lines


def _tell_pose(pose: Any) -> str:
    """Returns a pose in words, in mm and degrees."""
    x, y, theta = pose
    return f"x {x * MM_PER_M:.1f} mm, y {y * MM_PER_M:.1f} mm, theta {degrees(theta):.1f}°"
