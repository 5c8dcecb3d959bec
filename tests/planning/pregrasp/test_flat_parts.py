"""What is narrow nowhere is taken by its rim, as far as the pads hold it."""

from dataclasses import replace

import numpy as np
import pytest
import shapely
from scipy.optimize import linprog

from gridpush_drake.errors import PlanningError
from gridpush_drake.geometry.se2 import make_rotation
from gridpush_drake.identification.absolute.force_scale import ForceScale
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject, PhysicalPrior
from gridpush_drake.objects.object_file import find_shipped_object
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.belief import Belief
from gridpush_drake.planning.pregrasp.decision import PreGraspOptions
from gridpush_drake.planning.pregrasp.goals import calc_overhangs
from gridpush_drake.planning.pregrasp.grasp.grasp_parts import (
    find_flat_parts,
    find_held_grasps,
    find_held_parts,
)
from gridpush_drake.planning.pregrasp.grasp.gripper import USED_FRACTION, Gripper, PadLimit
from gridpush_drake.planning.pregrasp.grasp.side_grasp import find_side_grasps
from gridpush_drake.planning.pregrasp.planner import PreGraspPlanner
from gridpush_drake.planning.pregrasp.pregrasp_plan import PreGraspPlanStatus, plan_pregrasp
from gridpush_drake.planning.support_surface import SupportSurface
from tests.helpers.shapes import rectangle

TABLE = SupportSurface.rectangle((0.0, 0.0), (1.2, 1.0))
GRIPPER = Gripper()
PRIOR = PhysicalPrior(friction=0.35, friction_min=0.25, friction_max=0.5)


def make_tray(total_mass=0.5):
    """Wider everywhere than the gripper opens."""
    prior = replace(PRIOR, total_mass=total_mass)
    return GridObject.from_outline(rectangle(0.25, 0.2), max_cells=80, name="tray", prior=prior)


def can_balance(pads, d):
    """Whether some pressure of the pads, at their corners, holds the weight at d (2,), by linear programming."""
    a, b = pads.gripper.pad_length / 2, pads.gripper.pad_width / 2
    corners = np.array([(-a, -b), (a, -b), (a, b), (-a, b)])
    force = np.concatenate([np.ones(4), np.ones(4)])
    up = np.concatenate([np.ones(4), -np.ones(4)])
    moments = [np.concatenate([corners[:, i], -corners[:, i]]) for i in (0, 1)]
    wanted = [pads.force, pads.weight, *(pads.weight * d)]
    found = linprog(
        np.zeros(8), A_eq=np.array([force, up, *moments]), b_eq=wanted, bounds=(0, None)
    )
    return found.status == 0


@pytest.mark.parametrize("weight", [2.0, 9.0, 33.0, 81.0])
def test_the_limit_is_where_no_pressure_balances_the_weight(weight):
    pads, rng = PadLimit(GRIPPER, 80.0, weight), np.random.default_rng(0)
    seen = set()
    for _ in range(60):
        heading, at = rng.uniform(-np.pi, np.pi), rng.uniform(-0.1, 0.1, 2)
        d = rng.uniform(-1.6, 1.6, 2) * pads.torques / weight
        along = np.array([np.cos(heading), np.sin(heading)])
        center = at + d[0] * along + d[1] * np.array([-along[1], along[0]])
        (fraction,) = pads.calc_fractions(at[None], np.array([heading]), center[None])
        if abs(fraction - 1.0) > 1e-6:
            assert (fraction < 1.0) == can_balance(pads, d), (d, fraction)
            seen.add(bool(fraction < 1.0))
    assert seen == ({True, False} if weight < 80.0 else {False})


def test_the_worst_center_of_mass_counts():
    pads = PadLimit(GRIPPER, 80.0, 10.0)
    corners = np.array([(0.03, 0.0), (0.05, 0.01), (0.04, -0.02)])
    (fraction,) = pads.calc_fractions(np.zeros((1, 2)), np.zeros(1), corners)
    each = [
        pads.calc_fractions(np.zeros((1, 2)), np.zeros(1), corner[None])[0] for corner in corners
    ]
    assert fraction == max(each) == pytest.approx(10.0 * 0.05 / 0.96)


def place(part, back, front, width):
    u = np.array([np.cos(part.heading), np.sin(part.heading)])
    v = width / 2 * np.array([-u[1], u[0]])
    return shapely.Polygon(
        [part.p_BG + x * u + s * v for x, s in ((back, -1), (front, -1), (front, 1), (back, 1))]
    )


