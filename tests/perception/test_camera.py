from pathlib import Path

import numpy as np
import pytest
from pydrake.geometry import (
    ClippingRange,
    ColorRenderCamera,
    GeometryInstance,
    MakeRenderEngineVtk,
    PerceptionProperties,
    RenderCameraCore,
    RenderEngineVtkParams,
    RenderLabel,
    SceneGraph,
    Sphere,
)
from pydrake.math import RigidTransform
from pydrake.systems.sensors import CameraInfo
from scipy.spatial.transform import Rotation

from gridpush_drake.errors import CameraError, ImageError
from gridpush_drake.perception import Camera
from tests.helpers.renderer import require_renderer

DISTORTION = [0.08, -0.05, 0.001, -0.0005, 0.01]


def make_camera(distortion=()):
    X_WC = np.eye(4)
    X_WC[:3, :3] = Rotation.from_euler("xyz", [172, 5, 30], degrees=True).as_matrix()
    X_WC[:3, 3] = [0.4, -0.1, 0.7]
    return Camera(640, 480, [[610.0, 0, 321.5], [0, 612.0, 238.0], [0, 0, 1]], distortion, X_WC)


ROS = """
image_width: 640
image_height: 480
camera_name: overhead
camera_matrix: {rows: 3, cols: 3, data: [600, 0, 320, 0, 601, 240, 0, 0, 1]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [0.1, 0, 0, 0, 0]}
rectification_matrix: {rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}
"""

MESSAGE = """
header: {seq: 1, frame_id: camera}
height: 480
width: 640
distortion_model: "plumb_bob"
D: [0.1, 0, 0, 0, 0]
K: [600, 0, 320, 0, 601, 240, 0, 0, 1]
"""

OPENCV = """%YAML:1.0
---
image_width: 640
image_height: 480
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 600., 0., 320., 0., 601., 240., 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ 1.0e-01, 0., 0., 0., 0. ]
"""

DRAKE = """
width: 800
height: 600
focal: !FovDegrees {y: 60}
renderer_class: !RenderEngineVtkParams {}
X_PB:
  translation: [0.1, 0.2, 0.7]
  rotation: !Rpy {deg: [180, 0, 90]}
"""


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "camera.yaml"
    path.write_text(text)
    return path


@pytest.mark.parametrize("distortion", [(), DISTORTION])
def test_casting_inverts_projecting_on_any_plane(distortion):
    camera = make_camera(distortion)
    rng = np.random.default_rng(1)
    p_W = np.column_stack([rng.uniform(-0.2, 0.2, (50, 2)) + [0.4, -0.1], rng.uniform(0, 0.1, 50)])
    pixels = camera.project(p_W)
    assert np.ptp(pixels[:, 0]) > 100
    np.testing.assert_allclose(camera.cast(pixels, p_W[:, 2]), p_W[:, :2], atol=1e-7)
    assert camera.project(p_W.reshape(5, 10, 3)).shape == (5, 10, 2)


def test_what_is_behind_or_above_is_not_seen():
    camera = make_camera(DISTORTION)
    assert np.isnan(camera.project([0.4, -0.1, 1.0])).all()
    assert np.isnan(camera.cast([320, 240], 1.0)).all()


def test_undistorted_image_shows_each_point_where_the_ideal_camera_would():
    camera = make_camera(DISTORTION)
    at = np.array([0.31, -0.02, 0.0])
    rows, columns = np.mgrid[0:480, 0:640]
    x, y = camera.project(at)
    blob = 255 * np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / (2 * 3.0**2))
    image = camera.undistort(blob.astype(np.uint8)).astype(float)
    found = np.array([(image * columns).sum(), (image * rows).sum()]) / image.sum()
    np.testing.assert_allclose(found, camera.undistorted.project(at), atol=0.1)
    assert np.linalg.norm(found - [x, y]) > 0.3
    with pytest.raises(ImageError, match="has 10x20 pixels; expected 640x480"):
        camera.undistort(np.zeros((20, 10), np.uint8))


