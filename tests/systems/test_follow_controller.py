"""The controller that plans a path and steers along it, with a finger that needs no arm."""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.common.value import AbstractValue
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from shapely import Point, box

from gridpush_drake.geometry.se2 import transform
from gridpush_drake.identification.learning import describe_prior
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.exploration.strategy import MAX_REPETITION
from gridpush_drake.planning.feedback import (
    FollowOptions,
    FollowStatus,
    PosePath,
    PoseSensorModel,
    SteeredFinger,
)
from gridpush_drake.planning.feedback.follow_calculations import FollowRules, find_places
from gridpush_drake.planning.push_constraints import PushConstraints
from gridpush_drake.planning.pushed_object import FeedbackFinger
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.planning.world import SimulatedWorld
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.systems.base.messages import PushStatus, SteerCommand, SteerPhase, SteerStatus
from gridpush_drake.systems.control.follow_controller import (
    MAX_BLIND_TIME,
    FollowController,
    FollowMode,
)
from tests.helpers.made_identifications import make_block, make_identification
from tests.helpers.made_logs import make_pushed_block

OBJ = make_block(12)
TRUTH = CellParameters.by_part(OBJ, {1: 0.05, 2: 0.2}, 0.4, 0.4)
LEARNED = replace(
    make_identification(OBJ), parameters=(TRUTH,), push_names=("push_0",), unused_pushes=()
)
LOG = make_pushed_block().log[:1]
FINGER = FeedbackFinger(radius=0.01, speed=0.1, walking_speed=0.2)
RULES = FollowRules(
    goal=(0.2, 0.03, 0.2),
    finger=FINGER,
    options=FollowOptions(
        strokes=40, changes=60, draws=0, position_tolerance=0.004, angle_tolerance=0.06
    ),
    pokes=1,
    pose_delay=0.0,
    seed=1,
)
SIGHT = PoseSensorModel(period=0.02, delay=0.0, missing=0.0, position_std=0.0003, angle_std=0.002)


class Run:
    """The controller; a finger that obeys it at once; and a world that it pushes in."""

    def __init__(self, rules=RULES, learned=LEARNED, answer_delay=0.0):
        builder = DiagramBuilder()
        self.controller = builder.AddSystem(FollowController(OBJ, rules, answer_delay))
        self.diagram = builder.Build()
        self.simulator = Simulator(self.diagram)
        self.context = self.controller.GetMyMutableContextFromRoot(
            self.simulator.get_mutable_context()
        )
        self.steered = self.make_finger((-0.3, 0.3))
        self.is_seen = True
        self.is_finger_known = True
        self.refused = 0  # commands that the finger refuses
        self.commands = []
        self.steer = SteerStatus()
        self.fix("identification", AbstractValue.Make(learned))
        self.fix("push_log", AbstractValue.Make(PushLog(())))
        self.fix("push_status", AbstractValue.Make(PushStatus()))
        self.show(np.zeros(3))

    def make_finger(self, tip):
        return SteeredFinger(
            SimulatedWorld(Model(OBJ, TRUTH), np.zeros(3)), tip, FINGER.radius, SIGHT
        )

    def fix(self, port, value):
        self.controller.GetInputPort(port).FixValue(self.context, value)

    def poke(self):
        """Tells of a poke that was made."""
        self.fix("push_log", AbstractValue.Make(LOG))

    def show(self, pose):
        self.fix("object_pose", np.array(pose) if self.is_seen else np.full(3, np.nan))
        tip = self.steered.tip if self.is_finger_known else (np.nan, np.nan)
        self.fix("pusher_state", np.array([*tip, 0.02, 0.0, 0.0, 0.0]))
        self.fix("steer_status", AbstractValue.Make(self.steer))

    @property
    def status(self):
        return self.controller.GetOutputPort("status").Eval(self.context)

    @property
    def command(self):
        vector = self.controller.GetOutputPort("steer_command").Eval(self.context)
        return SteerCommand.from_vector(vector)

    def go(self, duration):
        """Lets the finger do what it is told; ends early once the controller is done."""
        end = self.simulator.get_context().get_time() + duration
        while self.simulator.get_context().get_time() < end - 1e-9:
            self.simulator.AdvanceTo(self.simulator.get_context().get_time() + SIGHT.period)
            command = self.command
            if command.command_id not in (0, self.steer.command_id):
                self.commands.append(command)
                if len(self.commands) <= self.refused:
                    self.steer = SteerStatus(
                        command_id=command.command_id, refused=True, reason="out of reach"
                    )
                else:
                    self.steered = self.make_finger((command.x, command.y))
                    self.steer = SteerStatus(SteerPhase.STEERING, command.command_id)
            if command.command_id == 0 and self.steer.phase == SteerPhase.STEERING:
                self.steer = replace(self.steer, phase=SteerPhase.IDLE)
            moves = self.steer.phase == SteerPhase.STEERING
            size = len(self.steered.tip)
            came = self.steered.move(command.velocity[:size] if moves else np.zeros(size))
            self.show(came[-1].pose)
            if self.status.mode in (FollowMode.REACHED, FollowMode.FAILED):
                break
        return self.status


