"""`EstimateVisualizer`: what is believed of an object, drawn over it in Meshcat while it is learned.

What has been drawn is part of the Context. Each new estimate and each new push is drawn at a path
with a number of its own (see `display.shapes`), once: what is there already is not sent again.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from pydrake.common.value import Value
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, EventStatus, InputPort, State

from gridpush_drake.display.cell_colors import CellColors, Shown
from gridpush_drake.display.server import KeepToItsThread
from gridpush_drake.display.shapes import (
    LAYER,
    AddArrow,
    AddCells,
    AddCenter,
    AddGhost,
    MakePlanarTransform,
    SwapVisible,
)
from gridpush_drake.dynamics.physics import Physics
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import GridPushError
from gridpush_drake.geometry.se2 import Array
from gridpush_drake.multibody.weak_calc import NO_SLOTS
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.pushes.push_log import DEFAULT_PUSHER_RADIUS
from gridpush_drake.systems.messages import PUSH_COMMAND_SIZE, PushCommand
from gridpush_drake.systems.object_controller import AbstractStateSystem


@dataclass(frozen=True, eq=False)
class Drawing:
    """What is to be seen, apart from the object's pose.

    Attributes:
        estimate: counts the estimates drawn, from 1; 0 stands for none.
        mass: (n,) of the present one, kg.
        friction: (n,) likewise.
        center: (2,) its center of mass, body frame, m; empty where there is none.
        covariance: (4,) of the center, row by row, m².
        push: counts the pushes drawn, from 1; 0 stands for none.
        command: the present one.
        predicted: (3,) the pose (x, y, theta) in which it is expected to leave the object, m and
            rad; empty where the push cannot be simulated.
    """

    estimate: int
    mass: Array
    friction: Array
    center: Array
    covariance: Array
    push: int
    command: PushCommand
    predicted: Array

    def has_estimate(self, mass: Array, friction: Array, center: Array, covariance: Array) -> bool:
        """Whether an estimate is the one that is drawn."""
        pairs = (
            (self.mass, mass),
            (self.friction, friction),
            (self.center, center),
            (self.covariance, covariance),
        )
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

    def Send(
        self, drawing: Drawing, pose: Array, time: float, X_WB: RigidTransform | None = None
    ) -> None:
        """Brings the scene up to date.

        Args:
            drawing: what is to be seen.
            pose: (3,) of the object, x, y, theta, m and rad; with NaN where it is not seen, and
                stays where it was.
            time: of the Context, s; what is recorded, is recorded for this time.
            X_WB: of the object where it is known to be, lifted or tipped, instead of `pose`.
        """
        moment = max(
            time, self.meshcat.get_mutable_recording().start_time()
        )  # an earlier one would end the process
        self._SendEstimate(drawing, moment)
        self._SendPush(drawing, moment)
        if X_WB is not None:
            raised: Any = np.array([0.0, 0.0, self.lift])
            self.meshcat.SetTransform(f"{self.path}/object", RigidTransform(raised) @ X_WB, moment)
        elif np.isfinite(pose).all():
            self.meshcat.SetTransform(
                f"{self.path}/object", MakePlanarTransform(pose, self.lift), moment
            )

    def Wipe(self) -> None:
        """Deletes all that was drawn."""
        self.meshcat.Delete(self.path)

    def _SendEstimate(self, drawing: Drawing, time: float) -> None:
        path = f"{self.path}/object/{drawing.estimate}"
        if not drawing.estimate or self.meshcat.HasPath(path):
            return
        colors = self.colors.calc_colors(drawing.mass, drawing.friction)
        AddCells(self.meshcat, f"{path}/cells", self.obj, colors, self.height)
        if len(drawing.center):
            covariance = drawing.covariance if len(drawing.covariance) else np.zeros(4)
            top = self.height + LAYER
            AddCenter(self.meshcat, f"{path}/center", drawing.center, covariance.reshape(2, 2), top)
        self._Turn("object", drawing.estimate, time)

    def _SendPush(self, drawing: Drawing, time: float) -> None:
        path = f"{self.path}/push/{drawing.push}"
        if not drawing.push or self.meshcat.HasPath(path):
            return
        self.meshcat.SetTransform(path, MakePlanarTransform((0.0, 0.0, 0.0), self.lift))
        command = drawing.command
        if command.command_id and command.distance > 0:
            above = self.height + 4 * LAYER
            AddArrow(self.meshcat, f"{path}/arrow", command.start, command.end, above)
        if len(drawing.predicted):
            AddGhost(self.meshcat, f"{path}/ghost", self.obj, self.height)
            self.meshcat.SetTransform(f"{path}/ghost", MakePlanarTransform(drawing.predicted))
        self._Turn("push", drawing.push, time)

    def _Turn(self, group: str, count: int, time: float) -> None:
        """Shows a group's newest drawing instead of the one before it."""
        before = f"{self.path}/{group}/{count - 1}" if count > 1 else None
        SwapVisible(self.meshcat, f"{self.path}/{group}/{count}", before, time, self.period)


