"""Where it is safe to press at the edge, how a press is carried out, and which press comes next."""

from dataclasses import replace
from itertools import product
from math import radians

import numpy as np
import pytest
import shapely

from gridpush_drake.dynamics.physics import GRAVITY
from gridpush_drake.geometry.se2 import transform, transform_back, turn_left
from gridpush_drake.identification.absolute.estimate import LINE_DISTANCE
from gridpush_drake.identification.learning import describe_prior
from gridpush_drake.identification.tilt_tests.weighed_model import believe_before, estimate_masses
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import find_shipped_object
from gridpush_drake.planning.belief import Belief
from gridpush_drake.planning.closed_loop import Observation
from gridpush_drake.planning.loop_run import LoopRun, run_loop
from gridpush_drake.planning.pregrasp.decision import PreGraspOptions
from gridpush_drake.planning.pregrasp.goals import ArmLimits
from gridpush_drake.planning.pregrasp.planner import PreGraspPlanner
from gridpush_drake.planning.pregrasp.pregrasp_loop import PreGraspLoop
from gridpush_drake.planning.pregrasp.stability import calc_stability_margin
from gridpush_drake.planning.pregrasp.weighing_planner import (
    REGION_ROOM,
    PressKind,
    TiltTestOptions,
    TiltTestPlanner,
    _calc_rate,
    _count_slides,
    list_edges,
)
from gridpush_drake.planning.robot_status import PressStatus, PressStep, PushStatus
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.planning.weighing.plan import (
    AVOIDED_RADIUS,
    Edge,
    PressRules,
    list_placements,
    plan_press,
)
from gridpush_drake.planning.weighing.press import (
    Plateau,
    PressOptions,
    PressOutcome,
    PressPhase,
    PressSample,
    PressState,
    PressTarget,
    advance_press,
    has_slid,
)
from gridpush_drake.planning.weighing.region import cut_to_ellipse
from gridpush_drake.planning.weighing.sequence import (
    MASS_INCREASE,
    SequenceOptions,
    calc_headings,
    calc_remaining_uncertainty,
    with_no_tip_force,
)
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.pushes.weighings import LiftTest, MassTestLog, TiltTest
from tests.helpers.shapes import rectangle

EDGE = Edge(point=(0.5, 0.1), angle=0.7)
TOP = 0.03
BAR = GridObject.from_outline(rectangle(0.3, 0.06), max_cells=60, name="bar")
CENTERS = np.array([[0.03, 0.01], [-0.03, 0.01], [-0.03, -0.01], [0.03, -0.01]])
FREE_WAY = 0.02
"""How far the tip goes on freely, m, so that nobody takes the edge for supports."""
TARGET = PressTarget((0.05, 0.0), (0.0, 0.0), 0.0, TOP, 0.008)
COARSE = TiltTestOptions(
    sequence=SequenceOptions(rules=PressRules(spacing=0.006, overhang_step=0.009))
)
"""Weighing with fewer places and overhangs that are tried, for speed."""
SURFACE = SupportSurface.rectangle((0.0, 0.0), (1.0, 0.8))


def make_model(obj, covariance):
    """A model of an object that was pressed once, with a covariance (4, 4) of what is believed."""
    found = describe_prior(obj.forget())
    belief = replace(believe_before(found), covariance=covariance, presses=1)
    return replace(Belief.of_identification(found), absolute=belief)


def choose_press(model, pose=(0.0, 0.0, 0.0), planner=None):
    """The planner's first choice of a press; None where there is none."""
    planner = planner or TiltTestPlanner(model.obj, SURFACE)
    return next(planner.plan_presses(np.array(pose), model), None)


def choose_rest(is_robust=True, rules=None):
    """The press on the bar that is told best."""
    rests = [
        one
        for heading in calc_headings(BAR, EDGE).tolist()
        for one in list_placements(BAR, CENTERS, heading, EDGE, TOP, rules, is_robust=is_robust)
    ]
    return min(rests, key=lambda one: one.relative_std)


def test_every_planned_press_is_caught_for_each_plausible_center():
    rules = PressRules()
    rests = list_placements(BAR, CENTERS, EDGE.angle + 0.1, EDGE, TOP, rules)
    assert len(rests) > 5
    rng = np.random.default_rng(0)
    for planned in rests:
        place = np.array(planned.target.place)
        outline = shapely.Polygon(transform(planned.pose, np.array(BAR.outline.exterior.coords)))
        assert outline.contains(shapely.Point(place).buffer(0.9 * rules.rim))
        a = planned.target.calc_lever_arm(place)
        assert a >= rules.min_arm
        for c in rng.uniform(CENTERS.min(axis=0), CENTERS.max(axis=0), (50, 2)):
            c_W = transform(planned.pose, c[None])[0]
            b = -EDGE.calc_beyond(c_W)
            # Tilted by a degree, with its center at the very top, the object still comes back.
            assert b > TOP * np.tan(rules.max_tilt) + rules.pose_error
            together = (a * c_W + b * place) / (a + b)
            assert outline.buffer(-0.9 * rules.pose_error).contains(shapely.Point(together))
            assert abs(EDGE.calc_beyond(together)) < 1e-9


