import re

import numpy as np
import pytest
import yaml
from PIL import Image

from gridpush_drake.errors import ObjectError, OutputError
from gridpush_drake.objects.grid_object import GridObject, PhysicalPrior
from gridpush_drake.objects.object_file import (
    PartMaterial,
    SeenSchema,
    TagSchema,
    dump_object,
    find_shipped_object,
    list_shipped_objects,
    read_object_file,
)
from gridpush_drake.objects.outline import MAX_POINTS

FULL = """\
name: triangle_block
outline: [[-0.05, -0.05], [0.10, -0.05], [-0.05, 0.10]]
parts:
  - {label: 2, outline: [[-0.05, -0.05], [0.0, -0.05], [0.0, 0.10], [-0.05, 0.10]]}
max_cells: 60
total_mass: 1.518
center_of_mass: {at: [0.0, 0.001], std: 3e-3}
friction: {prior: 0.3, min: 0.1, max: 0.9}
contact_friction: {prior: 0.45, std: 0.1}
pusher: {radius: 0.0005}
uniform_parts: true
materials:
  - {label: 2, name: steel, density: 7.8e+3, spread: 1.2}
"""
BASE = "outline: [[0, 0], [0.1, 0], [0.1, 0.1]]\n"


def written(tmp_path, text):
    path = tmp_path / "object.yaml"
    path.write_text(text)
    return path


def test_whole_file(tmp_path):
    obj = GridObject.from_yaml(written(tmp_path, FULL))
    assert obj.name == "triangle_block"
    assert 50 <= obj.n <= 60
    assert set(obj.labels) == {1, 2}
    assert obj.prior == PhysicalPrior(
        1.518,
        (0.0, 0.001),
        0.003,
        0.3,
        0.1,
        0.9,
        0.45,
        0.1,
        0.0005,
        uniform_parts=True,
        materials=(PartMaterial(label=2, name="steel", density=7800.0, spread=1.2),),
    )
    obj.write_yaml(tmp_path / "again.yaml")
    assert GridObject.from_yaml(tmp_path / "again.yaml").prior == obj.prior


def test_outline_alone_is_enough(tmp_path):
    obj = GridObject.from_yaml(written(tmp_path, BASE))
    assert obj.name == "object"
    assert obj.prior == PhysicalPrior()
    assert 115 <= obj.n <= 127
    assert GridObject.from_yaml(tmp_path / "object.yaml").n == obj.n


def test_mask_is_looked_up_beside_the_file(tmp_path):
    labels = np.zeros((40, 60), np.uint8)
    labels[5:20, 5:30], labels[30:35, 50:55] = 4, 1
    Image.fromarray(labels).save(tmp_path / "m.png")
    path = written(
        tmp_path, "mask: {image: m.png, meters_per_pixel: 0.002}\nmax_cells: 60\ntotal_mass: 2\n"
    )
    with pytest.raises(ObjectError, match=r"object\.yaml.*2 separate pieces"):
        GridObject.from_yaml(path)
    obj = GridObject.from_yaml(path, largest_piece=True)
    assert set(obj.labels) == {4}
    assert obj.prior.total_mass == 2.0
    assert obj.outline.area == pytest.approx(15 * 25 * 4e-6, rel=0.01)


def test_holes_hold_no_cells(tmp_path):
    hole = "holes: [[[0.06, 0.01], [0.09, 0.01], [0.09, 0.04], [0.06, 0.04]]]\n"
    obj = GridObject.from_yaml(written(tmp_path, BASE + hole))
    assert len(obj.outline.interiors) == 1
    x, y = obj.p_BC.T
    assert not ((x > 0.06) & (x < 0.09) & (y > 0.01) & (y < 0.04)).any()


def test_pieces_of_one_part_may_be_listed_apart(tmp_path):
    square = "outline: [[0, 0], [1, 0], [1, 1], [0, 1]]\nmax_cells: 100\nparts:\n"
    ends = "  - {label: 2, outline: [[0, 0], [0.2, 0], [0.2, 1], [0, 1]]}\n"
    ends += "  - {label: 2, outline: [[0.8, 0], [1, 0], [1, 1], [0.8, 1]]}\n"
    obj = GridObject.from_yaml(written(tmp_path, square + ends))
    np.testing.assert_array_equal(obj.labels == 2, abs(obj.p_BC[:, 0] - 0.5) > 0.3)


