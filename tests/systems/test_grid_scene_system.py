"""`GridSceneSystem` is `simulate` of several objects, one step at a time."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from gridpush_drake.dynamics.push import Push
from gridpush_drake.errors import SimulationError
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.systems.dynamics.grid_scene_system import GridSceneSystem
from tests.helpers.scene_cases import Layout
from tests.helpers.shapes import rectangle

DT = 0.01
RADIUS = 0.01


def make_scene():
    obj = GridObject.from_outline(rectangle(0.08, 0.04), max_cells=32)
    params = CellParameters.uniform(obj, 0.5, 0.4, 0.3)
    return Layout.of([(obj, params, (0.0, 0.0, 0.0)), (obj, params, (0.085, 0.012, 0.1))])


def make_simulator(system, push=None):
    builder = DiagramBuilder()
    builder.AddSystem(system)
    if push is not None:
        path = PiecewisePolynomial.FirstOrderHold(push.t, push.xy.T)
        source = builder.AddSystem(TrajectorySource(path, 1, zero_derivatives_beyond_limits=True))
        builder.Connect(source.get_output_port(), system.GetInputPort("pusher_state"))
    simulator = Simulator(builder.Build())
    return simulator, system.GetMyMutableContextFromRoot(simulator.get_mutable_context())


def test_it_is_simulate_step_by_step():
    scene = make_scene()
    push = Push((-0.052, 0.004), (0.05, 0.0), 1.0, RADIUS)
    expected = scene.simulate(push, dt=DT)
    system = GridSceneSystem(*scene, DT, RADIUS)
    simulator, context = make_simulator(system, push)
    simulator.AdvanceTo(push.duration)
    for b in range(2):
        pose = system.GetOutputPort(f"pose_{b}").Eval(context)
        np.testing.assert_allclose(pose, expected.final_pose[b], rtol=0, atol=1e-9)
    poses = system.GetOutputPort("poses").Eval(context)
    np.testing.assert_allclose(poses.reshape(2, 3), expected.final_pose, rtol=0, atol=1e-9)
    assert np.abs(expected.final_pose[1] - scene.poses[1]).max() > 0.01
    by_finger = expected.contact_bodies[-1, :, 1] == -1
    np.testing.assert_allclose(
        system.GetOutputPort("contact_force").Eval(context),
        expected.contact_forces[-1][by_finger].sum(axis=0),
        rtol=1e-6,
    )
    assert system.GetOutputPort("unsolved_steps").Eval(context) == 0


def test_without_a_pusher_nothing_moves_and_set_poses_places():
    scene = make_scene()
    system = GridSceneSystem(*scene, DT, RADIUS)
    simulator, context = make_simulator(system)
    placed = np.array([[0.1, 0.2, 0.3], [-0.1, 0.0, 1.0]])
    system.SetPoses(context, placed)
    simulator.AdvanceTo(0.05)
    np.testing.assert_array_equal(system.GetOutputPort("poses").Eval(context).reshape(2, 3), placed)


def test_what_is_refused():
    scene = make_scene()
    with pytest.raises(SimulationError, match="dt"):
        GridSceneSystem(*scene, 0.0)
    with pytest.raises(SimulationError, match="pusher_radius"):
        GridSceneSystem(*scene, pusher_radius=-1.0)
    system = GridSceneSystem(*scene)
    context = system.CreateDefaultContext()
    with pytest.raises(SimulationError, match=r"expected \(2, 3\)"):
        system.SetPoses(context, np.zeros(3))
    with pytest.raises(SimulationError, match="overlap"):
        system.SetPoses(context, np.zeros((2, 3)))
