"""What stands beside a recording, as a real browser draws it."""

import html
import json
import re

import numpy as np
import pytest
from pydrake.geometry import Box, Rgba
from pydrake.math import RigidTransform

from gridpush_drake.display.overlay import (
    CloseUp,
    ColorScale,
    Mark,
    Overlay,
    Phase,
)
from gridpush_drake.display.server import (
    StartMeshcatServer,
    looks_like_recording,
    write_recording,
)
from tests.helpers.chromium import (
    add_script,
    find_pixels,
    freeze_recording,
    read_page,
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


WATCH = """
const animator = viewer.animator, told = {}, button = document.querySelector("#player button");
const slider = document.querySelector("#player input");
const wait = (ms) => new Promise((done) => setTimeout(done, ms));
async function hold(moment) {
  // Each moment is held for a while, before what the page says is taken down.
  for (let k = 0; k < 3; k++) {
    animator.seek(moment); animator.display_progress(moment); await wait(100);
  }
}
function tell(name) {
  told[name] = document.getElementById("phase").innerHTML
    + document.getElementById("player").outerHTML;
}
(async () => {
  animator.pause();
  for (const moment of [0.5, 1.8, 2.0]) { await hold(moment); tell(moment); }
  animator.seek(1.9); animator.display_progress(1.9); animator.play();
  // A page that nobody sees draws as few pictures as it likes; a timer lets the animation go on.
  const going = setInterval(() => animator.update(), 20);
  await wait(1500); tell("end"); clearInterval(going);
  animator.mixer.timeScale = 0.01; button.click();
  await wait(300); tell("again");
  animator.mixer.timeScale = 1.0; slider.value = 1.7; slider.dispatchEvent(new Event("input"));
  await wait(300); tell("wound");
  const page = document.createElement("pre");
  page.id = "told"; page.textContent = JSON.stringify(told); document.body.append(page);
})();
"""
"""What is done in a recording's page, and what its phase and its player say after each step."""


@pytest.fixture(scope="module")
def told(recording, tmp_path_factory):
    """What the page says, as HTML, by what was done before."""
    script = add_script(recording, WATCH, tmp_path_factory.mktemp("watched") / "page.html")
    (text,) = re.findall('<pre id="told">(.*?)</pre>', read_page(script))
    return json.loads(html.unescape(text))


@pytest.mark.parametrize(
    ("moment", "said"),
    [
        ("0.5", "<b>Looking</b><span></span><small>0.5 s</small>"),
        ("1.8", "<b>Push 1</b><span>Because &lt;/script&gt; it must.</span><small>1.8 s</small>"),
        ("2", "<b>Done</b><span></span><small>2.0 s</small>"),
    ],
)
def test_tells_the_phase_of_each_moment(told, moment, said):
    assert told[moment].startswith(said)


def test_ends_with_what_was_done_last(told):
    """All of the scene's parts are set back when the animation is over; its own time is not."""
    assert "<b>Done</b><span></span><small>2.0 s</small>" in told["end"]
    assert "Replay</button>" in told["end"]
    assert "2.0 of 2.0 s</output>" in told["end"]


def test_replays_from_the_beginning(told):
    """At the end the button starts anew: at a hundredth of the speed it stays where it begins."""
    assert "<b>Looking</b>" in told["again"]
    assert "Pause</button>" in told["again"]


def test_the_slider_winds_to_any_moment(told):
    assert "<b>Push 1</b>" in told["wound"]
    assert "<small>1.7 s</small>" in told["wound"]
    assert "Play</button>" in told["wound"]


@pytest.mark.slow
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


@pytest.mark.slow
def test_the_close_up_follows_what_it_should(tmp_path):
    """A small red box far from the camera's target is large in the corner wherever it goes."""
    meshcat = StartMeshcatServer(0)
    meshcat.SetObject("box", Box(0.05, 0.05, 0.05), Rgba(0.9, 0.1, 0.1))
    meshcat.SetCameraPose((4.0, 0.0, 1.0), (0.0, 0.0, 0.0))
    meshcat.StartRecording(10.0)
    for time, y in ((0.0, -1.0), (1.0, 1.0)):
        meshcat.SetTransform("box", RigidTransform([0.0, y, 0.0]), time)
    recording = tmp_path / "recording.html"
    write_recording(meshcat, recording, overlay=Overlay(close_up=CloseUp("box", 0.2)))
    sizes = []
    for moment in (0.0, 1.0):
        still = freeze_recording(recording, moment, tmp_path / "still.html")
        red = find_pixels(take_picture(still), (0.9, 0.1, 0.1))
        height, width = red.shape
        corner = np.zeros_like(red)
        corner[: height // 2, 2 * width // 3 :] = True
        sizes.append((red & corner).sum())
        assert 0 < (red & ~corner).sum() < 0.1 * sizes[-1]
    assert sizes[1] == pytest.approx(sizes[0], rel=0.05)
    assert sizes[0] > 5000


@pytest.mark.slow
def test_nothing_to_say_shows_nothing(tmp_path):
    meshcat = StartMeshcatServer(0)
    write_recording(meshcat, tmp_path / "plain.html", overlay=Overlay())
    page = read_page(tmp_path / "plain.html")
    assert 'id="legend"' not in page
    for part in ("phase", "player", "close_up"):
        (tag,) = re.findall(f'<div id="{part}"[^>]*>', page)
        assert "hidden" in tag
