import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import PushLogError
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.object_file import PhysicalPrior
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.pushes.importers.qualisys import QualisysImporter, read_bodies
from tests.helpers.shared_data import shared_data

RADIUS = 0.006
TIP_AT = np.array([0.02, -0.01, -0.15])
"""Where the tip is in its body's frame, m."""

HEADER = "NO_OF_BODIES\t2\nFREQUENCY\t100\nBODY_NAMES\tFinger\tPlate\nFinger X\tY\tZ\n"


def make_plate():
    outline = np.array([[-0.06, -0.04], [0.06, -0.04], [0.06, 0.04], [-0.06, 0.04]])
    return GridObject.from_outline(
        outline, max_cells=24, name="plate", prior=PhysicalPrior(pusher_radius=RADIUS)
    )


def describe_body(p, R):
    """A body's columns in a row of the file; `p` in m."""
    angles = Rotation.from_matrix(R).as_euler("xyz", degrees=True)
    return [*(1e3 * p), *angles, 0.3, *R.T.ravel()]


LOST = [0.0] * 6 + [-1.0] + [0.0] * 9


def write_table(path, rows, header=HEADER):
    """Rows of (t, bodies), each body's columns as above."""
    text = header
    for i, (t, bodies) in enumerate(rows):
        cells = [f"{i + 1}", f"{t:.5f}"]
        for body in bodies:
            cells += [f"{number:.5f}" for number in body] + [""]
        text += "\t".join(cells) + "\n"
    path.write_text(text)
    return path


@pytest.fixture(scope="module")
def pushed():
    """A plate that is pushed twice, with the true motion: its rows, and the two final poses."""
    obj = make_plate()
    params = CellParameters.uniform(obj)
    tilt = Rotation.from_euler("zyx", [0.7, 0.2, -0.1]).as_matrix()  # of the tip's body
    pose, rows, finals, t = np.array([0.3, 0.1, 2.9]), [], [], 0.0

    def add(tip, q, height):
        nonlocal t
        place = np.array([*tip, height]) - tilt @ TIP_AT
        R = Rotation.from_euler("z", q[2]).as_matrix()
        bodies = [describe_body(place, tilt), describe_body(np.array([*q[:2], 0.02]), R)]
        rows.append((t, bodies))
        t += 0.01

    for arc in (0.03, 0.19):
        push = Push.on_outline(
            obj, arc, 0.1, 0.08, radius=RADIUS, speed=0.05, pose=pose, clearance=1e-3
        )
        motion = simulate(Model(obj, params), push, pose)
        for height in np.linspace(0.1, 0.01, 60):
            add(push.start, pose, height)
        for time in np.arange(0, push.duration + 0.8, 0.01):
            k = min(np.searchsorted(motion.times, time), len(motion.times) - 1)
            place = push.start + push.velocity * min(time, push.duration)
            add(place, motion.poses[k], 0.01)
        pose = motion.poses[-1]
        finals.append(pose)
        for height in np.linspace(0.01, 0.1, 60):
            add(place, pose, height)
    return obj, rows, finals


def importer(plate, **changes):
    options = {
        "obj": plate,
        "object_body": "Plate",
        "tip_body": "Finger",
        "tip_at": "0.02,-0.01,-0.15",
    }
    return QualisysImporter(**options | changes)


def test_pushes_of_a_tilted_body(tmp_path, pushed):
    obj, rows, finals = pushed
    path = write_table(tmp_path / "run_6D.tsv", rows)
    log, given = importer(obj).read(path)
    assert given is obj
    assert len(log) == 2
    for seen, final in zip(log, finals, strict=True):
        assert seen.push.radius == RADIUS
        assert seen.push.length == pytest.approx(0.08, abs=1e-3)
        np.testing.assert_allclose(seen.final_pose[:2], final[:2], atol=2e-4)
        assert np.cos(seen.final_pose[2] - final[2]) > 0.99999
    again, _ = importer(obj, object_body="2", tip_body="1").read(path)
    np.testing.assert_array_equal(again[0].final_pose, log[0].final_pose)


