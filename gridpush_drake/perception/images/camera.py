"""The camera: what it makes of points in the world, and back; and the files that describe one.

    p_C = X_CW p_W,     (x, y) = distort(p_C.xy / p_C.z),     pixel = (fx x + s y + cx, fy y + cy)

Three forms of files are read: ROS's `camera_info` (a calibration file, or a printed message),
OpenCV's YAML, and Drake's CameraConfig. The first two may say X_WC besides, as four rows of four
numbers; Drake's says it in its own way.

Images and their files are in `frames`.
"""

import re
from dataclasses import dataclass, replace
from functools import cached_property
from math import radians, tan
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from gridpush_drake.errors import CameraError, ImageError
from gridpush_drake.files import read_text, write_whole
from gridpush_drake.frozen import Frozen
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.yaml_file import NO_MAPPING, TAG_KEY, dump_yaml, parse_yaml, shorten

DISTORTION_COUNTS = (0, 4, 5, 8, 12, 14)
"""Numbers of coefficients that OpenCV knows: k1 k2 p1 p2 [k3 [k4 k5 k6 [s1 s2 s3 s4 [tau_x
tau_y]]]]; any other number is refused."""

DISTORTION_MODELS = ("plumb_bob", "rational_polynomial", "")
"""ROS's names of the distortion that OpenCV knows; others, such as the fisheye model, are
refused."""

MAX_SIDE = 20_000
"""Longest side of an image, pixels."""

MIN_FOCAL = 0.1
"""Least focal length, as a part of the picture's side; a shorter one, at which a pinhole camera
would see more than 157 degrees, was given in another unit."""

ROTATION_TOLERANCE = 1e-6
"""Greatest entry of R'R - I that a rotation matrix R may have, as files round."""

UNDISTORT_ITERATIONS = 50
"""Most rounds of OpenCV's loop that inverts the distortion."""

UNDISTORT_EPSILON = 1e-12
"""OpenCV's loop that inverts the distortion ends when its error is less than this, pixels."""

DRAKE_SIZE = (640, 480)
"""Width and height, pixels, that drake::systems::sensors::CameraConfig takes where a file leaves
them out."""

DRAKE_FOV = 45.0
"""Field of view along y, degrees, that drake::systems::sensors::CameraConfig takes where a file
leaves out the focal length."""

DRAKE_PIXEL_MIDDLE = 0.5
"""Place of the upper left pixel's middle along x and y for Drake's renderer, pixels; here it is at
0."""

STRAIGHT_ANGLE = 180.0
"""A field of view is less than this, degrees."""

EXPECTED_CAMERA = "a camera file (ROS camera_info, OpenCV YAML or Drake's CameraConfig)"
"""Names the files that are read, in messages."""

OPENCV_HEAD = re.compile(r"\A\s*%YAML:1\.0\s*\n")
"""First line of OpenCV's files, which is no YAML and is taken away."""

NOT_KNOWN = "X_WC is not known; `gridpush calibrate` finds it from a board of tags on the table"
"""Message where the camera's pose is needed and not known."""


