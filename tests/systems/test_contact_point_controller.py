"""Pushing to a goal in a small world, with good luck and with bad."""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.common.value import AbstractValue
from pydrake.systems.analysis import Simulator
from shapely import box

from gridpush_drake.dynamics.pusher import Pusher
from gridpush_drake.errors import PlanningError
from gridpush_drake.identification.learning import describe_prior
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.closed_loop import LoopOptions
from gridpush_drake.planning.contact.trial import ContactOptions, calc_goal_error
from gridpush_drake.planning.goal.next_push import GoalRules
from gridpush_drake.planning.push_constraints import PushConstraints
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.systems.base.messages import ContactPointMode, PushCommand, PushStatus
from gridpush_drake.systems.control.contact_point_controller import ContactPointController
from tests.helpers.goal_diagram import make_run
from tests.helpers.made_identifications import make_block

OBJ = make_block(12)
TRUTH = CellParameters.by_part(OBJ, {1: 0.05, 2: 0.2}, 0.4, 0.4)
TABLE = SupportSurface.rectangle((0.0, 0.0), (1.0, 1.0))
RULES = GoalRules(
    PushConstraints(TABLE),
    ContactOptions(Pusher(speed=0.1, clearance=0.005), (0.008, 0.3)),
    max_pushes=12,
)
GOAL = (0.15, 0.1, 1.0)


def over(status):
    return status.mode in (ContactPointMode.REACHED, ContactPointMode.FAILED)


def rules_with(**changes):
    return replace(RULES, constraints=replace(RULES.constraints, **changes))


def set_goal(run, goal):
    source = run.context(run.goal)
    run.goal.get_mutable_source_value(source).SetFromVector(goal)


def test_reaches_the_goal_learning_nothing_and_says_so():
    run = make_run(OBJ, TRUTH, GOAL, RULES)
    seen = []
    status = run.go_on_until(lambda status: seen.append(status) or over(status))
    assert (status.mode, status.cause) == (ContactPointMode.REACHED, "reached")
    assert calc_goal_error(OBJ, run.pose, GOAL) < RULES.tolerance + 1e-3
    assert status.error == pytest.approx(calc_goal_error(OBJ, run.pose, GOAL), abs=1e-3)
    executor = run.read(run.executor, "status")
    assert status.pushes == executor.executed == run.read(run.controller, "push_command")[0]
    under_way = [one for one in seen if one.mode == ContactPointMode.PUSHING]
    assert all(
        one.expected_pose is not None and one.expected_error < one.error for one in under_way
    )
    assert status.expected_pose is None and status.prediction_error < 0.1
    # nothing more is done once it is there
    run.simulator.AdvanceTo(run.simulator.get_context().get_time() + 2.0)
    assert run.status is status and run.read(run.executor, "status") == executor


def test_learns_on_the_way():
    run = make_run(OBJ, TRUTH, GOAL, RULES, learning=2)
    status = run.go_on_until(over)
    assert status.mode == ContactPointMode.REACHED


@pytest.mark.slow
def test_a_clone_goes_on_alike():
    run = make_run(OBJ, TRUTH, GOAL, RULES)
    run.simulator.AdvanceTo(2.0)
    clone = Simulator(run.simulator.get_system(), run.simulator.get_context().Clone())
    for one in (run.simulator, clone):
        one.AdvanceTo(14.0)
    ends = [run.world.GetOutputPort("pose").Eval(run.world.GetMyContextFromRoot(one.get_context()))
            for one in (run.simulator, clone)]  # fmt: skip
    np.testing.assert_array_equal(*ends)


@pytest.mark.slow
def test_another_goal_begins_anew():
    run = make_run(OBJ, TRUTH, GOAL, RULES)
    run.go_on_until(over)
    there, made = np.array([0.05, -0.1, 0.3]), run.read(run.executor, "status").executed
    set_goal(run, there)
    run.go_on_until(lambda status: status.mode == ContactPointMode.PUSHING, 3.0)
    assert run.status.pushes == 0
    status = run.go_on_until(over)
    assert (
        status.mode == ContactPointMode.REACHED
        and status.pushes == run.read(run.executor, "status").executed - made
    )
    assert calc_goal_error(OBJ, run.pose, there) < RULES.tolerance + 1e-3
    set_goal(run, np.full(3, np.nan))
    run.simulator.AdvanceTo(run.simulator.get_context().get_time() + 0.2)
    assert (run.status.mode, run.status.reason) == (ContactPointMode.WAITING, "No goal is given.")