@pytest.mark.parametrize(
    "text, message",
    [
        ("", "is empty"),
        ("- 1\n", "does not consist of `key: value` lines; expected an object file"),
        ("words", "does not consist of `key: value` lines"),
        ("name: [1\n", "line 2, column 1: is not valid YAML"),
        ("name: a\nname: b\n" + BASE, "line 2, column 1.*'name' occurs twice"),
        (BASE + "pusher: {radius: 1, radius: 2}\n", "'radius' occurs twice"),
        (BASE + "nmae: x\n", "nmae: unknown key; did you mean name"),
        (BASE + "1: x\n", "unknown key"),
        (BASE + "friction: {piror: 0.3}\n", r"friction\.piror: unknown key; did you mean prior"),
        (BASE + "name: 3\n", "name is 3; expected some text"),
        (BASE + "total_mass: -1\n", "total_mass is -1; expected a positive number, in kg"),
        (BASE + "total_mass: .nan\n", "total_mass is nan"),
        (BASE + "total_mass: .inf\n", "total_mass is inf"),
        (BASE + "total_mass: '3'\n", "total_mass is '3'"),
        (BASE + "total_mass: yes\n", "total_mass is .yes.; expected a positive number"),
        (BASE + "max_cells: 0\n", "max_cells is 0; expected a whole number"),
        (BASE + "max_cells: 1.5\n", "max_cells is 1.5"),
        (BASE + "friction: 0.3\n", "friction is 0.3; expected prior, min and max"),
        (BASE + "friction: {prior: 2}\n", r"friction\.prior is 2.*0\.05 to 1\.0"),
        (BASE + "friction: {min: 0}\n", r"friction\.min is 0; expected a positive number"),
        (BASE + "contact_friction: {prior: -0.1}\n", r"contact_friction\.prior is -0.1"),
        (BASE + "center_of_mass: {std: 0.1}\n", r"center_of_mass\.at is missing"),
        (BASE + "center_of_mass: {at: [0]}\n", r"center_of_mass\.at"),
        (
            BASE + "pusher: {radius: 0.005, height: 0}\n",
            r"pusher\.height is 0; expected a positive number, in meters",
        ),
        (
            BASE + "pusher: {radius: 0.005, height: 3}\n",
            r"pusher\.height is 3 m; expected less than 1 m",
        ),
        (
            BASE + "pusher: {}\n",
            r"pusher\.radius is missing; expected a positive number, in meters",
        ),
        (
            BASE + "parts: [{label: 0, outline: [[0, 0], [1, 0], [0, 1]]}]\n",
            r"parts\[0\]\.label is 0",
        ),
        (
            BASE + "parts: [{label: 1, outline: [[0, 0], [1, 0], [a, 1]]}]\n",
            r"parts\[0\]\.outline\[2\]\[0\] is 'a'",
        ),
        (
            BASE + "parts: [{label: 1, outline: [[0, 0], [1, 0], [2, 0]]}]\n",
            r"parts\[0\]\.outline encloses no area",
        ),
        (
            BASE + "materials: [{label: 3, name: oak, density: 700, spread: 1.2}]\n",
            r"materials\[0\]\.label is 3; expected a part that has cells: 1$",
        ),
        (
            BASE + "materials: [{label: 1, name: oak, density: -7, spread: 1.2}]\n",
            r"materials\[0\]\.density is -7; expected a positive number, in kg/m³",
        ),
        (
            BASE + "materials: [{label: 1, name: oak, density: 700, spread: 0.2}]\n",
            r"materials\[0\]\.spread is 0\.2; expected a factor, 1 or more",
        ),
        (
            BASE + 2 * "materials: [{label: 1, name: oak, density: 7, spread: 2}]\n",
            "'materials' occurs twice",
        ),
        (
            BASE + "materials:\n" + 2 * "  - {label: 1, name: oak, density: 7, spread: 2}\n",
            "materials: label 1 occurs twice",
        ),
        (BASE + "holes: [[[5, 5], [6, 5], [6, 6]]]\n", "outline is not a simple polygon"),
        (BASE + "mask: {image: a.png, meters_per_pixel: 1}\n", "both of outline and mask"),
        ("name: x\n", "neither of outline and mask"),
        ("mask: {image: a.png, meters_per_pixel: 0}\n", r"mask\.meters_per_pixel is 0"),
        ("mask: {image: a.png, meters_per_pixel: 1}\n", r"a\.png: cannot be read"),
        (
            "mask: {image: a.png, meters_per_pixel: 1}\nparts: [{label: 1, outline: [[0, 0], [1, 0], [0, 1]]}]\n",
            "parts",
        ),
        ("outline: [[0, 0], [1, 1], [1, 0], [0, 1]]\n", "must not cross itself"),
        ("outline: [[0, 0], [1, 1]]\n", "at least three points"),
        ("outline: [[0, 0], [true, 1], [1, 0]]\n", r"outline\[1\]\[0\] is True"),
        ("outline: [[0, 0], [.nan, 1], [1, 0]]\n", r"outline\[1\]\[0\] is nan"),
        ("!!python/object:os.system x", "is not valid YAML"),
        (BASE + "total_mass: 2024-13-45\n", "total_mass is .2024-13-45."),
        (BASE + "total_mass: 1:30\n", "total_mass is .1:30.; expected a positive number"),
        ("[" * 3000, "nested too deeply"),
        ("name: '\x00'\n", "is not valid YAML"),
    ],
)
def test_bad_files_are_refused_with_the_place_and_the_expected_form(tmp_path, text, message):
    path = written(tmp_path, text)
    with pytest.raises(ObjectError, match=message) as caught:
        GridObject.from_yaml(path)
    assert str(caught.value).startswith(str(path))
    assert "pydantic" not in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "old", "new"),
    [
        (BASE + "centre_of_mass: {at: [0, 0]}\n", "centre_of_mass", "center_of_mass"),
        (
            "mask: {image: a.png, metres_per_pixel: 1}\n",
            "mask.metres_per_pixel",
            "meters_per_pixel",
        ),
        (BASE + "cells: {size: 0.1, centres: [[0, 0]]}\n", "cells.centres", "centers"),
    ],
)
def test_an_old_key_is_refused_with_its_new_name(tmp_path, text, old, new):
    with pytest.raises(ObjectError, match=f"{re.escape(old)}: this key is called {new} now"):
        GridObject.from_yaml(written(tmp_path, text))


