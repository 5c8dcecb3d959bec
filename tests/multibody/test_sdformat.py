"""A grid object as an SDFormat or URDF file: Drake's parser makes the same body of it, and it moves the same."""

import numpy as np
import pytest
from pydrake.geometry import Box, Sphere
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from gridpush_drake.bench.worlds.plant import STICTION_TOLERANCE, TIME_STEP, AddPusher, PlantWorld
from gridpush_drake.dynamics.push import Push
from gridpush_drake.errors import ObjectError, OutputError, ParameterError
from gridpush_drake.identification.model import Model
from gridpush_drake.multibody.grid_object import SPHERE_RADIUS, MakeSpatialInertia
from gridpush_drake.multibody.sdformat import WriteSdf, WriteUrdf, make_sdf
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from tests.helpers.plant_object import add_table, parse_sdf
from tests.helpers.shapes import make_shape

RADIUS = 0.008


@pytest.fixture(scope="module")
def obj():
    return make_shape("claw_hammer", 60)


@pytest.fixture(scope="module")
def params(obj):
    rng = np.random.default_rng(5)
    return CellParameters(rng.uniform(0.002, 0.02, obj.n), rng.uniform(0.2, 0.6, obj.n), 0.45)


def push_parsed(path, obj, push, base):
    """The last planar pose of the parsed model after a push."""
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, TIME_STEP[base])
    plant.set_stiction_tolerance(STICTION_TOLERANCE)
    add_table(plant)
    pusher = AddPusher(plant, push.radius, 0.012)
    Parser(plant).AddModels(str(path))
    plant.Finalize()
    simulator = Simulator(builder.Build())
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    dt = TIME_STEP[base]
    path_W = push.tip_at(np.arange(round(push.duration / dt) + 1) * dt)
    desired = plant.get_desired_state_input_port(pusher)
    plant.SetPositions(context, pusher, path_W[0])
    plant.SetVelocities(context, pusher, push.velocity)
    for i, tip in enumerate(path_W):
        desired.FixValue(context, np.r_[tip, push.velocity])
        simulator.AdvanceTo(i * dt)
    X_WB = plant.EvalBodyPoseInWorld(context, plant.GetBodyByName(obj.name))
    R = X_WB.rotation().matrix()
    return np.array([*X_WB.translation()[:2], np.arctan2(R[1, 0], R[0, 0])])


@pytest.mark.parametrize("base", ["planar", "free"])
def test_moves_as_the_object_it_came_from(obj, params, base, tmp_path):
    path = tmp_path / "hammer.sdf"
    WriteSdf(Model(obj, params), path, base=base)
    push = Push.on_outline(obj, 0.1, 0.2, 0.05, radius=RADIUS, speed=0.1)
    world = PlantWorld(Model(obj, params), radius=RADIUS, base=base)
    world.execute(push)
    expected = world.truth.pose
    found = push_parsed(path, obj, push, base)
    assert np.linalg.norm(expected[:2]) > 0.01
    # geometries come in another order, which Drake's solver feels
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-4)


def test_has_the_inertia_and_the_spheres(obj, params, tmp_path):
    path = tmp_path / "hammer.sdf"
    WriteSdf(Model(obj, params), path, height=0.04)
    plant, scene_graph = parse_sdf(path)
    assert plant.num_positions() == 7
    body = plant.GetBodyByName(obj.name)
    found = body.CalcSpatialInertiaInBodyFrame(plant.CreateDefaultContext())
    expected = MakeSpatialInertia(Model(obj, params), 0.04).CopyToFullMatrix6()
    np.testing.assert_allclose(found.CopyToFullMatrix6(), expected, rtol=1e-9, atol=1e-15)
    inspector = scene_graph.model_inspector()
    spheres = [
        geometry
        for geometry in plant.GetCollisionGeometriesForBody(body)
        if isinstance(inspector.GetShape(geometry), Sphere)
    ]
    p_BS = np.array([inspector.GetPoseInFrame(sphere).translation() for sphere in spheres])
    np.testing.assert_allclose(
        p_BS, np.column_stack([obj.p_BC, np.full(obj.n, SPHERE_RADIUS)]), atol=1e-15
    )
    own = [
        inspector.GetProximityProperties(sphere)
        .GetProperty("material", "coulomb_friction")
        .dynamic_friction()
        for sphere in spheres
    ]
    np.testing.assert_allclose(2 * np.array(own) / (1 + np.array(own)), params.friction, rtol=1e-12)


