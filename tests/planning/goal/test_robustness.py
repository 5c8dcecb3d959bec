from dataclasses import replace

import numpy as np
import pytest

from gridpush_drake.dynamics.pusher import DEFAULT_PUSHER_RADIUS
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import PlanningError
from gridpush_drake.geometry.se2 import transform
from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.contact.optimization import optimize_contact
from gridpush_drake.planning.contact.trial import ContactOptions
from gridpush_drake.planning.goal.cost_to_go import CostToGo
from gridpush_drake.planning.goal.next_push import (
    GoalRules,
    Robustness,
    RobustnessOptions,
    choose_push,
    draw_model_samples,
)
from gridpush_drake.planning.push_constraints import PushConstraints
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.planning.world import SimulatedWorld
from gridpush_drake.pushes.push_log import PushLog
from tests.helpers.shapes import make_shape

TABLE = SupportSurface.round((0.0, 0.0), 0.4)
RULES = PushConstraints(TABLE, finger_inset=-0.1)
POSE, GOAL = (0.05, 0.25, 0.1), (-0.1, 0.3, 0.9)
OPTIONS = RobustnessOptions()


@pytest.fixture(scope="module")
def bar():
    return make_shape("bar", 40)


@pytest.fixture(scope="module")
def even(bar):
    return CellParameters.uniform(bar)


def make_robustness(bar, even, samples=None, rules=RULES):
    samples = draw_model_samples(Model(bar, even), None, OPTIONS) if samples is None else samples
    return Robustness(bar, [even, *samples], rules, ContactOptions(), OPTIONS)


def test_samples_lean_to_every_side(bar, even):
    samples = draw_model_samples(Model(bar, even), None, OPTIONS)
    assert len(samples) == len(OPTIONS.tilts) * OPTIONS.sides
    centers = np.array([sample.relative_friction() @ bar.p_BC for sample in samples])
    assert centers[:, 0].max() > 0.03
    assert centers[:, 0].min() < -0.03
    np.testing.assert_allclose(centers.mean(axis=0), 0.0, atol=1e-9)


def test_learning_narrows_the_samples(bar):
    hidden = CellParameters(np.where(bar.p_BC[:, 0] > 0.05, 0.4, 0.05), np.full(bar.n, 0.4))
    world = SimulatedWorld(Model(bar, hidden), POSE)
    seen = []
    for _ in range(3):
        plan = optimize_contact(Model(bar), world.observe(), GOAL)
        seen.append(world.execute(plan.push.push))
    found = identify(Model(bar), PushLog(tuple(seen)), regime="quasi_static")
    spread = [
        np.std(
            [
                sample.relative_friction() @ bar.p_BC[:, 0]
                for sample in draw_model_samples(Model(bar, found.params), given, OPTIONS)
            ]
        )
        for given in (None, found)
    ]
    assert spread[1] < 0.3 * spread[0]


def test_a_push_goes_only_as_far_as_every_sample_allows(bar, even):
    robustness = make_robustness(bar, even)
    plan = optimize_contact(Model(bar, even), POSE, GOAL, constraints=RULES)
    found = [robustness.cut(np.array(POSE), push) for push in plan.candidates]
    cuts = [None if safe is None else safe.planned for safe in found]
    assert robustness.simulations == len(cuts) * (1 + OPTIONS.sides * len(OPTIONS.tilts))
    shorter = [
        (whole, cut)
        for whole, cut in zip(plan.candidates, cuts, strict=True)
        if cut is not None and cut is not whole
    ]
    assert shorter
    for whole, cut in shorter:
        assert cut.distance < whole.distance
        assert cut.push.length == pytest.approx(cut.distance, abs=1e-9)
        np.testing.assert_array_equal(cut.push.start, whole.push.start)
        np.testing.assert_allclose(
            simulate(Model(bar, even), cut.push, POSE, regime="quasi_static").final_pose,
            cut.pose,
            atol=1e-4,
        )
    for cut in cuts:
        for params in robustness.models if cut is not None else ():
            motion = simulate(Model(bar, params), cut.push, POSE, regime="quasi_static")
            assert TABLE.contains_cells(bar, motion.poses, -OPTIONS.leeway - 1e-3).all()
            world = SimulatedWorld(Model(bar, params), POSE, TABLE)
            world.execute(cut.push)
            assert not world.truth.fallen


