"""What is calculated beside a Diagram: in lockstep a run is the same every time, and nothing that fails ends it."""

import gc
import threading
import time
from dataclasses import asdict, replace
from functools import partial
from threading import Event
from weakref import ref

import numpy as np
import pytest
from pydrake.common.value import AbstractValue
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.pusher import Pusher
from gridpush_drake.errors import PlanningError
from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.belief import Belief
from gridpush_drake.planning.contact.trial import ContactOptions
from gridpush_drake.planning.exploration import RandomPokeOptions, RandomPokes
from gridpush_drake.planning.goal.next_push import GoalRules
from gridpush_drake.planning.push_constraints import PushConstraints
from gridpush_drake.planning.scene.joint_loop import JointLoop
from gridpush_drake.planning.scene.loop import SceneAction, SceneDecision
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.systems.base.messages import ContactPointMode, PushStatus
from gridpush_drake.systems.base.worker import Worker, make_worker
from gridpush_drake.systems.control.poke_policy import PokePolicy
from gridpush_drake.systems.control.scene_controller import SceneController
from gridpush_drake.systems.learning.grid_identifier import GridIdentifier
from tests.helpers.goal_diagram import Run, make_run
from tests.helpers.made_identifications import make_block
from tests.helpers.poke_diagram import FINGER_RULES, REGION, PokeDiagram, make_poke_diagram

FAST = RandomPokeOptions(speed=0.1)
LONGEST = 5.0
"""s of the clock on the wall that a test waits for a thread."""


def make_pokes(**options) -> PokeDiagram:
    obj = make_block()
    return make_poke_diagram(
        obj, CellParameters.random(obj, seed=3), pokes=3, seed=1, style=FAST, **options
    )


def run_until(simulator: Simulator, parts: PokeDiagram, done, longest: float = 60.0) -> None:
    context = parts.identifier.GetMyContextFromRoot(simulator.get_context())
    while not done(context) and simulator.get_context().get_time() < longest:
        simulator.AdvanceTo(simulator.get_context().get_time() + 0.25)
    assert done(context), "it took too long"


def read(parts: PokeDiagram, simulator: Simulator, port: str):
    return parts.identifier.GetOutputPort(port).Eval(
        parts.identifier.GetMyContextFromRoot(simulator.get_context())
    )


def get_state(context):
    return context.get_abstract_state(0).get_value()


def test_lockstep_takes_answers_at_its_time_and_not_before() -> None:
    worker = Worker(0.5)
    request = worker.ask(lambda: 42, 1.0)
    deadline = time.monotonic() + LONGEST
    while not worker._find(request).done() and time.monotonic() < deadline:
        time.sleep(0.001)
    assert worker.take(request, 1.49) is None, "however fast the computer is"
    answer = worker.take(request, 1.5)
    assert answer is not None and answer.value == 42 and answer.error == ""
    assert worker.take(request, 2.0).value == 42, "a Context that is older may ask again"


def test_lockstep_waits_and_real_time_does_not() -> None:
    go = Event()
    waits, goes_on = Worker(0.5), Worker(None)
    request = goes_on.ask(partial(go.wait, LONGEST), 0.0)
    assert goes_on.take(request, 100.0) is None
    slow = waits.ask(partial(go.wait, LONGEST), 0.0)
    threading.Timer(0.05, go.set).start()
    assert waits.take(slow, 0.5).value is True
    deadline = time.monotonic() + LONGEST
    while (answer := goes_on.take(request, 100.0)) is None and time.monotonic() < deadline:
        time.sleep(0.001)
    assert answer is not None and answer.value is True


@pytest.mark.parametrize("error", [ValueError("no luck"), SystemExit(3), MemoryError()])
def test_what_fails_is_said_and_the_next_request_is_answered(error: BaseException) -> None:
    def fail() -> None:
        raise error

    worker = Worker(0.0)
    answer = worker.take(worker.ask(fail, 0.0), 0.0)
    assert answer is not None and answer.value is None and type(error).__name__ in answer.error
    assert worker.take(worker.ask(lambda: 1, 0.0), 0.0).value == 1


