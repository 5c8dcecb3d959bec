"""Ideas of how an object bears on the table, and the cuts by which it may be of two parts."""

from dataclasses import fields, replace
from itertools import product

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.stats import multivariate_normal

from gridpush_drake.errors import IdentificationError
from gridpush_drake.geometry.se2 import make_direction
from gridpush_drake.identification.fit.hypotheses import (
    DEFAULT_HYPOTHESES,
    Concentrated,
    NamedMaterials,
    Ring,
    TwoParts,
    UniformParts,
)
from gridpush_drake.identification.fit.load_modes import (
    CUT_ANGLES,
    MIN_PART,
    RING_WIDTH,
    calc_material_loads,
    calc_material_stds,
    calc_part_modes,
    calc_radius_mode,
    find_corners,
    find_cuts,
    find_part_borders,
    find_rings,
)
from gridpush_drake.identification.fit.load_prior import (
    HypothesisInputs,
    LinearizedPushes,
    calc_smooth_covariance,
)
from gridpush_drake.identification.fit.map_ensemble import MapEnsemble
from gridpush_drake.identification.fit.mode_choice import ALIKE_CORRELATION, calc_cut_evidence
from gridpush_drake.identification.learning import describe_prior, identify
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.prediction import calc_mean_cell_error
from gridpush_drake.identification.statistics.center_of_mass import FRICTION_STD
from gridpush_drake.objects.object_file import PartMaterial
from gridpush_drake.objects.parameters import CellParameters
from tests.helpers.shapes import make_shape
from tests.identification.simulated_pokes import make_pokes

MU_STD = 0.3

PARTS = TwoParts()


def propose_parts(obj, z0, residuals, J, known=0):
    pushes = LinearizedPushes(residuals, J, known)
    return PARTS.propose(HypothesisInputs(obj, z0, MU_STD).with_pushes(pushes))


def make_evidence(obj, rows, seed):
    """Whitened residuals at the prior mean and their derivatives, of no pushes in particular."""
    rng = np.random.default_rng(seed)
    return rng.normal(0, 1.5, rows), rng.normal(0, 0.3, (rows, obj.n + 1))


def calc_dense_evidence(covariance, residuals, J):
    """Log p(residuals), of linear residuals with unit noise and a normal prior of z, by the definition."""
    spread = np.eye(len(residuals)) + J @ covariance @ J.T
    return multivariate_normal(np.zeros(len(residuals)), spread).logpdf(residuals)


def make_covariance(obj, cut):
    C = calc_smooth_covariance(obj)
    return block_diag(PARTS.amplitude**2 * C + PARTS.part_std**2 * np.outer(cut, cut), MU_STD**2)


def test_cuts_are_straight_and_leave_both_parts_their_share() -> None:
    obj = make_shape("claw_hammer", 40)
    cuts = find_cuts(obj)
    assert len(cuts) > 40 and np.abs(cuts).max() == 0.5
    assert np.minimum((cuts > 0).mean(axis=1), (cuts < 0).mean(axis=1)).min() >= MIN_PART
    along = obj.p_BC @ make_direction(np.pi / CUT_ANGLES * np.arange(CUT_ANGLES)).T
    for h in cuts:
        gap = along[h == 0.5].min(axis=0) - along[h == -0.5].max(axis=0)
        assert gap.max() > 0  # in some direction one part lies wholly beyond the other
    assert not len(find_cuts(make_shape("square", 1)))


@pytest.mark.parametrize("known", [0, 2])
def test_the_evidence_of_a_cut_is_that_of_its_dense_covariance(known: int) -> None:
    obj = make_shape("l_bracket", 20)
    residuals, J = make_evidence(obj, 9, 0)
    cuts = find_cuts(obj)
    none = make_covariance(obj, np.zeros(obj.n))
    expected = []
    for cut in cuts:
        S = make_covariance(obj, cut)
        gain = calc_dense_evidence(S, residuals, J) - calc_dense_evidence(none, residuals, J)
        if known:
            gain -= calc_dense_evidence(S, residuals[-known:], J[-known:])
            gain += calc_dense_evidence(none, residuals[-known:], J[-known:])
        expected.append(gain)
    found = calc_cut_evidence(cuts, PARTS.part_std, none, residuals, J)
    if known:
        found -= calc_cut_evidence(cuts, PARTS.part_std, none, residuals[-known:], J[-known:])
    np.testing.assert_allclose(found, expected, atol=1e-9)
    prior = propose_parts(obj, np.zeros(obj.n + 1), residuals, J, known)[0]
    np.testing.assert_allclose(
        prior.factor @ prior.factor.T, make_covariance(obj, cuts[np.argmax(expected)])
    )


