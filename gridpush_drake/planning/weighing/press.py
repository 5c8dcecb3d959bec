"""How a fingertip presses on a part that hangs over the table's edge, up to the first sign of tilt.

    hovering --> taring --> pressing --> dwelling --> retreating --> done

The tip hovers over the place, and the force's offset is noted. Then it goes down slowly. While the
object lies still, an arm that is held by springs lets its tip stop and the force grow. As soon as
the object begins to tilt, the tip goes on as fast as it is commanded, and the force grows no more:
it is said to give way. The tip stops at once, the force is averaged for a moment, and the tip lets
go and goes up again: the object comes back, since its center of mass is still inside the edge.

An object that tilts needs less and less force, and a soft arm that is bent by the force would
follow it down. So at the tilt the tip's height is held: what is commanded is corrected, sample by
sample, by a share of how far the tip is off. And to let go, the tip is commanded to where it is,
so that the arm does not press any more at once.

What balances the weight is the moment about the edge. With the force f on the object, n the edge's
outward normal, a the tip's distance from the edge and h the height of the contact,

    F = -f_z + f·n h / a

is the force that would do the same straight down. As the object tilts, its top draws the tip along
by friction. A tip that is held against that presses with f·n, too, and may jam: so the place that
is commanded follows the tip sideways, as far from where it touched as a tilt draws the top,
h tan(t) at the greatest tilt t. There it is held, as its height is: an arm that is pushed sideways
by its own pressing would else creep on, and take the object along.

`advance_press` is a pure function from state and sample to state. `systems.edge_presser` puts it
between ports. Where it is safe to press is worked out in `plan`.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import StrEnum
from math import cos, isfinite, radians, sin, sqrt, tan

import numpy as np

from gridpush_drake.errors import PlanningError, require_positive
from gridpush_drake.frozen import Unchanging
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.pushes.weighings import FORCE_STD, EdgePress

HOVER_TOLERANCE = 0.0005
"""Distance from the hovering place, m, within which the tip has arrived there."""


ROUND_OFF = 0.002
"""Time by which a window of samples may be too short, s, for round-off in the times of samples."""


class PressPhase(StrEnum):
    """What a press is doing."""

    HOVERING = "hovering"
    TARING = "taring"
    PRESSING = "pressing"
    DWELLING = "dwelling"
    RETREATING = "retreating"
    DONE = "done"


class PressOutcome(StrEnum):
    """How a press ended."""

    TILTED = "tilted"
    TOO_HEAVY = "too_heavy"
    """The object lay still up to the greatest force."""
    NO_CONTACT = "no_contact"
    """The tip went below the object's top without meeting anything."""
    NO_FORCE = "no_force"
    """A force or a place that was measured was not finite."""
    MOVED = "moved"
    """The object was seen to move away while it was pressed."""
    BROKEN_OFF = "broken_off"
    """Whoever asked for the press took it back."""
    REFUSED = "refused"
    """The press was not begun: it makes no sense, or the arm does not get there."""


@dataclass(frozen=True)
class PressOptions:
    """How a press is made.

    Attributes:
        clearance: height over the object's top at which the tip hovers, m.
        approach_speed: speed in the air, m/s.
        descent_speed: speed of going down while the tip is higher than `slow_above` over the
            object's top, m/s.
        slow_above: height over the top from which on the tip goes down slowly, m; more than the
            height is uncertain by.
        tare_time: how long the force's offset is averaged, s.
        tilt_rate: rate at which the object tilts once it gives way, rad/s; it sets the speed.
        sure_speedup: factor on the speed while the force is less than the target's `sure_force`.
        notice_tilt: tilt within which giving way is noticed, rad.
        gives_way: share of the commanded descent that the tip must make for the object to give way.
        sink_share: share of the greatest tilt by which the tip may go down since it touched; from
            there on the object counts as giving way, too.
        touch_time: how long the force is averaged to see whether the tip touches, s.
        touch_force: mean force straight down from which the tip counts as touching, N.
        dwell_tilt: how much further than noticed the object is tilted while the force is averaged,
            rad. At the very beginning other feet than the edge may still bear.
        hold_gain: share of the error of the tip's height, and of its place where it is held
            sideways, by which the command is corrected in each sample.
        dwell_time: how long the force is averaged at the tilt, s.
        max_tilt: greatest tilt; the tip goes up at once if the object tilts further, rad.
        max_force: greatest force, N. If the object does not tilt with it, the press ends.
        force_time: how long the force is averaged to see whether it is as great as that, s. A stiff
            arm's force grows fast.
        max_depth: how far below the object's top the tip may go without touching, m.
        force_std: standard deviation of one sample of the force, per axis, N.
        force_floor: standard deviation of what averaging does not take away, N.
    """

    clearance: float = 0.004
    approach_speed: float = 0.1
    descent_speed: float = 0.015
    slow_above: float = 0.0015
    tare_time: float = 0.5
    tilt_rate: float = radians(5.0)
    sure_speedup: float = 3.0
    notice_tilt: float = radians(0.2)
    gives_way: float = 0.4
    sink_share: float = 0.6
    touch_time: float = 0.1
    touch_force: float = 0.35
    dwell_tilt: float = radians(0.15)
    hold_gain: float = 0.25
    dwell_time: float = 0.5
    max_tilt: float = radians(1.0)
    max_force: float = 50.0
    force_time: float = 0.02
    max_depth: float = 0.004
    force_std: float = FORCE_STD
    force_floor: float = 0.03

    def __post_init__(self) -> None:
        require_positive(PlanningError, "press: ", **vars(self))

    @property
    def window(self) -> float:
        """Time over which giving way is judged, s."""
        return self.notice_tilt / self.tilt_rate


