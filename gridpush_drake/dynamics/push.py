"""A push and the times of its steps.

A push is the planar motion of a disc or of another rigid shape, or, as in the paper, a given force.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from math import ceil, cos, sin

import numpy as np
import shapely
from numpy.typing import ArrayLike
from shapely import MultiPolygon, Polygon

from gridpush_drake.dynamics.pusher import PusherShape
from gridpush_drake.errors import MAX_NUMBER, PushError, SimulationError, require_positive
from gridpush_drake.frozen import Frozen
from gridpush_drake.geometry.se2 import Array, IntArray, check_vector, rotate, transform
from gridpush_drake.objects.grid_object import GridObject

TURN_SAMPLE = 0.005
"""Largest angle between two samples of a push about a center, rad: the chord of an arc of radius
0.3 m is then 1 µm off it."""


START_TOLERANCE = 1e-4
"""How much farther from an outline than asked a shape may begin to push it, m."""


@dataclass(frozen=True, eq=False, init=False)
class Push(Frozen):
    """The motion of a pusher in the plane of the support, piecewise linear in time.

    `Push(start, velocity, duration, radius)` is that of a disc, straight at constant velocity;
    `Push.along` follows sampled points, and poses of another shape; `Push.on_outline` starts at a
    place on an object's outline; `Push.about` turns a shape about a center.

    Attributes:
        start: (2,) p_WP of the disc's center, or of the origin of the shape's frame, at the
            beginning, m, world frame.
        velocity: (2,) v_WP, m/s, world frame; for a sampled path, its mean.
        duration: s, positive.
        radius: m, positive: of the disc, or of the shape's round corners.
        t: (K,) sample times from the push's beginning, s, strictly increasing, `t[0] == 0`.
        xy: (K, 2) p_WP at those times, m.
        start_tangent: (2,) direction in W in which `start` moves as the contact's arc length on the
            outline grows, where the push was made by an outline location; None otherwise.
        shape: the pusher's shape; None of a disc.
        yaw: (K,) angle of the shape's frame at the sample times, rad; None of a disc.

    Raises:
        PushError: a value is not finite, radius or duration is not positive, or samples disagree
            with the rest.
    """

    start: Array
    velocity: Array
    duration: float
    radius: float
    t: Array = field(kw_only=True, repr=False)
    xy: Array = field(kw_only=True, repr=False)
    start_tangent: Array | None = field(kw_only=True, repr=False)
    shape: PusherShape | None = field(kw_only=True, repr=False)
    yaw: Array | None = field(kw_only=True, repr=False)

    def __init__(
        self,
        start: ArrayLike,
        velocity: ArrayLike,
        duration: float,
        radius: float,
        *,
        t: ArrayLike | None = None,
        xy: ArrayLike | None = None,
        start_tangent: ArrayLike | None = None,
        shape: PusherShape | None = None,
        yaw: ArrayLike | None = None,
    ) -> None:
        """Copies and checks what is given.

        Without samples `t` and `xy`, those of the straight motion are made.
        """
        begin = check_vector(PushError, "push: start", start, 2)
        v = check_vector(PushError, "push: velocity", velocity, 2)
        require_positive(PushError, "push: ", radius=radius, duration=duration)
        end = check_vector(
            PushError, "push: end, start + velocity * duration,", begin + v * duration, 2
        )
        times = np.array([0.0, duration] if t is None else t, dtype=np.float64)
        path = np.array([begin, end] if xy is None else xy, dtype=np.float64)
        if t is not None or xy is not None:
            _check_samples(times, path)
            if (
                times[0] != 0
                or times[-1] != duration
                or not np.allclose(path[[0, -1]], [begin, end])
            ):
                raise PushError(
                    "push: t and xy disagree with start, velocity or duration; "
                    "`Push.along` takes samples"
                )
        angles = None
        if shape is not None:
            if radius != shape.radius:
                raise PushError(f"push: radius is {radius!r}, but its shape's is {shape.radius!r}")
            angles = np.zeros(len(times)) if yaw is None else np.array(yaw, dtype=np.float64)
            if angles.ndim == 0:
                angles = np.full(len(times), angles)
            _check_yaw(times, angles)
        elif yaw is not None:
            raise PushError("push: yaw is given without a shape; expected both")
        values = {
            "start": begin,
            "velocity": v,
            "duration": float(duration),
            "radius": float(radius),
            "t": times,
            "xy": path,
            "start_tangent": None
            if start_tangent is None
            else check_vector(PushError, "push: start_tangent", start_tangent, 2),
            "shape": shape,
            "yaw": angles,
        }
        for name, value in values.items():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)
            object.__setattr__(self, name, value)

    @classmethod
    def along(
        cls,
        t: ArrayLike,
        xy: ArrayLike | Sequence[Sequence[float]],
        radius: float | None = None,
        *,
        shape: PusherShape | None = None,
        yaw: ArrayLike | None = None,
    ) -> "Push":
        """Makes a push along p_WP (K, 2), m, at times (K,), s.

        The times increase strictly; only their differences matter.

        Args:
            t: the times, s.
            xy: the places of the disc's center, or of the origin of the shape's frame, m.
            radius: of the disc, m; or else `shape`.
            shape: of a pusher that is no disc.
            yaw: (K,) angles of its frame, rad, or one for all times; zero by default.

        Raises:
            PushError: shapes disagree, a value is not finite, or time does not increase.
        """
        if (radius is None) == (shape is None):
            raise PushError("push: expected either radius or shape")
        if shape is not None:
            radius = shape.radius
        assert radius is not None
        times = np.array(t, dtype=np.float64)
        path = np.array(xy, dtype=np.float64)
        _check_samples(times, path)
        times -= times[0]
        return cls(
            path[0].copy(),
            (path[-1] - path[0]) / times[-1],
            float(times[-1]),
            radius,
            t=times,
            xy=path,
            shape=shape,
            yaw=yaw,
        )

    @classmethod
    def about(
        cls,
        center: ArrayLike,
        angle: float,
        *,
        shape: PusherShape,
        start: ArrayLike,
        yaw: float = 0.0,
        duration: float,
    ) -> "Push":
        """Makes a push that turns a shape about a center.

        Args:
            center: (2,) p_WC of the center of rotation, m.
            angle: by which it turns, rad, counterclockwise.
            shape: the pusher's.
            start: (2,) where the origin of its frame is at the beginning, m.
            yaw: angle of its frame at the beginning, rad.
            duration: s.

        Raises:
            PushError: a value is out of range.
        """
        about = check_vector(PushError, "push: center", center, 2)
        ray = check_vector(PushError, "push: start", start, 2) - about
        if not (np.isfinite([angle, yaw]).all() and angle != 0):
            raise PushError("push: angle and yaw must be finite numbers, and angle not zero (rad)")
        turned = np.linspace(0.0, angle, max(2, ceil(abs(angle) / TURN_SAMPLE) + 1))
        return cls.along(
            np.linspace(0.0, duration, len(turned)),
            about + rotate(turned, ray),
            shape=shape,
            yaw=yaw + turned,
        )

    @classmethod
    def on_outline(
        cls,
        obj: GridObject,
        arc_length: float,
        angle: float,
        distance: float,
        *,
        radius: float,
        shape: PusherShape | None = None,
        duration: float | None = None,
        speed: float | None = None,
        pose: ArrayLike = (0.0, 0.0, 0.0),
        clearance: float = 0.0,
    ) -> "Push":
        """Makes a straight push that starts on an object's outline.

        Args:
            arc_length: where on the exterior outline, m from its first vertex, counterclockwise,
                modulo the perimeter.
            angle: of the motion from the inward normal there, rad, counterclockwise.
            distance: to move, m.
            radius: of the disc, or of the shape's round corners, m.
            shape: of a pusher that is no disc; None of a disc. Its x axis points where it moves,
                and its origin moves towards the place on the outline.
            duration: s; or else `speed`, m/s.
            pose: (3,) X_WB of the object, m and rad.
            clearance: gap between pusher and outline at the beginning, m; that of a shape is up to
                `START_TOLERANCE` wider.

        Returns:
            The push. Its `start_tangent` is that of the edge; so `Jacobian.contact_location` is the
            derivative by `arc_length` with the motion's direction held fixed, and at a vertex the
            one towards the edge that begins there.

        Raises:
            PushError: not one of duration and speed is given, or a value is out of range.
        """
        q = check_vector(PushError, "push: pose", pose, 3)
        if (duration is None) == (speed is None):
            raise PushError("push: expected either duration or speed")
        require_positive(PushError, "push: ", distance=distance, radius=radius)
        if not (np.isfinite([arc_length, angle]).all() and 0 <= clearance < np.inf):
            raise PushError("push: arc_length and angle must be finite, and clearance >= 0")
        if duration is None:
            assert speed is not None
            require_positive(PushError, "push: ", speed=speed)
            duration = distance / speed
        require_positive(PushError, "push: ", duration=duration)
        point, tangent, normal = obj.edges.at(arc_length)
        if shape is not None:
            heading = float(np.arctan2(-normal[1], -normal[0]) + angle)
            begin = find_clear_start(obj, shape, point, heading, clearance)
            start = transform(q, begin[None])[0]
            yaw = float(q[2] + heading)
            velocity = distance / duration * np.array([cos(yaw), sin(yaw)])
            return cls(start, velocity, duration, radius, shape=shape, yaw=yaw)
        # In plain numbers, for arrays of two take longer: planning makes thousands of pushes.
        x, y, theta = q.tolist()
        px, py = (point + (radius + clearance) * normal).tolist()
        nx, ny = normal.tolist()
        tx, ty = tangent.tolist()
        c = cos(theta)
        s = sin(theta)
        # the inward normal, turned by the angle, and by the object's heading
        turned_c = cos(theta + angle)
        turned_s = sin(theta + angle)
        speed = distance / duration
        return cls(
            (x + c * px - s * py, y + s * px + c * py),
            (-speed * (turned_c * nx - turned_s * ny), -speed * (turned_s * nx + turned_c * ny)),
            duration,
            radius,
            start_tangent=(c * tx - s * ty, s * tx + c * ty),
        )

    @cached_property
    def length(self) -> float:
        """Length of the path, m."""
        return float(np.linalg.norm(np.diff(self.xy, axis=0), axis=1).sum())

    @cached_property
    def piece_lengths(self) -> Array:
        """How far the pusher goes between samples, (K-1,) m.

        A shape that turns goes as far as the path of its origin and of its farthest point say, at
        right angles to each other.
        """
        lengths = np.linalg.norm(np.diff(self.xy, axis=0), axis=1)
        if self.yaw is None or self.shape is None:
            return lengths
        return np.hypot(lengths, self.shape.reach * np.diff(self.yaw))

    def cut(self, times: ArrayLike) -> "Push":
        """Takes the part of the push that goes through the places at times (K,), s."""
        if self.shape is None:
            return Push.along(times, self.tip_at(times), self.radius)
        yaw = self.yaw_at(times)
        return Push.along(times, self.tip_at(times), shape=self.shape, yaw=yaw)

    def shorten(self, duration: float) -> "Push":
        """Makes the beginning of a straight push at constant velocity, of a duration, s."""
        if self.shape is not None:
            return self.cut([0.0, duration])
        return Push(
            start=self.start,
            velocity=self.velocity,
            duration=duration,
            radius=self.radius,
            start_tangent=self.start_tangent,
        )

    def yaw_at(self, times: ArrayLike) -> Array:
        """Interpolates the yaw, (K,) rad, at times (K,), s from the beginning; zero of a disc."""
        times = np.asarray(times, dtype=np.float64)
        if self.yaw is None:
            return np.zeros(times.shape)
        return np.interp(times, self.t, self.yaw)

    def tip_at(self, times: ArrayLike) -> Array:
        """Interpolates p_WP of the disc's center, (K, 2) m, at times (K,), s from the beginning.

        Before the beginning and after the end the disc stays where it is.
        """
        times = np.asarray(times, dtype=np.float64)
        return np.column_stack([np.interp(times, self.t, self.xy[:, axis]) for axis in (0, 1)])

    def find_area(self, time: float) -> Polygon | MultiPolygon:
        """Finds what the pusher covers at a time, s from the beginning; world frame, m."""
        tip = self.tip_at([time])[0]
        if self.shape is None:
            return PusherShape.disc(self.radius).at([*tip, 0.0])
        return self.shape.at([*tip, self.yaw_at([time])[0]])

    def distance_at(self, times: ArrayLike) -> Array:
        """Calculates how far the pusher has gone along its path, (K,) m, at times (K,), s."""
        gone = np.append(0.0, np.cumsum(self.piece_lengths))
        return np.interp(np.asarray(times, dtype=np.float64), self.t, gone)


def find_clear_start(
    obj: GridObject,
    shape: PusherShape,
    point: Array,
    heading: float,
    clearance: float,
    tolerance: float = START_TOLERANCE,
) -> Array:
    """Finds where a shape begins that comes straight towards a place on an outline, from afar.

    As long as it is farther than `clearance` from the outline, it may go on by the difference.

    Args:
        obj: the object.
        shape: the pusher's; its x axis points where it moves.
        point: (2,) the place, body frame, m.
        heading: direction of the motion in the body frame, rad.
        clearance: gap at the beginning, m.
        tolerance: how much wider the gap may be, m.

    Returns:
        (2,) the origin of the shape's frame, body frame, m.
    """
    ahead = np.array([cos(heading), sin(heading)])
    core = rotate(heading, shape.core)
    reach = shape.reach + clearance
    # From farther away than the object is large, so that nothing lies behind the shape.
    x0, y0, x1, y1 = obj.outline.bounds
    at = point - (np.hypot(x1 - x0, y1 - y0) + 2 * reach) * ahead
    # The outline cannot be nearer ahead than it is in any direction.
    while True:
        points = shapely.multipoints(core + at)
        gap = obj.outline.distance(points.convex_hull if shape.joined else points)
        gap -= shape.radius + clearance
        if gap <= tolerance:
            return at
        at = at + gap * ahead


def _check_samples(times: Array, path: Array) -> None:
    """Raises PushError for samples of a path that are not (K,) increasing times, (K, 2) places."""
    if times.ndim != 1 or len(times) < 2 or path.shape != (len(times), 2):
        raise PushError(
            f"push: t of shape {times.shape} and xy of shape {path.shape}; "
            "expected (K,) and (K, 2), K >= 2"
        )
    if not all((np.abs(values) <= MAX_NUMBER).all() for values in (times, path)):
        raise PushError(f"push: t and xy must be finite numbers, at most {MAX_NUMBER:g}")
    if np.any(np.diff(times) <= 0):
        first = int(np.argmax(np.diff(times) <= 0)) + 1
        raise PushError(f"push: t must be strictly increasing; t[{first}] is not")


def _check_yaw(times: Array, yaw: Array) -> None:
    """Raises PushError for angles that are not (K,) finite numbers."""
    if yaw.shape != times.shape:
        raise PushError(f"push: yaw of shape {yaw.shape}; expected ({len(times)},)")
    if not (np.abs(yaw) <= MAX_NUMBER).all():
        raise PushError(f"push: yaw must be finite numbers, at most {MAX_NUMBER:g} (rad)")


@dataclass(frozen=True, eq=False)
class ForcePush(Frozen):
    """A force in W applied at a point of the object, piecewise constant in time.

    Attributes:
        point: (2,) p_BP where it acts, m, body frame.
        force: (2,) or (K, 2) N, world frame; the k-th acts from t[k] to t[k+1].
        duration: s, positive.
        t: (K,) times at which each force begins, s, strictly increasing from 0; not needed for one
            force.

    Raises:
        PushError: shapes disagree or a value is out of range.
    """

    point: Array
    force: Array
    duration: float
    t: Array = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        point = np.array(self.point, dtype=np.float64)
        force = np.atleast_2d(np.array(self.force, dtype=np.float64))
        t = np.zeros(1) if self.t is None else np.array(self.t, dtype=np.float64)
        if point.shape != (2,) or force.shape != (len(t), 2):
            raise PushError(
                f"force push: point of shape {point.shape}, force of shape {force.shape}, "
                f"{len(t)} times; "
                "expected (2,), (K, 2) and K"
            )
        if not (np.isfinite(point).all() and np.isfinite(force).all() and np.isfinite(t).all()):
            raise PushError("force push: point, force and t must be finite numbers")
        if t[0] != 0 or (np.diff(t) <= 0).any():
            raise PushError("force push: t must begin at 0 and strictly increase")
        require_positive(PushError, "force push: ", "s", duration=self.duration)
        for name, value in (("point", point), ("force", force), ("t", t)):
            value.setflags(write=False)
            object.__setattr__(self, name, value)

    def force_during(self, times: Array) -> Array:
        """Looks up the force at the beginning of each of the T steps between `times` (T+1,).

        Returns:
            (T, 2), N, world frame.
        """
        index = np.searchsorted(self.t, times[:-1], side="right") - 1
        return self.force[np.maximum(index, 0)]


DEFAULT_DT = 0.01
"""Longest step if none is given, s."""

DEFAULT_TIP_STEP = 0.001
"""Farthest that the pusher moves in a step if none is given, m."""

MAX_STEPS = 1_000_000
"""Most steps of a simulation, each of which is kept: 1 km of the pusher's path by default."""

