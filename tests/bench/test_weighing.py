"""Presses at the table's edge in Drake: the physics of a tilt that is caught, and what they tell."""

from dataclasses import replace

import numpy as np
import pytest
from pydantic import TypeAdapter

from gridpush_drake.bench.tilt_tests.experiments import (
    STUDY,
    TILT_TEST_JOBS,
    EdgeJob,
    PressCourse,
    TiltTestBenchOptions,
    TiltTestJob,
    TiltTestScore,
    draw_truth,
    make_jobs,
    make_model,
    make_planner,
    make_pushes,
    make_weighed,
    run_edge_job,
    run_job,
    score,
    weigh_at_edge,
)
from gridpush_drake.bench.tilt_tests.mujoco_scale import MujocoScale
from gridpush_drake.bench.tilt_tests.whole_task import make_press
from gridpush_drake.bench.tilt_tests.world import NOISELESS, TABLE_EDGE, TiltTestWorld
from gridpush_drake.bench.truth.sets import make_body
from gridpush_drake.cli.shell.options import load_object
from gridpush_drake.dynamics.physics import GRAVITY
from gridpush_drake.errors import GridPushError, ObjectError
from gridpush_drake.geometry.se2 import transform, wrap_angle
from gridpush_drake.identification.learning import describe_prior
from gridpush_drake.identification.tilt_tests.weighed_model import estimate_masses
from gridpush_drake.multibody.ground_truth import sample_ground_truth
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.pregrasp.weighing_planner import TiltTestPlanner
from gridpush_drake.planning.weighing.plan import Edge, PressRules, list_placements
from gridpush_drake.planning.weighing.press import PressOptions, PressOutcome, has_slid
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.pushes.weighings import MassTestLog, TiltTest


def load_coarse(name):
    """A shipped object with a third of its cells, so that Drake has fewer contacts to simulate."""
    obj = load_object(name)
    return GridObject.from_outline(obj.outline, max_cells=40, name=name, prior=obj.prior)


def plan(world, heading, mass=0.5, params=None, obj=None):
    """A press with the center of mass known to a centimeter, as far over the edge as it goes."""
    obj = obj or world.obj
    center = (params or world.params).center_of_mass(obj)
    centers = center + 0.01 * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
    rests = list_placements(obj, centers, heading, TABLE_EDGE, world.height, PressRules(mass=mass))
    return min(rests, key=lambda one: one.relative_std)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "heading"), [("claw_hammer", 0.3)])
def test_the_force_at_which_it_tilts_is_that_of_the_moments(name, heading):
    obj = load_object(name)
    params = sample_ground_truth(obj, 3, friction_by_part=True)
    world = TiltTestWorld(obj, params, noise=NOISELESS)
    planned = plan(world, heading)
    world.put(planned.pose)
    world.let_pass(0.2)
    before = world.read_pose()
    made = world.press(planned.target)
    assert made.state.outcome == PressOutcome.TILTED
    assert 0.0 < made.max_tilt < np.radians(5.0)
    # It is caught: it lies where it lay.
    world.let_pass(0.3)
    assert world.read_tilt() < np.radians(0.02)
    off = world.read_pose() - before
    assert np.abs(off[:2]).max() < 2e-4
    assert abs(wrap_angle(off[2])) < 2e-3
    # F a = m g b, with no friction in it.
    weighing = made.state.make_weighing(made.target, world.options, before)
    b = -transform(before, params.center_of_mass(obj)[None])[0, 0] - weighing.center_shift
    assert weighing.force * weighing.arm == pytest.approx(params.total_mass * GRAVITY * b, rel=0.01)


@pytest.mark.parametrize(("bottom", "rim_gap"), [("three_feet", 3e-4), ("flat", 0.0)])
def test_a_press_measures_the_edge_and_not_the_feet(bottom, rim_gap):
    """In MuJoCo. On three feet, the object first rocks at less than half the force."""
    pytest.importorskip("mujoco", reason="MuJoCo is in the extra `bench`")
    obj = load_object("snack_bag")
    params = sample_ground_truth(obj, 3, friction_by_part=True)
    body = make_body(bottom, obj, params, np.random.default_rng(7), 0.012, rim_gap)
    world = MujocoScale(body, noise=NOISELESS)
    planned = plan(world, 3.6, params=params, obj=obj)
    world.put(planned.pose)
    world.let_pass(0.3)
    before = world.read_pose()
    made = world.press(planned.target)
    world.let_pass(0.3)
    assert made.max_tilt < np.radians(5.0)
    assert not has_slid(before, world.read_pose())
    weighing = made.state.make_weighing(made.target, world.options, before)
    b = -transform(before, params.center_of_mass(obj)[None])[0, 0] - weighing.center_shift
    expected = params.total_mass * GRAVITY * b / weighing.arm
    assert weighing.force == pytest.approx(expected, rel=0.015)
    if bottom == "flat":
        assert weighing.rock_force is None
    else:
        assert weighing.rock_force < 0.5 * expected


