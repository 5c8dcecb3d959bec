"""The station's cameras: an ideal one that measures poses, or one of which pictures are rendered.

This module is for tasks with one object; a camera that follows all objects of a task with several
is in `station.scene.scene_camera`.

With a color and depth camera (`camera.kind: rgbd` in the scenario) the robot is told neither the
object's outline nor its height: `find_object` takes a photograph of the scene at its beginning, and
what the detector finds in it is the robot's object. The detector chooses the object's body frame F.
The plant's object is then moved into the same frame, so that a pose means the same to both.
"""

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray
from pydrake.common import MemoryFile
from pydrake.common.yaml import yaml_dump_typed
from pydrake.geometry import (
    InMemoryMesh,
    LightParameter,
    MakeRenderEngineVtk,
    Mesh,
    RenderEngineVtkParams,
    Role,
    SceneGraph,
)
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, ModelInstanceIndex
from pydrake.systems.framework import Context, DiagramBuilder, OutputPort, System
from pydrake.systems.sensors import RgbdSensor
from scipy.spatial import KDTree
from shapely.geometry.base import BaseGeometry

from gridpush_drake.dynamics.pusher import PusherShape
from gridpush_drake.errors import CameraError, ScenarioError, StationError
from gridpush_drake.geometry.outline_mesh import make_outline_mesh
from gridpush_drake.geometry.se2 import transform_back
from gridpush_drake.multibody.contact_material import TABLE_INSTANCE
from gridpush_drake.multibody.grid_object import GridObjectInPlant
from gridpush_drake.multibody.ground_truth import SetGridObjectPose
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.perception.detection.detection import DetectedObject, DetectorOptions
from gridpush_drake.perception.images.camera import Camera
from gridpush_drake.perception.tracking.outline_finder import TrackerOptions
from gridpush_drake.perception.tracking.pose_prediction import PushModel
from gridpush_drake.perception.tracking.tracking import PoseTracker
from gridpush_drake.station.schema.camera_config import CameraConfig
from gridpush_drake.station.schema.scenario import PushScenario
from gridpush_drake.systems.sensing.object_detector import Detection, ObjectDetector, ObjectNaming
from gridpush_drake.systems.sensing.object_pose_estimator import ObjectPoseEstimator
from gridpush_drake.systems.sensing.objects_pose_estimator import ObjectsPoseEstimator
from gridpush_drake.systems.sensing.planar_pose_sensor import PlanarPoseSensor
from gridpush_drake.systems.sensing.rgbd_noise import RgbdNoise

LOST_BELOW = -0.01
"""An ideal camera loses an object whose bottom is lower than this in W, m."""

RENDERER_NAME = "station_camera"
"""Name of the render engine that is added to the scene graph."""

LIGHT_DIRECTION = (0.15, 0.25, 1.0)
"""Direction of the light in the camera's frame (of any length). It comes about from where the
camera is, so that what the camera sees is lit."""

PART_COLORS = ((0.42, 0.13, 0.11, 1.0), (0.10, 0.17, 0.40, 1.0), (0.08, 0.30, 0.13, 1.0))
"""Colors of the parts of the plant's objects in the camera's pictures, the largest part first: red,
green, blue and opacity. They begin anew where an object has more parts."""

LIVE_TRACKER = TrackerOptions(search_period=0.5)
"""Options of a tracker that keeps up with its camera. A search of the whole picture takes several
times as long as the look where the object was. While the gripper holds the object there is nothing
to find, and every picture would be searched."""


def check_renderer() -> None:
    """Checks that this computer can render pictures: VTK needs EGL, with a display or without.

    Raises:
        StationError: there is no EGL; the message says how to get it.
    """
    try:
        ctypes.CDLL("libEGL.so.1")
    except OSError as error:
        raise StationError(
            "a color and depth camera (rgbd) cannot be simulated here, as there is no EGL to "
            "render its pictures; get it with apt-get install libegl1 libgl1-mesa-dri"
        ) from error


