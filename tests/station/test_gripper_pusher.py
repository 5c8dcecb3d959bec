"""Arms that push with their closed grippers: what touches, how it is led, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest
import shapely
import yaml
from pydrake.systems.analysis import Simulator

from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.simulation import calc_loads, simulate
from gridpush_drake.errors import ScenarioError, StationError
from gridpush_drake.geometry.se2 import wrap_angle
from gridpush_drake.identification.model import Model
from gridpush_drake.multibody.parser import find_models
from gridpush_drake.planning.support_surface import find_supported
from gridpush_drake.station.control.robot_control import Learning
from gridpush_drake.station.hardware.hardware_station import make_bounds, make_object_watch
from gridpush_drake.station.robot.robot import find_robot, list_robots, make_robot_directives
from gridpush_drake.station.scene.resolve import resolve
from gridpush_drake.station.schema.scenario import PushScenario
from gridpush_drake.station.schema.scenario_file import read_scenario
from gridpush_drake.station.simulated.limit_monitor import LimitMonitor
from gridpush_drake.station.simulated.push_station import MakePushStation
from gridpush_drake.station.tasks.identify_task import IdentifyTask
from gridpush_drake.station.tasks.registry import TASK_KINDS
from gridpush_drake.systems.base.messages import PushCommand
from gridpush_drake.systems.execution.push_executor import find_tool_yaw
from tests.helpers.twin_bench import TwinBench

SIZES = {"panda": (0.022, 0.052), "iiwa14": (0.02, 0.035), "ur5e": (0.02, 0.035)}
"""How thick and how wide the closed fingers are in the robots' models, as low as 30 mm, m."""

CONTACT = 0.42
SLANT = -0.4
"""Where on the hammer's outline it is pushed, m, and how far from straight into it, rad."""

SPEED = 0.03
DISTANCE = 0.08
CLEARANCE = 0.008


def make_scenario(robot="panda", pusher="gripper", **fields):
    directives = make_robot_directives(robot, grasping=False, pusher=pusher)
    return PushScenario(pusher=pusher, directives=directives, **fields)


def make_panda_task(name, scenario_name, grasping):
    """A shipped scenario's task, with a Panda that pushes with its gripper in place of the arm."""
    scenario = read_scenario(scenario_name)
    scenario.directives = make_robot_directives("panda", grasping=grasping, pusher="gripper")
    scenario.pusher = "gripper"
    return TASK_KINDS[name].station(scenario)


@pytest.fixture(scope="module")
def station():
    scenario = make_scenario(base="planar", object_pose=[0.6, 0.0, 0.3])
    return MakePushStation(scenario, learning=Learning(max_pushes=0))


@pytest.mark.parametrize("robot", SIZES)
def test_the_shape_is_that_of_the_robots_own_model(robot):
    resolved = resolve(make_scenario(robot))
    box = shapely.box(*(-np.array(SIZES[robot]) / 2), *(np.array(SIZES[robot]) / 2))
    shape = resolved.robot.shape
    assert shape.area.symmetric_difference(box).area < 1e-3 * box.area
    assert resolved.robot.gripper is None
    assert resolved.obj.prior.push_height == resolved.scenario.finger.push_height


@pytest.mark.slow
def test_a_camera_sees_the_whole_object_though_the_gripper_is_wide():
    """The claw hammer lies where it does in the demo, in the middle of the table."""
    station = MakePushStation(
        make_scenario(camera={"kind": "rgbd"}), learning=Learning(max_pushes=0)
    )
    seen, true = station.found.obj.outline, station.found.true_obj.outline
    assert seen.area == pytest.approx(true.area, rel=0.03)


def test_a_lower_object_is_touched_by_the_fingers_ends_alone():
    """The Panda's fingers are wider from 27 mm above the table on."""
    low = resolve(make_scenario(object_height=0.02)).robot.shape.area.bounds
    np.testing.assert_allclose(low, (-0.0105, -0.021, 0.0105, 0.021), atol=1e-6)


