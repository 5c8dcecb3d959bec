import numpy as np
import pytest

from gridpush_drake.dynamics.physics import QUASI_STATIC
from gridpush_drake.identification.baselines.methods import (
    CmaEs,
    FiniteDifference,
    NelderMead,
    RandomSearch,
    WeightedSampling,
)
from gridpush_drake.identification.baselines.search import Bounds, SearchStatus, run_search
from tests.helpers.made_logs import make_pushed_block

BLOCK = make_pushed_block()
BOUNDS = Bounds((0.005, 0.5), (0.1, 0.8))
SEARCHES = [RandomSearch(), WeightedSampling(), FiniteDifference(), CmaEs(), NelderMead()]
RANDOM = SEARCHES[:4]


def run(search, evaluations=40, seed=0, bounds=BOUNDS, extra=0, **options):
    budget = evaluations * len(BLOCK.log) + extra
    return run_search(
        search, BLOCK.obj, BLOCK.log, BLOCK.start, bounds, budget=budget, seed=seed, **options
    )


@pytest.mark.parametrize("search", SEARCHES)
def test_spends_its_budget_and_no_more(search):
    result = run(search, evaluations=40, extra=len(BLOCK.log) - 1)
    assert result.simulations == 40 * len(BLOCK.log)
    assert result.status == SearchStatus.BUDGET_SPENT
    assert [entry.simulations for entry in result.history] == [3 * (i + 1) for i in range(40)]


@pytest.mark.parametrize("search", SEARCHES)
def test_is_reproducible(search):
    first, second = run(search), run(search)
    np.testing.assert_array_equal(first.params.mass, second.params.mass)
    np.testing.assert_array_equal(first.params.friction, second.params.friction)
    assert first.history == second.history


@pytest.mark.parametrize("search", RANDOM)
def test_depends_on_the_seed(search):
    assert run(search, seed=0).history != run(search, seed=1).history


@pytest.mark.parametrize("search", SEARCHES)
def test_leaves_the_global_generator_alone(search):
    before = np.random.get_state()[1].copy()  # noqa: NPY002 - that is what must not move
    run(search, evaluations=15)
    np.testing.assert_array_equal(before, np.random.get_state()[1])  # noqa: NPY002


@pytest.mark.parametrize("search", SEARCHES)
def test_stays_within_the_bounds_and_never_gets_worse(search):
    result = run(search)
    assert (BOUNDS.mass[0] * (1 - 1e-12) <= result.params.mass).all()
    assert (result.params.mass <= BOUNDS.mass[1] * (1 + 1e-12)).all()
    assert (BOUNDS.friction[0] * (1 - 1e-12) <= result.params.friction).all()
    assert (result.params.friction <= BOUNDS.friction[1] * (1 + 1e-12)).all()
    losses = [entry.loss for entry in result.history]
    assert (np.diff(losses) <= 0).all()
    assert result.params.contact_friction == BLOCK.start.contact_friction


@pytest.mark.parametrize("search", SEARCHES)
def test_learns(search):
    result = run(search, evaluations=150, bounds=Bounds(BOUNDS.mass, (0.4, 0.4)))
    assert result.history[-1].loss < 0.7 * result.history[0].loss
    assert (result.params.friction == 0.4).all()


def test_quasi_static_too():
    assert run(RandomSearch(), physics=QUASI_STATIC).history != run(RandomSearch()).history


def test_tells_its_progress():
    told = []
    result = run(WeightedSampling(), evaluations=15, progress=told.append)
    assert tuple(told) == result.history
    assert {entry.stage for entry in told} == {"start", "uniform", "normal"}


def test_finite_differences_stall():
    slim = Bounds((BLOCK.start.mass[0], BLOCK.start.mass[0] * 1.0001), (0.4, 0.4))
    assert run(FiniteDifference(), evaluations=2000, bounds=slim).status == SearchStatus.STALLED
