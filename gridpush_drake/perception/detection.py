"""One object on a table, found in one photograph: its mask, outline, height and parts.

What is seen of a prism of height h is its outline on every level from the table to h. A pixel of
the picture's outline shows a point of the top where the prism's side there faces away from the
camera, and one of the bottom where it faces it. So the outline is what the pixels' rays meet on all
levels: the intersection of the picture's outline cast to some levels from the table to the height.
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
from gridpush_drake.perception.table_plane import TablePlane, fit_table

Mask = NDArray[np.bool_]

PIXEL_MIDDLE = 0.5
"""Of a pixel, from its corner."""

BORDER = 2
"""Pixels at the picture's border which no object may touch."""

CERTAIN = 3.0
"""Median score from which on a piece of the foreground is an object for certain, and not the
table's own unevenness; the plainest piece needs none."""

MAX_TABLE_DEVIATION = 8.0
"""Of a table's color, units of CIE L*a*b*; without depth, more is taken for no table."""

MAX_TILT, MAX_SHIFT = np.radians(10), 0.05
"""Between the table in depth and X_WC's z = 0, rad and m."""

RIM_WIDTH, RIM_PERCENTILE = 31, 60
"""Of the window in which an outline's point finds the height of the object there, pixels; and of
the heights in it."""

TOP_PERCENTILE, TOP_WINDOW = 90, 5
"""Of the heights of an object, smoothed in such a window, which is its height."""

LEVELS = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Of the height, to which the picture's outline is cast."""

OUTLINE_SMOOTHING = 0.5
"""Of the coverage, before the outline is traced, standard deviation in pixels."""

SIMPLIFICATION = 2e-4
"""m, by which the outline may differ after the levels were intersected."""

MAX_PARTS, PART_ROUNDS, PART_EPSILON = 3, 30, 0.1
"""Most parts by color; of the clustering."""

PART_CONTRAST, MIN_PART = 25.0, 0.08
"""Colors nearer than this in CIE L*a*b* are of one part; a part of less than this share of the
object is none."""

PART_SMOOTHING = 9
"""Width of the median that a part's colors go through, pixels."""

GREEN, RED, BLUE, LINE = (0, 255, 0), (255, 0, 0), (0, 80, 255), 1
"""Of what is drawn in pictures; the line's width, pixels."""

CLOSE_UP_ROOM = 0.2
"""About an object in its close-up, share of its longer side."""

AXIS = 0.03
"""Length of the body frame's axes in pictures, m."""


TABLE_SHARE = 75
"""Percent of what is seen, nearest to its median in color, that is taken for table."""


@dataclass(frozen=True)
class DetectorOptions:
    """What counts as an object.

    Attributes:
        min_area: of an object, m^2.
        height: of the object, m, where it is known; it goes before what depth says.
        parts: whether the object's parts are told apart by color.
        cues: what is looked at.
    """

    min_area: float = 2e-4
    height: float | None = None
    parts: bool = False
    cues: Cues = "both"


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
        camera: with X_WC: the one given, or, where it was not known, the one that depth gives: W's
            origin is where the optical axis meets the table, x to the right in the image, z up.
        picture: (height, width, 3) uint8, the undistorted photograph with the outline drawn.
        contradiction: share of the object about which color and depth contradict each other, see
            `calc_contradiction`.
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

    @property
    def close_up(self) -> Color:
        """The part of the picture that shows the object, with some room about it."""
        x, y, width, height = cv2.boundingRect(self.mask.astype(np.uint8))
        room = round(CLOSE_UP_ROOM * max(width, height))
        return self.picture[
            max(y - room, 0) : y + height + room, max(x - room, 0) : x + width + room
        ]

    @cached_property
    def outline_B(self) -> Polygon:
        """The outline in the body frame, m."""
        return self._to_body(self.outline)

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
        max_cells = (
            DEFAULT_MAX_CELLS
            if cell_size is None
            else max(1, round(self.outline.area / cell_size**2))
        )
        if max_cells > MAX_CELLS:
            raise ObjectError(
                f"{name}: cells of {cell_size:g} m are {max_cells}; expected at most {MAX_CELLS}, so of at least "
                f"{(self.outline.area / MAX_CELLS) ** 0.5:.2g} m"
            )
        parts = {label: self._to_body(part) for label, part in self.parts.items()}
        obj = GridObject.from_outline(self.outline_B, parts=parts, max_cells=max_cells, name=name)
        return GridObject(name, *obj.grid, obj.prior, self.height or None)

    def _to_body(self, shape: Polygon) -> Polygon:
        return shapely.transform(shape, lambda points: transform_back(self.X_WB, points))


