"""One object on a table, found in one photograph: its mask, outline, height and parts.

What is seen of a prism of height h is its outline on every level from the table to h. A pixel of
the picture's outline shows a point of the top where the prism's side there faces away from the
camera, and one of the bottom where it faces it. So the outline is what the pixels' rays meet on all
levels: the intersection of the picture's outline cast to some levels from the table to the height.

Which pixels are no table is found in `foreground`, and an object that is known is followed in
`tracking`. The theory is in docs/theory/perception.md, section 2.
"""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray
from shapely import MultiPolygon, Polygon
from shapely.geometry.base import BaseGeometry
from shapely.geometry.polygon import orient

from gridpush_drake.errors import (
    CameraError,
    NoObjectError,
    NoTableError,
    ObjectAtBorderError,
    ObjectError,
    PerceptionError,
    SeveralObjectsError,
)
from gridpush_drake.geometry.contour import calc_contour
from gridpush_drake.geometry.se2 import Array, transform_back
from gridpush_drake.objects.cells import DEFAULT_MAX_CELLS, MAX_CELLS
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.perception.camera import Camera
from gridpush_drake.perception.foreground import (
    Cues,
    Foreground,
    calc_contradiction,
    find_foreground,
    keep_largest,
    refine_boundary,
    to_lab,
)
from gridpush_drake.perception.frames import Color, Depth
from gridpush_drake.perception.hints import (
    ObjectHint,
    choose_by_click,
    choose_by_mask,
    choose_in_box,
    join_pieces,
)
from gridpush_drake.perception.joint_foreground import find_jointly
from gridpush_drake.perception.table_plane import Heights, TablePlane, fit_table

Mask = NDArray[np.bool_]

PIXEL_MIDDLE = 0.5
"""Distance from a pixel's upper left corner to its middle along each axis, pixels."""

BORDER = 2
"""Width of the strip along the picture's border that the object must not touch, pixels: beyond it,
some of the object may be out of view."""

CERTAIN = 3.0
"""A further piece of the foreground counts as an object if its median score is at least this; with
less it is the table's own unevenness. The plainest piece counts with any score."""

MAX_TABLE_DEVIATION = 8.0
"""Largest standard deviation of a table's color without depth, units of CIE L*a*b*; what varies
more is taken for no table."""

MAX_TILT = np.radians(10)
"""Largest angle between the table seen in depth and the plane z = 0 by X_WC, rad; beyond it, X_WC
is taken to be wrong."""

MAX_SHIFT = 0.05
"""Largest distance between the table seen in depth and the plane z = 0 by X_WC, m; beyond it, X_WC
is taken to be wrong."""

RIM_WIDTH = 31
"""Side of the square window about a point of the outline in which the object's height there is
looked for, pixels."""

RIM_PERCENTILE = 60
"""Percentile of the heights in that window that is taken for the object's height near its rim;
depth images blur the edge downward."""

TOP_PERCENTILE = 90
"""Percentile of an object's smoothed heights that is taken for its height."""

TOP_WINDOW = 5
"""Side of the window whose median smooths the heights of an object, pixels; half of it is left out
along the object's rim."""

LEVELS = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Levels to which the picture's outline is cast, as parts of the object's height."""

OUTLINE_SMOOTHING = 0.5
"""Standard deviation of the blur of the coverage before the outline is traced, pixels."""

SIMPLIFICATION = 2e-4
"""Largest distance by which the outline may be simplified after the levels were intersected, m."""

MAX_PARTS = 3
"""Most parts of an object that are told apart by color."""

PART_ROUNDS = 30
"""Most rounds of the clustering of colors (k-means)."""

PART_EPSILON = 0.1
"""The clustering of colors ends when no center moves by more than this, units of CIE L*a*b*."""

PART_CONTRAST = 25.0
"""Clusters whose centers are nearer than this are one part, units of CIE L*a*b*."""

MIN_PART = 0.08
"""A part that has less than this share of the object's pixels is joined to the others."""

PART_SMOOTHING = 9
"""Side of the window of the median that colors and labels of parts go through, pixels."""

GREEN = (0, 255, 0)
"""Color of an object's outline, of its top and of its body frame's y axis in pictures."""

RED = (255, 0, 0)
"""Color of what was refused, and of the body frame's x axis in pictures."""

BLUE = (0, 80, 255)
"""Color of an object's bottom in pictures."""

LINE = 1
"""Width of the lines drawn in pictures, pixels."""

FRACTION_BITS = 4
"""Bits after the binary point in the coordinates that OpenCV's drawing takes."""

CLOSE_UP_ROOM = 0.2
"""Room about an object in its close-up, as a part of the object's longer side."""

AXIS = 0.03
"""Length of the body frame's axes in pictures, m."""

