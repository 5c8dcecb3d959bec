"""`ArmGuard`: what stands last between all that commands an arm and the arm.

It lets positions through no faster than the joints may move, compares what the arm is told with
what it is measured to do, and where something is wrong it stops the arm smoothly and holds it
there, until a new Context begins. It trusts no single message: where it leads the arm back from a
collision, it does so along the way that the arm has come (`arm_path`).

What is *not* here: how a robot answers commands that stop coming (`CommandRamp`), and whether
messages are whole and in order (`HardwareLink`).
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, InputPort

from gridpush_drake.frozen import Unchanging
from gridpush_drake.geometry.se2 import Array, wrap_angle
from gridpush_drake.multibody.weak_calc import NO_SLOTS
from gridpush_drake.systems.arm_path import ArmPath, CalcTip, WayBack, brake, follow
from gridpush_drake.systems.messages import GraspStatus
from gridpush_drake.systems.object_controller import AbstractStateSystem
from gridpush_drake.systems.object_watch import ObjectWatch, WatchState

MAX_OBJECT_SPEED = 0.5
"""By how much an object may have moved on for every second that it was not seen, m and rad."""

JOINT_SPEED_MARGIN = 1.5
"""A joint that is measured to move faster than this many times its speed limit is measured wrongly,
or is thrown. In simulation joints seem up to 1.2 times as fast as they are, as two statuses are
4 to 6 ms apart."""

JOINT_NOISE = 0.002
"""How far a joint at rest may seem to move between two statuses, rad or m."""

MAX_STATUS_GAP = 0.1
"""Longest time between two statuses, s, for which a joint's motion is excused: in a longer pause no
command goes out, and the robot's driver brings the arm to rest."""

FROZEN_ERROR = 0.002
"""Following error, rad or m, beyond which joints are taken for frozen that are measured at exactly
the same positions for longer than `GuardLimits.following_time`. A true measurement is never twice
the same while the arm moves."""

HOLD_SPEED = 0.02
"""Speed, rad/s or m/s, below which every joint must be measured before the arm counts as held."""

HOLD_TIME = 0.02
"""How long the joints must be measured that slow, s."""

CONFIRM_TIME = 1.0
"""How long after the commands came to rest, s, the joints are waited for to be measured at rest."""

RETREAT_SPEED_SHARE = 0.1
"""Share of its speed limit at which a joint goes back, at most, after a collision."""

RETREAT_ACCELERATION_SHARE = 0.5
"""Share of its greatest acceleration with which a joint sets out on the way back, and comes to rest
at its end; the rest is left for the way's bends."""

RETREAT_TIP_SPEED = 0.05
"""Speed at which the finger's tip goes back, at most, after a collision, m/s."""

RELIEF_TIME = 0.1
"""How long after a collision, s, torques and forces may still rise: the arm has to brake first, and
its estimate of them comes late. After that a retreat ends where they rise further, or again."""

RELIEVED_SHARE = 0.8
"""An arm is relieved where torques and forces are below this share of what is allowed."""

IDLE_TIME = 0.5
"""How long after its last motion, s, the arm counts as idle. The object may then be moved by hand:
it is looked at anew before the next push."""

HIDDEN_TIME = 0.2
"""How long the object may be out of sight, s, for its motion still to be compared with the
finger's. After longer it may only not be farther away than `MAX_OBJECT_SPEED` allows."""

AT_REST = 1e-9
"""Velocity of a commanded joint, rad/s or m/s, below which rounding errors alone are left."""

TRAVEL_ROUNDING = 1e-8
"""Ways of the tip that differ by less than this are the same, m: bends are measured in straight
pieces."""

PUSHER_STATE_SIZE = 6
"""Length of the tip's state: p_WP, m, and v_WP, m/s."""

ROUNDING = 1e-9
"""Times that differ by less than this are the same, s."""

MILLI = 1e3
"""Millimeters in a meter, and milliseconds in a second."""

STOPPED_BY_USER = "stopped by the user"
WORK_DONE = "the work is done"
"""Reasons of stops that are no faults."""

BY_USER = 1.0
DONE = 2.0
BY_SILENCE = 3.0
"""Values of the port `stop`, which say what the arm is stopped for."""


