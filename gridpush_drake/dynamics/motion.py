"""`Motion`, the result of a simulated push, and `Jacobian`, its derivatives."""

from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.dynamics.bodies import Bodies
from gridpush_drake.dynamics.kernels import forward_sensitivity as columns
from gridpush_drake.dynamics.physics import Physics
from gridpush_drake.errors import SimulationError
from gridpush_drake.geometry.se2 import Array, IntArray
from gridpush_drake.notebook import count, describe_move, draw_paths, make_page

NO_BODY = -2
"""What stands in `Motion.contact_bodies` where there is no contact."""


class MotionStatus(StrEnum):
    """How a simulated push went."""

    OK = "ok"
    NO_CONTACT = "no_contact"
    """The pusher never touched."""
    NOT_CONVERGED = "not_converged"
    """A step was not solved."""
    TIPS = "tips"
    """No loads can hold the object: it tips over the table's edge, or its own."""
    STARTED_OVERLAPPING = "started_overlapping"
    """The pusher began more than 0.1 mm inside the object, which then jumped clear."""


OVERLAP_TOLERANCE = 1e-4
"""Overlap of pusher and outline at the beginning that a motion's status does not mention, m."""


@dataclass(frozen=True, eq=False)
class Jacobian:
    """Derivatives of R recorded poses, x and y in m and theta in rad, in blocks with names.

    Of N objects, N > 1, the shape of what is differentiated is (R, N, 3) in place of (R, 3).

    Attributes:
        steps: (R,) the steps the rows belong to.
        mass: (R, 3, n) by the cells' masses, 1/kg; (R, 3, 0) where only those by the push were
            asked for. Of several objects, the cells of all, one object after the other.
        friction: (R, 3, n) by the cells' friction coefficients, likewise; (R, 3, 0) where only
            those by mass or by the push were asked for.
        contact_friction: (R, 3) by the pusher's friction coefficient; (R, N, 3, N) by that with
            each of several objects.
        start: (R, 3, 2) by the place (x, y) in W where the push begins, the path moved with it,
            1/m.
        direction: (R, 3) by turning the path about its start, 1/rad.
        length: (R, 3) by the length of the path, its duration held, 1/m.
        pose: (R, 3, 3) by the pose at the beginning; (R, N, 3, N, 3) by those of several objects.
        contact_location: (R, 3) by the arc length on the outline where the push begins, 1/m; None
            unless the push was made by `Push.on_outline`, and of several objects.
        push_height: (R, 3) by the height at which the pusher acts; None where loads do not shift.
        yaw: (R, 3) by turning a shaped pusher about its frame's origin, at all times alike, 1/rad;
            None of a disc, as `turn` and `center`.
        turn: (R, 3) by how far it turns from beginning to end, its places held, 1/rad.
        center: (R, 3, 2) by the place (x, y) in W of the center about which it turns, its start and
            its yaws held, 1/m.
        pair_friction: (R, N, 3, N, N) by the friction coefficient of each pair of objects; it is
            the same at (i, j) and (j, i), which are one number. None of one object.
    """

    steps: IntArray
    mass: Array
    friction: Array
    contact_friction: Array
    start: Array
    direction: Array
    length: Array
    pose: Array
    contact_location: Array | None = None
    push_height: Array | None = None
    pair_friction: Array | None = None
    yaw: Array | None = None
    turn: Array | None = None
    center: Array | None = None

    def __repr__(self) -> str:
        """How many poses are derived by how many cells, in a line."""
        *rows, _, cells = self.mass.shape
        poses = count(int(np.prod(rows)), "pose")
        return f"Jacobian of {poses} by mass and friction of {count(cells, 'cell')}"


