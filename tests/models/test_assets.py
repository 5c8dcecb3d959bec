"""Every file in models/ is read, and says what its comments say; new files are found by themselves."""

from functools import lru_cache
from pathlib import PurePath

import numpy as np
import pytest
from pydrake.geometry import Box, Capsule, Cylinder, Role, Sphere
from pydrake.math import RollPitchYaw
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import DiagramBuilder

from gridpush_drake.multibody.contact_material import (
    PARTNER_FRICTION,
    PARTNER_STIFFNESS,
    FindTableOutline,
    FindTableTops,
)
from gridpush_drake.multibody.parser import MakeParser, find_models
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import list_shipped_objects
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.station.scene.resolve import resolve
from gridpush_drake.station.schema.scenario import PushScenario
from gridpush_drake.station.schema.scenario_file import read_scenario, write_scenario

FILES = sorted(
    path.relative_to(find_models()).as_posix()
    for path in find_models().rglob("*")
    if path.is_file()
)
SCENES = [file for file in FILES if file.startswith("scenes/")]
SCENARIOS = [file for file in FILES if file.startswith("scenarios/")]
OBJECTS = [file for file in FILES if file.startswith("objects/")]
MEASURES = [
    file for file in FILES if file.endswith(("/robot.yaml", "/finger.yaml", "/gripper.yaml"))
]
LOGS = [file for file in FILES if file.startswith("logs/")]
MODELS = [file for file in FILES if file.endswith((".sdf", ".urdf"))]
ARMS = ("iiwa", "panda", "gantry", "ur5e", "xarm6")
ROBOTS = [file for file in MODELS if file.startswith("robots/")]
TABLE_SCENES = [file for file in SCENES if "name: table" in (find_models() / file).read_text()]


@lru_cache(maxsize=16)
def parse(file):
    """The plant with a model or scene, the scene graph and the Diagram; nothing changes them."""
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.002)
    parser = MakeParser(plant)
    parser.SetStrictParsing()
    parser.AddModelsFromUrl(f"package://gridpush_drake/{file}")
    plant.Finalize()
    return plant, scene_graph, builder.Build()


def half_size(shape):
    """(3,) of the box about a primitive, m."""
    if isinstance(shape, Box):
        return np.array(shape.size()) / 2
    if isinstance(shape, Cylinder):
        return np.array([shape.radius(), shape.radius(), shape.length() / 2])
    if isinstance(shape, Capsule):
        return np.array([shape.radius(), shape.radius(), shape.length() / 2 + shape.radius()])
    return np.full(3, shape.radius())


def test_every_file_is_of_a_kind_that_is_tested():
    known = {"package.xml", *SCENES, *SCENARIOS, *OBJECTS, *MODELS, *MEASURES, *LOGS}
    assert set(FILES) == known
    assert all(file.endswith(".dmd.yaml") for file in SCENES)
    assert min(map(len, (SCENES, SCENARIOS, OBJECTS, MODELS))) > 1


@pytest.mark.parametrize("file", MODELS)
def test_model_is_parsed_without_a_warning_and_needs_no_other_file(file):
    plant, scene_graph, _ = parse(file)
    inspector = scene_graph.model_inspector()
    shapes = {
        type(inspector.GetShape(geometry)).__name__ for geometry in inspector.GetAllGeometryIds()
    }
    assert plant.num_bodies() > 1
    assert inspector.NumGeometriesWithRole(Role.kIllustration) > 0
    assert not shapes & {"Mesh", "Convex"}


