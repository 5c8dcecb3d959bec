"""The finger: where its tip is, and what it is made of."""

import pytest
from pydrake.geometry import Cylinder, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from gridpush_drake.station.robot.robot import AddRobot, find_robot
from gridpush_drake.station.schema.scenario import PushScenario

ROBOT = find_robot(PushScenario().directives)
TIP_RADIUS = ROBOT.finger.tip_radius


@pytest.fixture
def station():
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 1e-3)
    arm = AddRobot(plant, ROBOT)
    plant.Finalize()
    return plant, scene_graph, arm


def test_tip_lies_along_the_flange_s_axis(station):
    plant, _, _ = station
    context = plant.CreateDefaultContext()
    flange = plant.GetFrameByName("iiwa_link_ee_kuka")
    X = plant.GetFrameByName("finger_tip").CalcPose(context, flange)
    assert X.IsNearlyEqualTo(RigidTransform([0.0, 0.0, 0.16]), 1e-12)


def test_tip_is_a_sphere_wider_than_the_rod_and_the_lowest_of_all(station):
    plant, scene_graph, arm = station
    inspector = scene_graph.model_inspector()
    (tip,) = plant.GetCollisionGeometriesForBody(plant.GetBodyByName("finger_tip", arm.finger))
    assert isinstance(inspector.GetShape(tip), Sphere)
    assert inspector.GetShape(tip).radius() == TIP_RADIUS
    for geometry in plant.GetCollisionGeometriesForBody(plant.GetBodyByName("finger", arm.finger)):
        shape, z = inspector.GetShape(geometry), inspector.GetPoseInFrame(geometry).translation()[2]
        assert isinstance(shape, Cylinder)
        assert z + shape.length() / 2 < 0.16
        if z + shape.length() / 2 > 0.05:
            assert shape.radius() < TIP_RADIUS


def test_finger_is_light(station):
    plant, _, arm = station
    assert 0.05 < plant.CalcTotalMass(plant.CreateDefaultContext(), [arm.finger]) < 0.3
