"""Several objects on a table, found in one photograph.

Each piece that stands out from the table and lies all in view is an object. What reaches in over
the picture's border, such as a hand or an arm, is none. Nothing is known of the objects yet, so
that two of them that touch are one piece: where a piece looks like that, it is said to be in doubt.
Objects whose outlines are known are told apart by `scene_tracking`. The theory is in
docs/theory/perception.md, section 2.
"""

from dataclasses import dataclass
from itertools import combinations
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gridpush_drake.errors import NoObjectError, ObjectAtBorderError, PerceptionError
from gridpush_drake.perception.detection.detection import (
    DetectedObject,
    DetectorOptions,
    Photograph,
    is_in_view,
    list_pieces,
    measure_object,
    read_photograph,
)
from gridpush_drake.perception.detection.foreground import dilate, keep_largest, refine_boundary
from gridpush_drake.perception.detection.joint_foreground import (
    CERTAIN_EVIDENCE,
    MAX_MISSED_FRACTION,
    MISSED_GAP,
    NEAR_OBJECT,
    find_jointly,
)
from gridpush_drake.perception.images.camera import Camera
from gridpush_drake.perception.images.drawing import GREEN, draw_contours, draw_number, draw_outline
from gridpush_drake.perception.images.frames import Color, Depth, Mask

OTHERS_MARGIN = 5
"""Width of the brush that widens what belongs to other objects while a boundary is drawn,
pixels."""

HALF_COVERED = 0.5
"""If all evidence together joins more than this fraction of each of two pieces, they may be one
object."""

MIN_NOTCH = 6.0
"""Least depth of a notch between two objects that touch, pixels."""

MIN_HALF = 0.15
"""Each of two objects that touch has at least this fraction of their piece's pixels."""

MORE_SOLID = 0.05
"""Two objects that touch fill at least this much more of their own convex hulls than both together
of theirs, as a fraction."""

OTHER_COLOR = 15.0
"""Least difference of the mean colors of two objects that touch, units of CIE L*a*b*."""

OTHER_HEIGHT = 0.004
"""Least difference of the mean heights of two objects that touch, m."""

DEFECT_STEPS = 256.0
"""OpenCV's unit of the depth of a notch: parts of a pixel."""


@dataclass(frozen=True, eq=False)
class DetectedObjects:
    """All objects that were found in a photograph.

    Attributes:
        objects: the objects, from left to right in the picture.
        cut: number of things that the picture's border cuts, such as a hand; they are left out.
        picture: (height, width, 3) uint8, the undistorted photograph with all outlines, numbered
            from 1.
    """

    objects: tuple[DetectedObject, ...]
    cut: int
    picture: Color


def detect_objects(
    color: Color, depth: Depth | None, camera: Camera, options: DetectorOptions | None = None
) -> DetectedObjects:
    """Finds each of the objects that lie on the table.

    Args:
        color: (height, width, 3) uint8, red, green, blue, as it was taken (distorted).
        depth: (height, width), m, registered to `color`, 0 where it was not measured; None without
            a depth camera.
        camera: camera that took it; X_WC, with the table's top at z = 0, may be left out where
            there is depth.
        options: see `DetectorOptions`; a height is that of all objects. No hint may be given.

    Returns:
        The objects, one or more.

    Raises:
        ImageError: an image has another size than the camera, or depth is not in meters.
        CameraError: neither X_WC nor depth is given.
        NoTableError: no table is in view, or not where X_WC says.
        NoObjectError: there is none on it.
        ObjectAtBorderError: the picture's border cuts all of them.
        PerceptionError: a hint is given, the height is negative, or an object reaches up to the
            camera.
    """
    options = options or DetectorOptions()
    if options.hint is not None:
        raise PerceptionError("hint: is given; expected none where all objects are to be found")
    seen = read_photograph(color, depth, camera, options)
    pieces = list_pieces(seen, options)
    if not pieces:
        raise NoObjectError("no object is in view; expected some on the table", seen.color)
    whole = [piece for piece in pieces if is_in_view(piece)]
    if not whole:
        raise ObjectAtBorderError(
            "everything in view touches the picture's border; expected all of an object in view",
            draw_contours(seen.color, np.logical_or.reduce(pieces)),
        )

    # From left to right, as people number things.
    whole.sort(key=lambda piece: float(np.nonzero(piece)[1].mean()))
    doubtful = _find_doubtful_pieces(seen, pieces, whole, options)
    objects = []
    for piece, is_doubtful in zip(whole, doubtful, strict=True):
        # The boundary is drawn as of one object alone; other objects say nothing of it.
        others = np.logical_or.reduce([each for each in pieces if each is not piece] or [~piece])
        if len(pieces) == 1:
            others = np.zeros_like(piece)
        mask, coverage = refine_boundary(piece, seen.found, dilate(others, OTHERS_MARGIN))
        mask = keep_largest(mask & ~others)
        coverage = np.where(dilate(mask, 3), coverage, np.float32(0))
        crowded = may_be_two(mask, seen)
        objects.append(measure_object(seen, mask, coverage, options, is_doubtful, crowded))
    return DetectedObjects(
        objects=tuple(objects),
        cut=len(pieces) - len(whole),
        picture=_draw(seen, objects),
    )


