"""`gridpush bench feedback`: what it measures, and what it refuses."""

from dataclasses import replace

import numpy as np
import pytest

from gridpush_drake.bench.steering import hidden_weight
from gridpush_drake.bench.steering.experiments import STUDY, list_models
from gridpush_drake.bench.steering.hidden_weight import (
    GOAL_ANGLE,
    GOAL_POSITION,
    HAMMER_TASK,
    T_BOTTOM_TASK,
    T_MASS,
    T_TOP_TASK,
    T_UNIT,
    WEIGHT_MASS,
    WEIGHT_TASKS,
    SessionJob,
    draw_hidden_weight,
    run_session,
)
from gridpush_drake.bench.steering.runs import (
    DISTURBED_RUN,
    EVEN_MODEL,
    GOAL_RUN,
    LEARNED_MODEL,
    LEARNING_MODEL,
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
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.pusher import PusherShape
from gridpush_drake.errors import GridPushError, PlanningError
from gridpush_drake.geometry.se2 import make_direction, rotate
from gridpush_drake.identification.model import Model
from gridpush_drake.jobs.results import make_key
from gridpush_drake.planning.feedback.steered_finger import SteeredFinger, follow
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


def test_a_plate_in_mujoco_is_steered_as_it_pushes():
    pytest.importorskip("mujoco")
    rng = np.random.default_rng(0)
    obj, truth = draw_masses("toolbox", rng)
    body = make_body(FOUNDATION_KIND, obj, truth, rng)
    plate = PusherShape.plate(0.05, 0.02, 0.003)
    left = float(obj.outline.bounds[0])
    world = MujocoWorld(body, plate, pose=np.zeros(3))
    begin = (left - 0.004, 0.02, 0.0)
    finger = SteeredFinger(world, begin, plate.radius, POSE_SENSOR, shape=plate)
    for _ in range(25):
        finger.move((0.1, 0.0, 0.5))
    assert finger.tip == pytest.approx([left + 0.046, 0.02, 0.25])
    steered = finger.pose
    t = np.linspace(0.0, 0.5, 26)
    path = np.array(begin)[:2] + np.outer(t, [0.1, 0.0])
    world.put(np.zeros(3))
    world.execute(Push.along(t, path, shape=plate, yaw=0.5 * t))
    assert np.abs(steered).max() > 0.03
    assert steered == pytest.approx(world.truth.pose, abs=1e-6)
    with pytest.raises(PlanningError, match="shape: not that of this world's pusher"):
        world.steer(np.zeros(2), np.zeros(2), 0.1, plate.radius)


def test_jobs_of_a_disc_keep_the_keys_that_they_had():
    job = FeedbackJob(GOAL_RUN, LCP_WORLD, NAME, PRIMITIVE_PLANNER, 0)
    assert "pusher" not in make_key(job)
    assert "plate" in make_key(replace(job, pusher="plate:0.05x0.02x0.003"))
    assert "plate" in replace(job, pusher="plate:0.05x0.02x0.003").describe()


@pytest.mark.slow
def test_a_path_is_followed_by_the_plate_of_the_job():
    job = FeedbackJob(PATH_RUN, LCP_WORLD, NAME, TRUE_MODEL, 1, pusher="plate:0.05x0.02x0.003")
    run = run_job(job)
    assert run.reached
    assert run.rms < 2e-3


def test_only_what_is_steered_is_done_by_a_plate():
    options = STUDY.options(worlds=(LCP_WORLD,), objects=(NAME,), pusher="plate:0.05x0.02x0.003")
    jobs = STUDY.make_jobs(options)
    assert {job.pusher for job in jobs} == {options.pusher}
    assert PRIMITIVE_PLANNER not in {job.model for job in jobs}
    with pytest.raises(
        GridPushError, match="strokes and sessions with a hidden weight are by a disc"
    ):
        STUDY.make_jobs(replace(options, models=(PRIMITIVE_PLANNER,)))
    with pytest.raises(GridPushError, match="--pusher: is 'brush'; expected plate:WxTxR"):
        STUDY.make_jobs(replace(options, pusher="brush"))


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


def test_the_weight_of_a_t_is_below_its_bar_or_its_stem_and_nobody_sees_it():
    centers = {}
    for kind in WEIGHT_TASKS:
        obj, truth = draw_hidden_weight(kind, np.random.default_rng(0))
        assert (obj.labels == 1).all() and not obj.prior.uniform_parts
        low, high = obj.prior.friction_min, obj.prior.friction_max
        assert low <= truth.friction[0] <= high
        centers[kind] = truth.center_of_mass(obj) - obj.p_BC.mean(axis=0)
        if kind != HAMMER_TASK:
            assert truth.total_mass == pytest.approx(T_MASS + WEIGHT_MASS)
            # the centroid of 4 x 1 squares above 3 x 1 squares, from the middle of both
            x, y = obj.outline.centroid.coords[0]
            assert (x, y) == pytest.approx((0, T_UNIT * (4 * 1.5 + 3 * -0.5) / 7), abs=1e-9)
    share = WEIGHT_MASS / (T_MASS + WEIGHT_MASS)
    offset = T_UNIT * (4 * 1.5 + 3 * -0.5) / 7
    bottom = share * (-1.5 * T_UNIT - offset)
    assert centers[T_BOTTOM_TASK] == pytest.approx([0, bottom], abs=1e-9)
    assert centers[T_TOP_TASK] == pytest.approx([0, share * (1.5 * T_UNIT - offset)], abs=1e-9)
    assert np.linalg.norm(centers[HAMMER_TASK]) > 0.03


class EnoughError(Exception):
    """Ends an episode whose beginning is all that is looked at."""


@pytest.mark.slow
def test_a_session_carries_what_it_learned_into_the_next_episode(monkeypatch):
    begun = []

    def watch(follower, finger, most, **options):
        begun.append(options)
        return follow(follower, finger, most, **options)

    monkeypatch.setattr(hidden_weight, "follow", watch)
    monkeypatch.setattr(hidden_weight, "CELLS_PER_UNIT", 2)  # for speed
    job = SessionJob(T_BOTTOM_TASK, LCP_WORLD, LEARNING_MODEL, seed=1, episodes=2)
    first, second = run_session(job)
    assert first.reached and second.reached
    assert first.distance < GOAL_POSITION and first.turn < GOAL_ANGLE
    obj, truth = draw_hidden_weight(T_BOTTOM_TASK, np.random.default_rng((1, 53)))
    assert begun[0]["identification"] is None and not len(begun[0]["learner"].pokes)
    found = begun[1]["identification"]
    true = truth.center_of_mass(obj)
    even = np.linalg.norm(obj.p_BC.mean(axis=0) - true)
    assert np.linalg.norm(found.params.center_of_mass(obj) - true) < 0.3 * even
    assert len(begun[1]["learner"].pokes)

    # Another model is steered without a learner; how an episode begins tells it.
    def begin(*_, **options):
        raise EnoughError(options)

    monkeypatch.setattr(hidden_weight, "follow", begin)
    with pytest.raises(EnoughError) as seen:
        run_session(replace(job, model=EVEN_MODEL, episodes=1))
    (options,) = seen.value.args
    assert options["learner"] is None


def test_sessions_are_asked_for_by_name_and_tabulated():
    options = STUDY.options(kinds=WEIGHT_TASKS, worlds=(LCP_WORLD,), runs=2, episodes=3)
    jobs = STUDY.make_jobs(options)
    assert len(set(jobs)) == len(jobs) == 2 * 2 * len(WEIGHT_TASKS)
    assert {job.seed for job in jobs[: len(jobs) // 2]} == {0}  # body by body
    assert not any(
        isinstance(job, SessionJob) for job in STUDY.make_jobs(STUDY.shorten(STUDY.options()))
    )
    session = [make_result(kind=T_TOP_TASK, time=20.0), make_result(kind=T_TOP_TASK, time=10.0)]
    failed = [make_result(kind=T_TOP_TASK, time=8.0), make_result(kind=T_TOP_TASK, reached=False)]
    (table,) = STUDY.tabulate(options, Done([(jobs[0], session), (jobs[1], failed)]))
    row = dict(zip(table.columns, table.rows[0], strict=True))
    assert (row["bodies"], row["episodes"]) == (2, 4)
    assert row["reached"].startswith("3 (")
    assert row["first episode, s"] == pytest.approx(14.0)
    assert row["later ones, s"] == pytest.approx(10.0)