@pytest.mark.parametrize("file", MODELS)
def test_inertia_is_that_of_a_body_within_the_shapes(file):
    """Radii of gyration are no larger than the shapes reach from the center of mass."""
    plant, scene_graph, _ = parse(file)
    inspector = scene_graph.model_inspector()
    context = plant.CreateDefaultContext()
    for index in range(1, plant.num_bodies()):  # 0 is the world
        body = plant.get_body(BodyIndex(index))
        geometries = plant.GetVisualGeometriesForBody(body)
        mass = body.get_mass(context)
        if not mass or not geometries:
            continue
        inertia = body.CalcSpatialInertiaInBodyFrame(context)
        p_BC, G = (
            inertia.get_com(),
            inertia.Shift(inertia.get_com()).CopyToFullMatrix6()[:3, :3] / mass,
        )
        reach = max(
            np.linalg.norm(inspector.GetPoseInFrame(geometry).translation() - p_BC)
            + np.linalg.norm(half_size(inspector.GetShape(geometry)))
            for geometry in geometries
        )
        assert inertia.IsPhysicallyValid()
        assert np.sqrt(np.trace(G) / 2) < reach, body.name()


def surface(shape):
    """Points on a shape's surface, in its frame."""
    turns = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    ring = np.column_stack([np.cos(turns), np.sin(turns), 0 * turns])
    up = np.array([0, 0, 1.0])
    if isinstance(shape, Box):
        corners = np.array(np.meshgrid([-0.5, 0.5], [-0.5, 0.5], [-0.5, 0.5])).reshape(3, -1).T
        return corners * [shape.width(), shape.depth(), shape.height()]
    if isinstance(shape, Cylinder):
        return np.vstack([shape.radius() * ring + s * shape.length() * up for s in (-0.5, 0, 0.5)])
    length = shape.length() if isinstance(shape, Capsule) else 0.0
    assert isinstance(shape, Capsule | Sphere)
    caps = []
    for lift in np.linspace(0, np.pi / 2, 7):
        for side in (-1, 1):
            z = side * (length / 2 + shape.radius() * np.sin(lift))
            caps.append(shape.radius() * np.cos(lift) * ring + z * up)
    return np.vstack(caps)


@pytest.mark.parametrize("file", ROBOTS)
def test_collision_shapes_of_an_arm_contain_the_visible_ones(file):
    plant, scene_graph, diagram = parse(file)
    root = diagram.CreateDefaultContext()
    context, inspector = plant.GetMyContextFromRoot(root), scene_graph.model_inspector()
    query = scene_graph.get_query_output_port().Eval(scene_graph.GetMyContextFromRoot(root))
    count = 0
    for index in plant.GetBodyIndices(plant.GetModelInstanceByName(file.split("/")[1])):
        body = plant.get_body(index)
        own = set(plant.GetCollisionGeometriesForBody(body))
        X_WL = plant.EvalBodyPoseInWorld(context, body)
        for visual in plant.GetVisualGeometriesForBody(body):
            X_WG = X_WL @ inspector.GetPoseInFrame(visual)
            for p in surface(inspector.GetShape(visual)):
                near = query.ComputeSignedDistanceToPoint(X_WG @ p)
                assert min(d.distance for d in near if d.id_G in own) < 1e-6, inspector.GetName(
                    visual
                )
                count += 1
    assert count > (90 if "gantry" in file else 1000)  # a box has its corners only


@pytest.mark.parametrize("file", SCENES)
def test_scene_is_parsed_and_starts_without_contact(file):
    plant, scene_graph, diagram = parse(file)
    context = diagram.CreateDefaultContext()
    query = scene_graph.get_query_output_port().Eval(scene_graph.GetMyContextFromRoot(context))
    assert [name for name in ARMS if plant.HasModelInstanceNamed(name)] == [
        file.split("/")[1].split("_")[0]
    ]
    assert not query.ComputePointPairPenetration()


