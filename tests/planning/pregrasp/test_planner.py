import numpy as np
import pytest
import shapely

from gridpush_drake.bench.data.protocol import ANGLE_STD, POSITION_STD
from gridpush_drake.bench.pregrasp.world import EdgeWorld, run_pregrasp
from gridpush_drake.dynamics.simulation import calc_loads, simulate
from gridpush_drake.errors import PlanningError
from gridpush_drake.geometry.se2 import transform_shape
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.statistics.posterior import Posterior
from gridpush_drake.objects.grid_object import GridObject, PhysicalPrior
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.belief import Belief
from gridpush_drake.planning.contact.trial import calc_goal_error
from gridpush_drake.planning.edge_motion import simulate_near_edge
from gridpush_drake.planning.exploration.designed_pokes import calc_center_std
from gridpush_drake.planning.plausible_masses import PlausibleMassSet
from gridpush_drake.planning.pregrasp.decision import PokeForecast, PreGraspOptions
from gridpush_drake.planning.pregrasp.goals import (
    GOAL_ROOM,
    ArmLimits,
    GoalOptions,
    calc_overhangs,
    find_grasp_at,
    find_pregrasp_goals,
)
from gridpush_drake.planning.pregrasp.grasp.grasp_parts import find_grasp_parts
from gridpush_drake.planning.pregrasp.grasp.gripper import Gripper
from gridpush_drake.planning.pregrasp.planner import PreGraspPlanner
from gridpush_drake.planning.pregrasp.pregrasp_plan import PreGraspPlanStatus, plan_pregrasp
from gridpush_drake.planning.pregrasp.push_monitor import PushMonitor
from gridpush_drake.planning.pregrasp.slides import (
    OBSTACLE_MARGIN,
    SlideOptions,
    make_stability_rule,
    plan_slide,
)
from gridpush_drake.planning.pregrasp.stability import calc_stability_margin, calc_stability_margins
from gridpush_drake.planning.push_constraints import make_body
from gridpush_drake.planning.support_surface import SupportSurface
from tests.helpers.shapes import rectangle, regular_polygon

TABLE = SupportSurface.rectangle((0.0, 0.0), (0.8, 0.6))
ROUND = SupportSurface.round((0.3, -0.2), 0.35)
L_SHAPED = SupportSurface.from_polygon(
    [(0, 0), (0.8, 0), (0.8, 0.4), (0.4, 0.4), (0.4, 0.8), (0, 0.8)]
)
NOISE = {"position_std": POSITION_STD, "angle_std": ANGLE_STD}
PRIOR = PhysicalPrior(friction=0.35, friction_min=0.25, friction_max=0.5)


def dumbbell():
    """A plate of 0.14 m with a handle 0.03 m wide, 0.2 m long, at its side +x."""
    return shapely.box(-0.14, -0.07, 0.0, 0.07).union(shapely.box(0.0, -0.015, 0.2, 0.015))


@pytest.fixture(scope="module")
def pan():
    plate = shapely.box(-0.14, -0.07, 0.0, 0.07)
    return GridObject.from_outline(
        dumbbell(), parts={2: plate}, max_cells=60, name="pan", prior=PRIOR
    )


@pytest.fixture(scope="module")
def parts(pan):
    return find_grasp_parts(pan)


@pytest.fixture(scope="module")
def heavy_plate(pan):
    return CellParameters.by_part(pan, {1: 0.01, 2: 0.03}, 0.35)


def place(points, pose):
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return points @ np.array([[c, s], [-s, c]]) + pose[:2]


def test_only_the_handle_can_be_taken(pan, parts):
    assert parts
    for part in parts:
        assert part.p_BG[0] > 0.0
        assert part.width <= 0.11 - 2 * 0.004
        jaws = shapely.Polygon(part.footprint).difference(pan.outline)
        assert (
            not shapely.Polygon(part.footprint)
            .buffer(-1e-9)
            .intersects(shapely.box(-0.14, -0.07, -0.001, 0.07))
        )
        assert jaws.area > 2 * 0.009 * 0.03
    straight = [part for part in parts if abs(part.closing[1]) > 0.999]
    assert min(part.width for part in straight) == pytest.approx(0.03)
    assert {round(float(part.footprint[:, 1].max()), 4) for part in straight} == {0.029}


