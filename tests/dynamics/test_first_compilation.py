"""No process calculates with what it compiled: the first on a machine gets the same bits as all later ones."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from gridpush_drake.dynamics import first_compilation

PUSHES = """
import hashlib
import numpy as np
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import find_shipped_object
from gridpush_drake.objects.parameters import CellParameters

obj = GridObject.from_yaml(find_shipped_object("claw_hammer"))
rng = np.random.default_rng(0)
found = hashlib.sha256()
for regime in ("quasi_static", "inertial"):
    for _ in range(6):
        mass = rng.dirichlet(np.ones(obj.n))
        params = CellParameters(mass=mass, friction=np.full(obj.n, 0.35), push_height=0.01)
        place, angle = rng.uniform(0, obj.edges.perimeter), rng.uniform(-0.5, 0.5)
        push = Push.on_outline(obj, place, angle, 0.05, radius=0.01, speed=0.05)
        motion = simulate(obj, params, push, gradients=True, regime=regime)
        found.update(motion.poses.tobytes())
        found.update(motion.jacobian.mass.tobytes())
print(found.hexdigest())
"""


@pytest.fixture
def empty_cache(monkeypatch, tmp_path):
    """This process, before it has looked for the rollouts, with nothing in the cache."""
    monkeypatch.delenv(first_compilation.COMPILES, raising=False)
    monkeypatch.setattr(first_compilation, "is_compiled", lambda: False)
    first_compilation.have_rollouts_compiled.cache_clear()
    yield tmp_path
    first_compilation.have_rollouts_compiled.cache_clear()


def test_another_process_compiles_and_is_asked_once(empty_cache, monkeypatch):
    trace = empty_cache / "trace"
    code = f"import os; open({str(trace)!r}, 'a').write(os.environ['GRIDPUSH_COMPILES'] + ' ')"
    monkeypatch.setattr(first_compilation, "COMPILE", code)
    first_compilation.have_rollouts_compiled()
    first_compilation.have_rollouts_compiled()
    assert trace.read_text() == "1 "


def test_the_process_that_compiles_asks_no_other(empty_cache, monkeypatch):
    monkeypatch.setenv(first_compilation.COMPILES, "1")
    monkeypatch.setattr(first_compilation.subprocess, "run", pytest.fail)
    first_compilation.have_rollouts_compiled()


@pytest.mark.parametrize("code", ["raise SystemExit(3)", "1 +", "import os; os.abort()"])
def test_a_process_that_fails_is_not_needed(empty_cache, monkeypatch, capfd, code):
    monkeypatch.setattr(first_compilation, "COMPILE", code)
    first_compilation.have_rollouts_compiled()


@pytest.mark.slow
def test_the_first_process_on_a_machine_calculates_the_same_bits_as_the_next(tmp_path):
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    found = [
        subprocess.run(
            [sys.executable, "-c", PUSHES], check=True, capture_output=True, text=True,
            env=environment, cwd=Path(__file__).parents[2],
        ).stdout
        for _ in range(2)
    ]  # fmt: skip
    assert found[0] == found[1] != ""
