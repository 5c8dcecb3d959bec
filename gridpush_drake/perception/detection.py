"""One object on a table, found in one photograph: its mask, outline, height and parts."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from shapely import Polygon

from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.perception.camera import Camera
from gridpush_drake.perception.frames import Color, Depth

Array = NDArray[np.float64]


@dataclass(frozen=True)
class DetectorOptions:
    """What counts as an object.

    Attributes:
        min_area: of an object, m^2.
        height: of the object, m, where it is known and there is no depth image.
        parts: whether the object's parts are told apart by color.
    """

    min_area: float = 2e-4
    height: float | None = None
    parts: bool = False


@dataclass(frozen=True, eq=False)
class DetectedObject:
    """An object that was found.

    Attributes:
        outline: contour with holes, W, on the table's plane, m.
        mask: (height, width) bool, the pixels that show it, of the undistorted image.
        height: of its top above the table, m; 0 where neither depth nor options told it.
        X_WB: (3,) pose (x, y, theta) chosen for the body frame: the outline's centroid, x as in W.
        pixel: (2,) where the body frame's origin is in the photograph as it was taken, pixels.
        parts: polygons by label, W, m; empty where they were not asked for.
        camera: with X_WC: the one given, or, where it was not known, the one that depth gives: W's origin is where the
            optical axis meets the table, x to the right in the image, z up.
        picture: (height, width, 3) uint8, the undistorted photograph with the outline drawn.
    """

    outline: Polygon
    mask: NDArray[np.bool_]
    height: float
    X_WB: Array
    pixel: Array
    parts: dict[int, Polygon]
    camera: Camera
    picture: Color

    @property
    def outline_B(self) -> Polygon:
        """The outline in the body frame, m."""
        raise NotImplementedError

    def make_grid_object(self, cell_size: float | None = None, name: str = "object") -> GridObject:
        """Fills the outline with cells.

        Args:
            cell_size: side of a cell, m, about; the default number of cells where None.
            name: of the object.

        Returns:
            The object, in the body frame B that stands at X_WB.

        Raises:
            ObjectError: the cells would be too many.
        """
        raise NotImplementedError


def detect_object(
    color: Color, depth: Depth | None, camera: Camera, options: DetectorOptions = DetectorOptions()
) -> DetectedObject:
    """Finds the one object that lies on the table.

    Args:
        color: (height, width, 3) uint8, red, green, blue, as it was taken (distorted).
        depth: (height, width), m, registered to `color`, 0 where it was not measured; None without a depth camera.
        camera: that took it; X_WC, with the table's top at z = 0, may be left out where there is depth.
        options: see `DetectorOptions`.

    Returns:
        The object.

    Raises:
        ImageError: an image has another size than the camera, or depth is not in meters.
        CameraError: neither X_WC nor depth is given.
        NoTableError, NoObjectError, SeveralObjectsError, ObjectAtBorderError: as their names say; each with a picture
            of what was seen.
    """
    raise NotImplementedError
