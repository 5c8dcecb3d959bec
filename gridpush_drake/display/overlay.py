"""What stands beside a recording: what is being done at each moment, what the colors mean, and what is drawn.

A recording is a page that shows Meshcat's animation. The overlay is HTML above it that follows the
animation's time: it plays, stops and is wound with it. Fonts and colors are the page's own; nothing
is loaded. The legend's colors are those of `CellColors` and `display.shapes`.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from string import Template

import numpy as np
from matplotlib.colors import to_hex
from pydrake.geometry import Rgba

from gridpush_drake.display.cell_colors import CellColors
from gridpush_drake.display.shapes import CENTER_COLOR, PLAN_COLOR, SIGMAS
from gridpush_drake.objects.grid_object import GridObject

PAGE_END = "</body>"  # before the last one of a page the overlay is inserted

PERCENT = 100.0

SCALE_COLORS = 17  # of a scale; the page blends between them
TICKS = 5  # of a scale
GRAM = 1e-3  # in kg
DIGITS = 2  # of a tick's value


@dataclass(frozen=True)
class ColorScale:
    """A bar of colors with values beside it."""

    title: str  # what the colors stand for, with its unit
    colors: tuple[str, ...]  # CSS colors from the smallest value to the greatest, evenly spaced
    ticks: tuple[
        tuple[float, str], ...
    ]  # (place, text) of some values, place from 0, the smallest, to 1


@dataclass(frozen=True)
class Mark:
    """Something that is drawn, for the legend."""

    color: str  # CSS color
    text: str  # what it stands for
    kind: str = "area"  # "dot", "line" or "area"


@dataclass(frozen=True)
class Phase:
    """What is being done from some time on."""

    time: float  # in the recording, s
    title: str  # in a few words
    detail: str = ""  # in a sentence; may be empty


@dataclass(frozen=True)
class Overlay:
    """What stands beside a recording."""

    scale: ColorScale | None = None  # of the cells' colors; None for none
    marks: tuple[Mark, ...] = ()  # of the legend
    phases: tuple[Phase, ...] = ()  # in order; none where nothing is recorded


def make_color_scale(obj: GridObject, colors: CellColors) -> ColorScale:
    """The scale of cells' colors: the mass in g where the object was weighed, else shares of the even one."""
    low, high = colors.resolve_limits()
    values = np.geomspace(low, high, SCALE_COLORS)
    places, shown = np.linspace(0.0, 1.0, TICKS), np.geomspace(low, high, TICKS)
    weighed = colors.shows == "mass" and obj.prior.total_mass is not None
    if colors.shows == "friction":
        title = "friction coefficient of a cell"
    elif weighed:
        title = "estimated mass of a cell, g"
        shown = shown * obj.prior.total_mass / obj.n / GRAM  # type: ignore[operator]
    else:
        what = "mass" if colors.shows == "mass" else "friction force"
        title = f"estimated {what} of a cell, in even shares"
    ticks = tuple(
        (float(place), f"{value:.{DIGITS}g}") for place, value in zip(places, shown, strict=True)
    )
    return ColorScale(title, tuple(map(to_hex, colors.calc_colors_of(values))), ticks)


def list_center_marks() -> tuple[Mark, ...]:
    """What stands for the estimated center of mass."""
    return (
        Mark(to_css(CENTER_COLOR), "estimated center of mass", "dot"),
        Mark(to_css(CENTER_COLOR), f"where it may be, {SIGMAS:g} standard deviations"),
    )


def list_estimate_marks() -> tuple[Mark, ...]:
    """What an `EstimateVisualizer` draws."""
    return (
        *list_center_marks(),
        Mark(to_css(PLAN_COLOR), "the push that is commanded", "line"),
        Mark(to_css(PLAN_COLOR), "where it is predicted to leave the object"),
    )


def to_css(color: Rgba) -> str:
    """A color as CSS has it."""
    return str(to_hex((color.r(), color.g(), color.b())))


def add_overlay(page: str, overlay: Overlay) -> str:
    """Inserts an overlay into a page that Meshcat wrote."""
    head, end, tail = page.rpartition(PAGE_END)
    return f"{head}{make_overlay_html(overlay)}{end}{tail}"


def make_overlay_html(overlay: Overlay) -> str:
    """The overlay as a piece of HTML with its style and its script."""
    phases = [[phase.time, phase.title, phase.detail] for phase in overlay.phases]
    return PIECE.substitute(
        phase=PHASE if phases else "",
        legend=_describe_legend(overlay.scale, overlay.marks),
        phases=json.dumps(phases).replace("</", "<\\/"),
    )


def _describe_legend(scale: ColorScale | None, marks: Sequence[Mark]) -> str:
    if scale is None and not marks:
        return ""
    items = "".join(
        f'<li><i class="{escape(mark.kind)}" style="--c:{escape(mark.color)}"></i>{escape(mark.text)}</li>'
        for mark in marks
    )
    return f'<div id="legend">{_describe_scale(scale) if scale else ""}<ul>{items}</ul></div>'


def _describe_scale(scale: ColorScale) -> str:
    ticks = "".join(
        f'<span style="left:{PERCENT * place:.1f}%">{escape(text)}</span>'
        for place, text in scale.ticks
    )
    gradient = f"linear-gradient(to right, {', '.join(map(escape, scale.colors))})"
    bar = f'<div class="bar" style="background:{gradient}"></div>'
    return f'<b>{escape(scale.title)}</b>{bar}<div class="ticks">{ticks}</div>'


PHASE = '<div id="phase"><b></b><span></span><small></small></div>'

PIECE = Template("""
<style>
#phase, #legend { position: fixed; left: 16px; z-index: 1; box-sizing: border-box; padding: 10px 14px; color: #23272e;
  background: rgba(255, 255, 255, 0.88); border-radius: 8px; pointer-events: none;
  font: 14px/1.4 system-ui, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif; }
#phase { top: 16px; max-width: min(34rem, 60vw); }
#phase b { display: block; font-size: 20px; }
#phase span { display: block; }
#phase small { color: #5c6570; font-variant-numeric: tabular-nums; }
#legend { bottom: 16px; width: 24rem; max-width: 60vw; }
#legend .bar { height: 12px; margin: 6px 12px 0; border-radius: 3px; }
#legend .ticks { position: relative; height: 1.5em; margin: 0 12px; font-size: 12px; }
#legend .ticks span { position: absolute; transform: translateX(-50%); white-space: nowrap; }
#legend ul { list-style: none; margin: 4px 0 0; padding: 0; }
#legend li { display: flex; align-items: center; gap: 10px; }
#legend i { flex: none; box-sizing: border-box; width: 20px; height: 12px; background: var(--c); }
#legend i.area { border: 2px solid var(--c); background: color-mix(in srgb, var(--c) 30%, white); }
#legend i.line { height: 4px; }
#legend i.dot { width: 12px; margin: 0 4px; border-radius: 6px; }
</style>
$phase
$legend
<script>
(() => {
  const phases = $phases;
  const box = document.getElementById("phase");
  if (!box) return;
  const [title, detail, clock] = box.children;
  function show() {
    const actions = viewer.animator.actions;
    const time = Math.max(0, ...actions.map(action => action.time));
    const over = actions.length && time >= Math.max(...actions.map(action => action.getClip().duration));
    let now = phases[0];
    for (const phase of phases) if (phase[0] <= time || over) now = phase;
    title.textContent = now[1];
    detail.textContent = now[2];
    clock.textContent = time.toFixed(1) + " s";
  }
  show();
  setInterval(show, 50);
})();
</script>
""")
"""The overlay's HTML, to be filled in."""
