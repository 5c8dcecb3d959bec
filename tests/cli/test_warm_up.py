"""`gridpush warm-up`, whatever becomes of the second process."""

import json
import subprocess
import sys
import time
from pathlib import Path

import pytest

from gridpush_drake.cli.shell import kernels, warm_up
from gridpush_drake.dynamics.kernels import compiled
from gridpush_drake.dynamics.kernels.rollout import rollout

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("kind", ["is_compiled", "is_rare_compiled"])
def test_says_where_the_kernels_are_kept_and_whether_they_were_compiled(
    gridpush, monkeypatch, kind
):
    for name in ("is_compiled", "is_rare_compiled"):
        monkeypatch.setattr(warm_up, name, lambda: True)
    monkeypatch.setattr(warm_up, "compile_rare", lambda: None)
    found = json.loads(gridpush("warm-up", "--json").out)
    assert found["compiled"] is False
    assert "kernels-" in found["folder"]
    assert gridpush("warm-up").out.startswith(
        "The simulation was compiled before; the compiled code is"
    )
    monkeypatch.setattr(warm_up, kind, lambda: False)
    assert json.loads(gridpush("warm-up", "--json").out)["compiled"] is True


def test_other_processes_compile_while_this_one_does_something_else(monkeypatch, tmp_path):
    """Both processes run along with the body, are waited for by nothing else, and end with it."""
    began = [tmp_path / "rest", tmp_path / "apart"]
    code = "import pathlib, time; pathlib.Path({!r}).touch(); time.sleep(60)"
    monkeypatch.setattr(kernels, "is_compiled", lambda: False)
    monkeypatch.setattr(kernels, "compile_all", lambda: pytest.fail("compiled at once"))
    monkeypatch.setattr(kernels, "THIRD_PROCESS_CODE", code.format(str(began[0])))
    monkeypatch.setattr(kernels, "SECOND_PROCESS_CODE", code.format(str(began[1])))
    begin = time.monotonic()
    with kernels.compiling_meanwhile():
        while not all(each.exists() for each in began):
            time.sleep(0.01)
        others = compiled._OTHERS
        assert others.at_work()
        assert Path(rollout.py_func.__code__.co_filename) in others.sources
    assert not others.at_work()
    assert compiled._OTHERS is None
    assert time.monotonic() - begin < 30


STEER = """
import numpy as np
from gridpush_drake.dynamics.pusher import PusherShape
from gridpush_drake.identification.model import Model
from gridpush_drake.planning.feedback import PushFollower
from gridpush_drake.planning.pushed_object import FeedbackFinger
from tests.helpers.made_identifications import make_block

model = Model(make_block(12))
plate = PusherShape.plate(0.04, 0.016, 0.003)
finger = FeedbackFinger(radius=plate.radius, shape=plate)
follower = PushFollower(model.obj, model.params, np.array([0.1, 0.0, 0.2]), finger)
follower.add_tip(0.0, np.array([-0.1, 0.0, 0.0]))
follower.add_pose(0.0, np.zeros(3))
print(follower.decide(0.0, np.array([-0.1, 0.0, 0.0])).status.value)
"""


def test_afterwards_no_process_compiles_what_only_some_commands_need():
    kernels.compile_rare()
    assert kernels.is_rare_compiled()
    done = subprocess.run(
        [sys.executable, "-c", STEER], capture_output=True, text=True, check=True, cwd=ROOT
    )
    assert (done.stdout, done.stderr) == ("pushing\n", "")


def test_what_is_compiled_starts_no_other_process(monkeypatch):
    monkeypatch.setattr(kernels.subprocess, "Popen", lambda *_, **__: pytest.fail("started"))
    with kernels.compiling_meanwhile():
        assert not compiled._OTHERS.at_work()


@pytest.mark.parametrize("code", ["raise SystemExit(3)", "import time; time.sleep(60)", "1 +"])
def test_a_second_process_that_fails_or_hangs_is_not_needed(gridpush, monkeypatch, code):
    monkeypatch.setattr(kernels, "is_compiled", lambda *_: False)
    monkeypatch.setattr(kernels, "SECOND_PROCESS_CODE", code)
    monkeypatch.setattr(kernels, "SCENES_CODE", code)
    monkeypatch.setattr(kernels, "MAX_COMPILE_WAIT", 0.1)
    outcome = gridpush("warm-up")
    assert (outcome.code, outcome.err) == (0, "")
