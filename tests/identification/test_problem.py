from dataclasses import replace

import numpy as np
import pytest

from gridpush_drake.dynamics.physics import Physics
from gridpush_drake.dynamics.push import Push, make_path_times
from gridpush_drake.geometry.se2 import compose, transform
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.prediction import calc_pose_error, predict
from gridpush_drake.identification.statistics.problem import PushProblem, TimedPush
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.pushes.push_log import ObservedPush, PushLog
from tests.helpers.finite_difference import check_jacobian
from tests.helpers.shapes import make_shape
from tests.identification.simulated_pokes import make_pokes


def make_problem(regime: str) -> PushProblem:
    obj = GridObject.from_outline(
        [[-0.02, -0.06], [0.03, -0.06], [0.03, 0.04], [-0.02, 0.05]], max_cells=20
    )
    truth = CellParameters.random(obj, 1, by="cell", mass_range=(0.02, 0.2))
    log = make_pokes(obj, truth, 3, 2, length=0.03, observations=2, noise=(5e-4, 4e-3))
    return PushProblem(
        obj,
        log,
        replace(CellParameters.uniform(obj, friction=0.4), patch_ratio=0.2),
        Physics(regime=regime),
    )


@pytest.mark.parametrize("regime", ["quasi_static", "inertial"])
def test_residuals_have_the_jacobian_they_say(regime: str) -> None:
    problem = make_problem(regime)
    z = np.append(np.random.default_rng(0).normal(np.log(0.02), 0.3, problem.obj.n), np.log(0.4))
    linear = problem.linearize(z)
    for i in range(len(problem)):
        check_jacobian(
            lambda v, i=i: problem.residuals(v, [i])[0], z, linear.by_z[i], rtol=2e-5, atol=1e-9
        )


def test_residual_is_the_root_mean_square_distance_of_points_for_small_turns() -> None:
    problem = make_problem("quasi_static")
    z = problem.unknowns(CellParameters.uniform(problem.obj, contact_friction=0.4))
    for residual, cell_error in zip(
        problem.residuals(z), problem.calc_cell_errors(problem.residuals(z)), strict=True
    ):
        rows = residual.reshape(-1, 3)
        assert np.sqrt((rows**2).sum(axis=1)).mean() == pytest.approx(cell_error, rel=0.2)


def test_cell_errors_agree_with_the_cells_themselves() -> None:
    problem = make_problem("quasi_static")
    z = problem.unknowns(CellParameters.uniform(problem.obj, contact_friction=0.4))

    log = PushLog(tuple(push.observed for push in problem._pushes))
    for made, seen, error in zip(
        predict(Model(problem.obj, problem.params(z)), log),
        log,
        problem.calc_cell_errors(problem.residuals(z)),
        strict=True,
    ):
        pairs = zip(made.at_observations, seen.poses_observed, strict=True)
        expected = np.mean([calc_pose_error(problem.obj, p, q).cell for p, q in pairs])
        assert error == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("regime", ["quasi_static", "inertial"])
def test_a_pose_seen_twice_at_once_counts_twice(regime: str) -> None:
    problem = make_problem(regime)
    z = problem.unknowns(CellParameters.uniform(problem.obj, contact_friction=0.4))
    one = problem.choose([0])
    seen = one._pushes[0].observed
    t = np.sort(np.append(seen.t_observed, seen.t_observed - 1e-6))
    both = problem.replace_log(
        PushLog((replace(seen, t_observed=t, poses_observed=seen.poses_observed.repeat(2, 0)),))
    )
    expected = one.residuals(z)[0].reshape(-1, 3).repeat(2, axis=0).ravel()
    np.testing.assert_allclose(both.residuals(z)[0], expected, rtol=0, atol=1e-5)
    made = one.linearize(z).by_z[0].reshape(-1, 3, len(z)).repeat(2, axis=0).reshape(-1, len(z))
    np.testing.assert_allclose(both.linearize(z).by_z[0], made, rtol=0, atol=1e-5)