@dataclass(frozen=True)
class PressTarget:
    """Where to press.

    Attributes:
        place: (x, y) where the tip presses, W, m.
        edge_point: (x, y) of a point of the edge, W, m.
        edge_angle: direction of the edge's outward normal, rad.
        top: height of the object's top above the table, m.
        tip_radius: radius of the tip's sphere, m.
        sure_force: force up to which the object surely lies still, by all that is known of it, N.
            Up to there the tip presses faster.
    """

    place: tuple[float, float]
    edge_point: tuple[float, float]
    edge_angle: float
    top: float
    tip_radius: float
    sure_force: float = 0.0

    @property
    def hover(self) -> Array:
        """(3,) where the tip's center touches the object's top, p_WP, m."""
        return np.array([*self.place, self.top + self.tip_radius])

    @property
    def normal(self) -> Array:
        """(2,) the edge's outward unit normal, W."""
        return np.array([cos(self.edge_angle), sin(self.edge_angle)])

    def calc_arm(self, tip: Array) -> float:
        """Calculates how far beyond the edge a place (2,) or (3,) of the tip is, m."""
        return float(self.normal @ (tip[:2] - np.array(self.edge_point)))


@dataclass(frozen=True, eq=False)
class PressSample:
    """What is measured at one moment.

    Attributes:
        time: s.
        tip: (3,) place p_WP of the tip's center, m.
        force: (3,) on the tip, W, N.
    """

    time: float
    tip: Array
    force: Array


@dataclass(frozen=True, eq=False)
class PressState(Unchanging):
    """All that a press remembers; never changed, only replaced.

    Attributes:
        phase: what it is doing.
        outcome: how it ended; None before.
        command: (3,) where the tip is to be now, m; None before the first sample.
        velocity: (3,) how fast it is to move, m/s.
        since: when the phase began, s.
        last: when the last sample was taken, s.
        tare: mean force before the tip touched, (3,), N, and the number of samples in it.
        window: the latest samples, each with the height commanded then, m.
        touched: when the tip began to touch, s; None before.
        start_height: height of the tip as it began to touch, m.
        hold: (3,) place about which the tip is held, m: where it touched and, at the tilt, lower.
        forces: straight-down forces F of the samples at the tilt, N.
        places: (x, y) of the tip at these, m.
        tilt: greatest tilt that the tip's descent says, rad.
    """

    phase: PressPhase = PressPhase.HOVERING
    outcome: PressOutcome | None = None
    command: Array | None = None
    velocity: Array = field(default_factory=lambda: np.zeros(3))
    since: float = 0.0
    last: float = 0.0
    tare: tuple[Array, int] = field(default_factory=lambda: (np.zeros(3), 0))
    window: tuple[tuple[PressSample, float], ...] = ()
    touched: float | None = None
    start_height: float = 0.0
    hold: Array = field(default_factory=lambda: np.zeros(3))
    forces: tuple[float, ...] = ()
    places: tuple[tuple[float, float], ...] = ()
    tilt: float = 0.0

    @property
    def over(self) -> bool:
        """Whether the press has ended and the tip is up again."""
        return self.phase == PressPhase.DONE

    def make_weighing(
        self, target: PressTarget, options: PressOptions, pose: Array
    ) -> EdgePress | None:
        """Makes the weighing of a press that ended with a tilt; None of another.

        Args:
            target: where it pressed.
            options: how.
            pose: (3,) X_WB of the object, as it was seen, m and rad.
        """
        if self.outcome != PressOutcome.TILTED or not self.forces:
            return None
        force = float(np.mean(self.forces))
        if force < options.touch_force:
            return None
        place = np.mean(self.places, axis=0)
        # Forces along the normal count by h / a.
        share = target.top / target.calc_arm(place)
        samples = 1 / len(self.forces) + 1 / max(self.tare[1], 1)
        variance = options.force_std**2 * (1 + share**2) * samples + options.force_floor**2
        return EdgePress(
            pose=pose,
            place=place,
            force=force,
            edge_point=np.array(target.edge_point),
            edge_angle=target.edge_angle,
            force_std=sqrt(variance),
        )


