import re
from pathlib import Path

import numpy as np
import pytest
import shapely
from shapely import Polygon, box

from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.pusher import Pusher
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import PlanningError
from gridpush_drake.geometry.se2 import rotate
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.contact import limit_surface
from gridpush_drake.planning.contact.contact_kernels import solve_damped_step
from gridpush_drake.planning.contact.limit_surface import predict_roughly, screen
from gridpush_drake.planning.contact.optimization import (
    make_runner,
    optimize_contact,
)
from gridpush_drake.planning.contact.reachable_outline import find_reachable_outline
from gridpush_drake.planning.contact.trial import (
    ContactOptions,
    calc_cost_derivatives,
    calc_goal_error,
)
from gridpush_drake.planning.push_constraints import PushConstraints
from gridpush_drake.planning.support_surface import SupportSurface
from tests.helpers.finite_difference import check_jacobian
from tests.helpers.random_objects import make_random_parameters
from tests.helpers.rough_pushes import predict_roughly as follow_in_numpy
from tests.helpers.shapes import make_shape

POSE, GOAL = (0.1, -0.05, 0.4), (0.25, 0.1, 1.1)


@pytest.fixture(scope="module")
def hammer():
    return make_shape("claw_hammer", 60)


def make_params(obj, seed=0):
    return make_random_parameters(np.random.default_rng(seed), obj)


def run_fixed(obj, params, distance, **changes):
    """A runner of pushes of one distance only."""
    options = ContactOptions(distance_range=(distance, distance), **changes)
    return make_runner(Model(obj, params), np.array(POSE), np.array(GOAL), None, options)


def test_the_cost_is_the_mean_distance_of_the_cells(hammer):
    moved = np.array(GOAL) + [0.03, 0.04, 0.0]
    assert calc_goal_error(hammer, moved, GOAL) == pytest.approx(0.05, rel=1e-12)
    assert calc_goal_error(hammer, GOAL, np.array(GOAL) + [0, 0, 2 * np.pi]) == pytest.approx(
        0.0, abs=1e-12
    )


def test_the_cost_s_derivatives_by_the_pose(hammer):
    pose, goal = np.array(POSE), np.array(GOAL)
    slope, curvature = calc_cost_derivatives(hammer, pose, goal, np.eye(3))
    check_jacobian(lambda q: calc_goal_error(hammer, q, goal), pose, slope, order=4, step=1e-4)
    assert np.linalg.eigvalsh(curvature).min() > 0


@pytest.mark.parametrize("shape", ["claw_hammer", "l_bracket", "triangle", "bar"])
@pytest.mark.parametrize("place", [0.11, 0.43, 0.83])
@pytest.mark.parametrize("angle", [-0.15, 0.1])
def test_the_cost_s_derivatives_by_the_push(shape, place, angle):
    obj = make_shape(shape, 40)
    params, distance = make_params(obj, 1), 0.06
    runner = run_fixed(obj, params, distance)
    s, piece = runner.reach.find_nearest(place * runner.reach.perimeter)
    trial = runner.run(float(s), int(piece), angle, gradient=True)
    assert trial.distance == pytest.approx(distance, rel=1e-12)

    def cost(x):
        return runner.run(float(x[0]), int(piece), float(x[1])).cost

    x = np.array([float(s), angle])
    check_jacobian(cost, x, trial.slope[:2], step=1e-4, order=4, rtol=2e-4, atol=2e-5)


def test_the_best_distance_is_found_on_the_way(hammer):
    params, other = make_params(hammer), 0.002
    wide = run_fixed(hammer, params, 0.1)
    wide.distance_range = (0.02, 0.2)
    s, piece = wide.reach.spread(0.03)
    trials = [wide.run(float(s[i]), int(piece[i]), 0.1, gradient=True) for i in range(len(s))]
    inside = [trial for trial in trials if 0.03 < trial.distance < 0.19]
    assert len(inside) > 3
    for trial in inside:
        before, at, after = (
            run_fixed(hammer, params, trial.distance + by)
            .run(trial.arc_length, trial.piece, 0.1)
            .cost
            for by in (-other, 0, other)
        )
        assert at < min(before, after)
        assert at == pytest.approx(trial.cost, abs=1e-5)
        assert abs(trial.slope[2]) < 0.1


