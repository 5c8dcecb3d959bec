"""An object that comes to rest, moves on, and goes out of sight; and loops stepped by hand, as a robot would."""

import copy

import numpy as np
import pytest

from gridpush_drake.identification.model import Model
from gridpush_drake.planning.closed_loop import LoopOptions, Observation, PoseFilter
from gridpush_drake.planning.goal.next_push import GoalRules
from gridpush_drake.planning.goal.push_to_goal_loop import PushToGoalLoop
from gridpush_drake.planning.robot_status import PushPhase, PushStatus
from gridpush_drake.pushes.push_log import PushLog
from tests.helpers.made_identifications import make_block

OPTIONS = LoopOptions(observations=4, rest_distance=0.004, rest_angle=0.04, timeout=1.0)


def look(poses, looks=None):
    looks = looks or PoseFilter()
    for i, pose in enumerate(poses):
        looks = looks.take_in(0.1 * i, np.array(pose, float), OPTIONS)
    return looks


def test_looks_of_one_rest_are_averaged():
    poses = [(0.1, 0.2, 0.3), (0.103, 0.198, 0.33), (0.101, 0.2, 0.31)]
    looks = look(poses)
    assert len(looks) == 3
    np.testing.assert_allclose(looks.calc_mean(), np.mean(poses, axis=0), rtol=1e-15)


def test_no_more_than_the_latest_are_kept():
    looks = look([(1e-4 * i, 0.0, 0.0) for i in range(7)])
    np.testing.assert_allclose(np.array(looks.poses)[:, 0], [3e-4, 4e-4, 5e-4, 6e-4], atol=1e-15)


def test_what_lies_elsewhere_or_is_turned_begins_another_rest():
    for moved in ((0.005, 0.0, 0.0), (0.0, -0.005, 0.0), (0.0, 0.0, 0.05)):
        assert look([(0.0, 0.0, 0.0), (0.0, 0.0, 0.0), moved]).poses == (moved,)
    slow = [
        (0.002 * i, 0.0, 0.0) for i in range(4)
    ]  # each near the one before, but not all of one rest
    assert look(slow).poses == tuple(slow[1:])


def test_out_of_sight_is_overdue_after_a_while_and_begins_anew():
    looks = look([(0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (np.nan, np.nan, np.nan)])
    assert (len(looks), looks.last_seen) == (0, 0.1)
    assert not looks.is_overdue(1.0, OPTIONS)
    assert looks.is_overdue(1.2, OPTIONS)


def test_while_the_robot_works_only_whether_it_was_seen_counts():
    looks = look([(0.0, 0.0, 0.0)])
    assert looks.wait(3.0, np.zeros(3)) == PoseFilter(last_seen=3.0)
    assert looks.wait(3.0, np.full(3, np.nan)) == PoseFilter()


GOAL = np.array([0.15, 0.1, 1.0])
UNSEEN = np.full(3, np.nan)


class Stepper:
    """Steps a loop with what a robot says, every 0.05 s."""

    def __init__(self, **options):
        self.loop = PushToGoalLoop(
            Model(make_block(12)), GoalRules(), options=LoopOptions(**options)
        )
        self.state, self.time = self.loop.begin(), 0.0

    def observe(self, pose, robot):
        return Observation(self.time, np.array(pose, float), robot, PushLog(()), goal=GOAL)

    def step(self, pose=(0.0, 0.0, 0.0), robot=None, count=1):
        for _ in range(count):
            self.time += self.loop.options.period
            self.state = self.loop.step(self.state, self.observe(pose, robot or PushStatus()))
        return self.state


def test_asks_once_the_object_was_seen_at_rest_and_waits_until_the_push_is_taken_up():
    stepper = Stepper(observations=3)
    assert stepper.step(count=2).push is None
    asked = stepper.step()
    assert (asked.push_id, asked.status.mode) == (1, "pushing")
    assert stepper.step(count=20).push is asked.push
    assert stepper.step(robot=PushStatus(PushPhase.PUSHING, 1), count=20).push is asked.push
    after = stepper.step(robot=PushStatus(command_id=1), count=3)
    assert (after.push_id, after.status.pushes) == (2, 1)


def test_a_step_changes_neither_the_state_nor_its_outcome():
    stepper = Stepper(observations=1)
    before = stepper.step(UNSEEN)
    held = dict(vars(before))
    shown = stepper.observe((0.0, 0.0, 0.0), PushStatus())
    first, second = (stepper.loop.step(before, shown) for _ in range(2))
    assert dict(vars(before)) == held
    np.testing.assert_array_equal(first.push.xy, second.push.xy)
    np.testing.assert_equal(vars(first.status), vars(second.status))  # NaN is NaN
    assert copy.deepcopy(first) is first


def test_a_push_taken_up_as_it_is_withdrawn_holds_nothing_up():
    stepper = Stepper(observations=1)
    stepper.step()
    withdrawn = stepper.step(UNSEEN)
    assert (withdrawn.push, withdrawn.push_id, withdrawn.status.mode) == (None, 1, "waiting")
    stepper.step(robot=PushStatus(PushPhase.PUSHING, 1), count=5)
    again = stepper.step(robot=PushStatus(command_id=1))
    assert (again.push_id, again.status.pushes) == (2, 0)
    assert again.push is not None


@pytest.mark.parametrize("max_refusals", [1, 4])
def test_refused_pushes_are_not_tried_again_and_given_up(max_refusals):
    stepper, asked = Stepper(observations=1, max_refusals=max_refusals), []
    for number in range(1, max_refusals + 1):
        asked.append(
            stepper.step(
                robot=PushStatus(command_id=number - 1, reason="it sulks" if number > 1 else "")
            ).push
        )
    state = stepper.step(robot=PushStatus(command_id=max_refusals, reason="it sulks"))
    assert (state.status.mode, state.status.cause, state.status.refused) == (
        "failed",
        "refused",
        max_refusals,
    )
    assert "it sulks" in state.status.reason
    for i, one in enumerate(asked):
        for other in asked[:i]:
            cosine = (
                one.velocity
                @ other.velocity
                / np.linalg.norm(one.velocity)
                / np.linalg.norm(other.velocity)
            )
            assert np.linalg.norm(one.start - other.start) >= 0.01 or cosine <= np.cos(0.2)
