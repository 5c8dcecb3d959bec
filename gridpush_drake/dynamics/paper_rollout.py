"""The paper's closed-form gradient, along a simulated push: each step by itself.

It is what Song & Boularias descend on (RSS 2020, section V): the pose and velocity before the step, the applied and the
contact forces and the friction directions are held constant, and only the step's own impulses are differentiated. It
is NOT the derivative of the motion: what a parameter changed in earlier steps, and how the contact answers, is missing.
That derivative is `gradients=True`. Here it costs half of the simulation itself.

With nu, nu' the twists before and after the step, of the body as the step sees it (`rollout`),

    dnu'/dm_i  = -M_B^-1 [T_i^T diag(s²/6, 1, 1) T_i (nu' - nu) + mu_i g dt f_i]
    dnu'/dmu_i = -M_B^-1 m_i g dt f_i,      dq_{t+1} = dt dnu'

and f_i the direction of cell i's motion before the step, or after it where the cell was at rest (impending motion); a
motion that the step reversed has no friction. A body that the step brings to rest has no derivative, and where separate
spin friction holds its rotation, M_B^-1 gives way to its projection on translations. `paper_gradient` derives all this.
"""

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.dynamics.friction import SPIN_ARM
from gridpush_drake.dynamics.kernel_call import Method, Steps
from gridpush_drake.dynamics.paper_kernel import fill_paper_gradient
from gridpush_drake.dynamics.simulation import Jacobian
from gridpush_drake.grid.object import GridObject
from gridpush_drake.grid.parameters import CellParameters

Array = NDArray[np.float64]

REST = 1e-5
"""m/s; a step that leaves less has stopped the body: far above the stiction tolerance, far below any push."""


def calc_paper_jacobian(
    obj: GridObject,
    params: CellParameters,
    steps: Steps,
    dts: Array,
    rows: NDArray[np.int64],
    gravity: float,
    method: Method,
) -> Jacobian:
    """Differentiates each recorded pose by the step that led to it.

    Args:
        obj: the object.
        params: mass and friction of its cells.
        steps: the kernel's record.
        dts: (T,) s.
        rows: (R,) the poses wanted; that of pose 0, which no step led to, is zero.
        gravity: m/s².
        method: how the steps were taken; inertial.

    Returns:
        The blocks `mass` and `friction`; the others are zero.
    """
    t = np.maximum(rows - 1, 0)
    dt, arm = dts[t], SPIN_ARM * obj.cell_size
    before, turn = _twists_before(obj, params, steps, t, method.ahead * dt)
    after = steps.twists[t]
    turns = obj.radius_of_gyration * np.abs(after[:, 2]) > REST
    moves = turns | (np.hypot(after[:, 0], after[:, 1]) > REST)
    until = np.where((rows > 0) & moves, dt, 0.0)
    X_B = np.linalg.inv(_calc_inertia(obj, params))
    held = X_B - np.outer(X_B[:, 2], X_B[2]) / X_B[2, 2]
    sticks = ~turns & (method.spin == "separate")
    response = -until[:, None, None] * _rotations(turn) @ np.where(sticks[:, None, None], held, X_B)
    mass, friction = np.empty((len(rows), 3, obj.n)), np.empty((len(rows), 3, obj.n))
    fill_paper_gradient(
        np.array(obj.p_BC.T, order="C"), np.array(params.mass), np.array(params.friction), obj.cell_size**2 / 6,
        arm**2 if method.spin == "coupled" else 0.0, arm if method.spin == "separate" else 0.0, before, after,
        gravity * dt, response, mass, friction,
    )  # fmt: skip
    zeros = np.zeros((len(rows), 3))
    return Jacobian(
        steps=rows, mass=mass, friction=friction, contact_friction=zeros, start=np.zeros((len(rows), 3, 2)),
        direction=zeros, length=zeros, pose=np.zeros((len(rows), 3, 3)),
    )  # fmt: skip


def _twists_before(
    obj: GridObject, params: CellParameters, steps: Steps, t: NDArray[np.int64], until: Array
) -> tuple[Array, Array]:
    """(R, 3) the twists before the steps t, in their frames, and (R,) the frames' angles in W, rad.

    The frame is the body's, turned about its centre of mass for the time `until` (s) at the yaw rate before the step.
    """
    cx, cy = params.centre_of_mass(obj)
    theta, w = steps.poses[t, 2], steps.velocities[t, 2]
    turn = theta + until * w
    c, s = np.cos(theta), np.sin(theta)
    com_vx, com_vy = steps.velocities[t, 0] - w * (s * cx + c * cy), steps.velocities[t, 1] + w * (c * cx - s * cy)
    c, s = np.cos(turn), np.sin(turn)
    return np.stack([c * com_vx + s * com_vy + w * cy, -s * com_vx + c * com_vy - w * cx, w], axis=1), turn


def _calc_inertia(obj: GridObject, params: CellParameters) -> Array:
    """M_B (3, 3) about B's origin, body frame: kg, kg m, kg m²."""
    m, (cx, cy) = params.total_mass, params.centre_of_mass(obj)
    about_origin = params.inertia(obj) + m * (cx**2 + cy**2)
    return np.array([[m, 0.0, -m * cy], [0.0, m, m * cx], [-m * cy, m * cx, about_origin]])


def _rotations(angles: Array) -> Array:
    """(R, 3, 3) from the body's axes to those of W, for twists."""
    R = np.zeros((len(angles), 3, 3))
    R[:, 0, 0] = R[:, 1, 1] = np.cos(angles)
    R[:, 1, 0] = np.sin(angles)
    R[:, 0, 1] = -R[:, 1, 0]
    R[:, 2, 2] = 1.0
    return R
