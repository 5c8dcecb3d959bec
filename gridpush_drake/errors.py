"""What can go wrong, as exceptions under one root."""

from typing import Any


class GridPushError(Exception):
    """Root of every error this package raises on bad input.

    The message names the file (where there is one), the field and the expected form, so that it can
    be shown to a user as it is.
    """


class MissingExtraError(GridPushError):
    """A package is not installed that only some uses need; the message names its extra."""


class NumbaError(GridPushError):
    """The installed version of Numba is built differently from those that the kernels know."""


class ObjectError(GridPushError):
    """An object, a mask, an outline or their YAML is not what it should be."""


class ObjectWarning(UserWarning):
    """A mask or an outline may be right, but hardly is.

    The mask is inverted, say, or it is of a photograph that its depth image contradicts.
    """


class ParameterError(GridPushError):
    """Cell masses, frictions or priors are out of range or of the wrong shape."""


class PushError(GridPushError):
    """A push's geometry or timing is not usable."""


class PushLogError(GridPushError):
    """A push log, or a public data set to be imported, cannot be read."""


class PushLogWarning(UserWarning):
    """A push log may be true, but hardly is: units, frames or poses are doubtful."""


class SimulationError(GridPushError):
    """A simulation was asked for something it cannot do."""


class IdentificationError(GridPushError):
    """Identification was asked for something it cannot do."""


class PlanningError(GridPushError):
    """A plan was asked for with arguments that make no sense."""


class ScenarioError(GridPushError):
    """A scenario, or a field of it, is not what it should be."""


class PushRefusedError(PlanningError):
    """A world's robot does not carry a push out; the message says why."""


class StationError(GridPushError):
    """A station cannot be built or run as asked."""


class PerceptionError(GridPushError):
    """What a camera saw, or a file of what it saw, is not usable.

    Attributes:
        picture: (height, width, 3) uint8 RGB, what was seen, marked; None where there is no picture
            to show.
    """

    def __init__(self, message: str, picture: Any = None) -> None:
        super().__init__(message)
        self.picture = picture


class CameraError(PerceptionError):
    """A camera, or the file that describes it, is not what it should be."""


class ImageError(PerceptionError):
    """An image, a depth image or a video cannot be read, or has not the camera's size or unit."""


class NoTableError(PerceptionError):
    """No table is in view."""


class NoObjectError(PerceptionError):
    """No object is in view."""


class MultipleObjectsError(PerceptionError):
    """More than one object is in view."""


class ObjectAtBorderError(PerceptionError):
    """The object is cut by the picture's border."""


class TagError(PerceptionError):
    """A tag is not in view, or a board of tags is not what it should be."""


class SheetError(PerceptionError):
    """A sheet of paper that tells the scale is not in view, or several are."""


class OutputError(GridPushError):
    """A file cannot be written where it was asked for."""


MAX_NUMBER = 1e12
"""Magnitude beyond which a number is none that was measured, in SI units. Larger ones overflow in
calculations."""


def require_positive(
    kind: type[GridPushError], where: str = "", unit: str = "", **values: float
) -> None:
    """Refuses values that are not positive numbers, at most `MAX_NUMBER`.

    Args:
        kind: the error to raise.
        where: head of the message, such as a file's name.
        unit: the values' unit, for the message.
        values: the values by name; the first one that is refused is named.

    Raises:
        GridPushError: of the given kind.
    """
    for name, value in values.items():
        if not 0 < value <= MAX_NUMBER:
            form = f"a positive number, at most {MAX_NUMBER:g}{unit and f' ({unit})'}"
            raise kind(f"{where}{name} is {value!r}; expected {form}")
