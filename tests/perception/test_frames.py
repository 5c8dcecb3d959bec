import cv2
import numpy as np
import pytest

from gridpush_drake.errors import ImageError
from gridpush_drake.perception import read_frames
from tests.helpers.pictures import make_camera

CAMERA = make_camera(width=64, height=48)


def make_images(count):
    return [np.full((48, 64, 3), (10 * k, 100, 200 - 10 * k), np.uint8) for k in range(count)]


def write_folder(folder, times, depth=True):
    for k, image in enumerate(make_images(len(times))):
        cv2.imwrite(str(folder / f"{k}_color.png"), image[..., ::-1])
        if depth:
            cv2.imwrite(str(folder / f"{k}_depth.png"), np.full((48, 64), 700 + k, np.uint16))
    (folder / "times.csv").write_text(
        "name,t\n" + "".join(f"{k}_color.png,{t}\n" for k, t in enumerate(times))
    )


def test_a_folder_of_color_and_depth(tmp_path):
    write_folder(tmp_path, [0.5, 0.7, 1.1])
    frames = list(read_frames(tmp_path, CAMERA))
    assert [frame.t for frame in frames] == [0.5, 0.7, 1.1]
    for k, (frame, image) in enumerate(zip(frames, make_images(3), strict=True)):
        np.testing.assert_array_equal(frame.color, image)
        np.testing.assert_allclose(frame.depth, 0.7 + 0.001 * k, atol=1e-6)


def test_a_video(tmp_path):
    path = tmp_path / "video.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 20.0, (64, 48))
    for image in make_images(4):
        writer.write(np.ascontiguousarray(image[..., ::-1]))
    writer.release()
    frames = list(read_frames(path, CAMERA))
    np.testing.assert_allclose([frame.t for frame in frames], [0, 0.05, 0.1, 0.15])
    assert all(frame.depth is None for frame in frames)
    for frame, image in zip(frames, make_images(4), strict=True):
        np.testing.assert_allclose(frame.color.mean(axis=(0, 1)), image.mean(axis=(0, 1)), atol=6)


def test_bad_folders_and_videos_are_named(tmp_path):
    for name, times, message in [
        ("backwards", [0.0, 0.2, 0.1], r"2 is at 0\.1 s, not later than the image before it"),
        ("odd", [0.0, "soon"], r"line 3: is '1_color\.png,soon'"),
    ]:
        (tmp_path / name).mkdir()
        write_folder(tmp_path / name, times)
        with pytest.raises(ImageError, match=message) as raised:
            list(read_frames(tmp_path / name, CAMERA))
        assert name in str(raised.value)
    (tmp_path / "untimed").mkdir()
    write_folder(tmp_path / "untimed", [0.0, 0.1])
    (tmp_path / "untimed" / "times.csv").write_text("name,t\n0,0.0\n")
    with pytest.raises(ImageError, match="has no line for 1"):
        list(read_frames(tmp_path / "untimed", CAMERA))
    (tmp_path / "small").mkdir()
    write_folder(tmp_path / "small", [0.0])
    cv2.imwrite(str(tmp_path / "small" / "0_depth.png"), np.full((24, 64), 700, np.uint16))
    with pytest.raises(ImageError, match=r"0_depth\.png: the image has 64x24 pixels"):
        list(read_frames(tmp_path / "small", CAMERA))
