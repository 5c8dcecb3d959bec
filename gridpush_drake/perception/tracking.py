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
from gridpush_drake.geometry.se2 import Array, transform, wrap_angle
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

MAX_POINTS, SPACING = 360, 1.5
"""Of the boundary that are looked at, at most; and how far apart they are at least, pixels."""

SEARCHES = ((16.0, 1.0, 10), (6.0, 0.5, 10), (3.0, 0.25, 12))
"""How far from the boundary the edge is looked for, in what steps, pixels, and how often at most;
coarse to fine."""

CONVERGED = 1e-3
"""Pixels, of the step at which a search ends."""

TUKEY, MIN_SPREAD = 3.0, 0.3
"""Deviations at which an edge counts for nothing, and the least deviation, pixels."""

SHARED_LENGTH = 12.0
"""Along the boundary within which errors of edges are alike, pixels."""

SIDE_ERROR = 0.1
"""Of the edges below sides that are seen, in the sides' widths in the picture: a side is of another
brightness."""

LIGHT_ERROR = 0.03
"""By which light from one side draws the edges its way, pixels."""

DIFFERENCE = 1e-5
"""Step of numerical derivatives, m."""

HALF = 0.5
"""Coverage at the edge."""

CLEARANCE = 0.015
"""What stands higher than the object by this is something else, such as the arm, m."""

FLOOR, FLOOR_MARGIN = 0.05, 5
"""What lies lower than the table by this, m, is not the object, whatever its color; nor is, beyond
the table's edge, what is further than half of so many pixels from where the depth camera sees
anything above that."""

COVER_MARGIN = 9
"""Width, pixels, by which what covers the object is widened: its edges are uncertain too."""

MARGIN = 30
"""About what may hold the object in the next frame, pixels."""

PIECES, ANGLES, BEST, COARSE = 4, 48, 5, 4
"""Of a search everywhere: how many of the largest pieces are looked at, angles tried with each, how
many of the best are looked at closely, and the side of its pixels."""

PAINT_SEED = 0
"""Of the table's colors that are painted over what covers it in the first frame."""

MIN_OVERLAP = 0.35
"""Least share that silhouette and foreground have in common (intersection over union) in a search
everywhere."""

MIN_INSIDE = 0.6
"""Least share of the visible silhouette that must be foreground."""

MAX_RMS = 2.0
"""Pixels, of the edges that are found."""


@dataclass(frozen=True)
class TrackerOptions:
    """How the pose is found.

    Attributes:
        max_step: furthest that the object goes from one frame to the next, m.
        max_turn: likewise, rad.
        lost_share: the object is lost where less of its visible outline than this is found.
        found_share: in a search everywhere it is found where at least this of its visible outline
            is, and where what is visible determines the pose; else the arm's, the table's edge or
            another thing's would do.
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
        table: (height, width, 3) its color, CIE L*a*b*.
        deviation: (3,) of it.
        plane: its plane in depth, the normal (3,) over the distance; None without depth.
        height_deviation: of the table's heights, m.
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
        t: of the last frame, s.
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
        covariance: (3, 3) of it, m^2, m rad and rad^2; NaN where it was not seen. It is large along
            what cannot be seen: the angle of a disc, what the arm covers.
        seen: whether the object was found.
        residual: root mean square distance of the edges found from the outline, pixels; NaN where
            it was not seen.
    """

    pose: Array
    covariance: Array
    seen: bool
    residual: float


class _View(NamedTuple):
    """What is object in a part of the picture.

    Attributes:
        coverage: (h, w) share of each pixel that is object.
        mask: (h, w) bool.
        covered: (h, w) bool, pixels that say nothing.
        corner: (2,) the part's upper left pixel.
    """

    coverage: NDArray[np.float32]
    mask: Mask
    covered: Mask
    corner: Array


class _Fit(NamedTuple):
    """A registration: the pose, its covariance, and how well it explains the picture.

    Attributes:
        pose: (3,) m and rad.
        covariance: (3, 3) of it.
        dilution: by how much less sure it is than with nothing covered, a ratio of standard
            deviations.
        share: of the visible boundary that was found.
        inside: share of the visible silhouette that is foreground.
        rms: of the edges found, pixels.
    """

    pose: Array
    covariance: Array
    dilution: float
    share: float
    inside: float
    rms: float


NOT_SEEN = TrackedPose(np.full(3, np.nan), np.full((3, 3), np.nan), False, float("nan"))