SAME_TIME = 1e-9
"""Two times of a push are one if they differ by less than this fraction of its duration."""

SHORT_STEP = 0.01
"""Fraction of the mean step below which a step is avoided: a rounding error of a place, divided by
so short a time, would be a speed."""

DURATION_SLACK = 1e-9
"""Fraction of a step by which a duration may exceed a whole number of steps."""


def make_times(push: Push | ForcePush, dt: float | None, regime: str) -> Array:
    """Cuts a push into steps of dt, s, the last one shortened to end with the push.

    Without dt, the default steps are taken.

    Returns:
        (T+1,) s from the push's beginning.

    Raises:
        SimulationError: dt is not positive, or so short that there are more than MAX_STEPS.
    """
    if dt is not None:
        require_positive(SimulationError, unit="s", dt=dt)
        steps = _count_steps(push.duration / dt)
        return np.append(np.arange(steps) * dt, push.duration)
    if isinstance(push, ForcePush):
        return np.linspace(0.0, push.duration, _count_steps(push.duration / DEFAULT_DT) + 1)
    return make_path_times(push, regime)


def make_path_times(
    push: Push,
    regime: str,
    tip_step: float = DEFAULT_TIP_STEP,
    longest: float = DEFAULT_DT,
) -> Array:
    """Cuts a push's path into the default steps: (T+1,), s from its beginning.

    "inertial": every piece of the path, whose samples are among the times, is cut into the longest
    steps allowed, `longest` (s) and `tip_step` (m of the pusher), so that they do not jump with the
    piece's length and speed; the last two, half a step to a whole one each, share what is left.
    Samples less than a short step apart are taken for one. "quasi_static": the path's length is cut
    evenly, whatever its pieces and however long they last, for time does not matter.

    Raises:
        SimulationError: they are more than MAX_STEPS.
    """
    distance = push.piece_lengths
    if regime == "quasi_static":
        arc = np.append(0.0, np.cumsum(distance))
        count = _count_steps(arc[-1] / tip_step)
        cuts = np.interp(arc[-1] * np.arange(1, count) / count, arc, push.t)
        return np.unique(np.concatenate([[0.0], cuts, [push.duration]]))
    wanted = np.maximum(distance / tip_step, np.diff(push.t) / longest)
    _count_steps(float(np.maximum(wanted, 1.0).sum()))
    pieces = [
        push.t[i] + (push.t[i + 1] - push.t[i]) * _cut(parts) for i, parts in enumerate(wanted)
    ]
    times = np.append(np.concatenate(pieces), push.t[-1])
    return _merge(times, SHORT_STEP * push.duration / (len(times) - 1))


