"""The overlay beside Meshcat's scene: caption, legend, a player, and a close-up.

The overlay is HTML above a page of Meshcat, a recording or a live one (`display.live_page`). Its
caption says what is being done at the moment that is shown; where something was recorded, a player
at the bottom plays it, stops it, and winds it to any moment. The close-up is a second view that
follows the object, in a corner of the same canvas; a click swaps the two views.

Fonts and colors are the page's own; nothing is loaded. The legend's colors are those of
`CellColors` and `display.shapes`. The script and the style are in `overlay.html`, with `$` fields
to be filled in.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from string import Template
from typing import Any

import numpy as np
from matplotlib.colors import to_hex
from pydrake.geometry import Rgba

from gridpush_drake.display.cell_colors import CellColors
from gridpush_drake.display.shapes import CENTER_COLOR, ELLIPSE_SIGMAS, PLAN_COLOR
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.units import KG_PER_GRAM, PERCENT_PER_ONE

PAGE_END = "</body>"
"""Tag before which the overlay is inserted, where it stands last in a page."""


SCALE_COLORS = 17
"""Number of colors of a scale; the page blends between them."""

TICK_COUNT = 5
"""Number of values beside a scale."""


SCALE_DIGITS = 2
"""Number of digits of a value beside a scale."""

CAPTION_PATH = "caption"
"""Path in Meshcat whose `userData` is the list of phases of a live page (`encode_phases`)."""

CLOSE_UP_FRACTION = 1.5
"""Distance of a close-up's camera, in diagonals of the object's outline."""

MESHCAT_ROOT = "drake"
"""Path below which Meshcat puts every path that does not begin with a slash."""

OVERLAY_TEMPLATE = "overlay.html"
"""File with the overlay's script and style."""


@dataclass(frozen=True)
class ColorScale:
    """A bar of colors with values beside it.

    Attributes:
        title: what the colors stand for, with its unit.
        colors: CSS colors from the smallest value to the greatest, evenly spaced.
        ticks: (place, text) of some values, place from 0, the smallest, to 1.
    """

    title: str
    colors: tuple[str, ...]
    ticks: tuple[tuple[float, str], ...]


@dataclass(frozen=True)
class Mark:
    """Something that is drawn, for the legend.

    Attributes:
        color: CSS color.
        text: what it stands for.
        kind: "dot", "line" or "area".
    """

    color: str
    text: str
    kind: str = "area"


@dataclass(frozen=True)
class Phase:
    """What is being done from some time on.

    Attributes:
        time: when it begins, in the recording, s.
        title: what is being done, in a few words.
        detail: the same in a sentence; may be empty.
    """

    time: float
    title: str
    detail: str = ""

    def says_the_same(self, other: "Phase") -> bool:
        """Whether another phase has the same words, whenever it begins."""
        return (self.title, self.detail) == (other.title, other.detail)


@dataclass(frozen=True)
class CloseUp:
    """A second view that follows something in the scene.

    Attributes:
        path: path in Meshcat of what it follows, such as "estimate/object".
        distance: distance of its camera from there, m.
    """

    path: str
    distance: float


@dataclass(frozen=True)
class Overlay:
    """What stands beside a scene.

    Attributes:
        scale: scale of the cells' colors; None for none.
        marks: marks of the legend.
        phases: what is done from when on, in order; empty where nothing is recorded.
        close_up: a second view; None for none.
    """

    scale: ColorScale | None = None
    marks: tuple[Mark, ...] = ()
    phases: tuple[Phase, ...] = ()
    close_up: CloseUp | None = None


def make_color_scale(objects: Sequence[GridObject], colors: CellColors) -> ColorScale:
    """Makes the scale of the colors of objects' cells.

    It is by mass in g for a single object that was weighed, else in fractions of the even mass,
    which is another one for each object.
    """
    low, high = colors.resolve_limits()
    values = np.geomspace(low, high, SCALE_COLORS)
    places = np.linspace(0.0, 1.0, TICK_COUNT)
    shown = np.geomspace(low, high, TICK_COUNT)
    total_mass = objects[0].prior.total_mass if len(objects) == 1 else None
    if colors.shows == "friction":
        title = "friction coefficient of a cell"
    elif colors.shows == "mass" and total_mass is not None:
        title = "estimated mass of a cell, g"
        shown = shown * total_mass / objects[0].n / KG_PER_GRAM
    else:
        what = "mass" if colors.shows == "mass" else "friction force"
        title = f"estimated {what} of a cell, in even shares"
    ticks = tuple(
        (float(place), f"{value:.{SCALE_DIGITS}g}")
        for place, value in zip(places, shown, strict=True)
    )
    return ColorScale(title, tuple(map(to_hex, colors.calc_colors_of(values))), ticks)


