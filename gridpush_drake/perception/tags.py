"""AprilTags of the family 36h11: found in a photograph, placed in the world, and aligned with an object's body.

A board of such tags lies on the table; a photograph of it tells where the camera is. The board's
frame is W: its origin in the middle of the board, x to the right and y up on the sheet, z out of
it.
"""

from dataclasses import dataclass
from io import BytesIO
from math import atan2

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridpush_drake.errors import CameraError, TagError
from gridpush_drake.geometry.se2 import Array, compose, invert
from gridpush_drake.perception.camera import NOT_KNOWN, Camera
from gridpush_drake.perception.frames import Color
from gridpush_drake.perception.tracking import measure_edges, sample_image

INCH = 25.4e-3
"""In m."""

BITS = 8
"""Of a tag's side, with its black border, which are printed."""

DOTS = 150
"""Per inch, of the printed sheet, nearly; the true number makes a bit a whole number of dots."""

SIDE_POINTS, SIDE_ENDS = 24, 0.12
"""Edges looked for along a side of a tag; and the share of it at each end that is left out."""

EDGE_REACH, EDGE_STEP = 0.6, 0.125
"""How far across the side they are looked for, in bits of the tag, and in what steps, pixels."""

MIN_TAGS = 2
"""Of a board, that must be seen."""

MAX_BOARD_SIDE = 2.0
"""Of what is printed of a board, m; a larger one was given in another unit."""

MAX_BOARD_ERROR = 3.0
"""Root mean square distance of the tags' corners from where the board would have them, pixels."""


@dataclass(frozen=True, eq=False)
class DetectedTag:
    """A tag that was found.

    Attributes:
        id: its number in the family.
        corners: (4, 2) pixels of its black square in the photograph as it was taken, clockwise from
            the upper left.
        X_CT: (4, 4) pose of the tag in the camera: x to the tag's right, y up, z out of its face;
            origin in its middle.
        X_WT: (4, 4) likewise in the world; None where the camera's pose is not known.
    """

    id: int
    corners: Array
    X_CT: Array
    X_WT: Array | None

    @property
    def planar_pose(self) -> Array:
        """(3,) pose (x, y, theta) of the tag in W, m and rad. Raises CameraError where X_WT is not known."""
        if self.X_WT is None:
            raise CameraError(NOT_KNOWN)
        return np.array([*self.X_WT[:2, 3], atan2(self.X_WT[1, 0], self.X_WT[0, 0])])


def detect_tags(
    gray: NDArray[np.uint8], camera: Camera, size: float, height: float | None = None
) -> dict[int, DetectedTag]:
    """Finds the tags in a photograph.

    Args:
        gray: (height, width) uint8, or (height, width, 3) color, as it was taken.
        camera: that took it.
        size: side of a tag's black square, m.
        height: of the tags over the table, m, where they lie level: with the camera's pose it makes
            theirs ten times as exact; None where they stand anyhow.

    Returns:
        The tags by id.

    Raises:
        ImageError: the image has another size than the camera.
        TagError: the size is not positive.
    """
    camera.check_size(gray)
    if not size > 0:
        raise TagError(f"a tag's size is {size!r}; expected a positive number, in m")
    found = {}
    for number, corners in find_tag_corners(gray).items():
        X_CT = _solve_pose(corners, camera, size)
        X_WT = None if camera.X_WC is None else camera.X_WC @ X_CT
        if X_WT is not None and height is not None:
            X_WT = _lay_level(corners, camera, size, height)
        found[number] = DetectedTag(number, corners, X_CT, X_WT)
    return found


def solve_tag_to_body(tag: DetectedTag, X_WB: ArrayLike) -> Array:
    """The pose of a body in a tag that is fixed to it, from one photograph that shows the tag and told the body's pose.

    Args:
        tag: with X_WT.
        X_WB: (3,) the body's pose (x, y, theta), m and rad.

    Returns:
        (3,) the body's planar pose (x, y, theta) in the tag, X_TB: with a later tag,
        `geometry.compose(tag.planar_pose, X_TB)` is the body's pose.

    Raises:
        CameraError: the camera's pose is not known.
    """
    return compose(invert(tag.planar_pose), X_WB)