def test_what_is_not_safe_is_not_planned():
    heading = EDGE.angle
    near = np.array([[0.1, 0.0], [0.14, 0.02], [0.14, -0.02]])
    assert not list_placements(BAR, near, heading, EDGE, TOP)
    assert list_placements(BAR, near, heading + np.pi, EDGE, TOP)
    # On the table, nothing hangs over.
    on_table = np.array([*(np.array(EDGE.point) - 0.3 * EDGE.normal), heading])
    assert plan_press(BAR, CENTERS, on_table, EDGE, TOP) is None
    # An object that is supposed to be heavy is not pressed where that takes too much force.
    heavy = list_placements(BAR, CENTERS, heading, EDGE, TOP, PressRules(mass=10.0))
    for planned in heavy:
        b = (-EDGE.calc_beyond(transform(planned.pose, CENTERS))).max()
        a = planned.target.calc_lever_arm(np.array(planned.target.place))
        assert 98.1 * b <= 50.0 * a
    assert len(heavy) < len(list_placements(BAR, CENTERS, heading, EDGE, TOP))


@pytest.mark.slow
def test_the_whole_finger_presses_on_the_object_unless_its_parts_are_too_narrow():
    bar = GridObject.from_outline(rectangle(0.3, 0.014), max_cells=30, name="narrow bar")
    centers = 0.2 * CENTERS
    rules = PressRules()
    assert rules.rim > rules.tip_radius
    assert not list_placements(bar, centers, EDGE.angle, EDGE, TOP, rules)
    rests = list_placements(bar, centers, EDGE.angle, EDGE, TOP, replace(rules, is_narrow=True))
    assert rests
    for planned in rests:
        rim = shapely.Polygon(transform(planned.pose, np.array(bar.outline.exterior.coords)))
        assert rim.exterior.distance(shapely.Point(planned.target.place)) > 0.9 * rules.pose_error
    # A wide object is not pressed at its narrow end, though it would tell more.
    sure = np.diag([0.9, 0.008**2, 0.004**2, 0.1])
    for obj, is_narrow in ((BAR, False), (bar, True)):
        planner = TiltTestPlanner(obj, SURFACE)
        planner.weighing = COARSE
        assert choose_press(make_model(obj, sure), planner=planner).planner.is_narrow == is_narrow


def test_a_part_is_pressed_that_has_little_room_for_the_tip():
    """The room is narrower than the places that are tried are apart, wherever it lies."""
    rules = PressRules(is_narrow=True)
    bar = GridObject.from_outline(rectangle(0.3, 2 * rules.rim + 0.002), max_cells=30, name="bar")
    centers = np.array([[0.003, 0.0], [-0.003, 0.001], [-0.003, -0.001]])
    assert rules.spacing > 0.002
    for heading in np.linspace(0.0, 0.1, 5):
        assert list_placements(bar, centers, EDGE.angle + heading, EDGE, TOP, rules)


def test_a_region_is_cut_to_what_an_estimate_leaves():
    cut = cut_to_ellipse(CENTERS, np.array([0.01, 0.0]), np.diag([0.002**2, 1.0]), 3.0)
    np.testing.assert_allclose(cut.min(axis=0), [0.004, -0.01], atol=1e-4)
    np.testing.assert_allclose(cut.max(axis=0), [0.016, 0.01], atol=1e-4)
    # An estimate that contradicts the region is believed.
    far = cut_to_ellipse(CENTERS, np.array([0.1, 0.0]), np.diag([0.002**2, 0.002**2]), 3.0)
    assert far.min(axis=0)[0] > 0.09


def press_on(
    force: float,
    options: PressOptions | None = None,
    noise: float = 0.0,
    top: float = TOP,
    target: PressTarget = TARGET,
    rocks: tuple[float, float] = (0.0, 0.0),
) -> PressState:
    """A press by a spring on a rigid object that tilts about the edge at a force straight down, N.

    Before that it rocks at a smaller force `rocks[0]`, N, in which the tip goes down by `rocks[1]`, m.
    """
    options = options or PressOptions()
    rng = np.random.default_rng(1)
    offset = np.array([0.3, -0.2, 0.7])
    stiffness = 2000.0
    state = PressState()
    tip = TARGET.hover + (0.0, 0.0, 0.012)
    first, drop = rocks
    touching = TARGET.hover[2] + top - TARGET.top
    for step in range(4000):
        command = tip if state.command is None else state.command
        z = float(command[2])
        # As a spring between command and tip: the object holds the tip up, up to `first` before it
        # sinks by `drop`, and up to `force` then.
        high = touching - drop
        felt = min(max(stiffness * (touching - z), 0.0), first)
        felt = max(felt, min(max(stiffness * (high - z), 0.0), force))
        tip = np.array([*TARGET.place, z + felt / stiffness])
        measured = np.array([0.0, 0.0, felt]) + offset + noise * rng.standard_normal(3)
        state = advance_press(target, options, state, PressSample(0.01 * step, tip, measured))
        if state.over:
            return state
    return state


def calc_tilting_force(state: PressState, force: float) -> float:
    """What is measured of a force straight down on a top that does not turn as its tip sinks.

    The press supposes that the tip touches r sin t nearer to the edge than its center is.
    """
    return force * (1 - TARGET.tip_radius * np.sin(state.plateaus[-1].tilt) / 0.05)


@pytest.mark.parametrize("force", [1.0, 5.0, 30.0])
@pytest.mark.parametrize("noise", [0.0, 0.2])
def test_a_press_goes_on_as_far_as_is_safe_and_knows_the_force(force, noise):
    state = press_on(force, noise=noise)
    assert (state.phase, state.outcome) == (PressPhase.DONE, PressOutcome.TILTED)
    # At 5° a second, 4° are foreseen at 3.5°.
    assert radians(3.3) < state.tilt < radians(4.0)
    weighing = state.make_weighing(TARGET, PressOptions(), np.array([-0.05, 0, 0]))
    expected = calc_tilting_force(state, force)
    assert abs(weighing.force - expected) < (3 * weighing.force_std if noise else 2e-3 * force)
    assert 0.03 < weighing.force_std < 0.08
    np.testing.assert_allclose(weighing.place, TARGET.place)
    # It went on freely, and did not rock.
    assert weighing.rock_force is None
    assert 0.05 * np.tan(radians(2.5)) < weighing.free_way < 0.05 * np.tan(radians(4.0))
    assert weighing.center_shift == pytest.approx(0.5 * TOP * np.tan(state.plateaus[-1].tilt))


