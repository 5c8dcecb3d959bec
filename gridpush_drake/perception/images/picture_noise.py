"""The noise of a camera's pictures, for pictures that are rendered without any.

A normal random number is a quantile of the normal distribution, taken from a table of 2^16 by a
random number of 16 bits. The table ends at 4.3 standard deviations, where one number in 65536 lies;
against rounding to 8 bits that is nothing, and it takes a fifth of the time.
"""

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from gridpush_drake.dynamics.kernels.compiled import kernel

MAX_COLOR = 255
"""Greatest value of a color."""

QUANTILE_COUNT = 2**16
"""Number of quantiles in the table of the normal distribution."""


@cache
def make_quantiles() -> NDArray[np.float32]:
    """Makes a table (QUANTILE_COUNT,) of the standard normal distribution, one for all 16 bits."""
    fractions = (np.arange(QUANTILE_COUNT) + 0.5) / QUANTILE_COUNT
    table = ndtri(fractions).astype(np.float32)
    table.setflags(write=False)
    return table


def add_color_noise(
    rendered: NDArray[np.uint8],
    exposure: float,
    deviation: float,
    rng: np.random.Generator,
    noisy: NDArray[np.uint8],
) -> None:
    """Makes a picture brighter by a factor, and adds noise to each value of its colors.

    Args:
        rendered: (height, width, channels) picture; channels beyond the third are copied.
        exposure: the factor.
        deviation: standard deviation of the noise, of 255.
        rng: generator of the noise.
        noisy: (height, width, channels) is filled.
    """
    rows, columns = rendered.shape[:2]
    drawn = rng.integers(QUANTILE_COUNT, size=(rows, columns, 3), dtype=np.uint16)
    scaled = make_quantiles() * np.float32(deviation)
    fill_noisy_color(rendered, np.float32(exposure), drawn, scaled, noisy)


def add_depth_noise(
    z: NDArray[np.float32],
    measured: NDArray[np.bool_],
    deviation: float,
    rng: np.random.Generator,
    noisy: NDArray[np.float32],
) -> None:
    """Adds noise to depth that grows with the square of the depth.

    Args:
        z: (height, width) depth, m.
        measured: (height, width) where it is measured; elsewhere it becomes 0.
        deviation: standard deviation at a depth of 1 m, m.
        rng: generator of the noise.
        noisy: (height, width) is filled, m; nothing in it is negative.
    """
    drawn = rng.integers(QUANTILE_COUNT, size=z.shape, dtype=np.uint16)
    scaled = make_quantiles() * np.float32(deviation)
    fill_noisy_depth(z, measured, drawn, scaled, noisy)


@kernel(allocates=False)
def fill_noisy_color(rendered: Any, exposure: Any, drawn: Any, quantiles: Any, noisy: Any) -> None:
    """Fills a noisy picture; see `add_color_noise`."""
    half = np.float32(0.5)
    for row in range(rendered.shape[0]):
        for column in range(rendered.shape[1]):
            for i in range(3):
                noise = quantiles[drawn[row, column, i]]
                value = exposure * np.float32(rendered[row, column, i]) + noise + half
                noisy[row, column, i] = np.uint8(min(max(value, np.float32(0)), MAX_COLOR))
            for i in range(3, rendered.shape[2]):
                noisy[row, column, i] = rendered[row, column, i]


@kernel(allocates=False)
def fill_noisy_depth(z: Any, measured: Any, drawn: Any, quantiles: Any, noisy: Any) -> None:
    """Fills a noisy depth picture; see `add_depth_noise`."""
    for row in range(z.shape[0]):
        for column in range(z.shape[1]):
            noisy[row, column] = 0.0
            if measured[row, column]:
                depth = z[row, column]
                value = depth + depth * depth * quantiles[drawn[row, column]]
                noisy[row, column] = max(value, np.float32(0))
