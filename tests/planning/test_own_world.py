"""A world of the user's own, as `docs/extending.md` writes one, in closed loops and in benches."""

import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import shapely

from gridpush_drake.bench import planning
from gridpush_drake.bench.pregrasp import experiments as pregrasp
from gridpush_drake.bench.pregrasp.world import EdgeWorld, MujocoEdgeWorld
from gridpush_drake.bench.truth.mujoco_world import MujocoWorld
from gridpush_drake.bench.worlds.by_name import WORLD_CLASSES, find_world
from gridpush_drake.dynamics.physics import Physics
from gridpush_drake.dynamics.push import Push
from gridpush_drake.errors import GridPushError, PlanningError
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.contact.trial import calc_goal_error
from gridpush_drake.planning.feedback import PushFollower, SteeredFinger, follow
from gridpush_drake.planning.feedback.follow_options import FollowStatus
from gridpush_drake.planning.goal.next_push import GoalRules
from gridpush_drake.planning.goal.push_to_goal import push_to_goal
from gridpush_drake.planning.push_constraints import PushConstraints
from gridpush_drake.planning.pushed_object import FeedbackFinger
from gridpush_drake.planning.scene import hide
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.planning.weighing.press import PressOptions, PressTarget
from gridpush_drake.planning.world import (
    PushWorld,
    SimulatedWorld,
    SteeredWorld,
    TrackedWorld,
    WorldMotion,
)

PAGE = Path(__file__).parents[2] / "docs" / "extending.md"
TABLE = SupportSurface.rectangle((0.0, 0.0), (1.0, 0.8))
RADIUS = 0.05
FINGER = 0.008

pytestmark = pytest.mark.skipif(
    not PAGE.is_file(), reason="a wheel's tests have no docs beside them"
)


def find_code(name):
    """The page's block of code that defines a class."""
    pattern = rf"```python\n((?:(?!```).)*class {name}\(?.*?)```"
    (code,) = re.findall(pattern, PAGE.read_text(), re.DOTALL)
    return code


def make_class(name):
    """The page's class of a name."""
    names = {}
    exec(find_code(name), names)
    return names[name]


@pytest.fixture
def DiscWorld(tmp_path, monkeypatch):
    """The page's world, in a module that benches can import."""
    (tmp_path / "disc_world.py").write_text(find_code("DiscWorld"))
    monkeypatch.syspath_prepend(str(tmp_path))
    return find_world("disc_world:DiscWorld")


@pytest.fixture(scope="module")
def puck():
    return GridObject.from_outline(shapely.Point(0.0, 0.0).buffer(RADIUS), max_cells=40)


def test_a_disc_is_driven_straight_away_from_the_finger(DiscWorld, puck):
    world = DiscWorld(Model(puck), (0.0, 0.0, 0.3), TABLE)
    assert isinstance(world, PushWorld)
    seen = world.execute(Push((-0.1, 0.0), (0.05, 0.0), 2.0, FINGER))
    # the finger ends at the middle of the table, and touches
    np.testing.assert_allclose(world.truth.pose, [world.radius + FINGER, 0.0, 0.3], atol=1e-12)
    np.testing.assert_array_equal(seen.final_pose, world.observe())

    # beside the center, the disc goes off to the side, and the finger still touches it
    world.put((0.0, 0.0, 0.3))
    world.execute(Push((-0.1, 0.02), (0.05, 0.0), 2.0, FINGER))
    x, y, theta = world.truth.pose
    assert y < -0.02
    assert np.hypot(x - 0.0, y - 0.02) == pytest.approx(world.radius + FINGER, abs=1e-9)
    assert theta == 0.3

    # off the table it falls, and is not seen any more
    world.put((0.45, 0.0, 0.0))
    world.execute(Push((0.3, 0.0), (0.1, 0.0), 2.0, FINGER))
    assert world.truth.fallen
    assert world.observe() is None


def test_a_closed_loop_reaches_its_goal_in_it(DiscWorld, puck):
    params = CellParameters.uniform(puck)
    noise = {"position_std": 0.0005, "angle_std": 0.001}
    world = DiscWorld(Model(puck, params), (0.0, 0.0, 0.0), TABLE, **noise, seed=1)
    goal = (0.15, 0.05, 0.0)
    rules = GoalRules(PushConstraints(TABLE), max_pushes=12)
    run = push_to_goal(world, Model(puck), goal, rules, learner=None)
    assert run.status == "reached"
    assert calc_goal_error(puck, world.truth.pose, np.array(goal)) < 0.025
    assert world.pushes == len(run.log) >= 1


