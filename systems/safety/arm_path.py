"""How an arm's joints are led: after a target (`follow`), to rest (`brake`), and back (`ArmPath`).

Pure functions of positions and velocities, without Drake. `ArmGuard` and `CommandRamp` step them.
`ArmPath` remembers the way that an arm has come, so that it can be led back along it: positions
that it was commanded to take and was then measured to have passed through. No single measurement
decides where a retreat leads.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridpush_drake.frozen import Unchanging
from gridpush_drake.geometry.se2 import Array

CalcTip = Callable[[Array], Array]
"""Forward kinematics: from joint positions (n,), rad, to the place of the tip p_WP (3,), m."""

PASSED_TOLERANCE = 0.005
"""A command counts as passed through if the joints were measured within this of it, rad or m. In
simulation a healthy arm stays within 0.0015 rad of the commands that it follows, iiwa and Panda."""

UNCONFIRMED_TIME = 0.2
"""How long after a command, s, a measurement may still confirm it. Later the arm is not expected to
pass through it any more, and the command is forgotten."""

POSITION_SPACING = 0.0005
"""Least distance between two remembered positions, rad or m of a joint, so that an arm that stands
still does not fill the memory."""

MAX_GAP = 0.1
"""Greatest distance between two neighbors on the remembered way, rad or m of a joint. Where the arm
was not measured for longer than that, the way before the gap is forgotten."""

MAX_PASSED = 400
"""Most positions that are remembered."""

SPARE_LENGTH = 0.005
"""How much longer than the longest retreat the remembered way is, m of the tip's travel."""

MAX_PIECE = 0.005
"""Longest piece of a way whose length at the tip is measured as a straight line, rad or m of a
joint. At 1 m from the joint such a piece is straight to 0.02 micrometers."""

TIME_ROUNDING = 1e-9
"""Times that differ by less than this are the same, s."""


@dataclass(frozen=True, eq=False)
class RetreatPath(Unchanging):
    """Positions to go through one after the other, from rest to rest.

    Attributes:
        times: (k,) when each would be reached at full speed, s, from 0.
        positions: (k, n) of the joints, rad; straight lines lie between them.
        ramp: how long it takes to come to full speed, or from it to rest, s.
    """

    times: Array
    positions: Array
    ramp: float

    @property
    def duration(self) -> float:
        """Time from the first position to the last, s."""
        length = float(self.times[-1])
        rise = min(self.ramp, float(np.sqrt(length * self.ramp)))
        return length * self.ramp / rise + rise if rise > 0.0 else 0.0

    def calc_position(self, time: float) -> Array:
        """Calculates where the joints should be (n,), rad, at a time since the beginning, s.

        The speed rises in a straight line from 0 to the full speed within the ramp, and falls so
        at the end. On a way that is too short for that it begins to fall in the middle.
        """
        length = float(self.times[-1])
        duration = self.duration
        rise = min(self.ramp, float(np.sqrt(length * self.ramp)))
        time = float(np.clip(time, 0.0, duration))
        if time < rise:
            gone = time**2 / (2 * self.ramp)
        elif time > duration - rise:
            gone = length - (duration - time) ** 2 / (2 * self.ramp)
        else:
            gone = (time - rise / 2) * rise / self.ramp
        return np.array([np.interp(gone, self.times, column) for column in self.positions.T])


