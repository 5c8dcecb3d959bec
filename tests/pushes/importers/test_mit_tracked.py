import json
import warnings

import numpy as np
import pytest

from gridpush_drake.dynamics.push import Push
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import MissingExtraError, PushLogError, PushLogWarning
from gridpush_drake.identification.learning import identify
from gridpush_drake.identification.model import Model
from gridpush_drake.objects.parameters import CellParameters
from gridpush_drake.pushes.importers import mit_tracked
from gridpush_drake.pushes.importers.mit import TIP_RADIUS, make_mit_object
from gridpush_drake.pushes.importers.mit_tracked import MitTrackedImporter

LATE = 0.03
"""By how much the object's clock is late in the files made here, s."""

EPOCH = 1.47e9
"""When they begin, s, as in the data set."""


def name_file(i, shape="rect1", suffix=".json"):
    return f"motion_surface=abs_shape={shape}_a=0_v=50_i=0.000_s=0.50_t={i:.3f}{suffix}"


def make_tables(obj, params, arc, *, late=LATE, unseen=0.0, rest=0.6, forces=1.0):
    """The tables of one push: the object's poses end `unseen` s before the tip's last row."""
    pose = np.array([0.3, -0.1, 1.2])
    push = Push.on_outline(
        obj, arc, 0.15, 0.05, radius=TIP_RADIUS, speed=0.05, pose=pose, clearance=1e-3
    )
    motion = simulate(Model(obj, params), push, pose)
    t = np.arange(-0.3, push.duration + rest, 0.004)
    inside = np.clip(t, 0, push.duration)
    tip = push.start + push.velocity * inside[:, None]
    poses = np.array(
        [np.interp(inside, motion.times, motion.poses[:, axis]) for axis in range(3)]
    ).T
    seen = slice(0, len(t) - round(unseen / 0.004), 2)
    work = np.where((t > 0) & (t < push.duration), 2.0, 0.0)
    force = forces * work[:, None] * push.velocity / np.linalg.norm(push.velocity)
    return {
        "tip_pose": np.column_stack([EPOCH + t, tip, np.zeros(len(t))]),
        "object_pose": np.column_stack([EPOCH + late + t[seen], poses[seen]]),
        "ft_wrench": np.column_stack([EPOCH + t, force, np.zeros(len(t))]),
    }, motion


@pytest.fixture(scope="module")
def body():
    obj = make_mit_object("made here", "rect1")
    params = CellParameters.uniform(obj)
    mass = params.mass * np.exp(15 * obj.p_BC[:, 0])
    return obj, CellParameters(mass, params.friction, 0.25)


def write_json(folder, i, tables, **changes):
    path = folder / name_file(i)
    path.write_text(json.dumps({k: v.tolist() for k, v in tables.items()} | changes))
    return path


ARCS = (0.02, 0.07, 0.11, 0.16, 0.21, 0.25, 0.30, 0.34)


def test_a_folder_of_pushes_with_two_clocks(tmp_path, body):
    obj, params = body
    finals = []
    for i, arc in enumerate(ARCS):
        tables, motion = make_tables(obj, params, arc)
        write_json(tmp_path, i, tables)
        finals.append(motion.poses[-1])
    with pytest.warns(PushLogWarning, match=r"poses are 3\d ± \d+ ms late.*was taken out"):
        log, found = MitTrackedImporter().read(tmp_path)
    assert found.name == "rect1" and len(log) == len(ARCS)
    for seen, final in zip(log, finals, strict=True):
        np.testing.assert_allclose(seen.final_pose, final, atol=2e-4)
        assert seen.push.radius == TIP_RADIUS
        np.testing.assert_allclose(np.linalg.norm(seen.force, axis=1).max(), 2.0)
    # What is told is taken, and nothing is said where the pushes agree.
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        told, _ = MitTrackedImporter(object_delay=LATE).read(tmp_path)
    np.testing.assert_allclose(told[0].final_pose, finals[0], atol=1e-4)
    with pytest.warns(PushLogWarning, match="--object-delay says otherwise, and is believed"):
        MitTrackedImporter(object_delay=0.2).read(tmp_path)
    with pytest.warns(PushLogWarning, match="the forces are not used, as the pushes are fast"):
        found = identify(Model(obj), told)
    off = found.params.center_of_mass(obj) - params.center_of_mass(obj)
    assert np.linalg.norm(off) < 0.003


def test_what_was_not_seen_does_not_count(tmp_path, body):
    obj, params = body
    tables, motion = make_tables(obj, params, 0.07, late=0.0, unseen=0.1, rest=0.0)
    path = write_json(tmp_path, 0, tables)
    log, _ = MitTrackedImporter().read(path)
    (seen,) = log
    last = tables["object_pose"][-1, 0] - EPOCH
    assert seen.push.duration > last + 0.05
    assert seen.t_observed[-1] == pytest.approx(last, abs=0.02)
    then = [np.interp(seen.t_observed[-1], motion.times, motion.poses[:, i]) for i in range(3)]
    np.testing.assert_allclose(seen.final_pose, then, atol=5e-4)