def detect_object(
    color: Color, depth: Depth | None, camera: Camera, options: DetectorOptions | None = None
) -> DetectedObject:
    """Finds the one object that lies on the table.

    Args:
        color: (height, width, 3) uint8, red, green, blue, as it was taken (distorted).
        depth: (height, width), m, registered to `color`, 0 where it was not measured; None without
            a depth camera.
        camera: that took it; X_WC, with the table's top at z = 0, may be left out where there is
            depth.
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
            f"height is {options.height!r}; expected 0 to {camera.center[2]:.3g} m, where the camera is",
            color,
        )
    found = find_foreground(color, plane, options.cues)
    if plane is None and found.deviation.max() > MAX_TABLE_DEVIATION:
        raise NoTableError("no even color takes the picture's rim; expected a table in view", color)
    mask, coverage = refine_boundary(_choose_object(found, color, camera, options), found)
    if not mask.any():
        raise NoObjectError("no object is in view; expected one on the table", color)
    heights = None if plane is None or options.height is not None else plane.heights
    height = _find_height(heights, mask) if heights is not None else options.height or 0.0
    outline = _to_world(
        calc_contour(coverage.astype(np.float64), OUTLINE_SMOOTHING), camera, mask, heights, height
    )
    X_WB = np.array([*outline.centroid.coords[0], 0.0])
    parts = _find_parts(color, mask, camera, outline, height) if options.parts else {}
    return DetectedObject(
        outline,
        mask,
        height,
        X_WB,
        camera.project([*X_WB[:2], 0.0]),
        parts,
        camera,
        draw_outline(draw_contours(color, mask, GREEN), camera, outline, 0.0, X_WB),
        calc_contradiction(mask, found, plane) if options.cues == "both" else 0.0,
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
        if not np.isfinite(camera.cast(camera.K[:2, 2])).all():
            raise NoTableError(
                "the camera looks past the table; expected X_WC in its file with the table at z = 0 and the camera "
                "above, its z axis toward the table",
                color,
            )
        return color, None, None, camera
    camera.check_size(depth, "the depth image")
    depth = camera.undistort(depth)
    plane = fit_table(depth, camera.undistorted, color)
    if camera.X_WC is None:
        return color, depth, plane, camera.with_pose(plane.make_pose(camera))
    tilt = np.arccos(np.clip(plane.normal @ camera.X_WC[2, :3], -1, 1))
    shift = plane.offset - camera.X_WC[2, 3]
    if tilt > MAX_TILT or abs(shift) > MAX_SHIFT:
        raise NoTableError(
            f"the table in depth is tilted by {np.degrees(tilt):.0f} degrees and shifted by {shift:.3f} m from z = 0 of"
            " X_WC; expected them to agree",
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
        seed: of the colors, which are drawn from the table's, the most common ones.

    Returns:
        New images; depth is 0 there. The very ones that were given where nothing is unseen.

    Raises:
        NoTableError: nothing is left to be looked at.
    """
    if not unseen.any():
        return color, depth
    seen = color[~unseen]
    if not len(seen):
        raise NoTableError("the robot hides all of the picture; expected a table in view", color)
    off = np.abs(seen - np.median(seen, axis=0)).max(axis=1)
    table = seen[off <= np.percentile(off, TABLE_SHARE)]
    covered = color.copy()
    covered[unseen] = np.random.default_rng(seed).choice(table, int(unseen.sum()))
    return covered, None if depth is None else np.where(unseen, np.float32(0), depth)


