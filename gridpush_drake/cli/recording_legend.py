"""What stands beside the recordings of `gridpush demo` and `gridpush view`: their color scale and legend."""

import numpy as np
from matplotlib.colors import to_hex
from pydrake.geometry import Rgba

from gridpush_drake.multibody.cell_colors import CellColors
from gridpush_drake.multibody.meshcat_shapes import CENTER_COLOR, PLAN_COLOR
from gridpush_drake.multibody.recording_overlay import ColorScale, Mark
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.systems.estimate_visualizer import SIGMAS

COLORS = 17
"""Of a scale; the page blends between them."""

TICKS = 5

GRAM = 1e-3

DIGITS = 2
"""Of a tick's value."""


def describe_scale(obj: GridObject, colors: CellColors) -> ColorScale:
    """The scale of cells' colors: the mass in g where the object was weighed, else shares of the even one."""
    least, greatest = colors.resolve_limits()
    values = np.geomspace(least, greatest, COLORS)
    places = np.linspace(0.0, 1.0, TICKS)
    shown = np.geomspace(least, greatest, TICKS)
    weighed = colors.shows == "mass" and obj.prior.total_mass is not None
    if colors.shows == "friction":
        title = "friction coefficient of a cell"
    elif weighed:
        title = "estimated mass of a cell, g"
        shown = shown * obj.prior.total_mass / obj.n / GRAM  # type: ignore[operator]
    else:
        what = "mass" if colors.shows == "mass" else "friction force"
        title = f"estimated {what} of a cell, in even shares"
    ticks = tuple((float(place), f"{value:.{DIGITS}g}") for place, value in zip(places, shown, strict=True))
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
