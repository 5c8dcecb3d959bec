"""`SceneController`: a task with several objects; `planning.scene.joint_loop` between ports."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context

from gridpush_drake.geometry.se2 import Array
from gridpush_drake.identification.result import Identification, calc_center_of_mass
from gridpush_drake.multibody.weak_calc import NO_SLOTS
from gridpush_drake.planning.closed_loop import Observation
from gridpush_drake.planning.robot_status import GraspStatus, PushStatus
from gridpush_drake.planning.scene.joint_loop import JointLoop, JointState
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.systems.base.messages import (
    PUSH_COMMAND_SIZE,
    PushCommand,
)
from gridpush_drake.systems.base.object_controller import LoopController

NO_LOG = PushLog(())
"""What is shown to the loop of pushes: it keeps its own log."""


class SceneController(LoopController[JointState]):
    """Pushes several objects, and at last may grasp one, as a `JointLoop` decides.

    One push at a time is commanded, when the executor is ready and all objects lie still.

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
        - mass
        - friction
        - contact_friction
        - center_of_mass
        - center_of_mass_covariance
        - predicted_poses

    * object_poses: vector of 3 N, observed X_WB of the N objects, (x, y, theta) each, m and rad;
      NaN for an object that is not seen.
    * push_status: abstract `PushStatus` of the executor of pushes.
    * grasp_status: abstract `GraspStatus` of the executor of grasps; there is no such port where
      the loop finds no grasps.
    * status: abstract `SceneStatus`, how the loop stands.
    * push_command: vector of 6, see `PushCommand`; its id is 0 before the first command.
    * grasp_command: vector of 6, see `GraspCommand`; its id is 0 before a grasp is asked for. There
      is no such port where the loop finds no grasps.
    * mass: vector of all n, estimated mass of each cell of the objects, kg; this vector and the
      following ones have the first object's numbers first, then the second one's.
    * friction: vector of all n, estimated friction coefficient of each cell against the support.
    * contact_friction: vector of N, estimated friction coefficients of the tip against the objects.
    * center_of_mass: vector of 2 N, estimated p_BBcm of each object in its B, m.
    * center_of_mass_covariance: vector of 4 N, their covariances in B, row-major, m².
    * predicted_poses: vector of 3 N, X_WB that each object is expected to have after the commanded
      push, m and rad; NaN while no push is under way.

    Abstract state: one `JointState`.
    """

    __slots__ = NO_SLOTS

    def __init__(
        self,
        loop: JointLoop,
        *,
        grasp_height: float = 0.0,
        lift: float = 0.0,
        answer_delay: float | None = 0.0,
    ) -> None:
        """Declares the system.

        Args:
            loop: decides what to do.
            grasp_height: height of the grasp above the table, m.
            lift: height to which the object is lifted, m.
            answer_delay: time after which a decision is taken, s; None for real time, see
                `worker.make_worker`.

        Raises:
            PlanningError: the delay is negative.
        """
        super().__init__(loop, answer_delay)
        count = len(loop.belief.objects)
        self._object_poses = self.DeclareVectorInputPort("object_poses", 3 * count)
        self._push_status = self.DeclareAbstractInputPort(
            "push_status", AbstractValue.Make(PushStatus())
        )
        self._declare_vector(
            "push_command",
            PUSH_COMMAND_SIZE,
            lambda now: PushCommand.from_push(now.push_id, now.push).to_vector(),
        )
        self._grasp_status = None
        if loop.find_grasp is not None:
            self._grasp_status = self._declare_grasp(grasp_height, lift)

        self._declare_estimates(loop)

    def _declare_estimates(self, loop: JointLoop) -> None:
        """Declares the ports that show what is believed of the objects, and expected of a push."""
        count = len(loop.belief.objects)
        cells = sum(obj.n for obj in loop.belief.objects)

        def declare(name: str, size: int, show: Callable[[Identification], ArrayLike]) -> None:
            self._declare_vector(
                name,
                size,
                lambda now: np.concatenate(
                    [np.ravel(show(found)) for found in now.belief.identifications]
                ),
            )

        declare("mass", cells, lambda found: found.params.mass)
        declare("friction", cells, lambda found: found.params.friction)
        declare("contact_friction", count, lambda found: found.params.contact_friction)
        declare("center_of_mass", 2 * count, lambda found: calc_center_of_mass(found)[0])
        declare("center_of_mass_covariance", 4 * count, lambda found: calc_center_of_mass(found)[1])
        self._declare_vector("predicted_poses", 3 * count, _list_expected)

    def GetState(self, context: Context) -> JointState:
        """Returns what the loop remembers in a Context of this system."""
        return self._get_state(context)

    def _observe(self, context: Context) -> Observation:
        gripper = GraspStatus()
        if self._grasp_status is not None:
            gripper = self._grasp_status.Eval(context)
        return Observation(
            time=context.get_time(),
            pose=np.reshape(self._object_poses.Eval(context), (-1, 3)),
            robot=self._push_status.Eval(context),
            log=NO_LOG,
            gripper=gripper,
        )


def _list_expected(now: JointState) -> Array:
    """Lists where the push under way is expected to leave the objects, (3 N,); NaN for unknown."""
    asked = now.asked
    if asked is None or asked.decision.expected is None:
        return np.full(3 * len(now.belief.objects), np.nan)
    return asked.decision.expected.ravel()
