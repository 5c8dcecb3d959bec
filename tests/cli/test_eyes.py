"""`gridpush object`, `calibrate` and `track`, from image files to an object file and a push log."""

import json
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from shapely import Polygon

from gridpush_drake.geometry.se2 import compose, transform
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import read_object_file
from gridpush_drake.perception import SHEET_SIZES, Camera, TagBoard
from gridpush_drake.perception.calibration.sheet import list_corners
from gridpush_drake.pushes.push_log import PushLog
from tests.helpers.command_line import run_gridpush
from tests.helpers.pictures import calc_outline_error, cover, make_camera, paint, paint_tag

L_SHAPE = np.array([[0, 0], [0.14, 0], [0.14, 0.04], [0.05, 0.04], [0.05, 0.12], [0, 0.12]]) - [
    0.05,
    0.04,
]
POSE, HEIGHT, BROWN = np.array([0.02, 0.01, 0.3]), 0.03, (150, 120, 80)
BLOCK = L_SHAPE[1] + np.array([[0.0, -0.01], [0.05, -0.01], [0.05, 0.03], [0.0, 0.03]])
TAG_SIZE = 0.03
RADIUS = 0.005


@pytest.fixture
def folder(tmp_path):
    make_camera().write(tmp_path / "camera.yaml")
    frame = paint(make_camera(), [(L_SHAPE, POSE, HEIGHT, BROWN)])
    save(tmp_path / "photo.png", frame.color)
    cv2.imwrite(str(tmp_path / "depth.png"), (1000 * frame.depth).round().astype(np.uint16))
    return tmp_path


def save(path, color):
    cv2.imwrite(str(path), color[..., ::-1])


def square(pose, size, z):
    half = size / 2
    flat = transform(pose, np.array([[-half, half], [half, half], [half, -half], [-half, -half]]))
    return np.column_stack([flat, np.full(4, z)])


def test_object_from_a_photograph(capsys, folder):
    out = folder / "object.yaml"
    arguments = ("--depth", folder / "depth.png", "--camera", folder / "camera.yaml", "--out", out)
    done = run_gridpush(
        capsys,
        "object",
        folder / "photo.png",
        *arguments,
        "--picture",
        folder / "seen.png",
        "--json",
    )
    assert done.code == 0, done.err
    told = json.loads(done.out)
    obj, seen = GridObject.from_yaml(out), read_object_file(out).seen
    assert abs(obj.height - HEIGHT) < 0.0015
    assert obj.n == told["cells"]
    assert calc_outline_error(Polygon(transform(seen.pose, obj.outline.exterior.coords[:])), Polygon(
        transform(POSE, L_SHAPE))) < 6e-4  # fmt: skip
    np.testing.assert_allclose(make_camera().project([*seen.pose[:2], 0.0]), seen.pixel)
    assert cv2.imread(str(folder / "seen.png")).shape == (480, 640, 3)
    again = run_gridpush(capsys, "object", folder / "photo.png", *arguments)
    assert again.code == 2
    assert "exists already" in again.err


@pytest.mark.slow
def test_depth_of_another_photograph_is_doubted(capsys, folder):
    other = paint(make_camera(), [(L_SHAPE, POSE + (0.04, 0.02, 0.5), HEIGHT, BROWN)]).depth
    cv2.imwrite(str(folder / "other.png"), (1000 * other).round().astype(np.uint16))
    for name, doubted in (("depth.png", False), ("other.png", True)):
        arguments = (
            "--depth",
            folder / name,
            "--camera",
            folder / "camera.yaml",
            "--out",
            folder / "o.yaml",
            "--force",
        )
        done = run_gridpush(capsys, "object", folder / "photo.png", *arguments)
        assert done.code == 0, done.err
        assert ("color and depth contradict each other" in done.err) == doubted, done.err


