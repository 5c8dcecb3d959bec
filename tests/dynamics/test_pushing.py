"""Pushed bodies (issue 2, physics 2 and 4): known motions, Coulomb's law at the contacts, balance of forces."""

import numpy as np
import pytest
from shapely import Point

from gridpush_drake.dynamics.kernel_call import run_kernel
from gridpush_drake.dynamics.kernels.contact.contact import (
    CONTACT_COLUMNS,
    CX,
    CY,
    NX,
    NY,
    Edges,
    find_contacts,
)
from gridpush_drake.dynamics.kernels.contact.contact_modes import (
    SEPARATE,
    SLIDE_MINUS,
    SLIDE_PLUS,
    STICK,
)
from gridpush_drake.dynamics.kernels.friction.friction_law import SPIN_LEVER_ARM
from gridpush_drake.dynamics.kernels.inputs import Load
from gridpush_drake.dynamics.physics import Physics
from gridpush_drake.dynamics.push import Push, make_path_times
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from tests.helpers.finite_difference import check_jacobian
from tests.helpers.random_pushes import make_random_contents, make_random_push
from tests.helpers.shapes import SHAPES, make_shape, rectangle

G = 9.81
REGIMES = ["inertial", "quasi_static"]


@pytest.mark.parametrize("cells", [100, 1000])
def test_uniform_rod_pushed_at_its_end_turns_about_l_over_root_2(cells):
    """A rod of length L pushed across its end turns about the point at distance a from that end: a = L/sqrt2.

    With the pressure uniform, friction k per length points against the motion, so it changes sign
    at a. The force at the end balances it, F = k (a - (L - a)); moments about the end, where the
    force has none: 0 = k (a²/2 - (L² - a²)/2), so a² = L²/2. (Lynch and Mason 1996; Goyal, Ruina,
    Papadopoulos 1991.)
    """
    length, width, radius = 0.3, 0.003, 1e-4
    obj = GridObject.from_outline(rectangle(length, width), max_cells=cells, name="rod")
    params = CellParameters.uniform(obj, total_mass=1.0, friction=0.3)
    push = Push((length / 2 - 1e-9, -width / 2 - radius), (0.0, 0.001), 0.02, radius)
    result = simulate(Model(obj, params), push, times=[0.0, 0.01, 0.02], regime="quasi_static")
    _, vy, w = result.velocities[1]
    a = length / 2 + vy / w
    print(
        f"{obj.n} cells: turns about {a / length:.6f} L from the end, {a / length * np.sqrt(2) - 1:+.1e} off"
    )
    assert abs(a * np.sqrt(2) / length - 1) < 1e-3


@pytest.mark.parametrize("regime", REGIMES)
def test_push_through_the_center_of_friction_does_not_turn(regime):
    """In translation all cells' friction is parallel, with its resultant through sum k p / sum k (Mason 1986).

    Quasi-static: any mass and friction. Inertial: mass and friction symmetric about the line of the
    push.
    """
    for seed, shape in enumerate(["square", "bar", "triangle", "l_bracket"]):
        rng = np.random.default_rng(seed)
        obj = make_shape(shape, 60)
        params = (
            make_random_contents(rng, obj)
            if regime == "quasi_static"
            else CellParameters.uniform(obj, 1.0, 0.4)
        )
        if regime == "inertial" and shape not in ("square", "bar"):
            continue
        center = params.relative_friction() @ obj.p_BC
        left = obj.outline.bounds[0]
        push = Push((left - 0.006, center[1]), (0.05, 0.0), 2.0, 0.005)
        result = simulate(Model(obj, params), push, regime=regime)
        print(f"{shape}, {regime}: turns by {np.abs(result.poses[:, 2]).max():.1e} rad")
        assert result.final_pose[0] == pytest.approx(0.1 - 0.001, abs=1e-7)
        assert np.abs(result.poses[:, 2]).max() < 1e-10


