"""One contact, solved in closed form, against the whole system of equations."""

import numpy as np
import pytest

from gridpush_drake.dynamics.kernels.contact.contact import CONTACT_COLUMNS, CX, CY, GAP, NX, NY
from gridpush_drake.dynamics.kernels.contact.contact_modes import (
    SEPARATE,
    SLIDE_PLUS,
    STICK,
    Scales,
    Touch,
    Unknowns,
    build_contact_system,
    solve_modes,
)
from gridpush_drake.dynamics.kernels.friction.isotropic_friction import add_isotropic
from gridpush_drake.dynamics.kernels.integrate_pose import calc_turn

DT = 0.01


def draw_problem(rng):
    """A linearized step of random cells and a random contact, at a twist that the pusher causes."""
    px, py = rng.uniform(-0.1, 0.1, (2, 30))
    k = rng.dirichlet(np.ones(30))
    angle = rng.uniform(-np.pi, np.pi)
    normal = np.array([np.cos(angle), np.sin(angle)])
    contacts = np.zeros((2, CONTACT_COLUMNS))
    contacts[0, [NX, NY]] = normal
    contacts[0, [CX, CY]] = -0.1 * normal + rng.uniform(-0.03, 0.03, 2)
    contacts[0, GAP] = rng.uniform(-1e-4, 1e-4)
    slant = rng.uniform(-1.2, 1.2)
    vp = np.cos(slant) * normal + np.sin(slant) * np.array([-normal[1], normal[0]])
    touch = Touch(contacts, 1, float(vp[0]), float(vp[1]), rng.uniform(0.05, 0.8), DT)
    # a Newton step from a twist near the pusher's; H is singular but for the smoothing there
    xi = np.array([*vp, rng.normal(0.0, 5.0)]) * rng.uniform(0.5, 1.0)
    g = np.zeros(3)
    H = np.zeros((3, 3))
    add_isotropic(px, py, k, 1e-6, 0.0, 1e-7, xi, False, g, H)
    return H, H @ xi - g, touch


def solve_whole_system(H, rhs, touch, mode):
    """Solves [[H, -E], [C, 0]] (xi, lam) = (rhs, what the pusher asks for) by LAPACK."""
    K = np.zeros((7, 7))
    size = build_contact_system(H, touch, np.array([mode, SEPARATE]), 0.0, K)
    nx, ny = touch.contacts[0, [NX, NY]]
    asked = [nx * touch.vpx + ny * touch.vpy - touch.contacts[0, GAP] / DT]
    if mode == STICK:
        asked.append(nx * touch.vpy - ny * touch.vpx)
    # rows and columns are of very different sizes
    matrix = K[:size, :size]
    scale = 1.0 / np.abs(matrix).max(1)
    solution = np.linalg.solve(scale[:, None] * matrix, scale * np.array([*rhs, *asked]))
    if mode == STICK:
        return solution[:3], solution[3:5]
    slope = touch.mu if mode == SLIDE_PLUS else -touch.mu
    return solution[:3], solution[3] * np.array([1.0, slope])


def test_a_contact_that_sticks_or_slides_is_solved_as_by_elimination():
    rng = np.random.default_rng(0)
    seen = []
    for _ in range(400):
        H, rhs, touch = draw_problem(rng)
        unknowns = Unknowns(np.zeros(3), np.zeros((2, 2)), np.zeros(2, np.int64))
        unknowns.modes[0] = rng.integers(4)
        scales = Scales(0.05, 1.0, 2.0)
        K, X = np.zeros((2, 7, 7))
        worst = solve_modes(H, rhs, touch, scales, 0.0, K, X, unknowns)
        mode = unknowns.modes[0]
        seen.append(mode)
        if mode == SEPARATE:
            continue
        assert worst <= 1e-9
        xi, lam = solve_whole_system(H, rhs, touch, mode)
        assert unknowns.xi == pytest.approx(xi, rel=1e-8, abs=1e-9)
        assert unknowns.lam[0] == pytest.approx(lam, rel=1e-8, abs=1e-9)
        assert not unknowns.lam[1].any()
    # every mode of contact came up
    assert {1, 2, 3} <= set(seen)


def test_the_series_of_a_turn_are_exact_to_rounding():
    for angle in (0.0, 1e-9, -0.003, 0.02, -0.0499999, 0.05, 0.3, -3.0):
        c, s = calc_turn(angle)
        assert c == pytest.approx(np.cos(angle), rel=3e-16, abs=0.0)
        assert s == pytest.approx(np.sin(angle), rel=3e-16, abs=0.0)
