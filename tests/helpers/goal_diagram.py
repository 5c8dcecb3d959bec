"""A small Diagram without an arm: a contact-point controller and an executor move an ideal finger, the LCP is the
world, the identifier watches through a noisy camera that can be covered up.
"""

from typing import Any, NamedTuple

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, DiagramBuilder, LeafSystem
from pydrake.systems.primitives import ConstantVectorSource

from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.goal.next_push import GoalRules
from gridpush_drake.pushes.segmentation import RecordOptions
from gridpush_drake.systems.base.messages import ContactPointStatus
from gridpush_drake.systems.control.contact_point_controller import ContactPointController
from gridpush_drake.systems.dynamics.grid_lcp_system import GridLcpSystem
from gridpush_drake.systems.execution.push_executor import PushExecutor, PushTrajectoryOptions
from gridpush_drake.systems.learning.grid_identifier import DEFAULT_PERIOD, GridIdentifier
from tests.helpers.poke_diagram import OBJECT_HEIGHT, Camera, IdealFinger

STYLE = PushTrajectoryOptions(travel_speed=0.6, vertical_speed=0.4)


class Cover(LeafSystem):
    """Hides the object from the camera between two times, s; both are parameters of the Context."""

    def __init__(self) -> None:
        super().__init__()
        self.DeclareVectorInputPort("pose", 3)
        self.DeclareNumericParameter(_vector([np.inf, np.inf]))
        self.DeclareVectorOutputPort("object_pose", 3, self._calc_pose)

    def _calc_pose(self, context: Context, output: Any) -> None:
        begin, end = context.get_numeric_parameter(0).value()
        hidden = begin <= context.get_time() < end
        output.SetFromVector(
            np.full(3, np.nan) if hidden else self.GetInputPort("pose").Eval(context)
        )


def _vector(values: list[float]) -> Any:
    from pydrake.systems.framework import BasicVector

    return BasicVector(values)


class Run(NamedTuple):
    """A Diagram's simulator and its parts."""

    simulator: Simulator
    world: GridLcpSystem
    controller: ContactPointController
    executor: PushExecutor
    goal: ConstantVectorSource
    cover: Cover

    @property
    def status(self) -> ContactPointStatus:
        return self.read(self.controller, "status")

    @property
    def pose(self) -> np.ndarray:
        """The true one."""
        return np.array(self.read(self.world, "pose"))

    def read(self, system: Any, port: str) -> Any:
        return system.GetOutputPort(port).Eval(
            system.GetMyContextFromRoot(self.simulator.get_context())
        )

    def context(self, system: Any) -> Context:
        return system.GetMyMutableContextFromRoot(self.simulator.get_mutable_context())

    def go_on_until(self, done: Any, most: float = 120.0) -> ContactPointStatus:
        """Simulates until done(status), at most so many seconds more."""
        end = self.simulator.get_context().get_time() + most
        while not done(self.status) and self.simulator.get_context().get_time() < end:
            self.simulator.AdvanceTo(self.simulator.get_context().get_time() + 0.1)
        return self.status


def make_run(
    obj: GridObject,
    truth: CellParameters,
    goal: Any,
    rules: GoalRules,
    *,
    reach: Any = None,
    learning: int = 0,
    **options: Any,
) -> Run:
    """Makes it; the object begins at the origin. `learning` is the most pushes learned from."""
    builder = DiagramBuilder()
    radius = rules.contact.pusher.choose_radius(obj)
    world = builder.AddSystem(GridLcpSystem(Model(obj, truth), pusher_radius=radius))
    finger, camera = (
        builder.AddSystem(IdealFinger()),
        builder.AddSystem(Camera(5e-4, np.radians(0.2))),
    )
    cover, source = (
        builder.AddSystem(Cover()),
        builder.AddSystem(ConstantVectorSource(np.array(goal, float))),
    )
    identifier = builder.AddSystem(
        GridIdentifier(
            obj, engaged_below=OBJECT_HEIGHT, pusher_radius=radius, max_learning_pushes=learning,
            record=RecordOptions(pose_delay=DEFAULT_PERIOD),
        )
    )  # fmt: skip
    controller = builder.AddSystem(ContactPointController(Model(obj), rules, **options))
    executor = builder.AddSystem(PushExecutor((0.0, 0.0, 0.2), obj.outline, reach, STYLE))
    for start, port, sinks in (
        (source, "y0", [(controller, "goal_pose")]),
        (controller, "push_command", [(executor, "push_command")]),
        (executor, "tip_pose", [(finger, "tip_pose")]),
        (executor, "status", [(controller, "push_status")]),
        (finger, "planar_state", [(world, "pusher_state")]),
        (finger, "pusher_state", [(identifier, "pusher_state")]),
        (world, "pose", [(camera, "pose")]),
        (camera, "object_pose", [(cover, "pose")]),
        (
            cover,
            "object_pose",
            [(executor, "object_pose"), (controller, "object_pose"), (identifier, "object_pose")],
        ),
        (identifier, "identification", [(controller, "identification")]),
        (identifier, "push_log", [(controller, "push_log")]),
    ):
        for system, name in sinks:
            builder.Connect(start.GetOutputPort(port), system.GetInputPort(name))
    return Run(Simulator(builder.Build()), world, controller, executor, source, cover)