def test_counts_simulations() -> None:
    problem = make_problem("quasi_static")
    z = problem.unknowns(CellParameters.uniform(problem.obj))
    problem.residuals(z)
    problem.linearize(z, [0, 2])
    assert problem.simulations == 5


def test_unknowns_and_params_are_inverse() -> None:
    problem = make_problem("quasi_static")
    params = CellParameters(np.linspace(0.1, 0.5, problem.obj.n), np.full(problem.obj.n, 0.4), 0.3)
    back = problem.params(problem.unknowns(params))
    np.testing.assert_allclose(back.mass, params.mass, rtol=1e-12)
    assert back.contact_friction == pytest.approx(0.3)


def test_loads_elsewhere_in_their_cells_change_motions_and_keep_exact_derivatives() -> None:
    problem = make_problem("quasi_static")
    rng = np.random.default_rng(3)
    moved = problem.move_cells(
        problem.obj.p_BC + rng.uniform(-0.003, 0.003, problem.obj.p_BC.shape)
    )
    z = np.append(rng.normal(np.log(0.02), 0.3, problem.obj.n), np.log(0.4))
    assert np.abs(moved.residuals(z)[0] - problem.residuals(z)[0]).max() > 1e-5
    linear = moved.linearize(z)
    for i in range(len(moved)):
        check_jacobian(
            lambda v, i=i: moved.residuals(v, [i])[0], z, linear.by_z[i], rtol=2e-5, atol=1e-9
        )
    assert moved.simulations == problem.simulations


@pytest.mark.parametrize("regime", ["inertial", "quasi_static"])
def test_observations_a_rounding_error_beside_a_step_do_not_matter(regime):
    """In a step of 1e-16 s a rounding error of the gap would be a speed, which an object with inertia keeps."""
    obj = make_shape("claw_hammer", 30)
    params = CellParameters.uniform(obj)
    for place in (0.1, 0.4, 0.7):
        push = Push.on_outline(obj, place * obj.edges.perimeter, 0.2, 0.05, radius=0.01, speed=0.04)
        times = make_path_times(push, regime)
        seen = ObservedPush("push", push, np.zeros(3), times[1:], np.zeros((len(times) - 1, 3)))
        beside = np.nextafter(times[1:], np.inf)
        beside[-1] = np.nextafter(times[-1], 0.0)
        off = replace(seen, t_observed=beside)
        expected, poses = (
            TimedPush.of(each, regime).simulate(Model(obj, params, Physics(regime=regime))).poses
            for each in (seen, off)
        )
        assert len(expected) == len(poses)
        np.testing.assert_allclose(poses, expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("regime", ["quasi_static", "inertial"])
def test_residuals_have_the_derivatives_by_the_outline_s_frame_that_they_say(regime: str) -> None:
    problem = make_problem(regime)
    z = np.append(np.random.default_rng(0).normal(np.log(0.02), 0.3, problem.obj.n), np.log(0.4))
    # poses that are away from the origin of the world, and turned
    turned = [0.3, -0.2, 2.0]
    log = PushLog(tuple(carry(push.observed, turned) for push in problem._pushes))
    held = replace(CellParameters.uniform(problem.obj, friction=0.4), patch_ratio=0.2)
    linear = PushProblem(problem.obj, log, held, problem.physics).linearize(z)

    def calc_residuals(pose: np.ndarray) -> np.ndarray:
        moved = PushProblem(problem.obj.place(pose), log, held, problem.physics)
        return np.concatenate(moved.residuals(z))

    check_jacobian(
        calc_residuals, np.zeros(3), np.concatenate(linear.by_frame), rtol=2e-5, atol=1e-9
    )


def carry(seen: ObservedPush, pose: list[float]) -> ObservedPush:
    """Carries a push and what was seen of it to another place on the table."""
    push = Push.along(seen.push.t, transform(pose, seen.push.xy), seen.push.radius)
    return replace(
        seen,
        push=push,
        pose=compose(pose, seen.pose),
        poses_observed=compose(pose, seen.poses_observed),
    )
