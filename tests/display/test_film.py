"""Films of recordings."""

import numpy as np
import pytest
from PIL import Image, ImageSequence

from gridpush_drake.display.film import (
    CAPTION,
    FRAMES_PER_SECOND,
    SIZE,
    add_caption,
    check_film,
    find_phase,
    read_phases,
    write_film,
)
from gridpush_drake.display.overlay import Overlay, Phase
from gridpush_drake.display.server import StartMeshcatServer, write_recording
from gridpush_drake.errors import OutputError, StationError
from tests.helpers.chromium import require_chromium


def test_captions_follow_the_time():
    phases = read_phases('<script>const phases = [[0.5, "one", "x"], [2.0, "two", "y"]];</script>')
    assert [find_phase(phases, time) for time in (0.0, 0.6, 1.9, 2.0, 9.0)] == [
        "one",
        "one",
        "one",
        "two",
        "two",
    ]
    assert read_phases("<html></html>") == []
    assert find_phase([], 1.0) == ""
    plain, written = (
        np.asarray(add_caption(Image.new("RGB", (60, 20)), words)) for words in ("", "word")
    )
    assert plain.shape == (20 + CAPTION, 60, 3)
    assert (plain[20:] == 255).all()
    assert (written[20:] < 128).any()


def test_what_cannot_be_made_is_refused_at_once(tmp_path, monkeypatch):
    there = tmp_path / "there.gif"
    there.write_text("mine")
    with pytest.raises(OutputError, match="--force"):
        check_film(there, False)
    with pytest.raises(StationError, match=r"film.mp4: .* \.gif or \.webp"):
        check_film(tmp_path / "film.mp4", False)
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(StationError, match="no browser"):
        check_film(tmp_path / "film.gif", False)


@pytest.mark.slow
@pytest.mark.parametrize("ending", ["gif", "webp"])
def test_a_film_shows_what_moves(tmp_path, ending):
    require_chromium()
    from pydrake.geometry import Box, Rgba
    from pydrake.math import RigidTransform

    meshcat = StartMeshcatServer(0)
    meshcat.SetObject("box", Box(0.3, 0.3, 0.3), Rgba(0.9, 0.1, 0.1))
    meshcat.SetCameraPose((2.0, 0.0, 0.5), (0.0, 0.0, 0.0))
    meshcat.StartRecording(10)
    for time, y in ((0.0, -0.4), (1.0, 0.4)):
        meshcat.SetTransform("box", RigidTransform([0.0, y, 0.0]), time)
    page, film = tmp_path / "recording.html", tmp_path / f"film.{ending}"
    write_recording(meshcat, page, overlay=Overlay(phases=(Phase(0.0, "Across"),)))
    write_film(page, film, seconds=0.5)
    with Image.open(film) as image:
        pictures = [
            np.asarray(frame.convert("RGB")).astype(int) for frame in ImageSequence.Iterator(image)
        ]
    assert len(pictures) == round(0.5 * FRAMES_PER_SECOND)
    assert pictures[0].shape == (SIZE[1] + CAPTION, SIZE[0], 3)
    places = []
    for picture in (pictures[0], pictures[-1]):
        red = (picture[..., 0] > 100) & (picture[..., 0] > 2 * picture[..., 1])
        assert red.sum() > 1000
        places.append(np.flatnonzero(red.any(axis=0)).mean())
    assert places[1] - places[0] > SIZE[0] / 8
