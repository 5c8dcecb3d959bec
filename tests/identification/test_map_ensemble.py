"""The average over ideas of how the object bears on the table."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from gridpush_drake.bench.data.protocol import make_case, make_protocol
from gridpush_drake.bench.truth.random_bodies import PATCHES_KIND, draw_body
from gridpush_drake.identification.fit import fit_average
from gridpush_drake.identification.fit.fit_average import (
    SHARED_SHIFT,
    MapEnsembleFit,
    _average_fractions,
    _compare_fractions,
    move_center,
)
from gridpush_drake.identification.fit.hypotheses import (
    CENTER_STD,
    DEFAULT_HYPOTHESES,
    FIELD_AMPLITUDES,
    LoadHypothesis,
    RigidBottom,
    SmoothField,
)
from gridpush_drake.identification.fit.load_modes import find_corners
from gridpush_drake.identification.fit.load_prior import LoadPrior, calc_prior_factor
from gridpush_drake.identification.fit.map_ensemble import MapEnsemble
from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.prediction import calc_mean_cell_error
from gridpush_drake.identification.result import calc_center_of_friction
from gridpush_drake.identification.statistics.center_of_mass import CenterOfMass
from gridpush_drake.identification.statistics.posterior import Posterior, calc_center_jacobian
from gridpush_drake.identification.statistics.problem import PushProblem
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.pushes.push_log import PushLog
from tests.helpers.finite_difference import check_jacobian
from tests.helpers.shapes import make_shape
from tests.identification.simulated_pokes import make_pokes

NOISE = (5e-4, 3.5e-3)


def learn(mass_ratio: float, amplitudes: tuple[float, ...] | None = None):
    obj = make_shape("l_bracket", 20)
    truth = CellParameters(
        np.where(obj.p_BC[:, 0] > 0.03, mass_ratio, 1.0), np.full(obj.n, 0.4), 0.35
    )
    fields = None if amplitudes is None else tuple(map(SmoothField, amplitudes))
    ensemble = MapEnsemble() if fields is None else MapEnsemble(hypotheses=fields)
    return identify(Model(obj), make_pokes(obj, truth, 4, 5, noise=NOISE), method=ensemble)


def test_evidence_chooses_the_amplitude_that_the_pushes_ask_for() -> None:
    even, uneven = learn(1.0), learn(8.0)
    assert even.status == "prior_kept" and uneven.status == "learned"
    prior_variance = [
        np.diag(found.posterior.prior_covariance)[:-1].mean() for found in (even, uneven)
    ]
    assert prior_variance[0] < 0.25 * prior_variance[1]
    weight = {one.name: one.weight for one in even.hypotheses}
    assert weight["smooth field 0.05"] + weight["smooth field 0.3"] > 0.75


@pytest.mark.slow
def test_pushes_left_out_tell_which_of_several_wrong_hypotheses_predicts_best() -> None:
    # By evidence alone one wrong prior gets nearly all the weight, and the mean error is 1.0 mm.
    errors = []
    for seed in (4, 9, 12):
        body = draw_body(PATCHES_KIND, seed, training=5, held_out=5)
        found = identify(Model(body.obj), body.training)
        errors.append(
            calc_mean_cell_error(Model(body.obj, found.params, found.physics), body.held_out)
        )
    assert np.mean(errors) < 0.7e-3


def test_the_region_holds_what_evidence_says_where_predictions_say_otherwise(monkeypatch) -> None:
    found = learn(8.0)
    center, _ = calc_center_of_friction(found)

    # An almost even object, far off, is made out to predict best by far.
    def favor_even(fits, evidences, noise):
        return np.where(np.arange(len(fits)) == 0, 300.0, 0.0)

    monkeypatch.setattr(fit_average, "_calc_predictives", favor_even)
    moved, covariance = calc_center_of_friction(learn(8.0))
    off = center - moved
    assert np.linalg.norm(off) > 0.01
    assert off @ np.linalg.solve(covariance, off) < 5.991


def test_average_lies_among_its_fits_and_its_spread_covers_theirs() -> None:
    found = learn(4.0)
    fits = np.array([start.z for start in found.starts])
    assert (found.posterior.mean >= fits.min(axis=0)).all() and (
        found.posterior.mean <= fits.max(axis=0)
    ).all()
    alone = [learn(4.0, (amplitude,)).posterior.covariance for amplitude in FIELD_AMPLITUDES]
    assert np.trace(found.posterior.covariance) >= min(np.trace(covariance) for covariance in alone)


def test_where_nothing_is_known_the_center_is_held_about_the_centroid_until_pushes_say_otherwise() -> (
    None
):
    obj = make_shape("l_bracket", 20)
    truth = CellParameters(np.where(obj.p_BC[:, 0] > 0.03, 50.0, 1.0), np.full(obj.n, 0.4), 0.35)
    centroid, true_center = obj.p_BC.mean(axis=0), truth.mass @ obj.p_BC / truth.total_mass

    def find_center(pushes: int, std: float | None):
        known = (
            None
            if std is None
            else CenterOfMass((centroid[0], centroid[1]), std * obj.radius_of_gyration)
        )
        problem = PushProblem(obj, make_pokes(obj, truth, pushes, 5, noise=NOISE), truth)
        z0 = problem.unknowns(CellParameters.uniform(obj))
        return (
            calc_fraction(MapEnsemble().fit(problem, z0, 0.3, known, lambda z, linear: None).z)
            @ obj.p_BC
        )

    held, alike, free = (find_center(1, std) for std in (None, CENTER_STD, 100.0))
    np.testing.assert_array_equal(held, alike)
    assert np.linalg.norm(held - centroid) < np.linalg.norm(free - centroid)
    assert np.linalg.norm(find_center(6, None) - true_center) < 2e-3


def test_no_number_of_pushes_makes_the_center_surer_than_what_their_loads_share() -> None:
    obj = make_shape("l_bracket", 20)
    truth = CellParameters(np.where(obj.p_BC[:, 0] > 0.03, 2.0, 1.0), np.full(obj.n, 0.4), 0.35)
    for count in (3, 12):
        found = identify(Model(obj), make_pokes(obj, truth, count, 5, noise=NOISE))
        x = found.posterior.calc_fraction()
        problem = PushProblem(obj, make_pokes(obj, truth, 1, 5), truth)
        floor = problem.calc_tilt_covariance(SHARED_SHIFT * found.load_shift_std)
        F = calc_center_jacobian(x, obj.p_BC)
        excess = found.identifiability.center_of_friction_covariance - F @ floor @ F.T
        assert np.linalg.eigvalsh(excess).min() > 0


def test_a_tilt_shifts_the_center_of_even_loads_by_as_much_as_it_says() -> None:
    obj = make_shape("l_bracket", 20)
    truth = CellParameters.uniform(obj)
    covariance = PushProblem(obj, make_pokes(obj, truth, 1, 5), truth).calc_tilt_covariance(0.002)
    F = calc_center_jacobian(np.full(obj.n, 1 / obj.n), obj.p_BC)
    np.testing.assert_allclose(F @ covariance @ F.T, 0.002**2 * np.eye(2), atol=1e-4 * 0.002**2)


def calc_fraction(z: np.ndarray) -> np.ndarray:
    return Posterior(z, np.eye(len(z)), np.eye(len(z))).calc_fraction()


def test_shares_average_and_their_spread_is_the_mixture_of_the_fits() -> None:
    rng = np.random.default_rng(0)
    fits, weights, n = rng.normal(0, 2, (3, 9)), np.array([0.5, 0.3, 0.2]), 8
    mean = _average_fractions(weights, list(fits))
    fractions = np.array([calc_fraction(z) for z in fits])
    np.testing.assert_allclose(calc_fraction(mean), weights @ fractions, rtol=1e-12)
    np.testing.assert_allclose(mean[n], weights @ fits[:, n], rtol=1e-12)
    slope = np.diag(calc_fraction(mean)) - np.outer(calc_fraction(mean), calc_fraction(mean))
    off = np.array([_compare_fractions(z, mean)[0] for z in fits])
    np.testing.assert_allclose(off[:, :n] @ slope, fractions - weights @ fractions, atol=1e-14)


def test_variations_of_a_fit_are_turned_into_those_of_the_average_exactly() -> None:
    rng = np.random.default_rng(1)
    z, mean = rng.normal(0, 1, (2, 7))
    T = _compare_fractions(z, mean)[1]
    ratio = 1 / calc_fraction(mean)
    J = (np.diag(calc_fraction(mean)) - np.outer(calc_fraction(mean), calc_fraction(mean))) @ T[:6]
    check_jacobian(lambda v: ratio * calc_fraction(v), z, ratio[:, None] * J, rtol=1e-6, atol=1e-9)
    even = np.append(np.ones(6), 0.0)
    np.testing.assert_allclose(T @ even, even, atol=1e-12)  # the common scale stays apart
    np.testing.assert_allclose(_compare_fractions(z, z)[1], np.eye(7), atol=1e-12)


def test_loads_put_on_the_grid_keep_their_center() -> None:
    obj = make_shape("l_bracket", 40)
    cells, places = find_corners(obj)
    assert len(cells) == len(set(cells.tolist())) == len(places) and (np.diff(cells) > 0).all()
    loads = obj.p_BC.copy()
    loads[cells] = places
    z = np.random.default_rng(2).normal(0, 0.5, obj.n + 1)
    moved = move_center(obj.p_BC, z, loads)
    wanted = calc_fraction(z) @ loads
    before, after = (np.linalg.norm(calc_fraction(v) @ obj.p_BC - wanted) for v in (z, moved))
    assert before > 1e-4 and after < 0.05 * before and moved[-1] == z[-1]


def test_a_rigid_bottom_on_its_corners_is_recognized() -> None:
    obj = make_shape("l_bracket", 20)
    cells, places = find_corners(obj)
    mass = np.full(obj.n, 1e-4)
    mass[cells[[0, 1, -1]]] = (0.5, 0.3, 0.2)
    truth = CellParameters(mass, np.full(obj.n, 0.4), 0.35)
    on_corners = np.array(obj.p_BC)
    on_corners[cells] = places
    problem = PushProblem(
        obj, make_pokes(replace(obj, p_BC=on_corners), truth, 5, 5, noise=NOISE), truth
    )
    z0 = problem.unknowns(CellParameters.uniform(obj))
    fit = MapEnsemble().fit(problem, z0, 0.3, None, lambda z, linear: None)
    assert fit.best is not None
    np.testing.assert_array_equal(fit.best.linearized.problem.obj.p_BC, on_corners)
    true_center = truth.mass @ on_corners / truth.total_mass
    assert np.linalg.norm(calc_fraction(fit.z) @ obj.p_BC - true_center) < 3e-3


def fit_pokes(contradicting: bool) -> tuple[GridObject, MapEnsembleFit]:
    """Six pushes of one object, or three of one and three of another."""
    obj = make_shape("l_bracket", 20)
    one, other = (CellParameters(np.where(side, 8.0, 1.0), np.full(obj.n, 0.4), 0.35)
                  for side in (obj.p_BC[:, 0] > 0.03, obj.p_BC[:, 0] < 0.03))  # fmt: skip
    pushes = *make_pokes(obj, one, 3, 5), *make_pokes(obj, other if contradicting else one, 3, 6)
    log = PushLog(tuple(replace(seen, name=f"push_{i}") for i, seen in enumerate(pushes)))
    problem = PushProblem(obj, log, one)
    z0 = problem.unknowns(CellParameters.uniform(obj))
    return obj, MapEnsemble().fit(problem, z0, 0.3, None, lambda z, linear: None)


def calc_region(obj: GridObject, fit: MapEnsembleFit) -> float:
    F = calc_center_jacobian(calc_fraction(fit.z), obj.p_BC)
    return float(np.sqrt(np.linalg.det(F @ fit.covariance @ F.T)))


def test_pushes_that_contradict_each_other_widen_what_is_said_and_good_ones_narrow_intervals() -> (
    None
):
    (obj, agreeing), (_, contradicting) = fit_pokes(False), fit_pokes(True)
    assert agreeing.interval_scale < 0.7 and contradicting.interval_scale == 1.0
    assert calc_region(obj, contradicting) > 2 * calc_region(obj, agreeing)


def test_pushes_that_agree_make_surer_of_what_none_shows_but_by_half_as_much(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    obj, surer = fit_pokes(False)
    monkeypatch.setattr(fit_average, "MIN_NOISE_FACTOR", np.inf)
    _, cautious = fit_pokes(False)
    np.testing.assert_array_equal(surer.z, cautious.z)
    assert surer.interval_scale == cautious.interval_scale < 1 / 2
    assert (
        (2 * surer.interval_scale) ** 2 < calc_region(obj, surer) / calc_region(obj, cautious) < 0.9
    )
    monkeypatch.setattr(fit_average, "MIN_NOISE_FACTOR", 1.0)
    assert calc_region(*fit_pokes(False)) < 0.9 * calc_region(obj, surer)


@pytest.mark.slow
def test_a_push_that_ends_far_off_is_not_explained_away_by_being_sensitive() -> None:
    case = make_case(make_protocol(), "pliers", 4)
    found, test = (
        identify(Model(case.obj), case.log.subset([1, 2, 3, 8, 6])),
        case.log.subset([0, 4, 5, 7, 9]),
    )
    assert calc_mean_cell_error(Model(case.obj, found.params, found.physics), test) < 0.005, (
        "26 mm from a poor optimum"
    )


@dataclass(frozen=True)
class HeavyRow(LoadHypothesis):
    """A hypothesis of a user's own: the cells beyond some x bear more than the others."""

    beyond: float
    name: str = "heavy row"

    def propose(self, setting):
        side = np.where(setting.obj.p_BC[:, 0] > self.beyond, 0.5, -0.5)
        C = 1e-4 * np.eye(setting.obj.n) + 2.0**2 * np.outer(side, side)
        factor = calc_prior_factor(C, 1.0, setting.log_contact_friction_std)
        return [LoadPrior(mean=setting.z0, factor=factor, weight=1.0, p_BC=setting.obj.p_BC)]


