"""`GridLcpSystem` is `simulate`, one step at a time."""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, LogVectorOutput, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from gridpush_drake.dynamics.push import ForcePush, Push
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import ParameterError, SimulationError
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import find_shipped_object
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.systems.dynamics.grid_lcp_system import GridLcpSystem
from tests.helpers.finite_difference import check_jacobian
from tests.helpers.shapes import make_shape

DT = 0.01
RADIUS = 0.008
EXACT = 1e-12
"""m, m/s, N and rad by which the two may differ; they differ by round-off of the velocity's frame
alone."""


def make_params(obj: GridObject, seed: int) -> CellParameters:
    return CellParameters.random(obj, seed, (0.005, 0.05), (0.2, 0.6))


def make_push(obj: GridObject, arc_length: float, angle: float = 0.3, pose=(0.0, 0.0, 0.0)) -> Push:
    """20 cm in 2 s."""
    return Push.on_outline(
        obj, arc_length, angle, 0.2, radius=RADIUS, duration=2.0, pose=pose, clearance=0.003
    )


class World:
    """The system under a scripted pusher, in a Simulator that logs every step."""

    def __init__(self, system: GridLcpSystem, trajectory=None, wrench=None) -> None:
        builder = DiagramBuilder()
        self.system = builder.AddSystem(system)
        if trajectory is not None:
            source = builder.AddSystem(
                TrajectorySource(trajectory, 1, zero_derivatives_beyond_limits=True)
            )
            builder.Connect(source.get_output_port(), system.GetInputPort("pusher_state"))
        if wrench is not None:
            source = builder.AddSystem(ConstantVectorSource(wrench))
            builder.Connect(source.get_output_port(), system.GetInputPort("applied_wrench"))
        names = ("pose", "velocity", "contact_force")
        self.logs = {
            name: LogVectorOutput(system.GetOutputPort(name), builder, system.dt) for name in names
        }
        self.simulator = Simulator(builder.Build())
        self.root = self.simulator.get_mutable_context()
        self.context = system.GetMyMutableContextFromRoot(self.root)

    def log(self, name: str) -> np.ndarray:
        return self.logs[name].FindLog(self.root).data().T

    def eval(self, name: str):
        return self.system.GetOutputPort(name).Eval(self.context)


def make_trajectory(push: Push) -> PiecewisePolynomial:
    return PiecewisePolynomial.FirstOrderHold(push.t, push.xy.T)


def draw_push(obj: GridObject, seed: int) -> Push:
    rng = np.random.default_rng(seed)
    return make_push(obj, rng.uniform(0, obj.edges.perimeter), rng.uniform(-0.5, 0.5))


@pytest.mark.parametrize("regime", ["inertial", "quasi_static"])
@pytest.mark.parametrize(
    ("name", "seeds"),
    [("claw_hammer", (0, 1, 2)), ("toolbox", (3, 4)), ("pliers", (8, 18, 25)), ("open_book", (6,))],
)
def test_steps_exactly_as_the_core_does(name, seeds, regime):
    """Jams in the pliers' jaw and a push that is not solved (8) included: there the solver's memory decides."""
    obj = GridObject.from_yaml(find_shipped_object(name))
    for seed in seeds:
        params, push = make_params(obj, seed), draw_push(obj, seed)
        core = simulate(Model(obj, params), push, dt=DT, regime=regime)
        world = World(GridLcpSystem(Model(obj, params), DT, regime, RADIUS), make_trajectory(push))
        world.simulator.AdvanceTo(push.duration)
        np.testing.assert_allclose(world.log("pose"), core.poses, rtol=0, atol=EXACT)
        np.testing.assert_allclose(world.log("velocity"), core.velocities, rtol=0, atol=100 * EXACT)
        assert (world.eval("unsolved_steps")[0] > 0) == (core.status == "not_converged")
        if core.status == "ok":
            force = core.contact_forces.sum(axis=1)
            np.testing.assert_allclose(world.log("contact_force")[1:], force, rtol=1e-6, atol=1e-8)


TABLE = [[-0.06, -0.06], [0.06, -0.06], [0.06, 0.06], [-0.06, 0.06]]


@pytest.mark.parametrize("regime", ["inertial", "quasi_static"])
@pytest.mark.parametrize("falls", [False, True])
def test_loads_shift_as_in_the_core(regime, falls):
    obj = make_shape("square", 64)
    params = replace(make_params(obj, 2), push_height=0.01, patch_ratio=0.1)
    push = make_push(obj, 0.07)
    table = TABLE if falls else None
    core = simulate(Model(obj, params), push, dt=DT, regime=regime, table=table)
    system = GridLcpSystem(Model(obj, params), DT, regime, RADIUS, table=table)
    world = World(system, make_trajectory(push))
    assert system.GetParameters(world.context).push_height == 0.01
    world.simulator.AdvanceTo(push.duration)
    held = (
        int(np.argmax(core.tips)) + 1 if falls else len(core.poses)
    )  # then no loads balance it, and any will do
    np.testing.assert_allclose(world.log("pose")[:held], core.poses[:held], rtol=0, atol=EXACT)
    assert world.eval("tipping_steps")[0] == core.tips.sum()
    assert bool(core.tips.any()) == falls
    level = simulate(Model(obj, replace(params, push_height=0.0)), push, dt=DT, regime=regime)
    assert np.abs(core.final_pose - level.final_pose).max() > 1e-4, "the height must matter"