@dataclass(frozen=True, eq=False)
class Motion:
    """The motion of an object, or of several, under one push of T steps; world frame W.

    Attributes:
        times: (T+1,) s from the push's beginning.
        poses: (T+1, 3) q = (x, y, theta) of the body frame, m and rad; (T+1, N, 3) of several
            objects.
        velocities: (T+1, 3) (vx, vy, w) of the body frame's origin, m/s and rad/s; (T+1, N, 3) of
            several objects.
        tip: (T+1, 2) center of the pusher, or origin of its shape's frame, m; NaN for a
            force-driven push.
        contact_forces: (T, C, 2) force on the object at each contact within reach, N. In the
            quasi-static regime too: it is what the support's friction asks for. How several
            contacts that stick share it is statically indeterminate; one admissible way is given.
            Of one object C is 2: the contacts of a disc; of another shape as many as occur.
        contact_points: (T, C, 2) where they act, halfway through the step, m; NaN where there is no
            contact.
        modes: (T, C) contact modes: 0 separate, 1 stick, 2 slide with lam_t = +mu_c lam_n, 3 with
            the opposite sign.
        gaps: (T+1,) distance from the pusher's edge to the nearest outline, m; negative where they
            overlap, infinite where far.
        status: how it went; compares equal to its string, "ok" for instance.
        load_centers: (T, 2) where the table bears the object at each step, on average, m; NaN where
            every cell bears its own weight, as all do where there are several objects.
        tips: (T,) whether no loads can hold the object: their center would be beyond what is on the
            table.
        iterations: (T,) Newton iterations of each step.
        physics: physics of the simulation; its regime is never "auto".
        contact_bodies: (T, C, 2) the two bodies of each contact, by their number: the one whose
            outline is touched, on which the force acts, and the one that touches it, -1 for the
            pusher; both `NO_BODY` beyond a step's contacts. None of one object.
        contact_gaps: (T, C) distance at each contact when the step begins, m; negative where two
            overlap. None of one object.
        residuals: (T, 2) what is left of the balance of forces, as a fraction of what acts on a
            body, and of the contact conditions, as a fraction of forces and speeds. None of one
            object.
        yaw: (T+1,) angle of the pusher's frame, rad; None of a disc.
        jacobian: derivatives of the poses, where asked for.
    """

    times: Array
    poses: Array
    velocities: Array
    tip: Array
    contact_forces: Array
    contact_points: Array
    modes: IntArray
    gaps: Array
    status: MotionStatus
    load_centers: Array
    tips: NDArray[np.bool_]
    iterations: IntArray
    physics: Physics
    contact_bodies: IntArray | None = None
    contact_gaps: Array | None = None
    residuals: Array | None = None
    yaw: Array | None = None
    _jacobian: "Jacobian | RawJacobian | None" = field(default=None, repr=False)

    def __repr__(self) -> str:
        """Status, duration and what became of each object, in a line."""
        steps = count(len(self.times) - 1, "step")
        began = f"Motion, {self.status}: {self.times[-1]:.3g} s in {steps}"
        if self.poses.ndim == 2:
            return f"{began}, the object {describe_move(self.poses[0], self.poses[-1])}"
        moves = enumerate(zip(self.poses[0], self.poses[-1], strict=True))
        return "; ".join([began, *(f"object {b} {describe_move(*ends)}" for b, ends in moves)])

    def _repr_html_(self) -> str:
        """The paths of pusher and objects."""
        several = self.poses.reshape(len(self.poses), -1, 3)
        paths = [(self.tip, "crimson", "pusher")]
        paths += [
            (several[:, b, :2], "teal", "object's body frame") for b in range(several.shape[1])
        ]
        return make_page(repr(self), draw_paths(paths))

    @cached_property
    def jacobian(self) -> Jacobian:
        """The derivatives of the recorded poses.

        Raises:
            SimulationError: the simulation ran without `gradients`.
        """
        if self._jacobian is None:
            raise SimulationError(
                "no derivatives: pass gradients=True or gradients='paper' to simulate"
            )
        return self._jacobian if isinstance(self._jacobian, Jacobian) else self._jacobian.expand()

    @property
    def final_pose(self) -> Array:
        """(3,) the last pose; (N, 3) of several objects."""
        return self.poses[-1]

    def calc_net_forces(self) -> Array:
        """Calculates the force (T, N, 2) of all contacts on each of N objects, N; N may be 1."""
        if self.contact_bodies is None:
            return self.contact_forces.sum(axis=1)[:, None]
        first, second = np.moveaxis(self.contact_bodies, 2, 0)
        bodies = np.arange(self.poses.shape[1])
        # each contact's force acts on the first body, and the other way round on the second
        sign = (first[..., None] == bodies).astype(float) - (second[..., None] == bodies)
        forces = np.where(first[..., None] >= 0, self.contact_forces, 0.0)
        return np.asarray(np.einsum("tcb,tcd->tbd", sign, forces))

    @property
    def penetration(self) -> float:
        """Deepest overlap of pusher and outline, or of two objects, m."""
        deepest = float(self.gaps.min())
        if self.contact_gaps is not None:
            deepest = min(deepest, float(self.contact_gaps.min(initial=0.0)))
        return max(0.0, -deepest)


