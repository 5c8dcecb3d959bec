"""The whole station pushes an object along a path, with a finger that is steered."""

import numpy as np
import pytest
from shapely import LineString, box

from gridpush_drake.errors import ScenarioError
from gridpush_drake.planning.feedback.follow_options import FollowStatus
from gridpush_drake.planning.feedback.pose_path import PosePath
from gridpush_drake.station.robot.robot import make_robot_directives
from gridpush_drake.station.scene.finger_region import MakeFingerRegion
from gridpush_drake.station.scene.resolve import resolve
from gridpush_drake.station.schema.scenario import PushScenario
from gridpush_drake.station.schema.scenario_file import read_scenario
from gridpush_drake.station.simulated.push_station import MakePushStation
from gridpush_drake.station.tasks.follow_task import FollowRecord, FollowTask, calc_shown_age
from gridpush_drake.station.tasks.registry import TASK_KINDS
from gridpush_drake.station.tasks.task import TaskStatus
from gridpush_drake.systems.control.follow_controller import FollowControlStatus, FollowMode
from tests.helpers.link_bench import LinkBench


@pytest.mark.slow
def test_another_arm_than_the_scenario_s_goes_through_the_slalom():
    scenario = read_scenario("slalom")
    scenario.directives = make_robot_directives("panda", grasping=False)
    task = FollowTask(scenario)
    record = task.run(1)
    assert record.status == TaskStatus.REACHED, record.message
    # by the true pose: the tolerance, and what a pose that is seen may be off
    assert record.distance < scenario.follow.position_tolerance + 0.002
    assert record.turn < scenario.follow.angle_tolerance + np.radians(1)
    assert record.limit_report.ok, record.limit_report
    assert 0 < record.limit_report.force < scenario.safety.force
    assert record.calc_clearance() > 0.003
    assert record.calc_rms() < 0.02
    # it wound through: beyond the posts on either side
    assert np.ptp(record.way[:, 0]) > 0.03
    kind = TASK_KINDS["follow"]
    summary = kind.summarize(record)
    assert summary["done"]
    assert "data:image/svg+xml" in kind.make_report(record)
    # a second run of the same station goes alike
    assert task.run(1).pose == pytest.approx(record.pose)


@pytest.mark.slow
def test_goes_through_the_slalom_over_a_link_with_decisions_that_take_time():
    scenario = read_scenario("slalom")
    scenario.simulation.answer_delay = 0.05
    bench = LinkBench(resolve(scenario), FollowTask)
    record = bench.task.run(1, drive=bench.link)
    assert record.status == TaskStatus.REACHED, record.message
    assert record.distance < scenario.follow.position_tolerance + 0.002
    assert record.calc_clearance() > 0
    assert record.calc_rms() < 0.01
    # the joints keep up with the steered finger, whose height stays as it should be
    assert record.limit_report.tracking_error < 0.006
    assert record.limit_report.force < 0.5 * scenario.safety.force


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"pose": [0.66, 0.18, 1.57]}, r"goal.pose is .* nearer than 0.01 m to an obstacle"),
        ({"pose": [0.6, 0.6, 1.57]}, r"goal.pose is .* nearer than 0.03 m to the table's edge"),
        ({"speed": 0.3}, r"follow.speed is 0.3 m/s; expected at most follow.finger_speed, 0.1"),
        (
            {"path": [[0.58, -0.3, 1.57], [0.66, -0.1, 1.57], [0.6, 0.3, 1.57]]},
            r"follow.path\[1\] is .* to an obstacle",
        ),
    ],
)
def test_what_cannot_be_followed_is_refused_before_anything_moves(changes, message):
    scenario = read_scenario("slalom")
    scenario.goal.pose = changes.get("pose", scenario.goal.pose)
    scenario.follow.speed = changes.get("speed", scenario.follow.speed)
    scenario.follow.path = changes.get("path")
    with pytest.raises(ScenarioError, match=message):
        FollowTask(scenario)


