"""AprilTags of the family 36h11: found in a photograph, placed in the world and bound to a body.

A board of such tags lies on the table; a photograph of it tells where the camera is. The board's
frame is W: its origin in the middle of the board, x to the right and y up on the sheet, z out of
it.

Objects without tags are found in `detection`. The theory is in docs/theory/perception.md, section
4.
"""

from dataclasses import dataclass
from io import BytesIO
from math import atan2

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridpush_drake.errors import CameraError, TagError
from gridpush_drake.geometry.se2 import Array, compose, invert
from gridpush_drake.perception.images.camera import NOT_KNOWN, Camera
from gridpush_drake.perception.images.frames import Color
from gridpush_drake.perception.tracking.registration import measure_edges, sample_image
from gridpush_drake.units import M_PER_INCH

TAG_BITS = 8
"""Bits along a printed tag's side, with its black border."""

DOTS_PER_INCH = 150
"""Resolution of the printed sheet, dots per inch, nearly: the true number makes a bit a whole
number of dots."""

SIDE_POINTS = 24
"""Points along a side of a tag at which its edge is looked for; a side needs half of them."""

SIDE_ENDS = 0.12
"""Fraction of a tag's side at each end that is left out: near a corner the neighboring side's edge
blurs into it."""

EDGE_REACH = 0.6
"""How far across a tag's side its edge is looked for, bits of the tag; a whole bit further is the
next edge."""

EDGE_STEP = 0.125
"""Distance between two samples across a tag's side, pixels."""

MIN_TAGS = 2
"""Least number of a board's tags that a board has, and that must be seen of it."""

MAX_BOARD_SIDE = 2.0
"""Longest side of what is printed of a board, m; a larger one was given in another unit."""

MAX_BOARD_ERROR = 3.0
"""Greatest root mean square distance of the tags' corners from where the board would have them,
pixels; beyond it the sheet is not the board that was described."""


@dataclass(frozen=True, eq=False)
class DetectedTag:
    """A tag that was found.

    Attributes:
        id: its number in the family.
        corners: (4, 2) pixels of its black square in the photograph as it was taken, clockwise from
            the upper left.
        X_CT: (4, 4) pose of the tag in the camera: x to the tag's right, y up, z out of its face;
            origin in its middle.
        X_WT: (4, 4) pose of the tag in the world; None where the camera's pose is not known.
    """

    id: int
    corners: Array
    X_CT: Array
    X_WT: Array | None

    @property
    def planar_pose(self) -> Array:
        """(3,) pose (x, y, theta) of the tag in W, m and rad.

        Raises:
            CameraError: X_WT is not known.
        """
        if self.X_WT is None:
            raise CameraError(NOT_KNOWN)
        theta = atan2(self.X_WT[1, 0], self.X_WT[0, 0])
        return np.array([*self.X_WT[:2, 3], theta])


