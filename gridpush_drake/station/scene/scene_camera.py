"""A color and depth camera that follows all objects of a scene, for tasks with several objects.

The robot is told the outlines and heights of the objects, as their files have them, and finds each
of them in the first picture: objects that touch are one piece in a photograph, which only their
outlines tell apart. `SceneTracker` follows them from then on, and a model of the scene says where a
push takes those that the arm hides. Nobody but the simulated world knows their masses.

An object that is the only one of its outline is searched for in the whole picture. Which of several
equal ones is which no picture tells, nor which end of a plate is which: these are looked for where
the scenario has them.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import DiagramBuilder, OutputPort
from pydrake.systems.primitives import MatrixGain, Multiplexer
from shapely.geometry.base import BaseGeometry

from gridpush_drake.geometry.se2 import Array
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.perception.images.camera import Camera
from gridpush_drake.perception.tracking.multi_object_tracking import KnownObject, SceneTracker
from gridpush_drake.perception.tracking.pose_prediction import ScenePushModel
from gridpush_drake.perception.tracking.symmetries import SAME_POSE_IOU, find_symmetries
from gridpush_drake.planning.belief import Belief
from gridpush_drake.station.scene.camera import (
    LIVE_TRACKER,
    LOST_BELOW,
    ConnectPictures,
    RgbdCamera,
)
from gridpush_drake.station.scene.other_objects import OtherObject, list_parts
from gridpush_drake.station.schema.scenario import PushScenario
from gridpush_drake.systems.sensing.objects_pose_estimator import ObjectsPoseEstimator
from gridpush_drake.systems.sensing.planar_pose_sensor import PlanarPoseSensor

POSE_SIZE = 3
"""Length of a pose (x, y, theta)."""


def AddObjectsPoseEstimator(
    builder: DiagramBuilder,
    camera: RgbdCamera,
    scenario: PushScenario,
    obj: GridObject,
    others: Sequence[OtherObject],
    table_top: BaseGeometry,
    tip_radius: float,
) -> ObjectsPoseEstimator:
    """Adds the system that tracks all objects through the camera's pictures.

    Args:
        builder: the builder that has the camera.
        camera: the camera.
        scenario: the scenario, with the camera's rate and delay.
        obj: the scenario's `object`, which is object 0.
        others: the objects after it.
        table_top: the table's top, a polygon in W, m.
        tip_radius: radius of the finger's tip, m, for where its pushes take what it hides.
    """
    config = scenario.camera
    tracked = TrackedScene(scenario, obj, others)
    belief = Belief.of_even_objects(tracked.objects, sample_count=0)
    estimator = builder.AddNamedSystem(
        "camera",
        ObjectsPoseEstimator(
            tracked.make_tracker(camera.camera, table_top),
            config.rgbd.width,
            config.rgbd.height,
            period=1 / config.rate,
            latency=config.rgbd.output_delay,
            guesses=tracked.guess(),
            occluded_by=camera.occluded_by,
            model=ScenePushModel(belief.bodies, top=max(tracked.heights), radius=tip_radius),
        ),
    )
    ConnectPictures(builder, camera, estimator)
    return estimator


class TrackedScene:
    """The objects of a scenario as a camera follows them.

    Attributes:
        objects: the N objects, the scenario's `object` first.
        heights: their heights, m.
        poses: (N, 3) where the scenario has them, m and rad.
    """

    def __init__(
        self, scenario: PushScenario, obj: GridObject, others: Sequence[OtherObject]
    ) -> None:
        """Lists the objects.

        Args:
            scenario: the scenario.
            obj: its `object`.
            others: its other objects.
        """
        self.objects = (obj, *(other.obj for other in others))
        self.heights = (scenario.object_height, *(other.height for other in others))
        self.poses = np.array([scenario.object_pose, *(other.pose for other in others)])

    def make_tracker(self, camera: Camera, table_top: BaseGeometry) -> SceneTracker:
        """Makes what follows the objects by their outlines.

        Args:
            camera: the camera, with X_WC.
            table_top: the table's top, a polygon in W, m.
        """
        known = [
            KnownObject(obj.outline, height, obj.name)
            for obj, height in zip(self.objects, self.heights, strict=True)
        ]
        return SceneTracker(known, camera, options=LIVE_TRACKER, table_top=table_top)

    def guess(self) -> list[ArrayLike | None]:
        """Says where the objects are looked for in the first picture; see `guess_ambiguous`."""
        return guess_ambiguous(self.objects, self.poses)


def guess_ambiguous(objects: Sequence[GridObject], poses: Array) -> list[ArrayLike | None]:
    """Says where objects are looked for: where the scenario has them, if a picture is ambiguous.

    It is if another object has the same outline, or if the object looks the same when it is turned.

    Args:
        objects: the N objects.
        poses: (N, 3) where the scenario has them, m and rad.

    Returns:
        For each object its pose, or None to search for it everywhere.
    """
    outlines = [obj.outline for obj in objects]
    guesses: list[ArrayLike | None] = []
    for outline, pose in zip(outlines, poses, strict=True):
        has_equal = sum(each.equals(outline) for each in outlines) > 1
        turned = any(way.overlap >= SAME_POSE_IOU for way in find_symmetries(outline))
        guesses.append(pose if has_equal or turned else None)
    return guesses


def AddAllSeen(builder: DiagramBuilder, poses: OutputPort) -> OutputPort:
    """Adds a port with the pose (3,) of object 0, which is NaN while any object is not seen.

    Whoever waits for object 0 by this port waits for all.

    Args:
        builder: the builder that has the poses' system.
        poses: (3 N,) poses of all objects, m and rad.
    """
    # A product with NaN is NaN, even with a factor of 0.
    first = np.eye(POSE_SIZE, poses.size())
    all_seen = builder.AddNamedSystem("all_seen", MatrixGain(first))
    builder.Connect(poses, all_seen.get_input_port())
    return all_seen.get_output_port()


def AddPosesTogether(builder: DiagramBuilder, ports: Sequence[OutputPort], name: str) -> OutputPort:
    """Adds a port with the poses of N objects in a row, (3 N,), by a system of the given name."""
    together = builder.AddNamedSystem(name, Multiplexer([POSE_SIZE] * len(ports)))
    for number, port in enumerate(ports):
        builder.Connect(port, together.get_input_port(number))
    return together.get_output_port()


def AddTruePoses(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    others: Sequence[OtherObject],
    period: float,
) -> list[OutputPort]:
    """Adds sensors of the other objects' true poses, and exports each as name.pose_true.

    They are for display and for judging the task.

    Args:
        builder: the builder that has the plant.
        plant: the plant.
        others: the other objects in it.
        period: the period of the sensors, s.
    """
    ports = []
    for other, part in zip(others, list_parts(others), strict=True):
        sensor = builder.AddNamedSystem(
            f"{other.name}_ground_truth",
            PlanarPoseSensor(part.body_index, period=period, lowest=LOST_BELOW),
        )
        builder.Connect(plant.get_body_poses_output_port(), sensor.GetInputPort("body_poses"))
        builder.ExportOutput(sensor.GetOutputPort("object_pose"), f"{other.name}.pose_true")
        ports.append(sensor.GetOutputPort("object_pose"))
    return ports