def make_camera(config: CameraConfig) -> Camera:
    """Makes the camera model, with X_WC, of the color and depth camera that a scenario describes.

    Raises:
        ScenarioError: the camera is not placed in the world, or color and depth are not taken from
            one place.
    """
    try:
        return Camera.parse(Path("camera.rgbd"), yaml_dump_typed(config.rgbd))
    except CameraError as error:
        raise ScenarioError(str(error)) from error


def calc_pose_age(config: CameraConfig) -> float:
    """Calculates how old a pose is when the identifier reads it, s.

    Camera and identifier work at the same times, and the identifier reads what was there before.
    So it reads the pose of the last picture, one period old. If that takes a delay longer than a
    period to appear, it reads the pose of an older picture.
    """
    pictures = 1.0
    if config.kind == "rgbd":
        pictures = max(pictures, np.ceil(config.rgbd.output_delay * config.rate))
    return float(pictures / config.rate)


def AddIdealCamera(
    builder: DiagramBuilder, part: GridObjectInPlant, config: CameraConfig, name: str, seed: int
) -> PlanarPoseSensor:
    """Adds a camera that measures an object's pose in the plant, with noise.

    Args:
        builder: the builder that has the plant.
        part: the object in the plant.
        config: the camera's rate and noise.
        name: name of the camera's system.
        seed: seed of the noise.
    """
    sensor = PlanarPoseSensor(
        part.body_index,
        period=1 / config.rate,
        position_noise=config.position_noise,
        angle_noise=config.angle_noise,
        lowest=LOST_BELOW,
        seed=seed,
    )
    builder.AddNamedSystem(name, sensor)
    builder.Connect(part.plant.get_body_poses_output_port(), sensor.GetInputPort("body_poses"))
    return sensor


def AddSeenVisual(plant: MultibodyPlant, scene_graph: SceneGraph, part: GridObjectInPlant) -> None:
    """Adds a solid shape of an object for cameras to a plant, before Finalize.

    Each of its parts has a color of its own. Meshcat does not show the shape: there the object's
    estimate is drawn.
    """
    for number, area in enumerate(divide_outline(part.obj)):
        file = MemoryFile(
            make_outline_mesh(area, part.height, normals=True),
            ".obj",
            f"{part.obj.name}_seen_{number}.obj",
        )
        mesh = Mesh(InMemoryMesh(mesh_file=file))
        color = np.array(PART_COLORS[number % len(PART_COLORS)])
        geometry = plant.RegisterVisualGeometry(
            part.body, RigidTransform(), mesh, f"seen_{number}", color
        )
        scene_graph.RemoveRole(plant.get_source_id(), geometry, Role.kIllustration)


def divide_outline(obj: GridObject) -> list[BaseGeometry]:
    """Divides an object's outline among its parts.

    The squares of a lattice through the first cell belong to the parts of the cells next to them.

    Returns:
        An area of each part, polygons in the body frame, m, the part of the most cells first.
    """
    labels, counts = np.unique(obj.labels, return_counts=True)
    if len(labels) == 1:
        return [obj.outline]
    # Whole numbers, on which unions are exact: cell sizes from the first cell's center.
    corners = (shapely.get_coordinates(obj.outline.envelope) - obj.p_BC[0]) / obj.cell_size
    low = np.floor(corners.min(axis=0)).astype(int) - 1
    high = np.ceil(corners.max(axis=0)).astype(int) + 1
    squares = np.stack(np.meshgrid(*map(np.arange, low, high), indexing="ij"), axis=-1)
    squares = squares.reshape(-1, 2)
    _, nearest = KDTree(obj.p_BC).query(obj.p_BC[0] + squares * obj.cell_size)
    boxes = shapely.box(*squares.T, *(squares + 1).T)
    areas = []
    for label in labels[np.argsort(-counts, kind="stable")]:
        area = shapely.union_all(boxes[obj.labels[nearest] == label])
        area = shapely.transform(area, lambda points: obj.p_BC[0] + (points - 0.5) * obj.cell_size)
        areas.append(shapely.intersection(area, obj.outline))
    return areas


