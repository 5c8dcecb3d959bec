"""Importers of public data sets, motion capture and ROS bags: what one is, and which there are.

An importer is a frozen dataclass in a file of its own here, and a line in `IMPORTER_CLASSES`; its
fields are then the options of `gridpush import NAME`. What it reads becomes a push log and an
object, in SI units, radians and one world frame.
"""

from importlib import import_module
from pathlib import Path
from typing import ClassVar, Protocol

from gridpush_drake.errors import PushLogError
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.pushes.push_csv import PUSHER_HELP
from gridpush_drake.pushes.push_log import PushLog

IMPORTER_CLASSES = {
    "bag": "bag.BagImporter",
    "closed-loop": "closed_loop.ClosedLoopImporter",
    "cmu": "cmu.CmuImporter",
    "dubins": "dubins.DubinsImporter",
    "mit": "mit.MitImporter",
    "mit-tracked": "mit_tracked.MitTrackedImporter",
    "qualisys": "qualisys.QualisysImporter",
    "two-point": "two_point.TwoPointImporter",
}
"""By the name that follows `gridpush import`: the module here, and the class in it."""


class Importer(Protocol):
    """Reads one file of others' pushes; its fields are what a user may choose.

    A field is a bool, a number, a text, or a GridObject where an object's file or name is asked
    for. Its metadata has its `help` and, where it is not called after the field, its `name` on the
    command line. The first line of the class's docstring is the command's help. If an import needs
    more than a file, the class may have a text `example` with the options of the example that the
    help shows.

    Attributes:
        file: a stand-in for the file's name, such as "LOG.txt".
        source: where such files are from.
    """

    file: ClassVar[str]
    source: ClassVar[str]

    def read(self, path: Path | str) -> tuple[PushLog, GridObject]:
        """Reads a file's pushes, and the object that was pushed.

        Raises:
            PushLogError: the file cannot be read or is not of its form; the message names the file
                and what is wrong.
        """
        ...


OBJECT_OPTION = {
    "help": "The object that was pushed: an object file whose frame is that of the logged pose, or "
    "a shipped object's name. It has to be given.",
    "name": "--object",
}
"""The option of the object, of importers whose files say nothing of it."""


def describe_pusher_option(carrier: str) -> dict[str, str]:
    """Describes the option of the shape of a pusher that turns with what carries it."""
    return {
        "help": f"Shape of a pusher that is no round tip, whose angle is that of {carrier}: "
        f"{PUSHER_HELP}"
    }


def describe_yaw_option(carrier: str) -> dict[str, str]:
    """Describes the option of how such a pusher is mounted on what carries it."""
    return {
        "help": "With --pusher: how far its x axis is turned about the vertical from that of "
        f"{carrier}, counterclockwise from above, rad."
    }


def require_object(path: Path, obj: GridObject | None) -> GridObject:
    """The object that was pushed. Raises PushLogError where --object was not given."""
    if obj is None:
        raise PushLogError(f"{path}: --object is missing; expected the object that was pushed")
    return obj


def find_importer(name: str) -> type[Importer]:
    """Imports the importer of a name in `IMPORTER_CLASSES`."""
    module, class_name = IMPORTER_CLASSES[name].split(".")
    importer: type[Importer] = getattr(import_module(f"{__package__}.{module}"), class_name)
    return importer
