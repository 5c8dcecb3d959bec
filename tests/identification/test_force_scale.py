from dataclasses import replace

import numpy as np
import pytest

from gridpush_drake.dynamics.physics import GRAVITY, Physics
from gridpush_drake.dynamics.push import Push, make_path_times
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import PushLogWarning
from gridpush_drake.identification.absolute.force_scale import (
    _average,
    calc_force_scale,
    measure_pushes,
)
from gridpush_drake.identification.identifiability import (
    _calc_box_of_known_scale,
    calc_center_of_mass_box,
)
from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.model_file import read_model, write_model
from gridpush_drake.identification.result import Identification
from gridpush_drake.identification.statistics.posterior import Posterior
from gridpush_drake.identification.statistics.problem import TimedPush
from gridpush_drake.objects.grid_object import GridObject, PhysicalPrior
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.pushes.push_log import PushLog
from tests.helpers.shared_data import read_cmu
from tests.helpers.weighed_objects import weigh_exactly
from tests.identification.simulated_pokes import make_pokes
from tests.identification.test_held_friction import push_at_edge

RECTANGLE = [[-0.06, -0.03], [0.06, -0.03], [0.06, 0.03], [-0.06, 0.03]]
FRICTION = (0.25, 0.5)
MASS = 0.8


def make_case(total_mass: float | None = None) -> tuple[GridObject, CellParameters]:
    """An object, one of whose ends is heavier and rougher than supposed."""
    prior = PhysicalPrior(
        friction=0.35, friction_min=FRICTION[0], friction_max=FRICTION[1], total_mass=total_mass
    )
    obj = GridObject.from_outline(RECTANGLE, max_cells=18, prior=prior)
    heavy = obj.p_BC[:, 0] > 0.02
    mass = np.where(heavy, 4.0, 1.0)
    return obj, CellParameters(MASS * mass / mass.sum(), np.where(heavy, 0.45, 0.4), 0.35)


def add_forces(
    obj: GridObject,
    truth: CellParameters,
    log: PushLog,
    seed: int,
    backwards: int = 0,
    noise: float = 1.0,
) -> PushLog:
    """With forces at 50 Hz: 15 % off from push to push, with noise and an offset of the sensor.

    Those of the first `backwards` pushes have the wrong sign. `noise` is a factor on all errors.
    """
    rng, pushes = np.random.default_rng((9, seed)), []
    for i, seen in enumerate(log):
        times = make_path_times(seen.push, "quasi_static")
        motion = simulate(
            Model(obj, truth),
            seen.push,
            seen.pose,
            regime="quasi_static",
            times=times,
            table=log.table,
        )
        t = np.arange(0.0, seen.push.duration, 0.02)
        force = motion.contact_forces.sum(axis=1)[np.searchsorted(times, t, side="right") - 1]
        force = (
            force * np.exp(noise * rng.normal(0, 0.15))
            + noise * rng.normal(0, 0.3, force.shape)
            + noise * rng.normal(0, 0.05, 2)
        )
        pushes.append(replace(seen, force_t=t, force=-force if i < backwards else force))
    return replace(log, pushes=tuple(pushes))


def learn(
    seed: int = 0, total_mass: float | None = None, backwards: int = 0, count: int = 6
) -> Identification:
    obj, truth = make_case(total_mass)
    log = make_pokes(obj, truth, count, seed, noise=(3e-4, 3e-3))
    return identify(Model(obj), add_forces(obj, truth, log, seed, backwards))


@pytest.mark.parametrize("count", [1, 3, 8])
def test_friction_comes_out_as_far_off_as_is_said(count: int) -> None:
    _, truth = make_case()
    right = GRAVITY * truth.mass @ truth.friction
    found = [learn(seed, count=count).force for seed in range(5)]
    off = np.array([np.log(one.friction / right) / one.relative_std for one in found])
    assert np.abs(off).max() < 3.0 and 0.2 < np.sqrt((off**2).mean()) < 1.6, off
    assert max(one.relative_std for one in found) < 0.35 / np.sqrt(count) + 0.05
    assert all(one.pushes == count and one.against == 0 for one in found)


