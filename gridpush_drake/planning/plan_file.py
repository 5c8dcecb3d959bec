"""A push plan as a YAML file, and as the document that it holds."""

from pathlib import Path
from typing import Any

import yaml

from gridpush_drake.files import write_whole
from gridpush_drake.planning.push_plan import PushPlan

FORMAT_VERSION = 1

HEADER = """\
# Pushes that bring an object to a goal pose, planned by gridpush.
# SI units, radians, world frame; `start` is the place of the pusher's centre, `pose` the object's predicted pose after
# the push (x, y, theta), `error` the mean distance of the object's cells from where they are at the goal.
"""

LINE_WIDTH = 120


def describe_plan(plan: PushPlan, name: str, radius: float) -> dict[str, Any]:
    """A plan as plain lists and numbers.

    Args:
        plan: the plan.
        name: of the object.
        radius: of the pusher, m.

    Returns:
        The document.
    """
    return {
        "gridpush_plan": FORMAT_VERSION,
        "object": name,
        "status": plan.status,
        "reason": plan.reason,
        "start": plan.start.tolist(),
        "goal": plan.goal.tolist(),
        "error": plan.error,
        "simulations": plan.simulations,
        "pusher_radius": radius,
        "pushes": [
            {
                "start": planned.push.start.tolist(),
                "velocity": planned.push.velocity.tolist(),
                "duration": planned.push.duration,
                "arc_length": planned.arc_length,
                "angle": planned.angle,
                "distance": planned.distance,
                "pose": planned.pose.tolist(),
                "error": float(error),
            }
            for planned, error in zip(plan.pushes, plan.errors, strict=True)
        ],
    }


def write_plan(path: Path | str, plan: PushPlan, name: str, radius: float, force: bool = False) -> None:
    """Writes a plan.

    Args:
        path: the YAML file.
        plan: the plan.
        name: of the object.
        radius: of the pusher, m.
        force: whether an existing file may be replaced.

    Raises:
        OutputError: the file exists and `force` is not set, or it cannot be written.
    """
    document = describe_plan(plan, name, radius)
    text = yaml.dump(document, Dumper=_Dumper, sort_keys=False, width=LINE_WIDTH)
    write_whole(path, HEADER + text, force)


class _Dumper(yaml.SafeDumper):
    """Lists of numbers on one line."""


def _represent_list(dumper: Any, value: list[Any]) -> Any:
    return dumper.represent_sequence("tag:yaml.org,2002:seq", value, flow_style=not any(map(_is_block, value)))


def _is_block(value: Any) -> bool:
    return isinstance(value, dict | list)


_Dumper.add_representer(list, _represent_list)
