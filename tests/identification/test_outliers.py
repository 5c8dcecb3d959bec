"""Trackers that jump or flip, and pushes of another object."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from gridpush_drake.dynamics.push import Push
from gridpush_drake.errors import IdentificationError
from gridpush_drake.geometry.se2 import rotate
from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.model_file import read_model, write_model
from gridpush_drake.identification.statistics.outliers import (
    OUTLIER_GROWTH,
    OUTLIER_PRIOR_RATIO,
    Disagreement,
    LeftOut,
    calc_outlier_evidence,
    find_jumps,
    remove_outliers,
    weigh_pushes,
)
from gridpush_drake.identification.statistics.problem import PushProblem
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import PhysicalPrior
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.pushes.observed_push import ObservedPush
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.report.page import make_report
from tests.helpers.shapes import make_shape
from tests.identification.simulated_pokes import make_pokes

NOISE = (5e-4, 3.5e-3)
PUSHES, OBSERVATIONS = 8, 5
WORST = 1.5
"""Times the clean error that outliers may make of it."""

CASES, FOREIGN = (("square", 0), ("l_bracket", 0), ("claw_hammer", 1)), (5, 3, 7)
"""Shapes and seeds of the pushes; which push of each is another object's."""


def make_case(name: str = "square", seed: int = 1, reverse: bool = False) -> tuple:
    obj = make_shape(name, 40)
    order = np.argsort(obj.p_BC[:, 0])
    heavy = np.isin(np.arange(obj.n), (order if reverse else order[::-1])[: int(0.4 * obj.n)])
    truth = CellParameters(
        np.where(heavy, 0.3, 0.06), np.full(obj.n, 0.4), 0.35, patch_ratio=obj.n**-0.5
    )
    return obj, truth, make_pokes(obj, truth, PUSHES, seed, noise=NOISE, observations=OBSERVATIONS)


def calc_held_out_error(obj, truth, params) -> float:
    problem = PushProblem(obj, make_pokes(obj, truth, 12, 900, observations=1), params)
    return float(problem.calc_cell_errors(problem.residuals(problem.unknowns(params))).mean())


def turn(obj, pose, angle):
    """The pose turned about the cells' centroid, which stays in place."""
    c = obj.p_BC.mean(axis=0)
    return np.append(pose[:2] + rotate(pose[2], c) - rotate(pose[2] + angle, c), pose[2] + angle)


def spoil(obj, log: PushLog, kind: str) -> tuple[PushLog, dict[str, tuple[int, ...]]]:
    """One pose in five of every push flipped, turned by a quarter, or moved elsewhere."""
    rng, pushes, spoiled = np.random.default_rng(5), [], {}
    for seen in log:
        i = int(rng.integers(OBSERVATIONS))
        poses = seen.poses_observed.copy()
        if kind == "jump":
            poses[i] += np.append(
                rng.choice([-1, 1], 2) * rng.uniform(0.03, 0.15, 2), rng.uniform(-3, 3)
            )
        else:
            poses[i] = turn(obj, poses[i], np.pi if kind == "flip" else np.pi / 2)
        pushes.append(replace(seen, poses_observed=poses))
        spoiled[seen.name] = (i + 1,)
    return replace(log, pushes=tuple(pushes)), spoiled


@pytest.fixture(scope="module")
def clean() -> float:
    """Mean held-out error of the cases, learned from what was really seen."""
    return float(
        np.mean(
            [
                learn_and_judge(*case, case[2])[1]
                for case in map(make_case, *zip(*CASES, strict=True))
            ]
        )
    )


def learn_and_judge(obj, truth, _, log: PushLog) -> tuple:
    found = identify(Model(obj), log)
    return found, calc_held_out_error(obj, truth, found.params)


