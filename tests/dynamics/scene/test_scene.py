"""`simulate` of several objects: one object moves as `simulate` moves it, several push each other and keep apart."""

from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from gridpush_drake.dynamics.bodies import Bodies
from gridpush_drake.dynamics.one_object import ONE_OBJECT_ALONE
from gridpush_drake.dynamics.physics import Physics
from gridpush_drake.dynamics.push import ForcePush, Push
from gridpush_drake.dynamics.scene.cores import CORNER_RADIUS, get_core
from gridpush_drake.dynamics.scene.simulation import simulate_together
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import SimulationError
from gridpush_drake.geometry.se2 import transform_shape
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from tests.helpers.random_objects import make_random_pose
from tests.helpers.random_pushes import make_random_contents, make_random_push
from tests.helpers.scene_cases import Layout, make_row
from tests.helpers.shapes import SHAPES, make_shape, rectangle

SAME = 1e-9
"""m and rad by which the kernel of several objects may differ from that of one."""


def make_block(length=0.08, width=0.04, mass=0.5):
    obj = GridObject.from_outline(rectangle(length, width), max_cells=32)
    return obj, CellParameters.uniform(obj, mass, 0.4, 0.3)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("spin", ["coupled", "separate"])
def test_one_object_moves_as_by_itself(shape, spin):
    rng = np.random.default_rng(len(shape))
    obj = make_shape(shape, 30)
    params = make_random_contents(rng, obj)
    pose = make_random_pose(rng)
    push = make_random_push(rng, obj, pose, length=0.1)
    physics = Physics(regime="quasi_static", spin=spin)
    alone = simulate(Model(obj, params, physics), push, pose, gradients=True)
    scene = simulate_together(Bodies(obj, params, physics), push, pose[None], gradients=True)
    assert alone.status == scene.status == "ok"
    np.testing.assert_allclose(scene.poses[:, 0], alone.poses, rtol=0, atol=SAME)
    J = alone.jacobian
    K = scene.jacobian
    for mine, theirs in (
        (K.mass[:, 0], J.mass),
        (K.friction[:, 0], J.friction),
        (K.contact_friction[:, 0, :, 0], J.contact_friction),
        (K.start[:, 0], J.start),
        (K.direction[:, 0], J.direction),
        (K.length[:, 0], J.length),
        (K.pose[:, 0, :, 0], J.pose),
    ):
        np.testing.assert_allclose(mine, theirs, rtol=1e-6, atol=1e-7 * np.abs(theirs).max())


def test_an_object_far_away_changes_nothing():
    obj, params = make_block()
    push = Push((-0.06, 0.005), (0.05, 0.0), 1.0, 0.01)
    alone = Layout.of([(obj, params, (0.0, 0.0, 0.0))]).simulate(push)
    both = Layout.of([(obj, params, (0.0, 0.0, 0.0)), (obj, params, (0.5, 0.5, 1.0))]).simulate(
        push
    )
    np.testing.assert_array_equal(both.poses[:, 0], alone.poses[:, 0])
    np.testing.assert_array_equal(both.poses[:, 1] - (0.5, 0.5, 1.0), 0.0)


