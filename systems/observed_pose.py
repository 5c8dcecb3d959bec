"""`ObservedPose`: where an object is, by what a tracker says of it now and then."""

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, DiscreteValues, LeafSystem

from gridpush_drake.geometry.se2 import Array, wrap_angle
from gridpush_drake.multibody.weak_calc import NO_SLOTS
from gridpush_drake.systems.robot_records import PoseObservation

KEPT = 32
"""Number of last poses that are remembered."""

UNKNOWN_ROW = (-np.inf, np.nan, np.nan, np.nan)
"""Time and pose of an observation that did not come yet."""

LARGEST_POSE = 1e6
"""A pose with a number beyond this, m or rad, was not measured, and counts as not seen."""

UNOBSERVED = PoseObservation(0.0, (np.nan, np.nan, np.nan))
"""Stands for an observation before the first one."""


class ObservedPose(LeafSystem):
    """Holds an object's pose between observations; with no recent one it counts as not seen.

    .. pydrake_system::

        name: ObservedPose
        input_ports:
        - observation
        - time
        output_ports:
        - object_pose
        - newest_pose

    * observation: abstract `PoseObservation`. Its time grows from one to the next, and is 0 before
      the first. If it is smaller than before, the sender's clock was set back, and the poses before
      that are forgotten. A pose that is not finite says that the object is not seen. It need not be
      connected: then nothing was observed yet.
    * time: vector of 1, time by the clock of the observations, s. It need not be connected.
    * object_pose: vector of 3, x and y of B in W, m, and yaw, rad, which counts whole turns. It is
      the pose of `delay` ago, interpolated between the observations before and after. If none came
      since, or the time is not known, it is the newest pose. NaN if the object was not seen then,
      or nothing was observed for `max_age`.
    * newest_pose: vector of 3, the pose of the last observation, whatever the delay, m and rad. A
      guard reads it, which must notice a jump at once.
    """

    __slots__ = NO_SLOTS

    def __init__(self, period: float, max_age: float, delay: float = 0.0) -> None:
        """Declares ports and state.

        Args:
            period: time between two updates, s.
            max_age: if the last observation is older than this, the object is not seen, s.
            delay: age of the pose on `object_pose`, s.
        """
        super().__init__()
        self._max_age = max_age
        self._delay = delay
        self._observation = self.DeclareAbstractInputPort(
            "observation", AbstractValue.Make(UNOBSERVED)
        )
        self._time = self.DeclareVectorInputPort("time", 1)
        self._pose = self.DeclareDiscreteState(np.full(3, np.nan))
        # The last poses, row by row: time, s, x, y and yaw.
        self._kept = self.DeclareDiscreteState(np.tile(UNKNOWN_ROW, KEPT))
        self._newest = self.DeclareDiscreteState(np.full(3, np.nan))
        # The last yaw that was seen, with its whole turns, rad.
        self._yaw = self.DeclareDiscreteState(1)
        # The last observation: its time, and when it came, s.
        self._last = self.DeclareDiscreteState(2)
        self.DeclareStateOutputPort("object_pose", self._pose)
        self.DeclareStateOutputPort("newest_pose", self._newest)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._look)

    def _look(self, context: Context, state: DiscreteValues) -> None:
        """Takes in a new observation, and sets the poses on the ports."""
        has_value = self._observation.HasValue(context)
        new = self._observation.Eval(context) if has_value else UNOBSERVED
        time = context.get_time()
        last, came = context.get_discrete_state(self._last).value()
        kept = context.get_discrete_state(self._kept).value().reshape(KEPT, 4)
        if new.time != last:
            came = time
            state.set_value(self._last, [new.time, time])
            if new.time < last:
                kept = np.tile(UNKNOWN_ROW, (KEPT, 1))
            pose = self._read_pose(context, state, new)
            kept = np.vstack([kept[1:], [new.time, *pose]])
            state.set_value(self._kept, kept.ravel())
        if time - came > self._max_age:
            state.set_value(self._pose, np.full(3, np.nan))
            state.set_value(self._newest, np.full(3, np.nan))
            return
        wanted = np.inf
        if self._time.HasValue(context):
            wanted = float(self._time.Eval(context)[0]) - self._delay
        state.set_value(self._pose, find_pose(kept, wanted))
        state.set_value(self._newest, kept[-1, 1:])

    def _read_pose(self, context: Context, state: DiscreteValues, new: PoseObservation) -> Array:
        """Returns the pose (3,) of an observation, with whole turns of the yaw; NaN if not seen."""
        seen = np.asarray(new.pose, dtype=np.float64).ravel()
        if not (np.abs(seen) <= LARGEST_POSE).all():  # also true of NaN
            return np.full(3, np.nan)
        yaw = float(context.get_discrete_state(self._yaw).value()[0])
        pose = np.array([*seen[:2], yaw + wrap_angle(seen[2] - yaw)])
        state.set_value(self._yaw, pose[2:])
        return pose


def find_pose(kept: Array, time: float) -> Array:
    """Finds the pose at a time by interpolation.

    Args:
        kept: (n, 4) rows of time, s, and pose, m and rad; the times increase.
        time: time of the wanted pose, s.

    Returns:
        (3,) the pose; the first or the last one if the time is before or after all of them. NaN
        if a pose between which it lies is NaN.
    """
    after = int(np.searchsorted(kept[:, 0], time))
    if after == 0:
        return kept[0, 1:]
    if after == len(kept):
        return kept[-1, 1:]
    t0 = kept[after - 1, 0]
    t1 = kept[after, 0]
    fraction = (time - t0) / (t1 - t0) if np.isfinite(t0) else 1.0
    if fraction == 1.0:  # here the pose before does not matter, which may be NaN
        return kept[after, 1:]
    interpolated: Array = (1 - fraction) * kept[after - 1, 1:] + fraction * kept[after, 1:]
    return interpolated