def test_quasi_static_motion_knows_only_shares_of_friction():
    """Scaling all masses and all frictions, and the pusher's speed, changes nothing (`model.md`, section 7)."""
    for seed, shape in enumerate(SHAPES):
        rng = np.random.default_rng(seed)
        obj = make_shape(shape, 40)
        params, push = make_random_contents(rng, obj), make_random_push(rng, obj, length=0.1)
        scaled = CellParameters(3.7 * params.mass, 0.21 * params.friction, params.contact_friction)
        swapped = CellParameters(
            params.mass * params.friction, np.ones(obj.n), params.contact_friction
        )
        faster = Push(push.start, 8 * push.velocity, push.duration / 8, push.radius)
        times = make_path_times(push, "inertial")
        one = simulate(Model(obj, params), push, times=times, regime="quasi_static").poses
        for others in (scaled, swapped):
            other = simulate(Model(obj, others), push, times=times, regime="quasi_static").poses
            np.testing.assert_allclose(other, one, atol=1e-9)
        other = simulate(Model(obj, params), faster, times=times / 8, regime="quasi_static").poses
        np.testing.assert_allclose(other, one, atol=1e-9)


def cross(a, b):
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


@pytest.mark.parametrize("regime", REGIMES)
def test_disc_in_a_notch_translates_the_block(regime):
    """Two contacts at once, symmetric: no turning, both forces in their cones, and they balance friction mu m g.

    How the disc squeezes the notch is statically indeterminate; the sum of its forces is not.
    """
    obj = make_shape("notched_block", 100)
    mass, mu, mu_c = 0.8, 0.35, 0.3
    params = CellParameters.uniform(obj, mass, mu, mu_c)
    push = Push((-0.06, 0.0), (0.02, 0.0), 10.0, 0.01)
    result = simulate(Model(obj, params), push, dt=0.01, regime=regime)
    assert result.status == "ok"
    assert result.penetration < 1e-6
    # the one step in which the disc arrives looks ahead along one side only
    np.testing.assert_allclose(result.poses[:, 1:], 0, atol=1e-5)
    np.testing.assert_allclose(np.diff(result.poses[200:, 1:], axis=0), 0, atol=1e-10)
    assert (result.modes[-50:] != SEPARATE).all()
    np.testing.assert_allclose(result.poses[-1, 0] - result.poses[-51, 0], 0.02 * 0.5, atol=1e-8)
    forces = result.contact_forces[-50:]
    np.testing.assert_allclose(
        forces.sum(axis=1), np.tile([mu * mass * G, 0.0], (50, 1)), rtol=1e-6, atol=1e-5
    )
    # the notch's sides are at 45°
    points = result.contact_points[-50:]
    normal = np.stack([np.ones((50, 2)), np.sign(points[:, :, 1])], axis=2) / np.sqrt(2)
    lam_n, lam_t = (normal * forces).sum(axis=2), cross(normal, forces)
    assert (lam_n > 0).all()
    assert (np.abs(lam_t) <= mu_c * lam_n * (1 + 1e-6)).all()


@pytest.mark.parametrize("regime", REGIMES)
def test_disc_in_the_ring_of_a_wrench_drags_it(regime):
    obj = make_shape("wrench", 100)
    params = CellParameters.uniform(obj, 0.4, 0.3, 0.3)
    hole = Point(-0.1, 0.0)
    push = Push((-0.1, 0.0), (0.0, 0.05), 3.0, 0.008)
    result = simulate(Model(obj, params), push, regime=regime)
    assert result.status == "ok"
    assert result.penetration < 1e-4
    assert obj.outline.distance(hole) > 0.011
    ring = obj.cells_at(result.poses)[
        :, np.linalg.norm(obj.p_BC - [-0.1, 0.0], axis=1) < 0.03
    ].mean(axis=1)
    assert np.linalg.norm(ring[-1] - result.tip[-1]) < 0.01
    assert result.final_pose[1] > 0.05
    # dragged, the shaft turns towards the line of motion behind the tip
    assert result.final_pose[2] < -0.5


