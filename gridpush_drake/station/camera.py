"""The station's cameras: an ideal one, or one of color and depth, rendered, through which the robot sees all it knows.

With a color and depth camera (`camera.kind: rgbd` in the scenario) the robot is told neither
outline nor height: `find_object` takes a photograph of the scene at its beginning, and what the
detector makes of it is the robot's object. Its body frame F is chosen then; the plant's object is
given in it, so that poses mean the same on both sides.
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
from pydrake.systems.framework import Context, DiagramBuilder, System
from pydrake.systems.sensors import RgbdSensor
from shapely.geometry.base import BaseGeometry

from gridpush_drake.errors import CameraError, ScenarioError, StationError
from gridpush_drake.geometry.outline_mesh import make_outline_mesh
from gridpush_drake.geometry.se2 import transform_back
from gridpush_drake.multibody.contact_material import TABLE
from gridpush_drake.multibody.grid_object import GridObjectInPlant
from gridpush_drake.multibody.ground_truth import SetGridObjectPose
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.perception.camera import Camera
from gridpush_drake.perception.detection import DetectedObject
from gridpush_drake.perception.tracking import PoseTracker, TrackerOptions
from gridpush_drake.station.scenario import CameraConfig, PushScenario
from gridpush_drake.systems.object_detector import Detection, ObjectDetector, ObjectNaming
from gridpush_drake.systems.object_pose_estimator import ObjectPoseEstimator
from gridpush_drake.systems.planar_pose_sensor import PlanarPoseSensor
from gridpush_drake.systems.rgbd_noise import RgbdNoise

LOST_BELOW = -0.01
"""z of an object's bottom in W below which cameras have lost it, m: it has left the table."""

RENDERER = "station_camera"

LIGHT = (0.15, 0.25, 1.0)
"""Direction of the light in the camera's frame."""

OBJECT_COLOR = (0.42, 0.13, 0.11, 1.0)
"""Of the plant's object in the camera's pictures: red, green, blue and opacity."""

LIVE = TrackerOptions(search_period=0.5)
"""Of a tracker that keeps up with its camera, also while the gripper holds the object and there is
nothing to find."""


def check_renderer() -> None:
    """Raises StationError where pictures cannot be rendered: VTK wants EGL, with a display or without."""
    try:
        ctypes.CDLL("libEGL.so.1")
    except OSError as error:
        raise StationError(
            "a color and depth camera (rgbd) cannot be simulated here, as there is no EGL to render its pictures; get "
            "it with apt-get install libegl1 libgl1-mesa-dri"
        ) from error


def make_camera(config: CameraConfig) -> Camera:
    """The camera that a scenario describes, with its pose in W, as `gridpush object` reads it of a file.

    Raises:
        ScenarioError: it is not in the world, or color and depth are not from one place.
    """
    try:
        return Camera.parse(Path("camera.rgbd"), yaml_dump_typed(config.rgbd))
    except CameraError as error:
        raise ScenarioError(str(error)) from error


def calc_pose_age(config: CameraConfig) -> float:
    """How old a pose is when the identifier reads it, s: it sees the picture before the one being taken, or older."""
    pictures = (
        1.0 if config.kind == "ideal" else max(1.0, np.ceil(config.rgbd.output_delay * config.rate))
    )
    return float(pictures / config.rate)


def AddIdealCamera(
    builder: DiagramBuilder, part: GridObjectInPlant, config: CameraConfig, name: str, seed: int
) -> PlanarPoseSensor:
    """Adds what sees an object in a plant by its pose, with noise by a seed, and connects it to the plant."""
    noise = {"position_noise": config.position_noise, "angle_noise": config.angle_noise}
    sensor = PlanarPoseSensor(
        part.body_index, period=1 / config.rate, **noise, lowest=LOST_BELOW, seed=seed
    )
    builder.AddNamedSystem(name, sensor)
    builder.Connect(part.plant.get_body_poses_output_port(), sensor.GetInputPort("body_poses"))
    return sensor