@pytest.mark.parametrize(("shape", "seed"), [("claw_hammer", 0), ("l_bracket", 1), ("bar", 2)])
def test_the_gradient_finds_what_the_exhaustive_search_finds(shape, seed):
    obj = make_shape(shape, 60)
    params = make_params(obj, seed)
    plan = optimize_contact(Model(obj, params), POSE, GOAL)
    assert plan.status == "ok"
    assert plan.cost < 0.6 * plan.start_cost
    assert (
        plan.cost - optimize_contact(Model(obj, params), POSE, GOAL, method="exhaustive").cost
        < 0.001
    )
    assert plan.simulations <= ContactOptions().budget


@pytest.mark.parametrize("method", ["gradient", "finite_difference", "exhaustive"])
def test_every_method_predicts_what_the_simulation_does(hammer, method):
    params = make_params(hammer)
    options = ContactOptions(places=20, angles=3, refined=0)
    plan = optimize_contact(Model(hammer, params), POSE, GOAL, method=method, options=options)
    push = plan.push
    motion = simulate(Model(hammer, params), push.push, POSE, regime="quasi_static")
    np.testing.assert_allclose(motion.final_pose, push.pose, atol=1e-5)
    assert calc_goal_error(hammer, push.pose, GOAL) == pytest.approx(push.cost, abs=1e-12)
    again = Push.on_outline(
        hammer,
        push.arc_length,
        push.angle,
        push.distance,
        radius=0.008,
        speed=0.03,
        pose=POSE,
        clearance=0.002,
    )
    np.testing.assert_array_equal(again.xy, push.push.xy)
    assert [other.cost for other in plan.candidates] == sorted(
        other.cost for other in plan.candidates
    )
    if method == "exhaustive":
        assert 60 <= plan.simulations <= 63


def test_the_same_every_time(hammer):
    params = make_params(hammer)
    first, second = (optimize_contact(Model(hammer, params), POSE, GOAL) for _ in range(2))
    assert (first.push.arc_length, first.push.angle, first.push.distance, first.cost) == (
        second.push.arc_length, second.push.angle, second.push.distance, second.cost
    )  # fmt: skip
    assert first.simulations == second.simulations


def test_nearly_there_nothing_helps(hammer):
    plan = optimize_contact(Model(hammer, make_params(hammer)), GOAL, GOAL)
    assert plan.status == "no_improvement"
    assert plan.cost >= plan.start_cost == 0


@pytest.mark.parametrize("radius", [0.004, 0.008, 0.02])
def test_reachable_places_are_those_where_the_disc_fits(hammer, radius):
    reach = find_reachable_outline(hammer, radius)
    fine = np.linspace(0, reach.perimeter, 800, endpoint=False) + 1e-5
    places, _ = reach.find_nearest(fine)
    solid = Polygon(hammer.outline.exterior)
    for s, nearest in zip(fine, places, strict=True):
        point, _, normal = hammer.edges.at(s)
        room = solid.distance(shapely.Point(point + radius * normal))
        if abs(nearest - s) < 1e-9:
            assert room > radius - 2e-6
        elif abs(nearest - s) > 1e-4:
            assert room < radius


def test_a_slot_narrower_than_the_finger_is_left_out():
    u_shape = Polygon(
        [
            (0, 0),
            (0.1, 0),
            (0.1, 0.06),
            (0.055, 0.06),
            (0.055, 0.02),
            (0.045, 0.02),
            (0.045, 0.06),
            (0, 0.06),
        ]
    )
    obj = GridObject.from_outline(u_shape, max_cells=60, name="u")
    for radius, fits in ((0.003, True), (0.008, False)):
        reach = find_reachable_outline(obj, radius)
        s, piece = reach.spread(0.001)
        points = reach.point(s, piece)
        inside = (
            (points[:, 0] > 0.044)
            & (points[:, 0] < 0.056)
            & (points[:, 1] > 0.01)
            & (points[:, 1] < 0.059)
        )
        assert inside.any() == fits


