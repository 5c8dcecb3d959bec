import json

import numpy as np
import pytest
from PIL import Image


@pytest.mark.parametrize("target", ["block", "model", "open_book"])
def test_draws_a_picture(gridpush, block, model, tmp_path, target):
    out = tmp_path / "picture.png"
    outcome = gridpush("show", {"block": block, "model": model}.get(target, target), "--out", out)
    assert outcome.code == 0, outcome.err
    assert str(out) in outcome.out
    with Image.open(out) as image:
        assert image.width > 300


def test_prints_one_json_document(gridpush, block, tmp_path):
    document = json.loads(gridpush("show", block, "--out", tmp_path / "picture.png", "--json").out)
    assert (document["kind"], document["cells"], document["parts"]) == ("object", 18, [1, 2])


def test_replaces_a_picture_only_when_told(gridpush, refuses, block, tmp_path):
    out = tmp_path / "picture.png"
    out.write_text("mine")
    refuses("show", block, "--out", out, says=[out, "--force"])
    assert out.read_text() == "mine"
    assert gridpush("show", block, "--out", out, "--force").code == 0
    assert out.read_bytes().startswith(b"\x89PNG")


def test_refuses_a_folder_that_cannot_be_written(refuses, block, tmp_path):
    refuses(
        "show",
        block,
        "--out",
        tmp_path / "missing" / "picture.png",
        says=["missing", "does not exist"],
    )
    refuses("show", block, "--out", block / "picture.png", says=["picture.png", "does not exist"])
    refuses("show", block, "--out", "/proc/picture.png", says=["/proc/picture.png", "cannot write"])
    refuses("show", block, "--out", tmp_path, says=[tmp_path, "is a folder"])


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", ["is empty"]),
        ("name: a\noutlines: [[0, 0], [1, 0], [0, 1]]\n", ["outlines", "unknown key", "outline"]),
        ("outline: [[0, 0], [1, 0], [0, 1]]\ntotal_mass: -1\n", ["total_mass", "-1", "positive"]),
        ("outline: [[0, 0], [1, 0], [0, 1]]\nmax_cells: 0\n", ["max_cells", "1 or more"]),
        ("outline: [[0, 0], [1, 0\n", ["line", "YAML"]),
        ("mask: {image: none.png, meters_per_pixel: 0.001}\n", ["none.png"]),
        ("mask: {image: wrong.png, meters_per_pixel: 0.001}\n", ["wrong.png"]),
        ("mask: {image: color.png, meters_per_pixel: 0.001}\n", ["color.png"]),
        ("mask: {image: pieces.png, meters_per_pixel: 0.001}\n", ["pieces.png", "--largest-piece"]),
    ],
)
def test_refuses_an_object(refuses, tmp_path, text, says):
    (tmp_path / "wrong.png").write_text("not a picture")
    Image.new("RGB", (4, 4), (255, 0, 0)).save(tmp_path / "color.png")
    pieces = np.zeros((20, 30), dtype=np.uint8)
    pieces[2:8, 2:8] = pieces[10:18, 10:28] = 1
    Image.fromarray(pieces).save(tmp_path / "pieces.png")
    path = tmp_path / "object.yaml"
    path.write_text(text)
    refuses("show", path, "--out", tmp_path / "picture.png", says=[path, *says])


def test_keeps_the_largest_piece_when_told(gridpush, tmp_path):
    pieces = np.zeros((20, 30), dtype=np.uint8)
    pieces[2:8, 2:8] = pieces[10:18, 10:28] = 1
    Image.fromarray(pieces).save(tmp_path / "pieces.png")
    path = tmp_path / "object.yaml"
    path.write_text("mask: {image: pieces.png, meters_per_pixel: 0.001}\n")
    outcome = gridpush("show", path, "--out", tmp_path / "picture.png", "--largest-piece")
    assert outcome.code == 0, outcome.err


def test_says_that_a_mask_may_be_inverted(gridpush, tmp_path):
    inverted = np.full((20, 30), 255, dtype=np.uint8)
    inverted[5:15, 8:22] = 0
    Image.fromarray(inverted).save(tmp_path / "inverted.png")
    path = tmp_path / "object.yaml"
    path.write_text("mask: {image: inverted.png, meters_per_pixel: 0.001}\n")
    outcome = gridpush("show", path, "--out", tmp_path / "picture.png")
    assert outcome.code == 0
    assert (
        outcome.err.startswith("gridpush: warning: ")
        and "inverted.png: is the mask inverted?" in outcome.err
    )
    assert outcome.err.count("\n") == 1


def test_refuses_a_file_that_is_not_there(refuses, tmp_path):
    refuses("show", tmp_path / "none.yaml", "--out", tmp_path / "picture.png", says=["none.yaml"])


def test_a_picture_s_name_ends_as_its_form_does(refuses, tmp_path):
    refuses(
        "show",
        "claw_hammer",
        "--out",
        tmp_path / "hammer.pdf",
        says=["--out", "hammer.pdf", "ends with .png"],
    )
    refuses(
        "view",
        "claw_hammer",
        "--out",
        tmp_path / "hammer.txt",
        says=["--out", "hammer.txt", "ends with .html"],
    )
    assert not list(tmp_path.iterdir())


def test_one_of_a_kind_is_said_so(gridpush, tmp_path):
    cell = tmp_path / "cell.yaml"
    cell.write_text(
        "name: cell\noutline: [[0, 0], [0.05, 0], [0.05, 0.05], [0, 0.05]]\nmax_cells: 1\n"
    )
    out = gridpush("show", cell, "--out", tmp_path / "cell.png").out
    assert "1 cell of 50.0 mm, 1 part\n" in out
