"""What can go wrong, as exceptions under one root."""


class GridPushError(Exception):
    """Root of every error this package raises on bad input.

    The message names the file (where there is one), the field and the expected form, so that it can be
    shown to a user as it is.
    """


class ObjectError(GridPushError):
    """An object, a mask, an outline or their YAML is not what it should be."""


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


class StationError(GridPushError):
    """A station cannot be built or run as asked."""


class OutputError(GridPushError):
    """A file cannot be written where it was asked for."""