def test_nowhere_to_touch():
    obj = make_shape("square", 16)
    assert find_reachable_outline(obj, 0.5).length > 0.1
    with pytest.raises(PlanningError, match="radius"):
        find_reachable_outline(obj, 0.0)
    with pytest.raises(PlanningError, match="clearance"):
        find_reachable_outline(obj, 0.01, -0.001)


def test_the_finger_stays_over_the_table_and_the_object_on_it():
    bar = make_shape("bar", 60)
    params = make_params(bar)
    table = SupportSurface.rectangle((0.0, 0.0), (0.5, 0.4))
    pose, goal = (0.0, -0.185, 0.0), (0.0, 0.1, 0.3)
    rules = PushConstraints(table, finger_inset=0.005)
    free = optimize_contact(Model(bar, params), pose, goal)
    plan = optimize_contact(Model(bar, params), pose, goal, constraints=rules)
    over = table.polygon.buffer(-0.005)
    assert not over.contains(shapely.LineString(free.push.push.xy))
    assert plan.candidates
    for push in plan.candidates:
        assert over.buffer(1e-6).contains(shapely.LineString(push.push.xy))
        motion = simulate(Model(bar, params), push.push, pose, regime="quasi_static")
        assert table.contains_cells(bar, motion.poses, -2e-4).all()
    assert plan.cost > free.cost


def test_what_hangs_over_may_not_hang_over_further(hammer):
    params = make_params(hammer)
    table = SupportSurface.rectangle((0.0, 0.0), (0.5, 0.5))
    pose, goal = (0.2, 0.0, 0.0), (0.3, 0.05, 0.0)
    most = -table.cell_distances(hammer, np.array(pose)).min()
    assert most > 0.005
    plan = optimize_contact(
        Model(hammer, params), pose, goal, constraints=PushConstraints(table, finger_inset=-0.1)
    )
    for push in plan.candidates:
        motion = simulate(Model(hammer, params), push.push, pose, regime="quasi_static")
        assert -table.cell_distances(hammer, motion.poses).min() < most + 2e-4


def test_obstacles_stop_object_and_finger(hammer):
    params = make_params(hammer)
    pose, goal = (0.0, 0.0, 0.0), (0.2, 0.0, 0.0)
    wall = box(0.12, -0.3, 0.14, 0.3)
    plan = optimize_contact(
        Model(hammer, params), pose, goal, constraints=PushConstraints(obstacles=(wall,))
    )
    outline = hammer.outline
    for push in plan.candidates:
        motion = simulate(Model(hammer, params), push.push, pose, regime="quasi_static")
        assert wall.distance(shapely.LineString(push.push.xy)) > 0.008
        for x, y, theta in motion.poses[::10]:
            moved = shapely.affinity.translate(
                shapely.affinity.rotate(outline, theta, (0, 0), use_radians=True), x, y
            )
            assert wall.distance(moved) > 0.004


def test_a_finger_shut_out_finds_no_contact():
    obj = make_shape("square", 16)
    ring = Polygon(box(-0.1, -0.1, 0.1, 0.1).exterior, [box(-0.055, -0.055, 0.055, 0.055).exterior])
    walls = tuple(shapely.get_parts(shapely.constrained_delaunay_triangles(ring)))
    rules = PushConstraints(obstacles=walls, obstacle_margin=0.001)
    for method in ("gradient", "finite_difference", "exhaustive"):
        plan = optimize_contact(
            Model(obj, make_params(obj)), (0, 0, 0), (0.2, 0, 0), method=method, constraints=rules
        )
        assert (plan.status, plan.push, plan.simulations) == ("no_reachable_contact", None, 0)


def test_a_further_rule_is_kept(hammer):
    params = make_params(hammer)
    rules = PushConstraints(pose_rule=lambda poses: poses[:, 2] < POSE[2] + 0.1)
    plan = optimize_contact(Model(hammer, params), POSE, GOAL, constraints=rules)
    assert plan.push is not None
    assert all(push.pose[2] < POSE[2] + 0.1 for push in plan.candidates)
    assert optimize_contact(Model(hammer, params), POSE, GOAL).push.pose[2] > POSE[2] + 0.1


