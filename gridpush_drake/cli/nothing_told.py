"""`--nothing-told`, as `gridpush demo` and `gridpush robot` have it."""

from typing import Annotated

import typer

from gridpush_drake.cli import options
from gridpush_drake.station.scenario import PushScenario
from gridpush_drake.station.tasks import TaskName

NothingTold = Annotated[
    bool,
    typer.Option(
        "--nothing-told",
        help="Tell the robot neither the object's mass nor bounds of its friction. It then weighs "
        "the object on the way: its finger presses on what hangs over the table's edge, up to the "
        "first sign of tilt. Only with --task pregrasp.",
    ),
]
"""`--nothing-told`, see `tell_nothing`."""


def tell_nothing(scenario: PushScenario, task: TaskName) -> None:
    """Changes a scenario so that the robot is told nothing of the object.

    Raises:
        OptionError: the task weighs nothing.
    """
    if task is not TaskName.pregrasp:
        raise options.OptionError(
            f"--nothing-told: goes with --task pregrasp only; in --task {task} nothing is weighed"
        )
    scenario.nothing_told = True