class PoseTracker:
    """Registers a known outline to what a camera sees. It holds no state; `start` and `track` are pure."""

    def __init__(
        self, outline: Polygon | ArrayLike, height: float, camera: Camera, options: TrackerOptions | None = None,
        table_top: BaseGeometry | None = None,
    ) -> None:  # fmt: skip
        """Takes the object and the camera.

        Args:
            outline: of the object, B: a polygon, or (k, 2) vertices, m.
            height: of the object, m.
            camera: with X_WC; the table's top is at z = 0.
            options: see `TrackerOptions`.
            table_top: polygon, W, m, beyond which the floor is seen; None where that is not known.

        Raises:
            CameraError: X_WC is not known.
            ObjectError: the outline is none.
            PerceptionError: the height is negative, or the object reaches up to the camera.
        """
        self.outline = make_polygon(outline, "outline")
        self.height, self.camera, self.options = float(height), camera, options or TrackerOptions()
        if not 0 <= self.height < camera.center[2]:
            raise PerceptionError(
                f"height is {height!r}; expected 0 to {camera.center[2]:g} m, where the camera is"
            )
        self._ideal = camera.undistorted
        self._rays = make_rays(self._ideal)
        self._off_table, self._off_table_raw = (
            None if table_top is None else find_off_table(view, table_top)
            for view in (self._ideal, camera)
        )
        turn = self.options.max_turn
        self._prior = np.diag([self.options.max_step**-2, self.options.max_step**-2, turn**-2])

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
        color, depth = self._undistort(frame)
        table = self._cover(frame, unseen)
        painted, _, plane, _ = look_at_table(table.color, table.depth, self.camera)
        found = find_foreground(painted, plane)
        appearance = Appearance(
            to_lab(painted) - found.difference,
            found.deviation,
            None if plane is None else -plane.normal / plane.offset,
            0.0 if plane is None else plane.deviation,
        )
        before = None if guess is None else np.array(guess, dtype=np.float64)
        covered = self._find_covered(unseen)
        fit = None if before is None else self._find_near(appearance, color, depth, covered, before)
        fit = fit or self._find_anywhere(appearance, color, depth, covered, before)
        if fit is None:
            problem = "no object of this outline is in view; expected the one that the object's file describes"
            raise PerceptionError(problem, draw_contours(color, found.mask))
        pose = np.array(
            [*fit.pose[:2], fit.pose[2] if before is not None else wrap_angle(fit.pose[2])]
        )
        return TrackerState(pose, False, frame.t, appearance)

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
        color, depth = self._undistort(frame)
        covered = self._find_covered(unseen)
        fit, searched = (
            self._find_near(state.appearance, color, depth, covered, state.pose),
            state.searched,
        )
        if fit is None and (
            searched is None or not 0 <= frame.t - searched < self.options.search_period
        ):
            fit, searched = (
                self._find_anywhere(state.appearance, color, depth, covered, state.pose),
                frame.t,
            )
        state = replace(state, lost=fit is None, t=frame.t, searched=searched)
        if fit is None:
            return state, NOT_SEEN
        pose = fit.pose.copy()
        pose[2] = state.pose[2] + wrap_angle(pose[2] - state.pose[2])
        pose.setflags(write=False)
        if fit.dilution > self.options.max_dilution:
            return replace(state, pose=pose), NOT_SEEN
        return replace(state, pose=pose), TrackedPose(pose, fit.covariance, True, fit.rms)

    def _undistort(self, frame: Frame) -> tuple[Color, NDArray[np.float32] | None]:
        """Color and depth without distortion; their sizes are checked."""
        self.camera.check_size(frame.color, "the color image")
        if frame.depth is None:
            return self.camera.undistort(frame.color), None
        self.camera.check_size(frame.depth, "the depth image")
        return self.camera.undistort(frame.color), self.camera.undistort(frame.depth)

    def _cover(self, frame: Frame, unseen: Mask | None) -> Frame:
        """The frame with the table painted over what covers it, and over the floor: neither has the table's color."""
        hidden = np.zeros(frame.color.shape[:2], dtype=bool) if unseen is None else unseen
        if self._off_table_raw is not None:
            hidden = hidden | self._off_table_raw
        color, depth = cover_pixels(frame.color, frame.depth, hidden, PAINT_SEED)
        return frame._replace(color=color, depth=depth)

    def _find_covered(self, unseen: Mask | None) -> Mask:
        """The undistorted mask of what something covers."""
        if unseen is None:
            return np.zeros((self.camera.height, self.camera.width), dtype=bool)
        self.camera.check_size(unseen, "the mask of what is covered")
        return self.camera.undistort(unseen.astype(np.uint16)) > 0

    def _find_near(
        self, appearance: Appearance, color: Color, depth: NDArray[np.float32] | None, covered: Mask, before: Array,
    ) -> _Fit | None:  # fmt: skip
        """The object about where it was; None where it is not there."""
        view = self._look(appearance, color, depth, covered, self._find_window(before))
        fit = self._register(view, before)
        return fit if self._accepts(fit, self.options.lost_share) else None

    def _find_anywhere(
        self, appearance: Appearance, color: Color, depth: NDArray[np.float32] | None, covered: Mask,
        before: Array | None,
    ) -> _Fit | None:  # fmt: skip
        """The object in the whole picture; None where it is nowhere."""
        whole = (slice(0, color.shape[0]), slice(0, color.shape[1]))
        view = self._look(appearance, color, depth, covered, whole)
        fits = [self._register(view, pose) for pose in self._guess(view, before)]
        good = [fit for fit in fits if self._accepts(fit, self.options.found_share)]
        good = [fit for fit in good if fit.dilution <= self.options.max_dilution]
        return (
            max(good, key=lambda fit: fit.share * fit.inside - fit.rms / MAX_RMS) if good else None
        )

    def _accepts(self, fit: _Fit, share: float) -> bool:
        return fit.share >= share and fit.inside >= MIN_INSIDE and fit.rms <= MAX_RMS

    def _find_window(self, pose: Array) -> tuple[slice, slice]:
        """Rows and columns in which the object may be in the next frame."""
        reach = self._silhouette(pose).buffer(self.options.max_step).bounds
        corners = np.array([[reach[i], reach[j], 0.0] for i in (0, 2) for j in (1, 3)])
        pixels = self._ideal.project(corners)
        low, high = np.nanmin(pixels, axis=0) - MARGIN, np.nanmax(pixels, axis=0) + MARGIN
        sides = np.array([self.camera.width, self.camera.height])
        x, y = np.clip(np.array([low, high]), 0, sides - 1).astype(int).T
        return slice(y[0], y[1] + 1), slice(x[0], x[1] + 1)

    def _look(
        self, appearance: Appearance, color: Color, depth: NDArray[np.float32] | None, covered: Mask,
        window: tuple[slice, slice],
    ) -> _View:  # fmt: skip
        """Tells the object from the table in a part of the picture."""
        difference = to_lab(color[window]) - appearance.table[window]
        hidden, plane, high, floor = (
            covered[window],
            None,
            None,
            np.zeros(difference.shape[:2], dtype=bool),
        )
        if depth is not None and appearance.plane is not None:
            z = np.where(depth[window] > 0, depth[window], np.nan)
            scale = float(1 / np.linalg.norm(appearance.plane))
            heights = scale * (1 - z * (self._rays[window] @ appearance.plane))
            hidden = hidden | (np.nan_to_num(heights) > self.height + CLEARANCE)
            floor = heights < -FLOOR
            if self._off_table is not None:
                floor |= self._off_table[window] & ~dilate(heights > -FLOOR, FLOOR_MARGIN)
            plane = TablePlane(
                -appearance.plane * scale, scale, heights, appearance.height_deviation
            )
            high = find_high(plane)
        hidden = dilate(hidden, COVER_MARGIN) if hidden.any() else hidden
        found: Foreground = score_pixels(difference, appearance.deviation, plane, high)
        mask, coverage = refine_boundary(remove_thin(found.mask & ~hidden & ~floor), found, hidden)
        return _View(
            coverage, mask, hidden, np.array([window[1].start, window[0].start], dtype=np.float64)
        )

    def _silhouette(self, pose: Array) -> Polygon:
        return make_silhouette(self.outline, pose, self.height, self._ideal)

    def _guess(self, view: _View, before: Array | None) -> list[Array]:
        """Poses whose silhouettes look most like the foreground, the best first."""
        small = cv2.resize((view.mask & ~view.covered).astype(np.float32), None, fx=1 / COARSE, fy=1 / COARSE,
                           interpolation=cv2.INTER_AREA) > HALF  # fmt: skip
        count, labels, stats, middles = cv2.connectedComponentsWithStats(
            small.astype(np.uint8), connectivity=8
        )
        if count < 2:
            return []
        tried: list[tuple[float, Array]] = []
        largest = 1 + np.argsort(-stats[1:, cv2.CC_STAT_AREA])[:PIECES]
        for piece in largest:
            at = self._ideal.cast(
                (middles[piece] + HALF) * COARSE - HALF + view.corner, self.height / 2
            )
            for theta in np.arange(ANGLES) * (2 * np.pi / ANGLES):
                pose = np.array([*at, theta])
                pose[:2] += at - np.array(self._silhouette(pose).centroid.coords[0])
                tried.append((self._overlap(pose, labels == piece, view.corner), pose))
        tried.sort(key=lambda entry: -entry[0])
        best = [pose for overlap, pose in tried[:BEST] if overlap >= MIN_OVERLAP]
        return best if before is None else [*best, before]

    def _overlap(self, pose: Array, small: Mask, corner: Array) -> float:
        """Intersection over union of a silhouette and a mask of coarse pixels."""
        painted = np.zeros(small.shape, np.uint8)
        points = np.array(self._silhouette(pose).exterior.coords)
        pixels = self._ideal.project(np.column_stack([points, np.zeros(len(points))])) - corner
        cv2.fillPoly(painted, [np.round((pixels + HALF) / COARSE - HALF).astype(np.int32)], 1)
        common = np.count_nonzero(painted & small)
        return common / (np.count_nonzero(painted) + np.count_nonzero(small) - common)

    def _register(self, view: _View, pose: Array) -> _Fit:
        """Moves the silhouette onto the edges, from coarse to fine."""
        fit = _Fit(pose, np.full((3, 3), np.nan), np.inf, 0.0, 0.0, np.inf)
        for reach, step, rounds in SEARCHES:
            start = fit.pose
            for _ in range(rounds):
                fit, moved = self._step(view, fit.pose, start, reach, step)
                if moved < CONVERGED:
                    break
        return fit

    def _step(
        self, view: _View, pose: Array, start: Array, reach: float, step: float
    ) -> tuple[_Fit, float]:
        """One step of the least squares, and by how many pixels it moves the outline at most."""
        points, normals = sample_boundary(self._silhouette(pose), self._spacing(pose))
        pixels, rows = self._linearize(pose, points, normals)
        offsets, state = measure_edges(
            view.coverage, view.covered, pixels - view.corner, rows.normals, reach, step
        )
        found = np.isfinite(offsets)
        visible = found | (state != COVERED)
        inside = sample_image(view.coverage, pixels - view.corner - reach * rows.normals)
        share = found.sum() / max(1, visible.sum())
        hold = float((inside[visible] > HALF).mean()) if visible.any() else 0.0
        J, d = rows.J[found], offsets[found]
        spread = (
            max(MIN_SPREAD, TO_DEVIATION * float(np.median(np.abs(d)))) if len(d) else MIN_SPREAD
        )
        weight = np.clip(1 - (d / (TUKEY * spread + self.options.pixel_noise)) ** 2, 0, None) ** 2
        rms = float(np.sqrt((weight * d**2).sum() / max(weight.sum(), np.finfo(float).tiny)))
        noise = max(rms, self.options.pixel_noise) ** 2 * max(1.0, SHARED_LENGTH / rows.spacing)
        information = (J * weight[:, None]).T @ J / noise + self._prior
        back = start - pose
        moved = np.linalg.solve(
            information, (J * weight[:, None]).T @ d / noise + self._prior @ back
        )
        counts = np.zeros(len(found))
        counts[found] = weight
        covariance = self._calc_covariance(rows, counts, noise)
        whole = self._calc_covariance(rows, np.ones(len(found)), noise)
        dilution = calc_dilution(whole, covariance)
        largest = float(np.abs(rows.J @ moved).max(initial=0.0))
        return _Fit(pose + moved, covariance, dilution, float(share), hold, rms), largest

    def _calc_covariance(self, rows: "_Rows", weight: Array, noise: float) -> Array:
        """Of a pose (3, 3), from edges of weights (n,) and a variance, pixels^2, that counts what neighbors share."""
        count = max(1, round(SHARED_LENGTH / rows.spacing))
        J = uniform_filter1d(rows.J, count, axis=0, mode="wrap")
        random = np.linalg.inv((J * weight[:, None]).T @ J / noise + self._prior)
        shared = np.column_stack([SIDE_ERROR * rows.sides, LIGHT_ERROR * rows.normals])
        moved = random @ (J * weight[:, None]).T @ shared / noise
        return np.asarray(random + moved @ moved.T, dtype=np.float64)

    def _spacing(self, pose: Array) -> float:
        """Of the points of the boundary, m."""
        length = self.outline.length
        scale = self._ideal.K[0, 0] / self._ideal.center[2]
        return max(length / MAX_POINTS, SPACING / scale)

    def _linearize(self, pose: Array, points: Array, normals: Array) -> "tuple[Array, _Rows]":
        """Pixels of boundary points, their normals in the picture, and how they move along these with the pose."""

        def project(p: Array) -> Array:
            return self._ideal.project(np.column_stack([p, np.zeros(len(p))]))

        pixels = project(points)
        along_x = (project(points + [DIFFERENCE, 0.0]) - pixels) / DIFFERENCE
        along_y = (project(points + [0.0, DIFFERENCE]) - pixels) / DIFFERENCE
        tangents = along_x * -normals[:, 1:] + along_y * normals[:, :1]
        across = np.column_stack([tangents[:, 1], -tangents[:, 0]])
        outward = along_x * normals[:, :1] + along_y * normals[:, 1:]
        across *= np.sign((across * outward).sum(axis=1, keepdims=True))
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        J_x, J_y = (across * along_x).sum(axis=1), (across * along_y).sum(axis=1)
        arm = points - pose[:2]
        J = np.column_stack([J_x, J_y, J_y * arm[:, 0] - J_x * arm[:, 1]])
        scale = np.linalg.norm(outward, axis=1)
        foot, distance = self._ideal.center[:2], self._ideal.center[2]
        toward = (
            np.maximum(0.0, ((foot - points) * normals).sum(axis=1))
            * self.height
            / (distance - self.height)
        )
        return pixels, _Rows(J, across, toward * scale, float(scale.mean()) * self._spacing(pose))