def advance_press(
    target: PressTarget, options: PressOptions, now: PressState, sample: PressSample
) -> PressState:
    """Carries a press on by one sample.

    Args:
        target: where to press.
        options: how.
        now: the state so far.
        sample: what is measured.

    Returns:
        The state then, with what is commanded.
    """
    if now.phase == PressPhase.DONE:
        return now
    if now.command is None:
        # The first sample says where the tip is.
        now = replace(now, command=sample.tip, since=sample.time, last=sample.time)
    measured = [*sample.tip.tolist(), *sample.force.tolist()]
    if not all(map(isfinite, measured)):
        if now.phase == PressPhase.RETREATING:
            return replace(now, last=sample.time)
        return _retreat(now, sample, PressOutcome.NO_FORCE)
    after = PHASES[now.phase](target, options, now, sample)
    return replace(after, last=sample.time)


def break_off(now: PressState, sample: PressSample, outcome: PressOutcome) -> PressState:
    """Ends a press early: the tip lets go and goes up.

    Args:
        now: the state so far.
        sample: what is measured.
        outcome: why it ends.

    Returns:
        The state then; `now` itself where the tip is on its way up already.
    """
    if now.phase in (PressPhase.RETREATING, PressPhase.DONE):
        return now
    return _retreat(now, sample, outcome)


def _hover(
    target: PressTarget, options: PressOptions, now: PressState, sample: PressSample
) -> PressState:
    """Moves the tip over the place."""
    goal = target.hover + np.array([0.0, 0.0, options.clearance])
    after = _move(now, sample, goal, options.approach_speed)
    if np.linalg.norm(sample.tip - goal) < HOVER_TOLERANCE:
        return replace(after, phase=PressPhase.TARING, since=sample.time)
    return after


def _tare(
    target: PressTarget, options: PressOptions, now: PressState, sample: PressSample
) -> PressState:
    """Averages the force while nothing is touched."""
    mean, count = now.tare
    tare = (mean + (sample.force - mean) / (count + 1), count + 1)
    after = replace(now, tare=tare, velocity=np.zeros(3))
    if sample.time - now.since >= options.tare_time:
        return replace(after, phase=PressPhase.PRESSING, since=sample.time)
    return after


def _press(
    target: PressTarget, options: PressOptions, now: PressState, sample: PressSample
) -> PressState:
    """Goes down, and looks for the object to give way."""
    assert now.command is not None
    speed = options.tilt_rate * target.calc_arm(sample.tip)
    if now.touched is None and sample.tip[2] > target.hover[2] + options.slow_above:
        speed = max(speed, options.descent_speed)
    if now.touched is not None:
        now = _give_sideways(target, options, now, sample)
    assert now.command is not None
    window = (*now.window, (sample, float(now.command[2])))
    while sample.time - window[0][0].time > max(options.touch_time, options.window) + ROUND_OFF:
        window = window[1:]

    # The offset is known better than the noise of a few samples, but only straight down.
    felt = [one.force[2] for one, _ in window if sample.time - one.time <= options.touch_time]
    force = float(np.mean(felt)) - float(now.tare[0][2])
    if now.touched is not None and force < target.sure_force:
        speed *= options.sure_speedup
    moved = _move(now, sample, now.command - np.array([0.0, 0.0, 1.0]), speed)

    # Is the tip where something should have been met?
    is_full = sample.time - window[0][0].time >= options.touch_time - ROUND_OFF
    touches = is_full and force >= options.touch_force
    if not touches and sample.tip[2] < target.hover[2] - options.max_depth:
        return _retreat(moved, sample, PressOutcome.NO_CONTACT)
    latest = [one.force[2] for one, _ in window if sample.time - one.time <= options.force_time]
    if float(np.mean(latest)) - float(now.tare[0][2]) >= options.max_force:
        return _retreat(moved, sample, PressOutcome.TOO_HEAVY)

    # It gives way if the tip goes on as it is commanded, and did not just come through the air.
    touched = now.touched
    height_then = now.start_height
    if touches and touched is None:
        touched = sample.time
        height_then = float(sample.tip[2])
        moved = replace(moved, hold=sample.tip)
    moved = replace(moved, window=window, touched=touched, start_height=height_then)
    if touched is None or sample.time - touched < options.window:
        return moved
    first, height = next(
        pair
        for pair in reversed(window)
        if sample.time - pair[0].time >= options.window - ROUND_OFF
    )
    wanted = height - float(now.command[2])
    made = float(first.tip[2] - sample.tip[2])
    arm = target.calc_arm(sample.tip)
    sank = height_then - float(sample.tip[2]) > options.sink_share * options.max_tilt * arm
    if made < options.gives_way * wanted and not sank:
        return moved
    return replace(
        now,
        phase=PressPhase.DWELLING,
        velocity=np.zeros(3),
        since=sample.time,
        hold=np.array([*moved.hold[:2], sample.tip[2] - options.dwell_tilt * arm]),
        window=(),
    )