def test_what_is_no_text_file_is_refused(tmp_path):
    with pytest.raises(ObjectError, match="is a folder"):
        GridObject.from_yaml(tmp_path)
    with pytest.raises(ObjectError, match="cannot be read"):
        GridObject.from_yaml(tmp_path / "none.yaml")
    (tmp_path / "b.yaml").write_bytes(b"\x80\xff\x00")
    with pytest.raises(ObjectError, match="UTF-8"):
        GridObject.from_yaml(tmp_path / "b.yaml")


def test_written_object_is_read_back_as_it_was(tmp_path):
    first = GridObject.from_yaml(
        written(tmp_path, FULL + "holes: [[[-0.03, -0.03], [-0.01, -0.03], [-0.01, -0.01]]]\n")
    )
    first.write_yaml(tmp_path / "copy.yaml")
    copy = GridObject.from_yaml(tmp_path / "copy.yaml")
    np.testing.assert_array_equal(copy.p_BC, first.p_BC)
    np.testing.assert_array_equal(copy.labels, first.labels)
    assert copy.cell_size == first.cell_size
    assert copy.name == first.name and copy.prior == first.prior
    assert copy.outline.equals(first.outline)


def test_labels_that_enclose_others_survive_writing(tmp_path):
    square = [[0, 0], [1, 0], [1, 1], [0, 1]]
    inner = [[0.4, 0.4], [0.6, 0.4], [0.6, 0.6], [0.4, 0.6]]
    middle = [[0.2, 0.2], [0.8, 0.2], [0.8, 0.8], [0.2, 0.8]]
    first = GridObject.from_outline(square, parts={5: inner, 3: middle}, max_cells=100)
    first.write_yaml(tmp_path / "a.yaml")
    np.testing.assert_array_equal(GridObject.from_yaml(tmp_path / "a.yaml").labels, first.labels)


