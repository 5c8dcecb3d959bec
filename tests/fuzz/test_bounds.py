"""What once hung, took gigabytes or ended in a traceback is refused in one line, at once."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from gridpush_drake.dynamics.push import MAX_STEPS, ForcePush, Push
from gridpush_drake.dynamics.simulation import simulate
from gridpush_drake.errors import (
    GridPushError,
    ObjectError,
    OutputError,
    ParameterError,
    PushError,
    PushLogError,
    SimulationError,
)
from gridpush_drake.files import check_writable, make_folder, read_bytes, write_whole
from gridpush_drake.identification.model import Model
from gridpush_drake.identification.model_file import looks_like_model, read_model
from gridpush_drake.multibody.sdformat import make_sdf
from gridpush_drake.objects.cells import MAX_CELLS
from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.objects.mask import PGM_HEADER, read_labels
from gridpush_drake.planning.contact.limit_surface import MAX_TABLE_NODES, make_distance_table
from gridpush_drake.pushes.importers.bag import BagImporter
from gridpush_drake.pushes.importers.cmu import CmuImporter
from gridpush_drake.pushes.importers.mit import MitImporter
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.station.schema.scenario_file import read_scenario
from tests.helpers.made_identifications import make_block
from tests.helpers.rough_pushes import look_up

READERS = [
    GridObject.from_yaml,
    read_model,
    read_scenario,
    read_labels,
    CmuImporter().read,
    MitImporter().read,
    PushLog.read_csv,
]
OUTLINE = "outline: [[0, 0], [0.1, 0], [0.1, 0.1]]\n"
LEVELS, COPIES = 12, 9

ALIASES = "a0: &a0 [x, x]\n" + "".join(
    f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * COPIES)}]\n" for i in range(1, LEVELS)
)
MERGES = "a0: &a0 {x: 1}\n" + "".join(
    f"a{i}: &a{i} {{<<: [{', '.join([f'*a{i - 1}'] * COPIES)}]}}\n" for i in range(1, LEVELS)
)


@pytest.mark.parametrize("reader", [GridObject.from_yaml, read_scenario])
@pytest.mark.parametrize(
    ("text", "message"),
    [
        (ALIASES, "more than 500000 keys and values, its aliases written out"),
        (MERGES, "more than 500000 keys and values, its aliases written out"),
        ("a: &a [*a]\n", "stands inside the value that it names"),
        ("a: &a {b: *a}\n", "stands inside the value that it names"),
        ("a: 0x" + "1" * 5000 + "\n", "a number has 5002 characters; expected at most 400"),
        ("a: " + "9" * 5000 + "\n", "a number has 5000 characters; expected at most 400"),
    ],
    ids=["aliases", "merges", "list in itself", "mapping in itself", "base 16", "digits"],
)
def test_yaml_bombs(tmp_path, reader, text, message):
    path = tmp_path / "bomb.yaml"
    path.write_text(text)
    with pytest.raises(GridPushError, match=message):
        reader(path)


@pytest.mark.parametrize("reader", [GridObject.from_yaml, read_model, read_scenario])
def test_yaml_runs_no_code(tmp_path, reader):
    path, made = tmp_path / "code.yaml", tmp_path / "made"
    for tag in ("object/apply:os.mkdir", "object/new:os.mkdir", "name:os.mkdir", "module:os"):
        path.write_text(
            f"name: !!python/{tag} [{made}]\nobject: !!python/{tag} [{made}]\n" + OUTLINE
        )
        with pytest.raises(GridPushError, match=r"code\.yaml"):
            reader(path)
    assert not made.exists()


@pytest.mark.parametrize("reader", READERS)
def test_what_is_no_regular_file(tmp_path, reader):
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", Path("/dev/zero")):
        with pytest.raises(GridPushError, match="is a pipe or a device, not a file; expected"):
            reader(path)
    with pytest.raises(GridPushError, match="is a folder; expected"):
        reader(tmp_path)


@pytest.mark.parametrize("reader", READERS)
def test_names_that_no_file_has(tmp_path, reader):
    with pytest.raises(GridPushError, match="File name too long; expected") as caught:
        reader(tmp_path / ("a" * 300 + ".yaml"))
    assert len(str(caught.value)) < 400
    with pytest.raises(GridPushError, match=r"a\\0b: cannot be read: .*\(NUL\); expected"):
        reader(tmp_path / "a\0b")


def test_names_that_no_file_has_are_not_written(tmp_path):
    for name, message in (("a" * 300, "File name too long"), ("a\0b", "NUL")):
        for write in (check_writable, make_folder, lambda path: write_whole(path, "text")):
            with pytest.raises(OutputError, match=message):
                write(tmp_path / name)
        assert not looks_like_model(tmp_path / name)
    write_whole(tmp_path / ("a" * 255), "text")
    with pytest.raises(OutputError, match="is a pipe or a device"):
        check_writable("/dev/null", force=True)
    assert [path.name for path in tmp_path.iterdir()] == ["a" * 255]


def test_large_files(tmp_path):
    with (tmp_path / "large.csv").open("wb") as file:
        file.truncate(2**36)
    with pytest.raises(
        GridPushError, match=r"large\.csv: has 65536 MB, more than 64 MB; expected a push log"
    ):
        PushLog.read_csv(tmp_path / "large.csv")
    with pytest.raises(ObjectError, match="has more than 0 MB"):
        read_bytes("/proc/self/status", "little", ObjectError, max_size=10)


MANY = 300_000
"""So many blanks or comments that a header's reader that tries them again would not end."""


