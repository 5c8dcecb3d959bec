import gc
import socket
from threading import Thread
from types import SimpleNamespace
from urllib.request import urlopen
from weakref import ref

import pytest
from pydrake.geometry import Box, MeshcatAnimation
from pydrake.math import RigidTransform

from gridpush_drake.display.server import (
    PublishOnce,
    StartMeshcatServer,
    looks_like_recording,
    write_recording,
)
from gridpush_drake.errors import OutputError, StationError


def test_serves_its_page():
    meshcat = StartMeshcatServer(0)
    with urlopen(meshcat.web_url()) as page:
        assert b"Drake MeshCat" in page.read()


@pytest.mark.parametrize("host", ["localhost", "*"])
def test_names_a_port_that_is_in_use(host):
    first = StartMeshcatServer(0, host)
    with pytest.raises(StationError, match=f"port {first.port()} .*in use.*another port"):
        StartMeshcatServer(first.port(), host)


def test_names_a_port_that_another_program_uses():
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        with pytest.raises(StationError, match=f"port {port} .*in use"):
            StartMeshcatServer(port)


@pytest.mark.parametrize("port", [-1, 80, 65536])
def test_refuses_a_port_out_of_range(port):
    with pytest.raises(StationError, match=f"port is {port}; expected one from 1024 to 65535"):
        StartMeshcatServer(port)


def test_refuses_a_host_that_is_not_this_machine():
    with pytest.raises(StationError, match=r"'192\.0\.2\.1'"):
        StartMeshcatServer(0, "192.0.2.1")


def test_is_destroyed_by_the_thread_that_started_it_whichever_collects_the_garbage():
    """Elsewhere Drake would end the process."""
    garbage = SimpleNamespace(meshcat=StartMeshcatServer(0))
    garbage.itself, kept = garbage, ref(garbage.meshcat)
    del garbage
    collector = Thread(target=gc.collect)
    collector.start()
    collector.join()
    assert kept() is not None
    gc.collect()
    assert kept() is None


@pytest.fixture
def recorded():
    """A box that moves for a second, with a layer that a recording is not for."""
    meshcat = StartMeshcatServer(0)
    for path in ("box", "/drake/proximity/box"):
        meshcat.SetObject(path, Box(0.1, 0.1, 0.1))
    meshcat.StartRecording(10.0)
    for time in (0.0, 1.0):
        meshcat.SetTransform("box", RigidTransform([time, 0.0, 0.0]), time)
    return meshcat


def test_writes_a_recording_without_the_layers_that_explain(recorded, tmp_path):
    path = tmp_path / "recording.html"
    write_recording(recorded, path)
    assert looks_like_recording(path)
    assert recorded.HasPath("box")
    assert not recorded.HasPath("/drake/proximity")
    with pytest.raises(OutputError, match="--force"):
        write_recording(recorded, path)
    write_recording(recorded, path, force=True)


def test_a_recording_plays_once(recorded):
    PublishOnce(recorded)
    recording = recorded.get_mutable_recording()
    assert recording.loop_mode() == MeshcatAnimation.LoopMode.kLoopOnce
    assert recording.clamp_when_finished()


def test_tells_a_recording_from_other_files(tmp_path):
    other = tmp_path / "other.html"
    other.write_text("<html><title>Report</title></html>")
    assert not looks_like_recording(other)
    assert not looks_like_recording(tmp_path / "none.html")
    assert not looks_like_recording(tmp_path)
