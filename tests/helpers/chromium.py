"""Pictures of pages as a real browser draws them, without a display; and what colors are in them."""

import shutil
import subprocess
import tempfile
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray
from PIL import Image

from gridpush_drake.display.film import BROWSER_FLAGS, BROWSER_NAMES

SIZE = (1280, 800)
"""Of a picture, pixels."""

VIRTUAL_TIME = 10_000
"""What the page may take by its own clock before the picture is taken, ms."""

READ_TIME = 4_000
"""The same before a page's text is read, ms."""

LONGEST = 120.0
"""What chromium may take by ours, s."""

POLL = 100
"""How often a recording is held still, ms of the page's clock."""

FILM_INPUT = np.array(
    [[0.59719, 0.35458, 0.04823], [0.076, 0.90834, 0.01566], [0.0284, 0.13383, 0.83777]]
)
FILM_OUTPUT = np.array(
    [[1.60475, -0.53108, -0.07367], [-0.10208, 1.10813, -0.00605], [-0.00327, -0.07276, 1.07602]]
)
FILM_CURVE = (0.0245786, 0.000090537, 0.983729, 0.432951, 0.238081)
FILM_EXPOSURE, FILM_WHITE = 0.6, 0.99
"""Of the film curve in three.js, `ACESFilmicToneMapping`; it never reaches white."""

HUE_TOLERANCE = 0.1
"""Within which two hues count as one, rad."""

MIN_SATURATION = 0.6
"""Fraction of a color's saturation that gloss must leave it."""

MIN_LIGHT = 0.02
"""Sum of linear red, green and blue below which a pixel has no hue to speak of; white has 3."""


@cache
def find_chromium() -> str | None:
    """The browser's path; None where there is none."""
    return next((path for name in BROWSER_NAMES if (path := shutil.which(name))), None)


def require_chromium() -> str:
    """The browser's path; skips the test where there is none."""
    path = find_chromium()
    if path is None:
        pytest.skip("no chromium is installed, so no page can be drawn")
    return path


def take_picture(
    page: str | Path,
    out: Path | None = None,
    *,
    size: tuple[int, int] = SIZE,
    virtual_time: int = VIRTUAL_TIME,
) -> NDArray[np.uint8]:
    """Draws a page in headless chromium; skips the test where there is none.

    Args:
        page: its address, or an HTML file.
        out: keeps the picture as this PNG file.
        size: width and height, pixels.
        virtual_time: what the page may take by its own clock, ms.

    Returns:
        (height, width, 3) the picture, sRGB.
    """
    browser = require_chromium()
    address = page.resolve().as_uri() if isinstance(page, Path) else page
    with tempfile.TemporaryDirectory(prefix="chromium-", ignore_cleanup_errors=True) as folder:
        picture = Path(folder) / "picture.png"
        command = [
            browser, *BROWSER_FLAGS, f"--user-data-dir={folder}/profile", f"--window-size={size[0]},{size[1]}",
            f"--virtual-time-budget={virtual_time}", f"--screenshot={picture}", address,
        ]  # fmt: skip
        done = subprocess.run(command, capture_output=True, text=True, timeout=LONGEST)
        assert picture.exists(), f"chromium drew nothing:\n{done.stderr}"
        if out is not None:
            shutil.copyfile(picture, out)
        with Image.open(picture) as image:
            return np.array(image.convert("RGB"))


def read_page(page: str | Path, *, virtual_time: int = READ_TIME) -> str:
    """What a page holds when its scripts have run, as HTML; skips the test where there is no browser.

    Args:
        page: its address, or an HTML file.
        virtual_time: what the page may take by its own clock, ms.
    """
    browser = require_chromium()
    address = page.resolve().as_uri() if isinstance(page, Path) else page
    with tempfile.TemporaryDirectory(prefix="chromium-", ignore_cleanup_errors=True) as folder:
        command = [browser, *BROWSER_FLAGS, f"--user-data-dir={folder}"]
        command += [f"--virtual-time-budget={virtual_time}", "--dump-dom", address]
        done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=LONGEST)
    return done.stdout


