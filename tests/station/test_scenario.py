"""Scenarios: read, written, checked."""

import shutil
from math import pi, radians
from pathlib import Path

import numpy as np
import pytest
from pydrake.geometry import Sphere
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.inverse_kinematics import InverseKinematics
from pydrake.multibody.parsing import AddModel, ModelDirective
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.solvers import Solve
from pydrake.systems.framework import DiagramBuilder

from gridpush_drake.errors import OutputError, ScenarioError
from gridpush_drake.identification.learning import describe_prior
from gridpush_drake.identification.model_file import read_model, write_model
from gridpush_drake.multibody.contact_material import FindTableOutline
from gridpush_drake.multibody.parser import MakeParser, find_models
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import list_shipped_objects
from gridpush_drake.station.robot.robot import find_robot
from gridpush_drake.station.scene.contents import AddScene, load_object
from gridpush_drake.station.scene.resolve import resolve
from gridpush_drake.station.schema.scenario import PartTruth, PushScenario, TruthConfig
from gridpush_drake.station.schema.scenario_file import (
    find_scenario,
    format_scenario,
    list_shipped_scenarios,
    parse_scenario,
    read_scenario,
    write_scenario,
)
from tests.helpers.shapes import rectangle

ROUND = "package://gridpush_drake/scenes/iiwa_push_round.dmd.yaml"


def read(tmp_path, text, child_name=None):
    path = tmp_path / "scenario.yaml"
    path.write_text(text)
    return read_scenario(path, child_name=child_name)


def text_of(tmp_path, scenario):
    write_scenario(tmp_path / "written.yaml", scenario, force=True)
    return (tmp_path / "written.yaml").read_text()


def write_rectangle(path, length, width):
    GridObject.from_outline(rectangle(length, width), name="slab", max_cells=20).write_yaml(path)
    return str(path)


def test_what_is_not_said_is_as_by_default(tmp_path):
    scenario = read(tmp_path, "version: 1")
    assert text_of(tmp_path, scenario) == text_of(tmp_path, PushScenario())
    assert scenario.object == "claw_hammer"
    assert scenario.camera.angle_noise == radians(0.2)


def test_fields_of_every_kind_are_read(tmp_path):
    scenario = read(
        tmp_path,
        "{object: pliers, object_pose: [0.5, 1e-1, -1], base: planar, pokes: {count: 3, distance: [5e-2, 0.1]}, "
        "truth: {friction_by_part: true, parts: [{label: 2, friction: 0.3}]}, seed: 7, "
        f"directives: [{{add_directives: {{file: '{ROUND}'}}}}]}}",
    )
    assert (scenario.object, scenario.base, scenario.seed) == ("pliers", "planar", 7)
    assert scenario.object_pose == [0.5, 0.1, -1.0]
    assert (scenario.pokes.count, scenario.pokes.distance) == (3, [0.05, 0.1])
    assert scenario.truth.parts == [PartTruth(label=2, friction=0.3)]
    assert scenario.truth.friction_by_part
    assert [directive.add_directives.file for directive in scenario.directives] == [ROUND]


def test_what_was_written_is_read_back(tmp_path):
    scenario = PushScenario(object="toolbox", object_pose=[0.5, 1 / 3, pi], base="planar", seed=3)
    scenario.truth.parts = [PartTruth(label=1, cell_mass=0.01)]
    scenario.directives += [
        ModelDirective(add_model=AddModel(name="x", file="package://gridpush_drake/x.sdf"))
    ]
    again = read(tmp_path, text_of(tmp_path, scenario))
    assert again.object_pose == scenario.object_pose
    assert again.truth == scenario.truth
    assert text_of(tmp_path, again) == text_of(tmp_path, scenario)


def test_a_file_is_not_overwritten_unasked(tmp_path):
    path = tmp_path / "scenario.yaml"
    write_scenario(path, PushScenario())
    with pytest.raises(OutputError, match="exists already"):
        write_scenario(path, PushScenario(seed=1))
    write_scenario(path, PushScenario(seed=1), force=True)
    assert read_scenario(path).seed == 1


