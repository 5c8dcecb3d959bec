"""`PushExecutor`: makes desired poses of the finger's tip from push commands.

In a push the tip goes over the object, down beside it, along, pauses, and goes up again. How the
arm follows is not decided here; but a path that it cannot follow is refused.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
import shapely
from numpy.typing import ArrayLike
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context

from gridpush_drake.dynamics.pusher import DEFAULT_PUSHER_RADIUS, PusherShape
from gridpush_drake.frozen import Unchanging
from gridpush_drake.geometry.se2 import Array, transform_shape
from gridpush_drake.multibody.tool_motion import (
    TrajectorySegment,
    calc_tool_pose,
    make_transform,
)
from gridpush_drake.multibody.weak_calc import NO_SLOTS, weakly
from gridpush_drake.systems.base.messages import (
    PUSH_COMMAND_SIZE,
    GraspStatus,
    PressStatus,
    PushCommand,
    PushPhase,
    PushStatus,
    SteerStatus,
)
from gridpush_drake.systems.base.object_controller import AbstractStateSystem

Place = tuple[float, ...]
"""`Point` of the tip; or `ToolPose` of a tool that is turned to where it pushes."""


@dataclass(frozen=True)
class PushTrajectoryOptions:
    """How pushes are carried out.

    Attributes:
        travel_height: height of the tip's center while it passes over the object, m.
        push_height: height of the tip's center while it pushes, m.
        travel_speed: speed of the tip while it passes over the object, m/s.
        vertical_speed: speed of the tip while it goes down or up, m/s.
        travel_acceleration: greatest acceleration before and after the push, m/s².
        push_acceleration: greatest acceleration in the push, m/s².
        max_push_speed: a faster push is refused, m/s.
        settle_time: time that the tip stays at the end of the push, s.
        tip_radius: radius of the tip, m.
        shape: of a pusher that is no disc, in place of the radius; None of a disc. It looks the
            same from both sides, and is turned to where it pushes (`find_tool_yaw`).
        clearance: least gap between tip and object where a push starts, m.
        period: time between two updates of the state, s.
    """

    travel_height: float = 0.12
    push_height: float = 0.012
    travel_speed: float = 0.3
    vertical_speed: float = 0.15
    travel_acceleration: float = 1.0
    push_acceleration: float = 0.5
    max_push_speed: float = 0.2
    settle_time: float = 0.3
    tip_radius: float = DEFAULT_PUSHER_RADIUS
    clearance: float = 0.0
    period: float = 0.005
    shape: PusherShape | None = None


def make_push_trajectory(
    command: PushCommand, rest: ArrayLike, style: PushTrajectoryOptions, speed_scale: float = 1.0
) -> tuple[TrajectorySegment, ...]:
    """Makes the trajectory of a push: up if need be, over, down, along, pause, up.

    Args:
        command: the push.
        rest: (3,) p_WP of the tip, which is at rest, m; (4,) with the tool's yaw, rad, where it is
            turned to where it pushes.
        style: heights, speeds and times.
        speed_scale: factor of the speeds before and after the push.

    Returns:
        The segments; the last one ends above the push's end.
    """
    x, y, z, *yaw = np.asarray(rest, float).tolist()
    turned = [find_tool_yaw(command.direction)] if yaw else []
    x0, y0 = command.start.tolist()
    x1, y1 = command.end.tolist()
    high = style.travel_height
    low = style.push_height
    # Top speed and acceleration, as `TrajectorySegment` takes them.
    travel = (speed_scale * style.travel_speed, style.travel_acceleration)
    vertical = (speed_scale * style.vertical_speed, style.travel_acceleration)
    segments = []
    if z < high:
        segments.append(
            TrajectorySegment(PushPhase.APPROACHING, (x, y, z, *yaw), (x, y, high, *yaw), *vertical)
        )
        z = high
    above = (x0, y0, high, *turned)
    begin = (x0, y0, low, *turned)
    end = (x1, y1, low, *turned)
    push = (command.speed, style.push_acceleration)
    segments += [
        TrajectorySegment(PushPhase.APPROACHING, (x, y, z, *yaw), above, *travel),
        TrajectorySegment(PushPhase.DESCENDING, above, begin, *vertical),
        TrajectorySegment(PushPhase.PUSHING, begin, end, *push),
        TrajectorySegment(PushPhase.SETTLING, end, end, wait=style.settle_time),
        TrajectorySegment(PushPhase.RETRACTING, end, (x1, y1, high, *turned), *vertical),
    ]
    return tuple(segments)


def find_tool_yaw(direction: float, period: float = np.pi) -> float:
    """Finds the tool's smallest yaw, rad, with which a shape pushes in a direction, rad.

    Args:
        direction: the direction, rad.
        period: angle after which the shape looks the same, rad; half a turn of a gripper.
    """
    half = period / 2
    return float((direction + half) % period - half)


def make_lookout_trajectory(
    rest: Place, lookout: Place, style: PushTrajectoryOptions, speed_scale: float = 1.0
) -> tuple[TrajectorySegment, ...]:
    """Makes the way from rest to a lookout: up to the higher of both, over, and to the lookout."""
    x, y, z, *yaw = rest
    x1, y1, z1, *yaw1 = lookout
    high = max(z, z1, style.travel_height)
    places = [rest, (x, y, high, *yaw), (x1, y1, high, *yaw1), lookout]
    travel = (speed_scale * style.travel_speed, style.travel_acceleration)
    return tuple(
        TrajectorySegment(PushPhase.CLEARING, start, end, *travel)
        for start, end in pairwise(places)
        if start != end
    )


def break_off(segments: tuple[TrajectorySegment, ...], t: float) -> tuple[TrajectorySegment, ...]:
    """Shortens a push that is to stop as soon as it can; the pause and the way up are kept.

    Args:
        segments: the segments still to come, of which the first is under way.
        t: time since the first one began, s.

    Returns:
        The segments; as they were if the push itself is over.
    """
    phases = [segment.phase for segment in segments]
    if PushPhase.PUSHING not in phases:
        return segments
    i = phases.index(PushPhase.PUSHING)
    push = segments[i].stop_from(t if i == 0 else 0.0)
    if push.end == segments[i].end:
        return segments
    x, y, _, *yaw = push.end
    after = [
        replace(segment, start=(x, y, segment.start[2], *yaw), end=(x, y, segment.end[2], *yaw))
        for segment in segments[i + 1 :]
    ]
    return (*segments[:i], push, *after)


Reach = Callable[..., str | None]
"""A function that says why the arm cannot follow a path of the tip, (k, 3) in W, m, at speeds (k -
1,) on its pieces, m/s; None if it can. If the tool turns, its yaws (k,), rad, come third."""

SPEED_SCALES = (1.0, 0.5, 0.25)
"""Factors of the traveling speeds, tried in turn until the arm can follow. The joints of an arm
that is stretched turn fast."""


@dataclass(frozen=True)
class ExecutorState(Unchanging):
    """All that the executor remembers.

    Attributes:
        rest: where the tip stays while there is nothing to do.
        segments: the current segment and those still to come.
        segment_start: time at which the current segment began, s.
        status: the status on the port, but for the reason while a command's id is not finite.
        unseen_since: time since which the object has been out of sight with the tip at rest, s;
            None if it is seen.
        lookouts: number of lookouts to which the tip went since the object was last seen.
        unreadable: whether the id of the command on the port is not finite.
    """

    rest: Place
    segments: tuple[TrajectorySegment, ...] = ()
    segment_start: float = 0.0
    status: PushStatus = field(default_factory=PushStatus)
    unseen_since: float | None = None
    lookouts: int = 0
    unreadable: bool = False

    @property
    def shown_status(self) -> PushStatus:
        """The status on the port."""
        return replace(self.status, reason=UNREADABLE_ID) if self.unreadable else self.status

    def position(self, time: float) -> Array:
        """Calculates the desired position p_WP (3,) at a time, s, in m; with the yaw, if any."""
        if not self.segments:
            return np.array(self.rest)
        return self.segments[0].position(time - self.segment_start)


HIDDEN_AFTER = 0.3
"""If the object is out of sight for this long, the tip goes to a lookout, s."""

LOOK_FOR = 1.0
"""If the object is not seen from a lookout for this long, the tip goes to the next one, s."""

NOT_FINITE = "the command has numbers that are not finite"
"""Reason for which a command is refused."""

UNREADABLE_ID = "the command's id is not finite"
"""Reason in the status while a command has no usable id."""


class PushExecutor(AbstractStateSystem[ExecutorState]):
    """Carries out straight pushes: over the object, down beside it, along, a pause, and up again.

    A command is taken up when the executor is idle and the command's id differs from the last
    one's. It is refused, with the reason in the status, if its numbers are not finite or not
    usable, if the tip would start in the object or touch it, or if the arm cannot follow. A command
    whose id is not finite counts as refused once; the status says so until there is another
    command. If a command is withdrawn, by another one with id 0, the push is broken off: the finger
    stops as soon as it can, and goes up. Desired position and velocity are continuous, and so is
    the acceleration.

    If the object has been out of sight for a while and nothing is to be done, the arm may be what
    hides it. Then the finger goes to its lookouts, one after the other, until the object is seen,
    to each of them once.

    .. pydrake_system::

        name: PushExecutor
        input_ports:
        - push_command
        - object_pose
        - grasp_status
        - press_status
        - steer_status
        output_ports:
        - tip_pose
        - status

    * push_command: vector of 6, command_id, x, y (m), direction (rad), distance (m) and speed
      (m/s), see `PushCommand`.
    * object_pose: vector of 3, observed X_WB, (x, y, theta), m and rad. It is read when a command
      is taken up; while it is NaN, for the object is not seen, the command waits. It need not be
      connected if the executor has no outline.
    * grasp_status: abstract `GraspStatus`; while a grasp is under way the tip goes to no lookout.
      It need not be connected.
    * press_status: abstract `PressStatus`; while a press is under way the tip goes to no lookout,
      either. It need not be connected.
    * steer_status: abstract `SteerStatus`; while the finger is steered the tip goes to no lookout.
      It need not be connected.
    * tip_pose: abstract `RigidTransform`, desired X_WP, m, with P at the tip's center and its z
      axis pointing down.
    * status: abstract `PushStatus`, how the executor stands.

    Abstract state: one `ExecutorState`.
    """

    __slots__ = NO_SLOTS

    def __init__(
        self,
        home: ArrayLike,
        outline: shapely.Polygon | None = None,
        reach: Reach | None = None,
        style: PushTrajectoryOptions | None = None,
        lookouts: ArrayLike = (),
    ):
        """Makes an executor.

        Args:
            home: (3,) p_WP of the tip at the beginning, m; and where it goes if the arm cannot go
                straight to a push.
            outline: outline of the object in B, m; None to push without looking at an object.
            reach: says why the arm cannot follow a path; None if it always can.
            style: heights, speeds and times.
            lookouts: (n, 3) p_WP to which the tip goes, in this order, when the object is out of
                sight, m. Those that the arm cannot reach are left out.
        """
        self.style = style or PushTrajectoryOptions()
        # A tool that is turned to where it pushes has a yaw of 0 at home and at lookouts.
        yaw = () if self.style.shape is None else (0.0,)
        x, y, z = np.asarray(home, float).tolist()
        self.home: Place = (x, y, z, *yaw)
        super().__init__(ExecutorState(self.home), self.style.period)
        self._outline = outline
        self._reach = reach
        self._lookouts: list[Place] = [
            (x, y, z, *yaw) for x, y, z in np.asarray(lookouts, float).reshape(-1, 3).tolist()
        ]
        self._command_port = self.DeclareVectorInputPort("push_command", PUSH_COMMAND_SIZE)
        self._pose_port = self.DeclareVectorInputPort("object_pose", 3)
        self._grasp_port = self.DeclareAbstractInputPort(
            "grasp_status", AbstractValue.Make(GraspStatus())
        )
        self._press_port = self.DeclareAbstractInputPort(
            "press_status", AbstractValue.Make(PressStatus())
        )
        self._steer_port = self.DeclareAbstractInputPort(
            "steer_status", AbstractValue.Make(SteerStatus())
        )
        self.DeclareAbstractOutputPort(
            "tip_pose",
            lambda: AbstractValue.Make(RigidTransform()),
            weakly(self._calc_tip_pose),
            {self.time_ticket(), self._remembered},
        )
        self._declare_value("status", lambda now: now.shown_status)

    def SetRest(self, root_context: Context, X_WP: RigidTransform) -> None:
        """Sets where the tip begins instead of at home.

        Args:
            root_context: a fresh Context of the Diagram that the executor is part of.
            X_WP: pose of the tip, whose tool points down.
        """
        rest = calc_tool_pose(X_WP)[: len(self.home)]
        context = self.GetMyMutableContextFromRoot(root_context)
        context.SetAbstractState(int(self._state), ExecutorState(rest))

    def _calc_tip_pose(self, context: Context, output: AbstractValue) -> None:
        state = self._get_state(context)
        output.set_value(make_transform(state.position(context.get_time())))

    def _go_on(self, context: Context, now: ExecutorState) -> ExecutorState:
        """Goes on to the next segment; or breaks off, takes up or refuses a command."""
        time = context.get_time()
        if now.segments:
            return self._follow(context, now, time)
        return self._take_up(context, now, time)

    def _follow(self, context: Context, now: ExecutorState, time: float) -> ExecutorState:
        """Goes on with the segments; the last segment of a push counts it as executed."""
        if self._command_port.Eval(context)[0] == 0:
            segments = break_off(now.segments, time - now.segment_start)
            now = now if segments == now.segments else replace(now, segments=segments)
        done, *left = now.segments
        if time - now.segment_start < done.duration:
            return now
        phase = PushPhase(left[0].phase) if left else PushPhase.IDLE
        executed = now.status.executed + (not left and done.phase != PushPhase.CLEARING)
        status = replace(now.status, phase=phase, executed=executed)
        return replace(now, rest=done.end, segments=tuple(left), segment_start=time, status=status)

    def _take_up(self, context: Context, now: ExecutorState, time: float) -> ExecutorState:
        """Takes up or refuses a new command; without one it may go to a lookout."""
        vector = self._command_port.Eval(context)
        unreadable = not np.isfinite(vector[0])
        if unreadable != now.unreadable:
            status = replace(now.status, refused=now.status.refused + unreadable)
            now = replace(now, unreadable=unreadable, status=status)
        command = PushCommand.from_vector(vector)
        seen = self._outline is None or bool(np.isfinite(self._pose_port.Eval(context)).all())
        if command.command_id in (0, now.status.command_id) or not seen:
            return self._look_out(now, time, seen or self._is_elsewhere(context))
        segments, reason = self._plan(context, command, now.rest)
        status = replace(now.status, command_id=command.command_id, reason=reason)
        if reason:
            return replace(now, status=replace(status, refused=status.refused + 1))
        return ExecutorState(
            rest=now.rest,
            segments=segments,
            segment_start=time,
            status=replace(status, phase=PushPhase(segments[0].phase)),
        )

    def _is_elsewhere(self, context: Context) -> bool:
        """Returns whether others lead the tip: in a grasp, in a press, or while it is steered."""
        ports = (self._grasp_port, self._press_port, self._steer_port)
        return any(port.HasValue(context) and not port.Eval(context).ready for port in ports)

    def _look_out(self, now: ExecutorState, time: float, content: bool) -> ExecutorState:
        """Waits; and goes to the next lookout if the object has been out of sight for too long.

        Args:
            now: the state; nothing is to be done.
            time: time now, s.
            content: whether the object is seen, or need not be.
        """
        if content:
            if now.unseen_since is None and not now.lookouts:
                return now
            return replace(now, unseen_since=None, lookouts=0)
        since = time if now.unseen_since is None else now.unseen_since
        waited = time - since >= (LOOK_FOR if now.lookouts else HIDDEN_AFTER)
        if not waited or now.lookouts == len(self._lookouts):
            return now if now.unseen_since == since else replace(now, unseen_since=since)

        # The next lookout that the arm can reach; if there is none, none is tried again.
        segments: tuple[TrajectorySegment, ...] = ()
        for place in self._order_lookouts(now.rest):
            segments = plan_lookout(now.rest, place, self.style, self._reach)
            if segments:
                break
        if not segments:
            return replace(now, lookouts=len(self._lookouts), unseen_since=None)
        return replace(
            now,
            segments=segments,
            segment_start=time,
            status=replace(now.status, phase=PushPhase.CLEARING),
            lookouts=now.lookouts + 1,
            unseen_since=None,
        )

    def _order_lookouts(self, rest: Place) -> list[Place]:
        """Returns all lookouts, beginning with the one after `rest`.

        They are gone through in turn, even if the object was seen in between: what is seen on the
        way to a lookout may be hidden again from there.
        """
        i = self._lookouts.index(rest) + 1 if rest in self._lookouts else 0
        return self._lookouts[i:] + self._lookouts[:i]

    def _plan(
        self, context: Context, command: PushCommand, rest: Place
    ) -> tuple[tuple[TrajectorySegment, ...], str]:
        """Plans a command; returns its segments, and why it is refused, empty if it is not."""
        reason = self._find_fault(command)
        if reason is None and self._outline is not None:
            reason = self._find_overlap(command, self._pose_port.Eval(context))
        if reason is not None:
            return (), reason
        segments, reason = plan_push(command, rest, self.style, self._reach, self.home)
        return segments, reason or ""

    def _find_fault(self, command: PushCommand) -> str | None:
        """Says what is wrong with the numbers of a command; None if nothing is."""
        if not np.isfinite(command.to_vector()).all():
            return NOT_FINITE
        if command.distance <= 0.0:
            return f"distance {command.distance:.3g} m; expected a positive number"
        if not 0.0 < command.speed <= self.style.max_push_speed:
            return (
                f"speed {command.speed:.3g} m/s; "
                f"expected more than 0, at most {self.style.max_push_speed:.3g}"
            )
        return None

    def _find_overlap(self, command: PushCommand, pose: Array) -> str | None:
        """Says why the tip cannot start where it should, with the object at `pose` (3,)."""
        assert self._outline is not None
        outline_W = transform_shape(pose, self._outline)
        start = shapely.Point(command.start)
        where = f"({command.x:.3f}, {command.y:.3f}) m"
        shape = self.style.shape
        covered = start if shape is None else shape.at([*command.start, command.direction])
        if outline_W.contains(start) or (shape is not None and outline_W.overlaps(covered)):
            return f"the push would start inside the object, at {where}"
        gap = outline_W.distance(covered) - (self.style.tip_radius if shape is None else 0.0)
        if not gap >= self.style.clearance:
            return (
                f"the tip would start {gap:.4f} m from the object, at {where}; "
                f"expected {self.style.clearance:.4f}"
            )
        return None


def make_detour(
    command: PushCommand,
    rest: Place,
    home: Place,
    style: PushTrajectoryOptions,
    speed_scale: float,
) -> tuple[TrajectorySegment, ...]:
    """Makes the trajectory of a push to which the tip comes by its home; see `plan_push`."""
    way_home = make_lookout_trajectory(rest, home, style, speed_scale)
    approach = tuple(replace(segment, phase=PushPhase.APPROACHING) for segment in way_home)
    return approach + make_push_trajectory(command, home, style, speed_scale)


def plan_push(
    command: PushCommand,
    rest: Place,
    style: PushTrajectoryOptions,
    reach: Reach | None,
    home: Place | None = None,
) -> tuple[tuple[TrajectorySegment, ...], str | None]:
    """Plans the trajectory of a push, as fast as the arm can follow.

    Where the arm cannot follow from where it rests, it goes home first. A push is judged possible
    by planners if the arm can follow from its home; from elsewhere it may come to a place in
    another posture, at a joint's limit.

    Args:
        command: the push.
        rest: where the tip is at rest.
        style: heights, speeds and times.
        reach: says why the arm cannot follow a path; None if it always can.
        home: the tip's home, by which it may go, and to which it must be able to go afterwards;
            None where there is no such place.

    Returns:
        The segments, and None; or no segments, and why the arm cannot follow, or could not go home
        from where the push ends.
    """
    if reach is None:
        return make_push_trajectory(command, rest, style), None
    # Straight to the push, ever slower; or else by the home, likewise.
    ways = [make_push_trajectory(command, rest, style, scale) for scale in SPEED_SCALES]
    if home is not None and home != rest:
        ways += [make_detour(command, rest, home, style, scale) for scale in SPEED_SCALES]
    reasons = []
    for segments in ways:
        reason = _ask(reach, segments)
        if reason is None:
            break
        reasons.append(reason)
    else:
        # Why it cannot be done straight, at the least speed.
        return (), reasons[len(SPEED_SCALES) - 1]
    # From where this push ends the arm must be able to go home. Else it would be caught there: at a
    # joint's limit that it has just kept on another way, or stretched so far that its joints would
    # turn too fast.
    if home is not None:
        reason = _find_hitch(segments[-1].end, home, style, reach)
        if reason is not None:
            return (), reason
    return segments, None


def plan_lookout(
    rest: Place, lookout: Place, style: PushTrajectoryOptions, reach: Reach | None
) -> tuple[TrajectorySegment, ...]:
    """Plans the way to a lookout, as fast as the arm can follow; see `plan_push`.

    Returns:
        The segments; none if the tip is there already, or the arm cannot follow.
    """
    for speed_scale in SPEED_SCALES:
        segments = make_lookout_trajectory(rest, lookout, style, speed_scale)
        if reach is None or not segments or _ask(reach, segments) is None:
            return segments
    return ()


def _find_hitch(rest: Place, home: Place, style: PushTrajectoryOptions, reach: Reach) -> str | None:
    """Says why the arm cannot go home from a place, however slowly; None if it can."""
    reason = None
    for speed_scale in SPEED_SCALES:
        segments = make_lookout_trajectory(rest, home, style, speed_scale)
        reason = _ask(reach, segments) if segments else None
        if reason is None:
            return None
    return reason


def _ask(reach: Reach, segments: tuple[TrajectorySegment, ...]) -> str | None:
    """Asks why the arm cannot follow some segments; None if it can."""
    path = np.array([segments[0].start] + [segment.end for segment in segments])
    speeds = np.array([segment.top_speed for segment in segments])
    return reach(path[:, :3], speeds, path[:, 3]) if path.shape[1] > 3 else reach(path, speeds)
