"""A grid object in a plant, held to the plane: what its spheres bear, what touches what, what may change in a run."""

import numpy as np
import pytest
from pydrake.geometry import Box, Role, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from shapely import Point, Polygon, unary_union

from gridpush_drake.bench.worlds.plant import PlantWorld
from gridpush_drake.errors import ObjectError, ParameterError, SimulationError
from gridpush_drake.geometry.outline_mesh import make_outline_mesh
from gridpush_drake.identification.model import Model
from gridpush_drake.multibody.contact_material import (
    MakePartnerProperties,
    SetPartner,
    calc_own_friction,
)
from gridpush_drake.multibody.grid_object import (
    MAX_PROTRUSION,
    OUTLINE_CLEARANCE,
    AddGridObject,
    ApplyGridObjectFilters,
    MakeSpatialInertia,
    make_edge_boxes,
    make_inner_boxes,
)
from gridpush_drake.multibody.ground_truth import (
    CalcPlanarPose,
    SetGridObjectParameters,
    SetGridObjectPose,
    SetGridObjectVelocity,
)
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import find_shipped_object
from gridpush_drake.objects.parameters import CellParameters
from tests.helpers.made_identifications import make_block
from tests.helpers.plant_object import make_scene
from tests.helpers.shapes import SHAPES, make_shape

GRAVITY = 9.81


@pytest.fixture(scope="module")
def obj():
    return make_shape("l_bracket", 30)


def random_params(obj, seed=0):
    rng = np.random.default_rng(seed)
    return CellParameters(rng.uniform(0.002, 0.05, obj.n), rng.uniform(0.1, 0.9, obj.n), 0.4)


@pytest.fixture(scope="module")
def params(obj):
    return random_params(obj)


@pytest.mark.parametrize("spheres_per_cell", [1, 4])
def test_every_cell_bears_its_weight_at_rest_and_while_it_slides(obj, params, spheres_per_cell):
    scene = make_scene(obj, params, spheres_per_cell=spheres_per_cell)
    SetGridObjectPose(scene.plant, scene.plant_context, scene.handle, (0.02, -0.01, 0.7))
    for velocity in ((0.0, 0.0, 0.0), (0.3, 0.1, -2.0)):
        SetGridObjectVelocity(scene.plant, scene.plant_context, scene.handle, velocity)
        scene.simulator.AdvanceTo(scene.context.get_time() + 0.005)
        borne = np.bincount(scene.handle.layout.cell, scene.sphere_forces()[:, 2])
        np.testing.assert_allclose(borne, params.mass * GRAVITY, rtol=1e-6)


def test_friction_of_each_sphere_is_its_cells(obj, params):
    scene = make_scene(obj, params)
    SetGridObjectVelocity(scene.plant, scene.plant_context, scene.handle, (0.4, 0.3, 3.0))
    scene.simulator.AdvanceTo(0.003)
    forces = scene.sphere_forces()
    ratio = np.linalg.norm(forces[:, :2], axis=1) / forces[:, 2]
    # cells near the center of rotation are too slow to slide
    np.testing.assert_allclose(ratio, params.friction, rtol=2e-4)


def test_slides_to_rest_as_friction_says(obj):
    mu, speed = 0.35, 1.0
    scene = make_scene(obj, CellParameters(np.full(obj.n, 0.01), np.full(obj.n, mu)))
    SetGridObjectVelocity(scene.plant, scene.plant_context, scene.handle, (speed, 0.0, 0.0))
    scene.simulator.AdvanceTo(0.2)
    # implicit steps lose speed at their beginning: v - mu g t exactly, the path by half a step's
    # change less
    assert scene.plant.GetVelocities(scene.plant_context, scene.handle.model_instance)[
        0
    ] == pytest.approx(speed - mu * GRAVITY * 0.2, rel=1e-5)
    path = speed * 0.2 - mu * GRAVITY * 0.2**2 / 2
    assert scene.pose()[0] == pytest.approx(path, abs=mu * GRAVITY * 0.2 * 1e-3)
    assert np.abs(scene.pose()[1:]).max() < 1e-6
    scene.simulator.AdvanceTo(0.4)
    assert np.abs(scene.plant.GetVelocities(scene.plant_context)).max() < 1e-6