def measure_off(pose):
    middle = OBJ.p_BC.mean(axis=0)[None]
    return float(np.linalg.norm(transform(pose, middle) - transform(np.array(RULES.goal), middle)))


def test_it_waits_plans_goes_down_behind_the_object_and_pushes_it_to_the_end():
    run = Run()
    assert run.go(0.2).mode == FollowMode.POKING
    run.poke()
    status = run.go(30.0)
    assert (status.mode, status.cause) == (FollowMode.REACHED, FollowStatus.REACHED), status
    assert status.plans == 1
    assert measure_off(run.steered.pose) < 0.006
    # it came down behind the object, as its path begins
    (down,) = run.commands
    assert down.x < OBJ.outline.bounds[0]
    # at the end the finger goes up
    assert run.command.command_id == 0
    prepared = run.controller.GetOutputPort("prepared").Eval(run.context)
    assert prepared.path.goal == pytest.approx(RULES.goal)


def test_answers_that_come_late_do_as_well():
    run = Run(answer_delay=0.04)
    run.poke()
    assert run.go(30.0).mode == FollowMode.REACHED
    assert measure_off(run.steered.pose) < 0.006


@pytest.mark.slow
def test_it_rests_while_no_pose_comes_and_goes_on_with_the_next():
    run = Run()
    run.poke()
    run.go(1.0)
    assert run.status.mode == FollowMode.FOLLOWING
    run.is_seen = False
    run.go(1.0)
    assert (run.status.mode, run.status.cause) == (FollowMode.FOLLOWING, FollowStatus.NO_POSE)
    assert "No pose" in run.status.reason
    assert not run.command.velocity.any()
    assert run.command.command_id != 0
    run.is_seen = True
    run.go(0.5)
    assert run.status.cause == FollowStatus.PUSHING
    assert run.go(30.0).mode == FollowMode.REACHED


@pytest.mark.slow
def test_it_rests_while_the_finger_is_not_known_and_goes_on_afterwards():
    run = Run()
    run.poke()
    run.go(1.0)
    run.is_finger_known = False
    run.go(0.3)
    assert (run.status.mode, run.status.cause) == (FollowMode.FOLLOWING, FollowStatus.NO_FINGER)
    assert "finger" in run.status.reason
    assert not run.command.velocity.any()
    run.is_finger_known = True
    assert run.go(30.0).mode == FollowMode.REACHED