@pytest.mark.parametrize("noise", [0.0, 0.2])
@pytest.mark.parametrize(("first", "drop"), [(0.8, 1e-3), (4.0, 4e-4), (7.0, 2e-3)])
def test_a_press_goes_on_through_rocking(first, drop, noise):
    """On feet an object gives way twice: first about them, and then about the edge."""
    state = press_on(8.0, noise=noise, rocks=(first, drop))
    assert state.outcome == PressOutcome.TILTED
    weighing = state.make_weighing(TARGET, PressOptions(), np.array([-0.05, 0, 0]))
    assert weighing.force == pytest.approx(calc_tilting_force(state, 8.0), abs=0.2)
    assert weighing.rock_force == pytest.approx(first, abs=0.2)
    assert weighing.free_way < 0.05 * np.tan(radians(4.3)) - drop


def test_a_tip_that_is_drawn_away_ends_a_press_as_slid():
    """At a tilt of 1°, the top of an object 30 mm high draws the tip by 0.5 mm."""
    state = replace(
        PressState(),
        phase=PressPhase.DWELLING,
        command=TARGET.hover,
        touched=0.0,
        start_height=TARGET.hover[2],
        hold=TARGET.hover,
    )
    sunk = TARGET.hover - (0.0, 0.0, 0.05 * np.tan(radians(1.0)))
    for off, phase in ((0.002, PressPhase.DWELLING), (0.003, PressPhase.RETREATING)):
        sample = PressSample(0.1, sunk + (0.0, off, 0.0), np.array([0.0, 0.0, 5.0]))
        after = advance_press(TARGET, PressOptions(), state, sample)
        assert after.phase == phase
    assert after.outcome == PressOutcome.SLID
    assert after.make_weighing(TARGET, PressOptions(), np.zeros(3)) is None


def test_an_object_that_is_seen_elsewhere_afterwards_slid():
    before = np.array([0.3, 0.2, 3.1])
    assert not has_slid(before, before + [0.002, -0.001, 0.015])
    assert has_slid(before, before + [0.003, 0.003, 0.0])
    assert has_slid(before, before + [0.0, 0.0, 0.03])
    assert not has_slid(before, np.full(3, np.nan))
    assert not has_slid(before, before - [0.0, 0.0, 2 * np.pi])


@pytest.mark.parametrize("noise", [0.0, 0.2])
def test_a_press_is_faster_up_to_where_the_object_surely_lies_still(noise):
    slow = press_on(30.0, noise=noise)
    fast = press_on(30.0, noise=noise, target=replace(TARGET, no_tip_force=20.0))
    # Two thirds of the way up, 10 mm of the spring, take a third of the time.
    assert slow.last - fast.last == pytest.approx(0.01 / (radians(5.0) * 0.05) * 2 / 3, rel=0.1)
    for state in (slow, fast):
        weighing = state.make_weighing(TARGET, PressOptions(), np.zeros(3))
        expected = calc_tilting_force(state, 30.0)
        assert abs(weighing.force - expected) < (3 * weighing.force_std if noise else 0.06)
    assert abs(fast.tilt - slow.tilt) < radians(0.05)


@pytest.mark.parametrize("force", [1.0, 5.0, 15.0])
def test_an_object_that_tilts_below_its_sure_force_is_caught_all_the_same(force):
    state = press_on(force, noise=0.2, target=replace(TARGET, no_tip_force=30.0))
    assert state.outcome == PressOutcome.TILTED
    assert state.tilt < radians(4.3)


def test_an_object_that_is_too_heavy_is_left_alone():
    state = press_on(80.0)
    assert state.outcome == PressOutcome.TOO_HEAVY
    assert state.make_weighing(TARGET, PressOptions(), np.zeros(3)) is None


@pytest.mark.parametrize("noise", [0.0, 0.2])
def test_where_nothing_is_met_the_tip_goes_up_again(noise):
    state = press_on(5.0, noise=noise, top=0.0)
    assert (state.phase, state.outcome) == (PressPhase.DONE, PressOutcome.NO_CONTACT)


def test_numbers_that_are_not_finite_end_a_press():
    state = PressState()
    tip = TARGET.hover + (0.0, 0.0, 0.004)
    state = advance_press(TARGET, PressOptions(), state, PressSample(0.0, tip, np.zeros(3)))
    state = advance_press(TARGET, PressOptions(), state, PressSample(0.01, tip, np.full(3, np.nan)))
    assert (state.phase, state.outcome) == (PressPhase.RETREATING, PressOutcome.NO_FORCE)


