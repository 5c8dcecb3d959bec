from functools import lru_cache

import cv2
import numpy as np
import pytest
from shapely import Polygon

from gridpush_drake.errors import (
    CameraError,
    ImageError,
    MultipleObjectsError,
    NoObjectError,
    NoTableError,
    ObjectAtBorderError,
    ObjectError,
    PerceptionError,
)
from gridpush_drake.geometry.se2 import transform
from gridpush_drake.perception import Camera, DetectorOptions, detect_object, read_color, read_depth
from gridpush_drake.perception.detection.foreground import (
    Foreground,
    fill_holes,
    find_foreground,
    refine_boundary,
)
from gridpush_drake.perception.images.table_view import cover_pixels
from tests.helpers.pictures import calc_outline_error, cover, make_camera, paint
from tests.helpers.shared_data import shared_data

L_SHAPE = np.array([[0, 0], [0.14, 0], [0.14, 0.04], [0.05, 0.04], [0.05, 0.12], [0, 0.12]]) - [
    0.05,
    0.04,
]
BOARD = np.array([[-0.18, -0.13], [0.18, -0.13], [0.18, 0.13], [-0.18, 0.13]])
POSE, HEIGHT, BROWN = (0.02, 0.01, 0.3), 0.03, (150, 120, 80)
NAMES = ("hammer", "book", "box", "snack", "windex")


def detect(prisms, options=None, camera=None, use_depth=True, **painting):
    camera = camera or make_camera()
    frame = paint(camera, prisms, depth=use_depth, **painting)
    return detect_object(frame.color, frame.depth, camera, options)


@lru_cache(maxsize=1)
def find_plain():
    """What is found of the L alone, by color and depth."""
    return detect([(L_SHAPE, POSE, HEIGHT, BROWN)])


@pytest.mark.parametrize("use_depth", [True, False], ids=["depth", "color"])
@pytest.mark.parametrize("at", [(0.02, 0.01, 0.3), (0.14, 0.08, 2.0)], ids=["middle", "aside"])
def test_outline_and_height_are_found_in_shadow_and_gradient(at, use_depth):
    options = None if use_depth else DetectorOptions(height=HEIGHT)
    found = detect([(L_SHAPE, at, HEIGHT, BROWN)], options, use_depth=use_depth, shadow=0.25)
    true = Polygon(transform(at, L_SHAPE))
    assert calc_outline_error(found.outline, true) < 5e-4
    assert abs(found.outline.area / true.area - 1) < 0.025
    assert abs(found.height - HEIGHT) < 0.0015
    np.testing.assert_allclose(found.pixel, found.camera.project([*found.X_WB[:2], 0]))


@pytest.mark.slow
def test_parallax_would_spoil_it():
    seen = detect([(L_SHAPE, (0.14, 0.08, 2.0), 0.06, BROWN)], DetectorOptions(height=1e-6))
    true = Polygon(transform((0.14, 0.08, 2.0), L_SHAPE))
    assert calc_outline_error(seen.outline, true) > 4e-3
    corrected = detect([(L_SHAPE, (0.14, 0.08, 2.0), 0.06, BROWN)])
    assert calc_outline_error(corrected.outline, true) < 1e-3


TABLE = (170, 168, 160)
HEAD = np.array([[-0.10, -0.02], [0.0, -0.02], [0.0, 0.02], [-0.10, 0.02]])
GRIP = np.array([[0.0, -0.02], [0.10, -0.02], [0.10, 0.02], [0.0, 0.02]])
LOW = 0.0035


@pytest.mark.slow
def test_a_part_of_the_table_s_color_that_is_hardly_higher_is_found_and_doubted():
    """Each pixel of the head is as high as three standard deviations of its noise; all together are plain."""
    camera = make_camera()
    found = detect([(HEAD, POSE, LOW, TABLE), (GRIP, POSE, LOW, BROWN)], shade=0.0)
    whole = np.array([HEAD[0], GRIP[1], GRIP[2], HEAD[3]])
    true = cover(camera, whole, POSE, LOW) > 0.5
    iou = (found.mask & true).sum() / (found.mask | true).sum()
    assert iou > 0.9
    assert found.doubtful
    # nobody need doubt an object that stands out
    plain = detect([(whole, POSE, LOW, BROWN)], shade=0.0)
    assert not plain.doubtful
    # the doubt is graded
    assert found.expected_iou < 0.9 < plain.expected_iou


