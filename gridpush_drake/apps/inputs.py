"""What the commands read: objects, models and push logs."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from gridpush_drake.files import exists

if TYPE_CHECKING:
    from collections.abc import Sequence

    from gridpush_drake.grid.object import GridObject
    from gridpush_drake.grid.parameters import CellParameters
    from gridpush_drake.identification.result import Identification
    from gridpush_drake.pushes.log import PushLog


@dataclass(frozen=True, eq=False)
class Target:
    """What a command works on.

    Attributes:
        obj: the object.
        params: what it is taken to weigh and rub: the model's, or uniform ones by the object's prior.
        model: the model, where it is one.
    """

    obj: "GridObject"
    params: "CellParameters"
    model: "Identification | None" = None

    def resolve_regime(self, regime: str, default: str) -> str:
        """`regime`, or, where it is "auto", the model's, or else `default`."""
        if regime != "auto":
            return regime
        return self.model.regime if self.model else default


def load_object(name: str, largest_piece: bool = False) -> "GridObject":
    """Reads an object by its file or by the name it is shipped under. Raises ObjectError where there is neither."""
    from gridpush_drake.grid.object import GridObject

    return GridObject.from_yaml(object_path(name), largest_piece=largest_piece)


def object_path(name: str) -> Path:
    """The file of an object; a file goes before a shipped object of the same name."""
    from gridpush_drake.grid.object_file import find_shipped_object

    path = Path(name)
    return path if exists(path) or path.suffix else find_shipped_object(name)


def load_target(name: str, largest_piece: bool = False) -> Target:
    """Reads an object or a model. Raises ObjectError or IdentificationError where it is neither."""
    from gridpush_drake.grid.parameters import CellParameters
    from gridpush_drake.identification.model_file import looks_like_model, read_model

    if looks_like_model(name):
        model = read_model(name)
        return Target(model.obj, model.params, model)
    obj = load_object(name, largest_piece)
    return Target(obj, CellParameters.uniform(obj))


def load_log(path: Path, obj: "GridObject", *, require_final: bool = True) -> "PushLog":
    """Reads a push log, made with the pusher that the object's file names."""
    from gridpush_drake.pushes.log import PushLog

    log = PushLog.read_csv(path, require_final=require_final)
    if log.radius_given or obj.prior.pusher_radius is None:
        return log
    return log.with_radius(obj.prior.pusher_radius)


def describe_overhanging(names: "Sequence[str]") -> str:
    """Says which pushes were left out, and why."""
    count = f"{len(names)} push{'' if len(names) == 1 else 'es'}"
    return f"left out {count}, as the object hung over the table's edge: {', '.join(names)}"
