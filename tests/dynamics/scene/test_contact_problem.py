"""The methods that find a step's contact forces: complementary pivoting, and the banded system."""

import numpy as np
import pytest

from gridpush_drake.dynamics.kernels.scene.complementary_pivoting import (
    make_pivoting,
    solve_complementarity,
)
from gridpush_drake.dynamics.kernels.scene.contact_system import solve_banded
from tests.helpers.scene_cases import make_row
from tests.helpers.shapes import SHAPES


def make_contact_matrix(rng, contacts, bodies):
    """The complementarity problem of contacts with Coulomb friction between random bodies."""
    D = np.zeros((2 * contacts, 2 * contacts))
    J = rng.normal(size=(2 * contacts, 3 * bodies))
    D = J @ J.T + 1e-6 * np.eye(2 * contacts)
    q = rng.normal(size=2 * contacts)
    M = np.zeros((4 * contacts, 4 * contacts))
    w = np.zeros(4 * contacts)
    for r in range(contacts):
        for s in range(contacts):
            block = D[2 * r : 2 * r + 2, 2 * s : 2 * s + 2]
            M[4 * r, 4 * s : 4 * s + 3] = block[0, 0], block[0, 1], -block[0, 1]
            M[4 * r + 1, 4 * s : 4 * s + 3] = block[1, 0], block[1, 1], -block[1, 1]
        M[4 * r + 2] = -M[4 * r + 1]
        M[4 * r + 1 : 4 * r + 3, 4 * r + 3] = 1.0
        M[4 * r + 3, 4 * r : 4 * r + 3] = rng.uniform(0, 1), -1.0, -1.0
        w[4 * r : 4 * r + 3] = q[2 * r], q[2 * r + 1], -q[2 * r + 1]
    return M, w


@pytest.mark.parametrize("contacts", [1, 3, 8])
def test_pivoting_solves_every_problem_of_contacts(contacts):
    work = make_pivoting(4 * contacts + 4)
    n = 4 * contacts
    for seed in range(40):
        # fewer degrees of freedom than contacts: forces that are not unique, and ties
        M, q = make_contact_matrix(np.random.default_rng(seed), contacts, bodies=2)
        work.table[:n, :n] = M
        work.table[:n, n] = 1.0
        work.table[:n, n + 1] = q
        assert solve_complementarity(work, n)
        z = work.z[:n]
        w = M @ z + q
        scale = 1.0 + np.abs(z).max() * np.abs(M).max()
        assert z.min() >= 0
        assert w.min() > -1e-8 * scale
        assert np.abs(z * w).max() < 1e-8 * scale**2


def test_pivoting_says_where_there_is_no_solution():
    work = make_pivoting(1)
    work.table[0] = 0.0, 1.0, -1.0
    assert not solve_complementarity(work, 1)


@pytest.mark.parametrize("band", [0, 1, 4, 30])
def test_banded_systems_are_solved(band):
    rng = np.random.default_rng(band)
    size = 25
    for _ in range(20):
        widths = rng.integers(0, band + 1, size)
        places = np.arange(size)
        # symmetric in where it is not zero, and small on the diagonal, so that rows are exchanged
        reach = np.minimum(places[:, None], places[None, :])
        far = np.abs(places[:, None] - places[None, :])
        A = rng.normal(size=(size, size)) * (far <= widths[reach])
        A[places, places] *= 1e-3
        right = np.array([np.flatnonzero(row != 0).max() for row in A])
        B = rng.normal(size=(size, 3))
        X = B.copy()
        assert solve_banded(A.copy(), X, right, size, 3)
        np.testing.assert_allclose(A @ X, B, atol=1e-9 * np.abs(X).max())


def test_a_singular_system_is_noticed():
    A = np.zeros((2, 2))
    A[0, 0] = 1.0
    assert not solve_banded(A, np.ones((2, 1)), np.array([1, 1]), 2, 1)


@pytest.mark.parametrize("seed", [10, 22, 25, 57, 66, 80])
def test_every_step_of_concave_objects_is_solved(seed):
    """Rows in which the modes went round in circles, or no active set was found."""
    shapes = np.random.default_rng(seed).permutation(list(SHAPES))[:3]
    scene, push = make_row(seed, shapes)
    motion = scene.simulate(push)
    assert motion.status == "ok"
    assert motion.residuals.max() < 1e-6
    assert motion.penetration < 1e-3
