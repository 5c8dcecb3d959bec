"""What the station learns from the pushes it sees: its identifier, by a scenario."""

from collections.abc import Callable
from dataclasses import dataclass

from gridpush_drake.grid.object import GridObject
from gridpush_drake.pushes.log import ObservedPush
from gridpush_drake.scene.scenario import PushScenario
from gridpush_drake.systems.grid_identifier import GridIdentifier
from gridpush_drake.systems.push_record import RecordOptions

ESTIMATE_OUTPUTS = (
    "mass",
    "friction",
    "mass_std",
    "friction_std",
    "contact_friction",
    "centre_of_mass",
    "centre_of_mass_covariance",
    "loss",
    "num_pushes",
    "identification",
    "push_log",
    "message",
)
"""Of the identifier, exported as `estimate.mass` and so on."""


@dataclass(frozen=True)
class Learning:
    """What the station's identifier learns from.

    Attributes:
        most_pushes: the first so many; None for no limit.
        memory: of those, the latest so many; None for no limit.
        admit: whether a push may be learned from; None admits all.
    """

    most_pushes: int | None = None
    memory: int | None = None
    admit: Callable[[ObservedPush], bool] | None = None


def make_identifier(scenario: PushScenario, obj: GridObject, learning: Learning | None) -> GridIdentifier:
    """The station's identifier; it learns from the first `scenario.pokes.count` pushes by default."""
    learning = learning or Learning(scenario.pokes.count)
    return GridIdentifier(
        obj,
        period=1 / scenario.camera.rate,
        engaged_below=scenario.object_height,
        pusher_radius=scenario.finger.tip_radius,
        max_learning_pushes=learning.most_pushes,
        memory=learning.memory,
        admit=learning.admit,
        seed=scenario.seed,
        warm_start=False,  # it gains little, and so `gridpush identify` finds the same from the log, bit for bit
        record=RecordOptions(pose_delay=1 / scenario.camera.rate),  # it sees the picture before the one being taken
    )
