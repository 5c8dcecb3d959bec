import numpy as np
import pytest
import shapely
from shapely import affinity

from gridpush_drake.errors import CameraError, ImageError, PerceptionError
from gridpush_drake.geometry.se2 import transform
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import find_shipped_object
from gridpush_drake.perception import Camera, Frame, PoseTracker
from gridpush_drake.perception.images.silhouette import make_silhouette
from gridpush_drake.perception.tracking.outline_finder import TrackerOptions
from gridpush_drake.perception.tracking.registration import calc_dilution
from gridpush_drake.perception.tracking.symmetries import ExpectedPose, find_symmetries
from gridpush_drake.perception.tracking.tracking import AMBIGUITY_TIME
from tests.helpers.pictures import cover, make_camera, paint

L_SHAPE = np.array([[0, 0], [0.14, 0], [0.14, 0.04], [0.05, 0.04], [0.05, 0.12], [0, 0.12]]) - [
    0.05,
    0.04,
]
SQUARE = np.array([[-0.05, -0.05], [0.05, -0.05], [0.05, 0.05], [-0.05, 0.05]])
DISC = 0.06 * np.array(
    [[np.cos(a), np.sin(a)] for a in np.linspace(0, 2 * np.pi, 72, endpoint=False)]
)
ARM = np.array([[-0.03, -0.25], [0.03, -0.25], [0.03, 0.25], [-0.03, 0.25]])
BAR = np.array([[-0.06, -0.006], [0.06, -0.006], [0.06, 0.006], [-0.06, 0.006]])
HEIGHT, BROWN, DARK = 0.03, (150, 120, 80), (50, 50, 55)
START = np.array([0.02, 0.01, 0.3])


def look(outline, pose, arm_at=None, seed=0, **painting):
    prisms = [(outline, pose, HEIGHT, BROWN)]
    if arm_at is not None:
        prisms.append((ARM, arm_at, 0.1, DARK))
    return paint(make_camera(), prisms, seed=seed, **painting)


def follow(outline, poses, use_depth=True, guess=None):
    tracker = PoseTracker(outline, HEIGHT, make_camera())
    state = tracker.start(look(outline, poses[0], depth=use_depth), guess)
    seen = []
    for k, pose in enumerate(poses):
        state, tracked = tracker.track(
            state, look(outline, pose, seed=k, depth=use_depth, shadow=0.2)
        )
        seen.append(tracked)
    return seen


def make_walk(count, step=0.008, turn=0.08):
    along = np.arange(count)[:, None]
    return START + along * np.array([step, 0.4 * step, turn])


@pytest.mark.parametrize("use_depth", [True, False], ids=["depth", "color"])
def test_poses_are_found_to_a_fraction_of_a_pixel(use_depth):
    poses = make_walk(8)
    seen = follow(L_SHAPE, poses, use_depth)
    error = np.array([tracked.pose for tracked in seen]) - poses
    assert np.hypot(*error[:, :2].T).max() < 4e-4  # a pixel shows 1.1 mm
    assert np.abs(error[:, 2]).max() < np.radians(0.25)
    for tracked, off in zip(seen, error, strict=True):
        assert off @ np.linalg.solve(tracked.covariance, off) < 16
        assert np.linalg.eigvalsh(tracked.covariance).min() > 0


@pytest.mark.slow
def test_start_searches_every_angle_and_refuses_another_outline():
    tracker = PoseTracker(L_SHAPE, HEIGHT, make_camera())
    for pose in ([-0.05, 0.04, 2.5], [0.06, -0.03, -1.2]):
        np.testing.assert_allclose(tracker.start(look(L_SHAPE, pose)).pose, pose, atol=5e-3)
    with pytest.raises(PerceptionError, match="no object of this outline is in view") as raised:
        tracker.start(look(0.4 * SQUARE, START))
    assert raised.value.picture.shape == (480, 640, 3)


