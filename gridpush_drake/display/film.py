"""A film of a recording: its moments as a browser draws them, in a GIF or an animated WebP.

Chromium opens the page without a window, holds the animation still at each moment in turn, and
gives back what the page's own renderer drew. What is being done then, which stands beside the
scene, is written below it.
"""

import base64
import json
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
from PIL import Image, ImageDraw, ImageFont

from gridpush_drake.errors import StationError
from gridpush_drake.files import check_writable, read_text, write_whole

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")

FLAGS = (
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
"""Of a browser without window, display or graphics card."""

PAGE_TIME, PATIENCE = (
    10_000,
    600.0,
)  # what the page may take by its own clock, ms, and the browser by ours, s
SIZE = (640, 400)  # of the scene, pixels; the caption is below it
SECONDS, FRAMES_PER_SECOND = (
    12.0,
    8,
)  # of the film; it plays as much faster than the recording as it is shorter
REST = 1.5  # s that the last picture stays

CAPTION, FONT_SIZE, TEXT, PAPER = 30, 17, (35, 39, 46), (255, 255, 255)
"""Height of the caption and of its letters, pixels; colors of letters and ground, RGB."""

COLORS, PALETTE_BITS, SOME = 192, 5, 8
"""Of a GIF, the same for all of its pictures: how many, the bits by which colors are told apart
that they stand for, and the pictures that these are taken from."""

ZOOM = 1.25  # by which the recording's view is drawn nearer

WEBP_QUALITY = 70

MAX_PAGE = 64_000_000  # bytes of a recording

ENDINGS = (".gif", ".webp")

PHASES = re.compile(r"const phases = (\[.*\]);")
"""In the page, see `display.overlay`: what is done from when on."""

FILM = re.compile(r'<pre id="film">(.*?)</pre>', re.DOTALL)

SCRIPT = Template("""<script>
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
    for (let i = 0; i < $count; i++) {
      viewer.animator.seek(duration * i / ($count - 1));
      viewer.render();
      pictures.push(viewer.renderer.domElement.toDataURL("image/png"));
    }
    const film = document.createElement("pre");
    film.id = "film";
    film.textContent = JSON.stringify({duration, pictures});
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
    if Path(path).suffix.lower() not in ENDINGS:
        raise StationError(
            f"{path}: is of an unknown kind; expected a name that ends in {' or '.join(ENDINGS)}"
        )
    check_writable(path, force)
    find_browser()


def find_browser() -> str:
    """The path of a browser that draws pages. Raises StationError where there is none."""
    found = next((path for name in BROWSERS if (path := shutil.which(name))), None)
    if found is None:
        raise StationError(
            "no browser is installed that draws the film; get one with apt-get install chromium"
        )
    return found


def write_film(
    recording: Path | str, path: Path | str, force: bool = False, *, seconds: float = SECONDS
) -> None:
    """Makes a film of a recording, GIF or WebP by its ending, that takes `seconds` without the last picture's rest.

    Raises:
        OutputError, StationError: as `check_film`; or the browser drew nothing.
    """
    check_film(path, force)
    page = read_text(recording, "a recording", StationError, MAX_PAGE)
    duration, pictures = draw_frames(page, max(2, round(seconds * FRAMES_PER_SECOND)))
    phases = read_phases(page)
    times = [duration * i / (len(pictures) - 1) for i in range(len(pictures))]
    frames = [
        add_caption(picture, find_phase(phases, time))
        for picture, time in zip(pictures, times, strict=True)
    ]
    write_whole(path, _pack(frames, Path(path).suffix.lower()), force)


def draw_frames(page: str, count: int) -> tuple[float, list[Image.Image]]:
    """Draws a recording at `count` moments, evenly from its beginning to its end; and how long it takes, s.

    Raises StationError: there is no browser, or it drew nothing.
    """
    head, body, tail = page.rpartition("</body>")
    script = SCRIPT.substitute(width=SIZE[0], height=SIZE[1], zoom=ZOOM, count=count)
    with tempfile.TemporaryDirectory(prefix="gridpush-film-", ignore_cleanup_errors=True) as folder:
        held = Path(folder) / "page.html"
        held.write_text(f"{head}{script}{body}{tail}", encoding="utf-8")
        command = [
            find_browser(), *FLAGS, f"--user-data-dir={folder}/profile", f"--window-size={SIZE[0]},{SIZE[1]}",
            f"--virtual-time-budget={PAGE_TIME}", "--dump-dom", held.as_uri(),
        ]  # fmt: skip
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, timeout=PATIENCE, check=False
            )
        except subprocess.TimeoutExpired as error:
            raise StationError(f"the browser drew no film within {PATIENCE:g} s") from error
    found = FILM.search(done.stdout)
    if found is None:
        raise StationError(
            "the browser drew no film of the recording; expected a page that Meshcat wrote"
        )
    film = json.loads(found[1])
    data = (BytesIO(base64.b64decode(address.partition(",")[2])) for address in film["pictures"])
    pictures = [Image.open(picture).convert("RGB") for picture in data]
    return float(film["duration"]), pictures


def read_phases(page: str) -> list[tuple[float, str]]:
    """What is being done from which time on, s; nothing where the page has no such list."""
    found = PHASES.search(page)
    return [(float(time), str(title)) for time, title, *_ in json.loads(found[1])] if found else []


def find_phase(phases: Sequence[tuple[float, str]], time: float) -> str:
    """What is being done at a time, s."""
    begun = [title for begin, title in phases if begin <= time]
    return begun[-1] if begun else (phases[0][1] if phases else "")


def add_caption(picture: Image.Image, words: str) -> Image.Image:
    """Writes words below a picture."""
    framed = Image.new("RGB", (picture.width, picture.height + CAPTION), PAPER)
    framed.paste(picture)
    place = (CAPTION // 2, picture.height + CAPTION // 2)
    ImageDraw.Draw(framed).text(place, words, TEXT, ImageFont.load_default(FONT_SIZE), anchor="lm")
    return framed


def _pack(frames: Sequence[Image.Image], kind: str) -> bytes:
    """The film's bytes: it begins anew when it is over."""
    lasts = [round(1000 / FRAMES_PER_SECOND)] * (len(frames) - 1) + [round(1000 * REST)]
    options: dict[str, Any] = {"save_all": True, "duration": lasts, "loop": 0}
    buffer = BytesIO()
    if kind == ".webp":
        frames[0].save(
            buffer, "WEBP", append_images=frames[1:], quality=WEBP_QUALITY, method=6, **options
        )
        return buffer.getvalue()
    palette = _find_palette(frames)
    few = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    few[0].save(buffer, "GIF", append_images=few[1:], optimize=False, disposal=1, **options)
    return buffer.getvalue()


def _find_palette(frames: Sequence[Image.Image]) -> Image.Image:
    """Colors for all frames, so that what does not move keeps its own.

    They stand for all that occur, each as much as the other: by their areas the background would
    take most.
    """
    some = [np.asarray(frame).reshape(-1, 3) for frame in frames[:: max(1, len(frames) // SOME)]]
    width = 2 ** (8 - PALETTE_BITS)
    known = np.unique(np.concatenate(some) // width, axis=0) * width + width // 2
    every = Image.fromarray(known[None].astype(np.uint8))
    return every.quantize(COLORS, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
