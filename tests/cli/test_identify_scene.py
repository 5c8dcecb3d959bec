"""`gridpush identify --with`: several objects from one log, their models and the page about them."""

import json

import pytest

from gridpush_drake.display.server import looks_like_recording
from gridpush_drake.identification.model_file import read_model
from gridpush_drake.pushes.push_log import PushLog
from tests.identification.test_joint_fit import make_truth, push_scene


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Two objects' files, and a log in which each pushes the other."""
    folder = tmp_path_factory.mktemp("scene")
    truth = make_truth()
    for name, obj in zip(("left", "right"), truth.objects, strict=True):
        obj.write_yaml(folder / f"{name}.yaml")
    log = PushLog(tuple(push_scene(truth, seed) for seed in range(4)), names=("left", "right"))
    log.write_csv(folder / "pushes.csv")
    return folder


def test_both_objects_get_a_model_and_a_place_on_the_page(gridpush, files, undrawn):
    model = files / "model.yaml"
    report = files / "report.html"
    outcome = gridpush(
        "identify", f"left={files / 'left.yaml'}", files / "pushes.csv",
        "--with", f"right={files / 'right.yaml'}", "--out", model, "--report", report, "--json",
    )  # fmt: skip
    assert outcome.code == 0, outcome.err
    found = json.loads(outcome.out)
    assert [each["name"] for each in found["objects"]] == ["left", "right"]
    assert found["pair_friction"][0]["objects"] == ["left", "right"]
    for each in found["objects"]:
        assert each["moved"]
        assert each["mean_cell_error"] < each["mean_cell_error_before"]
        written = read_model(files / f"model_{each['name']}.yaml")
        assert written.obj.n == each["cells"]
        assert written.push_names == ("push 0", "push 1", "push 2", "push 3")
        center = written.identifiability.center_of_friction
        assert center == pytest.approx(each["center_of_friction"], abs=1e-9)
    page = report.read_text()
    assert page.count("data:image/svg+xml") == 6
    assert "friction of left and right" in page


def test_a_replay_shows_all_objects_beside_their_predictions(gridpush, files):
    page = files / "replay.html"
    outcome = gridpush(
        "view", files / "pushes.csv", "--with", f"left={files / 'model_left.yaml'}",
        "--with", f"right={files / 'model_right.yaml'}", "--push", "push 1", "--out", page, "--json",
    )  # fmt: skip
    assert outcome.code == 0, outcome.err
    found = json.loads(outcome.out)
    assert found["objects"] == ["left", "right"]
    assert found["pushes"] == ["push 1"]
    assert max(found["cell_errors"][0]) < 0.005
    assert looks_like_recording(page)
    outcome = gridpush("view", files / "pushes.csv", "--with", f"left={files / 'left.yaml'}")
    assert outcome.code == 2
    assert "has the columns of left, right" in outcome.err.replace("\n", " ")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["left={0}/left.yaml", "--with", "left={0}/right.yaml"], "two objects are called 'left'"),
        (
            ["left={0}/left.yaml", "--with", "wrong={0}/right.yaml"],
            "has the columns of left, right",
        ),
        (
            ["left={0}/left.yaml", "--with", "right={0}/right.yaml", "--method", "paper"],
            "--method: is for one object",
        ),
        (["left={0}/left.yaml", "--with", "right="], "'right=' names no file; expected NAME=FILE"),
        (["={0}/left.yaml", "--with", "right={0}/right.yaml"], "names no object; expected NAME="),
    ],
)
def test_what_is_refused(gridpush, files, arguments, message):
    first, *rest = (text.format(files) for text in arguments)
    outcome = gridpush("identify", first, files / "pushes.csv", *rest, "--out", files / "no.yaml")
    assert outcome.code == 2
    assert message in outcome.err.replace("\n", " ")
    assert not list(files.glob("no*"))
