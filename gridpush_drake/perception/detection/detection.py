"""One object on a table, found in one photograph: its mask, outline, height and parts.

Several of them are found by `several_detection`.

Where the table is in the picture is found in `table_view`, which pixels are no table in
`foreground`, and what is measured of those that show the object in `measuring`. An object that is
known is followed in `tracking`. The theory is in docs/theory/perception.md, section 2.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import cv2
import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray
from shapely import MultiPolygon, Polygon

from gridpush_drake.errors import (
    MultipleObjectsError,
    NoObjectError,
    NoTableError,
    ObjectAtBorderError,
    ObjectError,
    PerceptionError,
)
from gridpush_drake.geometry.contour import calc_contour
from gridpush_drake.geometry.se2 import Array, transform_back
from gridpush_drake.objects.cells import DEFAULT_MAX_CELLS, MAX_CELLS
from gridpush_drake.objects.grid_object import GridObject, PhysicalPrior
from gridpush_drake.perception.detection.expected_iou import expect_iou
from gridpush_drake.perception.detection.foreground import (
    Cues,
    Foreground,
    calc_contradiction,
    dilate,
    erode,
    find_foreground,
    keep_largest,
    refine_boundary,
)
from gridpush_drake.perception.detection.hints import (
    ObjectHint,
    choose_by_click,
    choose_by_mask,
    choose_in_box,
    join_pieces,
)
from gridpush_drake.perception.detection.joint_foreground import find_jointly
from gridpush_drake.perception.detection.measuring import (
    PIXEL_MIDDLE,
    cast_outline,
    find_height,
    find_parts,
)
from gridpush_drake.perception.images.camera import Camera
from gridpush_drake.perception.images.drawing import GREEN, draw_contours, draw_outline
from gridpush_drake.perception.images.frames import Color, Depth, Mask
from gridpush_drake.perception.images.table_plane import TablePlane
from gridpush_drake.perception.images.table_view import PAINTED_DEPTH, look_at_table

BORDER_WIDTH = 2
"""Width of the strip along the picture's border that the object must not touch, pixels: beyond it,
some of the object may be out of view."""

RIM_GAP = 2
"""Distance in the picture, pixels, within which an object's rim is that of what hides it."""

CUT_FRACTION = 0.1
"""Fraction of an object's rim that may lie there, as where a finger's image reaches over it."""

MIN_PIECE_SCORE = 3.0
"""A further piece of the foreground counts as an object if its median score is at least this; with
less it is the table's own unevenness. The plainest piece counts with any score."""

MAX_TABLE_DEVIATION = 8.0
"""Largest standard deviation of a table's color without depth, units of CIE L*a*b*; what varies
more is taken for no table."""


OUTLINE_SMOOTHING = 0.5
"""Standard deviation of the blur of the coverage before the outline is traced, pixels."""

CLOSE_UP_ROOM = 0.2
"""Room about an object in its close-up, as a part of the object's longer side."""


@dataclass(frozen=True)
class DetectorOptions:
    """What counts as an object.

    Attributes:
        min_area: least area of an object on the table, m^2; what is smaller is left out.
        height: height of the object, m, where it is known; it goes before what depth says.
        parts: whether the object's parts are told apart by color.
        cues: what is looked at.
        hint: where somebody says that the object is; None where the object is found by itself.
    """

    min_area: float = 2e-4
    height: float | None = None
    parts: bool = False
    cues: Cues = "both"
    hint: ObjectHint | None = None


