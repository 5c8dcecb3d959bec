"""Stable pushes: the motion cone against the simulation, and against non-negative least squares."""

import numpy as np
import pytest
from scipy.optimize import nnls

from gridpush_drake.dynamics.physics import QUASI_STATIC
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.pusher import PusherShape
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import PlanningError
from gridpush_drake.geometry.se2 import compose, invert
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.stable.stable_push import (
    MotionCone,
    calc_flush_pose,
    calc_push_stability,
    calc_slip,
    find_pusher_contacts,
    find_turn_limits,
)
from tests.helpers.scene_cases import PLATE, TIPS
from tests.helpers.shapes import rectangle

CLEAR_MARGIN = 0.02
"""Margin beyond which the cone and the simulation must agree; nearer, the steps count."""

STUCK = 1e-5
"""m and rad by which an object that sticks may move in the pusher's frame."""


def make_block(rng, friction=0.4):
    obj = GridObject.from_outline(rectangle(0.1, 0.08), max_cells=40)
    mass = rng.dirichlet(np.full(obj.n, 0.3))
    return Model(obj, CellParameters(mass, np.full(obj.n, 0.3), friction), QUASI_STATIC)


def push_about(center, shape, y=0.0, angle=0.1):
    """The pusher lies flush against the block's left side, with its frame at (-0.05 - front, y)."""
    front = shape.core[:, 0].max() + shape.radius
    start = np.array([-0.05 - front, y])
    angle = np.copysign(angle, center[1] - y)
    return Push.about(center, angle, shape=shape, start=start, duration=1.0)


@pytest.mark.parametrize("shape", [TIPS, PLATE, PusherShape.plate(0.12, 0.02, 0.001)])
def test_an_object_sticks_in_the_simulation_where_the_twist_is_in_the_motion_cone(shape):
    rng = np.random.default_rng(3)
    counts = {True: 0, False: 0}
    for _ in range(60):
        model = make_block(rng, friction=rng.uniform(0.2, 0.6))
        center = (rng.uniform(-0.1, 0.1), rng.choice([-1, 1]) * np.exp(rng.uniform(-4, 0)))
        push = push_about(center, shape, y=rng.uniform(-0.01, 0.01))
        margin = calc_push_stability(model, push, count=1).margins[0]
        if abs(margin) < CLEAR_MARGIN:
            continue
        motion = simulate(model, push)
        slip = calc_slip(model.obj, push, (0, 0, 0), motion.final_pose)
        assert slip.is_within(STUCK, STUCK) == (margin > 0), (center, margin, slip)
        counts[bool(margin > 0)] += 1
    print(counts)
    assert min(counts.values()) >= 10


def test_the_cone_holds_what_non_negative_forces_make():
    rng = np.random.default_rng(0)
    for _ in range(20):
        model = make_block(rng)
        pose = (-0.05 - TIPS.radius, rng.uniform(-0.01, 0.01), 0.0)
        contacts = find_pusher_contacts(model.obj, TIPS, pose)
        assert len(contacts.points) == 2
        cone = MotionCone(model.obj, model.params, contacts)
        twists = rng.normal(size=(30, 3)) * (1, 1, 20)
        mu = model.params.contact_friction
        forces = [(1, 0.0), (1, mu), (1, -mu)]
        for twist, margin in zip(twists, cone.calc_margins(twists), strict=True):
            # the table's wrench, cell by cell
            v = twist[:2] + twist[2] * np.column_stack(
                [-model.obj.p_BC[:, 1], model.obj.p_BC[:, 0]]
            )
            arm = cone._arm
            speed = np.sqrt((v**2).sum(axis=1) + (arm * twist[2]) ** 2)
            k = model.params.relative_friction()
            x, y = model.obj.p_BC.T
            moments = (x * v[:, 1] - y * v[:, 0] + arm**2 * twist[2]) / speed
            wrench = np.array([*(k / speed @ v), k @ moments])
            columns = [
                [fn, ft, p[0] * ft - p[1] * fn] for p in contacts.points for fn, ft in forces
            ]
            left = nnls(np.array(columns).T, wrench)[1]
            assert (left < 1e-9) == (margin > 0) or abs(margin) < 1e-6


