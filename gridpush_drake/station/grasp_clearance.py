"""Whether a grasp from the side keeps clear of the table: the gripper reaches in below the table's top."""

from dataclasses import dataclass, field

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from gridpush_drake.planning.side_grasp import SideGripper
from gridpush_drake.systems.grasp_command import GraspCommand
from gridpush_drake.systems.grasp_way import GraspingStyle


@dataclass(frozen=True, eq=False)
class GraspClearance:
    """What a `GraspExecutor` takes as `objection`.

    Attributes:
        table_top: the table's, a polygon in W, m.
        style: of the executor.
        gripper: its measures.
        clearance: least between table and gripper, m; a little less than what grasps are planned with.
    """

    table_top: BaseGeometry
    style: GraspingStyle
    gripper: SideGripper = field(default_factory=SideGripper)
    clearance: float = 0.001

    def __call__(self, command: GraspCommand) -> str | None:
        """None where the gripper is clear of the table all the way in, else a sentence."""
        gripper = self.gripper
        lanes = [(gripper.body_front, -gripper.jaw_reach, gripper.jaw_width)]
        lanes.append((gripper.body_back, gripper.body_front, gripper.body_width))
        u = command.heading
        v = np.array([-u[1], u[0]])
        for back, front, width in lanes:
            far, near = command.p_WG[:2] - (back + self.style.standoff) * u, command.p_WG[:2] - front * u
            lane = shapely.Polygon(
                [far - width / 2 * v, near - width / 2 * v, near + width / 2 * v, far + width / 2 * v]
            )
            if lane.distance(self.table_top) < self.clearance:
                return f"the gripper would hit the table on its way to ({command.x:.3f}, {command.y:.3f}) m"
        return None
