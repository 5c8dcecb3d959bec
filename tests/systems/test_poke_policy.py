"""When pokes are commanded, and which."""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.common.value import AbstractValue
from pydrake.systems.analysis import Simulator

from gridpush_drake.dynamics.push import Push
from gridpush_drake.errors import PushError
from gridpush_drake.geometry.se2 import transform_shape
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.exploration import RandomPokeOptions, RandomPokes
from gridpush_drake.planning.world import SimulatedWorld
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.systems.base.messages import PushCommand, PushPhase, PushStatus
from gridpush_drake.systems.control.poke_policy import LOGGING_TIME, PokePolicy, make_command
from tests.helpers.poke_diagram import FINGER_RULES, REGION, make_poke_diagram
from tests.helpers.shapes import make_shape

OPTIONS = RandomPokeOptions()
POSE = np.array([0.1, -0.05, 0.7])


def choose(obj: GridObject, number: int, seed: int, pose=POSE) -> PushCommand:
    """The command for what the strategy itself proposes."""
    pokes = RandomPokes(OPTIONS, REGION, seed, number)
    proposal = pokes.propose(Model(obj), pose, FINGER_RULES)
    return make_command(number, proposal.push, OPTIONS.speed)


class Bench:
    """The policy with hand-made inputs."""

    def __init__(self, seed: int = 0, style: RandomPokeOptions = OPTIONS, **options) -> None:
        self.obj = make_shape("claw_hammer", 30)
        pokes = RandomPokes(style, REGION, seed)
        self.policy = PokePolicy(Model(self.obj), pokes, FINGER_RULES, **options)
        self.simulator = Simulator(self.policy)
        self.context = self.simulator.get_mutable_context()
        self.say(PushStatus(), POSE)

    def say(self, status: PushStatus, pose=POSE) -> PushCommand:
        """What it commands after a while."""
        self.policy.GetInputPort("status").FixValue(self.context, AbstractValue.Make(status))
        self.policy.GetInputPort("object_pose").FixValue(self.context, np.asarray(pose))
        self.simulator.AdvanceTo(self.context.get_time() + 0.11)
        return PushCommand.from_vector(self.policy.GetOutputPort("push_command").Eval(self.context))


def test_commands_when_the_executor_is_ready_and_only_then():
    bench = Bench(seed=4, num_pushes=2)
    first = bench.say(PushStatus())
    assert first == choose(bench.obj, 1, 4)
    for phase in (PushPhase.APPROACHING, PushPhase.PUSHING):
        assert bench.say(PushStatus(phase, 1)) == first
    moved = POSE + [0.03, 0.0, 0.2]
    second = bench.say(PushStatus(command_id=1, executed=1), moved)
    assert second == choose(bench.obj, 2, 4, moved)
    assert bench.say(PushStatus(command_id=2, executed=2), moved) == second, "done"


def test_draws_another_one_when_refused():
    bench = Bench(num_pushes=1)
    first = bench.say(PushStatus())
    second = bench.say(PushStatus(command_id=1, refused=1, reason="out of reach"))
    assert second.command_id == 2 and second != replace(first, command_id=2)
    assert bench.say(PushStatus(command_id=2, executed=1, refused=1)) == second


def test_waits_until_the_object_is_seen():
    bench = Bench()
    first = bench.say(PushStatus())
    assert bench.say(PushStatus(command_id=1, executed=1), (np.nan,) * 3) == first
    assert bench.say(PushStatus(command_id=1, executed=1)).command_id == 2


def test_looks_on_where_no_candidate_fits():
    bench = Bench(style=RandomPokeOptions(candidates=5))
    first = bench.say(PushStatus())
    far = (3.0, 0.0, 0.0)
    assert bench.say(PushStatus(command_id=1, executed=1), far) == first
    assert bench.say(PushStatus(command_id=1, executed=1)).command_id == 2, "the object came back"


def test_test_pushes_follow_in_their_own_style():
    bench = Bench(num_pushes=1, test_pushes=1, test_distance=0.05)
    bench.say(PushStatus())
    test = bench.say(PushStatus(command_id=1, executed=1))
    assert test.command_id == 2 and test.distance == pytest.approx(0.05 + OPTIONS.clearance)
    assert bench.say(PushStatus(command_id=2, executed=2)) == test


def test_a_poke_that_was_not_logged_is_made_up_for_but_not_for_ever():
    bench = Bench(num_pushes=2)
    log = bench.policy.GetInputPort("push_log")
    seen = make_observed_pushes(bench.obj)

    def tell(executed, logged):
        log.FixValue(bench.context, AbstractValue.Make(PushLog(tuple(seen[:logged]))))
        status = PushStatus(command_id=executed, executed=executed)
        first = bench.say(status).command_id
        # it may be logged a little later
        bench.simulator.AdvanceTo(bench.context.get_time() + LOGGING_TIME)
        return first, bench.say(status).command_id

    assert bench.say(PushStatus()).command_id == 1
    assert tell(1, 0) == (2, 2)
    # two were made, and one of them is missing
    assert tell(2, 1) == (2, 3)
    assert tell(3, 1) == (3, 4)
    # twice as many as wanted, and never more
    assert tell(4, 1) == (4, 4)
    # all there
    other = Bench(num_pushes=2)
    other.policy.GetInputPort("push_log").FixValue(
        other.context, AbstractValue.Make(PushLog(tuple(seen)))
    )
    other.say(PushStatus(command_id=1, executed=1))
    status = PushStatus(command_id=2, executed=2)
    other.say(status)
    other.simulator.AdvanceTo(other.context.get_time() + LOGGING_TIME)
    assert other.say(status).command_id == 2


def make_observed_pushes(obj):
    """Two pushes of an object, as they are written down."""
    world = SimulatedWorld(Model(obj, CellParameters.uniform(obj)), np.zeros(3))
    pushes = []
    for place in (0.05, 0.15):
        world.put(np.zeros(3))
        pushes.append(
            world.execute(Push.on_outline(obj, place, 0.0, 0.05, radius=0.008, speed=0.05))
        )
    return pushes


@pytest.mark.slow
def test_executor_takes_the_pushes_and_a_clone_goes_on_alike():
    obj = make_shape("claw_hammer", 12)
    truth = CellParameters.uniform(obj, 1.0, 0.4, 0.3)
    parts = make_poke_diagram(
        obj,
        truth,
        pokes=3,
        seed=2,
        max_learning_pushes=0,
        style=RandomPokeOptions(distance=(0.05, 0.08), speed=0.06),
    )
    simulator = Simulator(parts.diagram)
    simulator.AdvanceTo(6.0)
    clone = Simulator(parts.diagram, simulator.get_context().Clone())
    ends = []
    for run in (simulator, clone):
        run.AdvanceTo(20.0)
        status = parts.executor.GetOutputPort("status").Eval(
            parts.executor.GetMyContextFromRoot(run.get_context())
        )
        assert (status.executed, status.refused, status.command_id) == (3, 0, 3)
        ends.append(
            parts.world.GetOutputPort("pose").Eval(
                parts.world.GetMyContextFromRoot(run.get_context())
            )
        )
    np.testing.assert_array_equal(*ends)
    assert REGION.keep_in.contains(transform_shape(ends[0], obj.outline))


def test_bad_arguments_are_refused():
    obj = make_shape("square", 9)
    for options in ({"num_pushes": -1}, {"test_pushes": -1}, {"period": 0.0}):
        with pytest.raises(PushError, match=next(iter(options))):
            PokePolicy(Model(obj), RandomPokes(), **options)
