"""The paper's closed-form gradient, along a simulated push: each step by itself.

It is what Song & Boularias descend on (RSS 2020, section V): the pose and velocity before the step,
the applied and the contact forces and the friction directions are held constant, and only the
step's own impulses are differentiated. It is NOT the derivative of the motion: what a parameter
changed in earlier steps, and how the contact answers, is missing. That derivative is
`gradients=True`. Here it costs half of the simulation itself.

With nu, nu' the twists before and after the step, of the body as the step sees it (`rollout`),

    dnu'/dm_i  = -M_B^-1 [T_i^T diag(s²/6, 1, 1) T_i (nu' - nu) + mu_i g dt f_i]
    dnu'/dmu_i = -M_B^-1 m_i g dt f_i,      dq_{t+1} = dt dnu'

and f_i the direction of cell i's motion before the step, or after it where the cell was at rest
(impending motion); a motion that the step reversed has no friction. A body that the step brings to
rest has no derivative, and where separate spin friction holds its rotation, M_B^-1 gives way to its
projection on translations. `paper_gradient` derives all this.
"""

from math import sqrt

import numpy as np

from gridpush_drake.dynamics.bodies import Bodies
from gridpush_drake.dynamics.kernels.compiled import kernel
from gridpush_drake.dynamics.kernels.friction.friction_law import calc_spin_lever_arm
from gridpush_drake.dynamics.kernels.friction.lagged_friction import SPEED_AT_REST, YAW_RATE_AT_REST
from gridpush_drake.dynamics.kernels.inputs import Steps
from gridpush_drake.dynamics.motion import Jacobian
from gridpush_drake.geometry.se2 import Array, IntArray, make_rotation

REST_SPEED = 1e-5
"""Speed, m/s, below which a step has stopped the body. It is far above the stiction tolerance, and
far below any push."""


def calc_paper_jacobian(
    bodies: Bodies,
    steps: Steps,
    dts: Array,
    rows: IntArray,
) -> Jacobian:
    """Differentiates recorded poses, each by the step that led to it.

    Args:
        bodies: one object, with its parameters and physics.
        steps: record of the T simulated steps.
        dts: (T,) lengths of the steps, which are inertial, s.
        rows: (R,) the poses that are differentiated, 0 to T.

    Returns:
        The derivatives, whose blocks `mass` and `friction` are filled. The others are zero, and so
        is the row of pose 0, which no step led to.
    """
    obj = bodies.obj
    params = bodies.params
    physics = bodies.physics
    spin = physics.used_spin
    t = np.maximum(rows - 1, 0)
    dt = dts[t]
    arm = calc_spin_lever_arm(obj, params)

    # A step that stopped the body has no derivative.
    before, turn = _twists_before(bodies, steps, t, physics.ahead * dt)
    after = steps.twists[t]
    turns = obj.radius_of_gyration * np.abs(after[:, 2]) > REST_SPEED
    moves = turns | (np.hypot(after[:, 0], after[:, 1]) > REST_SPEED)
    until = np.where((rows > 0) & moves, dt, 0.0)

    # M_B^-1, or its projection where separate spin friction holds the rotation; times -dt, and
    # turned into W.
    X_B = np.linalg.inv(_calc_inertia(bodies))
    held = X_B - np.outer(X_B[:, 2], X_B[2]) / X_B[2, 2]
    sticks = ~turns & (spin == "separate")
    inverse_inertia = np.where(sticks[:, None, None], held, X_B)
    response = -until[:, None, None] * _rotations(turn) @ inverse_inertia
    mass = np.empty((len(rows), 3, obj.n))
    friction = np.empty((len(rows), 3, obj.n))
    fill_paper_gradient(
        cells=np.array(obj.p_BC.T, order="C"),
        mass=np.array(params.mass),
        friction=np.array(params.friction),
        inertia=obj.cell_size**2 / 6,
        kappa2=arm**2 if spin == "coupled" else 0.0,
        spin_lever_arm=arm if spin == "separate" else 0.0,
        before=before,
        after=after,
        impulse=physics.gravity * dt,
        response=response,
        dm=mass,
        dmu=friction,
    )
    zeros = np.zeros((len(rows), 3))
    return Jacobian(
        steps=rows,
        mass=mass,
        friction=friction,
        contact_friction=zeros,
        start=np.zeros((len(rows), 3, 2)),
        direction=zeros,
        length=zeros,
        pose=np.zeros((len(rows), 3, 3)),
    )