def test_a_worker_that_was_ended_answers_again() -> None:
    worker, go = Worker(0.0), Event()
    busy, waiting = worker.ask(partial(go.wait, LONGEST), 0.0), worker.ask(lambda: 2, 0.0)
    worker.close()
    go.set()
    assert "Cancelled" in worker.take(waiting, 0.0).error
    assert worker.take(busy, 0.0).value is True
    assert worker.take(worker.ask(lambda: 3, 0.0), 0.0).value == 3


@pytest.mark.parametrize("delay", [-1.0, np.nan, np.inf])
def test_bad_delays_are_refused(delay: float) -> None:
    with pytest.raises(PlanningError, match="answer_delay is"):
        make_worker(delay)


@pytest.fixture(scope="module")
def late() -> tuple[PokeDiagram, Simulator]:
    """Three pokes, each learned from 0.7 s after it, which is while the next one is prepared."""
    parts = make_pokes(answer_delay=0.7, warm_start=False)
    simulator = Simulator(parts.diagram)
    run_until(simulator, parts, lambda context: get_state(context).considered == 3)
    return parts, simulator


def test_in_lockstep_outputs_hold_and_then_are_the_offline_answer_bit_for_bit(late) -> None:
    parts, simulator = late
    offline = identify(Model(parts.identifier.obj), read(parts, simulator, "push_log"), seed=1)
    np.testing.assert_array_equal(read(parts, simulator, "mass"), offline.params.mass)
    np.testing.assert_array_equal(
        read(parts, simulator, "identification").posterior.covariance, offline.posterior.covariance
    )
    parts = make_pokes(answer_delay=0.7, warm_start=False)
    simulator = Simulator(parts.diagram)
    run_until(simulator, parts, lambda context: get_state(context).request is not None)
    asked = get_state(parts.identifier.GetMyContextFromRoot(simulator.get_context())).request.time
    assert read(parts, simulator, "num_pushes")[0] == 1 and np.isnan(
        read(parts, simulator, "age")[0]
    )
    simulator.AdvanceTo(asked + 0.69)
    assert read(parts, simulator, "identification").push_names == ()
    simulator.AdvanceTo(asked + 0.75)
    assert read(parts, simulator, "identification").push_names == ("push_1",)
    assert read(parts, simulator, "age")[0] == pytest.approx(0.75)


@pytest.mark.slow
def test_a_clone_with_a_request_under_way_ends_as_the_original_bit_for_bit(late) -> None:
    parts = make_pokes(answer_delay=0.7, warm_start=False)
    simulator = Simulator(parts.diagram)
    run_until(simulator, parts, lambda context: get_state(context).request is not None)
    clone = simulator.get_context().Clone()
    parts.identifier._worker.close()  # even where what was begun is gone
    parts.identifier._worker._futures.clear()
    other = Simulator(parts.diagram, clone)
    for one in (simulator, other):
        run_until(one, parts, lambda context: get_state(context).considered == 3)
        for port in ("mass", "mass_std", "loss"):
            np.testing.assert_array_equal(read(parts, one, port), read(*late, port))


def test_in_real_time_the_same_is_learned_from_the_same_log() -> None:
    parts = make_pokes(answer_delay=None, warm_start=False)
    simulator = Simulator(parts.diagram)
    run_until(simulator, parts, lambda context: len(get_state(context).log) == 3)
    deadline = time.monotonic() + 4 * LONGEST
    while (
        len(read(parts, simulator, "identification").push_names) < 3 and time.monotonic() < deadline
    ):
        time.sleep(0.01)
        simulator.AdvanceTo(simulator.get_context().get_time() + 0.05)
    offline = identify(Model(parts.identifier.obj), read(parts, simulator, "push_log"), seed=1)
    np.testing.assert_array_equal(read(parts, simulator, "mass"), offline.params.mass)


class Unlucky(GridIdentifier):
    """Cannot learn from its first push, in a way that nobody foresaw."""

    __slots__ = ()

    def Learn(self, log, start=None, weighings=None):
        if log[0].name == "push_1":
            raise RuntimeError("out of luck")
        return super().Learn(log, start, weighings)