@pytest.mark.parametrize("robot", SIZES)
@pytest.mark.parametrize("opening", [None, 0.03])
def test_two_fingertips_are_as_far_apart_as_asked_and_discs_fill_their_rims(robot, opening):
    resolved = resolve(make_scenario(robot, "fingertips", finger={"opening": opening}))
    thick, wide = SIZES[robot]  # half as wide is each finger
    apart = opening or {"panda": 0.04}.get(robot, 0.05)
    right = shapely.box(-thick / 2, -(apart + wide) / 2, thick / 2, -apart / 2)
    both = shapely.union(right, shapely.transform(right, lambda xy: -xy))
    shape = resolved.robot.shape
    assert resolved.robot.opening == apart and not shape.joined
    # All that the discs cover is finger, up to their being polygons, and what they leave is small.
    assert both.buffer(1e-6).covers(shape.area)
    hull = shapely.union_all([part.convex_hull for part in shape.area.geoms])
    corners = shapely.get_coordinates(both)
    assert max(hull.distance(shapely.Point(each)) for each in corners) < 2e-3
    # A corner of an object comes in between two discs by half a millimeter at most.
    rims = shapely.union_all([part.exterior for part in shape.area.geoms])
    front = shapely.Point(shape.core[np.argmax(shape.core @ [1.0, 0.5])] + [shape.radius, -0.003])
    assert front.distance(rims) < 5e-4


@pytest.mark.parametrize(
    ("pusher", "opening", "says"),
    [
        ("fingertips", 0.081, r"finger\.opening is 0\.081; expected at most 0\.08"),
        ("gripper", 0.03, r"finger\.opening is 0\.03, and pusher gripper; expected pusher: fing"),
        ("fingertips", -0.01, r"finger\.opening is -0\.01; expected a positive number, in m"),
    ],
)
def test_an_opening_that_cannot_be_is_refused(pusher, opening, says):
    with pytest.raises(ScenarioError, match=says):
        resolve(make_scenario("panda", pusher, finger={"opening": opening}))


def test_all_of_a_gripper_keeps_the_guards_bounds():
    station = MakePushStation(make_scenario("panda"), learning=Learning(max_pushes=0))
    bounds = make_bounds(station._world.setting)
    x, _, _, left = bounds.box.bounds
    inside = [x + 0.3, left - 0.02, 0.1]  # 52 mm wide, 22 mm thick
    assert bounds(np.array(inside), np.pi / 2) is None
    assert "the gripper's tip is at" in bounds(np.array(inside), 0.0)
    # Beside the table, below its top: the tip is beyond the edge, and a part of the fingers is not.
    bounds = replace(bounds, box=bounds.table_top.buffer(0.3))
    x, _, _, left = bounds.table_top.bounds
    beside = np.array([x + 0.3, left + 0.02, -0.01])
    assert bounds(beside, np.pi / 2) is None
    assert bounds(beside, 0.0).endswith("in the table")


def test_the_simulated_fingers_stay_where_they_are_held():
    station = MakePushStation(make_scenario("ur5e", "fingertips"), learning=Learning(max_pushes=0))
    context = station.CreateDefaultContext()
    station.SetStart(context)
    station.GetInputPort("push_command").FixValue(context, PushCommand().to_vector())
    Simulator(station, context).AdvanceTo(0.2)
    plant = station.plant
    fingers = plant.GetModelInstanceByName(station.robot.finger_model)
    q = plant.GetPositions(plant.GetMyContextFromRoot(context), fingers)
    np.testing.assert_array_equal(np.abs(q), station.robot.opening / 2)


