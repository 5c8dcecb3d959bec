"""The arm: which posture it takes (`ArmPosture`), and which paths it can follow (`ArmReach`).

Posture: many postures bring the finger's tip to the same place. Of these, the one that is nearest
to a nominal posture is taken. With q the joint angles, J(q) the tip's Jacobian (rotation above
translation), J+ its pseudoinverse and e the pose's error, one step of

    dq = J+ e + (I - J+ J)(q_nominal - q) = J+ (e - J (q_nominal - q)) + q_nominal - q

moves the tip where it should be and, in the null space, as near to q_nominal as possible. Drake's
differential inverse kinematics with joint centering, which moves the arm by way of its driver, has
the same fixed point: a posture found here is the one that the moving arm takes. The tool points
down; its turn about the vertical (yaw) is zero at `R_WP_DOWN`. An arm of fewer than six joints,
such as a gantry, need not be able to turn its tool, only to keep it pointing down.

Path: before the arm moves, it is led along the path in steps. On the paths of 30 pushes, of which
19 can be followed, this search takes 8 ms a path. Two of Drake's methods were tried instead. Its
differential inverse kinematics takes 11 ms, and accepts postures with joints at their limits (7
paths of 10 instead of 6). Its `InverseKinematics` with SNOPT takes 510 ms, and misses a quarter of
the postures.
"""

from functools import lru_cache
from threading import RLock

import numpy as np
import shapely
from numpy.typing import ArrayLike
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame, JacobianWrtVariable, PrismaticJoint
from shapely.geometry.base import BaseGeometry

from gridpush_drake.errors import StationError
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.multibody.tool_motion import (
    R_WP_DOWN,
    TURNING_RADIUS,
    TipRule,
    calc_tool_rotation,
)
from gridpush_drake.station.robot.robot import AddRobot, Robot

POSITION_TOLERANCE = 1e-6
"""A posture is found once the tip's pose is off by less than this, m and rad."""

CENTERING_TOLERANCE = 1e-6
"""A posture is found only once the last step turns each joint by less than this, rad. Until then
the arm still moves toward the nominal posture in its null space."""

MAX_STEPS = 200
"""Greatest number of steps in the search for a posture from one that may be far off."""

FULL_TURN = 2.0 * np.pi
"""If a joint has gone further than this, the search for a posture has got lost, rad."""


