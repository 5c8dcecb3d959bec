"""What an `EstimateVisualizer` has drawn, as part of its Context, and how that comes into Meshcat.

Each new estimate and each new push is drawn at a path with a number of its own (see `meshcat_drawing`), once: what is
there already is not sent again.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform

from gridpush_drake.grid.object import GridObject
from gridpush_drake.systems.cell_colors import CellColors
from gridpush_drake.systems.meshcat_drawing import (
    LAYER,
    AddArrow,
    AddCells,
    AddCentre,
    AddGhost,
    ApplyTurn,
    MakePlanarTransform,
)
from gridpush_drake.systems.push_command import PushCommand

Array = NDArray[np.float64]

SIGMAS = 2.0
"""Half axes of the ellipse about the centre of mass, in standard deviations."""


@dataclass(frozen=True, eq=False)
class Drawing:
    """What is to be seen, apart from the object's pose.

    Attributes:
        estimate: counts the estimates drawn, from 1; 0 stands for none.
        mass: (n,) of the present one, kg.
        friction: (n,) likewise.
        centre: (2,) its centre of mass, body frame, m; empty where there is none.
        covariance: (4,) of the centre, row by row, m².
        push: counts the pushes drawn, from 1; 0 stands for none.
        command: the present one.
        predicted: (3,) the pose (x, y, theta) in which it is expected to leave the object, m and rad; empty where the
            push cannot be simulated.
    """

    estimate: int
    mass: Array
    friction: Array
    centre: Array
    covariance: Array
    push: int
    command: PushCommand
    predicted: Array

    def has_estimate(self, mass: Array, friction: Array, centre: Array, covariance: Array) -> bool:
        """Whether an estimate is the one that is drawn."""
        pairs = ((self.mass, mass), (self.friction, friction), (self.centre, centre), (self.covariance, covariance))
        return all(np.array_equal(drawn, present, equal_nan=True) for drawn, present in pairs)


EMPTY = np.empty(0)

NOTHING = Drawing(0, EMPTY, EMPTY, EMPTY, EMPTY, 0, PushCommand(), EMPTY)


@dataclass(frozen=True)
class Canvas:
    """Where and how an object's estimate is drawn.

    Attributes:
        obj: the object.
        meshcat: the scene.
        path: below which everything is drawn.
        height: of the object, m.
        lift: of everything above the table, m.
        colors: of the cells.
        period: between two updates of the scene, s.
    """

    obj: GridObject
    meshcat: Meshcat
    path: str
    height: float
    lift: float
    colors: CellColors
    period: float

    def Send(self, drawing: Drawing, pose: Array, time: float, X_WB: RigidTransform | None = None) -> None:
        """Brings the scene up to date.

        Args:
            drawing: what is to be seen.
            pose: (3,) of the object, x, y, theta, m and rad; with NaN where it is not seen, and stays where it was.
            time: of the Context, s; what is recorded, is recorded for this time.
            X_WB: of the object where it is known to be, lifted or tipped, instead of `pose`.
        """
        moment = max(time, self.meshcat.get_mutable_recording().start_time())  # an earlier one would end the process
        self._SendEstimate(drawing, moment)
        self._SendPush(drawing, moment)
        if X_WB is not None:
            raised: Any = np.array([0.0, 0.0, self.lift])
            self.meshcat.SetTransform(f"{self.path}/object", RigidTransform(raised) @ X_WB, moment)
        elif np.isfinite(pose).all():
            self.meshcat.SetTransform(f"{self.path}/object", MakePlanarTransform(pose, self.lift), moment)

    def Wipe(self) -> None:
        """Deletes all that was drawn."""
        self.meshcat.Delete(self.path)

    def _SendEstimate(self, drawing: Drawing, time: float) -> None:
        path = f"{self.path}/object/{drawing.estimate}"
        if not drawing.estimate or self.meshcat.HasPath(path):
            return
        colors = self.colors.calc_colors(drawing.mass, drawing.friction)
        AddCells(self.meshcat, f"{path}/cells", self.obj, colors, self.height)
        if len(drawing.centre):
            covariance = drawing.covariance if len(drawing.covariance) else np.zeros(4)
            top = self.height + LAYER
            AddCentre(self.meshcat, f"{path}/centre", drawing.centre, covariance.reshape(2, 2), top, SIGMAS)
        self._Turn("object", drawing.estimate, time)

    def _SendPush(self, drawing: Drawing, time: float) -> None:
        path = f"{self.path}/push/{drawing.push}"
        if not drawing.push or self.meshcat.HasPath(path):
            return
        self.meshcat.SetTransform(path, MakePlanarTransform((0.0, 0.0, 0.0), self.lift))
        command = drawing.command
        if command.number and command.distance > 0:
            above = self.height + 4 * LAYER
            AddArrow(self.meshcat, f"{path}/arrow", command.start, command.end, above)
        if len(drawing.predicted):
            AddGhost(self.meshcat, f"{path}/ghost", self.obj, self.height)
            self.meshcat.SetTransform(f"{path}/ghost", MakePlanarTransform(drawing.predicted))
        self._Turn("push", drawing.push, time)

    def _Turn(self, group: str, count: int, time: float) -> None:
        """Shows a group's newest drawing instead of the one before it."""
        before = f"{self.path}/{group}/{count - 1}" if count > 1 else None
        ApplyTurn(self.meshcat, f"{self.path}/{group}/{count}", before, time, self.period)