class _Rows(NamedTuple):
    """Of n edges in the picture.

    Attributes:
        J: (n, 3) derivatives of their places along their normals by the pose, pixels by m and rad.
        normals: (n, 2) outward, unit.
        sides: (n,) widths of the object's sides that are seen at them, pixels; 0 where it is the
            top that ends there.
        spacing: of them, pixels.
    """

    J: Array
    normals: Array
    sides: Array
    spacing: float


def calc_dilution(whole: Array, left: Array) -> float:
    """By how much the standard deviation of some combination of unknowns grows at most, where information is lost.

    Args:
        whole: (3, 3) covariance with all information, positive definite.
        left: (3, 3) covariance with what is left of it.

    Returns:
        The ratio of the standard deviations.
    """
    return float(np.sqrt(eigh(left, whole, eigvals_only=True)[-1]))


def make_silhouette(outline: Polygon, pose: ArrayLike, height: float, camera: Camera) -> Polygon:
    """All of the table that a prism hides from a camera.

    Args:
        outline: of the prism, B, m.
        pose: (3,) of it, W.
        height: of it, m.
        camera: above it.

    Returns:
        A polygon on the table's plane, W, m, counterclockwise.
    """
    bottom = orient(shapely.transform(outline, lambda points: transform(pose, points)))
    if height == 0:
        return bottom
    foot, distance = camera.center[:2], camera.center[2]
    scale = distance / (distance - height)
    pieces = [bottom]
    for ring in (bottom.exterior, *bottom.interiors):
        low = np.array(ring.coords)
        high = foot + scale * (low - foot)
        along, arm = np.diff(low, axis=0), low[:-1] - foot
        hides = (
            along[:, 1] * arm[:, 0] - along[:, 0] * arm[:, 1] > 0
        )  # sides that face the camera hide no more
        ends = np.flatnonzero(np.diff(hides, prepend=False, append=False))
        for i, j in ends.reshape(-1, 2):  # sides in a row that hide something
            strip = Polygon([*low[i : j + 1], *high[i : j + 1][::-1]])
            sides = np.stack([low[i:j], low[i + 1 : j + 1], high[i + 1 : j + 1], high[i:j]], axis=1)
            pieces += [strip] if strip.is_valid else list(shapely.polygons(sides))
    whole = shapely.union_all([piece for piece in pieces if piece.is_valid])
    return orient(max(shapely.get_parts(whole), key=lambda piece: piece.area))


