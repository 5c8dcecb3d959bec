"""The loop that a robot's controller steps: it looks, decides, waits, learns, and gives up in time."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from gridpush_drake.dynamics.bodies import describe_object
from gridpush_drake.dynamics.physics import Physics
from gridpush_drake.dynamics.push import Push
from gridpush_drake.identification.fit.hypotheses import SmoothField
from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.multi_object.joint_fit import JointEnsemble
from gridpush_drake.planning.belief import Belief
from gridpush_drake.planning.closed_loop import Observation
from gridpush_drake.planning.pregrasp.grasp.side_grasp import SideGrasp
from gridpush_drake.planning.robot_status import (
    GraspOutcome,
    GraspPhase,
    GraspStatus,
    PushPhase,
    PushStatus,
)
from gridpush_drake.planning.scene.joint_loop import STILL_WORLD, JointLoop, SceneMode
from gridpush_drake.planning.scene.loop import SceneAction, SceneDecision, SceneLearning
from gridpush_drake.pushes.push_log import PushLog
from tests.helpers.shapes import make_shape
from tests.helpers.two_blocks import NOISE, make_truth, push_scene

POSES = np.array([[0.0, 0.0, 0.0], [0.3, 0.0, 3.1]])
PUSH = Push((-0.2, 0.0), (0.05, 0.0), 1.0, 0.008)


@dataclass
class Scripted:
    """Gives decisions in their order, and keeps what it was shown."""

    decisions: list
    shown: list = field(default_factory=list)

    def decide(self, poses, belief, steps):
        self.shown.append((poses, belief, list(steps)))
        return self.decisions.pop(0)


@dataclass
class Counting:
    """Learns nothing, and notes of how many pushes it was asked, and whether none followed."""

    asked: list = field(default_factory=list)

    def learn(self, belief, pushes, seed, *, last=False, anew=False):
        self.asked.append((len(pushes), last))
        return Belief(belief.bodies)


def make_loop(decisions, **options):
    objects = [make_shape("square", 20), make_shape("bar", 20)]
    planner = Scripted(decisions)
    belief = Belief.of_even_objects(objects, sample_count=0)
    return JointLoop(planner, belief, **options), planner


def look(time, poses, robot, gripper=None):
    return Observation(time, np.array(poses), robot, PushLog(()), gripper=gripper or GraspStatus())


def watch(loop, now, poses, robot, begin, times=6, gripper=None):
    for i in range(times):
        now = loop.step(now, look(begin + 0.05 * i, poses, robot, gripper))
    return now


def decide(action, push=None):
    return SceneDecision(action, "so it is", push=push, body=1)


def test_a_push_is_made_seen_and_learned_from():
    learner = Counting()
    loop, _ = make_loop(
        [decide(SceneAction.PUSH, PUSH), decide(SceneAction.DONE)], learning=learner
    )
    now = watch(loop, loop.begin(), POSES, PushStatus(), 0.0)
    assert (now.status.mode, now.push_id, now.push) == (SceneMode.PUSHING, 1, PUSH)
    assert now.status.reason == "So it is."
    # while it is under way nothing is decided
    busy = PushStatus(PushPhase.PUSHING, command_id=1)
    working = watch(loop, now, POSES, busy, 0.3)
    assert (working.status, working.push_id, len(working.filter)) == (now.status, 1, 0)
    now = working
    after = POSES + [[0.05, 0.0, 0.1], [0.0, 0.0, 0.05]]
    wrapped = after - [[0.0, 0.0, 0.0], [0.0, 0.0, 2 * np.pi]]
    now = watch(loop, now, wrapped, PushStatus(command_id=1, executed=1), 1.0)
    assert now.status.mode is SceneMode.DONE and now.status.pushes == 1
    # it is asked after the push, and once more as the task is done
    assert learner.asked == [(1, False), (1, True)] and now.belief is not loop.belief
    np.testing.assert_allclose(now.log[0].pose, POSES)
    np.testing.assert_allclose(now.log[0].poses_observed[0], after)
    # what is over stays so
    assert watch(loop, now, POSES, PushStatus(), 2.0) is now


def test_objects_that_move_are_waited_for():
    loop, planner = make_loop([decide(SceneAction.DONE)])
    now = loop.begin()
    for i in range(10):
        moving = POSES + [[0.01 * i, 0.0, 0.0], [0.0, 0.0, 0.0]]
        now = loop.step(now, look(0.05 * i, moving, PushStatus()))
    assert not planner.shown
    now = watch(loop, now, moving, PushStatus(), 1.0)
    np.testing.assert_allclose(planner.shown[0][0], moving)
    assert now.status.over


def test_a_refused_push_is_told_to_the_planner_and_many_end_the_task():
    loop, planner = make_loop([decide(SceneAction.PUSH, PUSH)] * 20)
    now = loop.begin()
    for number in range(1, 20):
        now = watch(loop, now, POSES, PushStatus(command_id=number - 1, reason="too far"), number)
        if now.status.over:
            break
    assert now.status.mode is SceneMode.FAILED and "too far" in now.status.reason
    assert len(now.steps) == loop.options.max_refusals and now.log == ()
    assert planner.shown[-1][2][0].refused == "too far"


def test_what_the_arm_hides_while_it_is_at_work_is_not_lost():
    """Neither in a long push, nor while the arm moves out of the way afterwards."""
    loop, _ = make_loop([decide(SceneAction.PUSH, PUSH), decide(SceneAction.DONE)])
    hidden = POSES.copy()
    hidden[1] = np.nan
    now = watch(loop, loop.begin(), POSES, PushStatus(), 0.0)
    now = watch(loop, now, hidden, PushStatus(PushPhase.PUSHING, command_id=1), 1.0, times=180)
    done = PushStatus(command_id=1, executed=1)
    now = watch(loop, now, hidden, done, 10.0, times=6)
    away = PushStatus(PushPhase.CLEARING, command_id=1, executed=1)
    now = watch(loop, now, hidden, away, 10.3, times=180)
    now = watch(loop, now, hidden, done, 19.3, times=6)
    assert now.status.mode is SceneMode.WAITING
    now = watch(loop, now, POSES, done, 19.6)
    assert now.status.mode is SceneMode.DONE


def test_an_object_out_of_sight_is_lost_after_a_while():
    loop, _ = make_loop([])
    hidden = POSES.copy()
    hidden[1] = np.nan
    now = watch(loop, loop.begin(), POSES, PushStatus(), 0.0, times=2)
    now = watch(loop, now, hidden, PushStatus(), 0.2, times=2)
    assert not now.status.over
    now = watch(loop, now, hidden, PushStatus(), 9.0, times=1)
    assert now.status.mode is SceneMode.LOST
    name = describe_object(now.belief.objects, 1)
    assert now.status.reason == f"Not seen for {loop.options.timeout:g} s: {name}."


def test_it_is_given_up_after_as_many_pushes_as_asked():
    loop, _ = make_loop([decide(SceneAction.PUSH, PUSH)] * 3, max_pushes=1)
    now = watch(loop, loop.begin(), POSES, PushStatus(), 0.0)
    now = watch(loop, now, POSES, PushStatus(command_id=1, executed=1), 1.0)
    assert now.status.mode is SceneMode.FAILED and "after 1 pushes" in now.status.reason


@pytest.mark.parametrize(
    ("outcome", "mode"),
    [(GraspOutcome.HELD, SceneMode.HOLDING), (GraspOutcome.REFUSED, SceneMode.FAILED)],
)
def test_a_grasp_is_asked_for_and_followed(outcome, mode):
    found = SideGrasp.__new__(SideGrasp)
    loop, _ = make_loop([decide(SceneAction.GRASP)], find_grasp=lambda *seen: found)
    now = watch(loop, loop.begin(), POSES, PushStatus(), 0.0)
    assert now.status.mode is SceneMode.GRASPING and now.grasp is found and now.grasp_id == 1
    closing = GraspStatus(GraspPhase.CLOSING, command_id=1)
    assert watch(loop, now, POSES, PushStatus(), 1.0, gripper=closing) is now
    ended = GraspStatus(GraspPhase.HOLDING, command_id=1, outcome=outcome)
    now = watch(loop, now, POSES, PushStatus(), 2.0, gripper=ended)
    assert now.status.mode is mode and now.status.over


def test_where_no_grasp_is_in_reach_it_says_so():
    loop, _ = make_loop([decide(SceneAction.GRASP)], find_grasp=lambda *seen: None)
    now = watch(loop, loop.begin(), POSES, PushStatus(), 0.0)
    assert now.status.mode is SceneMode.FAILED and "grasp" in now.status.reason
    without, _ = make_loop([decide(SceneAction.GRASP)])
    now = watch(without, without.begin(), POSES, PushStatus(), 0.0)
    assert now.status.mode is SceneMode.DONE


def test_an_object_that_surprises_clearly_is_learned_anew_at_once():
    """And what was learned of it alone is dropped, but not what was of the others."""
    truth = make_truth()
    log = PushLog([push_scene(truth, seed) for seed in range(3)], names=("one", "other"))
    found = identify(Model(truth.objects), log, JointEnsemble(NOISE, (SmoothField(0.7),)))
    alone = {b: Belief.of_prior(truth.objects[b]) for b in range(2)}
    belief = replace(Belief.of_identification(found, sample_count=0), alone=alone)
    asked = []

    class Noting:
        def learn(self, belief, pushes, seed, *, last=False, anew=False):
            asked.append((sorted(belief.alone), [seen.name for seen in pushes], anew))

    seen = push_scene(truth, 7)
    for off, changed in ((0.0, False), (0.06, True)):
        planner = Scripted([decide(SceneAction.PUSH, seen.push)] * 2)
        loop = JointLoop(planner, belief, learning=Noting(), options=STILL_WORLD)
        now = loop.step(loop.begin(), look(0.0, seen.pose, PushStatus()))
        end = seen.final_pose + [[0.0, 0.0, 0.0], [off, 0.0, 0.0]]
        now = loop.step(now, look(5.0, end, PushStatus(command_id=1, executed=1)))
        assert asked.pop() == ([0] if changed else [0, 1], ["push_1"], changed)
        assert now.status.innovations == int(changed)
        assert now.status.surprise.startswith("block 1: It ended ") is changed
        assert [one.is_changed for one in now.object_innovations] == [False, changed]


def test_objects_are_learned_by_the_physics_that_they_are_believed_to_obey():
    truth = make_truth()
    physics = Physics(spin="none")
    belief = Belief.of_even_objects(truth.objects, sample_count=1, physics=physics)
    assert all(bodies.physics == physics for bodies in (belief.bodies, *belief.samples))
    learning = SceneLearning(after=(1,), hypotheses=(SmoothField(0.7),))
    learned = learning.learn(belief, [push_scene(truth, 0)], 0)
    assert learned.bodies.physics.spin == "none" and learned.identification is not None
