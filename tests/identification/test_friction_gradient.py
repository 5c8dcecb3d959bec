"""The change of friction along an object: its derivatives, its draws, and what weighings leave."""

from dataclasses import replace

import numpy as np
import pytest

from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.spread import predict_spread
from gridpush_drake.identification.statistics.center_of_mass import CenterOfMass
from gridpush_drake.identification.statistics.friction_gradient import (
    FRICTION_GRADIENT,
    calc_arms,
    calc_gradient_std,
    draw_gradients,
)
from gridpush_drake.identification.statistics.problem import PushProblem
from gridpush_drake.identification.tilt_tests.weighed_model import estimate_masses, hold_friction
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.pushes.weighings import LiftTest, MassTestLog
from tests.helpers.finite_difference import check_jacobian
from tests.helpers.shapes import make_shape
from tests.identification.simulated_pokes import make_pokes
from tests.identification.test_held_friction import TABLE, make_half_rough, push_at_edge

GRADIENT = slice(5, 7)
"""Columns of the inputs that are derivatives by the gradient."""


@pytest.mark.parametrize("name", ["l_bracket", "claw_hammer"])
def test_residuals_are_differentiated_by_the_gradient_with_the_loads_held(name):
    obj, truth = make_half_rough(name)
    log = push_at_edge(obj, truth, 2, 3)
    arms = calc_arms(obj)

    def calc_residuals(g):
        friction = truth.friction * np.exp(arms @ g)
        changed = replace(truth, friction=friction, mass=truth.mass * truth.friction / friction)
        problem = PushProblem(obj, log, changed)
        return np.concatenate(problem.residuals(problem.unknowns(changed)))

    problem = PushProblem(obj, log, truth)
    linear = problem.linearize(problem.unknowns(truth))
    J = np.concatenate(linear.by_inputs)[:, GRADIENT]
    assert np.abs(J).max() > 1e-3
    check_jacobian(calc_residuals, np.zeros(2), J, step=1e-4, rtol=1e-4, order=4)


def test_away_from_the_edge_nothing_depends_on_it():
    obj, truth = make_half_rough("l_bracket")
    pokes = make_pokes(obj, truth, 2, 0)
    problem = PushProblem(obj, pokes, truth)
    assert problem.linearize(problem.unknowns(truth)).by_inputs[0].shape[1] == 5
    # A table whose edge comes near in one push only: the others do not depend on it.
    one = push_at_edge(obj, truth, 1, 3)
    both = PushLog((*(replace(p, pose=p.pose) for p in pokes), *one), table=TABLE.corners)
    inputs = PushProblem(obj, both, truth).linearize(problem.unknowns(truth)).by_inputs
    assert [np.abs(one[:, GRADIENT]).max() > 0 for one in inputs] == [False, False, True]


def test_draws_keep_loads_and_mass_and_move_the_center_of_mass():
    obj, truth = make_half_rough("claw_hammer")
    drawn = draw_gradients(obj, [truth] * 200, 0.3, 1)
    loads = np.array([one.mass * one.friction for one in drawn])
    np.testing.assert_allclose(loads, np.tile(truth.mass * truth.friction, (200, 1)), rtol=1e-12)
    np.testing.assert_allclose([one.total_mass for one in drawn], truth.total_mass, rtol=1e-12)
    centers = np.array([one.center_of_mass(obj) for one in drawn])
    # To first order the center of mass moves by the spread of the masses times g / rho.
    arm = obj.p_BC - truth.center_of_mass(obj)
    M = (truth.mass[:, None] * arm).T @ arm / truth.total_mass / obj.radius_of_gyration
    np.testing.assert_allclose(np.cov(centers.T), 0.3**2 * M @ M, atol=0.2 * 0.3**2 * M.max() ** 2)
    assert draw_gradients(obj, [truth], 0.0, 1) == [truth]


def test_its_spread_follows_from_what_is_told():
    obj = make_shape("l_bracket", 30)
    close = replace(obj.prior, friction_min=0.3, friction_max=0.4)
    assert calc_gradient_std(close) == pytest.approx(np.log(4 / 3) / np.sqrt(12))
    wide = replace(obj.prior, friction_min=0.1, friction_max=0.9)
    assert calc_gradient_std(wide) == FRICTION_GRADIENT
    told = replace(wide, center_of_mass=(0.0, 0.0), center_of_mass_std=0.002)
    assert CenterOfMass.of_prior(told) is not None
    assert calc_gradient_std(told) == 0


def test_over_the_edge_less_is_known_of_a_push_until_the_object_is_weighed():
    obj, truth = make_half_rough("claw_hammer")
    obj = replace(obj, prior=replace(obj.prior, friction_min=0.1, friction_max=0.9))
    found = identify(Model(obj), make_pokes(obj, truth, 4, 0, noise=(5e-4, 3e-3)))
    assert found.noise.friction_gradient == FRICTION_GRADIENT
    even = replace(found, noise=replace(found.noise, friction_gradient=0.0))
    on_table = make_pokes(obj, truth, 2, 9)
    at_edge = push_at_edge(obj, truth, 4, 3)

    def calc_widest(model, log):
        return max(one.cell_error for one in predict_spread(model, log))

    assert calc_widest(found, on_table) == calc_widest(even, on_table)
    assert calc_widest(found, at_edge) > 1.2 * calc_widest(even, at_edge)

    # A lift tells mass and center of mass.
    center = truth.center_of_mass(obj)
    weight = 9.81 * truth.total_mass
    pads = np.array([0.0, 0.0])
    torque = weight * np.array([-(center - pads)[1], (center - pads)[0]])
    lift = LiftTest(np.zeros(3), pads, weight, torque, weight_std=0.05, torque_std=0.001)
    weighed = estimate_masses(found, MassTestLog(lifts=(lift,)))
    assert weighed.noise.friction_gradient < 0.2 * FRICTION_GRADIENT
    held = hold_friction(weighed)
    again = identify(Model(obj), make_pokes(obj, truth, 4, 0, noise=(5e-4, 3e-3)), friction=held)
    assert again.noise.friction_gradient == held.gradient_std
    assert calc_widest(weighed, at_edge) < calc_widest(found, at_edge)
