"""A camera's intrinsics from photographs of a board, and what is said where they will not do."""

import cv2
import numpy as np
import pytest

from gridpush_drake.errors import TagError
from gridpush_drake.perception import Camera, TagBoard, calibrate_intrinsics
from tests.helpers.command_line import run_gridpush
from tests.helpers.pictures import make_camera
from tests.perception.test_tags import DISTORTION, photograph_board

BOARD = TagBoard(3, 4, 0.04, 0.012)
TILTS = [(180, 0, 0), (140, 0, 20), (215, 5, 0), (180, 38, 60), (175, -40, -30), (150, 25, 90)]


def take_photographs(tilts=TILTS, board=BOARD, distortion=DISTORTION):
    """The camera, and a photograph of the board from each side."""
    photographs = []
    for number, rpy in enumerate(tilts):
        axis = make_camera(rpy=rpy).X_WC[:3, 2]
        at = 0.5 * axis[:2] / axis[2]
        camera = make_camera(distance=0.5, rpy=rpy, at=at, distortion=distortion)
        photographs.append((f"photo_{number}", photograph_board(board, camera, number)))
    return camera, photographs


@pytest.fixture(scope="module")
def taken():
    return take_photographs()


def test_focal_lengths_center_and_distortion_are_found(taken):
    true, photographs = taken
    found = calibrate_intrinsics(photographs, BOARD)
    assert found.error < 0.3
    assert found.focal_deviation < 0.005
    assert found.used == tuple(name for name, _ in photographs)
    K = found.camera.K
    assert K[0, 0] == pytest.approx(true.K[0, 0], rel=0.005)
    assert K[1, 1] == pytest.approx(true.K[1, 1], rel=0.005)
    np.testing.assert_allclose(K[:2, 2], true.K[:2, 2], atol=4.0)
    # where it counts: the same ray comes to the same pixel all over the picture
    ahead = Camera(true.width, true.height, K, found.camera.distortion, np.eye(4))
    given = Camera(true.width, true.height, true.K, true.distortion, np.eye(4))
    points = np.array([[x, y, 1.0] for x in (-0.35, 0.0, 0.35) for y in (-0.25, 0.0, 0.25)])
    shift = ahead.project(points) - given.project(points)
    assert np.abs(shift - shift.mean(axis=0)).max() < 1.5


def test_the_command_writes_a_file_that_calibrate_takes(taken, tmp_path, capsys):
    _, photographs = taken
    folder = tmp_path / "shots"
    folder.mkdir()
    for name, color in photographs:
        cv2.imwrite(str(folder / f"{name}.png"), cv2.cvtColor(color, cv2.COLOR_RGB2BGR))
    blank = np.full_like(photographs[0][1], 200)
    cv2.imwrite(str(folder / "blank.png"), blank)
    out = tmp_path / "intrinsics.yaml"
    arguments = ["--board", "3x4:0.04:0.012", "--out", out]
    done = run_gridpush(capsys, "calibrate", "--intrinsics", folder, *arguments)
    assert done.code == 0, done.err
    assert "6 photographs" in done.out
    assert "blank.png; left out" in done.err
    placed = tmp_path / "camera.yaml"
    done = run_gridpush(
        capsys,
        "calibrate",
        folder / "photo_1.png",
        "--camera",
        out,
        "--out",
        placed,
        "--board",
        "3x4:0.04:0.012",
    )
    assert done.code == 0, done.err
    assert np.linalg.norm(Camera.read(placed).center) == pytest.approx(0.65, abs=0.15)


@pytest.mark.slow
def test_photographs_from_one_side_are_refused():
    _, photographs = take_photographs([(180, 0, turn) for turn in (0, 20, 40, 60, 80)])
    with pytest.raises(TagError, match=r"from sides at most .* degrees apart; expected 20"):
        calibrate_intrinsics(photographs, BOARD)


def test_what_is_wrong_is_said(taken, tmp_path, capsys):
    _, photographs = taken
    with pytest.raises(TagError, match=r"4 of 4 photographs show .*; expected 5"):
        calibrate_intrinsics(photographs[:4], BOARD)
    small = [*photographs[:5], ("small", photographs[0][1][::2, ::2])]
    with pytest.raises(TagError, match=r"small: is \d+ x \d+ pixels; expected"):
        calibrate_intrinsics(small, BOARD)
    with pytest.raises(TagError, match=r"corners are .* pixels from where the board would have"):
        calibrate_intrinsics(photographs, TagBoard(3, 4, 0.04, 0.03))
    for more, says in (
        ([tmp_path], "holds no photographs; expected a folder with at least 5"),
        ([tmp_path, "--print", "b.pdf"], "expected either a photograph, or --intrinsics"),
    ):
        out = ["--out", tmp_path / "out.yaml"]
        done = run_gridpush(capsys, "calibrate", "--intrinsics", *more, *out)
        assert done.code == 2
        assert says in done.err
    assert run_gridpush(capsys, "calibrate", "--intrinsics", tmp_path).code == 2