def detect_tags(
    gray: NDArray[np.uint8], camera: Camera, size: float, height: float | None = None
) -> dict[int, DetectedTag]:
    """Finds the tags in a photograph.

    Args:
        gray: (height, width) uint8, or (height, width, 3) color, as it was taken.
        camera: camera that took it.
        size: side of a tag's black square, m.
        height: height of the tags over the table, m, where they lie level: with the camera's pose
            it makes their places ten times as exact; None where they stand anyhow.

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
        X_WT = None
        if camera.X_WC is not None:
            X_WT = camera.X_WC @ X_CT
            # A known height says more of a tag's place than the size of its picture does.
            if height is not None:
                X_WT = _lay_level(corners, camera, size, height)
        found[number] = DetectedTag(id=number, corners=corners, X_CT=X_CT, X_WT=X_WT)
    return found


def solve_tag_to_body(tag: DetectedTag, X_WB: ArrayLike) -> Array:
    """Finds the pose of a body in a tag that is fixed to it.

    It takes one photograph that shows the tag and tells the body's pose.

    Args:
        tag: tag with X_WT.
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
        columns: number of tags in a row.
        rows: number of rows of tags.
        size: side of a tag's black square, m.
        gap: distance between the black squares of two neighboring tags, m.
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
                f"a board's tags are {self.size!r} m, {self.gap!r} m apart; expected positive"
                " numbers"
            )
        width, height = self.extent
        if not max(width, height) <= MAX_BOARD_SIDE:
            raise TagError(
                f"a board of {width:g} x {height:g} m; expected at most {MAX_BOARD_SIDE:g} m a side"
            )
        most = len(_get_family().bytesList)
        if not 0 <= self.first <= most - count:
            last = self.first + count - 1
            raise TagError(f"a board's tags are {self.first} to {last}; expected 0 to {most - 1}")

    @property
    def extent(self) -> tuple[float, float]:
        """Width and height of what is printed, m."""
        step = self.size + self.gap
        width = self.columns * step - self.gap
        height = self.rows * step - self.gap
        return width, height

    @property
    def corners(self) -> dict[int, Array]:
        """(4, 3) corners of each tag by number, W, m, clockwise from its upper left."""
        width, height = self.extent
        step = self.size + self.gap
        unit_square = np.array(
            [
                [0.0, 0.0, 0.0],
                [1.0, 0.0, 0.0],
                [1.0, -1.0, 0.0],
                [0.0, -1.0, 0.0],
            ]
        )
        square = self.size * unit_square
        found = {}
        for i in range(self.columns * self.rows):
            row, column = divmod(i, self.columns)
            # The tag's upper left corner, from the board's middle.
            x = column * step - width / 2
            y = height / 2 - row * step
            found[self.first + i] = square + [x, y, 0.0]
        return found

    def make_pdf(self) -> bytes:
        """Makes the sheet at its true size, as a PDF file; it is to be printed at 100 %."""
        from PIL import Image

        # Size of a dot, m, such that a bit is a whole number of dots: a printer then draws the tags
        # as they are.
        dots_a_bit = max(1, round(self.size / TAG_BITS / M_PER_INCH * DOTS_PER_INCH))
        dot = self.size / (TAG_BITS * dots_a_bit)
        margin = round(self.gap / dot)
        width, height = (round(side / dot) + 2 * margin for side in self.extent)
        sheet = np.full((height, width), 255, np.uint8)

        side = round(self.size / dot)
        step = (self.size + self.gap) / dot
        for i in range(self.columns * self.rows):
            row, column = divmod(i, self.columns)
            y = margin + round(row * step)
            x = margin + round(column * step)
            tag = cv2.aruco.generateImageMarker(_get_family(), self.first + i, side)
            sheet[y : y + side, x : x + side] = tag
        file = BytesIO()
        Image.fromarray(sheet).save(file, "PDF", resolution=M_PER_INCH / dot)
        return file.getvalue()