@pytest.mark.parametrize(
    ("goal", "changes", "cause"),
    [
        ((0.49, 0.0, 0.0), {}, "goal_off_table"),
        ((3.0, 0.0, 0.0), {}, "goal_off_table"),
        ((0.2, 0.2, 0.0), {"obstacles": (box(0.15, 0.15, 0.25, 0.25),)}, "goal_blocked"),
        ((0.35, 0.0, 0.0), {"finger_region": box(-0.2, -0.2, 0.2, 0.2)}, "goal_out_of_reach"),
        ((0.2, 0.0, 0.0), {"push_rule": lambda push: False}, "stuck"),
        ((0.3, 0.3, 0.0), {"obstacles": (box(0.18, -0.5, 0.2, 0.19), box(-0.5, 0.17, 0.2, 0.19))}, "no_path"),
    ],
)  # fmt: skip
def test_says_why_a_goal_cannot_be_reached(goal, changes, cause):
    run = make_run(OBJ, TRUTH, goal, rules_with(**changes))
    status = run.go_on_until(over, 5.0)
    assert (status.mode, status.cause, status.pushes) == (ContactPointMode.FAILED, cause, 0)
    assert status.reason.endswith(".")
    np.testing.assert_array_equal(run.pose, np.zeros(3))


@pytest.mark.slow
def test_goes_round_an_obstacle():
    wall = box(0.1, -0.25, 0.12, 0.1)
    goal = (0.25, -0.05, 0.0)
    run = make_run(OBJ, TRUTH, goal, rules_with(obstacles=(wall,)))
    clear = []
    status = run.go_on_until(lambda status: clear.append(run.pose) or over(status), 200.0)
    assert status.mode == ContactPointMode.REACHED, status
    checker = PushConstraints(obstacles=(wall,)).start_at(OBJ, np.zeros(3), 0.008)
    assert not any(checker.overlaps_obstacle(pose) for pose in clear)


def test_the_arms_word_is_heeded():
    """Only pushes that come from the left half are possible for this arm."""
    rules = rules_with(push_rule=lambda push: bool(push.velocity[0] > 0))
    run = make_run(OBJ, TRUTH, (0.15, 0.0, 0.2), rules)
    commands = []
    status = run.go_on_until(
        lambda status: commands.append(run.read(run.controller, "push_command")) or over(status),
        60.0,
    )
    assert status.mode == ContactPointMode.REACHED
    made = [PushCommand.from_vector(command) for command in commands if command[0] > 0]
    assert made and all(np.cos(command.direction) > 0 for command in made)


def test_a_refused_push_is_not_tried_again():
    """The arm refuses to push away from the robot, and nobody has told the planner."""

    def reach(way, speeds):
        begin, end = way[-4], way[-3]
        return "the arm sulks" if end[0] - begin[0] > 0.02 else None

    run = make_run(
        OBJ, TRUTH, (0.15, 0.1, 1.0), RULES, reach=reach, options=LoopOptions(max_refusals=6)
    )
    refused = []

    def note(status):
        if status.refused > len(refused):
            refused.append(PushCommand.from_vector(run.read(run.controller, "push_command")))
        return over(status) or status.pushes > 0

    status = run.go_on_until(note, 60.0)
    assert len(refused) >= 2
    for i, one in enumerate(refused):
        for other in refused[:i]:
            apart, turned = np.linalg.norm(one.start - other.start), one.direction - other.direction
            assert apart > 0.01 - 1e-9 or np.cos(turned) < np.cos(0.2) + 1e-9
    assert status.pushes or status.cause == "stuck" or "the arm sulks" in status.reason


def test_gives_up_when_everything_is_refused():
    run = make_run(
        OBJ,
        TRUTH,
        GOAL,
        RULES,
        reach=lambda way, speeds: "the arm sulks",
        options=LoopOptions(max_refusals=3),
    )
    status = run.go_on_until(over, 10.0)
    assert (status.mode, status.cause, status.refused, status.pushes) == (
        ContactPointMode.FAILED,
        "refused",
        3,
        0,
    )
    assert "the arm sulks" in status.reason
    # somebody brings the object elsewhere: another attempt
    run.world.SetPose(run.context(run.world), (0.1, 0.1, 0.5))
    assert run.go_on_until(lambda status: status.refused == 1, 3.0).refused == 1


