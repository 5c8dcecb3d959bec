"""Dubins curves with different turns to the left and to the right."""

import numpy as np

from gridpush_drake.geometry.se2 import wrap_angle
from gridpush_drake.planning.stable.dubins import find_dubins_curves, move_along_arc


def follow(pose, curvatures, lengths, steps=4000):
    """Follows pieces by many small steps, each straight along its middle direction."""
    x, y, theta = pose
    for k, length in zip(curvatures, lengths, strict=True):
        h = length / steps
        angles = theta + k * h * (np.arange(steps) + 0.5)
        x += h * np.cos(angles).sum()
        y += h * np.sin(angles).sum()
        theta += k * length
    return np.array([x, y, theta])


def test_every_curve_ends_at_the_goal_and_the_best_is_near_the_straight_line():
    rng = np.random.default_rng(0)
    found = 0
    for _ in range(20):
        start, goal = rng.uniform(-1, 1, (2, 3)) * (0.5, 0.5, 3.0)
        curves = find_dubins_curves(start, goal, -9.0, 4.0)
        for k, lengths in zip(curves.curvatures, curves.lengths, strict=True):
            if not np.isfinite(lengths).all():
                continue
            end = follow(start, k, lengths)
            np.testing.assert_allclose(end[:2], goal[:2], atol=1e-5)
            assert abs(wrap_angle(end[2] - goal[2])) < 1e-9
            assert (lengths >= 0).all()
            assert lengths.sum() >= np.linalg.norm(goal[:2] - start[:2]) - 1e-9
            found += 1
    assert found >= 40


def test_straight_ahead_is_a_line_and_one_hand_is_enough():
    ahead = find_dubins_curves((0, 0, 0), (0.7, 0, 0), -5.0, 5.0)
    np.testing.assert_allclose(ahead.lengths.sum(axis=1).min(), 0.7)
    # two turns to the left, and a line between them
    goal = follow((0, 0, 0), (5.0, 0.0, 5.0), (0.3, 0.1, 0.5))
    left_only = find_dubins_curves((0, 0, 0), goal, 0.0, 5.0)
    finite = np.isfinite(left_only.lengths).all(axis=1)
    assert finite.sum() == 1
    np.testing.assert_allclose(left_only.lengths[finite][0], (0.3, 0.1, 0.5), atol=1e-5)


def test_an_arc_is_what_small_steps_make():
    start = np.array([0.1, -0.2, 0.4])
    for k, length in ((0.0, 0.3), (7.0, 0.2), (-3.0, 0.5)):
        end = move_along_arc(start, k, length)
        np.testing.assert_allclose(end, follow(start, [k], [length]), atol=1e-6)
