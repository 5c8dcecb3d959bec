"""Exact gradients against central differences, and the paper's against its own LCP (issue 2, physics 3)."""

from collections import Counter

import numpy as np
import pytest

from gridpush_drake.dynamics.physics import Physics
from gridpush_drake.dynamics.push import ForcePush, Push
from gridpush_drake.dynamics.reference.maximal_lcp import make_maximal_lcp, twist_to_cells
from gridpush_drake.dynamics.reference.maximal_solvers import solve_as_qp
from gridpush_drake.dynamics.simulation import calc_step, simulate
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.parameters import CellParameters
from tests.helpers.finite_difference import check_jacobian
from tests.helpers.push_cases import check_case, make_notch_case, make_random_case
from tests.helpers.random_objects import make_random_object, make_random_pose
from tests.helpers.random_pushes import make_random_contents
from tests.helpers.shapes import SHAPES, make_shape

REGIMES = ["inertial", "quasi_static"]
SPINS = ["coupled", "separate", "none"]


def count_features(case):
    """Whether the push slides, sticks, and has two contacts at once."""
    modes = case.result.modes
    return np.array([(modes > 1).any(), (modes == 1).any(), (modes != 0).all(axis=1).any()])


@pytest.mark.parametrize("regime", REGIMES)
@pytest.mark.parametrize("shape", SHAPES)
def test_exact_gradients(shape, regime):
    features, skipped, blocks = np.zeros(3, int), 0, 0
    for seed in range(3):
        case = make_random_case(shape, seed, regime, SPINS[seed])
        assert case.result.status == "ok"
        skipped += check_case(case, shape, seed)
        features += count_features(case)
        blocks += 7
    print(
        f"{shape}, {regime}: slide, stick, two contacts in {features} of 3; {skipped} of {blocks} blocks cross a switch"
    )
    assert skipped <= blocks // 3


@pytest.mark.parametrize("regime", REGIMES)
@pytest.mark.parametrize("overhang", [None, 0.2])
def test_exact_gradients_where_loads_shift(overhang, regime):
    skipped = blocks = 0
    for seed, shape in enumerate(SHAPES):
        case = make_random_case(
            shape, seed, regime, SPINS[seed % 3], push_height=0.004, overhang=overhang
        )
        if case.result.status == "tips":
            continue
        skipped += check_case(case, shape, seed)
        blocks += 8
    print(f"overhang {overhang}, {regime}: {skipped} of {blocks} blocks cross a switch")
    assert blocks >= 40 and skipped <= blocks // 3