@pytest.mark.parametrize(("period", "found_after"), [(0.0, 1), (0.25, 3)])
def test_an_object_that_is_gone_is_searched_for_everywhere_as_often_as_is_asked(
    period, found_after
):
    tracker = PoseTracker(L_SHAPE, HEIGHT, make_camera(), TrackerOptions(search_period=period))
    state = tracker.start(look(L_SHAPE, START, t=0.0))
    state, gone = tracker.track(state, look(DISC, [0.5, 0.5, 0.0], t=0.1))
    assert not gone.seen
    assert state.lost
    elsewhere = START + [-0.08, 0.04, 2.0]
    for k in range(1, 4):
        state, tracked = tracker.track(state, look(L_SHAPE, elsewhere, seed=k, t=0.1 + 0.1 * k))
        assert tracked.seen == (k >= found_after)
        assert state.lost != tracked.seen
    np.testing.assert_allclose(tracked.pose, elsewhere, atol=2e-3)


@pytest.mark.parametrize("name", ["combination_wrench", "toolbox", "spray_bottle"])
def test_a_silhouette_is_all_that_the_sides_and_the_top_hide(name):
    outline, camera = GridObject.from_yaml(find_shipped_object(name)).outline, make_camera()
    (x, y), distance = camera.center[:2], camera.center[2]
    rng = np.random.default_rng(0)
    for _ in range(4):
        pose, height = (
            [*rng.uniform(-0.3, 0.3, 2), rng.uniform(-np.pi, np.pi)],
            rng.uniform(0.01, 0.08),
        )
        placed = affinity.translate(
            affinity.rotate(outline, pose[2], (0, 0), use_radians=True), pose[0], pose[1]
        )
        slices = [
            affinity.scale(placed, *2 * [distance / (distance - z)], origin=(x, y))
            for z in np.linspace(0, height, 60)
        ]
        hidden = max(shapely.get_parts(shapely.union_all(slices)), key=lambda piece: piece.area)
        found = make_silhouette(outline, pose, height, camera)
        assert found.buffer(1e-9).contains(hidden)
        assert found.area < 1.003 * hidden.area
        assert found.exterior.is_ccw


def test_a_symmetric_outline_is_followed_past_its_symmetry():
    poses = make_walk(10, 0.002, 0.25)
    seen = follow(SQUARE, poses, guess=poses[0])
    assert poses[-1, 2] > np.pi / 2 + 0.5
    np.testing.assert_allclose([tracked.pose for tracked in seen], poses, atol=5e-3)


def test_the_angle_of_a_disc_is_said_to_be_unknown():
    *_, tracked = follow(DISC, make_walk(4), guess=START)
    deviation = np.sqrt(np.diag(tracked.covariance))
    assert deviation[2] > np.radians(3) > 10 * np.radians(0.2)
    assert deviation[:2].max() < 5e-4


def test_what_the_arm_covers_widens_the_covariance():
    tracker = PoseTracker(L_SHAPE, HEIGHT, make_camera())
    before = tracker.start(look(L_SHAPE, START))
    arm = [START[0] + 0.08, START[1], 0.0]
    frame = look(L_SHAPE, START + [0.003, 0, 0], arm, depth=False)
    covered = np.abs(frame.color.astype(int) - DARK).sum(axis=-1) < 60
    _, free = tracker.track(before, look(L_SHAPE, START + [0.003, 0, 0], depth=False))
    _, hidden = tracker.track(before, frame, covered)
    assert hidden.seen
    np.testing.assert_array_less(
        np.abs(hidden.pose - START - [0.003, 0, 0]), [1e-3, 1e-3, np.radians(0.5)]
    )
    assert np.linalg.det(hidden.covariance) > 2 * np.linalg.det(free.covariance)
    with_depth = look(L_SHAPE, START + [0.003, 0, 0], arm)
    _, by_height = tracker.track(before, with_depth)
    np.testing.assert_array_less(
        np.abs(by_height.pose - START - [0.003, 0, 0]), [1e-3, 1e-3, np.radians(0.5)]
    )


