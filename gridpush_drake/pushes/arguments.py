"""Arguments of functions that take a push log: its file will do, and swapped ones are named."""

from collections.abc import Mapping, Sequence
from itertools import permutations
from os import PathLike
from pathlib import Path
from typing import Any

from gridpush_drake.dynamics.pusher import find_pusher_radius
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.pushes.push_log import PushLog

PushLogOrFile = PushLog | str | Path
"""A push log, or the name of the CSV file that `PushLog.read_csv` reads it from."""

LOG_TYPES = (PushLog, str, PathLike)
"""Types that an argument that is a `PushLogOrFile` may have."""

TYPE_HINTS = {
    "GridObject": "a GridObject, such as GridObject.from_yaml reads",
    "Model": "a Model, such as Model(obj) makes of a GridObject",
    "PushLog": "a PushLog, or the name of its CSV file",
}
"""What is expected, by the name of the first of an argument's types."""


def check_types(function: str, **arguments: tuple[Any, tuple[type, ...]]) -> None:
    """Checks the types of a function's arguments.

    Args:
        function: its name, for the message.
        arguments: in the function's order, each one's value and the types that it may have.

    Raises:
        TypeError: an argument is of another type. The message names it, says what is expected, and
            whether arguments are swapped.
    """
    wrong = [name for name, (value, types) in arguments.items() if not isinstance(value, types)]
    if not wrong:
        return
    names = list(arguments)
    values = [value for value, _ in arguments.values()]
    found = " and ".join(f"{name} is {_describe_type(arguments[name][0])}" for name in wrong)
    for order in permutations(values):
        if all(
            isinstance(value, types)
            for value, (_, types) in zip(order, arguments.values(), strict=True)
        ):
            raise TypeError(
                f"{function}: {found}: the arguments are swapped; expected "
                f"{function}({', '.join(names)})"
            )
    first = arguments[wrong[0]][1][0]
    expected = TYPE_HINTS.get(first.__name__, f"a {first.__name__}")
    raise TypeError(
        f"{function}: {found}; expected for {wrong[0]} {expected}" + _suggest(wrong[0], arguments)
    )


def read_log(log: PushLogOrFile, objects: Sequence[GridObject], *, require_final: bool) -> PushLog:
    """Takes a push log, or reads its file with the radius of the pusher in the objects' files.

    Args:
        log: a push log, which is given back as it is, or the name of its CSV file.
        objects: the objects.
        require_final: whether every push of a file must have a pose after its first row.

    Raises:
        PushLogError: the file cannot be read or breaks the form, or the log is of another number of
            objects.
        ObjectError: the objects' files name pushers of different radii.
    """
    if isinstance(log, PushLog):
        log.check_objects(objects)
        return log
    read = PushLog.read_csv(Path(log), require_final=require_final)
    read.check_objects(objects)
    radius = find_pusher_radius(objects)
    return read if radius is None else read.with_radius(radius)


def _describe_type(value: Any) -> str:
    name = type(value).__name__
    return f"{'an' if name[0] in 'AEIOU' else 'a'} {name}"


def _suggest(name: str, arguments: Mapping[str, tuple[Any, tuple[type, ...]]]) -> str:
    """What the caller may have meant."""
    value = arguments[name][0]
    if isinstance(value, (list, tuple)) and arguments[name][1] == LOG_TYPES:
        return "; PushLog(pushes) makes a log of several pushes"
    return ""
