"""Looks at an object that comes to rest, moves on, and goes out of sight."""

import numpy as np

from gridpush_drake.planning.closed_loop import LoopOptions, PoseFilter

OPTIONS = LoopOptions(observations=4, rest=0.004, rest_angle=0.04, timeout=1.0)


def look(poses, looks=None):
    looks = looks or PoseFilter()
    for i, pose in enumerate(poses):
        looks = looks.take_in(0.1 * i, np.array(pose, float), OPTIONS)
    return looks


def test_looks_of_one_rest_are_averaged():
    poses = [(0.1, 0.2, 0.3), (0.103, 0.198, 0.33), (0.101, 0.2, 0.31)]
    looks = look(poses)
    assert len(looks) == 3
    np.testing.assert_allclose(looks.calc_mean(), np.mean(poses, axis=0), rtol=1e-15)


def test_no_more_than_the_latest_are_kept():
    looks = look([(1e-4 * i, 0.0, 0.0) for i in range(7)])
    np.testing.assert_allclose(np.array(looks.poses)[:, 0], [3e-4, 4e-4, 5e-4, 6e-4], atol=1e-15)


def test_what_lies_elsewhere_or_is_turned_begins_another_rest():
    for moved in ((0.005, 0.0, 0.0), (0.0, -0.005, 0.0), (0.0, 0.0, 0.05)):
        assert look([(0.0, 0.0, 0.0), (0.0, 0.0, 0.0), moved]).poses == (moved,)
    slow = [(0.002 * i, 0.0, 0.0) for i in range(4)]  # each near the one before, but not all of one rest
    assert look(slow).poses == tuple(slow[1:])


def test_out_of_sight_is_overdue_after_a_while_and_begins_anew():
    looks = look([(0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (np.nan, np.nan, np.nan)])
    assert (len(looks), looks.last_seen) == (0, 0.1)
    assert not looks.is_overdue(1.0, OPTIONS)
    assert looks.is_overdue(1.2, OPTIONS)


def test_while_the_robot_works_only_whether_it_was_seen_counts():
    looks = look([(0.0, 0.0, 0.0)])
    assert looks.wait(3.0, np.zeros(3)) == PoseFilter(last_seen=3.0)
    assert looks.wait(3.0, np.full(3, np.nan)) == PoseFilter()
