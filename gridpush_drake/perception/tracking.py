"""The pose of a known outline, from frame to frame.

What is seen of a prism on the table is its silhouette: the union of its outline and of all that its
sides and its top hide of the table. Along its boundary, at points p_i with outward normals n_i in
the picture, the edge between object and table is looked for, d_i pixels off, and the pose q moves
until these vanish on the whole:

    min_q  sum_i w_i (d_i - n_i' J_i dq)^2 / sigma^2 + |dq|^2_P,       J_i = d(pixel of p_i)/dq

with Tukey's weights w_i, and a prior P as wide as the object can move between two frames. Points
that something covers have no part. The covariance is the inverse of the information left, A = sum
w_i J_i' n_i n_i' J_i / sigma^2 + P, and what errors that edges share do to the pose besides:

    cov = A^-1 + sum_k (A^-1 sum_i w_i J_i' n_i e_ki / sigma^2) (...)'

What no edge tells, such as the angle of a disc, keeps the prior's width: in sigma^2 is what
neighboring edges share, and J is their mean along that length, as nothing finer is resolved. Shared
errors are of two kinds. Where a side is seen below the top, the edge is off by a share of the
side's width in the picture, on all such edges alike. And light from one side draws all edges its
way. Either moves the pose, and hardly turns it.

The object's outline and height must be known: `detection` finds them in one photograph. The theory
is in docs/theory/perception.md, section 3.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import cv2
import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import eigh
from scipy.ndimage import uniform_filter1d
from shapely import Polygon
from shapely.geometry.base import BaseGeometry
from shapely.geometry.polygon import orient

from gridpush_drake.errors import PerceptionError
from gridpush_drake.geometry.se2 import Array, IntArray, transform, wrap_angle
from gridpush_drake.objects.cells import make_polygon
from gridpush_drake.perception.camera import Camera
from gridpush_drake.perception.detection import (
    cover_pixels,
    draw_contours,
    find_off_table,
    look_at_table,
)
from gridpush_drake.perception.foreground import (
    Foreground,
    dilate,
    find_foreground,
    find_high,
    refine_boundary,
    remove_thin,
    score_pixels,
    to_lab,
)
from gridpush_drake.perception.frames import Color, Frame
from gridpush_drake.perception.table_plane import TO_DEVIATION, TablePlane, make_rays

Mask = NDArray[np.bool_]

MAX_POINTS = 360
"""Most points of the boundary at which an edge is looked for; a longer outline has them further
apart."""

MIN_SPACING = 1.5
"""Least distance between two points of the boundary, pixels: closer ones would see the same
edge."""


class Search(NamedTuple):
    """One stage of a registration.

    Attributes:
        reach: how far from the expected boundary an edge is looked for, inward and outward, pixels.
        step: distance between two samples across the boundary, pixels.
        rounds: largest number of least-squares steps.
    """

    reach: float
    step: float
    rounds: int


SEARCHES = (
    Search(reach=16.0, step=1.0, rounds=10),
    Search(reach=6.0, step=0.5, rounds=10),
    Search(reach=3.0, step=0.25, rounds=12),
)
"""Stages of a registration, from coarse to fine: a wide reach finds an object that moved far, and a
narrow one leaves out the edges of other things."""

CONVERGED = 1e-3
"""A stage ends when a step moves no point of the outline by more than this, pixels."""

TUKEY = 3.0
"""An edge that is this many standard deviations or more from the outline has no weight (the tuning
constant of Tukey's weights)."""

MIN_SPREAD = 0.3
"""Least standard deviation of the edges' distances that Tukey's weights assume, pixels; without it
a few edges that agree by chance would throw all others out."""

SHARED_LENGTH = 12.0
"""Edges that are less than this far apart along the boundary have nearly the same error, pixels;
such a stretch counts as one measurement."""

SIDE_ERROR = 0.1
"""Standard deviation of the error that all edges below visible sides share, as a part of the sides'
width in the picture: a side has another brightness than the top."""

LIGHT_ERROR = 0.03
"""Standard deviation of the error that all edges share because light from one side moves them its
way, pixels."""

DIFFERENCE = 1e-5
"""Step of the numerical derivatives of pixels by places on the table, m."""

HALF = 0.5
"""Coverage of a pixel at the object's edge; a pixel with more is object."""

CLEARANCE = 0.015
"""A pixel that is this much higher than the object's top shows something else, such as the arm,
m."""

FLOOR_DEPTH = 0.05
"""A pixel that is this much lower than the table's top shows the floor and never the object,
whatever its color, m."""

FLOOR_MARGIN = 5
"""Beyond the table's edge, a pixel counts as floor if it is more than half of this from every pixel
where the depth camera sees something above the floor, pixels."""

COVER_MARGIN = 9
"""Width of the brush that widens what covers the object, pixels; half of it is added on each side,
because the cover's own edge is uncertain too."""

WINDOW_MARGIN = 30
"""Room around the part of the picture that can hold the object in the next frame, pixels."""

MAX_PIECES = 4
"""A search everywhere tries this many pieces of the foreground, the largest first."""

ANGLES_TRIED = 48
"""A search everywhere tries this many angles with each piece, evenly over a full turn."""

MAX_CANDIDATES = 5
"""A search everywhere registers this many of the poses it tried, those with the largest overlap."""

COARSENESS = 4
"""Side of the pixels on which a search everywhere compares shapes, in pixels of the picture."""

PAINT_SEED = 0
"""Seed of the table's colors that are painted over what covers it in the first frame."""

MIN_OVERLAP = 0.35
"""A pose whose silhouette has a smaller intersection over union with the foreground is not
registered in a search everywhere."""

MIN_INSIDE = 0.6
"""A fit is refused if less than this share of the points just inside its visible boundary shows the
object."""

MAX_RMS = 2.0
"""A fit is refused if the edges found are further than this from its outline, root mean square,
pixels."""

FOUND = 0
"""State of a point of the boundary whose edge was found."""

MISSING = 1
"""State of a point of the boundary that is in plain view and has no edge."""

COVERED = 2
"""State of a point of the boundary that has no edge because something covers it or the picture ends
there; it says nothing of the pose."""

MAX_REMAP = 32_000
"""Most places that are looked up in one call of OpenCV's `remap`, which takes 16-bit sizes."""


@dataclass(frozen=True)
class TrackerOptions:
    """How the pose is found.

    Attributes:
        max_step: furthest that the object goes from one frame to the next, m.
        max_turn: furthest that the object turns from one frame to the next, rad.
        lost_share: the object is lost where less of its visible outline than this is found.
        found_share: a search everywhere accepts a pose only where at least this share of its
            visible outline is found, and where what is visible determines the pose; with less, the
            edges of the arm, of the table or of another thing would do.
        pixel_noise: least standard deviation of an edge's place, pixels.
        max_dilution: the object counts as not seen where what covers it makes its pose less sure by
            more than this: a ratio of standard deviations, in the worst direction.
        search_period: least time from one search everywhere to the next, s; it takes several times
            as long as a look where the object was. With 0 every frame in which the object is not
            there is searched.
    """

    max_step: float = 0.03
    max_turn: float = 0.3
    lost_share: float = 0.5
    found_share: float = 0.8
    pixel_noise: float = 0.1
    max_dilution: float = 4.0
    search_period: float = 0.0


@dataclass(frozen=True, eq=False)
class Appearance:
    """What the table looks like.

    Attributes:
        table: (height, width, 3) color of the table in each pixel, CIE L*a*b*.
        deviation: (3,) standard deviations of the table's color, CIE L*a*b*.
        plane: (3,) n/d, the normal of the table's plane in C over its distance, 1/m; None without
            depth.
        height_deviation: standard deviation of the heights measured on the table, m; 0 without
            depth.
    """

    table: NDArray[np.float32]
    deviation: Array
    plane: Array | None
    height_deviation: float


@dataclass(frozen=True, eq=False)
class TrackerState:
    """What the tracker remembers; nobody edits it.

    Attributes:
        pose: (3,) the last pose (x, y, theta) found, W, m and rad.
        lost: whether the object was not found in the last frame.
        t: time of the last frame, s.
        appearance: what the table looks like.
        searched: time of the frame that was last searched everywhere, s; None where none was.
    """

    pose: Array
    lost: bool
    t: float
    appearance: Appearance
    searched: float | None = None


@dataclass(frozen=True, eq=False)
class TrackedPose:
    """What one frame told.

    Attributes:
        pose: (3,) (x, y, theta) of the object, W, m and rad, theta without jumps; NaN where it was
            not seen.
        covariance: (3, 3) covariance of the pose, m^2, m rad and rad^2; NaN where it was not seen.
            It is large along what cannot be seen: the angle of a disc, what the arm covers.
        seen: whether the object was found.
        residual: root mean square distance of the edges found from the outline, pixels; NaN where
            it was not seen.
    """

    pose: Array
    covariance: Array
    seen: bool
    residual: float


class _Picture(NamedTuple):
    """A frame without distortion.

    Attributes:
        color: (height, width, 3) uint8.
        depth: (height, width), m; None without a depth camera.
        covered: (height, width) bool, pixels that are known to show something else.
    """

    color: Color
    depth: NDArray[np.float32] | None
    covered: Mask


class _View(NamedTuple):
    """What is object in a part of the picture.

    Attributes:
        coverage: (h, w) share of each pixel that is object.
        mask: (h, w) bool, pixels that show the object.
        covered: (h, w) bool, pixels that say nothing.
        corner: (2,) x and y of the part's upper left pixel in the whole picture.
    """

    coverage: NDArray[np.float32]
    mask: Mask
    covered: Mask
    corner: Array


class _Fit(NamedTuple):
    """A registration: the pose, its covariance, and how well it explains the picture.

    Attributes:
        pose: (3,) (x, y, theta) of the object, W, m and rad.
        covariance: (3, 3) covariance of the pose, m^2, m rad and rad^2.
        dilution: how much less sure the pose is than it would be with nothing covered, a ratio of
            standard deviations in the worst direction.
        share: share of the visible boundary whose edge was found.
        inside: share of the points just inside the visible boundary that show the object.
        rms: root mean square distance of the edges found from the outline, pixels.
    """

    pose: Array
    covariance: Array
    dilution: float
    share: float
    inside: float
    rms: float


class _LinearizedEdges(NamedTuple):
    """Edges at n points of the boundary, and how they move with the pose.

    Attributes:
        pixels: (n, 2) places of the points in the picture, pixels.
        J: (n, 3) rows n_i' J_i: derivatives of the edges' places along their normals by the pose,
            pixels/m and pixels/rad.
        normals: (n, 2) outward unit normals in the picture.
        sides: (n,) width of the object's side that is seen at each point, pixels; 0 where the top
            ends there.
        spacing: mean distance between neighboring points, pixels.
    """

    pixels: Array
    J: Array
    normals: Array
    sides: Array
    spacing: float


NOT_SEEN = TrackedPose(
    pose=np.full(3, np.nan),
    covariance=np.full((3, 3), np.nan),
    seen=False,
    residual=float("nan"),
)
"""What a frame tells that does not show the object."""


class PoseTracker:
    """Registers a known outline to what a camera sees.

    It holds no state: `start` and `track` take the state and return the next one.
    """

    def __init__(
        self,
        outline: Polygon | ArrayLike,
        height: float,
        camera: Camera,
        options: TrackerOptions | None = None,
        table_top: BaseGeometry | None = None,
    ) -> None:
        """Takes the object and the camera.

        Args:
            outline: outline of the object in B, a polygon or (k, 2) vertices, m.
            height: height of the object, m.
            camera: with X_WC; the table's top is at z = 0.
            options: see `TrackerOptions`.
            table_top: polygon, W, m, beyond which the floor is seen; None where that is not known.

        Raises:
            CameraError: X_WC is not known.
            ObjectError: the outline is none.
            PerceptionError: the height is negative, or the object reaches up to the camera.
        """
        self.outline = make_polygon(outline, "outline")
        self.height = float(height)
        self.camera = camera
        self.options = options or TrackerOptions()
        if not 0 <= self.height < camera.center[2]:
            raise PerceptionError(
                f"height is {height!r}; expected 0 to {camera.center[2]:g} m, where the camera is"
            )
        # All of the registration is done without lens distortion, so that straight sides are
        # straight in the picture.
        self._ideal = camera.undistorted
        self._rays = make_rays(self._ideal)

        # The pixels beside the table, in the picture without distortion and as it was taken: the
        # first frame is painted over before its distortion is taken out.
        self._off_table: Mask | None = None
        self._off_table_raw: Mask | None = None
        if table_top is not None:
            self._off_table = find_off_table(self._ideal, table_top)
            self._off_table_raw = find_off_table(camera, table_top)

        # P of the theory: the information of what can happen between two frames.
        step_information = self.options.max_step**-2
        turn_information = self.options.max_turn**-2
        self._prior = np.diag([step_information, step_information, turn_information])

    def start(
        self, frame: Frame, guess: ArrayLike | None = None, unseen: Mask | None = None
    ) -> TrackerState:
        """Learns what the table looks like, and finds the object.

        Args:
            frame: the first; the object lies in it, seen whole.
            guess: (3,) its pose (x, y, theta), W, about, m and rad; None to search everywhere.
            unseen: see `track`.

        Returns:
            The state before the first `track`, which may be of the same frame.

        Raises:
            PerceptionError: an image has another size, no table is in view, or no object that has
                the outline.
        """
        picture = self._undistort(frame, unseen)

        # The table is fitted to a picture in which nothing else than table and object is left: the
        # arm and the floor would draw the polynomial of its color and its plane away.
        table = self._paint_table(frame, unseen)
        painted, _, plane, _ = look_at_table(table.color, table.depth, self.camera)
        found = find_foreground(painted, plane)
        appearance = Appearance(
            table=to_lab(painted) - found.difference,
            deviation=found.deviation,
            plane=None if plane is None else -plane.normal / plane.offset,
            height_deviation=0.0 if plane is None else plane.deviation,
        )

        # A guess is worth a look before the slower search of the whole picture.
        before = None if guess is None else np.array(guess, dtype=np.float64)
        fit = None
        if before is not None:
            fit = self._find_near(appearance, picture, before)
        if fit is None:
            fit = self._find_anywhere(appearance, picture, before)
        if fit is None:
            raise PerceptionError(
                "no object of this outline is in view; expected the one that the object's file"
                " describes",
                draw_contours(picture.color, found.mask),
            )

        # A guess also says which turn the angle is counted in; without one it is the first.
        pose = fit.pose.copy()
        if before is None:
            pose[2] = wrap_angle(pose[2])
        return TrackerState(pose=pose, lost=False, t=frame.t, appearance=appearance)

    def track(
        self, state: TrackerState, frame: Frame, unseen: Mask | None = None
    ) -> tuple[TrackerState, TrackedPose]:
        """Finds the object in a frame.

        Args:
            state: after the frame before.
            frame: the next one.
            unseen: (height, width) bool, pixels of the frame which something covers, such as the
                arm; None where nothing is known to.

        Returns:
            The state after it, and the pose.

        Raises:
            ImageError: an image has another size than the camera.
        """
        picture = self._undistort(frame, unseen)

        # Where it was first; everywhere only if it is gone from there, and not in every frame.
        fit = self._find_near(state.appearance, picture, state.pose)
        searched = state.searched
        if fit is None and self._may_search(searched, frame.t):
            fit = self._find_anywhere(state.appearance, picture, state.pose)
            searched = frame.t
        state = replace(state, lost=fit is None, t=frame.t, searched=searched)
        if fit is None:
            return state, NOT_SEEN

        # The angle goes on from the last one, so that a full turn is no jump.
        pose = fit.pose.copy()
        before = state.pose[2]
        pose[2] = before + wrap_angle(pose[2] - before)
        pose.setflags(write=False)
        state = replace(state, pose=pose)

        # A pose that too little of the object determines is good enough to look there again, but
        # not to tell others.
        if fit.dilution > self.options.max_dilution:
            return state, NOT_SEEN
        return state, TrackedPose(pose=pose, covariance=fit.covariance, seen=True, residual=fit.rms)

    def _may_search(self, searched: float | None, t: float) -> bool:
        """Says whether the last search everywhere is long enough ago; a clock set back counts."""
        if searched is None:
            return True
        return not 0 <= t - searched < self.options.search_period

    def _undistort(self, frame: Frame, unseen: Mask | None) -> _Picture:
        """Takes the distortion out of all images, and checks their sizes."""
        self.camera.check_size(frame.color, "the color image")
        color = self.camera.undistort(frame.color)
        depth = None
        if frame.depth is not None:
            self.camera.check_size(frame.depth, "the depth image")
            depth = self.camera.undistort(frame.depth)
        covered = np.zeros((self.camera.height, self.camera.width), dtype=bool)
        if unseen is not None:
            self.camera.check_size(unseen, "the mask of what is covered")
            # No uint8, which would be interpolated between pixels.
            covered = self.camera.undistort(unseen.astype(np.uint16)) > 0
        return _Picture(color, depth, covered)

    def _paint_table(self, frame: Frame, unseen: Mask | None) -> Frame:
        """Paints the table's colors over what covers it and over the floor."""
        hidden = np.zeros(frame.color.shape[:2], dtype=bool)
        if unseen is not None:
            hidden = unseen
        if self._off_table_raw is not None:
            hidden = hidden | self._off_table_raw
        color, depth = cover_pixels(frame.color, frame.depth, hidden, PAINT_SEED)
        return frame._replace(color=color, depth=depth)

    def _find_near(self, appearance: Appearance, picture: _Picture, before: Array) -> _Fit | None:
        """Finds the object near its last pose (3,); None where it is not there."""
        view = self._look(appearance, picture, self._find_window(before))
        fit = self._register(view, before)
        return fit if self._accepts(fit, self.options.lost_share) else None

    def _find_anywhere(
        self, appearance: Appearance, picture: _Picture, before: Array | None
    ) -> _Fit | None:
        """Finds the object in the whole picture; None where it is nowhere."""
        rows, columns = picture.color.shape[:2]
        view = self._look(appearance, picture, (slice(0, rows), slice(0, columns)))
        fits = [self._register(view, pose) for pose in self._guess(view, before)]

        # Without a last pose to lean on, what is visible has to determine the pose.
        good = [
            fit
            for fit in fits
            if self._accepts(fit, self.options.found_share)
            and fit.dilution <= self.options.max_dilution
        ]
        if not good:
            return None
        return max(good, key=lambda fit: fit.share * fit.inside - fit.rms / MAX_RMS)

    def _accepts(self, fit: _Fit, share: float) -> bool:
        """Says whether a fit explains the picture, with at least a share of its edges found."""
        return fit.share >= share and fit.inside >= MIN_INSIDE and fit.rms <= MAX_RMS

    def _find_window(self, pose: Array) -> tuple[slice, slice]:
        """Finds the rows and columns in which the object may be in the next frame."""
        reach = self._silhouette(pose).buffer(self.options.max_step)
        x_low, y_low, x_high, y_high = reach.bounds
        corners = np.array(
            [
                [x_low, y_low],
                [x_low, y_high],
                [x_high, y_low],
                [x_high, y_high],
            ]
        )
        pixels = self._project(corners)
        low = np.nanmin(pixels, axis=0) - WINDOW_MARGIN
        high = np.nanmax(pixels, axis=0) + WINDOW_MARGIN
        last = np.array([self.camera.width, self.camera.height]) - 1
        left, top = np.clip(low, 0, last).astype(int)
        right, bottom = np.clip(high, 0, last).astype(int)
        return slice(top, bottom + 1), slice(left, right + 1)

    def _look(
        self, appearance: Appearance, picture: _Picture, window: tuple[slice, slice]
    ) -> _View:
        """Tells the object from the table in a part of the picture."""
        difference = to_lab(picture.color[window]) - appearance.table[window]
        hidden = picture.covered[window]
        floor = np.zeros(difference.shape[:2], dtype=bool)
        plane = None
        high = None
        if picture.depth is not None and appearance.plane is not None:
            # Heights above the plane n/d that was fitted in the first frame (section 1).
            depth = picture.depth[window]
            z = np.where(depth > 0, depth, np.nan)
            offset = float(1 / np.linalg.norm(appearance.plane))
            inverse_depth = self._rays[window] @ appearance.plane
            heights = offset * (1 - z * inverse_depth)
            plane = TablePlane(
                normal=-appearance.plane * offset,
                offset=offset,
                heights=heights,
                deviation=appearance.height_deviation,
            )
            high = find_high(plane)

            # What stands above the object's top covers it, whether or not anybody said so.
            hidden = hidden | (np.nan_to_num(heights) > self.height + CLEARANCE)

            # The floor has another color than the table and would be taken for object. Beside the
            # table, depth that is missing is floor, too, but for a rim as wide as depth is blurred.
            floor = heights < -FLOOR_DEPTH
            if self._off_table is not None:
                above_floor = dilate(heights > -FLOOR_DEPTH, FLOOR_MARGIN)
                floor |= self._off_table[window] & ~above_floor

        if hidden.any():
            hidden = dilate(hidden, COVER_MARGIN)

        # The score of each pixel and the boundary drawn by color, both of section 1.
        found: Foreground = score_pixels(difference, appearance.deviation, plane, high)
        rough = remove_thin(found.mask & ~hidden & ~floor)
        mask, coverage = refine_boundary(rough, found, hidden)
        rows, columns = window
        corner = np.array([columns.start, rows.start], dtype=np.float64)
        return _View(coverage=coverage, mask=mask, covered=hidden, corner=corner)

    def _silhouette(self, pose: Array) -> Polygon:
        """Makes the object's silhouette on the table at a pose (3,), W, m."""
        return make_silhouette(self.outline, pose, self.height, self._ideal)

    def _guess(self, view: _View, before: Array | None) -> list[Array]:
        """Lists poses whose silhouettes look most like the foreground, the best first."""
        # Shapes are compared on coarse pixels: many poses are tried, and none need be exact.
        fine = (view.mask & ~view.covered).astype(np.float32)
        scale = 1 / COARSENESS
        small = cv2.resize(fine, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA) > HALF
        count, labels, stats, middles = cv2.connectedComponentsWithStats(
            small.astype(np.uint8), connectivity=8
        )
        if count < 2:
            return []

        tried: list[tuple[float, Array]] = []
        area = stats[1:, cv2.CC_STAT_AREA]
        largest = np.argsort(-area)[:MAX_PIECES]
        for piece in 1 + largest:
            # A piece's middle is about where the object's is, at half of its height.
            middle = (middles[piece] + HALF) * COARSENESS - HALF + view.corner
            at = self._ideal.cast(middle, self.height / 2)
            for theta in np.arange(ANGLES_TRIED) * (2 * np.pi / ANGLES_TRIED):
                pose = np.array([*at, theta])
                # The silhouette's centroid, not the body's origin, belongs on the piece's middle.
                centroid = self._silhouette(pose).centroid
                pose[:2] += at - np.array(centroid.coords[0])
                overlap = self._calc_overlap(pose, labels == piece, view.corner)
                tried.append((overlap, pose))

        tried.sort(key=lambda entry: -entry[0])
        best = [pose for overlap, pose in tried[:MAX_CANDIDATES] if overlap >= MIN_OVERLAP]
        if before is not None:
            best.append(before)
        return best

    def _calc_overlap(self, pose: Array, small: Mask, corner: Array) -> float:
        """Calculates intersection over union of a silhouette and a mask of coarse pixels."""
        painted = np.zeros(small.shape, np.uint8)
        points = np.array(self._silhouette(pose).exterior.coords)
        pixels = self._project(points) - corner
        coarse = (pixels + HALF) / COARSENESS - HALF
        coarse = np.round(coarse).astype(np.int32)
        cv2.fillPoly(painted, [coarse], 1)
        common = np.count_nonzero(painted & small)
        either = np.count_nonzero(painted) + np.count_nonzero(small) - common
        return common / either

    def _register(self, view: _View, pose: Array) -> _Fit:
        """Moves the silhouette onto the edges, from coarse to fine."""
        fit = _Fit(
            pose=pose,
            covariance=np.full((3, 3), np.nan),
            dilution=np.inf,
            share=0.0,
            inside=0.0,
            rms=np.inf,
        )
        for search in SEARCHES:
            # Each stage has the prior about where the one before it ended.
            start = fit.pose
            for _ in range(search.rounds):
                fit, moved = self._improve(view, fit.pose, start, search)
                if moved < CONVERGED:
                    break
        return fit

    def _improve(
        self, view: _View, pose: Array, start: Array, search: Search
    ) -> tuple[_Fit, float]:
        """Takes one step of the least squares.

        Args:
            view: what is object in the picture.
            pose: (3,) q, the pose before the step.
            start: (3,) q_before, the middle of the prior.
            search: how edges are looked for.

        Returns:
            The fit after the step, and by how many pixels it moved the outline at most.
        """
        # d_i: how far the edges are from the boundary that the pose predicts.
        points, normals = sample_boundary(self._silhouette(pose), self._calc_spacing())
        edges = self._linearize(pose, points, normals)
        places = edges.pixels - view.corner
        offsets, state = measure_edges(
            view.coverage, view.covered, places, edges.normals, search.reach, search.step
        )
        found = np.isfinite(offsets)

        # How well the pose explains the picture, where it can be judged.
        visible = found | (state != COVERED)
        inside = 0.0
        if visible.any():
            coverage = sample_image(view.coverage, places - search.reach * edges.normals)
            inside = float((coverage[visible] > HALF).mean())
        share = found.sum() / max(1, visible.sum())

        # w_i: Tukey's weights, with the median for the scatter, as outliers do not move it.
        J = edges.J[found]
        d = offsets[found]
        spread = MIN_SPREAD
        if len(d):
            spread = max(MIN_SPREAD, TO_DEVIATION * float(np.median(np.abs(d))))
        limit = TUKEY * spread + self.options.pixel_noise
        weight = np.clip(1 - (d / limit) ** 2, 0, None) ** 2

        # sigma^2: neighboring edges share an error, so that only one in a stretch counts.
        total = max(weight.sum(), np.finfo(float).tiny)
        rms = float(np.sqrt((weight * d**2).sum() / total))
        alike = max(1.0, SHARED_LENGTH / edges.spacing)
        noise = max(rms, self.options.pixel_noise) ** 2 * alike

        # dq: the normal equations, with the prior about the pose before.
        weighted = J * weight[:, None]
        information = weighted.T @ J / noise + self._prior
        gradient = weighted.T @ d / noise + self._prior @ (start - pose)
        moved = np.linalg.solve(information, gradient)

        # C with the edges found, and C_0 as if all of the boundary had been seen.
        counts = np.zeros(len(found))
        counts[found] = weight
        covariance = self._calc_covariance(edges, counts, noise)
        whole = self._calc_covariance(edges, np.ones(len(found)), noise)
        fit = _Fit(
            pose=pose + moved,
            covariance=covariance,
            dilution=calc_dilution(whole, covariance),
            share=float(share),
            inside=inside,
            rms=rms,
        )
        return fit, float(np.abs(edges.J @ moved).max(initial=0.0))

    def _calc_covariance(self, edges: _LinearizedEdges, weight: Array, noise: float) -> Array:
        """Calculates the covariance (3, 3) of a pose.

        Args:
            edges: n edges.
            weight: (n,) their weights.
            noise: variance of an edge's place that counts what neighbors share, pixels^2.

        Returns:
            (3, 3) cov, m^2, m rad and rad^2.
        """
        # The mean of J over neighbors with the same error: what is finer is not resolved.
        count = max(1, round(SHARED_LENGTH / edges.spacing))
        J = uniform_filter1d(edges.J, count, axis=0, mode="wrap")
        weighted = J * weight[:, None]
        random = np.linalg.inv(weighted.T @ J / noise + self._prior)

        # The columns e_k: one of the visible sides, two of light along x and y.
        shared = np.column_stack([SIDE_ERROR * edges.sides, LIGHT_ERROR * edges.normals])
        moved = random @ weighted.T @ shared / noise
        return np.asarray(random + moved @ moved.T, dtype=np.float64)

    def _calc_spacing(self) -> float:
        """Calculates the distance between two points of the boundary on the table, m."""
        pixels_a_meter = self._ideal.K[0, 0] / self._ideal.center[2]
        return max(self.outline.length / MAX_POINTS, MIN_SPACING / pixels_a_meter)

    def _project(self, points: Array) -> Array:
        """Projects points (n, 2) on the table, W, m, into the picture (n, 2), pixels."""
        return self._ideal.project(np.column_stack([points, np.zeros(len(points))]))

    def _linearize(self, pose: Array, points: Array, normals: Array) -> _LinearizedEdges:
        """Projects boundary points, and finds how they move along their normals with the pose.

        Args:
            pose: (3,) pose of the object, W.
            points: (n, 2) points of the silhouette's boundary on the table, W, m.
            normals: (n, 2) outward unit normals there, W.

        Returns:
            The edges expected in the picture.
        """
        # Derivatives of the pixels by x and y on the table.
        pixels = self._project(points)
        along_x = (self._project(points + [DIFFERENCE, 0.0]) - pixels) / DIFFERENCE
        along_y = (self._project(points + [0.0, DIFFERENCE]) - pixels) / DIFFERENCE

        # A perspective picture keeps tangents and not normals: the normal in the picture is across
        # the picture of the tangent, on the side of the outward normal's picture.
        tangents = along_x * -normals[:, 1:] + along_y * normals[:, :1]
        across = np.column_stack([tangents[:, 1], -tangents[:, 0]])
        outward = along_x * normals[:, :1] + along_y * normals[:, 1:]
        across *= np.sign((across * outward).sum(axis=1, keepdims=True))
        across /= np.linalg.norm(across, axis=1, keepdims=True)

        # n_i' J_i: a turn moves a point by the arm from the body's origin, turned by 90 degrees.
        J_x = (across * along_x).sum(axis=1)
        J_y = (across * along_y).sum(axis=1)
        arm = points - pose[:2]
        along_turn_x = -arm[:, 1]
        along_turn_y = arm[:, 0]
        J_theta = J_y * along_turn_y + J_x * along_turn_x

        # A side is seen where its normal points to the camera's foot. On the table it is as wide as
        # a line of sight over the top's edge goes on before it meets the table.
        foot = self._ideal.center[:2]
        distance = self._ideal.center[2]
        toward_foot = np.maximum(0.0, ((foot - points) * normals).sum(axis=1))
        width = toward_foot * self.height / (distance - self.height)
        pixels_a_meter = np.linalg.norm(outward, axis=1)
        return _LinearizedEdges(
            pixels=pixels,
            J=np.column_stack([J_x, J_y, J_theta]),
            normals=across,
            sides=width * pixels_a_meter,
            spacing=float(pixels_a_meter.mean()) * self._calc_spacing(),
        )


def calc_dilution(whole: Array, left: Array) -> float:
    """Calculates by how much the standard deviation of some combination of unknowns grows at most.

    It is sqrt(lambda_max(whole^-1 left)), over all directions.

    Args:
        whole: (3, 3) covariance with all information, positive definite.
        left: (3, 3) covariance with what is left of it.

    Returns:
        The ratio of the standard deviations.
    """
    return float(np.sqrt(eigh(left, whole, eigvals_only=True)[-1]))


def make_silhouette(outline: Polygon, pose: ArrayLike, height: float, camera: Camera) -> Polygon:
    """Makes the silhouette of a prism: all of the table that it hides from a camera.

    Args:
        outline: outline of the prism in B, m.
        pose: (3,) pose (x, y, theta) of the prism, W, m and rad.
        height: height of the prism, m.
        camera: camera above it, with X_WC.

    Returns:
        A polygon on the table's plane, W, m, counterclockwise.
    """
    bottom = orient(shapely.transform(outline, lambda points: transform(pose, points)))
    if height == 0:
        return bottom
    # The top's shadow on the table, if the camera were a lamp: the bottom, scaled from its foot.
    foot = camera.center[:2]
    distance = camera.center[2]
    scale = distance / (distance - height)
    pieces = [bottom]
    for ring in (bottom.exterior, *bottom.interiors):
        low = np.array(ring.coords)
        high = foot + scale * (low - foot)

        # Only sides that face away from the camera hide any of the table beyond the bottom.
        along = np.diff(low, axis=0)
        arm = low[:-1] - foot
        hides = along[:, 1] * arm[:, 0] - along[:, 0] * arm[:, 1] > 0

        # Such sides in a row hide one strip. Where the strip crosses itself, each side's own
        # quadrilateral is taken.
        ends = np.flatnonzero(np.diff(hides, prepend=False, append=False))
        for i, j in ends.reshape(-1, 2):
            there = low[i : j + 1]
            back = high[i : j + 1][::-1]
            strip = Polygon([*there, *back])
            if strip.is_valid:
                pieces.append(strip)
                continue
            sides = [low[i:j], low[i + 1 : j + 1], high[i + 1 : j + 1], high[i:j]]
            pieces += list(shapely.polygons(np.stack(sides, axis=1)))

    # Slivers apart from the whole come of rounding alone.
    whole = shapely.union_all([piece for piece in pieces if piece.is_valid])
    return orient(max(shapely.get_parts(whole), key=lambda piece: piece.area))


def sample_boundary(polygon: Polygon, spacing: float) -> tuple[Array, Array]:
    """Samples points on all rings of a polygon, evenly along them.

    Args:
        polygon: polygon with its exterior counterclockwise and its holes clockwise, m.
        spacing: distance between two points along a ring, m.

    Returns:
        (n, 2) points, m, and (n, 2) outward unit normals.
    """
    points = []
    normals = []
    for ring in (polygon.exterior, *polygon.interiors):
        corners = np.array(ring.coords)
        sides = np.diff(corners, axis=0)
        lengths = np.linalg.norm(sides, axis=1)
        ends = np.concatenate([[0.0], np.cumsum(lengths)])

        # Distances along the ring, from half a spacing on: no point lies on the first corner. Even
        # a tiny hole has a few.
        count = max(3, round(ends[-1] / spacing))
        at = (np.arange(count) + HALF) * spacing
        at = at[at < ends[-1]]

        side = np.searchsorted(ends, at, side="right") - 1
        side = np.clip(side, 0, len(sides) - 1)
        direction = sides[side] / lengths[side, None]
        along = at - ends[side]
        points.append(corners[side] + along[:, None] * direction)
        normals.append(np.column_stack([direction[:, 1], -direction[:, 0]]))
    return np.concatenate(points), np.concatenate(normals)


def measure_edges(
    coverage: NDArray[np.float32],
    covered: Mask,
    pixels: Array,
    normals: Array,
    reach: float,
    step: float,
) -> tuple[Array, IntArray]:
    """Looks for the object's edge across its expected boundary.

    Args:
        coverage: (h, w) share of each pixel that is object.
        covered: (h, w) pixels that say nothing.
        pixels: (n, 2) points of the expected boundary, pixels.
        normals: (n, 2) outward unit normals there, in the picture.
        reach: how far to look inward and outward, pixels.
        step: distance between two samples, pixels.

    Returns:
        (n,) how far outward the nearest edge is, pixels, NaN where there is none; and (n,) FOUND,
        MISSING or COVERED.
    """
    # Samples across the boundary, from inside to outside.
    offsets = np.arange(-reach, reach + step / 2, step)
    places = pixels[:, None] + offsets[:, None] * normals[:, None]
    levels = sample_image(coverage, places)
    hidden = sample_image(covered.astype(np.float32), places) > 0

    # An edge is where the coverage falls through a half, and both samples show something.
    before = levels[:, :-1]
    after = levels[:, 1:]
    falls = (before > HALF) & (after <= HALF)
    falls &= ~(hidden[:, :-1] | hidden[:, 1:])

    # Its place is interpolated between them; of several, the nearest to the boundary counts.
    drop = np.maximum(before - after, np.finfo(np.float32).eps)
    at = offsets[:-1] + step * (before - HALF) / drop
    at = np.where(falls, at, np.inf)
    best = np.argmin(np.abs(at), axis=1)
    nearest = at[np.arange(len(at)), best]
    found = np.isfinite(nearest)

    # Without an edge, a point tells against the pose only if all of its samples could show one.
    last = np.array(coverage.shape[::-1]) - 1
    outside = ((places < 0) | (places > last)).any(axis=(1, 2))
    unseen = hidden.any(axis=1) | outside
    state = np.full(len(nearest), MISSING)
    state[unseen] = COVERED
    state[found] = FOUND
    return np.where(found, nearest, np.nan), state


def sample_image(image: NDArray[Any], places: Array) -> NDArray[np.float32]:
    """Finds an image's values between its pixels, linearly.

    Args:
        image: (height, width) image of one channel.
        places: (..., 2) x and y, pixels.

    Returns:
        (...) values; outside of the image it counts as 0.
    """
    flat = places.reshape(-1, 1, 2).astype(np.float32)
    source = image.astype(np.float32)
    values = []
    for i in range(0, len(flat), MAX_REMAP):
        some = flat[i : i + MAX_REMAP]
        values.append(
            cv2.remap(source, some, None, cv2.INTER_LINEAR)  # type: ignore[call-overload]
        )
    return np.concatenate(values).reshape(places.shape[:-1])


def track_object(
    tracker: PoseTracker,
    frames: Iterable[Frame],
    unseen: Callable[[Frame], Mask | None] | None = None,
) -> Iterator[tuple[Frame, TrackedPose]]:
    """Finds an object in frame after frame.

    Args:
        tracker: tracker that knows the object's outline.
        frames: frames in order of time; the first shows all of the object.
        unseen: function that says which pixels of a frame something covers; None where nothing is
            known to.

    Yields:
        Each frame, and what it told.

    Raises:
        PerceptionError: as `PoseTracker.start`, of the first frame.
    """
    state = None
    for frame in frames:
        if state is None:
            state = tracker.start(frame)
        mask = None if unseen is None else unseen(frame)
        state, tracked = tracker.track(state, frame, mask)
        yield frame, tracked