def test_a_part_that_hardly_differs_beside_one_that_does_is_kept():
    """Color draws the boundary of the black part, and must not cut the pale one off."""
    camera = make_camera()
    pale = (176, 174, 166)
    prisms = [(GRIP, POSE, 0.008, pale), (HEAD, POSE, 0.008, (25, 25, 25))]
    whole = np.array([HEAD[0], GRIP[1], GRIP[2], HEAD[3]])
    found = detect(prisms, shade=0.0, camera=camera)
    true = cover(camera, whole, POSE, 0.008) > 0.5
    pale_part = cover(camera, GRIP, POSE, 0.008) > 0.5
    assert (found.mask & pale_part).sum() > 0.95 * pale_part.sum()
    assert (found.mask & true).sum() / (found.mask | true).sum() > 0.8
    assert found.doubtful


def test_what_the_arm_hid_is_no_object_though_its_depth_is_missing():
    camera = make_camera()
    frame = paint(camera, [(L_SHAPE, POSE, HEIGHT, BROWN)])
    arm = np.zeros((480, 640), dtype=bool)
    arm[120:320, 400:620] = True
    color, depth = cover_pixels(frame.color, frame.depth, arm, 0)
    found = detect_object(color, depth, camera)
    true = (cover(camera, L_SHAPE, POSE, HEIGHT) > 0.5) & ~arm
    assert (found.mask & true).sum() / (found.mask | true).sum() > 0.98
    assert not found.doubtful


def test_what_joins_two_objects_must_be_seen():
    """Two objects with table between them are two, however alike they are."""
    apart = HEAD - [0.06, 0.0]
    with pytest.raises(MultipleObjectsError):
        detect([(apart, POSE, HEIGHT, BROWN), (GRIP, POSE, HEIGHT, BROWN)])


def test_an_object_that_fills_half_of_the_picture():
    found = detect([(BOARD, (0, 0, 0.1), 0.04, (205, 205, 215))], camera=make_camera(distance=0.5))
    assert found.mask.mean() > 0.45
    assert calc_outline_error(found.outline, Polygon(transform((0, 0, 0.1), BOARD))) < 1e-3


def test_without_X_WC_depth_gives_the_world():
    camera = make_camera(rpy=(176, 3, 90), at=(0.3, 0.2))
    frame = paint(camera, [(L_SHAPE, (0.32, 0.22, 0.3), HEIGHT, BROWN)])
    unplaced = Camera(camera.width, camera.height, camera.K, camera.distortion)
    found = detect_object(frame.color, frame.depth, unplaced)
    assert abs(found.outline.area / Polygon(L_SHAPE).area - 1) < 0.025
    middle = found.camera.project([0, 0, 0])
    np.testing.assert_allclose(middle, camera.K[:2, 2], atol=1e-9)
    tilt = np.degrees(
        np.arccos(
            found.camera.X_WC[2, 2] * camera.X_WC[2, 2]
            + found.camera.X_WC[2, :2] @ camera.X_WC[2, :2]
        )
    )
    assert tilt < 0.3
    with pytest.raises(CameraError, match="X_WC is not known and there is no depth"):
        detect_object(frame.color, None, unplaced)


def test_cells_fill_the_outline_in_the_body_frame():
    found = find_plain()
    obj = found.make_grid_object(0.01, "l_shape")
    assert abs(obj.cell_size / 0.01 - 1) < 0.2
    assert obj.height == found.height
    assert abs(obj.n * obj.cell_size**2 / found.outline.area - 1) < 0.1
    np.testing.assert_allclose(obj.outline.centroid.coords[0], [0, 0], atol=1e-9)


