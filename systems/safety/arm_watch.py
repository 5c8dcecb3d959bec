"""`ArmWatch`: whether an arm, as it is measured, does what it is told, and nothing presses on it.

It takes in each status of the robot once (`Measurements`), compares it with the commands of the
last moments, and finds what is wrong, each with a sentence. It decides on nothing: `ArmGuard` stops
the arm. How the object moves is watched by `object_watch`.
"""

from dataclasses import dataclass, replace

import numpy as np

from gridpush_drake.frozen import Unchanging
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.multibody.tool_motion import TipRule
from gridpush_drake.systems.safety.arm_path import ArmPath
from gridpush_drake.systems.safety.guard_status import (
    BY_SILENCE,
    BY_USER,
    STOPPED_BY_USER,
    WORK_DONE,
    Fault,
    GuardLimits,
    StopKind,
)
from gridpush_drake.units import MM_PER_M

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

TIME_ROUNDING = 1e-9
"""Times that differ by less than this are the same, s."""

POSITION_ROUNDING = 1e-9
"""Joint positions that differ by less than this are the same, rad or m."""

SILENCE_REASON = "the robot has sent no status for"
"""How the reasons of stops begin that are for a robot's silence."""


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
        yaw: angle by which the tool is turned about the vertical, rad; 0 where nothing says it.
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
    yaw: float = 0.0


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


