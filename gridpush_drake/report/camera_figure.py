"""Draws what a robot's camera saw: the photograph, and how far off the tracked poses were."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gridpush_drake.perception.drawing import AXIS
from gridpush_drake.perception.sight import Sight
from gridpush_drake.report.draw import FAINT, FONT, INK, LEARNED, MM, PAGE_WIDTH, make_grid, tidy

DEGREES = 180 / np.pi

PHOTOGRAPH_HEIGHT = 3.9
"""Height of the photograph, inches."""

TRACK_HEIGHT = 2.2
"""Height of a panel with errors, inches."""

BAND = 2.0
"""Half width of the band about zero, in standard deviations: 95 % of the errors belong into it."""

SHOWN = 95
"""Percentile of the errors by which the axes are scaled."""

CLIP = 3.0
"""End of the axes, in that percentile. Larger errors are not seen."""


def draw_sight(sight: Sight) -> Figure:
    """Draws the photograph, and the errors of what was tracked below it."""
    figure, axes = make_grid(3, 1, PAGE_WIDTH, (PHOTOGRAPH_HEIGHT + 2 * TRACK_HEIGHT) / 3)
    photograph, position, angle = axes.ravel()
    grid = photograph.get_gridspec()
    grid.set_height_ratios([PHOTOGRAPH_HEIGHT, TRACK_HEIGHT, TRACK_HEIGHT])
    photograph.imshow(sight.picture, interpolation="antialiased")
    photograph.set_axis_off()
    for column, label, color in ((0, "x", LEARNED), (1, "y", INK)):
        _draw_errors(position, sight, column, MM, color, label)
    _draw_errors(angle, sight, 2, DEGREES, LEARNED, "theta")
    # A few lost pictures must not hide all others.
    for ax, columns, scale in ((position, slice(0, 2), MM), (angle, slice(2, 3), DEGREES)):
        errors = sight.errors[sight.seen, columns]
        limit = CLIP * scale * float(np.percentile(np.abs(errors), SHOWN)) if errors.size else 0.0
        if limit > 0:
            ax.set_ylim(-limit, limit)
    position.legend(loc="upper right", frameon=False, ncols=2, fontsize=FONT, markerscale=4)
    tidy(position, "", "error, mm")
    tidy(angle, "time, s", "error, degrees")
    return figure


def _draw_errors(ax: Axes, sight: Sight, column: int, scale: float, color: str, label: str) -> None:
    """Draws the errors of one coordinate, and the band that the tracker states."""
    errors = sight.errors[:, column] * scale
    std = BAND * sight.std[:, column] * scale
    ax.fill_between(sight.t, -std, std, color=FAINT, alpha=0.4, linewidth=0)
    ax.plot(sight.t, errors, ".", color=color, markersize=2, label=label)


def describe_sight(sight: Sight) -> str:
    """Writes the caption of `draw_sight`."""
    position, angle = sight.calc_rms()
    return (
        f"The object was seen in {sight.seen.mean() * 100:.0f} % of the pictures, its pose wrong "
        f"by {position * MM:.2f} mm and {angle * DEGREES:.2f} degrees root mean square. Above, the "
        "photograph and the outline found, on the table in blue and on top in green, with the axes "
        f"of the body frame, x in red and y in green, {AXIS * MM:.0f} mm long; below, the poses "
        "less the true ones, and twice the standard deviation that the tracker states."
    )