def test_inertia_is_the_cells(obj, params):
    M = MakeSpatialInertia(Model(obj, params), 0.04)
    center = params.center_of_mass(obj)
    np.testing.assert_allclose(M.get_com(), [*center, 0.02], atol=1e-12)
    assert M.get_mass() == pytest.approx(params.total_mass, rel=1e-12)
    about_center = M.Shift(M.get_com()).CalcRotationalInertia().CopyToFullMatrix3()
    assert about_center[2, 2] == pytest.approx(params.inertia(obj), rel=1e-9)
    y2 = params.mass @ ((obj.p_BC[:, 1] - center[1]) ** 2 + obj.cell_size**2 / 12 + 0.04**2 / 12)
    assert about_center[0, 0] == pytest.approx(y2, rel=1e-9)


def test_changed_parameters_move_it_as_if_it_had_been_built_with_them(obj, params):
    other = random_params(obj, 1)

    def slide(scene):
        SetGridObjectPose(scene.plant, scene.plant_context, scene.handle, (0.1, 0.2, 0.3))
        SetGridObjectVelocity(scene.plant, scene.plant_context, scene.handle, (0.5, -0.2, 4.0))
        scene.simulator.AdvanceTo(scene.context.get_time() + 0.1)
        return scene.pose()

    changed = make_scene(obj, params)
    first = slide(changed)
    SetGridObjectParameters(
        changed.plant, changed.scene_graph, changed.context, changed.handle, other
    )
    second = slide(changed)
    np.testing.assert_allclose(second, slide(make_scene(obj, other)), rtol=0, atol=1e-9)
    assert np.abs(second - first).max() > 1e-3
    # a new Context has the first parameters again
    changed.simulator.reset_context(changed.diagram.CreateDefaultContext())
    np.testing.assert_allclose(slide(changed), first, rtol=0, atol=1e-12)


def add_ball(plant):
    ball = plant.AddRigidBody(
        "ball", plant.AddModelInstance("ball"), SpatialInertia.SolidSphereWithMass(1, 0.02)
    )
    plant.RegisterCollisionGeometry(
        ball, RigidTransform(), Sphere(0.02), "ball", MakePartnerProperties()
    )


def add_ball_and_filter(plant, scene_graph, handle, table):
    add_ball(plant)
    ApplyGridObjectFilters(plant, scene_graph, handle, [table])


@pytest.mark.parametrize(
    "more", [{"before_object": add_ball}, {"after_object": add_ball_and_filter}]
)
def test_spheres_touch_the_table_alone_and_sides_all_but_the_table(obj, params, more):
    scene = make_scene(obj, params, **more)
    inspector = scene.scene_graph.model_inspector()
    (ball,) = scene.plant.GetCollisionGeometriesForBody(scene.plant.GetBodyByName("ball"))
    assert not any(
        inspector.CollisionFiltered(sphere, scene.table) for sphere in scene.handle.contact_spheres
    )
    assert all(inspector.CollisionFiltered(sphere, ball) for sphere in scene.handle.contact_spheres)
    assert all(inspector.CollisionFiltered(side, scene.table) for side in scene.handle.sides)
    assert not any(inspector.CollisionFiltered(side, ball) for side in scene.handle.sides)
    assert not inspector.CollisionFiltered(ball, scene.table)


def test_needs_a_table(obj, params):
    plant, scene_graph = AddMultibodyPlantSceneGraph(DiagramBuilder(), 1e-3)
    with pytest.raises(ObjectError, match="table is empty"):
        AddGridObject(plant, scene_graph, Model(obj, params), table=[])


