import numpy as np
import pytest

from gridpush_drake.dynamics.physics import Physics
from gridpush_drake.errors import IdentificationError
from gridpush_drake.identification.baselines.search import (
    MASS_SPREAD,
    Bounds,
    CellLoss,
    LossSearch,
    SearchStatus,
    SearchStopped,
    run_search,
)
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.prediction import calc_pose_error, predict
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.pushes.push_log import ObservedPush, PushLog
from tests.helpers.made_logs import make_pushed_block

BLOCK = make_pushed_block()
BOUNDS = Bounds((0.005, 0.5), (0.1, 0.8))
INERTIAL = Physics(regime="inertial")


@pytest.mark.parametrize("mass", [(0.0, 1.0), (2.0, 1.0), (0.1, np.inf)])
def test_refuses_ranges_that_are_none(mass):
    with pytest.raises(IdentificationError, match=r"bounds\.mass"):
        Bounds(mass, (0.1, 1.0))


def test_bounds_around_a_start():
    start = BLOCK.start
    bounds = Bounds.around(BLOCK.obj, start)
    assert bounds.mass[1] / bounds.mass[0] == pytest.approx(MASS_SPREAD)
    assert np.sqrt(np.prod(bounds.mass)) == pytest.approx(start.mass[0])
    assert bounds.friction == (BLOCK.obj.prior.friction_min, BLOCK.obj.prior.friction_max)


def test_clips_to_bounds():
    n = BLOCK.obj.n
    clipped = BOUNDS.clip(CellParameters(np.full(n, 9.0), np.full(n, 0.01), 0.3))
    assert (clipped.mass == 0.5).all()
    assert (clipped.friction == 0.1).all()
    assert clipped.contact_friction == 0.3


def make_loss(budget=10**6, **options):
    return CellLoss(BLOCK.obj, BLOCK.log, BLOCK.start, budget=budget, physics=INERTIAL, **options)


def test_loss_is_the_mean_cell_distance_over_observed_times():
    params = CellParameters.random(BLOCK.obj, seed=3, mass_range=(0.01, 0.2), by="cell")
    means = [
        np.mean(
            [
                calc_pose_error(BLOCK.obj, at, seen).cell
                for at, seen in zip(made.at_observations, push.poses_observed, strict=True)
            ]
        )
        for made, push in zip(
            predict(Model(BLOCK.obj, params), BLOCK.log, "inertial"), BLOCK.log, strict=True
        )
    ]
    assert make_loss()(params, "here") == pytest.approx(np.mean(means), rel=1e-9)


class KnownTruth:
    """A method that knows the answer."""

    physics = INERTIAL

    def run(self, search):
        search.loss(BLOCK.truth, "truth")
        return SearchStatus.STALLED


def test_truth_converges_at_once():
    result = run_search(KnownTruth(), BLOCK.obj, BLOCK.log, BLOCK.start, BOUNDS, budget=10**6)
    assert result.status == SearchStatus.CONVERGED
    assert result.params is BLOCK.truth
    assert result.simulations == len(BLOCK.log)
    assert result.history[-1].loss < 1e-9


def test_spends_no_more_than_the_budget():
    loss = make_loss(budget=3 * len(BLOCK.log) + 2)
    for _ in range(3):
        loss(BLOCK.start, "again")
    with pytest.raises(SearchStopped) as stop:
        loss(BLOCK.start, "once more")
    assert stop.value.status == SearchStatus.BUDGET_SPENT
    assert loss.simulations == 3 * len(BLOCK.log)
    assert 0 < loss.spent < 1


def test_keeps_the_best_and_tells_of_each_evaluation():
    told = []
    loss = make_loss(progress=told.append)
    worse = CellParameters(BLOCK.truth.mass[::-1], BLOCK.truth.friction)
    start = BLOCK.start
    first = loss(start, "start")
    assert loss(worse, "worse") > first
    assert loss.best is start
    assert [entry.loss for entry in loss.history] == [first, first]
    assert [entry.simulations for entry in loss.history] == [3, 6]
    assert [entry.stage for entry in loss.history] == ["start", "worse"]
    assert told == loss.history


@pytest.mark.parametrize(("pushes", "budget"), [(3, 2), (0, 100)])
def test_refuses_a_budget_that_does_not_reach(pushes, budget):
    with pytest.raises(IdentificationError, match="budget"):
        CellLoss(BLOCK.obj, BLOCK.log[:pushes], BLOCK.start, budget=budget)


def test_refuses_a_push_without_observation():
    seen = BLOCK.log[0]
    blind = ObservedPush("blind", seen.push, seen.pose, np.empty(0), np.empty((0, 3)))
    with pytest.raises(IdentificationError, match="blind"):
        CellLoss(BLOCK.obj, PushLog((blind,)), BLOCK.start, budget=10)


def test_cube_is_logarithmic_between_the_bounds():
    search = LossSearch(make_loss(), BLOCK.start, BOUNDS, seed=0)
    n = BLOCK.obj.n
    assert search.start.shape == (2 * n,)
    back = search.params(search.start)
    np.testing.assert_allclose(back.mass, BLOCK.start.mass)
    np.testing.assert_allclose(back.friction, BLOCK.start.friction)
    middle = search.params(np.full(2 * n, 0.5))
    np.testing.assert_allclose(middle.mass, np.sqrt(0.005 * 0.5))
    outside = search.params(np.full(2 * n, 7.0))
    np.testing.assert_allclose(outside.friction, 0.8)


def test_equal_bounds_hold_a_parameter():
    search = LossSearch(make_loss(), BLOCK.start, Bounds((0.005, 0.5), (0.4, 0.4)), seed=0)
    assert search.start.shape == (BLOCK.obj.n,)
    assert (search.params(np.zeros(BLOCK.obj.n)).friction == 0.4).all()


def test_begins_within_the_bounds():
    heavy = CellParameters(np.full(BLOCK.obj.n, 9.0), np.full(BLOCK.obj.n, 0.4))
    search = LossSearch(make_loss(), heavy, BOUNDS, seed=0)
    np.testing.assert_allclose(search.params(search.start).mass, 0.5)