PUBLISH_PERIOD = 1 / 30
"""Time between two updates of the scene, s."""

DEFAULT_PATH = "estimate"
"""In Meshcat: everything is drawn below it where no other path is asked for."""

OBJECT_PATH = f"{DEFAULT_PATH}/object"
"""In Meshcat: what moves with the object is drawn below it."""


class EstimateVisualizer(AbstractStateSystem[Drawing]):
    """Colors an object's cells by their estimate, live and in a recording, and shows what the next push will do.

    Drawn are the cells in the colors of their mass or friction; the estimated center of mass, with
    the ellipse of `display.shapes.SIGMAS` standard deviations about it; the commanded push as an
    arrow; and, as a translucent ghost, the pose that the estimate at the time of the command
    predicts for its end. Everything is below `path`: the cells and the center at
    `path`/object/<count of estimates>, arrow and ghost at `path`/push/<count of pushes>.

    .. pydrake_system::

        name: EstimateVisualizer
        input_ports:
        - object_pose
        - mass
        - friction
        - contact_friction
        - center_of_mass
        - center_of_mass_covariance
        - push_command
        - body_poses

    * object_pose: vector of 3, (x, y, theta) of B in W, m and rad.
    * mass: vector of n, estimated mass of each cell, kg.
    * friction: vector of n, estimated friction coefficient of each cell against the support.
    * contact_friction: vector of 1, estimated friction coefficient of the tip against the object;
      need not be connected.
    * center_of_mass: vector of 2, estimated p_BBcm in B, m; need not be connected.
    * center_of_mass_covariance: vector of 4, its covariance in B, row-major, m²; need not be
      connected.
    * push_command: vector of 6, see `PushCommand`; need not be connected.
    * body_poses: abstract `list[RigidTransform]`, as a MultibodyPlant gives it; need not be
      connected. Where it is, and `body` is given, the object is drawn where that body is, lifted
      and tipped as it may be.

    Initializing a Simulator wipes what is below `path` and begins anew.
    """

    __slots__ = NO_SLOTS

    def __init__(
        self,
        obj: GridObject,
        meshcat: Meshcat,
        *,
        height: float,
        path: str = DEFAULT_PATH,
        shows: Shown = "mass",
        limits: tuple[float, float] | None = None,
        period: float = PUBLISH_PERIOD,
        pusher_radius: float | None = None,
        physics: Physics | None = None,
        lift: float = 0.0,
        body: int | None = None,
    ) -> None:
        """Declares ports, state and events.

        Args:
            obj: the object.
            meshcat: where to draw.
            height: of the object, m.
            path: in Meshcat, below which everything is drawn.
            shows: which of the cells' values gives their color, see `CellColors`.
            limits: of the color scale, see `CellColors`.
            period: between two updates of the scene, s.
            pusher_radius: of the finger's tip, m; by default the object's file's, or
                DEFAULT_PUSHER_RADIUS.
            physics: of the prediction, see `simulate`; `Physics()` by default.
            lift: of everything above the table, m.
            body: index of the object among `body_poses`.

        Raises:
            StationError: `shows` or `limits` is not what `CellColors` takes.
        """
        super().__init__(NOTHING, period)
        KeepToItsThread(meshcat)
        self._obj = obj
        self._canvas = Canvas(
            obj, meshcat, path.rstrip("/"), height, lift, CellColors(shows, limits), period
        )
        self._radius = pusher_radius or obj.prior.pusher_radius or DEFAULT_PUSHER_RADIUS
        self._physics = physics
        self._object_pose = self.DeclareVectorInputPort("object_pose", 3)
        self._mass = self.DeclareVectorInputPort("mass", obj.n)
        self._friction = self.DeclareVectorInputPort("friction", obj.n)
        self._contact_friction = self.DeclareVectorInputPort("contact_friction", 1)
        self._center = self.DeclareVectorInputPort("center_of_mass", 2)
        self._covariance = self.DeclareVectorInputPort("center_of_mass_covariance", 4)
        self._command = self.DeclareVectorInputPort("push_command", PUSH_COMMAND_SIZE)
        self._body = body
        self._body_poses = self.DeclareAbstractInputPort(
            "body_poses", Value[list[RigidTransform]]()
        )
        self.DeclareInitializationUnrestrictedUpdateEvent(self._Begin)
        self.DeclareInitializationPublishEvent(self._PublishAnew)
        self.DeclarePeriodicPublishEvent(period, 0.0, self._Publish)
        self.DeclareForcedPublishEvent(self._PublishNow)

    def _Begin(self, context: Context, state: State) -> EventStatus:
        """Forgets what was drawn before."""
        state.get_mutable_abstract_state(int(self._state)).set_value(
            self._CalcDrawing(context, NOTHING)
        )
        return EventStatus.Succeeded()

    def _go_on(self, context: Context, now: Drawing) -> Drawing:
        return self._CalcDrawing(context, now)

    def _PublishAnew(self, context: Context) -> EventStatus:
        self._canvas.Wipe()
        return self._Publish(context)

    def _PublishNow(self, context: Context) -> EventStatus:
        """Draws the inputs as they are where no Simulator was initialized, and as a periodic event otherwise."""
        drawing = self._get_state(context)
        if not drawing.estimate:
            self._canvas.Wipe()
            drawing = self._CalcDrawing(context, drawing)
        self._Send(context, drawing)
        return EventStatus.Succeeded()

    def _Publish(self, context: Context) -> EventStatus:
        self._Send(context, self._get_state(context))
        return EventStatus.Succeeded()

    def _CalcDrawing(self, context: Context, drawn: Drawing) -> Drawing:
        """What the inputs ask for; `drawn` itself where that is drawn already."""
        mass, friction = self._Eval(self._mass, context), self._Eval(self._friction, context)
        center, covariance = (
            self._Eval(self._center, context),
            self._Eval(self._covariance, context),
        )
        present = drawn
        if not drawn.estimate or not drawn.has_estimate(mass, friction, center, covariance):
            present = replace(
                drawn,
                estimate=drawn.estimate + 1,
                mass=mass,
                friction=friction,
                center=center,
                covariance=covariance,
            )
        vector = self._Eval(self._command, context)
        command = PushCommand.from_vector(vector) if len(vector) else PushCommand()
        if command.command_id == drawn.command.command_id:
            return present
        predicted = self._Predict(context, command, mass, friction)
        return replace(present, push=drawn.push + 1, command=command, predicted=predicted)

    def _Predict(
        self, context: Context, command: PushCommand, mass: Array, friction: Array
    ) -> Array:
        """The pose (3,) after a push; empty where the model cannot say."""
        if not (command.command_id and command.distance > 0 and command.speed > 0):
            return EMPTY
        contact = self._Eval(self._contact_friction, context)
        mu = float(contact[0]) if len(contact) else self._obj.prior.contact_friction
        pose, duration = self._Eval(self._object_pose, context), command.distance / command.speed
        if not np.isfinite(pose).all():
            return EMPTY
        try:
            push = Push(
                command.start, (command.end - command.start) / duration, duration, self._radius
            )
            params = CellParameters(mass, friction, mu)
            motion = simulate(self._obj, params, push, pose, physics=self._physics)
        except (
            GridPushError
        ):  # an estimate or a command out of range has no ghost; whoever made it says why
            return EMPTY
        return motion.final_pose

    def _Eval(self, port: InputPort, context: Context) -> Array:
        """A port's value; empty where an optional one is not connected."""
        return np.array(port.Eval(context)) if port.HasValue(context) else EMPTY

    def _Send(self, context: Context, drawing: Drawing) -> None:
        X_WB = None
        if self._body is not None and self._body_poses.HasValue(context):
            X_WB = self._body_poses.Eval(context)[self._body]
        self._canvas.Send(drawing, self._Eval(self._object_pose, context), context.get_time(), X_WB)