def test_is_seen_but_not_by_cameras(obj, params):
    inspector = make_scene(obj, params).scene_graph.model_inspector()
    assert inspector.NumGeometriesWithRole(Role.kIllustration) == 1
    assert inspector.NumGeometriesWithRole(Role.kPerception) == 0
    hidden = make_scene(obj, params, visual=False)
    assert not hidden.handle.visuals
    assert hidden.scene_graph.model_inspector().NumGeometriesWithRole(Role.kIllustration) == 0


def test_partner_leaves_other_properties_alone(obj, params):
    added = {}

    def add_soft_ball(plant):
        ball = plant.AddRigidBody(
            "ball", plant.AddModelInstance("ball"), SpatialInertia.SolidSphereWithMass(1, 0.02)
        )
        properties = MakePartnerProperties()
        properties.UpdateProperty("material", "point_contact_stiffness", 5.0)
        properties.AddProperty("other", "thing", 3.0)
        added["id"] = plant.RegisterCollisionGeometry(
            ball, RigidTransform(), Sphere(0.02), "ball", properties
        )

    scene = make_scene(obj, params, before_object=add_soft_ball)
    SetPartner(scene.plant, scene.scene_graph, [added["id"]])
    properties = scene.scene_graph.model_inspector().GetProximityProperties(added["id"])
    assert properties.GetProperty("material", "point_contact_stiffness") == 1e12
    assert properties.GetProperty("other", "thing") == 3.0


@pytest.mark.parametrize("mu", [0.0, 0.05, 0.7, 1.0, 1.9])
def test_combined_friction_is_the_wanted_one(mu):
    own = calc_own_friction(mu)
    assert 2 * own / (own + 1) == pytest.approx(mu, abs=1e-12)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"base": "flying"}, ObjectError, "base.*'planar' or 'free'"),
        ({"height": 0.0}, ObjectError, "height"),
        ({"delta": -1e-3}, ObjectError, "delta"),
        ({"side_stiffness": np.nan}, ObjectError, "side_stiffness"),
        ({"spheres_per_cell": 2}, ParameterError, "spheres_per_cell.*1 or 4"),
    ],
)
def test_refuses_what_makes_no_sense(obj, params, options, error, message):
    with pytest.raises(error, match=message):
        make_scene(obj, params, **{"dt": 1e-3, **options})


def test_refuses_friction_that_drake_cannot_combine(obj):
    rough = CellParameters(np.full(obj.n, 0.01), np.full(obj.n, 2.0))
    with pytest.raises(ParameterError, match=r"friction of cell 0 is 2.*less than 2"):
        make_scene(obj, rough)
    sticky = CellParameters(np.full(obj.n, 0.01), np.full(obj.n, 0.2), 2.5)
    with pytest.raises(ParameterError, match="contact_friction"):
        make_scene(obj, sticky)
    with pytest.raises(SimulationError, match="cells"):
        make_scene(obj, CellParameters(np.ones(3), np.ones(3)))


@pytest.mark.parametrize("base", ["planar", "free"])
def test_pose_is_set_and_read(obj, params, base):
    scene = make_scene(obj, params, base)
    q = (0.3, -0.2, 2.5)
    SetGridObjectPose(scene.plant, scene.plant_context, scene.handle, q)
    np.testing.assert_allclose(scene.pose(), q, atol=1e-12)
    SetGridObjectVelocity(scene.plant, scene.plant_context, scene.handle, (0.1, 0.2, 0.3))
    V = scene.plant.EvalBodySpatialVelocityInWorld(scene.plant_context, scene.handle.body)
    np.testing.assert_allclose(
        [*V.translational(), *V.rotational()], [0.1, 0.2, 0, 0, 0, 0.3], atol=1e-12
    )
    Simulator(scene.diagram, scene.diagram.CreateDefaultContext()).AdvanceTo(0.01)
    with pytest.raises(ObjectError, match="three finite numbers"):
        SetGridObjectPose(scene.plant, scene.plant_context, scene.handle, (0.0, np.nan, 0.0))


