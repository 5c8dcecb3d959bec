"""The wanted object is brought out of the clutter to the table's edge, and nothing falls."""

import numpy as np
import pytest
from shapely import Point

from gridpush_drake.dynamics.push import Push
from gridpush_drake.errors import PlanningError
from gridpush_drake.geometry.se2 import transform_shape
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import find_shipped_object
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.belief import Belief
from gridpush_drake.planning.edge_motion import simulate_near_edge
from gridpush_drake.planning.pregrasp.decision import PreGraspOptions
from gridpush_drake.planning.pregrasp.goals import ArmLimits, calc_overhangs
from gridpush_drake.planning.scene.fetching import (
    CLEARING_KIND,
    FetchLearning,
    FetchOptions,
    FetchPlanner,
)
from gridpush_drake.planning.scene.loop import SceneAction, SceneLearning, SceneStep
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.planning.world import SimulatedWorld
from gridpush_drake.pushes.observed_push import ObservedPush
from tests.helpers.random_pushes import make_random_contents
from tests.helpers.scene_cases import Layout, run_task
from tests.helpers.shapes import make_shape

TABLE = SupportSurface.rectangle((0.0, 0.0), (1.0, 1.0))


def make_truth():
    """A wrench with a square beside it and a bar behind that, 2 mm apart."""
    wrench = GridObject.from_yaml(find_shipped_object("combination_wrench"))
    rng = np.random.default_rng(4)
    hidden = CellParameters.random(wrench, 4, (0.1, 5.0), (0.3, 0.4))
    square, bar = make_shape("square", 20), make_shape("bar", 20)
    top = wrench.outline.bounds[3] - square.outline.bounds[1] + 0.002
    return Layout.of(
        [
            (wrench, hidden, (0.0, 0.0, 0.0)),
            (square, make_random_contents(rng, square), (0.0, top, 0.0)),
            (bar, make_random_contents(rng, bar), (0.25, 0.2, 1.0)),
        ],
        0.3,
    )


def make_planner_of_no_arm(truth):
    """A planner whose finger comes nowhere near the objects."""
    limits = ArmLimits(finger_region=Point(5.0, 5.0).buffer(0.1))
    return FetchPlanner(truth.objects, 0, TABLE, limits=limits)


def test_first_what_is_in_the_way_is_cleared_away():
    truth = make_truth()
    planner = FetchPlanner(truth.objects, 0, TABLE, seed=1)
    belief = Belief.of_even_objects(truth.objects, sample_count=2)
    decision = planner.decide(truth.poses, belief, [])
    assert decision.kind == CLEARING_KIND and decision.push is not None
    assert "square" in decision.reason and "out of the way of combination_wrench" in decision.reason
    # by the truth, too, there is more room afterwards
    world = SimulatedWorld(*truth, TABLE)
    world.execute(decision.push)
    before, after = (
        transform_shape(poses[0], truth.objects[0].outline).distance(
            transform_shape(poses[1], truth.objects[1].outline)
        )
        for poses in (truth.poses, world.truth.pose)
    )
    assert after > before + 0.01
    # at last it is given up
    steps = [SceneStep(truth.poses, decision)] * FetchOptions().max_clearing
    given_up = make_planner_of_no_arm(truth).decide(truth.poses, belief, steps)
    assert given_up.action is SceneAction.FAIL and "still in the way" in given_up.reason


def test_the_wanted_object_is_learned_only_from_pushes_in_which_nothing_else_moved():
    truth = make_truth()
    world = SimulatedWorld(*truth, TABLE, position_std=0.0005, angle_std=0.003, seed=1)
    belief = Belief.of_even_objects(truth.objects, sample_count=2)
    learning = FetchLearning(0, TABLE, friction_range=(0.3, 0.4))
    low = truth.objects[0].outline.bounds[1]
    x = truth.objects[0].outline.bounds[0] + 0.03
    beside = world.execute(Push((0.25, 0.35), (0.0, -0.05), 1.5, 0.008))
    assert learning.learn(belief, [beside], 0) is None
    alone = world.execute(Push((x, low - 0.02), (0.0, 0.05), 0.6, 0.008))
    learned = learning.learn(belief, [beside, alone], 0)
    assert set(learned.alone) == {0}
    assert len(learned.alone[0].poke_starts) == 1
    # what is shown of it is what it was learned to be, and of the others what was held before
    wanted, *others = learned.identifications
    assert wanted is learned.alone[0].identification and wanted.push_names == (alone.name,)
    assert not any(found.push_names for found in others)