@pytest.mark.slow
def test_the_rules_are_the_scenarios():
    scenario = read_scenario("slalom")
    scenario.follow.speed = 0.03
    scenario.follow.position_tolerance = 0.004
    task = FollowTask(scenario)
    rules = task.rules
    assert rules.speed == 0.03
    assert rules.options.position_tolerance == 0.004
    assert rules.pokes == 3
    assert rules.path is None
    assert rules.end == pytest.approx(scenario.goal.pose)
    assert len(rules.constraints.obstacles) == 3
    scenario.follow.path = [[0.58, -0.3, 1.57], [0.58, 0.0, 1.57]]
    told = FollowTask(scenario).rules
    assert told.path is not None
    assert told.path.speed == 0.03
    assert told.end == pytest.approx([0.58, 0.0, 1.57])
    scenario.follow.path = [[0.58, -0.3, 1.57], [0.58, -0.3, 1.57]]
    with pytest.raises(ScenarioError, match=r"follow\.path: all poses are the same"):
        FollowTask(scenario)


def test_an_ideal_cameras_pose_is_found_at_the_next_look():
    assert calc_shown_age(PushScenario()) == pytest.approx(0.005)
    late = PushScenario()
    late.camera.kind = "rgbd"
    late.camera.rgbd.output_delay = 0.1
    # the third picture after it, less the one period that an identifier waits beside it
    assert calc_shown_age(late) == pytest.approx(2 / 30 + 0.005)


@pytest.fixture(scope="module")
def slalom():
    """The task of the shipped slalom; nothing changes it."""
    return FollowTask(read_scenario("slalom"))


@pytest.fixture
def record(slalom):
    """A record of the task, as of a run that took the first half of its path."""
    record = slalom.make_record()
    record.paths.append(PosePath([(0.58, -0.3, 1.57), (0.58, 0.0, 1.57)], 0.05))
    for k in range(10):
        record.times.append(20.0 + 0.1 * k)
        record.poses.append(np.array([0.583, -0.3 + 0.01 * k, 1.57]))
        record.tips.append(np.array([0.58, -0.42 + 0.01 * k]))
    record.pose = record.poses[-1]
    record.goal = np.array([0.583, -0.2, 1.57])
    return record


@pytest.mark.slow
def test_a_record_says_how_far_off_the_path_and_how_near_to_a_post_it_was(slalom, record):
    assert isinstance(record, FollowRecord)
    assert record.calc_rms() == pytest.approx(0.003, abs=1e-4)
    assert record.distance == pytest.approx(0.01, abs=1e-4)
    assert record.turn == pytest.approx(0.0, abs=1e-9)
    assert record.steering_time == pytest.approx(0.9)
    assert 0 < record.calc_clearance() < 0.06
    empty = slalom.make_record()
    assert np.isnan(empty.calc_rms())
    assert empty.calc_clearance() == np.inf


def test_the_summary_and_the_words_tell_it(record):
    record.last = FollowControlStatus(FollowMode.FAILED, "It is stuck.", FollowStatus.STUCK, 2)
    record.message = "It is stuck."
    record.limit_report.touched.add(("body", "post_0"))
    kind = TASK_KINDS["follow"]
    summary = kind.summarize(record)
    assert summary["cause"] == "stuck"
    assert summary["path_rms"] == pytest.approx(0.003, abs=1e-4)
    text = "\n".join(kind.describe(summary))
    for words in ("It is stuck.", "3.0 mm from its path", "10.0 mm and 0.0°", "body and post_0"):
        assert words in text
    figure = kind.make_summary(record).figure
    assert len(figure.axes) == 2


@pytest.mark.parametrize("robot", ["panda", "ur5e"])
def test_a_region_that_was_found_in_squares_is_one_piece(robot):
    scenario = PushScenario(directives=make_robot_directives(robot, grasping=False))
    station = MakePushStation(scenario)
    x, y = scenario.workspace.x, scenario.workspace.y
    for inset in (0.0, 0.02):
        region = MakeFingerRegion(station, inset)
        whole = box(x[0], y[0], x[1], y[1]).buffer(-inset)
        assert region.area > 0.9 * whole.area
        # straight across many squares
        assert region.covers(LineString([whole.centroid, (x[0] + 0.05, y[0] + 0.05)]))


@pytest.mark.slow
def test_the_steered_fingers_region_has_no_cracks_where_it_was_found_in_squares():
    scenario = read_scenario("slalom")
    scenario.directives = make_robot_directives("panda", grasping=False)
    region = FollowTask(scenario).rules.constraints.finger_region
    # all of the table's middle but the three posts
    middle = box(0.45, -0.35, 0.72, 0.35)
    assert (middle - region).area == pytest.approx(3 * np.pi * 0.028**2, rel=0.05)
