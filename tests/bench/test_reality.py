"""`gridpush bench reality`: every set of real pushes by every model and simulator, in one table."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from gridpush_drake.bench.data.real_logs import (
    CMU_LOG,
    DUBINS_LOG,
    IMPORTED_LOG,
    TWO_POINT_LOG,
    simulate_log,
)
from gridpush_drake.bench.data.real_sets import PUSH_COUNTS, calc_error, divide, read_set
from gridpush_drake.bench.reality.experiments import (
    STUDY,
    RealityBenchOptions,
    calc_run_score,
    find_ends,
    find_run_end,
    hasten,
    make_jobs,
    run_job,
    tabulate,
)
from gridpush_drake.bench.reality.scores import (
    DRAKE_ENGINE,
    EVEN_MODEL,
    FRAME_MODEL,
    LCP_ENGINE,
    LEARNED_MODEL,
    MUJOCO_ENGINE,
    PLANT_SPEED,
    SET_MODEL,
    STILL_MODEL,
    RealityJob,
    RealityScore,
)
from gridpush_drake.bench.study import Done
from gridpush_drake.bench.worlds.mujoco_plant import MujocoPlant
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.pusher import PusherShape
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import GridPushError
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import find_shipped_object
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.pushes.importers.cmu import triangle_block
from gridpush_drake.pushes.push_log import ObservedPush, PushLog
from tests.helpers.scene_cases import PLATE, TIPS
from tests.helpers.shapes import rectangle
from tests.helpers.shared_data import shared_data
from tests.helpers.two_tip_logs import (
    FINGERS,
    describe_two_point,
    simulate_run,
    simulate_two_point,
    write_runs,
    write_two_point,
)

CLEARANCE = 0.002
"""Distance of a pusher from the object before it is moved, m."""


def test_without_data_simulated_pushes_stand_in():
    jobs = make_jobs(RealityBenchOptions(plants=False, splits=1, test=2))
    assert [job.name for job in jobs] == ["claw_hammer", "toolbox"]
    options = RealityBenchOptions(plants=False, splits=1, test=2)
    (table,) = tabulate(options, Done([(jobs[0], run_job(jobs[0]))]))
    assert "Nothing here is real" in table.notes[0]
    rows = {(row[1], row[2]): row[3].mean for row in table.rows}
    assert rows[LEARNED_MODEL, 25] < rows[EVEN_MODEL, 0] < rows[STILL_MODEL, 0]
    with pytest.raises(GridPushError, match="--test: 26; expected at most 25"):
        make_jobs(RealityBenchOptions(test=26))


@pytest.mark.slow
def test_what_was_imported_is_a_set_named_by_its_folder(tmp_path):
    log, obj = simulate_log(find_shipped_object("pliers"), 0, 0)
    folder = tmp_path / "steel_block"
    folder.mkdir()
    log.write_csv(folder / "pushes.csv")
    obj.write_yaml(folder / "object.yaml")
    log[:3].write_csv(folder / "too_few.csv")
    (job,) = make_jobs(RealityBenchOptions(data=tmp_path, plants=False, splits=1, test=4))
    assert (job.name, job.kind) == ("steel_block", IMPORTED_LOG)
    (table,) = tabulate(RealityBenchOptions(data=tmp_path), Done([(job, run_job(job))]))
    rows = {(row[1], row[2]): row[3].mean for row in table.rows}
    assert rows[LEARNED_MODEL, 25] < rows[EVEN_MODEL, 0] < rows[STILL_MODEL, 0]


def test_refuses_a_folder_without_pushes(tmp_path):
    with pytest.raises(GridPushError, match="expected push logs as of GitHub"):
        STUDY.run(data=tmp_path)


def test_slow_pushes_are_hastened_and_fast_ones_are_not():
    slow = Push((0.0, 0.0), (0.0, 0.0025), 6.4, 0.0005)
    made = hasten(slow)
    np.testing.assert_allclose(made.duration, slow.length / PLANT_SPEED)
    np.testing.assert_array_equal(made.xy, slow.xy)
    fast = Push((0.0, 0.0), (0.1, 0.0), 0.5, 0.0005)
    assert hasten(fast) is fast


def test_an_error_counts_turns_by_the_shorter_way():
    one = np.array([0.003, 0.0, np.pi - 0.01])
    other = np.array([0.0, 0.004, -np.pi + 0.01])
    assert calc_error(one, other) == pytest.approx(0.005 + 0.02 * 0.05 * 2**0.5)


def test_mujoco_pushes_as_the_model_says():
    pytest.importorskip("mujoco", reason="MuJoCo is in the extra `bench`")
    obj = GridObject.from_yaml(find_shipped_object("open_book"))
    params = CellParameters.random(obj, 1, (0.003, 0.03), (0.3, 0.5))
    pose = np.array([0.1, -0.2, 0.7])
    push = Push.on_outline(
        obj, 0.1, 0.2, 0.04, radius=0.008, speed=0.05, clearance=CLEARANCE, pose=pose
    )
    expected = simulate(Model(obj, params), push, pose, regime="inertial").final_pose
    assert calc_error(expected, pose) > 0.02
    plant = MujocoPlant(obj, params, PusherShape.disc(push.radius))
    assert calc_error(plant.push(push, pose), expected) < 1e-3
    # A second push begins from rest, and is the same
    np.testing.assert_array_equal(plant.push(push, pose), plant.push(push, pose))


@pytest.mark.parametrize("shape", [TIPS, PLATE])
def test_mujoco_pushes_with_a_shape_as_the_model_says(shape):
    pytest.importorskip("mujoco", reason="MuJoCo is in the extra `bench`")
    obj = GridObject.from_yaml(find_shipped_object("open_book"))
    params = CellParameters.random(obj, 1, (0.003, 0.03), (0.3, 0.5))
    side = obj.outline.bounds[0] - shape.core[:, 0].max() - shape.radius - CLEARANCE
    push = Push.about((side, 0.2), 0.3, shape=shape, start=(side, 0.01), duration=2.0)
    plant = MujocoPlant(obj, params, shape)
    pose = np.zeros(3)
    expected = simulate(Model(obj, params), push, pose, regime="quasi_static").final_pose
    assert calc_error(expected, pose) > 0.02
    assert calc_error(plant.push(push, pose), expected) < 1e-3


@pytest.mark.slow
def test_a_set_of_real_pushes_is_predicted_in_every_simulator():
    pytest.importorskip("mujoco", reason="MuJoCo is in the extra `bench`")
    path = shared_data("cmu_pushes", "hardboard_wide.txt")
    job = RealityJob(
        "hardboard_wide", CMU_LOG, path, 0, 4, (LCP_ENGINE, DRAKE_ENGINE, MUJOCO_ENGINE), 0
    )
    scores = run_job(job)
    means = {(s.model, s.training, s.engine): 1e3 * np.mean(s.errors) for s in scores}
    print(means)
    believed = [(EVEN_MODEL, 0), *((LEARNED_MODEL, count) for count in PUSH_COUNTS)]
    assert means.keys() == {(STILL_MODEL, 0, LCP_ENGINE)} | {
        (model, training, engine) for model, training in believed for engine in job.engines
    }
    assert all(len(score.errors) == 4 for score in scores)
    for engine in job.engines:
        # What was learned serves Drake and MuJoCo, too
        assert (
            means[LEARNED_MODEL, 25, engine]
            < means[EVEN_MODEL, 0, engine]
            < means[STILL_MODEL, 0, LCP_ENGINE]
        )
        assert abs(means[LEARNED_MODEL, 25, engine] - means[LEARNED_MODEL, 25, LCP_ENGINE]) < 1.0


def test_the_table_has_every_set_with_its_own_model():
    path = shared_data("mit_pushes", "abs_rect1.mat")
    options = RealityBenchOptions(data=path.parent, splits=2, test=3, plants=False)
    jobs = [job for job in make_jobs(options) if job.name == "abs_rect1"]
    assert [job.split for job in jobs] == [0, 1]

    def make(job):
        # Push 7 is held out twice
        pushes = (7, 8) if job.split else (7, 9)
        base = RealityScore(
            job.name, job.kind, job.split, STILL_MODEL, 0, LCP_ENGINE, pushes, (0.02, 0.02)
        )
        even = replace(base, model=EVEN_MODEL, errors=(0.006, 0.008))
        learned = [
            replace(base, model=LEARNED_MODEL, training=count, errors=(0.001 * job.split, 0.004))
            for count in PUSH_COUNTS
        ]
        return [base, even, *learned]

    (table,) = tabulate(options, Done((job, make(job)) for job in jobs))
    assert list(table.columns[:5]) == ["set", "model", "training", LCP_ENGINE, "repeated"]
    rows = {(row[1], row[2]): row[3] for row in table.rows}
    assert list(rows) == [
        (STILL_MODEL, 0),
        (EVEN_MODEL, 0),
        (LEARNED_MODEL, 5),
        (LEARNED_MODEL, 25),
        (SET_MODEL, None),
    ]
    assert rows[EVEN_MODEL, 0].mean == pytest.approx((6.0 + 8.0 + 8.0) / 3)
    errors = np.array([0.5, 4.0, 4.0])
    assert rows[LEARNED_MODEL, 5].mean == pytest.approx(errors.mean())
    half = stats.t.ppf(0.975, 2) * stats.sem(errors)
    assert rows[LEARNED_MODEL, 5].high == pytest.approx(errors.mean() + half)
    assert 1.0 < rows[SET_MODEL, None].mean < 10.0
    assert table.rows[0][4] is None


def test_a_set_of_two_point_pushes_is_divided_by_actions_and_says_what_is_stable(tmp_path):
    block = Model(triangle_block())
    # each action is made twice; the second time the block ends 1 mm farther on
    pushes = []
    for i, angle in enumerate(np.linspace(-0.3, 0.3, 20)):
        for again in (0, 1):
            end = simulate_two_point(block, angle) + [0.001 * again, 0, 0]
            stable = int(abs(angle) < 0.1)
            pushes.append(
                describe_two_point(f"a_{i}_{again}", np.zeros(3), end, angle, stable=stable)
            )
    path = write_two_point(tmp_path / "two.txt", pushes)
    known = read_set(path, TWO_POINT_LOG)
    assert known.calc_repeatability() == pytest.approx(0.001, rel=1e-6)
    division = divide(known, 4, seed=1, number=0)
    for count in PUSH_COUNTS:
        assert len(division.training[count]) == count
        kept = {known.groups[i] for i in division.training[count]}
        assert not kept & {known.groups[i] for i in division.test}

    job = RealityJob("two", TWO_POINT_LOG, path, 0, 4, (LCP_ENGINE,), 1)
    (table,) = tabulate(RealityBenchOptions(data=tmp_path), Done([(job, run_job(job))]))
    rows = {(row[1], row[2]): dict(zip(table.columns, row, strict=True)) for row in table.rows}
    even = rows[EVEN_MODEL, 0]
    assert even[LCP_ENGINE].mean < 1.1 < rows[STILL_MODEL, 0][LCP_ENGINE].mean
    assert even["repeated"] == pytest.approx(1.0)
    assert even["in 90 % region, %"] is None
    assert 0 <= rows[LEARNED_MODEL, 25]["in 90 % region, %"].mean <= 100
    assert 50 <= even["stable told, %"].mean <= 100


def test_runs_from_one_start_are_held_out_and_predicted_to_their_end(tmp_path):
    obj = GridObject.from_outline(rectangle(0.05, 0.035), max_cells=12)
    X_RC = np.array([0.002, -0.0015, 0.0])
    lines = [
        line
        for task, turns in {"a": [0.3, -0.3], "b": [-0.3, 0.2], "c": [0.25, -0.3]}.items()
        for repeat in (0, 1)
        for line in simulate_run(Model(obj), task, repeat, turns, X_RC)
    ]
    path = write_runs(tmp_path / "block.csv", obj, lines)
    options = RealityBenchOptions(data=tmp_path, splits=1, plants=False)
    (job,) = make_jobs(options)
    assert (job.name, job.kind) == ("block", DUBINS_LOG)
    known = read_set(path, DUBINS_LOG)
    assert [(run.group, len(run.pushes)) for run in known.runs] == [
        (group, 2) for group in (0, 0, 1, 1, 2, 2)
    ]
    tables = tabulate(options, Done([(job, run_job(job))]))
    pushes, runs = ({(row[1], row[2]): row for row in table.rows} for table in tables)
    assert list(pushes) == [
        (STILL_MODEL, 0),
        (EVEN_MODEL, 0),
        (LEARNED_MODEL, 3),
        (FRAME_MODEL, 3),
    ]
    place = tables[1].columns.index("end, mm")
    # as the camera tells them, whose frame is off, the ends are predicted worse
    raw = [
        calc_run_score(known.obj, find_run_end(Model(known.obj), run), run).position
        for run in known.runs[:2]
    ]
    assert runs[EVEN_MODEL, 0][place].mean < 0.7e3 * np.mean(raw)
    assert runs[STILL_MODEL, 0][place].mean > 20


@pytest.mark.slow
def test_the_plants_push_with_two_fingers_as_the_model_says():
    pytest.importorskip("mujoco", reason="MuJoCo is in the extra `bench`")
    model = Model(GridObject.from_outline(rectangle(0.1, 0.08), max_cells=30))
    push = Push.about((-0.053, 0.4), 0.15, shape=FINGERS, start=(-0.053, 0.0), duration=2.0)
    seen = ObservedPush("arc", push, np.zeros(3), np.array([2.0]), np.zeros((1, 3)))
    log = PushLog((seen,))
    (expected,) = find_ends(LCP_ENGINE, model, log)
    assert expected[2] > 0.14
    for engine in (DRAKE_ENGINE, MUJOCO_ENGINE):
        (end,) = find_ends(engine, model, log)
        assert calc_error(end, expected) < 1e-3