@pytest.mark.slow
def test_a_tag_on_the_object_is_aligned_once_and_then_tells_its_pose(capsys, folder):
    t, tips, poses = make_push()
    X_BT = np.array([-0.02, 0.02, 0.4])
    (folder / "video").mkdir()
    for k, pose in enumerate(poses):
        color = paint(make_camera(), [(L_SHAPE, pose, HEIGHT, BROWN)], seed=k, depth=False).color
        color = paint_tag(color, make_camera(), 4, square(compose(pose, X_BT), TAG_SIZE, HEIGHT), k)
        save(folder / "video" / f"{k:03d}.png", color)
    write_times(folder, t, tips)
    camera = ("--camera", folder / "camera.yaml")
    size = ("--height", HEIGHT, "--tag-size", TAG_SIZE)
    done = run_gridpush(
        capsys,
        "object",
        folder / "video" / "000.png",
        *camera,
        "--out",
        folder / "o.yaml",
        "--tag",
        4,
        *size,
    )
    assert done.code == 0, done.err
    seen = read_object_file(folder / "o.yaml").seen
    assert seen.tag.id == 4
    tracked = (
        "track",
        folder / "video",
        *camera,
        "--object",
        folder / "o.yaml",
        "--tip",
        folder / "tip.csv",
    )
    done = run_gridpush(capsys, *tracked, "--by", "tag", "--out", folder / "pushes.csv")
    assert done.code == 0, done.err
    (push,) = PushLog.read_csv(folder / "pushes.csv")
    np.testing.assert_allclose(push.pose, seen.pose, atol=3e-4)
    moved = push.final_pose - push.pose
    assert np.hypot(*(moved - (poses[-1] - poses[0]))[:2]) < 3e-4
    assert abs(moved[2]) < np.radians(0.3)
    absent = run_gridpush(
        capsys,
        "object",
        folder / "photo.png",
        *camera,
        "--out",
        folder / "p.yaml",
        "--tag",
        5,
        *size,
    )
    assert absent.code == 2
    assert "tag 5 is not in view; the tags in view are: none" in absent.err


def test_object_says_what_is_wrong_and_shows_it(capsys, folder):
    save(folder / "empty.png", paint(make_camera(), []).color)
    save(folder / "cut.png", paint(make_camera(), [(L_SHAPE, (0.36, 0, 0), HEIGHT, BROWN)]).color)
    save(folder / "small.png", np.zeros((100, 100, 3), np.uint8))
    Camera(640, 480, make_camera().K, []).write(folder / "unplaced.yaml")
    cases = [
        (("empty.png", "camera.yaml"), "no object is in view"),
        (("cut.png", "camera.yaml"), "the object touches the picture's border"),
        (("small.png", "camera.yaml"), "has 100x100 pixels; expected 640x480"),
        (("photo.png", "unplaced.yaml"), "X_WC is not known and there is no depth image"),
        (("absent.png", "camera.yaml"), "cannot be read"),
        (("photo.png", "photo.png"), "is not UTF-8 text"),
    ]
    for read in ("photo.png", "camera.yaml", "depth.png"):
        files = ("--camera", folder / "camera.yaml", "--depth", folder / "depth.png")
        done = run_gridpush(
            capsys, "object", folder / "photo.png", *files, "--out", folder / read, "--force"
        )
        assert done.code == 2
        assert f"{read}: is also read by this command" in done.err
    for (photo, camera), message in cases:
        done = run_gridpush(
            capsys, "object", folder / photo, "--camera", folder / camera, "--out", folder / "o.yaml", "--picture",
            folder / f"{photo}_seen.png",
        )  # fmt: skip
        assert done.code == 2
        assert message in done.err
        assert photo in done.err or camera in done.err
        assert not (folder / "o.yaml").exists()
    assert (folder / "cut.png_seen.png").exists()


