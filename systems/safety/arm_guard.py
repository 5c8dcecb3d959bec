"""`ArmGuard`: what stands last between all that commands an arm and the arm.

It lets positions through no faster than the joints may move, compares what the arm is told with
what it is measured to do (`arm_watch`), and where something is wrong it stops the arm smoothly and
holds it there, until a new Context begins. It trusts no single message: where it leads the arm back
from a collision (`guard_retreat`), it does so along the way that the arm has come (`arm_path`).

What is *not* here: how a robot answers commands that stop coming (`CommandRamp`), and whether
messages are whole and in order (`HardwareLink`).
"""

from dataclasses import dataclass, field, replace

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context

from gridpush_drake.frozen import Unchanging
from gridpush_drake.geometry.se2 import Array, wrap_angle
from gridpush_drake.multibody.tool_motion import TipRule
from gridpush_drake.multibody.weak_calc import NO_SLOTS
from gridpush_drake.systems.base.messages import GraspStatus
from gridpush_drake.systems.base.object_controller import AbstractStateSystem
from gridpush_drake.systems.safety.arm_path import ArmPath, CalcTip, brake, follow, keep_stoppable
from gridpush_drake.systems.safety.arm_watch import (
    TIME_ROUNDING,
    ArmWatch,
    GuardInputs,
    Measurements,
)
from gridpush_drake.systems.safety.guard_retreat import (
    Retreat,
    find_further_collisions,
    go_back,
    note_relief,
    plan_retreat,
)
from gridpush_drake.systems.safety.guard_status import (
    BY_SILENCE,
    COLLISION_KINDS,
    Fault,
    GuardLimits,
    GuardMode,
    GuardStatus,
    StopKind,
)
from gridpush_drake.systems.sensing.object_watch import ObjectWatch, WatchState
from gridpush_drake.units import MM_PER_M

MAX_OBJECT_SPEED = 0.5
"""By how much an object may have moved on for every second that it was not seen, m and rad."""

HOLD_TIME = 0.02
"""How long the joints must be measured that slow, s."""

CONFIRM_TIME = 1.0
"""How long after the commands came to rest, s, the joints are waited for to be measured at rest."""

IDLE_TIME = 0.5
"""How long after its last motion, s, the arm counts as idle. The object may then be moved by hand:
it is looked at anew before the next push."""

OCCLUDED_TIME = 0.2
"""How long the object may be out of sight, s, for its motion still to be compared with the
finger's. After longer it may only not be farther away than `MAX_OBJECT_SPEED` allows."""

