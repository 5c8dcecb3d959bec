"""A Diagram of a station and the system that commands it, ready to run."""

import numpy as np
import shapely
from pydrake.geometry import Meshcat
from pydrake.systems.framework import DiagramBuilder, System

from gridpush_drake.scene.meshcat_server import AimCamera
from gridpush_drake.station.push_station import PushStation
from gridpush_drake.station.task_run import TaskRun
from gridpush_drake.systems.estimate_visualizer import EstimateVisualizer

SOURCES = {
    "object_pose": "object.pose",
    "identification": "estimate.identification",
    "push_log": "estimate.push_log",
    "push_status": "executor.status",
    "status": "executor.status",
    "grasp_status": "grasp.status",
}
"""Of what is wanted at an input port, by its name: the station's output port."""

COMMANDS = ("push_command", "grasp_command")
"""Ports that command the station, named alike on both sides."""

SHOWN = ("mass", "friction", "contact_friction", "centre_of_mass", "centre_of_mass_covariance")
"""Estimates that are drawn."""


CAMERA_SHARE = 0.78
"""Distance of Meshcat's camera from what it looks at, in diagonals of the table and the robot's base."""

CAMERA_HEIGHT = 0.25
"""Of what it looks at above the table, m: a third of the arm."""

CAMERA_AZIMUTH, CAMERA_ELEVATION = 0.75, 0.5
"""Where it stands, rad: opposite the robot, to its left, beyond the edge that things are slid to."""


def AimStationCamera(meshcat: Meshcat, station: PushStation) -> None:
    """Points Meshcat's camera so that the whole arm and the whole table are in sight, whatever the robot does."""
    x0, y0, x1, y1 = station.table_top.union(shapely.Point(0.0, 0.0)).bounds
    x, y = (np.array([x0 + x1, y0 + y1]) / 2 + station.scenario.object_pose[:2]) / 2
    distance = CAMERA_SHARE * float(np.hypot(x1 - x0, y1 - y0))
    AimCamera(meshcat, (x, y, CAMERA_HEIGHT), distance, CAMERA_AZIMUTH, CAMERA_ELEVATION)


def BuildTask(
    builder: DiagramBuilder, station: PushStation, controller: System, name: str, meshcat: Meshcat | None = None
) -> TaskRun:
    """Connects a station with what commands it, and builds the Diagram.

    Args:
        builder: both are in it, and whatever else the Diagram has.
        station: the station.
        controller: its input ports named in `SOURCES` and its output ports named in `COMMANDS` are connected.
        name: of the Diagram.
        meshcat: to show the estimate in; None for none.

    Returns:
        Runs the Diagram.
    """
    ports = map(controller.get_input_port, range(controller.num_input_ports()))
    for port in [port for port in ports if port.get_name() in SOURCES]:
        builder.Connect(station.GetOutputPort(SOURCES[port.get_name()]), port)
    for command in COMMANDS:
        if controller.HasOutputPort(command):
            builder.Connect(controller.GetOutputPort(command), station.GetInputPort(command))
    if meshcat is not None:
        AddEstimateVisualizer(builder, station, controller, meshcat)
    diagram = builder.Build()
    diagram.set_name(name)
    return TaskRun(station, diagram)


def AddEstimateVisualizer(
    builder: DiagramBuilder, station: PushStation, controller: System, meshcat: Meshcat
) -> EstimateVisualizer:
    """Shows the station's estimate and what the controller commands, in Meshcat."""
    part = station.object_in_plant
    visualizer = builder.AddNamedSystem(
        "estimate_visualizer",
        EstimateVisualizer(station.obj, meshcat, height=part.height, body=int(part.body.index())),
    )
    builder.Connect(station.GetOutputPort("body_poses"), visualizer.GetInputPort("body_poses"))
    builder.Connect(station.GetOutputPort("object.pose_true"), visualizer.GetInputPort("object_pose"))
    for port in SHOWN:
        builder.Connect(station.GetOutputPort(f"estimate.{port}"), visualizer.GetInputPort(port))
    builder.Connect(controller.GetOutputPort("push_command"), visualizer.GetInputPort("push_command"))
    return visualizer
