"""`learn_with_mass_tests`: one object, learned from its pushes and its weighings together.

On the table pushes show how the loads mu_i m_i g lie, whatever the frictions are, and weighings add
what makes them absolute (`weighed_model`). Over the table's edge it is not as simple: there the
loads shift about the center of mass, and pushes by themselves take that for the center of friction.
So the pushes are learned from twice: as if friction were the same everywhere, and then with the
frictions held that the weighings tell with it. The second model takes in the weighings.

All that is known goes in each time. So the result is the same whenever the object was weighed
between its pushes, and when the files of a run are learned from afterwards.
"""

from typing import Protocol

from gridpush_drake.identification.result import Identification
from gridpush_drake.identification.statistics.friction_gradient import HeldFriction
from gridpush_drake.identification.tilt_tests.weighed_model import estimate_masses, hold_friction
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.pushes.weighings import MassTestLog


class PushLearner(Protocol):
    """Learns an object from pushes, as `identify` does with all but these arguments given."""

    def __call__(
        self,
        log: PushLog,
        start: Identification | None = None,
        friction: HeldFriction | None = None,
        /,
    ) -> Identification:
        """Learns from a log; see `identify`."""


def learn_with_mass_tests(
    learn: PushLearner,
    log: PushLog,
    weighings: MassTestLog,
    *,
    start: Identification | None = None,
    seed: int = 0,
    holds_friction: bool = True,
) -> tuple[Identification, Identification]:
    """Learns an object from pushes and weighings.

    Args:
        learn: learns from pushes alone.
        log: the pushes.
        weighings: the weighings; there may be none.
        start: where learning from the pushes begins; see `identify`.
        seed: see `estimate_masses`.
        holds_friction: whether `learn` can hold frictions. Otherwise the pushes are learned from
            only once.

    Returns:
        What the pushes tell with the weighed frictions held, and the same with the weighings. Both
        are what the pushes tell alone where there are no weighings.

    Raises:
        GridPushError: as `learn` and `estimate_masses` do.
    """
    pushed = learn(log, start)
    if not len(weighings):
        return pushed, pushed
    found = estimate_masses(pushed, weighings, seed=seed)
    # Weighings that contradict each other tell no frictions to hold.
    if not holds_friction or found.weighed is None:
        return pushed, found
    pushed = learn(log, found, hold_friction(found))
    return pushed, estimate_masses(pushed, weighings, seed=seed)