@pytest.mark.parametrize("rows", [9, 90])
def test_each_cut_begins_at_its_linear_optimum_and_no_two_are_alike(rows: int) -> None:
    obj = make_shape("l_bracket", 20)
    z0 = np.random.default_rng(1).normal(0, 1, obj.n + 1)
    residuals, J = make_evidence(obj, rows, 2)
    found = propose_parts(obj, z0, residuals, J)
    assert len(found) == PARTS.max_cuts
    for prior in found:
        z = prior.start
        precision = np.linalg.inv(prior.factor @ prior.factor.T)
        gradient = precision @ (z - z0) + J.T @ (residuals + J @ (z - z0))
        np.testing.assert_allclose(gradient, 0, atol=1e-6 * np.abs(J.T @ residuals).max())
    within = PARTS.amplitude**2 * calc_smooth_covariance(obj)
    cuts = [
        np.linalg.eigh((prior.factor @ prior.factor.T)[:-1, :-1] - within)[1][:, -1]
        for prior in found
    ]
    correlation = np.abs(np.corrcoef(cuts))
    assert correlation[np.triu_indices(PARTS.max_cuts, 1)].max() <= ALIKE_CORRELATION + 1e-6
    fractions = [prior.evidence_fraction for prior in found]
    assert min(fractions) > 0 and sum(fractions) <= 1


def test_four_pushes_show_two_parts_and_how_they_differ() -> None:
    obj = make_shape("claw_hammer", 30)
    side = obj.p_BC @ make_direction(0.0) > 0.02
    truth = CellParameters(np.where(side, 0.3, 0.06), np.full(obj.n, 0.4), 0.35)
    found = identify(Model(obj), make_pokes(obj, truth, 4, 3, noise=(5e-4, 3.5e-3)))
    log_k = np.log(found.params.mass)
    step = log_k[side].mean() - log_k[~side].mean()
    assert step == pytest.approx(np.log(5), abs=0.35)
    assert max(log_k[side].std(), log_k[~side].std()) < 0.35


def test_corners_are_those_of_the_convex_hull() -> None:
    obj = make_shape("square", 16)
    cells, places = find_corners(obj)
    assert len(cells) == 4
    np.testing.assert_allclose(np.abs(places), np.abs(places).max())


def test_the_radius_mode_is_the_squared_distance_from_the_middle_standardized() -> None:
    obj = make_shape("claw_hammer", 40)
    q = calc_radius_mode(obj)
    assert q.mean() == pytest.approx(0, abs=1e-12) and q.std() == pytest.approx(1)
    distance2 = ((obj.p_BC - obj.p_BC.mean(axis=0)) ** 2).sum(axis=1)
    slope, level = np.polyfit(distance2, q, 1)
    np.testing.assert_allclose(slope * distance2 + level, q, atol=1e-9)
    # It says the same of an object that is turned and moved.
    turned = replace(obj, p_BC=obj.p_BC @ [[0.6, 0.8], [-0.8, 0.6]] + [0.3, -0.2])
    np.testing.assert_allclose(calc_radius_mode(turned), q, atol=1e-9)


@pytest.mark.parametrize("cells", [1, 4])
def test_cells_that_are_all_as_far_from_the_middle_have_no_radius(cells: int) -> None:
    obj = make_shape("square", cells)
    assert obj.n == cells and not calc_radius_mode(obj).any()
    assert Concentrated().propose(HypothesisInputs(obj, np.zeros(obj.n + 1), MU_STD)) == []


