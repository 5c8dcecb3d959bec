"""A robot is a folder: its measures stand beside its model, and another arm needs no change to the package."""

import re
import shutil
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
import shapely
from pydrake.systems.analysis import Simulator

from gridpush_drake.errors import ScenarioError
from gridpush_drake.multibody.parser import find_models
from gridpush_drake.planning.pregrasp.grasp.gripper import Gripper
from gridpush_drake.station import IdentifyTask, TaskStatus
from gridpush_drake.station.robot.arm import (
    ArmPosture,
    ArmReach,
    CalcStartPosture,
    MakeControlPlant,
)
from gridpush_drake.station.robot.measures import FingerMeasures, GripperMeasures, read_measures
from gridpush_drake.station.robot.robot import find_robot, make_robot_directives
from gridpush_drake.station.scene.contents import CalcTipReach
from gridpush_drake.station.scene.finger_region import STEER_INSET, MakeRing
from gridpush_drake.station.scene.resolve import resolve
from gridpush_drake.station.schema.scenario import PushScenario
from gridpush_drake.station.schema.scenario_file import read_scenario
from gridpush_drake.station.simulated.limit_monitor import LimitMonitor
from gridpush_drake.station.simulated.push_station import MakePushStation
from gridpush_drake.systems.base.messages import PushCommand
from tests.helpers.twin_bench import COARSE_HAMMER, TwinBench

BASE = (0.05, -0.02, 0.08)
"""Of the second arm's base in the world, m."""

DOCS = Path(__file__).parents[2] / "docs/extending.md"


def read_docs():
    """The robot.yaml and the directives that stand under "A robot of your own"."""
    if not DOCS.is_file():
        pytest.skip("a wheel's tests have no docs beside them")
    section = DOCS.read_text().partition("## A robot of your own")[2]
    measures, directives = re.findall("```yaml\n(.*?)```", section, re.DOTALL)[:2]
    return measures, directives


@pytest.fixture
def second_arm(tmp_path):
    """A scenario as the docs say, with an arm of six joints at another height, its folder outside the package."""
    measures, directives = read_docs()
    (tmp_path / "robot.yaml").write_text(measures)
    urdf = (find_models() / "robots/iiwa14/iiwa14_primitives.urdf").read_text()
    urdf = re.sub(
        '<transmission name="iiwa_transmission_3">.*?</transmission>', "", urdf, flags=re.DOTALL
    )
    urdf = urdf.replace('"iiwa_joint_3" type="revolute"', '"iiwa_joint_3" type="fixed"')
    urdf = (
        urdf.replace("iiwa_link_0", "base")
        .replace("iiwa_link_ee_kuka", "flange")
        .replace("iiwa_", "other_")
    )
    (tmp_path / "arm.urdf").write_text(urdf)
    directives = directives.replace("file:///home/me/my_arm", tmp_path.as_uri())
    directives = directives.replace(
        "arm::base}", f"arm::base, X_PC: {{translation: {list(BASE)}}}}}"
    )
    (tmp_path / "scene.dmd.yaml").write_text(directives)
    path = tmp_path / "scenario.yaml"
    path.write_text(f"object_pose: [0.65, 0.0, 0.0]\n{directives}")
    return path


def advance_until_settled(simulator, station, limit):
    """Goes on until a push is made and the finger lifted, and returns the executor's status."""
    context = simulator.get_mutable_context()
    status = station.GetOutputPort("executor.status").Eval(context)
    while not status.executed and not status.refused and context.get_time() < limit:
        simulator.AdvanceTo(context.get_time() + 0.1)
        status = station.GetOutputPort("executor.status").Eval(context)
    return status


def test_a_second_arm_begins_at_home_and_reaches_the_object(second_arm):
    scenario = read_scenario(second_arm)
    resolve(scenario)
    station = MakePushStation(scenario)
    simulator = Simulator(station)
    context = simulator.get_mutable_context()
    station.SetStart(context)
    home = np.array(station.robot.arm.home) + [BASE[0], BASE[1], 0.0]
    assert station.GetOutputPort("pusher.state").Eval(context)[:3] == pytest.approx(home, abs=1e-5)
    assert station.FindObstacle(PushCommand(1, 0.65, -0.09, np.pi / 2, 0.13, 0.1)) is None


