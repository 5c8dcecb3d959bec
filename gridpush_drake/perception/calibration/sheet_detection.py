"""Finds an object that lies beside or on a sheet of paper, in a photograph that has both.

Beside it: the sheet is covered with the table's colors, and the object is found as in any other
photograph. On it: the sheet is made a picture of its own, as seen from straight above, in which the
paper is the table.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from shapely import Polygon

from gridpush_drake.errors import CameraError, ObjectAtBorderError
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.perception.calibration.sheet import FoundSheet, list_corners
from gridpush_drake.perception.detection.detection import (
    DetectedObject,
    DetectorOptions,
    detect_object,
    draw_found,
)
from gridpush_drake.perception.detection.foreground import find_foreground, remove_thin
from gridpush_drake.perception.detection.hints import ObjectHint
from gridpush_drake.perception.images.camera import Camera
from gridpush_drake.perception.images.frames import Color
from gridpush_drake.perception.images.table_view import cover_pixels

EDGE_MARGIN = 0.003
"""Width of the strip along the sheet's edge that is not looked at where the object lies on the
sheet, m."""

BESIDE_MARGIN = 0.006
"""Width of the strip about the sheet that is covered where the object lies beside it, m: it holds
the paper's shadow and thickness."""

MIN_ON_SHEET = 2e-4
"""Least area of what lies on a sheet, m²."""


@dataclass(frozen=True, eq=False)
class ObjectBySheet:
    """An object that was found by a sheet.

    Attributes:
        found: the object. Its camera is the one of `color`.
        color: (height, width, 3) uint8, the picture in which it was found: the undistorted
            photograph, or of an object on the sheet the sheet seen from above.
        pixel: (2,) where the body frame's origin is in the photograph as it was taken, pixels.
        on_sheet: whether it lies on the sheet, not beside it.
    """

    found: DetectedObject
    color: Color
    pixel: Array
    on_sheet: bool


def detect_by_sheet(
    color: Color, sheet: FoundSheet, options: DetectorOptions | None = None
) -> ObjectBySheet:
    """Finds the one object that lies beside a sheet, or on it.

    Args:
        color: (height, width, 3) uint8, red, green, blue, as it was taken (distorted).
        sheet: the sheet in it.
        options: see `DetectorOptions`.

    Raises:
        CameraError: the object has a height, which shifts its outline in the photograph, and
            nobody knows by how much, as the focal length is not known.
        PerceptionError: as `detect_object`.
    """
    options = options or DetectorOptions()
    camera = sheet.camera
    if options.height and not sheet.focal_known:
        raise CameraError(
            "the photograph does not tell its focal length, which the height of the object asks "
            "for; expected a photograph at a slant of 20 to 50 degrees, one that has the focal "
            "length in its EXIF data, or --camera"
        )
    plain = np.asarray(camera.undistort(color))

    # Whether it lies on the sheet is seen from above, where the sheet takes all of the picture
    view = view_from_above(plain, sheet)
    on_sheet = holds_object(view)
    if on_sheet:
        # The paper is the table, and the object must not reach over its edge
        shown = view.color
        hint = None if options.hint is None else view.move_hint(options.hint, camera)
        try:
            found = detect_object(shown, None, view.camera, replace(options, hint=hint))
        except ObjectAtBorderError as error:
            raise ObjectAtBorderError(
                "the object reaches over the edge of the sheet; expected all of it on the sheet, "
                "or beside it",
                error.picture,
            ) from error
    else:
        # The sheet would be an object, too: it is covered with the table's colors
        shown = plain
        sheet_pixels = sheet.cover(BESIDE_MARGIN)
        covered, _ = cover_pixels(plain, None, sheet_pixels, seed=0)
        found = detect_object(covered, None, camera.undistorted, options)
        # What is shown to the user is the photograph, in which the paper is still white.
        picture = draw_found(plain, found.camera, found.mask, found.outline, found.X_WB)
        found = replace(found, picture=picture)
    at = np.array([*found.X_WB[:2], 0.0])
    return ObjectBySheet(
        found=found,
        color=shown,
        pixel=camera.project(at),
        on_sheet=on_sheet,
    )


