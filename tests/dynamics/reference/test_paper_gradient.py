import numpy as np
import pytest

from gridpush_drake.dynamics.reference.maximal_solvers import solve_as_qp
from gridpush_drake.dynamics.reference.paper_gradient import (
    calc_paper_gradient,
    calc_paper_loss_gradient,
    calc_paper_step_jacobian,
    calc_x11,
)
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.parameters import CellParameters
from tests.helpers.finite_difference import calc_finite_difference, check_jacobian
from tests.helpers.random_pushes import DT, make_random_step

SEEDS = range(4)


def solve(step, mass=None, friction=None):
    params = CellParameters(
        step.params.mass if mass is None else mass,
        step.params.friction if friction is None else friction,
    )
    lcp = step.make_lcp(params)
    return lcp, solve_as_qp(lcp)


def slides(lcp, solution):
    return bool((solution.lam_f == lcp.bound).all())


@pytest.mark.parametrize("seed", SEEDS)
def test_gradient_of_a_sliding_object_agrees_with_differences(seed):
    step = make_random_step(seed, speed=3.0)
    lcp, solution = solve(step)
    assert slides(lcp, solution)
    gradient = calc_paper_gradient(lcp, solution, step.T)
    check_jacobian(
        lambda m: solve(step, mass=m)[1].xdot,
        step.params.mass,
        gradient.mass,
        step=3e-3,
        order=4,
        rtol=1e-7,
    )
    check_jacobian(
        lambda mu: solve(step, friction=mu)[1].xdot,
        step.params.friction,
        gradient.friction,
        step=3e-3,
        order=4,
        rtol=1e-7,
    )


@pytest.mark.slow
def test_gradient_holds_where_some_rows_stick_or_are_carried_backwards():
    checked = 0
    for seed in range(60):
        step = make_random_step(seed, speed=0.05, force=1.0)
        lcp, solution = solve(step)
        s = solution.lam_f / lcp.bound
        sticks = (s > 0) & (s < 1)
        margin = np.minimum(s, 1 - s)[sticks].min(initial=1.0)
        others = np.abs(lcp.J_f @ solution.xdot)[~sticks].min(initial=1.0)
        if (
            slides(lcp, solution)
            or margin < 0.01
            or others < 1e-4
            or np.abs(solution.xdot).max() < 1e-3
        ):
            continue
        checked += 1
        if checked > 4:
            break
        gradient = calc_paper_gradient(lcp, solution, step.T)
        for name, x in (("mass", step.params.mass), ("friction", step.params.friction)):
            check_jacobian(
                lambda x, step=step, name=name: solve(step, **{name: x})[1].xdot,
                x,
                getattr(gradient, name),
                step=1e-5,
                rtol=1e-6,
                atol=1e-8,
            )
    assert checked == 5


@pytest.mark.parametrize("speed", [3.0, 0.05])
@pytest.mark.parametrize("spanning_tree", [True, False])
def test_condensed_and_explicit_routes_agree(spanning_tree, speed):
    for seed in SEEDS:
        step = make_random_step(seed, speed=speed)
        lcp = step.make_lcp(spanning_tree=spanning_tree)
        solution = solve_as_qp(lcp)
        explicit, condensed = calc_x11(lcp, solution), calc_x11(lcp, solution, step.T)
        root = np.sqrt(lcp.M)
        np.testing.assert_allclose(
            explicit * np.outer(root, root), condensed * np.outer(root, root), atol=1e-11
        )
        one, other = calc_paper_gradient(lcp, solution), calc_paper_gradient(lcp, solution, step.T)
        for a, b in ((one.mass, other.mass), (one.friction, other.friction)):
            np.testing.assert_allclose(a, b, rtol=0, atol=1e-9 * (1 + np.abs(b).max()))


def test_x11_of_a_single_cell_is_its_inverse_inertia():
    step = make_random_step(0, n=1, speed=3.0)
    lcp, solution = solve(step)
    for T in (None, step.T):
        np.testing.assert_allclose(calc_x11(lcp, solution, T), np.diag(1 / lcp.M), atol=1e-9)


def test_x11_is_the_paper_s_formula():
    step = make_random_step(3, speed=3.0)
    lcp, solution = solve(step)
    M_inv, J_e = np.diag(1 / lcp.M), lcp.J_e.toarray()
    X11 = M_inv - M_inv @ J_e.T @ np.linalg.solve(J_e @ M_inv @ J_e.T, J_e @ M_inv)
    root = np.sqrt(np.outer(lcp.M, lcp.M))
    np.testing.assert_allclose(calc_x11(lcp, solution) * root, X11 * root, atol=1e-10)


