"""The color and depth camera of the station: where things are in its pictures; what the robot makes of the first."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely
from pydrake.systems.analysis import Simulator
from scipy import ndimage
from scipy.spatial import KDTree

from gridpush_drake.errors import ScenarioError, StationError
from gridpush_drake.geometry.se2 import wrap_angle
from gridpush_drake.identification.model import Model
from gridpush_drake.multibody.ground_truth import (
    SetGridObjectPose,
    resample_parameters,
    sample_ground_truth,
)
from gridpush_drake.multibody.parser import find_models
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import find_shipped_object
from gridpush_drake.perception import Camera
from gridpush_drake.pushes.segmentation import RecordOptions, SegmenterOptions
from gridpush_drake.pushes.stream import record_pushes
from gridpush_drake.station.scene import camera as station_camera
from gridpush_drake.station.scene.camera import calc_pose_age, make_camera
from gridpush_drake.station.scene.resolve import resolve
from gridpush_drake.station.schema.camera_config import CameraConfig
from gridpush_drake.station.schema.scenario import PushScenario
from gridpush_drake.station.schema.scenario_file import (
    format_scenario,
    parse_scenario,
    read_scenario,
)
from gridpush_drake.station.simulated.push_station import MakePushStation
from gridpush_drake.station.tasks.identify_task import IdentifyTask
from gridpush_drake.station.tasks.task import TaskStatus
from tests.helpers.renderer import require_renderer
from tests.helpers.shapes import make_shape


def make_scenario(name="claw_hammer"):
    scenario = read_scenario(find_models() / "scenarios/grasp.yaml")
    scenario.object, scenario.camera.kind, scenario.camera.rate = name, "rgbd", 10.0
    return scenario


@pytest.fixture(scope="module")
def renderer():
    """Skips where nothing can be rendered."""
    require_renderer()


@pytest.fixture(scope="module")
def photograph(renderer):
    """The hammer, found; and the labels as they were rendered."""
    taken = []
    take = station_camera._take_photograph

    def keep(*args):
        camera, detector, root = take(*args)
        images = (
            camera.noise.GetOutputPort("color_image"),
            camera.noise.GetOutputPort("depth_image"),
        )
        ports = (*images, camera.sensor.label_image_output_port())
        color, depth, labels = (
            port.Eval(port.get_system().GetMyContextFromRoot(root)).data.copy() for port in ports
        )
        taken.append(
            (color[..., :3], depth[..., 0], labels[..., 0], camera, int(args[3].part.body_index))
        )
        return camera, detector, root

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(station_camera, "_take_photograph", keep)
        scenario = make_scenario()
        resolved = resolve(scenario)
        found = resolved.found
        assert resolved.found is found and len(taken) == 1  # it is taken once
        return scenario, resolved.obj, found, taken[0]


@pytest.mark.slow
def test_the_camera_is_where_the_pictures_are_taken_from(photograph):
    """The pixels of the object lie about where the camera says: to a tenth of a pixel, taken together."""
    scenario, true_obj, _, (_, depth, labels, camera, body) = photograph
    mask = labels == body
    rows, columns = np.nonzero(mask)
    x, y, _ = scenario.object_pose
    samples = np.array(
        [[x0, y0] for x0 in np.linspace(-0.2, 0.2, 401) for y0 in np.linspace(-0.1, 0.1, 201)]
    )
    inside = shapely.contains_xy(true_obj.outline, samples[:, 0], samples[:, 1])
    top = np.column_stack([samples[inside] + (x, y), np.full(inside.sum(), scenario.object_height)])
    pixels = np.unique(np.round(camera.camera.project(top)).astype(int), axis=0)
    seen = mask[pixels[:, 1], pixels[:, 0]]
    assert seen.mean() > 0.985, "what is on top of the object is seen as the object"
    shifts = [
        (mask[pixels[:, 1] + dy, pixels[:, 0] + dx].mean(), (dx, dy))
        for dx in (-1, 0, 1)
        for dy in (-1, 0)
    ]
    assert max(shifts)[1] == (0, 0), (
        "one pixel up or aside would be worse; below it the sides are seen"
    )
    distance = np.linalg.norm(camera.camera.center - (x, y, scenario.object_height))
    assert np.median(depth[rows, columns]) == pytest.approx(distance, rel=0.05)


def test_the_robot_finds_the_object_that_lies_there(photograph):
    scenario, true_obj, found, _ = photograph
    seen, true = found.obj.outline, found.true_obj.outline
    assert seen.intersection(true).area / seen.union(true).area > 0.95
    assert seen.area == pytest.approx(true.area, rel=0.02)
    assert found.obj.height == pytest.approx(scenario.object_height, abs=0.001)
    prior = replace(true_obj.prior, uniform_parts=True)  # for handle and head differ in color
    assert found.obj.prior == prior and found.obj.name == true_obj.name
    true_labels = found.true_obj.labels[KDTree(found.true_obj.p_BC).query(found.obj.p_BC)[1]]
    largest = np.argmax(np.bincount(true_labels))
    assert ((found.obj.labels == 1) == (true_labels == largest)).mean() > 0.95
    assert found.pose[2] == scenario.object_pose[2]
    shift = true_obj.p_BC - found.true_obj.p_BC
    np.testing.assert_allclose(
        shift, np.tile(found.pose[:2] - scenario.object_pose[:2], (true_obj.n, 1)), atol=1e-12
    )
    assert found.detected.picture.shape == (480, 640, 3)


@pytest.mark.parametrize("name", ["claw_hammer", "pliers", "toolbox"])
def test_an_outline_is_divided_among_the_parts_of_its_cells(name):
    obj = GridObject.from_yaml(find_shipped_object(name)).place((0.1, 0.2, 0.3))
    areas = station_camera.divide_outline(obj)
    assert shapely.union_all(areas, grid_size=1e-9).area == pytest.approx(obj.outline.area)
    assert sum(area.area for area in areas) == pytest.approx(obj.outline.area)
    labels, counts = np.unique(obj.labels, return_counts=True)
    for label, area in zip(labels[np.argsort(-counts)], areas, strict=True):
        own = obj.labels == label
        inside = shapely.contains_xy(area.buffer(obj.cell_size / 2), *obj.p_BC.T)
        assert inside[own].all() and inside[~own].mean() < 0.3
    alone = replace(obj, labels=np.ones(obj.n, dtype=int))
    assert station_camera.divide_outline(alone) == [obj.outline]


@pytest.mark.slow
def test_the_arm_goes_out_of_the_way_also_where_it_hides_the_object_from_its_home(renderer):
    """The hammer's handle, over the table's edge, lies behind the arm at its home."""
    pose = (0.53, 0.16, -0.6)
    station = MakePushStation(make_scenario())
    simulator = Simulator(station)
    context = simulator.get_mutable_context()
    for name in ("push_command", "grasp_command"):
        station.GetInputPort(name).FixValue(context, np.zeros(6))
    station.SetStart(context)
    plant_context = station.plant.GetMyMutableContextFromRoot(context)
    SetGridObjectPose(station.plant, plant_context, station.object_in_plant, pose)
    seen = []
    for time in np.arange(0.5, 9.0, 0.5):
        simulator.AdvanceTo(time)
        seen.append(station.GetOutputPort("object.pose").Eval(context))
    assert np.isnan(seen[1]).all()
    off = np.array(seen[-3:]) - pose
    np.testing.assert_allclose(
        np.column_stack([off[:, :2], wrap_angle(off[:, 2])]), 0.0, atol=0.003
    )


def test_depth_has_holes_along_the_object_s_edge(photograph):
    *_, (_, depth, labels, _, body) = photograph
    mask = labels == body
    inner = ndimage.binary_erosion(mask, iterations=3)
    edge = mask & ~ndimage.binary_erosion(mask)
    assert (depth[inner] > 0).mean() > 0.9
    assert (depth[edge] == 0).mean() > 0.3


def test_what_is_out_of_view_is_said(renderer):
    scenario = make_scenario()
    scenario.camera.rgbd.X_PB.translation = [0.6, -1.8, 1.0]
    with pytest.raises(ScenarioError, match="camera: no object"):
        resolve(scenario).found  # noqa: B018 - the photograph is taken when it is asked for
    scenario.camera.rgbd.X_PB.base_frame = "iiwa::iiwa_link_7"
    with pytest.raises(ScenarioError, match=r"camera\.rgbd: X_PB: expected .* world"):
        make_camera(scenario.camera)


def test_the_scenario_s_camera_is_the_file_s(tmp_path):
    """`gridpush object --camera` takes what a scenario has, and the renderer's camera sees the same."""
    scenario = make_scenario()
    path = tmp_path / "camera.yaml"
    path.write_text(
        "{width: 320, height: 240, focal: !FocalLength {x: 400, y: 410}, center_x: 150.5, center_y: 130, "
        "X_PB: {translation: [0.5, -0.1, 0.9], rotation: !Rpy {deg: [180, 10, 30]}}}"
    )
    scenario = parse_scenario(path, f"camera: {{kind: rgbd, rgbd: {path.read_text()}}}")
    scenario = parse_scenario(path, format_scenario(scenario))
    seen, read = make_camera(scenario.camera), Camera.read(path)
    for name in ("K", "X_WC", "width", "height"):
        np.testing.assert_array_equal(getattr(seen, name), getattr(read, name))
    intrinsics = scenario.camera.rgbd.MakeCameras()[1].core().intrinsics()
    np.testing.assert_allclose(
        intrinsics.intrinsic_matrix()[:2], read.K[:2] + [[0, 0, 0.5], [0, 0, 0.5]]
    )
    X_WC = scenario.camera.rgbd.X_PB.GetDeterministicValue().GetAsMatrix4()
    np.testing.assert_allclose(X_WC, read.X_WC, atol=1e-12)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("fov_y: 0.7", r"camera\.rgbd\.fov_y: is Drake's focal now"),
        ("target: [0, 0, 0]", r"camera\.rgbd\.target: is Drake's X_PB now"),
        ("latency: 0.1", r"camera\.rgbd\.latency: is Drake's output_delay now"),
        (
            "depth_noise: 0.1",
            r"camera\.rgbd\.depth_noise: stands above now; expected camera\.depth_noise",
        ),
        ("fps: 10", r"camera\.rgbd\.fps: is not read here; camera\.rate"),
        ("widht: 10", r"camera\.rgbd\.widht: unknown key; did you mean width\?"),
        ("X_PB: {translatoin: [0, 0, 1]}", r"camera\.rgbd\.X_PB\.translatoin: unknown key"),
        ("lcm_bus: a", r"camera\.rgbd\.lcm_bus: says nothing here"),
        ("width: 10", r"camera\.rgbd\.width is 10; expected 64"),
        ("width: abc", r"camera\.rgbd: .*abc"),
        ("z_near: 7", r"camera\.rgbd: "),
        ("output_delay: -1", r"camera\.rgbd"),
        ("focal: !FovDegrees {y: 0}", r"camera\.rgbd: "),
    ],
)
def test_what_no_camera_can_be_is_refused(text, message):
    with pytest.raises(ScenarioError, match=message):
        parse_scenario(Path("scenario.yaml"), f"camera: {{rgbd: {{{text}}}}}")
    with pytest.raises(ScenarioError, match=r"camera\.rgbd is 3; expected `key: value` lines"):
        parse_scenario(Path("scenario.yaml"), "camera: {rgbd: 3}")