@pytest.mark.parametrize("tilt", [0.0, radians(2.0)])
def test_the_tip_follows_the_top_of_a_tilting_object_and_creeps_no_farther(tilt):
    """An arm whose tip is 0.1 mm off from what is commanded would else creep on and on."""
    options = PressOptions()
    room = options.follow_room
    drawn = TOP * np.tan(tilt) * TARGET.normal
    sunk = TARGET.hover - (0.0, 0.0, TARGET.calc_lever_arm(TARGET.hover) * tilt)
    # While it tilts, and while it is let come back.
    phases = ((PressPhase.DWELLING, None), (PressPhase.RETREATING, PressOutcome.TILTED))
    for direction, (phase, outcome) in product((TARGET.normal, turn_left(TARGET.normal)), phases):
        state = replace(
            PressState(),
            phase=phase,
            outcome=outcome,
            command=sunk + (*drawn, 0.0),
            touched=0.0,
            start_height=TARGET.hover[2] + 1e-6,
            stiff_height=TARGET.hover[2] + 1e-6,
            hold=np.array([*TARGET.hover[:2], sunk[2]]),
        )
        offs = []
        for step in range(30):
            tip = np.array([*(state.command[:2] + 1e-4 * direction), sunk[2]])
            offs.append(float((tip[:2] - TARGET.place - drawn) @ direction))
            state = advance_press(
                TARGET, options, state, PressSample(0.01 * step, tip, np.array([0.0, 0.0, 5.0]))
            )
        assert state.phase == phase
        assert offs[0] == pytest.approx(1e-4)
        assert max(offs) < room + 1.01e-4
        # Along the edge no tilt draws it.
        end = room if direction @ TARGET.normal > 0.5 else 0.0
        assert offs[-1] == pytest.approx(end, abs=5e-5)


def test_an_object_that_rocked_first_is_pressed_on_as_far_as_another_one():
    """It rocked about supports inside the edge, so that the same descent tilted it by less."""
    arm = TARGET.calc_lever_arm(TARGET.hover)
    rocked, sunk = 0.0015, 0.001
    tip = TARGET.hover - (0.0, 0.0, rocked + sunk)
    ends = []
    for stiff in (0.0, rocked):
        state = replace(
            PressState(),
            phase=PressPhase.FOLLOWING,
            command=tip,
            touched=0.0,
            start_height=TARGET.hover[2],
            stiff_height=TARGET.hover[2] - stiff,
            hold=tip,
            plateaus=(Plateau(5.0, TARGET.hover[:2], 50, tip[2], 0.0),),
        )
        sample = PressSample(0.01, tip, np.array([0.0, 0.0, 5.0]))
        after = advance_press(
            TARGET, PressOptions(max_tilt=0.9 * (rocked + sunk) / arm), state, sample
        )
        ends.append(after.phase)
        inside = stiff / (arm + LINE_DISTANCE)
        assert after.tilt == pytest.approx((rocked + sunk - stiff) / arm + inside)
    assert ends == [PressPhase.RETREATING, PressPhase.FOLLOWING]


def test_a_force_along_the_normal_counts_by_its_moment():
    """The object's top draws the tip along: the moment of both forces about the edge is what counts."""
    state = replace(
        PressState(),
        phase=PressPhase.DWELLING,
        command=TARGET.hover,
        start_height=0.038,
        hold=TARGET.hover,
    )
    sample = PressSample(0.0, TARGET.hover, np.array([2.0, 0.0, 10.0]))
    state = advance_press(TARGET, PressOptions(), state, sample)
    # The object feels -2 N outwards at the height of its top, 30 mm, and 10 N at 50 mm.
    assert state.forces == pytest.approx((10.0 - 2.0 * 0.03 / 0.05,))


def test_a_heavy_object_is_pressed_where_it_is_expected_to_tilt():
    # Two kilograms would not tilt everywhere with its center at the region's far end.
    wide = CENTERS * [3.0, 1.0]
    rules = PressRules(mass=2.0)
    headings = calc_headings(BAR, EDGE).tolist()
    assert not [
        one
        for heading in headings
        for one in list_placements(BAR, wide, heading, EDGE, TOP, rules)
        if rules.mass * GRAVITY * _calc_farthest(one, wide) > rules.max_force * _calc_lever_arm(one)
    ]
    heavier = replace(rules, mass=2.5)
    assert not [
        one
        for heading in headings
        for one in list_placements(BAR, wide, heading, EDGE, TOP, heavier)
    ]
    at_rim = replace(heavier, is_narrow=True)
    planned = next(
        one
        for heading in headings
        for one in list_placements(BAR, wide, heading, EDGE, TOP, at_rim, is_robust=False)
    )
    middle = -EDGE.calc_beyond(transform(planned.pose, wide)).mean()
    assert heavier.mass * GRAVITY * middle <= heavier.max_force * _calc_lever_arm(planned)
    # What is safe does not depend on how heavy it is.
    assert planned.inside > TOP * np.tan(rules.max_tilt) + rules.pose_error


def _calc_farthest(planned, centers):
    """How far inside the edge the center of mass is at most, m."""
    return -EDGE.calc_beyond(transform(planned.pose, centers)).min()


def _calc_lever_arm(planned):
    """How far beyond the edge it is pressed, m."""
    return EDGE.calc_beyond(np.array(planned.target.place))


def test_a_long_object_is_pressed_near_the_edge_as_long_as_no_other_press_is_safe():
    """So little of it may hang over that no press is 20 mm from the edge; it was pressed before."""
    wrench = GridObject.from_yaml(find_shipped_object("combination_wrench"))
    unknown = make_model(wrench, np.diag([0.28**2, 0.02**2, 0.0012**2, 0.28**2]))
    chosen = choose_press(unknown)
    assert chosen is not None
    assert all(one.gain > chosen.planner.weighing.min_gain for one in chosen.placements)
    arms = [
        one.planned.target.calc_lever_arm(np.array(one.planned.target.place))
        for one in chosen.placements
    ]
    assert max(arms) < PressRules().min_arm


