"""`gridpush bench feedback`: what it measures, and what it refuses."""

import numpy as np
import pytest

from gridpush_drake.bench.steering.experiments import STUDY, list_models
from gridpush_drake.bench.steering.runs import (
    DISTURBED_RUN,
    EVEN_MODEL,
    GOAL_RUN,
    LEARNED_MODEL,
    PATH_RUN,
    PRIMITIVE_PLANNER,
    TRUE_MODEL,
    FeedbackJob,
    Followed,
    find_side,
    make_path,
    run_job,
)
from gridpush_drake.bench.steering.worlds import (
    LCP_WORLD,
    POSE_SENSOR,
    draw_poke,
)
from gridpush_drake.bench.study import Done
from gridpush_drake.bench.truth.mujoco_world import MujocoWorld
from gridpush_drake.bench.truth.sets import FOUNDATION_KIND, draw_masses, make_body
from gridpush_drake.errors import GridPushError
from gridpush_drake.geometry.se2 import make_direction, rotate
from gridpush_drake.identification.model import Model
from gridpush_drake.planning.feedback.steered_finger import SteeredFinger
from gridpush_drake.planning.world import SimulatedWorld

NAME = "combination_wrench"


def make_result(**changes):
    fields = {
        "kind": PATH_RUN,
        "world": LCP_WORLD,
        "name": NAME,
        "model": LEARNED_MODEL,
        "seed": 0,
        "status": "reached",
        "reached": True,
        "time": 10.0,
        "rms": 0.001,
        "distance": 0.001,
        "turn": 0.01,
        "decision": 0.02,
    }
    return Followed(**{**fields, **changes})


@pytest.mark.slow
def test_the_learned_model_follows_the_path():
    path = run_job(FeedbackJob(PATH_RUN, LCP_WORLD, NAME, LEARNED_MODEL, 0))
    assert path.reached
    assert path.rms < 0.003


@pytest.mark.slow
def test_the_learned_model_reaches_the_goal():
    goal = run_job(FeedbackJob(GOAL_RUN, LCP_WORLD, NAME, LEARNED_MODEL, 0))
    assert (goal.status, goal.reached) == ("reached", True)
    assert goal.distance < 0.003
    assert 0 < goal.decision < 1.0
    assert np.isnan(goal.rms)


def test_strokes_are_timed_by_the_fingers_way():
    run = run_job(FeedbackJob(GOAL_RUN, LCP_WORLD, NAME, PRIMITIVE_PLANNER, 0))
    assert run.model == PRIMITIVE_PLANNER
    # the way to the goal at the finger's speed, at least
    assert run.time > 0.2 / 0.1
    assert np.isnan(run.decision)


def test_a_rod_in_mujoco_is_steered_and_takes_the_body_along():
    pytest.importorskip("mujoco")
    rng = np.random.default_rng(0)
    obj, truth = draw_masses(NAME, rng)
    body = make_body(FOUNDATION_KIND, obj, truth, rng)
    left = float(obj.outline.bounds[0])
    world = MujocoWorld(body, 0.008, pose=np.zeros(3))
    finger = SteeredFinger(world, (left - 0.012, 0.0), 0.008, POSE_SENSOR)
    start = finger.pose
    came = [seen for _ in range(25) for seen in finger.move((0.1, 0.0))]
    assert finger.tip == pytest.approx([left + 0.038, 0.0])
    assert np.hypot(*(finger.pose - start)[:2]) > 0.02
    # late, in order, and not all of them
    assert all(seen.time <= finger.time - POSE_SENSOR.delay + 1e-9 for seen in came)
    assert 10 <= len(came) < 25
    assert np.diff([seen.time for seen in came]).min() > 0
    world.put((0.1, 0.2, 0.3))
    assert finger.pose == pytest.approx([0.1, 0.2, 0.3], abs=1e-3)


def test_a_poke_moves_the_object_and_is_seen():
    rng = np.random.default_rng(3)
    obj, truth = draw_masses(NAME, rng)
    seen = draw_poke(SimulatedWorld(Model(obj, truth), np.zeros(3)), obj, rng, 1)
    assert seen.name == "poke_2"
    begin, end = obj.cells_at(np.array([seen.pose, seen.final_pose]))
    assert np.linalg.norm(end - begin, axis=1).mean() >= 0.01


def test_the_path_begins_where_the_object_lies_with_its_longest_side_behind():
    obj, _ = draw_masses(NAME, np.random.default_rng(0))
    path, pose = make_path(obj)
    assert path.poses[0, :2] == pytest.approx(pose[:2], abs=0.01)
    assert rotate(pose[2], make_direction(np.array(find_side(obj)))) == pytest.approx([1.0, 0.0])


def test_the_jobs_and_their_tables():
    pytest.importorskip("mujoco", reason="mujoco is not installed")
    options = STUDY.options(worlds=(LCP_WORLD, FOUNDATION_KIND), objects=(NAME,), runs=2)
    jobs = STUDY.make_jobs(options)
    count = sum(
        len(list_models(k, w))
        for k in (PATH_RUN, GOAL_RUN, DISTURBED_RUN)
        for w in (LCP_WORLD, FOUNDATION_KIND)
    )
    assert len(set(jobs)) == len(jobs) == 2 * count
    assert TRUE_MODEL not in list_models(PATH_RUN, FOUNDATION_KIND)
    job = jobs[0]
    results = [
        make_result(),
        make_result(rms=0.004),
        make_result(reached=False, status="stuck"),
        make_result(kind=GOAL_RUN, rms=np.nan, time=4.0),
        make_result(kind=GOAL_RUN, rms=np.nan, time=9.0, model=EVEN_MODEL),
    ]
    path, goal = STUDY.tabulate(options, Done((job, each) for each in results))
    row = dict(zip(path.columns, path.rows[0], strict=True))
    assert row["runs"] == 3
    assert row["to the end"].startswith("2 (")
    assert row["RMS within 3 mm"].startswith("1 (")
    assert row["RMS, median, mm"] == pytest.approx(2.5)
    assert [each[1] for each in goal.rows] == [LEARNED_MODEL, EVEN_MODEL]
    chosen = STUDY.make_jobs(
        STUDY.options(worlds=(LCP_WORLD,), objects=(NAME,), models=(LEARNED_MODEL,), runs=1)
    )
    assert [(job.kind, job.model) for job in chosen] == [
        (kind, LEARNED_MODEL) for kind in (PATH_RUN, GOAL_RUN, DISTURBED_RUN)
    ]
    quick = STUDY.make_jobs(STUDY.shorten(STUDY.options()))
    assert {job.world for job in quick} == {LCP_WORLD}
    assert {job.seed for job in quick} == {0}


@pytest.mark.parametrize(
    ("chosen", "message"),
    [
        ({"kinds": ("dance",)}, "kind: 'dance'; expected one of path, goal, shove"),
        ({"models": ("best",)}, "model: 'best'; expected one of learned"),
        (
            {"models": (PRIMITIVE_PLANNER,), "kinds": (PATH_RUN,), "worlds": (LCP_WORLD,)},
            "expected one of learned",
        ),
        ({"worlds": ("mars",)}, "world: 'mars'; expected one of lcp"),
        ({"runs": 0}, "runs: none"),
        ({"objects": ("teapot",), "worlds": (LCP_WORLD,)}, "teapot"),
    ],
)
def test_refuses_what_it_does_not_know(chosen, message):
    with pytest.raises(GridPushError, match=message):
        STUDY.make_jobs(STUDY.options(**chosen))
