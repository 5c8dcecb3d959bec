import cv2
import numpy as np
import pytest

from gridpush_drake.errors import TagError
from gridpush_drake.geometry.se2 import compose
from gridpush_drake.perception import (
    TagBoard,
    calibrate_pose,
    detect_tags,
    find_tag_corners,
    solve_tag_to_body,
)
from tests.helpers.pictures import make_camera, paint, paint_tag

SIZE, HEIGHT = 0.03, 0.02
DISTORTION = [0.06, -0.04, 0.0005, -0.0004, 0.0]


def photograph_board(board, camera, seed=0):
    frame = paint(camera, [], seed=seed, depth=False)
    color = frame.color
    for number, corners in board.corners.items():
        color = paint_tag(color, camera, number, corners, seed)
    return color


def photograph_tag(camera, number, pose, seed=0):
    from gridpush_drake.geometry.se2 import transform

    half = SIZE / 2
    square = transform(pose, np.array([[-half, half], [half, half], [half, -half], [-half, -half]]))
    color = paint(camera, [], seed=seed, depth=False).color
    return paint_tag(color, camera, number, np.column_stack([square, np.full(4, HEIGHT)]), seed)


@pytest.mark.parametrize("distortion", [(), DISTORTION], ids=["ideal", "distorted"])
@pytest.mark.parametrize("rpy", [(180, 0, 0), (160, 12, 70)], ids=["straight", "tilted"])
def test_a_board_tells_where_the_camera_is(distortion, rpy):
    board = TagBoard()
    axis = make_camera(rpy=rpy).X_WC[:3, 2]
    true = make_camera(distance=0.55, rpy=rpy, at=0.55 * axis[:2] / axis[2], distortion=distortion)
    found, error = calibrate_pose(photograph_board(board, true), true.with_pose(np.eye(4)), board)
    assert error < 0.3
    assert np.linalg.norm(found.center - true.center) < 2e-3
    points = np.array([[0, 0, 0], [0.1, 0.1, 0], [-0.1, 0.05, 0.03]])
    np.testing.assert_allclose(found.project(points), true.project(points), atol=0.3)


def test_level_tags_are_placed_to_a_third_of_a_millimeter():
    camera, rng = make_camera(distance=0.6), np.random.default_rng(3)
    errors = []
    for k in range(12):
        pose = np.array([*rng.uniform(-0.15, 0.15, 2), rng.uniform(-np.pi, np.pi)])
        tag = detect_tags(photograph_tag(camera, 11, pose, k), camera, SIZE, HEIGHT)[11]
        off = tag.planar_pose - pose
        errors.append([*off[:2], (off[2] + np.pi) % (2 * np.pi) - np.pi])
    place = np.sqrt((np.array(errors)[:, :2] ** 2).sum(axis=1).mean())
    assert place < 3e-4
    assert np.sqrt((np.array(errors)[:, 2] ** 2).mean()) < np.radians(0.3)


def test_one_photograph_aligns_tag_and_body():
    camera = make_camera(distance=0.6)
    X_TB = np.array([0.01, -0.02, 0.7])
    before, after = np.array([0.05, 0.02, 0.4]), np.array([-0.1, 0.06, -2.0])
    tag = detect_tags(photograph_tag(camera, 3, before), camera, SIZE, HEIGHT)[3]
    solved = solve_tag_to_body(tag, compose(before, X_TB))
    np.testing.assert_allclose(solved, X_TB, atol=8e-3)
    later = detect_tags(photograph_tag(camera, 3, after), camera, SIZE, HEIGHT)[3]
    off = compose(later.planar_pose, solved) - compose(after, X_TB)
    assert np.hypot(*off[:2]) < 6e-4


def test_a_free_tag_has_a_pose_in_the_camera():
    camera = make_camera(distance=0.5)
    tag = detect_tags(photograph_tag(camera, 5, (0.0, 0.0, 0.5)), camera, SIZE)[5]
    np.testing.assert_allclose(tag.X_CT[:3, 3], [0, 0, 0.5 - HEIGHT], atol=3e-3)
    np.testing.assert_allclose(tag.X_WT, camera.X_WC @ tag.X_CT)


def test_the_printed_sheet_shows_the_board():
    from io import BytesIO

    pdf = TagBoard(2, 3, 0.05, 0.02, 7).make_pdf()
    assert pdf.startswith(b"%PDF")
    start = pdf.index(b"/MediaBox")
    box = [float(x) for x in pdf[pdf.index(b"[", start) + 1 : pdf.index(b"]", start)].split()]
    np.testing.assert_allclose(np.array(box[2:]) / 72 * 25.4, [120 + 40, 190 + 40], atol=1.0)
    image = pdf[pdf.index(b"stream") + 6 :].lstrip(b"\r\n")
    sheet = cv2.imdecode(np.frombuffer(BytesIO(image).read(), np.uint8), cv2.IMREAD_GRAYSCALE)
    corners = find_tag_corners(sheet)
    assert sorted(corners) == list(range(7, 13))
    side = np.linalg.norm(corners[7][1] - corners[7][0])
    pitch = np.linalg.norm(corners[8][0] - corners[7][0])
    assert abs(pitch / side - 0.07 / 0.05) < 0.01


def test_what_is_wrong_with_a_board_is_said():
    camera = make_camera()
    with pytest.raises(TagError, match=r"0 of the board's tags .* tags seen: none") as raised:
        calibrate_pose(paint(camera, []).color, camera, TagBoard())
    assert raised.value.picture.shape == (480, 640, 3)
    board = TagBoard()
    with pytest.raises(TagError, match="at least 2"):
        calibrate_pose(photograph_board(board, camera), camera, TagBoard(first=300))
    with pytest.raises(TagError, match="pixels from where the board would have them"):
        calibrate_pose(photograph_board(board, camera), camera, TagBoard(columns=5, rows=4))
    with pytest.raises(TagError, match=r"a board of 171\.5 x 217 m; expected at most 2 m a side"):
        TagBoard(size=35.0, gap=10.5)
    for wrong in (
        {"size": float("inf")},
        {"columns": 0},
        {"size": -1.0},
        {"first": 600},
        {"columns": 40, "rows": 40},
    ):
        with pytest.raises(TagError):
            TagBoard(**wrong)