@pytest.mark.slow
def test_the_second_arm_pushes_and_speaks_with_its_twin(second_arm):
    scenario = read_scenario(second_arm)
    scenario.base, scenario.object = "planar", "open_book"
    scenario.pokes.count, scenario.pokes.test_count, scenario.pokes.speed = 1, 0, 0.08
    scenario.pokes.distance = [0.05, 0.05]
    bench = TwinBench(scenario, IdentifyTask)
    bench.begin()
    record = bench.task.run(drive=bench.link)
    assert (record.status, len(record.log)) == (TaskStatus.FINISHED, 1), record.message
    assert bench.task.station.GetOutputPort("arm.position_measured").size() == 6
    assert bench.link.report.left_out == {}
    moved = record.log[0].final_pose - record.log[0].pose
    assert np.hypot(*moved[:2]) > 0.01


@pytest.mark.parametrize(
    "name",
    [
        "panda",
        "gantry",
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("ur5e", "xarm6")),
    ],
)
def test_a_robot_that_comes_with_the_package_pushes_within_its_limits(name):
    scene = make_robot_directives(name, grasping=False)
    station = MakePushStation(PushScenario(object=COARSE_HAMMER, directives=scene))
    simulator = Simulator(station)
    context = simulator.get_mutable_context()
    station.SetStart(context)
    assert station.GetOutputPort("pusher.state").Eval(context)[:3] == pytest.approx(
        [0.5, 0.0, 0.2], abs=1e-5
    )
    push = PushCommand(1, 0.6, -0.06, np.pi / 2, 0.07, 0.1)
    station.GetInputPort("push_command").FixValue(context, push.to_vector())
    monitor = LimitMonitor(station)
    simulator.set_monitor(monitor)
    status = advance_until_settled(simulator, station, 5.0)
    assert (status.executed, status.refused) == (1, 0)
    assert station.GetOutputPort("object.pose_true").Eval(context)[1] > 0.01
    seen = monitor.limit_report
    assert seen.ok
    assert min(seen.position_fraction, seen.velocity_fraction, seen.torque_fraction) > 0.05
    assert seen.tracking_error < 2e-3
    arm = station.robot.arm_model
    assert station.GetOutputPort(f"{arm}.position_commanded").Eval(context) == pytest.approx(
        station.GetOutputPort(f"{arm}.position_measured").Eval(context), abs=2e-3
    )


def test_a_gantry_reaches_what_its_axes_do_and_says_where_it_does_not():
    scenario = PushScenario(directives=make_robot_directives("gantry", grasping=False))
    robot = find_robot(scenario.directives)
    plant = MakeControlPlant(robot)
    reach = ArmReach(plant, robot, CalcStartPosture(plant, robot, robot.arm.home))
    lower, upper = plant.GetPositionLowerLimits(), plant.GetPositionUpperLimits()
    assert reach.find_region((0.0, -1.0, 1.2, 1.0), 0.012).bounds == pytest.approx(
        (lower[0], lower[1], upper[0], upper[1]), abs=0.04
    )
    home = (0.5, 0.0, 0.2)
    assert reach([home, (0.9, 0.5, 0.2)], [0.3]) is None
    assert "joint 1 of the arm would come to its limit" in reach([home, (1.1, 0.0, 0.2)], [0.3])
    assert "joint 2 of the arm would have to slide at 0.60 m/s" in reach(
        [home, (0.5, 0.3, 0.2)], [0.6]
    )


def test_inverse_kinematics_finds_the_ring_that_the_formula_says():
    robot = find_robot(PushScenario().directives)
    plant = MakeControlPlant(robot)
    reach = ArmReach(plant, robot, CalcStartPosture(plant, robot, (0.5, 0.0, 0.2)))
    box = shapely.box(0.2, -0.2, 0.9, 0.4)
    ring = MakeRing(np.zeros(2), *robot.arm.reach.calc_ring(0.16, 0.012)) & box
    found = reach.find_region(box.bounds, 0.012)
    assert (found - ring.buffer(0.03)).is_empty
    assert found.area > 0.85 * ring.area  # the paths' margins from the joints' limits take a little