def calibrate_pose(
    gray: NDArray[np.uint8], camera: Camera, board: TagBoard
) -> tuple[Camera, float]:
    """Finds where a camera is from a photograph of a board on the table.

    Args:
        gray: (height, width) uint8, or (height, width, 3) color, as it was taken.
        camera: camera that took it; its pose is not used.
        board: board that lies on the table.

    Returns:
        The camera with X_WC, W the board's frame, and the root mean square error of the corners,
        pixels.

    Raises:
        ImageError: the image has another size than the camera.
        TagError: fewer than MIN_TAGS of the board's tags are in view, or they do not lie as on the
            board.
    """
    camera.check_size(gray)
    found = find_tag_corners(gray)
    known = board.corners
    common = sorted(found.keys() & known.keys())
    if len(common) < MIN_TAGS:
        there = ", ".join(map(str, sorted(found))) or "none"
        raise TagError(
            f"{len(common)} of the board's tags ({board.first} to {max(known)}) are in view, at"
            f" least {MIN_TAGS} are expected; tags seen: {there}",
            draw_tags(gray, found),
        )

    # All corners lie on one plane: IPPE solves that in closed form, and Levenberg and Marquardt's
    # method refines it.
    p_W = np.concatenate([known[i] for i in common])
    pixels = np.concatenate([found[i] for i in common])
    done, turn, shift = cv2.solvePnP(
        p_W, pixels, camera.K, camera.distortion, flags=cv2.SOLVEPNP_IPPE
    )
    assert done
    turn, shift = cv2.solvePnPRefineLM(p_W, pixels, camera.K, camera.distortion, turn, shift)
    X_CW = _make_transform(turn, shift)
    placed = camera.with_pose(np.linalg.inv(X_CW))

    # A sheet printed at another scale, or a wrong file of the camera, shows in the corners.
    off = placed.project(p_W) - pixels
    error = float(np.sqrt((off**2).sum(axis=1).mean()))
    if not error <= MAX_BOARD_ERROR:
        raise TagError(
            f"the tags' corners are {error:.1f} pixels from where the board would have them;"
            f" expected at most {MAX_BOARD_ERROR:g}: check --board and the camera's file",
            draw_tags(gray, found),
        )
    return placed, error


def draw_tag(number: int) -> NDArray[np.uint8]:
    """Draws a tag with its black border, one pixel a bit.

    Args:
        number: number of the tag in the family.

    Returns:
        (TAG_BITS, TAG_BITS) uint8, 0 for black and 255 for white.
    """
    tag = cv2.aruco.generateImageMarker(_get_family(), number, TAG_BITS)
    return np.asarray(tag, dtype=np.uint8)


def draw_tags(gray: NDArray[np.uint8], found: dict[int, Array]) -> Color:
    """Draws tags' corners (4, 2) by number into a photograph; returns a new one, in color."""
    color = gray
    if gray.ndim != 3:
        color = np.repeat(gray[..., None], 3, axis=-1)
    picture = np.array(color)
    if found:
        corners = tuple(found[i].astype(np.float32)[None] for i in found)
        cv2.aruco.drawDetectedMarkers(picture, corners, np.array(list(found)))
    return picture


def _get_family() -> cv2.aruco.Dictionary:
    """Gets OpenCV's description of the family 36h11."""
    return cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)


def find_tag_corners(gray: NDArray[np.uint8]) -> dict[int, Array]:
    """Finds the corners of each tag in an image.

    Args:
        gray: (height, width) uint8, or (height, width, 3) color.

    Returns:
        (4, 2) corners by number, pixels, clockwise from the tag's upper left; of a number that is
        seen twice, the larger's.
    """
    image = gray
    if gray.ndim != 2:
        image = np.asarray(cv2.cvtColor(gray, cv2.COLOR_RGB2GRAY), dtype=np.uint8)
    detector = cv2.aruco.ArucoDetector(_get_family(), cv2.aruco.DetectorParameters())
    corners, ids, _ = detector.detectMarkers(image)
    if ids is None:
        return {}
    numbers = [int(number) for number in np.ravel(ids)]
    quads = []
    for corner in corners:
        quad = np.asarray(corner, dtype=np.float64).reshape(4, 2)
        quads.append(_refine(image, quad))

    # The larger ones come last, and so stay in the dictionary.
    def calc_extent(tag: tuple[int, Array]) -> float:
        _, quad = tag
        return float(np.ptp(quad, axis=0).max())

    tags = zip(numbers, quads, strict=True)
    return dict(sorted(tags, key=calc_extent))


