"""The sensors of a simulated station: cameras, the tip's state, and what the arm feels."""

from collections.abc import Sequence
from dataclasses import dataclass

from pydrake.geometry import SceneGraph
from pydrake.systems.framework import DiagramBuilder, OutputPort, System
from shapely.geometry.base import BaseGeometry

from gridpush_drake.multibody.grid_object import GridObjectInPlant
from gridpush_drake.station.control.grasping import ExportOutputs
from gridpush_drake.station.robot.robot import GetTipInBody, Robot
from gridpush_drake.station.scene.camera import (
    LOST_BELOW,
    AddIdealCamera,
    AddPoseEstimator,
    AddRgbdCamera,
    FoundObject,
    StationCamera,
)
from gridpush_drake.station.scene.other_objects import OtherObject, list_parts
from gridpush_drake.station.scene.scene_camera import (
    AddAllSeen,
    AddObjectsPoseEstimator,
    AddPosesTogether,
)
from gridpush_drake.station.scene.setting import StationSetting
from gridpush_drake.station.schema.scenario import PushScenario
from gridpush_drake.systems.sensing.arm_load_sensor import ArmLoadSensor, LoadNoise
from gridpush_drake.systems.sensing.planar_pose_sensor import PlanarPoseSensor
from gridpush_drake.systems.sensing.pusher_state_sensor import PusherStateSensor

FORCE_PERIOD = 0.005
"""Time between two samples of the force on the tip of a finger that is steered, s."""


@dataclass(frozen=True)
class Sensors:
    """The sensors that `AddSensors` put into a builder.

    Attributes:
        camera: sees the object with noise.
        ground_truth: sees the object without noise, for display and for judging the task.
        tip: measures position and velocity of the finger's tip.
    """

    camera: StationCamera
    ground_truth: PlanarPoseSensor
    tip: PusherStateSensor


@dataclass(frozen=True)
class SceneViewPorts:
    """Ports of a camera that follows N objects.

    Attributes:
        poses: (3 N,) the poses as they are seen, m and rad.
        true_poses: (3 N,) the true ones.
        all_seen: (3,) the pose of object 0; NaN while any object is not seen.
    """

    poses: OutputPort
    true_poses: OutputPort
    all_seen: OutputPort


def AddSensors(
    builder: DiagramBuilder,
    scene_graph: SceneGraph,
    scenario: PushScenario,
    robot: Robot,
    part: GridObjectInPlant,
    found: FoundObject | None,
    followed: Sequence[OtherObject] = (),
    table_top: BaseGeometry | None = None,
) -> Sensors:
    """Adds the sensors of a simulated station, and connects them to its plant.

    Args:
        builder: the builder that has the plant.
        scene_graph: the plant's scene graph.
        scenario: the scenario, with its camera.
        robot: the robot, with the name of the tip's frame.
        part: the object in the plant.
        found: the object that a color and depth camera found and tracks; None for another camera.
        followed: other objects that a color and depth camera follows as well, of known outlines;
            none for another camera.
        table_top: the table's top, a polygon in W, m, if other objects are followed.
    """
    plant = part.plant
    if followed and table_top is not None:
        rgbd = AddRgbdCamera(builder, plant, scene_graph, scenario, [part, *list_parts(followed)])
        camera = StationCamera(
            AddObjectsPoseEstimator(
                builder,
                rgbd,
                scenario,
                obj=part.obj,
                others=followed,
                table_top=table_top,
                tip_radius=robot.finger.tip_radius,
            ),
            rgbd.noise,
        )
    elif found is None:
        ideal = AddIdealCamera(builder, part, scenario.camera, "camera", scenario.seed)
        camera = StationCamera(ideal)
    else:
        rgbd = AddRgbdCamera(builder, plant, scene_graph, scenario, [part])
        camera = StationCamera(
            AddPoseEstimator(builder, rgbd, scenario, found, robot.finger.tip_radius, robot.shape),
            rgbd.noise,
        )
    ground_truth = builder.AddNamedSystem(
        "ground_truth_sensor",
        PlanarPoseSensor(part.body.index(), period=1 / scenario.camera.rate, lowest=LOST_BELOW),
    )
    tip_body, X_BP = GetTipInBody(plant, robot)
    tip = builder.AddNamedSystem(
        "tip_sensor", PusherStateSensor(tip_body.index(), X_BP.translation(), X_BP.rotation())
    )
    for sensor in (ground_truth, tip):
        builder.Connect(plant.get_body_poses_output_port(), sensor.GetInputPort("body_poses"))
    builder.Connect(
        plant.get_body_spatial_velocities_output_port(), tip.GetInputPort("body_spatial_velocities")
    )
    return Sensors(camera=camera, ground_truth=ground_truth, tip=tip)


def AddLoadSensor(
    builder: DiagramBuilder, setting: StationSetting, driver: System
) -> ArmLoadSensor:
    """Adds what tells, with noise, which forces the simulated arm feels."""
    robot = setting.robot
    weighing = setting.scenario.weighing
    sensor: ArmLoadSensor = builder.AddNamedSystem(
        "load_sensor",
        ArmLoadSensor(
            setting.control_plant,
            robot.finger.tip_frame,
            None if robot.gripper is None else robot.gripper.grasp_frame,
            noise=LoadNoise(
                force=weighing.force_noise,
                torque=weighing.torque_noise,
                force_offset=weighing.force_offset,
                torque_offset=weighing.torque_offset,
            ),
            seed=setting.scenario.seed,
        ),
    )
    for port in ("position_measured", "torque_external"):
        builder.Connect(driver.GetOutputPort(port), sensor.GetInputPort(port))
    return sensor


def AddSceneView(
    builder: DiagramBuilder,
    sensors: Sensors,
    others: Sequence[OtherObject],
    truths: Sequence[OutputPort],
) -> SceneViewPorts | None:
    """Exports what a camera sees that follows all objects; None for another camera."""
    camera = sensors.camera
    if not camera.follows_multiple:
        return None
    seen = [camera.GetPose(number) for number in range(len(others) + 1)]
    for other, port in zip(others, seen[1:], strict=True):
        builder.ExportOutput(port, f"{other.name}.pose")
    ExportOutputs(builder, camera.source, "camera", ("message",))
    first = sensors.ground_truth.GetOutputPort("object_pose")
    poses = AddPosesTogether(builder, seen, "scene_poses")
    return SceneViewPorts(
        poses=poses,
        true_poses=AddPosesTogether(builder, [first, *truths], "true_scene_poses"),
        all_seen=AddAllSeen(builder, poses),
    )
