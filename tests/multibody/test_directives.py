"""What a scene's directives include is read within bounds, before Drake reads it."""

import os

import pytest
from pydrake.multibody.parsing import (
    AddDirectives,
    AddModel,
    AddWeld,
    ModelDirective,
    PackageMap,
)
from pydrake.multibody.plant import MultibodyPlant

from gridpush_drake.errors import ScenarioError
from gridpush_drake.multibody.parser import (
    MAX_DIRECTIVES,
    AddModelsPackage,
    MakePackageMap,
    MakeParser,
    ProcessDirectives,
    check_directives,
    check_model,
)
from gridpush_drake.station.robot.robot import find_robot, list_robots, make_robot_directives
from gridpush_drake.station.scene.resolve import resolve
from gridpush_drake.station.schema.scenario import PushScenario


def include(path):
    return ModelDirective(add_directives=AddDirectives(file=path.as_uri()))


def write(path, *included, rest=""):
    lines = [f"- add_directives: {{file: {other.as_uri()}}}\n" for other in included]
    path.write_text("directives:\n" + "".join(lines) + rest)
    return path


def check(*directives):
    package_map = PackageMap()
    AddModelsPackage(package_map)
    check_directives(directives, package_map)


def refuse(*directives):
    """What is said of directives, by the check and by whatever reads a scene."""
    with pytest.raises(ScenarioError) as said:
        check(*directives)
    with pytest.raises(ScenarioError) as read:
        find_robot(directives)
    assert str(read.value) == str(said.value)
    assert "\n" not in str(said.value)
    return str(said.value)


@pytest.mark.parametrize("robot", list_robots())
def test_the_scenes_that_ship_pass(robot):
    check(*make_robot_directives(robot, grasping=None))


def test_a_file_that_includes_itself_is_named(tmp_path):
    own = tmp_path / "own.dmd.yaml"
    write(own, own)
    assert f"{own} includes {own}; expected no file that includes itself" in refuse(include(own))


def test_a_circle_of_files_is_named_in_its_order(tmp_path):
    a, b, c = (tmp_path / f"{name}.dmd.yaml" for name in "abc")
    write(a, b)
    write(b, c)
    (tmp_path / "link.dmd.yaml").symlink_to(b)
    write(c, tmp_path / "link.dmd.yaml")
    assert f"{b} includes {c} includes {b}" in refuse(include(a))


def test_a_file_that_is_included_twice_is_no_circle(tmp_path):
    leaf = write(
        tmp_path / "leaf.dmd.yaml", rest="- add_frame: {name: f, X_PF: {base_frame: world}}\n"
    )
    check(include(write(tmp_path / "root.dmd.yaml", leaf, leaf)), include(leaf))


def test_files_that_multiply_are_refused(tmp_path):
    last = write(tmp_path / "0.dmd.yaml", rest="- add_weld: {parent: a, child: b}\n" * 4)
    for level in range(1, 40):
        last = write(tmp_path / f"{level}.dmd.yaml", last, last)
    assert f"more than {MAX_DIRECTIVES}" in refuse(include(last))


BOMB = "a: &a [1,1,1,1,1,1,1,1,1,1]\n" + "".join(
    f"{new}: &{new} [{','.join([f'*{old}'] * 10)}]\n"
    for old, new in zip("abcdefgh", "bcdefghi", strict=True)
)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (BOMB + "directives: []\n", "more than 500000 keys and values, its aliases written out"),
        ("directives: [", "is not valid YAML"),
        ("[" * 5000, "is nested too deeply"),
    ],
)
def test_an_included_file_is_read_within_the_bounds_of_any_other(tmp_path, text, said):
    inner = tmp_path / "inner.dmd.yaml"
    inner.write_text(text)
    assert said in refuse(include(write(tmp_path / "outer.dmd.yaml", inner)))


@pytest.mark.parametrize("kind", ["directives", "model"])
def test_a_pipe_or_a_device_is_not_waited_for(tmp_path, kind):
    pipe = tmp_path / "pipe.dmd.yaml"
    os.mkfifo(pipe)
    directive = include(pipe)
    if kind == "model":
        directive = ModelDirective(add_model=AddModel(file=pipe.as_uri(), name="m"))
    assert "is a pipe or a device" in refuse(directive)
    inner = write(tmp_path / "outer.dmd.yaml", pipe)
    assert "is a pipe or a device" in refuse(include(inner))


