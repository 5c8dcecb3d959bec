"""Pushers of other shapes than a disc: what they are made of, and how they move objects."""

import numpy as np
import pytest

from gridpush_drake.dynamics.bodies import Bodies
from gridpush_drake.dynamics.physics import QUASI_STATIC
from gridpush_drake.dynamics.push import START_TOLERANCE, Push
from gridpush_drake.dynamics.push_batch import BatchPush, PushBatch
from gridpush_drake.dynamics.pusher import Pusher, PusherShape
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import PlanningError, PushError, SimulationError
from gridpush_drake.geometry.se2 import transform, transform_shape
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from tests.helpers.random_objects import make_random_pose
from tests.helpers.random_pushes import make_random_contents, make_random_push
from tests.helpers.scene_cases import PLATE, TIPS
from tests.helpers.shapes import SHAPES, make_shape, rectangle

SAME = 1e-9
"""m and rad by which the kernel of several contacts may differ from that of a disc."""


def make_block(cells=60):
    obj = GridObject.from_outline(rectangle(0.1, 0.1), max_cells=cells)
    return Bodies(obj, CellParameters.uniform(obj, 0.5, 0.3, 0.4), QUASI_STATIC)


def turn_about(center, shape=TIPS, angle=None):
    """Turns forwards, by 0.3 rad."""
    if angle is None:
        angle = 0.3 * np.sign(center[1])
    front = shape.core[:, 0].max() + shape.radius
    start = (-0.05 - front, 0.0)
    return Push.about(center, angle, shape=shape, start=start, duration=1.0)


@pytest.mark.parametrize("shape", [TIPS, PLATE], ids=["tips", "plate"])
@pytest.mark.parametrize("name", SHAPES)
def test_a_push_on_the_outline_begins_clear_of_the_object_and_touches_it(name, shape):
    obj = make_shape(name, 30)
    pose = np.array([0.3, -0.1, 0.7])
    outline = transform_shape(pose, obj.outline)
    rng = np.random.default_rng(0)
    for _ in range(20):
        place = rng.uniform(0, obj.edges.perimeter)
        push = Push.on_outline(
            obj,
            place,
            rng.uniform(-0.6, 0.6),
            0.05,
            radius=shape.radius,
            shape=shape,
            speed=0.03,
            pose=pose,
            clearance=0.004,
        )
        gap = outline.distance(push.find_area(0.0))
        assert 0.004 - 1e-5 <= gap <= 0.004 + START_TOLERANCE + 1e-5
        # it looks where it goes, towards the place
        ahead = np.array([np.cos(push.yaw[0]), np.sin(push.yaw[0])])
        np.testing.assert_allclose(push.velocity / 0.03, ahead)
        away = transform(pose, obj.edges.at(place)[0][None])[0] - push.start
        assert abs(away @ [-ahead[1], ahead[0]]) < 1e-9
        assert simulate(Model(obj), push, pose).status == "ok"


@pytest.mark.parametrize("shape", SHAPES)
def test_a_shape_of_one_disc_moves_an_object_as_the_disc_does(shape):
    rng = np.random.default_rng(len(shape))
    obj = make_shape(shape, 30)
    model = Model(obj, make_random_contents(rng, obj), QUASI_STATIC)
    pose = make_random_pose(rng)
    push = make_random_push(rng, obj, pose, length=0.1)
    center = np.array([0.01, -0.02])
    for yaw in (0.0, 2.0):
        c, s = np.cos(yaw), np.sin(yaw)
        origin = push.xy - center @ np.array([[c, s], [-s, c]])
        shaped = Push.along(push.t, origin, shape=PusherShape.discs([center], push.radius), yaw=yaw)
        mine = simulate(model, shaped, pose, gradients=True)
        theirs = simulate(model, push, pose, gradients=True)
        np.testing.assert_allclose(mine.poses, theirs.poses, rtol=0, atol=SAME)
        assert mine.status == theirs.status
        for name in ("mass", "friction", "contact_friction", "start", "length", "pose"):
            expected = getattr(theirs.jacobian, name)
            off = np.abs(getattr(mine.jacobian, name) - expected).max()
            assert off < 1e-6 * np.abs(expected).max(), name


@pytest.mark.parametrize("shape", [TIPS, PLATE, PusherShape.plate(0.14, 0.02, 0.001)])
def test_an_object_goes_with_a_pusher_that_turns_about_a_far_center_and_slips_about_a_near_one(
    shape,
):
    # the last plate is wider than the block, whose corners then touch its face
    for distance, sticks in ((0.3, True), (-0.3, True), (0.02, False)):
        motion = simulate(make_block(), turn_about((0.0, distance), shape=shape))
        assert motion.status == "ok"
        assert motion.residuals.max() < 1e-6
        assert motion.penetration < 1e-6
        slip = np.abs(motion.yaw[-1] - motion.final_pose[2])
        assert (slip < 1e-4) == sticks
        assert ((motion.modes != 0).sum(axis=1)[5:] == 2).all() == sticks


