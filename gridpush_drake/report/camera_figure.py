"""What a robot's camera saw: the photograph with the outline found, and how far off the poses tracked were."""

from dataclasses import dataclass, replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from gridpush_drake.geometry.se2 import Array
from gridpush_drake.report.draw import FAINT, FONT, INK, LEARNED, MM, PAGE_WIDTH, make_grid, tidy

DEGREES = 180 / np.pi

PHOTOGRAPH_HEIGHT, TRACK_HEIGHT = 3.9, 2.2
"""Inches."""

BAND = 2.0
"""Standard deviations that the band about zero is wide, either way: 95 % of the errors belong into
it."""

CLIP, SHOWN = 3.0, 95
"""What is drawn: so many times the percentile of the errors."""


@dataclass(frozen=True, eq=False)
class Sight:
    """What the camera saw in a run.

    Attributes:
        picture: (height, width, 3) uint8, of the photograph what is near the object, with the
            outline found.
        t: (K,) times, s.
        errors: (K, 3) poses tracked less the true ones, (x, y, theta), m and rad; NaN where the
            object was not seen.
        std: (K, 3) as the tracker says, m and rad.
    """

    picture: NDArray[np.uint8]
    t: Array
    errors: Array
    std: Array

    @property
    def seen(self) -> NDArray[np.bool_]:
        """(K,) whether the object was seen."""
        return np.asarray(np.isfinite(self.errors).all(axis=1))

    def calc_rms(self) -> tuple[float, float]:
        """Root mean square error of the position, m, and of the angle, rad, where it was seen; NaN where never."""
        errors = self.errors[self.seen]
        if not len(errors):
            return float("nan"), float("nan")
        position, angle = np.square(errors[:, :2]).sum(axis=1), np.square(errors[:, 2])
        return float(np.sqrt(position.mean())), float(np.sqrt(angle.mean()))

    def until(self, time: float) -> "Sight":
        """What it saw before a time, s."""
        before = self.t < time
        return replace(self, t=self.t[before], errors=self.errors[before], std=self.std[before])

    def describe(self) -> str:
        """The figure's caption."""
        position, angle = self.calc_rms()
        return (
            f"The object was seen in {self.seen.mean() * 100:.0f} % of the pictures, its pose wrong by "
            f"{position * MM:.2f} mm and {angle * DEGREES:.2f} degrees root mean square. Above, the photograph and the "
            "outline found, on the table in blue and on top in green; below, the poses less the true ones, and twice "
            "the standard deviation that the tracker states."
        )


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
    errors, std = sight.errors[:, column] * scale, BAND * sight.std[:, column] * scale
    ax.fill_between(sight.t, -std, std, color=FAINT, alpha=0.4, linewidth=0)
    ax.plot(sight.t, errors, ".", color=color, markersize=2, label=label)
