"""Connected pieces of a mask, found from its runs of pixels, so that memory goes with the outline, not the area."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

STRIP_PIXELS = 4_000_000
"""Pixels looked at in one go."""


@dataclass(frozen=True)
class Runs:
    """Horizontal runs of object pixels, in reading order.

    Attributes:
        row: (k,) of each run.
        start: (k,) its first column.
        stop: (k,) the column after its last.
    """

    row: NDArray[np.int64]
    start: NDArray[np.int64]
    stop: NDArray[np.int64]

    @property
    def length(self) -> NDArray[np.int64]:
        """(k,) pixels."""
        return self.stop - self.start


def find_runs(labels: NDArray[np.uint16]) -> Runs:
    """Finds the runs of pixels that are not 0 in (height, width) `labels`."""
    height, width = labels.shape
    step = max(1, STRIP_PIXELS // width)
    found: list[list[NDArray[np.int64]]] = [[], [], []]
    for top in range(0, height, step):
        solid = np.pad(labels[top : top + step] != 0, ((0, 0), (1, 1)))
        row, start = np.nonzero(solid[:, 1:] & ~solid[:, :-1])
        stop = np.nonzero(solid[:, :-1] & ~solid[:, 1:])[1]
        for column, part in zip(found, (row + top, start, stop), strict=True):
            column.append(part)
    return Runs(*(np.concatenate(column) for column in found))


def find_pieces(runs: Runs, width: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Groups runs into pieces that touch along a side or at a corner (8-connectivity).

    Args:
        runs: in reading order.
        width: of the image, pixels.

    Returns:
        (k,) the piece of each run, and (pieces,) their sizes, pixels.
    """
    # Places on one line, with room between rows: a run meets those of the next row whose places overlap its own.
    stride = width + 2
    start, stop = runs.row * stride + runs.start, runs.row * stride + runs.stop
    first = np.searchsorted(stop, start + stride, side="left")
    last = np.searchsorted(start, stop + stride, side="right")
    count = np.maximum(last - first, 0)
    upper = np.repeat(np.arange(len(start)), count)
    lower = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count) + np.repeat(first, count)
    graph = coo_array((np.ones(len(upper), dtype=bool), (upper, lower)), shape=(len(start), len(start)))
    piece = connected_components(graph, directed=False)[1].astype(np.int64)
    return piece, np.bincount(piece, weights=runs.length).astype(np.int64)


def erase(labels: NDArray[np.uint16], runs: Runs, unwanted: NDArray[np.bool_]) -> None:
    """Sets the pixels of the unwanted runs to background, in place."""
    width = labels.shape[1]
    length = runs.length[unwanted]
    start = (runs.row * width + runs.start)[unwanted]
    offset = np.arange(length.sum()) - np.repeat(np.cumsum(length) - length, length)
    labels.ravel()[np.repeat(start, length) + offset] = 0