def test_what_covers_too_much_hides_the_object():
    tracker = PoseTracker(L_SHAPE, HEIGHT, make_camera())
    state = tracker.start(look(L_SHAPE, START))
    frame = look(L_SHAPE, START)
    covered = np.ones(frame.color.shape[:2], dtype=bool)
    column = round(float(make_camera().project(np.array([[*(START[:2] + 0.02), 0.0]]))[0, 0]))
    covered[:, column - 22 : column + 22] = (
        False  # two nearly parallel edges tell nothing of the place along them
    )
    state, hidden = tracker.track(state, frame, covered)
    assert not hidden.seen
    assert np.isnan(hidden.pose).all()
    state, free = tracker.track(state, look(L_SHAPE, START + [0.003, 0, 0], seed=1))
    assert free.seen
    np.testing.assert_array_less(
        np.abs(free.pose - START - [0.003, 0, 0]), [1e-3, 1e-3, np.radians(0.5)]
    )


def test_from_aslant_the_place_is_less_sure_along_the_view():
    """There the object's side is seen below its near edges alone, and its brightness moves them all alike."""
    oblique = make_camera(rpy=(180 + 20, 0, 0), at=(0.0, -0.25))
    tracker = PoseTracker(L_SHAPE, HEIGHT, oblique)
    frame = paint(oblique, [(L_SHAPE, START, HEIGHT, BROWN)])
    _, aslant = tracker.track(tracker.start(frame, START), frame)
    across, along = np.sqrt(np.diag(aslant.covariance))[:2]
    assert along > 1.5 * across
    assert abs(aslant.pose[1] - START[1]) < 3 * along


def test_dilution_is_the_worst_direction_s():
    turn, _ = np.linalg.qr(np.random.default_rng(3).standard_normal((3, 3)))
    whole = turn @ np.diag([1 / 4, 1 / 9, 1 / 16]) @ turn.T
    left = turn @ np.diag([1 / 4, 1.0, 1 / 8]) @ turn.T
    assert calc_dilution(whole, left) == pytest.approx(3.0)
    assert calc_dilution(whole, whole) == pytest.approx(1.0)


def test_lost_is_nan_and_found_again_elsewhere():
    tracker = PoseTracker(L_SHAPE, HEIGHT, make_camera())
    state = tracker.start(look(L_SHAPE, START))
    empty = paint(make_camera(), [], t=1.0)
    state, tracked = tracker.track(state, empty)
    assert not tracked.seen
    assert state.lost
    assert np.isnan(tracked.pose).all()
    assert np.isnan(tracked.covariance).all()
    elsewhere = np.array([-0.1, -0.06, 2.0])
    state, tracked = tracker.track(state, look(L_SHAPE, elsewhere, t=2.0))
    np.testing.assert_allclose(tracked.pose, elsewhere, atol=5e-3)
    assert not state.lost


@pytest.mark.parametrize("floor", [0.0, 1.4], ids=["too_far_to_measure", "measured"])
def test_what_hangs_over_the_edge_is_found_again_before_the_floor(floor):
    camera, edge = make_camera(), 0.07
    pose = np.array([0.05, -0.02, 2.6])
    frame = look(L_SHAPE, pose, shadow=0.2)
    x = camera.cast(np.stack(np.meshgrid(np.arange(640), np.arange(480)), axis=-1))[..., 0]
    beyond = (x > edge) & (cover(camera, L_SHAPE, pose, HEIGHT) < 0.5)
    frame.color[beyond], frame.depth[beyond] = DARK, floor
    tracker = PoseTracker(L_SHAPE, HEIGHT, camera, table_top=shapely.box(-1, -1, edge, 1))
    state = tracker.start(look(L_SHAPE, [-0.1, 0.05, 0.3]))
    _, tracked = tracker.track(state, frame)
    assert tracked.seen
    np.testing.assert_array_less(np.abs(tracked.pose - pose), [5e-4, 5e-4, np.radians(0.3)])


