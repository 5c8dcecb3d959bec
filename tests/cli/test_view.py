import json
import signal
import subprocess
import sys
from urllib.request import urlopen

import pytest

from gridpush_drake.display.cell_colors import CellColors
from gridpush_drake.display.server import StartMeshcatServer, looks_like_recording
from gridpush_drake.display.shapes import CENTER_COLOR, PLAN_COLOR
from gridpush_drake.identification.model_file import write_model
from tests.helpers.chromium import find_pixels, freeze_recording, require_chromium, take_picture
from tests.helpers.made_identifications import make_block, make_identification

PLAN = (PLAN_COLOR.r(), PLAN_COLOR.g(), PLAN_COLOR.b())
CENTER = (CENTER_COLOR.r(), CENTER_COLOR.g(), CENTER_COLOR.b())


@pytest.mark.parametrize("kind", ["model", "object"])
def test_writes_a_page_of_a_model_or_an_object(gridpush, model, block, tmp_path, kind):
    out = tmp_path / "page.html"
    outcome = gridpush("view", {"model": model, "object": block}[kind], "--out", out, "--json")
    assert outcome.code == 0, outcome.err
    document = json.loads(outcome.out)
    assert (document["kind"], document["object"], document["written"]) == (
        kind,
        "block",
        [str(out)],
    )
    assert looks_like_recording(out)


def test_replays_pushes_with_the_model_beside_them(gridpush, pushes, model, tmp_path):
    out = tmp_path / "page.html"
    outcome = gridpush("view", pushes, "--out", out)
    assert outcome.code == 0, outcome.err
    assert "5 pushes" in outcome.out
    assert "Mean cell error" in outcome.out
    assert f"Wrote {out}." in outcome.out


def test_replays_the_pushes_of_an_object_without_a_model(gridpush, pushes, block, tmp_path):
    out = tmp_path / "page.html"
    document = json.loads(gridpush("view", pushes, "--object", block, "--out", out, "--json").out)
    assert (document["errors"], len(document["pushes"])) == ([], 5)
    make_block().write_yaml(tmp_path / "object.yaml")
    assert gridpush("view", pushes, "--out", out, "--force").code == 0


def test_replays_the_pushes_that_are_named(gridpush, pushes, model, tmp_path):
    names = json.loads(gridpush("view", pushes, "--out", tmp_path / "all.html", "--json").out)[
        "pushes"
    ]
    chosen = ["--push", names[3], "--push", names[1]]
    document = json.loads(
        gridpush("view", pushes, *chosen, "--out", tmp_path / "page.html", "--json").out
    )
    assert document["pushes"] == [names[1], names[3]]


def test_refuses(refuses, pushes, block, model, tmp_path):
    out = ("--out", tmp_path / "page.html")
    refuses("view", tmp_path / "none.csv", *out, says=["none.csv", "no such file"])
    refuses("view", tmp_path / "none.yaml", *out, says=["none.yaml"])
    refuses("view", "claw_hamer", *out, says=["claw_hamer"])
    refuses("view", pushes, "--push", "push_99", *out, says=["--push", "push_99"])
    refuses("view", pushes, "--model", block, *out, says=["--model", block, "is not a model"])
    refuses("view", pushes, "--model", model, "--object", block, *out, says=["--object", "--model"])
    refuses("view", model, "--push", "push_01", *out, says=["--push", ".csv"])
    refuses("view", model, "--height", "0", *out, says=["--height", "positive"])
    refuses("view", model, "--out", tmp_path, says=[tmp_path, "is a folder"])
    page = tmp_path / "old.html"
    page.write_text("a page")
    refuses("view", model, "--out", page, says=[page, "--force"])
    model.unlink()
    refuses("view", pushes, *out, says=[pushes, "--object", "model.yaml"])


def test_a_film_is_of_a_recording_only(refuses, model, tmp_path):
    refuses("view", model, "--film", tmp_path / "film.gif", says=["is not a recording"])
    refuses("view", tmp_path / "none.html", "--film", tmp_path / "film.gif", says=["no such file"])
    assert not (tmp_path / "film.gif").exists()


def test_refuses_a_port_in_use(refuses, model):
    server = StartMeshcatServer(0)
    port = server.port()
    refuses("view", model, "--no-open", "--port", port, says=[f"port {port}", "in use"])


def test_prints_where_a_recording_is(gridpush, model, tmp_path):
    recording = tmp_path / "recording.html"
    assert gridpush("view", model, "--out", recording).code == 0
    outcome = gridpush("view", recording, "--no-open")
    assert outcome.code == 0
    assert recording.as_uri() in outcome.out
    document = json.loads(gridpush("view", recording, "--no-open", "--json").out)
    assert (document["kind"], document["url"], document["opened"]) == (
        "recording",
        recording.as_uri(),
        False,
    )


def test_refuses_what_is_not_a_recording(refuses, tmp_path):
    report = tmp_path / "report.html"
    report.write_text("<html><title>Report</title></html>")
    refuses("view", report, "--no-open", says=[report, "is not a recording"])
    refuses("view", tmp_path / "none.html", "--no-open", says=["none.html", "no such file"])
    refuses("view", report, "--out", tmp_path / "page.html", says=["--out", "is a page already"])


@pytest.mark.slow
def test_serves_until_it_is_interrupted(model):
    command = [
        sys.executable,
        "-m",
        "gridpush_drake.cli.main",
        "view",
        str(model),
        "--no-open",
        "--port",
        "0",
        "--json",
    ]
    with subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        preexec_fn=lambda: signal.signal(
            signal.SIGINT, signal.SIG_DFL
        ),  # a shell's background jobs ignore it
    ) as process:
        printed = b"".join(iter(process.stdout.readline, b"}\n")) + b"}"
        with urlopen(json.loads(printed)["url"]) as page:
            assert b"Drake MeshCat" in page.read()
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=30)
    assert (process.returncode, err) == (0, b"")


@pytest.mark.slow
def test_a_model_s_page_shows_its_cells_in_their_colors(gridpush, tmp_path):
    require_chromium()
    model, out = tmp_path / "model.yaml", tmp_path / "page.html"
    result = make_identification()
    write_model(model, result)
    assert gridpush("view", model, "--out", out).code == 0
    picture = take_picture(freeze_recording(out, 0.0, tmp_path / "still.html"))
    colors = CellColors().calc_colors(result.params.mass, result.params.friction)
    seen = [find_pixels(picture, color).sum() for color in colors]
    assert min(seen) > 300
    assert find_pixels(picture, CENTER).any()


@pytest.mark.slow
def test_a_replay_shows_the_prediction_where_there_is_a_model(
    gridpush, pushes, block, model, tmp_path
):
    require_chromium()
    seen = []
    for what in (("--model", model), ("--object", block)):
        out = tmp_path / "page.html"
        assert gridpush("view", pushes, *what, "--out", out, "--force").code == 0
        seen.append(
            find_pixels(
                take_picture(freeze_recording(out, 1.0, tmp_path / "still.html")), PLAN
            ).sum()
        )
    assert seen[1] > 0  # the push's arrow
    assert seen[0] > seen[1] + 300  # and the ghost
