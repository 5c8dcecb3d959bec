"""A learned model whose object was weighed: what it says of cells, in files, and of draws."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from gridpush_drake.dynamics.physics import GRAVITY
from gridpush_drake.errors import IdentificationError
from gridpush_drake.identification.absolute.estimate import (
    CENTER_INDICES,
    LOG_FRICTION,
    AbsoluteEstimate,
)
from gridpush_drake.identification.absolute.masses import (
    FRICTION_SCATTER,
    calc_cell_stds,
    tilt_to_center,
)
from gridpush_drake.identification.fit.learning_task import Abilities, Found, LearningTask
from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.model_file import read_model, write_model
from gridpush_drake.identification.result import Identification, calc_center_of_mass
from gridpush_drake.identification.tilt_tests.weighed_model import (
    _note_center_outside,
    calc_center_prior,
    estimate_masses,
)
from gridpush_drake.multibody.ground_truth import sample_ground_truth
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import find_shipped_object
from gridpush_drake.pushes.weighings import MassTestLog, TiltTest
from gridpush_drake.report.page import list_numbers
from tests.helpers.weighed_objects import Truth, make_problem, weigh_exactly
from tests.identification.simulated_pokes import make_pokes
from tests.identification.test_force_scale import MASS, learn, make_case

SIZE = 0.3
"""Size of the made-up weighings: their tips press on the object of these tests."""


@pytest.fixture(scope="module")
def learned():
    return learn(3)


@pytest.fixture(scope="module")
def truth():
    return make_case()[1]


@pytest.fixture(scope="module")
def weighed(learned, truth):
    obj = learned.obj
    made = Truth(MASS, truth.center_of_mass(obj), float(truth.mass @ truth.friction) / MASS)
    headings = (0.0, np.pi, np.pi / 2)
    rng = np.random.default_rng(1)
    log = make_problem(made, rng, headings, force_std=0.05, size=SIZE).log
    return estimate_masses(learned, log)


def test_mass_center_and_friction_are_near_the_truth(weighed, truth):
    obj = weighed.obj
    found = weighed.absolute
    low, high = found.mass_interval
    assert low < MASS < high < 1.05 * low
    off = found.center_of_mass - truth.center_of_mass(obj)
    assert (np.abs(off) < 3 * found.center_std).all() and np.abs(off).max() < 0.003
    low, high = found.friction_interval
    assert low < truth.mass @ truth.friction / MASS < high < 1.5 * low
    low, high = found.inertia_interval
    assert low < truth.inertia(obj) < high
    assert abs(found.inertia / truth.inertia(obj) - 1) < 0.1


def test_cells_have_what_is_known(weighed, learned):
    params = weighed.params
    found = weighed.absolute
    assert params.total_mass == pytest.approx(found.total_mass)
    np.testing.assert_allclose(params.center_of_mass(weighed.obj), found.center_of_mass, atol=1e-7)
    assert params.mass @ params.friction / params.total_mass == pytest.approx(found.friction)
    # What the pushes showed is kept.
    np.testing.assert_allclose(
        params.relative_friction(), learned.params.relative_friction(), rtol=1e-9
    )
    center, covariance = calc_center_of_mass(weighed)
    np.testing.assert_array_equal(center, found.center_of_mass)
    np.testing.assert_array_equal(covariance, found.center_covariance)
    known = weighed.identifiability
    assert known.mass_min.sum() < found.total_mass < known.mass_max.sum()
    assert np.diff(known.center_of_mass_box, axis=0).max() < 0.01
    assert known.statements[0].startswith(
        "Weighed by 6 presses at the edge, 1 lift and 6 pushes with measured forces: "
    )


def test_no_statement_contradicts_the_weighings(weighed, learned):
    said = " ".join(weighed.identifiability.statements)
    before = " ".join(learned.identifiability.statements)
    for words in ("Hence with friction", "was not measured", "with equal coefficients it is at"):
        assert words in before
        assert words not in said
    assert "the masses shown are those nearest to it, as a whole, that have the weighed" in said
    x, y = np.diff(weighed.identifiability.center_of_mass_box, axis=0)[0] * 1e3
    assert f"the weighings leave {x:.0f} mm by {y:.0f} mm of it" in said


def test_a_center_may_be_elsewhere_than_that_of_friction(learned):
    center, covariance = calc_center_prior(learned)
    np.testing.assert_allclose(center, learned.params.center_of_mass(learned.obj), atol=1e-9)
    alone = calc_center_of_mass(learned)[1]
    assert (np.diag(covariance) > np.diag(alone)).all()
    known = replace(learned.obj.prior, friction_max=0.3501, friction_min=0.3499)
    even = replace(learned, objects=(replace(learned.obj, prior=known),))
    np.testing.assert_allclose(calc_center_prior(even)[1], alone, rtol=1e-2)


def test_a_center_that_weighings_put_elsewhere_than_pushes_is_weighed_and_said(learned, tmp_path):
    """It is 25 mm from where pushes see the friction, as on feet of very different friction."""
    center = learned.params.center_of_mass(learned.obj) + [-0.02, -0.015]
    made = Truth(MASS, center, 0.4)
    rng = np.random.default_rng(5)
    problem = make_problem(made, rng, (0.0, np.pi, np.pi / 2), force_std=0.05, size=SIZE)
    found = estimate_masses(learned, problem.log)
    assert found.weighed is not None
    assert found.absolute.center_outlier_probability > 0.9
    off = found.absolute.center_of_mass - center
    assert np.abs(off).max() < 0.004
    said = " ".join(found.identifiability.statements)
    assert "What the pushes say of the center of mass is not used" in said
    write_model(tmp_path / "model.yaml", found)
    back = read_model(tmp_path / "model.yaml")
    assert back.absolute.center_outlier_probability == found.absolute.center_outlier_probability


def test_draws_spread_as_is_said(weighed):
    draws = weighed.draws(300, seed=2)
    found = weighed.absolute
    masses = np.array([draw.total_mass for draw in draws])
    low, high = found.mass_interval
    assert 0.9 < ((masses > low) & (masses < high)).mean() < 0.99
    scales = np.array([draw.mass @ draw.friction for draw in draws]) * GRAVITY
    assert 0.3 < np.std(np.log(scales)) / weighed.force.relative_std < 1.7
    centers = np.array([draw.center_of_mass(weighed.obj) for draw in draws])
    np.testing.assert_allclose(centers.std(axis=0), found.center_std, rtol=0.2)
    # The friction of a cell apart from the others hangs on where the center of mass is.
    cells = np.std([np.log(draw.friction) for draw in draws], axis=0)
    scatter = FRICTION_SCATTER * weighed.obj.prior.log_friction_std
    said = np.sqrt((weighed.std.friction / weighed.params.friction) ** 2 - scatter**2)
    np.testing.assert_allclose(cells, said, rtol=0.25)
    assert said.max() > 1.2 * np.sqrt(found.covariance[LOG_FRICTION, LOG_FRICTION])
    again = weighed.draws(300, seed=2)
    assert all((one.mass == other.mass).all() for one, other in zip(draws, again, strict=True))


@pytest.mark.parametrize("friction", [(0.1, 0.9), (0.2, 0.6)])
def test_what_is_said_of_single_cells_holds(friction):
    """Of objects with frictions that differ from part to part, weighed and pushed without error."""
    off = []
    for name in ("claw_hammer", "pliers", "spray_bottle", "toolbox"):
        obj = GridObject.from_yaml(find_shipped_object(name))
        least, most = friction
        prior = replace(obj.prior, friction=0.35, friction_min=least, friction_max=most)
        obj = replace(obj, prior=prior)
        for seed in range(15):
            truth = sample_ground_truth(obj, seed, friction_range=friction, friction_by_part=True)
            mean, params = weigh_exactly(obj, truth)
            found = AbsoluteEstimate(mean, 1e-12 * np.eye(4), pushes=5)
            stds = calc_cell_stds(Model(obj, params), np.zeros(obj.n), np.zeros((2, 2)), found)
            errors = np.log(truth.mass / params.mass), np.log(truth.friction / params.friction)
            off += [error / std for error, std in zip(errors, stds, strict=True)]
    off = np.concatenate(off)
    assert 0.8 < np.sqrt((off**2).mean()) < 1.2
    assert (np.abs(off) < 1.96).mean() > 0.88


def test_a_model_file_keeps_it(tmp_path, weighed):
    write_model(tmp_path / "model.yaml", weighed)
    back = read_model(tmp_path / "model.yaml")
    np.testing.assert_array_equal(back.absolute.mean, weighed.absolute.mean)
    np.testing.assert_array_equal(back.absolute.covariance, weighed.absolute.covariance)
    assert back.absolute.inertia_interval == weighed.absolute.inertia_interval
    assert back.identifiability.statements == weighed.identifiability.statements
    np.testing.assert_array_equal(back.params.mass, weighed.params.mass)
    np.testing.assert_array_equal(back.params.friction, weighed.params.friction)
    text = (tmp_path / "model.yaml").read_text()
    assert "absolute:" in text and "low:" in text
    (tmp_path / "bad.yaml").write_text(text.replace("presses: 6", "presses: -6"))
    with pytest.raises(IdentificationError, match=r"bad\.yaml.*absolute\.presses"):
        read_model(tmp_path / "bad.yaml")


def test_the_report_tells_it_beside_the_truth(weighed, truth):
    rows = {name: (found, true) for name, found, true in list_numbers(weighed, truth)}
    assert "weighed: " in rows["total mass"][0]
    assert rows["total mass"][1] == f"{MASS:.3g} kg"
    for name in (
        "center of mass, weighed",
        "mean friction, of forces and weighings",
        "inertia about the vertical axis",
    ):
        assert all(rows[name])


def test_without_forces_the_friction_stays_as_supposed(learned, weighed):
    log = make_problem(Truth(MASS, np.zeros(2), 0.4), np.random.default_rng(1), size=SIZE).log
    unmoved = estimate_masses(replace(learned, force=None), log)
    params = unmoved.params
    supposed = learned.params.mass @ learned.params.friction / learned.params.total_mass
    assert params.mass @ params.friction / params.total_mass == pytest.approx(supposed)
    assert "forces of no push were measured" in unmoved.identifiability.statements[0]


@dataclass
class Remembered:
    """A method of one's own: it finds the same model each time, and notes what it was asked."""

    model: Identification
    abilities: Abilities
    asked: list[LearningTask] = field(default_factory=list)
    name: str = "remembered"

    def learn(self, task: LearningTask) -> Found:
        self.asked.append(task)
        return Found(self.model, task.screened)