@pytest.mark.parametrize("name", ["iiwa14", "panda"])
def test_where_a_finger_is_steered_the_arm_can_move_it_as_fast_as_that(name):
    robot = find_robot(make_robot_directives(name, grasping=False))
    plant = MakeControlPlant(robot)
    q = CalcStartPosture(plant, robot, (0.5, 0.0, 0.2))
    reach = ArmReach(plant, robot, q)
    posture = ArmPosture(plant, robot)
    bounds = (0.4, -0.5, 0.8, 0.5)
    everywhere = reach.find_region(bounds, 0.012)
    steered = reach.find_region(bounds, 0.012, speed=0.15)
    assert steered.area < 0.99 * everywhere.area
    assert (steered - everywhere).is_empty
    # within the rim that the station leaves, no joint has to turn faster than it may
    rim = steered.buffer(1e-3).buffer(-STEER_INSET)
    for place in shapely.get_coordinates(rim)[::5]:
        posture_there = posture.solve((*place, 0.012), q, q)
        assert posture_there is not None
        # the tip's Jacobian is that of the tool, which points down: its z is no way to go
        rates = np.linalg.pinv(posture.calc_jacobian(posture_there))[:, 3:5]
        fastest = 0.15 * np.linalg.norm(rates, axis=1) / posture.speed
        assert fastest.max() < 1.0


def test_reach_is_measured_from_the_base_wherever_it_stands(second_arm):
    iiwa = (find_models() / "robots/iiwa14/robot.yaml").read_text()
    with second_arm.with_name("robot.yaml").open("a") as measures:
        measures.write(iiwa[iiwa.index("reach:") : iiwa.index("messages:")])
    station = MakePushStation(read_scenario(second_arm))
    axis, low, high = CalcTipReach(station.plant, station.robot, 0.012)
    assert axis == pytest.approx(BASE[:2])
    assert (low, high) == pytest.approx(station.robot.arm.reach.calc_ring(0.16, 0.012 - BASE[2]))


def test_the_gripper_of_the_page_is_the_default_one(tmp_path):
    if not DOCS.is_file():
        pytest.skip("a wheel's tests have no docs beside them")
    (measures,) = re.findall("```yaml\n(mount_frame.*?)```", DOCS.read_text(), re.DOTALL)
    path = tmp_path / "gripper.yaml"
    path.write_text(measures)
    assert read_measures(path, GripperMeasures).make_gripper() == Gripper()


def test_the_grippers_measures_are_those_that_grasps_are_planned_with():
    robot = find_robot(read_scenario(find_models() / "scenarios/grasp.yaml").directives)
    measured, default = robot.gripper.make_gripper(), Gripper()
    assert {f.name: getattr(measured, f.name) for f in fields(default)} == {
        f.name: getattr(default, f.name) for f in fields(default)
    }


