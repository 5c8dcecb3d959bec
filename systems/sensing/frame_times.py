"""`FrameTimes`: a run takes the same steps whether it is watched or not."""

from pydrake.systems.framework import Context, LeafSystem

from gridpush_drake.multibody.weak_calc import NO_SLOTS


class FrameTimes(LeafSystem):
    """Lets the simulator halt at the times at which a visualizer draws, and does nothing there.

    .. pydrake_system::

        name: FrameTimes

    Some of Drake's systems, such as the velocity filter of a simulated arm, are integrated from one
    event to the next. A visualizer's events make these steps shorter, so that a run with pictures
    and one without differ in the last bits, and by more once a contact comes earlier or later. With
    this system in its Diagram a run has these events in both cases. It has no ports.
    """

    __slots__ = NO_SLOTS

    def __init__(self, period: float) -> None:
        """Takes the visualizer's period, s."""
        super().__init__()
        self.DeclarePeriodicPublishEvent(period, 0.0, self._halt)

    def _halt(self, context: Context) -> None:
        """Does nothing: the simulator has halted."""
