"""`PreGraspController`: slides an object to the table's edge, and may grasp it there.

It holds no decisions of its own: it is `planning.pregrasp` between ports.
"""

from dataclasses import replace

from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context

from gridpush_drake.multibody.weak_calc import NO_SLOTS
from gridpush_drake.planning.closed_loop import Observation
from gridpush_drake.planning.pregrasp.planner import PreGraspPlanner
from gridpush_drake.planning.pregrasp.pregrasp_loop import (
    FindGrasp,
    PreGraspLoop,
    PreGraspLoopOptions,
    PreGraspState,
)
from gridpush_drake.systems.base.messages import (
    PRESS_COMMAND_SIZE,
    PUSH_COMMAND_SIZE,
    PressCommand,
    PressStatus,
    PushCommand,
)
from gridpush_drake.systems.base.object_controller import ObjectController


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
        - press_status
        output_ports:
        - status
        - push_command
        - grasp_command
        - press_command

    * object_pose: vector of 3, observed X_WB, (x, y, theta), m and rad; NaN if the object was not
      seen.
    * identification: abstract `Identification`, what was learned; without `push_names` before the
      first push.
    * push_log: abstract `PushLog`, all pushes so far; it need not be connected.
    * push_status: abstract `PushStatus` of the executor of pushes.
    * grasp_status: abstract `GraspStatus` of the executor of grasps; there only if it grasps.
    * press_status: abstract `PressStatus` of the executor of presses; there only if it weighs.
    * status: abstract `PreGraspStatus`, how the controller stands.
    * push_command: vector of 6, see `PushCommand`; its id is 0 before the first command, while a
      push is broken off, after a command was withdrawn, and while the object is grasped.
    * grasp_command: vector of 6, see `GraspCommand`; its id is 0 before the first command. It is
      there only if the controller grasps.
    * press_command: vector of 11, see `PressCommand`; its id is 0 while nothing is weighed. It is
      there only if the controller weighs.

    Abstract state: one `PreGraspState`.
    """

    __slots__ = NO_SLOTS

    def __init__(
        self,
        planner: PreGraspPlanner,
        find_grasp: FindGrasp | None,
        *,
        grasp_height: float = 0.015,
        lift: float = 0.1,
        seed: int = 0,
        options: PreGraspLoopOptions | None = None,
        answer_delay: float | None = 0.0,
        weighs: bool = False,
    ) -> None:
        """Declares the system.

        Args:
            planner: plans pokes, slides and goals for one object on one table.
            find_grasp: finds a grasp of the object where it lies; None for a controller that does
                not grasp, and is done where the object could be grasped.
            grasp_height: z of the grasp point in W, half the object's height, m.
            lift: height to which the object is lifted, m.
            seed: seed of the draws of masses that the object may have.
            options: options of the loop.
            answer_delay: time after which a decision is taken, s; None for real time, see
                `worker.make_worker`.
            weighs: whether something carries out presses at the table's edge, as a
                `TiltTestPlanner` asks for.
        """
        self.planner = planner
        super().__init__(
            planner.obj, PreGraspLoop(planner, find_grasp, seed=seed, options=options), answer_delay
        )
        self._declare_vector(
            "push_command",
            PUSH_COMMAND_SIZE,
            lambda now: PushCommand.from_push(now.push_id, now.shown_push).to_vector(),
        )
        self._grasp_status = None
        if find_grasp is not None:
            self._grasp_status = self._declare_grasp(grasp_height, lift)
        self._press_status = None
        if weighs:
            self._press_status = self.DeclareAbstractInputPort(
                "press_status", AbstractValue.Make(PressStatus())
            )
            self._declare_vector(
                "press_command",
                PRESS_COMMAND_SIZE,
                lambda now: PressCommand.from_target(
                    now.press_id, now.shown_press, now.press_pose
                ).to_vector(),
            )

    def _observe(self, context: Context) -> Observation:
        seen = super()._observe(context)
        if self._grasp_status is not None:
            seen = replace(seen, gripper=self._grasp_status.Eval(context))
        if self._press_status is None:
            return seen
        return replace(seen, presser=self._press_status.Eval(context))