@pytest.mark.parametrize("name", list_shipped_objects())
def test_an_object_is_given_back_bit_for_bit(tmp_path, name):
    obj = GridObject.from_yaml(find_shipped_object(name))
    obj.write_yaml(tmp_path / "a.yaml")
    copy = GridObject.from_yaml(tmp_path / "a.yaml")
    for array in ("p_BC", "labels"):
        np.testing.assert_array_equal(getattr(copy, array), getattr(obj, array))
    np.testing.assert_array_equal(copy.edges.start, obj.edges.start)
    assert (copy.name, copy.cell_size, copy.prior) == (obj.name, obj.cell_size, obj.prior)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (
            BASE + "cells: {size: 0.01, centers: [[0.05, 0.02]]}\nmax_cells: 3\n",
            "expected no mask, parts or max_cells",
        ),
        (
            BASE + "cells: {size: 0.01, centers: [[0.05, 0.02]], labels: [1, 2]}\n",
            "has 2 entries; expected 1",
        ),
        (
            BASE + "cells: {size: 0, centers: [[0.05, 0.02]]}\n",
            "cells.size is 0; expected a positive",
        ),
        (BASE + "cells: {size: 0.01, centers: []}\n", "cells.centers"),
    ],
)
def test_cells_that_make_no_sense_are_refused(tmp_path, text, says):
    with pytest.raises(ObjectError, match=re.escape(says)):
        GridObject.from_yaml(written(tmp_path, text))


def test_object_without_priors_is_written_short(tmp_path):
    obj = GridObject.from_outline([[0, 0], [1, 0], [1, 1], [0, 1]], max_cells=100, name="on")
    obj.write_yaml(tmp_path / "a.yaml")
    data = yaml.safe_load((tmp_path / "a.yaml").read_text())
    assert set(data) == {"name", "outline", "cells", "friction", "contact_friction"}
    copy = GridObject.from_yaml(tmp_path / "a.yaml")
    assert (copy.n, copy.name) == (100, "on")


def test_existing_file_is_kept_unless_forced(tmp_path):
    obj = GridObject.from_yaml(written(tmp_path, BASE))
    with pytest.raises(OutputError, match="--force"):
        obj.write_yaml(tmp_path / "object.yaml")
    obj.write_yaml(tmp_path / "object.yaml", force=True)
    assert GridObject.from_yaml(tmp_path / "object.yaml").outline.equals(obj.outline)


def test_height_and_where_it_was_seen_are_kept(tmp_path):
    plain = GridObject.from_outline([[0, 0], [0.1, 0], [0.1, 0.05], [0, 0.05]], max_cells=8)
    tall = GridObject("tall", *plain.grid, plain.prior, 0.04)
    tall.write_yaml(tmp_path / "tall.yaml")
    assert GridObject.from_yaml(tmp_path / "tall.yaml").height == 0.04
    plain.write_yaml(tmp_path / "plain.yaml")
    assert GridObject.from_yaml(tmp_path / "plain.yaml").height is None
    seen = SeenSchema(
        pixel=(321.5, 200.0), pose=(0.1, 0.2, 0.3), tag=TagSchema(id=3, size=0.03, pose=(0, 0, 1.0))
    )
    path = tmp_path / "seen.yaml"
    path.write_text(dump_object("seen", tall.grid, tall.prior, tall.height, seen))
    assert read_object_file(path).seen == seen
    path.write_text(path.read_text().replace("height: 0.04", "height: -1"))
    with pytest.raises(ObjectError, match="height is -1; expected a positive number, in meters"):
        GridObject.from_yaml(path)
    with pytest.raises(ObjectError, match=r"height is 0\.0; expected a positive number"):
        GridObject("flat", *plain.grid, plain.prior, 0.0)


def test_a_center_of_mass_outside_the_object_is_refused(tmp_path):
    path = tmp_path / "square.yaml"
    path.write_text(
        "outline: [[0, 0], [0.1, 0], [0.1, 0.1], [0, 0.1]]\ncenter_of_mass: {at: [0.3, 0.0]}\n"
    )
    with pytest.raises(
        ObjectError,
        match=r"square.yaml.*center_of_mass.at is \[0.3, 0\] m; expected a point within",
    ):
        GridObject.from_yaml(path)


def test_a_pusher_in_millimeters_is_refused(tmp_path):
    path = tmp_path / "square.yaml"
    path.write_text("outline: [[0, 0], [0.1, 0], [0.1, 0.1], [0, 0.1]]\npusher: {radius: 5}\n")
    with pytest.raises(
        ObjectError, match=r"pusher.radius is 5; expected a positive number, in meters, at most 1"
    ):
        GridObject.from_yaml(path)


