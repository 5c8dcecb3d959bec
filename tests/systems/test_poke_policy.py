"""Which pushes are chosen, and when they are commanded."""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.common.value import AbstractValue
from pydrake.systems.analysis import Simulator
from shapely import Point, Polygon, box
from shapely.affinity import affine_transform

from gridpush_drake.dynamics.push import Push
from gridpush_drake.errors import PushError
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import find_shipped_object
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.world import SimulatedWorld
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.systems.messages import PushCommand, PushPhase, PushStatus
from gridpush_drake.systems.poke_policy import (
    LOGGING_TIME,
    PokePolicy,
    PokeRegion,
    RandomPokeOptions,
    choose_poke,
    draw_poke,
    fits,
    predict_poke,
)
from tests.helpers.poke_diagram import REGION, make_poke_diagram
from tests.helpers.shapes import make_shape

STYLE = RandomPokeOptions()
POSE = np.array([0.1, -0.05, 0.7])


def choose(
    obj: GridObject,
    number: int = 1,
    seed: int = 0,
    pose=POSE,
    style=STYLE,
    region=REGION,
    **options,
):
    return choose_poke(Model(obj), pose, number, seed, style, region, **options)


def place(obj: GridObject, pose) -> Polygon:
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return affine_transform(obj.outline, [c, -s, s, c, pose[0], pose[1]])


@pytest.mark.parametrize("name", ["claw_hammer", "pliers", "toolbox"])
def test_chosen_pushes_fit_and_stay_in_bounds(name):
    obj = GridObject.from_yaml(find_shipped_object(name))
    for number in range(1, 9):
        command, _ = choose(obj, number)
        gap = place(obj, POSE).distance(Point(command.start)) - STYLE.tip_radius
        assert gap == pytest.approx(STYLE.clearance, rel=1e-4)
        assert command.command_id == number and command.speed == STYLE.speed
        assert STYLE.distance[0] <= command.distance - STYLE.clearance <= STYLE.distance[1]
        assert REGION.workspace.contains(Point(command.start)) and REGION.workspace.contains(
            Point(command.end)
        )
        last = predict_poke(Model(obj), POSE, command, STYLE)[-1]
        assert REGION.keep_in.contains(place(obj, last))
        moved = np.linalg.norm(obj.cells_at(last) - obj.cells_at(POSE), axis=1).mean()
        assert moved >= STYLE.min_motion


def test_draw_depends_on_seed_number_and_attempt_alone():
    obj = make_shape("claw_hammer", 40)
    one = draw_poke(obj, POSE, 3, 5, 7, STYLE)
    choose(obj, 1), choose(obj, 2, seed=5)
    assert draw_poke(obj, POSE, 3, 5, 7, STYLE) == one
    others = [draw_poke(obj, POSE, *key, STYLE) for key in ((4, 5, 7), (3, 6, 7), (3, 5, 8))]
    assert len({(other.x, other.y) for other in (one, *others)}) == 4
    command, attempts = choose(obj, 3, 5)
    assert command == draw_poke(obj, POSE, 3, 5, attempts - 1, STYLE)


def test_pushes_go_inwards_within_the_slant():
    obj = make_shape("square", 25)
    slants = []
    for attempt in range(200):
        command = draw_poke(obj, np.zeros(3), 1, 0, attempt, STYLE)
        nearest = np.clip(command.start, -0.05, 0.05)
        inward = (nearest - command.start) / np.linalg.norm(nearest - command.start)
        slants.append(
            np.arccos(np.clip(inward @ (command.end - command.start) / command.distance, -1, 1))
        )
    assert max(slants) <= STYLE.slant + 1e-9 and max(slants) > 0.8 * STYLE.slant