@dataclass(frozen=True, eq=False)
class DetectedObject:
    """An object that was found.

    Attributes:
        outline: contour with holes, W, on the table's plane, m.
        mask: (height, width) bool, the pixels that show it, of the undistorted image.
        height: height of its top above the table, m; 0 where neither depth nor options told it.
        X_WB: (3,) pose (x, y, theta) chosen for the body frame: the outline's centroid, x as in W.
        pixel: (2,) where the body frame's origin is in the photograph as it was taken, pixels.
        parts: polygons by label, W, m; empty where they were not asked for.
        camera: with X_WC: the one given, or, where it was not known, the one that depth gives: W's
            origin is where the optical axis meets the table, x to the right in the image, z up.
        picture: (height, width, 3) uint8, the undistorted photograph with the outline drawn.
        contradiction: fraction of the object about which color and depth contradict each other, see
            `calc_contradiction`.
        doubtful: whether parts of the object hardly stand out from the table, so that its outline
            may be wrong; see `joint_foreground`.
        crowded: whether it may be two objects that touch; only `detect_objects` looks for that.
        expected_iou: expected intersection over union of the mask with the true one, 0 to 1; 1
            where somebody has drawn the mask.
    """

    outline: Polygon
    mask: Mask
    height: float
    X_WB: Array
    pixel: Array
    parts: dict[int, Polygon | MultiPolygon]
    camera: Camera
    picture: Color
    contradiction: float = 0.0
    doubtful: bool = False
    crowded: bool = False
    expected_iou: float = 1.0

    @property
    def close_up(self) -> Color:
        """The part of the picture that shows the object, with some room about it."""
        x, y, width, height = cv2.boundingRect(self.mask.astype(np.uint8))
        room = round(CLOSE_UP_ROOM * max(width, height))
        rows = slice(max(y - room, 0), y + height + room)
        columns = slice(max(x - room, 0), x + width + room)
        return self.picture[rows, columns]

    @cached_property
    def outline_B(self) -> Polygon:
        """The outline in the body frame, m."""
        return self._to_body(self.outline)

    def make_grid_object(self, cell_size: float | None = None, name: str = "object") -> GridObject:
        """Fills the outline with cells.

        Args:
            cell_size: side of a cell, m, about; the default number of cells where None.
            name: name of the object.

        Returns:
            The object, in the body frame B that stands at X_WB.

        Raises:
            ObjectError: the cells would be too many.
        """
        max_cells = DEFAULT_MAX_CELLS
        if cell_size is not None:
            max_cells = max(1, round(self.outline.area / cell_size**2))
        if max_cells > MAX_CELLS:
            least = (self.outline.area / MAX_CELLS) ** 0.5
            raise ObjectError(
                f"{name}: cells of {cell_size:g} m are {max_cells}; expected at most {MAX_CELLS},"
                f" so of at least {least:.2g} m"
            )
        parts = {label: self._to_body(part) for label, part in self.parts.items()}
        prior = PhysicalPrior(uniform_parts=len(parts) > 1)
        obj = GridObject.from_outline(
            self.outline_B, parts=parts, max_cells=max_cells, name=name, prior=prior
        )
        return replace(obj, height=self.height or None)

    def _to_body(self, shape: Polygon) -> Polygon:
        """Moves a shape from W to the body frame, m."""
        return shapely.transform(shape, lambda points: transform_back(self.X_WB, points))


class Photograph(NamedTuple):
    """A photograph in which table and everything else are told apart.

    Attributes:
        color: (height, width, 3) uint8, undistorted.
        plane: the table with the heights above it; None without depth.
        camera: with X_WC.
        found: everything that is no table.
        painted: (height, width) bool, where the table was painted over what hides it.
    """

    color: Color
    plane: TablePlane | None
    camera: Camera
    found: Foreground
    painted: Mask


def detect_object(
    color: Color, depth: Depth | None, camera: Camera, options: DetectorOptions | None = None
) -> DetectedObject:
    """Finds the one object that lies on the table.

    Args:
        color: (height, width, 3) uint8, red, green, blue, as it was taken (distorted).
        depth: (height, width), m, registered to `color`, 0 where it was not measured; None without
            a depth camera.
        camera: camera that took it; X_WC, with the table's top at z = 0, may be left out where
            there is depth.
        options: see `DetectorOptions`.

    Returns:
        The object.

    Raises:
        ImageError: an image has another size than the camera, or depth is not in meters.
        CameraError: neither X_WC nor depth is given.
        NoTableError: no table is in view, or not where X_WC says.
        NoObjectError: there is none on it.
        MultipleObjectsError: there are two or more.
        ObjectAtBorderError: the picture's border cuts it.
        PerceptionError: the height is negative, or the object reaches up to the camera. Each of the
            last five has a picture of what was seen.
    """
    options = options or DetectorOptions()
    seen = read_photograph(color, depth, camera, options)
    mask, coverage, doubtful = _find_pixels(seen, options)
    if not mask.any():
        raise NoObjectError("no object is in view; expected one on the table", seen.color)
    return measure_object(seen, mask, coverage, options, doubtful)


