import numpy as np
import pytest

from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.identification.learning import identify
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.contact.optimization import ContactOptions, optimize_contact
from gridpush_drake.planning.goal.push_to_goal import SimulatedWorld
from gridpush_drake.planning.goal.robustness import Robustness, RobustnessOptions, draw_model_samples
from gridpush_drake.planning.push_constraints import PushConstraints
from gridpush_drake.planning.support_surface import SupportSurface
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


def make_caution(bar, even, doubts=None, rules=RULES):
    doubts = draw_model_samples(bar, even, None, OPTIONS) if doubts is None else doubts
    return Robustness(bar, [even, *doubts], rules, ContactOptions(), OPTIONS)


def test_doubts_lean_to_every_side(bar, even):
    doubts = draw_model_samples(bar, even, None, OPTIONS)
    assert len(doubts) == len(OPTIONS.tilts) * OPTIONS.sides
    centers = np.array([doubt.relative_friction() @ bar.p_BC for doubt in doubts])
    assert centers[:, 0].max() > 0.03
    assert centers[:, 0].min() < -0.03
    np.testing.assert_allclose(centers.mean(axis=0), 0.0, atol=1e-9)


def test_learning_narrows_the_doubts(bar):
    hidden = CellParameters(np.where(bar.p_BC[:, 0] > 0.05, 0.4, 0.05), np.full(bar.n, 0.4))
    world = SimulatedWorld(bar, hidden, POSE)
    seen = []
    for _ in range(3):
        plan = optimize_contact(bar, CellParameters.uniform(bar), world.pose, GOAL)
        seen.append(world.execute(plan.push.push))
    found = identify(bar, PushLog(tuple(seen)), regime="quasi_static")
    spread = [
        np.std(
            [
                doubt.relative_friction() @ bar.p_BC[:, 0]
                for doubt in draw_model_samples(bar, found.params, given, OPTIONS)
            ]
        )
        for given in (None, found)
    ]
    assert spread[1] < 0.3 * spread[0]


def test_a_push_goes_only_as_far_as_every_doubt_allows(bar, even):
    caution = make_caution(bar, even)
    plan = optimize_contact(bar, even, POSE, GOAL, constraints=RULES)
    cuts = [caution.cut(np.array(POSE), push) for push in plan.candidates]
    assert caution.simulations == len(cuts) * (1 + OPTIONS.sides * len(OPTIONS.tilts))
    shorter = [
        (whole, cut) for whole, cut in zip(plan.candidates, cuts, strict=True) if cut is not None and cut is not whole
    ]
    assert shorter
    for whole, cut in shorter:
        assert cut.distance < whole.distance
        assert cut.push.length == pytest.approx(cut.distance, abs=1e-9)
        np.testing.assert_array_equal(cut.push.start, whole.push.start)
        np.testing.assert_allclose(
            simulate(bar, even, cut.push, POSE, regime="quasi_static").final_pose, cut.pose, atol=1e-4
        )
    for cut in cuts:
        for params in caution.models if cut is not None else ():
            motion = simulate(bar, params, cut.push, POSE, regime="quasi_static")
            assert TABLE.contains_cells(bar, motion.poses, -OPTIONS.leeway - 1e-3).all()
            world = SimulatedWorld(bar, params, POSE, TABLE)
            world.execute(cut.push)
            assert not world.fallen


def test_without_edges_nothing_is_cut(bar, even):
    caution = make_caution(bar, even, rules=PushConstraints())
    plan = optimize_contact(bar, even, POSE, GOAL)
    assert caution.cut(np.array(POSE), plan.push) is plan.push
    assert caution.simulations == 0


def test_without_doubts_a_push_that_keeps_the_rules_stays_whole(bar, even):
    plan = optimize_contact(bar, even, POSE, GOAL, constraints=RULES)
    assert make_caution(bar, even, doubts=[]).cut(np.array(POSE), plan.push) is plan.push
