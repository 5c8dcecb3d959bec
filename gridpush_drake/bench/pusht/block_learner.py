"""Learns a block's center of friction and arm while it is pushed, by least squares.

The unknowns are z = (center x, center y, log arm). Of each decision in which the block moved, the
disc's state, the block's pose before and the target are known; the law of
`dynamics.kernels.steering.driven_disc` then gives the pose afterwards, y(z). `BlockLearner`
minimizes

    |S^-1/2 (z - z0)|² + sum over decisions huber(|y(z) - observed| / sigma)

by Levenberg-Marquardt's method with differences for derivatives, started at the estimate before.
The angle counts as a length, by the block's radius of gyration. Two kinds of decisions are left
out, for which the law says less: near a wall, where several contacts share a load, and with the
disc's center inside the block, where it may leave by any side.
"""

from dataclasses import dataclass

import numpy as np
from shapely import Point

from gridpush_drake.bench.pusht.sliding_block import BlockEstimate, SlidingBlock
from gridpush_drake.dynamics.kernels.steering.driven_disc import (
    PX,
    STATE_SIZE,
    THETA,
    VX,
    X,
    predict_poses,
)
from gridpush_drake.geometry.se2 import Array, transform_back, wrap_angle

UNKNOWNS = 3
"""Numbers that are learned: the center along x and y, and the logarithm of the arm."""


@dataclass(frozen=True)
class BlockLearnerOptions:
    """What is held possible beforehand, and how much is remembered. Lengths in the block's unit.

    Attributes:
        center_std: standard deviation of the center along each axis, in radii of gyration.
        log_gyration_radius_std: standard deviation of the arm's logarithm.
        noise: standard deviation of an observed pose, in radii of gyration.
        memory: decisions that are remembered; those that moved the block least are forgotten first.
        iterations: steps of the method after each decision.
        wall_distance: a decision counts as near a wall within this distance, in radii of the disc.
        least_motion: motion that counts as one, in radii of gyration.
    """

    center_std: float = 0.35
    log_gyration_radius_std: float = 0.3
    noise: float = 1e-3
    memory: int = 24
    iterations: int = 6
    wall_distance: float = 0.3
    least_motion: float = 2e-4


FIRST_DAMPING = 1e-3
"""Damping that Levenberg-Marquardt's method begins with, as a fraction of the diagonal."""

DAMPING_FACTOR = 8.0
"""By how much the damping grows after a bad step, and falls after a good one."""

DIFFERENCE = 1e-5
"""Step of the differences, in radii of gyration or of the logarithm."""

OUTLYING = 5.0
"""Length of a decision's residual, in standard deviations, beyond which its cost grows linearly."""

MISFIT = 100.0
"""Residual, in standard deviations, that tells of a poor minimum: the search then also starts from
what was believed first."""

CONVERGED = 1e-9
"""Relative decrease of the cost below which the method has converged."""