def test_the_center_of_friction_stays_over_the_table_by_every_model_to_the_end(bar, even):
    # cells may hang over, so that only the center of friction says how far a push goes
    rules = PushConstraints(TABLE, edge_margin=-0.2, finger_inset=-0.2)
    robustness = make_robustness(bar, even, rules=rules)
    pose = np.array([0.05, 0.2, 0.1])
    plan = optimize_contact(Model(bar, even), pose, (0.05, 0.4, 0.1), constraints=rules)
    safe = [robustness.cut(pose, push) for push in plan.candidates]
    lengths = [
        (one.planned.distance, whole.distance)
        for one, whole in zip(safe, plan.candidates, strict=True)
        if one is not None
    ]
    assert any(kept < whole - 0.01 for kept, whole in lengths)
    for one in safe:
        for params, end in zip(
            robustness.models, one.ends if one is not None else (), strict=False
        ):
            center = transform(end, (params.relative_friction() @ bar.p_BC)[None])
            assert TABLE.signed_distances(center)[0] >= OPTIONS.center_margin - 1e-6


def test_without_edges_nothing_is_cut(bar, even):
    robustness = make_robustness(bar, even, rules=PushConstraints())
    plan = optimize_contact(Model(bar, even), POSE, GOAL)
    assert robustness.cut(np.array(POSE), plan.push).planned is plan.push
    assert robustness.simulations == 0


def test_without_samples_a_push_that_keeps_the_rules_stays_whole(bar, even):
    plan = optimize_contact(Model(bar, even), POSE, GOAL, constraints=RULES)
    safe = make_robustness(bar, even, samples=[]).cut(np.array(POSE), plan.push)
    assert safe.planned is plan.push
    np.testing.assert_allclose(safe.ends, [plan.push.pose], atol=1e-6)


def test_a_share_of_the_draws_may_contradict(bar, even):
    plan = optimize_contact(Model(bar, even), POSE, GOAL, constraints=RULES)
    pose = np.array(POSE)

    def measure(samples):
        robustness = make_robustness(bar, even, samples)
        cuts = [robustness.cut(pose, push) for push in plan.candidates]
        return sum(0.0 if one is None else one.planned.distance for one in cuts)

    # the sample that shortens pushes most, among 100 draws
    sample = min(
        draw_model_samples(Model(bar, even), None, OPTIONS), key=lambda one: measure([one])
    )
    lengths = [measure([sample] * count + [even] * (100 - count)) for count in (0, 5, 6)]
    assert lengths[0] == lengths[1]
    assert lengths[2] == measure([sample]) < lengths[1] - 0.01


def test_draws_choose_the_push_that_leaves_least_on_their_average(bar, even):
    draws = [
        replace(even, mass=even.mass * np.exp(tilt * bar.p_BC[:, 0] / 0.1))
        for tilt in np.linspace(0.0, 1.5, 100)
    ]
    rules = GoalRules()
    gains = []
    for heading in np.linspace(-1.5, 1.5, 8):
        goal = np.array([0.08, 0.1, heading])
        checker = rules.constraints.start_at(bar, np.zeros(3), DEFAULT_PUSHER_RADIUS)
        cost_to_go = CostToGo(bar, np.zeros(3), goal, checker)
        costs = []
        for learned in (False, True):
            robustness = Robustness(
                bar, [even, *draws], rules.constraints, rules.contact, OPTIONS, learned=learned
            )
            chosen = choose_push(Model(bar, even), np.zeros(3), cost_to_go, rules, robustness)
            assert (robustness.simulations >= 101) == learned
            ends = [
                simulate(Model(bar, draw), chosen.push.push, regime="quasi_static").final_pose
                for draw in draws[::10]
            ]
            costs.append(float(np.mean([cost_to_go.calc_cost(end) for end in ends])))
        gains.append(costs[0] - costs[1])
    assert min(gains) > -0.001  # a tenth of the draws is not all of them
    assert max(gains) > 0.002


@pytest.mark.parametrize("change", [{"confidence": 0.0}, {"weighed": 0}, {"samples": -1}])
def test_options_out_of_range_are_refused(change):
    (name,) = change
    with pytest.raises(PlanningError, match=f"{name} is"):
        RobustnessOptions(**change)