def test_two_blocks_in_line_go_straight_and_share_the_force():
    """Symmetric about the push: neither turns, and the second takes its own friction's share."""
    obj, params = make_block()
    _, heavy = make_block(mass=1.5)
    scene = Layout.of([(obj, params, (0.0, 0.0, 0.0)), (obj, heavy, (0.09, 0.0, 0.0))])
    motion = scene.simulate(Push((-0.05, 0.0), (0.05, 0.0), 1.0, 0.01))
    assert motion.status == "ok"
    np.testing.assert_allclose(motion.final_pose[0], (0.05, 0, 0), atol=1e-6)
    np.testing.assert_allclose(motion.final_pose[1], (0.13, 0, 0), atol=1e-6)
    last = motion.contact_bodies[-1]
    finger = motion.contact_forces[-1][last[:, 1] == -1].sum(axis=0)
    between = motion.contact_forces[-1][(last[:, 0] == 1) & (last[:, 1] == 0)].sum(axis=0)
    between = between - motion.contact_forces[-1][(last[:, 0] == 0) & (last[:, 1] == 1)].sum(axis=0)
    np.testing.assert_allclose(finger, (0.4 * 9.81 * 2.0, 0), rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(between, (0.4 * 9.81 * 1.5, 0), rtol=1e-4, atol=1e-4)


def test_edges_on_each_other_touch_at_two_places():
    """At most two contacts of a pair of edges, at the ends of what they have in common."""
    obj, params = make_block()
    scene = Layout.of([(obj, params, (0.0, 0.0, 0.0)), (obj, params, (0.08, 0.013, 0.0))])
    motion = scene.simulate(Push((-0.05, 0.01), (0.05, 0.0), 0.5, 0.01))
    pairs = (motion.contact_bodies[:, :, 1] >= 0).sum(axis=1)
    assert pairs.max() == 2
    touching = np.flatnonzero(pairs == 2)
    points = motion.contact_points[touching[0]][motion.contact_bodies[touching[0], :, 1] >= 0]
    assert abs(np.diff(points[:, 1])[0]) == pytest.approx(0.027 - 2 * CORNER_RADIUS, abs=1e-4)


@pytest.mark.parametrize("seed", range(4))
def test_objects_push_each_other_and_keep_apart(seed):
    shapes = np.random.default_rng(seed).permutation(list(SHAPES))[:3]
    scene, push = make_row(seed, shapes)
    motion = scene.simulate(push)
    assert motion.status == "ok"
    assert motion.residuals.max() < 1e-6
    for poses in motion.poses[::10]:
        placed = [
            transform_shape(pose, obj.outline)
            for pose, obj in zip(poses, scene.objects, strict=True)
        ]
        for one, other in combinations(placed, 2):
            assert one.intersection(other).area < 1e-6


def test_every_contact_obeys_the_law():
    """No contact pulls, friction stays in its cone, and what is apart exerts nothing."""
    scene, push = make_row(0, list(SHAPES)[:3])
    motion = scene.simulate(push)
    sizes = np.linalg.norm(motion.contact_forces, axis=2)
    assert (sizes[motion.modes == 0] < 1e-9).all()
    assert (motion.modes[motion.contact_bodies[:, :, 1] >= 0] != 0).any()


def test_the_motion_hangs_on_the_path_and_not_on_the_speed():
    scene, push = make_row(1, list(SHAPES)[:2])
    slow = scene.simulate(push)
    fast = scene.simulate(Push(push.start, 2 * push.velocity, push.duration / 2, push.radius))
    np.testing.assert_allclose(fast.final_pose, slow.final_pose, atol=1e-9)


def test_half_the_step_changes_little():
    obj, params = make_block()
    scene = Layout.of([(obj, params, (0.0, 0.0, 0.0)), (obj, params, (0.09, 0.015, 0.1))], 0.2)
    push = Push((-0.05, 0.006), (0.05, 0.0), 1.0, 0.01)
    coarse = scene.simulate(push, dt=0.02)
    fine = scene.simulate(push, dt=0.0025)
    assert np.abs(coarse.final_pose - fine.final_pose)[:, :2].max() < 5e-4


def test_cores_keep_notches_and_round_corners():
    obj = make_shape("notched_block", 30)
    core = get_core(obj)
    assert core.radius == CORNER_RADIUS
    assert (~core.convex).sum() == 1
    grown = obj.outline.buffer(-core.radius, join_style="mitre").buffer(core.radius)
    assert obj.outline.symmetric_difference(grown).area < 8 * CORNER_RADIUS**2


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"pose": [(0, 0, 0), (0.02, 0, 0)]}, r"object 0\) and .*object 1\) overlap"),
        ({"pose": (0, 0, 0)}, r"pose of shape \(3,\); expected \(2, 3\)"),
        ({"regime": "inertial"}, "regime: is for one object"),
        ({"physics": Physics("lagged")}, "'lagged' needs the regime 'inertial'"),
        ({"push": ForcePush((0, 0), (1, 0), 1.0)}, "push by a force: is for one object"),
        ({"velocity": (0.1, 0, 0)}, "velocity: is for one object; .* no momentum"),
        ({"table": [(-1, -1), (1, -1), (1, 1)]}, "table: is for one object"),
        ({"gradients": "mass"}, "gradients: is for one object; several .* gradients=True"),
        ({"push_height": 0.01}, r"\(object 1\): push_height: is for one object"),
        ({"friction": 0.0}, "friction is zero"),
        ({"pair_friction": -1.0}, "pair_friction: expected finite numbers"),
        ({"pair_friction": [[0, 1], [2, 0]]}, "expected a symmetric matrix"),
        ({"pair_friction": np.ones(3)}, r"expected one number or \(2, 2\)"),
    ],
)
def test_what_is_refused(options, message):
    """By `simulate`: what is for one object alone, and wrong arguments."""
    obj, params = make_block()
    given = {"pose": [(0, 0, 0), (0.5, 0, 0)], "push": Push((-0.06, 0), (0.05, 0), 0.1, 0.01)}
    given |= options
    of_model = {key: given.pop(key) for key in ("physics", "pair_friction") if key in given}
    changed = replace(
        params,
        push_height=given.pop("push_height", 0.0),
        friction=given.pop("friction", 1.0) * params.friction,
    )
    with pytest.raises(SimulationError, match=message):
        simulate(Bodies([obj, obj], [params, changed], **of_model), **given)


def test_the_page_has_the_table_of_what_is_for_one_object_alone():
    page = (Path(__file__).parents[3] / "docs" / "howto" / "several_objects.md").read_text()
    rows = [line.strip("| ").split(" | ") for line in page.splitlines() if line.startswith("| `")]
    reasons = {row[0].strip("`"): row[1] for row in rows if len(row) == 2}
    assert {name: reasons.get(name) for name in ONE_OBJECT_ALONE} == ONE_OBJECT_ALONE


def test_derivatives_are_there_where_they_were_asked_for():
    obj, params = make_block()
    push = Push((-0.05, 0), (0.05, 0), 0.1, 0.01)
    motion = Model([obj, obj], [params, params]).simulate(push, [(0, 0, 0), (0.5, 0, 0)])
    with pytest.raises(SimulationError, match="pass gradients=True"):
        _ = motion.jacobian
    # so fast do they move at the end: the first one at the pusher's speed
    np.testing.assert_allclose(motion.velocities[-1], [[0.05, 0, 0], [0, 0, 0]], atol=1e-6)