def test_a_scenario_that_will_not_do_is_not_written(tmp_path):
    scenario = PushScenario()
    scenario.camera.rate = 0.0
    with pytest.raises(
        ScenarioError, match=r"camera\.rate is 0\.0; expected a positive number, in Hz"
    ):
        write_scenario(tmp_path / "scenario.yaml", scenario)
    assert not list(tmp_path.iterdir())


def test_one_of_several_is_picked_by_its_name(tmp_path):
    text = "_common: &common {base: planar}\nfirst: {seed: 1}\nsecond: {<<: *common, seed: 2}"
    assert read(tmp_path, text, "first").seed == 1
    second = read(tmp_path, text, "second")
    assert (second.base, second.seed) == ("planar", 2)
    with pytest.raises(ScenarioError, match="no scenario secnd; did you mean second"):
        read(tmp_path, text, "secnd")
    with pytest.raises(ScenarioError, match="first: unknown key"):
        read(tmp_path, text)
    with pytest.raises(
        ScenarioError, match=r"scenario\.yaml, first: sed: unknown key; did you mean seed"
    ):
        read(tmp_path, "first: {sed: 1}", "first")


def test_an_object_file_is_looked_up_beside_the_scenario(tmp_path, monkeypatch):
    write_rectangle(tmp_path / "slab.yaml", 0.2, 0.1)
    monkeypatch.chdir("/")
    scenario = read(tmp_path, "object: slab.yaml")
    assert load_object(scenario).name == "slab"
    again = tmp_path / "elsewhere"
    again.mkdir()
    write_scenario(again / "scenario.yaml", scenario)
    assert load_object(read_scenario(again / "scenario.yaml")).name == "slab"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("camra: {rate: 3}", "camra: unknown key; did you mean camera?"),
        (
            "camera: {rte: 3}",
            r"camera\.rte: unknown key; did you mean rate\? expected one of kind, rate, position_noise",
        ),
        (
            "truth: {parts: [{lable: 3}]}",
            r"truth\.parts\[0\]\.lable: unknown key; did you mean label",
        ),
        (
            "directives: [{add_modle: {}}]",
            r"directives\[0\]\.add_modle: unknown key; did you mean add_model",
        ),
        (
            "directives: [{add_model: {fil: x}}]",
            r"directives\[0\]\.add_model\.fil: unknown key; did you mean file",
        ),
        ("1: 2", "1: unknown key"),
        (
            "finger: {tip_radius: 0.01}",
            r"finger\.tip_radius: .*tip_radius in finger\.yaml beside the finger's model",
        ),
        ("camera: {rate: fast}", r"camera\.rate is 'fast'; expected a positive number, in Hz"),
        ("camera: {rate: -1}", r"camera\.rate is -1; expected a positive number, in Hz"),
        ("camera: {rate: .nan}", r"camera\.rate is nan; expected a positive number"),
        ("camera: {rate: true}", r"camera\.rate is True; expected a positive number"),
        ("camera: {rate: [1, 2]}", r"camera\.rate is \[1, 2\]; expected a positive number"),
        (
            "camera: {position_noise: -0.1}",
            r"camera\.position_noise is -0\.1; expected a number, 0 or more, in m",
        ),
        ("camera:", "camera is empty; expected `key: value` lines"),
        ("camera: 3", "camera is 3; expected `key: value` lines"),
        ("seed: 1.5", r"seed is 1\.5; expected a whole number, 0 or more"),
        ("seed: -1", "seed is -1; expected a whole number, 0 or more"),
        ("object: 3", "object is 3; expected the name of a shipped object"),
        ("object: ''", "object is ''; expected the name of a shipped object"),
        ("object_pose: [1, 2]", r"object_pose is \[1, 2\]; expected \[x, y, theta\], in m and rad"),
        (
            "object_pose: [1, 2, a]",
            r"object_pose\[2\] is 'a'; expected \[x, y, theta\], in m and rad",
        ),
        ("object_pose: 1", r"object_pose is 1; expected \[x, y, theta\]"),
        ("base: loose", "base is 'loose'; expected one of free, planar"),
        (
            "pokes: {distance: [0.2, 0.1]}",
            r"pokes\.distance is \[0\.2, 0\.1\]; expected \[least, greatest\], positive",
        ),
        ("pokes: {slant: 2}", r"pokes\.slant is 2; expected an angle"),
        ("pokes: {count: 0}", r"pokes\.count is 0; expected a whole number, 1 or more"),
        (
            "truth: {support: jelly}",
            r"truth\.support is 'jelly'; expected one of own_weight, foundation, three_feet",
        ),
        (
            "truth: {friction: [0, 1]}",
            r"truth\.friction is \[0, 1\]; expected \[least, greatest\], positive",
        ),
        (
            "truth: {parts: [{label: 1, friction: 0}]}",
            r"truth\.parts\[0\]\.friction is 0; expected a positive",
        ),
        (
            "simulation: {answer_delay: -0.1}",
            r"simulation\.answer_delay is -0.1; expected a number of seconds",
        ),
        (
            "simulation: {answer_delay: soon}",
            r"simulation\.answer_delay is 'soon'; expected a number of seconds",
        ),
        (
            "simulation: {time_step: 0}",
            r"simulation\.time_step is 0; expected a positive number, in s",
        ),
        ("workspace: {x: [1, 0]}", r"workspace\.x is \[1, 0\]; expected \[least, greatest\]"),
        ("directives: 3", "directives is 3; expected a list"),
        (
            "directives: [{add_weld: {parent: a, child: b, X_PC: {rotation: !Rpi {deg: [1, 2, 3]}}}}]",
            "directives: .*Rpi",
        ),
        ("version: 0\ncamra: 1", "version is 0, an older schema; this release reads version 1"),
        ("version: 2", "version is 2, a newer schema"),
        ("version: one", "version is 'one'; expected a whole number"),
        ("seed: 1\nseed: 2", "line 2, column 1: .*key 'seed' occurs twice"),
        ("camera: {\n  rate: 1,\n  rate: 2}", "line 3, column 3: .*key 'rate' occurs twice"),
        ("seed: [", r"line \d+, column \d+: is not valid YAML"),
        ("", "is empty; expected a scenario"),
        ("- 1", "does not consist of `key: value` lines; expected a scenario"),
    ],
)
def test_what_will_not_do_is_refused_by_file_field_and_form(tmp_path, text, message):
    with pytest.raises(ScenarioError, match=message) as caught:
        read(tmp_path, text)
    assert str(caught.value).startswith(str(tmp_path / "scenario.yaml"))


