"""`LineConfig`: the section of a scenario for the task `line`."""

from typing import Annotated

from pydantic import Field

from gridpush_drake.station.schema.fields import MAX_SIZE, Config, Point


class LineConfig(Config):
    """Along which line on the table the object is pushed.

    How fast, and how near to its end is near enough, stands in `follow`.

    Attributes:
        points: places [x, y] on the table, W, m. The centroid of the object's cells goes from where
            the object lies straight to the first of them, then to the second, and so on, to the
            last one, where the finger stops. The object turns with the line.
    """

    points: Annotated[
        list[Point],
        Field(description=f"a list of places [x, y], in m, at most {MAX_SIZE:g}"),
    ] = []
