"""One simulated push of a contact search: how near it comes to the goal, and where a better one is.

The cost of a pose q is the mean distance of the n cells' centers from where they are at the goal,

    C(q) = 1/n sum_i |r_i|,   r_i = p_i(q) - p_i(goal)

A straight push at arc length s, in direction phi, on its way of length d passes through the end of
every shorter one. So a single simulation tells the best distance, too: the cost of (s, phi) is that
of the best allowed pose of the motion,

    f(s, phi) = min_d C(q(s, phi, d))

With the exact Jacobian dq/dx by x = (s, phi, d), from the same push up to the best distance, the
gradient of C and the Gauss-Newton matrix H are

    dC/dx = 1/n sum_i r_i^T / |r_i| dp_i/dx
    H     = 1/n sum_i (dp_i/dx)^T (dp_i/dx) / |r_i|,     dp_i/dx = dp_i/dq dq/dx

In H each norm is replaced by the parabola that touches it from above. A simulation, with or without
its Jacobian, counts as one. The theory is in `docs/theory/planning.md`, section 1.

`Trial` is a push under trial, `TrialRunner` simulates it, `PlannedPush` is a push that was chosen.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from gridpush_drake.dynamics.kernel_call import get_cells
from gridpush_drake.dynamics.motion import Motion, MotionStatus
from gridpush_drake.dynamics.physics import Physics
from gridpush_drake.dynamics.push import Push, make_path_times
from gridpush_drake.dynamics.pusher import DEFAULT_PUSHER, Pusher
from gridpush_drake.dynamics.scene.simulation import simulate_one
from gridpush_drake.dynamics.simulation import PushSteps, check_friction, simulate_steps
from gridpush_drake.errors import PlanningError
from gridpush_drake.geometry.se2 import Array, transform, wrap_angle
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.planning.contact.contact_kernels import (
    fill_cost_derivatives,
    fill_goal_errors,
)
from gridpush_drake.planning.contact.reachable_outline import ReachableOutline
from gridpush_drake.planning.push_constraints import PushChecker
from gridpush_drake.units import MM_PER_M


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
        return (
            f"PlannedPush of {self.distance * MM_PER_M:.0f} mm: {self.cost * MM_PER_M:.1f} mm "
            "from the goal "
            "afterwards"
        )


def calc_goal_error(obj: GridObject, pose: ArrayLike, goal: ArrayLike) -> Array:
    """Calculates C, the mean distance of the cells' centers from the goal's (the paper's ADD).

    Args:
        obj: the object.
        pose: (..., 3) poses, X_WB, m and rad.
        goal: (3,) the goal pose.

    Returns:
        (...,) m.
    """
    q = np.asarray(pose, dtype=np.float64)
    errors = np.empty(q.shape[:-1])
    fill_goal_errors(
        cells=get_cells(obj),
        poses=np.array(q.reshape(-1, 3)),
        goal=np.array(goal, dtype=np.float64),
        errors=errors.reshape(-1),
    )
    return errors


def calc_goal_offset(obj: GridObject, pose: Array, goal: Array) -> tuple[float, float]:
    """Distance of the cells' centroids, m, and the turn, rad, between two poses (3,)."""
    middle = obj.p_BC.mean(axis=0)[None]
    distance = np.linalg.norm(transform(pose, middle) - transform(goal, middle))
    return float(distance), abs(float(wrap_angle(pose[2] - goal[2])))


RECORD_EVERY = 4
"""Number of steps of a motion from one whose Jacobian is taken to the next."""

MIN_RESIDUAL = 1e-4
"""A cell that is nearer than this to where it should be weighs no more in H than at this distance,
m."""

ZERO_TWIST = np.zeros(3)
"""Velocity of an object before it is pushed, m/s and rad/s."""

DISTANCE_TOUCH = 1e-9
"""By how much a push may be shorter than the least distance, m, for round-off."""


@dataclass(frozen=True)
class ContactOptions:
    """What pushes may be chosen from, and how they are searched for.

    Attributes:
        pusher: what pushes.
        distance_range: least and greatest distance, m.
        physics: takes the place of the model's, whose regime otherwise becomes the one that suits
            the pusher's speed; None for the model's.
        angle_range: least and greatest angle of the motion from the inward normal, rad.
        starts: number of starts of the gradient and the finite-difference search.
        budget: greatest number of simulations of the gradient and the finite-difference search.
        min_improvement: least improvement of the cost that is worth a simulation, m.
        places: number of places of the exhaustive search's grid, along the outline.
        angles: number of angles of the exhaustive search's grid, at each place.
        refined: number of nodes of that grid, the best ones, from which is searched further.
        seed: of the finite-difference search's first place.

    Raises:
        PlanningError: a value is out of range.
    """

    pusher: Pusher = DEFAULT_PUSHER
    distance_range: tuple[float, float] = (0.005, 0.3)
    physics: Physics | None = None
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
        for name in ("starts", "budget", "places", "angles"):
            if getattr(self, name) < 1:
                raise PlanningError(f"{name} is {getattr(self, name)!r}; expected at least 1")

    def resolve(self, model: Model) -> Model:
        """The model with the physics of pushes at the pusher's speed, with a regime but "auto"."""
        physics = self.physics or replace(model.physics, regime="auto")
        return model.with_physics(physics).resolve(self.pusher.speed)


@dataclass(frozen=True, eq=False)
class Trial:
    """A simulated push, at its best distance.

    Attributes:
        arc_length: s, where on the exterior outline the disc touches, m.
        piece: index of the piece of the reachable outline there.
        angle: of the motion from the inward normal there, rad.
        distance: d, m.
        pose: (3,) of the object at the push's end, X_WB, m and rad.
        cost: C there, m; infinite where the push is not allowed.
        slope: (3,) dC/dx by x = (s, phi, d); None where it was not asked for.
        curvature: (3, 3) H; None where it was not asked for.
    """

    arc_length: float
    piece: int
    angle: float
    distance: float
    pose: Array
    cost: float
    slope: Array | None = None
    curvature: Array | None = None


@dataclass(eq=False)
class TrialRunner:
    """Simulates pushes from one pose towards one goal, and counts them.

    Attributes:
        model: one object, with its parameters and the physics of these pushes.
        pose: (3,) where it lies, X_WB, m and rad.
        goal: (3,) where it should, X_WB, m and rad.
        reach: where on the outline the disc can touch.
        checker: the rules that a push must keep.
        options: what pushes may be chosen from.
        distance_range: least and greatest distance that are tried, m.
        simulations: number of simulations so far.

    Raises:
        SimulationError: nothing rubs on the table, and no push is so fast that it could be
            simulated.
    """

    model: Model
    pose: Array
    goal: Array
    reach: ReachableOutline
    checker: PushChecker
    options: ContactOptions
    distance_range: tuple[float, float]
    simulations: int = 0
    _steps: PushSteps | None = None

    def __post_init__(self) -> None:
        check_friction(self.model.physics, self.model.params)

    def make_push(self, arc_length: float, angle: float, distance: float) -> Push:
        """Makes the push at an arc length, m, with an angle, rad, and of a distance, m."""
        pusher = self.options.pusher
        return Push.on_outline(
            self.model.obj,
            arc_length,
            angle,
            distance,
            radius=pusher.choose_radius(self.model.obj),
            shape=pusher.shape,
            speed=self.options.pusher.speed,
            pose=self.pose,
            clearance=self.options.pusher.clearance,
        )

    def run(
        self,
        arc_length: float,
        piece: int,
        angle: float,
        gradient: bool = False,
        better_than: float = np.inf,
    ) -> Trial:
        """Simulates the longest push at a place and angle, and takes its best allowed part.

        Args:
            arc_length: s, m.
            piece: of the reachable outline that s is on.
            angle: from the inward normal, rad.
            gradient: whether slope and curvature are wanted, too.
            better_than: cost, m, below which the trial must be for that.

        Returns:
            The trial; of infinite cost where the push misses, or no part of it is allowed.
        """
        least, greatest = self.distance_range
        push = self.make_push(arc_length, angle, greatest)
        failed = Trial(
            arc_length=arc_length,
            piece=piece,
            angle=angle,
            distance=greatest,
            pose=self.pose,
            cost=np.inf,
        )
        if not self.checker.allows_finger(push.start[None])[0]:
            return failed
        steps = self._find_steps(push)
        times = steps.times
        motion = self._simulate(push, steps)
        self.simulations += 1
        if motion.status in (MotionStatus.STARTED_OVERLAPPING, MotionStatus.NOT_CONVERGED):
            return failed
        # The steps that are long enough, and allowed; of these the one nearest to the goal.
        traveled = self.options.pusher.speed * times
        usable = self.checker.count_allowed(motion.tip, motion.poses)
        first = int(np.searchsorted(traveled, least - DISTANCE_TOUCH))
        if usable <= first:
            return failed
        best, cost = self._find_nearest(motion.poses, first, usable)
        trial = Trial(
            arc_length=arc_length,
            piece=piece,
            angle=angle,
            distance=float(traveled[best]),
            pose=motion.poses[best].copy(),
            cost=cost,
        )
        if not (gradient and cost < better_than):
            return trial
        dq_dx = self._calc_pose_derivatives(push, motion, traveled, best)
        slope, H = calc_cost_derivatives(self.model.obj, trial.pose, self.goal, dq_dx)
        # A distance that cannot change, for the range or a rule ends here, is no unknown.
        if best in (first, usable - 1):
            slope, H = _exclude(slope, H, 2)
        return replace(trial, slope=slope, curvature=H)

    def _simulate(self, push: Push, steps: PushSteps) -> Motion:
        """Simulates a push by the object at `pose`, at rest."""
        if push.shape is not None:
            return simulate_one(self.model, push, self.pose, times=steps.times, record=[])
        return simulate_steps(self.model, push, pose=self.pose, velocity=ZERO_TWIST, steps=steps)

    def _calc_pose_derivatives(
        self, push: Push, motion: Motion, traveled: Array, step: int
    ) -> Array:
        """Calculates dq/dx of a push about a step: at the nearest one of every few.

        The push is simulated once more, with its Jacobian, but only as far as there.

        Args:
            push: the longest push.
            motion: of the object under it, T steps.
            traveled: (T+1,) length of the pusher's path up to each step, m.
            step: the given one.

        Returns:
            (3, 3) derivatives of the pose by x = (s, phi, d).
        """
        last = len(traveled) - 1
        rows = np.append(np.arange(0, last, RECORD_EVERY), last)
        k = int(rows[np.argmin(np.abs(rows - step))])
        # dq/dd by the poses before and after.
        after = min(k + 1, last)
        before = max(k - 1, 0)
        dq_dd = (motion.poses[after] - motion.poses[before]) / (traveled[after] - traveled[before])
        if k == 0:
            return np.column_stack([np.zeros((3, 2)), dq_dd])
        assert self._steps is not None
        J = simulate_steps(
            self.model,
            push,
            pose=self.pose,
            velocity=ZERO_TWIST,
            steps=self._steps.take_first(k),
            gradients="push",
        ).jacobian
        assert J.contact_location is not None
        return np.column_stack([J.contact_location[0], J.direction[0], dq_dd])

    def _find_steps(self, longest: Push) -> PushSteps:
        """Finds the steps of the longest pushes, which are as long as each other."""
        if self._steps is None:
            regime = self.model.physics.regime
            times = make_path_times(longest, regime)
            self._steps = PushSteps.of_record(longest, times, np.empty(0, np.int64), regime)
        return self._steps

    def _find_nearest(self, poses: Array, first: int, end: int) -> tuple[int, float]:
        """Finds the pose nearest to the goal, at first coarsely, then among its neighbors.

        Args:
            poses: (K, 3) of a motion.
            first: index of the first pose that may be taken.
            end: index after the last pose that may be taken.

        Returns:
            Its index and its cost, m.
        """
        rows = np.unique(np.append(np.arange(first, end, RECORD_EVERY), end - 1))
        coarse = int(rows[np.argmin(calc_goal_error(self.model.obj, poses[rows], self.goal))])
        begin = max(first, coarse - RECORD_EVERY + 1)
        stop = min(end, coarse + RECORD_EVERY)
        costs = calc_goal_error(self.model.obj, poses[begin:stop], self.goal)
        return begin + int(np.argmin(costs)), float(costs.min())

    def finish(self, trial: Trial, simulations: int) -> PlannedPush:
        """Makes the planned push of a trial; `simulations` is how many the choice took."""
        return PlannedPush(
            arc_length=trial.arc_length,
            angle=trial.angle,
            distance=trial.distance,
            push=self.make_push(trial.arc_length, trial.angle, trial.distance),
            pose=trial.pose,
            cost=trial.cost,
            simulations=simulations,
        )


def calc_cost_derivatives(
    obj: GridObject, pose: Array, goal: Array, dq_dx: Array
) -> tuple[Array, Array]:
    """Calculates dC/dx and H, see above.

    Args:
        obj: the object.
        pose: (3,) q, X_WB, m and rad.
        goal: (3,) the goal pose.
        dq_dx: (3, k) derivatives of the pose by k parameters x.

    Returns:
        dC/dx (k,) and H (k, k).
    """
    by_pose = np.empty(3)
    H = np.empty((3, 3))
    fill_cost_derivatives(
        cells=get_cells(obj),
        pose=np.array(pose, dtype=np.float64),
        goal=np.array(goal, dtype=np.float64),
        least=MIN_RESIDUAL,
        slope=by_pose,
        H=H,
    )
    return by_pose @ dq_dx, dq_dx.T @ H @ dq_dx


def _exclude(slope: Array, H: Array, index: int) -> tuple[Array, Array]:
    """The gradient (k,) and the matrix H (k, k) with which a step leaves one parameter as it is."""
    slope = slope.copy()
    slope[index] = 0.0
    H = H.copy()
    H[index, :] = 0.0
    H[:, index] = 0.0
    H[index, index] = 1.0
    return slope, H