@pytest.mark.parametrize(
    ("name", "text"),
    [
        (
            "m.sdf",
            '<sdf version="1.7"><model name="a"><link name="l"/><include><uri>{url}</uri>'
            "<name>b</name></include></model></sdf>",
        ),
        ("m.xml", '<mujoco><include file="m.xml"/><worldbody/></mujoco>'),
    ],
)
def test_a_model_that_includes_itself_is_named(tmp_path, name, text):
    path = tmp_path / name
    path.write_text(text.format(url=path.as_uri()))
    assert refuse_model(path) == (
        f"directives: {path} includes {path}; expected no file that includes itself"
    )


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        (
            "m.sdf",
            '<sdf version="1.7"><model name="a"><include><uri>pipe</uri></include></model></sdf>',
            "is a pipe or a device, not a file; expected a model",
        ),
        (
            "m.urdf",
            '<robot name="r"><link name="l"><collision><geometry><mesh filename="pipe"/></geometry>'
            "</collision></link></robot>",
            "is a pipe or a device, not a file; expected a mesh",
        ),
        ("m.urdf", "<robot", "is not valid XML"),
        (
            "m.urdf",
            '<robot name="r"><mesh filename="package://no_such/a.obj"/></robot>',
            "package no_such is not known; expected its folder in the scenario or in the robot.yaml"
            " (packages: {no_such: FOLDER}), or the folder that it lies in, in the environment "
            "variable ROS_PACKAGE_PATH",
        ),
    ],
)
def test_the_files_of_a_model_are_checked_before_drake_reads_them(tmp_path, name, text, said):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / name).write_text(text)
    assert said in refuse_model(tmp_path / name)


def refuse_model(path):
    """What is said of a model, by the check and by whatever adds it to a scene with a robot."""
    url = path.as_uri()
    with pytest.raises(ScenarioError) as said:
        check_model(url, MakePackageMap())
    model = ModelDirective(add_model=AddModel(file=url, name="m"))
    scene = make_robot_directives("iiwa14", grasping=False)
    with pytest.raises(ScenarioError) as read:
        resolve(PushScenario(directives=[*scene, model]))
    assert str(read.value) == str(said.value)
    assert "\n" not in str(said.value)
    return str(said.value)


def test_a_whole_scene_is_checked_before_drake_reads_it(tmp_path):
    own = tmp_path / "own.dmd.yaml"
    write(own, own)
    with pytest.raises(ScenarioError, match="expected no file that includes itself"):
        resolve(PushScenario(directives=[include(own)]))


@pytest.mark.parametrize("told", ["scenario", "environment"])
def test_packages_are_found_as_the_user_says(tmp_path, monkeypatch, told):
    folder = tmp_path / "src/cell"
    folder.mkdir(parents=True)
    (folder / "package.xml").write_text("<package><name>cell</name></package>")
    write(folder / "a.dmd.yaml", rest="- add_frame: {name: f, X_PF: {base_frame: world}}\n")
    directive = ModelDirective(add_directives=AddDirectives(file="package://cell/a.dmd.yaml"))
    plant = MultibodyPlant(0.0)
    assert "package cell is not known; expected its folder in the scenario" in refuse(directive)
    packages = {"cell": str(folder)} if told == "scenario" else {}
    if told == "environment":
        monkeypatch.setenv("ROS_PACKAGE_PATH", f"{tmp_path / 'src'}")
    ProcessDirectives([directive], MakeParser(plant, packages))
    assert plant.HasFrameNamed("f")
    with pytest.raises(ScenarioError, match=r"packages\.cell is /nowhere, which is no folder"):
        MakeParser(plant, {"cell": "/nowhere"})


def test_what_is_wrong_otherwise_is_drakes_to_say(tmp_path):
    missing = ModelDirective(add_weld=AddWeld(parent="world", child="nobody::nothing"))
    check(missing)
    with pytest.raises(ScenarioError, match="nobody"):
        ProcessDirectives([missing], MakeParser(MultibodyPlant(0.0)))


def test_a_scene_of_old_finds_the_models_by_the_names_of_their_old_files(tmp_path):
    path = write(
        tmp_path / "old.dmd.yaml",
        rest="- add_model: {name: table, file: package://gridpush_drake/tables/round.sdf}\n",
    )
    check(include(path))
    plant = MultibodyPlant(0.0)
    ProcessDirectives([include(path)], MakeParser(plant))
    assert plant.HasBodyNamed("table")