@pytest.mark.slow
def test_a_push_by_the_plant_is_led_logged_and_as_simulated(station):
    shape = station.robot.shape
    pose = np.array(station.scenario.object_pose)
    planned = Push.on_outline(
        station.obj,
        CONTACT,
        SLANT,
        DISTANCE,
        radius=shape.radius,
        shape=shape,
        speed=SPEED,
        pose=pose,
        clearance=CLEARANCE,
    )
    command = PushCommand.from_push(1, planned)
    assert station.FindObstacle(command) is None
    context = station.CreateDefaultContext()
    station.SetStart(context)
    simulator = Simulator(station, context)
    monitor = LimitMonitor(station, period=0.005)
    simulator.set_monitor(monitor)
    station.GetInputPort("push_command").FixValue(context, command.to_vector())
    status = station.GetOutputPort("executor.status")
    while not (status.Eval(context).ready and status.Eval(context).executed):
        simulator.AdvanceTo(context.get_time() + 0.1)
        assert context.get_time() < 15.0

    assert make_object_watch(station._world.setting).shape is shape

    # The tool was turned to where it pushed, and the push was logged with its shape and its yaw.
    (seen,) = station.GetOutputPort("estimate.push_log").Eval(context)
    assert seen.push.shape is shape
    assert np.abs(wrap_angle(seen.push.yaw - find_tool_yaw(command.direction))).max() < 0.01
    np.testing.assert_allclose(seen.push.start, planned.start, atol=1e-3)
    assert monitor.limit_report.ok, monitor.limit_report

    # The plant's gripper moved the object as the pushing model says.
    true_pose = station.GetOutputPort("object.pose_true").Eval(context)
    truth = Model(station.obj, replace(station.truth, push_height=0.0))
    expected = simulate(truth, planned, pose, regime="quasi_static").final_pose
    cells = station.obj.cells_at(np.array([pose, expected, true_pose]))
    moved = np.linalg.norm(cells[1] - cells[0], axis=1).mean()
    error = np.linalg.norm(cells[2] - cells[1], axis=1).mean()
    assert moved > 0.03
    assert error < 0.1 * moved


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (
            "robot: gantry\npusher: gripper",
            "robot gantry has no gripper: its robot.yaml has no `scenes: {gripper: FILE}`; "
            "expected one of iiwa14, panda, ur5e, xarm6, or pusher: finger",
        ),
        ("pusher: gripper", "pusher is gripper, but the scene has a finger, finger; expected"),
        ("pusher: hand", "pusher is 'hand'; expected one of finger, gripper"),
    ],
)
def test_a_robot_that_cannot_is_refused(tmp_path, text, says):
    path = tmp_path / "cell.yaml"
    path.write_text(text)
    with pytest.raises(ScenarioError) as error:
        resolve(read_scenario(path), path)
    assert str(path) in str(error.value) and says in str(error.value)


def test_a_scene_without_a_finger_says_that_its_gripper_could_push():
    directives = make_robot_directives("ur5e", grasping=False, pusher="gripper")
    with pytest.raises(ScenarioError, match=r"there is no finger; .* or pusher: gripper"):
        find_robot(directives)
    assert list_robots("gripper") == ["iiwa14", "panda", "ur5e", "xarm6"]


def test_a_gripper_that_does_not_say_where_its_tip_is_is_refused(tmp_path):
    folder = find_models() / "grippers/wsg_50"
    measures = yaml.safe_load((folder / "gripper.yaml").read_text())
    del measures["tip_frame"]
    (tmp_path / "gripper.yaml").write_text(yaml.safe_dump(measures))
    (tmp_path / "wsg_50.urdf").write_text((folder / "wsg_50.urdf").read_text())
    directives = make_robot_directives("iiwa14", grasping=False, pusher="gripper")
    text = (find_models() / "scenes/iiwa_gripper.dmd.yaml").read_text()
    scene = tmp_path / "scene.dmd.yaml"
    own = (tmp_path / "wsg_50.urdf").as_uri()
    scene.write_text(text.replace("package://gridpush_drake/grippers/wsg_50/wsg_50.urdf", own))
    directives[0].add_directives.file = scene.as_uri()
    with pytest.raises(
        ScenarioError, match=r"tip_frame in the gripper\.yaml of gripper is missing"
    ):
        find_robot(directives, pusher="gripper")


@pytest.mark.parametrize(
    ("task", "fields", "says"),
    [
        (
            "pregrasp",
            {},
            "which is for the tasks identify, push, slide, follow, line, separate and",
        ),
        ("fetch", {}, "pusher is gripper"),
        ("push", {"unknown_inertia": True}, "and unknown_inertia is true"),
    ],
)
def test_a_task_that_needs_a_finger_is_refused(task, fields, says):
    with pytest.raises(ScenarioError, match=says):
        TASK_KINDS[task].check(resolve(make_scenario(**fields)))


