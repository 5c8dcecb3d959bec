import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.math import SpatialVelocity
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput

from gridpush_drake.systems.sensing.planar_pose_sensor import PlanarPoseSensor, project_pose
from gridpush_drake.systems.sensing.pusher_state_sensor import PusherStateSensor

SPIN = 2.0  # rad/s
SPEED = 0.1  # m/s


def _make(noise=0.0, lowest=-np.inf, gravity=False, seed=3):
    """A free body that spins about z while it moves along x."""
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 1e-3)
    body = plant.AddRigidBody("thing", SpatialInertia.SolidBoxWithMass(1.0, 0.1, 0.1, 0.1))
    if not gravity:
        plant.mutable_gravity_field().set_gravity_vector([0, 0, 0])
    plant.Finalize()
    camera = builder.AddSystem(
        PlanarPoseSensor(
            body.index(),
            period=0.05,
            position_noise=noise,
            angle_noise=2 * noise,
            lowest=lowest,
            seed=seed,
        )
    )
    tip = builder.AddSystem(PusherStateSensor(body.index(), np.array([0.2, 0.0, 0.1])))
    builder.Connect(plant.get_body_poses_output_port(), camera.GetInputPort("body_poses"))
    builder.Connect(plant.get_body_poses_output_port(), tip.GetInputPort("body_poses"))
    builder.Connect(
        plant.get_body_spatial_velocities_output_port(), tip.GetInputPort("body_spatial_velocities")
    )
    log = LogVectorOutput(camera.GetOutputPort("object_pose"), builder, 0.05)
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    plant_context = plant.GetMyContextFromRoot(context)
    plant.SetFreeBodyPose(
        plant_context, body, RigidTransform(RollPitchYaw(0, 0, 1.0), [0.3, 0.1, 0.0])
    )
    plant.SetFreeBodySpatialVelocity(
        context=plant_context, body=body, V_JpJc=SpatialVelocity([0, 0, SPIN], [SPEED, 0, 0])
    )
    return diagram, context, log, tip


def test_pose_is_that_of_the_body_and_counts_turns():
    diagram, context, log, _ = _make()
    simulator = Simulator(diagram, context)
    simulator.AdvanceTo(6.0)
    seen = log.FindLog(context)
    late = seen.sample_times() > 0.05
    t = (
        seen.sample_times()[late] - 0.05
    )  # a sample is logged before the picture of its own time is taken
    expected = np.stack([0.3 + SPEED * t, np.full_like(t, 0.1), 1.0 + SPIN * t])
    np.testing.assert_allclose(seen.data()[:, late], expected, atol=SPIN * 2e-3)
    assert seen.data()[2, -1] > 2 * np.pi


def test_noise_has_its_spread_and_depends_on_seed_alone():
    runs = []
    for seed in (3, 3, 4):
        diagram, context, log, _ = _make(noise=1e-3, seed=seed)
        clean_diagram, clean_context, clean_log, _ = _make()
        Simulator(diagram, context).AdvanceTo(10.0)
        Simulator(clean_diagram, clean_context).AdvanceTo(10.0)
        noise = log.FindLog(context).data() - clean_log.FindLog(clean_context).data()
        runs.append(noise[:, 1:])  # the first is logged before any picture
    assert np.array_equal(runs[0], runs[1])
    assert not np.array_equal(runs[0], runs[2])
    np.testing.assert_allclose(runs[0].std(axis=1), [1e-3, 1e-3, 2e-3], rtol=0.25)


def test_body_below_the_table_is_lost_from_sight():
    diagram, context, log, _ = _make(gravity=True, lowest=-0.1)
    Simulator(diagram, context).AdvanceTo(0.5)
    seen = log.FindLog(context)
    t = seen.sample_times() - 0.05
    fallen = 0.5 * 9.81 * t**2 > 0.1
    assert fallen.any()
    assert np.isnan(seen.data()[:, fallen & (t > 0)]).all()
    assert np.isfinite(seen.data()[:, ~fallen & (t > -1e-9)]).all()
    np.testing.assert_allclose(seen.data()[:, 0], [0.3, 0.1, 1.0], atol=1e-12)


def test_covered_camera_sees_nothing_until_it_is_uncovered():
    diagram, context, log, _ = _make(noise=1e-3)
    plain, plain_context, plain_log, _ = _make(noise=1e-3)
    camera = next(system for system in diagram.GetSystems() if isinstance(system, PlanarPoseSensor))
    simulator = Simulator(diagram, context)
    simulator.AdvanceTo(0.52)
    camera.SetCovered(context, True)
    simulator.AdvanceTo(1.02)
    camera.SetCovered(context, False)
    simulator.AdvanceTo(1.5)
    Simulator(plain, plain_context).AdvanceTo(1.5)
    seen, plainly = log.FindLog(context), plain_log.FindLog(plain_context)
    taken = seen.sample_times() - 0.05  # of the picture that is shown
    covered = (taken > 0.52) & (taken < 1.02)
    assert covered.sum() == 10
    assert np.isnan(seen.data()[:, covered]).all()
    np.testing.assert_array_equal(seen.data()[:, ~covered], plainly.data()[:, ~covered])


def test_clone_sees_the_same():
    diagram, context, _, _ = _make(noise=1e-3)
    simulator = Simulator(diagram, context)
    simulator.AdvanceTo(0.42)
    twin = Simulator(diagram, context.Clone())
    simulator.AdvanceTo(1.0)
    twin.AdvanceTo(1.0)
    camera = next(system for system in diagram.GetSystems() if isinstance(system, PlanarPoseSensor))
    port = camera.GetOutputPort("object_pose")
    ours, theirs = (
        port.Eval(camera.GetMyContextFromRoot(root))
        for root in (simulator.get_context(), twin.get_context())
    )
    assert np.array_equal(ours, theirs)


def test_pusher_state_moves_with_its_point():
    _, context, _, tip = _make()
    state = tip.GetOutputPort("pusher_state").Eval(tip.GetMyContextFromRoot(context))
    arm = 0.2 * np.array([np.cos(1.0), np.sin(1.0)])
    np.testing.assert_allclose(state[:3], [0.3 + arm[0], 0.1 + arm[1], 0.1], atol=1e-12)
    np.testing.assert_allclose(state[3:], [SPEED - SPIN * arm[1], SPIN * arm[0], 0.0], atol=1e-12)


@pytest.mark.parametrize("near", [-7.0, 0.0, 9.0])
def test_planar_pose_takes_the_nearest_turn(near):
    q = project_pose(RigidTransform(RollPitchYaw(0, 0, 0.5), [1, 2, 3]), near)
    np.testing.assert_allclose(q[:2], [1, 2])
    assert abs(q[2] - near) <= np.pi
    np.testing.assert_allclose(
        (q[2] - 0.5) / (2 * np.pi), round((q[2] - 0.5) / (2 * np.pi)), atol=1e-12
    )
