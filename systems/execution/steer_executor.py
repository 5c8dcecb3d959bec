"""`SteerExecutor`: desired poses of the finger's tip for a finger that is steered by its velocity.

The finger goes over to the place where it is to come down, down, and then along the table with the
velocity that is commanded, until the command is withdrawn. Then it goes up and back to where the
executor of pushes has it. Who decides on the velocity is a controller, such as `FollowController`.
"""

from dataclasses import dataclass, field, replace

import numpy as np
import shapely
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context
from shapely.geometry.base import BaseGeometry

from gridpush_drake.frozen import Unchanging
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.multibody.tool_motion import TrajectorySegment, calc_tool_pose, make_transform
from gridpush_drake.multibody.weak_calc import NO_SLOTS, weakly
from gridpush_drake.systems.base.messages import (
    STEER_COMMAND_SIZE,
    PushStatus,
    SteerCommand,
    SteerPhase,
    SteerStatus,
)
from gridpush_drake.systems.base.object_controller import AbstractStateSystem
from gridpush_drake.systems.execution.push_executor import NOT_FINITE, SPEED_SCALES, Place, Reach

OUTSIDE_REGION = "the finger would leave the region in which it may be"
"""Reason for which the finger is held back, or a command is refused."""


@dataclass(frozen=True)
class SteerOptions:
    """How a finger is steered.

    Attributes:
        travel_height: height of the tip's center while it passes over the object, m.
        push_height: height of the tip's center while it is steered, m.
        travel_speed: speed of the tip while it passes over the object, m/s.
        vertical_speed: speed of the tip while it goes down or up, m/s.
        travel_acceleration: greatest acceleration on these ways, m/s².
        turns: whether the tool turns, too, as one whose pusher is no disc.
        max_speed: greatest speed while it is steered, m/s; a faster velocity is shortened.
        acceleration: greatest acceleration while it is steered, m/s².
        max_turning_speed: greatest speed at which the tool turns while it is steered, rad/s.
        turning_acceleration: greatest acceleration of that, rad/s².
        max_force: greatest force on the tip, N; beyond it the finger brakes hard, and goes up.
        hard_braking: the acceleration of that, m/s².
        period: time between two updates of the state, s.
    """

    travel_height: float = 0.12
    push_height: float = 0.012
    travel_speed: float = 0.3
    vertical_speed: float = 0.15
    travel_acceleration: float = 1.0
    turns: bool = False
    max_speed: float = 0.2
    acceleration: float = 1.0
    max_turning_speed: float = 1.0
    turning_acceleration: float = 10.0
    max_force: float = np.inf
    hard_braking: float = 2.0
    period: float = 0.005


@dataclass(frozen=True)
class SteerState(Unchanging):
    """All that the executor remembers.

    Attributes:
        segments: the way that is gone at present and those still to come; none while the finger is
            steered, and while there is nothing to do.
        segment_start: time at which the first of them began, s.
        place: (x, y) of the tip's center at `time`, while it is steered, m; (x, y, yaw) of a tool
            that turns, rad.
        velocity: of that from then on, m/s and rad/s.
        time: time of the last update while it is steered, s.
        pressed: why the finger brakes hard, a part of a sentence; empty if it does not.
        status: the status on the port.
    """

    segments: tuple[TrajectorySegment, ...] = ()
    segment_start: float = 0.0
    place: tuple[float, ...] = (0.0, 0.0)
    velocity: tuple[float, ...] = (0.0, 0.0)
    time: float = 0.0
    pressed: str = ""
    status: SteerStatus = field(default_factory=SteerStatus)


