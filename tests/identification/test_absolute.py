"""Mass, center of mass and friction in absolute numbers: gradients, exactness, and intervals that hold."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from gridpush_drake.dynamics.physics import GRAVITY
from gridpush_drake.errors import IdentificationError
from gridpush_drake.geometry.se2 import make_rotation
from gridpush_drake.identification.absolute.estimate import (
    AbsolutePrior,
    MassProblem,
    PoseNoise,
    TiltingLine,
    fit_absolute,
)
from gridpush_drake.identification.statements import describe_sources
from gridpush_drake.identification.tilt_tests.outliers import (
    estimate_absolute,
    get_support_distance,
)
from gridpush_drake.pushes.weighings import MassTestLog
from tests.helpers.finite_difference import check_jacobian
from tests.helpers.weighed_objects import CENTER, CENTER_STD, Truth, draw_truth, make_problem

TRUTH = Truth(0.68, np.array([0.03, -0.005]), 0.35)
SMALL = PoseNoise(1e-7, 1e-7, 1e-7)


@pytest.mark.parametrize("seed", range(4))
def test_derivatives_are_those_of_differences(seed):
    rng = np.random.default_rng(seed)
    problem = make_problem(draw_truth(rng), rng)
    u = problem.make_prior()[0] + 0.03 * rng.standard_normal(problem.size)
    jacobian = problem.calc_residuals(u)[1]
    check_jacobian(
        lambda u: problem.calc_residuals(u)[0], u, jacobian, step=1e-3, order=4, rtol=1e-7
    )


@pytest.mark.parametrize(
    ("headings", "lift"), [((0.3, 0.3 + np.pi, 1.9), False), ((0.3, 1.9), True)]
)
def test_without_noise_the_truth_comes_out(headings, lift):
    problem = make_problem(
        TRUTH, np.random.default_rng(1), headings, lift=lift, noise=0.0, force_std=1e-5
    )
    sure = replace(problem, noise=SMALL, force=replace(problem.force, relative_std=1e-5))
    found = estimate_absolute(sure)
    np.testing.assert_allclose(found.mean, TRUTH.unknowns, atol=2e-5)
    assert found.agreement > 0.5 and not found.contradictory


def test_one_press_gives_the_product_alone_and_two_overhangs_give_both():
    rng = np.random.default_rng(0)
    one = make_problem(TRUTH, rng, headings=(0.0,), lift=False, noise=0.0, force_std=0.02)
    one = replace(one, force=None, center_covariance=np.diag([0.03**2, 0.03**2]))
    alone = estimate_absolute(one)
    press = one.log.presses[0]

    def calc_product(center, mass):
        return mass * -(press.pose[:2] + make_rotation(press.pose[2]) @ center)[0]

    off = calc_product(alone.center_of_mass, alone.total_mass) / calc_product(
        TRUTH.center, TRUTH.mass
    )
    assert off == pytest.approx(1, abs=0.03)
    low, high = alone.mass_interval
    assert high / low > 2

    # The same object, pushed 60 mm further out.
    out = np.array([0.06, 0.0, 0.0])
    b = calc_product(TRUTH.center, 1.0) - 0.06
    assert b < 0 or b > 0.01
    further = [
        replace(each, pose=each.pose - out, force=GRAVITY * TRUTH.mass * (b + 0.12) / each.arm)
        for each in one.log.presses
    ]
    both = estimate_absolute(replace(one, log=MassTestLog((*one.log.presses, *further))))
    low, high = both.mass_interval
    assert low < TRUTH.mass < high < 1.2 * low
    assert abs(both.center_of_mass[0] - TRUTH.center[0]) < 3 * both.center_std[0] < 0.015


@pytest.mark.parametrize(
    ("headings", "presses", "lift"),
    [
        pytest.param((0.3, 0.3 + np.pi), 2, True, marks=pytest.mark.slow),
        pytest.param((0.3, 0.3 + np.pi), 2, False, marks=pytest.mark.slow),
        ((0.3, 1.9), 1, False),
        ((0.3,), 1, False),
    ],
)
def test_intervals_hold(headings, presses, lift):
    """95 % intervals hold in 88 % or more of 60 truths, and the squared distance is a chi square's."""
    rng = np.random.default_rng(7)
    inside = np.zeros(4)
    distances = []
    count = 60
    for _ in range(count):
        truth = draw_truth(rng)
        found = estimate_absolute(make_problem(truth, rng, headings, presses, lift))
        off = found.mean - truth.unknowns
        inside += np.abs(off) < 1.96 * np.sqrt(np.diag(found.covariance))
        distances.append(off @ np.linalg.solve(found.covariance, off))
    fraction = inside / count
    assert ((fraction >= 0.88) & (fraction <= 1.0)).all(), fraction
    # After one press alone, mass and center lie along a curve, which no ellipsoid follows.
    if len(headings) > 1:
        assert 3.2 < np.mean(distances) < 4.8


