"""Where the finger's tip may be: within the arm's reach and the scenario's workspace."""

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from gridpush_drake.station.push_station import PushStation
from gridpush_drake.station.scene import CalcTipReach

RING_SEGMENTS = 32
"""A quarter turn, of the polygon for a ring."""


def MakeFingerRegion(station: PushStation, inset: float = 0.0) -> BaseGeometry:
    """Makes the region in which the tip's center may be while it pushes.

    Args:
        station: the station.
        inset: least distance from the region's edge, m.

    Returns:
        The region, W, m: the ring that the arm reaches, and in it the workspace; it may be empty.
    """
    workspace = station.scenario.workspace
    box = shapely.box(workspace.x[0], workspace.y[0], workspace.x[1], workspace.y[1])
    axis, least, greatest = CalcTipReach(station.plant, station.robot, station.scenario.finger.push_height)
    return MakeRing(axis, least + inset, greatest - inset) & box.buffer(-inset)


def MakeRing(axis: NDArray[np.float64], least: float, greatest: float) -> shapely.Polygon:
    """The places about the robot's axis (2,) between two distances, m."""
    outer, inner = (shapely.Point(axis).buffer(radius, RING_SEGMENTS) for radius in (greatest, least))
    return outer - inner