def make_close_up(obj: GridObject, path: str) -> CloseUp:
    """Makes a second view that follows an object and has all of it in sight.

    Args:
        obj: the object.
        path: where it is drawn, in Meshcat.
    """
    x0, y0, x1, y1 = obj.outline.bounds
    return CloseUp(path, CLOSE_UP_FRACTION * float(np.hypot(x1 - x0, y1 - y0)))


def list_center_marks() -> tuple[Mark, ...]:
    """Lists the marks of the estimated center of mass."""
    return (
        Mark(to_css(CENTER_COLOR), "estimated center of mass", "dot"),
        Mark(
            to_css(CENTER_COLOR), f"where it may be, {ELLIPSE_SIGMAS:g} standard deviations", "line"
        ),
    )


def list_estimate_marks() -> tuple[Mark, ...]:
    """Lists the marks of what an `EstimateVisualizer` draws."""
    return (
        *list_center_marks(),
        Mark(to_css(PLAN_COLOR), "the push that is commanded", "line"),
        Mark(to_css(PLAN_COLOR), "where it is predicted to leave the object"),
    )


def to_css(color: Rgba) -> str:
    """A color as CSS has it."""
    return str(to_hex((color.r(), color.g(), color.b())))


def encode_phases(phases: Sequence[Phase]) -> list[float]:
    """Writes phases as JSON for the page, and the JSON as the numbers of its characters.

    A property of Meshcat can be a list of numbers, but not a text.
    """
    return [float(ord(letter)) for letter in json.dumps(_list_phases(phases))]


def add_overlay(page: str, overlay: Overlay) -> str:
    """Inserts an overlay into a page that Meshcat wrote."""
    head, end, tail = page.rpartition(PAGE_END)
    return f"{head}{make_overlay_html(overlay)}{end}{tail}"


def make_overlay_html(overlay: Overlay) -> str:
    """Makes the overlay as a piece of HTML with its style and its script."""
    text = files("gridpush_drake.display").joinpath(OVERLAY_TEMPLATE).read_text(encoding="utf-8")
    legend: dict[str, Any] = {"scale": None, "marks": [vars(mark) for mark in overlay.marks]}
    if overlay.scale is not None:
        legend["scale"] = vars(overlay.scale)
    close_up = overlay.close_up
    follows = None if close_up is None else _split_path(close_up.path)
    return Template(text).substitute(
        legend=_describe_legend(overlay.scale, overlay.marks),
        legend_data=_to_script(legend),
        phases=_to_script(_list_phases(overlay.phases)),
        caption_path=_to_script(_split_path(CAPTION_PATH)),
        follows=_to_script(follows),
        distance=_to_script(None if close_up is None else close_up.distance),
    )


def _list_phases(phases: Sequence[Phase]) -> list[list[float | str]]:
    """Phases as the page has them: [time (s), title, detail] each."""
    return [[phase.time, phase.title, phase.detail] for phase in phases]


def _split_path(path: str) -> list[str]:
    """The names along a path in Meshcat."""
    whole = path if path.startswith("/") else f"{MESHCAT_ROOT}/{path}"
    return [name for name in whole.split("/") if name]


def _to_script(value: Any) -> str:
    """A value as JSON that may stand inside a page's script."""
    return json.dumps(value).replace("</", "<\\/")


def _describe_legend(scale: ColorScale | None, marks: Sequence[Mark]) -> str:
    """Writes the legend as HTML; empty where it says nothing."""
    if scale is None and not marks:
        return ""
    items = ""
    for mark in marks:
        symbol = f'<i class="{escape(mark.kind)}" style="--c:{escape(mark.color)}"></i>'
        items += f"<li>{symbol}{escape(mark.text)}</li>"
    bar = _describe_scale(scale) if scale else ""
    return f'<div id="legend" class="gridpush">{bar}<ul>{items}</ul></div>'


def _describe_scale(scale: ColorScale) -> str:
    """Writes a color scale as HTML: its title, its bar, and the values below it."""
    ticks = "".join(
        f'<span style="left:{PERCENT_PER_ONE * place:.1f}%">{escape(text)}</span>'
        for place, text in scale.ticks
    )
    gradient = f"linear-gradient(to right, {', '.join(map(escape, scale.colors))})"
    bar = f'<div class="bar" style="background:{gradient}"></div>'
    return f'<b>{escape(scale.title)}</b>{bar}<div class="ticks">{ticks}</div>'
