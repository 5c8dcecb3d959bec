"""Finds a known outline in one picture: near a pose, or anywhere in it.

It looks at one picture only. What the pictures before said, and which pose goes on from where the
object was, is `tracking`'s matter. The theory is in docs/theory/perception.md, section 3.
"""

from dataclasses import dataclass

import numpy as np
from shapely import Polygon

from gridpush_drake.geometry.se2 import Array, compose
from gridpush_drake.perception.images.camera import Camera
from gridpush_drake.perception.tracking.picture_reader import (
    Appearance,
    PictureReader,
    UndistortedPicture,
)
from gridpush_drake.perception.tracking.pose_hypotheses import PoseHypothesis, choose_hypotheses
from gridpush_drake.perception.tracking.pose_search import guess_nearby, guess_poses
from gridpush_drake.perception.tracking.registration import EdgeShift, Fit, Registration, View
from gridpush_drake.perception.tracking.symmetries import (
    SAME_POSE_IOU,
    ExpectedPose,
    calc_pose_innovation,
    find_symmetries,
)

WINDOW_MARGIN = 30
"""Room around the part of the picture that can hold the object in the next frame, pixels."""

MIN_INSIDE = 0.6
"""A fit is refused if less than this fraction of the points just inside its visible boundary shows
the object."""

MAX_RMS = 2.0
"""A fit is refused if the edges found are further than this from its outline, root mean square,
pixels."""


