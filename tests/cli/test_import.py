import dataclasses
import json

import pytest

from gridpush_drake.objects.grid_object import GridObject
from gridpush_drake.pushes.importers import IMPORTER_CLASSES, find_importer
from gridpush_drake.pushes.importers.cmu import triangle_block
from gridpush_drake.pushes.push_log import PushLog
from tests.helpers.shared_data import shared_data


def test_cmu_pushes(gridpush, tmp_path):
    source = shared_data("cmu_pushes", "plywood_wide.txt")
    outcome = gridpush("import", "cmu", source, "--out-dir", tmp_path / "new", "--json")
    assert outcome.code == 0, outcome.err
    assert json.loads(outcome.out)["pushes"] == 50
    log, obj = (
        PushLog.read_csv(tmp_path / "new" / "pushes.csv"),
        GridObject.from_yaml(tmp_path / "new" / "object.yaml"),
    )
    assert len(log) == 50
    assert obj.n == triangle_block().n
    assert obj.prior.pusher_radius == 0.0005
    assert obj.prior.center_of_mass is None


def test_mit_pushes(gridpush, tmp_path):
    source = shared_data("mit_pushes", "abs_rect1.mat")
    csv, yaml = tmp_path / "a.csv", tmp_path / "b.yaml"
    outcome = gridpush("import", "mit", source, "--out-csv", csv, "--out-object", yaml)
    assert outcome.code == 0, outcome.err
    assert len(PushLog.read_csv(csv)) > 300
    assert GridObject.from_yaml(yaml).name == "rect1"


@pytest.mark.parametrize("kind", ["cmu", "mit"])
def test_refuses(refuses, tmp_path, kind):
    path = tmp_path / "bad.txt"
    path.write_text("no pushes here")
    outputs = ("--out-csv", tmp_path / "a.csv", "--out-object", tmp_path / "b.yaml")
    refuses("import", kind, path, *outputs, says=[path])
    refuses("import", kind, tmp_path / "none.txt", *outputs, says=["none.txt"])
    refuses("import", kind, path, says=["--out-dir", "--out-csv"])
    refuses("import", kind, path, *outputs[:2], says=["--out-dir", "--out-object"])
    refuses("import", kind, path, "--out-dir", path, says=[path, "folder"])
    refuses("import", kind, path, "--out-dir", tmp_path / "new", says=[path])
    (tmp_path / "a.csv").write_text("mine")
    refuses("import", kind, path, *outputs, says=["a.csv", "--force"])


@pytest.mark.parametrize("name", IMPORTER_CLASSES)
def test_its_options_are_those_of_the_command(name, gridpush):
    outcome = gridpush("import", name, "--help")
    assert outcome.code == 0
    for field in dataclasses.fields(find_importer(name)):
        assert field.metadata.get("name", "--" + field.name.replace("_", "-")) in outcome.out
