"""A friction law of the user's own, as `docs/extending.md` writes one, in everything that takes physics."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[2] / "docs" / "extending.md"

BEGIN = """
import numpy as np
from gridpush_drake import CellParameters, GridObject, Model, ObservedPush, Push, PushLog
from gridpush_drake import Physics
from gridpush_drake.identification.model_check import calc_training_errors
import ribbed_friction

obj = GridObject.from_outline([[-0.05, -0.03], [0.05, -0.03], [0.05, 0.03], [-0.05, 0.03]], max_cells=15)
mass = np.where(obj.p_BC[:, 0] > 0.0, 0.06, 0.02)
truth = CellParameters(mass, np.full(obj.n, 0.35), 0.3)
goal = [0.03, 0.01, 0.1]


def see(i):
    push = Push.on_outline(
        obj, 0.03 + 0.057 * i, 0.2 * (-1) ** i, 0.04, radius=0.008, speed=0.02, clearance=1e-4
    )
    motion = Model(obj, truth, Physics(friction_law="ribbed")).simulate(push)
    return ObservedPush(f"push_{i}", push, np.zeros(3), [push.duration], motion.poses[-1:])


log = PushLog(tuple(see(i) for i in range(6)))
push = log[0].push
"""

END = """
# the law is what was used, and not the isotropic one
isotropic = Model(obj, truth).simulate(push)
assert motion.physics == Physics("ribbed", "quasi_static")
assert np.abs(motion.final_pose - isotropic.final_pose).max() > 1e-3

# learned: the truth explains the pushes, and so does the model, better than with the other law
wrong = identify(Model(obj), log)
assert model.physics == motion.physics
_, error = calc_training_errors(model, log)
_, wrong_error = calc_training_errors(wrong, log)
assert error < 0.5 * wrong_error, (error, wrong_error)
heavy = obj.p_BC[:, 0] > 0.0
shares = model.params.relative_friction()
ratio = shares[heavy].sum() / shares[~heavy].sum()
assert 1.3 < ratio < 2.7, ratio  # 2 in truth, 2/3 of an even object

# planned: the push ends where the law takes it
assert plan.status == "ok"
end = model.simulate(plan.push.push).final_pose
assert np.abs(end - plan.push.pose).max() < 1e-9

# in a Diagram, step by step as the core does it
from pydrake.systems.analysis import Simulator

times = np.arange(51) * system.dt
tip = push.tip_at(times)
world = Simulator(system)
context = world.get_mutable_context()
port = system.GetInputPort("pusher_state")
for t in range(50):
    port.FixValue(context, np.concatenate([tip[t], (tip[t + 1] - tip[t]) / system.dt]))
    world.AdvanceTo((t + 1) * system.dt)
stepped = system.GetOutputPort("pose").Eval(context)
same_push = Push.along(times, tip, system.pusher_radius)
core = model.simulate(same_push, times=times)
assert system.physics == model.physics
np.testing.assert_allclose(stepped, core.final_pose, atol=1e-9)

# several objects: one far from the other moves as by itself, and so does its Jacobian
apart = [[0.0, 0.0, 0.0], [0.4, 0.3, 1.0]]
both = Model([obj, obj], [truth, truth], ribbed).simulate(push, apart, gradients=True)
alone = Model(obj, truth, ribbed).simulate(push, gradients=True)
np.testing.assert_allclose(both.poses[:, 0], alone.poses, rtol=0, atol=1e-9)
np.testing.assert_array_equal(both.poses[:, 1] - apart[1], 0.0)
slopes = alone.jacobian.mass
np.testing.assert_allclose(
    both.jacobian.mass[:, 0, :, : obj.n], slopes, rtol=1e-6, atol=1e-7 * np.abs(slopes).max()
)

# objects that push each other: exact gradients, and learned from pushes of both
from tests.dynamics.scene.test_sensitivity import STEPS, check_scene
from tests.helpers.scene_cases import SceneCase, make_row
from tests.helpers.shapes import SHAPES

for seed in (2, 3):
    scene, through = make_row(seed, np.random.default_rng(seed).permutation(list(SHAPES))[:2], cells=8)
    case = SceneCase(scene, through, STEPS, law="ribbed")
    between = case.result.contact_bodies[:, :, 1] >= 0
    assert case.result.status == "ok" and (case.result.modes[between] != 0).any()
    assert check_scene(case, seed) == 0


def see_both(i):
    one = Push((-0.062, 0.02 * (-1) ** i - 0.004 * i), (0.02, 0.0), 2.5, 0.008)
    begin = np.array([[0.0, 0.0, 0.0], [0.102, 0.01, 0.0]])
    if i % 2:
        begin[1, :2] = (0.2, 0.3)
    moved = Model([obj, obj], [truth, truth], ribbed).simulate(one, begin)
    return ObservedPush(f"push_{i}", one, begin, [one.duration], moved.poses[-1:])


seen = PushLog(tuple(see_both(i) for i in range(4)), names=("one", "other"))
learned = {law: identify(Model([obj, obj], physics=Physics(law)), seen) for law in ("ribbed", "isotropic")}
assert learned["ribbed"].physics.friction_law == "ribbed"
assert learned["ribbed"].errors.mean() < 0.5 * learned["isotropic"].errors.mean()

# written and read, with the same bits
assert same.physics == model.physics
np.testing.assert_array_equal(same.params.mass, model.params.mass)
print("done")
"""


@pytest.mark.slow
def test_it_goes_wherever_physics_go(tmp_path):
    """In a process of its own, with a cache of its own: the law is registered for the whole process."""
    blocks = re.findall(r"```\{code-block\} python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    law, use = blocks[:2]
    assert law.rstrip().endswith("register_friction_law(RIBBED)")
    (tmp_path / "ribbed_friction.py").write_text(law)
    (tmp_path / "try_it.py").write_text(BEGIN + use + END)
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    environment["PYTHONPATH"] = str(PAGE.parents[1])
    run = subprocess.run(
        [sys.executable, "try_it.py"],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0 and run.stdout.endswith("done\n"), run.stderr
    # without the law, reading its model says what is missing
    read = "from gridpush_drake import read_model; read_model('model.yaml')"
    run = subprocess.run(
        [sys.executable, "-c", read],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert "model.yaml: friction_law is 'ribbed'; expected one of" in run.stderr
