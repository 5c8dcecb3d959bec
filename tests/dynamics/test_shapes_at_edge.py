"""Pushers of other shapes than a disc near a table's edge, over which loads shift."""

from dataclasses import replace

import numpy as np
import pytest

from gridpush_drake.dynamics.bodies import Bodies
from gridpush_drake.dynamics.model_batch import simulate_models
from gridpush_drake.dynamics.physics import QUASI_STATIC
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.push_batch import BatchPush, PushBatch
from gridpush_drake.dynamics.pusher import PusherShape
from gridpush_drake.dynamics.simulation import calc_loads, simulate
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from tests.helpers.finite_difference import calc_finite_difference
from tests.helpers.scene_cases import PLATE, TIPS
from tests.helpers.shapes import rectangle

SAME = 1e-9
"""m and rad by which the kernel of several contacts may differ from that of a disc."""

POSE = np.array([0.0, 0.0, 0.1])
TIMES = np.linspace(0.0, 1.0, 31)


def make_table(edge):
    """A wide table that ends at x = edge."""
    return np.array([(-1.0, -1.0), (edge, -1.0), (edge, 1.0), (-1.0, 1.0)])


def make_block(cells=20):
    obj = GridObject.from_outline(rectangle(0.1, 0.08), max_cells=cells)
    rng = np.random.default_rng(3)
    params = CellParameters(
        mass=rng.uniform(0.5, 1.5, obj.n) * 0.5 / obj.n,
        friction=rng.uniform(0.25, 0.45, obj.n),
        contact_friction=0.3,
    )
    return Bodies(obj, params, QUASI_STATIC)


def turn_slowly(shape, *, start=(-0.066, 0.006), yaw=0.1, turn=0.25, center=(-0.066, 0.206)):
    """Goes 5 cm forwards about a center, from a start and a yaw."""
    angles = turn * TIMES
    c, s = np.cos(angles), np.sin(angles)
    x, y = np.subtract(start, center)
    xy = np.column_stack([center[0] + c * x - s * y, center[1] + s * x + c * y])
    return Push.along(TIMES, xy, shape=shape, yaw=yaw + angles)


@pytest.mark.parametrize("yaw", [0.0, 2.0])
@pytest.mark.parametrize(("edge", "height"), [(0.07, 0.0), (0.025, 0.0), (0.07, 0.02)])
def test_a_shape_of_one_disc_shifts_loads_as_the_disc_does(edge, height, yaw):
    bodies = make_block()
    slippery = replace(bodies.params, contact_friction=0.1, push_height=height)
    bodies = Bodies(bodies.obj, slippery, QUASI_STATIC)
    push = Push((-0.062, 0.01), (0.05, 0.012), 1.0, 0.008)
    center = np.array([0.01, -0.02])
    c, s = np.cos(yaw), np.sin(yaw)
    origin = push.xy - center @ np.array([[c, s], [-s, c]])
    shaped = Push.along(push.t, origin, shape=PusherShape.discs([center], 0.008), yaw=yaw)
    table = make_table(edge)
    mine = simulate(bodies, shaped, POSE, times=TIMES, gradients=True, table=table)
    theirs = simulate(bodies, push, POSE, times=TIMES, gradients=True, table=table)
    endless = simulate(bodies, push, POSE, times=TIMES)
    np.testing.assert_allclose(mine.poses, theirs.poses, rtol=0, atol=SAME)
    np.testing.assert_allclose(mine.load_centers, theirs.load_centers, rtol=0, atol=SAME)
    assert np.abs(endless.poses - theirs.poses).max() > 1e-5
    assert mine.status == theirs.status == ("ok" if edge == 0.07 else "tips")
    np.testing.assert_array_equal(mine.tips, theirs.tips)
    if edge == 0.07:
        names = ("mass", "friction", "contact_friction", "start", "length", "pose", "push_height")
        for name in names[: None if height else -1]:
            expected = getattr(theirs.jacobian, name)
            off = np.abs(getattr(mine.jacobian, name) - expected).max()
            assert 0 <= off < 1e-6 * np.abs(expected).max(), name