@pytest.mark.slow
def test_presses_that_tell_little_are_made_where_no_other_is_left():
    """As long as mass and center are not even roughly known."""
    planner = TiltTestPlanner(BAR, SURFACE)
    wide = make_model(BAR, np.diag([0.9, 0.018**2, 0.006**2, 0.1]))
    planner.weighing = replace(planner.weighing, min_gain=0.99)
    after = choose_press(wide, planner=planner)
    assert after is not None
    assert all(one.gain < planner.weighing.min_gain for one in after.placements)
    rough = make_model(BAR, np.diag([0.04**2, 0.004**2, 0.004**2, 0.1]))
    assert choose_press(rough) is not None
    assert choose_press(rough, planner=planner) is None


def test_what_is_expected_to_be_left_open_is_what_the_estimate_leaves():
    """The expected covariance is that of the estimate, were the press made with just that force."""
    found = describe_prior(BAR)
    options = SequenceOptions()
    planned = choose_rest()
    belief = believe_before(found)
    c_W = transform(planned.pose, belief.center_of_mass[None])[0]
    place = np.array(planned.target.place)
    arm = planned.target.calc_lever_arm(place)
    force = 9.81 * belief.total_mass * -EDGE.calc_beyond(c_W) / arm
    press = TiltTest(
        planned.pose,
        place,
        force,
        np.array(EDGE.point),
        EDGE.angle,
        options.rules.force_std,
        free_way=FREE_WAY,
    )
    after = estimate_masses(found, MassTestLog((press,))).absolute
    left = calc_remaining_uncertainty(belief, planned, options.rules, options)
    trace = after.covariance[0, 0] / options.mass_std**2
    trace += np.trace(after.center_covariance) / options.center_std**2
    assert left == pytest.approx(trace, rel=0.02)


def test_the_sure_force_is_less_than_any_that_is_likely_and_grows_with_what_is_known():
    found = describe_prior(BAR)
    first = choose_rest()
    mass = 0.6
    center = np.array([0.01, -0.004])

    def calc_force(planned):
        b = -float(EDGE.calc_beyond(transform(planned.pose, center[None])[0]))
        return mass * GRAVITY * b / planned.target.calc_lever_arm(np.array(planned.target.place))

    weighing = TiltTest(
        first.pose,
        np.array(first.target.place),
        calc_force(first),
        np.array(EDGE.point),
        EDGE.angle,
        force_std=0.05,
        free_way=FREE_WAY,
    )
    known = estimate_masses(found, MassTestLog((weighing,)))
    rules = PressRules()
    before, after = (
        with_no_tip_force(first, belief, rules).target.no_tip_force
        for belief in (believe_before(found), known.absolute)
    )
    # Pressed once more at the same place, the object tilts at the same force, near enough.
    assert before < 0.2 * weighing.force < 0.5 * weighing.force < after < 0.75 * weighing.force
    # Wherever else it is pressed, it lies still up to that force.
    count = 0
    for heading in calc_headings(BAR, EDGE):
        for planned in list_placements(BAR, CENTERS, float(heading), EDGE, TOP, rules):
            sure = with_no_tip_force(planned, known.absolute, rules).target.no_tip_force
            assert 0 < sure < calc_force(planned)
            count += 1
    assert count > 50


def test_presses_end_when_enough_is_known():
    planner = TiltTestPlanner(BAR, SURFACE)
    pokes = planner.options.min_pokes
    sure = make_model(BAR, np.diag([0.005**2, 0.0005**2, 0.0005**2, 0.1]))
    unsure = make_model(BAR, np.diag([0.9, 0.018**2, 0.006**2, 0.1]))
    assert not planner.may_weigh(sure, pokes, 0)
    assert planner.may_weigh(unsure, pokes, 0)
    assert not planner.may_weigh(unsure, pokes - 1, 0)


@pytest.mark.slow
def test_a_planner_weighs_where_the_other_gives_up():
    """With friction that may be anything it first brings the bar to where it can be pressed."""
    surface = SupportSurface.rectangle((0.0, 0.0), (1.0, 0.8))
    obj = replace(BAR, prior=replace(BAR.prior, friction_min=0.1, friction_max=0.9))
    found = describe_prior(obj)
    belief = replace(
        believe_before(found), covariance=np.diag([0.9, 0.018**2, 0.006**2, 0.1]), presses=1
    )
    model = replace(Belief.of_identification(found), absolute=belief)
    options = PreGraspOptions(max_pokes=0, min_pokes=0)
    plain = PreGraspPlanner(obj, surface, options)
    weighing = TiltTestPlanner(obj, surface, options)
    weighing.weighing = COARSE
    inside = np.array([0.2, 0.0, 0.0])
    at_edge = np.array([0.4, 0.0, 0.0])
    for pose in (inside, at_edge):
        assert plain.decide(pose, model).action == "fail"
    slide = weighing.decide(inside, model)
    assert slide.action == "slide"
    assert "from where it can be weighed" in slide.reason
    press = weighing.decide(at_edge, model)
    assert press.action == "weigh"
    place = np.array(press.press.place)
    assert 0.02 <= press.press.calc_lever_arm(place) <= 0.05
    # An object that does not tilt is pressed where less force would do, or not at all.
    heavier = weighing
    for _ in range(8):
        heavier = heavier.suppose_heavier()
    assert heavier.decide(at_edge, model).action != "weigh"
    assert weighing.decide(at_edge, model).action == "weigh"
    # After enough presses, it gives up as the other one does.
    tired = replace(model, presses=8)
    assert weighing.decide(at_edge, tired).action == "fail"

    # After many slides and no press it is slid no further to be weighed, and the reason says so;
    # each press allows more of them. Where it can be pressed as it lies, it is.
    options = weighing.weighing
    never = replace(model, absolute=replace(belief, presses=0))
    stopped = weighing.decide(inside, never, slides=options.first_slides)
    assert stopped.action == "fail"
    assert stopped.reason.endswith(
        "8 slides led to no press, so that it is slid no further to be weighed"
    )
    for slides, action in ((0, "slide"), (options.slides_per_press, "fail")):
        slides += options.first_slides
        assert weighing.decide(inside, model, slides=slides).action == action
    assert weighing.decide(at_edge, model, slides=slides).action == "weigh"

    # A press that the object withstood is a press, too.
    heavier = weighing.suppose_heavier()
    assert heavier.decide(inside, model, slides=slides).action == "slide"
    slides += options.slides_per_press
    stopped = heavier.decide(inside, model, slides=slides)
    assert stopped.action == "fail"
    assert stopped.reason.endswith(
        "16 slides led to 2 presses, so that it is slid no further to be weighed"
    )