@pytest.mark.parametrize("filler", [b" ", b"#\n", b"\n", b"# a\n ", b"1 "])
def test_headers_without_end(tmp_path, filler):
    path = tmp_path / "mask.pgm"
    path.write_bytes(b"P5" + filler * 4096)
    with pytest.raises(ObjectError, match=r"mask\.pgm"):
        read_labels(path)
    assert PGM_HEADER.match(b"P5" + filler * MANY) is None


def test_numbers_that_are_too_many(tmp_path):
    path = tmp_path / "object.yaml"
    for line, message in (
        (
            "max_cells: 10000000",
            "max_cells is 10000000; expected a whole number, 1 or more, at most 10000",
        ),
        (
            f"cells: {{size: 0.1, centers: [[0, 0]], labels: [{10**30}]}}",
            r"labels\[0\] is 10+; expected",
        ),
        (
            f"parts: [{{label: {10**30}, outline: [[0, 0], [1, 0], [0, 1]]}}]",
            r"parts\[0\]\.label is 10+; expected",
        ),
    ):
        path.write_text(f"{OUTLINE}{line}\n")
        with pytest.raises(ObjectError, match=message):
            GridObject.from_yaml(path)
    with pytest.raises(ObjectError, match="at most 10000"):
        GridObject.from_outline([[0, 0], [1, 0], [0, 1]], max_cells=MAX_CELLS + 1)
    with pytest.raises(ObjectError, match="labels"):
        GridObject("a", np.zeros((1, 2)), 0.1, [10**30], make_block().outline)


@pytest.mark.parametrize(
    ("push", "options"),
    [
        (Push((-0.1, 0), (1e6, 0), 1.0, 0.01), {}),
        (Push((-0.1, 0), (1e6, 0), 1.0, 0.01), {"regime": "quasi_static"}),
        (Push((-0.1, 0), (0.1, 0), 1e9, 0.01), {}),
        (Push((-0.1, 0), (0.1, 0), 1.0, 0.01), {"dt": 1e-300}),
        (ForcePush((0, 0), (1, 0), 1e9), {}),
    ],
)
def test_pushes_of_too_many_steps(push, options):
    obj = make_block()
    with pytest.raises(SimulationError, match=f"steps; expected at most {MAX_STEPS}"):
        simulate(Model(obj), push, **options)