@pytest.mark.parametrize("shape", [PLATE, TIPS], ids=["plate", "tips"])
@pytest.mark.parametrize(
    ("edge", "height"), [(0.075, 0.0), (0.06, 0.0), (0.06, 0.03), (None, 0.02)]
)
def test_gradients_of_shifting_loads_are_those_of_finite_differences(edge, height, shape):
    bodies = make_block()
    table = None if edge is None else make_table(edge)
    front = shape.core[:, 0].max() + shape.radius
    start = np.array([-0.058 - front, 0.006])
    center = np.array([-0.058, 0.206])
    n = bodies.obj.n

    def run(x, gradients=False):
        # so slippery that the object slides along the shape, and the masses matter
        params = replace(bodies.params, mass=x[:n], friction=x[n : 2 * n], contact_friction=0.03)
        params = replace(params, push_height=max(0.0, x[-10]))
        push = turn_slowly(shape, start=x[-9:-7], yaw=x[-7], turn=x[-6], center=x[-5:-3])
        return simulate(
            Bodies(bodies.obj, params, QUASI_STATIC),
            push,
            x[-3:],
            times=TIMES,
            gradients=gradients,
            table=table,
            record=[-1],
        )

    # in one vector: masses, frictions, height, start, yaw, turn, center, first pose
    x = np.concatenate(
        [bodies.params.mass, bodies.params.friction, [height], start, [0.1, 0.25], center]
    )
    x = np.append(x, POSE)
    motion = run(x, gradients=True)
    assert motion.status == "ok"
    assert np.ptp(motion.load_centers - motion.poses[:-1, :2], axis=0).max() > 1e-5
    found = motion.jacobian
    numeric = calc_finite_difference(lambda x: run(x).final_pose, x, step=1e-4, order=4)
    exact = {
        "mass": (found.mass[0], numeric[:, :n]),
        "friction": (found.friction[0], numeric[:, n : 2 * n]),
        "pose": (found.pose[0], numeric[:, -3:]),
        "center": (found.center[0], numeric[:, -5:-3]),
    }
    if height:
        exact["push_height"] = (found.push_height[0], numeric[:, 2 * n])
    for name, (mine, expected) in exact.items():
        off = np.abs(mine - expected).max()
        assert off < 1e-6 * np.abs(expected).max(), (name, off, np.abs(expected).max())


def test_batches_and_models_tip_where_no_loads_can_hold_the_object():
    bodies = make_block()
    push = turn_slowly(PLATE)
    rows = np.array([10, 30])
    for edge, status in ((0.07, "ok"), (0.025, "tips")):
        table = make_table(edge)
        motion = simulate(bodies, push, POSE, times=TIMES, gradients=True, table=table)
        assert motion.status == status
        # a step tips just where nothing holds the object at rest at its beginning
        held = [calc_loads(bodies, pose, table) is not None for pose in motion.poses[:-1]]
        np.testing.assert_array_equal(motion.tips, ~np.array(held))

        batch = PushBatch(bodies.obj, [BatchPush(push, POSE, TIMES, rows, table)], QUASI_STATIC)
        assert batch.near_edge
        poses, touched = batch.simulate(bodies.params)
        np.testing.assert_array_equal(poses, motion.poses[rows])
        assert touched.all()
        n = bodies.obj.n
        along = np.random.default_rng(0).normal(size=(n, 2))
        poses, J = batch.differentiate(bodies.params, along)
        np.testing.assert_array_equal(poses, motion.poses[rows])
        expected = motion.jacobian
        np.testing.assert_array_equal(J[..., :n], expected.mass[rows])
        np.testing.assert_array_equal(J[..., n + 1 : n + 3], expected.start[rows])
        np.testing.assert_array_equal(J[..., n + 3 : n + 6], expected.pose[rows])
        params = bodies.params
        held_up = expected.friction[rows] * params.friction - expected.mass[rows] * params.mass
        np.testing.assert_allclose(J[..., n + 6 :], held_up @ along, rtol=1e-12)

        by_model = simulate_models(
            bodies.obj, [params], push, POSE, times=TIMES, physics=QUASI_STATIC, table=table
        )
        np.testing.assert_array_equal(by_model.poses[0], motion.poses)
        first = int(np.argmax(motion.tips)) if status == "tips" else len(TIMES)
        assert by_model.upright[0] == first
        none = simulate_models(
            bodies.obj, [], push, POSE, times=TIMES, physics=QUASI_STATIC, table=table
        )
        assert none.poses.shape == (0, *motion.poses.shape) and none.upright.shape == (0,)


def test_far_from_the_edge_a_table_changes_nothing():
    bodies = make_block()
    push = turn_slowly(TIPS)
    endless = simulate(bodies, push, POSE, times=TIMES, gradients=True)
    far = simulate(bodies, push, POSE, times=TIMES, gradients=True, table=make_table(0.9))
    np.testing.assert_array_equal(far.poses, endless.poses)
    np.testing.assert_array_equal(far.jacobian.mass, endless.jacobian.mass)