def test_the_close_up_shows_all_of_the_outline_and_little_else():
    found = detect([(L_SHAPE, (0.1, 0.08, 2.0), HEIGHT, BROWN)])
    rows, columns = np.nonzero(found.mask)
    longer = max(np.ptp(rows), np.ptp(columns))
    assert max(found.close_up.shape[:2]) == pytest.approx(1.4 * longer, abs=2)
    drawn = [
        int((picture == (0, 255, 0)).all(axis=-1).sum())
        for picture in (found.close_up, found.picture)
    ]
    assert drawn[0] == drawn[1] > 100


@pytest.mark.slow
def test_parts_are_told_apart_by_color():
    half = np.array([[-0.06, -0.03], [0.0, -0.03], [0.0, 0.03], [-0.06, 0.03]])
    prisms = [(half, (0, 0, 0), HEIGHT, (150, 40, 40)), (-half, (0, 0, 0), HEIGHT, (40, 60, 160))]
    obj = detect(prisms, DetectorOptions(parts=True)).make_grid_object(0.01)
    left = obj.p_BC[:, 0] < 0
    assert set(obj.labels) == {1, 2}
    assert len(set(obj.labels[left])) == len(set(obj.labels[~left])) == 1
    assert obj.prior.uniform_parts
    assert (
        not detect(prisms[:1], DetectorOptions(parts=True)).make_grid_object().prior.uniform_parts
    )


def test_cells_too_small_to_be_counted_are_refused():
    found = find_plain()
    with pytest.raises(
        ObjectError,
        match=r"^plate: cells of 0\.0001 m are .*; expected at most 10000, so of at least",
    ):
        found.make_grid_object(1e-4, "plate")


@pytest.mark.slow
def test_what_is_wrong_is_said_with_a_picture():
    camera = make_camera()
    piece = (L_SHAPE, POSE, HEIGHT, BROWN)
    cases = {
        NoObjectError: [],
        MultipleObjectsError: [
            (L_SHAPE, (-0.15, -0.1, 0.3), HEIGHT, (60, 60, 120)),
            (L_SHAPE, (0.15, 0.05, 0), 0.02, BROWN),
        ],
        ObjectAtBorderError: [(L_SHAPE, (0.35, 0, 0), HEIGHT, BROWN)],
    }
    for expected, prisms in cases.items():
        with pytest.raises(expected) as raised:
            detect(prisms)
        assert raised.value.picture.shape == (camera.height, camera.width, 3)
    frame = paint(camera, [piece])
    with pytest.raises(ImageError, match="depth image has 320x240 pixels; expected 640x480"):
        detect_object(frame.color, frame.depth[::2, ::2], camera)
    with pytest.raises(ImageError, match=r"expected 0\.05 to 20 m"):
        detect_object(frame.color, 1000 * frame.depth, camera)
    rng = np.random.default_rng(0)
    with pytest.raises(NoTableError):
        detect_object(
            frame.color, rng.uniform(0.3, 3.0, frame.depth.shape).astype(np.float32), camera
        )
    with pytest.raises(NoTableError, match="shifted by"):
        detect_object(frame.color, frame.depth, camera.with_pose(make_camera(distance=0.9).X_WC))
    for height in (-0.01, 0.8, 30.0, np.inf):
        with pytest.raises(
            PerceptionError, match=r"height is .*; expected 0 to 0\.7 m, where the camera is"
        ):
            detect_object(frame.color, None, camera, DetectorOptions(height=height))
    for above, rpy in ((0.7, (0, 0, 0)), (-0.7, (180, 0, 0))):
        with pytest.raises(NoTableError, match="looks past the table; expected X_WC"):
            detect_object(
                frame.color, None, camera.with_pose(make_camera(distance=above, rpy=rpy).X_WC)
            )
    with pytest.raises(NoTableError, match="no even color"):
        detect_object(rng.integers(0, 255, frame.color.shape, dtype=np.uint8), None, camera)