@dataclass(frozen=True)
class TagBoard:
    """A sheet of tags in rows and columns; numbers run from `first` on, left to right, then down.

    Attributes:
        columns: of tags.
        rows: of tags.
        size: side of a tag's black square, m.
        gap: between two tags, m.
        first: number of the tag in the upper left.

    Raises:
        TagError: a count or a length is not positive, the board is larger than MAX_BOARD_SIDE, or
            the family has fewer tags.
    """

    columns: int = 4
    rows: int = 5
    size: float = 0.035
    gap: float = 0.0105
    first: int = 0

    def __post_init__(self) -> None:
        count = self.columns * self.rows
        if min(self.columns, self.rows) < 1 or count < MIN_TAGS:
            raise TagError(
                f"a board of {self.columns} x {self.rows} tags; expected at least {MIN_TAGS}"
            )
        if not (self.size > 0 and self.gap > 0):
            raise TagError(
                f"a board's tags are {self.size!r} m, {self.gap!r} m apart; expected positive numbers"
            )
        width, height = self.extent
        if not max(width, height) <= MAX_BOARD_SIDE:
            raise TagError(
                f"a board of {width:g} x {height:g} m; expected at most {MAX_BOARD_SIDE:g} m a side"
            )
        most = len(_family().bytesList)
        if not 0 <= self.first <= most - count:
            raise TagError(
                f"a board's tags are {self.first} to {self.first + count - 1}; expected 0 to {most - 1}"
            )

    @property
    def extent(self) -> tuple[float, float]:
        """Width and height of what is printed, m."""
        step = self.size + self.gap
        return self.columns * step - self.gap, self.rows * step - self.gap

    @property
    def corners(self) -> dict[int, Array]:
        """(4, 3) corners of each tag by number, W, m, clockwise from its upper left."""
        width, height = self.extent
        step, found = self.size + self.gap, {}
        square = self.size * np.array(
            [[0, 0, 0], [1, 0, 0], [1, -1, 0], [0, -1, 0]], dtype=np.float64
        )
        for i in range(self.columns * self.rows):
            row, column = divmod(i, self.columns)
            found[self.first + i] = square + [
                column * step - width / 2,
                height / 2 - row * step,
                0.0,
            ]
        return found

    def make_pdf(self) -> bytes:
        """The sheet at its true size, as a PDF file; it is to be printed at 100 %."""
        from PIL import Image

        dot = self.size / (BITS * max(1, round(self.size / BITS / INCH * DOTS)))
        margin = round(self.gap / dot)
        width, height = (round(side / dot) + 2 * margin for side in self.extent)
        sheet = np.full((height, width), 255, np.uint8)
        side, step = round(self.size / dot), (self.size + self.gap) / dot
        for i in range(self.columns * self.rows):
            row, column = divmod(i, self.columns)
            y, x = margin + round(row * step), margin + round(column * step)
            sheet[y : y + side, x : x + side] = cv2.aruco.generateImageMarker(
                _family(), self.first + i, side
            )
        file = BytesIO()
        Image.fromarray(sheet).save(file, "PDF", resolution=INCH / dot)
        return file.getvalue()


def calibrate_pose(
    gray: NDArray[np.uint8], camera: Camera, board: TagBoard
) -> tuple[Camera, float]:
    """Finds where a camera is from a photograph of a board on the table.

    Args:
        gray: (height, width) uint8, or (height, width, 3) color, as it was taken.
        camera: that took it; its pose is not used.
        board: that lies on the table.

    Returns:
        The camera with X_WC, W the board's frame, and the root mean square error of the corners,
        pixels.

    Raises:
        ImageError: the image has another size than the camera.
        TagError: fewer than MIN_TAGS of the board's tags are in view, or they do not lie as on the
            board.
    """
    camera.check_size(gray)
    found, known = find_tag_corners(gray), board.corners
    common = sorted(found.keys() & known.keys())
    if len(common) < MIN_TAGS:
        there = ", ".join(map(str, sorted(found))) or "none"
        raise TagError(
            f"{len(common)} of the board's tags ({board.first} to {max(known)}) are in view, at least {MIN_TAGS} are "
            f"expected; tags seen: {there}",
            draw_tags(gray, found),
        )
    p_W, pixels = (np.concatenate([corners[i] for i in common]) for corners in (known, found))
    done, turn, shift = cv2.solvePnP(
        p_W, pixels, camera.K, camera.distortion, flags=cv2.SOLVEPNP_IPPE
    )
    assert done
    turn, shift = cv2.solvePnPRefineLM(p_W, pixels, camera.K, camera.distortion, turn, shift)
    X_CW = _make_transform(turn, shift)
    placed = camera.with_pose(np.linalg.inv(X_CW))
    error = float(np.sqrt(((placed.project(p_W) - pixels) ** 2).sum(axis=1).mean()))
    if not error <= MAX_BOARD_ERROR:
        raise TagError(
            f"the tags' corners are {error:.1f} pixels from where the board would have them; expected at most "
            f"{MAX_BOARD_ERROR:g}: check --board and the camera's file",
            draw_tags(gray, found),
        )
    return placed, error


def draw_tag(number: int) -> NDArray[np.uint8]:
    """Draws a tag, a pixel a bit: (BITS, BITS), 0 for black and 255 for white, with its black border."""
    return np.asarray(cv2.aruco.generateImageMarker(_family(), number, BITS), dtype=np.uint8)


