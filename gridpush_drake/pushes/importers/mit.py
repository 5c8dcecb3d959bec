"""Importer of the MIT pushes, start and end only (Yu, Bauza, Fazeli, Rodriguez, IROS 2016).

The files are those of GitHub robinzhoucmu/PlanarManipulationToolBox (mcube_data_proc): `record_all`
holds for each push the object's pose and the pusher's place before and after, next to another
model's prediction.

Outlines of the eleven objects of the MIT push data set (Yu, Bauza, Fazeli, Rodriguez, IROS 2016).

Each is in the tracked body frame, m. The dimensions are those measured by the data set's authors,
as published in GitHub mcubelab/push-est-public (catkin_ws/src/pnpush_config/src/config/shape_db.py;
butter from catkin_ws/src/isam_pose/include/shape_db_butter_shape.h) and again in peterkty/pnpush.
rect1, rect3 and hex agree with where the pusher touches in the data; the areas of all agree with
the plates' published masses within 2.5 %.
"""

import zlib
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any, ClassVar, Literal
from warnings import warn

import numpy as np
from scipy.io import loadmat

from gridpush_drake.dynamics.push import Push
from gridpush_drake.errors import PushLogError, PushLogWarning
from gridpush_drake.files import read_bytes
from gridpush_drake.geometry.se2 import Array, make_direction
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import PhysicalPrior
from gridpush_drake.pushes.observed_push import ObservedPush, nearest_turn
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.units import BYTES_PER_MEGABYTE, M_PER_MM

TRIANGLE_CORNER = (0.045, 0.045)
"""Where the triangles' right angle is: the frame is that of the 90 mm square the markers were put
on, m."""

ELLIPSE_VERTICES = 120
"""Vertices of an ellipse's polygon; it then lies within 0.03 mm."""

HEXAGON_RADIUS = 0.0605
"""From the hexagon's center to its vertices, the first on the x axis, m."""

BUTTER_HALF_MM = (
    (-27.46, 0.00), (-27.94, -3.73), (-29.67, -8.71), (-32.20, -13.67), (-35.23, -18.62),
    (-38.46, -23.55), (-41.61, -28.46), (-44.38, -33.34), (-46.47, -38.18), (-47.59, -42.99),
    (-47.49, -47.75), (-46.18, -52.42), (-43.79, -56.91), (-40.42, -61.16), (-36.21, -65.09),
    (-31.27, -68.64), (-25.72, -71.72), (-19.70, -74.27), (-13.31, -76.21), (-6.67, -77.46),
    (0.92, -78.02), (6.83, -77.66), (13.47, -76.59), (19.86, -74.81), (25.88, -72.41),
    (31.43, -69.45), (36.37, -66.02), (40.58, -62.17), (43.95, -57.99), (46.34, -53.56),
    (47.65, -48.93), (47.75, -44.19), (46.63, -39.39), (44.54, -34.55), (41.77, -29.68),
    (38.62, -24.78), (35.39, -19.85), (32.36, -14.91), (29.83, -9.95), (28.10, -4.98),
)  # fmt: skip
"""Half of the butterfly's outline; the other half is this one turned by pi about the origin, mm."""


def _rectangle(along_x: float, along_y: float) -> Array:
    return np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * (along_x / 2, along_y / 2)


def _triangle(along_x: float, along_y: float) -> Array:
    return TRIANGLE_CORNER - np.array([[0, 0], [along_x, 0], [0, along_y]])


def _ellipse(along_x: float, along_y: float) -> Array:
    angle = np.linspace(0, 2 * np.pi, ELLIPSE_VERTICES, endpoint=False)
    return make_direction(angle) * (along_x / 2, along_y / 2)


MIT_SHAPES: dict[str, Callable[[], Array]] = {
    "rect1": lambda: _rectangle(0.0900, 0.0900),
    "rect2": lambda: _rectangle(0.08991, 0.11258),
    "rect3": lambda: _rectangle(0.13501, 0.08994),
    "tri1": lambda: _triangle(0.12590, 0.12587),
    "tri2": lambda: _triangle(0.15100, 0.12587),
    "tri3": lambda: _triangle(0.17650, 0.12561),
    "ellip1": lambda: _ellipse(0.10500, 0.10500),
    "ellip2": lambda: _ellipse(0.10500, 0.13089),
    "ellip3": lambda: _ellipse(0.10500, 0.15700),
    "hex": lambda: HEXAGON_RADIUS * make_direction(np.arange(6) * np.pi / 3),
    "butter": lambda: np.vstack(
        [np.array(BUTTER_HALF_MM) * M_PER_MM, -(np.array(BUTTER_HALF_MM) * M_PER_MM)]
    ),
}
"""(k, 2) vertices by the data set's name of the shape, m."""