def test_image_files(tmp_path):
    camera = make_camera()
    frame = paint(camera, [(L_SHAPE, POSE, HEIGHT, BROWN)])
    millimeters = (1000 * frame.depth).round().astype(np.uint16)
    cv2.imwrite(str(tmp_path / "color.png"), frame.color[..., ::-1])
    cv2.imwrite(str(tmp_path / "depth.png"), millimeters)
    np.testing.assert_array_equal(read_color(tmp_path / "color.png", camera), frame.color)
    np.testing.assert_allclose(read_depth(tmp_path / "depth.png", camera), frame.depth, atol=6e-4)
    cv2.imwrite(str(tmp_path / "meters.png"), (10 * frame.depth).astype(np.uint16))
    cv2.imwrite(str(tmp_path / "small.png"), millimeters[::2])
    (tmp_path / "text.png").write_text("no image")
    for read, name, message in [
        (read_color, "text.png", "is no image"),
        (read_color, "absent.png", "cannot be read"),
        (read_depth, "color.png", "has 3 channels of uint8"),
        (read_depth, "small.png", "has 640x240 pixels"),
        (read_depth, "meters.png", "expected mm, 50 to 20000"),
    ]:
        with pytest.raises(PerceptionError, match=message) as raised:
            read(tmp_path / name, camera)
        assert name in str(raised.value)


@pytest.mark.slow
def test_real_photographs():
    camera = Camera(640, 480, [[615, 0, 320], [0, 615, 240], [0, 0, 1]], [])
    scores = {}
    for name in NAMES:
        color = read_color(shared_data("rgbd", f"{name}_color.png"), camera)
        depth = read_depth(shared_data("rgbd", f"{name}_depth.png"), camera)
        true = cv2.imread(str(shared_data("masks", f"{name}_label.pgm")), cv2.IMREAD_UNCHANGED) > 0
        mask = detect_object(color, depth, camera).mask
        scores[name] = (mask & true).sum() / (mask | true).sum()
    assert min(scores.values()) >= 0.90, scores
    assert np.mean(list(scores.values())) >= 0.93, scores


@pytest.mark.parametrize(
    ("strip", "edge"), [((-60, 7, 3), 54), ((-60, 0, 0), 54), ((-12, 0, 0), 50)]
)
def test_a_side_in_the_dark_is_object_and_a_shadow_is_table(strip, edge):
    """Four rows below a brown top: too dark for a shadow, or a shadow."""
    difference = np.zeros((90, 120, 3), np.float32)
    difference[20:50, 20:100], difference[50:54, 20:100] = (-30, 22, 25), strip
    top = np.zeros((90, 120), dtype=bool)
    top[20:50, 20:100] = True
    found = Foreground(
        top, np.where(top, 5, -3).astype(np.float32), difference, np.ones(3), 0 * difference[..., 0]
    )
    _, coverage = refine_boundary(top, found)
    assert 20 + coverage[10:80, 60].sum() == pytest.approx(edge, abs=0.4)


def test_a_hole_through_which_the_table_is_plainly_seen_stays():
    mask = np.ones((60, 60), dtype=bool)
    mask[0], mask[10:15, 10:15], mask[30:35, 30:35], mask[50:53, 50:53] = False, False, False, False
    score = np.where(mask, 5.0, -3.0)
    score[30:35, 30:35] = 0.0
    filled = fill_holes(mask, score)
    assert not filled[10:15, 10:15].any(), "a hole"
    assert filled[30:35, 30:35].all(), "of the table's color, but not plainly"
    assert filled[50:53, 50:53].all(), "a speck"


@pytest.mark.parametrize("rows", [5, 6, 12])
def test_a_small_hole_is_drawn_as_wide_as_it_is(rows):
    """As of a wrench's ring from 1 m: what smoothing leaves of it is a third of it."""
    color = np.full((120, 160, 3), (205, 175, 130), np.uint8)
    color[40:80, 30:130] = (110, 35, 30)
    color[60 : 60 + rows, 60:72] = (205, 175, 130)
    rng = np.random.default_rng(0)
    found = find_foreground(
        (color + 2 * rng.standard_normal(color.shape)).clip(0, 255).astype(np.uint8), None, "color"
    )
    mask, coverage = refine_boundary(found.mask, found)
    hole = np.zeros_like(mask)
    hole[60 : 60 + rows, 60:72] = True
    assert (mask[45:75, 40:120] == ~hole[45:75, 40:120]).mean() > 0.99
    assert (1 - coverage[50:78, 50:82]).sum() == pytest.approx(12 * rows, rel=0.1)