@pytest.mark.parametrize("file", SCENES)
def test_scene_starts_with_the_finger_or_the_gripper_down_over_the_table(file):
    plant, _, _ = parse(file)
    closed = "panda_hand_tip" if "panda" in file else "tip"
    tip = closed if file.endswith("_gripper.dmd.yaml") else "finger_tip"
    X_WP = plant.GetFrameByName(tip).CalcPoseInWorld(plant.CreateDefaultContext())
    assert (
        np.abs(
            X_WP.rotation().matrix() - RollPitchYaw(0.0, np.pi, 0.0).ToRotationMatrix().matrix()
        ).max()
        < 1e-9
    )
    # A gripper is wide, and begins where it hides nothing in the middle of the table.
    side = 0.3 if tip != "finger_tip" else 0.0
    assert np.allclose(X_WP.translation(), [0.5, side, 0.2], atol=0.01)


def test_scenes_come_with_and_without_a_gripper():
    able = [file for file in TABLE_SCENES if parse(file)[0].HasModelInstanceNamed("gripper")]
    pushing = [f"scenes/{arm}_gripper.dmd.yaml" for arm in ("iiwa", "panda", "ur5e", "xarm6")]
    assert [file for file in able if not parse(file)[0].HasModelInstanceNamed("finger")] == pushing
    able = [file for file in able if file not in pushing]
    grasping = ("iiwa_grasp", "iiwa_grasp_heavy", "panda_grasp", "ur5e_grasp", "xarm6_grasp")
    assert able == [f"scenes/{name}.dmd.yaml" for name in grasping]
    assert len(TABLE_SCENES) >= 5


@pytest.mark.parametrize(
    ("file", "bounds", "area"),
    [
        ("scenes/iiwa_push.dmd.yaml", (0.2, -0.6, 1.0, 0.6), 0.8 * 1.2),
        ("scenes/iiwa_push_round.dmd.yaml", (0.15, -0.5, 1.15, 0.5), np.pi * 0.25),
        ("scenes/iiwa_grasp.dmd.yaml", (0.2, -1.05, 1.0, 0.15), 0.8 * 1.2),
    ],
)
def test_table_is_as_large_as_it_is_said_to_be(file, bounds, area):
    plant, scene_graph, _ = parse(file)
    outline = FindTableOutline(plant, scene_graph.model_inspector())
    assert outline.bounds == pytest.approx(bounds, abs=1e-9)
    assert outline.area == pytest.approx(area, rel=1e-5)


@pytest.mark.parametrize("file", TABLE_SCENES)
def test_table_top_is_a_stiff_partner_for_feet(file):
    plant, scene_graph, _ = parse(file)
    inspector = scene_graph.model_inspector()
    for geometry in FindTableTops(plant, inspector):
        properties = inspector.GetProximityProperties(geometry)
        friction = properties.GetProperty("material", "coulomb_friction")
        assert friction.static_friction() == friction.dynamic_friction() == PARTNER_FRICTION
        assert properties.GetProperty("material", "point_contact_stiffness") == PARTNER_STIFFNESS


@pytest.mark.parametrize("file", LOGS)
def test_log_is_of_a_shipped_object_that_was_moved(file):
    log = PushLog.read_csv(find_models() / file)
    assert PurePath(file).stem in list_shipped_objects()
    assert all(np.abs(seen.final_pose - seen.pose).max() > 1e-3 for seen in log)


@pytest.mark.parametrize("file", SCENARIOS)
def test_scenario_is_read_and_makes_sense(file):
    resolve(read_scenario(find_models() / file))


def test_default_scenario_shows_every_field_as_it_is_by_default(tmp_path):
    scenario = read_scenario(find_models() / "scenarios/default.yaml")
    for name, written in (("file", scenario), ("default", PushScenario())):
        write_scenario(tmp_path / name, written)
    text = (tmp_path / "default").read_text()
    assert (tmp_path / "file").read_text() == text
    assert (find_models() / "scenarios/default.yaml").read_text().endswith(text)


@pytest.mark.parametrize("file", OBJECTS)
def test_object_is_read(file):
    obj = GridObject.from_yaml(find_models() / file)
    assert file == f"objects/{obj.name}.yaml"
    assert obj.n > 1