def test_notch_narrower_than_the_tip_is_left_alone():
    """A U with a slot of 2 cm between arms: a tip of 8 mm radius with 8 mm clearance does not fit, one of 2 mm does."""
    slot = box(-0.01, -0.01, 0.01, 0.06)
    obj = GridObject.from_outline(box(-0.05, -0.05, 0.05, 0.05).difference(slot), max_cells=40)
    thin = RandomPokeOptions(tip_radius=0.002, clearance=0.002)
    starts = {
        style: [
            command.start
            for attempt in range(300)
            if fits(
                obj,
                np.zeros(3),
                command := draw_poke(obj, np.zeros(3), 1, 0, attempt, style),
                style,
                REGION,
            )
        ]
        for style in (STYLE, thin)
    }
    assert not any(slot.contains(Point(start)) for start in starts[STYLE])
    assert any(slot.contains(Point(start)) for start in starts[thin])


def test_workspace_and_reach_are_kept():
    obj = make_shape("square", 25)
    left = PokeRegion(box(-1, -1, 0, 1), REGION.keep_in)
    for number in range(1, 6):
        command, _ = choose(obj, number, pose=np.zeros(3), region=left)
        assert max(command.start[0], command.end[0]) <= 0
        command, _ = choose(
            obj, number, pose=np.zeros(3), reach=lambda command: command.start[1] > 0
        )
        assert command.start[1] > 0
    assert choose(obj, reach=lambda command: False) == (None, STYLE.candidates)
    assert choose(obj, pose=(3.0, 0.0, 0.0))[0] is None, "beyond the workspace"


def test_object_at_the_border_is_pushed_back():
    """Nearly all pushes would take it out; those chosen do not, or at least lead towards the middle."""
    obj = make_shape("square", 25)
    region = PokeRegion(box(-1, -1, 1, 1), box(-0.2, -0.2, 0.2, 0.2))
    for number in range(1, 9):
        pose = np.array([0.145, 0.145, 0.0])
        command, _ = choose(obj, number, pose=pose, region=region)
        last = predict_poke(Model(obj), pose, command, STYLE)[-1]
        assert region.keep_in.covers(place(obj, last))
    outside = np.array([0.4, 0.0, 0.0])
    command, attempts = choose(obj, pose=outside, region=region)
    last = predict_poke(Model(obj), outside, command, STYLE)[-1]
    assert attempts == STYLE.candidates
    assert np.linalg.norm(last[:2]) < np.linalg.norm(outside[:2]) - 0.03


class Bench:
    """The policy with hand-made inputs."""

    def __init__(self, **options) -> None:
        self.obj = make_shape("claw_hammer", 30)
        self.policy = PokePolicy(Model(self.obj), REGION, **options)
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
    assert first == choose(bench.obj, 1, 4)[0]
    for phase in (PushPhase.APPROACHING, PushPhase.PUSHING):
        assert bench.say(PushStatus(phase, 1)) == first
    moved = POSE + [0.03, 0.0, 0.2]
    second = bench.say(PushStatus(command_id=1, executed=1), moved)
    assert second == choose(bench.obj, 2, 4, moved)[0]
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
    assert test.command_id == 2 and test.distance == pytest.approx(0.05 + STYLE.clearance)
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
    assert REGION.keep_in.contains(place(obj, ends[0]))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"distance": (0.0, 0.1)}, "distance"),
        ({"distance": (0.2, 0.1)}, "distance"),
        ({"speed": 0.0}, "speed"),
        ({"slant": 1.6}, "slant"),
        ({"tip_radius": -1.0}, "tip_radius"),
        ({"clearance": -0.001}, "clearance"),
        ({"min_motion": np.nan}, "min_motion"),
        ({"candidates": 0}, "candidates"),
    ],
)
def test_bad_styles_are_refused(options, message):
    with pytest.raises(PushError, match=message):
        RandomPokeOptions(**options)


def test_bad_arguments_are_refused():
    obj = make_shape("square", 9)
    for options in ({"num_pushes": -1}, {"test_pushes": -1}, {"period": 0.0}):
        with pytest.raises(PushError, match=next(iter(options))):
            PokePolicy(Model(obj), REGION, **options)
