"""The condensed step against its references (issue 2, physics 1): the paper's LCP, its QP, and the cone program."""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.solvers import MathematicalProgram, MobyLcpSolver

from gridpush_drake.dynamics.physics import Physics
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.reference.isotropic_socp import solve_isotropic_socp
from gridpush_drake.dynamics.reference.maximal_solvers import solve_as_lcp, solve_as_qp
from gridpush_drake.dynamics.simulation import calc_step, simulate
from gridpush_drake.errors import SimulationError
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.parameters import CellParameters
from tests.helpers.random_pushes import DT, make_random_step
from tests.helpers.shapes import make_shape

AGREEMENT = 1e-8
"""m/s, of every cell's velocity, and of its spin times the cell's side."""

CASES = {
    "fast": {"speed": 3.0},
    "moving": {},
    "slow": {"speed": 0.05},
    "stops": {"speed": 0.02, "force": 0.5},
    "rest, far below the limit": {"speed": 0.0, "force": 0.05},
    "rest, near the limit": {"speed": 0.0, "force": 0.6},
    "rest, above the limit": {"speed": 0.0, "force": 1.5},
}


def solve_moby(M, q):
    program = MathematicalProgram()
    z = program.NewContinuousVariables(len(q))
    program.AddLinearComplementarityConstraint(M, q, z)
    result = MobyLcpSolver().Solve(program)
    assert result.is_success()
    return result.GetSolution(z)


def calc_disagreement(step, nu, xdot):
    """Greatest difference between the cells' velocities by the twist nu and xdot (3n,), m/s."""
    difference = (step.T @ nu - xdot).reshape(-1, 3)
    return np.abs(difference * [step.obj.cell_size, 1.0, 1.0]).max()


def take_step(step, **physics):
    wrench = step.T.T @ step.F
    return calc_step(Model(step.obj, step.params, Physics(**physics)), step.q, step.nu, wrench, DT)


def make_steps(case, count=20):
    for seed in range(count):
        step = make_random_step(
            seed, n=int(np.random.default_rng(seed).integers(1, 41)), **CASES[case]
        )
        yield replace(step, params=replace(step.params, patch_ratio=(1.0, 0.1, 0.0)[seed % 3]))


@pytest.mark.parametrize("case", CASES)
def test_lagged_step_is_the_paper_s_lcp(case):
    worst, residual, rests, partial = 0.0, 0.0, 0, 0
    for step in make_steps(case):
        solution = solve_as_qp(step.make_lcp())
        worst = max(
            worst, calc_disagreement(step, take_step(step, friction_law="lagged"), solution.xdot)
        )
        residual = max(residual, solution.residuals.worst)
        sticks = (solution.lam_f > 0) & (solution.lam_f < (1 - 1e-9) * step.make_lcp().bound)
        rests += np.abs(solution.xdot).max() < 1e-9
        partial += bool(sticks.any() and np.abs(solution.xdot).max() > 1e-6)
    print(
        f"{case}: cells' velocities within {worst:.1e} m/s, KKT residual of the QP {residual:.1e}",
        end="; ",
    )
    print(f"{rests} stay at rest, {partial} stick in part")
    assert worst < AGREEMENT
    assert residual < 1e-11


@pytest.mark.parametrize("case", CASES)
def test_moby_s_lcp_agrees_with_the_qp_and_the_condensed_step(case):
    worst, residual = 0.0, 0.0
    for step in make_steps(case, 8):
        lcp = step.make_lcp()
        solution = solve_as_lcp(lcp, solve_moby)
        residual = max(residual, solution.residuals.worst)
        for xdot in (solve_as_qp(lcp).xdot, step.T @ take_step(step, friction_law="lagged")):
            scaled = ((xdot - solution.xdot).reshape(-1, 3) * [step.obj.cell_size, 1, 1]).ravel()
            worst = max(worst, np.abs(scaled).max())
    print(f"{case}: Moby within {worst:.1e} m/s, KKT residual {residual:.1e}")
    assert worst < AGREEMENT
    assert residual < 1e-7


@pytest.mark.parametrize("spin", ["coupled", "separate", "none"])
@pytest.mark.parametrize("case", CASES)
def test_isotropic_step_is_the_cone_program_s(case, spin):
    worst = 0.0
    for step in make_steps(case):
        nu = solve_isotropic_socp(
            Model(step.obj, step.params), step.q, step.nu, step.T.T @ step.F, DT, spin=spin
        )
        worst = max(worst, calc_disagreement(step, take_step(step, spin=spin), step.T @ nu))
    print(f"{case}, {spin}: within {worst:.1e} m/s")
    assert worst < AGREEMENT


def test_the_cases_cover_what_they_say():
    counts = {}
    for case in CASES:
        rest = [np.abs(take_step(step)).max() < 1e-7 for step in make_steps(case, 20)]
        counts[case] = sum(rest)
    assert counts["fast"] == counts["moving"] == counts["rest, above the limit"] == 0
    assert counts["rest, far below the limit"] == 20
    assert 0 < counts["rest, near the limit"] + counts["stops"] < 40


def test_a_pure_moment_turns_a_body_about_its_center_of_mass_where_it_is_the_center_of_friction():
    obj = make_shape("square", 25)
    params = CellParameters.uniform(obj, total_mass=1.0, friction=0.3)
    nu = calc_step(Model(obj, params), (0.1, 0.2, 0.3), np.zeros(3), (0.0, 0.0, 2.0), DT)
    np.testing.assert_allclose(nu[:2], 0, atol=1e-12)
    assert nu[2] > 0.1


def test_quasi_static_push_is_the_limit_of_slow_inertial_ones():
    """Inertia's share is of order v²/(mu g L): the poses approach as v², and at 1 mm/s the steps' error is left."""
    for shape in ("square", "l_bracket", "claw_hammer"):
        obj = make_shape(shape, 40)
        rng = np.random.default_rng(3)
        params = CellParameters(rng.uniform(0.01, 0.05, obj.n), rng.uniform(0.2, 0.5, obj.n), 0.3)
        distances = []
        for speed in (0.1, 0.01, 0.001):
            push = Push.on_outline(obj, 0.03, 0.2, 0.05, radius=0.005, speed=speed)
            times = np.linspace(0, push.duration, 801)
            limit = simulate(
                Model(obj, params), push, times=times, regime="quasi_static"
            ).final_pose
            pose = simulate(Model(obj, params), push, times=times, regime="inertial").final_pose
            distances.append(
                np.linalg.norm(obj.cells_at(pose) - obj.cells_at(limit), axis=1).mean()
            )
        print(shape, distances)
        assert distances[0] > 1e-6
        assert distances[1] < 0.03 * distances[0]
        assert distances[2] < 2e-7


def test_bad_input_is_refused():
    step = make_random_step(0)
    for options in ({"friction_law": "dry"}, {"regime": "quasi_static"}, {"spin": "both"}):
        with pytest.raises(SimulationError, match=next(iter(options))):
            take_step(step, **options)
    with pytest.raises(SimulationError, match="dt"):
        calc_step(Model(step.obj, step.params), step.q, step.nu, np.zeros(3), 0.0)
