"""`EstimateVisualizer`: draws the estimates of objects over them in Meshcat while they are learned.

What has been drawn is part of the Context. Each new estimate and each new push is drawn once, at a
path with a number of its own (see `display.shapes`). What is there already is not sent again.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from pydrake.common.value import AbstractValue, Value
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, EventStatus, InputPort, State

from gridpush_drake.display.cell_colors import CellColors, Shown
from gridpush_drake.display.server import KeepToItsThread
from gridpush_drake.display.shapes import (
    LAYER_DISTANCE,
    AddArrow,
    AddCells,
    AddCenter,
    AddGhost,
    MakePlanarTransform,
    SwapVisible,
)
from gridpush_drake.dynamics.physics import Physics
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.pusher import DEFAULT_PUSHER_RADIUS, PusherShape
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import GridPushError
from gridpush_drake.geometry.se2 import Array, wrap_angle
from gridpush_drake.identification.model import Model
from gridpush_drake.multibody.weak_calc import NO_SLOTS
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.robot_status import PushStatus
from gridpush_drake.systems.base.messages import PUSH_COMMAND_SIZE, PushCommand
from gridpush_drake.systems.base.object_controller import AbstractStateSystem


@dataclass(frozen=True, eq=False)
class ShownObject:
    """An object whose estimate is drawn.

    Attributes:
        obj: the object.
        height: its height, m.
        body: its index in `body_poses`; None where it is drawn flat on the table.
    """

    obj: GridObject
    height: float
    body: int | None = None


@dataclass(frozen=True, eq=False)
class ShownEstimate:
    """The estimate of one object, as it is drawn.

    Attributes:
        number: number of the estimate, from 1.
        mass: (n,) estimated mass of each cell, kg.
        friction: (n,) estimated friction coefficient of each cell.
        center: (2,) estimated center of mass p_BBcm, m; empty if it is not known.
        covariance: (4,) covariance of the center in B, row-major, m²; empty if it is not known.
    """

    number: int
    mass: Array
    friction: Array
    center: Array
    covariance: Array

    def says_the_same(self, other: "ShownEstimate") -> bool:
        """Returns whether another estimate has the same values, whatever its number."""
        pairs = (
            (self.mass, other.mass),
            (self.friction, other.friction),
            (self.center, other.center),
            (self.covariance, other.covariance),
        )
        return all(np.array_equal(mine, theirs, equal_nan=True) for mine, theirs in pairs)


@dataclass(frozen=True, eq=False)
class Drawing:
    """What is to be seen in Meshcat, apart from the objects' poses.

    Attributes:
        estimates: (N,) the present estimates; empty before the first.
        push: number of the present drawing of a push, from 1; 0 before the first. The end of a
            push, after which none is drawn, has a number, too.
        command: the command of the last push.
        predicted: (N, 3) X_WB that the objects are expected to have after the push, m and rad; NaN
            for an object that is not expected to move, or of which nothing can be said.
        over: whether that push has ended, so that it is not drawn any more.
    """

    estimates: tuple[ShownEstimate, ...]
    push: int
    command: PushCommand
    predicted: Array
    over: bool


EMPTY_VECTOR = np.empty(0)
"""Stands for a vector that is not known."""

EMPTY_DRAWING = Drawing(
    estimates=(),
    push=0,
    command=PushCommand(),
    predicted=np.empty((0, 3)),
    over=True,
)
"""The drawing before the first estimate."""

STILL_MOTION = 1e-3
"""An object whose coordinates are all expected to change by less than this, m or rad, is not
expected to move: it is drawn without a ghost."""


@dataclass(frozen=True)
class Canvas:
    """The place in Meshcat where the objects' estimates are drawn, and how they are drawn.

    Attributes:
        objects: the N objects.
        meshcat: Meshcat in which they are drawn.
        path: path in Meshcat below which everything is drawn.
        lift: height above the table at which everything is drawn, m.
        colors: colors of the cells.
        period: time between two updates of the scene, s.
    """

    objects: tuple[ShownObject, ...]
    meshcat: Meshcat
    path: str
    lift: float
    colors: CellColors
    period: float

    def Send(
        self,
        drawing: Drawing,
        poses: Array,
        time: float,
        body_poses: Sequence[RigidTransform] | None = None,
    ) -> None:
        """Brings the scene up to date.

        Args:
            drawing: what is to be seen.
            poses: (N, 3) X_WB of the objects, m and rad. With NaN, for an object that is not seen,
                its drawing stays where it was.
            time: time of the Context, for which a recording keeps the changes, s.
            body_poses: X_WB of all bodies, which may be lifted or tipped; they take the place of
                `poses` for the objects that name their body.
        """
        # Drake ends the process over a time before the recording's beginning.
        moment = max(time, self.meshcat.get_mutable_recording().start_time())
        for b, estimate in enumerate(drawing.estimates):
            self._SendEstimate(b, estimate, moment)
        self._SendPush(drawing, moment)
        for b, shown in enumerate(self.objects):
            path = f"{self.path}/object/{b}"
            if body_poses is not None and shown.body is not None:
                raised: Any = np.array([0.0, 0.0, self.lift])
                X_WB = RigidTransform(raised) @ body_poses[shown.body]
                self.meshcat.SetTransform(path, X_WB, moment)
            elif np.isfinite(poses[b]).all():
                self.meshcat.SetTransform(path, MakePlanarTransform(poses[b], self.lift), moment)

    def Wipe(self) -> None:
        """Deletes all that was drawn."""
        self.meshcat.Delete(self.path)

    def _SendEstimate(self, b: int, estimate: ShownEstimate, time: float) -> None:
        """Draws the estimate of object b if that was not done yet."""
        group = f"object/{b}"
        path = f"{self.path}/{group}/{estimate.number}"
        if self.meshcat.HasPath(path):
            return
        shown = self.objects[b]
        colors = self.colors.calc_colors(estimate.mass, estimate.friction)
        AddCells(self.meshcat, f"{path}/cells", shown.obj, colors, shown.height)
        if len(estimate.center):
            covariance = estimate.covariance if len(estimate.covariance) else np.zeros(4)
            AddCenter(
                self.meshcat,
                f"{path}/center",
                estimate.center,
                covariance.reshape(2, 2),
                shown.height + LAYER_DISTANCE,
            )
        self._Turn(group, estimate.number, time)

    def _SendPush(self, drawing: Drawing, time: float) -> None:
        """Draws the push, or that it is over, if that was not done yet."""
        path = f"{self.path}/push/{drawing.push}"
        if not drawing.push or self.meshcat.HasPath(path):
            return
        self.meshcat.SetTransform(path, MakePlanarTransform((0.0, 0.0, 0.0), self.lift))
        command = drawing.command
        if not drawing.over and command.command_id and command.distance > 0:
            above = max(shown.height for shown in self.objects) + 4 * LAYER_DISTANCE
            AddArrow(self.meshcat, f"{path}/arrow", command.start, command.end, above)
        for b, pose in enumerate(drawing.predicted):
            if not drawing.over and np.isfinite(pose).all():
                ghost = f"{path}/ghost/{b}"
                AddGhost(self.meshcat, ghost, self.objects[b].obj, self.objects[b].height)
                self.meshcat.SetTransform(ghost, MakePlanarTransform(pose))
        self._Turn("push", drawing.push, time)

    def _Turn(self, group: str, count: int, time: float) -> None:
        """Shows the newest drawing of a group, such as "push", instead of the one before it."""
        before = f"{self.path}/{group}/{count - 1}" if count > 1 else None
        SwapVisible(self.meshcat, f"{self.path}/{group}/{count}", before, time, self.period)


PUBLISH_PERIOD = 1 / 30
"""Time between two updates of the scene, s."""

DEFAULT_PATH = "estimate"
"""Path in Meshcat below which everything is drawn by default."""

OBJECT_PATH = f"{DEFAULT_PATH}/object/0"
"""Path in Meshcat below which is drawn, by default, whatever moves with the first object."""


class EstimateVisualizer(AbstractStateSystem[Drawing]):
    """Colors objects' cells by their estimates, and shows what the next push is expected to do.

    It draws live and in a recording: the cells in the colors of their mass or friction; the
    estimated centers of mass, each with the ellipse of `display.shapes.SIGMAS` standard deviations
    about it; the commanded push as an arrow; and, as a translucent ghost, the pose of each object
    at the push's end, as predicted with the estimate at the time of the command. Cells and center
    of object b are at `path`/object/b/<number of the estimate>, arrow and ghosts, by object, at
    `path`/push/<number of the drawing>. They are taken away when the push has ended.

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
        - push_status
        - predicted_poses
        - body_poses

    Vectors of several objects have the first object's numbers first, then the second one's.

    * object_pose: vector of 3 N, X_WB of each object, (x, y, theta), m and rad.
    * mass: vector of all n, estimated mass of each cell of the objects, kg.
    * friction: vector of all n, estimated friction coefficient of each cell against the support.
    * contact_friction: vector of N, estimated friction coefficients of the tip against the objects.
    * center_of_mass: vector of 2 N, estimated p_BBcm of each object in its B, m.
    * center_of_mass_covariance: vector of 4 N, their covariances in B, row-major, m².
    * push_command: vector of 6, the push, see `PushCommand`.
    * push_status: abstract `PushStatus` of the executor of pushes. If it is not connected, a push
      is drawn until the next one is commanded.
    * predicted_poses: vector of 3 N, X_WB that each object is expected to have after the push, at
      the time of its command, m and rad; NaN for not known. If it is not connected, the pose of a
      single object is predicted here, and those of several are not.
    * body_poses: abstract `list[RigidTransform]`, X_WB of all bodies, as a MultibodyPlant has it.
      If it is connected, an object with a `body` is drawn where that body is, even lifted or
      tipped.

    Only object_pose, mass and friction must be connected.

    Initializing a Simulator wipes what is below `path` and begins anew.
    """

    __slots__ = NO_SLOTS

    def __init__(
        self,
        objects: Sequence[ShownObject],
        meshcat: Meshcat,
        *,
        path: str = DEFAULT_PATH,
        shows: Shown = "mass",
        limits: tuple[float, float] | None = None,
        period: float = PUBLISH_PERIOD,
        pusher_radius: float | None = None,
        pusher_shape: PusherShape | None = None,
        physics: Physics | None = None,
        lift: float = 0.0,
    ) -> None:
        """Declares ports, state and events.

        Args:
            objects: the N objects, at least one.
            meshcat: Meshcat in which they are drawn.
            path: path in Meshcat below which everything is drawn.
            shows: which of the cells' values gives their color, see `CellColors`.
            limits: limits of the color scale, see `CellColors`.
            period: time between two updates of the scene, s.
            pusher_radius: radius of the finger's tip, m; by default that of the first object's
                file, or `DEFAULT_PUSHER_RADIUS`.
            pusher_shape: of a pusher that is no disc, in place of the radius; None of a disc.
            physics: physics of the prediction, see `simulate`; `Physics()` by default.
            lift: height above the table at which everything is drawn, m.

        Raises:
            StationError: `shows` or `limits` is not what `CellColors` takes.
        """
        super().__init__(EMPTY_DRAWING, period)
        KeepToItsThread(meshcat)
        self._canvas = Canvas(
            objects=tuple(objects),
            meshcat=meshcat,
            path=path.rstrip("/"),
            lift=lift,
            colors=CellColors(shows, limits),
            period=period,
        )
        self._objects = tuple(shown.obj for shown in objects)
        first = self._objects[0].prior
        self._shape = pusher_shape
        self._radius = pusher_radius or first.pusher_radius or DEFAULT_PUSHER_RADIUS
        self._physics = physics
        count = len(self._objects)
        cells = sum(obj.n for obj in self._objects)
        self._object_pose = self.DeclareVectorInputPort("object_pose", 3 * count)
        self._mass = self.DeclareVectorInputPort("mass", cells)
        self._friction = self.DeclareVectorInputPort("friction", cells)
        self._contact_friction = self.DeclareVectorInputPort("contact_friction", count)
        self._center = self.DeclareVectorInputPort("center_of_mass", 2 * count)
        self._covariance = self.DeclareVectorInputPort("center_of_mass_covariance", 4 * count)
        self._command = self.DeclareVectorInputPort("push_command", PUSH_COMMAND_SIZE)
        self._push_status = self.DeclareAbstractInputPort(
            "push_status", AbstractValue.Make(PushStatus())
        )
        self._predicted_poses = self.DeclareVectorInputPort("predicted_poses", 3 * count)
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
            self._CalcDrawing(context, EMPTY_DRAWING)
        )
        return EventStatus.Succeeded()

    def _go_on(self, context: Context, now: Drawing) -> Drawing:
        return self._CalcDrawing(context, now)

    def _PublishAnew(self, context: Context) -> EventStatus:
        self._canvas.Wipe()
        return self._Publish(context)

    def _PublishNow(self, context: Context) -> EventStatus:
        """Draws at once what is on the inputs now, though the state may be a period older."""
        drawing = self._get_state(context)
        if not drawing.estimates:
            self._canvas.Wipe()
        self._Send(context, self._CalcDrawing(context, drawing))
        return EventStatus.Succeeded()

    def _Publish(self, context: Context) -> EventStatus:
        self._Send(context, self._get_state(context))
        return EventStatus.Succeeded()

    def _CalcDrawing(self, context: Context, drawn: Drawing) -> Drawing:
        """Makes the drawing that the inputs ask for; `drawn` itself if it is the one."""
        present = drawn
        estimates = self._CalcEstimates(context, drawn.estimates)
        if estimates is not drawn.estimates:
            present = replace(drawn, estimates=estimates)
        vector = self._Eval(self._command, context)
        command = PushCommand.from_vector(vector) if len(vector) else PushCommand()
        if command.command_id != drawn.command.command_id:
            return replace(
                present,
                push=drawn.push + 1,
                command=command,
                predicted=self._Predict(context, command, estimates),
                over=False,
            )
        if not drawn.over and self._HasEnded(context, command):
            return replace(present, push=drawn.push + 1, over=True)
        return present

    def _CalcEstimates(
        self, context: Context, drawn: tuple[ShownEstimate, ...]
    ) -> tuple[ShownEstimate, ...]:
        """Makes the estimates (N,) on the inputs; `drawn` itself if all are the same."""
        count = len(self._objects)
        sizes = [obj.n for obj in self._objects]
        ends = np.cumsum(sizes)[:-1]
        masses = np.split(self._Eval(self._mass, context), ends)
        frictions = np.split(self._Eval(self._friction, context), ends)
        centers = np.split(self._Eval(self._center, context), count)
        covariances = np.split(self._Eval(self._covariance, context), count)
        estimates = []
        for b, values in enumerate(zip(masses, frictions, centers, covariances, strict=True)):
            before = drawn[b] if drawn else None
            present = ShownEstimate(1 if before is None else before.number + 1, *values)
            same = before is not None and before.says_the_same(present)
            estimates.append(before if same and before is not None else present)
        if drawn and all(new is old for new, old in zip(estimates, drawn, strict=True)):
            return drawn
        return tuple(estimates)

    def _HasEnded(self, context: Context, command: PushCommand) -> bool:
        """Returns whether the executor is done with a command, as far as is known."""
        if not self._push_status.HasValue(context):
            return False
        status: PushStatus = self._push_status.Eval(context)
        return status.ready and status.command_id >= command.command_id

    def _Predict(
        self, context: Context, command: PushCommand, estimates: tuple[ShownEstimate, ...]
    ) -> Array:
        """Predicts the poses X_WB (N, 3) after a push; NaN where nothing can be said."""
        poses = np.reshape(self._Eval(self._object_pose, context), (-1, 3))
        if self._predicted_poses.HasValue(context):
            predicted = np.reshape(self._Eval(self._predicted_poses, context), (-1, 3))
            change = predicted - poses
            change[:, 2] = wrap_angle(change[:, 2])
            moves = np.abs(change).max(axis=1) >= STILL_MOTION
            return np.where(moves[:, None], predicted, np.nan)
        if len(self._objects) > 1:
            return np.full(poses.shape, np.nan)
        contact = self._Eval(self._contact_friction, context)
        return self._PredictOne(command, estimates[0], poses[0], contact)[None]

    def _PredictOne(
        self, command: PushCommand, estimate: ShownEstimate, pose: Array, contact: Array
    ) -> Array:
        """Predicts the pose X_WB (3,) of a single object after a push; NaN if that cannot be said.

        Args:
            command: the push.
            estimate: the object's estimate.
            pose: (3,) X_WB before the push, m and rad.
            contact: (1,) friction coefficient of the tip; empty for that of the object's file.
        """
        unknown = np.full(3, np.nan)
        if not (command.command_id and command.distance > 0 and command.speed > 0):
            return unknown
        if not np.isfinite(pose).all():
            return unknown
        obj = self._objects[0]
        mu = float(contact[0]) if len(contact) else obj.prior.contact_friction
        duration = command.distance / command.speed
        velocity = (command.end - command.start) / duration
        try:
            radius = self._radius if self._shape is None else self._shape.radius
            yaw = None if self._shape is None else command.direction
            push = Push(command.start, velocity, duration, radius, shape=self._shape, yaw=yaw)
            params = CellParameters(estimate.mass, estimate.friction, mu)
            motion = simulate(Model(obj, params, self._physics), push, pose)
        except GridPushError:
            # An estimate or a command that is out of range; the system that made it says why.
            return unknown
        return motion.final_pose

    def _Eval(self, port: InputPort, context: Context) -> Array:
        """Returns the value of a vector port; empty if it is not connected."""
        return np.array(port.Eval(context)) if port.HasValue(context) else EMPTY_VECTOR

    def _Send(self, context: Context, drawing: Drawing) -> None:
        body_poses = None
        if self._body_poses.HasValue(context):
            body_poses = self._body_poses.Eval(context)
        poses = np.reshape(self._Eval(self._object_pose, context), (-1, 3))
        self._canvas.Send(drawing, poses, context.get_time(), body_poses)
