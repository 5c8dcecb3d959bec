"""`--unknown-inertia`, as `gridpush demo`, `gridpush robot` and `gridpush campaign` have it."""

from typing import Annotated

import typer

from gridpush_drake.cli.shell import options
from gridpush_drake.station.schema.scenario import PushScenario
from gridpush_drake.station.tasks.registry import TASK_KINDS, name_tasks

WEIGHING_TASKS = name_tasks(lambda kind: kind.weighs)
"""Tasks in which the object is weighed, in words."""

UnknownInertia = Annotated[
    bool,
    typer.Option(
        "--unknown-inertia",
        help="Tell the robot neither the object's mass nor bounds of its friction. It then weighs "
        "the object on the way: its finger presses on what hangs over the table's edge, up to the "
        f"first sign of tilt. Only with --task {WEIGHING_TASKS}.",
    ),
]
"""`--unknown-inertia`, see `hide_inertia`."""


def hide_inertia(scenario: PushScenario, task: str) -> None:
    """Changes a scenario so that the robot is told nothing of the object.

    Raises:
        OptionError: the task weighs nothing.
    """
    if not TASK_KINDS[task].weighs:
        raise options.OptionError(
            f"--unknown-inertia: goes with --task {WEIGHING_TASKS} only; in --task {task} nothing "
            "is weighed"
        )
    scenario.unknown_inertia = True
