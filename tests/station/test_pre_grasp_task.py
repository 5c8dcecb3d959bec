"""The whole story in the full station: a robot, an object it knows nothing about, and a table's edge."""

import numpy as np
import pytest

from gridpush_drake.apps.demo_pre_grasp import make_scenario
from gridpush_drake.errors import PlanningError, ScenarioError
from gridpush_drake.scene.grid_object_state import SetGridObjectPose
from gridpush_drake.scene.scenario import PushScenario
from gridpush_drake.station.pre_grasp_task import HELD, PreGraspTask


def test_a_scene_without_a_gripper_is_refused():
    with pytest.raises(ScenarioError, match="gripper"):
        PreGraspTask(PushScenario())


def test_an_object_without_a_graspable_part_is_refused():
    scenario = make_scenario()
    scenario.object = "open_book"
    with pytest.raises(PlanningError, match="no graspable part"):
        PreGraspTask(scenario)


@pytest.mark.slow
def test_a_stranger_moves_the_hammer_between_pushes_and_it_is_lifted_all_the_same():
    task = PreGraspTask(make_scenario())
    moved = []

    def meddle(status, logged):
        if not moved and status.ready and status.executed == 2:
            station = task.station
            context = station.plant.GetMyMutableContextFromRoot(task.task.simulator.get_mutable_context())
            SetGridObjectPose(station.plant, context, station.object_in_plant, (0.58, -0.12, 0.6))
            moved.append(status.executed)

    record = task.run(progress=meddle)
    assert moved
    assert record.status == HELD, record.message
    away = np.linalg.norm(np.array([step.pose[:2] for step in record.steps]) - (0.58, -0.12), axis=1)
    assert away.min() < 0.01