def test_the_rule_of_the_page_is_kept():
    page = Path(__file__).parents[3] / "docs" / "extending.md"
    if not page.is_file():
        pytest.skip("a wheel's tests have no docs beside them")
    section = page.read_text().partition("## A rule that pushes keep")[2]
    names = {}
    exec(re.search("```python\n(.*?)```", section, re.DOTALL)[1], names)
    plan, start = names["plan"], names["start"]
    assert plan.status == "ok"
    assert all(abs(push.pose[2] - start[2]) <= np.pi / 4 for push in plan.candidates)


def test_the_limit_surface_ranks_pushes(hammer):
    params = make_params(hammer)
    reach = find_reachable_outline(hammer, 0.008)
    s, piece = reach.spread(0.02)
    normal = reach.normal[piece]
    start = reach.point(s, piece) + 0.008 * normal
    rough = predict_roughly(Model(hammer, params), start, -normal, 0.1, 0.008)[-1]
    exact = np.array(
        [
            simulate(
                Model(hammer, params), Push(p, -0.03 * n, 0.1 / 0.03, 0.008), regime="quasi_static"
            ).final_pose
            for p, n in zip(start, normal, strict=True)
        ]
    )
    off = np.array([calc_goal_error(hammer, a, b) for a, b in zip(rough, exact, strict=True)])
    moved = calc_goal_error(hammer, exact, np.zeros(3))
    assert np.median(off) < 0.15 * np.median(moved)


def test_rough_pushes_are_those_in_numpy(hammer):
    params = make_params(hammer)
    reach = find_reachable_outline(hammer, 0.008)
    s, piece = reach.spread(0.02)
    normal = reach.normal[piece]
    start = reach.point(s, piece) + 0.01 * normal
    direction = rotate(np.linspace(-1.0, 1.0, len(s)), -normal)
    found = predict_roughly(Model(hammer, params), start, direction, 0.15, 0.008)
    expected = follow_in_numpy(hammer, params, start, direction, 0.15, 0.008)
    np.testing.assert_allclose(found, expected, atol=1e-9)
    assert np.ptp(found[-1], axis=0).min() > 0.05


def test_the_cost_s_matrix_is_the_sum_over_the_cells(hammer):
    pose, goal = np.array(POSE), np.array(GOAL)
    dq_dx = np.random.default_rng(0).normal(size=(3, 3))
    r = hammer.cells_at(pose) - hammer.cells_at(goal)
    arm = hammer.cells_at(pose) - pose[:2]
    dp_dq = np.zeros((hammer.n, 2, 3))
    dp_dq[:, 0, 0] = dp_dq[:, 1, 1] = 1.0
    dp_dq[:, :, 2] = np.column_stack([-arm[:, 1], arm[:, 0]])
    dp_dx = dp_dq @ dq_dx
    length = np.linalg.norm(r, axis=1)
    _, H = calc_cost_derivatives(hammer, pose, goal, dq_dx)
    expected = np.einsum("ijk,ijl,i->kl", dp_dx, dp_dx, 1.0 / length) / hammer.n
    np.testing.assert_allclose(H, expected, rtol=1e-12)
    assert calc_goal_error(hammer, pose, goal) == pytest.approx(length.mean(), rel=1e-12)


