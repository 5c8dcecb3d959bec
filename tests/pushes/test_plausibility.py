"""Logs that cannot be true are refused with push, column and cause; real ones pass without a word."""

import re
import warnings
from dataclasses import replace

import numpy as np
import pytest
from shapely import Point

from gridpush_drake.dynamics.push import Push
from gridpush_drake.errors import IdentificationError, PushLogError, PushLogWarning
from gridpush_drake.geometry.se2 import compose
from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.prediction import predict
from gridpush_drake.identification.result import IdentificationStatus
from gridpush_drake.identification.tilt_tests.weighed_model import estimate_masses
from gridpush_drake.multibody.ground_truth import sample_ground_truth
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import find_shipped_object, list_shipped_objects
from gridpush_drake.pushes.importers.mit import MitImporter
from gridpush_drake.pushes.misplaced import explain_no_contact
from gridpush_drake.pushes.observed_push import ObservedPush, nearest_turn
from gridpush_drake.pushes.plausibility import (
    check_plausible,
    check_plausible_mass_tests,
    find_implausible,
    find_implausible_mass_tests,
)
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.pushes.weighings import LiftTest, MassTestLog, TiltTest
from tests.helpers.made_identifications import make_block, make_identification
from tests.helpers.shared_data import read_cmu, shared_data
from tests.helpers.simulated_pushes import make_pushes

CMU = ("hardboard_middle", "hardboard_patch", "hardboard_wide", "plywood_middle", "plywood_wide")
MIT = ("abs_hex", "abs_rect1", "plywood_rect3")
PER_RADIAN = 180 / np.pi


def simulated(obj, count=8):
    return make_pushes(obj, sample_ground_truth(obj, 1), count, seed=1)


def misread(log: PushLog, tip: float = 1.0, place: float = 1.0, angle: float = 1.0) -> PushLog:
    """The log of one who wrote other units, as a reader of CSV takes it: angles continuous."""
    pushes = []
    for seen in log:
        pose, poses = (
            np.array(q) * [place, place, angle] for q in (seen.pose, seen.poses_observed)
        )
        before = pose[2]
        for q in poses:
            before = q[2] = nearest_turn(float(q[2]), before)
        push = Push.along(seen.push.t, seen.push.xy * tip, seen.push.radius)
        pushes.append(ObservedPush(seen.name, push, pose, seen.t_observed, poses))
    return PushLog(tuple(pushes), "log.csv")


def changed(log: PushLog, i: int, pose) -> PushLog:
    """The log with push `i`'s last pose replaced."""
    seen = log[i]
    poses = np.vstack([seen.poses_observed[:-1], pose])
    pushes = list(log)
    pushes[i] = replace(seen, poses_observed=poses)
    return PushLog(tuple(pushes), "log.csv")


@pytest.mark.parametrize("name", CMU)
@pytest.mark.parametrize("calibrate", [True, False])
def test_cmu_logs_are_plausible(name, calibrate):
    log, obj = read_cmu(name, calibrate)
    assert find_implausible(obj, log) == []


@pytest.mark.parametrize("name", MIT)
def test_mit_logs_are_plausible(name):
    log, obj = MitImporter().read(shared_data("mit_pushes", f"{name}.mat"))
    assert find_implausible(obj, log) == []


@pytest.mark.parametrize("name", list_shipped_objects())
def test_units_are_told_apart(name):
    obj = GridObject.from_yaml(find_shipped_object(name))
    log = simulated(obj)
    assert find_implausible(obj, log) == []
    for units, says in (
        ({"tip": 1e3, "place": 1e3}, "column tip_x, tip_y, object_x, object_y: in millimeters"),
        ({"tip": 1e3}, "column tip_x, tip_y: in millimeters"),
        ({"place": 1e3}, "column object_x, object_y: in millimeters"),
        ({"angle": PER_RADIAN}, "column object_theta: in degrees"),
    ):
        with pytest.raises(PushLogError, match=rf"^log\.csv: push 'push_\d', {says}\?"):
            check_plausible(obj, misread(log, **units), learning=False)