def test_a_wider_gripper_takes_the_plate_too(pan):
    wide = find_grasp_parts(pan, Gripper(level_opening=0.16))
    assert min(part.p_BG[0] for part in wide) < -0.05


def test_a_round_plate_and_a_corner_offer_nothing_to_hold():
    assert not find_grasp_parts(GridObject.from_outline(regular_polygon(0.09), max_cells=40))
    assert not find_grasp_parts(GridObject.from_outline(rectangle(0.25, 0.25), max_cells=40))
    assert find_grasp_parts(GridObject.from_outline(rectangle(0.25, 0.05), max_cells=40))


def test_a_jaw_needs_room_in_a_hole():
    frame = shapely.box(-0.15, -0.1, 0.15, 0.1)
    for hole, found in (
        (shapely.box(-0.12, 0.03, 0.12, 0.08), True),
        (shapely.box(-0.12, 0.07, 0.12, 0.08), False),
    ):
        parts = find_grasp_parts(GridObject.from_outline(frame.difference(hole), max_cells=100))
        bars = [part for part in parts if abs(part.closing[1]) > 0.999 and abs(part.p_BG[0]) < 0.1]
        assert bool(bars) == found
        assert all(part.width == pytest.approx(0.02) for part in bars)


def test_overhang_is_what_the_drawing_says(parts):
    part = min((p for p in parts if abs(p.closing[1]) > 0.999), key=lambda p: -p.p_BG[0])
    inner = part.footprint[:, 0].min()
    assert inner == pytest.approx(0.17)
    for out in (-0.01, 0.0015, 0.02):
        assert calc_overhangs([part], (0.4 - inner + out, 0.0, 0.0), TABLE)[0] == pytest.approx(out)
        # turned by a right angle it hangs over the edge y = 0.3
        assert calc_overhangs([part], (0.1, 0.3 - inner + out, np.pi / 2), TABLE)[
            0
        ] == pytest.approx(out)


@pytest.mark.parametrize("surface", [TABLE, ROUND, L_SHAPED])
def test_overhangs_never_claim_what_is_over_the_table(parts, surface):
    rng = np.random.default_rng(0)
    x0, y0, x1, y1 = surface.polygon.bounds
    for pose in np.column_stack([rng.uniform((x0, y0), (x1, y1), (60, 2)), rng.uniform(-4, 4, 60)]):
        claimed = calc_overhangs(parts, pose, surface)
        for part, overhang in zip(parts, claimed, strict=True):
            clear = shapely.Polygon(place(part.footprint, pose)).distance(surface.polygon)
            if overhang > 0:
                assert clear >= overhang - 1e-9
            elif surface.is_convex is False:
                assert clear == 0


@pytest.mark.parametrize("surface", [TABLE, ROUND, L_SHAPED])
def test_goals_hang_over_far_enough_and_are_safe(pan, parts, heavy_plate, surface):
    masses = PlausibleMassSet.of_masses(Model(pan, heavy_plate))
    middle = surface.polygon.representative_point()
    start, options = np.array([middle.x, middle.y, 1.0]), GoalOptions(margin=0.01)
    goals = find_pregrasp_goals(masses, parts, start, surface, options)
    assert len(goals) > 5
    for goal in goals:
        footprint = shapely.Polygon(place(goal.part.footprint, goal.pose))
        assert footprint.distance(surface.polygon) >= options.min_overhang
        assert goal.margin >= 0.01
        assert goal.margin == pytest.approx(calc_stability_margin(masses, goal.pose, surface))
        assert calc_loads(Model(pan, heavy_plate), goal.pose, surface.corners) is not None
        assert goal.travel == pytest.approx(calc_goal_error(pan, start, goal.pose))
        assert abs(goal.pose[2] - start[2]) <= np.pi + 1e-9
        np.testing.assert_allclose(goal.p_WG, place(goal.part.p_BG, goal.pose))
    assert goals[0].travel < 1.5 * min(goal.travel for goal in goals)