@pytest.mark.parametrize("seed", SEEDS)
def test_loss_gradient_agrees_with_differences(seed):
    step = make_random_step(seed, speed=3.0)
    n = step.obj.n
    x = np.hstack([np.full((n, 1), step.q[2]), step.obj.cells_at(step.q)]).ravel()
    goal = x + np.random.default_rng(seed).normal(size=3 * n) * 0.01
    weight = np.tile([0.0, 1.0, 1.0], n)  # positions only, as the average distance of the cells

    def loss(xdot):
        return np.sum(weight * (x + DT * xdot - goal) ** 2)

    lcp, solution = solve(step)
    error = weight * (x + DT * solution.xdot - goal)
    routes = [calc_paper_loss_gradient(lcp, solution, error, T) for T in (step.T, None)]
    for i, name in enumerate(("mass", "friction")):
        check_jacobian(
            lambda x, name=name: np.full(2, loss(solve(step, **{name: x})[1].xdot)),
            getattr(step.params, name),
            np.stack([route[i] for route in routes]),
            step=1e-3,
            order=4,
            rtol=1e-6,
        )


@pytest.mark.parametrize("seed", SEEDS)
def test_step_jacobian_is_the_gradient_in_three_unknowns(seed):
    step = make_random_step(seed, speed=3.0)
    lcp, solution = solve(step)
    nu_next = np.linalg.lstsq(step.T, solution.xdot)[0]
    by_mass, by_friction = calc_paper_step_jacobian(
        Model(step.obj, step.params), step.q, step.nu, nu_next, DT
    )
    gradient = calc_paper_gradient(lcp, solution, step.T)
    np.testing.assert_allclose(
        step.T @ by_mass, gradient.mass, rtol=0, atol=1e-11 * np.abs(gradient.mass).max()
    )
    np.testing.assert_allclose(
        step.T @ by_friction,
        gradient.friction,
        rtol=0,
        atol=1e-11 * np.abs(gradient.friction).max(),
    )


def test_step_jacobian_of_a_body_that_stays_at_rest_is_zero_and_from_rest_takes_the_impending_motion():
    step = make_random_step(0, speed=0.0, force=3.0)
    zero = np.zeros(3)
    for derivative in calc_paper_step_jacobian(
        Model(step.obj, step.params), step.q, np.array([0.01, 0.0, 0.1]), zero, DT
    ):
        np.testing.assert_array_equal(derivative, np.zeros((3, step.obj.n)))
    nu_next = np.linalg.lstsq(step.T, solve(step)[1].xdot)[0]
    _, by_friction = calc_paper_step_jacobian(
        Model(step.obj, step.params), step.q, zero, nu_next, DT
    )
    assert (np.linalg.norm(by_friction, axis=0) > 0).all()


def test_the_derivative_at_zero_friction_is_that_of_growing_friction():
    step = make_random_step(2, speed=3.0, friction_range=(0.0, 0.0))
    lcp, solution = solve(step)
    gradient = calc_paper_gradient(lcp, solution, step.T)
    small = 1e-4
    for i in range(step.obj.n):
        friction = np.zeros(step.obj.n)
        friction[i] = small
        slope = (solve(step, friction=friction)[1].xdot - solution.xdot) / small
        np.testing.assert_allclose(gradient.friction[:, i], slope, atol=1e-6 * np.abs(slope).max())


def test_harness_names_the_worst_entry():
    def function(x):
        return np.array([x[0] ** 2, x[0] * x[1]])

    x = np.array([2.0, 3.0])
    right = np.array([[4.0, 0.0], [3.0, 2.0]])
    check_jacobian(function, x, right)
    check_jacobian(function, x, right, order=4, step=1e-2)
    np.testing.assert_allclose(
        calc_finite_difference(np.sin, np.zeros(()), step=1e-4), 1.0, rtol=1e-8
    )
    with pytest.raises(AssertionError, match=r"worst is jacobian\[1, 0\] = 3.5"):
        check_jacobian(function, x, right + [[0, 0], [0.5, 0]])
    with pytest.raises(AssertionError, match="shape"):
        check_jacobian(function, x, right[:1])
