from copy import copy
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from scipy.optimize import least_squares

from gridpush_drake.identification.fit.linearized_fit import factorize
from gridpush_drake.identification.fit.load_prior import calc_prior_factor, calc_smooth_covariance
from gridpush_drake.identification.fit.map_fit import MapFit, fit_map
from gridpush_drake.identification.statistics.center_of_mass import FRICTION_STD, CenterOfMass
from gridpush_drake.identification.statistics.noise import (
    NoiseModel,
    NoiseScale,
    calc_effective_count,
)
from gridpush_drake.identification.statistics.problem import Linearization, PushProblem
from gridpush_drake.objects.grid_object import GridObject, PhysicalPrior
from gridpush_drake.objects.parameters import CellParameters
from tests.helpers.finite_difference import check_jacobian
from tests.identification.simulated_pokes import make_pokes

RECTANGLE = [[-0.06, -0.03], [0.06, -0.03], [0.06, 0.03], [-0.06, 0.03]]


def make_problem(count: int = 6) -> tuple[PushProblem, CellParameters, np.ndarray, np.ndarray]:
    obj = GridObject.from_outline(RECTANGLE, max_cells=18)
    mass = np.where(obj.p_BC[:, 0] > 0, 0.3, 0.05)
    truth = CellParameters(mass, np.full(obj.n, 0.4), 0.35)
    problem = PushProblem(obj, make_pokes(obj, truth, count, 3), truth)
    z0 = problem.unknowns(CellParameters.uniform(obj))
    return problem, truth, z0, calc_prior_factor(calc_smooth_covariance(obj), 1.5, 0.3)


def test_center_of_mass_residual_has_the_jacobian_it_says() -> None:
    problem, _, z0, _ = make_problem(1)
    known = CenterOfMass((0.01, -0.002), 0.002, 0.2)
    z = z0 + np.random.default_rng(0).normal(size=len(z0)) * 0.3
    W, _ = known.make_whitening(problem.obj, z)
    check_jacobian(
        lambda v: known.linearize(problem.obj, v, W)[0],
        z,
        known.linearize(problem.obj, z, W)[1],
        rtol=1e-6,
    )