@dataclass(frozen=True, eq=False)
class Camera(Frozen):
    """A pinhole camera with OpenCV's lens distortion.

    Attributes:
        width: width of the image, pixels.
        height: height of the image, pixels.
        K: (3, 3) [[fx, s, cx], [0, fy, cy], [0, 0, 1]], pixels.
        distortion: (k,) coefficients in OpenCV's order, k one of 0, 4, 5, 8, 12, 14.
        X_WC: (4, 4) pose of the camera in the world; None where it is not known. x is right and y
            down in the image, z forward.

    Raises:
        CameraError: a shape or a value is not as said above.
    """

    width: int
    height: int
    K: Array
    distortion: Array
    X_WC: Array | None = None

    def __post_init__(self) -> None:
        for name, side in (("width", self.width), ("height", self.height)):
            if not (isinstance(side, int | np.integer) and 1 <= side <= MAX_SIDE):
                raise CameraError(
                    f"{name} is {side!r}; expected a whole number of pixels, at most {MAX_SIDE}"
                )
            object.__setattr__(self, name, int(side))

        K = self._freeze("K", self.K, (3, 3))
        positive = K[0, 0] > 0 and K[1, 1] > 0
        if not (positive and K[1, 0] == 0 and (K[2] == (0, 0, 1)).all()):
            raise CameraError(
                f"K is {K.tolist()}; expected [[fx, s, cx], [0, fy, cy], [0, 0, 1]], fx and fy"
                " positive"
            )
        # A focal length in meters or millimeters would otherwise pass for one in pixels.
        for name, focal, side in (("fx", K[0, 0], self.width), ("fy", K[1, 1], self.height)):
            least = MIN_FOCAL * side
            if focal < least:
                raise CameraError(
                    f"{name} is {focal:g} pixels of {side}; expected at least {least:g}"
                )

        count = np.size(self.distortion)
        if count not in DISTORTION_COUNTS:
            raise CameraError(
                f"distortion has {count} coefficients; expected {DISTORTION_COUNTS[1:]} or none"
            )
        self._freeze("distortion", np.reshape(self.distortion, -1), (count,))

        if self.X_WC is None:
            return
        X = self._freeze("X_WC", self.X_WC, (4, 4))
        R = X[:3, :3]
        off = np.abs(R.T @ R - np.eye(3)).max()
        rigid = off <= ROTATION_TOLERANCE and np.linalg.det(R) > 0
        if not (rigid and (X[3] == (0, 0, 0, 1)).all()):
            raise CameraError(
                "X_WC is no rigid transform; expected [R p; 0 0 0 1] with a rotation R"
            )

    def _freeze(self, name: str, value: ArrayLike, shape: tuple[int, ...]) -> Array:
        """Makes a field an array that nobody can change, and checks its shape and values."""
        try:
            array = np.array(value, dtype=np.float64)
        except (TypeError, ValueError):
            array = np.full((), np.nan)
        if array.shape != shape or not np.isfinite(array).all():
            raise CameraError(
                f"{name} is {shorten(value)}; expected finite numbers of shape {shape}"
            )
        array.setflags(write=False)
        object.__setattr__(self, name, array)
        return array

    @property
    def pose(self) -> Array:
        """(4, 4) X_WC. Raises CameraError where it is not known."""
        if self.X_WC is None:
            raise CameraError(NOT_KNOWN)
        return self.X_WC

    @property
    def center(self) -> Array:
        """(3,) p_WC, m. Raises CameraError where it is not known."""
        return self.pose[:3, 3]

    @cached_property
    def undistorted(self) -> "Camera":
        """This camera without distortion: the one of images that went through `undistort`."""
        return replace(self, distortion=np.zeros(0)) if self.distortion.any() else self

    def with_pose(self, X_WC: ArrayLike) -> "Camera":
        """Returns this camera at X_WC (4, 4). Raises CameraError if that is no rigid transform."""
        return replace(self, X_WC=np.asarray(X_WC))

    def project(self, p_W: ArrayLike) -> Array:
        """Projects points into the image.

        Args:
            p_W: (..., 3) points in the world, m.

        Returns:
            (..., 2) pixels, x right and y down from the middle of the upper left pixel, within the
            image or not; NaN for points that are not in front of the camera.

        Raises:
            CameraError: X_WC is not known.
        """
        points = np.asarray(p_W, dtype=np.float64)
        # p_C = R_WC' (p_W - p_WC), and its place on the plane z = 1 of C.
        R = self.pose[:3, :3]
        p_C = (points - self.center) @ R
        depth = p_C[..., 2]
        in_front = (depth > 0)[..., None]
        with np.errstate(divide="ignore", invalid="ignore"):
            flat = np.where(in_front, p_C[..., :2] / depth[..., None], np.nan)
        return self._distort(flat)

    def cast(self, pixels: ArrayLike, z: ArrayLike = 0.0) -> Array:
        """Finds the points that pixels show on a level plane.

        Args:
            pixels: (..., 2) places in the image, whole numbers in the pixels' middles.
            z: height of the plane in W, m; of any shape that goes with (...).

        Returns:
            (..., 2) x and y in W, m; NaN where the ray does not meet the plane before the camera.

        Raises:
            CameraError: X_WC is not known.
        """
        rays = self.rays(pixels) @ self.pose[:3, :3].T
        climb = np.asarray(z, dtype=np.float64) - self.center[2]
        with np.errstate(divide="ignore", invalid="ignore"):
            along = climb / rays[..., 2]
        # A ray that is level, or leads away from the plane, does not meet it.
        along = np.where(np.isfinite(along) & (along > 0), along, np.nan)
        return self.center[:2] + along[..., None] * rays[..., :2]

    def rays(self, pixels: ArrayLike) -> Array:
        """Makes the rays of pixels.

        Args:
            pixels: (..., 2) places in the image, whole numbers in the pixels' middles.

        Returns:
            (..., 3) directions in C, with z = 1.
        """
        places = np.asarray(pixels, dtype=np.float64)
        if self.distortion.any():
            xy = self._invert_distortion(places)
        else:
            # pixel = (fx x + s y + cx, fy y + cy), solved for y first.
            K = self.K
            u = places[..., 0]
            v = places[..., 1]
            y = (v - K[1, 2]) / K[1, 1]
            x = (u - K[0, 2] - K[0, 1] * y) / K[0, 0]
            xy = np.stack([x, y], axis=-1)
        ones = np.ones((*xy.shape[:-1], 1))
        return np.concatenate([xy, ones], axis=-1)

    def _invert_distortion(self, places: Array) -> Array:
        """Finds the points (..., 2) on the plane z = 1 of C that distorted pixels (..., 2) show."""
        criteria = (
            cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS,
            UNDISTORT_ITERATIONS,
            UNDISTORT_EPSILON,
        )
        undistorted = cv2.undistortPoints(
            src=np.ascontiguousarray(places.reshape(-1, 1, 2)),
            cameraMatrix=self.K,
            distCoeffs=self.distortion,
            criteria=criteria,
        )
        return np.asarray(undistorted, dtype=np.float64).reshape(places.shape)

    def undistort(self, image: NDArray[Any]) -> NDArray[Any]:
        """Takes the lens' distortion out of an image.

        Args:
            image: (height, width[, channels]); uint8 is interpolated, any other type (depth) is
                taken from the nearest pixel, and what the lens did not see is 0.

        Returns:
            The image that `undistorted` would take, of the same shape and type; the image itself
            where there is no distortion.

        Raises:
            ImageError: its size is not the camera's.
        """
        self.check_size(image)
        if not self.distortion.any():
            return image
        # A mean of two depths, at an edge, would be a depth at which there is nothing.
        method = cv2.INTER_LINEAR if image.dtype == np.uint8 else cv2.INTER_NEAREST
        return np.asarray(cv2.remap(image, *self._undistortion_maps, method))

    def check_size(self, image: NDArray[Any], what: str = "the image") -> None:
        """Raises ImageError where an image (height, width, ...) is not of the camera's size."""
        if image.shape[:2] != (self.height, self.width):
            size = "x".join(map(str, image.shape[1::-1]))
            raise ImageError(
                f"{what} has {size} pixels; expected {self.width}x{self.height}, as the camera's"
                " file says"
            )

    @cached_property
    def _undistortion_maps(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Where in the image as it was taken each undistorted pixel is, x and y."""
        size = (self.width, self.height)
        return cv2.initUndistortRectifyMap(
            self.K, self.distortion, None, self.K, size, cv2.CV_32FC1
        )  # type: ignore

    def _distort(self, flat: Array) -> Array:
        """Finds the pixels (..., 2) of points (..., 2) on the plane z = 1 of C."""
        if not self.distortion.any():
            K = self.K
            x = flat[..., 0]
            y = flat[..., 1]
            u = K[0, 0] * x + K[0, 1] * y + K[0, 2]
            v = K[1, 1] * y + K[1, 2]
            return np.stack([u, v], axis=-1)

        ones = np.ones((*flat.shape[:-1], 1))
        pixels = np.concatenate([flat, ones], axis=-1).reshape(-1, 1, 3)
        # OpenCV refuses to project no points at all.
        if len(pixels):
            none = np.zeros(3)
            pixels, _ = cv2.projectPoints(pixels, none, none, self.K, self.distortion)
        return np.asarray(pixels[..., :2].reshape(flat.shape), dtype=np.float64)

    @classmethod
    def read(cls, path: Path | str) -> "Camera":
        """Reads a camera file: ROS's camera_info, OpenCV's YAML or Drake's CameraConfig.

        Args:
            path: the file.

        Returns:
            The camera; X_WC is None where the file does not say it.

        Raises:
            CameraError: the file cannot be read, is of none of these forms, or a field is missing
                or of the wrong form; the message names the file and the field. ROS's and OpenCV's
                must have distortion coefficients.
        """
        path = Path(path)
        return cls.parse(path, read_text(path, EXPECTED_CAMERA, CameraError))

    @classmethod
    def parse(cls, path: Path, text: str) -> "Camera":
        """Makes a camera of the text of a camera file.

        Args:
            path: name of the file for messages; it need not be there.
            text: contents of the file.

        Returns:
            The camera, as from `read`.

        Raises:
            CameraError: as from `read`.
        """
        data = parse_yaml(
            path, OPENCV_HEAD.sub("", text), EXPECTED_CAMERA, CameraError, tagged=True
        )
        if data is None:
            raise CameraError(f"{path}: is empty; expected {EXPECTED_CAMERA}")
        if not isinstance(data, dict):
            raise CameraError(f"{path}: {NO_MAPPING}; expected {EXPECTED_CAMERA}")
        try:
            fields = _read_drake(data) if _is_drake(data) else _read_ros(data)
            return cls(**fields)
        except CameraError as error:
            raise CameraError(f"{path}: {error}") from error
        except OverflowError as error:
            raise CameraError(
                f"{path}: a number is too large; expected pixels and meters"
            ) from error

    def write(self, path: Path | str, force: bool = False) -> None:
        """Writes the camera as ROS's camera_info, and X_WC besides.

        `read` gives it back, bit for bit.

        Args:
            path: the YAML file to be written.
            force: whether an existing file may be replaced.

        Raises:
            OutputError: the file exists and `force` is not set, or it cannot be written.
        """
        plumb_bob = self.distortion.size <= len("kkppk")
        data: dict[str, Any] = {
            "image_width": self.width,
            "image_height": self.height,
            "camera_matrix": {"rows": 3, "cols": 3, "data": self.K.ravel().tolist()},
            "distortion_model": "plumb_bob" if plumb_bob else "rational_polynomial",
            "distortion_coefficients": {
                "rows": 1,
                "cols": self.distortion.size,
                "data": self.distortion.tolist(),
            },
        }
        if self.X_WC is not None:
            data["X_WC"] = self.X_WC.tolist()
        write_whole(path, dump_yaml(data, default_flow_style=None), force)


def _read_ros(data: dict[str, Any]) -> dict[str, Any]:
    """Reads the fields of a Camera from a calibration file of ROS or OpenCV, or a message."""
    model = _find(data, ("distortion_model",), "a name", "plumb_bob")
    if model not in DISTORTION_MODELS:
        raise CameraError(
            f"distortion_model is {shorten(model)}; expected plumb_bob or rational_polynomial"
        )
    found = {
        "width": _find(data, ("image_width", "width"), "a whole number of pixels"),
        "height": _find(data, ("image_height", "height"), "a whole number of pixels"),
        "K": _matrix(data, ("camera_matrix", "K", "k"), 3),
        "distortion": _numbers(
            data, ("distortion_coefficients", "D", "d"), "numbers; zeros where there is none"
        ),
    }
    if "X_WC" in data:
        found["X_WC"] = _matrix(data, ("X_WC",), 4)
    return found


def _find(data: dict[str, Any], names: tuple[str, ...], form: str, default: Any = None) -> Any:
    """Finds a field that may have one of several names; messages call it by the first."""
    value = next((data[name] for name in names if name in data), default)
    if value is None:
        raise CameraError(f"{names[0]} is missing; expected {form}")
    return value


def _matrix(data: dict[str, Any], names: tuple[str, ...], side: int) -> Array:
    """Reads a square matrix, in any of the forms of `_numbers`."""
    form = f"{side} rows of {side} numbers"
    numbers = _numbers(data, names, form)
    if len(numbers) != side * side:
        raise CameraError(f"{names[0]} has {len(numbers)} numbers; expected {form}")
    return np.array(numbers).reshape(side, side)


def _numbers(data: dict[str, Any], names: tuple[str, ...], form: str) -> list[float]:
    """Reads the numbers of a matrix, which stand under `data`, in rows, or in one list."""
    value = _find(data, names, form)
    if isinstance(value, dict):
        value = value.get("data")
    rows = value if isinstance(value, list) else [None]
    flat: list[Any] = []
    for row in rows:
        flat += row if isinstance(row, list) else [row]
    if not all(map(_is_number, flat)):
        raise CameraError(f"{names[0]} is {shorten(data.get(names[0]))}; expected {form}")
    return [float(number) for number in flat]


def _is_number(value: Any) -> bool:
    """Says whether a value of a YAML file is a number; `true` and `false` are none."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def _is_drake(data: dict[str, Any]) -> bool:
    """Says whether a file is a CameraConfig, by the fields that only Drake has."""
    return "focal" in data or "X_PB" in data


def _read_drake(data: dict[str, Any]) -> dict[str, Any]:
    """Reads the fields of a Camera from a CameraConfig.

    What the file leaves out is as Drake's own defaults have it.
    """
    width = data.get("width", DRAKE_SIZE[0])
    height = data.get("height", DRAKE_SIZE[1])
    if not all(isinstance(side, int) and side > 0 for side in (width, height)):
        raise CameraError(
            f"width and height are {width!r} and {height!r}; expected whole numbers of pixels"
        )
    focal = data.get("focal", {TAG_KEY: "FovDegrees", "y": DRAKE_FOV})
    fx, fy = _read_focal(focal, width, height)

    # Drake counts pixels from the upper left corner of the upper left pixel, here they are counted
    # from its middle.
    cx = _number(data, "center_x", width / 2 - 0.5) - DRAKE_PIXEL_MIDDLE
    cy = _number(data, "center_y", height / 2 - 0.5) - DRAKE_PIXEL_MIDDLE
    if data.get("X_BD", {}) != data.get("X_BC", {}):
        raise CameraError("X_BD is not X_BC; expected depth and color from the same place")
    X_WC = _read_transform(data, "X_PB") @ _read_transform(data, "X_BC")
    return {
        "width": width,
        "height": height,
        "K": [[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]],
        "distortion": np.zeros(0),
        "X_WC": X_WC,
    }


def _read_focal(focal: Any, width: int, height: int) -> tuple[float, float]:
    """Reads the focal lengths fx and fy, pixels, from a FocalLength or FovDegrees.

    Where the file gives one of the two, the other is equal to it.
    """
    if not isinstance(focal, dict) or not {"x", "y"} & focal.keys():
        raise CameraError(
            "focal: expected x or y, in pixels, or !FovDegrees and x or y, in degrees"
        )
    found = {}
    for axis, side in (("x", width), ("y", height)):
        if focal.get(axis) is None:
            continue
        value = _number(focal, axis, 0.0, "focal.")
        if focal.get(TAG_KEY) == "FovDegrees":
            if not 0 < value < STRAIGHT_ANGLE:
                raise CameraError(f"focal.{axis} is {value}; expected degrees between 0 and 180")
            # Half of the picture's side is seen at half of the angle.
            value = side / 2 / tan(radians(value) / 2)
        found[axis] = value
    if not found:
        return 0.0, 0.0
    either = next(iter(found.values()))
    return found.get("x", either), found.get("y", either)


def _read_transform(data: dict[str, Any], name: str) -> Array:
    """Reads a fixed drake::schema::Transform (4, 4) in the world; the identity of none."""
    schema = data.get(name) or {}
    if not isinstance(schema, dict) or schema.get("base_frame") not in (None, "", "world"):
        raise CameraError(f"{name}: expected a transform whose base_frame is world, or none")
    rotation = schema.get("rotation") or {}
    kind = None
    if isinstance(rotation, dict):
        kind = rotation.get(TAG_KEY, "Identity")
    X = np.eye(4)
    X[:3, 3] = _vector(schema, "translation", name)
    above = f"{name}.rotation"
    if kind == "Rpy":
        # Drake's roll, pitch and yaw are about the fixed axes x, y and z, one after the other.
        angles = _vector(rotation, "deg", above)
        X[:3, :3] = Rotation.from_euler("xyz", angles, degrees=True).as_matrix()
    elif kind == "AngleAxis":
        axis = np.array(_vector(rotation, "axis", above))
        angle = radians(_number(rotation, "angle_deg", 0.0, f"{above}."))
        if not axis.any():
            raise CameraError(f"{above}.axis is zero; expected a direction")
        vector = angle * axis / np.linalg.norm(axis)
        X[:3, :3] = Rotation.from_rotvec(vector).as_matrix()
    elif kind != "Identity":
        raise CameraError(f"{above} is {shorten(rotation)}; expected !Rpy or !AngleAxis")
    return X


def _vector(data: dict[str, Any], key: str, above: str) -> list[float]:
    """Reads a field of three numbers, zeros where it is missing; messages call it `above.key`."""
    if data.get(key) is None:
        return [0.0, 0.0, 0.0]
    numbers = _numbers(data, (key,), "[x, y, z]")
    if len(numbers) != 3:
        raise CameraError(f"{above}.{key} is {shorten(data[key])}; expected [x, y, z]")
    return numbers


def _number(data: dict[str, Any], key: str, default: float, above: str = "") -> float:
    """Reads a field that is a number; messages put `above` before its name."""
    value = data.get(key)
    if value is None:
        return default
    if not _is_number(value):
        raise CameraError(f"{above}{key} is {shorten(value)}; expected a number")
    return float(value)