def test_wrench_moves_it_as_a_force_moves_the_core():
    obj = make_shape("l_bracket", 40)
    params = make_params(obj, 0)
    force = np.array([3.0, 2.0])
    start, velocity = (0.1, -0.2, 0.4), (0.05, 0.0, 0.3)
    core = simulate(
        Model(obj, params), ForcePush((0.0, 0.0), force, 0.5), start, DT, velocity=velocity
    )
    world = World(
        GridLcpSystem(Model(obj, params), DT, pose=start, velocity=velocity), wrench=[*force, 0.0]
    )
    world.simulator.AdvanceTo(0.5)
    assert np.linalg.norm(core.final_pose[:2] - start[:2]) > 0.01
    np.testing.assert_allclose(world.log("pose"), core.poses, rtol=0, atol=EXACT)


def test_moment_turns_it_about_its_center_of_mass():
    obj = make_shape("square", 25)
    params = CellParameters.uniform(obj, 1.0, 0.0)
    world = World(GridLcpSystem(Model(obj, params), DT), wrench=[0.0, 0.0, 0.002])
    world.simulator.AdvanceTo(0.5)
    np.testing.assert_allclose(
        world.eval("velocity")[2], 0.002 / params.inertia(obj) * 0.5, rtol=1e-9
    )
    np.testing.assert_allclose(world.eval("pose")[:2], 0.0, atol=1e-12)


def test_slides_to_rest_where_nothing_touches_it():
    obj = make_shape("disc", 40)
    world = World(
        GridLcpSystem(
            Model(obj, CellParameters.uniform(obj, 1.0, 0.4)), 0.001, velocity=(0.2, 0.0, 0.0)
        )
    )
    world.simulator.AdvanceTo(0.2)
    assert world.eval("pose")[0] == pytest.approx(0.2**2 / (2 * 0.4 * 9.81), abs=0.2 * 0.001)
    np.testing.assert_allclose(world.eval("velocity"), 0.0, atol=1e-7)


def test_pusher_that_is_nan_is_none():
    obj = make_shape("square", 25)
    system = GridLcpSystem(Model(obj), pusher_radius=RADIUS)
    context = system.CreateDefaultContext()
    system.GetInputPort("pusher_state").FixValue(context, [np.nan, 0.0, 0.1, 0.0])
    state = system.EvalUniquePeriodicDiscreteUpdate(context)
    np.testing.assert_array_equal(state.value(0), np.zeros(6))
    system.GetInputPort("pusher_state").FixValue(context, [-0.058, 0.0, 0.1, 0.0])
    np.testing.assert_allclose(
        system.EvalUniquePeriodicDiscreteUpdate(context).value(0)[:3], [0.001, 0, 0], atol=1e-9
    )


def test_parameters_belong_to_the_context():
    obj = make_shape("claw_hammer", 60)
    params, push = [make_params(obj, seed) for seed in (0, 1)], make_push(obj, 0.1)
    world = World(
        GridLcpSystem(Model(obj, params[0]), DT, pusher_radius=RADIUS), make_trajectory(push)
    )
    other = world.root.Clone()
    mine = world.system.GetMyMutableContextFromRoot(other)
    world.system.SetParameters(mine, params[1])
    np.testing.assert_array_equal(world.system.GetParameters(mine).mass, params[1].mass)
    for root, expected in ((world.root, params[0]), (other, params[1])):
        simulator = Simulator(world.simulator.get_system(), root)
        simulator.AdvanceTo(push.duration)
        pose = world.system.GetOutputPort("pose").Eval(world.system.GetMyContextFromRoot(root))
        np.testing.assert_allclose(
            pose, simulate(Model(obj, expected), push, dt=DT).final_pose, rtol=0, atol=EXACT
        )


def test_clone_goes_on_as_the_original_does():
    obj = make_shape("claw_hammer", 60)
    push = make_push(obj, 0.1)
    world = World(
        GridLcpSystem(Model(obj, make_params(obj, 2)), DT, "quasi_static", RADIUS),
        make_trajectory(push),
    )
    world.simulator.AdvanceTo(1.0)
    clone = Simulator(world.simulator.get_system(), world.root.Clone())
    world.simulator.AdvanceTo(2.0)
    clone.AdvanceTo(2.0)
    context = world.system.GetMyContextFromRoot(clone.get_context())
    for name in ("pose", "velocity", "contact_force", "cell_positions"):
        np.testing.assert_array_equal(
            world.system.GetOutputPort(name).Eval(context), world.eval(name)
        )