def read_photograph(
    color: Color, depth: Depth | None, camera: Camera, options: DetectorOptions
) -> Photograph:
    """Tells the table and everything else apart in a photograph.

    Args:
        color: see `detect_object`.
        depth: see `detect_object`.
        camera: see `detect_object`.
        options: what counts as an object.

    Returns:
        The photograph, with what is no table.

    Raises:
        ImageError, CameraError, NoTableError, PerceptionError: as `detect_object`.
    """
    color, depth, plane, camera = look_at_table(color, depth, camera)
    if options.height is not None and not 0 <= options.height < camera.center[2]:
        raise PerceptionError(
            f"height is {options.height!r}; expected 0 to {camera.center[2]:.3g} m, where the"
            " camera is",
            color,
        )

    # Table and everything else (section 1). Without depth, only an even color tells the table.
    found = find_foreground(color, plane, options.cues)
    uneven = plane is None and found.deviation.max() > MAX_TABLE_DEVIATION
    if uneven and options.hint is None:
        raise NoTableError("no even color takes the picture's rim; expected a table in view", color)
    painted = np.zeros(color.shape[:2], dtype=bool) if depth is None else depth == PAINTED_DEPTH
    return Photograph(color=color, plane=plane, camera=camera, found=found, painted=painted)


def measure_object(
    seen: Photograph,
    mask: Mask,
    coverage: NDArray[np.float32],
    options: DetectorOptions,
    doubtful: bool,
    crowded: bool = False,
) -> DetectedObject:
    """Measures an object whose pixels are known.

    Args:
        seen: the photograph.
        mask: (height, width) bool, the pixels that show the object.
        coverage: (height, width) how much of each pixel is object, 0 to 1.
        options: its height, where it is known, and whether its parts are told apart.
        doubtful: see `DetectedObject`.
        crowded: see `DetectedObject`.

    Returns:
        The object.

    Raises:
        PerceptionError: no outline on the table can be seen like this.
    """
    # Its height: the one that is known goes before what depth says.
    heights = None
    height = options.height or 0.0
    if seen.plane is not None and options.height is None:
        heights = seen.plane.heights
        height = find_height(heights, mask)

    # Its outline on the table (section 2), and what follows from it.
    camera = seen.camera
    contour = calc_contour(coverage.astype(np.float64), OUTLINE_SMOOTHING)
    outline = cast_outline(contour, camera, mask, heights, height)
    X_WB = np.array([*outline.centroid.coords[0], 0.0])
    parts: dict[int, Polygon | MultiPolygon] = {}
    if options.parts:
        parts = find_parts(seen.color, mask, camera, outline, height)
    contradiction = 0.0
    if options.cues == "both":
        contradiction = calc_contradiction(mask, seen.found, seen.plane)
    drawn = options.hint is not None and options.hint.mask is not None
    return DetectedObject(
        outline=outline,
        mask=mask,
        height=height,
        X_WB=X_WB,
        pixel=camera.project([*X_WB[:2], 0.0]),
        parts=parts,
        camera=camera,
        picture=draw_found(seen.color, camera, mask, outline, X_WB),
        contradiction=contradiction,
        doubtful=doubtful,
        crowded=crowded,
        expected_iou=1.0 if drawn else expect_iou(mask, seen.found),
    )


def draw_found(
    color: Color, camera: Camera, mask: Mask, outline: Polygon, X_WB: ArrayLike
) -> Color:
    """Draws what was found of an object into a photograph.

    Args:
        color: (height, width, 3) uint8, the undistorted photograph.
        camera: the camera of that photograph, with X_WC.
        mask: (height, width) bool, the pixels that show the object; their contour is green.
        outline: the outline on the table, in W, m; it is blue.
        X_WB: (3,) pose of the body frame, m and rad; its axes are red (x) and green (y).

    Returns:
        A new picture.
    """
    picture = draw_contours(color, mask, GREEN)
    return draw_outline(picture, camera, outline, 0.0, X_WB)


def _find_pixels(
    seen: Photograph, options: DetectorOptions
) -> tuple[Mask, NDArray[np.float32], bool]:
    """Finds the pixels that show the object, by itself or where a hint says.

    Returns:
        (height, width) bool, the mask; how much of each pixel is object, 0 to 1; and whether that
        is doubtful.
    """
    color = seen.color
    found = seen.found
    hint = options.hint
    if hint is None:
        if seen.plane is None or options.cues != "both":
            return (*refine_boundary(_choose_object(seen, options), found), False)
        return _find_whole(seen, seen.plane, options)
    try:
        drawn = hint.place(seen.camera)
        if hint.mask is not None:
            # Whoever made the mask has drawn the boundary; only its steps of a pixel are smoothed.
            mask = choose_by_mask(drawn)
            _check_in_view(mask, color)
            return mask, mask.astype(np.float32), False
        boxed = hint.box is not None
        rough = choose_in_box(color, found, drawn) if boxed else choose_by_click(found, drawn)
    except PerceptionError as error:
        raise type(error)(str(error), color) from error
    if not rough.any():
        where = "in the box" if boxed else "where the click is"
        raise NoObjectError(f"nothing stands out from the table {where}", color)
    if boxed:
        # The boundary of each piece is drawn before they are joined: what joins them may have the
        # table's color. (Nothing is covered; saying so keeps more pieces than the largest.)
        pieces, coverage = refine_boundary(rough, found, covered=np.zeros_like(rough))
        mask = join_pieces(pieces, drawn, found)
        coverage = np.where(mask == pieces, coverage, mask).astype(np.float32)
    else:
        mask, coverage = refine_boundary(rough, found)
    _check_in_view(mask, color)
    return mask, coverage, False