@dataclass(frozen=True, eq=False)
class GuardLimits:
    """What an `ArmGuard` allows an arm of n joints.

    Where a joint slides, read m for rad and N for N m.

    Attributes:
        speed: (n,) greatest speed of each joint in the commands, rad/s.
        acceleration: (n,) greatest acceleration of each joint in the commands, rad/s².
        torque: (n,) greatest torque on each joint from outside, N m; beyond it the arm goes back.
        force: greatest force on the finger's tip, N; beyond it the arm goes back.
        status_age: greatest age of the robot's last status, s; beyond it the arm is stopped.
        pose_jump: farthest that the object may be seen to move from one look to the next, m.
        pose_turn: farthest that the object may be seen to turn from one look to the next, rad.
        retreat: farthest that the tip travels back after a torque or a force over its limit, m.
        following_error: how far a joint may be measured from all positions that it was told within
            the last `following_time`, rad.
        following_time: how long a joint may be farther off than `following_error`, s; and how late
            a joint may be without being off at all.
    """

    speed: Array
    acceleration: Array
    torque: Array
    force: float = 30.0
    status_age: float = 0.05
    pose_jump: float = 0.03
    pose_turn: float = 0.3
    retreat: float = 0.01
    following_error: float = 0.02
    following_time: float = 0.05


class GuardMode(StrEnum):
    """The present mode of a guard.

    WAITING: the arm was not measured yet; no command goes out. FOLLOWING: commands are passed on.
    STOPPING: the arm is brought to rest, or goes back from a collision. HOLDING: the arm is
    commanded to stay, and is measured at rest there. UNCONFIRMED: the arm is commanded to stay, but
    is not measured at rest there, or not measured at all.
    """

    WAITING = "waiting"
    FOLLOWING = "following"
    STOPPING = "stopping"
    HOLDING = "holding"
    UNCONFIRMED = "holding, not seen at rest"


class StopKind(StrEnum):
    """Kinds of reasons for which a guard stops an arm; each is noted once."""

    USER = "user"
    DONE = "done"
    SILENCE = "silence"
    NOT_FINITE = "not finite"
    TORQUE = "torque"
    FORCE = "force"
    JOINT_SPEED = "joint speed"
    FOLLOWING = "following"
    TIP = "tip"
    OBJECT = "object"


COLLISIONS = (StopKind.TORQUE, StopKind.FORCE)
"""Kinds after which the arm goes back along the way that it has come."""


@dataclass(frozen=True)
class Fault:
    """Something that is wrong, or another reason to stop.

    Attributes:
        kind: kind of the reason.
        reason: a sentence about it, without a full stop.
    """

    kind: StopKind
    reason: str


@dataclass(frozen=True)
class GuardStatus:
    """The status of a guard, as it is on its port.

    Attributes:
        mode: what the guard does.
        reason: why it stopped the arm, and what went wrong after that; empty if it did not.
        since: time at which it stopped the arm, s; NaN if it did not.
        kinds: kinds of all reasons, that of the stop first; empty if it did not stop the arm.
        back_at: time at which the arm will have gone back from a collision as far as it may, s; NaN
            if it does not go back.
    """

    mode: GuardMode = GuardMode.WAITING
    reason: str = ""
    since: float = float("nan")
    kinds: tuple[StopKind, ...] = ()
    back_at: float = float("nan")

    @property
    def by_user(self) -> bool:
        """Whether the arm was stopped because the user said so."""
        return self.kinds[:1] == (StopKind.USER,)

    @property
    def stopped(self) -> bool:
        """Whether the arm was stopped, or is just being."""
        return bool(self.reason)

    @property
    def ended(self) -> bool:
        """Whether the arm was stopped and nothing more is to come: it holds, as far as is known."""
        return self.mode in (GuardMode.HOLDING, GuardMode.UNCONFIRMED)

    @property
    def failed(self) -> bool:
        """Whether something was wrong, be it while the arm was at work or after it was stopped.

        A robot that falls silent only after the work was done does no harm any more.
        """
        harmless = (StopKind.USER, StopKind.DONE, StopKind.SILENCE)
        return self.kinds[:1] == (StopKind.SILENCE,) or any(
            kind not in harmless for kind in self.kinds
        )

    def stop_for(self, fault: Fault, time: float) -> "GuardStatus":
        """Notes a fault: the first one stops the arm, those after it are added to the reason."""
        if not self.stopped:
            return GuardStatus(GuardMode.STOPPING, fault.reason, time, (fault.kind,))
        then = "while it was held" if self.ended else "while it was stopped"
        reason = f"{self.reason}; then, {then}, {fault.reason}"
        return replace(self, reason=reason, kinds=(*self.kinds, fault.kind))


@dataclass(frozen=True, eq=False)
class GuardInputs:
    """What is on a guard's input ports at one time; see `ArmGuard`.

    Attributes:
        time: time of the Context, s.
        desired: (n,) desired joint positions, rad.
        measured: (n,) joint positions in the robot's last status, rad.
        torque: (n,) torques on the joints from outside, N m.
        force: (3,) force on the finger's tip in W, N.
        time_measured: time of the robot's last status, by the robot's clock, s.
        tip: (3,) position p_WP of the finger's tip, as measured, m.
        pose: (3,) X_WB of the object as it was seen last, m and rad; NaN while it is not seen.
        stop: what the arm is stopped for; 0 for nothing.
        grasping: whether a grasp is under way.
    """

    time: float
    desired: Array
    measured: Array
    torque: Array
    force: Array
    time_measured: float
    tip: Array
    pose: Array
    stop: float
    grasping: bool