def test_a_damped_step_solves_its_equations():
    rng = np.random.default_rng(0)
    for free in ([True, True, True], [True, False, True], [False, True, True]):
        root = rng.normal(size=(3, 3))
        H = root @ root.T
        slope = rng.normal(size=3)
        free = np.array(free)
        dx = np.empty(3)
        limit = np.full(3, np.inf)
        gain = solve_damped_step(H, slope, 0.3, 1e-12, free, limit, dx)
        damped = H + 0.3 * np.diag(np.diag(H))
        expected = np.zeros(3)
        expected[free] = np.linalg.solve(damped[np.ix_(free, free)], -slope[free])
        np.testing.assert_allclose(dx, expected, atol=1e-12)
        assert gain == pytest.approx(-(slope @ dx + dx @ H @ dx / 2))
        # shortened as a whole to the limit that is passed by most
        limit = np.abs(expected) + 1.0
        longest = int(np.argmax(np.abs(expected)))
        limit[longest] = abs(expected[longest]) / 4
        solve_damped_step(H, slope, 0.3, 1e-12, free, limit, dx)
        np.testing.assert_allclose(dx, expected / 4, atol=1e-12)


def test_a_trial_that_is_no_better_has_no_derivatives(hammer):
    runner = run_fixed(hammer, make_params(hammer), 0.06)
    s, piece = runner.reach.find_nearest(0.3)
    trial = runner.run(float(s), int(piece), 0.1, gradient=True)
    same = runner.run(float(s), int(piece), 0.1, gradient=True, better_than=trial.cost)
    assert (same.cost, same.distance) == (trial.cost, trial.distance)
    assert trial.slope is not None
    assert same.slope is None


def test_screening_keeps_its_starts_apart(hammer):
    options = ContactOptions(starts=10)
    runner = make_runner(
        Model(hammer, make_params(hammer)), np.array(POSE), np.array(GOAL), None, options
    )
    found = screen(runner)
    assert runner.simulations == 0
    assert len(found.arc_length) == 10
    assert (np.diff(found.rough_cost) >= 0).all()
    gap = np.abs(found.arc_length[:, None] - found.arc_length)
    gap = np.minimum(gap, runner.reach.perimeter - gap) / runner.reach.perimeter
    turn = np.abs(found.angle[:, None] - found.angle)
    assert (((gap >= 0.05) | (turn >= 0.3)) | np.eye(10, dtype=bool)).all()


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"method": "newton"}, "method.*gradient"),
        ({"goal": (0, 0)}, "goal.*three"),
        ({"pose": (0, 0, np.nan)}, "pose.*three"),
    ],
)
def test_refuses(hammer, arguments, says):
    given = {"pose": POSE, "goal": GOAL, **arguments}
    with pytest.raises(PlanningError, match=says):
        optimize_contact(Model(hammer, make_params(hammer)), **given)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: ContactOptions(distance_range=(0.1, 0.05)), "distance_range"),
        (lambda: Pusher(speed=0.0), "speed"),
        (lambda: ContactOptions(angle_range=(-2.0, 0.0)), "angle_range"),
        (lambda: ContactOptions(starts=0), "starts"),
        (lambda: PushConstraints(edge_margin=np.nan), "edge_margin"),
        (lambda: PushConstraints(obstacle_margin=-0.1), "obstacle_margin"),
        (lambda: PushConstraints(obstacles=(Polygon(),)), "obstacles"),
    ],
)
def test_refuses_options(make, says):
    with pytest.raises(PlanningError, match=says):
        make()


def test_asking_the_rules_in_blocks_picks_the_same_pushes(monkeypatch):
    """With blocks of one push each is asked about when its turn comes."""
    obj = make_shape("claw_hammer", max_cells=50)
    surface = SupportSurface.rectangle((0.0, 0.0), (0.6, 0.5))
    constraints = PushConstraints(surface, edge_margin=0.0)
    for seed in range(3):
        rng = np.random.default_rng(seed)
        pose, goal = rng.uniform(-0.12, 0.12, (2, 3)) * (1, 1, 20)
        runner = make_runner(
            Model(obj, CellParameters.random(obj, seed)), pose, goal, constraints, ContactOptions()
        )
        picked = [screen(runner)]
        for block in (1, 5):
            monkeypatch.setattr(limit_surface, "BLOCK_SIZE", block)
            picked.append(screen(runner))
        monkeypatch.undo()
        assert len(picked[0].arc_length) > 2
        for other in picked[1:]:
            for name in ("arc_length", "piece", "angle", "rough_cost"):
                np.testing.assert_array_equal(getattr(other, name), getattr(picked[0], name))
