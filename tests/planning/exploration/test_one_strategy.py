"""A robot and the benches that measure it ask the very same strategies for pokes."""

import numpy as np
import pytest

from gridpush_drake.bench.pregrasp.exploring import explore
from gridpush_drake.bench.truth.design import _choose_push
from gridpush_drake.dynamics.push import Push
from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.belief import Belief
from gridpush_drake.planning.exploration import DesignedPokes, RandomPokes
from gridpush_drake.planning.goal.learning_poke import choose_poke_within
from gridpush_drake.planning.goal.next_push import GoalRules
from gridpush_drake.planning.pregrasp.planner import PreGraspPlanner
from gridpush_drake.planning.support_surface import SupportSurface
from gridpush_drake.planning.world import SimulatedWorld
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.station.schema.scenario import PushScenario
from gridpush_drake.station.simulated.push_station import MakePushStation
from gridpush_drake.station.tasks.identify_task import make_policy

HERE = np.zeros(3)
TABLE = SupportSurface.rectangle((0.0, 0.0), (1.0, 0.8))
OBJ = GridObject.from_outline([[0, 0], [0.12, 0], [0.12, 0.06], [0, 0.06]], max_cells=8, name="box")
EVEN = CellParameters.uniform(OBJ)


class AskedError(Exception):
    """The strategy was asked for a poke."""


def poke_for_a_goal():
    world = SimulatedWorld(Model(OBJ, EVEN), HERE)
    log = PushLog((world.execute(Push.on_outline(OBJ, 0.03, 0.0, 0.03, radius=0.008, speed=0.03)),))
    found = identify(Model(OBJ), log, regime="quasi_static")
    choose_poke_within(GoalRules(), HERE, found, log, np.array([0.1, 0.0, 0.0]))


def poke_in_the_game():
    pytest.importorskip("gymnasium")
    from gridpush_drake.bench.games.environments import PLANNER_EPISODES, EnvironmentWorld
    from gridpush_drake.gym import PushEnvironment

    PLANNER_EPISODES["Explore"](EnvironmentWorld(PushEnvironment("Explore"), 3), 3)


@pytest.mark.parametrize(
    "poke",
    [
        pytest.param(poke_for_a_goal, id="robot that pushes to a goal"),
        pytest.param(
            lambda: PreGraspPlanner(OBJ, TABLE).propose_poke(Belief.of_prior(OBJ), HERE),
            id="robot that grasps, and its benches",
        ),
        pytest.param(lambda: explore(OBJ, EVEN, "box", 0, 1), id="bench of exploration"),
        pytest.param(lambda: _choose_push(Belief.of_prior(OBJ), 0.008), id="bench of truths"),
        pytest.param(poke_in_the_game, id="bench of games"),
    ],
)
def test_pokes_by_design_are_those_of_one_strategy(poke, monkeypatch):
    def ask(self, belief, pose, rules):
        raise AskedError

    monkeypatch.setattr(DesignedPokes, "propose", ask)
    with pytest.raises(AskedError):
        poke()


def test_a_station_s_random_pokes_are_those_of_the_strategy():
    policy = make_policy(MakePushStation(PushScenario()))
    assert type(policy.pokes) is RandomPokes
    assert policy.rules.finger_region is not None and policy.rules.push_rule is not None