def test_a_pusher_that_is_no_disc_turns_with_the_body_that_carries_it(tmp_path, pushed):
    obj, rows, _ = pushed
    path = write_table(tmp_path / "run_6D.tsv", rows)
    log, _ = importer(obj, pusher="discs:0.004@0,-0.01;0,0.01", pusher_yaw=0.1).read(path)
    assert len(log) == 2
    for seen in log:
        np.testing.assert_array_equal(seen.push.shape.core, [[0.0, -0.01], [0.0, 0.01]])
        # The body that carries it is tilted, too: what counts is its x axis as seen from above.
        x, y, _ = Rotation.from_euler("zyx", [0.7, 0.2, -0.1]).apply([1.0, 0.0, 0.0])
        np.testing.assert_allclose(seen.push.yaw, 0.1 + np.arctan2(y, x), atol=1e-4)
    with pytest.raises(PushLogError, match="--pusher-yaw: is inf; expected a finite number"):
        importer(obj, pusher="discs:0.004@0,0", pusher_yaw=np.inf).read(path)


def test_without_a_header_bodies_have_numbers(tmp_path, pushed):
    obj, rows, _ = pushed
    path = write_table(tmp_path / "run_6D.tsv", rows, header="")
    assert list(read_bodies(path)[1]) == ["1", "2"]
    assert len(importer(obj, object_body="2", tip_body="1").read(path)[0]) == 2


def test_a_lost_body_counts_as_not_seen(tmp_path, pushed):
    obj, rows, finals = pushed
    broken = [
        (t, [bodies[0], LOST if 100 < i < 140 else bodies[1]]) for i, (t, bodies) in enumerate(rows)
    ]
    path = write_table(tmp_path / "run_6D.tsv", broken)
    _, bodies = read_bodies(path)
    assert np.isnan(bodies["Plate"].p[101:140]).all()
    assert np.isfinite(bodies["Plate"].p[140:]).all()
    log, _ = importer(obj).read(path)
    np.testing.assert_allclose(log[0].final_pose[:2], finals[0][:2], atol=2e-4)


def test_a_table_above_the_floor(tmp_path, pushed):
    obj, rows, _ = pushed
    path = write_table(tmp_path / "run_6D.tsv", rows)
    with pytest.raises(PushLogError, match=r"comes down to 0\.710 m above.*--table-height right"):
        importer(obj, table_height=-0.7).read(path)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"object_body": ""}, "--object-body is missing; expected one of Finger, Plate"),
        ({"tip_body": "Wrist"}, "--tip-body is 'Wrist'; expected one of Finger, Plate"),
        ({"tip_body": "3"}, "--tip-body is '3'"),
        ({"tip_at": "1,2"}, "--tip-at: is '1,2'; expected x,y,z"),
        ({"tip_at": "1,2,nan"}, "--tip-at: .*finite numbers"),
        ({"obj": None}, "--object is missing"),
    ],
)
def test_options_that_are_wrong(tmp_path, pushed, changes, message):
    obj, rows, _ = pushed
    path = write_table(tmp_path / "run_6D.tsv", rows[:5])
    with pytest.raises(PushLogError, match=message):
        importer(obj, **changes).read(path)


def test_files_that_are_wrong(tmp_path, pushed):
    obj, rows, _ = pushed
    path = write_table(tmp_path / "run_6D.tsv", rows[:5])
    lines = path.read_text().splitlines()

    def refuse(changed, message):
        path.write_text("\n".join(changed) + "\n")
        with pytest.raises(PushLogError, match=message):
            importer(obj).read(path)

    refuse(lines[:4], "holds no frame")
    refuse([*lines, lines[-1]], "line 10: its time is not after the one above")
    refuse([*lines, lines[-1] + "1\t"], "line 10: has 37 columns; expected")
    refuse([*lines[:-1], lines[-1].replace("\t0.04000\t", "\tinf\t")], "line 9: is 'inf'")
    cells = lines[5].split("\t")
    cells[2 + 7] = "3.0"
    refuse([*lines[:5], "\t".join(cells)], "line 6: Rot.*of Finger are no rotation matrix")


def test_a_real_table():
    path = shared_data("csiro_pushes", "CubeExp0001_6D.tsv")
    t, bodies = read_bodies(path)
    assert (len(t), list(bodies)) == (2000, ["1", "2", "3"])
    cube = bodies["3"]
    moved = cube.p[-1] - cube.p[0]
    assert 0.08 < moved[0] < 0.11 and np.abs(moved[1:]).max() < 0.01
    # It slides without turning: Rot and the file's own yaw angle, 0.571 degrees at first, agree.
    yaw = np.degrees(np.arctan2(cube.R[:, 1, 0], cube.R[:, 0, 0]))
    assert yaw[0] == pytest.approx(0.5714, abs=0.02)
    assert np.ptp(yaw) < 2.0
