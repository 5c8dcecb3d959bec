from dataclasses import replace

import numpy as np
import pytest

from gridpush_drake.bench.data.protocol import ANGLE_STD, POSITION_STD, add_pose_noise
from gridpush_drake.bench.pregrasp import experiments as pregrasp
from gridpush_drake.bench.pregrasp.experiments import OBJECTS_OF_BENCH
from gridpush_drake.bench.pregrasp.exploring import (
    ALONG_OBJECT,
    MAX_POKES,
    explore,
    tabulate_exploration,
    tabulate_exploration_by_object,
)
from gridpush_drake.bench.pregrasp.sliding import (
    SlideScore,
    load_bench_object,
    make_table,
    tabulate_slides,
)
from gridpush_drake.bench.pregrasp.world import EdgeWorld, MujocoEdgeWorld, PreGraspOutcome
from gridpush_drake.dynamics.push import Push
from gridpush_drake.errors import GridPushError, PushError
from gridpush_drake.geometry.se2 import transform
from gridpush_drake.identification.model import Model
from gridpush_drake.jobs.run import Execution

NOISE = {"position_std": POSITION_STD, "angle_std": ANGLE_STD}


def test_hidden_parameters_stay_within_what_is_told(monkeypatch):
    obj = load_bench_object("pliers", pregrasp.FRICTION_RANGE)
    truths = [pregrasp.make_truth(obj, i) for i in range(5)]
    low, high = pregrasp.FRICTION_RANGE
    assert (obj.prior.friction_min, obj.prior.friction_max, obj.prior.total_mass) == (
        low,
        high,
        None,
    )
    assert all((low <= truth.friction).all() and (truth.friction <= high).all() for truth in truths)
    assert len({round(float(truth.mass[0]), 6) for truth in truths}) == 5
    again = pregrasp.make_truth(obj, 3)
    np.testing.assert_array_equal(again.mass, truths[3].mass)
    assert again.contact_friction == truths[3].contact_friction


def test_tables_take_turns():
    assert [len(make_table(seed).corners) for seed in range(3)] == [4, 120, 6]
    assert make_table(3).polygon.equals(make_table(0).polygon)


def test_the_world_drops_what_is_pushed_off():
    obj = load_bench_object("toothpaste_tube", pregrasp.FRICTION_RANGE)
    world = EdgeWorld(
        Model(obj, pregrasp.make_truth(obj, 0)), (0.3, 0.0, 0.0), make_table(0), **NOISE
    )
    assert 0 < np.abs(world.observe() - world.truth.pose).max() < 0.02
    assert not world.execute(Push((0.19, 0.0), (0.03, 0.0), 1.0, 0.008)).overhang
    assert not world.truth.fallen
    assert world.truth.stays
    assert world.truth.pose[0] > 0.31
    for _ in range(12):
        x, y, theta = world.truth.pose
        start = np.array([x, y]) - 0.108 * np.array([np.cos(theta), np.sin(theta)])
        seen = world.execute(Push(start, (0.03, 0.0), 1.0, 0.008))
        if world.truth.fallen:
            break
    assert world.truth.fallen
    assert not world.truth.stays
    assert world.observe() is None
    assert seen.overhang
    world.put((0.0, 0.0, 0.0))
    assert world.observe() is not None
    assert world.truth.stays