@pytest.mark.parametrize("distortion", [DISTORTION, [0.1] * 8])
def test_a_written_camera_is_read_back_bit_for_bit(tmp_path, distortion):
    camera = make_camera(distortion)
    camera.write(tmp_path / "camera.yaml")
    back = Camera.read(tmp_path / "camera.yaml")
    for name in ("width", "height", "K", "distortion", "X_WC"):
        np.testing.assert_array_equal(getattr(back, name), getattr(camera, name))


@pytest.mark.parametrize("text", [ROS, MESSAGE, OPENCV], ids=["ros", "message", "opencv"])
def test_files_of_ros_and_opencv(tmp_path, text):
    camera = Camera.read(write(tmp_path, text))
    assert (camera.width, camera.height) == (640, 480)
    np.testing.assert_array_equal(camera.K, [[600, 0, 320], [0, 601, 240], [0, 0, 1]])
    np.testing.assert_array_equal(camera.distortion, [0.1, 0, 0, 0, 0])
    assert camera.X_WC is None
    with pytest.raises(CameraError, match="X_WC is not known"):
        camera.cast([0, 0])


def test_drakes_camera_config(tmp_path):
    camera = Camera.read(write(tmp_path, DRAKE))
    np.testing.assert_allclose(
        camera.K, [[519.615, 0, 399], [0, 519.615, 299], [0, 0, 1]], atol=1e-3
    )
    np.testing.assert_allclose(camera.cast([399, 299]), [0.1, 0.2], atol=1e-12)
    np.testing.assert_allclose(camera.X_WC[:3, 0], [0, 1, 0], atol=1e-12)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (ROS.replace("distortion_coefficients", "#"), "distortion_coefficients is missing"),
        (ROS.replace("plumb_bob", "equidistant"), "distortion_model is 'equidistant'"),
        (ROS.replace("data: [0.1, 0, 0, 0, 0]", "data: [0.1, 0]"), "distortion has 2 coefficients"),
        (ROS.replace("0, 601", "601"), "camera_matrix has 8 numbers"),
        (ROS.replace("[600", "[-600"), "fx and fy positive"),
        (ROS.replace("[600", "[0.6"), "fx is 0.6 pixels"),
        (ROS.replace("image_width: 640", ""), "image_width is missing"),
        (ROS + "X_WC: [[2,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]", "X_WC is no rigid transform"),
        (DRAKE.replace("{y: 60}", "{y: 200}"), "focal.y is 200.0; expected degrees"),
        (DRAKE.replace("!Rpy", "!Uniform"), "X_PB.rotation is"),
        (DRAKE + "  base_frame: gripper", "base_frame is world"),
        (ROS.replace("[600", "[1" + "0" * 320), "a number is too large"),
        (DRAKE.replace("width: 800", "width: 1" + "0" * 320), "a number is too large"),
        ("- 1", "expected a camera file"),
    ],
)
def test_a_bad_file_is_named_with_its_field(tmp_path, text, message):
    path = write(tmp_path, text)
    with pytest.raises(CameraError, match=message) as raised:
        Camera.read(path)
    assert str(path) in str(raised.value)


def test_drakes_renderer_shows_a_point_where_the_camera_of_the_same_config_would(tmp_path):
    require_renderer()
    camera = Camera.read(write(tmp_path, DRAKE))
    at = np.array([0.16, 0.11, 0.05])
    scene = SceneGraph()
    source = scene.RegisterSource("point")
    scene.AddRenderer("vtk", MakeRenderEngineVtk(RenderEngineVtkParams()))
    properties = PerceptionProperties()
    properties.AddProperty("label", "id", RenderLabel(1))
    point = GeometryInstance(RigidTransform(at), Sphere(0.01), "point")
    point.set_perception_properties(properties)
    scene.RegisterAnchoredGeometry(source, point)
    info = CameraInfo(800, 600, np.radians(60))
    core = RenderCameraCore("vtk", info, ClippingRange(0.01, 5), RigidTransform())
    query = scene.get_query_output_port().Eval(scene.CreateDefaultContext())
    X_WC = RigidTransform(camera.X_WC)
    image = query.RenderLabelImage(ColorRenderCamera(core, False), scene.world_frame_id(), X_WC)
    rows, columns = np.nonzero(image.data[..., 0] == 1)
    assert len(rows) > 100
    np.testing.assert_allclose([columns.mean(), rows.mean()], camera.project(at), atol=0.2)
