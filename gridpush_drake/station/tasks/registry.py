"""The registry of tasks: `TASK_KINDS` has the `TaskKind` of each task that the commands know.

Which tasks there are, and where each is declared, is in `station.schema.task_table`.
"""

from collections.abc import Callable

from gridpush_drake.station.schema.task_table import TASKS, load_declared
from gridpush_drake.station.tasks.task_kind import TaskKind

TASK_KINDS: dict[str, TaskKind] = {
    name: load_declared(entry.kind)() for name, entry in TASKS.items()
}
"""The kinds of tasks by their names."""


def name_tasks(suits: Callable[[TaskKind], bool]) -> str:
    """Names the tasks whose kinds suit, as in "push or follow", for messages and help."""
    return " or ".join(name for name, kind in TASK_KINDS.items() if suits(kind))


def explain_tasks() -> str:
    """Explains in a paragraph what each task is, for help: first those with one object."""

    def explain(several: bool) -> str:
        """Explains the tasks with one object, or those with several."""
        kinds = TASK_KINDS.items()
        return "; ".join(f"{name}: {kind.help}" for name, kind in kinds if kind.several is several)

    return f"{explain(False)}. With several objects: {explain(True)}."
