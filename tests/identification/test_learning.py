from dataclasses import replace

import numpy as np
import pytest

from gridpush_drake.dynamics.physics import Physics
from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.pusher import PusherShape
from gridpush_drake.errors import IdentificationError, SimulationError
from gridpush_drake.identification.fit.hypotheses import SmoothField, TwoParts
from gridpush_drake.identification.fit.map_ensemble import MapEnsemble
from gridpush_drake.identification.learning import describe_prior, identify
from gridpush_drake.identification.methods import METHOD_NAMES
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.model_check import check_fit
from gridpush_drake.identification.prediction import calc_pose_error, predict
from gridpush_drake.identification.sentences import describe_fit_check
from gridpush_drake.identification.statistics.problem import resolve_physics
from gridpush_drake.objects.grid_object import GridObject, PhysicalPrior
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.pushes.push_log import ObservedPush, PushLog
from tests.identification.simulated_pokes import make_pokes

RECTANGLE = [[-0.06, -0.03], [0.06, -0.03], [0.06, 0.03], [-0.06, 0.03]]
HANDLE = [
    [-0.15, -0.01],
    [0.1, -0.01],
    [0.1, -0.05],
    [0.13, -0.05],
    [0.13, 0.05],
    [0.1, 0.05],
    [0.1, 0.01],
    [-0.15, 0.01],
]


def make_block(max_cells: int = 18) -> GridObject:
    return GridObject.from_outline(
        RECTANGLE, max_cells=max_cells, prior=PhysicalPrior(pusher_radius=0.008)
    )


def make_uneven(obj: GridObject) -> CellParameters:
    return CellParameters(np.where(obj.p_BC[:, 0] > 0, 0.3, 0.05), np.full(obj.n, 0.4), 0.35)


def calc_error(obj: GridObject, params: CellParameters, log: PushLog) -> float:
    made = predict(Model(obj, params), log)
    return float(
        np.mean(
            [
                calc_pose_error(obj, p.poses[-1], q.final_pose).cell
                for p, q in zip(made, log, strict=True)
            ]
        )
    )


def test_learns_an_uneven_block_from_noisy_pokes() -> None:
    obj = make_block()
    truth = make_uneven(obj)
    held_out = make_pokes(obj, truth, 10, 99, observations=1)
    log = make_pokes(obj, truth, 6, 0, noise=(5e-4, 3.5e-3))
    found = identify(Model(obj), log)
    assert found.status == "learned"
    assert (
        calc_error(obj, found.params, held_out)
        < calc_error(obj, CellParameters.uniform(obj), held_out) / 4
    )
    center = found.identifiability.center_of_friction
    true_center = truth.relative_friction() @ obj.p_BC
    spread = np.sqrt(np.diag(found.identifiability.center_of_friction_covariance))
    assert np.linalg.norm(center - true_center) < 0.005
    assert (np.abs(center - true_center) < 5 * spread + 0.001).all()
    assert found.history and all(
        b.loss <= a.loss for a, b in zip(found.history, found.history[1:], strict=False)
    )
    assert all(
        b.simulations >= a.simulations
        for a, b in zip(found.history, found.history[1:], strict=False)
    )


def test_default_stands_on_points_and_searches_on_whole_cells() -> None:
    obj = make_block()
    log = make_pokes(obj, make_uneven(obj), 2, 0)
    found = identify(Model(obj), log)
    assert found.params.patch_ratio == pytest.approx(1 / np.sqrt(obj.n))
    assert {draw.patch_ratio for draw in found.draws(3)} == {found.params.patch_ratio}
    assert identify(Model(obj), log, method=MapEnsemble(patch_ratio=0.5)).params.patch_ratio == 0.5
    assert identify(Model(obj), log, method="random_search", budget=4).params.patch_ratio == 1.0