def test_calibrate_prints_a_board_and_finds_the_camera(capsys, tmp_path):
    board, true = TagBoard(3, 4, 0.04, 0.012), make_camera(distance=0.55, rpy=(176, 3, 20))
    done = run_gridpush(
        capsys, "calibrate", "--print", tmp_path / "board.pdf", "--board", "3x4:0.04", "--json"
    )
    assert done.code == 0, done.err
    assert json.loads(done.out) == {
        "extent": list(board.extent),
        "written": str(tmp_path / "board.pdf"),
    }
    assert (tmp_path / "board.pdf").read_bytes().startswith(b"%PDF")
    color = paint(true, [], depth=False).color
    for number, corners in board.corners.items():
        color = paint_tag(color, true, number, corners)
    save(tmp_path / "photo.png", color)
    Camera(640, 480, true.K, []).write(tmp_path / "plain.yaml")
    arguments = ("--camera", tmp_path / "plain.yaml", "--out", tmp_path / "camera.yaml")
    done = run_gridpush(
        capsys, "calibrate", tmp_path / "photo.png", "--board", "3x4:0.04", *arguments
    )
    assert done.code == 0, done.err
    np.testing.assert_allclose(Camera.read(tmp_path / "camera.yaml").center, true.center, atol=2e-3)
    for extra, message in [
        (
            (tmp_path / "photo.png", "--board", "3by4"),
            "--board: is '3by4'; expected COLUMNSxROWS:SIZE",
        ),
        (
            (tmp_path / "photo.png", "--board", "2x2:0.04:0.01:300"),
            "0 of the board's tags (300 to 303) are in view",
        ),
        ((), "expected either a photograph, or --intrinsics FOLDER, or --print BOARD.pdf"),
        (("--print", tmp_path / "board.png"), "board.png'; expected a PDF file's name"),
    ]:
        done = run_gridpush(capsys, "calibrate", *extra, *arguments, "--force")
        assert done.code == 2
        assert message in done.err


def make_push(count=18):
    """Times, tips and poses: the tip rests, pushes along x for 40 mm, and rests."""
    t = np.arange(count) * 0.2
    moved = np.clip((np.arange(count) - 4) / 7, 0, 1) * 0.04
    poses = POSE + np.column_stack([moved, 0 * moved, 0 * moved])
    x = transform(POSE, L_SHAPE)[:, 0].min() - RADIUS - 0.001
    tips = np.column_stack([x + moved, np.full(count, transform(POSE, [L_SHAPE[5]])[0, 1]) - 0.02])
    return t, tips, poses


def write_times(folder, t, tips):
    """Writes when each picture was taken, and where the tip was then."""
    lines = "".join(f"{k:03d},{time}\n" for k, time in enumerate(t))
    (folder / "video" / "times.csv").write_text("name,t\n" + lines)
    tip_lines = "".join(f"{time},{x},{y}\n" for time, (x, y) in zip(t, tips, strict=True))
    (folder / "tip.csv").write_text("t,tip_x,tip_y\n" + tip_lines)


@cache
def paint_push(with_tags, with_block):
    """The pictures of a push, each the bytes of a PNG file."""
    t, tips, poses = make_push()
    pictures = []
    for k in range(len(t)):
        prisms = [(L_SHAPE, poses[k], HEIGHT, BROWN)]
        if with_block:
            prisms.append((BLOCK, poses[k], HEIGHT, BROWN))
        color = paint(make_camera(), prisms, seed=k, depth=False).color
        if with_tags:
            color = paint_tag(
                color, make_camera(), 9, square([*tips[k] - [0.06, 0], 0], TAG_SIZE, 0.04), k
            )
        pictures.append(cv2.imencode(".png", color[..., ::-1])[1].tobytes())
    return pictures


def write_video(folder, with_tags, with_block=False):
    (folder / "video").mkdir()
    t, tips, poses = make_push()
    for k, picture in enumerate(paint_push(with_tags, with_block)):
        (folder / "video" / f"{k:03d}.png").write_bytes(picture)
    write_times(folder, t, tips)
    obj = GridObject.from_outline(L_SHAPE, max_cells=40, name="l_shape")
    GridObject("l_shape", *obj.grid, obj.prior, HEIGHT).write_yaml(folder / "object.yaml")
    return t, tips, poses