class ArmPosture:
    """Kinematics of the finger's tip, and their inverse.

    It may be asked by several threads: planning may go on beside the Diagram, see
    `systems.base.worker`.

    Attributes:
        lower: (n,) lower limits of the joints, rad.
        upper: (n,) upper limits of the joints, rad.
        speed: (n,) greatest speeds of the joints, rad/s.
    """

    def __init__(self, control_plant: MultibodyPlant, robot: Robot):
        """Takes the plant that `MakeControlPlant` makes of a robot."""
        self._plant = control_plant
        self._context = control_plant.CreateDefaultContext()
        self._lock = RLock()  # guards the Context
        self._tip = control_plant.GetFrameByName(robot.finger.tip_frame)
        self._world = control_plant.world_frame()
        self.lower = control_plant.GetPositionLowerLimits()
        self.upper = control_plant.GetPositionUpperLimits()
        self.speed = control_plant.GetVelocityUpperLimits()
        joints = (control_plant.get_joint(index) for index in control_plant.GetJointIndices())
        self._slides = {
            joint.position_start()
            for joint in joints
            if joint.type_name() == PrismaticJoint.kTypeName
        }

    def describe_speed(self, k: int, speed: float) -> str:
        """Says that joint k, counted from 0, would have to move at a speed, rad/s or m/s."""
        if k in self._slides:
            return f"joint {k + 1} of the arm would have to slide at {speed:.2f} m/s"
        return f"joint {k + 1} of the arm would have to turn at {speed:.2f} rad/s"

    def calc_tip_pose(self, q: Array) -> RigidTransform:
        """Calculates X_WP of the tip's frame at the joint positions q (n,), rad."""
        with self._lock:
            self._plant.SetPositions(self._context, q)
            return self._tip.CalcPoseInWorld(self._context)

    def calc_jacobian(self, q: Array) -> Array:
        """Calculates the tip's Jacobian (6, n), expressed in the tip's own frame.

        Rotation stands above translation. The joint positions are q (n,), rad.
        """
        with self._lock:
            self.calc_tip_pose(q)
            return self._calc_jacobian(self._tip)

    def _calc_jacobian(self, frame: Frame) -> Array:
        """Calculates the tip's Jacobian (6, n) at the Context's positions, expressed in a frame."""
        return np.asarray(
            self._plant.CalcJacobianSpatialVelocity(
                self._context, JacobianWrtVariable.kV, self._tip, np.zeros(3), self._world, frame
            )
        )

    def calc_step(
        self, q: Array, p_WP: Array, q_nominal: Array, R_WP: RotationMatrix = R_WP_DOWN
    ) -> tuple[Array, float]:
        """Calculates one step toward the posture with the tip at p_WP, see the module's equation.

        Args:
            q: (n,) joint positions before the step, rad.
            p_WP: (3,) wanted position of the tip, m.
            q_nominal: (n,) posture to stay near to, rad.
            R_WP: wanted rotation of the tool, see `calc_tool_rotation`.

        Returns:
            The step dq (n,), rad, and the norm of the error e before the step, m and rad.
        """
        with self._lock:
            X_WP = self.calc_tip_pose(q)
            J = self._calc_jacobian(self._world)
        turn = (R_WP @ X_WP.rotation().inverse()).ToAngleAxis()
        e = np.concatenate([turn.angle() * turn.axis(), p_WP - X_WP.translation()])
        to_nominal = q_nominal - q
        # Least squares gives J+ times the right-hand side without forming J+.
        dq = np.linalg.lstsq(J, e - J @ to_nominal)[0] + to_nominal
        return dq, float(np.linalg.norm(e))

    def solve(self, p_WP: ArrayLike, q_nominal: Array, q_seed: Array) -> Array | None:
        """Finds the posture with the tool pointing down and its tip at p_WP.

        Joint limits are not looked at.

        Args:
            p_WP: (3,) wanted position of the tip, m.
            q_nominal: (n,) posture to stay near to, rad.
            q_seed: (n,) posture at which the search begins, rad.

        Returns:
            (n,) joint positions, rad; None if the search does not converge.
        """
        q = q_seed
        target = np.asarray(p_WP, float)
        for _ in range(MAX_STEPS):
            dq, error = self.calc_step(q, target, q_nominal)
            q = q + dq
            if error < POSITION_TOLERANCE and np.abs(dq).max() < CENTERING_TOLERANCE:
                return q
            if not np.abs(q).max() < FULL_TURN:  # also true of NaN
                return None
        return None


def CalcStartPosture(control_plant: MultibodyPlant, robot: Robot, p_WP: ArrayLike) -> Array:
    """Calculates the posture in which the tool points down with its tip at p_WP.

    Args:
        control_plant: the robot alone, as `MakeControlPlant` makes it.
        robot: the robot; the search begins at its `posture`.
        p_WP: (3,) position of the tip, m.

    Returns:
        (n,) joint positions, rad.

    Raises:
        StationError: there is no such posture within the joint limits.
    """
    posture = ArmPosture(control_plant, robot)
    seed = np.array(robot.arm.posture)
    q = posture.solve(p_WP, seed, seed)
    if q is None or (q < posture.lower).any() or (q > posture.upper).any():
        where = np.round(np.asarray(p_WP, float), 3).tolist()
        raise StationError(f"tip at {where} m: the arm does not reach it with the finger down")
    return q


POSTURE_STEP = 0.02
"""Distance along a path from one posture that is searched for to the next, m."""

STEPS_PER_POSTURE = 8
"""Greatest number of Newton steps from one posture to the next. Three or four are enough while the
arm is not stretched."""

ARRIVAL_TOLERANCE = 1e-5
"""A posture on a path is reached once the tip's pose differs by less than this, m and rad."""

MAX_REMEMBERED_LEADS = 1024
"""Number of straight pieces of paths whose postures are remembered. The same path is asked about
again at other speeds, which need no new search."""

REGION_STEP = 0.025
"""Distance between the places that are tried to find out how far an arm reaches, m."""

NEIGHBOR_STEPS = ((-1, 0), (1, 0), (0, -1), (0, 1))
"""Steps from a cell of a grid to those beside it."""