def test_a_robot_stands_for_the_scene_that_it_names(tmp_path):
    panda = read(tmp_path, "robot: panda\nseed: 3")
    assert (find_robot(panda.directives).arm_model, panda.seed) == ("panda", 3)
    assert find_robot(panda.directives).gripper is not None
    assert find_robot(read(tmp_path, "robot: gantry").directives).gripper is None
    assert "panda_grasp" in text_of(tmp_path, panda)
    # a robot in a folder of one's own, with a scene in which its own model stands
    own = Path(shutil.copytree(find_models() / "robots/panda", tmp_path / "own"))
    scene = (find_models() / "scenes/panda_grasp.dmd.yaml").read_text()
    shipped = "package://gridpush_drake/robots/panda"
    (own / "scene.dmd.yaml").write_text(scene.replace(shipped, own.as_uri()))
    measures = (own / "robot.yaml").read_text()
    for kind in ("push", "grasp"):
        measures = measures.replace(
            f"package://gridpush_drake/scenes/panda_{kind}.dmd.yaml", "scene.dmd.yaml"
        )
    (own / "robot.yaml").write_text(measures)
    assert find_robot(read(tmp_path, "robot: own").directives).arm_model == "panda"
    for text, message in (
        ("robot: pnda", "robot pnda is not known; did you mean panda"),
        ("robot: 3", "robot is 3; expected a robot's name"),
        (
            "robot: panda\ndirectives: []",
            "robot and directives are both given; expected one of them",
        ),
    ):
        with pytest.raises(ScenarioError, match=message):
            read(tmp_path, text)


