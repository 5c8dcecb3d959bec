"""`GraspFinder`: how, and where on the table's rim, the station's gripper can take an object."""

from dataclasses import dataclass, field
from math import atan2

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from gridpush_drake.errors import StationError
from gridpush_drake.grid.object import GridObject
from gridpush_drake.planning.pregrasp_goal import PreGraspGoal
from gridpush_drake.planning.side_grasp import SideGrasp, SideGripper, find_side_grasps
from gridpush_drake.planning.surface import SupportSurface
from gridpush_drake.planning.varied_grasps import choose_varied
from gridpush_drake.station.push_station import PushStation
from gridpush_drake.systems.grasp_command import GraspCommand

Array = NDArray[np.float64]

RIM_STEP = 0.03
"""m along the rim, between places that the gripper is tried at."""

RIM_SPARE = 0.002
"""m between the gripper's tips and the rim, beyond their least clearance, where places of the rim are tried."""

GRASPS_TRIED = 16
"""Of those found at a pose, all different, that the arm is asked about."""


@dataclass(frozen=True, eq=False)
class GraspFinder:
    """Finds grasps that the arm can carry out.

    Attributes:
        station: the station; it has a gripper.
        obj: the object.
        surface: the table.
        gripper: its measures.
    """

    station: PushStation
    obj: GridObject
    surface: SupportSurface
    gripper: SideGripper = field(default_factory=SideGripper)

    def find_grasp(self, pose: Array, centre_of_mass: Array) -> SideGrasp | None:
        """How the gripper takes the object at `pose` (3,), as near its centre of mass (2,), body frame, as it can."""
        found = find_side_grasps(
            self.obj,
            pose,
            self.surface,
            self.gripper,
            centre_of_mass,
            height=self.station.scenario.object_height,
        )
        for grasp in choose_varied(found, GRASPS_TRIED):
            if self._is_reached(grasp.p_WG, grasp.approach):
                return grasp
        return None

    def can_grasp(self, goal: PreGraspGoal) -> bool:
        """Whether the object can be taken at a goal."""
        return self.find_grasp(goal.pose, goal.part.p_BG) is not None

    def find_rim(self) -> BaseGeometry:
        """Where on the rim the gripper can take something, come in straight across. Raises StationError for nowhere."""
        out = self.gripper.jaw_reach + self.gripper.table_clearance + RIM_SPARE
        places = []
        for s in np.arange(0.0, self.surface.perimeter, RIM_STEP):
            point, normal = self.surface.rim_at(float(s))
            if self._is_reached(point + out * normal, atan2(-normal[1], -normal[0])):
                places.append(shapely.Point(point).buffer(RIM_STEP))
        if not places:
            raise StationError("the gripper reaches no place of the table's rim; expected a table beside the robot")
        return shapely.union_all(places)

    def _is_reached(self, p_WG: Array, approach: float) -> bool:
        """Whether the arm can grasp at a point (2,), m, with the fingers pointing along `approach`, rad."""
        scenario, (x, y) = self.station.scenario, p_WG.tolist()
        command = GraspCommand(1, x, y, scenario.object_height / 2, approach, scenario.pregrasp.lift)
        return self.station.FindGraspObstacle(command) is None
