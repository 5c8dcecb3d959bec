"""Getting an object to the table's edge and grasping it there, as a Drake system: `planning.pregrasp` between ports."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context

from gridpush_drake.multibody.weak_calc import NO_SLOTS, weakly
from gridpush_drake.planning.closed_loop import Observation
from gridpush_drake.planning.pregrasp.planner import PreGraspPlanner
from gridpush_drake.planning.pregrasp.pregrasp_loop import (
    FindGrasp,
    PreGraspLoop,
    PreGraspLoopOptions,
    PreGraspState,
)
from gridpush_drake.systems.messages import (
    GRASP_COMMAND_SIZE,
    PUSH_COMMAND_SIZE,
    GraspCommand,
    GraspStatus,
    PushCommand,
)
from gridpush_drake.systems.object_controller import ObjectController


class PreGraspController(ObjectController[PreGraspState]):
    """Explores, slides, verifies, grasps and lifts, as `PreGraspLoop` decides.

    .. pydrake_system::

        name: PreGraspController
        input_ports:
        - object_pose
        - identification
        - push_log
        - push_status
        - grasp_status
        output_ports:
        - status
        - push_command
        - grasp_command

    * object_pose: vector of 3, observed (x, y, theta) of B in W, m and rad; NaN where the object
      was not seen.
    * identification: abstract `Identification`; without `push_names` before the first push.
    * push_log: abstract `PushLog`, all pushes so far; need not be connected.
    * push_status: abstract `PushStatus` of the push executor.
    * grasp_status: abstract `GraspStatus` of the grasp executor.
    * status: abstract `PreGraspStatus`.
    * push_command: vector of 6, see `PushCommand`; id 0 before the first, while a push is broken
      off, where it was withdrawn, and while the object is grasped.
    * grasp_command: vector of 6, see `GraspCommand`; id 0 before the first.

    Abstract state: one `PreGraspState`.
    """

    __slots__ = NO_SLOTS

    def __init__(
        self,
        planner: PreGraspPlanner,
        find_grasp: FindGrasp,
        *,
        grasp_height: float = 0.015,
        lift: float = 0.1,
        seed: int = 0,
        options: PreGraspLoopOptions | None = None,
        answer_delay: float | None = 0.0,
    ) -> None:
        """Declares the system.

        Args:
            planner: decides, for one object on one table.
            find_grasp: finds how to take the object where it lies.
            grasp_height: z of the grasp point in W: half the object's thickness, m.
            lift: how high to lift, m.
            seed: of the draws from what is held possible.
            options: how to go about it.
            answer_delay: s after which a decision is taken; None for real time, see
                `worker.make_worker`.
        """
        self.planner = planner
        super().__init__(
            planner.obj, PreGraspLoop(planner, find_grasp, seed=seed, options=options), answer_delay
        )
        self._height, self._lift = grasp_height, lift
        self._grasp_status = self.DeclareAbstractInputPort(
            "grasp_status", AbstractValue.Make(GraspStatus())
        )
        self._declare_vector(
            "push_command",
            PUSH_COMMAND_SIZE,
            lambda now: PushCommand.from_push(now.push_id, now.shown_push).to_vector(),
        )
        self._declare_vector("grasp_command", GRASP_COMMAND_SIZE, weakly(self._show_grasp))

    def _observe(self, context: Context) -> Observation:
        return replace(super()._observe(context), gripper=self._grasp_status.Eval(context))

    def _show_grasp(self, now: PreGraspState) -> NDArray[np.float64]:
        if now.grasp is None:
            return GraspCommand().to_vector()
        x, y = now.grasp.p_WG.tolist()
        return GraspCommand(
            now.grasp_id, x, y, self._height, now.grasp.approach, self._lift
        ).to_vector()