def test_a_heavy_handle_leaves_no_safe_goal_but_says_where_it_is_weak(pan, parts):
    heavy_handle = CellParameters.by_part(pan, {1: 0.5, 2: 0.005}, 0.35)
    masses = PlausibleMassSet.of_masses(Model(pan, heavy_handle))
    goals = find_pregrasp_goals(masses, parts, np.zeros(3), TABLE, GoalOptions(margin=0.06))
    assert len(goals) == 1
    assert goals[0].margin < 0.06
    assert np.linalg.norm(goals[0].weakest) == pytest.approx(1)


def test_a_table_too_small_and_an_object_too_wide_are_refused(pan, parts):
    with pytest.raises(PlanningError, match=r"table: smaller than pan"):
        PreGraspPlanner(pan, SupportSurface.round((0, 0), 0.1))
    plate = GridObject.from_outline(rectangle(0.25, 0.25), max_cells=40, name="plate")
    with pytest.raises(PlanningError, match=r"plate: no graspable part"):
        PreGraspPlanner(plate, TABLE)


def test_what_hangs_over_already_is_grasped_and_only_if_it_stays(pan, parts, heavy_plate):
    masses = PlausibleMassSet.of_masses(Model(pan, heavy_plate))
    pose = np.array([0.4 - 0.165, 0.0, 0.0])
    here = find_grasp_at(masses, parts, pose, TABLE)
    assert here is not None
    assert here.margin > 0.01
    planner = PreGraspPlanner(pan, TABLE, parts=parts)
    assert planner.decide(pose, Belief.of_parameters(Model(pan, heavy_plate))).action == "grasp"
    heavy_handle = CellParameters.by_part(pan, {1: 0.5, 2: 0.005}, 0.35)
    assert calc_loads(Model(pan, heavy_handle), (0.38, 0.0, 0.0), TABLE.corners) is None
    assert (
        planner.decide((0.38, 0.0, 0.0), Belief.of_parameters(Model(pan, heavy_handle))).action
        != "grasp"
    )


def test_the_rule_of_the_way_is_the_margin(pan, heavy_plate):
    masses = PlausibleMassSet(pan, heavy_plate.mass[None] / 2, heavy_plate.mass[None])
    rule = make_stability_rule(masses, (0.0, 0.0, 0.0), TABLE, 0.01)
    poses = np.column_stack([np.linspace(0.0, 0.6, 40), np.zeros(40), np.zeros(40)])
    margins = calc_stability_margins(masses, poses, TABLE)
    np.testing.assert_array_equal(rule(poses), margins >= 0.01 - 1e-4)
    assert 10 < rule(poses).sum() < 40


def test_a_slide_is_safe_with_every_draw_all_the_way(pan, parts, heavy_plate):
    rng = np.random.default_rng(2)
    masses = PlausibleMassSet(pan, heavy_plate.mass[None] / 1.5, heavy_plate.mass[None])
    draws = [
        CellParameters(heavy_plate.mass * rng.uniform(0.8, 1.25, pan.n), heavy_plate.friction)
        for _ in range(3)
    ]
    pose = np.array([0.1, 0.0, 0.3])
    goals = find_pregrasp_goals(masses, parts, pose, TABLE)
    slide = plan_slide(masses, heavy_plate, draws, pose, goals, TABLE)
    assert slide is not None
    assert slide.planned.cost < calc_goal_error(pan, pose, slide.goal.pose)
    for params in (heavy_plate, *draws):
        motion = simulate_near_edge(Model(pan, params), slide.planned.push, pose, TABLE)
        assert not motion.fell
        assert calc_stability_margins(masses, motion.poses, TABLE).min() > 0.001
    np.testing.assert_allclose(
        simulate_near_edge(Model(pan, heavy_plate), slide.planned.push, pose, TABLE).final_pose,
        slide.planned.pose,
        atol=2e-3,
    )