class ArmReach:
    """Leads the arm along a path in steps, and says what stops it.

    A `PushExecutor` and a `GraspExecutor` take it as `reach`. The postures are those of
    `ArmPosture`, which the moving arm takes, too.
    """

    def __init__(
        self,
        control_plant: MultibodyPlant,
        robot: Robot,
        q_nominal: ArrayLike,
        tip_bounds: TipRule | None = None,
    ):
        """Prepares the search.

        Args:
            control_plant: the robot alone, as `MakeControlPlant` makes it.
            robot: the robot; its `control` says how far paths keep from the joints' limits.
            q_nominal: (n,) nominal posture, rad. Paths begin at it, and postures stay near to it.
            tip_bounds: says in a sentence why the tip may not be at p_WP (3,), m, with the tool's
                yaw, rad, or None if it may. Seen from above, the places where it may be are
                convex. None for no bounds.
        """
        self._posture = ArmPosture(control_plant, robot)
        self._tip_bounds = tip_bounds
        control = robot.arm.control
        self._nominal = np.array(q_nominal, float)
        self._p_WN = self._posture.calc_tip_pose(self._nominal).translation()
        self._lower = self._posture.lower + control.path_limit_margin
        self._upper = self._posture.upper - control.path_limit_margin
        self._speed = control.path_speed_share * self._posture.speed
        self._lead = lru_cache(MAX_REMEMBERED_LEADS)(self._find_postures)

    def __call__(
        self, path: ArrayLike, speeds: ArrayLike, yaws: ArrayLike | None = None
    ) -> str | None:
        """Says in a sentence why the tip cannot go along a path; None if it can.

        Args:
            path: (k, 3) corners p_WP of the tip's path, m.
            speeds: (k - 1,) greatest speed on each piece, m/s. If the tool turns, the turn counts
                as length, as in `tool_motion`.
            yaws: (k,) yaw of the tool at the corners, rad; None if it does not turn.
        """
        corners = np.array(path, float)
        turns = np.zeros(len(corners)) if yaws is None else np.asarray(yaws, float)
        if self._tip_bounds is not None:
            # Between two corners the tip goes straight, and so stays in what is convex.
            for corner, turn in zip(corners, turns.tolist(), strict=True):
                beyond = self._tip_bounds(corner, turn)
                if beyond is not None:
                    return beyond
        corners = np.column_stack([corners, turns])
        q, reason = self._follow(self._nominal, np.append(self._p_WN, 0.0), corners[0], None)
        for start, end, speed in zip(
            corners[:-1], corners[1:], np.asarray(speeds, float), strict=True
        ):
            if reason is not None:
                break
            q, reason = self._follow(q, start, end, float(speed))
        return reason

    def find_region(
        self,
        bounds: ArrayLike,
        height: float,
        step: float = REGION_STEP,
        speed: float | None = None,
        yaw: float = 0.0,
    ) -> BaseGeometry:
        """Finds where the tip can be, by leading it from place to place on a square grid.

        Args:
            bounds: (4,) least x and y, greatest x and y, in W, m.
            height: z of the tip's center in W, m.
            step: distance between places, m.
            speed: speed of the tip that the arm must be able to keep everywhere, m/s; a stretched
                arm cannot. None if it does not matter.
            yaw: of the tool, rad.

        Returns:
            The union of the grid's squares whose middle is reached, within the bounds, a polygon or
            several in W, m; it may be empty.
        """
        x0, y0, x1, y1 = np.asarray(bounds, float).tolist()
        xs = np.arange(x0 + step / 2, x1, step)
        ys = np.arange(y0 + step / 2, y1, step)
        # Tip (x, y, z), m, and yaw, rad, at each place of the grid.
        places = {
            (i, j): np.array([x, y, height, yaw])
            for i, x in enumerate(xs)
            for j, y in enumerate(ys)
        }
        # The posture at each place that is reached. The first is the nearest to home that can be
        # reached from there in a straight line.
        reached: dict[tuple[int, int], Array] = {}
        home = np.append(self._p_WN, 0.0)
        for first in sorted(places, key=lambda at: float(np.linalg.norm(places[at] - home))):
            q, reason = self._follow(self._nominal, home, places[first], None)
            if reason is None:
                reached[first] = q
                break
        # From each place that is reached, the arm is led to those beside it.
        front = list(reached)
        while front:
            at = front.pop(0)
            for di, dj in NEIGHBOR_STEPS:
                near = (at[0] + di, at[1] + dj)
                if near in places and near not in reached:
                    q, reason = self._follow(reached[at], places[at], places[near], None)
                    if reason is None:
                        reached[near] = q
                        front.append(near)
        kept = set(reached)
        if speed is not None:
            # Two neighbors are both left out if the arm is too slow on the way between them.
            for at in reached:
                for di, dj in ((1, 0), (0, 1)):
                    near = (at[0] + di, at[1] + dj)
                    if near not in reached:
                        continue
                    _, reason = self._follow(reached[at], places[at], places[near], speed)
                    if reason is not None:
                        kept -= {at, near}
        squares = [
            shapely.Point(places[at][:2]).buffer(step / 2, cap_style="square") for at in kept
        ]
        return shapely.union_all(squares) & shapely.box(x0, y0, x1, y1)

    def _follow(
        self, q: Array, start: Array, end: Array, speed: float | None
    ) -> tuple[Array, str | None]:
        """Leads the arm along a straight piece of a path.

        Args:
            q: (n,) posture at the start, rad.
            start: (4,) position of the tip, m, and yaw of the tool, rad.
            end: (4,) position and yaw at the end.
            speed: greatest speed on the way, m/s; None if it does not matter.

        Returns:
            The last posture (n,), rad, and a sentence about what stops the arm there; None if it
            gets to the end.
        """
        postures, reason = self._lead(tuple(q), tuple(start), tuple(end))
        if speed is not None and len(postures) > 1:
            length, count = _measure(start, end)
            # A step takes length / count / speed, s. In it each joint uses this fraction of its
            # speed.
            fractions = np.abs(np.diff(postures, axis=0)) * speed * count / length / self._speed
            too_fast = np.flatnonzero(fractions.max(axis=1) > 1.0)
            if too_fast.size:
                i = int(too_fast[0])
                k = int(fractions[i].argmax())
                where = _describe_place(start, end, (i + 1) / count)
                what = self._posture.describe_speed(k, fractions[i, k] * self._speed[k])
                return postures[i + 1], f"{what} at {where}"
        return postures[-1], reason

    def _find_postures(
        self, q: tuple[float, ...], start: tuple[float, ...], end: tuple[float, ...]
    ) -> tuple[Array, str | None]:
        """Searches for the postures along a straight piece of a path, each from the one before.

        The arguments are those of `_follow`, as tuples, which `lru_cache` can compare.

        Returns:
            The postures (k, n), rad, from q itself to the last within the limits, and a sentence
            about what stops the arm there; None if it gets to the end.
        """
        first = np.array(start)
        last = np.array(end)
        _, count = _measure(first, last)
        postures = [np.array(q)]
        for i in range(1, count + 1):
            fraction = i / count
            target = first + (last - first) * fraction
            p_WP = target[:3]
            R_WP = calc_tool_rotation(float(target[3]))
            posture = postures[-1]
            for _ in range(STEPS_PER_POSTURE):
                dq, error = self._posture.calc_step(posture, p_WP, self._nominal, R_WP)
                posture = posture + dq
                if error < ARRIVAL_TOLERANCE:
                    break
            if not error < ARRIVAL_TOLERANCE:
                where = _describe_place(first, last, fraction)
                return np.array(postures), f"the arm does not reach {where}"
            stopped = np.flatnonzero((posture < self._lower) | (posture > self._upper))
            if stopped.size:
                where = _describe_place(first, last, fraction)
                reason = f"joint {stopped[0] + 1} of the arm would come to its limit at {where}"
                return np.array(postures), reason
            postures.append(posture)
        return np.array(postures), None


def _measure(start: Array, end: Array) -> tuple[float, int]:
    """Measures a straight piece of a path: its length, m, and the number of steps along it.

    A turn of the tool counts as the way of a point at a distance of `TURNING_RADIUS`.
    """
    length = float(
        np.hypot(np.linalg.norm(end[:3] - start[:3]), TURNING_RADIUS * (end[3] - start[3]))
    )
    return length, int(np.ceil(length / POSTURE_STEP))


def _describe_place(start: Array, end: Array, fraction: float) -> str:
    """Describes the place after a fraction of the way from start to end."""
    return "({:.2f}, {:.2f}, {:.2f}) m".format(*(start + (end - start) * fraction)[:3])


def MakeControlPlant(robot: Robot, X_WB: RigidTransform | None = None) -> MultibodyPlant:
    """Makes the plant that controllers calculate with: the robot alone, with a rigid gripper.

    Args:
        robot: the robot.
        X_WB: pose of its base B in the world; identity by default.
    """
    plant = MultibodyPlant(time_step=0.0)
    AddRobot(plant, robot, X_WB)
    plant.Finalize()
    plant.set_name("control_plant")
    return plant
