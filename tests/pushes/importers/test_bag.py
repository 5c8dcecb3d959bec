"""Bags in all three formats, from clocks that are not quite even and with frames dropped."""

import sys
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gridpush_drake.dynamics.pusher import PusherShape
from gridpush_drake.errors import PushLogError, PushLogWarning
from gridpush_drake.pushes.importers.bag import BagImporter, Track, _Bag, interpolate, make_stream
from gridpush_drake.pushes.pose_delay import estimate_delay
from gridpush_drake.pushes.stream import record_pushes
from tests.helpers.scripted_stream import RADIUS, Script, poke_four_times
from tests.helpers.shapes import make_shape

pytest.importorskip("rosbags", reason="rosbags is in the extra `bags`")

from tests.helpers.ros_bags import Topic, sample_topic, write_bag

SPEED = 0.03  # of the tip while it pushes, m/s
JITTER = 0.002  # standard deviation of a stamp, s

TOPICS = {"object_topic": "/object", "tip_topic": "/tip"}


@pytest.fixture(scope="module")
def script() -> Script:
    return poke_four_times(Script(make_shape("l_bracket", 20), noise=np.zeros(3)))


@pytest.fixture(scope="module")
def obj(script):
    return script.obj


def see(
    script: Script, kinds=("PoseStamped", "PoseStamped"), delay: float = 0.0, jitter: float = JITTER
):
    """The topics of an object that lies 0.2 m up, seen 60 times a second, and of a tip, seen 125 times."""
    thing = sample_topic(
        script.samples,
        lambda seen: (*seen.pose[:2], 0.2, 0.0, 0.0, seen.pose[2] + 6.5),
        60,
        jitter,
        0.1,
        1,
        delay,
    )
    x, y, z = range(3)
    tip = sample_topic(
        script.samples,
        lambda seen: (seen.tip[x], seen.tip[y], seen.tip[z] + 0.2, 3.1, 0.0, 0.5),
        125,
        jitter,
        0.02,
        2,
    )
    force = sample_topic(script.samples, lambda seen: (seen.tip[x], -2.0, 5.0), 250, 0.0, 0.0, 3)
    return [
        Topic("/tf" if kinds[0] == "TFMessage" else "/object", kinds[0], *thing, child="thing"),
        Topic("/tip", kinds[1], *tip, child="tool"),
        Topic("/force", "WrenchStamped", *force),
    ]


def read(path, obj, **options):
    options = {**TOPICS, "table_height": 0.2, **options}
    return BagImporter(obj, **options).read(path)[0]


@pytest.fixture(scope="module")
def bags(script, tmp_path_factory):
    folder = tmp_path_factory.mktemp("bags")
    return {form: write_bag(folder, form, see(script)) for form in ("bag", "db3", "mcap")}


@pytest.mark.parametrize("form", ["bag", "db3", "mcap"])
def test_the_pushes_are_those_of_the_stream_within_the_jitter(bags, script, obj, form, tmp_path):
    log = read(bags[form], obj)
    expected = record_pushes(script.samples, obj, RADIUS).log
    assert len(log) == len(expected) == 4
    within = 4 * JITTER * SPEED
    for one, other in zip(log, expected, strict=True):
        np.testing.assert_allclose(one.push.xy[[0, -1]], other.push.xy[[0, -1]], atol=within)
        np.testing.assert_allclose(one.pose[:2], other.pose[:2], atol=within)
        np.testing.assert_allclose(one.final_pose[:2], other.final_pose[:2], atol=within)
        np.testing.assert_allclose(
            np.angle(np.exp(1j * (one.final_pose[2] - other.final_pose[2] - 6.5))),
            0.0,
            atol=4 * JITTER * SPEED / 0.02,
        )
        assert one.push.duration == pytest.approx(other.push.duration, abs=2 / 30)
    log.write_csv(tmp_path / "a.csv")
    read(bags["bag"], obj).write_csv(tmp_path / "b.csv")
    assert (tmp_path / "a.csv").read_text() == (tmp_path / "b.csv").read_text()


@pytest.mark.parametrize("kind", ["TransformStamped", "Odometry", "TFMessage"])
def test_every_kind_of_message_tells_the_same(bags, script, obj, kind, tmp_path):
    path = write_bag(tmp_path, "mcap", see(script, (kind, "TransformStamped")))
    topic = "/tf:thing" if kind == "TFMessage" else "/object"
    for one, other in zip(
        read(path, obj, object_topic=topic), read(bags["mcap"], obj), strict=True
    ):
        np.testing.assert_array_equal(one.poses_observed, other.poses_observed)
        np.testing.assert_array_equal(one.push.xy, other.push.xy)