def make_station_log(obj: GridObject, truth: CellParameters, contact: float, end: float) -> PushLog:
    """Pushes with forces as a station writes them: 20 of a push, each the mean of some time.

    The finger takes four times as long for the last twentieth of its way.

    Args:
        obj: the object.
        truth: its true masses and frictions.
        contact: factor on the first two forces after the finger met the object.
        end: factor on the forces while the finger slows down.
    """
    pushes = []
    for seen in make_pokes(obj, truth, 4, 0, noise=(3e-4, 3e-3)):
        slow = 0.95 * seen.push.duration
        stop = 1.15 * seen.push.duration
        places = seen.push.tip_at([0.0, slow, seen.push.duration])
        push = Push.along(np.array([0.0, slow, stop]), places, seen.push.radius)
        times = make_path_times(push, "quasi_static")
        motion = simulate(Model(obj, truth), push, seen.pose, regime="quasi_static", times=times)
        fine = np.linspace(0.0, stop, 400, endpoint=False)
        force = motion.contact_forces.sum(axis=1)[np.searchsorted(times, fine, side="right") - 1]
        force[fine > slow] *= end
        means = force.reshape(20, 20, 2).mean(axis=1)
        first = int(np.flatnonzero(means.any(axis=1))[0])
        means[first : first + 2] *= contact
        t = fine.reshape(20, 20).mean(axis=1)
        seen_at = np.append(seen.t_observed[:-1], stop)
        pushes.append(replace(seen, push=push, t_observed=seen_at, force_t=t, force=means))
    return PushLog(tuple(pushes))


def test_forces_of_a_finger_that_meets_the_object_or_stops_do_not_count() -> None:
    obj, truth = make_case()
    right = GRAVITY * truth.mass @ truth.friction
    whole = identify(Model(obj), make_station_log(obj, truth, 1.0, 1.0)).force
    cut = identify(Model(obj), make_station_log(obj, truth, 0.4, 0.1)).force
    assert whole.friction == pytest.approx(right, rel=0.02)
    assert cut.friction == pytest.approx(whole.friction, rel=1e-6)


def test_if_no_force_was_steady_all_of_them_count() -> None:
    obj, truth = make_case()
    log = make_station_log(obj, truth, 1.0, 1.0)
    few = [replace(seen, force_t=seen.force_t[-2:], force=seen.force[-2:]) for seen in log]
    found = identify(Model(obj), PushLog(tuple(few))).force
    assert found.pushes == 4
    assert found.friction == pytest.approx(GRAVITY * truth.mass @ truth.friction, rel=0.05)


def test_a_push_that_is_too_short_to_become_steady_says_nothing() -> None:
    """The finger goes 2 mm with the object, and feels half of what it would feel in the end."""
    obj, truth = make_case()
    log = make_station_log(obj, truth, 1.0, 1.0)
    seen = log[0]
    there = np.flatnonzero(seen.force.any(axis=1))
    way = seen.push.distance_at(seen.force_t)
    kept = seen.force_t < seen.force_t[there[0]] + 1e-9
    end = np.interp(way[there[0]] + 0.002, way, seen.force_t)
    t = np.append(seen.push.t[seen.push.t < end], end)
    times = np.append(seen.force_t[kept], np.linspace(seen.force_t[kept][-1], end, 6)[1:])
    force = np.vstack([seen.force[kept], np.tile(seen.force[there[0] + 1], (5, 1))])
    short = replace(
        seen,
        name="short",
        push=Push.along(t, seen.push.tip_at(t), seen.push.radius),
        t_observed=[end],
        poses_observed=[seen.pose],
        force_t=times,
        force=0.5 * force,
    )
    params = identify(Model(obj), log)
    alone = calc_force_scale(Model(obj, truth, params.physics), params.posterior, log)
    more = PushLog((*log, short, replace(short, name="again")))
    with_short = calc_force_scale(Model(obj, truth, params.physics), params.posterior, more)
    assert with_short.pushes == alone.pushes == 4
    assert with_short.friction == pytest.approx(alone.friction, rel=1e-9)


@pytest.mark.parametrize("fraction", [0.2, -0.2])
def test_the_weight_that_the_finger_carries_does_not_rub(fraction: float) -> None:
    obj, truth = make_case()
    right = GRAVITY * truth.mass @ truth.friction
    pushes = []
    for seen in make_station_log(obj, truth, 1.0, 1.0):
        # The finger takes up a fraction of the weight as it meets the object, and loses it slowly.
        lift = fraction * GRAVITY * MASS * np.exp(-np.arange(20) / 10)
        left = 1 - lift / (GRAVITY * MASS)
        pushes.append(replace(seen, force=seen.force * left[:, None], lift_force=lift))
    known = identify(Model(obj), PushLog(tuple(pushes))).force
    hidden = identify(
        Model(obj), PushLog(tuple(replace(seen, lift_force=None) for seen in pushes))
    ).force
    # The friction of what is carried is known no better than by its bounds, 0.25 and 0.5.
    assert known.friction == pytest.approx(right, rel=0.03)
    assert abs(hidden.friction / right - 1) > 0.08
    assert known.relative_std**2 > hidden.relative_std**2 + 0.01**2