@dataclass(frozen=True, eq=False)
class Measurements(Unchanging):
    """What a guard remembers of the robot's statuses.

    Attributes:
        time: time of the last status, by the robot's clock, s; NaN before the first.
        came: time at which that status came, by the Context's clock, s.
        position: (n,) the last credible joint positions, rad; None before the first.
        position_time: time of the status that they are from, by the robot's clock, s.
        before: (n,) the credible joint positions before these, rad; None before the second.
        credible: whether the joint positions in the last status are credible.
        too_fast: number, from 0, of a joint that moved faster in the last status than the arm can,
            and its speed, rad/s; None if there is none.
        slow_since: time since which all joints have been slower than `HOLD_SPEED`, s; NaN while one
            is not.
        unchanged_since: time since which the measured joint positions have been exactly the same,
            s.
        astray_since: time since which a joint has been farther from its commands than it may be, s;
            NaN while none is.
        astray: number of that joint, from 0, and how far it is off, rad.
    """

    time: float = float("nan")
    came: float = 0.0
    position: Array | None = None
    position_time: float = float("nan")
    before: Array | None = None
    credible: bool = False
    too_fast: tuple[int, float] | None = None
    slow_since: float = float("nan")
    unchanged_since: float = 0.0
    astray_since: float = float("nan")
    astray: tuple[int, float] = (0, 0.0)


@dataclass(frozen=True, eq=False)
class Retreat(Unchanging):
    """How an arm goes back from a collision.

    Attributes:
        way: the way back; None until the arm has braked.
        gone: time for which the arm has gone along the way, s.
        traveled: distance by which the tip has been commanded to go back, m.
        ended: whether the arm brakes for good, since it would otherwise go farther than it may.
        worst: greatest torque or force so far, as a share of its limit.
        relieved: whether torques and forces have been within their limits since.
    """

    way: WayBack | None = None
    gone: float = 0.0
    traveled: float = 0.0
    ended: bool = False
    worst: float = 0.0
    relieved: bool = False


@dataclass(frozen=True, eq=False)
class GuardState(Unchanging):
    """All that a guard remembers; never changed, only replaced.

    Attributes:
        status: the status on the port.
        position: (n,) commanded joint positions, rad; None before the arm was measured.
        velocity: (n,) velocities of the commanded positions, rad/s.
        desired: (n,) joint positions that were desired at the last update, rad.
        moved: time at which the commanded positions moved last, s.
        seen: what is remembered of the robot's statuses.
        path: the way that the arm has come; None before it was measured.
        retreat: how the arm goes back from a collision; None if it does not.
        at_rest_since: time since which the commands have been at rest after a stop, s; NaN before.
        pose: (3,) X_WB of the object as it was seen last, m and rad; None before it was.
        pose_seen: time at which that was, s.
        watch: what is remembered of the object's motion.
    """

    status: GuardStatus = GuardStatus()
    position: Array | None = None
    velocity: Array | None = None
    desired: Array | None = None
    moved: float = 0.0
    seen: Measurements = field(default_factory=Measurements)
    path: ArmPath | None = None
    retreat: Retreat | None = None
    at_rest_since: float = float("nan")
    pose: Array | None = None
    pose_seen: float = 0.0
    watch: WatchState = field(default_factory=WatchState)


