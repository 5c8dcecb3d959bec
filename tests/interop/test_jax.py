"""Pushes in JAX: the same poses, and derivatives forward, backward, batched and compiled."""

import numpy as np
import pytest

from gridpush_drake.errors import SimulationError
from gridpush_drake.interop.differentiable import ARGUMENT_NAMES
from tests.helpers.finite_difference import check_jacobian

jax = pytest.importorskip("jax", reason="jax is not installed")
jax.config.update("jax_enable_x64", True)

from gridpush_drake.interop.jax import PushSetting, simulate  # noqa: E402

EVERY = tuple(range(len(ARGUMENT_NAMES)))


def test_poses_and_both_jacobians_are_the_simulators(case, function):
    values = [jax.numpy.asarray(value) for value in case.values.values()]
    poses, blocks = function.expected.differentiate(*case.values.values())
    found = function(*values)
    assert found.dtype == jax.numpy.float64
    np.testing.assert_array_equal(found, poses)
    np.testing.assert_array_equal(jax.jit(function)(*values), poses)
    for transform in (jax.jacfwd, jax.jacrev):
        for run in (transform(function, EVERY), jax.jit(transform(function, EVERY))):
            for block, jacobian in zip(blocks, run(*values), strict=True):
                np.testing.assert_allclose(jacobian, block, rtol=1e-12, atol=1e-15)


def test_a_gradient_meets_finite_differences(case, function):
    mass = case.values["mass"]
    others = list(case.values.values())[1:]

    def loss(mass):
        pose = function(mass, *others)
        return (pose**2).sum() + jax.numpy.sin(5 * pose[2])

    gradient = jax.grad(loss)(mass)
    check_jacobian(lambda m: float(loss(m)), mass, gradient, step=1e-5, rtol=2e-4, order=4)


def test_batches_are_what_single_pushes_are(case, function):
    values = list(case.values.values())
    starts = values[3] + np.linspace(0.0, 0.001, 3)[:, None]
    frictions = np.linspace(0.3, 0.5, 2)

    def of(start, contact_friction):
        return function(*values[:2], contact_friction, start, *values[4:])

    batched = jax.vmap(jax.vmap(of, (None, 0)), (0, None))
    poses = jax.jit(batched)(starts, frictions)
    slopes = jax.vmap(jax.vmap(jax.jacrev(of), (None, 0)), (0, None))(starts, frictions)
    assert poses.shape == (3, 2, 3)
    assert slopes.shape == (3, 2, 3, 2)
    for i, start in enumerate(starts):
        for j, contact_friction in enumerate(frictions):
            np.testing.assert_array_equal(poses[i, j], of(start, contact_friction))
            np.testing.assert_allclose(
                slopes[i, j], jax.jacfwd(of)(start, contact_friction), rtol=1e-12, atol=1e-15
            )
    # leading dimensions of one's own do the same
    own = function(*values[:2], frictions, starts[:, None], *values[4:])
    np.testing.assert_array_equal(own, poses)
    summed = jax.grad(lambda s: function(*values[:2], frictions, s, *values[4:]).sum())
    np.testing.assert_allclose(
        summed(starts[:, None])[:, 0], slopes.sum(axis=(1, 2)), rtol=1e-10, atol=1e-14
    )


def test_a_whole_path_is_differentiated(case):
    setting = case.make_setting(path=True)
    values = dict(case.values)
    given = {name: values[name] for name in ARGUMENT_NAMES if name != "friction"}

    def run(friction):
        return simulate(case.obj, setting, friction=friction, **given)

    jacobian = jax.jacrev(run)(values["friction"])
    assert jacobian.shape == (26, 3, case.obj.n)
    check_jacobian(
        lambda friction: np.asarray(run(friction)),
        values["friction"],
        jacobian,
        step=1e-5,
        rtol=5e-4,
        order=4,
    )


def test_what_will_not_do_is_refused(case):
    setting = PushSetting(duration=0.5)
    with pytest.raises(SimulationError, match=r"start has shape \(3,\)"):
        simulate(case.obj, setting, start=np.zeros(3), velocity=np.ones(2))
    with pytest.raises(SimulationError, match="velocity is missing"):
        simulate(case.obj, setting, start=np.zeros(2), velocity=None)
    with pytest.raises(Exception, match=r"velocity is \(0, 0\)"):
        simulate(case.obj, setting, start=np.zeros(2), velocity=np.zeros(2)).block_until_ready()
    jax.config.update("jax_enable_x64", False)
    try:
        with pytest.raises(SimulationError, match="64-bit numbers are off"):
            simulate(case.obj, setting, start=np.zeros(2), velocity=np.ones(2))
    finally:
        jax.config.update("jax_enable_x64", True)
