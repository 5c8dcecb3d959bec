from dataclasses import replace

import numpy as np
import pytest
from pydrake.solvers import MathematicalProgram, MobyLcpSolver, UnrevisedLemkeSolver
from shapely import box

from gridpush_drake.dynamics.kernels.friction.friction_law import SPIN_LEVER_ARM
from gridpush_drake.dynamics.reference.maximal_lcp import make_maximal_lcp
from gridpush_drake.dynamics.reference.maximal_solvers import (
    solve_as_lcp,
    solve_as_qp,
    solve_isotropic_socp,
)
from gridpush_drake.errors import SimulationError
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from tests.helpers.random_pushes import DT, make_random_step

CASES = {
    "moving": {},
    "slow": {"speed": 0.01},
    "stopping": {"speed": 0.05, "force": 0.2},
    "fast": {"speed": 10.0, "force": 3.0},
    "at rest, below the static limit": {"speed": 0.0, "force": 0.02, "friction_range": (0.3, 0.8)},
    "at rest, near the static limit": {"speed": 0.0, "force": 0.3},
    "at rest, above the static limit": {"speed": 0.0, "force": 2.0},
    "no friction": {"friction_range": (0.0, 0.0)},
    "coasting": {"force": 0.0},
}


def make_drake_solver(Solver):
    def solve(M, q):
        program = MathematicalProgram()
        z = program.NewContinuousVariables(len(q))
        program.AddLinearComplementarityConstraint(M, q, z)
        result = Solver().Solve(program, np.zeros(len(q)), None)
        assert result.is_success()
        return result.GetSolution(z)

    return solve


@pytest.mark.parametrize("case", CASES)
def test_two_lcp_solvers_and_the_qp_agree(case):
    for seed in range(6):
        step = make_random_step(seed, **CASES[case])
        if seed % 3 == 0:  # some cells without friction, others with much
            friction = np.where(np.arange(step.obj.n) % 2, 0.0, step.params.friction)
            step = replace(step, params=CellParameters(step.params.mass, friction))
        velocities = []
        for spanning_tree in (True, False):
            lcp = step.make_lcp(spanning_tree=spanning_tree)
            for solution in (
                solve_as_qp(lcp),
                solve_as_lcp(lcp, make_drake_solver(MobyLcpSolver)),
                solve_as_lcp(lcp, make_drake_solver(UnrevisedLemkeSolver)),
            ):
                assert solution.residuals.worst < 1e-12, (case, seed, solution.residuals)
                velocities.append(solution.xdot)
        scale = max(np.abs(step.nu).max(), np.abs(velocities[0]).max())
        np.testing.assert_allclose(
            velocities[1:], velocities[:1] * 5, rtol=0, atol=1e-11 * scale + 1e-14
        )


def test_the_qp_covers_every_state_of_a_friction_row():
    sliding = sticking = backwards = partial = 0
    for seed in range(60):
        step = make_random_step(seed, speed=0.02, force=0.5)
        lcp = step.make_lcp()
        solution = solve_as_qp(lcp)
        assert solution.residuals.worst < 1e-12
        states = (
            (solution.lam_f == lcp.bound).any(),
            ((solution.lam_f > 0) & (solution.lam_f < lcp.bound)).any(),
            (solution.lam_f == 0).any(),
        )
        sliding, sticking, backwards = np.add((sliding, sticking, backwards), states)
        partial += states[1] and np.abs(solution.xdot).max() > 1e-6
    assert min(sliding, sticking, backwards, partial) > 3, (sliding, sticking, backwards, partial)


@pytest.mark.parametrize("seed", range(3))
def test_a_long_chain_of_the_largest_size_is_solved_to_round_off(seed):
    rng = np.random.default_rng(seed)
    n, s = 127, 0.01
    obj = GridObject(
        "chain",
        np.stack([s * np.arange(n), np.zeros(n)], axis=1),
        s,
        np.ones(n, int),
        box(-s / 2, -s / 2, s * n, s / 2),
    )
    params = CellParameters(rng.uniform(0.01, 0.2, n), rng.uniform(0.1, 0.8, n))
    F = np.zeros(3 * n)
    F[1:3] = params.total_mass * rng.normal(size=2) * 5
    solution = solve_as_qp(
        make_maximal_lcp(Model(obj, params), rng.normal(size=3), np.zeros(3 * n), F, DT)
    )
    assert solution.residuals.worst < 1e-12


@pytest.mark.parametrize("fraction, moves", [(0.999, False), (1.001, True)])
def test_the_static_limit_is_mu_m_g(fraction, moves):
    step = make_random_step(7)
    obj = step.obj
    params = CellParameters(step.params.mass, np.full(obj.n, 0.4))
    F = np.zeros(3 * obj.n)
    F[1::3] = (
        fraction * 0.4 * params.mass * 9.81
    )  # every cell is pulled by what it can just bear, but for the fraction
    lcp = make_maximal_lcp(Model(obj, params), step.q, np.zeros(3 * obj.n), F, DT)
    solution = solve_as_qp(lcp)
    assert (np.abs(solution.xdot).max() > 1e-6) == moves
    if moves:
        np.testing.assert_allclose(solution.xdot[1::3], (fraction - 1) * 0.4 * 9.81 * DT, rtol=1e-9)