def test_a_slow_way_says_the_same():
    """200,000 draws from the prior, weighted by their likelihood, give the same mean and spread."""
    rng = np.random.default_rng(5)
    problem = make_problem(TRUTH, rng, (0.3, 2.0), presses=1, lift=True, force_std=0.4)
    found = estimate_absolute(problem)
    draws = 200_000
    mass, mass_std = AbsolutePrior().log_mass
    friction, friction_std = AbsolutePrior().log_friction
    # Draws about the estimate, of the prior's variance where that is small, corrected by weights.
    wide = 2.0
    std = wide * np.sqrt(np.diag(found.covariance))
    u = found.mean + std * rng.standard_normal((draws, 4))
    log_weight = 0.5 * (((u - found.mean) / std) ** 2).sum(axis=1)
    center_std = np.sqrt(np.diag(problem.center_covariance))
    expected = np.array([mass, *CENTER, friction])
    prior_std = np.array([mass_std, *center_std, friction_std])
    log_weight -= 0.5 * (((u - expected) / prior_std) ** 2).sum(axis=1)
    assert np.allclose(center_std, CENTER_STD)
    weight = GRAVITY * np.exp(u[:, 0])

    def place(pose):
        noise = PoseNoise()
        seen = pose + rng.standard_normal((draws, 3)) * (
            noise.position,
            noise.position,
            noise.angle,
        )
        cosine, sine = np.cos(seen[:, 2]), np.sin(seen[:, 2])
        x = seen[:, 0] + cosine * u[:, 1] - sine * u[:, 2]
        y = seen[:, 1] + sine * u[:, 1] + cosine * u[:, 2]
        return x, y

    places = {tuple(press.pose): place(press.pose) for press in problem.log.presses}
    for press in problem.log.presses:
        e = PoseNoise().edge * rng.standard_normal(draws)
        force = weight * (e - places[tuple(press.pose)][0]) / (press.place[0] - e)
        log_weight -= 0.5 * ((force - press.force) / press.force_std) ** 2
    for lift in problem.log.lifts:
        x, y = places[tuple(lift.pose)]
        off = [
            (weight - lift.weight) / lift.weight_std,
            (-weight * (y - lift.place[1]) - lift.torque[0]) / lift.torque_std,
            (weight * (x - lift.place[0]) - lift.torque[1]) / lift.torque_std,
        ]
        log_weight -= 0.5 * sum(each**2 for each in off)
    scale = u[:, 0] + u[:, 3] + np.log(GRAVITY)
    log_weight -= 0.5 * ((scale - np.log(problem.force.friction)) / problem.force.relative_std) ** 2
    fraction = np.exp(log_weight - log_weight.max())
    fraction /= fraction.sum()
    assert 1 / (fraction**2).sum() > 1000
    mean = fraction @ u
    spread = np.sqrt(fraction @ (u - mean) ** 2)
    laplace = np.sqrt(np.diag(found.covariance))
    assert (np.abs(mean - found.mean) < 0.15 * laplace).all()
    np.testing.assert_allclose(spread, laplace, rtol=0.07)


