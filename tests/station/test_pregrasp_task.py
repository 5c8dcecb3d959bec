"""The whole story in the full station: a robot, an object it knows nothing about, and a table's edge."""

import pytest

from gridpush_drake.cli.demo_tasks import PreGraspDemo
from gridpush_drake.errors import PlanningError, ScenarioError
from gridpush_drake.station.pregrasp_task import PreGraspTask
from gridpush_drake.station.scenario import PushScenario


def test_a_scene_without_a_gripper_is_refused():
    with pytest.raises(ScenarioError, match="gripper"):
        PreGraspTask(PushScenario())


def test_an_object_too_thick_for_the_gripper_is_refused():
    scenario = PreGraspDemo().make_scenario()
    scenario.object, scenario.object_height = "open_book", 0.085
    with pytest.raises(PlanningError, match=r"0\.085 m thick; expected at most .* 0\.08 m"):
        PreGraspTask(scenario)