def draw_tags(gray: NDArray[np.uint8], found: dict[int, Array]) -> Color:
    """Draws tags' corners (4, 2) by number into a photograph; returns a new one, in color."""
    picture = np.array(gray if gray.ndim == 3 else np.repeat(gray[..., None], 3, axis=-1))
    if found:
        corners = tuple(found[i].astype(np.float32)[None] for i in found)
        cv2.aruco.drawDetectedMarkers(picture, corners, np.array(list(found)))
    return picture


def _family() -> cv2.aruco.Dictionary:
    return cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)


def find_tag_corners(gray: NDArray[np.uint8]) -> dict[int, Array]:
    """Finds the corners (4, 2) of each tag in an image by number; of a number that is seen twice, the larger's."""
    image = (
        gray
        if gray.ndim == 2
        else np.asarray(cv2.cvtColor(gray, cv2.COLOR_RGB2GRAY), dtype=np.uint8)
    )
    corners, ids, _ = cv2.aruco.ArucoDetector(
        _family(), cv2.aruco.DetectorParameters()
    ).detectMarkers(image)
    numbers = [] if ids is None else [int(number) for number in np.ravel(ids)]
    quads = [_refine(image, np.asarray(quad, dtype=np.float64).reshape(4, 2)) for quad in corners]
    by_size = sorted(
        zip(numbers, quads, strict=True), key=lambda tag: float(np.ptp(tag[1], axis=0).max())
    )
    return dict(by_size)


def _refine(image: NDArray[np.uint8], corners: Array) -> Array:
    """The corners (4, 2) where straight lines through the edges of the tag's four sides meet.

    An edge is where the image is half way from the black of the border to the white about it. A
    side along which too few are found leaves its corners as they are.
    """
    ends = np.roll(corners, -1, axis=0)
    along = np.linspace(SIDE_ENDS, 1 - SIDE_ENDS, SIDE_POINTS)[:, None]
    lines = []
    for a, b in zip(corners, ends, strict=True):
        tangent = (b - a) / np.linalg.norm(b - a)
        normal = np.array([tangent[1], -tangent[0]])
        points = a + along * (b - a)
        reach = EDGE_REACH * float(np.linalg.norm(b - a)) / BITS
        normals = np.repeat(normal[None], len(points), axis=0)
        black, white = (
            float(np.median(sample_image(image, points + s * reach * normals))) for s in (-1, 1)
        )
        darkness = ((white - image.astype(np.float32)) / max(white - black, 1.0)).astype(np.float32)
        offsets, _ = measure_edges(
            darkness, np.zeros(image.shape, dtype=bool), points, normals, reach, EDGE_STEP
        )
        found = np.isfinite(offsets)
        if found.sum() < SIDE_POINTS // 2:
            return corners
        edge = points[found] + offsets[found, None] * normal
        slope, level = np.polyfit((edge - a) @ tangent, (edge - a) @ normal, 1)
        direction = tangent + slope * normal
        lines.append((np.array([direction[1], -direction[0]]), a + level * normal))
    meets = [
        np.linalg.solve([one, other], [one @ p, other @ q])
        for (one, p), (other, q) in zip(np.roll(np.array(lines), 1, axis=0), lines, strict=True)
    ]
    return np.array(meets)


def _make_square(size: float) -> Array:
    """(4, 3) corners of a tag in its own frame, clockwise from the upper left."""
    half = size / 2
    return np.array([[-half, half, 0], [half, half, 0], [half, -half, 0], [-half, -half, 0]])


def _solve_pose(corners: Array, camera: Camera, size: float) -> Array:
    """(4, 4) X_CT from the corners alone."""
    square = _make_square(size)
    _, turn, shift = cv2.solvePnP(
        square, corners, camera.K, camera.distortion, flags=cv2.SOLVEPNP_IPPE_SQUARE
    )
    turn, shift = cv2.solvePnPRefineLM(square, corners, camera.K, camera.distortion, turn, shift)
    return _make_transform(turn, shift)


def _lay_level(corners: Array, camera: Camera, size: float, height: float) -> Array:
    """(4, 4) X_WT of a tag that lies level: its corners cast to that height, and a square laid on them."""
    p_W, square = camera.cast(corners, height), _make_square(size)[:, :2]
    middle = p_W.mean(axis=0)
    a, b = square, p_W - middle
    theta = atan2((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum(), (a * b).sum())
    c, s = np.cos(theta), np.sin(theta)
    X_WT = np.eye(4)
    X_WT[:2, :2], X_WT[:3, 3] = [[c, -s], [s, c]], [*middle, height]
    return X_WT


def _make_transform(turn: ArrayLike, shift: ArrayLike) -> Array:
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = cv2.Rodrigues(np.asarray(turn))[0], np.ravel(shift)
    return X