PUSHER_STATE_SIZE = 6
"""Length of the tip's state: p_WP, m, and v_WP, m/s."""


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

    status: GuardStatus = field(default_factory=GuardStatus)
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
        - pusher_yaw
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
    * pusher_yaw: vector of 1, angle by which the tool is turned about the vertical, rad; it need
      not be connected if the pusher is round.
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
    `GuardLimits.status_age`; a number is not finite; a joint is desired beyond its limits; a torque
    from outside or the force on the tip is beyond its limit; a joint is measured to move faster
    than `JOINT_SPEED_MARGIN` times its speed limit between two statuses; a joint is measured
    farther than `following_error` from all that it was told within the last `following_time`, for
    longer than that again, or the joints are measured at exactly the same place meanwhile,
    `FROZEN_ERROR` from where they should be; the tip leaves where it may be; the pose of the object
    jumps, or the object moves as the finger cannot have moved it; or `stop` says so.

    All this counts from the very update on in which the arm is first measured at rest. What `stop`
    says counts even before: the arm is then held where it is first measured.

    **What a stop does.** The commands go on in a straight line in the joints' space, no farther
    than the accelerations need, and rest there; where a joint would leave its limits so, it brakes
    harder. After a torque or a force over its limit they then
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
        validator: TipRule | None = None,
        period: float = 0.005,
        object_watch: ObjectWatch | None = None,
    ) -> None:
        """Declares the system.

        Args:
            limits: what it allows; their sizes say how many joints there are.
            calc_tip: the arm's forward kinematics, from the joint positions (n,), rad, to the place
                of the tip p_WP (3,), m.
            validator: of the tip's place p_WP (3,), m, and the tool's yaw, rad: None where it may
                be there, else a sentence; None allows all.
            period: of the commands, s.
            object_watch: what the object's motion is judged by; None looks for jumps only.
        """
        super().__init__(GuardState(), period)
        self.limits = limits
        self._calc_tip = calc_tip
        self._watch = ArmWatch(limits, period, validator)
        self._period = period
        self._object_watch = object_watch
        n = len(limits.speed)
        self._desired = self.DeclareVectorInputPort("position_desired", n)
        self._measured = self.DeclareVectorInputPort("position_measured", n)
        self._torque = self.DeclareVectorInputPort("torque_external", n)
        self._force = self.DeclareVectorInputPort("force", 3)
        self._time_measured = self.DeclareVectorInputPort("time_measured", 1)
        self._pusher = self.DeclareVectorInputPort("pusher_state", PUSHER_STATE_SIZE)
        self._yaw = self.DeclareVectorInputPort("pusher_yaw", 1)
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
        paused = self._watch.has_paused(now.seen, inputs)
        now = replace(now, seen=self._watch.measure(now.seen, inputs))
        begins = now.position is None
        if begins:
            now = self._begin_at(now, inputs)
        if now.position is None or now.velocity is None:
            return now
        if paused:
            now = replace(now, velocity=np.zeros_like(now.velocity))
        if now.status.stopped:
            faults = self._watch.find_faults_at_rest(now.seen, inputs, now.status.kinds)
            faults += find_further_collisions(self._watch, now.status, now.retreat, inputs)
            now = self._note_faults(now, inputs, faults)
            return self._stop_on(now, inputs)
        # What the arm and the object have done since the last update.
        if now.path is not None:
            seen, path = self._watch.compare(now.seen, now.path, inputs)
            now = replace(now, seen=seen, path=path)
        now, object_fault = self._look_at_object(now, inputs)
        # What is wrong, and the next command.
        faults = self._watch.find_faults(now.seen, inputs)
        if object_fault:
            faults.append(Fault(StopKind.OBJECT, object_fault))
        now = self._note_faults(now, inputs, faults)
        if now.status.stopped:
            return self._stop_on(now, inputs)
        return now if begins else self._follow(now, inputs)

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
            yaw=float(self._yaw.Eval(context)[0]) if self._yaw.HasValue(context) else 0.0,
        )

    def _begin_at(self, now: GuardState, inputs: GuardInputs) -> GuardState:
        """Begins where two statuses in a row say that the arm is at rest; until then, waits.

        A stop that comes while it waits is kept.
        """
        if not now.status.stopped:
            now = self._note_faults(now, inputs, self._watch.find_requested_stop(inputs))
        seen = now.seen
        measured = inputs.measured
        if seen.too_fast is not None:  # the first of the two may have been the wrong one
            return replace(
                now, seen=replace(seen, position=measured, position_time=seen.time, too_fast=None)
            )
        if not seen.credible or np.isnan(seen.slow_since) or not np.isfinite(inputs.desired).all():
            return now
        stopped = now.status.stopped
        mode = GuardMode.STOPPING if stopped else GuardMode.FOLLOWING
        return replace(
            now,
            status=replace(now.status, mode=mode),
            position=measured,
            velocity=np.zeros_like(measured),
            desired=inputs.desired,
            moved=inputs.time,
            seen=replace(seen, unchanged_since=inputs.time),
            path=ArmPath.begin(measured, inputs.time, self._calc_tip(measured)),
        )

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
            hidden = time - now.pose_seen > OCCLUDED_TIME
            if idle or hidden or inputs.grasping:
                watch = self._object_watch.forget(watch)
            watch, moved = self._object_watch.watch(watch, time, pose, inputs.tip, inputs.yaw)
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
            return f"the object was seen to jump by {MM_PER_M * jump:.0f} mm and {turn:.2f} rad"
        return ""

    # What is done.

    def _follow(self, now: GuardState, inputs: GuardInputs) -> GuardState:
        """Makes the next command after what is desired."""
        assert now.position is not None and now.velocity is not None and now.desired is not None
        assert now.path is not None
        _, velocity = follow(
            position=now.position,
            velocity=now.velocity,
            before=now.desired,
            target=inputs.desired,
            speed=self.limits.speed,
            acceleration=self.limits.acceleration,
            period=self._period,
        )
        now = self._move_at(now, velocity)
        assert now.position is not None and now.velocity is not None and now.path is not None
        return replace(
            now,
            desired=inputs.desired,
            moved=inputs.time if now.velocity.any() else now.moved,
            path=now.path.add(inputs.time, now.position, self.limits.retreat, self._calc_tip),
        )

    def _note_faults(self, now: GuardState, inputs: GuardInputs, faults: list[Fault]) -> GuardState:
        """Notes faults in the status: the first stops the arm, a further one ends a retreat."""
        if not faults:
            return now
        retreat = None
        if not now.status.stopped:
            faults = faults[:1]
            if faults[0].kind in COLLISION_KINDS:
                retreat = Retreat(worst=self._watch.calc_load(inputs))
        status = now.status
        for fault in faults:
            status = status.stop_for(fault, inputs.time)
        return replace(now, status=status, retreat=retreat)

    def _stop_on(self, now: GuardState, inputs: GuardInputs) -> GuardState:
        """Makes the next command of a stopped arm, on the way to rest or at rest; sets the mode."""
        assert now.position is not None and now.velocity is not None
        retreat = now.retreat
        if retreat is not None:
            load = self._watch.calc_load(inputs)
            retreat = note_relief(retreat, load, inputs.time - now.status.since)
            now = replace(now, retreat=retreat)
        if inputs.stop == BY_SILENCE:  # no command goes out any more: the robot's driver brakes
            now = replace(now, velocity=np.zeros_like(now.velocity))
        if retreat is None or retreat.ended:
            now = self._brake(now)
        elif retreat.way is None:
            now = self._brake(now)
            assert now.position is not None and now.velocity is not None and now.path is not None
            if not now.velocity.any():
                way = plan_retreat(now.path, now.position, self.limits, self._calc_tip)
                status = replace(now.status, back_at=inputs.time + way.duration)
                return replace(now, status=status, retreat=replace(retreat, way=way))
        else:
            now = self._go_back(now, retreat)
        return self._judge_rest(now, inputs)

    def _brake(self, now: GuardState) -> GuardState:
        """Makes the next command on the way to rest."""
        assert now.position is not None and now.velocity is not None
        if not now.velocity.any():
            return now
        return self._move_at(now, brake(now.velocity, self.limits.acceleration, self._period))

    def _move_at(self, now: GuardState, velocity: Array) -> GuardState:
        """Makes the next command at velocities (n,), rad/s, or slower near a joint's limit."""
        assert now.position is not None
        limits = self.limits
        velocity = keep_stoppable(
            now.position,
            velocity,
            limits.position_lower,
            limits.position_upper,
            limits.acceleration,
            self._period,
        )
        return replace(now, position=now.position + self._period * velocity, velocity=velocity)

    def _go_back(self, now: GuardState, retreat: Retreat) -> GuardState:
        """Makes the next command along the way back, or brakes for good at its end."""
        assert now.position is not None and now.velocity is not None and retreat.way is not None
        step = go_back(
            retreat,
            retreat.way,
            now.position,
            now.velocity,
            self.limits,
            self._period,
            self._calc_tip,
        )
        if step.retreat.ended:
            return self._brake(replace(now, retreat=step.retreat))
        return replace(now, retreat=step.retreat, position=step.position, velocity=step.velocity)

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
        silent = (
            time - seen.came > self.limits.status_age - TIME_ROUNDING or inputs.stop == BY_SILENCE
        )
        there = False
        if seen.credible and seen.position is not None:
            # What is on the port now counts, too, even if its time shows that it is no new status.
            off = np.abs(np.array([seen.position, inputs.measured]) - place)
            there = bool((off <= self.limits.following_error).all())
        slow = time - seen.slow_since >= HOLD_TIME - TIME_ROUNDING
        mode = now.status.mode
        if slow and there and not silent:
            mode = GuardMode.HOLDING
        elif now.status.ended or silent or time - since > CONFIRM_TIME:
            mode = GuardMode.UNCONFIRMED
        if mode == now.status.mode:
            return now
        return replace(now, status=replace(now.status, mode=mode))