@pytest.mark.slow
def test_benches_take_it_by_its_name(DiscWorld):
    name = "disc_world:DiscWorld"
    (run,) = planning.run_job(
        planning.PlanningJob(
            kind="push", data=None, name="pliers", number=0, pairs=1, modes=(planning.UNIFORM_MODEL,),
            seed=0, world=name,
        )
    )  # fmt: skip
    assert run.pushes >= 1
    score = pregrasp.run_job(
        pregrasp.PreGraspJob(
            name="toolbox", mass_set=0, seed=0, method=pregrasp.UNIFORM_METHOD, truth=name
        )
    )
    assert score.method == name
    assert score.outcome.slides >= 1


def test_an_unknown_world_is_refused(DiscWorld):
    for name in ("marbles", "disc_world:Marbles", "no_such_module:World", ":", "a:"):
        with pytest.raises(GridPushError, match="expected one of lcp, edge, mujoco, drake, or MOD"):
            planning.STUDY.run(objects=("pliers",), quick=True, world=name)
    with pytest.raises(GridPushError, match="world: 'disc_world:Marbles'"):
        pregrasp.STUDY.run(objects=("toolbox",), truths=("disc_world:Marbles",))


def test_the_named_worlds_are_of_one_form():
    classes = [find_world(name) for name in WORLD_CLASSES]
    assert classes[:3] == [SimulatedWorld, EdgeWorld, MujocoEdgeWorld]
    assert all(issubclass(each, TrackedWorld) for each in (*classes, MujocoWorld))
    for method in ("put", "execute", "observe"):
        # none of them has a way of its own to do what the form says
        assert all(getattr(each, method) is getattr(TrackedWorld, method) for each in classes)


@pytest.mark.parametrize("name", ["lcp", "edge", "mujoco", "drake"])
def test_every_named_world_moves_an_object_alike(name):
    """The same push of a slab in all of them: what a bench or a loop relies on holds in each."""
    if name == "mujoco":
        pytest.importorskip("mujoco", reason="MuJoCo is in the extra `bench`")
    slab = GridObject.from_outline(
        [[-0.06, -0.04], [0.06, -0.04], [0.06, 0.04], [-0.06, 0.04]], max_cells=24
    )
    params = CellParameters(np.full(slab.n, 0.02), np.full(slab.n, 0.35), 0.4)
    world = find_world(name)(Model(slab, params), (0.05, 0.0, 0.0), TABLE, seed=3)
    assert isinstance(world, PushWorld)
    np.testing.assert_array_equal(world.observe(), [0.05, 0.0, 0.0])
    assert world.truth.motion is None
    push = Push((-0.02, 0.01), (0.03, 0.0), 2.0, FINGER)
    seen = world.execute(push)
    motion = world.truth.motion
    np.testing.assert_allclose(seen.pose, motion.poses[0], rtol=0, atol=1e-12)
    np.testing.assert_array_equal(world.truth.pose, motion.poses[-1])
    assert motion.times[0] == 0.0
    assert motion.times[-1] == pytest.approx(push.duration)
    assert world.truth.stays
    assert not world.truth.fallen
    expected = SimulatedWorld(Model(slab, params), (0.05, 0.0, 0.0))
    expected.execute(push)
    np.testing.assert_allclose(motion.poses[-1, :2], expected.truth.pose[:2], atol=2e-3)
    assert abs(motion.poses[-1, 2] - expected.truth.pose[2]) < np.radians(2)
    assert expected.truth.pose[0] > 0.07

    # the same again, from where it is put back
    world.put((0.05, 0.0, 0.0))
    assert world.truth.motion is None
    world.execute(push)
    np.testing.assert_allclose(world.truth.pose, motion.poses[-1], atol=1e-6)


