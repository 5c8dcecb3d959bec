from dataclasses import replace

import numpy as np
import pytest

from gridpush_drake.dynamics.motion import Jacobian
from gridpush_drake.dynamics.physics import QUASI_STATIC, Physics
from gridpush_drake.identification.baselines.paper import (
    PAPER_PHYSICS,
    PaperDescent,
    calc_paper_gradient_of_loss,
)
from gridpush_drake.identification.baselines.search import (
    Bounds,
    CellLoss,
    SearchStatus,
    run_search,
)
from tests.helpers.finite_difference import calc_finite_difference, check_jacobian
from tests.helpers.made_logs import make_pushed_block

BLOCK = make_pushed_block(max_cells=18)
INERTIAL = Physics(regime="inertial")
BOUNDS = Bounds((0.002, 0.2), (0.1, 0.8))


def make_loss(budget=10**6, physics=INERTIAL):
    return CellLoss(BLOCK.obj, BLOCK.log, BLOCK.start, budget=budget, physics=physics)


def run(evaluations, **options):
    options = {"bounds": BOUNDS, "budget": evaluations * len(BLOCK.log)} | options
    return run_search(PaperDescent(), BLOCK.obj, BLOCK.log, BLOCK.start, **options)


def with_jacobian(simulation, mass):
    steps, n = len(simulation.poses), BLOCK.obj.n
    zero = np.zeros((steps, 3))
    jacobian = Jacobian(
        np.arange(steps), mass, np.zeros((steps, 3, n)), zero, np.zeros((steps, 3, 2)), zero, zero,
        np.zeros((steps, 3, 3)),
    )  # fmt: skip
    return replace(simulation, _jacobian=jacobian)


def calc_moved_loss(loss, simulations, shift, first):
    """The loss when all poses from step `first` on are moved."""
    moved = []
    for simulation in simulations:
        poses = simulation.poses.copy()
        poses[first:] += shift
        moved.append(replace(simulation, poses=poses))
    return np.mean([np.linalg.norm(miss, axis=-1).mean() for miss in loss.misses(moved)])


@pytest.mark.parametrize("first", [1, 55, 100])
def test_a_step_answers_for_all_poses_after_it(first):
    loss = make_loss()
    _, simulations = loss.evaluate(BLOCK.start, "here")
    mass = np.zeros((len(simulations[0].poses), 3, BLOCK.obj.n))
    mass[first, :, :3] = np.eye(3)
    gradient = calc_paper_gradient_of_loss(
        loss, [with_jacobian(simulation, mass) for simulation in simulations]
    )
    check_jacobian(
        lambda shift: calc_moved_loss(loss, simulations, shift, first),
        np.zeros(3),
        gradient["mass"][:3],
        atol=1e-7,
    )


def test_gradient_points_as_the_exact_one_does():
    loss = make_loss()
    paper = make_loss(physics=PAPER_PHYSICS)
    _, simulations = paper.evaluate(BLOCK.start, "here", gradients="paper")
    gradient = calc_paper_gradient_of_loss(paper, simulations)
    for block in ("mass", "friction"):
        exact = calc_finite_difference(
            lambda values, block=block: loss(replace(BLOCK.start, **{block: values}), "difference"),
            getattr(BLOCK.start, block),
            step=1e-4,
        )
        cosine = gradient[block] @ exact / np.linalg.norm(gradient[block]) / np.linalg.norm(exact)
        assert cosine > 0.8


def test_learns_within_few_steps():
    result = run(evaluations=30)
    assert result.history[-1].loss < 0.25 * result.history[0].loss
    heavy = BLOCK.obj.labels == 2
    k = result.params.relative_friction()
    assert k[heavy].mean() > 1.5 * k[~heavy].mean()


def test_spends_no_more_than_the_budget():
    result = run(evaluations=4, budget=4 * len(BLOCK.log) + 1)
    assert result.simulations == 4 * len(BLOCK.log)
    assert result.status == SearchStatus.BUDGET_SPENT
    assert [entry.stage for entry in result.history] == [
        "start", "descent in mass", "descent in friction", "descent in mass",
    ]  # fmt: skip


def test_stays_within_the_bounds():
    slim = Bounds((0.04, 0.06), (0.35, 0.45))
    result = run(evaluations=20, bounds=slim)
    assert (result.params.mass >= 0.04).all()
    assert (result.params.mass <= 0.06).all()
    assert (result.params.friction >= 0.35).all()
    assert (result.params.friction <= 0.45).all()


def test_equal_bounds_hold_the_friction():
    result = run(evaluations=6, bounds=Bounds(BOUNDS.mass, (0.4, 0.4)))
    assert (result.params.friction == 0.4).all()
    assert {entry.stage for entry in result.history} == {"start", "descent in mass"}


def test_neither_seed_nor_regime_matters():
    first, second = run(evaluations=6, seed=0), run(evaluations=6, seed=5, physics=QUASI_STATIC)
    np.testing.assert_array_equal(first.params.mass, second.params.mass)
    assert first.history == second.history