def test_velocities_decay_by_mu_g_dt():
    step = make_random_step(8)
    params = CellParameters(step.params.mass, np.full(step.obj.n, 0.3))
    xdot = np.tile([0.0, 0.3, 0.4], step.obj.n)
    lcp = make_maximal_lcp(Model(step.obj, params), step.q, xdot, np.zeros_like(xdot), DT)
    solution = solve_as_qp(lcp)
    np.testing.assert_allclose(solution.xdot, (0.5 - 0.3 * 9.81 * DT) / 0.5 * xdot, atol=1e-13)
    np.testing.assert_allclose(solution.lam_f[: lcp.n], lcp.bound[: lcp.n])


def calc_step_energy(step, nu, spin):
    """The convex function that the isotropic step minimizes, written out cell by cell."""
    obj, params = step.obj, step.params
    s, m, arm = obj.cell_size, params.mass, SPIN_LEVER_ARM * obj.cell_size
    r = obj.cells_at(step.q) - step.q[:2]
    change = nu - step.nu
    energy = -DT * (step.T.T @ step.F) @ nu
    for i in range(obj.n):
        v = nu[:2] + nu[2] * np.array([-r[i, 1], r[i, 0]])
        dv = change[:2] + change[2] * np.array([-r[i, 1], r[i, 0]])
        energy += m[i] / 2 * (dv @ dv + s**2 / 6 * change[2] ** 2)
        b = params.friction[i] * m[i] * 9.81 * DT
        if spin == "coupled":
            energy += b * np.sqrt(v @ v + (arm * nu[2]) ** 2)
        else:
            energy += b * np.linalg.norm(v) + (arm * b * abs(nu[2]) if spin == "separate" else 0.0)
    return energy


@pytest.mark.parametrize("spin", ["separate", "coupled", "none"])
@pytest.mark.parametrize("case", CASES)
def test_no_neighbor_of_the_isotropic_step_has_less_energy(case, spin):
    rng = np.random.default_rng(0)
    for seed in range(3):
        step = make_random_step(seed, **CASES[case])
        nu = solve_isotropic_socp(
            Model(step.obj, step.params), step.q, step.nu, step.T.T @ step.F, DT, spin=spin
        )
        best = calc_step_energy(step, nu, spin)
        scale = np.abs(step.nu).max() + np.abs(nu).max() + 1e-3
        round_off = 1e-15 * (abs(best) + step.params.total_mass * scale**2)
        for size in (1e-1, 1e-3, 1e-5, 1e-7):
            for _ in range(20):
                assert (
                    calc_step_energy(step, nu + size * scale * rng.normal(size=3), spin)
                    > best - round_off
                )


@pytest.mark.parametrize("spin", ["separate", "coupled", "none"])
def test_the_isotropic_step_balances_momentum(spin):
    for seed in range(20):
        step = make_random_step(seed, speed=2.0)
        nu = solve_isotropic_socp(
            Model(step.obj, step.params), step.q, step.nu, step.T.T @ step.F, DT, spin=spin
        )
        T, lcp = step.T, step.make_lcp()
        n, s = step.obj.n, step.obj.cell_size
        if np.abs(nu[2]) < 1e-6:
            continue  # the rotation sticks, and its moment is not determined by the motion
        after = (T @ nu).reshape(n, 3)
        impulse, b, arm = np.zeros((n, 3)), lcp.bound[:n], SPIN_LEVER_ARM * s
        speed = np.sqrt((after[:, 1:] ** 2).sum(axis=1) + (arm * nu[2]) ** 2 * (spin == "coupled"))
        impulse[:, 1:] = -(b / speed)[:, None] * after[:, 1:]
        impulse[:, 0] = {
            "separate": -arm * b * np.sign(nu[2]),
            "coupled": -(arm**2) * b / speed * nu[2],
            "none": 0,
        }[spin]
        balance = T.T @ (lcp.M * (T @ (nu - step.nu)) - DT * step.F - impulse.ravel())
        np.testing.assert_allclose(balance, 0, atol=1e-12 * step.params.total_mass)


def test_where_the_directions_keep_the_isotropic_step_is_the_lagged_one():
    """In pure translation no direction changes, so the paper's linearization is exact."""
    step = make_random_step(9)
    obj = step.obj
    params = CellParameters(step.params.mass, np.full(obj.n, 0.3))
    nu = np.array([0.3, 0.4, 0.0])
    solution = solve_as_qp(
        make_maximal_lcp(Model(obj, params), step.q, step.T @ nu, np.zeros(3 * obj.n), DT)
    )
    for spin in ("separate", "coupled", "none"):
        after = solve_isotropic_socp(Model(obj, params), step.q, nu, np.zeros(3), DT, spin=spin)
        np.testing.assert_allclose(step.T @ after, solution.xdot, atol=1e-12)


def test_the_isotropic_step_sticks_exactly_and_refuses_an_unknown_spin():
    step = make_random_step(10, speed=0.0, force=0.05)
    nu = solve_isotropic_socp(Model(step.obj, step.params), step.q, step.nu, step.T.T @ step.F, DT)
    np.testing.assert_allclose(nu, 0, atol=1e-14)
    np.testing.assert_array_equal(
        solve_isotropic_socp(Model(step.obj, step.params), step.q, np.zeros(3), np.zeros(3), DT),
        np.zeros(3),
    )
    with pytest.raises(SimulationError, match="spin"):
        solve_isotropic_socp(
            Model(step.obj, step.params), step.q, step.nu, np.zeros(3), DT, spin="both"
        )
