"""What the cells bear, against slow independent ways to say it, against statics, and where no loads exist."""

import numpy as np
import pytest
from scipy.optimize import minimize

from gridpush_drake.dynamics.kernel_call import make_support
from gridpush_drake.dynamics.kernels.step_start import make_state
from gridpush_drake.dynamics.kernels.support_loads import find_loads, make_loads
from gridpush_drake.dynamics.push import ForcePush, Push
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import ParameterError, SimulationError
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.support_surface import SupportSurface
from tests.helpers.push_cases import make_random_case, make_table_edge
from tests.helpers.shapes import make_shape

GRAVITY = 9.81


def run_kernel_loads(obj, params, friction, table=None, pose=(0.0, 0.0, 0.0)):
    """The kernel's loads, N, at a pose, with a friction F (2,) of the step before; None where the object tips."""
    edges = None if table is None else np.column_stack([table, np.roll(table, -1, axis=0)])
    support = make_support(Model(obj, params), edges)
    loads, k = make_loads(support), np.empty(obj.n)
    loads.friction[:] = friction
    state = make_state(np.array(pose), np.zeros(3), 0.0, 0.0)
    held = find_loads(support, np.array(obj.p_BC.T, order="C"), obj.cell_size, state, loads, k)
    np.testing.assert_allclose(
        k, params.friction * params.mass * loads.fraction * params.total_mass * GRAVITY, rtol=1e-12
    )
    return params.total_mass * GRAVITY * params.mass * loads.fraction if held else None


@pytest.mark.parametrize("shape", ["square", "l_bracket", "claw_hammer"])
@pytest.mark.parametrize("overhang", [0.0, 0.15])
def test_loads_are_the_nearest_in_equilibrium(shape, overhang):
    """The problem of least relative entropy itself, by a general optimizer."""
    rng = np.random.default_rng(7)
    obj = make_shape(shape, 60)
    params = CellParameters(
        rng.uniform(0.01, 0.03, obj.n), rng.uniform(0.2, 0.5, obj.n), push_height=0.006
    )
    weight = params.total_mass * GRAVITY
    friction = 0.3 * weight * np.array([0.6, -0.8])
    table = make_table_edge(obj, (0.0, 0.0, 0.0), 2.5, overhang) if overhang else None
    depth = (
        np.full(obj.n, np.inf)
        if table is None
        else SupportSurface.from_polygon(table).signed_distances(obj.p_BC)
    )
    at_rest = params.mass * np.clip(0.5 + depth / obj.cell_size, 0.0, 1.0)
    held = at_rest > 0
    at_rest, p = at_rest[held] / at_rest.sum(), obj.p_BC[held] / obj.cell_size
    center = (params.center_of_mass(obj) + params.push_height * friction / weight) / obj.cell_size
    nearest = minimize(
        lambda x: (x * np.log(x / at_rest)).sum(),
        at_rest,
        jac=lambda x: np.log(x / at_rest) + 1,
        constraints=[{"type": "eq", "fun": lambda x: [x.sum() - 1, *(x @ p - center)]}],
        bounds=[(1e-9, 1.0)] * len(at_rest),
        method="SLSQP",
        options={"ftol": 1e-14, "maxiter": 500},
    )
    assert nearest.success
    loads = run_kernel_loads(obj, params, friction, table)
    assert not loads[~held].any()
    np.testing.assert_allclose(loads[held] / weight, nearest.x, rtol=0.01, atol=1e-5)


def test_three_feet_bear_what_statics_says():
    """Where nearly all loads are on three cells, equilibrium alone determines them."""
    obj = make_shape("square", 100)
    feet = [0, 9, 94]
    mass = np.full(obj.n, 1e-9)
    mass[feet] = [0.2, 0.3, 0.25]
    params = CellParameters(mass, np.full(obj.n, 0.3), push_height=0.02)
    weight = params.total_mass * GRAVITY
    friction = 0.3 * weight * np.array([0.8, 0.6])
    loads = run_kernel_loads(obj, params, friction)
    center = params.center_of_mass(obj) + params.push_height * friction / weight
    statics = np.linalg.solve(
        np.vstack([obj.p_BC[feet].T, np.ones(3)]), [*(weight * center), weight]
    )
    np.testing.assert_allclose(loads[feet], statics, rtol=1e-3)


def test_nothing_shifts_without_friction_or_edge():
    rng = np.random.default_rng(0)
    obj = make_shape("wrench", 40)
    params = CellParameters(
        rng.uniform(0.01, 0.03, obj.n), rng.uniform(0.2, 0.5, obj.n), push_height=0.01
    )
    np.testing.assert_allclose(
        run_kernel_loads(obj, params, (0.0, 0.0)), params.mass * GRAVITY, rtol=1e-12
    )
    wide = SupportSurface.rectangle((0.0, 0.0), (4.0, 4.0)).corners
    push = Push.on_outline(obj, 0.05, 0.2, 0.03, radius=0.005, speed=0.05)
    bare = CellParameters(params.mass, params.friction)
    np.testing.assert_allclose(
        simulate(Model(obj, bare), push, table=wide).poses,
        simulate(Model(obj, bare), push).poses,
        atol=1e-12,
    )


