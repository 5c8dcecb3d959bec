"""Several known outlines in one picture: apart, touching, and pushing each other."""

import numpy as np
import pytest
import shapely

from gridpush_drake.errors import PerceptionError
from gridpush_drake.geometry.se2 import compose
from gridpush_drake.perception import Frame
from gridpush_drake.perception.tracking.multi_object_tracking import (
    KnownObject,
    SceneTracker,
    track_objects,
)
from gridpush_drake.perception.tracking.tracking import PoseTracker
from tests.helpers.pictures import make_camera, paint

L_SHAPE = np.array([[0, 0], [0.14, 0], [0.14, 0.04], [0.05, 0.04], [0.05, 0.12], [0, 0.12]]) - [
    0.05,
    0.04,
]
BLOCK = np.array([[-0.03, -0.02], [0.03, -0.02], [0.03, 0.02], [-0.03, 0.02]])
WEDGE = np.array([[-0.05, -0.03], [0.05, -0.03], [0.02, 0.03]])
HEIGHT = 0.03
BROWN = (150, 120, 80)
BLUE = (70, 80, 140)
DARK = (60, 60, 62)

FRIENDS = (L_SHAPE, BLOCK, WEDGE)
COLORS = (BROWN, BLUE, DARK)
# the block lies against the L's foot from the right, the wedge against the block's right side
TOUCHING = np.array([[0.0, 0.0, 0.0], [0.1203, -0.015, 0.0], [0.2, 0.06, 0.4]])


def look(poses, seed=0, outlines=FRIENDS, colors=COLORS, **painting):
    prisms = [
        (outline, pose, HEIGHT, color)
        for outline, pose, color in zip(outlines, poses, colors, strict=True)
    ]
    return paint(make_camera(), prisms, seed=seed, **painting)


def make_tracker(outlines=FRIENDS):
    names = ("elbow", "block", "wedge")
    objects = [KnownObject(each, HEIGHT, name) for each, name in zip(outlines, names, strict=False)]
    return SceneTracker(objects, make_camera())


def check(tracked, poses, place=6e-4, angle=0.007):
    for found, pose in zip(tracked, poses, strict=True):
        assert found.seen
        off = found.pose - pose
        assert np.hypot(*off[:2]) < place, off
        assert abs(off[2]) < angle, off


@pytest.mark.parametrize("use_depth", [True, False], ids=["depth", "color"])
def test_objects_that_touch_do_not_pull_on_each_other(use_depth):
    start = TOUCHING - [0.08, 0.0, 0.0]
    tracker = make_tracker()
    state = tracker.start(look(start, depth=use_depth), list(start))
    for k in range(1, 6):
        # the L pushes the block, which turns a little; the wedge stays
        poses = start + [0.007 * k, 0.0, 0.0]
        poses[2] = start[2]
        frame = look(poses, seed=k, depth=use_depth, shadow=0.1)
        state, tracked = tracker.track(state, frame)
        check(tracked, poses)
        for found, pose in zip(tracked, poses, strict=True):
            off = found.pose - pose
            assert off @ np.linalg.solve(found.covariance, off) < 16


def test_all_are_found_without_a_guess_apart_and_touching():
    apart = np.array([[-0.12, -0.05, 0.3], [0.1, -0.08, 1.0], [0.08, 0.1, -2.0]])
    touching = TOUCHING - [0.08, 0.0, 0.0]
    for poses in (apart, touching):
        tracker = make_tracker()
        state = tracker.start(look(poses))
        found = np.array([each.pose for each in state.objects])
        # half a turn of the block looks the same
        found[1, 2] = (found[1, 2] - poses[1, 2] + np.pi / 2) % np.pi - np.pi / 2 + poses[1, 2]
        np.testing.assert_allclose(found, poses, atol=5e-3)