def test_a_shipped_scenario_is_found_by_its_old_name():
    assert find_scenario("grasp_untold") == find_scenario("grasp_unknown_inertia")


def test_a_shipped_scenario_goes_by_its_name(tmp_path, monkeypatch):
    shipped = [
        "default",
        "fetch",
        "fetch_three",
        "fetch_two",
        "grasp",
        "grasp_heavy",
        "grasp_unknown_inertia",
        "line",
        "planar",
        "rearrange",
        "round_table",
        "separate",
        "slalom",
        "two_objects",
    ]
    assert list_shipped_scenarios() == shipped
    for name in list_shipped_scenarios():
        by_file = read_scenario(find_models() / "scenarios" / f"{name}.yaml")
        assert format_scenario(read_scenario(name)) == format_scenario(by_file)
    for name, message in (
        ("grsp", "grsp: no shipped scenario has this name, and no file; did you mean grasp?"),
        ("cup", f"cup: .*no file. Shipped are: {', '.join(shipped)}$"),
        ("", "no shipped scenario has this name"),
    ):
        with pytest.raises(ScenarioError, match=message):
            read_scenario(name)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "planar").mkdir()  # a folder is no scenario
    assert read_scenario("planar").base == "planar"
    (tmp_path / "grasp").write_text("seed: 77")
    assert read_scenario("grasp").seed == 77  # a file goes before what is shipped


def test_a_file_that_cannot_be_read_is_named(tmp_path):
    with pytest.raises(ScenarioError, match=r"none\.yaml: cannot be read: No such file"):
        read_scenario(tmp_path / "none.yaml")
    with pytest.raises(ScenarioError, match="is a folder; expected a scenario"):
        read_scenario(tmp_path)
    (tmp_path / "latin.yaml").write_bytes(b"object: caf\xe9")
    with pytest.raises(ScenarioError, match="not UTF-8"):
        read_scenario(tmp_path / "latin.yaml")


@pytest.mark.parametrize("name", list_shipped_objects())
def test_every_shipped_object_lies_on_the_default_table(name):
    resolve(PushScenario(object=name))


def directives(*files):
    return [ModelDirective(add_model=AddModel(name=name, file=file)) for name, file in files]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"object": "claw_hamer"},
            "object: claw_hamer: no shipped object .*did you mean claw_hammer",
        ),
        ({"object": "nowhere.yaml"}, r"object: nowhere\.yaml: cannot be read"),
        (
            {"object_pose": [0.3, 0, 0]},
            r"object_pose is \[0\.3, 0, 0\]: .*x 0\.2 to 1 m and y -0\.6 to 0\.6 m",
        ),
        ({"object_pose": [3.0, 0, 0]}, "object_pose is .* not wholly on the table"),
        ({"object_pose": [0.6, 0, 90]}, "object_pose is .*90.*; expected .* rad"),
        (
            {"object_height": 0.01},
            r"finger\.push_height is 0\.012 m; expected more than the tip's radius, 0\.008 m",
        ),
        (
            {"object_height": 0.2},
            r"finger\.travel_height is 0\.12 m; expected more than .*0\.208 m",
        ),
        ({"base": "fre"}, "base is 'fre'; expected one of free, planar"),
        ({"camera": None}, "camera is empty; expected `key: value` lines"),
        ({"seed": "1"}, "seed is '1'; expected a whole number"),
        ({"directives": []}, "directives: there is no robot; expected a model"),
        (
            {"directives": directives(("x", "package://gridpush_drake/no.urdf"))},
            r"directives: .*no\.urdf",
        ),
    ],
)
def test_a_scenario_that_makes_no_sense_is_refused(changes, message):
    with pytest.raises(ScenarioError, match=message):
        resolve(PushScenario(**changes))