def test_refuses(obj, params, tmp_path):
    with pytest.raises(ObjectError, match="base"):
        make_sdf(Model(obj, params), "flying")
    with pytest.raises(ObjectError, match="height"):
        make_sdf(Model(obj, params), height=0.001)
    with pytest.raises(ObjectError, match="delta"):
        make_sdf(Model(obj, params), delta=0.1)
    with pytest.raises(ParameterError, match="friction of cell"):
        make_sdf(Model(obj, CellParameters(params.mass, np.full(obj.n, 3.0))))
    with pytest.raises(ObjectError, match="name"):
        strange = GridObject("a::b", obj.p_BC, obj.cell_size, obj.labels, obj.outline)
        make_sdf(Model(strange, params))
    path = tmp_path / "there.sdf"
    path.write_text("mine")
    with pytest.raises(OutputError, match="--force"):
        WriteSdf(Model(obj, params), path)
    assert path.read_text() == "mine"


def test_names_are_escaped(obj, params, tmp_path):
    named = GridObject("nuts & <bolts>", obj.p_BC, obj.cell_size, obj.labels, obj.outline)
    path = tmp_path / "named.sdf"
    WriteSdf(Model(named, params), path)
    plant, _ = parse_sdf(path)
    assert plant.HasBodyNamed("nuts & <bolts>")


def describe(path, name):
    """The body's spatial inertia, and each collision's place, size, friction and stiffness."""
    plant, scene_graph = parse_sdf(path)
    body, inspector = plant.GetBodyByName(name), scene_graph.model_inspector()
    rows = []
    for geometry in plant.GetCollisionGeometriesForBody(body):
        shape, properties = inspector.GetShape(geometry), inspector.GetProximityProperties(geometry)
        assert isinstance(shape, Box | Sphere)
        size = shape.size() if isinstance(shape, Box) else np.full(3, shape.radius())
        friction = properties.GetProperty("material", "coulomb_friction")
        rows.append(
            [
                *inspector.GetPoseInFrame(geometry).GetAsMatrix4().ravel(), *size,
                friction.static_friction(), friction.dynamic_friction(),
                properties.GetProperty("material", "point_contact_stiffness"),
                properties.GetProperty("material", "hunt_crossley_dissipation"),
            ]
        )  # fmt: skip
    inertia = body.CalcSpatialInertiaInBodyFrame(plant.CreateDefaultContext()).CopyToFullMatrix6()
    return plant.num_positions(), inertia, np.array(rows)


def test_is_the_body_of_the_sdformat_file(tmp_path):
    obj, rng = make_shape("claw_hammer", 60), np.random.default_rng(5)
    params = CellParameters(rng.uniform(0.002, 0.02, obj.n), rng.uniform(0.2, 0.6, obj.n), 0.45)
    WriteUrdf(Model(obj, params), tmp_path / "hammer.urdf", height=0.04)
    WriteSdf(Model(obj, params), tmp_path / "hammer.sdf", height=0.04)
    urdf, sdf = (describe(tmp_path / f"hammer.{kind}", obj.name) for kind in ("urdf", "sdf"))
    assert urdf[0] == sdf[0] == 7
    np.testing.assert_allclose(urdf[1], sdf[1], rtol=1e-9, atol=1e-15)
    assert len(urdf[2]) > obj.n
    np.testing.assert_allclose(urdf[2], sdf[2], rtol=1e-12, atol=1e-12)
