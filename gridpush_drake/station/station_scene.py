"""What stands in the station's plant besides the object, and the object that is pushed, by a scenario."""

from dataclasses import replace

from pydrake.geometry import GeometryId, Role, SceneGraph
from pydrake.multibody.plant import MultibodyPlant

from gridpush_drake.grid.object import GridObject
from gridpush_drake.scene.contact_material import SetPartner
from gridpush_drake.scene.parser import MakeParser
from gridpush_drake.scene.scenario import PushScenario
from gridpush_drake.scene.scenario_parts import AddScene, load_object
from gridpush_drake.scene.table import TABLE
from gridpush_drake.station.arm_posture import TIP_FRAME
from gridpush_drake.station.grasping import FindGripper
from gridpush_drake.station.iiwa import Arm


def LoadPushedObject(scenario: PushScenario) -> GridObject:
    """Reads the scenario's object, with its finger as the pusher. Raises ScenarioError where there is none."""
    obj = load_object(scenario)
    return replace(obj, prior=replace(obj.prior, pusher_radius=scenario.finger.tip_radius))


def AddStationScene(
    plant: MultibodyPlant, scene_graph: SceneGraph, scenario: PushScenario
) -> tuple[Arm, tuple[GeometryId, ...]]:
    """Adds what the directives say; returns the robot and the table's collision geometries."""
    AddScene(MakeParser(plant), scenario)
    # a plant's own GetCollisionGeometriesForBody gives ids that keep it alive, unseen by the garbage collector
    inspector = scene_graph.model_inspector()
    table = tuple(
        geometry
        for body in plant.GetBodyIndices(plant.GetModelInstanceByName(TABLE))
        for geometry in inspector.GetGeometries(plant.GetBodyFrameIdOrThrow(body), Role.kProximity)
    )
    SetPartner(plant, scene_graph, [*table, *plant.GetCollisionGeometriesForBody(plant.GetBodyByName(TIP_FRAME))])
    iiwa, finger = map(plant.GetModelInstanceByName, ("iiwa", "finger"))
    return Arm(iiwa, finger, FindGripper(plant)), table