@pytest.mark.slow
def test_presses_of_one_rest_share_its_pose():
    """Many presses at one rest do not average out the error of the pose."""
    rng = np.random.default_rng(2)
    problem = make_problem(TRUTH, rng, headings=(0.3,), presses=20, lift=True, force_std=0.01)
    sure = estimate_absolute(problem)
    across = make_rotation(0.3)[0]
    std = np.sqrt(across @ sure.center_covariance @ across)
    assert std > 0.8 * PoseNoise().position


def test_contradictions_are_noticed():
    rng = np.random.default_rng(3)
    problem = make_problem(TRUTH, rng)
    assert not estimate_absolute(problem).contradictory
    lift = replace(problem.log.lifts[0], weight=2 * problem.log.lifts[0].weight)
    wrong = replace(problem, log=replace(problem.log, lifts=(lift,)))
    assert estimate_absolute(wrong).contradictory


def test_nothing_measured_is_refused():
    with pytest.raises(IdentificationError, match="there are none; expected at least one"):
        estimate_absolute(MassProblem(MassTestLog(), CENTER, np.eye(2)))
    with pytest.raises(IdentificationError, match="expected 0 < least < greatest"):
        AbsolutePrior(mass=(1.0, 0.5))
    with pytest.raises(IdentificationError, match=r"edge is 0\.0; expected a positive number"):
        PoseNoise(edge=0.0)


def test_sources_are_named():
    rng = np.random.default_rng(3)
    words = describe_sources(estimate_absolute(make_problem(TRUTH, rng, (0.3,), 1)))
    assert words == "1 press at the edge, 1 lift and 5 pushes with measured forces"


def _weigh_many(rng: np.random.Generator) -> MassProblem:
    """Six presses of three rests, and the forces of pushes; no lift."""
    return make_problem(TRUTH, rng, (0.3, 1.9, 4.2), presses=2, lift=False, force_std=0.05)


@pytest.mark.parametrize("seed", range(3))
def test_pushes_that_are_wrong_about_the_center_do_not_spoil_what_weighings_say(seed):
    """On feet of very different friction, the center of friction is far from that of mass."""
    problem = _weigh_many(np.random.default_rng(seed))
    wrong = replace(
        problem, center=TRUTH.center + [0.06, -0.03], center_covariance=1e-4 * np.eye(2)
    )
    spread = 0.05**2 * np.eye(2)
    assert estimate_absolute(wrong).contradictory
    found = estimate_absolute(replace(wrong, outline_center=(np.zeros(2), spread)))
    assert found.center_outlier_probability > 0.99
    assert not found.contradictory
    assert sum(one.line == TiltingLine.EDGE for one in found.tests) == 6
    off = found.mean - TRUTH.unknowns
    assert off @ np.linalg.solve(found.covariance, off) < 13.3  # 99 % of a chi square of 4
    # Pushes that are right are believed, and so are all where few weighings speak against them.
    right = replace(problem, outline_center=(np.zeros(2), spread))
    np.testing.assert_array_equal(estimate_absolute(right).mean, estimate_absolute(problem).mean)
    few = replace(wrong, log=MassTestLog(wrong.log.presses[:4]))
    doubtful = replace(few, outline_center=(np.zeros(2), spread))
    assert estimate_absolute(doubtful).center_outlier_probability == 0.0


def _spoil(problem: MassProblem, index: int, **changes: Any) -> MassProblem:
    """The same with one press changed."""
    presses = list(problem.log.presses)
    presses[index] = replace(presses[index], **changes)
    return replace(problem, log=replace(problem.log, presses=tuple(presses)))


