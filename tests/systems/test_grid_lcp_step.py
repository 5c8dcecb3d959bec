"""`GridLcpStep_`: the difference equation that Drake's own tools differentiate."""

import numpy as np
import pytest
from pydrake.autodiffutils import AutoDiffXd, ExtractGradient, ExtractValue, InitializeAutoDiff
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, FirstOrderTaylorApproximation

from gridpush_drake.dynamics.physics import Physics
from gridpush_drake.errors import SimulationError
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.systems import GridLcpStep, GridLcpStep_, GridLcpSystem
from tests.helpers.finite_difference import check_jacobian
from tests.helpers.made_identifications import make_block

DT = 0.02
OBJ = make_block()
PARAMS = CellParameters.random(OBJ, 3, (0.02, 0.1), (0.2, 0.5))
LEFT = OBJ.outline.bounds[0]
POSE = np.array([0.001, -0.002, 0.02])
PUSHER = np.array([LEFT - 0.0055, 0.011, 0.06, 0.01])


def make_step(**more):
    return GridLcpStep(Model(OBJ, PARAMS), DT, pusher_radius=0.006, pose=POSE, **more)


def advance(system, context):
    """The state after the next update, in whatever the system's scalar is."""
    return np.array(system.EvalUniquePeriodicDiscreteUpdate(context).value())


def make_context(system, pose=POSE, pusher=PUSHER):
    context = system.CreateDefaultContext()
    context.SetDiscreteState(pose)
    system.GetInputPort("pusher_state").FixValue(context, pusher)
    return context


def test_many_steps_go_where_the_system_with_a_memory_goes():
    ends = []
    for dt in (0.02, 0.005):
        for kind, more in ((GridLcpStep, {}), (GridLcpSystem, {"regime": "quasi_static"})):
            builder = DiagramBuilder()
            system = builder.AddSystem(
                kind(Model(OBJ, PARAMS), dt, pusher_radius=0.006, pose=POSE, **more)
            )
            # a pusher whose place is told anew in each step
            path = builder.AddSystem(ConstantVectorSource(PUSHER))
            builder.Connect(path.get_output_port(), system.GetInputPort("pusher_state"))
            diagram = builder.Build()
            simulator = Simulator(diagram)
            context = diagram.GetMutableSubsystemContext(path, simulator.get_mutable_context())
            for k in range(round(0.5 / dt)):
                now = [*(PUSHER[:2] + k * dt * PUSHER[2:]), *PUSHER[2:]]
                path.get_mutable_source_value(context).SetFromVector(now)
                simulator.AdvanceTo((k + 1) * dt)
            own = system.GetMyContextFromRoot(simulator.get_context())
            ends.append(system.GetOutputPort("pose").Eval(own))
    coarse, coarse_memory, fine, fine_memory = ends
    assert np.linalg.norm(fine - POSE) > 0.02
    assert np.abs(fine - fine_memory).max() < 1e-3
    assert np.abs(fine - fine_memory).max() < 0.6 * np.abs(coarse - coarse_memory).max()


def test_state_and_input_are_differentiated_exactly():
    system = make_step()
    auto = system.ToAutoDiffXd()
    assert isinstance(auto, GridLcpStep_[AutoDiffXd])
    seeds = InitializeAutoDiff(np.concatenate([POSE, PUSHER])).ravel()
    after = advance(auto, make_context(auto, seeds[:3], seeds[3:]))
    np.testing.assert_array_equal(
        ExtractValue(after).ravel(), advance(system, make_context(system))
    )
    check_jacobian(
        lambda x: advance(system, make_context(system, x[:3], x[3:])),
        np.concatenate([POSE, PUSHER]),
        ExtractGradient(after),
        step=1e-6,
        rtol=2e-4,
        order=4,
    )


@pytest.mark.parametrize("index", range(4))
def test_parameters_are_differentiated_exactly(index):
    params = CellParameters(PARAMS.mass, PARAMS.friction, 0.4, 0.01)
    system = GridLcpStep(Model(OBJ, params), DT, pusher_radius=0.006, pose=POSE)
    auto = system.ToAutoDiffXd()
    context = make_context(auto)
    value = context.get_numeric_parameter(index)
    at = np.array(ExtractValue(value.CopyToVector())).ravel()
    context.get_mutable_numeric_parameter(index).SetFromVector(InitializeAutoDiff(at).ravel())

    def vary(x):
        varied = make_context(system)
        varied.get_mutable_numeric_parameter(index).SetFromVector(x)
        return advance(system, varied)

    found = ExtractGradient(advance(auto, context))
    check_jacobian(vary, at, found, step=1e-5, rtol=1e-3, order=4)


def test_drake_linearizes_it():
    system = make_step()
    context = make_context(system)
    linear = FirstOrderTaylorApproximation(
        system, context, system.GetInputPort("pusher_state").get_index(),
        system.GetOutputPort("pose").get_index(),
    )  # fmt: skip
    assert linear.time_period() == DT
    assert linear.A().shape == (3, 3)
    assert linear.B().shape == (3, 4)
    np.testing.assert_array_equal(linear.C(), np.eye(3))
    # near by, the linear system says where the next step ends
    shift, other = np.array([1e-5, 2e-5, -1e-4]), np.array([1e-5, -1e-5, 1e-4, 2e-4])
    moved = advance(system, make_context(system, POSE + shift, PUSHER + other))
    expected = advance(system, context) + linear.A() @ shift + linear.B() @ other
    np.testing.assert_allclose(moved, expected, atol=2e-8)


def test_without_a_pusher_it_stays_and_at_rest_it_has_derivatives():
    system = make_step()
    context = system.CreateDefaultContext()
    np.testing.assert_array_equal(advance(system, context), POSE)
    auto = system.ToAutoDiffXd()
    resting = np.array([*PUSHER[:2], 0.0, 0.0])
    seeds = InitializeAutoDiff(np.concatenate([POSE, resting])).ravel()
    after = advance(auto, make_context(auto, seeds[:3], seeds[3:]))
    assert np.isfinite(ExtractGradient(after)).all()
    alone = auto.CreateDefaultContext()
    alone.SetDiscreteState(seeds[:3])
    np.testing.assert_array_equal(ExtractGradient(advance(auto, alone)), np.eye(3, 7))


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"physics": Physics(regime="inertial")}, "regime is 'inertial'"),
        ({"physics": Physics(friction_law="lagged", regime="auto")}, "lagged"),
        ({"pose": [np.nan, 0, 0]}, "pose"),
        ({"pusher_radius": -1.0}, "pusher_radius is -1.0"),
    ],
)
def test_what_will_not_do_is_refused(more, message):
    with pytest.raises(SimulationError, match=message):
        options = {name: value for name, value in more.items() if name != "physics"}
        GridLcpStep(Model(OBJ, PARAMS, more.get("physics")), DT, **options)