def _refine(image: NDArray[np.uint8], corners: Array) -> Array:
    """Refines a tag's corners (4, 2): lines through the edges of its four sides meet there.

    An edge is where the image is half way from the black of the border to the white about it. A
    side along which too few are found leaves its corners as they are.
    """
    ends = np.roll(corners, -1, axis=0)
    along = np.linspace(SIDE_ENDS, 1 - SIDE_ENDS, SIDE_POINTS)[:, None]
    lines = []
    for a, b in zip(corners, ends, strict=True):
        # Points along the side, with the normal that points out of the tag.
        length = float(np.linalg.norm(b - a))
        tangent = (b - a) / length
        normal = np.array([tangent[1], -tangent[0]])
        points = a + along * (b - a)
        normals = np.repeat(normal[None], len(points), axis=0)

        # How dark each pixel is, between the side's own black and white: light may be uneven.
        reach = EDGE_REACH * length / TAG_BITS
        black = float(np.median(sample_image(image, points - reach * normals)))
        white = float(np.median(sample_image(image, points + reach * normals)))
        contrast = max(white - black, 1.0)
        darkness = ((white - image.astype(np.float32)) / contrast).astype(np.float32)

        # Edges are then where darkness falls through a half, as those of an object are.
        nothing = np.zeros(image.shape, dtype=bool)
        offsets, _ = measure_edges(darkness, nothing, points, normals, reach, EDGE_STEP)
        found = np.isfinite(offsets)
        if found.sum() < SIDE_POINTS // 2:
            return corners

        # The line through them, as its normal and a point.
        edge = points[found] + offsets[found, None] * normal
        arm = edge - a
        slope, level = np.polyfit(arm @ tangent, arm @ normal, 1)
        direction = tangent + slope * normal
        line_normal = np.array([direction[1], -direction[0]])
        lines.append((line_normal, a + level * normal))

    # Each corner is on the line of its own side and on that of the side before: n.p is given on
    # both.
    before = np.roll(np.array(lines), 1, axis=0)
    meets = []
    for (one, p), (other, q) in zip(before, lines, strict=True):
        sides = [one, other]
        meets.append(np.linalg.solve(sides, [one @ p, other @ q]))
    return np.array(meets)


def _make_square(size: float) -> Array:
    """Makes the corners (4, 3) of a tag in its own frame, m, clockwise from the upper left."""
    half = size / 2
    return np.array(
        [
            [-half, half, 0],
            [half, half, 0],
            [half, -half, 0],
            [-half, -half, 0],
        ]
    )


def _solve_pose(corners: Array, camera: Camera, size: float) -> Array:
    """Solves for X_CT (4, 4) from a tag's corners (4, 2) alone."""
    square = _make_square(size)
    _, turn, shift = cv2.solvePnP(
        square, corners, camera.K, camera.distortion, flags=cv2.SOLVEPNP_IPPE_SQUARE
    )
    turn, shift = cv2.solvePnPRefineLM(square, corners, camera.K, camera.distortion, turn, shift)
    return _make_transform(turn, shift)


def _lay_level(corners: Array, camera: Camera, size: float, height: float) -> Array:
    """Finds X_WT (4, 4) of a tag that lies level at a known height, m."""
    p_W = camera.cast(corners, height)
    square = _make_square(size)[:, :2]

    # A square laid on the four points by least squares: its middle on theirs, and the angle that
    # turns its corners toward them.
    middle = p_W.mean(axis=0)
    arm = p_W - middle
    across = square[:, 0] * arm[:, 1] - square[:, 1] * arm[:, 0]
    along = square * arm
    theta = atan2(across.sum(), along.sum())
    c = np.cos(theta)
    s = np.sin(theta)
    X_WT = np.eye(4)
    X_WT[:2, :2] = [[c, -s], [s, c]]
    X_WT[:3, 3] = [*middle, height]
    return X_WT


def _make_transform(turn: ArrayLike, shift: ArrayLike) -> Array:
    """Makes a transform (4, 4) of OpenCV's rotation vector and translation, m."""
    X = np.eye(4)
    X[:3, :3] = cv2.Rodrigues(np.asarray(turn))[0]
    X[:3, 3] = np.ravel(shift)
    return X