def test_slides_goals_and_pokes_keep_clear_of_what_else_lies_there(pan, parts, heavy_plate):
    masses = PlausibleMassSet(pan, heavy_plate.mass[None] / 1.5, heavy_plate.mass[None])
    draws = [CellParameters(heavy_plate.mass[::-1].copy(), heavy_plate.friction)]
    pose, body = np.array([0.1, 0.0, 0.3]), make_body(pan)

    def come_near(poses, obstacle):
        return min(transform_shape(each, body).distance(obstacle) for each in poses)

    free_goal, *_ = find_pregrasp_goals(masses, parts, pose, TABLE)
    there = transform_shape(free_goal.pose, body).intersection(TABLE.polygon)
    blocked_goal = there.representative_point().buffer(0.02)
    goals = find_pregrasp_goals(masses, parts, pose, TABLE, obstacles=(blocked_goal,))
    assert goals and come_near([free_goal.pose], blocked_goal) == 0.0
    assert all(come_near([goal.pose], blocked_goal) >= GOAL_ROOM for goal in goals)

    def slide(obstacles):
        goals = find_pregrasp_goals(masses, parts, pose, TABLE)
        return plan_slide(masses, heavy_plate, draws, pose, goals, TABLE, obstacles=obstacles)

    free = slide(())
    end = simulate_near_edge(Model(pan, heavy_plate), free.planned.push, pose, TABLE).final_pose
    swept = transform_shape(end, body) - transform_shape(pose, body).buffer(OBSTACLE_MARGIN)
    obstacle = swept.representative_point().buffer(0.002)
    kept = slide((obstacle,))
    for params in (heavy_plate, *draws):
        path = simulate_near_edge(Model(pan, params), free.planned.push, pose, TABLE).poses
        assert come_near(path, obstacle) < OBSTACLE_MARGIN  # without the rule it is not clear
        if kept is not None:
            path = simulate_near_edge(Model(pan, params), kept.planned.push, pose, TABLE).poses
            assert come_near(path, obstacle) > OBSTACLE_MARGIN - 0.003

    model = Belief.of_prior(pan)
    beside = shapely.box(-0.2, 0.12, 0.4, 0.13)  # a wall along one side
    poke = PreGraspPlanner(pan, TABLE, obstacles=(beside,)).propose_poke(model, pose).push
    assert shapely.LineString(poke.xy).distance(beside) > OBSTACLE_MARGIN
    motion = simulate(Model(pan, model.params), poke, pose, regime="quasi_static")
    room = come_near([pose], beside)
    assert come_near(motion.poses, beside) >= min(room, OBSTACLE_MARGIN) - 1e-5


def test_a_push_is_broken_off_that_comes_near_another_object(pan, heavy_plate):
    masses = PlausibleMassSet(pan, heavy_plate.mass[None] / 1.5, heavy_plate.mass[None])
    pose, look = np.zeros(3), 0.001
    end = make_body(pan).bounds[2]  # of the handle
    far = shapely.box(end + 0.1, -0.1, end + 0.11, 0.1)
    options = SlideOptions()
    monitor = PushMonitor.of_push(masses, TABLE, pose, options, look, (far,))
    assert monitor.find_fault(pose) is None
    assert monitor.find_fault(np.array([0.08, 0.0, 0.0])) is None
    fault = monitor.find_fault(np.array([0.09, 0.0, 0.0]))
    assert fault == "the object is 10 mm from another one"
    assert PushMonitor.of_push(masses, TABLE, pose, options, look).find_fault(pose) is None
    # One that lies beside another object may stay as near, but come no nearer.
    near = PushMonitor.of_push(masses, TABLE, np.array([0.09, 0.0, 0.0]), options, look, (far,))
    assert near.find_fault(np.array([0.09, 0.0, 0.0])) is None
    assert near.find_fault(np.array([0.095, 0.0, 0.0])) is not None


@pytest.mark.slow
def test_nothing_known_asks_for_a_poke_and_says_what_it_is_worth(pan, parts):
    planner = PreGraspPlanner(pan, TABLE, parts=parts)
    decision = planner.decide((0.0, 0.0, 0.0), None)
    assert decision.action == "poke"
    assert decision.push is not None
    assert "standard deviation" in decision.reason
    forecast = decision.forecast
    assert not forecast.across_edge
    assert forecast.std == pytest.approx(calc_center_std(Belief.of_prior(pan)))
    assert forecast.expected_std < forecast.std
    careful = PreGraspPlanner(
        pan, TABLE, PreGraspOptions(goal=GoalOptions(margin=0.06), max_pokes=5), parts
    )
    prior = Belief.of_prior(pan)
    asks = careful.decide((0.0, 0.0, 0.0), prior, pokes=4)
    assert asks.action == "poke"
    assert "across the edge" in asks.reason
    ends = careful.decide((0.0, 0.0, 0.0), prior, pokes=5)
    assert (ends.action, ends.push) == ("fail", None)
    assert "after 5 pokes" in ends.reason