@dataclass(frozen=True)
class TrackerOptions:
    """How the pose is found.

    Attributes:
        max_step: furthest that the object goes from one frame to the next, m.
        max_turn: furthest that the object turns from one frame to the next, rad.
        lost_fraction: the object is lost where less of its visible outline than this is found.
        found_fraction: a search everywhere accepts a pose only where at least this fraction of its
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
    lost_fraction: float = 0.5
    found_fraction: float = 0.8
    pixel_noise: float = 0.1
    max_dilution: float = 4.0
    search_period: float = 0.0


class OutlineFinder:
    """Finds one object of a known outline and height in a picture. It holds no state."""

    def __init__(
        self,
        outline: Polygon,
        height: float,
        camera: Camera,
        reader: PictureReader,
        options: TrackerOptions,
    ) -> None:
        """Takes the object and the camera.

        Args:
            outline: outline of the object in B, m.
            height: height of the object, m.
            camera: with X_WC; the table's top is at z = 0.
            reader: tells object and table apart in a part of a picture.
            options: see `TrackerOptions`.
        """
        self._height = height
        self._camera = camera
        self._reader = reader
        self._options = options

        # Where the object looks alike when it is turned, both answers are weighed after it was
        # hidden. Its middle stays where it is, wherever the body's origin is.
        self._symmetric_poses = find_symmetries(outline)
        self._middle = np.array(outline.centroid.coords[0])

        # All of the registration is done without lens distortion, so that straight sides are
        # straight in the picture.
        self._ideal = camera.undistorted

        # P of the theory: the information of what can happen between two frames.
        step_information = options.max_step**-2
        turn_information = options.max_turn**-2
        self._registration = Registration(
            outline=outline,
            height=height,
            camera=self._ideal,
            prior=np.diag([step_information, step_information, turn_information]),
            pixel_noise=options.pixel_noise,
        )

    def make_silhouette(self, pose: Array) -> Polygon:
        """Makes the object's silhouette on the table at a pose (3,), W, m."""
        return self._registration.make_silhouette(pose)

    def register(self, view: View, pose: Array) -> Fit | None:
        """Registers the outline about a pose (3,) in a part of a picture; None if it fails."""
        fit = self._registration.register(view, pose)
        return fit if self._accepts(fit, self._options.lost_fraction) else None

    def calc_lost(self, view: View, before: Fit, pose: Array) -> float:
        """Calculates how much is covered of what a fit saw; see `Registration.calc_lost`."""
        return self._registration.calc_lost(view, before, pose)

    def has_left(self, view: View, before: Fit) -> bool:
        """Says whether the object is not where it was; see `Registration.has_left`."""
        return self._registration.has_left(view, before)

    def has_jumped(self, view: View, before: Fit, pose: Array) -> bool:
        """Says whether a pose (3,) is far from a fit; see `Registration.has_jumped`."""
        return self._registration.has_jumped(view, before, pose)

    def measure_motion(self, view: View, before: Fit) -> EdgeShift | None:
        """Measures how the object moved since a fit; see `Registration.measure_motion`."""
        return self._registration.measure_motion(view, before)

    def weight_symmetric_poses(
        self, view: View, fit: Fit, expected: ExpectedPose | None
    ) -> list[PoseHypothesis]:
        """Weighs a registration against those at which the object looks nearly the same.

        Args:
            view: what is object in the picture.
            fit: the registration.
            expected: where the object is expected; None where nothing is known.

        Returns:
            The answers, the likeliest first.
        """
        fits = [fit]
        for way in self._symmetric_poses:
            # Where nothing was seen before, either end may be called the first.
            if expected is None and way.overlap > SAME_POSE_IOU:
                continue
            again = self.register(view, np.asarray(compose(fit.pose, way.pose)))
            if again is not None:
                fits.append(again)
        hypotheses = []
        for each in fits:
            innovation = 0.0
            if expected is not None:
                innovation = calc_pose_innovation(expected, each.pose, self._middle)
            hypotheses.append(PoseHypothesis(each, each.evidence - innovation))
        return choose_hypotheses(hypotheses)

    def find_near(
        self, appearance: Appearance, picture: UndistortedPicture, before: Array
    ) -> tuple[View, Fit | None]:
        """Looks for the object near a pose (3,).

        Returns:
            What is object there, and the fit; None where the object is not there.
        """
        window = self._find_window(before)
        view = self._reader.look(appearance, picture, window, self._height)
        return view, self.register(view, before)

    def look_nearby(self, view: View, pose: Array) -> Fit | None:
        """Tries other poses near one that the edges about it do not lead to.

        Args:
            view: what is object in a part of the picture.
            pose: (3,) about where the object is, W.

        Returns:
            The best registration that leaves little open; None where there is none.
        """
        reach = (self._options.max_step, self._options.max_turn)
        guesses = guess_nearby(view, self._registration, self._ideal, self._height, pose, reach)
        fits = [self._registration.register(view, guess) for guess in guesses]
        good = [
            fit
            for fit in fits
            if self._accepts(fit, self._options.found_fraction)
            and fit.dilution <= self._options.max_dilution
        ]
        return max(good, key=lambda fit: fit.evidence, default=None)

    def find_anywhere(
        self,
        appearance: Appearance,
        picture: UndistortedPicture,
        expected: ExpectedPose | None,
        fraction: float | None = None,
    ) -> list[PoseHypothesis]:
        """Finds the object in the whole picture.

        Args:
            appearance: what the table looks like.
            picture: the picture.
            expected: where the object is expected; None where nothing is known.
            fraction: least fraction of its visible outline that has to be found; None for the
                options'.

        Returns:
            The poses that explain the picture, the likeliest first; none where it is nowhere.
        """
        rows, columns = picture.color.shape[:2]
        everywhere = (slice(0, rows), slice(0, columns))
        view = self._reader.look(appearance, picture, everywhere, self._height)
        guesses = guess_poses(view, self._registration, self._ideal, self._height)
        if expected is not None:
            guesses.append(expected.pose)
        fits = [self._registration.register(view, pose) for pose in guesses]

        # Without a last pose to lean on, what is visible has to determine the pose.
        good = [
            fit
            for fit in fits
            if self._accepts(fit, fraction or self._options.found_fraction)
            and fit.dilution <= self._options.max_dilution
        ]
        if not good:
            return []
        best = max(good, key=lambda fit: fit.fraction * fit.inside - fit.rms / MAX_RMS)
        return self.weight_symmetric_poses(view, best, expected)

    def _accepts(self, fit: Fit, fraction: float) -> bool:
        """Says whether a fit explains the picture, with at least a fraction of its edges found."""
        return fit.fraction >= fraction and fit.inside >= MIN_INSIDE and fit.rms <= MAX_RMS

    def _find_window(self, pose: Array) -> tuple[slice, slice]:
        """Finds the rows and columns in which the object may be in the next frame."""
        bounds = self._registration.find_bounds(pose)
        pixels_a_meter = self._ideal.K[0, 0] / (self._ideal.center[2] - self._height)
        margin = WINDOW_MARGIN + self._options.max_step * pixels_a_meter
        low = bounds[0] - margin
        high = bounds[1] + margin
        last = np.array([self._camera.width, self._camera.height]) - 1
        left, top = np.clip(low, 0, last).astype(int)
        right, bottom = np.clip(high, 0, last).astype(int)
        return slice(top, bottom + 1), slice(left, right + 1)
