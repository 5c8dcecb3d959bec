"""The live page: what it gives out itself, and what it passes on."""

from http.client import HTTPConnection

import pytest
from pydrake.geometry import Box, Rgba

from gridpush_drake.display.live_page import FIRST_PORT, LivePage
from gridpush_drake.display.overlay import Mark, Overlay, Phase
from gridpush_drake.errors import StationError
from tests.helpers.chromium import find_pixels, read_page, take_picture

GREEN = (0.1, 0.8, 0.1)


@pytest.fixture(scope="module")
def page():
    live = LivePage(0)
    live.overlay = Overlay(marks=(Mark("#00ff00", "a thing", "line"),))
    live.meshcat.SetObject("box", Box(1.0, 1.0, 1.0), Rgba(*GREEN))
    return live


def ask(page, path):
    connection = HTTPConnection(page.url.removeprefix("http://"), timeout=10)
    connection.request("GET", path)
    return connection.getresponse()


def test_gives_out_meshcat_s_page_with_the_overlay_and_passes_the_rest_on(page):
    for path in ("/", "/index.html", "/meshcat.html?reconnect_ms=0"):
        answer = ask(page, path)
        text = answer.read().decode()
        assert answer.status == 200
        assert "Drake MeshCat" in text and "a thing" in text
    icon = ask(page, "/favicon.ico")
    assert icon.status == 200 and len(icon.read()) > 100
    assert ask(page, "/nothing.txt").status == 404


@pytest.mark.slow
def test_shows_the_scene_and_what_is_being_done(page, tmp_path):
    page.show_phases([Phase(0.0, "Looking")])
    page.show_phases([Phase(0.0, "Looking"), Phase(3.2, "Poke 1 é", "Why <b> not?")])
    said = "<b>Poke 1 é</b><span>Why &lt;b&gt; not?</span><small>3.2 s</small>"
    assert said in read_page(page.url)
    assert find_pixels(take_picture(page.url, tmp_path / "live.png"), GREEN).sum() > 5000


def test_takes_the_port_it_is_told_or_the_first_free_one(page):
    with pytest.raises(StationError, match="in use"):
        LivePage(int(page.url.rpartition(":")[2]))
    with pytest.raises(StationError, match="port is 80"):
        LivePage(80)
    first, second = (int(LivePage().url.rpartition(":")[2]) for _ in range(2))
    assert FIRST_PORT <= first < second
    with pytest.raises(StationError, match=r"nowhere\.invalid"):
        LivePage(0, "nowhere.invalid")