class ArmGuard(AbstractStateSystem[GuardState]):
    """Passes on the commands for an arm's n joints, within limits, and stops the arm over a fault.

    .. pydrake_system::

        name: ArmGuard
        input_ports:
        - position_desired
        - position_measured
        - torque_external
        - force
        - time_measured
        - pusher_state
        - object_pose
        - stop
        - grasp_status
        output_ports:
        - position
        - status

    * position_desired: vector of n, desired joint positions, rad.
    * position_measured: vector of n, measured joint positions, rad.
    * torque_external: vector of n, torques on the joints from outside, N m.
    * force: vector of 3, force on the finger's tip in W, N.
    * time_measured: vector of 1, time of the robot's status by the robot's clock, s; it grows with
      every status.
    * pusher_state: vector of 6, position p_WP of the tip's center, m, and its velocity v_WP, m/s,
      as measured.
    * object_pose: vector of 3, observed X_WB, (x, y, theta), m and rad; NaN while the object is not
      seen.
    * stop: vector of 1; any value but 0 stops the arm. `BY_USER` says that the user asked for it;
      `BY_SILENCE` that the robot was silent, so that time stood still and no command went out for
      longer than `status_age`; any other value that the work is done.
    * grasp_status: abstract `GraspStatus`; while a grasp is under way the object moves with the
      gripper. It need not be connected.
    * position: vector of n, joint positions for the robot, rad; they begin where the joints were
      first measured, and are NaN before.
    * status: abstract `GuardStatus`, what the guard does, and why it stopped the arm.

    **What stops the arm**, each with a sentence in the status: the last status is as old as
    `GuardLimits.status_age`; a number is not finite; a torque from outside or the force on the tip
    is beyond its limit; a joint is measured to move faster than `JOINT_SPEED_MARGIN` times its
    speed limit between two statuses; a joint is measured farther than `following_error` from all
    that it was told within the last `following_time`, for longer than that again, or the joints
    are measured at exactly the same place meanwhile, `FROZEN_ERROR` from where they should be; the
    tip leaves where it may be; the pose of the object jumps, or the object moves as the finger
    cannot have moved it; or `stop` says so.

    **What a stop does.** The commands go on in a straight line in the joints' space, no farther
    than the accelerations need, and rest there. After a torque or a force over its limit they then
    go back slowly along the way that the arm was measured to have come, until the tip has traveled
    by `retreat`, or as far as the way is known. A fault on the way back ends it there. All the
    time, all commands keep the limits of speed and acceleration. No measurement leads the arm
    anywhere. Faults that come after the stop are added to the status; nothing makes the arm follow
    again.

    The mode is `HOLDING` only while the joints were measured slower than `HOLD_SPEED`, and where
    they were told to be; else it is `UNCONFIRMED`, at the latest `CONFIRM_TIME` after the commands
    came to rest.

    Where the robot's clock went on by more than `status_age` longer than the Context's, it was the
    commands that paused: the arm rests, and they begin at rest again, at once.

    Abstract state: one `GuardState`.
    """

    __slots__ = NO_SLOTS

    def __init__(
        self,
        limits: GuardLimits,
        calc_tip: CalcTip,
        validator: Callable[[Array], str | None] | None = None,
        period: float = 0.005,
        object_watch: ObjectWatch | None = None,
    ) -> None:
        """Declares the system.

        Args:
            limits: what it allows; their sizes say how many joints there are.
            calc_tip: the arm's forward kinematics, from the joint positions (n,), rad, to the place
                of the tip p_WP (3,), m.
            validator: of the tip's place p_WP (3,), m: None where it may be there, else a sentence;
                None allows all.
            period: of the commands, s.
            object_watch: what the object's motion is judged by; None looks for jumps only.
        """
        super().__init__(GuardState(), period)
        self.limits = limits
        self._calc_tip = calc_tip
        self._validator = validator
        self._period = period
        self._object_watch = object_watch
        n = len(limits.speed)
        self._desired = self.DeclareVectorInputPort("position_desired", n)
        self._measured = self.DeclareVectorInputPort("position_measured", n)
        self._torque = self.DeclareVectorInputPort("torque_external", n)
        self._force = self.DeclareVectorInputPort("force", 3)
        self._time_measured = self.DeclareVectorInputPort("time_measured", 1)
        self._pusher = self.DeclareVectorInputPort("pusher_state", PUSHER_STATE_SIZE)
        self._pose = self.DeclareVectorInputPort("object_pose", 3)
        self._stop = self.DeclareVectorInputPort("stop", 1)
        self._grasp = self.DeclareAbstractInputPort(
            "grasp_status", AbstractValue.Make(GraspStatus())
        )
        self._declare_vector(
            "position", n, lambda now: np.full(n, np.nan) if now.position is None else now.position
        )
        self._declare_value("status", lambda now: now.status)

    def _go_on(self, context: Context, now: GuardState) -> GuardState:
        """Looks whether all is well, and makes the next command."""
        inputs = self._read(context)
        paused = self._has_paused(now, inputs)
        now = replace(now, seen=self._measure(now.seen, inputs))
        if now.position is None or now.velocity is None:
            return self._begin_at(now, inputs)
        if paused:
            now = replace(now, velocity=np.zeros_like(now.velocity))
        if now.status.stopped:
            now = self._note_faults(now, inputs, self._find_faults_at_rest(now, inputs))
            return self._stop_on(now, inputs)
        # What the arm and the object have done since the last update.
        now = self._compare(now, inputs)
        now, object_fault = self._look_at_object(now, inputs)
        # What is wrong, and the next command.
        faults = self._find_faults(now, inputs)
        if object_fault:
            faults.append(Fault(StopKind.OBJECT, object_fault))
        now = self._note_faults(now, inputs, faults)
        if now.status.stopped:
            return self._stop_on(now, inputs)
        return self._follow(now, inputs)

    def _read(self, context: Context) -> GuardInputs:
        """Reads the input ports."""
        grasping = self._grasp.HasValue(context) and not self._grasp.Eval(context).ready
        return GuardInputs(
            time=context.get_time(),
            desired=np.array(self._desired.Eval(context)),
            measured=np.array(self._measured.Eval(context)),
            torque=np.array(self._torque.Eval(context)),
            force=np.array(self._force.Eval(context)),
            time_measured=float(self._time_measured.Eval(context)[0]),
            tip=np.array(self._pusher.Eval(context)[:3]),
            pose=np.array(self._pose.Eval(context)),
            stop=float(self._stop.Eval(context)[0]),
            grasping=grasping,
        )

    # What the robot says of itself.

    def _has_paused(self, now: GuardState, inputs: GuardInputs) -> bool:
        """Returns whether the robot's clock shows that no command went out for longer than allowed.

        The robot's clock has then gone on although the Context's time, by which the commands are
        made, has not.
        """
        ahead = (inputs.time_measured - now.seen.time) - (inputs.time - now.seen.came)
        return bool(np.isfinite(ahead) and ahead > self.limits.status_age + ROUNDING)

    def _measure(self, seen: Measurements, inputs: GuardInputs) -> Measurements:
        """Takes in the robot's status on the ports; each status counts once."""
        newer = np.isnan(seen.time) or inputs.time_measured > seen.time
        if not (np.isfinite(inputs.time_measured) and newer):
            return seen
        measured = inputs.measured
        seen = replace(
            seen, time=inputs.time_measured, came=inputs.time, credible=False, too_fast=None
        )
        if not np.isfinite(measured).all():
            return replace(seen, slow_since=np.nan)
        if seen.position is None:
            return replace(seen, position=measured, position_time=seen.time)
        # Can the joints move like that from one status to the next?
        elapsed = float(np.clip(seen.time - seen.position_time, self._period, MAX_STATUS_GAP))
        moved = np.abs(measured - seen.position)
        farthest = JOINT_SPEED_MARGIN * self.limits.speed * elapsed + JOINT_NOISE
        if (moved > farthest).any():
            k = int((moved / farthest).argmax())
            return replace(seen, slow_since=np.nan, too_fast=(k, float(moved[k]) / elapsed))
        # Are they at rest, and are they the very same numbers as before?
        slow = bool((moved <= HOLD_SPEED * elapsed).all())
        since = seen.slow_since if np.isfinite(seen.slow_since) else inputs.time
        return replace(
            seen,
            before=seen.position,
            position=measured,
            position_time=seen.time,
            credible=True,
            slow_since=since if slow else np.nan,
            unchanged_since=inputs.time if moved.any() else seen.unchanged_since,
        )

    def _begin_at(self, now: GuardState, inputs: GuardInputs) -> GuardState:
        """Begins where two statuses in a row say that the arm is at rest."""
        seen = now.seen
        measured = inputs.measured
        if seen.too_fast is not None:  # the first of the two may have been the wrong one
            return replace(
                now, seen=replace(seen, position=measured, position_time=seen.time, too_fast=None)
            )
        if not seen.credible or np.isnan(seen.slow_since) or not np.isfinite(inputs.desired).all():
            return now
        return replace(
            now,
            status=GuardStatus(GuardMode.FOLLOWING),
            position=measured,
            velocity=np.zeros_like(measured),
            desired=inputs.desired,
            moved=inputs.time,
            seen=replace(seen, unchanged_since=inputs.time),
            path=ArmPath.begin(measured, inputs.time, self._calc_tip(measured)),
        )

    def _compare(self, now: GuardState, inputs: GuardInputs) -> GuardState:
        """Notes which commands the arm has passed through, and how far it is off all of them."""
        seen = now.seen
        path = now.path
        limits = self.limits
        fresh = seen.credible and seen.came == inputs.time
        if not fresh or path is None or seen.before is None or seen.position is None:
            return now
        path = path.confirm(seen.before, seen.position)
        error = path.calc_error(seen.position, inputs.time, limits.following_time)
        # Joints that are said to be exactly where they were may not be measured at all.
        frozen = inputs.time - seen.unchanged_since > limits.following_time + ROUNDING
        allowed = min(FROZEN_ERROR, limits.following_error) if frozen else limits.following_error
        k = int(error.argmax())
        since = np.nan
        if error[k] > allowed:
            since = seen.astray_since if np.isfinite(seen.astray_since) else inputs.time
        seen = replace(seen, astray_since=since, astray=(k, float(error[k])))
        return replace(now, seen=seen, path=path)

    # What is wrong.

    def _find_faults(self, now: GuardState, inputs: GuardInputs) -> list[Fault]:
        """Finds all that is wrong while the arm is at work, the most telling first."""
        faults = self._find_stops(now, inputs)
        faults += self._find_not_finite(inputs, with_desired=True)
        faults += self._find_collisions(inputs)
        faults += self._find_astray_joints(now, inputs)
        faults += self._find_breach(inputs)
        return faults

    def _find_faults_at_rest(self, now: GuardState, inputs: GuardInputs) -> list[Fault]:
        """Finds what is newly wrong after a stop, while the arm brakes, goes back and is held."""
        faults = self._find_stops(now, inputs)
        faults += self._find_not_finite(inputs, with_desired=False)
        faults += self._find_astray_joints(now, inputs)
        faults += self._find_breach(inputs)
        known = (*now.status.kinds, StopKind.DONE, StopKind.FOLLOWING)
        faults = [fault for fault in faults if fault.kind not in known]
        return faults + self._find_further_collisions(now, inputs)

    def _find_stops(self, now: GuardState, inputs: GuardInputs) -> list[Fault]:
        """Finds what the port `stop` says, and whether the robot is silent."""
        allowed = self.limits.status_age
        age = inputs.time - now.seen.came
        if np.isfinite(inputs.stop) and inputs.stop not in (0.0, BY_SILENCE):
            if inputs.stop == BY_USER:
                return [Fault(StopKind.USER, STOPPED_BY_USER)]
            return [Fault(StopKind.DONE, WORK_DONE)]
        text = "the robot has sent no status for"
        if inputs.stop == BY_SILENCE:
            # The Context's time has stood still meanwhile, and cannot tell for how long.
            reason = f"{text} longer than the {MILLI * allowed:.0f} ms that are allowed"
            return [Fault(StopKind.SILENCE, reason)]
        if age > allowed - ROUNDING:
            passed = f"{MILLI * max(age, allowed):.0f} ms"
            reason = f"{text} {passed}; {MILLI * allowed:.0f} ms are allowed"
            return [Fault(StopKind.SILENCE, reason)]
        return []

    def _find_not_finite(self, inputs: GuardInputs, with_desired: bool) -> list[Fault]:
        """Finds a port with numbers that are not finite."""
        values: list[tuple[InputPort, Array | float]] = [
            (self._measured, inputs.measured),
            (self._torque, inputs.torque),
            (self._force, inputs.force),
            (self._time_measured, inputs.time_measured),
            (self._pusher, inputs.tip),
            (self._stop, inputs.stop),
        ]
        if with_desired:
            values.append((self._desired, inputs.desired))
        for port, value in values:
            if not np.isfinite(value).all():
                reason = f"{port.get_name()} has numbers that are not finite"
                return [Fault(StopKind.NOT_FINITE, reason)]
        return []

    def _find_collisions(self, inputs: GuardInputs) -> list[Fault]:
        """Finds the torque farthest beyond its limit, and whether the force is beyond its own."""
        faults = []
        limits = self.limits
        torque = np.abs(inputs.torque)
        force = float(np.linalg.norm(inputs.force))
        if (torque > limits.torque).any():
            k = int((torque / limits.torque).argmax())
            allowed = f"{limits.torque[k]:.1f} N m are allowed"
            reason = f"the external torque on joint {k + 1} is {torque[k]:.1f} N m; {allowed}"
            faults.append(Fault(StopKind.TORQUE, reason))
        if force > limits.force:
            reason = (
                f"the force on the finger's tip is {force:.1f} N; {limits.force:.1f} N are allowed"
            )
            faults.append(Fault(StopKind.FORCE, reason))
        return faults

    def _find_further_collisions(self, now: GuardState, inputs: GuardInputs) -> list[Fault]:
        """Finds torques and forces over their limits that are not what the arm was stopped for.

        After a collision these are the ones that rise further although the arm goes back, or rise
        again.
        """
        kinds = now.status.kinds
        if kinds[0] not in COLLISIONS:
            return [fault for fault in self._find_collisions(inputs) if fault.kind not in kinds]
        if sum(kind in COLLISIONS for kind in kinds) > 1:
            return []
        retreat = now.retreat or Retreat()
        overdue = inputs.time - now.status.since > RELIEF_TIME
        load = self._calc_load(inputs)
        if retreat.relieved or (overdue and load > retreat.worst):
            return self._find_collisions(inputs)[:1]
        return []

    def _calc_load(self, inputs: GuardInputs) -> float:
        """Calculates the greatest torque or force as a share of its limit; NaN is left out."""
        shares = [*np.abs(inputs.torque) / self.limits.torque]
        shares.append(float(np.linalg.norm(inputs.force)) / self.limits.force)
        return max((float(share) for share in shares if np.isfinite(share)), default=0.0)

    def _find_astray_joints(self, now: GuardState, inputs: GuardInputs) -> list[Fault]:
        """Finds joints that are measured where they cannot be, or where they should not be."""
        faults = []
        seen = now.seen
        limits = self.limits
        if seen.too_fast is not None:
            k, speed = seen.too_fast
            reason = (
                f"joint {k + 1} was measured to move at {speed:.2f} per second between two "
                f"statuses; it can move at {limits.speed[k]:.2f}"
            )
            faults.append(Fault(StopKind.JOINT_SPEED, reason))
        late = inputs.time - seen.astray_since > limits.following_time + ROUNDING
        if late:
            k, error = seen.astray
            asked = f"joint {k + 1} is measured {error:.3f} from where it was told to be"
            if inputs.time - seen.unchanged_since > limits.following_time + ROUNDING:
                still = MILLI * (inputs.time - seen.unchanged_since)
                reason = f"{asked}, and no joint's measured position has changed for {still:.0f} ms"
            else:
                reason = (
                    f"{asked}, for more than {MILLI * limits.following_time:.0f} ms; "
                    f"{limits.following_error:.3f} is allowed"
                )
            faults.append(Fault(StopKind.FOLLOWING, reason))
        return faults

    def _find_breach(self, inputs: GuardInputs) -> list[Fault]:
        """Finds out whether the tip is where it may not be."""
        if self._validator is None or not np.isfinite(inputs.tip).all():
            return []
        breach = self._validator(inputs.tip)
        return [Fault(StopKind.TIP, breach)] if breach else []

    def _look_at_object(self, now: GuardState, inputs: GuardInputs) -> tuple[GuardState, str]:
        """Takes in where the object is seen; says why it cannot have come there, else ""."""
        time = inputs.time
        pose = inputs.pose
        watch = now.watch
        if not np.isfinite(pose).all():
            return now, ""
        fault = self._find_jump(now, inputs)
        if self._object_watch is not None and np.isfinite(inputs.tip).all():
            idle = time - now.moved > IDLE_TIME
            hidden = time - now.pose_seen > HIDDEN_TIME
            if idle or hidden or inputs.grasping:
                watch = self._object_watch.forget(watch)
            watch, moved = self._object_watch.watch(watch, time, pose, inputs.tip)
            fault = fault or moved
        return replace(now, pose=pose, pose_seen=time, watch=watch), fault

    def _find_jump(self, now: GuardState, inputs: GuardInputs) -> str:
        """Says how far the object was seen to jump; "" if it did not."""
        if now.pose is None:
            return ""
        moved = MAX_OBJECT_SPEED * (inputs.time - now.pose_seen)
        jump = float(np.linalg.norm(inputs.pose[:2] - now.pose[:2]))
        turn = abs(float(wrap_angle(inputs.pose[2] - now.pose[2])))
        if jump > self.limits.pose_jump + moved or turn > self.limits.pose_turn + moved:
            return f"the object was seen to jump by {MILLI * jump:.0f} mm and {turn:.2f} rad"
        return ""

    # What is done.

    def _follow(self, now: GuardState, inputs: GuardInputs) -> GuardState:
        """Makes the next command after what is desired."""
        assert now.position is not None and now.velocity is not None and now.desired is not None
        assert now.path is not None
        position, velocity = follow(
            position=now.position,
            velocity=now.velocity,
            before=now.desired,
            target=inputs.desired,
            speed=self.limits.speed,
            acceleration=self.limits.acceleration,
            period=self._period,
        )
        return replace(
            now,
            position=position,
            velocity=velocity,
            desired=inputs.desired,
            moved=inputs.time if velocity.any() else now.moved,
            path=now.path.add(inputs.time, position, self.limits.retreat, self._calc_tip),
        )

    def _note_faults(self, now: GuardState, inputs: GuardInputs, faults: list[Fault]) -> GuardState:
        """Notes faults in the status: the first stops the arm, a further one ends a retreat."""
        if not faults:
            return now
        retreat = None
        if not now.status.stopped:
            faults = faults[:1]
            if faults[0].kind in COLLISIONS:
                retreat = Retreat(worst=self._calc_load(inputs))
        status = now.status
        for fault in faults:
            status = status.stop_for(fault, inputs.time)
        return replace(now, status=status, retreat=retreat)

    def _stop_on(self, now: GuardState, inputs: GuardInputs) -> GuardState:
        """Makes the next command of a stopped arm, on the way to rest or at rest; sets the mode."""
        assert now.position is not None and now.velocity is not None
        now = self._note_relief(now, inputs)
        retreat = now.retreat
        if inputs.stop == BY_SILENCE:  # no command goes out any more: the robot's driver brakes
            now = replace(now, velocity=np.zeros_like(now.velocity))
        if retreat is None or retreat.ended:
            now = self._brake(now)
        elif retreat.way is None:
            now = self._brake(now)
            if now.velocity is not None and not now.velocity.any():
                way = self._plan_retreat(now)
                status = replace(now.status, back_at=inputs.time + way.duration)
                return replace(now, status=status, retreat=replace(retreat, way=way))
        else:
            now = self._go_back(now, retreat, retreat.way)
        return self._judge_rest(now, inputs)

    def _note_relief(self, now: GuardState, inputs: GuardInputs) -> GuardState:
        """Takes in how strongly something still presses on the arm after a collision."""
        retreat = now.retreat
        if retreat is None:
            return now
        load = self._calc_load(inputs)
        early = inputs.time - now.status.since <= RELIEF_TIME
        worst = max(retreat.worst, load) if early else retreat.worst
        relieved = retreat.relieved or load < RELIEVED_SHARE
        if worst == retreat.worst and relieved == retreat.relieved:
            return now
        return replace(now, retreat=replace(retreat, worst=worst, relieved=relieved))

    def _brake(self, now: GuardState) -> GuardState:
        """Makes the next command on the way to rest."""
        assert now.position is not None and now.velocity is not None
        if not now.velocity.any():
            return now
        velocity = brake(now.velocity, self.limits.acceleration, self._period)
        return replace(now, position=now.position + self._period * velocity, velocity=velocity)

    def _plan_retreat(self, now: GuardState) -> WayBack:
        """Plans the way back from where the commands have come to rest."""
        assert now.position is not None and now.path is not None
        acceleration = RETREAT_ACCELERATION_SHARE * self.limits.acceleration
        return now.path.plan_retreat(
            now.position,
            distance=self.limits.retreat,
            speed=RETREAT_SPEED_SHARE * self.limits.speed,
            tip_speed=RETREAT_TIP_SPEED,
            ramp=float(np.max(RETREAT_SPEED_SHARE * self.limits.speed / acceleration)),
            calc_tip=self._calc_tip,
        )

    def _go_back(self, now: GuardState, retreat: Retreat, way: WayBack) -> GuardState:
        """Makes the next command along the way back.

        The commands may cut a bend of the way, or run a little wide of it. So that the tip still
        goes no farther than it may, each command leaves room to brake after it.
        """
        assert now.position is not None and now.velocity is not None
        limits = self.limits
        gone = min(retreat.gone + self._period, way.duration)
        position, velocity = follow(
            position=now.position,
            velocity=now.velocity,
            before=way.calc_position(retreat.gone),
            target=way.calc_position(gone),
            speed=RETREAT_SPEED_SHARE * limits.speed,
            acceleration=limits.acceleration,
            period=self._period,
        )
        # How far the tip has gone by then, and would go until it has braked.
        braking_time = float(np.max(np.abs(velocity) / limits.acceleration))
        tip = self._calc_tip(position)
        step = float(np.linalg.norm(tip - self._calc_tip(now.position)))
        rest = self._calc_tip(position + velocity * braking_time / 2)
        traveled = retreat.traveled + step
        if traveled + float(np.linalg.norm(rest - tip)) > limits.retreat + TRAVEL_ROUNDING:
            return self._brake(replace(now, retreat=replace(retreat, ended=True)))
        if retreat.gone >= way.duration and np.abs(velocity).max() < AT_REST:
            velocity = np.zeros_like(velocity)
        retreat = replace(retreat, gone=gone, traveled=traveled)
        return replace(now, position=position, velocity=velocity, retreat=retreat)

    def _judge_rest(self, now: GuardState, inputs: GuardInputs) -> GuardState:
        """Sets the mode of a stopped arm."""
        assert now.position is not None and now.velocity is not None
        retreat = now.retreat
        going_back = (
            retreat is not None
            and not retreat.ended
            and (retreat.way is None or retreat.gone < retreat.way.duration)
        )
        if now.velocity.any() or going_back:
            return replace(now, at_rest_since=np.nan)
        since = inputs.time if np.isnan(now.at_rest_since) else now.at_rest_since
        place = now.position
        now = replace(now, at_rest_since=since)
        # Not only the commands: the arm, too, must be measured at rest, and there.
        seen = now.seen
        time = inputs.time
        silent = time - seen.came > self.limits.status_age - ROUNDING or inputs.stop == BY_SILENCE
        there = False
        if seen.credible and seen.position is not None:
            # What is on the port now counts, too, even if its time shows that it is no new status.
            off = np.abs(np.array([seen.position, inputs.measured]) - place)
            there = bool((off <= self.limits.following_error).all())
        slow = time - seen.slow_since >= HOLD_TIME - ROUNDING
        mode = now.status.mode
        if slow and there and not silent:
            mode = GuardMode.HOLDING
        elif now.status.ended or silent or time - since > CONFIRM_TIME:
            mode = GuardMode.UNCONFIRMED
        if mode == now.status.mode:
            return now
        return replace(now, status=replace(now.status, mode=mode))