def test_contacts_are_found_where_they_will_be_once_flush():
    obj = make_block(np.random.default_rng(0)).obj
    skewed = (-0.05 - PLATE.radius + 0.001, 0.0, 0.01)
    contacts = find_pusher_contacts(obj, PLATE, skewed)
    np.testing.assert_allclose(contacts.normals, [[1, 0]] * len(contacts.points), atol=1e-9)
    assert len(contacts.points) == 2
    flush = calc_flush_pose(contacts, skewed)
    np.testing.assert_allclose(flush[[0, 2]], [-0.05, 0.0], atol=2e-5)
    wide = PusherShape.plate(0.12, 0.02, 0.001)
    corners = find_pusher_contacts(obj, wide, (-0.05, 0.0, 0.0))
    np.testing.assert_allclose(np.sort(corners.points[:, 1]), [-0.04, 0.04])


def test_a_fingertip_touches_a_corner_along_its_own_normal():
    obj = make_block(np.random.default_rng(0)).obj
    corner = np.array([-0.05, 0.04])
    normal = np.array([0.8, -0.6])
    place = corner - TIPS.radius * normal - TIPS.core[1]
    contacts = find_pusher_contacts(obj, TIPS, (*place, 0.0), 1e-4)
    np.testing.assert_allclose(contacts.points, [corner], atol=1e-12)
    np.testing.assert_allclose(contacts.normals, [normal], atol=1e-9)
    np.testing.assert_allclose(contacts.gaps, [0.0], atol=1e-9)


def test_turns_within_the_limits_are_stable_and_tighter_ones_are_not():
    rng = np.random.default_rng(5)
    for _ in range(5):
        model = make_block(rng)
        frame = np.array([-0.05, 0.0, 0.0])
        contacts = find_pusher_contacts(model.obj, PLATE, frame)
        limits = find_turn_limits(model, contacts, frame, 0.9, max_curvature=30.0)
        if limits is None:
            continue
        right, left = limits
        assert right <= 0 <= left
        for curvature, stable in ((left * 0.95, True), (left + 2.0, False), (right - 2.0, False)):
            if curvature == 0:
                continue
            push = push_about((-0.05, 1 / curvature), PLATE)
            end = simulate(model, push).final_pose
            assert calc_slip(model.obj, push, (0, 0, 0), end).is_within(STUCK, STUCK) == stable


def test_places_that_are_rounded_do_not_make_a_push_unstable():
    model = make_block(np.random.default_rng(0))
    even = Model(model.obj, physics=QUASI_STATIC)
    push = push_about((-0.05, 0.2), PLATE, angle=0.3)
    # as a log has it: many rows, each rounded to 0.1 mm
    t = np.linspace(0, push.duration, 400)
    rounded = Push.along(t, push.tip_at(t).round(4), shape=PLATE, yaw=push.yaw_at(t))
    margins = [calc_push_stability(even, each, count=1).margins[0] for each in (push, rounded)]
    assert min(margins) > 0.01
    still = Push.along([0, 1], push.xy[[0, 0]], shape=PLATE)
    with pytest.raises(PlanningError, match="stands still"):
        calc_push_stability(even, still)


def test_a_slip_is_seen_from_the_pusher():
    obj = make_block(np.random.default_rng(0)).obj
    push = push_about((0.0, 0.2), TIPS)
    first = np.array([*push.xy[0], push.yaw[0]])
    last = np.array([*push.xy[-1], push.yaw[-1]])
    held = compose(last, invert(first))
    assert calc_slip(obj, push, (0, 0, 0), held).is_within(1e-9, 1e-9)
    slip = calc_slip(obj, push, (0, 0, 0), held + (0.003, 0.004, -0.1))
    assert slip.distance == pytest.approx(0.005, rel=1e-3)
    assert slip.angle == pytest.approx(0.1)


def test_what_has_no_cone_is_refused():
    model = make_block(np.random.default_rng(0))
    with pytest.raises(PlanningError, match="by a disc without a frame"):
        calc_push_stability(model, Push((-0.06, 0), (0.1, 0), 1.0, 0.01))
    with pytest.raises(PlanningError, match=r"more than 0\.002 m off the outline"):
        calc_push_stability(model, Push.along([0, 1], [(-1, 0), (0, 0)], shape=TIPS))
    one = find_pusher_contacts(model.obj, PusherShape.disc(0.01), (-0.06, 0.0, 0.0))
    cone = MotionCone(model.obj, model.params, one)
    assert (cone.calc_margins(np.random.default_rng(0).normal(size=(50, 3))) <= 0).all()
