"""`simulate` and `simulate_batch`: arguments, reproducibility, what they return."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from gridpush_drake.dynamics.kernels.friction.isotropic_friction import Isotropic
from gridpush_drake.dynamics.kernels.rollout import rollout
from gridpush_drake.dynamics.physics import Physics
from gridpush_drake.dynamics.push import ForcePush, Push, make_path_times
from gridpush_drake.dynamics.reference.paper_rollout import fill_paper_gradient
from gridpush_drake.dynamics.simulation import calc_step, simulate, simulate_batch
from gridpush_drake.errors import SimulationError
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from tests.helpers.random_pushes import make_random_contents, make_random_push
from tests.helpers.shapes import make_shape

PUSH = Push((-0.07, 0.01), (0.1, 0.0), 0.5, 0.01)
FORCE = ForcePush((0.0, 0.0), (3.0, 0.0), 0.5)


@pytest.fixture(scope="module")
def obj():
    return make_shape("square", 36)


@pytest.fixture(scope="module")
def params(obj):
    return make_random_contents(np.random.default_rng(0), obj)


@pytest.mark.parametrize(
    ("push", "options", "message"),
    [
        (PUSH, {"pose": (0.0, 0.0)}, "pose"),
        (PUSH, {"pose": (0.0, np.nan, 0.0)}, "pose"),
        (PUSH, {"pose": "here"}, "pose"),
        (PUSH, {"velocity": (0.0, 0.0)}, "velocity"),
        (PUSH, {"velocity": (0.1, 0.0, 0.0), "regime": "quasi_static"}, "velocity"),
        (PUSH, {"dt": 0.0}, "dt"),
        (PUSH, {"dt": -0.01}, "dt"),
        (PUSH, {"dt": np.nan}, "dt"),
        (PUSH, {"regime": "static"}, "regime.*'inertial', 'quasi_static'"),
        (PUSH, {"physics": {"friction_law": "dry"}}, "friction_law.*'isotropic', 'lagged'"),
        (PUSH, {"physics": {"spin": "both"}}, "spin"),
        (PUSH, {"gradients": "exact"}, "gradients"),
        (FORCE, {"regime": "quasi_static"}, "regime"),
        (PUSH, {"regime": "quasi_static", "physics": {"friction_law": "lagged"}}, "friction_law"),
        (PUSH, {"physics": {"friction_law": "lagged"}, "gradients": True}, "gradients"),
        (PUSH, {"regime": "quasi_static", "gradients": "paper"}, "gradients"),
        (PUSH, {"times": [0.0]}, "times"),
        (PUSH, {"times": [0.0, 0.2, 0.1]}, "times"),
        (PUSH, {"times": [0.0, np.inf]}, "times"),
        (PUSH, {"record": [0, 0]}, "record"),
        (PUSH, {"record": [-1_000]}, "record"),
        (PUSH, {"record": [0, -51]}, "record.*twice"),
        (PUSH, {"record": [10_000]}, "record"),
        (PUSH, {"record": [0.5]}, "record"),
        (PUSH, {"physics": {"gravity": -9.81}}, "gravity"),
        (PUSH, {"physics": {"gravity": np.nan}}, "gravity"),
        (PUSH, {"physics": {"stiction_tolerance": 0.0}}, "stiction_tolerance"),
        (PUSH, {"physics": {"relative_stiction_tolerance": -1.0}}, "relative_stiction_tolerance"),
    ],
)
def test_bad_arguments_are_refused(obj, params, push, options, message):
    with pytest.raises(SimulationError, match=message):
        physics = None
        if "physics" in options:
            physics = Physics(**options["physics"])
            options = {key: value for key, value in options.items() if key != "physics"}
        simulate(Model(obj, params, physics), push, **options)


def test_parameters_of_another_object_are_refused(obj):
    other = make_shape("disc", 20)
    with pytest.raises(SimulationError, match=f"expected {obj.n}"):
        simulate(Model(obj, CellParameters.uniform(other)), PUSH)


def test_quasi_static_regime_needs_friction(obj):
    smooth = CellParameters.uniform(obj, 1.0, 0.0)
    with pytest.raises(SimulationError, match="friction"):
        simulate(Model(obj, smooth), PUSH, regime="quasi_static")
    with pytest.raises(SimulationError, match="friction"):
        weightless = Physics(regime="quasi_static", gravity=0.0)
        simulate(Model(obj, CellParameters.uniform(obj, 1.0, 0.3), weightless), PUSH)
    assert simulate(Model(obj, smooth), PUSH).status == "ok"


def test_shapes_and_the_first_row(obj, params):
    result = simulate(Model(obj, params), PUSH, (0.0, 0.01, 0.2), 0.01, True)
    T, n = 50, obj.n
    assert result.times.shape == (T + 1,)
    assert result.poses.shape == result.velocities.shape == (T + 1, 3)
    assert result.contact_forces.shape == result.contact_points.shape == (T, 2, 2)
    assert result.modes.shape == (T, 2)
    assert result.gaps.shape == (T + 1,)
    np.testing.assert_array_equal(result.poses[0], (0.0, 0.01, 0.2))
    np.testing.assert_array_equal(result.final_pose, result.poses[-1])
    J = result.jacobian
    assert J.mass.shape == J.friction.shape == (T + 1, 3, n)
    assert J.contact_friction.shape == J.direction.shape == J.length.shape == (T + 1, 3)
    assert J.start.shape == (T + 1, 3, 2)
    assert J.contact_location is None
    np.testing.assert_allclose(J.pose[0], np.eye(3), atol=1e-15)
    for block in (J.mass, J.friction, J.contact_friction, J.start, J.direction, J.length):
        assert not block[0].any()


def test_without_gradients_the_jacobian_says_so(obj, params):
    with pytest.raises(SimulationError, match="gradients"):
        _ = simulate(Model(obj, params), PUSH).jacobian


@pytest.mark.parametrize("gradients", [True, "paper"])
def test_gradients_leave_the_motion_alone(obj, params, gradients):
    np.testing.assert_array_equal(
        simulate(Model(obj, params), PUSH, gradients=gradients).poses,
        simulate(Model(obj, params), PUSH).poses,
    )


def test_default_steps_are_short_in_time_and_in_way(obj, params):
    for push in (
        PUSH,
        Push(PUSH.start, (0.01, 0.0), 1.0, 0.01),
        Push(PUSH.start, (1.0, 0.0), 0.2, 0.01),
    ):
        result = simulate(Model(obj, params), push, regime="inertial")
        assert np.diff(result.times).max() <= 0.01 * (1 + 1e-9)
        assert np.linalg.norm(np.diff(result.tip, axis=0), axis=1).max() <= 0.001 * (1 + 1e-9)
        assert result.times[-1] == push.duration
    slow = Push(PUSH.start, (0.0001, 0.0), 100.0, 0.01)
    assert len(simulate(Model(obj, params), slow, regime="quasi_static").times) == 11
    np.testing.assert_allclose(np.diff(simulate(Model(obj, params), FORCE).times), 0.01)


def test_last_step_is_shortened_to_the_push_s_end(obj, params):
    np.testing.assert_allclose(simulate(Model(obj, params), PUSH, dt=0.2).times, [0, 0.2, 0.4, 0.5])
    np.testing.assert_allclose(simulate(Model(obj, params), PUSH, dt=0.25).times, [0, 0.25, 0.5])
    np.testing.assert_allclose(simulate(Model(obj, params), PUSH, dt=3.0).times, [0, 0.5])


def test_times_may_outlast_the_push_whose_pusher_then_stands(obj, params):
    times = np.linspace(0, 1.0, 101)
    result = simulate(Model(obj, params), PUSH, times=times)
    np.testing.assert_array_equal(result.times, times)
    np.testing.assert_allclose(result.tip[50:], np.broadcast_to(result.tip[50], (51, 2)))
    np.testing.assert_allclose(result.poses[-1], result.poses[60], atol=1e-9)


def test_record_counts_from_the_end_as_numpy_does(obj, params):
    whole = simulate(Model(obj, params), PUSH, gradients=True)
    chosen = simulate(Model(obj, params), PUSH, gradients=True, record=[-1, 2, -4])
    T = len(whole.times) - 1
    forwards = simulate(Model(obj, params), PUSH, gradients=True, record=[T, 2, T - 3])
    for name in ("mass", "friction", "contact_friction"):
        part, same, every = (getattr(s.jacobian, name) for s in (chosen, forwards, whole))
        np.testing.assert_array_equal(part, same)
        np.testing.assert_array_equal(part, every[[-1, 2, -4]])


def test_record_of_nothing(obj, params):
    J = simulate(Model(obj, params), PUSH, gradients=True, record=[]).jacobian
    assert J.mass.shape == (0, 3, obj.n)


def test_runs_are_reproducible_and_arguments_untouched(obj, params):
    pose, nu, times = np.array([0.0, 0.01, 0.2]), np.array([0.1, 0.0, 1.0]), np.linspace(0, 0.5, 77)
    given = [array.copy() for array in (pose, nu, times)]
    one = simulate(Model(obj, params), PUSH, pose, velocity=nu, times=times, gradients=True)
    other = simulate(Model(obj, params), PUSH, pose, velocity=nu, times=times, gradients=True)
    for before, after in zip(given, (pose, nu, times), strict=True):
        np.testing.assert_array_equal(before, after)
        assert after.flags.writeable
    for name in ("poses", "velocities", "contact_forces", "modes", "gaps"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    np.testing.assert_array_equal(one.jacobian.mass, other.jacobian.mass)
    one.times[0] = 5.0
    assert times[0] == 0.0


def make_batch(count):
    rng = np.random.default_rng(1)
    obj = make_shape("l_bracket", 30)
    return (
        [Model(obj, make_random_contents(rng, obj)) for _ in range(count)],
        [make_random_push(rng, obj, length=0.05) for _ in range(count)],
        rng.normal(size=(count, 3)) * 0.001,
    )


def test_two_times_that_are_one_are_refused_where_there_is_inertia():
    obj = make_shape("square", 9)
    push = Push((-0.1, 0.0), (0.1, 0.0), 1.0, 0.01)
    times = [0.0, 0.5, np.nextafter(0.5, 1.0), 1.0]
    with pytest.raises(
        SimulationError, match="two are all but the same; expected steps of at least 1e-09 s"
    ):
        simulate(Model(obj), push, times=times)
    assert len(simulate(Model(obj), push, times=times, regime="quasi_static").poses) == 4


@pytest.mark.parametrize("workers", [0, float("nan")])
def test_a_batch_needs_a_worker(workers):
    obj = make_shape("square", 9)
    with pytest.raises(SimulationError, match=f"workers is {workers}"):
        simulate_batch(Model(obj), [], workers=workers)


def test_batch_is_the_loop_whatever_the_workers():
    models, pushes, poses = make_batch(12)
    loop = [
        simulate(*job, regime="quasi_static", gradients=True)
        for job in zip(models, pushes, poses, strict=True)
    ]
    for workers in (1, 2, 5, None):
        batch = simulate_batch(
            models, pushes, poses, workers=workers, regime="quasi_static", gradients=True
        )
        for one, other in zip(loop, batch, strict=True):
            np.testing.assert_array_equal(one.poses, other.poses)
            np.testing.assert_array_equal(one.jacobian.mass, other.jacobian.mass)
            assert one.status == other.status


def test_batch_of_one_push_with_many_parameters_and_the_other_way_round():
    models, pushes, poses = make_batch(3)
    for batch, jobs in (
        (simulate_batch(models, pushes[0]), [(m, pushes[0], np.zeros(3)) for m in models]),
        (simulate_batch(models[0], pushes), [(models[0], p, np.zeros(3)) for p in pushes]),
        (
            simulate_batch(models[0], pushes[0], poses),
            [(models[0], pushes[0], q) for q in poses],
        ),
        (simulate_batch(models[0], pushes[0]), [(models[0], pushes[0], np.zeros(3))]),
        (simulate_batch([], pushes[0]), []),
    ):
        assert len(batch) == len(jobs)
        for result, (model, push, q) in zip(batch, jobs, strict=True):
            np.testing.assert_array_equal(result.poses, simulate(model, push, q).poses)


def test_batch_of_many_objects_is_the_loop():
    rng = np.random.default_rng(2)
    objects = [make_shape(name, 30) for name in ("l_bracket", "square", "l_bracket")]
    models = [Model(obj, make_random_contents(rng, obj)) for obj in objects]
    pushes = [make_random_push(rng, obj, length=0.05) for obj in objects]
    for workers in (1, 2):
        batch = simulate_batch(models, pushes, workers=workers, regime="quasi_static")
        for motion, *job in zip(batch, models, pushes, strict=True):
            np.testing.assert_array_equal(motion.poses, simulate(*job, regime="quasi_static").poses)
    with pytest.raises(SimulationError, match="lengths"):
        simulate_batch(models[:2], pushes)


def test_kernel_is_compiled_once_whatever_the_caller_s_arrays():
    """Numba compiles anew, for some 15 s, for a read-only or a strided array where it knew others."""
    obj = make_shape("l_bracket", 30)
    one_cell = GridObject("cell", np.zeros((1, 2)), 0.1, np.ones(1, int), obj.outline)
    for body in (obj, one_cell, pickle.loads(pickle.dumps(obj))):
        params = CellParameters.uniform(body, 1.0, 0.3)
        for push in (PUSH, FORCE, Push.along([0, 1], [[0, 0.2], [0, 0.1]], 0.01)):
            for gradients in (False, True, "paper"):
                simulate(
                    Model(body, pickle.loads(pickle.dumps(params))),
                    push,
                    np.zeros(6)[::2],
                    gradients=gradients,
                )
                simulate(
                    Model(body, params), push, times=np.linspace(0, 1, 9)[::2], gradients=gradients
                )
    calc_step(Model(obj), (0, 0, 0), [0, 0, 1], (1, 2, 3), 0.01)
    isotropic = [
        signature for signature in rollout.signatures if signature[0].instance_class is Isotropic
    ]
    assert len(isotropic) == len(fill_paper_gradient.signatures) == 1


def test_batch_refuses_lists_of_different_lengths():
    models, pushes, poses = make_batch(3)
    with pytest.raises(SimulationError, match="lengths"):
        simulate_batch(models, pushes[:2])
    with pytest.raises(SimulationError, match="lengths"):
        simulate_batch(models, pushes, poses[:1])
    with pytest.raises(SimulationError, match="poses"):
        simulate_batch(models, pushes, np.zeros((3, 2)))


def test_contact_points_lie_on_disc_and_outline(obj, params):
    result = simulate(Model(obj, params), PUSH, dt=0.005)
    touching = result.modes[:, 0] > 0
    assert touching.sum() > 50
    middle = (result.tip[1:] + result.tip[:-1]) / 2
    distance = np.linalg.norm(result.contact_points[:, 0] - middle, axis=1)[touching]
    np.testing.assert_allclose(distance[2:], PUSH.radius, atol=5e-6)
    assert np.isnan(result.contact_points[:, 1]).all()


def test_lagged_friction_differs_little_while_directions_change_little(obj, params):
    one = simulate(Model(obj, params, Physics(spin="separate")), PUSH, dt=0.001).final_pose
    other = simulate(Model(obj, params, Physics(friction_law="lagged")), PUSH, dt=0.001).final_pose
    assert 0 < np.abs(one - other).max() < 0.01


def test_the_number_of_edges_and_split_edges_change_nothing(obj, params):
    split = GridObject("split", obj.p_BC, obj.cell_size, obj.labels, obj.outline.segmentize(0.007))
    one, other = simulate(Model(obj, params), PUSH), simulate(Model(split, params), PUSH)
    np.testing.assert_allclose(one.poses, other.poses, atol=1e-9)


def test_make_path_times_keeps_samples_when_inertial_and_cuts_evenly_by_length_when_quasi_static():
    push = Push.along(
        [0.0, 1.0, 3.0, 4.0], [[0, 0], [0.0105, 0], [0.0105, 0], [0.0105, 0.02]], 0.005
    )
    times = make_path_times(push, "inertial")
    assert set(push.t) <= set(times)
    assert np.diff(times).max() <= 0.01 + 1e-12
    tip = push.tip_at(make_path_times(push, "quasi_static"))
    np.testing.assert_allclose(np.abs(np.diff(tip, axis=0)).sum(axis=1), 0.0305 / 31, rtol=1e-9)


@pytest.mark.parametrize("regime", ["inertial", "quasi_static"])
@pytest.mark.parametrize("height", [0.0, 0.01])
def test_derivatives_by_the_push_alone_are_those_of_the_whole_jacobian(obj, params, regime, height):
    high = replace(params, push_height=height)
    push = Push.on_outline(obj, 0.03, 0.7, 0.05, radius=0.01, speed=0.1)
    options = {"regime": regime, "record": [10, -1]}
    whole = simulate(Model(obj, high), push, gradients=True, **options)
    short = simulate(Model(obj, high), push, gradients="push", **options)
    assert np.array_equal(short.poses, whole.poses)
    assert short.jacobian.mass.shape == short.jacobian.friction.shape == (2, 3, 0)
    for name in ("contact_friction", "start", "direction", "length", "pose", "contact_location"):
        expected = getattr(whole.jacobian, name)
        assert np.abs(expected).max() > 0.0
        assert getattr(short.jacobian, name) == pytest.approx(expected, rel=1e-12, abs=1e-13)
    if height > 0.0:
        assert short.jacobian.push_height == pytest.approx(whole.jacobian.push_height, rel=1e-12)


def test_swapped_arguments_are_named(obj, params):
    form = r"as in simulate\(Model\(obj, params\), push\)"
    with pytest.raises(SimulationError, match=f"model: is a Push; expected a Bodies, {form}"):
        simulate(PUSH, Model(obj, params))
    with pytest.raises(SimulationError, match=f"push: is a CellParameters; .*, {form}"):
        simulate(Model(obj), params)
