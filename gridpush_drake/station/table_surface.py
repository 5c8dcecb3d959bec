"""The station's table as planning knows it."""

import shapely

from gridpush_drake.errors import ScenarioError
from gridpush_drake.planning.surface import SupportSurface
from gridpush_drake.station.push_station import PushStation

RIM_DETAIL = 5e-4
"""m by which the rim may be simplified: of a round table to a polygon of few corners."""


def make_surface(station: PushStation) -> SupportSurface:
    """The table's top. Raises ScenarioError where it is in several pieces."""
    top = station.table_top
    if not isinstance(top, shapely.Polygon):
        raise ScenarioError("directives: the table's top is in several pieces; expected one")
    return SupportSurface(shapely.simplify(top, RIM_DETAIL))
