"""Draws what a robot's camera saw: the photograph, and how far off the tracked poses were."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gridpush_drake.perception.images.camera_view import CameraView
from gridpush_drake.perception.images.drawing import AXIS_LENGTH
from gridpush_drake.report.draw import (
    FAINT_COLOR,
    FONT_SIZE,
    INK_COLOR,
    LEARNED_COLOR,
    PAGE_WIDTH,
    make_grid,
    tidy,
)
from gridpush_drake.units import DEG_PER_RAD, MM_PER_M

PHOTOGRAPH_HEIGHT = 3.9
"""Height of the photograph, inches."""

TRACK_HEIGHT = 2.2
"""Height of a panel with errors, inches."""

BAND_SIGMAS = 2.0
"""Half width of the band about zero, in standard deviations: 95 % of the errors belong into it."""

AXIS_PERCENTILE = 95
"""Percentile of the errors by which the axes are scaled."""

AXIS_FACTOR = 3.0
"""End of the axes, in that percentile. Larger errors are not seen."""


def draw_camera_view(view: CameraView) -> Figure:
    """Draws the photograph, and the errors of what was tracked below it."""
    figure, axes = make_grid(3, 1, PAGE_WIDTH, (PHOTOGRAPH_HEIGHT + 2 * TRACK_HEIGHT) / 3)
    photograph, position, angle = axes.ravel()
    grid = photograph.get_gridspec()
    grid.set_height_ratios([PHOTOGRAPH_HEIGHT, TRACK_HEIGHT, TRACK_HEIGHT])
    photograph.imshow(view.picture, interpolation="antialiased")
    photograph.set_axis_off()
    for column, label, color in ((0, "x", LEARNED_COLOR), (1, "y", INK_COLOR)):
        _draw_errors(position, view, column, MM_PER_M, color, label)
    _draw_errors(angle, view, 2, DEG_PER_RAD, LEARNED_COLOR, "theta")
    # A few lost pictures must not hide all others.
    for ax, columns, scale in (
        (position, slice(0, 2), MM_PER_M),
        (angle, slice(2, 3), DEG_PER_RAD),
    ):
        errors = view.errors[view.seen, columns]
        limit = (
            AXIS_FACTOR * scale * float(np.percentile(np.abs(errors), AXIS_PERCENTILE))
            if errors.size
            else 0.0
        )
        if limit > 0:
            ax.set_ylim(-limit, limit)
    position.legend(loc="upper right", frameon=False, ncols=2, fontsize=FONT_SIZE, markerscale=4)
    tidy(position, "", "error, mm")
    tidy(angle, "time, s", "error, degrees")
    return figure


def _draw_errors(
    ax: Axes, view: CameraView, column: int, scale: float, color: str, label: str
) -> None:
    """Draws the errors of one coordinate, and the band that the tracker states."""
    errors = view.errors[:, column] * scale
    std = BAND_SIGMAS * view.std[:, column] * scale
    ax.fill_between(view.t, -std, std, color=FAINT_COLOR, alpha=0.4, linewidth=0)
    ax.plot(view.t, errors, ".", color=color, markersize=2, label=label)


def describe_camera_view(view: CameraView) -> str:
    """Writes the caption of `draw_camera_view`."""
    position, angle = view.calc_rms()
    return (
        f"The object was seen in {view.seen.mean() * 100:.0f} % of the pictures, its pose wrong "
        f"by {position * MM_PER_M:.2f} mm and {angle * DEG_PER_RAD:.2f} degrees root mean square. "
        "Above, the "
        "photograph and the outline found, on the table in blue and on top in green, with the axes "
        f"of the body frame, x in red and y in green, {AXIS_LENGTH * MM_PER_M:.0f} mm long; "
        "below, the poses "
        "less the true ones, and twice the standard deviation that the tracker states."
    )
