import numpy as np
import pytest
import shapely
from shapely import box

from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import PlanningError
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.closed_loop import LoopOptions
from gridpush_drake.planning.contact.trial import calc_goal_error
from gridpush_drake.planning.goal.cost_to_go import CostToGo
from gridpush_drake.planning.goal.next_push import GoalRules
from gridpush_drake.planning.goal.push_plan import plan_pushes
from gridpush_drake.planning.goal.push_to_goal import push_to_goal
from gridpush_drake.planning.push_constraints import PushConstraints
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.planning.world import SimulatedWorld
from tests.helpers.made_identifications import make_block
from tests.helpers.shapes import make_shape

TABLE = SupportSurface.round((0.0, 0.0), 0.5)
START, GOAL = (-0.2, 0.1, 0.3), (0.15, -0.1, 2.4)
WALL = box(-0.02, -0.3, 0.02, 0.12)


@pytest.fixture(scope="module")
def block():
    return make_block(24)


@pytest.fixture(scope="module")
def hidden(block):
    return CellParameters.by_part(block, {1: 0.05, 2: 0.6}, 0.4, 0.4)


def check_plan(obj, params, plan):
    """Replays a plan's pushes one after another."""
    pose = plan.start
    motions = []
    for planned in plan.pushes:
        motion = simulate(Model(obj, params), planned.push, pose, regime="quasi_static")
        np.testing.assert_allclose(motion.final_pose, planned.pose, atol=1e-5)
        motions.append(motion)
        pose = planned.pose
    assert calc_goal_error(obj, pose, plan.goal) == pytest.approx(plan.error, abs=1e-9)
    return motions


def place(obj, pose):
    turned = shapely.affinity.rotate(obj.outline, pose[2], (0, 0), use_radians=True)
    return shapely.affinity.translate(turned, pose[0], pose[1])


@pytest.mark.parametrize("horizon", [1, 2])
def test_a_plan_ends_at_the_goal(block, hidden, horizon):
    plan = plan_pushes(
        Model(block, hidden),
        START,
        GOAL,
        GoalRules(PushConstraints(TABLE), horizon=horizon, tolerance=0.005),
    )
    assert (plan.status, plan.reached) == ("reached", True)
    assert 2 <= len(plan.pushes) <= 6
    assert plan.error <= 0.005
    for motion in check_plan(block, hidden, plan):
        assert TABLE.contains_cells(block, motion.poses, -2e-4).all()


def test_nothing_to_do(block, hidden):
    plan = plan_pushes(Model(block, hidden), GOAL, GOAL)
    assert (plan.status, len(plan.pushes), plan.simulations) == ("reached", 0, 0)


def test_a_plan_goes_round_an_obstacle(block, hidden):
    start, goal = (-0.15, 0.0, 0.0), (0.15, 0.0, 0.0)
    rules = PushConstraints(SupportSurface.rectangle((0.0, 0.0), (0.8, 0.6)), (WALL,))
    plan = plan_pushes(Model(block, hidden), start, goal, GoalRules(rules, horizon=2))
    assert plan.status == "reached"
    assert plan.poses[:, 1].max() > 0.12
    for planned, motion in zip(plan.pushes, check_plan(block, hidden, plan), strict=True):
        assert WALL.distance(shapely.LineString(planned.push.xy)) > planned.push.radius
        assert min(WALL.distance(place(block, pose)) for pose in motion.poses[::5]) > 0.004


