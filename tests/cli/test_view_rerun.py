"""`gridpush view --rerun`: models, push logs and recorded runs for the Rerun viewer."""

import json
import os
import resource
import signal
import socket
import subprocess
import sys
import time

import numpy as np
import pytest

from gridpush_drake.display.rerun_scene import RerunScene
from tests.helpers.rerun_files import print_rerun
from tests.helpers.scene_cases import PLATE
from tests.helpers.two_processes import ENTER, find_obstacle

VIEWER_PORT = 9876
"""Port on which Rerun's viewer listens unless it is told otherwise."""

PATIENCE = 120.0
"""Longest time for anything, s."""


def test_refuses(refuses, pushes, model, tmp_path):
    rrd = tmp_path / "out.rrd"
    refuses("view", model, "--rerun", tmp_path / "out.txt", says=["--rerun", ".rrd", "live"])
    refuses("view", model, "--rerun", rrd, "--height", 0.1, says=["--height", "no --rerun"])
    refuses("view", model, "--rerun", rrd, "--out", "a.html", says=["--out", "no --rerun"])
    refuses("view", tmp_path / "a.html", "--rerun", rrd, says=["--rerun", "is a page already"])
    refuses("view", pushes, "--push", "push_99", "--rerun", rrd, says=["--push", "push_99"])
    run = tmp_path / "run.mcap"
    refuses("view", run, says=["--rerun: missing", "Foxglove"])
    refuses("view", run, "--rerun", rrd, says=[run, "there is no such file"])
    assert not list(tmp_path.glob("*.rrd"))


def test_refuses_a_damaged_recording(refuses, tmp_path):
    pytest.importorskip("rosbags", reason="rosbags is not installed")
    run = tmp_path / "run.mcap"
    run.write_bytes(b"\x89MCAP0 but no more")
    says = [f"{run}: cannot be read: ", "; expected a recording (.mcap) that gridpush wrote"]
    refuses("view", run, "--rerun", tmp_path / "out.rrd", says=says)
    assert not list(tmp_path.glob("*.rrd"))


def test_shows_a_model(gridpush, model, tmp_path):
    pytest.importorskip("rerun", reason="rerun-sdk is not installed")
    file = tmp_path / "model.rrd"
    done = gridpush("view", model, "--rerun", file, "--json")
    assert done.code == 0, done.err
    assert json.loads(done.out)["written"] == [str(file)]
    assert list(tmp_path.glob("*.rrd")) == [file]
    printed = print_rerun(file)
    for entity in ("/world/object/cells", "/world/object/center_of_mass", "/known/pushes"):
        assert entity in printed, entity
    again = gridpush("view", model, "--rerun", file)
    assert (again.code, "--force" in again.err) == (2, True)
    assert gridpush("view", model, "--rerun", file, "--force").code == 0


def test_a_full_disk_leaves_no_file(refuses, model, tmp_path):
    pytest.importorskip("rerun", reason="rerun-sdk is not installed")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    file = tmp_path / "model.rrd"
    resource.setrlimit(resource.RLIMIT_FSIZE, (1024, hard))
    try:
        refuses("view", model, "--rerun", file, says=[f"{file}: cannot be written: File too large"])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_shows_pushes_beside_their_predictions(gridpush, pushes, model, tmp_path):
    pytest.importorskip("rerun", reason="rerun-sdk is not installed")
    file = tmp_path / "pushes.rrd"
    done = gridpush("view", pushes, "--rerun", file)
    assert done.code == 0, done.err
    assert "5 pushes" in done.out and "Mean cell error" in done.out
    printed = print_rerun(file)
    for entity in ("/world/predicted/outline", "/predicted/cell_error_mm", "/world/tip"):
        assert entity in printed, entity

    # A pusher that is no ball is shown by its edge.
    scene = RerunScene(str(tmp_path / "plate.rrd"))
    scene.show_tip(np.zeros(3), PLATE.radius, PLATE, 0.3)
    scene.finish()
    assert "LineStrips3D:strips" in print_rerun(tmp_path / "plate.rrd")


@pytest.mark.slow
def test_shows_it_live(pushes, model, tmp_path):
    """In a viewer that is open: here Rerun's own receiver, which writes down what comes."""
    pytest.importorskip("rerun", reason="rerun-sdk is not installed")
    obstacle = find_obstacle()
    if obstacle:
        pytest.skip(obstacle)
    # In a network namespace, so that the viewer's port is free whatever else runs
    command = ["unshare", "-rn", "sh", "-c", ENTER, "sh", sys.executable, __file__]
    assert model.parent == pushes.parent
    told = [str(pushes), str(tmp_path / "come.rrd")]
    done = subprocess.run(
        [*command, *told], capture_output=True, text=True, timeout=PATIENCE, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "It is shown in the Rerun viewer." in done.stdout
    printed = print_rerun(tmp_path / "come.rrd")
    for entity in ("/world/object", "/world/predicted", "/world/tip", "/world/push"):
        assert entity in printed, entity


def receive(pushes, path):
    """Runs the command while Rerun's receiver writes to a file; in a process of its own."""
    receiver = subprocess.Popen(
        [sys.executable, "-m", "rerun", "--save", path],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        wait_for(is_listening)
        words = [sys.executable, "-m", "gridpush_drake.cli.main", "view", pushes]
        subprocess.run([*words, "--rerun", "live"], check=True, timeout=PATIENCE)
        # The receiver writes down what has come a moment later
        wait_for(lambda: "/world/push" in print_rerun(path))
    finally:
        os.killpg(receiver.pid, signal.SIGKILL)
        receiver.wait()


def is_listening():
    """Whether somebody listens on the port of Rerun's viewer."""
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", VIEWER_PORT)) == 0


def wait_for(condition):
    """Waits until a condition holds."""
    end = time.monotonic() + PATIENCE / 2
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.1)


if __name__ == "__main__":
    receive(*sys.argv[1:])