def test_an_identifier_whose_worker_raises_says_so_and_goes_on(monkeypatch) -> None:
    monkeypatch.setattr("tests.helpers.poke_diagram.GridIdentifier", Unlucky)
    parts = make_pokes(answer_delay=0.2)
    simulator = Simulator(parts.diagram)
    run_until(simulator, parts, lambda context: get_state(context).considered == 1)
    assert (
        read(parts, simulator, "message")
        == "Nothing could be learned from push_1: RuntimeError: out of luck."
    )
    run_until(simulator, parts, lambda context: get_state(context).considered == 2)
    assert read(parts, simulator, "message") == ""
    assert read(parts, simulator, "identification").push_names == ("push_2",)


POSE = np.array([0.05, -0.02, 0.4])


def make_policy(push_rule=None, **options) -> Simulator:
    """A policy in a Diagram of its own, with an object that lies and an executor that is ready."""
    builder = DiagramBuilder()
    policy = builder.AddNamedSystem(
        "policy",
        PokePolicy(
            Model(make_block()),
            RandomPokes(region=REGION, seed=1),
            replace(FINGER_RULES, push_rule=push_rule),
            2,
            **options,
        ),
    )
    simulator = Simulator(builder.Build())
    context = policy.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    policy.GetInputPort("object_pose").FixValue(context, POSE)
    policy.GetInputPort("status").FixValue(context, AbstractValue.Make(PushStatus()))
    return simulator


def read_policy(simulator: Simulator, port: str):
    policy = simulator.get_system().GetSubsystemByName("policy")
    return policy.GetOutputPort(port).Eval(policy.GetMyContextFromRoot(simulator.get_context()))


def test_a_poke_is_chosen_beside_the_diagram_and_is_the_same() -> None:
    waited, late = make_policy(), make_policy(answer_delay=0.32)
    for simulator in (waited, late):
        simulator.AdvanceTo(0.3)
    assert read_policy(waited, "push_command")[0] == 1 and read_policy(late, "push_command")[0] == 0
    late.AdvanceTo(0.4)
    np.testing.assert_array_equal(
        read_policy(late, "push_command"), read_policy(waited, "push_command")
    )


def test_a_poke_for_an_object_that_moved_meanwhile_is_passed_over() -> None:
    simulator = make_policy(answer_delay=0.32)
    simulator.AdvanceTo(0.2)
    policy = simulator.get_system().GetSubsystemByName("policy")
    context = policy.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    policy.GetInputPort("object_pose").FixValue(context, POSE + [0.03, 0.0, 0.0])
    simulator.AdvanceTo(0.5)
    assert read_policy(simulator, "push_command")[0] == 0
    simulator.AdvanceTo(1.0)
    there = make_policy()
    context = (
        there.get_system()
        .GetSubsystemByName("policy")
        .GetMyMutableContextFromRoot(there.get_mutable_context())
    )
    policy = there.get_system().GetSubsystemByName("policy")
    policy.GetInputPort("object_pose").FixValue(context, POSE + [0.03, 0.0, 0.0])
    there.AdvanceTo(0.1)
    np.testing.assert_array_equal(
        read_policy(simulator, "push_command"), read_policy(there, "push_command")
    )


def test_a_policy_that_cannot_choose_says_so() -> None:
    def push_rule(poke) -> bool:
        raise RuntimeError("no such arm")

    simulator = make_policy(answer_delay=0.1, push_rule=push_rule)
    simulator.AdvanceTo(1.0)
    assert read_policy(simulator, "message") == "RuntimeError: no such arm"
    assert read_policy(simulator, "push_command")[0] == 0


def test_a_dropped_diagram_leaves_no_thread_behind() -> None:
    go = Event()

    def push_rule(poke) -> bool:
        return go.wait(LONGEST)

    simulator = make_policy(answer_delay=None, push_rule=push_rule)
    simulator.AdvanceTo(0.2)
    kept = ref(simulator.get_system())
    (thread,) = simulator.get_system().GetSubsystemByName("policy")._worker._pool._threads
    assert thread.is_alive()
    del simulator
    gc.collect()
    assert kept() is None, "while its worker is still at work"
    go.set()
    thread.join(LONGEST)
    assert not thread.is_alive()


GOAL_OBJ = make_block(12)
RULES = GoalRules(
    PushConstraints(SupportSurface.rectangle((0.0, 0.0), (1.0, 1.0))),
    ContactOptions(Pusher(speed=0.1, clearance=0.005), (0.008, 0.3)),
    max_pushes=12,
)