def test_the_prior_of_a_concentrated_load_is_that_of_its_equation() -> None:
    obj = make_shape("l_bracket", 20)
    z0 = np.random.default_rng(3).normal(0, 1, obj.n + 1)
    asked = Concentrated(weight=0.5, radius_std=1.5, amplitude=0.2, range_cells=3.0)
    (prior,) = asked.propose(HypothesisInputs(obj, z0, MU_STD))
    q = calc_radius_mode(obj)
    C = 0.2**2 * calc_smooth_covariance(obj, 3.0) + 1.5**2 * np.outer(q, q)
    np.testing.assert_allclose(prior.factor @ prior.factor.T, block_diag(C, MU_STD**2), atol=1e-9)
    np.testing.assert_array_equal(prior.mean, z0)
    assert prior.weight == 0.5 and prior.p_BC is obj.p_BC and not asked.needs_pushes


@pytest.mark.parametrize("kind", [Concentrated, Ring])
@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
def test_round_loads_have_positive_numbers(kind, value: float) -> None:
    for field in fields(kind):
        match = rf"{kind.__name__}: {field.name} is .*; expected a positive finite number"
        with pytest.raises(IdentificationError, match=match):
            kind(**{field.name: value})


def learn_round_bodies(profile, left_out: str) -> tuple[list[float], list[float], list[float]]:
    """Learns three bodies whose load is a function of the distance from the middle, with all
    hypotheses and without one of them.

    Args:
        profile: the load by the distance, in radii of gyration.
        left_out: the name of the hypothesis.

    Returns:
        Errors of held-out pushes with all and without it, m, and its weights.
    """
    rest = tuple(one for one in DEFAULT_HYPOTHESES if one.name != left_out)
    with_all, without, weights = [], [], []
    for seed, name in enumerate(("square", "l_bracket", "claw_hammer")):
        obj = make_shape(name, 60)
        r = np.linalg.norm(obj.p_BC - obj.p_BC.mean(axis=0), axis=1) / obj.radius_of_gyration
        load = profile(r) + 1e-3
        truth = CellParameters(load / load.sum(), np.full(obj.n, 0.35), 0.4, patch_ratio=0.2)
        train = make_pokes(obj, truth, 5, 10 + seed, length=0.1, noise=(5e-4, 3.5e-3))
        test = make_pokes(obj, truth, 10, 100 + seed, length=0.1)
        found = identify(Model(obj), train)
        with_all.append(calc_mean_cell_error(Model(obj, found.params, found.physics), test))
        weights += [one.weight for one in found.hypotheses if one.name == left_out]
        found = identify(Model(obj), train, method=MapEnsemble(hypotheses=rest))
        without.append(calc_mean_cell_error(Model(obj, found.params, found.physics), test))
    return with_all, without, weights


@pytest.mark.slow
def test_a_bowl_is_learned_better_where_its_radius_is_a_freedom_of_its_own() -> None:
    with_all, without, weights = learn_round_bodies(
        lambda r: np.exp(-0.5 * (r / 0.4) ** 2), "concentrated"
    )
    assert np.mean(with_all) < 0.6 * np.mean(without)
    assert np.median(weights) > 0.9


@pytest.mark.parametrize("cells", [1, 4])
def test_cells_that_are_all_as_far_from_the_middle_make_no_ring(cells: int) -> None:
    obj = make_shape("square", cells)
    residuals, J = make_evidence(obj, 9, 0)
    pushes = LinearizedPushes(residuals, J)
    assert not len(find_rings(obj))
    setting = HypothesisInputs(obj, np.zeros(obj.n + 1), MU_STD).with_pushes(pushes)
    assert Ring().propose(setting) == []


def test_rings_are_standardized_and_highest_at_their_radius() -> None:
    obj = make_shape("claw_hammer", 60)
    rings = find_rings(obj)
    assert len(rings) > 5
    np.testing.assert_allclose(rings.mean(axis=1), 0, atol=1e-12)
    np.testing.assert_allclose(rings.std(axis=1), 1)
    r = np.linalg.norm(obj.p_BC - obj.p_BC.mean(axis=0), axis=1) / obj.radius_of_gyration
    tops = r[rings.argmax(axis=1)]
    assert (np.diff(tops) >= 0).all() and np.ptp(tops) > 2 * RING_WIDTH
    for h, top in zip(rings, tops, strict=True):
        order = np.argsort(np.abs(r - top))
        assert np.corrcoef(h, -np.abs(r - top))[0, 1] > 0.5
        assert h[order[0]] > 0 > h[order[-1]]


