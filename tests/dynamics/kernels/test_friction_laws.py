"""Every law of support friction that is registered: its derivatives are those of its dissipation."""

import numba
import numpy as np
import pytest

from gridpush_drake.dynamics.kernels.friction import laws as friction
from gridpush_drake.dynamics.kernels.friction.laws import FRICTION_LAWS
from gridpush_drake.dynamics.physics import Physics
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import SimulationError
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.parameters import CellParameters
from tests.helpers.finite_difference import check_jacobian
from tests.helpers.random_objects import make_random_object
from tests.helpers.shapes import make_shape

EPS, ARM, CELL_SIZE = 1e-3, 0.004, 0.01
HAT, PUSH = np.array([0.02, -0.01, 0.3]), np.array([0.1, 0.2, -1.0])
CASES = [(name, spin) for name, law in FRICTION_LAWS.items() for spin in law.spin_models]


@numba.njit
def begin(law, cells, known):
    friction.begin_step(law, cells, 0.001, -0.002, CELL_SIZE, HAT, PUSH, known)


@numba.njit
def calc_dissipation(law, cells, xi):
    return friction.calc_dissipation(law, cells, EPS, xi)


@numba.njit
def add_derivatives(law, cells, xi, majorize, g, H):
    friction.add_derivatives(law, cells, EPS, xi, majorize, g, H)


@numba.njit
def can_majorize(law):
    return friction.can_majorize(law)


@numba.njit
def fill_load_derivatives(law, cells, xi, f):
    friction.fill_load_derivatives(law, cells, EPS, xi, f)


class Case:
    """A law of random cells at a random twist, with all that it says, as plain functions."""

    def __init__(self, name, spin, seed, known):
        rng = np.random.default_rng(seed)
        self.make = lambda k: FRICTION_LAWS[name].make(np.array(k), ARM, spin)
        self.known = known
        self.cells = np.array(make_random_object(rng, 12, CELL_SIZE).p_BC.T, order="C")
        self.k = rng.uniform(0.1, 1.0, 12)
        self.xi = rng.normal(size=3) * (0.01, 0.01, 0.2)

    def begin(self, k):
        law = self.make(k)
        begin(law, self.cells, self.known)
        return law

    def dissipation(self, xi, k=None):
        return calc_dissipation(self.begin(self.k if k is None else k), self.cells, np.array(xi))

    def derivatives(self, xi, k=None, majorize=False):
        g, H = np.zeros(3), np.zeros((3, 3))
        add_derivatives(
            self.begin(self.k if k is None else k), self.cells, np.array(xi), majorize, g, H
        )
        return g, H

    def load_derivatives(self):
        f = np.zeros((3, len(self.k) + 2))
        fill_load_derivatives(self.begin(self.k), self.cells, self.xi, f)
        return f


@pytest.mark.parametrize("known", [False, True])
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("name", "spin"), CASES)
def test_derivatives_are_the_dissipation_s(name, spin, seed, known):
    case = Case(name, spin, seed, known)
    g, H = case.derivatives(case.xi)
    check_jacobian(case.dissipation, case.xi, g, step=1e-4, order=4)
    check_jacobian(lambda xi: case.derivatives(xi)[0], case.xi, H, step=1e-4, order=4)
    f = case.load_derivatives()
    check_jacobian(
        lambda k: case.derivatives(case.xi, k)[0], case.k, f[:, : len(case.k)], step=1e-3
    )
    assert not f[:, len(case.k) :].any()
    np.testing.assert_array_equal(H, H.T)
    assert np.linalg.eigvalsh(H).min() > -1e-12 * np.abs(H).max(), "convex"


@pytest.mark.parametrize("known", [False, True])
@pytest.mark.parametrize(("name", "spin"), CASES)
def test_dissipation_is_convex_and_the_majorizing_hessian_is_no_flatter(name, spin, known):
    case, rng = Case(name, spin, 7, known), np.random.default_rng(8)
    _, H = case.derivatives(case.xi)
    if can_majorize(case.begin(case.k)):
        _, above = case.derivatives(case.xi, majorize=True)
        assert np.linalg.eigvalsh(above - H).min() > -1e-12 * np.abs(H).max()
    for _ in range(20):
        xi, other = (rng.normal(size=3) * (0.01, 0.01, 0.2) for _ in range(2))
        middle = case.dissipation((xi + other) / 2)
        assert middle <= (case.dissipation(xi) + case.dissipation(other)) / 2 + 1e-12


@pytest.mark.parametrize("regime", ["inertial", "quasi_static"])
@pytest.mark.parametrize("name", list(FRICTION_LAWS))
def test_a_push_is_simulated_with_every_law_or_refused(name, regime):
    obj = make_shape("square", 16)
    params, push = CellParameters.uniform(obj, 1.0, 0.3), Push((-0.07, 0.01), (0.1, 0.0), 0.5, 0.01)
    if regime not in FRICTION_LAWS[name].regimes:
        with pytest.raises(SimulationError, match=name):
            simulate(Model(obj, params, Physics(name, regime)), push)
        return
    motion = simulate(Model(obj, params, Physics(name, regime)), push)
    assert motion.status == "ok"
    assert motion.final_pose[0] > 0.01
    if True not in FRICTION_LAWS[name].gradients:
        with pytest.raises(SimulationError, match=name):
            simulate(Model(obj, params, Physics(name, regime)), push, gradients=True)
        return
    record = [len(motion.times) - 1]
    J = simulate(
        Model(obj, params, Physics(name, regime)), push, gradients=True, record=record
    ).jacobian

    def move(mu):
        moved = CellParameters(params.mass, mu, params.contact_friction)
        return simulate(Model(obj, moved, Physics(name, regime)), push).final_pose

    check_jacobian(move, params.friction, J.friction[0], step=1e-4, order=4, rtol=1e-5, atol=1e-8)
