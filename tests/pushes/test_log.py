import math
from dataclasses import replace

import numpy as np
import pytest
import yaml

from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.pusher import DEFAULT_PUSHER_RADIUS, Pusher
from gridpush_drake.errors import PushError, PushLogError
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import find_shipped_object
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.planning.belief import Belief
from gridpush_drake.planning.contact.optimization import optimize_contact
from gridpush_drake.planning.contact.trial import ContactOptions
from gridpush_drake.planning.exploration.designed_pokes import make_pokes
from gridpush_drake.pushes.observed_push import ObservedPush, nearest_turn
from gridpush_drake.pushes.push_log import PushLog


def straight() -> Push:
    return Push([0.0, 0.1], [0.01, 0.0], 5.0, 0.004)


def observed(name="a", **changes) -> ObservedPush:
    values = {
        "name": name,
        "push": straight(),
        "pose": [0.0, 0.0, 0.0],
        "t_observed": [2.0, 5.0],
        "poses_observed": [[0.01, 0.0, 0.1], [0.02, 0.0, 0.2]],
    }
    return ObservedPush(**(values | changes))


def test_final_pose_is_the_last_observed():
    np.testing.assert_array_equal(observed().final_pose, [0.02, 0.0, 0.2])


def test_final_pose_of_a_push_to_be_predicted_is_refused():
    with pytest.raises(PushLogError, match="not observed after"):
        _ = observed(t_observed=[], poses_observed=[]).final_pose


def test_arrays_are_copied_and_read_only():
    pose = np.zeros(3)
    seen = observed(pose=pose, force_t=[0.0], force=[[1.0, 2.0]])
    pose[0] = 1
    assert seen.pose[0] == 0
    for array in (seen.pose, seen.t_observed, seen.poses_observed, seen.force_t, seen.force):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 1


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"name": ""}, "name"),
        ({"name": " a"}, "name"),
        ({"pose": [0.0, 0.0]}, r"pose has shape \(2,\)"),
        ({"pose": [0.0, 0.0, math.nan]}, "pose must hold finite"),
        ({"t_observed": [2.0]}, "poses_observed has shape"),
        ({"t_observed": [5.0, 2.0]}, "t_observed must be strictly increasing"),
        ({"t_observed": [2.0, 2.0]}, "t_observed must be strictly increasing"),
        ({"t_observed": [0.0, 2.0]}, r"t_observed\[0\] is 0.0"),
        ({"t_observed": [2.0, 5.1]}, "times within the push"),
        ({"t_observed": [[2.0, 5.0]]}, "t_observed has shape"),
        ({"force_t": [0.0]}, "come together"),
        ({"force": [[0.0, 1.0]]}, "come together"),
        ({"force_t": [0.0], "force": [0.0, 1.0]}, "force has shape"),
        ({"force_t": [-0.1], "force": [[0.0, 1.0]]}, "force_t runs from -0.1"),
        ({"force_t": [1.0, 1.0], "force": [[0.0, 1.0]] * 2}, "force_t must be strictly increasing"),
        ({"force_t": [1.0], "force": [[0.0, math.inf]]}, "force must hold finite"),
        ({"lift_force": [1.0]}, "lift_force does not come without force_t"),
        (
            {"force_t": [1.0], "force": [[0.0, 1.0]], "lift_force": [1.0, 2.0]},
            "lift_force has shape",
        ),
    ],
)
def test_what_cannot_have_been_observed_is_refused(changes, message):
    with pytest.raises(PushLogError, match=message):
        observed(**changes)


def test_times_that_miss_the_push_by_their_round_off_are_its_ends():
    end = observed().push.duration
    seen = observed(
        t_observed=[2.0, np.nextafter(end, 9)], force_t=[-1e-7, 1.0], force=[[0.0, 1.0]] * 2
    )
    assert seen.t_observed.tolist() == [2.0, end]
    assert seen.force_t.tolist() == [0.0, 1.0]


def test_length_iteration_and_indexing():
    log = PushLog([observed(name) for name in "abcd"], "here")
    assert len(log) == 4
    assert [seen.name for seen in log] == list("abcd")
    assert log[-1].name == "d"
    assert log[np.int64(1)].name == "b"
    for part, names in (
        (log[1:3], "bc"),
        (log[[3, 0]], "da"),
        (log[np.array([0, 2])], "ac"),
        (log.subset((1, 1)), "bb"),
        (log[np.array([True, False, False, True])], "ad"),
        (log.subset([]), ""),
    ):
        assert isinstance(part, PushLog)
        assert "".join(seen.name for seen in part) == names
        assert part.source == "here"
    with pytest.raises(IndexError):
        log[4]
    with pytest.raises(IndexError):
        log[[0, 4]]


def test_radius_is_replaced_in_every_push():
    log = PushLog((observed("a"), observed("b")), radius_given=False)
    wider = log.with_radius(0.02)
    assert [seen.push.radius for seen in wider] == [0.02, 0.02]
    assert [seen.push.radius for seen in log] == [0.004, 0.004]
    assert wider.radius_given
    assert not log.radius_given
    np.testing.assert_array_equal(wider[0].push.xy, log[0].push.xy)
    assert wider[0].push.duration == log[0].push.duration
    with pytest.raises(PushError, match="radius"):
        log.with_radius(0.0)


def test_a_log_made_in_code_has_its_radius():
    assert PushLog((observed(),)).radius_given
    assert DEFAULT_PUSHER_RADIUS > 0


def test_the_radius_that_is_assumed_is_the_shipped_finger_s_in_learning_and_planning():
    models = find_shipped_object("claw_hammer").parents[1]
    finger = models / "fingers" / "rod" / "finger.yaml"
    assert yaml.safe_load(finger.read_text())["tip_radius"] == DEFAULT_PUSHER_RADIUS
    obj = GridObject.from_yaml(find_shipped_object("claw_hammer"))
    for told, radius in ((None, DEFAULT_PUSHER_RADIUS), (0.010, 0.010)):
        known = replace(obj, prior=replace(obj.prior, pusher_radius=told, push_height=None))
        even = CellParameters.uniform(known)
        plan = optimize_contact(Model(known, even), np.zeros(3), [0.05, 0.0, 0.0])
        poke = make_pokes(Belief.of_parameters(Model(known, even)), np.zeros(3))[0]
        assert plan.push.push.radius == poke.radius == radius
    # Whoever knows better says so.
    thin = optimize_contact(
        Model(known, even), np.zeros(3), [0.05, 0.0, 0.0], options=ContactOptions(Pusher(0.005))
    )
    assert thin.push.push.radius == 0.005


@pytest.mark.parametrize("turns", [-3, -1, 0, 1, 7])
@pytest.mark.parametrize("difference", [-3.1, -0.2, 0.0, 3.1])
def test_nearest_turn(turns, difference):
    reference = 12.3
    assert nearest_turn(reference + difference + turns * math.tau, reference) == pytest.approx(
        reference + difference
    )


def test_nearest_turn_keeps_a_near_angle_bit_for_bit():
    assert nearest_turn(0.1 + 0.2, -2.0) == 0.1 + 0.2
    assert math.copysign(1, nearest_turn(-0.0, 0.0)) == -1
