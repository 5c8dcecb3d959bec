"""Pushes to learn from, cut out of what was seen while a finger was steered.

The finger's path is curved, and touches the object now and then. A log takes it as it is: a push is
any path of a disc (`Push.along`), and how contact begins, slides and breaks is the model's affair.
A long ride is cut into pieces, each of which begins at a pose that was seen, so that errors of the
model do not add up from one to the next. Pieces in which the object hardly moves tell nothing, and
are left out.
"""

from dataclasses import dataclass

import numpy as np

from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.pusher import PusherShape
from gridpush_drake.errors import PlanningError, require_positive
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.contact.trial import calc_goal_error
from gridpush_drake.pushes.push_log import ObservedPush

PIECE_DURATION = 1.5
"""Duration of a piece, s."""

LEAST_MOTION = 0.005
"""Mean distance that the cells must move in a piece, m."""

LEAST_WAY = 0.005
"""Way of the finger in a piece, m."""

OBSERVED_POSE_COUNT = 8
"""Poses of a piece that are kept after the first one: neighbors tell nearly the same."""


@dataclass(frozen=True, eq=False)
class SeenPose:
    """A pose that has come.

    Attributes:
        time: when it was seen, s.
        pose: (3,) X_WB, with noise, m and rad.
    """

    time: float
    pose: Array


class FollowLog:
    """Collects where the finger was and where the object was seen.

    Attributes:
        obj: the object.
        radius: of the finger, m.
        piece: duration of a piece, s.
        shape: of a finger that is no disc; None of a disc.
    """

    def __init__(
        self,
        obj: GridObject,
        radius: float,
        piece: float = PIECE_DURATION,
        shape: PusherShape | None = None,
    ) -> None:
        """Begins with nothing.

        Args:
            obj: the object.
            radius: of the finger, or of the shape's round corners, m.
            piece: duration of a piece, s.
            shape: of a finger that is no disc.

        Raises:
            PlanningError: a number is not positive.
        """
        require_positive(PlanningError, "log: ", "m", radius=radius)
        require_positive(PlanningError, "log: ", "s", piece=piece)
        self.obj = obj
        self.radius = radius
        self.piece = piece
        self.shape = shape
        self._times: list[float] = []
        self._tips: list[Array] = []
        self._seen: list[SeenPose] = []

    def add_tip(self, time: float, tip: Array) -> None:
        """Takes in where the finger's center is, (2,) m, at a time, s; times increase.

        Of a shape it is (3,), with its angle, rad.
        """
        if not self._times or time > self._times[-1]:
            self._times.append(float(time))
            self._tips.append(np.array(tip, dtype=np.float64))

    def add_pose(self, seen: SeenPose) -> None:
        """Takes in a pose that has come; poses come in order."""
        if not self._seen or seen.time > self._seen[-1].time:
            self._seen.append(seen)

    def cut(self) -> list[ObservedPush]:
        """Cuts what was seen so far into pushes that moved the object."""
        found: list[ObservedPush] = []
        begin = 0
        while begin < len(self._seen) - 1:
            # as many poses as there are within the duration of a piece
            until = self._seen[begin].time + self.piece
            end = begin + 1
            while end < len(self._seen) - 1 and self._seen[end + 1].time <= until:
                end += 1
            made = self._make_push(self._seen[begin : end + 1], f"piece_{len(found) + 1}")
            if made is not None:
                found.append(made)
            begin = end
        return found

    def _make_push(self, seen: list[SeenPose], name: str) -> ObservedPush | None:
        """Makes a push of the poses seen in a piece; None where it tells nothing."""
        poses = np.array([each.pose for each in seen])
        poses[:, 2] = np.unwrap(poses[:, 2])
        if not calc_goal_error(self.obj, poses[1:], poses[0]).max() > LEAST_MOTION:
            return None
        # the finger's path between the first pose and the last
        begin = seen[0].time
        end = seen[-1].time
        times = np.array(self._times)
        tips = np.array(self._tips)
        inside = (times > begin) & (times < end)
        t = np.concatenate([[begin], times[inside], [end]])
        places = np.column_stack([np.interp(t, times, column) for column in tips.T])
        xy = places[:, :2]
        if not np.linalg.norm(np.diff(xy, axis=0), axis=1).sum() > LEAST_WAY:
            return None
        if self.shape is None:
            push = Push.along(t, xy, self.radius)
        else:
            push = Push.along(t, xy, shape=self.shape, yaw=places[:, 2])
        rows = np.unique(np.linspace(1, len(seen) - 1, OBSERVED_POSE_COUNT).round().astype(int))
        return ObservedPush(
            name=name,
            push=push,
            pose=poses[0],
            t_observed=np.array([seen[i].time - begin for i in rows]),
            poses_observed=poses[rows],
        )