SQUARE = "outline: [[0, 0], [0.1, 0], [0.1, 0.1], [0, 0.1]]\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            SQUARE + "center_of_mass: {at: [0, 0], std: 1e300}\n",
            "center_of_mass.std is 1e.300; expected a positive number, in meters, at most 10000",
        ),
        (
            SQUARE + "center_of_mass: {at: [0, 0], std: 1e-300}\n",
            "center_of_mass.std is 1e-300; expected a positive number",
        ),
        (
            SQUARE + "contact_friction: {prior: 0.5, std: 1e12}\n",
            "contact_friction.std is 1000000000000.0; expected a positive number, at most 100",
        ),
        (SQUARE + "contact_friction: {prior: 1e12}\n", "contact_friction.prior is 1000000000000.0"),
        (SQUARE + "friction: {max: 1e300}\n", "friction.max is 1e.300; expected"),
        (SQUARE + "total_mass: 1e300\n", "total_mass is 1e.300; expected a positive number, in kg"),
        (SQUARE + "height: 1e300\n", "height is 1e.300; expected a positive number, in meters"),
        (SQUARE + "max_cells: 0x7fffffff\n", "max_cells is 2147483647; expected a whole number"),
        (SQUARE + 'name: "a\\x1b[31mb"\n', "name is 'a.x1b.*b'; expected some text, at most 200"),
        (SQUARE + 'name: "a\\nb"\n', "without control characters"),
        (SQUARE + 'name: "a\\u2028b"\n', "without control characters"),
        (SQUARE + f"name: {'a' * 201}\n", "at most 200 characters"),
        (
            SQUARE + "cells: {size: 0.05, centers: [[0.05, 0.05], [0.3, 0.05]]}\n",
            r"cells.centers\[1\] is \[0.3, 0.05\] m, 0.2 m outside the outline",
        ),
        (
            SQUARE + "cells: {size: 0.05, centers: [[0.02, 0.02], [0.07, 0.02], [0.02, 0.02]]}\n",
            r"cells.centers\[0\] and \[2\] are 0 m apart; expected squares of 0.05 m",
        ),
        (
            SQUARE + "cells: {size: 0.05, centers: [[0.02, 0.02], [0.04, 0.02], [0.02, 0.08]]}\n",
            r"cells.centers\[0\] and \[1\] are 0.02 m apart",
        ),
    ],
)
def test_what_no_object_can_be_is_refused_in_one_line(tmp_path, text, message):
    path = written(tmp_path, text)
    with pytest.raises(ObjectError, match=message) as caught:
        GridObject.from_yaml(path)
    assert str(caught.value).startswith(str(path))
    assert str(caught.value).isprintable()


def test_an_outline_of_too_many_points_is_refused(tmp_path):
    angle = np.linspace(0, 2 * np.pi, MAX_POINTS + 1, endpoint=False)
    points = ", ".join(
        f"[{x:.9f}, {y:.9f}]" for x, y in zip(np.cos(angle), np.sin(angle), strict=True)
    )
    path = written(tmp_path, f"outline: [{points}]\n")
    with pytest.raises(ObjectError, match=f"outline has .* points; expected at most {MAX_POINTS}"):
        GridObject.from_yaml(path)


def test_a_mask_that_can_be_opened_but_not_read_is_refused(tmp_path):
    path = written(tmp_path, "mask: {image: /proc/self/mem, meters_per_pixel: 0.001}\n")
    with pytest.raises(ObjectError, match="/proc/self/mem: cannot be read: Input/output error"):
        GridObject.from_yaml(path)


@pytest.mark.parametrize("name", ["a\0b", "a\tb", "a\ud800b", "\ufffe", "", "a" * 201])
def test_no_object_has_a_name_that_xml_cannot_hold(name):
    with pytest.raises(ObjectError, match=r"name is .*; expected some text"):
        GridObject.from_outline([[0, 0], [1, 0], [1, 1]], name=name)


@pytest.mark.parametrize("name", ["Hammer № 3", "トンカチ", "x & <y>", "été\u00a0!"])
def test_any_other_text_is_a_name(name):
    assert GridObject.from_outline([[0, 0], [1, 0], [1, 1]], name=name).name == name
