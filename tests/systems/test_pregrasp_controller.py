"""The controller as a system by itself: its inputs are set, as a robot would set them, and its outputs read."""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.common.value import AbstractValue
from pydrake.systems.analysis import Simulator

from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import PlanningError
from gridpush_drake.identification.learning import describe_prior, identify
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.pregrasp.grasp.gripper import Gripper
from gridpush_drake.planning.pregrasp.grasp.side_grasp import find_side_grasps
from gridpush_drake.planning.pregrasp.planner import PreGraspPlanner
from gridpush_drake.planning.pregrasp.pregrasp_loop import PreGraspLoopOptions
from gridpush_drake.planning.pregrasp.weighing_planner import TiltTestPlanner
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.planning.weighing.press import PressTarget
from gridpush_drake.pushes.push_log import ObservedPush, PushLog
from gridpush_drake.systems.base.messages import (
    GraspCommand,
    GraspOutcome,
    GraspStatus,
    PressCommand,
    PushCommand,
    PushPhase,
    PushStatus,
)
from gridpush_drake.systems.control.pregrasp_controller import PreGraspController

pytestmark = pytest.mark.usefixtures("without_forecasts")

TABLE = SupportSurface.rectangle((0.0, 0.0), (0.8, 0.6))

BAR = GridObject.from_outline(
    [[-0.12, -0.02], [0.12, -0.02], [0.12, 0.02], [-0.12, 0.02]], max_cells=48
)
BAR = replace(BAR, prior=replace(BAR.prior, friction=0.35, friction_min=0.34, friction_max=0.36))

TRUTH = CellParameters(np.where(BAR.p_BC[:, 0] > 0, 0.03, 0.01), np.full(BAR.n, 0.35), 0.5)
"""Three times as heavy on its right side: its center of mass is at x = 3 cm."""

OVER_THE_EDGE = (-0.36, 0.0, 0.0)
"""Eight centimeters of the light end beyond the edge at x = -0.4."""

NOWHERE = (np.nan, np.nan, np.nan)


class Robot:
    """What the controller is connected to."""

    def __init__(self, pose, grasps=True, **options):
        planner = PreGraspPlanner(BAR, TABLE)
        self.controller = PreGraspController(
            planner,
            self.find_grasp if grasps else None,
            options=PreGraspLoopOptions(**options),
        )
        self.simulator = Simulator(self.controller)
        self.context = self.simulator.get_mutable_context()
        self.log, self.found = PushLog(()), describe_prior(BAR)
        self.pushing, self.grasping = PushStatus(), GraspStatus()
        self.see(pose)
        self.tell()

    @staticmethod
    def find_grasp(pose, aim, masses, at_worst):
        assert not at_worst  # a bar is taken by a narrow part
        return next(iter(find_side_grasps(BAR, pose, TABLE, Gripper(), aim)), None)

    def see(self, pose):
        self.controller.GetInputPort("object_pose").FixValue(self.context, pose)

    def tell(self):
        for port, value in (
            ("identification", self.found),
            ("push_log", self.log),
            ("push_status", self.pushing),
            ("grasp_status", self.grasping),
        ):
            if not self.controller.HasInputPort(port):
                continue
            self.controller.GetInputPort(port).FixValue(self.context, AbstractValue.Make(value))

    def wait(self, seconds=1.0):
        self.tell()
        self.simulator.AdvanceTo(self.context.get_time() + seconds)
        return self.status

    def read(self, port):
        return self.controller.GetOutputPort(port).Eval(self.context)

    @property
    def status(self):
        return self.read("status")

    @property
    def push(self):
        return PushCommand.from_vector(self.read("push_command"))

    @property
    def grasp(self):
        return GraspCommand.from_vector(self.read("grasp_command"))

    def learn(self, pushes=4):
        """Knows the bar from simulated pokes."""
        planner, seen = self.controller.planner, []
        poses = [np.zeros(3)]
        for _ in range(pushes):
            belief = (
                None
                if not seen
                else self.controller.loop.infer_from_identification(
                    identify(Model(BAR), PushLog(tuple(seen))), PushLog(tuple(seen))
                )
            )
            push = planner.decide(poses[-1], belief, 0).push
            end = simulate(Model(BAR, TRUTH), push, poses[-1], regime="quasi_static").final_pose
            seen.append(
                ObservedPush(
                    f"push_{len(seen)}", push, poses[-1], np.array([push.duration]), end[None]
                )
            )
            poses.append(end)
        self.log = PushLog(tuple(seen))
        self.found = identify(Model(BAR), self.log, regime="quasi_static")


