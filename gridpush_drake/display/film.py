"""A film of a recording: its moments as a browser draws them, in a GIF or an animated WebP.

Chromium opens the page without a window, holds the animation still at each moment in turn, and
gives back what the page's own renderer drew, with the close-up in its corner. What is being done
then and the legend, which stand beside the scene in the page, are drawn below it.
"""

import base64
import json
import math
import re
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from string import Template
from typing import Any

import numpy as np
from PIL import Image, ImageColor, ImageDraw, ImageFont

from gridpush_drake.errors import StationError
from gridpush_drake.files import check_writable, read_text, write_whole

BROWSER_NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
"""Names of the programs that can draw a film, the first one preferred."""

BROWSER_FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-dev-shm-usage",
    "--hide-scrollbars",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
)
"""Options with which a browser draws without window, display or graphics card."""

PAGE_TIME = 10_000
"""Longest time that the page may take by its own clock, ms."""

MAX_BROWSER_TIME = 600.0
"""Longest time that the browser may take by our clock, s."""

SCENE_SIZE = (720, 440)
"""Width and height of the scene, pixels; caption and legend are below it."""

FILM_DURATION = 12.0
"""Length of a film, s; it plays as much faster than the recording as it is shorter."""

FRAMES_PER_SECOND = 8
"""Number of pictures of a film in a second."""

LAST_PICTURE_TIME = 1.5
"""Time that the last picture stays, s."""

BACKGROUND_COLOR = (0.925, 0.933, 0.945)
"""Color behind the scene, sRGB: one color, as a gradient would show in bands."""

VIEW_ZOOM = 1.25
"""Factor by which the recording's view is drawn nearer."""

PAPER_COLOR = (255, 255, 255)
"""Color below the scene, RGB."""

TEXT_COLOR = (35, 39, 46)
"""Color of letters, RGB."""

FRAME_COLOR = (255, 255, 255)
"""Color of the line about the close-up, RGB."""

CAPTION_MARGIN = 14
"""Room at the left and the right of caption and legend, pixels."""

CAPTION_HEIGHT = 34
"""Height of the caption, pixels."""

CAPTION_FONT = 18
"""Height of the caption's letters, pixels."""

LEGEND_FONT = 13
"""Height of the legend's letters, pixels."""

LINE_SPACING = 18
"""Distance from one line of the legend to the next, pixels."""

SCALE_WIDTH = 250
"""Width of the color scale, pixels."""

BAR_HEIGHT = 12
"""Height of the color scale's bar, pixels."""

SYMBOL_SIZE = (16, 10)
"""Width and height of the symbol before a line of the legend, pixels."""

PALETTE_BITS = 6
"""Number of bits of red, green and blue by which colors are told apart when a GIF's palette is
chosen."""

PALETTE_SOURCES = 12
"""Number of pictures that a GIF's palette is chosen from."""

PALETTE_ROUNDS = 3
"""Number of rounds in which the palette's colors move to the middle of the colors they replace."""

MOST_OF_ONE = 24
"""Largest weight of a color when the palette is chosen, however much of the film it fills."""

DITHER_AMPLITUDE = 5.0
"""Greatest change of a GIF's pixel, of 255, that lets two colors of the palette blend into one
another. The pattern is the same in every picture, so what stands still does not flicker."""

FLAT_FRACTION = 0.05
"""Fraction of a picture that a color must fill for nothing to be blended into it, as the ground."""

BAYER_PATTERN = (
    np.array([[0, 8, 2, 10], [12, 4, 14, 6], [3, 11, 1, 9], [15, 7, 13, 5]]) / 16 - 15 / 32
)
"""Pattern of the dither: B. E. Bayer's, 4 by 4, about zero."""

WEBP_QUALITY = 70
"""Quality of a WebP's pictures, 0 to 100."""

MAX_PAGE = 64_000_000
"""Largest size of a recording, bytes."""

FILM_SUFFIXES = (".gif", ".webp")
"""Endings of a film's name."""

PHASES_PATTERN = re.compile(r"const phases = (\[.*\]);")
"""Finds the list of phases in a page that `display.overlay` made."""

LEGEND_PATTERN = re.compile(r"const legend_data = (\{.*\});")
"""Finds the color scale and the marks in a page that `display.overlay` made."""

FILM_PATTERN = re.compile(r'<pre id="film">(.*?)</pre>', re.DOTALL)
"""Finds the pictures in what the browser drew."""

