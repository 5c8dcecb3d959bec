"""The pose of a known outline, from frame to frame.

Each picture is told into object and table near the last pose, by what the table looked like in the
first one, and the outline is moved onto the edges between the two (`registration`). Where it is not
found there, it is searched for everywhere.

The object's outline and height must be known: `detection` finds them in one photograph. The theory
is in docs/theory/perception.md, section 3.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from shapely import Polygon
from shapely.geometry.base import BaseGeometry

from gridpush_drake.errors import PerceptionError
from gridpush_drake.geometry.se2 import Array, compose, wrap_angle
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
from gridpush_drake.perception.look_alikes import (
    SAME,
    Expectation,
    calc_surprise,
    find_look_alikes,
)
from gridpush_drake.perception.pixel_kernels import HALF
from gridpush_drake.perception.registration import Fit, Registration, View
from gridpush_drake.perception.table_plane import TablePlane

Mask = NDArray[np.bool_]

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


HIDDEN_SPEED = 0.1
"""Speed with which it becomes less sure where an object is that is hidden, m/s."""

MAX_HIDDEN_WAY = 0.2
"""Largest standard deviation of the place of an object that was hidden, m."""

HIDDEN_SPIN = 0.3
"""Angular velocity with which it becomes less sure how far an object is turned that is hidden,
rad/s."""

MAX_HIDDEN_TURN = 0.5
"""Largest standard deviation of the angle of an object that was hidden, rad. By a push it turns by
a part of this; half a turn, at which it may look the same, is much less likely."""

MAX_DOUBT = 7.0
"""An answer is left out if the logarithm of its likelihood is below that of the likeliest by more
than this: it is a thousand times less likely."""

SAME_ANSWER = 0.2
"""Two answers whose angles differ by less than this are the same, rad."""

STILL_SEEN = 1.25
"""Factor on the largest dilution of an object that was seen in the frame before: one that is seen
just well enough must not come and go with the noise of each picture."""

NEW_EVIDENCE = 0.1
"""Part of a picture's evidence that the pictures before it did not give."""


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


class OtherPose(NamedTuple):
    """A pose at which the object would look nearly as it does.

    Attributes:
        pose: (3,) (x, y, theta), W, m and rad.
        log_odds: logarithm of how likely it is over the likelihood of the pose that was told, 0 or
            less.
    """

    pose: Array
    log_odds: float


class _Answer(NamedTuple):
    """A registration and how likely it is, among others of the same picture.

    Attributes:
        fit: the registration.
        weight: logarithm of its likelihood, up to a constant of the picture.
    """

    fit: Fit
    weight: float


@dataclass(frozen=True, eq=False)
class TrackerState:
    """What the tracker remembers; nobody edits it.

    Attributes:
        pose: (3,) the last pose (x, y, theta) found, W, m and rad.
        lost: whether the object was not found in the last frame.
        t: time of the last frame, s.
        appearance: what the table looks like.
        told: (3,) the last pose that was told others, W, m and rad.
        told_t: time of the frame that it is of, s.
        hidden: whether nothing was told of the last frame.
        others: other poses that the last frame shows nearly as well, such as that of a wrench
            turned by half a turn; empty where there is no doubt.
        searched: time of the frame that was last searched everywhere, s; None where none was.
    """

    pose: Array
    lost: bool
    t: float
    appearance: Appearance
    told: Array
    told_t: float
    hidden: bool = False
    others: tuple["OtherPose", ...] = ()
    searched: float | None = None