def test_the_next_poke_says_what_the_one_before_was_worth():
    first, second = PokeForecast(False, 0.0304, 0.0082), PokeForecast(False, 0.0378, 0.02)
    said = first.describe_outcome(second)
    assert "expected to leave 8.2 mm and left 37.8 mm" in said
    assert first.describe_outcome(PokeForecast(False, 0.00822, 0.002)) == ""
    assert first.describe_outcome(PokeForecast(True, 0.0378, 0.02)) == ""
    assert "bring the standard deviation of the center from 30.4 mm to 8.2 mm" in first.describe()
    assert "is 19.2 mm, and may be 20.9 mm" in PokeForecast(False, 0.0192, 0.0209).describe()


def test_what_no_poke_can_tell_is_not_poked_for(pan, parts):
    planner = PreGraspPlanner(pan, TABLE, parts=parts)
    prior = Belief.of_prior(pan)
    sure = Posterior(
        prior.posterior.mean, 1e-6 * prior.posterior.covariance, prior.posterior.prior_covariance
    )
    model = Belief(prior.bodies, posterior=sure, friction_range=(0.001, 1.0))
    decision = planner.decide((0.0, 0.0, 0.0), model, pokes=3)
    assert decision.action == "fail"
    assert "closer friction bounds" in decision.reason


def test_where_no_poke_can_be_made_what_is_known_has_to_do(pan, parts, heavy_plate):
    """As of an object that was weighed, surprised, and lies where pokes might push it off."""
    nowhere = PreGraspOptions(poke_margin=1.0)
    planner = PreGraspPlanner(pan, TABLE, nowhere, parts)
    prior = Belief.of_prior(pan).posterior
    logs = np.log(np.append(heavy_plate.relative_friction(), heavy_plate.contact_friction))
    sure = Posterior(logs, 1e-8 * prior.covariance, prior.prior_covariance)
    bodies = Belief.of_parameters(Model(pan, heavy_plate)).bodies
    known = Belief(bodies, posterior=sure, friction_range=(0.34, 0.36))
    at = (0.1, 0.0, 0.0)
    assert PreGraspPlanner(pan, TABLE, parts=parts).decide(at, known).action == "poke"
    assert planner.propose_poke(known, at).push is None
    assert planner.decide(at, known).action == "slide"
    ends = planner.decide(at, Belief(bodies, posterior=sure, friction_range=(0.001, 1.0)))
    assert ends.action == "fail"
    assert "no poke keeps the object on the table" in ends.reason


def test_where_no_pose_can_be_grasped_at_pokes_are_not_wasted(pan, parts):
    clumsy = ArmLimits(can_grasp=lambda goal, masses: False)
    planner = PreGraspPlanner(pan, TABLE, PreGraspOptions(max_arm=0.1), parts, clumsy)
    asks = planner.decide((0.0, 0.0, 0.0), Belief.of_prior(pan), pokes=2)
    assert asks.action == "poke"
    ends = planner.decide((0.0, 0.0, 0.0), Belief.of_prior(pan), pokes=3)
    assert (ends.action, ends.goal) == ("fail", None)
    assert "within 100 mm of the center of mass" in ends.reason
    assert "arm can take it" in ends.reason


def test_a_part_too_far_off_is_hoped_for_while_the_center_may_be_nearer(pan, parts, heavy_plate):
    far = tuple(part for part in parts if part.p_BG[0] > 0.15)
    planner = PreGraspPlanner(pan, TABLE, PreGraspOptions(max_arm=0.1), far)
    asks = planner.decide((0.0, 0.0, 0.0), Belief.of_prior(pan), pokes=3)
    assert asks.action == "poke"
    assert "no pose lets" in asks.reason
    ends = planner.decide((0.0, 0.0, 0.0), Belief.of_parameters(Model(pan, heavy_plate)), pokes=3)
    assert ends.action == "fail"