@pytest.fixture(scope="module")
def learned():
    robot = Robot((0.0, 0.0, 0.0))
    robot.learn()
    return robot.log, robot.found


def make_robot(pose, learned, **options):
    robot = Robot(pose, **options)
    robot.log, robot.found = learned
    return robot


def test_pokes_first_and_waits_for_the_robot():
    robot = Robot((0.0, 0.0, 0.0))
    assert robot.wait().mode == "exploring"
    command = robot.push
    assert (command.command_id, robot.status.pokes) == (1, 1)
    robot.pushing = PushStatus(PushPhase.PUSHING, 1)
    robot.see((0.02, 0.0, 0.1))
    robot.wait(3.0)
    assert robot.push == command  # nothing new while the finger is at work
    robot.pushing = PushStatus(command_id=1, executed=1)
    robot.wait()
    assert robot.push.command_id == 2


def test_grasps_what_hangs_over_and_reports_that_it_is_held(learned):
    robot = make_robot(OVER_THE_EDGE, learned)
    assert robot.wait().mode == "grasping"
    command = robot.grasp
    assert command.command_id == 1
    assert command.x < -0.4
    assert np.cos(command.approach) > 0.0  # the fingers come in over the edge at x = -0.4
    robot.grasping = GraspStatus("closing", 1)
    assert robot.wait().mode == "grasping"
    robot.grasping = GraspStatus("holding", 1, GraspOutcome.HELD)
    assert robot.wait().mode == "holding"
    assert robot.status.over


def test_without_a_grasp_it_is_done_where_the_object_could_be_grasped(learned):
    robot = make_robot(OVER_THE_EDGE, learned, grasps=False)
    assert not robot.controller.HasOutputPort("grasp_command")
    status = robot.wait()
    assert (status.mode, status.over, status.grasps) == ("ready", True, 0)
    assert status.goal is not None and status.margin > 0
    robot.see((0.0, 0.0, 0.0))
    assert robot.wait() is status  # nothing more is done


def test_a_missed_grasp_is_tried_anew_and_given_up_in_the_end(learned):
    robot = make_robot(OVER_THE_EDGE, learned, max_grasps=2)
    for number in (1, 2):
        assert robot.wait().mode == "grasping"
        assert robot.grasp.command_id == number
        robot.grasping = GraspStatus("retreating", number, GraspOutcome.MISSED, "nothing is in it")
        assert robot.wait().mode == "grasping"  # until it is out of the way
        robot.grasping = GraspStatus("idle", number, GraspOutcome.MISSED, "nothing is in it")
    status = robot.wait()
    assert status.mode == "failed"
    assert "nothing is in it" in status.reason


def test_an_object_out_of_sight_is_lost_and_dealt_with_where_it_is_seen_again(learned):
    robot = make_robot(NOWHERE, learned, timeout=1.0)
    assert robot.wait(0.8).mode == "waiting"
    assert robot.wait(0.5).mode == "lost"
    assert robot.push.command_id == 0
    robot.see(OVER_THE_EDGE)
    assert robot.wait().mode == "grasping"


def test_a_push_not_taken_up_when_the_object_goes_out_of_sight_is_taken_back(learned):
    robot = make_robot((0.0, 0.0, 0.0), learned, timeout=1.0)
    assert robot.wait().mode == "exploring"
    first = robot.push
    robot.see(NOWHERE)
    status = robot.wait(0.5)
    assert (status.mode, status.pokes, robot.push.command_id) == ("waiting", 0, 0)
    assert robot.wait().mode == "lost"
    robot.see((0.1, 0.05, 0.5))
    assert robot.wait().mode == "exploring"
    assert (robot.push.command_id, robot.status.pokes) == (2, 1)  # an id is never used again
    assert np.linalg.norm(robot.push.start - first.start) > 0.02


def test_an_object_unseen_only_since_the_push_ended_is_not_lost_yet(learned):
    robot = make_robot((0.0, 0.0, 0.0), learned, timeout=1.0)
    robot.wait()
    robot.pushing = PushStatus(PushPhase.PUSHING, 1)
    robot.wait(5.0)
    robot.pushing = PushStatus(command_id=1, executed=1)
    robot.see(NOWHERE)
    assert robot.wait(0.8).mode == "waiting"
    assert robot.wait(0.5).mode == "lost"