def test_a_tip_radius_that_is_not_the_models_is_refused(second_arm):
    folder = second_arm.parent / "finger"
    folder.mkdir()
    (folder / "finger.urdf").write_text((find_models() / "fingers/rod/finger.urdf").read_text())
    (folder / "finger.yaml").write_text("tip_frame: finger_tip\ntip_radius: 0.01")
    text = second_arm.read_text().replace(
        "package://gridpush_drake/fingers/rod", f"file://{folder}"
    )
    second_arm.write_text(text)
    with pytest.raises(ScenarioError, match=r"tip_radius is 0\.01 m; expected 0\.008 m"):
        resolve(read_scenario(second_arm))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("tip_frame: tip", "tip_radius is missing; expected a positive number, in m"),
        ("tip_frame: tip\ntip_radius: -1", "tip_radius is -1; expected a positive number, in m"),
        ("tip_frame: tip\ntip_radios: 1", "tip_radios: unknown key; did you mean tip_radius"),
        ("- 1", "expected finger measures"),
    ],
)
def test_measures_that_will_not_do_are_refused(tmp_path, text, message):
    path = tmp_path / "finger.yaml"
    path.write_text(text)
    with pytest.raises(ScenarioError, match=message) as caught:
        read_measures(path, FingerMeasures)
    assert str(caught.value).startswith(str(path))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("base_frame: base", "base_frame: foot", "there is no frame arm::foot"),
        ("flange_frame: flange", "flange_frame: hand", "there is no frame arm::hand"),
        (
            "posture: [0.0, ",
            "posture: [",
            "posture in the robot.yaml of arm has 5 numbers; expected 6, one for each",
        ),
        (
            "stiffness: [3000.0, ",
            "stiffness: [",
            "stiffness in the robot.yaml of arm has 5 numbers; expected 6",
        ),
        (
            "  damping: [120",
            "  # damping: [120",
            "control.damping in the robot.yaml of arm is missing; expected a positive",
        ),
        (
            "stiffness: [3000.0, ",
            "stiffness: [-3000.0, ",
            "control.stiffness.* is -3000.0; expected a positive number",
        ),
        (
            "driver: position",
            "driver: ur",
            "control.driver is 'ur'; expected one of iiwa, position",
        ),
        (
            "home: [0.5, 0.0, 0.2]",
            "home: [1.5, 0.0, 0.2]",
            r"does not reach its home, \(1\.55, -0\.02, 0\.2\) m",
        ),
        (
            "robot.yaml",
            None,
            "there is no robot; expected a model in whose folder there is a robot",
        ),
    ],
)
def test_a_robot_that_is_not_there_is_refused(second_arm, old, new, message):
    path = second_arm.parent / "robot.yaml"
    if new is None:
        path.unlink()
    else:
        path.write_text(path.read_text().replace(old, new))
    with pytest.raises(ScenarioError, match=message) as caught:
        resolve(read_scenario(second_arm))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            ' lower=".*?" upper=".*?"',
            "",
            "joint other_joint_1 of arm has no limits; expected its model",
        ),
        (' velocity=".*?"', "", "joint other_joint_1 of arm has no limits; expected its model"),
        (
            '<transmission name="other_transmission_6.*?</transmission>',
            "",
            "joints of arm with a motor are .*_7; ",
        ),
    ],
)
def test_an_arm_whose_joints_will_not_do_is_refused(second_arm, old, new, message):
    path = second_arm.parent / "arm.urdf"
    path.write_text(re.sub(old, new, path.read_text(), count=1, flags=re.DOTALL))
    with pytest.raises(ScenarioError, match=message):
        resolve(read_scenario(second_arm))


def test_a_gripper_that_does_not_open_as_drakes_controller_has_it_is_refused(tmp_path):
    wsg, scene = find_models() / "grippers/wsg_50", find_models() / "scenes/iiwa_grasp.dmd.yaml"
    (tmp_path / "gripper.yaml").write_text((wsg / "gripper.yaml").read_text())
    (tmp_path / "wsg_50.urdf").write_text(
        (wsg / "wsg_50.urdf").read_text().replace('upper="0"', 'upper="0.01"')
    )
    text = scene.read_text().replace("package://gridpush_drake/grippers/wsg_50", tmp_path.as_uri())
    (tmp_path / "scenario.yaml").write_text(f"object_pose: [0.54, -0.06, 0.0]\n{text}")
    with pytest.raises(
        ScenarioError, match="gripper gripper does not open by two joints; expected the first"
    ):
        resolve(read_scenario(tmp_path / "scenario.yaml"))


@pytest.mark.parametrize("name", ["gantry", "iiwa14"])
def test_a_base_from_where_nothing_is_reached_is_refused(name, tmp_path):
    (scene,) = make_robot_directives(name, grasping=False)
    text = (
        find_models() / scene.add_directives.file.removeprefix("package://gridpush_drake/")
    ).read_text()
    if name == "iiwa14":
        text = (find_models() / "scenes/iiwa_finger.dmd.yaml").read_text()
        table = (find_models() / "scenes/iiwa_push.dmd.yaml").read_text()
        text += table[table.index("- add_model") :]
    base = {"gantry": "child: gantry::gantry_link_0", "iiwa14": "child: iiwa::iiwa_link_0"}[name]
    path = tmp_path / "scenario.yaml"
    path.write_text(text.replace(base, base + "\n    X_PC: {translation: [0.0, 0.0, 2.0]}"))
    with pytest.raises(ScenarioError, match="reach"):
        resolve(read_scenario(path))


