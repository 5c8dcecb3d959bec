"""Where an object's outline is in the frame in which its poses are logged, fitted with its loads.

A tracker's frame of an object may be off the frame in which its outline was drawn, by a pose
f = (x, y, theta). Pushes show it: by where the pusher meets the outline, and by how the object
moves. The loads' u and f are fitted together. For one f the loads are fitted as always, with one
smooth field. About that fit all residuals are linear,

    r + J du + F df,    J = dr/du, F = dr/df, whitened and weighted,

and with P the prior covariance of f, which is about zero, the loads are taken out of the equations:

    S = F^T F + P^-1 - F^T J H^-1 J^T F,    df = -S^-1 (F^T r + P^-1 f - F^T J H^-1 g)

with H = I + J^T J and g the gradient by u. f takes this step, and the loads are fitted again, until
the steps are small beside the spread, which is S^-1 (`docs/theory/identification.md`, section 14).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gridpush_drake.geometry.se2 import Array, compose
from gridpush_drake.identification.fit.linearized_fit import LinearizedFit
from gridpush_drake.identification.fit.map_fit import MapFit
from gridpush_drake.objects.grid_object import GridObject

FRAME_STD = (0.01, 0.01, 0.1)
"""Standard deviations, beforehand, of where an outline's frame is in the log's, m, m and rad."""

MAX_FRAME_STEPS = 15
"""Number of steps of the frame at most, each with a fit of the loads."""

SETTLED_STEP = 0.1
"""Length of a step of the frame, in standard deviations of its spread, at which it has settled."""

MAX_FRAME_STEP = (0.004, 0.004, 0.04)
"""Largest step of the frame, m, m and rad. A longer one is shortened: contacts change on the
way."""


@dataclass(frozen=True, eq=False)
class FrameFit:
    """Where the outline's frame is in the log's, and how surely.

    Attributes:
        pose: (3,) f, the pose of the outline's frame in that of the logged poses, m and rad.
        covariance: (3, 3) of f.
        gain: (n+1, 3) derivatives of z by f where the pushes are explained as before.
    """

    pose: Array
    covariance: Array
    gain: Array

    @property
    def std(self) -> Array:
        """Standard deviations (3,) of the pose, m and rad."""
        return np.sqrt(np.diag(self.covariance))

    def place(self, obj: GridObject) -> GridObject:
        """Moves an object from where its file has it to where the log does."""
        return obj.place(self.pose, self.std)

    def widen(self, covariance: Array) -> Array:
        """Adds to a covariance (n+1, n+1) of z, for one frame, what the frame leaves open."""
        return covariance + self.gain @ self.covariance @ self.gain.T


def fit_frame(obj: GridObject, fit_at: Callable[[GridObject], MapFit | None]) -> FrameFit:
    """Fits where an object's outline is in the frame of its logged poses.

    Args:
        obj: the object, where its file has it.
        fit_at: fits the loads of the object, which was moved in the frame of the log; None where
            no push touches it there.

    Returns:
        The frame.
    """
    pose = np.zeros(3)
    found = FrameFit(
        pose=pose, covariance=np.diag(np.square(FRAME_STD)), gain=np.zeros((obj.n + 1, 3))
    )
    for _ in range(MAX_FRAME_STEPS):
        fit = fit_at(obj.place(pose))
        if fit is None:
            break
        covariance, gain, step = _solve(fit.linearized, pose)
        found = FrameFit(pose=pose, covariance=covariance, gain=fit.linearized.A @ gain)
        if np.sqrt(step @ np.linalg.solve(covariance, step)) < SETTLED_STEP:
            break
        shortening = min(1.0, 1.0 / np.abs(step / MAX_FRAME_STEP).max())
        pose = compose(shortening * step, pose)
    return found


def _solve(system: LinearizedFit, pose: Array) -> tuple[Array, Array, Array]:
    """Solves for the frame about a fit of the loads.

    Args:
        system: the fit.
        pose: (3,) f there.

    Returns:
        The covariance S^-1 (3, 3), du/df (n+1, 3), and the step df (3,).
    """
    F = np.concatenate(
        [
            np.sqrt(weight) * W.apply(J)
            for weight, W, J in zip(
                system.weights, system.whitenings, system.linear.by_frame, strict=True
            )
        ]
    )
    J = system.J[: len(F)]
    r = system.r[: len(F)]
    precision = np.diag(np.square(FRAME_STD) ** -1.0)
    gain = -system.solve(J.T @ F)
    S = F.T @ F + precision + F.T @ (J @ gain)
    by_loads = system.u + system.J.T @ system.r
    slope = F.T @ r + precision @ pose + gain.T @ by_loads
    covariance = np.linalg.inv((S + S.T) / 2)
    return covariance, gain, -covariance @ slope
