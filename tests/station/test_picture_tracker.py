import numpy as np
import pytest
import shapely
from drake import lcmt_iiwa_status
from pydrake.lcm import DrakeLcm

from gridpush_drake.geometry.se2 import transform
from gridpush_drake.station import IdentifyTask, PushScenario, TaskStatus
from gridpush_drake.station.hardware.picture_tracker import PictureTracker
from gridpush_drake.station.links.lcm.lcm_link import LcmLink
from gridpush_drake.station.links.lcm.lcm_messages import ARM_MESSAGES, PICTURES
from gridpush_drake.station.links.lcm.picture_messages import encode_frame
from gridpush_drake.station.links.link import LinkRole
from gridpush_drake.station.scene.camera import make_camera
from gridpush_drake.station.tasks.scene_task import SeparateTask
from tests.helpers.renderer import require_renderer
from tests.helpers.twin_bench import CameraBench


def make_scenario():
    scenario = PushScenario(object="claw_hammer", base="planar", object_pose=[0.6, -0.15, 0.5])
    scenario.pokes.count, scenario.pokes.test_count, scenario.pokes.speed = 1, 0, 0.08
    scenario.pokes.distance = [0.05, 0.05]
    scenario.camera.use("rgbd")
    return scenario


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    require_renderer()
    return CameraBench(make_scenario(), IdentifyTask, tmp_path_factory.mktemp("seen"))


def test_the_object_in_the_pictures_is_found_and_its_pose_said(bench):
    """The plant's object and the tracker's have frames of their own; in W they are the same."""
    obj, found = bench.tracker.obj, bench.tracker.detected
    bench.begin()
    bench.seen.clear()
    while len(bench.seen) < 3:
        bench.move()
    for _, true_pose, tracked in bench.seen:
        assert tracked.seen
        outlines = [
            shapely.transform(each.outline, lambda p, at=at: transform(at, p))
            for each, at in ((bench.twin.world.true_obj, true_pose), (obj, tracked.pose))
        ]
        assert outlines[0].symmetric_difference(outlines[1]).area < 0.05 * outlines[0].area
    assert found is not None
    assert abs(obj.height - make_scenario().object_height) < 0.004
    assert bench.tracker.report.left_out == {}
    assert bench.tracker.find_obstacle() == ""


@pytest.mark.slow
def test_a_task_over_lcm_sees_by_the_pictures_alone(bench):
    bench.begin()
    bench.seen.clear()
    record = bench.task.run(drive=bench.link)
    assert (record.status, len(record.log)) == (TaskStatus.FINISHED, 1), record.message
    assert record.limit_report.ok
    poses = np.array([tracked.pose for _, _, tracked in bench.seen if tracked.seen])
    true = np.array([pose for _, pose, tracked in bench.seen if tracked.seen])
    assert len(poses) > 0.9 * len(bench.seen)
    # how far, and by how much it turned, whatever the frames are
    moved, truly = poses - poses[0], true - true[0]
    assert np.hypot(*(moved - truly)[:, :2].T).max() < 0.001
    assert np.abs((moved - truly)[:, 2]).max() < np.radians(0.5)
    assert np.hypot(*truly[-1, :2]) > 0.02
    np.testing.assert_allclose(record.log[0].final_pose, poses[-1], atol=1e-3)


def make_status(utime, joints=7):
    message = lcmt_iiwa_status()
    message.utime, message.num_joints = utime, joints
    for name in lcmt_iiwa_status.__slots__[2:]:
        setattr(message, name, [0.0] * joints)
    return message.encode()


