"""The poses of several known outlines, from frame to frame.

Objects on one table touch and push each other, and then no edge lies between them. What keeps them
apart is that their outlines are known: each pixel is explained by the object whose silhouette is
nearest, and says nothing of the others. So objects that touch do not pull on each other. As the
silhouettes are those of the poses that are looked for, the objects are registered in turn, until
none of them moves any more.

One object is followed by `tracking`. The theory is in docs/theory/perception.md, section 3.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from shapely import Polygon
from shapely.geometry.base import BaseGeometry

from gridpush_drake.errors import PerceptionError
from gridpush_drake.geometry.se2 import Array, wrap_angle
from gridpush_drake.perception.images.camera import Camera
from gridpush_drake.perception.images.drawing import draw_contours
from gridpush_drake.perception.images.frames import Frame, Mask
from gridpush_drake.perception.tracking.outline_finder import TrackerOptions
from gridpush_drake.perception.tracking.picture_reader import (
    Appearance,
    PictureReader,
    UndistortedPicture,
)
from gridpush_drake.perception.tracking.symmetries import ExpectedPose
from gridpush_drake.perception.tracking.tracking import PoseTracker, TrackedPose, TrackerState

OCCLUSION_MARGIN = 2.0
"""A pixel says nothing of an object if another one is nearer, or farther by less than this, pixels:
where two objects meet, blur mixes their colors with the dark gap between them."""

NEIGHBOR_DISTANCE = 40.0
"""Objects whose silhouettes are further apart than this do not disturb each other, pixels."""

SETTLED_MOTION = 0.05
"""An object is registered again if a neighbor has moved by more than this since, pixels."""

MAX_SWEEPS = 4
"""Most times that an object is registered in one picture."""

FRACTION_BITS = 4
"""Bits after the binary point in the coordinates of silhouettes that are painted."""


class KnownObject(NamedTuple):
    """An object that is followed.

    Attributes:
        outline: outline of the object in B, a polygon or (k, 2) vertices, m.
        height: height of the object, m.
        name: what it is called in messages.
    """

    outline: Polygon | ArrayLike
    height: float
    name: str = "object"


@dataclass(frozen=True, eq=False)
class SceneTrackerState:
    """What the tracker of several objects remembers; nobody edits it.

    Attributes:
        objects: what is remembered of each object, in their order.
    """

    objects: tuple[TrackerState, ...]


class SceneTracker:
    """Registers several known outlines to what a camera sees.

    It holds no state: `start` and `track` take the state and return the next one.
    """

    def __init__(
        self,
        objects: Sequence[KnownObject],
        camera: Camera,
        options: TrackerOptions | None = None,
        table_top: BaseGeometry | None = None,
    ) -> None:
        """Takes the objects and the camera.

        Args:
            objects: the objects, one or more; several of them may have one outline.
            camera: with X_WC; the table's top is at z = 0.
            options: see `TrackerOptions`.
            table_top: polygon, W, m, beyond which the floor is seen; None where that is not known.

        Raises:
            CameraError: X_WC is not known.
            ObjectError: an outline is none.
            PerceptionError: there is no object, a height is negative, or an object reaches up to
                the camera.
        """
        if not len(objects):
            raise PerceptionError("objects: none are given; expected one or more to follow")
        self.camera = camera
        self._options = options or TrackerOptions()
        self.names = tuple(each.name for each in objects)
        self._trackers = tuple(
            PoseTracker(each.outline, each.height, camera, options, table_top) for each in objects
        )
        self._reader = PictureReader(camera, table_top)
        self._ideal = camera.undistorted

        # Of each object, the pixels by which its rim moves when it turns by 1 rad, and when it goes
        # by 1 m.
        self._pixels_a_meter = camera.K[0, 0] / camera.center[2]
        self._reach = tuple(
            float(np.linalg.norm(np.array(each.outline.exterior.coords), axis=1).max())
            for each in self._trackers
        )

    def __len__(self) -> int:
        """Number of objects."""
        return len(self._trackers)

    def start(
        self,
        frame: Frame,
        guesses: Sequence[ArrayLike | None] | None = None,
        unseen: Mask | None = None,
    ) -> SceneTrackerState:
        """Learns what the table looks like, and finds the objects.

        Args:
            frame: the first; the objects lie in it, seen whole.
            guesses: for each object (3,) its pose (x, y, theta), W, about, m and rad, or None to
                search for it everywhere; None for all of them to be searched for.
            unseen: see `track`.

        Returns:
            The state before the first `track`, which may be of the same frame.

        Raises:
            PerceptionError: an image has another size, no table is in view, there are not as many
                guesses as objects, or an object is not found.
        """
        # Told are poses in the objects' order, some of which nobody knows.
        given = [None] * len(self) if guesses is None else list(guesses)
        if len(given) != len(self):
            raise PerceptionError(
                f"guesses: {len(given)} are given; expected {len(self)}, one for each object"
            )
        appearance, off_table = self._reader.learn(frame, unseen)
        picture = self._reader.read(frame, unseen)

        # Where poses are told, they say at once which pixels belong to which object.
        places = [None if guess is None else np.array(guess, dtype=np.float64) for guess in given]
        states: list[TrackerState | None] = [None] * len(self)
        for i, place in enumerate(places):
            if place is not None:
                near = self._explain(i, places, picture)
                states[i] = self._trackers[i].begin(appearance, near, place)
        poses = [None if state is None else state.pose for state in states]

        # The others are searched for: the plainest first, and then the next one among the pixels
        # that are left. Where two objects touch, neither shows all of its outline before the other
        # is found.
        fraction = self._options.found_fraction
        while missing := [i for i, state in enumerate(states) if state is None]:
            found = self._find_plainest(appearance, picture, missing, poses, fraction)
            if found is not None:
                i, state = found
                states[i] = state
                poses[i] = state.pose
            elif fraction > self._options.lost_fraction:
                fraction = self._options.lost_fraction
            else:
                raise self._make_refusal(missing, frame, off_table)

        # With all of them in place, each is registered by the others' silhouettes, and has to show
        # what of its outline can be seen.
        for last in (False, True):
            for i, tracker in enumerate(self._trackers):
                fraction = self._options.found_fraction if last else self._options.lost_fraction
                near = self._explain(i, poses, picture)
                settled = tracker.begin(appearance, near, poses[i], fraction)
                if settled is None:
                    raise self._make_refusal([i], frame, off_table)
                states[i] = settled
                poses[i] = settled.pose
        return SceneTrackerState(tuple(state for state in states if state is not None))

    def track(
        self,
        state: SceneTrackerState,
        frame: Frame,
        unseen: Mask | None = None,
        expected: Sequence[ExpectedPose | None] | None = None,
    ) -> tuple[SceneTrackerState, tuple[TrackedPose, ...]]:
        """Finds the objects in a frame.

        Args:
            state: after the frame before.
            frame: the next one.
            unseen: (height, width) bool, pixels of the frame which something covers, such as the
                arm; None where nothing is known to.
            expected: for each object where it is expected, such as where a model says that a push
                took it, or None; None where only the last poses are known.

        Returns:
            The state after it, and the pose of each object.

        Raises:
            ImageError: an image has another size than the camera.
        """
        # Where each object is to begin with: where it is expected, or where it was.
        picture = self._reader.read(frame, unseen)
        hopes = [None] * len(self) if expected is None else list(expected)
        poses: list[Array | None] = [None if each.lost else each.pose for each in state.objects]
        if expected is not None:
            poses = [
                pose if hope is None else hope.pose for pose, hope in zip(poses, hopes, strict=True)
            ]
        results: list[tuple[TrackerState, TrackedPose] | None] = [None] * len(self)
        used: list[list[Array | None]] = [[] for _ in results]

        # Each object in turn, by the silhouettes of the others as they are known by then; again
        # where a neighbor has moved since. Nothing is searched for yet.
        for _ in range(MAX_SWEEPS):
            moved = False
            for i, tracker in enumerate(self._trackers):
                if used[i] and not self._is_stale(i, used[i], poses):
                    continue
                moved = True
                used[i] = list(poses)
                result = tracker.track_picture(
                    state.objects[i],
                    self._explain(i, poses, picture),
                    hopes[i],
                    start=poses[i],
                    may_search=False,
                )
                results[i] = result
                poses[i] = None if result[0].lost else result[0].pose
            if not moved:
                break

        # What is not there is searched for among the pixels that no other object explains.
        for i, tracker in enumerate(self._trackers):
            before = results[i]
            if before is not None and not before[0].lost and not state.objects[i].hidden:
                continue
            result = tracker.track_picture(
                state.objects[i],
                self._explain(i, poses, picture),
                hopes[i],
                start=poses[i],
            )
            results[i] = result
            poses[i] = None if result[0].lost else result[0].pose
        found = [result for result in results if result is not None]
        return (
            SceneTrackerState(tuple(after for after, _ in found)),
            tuple(pose for _, pose in found),
        )

    def _make_refusal(
        self, missing: Sequence[int], frame: Frame, off_table: Mask
    ) -> PerceptionError:
        """Makes the error that says which objects are not found."""
        names = " and ".join(self.names[i] for i in missing)
        return PerceptionError(
            f"{names}: not found; expected {len(self)} objects in view, each of the outline that"
            " its file describes",
            draw_contours(self.camera.undistort(frame.color), off_table),
        )

    def _find_plainest(
        self,
        appearance: Appearance,
        picture: UndistortedPicture,
        missing: Sequence[int],
        poses: Sequence[Array | None],
        fraction: float,
    ) -> tuple[int, TrackerState] | None:
        """Finds that of some objects whose registration explains most of what is left.

        Args:
            appearance: what the table looks like.
            picture: the first picture.
            missing: numbers of the objects that are not found yet.
            poses: for each object (3,) its pose, or None where it is not found yet.
            fraction: least fraction of its visible outline that has to be found.

        Returns:
            Its number, and its state; None where none of them is there.
        """
        best: tuple[float, int, TrackerState] | None = None
        for i in missing:
            # Only pixels that no object explains yet are left for it.
            rest = self._explain(i, poses, picture)
            state = self._trackers[i].begin(appearance, rest, fraction=fraction)
            if state is None:
                continue
            # Of two outlines that fit, the larger one explains more.
            area = self._trackers[i].outline.area
            if best is None or area > best[0]:
                best = (area, i, state)
        return None if best is None else (best[1], best[2])

    def _is_stale(
        self, i: int, used: Sequence[Array | None], poses: Sequence[Array | None]
    ) -> bool:
        """Says whether a neighbor of object i has moved since poses were used for it."""
        mine = poses[i]
        for j, (before, now) in enumerate(zip(used, poses, strict=True)):
            if i == j or (before is None and now is None):
                continue
            # It was lost or found meanwhile.
            if before is None or now is None:
                return True
            # What is far away says nothing of this object, wherever it goes.
            if mine is not None and not self._are_near(i, j, mine, now):
                continue
            # The furthest that a point of its rim has moved.
            off = now - before
            turn = abs(wrap_angle(off[2])) * self._reach[j]
            if (np.hypot(*off[:2]) + turn) * self._pixels_a_meter > SETTLED_MOTION:
                return True
        return False

    def _are_near(self, i: int, j: int, mine: Array, other: Array) -> bool:
        """Says whether the silhouettes of two objects are near enough to disturb each other."""
        distance = (
            self._trackers[i]
            .make_silhouette(mine)
            .distance(self._trackers[j].make_silhouette(other))
        )
        return bool(distance * self._pixels_a_meter < NEIGHBOR_DISTANCE)

    def _explain(
        self, i: int, poses: Sequence[Array | None], picture: UndistortedPicture
    ) -> UndistortedPicture:
        """Marks the pixels of a picture that show another object than object i.

        Args:
            i: number of the object that is to be found.
            poses: for each object (3,) its pose, as far as it is known.
            picture: the picture.

        Returns:
            The picture with these pixels marked.
        """
        # Most objects are alone, or no other one is found yet.
        others = [pose for j, pose in enumerate(poses) if j != i and pose is not None]
        if not others:
            return picture

        # How far each pixel is from the nearest of the others' silhouettes, and from its own.
        size = (self.camera.height, self.camera.width)
        explained = np.zeros(size, dtype=np.uint8)
        for j, pose in enumerate(poses):
            if j != i and pose is not None:
                explained |= self._paint(j, pose)
        distance = cv2.distanceTransform(1 - explained, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        mine = poses[i]
        if mine is None:
            # Where it is not known where this object is, it may be as near as it likes.
            return picture._replace(explained=distance < OCCLUSION_MARGIN)
        own = cv2.distanceTransform(1 - self._paint(i, mine), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        return picture._replace(explained=distance < own + OCCLUSION_MARGIN)

    def _paint(self, i: int, pose: Array) -> NDArray[np.uint8]:
        """Paints the silhouette of object i at a pose (3,): (height, width), 1 where it is."""
        silhouette = self._trackers[i].make_silhouette(pose)
        # OpenCV fills between rings, so that holes stay open.
        rings = []
        for ring in (silhouette.exterior, *silhouette.interiors):
            corners = np.array(ring.coords)
            pixels = self._ideal.project(np.column_stack([corners, np.zeros(len(corners))]))
            rings.append(np.round(pixels * 2**FRACTION_BITS).astype(np.int32))
        painted = np.zeros((self.camera.height, self.camera.width), np.uint8)
        cv2.fillPoly(painted, rings, 1, cv2.LINE_8, FRACTION_BITS)
        return painted


def track_objects(
    tracker: SceneTracker,
    frames: Iterable[Frame],
    unseen: Callable[[Frame], Mask | None] | None = None,
) -> Iterator[tuple[Frame, tuple[TrackedPose, ...]]]:
    """Finds several objects in frame after frame.

    Args:
        tracker: tracker that knows the objects' outlines.
        frames: frames in order of time; the first shows all of the objects.
        unseen: function that says which pixels of a frame something covers; None where nothing is
            known to.

    Yields:
        Each frame, and what it told of each object.

    Raises:
        PerceptionError: as `SceneTracker.start`, of the first frame.
    """
    state = None
    for frame in frames:
        mask = None if unseen is None else unseen(frame)
        if state is None:
            state = tracker.start(frame, unseen=mask)
        state, tracked = tracker.track(state, frame, mask)
        yield frame, tracked