def AddSeenVisual(plant: MultibodyPlant, scene_graph: SceneGraph, part: GridObjectInPlant) -> None:
    """Gives the plant's object a color and a height that cameras see, and Meshcat does not; before Finalize."""
    file = MemoryFile(
        make_outline_mesh(part.obj.outline, part.height, normals=True),
        ".obj",
        f"{part.obj.name}_seen.obj",
    )
    mesh = Mesh(InMemoryMesh(mesh_file=file))
    geometry = plant.RegisterVisualGeometry(
        part.body, RigidTransform(), mesh, "seen", np.array(OBJECT_COLOR)
    )
    scene_graph.RemoveRole(plant.get_source_id(), geometry, Role.kIllustration)


@dataclass(frozen=True)
class RgbdCamera:
    """A color and depth camera in a builder.

    Attributes:
        sensor: Drake's.
        noise: what its pictures go through.
        camera: its measures and pose.
        hidden_by: labels of the robot's bodies, and of other objects, in its label image.
    """

    sensor: System
    noise: RgbdNoise
    camera: Camera
    hidden_by: tuple[int, ...]


def AddRgbdCamera(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    scenario: PushScenario,
    part: GridObjectInPlant | None,
) -> RgbdCamera:
    """Adds the scenario's camera to a builder, and connects it to the scene.

    Args:
        builder: plant and scene graph are in it.
        plant: finalised.
        scene_graph: of the plant.
        scenario: its `camera.rgbd`.
        part: the object in the plant; None where it is not.

    Returns:
        The camera, as yet connected to nothing that reads it.

    Raises:
        ScenarioError: the camera makes no sense, see `make_camera`.
        StationError: nothing can be rendered here.
    """
    check_renderer()
    config, drake = scenario.camera, scenario.camera.rgbd
    camera = make_camera(config)
    light = LightParameter(type="directional", direction=LIGHT, frame="camera")
    params = RenderEngineVtkParams(lights=[light], default_clear_color=drake.background.rgba[:3])
    drake.renderer_name = RENDERER
    scene_graph.AddRenderer(RENDERER, MakeRenderEngineVtk(params))
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
    return RgbdCamera(sensor, noise, camera, _find_labels(plant, part))


def _find_labels(plant: MultibodyPlant, part: GridObjectInPlant | None) -> tuple[int, ...]:
    """Of all bodies but the table's and the object's: a MultibodyPlant labels what it renders with a body's index."""
    seen = {plant.GetModelInstanceByName(TABLE)} | (
        set() if part is None else {part.model_instance}
    )
    bodies = map(BodyIndex, range(1, plant.num_bodies()))
    return tuple(int(body) for body in bodies if plant.get_body(body).model_instance() not in seen)


def AddPoseEstimator(
    builder: DiagramBuilder, camera: RgbdCamera, scenario: PushScenario, found: "FoundObject"
) -> ObjectPoseEstimator:
    """Adds what tracks the object that was found through the camera's pictures."""
    config = scenario.camera
    height = found.obj.height or scenario.object_height
    estimator = builder.AddNamedSystem(
        "camera",
        ObjectPoseEstimator(
            PoseTracker(found.obj.outline, height, camera.camera, LIVE, found.table_top),
            config.rgbd.width,
            config.rgbd.height,
            period=1 / config.rate,
            latency=config.rgbd.output_delay,
            guess=found.pose,
            hidden_by=camera.hidden_by,
        ),
    )
    ConnectPictures(builder, camera, estimator)
    return estimator


class StationCamera:
    """What a station's run sets in its camera, of either kind."""

    def __init__(
        self, source: PlanarPoseSensor | ObjectPoseEstimator, noise: RgbdNoise | None = None
    ) -> None:
        """Takes what tells the poses, and what spoils the pictures; where there are none, the poses are spoilt."""
        self.source, self._noise = source, noise

    def SetSeed(self, root_context: Context, seed: int) -> None:
        """Sets the seed of the noise in a Diagram's Context."""
        noisy = self._noise or self.source
        assert not isinstance(noisy, ObjectPoseEstimator)
        noisy.SetSeed(root_context, seed)

    def SetCovered(self, root_context: Context, covered: bool) -> None:
        """Covers the lens in a Diagram's Context, or uncovers it; it counts from the next picture."""
        self.source.SetCovered(root_context, covered)