def walk_contacts(obj, params, push, regime, ahead=0.0):
    """Every contact of a push whose steps look at the body where they begin, so that its law can be read off exactly.

    Yields:
        step, contact, mode, lam_n, lam_t, slip, closing speed; and the support's force and moment
        with the contacts'.
    """
    times = make_path_times(push, regime)
    dts, tip, steps = np.diff(times), push.tip_at(times), len(times) - 1
    load = Load(tip, push.length, push.radius, np.zeros((steps, 3)), np.zeros(2))
    run = run_kernel(
        Model(obj, params, Physics(regime=regime)),
        pose=np.zeros(3),
        velocity=np.zeros(3),
        dts=dts,
        load=load,
        row_of_step=np.full(steps + 1, -1),
        J=np.empty((0, 3, 0)),
        ahead=ahead,
    )
    edges = obj.edges
    kernel_edges = Edges(*edges.start.T.copy(), *edges.end.T.copy(), np.array(edges.previous))
    for t in range(steps):
        c, s = np.cos(run.poses[t, 2]), np.sin(run.poses[t, 2])
        R = np.array([[c, -s], [s, c]])
        center, v_tip = R.T @ (tip[t] - run.poses[t, :2]), R.T @ (tip[t + 1] - tip[t]) / dts[t]
        found = np.zeros((2, CONTACT_COLUMNS))
        find_contacts(kernel_edges, *center, push.radius, 0.01, found)
        touching = []
        for j in range(2):
            mode = run.modes[t, j]
            if mode == SEPARATE:
                assert not run.contact_forces[t, j].any()
                continue
            f = R.T @ run.contact_forces[t, j]
            normal, p = found[j, [NX, NY]], found[j, [CX, CY]]
            tangent = np.array([-normal[1], normal[0]])
            u, w = run.twists[t, :2], run.twists[t, 2]
            relative = u + w * np.array([-p[1], p[0]]) - v_tip
            touching.append((p, f))
            yield (
                "contact",
                (mode, f @ normal, f @ tangent, relative @ tangent, np.linalg.norm(v_tip)),
            )
        yield "balance", (run.twists[t], touching)


@pytest.mark.parametrize("regime", REGIMES)
def test_coulomb_s_law_holds_at_every_contact_and_the_forces_balance_the_support_s(regime):
    counts, worst = {STICK: 0, SLIDE_PLUS: 0, SLIDE_MINUS: 0}, 0.0
    for seed in range(12):
        rng = np.random.default_rng(seed)
        obj = make_shape(list(SHAPES)[seed % len(SHAPES)], 30)
        params, push = make_random_contents(rng, obj), make_random_push(rng, obj, length=0.05)
        mu, k = params.contact_friction, params.mass * params.friction * G
        x, y = obj.p_BC.T
        for kind, values in walk_contacts(obj, params, push, regime):
            if kind == "contact":
                mode, lam_n, lam_t, slip, speed = values
                counts[mode] += 1
                assert lam_n >= -1e-6 * k.sum()
                assert abs(lam_t) <= mu * lam_n + 1e-6 * k.sum()
                if mode == STICK:
                    assert abs(slip) <= 3e-6 * speed
                else:
                    assert lam_t == pytest.approx(
                        mu * lam_n if mode == SLIDE_PLUS else -mu * lam_n, abs=1e-9 * k.sum()
                    )
                    assert (
                        lam_t * slip <= 1e-6 * k.sum() * speed
                    )  # friction on the object opposes its slip
            elif regime == "quasi_static" and values[1]:
                (ux, uy, w), touching = values
                kappa2 = (SPIN_LEVER_ARM * obj.cell_size) ** 2
                vx, vy = ux - w * y, uy + w * x
                s = np.sqrt(vx**2 + vy**2 + kappa2 * w**2)
                support = np.array(
                    [k @ (vx / s), k @ (vy / s), k @ ((x * vy - y * vx + kappa2 * w) / s)]
                )
                contact = sum(np.array([*f, cross(p, f)]) for p, f in touching)
                forces = k.sum() + sum(np.abs(f).sum() for _, f in touching)
                worst = max(
                    worst,
                    np.abs((contact - support) / [1, 1, obj.radius_of_gyration]).max() / forces,
                )
    print(f"{regime}: modes {counts}; imbalance at most {worst:.1e} of the forces")
    assert min(counts.values()) > 50
    assert worst < 1e-6


