"""The table in a picture: where it is, where it is not, and what covers it.

Depth shows the table's plane, or the camera's pose X_WC says where it is; where both do, they must
agree. What covers the table, such as the arm, is painted over. What lies on the table is found in
`detection`.
"""

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from gridpush_drake.errors import CameraError, NoTableError
from gridpush_drake.perception.images.camera import Camera
from gridpush_drake.perception.images.frames import Color, Depth, Mask
from gridpush_drake.perception.images.table_plane import TablePlane, fit_table

MAX_TILT = np.radians(10)
"""Largest angle between the table seen in depth and the plane z = 0 by X_WC, rad; beyond it, X_WC
is taken to be wrong."""

MAX_SHIFT = 0.05
"""Largest distance between the table seen in depth and the plane z = 0 by X_WC, m; beyond it, X_WC
is taken to be wrong."""

PAINTED_DEPTH = -1.0
"""Depth where the table was painted over what hides it, m: neither measured nor missing."""

TABLE_FRACTION = 75
"""Percentage of the pixels seen, those nearest to the median color, that is taken for table when
something is painted over."""


def look_at_table(
    color: Color, depth: Depth | None, camera: Camera
) -> tuple[Color, Depth | None, TablePlane | None, Camera]:
    """Takes the distortion out of both images and fits the table.

    Returns:
        Color and depth, undistorted; the table, None without depth; and the camera with X_WC.

    Raises:
        ImageError, CameraError, NoTableError: as `detect_object`.
    """
    camera.check_size(color, "the color image")
    color = camera.undistort(color)
    if depth is None:
        if camera.X_WC is None:
            raise CameraError(
                "X_WC is not known and there is no depth image; expected one of the two"
            )
        # Without depth nothing else than X_WC tells where the table is.
        if not np.isfinite(camera.cast(camera.K[:2, 2])).all():
            raise NoTableError(
                "the camera looks past the table; expected X_WC in its file with the table at z = 0"
                " and the camera above, its z axis toward the table",
                color,
            )
        return color, None, None, camera
    camera.check_size(depth, "the depth image")
    depth = camera.undistort(depth)
    plane = fit_table(depth, camera.undistorted, color)
    if camera.X_WC is None:
        return color, depth, plane, camera.with_pose(plane.make_pose(camera))

    # Where both tell it, they must agree: a camera that was moved gives wrong places silently.
    tilt = np.arccos(np.clip(plane.normal @ camera.X_WC[2, :3], -1, 1))
    shift = plane.offset - camera.X_WC[2, 3]
    if tilt > MAX_TILT or abs(shift) > MAX_SHIFT:
        raise NoTableError(
            f"the table in depth is tilted by {np.degrees(tilt):.0f} degrees and shifted by"
            f" {shift:.3f} m from z = 0 of X_WC; expected them to agree",
            color,
        )
    return color, depth, plane, camera


def cover_pixels(
    color: Color, depth: Depth | None, unseen: Mask, seed: int
) -> tuple[Color, Depth | None]:
    """Paints the table over what is not to be looked at, such as the arm.

    Args:
        color: (height, width, 3) uint8.
        depth: (height, width), m; None without a depth camera.
        unseen: (height, width) bool, pixels that say nothing; most of the others show the table.
        seed: seed of the choice among the table's colors, which are the most common ones.

    Returns:
        New images; depth is PAINTED_DEPTH there. The very ones that were given where nothing is
        unseen.

    Raises:
        NoTableError: nothing is left to be looked at.
    """
    if not unseen.any():
        return color, depth
    seen = color[~unseen]
    if not len(seen):
        raise NoTableError("the robot hides all of the picture; expected a table in view", color)
    # The colors nearest to the median are the table's. Each pixel gets one of them and not their
    # mean, so that what is painted has the table's own noise.
    off = np.abs(seen - np.median(seen, axis=0)).max(axis=1)
    table = seen[off <= np.percentile(off, TABLE_FRACTION)]
    covered = color.copy()
    covered[unseen] = np.random.default_rng(seed).choice(table, int(unseen.sum()))
    if depth is None:
        return covered, None
    return covered, np.where(unseen, np.float32(PAINTED_DEPTH), depth)


def find_off_table(camera: Camera, table_top: BaseGeometry) -> Mask:
    """Finds the pixels whose rays do not meet the table's top.

    Args:
        camera: camera with X_WC.
        table_top: polygon of the table's top at z = 0, W, m.

    Returns:
        (height, width) bool, True where the table is not.
    """
    columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    xy = camera.cast(np.stack([columns, rows], axis=-1))
    on_table = shapely.contains_xy(table_top, xy[..., 0], xy[..., 1])
    return ~np.asarray(on_table)