def test_what_is_missing_or_amiss_is_said(bench):
    lcm, arm = DrakeLcm("memq://"), ARM_MESSAGES["iiwa"]
    robot, camera = bench.twin.world.setting.robot, make_camera(make_scenario().camera)
    tracker = PictureTracker(make_scenario(), LcmLink(lcm, robot, LinkRole.TRACKER, camera=camera))
    assert tracker.step() is None
    assert tracker.find_obstacle() == f"no status of the robot on {arm.status}"
    for data in (b"nothing", make_status(0, joints=6), make_status(0)):
        lcm.Publish(arm.status, data)
        tracker.step()
    joints = "6 joints; expected 7, as the scenario's robot has"
    unread, other = tracker.report.left_out
    assert unread.startswith(f"{arm.status} is not lcmt_iiwa_status")
    assert other == f"{arm.status} speaks of {joints}"
    assert tracker.find_obstacle().startswith(f"no usable picture on {PICTURES}")
    positions = bench.twin.GetPositions(bench.simulator.get_context())
    picture = encode_frame(bench._camera.take(0.1, positions))
    whole = picture.encode()
    lcm.Publish(PICTURES, whole[: len(whole) // 2])
    assert tracker.step() is None
    picture.images[0].width //= 2
    picture.images[0].compression_method = 0
    lcm.Publish(PICTURES, picture.encode())
    assert tracker.step() is None
    assert any("is 320 x 480 pixels; expected 640 x 480" in why for why in tracker.report.left_out)
    lcm.Publish(PICTURES, whole)
    lcm.Publish(PICTURES, whole)
    tracker.step()
    assert tracker.report.skipped == 1
    lcm.Publish(PICTURES, whole)
    assert tracker.step() is None
    assert "a picture was not newer than the one before" in tracker.report.left_out
    late = encode_frame(bench._camera.take(100.0, positions))
    lcm.Publish(PICTURES, late.encode())
    assert tracker.step() is None
    early = "a picture is from the future, by the robot's clock; expected one clock for both"
    assert tracker.report.left_out[early] == 1
    for data in (make_status(10_000_000), make_status(9_000_000_000)):
        lcm.Publish(arm.status, data)
        tracker.step()
    assert f"{arm.status} is from the future, by its sender's own clock" in tracker.report.left_out


def make_scene():
    """Two objects 21 mm apart, one push away from done."""
    objects = [
        {"object": "pliers", "pose": [0.56, -0.1, 0.0]},
        {"object": "open_book", "pose": [0.56, 0.068, 0.0]},
    ]
    scenario = PushScenario(objects=objects, seed=4)
    scenario.pokes.speed = 0.08
    scenario.camera.use("rgbd")
    return scenario


@pytest.fixture(scope="module")
def scene_bench(tmp_path_factory):
    require_renderer()
    return CameraBench(make_scene(), SeparateTask, tmp_path_factory.mktemp("scene"))


def read_true_poses(bench):
    world = bench.twin.world
    context = world.plant.GetMyContextFromRoot(bench.simulator.get_context())
    parts = [world.object_in_plant, world.setting.others[0].part]
    poses = [world.plant.EvalBodyPoseInWorld(context, part.body) for part in parts]
    return np.array(
        [[*X.translation()[:2], X.rotation().ToRollPitchYaw().yaw_angle()] for X in poses]
    )


@pytest.mark.slow
def test_several_objects_are_found_by_their_outlines_and_each_pose_is_said(scene_bench):
    bench = scene_bench
    bench.begin()
    push = bench.task.preview(bench.link, within=2.0)
    assert bench.tracker.names == ("pliers", "open_book")
    assert bench.tracker.report.seen == bench.tracker.report.pictures > 0
    for port, true in zip(("object.pose", "other_0.pose"), read_true_poses(bench), strict=True):
        off = bench.task.read(port) - true
        assert np.linalg.norm(off[:2]) < 1e-3 and abs(off[2]) < np.radians(0.3), off
    assert push is not None


@pytest.mark.slow
def test_objects_are_separated_over_lcm_by_the_pictures_alone(scene_bench):
    bench = scene_bench
    bench.begin()
    record = bench.task.run(drive=bench.link)
    assert record.status == TaskStatus.REACHED, record.message
    assert record.pushes >= 1
    np.testing.assert_allclose(record.poses, read_true_poses(bench), atol=0.003)