@pytest.mark.parametrize("overhang", [None, 0.2])
def test_derivatives_by_mass_alone_are_the_same(overhang):
    case = make_random_case(
        "wrench", 0, "quasi_static", "coupled", push_height=0.004, overhang=overhang
    )
    J, masses = case.result.jacobian, case.run(gradients="mass").jacobian
    assert masses.friction.shape == (*J.mass.shape[:2], 0)
    for name in ("mass", "contact_friction", "push_height", "start", "direction", "length", "pose"):
        np.testing.assert_allclose(getattr(masses, name), getattr(J, name), rtol=1e-9, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("regime", REGIMES)
@pytest.mark.parametrize("shape", SHAPES)
def test_exact_gradients_of_many_pushes(shape, regime):
    skipped = sum(
        check_case(make_random_case(shape, seed, regime, SPINS[seed % 3]), shape, seed)
        for seed in range(100, 110)
    )
    print(f"{shape}, {regime}: {skipped} of 70 blocks cross a switch")
    assert skipped < 18


@pytest.mark.parametrize("regime", REGIMES)
def test_exact_gradients_with_two_contacts(regime):
    """A disc that comes to lie in a V-notch, pushed askew: both contacts slide, or one of them sticks."""
    combinations = Counter()
    for seed in range(16):
        case = make_notch_case(seed, regime)
        assert check_case(case, "notched_block", seed) == 0
        modes = case.result.modes
        combinations.update(
            {tuple(sorted(row)) for row in modes[(modes != 0).all(axis=1)].tolist()}
        )
    print(f"{regime}: pairs of modes, by pushes: {dict(combinations)}")
    assert {(1, 2), (2, 2), (3, 3)} <= set(combinations)


@pytest.mark.parametrize("spin", SPINS)
def test_exact_gradients_of_force_driven_pushes(spin):
    for seed in range(6):
        rng = np.random.default_rng(seed)
        obj = make_random_object(rng, 12)
        params, pose = make_random_contents(rng, obj), make_random_pose(rng)
        weight = 9.81 * params.total_mass
        force = weight * rng.uniform(0.8, 1.5) * np.array([[1.0, 0.3], [-0.2, 0.9]])
        push = ForcePush(obj.p_BC[2], force, 0.2, t=np.array([0.0, 0.1]))
        nu = rng.normal(size=3) * (0.05, 0.05, 0.5)

        def run(mass, friction, pose, obj=obj, push=push, nu=nu, gradients=False):
            return simulate(
                Model(obj, CellParameters(mass, friction), Physics(spin=spin)),
                push,
                pose,
                velocity=nu,
                gradients=gradients,
            )

        J = run(params.mass, params.friction, pose, gradients=True).jacobian
        m, mu = params.mass, params.friction
        tolerances = {"step": 1e-4, "order": 4, "rtol": 1e-5, "atol": 1e-10}
        check_jacobian(
            lambda x, run=run, mu=mu, q=pose: run(x, mu, q).poses, m, J.mass, **tolerances
        )
        check_jacobian(
            lambda x, run=run, m=m, q=pose: run(m, x, q).poses, mu, J.friction, **tolerances
        )
        check_jacobian(
            lambda x, run=run, m=m, mu=mu: run(m, mu, x).poses, pose, J.pose, **tolerances
        )
        for block in (J.start, J.direction, J.length, J.contact_friction):
            assert not block.any()


@pytest.mark.parametrize("regime", REGIMES)
def test_contact_location_is_the_derivative_by_arc_length(regime):
    pose = (0.1, -0.2, 0.4)
    for shape in ("square", "triangle", "l_bracket", "claw_hammer"):
        obj = make_shape(shape, 20)
        params = make_random_contents(np.random.default_rng(1), obj)
        for fraction in (0.1, 0.37, 0.8):
            where = np.array(fraction * obj.edges.perimeter)

            def run(s, obj=obj, params=params, gradients=False):
                push = Push.on_outline(
                    obj, float(s), 0.2, 0.03, radius=0.004, speed=0.05, pose=pose, clearance=1e-4
                )
                return simulate(Model(obj, params), push, pose, regime=regime, gradients=gradients)

            result = run(where, gradients=True)
            modes = result.modes
            if any((run(where * (1 + h)).modes != modes).any() for h in (-2e-5, 2e-5)):
                continue
            check_jacobian(
                lambda s: run(s).poses, where, result.jacobian.contact_location, step=1e-5, order=4, rtol=1e-5,
                atol=1e-8,
            )  # fmt: skip


def test_recorded_rows_are_those_of_the_whole_jacobian():
    case = make_random_case("l_bracket", 3, "inertial", "coupled")
    push = Push.along(case.t, case.path, case.radius)
    some = simulate(
        Model(case.obj, case.params),
        push,
        case.pose,
        gradients=True,
        record=[30, 7],
        **case.options,
    ).jacobian
    np.testing.assert_array_equal(some.steps, [30, 7])
    for name in ("mass", "friction", "contact_friction", "start", "direction", "length", "pose"):
        np.testing.assert_array_equal(
            getattr(some, name), getattr(case.result.jacobian, name)[[30, 7]]
        )


def make_paper_case(seed):
    rng = np.random.default_rng(seed)
    obj = make_random_object(rng, 10)
    params, pose = make_random_contents(rng, obj), make_random_pose(rng)
    nu = np.array([0.4, -0.3, 2.0]) * rng.uniform(0.8, 1.2, 3)
    weight = 9.81 * params.total_mass
    push = ForcePush(obj.p_BC[3], weight * rng.uniform(-0.4, 0.4, 2), 0.05)
    return obj, params, pose, nu, push


@pytest.mark.parametrize("seed", range(2))
def test_paper_gradient_is_that_of_the_one_step_lcp(seed):
    """Each step by itself: differences of the maximal LCP's velocities, and of the condensed step's, times dt."""
    obj, params, pose, nu, push = make_paper_case(seed)
    dt = 0.01
    lagged = Physics(friction_law="lagged")
    result = simulate(Model(obj, params, lagged), push, pose, dt, "paper", velocity=nu)
    J = result.jacobian
    assert not J.mass[0].any()
    m, mu = params.mass, params.friction
    for t in (0, 1, 4):
        q, nu_t = result.poses[t], result.velocities[t]
        T = twist_to_cells(obj, q)
        c, s = np.cos(q[2]), np.sin(q[2])
        arm, force = np.array([[c, -s], [s, c]]) @ push.point, push.force[0]
        wrench = np.array([*force, arm[0] * force[1] - arm[1] * force[0]])
        F = np.zeros(3 * obj.n)
        F[9:12] = [0.0, *force]  # on the fourth cell

        def condensed(mass, friction, q=q, nu_t=nu_t, wrench=wrench):
            return dt * calc_step(
                Model(obj, CellParameters(mass, friction), lagged), q, nu_t, wrench, dt
            )

        def maximal(mass, friction, q=q, nu_t=nu_t, F=F, T=T):
            lcp = make_maximal_lcp(Model(obj, CellParameters(mass, friction)), q, T @ nu_t, F, dt)
            return dt * np.linalg.lstsq(T, solve_as_qp(lcp).xdot)[0]

        for step in (condensed, maximal):
            check_jacobian(
                lambda x, f=step: f(x, mu), m, J.mass[t + 1], step=1e-3, order=4, rtol=1e-6
            )
            check_jacobian(
                lambda x, f=step: f(m, x), mu, J.friction[t + 1], step=1e-3, order=4, rtol=1e-6
            )


def test_paper_gradient_of_a_push_is_one_step_s_and_misses_what_accumulates():
    """The first step from rest agrees with the exact Jacobian's order of size; later ones do not carry on from it."""
    obj = make_shape("square", 25)
    params = make_random_contents(np.random.default_rng(0), obj)
    push = Push((-0.06, 0.02), (0.1, 0.0), 1.0, 0.005)
    paper = simulate(Model(obj, params), push, gradients="paper").jacobian
    exact = simulate(Model(obj, params), push, gradients=True, regime="inertial").jacobian
    assert np.abs(paper.friction[-1]).max() < 0.1 * np.abs(exact.friction[-1]).max()
    for block in (paper.start, paper.pose, paper.contact_friction, paper.length, paper.direction):
        assert not block.any()
    some = simulate(Model(obj, params), push, gradients="paper", record=[50, 0, 20]).jacobian
    np.testing.assert_array_equal(some.mass, paper.mass[[50, 0, 20]])


@pytest.mark.parametrize("spin", SPINS)
def test_paper_gradient_of_the_midpoint_step_with_isotropic_friction(spin):
    """A spinning, sliding body's step is differentiated in the frame that the step itself used."""
    obj, params, pose, nu, push = make_paper_case(5)
    dt = 1e-4  # so short that the friction's direction before the step is that within it
    options = {"velocity": nu, "record": [1]}
    model = Model(obj, params, Physics(spin=spin))
    result = simulate(model, push, pose, dt, "paper", **options)
    exact = simulate(model, push, pose, dt, True, **options)
    for name in ("mass", "friction"):
        one, other = getattr(result.jacobian, name)[0], getattr(exact.jacobian, name)[0]
        np.testing.assert_allclose(one, other, rtol=0, atol=3e-3 * np.abs(other).max())
