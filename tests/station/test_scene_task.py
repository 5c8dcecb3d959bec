"""Several objects in the station: one list of a scenario, what is refused, and whole runs."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import shapely
from pydrake.systems.analysis import Simulator

from gridpush_drake import MakePushStation, PushScenario, read_scenario
from gridpush_drake.display.cell_colors import CellColors
from gridpush_drake.display.server import StartMeshcatServer
from gridpush_drake.dynamics.push import Push
from gridpush_drake.errors import ScenarioError
from gridpush_drake.geometry.se2 import wrap_angle
from gridpush_drake.identification.model_file import read_model
from gridpush_drake.planning.scene.joint_loop import SceneMode, SceneStatus
from gridpush_drake.planning.scene.loop import SceneAction, SceneDecision, SceneLearning
from gridpush_drake.planning.scene.separation import WANTED_CLEARANCE
from gridpush_drake.pushes.observed_push import ObservedPush
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.station.recording.run_recorder import RunRecorder
from gridpush_drake.station.recording.run_recording import read_run
from gridpush_drake.station.scene.contents import load_object, load_others, use_object
from gridpush_drake.station.scene.other_objects import draw_other_truth
from gridpush_drake.station.scene.resolve import resolve
from gridpush_drake.station.scene.scene_camera import guess_ambiguous
from gridpush_drake.station.schema.scenario import PostConfig
from gridpush_drake.station.schema.scenario_file import (
    format_scenario,
    parse_scenario,
    write_scenario,
)
from gridpush_drake.station.tasks.registry import TASK_KINDS
from gridpush_drake.station.tasks.scene_kinds import list_rest_poses
from gridpush_drake.station.tasks.scene_task import (
    FetchTask,
    RearrangeTask,
    SeparateTask,
    make_goals,
    name_objects,
)
from gridpush_drake.station.tasks.task import TaskStatus, TaskStep
from gridpush_drake.station.tasks.task_kind import write_files
from gridpush_drake.systems.base.messages import PushCommand
from tests.helpers.renderer import require_renderer

NAMES = ("separate", "rearrange", "fetch")

LIST = """
objects:
- {object: pliers, pose: [0.6, 0.2, 0.5], goal: [0.6, 0.1, 0.0]}
- {object: claw_hammer, pose: [0.6, -0.1, 0.0], height: 0.04, wanted: true,
   goal: [0.62, -0.2, 0.3], parts: [{label: 1, cell_mass: 0.02}]}