def sample_boundary(polygon: Polygon, spacing: float) -> tuple[Array, Array]:
    """Points (n, 2) on a polygon's rings, about `spacing` m apart, and their outward unit normals (n, 2)."""
    points, normals = [], []
    for ring in (polygon.exterior, *polygon.interiors):
        corners = np.array(ring.coords)
        sides = np.diff(corners, axis=0)
        lengths = np.linalg.norm(sides, axis=1)
        ends = np.concatenate([[0.0], np.cumsum(lengths)])
        at = (np.arange(max(3, round(ends[-1] / spacing))) + HALF) * spacing
        at = at[at < ends[-1]]
        side = np.clip(np.searchsorted(ends, at, side="right") - 1, 0, len(sides) - 1)
        direction = sides[side] / lengths[side, None]
        points.append(corners[side] + (at - ends[side])[:, None] * direction)
        normals.append(np.column_stack([direction[:, 1], -direction[:, 0]]))
    return np.concatenate(points), np.concatenate(normals)


FOUND, MISSING, COVERED = 0, 1, 2


def measure_edges(
    coverage: NDArray[np.float32],
    covered: Mask,
    pixels: Array,
    normals: Array,
    reach: float,
    step: float,
) -> tuple[Array, NDArray[np.int64]]:
    """Looks for the object's edge across its expected boundary.

    Args:
        coverage: (h, w) share of each pixel that is object.
        covered: (h, w) pixels that say nothing.
        pixels: (n, 2) of the boundary.
        normals: (n, 2) outward, unit.
        reach: how far to look both ways, pixels.
        step: of looking, pixels.

    Returns:
        (n,) how far outward the nearest edge is, pixels, NaN where there is none; and (n,) FOUND,
        MISSING or COVERED.
    """
    offsets = np.arange(-reach, reach + step / 2, step)
    places = pixels[:, None] + offsets[:, None] * normals[:, None]
    levels = sample_image(coverage, places)
    hidden = sample_image(covered.astype(np.float32), places) > 0
    falls = (levels[:, :-1] > HALF) & (levels[:, 1:] <= HALF)
    falls &= ~(hidden[:, :-1] | hidden[:, 1:])
    drop = np.maximum(levels[:, :-1] - levels[:, 1:], np.finfo(np.float32).eps)
    at = offsets[:-1] + step * (levels[:, :-1] - HALF) / drop
    at = np.where(falls, at, np.inf)
    best = np.argmin(np.abs(at), axis=1)
    nearest = at[np.arange(len(at)), best]
    outside = ((places < 0) | (places > np.array(coverage.shape[::-1]) - 1)).any(axis=(1, 2))
    nearest = np.where(np.isfinite(nearest), nearest, np.nan)
    unseen = ~np.isfinite(nearest) & (hidden.any(axis=1) | outside)
    return nearest, np.where(np.isfinite(nearest), FOUND, np.where(unseen, COVERED, MISSING))