@dataclass(frozen=True)
class RgbdCamera:
    """A color and depth camera in a builder.

    Attributes:
        sensor: Drake's sensor, which renders the pictures.
        noise: the system that adds noise to its pictures.
        camera: its intrinsics and pose.
        occluded_by: labels, in the label image, of whatever may hide the object: the robot's bodies
            and other objects.
    """

    sensor: System
    noise: RgbdNoise
    camera: Camera
    occluded_by: tuple[int, ...]


def AddRgbdCamera(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    scenario: PushScenario,
    parts: Sequence[GridObjectInPlant],
) -> RgbdCamera:
    """Adds the scenario's camera to a builder, and connects it to the scene.

    Args:
        builder: the builder that has plant and scene graph.
        plant: the scene's plant, finalised.
        scene_graph: the plant's scene graph.
        scenario: the scenario, with `camera.rgbd`.
        parts: the objects in the plant that are looked at; whatever else stands on the table may
            hide them.

    Returns:
        The camera. Its outputs are not connected yet.

    Raises:
        ScenarioError: the camera makes no sense, see `make_camera`.
        StationError: nothing can be rendered on this computer.
    """
    check_renderer()
    config = scenario.camera
    drake = config.rgbd
    camera = make_camera(config)
    light = LightParameter(type="directional", direction=LIGHT_DIRECTION, frame="camera")
    params = RenderEngineVtkParams(lights=[light], default_clear_color=drake.background.rgba[:3])
    drake.renderer_name = RENDERER_NAME
    scene_graph.AddRenderer(RENDERER_NAME, MakeRenderEngineVtk(params))
    sensor = builder.AddNamedSystem(
        "rgbd_sensor",
        RgbdSensor(
            scene_graph.world_frame_id(), drake.X_PB.GetDeterministicValue(), *drake.MakeCameras()
        ),
    )
    noise = builder.AddNamedSystem(
        "rgbd_noise",
        RgbdNoise(
            drake.width,
            drake.height,
            1 / config.rate,
            depth_noise=config.depth_noise,
            depth_edge=config.depth_edge,
            color_noise=config.color_noise,
            exposure_noise=config.exposure_noise,
            seed=scenario.seed,
        ),
    )
    builder.Connect(scene_graph.get_query_output_port(), sensor.query_object_input_port())
    builder.Connect(sensor.color_image_output_port(), noise.GetInputPort("color_image"))
    builder.Connect(sensor.depth_image_32F_output_port(), noise.GetInputPort("depth_image"))
    return RgbdCamera(sensor, noise, camera, _find_labels(plant, parts))


def _find_labels(plant: MultibodyPlant, parts: Sequence[GridObjectInPlant]) -> tuple[int, ...]:
    """Lists the labels of all bodies but the table's and those of the objects that are looked at.

    A MultibodyPlant labels what it renders with the index of the body. Body 0 is the world.
    """
    looked_at = {
        plant.GetModelInstanceByName(TABLE_INSTANCE),
        *(part.model_instance for part in parts),
    }
    bodies = [plant.get_body(BodyIndex(index)) for index in range(1, plant.num_bodies())]
    return tuple(int(body.index()) for body in bodies if body.model_instance() not in looked_at)