@pytest.mark.slow
def test_friction_does_not_matter():
    """Neither that of the table nor that of the tip, by which the object's top draws it along."""
    obj = load_object("snack_bag")
    smooth = sample_ground_truth(obj, 3)
    rough = CellParameters(smooth.mass, 2.5 * smooth.friction, 0.9)
    forces = []
    for params in (smooth, rough):
        world = TiltTestWorld(obj, params, noise=NOISELESS)
        planned = plan(world, 0.3)
        world.put(planned.pose)
        world.let_pass(0.2)
        made = world.press(planned.target)
        forces.append(made.state.make_weighing(made.target, world.options, planned.pose).force)
    assert forces[0] == pytest.approx(forces[1], rel=0.004)


@pytest.mark.slow
def test_an_object_that_is_too_heavy_lies_still():
    obj = load_coarse("snack_bag")
    params = CellParameters.uniform(obj, 2.0, 0.4)
    world = TiltTestWorld(obj, params, noise=NOISELESS, options=PressOptions(max_force=6.0))
    planned = plan(world, 0.3)
    world.put(planned.pose)
    world.let_pass(0.2)
    made = world.press(planned.target)
    assert made.state.outcome == PressOutcome.TOO_HEAVY
    assert made.max_tilt < np.radians(0.1)


@pytest.mark.slow
def test_a_press_at_any_edge_tells_the_same_as_at_drakes():
    """The story's table has four edges; what is pressed at any of them comes back in its frame."""
    obj = load_coarse("snack_bag")
    params = sample_ground_truth(obj, 3, friction_by_part=True)
    center = params.center_of_mass(obj)
    edge = Edge(point=(0.31, -0.12), angle=2.0)
    centers = center + 0.01 * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
    rests = list_placements(obj, centers, 2.3, edge, 0.03, along=0.2)
    planned = min(rests, key=lambda one: one.relative_std)
    scale = TiltTestWorld(obj, params, noise=NOISELESS)
    press, made = make_press(scale, planned.target, planned.pose, planned.pose)
    assert 0.0 < made.max_tilt < np.radians(5.0)
    assert press.edge_angle == edge.angle
    np.testing.assert_array_equal(press.pose, planned.pose)
    # The top, twice as high as the center of mass, has drawn the tip along.
    place = planned.target.place + 2 * press.center_shift * edge.normal
    np.testing.assert_allclose(press.place, place, atol=5e-4)
    b = -edge.calc_beyond(transform(planned.pose, center[None])[0]) - press.center_shift
    assert press.force * press.arm == pytest.approx(params.total_mass * GRAVITY * b, rel=0.01)


@pytest.mark.slow
def test_an_object_of_which_nothing_is_told_is_weighed():
    found = run_job(TiltTestJob("claw_hammer", 0))
    assert abs(found.mass_error) < 0.03
    assert found.center_error < 0.003
    assert abs(found.friction_error) < 0.03
    assert not found.fell
    assert found.max_tilt < np.radians(5.0)
    # The robot's planner makes presses until it is known well, here seven.
    assert found.time < 90.0


@pytest.mark.slow
def test_what_is_said_of_an_object_that_is_pressed_once_holds():
    """The planner finds one press for a narrow wrench, so that its mass is known roughly."""
    found = run_job(TiltTestJob("combination_wrench", 0))
    assert found.presses >= 1
    assert found.mass_holds and found.center_holds and found.friction_holds
    assert not found.fell
    assert found.max_tilt < np.radians(5.0)


@pytest.mark.slow
def test_where_it_would_give_up_it_weighs_and_goes_on():
    given_up, weighed = run_edge_job(EdgeJob("claw_hammer", 3))
    assert not given_up.grasped
    assert "only closer friction bounds would help" in given_up.reason
    assert weighed.grasped
    assert not weighed.dropped
    assert weighed.presses >= 1
    assert weighed.max_tilt < np.radians(5.0)


def test_scores_are_kept_as_json():
    obj = load_object("spring_clamp").forget()
    truth = draw_truth(obj, 3)
    found = describe_prior(obj)
    press = TiltTest(np.zeros(3), np.array([0.1, 0.0]), 3.0, np.array([0.05, 0.0]), 0.0)
    for known in (found, estimate_masses(found, MassTestLog((press,)))):
        scored = score(
            TiltTestJob(obj.name, 3),
            known,
            truth,
            PressCourse(presses=1, time=4.0, max_tilt=np.float64(0.01)),
        )
        kept = TypeAdapter(TiltTestScore).dump_json(scored)
        back = TypeAdapter(TiltTestScore).validate_json(kept)
        assert back.presses == 1
        assert back.mass == truth.total_mass