def test_an_object_that_is_not_there_is_named():
    tracker = make_tracker()
    two = look(TOUCHING[:2] - [0.08, 0.0, 0.0], outlines=FRIENDS[:2], colors=COLORS[:2])
    with pytest.raises(PerceptionError, match="wedge: not found") as raised:
        tracker.start(two)
    assert raised.value.picture.shape == (480, 640, 3)
    with pytest.raises(PerceptionError, match="2 are given; expected 3"):
        tracker.start(two, [None, None])
    with pytest.raises(PerceptionError, match="none are given"):
        SceneTracker([], make_camera())


def test_twins_that_pass_each_other_are_not_swapped():
    outlines = (L_SHAPE, L_SHAPE)
    tracker = make_tracker(outlines)
    poses = np.array([[-0.12, -0.03, 0.2], [0.1, 0.05, 0.2]])
    state = tracker.start(look(poses, outlines=outlines, colors=(BROWN, BROWN)), list(poses))
    step = np.array([[0.009, 0.0, 0.0], [-0.009, 0.0, 0.0]])
    for k in range(1, 9):
        poses = poses + step
        frame = look(poses, seed=k, outlines=outlines, colors=(BROWN, BROWN), t=0.1 * k)
        state, tracked = tracker.track(state, frame)
        check(tracked, poses)


def test_what_was_hidden_is_not_found_in_the_place_of_its_twin():
    outlines = (L_SHAPE, L_SHAPE)
    colors = (BROWN, BROWN)
    tracker = make_tracker(outlines)
    poses = np.array([[-0.12, -0.03, 0.2], [0.1, 0.05, 0.2]])
    first = look(poses, outlines=outlines, colors=colors)
    state = tracker.start(first, list(poses))
    # all of the first one is covered
    covered = np.zeros((480, 640), dtype=bool)
    covered[:, :330] = True
    dark = np.where(covered[..., None], np.uint8(40), first.color)
    for k in range(1, 4):
        state, (hidden, free) = tracker.track(state, Frame(dark, None, 0.1 * k), covered)
        assert not hidden.seen
        check([free], poses[1:])
    before = state.objects[0]
    # it is gone altogether, and there is another one of its outline in view
    empty = look(poses[1:], outlines=outlines[1:], colors=colors[1:], t=0.5)
    state, (gone, free) = tracker.track(state, empty)
    assert not gone.seen
    check([free], poses[1:])
    # (the tracker of one outline takes the twin for it)
    _, mistaken = PoseTracker(L_SHAPE, HEIGHT, make_camera()).track(before, empty)
    check([mistaken], poses[1:])
    # it comes back elsewhere
    there = np.array([[-0.1, 0.06, -1.2], poses[1]])
    state, tracked = tracker.track(state, look(there, outlines=outlines, colors=colors, t=0.6))
    check(tracked, there)


@pytest.mark.slow
def test_a_guess_for_some_is_enough_and_frames_may_be_a_stream():
    poses = TOUCHING - [0.08, 0.0, 0.0]
    tracker = make_tracker()
    state = tracker.start(look(poses), [None, poses[1], None])
    np.testing.assert_allclose([each.pose for each in state.objects], poses, atol=5e-3)
    apart = compose([0.0, 0.05, 0.0], [0.12, 0.0, 0.3])
    frames = [
        look(
            [(-0.1, -0.05, 0.3), (*apart[:2], apart[2])],
            seed=k,
            outlines=FRIENDS[:2],
            colors=COLORS[:2],
            t=0.1 * k,
        )
        for k in range(2)
    ]
    for _, tracked in track_objects(make_tracker(FRIENDS[:2]), frames):
        assert all(found.seen for found in tracked)


def test_overlap_of_the_drawing_is_none():
    placed = [
        shapely.Polygon(compose_all(pose, outline))
        for pose, outline in zip(TOUCHING, FRIENDS, strict=True)
    ]
    assert placed[0].intersection(placed[1]).area == 0
    assert placed[0].distance(placed[1]) < 1e-3


def compose_all(pose, outline):
    return [compose(pose, (*point, 0.0))[:2] for point in outline]