def AddPoseEstimator(
    builder: DiagramBuilder,
    camera: RgbdCamera,
    scenario: PushScenario,
    found: "FoundObject",
    tip_radius: float,
    shape: PusherShape | None = None,
) -> ObjectPoseEstimator:
    """Adds the system that tracks the object through the camera's pictures.

    Args:
        builder: the builder that has the camera.
        camera: the camera.
        scenario: the scenario, with the camera's rate and delay.
        found: the object as it was found in the photograph.
        tip_radius: radius of the finger's tip, m, for where its pushes take what it hides.
        shape: of a pusher that is no disc; None of a disc.
    """
    config = scenario.camera
    height = found.obj.height or scenario.object_height
    estimator = builder.AddNamedSystem(
        "camera",
        ObjectPoseEstimator(
            PoseTracker(
                found.obj.outline,
                height,
                camera.camera,
                options=LIVE_TRACKER,
                table_top=found.table_top,
            ),
            config.rgbd.width,
            config.rgbd.height,
            period=1 / config.rate,
            latency=config.rgbd.output_delay,
            guess=found.pose,
            occluded_by=camera.occluded_by,
            model=PushModel(found.obj, top=height, radius=tip_radius, shape=shape),
        ),
    )
    ConnectPictures(builder, camera, estimator)
    return estimator


class StationCamera:
    """A station's camera of either kind, for what is set in it at the beginning of a run.

    Attributes:
        source: the system whose port `object_pose` has the poses; where it follows several objects,
            the ports `object_pose_0` and so on.
    """

    def __init__(
        self,
        source: PlanarPoseSensor | ObjectPoseEstimator | ObjectsPoseEstimator,
        noise: RgbdNoise | None = None,
    ) -> None:
        """Takes the camera's systems.

        Args:
            source: the system that gives the poses.
            noise: the system that adds noise to the pictures; None for an ideal camera, which adds
                noise to the poses by itself.
        """
        self.source = source
        self._noise = noise

    @property
    def follows_multiple(self) -> bool:
        """Whether it follows several objects."""
        return isinstance(self.source, ObjectsPoseEstimator)

    def GetPose(self, number: int = 0) -> OutputPort:
        """The port with the pose (3,) of an object, by its number; 0 for the pushed one."""
        if self.follows_multiple:
            return self.source.GetOutputPort(f"object_pose_{number}")
        return self.source.GetOutputPort("object_pose")

    def SetSeed(self, root_context: Context, seed: int) -> None:
        """Sets the seed of the noise in a Diagram's Context."""
        noisy = self._noise or self.source
        assert isinstance(noisy, RgbdNoise | PlanarPoseSensor)
        noisy.SetSeed(root_context, seed)

    def SetCovered(self, root_context: Context, covered: bool) -> None:
        """Covers the lens in a Diagram's Context, or uncovers it, from the next picture on."""
        self.source.SetCovered(root_context, covered)


@dataclass(frozen=True, eq=False)
class FoundObject:
    """The object that the robot found in its photograph, and the plant's object in the same frame.

    Attributes:
        obj: the robot's object, in the body frame F that the detector chose.
        pose: (3,) X_WF in the photograph, m and rad.
        detected: what the detector found, with a close-up of the photograph.
        true_obj: the plant's object, moved into F.
        table_top: the table's top, a polygon in W, m.
    """

    obj: GridObject
    pose: NDArray[np.float64]
    detected: DetectedObject
    true_obj: GridObject
    table_top: BaseGeometry


def find_object(
    scenario: PushScenario,
    true_obj: GridObject,
    builder: DiagramBuilder,
    scene: "PhotographedScene",
) -> FoundObject:
    """Photographs the scene at its beginning and finds the object in it.

    Args:
        scenario: a scenario with a color and depth camera.
        true_obj: the plant's object, in its own body frame B.
        builder: a builder with the scene and nothing else; a Diagram is built of it.
        scene: what stands before the camera, in the builder.

    Returns:
        The object. The heading of its frame F is the scenario's: nothing in the picture makes one
        heading better than another.

    Raises:
        ScenarioError: the camera sees no object.
        StationError: nothing can be rendered on this computer.
    """
    _, detector, root_context = _take_photograph(scenario, true_obj, builder, scene)
    seen: Detection = detector.GetOutputPort("detection").Eval(
        detector.GetMyContextFromRoot(root_context)
    )
    obj = seen.obj
    detected = seen.detected
    if obj is None or detected is None:
        raise ScenarioError(f"camera: no object is found in the first picture: {seen.message}")
    # B and F have the same heading, so that a shift by F's origin moves the plant's object into F.
    p_BF = transform_back(np.array(scenario.object_pose), detected.X_WB[:2])
    moved = replace(
        true_obj,
        p_BC=true_obj.p_BC - p_BF,
        outline=shapely.transform(true_obj.outline, lambda points: points - p_BF),
    )
    return FoundObject(
        obj=obj,
        pose=detected.X_WB,
        detected=detected,
        true_obj=moved,
        table_top=scene.table_top,
    )