OBJECTS = ("claw_hammer", "combination_wrench", "toolbox", "open_book")
DEPTH = 1e-5  # m that the sphere overlaps the outline


def load(name) -> GridObject:
    return make_shape(name) if name in SHAPES else GridObject.from_yaml(find_shipped_object(name))


def to_polygon(flat) -> Polygon:
    length, width = flat.size
    corners = np.array([[-length, -width], [length, -width], [length, width], [-length, width]]) / 2
    c, s = np.cos(flat.angle), np.sin(flat.angle)
    return Polygon(corners @ np.array([[c, s], [-s, c]]) + flat.center)


@pytest.mark.parametrize("name", OBJECTS)
def test_a_sphere_touches_the_outline_with_its_depth_and_normal(name):
    obj, radius = load(name), 0.008
    rig = PlantWorld(Model(obj, CellParameters.uniform(obj)), radius=radius)
    context = rig.simulator.get_mutable_context()
    plant_context = rig.plant.GetMyMutableContextFromRoot(context)
    SetGridObjectPose(rig.plant, plant_context, rig.handle, (0.0, 0.0, 0.0))
    (tip,) = rig.plant.GetCollisionGeometriesForBody(rig.plant.GetBodyByName("tip"))
    rng = np.random.default_rng(0)
    checked = 0
    for _ in range(200):
        point, _, normal = obj.edges.at(rng.uniform(0, obj.edges.perimeter))
        center = point + (radius - DEPTH) * normal
        if obj.outline.distance(Point(center)) < radius - DEPTH - 1e-9:
            continue
        rig.plant.SetPositions(plant_context, rig.pusher, center)
        query = rig.plant.get_geometry_query_input_port().Eval(plant_context)
        pairs = [
            pair for pair in query.ComputePointPairPenetration() if tip in (pair.id_A, pair.id_B)
        ]
        deepest = max(pairs, key=lambda pair: pair.depth)
        # nhat_BA_W points out of B
        found = deepest.nhat_BA_W if deepest.id_A == tip else -deepest.nhat_BA_W
        assert deepest.depth == pytest.approx(DEPTH, abs=2 * MAX_PROTRUSION)
        np.testing.assert_allclose(found, [*normal, 0.0], atol=1e-6)
        # at most the two edges of a corner, and none of what fills the inside
        assert len(pairs) <= 3
        inside = set(rig.handle.sides[len(obj.edges.start) :])
        assert not any({pair.id_A, pair.id_B} & inside for pair in pairs)
        checked += 1
    assert checked > 100


@pytest.mark.parametrize("name", [*SHAPES, *OBJECTS])
def test_boxes_lie_within_the_outline(name):
    obj = load(name)
    for flat in make_edge_boxes(obj):
        assert obj.outline.buffer(2 * MAX_PROTRUSION).covers(to_polygon(flat))
    for flat in make_inner_boxes(obj):
        assert obj.outline.buffer(-0.9 * OUTLINE_CLEARANCE).covers(to_polygon(flat))


@pytest.mark.parametrize("name", ["claw_hammer", "toolbox", "square", "wrench"])
def test_what_comes_down_on_the_object_is_not_let_through(name):
    obj = load(name)
    covered = unary_union(
        [to_polygon(flat) for flat in (*make_edge_boxes(obj), *make_inner_boxes(obj))]
    )
    gaps = obj.outline.difference(covered)
    # a finger of radius 8 mm would touch a box long before its middle is level with the top
    assert gaps.buffer(-0.004).is_empty
    assert gaps.area < 0.2 * obj.outline.area