@dataclass(frozen=True, eq=False)
class ArmPath(Unchanging):
    """The way that an arm has come; never changed, only replaced.

    Attributes:
        times: (k,) when the latest commands were sent, s, the last one last.
        commands: (k, n) those commands, rad.
        confirmed: (k,) whether the arm was measured to pass through each of them.
        passed: (m, n) older commands that were confirmed, rad, the last one last.
        tips: (m, 3) where the tip is at each of these, p_WP, m.
    """

    times: Array
    commands: Array
    confirmed: NDArray[np.bool_]
    passed: Array
    tips: Array

    @staticmethod
    def begin(position: Array, time: float, tip: Array) -> "ArmPath":
        """Makes the way of an arm measured at a position (n,), rad, with its tip at (3,), m."""
        return ArmPath(
            times=np.array([time]),
            commands=position[np.newaxis],
            confirmed=np.array([True]),
            passed=position[np.newaxis],
            tips=np.asarray(tip, float)[np.newaxis],
        )

    def add(self, time: float, command: Array, length: float, calc_tip: CalcTip) -> "ArmPath":
        """Adds a command that was sent at a time.

        Args:
            time: time at which it was sent, s.
            command: (n,) commanded joint positions, rad.
            length: length of the way to remember, as travel of the tip, m.
            calc_tip: the arm's forward kinematics.
        """
        old = self.times < time - UNCONFIRMED_TIME
        leaving = self.commands[old & self.confirmed]
        kept = ~old
        path = replace(
            self,
            times=np.append(self.times[kept], time),
            commands=np.vstack([self.commands[kept], command]),
            confirmed=np.append(self.confirmed[kept], False),
        )
        for position in leaving:
            path = path._remember(position, length, calc_tip)
        return path

    def confirm(self, before: Array, measured: Array) -> "ArmPath":
        """Confirms the commands that lie between two measurements in a row, (n,), rad."""
        low = np.minimum(before, measured) - PASSED_TOLERANCE
        high = np.maximum(before, measured) + PASSED_TOLERANCE
        passed = ((self.commands >= low) & (self.commands <= high)).all(axis=1)
        if (passed <= self.confirmed).all():
            return self
        return replace(self, confirmed=self.confirmed | passed)

    def calc_error(self, measured: Array, time: float, duration: float) -> Array:
        """Calculates how far joints are from all that they were told within a time before now.

        A joint that merely comes late is not off at all: it is at an earlier command.

        Args:
            measured: (n,) rad.
            time: now, s.
            duration: how late a joint may come, s.

        Returns:
            (n,) distance of each joint from the range of its commands, rad.
        """
        recent = self.commands[self.times >= time - duration - TIME_ROUNDING]
        recent = recent if len(recent) else self.commands[-1:]
        below = recent.min(axis=0) - measured
        above = measured - recent.max(axis=0)
        error: Array = np.maximum(np.maximum(below, above), 0.0)
        return error

    def plan_retreat(
        self,
        position: Array,
        distance: float,
        speed: Array,
        tip_speed: float,
        ramp: float,
        calc_tip: CalcTip,
    ) -> RetreatPath:
        """Plans the way back from a position, as far as the tip may travel.

        Args:
            position: (n,) joint positions that are commanded now, rad.
            distance: greatest travel of the tip, m.
            speed: (n,) greatest speeds of the joints, rad/s.
            tip_speed: greatest speed of the tip, m/s.
            ramp: time to come to these speeds, s.
            calc_tip: the arm's forward kinematics.

        Returns:
            The way; the position alone if nothing is remembered.
        """
        recent = self.commands[self.confirmed]
        places = [position, *recent[::-1], *self.passed[::-1]]
        positions = [position]
        times = [0.0]
        # Where the tip is, and how far it may still travel, m.
        tip = calc_tip(position)
        left = distance
        for start, end in pairwise(places):
            for next_position in _divide(start, end):
                next_tip = calc_tip(next_position)
                length = float(np.linalg.norm(next_tip - tip))
                fraction = min(1.0, left / length) if length > 0.0 else 1.0
                reached = positions[-1] + fraction * (next_position - positions[-1])
                taken = float(np.max(np.abs(reached - positions[-1]) / speed))
                times.append(times[-1] + max(taken, fraction * length / tip_speed))
                positions.append(reached)
                if fraction < 1.0:
                    return RetreatPath(np.array(times), np.array(positions), ramp)
                tip = next_tip
                left -= length
        return RetreatPath(np.array(times), np.array(positions), ramp)

    def _remember(self, position: Array, length: float, calc_tip: CalcTip) -> "ArmPath":
        """Adds a confirmed position to the end of the way."""
        gap = float(np.abs(position - self.passed[-1]).max())
        if gap < POSITION_SPACING:
            return self
        tip = calc_tip(position)
        if gap > MAX_GAP:
            return replace(self, passed=position[np.newaxis], tips=tip[np.newaxis])
        passed = np.vstack([self.passed[1 - MAX_PASSED :], position])
        tips = np.vstack([self.tips[1 - MAX_PASSED :], tip])
        # What is longer ago than a retreat may lead is not needed.
        steps = np.linalg.norm(np.diff(tips, axis=0), axis=1)
        travel = np.cumsum(steps[::-1])[::-1]
        first = max(int(np.count_nonzero(travel > length + SPARE_LENGTH)) - 1, 0)
        return replace(self, passed=passed[first:], tips=tips[first:])


def _divide(start: Array, end: Array) -> Array:
    """Divides the straight line between two positions into short pieces; without its beginning."""
    count = max(int(np.ceil(np.abs(end - start).max() / MAX_PIECE)), 1)
    fractions = np.arange(1, count + 1)[:, np.newaxis] / count
    points: Array = start + fractions * (end - start)
    return points


