"""Bodies that slide by themselves, and frames (issue 2, physics 2 and 4): each against its textbook result."""

import numpy as np
import pytest
from shapely import Polygon
from shapely.affinity import translate

from gridpush_drake.dynamics.physics import Physics
from gridpush_drake.dynamics.push import ForcePush, Push
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from tests.helpers.random_objects import make_random_object, make_random_pose
from tests.helpers.random_pushes import make_random_contents, make_random_push
from tests.helpers.shapes import SHAPES, make_shape, rectangle, regular_polygon

G = 9.81
NO_PUSH = {"point": (0.0, 0.0), "force": (0.0, 0.0)}


def slide(obj, params, nu, duration, dt, pose=(0.0, 0.0, 0.0), physics=None, **options):
    return simulate(
        Model(obj, params, physics),
        ForcePush(**NO_PUSH, duration=duration),
        pose,
        dt,
        velocity=nu,
        **options,
    )


def make_disc(max_cells=1200, radius=0.05):
    return GridObject.from_outline(regular_polygon(radius, 360), max_cells=max_cells, name="disc")


@pytest.mark.parametrize(
    "outline", [regular_polygon(0.05), rectangle(0.1, 0.1)], ids=["disc", "square"]
)
def test_sliding_body_stops_after_v2_over_2_mu_g(outline):
    """Coulomb: the deceleration is mu g, so the way is v²/(2 mu g), in any direction, whatever the shape.

    The implicit step loses v dt/2 of it, a fraction of mu g dt/v; with steps of 0.2 ms that is 0.08 %.
    """
    obj = GridObject.from_outline(outline, max_cells=60)
    v, mu = 1.0, 0.4
    expected = v**2 / (2 * mu * G)
    params = CellParameters.uniform(obj, total_mass=0.7, friction=mu)
    errors = []
    for dt in (8e-4, 4e-4, 2e-4):
        ways = []
        for angle in (0.0, 0.3, 1.0, np.pi / 4):
            result = slide(obj, params, (v * np.cos(angle), v * np.sin(angle), 0.0), 0.4, dt)
            assert np.abs(result.velocities[-1]).max() < 1e-8
            assert abs(result.final_pose[2]) < 1e-9
            ways.append(np.linalg.norm(result.final_pose[:2]))
        np.testing.assert_allclose(ways, ways[0], rtol=1e-9)
        errors.append(ways[0] / expected - 1)
    print(f"relative errors of the way {errors}")
    assert abs(errors[-1]) < 1e-3
    np.testing.assert_allclose(np.array(errors[:-1]) / errors[1:], 2.0, rtol=0.01)
    np.testing.assert_allclose(errors, -mu * G * np.array([8e-4, 4e-4, 2e-4]) / v, rtol=0.01)


def test_spinning_disc_stops_after_3_R_w2_over_8_mu_g():
    """A uniform disc's friction moment is the integral of mu g sigma r, 2/3 mu m g R, and its inertia m R²/2.

    So it slows by 4 mu g/(3 R) and stops after w²/(2 alpha) = 3 R w²/(8 mu g), without moving.
    """
    radius, mu, w = 0.05, 0.3, 10.0
    expected = 3 * radius * w**2 / (8 * mu * G)
    errors = []
    for cells in (80, 300, 1200):
        obj = make_disc(cells, radius)
        params = CellParameters.uniform(obj, total_mass=0.5, friction=mu)
        result = slide(obj, params, (0.0, 0.0, w), 0.3, 5e-5)
        assert np.abs(result.velocities[-1]).max() < 1e-6
        np.testing.assert_allclose(result.final_pose[:2], 0, atol=1e-6)
        errors.append(result.final_pose[2] / expected - 1)
    print(f"relative errors of the angle with 80, 300, 1200 cells: {errors}")
    assert np.abs(errors).max() < 5e-3
    assert abs(errors[-1]) < 1e-3


def test_direction_of_sliding_changes_nothing_for_a_spinning_disc():
    """Isotropy: the grid's axes must not show. 90° is a symmetry of the grid; other angles differ by its resolution."""
    obj = make_disc(1200)
    params = CellParameters.uniform(obj, total_mass=0.5, friction=0.3)
    ends = []
    for angle in np.array([0, 90, 20, 45, 70]) * np.pi / 180:
        result = slide(obj, params, (0.5 * np.cos(angle), 0.5 * np.sin(angle), 8.0), 0.4, 1e-3)
        c, s = np.cos(angle), np.sin(angle)
        x, y, theta = result.final_pose
        ends.append([c * x + s * y, -s * x + c * y, theta])
    ends = np.array(ends)
    print(ends)
    np.testing.assert_allclose(ends[1], ends[0], atol=1e-9)
    way = np.linalg.norm(ends[0, :2])
    assert np.abs(ends[:, :2] - ends[0, :2]).max() < 1e-3 * way
    assert np.abs(ends[:, 2] - ends[0, 2]).max() < 1e-3 * ends[0, 2]