def test_pushes_with_noisy_forces_count_less() -> None:
    scales = np.array([1.0, 1.02, 0.98, 1.6])
    on_table = np.zeros(4)
    mean, variance = _average(scales, np.array([0.02, 0.02, 0.02, 0.6]), on_table)
    alike, of_alike = _average(scales, np.zeros(4), on_table)
    assert abs(mean - 1) < 0.03 < abs(alike - 1)
    assert variance < of_alike
    # Noise that is known is no spread of the table's friction.
    rng = np.random.default_rng(0)
    noisy, of_noisy = _average(1 + 0.2 * rng.standard_normal(400), np.full(400, 0.2), np.zeros(400))
    assert abs(noisy - 1) < 0.03
    assert 0.005 < np.sqrt(of_noisy) < 0.013


def test_pushes_over_the_edge_share_an_error() -> None:
    """The model has the true loads and center of mass, and not how friction is spread."""
    obj, _ = make_case()
    rng = np.random.default_rng(1)
    shared, apart = [], []
    for seed in range(12):
        rough = obj.p_BC[:, 0] > rng.uniform(-0.03, 0.03)
        friction = np.where(rough, *rng.permutation([0.2, 0.7]))
        mass = np.exp(rng.normal(0, 0.3, obj.n))
        truth = CellParameters(MASS * mass / mass.sum(), friction, 0.35)
        k = truth.mass * friction
        model = Model(obj, weigh_exactly(obj, truth)[1], Physics(regime="quasi_static"))
        sure = 1e-12 * np.eye(obj.n + 1)
        posterior = Posterior(np.append(np.log(k), np.log(0.35)), sure, np.eye(obj.n + 1))
        on_table = make_pokes(obj, truth, 3, seed)
        over = push_at_edge(obj, truth, 9, seed)
        log = add_forces(obj, truth, replace(over, pushes=(*on_table, *over)), seed, noise=0.0)
        found = calc_force_scale(model, posterior, log)
        shared.append(np.log(found.friction / (GRAVITY * k.sum())) / found.relative_std)
        timed = [TimedPush.of(seen, "quasi_static", log.table) for seen in log]
        measured = measure_pushes(model, timed)
        mean, variance = _average(measured.scales, measured.stds, np.zeros(len(log)))
        apart.append(np.log(mean / (GRAVITY * k.sum())) / np.sqrt(variance))
    assert np.sqrt(np.mean(np.square(shared))) < 1.2, shared
    assert np.sqrt(np.mean(np.square(apart))) > 1.5, apart


def test_an_unknown_mass_is_bounded_and_the_estimate_has_the_forces_scale() -> None:
    _, truth = make_case()
    model = learn(2)
    low, high = model.force.calc_mass_bounds(model.obj)
    assert low < MASS < high and high / low < 3.5
    assert GRAVITY * model.params.mass @ model.params.friction == pytest.approx(
        model.force.friction
    )
    assert np.all(model.params.friction == 0.35)
    known = model.identifiability
    assert known.mass_min.sum() == pytest.approx(low) and known.mass_max.sum() == pytest.approx(
        high
    )
    assert (known.mass_min < truth.mass * 1.5).all() and (known.mass_max > truth.mass / 1.5).all()
    (said,) = [text for text in known.statements if "forces" in text]
    assert f"{model.force.friction:.2f} N" in said and f"weighs {low:.3g} to {high:.3g} kg" in said
    assert not any("common scale of the friction. Slow" in text for text in known.statements)