class ArmWatch:
    """Finds what is wrong with an arm of n joints, by what is measured of it.

    It remembers nothing itself: what it must know of earlier statuses is in `Measurements`.

    Attributes:
        limits: what is allowed.
    """

    def __init__(
        self,
        limits: GuardLimits,
        period: float,
        validator: TipRule | None = None,
    ) -> None:
        """Takes what never changes.

        Args:
            limits: what is allowed.
            period: of the commands, s.
            validator: says where the tip may not be; None allows all.
        """
        self.limits = limits
        self._period = period
        self._validator = validator

    def has_paused(self, seen: Measurements, inputs: GuardInputs) -> bool:
        """Returns whether the robot's clock shows that no command went out for longer than allowed.

        The robot's clock has then gone on although the Context's time, by which the commands are
        made, has not.
        """
        ahead = (inputs.time_measured - seen.time) - (inputs.time - seen.came)
        return bool(np.isfinite(ahead) and ahead > self.limits.status_age + TIME_ROUNDING)

    def measure(self, seen: Measurements, inputs: GuardInputs) -> Measurements:
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

    def compare(
        self, seen: Measurements, path: ArmPath, inputs: GuardInputs
    ) -> tuple[Measurements, ArmPath]:
        """Notes which commands the arm has passed through, and how far it is off all of them."""
        limits = self.limits
        fresh = seen.credible and seen.came == inputs.time
        if not fresh or seen.before is None or seen.position is None:
            return seen, path
        path = path.confirm(seen.before, seen.position)
        error = path.calc_error(seen.position, inputs.time, limits.following_time)
        # Joints that are said to be exactly where they were may not be measured at all.
        frozen = inputs.time - seen.unchanged_since > limits.following_time + TIME_ROUNDING
        allowed = min(FROZEN_ERROR, limits.following_error) if frozen else limits.following_error
        k = int(error.argmax())
        since = np.nan
        if error[k] > allowed:
            since = seen.astray_since if np.isfinite(seen.astray_since) else inputs.time
        return replace(seen, astray_since=since, astray=(k, float(error[k]))), path

    def find_faults(self, seen: Measurements, inputs: GuardInputs) -> list[Fault]:
        """Finds all that is wrong while the arm is at work, the most telling first."""
        faults = self._find_stops(seen, inputs)
        faults += self._find_not_finite(inputs, with_desired=True)
        faults += self._find_desired_beyond_limits(inputs)
        faults += self.find_collisions(inputs)
        faults += self._find_astray_joints(seen, inputs)
        faults += self._find_breach(inputs)
        return faults

    def find_faults_at_rest(
        self, seen: Measurements, inputs: GuardInputs, known: tuple[StopKind, ...]
    ) -> list[Fault]:
        """Finds what is wrong after a stop, while the arm brakes, goes back and is held.

        Collisions are left out, which are looked for by `guard_retreat.find_further_collisions`.

        Args:
            seen: what is remembered of the robot's statuses.
            inputs: what is on the ports.
            known: kinds of faults that are noted already, and left out.
        """
        faults = self._find_stops(seen, inputs)
        faults += self._find_not_finite(inputs, with_desired=False)
        faults += self._find_astray_joints(seen, inputs)
        faults += self._find_breach(inputs)
        left_out = (*known, StopKind.DONE, StopKind.FOLLOWING)
        return [fault for fault in faults if fault.kind not in left_out]

    def _find_stops(self, seen: Measurements, inputs: GuardInputs) -> list[Fault]:
        """Finds what the port `stop` says, and whether the robot is silent."""
        stops = self.find_requested_stop(inputs)
        allowed = self.limits.status_age
        age = inputs.time - seen.came
        if not stops and age > allowed - TIME_ROUNDING:
            passed = f"{MM_PER_M * max(age, allowed):.0f} ms"
            reason = f"{SILENCE_REASON} {passed}; {MM_PER_M * allowed:.0f} ms are allowed"
            return [Fault(StopKind.SILENCE, reason)]
        return stops

    def find_requested_stop(self, inputs: GuardInputs) -> list[Fault]:
        """Finds what the port `stop` says."""
        if inputs.stop == 0.0 or not np.isfinite(inputs.stop):
            return []
        if inputs.stop == BY_USER:
            return [Fault(StopKind.USER, STOPPED_BY_USER)]
        if inputs.stop == BY_SILENCE:
            # The Context's time has stood still meanwhile, and cannot tell for how long.
            allowed = f"{MM_PER_M * self.limits.status_age:.0f} ms that are allowed"
            return [Fault(StopKind.SILENCE, f"{SILENCE_REASON} longer than the {allowed}")]
        return [Fault(StopKind.DONE, WORK_DONE)]

    def _find_desired_beyond_limits(self, inputs: GuardInputs) -> list[Fault]:
        """Finds the joint that is desired farthest beyond its limits."""
        limits = self.limits
        beyond = np.maximum(
            limits.position_lower - inputs.desired, inputs.desired - limits.position_upper
        )
        if not (beyond > POSITION_ROUNDING).any():
            return []
        k = int(beyond.argmax())
        unit = limits.name_unit(k)
        reason = (
            f"joint {k + 1} is wanted at {inputs.desired[k]:.3f} {unit}; its limits are "
            f"{limits.position_lower[k]:.3f} and {limits.position_upper[k]:.3f} {unit}"
        )
        return [Fault(StopKind.JOINT_LIMIT, reason)]

    def _find_not_finite(self, inputs: GuardInputs, with_desired: bool) -> list[Fault]:
        """Finds a port with numbers that are not finite."""
        values: list[tuple[str, Array | float]] = [
            ("position_measured", inputs.measured),
            ("torque_external", inputs.torque),
            ("force", inputs.force),
            ("time_measured", inputs.time_measured),
            ("pusher_state", inputs.tip),
            ("stop", inputs.stop),
        ]
        if with_desired:
            values.append(("position_desired", inputs.desired))
        for port, value in values:
            if not np.isfinite(value).all():
                reason = f"{port} has numbers that are not finite"
                return [Fault(StopKind.NOT_FINITE, reason)]
        return []

    def find_collisions(self, inputs: GuardInputs) -> list[Fault]:
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

    def calc_load(self, inputs: GuardInputs) -> float:
        """Calculates the greatest torque or force as a fraction of its limit; NaN is left out."""
        fractions = [*np.abs(inputs.torque) / self.limits.torque]
        fractions.append(float(np.linalg.norm(inputs.force)) / self.limits.force)
        return max(
            (float(fraction) for fraction in fractions if np.isfinite(fraction)), default=0.0
        )

    def _find_astray_joints(self, seen: Measurements, inputs: GuardInputs) -> list[Fault]:
        """Finds joints that are measured where they cannot be, or where they should not be."""
        faults = []
        limits = self.limits
        if seen.too_fast is not None:
            k, speed = seen.too_fast
            unit = limits.name_unit(k)
            reason = (
                f"joint {k + 1} was measured to move at {speed:.2f} {unit}/s between two "
                f"statuses; it can move at {limits.speed[k]:.2f} {unit}/s"
            )
            faults.append(Fault(StopKind.JOINT_SPEED, reason))
        late = inputs.time - seen.astray_since > limits.following_time + TIME_ROUNDING
        if late:
            k, error = seen.astray
            unit = limits.name_unit(k)
            asked = f"joint {k + 1} is measured {error:.3f} {unit} from where it was told to be"
            if inputs.time - seen.unchanged_since > limits.following_time + TIME_ROUNDING:
                still = MM_PER_M * (inputs.time - seen.unchanged_since)
                reason = f"{asked}, and no joint's measured position has changed for {still:.0f} ms"
            else:
                reason = (
                    f"{asked}, for more than {MM_PER_M * limits.following_time:.0f} ms; "
                    f"{limits.following_error:.3f} {unit} is allowed"
                )
            faults.append(Fault(StopKind.FOLLOWING, reason))
        return faults

    def _find_breach(self, inputs: GuardInputs) -> list[Fault]:
        """Finds out whether the tip is where it may not be."""
        if self._validator is None or not np.isfinite(inputs.tip).all():
            return []
        breach = self._validator(inputs.tip, inputs.yaw)
        return [Fault(StopKind.TIP, breach)] if breach else []