TIP_RADIUS = 0.00475
"""Radius of the pusher, m."""

DEFAULT_SPEED = 0.010
"""Speed of the pusher where the file does not tell it (`vel`, mm/s), m/s."""


MIT_CELLS = 60
"""Largest number of cells of an object's grid."""

EXPECTED_MATLAB = "a MATLAB v5 file"

MAX_SIZE = 16 * BYTES_PER_MEGABYTE
"""Largest size of a file, packed or unpacked, bytes. Those of the data set have a tenth of one
megabyte."""

HEADER_BYTES = 128
"""Number of bytes before a file's first element."""

TAG_BYTES = 8
"""Number of bytes before an element's content, which tell its kind and its size."""

COMPRESSED_KIND = 15
"""Kind of an element that is compressed."""

RECORD_SIZES = {"init_pose_gt": 3, "final_pose_gt": 3, "init_tip_pt": 2, "final_tip_pt": 2}
"""Fields of a record that are read, and how many numbers each has (m, rad)."""

MODEL_ERRORS = ("avg_diff_disp", "avg_diff_angle")
"""Fields with the mean errors of the data set's own model, m and rad."""

OBJECT_OPTION = {
    "help": "The object that was pushed, if it is none of the data set's shapes: an object file or "
    "a shipped object's name.",
    "name": "--object",
}
"""Option of the data set's importers for the object."""


@dataclass(frozen=True)
class MitImporter:
    """Convert a file of the MIT push data set (Yu, Bauza, Fazeli, Rodriguez, IROS 2016).

    Without `shape` and `obj` the object is the last part of the file's name after an underscore if
    that is one, otherwise the file's own `shape_id`. A PushLogWarning says where the name or
    `shape_id` is another shape.
    """

    file: ClassVar[str] = "FILE.mat"
    source: ClassVar[str] = "a file of the MIT push data set with each push's start and end"

    shape: str | None = field(
        default=None,
        metadata={
            "help": "The name of the shape that was pushed, such as rect1. If it is not given, the "
            "file's name or its content tells."
        },
    )
    obj: GridObject | None = field(
        default=None,
        metadata=OBJECT_OPTION,
    )

    def read(self, path: Path | str) -> tuple[PushLog, GridObject]:
        """Reads a file's pushes, and the object that was pushed.

        All pushes are straight and at constant speed. Of each, the file holds the object's pose at
        the beginning and at the end, and none in between.

        Raises:
            PushLogError: the file cannot be read, lacks a field or holds something else in it, a
                pusher does not move, or the shape is not known.
        """
        path = Path(path)
        data = _read_mat(path)
        obj = self.obj or _mit_object(path, self.shape, data)
        speed = (
            float(_numbers(path, "vel", data["vel"], 1)[0]) * M_PER_MM
            if "vel" in data
            else DEFAULT_SPEED
        )
        if speed <= 0:
            raise PushLogError(f"{path}: vel is {data['vel']!r}; expected a positive number (mm/s)")
        records = np.atleast_1d(_field(path, data, "record_all"))
        digits = len(str(len(records)))
        pushes = (
            _observe(path, record, f"push_{i:0{digits}}", speed)
            for i, record in enumerate(records, start=1)
        )
        return PushLog(tuple(pushes), str(path)), obj


def read_model_errors(path: Path | str) -> tuple[float, float]:
    """Reads the file's own model's mean error of the end position, m, and of the end angle, rad.

    Raises:
        PushLogError: the file cannot be read or does not say.
    """
    path = Path(path)
    data = _read_mat(path)
    position, angle = (
        float(_numbers(path, name, _field(path, data, name), 1)[0]) for name in MODEL_ERRORS
    )
    return position, angle


