"""Other objects on the table, beside the one that is pushed and learned: a scenario's `others`.

Each is a free body with cells, contact spheres and sides of its own. Its true masses and frictions
are drawn from the seed, and its pose is seen (`other_0.pose`, `other_1.pose`, ...). In a task with
one object nobody learns it, and pushes are planned around the place where it lies at the beginning:
`MakeFingerRegion` keeps the finger away from it, and each task the pushed object. An ideal camera
of its own sees it then. The pictures of a color and depth camera show it as well; where it hides
the pushed object, those cells are taken for unseen, as they are behind the robot.

In a task with several objects (`station.tasks.scene_task`) it is pushed like any other, and the
color and depth camera follows it, too (`station.scene.scene_camera`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from pydrake.geometry import GeometryId, SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Context, DiagramBuilder
from shapely import Polygon

from gridpush_drake.geometry.se2 import transform_shape
from gridpush_drake.identification.model import Model
from gridpush_drake.multibody.grid_object import (
    AddGridObject,
    ApplyGridObjectFilters,
    GridObjectInPlant,
)
from gridpush_drake.multibody.ground_truth import SetGridObjectParameters, SetGridObjectPose
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.station.scene.camera import AddIdealCamera, AddSeenVisual
from gridpush_drake.station.scene.contents import MakeTruth
from gridpush_drake.station.schema.scenario import PushScenario
from gridpush_drake.systems.sensing.planar_pose_sensor import PlanarPoseSensor


@dataclass(frozen=True, eq=False)
class OtherObject:
    """Another object in a station.

    Attributes:
        name: name of its model in the plant; its output port is called name.pose.
        pose: (x, y, theta) X_WB at the beginning, m and rad.
        obj: the object.
        height: its height, m.
        part: its body, cells and geometry in the plant; None where the objects are real.
    """

    name: str
    pose: tuple[float, float, float]
    obj: GridObject
    height: float
    part: GridObjectInPlant | None = None


def list_others(scenario: PushScenario, objects: Sequence[GridObject]) -> tuple[OtherObject, ...]:
    """Lists a scenario's other objects, as they are known without a plant.

    Args:
        scenario: the scenario, with poses and heights.
        objects: the other objects, in the scenario's order.
    """
    others = []
    for number, (config, obj) in enumerate(zip(scenario.others, objects, strict=True)):
        x, y, theta = config.pose
        others.append(OtherObject(f"other_{number}", (x, y, theta), obj, config.height))
    return tuple(others)


def draw_other_truth(
    scenario: PushScenario, part: GridObjectInPlant, number: int, seed: int
) -> CellParameters:
    """Draws the true masses and frictions of another object.

    Args:
        scenario: the scenario, with the ranges of the draw, and the values that it gives for parts
            of this object.
        part: the object in the plant.
        number: its place in the scenario's `others`, from 0.
        seed: seed of the run. Each object's draw has a seed of its own that is made from it.
    """
    ranges = scenario.truth.model_copy(update={"parts": scenario.others[number].parts})
    own_seed = int(np.random.SeedSequence((seed, number)).generate_state(1)[0])
    return MakeTruth(part.obj, ranges, own_seed)


def AddOthers(
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    scenario: PushScenario,
    objects: Sequence[GridObject],
    table: Sequence[GeometryId],
    pushed: GridObjectInPlant,
    *,
    visual: bool = True,
) -> tuple[OtherObject, ...]:
    """Adds a scenario's other objects to a plant; they stand on the table and touch one another.

    Args:
        plant: the plant, before Finalize; the pushed object is in it.
        scene_graph: the plant's scene graph.
        scenario: the scenario, with poses and heights.
        objects: the other objects, in the scenario's order.
        table: the table's collision geometries.
        pushed: the pushed object in the plant.
        visual: whether Meshcat shows their plain outlines.

    Returns:
        The other objects in the plant.
    """
    others = []
    parts = [pushed]
    for other in list_others(scenario, objects):
        part = AddGridObject(
            plant,
            scene_graph,
            Model(other.obj),
            "free",
            table=table,
            height=other.height,
            name=other.name,
            visual=visual,
        )
        if scenario.camera.kind == "rgbd":
            AddSeenVisual(plant, scene_graph, part)
        others.append(replace(other, part=part))
        parts.append(part)
    # Only now that all objects are in the plant, it is known whose geometries must not collide.
    for part in parts:
        ApplyGridObjectFilters(plant, scene_graph, part, table)
    return tuple(others)


def list_parts(others: Sequence[OtherObject]) -> list[GridObjectInPlant]:
    """Lists the bodies, cells and geometries of a simulated station's other objects."""
    return [other.part for other in others if other.part is not None]


def AddOtherCameras(
    builder: DiagramBuilder, scenario: PushScenario, others: Sequence[OtherObject]
) -> tuple[PlanarPoseSensor, ...]:
    """Adds an ideal camera for each other object, and exports the pose it sees as name.pose.

    Its rate and noise are those of the scenario's camera.
    """
    cameras = []
    for number, (other, part) in enumerate(zip(others, list_parts(others), strict=True)):
        seed = _make_camera_seed(scenario.seed, number)
        camera = AddIdealCamera(builder, part, scenario.camera, f"{other.name}_camera", seed)
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
    """Writes the beginning of a run into a Context: the other objects lie at rest in their places.

    Args:
        plant: the plant with the objects.
        scene_graph: the plant's scene graph.
        root_context: the Context of the whole Diagram.
        scenario: the scenario, with the ranges of the truth.
        others: the objects, with their poses.
        cameras: the ideal camera of each object; none where one camera follows all objects.
        seed: seed of the run, for the objects' truth and the noise of their cameras.
    """
    plant_context = plant.GetMyMutableContextFromRoot(root_context)
    for number, (other, part) in enumerate(zip(others, list_parts(others), strict=True)):
        truth = draw_other_truth(scenario, part, number, seed)
        SetGridObjectParameters(plant, scene_graph, root_context, part, truth)
        SetGridObjectPose(plant, plant_context, part, other.pose)
    for number, camera in enumerate(cameras):
        camera.SetSeed(root_context, _make_camera_seed(seed, number))


def place_others(others: Sequence[OtherObject]) -> tuple[Polygon, ...]:
    """Returns the outlines of the other objects where they lie at the beginning, in W, m.

    They have no holes: nothing is pushed into one.
    """
    return tuple(
        Polygon(transform_shape(other.pose, other.obj.outline).exterior) for other in others
    )


def _make_camera_seed(seed: int, number: int) -> int:
    """Makes the seed of the noise with which the other object of a number, from 0, is seen.

    The camera of the pushed object takes the run's seed itself. The 1 at the end sets this seed
    apart from that of the object's truth.
    """
    return int(np.random.SeedSequence((seed, number, 1)).generate_state(1)[0])