def test_a_ring_begins_at_its_linear_optimum() -> None:
    obj = make_shape("l_bracket", 20)
    z0 = np.random.default_rng(1).normal(0, 1, obj.n + 1)
    residuals, J = make_evidence(obj, 9, 2)
    setting = HypothesisInputs(obj, z0, MU_STD).with_pushes(LinearizedPushes(residuals, J))
    (prior,) = Ring().propose(setting)
    covariance = prior.factor @ prior.factor.T
    gradient = np.linalg.solve(covariance, prior.start - z0)
    gradient += J.T @ (residuals + J @ (prior.start - z0))
    np.testing.assert_allclose(gradient, 0, atol=1e-6 * np.abs(J.T @ residuals).max())
    # Of all rings it is the one of most evidence, by the definition.
    within = Ring.amplitude**2 * calc_smooth_covariance(obj)
    evidences, found = [], []
    for h in find_rings(obj):
        C = block_diag(within + Ring.ring_std**2 * np.outer(h, h), MU_STD**2)
        evidences.append(calc_dense_evidence(C, residuals, J))
        found.append(np.allclose(C, covariance))
    assert found[int(np.argmax(evidences))]


def test_a_ring_is_learned_better_where_rings_are_tried() -> None:
    with_all, without, weights = learn_round_bodies(
        lambda r: np.exp(-0.5 * ((r - 0.9) / 0.12) ** 2), "ring"
    )
    assert np.mean(with_all) < 0.8 * np.mean(without)
    assert max(weights) > 0.9


def see_parts(obj, labels):
    """The object whose parts are seen, and may be of one material each."""
    return replace(obj, labels=labels, prior=replace(obj.prior, uniform_parts=True))


def test_borders_of_parts_are_the_cells_next_to_another_part() -> None:
    obj = make_shape("l_bracket", 20)
    labels = np.where(obj.p_BC[:, 0] > 0.02, 5, 2)
    parted = see_parts(obj, labels)
    h = calc_part_modes(parted)
    np.testing.assert_allclose(h.mean(axis=1), 0, atol=1e-12)
    np.testing.assert_allclose(np.ptp(h, axis=1), 1)
    np.testing.assert_array_equal(h[1] > 0, labels == 5)
    near = np.abs(obj.p_BC[:, 0] - 0.02) < obj.cell_size
    assert set(find_part_borders(parted)) == set(np.flatnonzero(near))
    assert not len(find_part_borders(obj))


def test_parts_that_look_alike_are_learned_from_two_pushes_and_paint_does_no_harm() -> None:
    shape = make_shape("claw_hammer", 60)
    labels = np.where(shape.p_BC[:, 0] > np.median(shape.p_BC[:, 0]), 2, 1)
    labels[shape.p_BC[:, 1] > np.quantile(shape.p_BC[:, 1], 0.8)] = 3
    ratios = {"parts": np.array([1.0, 6.0, 0.3]), "paint": np.ones(3)}
    errors = {(name, seen): 0.0 for name in ratios for seen in (True, False)}
    for (name, seen), seed in product(errors, range(3)):
        truth = CellParameters(ratios[name][labels - 1], np.full(shape.n, 0.4), 0.4)
        obj = see_parts(shape, labels) if seen else shape
        train = make_pokes(obj, truth, 2, seed, noise=(5e-4, 3.5e-3))
        test = make_pokes(obj, truth, 10, 100 + seed)
        found = identify(Model(obj), train)
        assert ("uniform parts" in [one.name for one in found.hypotheses]) == seen
        errors[name, seen] += calc_mean_cell_error(Model(obj, found.params, found.physics), test)
    assert errors["parts", True] < 0.6 * errors["parts", False]
    assert errors["paint", True] < errors["paint", False] + 3e-4


def name_materials(obj, densities, spread):
    """The object with densities told of its parts 1, 2, ..., each to within a factor."""
    told = tuple(
        PartMaterial(label=label, name=f"material {label}", density=density, spread=spread)
        for label, density in enumerate(densities, start=1)
    )
    return replace(obj, prior=replace(obj.prior, materials=told))