def test_a_pusher_that_is_no_disc_turns_with_the_tips_pose(bags, obj):
    """The tool points down, turned by 0.5 rad, and the plate is mounted a quarter turn from its x axis."""
    path = bags["bag"]
    log = read(path, obj, pusher="plate:0.04x0.01x0.002", pusher_yaw=np.pi / 2)
    disc = read(path, obj)
    assert len(log) == len(disc) > 0
    shape = PusherShape.plate(0.04, 0.01, 0.002)
    for seen, same in zip(log, disc, strict=True):
        np.testing.assert_array_equal(seen.push.shape.core, shape.core)
        np.testing.assert_allclose(seen.push.yaw, 0.5 + np.pi / 2, atol=1e-9)
        np.testing.assert_array_equal(seen.final_pose, same.final_pose)
        assert same.push.shape is None
    with pytest.raises(PushLogError, match=r"--pusher: is 'plate:0\.04'; expected plate:WxTxR"):
        read(path, obj, pusher="plate:0.04")
    with pytest.raises(PushLogError, match="--pusher-yaw: is nan; expected a finite number"):
        read(path, obj, pusher_yaw=np.nan)


def test_forces_are_those_of_their_push(bags, obj):
    plain, pushed = (
        read(bags["db3"], obj),
        read(bags["db3"], obj, force_topic="/force", negate_force=True),
    )
    for without, seen in zip(plain, pushed, strict=True):
        assert without.force is None
        assert len(seen.force) == pytest.approx(250 * seen.push.duration, abs=3)
        np.testing.assert_allclose(seen.force[:, 1], 2.0)
        np.testing.assert_allclose(
            seen.force[:, 0], -seen.push.tip_at(seen.force_t)[:, 0], atol=2e-3
        )


def test_a_long_bag_of_a_tracker_and_a_wrist_sensor_is_read(script, obj, tmp_path):
    """A tracker's poses 100 times a second, and the force in the axes of a sensor on the tip."""
    yaw = 0.8
    thing, tip, _ = see(script)
    at_table = np.array([3.0, -2.0])
    towards = Rotation.from_euler("xyz", [3.1, 0.0, 0.5]) * Rotation.from_rotvec([0, 0, yaw])
    in_sensor = towards.inv().apply([*at_table, 5.0])
    force = sample_topic(script.samples, lambda seen: in_sensor, 100, 0.0, 0.0, 3)
    path = write_bag(
        tmp_path,
        "bag",
        [
            replace(thing, name="/vicon/block/block"),
            replace(tip, name="/tip_pose"),
            Topic("/netft_data", "WrenchStamped", *force, frame="netft"),
        ],
    )
    topics = {
        "object_topic": "/vicon/block/block",
        "tip_topic": "/tip_pose",
        "force_topic": "/netft_data",
    }
    log = read(path, obj, **topics, force_in_tip=True, sensor_yaw=yaw)
    assert len(log) == 4
    for seen in log:
        assert len(seen.force) == pytest.approx(100 * seen.push.duration, abs=3)
        np.testing.assert_allclose(seen.force, np.tile(at_table, (len(seen.force), 1)), atol=1e-6)
    with pytest.raises(PushLogError, match="/netft_data is in frame 'netft'"):
        read(path, obj, **topics)


@pytest.mark.slow
def test_a_delay_is_found_taken_out_and_agreed_with(script, obj, tmp_path):
    late, on_time = tmp_path / "late", tmp_path / "on_time"
    for folder in (late, on_time):
        folder.mkdir()
    path = write_bag(late, "bag", see(script, delay=0.147))
    with pytest.warns(
        PushLogWarning, match=r"poses are 1[345]\d ± \d+ ms late, by 4 pushes; this was taken out"
    ) as caught:
        found = read(path, obj)
    number = float(str(caught[0].message).split("--object-delay ")[1].split(" ")[0])
    assert number == pytest.approx(0.147, abs=0.02)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        told = read(path, obj, object_delay=number)
    expected = read(write_bag(on_time, "bag", see(script)), obj)
    for one, other, right in zip(found, told, expected, strict=True):
        np.testing.assert_allclose(one.final_pose, other.final_pose, atol=1e-4)
        np.testing.assert_allclose(one.final_pose, right.final_pose, atol=2e-4)
        np.testing.assert_allclose(one.push.xy[-1], right.push.xy[-1], atol=4 * JITTER * SPEED)
    with pytest.warns(PushLogWarning, match=r"--object-delay says otherwise, and is believed"):
        read(path, obj, object_delay=0.0)