PAINTED = -1.0
"""Depth where the table was painted over what hides it, m: neither measured nor missing."""

TABLE_SHARE = 75
"""Percentage of the pixels seen, those nearest to the median color, that is taken for table when
something is painted over."""


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
        contradiction: share of the object about which color and depth contradict each other, see
            `calc_contradiction`.
        doubtful: whether parts of the object hardly stand out from the table, so that its outline
            may be wrong; see `joint_foreground`.
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
        obj = GridObject.from_outline(self.outline_B, parts=parts, max_cells=max_cells, name=name)
        return GridObject(name, *obj.grid, obj.prior, self.height or None)

    def _to_body(self, shape: Polygon) -> Polygon:
        """Moves a shape from W to the body frame, m."""
        return shapely.transform(shape, lambda points: transform_back(self.X_WB, points))


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
        SeveralObjectsError: there are two or more.
        ObjectAtBorderError: the picture's border cuts it.
        PerceptionError: the height is negative, or the object reaches up to the camera. Each of the
            last five has a picture of what was seen.
    """
    options = options or DetectorOptions()
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

    # The object's pixels, with the boundary drawn anew by color.
    painted = np.zeros(color.shape[:2], dtype=bool) if depth is None else depth == PAINTED
    mask, coverage, doubtful = _find_pixels(found, color, plane, painted, camera, options)
    if not mask.any():
        raise NoObjectError("no object is in view; expected one on the table", color)

    # Its height: the one that is known goes before what depth says.
    heights = None
    height = options.height or 0.0
    if plane is not None and options.height is None:
        heights = plane.heights
        height = _find_height(heights, mask)

    # Its outline on the table (section 2), and what follows from it.
    contour = calc_contour(coverage.astype(np.float64), OUTLINE_SMOOTHING)
    outline = _to_world(contour, camera, mask, heights, height)
    X_WB = np.array([*outline.centroid.coords[0], 0.0])
    parts: dict[int, Polygon | MultiPolygon] = {}
    if options.parts:
        parts = _find_parts(color, mask, camera, outline, height)
    contradiction = 0.0
    if options.cues == "both":
        contradiction = calc_contradiction(mask, found, plane)
    picture = draw_contours(color, mask, GREEN)
    return DetectedObject(
        outline=outline,
        mask=mask,
        height=height,
        X_WB=X_WB,
        pixel=camera.project([*X_WB[:2], 0.0]),
        parts=parts,
        camera=camera,
        picture=draw_outline(picture, camera, outline, 0.0, X_WB),
        contradiction=contradiction,
        doubtful=doubtful,
    )


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
        New images; depth is PAINTED there. The very ones that were given where nothing is unseen.

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
    table = seen[off <= np.percentile(off, TABLE_SHARE)]
    covered = color.copy()
    covered[unseen] = np.random.default_rng(seed).choice(table, int(unseen.sum()))
    if depth is None:
        return covered, None
    return covered, np.where(unseen, np.float32(PAINTED), depth)


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


def draw_outline(
    color: Color, camera: Camera, outline: Polygon, height: float, X_WB: ArrayLike
) -> Color:
    """Draws an outline and its body frame into a photograph.

    Args:
        color: (height, width, 3) uint8, undistorted.
        camera: camera that took it, with X_WC.
        outline: outline on the table, W, m.
        height: height of the object, m; 0 draws its bottom alone.
        X_WB: (3,) pose (x, y, theta) of the body frame, W, m and rad.

    Returns:
        A new picture.
    """
    picture = color.copy()
    ideal = camera.undistorted

    def draw(points: Array, closed: bool, tint: tuple[int, int, int]) -> None:
        places = np.round(ideal.project(points) * 2**FRACTION_BITS).astype(np.int32)
        cv2.polylines(picture, [places], closed, tint, LINE, cv2.LINE_AA, FRACTION_BITS)

    # The bottom, and the top where that is another.
    levels = [(0.0, BLUE)]
    if height > 0:
        levels.append((height, GREEN))
    for z, tint in levels:
        for ring in (outline.exterior, *outline.interiors):
            xy = np.array(ring.coords)
            points = np.column_stack([xy, np.full(len(xy), z)])
            draw(points, True, tint)

    # The body frame's axes lie on the top, where they hide no part of the outline.
    x, y, theta = np.asarray(X_WB, dtype=np.float64)
    for angle, tint in ((theta, RED), (theta + np.pi / 2, GREEN)):
        tip = [x + AXIS * np.cos(angle), y + AXIS * np.sin(angle), height]
        draw(np.array([[x, y, height], tip]), False, tint)
    return picture


def _find_pixels(
    found: Foreground,
    color: Color,
    plane: TablePlane | None,
    painted: Mask,
    camera: Camera,
    options: DetectorOptions,
) -> tuple[Mask, NDArray[np.float32], bool]:
    """Finds the pixels that show the object, by itself or where a hint says.

    Returns:
        (height, width) bool, the mask; how much of each pixel is object, 0 to 1; and whether that
        is doubtful.
    """
    hint = options.hint
    if hint is None:
        if plane is None or options.cues != "both":
            return (*refine_boundary(_choose_object(found, color, camera, options), found), False)
        return _find_whole(found, color, plane, painted, camera, options)
    try:
        drawn = hint.place(camera)
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
    found: Foreground,
    color: Color,
    plane: TablePlane,
    painted: Mask,
    camera: Camera,
    options: DetectorOptions,
) -> tuple[Mask, NDArray[np.float32], bool]:
    """Finds the pixels that show the object, also where parts of it hardly stand out.

    Returns:
        As `_find_pixels`.

    Raises:
        PerceptionError: there is no object, or there are several, or one is cut by the border.
    """
    refused: SeveralObjectsError | None = None
    try:
        mask, coverage = refine_boundary(_choose_object(found, color, camera, options), found)
    except SeveralObjectsError as error:
        refused = error
    joint = find_jointly(color, plane, found, painted)
    if refused is None and (joint is None or not joint.disputes(mask)):
        return mask, coverage, False

    # Several pieces are one object only if all that stands out is in what joins them.
    if joint is None or (refused is not None and joint.disputes(joint.mask)):
        assert refused is not None
        raise refused
    _check_in_view(joint.mask, color)
    return joint.mask, joint.mask.astype(np.float32), True


def _check_in_view(mask: Mask, color: Color) -> None:
    """Raises ObjectAtBorderError where the picture's border cuts an object."""
    inner = mask[BORDER:-BORDER, BORDER:-BORDER]
    if inner.sum() < mask.sum():
        problem = "the object touches the picture's border; expected all of it in view"
        raise ObjectAtBorderError(problem, draw_contours(color, mask))


