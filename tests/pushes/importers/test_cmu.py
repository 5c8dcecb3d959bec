import math

import numpy as np
import pytest

from gridpush_drake.errors import PushLogError
from gridpush_drake.pushes.importers import cmu
from gridpush_drake.pushes.importers.cmu import CmuImporter, triangle_block
from gridpush_drake.pushes.push_log import PushLog
from tests.helpers.shared_data import read_cmu
from tests.pushes.gaps import gap, gaps

FILES = ["hardboard_wide", "hardboard_middle", "hardboard_patch", "plywood_wide", "plywood_middle"]
EPOCH = 1439834932.25
SPEED = 2.5  # mm/s


def import_cmu(path, **options):
    return CmuImporter(**options).read(path)


def turned(angle, vector):
    c, s = math.cos(angle), math.sin(angle)
    return np.array([c * vector[0] - s * vector[1], s * vector[0] + c * vector[1]])


def pose_line(q):
    """The logged pose of the corner for a pose of the centroid, m and rad."""
    corner = 1e3 * (np.array(q[:2]) + turned(q[2], (-0.05, -0.05)))
    return f"{corner[0]:.12f} {corner[1]:.12f} 10 {math.cos(q[2] / 2)} 0 0 {math.sin(q[2] / 2)}"


def push_lines(before, after, start, angle, force, samples=60, stand=5):
    """A tool that stands, moves at SPEED from `start` (m) along `angle`, and stands; the force grows linearly.

    `force` is the last force on the object in the robot's frame, N.
    """
    moved = (
        [0.0] * stand
        + [SPEED * 0.03 * i for i in range(1, samples + 1)]
        + [SPEED * 0.03 * samples] * stand
    )
    tool = []
    for i, way in enumerate(moved):
        x, y = 1e3 * np.array(start) + turned(angle, (way, 0.0))
        tool.append(
            f"{EPOCH + 0.03 * i:.9f} {x:.9f} {y:.9f} 9 {math.cos(angle / 2)} 0 0 {math.sin(angle / 2)}"
        )
    tool.insert(3, tool[2])
    axes = np.array([[1, 1], [1, -1]]) / math.sqrt(2)
    sensor = -axes @ turned(-angle, force)
    last = len(moved) - 1
    rows = [
        f"{EPOCH + 0.01 * i:.9f} {0.3 + sensor[0] * i / (3 * last):.9f} {-0.2 + sensor[1] * i / (3 * last):.9f}"
        for i in range(3 * last + 1)
    ]
    return [pose_line(before), pose_line(after), str(len(rows)), *rows, str(len(tool)), *tool]


BEFORE, AFTER = (0.5, -0.2, 2.0), (0.506, -0.198, 2.1)
START, ANGLE, FORCE = (0.45, -0.22), 0.7, (1.5, -0.5)


@pytest.fixture
def lines():
    return [
        "2",
        *push_lines(BEFORE, AFTER, START, ANGLE, FORCE),
        *push_lines(AFTER, BEFORE, START, ANGLE, FORCE),
    ]


@pytest.fixture
def write(tmp_path):
    def write(lines):
        path = tmp_path / "pushes.txt"
        path.write_text("\n".join(lines) + "\n")
        return path

    return write


def test_poses_are_in_the_initial_object_frame(lines, write):
    log, obj = import_cmu(write(lines), shuffle=False)
    assert obj.name == "triangle_block"
    assert [seen.name for seen in log] == ["push_1", "push_2"]
    first, second = log
    np.testing.assert_array_equal(first.pose, 0)
    np.testing.assert_allclose(first.final_pose, [*turned(-2.0, (0.006, 0.002)), 0.1], atol=1e-12)
    np.testing.assert_allclose(
        second.final_pose, [*turned(-2.1, (-0.006, -0.002)), -0.1], atol=1e-12
    )
    np.testing.assert_array_equal(first.t_observed, [first.push.duration])


def test_calibrated_tip(lines, write):
    push = import_cmu(write(lines), shuffle=False)[0][0].push
    assert push.radius == 0.0005
    start = np.array(START) + turned(ANGLE, (-0.0012, -0.00085))
    end = start + turned(ANGLE, (60 * 0.03 * SPEED * 1e-3 + 0.00065, 0))
    np.testing.assert_allclose(push.xy[0], turned(-2.0, start - BEFORE[:2]), atol=1e-8)
    np.testing.assert_allclose(push.xy[-1], turned(-2.0, end - BEFORE[:2]), atol=1e-8)
    assert push.duration == pytest.approx(60 * 0.03 + 0.65 / SPEED, rel=1e-3)


def test_logged_tip_when_not_calibrated(lines, write):
    push = import_cmu(write(lines), shuffle=False, calibrate=False)[0][0].push
    end = np.array(START) + turned(ANGLE, (60 * 0.03 * SPEED * 1e-3, 0))
    np.testing.assert_allclose(push.xy[0], turned(-2.0, np.array(START) - BEFORE[:2]), atol=1e-8)
    np.testing.assert_allclose(push.xy[-1], turned(-2.0, end - BEFORE[:2]), atol=1e-8)
    assert push.duration == pytest.approx(60 * 0.03, rel=1e-3)