@pytest.mark.parametrize("regime", ["inertial", "quasi_static"])
def test_a_higher_pusher_moves_the_load_forward(regime):
    """Pushed through its center, an even square's load moves by h mu along the push; it goes straight all the same."""
    obj = make_shape("square", 100)
    params = CellParameters(np.full(obj.n, 0.01), np.full(obj.n, 0.35), 0.3, push_height=0.015)
    start = np.array([obj.p_BC[:, 0].min() - obj.cell_size / 2 - 0.005, 0.0])
    motion = simulate(Model(obj, params), Push(start, (0.03, 0.0), 1.0, 0.005), regime=regime)
    ahead = motion.load_centers[-1] - motion.poses[-2, :2]
    np.testing.assert_allclose(ahead, [0.35 * 0.015, 0.0], atol=2e-5)
    assert abs(motion.final_pose[2]) < 1e-6


def test_the_lagged_friction_errs_in_proportion_to_the_step():
    case = make_random_case("wrench", 1, "quasi_static", "coupled", push_height=0.005, overhang=0.2)
    push = Push.along(case.t, case.path, case.radius)
    ends = [
        simulate(
            Model(case.obj, case.params),
            push,
            case.pose,
            **{**case.options, "times": np.linspace(0, push.duration, n + 1)},
        ).final_pose
        for n in (60, 120, 240, 960)
    ]
    errors = [np.abs(end - ends[-1]).max() for end in ends[:-1]]
    assert errors[0] < 5e-4 and errors[1] < 0.7 * errors[0] and errors[2] < 0.6 * errors[1]


@pytest.mark.parametrize("inside, status", [(0.0005, "ok"), (-0.0005, "tips")])
def test_tips_when_the_center_of_mass_passes_the_edge(inside, status):
    obj = make_shape("bar", 60)
    params = CellParameters.uniform(obj)
    center = params.center_of_mass(obj)
    table = SupportSurface.rectangle((center[0] + inside - 1.0, 0.0), (2.0, 2.0)).corners
    rest = ForcePush((0.0, 0.0), (0.0, 0.0), 0.1)
    assert simulate(Model(obj, params), rest, table=table).status == status


@pytest.mark.parametrize("fraction, status", [(0.9, "ok"), (1.1, "tips")])
def test_tips_over_its_own_edge_when_pushed_high(fraction, status):
    obj = make_shape("square", 100)
    half = obj.p_BC[:, 0].max() + obj.cell_size / 2
    params = CellParameters(
        np.full(obj.n, 0.01), np.full(obj.n, 0.5), 0.3, push_height=fraction * half / 0.5
    )
    motion = simulate(
        Model(obj, params),
        Push((-half - 0.005, 0.0), (0.02, 0.0), 0.5, 0.005),
        regime="quasi_static",
    )
    assert motion.status == status


@pytest.mark.parametrize("regime", ["inertial", "quasi_static"])
def test_a_pusher_high_above_the_object_tips_it_and_nothing_overflows(regime):
    """The center that the loads would need is many lengths beyond the object."""
    obj = make_shape("claw_hammer", 60)
    params = CellParameters(
        np.full(obj.n, 0.01), np.full(obj.n, 0.9), 0.5, push_height=8 * np.ptp(obj.p_BC[:, 0])
    )
    push = Push.on_outline(obj, 0.02, 0.2, 0.05, radius=0.008, speed=0.3)
    motion = simulate(Model(obj, params), push, regime=regime, gradients=True)
    assert motion.status == "tips"
    assert np.isfinite(motion.poses).all() and np.isfinite(motion.contact_forces).all()


def test_refuses_what_makes_no_sense():
    obj = make_shape("square", 16)
    params = CellParameters.uniform(obj)
    push = Push((-0.1, 0.0), (0.05, 0.0), 0.5, 0.005)
    far = SupportSurface.rectangle((5.0, 0.0), (1.0, 1.0)).corners
    with pytest.raises(SimulationError, match=r"no cell of .* is on it at the pose"):
        simulate(Model(obj, params), push, table=far)
    with pytest.raises(SimulationError, match="corners of shape"):
        simulate(Model(obj, params), push, table=[(0, 0), (1, 0)])
    with pytest.raises(ParameterError, match="push_height is -1"):
        CellParameters(params.mass, params.friction, push_height=-1.0)
    with pytest.raises(SimulationError, match="knows no shifting loads"):
        simulate(
            Model(obj, params),
            push,
            table=SupportSurface.rectangle((0, 0), (1, 1)).corners,
            gradients="paper",
        )


def test_an_endless_table_is_the_paper_s_model():
    obj = make_shape("l_bracket", 40)
    params = CellParameters.uniform(obj)
    motion = simulate(
        Model(obj, params), Push.on_outline(obj, 0.03, 0.1, 0.03, radius=0.005, speed=0.05)
    )
    assert np.isnan(motion.load_centers).all()
