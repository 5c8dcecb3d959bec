"""How an arm goes back from a collision: along the way that it has come, slowly and not far.

`ArmGuard` brakes the arm first, and asks these functions for each command of the way back. The way
itself is planned by `arm_path`.
"""

from dataclasses import dataclass, replace

import numpy as np

from gridpush_drake.frozen import Unchanging
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.systems.safety.arm_path import (
    ArmPath,
    CalcTip,
    RetreatPath,
    follow,
    keep_stoppable,
)
from gridpush_drake.systems.safety.arm_watch import ArmWatch, GuardInputs
from gridpush_drake.systems.safety.guard_status import (
    COLLISION_KINDS,
    Fault,
    GuardLimits,
    GuardStatus,
)

RETREAT_SPEED_FRACTION = 0.1
"""Fraction of its speed limit at which a joint goes back, at most, after a collision."""

RETREAT_ACCELERATION_FRACTION = 0.5
"""Fraction of its greatest acceleration with which a joint sets out on the way back, and comes to
rest at its end; the rest is left for the way's bends."""

RETREAT_TIP_SPEED = 0.05
"""Speed at which the finger's tip goes back, at most, after a collision, m/s."""

RELIEF_TIME = 0.1
"""How long after a collision, s, torques and forces may still rise: the arm has to brake first, and
its estimate of them comes late. After that a retreat ends where they rise further, or again."""

RELIEVED_FRACTION = 0.8
"""An arm is relieved where torques and forces are below this fraction of what is allowed."""

AT_REST = 1e-9
"""Velocity of a commanded joint, rad/s or m/s, below which rounding errors alone are left."""

TRAVEL_ROUNDING = 1e-8
"""Ways of the tip that differ by less than this are the same, m: bends are measured in straight
pieces."""


@dataclass(frozen=True, eq=False)
class Retreat(Unchanging):
    """How an arm goes back from a collision.

    Attributes:
        way: the way back; None until the arm has braked.
        gone: time for which the arm has gone along the way, s.
        traveled: distance by which the tip has been commanded to go back, m.
        ended: whether the arm brakes for good, since it would otherwise go farther than it may.
        worst: greatest torque or force so far, as a fraction of its limit.
        relieved: whether torques and forces have been within their limits since.
    """

    way: RetreatPath | None = None
    gone: float = 0.0
    traveled: float = 0.0
    ended: bool = False
    worst: float = 0.0
    relieved: bool = False


def find_further_collisions(
    watch: ArmWatch, status: GuardStatus, retreat: Retreat | None, inputs: GuardInputs
) -> list[Fault]:
    """Finds torques and forces over their limits that are not what the arm was stopped for.

    After a collision these are the ones that rise further although the arm goes back, or rise
    again.

    Args:
        watch: finds the collisions.
        status: says what the arm was stopped for.
        retreat: how the arm goes back; None if it does not.
        inputs: what is on the ports.
    """
    kinds = status.kinds
    if kinds[0] not in COLLISION_KINDS:
        return [fault for fault in watch.find_collisions(inputs) if fault.kind not in kinds]
    if sum(kind in COLLISION_KINDS for kind in kinds) > 1:
        return []
    retreat = retreat or Retreat()
    overdue = inputs.time - status.since > RELIEF_TIME
    load = watch.calc_load(inputs)
    if retreat.relieved or (overdue and load > retreat.worst):
        return watch.find_collisions(inputs)[:1]
    return []


def note_relief(retreat: Retreat, load: float, passed: float) -> Retreat:
    """Takes in how strongly something still presses on the arm after a collision.

    Args:
        retreat: how the arm goes back.
        load: greatest torque or force now, as a fraction of its limit.
        passed: time since the arm was stopped, s.
    """
    worst = max(retreat.worst, load) if passed <= RELIEF_TIME else retreat.worst
    relieved = retreat.relieved or load < RELIEVED_FRACTION
    if worst == retreat.worst and relieved == retreat.relieved:
        return retreat
    return replace(retreat, worst=worst, relieved=relieved)


def plan_retreat(
    path: ArmPath, position: Array, limits: GuardLimits, calc_tip: CalcTip
) -> RetreatPath:
    """Plans the way back from where the commands (n,), rad, have come to rest."""
    acceleration = RETREAT_ACCELERATION_FRACTION * limits.acceleration
    return path.plan_retreat(
        position,
        distance=limits.retreat,
        speed=RETREAT_SPEED_FRACTION * limits.speed,
        tip_speed=RETREAT_TIP_SPEED,
        ramp=float(np.max(RETREAT_SPEED_FRACTION * limits.speed / acceleration)),
        calc_tip=calc_tip,
    )


@dataclass(frozen=True, eq=False)
class StepBack:
    """One command of the way back.

    Attributes:
        retreat: how the arm goes back after it; `ended` if the arm must brake instead.
        position: (n,) the command, rad.
        velocity: (n,) its velocity, rad/s.
    """

    retreat: Retreat
    position: Array
    velocity: Array


def go_back(
    retreat: Retreat,
    way: RetreatPath,
    position: Array,
    velocity: Array,
    limits: GuardLimits,
    period: float,
    calc_tip: CalcTip,
) -> StepBack:
    """Makes the next command along the way back.

    The commands may cut a bend of the way, or run a little wide of it. So that the tip still
    goes no farther than it may, each command leaves room to brake after it.

    Args:
        retreat: how the arm goes back.
        way: the way.
        position: (n,) the last command, rad.
        velocity: (n,) its velocity, rad/s.
        limits: what is allowed.
        period: of the commands, s.
        calc_tip: the arm's forward kinematics.

    Returns:
        The command; the last one again, with a retreat that has ended, where the tip would go too
        far.
    """
    gone = min(retreat.gone + period, way.duration)
    _, next_velocity = follow(
        position=position,
        velocity=velocity,
        before=way.calc_position(retreat.gone),
        target=way.calc_position(gone),
        speed=RETREAT_SPEED_FRACTION * limits.speed,
        acceleration=limits.acceleration,
        period=period,
    )
    next_velocity = keep_stoppable(
        position,
        next_velocity,
        limits.position_lower,
        limits.position_upper,
        limits.acceleration,
        period,
    )
    next_position = position + period * next_velocity
    # How far the tip has gone by then, and would go until it has braked.
    braking_time = float(np.max(np.abs(next_velocity) / limits.acceleration))
    tip = calc_tip(next_position)
    step = float(np.linalg.norm(tip - calc_tip(position)))
    rest = calc_tip(next_position + next_velocity * braking_time / 2)
    traveled = retreat.traveled + step
    if traveled + float(np.linalg.norm(rest - tip)) > limits.retreat + TRAVEL_ROUNDING:
        return StepBack(replace(retreat, ended=True), position, velocity)
    if retreat.gone >= way.duration and np.abs(next_velocity).max() < AT_REST:
        next_velocity = np.zeros_like(next_velocity)
    retreat = replace(retreat, gone=gone, traveled=traveled)
    return StepBack(retreat, next_position, next_velocity)