FILM_SCRIPT = Template("""<script>
(() => {
  const timer = setInterval(() => {
    // the page reads its scene bit by bit after it was loaded
    if (!viewer.animator.actions.length) return;
    clearInterval(timer);
    const duration = viewer.animator.duration, pictures = [];
    viewer.animator.pause();
    viewer.set_3d_pane_size($width, $height);
    viewer.camera.zoom *= $zoom;
    viewer.camera.updateProjectionMatrix();
    for (const end of ["top_color", "bottom_color"]) {
      viewer.set_property(["Background", "<object>"], end, $ground);
    }
    const inset = viewer.place_close_up ? viewer.place_close_up() : null;
    for (let i = 0; i < $count; i++) {
      viewer.animator.seek(duration * i / ($count - 1));
      viewer.render();
      pictures.push(viewer.renderer.domElement.toDataURL("image/png"));
    }
    const film = document.createElement("pre");
    film.id = "film";
    film.textContent = JSON.stringify({duration, pictures, inset});
    document.body.replaceChildren(film);
  }, 500);
})();
</script>""")


def check_film(path: Path | str, force: bool) -> None:
    """Checks, before long work begins, that a film may be written, and made.

    Raises:
        OutputError: the file may not be written.
        StationError: its ending is of another kind, or there is no browser.
    """
    if Path(path).suffix.lower() not in FILM_SUFFIXES:
        raise StationError(
            f"{path}: is of an unknown kind; expected a name that ends in "
            f"{' or '.join(FILM_SUFFIXES)}"
        )
    check_writable(path, force)
    find_browser()


def find_browser() -> str:
    """The path of a browser that draws pages. Raises StationError where there is none."""
    found = next((path for name in BROWSER_NAMES if (path := shutil.which(name))), None)
    if found is None:
        raise StationError(
            "no browser is installed that draws the film; get one with apt-get install chromium"
        )
    return found


def write_film(
    recording: Path | str, path: Path | str, force: bool = False, *, seconds: float = FILM_DURATION
) -> None:
    """Makes a film of a recording.

    Args:
        recording: an HTML file that Meshcat wrote.
        path: the film, GIF or WebP by its ending.
        force: whether an existing file may be replaced.
        seconds: length of the film without the last picture's rest, s.

    Raises:
        OutputError, StationError: as `check_film`; or the browser drew nothing.
    """
    check_film(path, force)
    page = read_text(recording, "a recording", StationError, MAX_PAGE)
    duration, pictures = draw_frames(page, max(2, round(seconds * FRAMES_PER_SECOND)))
    phases = read_phases(page)
    legend = draw_legend(read_legend(page), SCENE_SIZE[0])
    times = [duration * i / (len(pictures) - 1) for i in range(len(pictures) - 1)]
    times.append(math.inf)  # the last picture shows what was done last
    frames = [
        add_strip(picture, find_phase(phases, time), legend)
        for picture, time in zip(pictures, times, strict=True)
    ]
    write_whole(path, _pack(frames, Path(path).suffix.lower()), force)


def draw_frames(page: str, count: int) -> tuple[float, list[Image.Image]]:
    """Draws a recording at moments that are evenly spread from its beginning to its end.

    Args:
        page: the recording's HTML.
        count: how many moments.

    Returns:
        How long the recording takes, s, and the pictures.

    Raises:
        StationError: there is no browser, or it drew nothing.
    """
    head, body, tail = page.rpartition("</body>")
    script = FILM_SCRIPT.substitute(
        width=SCENE_SIZE[0],
        height=SCENE_SIZE[1],
        zoom=VIEW_ZOOM,
        count=count,
        ground=list(BACKGROUND_COLOR),
    )
    with tempfile.TemporaryDirectory(prefix="gridpush-film-", ignore_cleanup_errors=True) as folder:
        held = Path(folder) / "page.html"
        held.write_text(f"{head}{script}{body}{tail}", encoding="utf-8")
        command = [
            find_browser(),
            *BROWSER_FLAGS,
            f"--user-data-dir={folder}/profile",
            f"--window-size={SCENE_SIZE[0]},{SCENE_SIZE[1]}",
            f"--virtual-time-budget={PAGE_TIME}",
            "--dump-dom",
            held.as_uri(),
        ]
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, timeout=MAX_BROWSER_TIME, check=False
            )
        except subprocess.TimeoutExpired as error:
            raise StationError(f"the browser drew no film within {MAX_BROWSER_TIME:g} s") from error
    found = FILM_PATTERN.search(done.stdout)
    if found is None:
        raise StationError(
            "the browser drew no film of the recording; expected a page that Meshcat wrote"
        )
    film = json.loads(found[1])
    data = (BytesIO(base64.b64decode(address.partition(",")[2])) for address in film["pictures"])
    pictures = [Image.open(picture).convert("RGB") for picture in data]
    if film["inset"] is not None:
        for picture in pictures:
            _frame_inset(picture, film["inset"])
    return float(film["duration"]), pictures


