"""Paths of stable pushes: they end where they should, as long as nothing slips."""

from dataclasses import replace

import numpy as np
import pytest
from shapely import box

from gridpush_drake.dynamics.pusher import Pusher, PusherShape
from gridpush_drake.errors import PlanningError
from gridpush_drake.geometry.se2 import transform_shape
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.push_constraints import PushConstraints
from gridpush_drake.planning.stable.stable_path import STABLE_MARGIN, plan_stable_path
from gridpush_drake.planning.stable.stable_push import calc_push_stability
from tests.helpers.shapes import rectangle

TIPS = Pusher(shape=PusherShape.discs([(0, -0.03), (0, 0.03)], 0.005), clearance=0.0005)
PLATE = Pusher(shape=PusherShape.plate(0.05, 0.02, 0.003))

END_ERROR = 2e-4
"""m of the cells by which the simulated end may be off: the gap closes in whole steps."""


class OpenModel(Model):
    """A model of which the friction with the pusher is not known."""

    def draws(self, count, seed=0):
        rng = np.random.default_rng(seed)
        friction = self.params.contact_friction * np.exp(0.3 * rng.standard_normal(count))
        return [replace(self.params, contact_friction=float(mu)) for mu in friction]


def make_block(seed, kind=Model):
    rng = np.random.default_rng(seed)
    obj = GridObject.from_outline(rectangle(0.12, 0.1), max_cells=40)
    mass = rng.dirichlet(np.full(obj.n, 1.0))
    return kind(obj, CellParameters(mass, np.full(obj.n, 0.3), 0.5))


def draw_goal(seed):
    rng = np.random.default_rng(seed)
    direction = rng.uniform(-np.pi, np.pi)
    return np.array([0.3 * np.cos(direction), 0.3 * np.sin(direction), rng.uniform(-np.pi, np.pi)])


@pytest.mark.parametrize("pusher", [TIPS, PLATE])
@pytest.mark.parametrize("seed", range(4))
def test_a_path_ends_at_its_goal_in_the_simulation(pusher, seed):
    model = make_block(seed)
    start = np.array([0.02, -0.01, 0.3])
    goal = draw_goal(seed)
    path = plan_stable_path(model, pusher, start, goal)
    assert 1 <= len(path.pushes) <= 3
    assert path.probability == 1
    assert path.margins.min() > STABLE_MARGIN
    assert path.errors.max() < END_ERROR
    # the pushes are those that were simulated, and each is stable from where the last one ends
    pose = start
    for each in path.pushes:
        # the pusher's own analysis, once the gap is closed
        closed = each.push.cut(np.linspace(each.push.t[1], each.push.duration, 200))
        stability = calc_push_stability(model, closed, pose, count=1)
        assert stability.margins[0] >= path.margins.min() - 0.01
        pose = model.simulate(each.push, pose).final_pose
    np.testing.assert_allclose(pose, path.ends[0])


def test_the_less_is_known_the_wider_are_the_turns():
    goal = draw_goal(5)
    known = plan_stable_path(make_block(1), TIPS, np.zeros(3), goal)
    vague = plan_stable_path(make_block(1, OpenModel), TIPS, np.zeros(3), goal)
    tightest = [
        max(np.abs(each.curvatures).max() for each in path.pushes) for path in (known, vague)
    ]
    assert tightest[1] < tightest[0]
    assert 0.95 <= vague.probability <= 1
    # a tenth of the draws may slip, and then does not end at the goal
    daring = plan_stable_path(make_block(1, OpenModel), TIPS, np.zeros(3), goal, probability=0.5)
    assert 0.5 <= daring.probability < 0.9
    assert daring.errors.max() > 5 * END_ERROR
    assert np.median(daring.errors) < END_ERROR


def test_a_place_is_reached_at_any_angle_and_what_is_in_the_way_is_avoided():
    model = make_block(2)
    goal = (0.3, 0.05)
    free = plan_stable_path(model, TIPS, np.zeros(3), goal)
    np.testing.assert_allclose(free.goal[:2], goal)
    assert free.errors.max() < END_ERROR
    # a post that the object would run into
    middle = free.pushes[0].poses[len(free.pushes[0].poses) // 2]
    post = transform_shape(middle, box(-0.01, -0.01, 0.01, 0.01))
    path = plan_stable_path(
        model, TIPS, np.zeros(3), goal, constraints=PushConstraints(obstacles=(post,))
    )
    assert path.errors.max() < END_ERROR
    for each in path.pushes:
        for pose in each.poses:
            assert not transform_shape(pose, model.obj.outline).intersects(post)


def test_what_cannot_be_done_is_said():
    model = make_block(0)
    with pytest.raises(PlanningError, match="expected a shape of two contacts"):
        plan_stable_path(model, Pusher(), np.zeros(3), draw_goal(0))
    with pytest.raises(PlanningError, match="probability"):
        plan_stable_path(model, TIPS, np.zeros(3), draw_goal(0), probability=1.5)
    wide = Pusher(shape=PusherShape.discs([(0, -0.2), (0, 0.2)], 0.005))
    assert plan_stable_path(model, wide, np.zeros(3), draw_goal(0)) is None