@pytest.mark.slow
def test_the_finger_goes_up_if_the_object_stays_hidden_and_goes_on_once_it_is_seen():
    run = Run()
    run.poke()
    run.go(1.0)
    run.is_seen = False
    status = run.go(MAX_BLIND_TIME + 1.0)
    assert (status.mode, status.cause) == (FollowMode.PLANNING, FollowStatus.NO_POSE)
    assert "Another path" in status.reason
    assert run.command.command_id == 0
    run.is_seen = True
    status = run.go(30.0)
    assert (status.mode, status.plans) == (FollowMode.REACHED, 2)


@pytest.mark.slow
def test_what_is_behind_on_a_told_path_is_not_gone_again():
    class Left(Run):
        """The object stays where it was left when the finger comes down again."""

        def make_finger(self, tip):
            been = self.steered.poses if hasattr(self, "steered") else []
            pose = been[-1] if been else np.zeros(3)
            return SteeredFinger(SimulatedWorld(Model(OBJ, TRUTH), pose), tip, FINGER.radius, SIGHT)

    told = PosePath([(0, 0, 0), (0.1, 0, 0), (0.1, 0.1, 0)], speed=0.05)
    run = Left(replace(RULES, path=told))
    run.poke()
    while not run.steered.poses or run.steered.poses[-1][0] < 0.05:
        run.go(0.1)
    run.is_seen = False
    run.go(MAX_BLIND_TIME + 1.0)
    run.is_seen = True
    left = run.steered.poses[-1]
    run.go(0.1)
    path = run.controller.GetOutputPort("prepared").Eval(run.context).path
    begin = transform(path.poses[0], OBJ.p_BC.mean(axis=0)[None])
    assert np.linalg.norm(begin - transform(left, OBJ.p_BC.mean(axis=0)[None])) < 0.01
    np.testing.assert_allclose(path.goal, told.goal, atol=1e-12)
    assert run.go(30.0).mode == FollowMode.REACHED


@pytest.mark.slow
def test_the_finger_stops_where_a_decision_takes_too_long_and_makes_up_for_its_time():
    late = 2.5 * RULES.options.period
    run = Run(answer_delay=late)
    run.poke()
    # planning takes as long
    while run.status.mode != FollowMode.FOLLOWING:
        run.go(0.02)
    speeds = []
    for _ in range(200):
        run.go(0.02)
        speeds.append(float(np.hypot(*run.command.velocity[:2])))
    moving = np.array(speeds) > 0
    # each decision holds for two periods at most, and the rest of its time the finger waits
    edges = np.flatnonzero(np.diff(moving.astype(int)))
    assert len(edges) > 10
    assert 0.02 * np.max(np.diff(edges)) <= 2 * RULES.options.period + 0.05
    status = run.go(60.0)
    assert status.mode == FollowMode.REACHED, status


def test_the_finger_comes_down_elsewhere_if_the_arm_does_not_get_there():
    run = Run()
    run.refused = 2
    run.poke()
    run.go(1.0)
    assert run.status.mode == FollowMode.FOLLOWING
    places = {(command.x, command.y) for command in run.commands}
    assert len(places) == 3
    hopeless = Run()
    hopeless.refused = 1000
    hopeless.poke()
    status = hopeless.go(5.0)
    assert status.mode == FollowMode.FAILED
    assert "out of reach" in status.reason


@pytest.mark.parametrize(
    ("changes", "cause"),
    [
        (
            {"constraints": PushConstraints(obstacles=(Point(0.2, 0.03).buffer(0.02),))},
            FollowStatus.GOAL_BLOCKED,
        ),
        (
            # a wall from one edge of the table to the other
            {
                "constraints": PushConstraints(
                    obstacles=(box(0.09, -0.4, 0.1, 0.4),),
                    surface=SupportSurface.rectangle((0.1, 0.0), (0.6, 0.5)),
                )
            },
            FollowStatus.PATH_BLOCKED,
        ),
        (
            {"path": PosePath([(0, 0, 0), (0.2, 0, 0)], speed=0.2)},
            FollowStatus.TOO_FAST,
        ),
    ],
)
def test_what_cannot_be_followed_is_refused_before_the_finger_comes_down(changes, cause):
    run = Run(replace(RULES, **changes))
    run.poke()
    status = run.go(3.0)
    assert (status.mode, status.cause) == (FollowMode.FAILED, cause)
    assert status.reason.endswith(".")
    assert not run.commands