@pytest.mark.parametrize("name", ["open_book", "snack_bag", "toolbox", "claw_hammer"])
def test_pads_lie_on_the_object_and_the_body_beside_it(name):
    obj, g = GridObject.from_yaml(find_shipped_object(name)), GRIPPER
    parts = find_flat_parts(obj, g)
    assert len(parts) >= 10
    for part in parts:
        assert obj.outline.contains(place(part, -g.pad_length / 2, g.pad_length / 2, g.pad_width))
        assert (
            place(part, -g.body_back, -g.body_front, g.body_width).distance(obj.outline)
            >= g.object_clearance - 1e-9
        )
        jaw = shapely.Polygon(part.footprint)
        assert jaw.buffer(1e-9).covers(place(part, -g.pad_length / 2, g.jaw_reach, g.jaw_width))


def test_where_a_flat_part_hangs_over_the_gripper_takes_it():
    """The footprint is just what must be beyond the edge."""
    obj = make_tray()
    for part in find_flat_parts(obj, GRIPPER)[::45]:
        theta = (
            -np.pi / 2 - part.heading
        )  # the fingers point along -y, from beyond the edge y = 0.5
        c, s = np.cos(theta), np.sin(theta)
        ahead = np.array([[c, -s], [s, c]]) @ part.p_BG
        for spare, free in ((0.001, True), (-0.006, False)):
            pose = np.array(
                [0.0, 0.5 + GRIPPER.jaw_reach + GRIPPER.table_clearance + spare - ahead[1], theta]
            )
            assert (calc_overhangs([part], pose, TABLE)[0] >= 0) == free
            near = [
                found
                for found in find_side_grasps(obj, pose, TABLE, GRIPPER, part.p_BG)
                if found.distance < 0.002 and abs(np.sin(found.approach + np.pi / 2)) < 0.05
            ]
            assert bool(near) == free


def make_planner(obj, force=80.0):
    return PreGraspPlanner(
        obj, TABLE, PreGraspOptions(gripper=GRIPPER, pad_force=force, min_pokes=1)
    )


def test_a_tray_is_brought_to_the_edge_and_a_part_hangs_over_that_the_pads_hold():
    obj = make_tray()
    with pytest.raises(PlanningError, match="no graspable part"):
        PreGraspPlanner(obj, TABLE)
    planner = make_planner(obj)
    params = CellParameters.uniform(obj)
    plan = plan_pregrasp(planner, Belief.of_parameters(Model(obj, params)), (0.1, 0.2, 0.3))
    assert plan.status == PreGraspPlanStatus.READY, plan.message
    assert len(plan.pushes) >= 1
    (fraction,) = planner.pads.calc_fractions(
        plan.goal.part.p_BG[None],
        np.array([plan.goal.part.heading]),
        params.center_of_mass(obj)[None],
    )
    assert 0.1 < fraction <= USED_FRACTION
    assert plan.goal.margin > 0.0


def test_what_the_pads_cannot_hold_is_refused_with_figures():
    obj = make_tray(total_mass=3.0)
    planner = make_planner(obj)
    params = CellParameters.uniform(obj)
    plan = plan_pregrasp(planner, Belief.of_parameters(Model(obj, params)), (0.1, 0.2, 0.3))
    assert plan.status == PreGraspPlanStatus.FAILED
    center = params.center_of_mass(obj)
    nearest = min(np.abs(part.p_BG - center).max() for part in planner.flat_parts)
    torque = 3.0 * 9.81 * nearest
    assert plan.message.startswith("the pads cannot hold it: ")
    for figure in (
        "29.4 N",
        "0.96 N m along",
        "0.48 N m across",
        "80 N",
        f"{100 * torque / 0.96:.0f} %",
        "80 %",
    ):
        assert figure in plan.message
    strong = make_planner(obj, force=2 * 80.0)
    assert (
        plan_pregrasp(strong, Belief.of_parameters(Model(obj, params)), (0.1, 0.2, 0.3)).status
        == PreGraspPlanStatus.READY
    )


@pytest.mark.parametrize("friction", [0.6, 6.0])
def test_measured_forces_say_how_heavy_an_object_is_that_was_not_weighed(friction):
    """K of 0.6 N: at most a few hundred grams; of 6 N: it may weigh kilograms. Without forces it is taken for one."""
    obj = make_tray(total_mass=None)
    planner, prior = make_planner(obj), Belief.of_prior(obj)
    felt = replace(prior, force=ForceScale(friction, 0.1, 6))
    heaviest = friction * np.exp(0.2) / (9.81 * obj.prior.friction_min)
    pads, centers = planner.pads, prior.masses.center_of_mass_polygon
    assert prior.masses.max_total_mass is None and pads.weigh(prior.masses) is pads
    assert pads.weigh(felt.masses).weight == pytest.approx(9.81 * heaviest)
    held = len(find_held_parts(planner.flat_parts, pads.weigh(felt.masses), centers))
    assert (held > len(find_held_parts(planner.flat_parts, pads, centers))) == (friction < 1.0)
    decision = planner.decide((0.1, 0.2, 0.3), felt, pokes=planner.options.min_pokes)
    assert (decision.action != "fail") == (friction < 1.0), decision.reason
    if friction > 1.0:
        assert f"its {9.81 * heaviest:.1f} N are up to" in decision.reason
    weighed = replace(obj, prior=replace(obj.prior, total_mass=0.4))
    known = replace(Belief.of_prior(weighed), force=felt.force)
    assert known.masses.max_total_mass is None
    narrow = replace(felt, friction_range=(0.5, 0.6))
    assert narrow.masses.max_total_mass == pytest.approx(friction * np.exp(0.2) / (9.81 * 0.5))