def find_off_table(camera: Camera, table_top: BaseGeometry) -> Mask:
    """Finds the pixels (height, width) whose rays do not meet the table's top, a polygon in W, m."""
    pixels = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=-1)
    xy = camera.cast(pixels)
    return ~np.asarray(shapely.contains_xy(table_top, xy[..., 0], xy[..., 1]))


def draw_outline(
    color: Color, camera: Camera, outline: Polygon, height: float, X_WB: ArrayLike
) -> Color:
    """Draws an outline (W, m) and the body frame at X_WB (3,) into an undistorted photograph; returns a new one."""
    picture, ideal = color.copy(), camera.undistorted
    for z, tint in ((0.0, BLUE), (height, GREEN))[: 1 + (height > 0)]:
        for ring in (outline.exterior, *outline.interiors):
            points = np.column_stack([np.array(ring.coords), np.full(len(ring.coords), z)])
            cv2.polylines(
                picture, [_to_places(ideal.project(points))], True, tint, LINE, cv2.LINE_AA, SHIFT
            )
    x, y, theta = np.asarray(X_WB, dtype=np.float64)
    for angle, tint in ((theta, RED), (theta + np.pi / 2, GREEN)):
        ends = np.array(
            [[x, y, height], [x + AXIS * np.cos(angle), y + AXIS * np.sin(angle), height]]
        )
        cv2.polylines(
            picture, [_to_places(ideal.project(ends))], False, tint, LINE, cv2.LINE_AA, SHIFT
        )
    return picture


SHIFT = 4
"""Bits of a pixel's fraction in OpenCV's drawing."""


def _to_places(pixels: Array) -> NDArray[np.int32]:
    return np.round(pixels * 2**SHIFT).astype(np.int32)


def _choose_object(
    found: Foreground, color: Color, camera: Camera, options: DetectorOptions
) -> Mask:
    """The one piece of the foreground that is large enough to be an object."""
    score = found.score
    count, labels, stats, middles = cv2.connectedComponentsWithStats(
        found.mask.astype(np.uint8), connectivity=8
    )
    corners = np.array(
        [
            [-PIXEL_MIDDLE, -PIXEL_MIDDLE],
            [PIXEL_MIDDLE, -PIXEL_MIDDLE],
            [-PIXEL_MIDDLE, PIXEL_MIDDLE],
        ]
    )
    places = camera.undistorted.cast(middles[:, None] + corners)
    across, down = np.moveaxis(places[:, 1:] - places[:, :1], 1, 0)
    area = stats[:, cv2.CC_STAT_AREA] * np.abs(
        across[:, 0] * down[:, 1] - across[:, 1] * down[:, 0]
    )
    large = [i for i in range(1, count) if area[i] >= options.min_area]
    if not large:
        raise NoObjectError("no object is in view; expected one on the table", color)
    plainest = max(large, key=lambda i: score[labels == i].sum())
    large = [i for i in large if i == plainest or np.median(score[labels == i]) >= CERTAIN]
    chosen = np.isin(labels, large)
    if len(large) > 1:
        problem = f"{len(large)} objects are in view; expected one"
        raise SeveralObjectsError(problem, draw_contours(color, chosen))
    inner = chosen[BORDER:-BORDER, BORDER:-BORDER]
    if inner.sum() < chosen.sum():
        problem = "the object touches the picture's border; expected all of it in view"
        raise ObjectAtBorderError(problem, draw_contours(color, chosen))
    return keep_largest(chosen)


def draw_contours(color: Color, mask: Mask, tint: tuple[int, int, int] = RED) -> Color:
    """Draws the contours of a mask into a photograph; returns a new one."""
    picture = color.copy()
    contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(picture, contours, -1, tint, LINE)
    return picture


def _find_height(heights: Array, mask: Mask) -> float:
    inner = cv2.erode(mask.astype(np.uint8), np.ones((TOP_WINDOW, TOP_WINDOW), np.uint8)) > 0
    smooth = cv2.medianBlur(np.nan_to_num(heights).astype(np.float32), TOP_WINDOW)
    measured = smooth[inner & np.isfinite(heights)]
    return max(0.0, float(np.percentile(measured, TOP_PERCENTILE))) if len(measured) else 0.0