@pytest.mark.parametrize(
    ("place", "value", "message"),
    [
        (
            "workspace.x",
            [0.9, 1.2],
            r"workspace is out of the arm's reach; .*between 0\.41 and 0\.82 m",
        ),
        ("workspace.x", [0.0, 0.1], "workspace does not contain the object's position"),
        (
            "workspace.y",
            [0.1, 0.2],
            r"workspace does not contain the object's position, \(0\.6, 0\) m",
        ),
        (
            "truth.parts",
            [PartTruth(label=9)],
            r"truth\.parts\[0\]\.label is 9; expected a part of claw_hammer: one of 1, 2",
        ),
        (
            "truth.parts",
            [PartTruth(label=1), PartTruth(label=1)],
            r"truth\.parts\[1\]\.label is 1 once more",
        ),
        ("truth.friction", [20.0, 30.0], r"truth\.support: claw_hammer: found no three feet"),
    ],
)
def test_a_part_of_a_scenario_that_makes_no_sense_is_refused(place, value, message):
    scenario = PushScenario()
    scenario.truth.support = "three_feet"
    group, name = place.split(".")
    setattr(getattr(scenario, group), name, value)
    with pytest.raises(ScenarioError, match=message):
        resolve(scenario)


def test_only_a_free_object_stands_on_other_than_its_own_weight():
    scenario = PushScenario(base="planar", truth=TruthConfig(support="foundation"))
    with pytest.raises(
        ScenarioError, match=r"truth\.support is foundation and base planar; expected base free"
    ):
        resolve(scenario)


def test_an_object_that_lies_on_the_table_nowhere_is_larger_than_it(tmp_path):
    large = write_rectangle(tmp_path / "large.yaml", 1.3, 0.9)
    with pytest.raises(
        ScenarioError,
        match=r"object: slab, 1\.30 x 0\.90 m, is larger than the table, 0\.80 x 1\.20 m",
    ):
        resolve(PushScenario(object=large))
    long = write_rectangle(tmp_path / "long.yaml", 1.1, 0.1)  # fits when it is turned
    with pytest.raises(ScenarioError, match="object_pose is"):
        resolve(PushScenario(object=long, object_pose=[0.6, 0.0, 0.0]))
    resolve(PushScenario(object=long, object_pose=[0.6, 0.0, pi / 2]))


def test_the_tables_edge_is_where_the_check_has_it():
    """A pose 1 mm inside the edge passes, 1 mm beyond it does not."""
    scenario = PushScenario(object="toolbox", object_pose=[0.6, 0.0, 0.0])
    outline = load_object(scenario).outline
    for x, passes in (
        (1.0 - outline.bounds[2] - 1e-3, True),
        (1.0 - outline.bounds[2] + 1e-3, False),
    ):
        scenario.object_pose = [x, 0.0, 0.0]
        scenario.workspace.x = [0.3, 1.2]
        if passes:
            resolve(scenario)
        else:
            with pytest.raises(ScenarioError, match="object_pose is"):
                resolve(scenario)


def test_a_table_may_be_turned_and_moved_and_of_several_pieces():
    """Two boxes that meet, on a table turned by 90 degrees; what does not end at z = 0 is left out."""
    sdf = """<sdf version="1.9"><model name="table"><link name="table">
    <collision name="a"><pose>0 0 -.1 0 0 0</pose><geometry><box><size>1 .4 .2</size></box></geometry></collision>
    <collision name="b"><pose>.25 .4 -.1 0 0 0</pose><geometry><box><size>.5 .4 .2</size></box></geometry></collision>
    <collision name="c"><pose>0 0 -.5 0 0 0</pose><geometry><box><size>2 2 .2</size></box></geometry></collision>
    </link></model></sdf>"""
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.001)
    MakeParser(plant).AddModelsFromString(sdf, "sdf")
    turned = RotationMatrix.MakeZRotation(pi / 2)
    plant.WeldFrames(
        plant.world_frame(), plant.GetFrameByName("table"), RigidTransform(turned, [0.5, 0.0, 0.0])
    )
    plant.Finalize()
    outline = FindTableOutline(plant, scene_graph.model_inspector())
    assert outline.geom_type == "Polygon"
    assert outline.area == pytest.approx(0.4 + 0.2)
    assert outline.bounds == pytest.approx((-0.1, -0.5, 0.7, 0.5))