def read_phases(page: str) -> list[tuple[float, str]]:
    """What is being done from which time on, s; nothing where the page has no such list."""
    found = PHASES_PATTERN.search(page)
    return [(float(time), str(title)) for time, title, *_ in json.loads(found[1])] if found else []


def find_phase(phases: Sequence[tuple[float, str]], time: float) -> str:
    """What is being done at a time, s."""
    begun = [title for begin, title in phases if begin <= time]
    return begun[-1] if begun else (phases[0][1] if phases else "")


def read_legend(page: str) -> dict[str, Any]:
    """Reads the legend of a page.

    Returns:
        "scale" (title, colors and ticks, or None) and "marks"; both empty where there is no legend.
    """
    found = LEGEND_PATTERN.search(page)
    return dict(json.loads(found[1])) if found else {"scale": None, "marks": []}


def add_strip(picture: Image.Image, words: str, legend: Image.Image | None = None) -> Image.Image:
    """Writes words below a picture, and draws a legend below them."""
    height = picture.height + CAPTION_HEIGHT + (legend.height if legend else 0)
    framed = Image.new("RGB", (picture.width, height), PAPER_COLOR)
    framed.paste(picture)
    place = (CAPTION_MARGIN, picture.height + CAPTION_HEIGHT // 2)
    font = ImageFont.load_default(CAPTION_FONT)
    ImageDraw.Draw(framed).text(place, words, TEXT_COLOR, font, anchor="lm")
    if legend is not None:
        framed.paste(legend, (0, picture.height + CAPTION_HEIGHT))
    return framed


def draw_legend(legend: dict[str, Any], width: int) -> Image.Image | None:
    """Draws a legend with the color scale at the left.

    Args:
        legend: what `read_legend` returns.
        width: width of the picture, pixels.

    Returns:
        The picture; None of a legend that says nothing.
    """
    scale = legend["scale"]
    marks = legend["marks"]
    if scale is None and not marks:
        return None
    lines = max(len(marks), 3)  # the scale takes three
    picture = Image.new("RGB", (width, LINE_SPACING * lines + CAPTION_MARGIN // 2), PAPER_COLOR)
    drawing = ImageDraw.Draw(picture)
    font = ImageFont.load_default(LEGEND_FONT)
    left = CAPTION_MARGIN
    if scale is not None:
        _draw_scale(drawing, font, scale)
        left += SCALE_WIDTH + 3 * CAPTION_MARGIN
    for i, mark in enumerate(marks):
        place = (left, LINE_SPACING // 2 + LINE_SPACING * i)
        _draw_symbol(drawing, place, mark)
        words = (place[0] + SYMBOL_SIZE[0] + 6, place[1])
        drawing.text(words, mark["text"], TEXT_COLOR, font, anchor="lm")
    return picture


def _draw_scale(drawing: ImageDraw.ImageDraw, font: Any, scale: dict[str, Any]) -> None:
    """Draws the title, the bar of colors, and the values below it."""
    drawing.text((CAPTION_MARGIN, LINE_SPACING // 2), scale["title"], TEXT_COLOR, font, anchor="lm")
    colors = np.array([ImageColor.getrgb(color) for color in scale["colors"]])
    for x in range(SCALE_WIDTH):
        at = x / (SCALE_WIDTH - 1) * (len(colors) - 1)
        color = [np.interp(at, range(len(colors)), channel) for channel in colors.T]
        drawing.line(
            [CAPTION_MARGIN + x, LINE_SPACING, CAPTION_MARGIN + x, LINE_SPACING + BAR_HEIGHT],
            tuple(map(round, color)),
        )
    for place, words in scale["ticks"]:
        spot = (CAPTION_MARGIN + place * (SCALE_WIDTH - 1), LINE_SPACING + BAR_HEIGHT + 4)
        drawing.text(spot, words, TEXT_COLOR, font, anchor="la" if place == 0 else "ma")


def _draw_symbol(
    drawing: ImageDraw.ImageDraw, place: tuple[int, int], mark: dict[str, Any]
) -> None:
    """Draws a dot, a line or an area in a mark's color; `place` is the middle of its left side."""
    x, y = place
    width, height = SYMBOL_SIZE
    color = ImageColor.getrgb(mark["color"])
    if mark["kind"] == "dot":
        radius = height // 2
        middle = x + width // 2
        drawing.ellipse([middle - radius, y - radius, middle + radius, y + radius], color)
    elif mark["kind"] == "line":
        drawing.rectangle([x, y - 1, x + width, y + 1], color)
    else:
        pale = tuple(round(0.3 * part + 0.7 * 255) for part in color)
        drawing.rectangle([x, y - height // 2, x + width, y + height // 2], pale, color, 2)


def _frame_inset(picture: Image.Image, inset: dict[str, float]) -> None:
    """Draws a line about the close-up, which the page has as a box of its own."""
    left = round(inset["left"])
    top = round(inset["height"] - inset["bottom"] - inset["high"])
    right = left + round(inset["wide"])
    bottom = top + round(inset["high"])
    edges = [left - 2, top - 2, right + 1, bottom + 1]
    ImageDraw.Draw(picture).rectangle(edges, outline=FRAME_COLOR, width=2)


def _pack(frames: Sequence[Image.Image], kind: str) -> bytes:
    """The film's bytes: it begins anew when it is over."""
    lasts = [round(1000 / FRAMES_PER_SECOND)] * (len(frames) - 1) + [
        round(1000 * LAST_PICTURE_TIME)
    ]
    options: dict[str, Any] = {"save_all": True, "duration": lasts, "loop": 0}
    buffer = BytesIO()
    if kind == ".webp":
        frames[0].save(
            buffer, "WEBP", append_images=frames[1:], quality=WEBP_QUALITY, method=6, **options
        )
        return buffer.getvalue()
    palette = _find_palette(frames)
    few = [_blend(frame).quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    few[0].save(buffer, "GIF", append_images=few[1:], optimize=False, disposal=1, **options)
    return buffer.getvalue()


def _find_palette(frames: Sequence[Image.Image]) -> Image.Image:
    """Finds 256 colors for all frames, so that what does not move keeps its own.

    A color counts by the root of the area that it fills, at most MOST_OF_ONE times: else the ground
    and the table would take nearly all of the palette, and the arm's shades would show in bands.
    """
    some = frames[:: max(1, len(frames) // PALETTE_SOURCES)]
    pixels = np.concatenate([np.asarray(frame).reshape(-1, 3) for frame in some])
    width = 2 ** (8 - PALETTE_BITS)
    known, counts = np.unique(pixels // width, axis=0, return_counts=True)
    weights = np.clip(np.sqrt(counts).astype(int), 1, MOST_OF_ONE)
    every = np.repeat(known * width + width // 2, weights, axis=0).astype(np.uint8)
    return Image.fromarray(every[None]).quantize(
        256,
        method=Image.Quantize.MEDIANCUT,
        kmeans=PALETTE_ROUNDS,
        dither=Image.Dither.NONE,
    )


def _blend(frame: Image.Image) -> Image.Image:
    """Adds the dither's pattern to a picture, but not to where one color fills much of it."""
    pixels = np.asarray(frame).astype(np.float64)
    height, width, _ = pixels.shape
    tiles = (height // len(BAYER_PATTERN) + 1, width // len(BAYER_PATTERN) + 1)
    pattern = np.tile(BAYER_PATTERN, tiles)[:height, :width, None]
    known, counts = np.unique(pixels.reshape(-1, 3), axis=0, return_counts=True)
    flat = np.zeros((height, width, 1), dtype=bool)
    for color in known[counts > FLAT_FRACTION * height * width]:
        flat |= (pixels == color).all(axis=-1, keepdims=True)
    blended = pixels + np.where(flat, 0.0, DITHER_AMPLITUDE * pattern)
    return Image.fromarray(np.clip(np.round(blended), 0, 255).astype(np.uint8))
