import numpy as np
import pytest

from gridpush_drake.dynamics.reference.maximal_lcp import make_maximal_lcp, twist_to_cells
from gridpush_drake.errors import SimulationError
from gridpush_drake.identification.model import Model
from tests.helpers.finite_difference import check_jacobian
from tests.helpers.random_objects import make_random_object
from tests.helpers.random_pushes import DT, make_random_step


def test_twist_to_cells_is_the_derivative_of_the_cells_poses():
    step = make_random_step(0)

    def cells(q):
        p = step.obj.cells_at(q)
        return np.hstack([np.full((step.obj.n, 1), q[2]), p]).ravel()

    check_jacobian(cells, step.q, step.T, step=1e-4, order=4, rtol=1e-9)


@pytest.mark.parametrize("spanning_tree", [True, False])
@pytest.mark.parametrize("seed", range(5))
def test_rigid_motions_and_no_others_satisfy_J_e(seed, spanning_tree):
    step = make_random_step(seed)
    lcp = step.make_lcp(spanning_tree=spanning_tree)
    n = step.obj.n
    pairs = n - 1 if spanning_tree else len(step.obj.adjacency)
    assert lcp.J_e.shape == (3 * pairs, 3 * n)
    np.testing.assert_allclose(lcp.J_e @ step.T, 0, atol=1e-14)
    assert np.linalg.matrix_rank(lcp.J_e.toarray()) == 3 * (n - 1)


def test_data_have_the_units_and_sizes_of_the_design():
    step = make_random_step(1)
    lcp, s, m = step.make_lcp(), step.obj.cell_size, step.params.mass
    np.testing.assert_allclose(lcp.M.reshape(-1, 3), np.stack([m * s**2 / 6, m, m], axis=1))
    b = step.params.friction * m * 9.81 * DT
    np.testing.assert_allclose(lcp.bound, np.concatenate([b, 0.38259785823210635 * s * b]))
    np.testing.assert_allclose([lcp.cell_size, *lcp.mass], [s, *m])


def test_friction_opposes_the_motion_of_every_cell():
    step = make_random_step(2)
    lcp = step.make_lcp()
    n = step.obj.n
    velocities = lcp.xdot.reshape(n, 3)
    along = lcp.J_f @ lcp.xdot
    np.testing.assert_allclose(along[:n], -np.linalg.norm(velocities[:, 1:], axis=1))
    np.testing.assert_allclose(along[n:], -np.abs(velocities[:, 0]))


def test_at_rest_friction_opposes_the_impending_rigid_motion():
    step = make_random_step(3, speed=0.0)
    lcp, n, T = step.make_lcp(), step.obj.n, step.T
    nu = np.linalg.solve(T.T @ np.diag(lcp.M) @ T, T.T @ step.F)
    assert (np.abs(step.F) > 0).sum() == 3 and n > 1
    rows = lcp.J_f.toarray()
    np.testing.assert_allclose(np.linalg.norm(rows, axis=1), 1)
    assert (rows @ T @ nu < 0).all()
    np.testing.assert_allclose(
        (rows @ T @ nu)[:n], -np.linalg.norm((T @ nu).reshape(n, 3)[:, 1:], axis=1)
    )


def test_gliding_without_turning_takes_the_sense_of_the_impending_rotation():
    step = make_random_step(4)
    object.__setattr__(step, "nu", np.array([0.1, 0.2, 0.0]))
    lcp, n, T = step.make_lcp(), step.obj.n, step.T
    w = np.linalg.solve(T.T @ np.diag(lcp.M) @ T, T.T @ step.F)[2]
    np.testing.assert_allclose(lcp.J_f.toarray()[n:, ::3], -np.sign(w) * np.eye(n))


def test_directions_are_zero_where_nothing_defines_them():
    step = make_random_step(5, speed=0.0, force=0.0)
    assert step.make_lcp().J_f.nnz == 0
    # a pure moment about the common center of mass of one cell: it turns on the spot
    obj = make_random_object(np.random.default_rng(0), 1)
    params = make_random_step(5, n=1).params
    lcp = make_maximal_lcp(Model(obj, params), np.zeros(3), np.zeros(3), np.array([1.0, 0, 0]), DT)
    np.testing.assert_allclose(lcp.J_f.toarray(), [[0, 0, 0], [-1, 0, 0]])
    assert lcp.J_e.shape == (0, 3)


def test_bad_input_is_refused():
    step = make_random_step(6)
    xdot = step.T @ step.nu
    with pytest.raises(SimulationError, match="expected"):
        make_maximal_lcp(Model(step.obj, step.params), step.q, xdot[:-1], step.F, DT)
    with pytest.raises(SimulationError, match="dt"):
        make_maximal_lcp(Model(step.obj, step.params), step.q, xdot, step.F, 0.0)
    with pytest.raises(SimulationError, match="finite"):
        make_maximal_lcp(Model(step.obj, step.params), step.q, xdot * np.nan, step.F, DT)


def test_twist_to_cells_orders_yaw_rate_first():
    obj = make_random_object(np.random.default_rng(1), 3)
    T = twist_to_cells(obj, (1.0, 2.0, 0.0))
    x, y = obj.p_BC[2]
    np.testing.assert_allclose(T[6:], [[0, 0, 1], [1, 0, -y], [0, 1, x]])