def test_free_body_without_friction_keeps_its_momentum():
    rng = np.random.default_rng(0)
    obj = make_random_object(rng, 12)
    params = CellParameters(rng.uniform(0.01, 0.2, 12), np.zeros(12))
    nu, pose = np.array([0.3, -0.2, 4.0]), (0.1, 0.2, 0.3)
    result = slide(obj, params, nu, 2.0, 0.01, pose)
    com = params.mass @ obj.cells_at(result.poses) / params.total_mass
    arm = com[0] - pose[:2]
    v_com = nu[:2] + nu[2] * np.array([-arm[1], arm[0]])
    np.testing.assert_allclose(result.velocities[:, 2], nu[2], rtol=1e-12)
    np.testing.assert_allclose(com, com[0] + np.outer(result.times, v_com), atol=1e-12)
    np.testing.assert_allclose(result.poses[:, 2], pose[2] + nu[2] * result.times, rtol=1e-12)


def calc_energy(obj, params, result):
    """Kinetic energy at every step, J."""
    com = params.mass @ obj.cells_at(result.poses) / params.total_mass
    v, w, arm = result.velocities[:, :2], result.velocities[:, 2], com - result.poses[:, :2]
    v_com = v + w[:, None] * np.stack([-arm[:, 1], arm[:, 0]], axis=1)
    return params.total_mass / 2 * (v_com**2).sum(axis=1) + params.inertia(obj) / 2 * w**2


@pytest.mark.parametrize("spin", ["coupled", "separate", "none"])
@pytest.mark.parametrize("law", ["isotropic", "lagged"])
def test_energy_never_rises_without_a_push(law, spin):
    """The implicit step minimizes a convex function of which dissipation is a part.

    With lagged directions a body at rest trembles at some 1e-7 m/s: the ramp's tail magnifies the
    stiction tolerance.
    """
    for seed in range(20):
        rng = np.random.default_rng(seed)
        obj = make_random_object(rng, int(rng.integers(1, 30)))
        params = make_random_contents(rng, obj)
        nu = rng.normal(size=3) * (0.3, 0.3, 5.0)
        result = slide(
            obj,
            params,
            nu,
            1.0,
            0.005,
            make_random_pose(rng),
            physics=Physics(friction_law=law, spin=spin),
        )
        energy = calc_energy(obj, params, result)
        assert result.status == "ok"
        tremble = params.total_mass * 1e-12 if law == "lagged" else 0.0
        assert np.diff(energy).max() <= 1e-15 * energy[0] + tremble
        assert spin == "none" or energy[-1] < 1e-9 * energy[0]


@pytest.mark.parametrize("fraction, moves", [(0.99, False), (1.01, True)])
def test_below_the_static_limit_a_body_does_not_creep(fraction, moves):
    """Coulomb: at rest up to mu m g, or up to the moment of all cells' friction. Ten seconds at 99 % of either."""
    obj = make_shape("square", 100)
    params = CellParameters.uniform(obj, total_mass=1.2, friction=0.35)
    limit = 0.35 * 1.2 * G
    push = ForcePush((0.0, 0.0), (0.6 * fraction * limit, 0.8 * fraction * limit), 10.0)
    result = simulate(Model(obj, params), push, (0.1, 0.2, 0.3))
    way = np.abs(obj.cells_at(result.poses) - obj.cells_at(result.poses[0])).max()
    print(f"{fraction}: the cells move by {way:.2e} m in 10 s")
    assert (way > 0.1) if moves else (way < 1e-6)


@pytest.mark.parametrize("fraction, moves", [(0.99, False), (1.01, True)])
def test_below_the_limit_of_an_eccentric_force_a_body_does_not_creep(fraction, moves):
    """The limit is found by bisection on one step from rest: the reference cone program says what moves."""
    from gridpush_drake.dynamics.reference.isotropic_socp import solve_isotropic_socp

    rng = np.random.default_rng(5)
    obj = make_random_object(rng, 15, 0.01)
    params, point, direction = make_random_contents(rng, obj), obj.p_BC[3], np.array([0.6, 0.8])

    def starts(force):
        f = force * direction
        wrench = np.array([*f, point[0] * f[1] - point[1] * f[0]])
        return np.abs(
            solve_isotropic_socp(
                Model(obj, params), np.zeros(3), np.zeros(3), wrench, 0.01, spin="coupled"
            )
        ).max()

    low, high = 0.0, G * params.total_mass
    for _ in range(40):
        middle = (low + high) / 2
        low, high = (low, middle) if starts(middle) > 1e-11 else (middle, high)
    result = simulate(Model(obj, params), ForcePush(point, fraction * high * direction, 10.0))
    way = np.abs(obj.cells_at(result.poses[: 200 if moves else None]) - obj.p_BC).max()
    print(f"{fraction} of {high:.3f} N: the cells move by {way:.2e} m")
    assert (way > 1e-3) if moves else (way < 1e-6)


