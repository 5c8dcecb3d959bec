import dataclasses
import re

import numpy as np
import pytest
import shapely

from gridpush_drake.errors import IdentificationError, ObjectError, OutputError
from gridpush_drake.identification.model_file import looks_like_model, read_model, write_model
from gridpush_drake.identification.statistics.noise import NoiseModel
from gridpush_drake.objects.grid_object import GridObject
from tests.helpers.made_identifications import OUTLINE, make_identification

HOLE = [[-0.03, -0.01], [-0.01, -0.01], [-0.01, 0.01], [-0.03, 0.01]]


def assert_same(first, second):
    assert type(first) is type(second)
    if dataclasses.is_dataclass(first):
        for field in dataclasses.fields(first):
            assert_same(getattr(first, field.name), getattr(second, field.name))
    elif isinstance(first, np.ndarray):
        np.testing.assert_array_equal(first, second)
    elif isinstance(first, shapely.Polygon):
        assert shapely.to_wkb(first) == shapely.to_wkb(second)
    elif isinstance(first, tuple):
        assert len(first) == len(second)
        for one, other in zip(first, second, strict=True):
            assert_same(one, other)
    else:
        assert first == second


@pytest.fixture
def model(tmp_path):
    path = tmp_path / "model.yaml"
    write_model(path, make_identification())
    return path


def test_gives_every_number_back(tmp_path):
    outline = shapely.Polygon(OUTLINE, [HOLE])
    identification = make_identification(
        GridObject.from_outline(outline, max_cells=60, name="block: with a 'hole'")
    )
    path = tmp_path / "model.yaml"
    write_model(path, identification)
    assert looks_like_model(path)
    restored = read_model(path)
    assert_same(identification, restored)
    assert_same(tuple(identification.draws(2)), tuple(restored.draws(2)))


def test_keeps_the_noise_that_was_supposed(tmp_path):
    supposed = NoiseModel(pose=0.002, outlier=1.5)
    path = tmp_path / "model.yaml"
    write_model(path, dataclasses.replace(make_identification(), noise=supposed))
    assert read_model(path).noise == supposed


def test_keeps_the_patch_and_takes_the_whole_cell_where_none_is_said(model, tmp_path):
    found = make_identification()
    path = tmp_path / "points.yaml"
    write_model(path, found.with_params(dataclasses.replace(found.params, patch_ratio=0.1)))
    assert read_model(path).params.patch_ratio == 0.1
    model.write_text(re.sub(r"patch_ratio: .*\n", "", model.read_text()))
    assert_same(read_model(model), found)


def test_keeps_an_existing_file(model):
    before = model.read_bytes()
    with pytest.raises(OutputError, match="--force"):
        write_model(model, make_identification(seed=1))
    assert model.read_bytes() == before
    write_model(model, make_identification(seed=1), force=True)
    assert model.read_bytes() != before


@pytest.mark.parametrize(
    ("old", "new", "messages"),
    [
        ("gridpush_model: 2", "gridpush_model: 1", ["gridpush_model is 1", "expected 2"]),
        ("method: default", "methods: default", ["methods: unknown key", "did you mean method?"]),
        ("status: learned", "status: lucky", ["status", "'learned'", "'budget_spent'"]),
        ("seed: 0", "seed: zero", ["seed", "integer"]),
        ("seed: 0", "seed: 0\ncolor: red", ["color: unknown key", "expected one of gridpush_model, method"]),
        ("  mass: [0", "  mass: [-0", ["cells.mass[0]", "greater than 0"]),
        ("  mass: [0", "  mass: [1.0, 0", ["mass", "expected one a cell, 18"]),
        ("  mean: [", "  mean: [1.0, ", ["posterior.mean", "19"]),
        ("  covariance: |\n    ", "  covariance: |\n    !", ["posterior.covariance", "base64"]),
        ("  covariance: |\n    ", "  covariance: |\n    AAAAAAAA", ["posterior.covariance", "expected"]),
        ("contact_friction: 0.43", "contact_friction: .nan", ["contact_friction", "finite"]),
        ("outline: [", "outline: [[0.0, 1.0], ", ["outline"]),
        ("    size: ", "    cell_size: ", ["object.cells.cell_size: unknown key", "expected one of size"]),
        ("  name: block", "  title: block", ["object.title: unknown key"]),
    ],
)  # fmt: skip
def test_refuses_what_is_not_a_model(model, old, new, messages):
    text = model.read_text()
    assert old in text
    model.write_text(text.replace(old, new, 1))
    with pytest.raises(IdentificationError) as raised:
        read_model(model)
    for message in (str(model), *messages):
        assert message in str(raised.value)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("content", "message"),
    [(b"", "is empty"), (b"\x00\xff", "not UTF-8"), (b"[1", "not valid YAML")],
)
def test_refuses_other_files(tmp_path, content, message):
    path = tmp_path / "model.yaml"
    path.write_bytes(content)
    assert not looks_like_model(path)
    with pytest.raises(ObjectError, match=message):
        read_model(path)


def test_says_that_there_is_no_file(tmp_path):
    assert not looks_like_model(tmp_path / "none.yaml")
    with pytest.raises(ObjectError, match="No such file"):
        read_model(tmp_path / "none.yaml")


@pytest.mark.parametrize(
    ("line", "old", "new"),
    [
        ("  name: block\n", "object.centre_of_mass", "called center_of_mass now"),
        ("  name: block\n", "object.cell_size", "called object.cells.size now"),
        ("  name: block\n", "object.prior", "stand in object now: total_mass"),
        ("  cells:\n", "object.cells.centres", "called centers now"),
        ("\ncells:\n", "cells.p_BC", "called object.cells.centers now"),
        ("\ncells:\n", "cells.labels", "called object.cells.labels now"),
        (
            "identifiability:\n",
            "identifiability.centre_of_friction",
            "called center_of_friction now",
        ),
        (
            "identifiability:\n",
            "identifiability.centre_of_friction_covariance",
            "called center_of_friction_covariance now",
        ),
        (
            "identifiability:\n",
            "identifiability.centre_of_mass_box",
            "called center_of_mass_box now",
        ),
    ],
)
def test_an_old_key_is_refused_with_its_new_name(model, line, old, new):
    text = model.read_text()
    assert line in text
    indent = " " * (2 * old.count("."))
    model.write_text(text.replace(line, f"{line}{indent}{old.rpartition('.')[2]}: 1\n", 1))
    with pytest.raises(IdentificationError, match=f"{re.escape(old)}: .*{re.escape(new)}"):
        read_model(model)
