"""Poses at which a known outline may lie, guessed from what is object in a whole picture.

Each guess is then registered by `tracking`. Where a piece of the foreground is about as large as
the object's silhouette, the object lies on its middle, and only the angle is tried. A larger piece
may be several objects that touch, or an object and a hand: there the silhouette is slid over the
piece, and lies well where it is filled and what is just outside of it is not.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from gridpush_drake.geometry.se2 import Array, wrap_angle
from gridpush_drake.perception.images.camera import Camera
from gridpush_drake.perception.images.frames import Mask
from gridpush_drake.perception.images.pixel_kernels import EDGE_COVERAGE
from gridpush_drake.perception.tracking.registration import Registration, View

MAX_PIECES = 4
"""A search everywhere tries this many pieces of the foreground, the largest first."""

ANGLES_TRIED = 48
"""A search everywhere tries this many angles with each piece, evenly over a full turn."""

MAX_CANDIDATES = 5
"""A search everywhere registers this many of the poses it tried, those with the largest overlap."""

COARSE_PIXEL_SIZE = 4
"""Side of the pixels on which a search everywhere compares shapes, in pixels of the picture."""

MIN_OVERLAP = 0.35
"""A pose whose silhouette has a smaller intersection over union with the foreground is not
registered in a search everywhere."""

CROWDED_AREA_FACTOR = 1.25
"""A piece of the foreground that is larger than the object's silhouette by this factor may be
several objects that touch."""

OUTSIDE_WEIGHT = 0.5
"""Weight of the foreground just outside of a silhouette, against that inside, where it is slid."""

MIN_FIT = 0.55
"""Least share inside less weighted share outside of a pose that is registered after sliding; where
nothing else touches the object it is nearly 1."""

TURNS_TRIED = 7
"""A search nearby tries this many angles, evenly over those that an object turns between two
pictures."""

MAX_NEARBY = 3
"""A search nearby gives this many poses."""

COVERED_PIXEL_WEIGHT = 0.5
"""How much of a pixel counts as object that something covers."""

SAME_PLACE = 3.0
"""Two guesses that are less than this apart, and that are turned by about the same, are one, coarse
pixels."""

SAME_TURN = 0.2
"""Angle up to which two guesses are turned by about the same, rad."""


def guess_poses(
    view: View, registration: Registration, camera: Camera, height: float
) -> list[Array]:
    """Lists poses at which a silhouette looks most like the foreground.

    Args:
        view: what is object in the whole picture.
        registration: knows the object's silhouettes.
        camera: camera without distortion, with X_WC.
        height: height of the object, m.

    Returns:
        Poses (3,), the best first; none where nothing looks like the object.
    """
    # Shapes are compared on coarse pixels: many poses are tried, and none need be exact.
    fine = (view.mask & ~view.covered).astype(np.float32)
    scale = 1 / COARSE_PIXEL_SIZE
    small = cv2.resize(fine, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA) > EDGE_COVERAGE
    count, labels, stats, middles = cv2.connectedComponentsWithStats(
        small.astype(np.uint8), connectivity=8
    )
    if count < 2:
        return []

    tried: list[tuple[float, Array]] = []
    slid: list[tuple[float, Array]] = []
    area = stats[1:, cv2.CC_STAT_AREA]
    largest = np.argsort(-area)[:MAX_PIECES]
    for piece in 1 + largest:
        # A piece's middle is about where the object's is, at half of its height.
        middle = (middles[piece] + EDGE_COVERAGE) * COARSE_PIXEL_SIZE - EDGE_COVERAGE + view.corner
        at = camera.cast(middle, height / 2)
        if not np.isfinite(at).all():
            continue
        sizes = []
        for theta in np.arange(ANGLES_TRIED) * (2 * np.pi / ANGLES_TRIED):
            pose = _center(registration, np.array([*at, theta]))
            painted = _paint(registration, camera, pose, view.corner, small.shape)
            sizes.append(np.count_nonzero(painted))
            common = np.count_nonzero(painted & (labels == piece))
            either = sizes[-1] + area[piece - 1] - common
            tried.append((common / either, pose))
        if area[piece - 1] > CROWDED_AREA_FACTOR * np.median(sizes):
            slid += _slide(labels == piece, view, registration, camera, height, at)

    tried.sort(key=lambda entry: -entry[0])
    best = [pose for overlap, pose in tried[:MAX_CANDIDATES] if overlap >= MIN_OVERLAP]
    slid.sort(key=lambda entry: -entry[0])
    best += [pose for fit, pose in slid[:MAX_CANDIDATES] if fit >= MIN_FIT]
    return best


def guess_nearby(
    view: View,
    registration: Registration,
    camera: Camera,
    height: float,
    pose: Array,
    reach: tuple[float, float],
) -> list[Array]:
    """Lists poses near another one at which a silhouette looks most like the foreground.

    Args:
        view: what is object in a part of the picture.
        registration: knows the object's silhouettes.
        camera: camera without distortion, with X_WC.
        height: height of the object, m.
        pose: (3,) the other pose, W, m and rad.
        reach: how far the object may be from it, m, and how far turned, rad.

    Returns:
        Poses (3,), the best first.
    """
    # The part of the picture on coarse pixels: object, table, or unknown.
    shown = np.where(view.covered, COVERED_PIXEL_WEIGHT, view.mask).astype(np.float32)
    scale = 1 / COARSE_PIXEL_SIZE
    small = cv2.resize(shown, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    centroid = np.array(registration.make_silhouette(pose).centroid.coords[0])
    max_step, max_turn = reach

    tried: list[tuple[float, Array]] = []
    for turn in np.linspace(-max_turn, max_turn, TURNS_TRIED):
        # The silhouette turned about its middle, slid over the part within reach.
        turned = pose + [0.0, 0.0, turn]
        middle = np.array(registration.make_silhouette(turned).centroid.coords[0])
        turned[:2] += centroid - middle
        painted = _paint(registration, camera, turned, view.corner, small.shape)
        if not painted.any():
            continue
        kernel, anchor = _make_kernel(painted)
        fit = cv2.filter2D(small, cv2.CV_32F, kernel, anchor=anchor, borderType=cv2.BORDER_CONSTANT)
        rows, columns = np.nonzero(painted)
        here = np.array([columns.mean(), rows.mean()])
        pixels_a_meter = camera.K[0, 0] / camera.center[2] / COARSE_PIXEL_SIZE
        y, x = np.ogrid[: small.shape[0], : small.shape[1]]
        far = np.hypot(x - here[0], y - here[1]) > max_step * pixels_a_meter
        fit[far] = -1.0
        _, value, _, place = cv2.minMaxLoc(fit)

        # From the silhouette's middle in the picture to there, on the table.
        ends = (
            (np.array([here, place]) + EDGE_COVERAGE) * COARSE_PIXEL_SIZE
            - EDGE_COVERAGE
            + view.corner
        )
        start, end = camera.cast(ends, height / 2)
        if np.isfinite(end).all():
            tried.append((value, turned + [*(end - start), 0.0]))
    tried.sort(key=lambda entry: -entry[0])
    return [guess for _, guess in tried[:MAX_NEARBY]]


def _slide(
    piece: Mask,
    view: View,
    registration: Registration,
    camera: Camera,
    height: float,
    at: Array,
) -> list[tuple[float, Array]]:
    """Slides a silhouette over a piece of the foreground, at each angle.

    Args:
        piece: (m, n) bool, the piece on coarse pixels.
        view: what is object in the whole picture.
        registration: knows the object's silhouettes.
        camera: camera without distortion, with X_WC.
        height: height of the object, m.
        at: (2,) where the silhouettes are taken, W, m: on the piece, so that little of the
            perspective changes.

    Returns:
        How well each guess fits, and the guesses, the best first and each only once.
    """
    image = piece.astype(np.float32)
    tried: list[tuple[float, float, float, float]] = []
    for theta in np.arange(ANGLES_TRIED) * (2 * np.pi / ANGLES_TRIED):
        pose = _center(registration, np.array([*at, theta]))
        painted = _paint(registration, camera, pose, view.corner, piece.shape)
        kernel, anchor = _make_kernel(painted)
        fit = cv2.filter2D(image, cv2.CV_32F, kernel, anchor=anchor, borderType=cv2.BORDER_CONSTANT)
        # The best place of each angle, and the best that is far from it.
        for _ in range(2):
            _, value, _, place = cv2.minMaxLoc(fit)
            tried.append((value, float(place[0]), float(place[1]), theta))
            cv2.circle(fit, place, round(2 * SAME_PLACE), -1.0, -1)

    # Of neighboring angles and places only the best is kept.
    tried.sort(key=lambda entry: -entry[0])
    found: list[tuple[float, Array]] = []
    kept: list[tuple[float, float, float]] = []
    for value, x, y, theta in tried:
        if any(
            np.hypot(x - other_x, y - other_y) < SAME_PLACE
            and abs(wrap_angle(theta - other_theta)) < SAME_TURN
            for other_x, other_y, other_theta in kept
        ):
            continue
        kept.append((x, y, theta))
        middle = (
            (np.array([x, y]) + EDGE_COVERAGE) * COARSE_PIXEL_SIZE - EDGE_COVERAGE + view.corner
        )
        on_table = camera.cast(middle, height / 2)
        if np.isfinite(on_table).all():
            found.append((value, _center(registration, np.array([*on_table, theta]))))
        if len(found) == MAX_CANDIDATES:
            break
    return found


def _make_kernel(painted: Mask) -> tuple[NDArray[np.float32], tuple[int, int]]:
    """Makes what is slid: a silhouette less a rim about it.

    Args:
        painted: (m, n) bool, the silhouette on coarse pixels.

    Returns:
        The kernel, and its point (x, y) on the silhouette's middle.
    """
    # The rim begins one coarse pixel outside, for the silhouette's own border is uncertain.
    x, y, width, height = cv2.boundingRect(painted.astype(np.uint8))
    inside = np.pad(painted[y : y + height, x : x + width], 2).astype(np.uint8)
    brush = np.ones((3, 3), np.uint8)
    rim = cv2.dilate(inside, brush, iterations=2) - cv2.dilate(inside, brush)
    kernel = inside / max(1, inside.sum()) - OUTSIDE_WEIGHT * rim / max(1, rim.sum())
    rows, columns = np.nonzero(inside)
    anchor = (round(float(columns.mean())), round(float(rows.mean())))
    return kernel.astype(np.float32), anchor


def _center(registration: Registration, pose: Array) -> Array:
    """Moves a pose (3,) so that the silhouette's middle, not the body's origin, is where it is."""
    centroid = registration.make_silhouette(pose).centroid
    moved = pose.copy()
    moved[:2] += pose[:2] - np.array(centroid.coords[0])
    return moved


def _paint(
    registration: Registration, camera: Camera, pose: Array, corner: Array, shape: tuple[int, ...]
) -> Mask:
    """Paints the silhouette at a pose (3,) on coarse pixels of this shape."""
    painted = np.zeros(shape, np.uint8)
    points = np.array(registration.make_silhouette(pose).exterior.coords)
    on_table = np.column_stack([points, np.zeros(len(points))])
    pixels = camera.project(on_table) - corner
    coarse = (pixels + EDGE_COVERAGE) / COARSE_PIXEL_SIZE - EDGE_COVERAGE
    cv2.fillPoly(painted, [np.round(coarse).astype(np.int32)], 1)
    return painted > 0
