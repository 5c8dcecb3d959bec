"""The outline as boxes: what a sphere touches is the outline, to numerical precision."""

import numpy as np
import pytest
from pydrake.geometry import Role
from shapely import Point, Polygon, unary_union

from gridpush_drake.bench.plant import PlantPusher
from gridpush_drake.multibody.grid_object import CLEARANCE, PROTRUSION, make_edge_boxes, make_inner_boxes
from gridpush_drake.multibody.ground_truth import SetGridObjectPose
from gridpush_drake.multibody.meshcat_shapes import make_outline_mesh
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import find_shipped_object
from gridpush_drake.objects.parameters import CellParameters
from tests.helpers.shapes import SHAPES, make_shape

OBJECTS = ("claw_hammer", "combination_wrench", "toolbox", "open_book")
DEPTH = 1e-5
"""m that the sphere overlaps the outline."""


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
    rig = PlantPusher(obj, CellParameters.uniform(obj), radius)
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
        pairs = [pair for pair in query.ComputePointPairPenetration() if tip in (pair.id_A, pair.id_B)]
        deepest = max(pairs, key=lambda pair: pair.depth)
        # nhat_BA_W points out of B
        found = deepest.nhat_BA_W if deepest.id_A == tip else -deepest.nhat_BA_W
        assert deepest.depth == pytest.approx(DEPTH, abs=2 * PROTRUSION)
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
        assert obj.outline.buffer(2 * PROTRUSION).covers(to_polygon(flat))
    for flat in make_inner_boxes(obj):
        assert obj.outline.buffer(-0.9 * CLEARANCE).covers(to_polygon(flat))


@pytest.mark.parametrize("name", ["claw_hammer", "toolbox", "square", "wrench"])
def test_what_comes_down_on_the_object_is_not_let_through(name):
    obj = load(name)
    covered = unary_union([to_polygon(flat) for flat in (*make_edge_boxes(obj), *make_inner_boxes(obj))])
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
    rig = PlantPusher(obj, CellParameters.uniform(obj), 0.01)
    inspector = rig.scene_graph.model_inspector()
    frame = rig.plant.GetBodyFrameIdOrThrow(rig.handle.body.index())
    assert set(inspector.GetGeometries(frame, Role.kProximity)) == {*rig.handle.contact_spheres, *rig.handle.sides}