class BlockLearner:
    """Learns one block within one episode.

    Attributes:
        block: what is known beforehand.
        options: what is held possible.
        estimate: the present estimate.
        covariance: (3, 3) of the unknowns, linearized at the estimate.
    """

    def __init__(self, block: SlidingBlock, options: BlockLearnerOptions | None = None) -> None:
        """Begins with the even block's estimate."""
        self.block = block
        self.options = options or BlockLearnerOptions()
        self.estimate = block.even_estimate
        unit = block.gyration_radius
        center_std = self.options.center_std * unit
        self._prior_std = np.array([center_std, center_std, self.options.log_gyration_radius_std])
        self._prior_mean = _to_unknowns(self.estimate)
        self._scale = np.array([unit, unit, 1.0])
        self.covariance = np.diag(self._prior_std**2)
        self._states = np.empty((0, STATE_SIZE))
        self._targets = np.empty((0, 2))
        self._poses = np.empty((0, 3))
        self._motions = np.empty(0)

    def add(self, disc: Array, pose: Array, target: Array, pose_after: Array) -> bool:
        """Takes in one decision, and renews the estimate where it told anything.

        Args:
            disc: (4,) position and velocity of the disc before.
            pose: (3,) pose of the block before.
            target: (2,) target of the disc.
            pose_after: (3,) pose of the block afterwards.

        Returns:
            Whether the estimate was renewed.
        """
        unit = self.block.gyration_radius
        change = pose_after - pose
        turn = float(wrap_angle(change[2]))
        motion = float(np.hypot(np.hypot(change[0], change[1]), unit * turn))
        if motion < self.options.least_motion * unit:
            return False
        if self._is_near_wall(pose) or self._is_near_wall(pose_after):
            return False
        if self._is_inside(disc[:2], pose):
            return False
        state = np.zeros(STATE_SIZE)
        state[PX : VX + 2] = disc
        state[X : THETA + 1] = pose
        # the pose afterwards, with an angle that does not jump
        after = np.append(pose_after[:2], pose[2] + turn)
        self._states = np.vstack([self._states, state])
        self._targets = np.vstack([self._targets, target])
        self._poses = np.vstack([self._poses, after])
        self._motions = np.append(self._motions, motion)
        if len(self._motions) > self.options.memory:
            least = int(self._motions[:-1].argmin())
            self._states = np.delete(self._states, least, axis=0)
            self._targets = np.delete(self._targets, least, axis=0)
            self._poses = np.delete(self._poses, least, axis=0)
            self._motions = np.delete(self._motions, least)
        self._fit()
        return True

    def _is_near_wall(self, pose: Array) -> bool:
        """Whether a corner of the block is near a wall at a pose (3,)."""
        c = np.cos(pose[2])
        s = np.sin(pose[2])
        corners = np.concatenate([np.asarray(part) for part in self.block.parts])
        world = corners @ np.array([[c, s], [-s, c]]) + pose[:2]
        low_x, low_y, high_x, high_y = self.block.walls
        margin = self.options.wall_distance * self.block.disc.radius
        inside = (world > np.array([low_x, low_y]) + margin).all()
        return not bool(inside and (world < np.array([high_x, high_y]) - margin).all())

    def _is_inside(self, position: Array, pose: Array) -> bool:
        """Whether a point (2,) is inside the block at a pose (3,)."""
        return self.block.outline.contains(Point(transform_back(pose, position[None])[0]))

    def _fit(self) -> None:
        """Minimizes the cost from the present estimate on; from the first too if it fits badly."""
        z, cost = self._minimize(_to_unknowns(self.estimate))
        residual = self._calc_residual(z)
        if np.abs(residual[UNKNOWNS:]).max() > MISFIT:
            other, other_cost = self._minimize(self._prior_mean)
            if other_cost < cost:
                z = other
                residual = self._calc_residual(z)
        weights = _calc_weights(residual)
        J = weights[:, None] * self._differentiate(z, residual)
        self.covariance = np.linalg.inv(J.T @ J)
        self.estimate = BlockEstimate(float(z[0]), float(z[1]), float(np.exp(z[2])))

    def _minimize(self, z: Array) -> tuple[Array, float]:
        """Minimizes the cost from unknowns (3,) on; returns where it is least, and its value."""
        residual = self._calc_residual(z)
        cost = _calc_cost(residual)
        damping = FIRST_DAMPING
        J = self._differentiate(z, residual)
        for _ in range(self.options.iterations):
            # each residual counts by its weight, with which its square is Huber's cost nearby
            weights = _calc_weights(residual)
            A = weights[:, None] * J
            H = A.T @ A
            gradient = A.T @ (weights * residual)
            step = np.linalg.solve(H + damping * np.diag(np.diag(H)), -gradient)
            tried = self._calc_residual(z + step)
            tried_cost = _calc_cost(tried)
            if not tried_cost < cost:
                damping *= DAMPING_FACTOR
                continue
            settled = cost - tried_cost < CONVERGED * cost
            z = z + step
            residual = tried
            cost = tried_cost
            damping /= DAMPING_FACTOR
            if settled:
                break
            J = self._differentiate(z, residual)
        return z, cost

    def _calc_residual(self, z: Array) -> Array:
        """All residuals of the cost at unknowns (3,), the prior's first."""
        estimate = BlockEstimate(float(z[0]), float(z[1]), float(np.exp(z[2])))
        poses = np.empty_like(self._poses)
        predict_poses(self.block.make_record(estimate), self._states, self._targets, poses)
        unit = self.block.gyration_radius
        off = (poses - self._poses) * np.array([1.0, 1.0, unit]) / (self.options.noise * unit)
        return np.concatenate([(z - self._prior_mean) / self._prior_std, off.ravel()])

    def _differentiate(self, z: Array, residual: Array) -> Array:
        """(n, 3) derivative of the residuals, by forward differences."""
        columns = []
        for i in range(UNKNOWNS):
            moved = z.copy()
            moved[i] += DIFFERENCE * self._scale[i]
            columns.append((self._calc_residual(moved) - residual) / (moved[i] - z[i]))
        return np.column_stack(columns)


def _calc_sizes(residual: Array) -> Array:
    """(n, 1) length of each decision's residual, which has three numbers."""
    return np.linalg.norm(residual[UNKNOWNS:].reshape(-1, UNKNOWNS), axis=1, keepdims=True)


def _calc_cost(residual: Array) -> float:
    """Sum of squares of residuals (n,); those of a decision grow linearly beyond OUTLYING."""
    prior = residual[:UNKNOWNS]
    size = _calc_sizes(residual)
    huber = np.where(size < OUTLYING, size**2, OUTLYING * (2.0 * size - OUTLYING))
    return float(prior @ prior + huber.sum())


def _calc_weights(residual: Array) -> Array:
    """(n,) weights by which residuals are multiplied in the quadratic model of the cost."""
    size = np.maximum(_calc_sizes(residual), np.finfo(float).tiny)
    weights = np.sqrt(np.minimum(1.0, OUTLYING / size))
    return np.concatenate([np.ones(UNKNOWNS), np.repeat(weights[:, 0], UNKNOWNS)])


def _to_unknowns(estimate: BlockEstimate) -> Array:
    """The unknowns (3,) of an estimate."""
    return np.array([estimate.center_x, estimate.center_y, np.log(estimate.arm)])
