"""A step's beginning: how the body moves and what acts on it, seen from the body.

The state is the pose (x, y, theta) of B in W and the velocity: of the center of mass, in the body
frame, with the yaw rate. In the quasi-static regime B's origin stands for the center of mass, and
the velocity tells nothing but how the body will probably go on. The frame of a step is the body's,
turned by the angle a = h w that it is expected to have turned after the time h, when the step looks
at it.
"""

from math import cos, sin
from typing import NamedTuple

from gridpush_drake.dynamics.kernels.compiled import kernel
from gridpush_drake.dynamics.kernels.integrate_pose import calc_turn


class State(NamedTuple):
    """Where the body is and how it moves.

    Attributes:
        x, y, theta: pose of B in W, m and rad.
        c, s: cosine and sine of theta.
        com_vx, com_vy: velocity of the center of mass, body frame, m/s.
        yaw_rate: rad/s.
        body_x, body_y: velocity of B's origin, body frame, m/s.
    """

    x: float
    y: float
    theta: float
    c: float
    s: float
    com_vx: float
    com_vy: float
    yaw_rate: float
    body_x: float
    body_y: float


class StepStart(NamedTuple):
    """What a step sees when it begins; body frame unless said otherwise.

    Attributes:
        dt, h: the step, and the time after which it looks at the body, s.
        a: the turn expected until then, rad.
        c, s: cosine and sine of theta.
        step_c, step_s: of theta + a.
        yaw_rate: rad/s.
        expected_vx, expected_vy: velocity of the center of mass, which it is expected to keep,
            frame of the step, m/s.
        tx, ty: the disc's center t, m.
        vx, vy: its velocity, m/s.
        vpx, vpy: the same in the frame of the step.
        rx, ry: the rate of t seen from the moving body, m/s.
        world_vx, world_vy: the disc's velocity in W, m/s.
        ray_x, ray_y: how far the disc is from where the push began, W, m.
        fx, fy, couple: force, frame of the step, N, and couple, N m.
    """

    dt: float
    h: float
    a: float
    c: float
    s: float
    step_c: float
    step_s: float
    yaw_rate: float
    expected_vx: float
    expected_vy: float
    tx: float
    ty: float
    vx: float
    vy: float
    vpx: float
    vpy: float
    rx: float
    ry: float
    world_vx: float
    world_vy: float
    ray_x: float
    ray_y: float
    fx: float
    fy: float
    couple: float


@kernel(allocates=False)
def make_state(pose, velocity, com_x, com_y):
    """Makes the state from q (3,) and nu (3,), which is of B's origin in W, m/s and rad/s."""
    c = cos(pose[2])
    s = sin(pose[2])
    yaw_rate = velocity[2]
    # R^T v: the velocity of B's origin in the body frame. The center of mass has u + w z × c.
    body_x = c * velocity[0] + s * velocity[1]
    body_y = -s * velocity[0] + c * velocity[1]
    return State(
        x=pose[0],
        y=pose[1],
        theta=pose[2],
        c=c,
        s=s,
        com_vx=body_x - yaw_rate * com_y,
        com_vy=body_y + yaw_rate * com_x,
        yaw_rate=yaw_rate,
        body_x=body_x,
        body_y=body_y,
    )


@kernel(allocates=False, inlined=True)
def advance_state(state, forward_x, forward_y, dt, com_vx, com_vy, yaw_rate, com_x, com_y):
    """Moves the state on by a displacement in W, m, and gives it the velocity after the step."""
    theta = state.theta + yaw_rate * dt
    return State(
        x=state.x + forward_x,
        y=state.y + forward_y,
        theta=theta,
        c=cos(theta),
        s=sin(theta),
        com_vx=com_vx,
        com_vy=com_vy,
        yaw_rate=yaw_rate,
        body_x=com_vx + yaw_rate * com_y,
        body_y=com_vy - yaw_rate * com_x,
    )


@kernel(allocates=False, inlined=True)
def make_step_start(state, load, t, dt, h):
    """Looks at the body, the pusher and the force when step t begins."""
    c = state.c
    s = state.s
    yaw_rate = state.yaw_rate

    # The frame of the step is the body's, turned on by a = h w.
    a = h * yaw_rate
    ca, sa = calc_turn(a)
    step_c = c * ca - s * sa
    step_s = s * ca + c * sa
    tip = load.tip
    wrench = load.wrench

    # The disc moves evenly through the step, seen from W and from the body.
    world_vx = (tip[t + 1, 0] - tip[t, 0]) / dt
    world_vy = (tip[t + 1, 1] - tip[t, 1]) / dt
    vx = c * world_vx + s * world_vy
    vy = -s * world_vx + c * world_vy
    tx = c * (tip[t, 0] - state.x) + s * (tip[t, 1] - state.y)
    ty = -s * (tip[t, 0] - state.x) + c * (tip[t, 1] - state.y)

    return StepStart(
        dt=dt,
        h=h,
        a=a,
        c=c,
        s=s,
        step_c=step_c,
        step_s=step_s,
        yaw_rate=yaw_rate,
        expected_vx=ca * state.com_vx + sa * state.com_vy,
        expected_vy=-sa * state.com_vx + ca * state.com_vy,
        tx=tx,
        ty=ty,
        vx=vx,
        vy=vy,
        vpx=ca * vx + sa * vy,
        vpy=-sa * vx + ca * vy,
        # v_p - u - w z × t: the disc's motion seen from the body that moves as it did.
        rx=vx - state.body_x + yaw_rate * ty,
        ry=vy - state.body_y - yaw_rate * tx,
        world_vx=world_vx,
        world_vy=world_vy,
        ray_x=tip[t, 0] - tip[0, 0],
        ray_y=tip[t, 1] - tip[0, 1],
        fx=step_c * wrench[t, 0] + step_s * wrench[t, 1],
        fy=-step_s * wrench[t, 0] + step_c * wrench[t, 1],
        couple=wrench[t, 2],
    )