@pytest.mark.slow
def test_a_push_is_tracked_and_learned_from_by_the_camera_alone(renderer):
    """The poses are the true ones to a millimeter, within what the tracker states; so is the log's last one."""
    scenario = PushScenario(object="open_book")
    scenario.camera.kind, scenario.camera.rate = "rgbd", 10.0
    scenario.pokes.count, scenario.pokes.test_count, scenario.pokes.speed = 1, 0, 0.06
    task = IdentifyTask(scenario)
    record = task.run()
    assert (
        record.status == TaskStatus.FINISHED and len(record.log) == 1 and len(record.estimates) == 1
    )
    view = record.camera_view
    assert view.seen.mean() > 0.9
    position, angle = view.calc_rms()
    assert position < 1e-3 and angle < np.radians(0.5)
    assert (np.abs(view.errors[view.seen]) < 4 * view.std[view.seen] + 1e-9).mean() > 0.99
    # the camera is told of pushes, for when the arm hides the object
    camera = task.station.GetSubsystemByName("camera")
    context = camera.GetMyContextFromRoot(task.simulator.get_context())
    for name in ("pusher_state", "mass", "friction", "contact_friction"):
        assert camera.GetInputPort(name).HasValue(context)
    off = record.log[0].final_pose - task.read("object.pose_true")
    assert np.linalg.norm(off[:2]) < 1e-3
    assert record.obj is task.station.found.obj and record.truth.n == record.obj.n
    again = record_pushes(
        record.stream, record.obj, record.obj.prior.pusher_radius, SegmenterOptions(engaged_below=record.obj.height),
        RecordOptions(pose_delay=0.1),
    ).log  # fmt: skip
    np.testing.assert_array_equal(again[0].poses_observed, record.log[0].poses_observed)