@pytest.mark.slow
def test_a_planner_weighs_a_heavy_object_where_it_is_expected_to_tilt():
    """No press would tilt it wherever its center of mass may be; one with the center in the middle.

    Of 7 kg it tilts only if it is lighter than it is expected to be, by one standard deviation.
    """
    surface = SupportSurface.rectangle((0.0, 0.0), (1.0, 0.8))
    obj = replace(BAR, prior=replace(BAR.prior, friction_min=0.1, friction_max=0.9))
    found = describe_prior(obj)
    planner = TiltTestPlanner(obj, surface, PreGraspOptions(max_pokes=0, min_pokes=0))
    inside = np.array([0.2, 0.0, 0.0])
    before = believe_before(found)
    expected = {
        2.0: (True, True, "slide"),
        5.0: (False, True, "slide"),
        7.0: (False, False, "slide"),
        30.0: (False, False, "fail"),
    }
    for mass, outcome in expected.items():
        belief = replace(
            before,
            mean=np.array([np.log(mass), *before.mean[1:]]),
            covariance=np.diag([0.9, 0.018**2, 0.006**2, 0.1]),
            presses=1,
        )
        model = replace(Belief.of_identification(found), absolute=belief)
        rests = [
            planner._list_placements(
                inside, model, belief, [PressKind(planner._make_rules(belief), is_robust, 1.0)]
            )
            for is_robust in (True, False)
        ]
        assert (*map(bool, rests), planner.decide(inside, model).action) == outcome


def test_a_weighed_model_leaves_the_center_of_mass_where_it_was_weighed():
    obj = replace(BAR, prior=replace(BAR.prior, friction_min=0.1, friction_max=0.9))
    found = describe_prior(obj)
    wide = Belief.of_identification(found)
    assert wide.weighed is None
    sure = replace(
        believe_before(found),
        mean=np.array([np.log(0.7), 0.02, 0.0, np.log(0.4)]),
        covariance=np.diag([0.01**2, 0.001**2, 0.002**2, 0.1]),
        presses=3,
    )
    weighed = Belief.of_identification(replace(found, absolute=sure))
    corners = weighed.masses.center_of_mass_polygon
    np.testing.assert_allclose(corners.min(axis=0), [0.0165, -0.007], atol=2e-4)
    np.testing.assert_allclose(corners.max(axis=0), [0.0235, 0.007], atol=2e-4)
    assert np.ptp(wide.masses.center_of_mass_polygon, axis=0)[0] > 0.1
    assert weighed.masses.max_total_mass == pytest.approx(0.7 * np.exp(0.035))


def test_a_run_goes_on_where_another_one_ended():
    surface = SupportSurface.rectangle((0.0, 0.0), (1.0, 0.8))
    planner = TiltTestPlanner(BAR, surface, PreGraspOptions())
    loop = PreGraspLoop(planner, lambda *_: None)
    state = loop.begin().turn_to("weighing", "It is weighed.")
    before = LoopRun(state=state, identification=describe_prior(BAR))
    after = run_loop(loop, None, lambda _: True, obj=BAR, begun=before)
    assert after is before
    assert after.state.shown_push is None


def make_press_loop():
    surface = SupportSurface.rectangle((0.0, 0.0), (1.0, 0.8))
    loop = PreGraspLoop(TiltTestPlanner(BAR, surface, PreGraspOptions()), lambda *_: None)
    state = replace(loop.begin(), press=TARGET, press_id=1, press_pose=(0.0, 0.0, 0.0))
    return loop, state.turn_to("weighing", "It is weighed.")


def watch(loop, state, presser):
    seen = Observation(
        time=1.0, pose=np.zeros(3), robot=PushStatus(), log=PushLog(()), presser=presser
    )
    return loop.step(state, seen)


def test_a_loop_waits_for_a_press_and_looks_anew_after_it():
    loop, state = make_press_loop()
    assert state.shown_press is TARGET
    for under_way in (
        PressStatus(),
        PressStatus(PressStep.PRESSING, 1),
        # The outcome is known, but the tip is still on its way back.
        PressStatus(PressStep.RETURNING, 1, PressOutcome.TILTED, "it tilts", True),
    ):
        state = watch(loop, state, under_way)
        assert state.status.mode == "weighing"
    done = PressStatus(PressStep.IDLE, 1, PressOutcome.TILTED, "it tilts at 4.0 N", True)
    after = watch(loop, state, done)
    assert after.status.mode == "waiting"
    assert after.status.presses == 1
    assert after.status.reason == "It was pressed at the edge: it tilts at 4.0 N."
    assert after.shown_press is None