@dataclass(frozen=True, eq=False)
class TrackedPose:
    """What one frame told.

    Attributes:
        pose: (3,) (x, y, theta) of the object, W, m and rad, theta without jumps; NaN where it was
            not seen.
        covariance: (3, 3) covariance of the pose, m^2, m rad and rad^2; NaN where it was not seen.
            It is large along what cannot be seen: the angle of a disc, what the arm covers, the
            angle of a plate of which it is not known which end is which.
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
        # Where the object looks alike when it is turned, both answers are weighed after it was
        # hidden. Its middle stays where it is, wherever the body's origin is.
        self._look_alikes = find_look_alikes(self.outline)
        self._middle = np.array(self.outline.centroid.coords[0])

        # All of the registration is done without lens distortion, so that straight sides are
        # straight in the picture.
        self._ideal = camera.undistorted

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
        self._registration = Registration(
            outline=self.outline,
            height=self.height,
            camera=self._ideal,
            prior=np.diag([step_information, step_information, turn_information]),
            pixel_noise=self.options.pixel_noise,
        )

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
        answers: list[_Answer] = []
        if before is not None:
            _, fit = self._find_near(appearance, picture, before)
            if fit is not None:
                answers = [_Answer(fit, 0.0)]
        if not answers:
            expected = None
            if before is not None:
                step = self.options.max_step
                expected = Expectation(before, step, self.options.max_turn)
            answers = self._find_anywhere(appearance, picture, expected)
        if not answers:
            raise PerceptionError(
                "no object of this outline is in view; expected the one that the object's file"
                " describes",
                draw_contours(picture.color, found.mask),
            )

        # A guess also says which turn the angle is counted in; without one it is the first.
        pose = answers[0].fit.pose.copy()
        if before is None:
            pose[2] = wrap_angle(pose[2])
        return TrackerState(
            pose=pose,
            lost=False,
            t=frame.t,
            appearance=appearance,
            told=pose,
            told_t=frame.t,
            others=_list_others(answers),
        )

    def track(
        self,
        state: TrackerState,
        frame: Frame,
        unseen: Mask | None = None,
        expected: Expectation | None = None,
    ) -> tuple[TrackerState, TrackedPose]:
        """Finds the object in a frame.

        Args:
            state: after the frame before.
            frame: the next one.
            unseen: (height, width) bool, pixels of the frame which something covers, such as the
                arm; None where nothing is known to.
            expected: where the object is expected, such as where a model says that a push took it;
                None where only its last pose is known.

        Returns:
            The state after it, and the pose.

        Raises:
            ImageError: an image has another size than the camera.
        """
        picture = self._undistort(frame, unseen)

        # Where it is expected first; everywhere only if it is gone from there, and not in every
        # frame.
        starts = [state.pose] if expected is None else [expected.pose, state.pose]
        if expected is None:
            expected = self._expect(state, frame.t)
        answers = self._follow(state, picture, starts, expected)
        searched = state.searched

        # After it was hidden, edges that are missing in plain view tell of an outline that came to
        # rest on the wrong ones.
        doubtful = state.hidden and any(
            each.fit.share < self.options.found_share for each in answers
        )
        if (doubtful or not answers) and self._may_search(searched, frame.t):
            found = self._find_anywhere(state.appearance, picture, expected)
            answers = found or answers
            searched = frame.t
        state = replace(state, lost=not answers, t=frame.t, searched=searched)
        if not answers:
            return replace(state, hidden=True, others=()), NOT_SEEN

        # The angle goes on from the last one, so that a full turn is no jump.
        fit = answers[0].fit
        pose = fit.pose.copy()
        before = state.pose[2]
        pose[2] = before + wrap_angle(pose[2] - before)
        pose.setflags(write=False)
        state = replace(state, pose=pose, others=_list_others(answers))

        # A pose that too little of the object determines is good enough to look there again, but
        # not to tell others.
        limit = self.options.max_dilution
        if not state.hidden:
            limit *= STILL_SEEN
        if fit.dilution > limit:
            return replace(state, hidden=True), NOT_SEEN
        state = replace(state, told=pose, told_t=frame.t, hidden=False)
        covariance = _mix_covariances(answers)
        return state, TrackedPose(pose=pose, covariance=covariance, seen=True, residual=fit.rms)

    def _expect(self, state: TrackerState, t: float) -> Expectation:
        """Says where the object is expected by its last pose, and how long ago that was told."""
        since = max(0.0, t - state.told_t)
        place = max(self.options.max_step, min(HIDDEN_SPEED * since, MAX_HIDDEN_WAY))
        turn = max(self.options.max_turn, min(HIDDEN_SPIN * since, MAX_HIDDEN_TURN))
        return Expectation(pose=state.told, place_deviation=place, turn_deviation=turn)

    def _follow(
        self, state: TrackerState, picture: _Picture, starts: list[Array], expected: Expectation
    ) -> list[_Answer]:
        """Finds the object near where it is expected.

        Args:
            state: after the frame before.
            picture: the frame.
            starts: poses (3,) about which it is looked for, until it is found.
            expected: how likely it is where.

        Returns:
            The poses that explain the picture, the likeliest first; none where it is not there.
        """
        for start in starts:
            view, fit = self._find_near(state.appearance, picture, start)
            if fit is not None:
                break
        if fit is None:
            return []

        # After it was hidden, whatever looks alike may be the right answer.
        if state.hidden:
            return self._weigh_look_alikes(view, fit, expected)

        # Else only the answers go on that could not be told apart before. The pictures of a video
        # share most of what is wrong with them, so that each adds a part of its evidence alone.
        answers = [_Answer(fit, 0.0)]
        for other in state.others:
            again = self._registration.register(view, other.pose)
            if self._accepts(again, self.options.lost_share):
                gain = NEW_EVIDENCE * (again.evidence - fit.evidence)
                answers.append(_Answer(again, other.log_odds + gain))
        return _choose(answers)

    def _weigh_look_alikes(
        self, view: View, fit: Fit, expected: Expectation | None
    ) -> list[_Answer]:
        """Weighs a registration against those at which the object looks nearly the same.

        Args:
            view: what is object in the picture.
            fit: the registration.
            expected: where the object is expected; None where nothing is known.

        Returns:
            The answers, the likeliest first.
        """
        fits = [fit]
        for way in self._look_alikes:
            # Where nothing was seen before, either end may be called the first.
            if expected is None and way.overlap > SAME:
                continue
            again = self._registration.register(view, np.asarray(compose(fit.pose, way.pose)))
            if self._accepts(again, self.options.lost_share):
                fits.append(again)
        answers = []
        for each in fits:
            surprise = 0.0
            if expected is not None:
                surprise = calc_surprise(expected, each.pose, self._middle)
            answers.append(_Answer(each, each.evidence - surprise))
        return _choose(answers)

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

    def _find_near(
        self, appearance: Appearance, picture: _Picture, before: Array
    ) -> tuple[View, Fit | None]:
        """Looks for the object near a pose (3,).

        Returns:
            What is object there, and the fit; None where the object is not there.
        """
        view = self._look(appearance, picture, self._find_window(before))
        fit = self._registration.register(view, before)
        return view, fit if self._accepts(fit, self.options.lost_share) else None

    def _find_anywhere(
        self, appearance: Appearance, picture: _Picture, expected: Expectation | None
    ) -> list[_Answer]:
        """Finds the object in the whole picture.

        Returns:
            The poses that explain the picture, the likeliest first; none where it is nowhere.
        """
        rows, columns = picture.color.shape[:2]
        view = self._look(appearance, picture, (slice(0, rows), slice(0, columns)))
        before = None if expected is None else expected.pose
        fits = [self._registration.register(view, pose) for pose in self._guess(view, before)]

        # Without a last pose to lean on, what is visible has to determine the pose.
        good = [
            fit
            for fit in fits
            if self._accepts(fit, self.options.found_share)
            and fit.dilution <= self.options.max_dilution
        ]
        if not good:
            return []
        best = max(good, key=lambda fit: fit.share * fit.inside - fit.rms / MAX_RMS)
        return self._weigh_look_alikes(view, best, expected)

    def _accepts(self, fit: Fit, share: float) -> bool:
        """Says whether a fit explains the picture, with at least a share of its edges found."""
        return fit.share >= share and fit.inside >= MIN_INSIDE and fit.rms <= MAX_RMS

    def _find_window(self, pose: Array) -> tuple[slice, slice]:
        """Finds the rows and columns in which the object may be in the next frame."""
        bounds = self._registration.find_bounds(pose)
        pixels_a_meter = self._ideal.K[0, 0] / (self._ideal.center[2] - self.height)
        margin = WINDOW_MARGIN + self.options.max_step * pixels_a_meter
        low = bounds[0] - margin
        high = bounds[1] + margin
        last = np.array([self.camera.width, self.camera.height]) - 1
        left, top = np.clip(low, 0, last).astype(int)
        right, bottom = np.clip(high, 0, last).astype(int)
        return slice(top, bottom + 1), slice(left, right + 1)

    def _look(self, appearance: Appearance, picture: _Picture, window: tuple[slice, slice]) -> View:
        """Tells the object from the table in a part of the picture."""
        difference = to_lab(picture.color[window]) - appearance.table[window]
        hidden = picture.covered[window]
        floor = np.zeros(difference.shape[:2], dtype=bool)
        plane = None
        high = None
        if picture.depth is not None and appearance.plane is not None:
            # Heights above the plane n/d that was fitted in the first frame (section 1).
            heights = self._calc_heights(picture.depth, appearance.plane, window)
            offset = float(1 / np.linalg.norm(appearance.plane))
            plane = TablePlane(
                normal=-appearance.plane * offset,
                offset=offset,
                heights=heights,
                deviation=appearance.height_deviation,
            )
            high = find_high(plane)

            # What stands above the object's top covers it, whether or not anybody said so.
            hidden = hidden | (heights > self.height + CLEARANCE)

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
        return View(coverage=coverage, mask=mask, covered=hidden, corner=corner)

    def _calc_heights(
        self, depth: NDArray[np.float32], plane: Array, window: tuple[slice, slice]
    ) -> NDArray[np.float32]:
        """Calculates how high above the table the pixels of a window are, m; NaN without depth.

        Args:
            depth: (height, width) of the whole picture, m.
            plane: (3,) n/d of the table.
            window: rows and columns.

        Returns:
            (h, w), m.
        """
        # The inverse depth n/d . r of the plane is linear in the pixel, as r is.
        across, down, level = np.linalg.solve(self._ideal.K.T, plane)
        rows, columns = window
        x = np.arange(columns.start, columns.stop)
        y = np.arange(rows.start, rows.stop)
        in_row = (across * x).astype(np.float32)
        in_column = (down * y + level).astype(np.float32)
        inverse_depth = in_column[:, None] + in_row

        # 1 - z (n/d).r is 0 on the plane, and 1/|n/d| the camera's distance.
        z = depth[window]
        heights = np.float32(1 / np.linalg.norm(plane)) * (1 - z * inverse_depth)
        heights[~(z > 0)] = np.nan
        return heights

    def _guess(self, view: View, before: Array | None) -> list[Array]:
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
                centroid = self._registration.make_silhouette(pose).centroid
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
        points = np.array(self._registration.make_silhouette(pose).exterior.coords)
        on_table = np.column_stack([points, np.zeros(len(points))])
        pixels = self._ideal.project(on_table) - corner
        coarse = (pixels + HALF) / COARSENESS - HALF
        coarse = np.round(coarse).astype(np.int32)
        cv2.fillPoly(painted, [coarse], 1)
        common = np.count_nonzero(painted & small)
        either = np.count_nonzero(painted) + np.count_nonzero(small) - common
        return common / either


def _choose(answers: list[_Answer]) -> list[_Answer]:
    """Sorts answers, the likeliest first, and leaves out those beyond doubt and those given twice.

    Args:
        answers: answers of one picture.

    Returns:
        Some of them, one or more.
    """
    kept: list[_Answer] = []
    for answer in sorted(answers, key=lambda each: -each.weight):
        if kept and answer.weight < kept[0].weight - MAX_DOUBT:
            break
        turns = [abs(wrap_angle(answer.fit.pose[2] - each.fit.pose[2])) for each in kept]
        if all(turn > SAME_ANSWER for turn in turns):
            kept.append(answer)
    return kept


def _list_others(answers: list[_Answer]) -> tuple[OtherPose, ...]:
    """Lists all answers but the likeliest, which is the first, for the next frame."""
    best = answers[0].weight
    return tuple(OtherPose(each.fit.pose, each.weight - best) for each in answers[1:])


def _mix_covariances(answers: list[_Answer]) -> Array:
    """Calculates the covariance (3, 3) of a pose that may be one of several.

    Args:
        answers: what it may be; it is told as the first of them.

    Returns:
        The mean square distance from the first pose: its own covariance where there is no doubt.
    """
    weights = np.exp([each.weight - answers[0].weight for each in answers])
    weights /= weights.sum()
    total = np.zeros((3, 3))
    for weight, answer in zip(weights, answers, strict=True):
        off = answer.fit.pose - answers[0].fit.pose
        off[2] = wrap_angle(off[2])
        total += weight * (answer.fit.covariance + np.outer(off, off))
    return total


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