@pytest.mark.parametrize("holds_friction", [False, True])
def test_pushes_are_learned_from_again_with_the_frictions_that_weighings_tell(
    learned, holds_friction
):
    method = Remembered(learned, Abilities(holds_friction=holds_friction))
    log = make_pokes(learned.obj, learned.params, 1, 0)
    found = identify(Model(learned.obj), log, method, start=learned)
    assert found.absolute is None and found.unweighed is found
    assert [(task.starts, task.friction) for task in method.asked] == [(learned.starts, None)]

    press = TiltTest(np.zeros(3), np.array([0.08, 0.0]), 3.0, np.array([0.05, 0.0]), 0.0)
    found = identify(Model(learned.obj), log, method, weighings=MassTestLog((press,)))
    assert found.absolute.presses == 1 and found.unweighed.params is learned.params
    held = [task.friction for task in method.asked[1:]]
    assert held[0] is None and len(held) == 1 + holds_friction
    if holds_friction:
        np.testing.assert_array_equal(held[1].coefficients, found.params.friction)


def test_no_weighing_is_refused(learned):
    with pytest.raises(IdentificationError, match="there are none"):
        estimate_masses(learned, MassTestLog())


@pytest.mark.parametrize("seed", range(3))
def test_tilted_loads_have_the_center_and_are_the_nearest(seed):
    rng = np.random.default_rng(seed)
    p = rng.uniform(-0.1, 0.1, (40, 2))
    fraction = rng.dirichlet(np.ones(40))
    center = 0.5 * fraction @ p + 0.5 * p[rng.integers(40)]
    a = tilt_to_center(fraction, p, center)
    np.testing.assert_allclose(a @ p, center, atol=1e-9)
    assert a.sum() == pytest.approx(1)
    # Any other loads with that center are farther off in relative entropy.
    nearest = a @ np.log(a / fraction)
    null = np.linalg.svd(np.vstack([np.ones(40), p.T]))[2][3:]
    for _ in range(20):
        other = a + 0.01 * a.min() * (rng.standard_normal(37) @ null)
        assert other @ np.log(other / fraction) > nearest


def test_a_center_that_no_loads_have_is_come_near_to():
    p = np.array([[-0.1, 0.0], [0.1, 0.0], [0.0, 0.05]])
    a = tilt_to_center(np.full(3, 1 / 3), p, np.array([0.2, 0.0]))
    assert np.isfinite(a).all() and (a > 0).all() and a[1] > 0.9


def test_a_center_of_mass_outside_the_object_is_never_called_learned(weighed):
    mean = weighed.absolute.mean.copy()
    mean[CENTER_INDICES] = (1.0, 0.0)
    noted = _note_center_outside(
        replace(weighed, absolute=replace(weighed.absolute, mean=mean)), "weighings.csv"
    )
    assert noted.status == "explains_little"
    assert noted.message.startswith("weighings.csv: they put the center of mass at [1, 0] m, ")
    assert _note_center_outside(weighed, "weighings.csv") is weighed