def add_script(recording: Path, script: str, out: Path) -> Path:
    """Copies a Meshcat recording with a script that runs once its animation is there; returns `out`."""
    waiting = (
        "const waiting = setInterval(() => { if (!viewer.animator.actions.length) return; "
        f"clearInterval(waiting); {script} }}, {POLL});"
    )
    head, body, tail = recording.read_text(encoding="utf-8").rpartition("</body>")
    out.write_text(f"{head}<script>{waiting}</script>{body}{tail}", encoding="utf-8")
    return out


def freeze_recording(recording: Path, time: float, out: Path) -> Path:
    """Copies a Meshcat recording so that it stands still at one moment, and shows the scene alone.

    What stands beside it, which has the scene's colors, is in the page but not to be seen.

    Args:
        recording: the HTML file.
        time: of the animation, s from its beginning.
        out: the copy.

    Returns:
        `out`.
    """
    # The page reads its scene bit by bit after it was loaded, so the animation is there at some
    # later time only.
    moment = float(time)
    still = (
        "setInterval(() => { const animator = viewer.animator; animator.pause(); "
        f"animator.seek({moment!r}); animator.display_progress({moment!r}); }}, {POLL});"
    )
    head, body, tail = recording.read_text(encoding="utf-8").rpartition("</body>")
    alone = "<style>.gridpush { display: none; }</style>"
    out.write_text(f"{head}{alone}<script>{still}</script>{body}{tail}", encoding="utf-8")
    return out


def find_pixels(picture: NDArray[np.uint8], color: ArrayLike) -> NDArray[np.bool_]:
    """Finds a surface's color c in a picture of a Meshcat page, however it is lit.

    White light l makes a surface send out l c + g (1, 1, 1), with g its gloss. So what stays is the
    hue, the direction of the part across white, in linear light; and that the color is about as
    saturated as it was.

    Args:
        picture: (height, width, 3) sRGB.
        color: (3,) c, sRGB, 0 to 1.

    Returns:
        (height, width) where the picture has the hue to within HUE_TOLERANCE, at least
        MIN_SATURATION of the saturation, and more than MIN_LIGHT.
    """
    light, wanted = (
        undo_tone_mapping(to_linear(picture / 255.0)),
        to_linear(np.asarray(color, dtype=np.float64)),
    )
    hue, saturation = _split(light)
    wanted_hue, wanted_saturation = _split(wanted)
    near = hue @ wanted_hue > np.cos(HUE_TOLERANCE)
    found: NDArray[np.bool_] = (
        near & (saturation > MIN_SATURATION * wanted_saturation) & (light.sum(axis=-1) > MIN_LIGHT)
    )
    return found


def _split(light: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The unit vectors (..., 3) of light's part across white, and its size (...) in the light's sum."""
    across = light - light.mean(axis=-1, keepdims=True)
    size = np.linalg.norm(across, axis=-1)
    tiny = np.finfo(float).tiny
    return across / np.maximum(size, tiny)[..., None], size / np.maximum(light.sum(axis=-1), tiny)


def undo_tone_mapping(shown: NDArray[np.float64]) -> NDArray[np.float64]:
    """The light (..., 3) that left a surface, from what the page shows of it, linear.

    Meshcat has three.js map light to the screen by S. Hill's fit of the ACES film curve:
    shown = O f(I light / 0.6), f(v) = (v (v + a) - b) / (v (c v + d) + e), each channel by itself.
    """
    a, b, c, d, e = FILM_CURVE
    y = np.clip(shown @ np.linalg.inv(FILM_OUTPUT).T, 0.0, FILM_WHITE)
    # y (c v² + d v + e) = v² + a v - b, of which v is the greater root
    A, B, C = 1 - c * y, a - d * y, -(b + e * y)
    v = (-B + np.sqrt(B**2 - 4 * A * C)) / (2 * A)
    return FILM_EXPOSURE * v @ np.linalg.inv(FILM_INPUT).T


def to_linear(srgb: ArrayLike) -> NDArray[np.float64]:
    """sRGB, 0 to 1, as linear light."""
    value = np.asarray(srgb, dtype=np.float64)
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
