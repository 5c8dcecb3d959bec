"""Learn an unknown object's mass and friction by pushing it, and predict where the next push takes it.

The names below are the public ones. They are imported on first use, so that `import gridpush_drake` costs nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gridpush_drake.dynamics.push import ForcePush, Push
    from gridpush_drake.dynamics.simulation import simulate, simulate_batch
    from gridpush_drake.errors import GridPushError
    from gridpush_drake.identification.learning import identify
    from gridpush_drake.identification.result import Identification
    from gridpush_drake.objects.grid_object import GridObject, PhysicalPrior
    from gridpush_drake.objects.parameters import CellParameters
    from gridpush_drake.pushes.push_log import PushLog

    __version__: str

__all__ = [
    "CellParameters",
    "ForcePush",
    "GridObject",
    "GridPushError",
    "Identification",
    "PhysicalPrior",
    "Push",
    "PushLog",
    "identify",
    "simulate",
    "simulate_batch",
]

_HOMES = {
    "CellParameters": "objects.parameters",
    "ForcePush": "dynamics.push",
    "GridObject": "objects.grid_object",
    "GridPushError": "errors",
    "Identification": "identification.result",
    "PhysicalPrior": "objects.grid_object",
    "Push": "dynamics.push",
    "PushLog": "pushes.push_log",
    "identify": "identification.learning",
    "simulate": "dynamics.simulation",
    "simulate_batch": "dynamics.simulation",
}


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        value: Any = version("gridpush-drake")
    elif name in _HOMES:
        value = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__, "__version__"])