def test_a_push_in_which_the_object_might_fall_is_broken_off(learned):
    robot = make_robot((0.0, 0.0, 0.0), learned)
    robot.wait()
    command = robot.push
    robot.pushing = PushStatus(PushPhase.PUSHING, 1)
    robot.see((-0.3, 0.0, 0.0))  # over the edge, but the heavy end holds it
    assert (robot.wait(0.2).mode, robot.push) == ("exploring", command)
    robot.see((-0.45, 0.0, 0.0))  # its center of mass is beyond the edge
    status = robot.wait(0.2)
    assert (status.mode, robot.push.command_id) == ("stopping", 0)
    assert "might fall" in status.reason
    robot.see((-0.3, 0.0, 0.0))
    assert robot.wait(0.2) is status  # what was begun is not taken up again
    robot.pushing = PushStatus(command_id=1, executed=1)
    assert robot.wait(0.2).mode == "waiting"
    assert robot.status.pokes == 1
    robot.wait()
    assert robot.push.command_id in (0, 2)


def test_a_stranger_who_moves_the_object_between_two_looks_changes_the_decision(learned):
    robot = make_robot((0.0, 0.0, 0.0), learned)
    robot.wait(0.2)  # some looks, not enough yet
    assert robot.status.mode == "waiting"
    robot.see((0.1, 0.05, 0.5))
    robot.wait()
    assert robot.status.mode == "exploring"  # fewer pokes were made than are asked for
    near = np.linalg.norm(BAR.cells_at((0.1, 0.05, 0.5)) - robot.push.start, axis=1).min()
    assert near < 0.03


def test_refused_pushes_do_not_count_and_are_given_up(learned):
    robot = make_robot((0.0, 0.0, 0.0), learned, max_refusals=3)
    for number in (1, 2, 3):
        assert robot.wait().mode == "exploring"
        assert (robot.push.command_id, robot.status.pokes) == (number, 1)
        robot.pushing = PushStatus(
            command_id=number, refused=number, reason="the arm does not reach it"
        )
    status = robot.wait()
    assert status.mode == "failed"
    assert "the arm does not reach it" in status.reason
    assert status.pokes == 0


def test_a_clone_of_the_context_goes_the_same_way(learned):
    robot = make_robot(OVER_THE_EDGE, learned)
    robot.wait(0.2)
    clone = robot.context.Clone()
    robot.wait()
    other = Simulator(robot.controller, clone)
    other.AdvanceTo(robot.context.get_time())
    np.testing.assert_array_equal(
        robot.controller.GetOutputPort("grasp_command").Eval(clone), robot.read("grasp_command")
    )


@pytest.mark.parametrize("options", [{"period": 0.0}, {"observations": 0}, {"timeout": np.nan}])
def test_refuses_options_out_of_range(options):
    with pytest.raises(PlanningError, match=next(iter(options))):
        PreGraspLoopOptions(**options)


def test_what_it_presses_stands_on_a_port_only_if_it_weighs():
    plain = Robot((0.0, 0.0, 0.0)).controller
    assert not plain.HasOutputPort("press_command")
    planner = TiltTestPlanner(BAR, TABLE)
    controller = PreGraspController(planner, Robot.find_grasp, weighs=True)
    context = controller.CreateDefaultContext()
    port = controller.GetOutputPort("press_command")
    assert PressCommand.from_vector(port.Eval(context)).command_id == 0
    target = PressTarget((0.02, 0.1), (0.0, 0.08), 1.5, 0.03, 0.008)
    asked = replace(controller.loop.begin(), press=target, press_id=3, press_pose=(0.0, 0.1, 0.2))
    asked = asked.turn_to("weighing", "It is weighed.")
    context.SetAbstractState(0, asked)
    command = PressCommand.from_vector(port.Eval(context))
    assert command.command_id == 3
    assert command.make_target(0.008) == target
    np.testing.assert_array_equal(command.object_pose, (0.0, 0.1, 0.2))
    # After the press, or where it was given up, none is asked for.
    context.SetAbstractState(0, asked.turn_to("waiting", "It was pressed."))
    assert PressCommand.from_vector(port.Eval(context)).command_id == 0
