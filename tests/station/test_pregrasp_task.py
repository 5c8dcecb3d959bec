"""The whole story in the full station: a robot, an object it knows nothing about, and a table's edge."""

import pytest

from gridpush_drake.cli.demo_tasks import PreGraspDemo
from gridpush_drake.errors import PlanningError, ScenarioError
from gridpush_drake.station.pregrasp_task import LIFTED_SHARE, PreGraspTask
from gridpush_drake.station.robot import make_robot_directives
from gridpush_drake.station.scenario import PushScenario
from gridpush_drake.station.task import TaskStatus


def test_a_scene_without_a_gripper_is_refused():
    with pytest.raises(ScenarioError, match="gripper"):
        PreGraspTask(PushScenario())


def test_an_object_too_thick_for_the_gripper_is_refused():
    scenario = PreGraspDemo().make_scenario()
    scenario.object, scenario.object_height = "open_book", 0.085
    with pytest.raises(PlanningError, match=r"0\.085 m thick; expected at most .* 0\.08 m"):
        PreGraspTask(scenario)


@pytest.mark.slow
def test_a_panda_lifts_the_hammer_with_its_own_hand():
    scenario = PreGraspDemo().make_scenario()
    scenario.directives = make_robot_directives("panda", grasping=True)
    task = PreGraspTask(scenario)
    record = task.run()
    assert record.status == TaskStatus.HELD, record.message
    assert record.raised > LIFTED_SHARE * scenario.pregrasp.lift
    assert record.limit_report.ok, record.limit_report
    assert record.limit_report.tracking_error < 2.5e-3
