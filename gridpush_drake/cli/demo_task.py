"""What the demo's tasks have in common: how each is set up, run, written down and judged."""

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pydrake.geometry import Meshcat
    from pydrake.systems.analysis import Simulator

    from gridpush_drake.station.scenario import PushScenario


@dataclass(frozen=True)
class DemoTask:
    """A task of the demo; `Record` below stands for its own kind of record.

    Attributes:
        files: that it leaves in its folder, the report first.
        make_scenario: the one that it has by itself.
        run: scenario, Meshcat, realtime rate -> Record. Begins Meshcat's recording when all is set up.
        write: folder, scenario, Record, Meshcat, force -> the files written.
        judge: Record -> what came of it, for JSON; "status" and "done" among it.
        tell: verdict, files written -> prints it.
    """

    files: tuple[str, ...]
    make_scenario: Callable[[], "PushScenario"]
    run: Callable[["PushScenario", "Meshcat", float], Any]
    write: Callable[[Path, "PushScenario", Any, "Meshcat", bool], list[Path]]
    judge: Callable[[Any], dict[str, Any]]
    tell: Callable[[dict[str, Any], list[Path]], None]


FRAMES_A_SECOND = 20.0
"""Of the recording."""


def describe_time(simulator: "Simulator") -> str:
    """How far a simulation is, for whoever waits."""
    return f"{simulator.get_context().get_time():.0f} s simulated"


MODULES = {"identify": "demo_identify", "push": "demo_push", "pregrasp": "demo_pre_grasp"}
"""Where each task is."""


def load_task(name: str) -> DemoTask:
    """Finds a task, by one of the words of `demo.TaskName`; what it needs is imported only now."""
    task: DemoTask = import_module(f"gridpush_drake.cli.{MODULES[name]}").TASK
    return task
