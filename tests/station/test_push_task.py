"""The whole station pushes objects to goals."""

import numpy as np
import pytest
from pydrake.math import RigidTransform, RotationMatrix

from gridpush_drake.errors import ScenarioError
from gridpush_drake.planning.contact.trial import calc_goal_error
from gridpush_drake.station.schema.scenario import PostConfig, PushScenario
from gridpush_drake.station.tasks.push_task import PushTask
from gridpush_drake.station.tasks.task import TaskStatus


def make_scenario(**fields) -> PushScenario:
    scenario = PushScenario(**fields)
    scenario.pokes.speed = 0.06
    return scenario


def put(task: PushTask, pose) -> None:
    """Somebody lays the object elsewhere."""
    station = task.station
    context = station.plant.GetMyMutableContextFromRoot(task.simulator.get_mutable_context())
    X_WB = RigidTransform(RotationMatrix.MakeZRotation(pose[2]), [pose[0], pose[1], 0.0])
    station.plant.SetFloatingBaseBodyPoseInWorldFrame(context, station.object_in_plant.body, X_WB)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["claw_hammer", "pliers"])
def test_reaches_the_goal(name):
    task = PushTask(make_scenario(object=name))
    record = task.run(1)
    assert record.status == TaskStatus.REACHED, record.message
    assert record.error < 0.02
    assert record.error == pytest.approx(calc_goal_error(record.obj, record.pose, record.goal))
    assert record.limit_report.ok, record.limit_report
    assert 2 <= record.pushes == len(record.log) <= 8
    assert len(record.estimates) >= record.pushes - 1
    assert len([step for step in record.steps if step.push is not None]) == record.pushes
    assert record.last.error == pytest.approx(record.error, abs=1.5e-3)


@pytest.mark.slow
def test_pushes_on_from_where_somebody_put_the_object():
    scenario = make_scenario()
    scenario.goal.pose = [0.6, 0.1, 0.6]
    task, moved = PushTask(scenario), []

    def meddle(status, logged):
        if logged == 1 and status.ready and not moved:
            moved.append(True)
            put(task, (0.55, -0.1, -0.3))

    record = task.run(0, progress=meddle)
    assert moved
    assert record.status == TaskStatus.REACHED, record.message
    assert record.pushes >= 2 and record.error < 0.02


@pytest.mark.slow
def test_ends_when_the_object_falls_and_when_nobody_waits():
    task = PushTask(make_scenario())

    def disturb(status, logged):
        if status.phase == "pushing":
            put(task, (0.6, 1.5, 0.0))

    record = task.run(progress=disturb)
    assert record.status == TaskStatus.LOST and "left the table during push 1" in record.message
    assert np.isnan(record.pose).all()

    def interrupt(status, logged):
        raise KeyboardInterrupt

    record = task.run(progress=interrupt)
    assert (record.status, record.pushes) == (TaskStatus.INTERRUPTED, 0)


@pytest.mark.parametrize(
    ("goal", "says"),
    [
        (
            [0.6, 0.58, 0.0],
            r"0.58, 0\]: there the object is nearer than 0.03 m to the table's edge",
        ),
        ([3.0, 0.0, 0.0], r"goal.pose is \[3, 0, 0\].*or beyond it; expected \[x, y, theta\]"),
        ([0.6, -0.5, 0.0], "there the finger does not come to the object; .* the robot's reach"),
    ],
)
def test_refuses_a_goal_that_is_out_of_the_question(goal, says):
    scenario = make_scenario(object="pliers")
    scenario.goal.pose = goal
    with pytest.raises(ScenarioError, match=says):
        PushTask(scenario)


def test_refuses_a_goal_on_a_post():
    scenario = make_scenario(object="pliers")
    scenario.posts = [PostConfig(position=[0.6, 0.2])]
    scenario.goal.pose = [0.6, 0.2, 0.0]
    with pytest.raises(ScenarioError, match=r"to an obstacle; expected .* clear of all of them"):
        PushTask(scenario)