def test_leaves_a_uniform_block_nearly_alone() -> None:
    obj = make_block()
    truth = CellParameters.uniform(obj, contact_friction=0.3)
    log = make_pokes(obj, truth, 5, 1, noise=(1e-3, 1e-2))
    found = identify(Model(obj), log)
    held_out = make_pokes(obj, truth, 10, 98, observations=1)
    uniform = calc_error(obj, CellParameters.uniform(obj), held_out)
    assert calc_error(obj, found.params, held_out) < uniform + 2e-4


def test_keeping_the_prior_does_not_make_it_look_surer() -> None:
    obj = make_block()
    truth = CellParameters.uniform(obj, contact_friction=0.3)
    found = identify(Model(obj), make_pokes(obj, truth, 3, 1, length=0.02, noise=(1e-3, 1e-2)))
    assert found.status == "prior_kept"
    assert np.median(found.std.mass / found.params.mass) > 0.15


def test_same_seed_same_bits_and_threads_do_not_matter() -> None:
    obj = make_block()
    log = make_pokes(obj, make_uneven(obj), 3, 2, noise=(5e-4, 3e-3))
    first, second = identify(Model(obj), log, seed=4), identify(Model(obj), log, seed=4)
    assert np.array_equal(first.params.mass, second.params.mass)
    assert np.array_equal(first.posterior.covariance, second.posterior.covariance)


def test_result_carries_spread_and_samples() -> None:
    obj = make_block()
    found = identify(Model(obj), make_pokes(obj, make_uneven(obj), 3, 2))
    assert found.std.mass.shape == found.params.mass.shape
    samples = found.draws(300, seed=1)
    assert len(samples) == 300
    fractions = np.array([sample.relative_friction() for sample in samples])
    centers = fractions @ obj.p_BC
    spread = np.sqrt(np.diag(found.identifiability.center_of_friction_covariance))
    np.testing.assert_allclose(centers.std(axis=0), spread, rtol=0.5)
    assert all(np.allclose(sample.friction, found.params.friction) for sample in samples)
    assert found.params.total_mass == pytest.approx(1.0)


def test_weighed_object_keeps_its_mass() -> None:
    obj = make_block()
    known = replace(obj, prior=PhysicalPrior(total_mass=2.5))
    found = identify(Model(known), make_pokes(obj, make_uneven(obj), 2, 2))
    assert found.params.total_mass == pytest.approx(2.5)
    assert found.obj.prior.total_mass == 2.5


def test_pushes_that_never_touch_are_left_out_and_named() -> None:
    obj = make_block()
    log = make_pokes(obj, make_uneven(obj), 2, 2)
    miss = log[0]
    far = type(miss.push)(
        miss.push.start + 1.0, miss.push.velocity, miss.push.duration, miss.push.radius
    )
    missed = ObservedPush(
        "far", far, miss.pose, miss.t_observed, np.zeros_like(miss.poses_observed)
    )
    found = identify(Model(obj), PushLog((*log.pushes, missed)))
    assert found.unused_pushes == ("far",)
    assert found.push_names == ("poke_0", "poke_1")
    nothing = identify(Model(obj), PushLog((missed,)))
    assert nothing.status == "no_usable_pushes"
    np.testing.assert_allclose(nothing.params.mass, nothing.params.mass[0])


def test_uses_the_objects_pusher_radius_where_the_log_has_none() -> None:
    obj = make_block()
    log = make_pokes(obj, make_uneven(obj), 2, 2)
    bare = replace(log.with_radius(0.001), radius_given=False)
    assert np.array_equal(
        identify(Model(obj), bare).params.mass, identify(Model(obj), log).params.mass
    )


def test_the_paper_s_method_learns_of_an_object_pushed_above_the_table() -> None:
    obj = make_block(8)
    log = make_pokes(obj, make_uneven(obj), 2, 2, length=0.03, observations=2, regime="inertial")
    high = replace(obj, prior=replace(obj.prior, pusher_radius=0.005, push_height=0.01))
    found = identify(Model(high), log, method="paper", budget=20)
    assert found.params.push_height == 0.01
    np.testing.assert_array_equal(
        found.params.mass, identify(Model(obj), log, method="paper", budget=20).params.mass
    )


