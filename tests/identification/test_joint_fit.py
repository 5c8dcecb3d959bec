"""Several objects learned together, from pushes in which they push each other."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from gridpush_drake.dynamics.physics import QUASI_STATIC
from gridpush_drake.dynamics.push import Push
from gridpush_drake.errors import IdentificationError, PushLogError, PushLogWarning
from gridpush_drake.identification.absolute.force_scale import calc_force_scale
from gridpush_drake.identification.fit.hypotheses import (
    LoadHypothesis,
    RigidBottom,
    SmoothField,
    TwoParts,
)
from gridpush_drake.identification.fit.load_prior import LoadPrior, calc_prior_factor
from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.multi_object.joint_fit import JointEnsemble
from gridpush_drake.identification.multi_object.joint_forces import learn_from_forces
from gridpush_drake.identification.prediction import calc_pose_error
from gridpush_drake.identification.result import IdentificationStatus
from gridpush_drake.identification.statistics.friction_gradient import HeldFriction
from gridpush_drake.identification.statistics.robust_least_squares import MAX_CHANGE
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.pushes.observed_push import ObservedPush
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.pushes.weighings import LiftTest, MassTestLog
from gridpush_drake.report.scene_page import explain_scene, tell_scene
from tests.helpers.shapes import rectangle
from tests.helpers.two_blocks import (
    NOISE,
    PAIR_FRICTION,
    RADIUS,
    make_truth,
    push_apart,
    push_scene,
)


def make_fields(*amplitudes):
    return tuple(SmoothField(amplitude) for amplitude in amplitudes)


def calc_errors(model, pushes):
    """Mean cell error of each held-out push, m."""
    errors = []
    for seen in pushes:
        last = model.simulate(seen.push, seen.pose).final_pose
        for obj, mine, theirs in zip(model.objects, last, seen.final_pose, strict=True):
            errors.append(calc_pose_error(obj, mine, theirs).cell)
    return np.array(errors)


def test_poses_that_cannot_be_are_warned_of_by_the_name_of_their_object():
    truth = make_truth()
    names = ("block 0", "block 1")
    seen = push_scene(truth, 0)
    method = JointEnsemble(NOISE, make_fields(0.3))
    for shift, says in (
        ([0.5, 0.0, 0.0], "_x: .* a lost track"),
        ([0.0, 0.0, 90.0], "_theta: .* in degrees"),
    ):
        odd = replace(seen, poses_observed=seen.poses_observed + np.array([np.zeros(3), shift]))
        with pytest.warns(PushLogWarning, match=f"column block 1{says}"):
            identify(Model(truth.objects), PushLog((odd,), names=names), method)


def test_two_objects_are_learned_together():
    truth = make_truth()
    log = PushLog(tuple(push_scene(truth, seed) for seed in range(6)), names=("block 0", "block 1"))
    held_out = [push_scene(truth, seed, noise=0.0) for seed in range(100, 106)]
    found = identify(Model(truth.objects), log, JointEnsemble(NOISE, make_fields(0.3, 0.7)))
    even = Model(truth.objects)
    learned = calc_errors(found, held_out)
    before = calc_errors(even, held_out)
    print(f"cell error {1e3 * before.mean():.2f} mm, learned {1e3 * learned.mean():.2f} mm")
    assert learned.mean() < 2.5e-3
    assert learned.mean() < before.mean() / 3
    assert found.noise_scale < 2.0

    # What was hidden is where the posterior says that it may be.
    ratio, std = found.calc_load_ratio(1, 0)
    assert abs(ratio - np.log(2)) < 4 * std
    assert std < 0.3
    for b in range(2):
        center, covariance = found.calc_center(b)
        true_center = truth.params[b].relative_friction() @ truth.objects[b].p_BC
        off = center - true_center
        assert off @ np.linalg.solve(covariance, off) < 16
        assert np.sqrt(covariance[0, 0]) < 0.01
    i, j = np.triu_indices(2, 1)
    off = np.log(found.pair_friction[i, j] / PAIR_FRICTION)
    assert (np.abs(off) < 4 * found.calc_pair_friction_std()).all()


def test_a_pusher_that_is_held_to_slip_can_be_learned_to_rub():
    """A file may say that the pusher has no friction; its logarithm is an unknown all the same."""
    truth = make_truth()
    objects = [
        replace(obj, prior=replace(obj.prior, contact_friction=0.0)) for obj in truth.objects
    ]
    log = PushLog(tuple(push_scene(truth, seed) for seed in range(3)), names=("block 0", "block 1"))
    found = identify(Model(objects), log, JointEnsemble(NOISE, make_fields(0.3)))
    assert np.isfinite(found.z).all()
    # what it begins with is small, and pushes may still raise it
    begin = identify(Model(objects), log, JointEnsemble((10.0, 10.0, 10.0), make_fields(0.3)))
    for before, after in zip(begin.parameters, found.parameters, strict=True):
        assert before.contact_friction == pytest.approx(0.05, rel=0.01)
        assert after.contact_friction > 0.05


def test_what_is_refused():
    truth = make_truth()
    log = PushLog((push_scene(truth, 0),), names=("block 0", "block 1"))
    with pytest.raises(IdentificationError, match="holds no push"):
        identify(Model(truth.objects), PushLog((), names=log.names))
    with pytest.raises(PushLogError, match=r"of 2 objects .* expected 1"):
        identify(Model(truth.objects[0]), log)
    quick = Push(log[0].push.xy[0], 1e4 * (log[0].push.xy[-1] - log[0].push.xy[0]), 1e-4, RADIUS)
    fast = replace(log[0], push=quick, t_observed=log[0].t_observed * 1e-5)
    with pytest.raises(PushLogError, match=r"column t: the pusher moves .* are times in s"):
        identify(Model(truth.objects), PushLog((fast,), names=log.names))
    with pytest.raises(IdentificationError, match="noise"):
        JointEnsemble(noise=(0.0, 1.0, 1.0))


@pytest.mark.parametrize(
    "options",
    [
        {"method": "cma_es"},
        {"regime": "inertial"},
        {"budget": 5},
        {"friction": HeldFriction(None)},
        {"weighings": MassTestLog((), (LiftTest(np.zeros(3), np.zeros(2), 6.0),))},
    ],
)
def test_what_is_for_one_object_alone_is_refused(options):
    truth = make_truth()
    log = PushLog((push_scene(truth, 0),), names=("block 0", "block 1"))
    (name,) = options
    with pytest.raises(IdentificationError, match=f"{name}: is for one object"):
        identify(Model(truth.objects), log, **options)


def test_a_push_that_no_loads_explain_is_named_and_spoils_nothing():
    truth = make_truth()
    pushes = [push_scene(truth, seed) for seed in range(6)]
    # somebody turned an object while it was pushed
    moved = pushes[0].poses_observed + [[0.0, 0.02, 0.5], [0.0, 0.0, 0.0]]
    pushes[0] = replace(pushes[0], poses_observed=moved)
    held_out = [push_scene(truth, seed, noise=0.0) for seed in range(100, 104)]
    log = PushLog(tuple(pushes), names=("block 0", "block 1"))
    found = identify(Model(truth.objects), log, JointEnsemble(NOISE, make_fields(0.7)))
    assert found.unexplained == ("push 0",)
    assert found.noise_scale < 2.0
    assert calc_errors(found, held_out).mean() < 1e-3
    models = found.parts
    assert all(model.status == IdentificationStatus.LEARNED for model in models)
    assert "It does not explain push 0." in models[0].message
    assert any("push 0" in line for line in explain_scene(found, models, log.names))


def test_loads_stay_where_the_model_can_be_solved_though_nothing_explains_the_log():
    truth = make_truth()
    rng = np.random.default_rng(5)
    pushes = [
        replace(seen, poses_observed=seen.poses_observed + rng.normal(size=(6, 2, 3)) * 0.3)
        for seen in (push_scene(truth, seed) for seed in range(3))
    ]
    log = PushLog(tuple(pushes), names=("block 0", "block 1"))
    with pytest.warns(PushLogWarning, match="lost track"):
        found = identify(Model(truth.objects), log, JointEnsemble(NOISE, make_fields(0.7, 1.5)))
    assert len(found.unexplained) == 3
    assert np.isfinite(found.covariance).all()
    with pytest.warns(PushLogWarning, match="lost track"):
        even = identify(Model(truth.objects), log, JointEnsemble((1e3, 1e3, 1e3), make_fields(0.7)))
    assert np.abs(found.z - even.z).max() < MAX_CHANGE + 0.1
    statuses = {model.status for model in found.parts}
    assert statuses == {IdentificationStatus.EXPLAINS_LITTLE}


def test_it_is_said_what_pushes_of_one_object_alone_do_not_tell():
    truth = make_truth()
    apart = truth.with_poses([[0.0, 0.0, 0.0], [0.4, 0.3, 0.0]])
    push = Push((-0.05 - RADIUS - 1e-3, 0.01), (0.04, 0.0), 2.0, RADIUS)
    motion = apart.simulate(push)
    seen = ObservedPush("push", push, apart.poses, motion.times[-1:], motion.poses[-1:])
    log = PushLog((seen,), names=("block 0", "block 1"))
    found = identify(Model(truth.objects), log, JointEnsemble(NOISE, make_fields(0.7)))
    assert not found.shows_load_ratio(1, 0)
    assert not found.shows_pair_friction().any()
    document = tell_scene(found, log.names)
    assert document["pair_friction"][0]["told"] is False
    assert document["objects"][1]["load_ratio_told"] is False
    together = PushLog(tuple(push_scene(truth, seed) for seed in range(2)), names=log.names)
    found = identify(Model(truth.objects), together, JointEnsemble(NOISE, make_fields(0.7)))
    assert found.shows_load_ratio(1, 0)


def test_learning_goes_on_from_what_was_learned():
    truth = make_truth()
    pushes = tuple(push_scene(truth, seed) for seed in range(5))
    names = ("block 0", "block 1")
    method = JointEnsemble(NOISE, make_fields(0.7))
    few = identify(Model(truth.objects), PushLog(pushes[:4], names=names), method)
    cold = identify(Model(truth.objects), PushLog(pushes, names=names), method)
    warm = identify(Model(truth.objects), PushLog(pushes, names=names), method, start=few)
    assert warm.simulations < cold.simulations
    assert abs(warm.evidence[0] - cold.evidence[0]) < 1.0
    third = GridObject.from_outline(rectangle(0.10, 0.05), max_cells=30, name="block 0")
    with pytest.raises(IdentificationError, match=r"start: has .* unknowns; expected"):
        identify(Model((third, truth.objects[1])), PushLog(pushes, names=names), method, start=few)


@dataclass(frozen=True)
class HeavyEnd(LoadHypothesis):
    """A hypothesis of one's own: the right end bears more than the left one."""

    name: str = "heavy end"

    def propose(self, setting):
        ramp = setting.obj.p_BC[:, 0] / setting.obj.p_BC[:, 0].std()
        C = 0.01 * setting.calc_smooth_covariance(4.0) + 0.25 * np.outer(ramp, ramp)
        factor = calc_prior_factor(C, 1.0, setting.log_contact_friction_std)
        mean = setting.z0 + np.append(1.5 * ramp, 0.0)
        return [LoadPrior(mean=mean, factor=factor, weight=1.0, p_BC=setting.obj.p_BC)]


