"""A command does its work wherever its words go, and says in one line where they cannot be written."""

import json
import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest

from gridpush_drake.objects.grid_object import GridObject

COMMAND = [sys.executable, "-m", "gridpush_drake.cli.main"]


def run(arguments, **options):
    """Runs a process of its own, as only that has standard files."""
    return subprocess.run([*COMMAND, *map(str, arguments)], **options)


@pytest.fixture
def picture(tmp_path):
    """A command that prints a line and writes a file: its arguments, and the file."""
    GridObject.from_outline([[0, 0], [0.1, 0], [0, 0.1]], name="Hämmerchen").write_yaml(
        tmp_path / "object.yaml"
    )
    return [
        "show",
        tmp_path / "object.yaml",
        "--out",
        tmp_path / "object.png",
    ], tmp_path / "object.png"


def expect_one_line(done, said):
    assert done.returncode == 2
    assert (
        done.stderr == f"gridpush: error: standard output {said}; what was printed there is lost\n"
    )


def test_a_full_disk_loses_only_the_words(picture):
    arguments, file = picture
    with Path("/dev/full").open("w") as full:
        done = run(arguments, stdout=full, stderr=subprocess.PIPE, text=True)
    expect_one_line(done, "cannot be written: No space left on device")
    assert file.exists()


def test_a_closed_pipe_loses_only_the_words(picture):
    arguments, file = picture
    read, write = os.pipe()
    os.close(read)
    try:
        done = run(arguments, stdout=write, stderr=subprocess.PIPE, text=True)
    finally:
        os.close(write)
    expect_one_line(done, "cannot be written: Broken pipe")
    assert file.exists()


@pytest.mark.slow
def test_a_closed_standard_output_loses_only_the_words_and_no_file_takes_its_place(picture):
    arguments, file = picture
    words = " ".join(f"'{word}'" for word in [*COMMAND, *arguments])
    done = subprocess.run(["sh", "-c", f"{words} >&-"], stderr=subprocess.PIPE, text=True)
    expect_one_line(done, "is closed")
    assert file.read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_a_full_or_closed_standard_error_ends_nothing(picture):
    arguments, file = picture
    words = " ".join(f"'{word}'" for word in [*COMMAND, *arguments])
    with Path("/dev/full").open("w") as full:
        assert run(["no-such-command"], stderr=full).returncode == 2
    done = subprocess.run(["sh", "-c", f"{words} 2>&-"], stdout=subprocess.PIPE, text=True)
    assert done.returncode == 0
    assert file.exists()


TWICE = """
import sys
from gridpush_drake.cli.main import main
for more in ([], ["--json", "--force"]):
    try:
        main([*sys.argv[1:], *more])
    except SystemExit as ended:
        assert not ended.code
"""


@pytest.mark.slow
def test_letters_that_the_encoding_lacks_are_escaped(picture):
    """In words, and so that JSON can still be read."""
    arguments, file = picture
    done = subprocess.run(
        [sys.executable, "-c", TWICE, *map(str, arguments)],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONIOENCODING": "ascii"},
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert file.exists()
    words, start, document = done.stdout.partition("{")
    assert "H\\xe4mmerchen" in words
    assert json.loads(start + document)["object"] == "Hämmerchen"


@pytest.fixture
def small_disk():
    """A disk on which files of more than some bytes are refused, as a full one refuses them."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)

    def limit(size):
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))

    yield limit
    resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize(
    ("command", "first", "second"),
    [
        (["identify"], ("--out", "new.yaml"), ("--report", "report.html")),
        (["plan", "--goal", "0.02,0,0"], ("--out", "plan.yaml"), ("--picture", "plan.png")),
        (
            ["simulate", "--start", "0,-0.1", "--velocity", "0,0.05", "--duration", "2"],
            ("--out", "push.csv"),
            ("--picture", "push.png"),
        ),
    ],
)
def test_a_full_disk_leaves_all_outputs_or_none(
    gridpush, block, pushes, tmp_path, small_disk, command, first, second
):
    inputs = [block, pushes] if command == ["identify"] else [block]
    outputs = [first[0], tmp_path / first[1], second[0], tmp_path / second[1]]
    before = sorted(tmp_path.iterdir())
    small_disk(65536 if command == ["identify"] else 8192)
    done = gridpush(command[0], *inputs, *command[1:], *outputs)
    assert done.code == 2
    assert done.err.endswith(f"{outputs[3]}: cannot be written: File too large\n")
    assert sorted(tmp_path.iterdir()) == before