def test_the_finger_s_force_is_seen_with_the_push(DiscWorld, puck):
    class FeltDisc(DiscWorld):
        def do_push(self, push, pose):
            t = np.linspace(0.0, push.duration, 5)
            return replace(super().do_push(push, pose), force_t=t, force=np.outer(t, [1.0, 2.0]))

    world = FeltDisc(Model(puck), (0.0, 0.0, 0.3), TABLE)
    seen = world.execute(Push((-0.1, 0.0), (0.05, 0.0), 2.0, FINGER))
    np.testing.assert_array_equal(seen.force_t, np.linspace(0.0, 2.0, 5))
    np.testing.assert_array_equal(seen.force[-1], [2.0, 4.0])
    for wrong in ({"force_t": np.zeros(2)}, {"force_t": np.zeros(2), "force": np.zeros((3, 2))}):
        with pytest.raises(PlanningError, match="motion: force"):
            WorldMotion(times=np.zeros(2), poses=np.zeros((2, 3)), **wrong)


def test_a_finger_is_steered_in_a_world_of_one_s_own(DiscWorld, puck):
    finger = FeedbackFinger(radius=FINGER, speed=0.1, walking_speed=0.2)
    world = make_class("SteeredDisc")(Model(puck), (0.0, 0.0, 0.0))
    steered = SteeredFinger(world, (-0.1, 0.01), FINGER, seed=1)
    follower = PushFollower(puck, CellParameters.uniform(puck), np.array([0.15, 0.0, 0.0]), finger)
    run = follow(follower, steered, 20.0)
    assert isinstance(world, SteeredWorld)
    assert run.status == FollowStatus.REACHED
    assert np.hypot(*(steered.pose[:2] - (0.15, 0.0))) < 0.01
    with pytest.raises(PlanningError, match="radius"):
        SteeredFinger(world, (0.0, 0.0), 0.0)


@pytest.mark.parametrize("physics", [Physics(), Physics(friction_law="isotropic")])
def test_an_object_that_a_finger_is_steered_into_moves_as_in_one_push(puck, physics):
    model = Model(puck, physics=physics)
    world, steered = (SimulatedWorld(model, (0.0, 0.0, 0.2)) for _ in range(2))
    path = np.linspace((-0.1, 0.02), (0.02, 0.01), 13)
    for begin, end in pairwise(path):
        steered.steer(begin, end, 0.1, FINGER)
    world.execute(Push(path[0], (path[-1] - path[0]) / 1.2, 1.2, FINGER))
    assert np.hypot(*steered.truth.pose[:2]) > 0.02
    off = [1e-4, 1e-4, 1e-3]  # their steps differ
    assert (np.abs(steered.truth.pose - world.truth.pose) < off).all()
    # It is at rest again when it was put elsewhere.
    steered.put((0.0, 0.0, 0.2))
    for begin, end in pairwise(path):
        steered.steer(begin, end, 0.1, FINGER)
    assert (np.abs(steered.truth.pose - world.truth.pose) < off).all()
    with pytest.raises(PlanningError, match="is for one object; a steered finger"):
        SimulatedWorld(Model([puck, puck]), [(0, 0, 0), (1, 0, 0)]).steer(*path[:2], 0.1, FINGER)


def test_a_press_is_made_in_a_world_of_one_s_own():
    target = PressTarget((0.03, 0.0), (0.0, 0.0), 0.0, 0.03, 0.008)
    options = PressOptions()
    state = make_class("SpringPress")(weight=6.0, inside=0.05).press(target, options)
    weighing = state.make_weighing(target, options, np.zeros(3))
    inside = 0.05 - weighing.center_shift
    assert weighing.force == pytest.approx(6.0 * inside / weighing.arm, rel=0.01)


def test_several_objects_are_pushed_in_a_world_of_one_s_own(puck):
    start = np.array([[0.0, 0.0, 0.3], [0.3, 0.0, 0.0]])
    hidden = hide([puck, puck], np.random.default_rng(0))
    world = make_class("DiscScene")(hidden, start, position_std=0.001, angle_std=0.01, seed=1)
    assert isinstance(world, PushWorld)
    before = world.observe()
    seen = world.execute(Push((-0.1, 0.0), (0.05, 0.0), 2.0, FINGER))
    moved = world.truth.pose - start
    assert moved[0, 0] > 0.05 and not moved[1].any()
    off = seen.poses_observed[-1] - world.truth.pose
    assert off.any() and np.abs(off[:, :2]).max() < 0.005 and np.abs(off[:, 2]).max() < 0.05
    np.testing.assert_array_equal(seen.pose, before)
    np.testing.assert_array_equal(world.observe(), seen.poses_observed[-1])
    assert world.pushes == 1 and world.time > 2.0