def _to_world(
    contour: Polygon, camera: Camera, mask: Mask, heights: Array | None, height: float
) -> Polygon:
    """The outline on the table of one in the picture, whose pixels are counted from the upper left corner."""

    def cast(points: Array, level: float) -> Array:
        pixels = points - PIXEL_MIDDLE
        z = height if heights is None else _find_rim_heights(pixels, mask, heights, height)
        return camera.undistorted.cast(pixels, level * np.asarray(z))

    layers = [
        shapely.transform(contour, lambda points, level=level: cast(points, level))
        for level in LEVELS
    ]
    outline = (
        shapely.intersection_all(shapely.make_valid(layers))
        if height > 0
        else shapely.make_valid(layers[0])
    )
    pieces = [piece for piece in shapely.get_parts(outline) if isinstance(piece, Polygon)]
    if not pieces:
        raise PerceptionError(
            "the object is higher than it is wide, seen from the side; expected an overhead camera"
        )
    largest = max(pieces, key=lambda piece: piece.area)
    return orient(largest.simplify(SIMPLIFICATION)) if height > 0 else orient(largest)


def _find_rim_heights(pixels: Array, mask: Mask, heights: Array, height: float) -> Array:
    """The object's height near each of (k, 2) pixels of its outline, m."""
    half = RIM_WIDTH // 2
    inside = np.where(mask, heights, np.nan)
    found = np.full(len(pixels), height)
    for i, (x, y) in enumerate(np.round(pixels).astype(int)):
        window = inside[max(y - half, 0) : y + half + 1, max(x - half, 0) : x + half + 1]
        window = window[np.isfinite(window)]
        if len(window):
            found[i] = np.clip(np.percentile(window, RIM_PERCENTILE), 0.0, height)
    return found


def _find_parts(
    color: Color, mask: Mask, camera: Camera, outline: Polygon, height: float
) -> dict[int, Polygon | MultiPolygon]:
    """Parts by color, the largest first, W; one part where the object is of one color."""
    lab = to_lab(np.asarray(cv2.medianBlur(color, PART_SMOOTHING), dtype=np.uint8))[mask]
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, PART_ROUNDS, PART_EPSILON)
    cv2.setRNGSeed(0)
    none = np.zeros((len(lab), 1), np.int32)
    _, labels, centers = cv2.kmeans(
        lab, min(MAX_PARTS, len(lab)), none, criteria, 1, cv2.KMEANS_PP_CENTERS
    )
    labels = labels.ravel()
    counts = np.bincount(labels, minlength=len(centers))
    kept: list[int] = []
    for k in np.argsort(-counts):
        apart = all(np.linalg.norm(centers[k] - centers[other]) >= PART_CONTRAST for other in kept)
        if not kept or (apart and counts[k] >= MIN_PART * len(lab)):
            kept.append(int(k))
    nearest = np.argmin(np.linalg.norm(lab[:, None] - centers[kept], axis=-1), axis=1)
    image = np.zeros(mask.shape, np.uint8)
    image[mask] = nearest + 1
    image = np.asarray(cv2.medianBlur(image, PART_SMOOTHING), dtype=np.uint8)
    parts: dict[int, Polygon | MultiPolygon] = {}
    for label in range(1, len(kept) + 1):
        part = keep_largest(image == label)
        if part.sum() < MIN_PART * len(lab):
            continue
        shape = shapely.transform(
            calc_contour(part.astype(np.float64)),
            lambda p: camera.undistorted.cast(p - PIXEL_MIDDLE, height),
        )
        pieces = shapely.get_parts(shapely.intersection(shapely.make_valid(shape), outline))
        pieces = [piece for piece in pieces if isinstance(piece, Polygon)]
        if pieces:
            parts[len(parts) + 1] = MultiPolygon(pieces) if len(pieces) > 1 else pieces[0]
    return parts