def test_presses_that_weigh_nothing_suppose_a_heavier_object_and_end_at_last():
    loop, state = make_press_loop()
    no_tilt_count = PressStatus(PressStep.IDLE, 1, PressOutcome.TOO_HEAVY, "it lay still", False)
    factors = []
    for _ in range(loop.options.max_failed_presses):
        planner = loop._choose_planner(state)
        factors.append(planner._make_rules(believe_before(describe_prior(BAR))).mass)
        state = watch(loop, state.turn_to("weighing", "Once more."), no_tilt_count)
        assert state.status.mode == "waiting"
    np.testing.assert_allclose(np.diff(np.log(factors)), np.log(MASS_INCREASE))
    assert state.status.presses == 0
    # From then on the loop goes on with what is known, as if the object could not be weighed.
    obj = replace(BAR, prior=replace(BAR.prior, friction_min=0.1, friction_max=0.9))
    found = describe_prior(obj)
    belief = replace(
        believe_before(found), covariance=np.diag([0.9, 0.018**2, 0.006**2, 0.1]), presses=1
    )
    model = replace(Belief.of_identification(found), absolute=belief)
    options = PreGraspOptions(min_pokes=0, max_pokes=0)
    at_edge = np.array([0.4, 0.0, 0.0])
    plain = PreGraspPlanner(obj, loop.planner.surface, options)
    weighing = TiltTestPlanner(obj, loop.planner.surface, options)
    weighing.weighing = COARSE
    assert weighing.decide(at_edge, model).action == "weigh"
    stopped = PreGraspLoop(weighing, lambda *_: None)._choose_planner(state).decide(at_edge, model)
    expected = plain.decide(at_edge, model)
    assert stopped.action == expected.action == "fail"
    assert stopped.reason == (
        f"{expected.reason}; 4 presses in a row weighed nothing, so that it is weighed no more"
    )


@pytest.mark.parametrize("outcome", [PressOutcome.SLID, PressOutcome.MOVED])
def test_where_an_object_slid_it_is_not_pressed_again(outcome):
    loop, state = make_press_loop()
    state = replace(state, press_pose=(0.4, 0.02, 0.3))
    slid = PressStatus(PressStep.IDLE, 1, outcome, "it slid", False)
    after = watch(loop, state, slid)
    expected = transform_back(np.array(state.press_pose), np.array([TARGET.place]))
    np.testing.assert_allclose(after.slid_places, expected)
    # A press that weighs something changes nothing of that.
    tilted = PressStatus(PressStep.IDLE, 1, PressOutcome.TILTED, "it tilts at 4.0 N", True)
    assert watch(loop, after.turn_to("weighing", "Once more."), tilted).slid_places == (
        after.slid_places
    )
    belief = believe_before(describe_prior(BAR))
    assert loop._choose_planner(state)._make_rules(belief).avoided == ()
    assert loop._choose_planner(after)._make_rules(belief).avoided == after.slid_places


def test_a_press_keeps_away_from_where_the_object_slid():
    pose = choose_rest().pose
    first = plan_press(BAR, CENTERS, pose, EDGE, TOP)
    avoided = tuple(map(tuple, transform_back(pose, np.array([first.target.place])).tolist()))
    other = plan_press(BAR, CENTERS, pose, EDGE, TOP, PressRules(avoided=avoided))
    distance = np.linalg.norm(np.subtract(other.target.place, first.target.place))
    assert AVOIDED_RADIUS < distance < 2 * AVOIDED_RADIUS
    assert other.relative_std > first.relative_std
    # Wherever else it is laid, too.
    for rest in list_placements(
        BAR, CENTERS, EDGE.angle + 0.2, EDGE, TOP, PressRules(avoided=avoided)
    ):
        place = transform_back(rest.pose, np.array([rest.target.place]))
        assert np.linalg.norm(place - avoided) > AVOIDED_RADIUS


def test_an_object_that_left_the_finger_s_region_is_laid_within_it_again():
    region = shapely.box(-0.2, -0.45, 0.3, 0.45)
    planner = TiltTestPlanner(BAR, SURFACE, limits=ArmLimits(finger_region=region))
    free = TiltTestPlanner(BAR, SURFACE)
    (back,) = (edge for edge in list_edges(SURFACE) if edge.line.normal[1] > 0.9)
    for x, expected in ((0.1, 0.1), (-0.3, -0.2 + REGION_ROOM), (0.4, 0.3 - REGION_ROOM)):
        pose = np.array([x, 0.3, 0.5])
        for asked, place in ((planner, expected), (free, np.clip(x, -0.35, 0.35))):
            along = asked._choose_along(back, pose)
            found = np.array(back.line.point) + along * back.line.tangent
            np.testing.assert_allclose(found, [place, 0.4], atol=1e-12)
    # An edge that the finger does not get to is as it was.
    (right,) = (edge for edge in list_edges(SURFACE) if edge.line.normal[0] > 0.9)
    pose = np.array([0.4, 0.1, 0.0])
    assert planner._choose_along(right, pose) == free._choose_along(right, pose)


def test_near_a_corner_of_the_table_nothing_is_pressed():
    """There an object hangs over two edges, or its edge ends below it: it would tilt otherwise."""
    surface = SupportSurface.rectangle((0.0, 0.0), (1.0, 0.8))
    planner = TiltTestPlanner(BAR, surface, PreGraspOptions())
    (right,) = (edge for edge in list_edges(surface) if edge.line.normal[0] > 0.9)
    assert planner._hangs_over_only(right, np.array([0.4, 0.0, 0.0]))
    assert planner._hangs_over_only(right, np.array([0.4, 0.36, 0.0]))
    assert not planner._hangs_over_only(right, np.array([0.4, 0.368, 0.0]))
    assert not planner._hangs_over_only(right, np.array([0.4, 0.39, 0.0]))


