"""`EstimateVisualizer`: draws the estimate of an object over it in Meshcat while it is learned.

What has been drawn is part of the Context. Each new estimate and each new push is drawn once, at a
path with a number of its own (see `display.shapes`). What is there already is not sent again.
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
from gridpush_drake.identification.model import Model
from gridpush_drake.multibody.weak_calc import NO_SLOTS
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.pushes.push_log import DEFAULT_PUSHER_RADIUS
from gridpush_drake.systems.messages import PUSH_COMMAND_SIZE, PushCommand
from gridpush_drake.systems.object_controller import AbstractStateSystem


@dataclass(frozen=True, eq=False)
class Drawing:
    """What is to be seen in Meshcat, apart from the object's pose.

    Attributes:
        estimate: number of the present estimate, from 1; 0 if there is none.
        mass: (n,) estimated mass of each cell, kg.
        friction: (n,) estimated friction coefficient of each cell.
        center: (2,) estimated center of mass p_BBcm, m; empty if it is not known.
        covariance: (4,) covariance of the center in B, row-major, m²; empty if it is not known.
        push: number of the present push, from 1; 0 if there is none.
        command: the command of the present push.
        predicted: (3,) X_WB that the object is expected to have after the push, m and rad; empty if
            the push cannot be simulated.
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
        """Returns whether an estimate is the one that is drawn."""
        pairs = (
            (self.mass, mass),
            (self.friction, friction),
            (self.center, center),
            (self.covariance, covariance),
        )
        return all(np.array_equal(drawn, present, equal_nan=True) for drawn, present in pairs)


EMPTY = np.empty(0)
"""Stands for a vector that is not known."""

NOTHING = Drawing(
    estimate=0,
    mass=EMPTY,
    friction=EMPTY,
    center=EMPTY,
    covariance=EMPTY,
    push=0,
    command=PushCommand(),
    predicted=EMPTY,
)
"""The drawing before the first estimate."""


@dataclass(frozen=True)
class Canvas:
    """The place in Meshcat where an object's estimate is drawn, and how it is drawn.

    Attributes:
        obj: the object.
        meshcat: Meshcat in which it is drawn.
        path: path in Meshcat below which everything is drawn.
        height: height of the object, m.
        lift: height above the table at which everything is drawn, m.
        colors: colors of the cells.
        period: time between two updates of the scene, s.
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
            pose: (3,) X_WB of the object, m and rad. With NaN, for an object that is not seen, the
                drawing stays where it was.
            time: time of the Context, for which a recording keeps the changes, s.
            X_WB: pose of the object, which may be lifted or tipped, instead of `pose`.
        """
        # Drake ends the process over a time before the recording's beginning.
        moment = max(time, self.meshcat.get_mutable_recording().start_time())
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
        """Draws the estimate if that was not done yet."""
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
        """Draws the push if that was not done yet."""
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
        """Shows the newest drawing of a group, "object" or "push", instead of the one before it."""
        before = f"{self.path}/{group}/{count - 1}" if count > 1 else None
        SwapVisible(self.meshcat, f"{self.path}/{group}/{count}", before, time, self.period)


PUBLISH_PERIOD = 1 / 30
"""Time between two updates of the scene, s."""

DEFAULT_PATH = "estimate"
"""Path in Meshcat below which everything is drawn by default."""

OBJECT_PATH = f"{DEFAULT_PATH}/object"
"""Path in Meshcat below which is drawn, by default, whatever moves with the object."""


class EstimateVisualizer(AbstractStateSystem[Drawing]):
    """Colors an object's cells by their estimate, and shows what the next push is expected to do.

    It draws live and in a recording: the cells in the colors of their mass or friction; the
    estimated center of mass, with the ellipse of `display.shapes.SIGMAS` standard deviations about
    it; the commanded push as an arrow; and, as a translucent ghost, the pose of the object at the
    push's end, as predicted with the estimate at the time of the command. Cells and center are at
    `path`/object/<number of the estimate>, arrow and ghost at `path`/push/<number of the push>.

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

    * object_pose: vector of 3, X_WB, (x, y, theta), m and rad.
    * mass: vector of n, estimated mass of each cell, kg.
    * friction: vector of n, estimated friction coefficient of each cell against the support.
    * contact_friction: vector of 1, estimated friction coefficient of the tip against the object.
    * center_of_mass: vector of 2, estimated p_BBcm in B, m.
    * center_of_mass_covariance: vector of 4, its covariance in B, row-major, m².
    * push_command: vector of 6, the push, see `PushCommand`.
    * body_poses: abstract `list[RigidTransform]`, X_WB of all bodies, as a MultibodyPlant has it.
      If it is connected, and `body` is given, the object is drawn where that body is, even lifted
      or tipped.

    Only object_pose, mass and friction must be connected.

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
            meshcat: Meshcat in which it is drawn.
            height: height of the object, m.
            path: path in Meshcat below which everything is drawn.
            shows: which of the cells' values gives their color, see `CellColors`.
            limits: limits of the color scale, see `CellColors`.
            period: time between two updates of the scene, s.
            pusher_radius: radius of the finger's tip, m; by default that of the object's file, or
                `DEFAULT_PUSHER_RADIUS`.
            physics: physics of the prediction, see `simulate`; `Physics()` by default.
            lift: height above the table at which everything is drawn, m.
            body: index of the object in `body_poses`.

        Raises:
            StationError: `shows` or `limits` is not what `CellColors` takes.
        """
        super().__init__(NOTHING, period)
        KeepToItsThread(meshcat)
        self._obj = obj
        self._canvas = Canvas(
            obj=obj,
            meshcat=meshcat,
            path=path.rstrip("/"),
            height=height,
            lift=lift,
            colors=CellColors(shows, limits),
            period=period,
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
        """Draws at once; if no Simulator was initialized, it draws what is on the inputs now."""
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
        """Makes the drawing that the inputs ask for; `drawn` itself if it is the one."""
        mass = self._Eval(self._mass, context)
        friction = self._Eval(self._friction, context)
        center = self._Eval(self._center, context)
        covariance = self._Eval(self._covariance, context)
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
        """Predicts the pose X_WB (3,) after a push; empty if the model cannot say."""
        if not (command.command_id and command.distance > 0 and command.speed > 0):
            return EMPTY
        pose = self._Eval(self._object_pose, context)
        if not np.isfinite(pose).all():
            return EMPTY
        contact = self._Eval(self._contact_friction, context)
        mu = float(contact[0]) if len(contact) else self._obj.prior.contact_friction
        duration = command.distance / command.speed
        velocity = (command.end - command.start) / duration
        try:
            push = Push(command.start, velocity, duration, self._radius)
            params = CellParameters(mass, friction, mu)
            motion = simulate(Model(self._obj, params, self._physics), push, pose)
        except GridPushError:
            # An estimate or a command that is out of range; the system that made it says why.
            return EMPTY
        return motion.final_pose

    def _Eval(self, port: InputPort, context: Context) -> Array:
        """Returns the value of a vector port; empty if it is not connected."""
        return np.array(port.Eval(context)) if port.HasValue(context) else EMPTY

    def _Send(self, context: Context, drawing: Drawing) -> None:
        X_WB = None
        if self._body is not None and self._body_poses.HasValue(context):
            X_WB = self._body_poses.Eval(context)[self._body]
        self._canvas.Send(drawing, self._Eval(self._object_pose, context), context.get_time(), X_WB)