def test_no_edge_of_the_table_and_nothing_that_the_arm_hid_at_first_is_found_for_a_thin_object_that_is_hidden():
    camera, edge = make_camera(), 0.2
    x, y = np.moveaxis(
        camera.cast(np.stack(np.meshgrid(np.arange(640), np.arange(480)), axis=-1)), -1, 0
    )

    def take(pose=None, arm=False, t=0.0):
        """A table whose light falls off toward the back, and the floor; the arm stands there at first."""
        frame = paint(
            camera, [] if pose is None else [(BAR, pose, HEIGHT, BROWN)], seed=int(10 * t), t=t
        )
        shade = np.clip(1.0 - 8.0 * np.clip(y - 0.06, 0, None) ** 1.2, 0.5, 1.0)[..., None]
        frame.color[:] = np.rint(frame.color * shade)
        frame.color[x > edge], frame.depth[x > edge] = DARK, 1.4
        hidden = arm & (y > 0.08) & (x < -0.02)
        frame.color[hidden], frame.depth[hidden] = DARK, 0.4
        return frame, hidden

    tracker = PoseTracker(BAR, HEIGHT, camera, table_top=shapely.box(-1, -1, edge, 1))
    start = np.array([0.03, -0.04, 0.3])
    frame, hidden = take(start, arm=True)
    state = tracker.start(frame, start, hidden)
    for k in range(3):
        state, tracked = tracker.track(state, *take(t=0.1 * k))
        assert not tracked.seen
    there = np.array([-0.05, -0.07, 1.2])
    state, tracked = tracker.track(state, *take(there, t=0.4))
    np.testing.assert_allclose(tracked.pose, there, atol=5e-3)


def push_out_of_sight(outline, start, end, tell=None):
    """Tracks an object that is hidden for a second while it goes from one pose to another."""
    corners = np.array(shapely.Polygon(outline).exterior.coords)[:-1]
    tracker = PoseTracker(outline, HEIGHT, make_camera())
    state = tracker.start(look(corners, start), start)
    covered = np.ones((480, 640), dtype=bool)
    dark = np.full((480, 640, 3), DARK[0], np.uint8)
    for k in range(1, 6):
        state, hidden = tracker.track(state, Frame(dark, None, 0.2 * k), covered, tell)
        assert not hidden.seen
    state, first = tracker.track(state, look(corners, end, seed=6, t=1.2), None, tell)
    state, last = tracker.track(state, look(corners, end, seed=7, t=1.4))
    return first, last


def make_wrench(radius, larger, shift=0.0):
    """A handle with two open heads of these radii, moved along its x axis."""
    heads = []
    for side, size in ((-1, radius), (1, larger)):
        left, right = sorted((side * 0.07, side * 0.1))
        jaw = shapely.box(left, -0.007, right, 0.007)
        heads.append(shapely.Point(side * 0.07, 0).buffer(size) - jaw)
    handle = shapely.box(-0.07, -0.006, 0.07, 0.006)
    return affinity.translate(shapely.union_all([handle, *heads]), shift)


EQUAL_ENDS = make_wrench(0.016, 0.016)
NEARLY = make_wrench(0.016, 0.0165, shift=0.04)
PLATE = shapely.box(-0.06, -0.035, 0.06, 0.035)


@pytest.mark.parametrize(
    ("outline", "theta"),
    [(EQUAL_ENDS, -2.6), (NEARLY, 0.7), (PLATE, -2.6)],
    ids=["wrench", "nearly", "plate"],
)
def test_what_looks_the_same_turned_round_is_not_flipped_by_a_push_out_of_sight(outline, theta):
    start = np.array([-0.04, -0.02, theta])
    end = start + [0.06, 0.05, 0.5]
    for tracked in push_out_of_sight(outline, start, end):
        off = tracked.pose - end
        assert np.hypot(*off[:2]) < 2e-3
        assert abs(off[2]) < np.radians(1.0)
        assert np.sqrt(tracked.covariance[2, 2]) < np.radians(15)


@pytest.mark.slow
def test_a_model_says_which_side_of_a_square_is_which():
    """After a turn by 60 degrees its next side is nearer to where the last one was."""
    start = np.array([-0.04, -0.02, 0.2])
    end = start + [0.06, 0.05, np.radians(60)]
    told = ExpectedPose(end + [0.01, -0.01, 0.1], place_deviation=0.02, turn_deviation=0.15)
    first, last = push_out_of_sight(SQUARE, start, end, told)
    np.testing.assert_allclose(last.pose, end, atol=5e-3)
    assert np.sqrt(last.covariance[2, 2]) < np.radians(3)
    # without it the wrong answer is the likelier one, and the other is kept and stated
    first, last = push_out_of_sight(SQUARE, start, end)
    assert abs(abs(first.pose[2] - end[2]) - np.pi / 2) < np.radians(1)
    assert np.sqrt(last.covariance[2, 2]) > np.radians(15)