def test_named_materials_tell_ratios_of_loads_and_how_far_they_may_be_off() -> None:
    obj = make_shape("l_bracket", 20)
    obj = replace(obj, labels=1 + np.arange(obj.n) % 3)
    told = name_materials(obj, [700.0, 7800.0], spread=1.5)
    m = calc_material_loads(told)
    np.testing.assert_allclose(np.exp(m).mean(), 1)  # the whole load stays as it is
    steel, wood, untold = (m[obj.labels == label] for label in (2, 1, 3))
    np.testing.assert_allclose(np.exp(steel[0] - wood), 7800 / 700)
    np.testing.assert_allclose(untold, (steel[0] + wood[0]) / 2)
    np.testing.assert_allclose(
        calc_material_loads(name_materials(obj, [0.7, 7.8], spread=1.5)), m, atol=1e-12
    )
    stds = calc_material_stds(told, unknown_std=1.5)
    np.testing.assert_allclose(stds, [np.hypot(np.log(1.5), FRICTION_STD)] * 2 + [1.5])

    residuals, J = make_evidence(obj, 30, seed=3)
    setting = HypothesisInputs(told, np.zeros(obj.n + 1), MU_STD)
    asked = setting.with_pushes(LinearizedPushes(residuals, J))
    (prior,) = NamedMaterials().propose(asked)
    np.testing.assert_allclose(prior.mean, np.append(m, 0))
    # The fit begins at the most probable z of the linear pushes under this prior.
    gradient = np.linalg.solve(prior.factor @ prior.factor.T, prior.start - prior.mean)
    np.testing.assert_allclose(gradient + J.T @ (residuals + J @ prior.start), 0, atol=1e-6)
    assert len(UniformParts().propose(asked)) == 1  # named parts are uniform ones, too
    assert NamedMaterials().propose(replace(asked, obj=obj)) == []
    of_one = replace(told, labels=np.ones(obj.n, dtype=int))
    assert NamedMaterials().propose(replace(asked, obj=of_one)) == []


def test_an_object_of_named_materials_bears_as_they_say_before_any_push() -> None:
    shape = make_shape("claw_hammer", 60)
    labels = np.where(shape.p_BC[:, 0] > np.median(shape.p_BC[:, 0]), 2, 1)
    told = name_materials(replace(shape, labels=labels), [1.0, 8.0], spread=1.5)
    mass = describe_prior(told).params.mass
    np.testing.assert_allclose(mass[labels == 2].min() / mass[labels == 1].max(), 8.0)
    np.testing.assert_allclose(mass.sum(), describe_prior(shape).params.mass.sum())


def test_named_materials_are_learned_from_one_push_and_wrong_ones_do_no_harm() -> None:
    shape = make_shape("claw_hammer", 60)
    labels = np.where(shape.p_BC[:, 0] > np.median(shape.p_BC[:, 0]), 2, 1)
    labels[shape.p_BC[:, 1] > np.quantile(shape.p_BC[:, 1], 0.8)] = 3
    densities = np.array([1.0, 6.0, 0.3])
    looks = see_parts(shape, labels)
    told = {
        "looks": looks,
        "right": name_materials(looks, densities, spread=1.2),
        "off": name_materials(looks, densities * [2.0, 0.5, 2.0], spread=2.0),
    }
    truth = CellParameters(densities[labels - 1], np.full(shape.n, 0.4), 0.4)
    errors = dict.fromkeys(told, 0.0)
    for (name, obj), seed in product(told.items(), range(3)):
        train = make_pokes(obj, truth, 1, seed, noise=(5e-4, 3.5e-3))
        test = make_pokes(obj, truth, 10, 100 + seed)
        found = identify(Model(obj), train)
        errors[name] += calc_mean_cell_error(Model(obj, found.params, found.physics), test)
    assert errors["right"] < 0.5 * errors["looks"]
    assert errors["off"] < errors["looks"]


def test_nothing_is_proposed_where_no_parts_are_known() -> None:
    obj = make_shape("square", 16)
    setting = HypothesisInputs(obj, np.zeros(obj.n + 1), MU_STD)
    assert UniformParts().propose(setting) == []
    painted = replace(setting, obj=see_parts(obj, np.ones(obj.n, dtype=int)))
    assert UniformParts().propose(painted) == []