@pytest.mark.parametrize("name", CMU)
def test_units_of_real_logs_are_told_apart(name):
    log, obj = read_cmu(name)
    for units, says in (
        ({"tip": 1e3, "place": 1e3}, "tip_x, .*in millimeters"),
        ({"place": 1e3}, "object_[xy]: .*in millimeters"),
        ({"angle": PER_RADIAN}, "object_theta: .*in degrees"),
    ):
        with pytest.raises(PushLogError, match=f"column {says}"):
            check_plausible(obj, misread(log, **units), learning=True)


def test_a_pose_that_no_push_leads_to_is_refused_to_learn_from():
    obj = make_block()
    log = simulated(obj, 3)
    last = len(log[1].t_observed)
    for pose, says, jumps_back in (
        (
            [9.9, 0, 0],
            r"push 'push_2', column object_x: the object moves 9\.\d+ m by t = .* in a push of 0\.0\d+ m",
            True,
        ),
        ([0, -30.0, 0], "push 'push_2', column object_y: the object moves", True),
        (
            log[1].poses_observed[-1] + [0, 0, 6.0],
            "push 'push_2', column object_theta: the object turns",
            False,
        ),
    ):
        wrong = changed(log, 1, pose)
        with pytest.warns(PushLogWarning, match=says):
            found = predict(Model(obj), wrong)
        assert len(found) == 3
        if jumps_back:  # a tracker's jump among good poses: that pose is left out, and named
            learned = identify(Model(obj), wrong)
            assert [(out.push, out.poses, out.whole) for out in learned.outliers] == [
                ("push_2", (last,), False)
            ]
            wrong = PushLog(
                tuple(
                    replace(
                        seen,
                        t_observed=seen.t_observed[-1:],
                        poses_observed=seen.poses_observed[-1:],
                    )
                    for seen in wrong
                ),
                "log.csv",
            )
        with pytest.raises(PushLogError, match=says):
            identify(Model(obj), wrong)


@pytest.mark.parametrize(
    "table",
    [
        [[1, 1], [2, 1], [2, 2], [1, 2]],
        [[-1, -1], [1, -1], [1, -0.999], [-1, -0.999]],
        [
            [-1, -1e-4],
            [1, -1e-4],
            [1, 1e-4],
            [-1, 1e-4],
        ],  # its edges cross the object, between the cells' centers
    ],
)
def test_a_table_that_the_object_is_not_on_is_refused(table):
    obj = make_block()
    log = replace(misread(simulated(obj, 2)), table=np.array(table, dtype=float))
    with pytest.raises(
        PushLogError,
        match=r"^log\.csv: push 'push_1', column table: at t = 0 s the object, at \(.*",
    ):
        predict(Model(obj), log)
    with pytest.raises(
        PushLogError,
        match=r"has no cell of block with its center on the table; expected an object on",
    ):
        identify(Model(obj), log)


def test_an_object_that_leaves_the_table_is_refused_to_learn_from():
    obj = make_block()
    left, low = obj.outline.bounds[:2]
    push = Push((left - 0.005, low / 2), (0.03, 0.0), 2.0, 0.005)
    seen = ObservedPush("over", push, np.zeros(3), [1.0, 2.0], [[0.03, 0.0, 0.0], [0.06, 0.0, 0.0]])
    strip = np.array([[-1.0, -1.0], [left + 0.05, -1.0], [left + 0.05, 1.0], [-1.0, 1.0]])
    log = PushLog((seen,), "log.csv", table=strip)
    says = r"^log\.csv: push 'over', column table: at t = 2 s the object, .* did it fall, or a lost track\?$"
    with pytest.raises(PushLogError, match=says):
        identify(Model(obj), log)
    with pytest.warns(PushLogWarning, match=says):
        predict(Model(obj), log)
    assert (
        find_implausible(obj, replace(log, table=strip + [[0, 0], [0.02, 0], [0.02, 0], [0, 0]]))
        == []
    )


def test_fast_pushers_are_refused():
    obj = make_block()
    log = simulated(obj, 2)
    seen = log[0]
    push = Push.along(seen.push.t * 1e-6, seen.push.xy, seen.push.radius)
    fast = PushLog((replace(seen, push=push, t_observed=seen.t_observed * 1e-6), log[1]))
    with pytest.raises(
        PushLogError,
        match=r"push 'push_1', column t: the pusher moves 0\.0\d+ m in .*at most 30 m/s",
    ):
        predict(Model(obj), fast)


