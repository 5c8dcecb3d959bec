"""`--rerun`: a run as a file for the Rerun viewer."""

import pytest

from tests.helpers.command_line import run_gridpush
from tests.helpers.rerun_files import ENTITIES, print_rerun

SCENARIO = """
object: open_book
object_pose: [0.55, 0.0, 0.0]
base: planar
pokes: {count: 1, test_count: 0, speed: 0.06}
"""


@pytest.mark.slow
def test_a_demo_is_written_for_the_viewer(capsys, tmp_path):
    pytest.importorskip("rerun", reason="rerun-sdk is not installed")
    (tmp_path / "scenario.yaml").write_text(SCENARIO)
    file = tmp_path / "run.rrd"
    arguments = ["--task", "identify", "--scenario", tmp_path / "scenario.yaml"]
    done = run_gridpush(capsys, "demo", *arguments, "--out", tmp_path / "out", "--rerun", file)
    assert done.code == 0, done.err
    assert list(tmp_path.glob("*.rrd")) == [file]
    printed = print_rerun(file)
    for entity in ENTITIES:
        assert entity in printed, entity
    again = run_gridpush(capsys, "demo", *arguments, "--out", tmp_path / "b", "--rerun", file)
    assert again.code == 2
    assert "run.rrd" in again.err
