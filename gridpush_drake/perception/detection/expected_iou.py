"""How good an outline found in one photograph is expected to be, told from the photograph alone.

The figure is the intersection over union (IoU) with the object's true mask. Two things tell most:
whether a stricter threshold on what stands out from the table gives the same mask, and how much of
the outline lies on an edge in the picture. A logistic function of both is the expected IoU. It was
fitted to photographs of the generator's tuning half; `docs/measurements/perception.md` has the
figures on the other half. It takes 10 to 30 ms.
"""

import cv2
import numpy as np

from gridpush_drake.perception.detection.foreground import Foreground, Mask, dilate, erode

DOUBTFUL_IOU = 0.9
"""An outline whose expected intersection over union with the true one is less is doubtful."""

WEIGHTS = (-1.51, 2.74, 1.58)
"""Constant, weight of the agreement with a stricter threshold, and weight of the outline's fraction
that lies on edges, in the log odds of the expected IoU. Fitted to 74 generated photographs by least
absolute deviations to the power of 1.5, with both inputs kept near their means by a weak ridge."""

STRICT_SCORE = 1.5
"""Score of the stricter threshold; the finder's own is 0, see `foreground`."""

EDGE_FACTOR = 6.0
"""A pixel is on an edge if the gradient of its color is more than this many times the median one on
the table nearby."""

NEARBY = 40
"""Width of the strip about an object in which the table's gradient is taken, pixels."""

TABLE_GAP = 15
"""Width of the brush that keeps the object's own rim out of that gradient, pixels."""


def expect_iou(mask: Mask, found: Foreground) -> float:
    """Says which intersection over union with the true mask is to be expected, 0 to 1.

    Args:
        mask: (height, width) bool, the pixels that are taken for the object.
        found: foreground of the picture.

    Returns:
        The expected IoU; 0 for an empty mask.
    """
    if not mask.any():
        return 0.0
    # Everything is told from the object and the table near it.
    x, y, width, height = cv2.boundingRect(mask.astype(np.uint8))
    rows = slice(max(y - NEARBY, 0), y + height + NEARBY)
    columns = slice(max(x - NEARBY, 0), x + width + NEARBY)
    near = mask[rows, columns]

    # A mask that a little more doubt would change is a poor one.
    strict = found.score[rows, columns] > STRICT_SCORE
    agreement = (strict & near).sum() / (strict | near).sum()

    # Where no edge is near the outline, it was drawn by chance.
    difference = np.ascontiguousarray(found.difference[rows, columns])
    across = cv2.Sobel(difference, cv2.CV_32F, 1, 0, ksize=3)
    down = cv2.Sobel(difference, cv2.CV_32F, 0, 1, ksize=3)
    gradient = np.sqrt((across**2 + down**2).sum(axis=-1)).astype(np.float32)
    table = ~dilate(near, TABLE_GAP)
    on_edge = 0.0
    if table.any():
        # An edge beside the outline counts, too.
        steepest = cv2.dilate(gradient, np.ones((3, 3), np.uint8))
        rim = dilate(near, 3) & ~erode(near, 3)
        on_edge = float((steepest[rim] > EDGE_FACTOR * np.median(gradient[table])).mean())

    # The logistic function of both.
    constant, of_agreement, of_edges = WEIGHTS
    log_ratio = constant + of_agreement * agreement + of_edges * on_edge
    return float(1 / (1 + np.exp(-log_ratio)))