def test_standstill_is_dropped_and_time_increases_from_zero(lines, write):
    push = import_cmu(write(lines), shuffle=False, calibrate=False)[0][0].push
    assert push.t[0] == 0
    assert np.all(np.diff(push.t) > 0)
    assert len(push.t) == 61
    steps = np.linalg.norm(np.diff(push.xy, axis=0), axis=1)
    assert steps.min() > 0


def test_force_on_the_object(lines, write):
    seen = import_cmu(write(lines), shuffle=False)[0][0]
    assert seen.force_t[-1] < seen.push.duration
    fraction = (seen.force_t + 4 * 0.03) / (69 * 0.03)
    np.testing.assert_allclose(seen.force, fraction[:, None] * turned(-2.0, FORCE), atol=1e-6)


def test_steps_of_the_log_are_taken_out_of_a_straight_path(write):
    lines = ["1", *push_lines(BEFORE, AFTER, START, ANGLE, FORCE)]
    rows = slice(-71, None)
    for i, line in enumerate(lines[rows], start=len(lines) - 71):
        words = line.split()
        words[1:3] = [f"{float(word):.1f}" for word in words[1:3]]
        lines[i] = " ".join(words)
    rough = import_cmu(write(lines), calibrate=False)[0][0].push
    smooth = import_cmu(write(lines))[0][0].push
    length = 60 * 0.03 * SPEED * 1e-3
    assert rough.length > 1.05 * length
    assert smooth.length == pytest.approx(length + 0.00065, abs=1e-4)
    assert np.linalg.norm(smooth.xy[-1] - smooth.xy[0]) == pytest.approx(smooth.length)


def test_a_bent_path_is_kept():
    p = np.column_stack([np.linspace(0, 0.01, 50), np.linspace(-0.05, 0.05, 50) ** 2])
    np.testing.assert_array_equal(cmu._straightened(p), p)


def test_order_is_shuffled_by_seed(write):
    lines = ["6"]
    for i in range(6):
        lines += push_lines(BEFORE, (*AFTER[:2], 2.0 + 0.01 * i), START, ANGLE, FORCE)
    path = write(lines)

    def turns(**options):
        log = import_cmu(path, **options)[0]
        assert [seen.name for seen in log] == [f"push_{i}" for i in range(1, 7)]
        return [round(100 * seen.final_pose[2]) for seen in log]

    assert turns(shuffle=False) == list(range(6))
    assert turns() == turns(seed=0) != list(range(6))
    assert sorted(turns(seed=1)) == list(range(6))
    assert turns(seed=1) != turns(seed=0)


def test_triangle_block():
    block = triangle_block()
    assert block.name == "triangle_block"
    assert block.n <= 60
    assert block.prior.total_mass == 1.518
    assert block.prior.contact_friction == 0.5
    assert block.prior.contact_friction_std == 0.15
    assert block.prior.pusher_radius == 0.0005
    assert block.prior.center_of_mass is None
    np.testing.assert_allclose(block.outline.centroid.coords[0], [0, 0], atol=1e-12)


def test_uniform_plate(lines, write):
    for block in (
        triangle_block(uniform_plate=True),
        import_cmu(write(lines), uniform_plate=True)[1],
    ):
        assert block.prior.center_of_mass == (0.0, 0.0)
        assert block.prior.center_of_mass_std == 0.002


def spoilt(lines, index, text):
    return [*lines[:index], text, *lines[index + 1 :]]


@pytest.mark.parametrize(
    ("spoil", "messages"),
    [
        (lambda lines: [""], ["line 1", "ends here", "number of pushes"]),
        (lambda lines: spoilt(lines, 0, "two"), ["line 1", "'two'", "whole number"]),
        (lambda lines: spoilt(lines, 0, "0"), ["line 1", "whole number"]),
        (lambda lines: spoilt(lines, 0, "2.5"), ["line 1", "whole number"]),
        (lambda lines: spoilt(lines, 0, "3"), ["ends here", "push 3", "pose before"]),
        (lambda lines: spoilt(lines, 0, "1"), ["end after its last push"]),
        (lambda lines: spoilt(lines, 1, "1 2 3"), ["line 2", "push 1", "pose before"]),
        (lambda lines: spoilt(lines, 2, "1 2 3 1 1 0 0"), ["line 3", "pose after", "length 1"]),
        (lambda lines: spoilt(lines, 3, "-4"), ["line 4", "number of force rows"]),
        (lambda lines: spoilt(lines, 3, "10"), ["line 15", "number of tool rows"]),
        (lambda lines: spoilt(lines, 6, "1 x 2"), ["line 7", "a force row", "'1 x 2'"]),
        (lambda lines: spoilt(lines, 6, "1 nan 2"), ["line 7", "a force row"]),
        (lambda lines: spoilt(lines, 6, "1 2"), ["line 7", "a force row", "fx fy"]),
        (lambda lines: lines[:50], ["line 51", "ends here", "a force row"]),
        (lambda lines: lines[:-1], ["ends here", "push 2: a tool row"]),
        (lambda lines: [*lines, "1 2 3"], ["end after its last push"]),
    ],
)
def test_bad_files_are_named_with_line_and_form(lines, write, spoil, messages):
    path = write(spoil(lines))
    with pytest.raises(PushLogError) as raised:
        import_cmu(path)
    for message in (str(path), *messages):
        assert message in str(raised.value)


