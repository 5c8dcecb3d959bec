"""Two grid objects in one plant, each with frames, geometry and truth of its own."""

import numpy as np
import pytest
from pydrake.geometry import Box
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from gridpush_drake.errors import ObjectError
from gridpush_drake.multibody.contact_material import SetPartner
from gridpush_drake.multibody.grid_object import AddGridObject, ApplyGridObjectFilters
from gridpush_drake.multibody.ground_truth import CalcPlanarPose, SetGridObjectPose, SetGridObjectVelocity
from gridpush_drake.objects.parameters import CellParameters
from tests.helpers.made_identifications import make_block

OBJ = make_block(12)
FRICTIONS = (0.2, 0.5)
SPEED, TIME = 0.5, 0.5
GRAVITY = 9.81


def make_plant(base):
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.001)
    table = plant.RegisterCollisionGeometry(
        plant.world_body(), RigidTransform([0, 0, -0.05]), Box(4.0, 4.0, 0.1), "table", CoulombFriction(1.0, 1.0)
    )
    SetPartner(plant, scene_graph, [table])
    handles = [
        AddGridObject(
            plant, scene_graph, OBJ, CellParameters.uniform(OBJ, friction=mu), base, table=[table], name=f"block_{i}"
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
    assert plant.GetFrameByName("block_0_table").index() != plant.GetFrameByName("block_1_table").index()
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
        AddGridObject(plant, scene_graph, OBJ, CellParameters.uniform(OBJ), table=[table], name="block_1")