def test_what_may_be_true_is_warned_of():
    obj = make_block()
    log = simulated(obj, 2)
    turned = misread(log)
    turned = PushLog(tuple(replace(seen, pose=seen.pose + [0, 0, 8 * np.pi]) for seen in turned))
    turned = PushLog(
        tuple(replace(s, poses_observed=s.poses_observed + [0, 0, 8 * np.pi]) for s in turned)
    )
    with pytest.warns(
        PushLogWarning, match=r"object_theta: in degrees\? expected rad; the object lies at 2\d\."
    ):
        check_plausible(obj, turned, learning=True)
    wide = replace(log, table=1e3 * np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]))
    with pytest.warns(
        PushLogWarning,
        match=r"column table: in millimeters\? expected m, .*; the table spans 1e\+03$",
    ):
        check_plausible(obj, wide, learning=True)
    large = GridObject.from_outline(np.array(obj.outline.exterior.coords) * 1e3, name="large")
    far = PushLog(
        (
            ObservedPush(
                "a", Push((-60.0, 0.0), (1.0, 0.0), 1.0, 0.005), np.zeros(3), [], np.empty((0, 3))
            ),
        )
    )
    with pytest.warns(
        PushLogWarning, match=r"large: its outline spans 134 m; in millimeters\? expected m"
    ):
        check_plausible(large, far, learning=False)
    with pytest.raises(PushLogError, match=r"large: its outline spans 134 m; in millimeters\?"):
        check_plausible(large, far, learning=True)