def test_a_rotating_disc_drags_the_side_that_it_touches():
    shape = PusherShape.disc(0.01)
    t = [0.0, 1.0]
    ends = []
    for turn in (0.0, 20.0):
        push = Push.along(t, [(-0.06, 0.0), (-0.01, 0.0)], shape=shape, yaw=[0.0, turn])
        ends.append(simulate(make_block(), push).final_pose)
    straight, dragged = ends
    assert abs(straight[1]) < 1e-6
    # the face that touches moves by +y where the disc turns to the left
    assert dragged[1] > 0.005


def test_a_batch_simulates_shapes_beside_discs():
    bodies = make_block()
    plain = Push((-0.06, 0.01), (0.05, 0.0), 1.0, 0.01)
    pushes = [turn_about((0.0, 0.2)), plain, turn_about((0.0, -0.1), shape=PLATE)]
    times = np.linspace(0, 1.0, 21)
    rows = [np.array([5, 20]), np.array([20]), np.array([20, 20])]
    batch = PushBatch(
        bodies.obj,
        [BatchPush(p, np.zeros(3), times, r, None) for p, r in zip(pushes, rows, strict=True)],
        QUASI_STATIC,
    )
    poses, touched = batch.simulate(bodies.params)
    again, J = batch.differentiate(bodies.params)
    np.testing.assert_array_equal(poses, again)
    assert touched.all()
    n = bodies.obj.n
    for i, push in enumerate(pushes):
        motion = simulate(bodies, push, times=times, gradients=True)
        own = slice(*batch.offsets[i : i + 2])
        np.testing.assert_array_equal(poses[own], motion.poses[rows[i]])
        expected = motion.jacobian
        np.testing.assert_array_equal(J[own][..., :n], expected.mass[rows[i]])
        np.testing.assert_array_equal(J[own][..., n], expected.contact_friction[rows[i]])
        np.testing.assert_array_equal(J[own][..., n + 1 : n + 3], expected.start[rows[i]])
        np.testing.assert_array_equal(J[own][..., n + 3 :], expected.pose[rows[i]])


def test_a_plate_has_its_front_on_the_y_axis():
    plate = PusherShape.plate(0.08, 0.02, 0.003)
    assert plate.joined
    np.testing.assert_allclose(plate.core.max(axis=0) + plate.radius, (0.0, 0.04), atol=1e-12)
    np.testing.assert_allclose(plate.core.min(axis=0) - plate.radius, (-0.02, -0.04), atol=1e-12)


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (lambda: PusherShape.disc(0.0), PushError, "radius is 0.0; expected a positive"),
        (lambda: PusherShape.discs([], 0.01), PushError, "expected \\(K, 2\\), K >= 1"),
        (lambda: PusherShape.plate(0.02, 0.01, 0.006), PushError, "thinner than 0.012 m"),
        (
            lambda: PusherShape.polygon([(0, 0), (0, 1), (1, 1), (1, 0)], 0.1),
            PushError,
            "convex polygon, counterclockwise",
        ),
        (
            lambda: PusherShape.polygon([(0, 0), (1, 0), (0.2, 0.2), (0, 1)], 0.01),
            PushError,
            "convex polygon",
        ),
        (lambda: PusherShape([(0, 0), (0, 0)], 0.1, True), PushError, "both corners are the same"),
        (lambda: Pusher(0.01, shape=TIPS), PlanningError, "radius and shape are given"),
        (lambda: Push.along([0, 1], np.eye(2)), PushError, "either radius or shape"),
        (lambda: Push.along([0, 1], np.eye(2), 0.1, yaw=0.0), PushError, "without a shape"),
        (
            lambda: Push.along([0, 1], np.eye(2), shape=TIPS, yaw=[0, 1, 2]),
            PushError,
            "yaw of shape",
        ),
        (lambda: turn_about((0, 1), angle=0.0), PushError, "angle not zero"),
        (
            lambda: simulate(make_block(), turn_about((0, 0.1)), regime="inertial"),
            SimulationError,
            "regime: 'inertial' is for a pusher that is one disc",
        ),
        (
            lambda: simulate(make_block(), turn_about((0, 0.1)), gradients="push"),
            SimulationError,
            "gradients: is for a pusher that is one disc",
        ),
    ],
)
def test_what_cannot_be_is_refused(make, error, message):
    with pytest.raises(error, match=message):
        make()
