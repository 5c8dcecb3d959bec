"""Other objects on the table, beside the one that is pushed and learned: a scenario's `others`.

Each is a free body with cells, contact spheres and sides of its own, weighs and rubs as it is drawn
from the seed, and is seen by a camera of its own (`other_0.pose`, `other_1.pose`, ...). Nobody
learns it. Pushes keep clear of where it lies at the beginning, the finger by `MakeFingerRegion`,
the object as the task has it. A color and depth camera has it in its pictures, and takes what it
covers for unseen, as with the robot.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from pydrake.geometry import GeometryId, SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Context, DiagramBuilder
from shapely import Polygon
from shapely.geometry.base import BaseGeometry

from gridpush_drake.geometry.se2 import transform_shape
from gridpush_drake.multibody.grid_object import (
    AddGridObject,
    ApplyGridObjectFilters,
    GridObjectInPlant,
)
from gridpush_drake.multibody.ground_truth import SetGridObjectParameters, SetGridObjectPose
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.station.camera import AddIdealCamera, AddSeenVisual
from gridpush_drake.station.scenario import PushScenario
from gridpush_drake.station.scene import MakeTruth
from gridpush_drake.systems.planar_pose_sensor import PlanarPoseSensor


@dataclass(frozen=True, eq=False)
class OtherObject:
    """Another object in a station.

    Attributes:
        name: of its model in the plant, and what its port begins with.
        pose: (x, y, theta) X_WB at the beginning, m and rad.
        part: its parts in the plant.
    """

    name: str
    pose: tuple[float, float, float]
    part: GridObjectInPlant


def draw_other_truth(
    scenario: PushScenario, part: GridObjectInPlant, number: int, seed: int
) -> CellParameters:
    """Draws what the other object of a number, from 0, weighs and how it rubs; another draw than any other object's."""
    ranges = scenario.truth.model_copy(update={"parts": []})
    own = int(np.random.SeedSequence((seed, number)).generate_state(1)[0])
    return MakeTruth(part.obj, ranges, own)


def AddOthers(
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    scenario: PushScenario,
    objects: Sequence[GridObject],
    table: Sequence[GeometryId],
    pushed: GridObjectInPlant,
) -> tuple[OtherObject, ...]:
    """Adds a scenario's other objects to a plant, before Finalize; they stand on the table and touch one another."""
    others = []
    for number, (config, obj) in enumerate(zip(scenario.others, objects, strict=True)):
        name = f"other_{number}"
        part = AddGridObject(
            plant,
            scene_graph,
            obj,
            CellParameters.uniform(obj),
            "free",
            table=table,
            height=config.height,
            name=name,
        )
        x, y, theta = config.pose
        if scenario.camera.kind == "rgbd":
            AddSeenVisual(plant, scene_graph, part)
        others.append(OtherObject(name, (x, y, theta), part))
    for part in (pushed, *(other.part for other in others)):
        ApplyGridObjectFilters(plant, scene_graph, part, table)
    return tuple(others)


def AddOtherCameras(
    builder: DiagramBuilder, scenario: PushScenario, others: Sequence[OtherObject]
) -> tuple[PlanarPoseSensor, ...]:
    """Adds a camera for each, as noisy as the station's, and exports what it sees as NAME.pose."""
    cameras = []
    for number, other in enumerate(others):
        seed = _make_camera_seed(scenario.seed, number)
        camera = AddIdealCamera(builder, other.part, scenario.camera, f"{other.name}_camera", seed)
        builder.ExportOutput(camera.GetOutputPort("object_pose"), f"{other.name}.pose")
        cameras.append(camera)
    return tuple(cameras)


def SetOthersStart(
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    root_context: Context,
    scenario: PushScenario,
    others: Sequence[OtherObject],
    cameras: Sequence[PlanarPoseSensor],
    seed: int,
) -> None:
    """Puts them where the scenario has them, at rest, with the truth and the camera's noise of a seed."""
    plant_context = plant.GetMyMutableContextFromRoot(root_context)
    for number, (other, camera) in enumerate(zip(others, cameras, strict=True)):
        truth = draw_other_truth(scenario, other.part, number, seed)
        SetGridObjectParameters(plant, scene_graph, root_context, other.part, truth)
        SetGridObjectPose(plant, plant_context, other.part, other.pose)
        camera.SetSeed(root_context, _make_camera_seed(seed, number))


def place_others(others: Sequence[OtherObject]) -> tuple[Polygon, ...]:
    """Where they lie at the beginning, polygons in W, m; without their holes."""
    return tuple(
        Polygon(transform_shape(other.pose, other.part.obj.outline).exterior) for other in others
    )


def leave_out(region: BaseGeometry, others: Sequence[OtherObject], distance: float) -> BaseGeometry:
    """A region without what is nearer than a distance, m, to where the others lie; itself where there are none."""
    return region - shapely.union_all(place_others(others)).buffer(distance) if others else region


def _make_camera_seed(seed: int, number: int) -> int:
    """Of the noise; the station's own camera has the seed itself."""
    return int(np.random.SeedSequence((seed, number, 1)).generate_state(1)[0])