def _choose_object(
    found: Foreground, color: Color, camera: Camera, options: DetectorOptions
) -> Mask:
    """Chooses the one piece of the foreground that is large enough to be an object."""
    score = found.score
    count, labels, stats, middles = cv2.connectedComponentsWithStats(
        found.mask.astype(np.uint8), connectivity=8
    )

    # The area of each piece on the table: its pixels, times what a pixel at its middle takes there.
    # That is the parallelogram of the pixel's upper left, upper right and lower left corners.
    low = -PIXEL_MIDDLE
    high = PIXEL_MIDDLE
    corners = np.array([[low, low], [high, low], [low, high]])
    places = camera.undistorted.cast(middles[:, None] + corners)
    across, down = np.moveaxis(places[:, 1:] - places[:, :1], 1, 0)
    pixel_area = np.abs(across[:, 0] * down[:, 1] - across[:, 1] * down[:, 0])
    area = stats[:, cv2.CC_STAT_AREA] * pixel_area
    large = [i for i in range(1, count) if area[i] >= options.min_area]
    if not large:
        raise NoObjectError("no object is in view; expected one on the table", color)

    # The plainest piece is the object. Others count only if they stand out from the table: faint
    # ones are the table's own unevenness.
    plainest = max(large, key=lambda i: score[labels == i].sum())
    large = [i for i in large if i == plainest or np.median(score[labels == i]) >= CERTAIN]
    chosen = np.isin(labels, large)
    if len(large) > 1:
        problem = f"{len(large)} objects are in view; expected one"
        raise SeveralObjectsError(problem, draw_contours(color, chosen))

    _check_in_view(chosen, color)
    return keep_largest(chosen)


def draw_contours(color: Color, mask: Mask, tint: tuple[int, int, int] = RED) -> Color:
    """Draws the contours of a mask into a photograph; returns a new one."""
    picture = color.copy()
    contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(picture, contours, -1, tint, LINE)
    return picture


def _find_height(heights: Heights, mask: Mask) -> float:
    """Finds the height of an object's top, m; 0 where depth was not measured on it."""
    # Depth images blur an object's rim, and single pixels are noisy: the rim is left out, and a
    # percentile taken for the top.
    brush = np.ones((TOP_WINDOW, TOP_WINDOW), np.uint8)
    inner = cv2.erode(mask.astype(np.uint8), brush) > 0
    smooth = cv2.medianBlur(np.nan_to_num(heights).astype(np.float32), TOP_WINDOW)
    measured = smooth[inner & np.isfinite(heights)]
    if not len(measured):
        return 0.0
    return max(0.0, float(np.percentile(measured, TOP_PERCENTILE)))