@pytest.mark.parametrize("with_tags", [False, True], ids=["csv", "tag"])
def test_track_writes_the_pushes_of_a_folder_of_images(capsys, folder, with_tags):
    _, tips, poses = write_video(folder, with_tags)
    by_tag = (
        "tag:9",
        "--tip-offset",
        "0.06,0,-0.035",
        "--tag-size",
        TAG_SIZE,
        "--tag-height",
        0.04,
    )
    tip = by_tag if with_tags else (folder / "tip.csv",)
    done = run_gridpush(
        capsys, "track", folder / "video", "--camera", folder / "camera.yaml", "--object", folder / "object.yaml",
        "--tip", *tip, "--out", folder / "pushes.csv", "--picture", folder / "seen.png", "--json",
    )  # fmt: skip
    assert done.code == 0, done.err
    told = json.loads(done.out)
    assert (told["pushes"], told["lost"]) == (1, 0)
    (push,) = PushLog.read_csv(folder / "pushes.csv")
    np.testing.assert_allclose(push.pose, poses[0], atol=1e-3)
    np.testing.assert_allclose(push.final_pose, poses[-1], atol=1e-3)
    np.testing.assert_allclose(push.push.xy[[0, -1]], tips[[0, -1]], atol=6e-4)
    assert cv2.imread(str(folder / "seen.png")).shape == (480, 640, 3)


@pytest.mark.slow
def test_track_tells_apart_what_is_beside_the_object(capsys, folder):
    """A block of the same color, which the object pushes along."""
    _, _, poses = write_video(folder, False, with_block=True)
    obj = GridObject.from_outline(BLOCK - BLOCK.mean(axis=0), max_cells=20, name="block")
    GridObject("block", *obj.grid, obj.prior, HEIGHT).write_yaml(folder / "block.yaml")

    def run(*more):
        return run_gridpush(
            capsys, "track", folder / "video", "--camera", folder / "camera.yaml", "--object",
            folder / "object.yaml", "--tip", folder / "tip.csv", "--out", folder / "pushes.csv", *more,
        )  # fmt: skip

    # an object that is not in view is named
    absent = run("--beside", folder / "block.yaml", "--beside", "toolbox")
    assert absent.code == 2
    assert "toolbox: not found; expected 3 objects in view" in absent.err
    done = run("--beside", folder / "block.yaml")
    assert done.code == 0, done.err
    (push,) = PushLog.read_csv(folder / "pushes.csv")
    np.testing.assert_allclose(push.pose, poses[0], atol=1e-3)
    np.testing.assert_allclose(push.final_pose, poses[-1], atol=1e-3)


def test_track_says_what_is_wrong(capsys, folder):
    write_video(folder, with_tags=False)
    (folder / "late.csv").write_text("t,tip_x,tip_y\n100,0,0\n101,0,0\n")
    (folder / "odd.csv").write_text("t,tip_x,tip_y\n1,0\n2,0,0\n")
    (folder / "nothing").mkdir()
    (folder / "text.mp4").write_text("no video")
    for video, tip, message in [
        ("video", "late.csv", "expected times that overlap"),
        ("video", "odd.csv", "line 2: is '1,0'"),
        ("video", "tag:5", "tag 5 is in no frame; the tags that are seen are: none"),
        ("video", "tag:x", "expected TIP.csv, or tag:ID"),
        ("video", "tag:²", "expected TIP.csv, or tag:ID"),
        ("nothing", "tip.csv", "holds no images"),
        ("text.mp4", "tip.csv", "no frame can be read"),
        ("absent.mp4", "tip.csv", "no such file"),
    ]:
        named = tip if tip.startswith("tag:") else folder / tip
        done = run_gridpush(
            capsys, "track", folder / video, "--camera", folder / "camera.yaml", "--object", folder / "object.yaml",
            "--tip", named, "--out", folder / "pushes.csv",
        )  # fmt: skip
        assert done.code == 2, video
        assert message in done.err
        assert not (folder / "pushes.csv").exists()