def test_hdf5_is_read_as_json_is(tmp_path, body):
    h5py = pytest.importorskip("h5py")
    obj, params = body
    tables, _ = make_tables(obj, params, 0.11, late=0.0)
    path = tmp_path / name_file(0, suffix=".h5")
    with h5py.File(path, "w") as file:
        for name, table in tables.items():
            file.create_dataset(name, data=table, compression="gzip")
    (seen,), _ = MitTrackedImporter(object_delay=0.0).read(path)
    (same,), _ = MitTrackedImporter(object_delay=0.0).read(write_json(tmp_path, 0, tables))
    np.testing.assert_array_equal(seen.poses_observed, same.poses_observed)
    np.testing.assert_array_equal(seen.force, same.force)

    with h5py.File(path, "w") as file:
        file.create_dataset("tip_pose", shape=(10**9, 4), dtype="f8", chunks=(1000, 4))
    with pytest.raises(PushLogError, match=r"tip_pose has the shape \(1000000000, 4\); expected"):
        MitTrackedImporter().read(path)
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(PushLogError, match="cannot be read as HDF5"):
        MitTrackedImporter().read(path)


def test_without_h5py_the_extra_is_named(tmp_path, monkeypatch):
    path = tmp_path / name_file(0, suffix=".h5")
    path.write_bytes(b"\x89HDF\r\n")

    def refuse(package, extra):
        raise MissingExtraError(f"{package}: is in the extra {extra}")

    monkeypatch.setattr(mit_tracked, "import_extra", refuse)
    with pytest.raises(MissingExtraError, match="h5py: is in the extra hdf5"):
        MitTrackedImporter().read(path)


def test_forces_on_the_tip_are_turned_round(tmp_path, body):
    obj, params = body
    tables, _ = make_tables(obj, params, 0.02, late=0.0, forces=-1.0)
    path = write_json(tmp_path, 0, tables)
    with pytest.warns(PushLogWarning, match="forces on the tip; they were turned round"):
        (seen,), _ = MitTrackedImporter(object_delay=0.0).read(path)
    assert seen.force.sum(axis=0) @ seen.push.velocity > 0


def test_the_shape_is_in_the_name(tmp_path, body):
    obj, params = body
    tables, _ = make_tables(obj, params, 0.02, late=0.0)
    write_json(tmp_path, 0, tables)
    (tmp_path / "other.json").write_text("{}")
    with pytest.raises(PushLogError, match=r"other\.json: its name does not say the shape"):
        MitTrackedImporter().read(tmp_path)
    (tmp_path / "other.json").rename(tmp_path / name_file(1, shape="hex"))
    with pytest.raises(PushLogError, match="holds pushes of hex and rect1; expected one shape"):
        MitTrackedImporter().read(tmp_path)
    with pytest.raises(PushLogError, match=r"shape=hex.*has no tip_pose; it holds nothing"):
        MitTrackedImporter(shape="rect1").read(tmp_path)
    with pytest.raises(PushLogError, match="shape 'egg' is not known; expected rect1, "):
        MitTrackedImporter(shape="egg").read(tmp_path / name_file(0))


def test_files_that_are_wrong(tmp_path, body):
    obj, params = body
    tables, _ = make_tables(obj, params, 0.02, late=0.0)

    def refuse(message, **changes):
        path = write_json(tmp_path, 0, tables, **changes)
        with pytest.raises(PushLogError, match=message):
            MitTrackedImporter().read(path)

    refuse("tip_pose has the shape", tip_pose=[[1, 2, 3]] * 5)
    refuse("tip_pose has the shape", tip_pose="none")
    refuse("tip_pose must hold finite", tip_pose=[[1, 2, 3, None], [1, 2, 3, 4]])
    back = tables["object_pose"][::-1].tolist()
    refuse("object_pose, row 2: its time is before the one above", object_pose=back)
    still = [[EPOCH + i, 0.0, 0.0, 0.0] for i in range(5)]
    refuse("no push touches rect1", tip_pose=still)
    (tmp_path / name_file(0)).write_text("[" * 100_000)
    with pytest.raises(PushLogError, match="cannot be read as JSON"):
        MitTrackedImporter().read(tmp_path / name_file(0))
    (tmp_path / "empty").mkdir()
    with pytest.raises(PushLogError, match=r"empty: holds 0 files that end in \.h5"):
        MitTrackedImporter().read(tmp_path / "empty")
