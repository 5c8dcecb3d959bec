"""The pose of a known outline, from frame to frame.

In each picture the outline is looked for near the last pose and, where it is not found there,
everywhere (`outline_finder`). To that end the picture is divided into object and table by what the
table looked like in the first one (`picture_reader`), and the outline is moved onto the edges
between the two (`registration`). Several objects in one picture are followed by `scene_tracking`.

While the arm covers more of the object than before, its pose is corrected by how the edges left in
view changed since. If they do not show a small motion, and nothing touched the object meanwhile,
its pose is not told: the object did not jump, but the view of it is poor. An object that plainly is
no longer where it was, because somebody else moved it, is told at once.

The object's outline and height must be known: `detection` finds them in one photograph. The theory
is in docs/theory/perception.md, section 3.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from shapely import Polygon
from shapely.geometry.base import BaseGeometry

from gridpush_drake.errors import PerceptionError
from gridpush_drake.geometry.se2 import Array, wrap_angle
from gridpush_drake.objects.outline import make_polygon
from gridpush_drake.perception.images.camera import Camera
from gridpush_drake.perception.images.drawing import draw_contours
from gridpush_drake.perception.images.frames import Frame, Mask
from gridpush_drake.perception.tracking.outline_finder import OutlineFinder, TrackerOptions
from gridpush_drake.perception.tracking.picture_reader import (
    Appearance,
    PictureReader,
    UndistortedPicture,
)
from gridpush_drake.perception.tracking.pose_hypotheses import (
    OtherPose,
    PoseHypothesis,
    choose_hypotheses,
    list_others,
    mix_covariances,
)
from gridpush_drake.perception.tracking.registration import Fit, View
from gridpush_drake.perception.tracking.symmetries import ExpectedPose

OCCLUDED_SPEED = 0.1
"""Speed with which it becomes less sure where an object is that is hidden, m/s."""

MAX_OCCLUDED_TRAVEL = 0.2
"""Largest standard deviation of the place of an object that was hidden, m."""

OCCLUDED_SPIN = 0.3
"""Angular velocity with which it becomes less sure how far an object is turned that is hidden,
rad/s."""

MAX_OCCLUDED_TURN = 0.5
"""Largest standard deviation of the angle of an object that was hidden, rad. By a push it turns by
a part of this; half a turn, at which it may look the same, is much less likely."""

LOST_HYSTERESIS = 1.25
"""Factor on the largest dilution of an object that was seen in the frame before: one that is seen
just well enough must not come and go with the noise of each picture."""

NEW_EVIDENCE = 0.1
"""Part of a picture's evidence that the pictures before it did not give."""

STILL_CLEAR = 0.01
"""If less than this fraction of an object's edges is newly covered, it is as well in view as
before: the rim of what covers it comes and goes with the noise of each picture."""

AMBIGUITY_TIME = 4.0
"""Longest time for which an object is not told that seems to have moved untouched, s. After that
the poor view of it is all that there is, as where the arm rests before an object that a person
moved."""