def test_a_hypothesis_of_ones_own_is_weighed_and_named() -> None:
    obj = make_shape("l_bracket", 20)
    truth = CellParameters(np.where(obj.p_BC[:, 0] > 0.03, 8.0, 1.0), np.full(obj.n, 0.4), 0.35)
    log = make_pokes(obj, truth, 4, 5, noise=NOISE)
    found = identify(Model(obj), log)
    # Those that the pushes choose come last; of two parts several cuts are proposed.
    unconditional = [one.name for one in DEFAULT_HYPOTHESES if not one.needs_pushes]
    names = [one.name for one in found.hypotheses]
    assert names[: len(unconditional)] == unconditional
    assert names[len(unconditional)] == "two parts 1" and names[-1] == "ring"
    assert sum(one.weight for one in found.hypotheses) == pytest.approx(1.0)
    assert max(one.log_evidence for one in found.hypotheses) == 0.0

    right, wrong = (
        identify(
            Model(obj),
            log,
            method=MapEnsemble(hypotheses=(*DEFAULT_HYPOTHESES, HeavyRow(beyond))),
        )
        for beyond in (0.03, -0.02)
    )
    weights = [
        next(one.weight for one in found.hypotheses if one.name == "heavy row")
        for found in (right, wrong)
    ]
    assert weights[0] > 0.5 and weights[1] < 0.1
    step = np.log(right.params.mass[obj.p_BC[:, 0] > 0.03].mean())
    step -= np.log(right.params.mass[obj.p_BC[:, 0] < 0.03].mean())
    assert step == pytest.approx(np.log(8), abs=0.5)


