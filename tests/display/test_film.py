"""Films of recordings."""

from io import BytesIO

import numpy as np
import pytest
from PIL import Image, ImageSequence

from gridpush_drake.display import film
from gridpush_drake.display.film import (
    CAPTION_HEIGHT,
    FRAMES_PER_SECOND,
    SCENE_SIZE,
    add_strip,
    check_film,
    draw_legend,
    find_phase,
    read_legend,
    read_phases,
    write_film,
)
from gridpush_drake.display.overlay import (
    CloseUp,
    ColorScale,
    Mark,
    Overlay,
    Phase,
    make_overlay_html,
)
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
        np.asarray(add_strip(Image.new("RGB", (60, 20)), words)) for words in ("", "word")
    )
    assert plain.shape == (20 + CAPTION_HEIGHT, 60, 3)
    assert (plain[20:] == 255).all()
    assert (written[20:] < 128).any()


OVERLAY = Overlay(
    ColorScale("mass, g", ("#ff0000", "#0000ff"), ((0.0, "1"), (1.0, "2"))),
    (
        Mark("#00c000", "a push", "line"),
        Mark("#c000c0", "an area"),
        Mark("#00c0c0", "a dot", "dot"),
    ),
    (Phase(0.0, "Across"), Phase(1.0, "There")),
    CloseUp("box", 0.5),
)


def find_color(picture, color, within=40):
    return (np.abs(np.asarray(picture).astype(int) - color).sum(axis=-1) < within).sum()


def test_the_legend_of_the_page_is_drawn():
    legend = draw_legend(read_legend(make_overlay_html(OVERLAY)), 600)
    assert legend.width == 600
    for color in ((255, 0, 0), (0, 0, 255), (0, 192, 0), (192, 0, 192), (0, 192, 192)):
        assert find_color(legend, color) > 20, color
    assert draw_legend(read_legend("<html></html>"), 600) is None


def pack_shades():
    """A gradient, (64, 800), beside many other colors: as it is, and in a GIF's first two pictures."""
    shade = np.broadcast_to(np.linspace(60.0, 200.0, 800)[None, :, None], (64, 800, 3))
    others = np.random.default_rng(0).integers(0, 256, (8, 800, 3))
    first = Image.fromarray(np.concatenate([shade, others]).astype(np.uint8))
    second = first.copy()
    second.paste((255, 0, 0), (0, 64, 800, 72))
    with Image.open(BytesIO(film._pack([first, second], ".gif"))) as image:
        pictures = [np.asarray(each.convert("RGB")) for each in ImageSequence.Iterator(image)]
    return shade[0, :, 0], [picture[:64] for picture in pictures]


def calc_banding(shade, picture):
    """By how much areas of 4 columns differ from what they should be, standard deviation of 255."""
    box = np.ones(4) / 4
    shown, wanted = picture.astype(float).mean(axis=(0, 2)), shade
    return (np.convolve(shown, box, "valid") - np.convolve(wanted, box, "valid")).std()


def test_shades_blend_in_a_gif_and_stand_still(monkeypatch):
    shade, (first, second) = pack_shades()
    np.testing.assert_array_equal(first, second)
    monkeypatch.setattr(film, "DITHER_AMPLITUDE", 0.0)
    banded = pack_shades()[1][0]
    assert calc_banding(shade, first) < 0.8 * calc_banding(shade, banded)


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
    page, out = tmp_path / "recording.html", tmp_path / f"film.{ending}"
    write_recording(meshcat, page, overlay=OVERLAY)
    write_film(page, out, seconds=0.5)
    with Image.open(out) as image:
        pictures = [
            np.asarray(frame.convert("RGB")).astype(int) for frame in ImageSequence.Iterator(image)
        ]
    assert len(pictures) == round(0.5 * FRAMES_PER_SECOND)
    assert pictures[0].shape[:2] > (SCENE_SIZE[1] + CAPTION_HEIGHT, SCENE_SIZE[0] - 1)
    corner = pictures[0][: SCENE_SIZE[1] // 2, 2 * SCENE_SIZE[0] // 3 :]
    assert ((corner[..., 0] > 100) & (corner[..., 0] > 2 * corner[..., 1])).sum() > 5000
    for picture in pictures:
        picture[: SCENE_SIZE[1] // 2, 2 * SCENE_SIZE[0] // 3 :] = 0
        picture[SCENE_SIZE[1] :] = 0
    places = []
    for picture in (pictures[0], pictures[-1]):
        red = (picture[..., 0] > 100) & (picture[..., 0] > 2 * picture[..., 1])
        assert red.sum() > 1000
        places.append(np.flatnonzero(red.any(axis=0)).mean())
    assert places[1] - places[0] > SCENE_SIZE[0] / 8