@pytest.mark.parametrize("height", [0.012, 0.2])
def test_reach_is_the_arms(height):
    """Inverse kinematics with the tool down finds a posture just within both radii, and none just beyond."""
    plant = MultibodyPlant(0.001)
    AddScene(MakeParser(plant), PushScenario())
    plant.Finalize()
    least, greatest = find_robot(PushScenario().directives).arm.reach.calc_ring(0.16, height)
    reached = {
        radius: reaches(plant, [radius, 0.0, height])
        for radius in (least - 0.005, least + 0.005, greatest - 0.005, greatest + 0.005)
    }
    assert list(reached.values()) == [False, True, True, False]


def reaches(plant, p_WP):
    tip, down = plant.GetFrameByName("finger_tip"), plant.world_frame()
    rng = np.random.default_rng(0)
    for _ in range(5):
        ik = InverseKinematics(plant)
        ik.AddPositionConstraint(tip, [0, 0, 0], plant.world_frame(), p_WP, p_WP)
        ik.AddAngleBetweenVectorsConstraint(tip, [0, 0, 1], down, [0, 0, -1], 0, 1e-4)
        guess = np.array([0, 0.5, 0, -1.8, 0, 0.9, 0]) + rng.uniform(-0.3, 0.3, 7)
        ik.prog().SetInitialGuess(ik.q(), guess)
        if Solve(ik.prog()).is_success():
            return True
    return False


def test_the_scenarios_finger_is_the_models():
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.001)
    AddScene(MakeParser(plant), PushScenario())
    (geometry,) = plant.GetCollisionGeometriesForBody(plant.GetBodyByName("finger_tip"))
    shape = scene_graph.model_inspector().GetShape(geometry)
    assert isinstance(shape, Sphere)
    assert shape.radius() == find_robot(PushScenario().directives).finger.tip_radius


def test_friction_is_what_object_file_and_scenario_both_allow(tmp_path):
    def bounds(text):
        prior = load_object(read(tmp_path, text)).prior
        return prior.friction_min, prior.friction, prior.friction_max

    slab = tmp_path / "slab.yaml"
    slab.write_text(
        "name: slab\noutline: [[0, 0], [0.1, 0], [0.1, 0.05], [0, 0.05]]\nmax_cells: 20\n"
        "friction: {prior: 0.5, min: 0.25, max: 0.7}\n"
    )
    assert bounds("object: slab.yaml") == (0.25, 0.5, 0.7)
    assert bounds("{object: slab.yaml, object_friction: null}") == (0.25, 0.5, 0.7)
    assert bounds("{object: slab.yaml, object_friction: [0.1, 0.6]}") == (0.25, 0.5, 0.6)
    assert bounds("{object: slab.yaml, object_friction: [0.3, 0.4]}") == (0.3, 0.4, 0.4)
    for text, form in (
        ("[0.8, 0.9]", "overlaps.*0.25 to 0.7"),
        ("[0.4, 0.3]", "least, greatest"),
        ("0.3", "object_fr"),
    ):
        with pytest.raises(ScenarioError, match=form):
            load_object(read(tmp_path, f"{{object: slab.yaml, object_friction: {text}}}"))


def test_one_friction_range_from_the_scenario_to_the_model(tmp_path):
    """What the robot is told is what the object's file, the model, its reading and its report say."""
    obj = resolve(read_scenario(find_models() / "scenarios/grasp.yaml")).obj
    obj.write_yaml(tmp_path / "object.yaml")
    again = GridObject.from_yaml(tmp_path / "object.yaml")
    write_model(tmp_path / "model.yaml", describe_prior(again))
    model = read_model(tmp_path / "model.yaml")
    for known in (obj, again, model.obj):
        assert (known.prior.friction_min, known.prior.friction_max) == (0.3, 0.4)
    assert "friction coefficients anywhere from 0.3 to 0.4" in " ".join(
        model.identifiability.statements
    )


def test_a_key_by_its_old_name_is_read():
    path = Path("old.yaml")
    assert parse_scenario(path, "nothing_told: true\n").unknown_inertia
    with pytest.raises(ScenarioError, match="nothing_told and unknown_inertia are both given"):
        parse_scenario(path, "nothing_told: true\nunknown_inertia: true\n")