def test_track_names_the_file_or_option_that_is_wrong(capsys, folder):
    write_video(folder, with_tags=True)
    Camera(640, 480, make_camera().K, []).write(folder / "unplaced.yaml")
    (folder / "still.csv").write_text("t,tip_x,tip_y\n0,-0.3,0\n9,-0.3,0\n")
    for options, message in [
        (
            ("--camera", folder / "unplaced.yaml"),
            "unplaced.yaml: X_WC is not known; `gridpush calibrate` finds it",
        ),
        (("--object", "claw_hammer"), "video: no object of this outline is in view"),
        (("--height", "30"), "video: height is 30.0; expected 0 to 0.7 m, where the camera is"),
        (
            ("--tip", "tag:9", "--tag-height", "40"),
            "--tag-height: is 40; expected 0 to 0.7 m, where the camera is",
        ),
        (("--tip", "tag:9", "--tag-height", "nan"), "--tag-height: is nan; expected 0 to 0.7 m"),
        (
            ("--tip", folder / "still.csv"),
            "video: holds no whole push: the tip never moved the object while it was below 0.05 m; the object was seen",
        ),
    ]:
        given = {
            "--camera": folder / "camera.yaml",
            "--object": folder / "object.yaml",
            "--tip": folder / "tip.csv",
        }
        given |= dict(zip(options[::2], options[1::2], strict=True))
        words = [word for pair in given.items() for word in pair]
        done = run_gridpush(
            capsys, "track", folder / "video", *words, "--out", folder / "pushes.csv"
        )
        assert done.code == 2, options
        assert message in done.err


@pytest.mark.slow
def test_hints_of_where_the_object_is(capsys, folder):
    square = 0.03 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    aside = np.array([-0.16, 0.1, 0.2])
    camera = make_camera()
    frame = paint(camera, [(L_SHAPE, POSE, HEIGHT, BROWN), (square, aside, HEIGHT, (60, 90, 150))])
    save(folder / "two.png", frame.color)
    cv2.imwrite(
        str(folder / "mask.png"), (cover(camera, square, aside, HEIGHT) > 0.5).astype(np.uint8)
    )
    x, y = camera.project([*aside[:2], 0.0])

    def run(*options):
        given = ("--camera", folder / "camera.yaml", "--height", HEIGHT, "--force", "--json")
        return run_gridpush(
            capsys, "object", folder / "two.png", *given, "--out", folder / "o.yaml", *options
        )

    refused = run()
    assert refused.code == 2
    assert "2 objects are in view; expected one; --click X,Y, --box" in refused.err
    box = f"{x - 50:.0f},{y - 50:.0f},{x + 50:.0f},{y + 50:.0f}"
    for hint in (("--click", f"{x:.0f},{y:.0f}"), ("--box", box), ("--mask", folder / "mask.png")):
        done = run(*hint)
        assert done.code == 0, done.err
        assert json.loads(done.out)["area"] == pytest.approx(0.0036, rel=0.03)
    assert "--click: is '1'; expected x,y (pixels)" in run("--click", "1").err
    assert "--box: is '1,2,3,inf'" in run("--box", "1,2,3,inf").err
    both = run("--box", box, "--click", "1,2")
    assert both.code == 2 and "--box and --click: both are given" in both.err
    assert "none.png: cannot be read" in run("--mask", folder / "none.png").err


