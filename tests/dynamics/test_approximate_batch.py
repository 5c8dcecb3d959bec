"""Approximate batches: pooled cells and unchecked Newton steps, against the exact simulation."""

from dataclasses import replace

import numpy as np
import pytest

from gridpush_drake.dynamics.cell_pooling import POOLED_FROM, CellPooling
from gridpush_drake.dynamics.kernels.friction.isotropic_friction import add_isotropic
from gridpush_drake.dynamics.kernels.friction.pooled_loads import Pool, gather_points
from gridpush_drake.dynamics.physics import QUASI_STATIC, Physics
from gridpush_drake.dynamics.push import make_path_times
from gridpush_drake.dynamics.push_batch import BatchPush, PushBatch
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import find_shipped_object, list_shipped_objects
from gridpush_drake.objects.parameters import CellParameters
from tests.helpers.finite_difference import check_jacobian
from tests.helpers.random_pushes import make_random_push

POSITION_BOUND = 1e-5
"""Greatest error of a final position, m: what the theory page states."""

ANGLE_BOUND = np.radians(0.005)
"""Greatest error of a final heading, rad: what the theory page states."""

EPS = 1e-9
KAPPA = 2e-4
STILL = np.zeros(3)


def make_square(cells: int) -> GridObject:
    return GridObject.from_outline([[0, 0], [0.2, 0], [0.2, 0.2], [0, 0.2]], max_cells=cells)


def make_map(rng: np.random.Generator, obj: GridObject) -> CellParameters:
    """Loads of four kinds: rough from cell to cell, in two parts, smooth, and on three feet."""
    p = (obj.p_BC - obj.p_BC.mean(axis=0)) / obj.radius_of_gyration
    kind = rng.integers(4)
    if kind == 0:
        mass = np.exp(rng.normal(size=obj.n))
    elif kind == 1:
        mass = np.where(p @ rng.normal(size=2) > 0.5, 10.0, 1.0)
    elif kind == 2:
        mass = np.exp(p @ rng.normal(size=2))
    else:
        mass = np.full(obj.n, 1e-3)
        mass[rng.integers(obj.n, size=3)] = 1.0
    friction = np.full(obj.n, 0.4)
    ratio = rng.choice([1.0, obj.n**-0.5])
    return CellParameters(
        mass / mass.sum(), friction, rng.uniform(0.1, 0.6), patch_ratio=float(ratio)
    )


def make_pushes(rng: np.random.Generator, obj: GridObject, count: int) -> list[BatchPush]:
    pushes = []
    for _ in range(count):
        push = make_random_push(rng, obj, length=rng.uniform(0.03, 0.1))
        times = make_path_times(push, "quasi_static")
        pushes.append(BatchPush(push, STILL, times, np.array([len(times) - 1]), None))
    return pushes


def measure_errors(obj: GridObject, params: CellParameters, pushes: list[BatchPush]) -> np.ndarray:
    """How far approximate final poses are off, (P, 2), m and rad."""
    exact, _ = PushBatch(obj, pushes, QUASI_STATIC).simulate(params)
    found, _ = PushBatch(obj, pushes, QUASI_STATIC, approximate=True).simulate(params)
    off = found - exact
    return np.column_stack([np.hypot(off[:, 0], off[:, 1]), np.abs(off[:, 2])])


def make_pool(seed: int, obj: GridObject) -> tuple[Pool, np.ndarray]:
    k = np.exp(np.random.default_rng(seed).normal(size=obj.n))
    return CellPooling.of_object(obj).make_pool(k / k.sum()), k / k.sum()