def test_all_objects_together_are_learned_from_pushes_on_the_table_alone():
    """The model of a scene knows no edge, over which the wanted object hangs at last."""
    truth = make_truth()
    belief = Belief.of_even_objects(truth.objects, sample_count=2)
    shown = []

    class Noting:
        def learn(self, belief, pushes, seed, *, last=False, anew=False):
            shown.append(([seen.name for seen in pushes], last))

    push = Push((0.25, 0.35), (0.0, -0.05), 1.5, 0.008)
    poses = np.stack([truth.poses, truth.poses + [[0.5, 0.0, 0.0], [0.0] * 3, [0.0] * 3]])
    on_table, over_edge = (
        ObservedPush(name, push, start, np.array([1.5]), start[None])
        for name, start in zip(("on", "over"), poses, strict=True)
    )
    learning = FetchLearning(0, TABLE, scene=Noting())
    assert learning.learn(belief, [on_table, over_edge], 0, last=True) is None
    assert shown == [(["on"], True)]


@pytest.mark.slow
def test_the_wanted_object_is_fetched_and_nothing_falls():
    truth = make_truth()
    world = SimulatedWorld(*truth, TABLE, position_std=0.0005, angle_std=0.003, seed=1)
    options = FetchOptions(pregrasp=PreGraspOptions(max_arm=0.1))
    planner = FetchPlanner(truth.objects, 0, TABLE, options, seed=1)
    belief = Belief.of_even_objects(truth.objects, sample_count=2)
    learning = FetchLearning(0, TABLE, friction_range=(0.3, 0.4), scene=SceneLearning())
    run = run_task(world, planner, belief, learning=learning, max_pushes=50, seed=1)
    assert run.state.done and run.state.last.action is SceneAction.GRASP, run.state.status.reason
    kinds = [step.decision.kind for step in run.state.steps]
    assert kinds[0] == CLEARING_KIND and "slide" in kinds
    # judged by the truth
    assert not np.any(world.truth.fallen)
    part = run.state.last.goal.part
    assert calc_overhangs([part], world.truth.pose[0], TABLE)[0] > 0.0
    for obj, pose in zip(truth.objects[1:], world.truth.pose[1:], strict=True):
        assert TABLE.contains_cells(obj, pose)
    # of the wanted one only pushes are learned from in which nothing else moved
    assert 0 in run.state.belief.alone


def test_an_object_alone_at_the_edge_moves_as_its_loads_say():
    truth = make_truth()
    poses = truth.poses.copy()
    poses[0] = (0.38, -0.2, 0.0)
    truth = truth.with_poses(poses)
    obj = truth.objects[0]
    right = obj.outline.bounds[0] + poses[0, 0]
    push = Push((right - 0.01, -0.2), (0.05, 0.0), 1.5, 0.008)
    world = SimulatedWorld(*truth, TABLE)
    world.execute(push)
    motion = simulate_near_edge(Model(obj, truth.params[0]), push, poses[0], TABLE)
    np.testing.assert_array_equal(world.truth.pose[0], motion.final_pose)
    assert world.truth.fallen[0] == motion.fell


def test_what_is_refused():
    truth = make_truth()
    with pytest.raises(PlanningError, match="wanted is 3; expected the number of one of 3"):
        FetchPlanner(truth.objects, 3, TABLE)
    with pytest.raises(PlanningError, match="room"):
        FetchOptions(room=0.0)
    planner = make_planner_of_no_arm(truth)
    belief = Belief.of_even_objects(truth.objects)
    decision = planner.decide(truth.poses, belief, [])
    assert decision.action is SceneAction.FAIL and "square" in decision.reason
    assert "between" in decision.reason