@pytest.mark.parametrize("kind", ["flip", "quarter", "jump"])
def test_a_fifth_of_wrong_poses_costs_little_and_is_named_exactly(kind: str, clean: float) -> None:
    errors = []
    for name, seed in CASES:
        case = make_case(name, seed)
        bad, spoiled = spoil(case[0], case[2], kind)
        found, error = learn_and_judge(*case, bad)
        assert {outlier.push: outlier.poses for outlier in found.outliers} == spoiled
        assert not any(outlier.whole for outlier in found.outliers)
        assert found.outliers[0].fraction == pytest.approx(1 / (OBSERVATIONS + 1))
        errors.append(error)
    assert np.mean(errors) <= WORST * clean


def test_flips_are_named_exactly_in_a_log_that_was_read_from_a_file(tmp_path) -> None:
    obj, _, log = make_case()
    bad, spoiled = spoil(obj, log, "flip")
    bad.write_csv(tmp_path / "pushes.csv")
    read = PushLog.read_csv(tmp_path / "pushes.csv", log[0].push.radius)
    turns = [abs(seen.poses_observed[-1, 2] - seen.pose[2]) > np.pi for seen in read]
    assert any(turns)  # a flip and the way back, each the nearer way round, can make a whole turn
    found, expected = identify(Model(obj), read), identify(Model(obj), bad)
    assert {outlier.push: outlier.poses for outlier in found.outliers} == spoiled
    np.testing.assert_allclose(found.params.mass, expected.params.mass, rtol=1e-9)


@pytest.mark.slow
def test_a_push_of_another_object_costs_little_and_is_named(clean: float) -> None:
    errors = []
    for which, (name, seed) in zip(FOREIGN, CASES, strict=True):
        case = make_case(name, seed)
        log, foreign = case[2], make_case(name, seed, reverse=True)[2][which]
        assert (
            np.linalg.norm(foreign.poses_observed[-1, :2] - log[which].poses_observed[-1, :2])
            > 0.005
        )
        mixed = replace(
            log, pushes=tuple(foreign if i == which else seen for i, seen in enumerate(log))
        )
        found, error = learn_and_judge(*case, mixed)
        assert [(outlier.push, outlier.whole) for outlier in found.outliers] == [
            (log[which].name, True)
        ]
        assert log[which].name not in found.push_names
        far = found.outliers[0].disagreement
        assert far.distance > far.allowed > 0.001 and far.deviations > 2
        errors.append(error)
    assert np.mean(errors) <= WORST * clean


def test_a_push_that_is_kept_is_learned_from_though_the_others_disagree() -> None:
    obj, _, log = make_case(*CASES[1])
    which = FOREIGN[1]
    foreign = make_case(*CASES[1], reverse=True)[2][which]
    mixed = replace(log, pushes=(*log[:which], foreign, *log[which + 1 :]))
    kept = identify(Model(obj), mixed, keep=[foreign.name])
    assert kept.outliers == () and foreign.name in kept.push_names
    with pytest.raises(IdentificationError, match=r"keep: .* has no push 'z'; expected names"):
        identify(Model(obj), log, keep=["z"])
    with pytest.raises(IdentificationError, match=r"keep is 'z'; expected names of pushes"):
        identify(Model(obj), log, keep="z")


def test_what_would_have_been_believed_is_where_the_odds_are_even() -> None:
    rng = np.random.default_rng(3)
    A, way = rng.normal(size=(6, 6)), np.array([0.02, 0.04])
    Q = 1e6 * (A @ A.T + np.eye(6))
    e = rng.normal(size=6) * 0.01
    seen = LeftOut(Q, Q @ e)
    far = calc_outlier_evidence(seen, way).explain(seen)
    assert far.distance == pytest.approx(np.linalg.norm(e[-3:]))
    # at once, by the two densities of the residuals themselves
    D = np.kron(OUTLIER_GROWTH * way[:, None], np.eye(3))
    s = far.allowed / far.distance
    foreign, own = (
        multivariate_normal(np.zeros(6), covariance).logpdf(s * e)
        for covariance in (np.linalg.inv(Q) + D @ D.T, np.linalg.inv(Q))
    )
    assert foreign - own + np.log(OUTLIER_PRIOR_RATIO) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(("name", "seed"), [("square", 4), ("l_bracket", 4)])