def test_which_ways_an_outline_can_be_turned():
    def list_angles(outline):
        return sorted(round(float(np.degrees(way.pose[2]))) for way in find_symmetries(outline))

    assert list_angles(shapely.box(0.01, -0.05, 0.11, 0.05)) == [90, 180, 270]
    assert list_angles(PLATE) == [180]
    assert list_angles(shapely.Point(0.1, 0.0).buffer(0.05)) == []
    assert list_angles(shapely.Polygon(L_SHAPE)) == []
    (way,) = find_symmetries(NEARLY)
    assert 0.9 < way.overlap < 1.0
    turned = transform(way.pose, np.array(NEARLY.exterior.coords))
    overlap = shapely.Polygon(turned).intersection(NEARLY).area / NEARLY.area
    assert overlap == pytest.approx(2 * way.overlap / (1 + way.overlap), abs=1e-3)


def test_an_object_that_moves_along_its_longer_sides_is_followed():
    """Most of its edges stay where they are; those of its ends are no outliers."""
    poses = np.array([0.0, 0.0, 0.0]) + np.arange(5)[:, None] * [0.011, 0.0, 0.0]
    for tracked, pose in zip(follow(BAR, poses, guess=poses[0]), poses, strict=True):
        np.testing.assert_allclose(tracked.pose, pose, atol=1e-3)


def test_thin_parts_that_go_further_than_they_are_wide_are_followed_past_the_arm():
    """The nearest edges are those of the wrong side of a leg, and the arm hides the joint."""
    pliers = GridObject.from_yaml(find_shipped_object("pliers")).outline
    outline = np.array(pliers.exterior.coords)[:-1]
    middle = transform([0.0, 0.0, 1.5], np.array(pliers.centroid.coords))[0]
    start = np.array([*-middle, 1.5])
    tracker = PoseTracker(outline, HEIGHT, make_camera())
    state = tracker.start(look(outline, start), start)
    covered = np.zeros((480, 640), dtype=bool)
    covered[215:265, 250:330] = True
    for step in ([0.0105, -0.002, -0.15], [0.02, 0.0, 0.0], [-0.015, 0.0, 0.2]):
        _, tracked = tracker.track(state, look(outline, start + step, seed=1), covered)
        np.testing.assert_allclose(tracked.pose, start + step, atol=2e-3)


def test_track_is_pure():
    tracker = PoseTracker(L_SHAPE, HEIGHT, make_camera())
    state = tracker.start(look(L_SHAPE, START))
    frame = look(L_SHAPE, START + [0.004, 0, 0.02], seed=5)
    pose = state.pose.copy()
    first, second = tracker.track(state, frame)[1], tracker.track(state, frame)[1]
    np.testing.assert_array_equal(first.pose, second.pose)
    np.testing.assert_array_equal(state.pose, pose)


def test_bad_arguments_are_named():
    camera = make_camera()
    with pytest.raises(CameraError, match="X_WC is not known"):
        PoseTracker(L_SHAPE, HEIGHT, Camera(640, 480, camera.K, []))
    with pytest.raises(PerceptionError, match=r"height is 0\.8"):
        PoseTracker(L_SHAPE, 0.8, camera)
    tracker = PoseTracker(L_SHAPE, HEIGHT, camera)
    frame = look(L_SHAPE, START)
    state = tracker.start(frame)
    with pytest.raises(ImageError, match="has 640x240 pixels"):
        tracker.track(state, frame._replace(color=frame.color[::2]))


HALF_PLATE = np.array([[-0.12, -0.02], [0.12, -0.02], [0.12, 0.02], [-0.12, 0.02]])
ILL_SEEN = np.array([[-0.12, -0.02], [0.12, -0.02], [0.12, 0.017], [-0.03, 0.02], [-0.12, 0.02]])
"""The same as a camera sees it that takes a part of a dark side for the floor."""


