"""A small Diagram without an arm: a policy and an executor move an ideal finger, the LCP is the world, the identifier
watches through a noisy camera.
"""

from typing import Any, NamedTuple

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, LeafSystem
from shapely import box

from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.exploration import PokeRegion, RandomPokeOptions, RandomPokes
from gridpush_drake.planning.push_constraints import PushConstraints
from gridpush_drake.pushes.segmentation import RecordOptions
from gridpush_drake.systems.control.poke_policy import PokePolicy
from gridpush_drake.systems.dynamics.grid_lcp_system import GridLcpSystem
from gridpush_drake.systems.execution.push_executor import PushExecutor
from gridpush_drake.systems.learning.grid_identifier import DEFAULT_PERIOD, GridIdentifier

OBJECT_HEIGHT = 0.04
FINGER_PERIOD = 0.005
REGION = PokeRegion(keep_in=box(-0.35, -0.35, 0.35, 0.35))
FINGER_RULES = PushConstraints(finger_region=box(-0.5, -0.5, 0.5, 0.5))


class IdealFinger(LeafSystem):
    """Follows the desired pose exactly; its planar state is NaN while it is above the object."""

    def __init__(self) -> None:
        super().__init__()
        self.DeclareAbstractInputPort("tip_pose", AbstractValue.Make(RigidTransform()))
        self.DeclareDiscreteState([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
        self.DeclarePeriodicDiscreteUpdateEvent(FINGER_PERIOD, 0.0, self._follow)
        self.DeclareStateOutputPort("pusher_state", self.get_discrete_state_index())
        self.DeclareVectorOutputPort("planar_state", 4, self._calc_planar_state, {self.xd_ticket()})

    def get_discrete_state_index(self) -> Any:
        from pydrake.systems.framework import DiscreteStateIndex

        return DiscreteStateIndex(0)

    def _follow(self, context: Context, state: Any) -> None:
        p = self.GetInputPort("tip_pose").Eval(context).translation()
        before = context.get_discrete_state(0).value()[:3]
        state.set_value(0, np.concatenate([p, (p - before) / FINGER_PERIOD]))

    def _calc_planar_state(self, context: Context, output: Any) -> None:
        x, y, z, vx, vy, _ = context.get_discrete_state(0).value()
        output.SetFromVector([x, y, vx, vy] if z < OBJECT_HEIGHT else np.full(4, np.nan))


class Camera(LeafSystem):
    """Samples a pose with seeded noise."""

    def __init__(
        self, position_noise: float, angle_noise: float, period: float = DEFAULT_PERIOD
    ) -> None:
        super().__init__()
        self._std = np.array([position_noise, position_noise, angle_noise])
        self.DeclareVectorInputPort("pose", 3)
        self.DeclareDiscreteState([np.nan] * 3)
        self.DeclareDiscreteState(1)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._look)
        self.DeclareVectorOutputPort("object_pose", 3, self._calc_pose, {self.xd_ticket()})

    def _look(self, context: Context, state: Any) -> None:
        count = int(context.get_discrete_state(1).value()[0])
        noise = self._std * np.random.default_rng((7, count)).normal(size=3)
        state.set_value(0, self.GetInputPort("pose").Eval(context) + noise)
        state.set_value(1, [count + 1])

    def _calc_pose(self, context: Context, output: Any) -> None:
        output.SetFromVector(context.get_discrete_state(0).value())


class Spoiler(LeafSystem):
    """Passes a vector on, in spells with NaN in some of its numbers, drawn from (seed, count of the spell)."""

    def __init__(self, size: int, fraction: float, seed: int, spell: float = 0.25) -> None:
        super().__init__()
        self._size, self._fraction, self._seed, self._spell = size, fraction, seed, spell
        self.DeclareVectorInputPort("good", size)
        self.DeclareVectorOutputPort("spoiled", size, self._calc)

    def _calc(self, context: Context, output: Any) -> None:
        rng = np.random.default_rng((self._seed, int(context.get_time() / self._spell)))
        bad = (rng.random(self._size) < 0.5) & (rng.random() < self._fraction)
        output.SetFromVector(np.where(bad, np.nan, self.GetInputPort("good").Eval(context)))


class PokeDiagram(NamedTuple):
    """The Diagram and its parts."""

    diagram: Diagram
    world: GridLcpSystem
    identifier: GridIdentifier
    policy: PokePolicy
    executor: PushExecutor


def make_poke_diagram(
    obj: GridObject,
    truth: CellParameters,
    *,
    pokes: int,
    seed: int = 0,
    noise: tuple[float, float] = (5e-4, np.radians(0.2)),
    style: RandomPokeOptions | None = None,
    spoiled: float = 0.0,
    **options: Any,
) -> PokeDiagram:
    """Makes it; `spoiled` is the fraction of time with NaN in what is measured; `options` go to the identifier."""
    builder = DiagramBuilder()
    style = style or RandomPokeOptions()
    world = builder.AddSystem(GridLcpSystem(Model(obj, truth), pusher_radius=style.tip_radius))
    finger, camera = builder.AddSystem(IdealFinger()), builder.AddSystem(Camera(*noise))
    options = {"record": RecordOptions(pose_delay=DEFAULT_PERIOD), **options}
    identifier = builder.AddSystem(
        GridIdentifier(
            obj, engaged_below=OBJECT_HEIGHT, pusher_radius=style.tip_radius, seed=seed, **options
        )
    )
    policy = builder.AddSystem(
        PokePolicy(Model(obj), RandomPokes(style, REGION, seed), FINGER_RULES, pokes)
    )
    executor = builder.AddSystem(PushExecutor((0.0, 0.0, 0.2), obj.outline))
    for source, port, sinks in (
        (policy, "push_command", [(executor, "push_command")]),
        (executor, "tip_pose", [(finger, "tip_pose")]),
        (executor, "status", [(policy, "status")]),
        (finger, "planar_state", [(world, "pusher_state")]),
        (finger, "pusher_state", [(identifier, "pusher_state")]),
        (world, "pose", [(camera, "pose")]),
        (
            camera,
            "object_pose",
            [(executor, "object_pose"), (policy, "object_pose"), (identifier, "object_pose")],
        ),
    ):
        start = source.GetOutputPort(port)
        if spoiled and port in ("planar_state", "pusher_state", "object_pose"):
            spoiler = builder.AddSystem(Spoiler(start.size(), spoiled, seed))
            builder.Connect(start, spoiler.get_input_port())
            start = spoiler.get_output_port()
        for system, name in sinks:
            builder.Connect(start, system.GetInputPort(name))
    return PokeDiagram(builder.Build(), world, identifier, policy, executor)
