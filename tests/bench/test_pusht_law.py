"""The law of a block that a driven disc pushes, against statements that do not use its formulas."""

import numpy as np
import pytest
from shapely import Point, Polygon

from gridpush_drake.bench.pusht.experiments import (
    CENTER,
    CORRECTION,
    GOAL,
    SLOP,
    make_block,
    make_environment,
)
from gridpush_drake.bench.pusht.sliding_block import (
    BlockEstimate,
    DrivenDisc,
    SlidingBlock,
)
from gridpush_drake.bench.pusht.stroke_search import calc_coverage
from gridpush_drake.dynamics.kernels.steering.driven_disc import (
    PX,
    STATE_SIZE,
    THETA,
    UX,
    VX,
    W,
    X,
    advance,
    predict_poses,
)
from gridpush_drake.errors import PlanningError
from gridpush_drake.geometry.se2 import transform, transform_shape
from tests.helpers.pusht import TRUE, make_controller, make_world


def test_a_disc_that_touches_nothing_follows_its_law():
    world = make_world([100.0, 100.0], [400.0, 300.0, 0.3])
    disc = make_block().disc
    target = np.array([180.0, 60.0])
    position = world.disc
    velocity = np.zeros(2)
    for _ in range(disc.substeps):
        velocity = velocity + disc.time_step * (
            disc.stiffness * (target - position) - disc.damping * velocity
        )
        position = position + disc.time_step * velocity
    assert not world.step(target)
    np.testing.assert_allclose(world.disc, position, rtol=1e-12)
    np.testing.assert_allclose(world.velocity, velocity, rtol=1e-12)
    np.testing.assert_array_equal(world.pose, [400.0, 300.0, 0.3])


@pytest.mark.parametrize("along", [-45.0, 0.0, 50.0])
def test_the_block_moves_as_a_force_on_the_ellipsoid_moves_it(along):
    """A force n at r moves it by a twist in proportion to (n, r × n / arm²), and keeps it ahead of the disc."""
    # the disc pushes the bar's long face from below, at rest angle 0: the force is along y
    world = make_world([256.0 + along, 236.0 - 15.0], [256.0, 236.0, 0.0])
    for _ in range(3):
        world.step([256.0 + along, 350.0])
    before = world._state.copy()
    world.step([256.0 + along, 350.0])
    theta = before[THETA]
    normal = np.array([-np.sin(theta), np.cos(theta)])
    # the point of the face that is nearest to the disc, about the center of friction
    center = transform(before[X : THETA + 1], np.array([[TRUE.center_x, TRUE.center_y]]))[0]
    distance = normal @ (before[X : X + 2] - before[PX : PX + 2])
    touch = before[PX : PX + 2] + distance * normal
    offset = touch - center
    arm = offset[0] * normal[1] - offset[1] * normal[0]
    ux, uy, w = before[UX : W + 1]
    np.testing.assert_allclose(np.array([ux, uy]) @ [-normal[1], normal[0]], 0.0, atol=1e-9)
    speed = np.hypot(ux, uy)
    assert speed > 20.0
    assert w == pytest.approx(speed * arm / TRUE.arm**2, rel=1e-9, abs=1e-9)
    # the block's point moves as fast along the normal as the disc, and out of the overlap
    overlap = 15.0 - distance - SLOP
    assert overlap > 0.0
    wanted = before[VX : VX + 2] @ normal + CORRECTION * overlap / 0.01
    assert speed + w * arm == pytest.approx(wanted, rel=1e-9)


def test_walls_hold_the_block():
    world = make_world([256.0, 150.0], [256.0, 100.0, 0.0])
    for _ in range(30):
        world.step([256.0, 0.0])
    corners = np.concatenate([np.asarray(part) for part in make_block().parts])
    assert transform(world.pose, corners).min() > 7.0 - 1.0


def test_many_predictions_are_single_ones():
    rng = np.random.default_rng(3)
    record = make_block().make_record(TRUE)
    states = np.zeros((40, STATE_SIZE))
    states[:, PX : PX + 2] = rng.uniform(200, 300, (40, 2))
    states[:, VX : VX + 2] = rng.uniform(-100, 100, (40, 2))
    states[:, X : THETA + 1] = [256.0, 236.0, 0.7]
    targets = rng.uniform(100, 400, (40, 2))
    poses = np.empty((40, 3))
    predict_poses(record, states, targets, poses)
    assert np.ptp(poses, axis=0).min() > 0.1
    for state, target, pose in zip(states, targets, poses, strict=True):
        single = state.copy()
        advance(record, single, target)
        np.testing.assert_array_equal(single[X : THETA + 1], pose)


def test_coverage_is_the_area_that_shapely_finds():
    rng = np.random.default_rng(0)
    block = make_block()
    record = block.make_record(TRUE)
    task = make_controller()._make_task()
    goal = transform_shape(np.array(GOAL), block.outline)
    found = []
    for i in range(200):
        pose = np.array(GOAL) + (i / 200) * rng.normal(0.0, [15.0, 15.0, 0.5])
        common = goal.intersection(transform_shape(pose, block.outline)).area / goal.area
        found.append(calc_coverage(record, task, pose))
        assert found[-1] == pytest.approx(common, abs=1e-9)
    assert min(found) < 0.5 < 0.9 < max(found)


