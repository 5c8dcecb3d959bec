"""The same push in MuJoCo: the object's cells as boxes of one free body on a plane, pushed by a sphere."""

from collections.abc import Callable

import numpy as np

from gridpush_drake.dynamics.push import Push
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters

TIME_STEP = 0.002
"""MuJoCo's default, s."""

PUSHER_GAIN = 1e4
"""Of the position servo that drives the pusher, N/m."""

PUSHER_MASS = 1.0
"""kg."""


def make_mujoco_push(obj: GridObject, params: CellParameters, push: Push) -> Callable[[], np.ndarray]:
    """Prepares the push.

    Args:
        obj: the object; each cell becomes a cube.
        params: masses and frictions of its cells.
        push: straight, at constant velocity.

    Returns:
        What runs the whole push once from the beginning and returns the final pose (x, y, theta).

    Raises:
        ImportError: MuJoCo is not installed (`pip install 'gridpush-drake[bench]'`).
    """
    import mujoco

    model = mujoco.MjModel.from_xml_string(_describe_scene(obj, params, push))
    data = mujoco.MjData(model)
    steps = round(push.duration / TIME_STEP)
    targets = push.tip_at(np.arange(1, steps + 1) * TIME_STEP) - push.start
    velocity = np.asarray(push.velocity)

    def run() -> np.ndarray:
        mujoco.mj_resetData(model, data)
        data.qvel[-2:] = velocity
        for target in targets:
            data.ctrl[:] = target
            mujoco.mj_step(model, data)
        w, x, y, z = data.qpos[3:7]
        return np.array([*data.qpos[:2], np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))])

    return run


def _describe_scene(obj: GridObject, params: CellParameters, push: Push) -> str:
    """The scene in MJCF; a contact with the plane has the cell's friction, one with the pusher the pusher's."""
    half = obj.cell_size / 2
    boxes = "\n".join(
        f'<geom type="box" pos="{x} {y} 0" size="{half} {half} {half}" mass="{mass}" conaffinity="3" '
        f'friction="{mu} 0.005 0.0001"/>'
        for (x, y), mass, mu in zip(obj.p_BC, params.mass, params.friction, strict=True)
    )
    damping = 2 * np.sqrt(PUSHER_GAIN * PUSHER_MASS)
    return f"""
<mujoco>
  <option timestep="{TIME_STEP}"/>
  <worldbody>
    <geom type="plane" size="2 2 0.1" friction="0 0.005 0.0001"/>
    <body pos="0 0 {half}"><freejoint/>{boxes}</body>
    <body pos="{push.start[0]} {push.start[1]} {half}" gravcomp="1">
      <joint name="x" type="slide" axis="1 0 0"/><joint name="y" type="slide" axis="0 1 0"/>
      <geom type="sphere" size="{push.radius}" mass="{PUSHER_MASS}" contype="2" conaffinity="0" priority="1"
            friction="{params.contact_friction} 0.005 0.0001"/>
    </body>
  </worldbody>
  <actuator>
    <position joint="x" kp="{PUSHER_GAIN}" kv="{damping}"/><position joint="y" kp="{PUSHER_GAIN}" kv="{damping}"/>
  </actuator>
</mujoco>"""