def test_contact_forces_of_a_push_balance_friction_and_momentum():
    """Newton's second law over a whole push: the pusher's impulse minus friction's is the momentum gained."""
    obj = make_shape("square", 64)
    mass, mu = 1.0, 0.3
    params = CellParameters.uniform(obj, mass, mu, 0.5)
    push = Push((-0.06, 0.0), (0.3, 0.0), 0.5, 0.01)
    result = simulate(Model(obj, params), push, dt=0.001)
    pushed = np.abs(result.contact_forces).sum(axis=(1, 2)) > 0
    gained = mass * np.diff(result.velocities[:, 0])
    friction = np.where(result.velocities[1:, 0] > 1e-6, -mu * mass * G, 0.0) * 0.001
    np.testing.assert_allclose(
        (result.contact_forces[:, 0, 0] * 0.001 + friction)[pushed], gained[pushed], atol=1e-9
    )


@pytest.mark.parametrize("regime", REGIMES)
def test_a_push_that_never_touches_is_flagged(regime):
    obj = make_shape("square", 25)
    params = CellParameters.uniform(obj, 1.0, 0.3)
    result = simulate(
        Model(obj, params), Push((0.2, 0.0), (0.0, 0.1), 1.0, 0.005), regime=regime, gradients=True
    )
    assert result.status == "no_contact"
    np.testing.assert_array_equal(result.poses, 0)
    np.testing.assert_array_equal(result.contact_forces, 0)
    assert np.isnan(result.contact_points).all()
    np.testing.assert_array_equal(result.jacobian.pose[-1], np.eye(3))
    assert not result.jacobian.mass.any()


@pytest.mark.parametrize("regime", REGIMES)
@pytest.mark.parametrize("depth", [0.002, 0.008])
def test_starting_overlapped_is_flagged_and_clears_at_once(regime, depth):
    """8 mm is more than the radius: the disc's center begins inside the object."""
    obj = make_shape("square", 25)
    params = CellParameters.uniform(obj, 1.0, 0.3)
    push = Push((-0.05 - 0.005 + depth, 0.01), (0.02, 0.0), 1.0, 0.005)
    result = simulate(Model(obj, params), push, regime=regime)
    assert result.status == "started_overlapping"
    assert result.gaps[0] == pytest.approx(-depth)
    if regime == "quasi_static":
        assert (result.gaps[3:] > -1e-4).all()
        assert result.poses[1, 0] == pytest.approx(depth, abs=1.5e-3)


@pytest.mark.parametrize("depth", [0.002, 0.004])
def test_a_fast_push_that_starts_overlapped_does_not_throw_the_object(depth):
    obj = make_shape("claw_hammer", 60)
    params = CellParameters.random(obj, 0, (0.005, 0.05), (0.2, 0.6))
    touching = Push.on_outline(obj, 0.1, 0.3, 0.1, radius=0.008, duration=0.4, clearance=0.0)
    way = touching.xy[-1] - touching.xy[0]
    velocity = way / touching.duration
    push = Push(
        touching.xy[0] + depth * way / np.linalg.norm(way),
        velocity,
        touching.duration,
        touching.radius,
    )
    coarse, fine = (
        simulate(Model(obj, params), push, dt=dt, gradients=dt > 0.001) for dt in (0.004, 0.0005)
    )

    def measure_distance(one, other):
        return np.linalg.norm(
            obj.cells_at(one.final_pose) - obj.cells_at(other.final_pose), axis=1
        ).max()

    assert measure_distance(coarse, fine) < 1e-4
    assert measure_distance(fine, simulate(Model(obj, params), touching)) < 1.5 * depth
    assert fine.gaps[-1] > -1e-4

    def end(place):
        return simulate(
            Model(obj, params), Push(place, velocity, touching.duration, touching.radius), dt=0.004
        ).final_pose

    check_jacobian(end, push.xy[0], coarse.jacobian.start[-1], step=1e-6, rtol=1e-4, atol=1e-6)
