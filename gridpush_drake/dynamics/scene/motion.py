"""What a simulated push of several objects gives back."""

from dataclasses import dataclass, field

import numpy as np

from gridpush_drake.dynamics.motion import MotionStatus
from gridpush_drake.dynamics.physics import Physics
from gridpush_drake.errors import SimulationError
from gridpush_drake.geometry.se2 import Array, IntArray
from gridpush_drake.notebook import count, describe_move


@dataclass(frozen=True, eq=False)
class SceneJacobian:
    """Derivatives of recorded poses of N objects, named blocks; R poses (x, y in m; theta in rad).

    Attributes:
        steps: (R,) the steps the rows belong to.
        mass: for each object, (R, N, 3, n) the derivatives of all poses by the masses of its n
            cells, 1/kg.
        friction: for each object, (R, N, 3, n) by the friction coefficients of its cells.
        contact_friction: (R, N, 3, N) by the pusher's friction coefficient with each object.
        pair_friction: (R, N, 3, N, N) by the friction coefficient of each pair of objects; it is
            the same at (i, j) and (j, i), which are one number.
        start: (R, N, 3, 2) by the place (x, y) in W where the push begins, the path moved with it,
            1/m.
        direction: (R, N, 3) by turning the path about its start, 1/rad.
        length: (R, N, 3) by the length of the path, 1/m.
        pose: (R, N, 3, N, 3) by the poses at the beginning.
    """

    steps: IntArray
    mass: tuple[Array, ...]
    friction: tuple[Array, ...]
    contact_friction: Array
    pair_friction: Array
    start: Array
    direction: Array
    length: Array
    pose: Array

    def __repr__(self) -> str:
        """How many poses are derived by how many cells, in a line."""
        cells = sum(block.shape[-1] for block in self.mass)
        rows, bodies = self.contact_friction.shape[:2]
        return (
            f"SceneJacobian of {count(rows * bodies, 'pose')} by mass and friction of "
            f"{count(cells, 'cell')}"
        )


@dataclass(frozen=True, eq=False)
class SceneMotion:
    """The motion of N objects under one push, T steps; world frame unless said otherwise.

    Attributes:
        names: the objects' names.
        times: (T+1,) s from the push's beginning.
        poses: (T+1, N, 3) q = (x, y, theta) of the body frames, m and rad.
        tip: (T+1, 2) center of the pusher, m.
        bodies: (T, R, 2) the two bodies of each contact within reach, by their number: the one
            whose outline is touched, and the one that touches it, -1 for the pusher. Rows beyond a
            step's contacts are -2.
        forces: (T, R, 2) force on the first of the two, N; zero where they do not touch. What
            several contacts share in more than one way is shared in one of them.
        points: (T, R, 2) where it acts, halfway through the step, m; NaN beyond a step's contacts.
        modes: (T, R) contact modes: 0 separate, 1 stick, 2 slide with lam_t = +mu lam_n, 3 with the
            opposite sign.
        gaps: (T, R) at the beginning of the step, m; negative where two overlap.
        finger_gaps: (T+1,) distance from the pusher's edge to the nearest outline, m; infinite
            where it is far.
        status: how it went.
        residuals: (T, 2) what is left of the balance of forces, as a share of what acts on a body,
            and of the contact conditions, as a share of forces and speeds.
        iterations: (T,) Newton iterations of each step.
        physics: by which it was simulated.
        jacobian: derivatives of the poses, where asked for.
    """

    names: tuple[str, ...]
    times: Array
    poses: Array
    tip: Array
    bodies: IntArray
    forces: Array
    points: Array
    modes: IntArray
    gaps: Array
    finger_gaps: Array
    status: MotionStatus
    residuals: Array
    iterations: IntArray
    physics: Physics
    _jacobian: SceneJacobian | None = field(default=None, repr=False)

    def __repr__(self) -> str:
        """Status, duration and what became of the objects, in a line each."""
        steps = count(len(self.times) - 1, "step")
        lines = [f"SceneMotion, {self.status}: {self.times[-1]:.3g} s in {steps}"]
        for name, first, last in zip(self.names, self.poses[0], self.poses[-1], strict=True):
            lines.append(f"{name} {describe_move(first, last)}")
        return "; ".join(lines)

    @property
    def jacobian(self) -> SceneJacobian:
        """The derivatives of the recorded poses.

        Raises:
            SimulationError: the simulation ran without `gradients`.
        """
        if self._jacobian is None:
            raise SimulationError("no derivatives: pass gradients=True to simulate_scene")
        return self._jacobian

    @property
    def final_poses(self) -> Array:
        """(N, 3) the last poses."""
        return np.asarray(self.poses[-1])

    @property
    def penetration(self) -> float:
        """Deepest overlap of two bodies, or of the pusher and one, m."""
        deepest = min(float(self.gaps.min(initial=0.0)), float(self.finger_gaps.min()))
        return max(0.0, -deepest)