def _dwell(
    target: PressTarget, options: PressOptions, now: PressState, sample: PressSample
) -> PressState:
    """Averages the force at the tilt, and watches that the object does not tilt further."""
    tilt = (now.start_height - float(sample.tip[2])) / target.calc_arm(sample.tip)
    after = replace(
        _hold(target, options, now, sample),
        forces=(*now.forces, _calc_force(target, now, sample)),
        places=(*now.places, (float(sample.tip[0]), float(sample.tip[1]))),
        tilt=max(now.tilt, tilt),
    )
    if tilt > options.max_tilt or sample.time - now.since >= options.dwell_time:
        return _retreat(after, sample, PressOutcome.TILTED)
    return after


def _go_up(
    target: PressTarget, options: PressOptions, now: PressState, sample: PressSample
) -> PressState:
    """Moves the tip up again."""
    goal = target.hover + np.array([0.0, 0.0, options.clearance])
    after = _move(now, sample, goal, options.approach_speed)
    if sample.tip[2] > goal[2] - HOVER_TOLERANCE:
        return replace(after, phase=PressPhase.DONE, velocity=np.zeros(3))
    return after


PHASES: dict[
    PressPhase, Callable[[PressTarget, PressOptions, PressState, PressSample], PressState]
] = {
    PressPhase.HOVERING: _hover,
    PressPhase.TARING: _tare,
    PressPhase.PRESSING: _press,
    PressPhase.DWELLING: _dwell,
    PressPhase.RETREATING: _go_up,
}
"""How each phase but the last is carried on."""


def _calc_force(target: PressTarget, now: PressState, sample: PressSample) -> float:
    """Calculates F, the force straight down that has the same moment about the edge, N."""
    # What the object feels is the opposite of what the tip does.
    f = now.tare[0] - sample.force
    height = float(sample.tip[2]) - target.tip_radius
    return float(-f[2] + f[:2] @ target.normal * height / target.calc_arm(sample.tip))


def _move(now: PressState, sample: PressSample, goal: Array, speed: float) -> PressState:
    """Moves the command towards a goal (3,), m, at a speed, m/s."""
    assert now.command is not None
    way = goal - now.command
    length = float(np.linalg.norm(way))
    step = speed * (sample.time - now.last)
    if length <= step:
        return replace(now, command=goal, velocity=np.zeros(3))
    direction = way / length
    return replace(now, command=now.command + step * direction, velocity=speed * direction)


def _give_sideways(
    target: PressTarget, options: PressOptions, now: PressState, sample: PressSample
) -> PressState:
    """Lets the command follow the tip sideways as far as a tilt draws it, and holds it there."""
    assert now.command is not None
    farthest = target.top * tan(options.max_tilt)
    off = sample.tip[:2] - now.hold[:2]
    distance = float(np.linalg.norm(off))
    place = sample.tip[:2]
    if distance > farthest:
        limit = now.hold[:2] + farthest / distance * off
        place = now.command[:2] + options.hold_gain * (limit - sample.tip[:2])
    return replace(now, command=np.array([*place, now.command[2]]))


def _hold(
    target: PressTarget, options: PressOptions, now: PressState, sample: PressSample
) -> PressState:
    """Corrects the command so that the tip stays at one height, and near one place."""
    followed = _give_sideways(target, options, now, sample)
    assert followed.command is not None
    rise = options.hold_gain * float(now.hold[2] - sample.tip[2])
    return replace(followed, command=followed.command + np.array([0.0, 0.0, rise]))


def _retreat(now: PressState, sample: PressSample, outcome: PressOutcome) -> PressState:
    """Lets go, with an outcome: the tip is commanded to where it is, and then upwards."""
    command = now.command
    if np.isfinite(sample.tip).all():
        command = sample.tip
    return replace(
        now,
        phase=PressPhase.RETREATING,
        outcome=outcome,
        command=command,
        since=sample.time,
        velocity=np.zeros(3),
    )
