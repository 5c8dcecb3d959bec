"""YAML is read as version 1.2 has it, within bounds, the same with libyaml and without it."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from gridpush_drake.errors import ObjectError
from gridpush_drake.yaml_file import MAX_LINES, MAX_NODES, _StrictLoader, dump_yaml, parse_yaml

FILE = Path("file.yaml")

SCALARS = {
    "1:30": "1:30", "010": 10, "09": 9, "0o10": 8, "0x1F": 31, "1_000": "1_000", "0b11": "0b11",
    "yes": "yes", "No": "No", "on": "on", "off": "off", "y": "y", "true": True, "False": False,
    "~": None, "null": None, "": None, "1e-3": 0.001, "1.": 1.0, ".5": 0.5, "-1E3": -1000.0,
    "2001-01-01": "2001-01-01", "1.5:3": "1.5:3", "'1'": "1", "!!int '010'": 10, "- ": [None],
}  # fmt: skip

REFUSED = {
    "a: 1\na: 2": "line 2, column 1: is not valid YAML: key 'a' occurs twice",
    "x: !!int '1:30'": "line 1, column 4: is not valid YAML: !!int stands before '1:30'; expected a whole number",
    "x: !!float '1:30'": "!!float stands before '1:30'; expected a number",
    "x: !!bool maybe": "line 1, column 4: is not valid YAML: !!bool stands before 'maybe'; expected true or false",
    "!!timestamp x": "line 1, column 1: is not valid YAML: the tag !!timestamp is not known; expected a plain value",
    "x: !!timestamp 2001-01-01": "the tag !!timestamp is not known",
    "x: !!binary '@'": "the tag !!binary is not known",
    "x: !!set {a, b}": "the tag !!set is not known",
    "x: !!omap [a: 1]": "the tag !!omap is not known",
    "x: !!python/object/apply:os.system [true]": "is not valid YAML: could not determine",
    "x: &a [*a]": "an alias (*name) stands inside the value that it names",
    "x: " + "1" * 401: "a number has 401 characters; expected at most 400",
    "[" * 300 + "]" * 300: "is nested too deeply",
    "- " * 300 + "1": "is nested too deeply",
    "? " * 100_000: "is nested too deeply",
    "x: \0": "is not valid YAML",
    "x: '": "is not valid YAML",
    "\n" * (MAX_LINES + 1): f"has more than {MAX_LINES} lines",
}


def parse(text):
    """The values, or what was said of them."""
    try:
        return parse_yaml(FILE, text, "anything", ObjectError)
    except ObjectError as error:
        return str(error)


@pytest.mark.parametrize("text", SCALARS)
def test_what_a_plain_scalar_is_follows_the_core_schema_of_yaml_1_2(text):
    expected = SCALARS[text]
    found = parse(f"x:\n {text}")
    assert found == {"x": expected}
    assert type(found["x"]) is type(expected)


@pytest.mark.parametrize("text", REFUSED, ids=range(len(REFUSED)))
def test_a_document_that_is_none_is_refused_in_one_line(text):
    said = parse(text)
    assert said.startswith("file.yaml")
    assert REFUSED[text] in said
    assert "\n" not in said


WITHOUT_LIBYAML = """
import json, sys, yaml
yaml.__with_libyaml__ = False
from tests.test_yaml_file import parse
from gridpush_drake.yaml_file import _Parser
assert not hasattr(yaml, "CParser") or not issubclass(_Parser, yaml.cyaml.CParser)
print(json.dumps([parse(text) for text in json.load(sys.stdin)]))
"""


@pytest.mark.skipif(not yaml.__with_libyaml__, reason="there is nothing to compare with")
def test_without_libyaml_the_same_is_read_and_the_same_is_refused():
    texts = [f"x:\n {text}" for text in SCALARS] + list(REFUSED)
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_LIBYAML], input=json.dumps(texts), capture_output=True, text=True,
        check=True, cwd=Path(__file__).parents[1],
    )  # fmt: skip
    slow = json.loads(done.stdout)
    for text, found in zip(texts, slow, strict=True):
        if text in REFUSED:
            assert REFUSED[text] in found
        else:
            assert found == parse(text)


@pytest.mark.slow
def test_a_large_document_is_read_by_the_compiled_parser():
    """PyYAML's own parser takes several times as long."""
    points = ",".join(f"[{i / 7},{-i / 3}]" for i in range(MAX_NODES // 25))
    found = parse(f"outline: [{points}]")
    assert len(found["outline"]) == MAX_NODES // 25
    if yaml.__with_libyaml__:
        assert issubclass(_StrictLoader, yaml.cyaml.CParser)
    assert f"more than {MAX_NODES} keys and values" in parse("- 1\n" * (MAX_NODES + 1))


@pytest.mark.parametrize(
    "name", ["1:30", "010", "0o17", "0x1F", "1e3", "1_000", "yes", "null", "~", "", "2001-01-01", "on"]
)  # fmt: skip
def test_a_text_that_looks_like_a_number_is_written_so_that_both_versions_read_it_as_text(name):
    text = dump_yaml({"name": name})
    assert parse(text) == {"name": name}
    assert yaml.safe_load(text) == {"name": name}