@pytest.mark.parametrize(
    ("robot", "grasping", "message"),
    [
        (
            "pandaa",
            False,
            "robot pandaa is not known; did you mean panda.* gantry, iiwa14, panda, ur5e, xarm6",
        ),
        (
            "gantry",
            True,
            "robot gantry has no gripper: .*expected one of iiwa14, panda, ur5e, xarm6",
        ),
        ("/nowhere", False, "robot /nowhere is not known"),
    ],
)
def test_a_robot_that_cannot_be_had_is_refused(robot, grasping, message):
    with pytest.raises(ScenarioError, match=message):
        make_robot_directives(robot, grasping=grasping)


def test_a_folder_of_ones_own_names_its_scene(second_arm):
    for robot in (second_arm.parent, second_arm.with_name("robot.yaml")):
        directives = make_robot_directives(str(robot), grasping=False)
        assert find_robot(directives).arm_model == "arm"
        resolve(PushScenario(directives=directives, object_pose=[0.65, 0.0, 0.0]))
    with pytest.raises(ScenarioError, match="has no gripper"):
        make_robot_directives(str(second_arm.parent), grasping=True)


@pytest.mark.parametrize("welded", [True, False])
def test_a_ros_description_that_fixes_itself_to_the_world_stands_where_the_scene_says(
    tmp_path, welded
):
    """A URDF with a link `world` and a mesh in a package that its robot.yaml names."""
    folder = Path(shutil.copytree(find_models() / "robots/panda", tmp_path / "mine"))
    scene = find_models() / "scenes/panda_push.dmd.yaml"
    (folder / "meshes").mkdir()
    (folder / "meshes/box.obj").write_text("v 0 0 0\nv .1 0 0\nv 0 .1 0\nv 0 0 .1\nf 1 2 3\n")
    urdf = folder / "panda_primitives.urdf"
    fixed = (
        '<link name="world"/><joint name="fixed" type="fixed"><parent link="world"/>'
        '<child link="panda_link0"/><origin xyz="0.08 0.01 0"/></joint><link name="shown"><visual>'
        '<geometry><mesh filename="package://mine/meshes/box.obj"/></geometry></visual></link>'
        '<joint name="shows" type="fixed"><parent link="panda_link0"/><child link="shown"/></joint>'
    )
    urdf.write_text(urdf.read_text().replace("</robot>", fixed + "</robot>"))
    text = scene.read_text().replace("package://gridpush_drake/robots/panda", "package://mine")
    weld = "- add_weld:\n    parent: world\n    child: panda::panda_link0"
    place = "\n    X_PC:\n      translation: [0.08, 0.0, 0.0]"
    assert weld + place in text
    (folder / "scene.dmd.yaml").write_text(text if welded else text.replace(weld + place, ""))
    measures = (folder / "robot.yaml").read_text().partition("scenes:")[0]
    measures += "scenes: {push: scene.dmd.yaml}\npackages: {mine: .}\n"
    (folder / "robot.yaml").write_text(measures)
    (tmp_path / "cell.yaml").write_text("robot: mine\nobject_pose: [0.6, 0.0, 0.0]\n")

    resolved = resolve(read_scenario(tmp_path / "cell.yaml"))
    X_WR = resolved.X_WR.translation()
    np.testing.assert_allclose(X_WR, [0.08, 0.0 if welded else 0.01, 0.0], atol=1e-12)
    plant = resolved.control_plant
    base = plant.GetFrameByName("panda_link0").CalcPoseInWorld(plant.CreateDefaultContext())
    np.testing.assert_allclose(base.translation(), X_WR, atol=1e-12)


def test_a_copied_folder_whose_scene_has_the_robot_it_was_copied_from_is_refused(tmp_path):
    # The copy's own measures would be passed over.
    copied = Path(shutil.copytree(find_models() / "robots/ur5e", tmp_path / "mine"))
    message = r"mine/robot\.yaml: scenes\.push is package://.*, where the robot of .*ur5e stands"
    with pytest.raises(ScenarioError, match=message):
        make_robot_directives(str(copied), grasping=False)
