"""Posts on the table of several objects: nothing is pushed against one, nor sent to lie in one."""

from dataclasses import replace

import numpy as np
import pytest
import shapely

from gridpush_drake.dynamics.pusher import DEFAULT_PUSHER_RADIUS
from gridpush_drake.errors import PlanningError
from gridpush_drake.geometry.se2 import transform_shape
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.belief import Belief
from gridpush_drake.planning.scene.loop import SceneAction
from gridpush_drake.planning.scene.rearrangement import RearrangeOptions, RearrangePlanner
from gridpush_drake.planning.scene.rules import POST_LEEWAY, POST_MARGIN, SceneRules, place_outlines
from gridpush_drake.planning.scene.search import SceneSearch, SceneSearchOptions
from gridpush_drake.planning.scene.separation import SeparatePlanner, SeparationOptions
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.planning.world import SimulatedWorld
from tests.helpers.random_pushes import make_random_contents
from tests.helpers.scene_cases import Layout, make_row, run_task
from tests.helpers.shapes import make_shape

TABLE = SupportSurface.rectangle((0.0, 0.0), (1.2, 1.2))
QUICK = SceneSearchOptions(candidates=24, variations=4, firsts=3, seconds=8, compared=3)
RADIUS = 0.02


def make_post(x, y):
    return shapely.Point(x, y).buffer(RADIUS)


def make_rules(*posts):
    region = shapely.box(-0.6, -0.6, 0.6, 0.6) - shapely.union_all(posts).buffer(
        DEFAULT_PUSHER_RADIUS
    )
    return SceneRules(TABLE, finger_region=region, posts=posts)


def calc_distances(truth, poses, post):
    """Distances of all objects from a post in states (K, N, 3), m."""
    outlines = [place_outlines(truth.objects, each) for each in poses]
    return shapely.distance(np.array(outlines), post)


@pytest.fixture(scope="module")
def bar():
    obj = make_shape("bar", 20)
    return Layout.of([(obj, CellParameters.uniform(obj), (0.0, 0.0, 0.0))])


def test_a_push_stops_before_an_object_comes_to_a_post(bar):
    """To the right of a bar that should go there stands a post; without it the bar goes on."""
    (obj,) = bar.objects
    right = obj.outline.bounds[2]
    post = make_post(right + 0.05 + RADIUS, 0.0)
    belief = Belief(bar.bodies)

    def find(rules):
        search = SceneSearch(belief, rules, QUICK)
        rng = np.random.default_rng(1)
        return search.find_push(bar.poses, lambda poses: -100.0 * poses[:, 0, 0], [0], rng)

    free, kept = find(SceneRules(TABLE)), find(make_rules(post))
    gap = calc_distances(bar, [free.poses, kept.poses], post)[:, 0]
    assert gap[0] == 0.0  # there it would stand in the way
    assert gap[1] > POST_MARGIN - 1e-5
    assert kept.poses[0, 0] > 0.02  # and yet it was pushed there
    # the tip does not touch it either
    assert post.distance(shapely.LineString(kept.push.xy)) > DEFAULT_PUSHER_RADIUS - 1e-5


def test_what_lies_at_a_post_is_pushed_away_from_it(bar):
    post = make_post(bar.objects[0].outline.bounds[2] + 0.004 + RADIUS, 0.0)
    search = SceneSearch(Belief(bar.bodies), make_rules(post), QUICK)
    rng = np.random.default_rng(1)
    found = search.find_push(bar.poses, lambda poses: 100.0 * poses[:, 0, 0], [0], rng)
    before, after = calc_distances(bar, [bar.poses, found.poses], post)[:, 0]
    assert after > before + 0.02


def make_truth(seed):
    truth, _ = make_row(seed, ["square", "bar", "triangle"], cells=20)
    rng = np.random.default_rng(seed)
    bodies = [
        (obj, make_random_contents(rng, obj), pose)
        for obj, pose in zip(truth.objects, truth.poses, strict=True)
    ]
    return Layout.of(bodies, 0.25)


@pytest.mark.parametrize("seed", range(2))
def test_objects_are_separated_beside_a_post(seed):
    truth = make_truth(seed)
    heap = shapely.union_all(place_outlines(truth.objects, truth.poses))
    middle = heap.centroid
    post = make_post(middle.x, heap.bounds[3] + 0.025 + RADIUS)
    rules = make_rules(post)
    world = SimulatedWorld(*truth, TABLE, position_std=0.0005, angle_std=0.003, seed=seed)
    planner = SeparatePlanner(truth.objects, SeparationOptions(search=QUICK), rules, seed=seed)
    belief = Belief.of_even_objects(truth.objects, sample_count=2, seed=seed)
    run = run_task(world, planner, belief, seed=seed)
    assert run.state.done and run.state.last.action is SceneAction.DONE
    # whatever their masses are, no object was pushed against it
    seen = [step.poses for step in run.state.steps] + [each.poses_observed[-1] for each in run.log]
    assert calc_distances(truth, seen, post).min() > POST_MARGIN - POST_LEEWAY - 0.002


def test_a_goal_at_a_post_is_refused_by_both_names():
    truth = make_truth(0)
    goals = truth.poses + [[0.0, 0.3, 0.0]]
    post = make_post(*goals[1, :2])
    with pytest.raises(
        PlanningError, match=r"goals: that of .* is nearer to posts\[0\] than 10 mm"
    ):
        RearrangePlanner(truth.objects, goals, rules=make_rules(post))


def test_a_place_aside_is_beside_posts():
    """Two objects in each other's goals: the one that goes aside does not go to where a post is."""
    objects = [make_shape("square", 20), make_shape("square", 20)]
    poses = np.array([[0.0, 0.0, 0.0], [0.15, 0.0, 0.0]])
    options = RearrangeOptions(search=QUICK)
    free = RearrangePlanner(objects, poses[::-1], options, SceneRules(TABLE))
    aside = free.choose_targets(poses, [])
    body = int(np.flatnonzero(aside.is_buffered)[0])
    post = make_post(*aside.poses[body, :2])
    rules = replace(make_rules(post), finger_region=None)
    kept = RearrangePlanner(objects, poses[::-1], options, rules).choose_targets(poses, [])
    outline = transform_shape(kept.poses[body], objects[body].outline)
    assert kept.is_buffered[body] and outline.distance(post) > POST_MARGIN