@pytest.mark.slow
def test_a_body_in_mujoco_moves_alike_and_drops():
    pytest.importorskip("mujoco", reason="MuJoCo is in the extra `bench`")
    obj = load_bench_object("toothpaste_tube", pregrasp.FRICTION_RANGE)
    truth = pregrasp.make_truth(obj, 0)
    body = MujocoEdgeWorld(Model(obj, truth), (0.3, 0.0, 0.0), make_table(0), support="half_height")
    model = EdgeWorld(Model(obj, replace(truth, push_height=0.015)), (0.3, 0.0, 0.0), make_table(0))
    with pytest.raises(PushError, match=f"expected that of the world's pusher, {body.radius:g} m"):
        body.execute(Push((0.19, 0.01), (0.03, 0.0), 1.5, 0.008))
    push = Push((0.188, 0.01), (0.03, 0.0), 1.5, body.radius)
    assert not body.execute(push).overhang
    model.execute(push)
    true, expected = body.truth.pose, model.truth.pose
    assert np.linalg.norm(expected[:2] - [0.3, 0.0]) > 0.005
    np.testing.assert_allclose(true[:2], expected[:2], atol=0.002)
    assert abs(true[2] - expected[2]) < np.radians(2)
    assert body.truth.stays
    np.testing.assert_array_equal(body.truth.pose, true)  # to ask changes nothing
    for _ in range(6):
        x, y, theta = body.truth.pose
        start = np.array([x, y]) - 0.11 * np.array([np.cos(theta), np.sin(theta)])
        body.execute(Push(start, (0.05, 0.0), 1.0, body.radius))
        if body.truth.fallen:
            break
    assert body.truth.fallen
    assert body.observe() is None


@pytest.mark.slow
def test_a_light_end_over_the_edge_rests_there_and_is_not_flung_up():
    """One of three feet, which bears 4 % of the weight a quarter of a meter off, leaves the table."""
    pytest.importorskip("mujoco", reason="MuJoCo is in the extra `bench`")
    obj, mass_set = load_bench_object("claw_hammer", (0.2, 0.6)), 8
    rng = np.random.default_rng([0, mass_set])
    rng.uniform(size=3)
    world = MujocoEdgeWorld(
        Model(obj, pregrasp.make_truth(obj, mass_set)),
        np.zeros(3), make_table(0), seed=rng, support="three_feet",
    )  # fmt: skip
    world.put((0.14976997, -0.19900505, -3.48661867))
    world.execute(Push((0.07897363, -0.16276592), (-0.01204642, -0.02747515), 5.0, world.radius))
    motion = world.truth.motion
    feet = world.surface.signed_distances(transform(motion.poses[-1], world.body.feet[:3]))
    assert sorted(feet > 0) == [False, True, True]
    assert np.degrees(motion.tilt.max()) < 1


@pytest.mark.slow
def test_truths_are_measured_beside_each_other():
    pytest.importorskip("mujoco", reason="MuJoCo is in the extra `bench`")
    truths, by_object = pregrasp.STUDY.run(
        objects=("toolbox",),
        mass_sets=1,
        seeds=1,
        truths=("three_feet", "lcp"),
        execution=Execution(workers=0),
    )
    assert [row[:2] for row in truths.rows] == [["three_feet", 1], ["lcp", 1]]
    assert [row[2] for row in truths.rows] == ["100 (21-100)"] * 2
    assert [row[3] for row in truths.rows] == ["0 (0-79)"] * 2
    assert min(row[6] for row in truths.rows) > 2.0
    assert len(truths.split(80)) == len(by_object.rows) == 1


@pytest.mark.slow
def test_materials_are_measured_by_what_is_told(monkeypatch):
    monkeypatch.setattr(pregrasp, "KNOWN_FRICTION_BOUNDS", {"0.2 to 0.8": (0.2, 0.8)})
    table, _ = pregrasp.STUDY.run(
        objects=("toolbox",),
        mass_sets=1,
        seeds=1,
        experiment=pregrasp.MATERIALS_EXPERIMENT,
        execution=Execution(workers=0),
    )
    assert table.rows[0][:2] == ["0.2 to 0.8", 1]
    assert table.rows[0][3] == "0 (0-79)"


def test_one_part_is_of_rubber():
    obj = load_bench_object("toolbox", (0.3, 0.4))
    drawn = [pregrasp.draw_materials(obj, i) for i in range(6)]
    for friction in drawn:
        assert len(np.unique(obj.labels[friction == pregrasp.RUBBER_FRICTION])) == 1
        assert set(friction) == {pregrasp.RUBBER_FRICTION, pregrasp.STEEL_FRICTION}
    assert len({tuple(friction) for friction in drawn}) > 1