def AddDetector(
    builder: DiagramBuilder,
    camera: RgbdCamera,
    scenario: PushScenario,
    table_top: BaseGeometry,
    named_after: GridObject,
) -> ObjectDetector:
    """Adds the system that finds the object in the camera's pictures.

    Args:
        builder: the builder that has the camera.
        camera: the camera.
        scenario: the scenario, with the camera's rate, the seed, and the heading of the frame.
        table_top: the table's top, a polygon in W, m.
        named_after: the object whose name and prior the found object gets: a picture tells neither.
    """
    detector = builder.AddNamedSystem(
        "detector",
        ObjectDetector(
            camera.camera,
            DetectorOptions(parts=True),
            naming=ObjectNaming(named_after.name, named_after.prior, scenario.object_pose[2]),
            table_top=table_top,
            occluded_by=camera.occluded_by,
            seed=scenario.seed,
            period=1 / scenario.camera.rate,
        ),
    )
    ConnectPictures(builder, camera, detector)
    return detector


def ConnectPictures(builder: DiagramBuilder, camera: RgbdCamera, system: System) -> None:
    """Connects the camera's color, depth and label images to the inputs of the same names."""
    for name in ("color_image", "depth_image"):
        builder.Connect(camera.noise.GetOutputPort(name), system.GetInputPort(name))
    builder.Connect(camera.sensor.label_image_output_port(), system.GetInputPort("label_image"))


@dataclass(frozen=True, eq=False)
class PhotographedScene:
    """What stands before the camera when the photograph is taken.

    Attributes:
        plant: the scene's plant, finalised.
        scene_graph: the plant's scene graph.
        arm: the arm's model instance.
        part: the object that is pushed.
        others: the other objects, each with its pose X_WB, (x, y, theta), m and rad.
        q_start: (n,) positions of the arm's joints, rad.
        table_top: the table's top, a polygon in W, m.
    """

    plant: MultibodyPlant
    scene_graph: SceneGraph
    arm: ModelInstanceIndex
    part: GridObjectInPlant
    others: Sequence[tuple[GridObjectInPlant, ArrayLike]]
    q_start: NDArray[np.float64]
    table_top: BaseGeometry


def _take_photograph(
    scenario: PushScenario, obj: GridObject, builder: DiagramBuilder, scene: PhotographedScene
) -> tuple[RgbdCamera, ObjectDetector, Context]:
    """Builds the Diagram of camera and detector, and lets the detector look at one picture.

    Returns:
        The camera, the detector, and the Diagram's Context with what the detector found.
    """
    camera = AddRgbdCamera(builder, scene.plant, scene.scene_graph, scenario, [scene.part])
    detector = AddDetector(builder, camera, scenario, scene.table_top, obj)
    diagram = builder.Build()

    # Arm and objects stand where the run will begin.
    root_context = diagram.CreateDefaultContext()
    plant_context = scene.plant.GetMyMutableContextFromRoot(root_context)
    scene.plant.SetPositions(plant_context, scene.arm, scene.q_start)
    for part, pose in ((scene.part, scenario.object_pose), *scene.others):
        SetGridObjectPose(scene.plant, plant_context, part, pose)

    # The detector looks for the first time in its initialization event.
    diagram.ExecuteInitializationEvents(root_context)
    return camera, detector, root_context
