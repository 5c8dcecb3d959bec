"""The simulated world of a station: the plant with robot, table and objects.

It also knows the hidden truth, the objects' masses and frictions, which the robot is not told.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np
from pydrake.geometry import GeometryId, Role, SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Context, Diagram, DiagramBuilder

from gridpush_drake.identification.model import Model
from gridpush_drake.multibody.contact_material import TABLE_INSTANCE, SetPartner
from gridpush_drake.multibody.grid_object import AddGridObject, Base, GridObjectInPlant
from gridpush_drake.multibody.ground_truth import (
    SetGridObjectParameters,
    SetGridObjectPose,
    resample_parameters,
)
from gridpush_drake.multibody.parser import AddPlantAndSceneGraph, AddVisualMeshes, MakeParser
from gridpush_drake.multibody.table_rim import AddTableRim
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.station.robot.arm_driver import SetJointServos
from gridpush_drake.station.robot.robot import (
    GetRobotInPlant,
    Robot,
    RobotInPlant,
    SetGripperOpening,
    list_moving_joints,
    list_touching_bodies,
)
from gridpush_drake.station.scene.camera import AddSeenVisual
from gridpush_drake.station.scene.contents import AddScene, MakeSupport, MakeTruth
from gridpush_drake.station.scene.other_objects import AddOthers
from gridpush_drake.station.scene.resolve import ResolvedScenario
from gridpush_drake.station.scene.setting import MakeSetting, StationSetting
from gridpush_drake.station.schema.scenario import PushScenario


def AddStationScene(
    plant: MultibodyPlant, scene_graph: SceneGraph, scenario: PushScenario, robot: Robot
) -> tuple[RobotInPlant, tuple[GeometryId, ...]]:
    """Adds robot and table to a plant as the scenario's directives say, before Finalize.

    Returns:
        The robot's model instances, and the table's collision geometries.
    """
    AddScene(MakeParser(plant, robot.packages), scenario)
    # Not by the plant's own GetCollisionGeometriesForBody: pydrake ties the ids that it returns to
    # the plant, and whoever keeps them keeps the plant alive, unseen by Python's garbage collector.
    inspector = scene_graph.model_inspector()
    table = tuple(
        geometry
        for body in plant.GetBodyIndices(plant.GetModelInstanceByName(TABLE_INSTANCE))
        for geometry in inspector.GetGeometries(plant.GetBodyFrameIdOrThrow(body), Role.kProximity)
    )
    pushing = [
        geometry
        for body in list_touching_bodies(plant, robot)
        for geometry in plant.GetCollisionGeometriesForBody(body)
    ]
    SetPartner(plant, scene_graph, [*table, *pushing])
    instances = GetRobotInPlant(plant, robot)
    SetJointServos(plant, robot, instances.arm)
    return instances, table


@dataclass(frozen=True, eq=False)
class World:
    """The simulated part of a station: the plant with robot, object and table.

    The cells of the robot's object and of the plant's object differ where a camera found the
    object: the truth is drawn on the plant's, and carried over to the robot's for comparison.

    Attributes:
        resolved: the resolved scenario that it is made from.
        setting: what the robot knows.
        true_obj: the plant's object.
        truth: true masses and frictions, for the scenario's seed, on the cells of `setting.obj`.
        scene_graph: the plant's scene graph.
        robot_in_plant: the robot's model instances in the plant.
        object_in_plant: the object's body and geometry in the plant.
        table: the table's collision geometries, with those of its rim.
    """

    resolved: ResolvedScenario
    setting: StationSetting
    true_obj: GridObject
    truth: CellParameters
    scene_graph: SceneGraph
    robot_in_plant: RobotInPlant
    object_in_plant: GridObjectInPlant
    table: tuple[GeometryId, ...]

    @property
    def plant(self) -> MultibodyPlant:
        """The plant."""
        return self.setting.plant

    def SetStart(
        self, diagram: Diagram, root_context: Context, seed: int | None
    ) -> CellParameters | None:
        """Puts arm and object at rest where the scenario has them.

        Args:
            diagram: the Diagram that has the plant.
            root_context: its Context, or that of a Diagram that it is part of.
            seed: seed of the hidden truth, instead of the scenario's; None leaves the truth in the
                Context as it is.

        Returns:
            The truth on the cells of `setting.obj`; None if it was left as it is.
        """
        plant = self.plant
        scenario = self.setting.scenario
        arm = self.robot_in_plant.arm
        plant_context = plant.GetMyMutableContextFromRoot(root_context)
        plant.SetPositions(plant_context, arm, self.setting.q_start)
        plant.SetVelocities(plant_context, arm, np.zeros_like(self.setting.q_start))
        if self.setting.robot.pushing_gripper is not None:
            # What drives a real gripper does not give way.
            for joint in list_moving_joints(plant, self.robot_in_plant.finger):
                joint.Lock(plant_context)
        SetGridObjectPose(plant, plant_context, self.object_in_plant, scenario.object_pose)
        if seed is None:
            return None
        resolved = self.resolved
        truth = resolved.truth
        support = resolved.support
        if seed != resolved.scenario.seed:
            truth = MakeTruth(self.true_obj, scenario.truth, seed)
            support = MakeSupport(self.true_obj, truth, scenario, seed)
        SetGridObjectParameters(
            plant, self.scene_graph, root_context, self.object_in_plant, truth, support
        )
        if truth is resolved.truth:
            return self.truth
        return resample_parameters(Model(self.true_obj, truth), self.setting.obj)


def AddWorld(
    builder: DiagramBuilder,
    resolved: ResolvedScenario,
    show_object: bool = True,
    drake_models: Path | None = None,
    is_known: bool = False,
) -> World:
    """Adds a finalised plant with all that a scenario has.

    Args:
        builder: an empty builder.
        resolved: the resolved scenario.
        show_object: whether Meshcat shows the plain outlines of the objects that the task is about.
        drake_models: folder of the meshes with which the robot is shown; None to show its
            primitive shapes.
        is_known: whether the task is about all objects, whose outlines the robot is told whatever
            its camera is. Otherwise a color and depth camera takes a photograph, in which the one
            object is found.

    Returns:
        The world.

    Raises:
        ScenarioError: the camera sees no object.
        StationError: nothing can be rendered on this computer.
    """
    scenario = resolved.scenario
    robot = resolved.robot
    found = None if is_known else resolved.found
    true_obj = resolved.obj if found is None else found.true_obj

    # The plant: scene, object, other objects.
    plant, scene_graph = AddPlantAndSceneGraph(builder, scenario.simulation.time_step)
    plant.set_name("plant")
    plant.set_stiction_tolerance(scenario.simulation.stiction_tolerance)
    scene_graph.set_name("scene_graph")
    instances, table = AddStationScene(plant, scene_graph, scenario, robot)
    # An object that is pressed at the edge tilts about the edge itself.
    rim = AddTableRim(plant, resolved.table_top) if scenario.unknown_inertia else ()
    object_in_plant = AddGridObject(
        plant,
        scene_graph,
        Model(true_obj, resolved.truth),
        cast(Base, scenario.base),
        table=table,
        height=scenario.object_height,
        support=resolved.support,
        rim_gap=scenario.truth.rim_gap,
        visual=show_object,
    )
    # In a task with several objects the estimates of all are drawn, in the place of their outlines.
    others = AddOthers(
        plant,
        scene_graph,
        scenario,
        resolved.others,
        table,
        object_in_plant,
        visual=show_object or not is_known,
    )
    if scenario.camera.kind == "rgbd":
        AddSeenVisual(plant, scene_graph, object_in_plant)
    if found is not None:
        # From here on the scenario is the robot's, which knows only what the camera saw.
        seen = {
            "object_pose": found.pose.tolist(),
            "object_height": found.obj.height or scenario.object_height,
        }
        scenario = scenario.model_copy(update=seen)
    if drake_models is not None:
        AddVisualMeshes(plant, scene_graph, drake_models)
    plant.Finalize()
    SetGripperOpening(plant, robot)

    # What the robot knows of the plant, and what only the world knows.
    setting = MakeSetting(resolved, scenario, plant, found, others)
    plant.SetDefaultPositions(instances.arm, setting.q_start)
    return World(
        resolved=resolved,
        setting=setting,
        true_obj=true_obj,
        truth=resample_parameters(Model(true_obj, resolved.truth), setting.obj),
        scene_graph=scene_graph,
        robot_in_plant=instances,
        object_in_plant=object_in_plant,
        table=(*table, *rim),
    )
