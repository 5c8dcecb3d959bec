"""`ContactPointController`: pushes an object to a goal; `planning.goal` between ports."""

from dataclasses import replace

from pydrake.systems.framework import Context

from gridpush_drake.identification.model import Model
from gridpush_drake.multibody.weak_calc import NO_SLOTS
from gridpush_drake.planning.closed_loop import LoopOptions, Observation
from gridpush_drake.planning.goal.next_push import GoalRules
from gridpush_drake.planning.goal.push_to_goal_loop import PushToGoalLoop, PushToGoalState
from gridpush_drake.systems.base.messages import PUSH_COMMAND_SIZE, PushCommand
from gridpush_drake.systems.base.object_controller import ObjectController


class ContactPointController(ObjectController[PushToGoalState]):
    """Pushes an object to a goal pose, as `PushToGoalLoop` decides.

    One push at a time is commanded, when the executor is ready and the object lies still. If the
    object goes out of sight before a command was taken up, the command is withdrawn, and its id is
    not used again. With another goal on the port everything begins anew, after the push under way.

    .. pydrake_system::

        name: ContactPointController
        input_ports:
        - object_pose
        - identification
        - push_log
        - push_status
        - goal_pose
        output_ports:
        - status
        - push_command

    * object_pose: vector of 3, observed X_WB, (x, y, theta), m and rad; NaN if the object was not
      seen.
    * identification: abstract `Identification`, what was learned; while it has no `push_names`,
      `params` is the model.
    * push_log: abstract `PushLog`, all pushes so far; it need not be connected.
    * push_status: abstract `PushStatus` of the executor of pushes.
    * goal_pose: vector of 3, X_WB of the object at the goal, (x, y, theta), m and rad; NaN for no
      goal.
    * status: abstract `ContactPointStatus`, how the controller stands.
    * push_command: vector of 6, see `PushCommand`; its id is 0 before the first command, and after
      one was withdrawn.

    Abstract state: one `PushToGoalState`.
    """

    __slots__ = NO_SLOTS

    def __init__(
        self,
        model: Model,
        rules: GoalRules | None = None,
        *,
        options: LoopOptions | None = None,
        answer_delay: float | None = 0.0,
    ) -> None:
        """Declares the system.

        Args:
            model: one object, with its parameters.
            rules: table, obstacles, finger, arm, tolerance of the goal, and how pushes are chosen.
            options: options of the loop.
            answer_delay: time after which a decision is taken, s; None for real time, see
                `worker.make_worker`.
        """
        super().__init__(model.obj, PushToGoalLoop(model, rules, options), answer_delay)
        self._goal_pose = self.DeclareVectorInputPort("goal_pose", 3)
        self._declare_vector(
            "push_command",
            PUSH_COMMAND_SIZE,
            lambda now: PushCommand.from_push(now.push_id, now.push).to_vector(),
        )

    def _observe(self, context: Context) -> Observation:
        return replace(super()._observe(context), goal=self._goal_pose.Eval(context))