def test_push_that_leaves_all_numbers():
    with pytest.raises(PushError, match="end, start"):
        Push((0, 0), (1e12, 0), 1e12, 0.01)
    with pytest.raises(
        PushError, match=r"velocity is .*; expected two finite numbers, at most 1e\+12"
    ):
        Push((0, 0), (1e300, 0), 1e300, 0.01)
    for radius, duration, name in ((1e300, 1.0, "radius"), (0.01, 1e300, "duration")):
        with pytest.raises(
            PushError, match=rf"{name} is 1e\+300; expected a positive number, at most 1e\+12"
        ):
            Push((0, 0), (0.1, 0), duration, radius)
    for times, places in (
        ((0, 1), (0, 1e300)),
        ((0, 1e300), (0, 1)),
        ((0, 1), (0, np.nan)),
        ((0, np.nan), (0, 1)),
    ):
        with pytest.raises(PushError, match=r"t and xy must be finite numbers, at most 1e\+12"):
            Push.along(times, np.column_stack([places, places]), 0.01)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("pokes: {distance: [1e-300, 1e-300]}", "pokes.distance is .*positive, in m, from 0.01 to"),
        (
            "pokes: {count: 10000000000000000000000000}",
            "pokes.count is 1.*; expected a whole number, 1 or more, at most",
        ),
        ("pokes: {test_distance: 1e-300}", "pokes.test_distance"),
        ("simulation: {time_step: 1e-300}", "simulation.time_step"),
        ("camera: {rate: 1e300}", "camera.rate"),
        ("object_pose: [1e300, 0, 0]", "object_pose"),
        (f"seed: {10**30}", "seed is"),
    ],
)
def test_scenarios_without_end(tmp_path, text, message):
    path = tmp_path / "scenario.yaml"
    path.write_text(text)
    with pytest.raises(GridPushError, match=message):
        read_scenario(path)


def test_masses_that_drake_takes_for_unphysical():
    obj = make_block()
    with pytest.raises(
        ParameterError,
        match=r"block: mass or height: cells of .* kg, 0\.\d+ m wide, make no inertia",
    ):
        make_sdf(Model(obj), height=1e300)


def test_plans_for_objects_without_end():
    table = make_distance_table(
        GridObject.from_outline([[-900, -300], [900, -300], [900, 300], [-900, 300]]), 0.01
    )
    assert max(table.values.shape) <= MAX_TABLE_NODES + 2
    np.testing.assert_allclose(look_up(table, np.array([[0.0, 290.0]]))[0], -10.0, atol=table.step)


def test_a_small_file_that_is_large_unpacked(tmp_path):
    path = tmp_path / "rect1.mat"
    savemat(path, {"record_all": np.zeros(3 * 2**20)}, do_compression=True)
    assert path.stat().st_size < 2**16
    with pytest.raises(
        PushLogError, match=r"rect1\.mat: has more than 16 MB, unpacked; expected a MATLAB v5 file"
    ):
        MitImporter().read(path)


def test_bags_that_are_no_files(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", Path("/dev/zero")):
        with pytest.raises(
            PushLogError, match="is a pipe or a device, not a file; expected a ROS bag"
        ):
            BagImporter(make_block(), "/object", "/tip").read(path)


def test_counts_without_end_in_cmu_logs(tmp_path):
    path = tmp_path / "cmu.txt"
    for count in ("9" * 9, "9" * 5000):
        path.write_text(f"1\n0 0 0 1 0 0 0\n0 0 0 1 0 0 0\n{count}\n0 0 0\n")
        with pytest.raises(GridPushError, match=r"cmu\.txt, line [46]: .*expected push 1"):
            CmuImporter().read(path)


def test_a_killed_writer_leaves_the_old_file_or_the_new_one(tmp_path):
    path, size = tmp_path / "out.txt", 4_000_000
    path.write_bytes(b"a" * size)
    code = (
        "import sys\nfrom gridpush_drake.files import write_whole\n"
        f"contents = [b'a' * {size}, b'b' * {size}]\nprint('ready', flush=True)\n"
        "while True:\n    for content in contents:\n        write_whole(sys.argv[1], content, force=True)\n"
    )
    for wait in (0.01, 0.03, 0.05):
        writer = subprocess.Popen([sys.executable, "-c", code, str(path)], stdout=subprocess.PIPE)
        assert writer.stdout is not None
        writer.stdout.readline()
        time.sleep(wait)
        writer.send_signal(signal.SIGKILL)
        writer.wait()
        writer.stdout.close()
        content = path.read_bytes()
        assert len(content) == size and len(set(content)) == 1