@dataclass(frozen=True, eq=False)
class TopView:
    """A picture of a sheet alone, as a camera straight above would see it.

    It has the center of the camera that took the photograph, so that it shows the same sides of the
    object: only its direction, and the focal length, are others.

    Attributes:
        color: (height, width, 3) uint8.
        camera: the camera that would have taken it.
        homography: (3, 3) from pixels of the undistorted photograph to those of this picture.
    """

    color: Color
    camera: Camera
    homography: Array

    def move_hint(self, hint: ObjectHint, camera: Camera) -> ObjectHint:
        """Moves a hint from the photograph to this picture.

        Args:
            hint: where the object is in the photograph.
            camera: the camera that took the photograph.
        """
        if hint.click is not None:
            ((x, y),) = self._move(np.array([hint.click], float), camera)
            return ObjectHint(click=(float(x), float(y)))
        if hint.box is not None:
            left, top, right, bottom = hint.box
            corners = [[left, top], [right, top], [right, bottom], [left, bottom]]
            moved = self._move(np.array(corners, float), camera)
            left, top = moved.min(axis=0).tolist()
            right, bottom = moved.max(axis=0).tolist()
            return ObjectHint(box=(left, top, right, bottom))
        drawn = hint.place(camera).astype(np.uint8)
        size = (self.camera.width, self.camera.height)
        moved_mask = cv2.warpPerspective(drawn, self.homography, size, flags=cv2.INTER_NEAREST)
        return ObjectHint(mask=moved_mask > 0)

    def _move(self, pixels: Array, camera: Camera) -> Array:
        """Moves pixels (k, 2) of the photograph to this picture."""
        # By way of the undistorted photograph
        rays = camera.rays(pixels)
        flat = rays / rays[:, 2:] @ camera.K.T
        moved = flat @ self.homography.T
        return np.asarray(moved[:, :2] / moved[:, 2:])


def view_from_above(color: Color, sheet: FoundSheet) -> TopView:
    """Makes the picture of a sheet alone, without its rim, as seen from straight above.

    Args:
        color: (height, width, 3) uint8, the undistorted photograph.
        sheet: the sheet.
    """
    # What is shown: the sheet without its rim
    camera = sheet.camera
    length, width = sheet.size
    inner = list_corners((length - 2 * EDGE_MARGIN, width - 2 * EDGE_MARGIN))

    # As many pixels in a meter as the photograph has about the sheet's middle
    area = Polygon(sheet.corners).area
    scale = float(np.sqrt(area / (length * width)))
    shape = (round(scale * 2 * inner[2, 0]), round(scale * 2 * inner[2, 1]))

    # Looking down, with x to the right and y up in the picture: R_WV = diag(1, -1, -1)
    x, y, z = camera.center
    focal = scale * z
    K = np.array(
        [
            [focal, 0.0, scale * (x + inner[2, 0]) - 0.5],
            [0.0, focal, scale * (inner[2, 1] - y) - 0.5],
            [0.0, 0.0, 1.0],
        ]
    )
    R_WV = np.diag([1.0, -1.0, -1.0])
    X_WV = np.eye(4)
    X_WV[:3, :3] = R_WV
    X_WV[:3, 3] = camera.center
    # Both cameras have one center: what a pixel of one shows is at K R_VC K_C^-1 of it in the other
    R_WC = np.asarray(camera.X_WC)[:3, :3]
    homography = K @ R_WV.T @ R_WC @ np.linalg.inv(camera.K)
    warped = cv2.warpPerspective(color, homography, shape, flags=cv2.INTER_AREA)
    return TopView(
        color=np.asarray(warped),
        camera=Camera(shape[0], shape[1], K, np.zeros(0), X_WV),
        homography=homography,
    )


def holds_object(view: TopView) -> bool:
    """Says whether something lies on a sheet, by its colors."""
    found = find_foreground(view.color, None, "color")
    count, _, stats, _ = cv2.connectedComponentsWithStats(
        remove_thin(found.mask).astype(np.uint8), connectivity=8
    )
    if count < 2:
        return False
    # What is small is a speck on the paper, or a fold
    pixel_area = (view.camera.center[2] / view.camera.K[0, 0]) ** 2
    return bool(stats[1:, cv2.CC_STAT_AREA].max() * pixel_area >= MIN_ON_SHEET)