@dataclass(frozen=True, eq=False)
class RawJacobian:
    """The kernel's columns, and what turns them into named blocks by the chain rule.

    k_i = mu_i m_i g, and m_i moves mass, center of mass c and inertia I about it:
    dm = dm_i, dc = (p_i - c)/m dm_i, dI = (|p_i - c|² + s²/6) dm_i. Where loads shift the columns
    are by m_i already.

    Attributes:
        steps: (R,) the differentiated poses.
        J: (R, 3, width) the kernel's columns, see `kernels.forward_sensitivity`.
        p_BC: (n, 2) cell centers, m.
        cell_size: side of a cell, m.
        mass: (n,) m_i, kg.
        friction: (n,) mu_i.
        gravity: g, m/s².
        inertial: whether the body has inertia.
        start_tangent: (2,) unit tangent of the outline where the push begins; None where its start
            does not move along the outline.
        shifted: whether the columns are by m_i already.
        by_cells: whether derivatives by the cells are wanted. Where they are not, and loads do not
            shift, the kernel made no columns of them.
    """

    steps: IntArray
    J: Array
    p_BC: Array
    cell_size: float
    mass: Array
    friction: Array
    gravity: float
    inertial: bool
    start_tangent: Array | None
    shifted: bool = False
    by_cells: bool = True

    @classmethod
    def of_parameters(
        cls,
        bodies: Bodies,
        *,
        steps: IntArray,
        J: Array,
        shifted: bool,
        start_tangent: Array | None = None,
        by_cells: bool = True,
    ) -> "RawJacobian":
        """Makes it of an object, its parameters, the physics, and what the kernel filled in."""
        obj = bodies.obj
        params = bodies.params
        physics = bodies.physics
        return cls(
            steps=steps,
            J=J,
            p_BC=obj.p_BC,
            cell_size=obj.cell_size,
            mass=params.mass,
            friction=params.friction,
            gravity=physics.gravity,
            inertial=physics.inertial,
            start_tangent=start_tangent,
            shifted=shifted,
            by_cells=by_cells,
        )

    @property
    def cell_columns(self) -> int:
        """How many of the kernel's columns are by cells; they come first."""
        return len(self.mass) if self.by_cells or self.shifted else 0

    @property
    def other(self) -> Array:
        """(R, 3, OTHER) the columns after those of the cells' frictions."""
        n = self.cell_columns
        return self.J[..., n : n + columns.OTHER_COLUMNS]

    def calc_mass(self) -> Array:
        """(R, 3, n) by the cells' masses, 1/kg."""
        n = len(self.mass)
        other = self.other
        load = self.J[..., :n]
        mass = load if self.shifted else load * (self.friction * self.gravity)
        if self.inertial:
            total = self.mass.sum()
            arm = self.p_BC - self.mass @ self.p_BC / total
            moments = np.stack(
                [
                    np.ones(n),
                    arm[:, 0] / total,
                    arm[:, 1] / total,
                    (arm**2).sum(axis=1) + self.cell_size**2 / 6,
                ]
            )
            mass = mass + other[..., columns.MASS : columns.INERTIA + 1] @ moments
        return np.asarray(mass)

    def calc_friction(self) -> Array:
        """(R, 3, n) by the cells' frictions. Where loads shift, the kernel was asked for them."""
        n = len(self.mass)
        if self.shifted:
            return self.J[..., n + columns.OTHER_COLUMNS + 1 :]
        return np.asarray(self.J[..., :n] * (self.mass * self.gravity))

    def expand(self) -> Jacobian:
        """Applies the chain rule."""
        n = self.cell_columns
        other = self.other
        nothing = np.empty((*self.J.shape[:2], 0))
        mass = self.calc_mass() if self.by_cells else nothing
        friction = self.calc_friction() if self.by_cells else nothing
        more = self.J[..., n + columns.OTHER_COLUMNS :]
        start = other[..., columns.START_X : columns.START_Y + 1]
        return Jacobian(
            steps=self.steps,
            mass=mass,
            friction=friction,
            contact_friction=other[..., columns.CONTACT_FRICTION],
            start=start,
            direction=other[..., columns.DIRECTION],
            length=other[..., columns.LENGTH],
            pose=other[..., columns.POSE_X : columns.POSE_THETA + 1],
            contact_location=None if self.start_tangent is None else start @ self.start_tangent,
            push_height=more[..., 0] if self.shifted else None,
        )