@pytest.mark.parametrize("method", METHOD_NAMES[1:])
def test_every_search_is_behind_the_same_interface(method: str) -> None:
    obj = make_block(8)
    log = make_pokes(obj, make_uneven(obj), 2, 2, length=0.03, observations=2, regime="inertial")
    found = identify(Model(obj), log, method=method, budget=30, regime="inertial")
    assert found.method == method and found.simulations <= 30
    assert found.history[-1].loss <= found.history[0].loss
    assert np.linalg.eigvalsh(found.posterior.covariance).min() > 0


def test_elongated_object_with_a_very_light_part_does_not_stall() -> None:
    obj = GridObject.from_outline(HANDLE, max_cells=60)
    truth = CellParameters(np.where(obj.p_BC[:, 0] > 0.1, 2.0, 0.02), np.full(obj.n, 0.4), 0.4)
    found = identify(Model(obj), make_pokes(obj, truth, 5, 0))
    center = truth.relative_friction() @ obj.p_BC
    assert np.linalg.norm(found.identifiability.center_of_friction - center) < 0.01


def test_regime_follows_the_speed() -> None:
    obj = make_block()
    log = make_pokes(obj, make_uneven(obj), 1, 0)
    assert resolve_physics(Physics(), obj, log).regime == "quasi_static"
    push = log[0].push
    fast = type(push)(push.start, 20 * push.velocity, push.duration / 20, push.radius)
    hit = ObservedPush("fast", fast, log[0].pose, log[0].t_observed / 20, log[0].poses_observed)
    assert resolve_physics(Physics(), obj, PushLog((hit,))).regime == "inertial"


def test_bad_arguments_are_refused() -> None:
    obj = make_block()
    log = make_pokes(obj, make_uneven(obj), 1, 0)
    with pytest.raises(IdentificationError, match="method is 'magic'"):
        identify(Model(obj), log, method="magic")
    with pytest.raises(SimulationError, match="regime"):
        identify(Model(obj), log, regime="fast")
    with pytest.raises(IdentificationError, match="seed is -1"):
        identify(Model(obj), log, method="random_search", seed=-1)
    with pytest.raises(IdentificationError, match=r"seed is 1\.5"):
        identify(Model(obj), log, seed=1.5)  # type: ignore[arg-type]
    with pytest.raises(IdentificationError, match="budget"):
        identify(Model(obj), log, method="random_search", budget=0)
    with pytest.raises(IdentificationError, match="count is -1"):
        describe_prior(obj).draws(-1)
    for amplitude in (0.0, -1.0, np.inf, np.nan):
        with pytest.raises(IdentificationError, match="expected a positive finite number"):
            SmoothField(amplitude)
    for hypotheses in ((), (TwoParts(),)):
        with pytest.raises(IdentificationError, match="at least one that needs no pushes"):
            MapEnsemble(hypotheses=hypotheses)
    with pytest.raises(IdentificationError, match="two are named 'smooth field 1'"):
        MapEnsemble(hypotheses=(SmoothField(1.0), SmoothField(1.0)))
    with pytest.raises(IdentificationError, match="no pushes"):
        identify(Model(obj), PushLog(()))
    unseen = replace(log[0], t_observed=np.empty(0), poses_observed=np.empty((0, 3)))
    with pytest.raises(IdentificationError, match="object_x"):
        identify(Model(obj), PushLog((unseen,)))


def test_a_fit_that_has_no_solution_is_an_error_that_asks_about_what_was_told() -> None:
    class Singular(MapEnsemble):
        def fit(self, *_, **__):
            raise np.linalg.LinAlgError

    obj = make_block()
    log, told = make_pokes(obj, make_uneven(obj), 1, 0), replace(obj.prior, push_height=0.02)
    with pytest.raises(IdentificationError, match=r"is pusher.height, 0.02 m, right\?"):
        identify(Model(replace(obj, prior=told)), log, method=Singular())


