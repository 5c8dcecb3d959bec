"""`gridpush bench scene-tasks`: its scenes, its judge, its tables and figure, and what it refuses."""

from dataclasses import replace

import numpy as np
import pytest

from gridpush_drake.bench.multi_object.scene_tasks import (
    EPISODE_JOBS,
    EPISODE_OBJECTS,
    FETCH_PART,
    FINE_REARRANGE_PART,
    REARRANGE_PART,
    SEPARATE_PART,
    STUDY,
    WANTED_CLEARANCE,
    SceneTaskJob,
    SceneTaskOptions,
    SceneTaskOutcome,
    load_objects,
    make_jobs,
    run_job,
    shorten,
    tabulate,
)
from gridpush_drake.bench.study import Done
from gridpush_drake.errors import GridPushError
from gridpush_drake.planning.scene.random_scenes import HEAP_GAP, HEAP_STEP, heap_up, scatter
from gridpush_drake.planning.scene.separation import calc_clearances


def make_outcome(**changes):
    fields = {
        "part": REARRANGE_PART,
        "count": 2,
        "seed": 0,
        "done": True,
        "reached": True,
        "fell": 0,
        "time": 60.0,
        "pushes": 9,
        "distance": 0.01,
        "turn": 0.1,
        "room": 0.05,
        "decision": 0.4,
        "reason": "every object lies at its goal",
    }
    return SceneTaskOutcome(**{**fields, **changes})


@pytest.mark.slow
def test_an_object_is_brought_to_its_goal_and_judged_by_the_truth():
    outcome = run_job(SceneTaskJob(REARRANGE_PART, 1, 4))
    assert outcome.reached and outcome.fell == 0
    assert outcome.distance < 0.025 and outcome.turn < 0.25
    assert outcome == replace(
        run_job(SceneTaskJob(REARRANGE_PART, 1, 4)), decision=outcome.decision
    )


def test_a_heap_is_separated():
    outcome = run_job(SceneTaskJob(SEPARATE_PART, 3, 0))
    assert (
        outcome.reached and outcome.room > WANTED_CLEARANCE - 0.003 and np.isnan(outcome.distance)
    )


@pytest.mark.slow
def test_an_object_is_fetched():
    outcome = run_job(SceneTaskJob(FETCH_PART, 2, 0))
    assert outcome.reached and outcome.fell == 0


def test_scenes_are_as_said():
    objects = load_objects(EPISODE_OBJECTS[:4])
    heap = heap_up(objects, np.random.default_rng(1))
    apart = calc_clearances(objects, heap)
    assert (apart > 0).all() and apart.min() < HEAP_GAP + HEAP_STEP
    spread = calc_clearances(objects, scatter(objects, np.random.default_rng(1), 0.02, 0.3))
    assert spread.min() >= 0.02


def test_jobs_are_those_asked_for():
    jobs = make_jobs(SceneTaskOptions(parts=(REARRANGE_PART,), seeds=2, seed=5))
    assert {(job.part, job.count) for job in jobs} == {
        (part, count) for part in (REARRANGE_PART, FINE_REARRANGE_PART) for count in (1, 2, 3, 4)
    }
    assert {job.seed for job in jobs} == {5, 6}
    quick = shorten(replace(SceneTaskOptions(), quick=True))
    assert len(make_jobs(quick)) == 8
    with pytest.raises(GridPushError, match="part: fly; expected some of rearrange, separate"):
        make_jobs(SceneTaskOptions(parts=("fly",)))


def test_tables_and_figure(tmp_path):
    figure = tmp_path / "times.png"
    outcomes = [
        make_outcome(),
        make_outcome(seed=1, time=120.0, reached=False, reason="not done after 60 pushes"),
        make_outcome(part=SEPARATE_PART, count=4, distance=np.nan, turn=np.nan),
    ]
    pairs = [(SceneTaskJob(one.part, one.count, one.seed), one) for one in outcomes]
    first, second = tabulate(SceneTaskOptions(figure=figure), Done(pairs))
    row = dict(zip(first.columns, first.rows[0], strict=True))
    assert row["episodes"] == 2 and row["done"].startswith("1 (")
    assert row["simulated, min"].mean == pytest.approx(1.5)
    assert "2 objects, seed 1: not done after 60 pushes" in first.notes
    assert second.title.startswith("Separating")
    assert figure.read_bytes().startswith(b"\x89PNG")
    assert STUDY.tasks == (EPISODE_JOBS,)