def follow(
    position: ArrayLike,
    velocity: ArrayLike,
    before: ArrayLike,
    target: ArrayLike,
    speed: Array,
    acceleration: Array,
    period: float,
) -> tuple[Array, Array]:
    """Takes one step after a target that moves, each joint by itself.

    A target that keeps the limits is met exactly. It may brake at any time as hard as the joint can
    itself. So a joint that is behind goes no faster than lets it come to rest, at the latest, where
    the target can come to rest first. With the gap e, the target's velocity w in the direction of
    the gap, and the way S of `calc_stop_distance`, the velocity v in this direction is

        S(v) = e + S(w)  if w >= 0 (the target goes away),   v = w + S^-1(e)  otherwise.

    If the target keeps the limits, a joint that begins at rest thus never overshoots: it stays in
    the range of where it began, where the target has been, and where the target can rest first.

    Args:
        position: (n,) rad.
        velocity: (n,) rad/s.
        before: (n,) the target at the step's beginning, rad.
        target: (n,) at its end, rad.
        speed: (n,) greatest, rad/s.
        acceleration: (n,) greatest, rad/s².
        period: s.

    Returns:
        Position (n,), rad, and velocity (n,), rad/s, after the step.
    """
    q, v, start, end = (np.asarray(value, float) for value in (position, velocity, before, target))
    unit = acceleration * period
    gap = start - q
    toward = np.where(gap < 0.0, -1.0, 1.0)
    # The target's velocity along the gap, and how far it still goes if it brakes.
    leaving = toward * np.clip((end - start) / period, -speed, speed)
    ahead = calc_stop_distance(np.maximum(leaving, 0.0), unit, period)
    # More than the way of a joint at its greatest speed makes no difference.
    distance = np.minimum(np.abs(gap) + ahead, calc_stop_distance(speed, unit, period))
    wanted = toward * (_calc_stoppable_speed(distance, unit, period) + np.minimum(leaving, 0.0))
    v = np.clip(np.clip(wanted, -speed, speed), v - unit, v + unit)
    return q + period * v, v


def calc_stop_distance(speed: Array, unit: Array, period: float) -> Array:
    """Calculates how far joints go that move at a speed in this period, and brake after it.

    In each period h the speed v falls by u, so that with m = ceil(v / u) periods of motion

        S(v) = h (m v - u m (m - 1) / 2)

    Args:
        speed: (n,) at least 0, rad/s.
        unit: (n,) greatest change of the speed within a period, rad/s.
        period: s.

    Returns:
        (n,) way, with that in this period, rad.
    """
    periods = np.ceil(speed / unit)
    distance: Array = period * (periods * speed - unit * periods * (periods - 1) / 2)
    return distance


def _calc_stoppable_speed(distance: Array, unit: Array, period: float) -> Array:
    """Calculates the greatest speeds (n,), rad/s, whose `calc_stop_distance` is a distance, rad."""
    periods = np.maximum(np.ceil((np.sqrt(1 + 8 * distance / (unit * period)) - 1) / 2), 1.0)
    speed: Array = distance / (period * periods) + unit * (periods - 1) / 2
    return speed


def keep_stoppable(
    position: Array,
    velocity: Array,
    lower: Array,
    upper: Array,
    acceleration: Array,
    period: float,
) -> Array:
    """Slows joints down that could otherwise not come to rest within their limits.

    Args:
        position: (n,) before the step, rad.
        velocity: (n,) of the step, rad/s.
        lower: (n,) least positions, rad.
        upper: (n,) greatest positions, rad.
        acceleration: (n,) greatest, rad/s².
        period: s.

    Returns:
        (n,) velocities of the step, rad/s. Joints that have kept to this so far need no more than
        the acceleration for it. Out of its limits a joint only moves back towards them.
    """
    unit = acceleration * period
    most = _calc_stoppable_speed(np.maximum(upper - position, 0.0), unit, period)
    least = -_calc_stoppable_speed(np.maximum(position - lower, 0.0), unit, period)
    return np.clip(velocity, least, most)


def brake(velocity: Array, acceleration: Array, period: float) -> Array:
    """Takes one step on the way to rest, which all joints reach together, as soon as they can.

    Args:
        velocity: (n,) rad/s.
        acceleration: (n,) greatest, rad/s².
        period: s.

    Returns:
        Velocity (n,), rad/s, after the step; its direction stays as it was.
    """
    left = float(np.max(np.abs(velocity) / acceleration))
    return velocity * (1 - period / left) if left > period else np.zeros_like(velocity)
