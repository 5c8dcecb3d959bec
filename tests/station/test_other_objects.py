"""Two objects in one scene: a scenario names the second, the station shows its pose, pushes keep clear of it."""

import numpy as np
import pytest
import shapely
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from gridpush_drake import GridIdentifier, MakePushStation, PushCommand, PushScenario, read_scenario
from gridpush_drake.errors import ScenarioError
from gridpush_drake.geometry.se2 import transform_shape
from gridpush_drake.multibody.ground_truth import SetGridObjectPose
from gridpush_drake.station.scene.finger_region import MakeFingerRegion
from gridpush_drake.station.scene.other_objects import place_others
from gridpush_drake.station.scene.resolve import resolve
from gridpush_drake.station.scene.setting import make_surface
from gridpush_drake.station.simulated.limit_monitor import LimitMonitor
from gridpush_drake.station.tasks.identify_task import IdentifyTask
from gridpush_drake.station.tasks.pregrasp_task import PreGraspTask
from gridpush_drake.station.tasks.push_task import PushTask, make_rules
from gridpush_drake.station.tasks.task import TaskStatus
from tests.helpers.renderer import require_renderer

SCENARIO = """
object: open_book
object_pose: [0.6, 0.0, 0.0]
others:
- {object: pliers, pose: [0.6, 0.25, 0.5]}
- {object: mine.yaml, pose: [0.6, -0.25, 0.0], height: 0.02}
"""
POSES = [(0.6, 0.25, 0.5), (0.6, -0.25, 0.0)]
NOISE = 0.003  # m, beyond that of any picture


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scenario")
    (folder / "mine.yaml").write_text(
        "name: block\noutline: [[0, 0], [0.06, 0], [0.06, 0.04], [0, 0.04]]\n"
    )
    (folder / "scenario.yaml").write_text(SCENARIO)
    builder = DiagramBuilder()
    station = builder.AddSystem(MakePushStation(read_scenario(folder / "scenario.yaml")))
    # what the block is like is learned by an identifier of its own
    obj, radius = station.others[1].part.obj, station.robot.finger.tip_radius
    second = builder.AddNamedSystem(
        "second", GridIdentifier(obj, engaged_below=0.02, pusher_radius=radius)
    )
    builder.Connect(station.GetOutputPort("other_1.pose"), second.GetInputPort("object_pose"))
    builder.Connect(station.GetOutputPort("pusher.state"), second.GetInputPort("pusher_state"))
    return builder.Build(), station


@pytest.fixture
def station(scene):
    return scene[1]


@pytest.fixture
def simulator(scene):
    diagram, station = scene
    context = diagram.CreateDefaultContext()
    station.SetStart(context, seed=3)
    command(station, context, PushCommand())
    return Simulator(diagram, context)


def command(station, context, push):
    own = station.GetMyMutableContextFromRoot(context)
    station.GetInputPort("push_command").FixValue(own, push.to_vector())


def read(system, simulator, port):
    return system.GetOutputPort(port).Eval(system.GetMyContextFromRoot(simulator.get_context()))


def test_each_lies_where_the_scenario_has_it_and_is_seen(station, simulator):
    monitor = LimitMonitor(station, period=0.01)
    simulator.set_monitor(monitor)
    simulator.AdvanceTo(0.3)
    for number, pose in enumerate(POSES):
        seen = read(station, simulator, f"other_{number}.pose")
        np.testing.assert_allclose(seen, pose, atol=4 * NOISE)
        assert np.abs(seen - pose).max() > 0  # a picture has noise
    np.testing.assert_allclose(
        read(station, simulator, "object.pose_true"), (0.6, 0.0, 0.0), atol=1e-4
    )
    assert monitor.limit_report.ok, monitor.limit_report


def test_each_weighs_and_rubs_as_its_own_seed_says(scene, station):
    masses = []
    for seed in (0, 1):
        context = scene[0].CreateDefaultContext()
        station.SetStart(context, seed)
        plant_context = station.plant.GetMyContextFromRoot(context)
        bodies = [station.object_in_plant.body, *(other.part.body for other in station.others)]
        masses.append(
            [body.CalcSpatialInertiaInBodyFrame(plant_context).get_com()[:2] for body in bodies]
        )
    first, second = np.array(masses)
    assert (np.abs(first - second)[0] > 1e-5).any()
    assert (np.abs(first - second)[1] > 1e-5).any()


@pytest.mark.slow
def test_one_that_is_pushed_moves_and_is_learned_and_the_others_stay(scene, station, simulator):
    x, y, _ = POSES[1]
    context = simulator.get_mutable_context()
    command(station, context, PushCommand(1, x - 0.03, y + 0.01, 0.0, 0.05, 0.05))
    while read(station, simulator, "executor.status").executed < 1:
        simulator.AdvanceTo(context.get_time() + 0.1)
        assert context.get_time() < 15.0
    assert read(station, simulator, "other_1.pose")[0] > x + 0.01
    np.testing.assert_allclose(read(station, simulator, "other_0.pose"), POSES[0], atol=4 * NOISE)
    np.testing.assert_allclose(
        read(station, simulator, "object.pose_true"), (0.6, 0.0, 0.0), atol=1e-3
    )
    second = scene[0].GetSubsystemByName("second")
    assert len(read(second, simulator, "push_log")) == 1
    assert np.ptp(read(second, simulator, "mass")) > 0  # no longer even