def _merge(times: Array, shortest: float) -> Array:
    """Leaves out times (T+1,), s, that are less than `shortest` after another or before the end."""
    if (np.diff(times) >= shortest).all():
        return times
    kept = [float(times[0])]
    for t in times[1:-1].tolist():
        if min(t - kept[-1], times[-1] - t) >= shortest:
            kept.append(t)
    return np.array([*kept, times[-1]])


def _count_steps(steps: float) -> int:
    """Rounds up to a whole number of steps. Raises SimulationError if they are too many."""
    if not steps <= MAX_STEPS:
        raise SimulationError(
            f"the push takes {steps:.3g} steps; expected at most {MAX_STEPS}: "
            "a shorter path or time (in m and s), or longer steps"
        )
    return max(1, ceil(steps - DURATION_SLACK))


def _cut(parts: float) -> Array:
    """Cuts 1 into steps of 1/parts, of which the last two share what is left.

    Returns:
        Where each begins.
    """
    count = _count_steps(parts)
    if parts > count - DURATION_SLACK:
        return np.arange(count) / count
    starts = np.arange(count) / parts
    if count > 1:
        starts[-1] = (starts[-2] + 1.0) / 2
    return starts


def make_times_with(push: Push, wanted: Array, regime: str) -> Array:
    """Cuts a push into the default steps, and at further times.

    Args:
        push: the push.
        wanted: (K,) increasing times after its beginning, s. The default ones so near them that the
            step between would be a short one are left out.
        regime: "inertial" or "quasi_static".

    Returns:
        All times, increasing, s. In the inertial regime, wanted ones less than a short step apart
        are taken for one.
    """
    path = make_path_times(push, regime)
    place, near = (
        (path, wanted)
        if regime == "inertial"
        else (push.distance_at(path), push.distance_at(wanted))
    )
    before = np.append(-np.inf, near)
    after = np.append(near, np.inf)
    at = np.searchsorted(near, place)
    shortest = SHORT_STEP * float(place[-1]) / (len(path) - 1)
    repeated = np.minimum(place - before[at], after[at] - place) < shortest
    repeated[0] = False
    times = np.union1d(path[~repeated], wanted)
    return _merge(times, shortest) if regime == "inertial" else times