def _observe(path: Path, record: Any, name: str, speed: float) -> ObservedPush:
    """Makes the log's entry of a record; the pusher's speed is in m/s."""
    fields = {}
    for key, size in RECORD_SIZES.items():
        if not hasattr(record, key):
            raise PushLogError(
                f"{path}: {name} of record_all has no {key}; expected {', '.join(RECORD_SIZES)}"
            )
        fields[key] = _numbers(path, f"{key} of {name}", getattr(record, key), size)
    start = fields["init_tip_pt"]
    travel = fields["final_tip_pt"] - start
    length = float(np.linalg.norm(travel))
    if length == 0:
        raise PushLogError(f"{path}: {name}: the pusher ends where it starts; expected a path")
    push = Push(start, travel * (speed / length), length / speed, TIP_RADIUS)
    pose = fields["init_pose_gt"]
    end = fields["final_pose_gt"]
    end[2] = nearest_turn(float(end[2]), float(pose[2]))
    return ObservedPush(name, push, pose, np.array([push.duration]), end[None])


def _mit_object(path: Path, shape: str | None, data: dict[str, Any]) -> GridObject:
    """Chooses the object by the file's name and content; warns where these contradict."""
    named = path.stem.rpartition("_")[2]
    said = {"name": named, "shape_id": str(data.get("shape_id", ""))}
    if shape is None:
        shape = named if named in MIT_SHAPES else said["shape_id"] or named
    obj = make_mit_object(path, shape)
    others = [
        f"its {what} says {other}"
        for what, other in said.items()
        if other in MIT_SHAPES and other != shape
    ]
    if others:
        warn(
            f"{path}: taken for pushes of {shape}, but {' and '.join(others)}",
            PushLogWarning,
            stacklevel=3,
        )
    return obj


def make_mit_object(path: Path, shape: str) -> GridObject:
    """Makes the object of a shape's name.

    Args:
        path: the file that was read, for messages.
        shape: one of MIT_SHAPES.

    Returns:
        The object, without a mass.

    Raises:
        PushLogError: the shape is not known.
    """
    if shape not in MIT_SHAPES:
        raise PushLogError(
            f"{path}: shape {shape!r} is not known; expected {', '.join(MIT_SHAPES)}, or an "
            "object file"
        )
    prior = PhysicalPrior(pusher_radius=TIP_RADIUS)
    return GridObject.from_outline(
        MIT_SHAPES[shape](), max_cells=MIT_CELLS, name=shape, prior=prior
    )


def _read_mat(path: Path) -> dict[str, Any]:
    content = read_bytes(path, EXPECTED_MATLAB, PushLogError, MAX_SIZE)
    if _calc_unpacked_size(content) > MAX_SIZE:
        raise PushLogError(
            f"{path}: has more than {MAX_SIZE // BYTES_PER_MEGABYTE} MB, unpacked; expected "
            f"{EXPECTED_MATLAB}"
        )
    try:
        data: dict[str, Any] = loadmat(BytesIO(content), squeeze_me=True, struct_as_record=False)
    except Exception as error:  # a damaged file makes SciPy raise almost anything
        raise PushLogError(f"{path}: cannot be read as {EXPECTED_MATLAB}: {error}") from error
    return data


def _calc_unpacked_size(content: bytes) -> int:
    """Counts the bytes of a file's compressed elements, unpacked; no further than MAX_SIZE."""
    # The file's header says in which order the bytes of a number stand.
    order: Literal["little", "big"] = (
        "little" if content[HEADER_BYTES - 2 : HEADER_BYTES] == b"IM" else "big"
    )
    at = HEADER_BYTES
    size = 0
    while at + TAG_BYTES <= len(content) and size <= MAX_SIZE:
        kind = int.from_bytes(content[at : at + 4], order)
        length = int.from_bytes(content[at + 4 : at + TAG_BYTES], order)
        at += TAG_BYTES
        if kind == COMPRESSED_KIND:
            with suppress(zlib.error):  # SciPy says what is wrong
                unpacked = zlib.decompressobj().decompress(content[at : at + length], MAX_SIZE + 1)
                size += len(unpacked)
        at += length
    return size


def _field(path: Path, data: dict[str, Any], name: str) -> Any:
    if name not in data:
        there = ", ".join(key for key in data if not key.startswith("__")) or "nothing"
        raise PushLogError(f"{path}: has no {name}; it holds {there}")
    return data[name]


def _numbers(path: Path, name: str, value: Any, size: int) -> Array:
    try:
        numbers = np.array(value, dtype=np.float64).reshape(-1)
    except (TypeError, ValueError):
        numbers = np.empty(0)
    if numbers.shape != (size,) or not np.isfinite(numbers).all():
        raise PushLogError(f"{path}: {name} is {value!r}; expected {size} finite number(s)")
    return numbers
