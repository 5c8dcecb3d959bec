"""A push in MuJoCo of an object whose cells are boxes, for the comparison of speeds.

It is the plainest form that such an object can have there. Bodies that bear their load otherwise,
and serve as the truth that learning is tested with, are in `bench.truth`.
"""

from collections.abc import Callable

import numpy as np

from gridpush_drake.dynamics.push import Push
from gridpush_drake.geometry.se2 import calc_yaw
from gridpush_drake.identification.model import Model

MUJOCO_TIME_STEP = 0.002
"""Time step of MuJoCo, its default, s."""

PUSHER_GAIN = 1e4
"""Gain of the position servo that drives the pusher in MuJoCo, N/m."""

PUSHER_MASS = 1.0
"""Mass of the pusher in MuJoCo, kg."""


def make_mujoco_push(model: Model, push: Push) -> Callable[[], np.ndarray]:
    """Prepares a push in MuJoCo: the cells are boxes of a free body, pushed by a sphere.

    Returns:
        A function that runs the push, straight and at constant velocity, from the beginning, and
        returns the final pose (3,), m and rad.

    Raises:
        ImportError: MuJoCo is not installed (`pip install '.[bench]'`).
    """
    import mujoco

    model = mujoco.MjModel.from_xml_string(_describe_scene(model, push))
    data = mujoco.MjData(model)
    steps = round(push.duration / MUJOCO_TIME_STEP)
    targets = push.tip_at(np.arange(1, steps + 1) * MUJOCO_TIME_STEP) - push.start
    velocity = np.asarray(push.velocity)

    def run() -> np.ndarray:
        mujoco.mj_resetData(model, data)
        data.qvel[-2:] = velocity
        for target in targets:
            data.ctrl[:] = target
            mujoco.mj_step(model, data)
        return np.array([*data.qpos[:2], calc_yaw(*data.qpos[3:7])])

    return run


def _describe_scene(model: Model, push: Push) -> str:
    """Describes the scene in MJCF.

    A contact with the plane has the cell's friction, and one with the pusher has the pusher's.
    """
    obj = model.obj
    params = model.params
    half = obj.cell_size / 2
    boxes = "\n".join(
        f'<geom type="box" pos="{x} {y} 0" size="{half} {half} {half}" mass="{mass}" '
        f'conaffinity="3" friction="{mu} 0.005 0.0001"/>'
        for (x, y), mass, mu in zip(obj.p_BC, params.mass, params.friction, strict=True)
    )
    damping = 2 * np.sqrt(PUSHER_GAIN * PUSHER_MASS)
    return f"""
<mujoco>
  <option timestep="{MUJOCO_TIME_STEP}"/>
  <worldbody>
    <geom type="plane" size="2 2 0.1" friction="0 0.005 0.0001"/>
    <body pos="0 0 {half}"><freejoint/>{boxes}</body>
    <body pos="{push.start[0]} {push.start[1]} {half}" gravcomp="1">
      <joint name="x" type="slide" axis="1 0 0"/><joint name="y" type="slide" axis="0 1 0"/>
      <geom type="sphere" size="{push.radius}" mass="{PUSHER_MASS}" contype="2" conaffinity="0"
            priority="1" friction="{params.contact_friction} 0.005 0.0001"/>
    </body>
  </worldbody>
  <actuator>
    <position joint="x" kp="{PUSHER_GAIN}" kv="{damping}"/>
    <position joint="y" kp="{PUSHER_GAIN}" kv="{damping}"/>
  </actuator>
</mujoco>"""