def measure_steps(push: Push | ForcePush, times: Array, regime: str) -> Array:
    """Measures the steps between `times` (T+1,): (T,) s, or m of the pusher's path.

    It is the path where nothing has inertia.

    There time does not matter, and what a step expects of the one before must not depend on it.
    Steps in which the pusher all but stands still count as short ones.
    """
    if regime == "inertial" or isinstance(push, ForcePush):
        return np.diff(times)
    steps = np.diff(push.distance_at(times))
    return np.maximum(steps, SHORT_STEP * steps.mean()) if steps.any() else np.diff(times)


def check_times(times: ArrayLike, inertial: bool) -> Array:
    """Copies the steps' times that a caller gives, (T+1,), s.

    Raises:
        SimulationError: they are not finite or not strictly increasing, or two are all but the same
            where the object has inertia.
    """
    times = np.array(times, dtype=np.float64)
    if (
        times.ndim != 1
        or len(times) < 2
        or not np.isfinite(times).all()
        or (np.diff(times) <= 0).any()
    ):
        raise SimulationError(
            "times: expected at least two finite, strictly increasing numbers (s)"
        )
    shortest = SAME_TIME * float(times[-1] - times[0])
    if inertial and (np.diff(times) < shortest).any():
        raise SimulationError(
            f"times: two are all but the same; expected steps of at least {shortest:.3g} s"
        )
    return times


def check_record(record: ArrayLike, steps: int) -> IntArray:
    """Copies the indices of the poses whose Jacobian is wanted, out of steps + 1.

    Negative ones count from the end.

    Raises SimulationError where they are not whole numbers in that range that name each pose once
    at most.
    """
    rows = np.array(record)
    whole = rows.ndim == 1 and (len(rows) == 0 or np.issubdtype(rows.dtype, np.integer))
    if not whole or (rows < -(steps + 1)).any() or (rows > steps).any():
        raise SimulationError(f"record: expected whole numbers from {-(steps + 1)} to {steps}")
    rows = rows.astype(np.int64)
    rows[rows < 0] += steps + 1
    if len(np.unique(rows)) != len(rows):
        raise SimulationError("record: names a pose twice; expected distinct indices")
    return rows