def test_each_object_is_given_the_hypothesis_that_explains_it():
    """The first block is heavy at the right end, the second one at the left; whatever was pushed together."""
    truth = make_truth()
    log = PushLog(tuple(push_scene(truth, seed) for seed in range(4)), names=("block 0", "block 1"))
    method = JointEnsemble(NOISE, (SmoothField(0.3), TwoParts(), RigidBottom(), HeavyEnd()))
    found = identify(Model(truth.objects), log, method)
    plain = identify(Model(truth.objects), log, JointEnsemble(NOISE, method.hypotheses[:1]))
    weights = [{each.name: each.weight for each in one} for one in found.hypotheses]
    assert sum(weights[0].values()) == pytest.approx(1.0)
    assert weights[0]["heavy end"] > 0.2 and weights[1].get("heavy end", 0.0) < 0.01
    assert sum(weight for name, weight in weights[1].items() if "two parts" in name) > 0.9
    assert all(one["rigid bottom"] < 0.01 for one in weights)
    held_out = [push_scene(truth, seed, noise=0.0) for seed in range(100, 106)]
    assert calc_errors(found, held_out).mean() < 0.8 * calc_errors(plain, held_out).mean()
    assert found.parts[0].hypotheses == found.hypotheses[0]


def test_an_object_far_from_the_others_is_learned_as_by_itself():
    truth = make_truth()
    pushes = [push_apart(truth, seed) for seed in (0, 2, 4)]
    method = JointEnsemble(NOISE, (SmoothField(0.3), TwoParts()))
    both = identify(Model(truth.objects), PushLog(pushes, names=("one", "other")), method)
    single = [
        replace(seen, pose=seen.pose[:1], poses_observed=seen.poses_observed[:, :1])
        for seen in pushes
    ]
    alone = identify(Model(truth.objects[0]), PushLog(single), method)
    # a block of residuals counts by its size, which is all that differs
    for mine, theirs in zip(both.hypotheses[0], alone.hypotheses[0], strict=True):
        assert mine.name == theirs.name
        assert abs(mine.weight - theirs.weight) < 0.05
    assert np.abs(both.calc_center(0)[0] - alone.calc_center(0)[0]).max() < 2e-4
    assert both.hypotheses[1] == ()