def test_a_log_that_misses_is_explained():
    obj = make_block()
    log = simulated(obj, 2)
    away = PushLog(
        tuple(replace(s, push=Push.along(s.push.t, s.push.xy + 0.5, s.push.radius)) for s in log)
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_plausible(obj, away, learning=True)
    assert "no push touches block from outside; the nearest, 'push_" in explain_no_contact(
        obj, away
    )


def test_a_log_that_misses_is_not_taken_for_millimeters_where_the_body_frame_is_at_a_corner():
    obj = make_block()
    corner = GridObject.from_outline(
        np.array(obj.outline.exterior.coords) - obj.outline.bounds[:2], max_cells=20
    )
    push = Push((0.5, 0.5), (0.0, 0.05), 1.0, 0.005)
    away = PushLog((ObservedPush("a", push, np.zeros(3), [1.0], np.zeros((1, 3))),))
    assert find_implausible(corner, away) == []


def test_degrees_are_named_where_the_body_frame_is_far_from_the_centroid():
    obj = make_block()
    aside = GridObject.from_outline(
        np.array(obj.outline.exterior.coords) + 0.3, max_cells=20, name="aside"
    )
    start = aside.outline.bounds[0] - 0.006, aside.outline.centroid.y
    seen = ObservedPush(
        "a",
        Push(start, (0.05, 0.0), 1.0, 0.005),
        np.zeros(3),
        [1.0],
        [[0.03, 0.0, 0.3 * PER_RADIAN]],
    )
    with pytest.raises(
        PushLogError,
        match=r"push 'a', column object_theta: the object turns 17\.2 rad .* in degrees",
    ):
        check_plausible(aside, PushLog((seen,)), learning=True)


def shift_body_frame(log: PushLog, shift) -> PushLog:
    """The log of one whose tracked frame is `shift`, m, away from the outline's, in body axes."""
    X = np.array([*shift, 0.0])
    return replace(
        log,
        source="log.csv",
        pushes=tuple(
            replace(
                seen,
                pose=compose(seen.pose, X),
                poses_observed=np.array([compose(pose, X) for pose in seen.poses_observed]),
            )
            for seen in log
        ),
    )


@pytest.mark.parametrize("name", ["claw_hammer", "open_book", "pliers", "toolbox"])
def test_another_body_frame_is_doubted_and_told(name):
    obj = GridObject.from_yaml(find_shipped_object(name))
    log = simulated(obj)
    for angle in np.radians([20, 110, 200, 290]):
        shift = 0.03 * np.array([np.cos(angle), np.sin(angle)])
        (found,) = find_implausible(obj, shift_body_frame(log, shift))
        assert not found.certain and "object_x, object_y" in found.message


def test_how_far_the_body_frame_is_off_is_told():
    obj = GridObject.from_yaml(find_shipped_object("toolbox"))
    log = shift_body_frame(simulated(obj), (0.02, 0.01))
    with pytest.warns(
        PushLogWarning, match=r"^log\.csv: object_x, object_y: of another body frame"
    ) as caught:
        check_plausible(obj, log, learning=True)
    x, y = map(float, str(caught[0].message).split("lies at (")[1].split(") mm")[0].split(","))
    np.testing.assert_allclose([x, y], [-20, -10], atol=3)


@pytest.mark.parametrize(
    "unit, factor", [("milliseconds", 1e3), ("microseconds", 1e6), ("nanoseconds", 1e9)]
)
def test_times_in_other_units_are_doubted(unit, factor):
    obj = make_block()
    log = simulated(obj)
    slow = replace(
        log,
        pushes=tuple(
            replace(
                seen,
                push=Push.along(seen.push.t * factor, seen.push.xy, seen.push.radius),
                t_observed=np.minimum(seen.t_observed * factor, seen.push.t[-1] * factor),
            )
            for seen in log
        ),
    )
    with pytest.warns(PushLogWarning, match=rf"column t: in {unit}\? expected s; as they stand"):
        check_plausible(obj, slow, learning=True)


def test_heavy_objects_are_doubted():
    block = make_block()
    log = simulated(block)
    for mass in (600.0, 30.0):
        obj = replace(block, prior=replace(block.prior, total_mass=mass))
        with pytest.warns(PushLogWarning, match=rf"total_mass is {mass:g} kg, .*: in grams\?"):
            check_plausible(obj, log, learning=True)
    obj = replace(block, prior=replace(block.prior, total_mass=5.0))
    assert find_implausible(obj, log) == []


def with_forces(log: PushLog, factor: float = 1.0, count: int = 20) -> PushLog:
    """The log with a force along the pusher's motion, N."""
    pushes = []
    for seen in log:
        t = np.linspace(0, seen.push.duration, count)
        along = (seen.push.xy[-1] - seen.push.xy[0]) / np.linalg.norm(
            seen.push.xy[-1] - seen.push.xy[0]
        )
        pushes.append(replace(seen, force_t=t, force=np.tile(factor * along, (count, 1))))
    return replace(log, pushes=tuple(pushes), source="log.csv")


@pytest.mark.parametrize(
    ("factor", "says"),
    [
        (
            1e8,
            r"push 'push_1', columns force_x, force_y: are 1e\+08 N at the median; .* a sensor's counts",
        ),
        (
            -2.0,
            r"push 'push_1', columns force_x, force_y: pull the object .* is it that on the pusher",
        ),
    ],
)
def test_forces_that_cannot_be_are_not_used_and_it_is_said_why(factor, says):
    obj = make_block()
    log = simulated(obj, 4)
    with pytest.warns(PushLogWarning, match=rf"^log\.csv: {says}.*; the forces are not used$"):
        found = identify(Model(obj), with_forces(log, factor), regime="quasi_static")
    assert found.force is None
    assert identify(Model(obj), with_forces(log, 2.0), regime="quasi_static").force is not None


def test_upward_forces_that_friction_cannot_carry_are_a_sensor_s_offset():
    obj = make_block()
    log = with_forces(simulated(obj, 4), 2.0)

    def lifted(size: float) -> PushLog:
        pushes = [replace(seen, lift_force=np.full(len(seen.force_t), size)) for seen in log]
        return replace(log, pushes=tuple(pushes))

    says = r"^log\.csv: column force_z: is 5 N at the median, .* only 2 N; .* not used$"
    with pytest.warns(PushLogWarning, match=says):
        assert identify(Model(obj), lifted(-5.0), regime="quasi_static").force is None
    assert identify(Model(obj), lifted(-0.5), regime="quasi_static").force is not None


def test_forces_of_fast_pushes_are_not_used_and_it_is_said_why():
    obj = make_block()
    log = with_forces(simulated(obj, 4), 2.0)
    with pytest.warns(
        PushLogWarning, match=r"^log\.csv: columns force_x, force_y: .* the pushes are fast"
    ):
        assert identify(Model(obj), log, regime="inertial").force is None


def test_why_nothing_touches_is_told_without_contradiction():
    obj = make_block()
    x = obj.outline.bounds[2]
    inside = Push((0.0, 0.0), (0.01, 0.0), 1.0, 0.005)
    away = Push((x + 0.105, 0.0), (0.01, 0.0), 1.0, 0.005)
    for push, says in (
        (inside, r"begins with the pusher 0\.0\d+ m inside its outline"),
        (away, "passes its outline at 0.1 m"),
    ):
        seen = ObservedPush("a", push, np.zeros(3), [1.0], np.zeros((1, 3)))
        text = explain_no_contact(obj, PushLog((seen,), "log.csv"))
        assert "at 0 m" not in text
        assert re.search(says, text), text


@pytest.fixture(scope="module")
def block():
    return make_block()


REST = np.array([-0.04, 0.0, 0.0])
"""The block lies with its last 20 mm over an edge along y, at x = 0."""

LEAN = TiltTest(REST, np.array([0.01, 0.0]), 10.0, np.zeros(2), 0.0)
LIFTED = LiftTest(REST, np.array([-0.01, 0.0]), 8.0, np.array([0.0, -0.24]))


@pytest.mark.parametrize(
    ("weighing", "says"),
    [
        (replace(LEAN, force=1.2e10), "press 1, column force: 1.2e+10 N is that of"),
        (replace(LEAN, force_std=3.5e-11), "press 1, column force_std: is 3.5e-11 N"),
        (replace(LEAN, place=np.array([10.0, 0.0])), "press 1, columns place_x, place_y: are 9.98"),
        (replace(LEAN, pose=1e3 * REST), "expected a place on it"),
        (
            replace(LEAN, edge_angle=np.pi, edge_point=np.array([0.03, 0.0])),
            "press 1, columns edge_x, edge_y, edge_angle: block lies wholly beyond",
        ),
        (replace(LIFTED, weight=8e3), "lift 1, column force: 8000 N is that of"),
        (replace(LIFTED, weight_std=1e-9), "lift 1, column force_std"),
        (replace(LIFTED, torque_std=1e-12), "lift 1, column torque_std: is 1e-12 N m"),
        (replace(LIFTED, torque=np.array([0.0, 240.0])), "put the center of mass 30 m off"),
    ],
)
def test_weighings_that_cannot_be_true_are_refused(block, weighing, says) -> None:
    is_press = isinstance(weighing, TiltTest)
    log = MassTestLog(
        presses=(weighing,) if is_press else (), lifts=() if is_press else (weighing,)
    )
    with pytest.raises(PushLogError, match=re.escape(says)):
        check_plausible_mass_tests(block, log)


def test_weighings_that_may_be_true_pass_without_a_word(block) -> None:
    good = MassTestLog((LEAN, LEAN), (LIFTED, replace(LIFTED, torque=None, torque_std=1e-12)))
    assert find_implausible_mass_tests(block, good) == []
    degrees = replace(LEAN, edge_angle=360.0 * np.pi)
    with pytest.warns(PushLogWarning, match="edge_angle: in degrees"):
        check_plausible_mass_tests(block, MassTestLog((degrees,)))


def test_whatever_passes_has_an_estimate(block) -> None:
    found = make_identification(block)
    rng = np.random.default_rng(0)
    used = 0
    for _ in range(50):
        std = 10.0 ** rng.uniform(-4, 3)
        force = 10.0 ** rng.uniform(-6, 3)
        arm = 10.0 ** rng.uniform(-9, -1.7)
        press = replace(LEAN, force=force, force_std=std, place=np.array([arm, 0.0]))
        lift = replace(LIFTED, weight=10.0 ** rng.uniform(-6, 2), weight_std=std)
        log = MassTestLog((press, press), (lift,))
        if find_implausible_mass_tests(block, log):
            continue
        used += 1
        try:
            weighed = estimate_masses(found, log)
        except IdentificationError as error:
            assert "no mass and center of mass are found" in str(error)
            continue
        x, y = weighed.absolute.center_of_mass
        inside = block.outline.convex_hull.covers(Point(x, y))
        assert inside == (weighed.status != IdentificationStatus.EXPLAINS_LITTLE)
    assert used > 12
