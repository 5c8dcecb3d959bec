"""A motion that is cut into single steps is the motion, jams included."""

import numpy as np
import pytest

from gridpush_drake.dynamics.kernel_call import run_kernel
from gridpush_drake.dynamics.kernels.inputs import Load, Steps
from gridpush_drake.dynamics.kernels.step_memory import MEMORY_SIZE, make_memory
from gridpush_drake.dynamics.physics import Physics
from gridpush_drake.dynamics.push import Push
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.parameters import CellParameters
from tests.helpers.shapes import make_shape

DT = 0.01
PHYSICS = [
    Physics(regime="inertial"),
    Physics(regime="quasi_static"),
    Physics(friction_law="lagged", regime="inertial"),
]


def run(obj, params, q, nu, tip, physics, memory) -> Steps:
    steps = len(tip) - 1
    load = Load(tip, 1.0, 0.012, np.zeros((steps, 3)), np.zeros(2))
    row_of_step = np.full(steps + 1, -1)
    return run_kernel(
        Model(obj, params, physics),
        pose=q,
        velocity=nu,
        dts=np.full(steps, DT),
        load=load,
        row_of_step=row_of_step,
        J=np.empty((0, 3, 0)),
        memory=memory,
    )


@pytest.mark.parametrize("physics", PHYSICS)
def test_cut_into_steps_it_moves_the_same(physics):
    """Into the notch of a block, where the disc touches both flanks and jams."""
    obj = make_shape("notched_block", 60)
    params = CellParameters(np.where(obj.p_BC[:, 1] > 0, 0.03, 0.01), np.full(obj.n, 0.4), 0.6)
    push = Push((-0.07, 0.004), (0.1, 0.0), 1.0, 0.012)
    tip = push.tip_at(np.arange(101) * DT)
    whole = run(obj, params, np.zeros(3), np.zeros(3), tip, physics, None)
    if physics.friction_law != "lagged":
        assert (whole.modes > 0).all(axis=1).any(), "it must touch twice"
    q, nu, memory = np.zeros(3), np.zeros(3), make_memory()
    iterations = []
    for t in range(100):
        step = run(obj, params, q, nu, tip[t : t + 2], physics, memory)
        q, nu = step.poses[1], step.velocities[1]
        iterations.append(step.statuses[0, 1])
        np.testing.assert_allclose(q, whole.poses[t + 1], rtol=0, atol=1e-12)
    assert memory.shape == (MEMORY_SIZE,) and memory.any()
    assert abs(sum(iterations) - whole.statuses[:, 1].sum()) <= 3
