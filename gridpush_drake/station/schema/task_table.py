"""The table of tasks: one line for each task that `gridpush demo`, `robot` and `campaign` know.

A task declares itself in the modules that its line names. Nothing else in the package names a task:
commands, campaigns and exports read what they need from its `TaskKind`
(`station.tasks.registry`), and a scenario takes the task's section from here. The names are
imported only when they are asked for, so that this table costs nothing, and a scenario, which has
to know all sections, does not need the tasks.
"""

from collections.abc import Iterator
from pkgutil import resolve_name
from typing import Any, NamedTuple, TypeVar

from pydantic import BaseModel, create_model

from gridpush_drake.station.schema.fields import Config


class TaskEntry(NamedTuple):
    """Where a task is declared; both places are "MODULE:NAME" within `station.tasks`.

    Attributes:
        kind: the task's `TaskKind`, which says all that is not about scenarios.
        section: the `Config` of its section of a scenario, which stands there under the task's
            name; empty if the sections that every scenario has will do. Its module imports
            nothing of a task, as every scenario needs it.
    """

    kind: str
    section: str = ""


TASKS = {
    "identify": TaskEntry("identify_task:IdentifyKind"),
    "push": TaskEntry("push_task:PushKind"),
    "pregrasp": TaskEntry("pregrasp_kind:PreGraspKind"),
    "slide": TaskEntry("pregrasp_kind:SlideKind"),
    "follow": TaskEntry("follow_task:FollowKind", section="follow_config:FollowConfig"),
    "line": TaskEntry("line_task:LineKind", section="line_config:LineConfig"),
    "separate": TaskEntry("scene_kinds:SeparateKind"),
    "rearrange": TaskEntry("scene_kinds:RearrangeKind"),
    "fetch": TaskEntry("scene_kinds:FetchKind"),
}
"""The tasks by their names, in the order in which they are listed to the user."""

DEFAULT_TASK = "pregrasp"
"""Name of the task that a command does if none is named."""

TASKS_PACKAGE = "gridpush_drake.station.tasks"
"""Package of the modules that the table names."""


def load_declared(place: str) -> Any:
    """Imports what a place in the table names."""
    return resolve_name(f"{TASKS_PACKAGE}.{place}")


def list_sections() -> Iterator[tuple[str, type[Config]]]:
    """Yields the tasks' sections of a scenario, each with its key."""
    for name, entry in TASKS.items():
        if entry.section:
            yield name, load_declared(entry.section)


Schema = TypeVar("Schema", bound=BaseModel)


def add_task_sections(schema: type[Schema]) -> type[Schema]:
    """Adds the tasks' sections to a schema, after its own fields, each with its defaults.

    In the code `PushScenario.section` gives a section with its type; its name is an attribute, too.
    """
    sections: dict[str, Any] = {name: (section, section()) for name, section in list_sections()}
    return create_model(
        schema.__name__,
        __base__=schema,
        __module__=schema.__module__,
        __doc__=schema.__doc__,
        **sections,
    )
