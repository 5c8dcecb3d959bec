"""How a fingertip presses on a part that hangs over the table's edge, until the object tilts there.

    hovering --> taring --> pressing --> dwelling --> following --> retreating --> done
                               ^                          |
                               +---- stiff again ---------+

The tip hovers over the place, and the force's offset is noted. Then it goes down slowly. While the
object lies still, an arm that is held by springs lets its tip stop and the force grow. As soon as
the object begins to tilt, the tip goes on as fast as it is commanded, and the force grows no more:
it is said to give way. The tip stops, and the force is averaged for a moment: that is a plateau of
the force over the way.

An object with a flat bottom tilts about the edge. One that stands on feet first rocks about the
line of two of them, at a smaller force, until its underside meets the edge. So the tip follows on
downwards. If the force rises again, the object was only rocking: the next plateau is looked for. If
it does not up to the greatest tilt that is safe, the last plateau is taken for that about the edge;
how far the tip went on freely is noted with it, and what that says is judged in
`identification.absolute.estimate`. Then the tip goes up, slowly while it still touches, and the
object comes back, since its center of mass is still inside the edge.

An object that tilts needs less and less force, and a soft arm that is bent by the force would
follow it down. So while the force is averaged, the tip's height is held: what is commanded is
corrected, sample by sample, by a fraction of how far the tip is off. A press that is ended early is
commanded to where the tip is, so that the arm does not press any more at once.

What balances the weight is the moment about the edge. With the force f on the object, n the edge's
outward normal, a the tip's distance from the edge and h the height of the contact,

    F = -f_z + f·n h / a

is the force that would do the same straight down. (On a top that is tilted by t, a tip of radius r
touches r sin t nearer to the edge than its center is, which counts as well.) As the object tilts,
its top draws the tip along by friction. A tip that is held against that presses with f·n, too, and
may jam: so the place that is commanded follows the tip outward, up to 0.2 mm from where the tilt t
draws the top, which is h tan(t). There, and along the edge in any case, the tip is held, as its
height is: an arm that is pushed sideways by its own pressing would else creep on, and take the
object along. A tip that is drawn farther than the tilt says slides on the object, or the object on
the table: the press has ended as slid, and tells nothing of the weight.

`advance_press` is a pure function from state and sample to state. `systems.execution.edge_presser`
puts it between ports. Where it is safe to press is worked out in `plan`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from math import cos, inf, isfinite, radians, sin, sqrt, tan

import numpy as np

from gridpush_drake.errors import PlanningError, require_positive
from gridpush_drake.frozen import Unchanging
from gridpush_drake.geometry.se2 import Array, transform_back, wrap_angle
from gridpush_drake.identification.absolute.estimate import LINE_DISTANCE
from gridpush_drake.pushes.weighings import FORCE_STD, TiltTest

HOVER_TOLERANCE = 0.0005
"""Distance from the hovering place, m, within which the tip has arrived there."""


SLID_DISTANCE = 0.004
"""Distance, m, from where an object was seen before a press to where it is seen afterwards, beyond
which it slid: four standard deviations of a seen position."""

SLID_ANGLE = radians(1.5)
"""Change of an object's seen heading by a press, rad, beyond which it slid: five standard
deviations of a seen heading."""

CENTER_HEIGHT = 0.5
"""Height of a center of mass as a fraction of the object's, as it is supposed: it says how far a
tilt moves the center outwards."""

RATE_GAIN = 0.3
"""Fraction of a new sample in the smoothed speed of the tip."""

BRAKING_FACTOR = 4.0
"""Factor on the speed of a tip that still goes down while it lets an object come back, with which
it is commanded upwards besides."""

RISE_PARTS = 3
"""Number of parts of a plateau of the force; the first and the last one are compared."""

ROUND_OFF = 0.002
"""Time by which a window of samples may be too short, s, for round-off in the times of samples."""


class PressPhase(StrEnum):
    """What a press is doing."""

    HOVERING = "hovering"
    TARING = "taring"
    PRESSING = "pressing"
    DWELLING = "dwelling"
    FOLLOWING = "following"
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
    SLID = "slid"
    """The tip slid on the object, or the object shifted or yawed under it."""
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
        no_tip_speedup: factor on the speed while the force is less than the target's
            `no_tip_force`.
        notice_tilt: tilt within which giving way is noticed, rad.
        gives_way: fraction of the commanded descent that the tip must make for the object to give
            way.
        sink_tilt: tilt up to which the tip may go down while the object is stiff, rad; from there
            on the object counts as giving way, too.
        touch_time: how long the force is averaged to see whether the tip touches, s.
        touch_force: mean force straight down from which the tip counts as touching, N.
        dwell_tilt: how much further than noticed the object is tilted while the force is averaged,
            rad. At the very beginning other feet than the edge may still bear.
        hold_gain: fraction of the error of the tip's height, and of its place where it is held
            sideways, by which the command is corrected in each sample.
        dwell_time: how long the force is averaged at the tilt, s.
        max_tilt: tilt up to which the tip follows an object that gives way, rad, as the tip's
            descent says it.
        spare_tilt: further tilt in which a plateau of the force that began before may end, rad.
        look_ahead: time by which the tilt is foreseen, s.
        stiff_fraction: fraction of a plateau's force by which the force must rise for the object to
            be stiff again.
        stiff_force: least such rise, N.
        max_plateaus: greatest number of forces at which the object may give way; then it is let
            come back.
        follow_time: how long the force is averaged to see whether it rises, s.
        lowering_rate: rate at which an object is let come back, rad/s.
        follow_room: how far from where a tilt draws it the command follows the tip outward, m.
            Beyond it the tip is held: an arm that is bent by its own pressing would creep on.
        slide_room: how much farther sideways the tip may be drawn than a tilt draws it, m. Beyond
            it, something slid.
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
    no_tip_speedup: float = 3.0
    notice_tilt: float = radians(0.2)
    gives_way: float = 0.4
    sink_tilt: float = radians(0.6)
    touch_time: float = 0.1
    touch_force: float = 0.35
    dwell_tilt: float = radians(0.15)
    hold_gain: float = 0.25
    dwell_time: float = 0.5
    max_tilt: float = radians(4.0)
    spare_tilt: float = radians(1.0)
    look_ahead: float = 0.1
    stiff_fraction: float = 0.04
    stiff_force: float = 0.3
    follow_time: float = 0.15
    max_plateaus: int = 6
    lowering_rate: float = radians(10.0)
    follow_room: float = 0.0002
    slide_room: float = 0.002
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
        no_tip_force: force up to which the object surely lies still, by all that is known of it, N.
            Up to there the tip presses faster.
    """

    place: tuple[float, float]
    edge_point: tuple[float, float]
    edge_angle: float
    top: float
    tip_radius: float
    no_tip_force: float = 0.0

    @property
    def hover(self) -> Array:
        """(3,) where the tip's center touches the object's top, p_WP, m."""
        return np.array([*self.place, self.top + self.tip_radius])

    @property
    def normal(self) -> Array:
        """(2,) the edge's outward unit normal, W."""
        return np.array([cos(self.edge_angle), sin(self.edge_angle)])

    def calc_lever_arm(self, tip: Array) -> float:
        """Calculates how far beyond the edge a place (2,) or (3,) of the tip is, m."""
        return float(self.normal @ (tip[:2] - np.array(self.edge_point)))

    def find_on(self, pose: Sequence[float] | Array) -> tuple[float, float]:
        """Finds the place on an object at a pose (3,), in the object's body frame, m."""
        x, y = transform_back(np.array(pose), np.array([self.place]))[0].tolist()
        return x, y


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
class Plateau:
    """A force at which an object gave way.

    Attributes:
        force: mean of F, N.
        place: (2,) mean place of the tip, W, m.
        samples: number of samples in both.
        height: height of the tip as the object began to give way, m.
        tilt: mean tilt that the tip's descent says, rad.
    """

    force: float
    place: Array
    samples: int
    height: float
    tilt: float


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
        stiff_height: height of the tip as the object was last found stiff, m.
        lowest: least height of the tip so far, m.
        sink_rate: how fast the tip goes down, smoothed over some samples, m/s.
        last_height: height of the tip in the last sample, m; None before.
        hold: (3,) place about which the tip is held, m: where it touched and, at the tilt, lower.
        forces: straight-down forces F of the samples since the object gave way, N.
        places: (x, y, z) of the tip at these, m.
        plateaus: the forces at which the object gave way so far. All but the last one were followed
            by a rise of the force.
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
    stiff_height: float = 0.0
    lowest: float = inf
    sink_rate: float = 0.0
    last_height: float | None = None
    hold: Array = field(default_factory=lambda: np.zeros(3))
    forces: tuple[float, ...] = ()
    places: tuple[tuple[float, float, float], ...] = ()
    plateaus: tuple[Plateau, ...] = ()
    tilt: float = 0.0

    @property
    def over(self) -> bool:
        """Whether the press has ended and the tip is up again."""
        return self.phase == PressPhase.DONE

    def make_weighing(
        self, target: PressTarget, options: PressOptions, pose: Array
    ) -> TiltTest | None:
        """Makes the weighing of a press that ended with a tilt; None of another.

        Args:
            target: where it pressed.
            options: how.
            pose: (3,) X_WB of the object, as it was seen, m and rad.
        """
        if self.outcome != PressOutcome.TILTED or not self.plateaus:
            return None
        last = self.plateaus[-1]
        if last.force < options.touch_force:
            return None
        # Forces along the normal count by h / a.
        fraction = target.top / target.calc_lever_arm(last.place)
        samples = 1 / last.samples + 1 / max(self.tare[1], 1)
        variance = options.force_std**2 * (1 + fraction**2) * samples + options.force_floor**2
        return TiltTest(
            pose=pose,
            place=last.place,
            force=last.force,
            edge_point=np.array(target.edge_point),
            edge_angle=target.edge_angle,
            force_std=sqrt(variance),
            center_shift=CENTER_HEIGHT * target.top * tan(last.tilt),
            free_way=max(last.height - self.lowest, 0.0),
            rock_force=self.plateaus[0].force if len(self.plateaus) > 1 else None,
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
    now = _note_rate(now, sample)
    after = PHASE_STEPS[now.phase](target, options, now, sample)
    if now.phase in SLIDING_PHASES and _is_drawn_away(target, options, after, sample):
        after = _retreat(after, sample, PressOutcome.SLID)
    return replace(after, last=sample.time)


def has_slid(
    before: Array, after: Array, distance: float = SLID_DISTANCE, angle: float = SLID_ANGLE
) -> bool:
    """Says whether an object was shifted or turned by a press.

    Args:
        before: (3,) X_WB as it was seen at rest before the press, m and rad.
        after: (3,) X_WB as it is seen at rest afterwards; NaN where it is not seen.
        distance: how far it may seem to be shifted by the noise of the poses, m.
        angle: how far it may seem to be turned, rad.
    """
    off = after - before
    turn = wrap_angle(off[2])
    return bool(np.linalg.norm(off[:2]) > distance or abs(turn) > angle)


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
    speed = options.tilt_rate * target.calc_lever_arm(sample.tip)
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
    if now.touched is not None and force < target.no_tip_force:
        speed *= options.no_tip_speedup
    moved = _move(now, sample, now.command - np.array([0.0, 0.0, 1.0]), speed)

    # Is the tip where something should have been met?
    is_full = sample.time - window[0][0].time >= options.touch_time - ROUND_OFF
    touches = is_full and force >= options.touch_force
    too_low = sample.tip[2] < target.hover[2] - options.max_depth
    if now.touched is None and not touches and too_low:
        return _retreat(moved, sample, PressOutcome.NO_CONTACT)
    latest = [one.force[2] for one, _ in window if sample.time - one.time <= options.force_time]
    if float(np.mean(latest)) - float(now.tare[0][2]) >= options.max_force:
        return _retreat(moved, sample, PressOutcome.TOO_HEAVY)
    moved = replace(moved, window=window)
    if touches and now.touched is None:
        height = float(sample.tip[2])
        moved = replace(
            moved, touched=sample.time, start_height=height, stiff_height=height, hold=sample.tip
        )
    if not _gives_way(target, options, moved, sample):
        return moved
    arm = target.calc_lever_arm(sample.tip)
    return replace(
        now,
        phase=PressPhase.DWELLING,
        velocity=np.zeros(3),
        since=sample.time,
        hold=np.array([*moved.hold[:2], sample.tip[2] - options.dwell_tilt * arm]),
        window=(),
        forces=(),
        places=(),
    )


def _gives_way(
    target: PressTarget, options: PressOptions, now: PressState, sample: PressSample
) -> bool:
    """Says whether the tip goes on as it is commanded, and did not just come through the air."""
    if now.touched is None or sample.time - now.touched < options.window:
        return False
    old = [pair for pair in now.window if sample.time - pair[0].time >= options.window - ROUND_OFF]
    if not old:
        return False
    first, height = old[-1]
    # The last height in the window is what was commanded for this sample.
    wanted = height - now.window[-1][1]
    made = float(first.tip[2] - sample.tip[2])
    sunk = now.stiff_height - float(sample.tip[2])
    return made >= options.gives_way * wanted or sunk > options.sink_tilt * target.calc_lever_arm(
        sample.tip
    )


def _dwell(
    target: PressTarget, options: PressOptions, now: PressState, sample: PressSample
) -> PressState:
    """Averages the force at the tilt, and watches that the object does not tilt further."""
    tilt = _calc_tilt(target, now, sample.tip)
    after = replace(
        _hold(target, options, now, sample),
        forces=(*now.forces, _calc_force(target, now, sample)),
        places=(*now.places, (float(sample.tip[0]), float(sample.tip[1]), float(sample.tip[2]))),
        tilt=max(now.tilt, tilt),
        lowest=min(now.lowest, float(sample.tip[2])),
    )
    too_far = _foresee_tilt(target, options, now, sample) > options.max_tilt + options.spare_tilt
    if not too_far and sample.time - now.since < options.dwell_time:
        return after
    if not too_far and _has_risen(options, np.array(after.forces)):
        # The underside met the edge meanwhile: this was no plateau.
        return _press_on(after, sample)
    height = float(now.hold[2]) + options.dwell_tilt * target.calc_lever_arm(sample.tip)
    plateau = _average(target, after, height, len(after.forces))
    after = replace(after, plateaus=(*now.plateaus, plateau))
    if tilt > options.max_tilt:
        return _lower(after, sample)
    return replace(
        after, phase=PressPhase.FOLLOWING, since=sample.time, window=(), forces=(), places=()
    )


def _follow(
    target: PressTarget, options: PressOptions, now: PressState, sample: PressSample
) -> PressState:
    """Goes on downwards with an object that gave way, until it is stiff again or tilted enough."""
    now = _give_sideways(target, options, now, sample)
    assert now.command is not None
    speed = options.tilt_rate * target.calc_lever_arm(sample.tip)
    moved = _move(now, sample, now.command - np.array([0.0, 0.0, 1.0]), speed)
    tilt = _calc_tilt(target, now, sample.tip)
    after = replace(
        moved,
        forces=(*now.forces, _calc_force(target, now, sample)),
        places=(*now.places, (float(sample.tip[0]), float(sample.tip[1]), float(sample.tip[2]))),
        tilt=max(now.tilt, tilt),
        lowest=min(now.lowest, float(sample.tip[2])),
    )
    # The force of the last moment, in a window of as many samples as that time has.
    plateau = now.plateaus[-1]
    period = max(sample.time - now.last, ROUND_OFF)
    count = round(options.follow_time / period)
    force = float(np.mean(after.forces[-count:]))
    rise = max(options.stiff_force, options.stiff_fraction * plateau.force)
    stiff = len(after.forces) >= count and force - plateau.force > rise
    if stiff and len(now.plateaus) < options.max_plateaus:
        return _press_on(after, sample)
    # A heavy object on a soft arm swings on.
    if _foresee_tilt(target, options, now, sample) <= options.max_tilt and not stiff:
        return after
    # While the object began to tilt, other feet than the edge may still have borne a little. The
    # force is that of the end, if there are samples enough.
    if len(after.forces) >= count:
        last = _average(target, after, plateau.height, round(options.dwell_time / period))
        after = replace(after, plateaus=(*now.plateaus[:-1], last))
    return _lower(after, sample)


def _average(target: PressTarget, now: PressState, height: float, count: int) -> Plateau:
    """Averages the last samples, as many as `count`, of a plateau that began at a height, m."""
    places = np.array(now.places[-count:])
    place = places.mean(axis=0)
    return Plateau(
        force=float(np.mean(now.forces[-count:])),
        place=place[:2],
        samples=len(places),
        height=height,
        tilt=max(_calc_tilt(target, now, place), 0.0),
    )


def _press_on(now: PressState, sample: PressSample) -> PressState:
    """Presses on an object that is stiff again."""
    return replace(
        now,
        phase=PressPhase.PRESSING,
        since=sample.time,
        stiff_height=float(sample.tip[2]),
        window=(),
        velocity=np.zeros(3),
    )


def _has_risen(options: PressOptions, forces: Array) -> bool:
    """Says whether the force rose while it was averaged, as where an object gets stiff again."""
    part = len(forces) // RISE_PARTS
    if part == 0:
        return False
    first = float(forces[:part].mean())
    rise = max(options.stiff_force, options.stiff_fraction * first)
    return float(forces[-part:].mean()) - first > rise


def _calc_tilt(target: PressTarget, now: PressState, tip: Array) -> float:
    """Calculates the tilt that the descent of the tip to a place (3,), m, says, rad.

    Since the object was last stiff it tilts about the edge. Before that it rocked, about lines of
    supports inside the edge, and tilted by less.
    """
    arm = target.calc_lever_arm(tip)
    rocked = (now.start_height - now.stiff_height) / (arm + LINE_DISTANCE)
    return (now.stiff_height - float(tip[2])) / arm + rocked


def _foresee_tilt(
    target: PressTarget, options: PressOptions, now: PressState, sample: PressSample
) -> float:
    """Calculates the tilt, rad, that is reached a little later if the tip goes on as fast."""
    tilt = _calc_tilt(target, now, sample.tip)
    return tilt + options.look_ahead * max(now.sink_rate, 0.0) / target.calc_lever_arm(sample.tip)


def _note_rate(now: PressState, sample: PressSample) -> PressState:
    """Notes how fast the tip goes down."""
    height = float(sample.tip[2])
    rate = now.sink_rate
    if now.last_height is not None and sample.time > now.last:
        latest = (now.last_height - height) / (sample.time - now.last)
        rate += RATE_GAIN * (latest - rate)
    return replace(now, sink_rate=rate, last_height=height)


def _is_drawn_away(
    target: PressTarget, options: PressOptions, now: PressState, sample: PressSample
) -> bool:
    """Says whether the tip was drawn farther sideways than a tilt of the object draws it."""
    if now.touched is None:
        return False
    off = float(np.linalg.norm(sample.tip[:2] - now.hold[:2]))
    return off > _calc_drawn(target, now, sample) + options.slide_room


def _calc_drawn(target: PressTarget, now: PressState, sample: PressSample) -> float:
    """Calculates how far sideways the tilt that the tip's descent says draws the tip, m."""
    return target.top * tan(max(_calc_tilt(target, now, sample.tip), 0.0))


def _go_up(
    target: PressTarget, options: PressOptions, now: PressState, sample: PressSample
) -> PressState:
    """Moves the tip up again, slowly as long as it lets an object come back that tilted."""
    goal = target.hover + np.array([0.0, 0.0, options.clearance])
    speed = options.approach_speed
    if now.outcome == PressOutcome.TILTED and sample.tip[2] < now.start_height:
        speed = min(speed, options.lowering_rate * target.calc_lever_arm(sample.tip))
        speed += BRAKING_FACTOR * max(now.sink_rate, 0.0)
        # The tip still presses, so that it would creep here as well.
        now = _give_sideways(target, options, now, sample)
        assert now.command is not None
        goal[:2] = now.command[:2]
    after = _move(now, sample, goal, speed)
    if sample.tip[2] > goal[2] - HOVER_TOLERANCE:
        return replace(after, phase=PressPhase.DONE, velocity=np.zeros(3))
    return after


PHASE_STEPS: dict[
    PressPhase, Callable[[PressTarget, PressOptions, PressState, PressSample], PressState]
] = {
    PressPhase.HOVERING: _hover,
    PressPhase.TARING: _tare,
    PressPhase.PRESSING: _press,
    PressPhase.DWELLING: _dwell,
    PressPhase.FOLLOWING: _follow,
    PressPhase.RETREATING: _go_up,
}
"""How each phase but the last is carried on."""

SLIDING_PHASES = (PressPhase.PRESSING, PressPhase.DWELLING, PressPhase.FOLLOWING)
"""Phases in which the tip touches, and may slide."""


def _calc_force(target: PressTarget, now: PressState, sample: PressSample) -> float:
    """Calculates F, the force straight down that has the same moment about the edge, N."""
    # What the object feels is the opposite of what the tip does. On a top that is tilted by t, a
    # tip of radius r touches r sin t nearer to the edge than its center is.
    f = now.tare[0] - sample.force
    tilt = 0.0 if now.touched is None else max(_calc_tilt(target, now, sample.tip), 0.0)
    arm = target.calc_lever_arm(sample.tip)
    height = float(sample.tip[2]) - target.tip_radius * cos(tilt)
    moment = -f[2] * (arm - target.tip_radius * sin(tilt)) + f[:2] @ target.normal * height
    return float(moment / arm)


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
    """Lets the command follow the tip outward as far as the tilt draws it; else the tip is held."""
    assert now.command is not None
    # The top of an object that tilts goes outward, and not along the edge.
    middle = now.hold[:2] + _calc_drawn(target, now, sample) * target.normal
    off = sample.tip[:2] - middle
    outward = float(off @ target.normal)
    allowed = float(np.clip(outward, -options.follow_room, options.follow_room))
    place = now.command[:2] + options.hold_gain * (allowed * target.normal - off)
    if allowed == outward:
        place += ((sample.tip - now.command)[:2] @ target.normal) * target.normal
    return replace(now, command=np.array([*place, now.command[2]]))


def _hold(
    target: PressTarget, options: PressOptions, now: PressState, sample: PressSample
) -> PressState:
    """Corrects the command so that the tip stays at one height, and near one place."""
    followed = _give_sideways(target, options, now, sample)
    assert followed.command is not None
    rise = options.hold_gain * float(now.hold[2] - sample.tip[2])
    return replace(followed, command=followed.command + np.array([0.0, 0.0, rise]))


def _lower(now: PressState, sample: PressSample) -> PressState:
    """Lets an object that tilted come back: the tip goes up from where it is commanded."""
    return replace(
        now,
        phase=PressPhase.RETREATING,
        outcome=PressOutcome.TILTED,
        since=sample.time,
        velocity=np.zeros(3),
    )


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