def sample_image(image: NDArray[Any], places: Array) -> NDArray[np.float32]:
    """Finds the values of an image (height, width) at places (..., 2), linear between pixels; 0 outside."""
    flat = places.reshape(-1, 1, 2).astype(np.float32)
    values = [
        cv2.remap(image.astype(np.float32), flat[i : i + MAX_REMAP], None, cv2.INTER_LINEAR)  # type: ignore[call-overload]
        for i in range(0, len(flat), MAX_REMAP)
    ]
    return np.concatenate(values).reshape(places.shape[:-1])


MAX_REMAP = 32_000
"""Places that OpenCV looks up in one go."""


def track_object(
    tracker: PoseTracker,
    frames: Iterable[Frame],
    unseen: Callable[[Frame], Mask | None] | None = None,
) -> Iterator[tuple[Frame, TrackedPose]]:
    """Finds an object in frame after frame.

    Args:
        tracker: of the object.
        frames: in order of time; the first shows all of the object.
        unseen: says of each what something covers; None where nothing is known to.

    Yields:
        Each frame, and what it told.

    Raises:
        PerceptionError: as `PoseTracker.start`, of the first frame.
    """
    state = None
    for frame in frames:
        state = tracker.start(frame) if state is None else state
        state, tracked = tracker.track(state, frame, unseen(frame) if unseen is not None else None)
        yield frame, tracked
