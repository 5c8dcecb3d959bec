"""The bench of several objects: rows that are pushed, MuJoCo beside the model, and its tables."""

import numpy as np
import pytest

from gridpush_drake.bench.multi_object.experiments import (
    STUDY,
    SceneBenchOptions,
    ScenePushJob,
    SceneScore,
    make_speed_table,
)
from gridpush_drake.bench.multi_object.joint_learning import LearnJob, LearnScore, make_learn_table
from gridpush_drake.bench.multi_object.scene_plant import MakePlantScene
from gridpush_drake.bench.multi_object.scene_rows import (
    PAIR_FRICTION,
    PUSHER_FRICTION,
    PUSHER_RADIUS,
    draw_row,
    load_objects,
    make_mujoco_scene,
)
from gridpush_drake.bench.study import Done
from gridpush_drake.dynamics.physics import Physics
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.identification.prediction import calc_pose_error
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from tests.helpers.scene_cases import Layout
from tests.helpers.shapes import rectangle


def test_two_blocks_move_in_mujoco_as_in_the_model():
    """Bodies that bear their own weight: our model's assumption, in a body of six degrees of freedom."""
    pytest.importorskip("mujoco")
    obj = GridObject.from_outline(rectangle(0.08, 0.05), max_cells=40)
    heavy = np.where(obj.p_BC[:, 1] > 0, 3.0, 1.0)
    params = CellParameters(0.5 * heavy / heavy.sum(), np.full(obj.n, 0.35), PUSHER_FRICTION)
    scene = Layout.of(
        [(obj, params, (0.0, 0.0, 0.0)), (obj, params, (0.083, 0.02, 0.1))], PAIR_FRICTION
    )
    push = Push((-0.04 - PUSHER_RADIUS, 0.004), (0.05, 0.0), 1.2, PUSHER_RADIUS)
    ours = scene.simulate(push)
    theirs = make_mujoco_scene(*scene, push)(np.array([0.0, push.duration]))
    np.testing.assert_allclose(theirs[0], scene.poses, atol=1e-6)
    for b in range(2):
        moved = calc_pose_error(obj, theirs[-1, b], scene.poses[b]).cell
        error = calc_pose_error(obj, ours.final_pose[b], theirs[-1, b]).cell
        print(f"block {b}: moved {1e3 * moved:.1f} mm, off by {1e3 * error:.2f} mm")
        assert moved > 0.02
        assert error < 0.001


def test_two_blocks_move_in_the_plant_as_in_the_model():
    """The same in Drake's plant, where a rough tip and rough sides rub as is wanted."""
    obj = GridObject.from_outline(rectangle(0.08, 0.05), max_cells=24)
    heavy = np.where(obj.p_BC[:, 1] > 0, 3.0, 1.0)
    params = CellParameters(0.5 * heavy / heavy.sum(), np.full(obj.n, 0.35), PUSHER_FRICTION)
    scene = Layout.of(
        [(obj, params, (0.0, 0.0, 0.0)), (obj, params, (0.083, 0.02, 0.1))], PAIR_FRICTION
    )
    push = Push((-0.04 - PUSHER_RADIUS, 0.004), (0.05, 0.0), 1.0, PUSHER_RADIUS)
    ours = simulate(scene.bodies.with_physics(Physics(spin="none")), push, scene.poses)
    theirs = MakePlantScene(*scene, push)(np.array([0.0, push.duration]))
    np.testing.assert_allclose(theirs[0], scene.poses, atol=1e-9)
    for b in range(2):
        moved = calc_pose_error(obj, theirs[-1, b], scene.poses[b]).cell
        error = calc_pose_error(obj, ours.final_pose[b], theirs[-1, b]).cell
        print(f"block {b}: moved {1e3 * moved:.1f} mm, off by {1e3 * error:.2f} mm")
        assert moved > 0.015
        assert error < 0.0005


def test_a_push_is_drawn_that_moves_all_objects():
    objects = load_objects(2)
    bodies, poses, push = draw_row(objects, 0)
    motion = simulate(bodies, push, poses)
    for obj, last, first in zip(objects, motion.final_pose, poses, strict=True):
        assert calc_pose_error(obj, last, first).cell > 1e-4


def test_its_tables():
    options = SceneBenchOptions(counts=(2,))
    score = SceneScore(
        2, moved=0.05, last_moved=0.02, drake=0.001, mujoco=0.002, between=0.003, solved=True
    )
    learned = LearnScore(2, "model", even=0.01, learned=0.001, true=0.0, held=1.0)
    compared, learning = STUDY.tabulate(
        options, Done([(ScenePushJob(2, 0), score), (LearnJob(2, 0, "model"), learned)])
    )
    assert compared.rows[0][:2] == [2, 1]
    assert learning.rows == make_learn_table([learned]).rows
    assert learning.rows[0][:3] == ["model", 2, 1]
    table = make_speed_table((1, 2), 3)
    assert [row[0] for row in table.rows] == [1, 2]
    assert all(row[3] > 0 for row in table.rows)