@pytest.mark.parametrize("name", ["claw_hammer", "combination_wrench", "square"])
def test_mesh_is_a_closed_prism_of_the_outline(name):
    obj = load(name)
    lines = [line.split() for line in make_outline_mesh(obj.outline, 0.05).splitlines() if line]
    vertices = np.array([line[1:] for line in lines if line[0] == "v"], dtype=float)
    faces = np.array([line[1:] for line in lines if line[0] == "f"], dtype=int) - 1
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    volume = np.einsum("ij,ij->", a, np.cross(b, c)) / 6
    assert volume == pytest.approx(obj.outline.area * 0.05, rel=1e-4)


def test_only_the_sides_and_spheres_collide():
    obj = load("square")
    rig = PlantWorld(Model(obj, CellParameters.uniform(obj)), radius=0.01)
    inspector = rig.scene_graph.model_inspector()
    frame = rig.plant.GetBodyFrameIdOrThrow(rig.handle.body.index())
    assert set(inspector.GetGeometries(frame, Role.kProximity)) == {
        *rig.handle.contact_spheres,
        *rig.handle.sides,
    }


OBJ = make_block(12)
FRICTIONS = (0.2, 0.5)
SPEED, TIME = 0.5, 0.5


def make_plant(base):
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.001)
    table = plant.RegisterCollisionGeometry(
        plant.world_body(),
        RigidTransform([0, 0, -0.05]),
        Box(4.0, 4.0, 0.1),
        "table",
        CoulombFriction(1.0, 1.0),
    )
    SetPartner(plant, scene_graph, [table])
    handles = [
        AddGridObject(
            plant,
            scene_graph,
            Model(OBJ, CellParameters.uniform(OBJ, friction=mu)),
            base,
            table=[table],
            name=f"block_{i}",
        )
        for i, mu in enumerate(FRICTIONS)
    ]
    for handle in handles:
        ApplyGridObjectFilters(plant, scene_graph, handle, [table])
    return builder, plant, scene_graph, handles, table


@pytest.mark.parametrize("base", ["planar", "free"])
def test_each_slides_by_its_own_friction(base):
    builder, plant, _, handles, _ = make_plant(base)
    plant.Finalize()
    simulator = Simulator(builder.Build())
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    starts = [np.array([-1.0, y, 0.0]) for y in (-0.5, 0.5)]
    for handle, start in zip(handles, starts, strict=True):
        SetGridObjectPose(plant, context, handle, start)
        SetGridObjectVelocity(plant, context, handle, (SPEED, 0.0, 0.0))
    simulator.AdvanceTo(TIME)
    for handle, start, mu in zip(handles, starts, FRICTIONS, strict=True):
        way = SPEED**2 / (2 * mu * GRAVITY)
        moved = CalcPlanarPose(plant, context, handle) - start
        np.testing.assert_allclose(moved, (way, 0.0, 0.0), atol=1e-3)


def test_nothing_is_shared():
    _, plant, scene_graph, handles, table = make_plant("planar")
    first, second = handles
    assert plant.GetBodyByName("block_0").index() == first.body.index() != second.body.index()
    assert (
        plant.GetFrameByName("block_0_table").index()
        != plant.GetFrameByName("block_1_table").index()
    )
    assert not {*first.contact_spheres, *first.sides, *first.visuals} & {
        *second.contact_spheres,
        *second.sides,
        *second.visuals,
    }
    inspector = scene_graph.model_inspector()
    for one, other in ((first, second), (second, first)):
        assert inspector.CollisionFiltered(one.contact_spheres[0], other.sides[0])
        assert inspector.CollisionFiltered(one.contact_spheres[0], other.contact_spheres[0])
        assert not inspector.CollisionFiltered(one.sides[0], other.sides[0])
        assert not inspector.CollisionFiltered(one.contact_spheres[0], table)


def test_a_name_that_is_taken_is_refused():
    _, plant, scene_graph, _, table = make_plant("planar")
    with pytest.raises(ObjectError, match="'block_1'"):
        AddGridObject(
            plant,
            scene_graph,
            Model(OBJ),
            table=[table],
            name="block_1",
        )