def test_the_even_estimate_is_that_of_the_area():
    block = make_block()
    rng = np.random.default_rng(0)
    points = rng.uniform([-60, 0], [60, 120], (40000, 2))
    inside = points[[block.outline.contains(Point(point)) for point in points]]
    middle = inside.mean(axis=0)
    estimate = block.even_estimate
    np.testing.assert_allclose([estimate.center_x, estimate.center_y], middle, atol=0.7)
    spread = np.sqrt(((inside - middle) ** 2).sum(axis=1).mean())
    assert estimate.arm == pytest.approx(spread, rel=0.01)


def test_places_round_the_block_touch_it():
    block = make_block()
    ways = block.ways
    for touch, angle in zip(ways.touch, ways.inward, strict=True):
        assert block.outline.distance(Point(touch)) == pytest.approx(15.0, abs=0.05)
        ahead = touch + 16.0 * np.array([np.cos(angle), np.sin(angle)])
        assert block.outline.buffer(0.1).contains(Point(ahead))
    assert not any(block.outline.buffer(15.0).contains(Point(point)) for point in ways.ring)


DISC = DrivenDisc(1.0, 100.0, 20.0, 0.01, 10, 0.0, 10.0)
SQUARE = [(0, 0), (1, 0), (1, 1), (0, 1)]


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: SlidingBlock(parts=(), disc=DISC), "parts: expected convex polygons"),
        (
            lambda: SlidingBlock(parts=([(0, 0), (2, 0), (1, 0.1), (1, 2)],), disc=DISC),
            "one is not convex",
        ),
        (
            lambda: SlidingBlock(parts=(SQUARE, np.array(SQUARE) + 5.0), disc=DISC),
            "they are apart",
        ),
        (lambda: SlidingBlock(parts=(SQUARE, SQUARE[:3]), disc=DISC), "as many corners each"),
        (
            lambda: SlidingBlock(parts=([(0, 0), (np.nan, 0), (1, 1)],), disc=DISC),
            "expected convex",
        ),
        (lambda: DrivenDisc(0.0, 100.0, 20.0, 0.01, 10, 0.0, 10.0), "radius is 0.0; expected"),
        (lambda: DrivenDisc(1.0, 100.0, 20.0, 0.01, 10, 5.0, 5.0), "low is 5.0; expected less"),
        (lambda: BlockEstimate(np.nan, 0.0, 1.0), "must be finite"),
        (lambda: BlockEstimate(0.0, 0.0, -1.0), "arm is -1.0; expected"),
    ],
)
def test_refuses_what_is_no_block(make, says):
    with pytest.raises(PlanningError, match=says):
        make()


def test_a_clockwise_part_is_turned():
    turned = SlidingBlock(parts=(SQUARE[::-1],), disc=DISC)
    assert Polygon(turned.parts[0]).exterior.is_ccw


@pytest.mark.parametrize("center", [None, (20.0, 20.0)])
def test_it_is_the_law_of_gym_pusht(center):
    """Away from the walls, every decision of a random player."""
    pytest.importorskip("gym_pusht")
    env = make_environment(None if center is None else np.array(center))
    mine = BlockEstimate(*(center or CENTER), arm=np.sqrt(3000.0))
    block = make_block()
    record = block.make_record(mine)
    rng = np.random.default_rng(5)
    off = []
    for seed in range(10000, 10006):
        observation, info = env.reset(seed=seed)
        state = np.zeros(STATE_SIZE)
        for _ in range(60):
            state[PX : PX + 2] = observation[:2]
            state[X : THETA + 1] = observation[2:5]
            # aim beyond the block, so that it is pushed
            target = observation[2:4] + rng.uniform(-100.0, 100.0, 2)
            target = np.clip(target, 0.0, 512.0)
            corners = transform(
                observation[2:5], np.concatenate([np.array(p) for p in block.parts])
            )
            inside = block.outline.contains(
                Point(transform_back_point(observation[2:5], observation[:2]))
            )
            advance(record, state, target)
            observation, *_, info = env.step(target)
            if corners.min() > 60.0 and corners.max() < 450.0 and not inside:
                error = state[X : THETA + 1] - observation[2:5]
                error[2] = np.angle(np.exp(1j * error[2]))
                off.append(np.abs(error).max())
                np.testing.assert_allclose(state[PX : PX + 2], observation[:2], atol=1e-9)
                np.testing.assert_allclose(state[VX : VX + 2], info["vel_agent"], atol=1e-9)
    assert len(off) > 50
    assert np.quantile(off, 0.9) < 1e-5
    # where the disc is in the inner corner, two contacts share the load; the solvers differ a little
    assert max(off) < 0.1


def transform_back_point(pose, point):
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return np.array([[c, s], [-s, c]]) @ (point - pose[:2])
