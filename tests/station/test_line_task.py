"""The whole station pushes an object along a line on the table, with a finger that is steered."""

import numpy as np
import pytest

from gridpush_drake.errors import ScenarioError
from gridpush_drake.geometry.se2 import transform, wrap_angle
from gridpush_drake.station.scene.resolve import resolve
from gridpush_drake.station.schema.scenario_file import read_scenario
from gridpush_drake.station.tasks.line_task import LineKind, LineTask
from gridpush_drake.station.tasks.task import TaskStatus


@pytest.mark.slow
def test_goes_along_the_line_to_its_end():
    scenario = read_scenario("line")
    record = LineTask(scenario).run(1)
    assert record.status == TaskStatus.REACHED, record.message
    # by the true pose: the tolerance, and what a pose that is seen may be off
    assert record.distance < scenario.follow.position_tolerance + 0.002
    assert record.turn < scenario.follow.angle_tolerance + np.radians(1)
    assert record.limit_report.ok, record.limit_report
    assert record.calc_rms() < 0.02
    # it came by every point of the line
    for point in scenario.line.points:
        assert np.linalg.norm(record.way - point, axis=1).min() < 0.02
    kind = LineKind()
    assert kind.summarize(record)["done"]
    assert "data:image/svg+xml" in kind.make_report(record)


def test_the_path_begins_at_the_object_and_turns_with_the_line():
    resolved = resolve(read_scenario("line"))
    obj, scenario = resolved.obj, resolved.scenario
    scenario.line.points = [[0.6, -0.1], [0.5, 0.0], [0.4, 0.0]]
    path = LineTask.make_path(obj, scenario)
    assert path.speed == scenario.follow.speed
    assert path.poses[0] == pytest.approx(scenario.object_pose)
    middle = obj.p_BC.mean(axis=0)[None]
    assert transform(path.poses[1:], middle)[:, 0] == pytest.approx(np.array(scenario.line.points))
    # from where it lies to the last stretch the line turns from about 84 degrees to 180
    way = np.array([0.6, -0.1]) - transform(path.poses[0], middle)[0]
    turned = np.pi - np.arctan2(*way[::-1])
    assert wrap_angle(path.poses[-1, 2] - path.poses[0, 2]) == pytest.approx(turned)
    # a single point is a straight line, on which nothing turns
    scenario.line.points = [[0.6, 0.1]]
    straight = LineTask.make_path(obj, scenario)
    assert straight.poses[:, 2] == pytest.approx(scenario.object_pose[2])


@pytest.mark.parametrize(
    ("points", "posts", "message"),
    [
        ([], [], r"line: line\.points: empty; expected a list of places \[x, y\] \(m\)"),
        ([[0.6, 0.1], [0.6, 0.1]], [], r"line\.points: points must be finite, and no two"),
        ([[0.6, 0.0], [1.6, 0.0]], [], r"the pose at line\.points\[1\] is .* the table's edge"),
        ([[0.6, 0.0]], [[0.6, 0.01]], r"the pose at line\.points\[0\] is .* to an obstacle"),
    ],
)
def test_a_line_that_cannot_be_followed_is_refused_before_anything_moves(points, posts, message):
    scenario = read_scenario("line")
    scenario.line.points = points
    scenario.posts = [{"position": position} for position in posts]
    with pytest.raises(ScenarioError, match=message):
        LineKind().check(resolve(type(scenario)(**dict(scenario)), "line"))


def test_a_place_that_is_no_pair_of_numbers_is_refused():
    scenario = read_scenario("line")
    scenario.line.points = [[0.6, 0.1, 1.57]]
    with pytest.raises(ScenarioError, match=r"line\.points\[0\] is .*; expected"):
        scenario.check()