@dataclass(frozen=True)
class OwnField(LoadHypothesis):
    """A smooth field of a user's own."""

    amplitude: float

    @property
    def name(self):
        return f"own field {self.amplitude:g}"

    @property
    def field_amplitude(self):
        return self.amplitude

    def propose(self, setting):
        return SmoothField(self.amplitude).propose(setting)


def test_a_smooth_field_of_ones_own_is_fitted_as_those_that_are_shipped() -> None:
    obj = make_shape("l_bracket", 20)
    truth = CellParameters(np.where(obj.p_BC[:, 0] > 0.03, 8.0, 1.0), np.full(obj.n, 0.4), 0.35)
    log = make_pokes(obj, truth, 3, 5, noise=NOISE)
    shipped, own = (
        identify(Model(obj), log, MapEnsemble(hypotheses=tuple(map(kind, (3.0, 0.3, 1.5)))))
        for kind in (SmoothField, OwnField)
    )
    assert [one.name for one in own.hypotheses] == [f"own field {a}" for a in ("0.3", "1.5", "3")]
    np.testing.assert_array_equal(own.params.mass, shipped.params.mass)
    np.testing.assert_array_equal(own.posterior.covariance, shipped.posterior.covariance)


@pytest.mark.parametrize("alone", [RigidBottom(), SmoothField(1.5), HeavyRow(0.03)])
def test_one_hypothesis_is_enough(alone) -> None:
    obj = make_shape("l_bracket", 20)
    truth = CellParameters(np.where(obj.p_BC[:, 0] > 0.03, 8.0, 1.0), np.full(obj.n, 0.4), 0.35)
    log = make_pokes(obj, truth, 3, 5, noise=NOISE)
    found = identify(Model(obj), log, method=MapEnsemble(hypotheses=(alone,)))
    assert [one.name for one in found.hypotheses] == [alone.name]
    # On its corners alone the object explains its pushes poorly, and that is what is said.
    poor = isinstance(alone, RigidBottom)
    assert found.status == ("explains_little" if poor else "learned")
    assert np.isfinite(found.posterior.covariance).all()
