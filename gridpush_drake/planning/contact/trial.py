"""One simulated push of a contact search: how near it comes to the goal, and where a better one is.

A straight push at one place and in one direction passes through all its shorter selves, so that a
single simulation tells the best distance too: the cost at (arc length s, direction phi) is that of
the best allowed pose of the motion,

    f(s, phi) = min_d C(q(s, phi, d)),   C(q) = 1/n sum_i |p_i(q) - p_i(goal)|.

With the exact Jacobian dq/d(s, phi, d), from the same simulation, C's gradient is  1/n sum_i
r_i^T/|r_i| dp_i/dq dq/dx, and  H = 1/n sum_i (dp_i/dx)^T (dp_i/dx) / |r_i|  is the Gauss-Newton
matrix of the sum of norms (each norm replaced by the parabola that touches it from above). A
simulation with its Jacobian counts as one simulation.

A push that was chosen, and what the model expects of it.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from gridpush_drake.dynamics.motion import MotionStatus
from gridpush_drake.dynamics.physics import DEFAULT_PHYSICS, Physics
from gridpush_drake.dynamics.push import Push, make_path_times
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import PlanningError, require_positive
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.notebook import MM
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.contact.reachable_outline import ReachableOutline
from gridpush_drake.planning.push_constraints import PushChecker


@dataclass(frozen=True, eq=False)
class PlannedPush:
    """One push of a plan, by its parameters, as a motion, and with its predicted outcome.

    Attributes:
        arc_length: where on the exterior outline the disc touches, m (see `Push.on_outline`).
        angle: of the motion from the inward normal there, rad, counterclockwise.
        distance: of the motion, the clearance included, m.
        push: the disc's motion, world frame.
        pose: (3,) predicted pose q_W of the object at the push's end, m and rad.
        cost: mean distance of the cells' centers at `pose` from where they are at the goal pose, m.
        simulations: simulated pushes that the choice took.
    """

    arc_length: float
    angle: float
    distance: float
    push: Push
    pose: Array
    cost: float
    simulations: int

    def __repr__(self) -> str:
        """How far it pushes and what is left to the goal, in a line."""
        return f"PlannedPush of {self.distance * MM:.0f} mm: {self.cost * MM:.1f} mm from the goal afterwards"


def calc_goal_error(obj: GridObject, pose: ArrayLike, goal: ArrayLike) -> Array:
    """Mean distance of the cells' centers between poses (..., 3) and one goal pose (3,), (...,) m (the paper's ADD)."""
    difference = obj.cells_at(pose) - obj.cells_at(goal)
    return np.asarray(np.hypot(difference[..., 0], difference[..., 1]).mean(axis=-1))


DEFAULT_RADIUS = 0.008  # of a finger of which nothing else is said, m: `models/fingers/rod`'s


@dataclass(frozen=True)
class ContactOptions:
    """What pushes may be chosen from, and how they are searched for.

    Attributes:
        radius: of the finger, a disc, m.
        clearance: gap between finger and object at the beginning, m.
        speed: of the finger, m/s.
        distance_range: least and greatest distance, m.
        physics: of the simulations, such as that of a learned model; the regime "auto" becomes the
            one that suits `speed`.
        angle_range: least and greatest angle of the motion from the inward normal, rad.
        starts: of the gradient and the finite-difference search.
        budget: most simulations of the gradient and the finite-difference search.
        min_improvement: of the cost that is worth a simulation, m.
        places: of the exhaustive search's grid, along the outline.
        angles: of the exhaustive search's grid, at each place.
        refined: best nodes of that grid that are walked on from.
        seed: of the finite-difference search's first place.

    Raises:
        PlanningError: a value is out of range.
    """

    radius: float = DEFAULT_RADIUS
    clearance: float = 0.002
    speed: float = 0.03
    distance_range: tuple[float, float] = (0.005, 0.3)
    physics: Physics = DEFAULT_PHYSICS
    angle_range: tuple[float, float] = (-0.8, 0.8)
    starts: int = 12
    budget: int = 44
    min_improvement: float = 2e-4
    places: int = 60
    angles: int = 7
    refined: int = 16
    seed: int = 0

    def __post_init__(self) -> None:
        low, high = self.distance_range
        if not 0 < low <= high < np.inf:
            raise PlanningError(
                f"distance_range is {self.distance_range!r}; expected 0 < least <= greatest (m)"
            )
        low, high = self.angle_range
        if not -np.pi / 2 < low <= high < np.pi / 2:
            raise PlanningError(
                f"angle_range is {(low, high)!r}; expected -pi/2 < least <= greatest < pi/2 (rad)"
            )
        require_positive(PlanningError, unit="m", radius=self.radius)
        require_positive(PlanningError, unit="m/s", speed=self.speed)
        for name in ("starts", "budget", "places", "angles"):
            if getattr(self, name) < 1:
                raise PlanningError(f"{name} is {getattr(self, name)!r}; expected at least 1")

    def resolve_physics(self, obj: GridObject, params: CellParameters) -> Physics:
        """The physics of pushes at `speed`, by a model of the object; never with the regime "auto"."""
        return self.physics.resolve_for(obj, params, self.speed)


RECORD_EVERY = 4  # steps between those whose Jacobian is kept
MIN_RESIDUAL = 1e-4  # m, below which a cell's error weighs no more in the Gauss-Newton matrix


@dataclass(frozen=True, eq=False)
class Trial:
    """A simulated push, at its best distance."""

    arc_length: float  # m
    piece: int  # of the reachable outline
    angle: float  # from the inward normal, rad
    distance: float  # m
    pose: Array  # (3,) q_W at its end
    cost: float  # mean cell error to the goal, m; infinite where the push is not allowed
    slope: Array | None = (
        None  # (3,) of the cost by arc length, direction and distance; None where not asked for
    )
    curvature: Array | None = None  # (3, 3) Gauss-Newton matrix of the same


@dataclass(eq=False)
class TrialRunner:
    """Simulates pushes from one pose towards one goal, and counts them."""

    obj: GridObject
    params: CellParameters
    pose: Array  # (3,) where it lies
    goal: Array  # (3,) where it should
    reach: ReachableOutline  # where the disc can touch
    checker: PushChecker
    options: ContactOptions  # what pushes may be chosen from
    distance_range: tuple[float, float]  # least and greatest distance that are tried, m
    simulations: int = 0  # run so far

    def make_push(self, arc_length: float, angle: float, distance: float) -> Push:
        """The push with these parameters."""
        return Push.on_outline(
            self.obj, arc_length, angle, distance, radius=self.options.radius, speed=self.options.speed,
            pose=self.pose, clearance=self.options.clearance,
        )  # fmt: skip

    def run(self, arc_length: float, piece: int, angle: float, gradient: bool = False) -> Trial:
        """Simulates the longest push at a place and angle, and takes its best allowed part."""
        push = self.make_push(arc_length, angle, self.distance_range[1])
        failed = Trial(arc_length, piece, angle, self.distance_range[1], self.pose, np.inf)
        if not self.checker.allows_finger(push.start[None])[0]:
            return failed
        physics = self.options.resolve_physics(self.obj, self.params)
        times = make_path_times(push, physics.regime)
        record = np.unique(np.append(np.arange(0, len(times), RECORD_EVERY), len(times) - 1))
        motion = simulate(
            self.obj,
            self.params,
            push,
            self.pose,
            physics=physics,
            times=times,
            gradients=gradient,
            record=record if gradient else None,
        )
        self.simulations += 1
        if motion.status in (MotionStatus.STARTED_OVERLAPPING, MotionStatus.NOT_CONVERGED):
            return failed
        traveled = self.options.speed * times
        usable = self.checker.count_allowed(motion.tip, motion.poses)
        first = int(np.searchsorted(traveled, self.distance_range[0] - 1e-9))
        if usable <= first:
            return failed
        best, cost = self._find_nearest(motion.poses, first, usable)
        trial = Trial(
            arc_length, piece, angle, float(traveled[best]), motion.poses[best].copy(), cost
        )
        if not gradient:
            return trial
        row = int(np.argmin(np.abs(record - best)))
        J, k = motion.jacobian, int(record[row])
        assert J.contact_location is not None
        onward = motion.poses[min(k + 1, len(times) - 1)] - motion.poses[max(k - 1, 0)]
        onward = onward / (traveled[min(k + 1, len(times) - 1)] - traveled[max(k - 1, 0)])
        dq = np.column_stack([J.contact_location[row], J.direction[row], onward])
        slope, curvature = calc_cost_derivatives(self.obj, trial.pose, self.goal, dq)
        # A distance that cannot change, for the range or a rule ends here, is no unknown.
        if best in (first, usable - 1):
            slope, curvature = _exclude(slope, curvature, 2)
        return Trial(
            arc_length, piece, angle, trial.distance, trial.pose, trial.cost, slope, curvature
        )

    def _find_nearest(self, poses: Array, first: int, end: int) -> tuple[int, float]:
        """Index of the pose in [first, end) nearest to the goal, looked for coarsely first, and its cost, m."""
        rows = np.unique(np.append(np.arange(first, end, RECORD_EVERY), end - 1))
        coarse = int(rows[np.argmin(calc_goal_error(self.obj, poses[rows], self.goal))])
        begin, stop = max(first, coarse - RECORD_EVERY + 1), min(end, coarse + RECORD_EVERY)
        costs = calc_goal_error(self.obj, poses[begin:stop], self.goal)
        return begin + int(np.argmin(costs)), float(costs.min())

    def finish(self, trial: Trial, simulations: int) -> PlannedPush:
        """The trial as a planned push."""
        push = self.make_push(trial.arc_length, trial.angle, trial.distance)
        return PlannedPush(
            trial.arc_length, trial.angle, trial.distance, push, trial.pose, trial.cost, simulations
        )


def calc_cost_derivatives(
    obj: GridObject, pose: Array, goal: Array, dq: Array
) -> tuple[Array, Array]:
    """Gradient (k,) and Gauss-Newton matrix (k, k) of the mean cell error, by dq (3, k), the pose's by k parameters."""
    residual = obj.cells_at(pose) - obj.cells_at(goal)
    length = np.maximum(np.linalg.norm(residual, axis=1), MIN_RESIDUAL)
    arm = obj.cells_at(pose) - pose[:2]
    dp = np.zeros((obj.n, 2, 3))
    dp[:, 0, 0] = dp[:, 1, 1] = 1.0
    dp[:, 0, 2], dp[:, 1, 2] = -arm[:, 1], arm[:, 0]
    dx = dp @ dq
    slope = np.einsum("ij,ijk->k", residual / length[:, None], dx) / obj.n
    return slope, np.einsum("ijk,ijl,i->kl", dx, dx, 1.0 / length) / obj.n


def _exclude(slope: Array, curvature: Array, index: int) -> tuple[Array, Array]:
    slope, curvature = slope.copy(), curvature.copy()
    slope[index] = 0.0
    curvature[index, :] = curvature[:, index] = 0.0
    curvature[index, index] = 1.0
    return slope, curvature