def test_two_of_ten_pushes_of_another_object_are_named_though_loads_that_shift_could_explain_them(
    name: str, seed: int
) -> None:
    obj, truth, _ = make_case(name)
    log, foreign = (
        make_pokes(obj, one, 10, first, noise=NOISE, observations=OBSERVATIONS)
        for one, first in ((truth, seed), (make_case(name, reverse=True)[1], seed + 50))
    )
    bad = sorted(np.random.default_rng(seed).choice(10, 2, replace=False).tolist())
    mixed = [
        replace(foreign[i], name=f"foreign_{i}") if i in bad else seen for i, seen in enumerate(log)
    ]
    found, error = learn_and_judge(obj, truth, log, replace(log, pushes=tuple(mixed)))
    assert [(outlier.push, outlier.whole) for outlier in found.outliers] == [
        (f"foreign_{i}", True) for i in bad
    ]
    assert error <= WORST * learn_and_judge(obj, truth, log, log)[1]


@pytest.mark.parametrize("helped", [3, 4])
def test_pushes_in_which_a_hand_helped_do_not_veto_the_others(helped: int) -> None:
    obj, truth, _ = make_case("claw_hammer", 2)
    log = make_pokes(obj, truth, 10, 2, noise=NOISE, observations=1)
    moved = ([0.02, 0.015, 0.3], [-0.015, 0.02, -0.25], [0.01, -0.02, 0.3], [-0.02, -0.01, 0.2])
    pushes = [
        replace(seen, poses_observed=seen.poses_observed + moved[i]) if i < helped else seen
        for i, seen in enumerate(log)
    ]
    found = identify(Model(obj), replace(log, pushes=tuple(pushes)))
    # three of ten may be refused; what is left of four is odd, and counts for little
    assert len(found.outliers) == 3
    assert {outlier.push for outlier in found.outliers} <= {f"poke_{i}" for i in range(helped)}
    assert found.status == "learned"
    even = calc_held_out_error(obj, truth, CellParameters.uniform(obj))
    assert calc_held_out_error(obj, truth, found.params) < 0.3 * even


def test_only_a_push_that_no_model_predicts_is_odd() -> None:
    even = np.array([3.0, 2.5, 3.5, 30.0, 31.0])
    learned = np.array([1.0, 1.2, 0.8, 1.1, 30.0])
    weights = weigh_pushes([even, learned], 0.5)
    # the median of 1.0, 1.2, 0.8, 1.1 and 30 is 1.1
    np.testing.assert_allclose(weights, [1, 1, 1, 1, (3 * 1.1 / 30) ** 2])
    # by a noise that large nothing is odd
    np.testing.assert_array_equal(weigh_pushes([even, learned], 11.0), np.ones(5))


def test_nothing_is_refused_of_a_clean_log() -> None:
    for name, seed in (("square", 1), ("l_bracket", 2), ("claw_hammer", 0)):
        obj, _, log = make_case(name, seed)
        assert identify(Model(obj), log).outliers == ()


def test_a_small_slip_within_reach_of_the_push_is_found_by_the_fit_unless_the_push_is_kept() -> (
    None
):
    obj, _, log = make_case()
    poses = log[2].poses_observed.copy()
    poses[3] += [0.006, -0.006, 0.0]
    slipped = replace(
        log,
        pushes=tuple(replace(s, poses_observed=poses) if i == 2 else s for i, s in enumerate(log)),
    )
    assert all(mask.all() for mask in find_jumps(obj, slipped))
    assert [
        (outlier.push, outlier.poses) for outlier in identify(Model(obj), slipped).outliers
    ] == [(log[2].name, (4,))]
    assert identify(Model(obj), slipped, keep=[log[2].name]).outliers == ()