def test_where_nothing_can_be_rendered_it_says_what_is_missing(monkeypatch):
    def refuse(name):
        raise OSError

    monkeypatch.setattr(station_camera.ctypes, "CDLL", refuse)
    scenario = make_scenario()
    with pytest.raises(StationError, match="libegl1"):
        resolve(scenario).found  # noqa: B018 - the photograph is taken when it is asked for


@pytest.mark.parametrize(("latency", "age"), [(0.0, 0.1), (0.05, 0.1), (0.1, 0.1), (0.25, 0.3)])
def test_how_old_a_pose_is(latency, age):
    config = CameraConfig(kind="rgbd", rate=10.0, rgbd={"output_delay": latency})
    assert calc_pose_age(config) == pytest.approx(age)
    assert calc_pose_age(CameraConfig(rate=10.0)) == pytest.approx(0.1)


@pytest.mark.parametrize("cells", [20, 90])
def test_the_truth_on_another_grid_keeps_mass_and_center(cells):
    obj = make_shape("claw_hammer", 60)
    truth = sample_ground_truth(obj, 3)
    other = GridObject.from_outline(obj.outline.buffer(0.0005), max_cells=cells)
    seen = resample_parameters(Model(obj, truth), other)
    assert seen.total_mass == pytest.approx(truth.total_mass)
    np.testing.assert_allclose(seen.center_of_mass(other), truth.center_of_mass(obj), atol=1e-9)
    assert (
        seen.friction.min() >= truth.friction.min() and seen.friction.max() <= truth.friction.max()
    )
    assert resample_parameters(Model(obj, truth), obj) is truth