def make_handle(total_mass):
    outline = shapely.box(-0.1, -0.05, 0.1, 0.15).union(shapely.box(-0.02, -0.2, 0.02, -0.05))
    return GridObject.from_outline(
        outline, max_cells=80, prior=replace(PRIOR, total_mass=total_mass)
    )


def test_narrow_parts_go_first_and_both_reasons_are_given():
    obj, pose = make_handle(0.3), (0.1, 0.2, 0.3)
    planner, model = (
        make_planner(obj),
        Belief.of_parameters(Model(obj)),
    )
    alone = PreGraspPlanner(obj, TABLE, PreGraspOptions(min_pokes=1))
    np.testing.assert_array_equal(
        planner.decide(pose, model).push.xy, alone.decide(pose, model).push.xy
    )
    obj = make_handle(3.0)
    planner, model = (
        make_planner(obj),
        Belief.of_parameters(Model(obj)),
    )
    near = PreGraspPlanner(obj, TABLE, replace(planner.options, max_arm=0.02))
    decision = near.decide(pose, model)
    assert decision.action == "fail"
    assert "within 20 mm of the center of mass" in decision.reason
    assert "; and by the rim, the pads cannot hold it: " in decision.reason


def test_a_heavy_object_is_not_taken_by_a_handle_that_it_would_turn_about():
    obj, pose = make_handle(3.0), (0.1, 0.2, 0.3)
    model = Belief.of_parameters(Model(obj))
    planner = make_planner(obj)
    assert planner.pads.max_arm == pytest.approx(0.8 * 80.0 * 0.012 / (3.0 * 9.81), rel=1e-3)
    decision = planner.decide(pose, model)
    assert decision.action == "fail"
    assert "within 26 mm of the center of mass" in decision.reason
    stronger = make_planner(obj, force=600.0)
    assert stronger.decide(pose, model).action == "slide"


@pytest.mark.parametrize(
    ("total_mass", "known", "at_worst", "held"),
    [
        (0.3, True, True, True),
        (1.0, True, False, False),
        (0.4, False, False, True),
        (0.4, False, True, False),
    ],
)
def test_a_bar_beside_the_center_of_mass_is_taken_where_the_pads_hold_across_themselves(
    total_mass, known, at_worst, held
):
    """A toolbox's handle lets the fingers in only along it, so that all of the weight is to one side of them."""
    body, hole = shapely.box(-0.15, -0.1, 0.15, 0.11), shapely.box(-0.1, 0.05, 0.1, 0.09)
    obj = GridObject.from_outline(
        body - hole, max_cells=80, prior=replace(PRIOR, total_mass=total_mass)
    )
    uncertain = Belief.of_parameters(Model(obj)) if known else Belief.of_prior(obj)
    masses = uncertain.masses
    pose, pads = np.array([0.0, 0.46, 0.35]), GRIPPER.limit_pads(obj, 80.0)
    taken = find_side_grasps(obj, pose, TABLE, GRIPPER, (-0.05, 0.1))[0]
    assert abs(make_rotation(pose[2] - taken.approach) @ (masses.middle - taken.p_BG))[1] > 0.08
    found = find_held_grasps(obj, pose, TABLE, pads, np.array([-0.05, 0.1]), 0.03, masses, at_worst)
    assert (len(found) > 0 and found[0].p_BG[1] > 0.09) == held


@pytest.mark.slow
def test_pokes_are_made_while_the_center_of_mass_may_be_where_the_pads_hold_it():
    obj = make_tray(total_mass=1.2)
    planner, prior = make_planner(obj), Belief.of_prior(obj)
    centers = prior.masses.center_of_mass_polygon
    assert not find_held_parts(planner.flat_parts, planner.pads, centers)
    assert find_held_parts(planner.flat_parts, planner.pads, prior.masses.middle[None])
    asks = planner.decide((0.1, 0.2, 0.3), prior, pokes=1)
    assert asks.action == "poke"
    assert "the pads cannot hold it" in asks.reason
    ends = planner.decide((0.1, 0.2, 0.3), prior, pokes=planner.options.max_pokes)
    assert ends.action == "fail"


@pytest.mark.parametrize("change", [{"force": 0.0}, {"weight": np.nan}])
def test_refuses_what_makes_no_sense(change):
    with pytest.raises(PlanningError, match=next(iter(change))):
        replace(PadLimit(GRIPPER, 80.0, 5.0), **change)