def test_a_decision_forgets_where_the_object_was(pan, parts, heavy_plate):
    planner, model = (
        PreGraspPlanner(pan, TABLE, parts=parts),
        Belief.of_parameters(Model(pan, heavy_plate)),
    )
    first = planner.decide((0.1, 0.0, 0.3), model)
    planner.decide((-0.2, 0.1, 2.0), model)
    again = planner.decide((0.1, 0.0, 0.3), model)
    np.testing.assert_array_equal(first.push.xy, again.push.xy)


@pytest.mark.parametrize("surface", [TABLE, pytest.param(ROUND, marks=pytest.mark.slow)])
def test_a_plan_ends_with_something_to_grasp(pan, parts, heavy_plate, surface):
    planner = PreGraspPlanner(pan, surface, parts=parts)
    middle = surface.polygon.centroid
    plan = plan_pregrasp(
        planner, Belief.of_parameters(Model(pan, heavy_plate)), (middle.x, middle.y, 2.0)
    )
    assert plan.status == PreGraspPlanStatus.READY, plan.message
    assert 1 <= len(plan.pushes) == len(plan.poses) - 1
    assert calc_overhangs(parts, plan.poses[-1], surface).max() > 0
    assert calc_loads(Model(pan, heavy_plate), plan.poses[-1], surface.corners) is not None


@pytest.mark.parametrize("pose", [(np.nan, 0.0, 0.0), (0.0, 0.0)])
def test_a_pose_that_is_none_is_refused(pan, parts, pose):
    planner = PreGraspPlanner(pan, TABLE, parts=parts)
    with pytest.raises(PlanningError, match="expected three finite numbers"):
        plan_pregrasp(planner, Belief.of_prior(pan), pose)


def test_a_plan_without_a_safe_goal_says_so(pan, parts):
    options = PreGraspOptions(goal=GoalOptions(margin=0.065))
    planner = PreGraspPlanner(pan, TABLE, options, parts)
    plan = plan_pregrasp(planner, Belief.of_prior(pan), (0.0, 0.0, 0.0))
    assert plan.status == PreGraspPlanStatus.POKE_FIRST
    assert plan.poke is not None
    certain = Belief.of_parameters(Model(pan))
    assert plan_pregrasp(planner, certain, (0.0, 0.0, 0.0)).status == PreGraspPlanStatus.FAILED


def test_the_whole_task_with_hidden_masses(pan, parts):
    truth = CellParameters.random(pan, 3, friction_range=(0.25, 0.5))
    planner = PreGraspPlanner(pan, TABLE, parts=parts)
    world = EdgeWorld(Model(pan, truth), (0.02, 0.03, 0.5), TABLE, **NOISE)
    outcome = run_pregrasp(world, planner)
    assert outcome.grasped, outcome
    assert not outcome.dropped
    assert outcome.pokes >= 3
    assert outcome.slides >= 1


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_hidden_masses_never_fall(pan, parts, seed):
    truth = CellParameters.random(pan, seed, friction_range=(0.25, 0.5))
    surface = (TABLE, ROUND)[seed % 2]
    planner = PreGraspPlanner(pan, surface, parts=parts)
    middle = surface.polygon.centroid
    start = np.array([middle.x, middle.y, float(seed)])
    world = EdgeWorld(Model(pan, truth), start, surface, **NOISE, seed=seed)
    outcome = run_pregrasp(world, planner)
    assert not outcome.dropped, outcome
    assert outcome.grasped, outcome


class MovedWorld(EdgeWorld):
    """A world in which somebody lays the object elsewhere, after the third push and before the fourth is decided on."""

    looks = 0

    def observe(self):
        self.looks += 1
        if self.looks == 4:
            assert self.pushes == 3
            self.put((-0.15, 0.1, -2.0))
        return super().observe()


@pytest.mark.slow
def test_an_object_that_somebody_moved_is_slid_from_where_it_is(pan, parts):
    truth = CellParameters.random(pan, 3, friction_range=(0.25, 0.5))
    planner = PreGraspPlanner(pan, TABLE, parts=parts)
    world = MovedWorld(Model(pan, truth), (0.02, 0.03, 0.5), TABLE, **NOISE)
    outcome = run_pregrasp(world, planner)
    assert world.looks > 4
    assert outcome.grasped, outcome