@pytest.mark.parametrize("regime", ["inertial", "quasi_static"])
def test_turning_and_shifting_object_and_push_together_changes_nothing(regime):
    worst = 0.0
    for seed, shape in enumerate(SHAPES):
        rng = np.random.default_rng(seed)
        obj = make_shape(shape, 30)
        params, push = make_random_contents(rng, obj), make_random_push(rng, obj, length=0.05)
        X = make_random_pose(rng)
        c, s = np.cos(X[2]), np.sin(X[2])
        R = np.array([[c, -s], [s, c]])
        turned = Push(X[:2] + R @ push.start, R @ push.velocity, push.duration, push.radius)
        nu = np.array([0.01, 0.02, 0.3]) if regime == "inertial" else np.zeros(3)
        one = simulate(Model(obj, params), push, regime=regime, velocity=nu).poses
        other = simulate(
            Model(obj, params), turned, X, regime=regime, velocity=[*(R @ nu[:2]), nu[2]]
        ).poses
        moved = np.column_stack([X[:2] + one[:, :2] @ R.T, one[:, 2] + X[2]])
        worst = max(worst, np.abs(other - moved).max())
    print(f"{regime}: frames agree within {worst:.1e}")
    assert worst < 1e-10


@pytest.mark.parametrize("regime", ["inertial", "quasi_static"])
def test_moving_the_body_frame_s_origin_changes_nothing(regime):
    """The cells' and the outline's coordinates are shifted by d, and the pose by -d: the same body in the world."""
    worst = 0.0
    for seed, shape in enumerate(SHAPES):
        rng = np.random.default_rng(seed)
        obj, d = make_shape(shape, 30), np.array([0.13, -0.21])
        params, pose = make_random_contents(rng, obj), make_random_pose(rng)
        push = make_random_push(rng, obj, pose, length=0.05)
        shifted = GridObject(
            "shifted", obj.p_BC + d, obj.cell_size, obj.labels, translate(obj.outline, *d)
        )
        c, s = np.cos(pose[2]), np.sin(pose[2])
        there = np.array([*(pose[:2] - np.array([[c, -s], [s, c]]) @ d), pose[2]])
        one = simulate(Model(obj, params), push, pose, regime=regime)
        other = simulate(Model(shifted, params), push, there, regime=regime)
        worst = max(worst, np.abs(obj.cells_at(one.poses) - shifted.cells_at(other.poses)).max())
    print(f"{regime}: origins agree within {worst:.1e} m")
    assert worst < 1e-10


@pytest.mark.parametrize("patch", [1.0, 0.1, 0.0])
def test_one_cell_spins_against_the_friction_of_its_patch(patch):
    """I dw/dt = -mu m g c s, with s the patch's side and I = m a²/6 the cell's; on a point it spins for ever."""
    side, w, duration, dt = 0.02, 30.0, 0.01, 1e-5
    obj = GridObject(
        "cell", np.zeros((1, 2)), side, np.ones(1, int), Polygon(rectangle(side, side))
    )
    params = CellParameters(np.array([0.1]), np.array([0.4]), patch_ratio=patch)
    for spin in ("coupled", "separate"):
        physics = Physics(spin=spin)
        after = slide(obj, params, (0.0, 0.0, w), duration, dt, physics=physics).velocities[-1, 2]
        slowed = 0.4 * 9.81 * 0.3826 * patch * side * duration / (side**2 / 6)
        assert after == pytest.approx(w - slowed, abs=1e-4 * w)


def test_one_cell_slides_spins_and_is_pushed():
    square = Polygon(rectangle(0.02, 0.02))
    obj = GridObject("cell", np.zeros((1, 2)), 0.02, np.ones(1, int), square)
    params = CellParameters(np.array([0.1]), np.array([0.4]), 0.3)
    for spin in ("coupled", "separate", "none"):
        result = slide(obj, params, (0.3, 0.0, 5.0), 0.5, 1e-3, physics=Physics(spin=spin))
        np.testing.assert_allclose(result.velocities[-1, :2], 0, atol=1e-7)
        assert spin == "none" or abs(result.velocities[-1, 2]) < 1e-5
    push = Push((-0.01 - 0.005, 0.0), (0.05, 0.0), 0.4, 0.005)
    for regime in ("inertial", "quasi_static"):
        end = simulate(Model(obj, params), push, regime=regime).final_pose
        np.testing.assert_allclose(end, [0.02, 0.0, 0.0], atol=1e-8)