@pytest.mark.slow
def test_where_the_arm_cannot_press_nothing_is_planned():
    obj = replace(BAR, prior=replace(BAR.prior, friction_min=0.1, friction_max=0.9))
    found = describe_prior(obj)
    belief = replace(
        believe_before(found), covariance=np.diag([0.9, 0.018**2, 0.006**2, 0.1]), presses=1
    )
    model = replace(Belief.of_identification(found), absolute=belief)
    surface = SupportSurface.rectangle((0.0, 0.0), (1.0, 0.8))
    asked = []

    def can_press(target, pose):
        asked.append(target)
        return False

    planner = TiltTestPlanner(
        obj,
        surface,
        PreGraspOptions(max_pokes=0, min_pokes=0),
        limits=ArmLimits(can_press=can_press),
    )
    for pose in ([0.2, 0.0, 0.0], [0.4, 0.0, 0.0]):
        assert planner.decide(np.array(pose), model).action == "fail"
    assert len(asked) > 1


def test_a_place_where_the_object_may_tip_counts_half_and_a_slide_that_must_be_exact_less():
    """A slide is cut short of a place at which the object may tip, and ends only nearly there."""
    obj = GridObject.from_yaml(find_shipped_object("claw_hammer")).forget()
    surface = SupportSurface.rectangle((0.0, 0.0), (1.0, 0.8))
    found = describe_prior(obj)
    belief = replace(
        believe_before(found), covariance=np.diag([0.9, 0.008**2, 0.01**2, 0.1]), presses=1
    )
    model = replace(Belief.of_identification(found), absolute=belief)
    planner = TiltTestPlanner(obj, surface, PreGraspOptions(max_pokes=0, min_pokes=0))
    pose = np.array([0.0, 0.1, 1.96])
    kinds = [kind for kind in planner._list_kinds(belief) if kind.trust == 0.7 and kind.is_robust]
    rests = planner._list_placements(pose, model, belief, kinds)
    safe = [rest.goal.margin >= planner.options.slide.margin for rest in rests]
    assert True in safe and False in safe
    for rest, is_safe in zip(rests, safe, strict=True):
        assert rest.goal.margin == calc_stability_margin(model.masses, rest.goal.pose, surface)
        rate = _calc_rate(rest.gain, _count_slides(pose, rest.goal.pose))
        assert rest.rate == pytest.approx(0.7 * rate * (1.0 if is_safe else 0.5))
    rates = [rest.rate for rest in rests]
    assert rates == sorted(rates, reverse=True)


def test_a_press_at_one_edge_is_the_same_at_any_other():
    obj = GridObject.from_yaml(find_shipped_object("claw_hammer")).forget()
    centers = np.array([[-0.01, -0.01], [0.01, -0.01], [0.01, 0.01], [-0.01, 0.01]])
    here = Edge((0.0, 0.0), 0.0)
    there = Edge((0.3, -0.2), 2.0)
    at_origin = list_placements(obj, centers, 0.4, here, 0.03)
    expected = list_placements(obj, centers, 2.4, there, 0.03, along=0.07)
    # The grid of places is turned with the edge, so that the smallest overhangs may differ.
    by_overhang = {round(one.inside, 6): one for one in expected}
    pairs = [(one.move_to(there, 0.07), by_overhang.get(round(one.inside, 6))) for one in at_origin]
    shared = [(moved, other) for moved, other in pairs if other is not None]
    assert len(shared) > 10
    for moved, other in shared:
        np.testing.assert_allclose(moved.pose, other.pose, atol=1e-12)
        edge_point = np.array(moved.target.edge_point)
        np.testing.assert_allclose(edge_point, other.target.edge_point, atol=1e-12)
        assert moved.target.edge_angle == there.angle
        arms = [each.target.calc_lever_arm(np.array(each.target.place)) for each in (moved, other)]
        assert arms[0] == pytest.approx(arms[1], abs=0.006)


def test_weighings_that_contradict_each_other_are_not_planned_with():
    """Their center of mass is far off: it moves neither the model nor any region or margin."""
    found = describe_prior(BAR)
    press = TiltTest(np.array([-0.05, 0, 0]), np.array([0.05, 0.0]), 8.0, np.zeros(2), 0.0, 0.05)
    turned = replace(press, pose=np.array([-0.05, 0.0, np.pi]), force=0.4)
    lifts = (
        LiftTest(np.zeros(3), np.zeros(2), weight=4.0, torque=np.zeros(2)),
        LiftTest(np.ones(3), np.ones(2), weight=12.0, torque=np.zeros(2)),
    )
    weighed = estimate_masses(found, MassTestLog((press, turned), lifts))
    assert weighed.absolute.contradictory and weighed.weighed is None
    np.testing.assert_array_equal(weighed.params.mass, found.params.mass)
    model = Belief.of_identification(weighed)
    before = Belief.of_identification(found)
    assert model.weighed is None and model.presses == 2
    np.testing.assert_array_equal(
        model.masses.center_of_mass_polygon, before.masses.center_of_mass_polygon
    )
    surface = SupportSurface.rectangle((0.0, 0.0), (1.0, 0.8))
    margins = [calc_stability_margin(one.masses, np.zeros(3), surface) for one in (model, before)]
    assert margins[0] == margins[1]
    # What is next to be pressed is as before the first press; so the presses are repeated.
    np.testing.assert_array_equal(model.absolute.mean, before.absolute.mean)
    np.testing.assert_array_equal(model.absolute.covariance, before.absolute.covariance)
    assert "contradict each other" in weighed.identifiability.statements[0]
    # But not for ever.
    planner = TiltTestPlanner(BAR, surface, PreGraspOptions())
    enough = replace(model, presses=planner.weighing.max_presses)
    pokes = planner.options.min_pokes
    assert planner.may_weigh(model, pokes, 0)
    assert not planner.may_weigh(enough, pokes, 0)