- {object: mine.yaml, pose: [0.5, 0.0, 0.0], parts: [{label: 1, friction: 0.33}]}
"""


def read(tmp_path, text=LIST):
    (tmp_path / "mine.yaml").write_text(
        "name: block\noutline: [[0, 0], [0.05, 0], [0.05, 0.04], [0, 0.04]]\n"
    )
    path = tmp_path / "scenario.yaml"
    path.write_text(text)
    return read_scenario(path)


def test_the_wanted_object_of_a_list_is_the_object_and_the_rest_are_the_others(tmp_path):
    scenario = read(tmp_path)
    assert scenario.object == "claw_hammer" and scenario.object_height == 0.04
    assert scenario.object_pose == [0.6, -0.1, 0.0] and scenario.goal.pose == [0.62, -0.2, 0.3]
    assert scenario.truth.parts[0].cell_mass == 0.02
    assert [other.object for other in scenario.others] == ["pliers", str(tmp_path / "mine.yaml")]
    np.testing.assert_array_equal(
        make_goals(scenario), [[0.62, -0.2, 0.3], [0.6, 0.1, 0.0], [np.nan] * 3]
    )
    # it is written in the older form, and is the same when it is read again
    write_scenario(tmp_path / "again.yaml", scenario)
    again = read_scenario(tmp_path / "again.yaml")
    assert format_scenario(again) == format_scenario(scenario)
    assert scenario.objects == []


LATE_FAULTS = [
    (("object: pliers", "object: plyers"), r"objects\[0\].object: .*pliers"),
    (("object: claw_hammer", "object: claw_hamer"), r"objects\[1\].object: .*claw_hammer"),
    (("mine.yaml", "yours.yaml"), r"objects\[2\].object: .*yours.yaml"),
    (("[0.6, 0.2, 0.5]", "[1.6, 0.2, 0.5]"), r"objects\[0\].pose is \[1.6, 0.2, 0.5\]"),
    (("[0.6, -0.1, 0.0]", "[1.6, -0.1, 0.0]"), r"objects\[1\].pose is \[1.6, -0.1, 0\]"),
    (("pose: [0.5, 0.0, 0.0]", "height: 0.2, pose: [0.5, 0, 0]"), r"objects\[2\].height is 0.2 m"),
    (("height: 0.04", "height: 0.2"), r"finger.travel_height .* height \(objects\[1\].height\)"),
    (("label: 1, cell", "label: 9, cell"), r"objects\[1\].parts\[0\].label is 9; expected a part"),
    (("label: 1, fric", "label: 9, fric"), r"objects\[2\].parts\[0\].label is 9; expected a part"),
    (
        ("\nobjects:", "\nposts: [{position: [0.6, 0.2]}]\nobjects:"),
        r"the object of objects\[0\].pose",
    ),
    (("\nobjects:", "\nscatter: {distance: 9}\nobjects:"), r"near objects\[0\].pose in"),
]


@pytest.mark.parametrize(("change", "message"), LATE_FAULTS)
def test_what_is_found_out_later_is_told_by_the_fields_name_in_the_list(tmp_path, change, message):
    scenario = read(tmp_path, LIST.replace(*change))
    with pytest.raises(ScenarioError, match=message):
        resolve(scenario, tmp_path / "scenario.yaml")


def test_a_field_is_called_by_the_form_in_which_it_was_written(tmp_path):
    names = read(tmp_path).names
    assert [names.name_object(number) for number in range(3)] == [
        "objects[1]",
        "objects[0]",
        "objects[2]",
    ]
    assert names.name_field(0, "goal") == "objects[1].goal"
    assert names.name_others(2) == ["objects[0]", "objects[2]"]
    # a goal or parts that do not stand in the list
    text = LIST.replace("goal: [0.62, -0.2, 0.3], parts: [{label: 1, cell_mass: 0.02}]", "")
    names = read(tmp_path, text + "goal: {pose: [0.6, 0, 0]}\ntruth: {parts: []}\n").names
    assert (names.name_field(0, "goal"), names.name_field(0, "parts")) == (
        "goal.pose",
        "truth.parts",
    )
    # an object of the command line
    scenario = read(tmp_path)
    use_object(scenario, "pliers")
    assert scenario.names.name_field(0, "object") == "object"
    # the older form, in which runs write it
    write_scenario(tmp_path / "again.yaml", scenario)
    names = read_scenario(tmp_path / "again.yaml").names
    assert names.name_others(2) == ["others[0]", "others[1]"]
    assert names.name_field(0, "height") == "object_height"
    # names say nothing of what a scenario is
    assert names == read(tmp_path).names


def test_the_hidden_truth_of_each_object_may_be_given(tmp_path):
    scenario = read(tmp_path)
    resolved = resolve(scenario)
    part = SimpleNamespace(obj=resolved.others[1])
    truth = draw_other_truth(scenario, part, 1, seed=4)
    assert (truth.friction == 0.33).all()
    assert (resolved.truth.mass[resolved.obj.labels == 1] == 0.02).all()


def test_without_a_wanted_one_the_first_object_is_the_object():
    objects = [{"object": name, "pose": [0.6, y, 0]} for name, y in (("pliers", 0.1), ("box", 0))]
    assert PushScenario(objects=objects).object == "pliers"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("objects:", "object: pliers\nobjects:"), "objects and object are both given"),
        (("goal: [0.6, 0.1, 0.0]", "wanted: true"), r"objects\[1\].wanted is true, and so is"),
        (("pose: [0.6, 0.2, 0.5]", "pose: [0.6, 0.2]"), r"objects\[0\].pose"),
        (("wanted: true", "wished: true"), r"objects\[1\].wished"),
    ],
)
def test_a_wrong_list_is_refused_by_the_fields_name(tmp_path, change, message):
    with pytest.raises(ScenarioError, match=message):
        read(tmp_path, LIST.replace(*change))


def test_objects_in_each_other_are_both_named(tmp_path):
    scenario = read(tmp_path, LIST.replace("[0.6, 0.2, 0.5]", "[0.6, -0.1, 0.5]"))
    with pytest.raises(
        ScenarioError,
        match=r"objects\[0\].pose is .* pliers would lie in claw_hammer, which is at objects\[1\].pose",
    ):
        resolve(scenario)


@pytest.mark.parametrize("name", NAMES)
def test_the_shipped_scenario_of_each_task_makes_sense(name):
    assert set(NAMES) < set(TASK_KINDS)
    scenario = TASK_KINDS[name].make_scenario()
    assert scenario.others and scenario.camera.kind == "ideal"
    resolve(scenario)


def test_what_a_task_with_several_objects_refuses(tmp_path):
    with pytest.raises(ScenarioError, match="others: empty; expected other objects"):
        SeparateTask(PushScenario())
    scenario = read_scenario("separate")
    scenario.base = "planar"
    with pytest.raises(ScenarioError, match="base is planar; expected free"):
        SeparateTask(scenario)
    with pytest.raises(ScenarioError, match="no model gripper"):
        FetchTask(read_scenario("separate"))


def make_scenario_with_a_post(name="separate"):
    scenario = read_scenario(name)
    scenario.posts = [PostConfig(position=[0.62, -0.26], radius=0.015)]
    return scenario


def test_pushes_of_several_objects_are_planned_around_posts():
    task = SeparateTask(make_scenario_with_a_post())
    post = shapely.Point(0.62, -0.26).buffer(0.015)
    rules = task.planner.rules
    assert len(rules.posts) == 1 and rules.posts[0].covers(post.buffer(-1e-9))
    radius = task.station.robot.finger.tip_radius
    assert rules.finger_region.distance(post) > 0.99 * radius
    # but not around the other objects, which are there to be pushed
    assert rules.finger_region.covers(shapely.Point(task.station.others[0].pose[:2]))


def test_goals_in_each_other_are_both_named():
    scenario = read_scenario("rearrange")
    scenario.others[0].goal = scenario.goal.pose
    expected = (
        r"objects\[0\].goal of claw_hammer and objects\[1\].goal of combination_wrench overlap"
    )
    with pytest.raises(ScenarioError, match=expected):
        RearrangeTask(scenario)


def test_a_goal_that_is_nowhere_told_is_not_made_up(tmp_path):
    text = LIST.replace("goal: [0.62, -0.2, 0.3], ", "")
    with pytest.raises(
        ScenarioError, match=r"objects\[1\].goal: missing; expected \[x, y, theta\]"
    ):
        TASK_KINDS["rearrange"].check(resolve(read(tmp_path, text)))
    scenario = read(tmp_path, text + "goal: {pose: [0.62, -0.2, 0.3]}\n")
    TASK_KINDS["rearrange"].check(resolve(scenario))


def test_all_that_does_not_suit_a_task_is_told_at_once():
    scenario = PushScenario(base="planar")
    with pytest.raises(ScenarioError) as told:
        TASK_KINDS["fetch"].check(resolve(scenario, "cell.yaml"), ["--object: missing"])
    message = str(told.value)
    assert message.startswith("cell.yaml: others: empty") and message.count("Also: ") == 3
    assert "base is planar" in message and "no model gripper" in message
    assert message.endswith("--object: missing")


def make_record(task, name):
    """A record of one push, as a task would have noted it."""
    record = task.make_record()
    push = Push((0.5, -0.2), (0.05, 0.0), 1.0, 0.01)
    moved = record.begin + [0.0, 0.05, 0.1]
    seen = ObservedPush("push_1", push, record.begin, np.array([1.0]), moved[None])
    command = PushCommand.from_push(1, push)
    status = SceneStatus(SceneMode.PUSHING, "The pliers away.", 0, 1, "clear")
    record.steps.append(TaskStep(0.4, status, record.begin[0], push=command))
    record.last = replace(status, mode=SceneMode.DONE, pushes=1)
    record.scene_log = (seen,)
    record.poses = moved
    record.status = TASK_KINDS[name].done
    record.message = "Every object is where it should be."
    return record


@pytest.mark.parametrize("name", ["separate", "rearrange"])
def test_a_run_is_summarized_and_reported(name, tmp_path, undrawn):
    kind = TASK_KINDS[name]
    task = kind.station(kind.make_scenario())
    task.begin(0)
    assert task.names[0] == "claw hammer" and len(task.objects) == len(task.names)
    record = make_record(task, name)
    summary = kind.summarize(record)
    assert summary["done"] and summary["pushes"] == 1 and len(summary["at_end"]) == len(task.names)
    lines = kind.describe(summary)
    assert "After 1 push" in lines[0] and "claw hammer" in lines[1]
    assert kind.write_own(tmp_path, record, None, False) == ["pushes.csv", "report.html"]
    page = (tmp_path / "report.html").read_text()
    assert "The pliers away." in page and "recording.html" not in page
    assert "recording.html" in kind.make_report(record, "recording.html")
    log = PushLog.read_csv(tmp_path / "pushes.csv")
    np.testing.assert_array_equal(log[0].poses_observed, record.scene_log[0].poses_observed)
    assert len(list_rest_poses(record)) == 2
    # what is not done yet
    record.scene_log = ()
    assert kind.write_own(tmp_path, record, None, True) == []
    np.testing.assert_array_equal(list_rest_poses(record), record.begin[None])
    assert task.judge(record, SimpleNamespace(idle=0.0, unseen=0.0))[0] is TaskStatus.REACHED
    record.poses[1] = np.nan
    status, message = task.judge(record, SimpleNamespace(idle=0.0, unseen=0.0))
    assert status is TaskStatus.DROPPED and task.names[1] in message


def learn_one_push(task, record):
    """Makes the controller of a task that has begun hold what the push of a record tells, and stop."""
    context = task.simulator.get_mutable_context()
    state = task.controller.GetState(task.controller.GetMyContextFromRoot(context))
    learning = SceneLearning(noise=(2e-3, 2e-3, 1e-2))
    belief = learning.learn(state.belief, record.scene_log, 0, last=True)
    done = replace(state, belief=belief, log=record.scene_log).turn_to(SceneMode.DONE, "Done.")
    task.controller.GetMyMutableContextFromRoot(context).SetAbstractState(0, done)
    return belief.identifications


@pytest.mark.slow
def test_what_was_learned_of_each_object_is_drawn_recorded_and_written(tmp_path, undrawn):
    """The colors in Meshcat are those of the models that the folder holds, and no object is gray."""
    pytest.importorskip("rosbags")
    kind = TASK_KINDS["separate"]
    scenario = kind.make_scenario()
    meshcat = StartMeshcatServer(0)
    task = SeparateTask(scenario, meshcat)
    task.begin(0)
    meshcat.StartRecording(20.0)
    task.simulator.Initialize()
    visualizer = task.diagram.GetSubsystemByName("estimate_visualizer")

    def load_masses():
        context = visualizer.GetMyContextFromRoot(task.simulator.get_context())
        return [each.mass for each in context.get_abstract_state(0).get_value().estimates]

    # beforehand all are even
    assert len(load_masses()) == len(task.objects)
    assert all(np.ptp(mass) < 1e-9 for mass in load_masses())
    assert all(other.part.visuals == () for other in task.station.others)
    # then what a push told of each
    record = make_record(task, "separate")
    models = learn_one_push(task, record)
    recorder = RunRecorder()
    task.simulator.AdvanceTo(0.2)
    recorder.note(task)
    assert all(np.ptp(model.params.mass) > 0 for model in models)
    for b, (mass, model) in enumerate(zip(load_masses(), models, strict=True)):
        np.testing.assert_array_equal(mass, model.params.mass)
        assert meshcat.HasPath(f"estimate/object/{b}/2/cells")
    # the folder
    task.note(record, 0.2)
    names = [f"model_{name.replace(' ', '_')}.yaml" for name in task.names]
    written = write_files(kind, tmp_path, scenario, record, meshcat, False)
    assert set(names) <= {path.name for path in written}
    assert set(names) <= set(kind.list_files(resolve(scenario, "separate")))
    for name, model in zip(names, models, strict=True):
        again = read_model(tmp_path / name)
        np.testing.assert_allclose(again.params.mass, model.params.mass, rtol=1e-6)
    page = (tmp_path / "report.html").read_text()
    assert all(f"What was learned of the {name}" in page for name in task.names)
    assert "truth" in page
    # the file for Foxglove, in which every object has a frame
    recorder.write(tmp_path / "run.mcap", record)
    run = read_run(tmp_path / "run.mcap")
    markers = run.require("/cells")[-1][1].markers
    assert [marker.header.frame_id for marker in markers] == list(task.object_names)
    for marker, model in zip(markers, models, strict=True):
        wanted = CellColors().calc_colors(model.params.mass, model.params.friction)
        shown = [(color.r, color.g, color.b) for color in marker.colors]
        np.testing.assert_allclose(shown, wanted, atol=1e-6)
    for name in task.object_names[1:]:
        assert run.get(f"/{name}/object_pose") and run.get(f"/{name}/center_of_mass")


@pytest.mark.parametrize(("tolerance", "angle"), [(0.005, 0.05), (0.3, 0.5)])
def test_a_goals_tolerance_is_one_of_position_and_turn(tolerance, angle):
    scenario = read_scenario("rearrange")
    goal = scenario.goal.model_copy(update={"tolerance": tolerance})
    options = RearrangeTask(scenario.model_copy(update={"goal": goal})).make_planner().options
    assert options.position_tolerance == tolerance
    assert options.angle_tolerance == pytest.approx(angle)


def test_objects_of_one_name_are_told_apart():
    scenario = parse_scenario(
        Path("two.yaml"),
        "objects:\n- {object: pliers, pose: [0.6, 0.2, 0]}\n- {object: pliers, pose: [0.6, 0, 0]}\n",
    )
    resolved = resolve(scenario)
    assert name_objects((resolved.obj, *resolved.others)) == ("pliers 0", "pliers 1")
    assert SceneDecision(SceneAction.DONE, "done").push is None


def make_rgbd(name):
    require_renderer()
    scenario = read_scenario(name)
    scenario.camera.use("rgbd")
    return scenario


@pytest.mark.slow
def test_objects_that_touch_are_found_in_the_first_picture_and_told_apart():
    """Four objects of the station, all but touching, of which the robot is told the outlines alone."""
    station = MakePushStation(make_rgbd("separate"), several=True)
    assert station.found is None
    context = station.CreateDefaultContext()
    station.SetStart(context, seed=5)
    station.GetInputPort("push_command").FixValue(context, PushCommand().to_vector())
    simulator = Simulator(station, context)
    simulator.AdvanceTo(0.05)
    names = ["object", *(other.name for other in station.others)]
    assert station.GetOutputPort("camera.message").Eval(context) == ""
    for name in names:
        seen, true = (
            station.GetOutputPort(f"{name}.{kind}").Eval(context) for kind in ("pose", "pose_true")
        )
        assert np.hypot(*(seen - true)[:2]) < 1e-3, name
        assert abs(wrap_angle(seen[2] - true[2])) < np.radians(0.5), name
        assert np.abs(seen - true).max() > 0  # a picture has noise
    sight = station.FindSceneView(context)
    assert sight.errors.shape == (1, len(names), 3) and sight.seen.all()
    assert station.FindCameraView(context) is None

    # while one of them is not seen, the executor takes up no push
    station.CoverCamera(context)
    simulator.AdvanceTo(0.15)
    push = PushCommand(1, 0.45, -0.3, 0.0, 0.02, 0.05)
    station.GetInputPort("push_command").FixValue(context, push.to_vector())
    simulator.AdvanceTo(0.25)
    assert np.isnan(station.GetOutputPort("other_2.pose").Eval(context)).all()
    assert np.isfinite(station.GetOutputPort("other_2.pose_true").Eval(context)).all()
    assert station.GetOutputPort("executor.status").Eval(context).command_id == 0


def test_what_no_picture_tells_is_looked_for_where_the_scenario_has_it():
    """Which of two equal pliers is which, and which end of a book is which; but not the hammer."""
    names = ["pliers", "claw_hammer", "pliers", "open_book"]
    ys = [0.2, 0.0, -0.2, 0.4]
    listed = [
        f"- {{object: {name}, pose: [0.6, {y}, 0]}}" for name, y in zip(names, ys, strict=True)
    ]
    scenario = parse_scenario(Path("four.yaml"), "\n".join(["objects:", *listed]))
    objects = (load_object(scenario), *load_others(scenario))
    poses = np.column_stack([np.full(4, 0.6), ys, np.zeros(4)])
    first, hammer, second, book = guess_ambiguous(objects, poses)
    assert hammer is None
    np.testing.assert_array_equal([first, second, book], poses[[0, 2, 3]])


@pytest.mark.slow
def test_what_the_camera_does_not_find_ends_the_task_with_its_message():
    task = SeparateTask(make_rgbd("separate"))
    task.begin()
    task.station.CoverCamera(task.simulator.get_mutable_context())
    task.simulator.AdvanceTo(0.1)
    record = task.make_record()
    record.last = SceneStatus(SceneMode.LOST, "Not seen for 3 s: pliers.")
    status, message = task.judge(record, SimpleNamespace(idle=0.0, unseen=0.0))
    assert status is TaskStatus.LOST and message == record.last.reason
    assert np.isfinite(record.poses).all()  # nothing fell: it is only not seen


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_every_task_is_done_by_what_a_color_and_depth_camera_shows(name):
    kind = TASK_KINDS[name]
    task = kind.station(make_rgbd(name))
    record = task.run()
    assert record.status == kind.done, record.message
    assert record.limit_report.ok, record.limit_report
    camera = kind.summarize(record)["camera"]
    assert min(camera["seen"]) > 0.5 and camera["position_rms"] < 1e-3
    assert camera["angle_rms"] < np.radians(0.3)
    lines = [line for line in kind.describe(kind.summarize(record)) if "camera" in line]
    assert len(lines) == 1 and "pictures" in lines[0]
    assert "poses off by (RMS)" in kind.make_report(record)


@pytest.mark.slow
def test_objects_are_separated_beside_a_post_by_the_robot():
    record = SeparateTask(make_scenario_with_a_post()).run()
    assert record.status == TaskStatus.REACHED, record.message
    assert record.clearances.min() > WANTED_CLEARANCE - 0.003
    assert record.limit_report.ok, record.limit_report  # nothing touched the post
    assert len(record.scene_log) == record.pushes >= 1


@pytest.mark.slow
def test_objects_are_rearranged_by_the_robot():
    record = RearrangeTask(read_scenario("rearrange")).run()
    assert record.status == TaskStatus.REACHED, record.message
    off = TASK_KINDS["rearrange"].measure(record, record.poses[None])[0]
    assert off.max() < 0.022
    assert record.limit_report.ok, record.limit_report


@pytest.mark.slow
def test_the_wanted_object_is_fetched_by_the_robot():
    record = FetchTask(read_scenario("fetch")).run()
    assert record.status == TaskStatus.HELD, record.message
    assert record.raised > 0.05
    assert np.isfinite(record.poses).all()
