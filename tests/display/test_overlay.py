"""What stands beside a recording, as a real browser draws it."""

import subprocess
import tempfile

import numpy as np
import pytest
from pydrake.geometry import Box
from pydrake.math import RigidTransform

from gridpush_drake.display.overlay import (
    ColorScale,
    Mark,
    Overlay,
    Phase,
    make_overlay_html,
)
from gridpush_drake.display.server import (
    StartMeshcatServer,
    looks_like_recording,
    write_recording,
)
from tests.helpers.chromium import (
    FLAGS,
    VIRTUAL_TIME,
    freeze_recording,
    require_chromium,
    take_picture,
)

RED, BLUE = "#ff0000", "#0000ff"

OVERLAY = Overlay(
    ColorScale("mass, g", (RED, BLUE), ((0.0, "1"), (1.0, "2"))),
    (Mark("#00ff00", "a <thing>", "line"),),
    (
        Phase(0.0, "Looking"),
        Phase(1.5, "Push 1", "Because </script> it must."),
        Phase(2.05, "Done"),
    ),
)


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """A box that moves for two seconds."""
    meshcat = StartMeshcatServer(0)
    meshcat.SetObject("box", Box(0.1, 0.1, 0.1))
    meshcat.StartRecording(10.0)
    for time in (0.0, 2.0):
        meshcat.SetTransform("box", RigidTransform([time, 0.0, 0.0]), time)
    path = tmp_path_factory.mktemp("overlay") / "recording.html"
    write_recording(meshcat, path, overlay=OVERLAY)
    return path


def read_page(page):
    """What the page holds when its scripts have run, as HTML."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        command = [
            require_chromium(),
            *FLAGS,
            f"--user-data-dir={folder}",
            f"--virtual-time-budget={VIRTUAL_TIME}",
        ]
        command += ["--dump-dom", page.resolve().as_uri()]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout


@pytest.mark.parametrize(
    ("moment", "says"),
    [
        (0.5, "<b>Looking</b><span></span><small>0.5 s</small>"),
        (2.0, "<b>Done</b><span></span><small>2.0 s</small>"),
        (1.8, "<b>Push 1</b><span>Because &lt;/script&gt; it must.</span><small>1.8 s</small>"),
    ],
)
def test_tells_the_phase_of_the_moment(recording, tmp_path, moment, says):
    assert says in read_page(freeze_recording(recording, moment, tmp_path / "still.html"))


def test_shows_the_color_scale_and_the_legend(recording, tmp_path):
    picture = take_picture(recording, tmp_path / "picture.png").astype(int)
    found = {}
    for name, color in (("red", (255, 0, 0)), ("blue", (0, 0, 255)), ("green", (0, 255, 0))):
        rows, columns = np.nonzero(np.abs(picture - color).sum(axis=-1) < 60)
        assert len(rows) > 20, name
        found[name] = rows.mean(), columns.mean()
    assert found["red"][1] + 100 < found["blue"][1]
    assert found["green"][0] > found["red"][0]
    page = recording.read_text()
    assert looks_like_recording(recording)
    assert "a &lt;thing&gt;" in page


def test_nothing_to_say_shows_nothing():
    html = make_overlay_html(Overlay())
    assert "<div" not in html