@pytest.mark.parametrize(
    ("start", "goal", "rules", "status"),
    [
        (START, (0.6, 0.0, 0.0), PushConstraints(TABLE), "goal_off_table"),
        ((0.6, 0.0, 0.0), GOAL, PushConstraints(TABLE), "start_off_table"),
        (START, (0.01, 0.0, 0.0), PushConstraints(TABLE, (WALL,)), "goal_blocked"),
        ((0.01, 0.0, 0.0), GOAL, PushConstraints(TABLE, (WALL,)), "start_blocked"),
        (START, GOAL, PushConstraints(TABLE, (box(-0.02, -0.6, 0.02, 0.6),)), "no_path"),
        (
            START,
            GOAL,
            PushConstraints(TABLE, pose_rule=lambda poses: abs(poses - START).max(axis=1) < 1e-3),
            "stuck",
        ),
    ],
)
def test_says_why_not(block, hidden, start, goal, rules, status):
    plan = plan_pushes(
        Model(block, hidden),
        start,
        goal,
        GoalRules(rules, horizon=2, max_pushes=2, tolerance=0.001),
    )
    assert plan.status == status
    assert len(plan.pushes) == 0 or status == "stuck"
    assert plan.reason.endswith(".")
    assert not plan.reached


def test_counts_its_pushes(block, hidden):
    plan = plan_pushes(
        Model(block, hidden), START, GOAL, GoalRules(horizon=2, max_pushes=1, tolerance=0.001)
    )
    assert (plan.status, len(plan.pushes)) == ("too_many_pushes", 1)


def test_the_path_is_as_long_as_the_cells_go(block):
    rules = PushConstraints(SupportSurface.rectangle((0.0, 0.0), (0.8, 0.6)), (WALL,))
    goal, start = np.array([0.15, 0.0, 0.0]), np.array([-0.15, 0.0, 0.0])
    path = CostToGo(block, start, goal, rules.start_at(block, start, 0.008))
    # over the wall's end, half the block's width and the obstacle's margin above it
    height = 0.12 + 0.03 + 0.005
    shortest = 2 * (np.hypot(0.15 - 0.02, height) + 0.02)
    assert shortest - 0.08 < path.calc_cost(start) < 1.35 * shortest
    beside = np.array([0.15, 0.1, 0.0])
    assert path.calc_cost(beside) == pytest.approx(0.1, abs=1e-12)
    assert len(path.find_subgoals(start)) >= 1
    assert all(
        path.calc_cost(subgoal) < path.calc_cost(start) for subgoal in path.find_subgoals(start)
    )


@pytest.mark.parametrize("known", [True, False])
def test_reaches_the_goal_with_hidden_masses(block, hidden, known):
    world = SimulatedWorld(
        Model(block, hidden), START, TABLE, position_std=0.0005, angle_std=0.003, seed=1
    )
    run = push_to_goal(
        world,
        Model(make_block(24), hidden if known else None),
        GOAL,
        GoalRules(PushConstraints(TABLE), tolerance=0.015),
        learner=None,
    )
    assert run.status == "reached"
    assert calc_goal_error(block, world.truth.pose, GOAL) < 0.02
    assert len(run.log) == len(run.steps) == world.pushes <= 12
    assert run.error == pytest.approx(calc_goal_error(block, world.observe(), GOAL))
    assert run.identification is None


def test_learns_on_the_way(block, hidden):
    world = SimulatedWorld(Model(block, hidden), START, TABLE)
    seen = []
    run = push_to_goal(
        world, Model(make_block(24)), GOAL, GoalRules(PushConstraints(TABLE)), progress=seen.append
    )
    assert run.status == "reached"
    assert seen == list(run.steps)
    assert [step.learned for step in run.steps[:-1]][:2] == [True] * min(2, len(run.steps) - 1)
    assert not run.steps[-1].learned
    center = [
        params.relative_friction() @ block.p_BC
        for params in (run.params, hidden, CellParameters.uniform(block))
    ]
    assert np.linalg.norm(center[0] - center[1]) < 0.3 * np.linalg.norm(center[2] - center[1])


class MeddledWorld(SimulatedWorld):
    """Somebody moves the object after the first push, and hides it for the two looks that follow."""

    meddled, hidden_looks = False, 0

    def observe(self):
        if self.hidden_looks > 0:
            self.hidden_looks -= 1
            return None
        return super().observe()

    def execute(self, push):
        seen = super().execute(push)
        if not self.meddled:
            self.meddled, self.hidden_looks = True, 2
            self.put(self.truth.pose + [0.05, 0.1, 1.0])
        return seen