@pytest.mark.parametrize("height", [0.0, 0.01])
@pytest.mark.parametrize("regime", ["inertial", "quasi_static"])
def test_step_jacobian_is_that_of_the_step(regime, height):
    obj = make_shape("l_bracket", 20)
    params = replace(make_params(obj, 3), push_height=height)
    system = GridLcpSystem(Model(obj, params), DT, regime, RADIUS)
    context = system.CreateDefaultContext()
    pusher = np.array([-0.0385, 0.02, 0.1, 0.02])
    q = np.array([0.0, 0.0, 0.05])

    def step(pose=q, start=pusher[:2], **changed):
        system.SetPose(context, pose)
        system.SetParameters(context, replace(params, **changed))
        system.GetInputPort("pusher_state").FixValue(context, np.append(start, pusher[2:]))
        return system.EvalUniquePeriodicDiscreteUpdate(context).value(0)[:3].copy()

    step()
    J = system.GetOutputPort("step_jacobian").Eval(context)
    assert np.abs(J.pose[0] - np.eye(3)).max() > 0.01, "it must touch"
    check = {"rtol": 1e-5, "atol": 1e-9}
    check_jacobian(lambda v: step(mass=v), params.mass, J.mass[0], **check)
    check_jacobian(lambda v: step(friction=v), params.friction, J.friction[0], **check)
    contact = [params.contact_friction]
    check_jacobian(
        lambda v: step(contact_friction=v[0]), contact, J.contact_friction[0][:, None], **check
    )
    if height:
        check_jacobian(
            lambda v: step(push_height=v[0]), [height], J.push_height[0][:, None], **check
        )
    check_jacobian(lambda v: step(pose=v), q, J.pose[0], **check)
    check_jacobian(lambda v: step(start=v), pusher[:2], J.start[0], **check)


def test_cells_are_where_the_pose_puts_them():
    obj = make_shape("wrench", 50)
    system = GridLcpSystem(Model(obj))
    context = system.CreateDefaultContext()
    q = np.array([0.3, -0.1, 2.0])
    system.SetPose(context, q)
    cells = system.GetOutputPort("cell_positions").Eval(context)
    np.testing.assert_array_equal(cells.reshape(-1, 2), obj.cells_at(q))


def test_pusher_that_speeds_up_is_followed():
    """Position and velocity where each step begins, from a trajectory that bends: against the core's finest steps."""
    obj = make_shape("claw_hammer", 60)
    params, straight = make_params(obj, 4), make_push(obj, 0.2)
    t = np.linspace(0, 2.0, 401)
    fraction = 3 * (t / 2) ** 2 - 2 * (t / 2) ** 3
    xy = straight.start + fraction[:, None] * (straight.xy[-1] - straight.start)
    fine = simulate(Model(obj, params), Push.along(t, xy, RADIUS))
    trajectory = PiecewisePolynomial.CubicHermite(
        [0.0, 2.0], np.array([straight.start, straight.xy[-1]]).T, np.zeros((2, 2))
    )
    errors = []
    for dt in (0.02, 0.01, 0.005):
        world = World(GridLcpSystem(Model(obj, params), dt, pusher_radius=RADIUS), trajectory)
        world.simulator.AdvanceTo(2.0)
        errors.append(
            np.abs(obj.cells_at(world.eval("pose")) - obj.cells_at(fine.final_pose)).max()
        )
    assert errors[1] < 2e-4 and errors[2] < errors[0]


def test_bad_arguments_are_refused():
    obj = make_shape("square", 25)
    for options, message in (
        ({"dt": 0.0}, "dt"),
        ({"regime": "static"}, "regime"),
        ({"pusher_radius": 0.0}, "pusher_radius"),
        ({"pose": (0.0, np.nan, 0.0)}, "pose"),
        ({"table": [[0.0, 0.0], [1.0, 0.0]]}, "table"),
    ):
        with pytest.raises(SimulationError, match=message):
            GridLcpSystem(Model(obj), **options)
    with pytest.raises(SimulationError, match="expected 25"):
        GridLcpSystem(Model(obj, CellParameters.uniform(make_shape("disc", 20))))
    system = GridLcpSystem(Model(obj))
    with pytest.raises(ParameterError, match="expected 25"):
        system.SetParameters(
            system.CreateDefaultContext(), CellParameters.uniform(make_shape("disc", 20))
        )
    assert not GridLcpSystem(Model(obj), regime="quasi_static").HasInputPort("applied_wrench")