def test_object_beside_a_sheet_of_paper(capsys, tmp_path):
    """A phone's photograph is enough: nobody knows the camera, and there is no board of tags."""
    outline = np.array([[-0.05, -0.03], [0.05, -0.03], [0.05, 0.03], [-0.05, 0.03]])
    paper = list_corners(SHEET_SIZES["a4"])[:, :2], (-0.1, 0.02, 0.3), 0.0, (235, 233, 228)
    block = outline, (0.13, 0.02, 0.4), 0.02, (60, 90, 150)
    camera = make_camera(960, 720, 750.0, rpy=(210, 0, 0), at=(0.0, -0.35), distance=0.6)
    photo, out = tmp_path / "phone.png", tmp_path / "block.yaml"
    save(photo, paint(camera, [paper, block], table=(120, 100, 85), depth=False).color)
    told = ["object", photo, "--sheet", "a4", "--height", 0.02, "--out", out]
    done = run_gridpush(capsys, *told, "--picture", tmp_path / "seen.png", "--json")
    assert done.code == 0, done.err
    assert json.loads(done.out)["area"] == pytest.approx(0.006, rel=0.02)
    assert (tmp_path / "seen.png").exists()
    assert GridObject.from_yaml(out).height == 0.02

    def refuse(*words, says):
        refused = run_gridpush(capsys, "object", photo, *words, "--out", tmp_path / "no.yaml")
        assert (refused.code, refused.err.count("\n")) == (2, 1)
        for text in says:
            assert text in refused.err
        assert not (tmp_path / "no.yaml").exists()

    refuse(says=["--camera: missing", "--sheet a4"])
    refuse("--sheet", "a4", "--depth", photo, says=["--sheet and --depth"])
    refuse(
        "--sheet", "letter", says=["phone.png: no sheet of 279 x 216 mm", "may be a3 or a4 or a5"]
    )
    refuse("--sheet", "a6", says=["--sheet", "a6"])


def test_a_file_for_each_of_several_objects(capsys, folder):
    block = 0.03 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    hand = 0.02 * np.array([[-1, -7], [1, -7], [1, 7], [-1, 7]])
    aside = np.array([-0.16, 0.1, 0.2])
    frame = paint(
        make_camera(),
        [
            (L_SHAPE, POSE, HEIGHT, BROWN),
            (block, aside, HEIGHT, (60, 90, 150)),
            (hand, (0.2, 0.2, 0.0), 0.06, (200, 150, 120)),
        ],
    )
    save(folder / "three.png", frame.color)

    def run(*options):
        given = ("--camera", folder / "camera.yaml", "--height", HEIGHT, "--out", folder / "o.yaml")
        return run_gridpush(capsys, "object", folder / "three.png", "--all", *given, *options)

    done = run("--json", "--picture", folder / "all.png")
    assert done.code == 0, done.err
    assert "1 thing cut by the picture's border is left out" in done.err
    told = json.loads(done.out)
    assert told["cut"] == 1
    assert [Path(each["written"]).name for each in told["objects"]] == ["o_1.yaml", "o_2.yaml"]
    assert [each["object"] for each in told["objects"]] == ["three_1", "three_2"]
    assert told["objects"][0]["area"] == pytest.approx(0.0036, rel=0.03)
    elbow = GridObject.from_yaml(folder / "o_2.yaml")
    assert elbow.outline.area == pytest.approx(Polygon(L_SHAPE).area, rel=0.03)
    assert not (folder / "o.yaml").exists()
    assert cv2.imread(str(folder / "all.png")).shape == (480, 640, 3)
    # written whole or not at all
    (folder / "o_1.yaml").unlink()
    again = run()
    assert again.code == 2
    assert "o_2.yaml" in again.err and "exists already" in again.err
    assert not (folder / "o_1.yaml").exists()
    both = run("--click", "1,2", "--force")
    assert both.code == 2 and "--all and --click: both are given" in both.err
    alone = run_gridpush(
        capsys, "object", folder / "three.png", "--camera", folder / "camera.yaml", "--height", HEIGHT,
        "--out", folder / "o.yaml",
    )  # fmt: skip
    assert alone.code == 2 and "--all writes a file for each object" in alone.err
