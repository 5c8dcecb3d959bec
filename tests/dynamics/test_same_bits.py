"""What is calculated does not depend on who compiled it, or on what was loaded before."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

PARTS = """
import hashlib
import sys

import numpy as np

from gridpush_drake.dynamics.push import Push
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import find_shipped_object
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.contact import optimize_contact
from gridpush_drake.planning.pregrasp.stability import calc_stability_margin
from gridpush_drake.planning.plausible_masses import PlausibleMassSet
from gridpush_drake.planning.support_surface import SupportSurface

obj = GridObject.from_yaml(find_shipped_object("claw_hammer"))


def draw(rng):
    mass = rng.dirichlet(np.ones(obj.n))
    return CellParameters(mass=mass, friction=np.full(obj.n, 0.35), push_height=0.01)


def simulate_pushes(rng):
    for regime in ("quasi_static", "inertial"):
        for _ in range(6):
            place, angle = rng.uniform(0, obj.edges.perimeter), rng.uniform(-0.5, 0.5)
            push = Push.on_outline(obj, place, angle, 0.05, radius=0.01, speed=0.05)
            motion = Model(obj, draw(rng)).simulate(push, gradients=True, regime=regime)
            yield motion.poses
            yield motion.jacobian.mass


def choose_pushes(rng):
    for _ in range(3):
        x, y, turn = 0.05 * rng.normal(size=3)
        for planned in optimize_contact(Model(obj, draw(rng)), [0, 0, 0], [x, y, 10 * turn]).candidates:
            yield np.array([*planned.push.start, *planned.push.velocity, planned.push.duration])


def judge_stability(rng):
    for x in (0.0, 0.03, 0.06):
        masses = PlausibleMassSet.of_masses(Model(obj, draw(rng)))
        yield np.array(calc_stability_margin(masses, [x, 0, 0], SupportSurface.round([0, 0], 0.1)))


for name in sys.argv[1:]:
    found = hashlib.sha256()
    for array in globals()[name](np.random.default_rng(0)):
        found.update(array.tobytes())
    print(name, found.hexdigest())
"""

NAMES = ["simulate_pushes", "choose_pushes", "judge_stability"]


@pytest.mark.slow
def test_a_process_that_compiles_and_one_that_loads_in_another_order_calculate_the_same_bits(
    tmp_path,
):
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    compiled, loaded = (
        subprocess.run(
            [sys.executable, "-c", PARTS, *names], check=True, capture_output=True, text=True,
            env=environment, cwd=Path(__file__).parents[2],
        )
        for names in (NAMES, NAMES[::-1])
    )  # fmt: skip
    assert "compiling kernels" in compiled.stderr and loaded.stderr == ""
    lines = compiled.stdout.splitlines()
    assert len(lines) == len(NAMES) and sorted(loaded.stdout.splitlines()) == sorted(lines)