def cover_half(shape, top):
    """A cover of all but the right half of the plate, and of its lower long side where `top`."""
    covered = np.zeros(shape[:2], dtype=bool)
    covered[:, : round(shape[1] / 2)] = True
    if top:
        covered[round(shape[0] / 2) :] = True
    return covered


def test_an_object_at_rest_does_not_seem_to_move_where_something_covers_its_better_edges():
    """By the edges that are left alone, the plate seems to be turned by a degree."""
    pose = np.zeros(3)
    tracker = PoseTracker(HALF_PLATE, HEIGHT, make_camera())
    frames = [look(ILL_SEEN, pose, seed=k, depth=False) for k in range(3)]
    state, clear = tracker.track(tracker.start(frames[0], pose), frames[0])
    covered = cover_half(frames[0].color.shape, top=True)
    for untouched in (True, False):
        _, seen = tracker.track(state, frames[1], covered, untouched=untouched)
        assert seen.seen
        np.testing.assert_allclose(seen.pose[:2], clear.pose[:2], atol=3e-4)
        assert abs(seen.pose[2] - clear.pose[2]) < np.radians(0.1)
        assert np.linalg.det(seen.covariance) > np.linalg.det(clear.covariance)


def test_a_jump_of_an_object_that_nothing_touched_is_not_told_until_it_is_plainly_seen():
    moved = np.array([0.004, -0.003, np.radians(3.0)])
    tracker = PoseTracker(HALF_PLATE, HEIGHT, make_camera())
    frame = look(HALF_PLATE, np.zeros(3), depth=False)
    state, _ = tracker.track(tracker.start(frame, np.zeros(3)), frame, untouched=True)
    after = look(HALF_PLATE, moved, seed=1, t=0.1, depth=False)
    covered = cover_half(after.color.shape, top=False)
    doubted, told = tracker.track(state, after, covered, untouched=True)
    assert not told.seen
    # What the finger may have touched may have moved.
    assert tracker.track(state, after, covered)[1].seen
    # With nothing before it, the object is where it is seen; and a view that stays poor must do.
    _, plain = tracker.track(doubted, after._replace(t=0.2), untouched=True)
    np.testing.assert_allclose(plain.pose, moved, atol=1e-3)
    late = after._replace(t=0.2 + AMBIGUITY_TIME)
    assert tracker.track(doubted, late, covered, untouched=True)[1].seen


def test_an_object_that_somebody_else_moved_is_told_at_once_though_something_covers_a_part_of_it():
    moved = np.array([0.01, 0.05, np.radians(3.0)])
    tracker = PoseTracker(HALF_PLATE, HEIGHT, make_camera())
    frame = look(HALF_PLATE, np.zeros(3), depth=False)
    state, _ = tracker.track(tracker.start(frame, np.zeros(3)), frame, untouched=True)
    after = look(HALF_PLATE, moved, seed=1, t=0.1, depth=False)
    covered = np.zeros(after.color.shape[:2], dtype=bool)
    covered[:, 380:420] = True
    _, told = tracker.track(state, after, covered, untouched=True)
    np.testing.assert_allclose(told.pose, moved, atol=1e-3)


def test_an_object_that_was_hidden_is_not_compared_with_what_hardly_showed_it():
    moved = np.array([0.01, 0.012, 0.05])
    tracker = PoseTracker(HALF_PLATE, HEIGHT, make_camera())
    frame = look(HALF_PLATE, np.zeros(3), depth=False)
    state, _ = tracker.track(tracker.start(frame, np.zeros(3)), frame)
    # Two parallel edges do not tell how far it was pushed along them.
    after = look(HALF_PLATE, moved, seed=1, t=0.1, depth=False)
    strip = np.ones(frame.color.shape[:2], dtype=bool)
    strip[:, 290:350] = False
    for untouched in (False, True):
        state, hidden = tracker.track(state, after, strip, untouched=untouched)
        assert not hidden.seen
    half = cover_half(frame.color.shape, top=False)
    _, told = tracker.track(state, after, half, untouched=True)
    assert told.seen
    np.testing.assert_allclose(told.pose, moved, atol=1e-3)