@pytest.mark.slow
def test_bounds_that_hold_contain_the_center_and_tip_nothing():
    table = pregrasp.STUDY.run(
        objects=("pliers",),
        mass_sets=2,
        seeds=1,
        experiment=pregrasp.BOUNDS_EXPERIMENT,
        friction=(0.3, 0.4),
        execution=Execution(workers=0),
    )[0]
    rows = {row[0]: row[1:] for row in table.rows}
    assert rows["0.3 to 0.4, drawn"] == [2, "100 (34-100)", "0 (0-66)", 0, 0.0]
    assert rows["0.2 to 0.8, rubber"][2:] == ["0 (0-66)", 0, 0.0]
    assert rows["0.3 to 0.4, rubber"][3] == 2
    assert (
        rows["0.3 to 0.4, rubber"][4]
        > rows["0.25 to 0.5, rubber"][4]
        > rows["0.2 to 0.6, rubber"][4]
        > 1.0
    )
    assert len(table.split(80)) == 1


def test_noise_is_as_large_as_it_says():
    rng = np.random.default_rng(0)
    noise = np.array([add_pose_noise(np.zeros(3), rng) for _ in range(2000)])
    np.testing.assert_allclose(noise.std(axis=0), [0.0005, 0.0005, 0.003], rtol=0.1)


def test_the_table_counts_what_happened():
    outcomes = [
        PreGraspOutcome(True, False, 3, 2, ""),
        PreGraspOutcome(False, True, 1, 1, ""),
        PreGraspOutcome(False, False, 5, 0, ""),
    ]
    table = tabulate_slides(
        [SlideScore("pliers", "learned", outcome) for outcome in outcomes], ["learned"]
    )
    assert tuple(table.rows[0]) == ("learned", 3, pytest.approx(100 / 3), 1, 1, 3.0, 1.0)


def test_runs_with_the_true_parameters():
    tables = pregrasp.STUDY.run(
        objects=("toolbox",),
        mass_sets=1,
        seeds=1,
        methods=["true"],
        experiment=pregrasp.SLIDING_ONLY,
        execution=Execution(workers=0),
    )
    assert tuple(tables[0].rows[0][:4]) == ("true", 1, 100.0, 0)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"objects": ["open_book"]}, "objects: open_book"),
        ({"methods": []}, "methods: none"),
        ({"mass_sets": 0}, "mass sets: 0"),
        ({"seeds": -1}, "seeds: -1"),
        ({"truths": ["jelly"]}, "truths: jelly"),
        ({"max_arm": 0.0}, "max arm: 0"),
        ({"friction": (0.4, 0.3)}, "friction: 0.4 to 0.3"),
    ],
)
def test_refuses_what_makes_no_sense(arguments, says):
    with pytest.raises(GridPushError, match=says):
        pregrasp.STUDY.run(**arguments)


@pytest.mark.slow
def test_pokes_by_design_are_fewer_and_the_spread_is_honest():
    scores = []
    for i, name in enumerate(OBJECTS_OF_BENCH[:2]):
        obj = load_bench_object(name, pregrasp.FRICTION_RANGE)
        scores.append(explore(obj, pregrasp.make_truth(obj, i), name, i, 0, ALONG_OBJECT))
    designed = np.mean([score.active.pokes for score in scores])
    assert designed < np.mean([score.random.pokes for score in scores])
    assert designed < MAX_POKES
    assert max(score.active.error for score in scores) < 0.02
    assert tabulate_exploration(scores).rows[0][:3] == [ALONG_OBJECT, 40.0, 2]
    assert len(tabulate_exploration_by_object(scores, OBJECTS_OF_BENCH).rows) == 2


@pytest.mark.slow
def test_what_was_learned_drops_nothing():
    tables = pregrasp.STUDY.run(
        objects=("pliers", "toolbox"),
        mass_sets=2,
        seeds=1,
        methods=["learned"],
        experiment=pregrasp.SLIDING_ONLY,
    )
    assert tables[0].rows[0][3] == 0
    assert tables[0].rows[0][2] >= 75.0
