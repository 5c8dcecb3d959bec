"""Bodies in MuJoCo bear, rub and shift their loads as each kind is said to."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from shapely import LineString

from gridpush_drake.bench.truth.sets import (
    TRUTH_KINDS,
    draw_masses,
    make_body,
    make_set,
    read_set,
    write_set,
)
from gridpush_drake.dynamics.physics import GRAVITY
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import GridPushError, PushError
from gridpush_drake.geometry.se2 import rotate
from gridpush_drake.identification.model import Model
from gridpush_drake.planning.stable.stable_push import calc_push_stability, calc_slip
from tests.helpers.scene_cases import PLATE, TIPS

pytest.importorskip("mujoco", reason="MuJoCo is in the extra `bench`")

from gridpush_drake.bench.stable_paths import (
    CLOSE_ENOUGH,
    STABLE_WAY,
    StableBenchOptions,
    StableJob,
    StableRun,
    make_jobs,
    run_job,
    tabulate_runs,
)
from gridpush_drake.bench.truth import mujoco_world
from gridpush_drake.bench.truth.mujoco_world import BODY_HEIGHT, MujocoWorld

RADIUS = 0.01


def make_world(kind, name="claw_hammer", seed=0):
    rng = np.random.default_rng(seed)
    obj, params = draw_masses(name, rng)
    return MujocoWorld(make_body(kind, obj, params, rng), RADIUS)


def make_push(obj, place, distance=0.05):
    return Push.on_outline(obj, place, 0.1, distance, radius=RADIUS, speed=0.05)


def calc_shift(world, push):
    """How far the load's center is from the center of mass at the push's end, along the push."""
    world.put((0, 0, 0))
    world.execute(push)
    theta = world.truth.pose[2]
    loads = world.read_loads()
    center = world.body.feet.T @ loads / loads.sum() - world.body.params.center_of_mass(
        world.body.obj
    )
    ahead = np.asarray(push.velocity) / np.linalg.norm(push.velocity)
    return float(ahead @ rotate(theta, center))


@pytest.mark.parametrize("kind", TRUTH_KINDS)
def test_loads_at_rest_are_in_equilibrium(kind):
    world = make_world(kind)
    params, feet = world.body.params, world.body.feet
    weight = params.total_mass * GRAVITY
    assert world.foot_loads.sum() == pytest.approx(weight, rel=1e-4)
    center = world.foot_loads @ feet / world.foot_loads.sum()
    world.put((0, 0, 0))
    leaning = BODY_HEIGHT / 2 * world.truth.tilt  # the center of mass is above the feet
    np.testing.assert_allclose(
        center, params.center_of_mass(world.body.obj), atol=1.01 * leaning + 1e-7
    )
    bearing = int((world.foot_loads > 1e-3 * weight).sum())
    expected = {"vertices": range(3, 8), "three_feet": [3], "foundation": range(20, 126)}
    assert bearing in expected.get(kind, [world.body.obj.n])


def test_each_cell_bears_its_own_weight_and_moves_as_the_model_says():
    world = make_world("own_weight")
    obj, params = world.body.obj, world.body.params
    np.testing.assert_allclose(world.loads, params.mass * GRAVITY, rtol=1e-6)
    push = make_push(obj, 0.1)
    world.put((0, 0, 0))
    world.execute(push)
    motion = world.truth.motion
    expected = simulate(Model(obj, params), push, regime="quasi_static").final_pose
    apart = np.linalg.norm(obj.cells_at(motion.poses[-1]) - obj.cells_at(expected), axis=1).mean()
    moved = np.linalg.norm(obj.cells_at(motion.poses[-1]) - obj.p_BC, axis=1).mean()
    assert moved > 0.02
    assert apart < 3e-4
    assert abs(calc_shift(world, push)) < 3e-4


@pytest.mark.parametrize("shape", [TIPS, PLATE])
def test_a_shape_that_turns_moves_a_body_as_the_model_says(shape):
    rng = np.random.default_rng(0)
    obj, params = draw_masses("open_book", rng)
    world = MujocoWorld(make_body("own_weight", obj, params, rng), shape)
    # a wide turn and a tight one
    front = shape.core[:, 0].max() + shape.radius
    side = obj.outline.bounds[0] - front - 1e-4
    for center in ((side, 0.3), (side, -0.04)):
        angle = np.copysign(0.3, center[1])
        push = Push.about(center, angle, shape=shape, start=(side, 0.02), duration=2.0)
        world.put((0, 0, 0))
        world.execute(push)
        end = world.truth.motion.poses[-1]
        expected = simulate(Model(obj, params), push, regime="quasi_static").final_pose
        # both turns are too tight for this body, which slips; so says the cone, and as far
        assert not calc_push_stability(Model(obj, params), push, count=1).is_stable
        slips = [calc_slip(obj, push, np.zeros(3), pose).distance for pose in (end, expected)]
        assert slips[1] > 0.04
        assert abs(slips[0] - slips[1]) < 5e-4
        apart = np.linalg.norm(obj.cells_at(end) - obj.cells_at(expected), axis=1).mean()
        assert np.linalg.norm(obj.cells_at(end) - obj.p_BC, axis=1).mean() > 0.01
        assert apart < 6e-4
    with pytest.raises(PushError, match="not by the pusher that the world has"):
        world.execute(make_push(obj, 0.1))


def test_pushed_above_the_table_the_load_moves_forward_by_h_f_over_w():
    world = make_world("three_feet", "toolbox")
    obj, mu = world.body.obj, float(world.body.params.friction[0])
    x, low = world.body.params.center_of_mass(obj)[0], obj.outline.bounds[1]
    below = LineString([(x, low - 1), (x, 1)]).intersection(obj.outline.exterior).geoms[0]
    place = obj.outline.exterior.project(below)
    push = Push.on_outline(obj, place, 0.0, 0.03, radius=RADIUS, speed=0.03)
    # pushed through its center of mass, it slides straight: all friction is against the push
    assert calc_shift(world, push) == pytest.approx(mu * world.body.push_height, rel=0.15)


def test_a_force_below_friction_moves_nothing():
    world = make_world("own_weight")
    params, data = world.body.params, world._data
    world.put((0, 0, 0))
    center = params.center_of_mass(world.body.obj)
    force = 0.95 * params.friction[0] * params.total_mass * GRAVITY
    data.qpos[7:9] = 0.0, 5.0
    data.qfrc_applied[[0, 5]] = force, -center[1] * force
    for _ in range(1000):
        world._mujoco.mj_step(world._model, data)
    assert np.abs(world._read_pose()).max() < 5e-5
    data.qfrc_applied[:] *= 1.1 / 0.95
    for _ in range(500):
        world._mujoco.mj_step(world._model, data)
    assert world._read_pose()[0] > 0.02


def test_a_set_is_reproducible_and_written_whole(tmp_path):
    made, again = (
        make_set("three_feet", "claw_hammer", 1, training=1, held_out=1) for _ in range(2)
    )
    assert made.training[0].name == "push_1"
    np.testing.assert_array_equal(made.held_out[0].final_pose, again.held_out[0].final_pose)
    write_set(made, tmp_path / "set")
    read = read_set(tmp_path / "set")
    assert (read.obj.labels == 1).all()
    assert (read.kind, read.name, read.seed, read.push_height) == (
        "three_feet",
        "claw_hammer",
        1,
        BODY_HEIGHT / 2,
    )
    np.testing.assert_array_equal(read.held_out[0].final_pose, made.held_out[0].final_pose)
    np.testing.assert_array_equal(read.loads, made.loads)
    np.testing.assert_array_equal(read.center_of_mass, made.center_of_mass)
    (tmp_path / "set" / "truth.json").write_text("{}")
    with pytest.raises(GridPushError, match=r"truth\.json: expected a truth"):
        read_set(tmp_path / "set")


def test_refuses_an_unknown_kind():
    with pytest.raises(GridPushError, match="kind: 'jelly'"):
        make_set("jelly", "claw_hammer", 0)


def test_edges_left_out_while_they_are_far_change_nothing(monkeypatch):
    obj, params = draw_masses("toolbox", np.random.default_rng(0))
    body = make_body("three_feet", obj, params, np.random.default_rng(0))
    body = replace(body, time_step=mujoco_world.EDGE_TIME_STEP)  # as near an edge everywhere
    left, low, right, high = obj.outline.bounds
    table = (left - 1.0, low - 1.0, right + 0.02, high + 1.0)
    push, ends = Push((left - RADIUS - 0.001, (low + high) / 2), (0.05, 0.0), 1.0, RADIUS), []
    for near in (10.0, mujoco_world.NEAR_EDGE):
        monkeypatch.setattr(mujoco_world, "NEAR_EDGE", near)
        world = MujocoWorld(body, RADIUS, table)
        world.put((0.0, 0.0, 0.0))
        world.execute(push)
        motion = world.truth.motion
        world.wait(0.2)
        ends.append(np.concatenate([motion.poses[-1], world.truth.pose, [world.truth.tilt]]))
    assert ends[0][0] > 0.03  # beyond the edge by a centimeter or more
    np.testing.assert_array_equal(ends[0], ends[1])


@pytest.mark.slow
def test_a_learned_body_comes_to_its_goal_unseen_by_stable_pushes():
    (run,) = run_job(StableJob("foundation", "spray_bottle", 500, (STABLE_WAY,)))
    assert 1 <= run.pushes <= 3
    assert run.probability >= 0.95
    assert run.position < CLOSE_ENOUGH
    assert run.angle < 0.01


def test_a_table_of_stable_pushes_counts_bodies_without_a_path_as_not_within():
    near = StableRun("foundation", "toolbox", 0, STABLE_WAY, 2, 0.001, 0.01, 0.002, 0.98, 1e-4)
    runs = [near, replace(near, position=0.006), replace(near, position=0.006, probability=0.8)]
    runs.append(replace(near, pushes=0, position=0.3, probability=np.nan, expected=np.nan))
    table = tabulate_runs(runs)
    row = dict(zip(table.columns, table.rows[0], strict=True))
    assert row["bodies"] == 4
    assert row["within 5 mm, %"] == 25
    assert row["median, mm"] == 6
    assert row["no path"] == 1
    assert row["sure, but not within"] == 1


def test_bodies_of_all_kinds_take_turns_and_each_round_has_its_seed():
    jobs = make_jobs(StableBenchOptions(seed=3, bodies=60))
    assert Counter(job.kind for job in jobs) == dict.fromkeys(TRUTH_KINDS, 12)
    assert Counter(job.seed for job in jobs) == {3: 25, 4: 25, 5: 10}
    assert len(set(jobs)) == 60
    with pytest.raises(GridPushError, match="kind"):
        make_jobs(StableBenchOptions(kinds=("ice",)))
