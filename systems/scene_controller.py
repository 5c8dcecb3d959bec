"""`SceneController`: a task with several objects; `planning.scene.scene_loop` between ports."""

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context

from gridpush_drake.multibody.weak_calc import NO_SLOTS
from gridpush_drake.planning.robot_status import GraspStatus, PushStatus
from gridpush_drake.planning.scene.scene_loop import SceneLoop, SceneLoopState, SceneObservation
from gridpush_drake.systems.messages import PUSH_COMMAND_SIZE, GraspCommand, PushCommand
from gridpush_drake.systems.object_controller import AbstractStateSystem

GRASP_COMMAND_SIZE = len(GraspCommand().to_vector())
"""Length of a `GraspCommand` as a vector."""


class SceneController(AbstractStateSystem[SceneLoopState]):
    """Pushes several objects, and at last may grasp one, as a `SceneLoop` decides.

    One push at a time is commanded, when the executor is ready and all objects lie still. The
    simulation waits for each decision.

    .. pydrake_system::

        name: SceneController
        input_ports:
        - object_poses
        - push_status
        - grasp_status
        output_ports:
        - status
        - push_command
        - grasp_command

    * object_poses: vector of 3 N, observed X_WB of the N objects, (x, y, theta) each, m and rad;
      NaN for an object that is not seen.
    * push_status: abstract `PushStatus` of the executor of pushes.
    * grasp_status: abstract `GraspStatus` of the executor of grasps; there is no such port where
      the loop finds no grasps.
    * status: abstract `SceneStatus`, how the loop stands.
    * push_command: vector of 6, see `PushCommand`; its id is 0 before the first command.
    * grasp_command: vector of 6, see `GraspCommand`; its id is 0 before a grasp is asked for. There
      is no such port where the loop finds no grasps.

    Abstract state: one `SceneLoopState`.
    """

    __slots__ = NO_SLOTS

    def __init__(self, loop: SceneLoop, *, grasp_height: float = 0.0, lift: float = 0.0) -> None:
        """Declares the system.

        Args:
            loop: decides what to do.
            grasp_height: height of the grasp above the table, m.
            lift: height to which the object is lifted, m.
        """
        super().__init__(loop.begin(), loop.options.period)
        self.loop = loop
        count = len(loop.belief.objects)
        self._object_poses = self.DeclareVectorInputPort("object_poses", 3 * count)
        self._push_status = self.DeclareAbstractInputPort(
            "push_status", AbstractValue.Make(PushStatus())
        )
        self._declare_value("status", lambda now: now.status)
        self._declare_vector(
            "push_command",
            PUSH_COMMAND_SIZE,
            lambda now: PushCommand.from_push(now.push_id, now.push).to_vector(),
        )
        self._grasp_status = None
        if loop.find_grasp is not None:
            self._grasp_status = self.DeclareAbstractInputPort(
                "grasp_status", AbstractValue.Make(GraspStatus())
            )
            self._declare_vector(
                "grasp_command",
                GRASP_COMMAND_SIZE,
                lambda now: _make_grasp_command(now, grasp_height, lift).to_vector(),
            )

    def GetState(self, context: Context) -> SceneLoopState:
        """Returns what the loop remembers in a Context of this system."""
        return self._get_state(context)

    def _go_on(self, context: Context, now: SceneLoopState) -> SceneLoopState:
        gripper = GraspStatus()
        if self._grasp_status is not None:
            gripper = self._grasp_status.Eval(context)
        return self.loop.step(
            now,
            SceneObservation(
                time=context.get_time(),
                poses=np.reshape(self._object_poses.Eval(context), (-1, 3)),
                robot=self._push_status.Eval(context),
                gripper=gripper,
            ),
        )


def _make_grasp_command(now: SceneLoopState, height: float, lift: float) -> GraspCommand:
    """Makes the command of the grasp that a state asks for."""
    if now.grasp is None:
        return GraspCommand()
    x, y = now.grasp.p_WG.tolist()
    return GraspCommand(
        command_id=now.grasp_id,
        x=x,
        y=y,
        z=height,
        approach=now.grasp.approach,
        lift=lift,
    )