def test_pushes_keep_clear_of_where_they_lie(station):
    region, outlines = MakeFingerRegion(station), place_others(station.others)
    assert region.distance(shapely.union_all(outlines)) > 0.99 * station.robot.finger.tip_radius
    rules = make_rules(station, make_surface(station.table_top))
    checker = rules.constraints.start_at(
        station.obj, np.array([0.6, 0.0, 0.0]), rules.contact.pusher.choose_radius(station.obj)
    )
    assert checker.allows_poses(np.array([[0.6, 0.0, 0.0], [0.6, 0.2, 0.0]])).tolist() == [
        True,
        False,
    ]


@pytest.mark.slow
def test_pokes_and_pushes_to_a_goal_leave_them_where_they_are():
    others = [
        {"object": "pliers", "pose": list(POSES[0])},
        {"object": "toothpaste_tube", "pose": [0.65, -0.25, 0.0]},
    ]
    scenario = PushScenario(object="claw_hammer", object_pose=[0.6, 0.0, 0.5], others=others)
    scenario.pokes.count, scenario.pokes.test_count, scenario.pokes.speed = 1, 0, 0.06
    scenario.goal.pose = [0.62, -0.03, 0.7]
    for task in (IdentifyTask(scenario), PushTask(scenario)):
        record = task.run(0)
        assert record.status in (TaskStatus.FINISHED, TaskStatus.REACHED), record.message
        assert record.limit_report.ok, record.limit_report
        for number, other in enumerate(others):
            np.testing.assert_allclose(
                task.read(f"other_{number}.pose"), other["pose"], atol=4 * NOISE
            )


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        ({"object": "plier"}, r"others\[0\].object: .*pliers"),
        (
            {"pose": [0.6, 0.02, 0.0]},
            r"others\[0\].pose is .*pliers would lie in claw_hammer, which is at object_pose",
        ),
        ({"pose": [3.0, 0.0, 0.0]}, r"others\[0\].pose is .*not wholly on the table"),
        ({"height": 0.13}, r"others\[0\].height is 0.13 m; .*finger.travel_height .*, 0.112 m"),
        ({"height": -1.0}, r"others.* -1.0; expected a positive number"),
    ],
)
def test_what_makes_no_sense_is_refused(fields, says):
    with pytest.raises(ScenarioError, match=says):
        resolve(PushScenario(others=[{"object": "pliers", "pose": [0.6, 0.25, 0.5]} | fields]))


@pytest.mark.slow
def test_a_slide_to_the_edge_keeps_clear_of_them():
    task = PreGraspTask(read_scenario("two_objects"))
    assert task.planner.obstacles == place_others(task.station.others)
    assert len(task.planner.obstacles) == 1


@pytest.mark.slow
@pytest.mark.parametrize("make_task", [IdentifyTask, PushTask, PreGraspTask])
def test_every_task_is_done_in_the_scenario_of_two_objects(make_task):
    """The other object is touched by nothing but the table, and stays where it is."""
    scenario = read_scenario("two_objects")
    scenario.pokes.count, scenario.pokes.test_count = 2, 0
    task = make_task(scenario)
    record = task.run()
    done = (TaskStatus.FINISHED, TaskStatus.REACHED, TaskStatus.HELD)
    assert record.status in done, record.message
    assert record.limit_report.ok, record.limit_report
    np.testing.assert_allclose(task.read("other_0.pose"), scenario.others[0].pose, atol=4 * NOISE)


@pytest.mark.slow
def test_a_color_and_depth_camera_finds_and_tracks_the_object_among_them():
    """In the photograph and after the object was put beside another one, 12 mm away, it is the object that is seen."""
    require_renderer()
    others = [
        {"object": "pliers", "pose": list(POSES[0])},
        {"object": "toothpaste_tube", "pose": [0.65, -0.25, 0.0]},
    ]
    scenario = PushScenario(object="open_book", object_pose=[0.6, 0.0, 0.0], others=others)
    scenario.camera.kind, scenario.camera.rate = "rgbd", 10.0
    station = MakePushStation(scenario)
    seen, true = station.found.obj.outline, station.found.true_obj.outline
    assert seen.intersection(true).area / seen.union(true).area > 0.95
    simulator = Simulator(station)
    context = simulator.get_mutable_context()
    station.SetStart(context, seed=0)
    command(station, context, PushCommand())
    start = station.scenario.object_pose
    outline, theta = transform_shape(start, true), start[2]
    gap = outline.distance(place_others(station.others)[0])
    for time, (x, y) in ((0.15, start[:2]), (0.35, (start[0], start[1] + gap - 0.012))):
        SetGridObjectPose(
            station.plant,
            station.plant.GetMyMutableContextFromRoot(context),
            station.object_in_plant,
            (x, y, theta),
        )
        simulator.AdvanceTo(time)
        assert read(station, simulator, "camera.seen")[0] == 1
        off = read(station, simulator, "object.pose") - read(station, simulator, "object.pose_true")
        assert np.linalg.norm(off[:2]) < 1e-3 and abs(off[2]) < np.radians(0.5), off
    np.testing.assert_allclose(read(station, simulator, "other_0.pose"), POSES[0], atol=4 * NOISE)