@kernel()
def fill_paper_gradient(
    cells: Array,
    mass: Array,
    friction: Array,
    inertia: float,
    kappa2: float,
    spin_lever_arm: float,
    before: Array,
    after: Array,
    impulse: Array,
    response: Array,
    dm: Array,
    dmu: Array,
) -> None:
    """Fills in the derivatives of R steps.

    Args:
        cells: (2, n) cell centers p_BC, m.
        mass, friction: (n,) m_i, kg, and mu_i.
        inertia: of a cell about its center over its mass, m².
        kappa2, spin_lever_arm: the spin model: kappa² (m²) of the coupled one, c s (m) of the
            separate one; else zero.
        before, after: (R, 3) twists, in the frames of the steps.
        impulse: (R,) g dt, N s/kg.
        response: (R, 3, 3) from an impulse in that frame to the pose's displacement in W.
        dm, dmu: (R, 3, n) filled, by m_i and mu_i.
    """
    px = cells[0]
    py = cells[1]
    n = px.shape[0]
    row_m = np.empty((3, n))
    row_mu = np.empty((3, n))
    for r in range(before.shape[0]):
        ux = before[r, 0]
        uy = before[r, 1]
        w = before[r, 2]
        ux1 = after[r, 0]
        uy1 = after[r, 1]
        w1 = after[r, 2]
        dx = ux1 - ux
        dy = uy1 - uy
        dw = w1 - w
        # Separate spin acts against the sense of rotation, unless the step reversed it.
        w_own = w if abs(w) > YAW_RATE_AT_REST else w1
        spins = abs(w_own) > YAW_RATE_AT_REST and w_own * w1 > 0.0
        spin = spin_lever_arm * np.sign(w_own) if spins else 0.0
        for i in range(n):
            x = px[i]
            y = py[i]
            vx = ux - w * y
            vy = uy + w * x
            wi = w
            vx1 = ux1 - w1 * y
            vy1 = uy1 + w1 * x
            # f_i: by the motion before the step, or after it for a cell that was at rest.
            size = sqrt(vx * vx + vy * vy + kappa2 * wi * wi)
            if size <= SPEED_AT_REST:
                vx = vx1
                vy = vy1
                wi = w1
                size = sqrt(vx * vx + vy * vy + kappa2 * wi * wi)
            slides = size > SPEED_AT_REST and vx * vx1 + vy * vy1 + kappa2 * wi * w1 > 0.0
            inverse = impulse[r] / size if slides else 0.0
            fx = vx * inverse
            fy = vy * inverse
            fw = x * fy - y * fx + kappa2 * wi * inverse + spin * impulse[r]
            # T_i^T diag(s²/6, 1, 1) T_i (nu' - nu) + mu_i g dt f_i, and m_i g dt f_i
            momentum_x = dx - dw * y
            momentum_y = dy + dw * x
            row_mu[0, i] = mass[i] * fx
            row_mu[1, i] = mass[i] * fy
            row_mu[2, i] = mass[i] * fw
            row_m[0, i] = momentum_x + friction[i] * fx
            row_m[1, i] = momentum_y + friction[i] * fy
            row_m[2, i] = x * momentum_y - y * momentum_x + inertia * dw + friction[i] * fw
        # to the pose's displacement in W
        for j in range(3):
            a = response[r, j, 0]
            b = response[r, j, 1]
            c = response[r, j, 2]
            for i in range(n):
                dm[r, j, i] = a * row_m[0, i] + b * row_m[1, i] + c * row_m[2, i]
                dmu[r, j, i] = a * row_mu[0, i] + b * row_mu[1, i] + c * row_mu[2, i]


def _twists_before(bodies: Bodies, steps: Steps, t: IntArray, until: Array) -> tuple[Array, Array]:
    """Calculates the twists before some steps, in the frames of the steps.

    A step's frame is the body's, turned about its center of mass at the yaw rate before the step.

    Args:
        bodies: one object, with its parameters.
        steps: record of the steps.
        t: (R,) the steps.
        until: (R,) for how long each frame is turned, s.

    Returns:
        The twists (R, 3), and the frames' angles in W (R,), rad.
    """
    cx, cy = bodies.params.center_of_mass(bodies.obj)
    theta = steps.poses[t, 2]
    w = steps.velocities[t, 2]
    turn = theta + until * w
    # The center of mass goes on straight; its velocity is that of B's origin plus w z × r.
    c = np.cos(theta)
    s = np.sin(theta)
    com_vx = steps.velocities[t, 0] - w * (s * cx + c * cy)
    com_vy = steps.velocities[t, 1] + w * (c * cx - s * cy)
    # In the turned frame, and back to B's origin.
    c = np.cos(turn)
    s = np.sin(turn)
    ux = c * com_vx + s * com_vy + w * cy
    uy = -s * com_vx + c * com_vy - w * cx
    return np.stack([ux, uy, w], axis=1), turn


def _calc_inertia(bodies: Bodies) -> Array:
    """Calculates M_B (3, 3) about B's origin, body frame: kg, kg m, kg m²."""
    obj = bodies.obj
    params = bodies.params
    m = params.total_mass
    cx, cy = params.center_of_mass(obj)
    about_origin = params.inertia(obj) + m * (cx**2 + cy**2)
    return np.array([[m, 0.0, -m * cy], [0.0, m, m * cx], [-m * cy, m * cx, about_origin]])


def _rotations(angles: Array) -> Array:
    """Makes the matrices (R, 3, 3) that turn twists by angles (R,), rad."""
    R = np.zeros((len(angles), 3, 3))
    R[:, :2, :2] = make_rotation(angles)
    R[:, 2, 2] = 1.0
    return R
