"""What the pushes themselves say of draws."""

from dataclasses import replace

import numpy as np
import pytest

from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.geometry.se2 import rotate, transform
from gridpush_drake.identification.fit.evidence import PushEvidence, select_learned
from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.statistics.noise import NoiseModel
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.plausible_masses import PlausibleMassSet
from gridpush_drake.pushes.push_log import PushLog
from tests.helpers.shapes import make_shape
from tests.helpers.simulated_pushes import make_pushes

OBJ = make_shape("claw_hammer", 50)
POSE_NUMBERS = 3


def make_three_footed() -> CellParameters:
    """All but nothing of the load is on cells other than three: at both ends, and to one side."""
    p = OBJ.p_BC
    feet = [int(np.argmin(p[:, 0])), int(np.argmax(p[:, 0])), int(np.argmax(p[:, 1]))]
    mass = np.full(OBJ.n, 1e-6)
    mass[feet] = (0.2, 0.25, 0.15)
    return CellParameters(mass, np.full(OBJ.n, OBJ.prior.friction), 0.4, patch_ratio=0.0)


@pytest.fixture(scope="module")
def learned():
    log = make_pushes(OBJ, make_three_footed(), 6, seed=4)
    return identify(Model(OBJ), log), log


def calc_slowly(found, log, dz):
    """Independent of `PushEvidence`: pushes simulated one by one, and whole covariance matrices inverted."""
    noise, total, z = NoiseModel(), 0.0, found.posterior.mean + dz
    params = replace(
        found.params,
        mass=np.exp(z[:-1]) / found.params.friction,
        contact_friction=float(np.exp(z[-1])),
    )
    centroid, rho = OBJ.p_BC.mean(axis=0), OBJ.radius_of_gyration
    evidence = PushEvidence(found, log)
    inputs = evidence._problem.linearize(found.posterior.mean).by_inputs
    for seen, J in zip(log, inputs, strict=True):
        times = np.union1d(np.linspace(0, seen.push.duration, 1001), seen.t_observed)
        motion = simulate(
            Model(OBJ, params), seen.push, seen.pose, times=times, regime=found.regime
        )
        rows = []
        for time, pose in zip(seen.t_observed, seen.poses_observed, strict=True):
            made = motion.poses[int(np.argmin(np.abs(motion.times - time)))]
            off = transform(made, centroid[None])[0] - transform(pose, centroid[None])[0]
            rows.append([*rotate(-pose[2], off), rho * (made[2] - pose[2])])
        r, count = np.ravel(rows), POSE_NUMBERS * np.sqrt(len(rows))
        size = np.sqrt(r @ np.linalg.solve(noise.calc_covariance(J, found.noise_scale), r) / count)
        bend = noise.outlier
        total += count * (size**2 if size <= bend else bend * (2 * size - bend))
    return total


def test_excess_is_that_of_pushes_simulated_one_by_one(learned):
    found, log = learned
    evidence, nothing = PushEvidence(found, log), np.zeros(OBJ.n + 1)
    assert evidence.calc_excess(nothing) == 0.0
    rng = np.random.default_rng(0)
    for _ in range(3):
        dz = rng.normal(0, 0.3, OBJ.n + 1)
        expected = calc_slowly(found, log, dz) - calc_slowly(found, log, nothing)
        assert evidence.calc_excess(dz) == pytest.approx(expected, rel=0.01, abs=0.5)


def test_only_draws_that_the_pushes_contradict_are_drawn_in(learned):
    found, log = learned
    evidence = PushEvidence(found, log)
    dz = (
        np.random.default_rng(1).normal(0, 1, (40, OBJ.n + 1)) * np.repeat([0.01, 2.0], 20)[:, None]
    )
    excess = np.array([evidence.calc_excess(one) for one in dz])
    fine = excess <= evidence.max_excess
    assert 10 < fine.sum() < 30
    kept = evidence.draw_in(dz)
    np.testing.assert_array_equal(kept[fine], dz[fine])
    for one, was in zip(kept[~fine], dz[~fine], strict=True):
        fraction = one[0] / was[0]
        np.testing.assert_allclose(one, fraction * was, rtol=1e-12)
        assert 0 < fraction < 1
        assert evidence.calc_excess(one) <= evidence.max_excess


def test_the_center_of_mass_of_a_three_footed_object_is_known_the_better_and_no_worse(learned):
    found, log = learned
    truth, evidence = make_three_footed(), PushEvidence(found, log)
    with_pushes, without = (
        PlausibleMassSet.from_posterior(OBJ, found.posterior, (0.4, 0.4), judge=judge)
        for judge in (evidence, None)
    )
    angle = 2 * np.pi * np.arange(12) / 12
    directions = np.column_stack([np.cos(angle), np.sin(angle)])
    far, farther = with_pushes.calc_support(directions), without.calc_support(directions)
    assert (far >= directions @ truth.center_of_mass(OBJ) - 5e-4).all(), (
        "the true center is still within"
    )
    assert far.sum() < 0.9 * farther.sum(), "the region's mean width"


def test_what_was_refused_or_not_learned_from_does_not_judge(learned):
    _, log = learned
    flipped = replace(log[5], poses_observed=log[5].poses_observed + [0.0, 0.0, np.pi])
    spoilt = PushLog((*log[:5], flipped), log.source)
    found = identify(Model(OBJ), spoilt)
    assert {outlier.push for outlier in found.outliers} == {log[5].name}
    used = select_learned(found, spoilt)
    assert [seen.name for seen in used] == [seen.name for seen in log[:5]]
    evidence = PushEvidence.of_log(found, spoilt)
    assert evidence.max_excess == pytest.approx(
        5 * POSE_NUMBERS + 3 * np.sqrt(2 * 5 * POSE_NUMBERS)
    )
    assert PushEvidence.of_log(found, PushLog((replace(log[0], name="another"),))) is None
    assert PushEvidence.of_log(found, None) is None


def test_the_judge_has_the_last_word_on_draws(learned):
    found, log = learned
    evidence = PushEvidence(found, log)
    for sample in found.posterior.draw_parameters(found.params, 8, 3, evidence):
        fraction = sample.relative_friction() / sample.relative_friction().sum()
        dz = np.append(
            np.log(fraction / found.posterior.calc_fraction()), np.log(sample.contact_friction)
        )
        dz[-1] -= found.posterior.mean[-1]
        assert evidence.calc_excess(dz) <= 1.01 * evidence.max_excess