def _find_doubtful_pieces(
    seen: Photograph, pieces: list[Mask], whole: list[Mask], options: DetectorOptions
) -> list[bool]:
    """Says of which objects all evidence together tells something else than their pieces.

    Args:
        seen: the photograph.
        pieces: everything that stands out.
        whole: the pieces that are objects.
        options: what is looked at.

    Returns:
        For each object whether it lacks a part that is surely object, or may be one with another
        piece.
    """
    doubtful = [False] * len(whole)
    if seen.plane is None or options.cues != "both":
        return doubtful
    joint = find_jointly(seen.color, seen.plane, seen.found, seen.painted)
    if joint is None:
        return doubtful
    # What is surely object and in no piece, and which pieces are one by all evidence together.
    everything = np.logical_or.reduce(pieces)
    missed = (joint.evidence > CERTAIN_EVIDENCE) & ~dilate(everything, MISSED_GAP)
    joined = [(joint.mask & piece).sum() > HALF_COVERED * piece.sum() for piece in whole]
    for i, piece in enumerate(whole):
        lacks = (missed & dilate(piece, NEAR_OBJECT)).sum() > MAX_MISSED_FRACTION * piece.sum()
        doubtful[i] = bool(lacks or (joined[i] and sum(joined) > 1))
    return doubtful


def may_be_two(mask: Mask, seen: Photograph) -> bool:
    """Says whether a piece may be two objects that touch.

    Between two objects that touch there are two notches. A cut from one notch to the other leaves
    two shapes that are more solid, and that differ in color or in height. A tool of one material
    may have such a shape, too; one of two materials is doubted without need.

    Args:
        mask: (height, width) bool, the piece.
        seen: the photograph.

    Returns:
        Whether there is such a cut.
    """
    contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not contours:
        return False
    contour = max(contours, key=cv2.contourArea)
    hull = cv2.convexHull(contour, returnPoints=False)
    try:
        defects = cv2.convexityDefects(contour, hull)
    except cv2.error:
        # OpenCV refuses contours that cross themselves; such a piece is no two solid shapes.
        return False
    if defects is None:
        return False
    # Notches: where the contour is farthest from its convex hull.
    corners = contour.reshape(-1, 2)
    notches = [
        corners[farthest]
        for _, _, farthest, depth in defects.reshape(-1, 4)
        if depth > MIN_NOTCH * DEFECT_STEPS
    ]
    # Any two of them may be the ends of the line along which two objects touch.
    together = mask.sum() / _calc_hull_area(mask)
    for a, b in combinations(notches, 2):
        halves = _cut(mask, a, b)
        if halves is None:
            continue
        hulls = sum(_calc_hull_area(half) for half in halves)
        solid = sum(int(half.sum()) for half in halves) / hulls
        if solid > together + MORE_SOLID and _differ(halves, seen):
            return True
    return False


def _cut(mask: Mask, a: NDArray[Any], b: NDArray[Any]) -> tuple[Mask, Mask] | None:
    """Cuts a piece along the line between two pixels; None where that leaves no two large parts."""
    cut = mask.astype(np.uint8)
    cv2.line(cut, (int(a[0]), int(a[1])), (int(b[0]), int(b[1])), 0, 2)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(cut, connectivity=4)
    large = [i for i in range(1, count) if stats[i, cv2.CC_STAT_AREA] >= MIN_HALF * mask.sum()]
    if len(large) != 2:
        return None
    return labels == large[0], labels == large[1]


def _calc_hull_area(mask: Mask) -> float:
    """Calculates the area of a mask's convex hull, pixels."""
    rows, columns = np.nonzero(mask)
    points = np.stack([columns, rows], axis=-1).astype(np.int32)
    hull = cv2.convexHull(points)
    # Pixels are counted by their middles; half a pixel is missing all around.
    return float(cv2.contourArea(hull) + cv2.arcLength(hull, True) / 2 + 1)


def _differ(halves: tuple[Mask, Mask], seen: Photograph) -> bool:
    """Says whether two parts of a piece differ in color or in height."""
    # Medians, as print and holes in depth are no matter of the whole.
    colors = [np.median(seen.found.difference[half], axis=0) for half in halves]
    if np.linalg.norm(colors[0] - colors[1]) > OTHER_COLOR:
        return True
    if seen.plane is None:
        return False
    heights = []
    for half in halves:
        measured = seen.plane.heights[half]
        measured = measured[np.isfinite(measured)]
        heights.append(float(np.median(measured)) if len(measured) else 0.0)
    return abs(heights[0] - heights[1]) > OTHER_HEIGHT


def _draw(seen: Photograph, objects: list[DetectedObject]) -> Color:
    """Draws all objects into a photograph, numbered from 1."""
    picture = seen.color
    for each in objects:
        picture = draw_contours(picture, each.mask, GREEN)
        picture = draw_outline(picture, seen.camera, each.outline, 0.0, each.X_WB)
    for number, each in enumerate(objects, start=1):
        rows, columns = np.nonzero(each.mask)
        picture = draw_number(picture, number, (columns.mean(), rows.mean()))
    return picture