def _press_at_supports(problem: MassProblem, index: int, inside: float) -> MassProblem:
    """The same with one press at which it truly rocked about supports, m inside the edge."""
    press = problem.log.presses[index]
    c_W = press.pose[:2] + make_rotation(press.pose[2]) @ TRUTH.center
    b = float(press.normal @ (press.edge_point - c_W))
    force = GRAVITY * TRUTH.mass * (b - inside) / (press.arm + inside)
    return _spoil(problem, index, force=force)


@pytest.mark.parametrize("seed", range(5))
def test_a_press_that_measured_the_feet_does_not_count_as_one_at_the_edge(seed):
    """With the press believed, mass and center are far off; the others say that it is wrong."""
    problem = _press_at_supports(_weigh_many(np.random.default_rng(seed)), 2, 0.03)
    believed = fit_absolute(problem)
    found = estimate_absolute(problem)
    assert found.tests[2].line != TiltingLine.EDGE
    assert found.tests[2].residual < -4
    assert sum(one.line == TiltingLine.EDGE for one in found.tests) == 5
    off = found.mean - TRUTH.unknowns
    assert off @ np.linalg.solve(found.covariance, off) < 13.3  # 99 % of a chi square of 4
    assert found.agreement > 20 * believed.agreement
    assert not found.contradictory


def test_two_presses_at_one_rest_tell_edge_and_supports_apart():
    """About the edge F a is the same for both; about supports D inside it F (a + D) is."""
    problem = _weigh_many(np.random.default_rng(3))
    a, b = problem.log.presses[:2]
    assert abs(a.arm - b.arm) > 0.01
    for index in (0, 1):
        problem = _press_at_supports(problem, index, 0.04)
    problem = replace(problem, force=None, log=MassTestLog(problem.log.presses[:2]))
    D = (b.arm * problem.log.presses[1].force - a.arm * problem.log.presses[0].force) / (
        problem.log.presses[0].force - problem.log.presses[1].force
    )
    assert pytest.approx(0.04) == D
    fits = {
        line: fit_absolute(problem.suppose((line, line)))
        for line in (TiltingLine.EDGE, TiltingLine.SUPPORTS)
    }
    assert fits[TiltingLine.SUPPORTS].loss < fits[TiltingLine.EDGE].loss - 3
    press = problem.log.presses[0]
    assert get_support_distance(fits[TiltingLine.SUPPORTS], press) == pytest.approx(0.04, rel=0.4)


def test_how_far_it_went_on_freely_tells_edge_and_supports_apart():
    """Of one press alone: rocking ends when the underside meets the edge."""
    problem = make_problem(TRUTH, np.random.default_rng(1), (0.3,), presses=1, lift=False)
    chances = []
    for way in (1e-4, 3e-3):
        found = estimate_absolute(_spoil(problem, 0, free_way=way))
        (test,) = found.tests
        assert test.line == TiltingLine.EDGE
        chances.append(test.probability)
    assert chances[0] < 0.85 < 0.95 < chances[1]


def test_a_press_that_shows_both_forces_tells_the_support_line():
    problem = _weigh_many(np.random.default_rng(4))
    rocked = _press_at_supports(problem, 1, 0.025).log.presses[1].force
    found = estimate_absolute(_spoil(problem, 1, rock_force=rocked, free_way=2e-3))
    assert found.tests[1].line == TiltingLine.EDGE
    assert found.tests[1].support_distance == pytest.approx(0.025, abs=0.005)
    assert found.tests[0].support_distance is None


def test_support_lines_have_exact_derivatives():
    lines = (TiltingLine.SUPPORTS, TiltingLine.SUPPORTS, TiltingLine.EDGE, TiltingLine.NONE)
    rng = np.random.default_rng(6)
    problem = make_problem(draw_truth(rng), rng).suppose(lines)
    assert problem.size == make_problem(draw_truth(rng), rng).size + 1
    u = problem.make_prior()[0] + 0.03 * rng.standard_normal(problem.size)
    jacobian = problem.calc_residuals(u)[1]
    check_jacobian(
        lambda u: problem.calc_residuals(u)[0], u, jacobian, step=1e-3, order=4, rtol=1e-7
    )