def _to_world(
    contour: Polygon, camera: Camera, mask: Mask, heights: Heights | None, height: float
) -> Polygon:
    """Finds an object's outline on the table from its outline in the picture.

    Args:
        contour: outline in the picture, pixels from the picture's upper left corner.
        camera: camera with X_WC.
        mask: (height, width) bool, pixels that show the object.
        heights: (height, width) heights above the table, m; None for the same height everywhere.
        height: height of the object's top, m.

    Returns:
        The outline, W, m, counterclockwise.

    Raises:
        PerceptionError: nothing is common to all levels.
    """

    def cast(points: Array, level: float) -> Array:
        """Makes S_z: casts the contour to a part of the height at each of its points."""
        pixels = points - PIXEL_MIDDLE
        z: float | Array = height
        if heights is not None:
            z = _find_rim_heights(pixels, mask, heights, height)
        return camera.undistorted.cast(pixels, level * np.asarray(z))

    layers = [
        shapely.transform(contour, lambda points, level=level: cast(points, level))
        for level in LEVELS
    ]

    # P: what all levels have in common. A flat object is the same on all.
    valid = shapely.make_valid(layers)
    outline = valid[0]
    if height > 0:
        outline = shapely.intersection_all(valid)
    pieces = [piece for piece in shapely.get_parts(outline) if isinstance(piece, Polygon)]
    if not pieces:
        raise PerceptionError(
            "the object is higher than it is wide, seen from the side; expected an overhead camera"
        )

    # Levels cross each other in many short sides, which say nothing of the object.
    largest = max(pieces, key=lambda piece: piece.area)
    if height > 0:
        largest = largest.simplify(SIMPLIFICATION)
    return orient(largest)


def _find_rim_heights(pixels: Array, mask: Mask, heights: Heights, height: float) -> Array:
    """Finds the object's height near each of (k, 2) pixels of its outline, (k,), m.

    An object that is not of one height is so taken for a prism at each side.
    """
    half = RIM_WIDTH // 2
    inside = np.where(mask, heights, np.nan)
    found = np.full(len(pixels), height)
    for i, (x, y) in enumerate(np.round(pixels).astype(int)):
        rows = slice(max(y - half, 0), y + half + 1)
        columns = slice(max(x - half, 0), x + half + 1)
        window = inside[rows, columns]
        window = window[np.isfinite(window)]
        if len(window):
            found[i] = np.clip(np.percentile(window, RIM_PERCENTILE), 0.0, height)
    return found


def _find_parts(
    color: Color, mask: Mask, camera: Camera, outline: Polygon, height: float
) -> dict[int, Polygon | MultiPolygon]:
    """Finds parts by color, the largest first, W, m; one part where the object is of one color."""
    # Clusters of color, after a median that takes prints and grain away. OpenCV's generator is
    # seeded, so that the same picture gives the same parts.
    smooth = np.asarray(cv2.medianBlur(color, PART_SMOOTHING), dtype=np.uint8)
    lab = to_lab(smooth)[mask]
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, PART_ROUNDS, PART_EPSILON)
    cv2.setRNGSeed(0)
    _, labels, centers = cv2.kmeans(
        data=lab,
        K=min(MAX_PARTS, len(lab)),
        bestLabels=np.zeros((len(lab), 1), np.int32),
        criteria=criteria,
        attempts=1,
        flags=cv2.KMEANS_PP_CENTERS,
    )
    counts = np.bincount(labels.ravel(), minlength=len(centers))

    # Clusters that are large, and of another color than the larger ones, are parts.
    kept: list[int] = []
    for k in np.argsort(-counts):
        apart = all(np.linalg.norm(centers[k] - centers[other]) >= PART_CONTRAST for other in kept)
        if not kept or (apart and counts[k] >= MIN_PART * len(lab)):
            kept.append(int(k))

    # Every pixel goes to the nearest part in color, and single ones to what is about them.
    distances = np.linalg.norm(lab[:, None] - centers[kept], axis=-1)
    nearest = np.argmin(distances, axis=1)
    image = np.zeros(mask.shape, np.uint8)
    image[mask] = nearest + 1
    image = np.asarray(cv2.medianBlur(image, PART_SMOOTHING), dtype=np.uint8)

    # Parts are cast to the top, for that is what shows them, and cut to the object's outline.
    parts: dict[int, Polygon | MultiPolygon] = {}
    for label in range(1, len(kept) + 1):
        part = keep_largest(image == label)
        if part.sum() < MIN_PART * len(lab):
            continue
        contour = calc_contour(part.astype(np.float64))
        shape = shapely.transform(
            contour, lambda points: camera.undistorted.cast(points - PIXEL_MIDDLE, height)
        )
        pieces = shapely.get_parts(shapely.intersection(shapely.make_valid(shape), outline))
        pieces = [piece for piece in pieces if isinstance(piece, Polygon)]
        if pieces:
            whole = MultiPolygon(pieces) if len(pieces) > 1 else pieces[0]
            parts[len(parts) + 1] = whole
    return parts