def make_goal_run(**options) -> Run:
    truth = CellParameters.by_part(GOAL_OBJ, {1: 0.05, 2: 0.2}, 0.4, 0.4)
    return make_run(GOAL_OBJ, truth, (0.1, 0.05, 0.6), RULES, **options)


def is_over(status) -> bool:
    return status.mode in (ContactPointMode.REACHED, ContactPointMode.FAILED)


def test_a_controller_in_lockstep_reaches_its_goal_the_same_way_every_time() -> None:
    runs = [make_goal_run(answer_delay=0.3) for _ in range(2)]
    ends = [(run.go_on_until(is_over), run.pose) for run in runs]
    assert [status.mode for status, _ in ends] == [ContactPointMode.REACHED] * 2
    np.testing.assert_array_equal(ends[0][1], ends[1][1])
    np.testing.assert_equal(asdict(ends[0][0]), asdict(ends[1][0]))  # NaN is NaN


def test_a_controller_in_real_time_reaches_its_goal() -> None:
    run = make_goal_run(answer_delay=None)
    run.simulator.set_target_realtime_rate(5.0)
    assert run.go_on_until(is_over).mode == ContactPointMode.REACHED


def test_a_decision_for_an_object_that_went_out_of_sight_is_passed_over() -> None:
    run = make_goal_run(answer_delay=0.3)
    while (state := get_state(run.context(run.controller))).request is None:
        run.simulator.AdvanceTo(run.simulator.get_context().get_time() + 0.05)
    asked = state.request.time
    run.context(run.cover).get_mutable_numeric_parameter(0).SetFromVector(
        [asked + 0.1, asked + 3.0]
    )
    run.simulator.AdvanceTo(asked + 2.9)
    assert run.status.mode == ContactPointMode.LOST and run.status.pushes == 0
    assert run.go_on_until(is_over).mode == ContactPointMode.REACHED


def test_a_controller_whose_worker_raises_fails_and_says_why() -> None:
    def refuse(push) -> bool:
        raise RuntimeError("no such arm")

    rules = replace(RULES, constraints=replace(RULES.constraints, push_rule=refuse))
    run = make_run(
        GOAL_OBJ, CellParameters.uniform(GOAL_OBJ), (0.1, 0.05, 0.6), rules, answer_delay=0.2
    )
    status = run.go_on_until(is_over, 5.0)
    assert status.mode == ContactPointMode.FAILED
    assert status.reason == "No decision could be made: RuntimeError: no such arm."


class PushingOne:
    """A planner of several objects that always wants the same push."""

    def decide(self, poses, belief, steps) -> SceneDecision:
        push = Push((-0.2, 0.0), (0.05, 0.0), 1.0, 0.008)
        return SceneDecision(SceneAction.PUSH, "go on", push=push, body=0)


@pytest.mark.parametrize(
    ("seen_later", "commanded"), [((0.0, 2 * np.pi), True), ((0.02, 0.0), False)]
)
def test_a_decision_for_several_objects_is_taken_late_too(seen_later, commanded) -> None:
    """It counts although a heading jumps by a turn meanwhile, but not where an object moves."""
    objects = [make_block(12), make_block(12)]
    loop = JointLoop(PushingOne(), Belief.of_even_objects(objects, sample_count=0))
    controller = SceneController(loop, answer_delay=0.3)
    simulator = Simulator(controller)
    context = simulator.get_mutable_context()
    port = controller.GetInputPort("object_poses")
    poses = np.array([[0.0, 0.0, 0.1], [0.3, 0.0, 3.0]])
    port.FixValue(context, poses.ravel())
    controller.GetInputPort("push_status").FixValue(context, AbstractValue.Make(PushStatus()))

    def get_command() -> float:
        return controller.GetOutputPort("push_command").Eval(context)[0]

    while get_state(context).request is None:
        simulator.AdvanceTo(context.get_time() + 0.05)
    asked = get_state(context).request.time
    dx, turn = seen_later
    port.FixValue(context, (poses + [[0.0, 0.0, 0.0], [dx, 0.0, turn]]).ravel())
    simulator.AdvanceTo(asked + 0.26)
    assert get_command() == 0
    simulator.AdvanceTo(asked + 0.31)
    assert get_command() == float(commanded)