def _find_whole(
    seen: Photograph, plane: TablePlane, options: DetectorOptions
) -> tuple[Mask, NDArray[np.float32], bool]:
    """Finds the pixels that show the object, also where parts of it hardly stand out.

    Returns:
        As `_find_pixels`.

    Raises:
        PerceptionError: there is no object, or there are several, or one is cut by the border.
    """
    refused: MultipleObjectsError | None = None
    try:
        mask, coverage = refine_boundary(_choose_object(seen, options), seen.found)
    except MultipleObjectsError as error:
        refused = error
    joint = find_jointly(seen.color, plane, seen.found, seen.painted)
    if refused is None and (joint is None or not joint.disputes(mask)):
        return mask, coverage, False

    # Several pieces are one object only if all that stands out is in what joins them.
    if joint is None or (refused is not None and joint.disputes(joint.mask)):
        assert refused is not None
        raise refused
    _check_in_view(joint.mask, seen.color)
    return joint.mask, joint.mask.astype(np.float32), True


def _check_in_view(mask: Mask, color: Color) -> None:
    """Raises ObjectAtBorderError where the picture's border cuts an object."""
    if not is_in_view(mask):
        problem = "the object touches the picture's border; expected all of it in view"
        raise ObjectAtBorderError(problem, draw_contours(color, mask))


def _choose_object(seen: Photograph, options: DetectorOptions) -> Mask:
    """Chooses the one piece of the foreground that is large enough to be an object."""
    pieces = list_pieces(seen, options)
    if not pieces:
        raise NoObjectError("no object is in view; expected one on the table", seen.color)
    chosen = np.logical_or.reduce(pieces)
    if len(pieces) > 1:
        problem = f"{len(pieces)} objects are in view; expected one"
        raise MultipleObjectsError(problem, draw_contours(seen.color, chosen))
    _check_in_view(chosen, seen.color)
    return keep_largest(chosen)


def list_pieces(seen: Photograph, options: DetectorOptions) -> list[Mask]:
    """Lists the pieces of the foreground that are large enough to be objects.

    Args:
        seen: the photograph.
        options: the least area of an object.

    Returns:
        (height, width) bool for each piece.
    """
    score = seen.found.score
    count, labels, stats, middles = cv2.connectedComponentsWithStats(
        seen.found.mask.astype(np.uint8), connectivity=8
    )

    # The area of each piece on the table: its pixels, times what a pixel at its middle takes there.
    # That is the parallelogram of the pixel's upper left, upper right and lower left corners.
    low = -PIXEL_MIDDLE
    high = PIXEL_MIDDLE
    corners = np.array([[low, low], [high, low], [low, high]])
    places = seen.camera.undistorted.cast(middles[:, None] + corners)
    across, down = np.moveaxis(places[:, 1:] - places[:, :1], 1, 0)
    pixel_area = np.abs(across[:, 0] * down[:, 1] - across[:, 1] * down[:, 0])
    area = stats[:, cv2.CC_STAT_AREA] * pixel_area
    large = [i for i in range(1, count) if area[i] >= options.min_area]
    if not large:
        return []

    # The plainest piece is an object. Others count only if they stand out from the table: faint
    # ones are the table's own unevenness.
    plainest = max(large, key=lambda i: score[labels == i].sum())
    return [
        labels == i
        for i in large
        if i == plainest or np.median(score[labels == i]) >= MIN_PIECE_SCORE
    ]


def is_in_view(mask: Mask) -> bool:
    """Says whether a mask (height, width) keeps clear of the picture's border."""
    return bool(mask[BORDER_WIDTH:-BORDER_WIDTH, BORDER_WIDTH:-BORDER_WIDTH].sum() == mask.sum())


def is_cut_off(mask: Mask, hidden: Mask) -> bool:
    """Says whether the rim of an object ends at what hides it.

    Args:
        mask: (height, width) bool, the object's pixels.
        hidden: (height, width) bool, pixels that show the robot.
    """
    rim = mask & ~erode(mask, 3)
    beside = rim & dilate(hidden, 2 * RIM_GAP + 1)
    return bool(beside.sum() > CUT_FRACTION * rim.sum())