def test_center_of_friction_scatters_about_the_center_of_mass_as_drawn_frictions_make_it() -> None:
    problem, truth, z0, _ = make_problem(1)
    obj, rng, sigma = problem.obj, np.random.default_rng(1), 0.1
    z, at = problem.unknowns(truth), truth.center_of_mass(obj)
    k = truth.mass * np.exp(sigma * rng.standard_normal((20000, obj.n)))
    centers = (k / k.sum(axis=1, keepdims=True)) @ obj.p_BC
    centers += 0.001 * rng.standard_normal(centers.shape)
    W, spread = CenterOfMass((at[0], at[1]), 0.001, sigma).make_whitening(obj, z)
    np.testing.assert_allclose(np.cov(((centers - at) @ W.T).T), np.eye(2), atol=0.05)
    assert spread == pytest.approx(-np.linalg.slogdet(W)[1])
    feet = z0.copy()
    feet[[0, obj.n // 2, obj.n - 1]] += 5.0
    nearer, farther = (
        CenterOfMass((0.0, 0.0), 0.001, sigma).make_whitening(obj, at)[1] for at in (z0, feet)
    )
    assert nearer < farther


def test_frictions_scatter_no_more_than_their_bounds_allow() -> None:
    told = PhysicalPrior(
        friction=0.35, friction_min=0.3, friction_max=0.4, center_of_mass=(0.0, 0.01)
    )
    wide, narrow = (
        CenterOfMass.of_prior(replace(told, friction_max=1.0)),
        CenterOfMass.of_prior(told),
    )
    assert wide is not None and narrow is not None
    assert wide.friction_std == FRICTION_STD > narrow.friction_std
    assert narrow.friction_std == pytest.approx(np.log(0.4 / 0.3) / 12**0.5)
    assert CenterOfMass.of_prior(replace(told, center_of_mass=None)) is None


@pytest.mark.parametrize("std", [0.0001, 0.002, 0.02])
def test_a_center_of_mass_is_no_evidence_for_an_amplitude_where_no_push_was_made(
    std: float,
) -> None:
    problem, _, z0, _ = make_problem(1)
    # One push, whose noise is so large that it says nothing.
    noise = NoiseModel(pose=1e3, tip=1e3, load_shift=1e3, prior_weight=1e9, shift_weight=1e9)
    C = calc_smooth_covariance(problem.obj)
    found = [
        fit_map(
            problem, z0, calc_prior_factor(C, a, 0.3), noise, CenterOfMass((0.02, 0.005), std)
        ).log_evidence
        for a in (0.2, 0.7, 1.5, 3.0)
    ]
    np.testing.assert_allclose(found, found[0], atol=0.1)


def test_noise_free_pokes_give_the_center_of_friction_back() -> None:
    problem, truth, z0, A = make_problem()
    fit = fit_map(problem, z0, A, NoiseModel())
    found = problem.params(fit.z)
    error = (
        found.relative_friction() @ problem.obj.p_BC - truth.relative_friction() @ problem.obj.p_BC
    )
    assert np.linalg.norm(error) < 1e-3
    assert problem.calc_cell_errors(problem.residuals(fit.z)).mean() < 3e-4
    assert found.contact_friction == pytest.approx(truth.contact_friction, rel=0.1)


def test_evidence_prefers_the_prior_that_can_explain_the_data() -> None:
    problem, _, z0, A = make_problem()
    flat = calc_prior_factor(calc_smooth_covariance(problem.obj), 0.05, 0.3)
    assert (
        fit_map(problem, z0, A, NoiseModel()).log_evidence
        > fit_map(problem, z0, flat, NoiseModel()).log_evidence + 5
    )


def test_covariance_shrinks_from_the_prior_and_more_data_shrink_it_further() -> None:
    problem, _, z0, A = make_problem()
    fewer, _, _, _ = make_problem(2)
    few, many = fit_map(fewer, z0, A, NoiseModel()), fit_map(problem, z0, A, NoiseModel())
    prior = A @ A.T
    assert np.linalg.eigvalsh(prior - many.covariance).min() > -1e-8
    assert np.trace(many.covariance) < np.trace(few.covariance) < np.trace(prior)
    assert 0 < many.effective_parameters < len(z0)


def test_known_center_of_mass_pulls_the_center_of_friction() -> None:
    problem, _, z0, A = make_problem(1)
    at = (-0.02, 0.0)
    fit = fit_map(problem, z0, A, NoiseModel(), CenterOfMass(at, 0.0005))
    center = problem.params(fit.z).relative_friction() @ problem.obj.p_BC
    assert np.linalg.norm(center - at) < 0.005


def test_an_outlier_counts_for_less() -> None:
    noise = NoiseModel(outlier=1.0)
    whitened = np.array([10.0, 0.0, 0.0])
    size = np.linalg.norm(whitened) / np.sqrt(3)
    assert noise.calc_weight(whitened) == pytest.approx(1 / size)
    assert noise.calc_loss(whitened) == pytest.approx(1.5 * (2 * size - 1))
    assert noise.calc_weight(np.full(3, 0.5)) == 1.0
    assert noise.calc_loss(np.full(3, 0.5)) == pytest.approx(1.5 * 0.25)


def test_many_observations_of_one_push_count_as_their_square_root() -> None:
    assert calc_effective_count(3) == pytest.approx(3)
    assert calc_effective_count(3 * 16) == pytest.approx(12)


def make_stacked(
    problem: PushProblem, z0: np.ndarray, A: np.ndarray, fit: MapFit, noise: NoiseModel
):
    """The problem in u, whole: residuals and Jacobian with the noise dense and weights held as they are at the fit."""
    whitening, weights = [], []
    for inputs, r in zip(fit.linear.by_inputs, fit.linear.residuals, strict=True):
        whitening.append(
            np.linalg.inv(np.linalg.cholesky(noise.calc_covariance(inputs, fit.scale)))
        )
        weights.append(np.sqrt(noise.calc_weight(whitening[-1] @ r)))

    def evaluate(u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        linear = problem.linearize(z0 + A @ u)
        rows = [w * W @ r for w, W, r in zip(weights, whitening, linear.residuals, strict=True)]
        slopes = [w * W @ J @ A for w, W, J in zip(weights, whitening, linear.by_z, strict=True)]
        return np.concatenate([u, *rows]), np.concatenate([np.eye(len(u)), *slopes])

    return evaluate


@pytest.mark.parametrize("count", [1, 2, 6])  # fewer residuals than unknowns, and more
def test_fit_is_that_of_the_whole_problem_solved_densely(count: int) -> None:
    problem, _, z0, A = make_problem(count)
    noise = NoiseModel()
    fit = fit_map(problem, z0, A, noise)
    evaluate = make_stacked(problem, z0, A, fit, noise)
    u = np.linalg.solve(A, fit.z - z0)
    slow = least_squares(
        lambda v: evaluate(v)[0], u, jac=lambda v: evaluate(v)[1], ftol=1e-12, xtol=1e-12, gtol=None
    )
    std = np.sqrt(np.diag(fit.covariance))
    assert (np.abs(z0 + A @ slow.x - fit.z) < 0.1 * std).all()
    J = evaluate(u)[1]
    np.testing.assert_allclose(
        fit.covariance, A @ np.linalg.inv(J.T @ J) @ A.T, rtol=1e-6, atol=1e-9
    )


def test_whitening_is_the_inverse_root_of_the_noise() -> None:
    problem, _, z0, _ = make_problem(1)
    linear, noise = problem.linearize(z0), NoiseModel()
    scale = NoiseScale(1.3, 0.7)
    sigma = noise.calc_covariance(linear.by_inputs[0], scale)
    W = noise.make_whitenings(linear.by_inputs, scale)[0]
    twice = W.apply(W.apply(np.eye(len(sigma))))
    np.testing.assert_allclose(twice @ sigma, np.eye(len(sigma)), atol=1e-8)
    assert W.log_determinant == pytest.approx(0.5 * np.linalg.slogdet(sigma)[1])


def test_last_poses_are_judged_by_what_the_other_pushes_say_of_them() -> None:
    problem, _, z0, A = make_problem(4)
    system = fit_map(problem, z0, A, NoiseModel()).linearized
    noise, K = system.noise, len(system.linear.residuals[0]) // 3
    ratios = system.leave_out_ends().ratios
    for i, ratio in enumerate(ratios):
        weighted = [root * W.apply(J) for root, W, J in zip(
            np.sqrt(system.weights), system.whitenings, system.slopes, strict=True)]  # fmt: skip
        others = np.concatenate([rows for j, rows in enumerate(weighted) if j != i])
        H = np.eye(len(z0)) + others.T @ others
        J, r, W = system.slopes[i], system.linear.residuals[i], system.whitenings[i]
        own = weighted[i].T @ (np.sqrt(system.weights[i]) * W.apply(r))
        e = (r + J @ np.linalg.solve(H, own))[
            -3:
        ]  # the fit moves on by what the push itself pulled
        one = noise.calc_covariance(system.linear.by_inputs[i], system.scale)[-3:, -3:]
        one -= (system.scale.pose * noise.pose) ** 2 * (np.sqrt(K) - 1) * np.eye(3)
        S = one + J[-3:] @ np.linalg.solve(H, J[-3:].T)
        assert ratio == pytest.approx(e @ e / np.trace(S), rel=1e-6)
    worse = [r + 0.01 for r in system.linear.residuals]
    assert system.leave_out_ends(worse).ratios.sum() > 10 * ratios.sum()


def test_the_log_predictive_is_that_of_students_t_as_wide_as_the_errors_are() -> None:
    problem, _, z0, A = make_problem(4)
    system = fit_map(problem, z0, A, NoiseModel()).linearized
    noise = system.noise
    ends = system.leave_out_ends()
    f = noise.calc_freedom(len(problem))
    kappa = noise.calc_discrepancy(ends.ratios)
    scale = noise.calc_typical_fraction(len(problem)) * kappa**2
    exact = [
        stats.multivariate_t.logpdf(e, shape=scale * C, df=f)
        for e, C in zip(ends.errors, ends.covariances, strict=True)
    ]
    # Both differ by a constant: that of four errors of zero and unit covariance.
    constant = len(problem) * stats.multivariate_t.logpdf(np.zeros(3), shape=np.eye(3), df=f)
    assert noise.calc_log_predictive(ends) == pytest.approx(sum(exact) - constant)


class SteepOnce(PushProblem):
    """Pushes whose derivatives are all but infinite at the first step of a fit, as at a jump."""

    asked = 0

    def linearize(self, z: np.ndarray, pushes: list[int] | None = None) -> Linearization:
        self.asked += 1
        linear = super().linearize(z, pushes)
        if self.asked != 2:
            return linear
        by_z = [1e16 * J for J in linear.by_z]
        by_inputs = [1e16 * J for J in linear.by_inputs]
        return replace(linear, by_z=by_z, by_inputs=by_inputs)


def test_a_step_to_where_the_equations_cannot_be_solved_is_shortened() -> None:
    problem, _, z0, A = make_problem()
    expected = fit_map(problem, z0, A, NoiseModel())
    steep = copy(problem)
    steep.__class__ = SteepOnce
    found = fit_map(steep, z0, A, NoiseModel())
    assert steep.asked > 2
    np.testing.assert_allclose(found.z, expected.z, atol=0.05)


def test_a_push_whose_end_all_but_jumps_does_not_end_a_fit() -> None:
    """Its derivatives are so large that round-off takes the smallest eigenvalues, which are 1."""
    rng = np.random.default_rng(2)
    J = np.vstack([1e10 * rng.standard_normal((6, 12)), rng.standard_normal((6, 12))])
    H = np.eye(12) + J.T @ J
    with pytest.raises(np.linalg.LinAlgError):
        np.linalg.cholesky(H)
    (L, _), ridge = factorize(H)
    L = np.tril(L)
    assert 0 < ridge < 1e-10 * H.max()
    np.testing.assert_allclose(L @ L.T, H, atol=2 * ridge)
    # A matrix that has a factor gets just that.
    small = np.eye(3) + 0.2
    (L, _), ridge = factorize(small)
    assert ridge == 0.0
    np.testing.assert_array_equal(np.tril(L), np.linalg.cholesky(small))
    with pytest.raises(np.linalg.LinAlgError):
        factorize(np.full((2, 2), np.nan))


def test_a_fit_begins_from_a_point_with_derivatives_as_good_as_infinite() -> None:
    problem, _, z0, A = make_problem(4)
    jumps = copy(problem)
    jumps.linearize = lambda z: _make_steep(problem.linearize(z))
    fit = fit_map(jumps, z0, A, NoiseModel())
    assert np.isfinite(fit.linearized.calc_covariance()).all()


def _make_steep(linear: Linearization) -> Linearization:
    """The first push's end as good as jumps with any change of the loads."""
    return replace(linear, by_z=[1e12 * linear.by_z[0], *linear.by_z[1:]])
