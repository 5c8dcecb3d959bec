"""The dissipation function: kernel against the equation, and against the integral that it stands for."""

import numpy as np
import pytest

from gridpush_drake.dynamics.kernels.friction.friction_law import SPIN_LEVER_ARM
from gridpush_drake.dynamics.kernels.friction.isotropic_friction import (
    add_isotropic,
    fill_cell_forces,
)
from gridpush_drake.dynamics.kernels.friction.lagged_friction import add_lagged
from tests.helpers.finite_difference import check_jacobian
from tests.helpers.random_objects import make_random_object

EPS = 1e-3


def calc_dissipation(p_BC, k, kappa, spin_load, xi, eps=0.0):
    """The equation at the head of `friction`, in NumPy, W."""
    v = xi[:2] + xi[2] * np.column_stack([-p_BC[:, 1], p_BC[:, 0]])
    s = np.sqrt((v**2).sum(axis=1) + (kappa * xi[2]) ** 2 + eps**2)
    return float(k @ s + spin_load * abs(xi[2]))


def make_cells(seed, n=12):
    rng = np.random.default_rng(seed)
    p_BC = make_random_object(rng, n, 0.01).p_BC
    return (
        p_BC,
        np.array(p_BC.T, order="C"),
        rng.uniform(0.1, 1.0, n),
        rng.normal(size=3) * (0.01, 0.01, 0.2),
    )


def calc_isotropic(p, k, kappa, spin_load, xi, majorize=False):
    g, H = np.zeros(3), np.zeros((3, 3))
    add_isotropic(p[0], p[1], k, kappa**2, spin_load, EPS, np.array(xi), majorize, g, H)
    return g, H


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("kappa", [0.0, 0.004])
def test_gradient_and_hessian_are_the_dissipation_s(kappa, seed):
    p_BC, p, k, xi = make_cells(seed)
    g, H = calc_isotropic(p, k, kappa, 0.0, xi)
    check_jacobian(
        lambda x: calc_dissipation(p_BC, k, kappa, 0.0, x, EPS), xi, g, step=1e-4, order=4
    )
    check_jacobian(lambda x: calc_isotropic(p, k, kappa, 0.0, x)[0], xi, H, step=1e-4, order=4)
    assert np.linalg.eigvalsh(H).min() > 0


def test_separate_spin_adds_a_smooth_absolute_value():
    _, p, k, xi = make_cells(0)
    g, H = calc_isotropic(p, k, 0.0, 0.7, xi)
    check_jacobian(lambda x: calc_isotropic(p, k, 0.0, 0.7, x)[0], xi, H, step=1e-4, order=4)
    without, _ = calc_isotropic(p, k, 0.0, 0.0, xi)
    np.testing.assert_allclose(g - without, [0, 0, 0.7 * xi[2] / np.hypot(xi[2], EPS)], atol=1e-12)


def test_majorizing_quadratic_touches_from_above():
    rng = np.random.default_rng(1)
    p_BC, p, k, xi = make_cells(1)
    g, H = calc_isotropic(p, k, 0.004, 0.0, xi, True)
    here = calc_dissipation(p_BC, k, 0.004, 0.0, xi, EPS)
    for scale in (0.01, 1.0, 100.0):
        for _ in range(20):
            d = rng.normal(size=3) * scale * xi
            assert (
                calc_dissipation(p_BC, k, 0.004, 0.0, xi + d, EPS)
                <= here + g @ d + d @ H @ d / 2 + 1e-12
            )


def test_cell_forces_sum_up_to_the_gradient():
    for model in ([0.004**2, 0.0, 0.0], [0.0, 0.5, 0.004], [0.0, 0.0, 0.0]):
        _, p, k, xi = make_cells(2)
        spin_load = k.sum() * model[2]
        f = np.zeros((3, len(k) + 4))
        fill_cell_forces(p[0], p[1], np.array(model), EPS**2, xi, f)
        np.testing.assert_allclose(
            f[:, : len(k)] @ k, calc_isotropic(p, k, np.sqrt(model[0]), spin_load, xi)[0]
        )
        assert not f[:, len(k) :].any()


def test_lagged_gradient_and_hessian():
    rng = np.random.default_rng(3)
    _, p, k, xi = make_cells(3)
    angle = rng.uniform(0, 2 * np.pi, len(k))
    dx, dy = np.cos(angle), np.sin(angle)

    def calc(x):
        g, H = np.zeros(3), np.zeros((3, 3))
        add_lagged(p[0], p[1], k, dx, dy, 0.3, -1.0, EPS, np.array(x), g, H)
        return g, H

    def calc_energy(x):
        z = dx * (x[0] - x[2] * p[1]) + dy * (x[1] + x[2] * p[0])
        ramp = [(z + np.hypot(z, EPS)) / 2, (-x[2] + np.hypot(x[2], EPS)) / 2]
        return k @ ramp[0] + 0.3 * ramp[1]

    check_jacobian(calc_energy, xi, calc(xi)[0], step=1e-4, order=4)
    check_jacobian(lambda x: calc(x)[0], xi, calc(xi)[1], step=1e-4, order=4)


def test_coupled_spin_is_the_mean_over_the_cell_s_points_in_both_limits_and_near_it_in_between():
    """s_i against the mean of |v + w z × r| over a square: exact where it slides fast or only spins."""
    side = 0.01
    r = side * (
        np.stack(np.meshgrid(*[(np.arange(400) + 0.5) / 400] * 2), axis=-1).reshape(-1, 2) - 0.5
    )
    worst = 0.0
    for v in (0.0, 1e-3, 3e-3, 1e-2, 1e-1):
        mean = np.hypot(v - r[:, 1], r[:, 0]).mean()  # w = 1 rad/s
        s = calc_dissipation(
            np.zeros((1, 2)), np.ones(1), SPIN_LEVER_ARM * side, 0.0, np.array([v, 0.0, 1.0])
        )
        worst = max(worst, abs(s / mean - 1))
        if v in (0.0, 0.1):
            assert s == pytest.approx(mean, rel=1e-3)
    print(f"coupled spin: within {worst:.1%} of the integral")
    assert worst < 0.06
