"""`Ros2Estimate`: what is known and planned, on topics with standard messages, for RViz.

Below the node's own name, `~`:

    ~/object_pose       geometry_msgs/PoseStamped: where the object is held to be
    ~/center_of_mass    geometry_msgs/PoseWithCovarianceStamped: its center, with the ellipse
    ~/push              nav_msgs/Path: the push that is under way, from its start to its end
    ~/cells             visualization_msgs/MarkerArray: the cells, colored by their masses
    /diagnostics        diagnostic_msgs/DiagnosticArray: the guard, the executor and the loop

Each is published only where its package is there. All are in the frame `world`; what changes seldom
is latched (transient local), so that who comes later has it, too.
"""

from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridpush_drake.display.cell_colors import CellColors
from gridpush_drake.geometry.se2 import make_rotation
from gridpush_drake.identification.result import Identification, calc_center_of_mass
from gridpush_drake.station.hardware.hardware_link import HardwareLink
from gridpush_drake.station.links.ros2.ros2_link import Ros2Link
from gridpush_drake.station.links.ros2.ros2_topics import WORLD
from gridpush_drake.station.links.ros2.ros2_writer import write_pose
from gridpush_drake.station.tasks.task import StationTask
from gridpush_drake.systems.base.messages import PushCommand
from gridpush_drake.systems.safety.guard_status import GuardMode, GuardStatus

PERIOD = 0.2
"""Least time between two looks at what is to be published, s, by the node's clock."""

CELL_HEIGHT = 0.005
"""Height of the cells that are shown, m."""

SEEN_SIZE = 0.95
"""Side of a cell that is shown, as a fraction of its true side: so that cells can be told apart."""

PARTS = {
    "center_of_mass": ("geometry_msgs", "PoseWithCovarianceStamped"),
    "object_pose": ("geometry_msgs", "PoseStamped"),
    "push": ("nav_msgs", "Path"),
    "cells": ("visualization_msgs", "MarkerArray"),
    "marker": ("visualization_msgs", "Marker"),
    "color": ("std_msgs", "ColorRGBA"),
    "point": ("geometry_msgs", "Point"),
    "diagnostics": ("diagnostic_msgs", "DiagnosticArray"),
    "status": ("diagnostic_msgs", "DiagnosticStatus"),
    "value": ("diagnostic_msgs", "KeyValue"),
}
"""Messages and the packages that define them."""


class Ros2Estimate:
    """Publishes what a task knows and does."""

    def __init__(self, ros: Ros2Link, task: StationTask[Any], link: HardwareLink) -> None:
        """Looks which messages are there.

        Args:
            ros: the node that publishes.
            task: whose station is looked at.
            link: whose account of the loop is published.
        """
        self._ros, self._task, self._link = ros, task, link
        self._last_time = -np.inf
        self._last_push = 0
        self._said: Identification | None = None
        self._types: dict[str, Any] = {}
        for name, (package, kind) in PARTS.items():
            try:
                self._types[name] = getattr(import_module(f"{package}.msg"), kind)
            except ImportError:
                continue

    def publish(self) -> None:
        """Publishes what is new, at most every `PERIOD`."""
        time = self._ros.get_time()
        if 0.0 <= time - self._last_time < PERIOD:
            return
        self._last_time = time
        pose = np.array(self._task.read("object.pose"))
        seen = bool(np.isfinite(pose).all())
        if seen:
            message = self._make("object_pose")
            write_pose(message.pose, pose)
            self._ros.publish("~/object_pose", message)
        self._publish_push()
        found: Identification = self._task.read("estimate.identification")
        if seen and found.push_names:
            self._publish_center(found, pose)
            self._publish_cells(found, pose)
        self._publish_diagnostics()

    def _make(self, name: str) -> Any:
        """A new message whose header says now, in the frame `world`."""
        message = self._types[name]()
        message.header.stamp = self._ros.node.get_clock().now().to_msg()
        message.header.frame_id = WORLD
        return message

    def _publish_push(self) -> None:
        if "push" not in self._types:
            return
        command = PushCommand.from_vector(self._task.read("push_command", self._task.controller))
        if command.command_id in (0, self._last_push):
            return
        self._last_push = command.command_id
        path = self._make("push")
        for point in (command.start, command.end):
            pose = self._make("object_pose")
            write_pose(pose.pose, (*point, command.direction))
            path.poses.append(pose)
        self._ros.publish("~/push", path, latched=True)

    def _publish_center(self, found: Identification, pose: NDArray[np.float64]) -> None:
        """The center of mass in W and its covariance, which turns with the object."""
        center, covariance = calc_center_of_mass(found)
        R = make_rotation(pose[2])
        message = self._make("center_of_mass")
        write_pose(message.pose.pose, (*(pose[:2] + R @ center), pose[2]))
        full = np.zeros((6, 6))
        full[:2, :2] = R @ covariance @ R.T
        message.pose.covariance = full.ravel()
        self._ros.publish("~/center_of_mass", message, latched=True)

    def _publish_cells(self, found: Identification, pose: NDArray[np.float64]) -> None:
        """The cells as one list of cubes; once for each estimate and place."""
        if "cells" not in self._types:
            return
        marker = self._types["marker"]()
        marker.header = self._make("object_pose").header
        marker.ns, marker.id, marker.action = "cells", 0, self._types["marker"].ADD
        marker.type = self._types["marker"].CUBE_LIST
        write_pose(marker.pose, pose)
        side = SEEN_SIZE * found.obj.grid.cell_size
        marker.scale.x, marker.scale.y, marker.scale.z = side, side, CELL_HEIGHT
        for x, y in found.obj.p_BC:
            marker.points.append(self._types["point"](x=float(x), y=float(y), z=0.0))
        for r, g, b in CellColors().calc_colors(found.params.mass, found.params.friction):
            color = self._types["color"](r=float(r), g=float(g), b=float(b), a=1.0)
            marker.colors.append(color)
        cells = self._types["cells"](markers=[marker])
        self._ros.publish("~/cells", cells, latched=True)

    def _publish_diagnostics(self) -> None:
        if "diagnostics" not in self._types:
            return
        guard: GuardStatus = self._task.read("guard.status")
        executor = self._task.read("executor.status")
        report = self._link.report
        values = {
            "phase": executor.phase,
            "pushes": len(self._task.read("estimate.push_log")),
            "commands": report.steps,
            "longest period, s": f"{report.worst_period:.4f}",
            "greatest force, N": f"{report.force:.1f}",
            "messages left out": report.left_out.total(),
        }
        status = self._types["status"]()
        stopped = guard.mode in (GuardMode.STOPPING, GuardMode.HOLDING)
        status.level = self._types["status"].ERROR if stopped else self._types["status"].OK
        status.name = f"{self._ros.node.get_name()}: guard"
        status.message = guard.reason or str(guard.mode)
        status.values = [
            self._types["value"](key=key, value=str(value)) for key, value in values.items()
        ]
        message = self._types["diagnostics"]()
        message.header.stamp = self._ros.node.get_clock().now().to_msg()
        message.status = [status]
        self._ros.publish("/diagnostics", message)