def test_goes_on_where_a_stranger_left_the_object(block, hidden):
    world = MeddledWorld(Model(block, hidden), START, TABLE)
    run = push_to_goal(
        world, Model(block, hidden), GOAL, GoalRules(PushConstraints(TABLE)), learner=None
    )
    assert run.status == "reached"
    assert calc_goal_error(block, run.steps[1].seen.pose, run.steps[0].seen.final_pose) > 0.05
    np.testing.assert_allclose(run.steps[1].prediction_error, 0.0, atol=1e-9)


def test_gives_up_on_an_object_that_is_not_seen(block, hidden):
    world = MeddledWorld(Model(block, hidden), START, TABLE)
    run = push_to_goal(
        world,
        Model(block, hidden),
        GOAL,
        learner=None,
        options=LoopOptions(observations=1, timeout=0.07),
    )
    assert (run.status, len(run.steps)) == ("lost", 1)
    assert "seen" in run.reason


def test_an_object_falls_where_its_center_of_mass_does(block, hidden):
    table = SupportSurface.rectangle((0.0, 0.0), (0.4, 0.4))
    com = hidden.center_of_mass(block)
    assert com[0] > 0.02
    for reach, falls in ((-0.012, False), (0.012, True)):
        world = SimulatedWorld(Model(block, hidden), (0.1, 0.0, 0.0), table)
        start = world.observe()[0] - 0.06 - 0.008
        way = 0.2 + reach - com[0] - world.observe()[0]
        world.execute(Push((start, 0.0), (0.03, 0.0), way / 0.03, 0.008))
        assert world.truth.pose[0] == pytest.approx(0.1 + way, abs=1e-3)
        assert world.truth.fallen == falls
        assert (world.observe() is None) == falls


def test_a_fallen_object_is_lost(block, hidden):
    world = SimulatedWorld(
        Model(block, hidden), (0.3, 0.0, 0.0), SupportSurface.rectangle((0.0, 0.0), (0.4, 0.4))
    )
    world.execute(Push((0.3, -0.1), (0.0, 0.03), 2.0, 0.008))
    run = push_to_goal(world, Model(block, hidden), GOAL, learner=None)
    assert (run.status, len(run.steps)) == ("lost", 0)
    assert np.isnan(run.error)


def test_noise_follows_its_seed(block, hidden):
    push = Push((-0.068, 0.0), (0.03, 0.0), 1.0, 0.008)
    first, again, other = (
        SimulatedWorld(
            Model(block, hidden), (0, 0, 0), position_std=0.001, angle_std=0.01, seed=seed
        ).execute(push)
        for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(first.poses_observed, again.poses_observed)
    assert np.abs(first.poses_observed - other.poses_observed).max() > 1e-4
    assert len(first.poses_observed) == 4


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: GoalRules(tolerance=0.0), "tolerance"),
        (lambda: GoalRules(max_pushes=-1), "max_pushes"),
        (lambda: GoalRules(horizon=3), "horizon"),
        (lambda: LoopOptions(timeout=0), "timeout"),
    ],
)
def test_refuses(make, says):
    with pytest.raises(PlanningError, match=says):
        make()


@pytest.mark.slow
def test_learning_predicts_better_than_not(block):
    later = {True: [], False: []}
    obj = make_shape("claw_hammer", 60)
    for seed in range(6):
        masses = CellParameters(
            np.where(obj.p_BC[:, 0] > 0.02, 4.0, 0.4 + 0.1 * seed), np.full(obj.n, 0.4)
        )
        for learns in later:
            world = SimulatedWorld(Model(obj, masses), START, TABLE, seed=seed)
            options = {} if learns else {"learner": None}
            run = push_to_goal(
                world,
                Model(obj),
                GOAL,
                GoalRules(PushConstraints(TABLE, edge_margin=-0.05)),
                **options,
            )
            assert run.status == "reached"
            later[learns] += [step.prediction_error for step in run.steps[1:]]
    assert np.mean(later[True]) < 0.6 * np.mean(later[False])
