"""Whether the arm can follow the tip along a way, asked before it goes."""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.multibody.plant import MultibodyPlant

from gridpush_drake.station.arm_posture import ArmPosture
from gridpush_drake.systems.tool_motion import TURNING_RADIUS, calc_tool_rotation

Array = NDArray[np.float64]

STEP = 0.02
"""m along the way, between the postures looked at."""

STEPS_PER_POSTURE = 8
"""Newton's, at most, from one posture to the next; three or four are enough where the arm is not stretched."""

ARRIVED = 1e-5
"""m and rad, of a posture that is reached."""


class ArmReach:
    """Leads the arm along a way in steps and says what stops it.

    It is what a `PushExecutor` and a `GraspExecutor` take as `reach`. The postures are those of `arm_posture`, to which
    the moving arm is drawn.
    """

    def __init__(
        self,
        control_plant: MultibodyPlant,
        q_nominal: ArrayLike,
        position_margin: float = 0.05,
        speed_share: float = 0.9,
    ):
        """Makes the question.

        Args:
            control_plant: as `MakeControlPlant` makes it.
            q_nominal: (7,) the posture that the arm is drawn to, rad.
            position_margin: to keep from the joint limits, rad.
            speed_share: of the joints' greatest speeds that may be used.
        """
        self._posture = ArmPosture(control_plant)
        self._nominal = np.array(q_nominal, float)
        self._p_WN = self._posture.calc_tip_pose(self._nominal).translation()
        self._lower, self._upper = self._posture.lower + position_margin, self._posture.upper - position_margin
        self._speed = speed_share * self._posture.speed

    def __call__(self, way: ArrayLike, speeds: ArrayLike, yaws: ArrayLike | None = None) -> str | None:
        """None where the tip can go along `way`, else a sentence that says why not.

        Args:
            way: (k, 3) corners p_WP of the tip's way, m.
            speeds: (k - 1,) greatest on its pieces, m/s; of the way that `tool_motion` measures where the tool turns.
            yaws: (k,) of the tool at the corners, rad; None where it does not turn.
        """
        corners = np.array(way, float)
        turns = np.zeros(len(corners)) if yaws is None else np.asarray(yaws, float)
        corners = np.column_stack([corners, turns])
        q, reason = self._follow(self._nominal, np.append(self._p_WN, 0.0), corners[0], None)
        for start, end, speed in zip(corners[:-1], corners[1:], np.asarray(speeds, float), strict=True):
            if reason is not None:
                break
            q, reason = self._follow(q, start, end, float(speed))
        return reason

    def _follow(self, q: Array, start: Array, end: Array, speed: float | None) -> tuple[Array, str | None]:
        """Leads the arm from posture q, tip and yaw at `start` (4,), to `end`; returns its last posture and stop."""
        turn = float(end[3] - start[3])
        length = float(np.hypot(np.linalg.norm(end[:3] - start[:3]), TURNING_RADIUS * turn))
        count = int(np.ceil(length / STEP))
        for i in range(1, count + 1):
            p_WP = start[:3] + (end[:3] - start[:3]) * (i / count)
            R_WP = calc_tool_rotation(float(start[3]) + turn * (i / count))
            before, where = q, "({:.2f}, {:.2f}, {:.2f}) m".format(*p_WP)
            for _ in range(STEPS_PER_POSTURE):
                dq, error = self._posture.calc_step(q, p_WP, self._nominal, R_WP)
                q = q + dq
                if error < ARRIVED:
                    break
            if not error < ARRIVED:
                return q, f"the arm does not reach {where}"
            stopped = np.flatnonzero((q < self._lower) | (q > self._upper))
            if stopped.size:
                return q, f"joint {stopped[0] + 1} of the arm would come to its limit at {where}"
            if speed is not None:
                share = np.abs(q - before) * speed * count / length / self._speed
                if share.max() > 1.0:
                    k = int(share.argmax())
                    needed = share[k] * self._speed[k]
                    return q, f"joint {k + 1} of the arm would have to turn at {needed:.2f} rad/s at {where}"
        return q, None