@pytest.mark.parametrize("told", [0.02, 0.05, 0.147, -0.1])
def test_what_is_found_does_not_depend_on_what_was_told(script, obj, told):
    tip = make_track(script, lambda seen: (*seen.tip, 0, 0, 0, 1))
    thing = make_track(script, lambda seen: (*seen.pose[:2], 0, *turn(seen.pose[2])))
    known = estimate_delay(make_stream(Path(), thing, tip, 27, 0.0)[0], obj)
    samples, rest = make_stream(Path(), thing, tip, 27, 0.0, told)
    assert abs(rest) <= 0.5 / 27
    found = estimate_delay(samples, obj)
    assert found.value - rest + told == pytest.approx(known.value, abs=3e-4)


def test_what_would_take_gigabytes_is_refused(script, obj, tmp_path):
    path = write_bag(tmp_path, "bag", see(script))
    with pytest.raises(PushLogError, match=r"--rate: is 1000000\.0; .* at most 1000"):
        read(path, obj, rate=1e6)
    track = Track("/object", "", np.array([0.0, 1e6]), np.tile([0.1, 0, 0, 0, 0, 0, 1.0], (2, 1)))
    with pytest.raises(PushLogError, match=r"1000000 s at --rate 30 make more than 500000 samples"):
        make_stream(Path("long.bag"), track, track, 30.0, 0.0)


@pytest.mark.parametrize("number", [1e300, 0.5, 0.0])
def test_an_orientation_that_is_none_is_refused(script, obj, tmp_path, monkeypatch, number):
    path = write_bag(tmp_path, "bag", see(script))
    convert = _Bag._convert

    def spoil(self, kind, t, message, child):
        for made in convert(self, kind, t, message, child):
            yield made._replace(values=[*made.values[:3], 0.0, 0.0, 0.0, number])

    monkeypatch.setattr(_Bag, "_convert", spoil)
    with pytest.raises(PushLogError, match=r"/object holds .*; expected .*unit quaternion"):
        read(path, obj)


def make_track(script, value):
    t = np.array([seen.t for seen in script.samples])
    return Track("track", "", t, np.array([value(seen) for seen in script.samples], dtype=float))


def turn(theta):
    return (0.0, 0.0, np.sin(theta / 2), np.cos(theta / 2))


def test_nothing_is_interpolated_across_a_gap():
    t = np.delete(np.arange(0, 2, 0.02), slice(30, 60))
    track = Track("/object", "", t, np.tile([0.1, 0, 0, 0, 0, 0, 1.0], (len(t), 1)))
    seen = interpolate(track, np.array([0.29, 0.58, 0.9, 1.2, 1.3]))
    np.testing.assert_array_equal(np.isnan(seen[:, 0]), [False, False, True, False, False])


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (
            {"object_topic": "/objekt"},
            ["/objekt", "/object (PoseStamped)", "/tip (PoseStamped)", "/force"],
        ),
        ({"tip_topic": ""}, ["--tip-topic", "/tip (PoseStamped)"]),
        ({"tip_topic": "/force"}, ["/force", "WrenchStamped", "PoseStamped"]),
        ({"force_topic": "/tip"}, ["/tip", "WrenchStamped"]),
        ({"object_delay": 1e4}, ["do not overlap", "/object", "/tip"]),
        ({"table_height": -1.0}, ["holds no push", "--table-height"]),
        ({"rate": 0.0}, ["--rate", "Hz"]),
        ({"tip_delay": float("nan")}, ["--tip-delay"]),
    ],
)
def test_what_is_not_there_is_refused(bags, obj, options, says):
    with pytest.raises(PushLogError) as error:
        read(bags["mcap"], obj, **options)
    for text in says:
        assert text in str(error.value)


def test_frames_that_differ_or_are_not_there_are_refused(script, obj, tmp_path):
    topics = see(script, ("TFMessage", "PoseStamped"))
    path = write_bag(
        tmp_path,
        "bag",
        [topics[0], Topic("/tip", "PoseStamped", topics[1].t, topics[1].values, "tool")],
    )
    for topic, says in (
        ("/tf", "/tf:FRAME"),
        ("/tf:cup", "something_else, thing"),
        ("/tf:thing", "'tool'"),
    ):
        with pytest.raises(PushLogError, match=says):
            read(path, obj, object_topic=topic)


def test_a_bag_that_is_none_is_refused(obj, tmp_path):
    for name, text in (
        ("none.bag", None),
        ("bad.bag", "#ROSBAG V2.0\nno"),
        ("bad.mcap", "x" * 99),
        ("bad.txt", "x"),
    ):
        path = tmp_path / name
        if text is not None:
            path.write_text(text)
        with pytest.raises(PushLogError, match=name):
            read(path, obj)
    (tmp_path / "folder").mkdir()
    with pytest.raises(PushLogError, match=r"folder: is a folder without metadata\.yaml"):
        read(tmp_path / "folder", obj)


def test_without_the_package_it_says_which_extra(bags, obj, monkeypatch):
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    with pytest.raises(PushLogError, match=r".\[bags\]"):
        read(bags["bag"], obj)