def calc_pooled(pool: Pool, xi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    count = gather_points(pool, xi)
    x, y, k = pool.points[:, :count]
    g = np.zeros(3)
    H = np.zeros((3, 3))
    add_isotropic(x, y, k, KAPPA**2, 0.0, EPS, xi, False, g, H)
    return g, H


def calc_gradient(obj: GridObject, k: np.ndarray, xi: np.ndarray) -> np.ndarray:
    """The equation at the head of `isotropic_friction`, in NumPy, over all cells."""
    x, y = obj.p_BC.T
    v = np.array([xi[0] - xi[2] * y, xi[1] + xi[2] * x])
    s = np.sqrt((v**2).sum(axis=0) + (KAPPA * xi[2]) ** 2 + EPS**2)
    a = np.array([v[0], v[1], x * v[1] - y * v[0] + KAPPA**2 * xi[2]])
    return a @ (k / s)


def make_twists(count: int) -> list[np.ndarray]:
    """Twists about centers within the square and around it, the last one a translation."""
    rng = np.random.default_rng(3)
    centers = rng.uniform(-0.05, 0.25, (count, 2))
    return [np.array([y, -x, 1.0]) for x, y in centers] + [np.array([1.0, 0.3, 0.0])]


def test_points_bear_the_wrench_of_all_cells() -> None:
    obj = make_square(4900)
    pool, k = make_pool(0, obj)
    counts = []
    for xi in make_twists(60):
        pool.last[:] = 0.0
        g, _ = calc_pooled(pool, xi)
        counts.append(gather_points(pool, xi))
        arm = np.array([1.0, 1.0, obj.radius_of_gyration])
        np.testing.assert_allclose(g / arm, calc_gradient(obj, k, xi) / arm, atol=5e-6)
        assert pool.points[2, : counts[-1]].sum() == pytest.approx(k.sum())
    assert np.mean(counts) < obj.n / 3
    assert counts[-1] == 25  # a translation has no center: the whole object is one box


def test_the_hessian_is_the_gradient_s_while_the_points_are_the_same() -> None:
    obj = make_square(2500)
    pool, _ = make_pool(1, obj)
    for xi in make_twists(5):
        _, H = calc_pooled(pool, xi)
        check_jacobian(lambda x: calc_pooled(pool, x)[0], xi, H, step=1e-5, order=4)


def test_a_lattice_of_any_shape_is_pooled() -> None:
    ring = GridObject.from_outline(
        [[0, 0], [0.3, 0], [0.3, 0.04], [0.04, 0.04], [0.04, 0.2], [0, 0.2]], max_cells=1500
    )
    pool, k = make_pool(2, ring)
    np.testing.assert_allclose(np.sort(pool.cells[2]), np.sort(k))
    for xi in make_twists(10):
        pool.last[:] = 0.0
        np.testing.assert_allclose(calc_pooled(pool, xi)[0], calc_gradient(ring, k, xi), atol=5e-6)


def test_few_cells_are_not_pooled_and_many_are() -> None:
    rng = np.random.default_rng(0)
    for obj in (make_square(400), make_square(POOLED_FROM + 600)):
        errors = measure_errors(obj, make_map(rng, obj), make_pushes(rng, obj, 10))
        assert errors.max() > 0.0  # approximate indeed
        assert (errors < [POSITION_BOUND, ANGLE_BOUND]).all()
        assert ("_cell_pooling" in obj.__dict__) == (obj.n >= POOLED_FROM)


def test_an_approximate_push_is_the_same_in_any_batch_bit_for_bit() -> None:
    rng = np.random.default_rng(1)
    obj = make_square(1600)
    params = make_map(rng, obj)
    pushes = make_pushes(rng, obj, 5)
    together, _ = PushBatch(obj, pushes, QUASI_STATIC, approximate=True).simulate(params)
    backwards, _ = PushBatch(obj, pushes[::-1], QUASI_STATIC, approximate=True).simulate(params)
    assert np.array_equal(together, backwards[::-1])


def test_derivatives_of_an_approximate_batch_are_exact() -> None:
    rng = np.random.default_rng(2)
    obj = make_square(100)
    params = make_map(rng, obj)
    pushes = make_pushes(rng, obj, 2)
    exact = PushBatch(obj, pushes, QUASI_STATIC).differentiate(params)
    found = PushBatch(obj, pushes, QUASI_STATIC, approximate=True).differentiate(params)
    for a, b in zip(exact, found, strict=True):
        assert np.array_equal(a, b)


@pytest.mark.parametrize("regime", ["quasi_static", "inertial"])
def test_loads_that_shift_and_the_inertial_regime_are_approximated_too(regime: str) -> None:
    rng = np.random.default_rng(4)
    obj = make_square(POOLED_FROM + 200)
    params = replace(CellParameters.uniform(obj), push_height=0.01)
    physics = Physics(regime=regime)
    push = make_random_push(rng, obj, length=0.04, speeds=(0.1,))
    times = make_path_times(push, regime)
    one = BatchPush(push, STILL, times, np.array([len(times) - 1]), None)
    (end,), _ = PushBatch(obj, [one], physics, approximate=True).simulate(params)
    exact = simulate(Model(obj, params, physics), push, times=times).final_pose
    assert np.hypot(*(end - exact)[:2]) < POSITION_BOUND
    assert abs(end[2] - exact[2]) < ANGLE_BOUND


@pytest.mark.parametrize("cells", [None, 1500])
def test_shipped_objects_end_where_they_do_exactly(cells: int | None) -> None:
    check_shipped_objects(cells, count=2)


@pytest.mark.slow
@pytest.mark.parametrize("cells", [None, 5000])
def test_hundreds_of_pushes_of_shipped_objects_end_where_they_do_exactly(
    cells: int | None,
) -> None:
    check_shipped_objects(cells, count=90)


def check_shipped_objects(cells: int | None, count: int) -> None:
    """Compares pushes of every shipped object, as it is or in as many cells."""
    rng = np.random.default_rng(5)
    errors = []
    # Into many cells it takes a second to divide an object.
    names = list_shipped_objects()
    for name in names if cells is None else names[::3]:
        obj = GridObject.from_yaml(find_shipped_object(name))
        if cells is not None:
            obj = GridObject.from_outline(obj.outline, max_cells=cells, name=name)
        for some in np.array_split(np.arange(count), min(count, 8)):
            pushes = make_pushes(rng, obj, len(some))
            errors.append(measure_errors(obj, make_map(rng, obj), pushes))
    off = np.concatenate(errors) / [POSITION_BOUND, ANGLE_BOUND]
    assert off.max() < 1.0, np.sort(off, axis=0)[-5:]