def test_a_push_whose_first_pose_is_wrong_begins_at_the_next() -> None:
    obj, _, log = make_case()
    wrong = replace(log[0], pose=turn(obj, log[0].pose, np.pi))
    found = identify(Model(obj), replace(log, pushes=(wrong, *log.pushes[1:])))
    (outlier,) = found.outliers
    assert (outlier.push, outlier.poses, outlier.whole) == (wrong.name, (0,), False)
    end = wrong.push.duration
    felt = replace(wrong, force_t=[0.0, end], force=[[1, 2], [3, 4]], lift_force=[5, 6])
    rest = remove_outliers(PushLog((felt,)), found.outliers)[0]
    np.testing.assert_array_equal(rest.force, [[3, 4]])
    np.testing.assert_array_equal(rest.lift_force, [6])
    np.testing.assert_array_equal(rest.pose, log[0].poses_observed[0])
    np.testing.assert_allclose(rest.t_observed, log[0].t_observed[1:] - log[0].t_observed[0])
    np.testing.assert_allclose(rest.push.xy[-1], log[0].push.xy[-1])


def test_a_log_in_which_most_poses_jump_is_left_to_be_judged_as_a_whole() -> None:
    obj, _, log = make_case()
    far = replace(
        log,
        pushes=tuple(replace(s, poses_observed=s.poses_observed * [1e3, 1e3, 1.0]) for s in log),
    )
    assert all(mask.all() for mask in find_jumps(obj, far))


def test_what_was_refused_is_in_words_in_the_file_and_in_the_report(tmp_path, undrawn) -> None:
    obj, _, log = make_case()
    bad, spoiled = spoil(obj, log[:3], "flip")
    found = identify(Model(obj), bad)
    write_model(tmp_path / "model.yaml", found)
    assert read_model(tmp_path / "model.yaml").outliers == found.outliers
    page = make_report(found, bad)
    for outlier in found.outliers:
        (pose,) = spoiled[outlier.push]
        assert outlier.describe() == (
            f"push {outlier.push}: 1 of 6 poses jump or disagree with the rest (number {pose + 1}), refused"
        )
        assert outlier.describe() in page
    far = Disagreement(distance=0.0062, deviations=4.1, allowed=0.0048)
    whole = replace(found.outliers[0], poses=(), whole=True, disagreement=far)
    assert whole.fraction == 1.0 and whole.describe() == (
        f"push {whole.push}: refused, as no motion of this object that the other pushes allow: it "
        "ends 6.2 mm (4.1 standard deviations) from where they put it, and 4.8 mm would have been "
        f"believed; --keep {whole.push} (keep= in Python) learns from it all the same"
    )
    write_model(tmp_path / "whole.yaml", replace(found, outliers=(whole,)))
    assert read_model(tmp_path / "whole.yaml").outliers == (whole,)


def test_pushes_that_slip_along_one_side_tell_the_friction_and_are_not_refused() -> None:
    # All begin on one side, where most contacts stick: there the loss is flat in the friction.
    side = 0.045 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    prior = PhysicalPrior(pusher_radius=0.005)
    obj = GridObject.from_outline(side, max_cells=36, name="square", prior=prior)
    heavy = obj.p_BC @ [1.0, 0.5] > 0.015
    params = CellParameters(
        np.where(heavy, 0.2, 0.02), np.full(obj.n, 0.35), 0.25, patch_ratio=obj.n**-0.5
    )
    rng = np.random.default_rng(1)
    t = np.linspace(0.0, 1.0, 6)
    pushes = []
    for k in range(6):
        direction = rng.uniform(-0.4, 0.4)
        start = np.array([-0.05, rng.uniform(-0.03, 0.03)])
        path = start + 0.04 * t[:, None] * [np.cos(direction), np.sin(direction)]
        push = Push.along(t, path, 0.005)
        poses = Model(obj, params).simulate(push, dt=0.01).poses[20::20]
        noise = rng.normal(size=poses.shape) * [3e-4, 3e-4, 3e-3]
        pushes.append(ObservedPush(f"push_{k}", push, np.zeros(3), t[1:], poses + noise))
    found = identify(Model(obj), PushLog(tuple(pushes)))
    assert found.outliers == ()
    assert found.params.contact_friction == pytest.approx(0.25, abs=0.05)