class SteerExecutor(AbstractStateSystem[SteerState]):
    """Lets a finger be steered along the table by its velocity.

    While nobody steers, the pose that the executor of pushes (or of grasps) desires is passed on.

    A command with a new id is taken up while the executor of pushes is idle. It is refused, with
    the reason in the status, if its numbers are not finite, if the place where the finger is to
    come down is outside the region, or if the arm cannot follow. Then the finger goes over to that
    place and down, and moves with the velocity on the port, within the greatest speed and
    acceleration. Where it would leave the region, it brakes, and the status says so; a velocity
    that is not finite counts as zero. With id 0 the finger brakes, goes up and back. It does so by
    itself, braking harder, if the force on the tip is too great; the status keeps the reason.
    Position and velocity are continuous.

    .. pydrake_system::

        name: SteerExecutor
        input_ports:
        - passed_tip_pose
        - push_status
        - steer_command
        - tip_force
        output_ports:
        - tip_pose
        - status

    * passed_tip_pose: abstract `RigidTransform`, X_WP that the other executors desire, m; it is at
      rest while those are idle.
    * push_status: abstract `PushStatus` of the executor of pushes.
    * steer_command: vector of 7, command_id, x, y (m), vx, vy (m/s), yaw (rad), yaw_rate (rad/s),
      see `SteerCommand`; the last two count if the tool turns. It need not be connected.
    * tip_force: vector of 3, force on the tip in W, N. It need not be connected.
    * tip_pose: abstract `RigidTransform`, desired X_WP, m.
    * status: abstract `SteerStatus`.

    Abstract state: one `SteerState`.
    """

    __slots__ = NO_SLOTS

    def __init__(
        self,
        region: BaseGeometry | None = None,
        reach: Reach | None = None,
        style: SteerOptions | None = None,
    ) -> None:
        """Makes an executor.

        Args:
            region: where the tip's center may be while the finger is down, W, m; None for anywhere.
            reach: says why the arm cannot follow a path; None if it always can.
            style: heights, speeds and accelerations.
        """
        self.style = style or SteerOptions()
        super().__init__(SteerState(), self.style.period)
        self._region = region
        if region is not None:
            shapely.prepare(region)
        self._reach = reach
        self._passed = self.DeclareAbstractInputPort(
            "passed_tip_pose", AbstractValue.Make(RigidTransform())
        )
        self._push_status = self.DeclareAbstractInputPort(
            "push_status", AbstractValue.Make(PushStatus())
        )
        self._command = self.DeclareVectorInputPort("steer_command", STEER_COMMAND_SIZE)
        self._tip_force = self.DeclareVectorInputPort("tip_force", 3)
        self.DeclareAbstractOutputPort(
            "tip_pose",
            lambda: AbstractValue.Make(RigidTransform()),
            weakly(self._calc_tip_pose),
            {self.time_ticket(), self._remembered, self._passed.ticket()},
        )
        self._declare_value("status", lambda now: now.status)

    def _calc_tip_pose(self, context: Context, output: AbstractValue) -> None:
        now = self._get_state(context)
        time = context.get_time()
        if now.segments:
            pose = now.segments[0].position(time - now.segment_start)
        elif now.status.phase == SteerPhase.STEERING:
            place = np.array(now.place) + (time - now.time) * np.array(now.velocity)
            pose = np.insert(place, 2, self.style.push_height)
        else:
            output.set_value(self._passed.Eval(context))
            return
        output.set_value(make_transform(pose))

    def _go_on(self, context: Context, now: SteerState) -> SteerState:
        """Goes on with a way or with steering, or takes up or refuses a command."""
        time = context.get_time()
        command, is_finite = self._read_command(context)
        if now.status.phase == SteerPhase.STEERING:
            return self._steer(context, now, time, command if is_finite else None)
        if now.segments:
            return self._follow(now, time)
        is_new = command.command_id not in (0, now.status.command_id)
        if not is_new or not self._push_status.Eval(context).ready:
            return now
        segments, reason = self._plan(context, command, is_finite)
        status = SteerStatus(command_id=command.command_id, refused=bool(reason), reason=reason)
        if not reason:
            status = replace(status, phase=SteerPhase(segments[0].phase))
        return replace(now, segments=segments, segment_start=time, status=status)

    def _read_command(self, context: Context) -> tuple[SteerCommand, bool]:
        """Reads the command on the port, and whether all its numbers are finite."""
        if not self._command.HasValue(context):
            return SteerCommand(), True
        vector = self._command.Eval(context)
        return SteerCommand.from_vector(vector), bool(np.isfinite(vector).all())

    def _plan(
        self, context: Context, command: SteerCommand, is_finite: bool
    ) -> tuple[tuple[TrajectorySegment, ...], str]:
        """Plans the way to where the finger comes down; says why it is refused, if it is."""
        if not is_finite:
            return (), NOT_FINITE
        place = shapely.Point(command.x, command.y)
        if self._region is not None and not self._region.covers(place):
            return (), f"({command.x:.3f}, {command.y:.3f}) m: {OUTSIDE_REGION}"
        # A stretched arm may follow the same way more slowly.
        rest = self._read_rest(context)
        reason: str | None = None
        for scale in SPEED_SCALES:
            segments = self._make_way_down(rest, command, scale)
            if self._reach is None:
                return segments, ""
            path = np.array([segments[0].start, *(segment.end for segment in segments)])
            speeds = np.array([segment.speed for segment in segments])
            turns = (path[:, 3],) if self.style.turns else ()
            reason = self._reach(path[:, :3], speeds, *turns)
            if reason is None:
                return segments, ""
        return (), reason or ""

    def _read_rest(self, context: Context) -> Place:
        """Reads where the other executors have the tip, with the yaw of a tool that turns."""
        X_WP: RigidTransform = self._passed.Eval(context)
        x, y, z, yaw = calc_tool_pose(X_WP)
        return (x, y, z, yaw) if self.style.turns else (x, y, z)

    def _make_way_down(
        self, rest: Place, command: SteerCommand, scale: float
    ) -> tuple[TrajectorySegment, ...]:
        """Makes the way up if need be, over, and down; the speeds are scaled."""
        style = self.style
        x, y, z, *yaw = rest
        turned = [command.yaw] if style.turns else []
        high = max(z, style.travel_height)
        acceleration = style.travel_acceleration
        travel = scale * style.travel_speed
        vertical = scale * style.vertical_speed
        above = (command.x, command.y, high, *turned)
        below = (command.x, command.y, style.push_height, *turned)
        ways = []
        if z < high:
            ways.append((SteerPhase.APPROACHING, rest, (x, y, high, *yaw), vertical))
        ways.append((SteerPhase.APPROACHING, (x, y, high, *yaw), above, travel))
        ways.append((SteerPhase.DESCENDING, above, below, vertical))
        return tuple(
            TrajectorySegment(phase, start, end, speed, acceleration)
            for phase, start, end, speed in ways
        )

    def _follow(self, now: SteerState, time: float) -> SteerState:
        """Goes on with the ways down or up."""
        done, *left = now.segments
        if time - now.segment_start < done.duration:
            return now
        x, y, _, *yaw = done.end
        if left:
            phase = SteerPhase(left[0].phase)
        elif done.phase == SteerPhase.DESCENDING:
            phase = SteerPhase.STEERING
        else:
            phase = SteerPhase.IDLE
        return replace(
            now,
            segments=tuple(left),
            segment_start=time,
            place=(x, y, *yaw),
            velocity=(0.0,) * (2 + len(yaw)),
            time=time,
            status=replace(now.status, phase=phase),
        )

    def _steer(
        self, context: Context, now: SteerState, time: float, command: SteerCommand | None
    ) -> SteerState:
        """Moves the finger on, towards the velocity of a command; None counts as zero."""
        style = self.style
        place = np.array(now.place) + (time - now.time) * np.array(now.velocity)
        velocity = np.array(now.velocity)
        # Whether steering ends: by another command, by none, or since the finger presses too hard.
        pressed = now.pressed or self._find_pressure(context)
        ends = bool(pressed) or (
            command is not None and command.command_id != now.status.command_id
        )
        if ends and not velocity.any():
            return self._go_up(context, replace(now, pressed=pressed), time, place)
        # The velocity that is wanted, no faster than it may be.
        wanted = np.zeros(len(velocity))
        if command is not None and not ends:
            wanted = command.velocity[: len(velocity)]
            wanted[:2] = _limit(wanted[:2], style.max_speed)
            wanted[2:] = _limit(wanted[2:], style.max_turning_speed)
        # What can be had of it now; where that leads out of the region, the finger brakes.
        most = (style.hard_braking if pressed else style.acceleration) * style.period
        changed = self._approach(velocity, wanted, most)
        reason = "" if command is not None else NOT_FINITE
        if not self._may_go(place[:2], changed[:2]):
            changed = self._approach(velocity, np.zeros(len(velocity)), most)
            reason = OUTSIDE_REGION
        status = now.status
        if status.reason != reason:
            status = replace(status, reason=reason)
        return replace(
            now,
            place=tuple(place.tolist()),
            velocity=tuple(changed.tolist()),
            time=time,
            pressed=pressed,
            status=status,
        )

    def _approach(self, velocity: Array, wanted: Array, most: float) -> Array:
        """Changes a velocity (D,) towards another one; that of the tip by at most so much, m/s."""
        turn = self.style.turning_acceleration * self.style.period
        return np.concatenate(
            [
                _approach(velocity[:2], wanted[:2], most),
                _approach(velocity[2:], wanted[2:], turn),
            ]
        )

    def _find_pressure(self, context: Context) -> str:
        """Says that the force on the tip is too great; empty if it is not."""
        if not self._tip_force.HasValue(context):
            return ""
        force = float(np.linalg.norm(self._tip_force.Eval(context)))
        if not force > self.style.max_force:
            return ""
        return f"the force on the finger is {force:.0f} N; {self.style.max_force:.0f} N are allowed"

    def _may_go(self, place: Array, velocity: Array) -> bool:
        """Whether a tip at a place (2,), m, with a velocity (2,), m/s, can stop within the region.

        A tip that is outside may only go to where it is nearer to the region.
        """
        if self._region is None or not velocity.any():
            return True
        style = self.style
        speed = float(np.linalg.norm(velocity))
        braking = velocity * (speed / (2 * style.acceleration) + style.period)
        end = shapely.Point(place + braking)
        if self._region.covers(end):
            return True
        begin = self._region.distance(shapely.Point(place))
        return begin > 0 and self._region.distance(end) < begin

    def _go_up(self, context: Context, now: SteerState, time: float, place: Array) -> SteerState:
        """Begins the way up and back to where the other executors have the tip."""
        style = self.style
        x, y, *yaw = place.tolist()
        rest = self._read_rest(context)
        x1, y1, z1, *yaw1 = rest
        high = max(style.travel_height, z1)
        acceleration = style.travel_acceleration
        below = (x, y, style.push_height, *yaw)
        above = (x, y, high, *yaw)
        over = (x1, y1, high, *yaw1)
        ways = [(SteerPhase.RETRACTING, below, above, style.vertical_speed)]
        ways.append((SteerPhase.RETURNING, above, over, style.travel_speed))
        if z1 < high:
            ways.append((SteerPhase.RETURNING, over, rest, style.vertical_speed))
        segments = tuple(
            TrajectorySegment(phase, start, end, speed, acceleration)
            for phase, start, end, speed in ways
        )
        status = replace(now.status, phase=SteerPhase.RETRACTING, reason=now.pressed)
        return replace(now, segments=segments, segment_start=time, pressed="", status=status)


def _approach(velocity: Array, wanted: Array, most: float) -> Array:
    """Changes a velocity towards another one by at most so much."""
    change = wanted - velocity
    size = float(np.linalg.norm(change))
    return wanted if size <= most else velocity + change * (most / size)


def _limit(vector: Array, most: float) -> Array:
    """Shortens a vector to a greatest length."""
    size = float(np.linalg.norm(vector))
    return vector if size <= most else vector * (most / size)
