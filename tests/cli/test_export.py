import json

import pytest

from tests.helpers.made_identifications import make_identification
from tests.helpers.plant_object import parse_sdf


def test_writes_a_learned_model_that_drake_loads(gridpush, model, tmp_path):
    out = tmp_path / "block.sdf"
    outcome = gridpush("export", model, out)
    assert outcome.code == 0, outcome.err
    assert "learned model" in outcome.out and str(out) in outcome.out
    plant, _ = parse_sdf(out)
    assert (plant.num_positions(), plant.GetBodyByName("block").default_mass()) == (
        7,
        pytest.approx(make_identification().params.total_mass, rel=1e-6),
    )


def test_writes_an_object_held_to_the_plane(gridpush, tmp_path):
    out = tmp_path / "book.sdf"
    document = json.loads(
        gridpush("export", "open_book", out, "--base", "planar", "--height", "0.05", "--json").out
    )
    assert document["base"] == "planar"
    assert document["total_mass"] == pytest.approx(0.92)
    plant, _ = parse_sdf(out)
    assert plant.num_positions() == 3


def test_height_and_mass_are_those_of_the_file(gridpush, tmp_path):
    file, out = tmp_path / "tall.yaml", tmp_path / "tall.sdf"
    file.write_text("name: tall\noutline: [[0, 0], [0.1, 0], [0.1, 0.1], [0, 0.1]]\nheight: 0.08\n")
    for given, height in (((), 0.08), (("--height", 0.05), 0.05)):
        told = gridpush("export", file, out, *given, "--force", "--json")
        assert json.loads(told.out)["height"] == height
        assert told.err == "tall: its file has no total_mass; 1 kg is assumed\n"
        plant, _ = parse_sdf(out)
        middle = plant.GetBodyByName("tall").default_com()
        assert middle[2] == pytest.approx(height / 2)
    told = gridpush("export", "open_book", tmp_path / "book.sdf")
    assert "30 mm high" in told.out and not told.err


@pytest.mark.parametrize(
    ("name", "given", "begins"),
    [
        ("book.urdf", (), '<?xml version="1.0"?>\n<robot'),
        ("book.xml", (), "<mujoco"),
        ("book.mjcf", (), "<mujoco"),
        ("book.txt", ("--format", "mjcf"), "<mujoco"),
    ],
)
def test_the_format_follows_the_name_or_is_given(gridpush, tmp_path, name, given, begins):
    out = tmp_path / name
    document = json.loads(gridpush("export", "open_book", out, *given, "--json").out)
    assert document["format"] in ("urdf", "mjcf")
    text = out.read_text()
    assert text.startswith(begins)
    assert (
        text.count("friction") >= document["cells"] or text.count("mu_static") >= document["cells"]
    )


def test_replaces_a_file_only_when_told(gridpush, refuses, block, tmp_path):
    out = tmp_path / "block.sdf"
    out.write_text("mine")
    refuses("export", block, out, says=[out, "--force"])
    assert out.read_text() == "mine"
    assert gridpush("export", block, out, "--force").code == 0
    assert out.read_text().startswith("<?xml")


def test_refuses_what_makes_no_sense(refuses, block, tmp_path):
    out = tmp_path / "block.sdf"
    refuses(
        "export",
        block,
        tmp_path / "block.usd",
        says=["OUT", "block.usd", ".sdf", ".urdf", ".xml", "--format"],
    )
    refuses(
        "export", block, tmp_path / "block.xml", "--base", "planar", says=["base", "planar", "mjcf"]
    )
    refuses("export", block, tmp_path / "missing" / "block.sdf", says=["missing", "does not exist"])
    refuses("export", block, out, "--height", "0", says=["--height: is 0; expected a positive"])
    refuses("export", block, out, "--height", "nan", says=["--height: is nan"])
    refuses("export", block, out, "--base", "flying", says=["flying"])
    refuses("export", "claw_hamer", out, says=["claw_hamer"])
    refuses("export", tmp_path / "nothing.yaml", out, says=["nothing.yaml"])
    assert not out.exists()


def test_draws_of_a_model(gridpush, model, tmp_path):
    out = tmp_path / "block.sdf"
    told = gridpush("export", model, out, "--samples", "12", "--seed", "3", "--json")
    assert told.code == 0, told.err
    document = json.loads(told.out)
    names = [f"block_{i:02}.sdf" for i in range(1, 13)]
    assert document["written"] == [str(tmp_path / name) for name in names]
    assert (document["samples"], document["seed"]) == (12, 3)
    assert not out.exists()
    found = make_identification()
    for name, params in zip(names, found.draws(12, seed=3), strict=True):
        plant, _ = parse_sdf(tmp_path / name)
        body = plant.GetBodyByName("block")
        assert body.default_mass() == pytest.approx(params.total_mass, rel=1e-6)
        center = params.center_of_mass(found.obj)
        assert body.default_com()[:2] == pytest.approx(center, abs=1e-6)
    centers = {
        parse_sdf(tmp_path / name)[0].GetBodyByName("block").default_com()[0] for name in names
    }
    assert len(centers) == 12
    one = gridpush("export", model, tmp_path / "one.xml", "--samples", "1")
    assert f"Wrote {tmp_path / 'one_1.xml'}." in " ".join(one.out.split())


def test_draws_want_a_model_and_replace_nothing(refuses, model, block, tmp_path):
    refuses("export", block, tmp_path / "b.sdf", "--samples", "2", says=["--samples", "model.yaml"])
    (tmp_path / "b_2.sdf").write_text("mine")
    refuses("export", model, tmp_path / "b.sdf", "--samples", "3", says=["b_2.sdf", "--force"])