@dataclass(frozen=True, eq=False)
class FoundObject:
    """What the robot makes of its photograph, and what only the simulated world knows of it.

    Attributes:
        obj: the robot's object, in the frame F that it chose.
        pose: (3,) X_WF in the photograph, m and rad.
        detected: what the detector says.
        true_obj: the plant's object, in F.
        table_top: W, m.
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
        scenario: with a color and depth camera.
        true_obj: the plant's object, in its own frame.
        builder: of a Diagram with nothing else in it, with the scene.
        scene: what is in the builder.

    Returns:
        The object; its frame's heading is the scenario's, which is as good as any.

    Raises:
        ScenarioError: the camera does not see an object there.
    """
    _, detector, root = _take_photograph(scenario, true_obj, builder, scene)
    own = detector.GetMyContextFromRoot(root)
    seen: Detection = detector.GetOutputPort("detection").Eval(own)
    obj, detected = seen.obj, seen.detected
    if obj is None or detected is None:
        raise ScenarioError(f"camera: no object is found in the first picture: {seen.message}")
    shift = transform_back(np.array(scenario.object_pose), detected.X_WB[:2])
    moved = replace(
        true_obj,
        p_BC=true_obj.p_BC - shift,
        outline=shapely.transform(true_obj.outline, lambda points: points - shift),
    )
    return FoundObject(obj, detected.X_WB, detected, moved, scene.table_top)


def AddDetector(
    builder: DiagramBuilder,
    camera: RgbdCamera,
    scenario: PushScenario,
    table_top: BaseGeometry,
    told: GridObject,
) -> ObjectDetector:
    """Adds what finds the object in the camera's pictures; name and prior are those of the one that is told."""
    detector = builder.AddNamedSystem(
        "detector",
        ObjectDetector(
            camera.camera,
            naming=ObjectNaming(told.name, told.prior, scenario.object_pose[2]),
            table_top=table_top,
            hidden_by=camera.hidden_by,
            seed=scenario.seed,
            period=1 / scenario.camera.rate,
        ),
    )
    ConnectPictures(builder, camera, detector)
    return detector


def ConnectPictures(builder: DiagramBuilder, camera: RgbdCamera, system: System) -> None:
    """Connects what looks at the camera's pictures."""
    for name in ("color_image", "depth_image"):
        builder.Connect(camera.noise.GetOutputPort(name), system.GetInputPort(name))
    builder.Connect(camera.sensor.label_image_output_port(), system.GetInputPort("label_image"))


@dataclass(frozen=True, eq=False)
class PhotographedScene:
    """What stands before the camera.

    Attributes:
        plant: finalised, in the builder.
        scene_graph: of the plant.
        arm: its model instance.
        part: the object in the plant.
        others: further objects in the plant, by what they are and where, (x, y, theta), m and rad.
        q_start: of the arm, rad.
        table_top: W, m.
    """

    plant: MultibodyPlant
    scene_graph: SceneGraph
    arm: ModelInstanceIndex
    part: GridObjectInPlant
    others: Sequence[tuple[GridObjectInPlant, ArrayLike]]
    q_start: NDArray[np.float64]
    table_top: BaseGeometry


def _take_photograph(
    scenario: PushScenario, told: GridObject, builder: DiagramBuilder, scene: PhotographedScene
) -> tuple[RgbdCamera, ObjectDetector, Context]:
    """The camera, the detector, and the Diagram's Context in which it has looked at the first picture."""
    camera = AddRgbdCamera(builder, scene.plant, scene.scene_graph, scenario, scene.part)
    detector = AddDetector(builder, camera, scenario, scene.table_top, told)
    diagram = builder.Build()
    root = diagram.CreateDefaultContext()
    context = scene.plant.GetMyMutableContextFromRoot(root)
    scene.plant.SetPositions(context, scene.arm, scene.q_start)
    for part, pose in ((scene.part, scenario.object_pose), *scene.others):
        SetGridObjectPose(scene.plant, context, part, pose)
    diagram.ExecuteInitializationEvents(root)
    return camera, detector, root