@pytest.mark.slow
def test_an_object_that_slips_away_from_the_finger_is_pursued():
    slippery = CellParameters(TRUTH.mass, TRUTH.friction, 0.02)
    run = make_run(OBJ, slippery, GOAL, RULES)
    status = run.go_on_until(over, 200.0)
    assert status.mode == ContactPointMode.REACHED or status.cause in ("too_many_pushes", "stuck")
    assert TABLE.contains(OBJ.cells_at(run.pose)).all()


@pytest.mark.slow
def test_an_object_moved_between_pushes_is_pushed_from_where_it_lies():
    run = make_run(OBJ, TRUTH, GOAL, RULES)
    run.go_on_until(lambda status: status.pushes == 1)
    run.world.SetPose(run.context(run.world), (-0.2, -0.2, -1.0))
    status = run.go_on_until(over)
    assert status.mode == ContactPointMode.REACHED and status.pushes >= 2
    assert calc_goal_error(OBJ, run.pose, GOAL) < RULES.tolerance + 1e-3
    # and once more after the end
    run.world.SetPose(run.context(run.world), (0.1, -0.2, 0.0))
    assert (
        run.go_on_until(lambda status: status.mode == ContactPointMode.PUSHING, 3.0).pushes
        == status.pushes
    )
    assert run.go_on_until(over).mode == ContactPointMode.REACHED


def test_an_object_out_of_sight_is_waited_for():
    run = make_run(OBJ, TRUTH, GOAL, RULES)
    run.go_on_until(lambda status: status.pushes == 1)
    now = run.simulator.get_context().get_time()
    run.context(run.cover).get_mutable_numeric_parameter(0).SetFromVector([now, now + 2.0])
    lost = run.go_on_until(lambda status: status.mode == ContactPointMode.LOST, 2.0)
    assert lost.mode == ContactPointMode.LOST and "not been seen for 1 s" in lost.reason
    before = run.read(run.executor, "status")
    run.simulator.AdvanceTo(now + 1.9)
    assert run.read(run.executor, "status") == before
    assert run.go_on_until(over).mode == ContactPointMode.REACHED


def test_a_command_that_was_not_taken_up_is_withdrawn():
    """The object is covered up between the command and the executor's look, and lies elsewhere afterwards."""
    controller = ContactPointController(Model(OBJ), RULES)
    simulator = Simulator(controller)
    context = simulator.get_mutable_context()
    for port, value in (("push_status", PushStatus()), ("identification", describe_prior(OBJ))):
        controller.GetInputPort(port).FixValue(context, AbstractValue.Make(value))
    controller.GetInputPort("goal_pose").FixValue(context, np.array(GOAL))
    object_pose = controller.GetInputPort("object_pose")
    object_pose.FixValue(context, np.zeros(3))
    command = controller.GetOutputPort("push_command")
    simulator.AdvanceTo(0.5)
    assert command.Eval(context)[0] == 1
    object_pose.FixValue(context, np.full(3, np.nan))
    simulator.AdvanceTo(0.7)
    assert command.Eval(context)[0] == 0
    object_pose.FixValue(context, np.array([0.1, 0.0, 0.0]))
    simulator.AdvanceTo(1.3)
    assert command.Eval(context)[0] == 2


def test_stops_after_the_allowed_pushes():
    run = make_run(OBJ, TRUTH, (0.2, 0.2, 3.0), replace(RULES, max_pushes=1, tolerance=0.002))
    status = run.go_on_until(over)
    assert (status.mode, status.cause, status.pushes) == (
        ContactPointMode.FAILED,
        "too_many_pushes",
        1,
    )


def test_bad_numbers_are_refused():
    with pytest.raises(PlanningError, match="tolerance"):
        GoalRules(tolerance=0.0)
    with pytest.raises(PlanningError, match="max_pushes"):
        GoalRules(max_pushes=-1)
    with pytest.raises(PlanningError, match="observations"):
        LoopOptions(observations=0)
    with pytest.raises(PlanningError, match="timeout"):
        LoopOptions(timeout=-1.0)