@pytest.mark.slow
def test_the_bench_presses_where_the_robot_s_planner_says(monkeypatch):
    """One planner decides for both: what it yields is pressed, and nothing else. In MuJoCo."""
    pytest.importorskip("mujoco", reason="MuJoCo is in the extra `bench`")
    made = make_weighed(TiltTestJob("snack_bag", 3, "flat"))
    center = tuple(made.truth.center_of_mass(made.obj).tolist())
    prior = replace(made.obj.prior, center_of_mass=center, center_of_mass_std=0.005)
    made = replace(made, obj=replace(made.obj, prior=prior))
    found = describe_prior(made.obj)
    model = make_model(found, PushLog(()))
    asked = []
    real = TiltTestPlanner.plan_presses

    def plan(planner, pose, model, may_slide=True):
        asked.append(next(real(planner, pose, model, may_slide)))
        yield asked[-1]

    pressed = []
    press = made.scale.press

    def note(target):
        pressed.append(target)
        return press(target)

    monkeypatch.setattr(made.scale, "press", note)
    monkeypatch.setattr(TiltTestPlanner, "plan_presses", plan)
    planner = make_planner(made.obj, made.scale.height)
    once = replace(planner.weighing, max_presses=1)
    monkeypatch.setattr(TiltTestPlanner, "weighing", once)
    _, course = weigh_at_edge(made, replace(found, push_names=("push",) * 3), PushLog(()), 3)
    # A press that shifts the object, as engines have it more or less, is made again.
    chosen = [one.here for one in asked if not one.placements]
    assert course.presses == len(pressed) == len(chosen) >= 1
    assert all(target is one.target for target, one in zip(pressed, chosen, strict=True))
    assert course.slides == len(asked) - len(pressed) >= 1
    # The robot decides by the same plan.
    pose = chosen[0].pose
    decision = planner.decide(pose, model, pokes=3)
    assert decision.action == "weigh"
    assert decision.press is asked[-1].here.target
    np.testing.assert_allclose(decision.press.place, pressed[0].place)


def test_hidden_masses_differ_from_object_to_object():
    masses = [draw_truth(load_object(name), 3).total_mass for name in ("pliers", "toolbox")]
    assert masses[0] != masses[1]
    assert all(0.1 <= mass <= 3.0 for mass in masses)


def test_errors_differ_from_object_to_object():
    """Runs with one seed count as independent ones."""
    seen = []
    pushed = []
    for name in ("pliers", "toolbox"):
        obj = load_object(name)
        truth = draw_truth(obj, 3)
        world = TiltTestWorld(obj, truth, seed=3)
        seen.append(world.observe() - world.read_pose())
        # The first pose of a push is that of an object at the origin, with noise.
        pushed.append(make_pushes(obj, truth, 3, 1)[0].pose)
    assert (np.abs(seen[0] - seen[1]) > 1e-6).all()
    assert (np.abs(pushed[0] - pushed[1]) > 1e-6).all()


def test_jobs_are_those_that_were_asked_for():
    jobs = make_jobs(TiltTestBenchOptions(objects=("toolbox",), truths=2, seed=5, part="scale"))
    assert jobs == [TiltTestJob("toolbox", 5), TiltTestJob("toolbox", 6)]
    # Of nine objects, seven have a part that the gripper takes.
    assert len(make_jobs(TiltTestBenchOptions())) == 90 + 70
    to_edge = make_jobs(
        TiltTestBenchOptions(objects=("open_book", "pliers"), truths=1, part="edge")
    )
    assert [job.name for job in to_edge] == ["pliers"]
    both = make_jobs(STUDY.shorten(TiltTestBenchOptions()))
    assert both == [TiltTestJob("claw_hammer", 0), EdgeJob("claw_hammer", 0)]
    assert TILT_TEST_JOBS.describe(jobs[0]) == "toolbox, truth 5"
    with pytest.raises(ObjectError, match="anvil"):
        make_jobs(TiltTestBenchOptions(objects=("anvil",)))
    with pytest.raises(GridPushError, match="cannot be grasped"):
        make_jobs(TiltTestBenchOptions(objects=("open_book",), part="edge"))
    with pytest.raises(GridPushError, match="truths: none"):
        make_jobs(TiltTestBenchOptions(truths=0))