def test_forces_tell_how_heavy_objects_are_that_never_touched():
    truth = make_truth()
    names = ("one", "other")
    log = PushLog([push_apart(truth, seed, with_force=True) for seed in range(6)], names=names)
    without = PushLog([replace(seen, force_t=None, force=None) for seen in log], names=names)
    method = JointEnsemble(NOISE, make_fields(0.7))
    found = identify(Model(truth.objects), log, method)
    blind = identify(Model(truth.objects), without, method)
    assert not blind.shows_load_ratio(1, 0) and blind.forces == ()
    assert found.shows_load_ratio(1, 0)
    ratio, std = found.calc_load_ratio(1, 0)
    assert abs(ratio - np.log(2)) < 3 * std and std < 0.25
    for b in range(2):
        scale = found.parts[b].force
        true = 9.81 * float(truth.params[b].mass @ truth.params[b].friction)
        assert scale.pushes == 3
        assert scale.bounds[0] < true < scale.bounds[1] < 2 * true
        assert found.parameters[b].total_mass == pytest.approx(
            scale.friction / 9.81 / truth.objects[b].prior.friction, rel=1e-6
        )
    # measured on the pusher instead of on the object, they say nothing
    wrong = PushLog([replace(seen, force=-seen.force) for seen in log], names=names)
    with pytest.warns(PushLogWarning, match=r"pull the object .*; the forces are not used"):
        assert identify(Model(truth.objects), wrong, method).forces == ()
    counts = PushLog([replace(seen, force=1e6 * seen.force) for seen in log], names=names)
    with pytest.warns(PushLogWarning, match=r"a sensor's counts\?; the forces are not used"):
        assert identify(Model(truth.objects), counts, method).forces == ()


def test_forces_of_one_object_say_what_they_say_alone():
    """The scale of `calc_force_scale`, found by other means, where there is one object."""
    truth = make_truth()
    pushes = [push_apart(truth, seed, with_force=True) for seed in (0, 2, 4)]
    single = PushLog([seen.single_out(0) for seen in pushes])
    model = Model(truth.objects[0], truth.params[0], QUASI_STATIC)
    posterior = identify(model, single).posterior
    scale = calc_force_scale(model, posterior, single)
    z = np.log(np.append(truth.params[0].mass * truth.params[0].friction, 0.3))
    found = learn_from_forces(model, z, 1e-12 * np.eye(len(z)), single)
    assert found.scales[0].friction == pytest.approx(scale.friction, rel=0.01)