def test_a_known_mass_makes_the_box_of_centers_smaller() -> None:
    obj, truth = make_case(MASS)
    model = learn(3, MASS)
    low, high = model.force.calc_mean_friction_bounds(obj)
    mean = truth.mass @ truth.friction / MASS
    assert low < mean < high and high - low < 0.8 * (FRICTION[1] - FRICTION[0])
    assert model.params.total_mass == pytest.approx(MASS)
    assert low < model.params.friction.mean() < high
    wide = calc_center_of_mass_box(model.identifiability.relative_friction, obj)
    box, center = model.identifiability.center_of_mass_box, truth.center_of_mass(obj)
    assert (box[0] >= wide[0] - 1e-9).all() and (box[1] <= wide[1] + 1e-9).all()
    assert (np.diff(box, axis=0) < 0.97 * np.diff(wide, axis=0)).all()
    assert (box[0] < center).all() and (center < box[1]).all()
    assert any("without forces it would be" in text for text in model.identifiability.statements)


def test_the_box_with_a_free_scale_is_that_without_forces() -> None:
    obj, _ = make_case(MASS)
    for seed in range(3):
        fraction = np.random.default_rng(seed).dirichlet(np.ones(obj.n))
        np.testing.assert_allclose(
            _calc_box_of_known_scale(fraction, obj, *FRICTION),
            calc_center_of_mass_box(fraction, obj),
            atol=1e-9,
        )


def test_at_a_bound_of_the_friction_all_cells_are_there_and_the_center_is_known() -> None:
    obj, _ = make_case(MASS)
    fraction = np.random.default_rng(0).dirichlet(np.ones(obj.n))
    box = _calc_box_of_known_scale(fraction, obj, FRICTION[1], FRICTION[1])
    np.testing.assert_allclose(box, np.tile(fraction @ obj.p_BC, (2, 1)), atol=1e-9)


def test_forces_that_point_backwards_are_left_out_or_not_believed_at_all() -> None:
    some = learn(1, backwards=2)
    assert (some.force.pushes, some.force.against) == (4, 2)
    assert any(
        "Left out are the forces of 2 pushes" in text for text in some.identifiability.statements
    )
    with pytest.warns(PushLogWarning, match=r"pull the object .*; the forces are not used"):
        none = learn(1, backwards=6)
    assert none.force is None
    np.testing.assert_array_equal(none.params.mass, learn_without_forces(1).params.mass)


def learn_without_forces(seed: int) -> Identification:
    obj, truth = make_case()
    return identify(Model(obj), make_pokes(obj, truth, 6, seed, noise=(3e-4, 3e-3)))


def test_without_forces_nothing_is_said_of_them() -> None:
    model = learn_without_forces(0)
    assert model.force is None
    assert not any("forces" in text for text in model.identifiability.statements)
    assert model.identifiability.statements[0].startswith(
        "Not identifiable from these data: the common scale"
    )


def test_a_mass_that_contradicts_the_forces_is_said_and_kept() -> None:
    model = learn(0, total_mass=10 * MASS)
    assert model.force.calc_mean_friction_bounds(model.obj) is None
    assert model.params.total_mass == pytest.approx(10 * MASS) and np.all(
        model.params.friction == 0.35
    )
    assert "contradicts what was told" in model.identifiability.statements[0]


def test_a_model_file_keeps_it(tmp_path) -> None:
    model = learn(4, MASS)
    write_model(tmp_path / "model.yaml", model)
    back = read_model(tmp_path / "model.yaml")
    assert back.force == model.force
    assert back.identifiability.statements == model.identifiability.statements
    np.testing.assert_allclose(
        back.identifiability.mass_min, model.identifiability.mass_min, rtol=1e-9
    )
    np.testing.assert_allclose(
        back.identifiability.center_of_mass_box, model.identifiability.center_of_mass_box
    )


@pytest.mark.parametrize(
    "name", ["hardboard_wide", "hardboard_middle", "hardboard_patch", "plywood_wide"]
)
def test_real_forces_give_a_steel_block_a_likely_friction(name: str) -> None:
    """1.518 kg on hardboard and plywood, whose friction is between 0.2 and 0.5."""
    log, obj = read_cmu(name)
    model = identify(Model(obj), log[:10])
    assert model.force is not None and model.force.pushes >= 9 and model.force.relative_std < 0.15
    low, high = model.force.calc_mean_friction_bounds(obj)
    assert 0.2 < low < high < 0.5
    wider_prior = replace(obj.prior, total_mass=None, friction_min=0.2, friction_max=0.5)
    lightest, heaviest = model.force.calc_mass_bounds(replace(obj, prior=wider_prior))
    assert 0.5 < lightest < 1.518 < heaviest < 4.0