def test_nothing_learned_is_nothing_followed():
    run = Run(learned=describe_prior(OBJ))
    run.poke()
    status = run.go(12.0)
    assert status.mode == FollowMode.FAILED
    assert "Nothing was learned" in status.reason


def test_goes_on_with_fewer_pokes_where_no_more_could_be_written_down():
    run = Run(replace(RULES, pokes=2))
    run.poke()
    assert len(LOG) == 1
    run.fix("push_status", AbstractValue.Make(PushStatus(executed=3)))
    assert run.go(1.0).mode == FollowMode.POKING
    run.fix("push_status", AbstractValue.Make(PushStatus(executed=MAX_REPETITION * 2)))
    run.go(1.0)
    assert run.status.mode == FollowMode.FOLLOWING


def test_a_model_of_another_object_is_told_apart_and_planned_with_anew_at_most_so_often():
    class Held(Run):
        """The object is held fast, and the finger slides along it."""

        def show(self, pose):
            widened = OBJ.outline.buffer(FINGER.radius)
            tip = Point(self.steered.tip)
            if widened.contains(tip):
                rim = widened.exterior
                self.steered.tip = np.array(rim.interpolate(rim.project(tip)).coords[0])
            super().show(np.zeros(3))

    options = replace(RULES.options, stuck_after=4.0)
    run = Held(replace(RULES, plans=2, options=options))
    run.poke()
    status = run.go(60.0)
    assert status.mode == FollowMode.FAILED
    assert status.cause in (FollowStatus.UNLIKE_MODEL, FollowStatus.STUCK)
    assert status.plans == 2
    assert len(run.commands) == 2
    assert run.command.command_id == 0


def test_places_for_the_finger_keep_clear_of_what_stands_there():
    path = PosePath([(0, 0, 0), (0.2, 0, 0)], speed=0.05)
    free = find_places(OBJ, np.zeros(3), path, RULES)
    assert free[0] == pytest.approx([-0.06 - FINGER.radius - 0.012, 0.0], abs=1e-3)
    post = Point(-0.09, 0.0).buffer(0.02)
    rules = replace(RULES, constraints=PushConstraints(obstacles=(post,)))
    kept = find_places(OBJ, np.zeros(3), path, rules)
    assert 0 < len(kept) < len(free)
    least = FINGER.radius + rules.constraints.obstacle_margin
    assert min(post.distance(Point(place)) for place in kept) >= least


def test_a_clone_goes_on_alike():
    run = Run()
    run.poke()
    run.go(1.0)
    clone = Simulator(run.diagram, run.simulator.get_context().Clone())
    ends = []
    for simulator in (run.simulator, clone):
        simulator.AdvanceTo(1.3)
        context = run.controller.GetMyContextFromRoot(simulator.get_context())
        ends.append(run.controller.GetOutputPort("steer_command").Eval(context))
    assert ends[0] == pytest.approx(ends[1])


@pytest.mark.parametrize("answer_delay", [0.0, 0.04])
def test_it_learns_on_the_way(answer_delay):
    """It begins with a model whose light end is the heavy one."""
    wrong = CellParameters.by_part(OBJ, {1: 0.2, 2: 0.05}, 0.4, 0.4)
    run = Run(learned=LEARNED.with_params(wrong), answer_delay=answer_delay)
    run.poke()
    assert run.go(40.0).mode == FollowMode.REACHED
    state = run.context.get_abstract_state(0).get_value()
    model = state.prepared.follower.model
    loads = model.body.k
    heavy = OBJ.labels == 2
    assert loads[heavy].mean() > 1.5 * loads[~heavy].mean()