def test_a_tool_that_stands_is_refused(write):
    with pytest.raises(PushLogError, match="push 1: the tool does not move"):
        import_cmu(write(["1", *push_lines(BEFORE, AFTER, START, ANGLE, FORCE, samples=0)]))


def test_files_that_cannot_be_read(tmp_path):
    with pytest.raises(PushLogError, match="No such file"):
        import_cmu(tmp_path / "none.txt")
    with pytest.raises(PushLogError, match="cannot be read"):
        import_cmu(tmp_path)
    (tmp_path / "binary.txt").write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(PushLogError, match="not UTF-8 text"):
        import_cmu(tmp_path / "binary.txt")


@pytest.mark.parametrize("name", FILES)
def test_real_pushes_touch_the_block(name):
    """The tool approaches for about 2.7 mm, touches as the force sets in, and touches still at the end."""
    log, block = read_cmu(name)
    start, end = gaps(log, block)
    touch = []
    for seen in log:
        felt = np.linalg.norm(seen.force - seen.force[0], axis=1) > 0.5
        tip = seen.push.tip_at(seen.force_t[[np.argmax(felt)]])[0]
        touch.append(1e3 * gap(block, seen.pose, tip, seen.push.radius))
    assert len(log) == 50
    assert start.min() > 0.5
    assert 2.3 < np.median(start) < 3.1
    assert start.max() < 3.4
    assert abs(np.median(touch)) < 0.3
    assert abs(np.median(end)) < 0.2
    assert end.min() > -1.3
    assert end.max() < 1.9


@pytest.mark.parametrize("name", FILES)
def test_real_pushes_uncalibrated_do_not_touch_as_well(name):
    calibrated, raw = (gaps(*read_cmu(name, flag))[1] for flag in (True, False))
    assert np.abs(calibrated).mean() < np.abs(raw).mean()


@pytest.mark.parametrize("name", FILES)
def test_real_pushes_as_a_whole(name, tmp_path):
    log, _ = read_cmu(name)
    for seen in log:
        assert np.all(seen.pose == 0)
        assert seen.push.length == pytest.approx(0.01695, abs=2e-4)
        assert np.linalg.norm(seen.final_pose[:2]) < 0.025
        assert abs(seen.final_pose[2]) < math.pi / 4
        assert np.abs(np.diff(seen.push.t)).max() < 0.3
        direction = (seen.push.xy[-1] - seen.push.xy[0]) / seen.push.length
        assert np.median(seen.force[len(seen.force) // 2 :] @ direction) > 0.5
    assert not np.array_equal(
        [seen.final_pose for seen in log],
        [seen.final_pose for seen in import_cmu(log.source, shuffle=False)[0]],
    )
    log.write_csv(tmp_path / "log.csv")
    back = PushLog.read_csv(tmp_path / "log.csv")
    for seen, again in zip(log, back, strict=True):
        np.testing.assert_array_equal(seen.push.xy, again.push.xy)
        np.testing.assert_array_equal(seen.final_pose, again.final_pose)
        np.testing.assert_array_equal(seen.force, again.force)


@pytest.mark.slow
def test_one_number_changed_is_read_or_refused_in_a_line(tmp_path):
    """Times that go back leave a tool that never moves, whatever its places say."""
    pose = "0 0 0 1 0 0 0"
    tool = [f"{0.1 * i:g} {i} 0 0 1 0 0 0" for i in range(5)]
    lines = ["1", pose, pose, "2", "0 0 0", "1 0.1 0.2", "5", *tool]
    path = tmp_path / "log.txt"
    refused_lines = set()
    for i, line in enumerate(lines):
        for j in range(len(line.split())):
            for number in ("0", "1", "2", "1e9", "-1e12"):
                words = line.split()
                words[j] = number
                changed = [*lines[:i], " ".join(words), *lines[i + 1 :]]
                path.write_text("\n".join(changed))
                for calibrate in (True, False):
                    try:
                        CmuImporter(calibrate=calibrate).read(path)
                    except PushLogError as error:
                        assert str(path) in str(error) and "\n" not in str(error)
                        refused_lines.add(i)
    assert 7 in refused_lines  # the first row's time, after all others