def test_the_table_of_a_gripper_that_slides_stands_where_something_could_be_grasped():
    there = {
        pusher: resolve(
            PushScenario(
                pusher=pusher,
                directives=make_robot_directives("panda", grasping=True, pusher=pusher),
                object_pose=[0.54, -0.06, 0.0],
            )
        )
        for pusher in ("finger", "gripper")
    }
    assert there["gripper"].table_top.equals(there["finger"].table_top)
    assert there["gripper"].X_WR.IsExactlyEqualTo(there["finger"].X_WR)
    assert not there["gripper"].table_top.equals(resolve(make_scenario()).table_top)


def test_a_pusher_that_gets_to_no_place_of_the_edge_slides_nothing():
    with pytest.raises(StationError, match="workspace: the pusher gets to no place of the table"):
        TASK_KINDS["slide"].station(make_scenario(object_pose=[0.6, 0.0, 0.0]))


def test_a_gripper_keeps_all_that_is_as_low_as_a_post_from_it():
    """A Panda's hand is 0.2 m wide, and begins between the tops of these two posts."""
    low, high = (
        resolve(make_scenario(posts=[{"position": [0.75, 0.3], "height": height}])).robot
        for height in (0.03, 0.08)
    )
    assert low.clear_radius == pytest.approx(low.shape.reach, abs=1e-3)
    assert high.clear_radius > 0.09
    assert high.shape.reach == low.shape.reach


@pytest.mark.slow
def test_an_object_is_pushed_along_a_line_with_a_gripper_that_turns():
    scenario = read_scenario("line")
    scenario.directives = make_robot_directives("panda", grasping=False, pusher="gripper")
    scenario.pusher = "gripper"
    scenario.pokes.count = 1
    scenario.line.points = [[0.6, -0.12]]
    task = TASK_KINDS["line"].station(scenario)
    record = task.run()
    assert record.status == "reached", record.message
    assert record.distance < scenario.follow.position_tolerance + 0.002
    assert record.limit_report.ok, record.limit_report


@pytest.mark.slow
def test_an_object_is_slid_to_where_it_can_be_grasped_with_a_gripper():
    task = make_panda_task("slide", "grasp", grasping=True)
    record = task.run()
    assert (record.status, record.last.mode) == ("reached", "ready"), record.message
    assert record.last.slides > 0 and record.limit_report.ok
    assert all(made.push.shape is task.station.robot.shape for made in record.log)
    # It truly hangs over the edge, and lies there.
    assert record.log[-1].overhang
    true_pose = task.read("object.pose_true")
    assert not find_supported(task.obj, true_pose, task.surface).all()
    assert calc_loads(Model(task.obj, record.truth), true_pose, task.surface.corners) is not None


@pytest.mark.slow
def test_a_twin_is_poked_and_learned_from_with_its_gripper():
    """Over LCM, with the guard of a real arm between them."""
    scenario = make_scenario("ur5e")
    scenario.pokes.count = 1
    scenario.pokes.test_count = 0
    scenario.simulation.answer_delay = None
    bench = TwinBench(scenario, IdentifyTask)
    bench.begin()
    record = bench.task.run(drive=bench.link)
    assert (record.status, len(record.log)) == ("finished", 1), record.message
    assert record.log[0].push.shape is bench.task.station.robot.shape
    assert np.abs(record.log[0].push.yaw).min() > 0.1
    assert record.limit_report.ok


@pytest.mark.slow
def test_an_object_is_pushed_to_its_goal_with_two_fingertips():
    scenario = make_scenario("panda", "fingertips", seed=2)
    task = TASK_KINDS["push"].station(scenario)
    record = task.run()
    assert record.status == "reached", record.message
    assert all(made.push.shape is task.station.robot.shape for made in record.log)


@pytest.mark.slow
def test_several_objects_are_brought_to_goals_with_a_gripper():
    """It comes down beside them with all of its shape, and they are learned by that."""
    task = make_panda_task("rearrange", "rearrange", grasping=False)
    record = task.run()
    assert record.status == "reached", record.message
    shape = task.station.robot.shape
    assert len(record.scene_log) > 0
    for made in record.scene_log:
        assert made.push.shape is shape and np.ptp(made.push.yaw) < 0.1