@dataclass(frozen=True, eq=False)
class TrackerState:
    """What the tracker remembers; nobody edits it.

    Attributes:
        pose: (3,) the last pose (x, y, theta) found, W, m and rad.
        lost: whether the object was not found in the last frame.
        t: time of the last frame, s.
        appearance: what the table looks like.
        last_published_pose: (3,) the last pose that was told others, W, m and rad.
        last_published_time: time of the frame that it is of, s.
        hidden: whether nothing was told of the last frame.
        others: other poses that the last frame shows nearly as well, such as that of a wrench
            turned by half a turn; empty where there is no doubt.
        searched: time of the frame that was last searched everywhere, s; None where none was.
        clear: the registration in the last frame that showed all that was seen of the object in the
            `clear` frame before; None before there is one.
        touched: whether something may have touched the object in that frame or since.
    """

    pose: Array
    lost: bool
    t: float
    appearance: Appearance
    last_published_pose: Array
    last_published_time: float
    hidden: bool = False
    others: tuple["OtherPose", ...] = ()
    searched: float | None = None
    clear: Fit | None = None
    touched: bool = False


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
        self._reader = PictureReader(camera, table_top)
        self._finder = OutlineFinder(
            outline=self.outline,
            height=self.height,
            camera=camera,
            reader=self._reader,
            options=self.options,
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
        appearance, off_table = self._reader.learn(frame, unseen)
        state = self.begin(appearance, self._reader.read(frame, unseen), guess)
        if state is None:
            raise PerceptionError(
                "no object of this outline is in view; expected the one that the object's file"
                " describes",
                draw_contours(self.camera.undistort(frame.color), off_table),
            )
        return state

    def begin(
        self,
        appearance: Appearance,
        picture: UndistortedPicture,
        guess: ArrayLike | None = None,
        fraction: float | None = None,
    ) -> TrackerState | None:
        """Finds the object in the first picture; `start` does this and what comes before.

        Args:
            appearance: what the table looks like.
            picture: the first picture.
            guess: see `start`.
            fraction: least fraction of the visible outline that has to be found; by default that of
                `TrackerOptions`, `lost_fraction` near a guess and `found_fraction` elsewhere.

        Returns:
            The state before the first `track`; None where no such object is in view.
        """
        # A guess is worth a look before the slower search of the whole picture.
        before = None if guess is None else np.array(guess, dtype=np.float64)
        hypotheses: list[PoseHypothesis] = []
        if before is not None:
            _, fit = self._finder.find_near(appearance, picture, before)
            if fit is not None and fit.fraction >= (fraction or 0.0):
                hypotheses = [PoseHypothesis(fit, 0.0)]
        if not hypotheses:
            expected = None
            if before is not None:
                step = self.options.max_step
                expected = ExpectedPose(before, step, self.options.max_turn)
            hypotheses = self._finder.find_anywhere(appearance, picture, expected, fraction)
        if not hypotheses:
            return None

        # A guess also says which turn the angle is counted in; without one it is the first.
        pose = hypotheses[0].fit.pose.copy()
        if before is None:
            pose[2] = wrap_angle(pose[2])
        return TrackerState(
            pose=pose,
            lost=False,
            t=picture.t,
            appearance=appearance,
            last_published_pose=pose,
            last_published_time=picture.t,
            others=list_others(hypotheses),
            clear=hypotheses[0].fit._replace(pose=pose),
        )

    def track(
        self,
        state: TrackerState,
        frame: Frame,
        unseen: Mask | None = None,
        expected: ExpectedPose | None = None,
        untouched: bool = False,
    ) -> tuple[TrackerState, TrackedPose]:
        """Finds the object in a frame.

        Args:
            state: after the frame before.
            frame: the next one.
            unseen: (height, width) bool, pixels of the frame which something covers, such as the
                arm; None where nothing is known to.
            expected: where the object is expected, such as where a model says that a push took it;
                None where only its last pose is known.
            untouched: whether the robot surely has not touched the object since the frame before.
                It is then at rest; it counts as not seen if it seems to have moved where something
                covers more of it than before.

        Returns:
            The state after it, and the pose.

        Raises:
            ImageError: an image has another size than the camera.
        """
        picture = self._reader.read(frame, unseen)
        return self.track_picture(state, picture, expected, untouched=untouched)

    def track_picture(
        self,
        state: TrackerState,
        picture: UndistortedPicture,
        expected: ExpectedPose | None = None,
        start: Array | None = None,
        may_search: bool = True,
        untouched: bool = False,
    ) -> tuple[TrackerState, TrackedPose]:
        """Finds the object in a picture; `track` does this with the picture of a frame.

        Args:
            state: after the picture before.
            picture: the next one.
            expected: see `track`.
            start: (3,) a pose about which it is looked for first, W, m and rad; None for where it
                is expected.
            may_search: whether the whole picture may be searched if it is not found there.
            untouched: see `track`.

        Returns:
            The state after it, and the pose.
        """
        # Where it is expected first; everywhere only if it is gone from there, and not in every
        # frame.
        starts = [state.pose] if expected is None else [expected.pose, state.pose]
        if start is not None:
            starts = [start, *starts]
        if expected is None:
            expected = self._expect(state, picture.t)
        view, hypotheses = self._follow(state, picture, starts, expected)
        searched = state.searched

        # After it was hidden, edges that are missing in plain view tell of an outline that came to
        # rest on the wrong ones.
        doubtful = state.hidden and any(
            each.fit.fraction < self.options.found_fraction for each in hypotheses
        )
        gone = doubtful or not hypotheses
        if gone and may_search and self._may_search(searched, picture.t):
            found = self._finder.find_anywhere(state.appearance, picture, expected)
            hypotheses = found or hypotheses
            searched = picture.t
        touched = state.touched or not untouched
        state = replace(state, lost=not hypotheses, t=picture.t, searched=searched, touched=touched)
        if not hypotheses:
            return replace(state, hidden=True, others=()), NOT_SEEN

        # What covers a part of the object must not seem to move it.
        steady = self._compare_with_clear(state, view, hypotheses[0].fit)
        if steady is None:
            return replace(state, hidden=True, others=()), NOT_SEEN
        if steady is hypotheses[0].fit:
            state = replace(state, clear=steady, touched=not untouched)
        fit = steady
        hypotheses = [hypotheses[0]._replace(fit=fit), *hypotheses[1:]]

        # The angle goes on from the last one, so that a full turn is no jump.
        pose = fit.pose.copy()
        before = state.pose[2]
        pose[2] = before + wrap_angle(pose[2] - before)
        pose.setflags(write=False)
        state = replace(state, pose=pose, others=list_others(hypotheses))

        # A pose that too little of the object determines is good enough to look there again, but
        # not to tell others.
        limit = self.options.max_dilution
        if not state.hidden:
            limit *= LOST_HYSTERESIS
        if fit.dilution > limit:
            # Nor is it one that later pictures are to be compared with.
            clear = None if state.clear is fit else state.clear
            return replace(state, hidden=True, clear=clear), NOT_SEEN
        state = replace(
            state, last_published_pose=pose, last_published_time=picture.t, hidden=False
        )
        covariance = mix_covariances(hypotheses)
        return state, TrackedPose(pose=pose, covariance=covariance, seen=True, residual=fit.rms)

    def make_silhouette(self, pose: Array) -> Polygon:
        """Makes the object's silhouette on the table at a pose (3,), W, m."""
        return self._finder.make_silhouette(pose)

    def _expect(self, state: TrackerState, t: float) -> ExpectedPose:
        """Says where the object is expected by its last pose, and how long ago that was told."""
        since = max(0.0, t - state.last_published_time)
        place = max(self.options.max_step, min(OCCLUDED_SPEED * since, MAX_OCCLUDED_TRAVEL))
        turn = max(self.options.max_turn, min(OCCLUDED_SPIN * since, MAX_OCCLUDED_TURN))
        return ExpectedPose(
            pose=state.last_published_pose, place_deviation=place, turn_deviation=turn
        )

    def _compare_with_clear(self, state: TrackerState, view: View, fit: Fit) -> Fit | None:
        """Corrects a registration by the last one with more of the object in view.

        Args:
            state: after the frame before; `touched` is of this one.
            view: what is object in the frame.
            fit: the registration in the frame.

        Returns:
            `fit` itself where the object is as well in view as before, or may have moved too far to
            be compared; None where it seems to have jumped in a poorer view and nothing touched it.
        """
        clear = state.clear
        if clear is None or self._finder.calc_lost(view, clear, fit.pose) < STILL_CLEAR:
            return fit
        # The change of the edges says how it moved, if little.
        motion = self._finder.measure_motion(view, clear)
        if motion is not None:
            covariance = clear.covariance + motion.covariance
            return fit._replace(pose=motion.pose, covariance=covariance)
        is_better = fit.dilution <= clear.dilution
        if state.touched or is_better or state.t - state.last_published_time > AMBIGUITY_TIME:
            return fit
        # What nothing touched is at rest. A jump of it is believed only where it plainly left.
        if self._finder.has_left(view, clear):
            return fit
        if self._finder.has_jumped(view, clear, fit.pose):
            return None
        return fit._replace(pose=clear.pose, covariance=clear.covariance)

    def _follow(
        self,
        state: TrackerState,
        picture: UndistortedPicture,
        starts: list[Array],
        expected: ExpectedPose,
    ) -> tuple[View, list[PoseHypothesis]]:
        """Finds the object near where it is expected.

        Args:
            state: after the frame before.
            picture: the frame.
            starts: poses (3,) about which it is looked for, until it is found.
            expected: how likely it is where.

        Returns:
            What is object near there; and the poses that explain the picture, the likeliest first,
            none where it is not there.
        """
        for start in starts:
            view, fit = self._finder.find_near(state.appearance, picture, start)
            if fit is not None:
                break

        # Edges that are missing in plain view tell of an outline on wrong edges, as where a thin
        # part of the object went further than it is wide.
        if fit is None or fit.fraction < self.options.found_fraction:
            fit = self._finder.look_nearby(view, start) or fit
        if fit is None:
            return view, []

        # After it was hidden, whatever looks alike may be the right answer.
        if state.hidden:
            return view, self._finder.weight_symmetric_poses(view, fit, expected)

        # Else only the answers go on that could not be told apart before. The pictures of a video
        # share most of what is wrong with them, so that each adds a part of its evidence alone.
        hypotheses = [PoseHypothesis(fit, 0.0)]
        for other in state.others:
            again = self._finder.register(view, other.pose)
            if again is not None:
                gain = NEW_EVIDENCE * (again.evidence - fit.evidence)
                hypotheses.append(PoseHypothesis(again, other.log_prior_ratio + gain))
        return view, choose_hypotheses(hypotheses)

    def _may_search(self, searched: float | None, t: float) -> bool:
        """Says whether the last search everywhere is long enough ago; a clock set back counts."""
        if searched is None:
            return True
        return not 0 <= t - searched < self.options.search_period


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