@pytest.mark.parametrize("patch_ratio", [1.0, 0.1])
def test_an_object_of_one_cell_has_its_whole_load_there(patch_ratio: float) -> None:
    obj = GridObject.from_outline([[0, 0], [0.05, 0], [0.05, 0.05], [0, 0.05]], max_cells=1)
    found = identify(
        Model(obj),
        make_pokes(obj, replace(CellParameters.uniform(obj), patch_ratio=patch_ratio), 3, 0),
    )
    np.testing.assert_allclose(found.relative_friction, 1.0)
    np.testing.assert_allclose(found.identifiability.center_of_friction, obj.p_BC[0])


def test_a_center_of_mass_at_a_corner_leaves_a_model_of_numbers() -> None:
    obj = make_block()
    corner = tuple(float(value) for value in obj.outline.exterior.coords[0][:2])
    told = replace(obj.prior, center_of_mass=corner, center_of_mass_std=1e-4)
    found = identify(Model(replace(obj, prior=told)), make_pokes(obj, make_uneven(obj), 3, 0))
    assert np.isfinite(found.params.mass).all() and (found.params.mass > 0).all()


def test_what_predicts_worse_than_an_even_object_is_not_called_learned() -> None:
    obj = make_block()
    log = make_pokes(obj, CellParameters.uniform(obj), 5, 0, noise=(5e-4, 3.5e-3))
    found = identify(Model(obj), log)
    assert found.status != "learned" or check_fit(found, log).status is None
    even = CellParameters.uniform(obj)
    x = obj.p_BC[:, 0] / obj.p_BC[:, 0].max()
    judged = {}
    for slope in (0.03, 1.0):
        tilted = replace(even, mass=even.mass * np.exp(slope * x))
        assert calc_error(obj, tilted, log) > calc_error(obj, even, log)
        check = check_fit(found.with_params(tilted), log)
        judged[slope] = check.status
        message = describe_fit_check(check, obj.name)
        assert f"an even object by {1e3 * calc_error(obj, even, log):.1f} mm" in message
    # Worse by less than the noise of a pose it is no better; by more it should not be used.
    assert judged == {0.03: "prior_kept", 1.0: "explains_little"}


def test_pushes_by_two_fingertips_tell_where_the_weight_is():
    obj = make_block(max_cells=8)
    heavy = CellParameters(
        np.where(obj.p_BC[:, 0] > 0, 4.0, 1.0), np.full(obj.n, 0.3), contact_friction=0.4
    )
    tips = PusherShape.discs([(0.0, -0.015), (0.0, 0.015)], 0.004)
    pushes = []
    # on either long side, turning to either hand, tightly enough to slip
    for side, y, along, turn in ((1, -1, -0.03, 0.3), (1, -1, 0.03, -0.3), (-1, 1, 0.0, 0.3)):
        start = np.array([along, y * 0.034])
        center = start + (-0.08 * side * np.sign(turn), 0.0)
        push = Push.about(center, turn, shape=tips, start=start, yaw=side * np.pi / 2, duration=1.0)
        end = Model(obj, heavy).simulate(push).final_pose
        pushes.append(ObservedPush(f"p{len(pushes)}", push, np.zeros(3), [1.0], end[None]))
    log = PushLog(tuple(pushes))
    found = identify(Model(obj), log, seed=0)
    learned = found.params.center_of_mass(obj)
    assert heavy.center_of_mass(obj)[0] == pytest.approx(0.018)
    assert learned[0] > 0.009
    mine, even = (
        [
            np.linalg.norm(made.at_observations[-1, :2] - seen.final_pose[:2])
            for made, seen in zip(predict(model, log), log, strict=True)
        ]
        for model in (found, Model(obj))
    )
    print(mine, even)
    assert np.mean(mine) < 0.5 * np.mean(even)
