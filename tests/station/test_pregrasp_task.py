"""The whole story in the full station: a robot, an object it knows nothing about, and a table's edge."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from gridpush_drake.errors import ScenarioError, StationError
from gridpush_drake.identification.model import Model
from gridpush_drake.multibody.parser import find_models
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.belief import Belief
from gridpush_drake.planning.pregrasp.goals import PreGraspGoal
from gridpush_drake.planning.pregrasp.grasp.side_grasp import find_side_grasps
from gridpush_drake.station.robot.robot import make_robot_directives
from gridpush_drake.station.schema.scenario import PushScenario
from gridpush_drake.station.schema.scenario_file import read_scenario
from gridpush_drake.station.tasks.pregrasp_kind import PreGraspKind
from gridpush_drake.station.tasks.pregrasp_task import LIFTED_FRACTION, PreGraspTask
from gridpush_drake.station.tasks.task import TaskStatus
from gridpush_drake.systems.base.messages import PreGraspMode, PreGraspStatus


def test_a_scene_without_a_gripper_is_refused():
    with pytest.raises(ScenarioError, match="gripper"):
        PreGraspTask(PushScenario())


def test_an_object_too_thick_for_the_gripper_is_refused():
    scenario = PreGraspKind().make_scenario()
    scenario.object, scenario.object_height = "open_book", 0.085
    with pytest.raises(
        ScenarioError, match=r"object_height: .* 0\.085 m thick; expected at most .* 0\.08 m"
    ):
        PreGraspTask(scenario)


@pytest.fixture(scope="module")
def task():
    """The task of lifting a toolbox."""
    scenario = read_scenario(find_models() / "scenarios/grasp_heavy.yaml")
    scenario.object = "toolbox"
    return PreGraspTask(scenario)


@pytest.mark.slow
def test_says_whether_an_object_could_be_held(task, monkeypatch):
    """Told of its masses and frictions, the planner sees a way for the toolbox, and none for one of lead."""
    assert task.could_hold()
    truth = task.station.truth
    monkeypatch.setattr(task.station, "truth", replace(truth, mass=20.0 * truth.mass))
    assert not task.could_hold()
    monkeypatch.setattr(task.station, "truth", None)
    with pytest.raises(StationError, match="nothing is simulated"):
        task.could_hold()


def test_a_toolbox_is_taken_by_its_handle_only_where_the_pads_hold_it_there(task):
    """The fingers get in only along the handle; with all of the weight to one side they would be pried apart."""
    obj, pose, along = task.obj, np.array([0.451, 0.075, 0.281]), np.array([0.0, 0.095])
    part = min(task.planner.parts, key=lambda part: np.linalg.norm(part.p_BG - along))
    goal = PreGraspGoal(pose, part, 0.0, 0.0, 0.0, np.array([1.0, 0.0]))
    assert any(
        np.linalg.norm(one.p_BG - part.p_BG) < 0.03
        for one in find_side_grasps(obj, pose, task.surface)
    )
    for heavy_bar, taken in ((1.0, False), (200.0, True)):
        mass = np.where(obj.p_BC[:, 1] > 0.06, heavy_bar, 1.0)
        params = CellParameters(mass * 3.4 / mass.sum(), np.full(obj.n, 0.35))
        masses = Belief.of_parameters(Model(obj, params)).masses
        assert task.planner.limits.can_grasp(goal, masses) == taken


def test_what_stays_on_the_table_is_not_lifted(task, monkeypatch):
    record = task.make_record()
    record.last, record.raised = PreGraspStatus(mode=PreGraspMode.HOLDING), 0.001
    monkeypatch.setattr(task, "read", lambda name: np.zeros(3))
    assert task.judge(record, SimpleNamespace())[0] == "not_lifted"


@pytest.mark.slow
def test_a_panda_lifts_the_hammer_with_its_own_hand():
    scenario = PreGraspKind().make_scenario()
    scenario.directives = make_robot_directives("panda", grasping=True)
    task = PreGraspTask(scenario)
    record = task.run()
    assert record.status == TaskStatus.HELD, record.message
    assert record.raised > LIFTED_FRACTION * scenario.pregrasp.lift
    assert record.limit_report.ok, record.limit_report
    assert record.limit_report.tracking_error < 2.5e-3
